"""Type and root mean square of arrays of real numbers."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

#: array of real numbers; docstrings state the shape
Array = NDArray[np.float64]


def rms(values: Array) -> float:
    """Return the root mean square of an array.

    Args:
        values: Array of any shape.

    Returns:
        Root mean square in the unit of `values`.
    """
    return float(np.sqrt(np.mean(np.square(values))))
