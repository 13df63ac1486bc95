"""Tools for sampled, noisy signals: noise level, derivatives, and consistency of two channels of one motion."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy import linalg, optimize, signal

from ...common.errors import InputError

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

SLIPS = 3  # number of unequal steps from which stamps count as rounded


def noise_level(x: ArrayLike, step: float) -> tuple[float, float]:
    """Return the level and correlation of the AR(1) measurement noise on a sampled channel.

    A power law plus AR(1) noise is fitted to the top of a Welch spectrum (from an eighth of the Nyquist
    frequency up) by the Whittle likelihood. Assumption: in this band the power of the signal falls at least
    as steeply as 1/f^2, as that of any body with inertia and even of a jump does, and the noise does not.
    Noise below this band counts as signal; signal near the Nyquist frequency counts as noise.

    Args:
        x: Samples (n,) in any unit.
        step: Sampling step [s].

    Returns:
        Standard deviation in the unit of `x`, and lag-one correlation [-].

    Raises:
        InputError: Fewer than 64 samples, or samples that are not finite.

    References:
        Whittle, "Estimation and information in stationary time series", Arkiv för Matematik, 1953.
    """
    x = np.asarray(x, float)
    if x.ndim != 1 or len(x) < 64 or not np.all(np.isfinite(x)) or not step > 0:
        raise InputError("noise level: 64 or more finite samples and a positive step are needed")
    scale = float(np.std(x))
    if scale <= 1e-14 * np.max(np.abs(x)):
        return 0.0, 0.0
    size = min(512, len(x) // 4)
    frequency, power = signal.welch(
        x / scale,
        window="blackmanharris",
        nperseg=size,
        noverlap=3 * size // 4,
        detrend="linear",
        average="median",
    )
    band = (frequency >= 1 / 16) & (frequency < 0.5 - 1.5 / size)
    omega, power = 2 * np.pi * frequency[band], np.maximum(power[band], 1e-32)
    slope = np.log(np.sin(omega / 2) / np.sin(omega[0] / 2))

    def misfit(p: np.ndarray) -> float:
        model = np.exp(p[0] - p[1] * slope) + np.exp(p[2]) / (1 - 2 * p[3] * np.cos(omega) + p[3] ** 2)
        return float(np.mean(np.log(model) + power / model))

    top = math.log(float(np.median(power[-len(power) // 4 :])))
    bounds = [(-80.0, 10.0), (2.0, 16.0), (-80.0, 10.0), (-0.5, 0.8)]
    starts = [(math.log(power[0]), q, top + 2 * math.log1p(r), r) for q in (2.5, 8.0) for r in (0.0, 0.4)]
    best = min((optimize.minimize(misfit, s, bounds=bounds) for s in starts), key=lambda fit: fit.fun)
    lag1 = float(best.x[3])
    return scale * math.sqrt(math.exp(best.x[2]) / 2 / (1 - lag1**2)), lag1


def smooth_derivatives(
    x: ArrayLike, step: float, noise: tuple[float, float] | None = None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return position, velocity and acceleration from a noisy measured displacement.

    The estimate is that of a Rauch-Tung-Striebel smoother for an integrated random walk in AR(1) noise,
    computed as a penalised spline (banded, exact at the ends). Bandwidth and order (white jerk or white snap)
    maximise the restricted likelihood. A signal with negligible noise is only differentiated.

    Args:
        x: Displacement (n,) [m].
        step: Sampling step [s].
        noise: Standard deviation [m] and lag-one correlation [-]; None for the estimate of `noise_level`.

    Returns:
        Position [m], velocity [m/s] and acceleration [m/s^2], (n,) each.

    Raises:
        InputError: Fewer than 64 samples, samples that are not finite, or a lag-one correlation outside (-1,
            1).

    References:
        Rauch, Tung and Striebel, "Maximum likelihood estimates of linear dynamic systems", AIAA Journal,
            1965.
    """
    x = np.array(x, float)
    sigma, lag1 = noise_level(x, step) if noise is None else noise
    if x.ndim != 1 or len(x) < 64 or not np.all(np.isfinite(x)) or not -1 < lag1 < 1:
        raise InputError(
            "smoothing: 64 or more finite samples and a lag-one correlation within (-1, 1) needed"
        )
    if sigma > 1e-12 * np.std(x):
        fits = (_spline(x, sigma, lag1, order) for order in (3, 4))
        x = min(fits, key=lambda fit: fit[0])[1]
    v, a = np.empty_like(x), np.empty_like(x)
    v[2:-2] = (8 * (x[3:-1] - x[1:-3]) - (x[4:] - x[:-4])) / (12 * step)
    a[2:-2] = (16 * (x[3:-1] + x[1:-3]) - (x[4:] + x[:-4]) - 30 * x[2:-2]) / (12 * step**2)
    # the quartic through the last five samples
    for ends, at in ((slice(0, 5), (0, 1)), (slice(-5, None), (-2, -1))):
        p = np.polynomial.Polynomial.fit(np.arange(5), x[ends], 4, domain=[0, 4], window=[0, 4])
        for i in at:
            v[i], a[i] = p.deriv()(i % 5) / step, p.deriv(2)(i % 5) / step**2
    return x, v, a


def _gram(row: np.ndarray, n: int) -> np.ndarray:
    """Return D'D in upper banded form; D (n - m + 1, n) is the convolution with `row` (m,)."""
    m = len(row)
    out = np.zeros((m, n))
    for j in range(m):
        for i in range(m - j):
            out[m - 1 - j, i + j : i + j + n - m + 1] += row[i] * row[i + j]
    return out


def _spline(x: np.ndarray, sigma: float, lag1: float, order: int) -> tuple[float, np.ndarray]:
    """Return -2 log restricted likelihood and the smoothed x; the differences of `order` are white noise of fitted size."""
    n = len(x)
    row = np.array([math.comb(order, k) * (-1.0) ** k for k in range(order + 1)])
    penalty = _gram(row, n)
    weight = np.zeros_like(penalty)  # inverse covariance of AR(1) noise of unit variance
    weight[-2:] = _gram(np.array([-lag1, 1.0]), n)
    weight[-1, 0] += 1 - lag1**2
    weight /= 1 - lag1**2

    def times(y: np.ndarray) -> np.ndarray:
        out = weight[-1] * y
        out[1:] += weight[-2, 1:] * y[:-1]
        out[:-1] += weight[-2, 1:] * y[1:]
        return out

    right = times(x)

    def fit(log_penalty: float) -> tuple[float, np.ndarray]:
        factor = linalg.cholesky_banded(weight + math.exp(log_penalty) * penalty)
        s = linalg.cho_solve_banded((factor, False), right)
        quadratic = (x - s) @ times(x - s) + math.exp(log_penalty) * np.sum(np.diff(s, order) ** 2)
        determinant = 2 * np.sum(np.log(factor[-1])) - (n - order) * log_penalty
        return float(determinant + quadratic / sigma**2), s

    # beyond 30 the banded solution loses its digits: a cut-off below about 1/1000 of the sampling rate
    grid = np.arange(-6.0, 30.1, 2.0)
    costs = [fit(float(g))[0] for g in grid]
    i = int(np.argmin(costs))
    best = optimize.minimize_scalar(
        lambda g: fit(float(g))[0],
        bounds=(grid[max(i - 1, 0)], grid[min(i + 1, len(grid) - 1)]),
        method="bounded",
    )
    return fit(float(best.x))


def stamp_rounding(time: np.ndarray) -> float:
    """Return the resolution to which the stamps of a uniform sampling were rounded.

    Uniform stamps that are rounded to multiples of q have steps of two lengths, both multiples of q with
    difference q, and stay within q/2 of a straight line. If the step is at most q, fewer than `SLIPS` steps
    of the rarer length may also be lost or doubled samples.

    Args:
        time: Stamps (n,) [s].

    Returns:
        Resolution [s]; 0 for stamps that are not rounded or not uniform.
    """
    if len(time) < 3 or not np.isfinite(time).all():
        return 0.0
    steps = np.diff(time)
    short, long = float(steps.min()), float(steps.max())
    mean = float(steps.mean())
    digits = 1e-6 * mean + 4 * float(np.spacing(np.abs(time).max()))
    rounding = long - short
    if short < -digits or mean <= 0 or rounding <= 4 * digits:
        return 0.0
    is_long = long - steps < digits
    if not np.all(is_long | (steps - short < digits)):
        return 0.0
    count = short / rounding
    if abs(count - round(count)) * rounding > digits * (1 + count) + 1e-3 * rounding:
        return 0.0
    if count < 1.5 and min(is_long.sum(), len(steps) - is_long.sum()) < SLIPS:
        return 0.0
    return rounding if np.ptp(time - even_stamps(time)) < 1.1 * rounding else 0.0


def even_stamps(time: np.ndarray) -> np.ndarray:
    """Return the uniform stamps nearest to given stamps (least squares over the whole span).

    Args:
        time: Stamps (n,) [s].

    Returns:
        Uniform stamps (n,) [s].
    """
    k = np.arange(len(time)) - 0.5 * (len(time) - 1)
    mean = float(np.mean(time - time[0]))
    return np.asarray(time[0] + mean + k * (float(k @ (time - time[0] - mean)) / float(k @ k)))


def unwrapped(angle: np.ndarray, turn: float) -> tuple[np.ndarray, int]:
    """Return a measured angle without the jumps of a sensor that restarts at each turn.

    A wrap is a step of nearly a turn between the ends of a range of one turn; the angle continues smoothly
    across the step. Angles with another range, or with steps near half a turn, are returned unchanged.

    Args:
        angle: Samples (n,).
        turn: One turn in the unit of the samples, such as 360 for degrees.

    Returns:
        Angle (n,), and the number of wraps.
    """
    none = np.asarray(angle), 0
    if len(angle) < 3 or not np.isfinite(angle).all() or not np.ptp(angle) <= 1.001 * turn:
        return none
    steps = np.diff(angle)
    wraps = np.abs(steps) > 0.5 * turn
    if not wraps.any():
        return none
    out = np.unwrap(angle, period=turn)
    after = np.abs(np.diff(out))
    usual = float(np.quantile(after[~wraps], 0.99)) if not wraps.all() else math.inf
    smooth = after.max() < 0.35 * turn and after[wraps].max() <= 3 * usual + 0.01 * turn
    full = np.ptp(angle) > turn - 2 * after.max() - 0.01 * turn
    return (out, int(wraps.sum())) if smooth and full else none


@dataclass(frozen=True)
class Consistency:
    """Agreement of one channel with the time derivative of another.

    Attributes:
        gain: Measured over computed derivative [-]; 1 for agreement, negative for a wrong sign.
        lag: Delay of the measured derivative [s]; 0 for agreement.
        coherence: Mean coherence over the band [-].
        gain_std: Standard deviation of the gain [-].
        band: Lowest and highest frequency [Hz].
    """

    gain: float
    lag: float
    coherence: float
    gain_std: float
    band: tuple[float, float]


def integral_consistency(
    lower: ArrayLike,
    higher: ArrayLike,
    step: float,
    *,
    order: int = 2,
    band: tuple[float, float] = (0.5, 20.0),
    max_lag: float = 0.25,
) -> Consistency:
    """Compare a time derivative of one channel with another channel of the same node.

    The comparison uses cross spectra; each line is weighted by its information coherence/(1 - coherence).
    Nothing is differentiated or integrated in time, so that noise and offsets do not enter.

    Args:
        lower: Channel (n,) of lower order, such as a displacement [m].
        higher: Channel (n,) of higher order, such as an acceleration [m/s^2].
        step: Sampling step [s].
        order: Number of time derivatives between the channels; 2 from displacement to acceleration.
        band: Lowest and highest frequency [Hz].
        max_lag: Largest delay to be considered [s].

    Returns:
        Gain, delay and coherence of the measured against the computed derivative.

    Raises:
        InputError: The channels differ in length, are not finite, or are too short for the band.
    """
    x, y = np.asarray(lower, float), np.asarray(higher, float)
    size = int(min(len(x) // 4, max(4.0 / band[0], 4 * max_lag) / step))
    if x.shape != y.shape or x.ndim != 1 or not np.all(np.isfinite(x + y)) or size * step * band[0] < 1:
        raise InputError(
            f"consistency: two finite channels of more than {4 / band[0]:.3g} s alike are needed"
        )
    options: dict[str, Any] = {"fs": 1 / step, "nperseg": size, "noverlap": size // 2, "detrend": "linear"}
    frequency, xx = signal.welch(x, **options)
    _, yy = signal.welch(y, **options)
    _, xy = signal.csd(x, y, **options)
    use = (frequency >= band[0]) & (frequency <= min(band[1], 0.4 / step)) & (xx > 0) & (yy > 0)
    omega = 2 * np.pi * frequency[use]
    coherence = np.minimum(np.abs(xy[use]) ** 2 / (xx[use] * yy[use]), 1 - 1e-9)
    ratio = xy[use] / xx[use] / (1j * omega) ** order
    weight = coherence / (1 - coherence) / np.maximum(np.abs(ratio), 1e-300) ** 2
    weight /= weight.sum()

    def projected(lag: float) -> float:
        return float(np.sum(weight * ratio * np.exp(1j * omega * lag)).real)

    lags = np.linspace(-max_lag, max_lag, 2 * int(max_lag * 8 * min(band[1], 0.4 / step)) + 1)
    i = int(np.argmax([abs(projected(t)) for t in lags]))
    ends = (lags[max(i - 1, 0)], lags[min(i + 1, len(lags) - 1)])
    lag = float(optimize.minimize_scalar(lambda t: -abs(projected(t)), bounds=ends, method="bounded").x)
    blocks = max(2 * len(x) / size - 1, 1)
    information = np.sum(2 * blocks * coherence / (1 - coherence))
    gain = projected(lag)
    span = (float(frequency[use][0]), float(frequency[use][-1]))
    return Consistency(
        gain, lag, float(coherence.mean()), abs(gain) / math.sqrt(max(information, 1e-12)), span
    )
