"""Inputs on a uniform grid, with a stated interpolation between different time stamps."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.interpolate import CubicSpline

from ..._common.errors import InputError
from .recording import Recording, Signal, even

if TYPE_CHECKING:
    from collections.abc import Sequence

    from ...physics.network import Channel


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


def inputs_of(
    recording: Recording, channels: Sequence[Channel], notes: list[str], step: float | None = None
) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Return time (n,) [s] and inputs (n,) [SI] of a model on a common grid; `notes` are extended by the interpolations.

    The grid has the `step` [s], or the stamps of the finest input.
    """
    own = [recording.signals[c.name] for c in channels]
    if not own:
        raise InputError(f"{recording.name}: no inputs to simulate for")
    base = min(own, key=lambda s: s.step)
    start, stop = max(s.time[0] for s in own), min(s.time[-1] for s in own)
    if step is None and even(base.time):
        keep = base.time[(base.time >= start - 1e-9) & (base.time <= stop + 1e-9)]
        time = keep[0] + base.step * np.arange(len(keep))
    else:
        step = step or base.step
        time = start + step * np.arange(int((stop - start) / step + 1e-9) + 1)
    out = {}
    for c, s in zip(channels, own, strict=True):
        out[c.name], how = sampled(s, time, c.quantity)
        if how:
            told = f"{recording.name}: input {c.name}, logged at {1 / s.step:.5g} Hz, is taken at {1 / (time[1] - time[0]):.5g} Hz: {how}"
            if told not in notes:
                notes.append(told)
    return time, out
