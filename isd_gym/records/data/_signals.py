"""Time stamps that were rounded, and angles that restart at each turn."""

from __future__ import annotations

import math

import numpy as np

SLIPS = 3  # number of unequal steps from which stamps count as rounded


def stamp_rounding(time: np.ndarray) -> float:
    """Return the resolution [s] to which the stamps (n,) [s] of a uniform sampling were rounded; 0 for other stamps.

    Uniform stamps that are rounded to multiples of q have steps of two lengths, both multiples of q with
    difference q, and stay within q/2 of a straight line. If the step is at most q, fewer than `SLIPS` steps
    of the rarer length may also be lost or doubled samples.
    """
    if len(time) < 3 or not np.isfinite(time).all():
        return 0.0
    steps = np.diff(time)
    short, long = float(steps.min()), float(steps.max())
    mean = float(steps.mean())
    digits = 1e-6 * mean + 4 * float(np.spacing(np.abs(time).max()))
    rounding = long - short
    if short < -digits or mean <= 0 or rounding <= 4 * digits:
        return 0.0
    is_long = long - steps < digits
    if not np.all(is_long | (steps - short < digits)):
        return 0.0
    count = short / rounding
    if abs(count - round(count)) * rounding > digits * (1 + count) + 1e-3 * rounding:
        return 0.0
    if count < 1.5 and min(is_long.sum(), len(steps) - is_long.sum()) < SLIPS:
        return 0.0
    return rounding if np.ptp(time - even_stamps(time)) < 1.1 * rounding else 0.0


def even_stamps(time: np.ndarray) -> np.ndarray:
    """Return the uniform stamps nearest to given stamps (n,) [s], by least squares over the whole span."""
    k = np.arange(len(time)) - 0.5 * (len(time) - 1)
    mean = float(np.mean(time - time[0]))
    return np.asarray(
        time[0] + mean + k * (float(k @ (time - time[0] - mean)) / float(k @ k))
    )


def unwrapped(angle: np.ndarray, turn: float) -> tuple[np.ndarray, int]:
    """Return a measured angle (n,) without the jumps of a sensor that restarts at each `turn`, and the number of jumps.

    A wrap is a step of nearly a turn between the ends of a range of one turn; the angle continues smoothly
    across the step. Angles with another range, or with steps near half a turn, are returned unchanged.
    """
    none = np.asarray(angle), 0
    if (
        len(angle) < 3
        or not np.isfinite(angle).all()
        or not np.ptp(angle) <= 1.001 * turn
    ):
        return none
    steps = np.diff(angle)
    wraps = np.abs(steps) > 0.5 * turn
    if not wraps.any():
        return none
    out = np.unwrap(angle, period=turn)
    after = np.abs(np.diff(out))
    usual = float(np.quantile(after[~wraps], 0.99)) if not wraps.all() else math.inf
    smooth = after.max() < 0.35 * turn and after[wraps].max() <= 3 * usual + 0.01 * turn
    full = np.ptp(angle) > turn - 2 * after.max() - 0.01 * turn
    return (out, int(wraps.sum())) if smooth and full else none
