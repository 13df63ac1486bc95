"""Agreement of one channel with the time derivative of another, as of two sensors of one motion."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy import optimize, signal

from ..._common.errors import InputError

if TYPE_CHECKING:
    from numpy.typing import ArrayLike


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
