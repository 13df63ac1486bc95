"""A damped Gauss-Newton step within limits (Levenberg 1944, Marquardt 1963; active set at the limits)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from .problem import Array


def bounded_step(
    hessian: Array, slope: Array, x: Array, low: Array, high: Array, stride: Array, damping: float
) -> Array:
    """The step (p,) that minimises the damped model of the cost from `x`, no coordinate beyond its limits or its stride.

    hessian (p, p), slope (p,): of half the cost, downhill. Coordinates that rest on a limit and would leave it are held
    there, and the others stepped as if they were known. `damping`: relative, on the diagonal.
    """
    p = len(x)
    damped = hessian + np.diag(damping * np.diag(hessian))
    free = np.ones(p, bool)
    step = np.zeros(p)
    for _ in range(p + 1):
        index = np.flatnonzero(free)
        step = np.zeros(p)
        if len(index):
            step[index] = np.linalg.solve(damped[np.ix_(index, index)], slope[index])
        leaves = ((step < 0) & (x <= low + 1e-9)) | ((step > 0) & (x >= high - 1e-9))
        if not np.any(leaves & free):
            break
        free &= ~leaves
    return np.asarray(np.clip(x + np.clip(step, -stride, stride), low, high) - x, dtype=np.float64)
