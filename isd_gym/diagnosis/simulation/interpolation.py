"""Inputs between their samples, at every step of the physics."""

from __future__ import annotations

import math

import numpy as np
from scipy.interpolate import CubicSpline

from ...common.arrays import Array, rms
from ...physics.simulate import upsample

#: white noise of one unit in the first and second derivative of a spline through it, by the sample (RMS over frequencies)
GAINS = 1.18, 6.0
QUIET = 0.02  # share of a derivative that noise may have
#: eighth differences of white noise of one unit, in which a motion hardly shows
EIGHTH = math.sqrt(math.comb(16, 8))


def through(values: Array, every: int, *, by: int = 0) -> Array:
    """A record at `every` times its rate, by a cubic spline through its samples, or its `by`-th derivative by the sample."""
    n = len(values)
    return np.asarray(
        CubicSpline(np.arange(n), values)(np.arange(every * (n - 1) + 1) / every, by), dtype=np.float64
    )


def interpolated(values: Array, every: int, *, held: bool, sparse: bool) -> Array:
    """Return a record (n,) at `every` times its rate: held, linear, or through a spline if the samples are `sparse`."""
    return through(values, every) if sparse and not held else upsample(values, every, hold=held)


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

    Args:
        values: Samples (n,).
        slopes: First and second derivative at the samples, if known.
        step: Sampling step [s].
        every: Ratio of the rates.
        sparse: As for `interpolated`.
    """
    if slopes is None:
        slopes = differences(values, step)
        noise = rms(np.diff(values, 8)) / EIGHTH if len(values) > 8 else 0.0
        splined = [GAINS[k] * noise / step ** (k + 1) < QUIET * rms(slopes[k]) for k in (0, 1)]
    else:
        splined = [False, False]
    x = interpolated(values, every, held=False, sparse=sparse or splined[0])
    derived = [
        through(values, every, by=k + 1) / step ** (k + 1) if splined[k] else upsample(slopes[k], every)
        for k in (0, 1)
    ]
    return x, *derived
