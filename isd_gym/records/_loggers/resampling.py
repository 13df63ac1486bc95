"""Inputs at given instants, with a stated interpolation between different time stamps."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.interpolate import CubicSpline

if TYPE_CHECKING:
    from .recording import Signal


def sampled(signal: Signal, at: np.ndarray, quantity: str) -> tuple[np.ndarray, str]:
    """Return an input at given instants (n,) [s] in its unit, and the kind of interpolation ('' for identical stamps).

    A current or a command is held between samples, a force or a logged channel is linear, and a motion is a
    cubic spline.
    """
    t, x = signal.time, signal.values
    if len(t) >= len(at):
        first = int(np.argmin(np.abs(t - at[0])))
        own = t[first : first + len(at)]
        if len(own) == len(at) and np.abs(own - at).max() < 1e-3 * signal.step:
            return x[first : first + len(at)], ""
    if quantity == "current":
        return x[
            np.clip(np.searchsorted(t, at + 1e-9 * signal.step, side="right") - 1, 0, len(x) - 1)
        ], "held"
    if quantity in ("force", "condition"):
        return np.interp(at, t, x), "linear between its samples"
    return np.asarray(CubicSpline(t, x)(np.clip(at, t[0], t[-1]))), "a cubic spline through its samples"
