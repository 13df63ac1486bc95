"""Inputs of a record on a common grid, and the outputs that files provide."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..._common.errors import InputError
from ..data._columns import split_header
from . import files_of
from .recording import even, rasters, sampled

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from ...physics.network import Channel, Network
    from . import ChannelMap, Recording


def outputs_of(
    path: str | Path,
    network: Network,
    by: ChannelMap | None = None,
    rename: Mapping[str, str] | None = None,
    columns: Sequence[str] | None = None,
    rate: float | None = None,
) -> list[str]:
    """Return the outputs of a model that the files or the map provide."""
    names = dict(rename or {})
    there = set(by.channels if by else ())
    if by is None:
        stamp = next((c for c, n in names.items() if n == "time"), None)
        read = [
            r
            for f in files_of(path)
            for r in rasters(f, stamp=stamp, columns=columns, rate=rate)
        ]
        found = [n for r in read for n in r.columns]
        there = {
            names.get(n, n) for full in found for n in (full, split_header(full)[0])
        }
    return [c.name for c in network.outputs if c.name in there]


def inputs_of(
    recording: Recording, channels: Sequence[Channel], notes: list[str]
) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Return time (n,) [s] and inputs (n,) [SI] of a model on a common grid; `notes` are extended by the interpolations.

    The grid has the stamps of the finest input, or its mean step.
    """
    own = [recording.signals[c.name] for c in channels]
    if not own:
        raise InputError(f"{recording.name}: no inputs to simulate for")
    base = min(own, key=lambda s: s.step)
    start = max(s.time[0] for s in own)
    stop = min(s.time[-1] for s in own)
    if even(base.time):
        keep = base.time[(base.time >= start - 1e-9) & (base.time <= stop + 1e-9)]
        time = keep[0] + base.step * np.arange(len(keep))
    else:
        time = start + base.step * np.arange(int((stop - start) / base.step + 1e-9) + 1)
    out = {}
    for c, s in zip(channels, own, strict=True):
        out[c.name], how = sampled(s, time, c.quantity)
        if how:
            told = f"{recording.name}: input {c.name}, logged at {1 / s.step:.5g} Hz, is taken at {1 / (time[1] - time[0]):.5g} Hz: {how}"
            if told not in notes:
                notes.append(told)
    return time, out
