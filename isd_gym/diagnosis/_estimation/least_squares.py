"""Damped Gauss-Newton steps within limits (Levenberg 1944, Marquardt 1963; active set at the limits)."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, TypeVar

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from ..._common.arrays import Array

Point = TypeVar("Point")
#: further dampings that a step tries
TRIES = 5


def damped_step(
    take: Callable[[Sequence[float]], list[tuple[Point, float]]],
    cost: float,
    damping: float,
) -> tuple[Point | None, float]:
    """Return a point with a lower cost, or None, and the next damping: less after a success. Where the first try fails, the best of
    several dampings, tenfold each, is taken. `take` returns the points of dampings and their costs, infinite if a simulation fails.
    """
    found, lower = take([damping])[0]
    if not lower < cost:
        least = max(10 * damping, 1e-3 if math.isfinite(lower) else 1.0)
        dampings = [least * 10**k for k in range(TRIES)]
        points = take(dampings)
        k = int(np.argmin([each for _, each in points]))
        (found, lower), damping = points[k], dampings[k]
    return (found, max(0.2 * damping, 1e-6)) if lower < cost else (None, damping)


def damped(matrix: Array, damping: float) -> Array:
    """Return a matrix (n, n) with its diagonal grown by a share."""
    return np.asarray(matrix + damping * np.diag(np.diag(matrix)))


def bounded_step(
    hessian: Array,
    slope: Array,
    x: Array,
    low: Array,
    high: Array,
    stride: Array,
    damping: float,
) -> Array:
    """Return the minimum of the damped quadratic model of the cost within limits and strides (p,), from half its Hessian (p, p) and
    descent direction (p,); coordinates that would leave the limits stay."""
    p = len(x)
    curvature = damped(hessian, damping)
    free = np.ones(p, bool)
    step = np.zeros(p)
    for _ in range(p + 1):
        index = np.flatnonzero(free)
        step = np.zeros(p)
        if len(index):
            step[index] = np.linalg.solve(curvature[np.ix_(index, index)], slope[index])
        leaves = ((step < 0) & (x <= low + 1e-9)) | ((step > 0) & (x >= high - 1e-9))
        if not np.any(leaves & free):
            break
        free &= ~leaves
    return np.asarray(
        np.clip(x + np.clip(step, -stride, stride), low, high) - x, dtype=np.float64
    )
