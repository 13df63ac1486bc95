"""Type and root mean square of arrays of real numbers, and the quantile of their 95 % intervals."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from collections.abc import Sequence

#: array of real numbers; docstrings state the shape
Array = NDArray[np.float64]
#: quantile of a normal distribution for a 95 % interval
Z95 = 1.96


def rms(values: Array) -> float:
    """Return the root mean square of an array.

    Args:
        values: Array of any shape.

    Returns:
        Root mean square in the unit of `values`.
    """
    return float(np.sqrt(np.mean(np.square(values))))


def channel_rms(parts: Sequence[Array]) -> Array:
    """Return the root mean square of every channel over several parts.

    Args:
        parts: Arrays (samples, channels).

    Returns:
        Root mean square (channels,); not finite where a simulation diverged.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        return np.asarray(np.sqrt(np.mean(np.concatenate(parts) ** 2, axis=0)), dtype=np.float64)
