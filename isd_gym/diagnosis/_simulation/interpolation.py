"""Inputs between their samples, at every step of the physics."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import CubicSpline

from ..._common.arrays import Array, is_smooth
from ...physics.simulate import upsample


def through(values: Array, every: int, *, by: int = 0) -> Array:
    """A record at `every` times its rate, by a cubic spline through its samples, or its `by`-th derivative by the sample."""
    n = len(values)
    return np.asarray(
        CubicSpline(np.arange(n), values)(np.arange(every * (n - 1) + 1) / every, by),
        dtype=np.float64,
    )


def interpolated(
    values: Array, every: int, step: float, *, held: bool, sparse: bool
) -> Array:
    """Return a record (n,) at `every` times its rate: held, linear, or through a spline if samples are sparse or smooth, since a straight
    line reduces the amplitude by a twelfth of the squared angle between samples."""
    if held or every == 1 or not (sparse or is_smooth(values, step)):
        return upsample(values, every, hold=held)
    return through(values, every)


def differences(values: Array, step: float) -> tuple[Array, Array]:
    """Return first and second derivative by time at the samples, from central differences with the sampling step [s]."""
    v = np.gradient(values, step, edge_order=2)
    return v, np.gradient(v, step, edge_order=2)


def splined_input(
    values: Array,
    slopes: tuple[Array, Array] | None,
    step: float,
    every: int,
    *,
    sparse: bool,
) -> tuple[Array, ...]:
    """Return an input (n,) at `every` times its rate with its first and second derivative: of a spline, or differences where noise
    dominates."""
    if slopes is None:
        slopes = differences(values, step)
        splined = [is_smooth(values, step, slopes[k], k + 1) for k in (0, 1)]
    else:
        splined = [False, False]
    x = through(values, every) if sparse or splined[0] else upsample(values, every)
    derived = [
        through(values, every, by=k + 1) / step ** (k + 1)
        if splined[k]
        else upsample(slopes[k], every)
        for k in (0, 1)
    ]
    return x, *derived
