"""Inputs between their samples, at every step of the physics."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import CubicSpline

from ..arrays import Array
from ..simulate import upsample


def through(values: Array, every: int, *, by: int = 0) -> Array:
    """A record at `every` times its rate, by a cubic spline through its samples, or its `by`-th derivative by the sample."""
    n = len(values)
    return np.asarray(
        CubicSpline(np.arange(n), values)(np.arange(every * (n - 1) + 1) / every, by), dtype=np.float64
    )


def finer(values: Array, every: int, *, held: bool, sparse: bool) -> Array:
    """A record (n,) at `every` times its rate: held, or along lines; through a spline where samples are `sparse`."""
    return through(values, every) if sparse and not held else upsample(values, every, hold=held)


def bent(
    values: Array, slopes: tuple[Array, Array] | None, step: float, every: int, *, sparse: bool
) -> tuple[Array, ...]:
    """An input at `every` times its rate, and its two derivatives by time, where something acts through them.

    Along lines every sample would be a knock. slopes: the derivatives, where they are known at the samples; step [s]: of those.
    """
    if slopes is not None:
        x = finer(values, every, held=False, sparse=sparse)
        return x, upsample(slopes[0], every), upsample(slopes[1], every)
    return tuple(through(values, every, by=by) / step**by for by in range(3))
