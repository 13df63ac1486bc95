"""Tools for sampled, noisy signals: their noise, their derivatives, and whether two of them tell the same motion."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy import linalg, optimize, signal

from ..errors import InputError

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

SLIPS = 3  # steps of another length from which on stamps count as rounded


def noise_level(x: ArrayLike, step: float) -> tuple[float, float]:
    """Standard deviation and lag-one correlation of the AR(1) measurement noise on a sampled channel (n,).

    Assumes that the signal, at the top of the spectrum (from an eighth of the Nyquist frequency up), falls at least
    as steeply as 1/f^2 in power, as anything with inertia and even a jump does, and that the noise does not: a power
    law plus AR(1) noise is fitted to a Welch spectrum by Whittle's likelihood. Noise slower than that band cannot be
    told from signal and is not counted; a signal that reaches the Nyquist frequency is. x in any unit, `step` [s].
    Raises `InputError` for fewer than 64 samples or ones that are not finite.
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
    """Position, velocity and acceleration (n,) each [m, m/s, m/s^2] from a noisy measured displacement x (n,) [m].

    The smoother of an integrated random walk in AR(1) noise, which is what a Kalman filter and Rauch-Tung-Striebel
    smoother give for it, computed as a penalised spline (banded, exact at the ends). Its bandwidth, and its order (jerk
    or snap being white), maximise the restricted likelihood. noise: (sigma [m], lag-one correlation), by default from
    `noise_level`. Where there is no noise to speak of, x is only differentiated. Raises `InputError` as that does.

    step [s].
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
    for ends, at in ((slice(0, 5), (0, 1)), (slice(-5, None), (-2, -1))):  # the quartic through the last five
        p = np.polynomial.Polynomial.fit(np.arange(5), x[ends], 4, domain=[0, 4], window=[0, 4])
        for i in at:
            v[i], a[i] = p.deriv()(i % 5) / step, p.deriv(2)(i % 5) / step**2
    return x, v, a


def _gram(row: np.ndarray, n: int) -> np.ndarray:
    """D'D in upper banded form, D (n - m + 1, n) being the convolution with `row` (m,)."""
    m = len(row)
    out = np.zeros((m, n))
    for j in range(m):
        for i in range(m - j):
            out[m - 1 - j, i + j : i + j + n - m + 1] += row[i] * row[i + j]
    return out


def _spline(x: np.ndarray, sigma: float, lag1: float, order: int) -> tuple[float, np.ndarray]:
    """-2 log restricted likelihood and the smoothed x, with differences of `order` as white noise of fitted size."""
    n = len(x)
    row = np.array([math.comb(order, k) * (-1.0) ** k for k in range(order + 1)])
    penalty = _gram(row, n)
    weight = np.zeros_like(penalty)  # the inverse covariance of AR(1) noise of unit variance
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
    """Return the rounding [s] that stamps (n,) of an even sampling went through; 0 where there is none, or where they are not even.

    Even stamps that are rounded to multiples of q have steps of two lengths, multiples of q that differ by q, and stay within q/2 of
    a straight line. Where a step is no longer than q, fewer than `SLIPS` steps of the rarer length may as well be lost or doubled
    samples.

    Args:
        time: Stamps [s].
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
    """Return the evenly spaced stamps (n,) nearest to `time` (n,) [s] (least squares over the whole span)."""
    k = np.arange(len(time)) - 0.5 * (len(time) - 1)
    mean = float(np.mean(time - time[0]))
    return np.asarray(time[0] + mean + k * (float(k @ (time - time[0] - mean)) / float(k @ k)))


def unwrapped(angle: np.ndarray, turn: float) -> tuple[np.ndarray, int]:
    """Return a measured angle (n,) without the jumps of a sensor that begins anew each turn, and how many there were.

    A wrap is a step of nearly a `turn` from one end of a range of one turn to the other, at whose sides the angle goes on as before.
    Angles with a range of more or less than a turn, or with steps near half a turn, are returned as they are.

    Args:
        angle: Samples.
        turn: A turn in the unit of the samples, such as 360 for degrees.
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
    """How well one channel is another's time derivative: `gain` [-] and `lag` [s] of the measured derivative against
    the computed one (1 and 0 where they agree, a negative gain for a wrong sign), `gain_std` [-], and their mean
    coherence [-] over `band` [Hz]."""

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
    """Compare d^order(lower)/dt^order with `higher`, both (n,), for channels of one node whose kinematics must agree
    (displacement [m] and acceleration [m/s^2]: order 2).

    From cross spectra over `band` [Hz], each line weighted by its information coherence/(1 - coherence): nothing is
    differentiated or integrated in time, so noise and offsets do not enter. Lags beyond `max_lag` [s] are not sought.
    Raises `InputError` if the record is too short for the band.

    step [s].
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
