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
        CubicSpline(np.arange(n), values)(np.arange(every * (n - 1) + 1) / every, by), dtype=np.float64
    )


def interpolated(values: Array, every: int, step: float, *, held: bool, sparse: bool) -> Array:
    """Return a record (n,) at `every` times its rate: held, linear, or through a spline.

    A spline is used if the samples are `sparse`, or if noise and jumps do not dominate its slope. A straight line between the samples of a
    smooth force reduces its amplitude by a twelfth of the squared angle between samples: 0.4 % at 30 samples per period.

    `values`: Samples (n,).
    `sparse`: Whether samples are so sparse that straight lines lose much of the amplitude.
    """
    if held or every == 1 or not (sparse or is_smooth(values, step)):
        return upsample(values, every, hold=held)
    return through(values, every)


def differences(values: Array, step: float) -> tuple[Array, Array]:
    """Return first and second derivative by time at the samples, from central differences with the sampling step [s]."""
    v = np.gradient(values, step, edge_order=2)
    return v, np.gradient(v, step, edge_order=2)


def splined_input(
    values: Array, slopes: tuple[Array, Array] | None, step: float, every: int, *, sparse: bool
) -> tuple[Array, ...]:
    """Return an input at `every` times its sampling rate, with its first and second derivative by time.

    Derivatives of a linear interpolation would jump at each sample, so the derivatives are those of a cubic spline. If noise dominates
    the derivatives of the spline, the derivatives are differences between samples, which attenuate high frequencies.

    `values`: Samples (n,).
    """
    if slopes is None:
        slopes = differences(values, step)
        splined = [is_smooth(values, step, slopes[k], k + 1) for k in (0, 1)]
    else:
        splined = [False, False]
    x = through(values, every) if sparse or splined[0] else upsample(values, every)
    derived = [
        through(values, every, by=k + 1) / step ** (k + 1) if splined[k] else upsample(slopes[k], every)
        for k in (0, 1)
    ]
    return x, *derived
