"""Type and root mean square of arrays of real numbers, and the quantile of their 95 % intervals."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

#: array of real numbers; docstrings state the shape
Array = NDArray[np.float64]
#: quantile of a normal distribution for a 95 % interval
Z95 = 1.96
#: amplification of the white noise of samples in the first and second derivative of a spline through them, times the sampling step and
#: its square (RMS over frequencies)
GAINS = 1.18, 6.0
#: share of a derivative that may be noise
QUIET = 0.02
#: deviation of eighth differences of white noise of deviation 1; a motion hardly shows in them
EIGHTH = math.sqrt(math.comb(16, 8))


def rms(values: Array) -> float:
    """Return the root mean square of an array."""
    return float(np.sqrt(np.mean(np.square(values))))


def channel_rms(parts: Sequence[Array]) -> Array:
    """Return the root mean square of every channel over several parts."""
    with np.errstate(over="ignore", invalid="ignore"):
        return np.asarray(
            np.sqrt(np.mean(np.concatenate(parts) ** 2, axis=0)), dtype=np.float64
        )


def is_smooth(
    values: Array, step: float, slope: Array | None = None, order: int = 1
) -> bool:
    """Return whether noise and jumps are a small share of a derivative of a cubic spline through samples."""
    if slope is None:
        slope = np.gradient(values, step)
    noise = rms(np.diff(values, 8)) / EIGHTH if len(values) > 8 else 0.0
    return bool(GAINS[order - 1] * noise / step**order < QUIET * rms(slope))
