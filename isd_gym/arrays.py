"""The arrays that physics and measurements are, and how large they are."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

#: of real numbers, shape in the docstring of whoever hands it on
Array = NDArray[np.float64]


def rms(values: Array) -> float:
    """Root of the mean square of `values`, of any shape."""
    return float(np.sqrt(np.mean(np.square(values))))
