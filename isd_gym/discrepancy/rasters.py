"""Recordings whose channels have stamps of their own: what is compared, and when.

The simulation runs on one grid, and is read at each channel's own instants; nothing that was measured is resampled. Where
channels have different rates, what is compared of the faster ones is passed through a low-pass, model and data alike, and
taken as often as the slowest comes. Stamps of another clock are late by a lag, a nuisance of every record (`align`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.signal import welch
from scipy.sparse import csr_matrix

from ..data import Table, check
from ..data.quality import Scale, admit
from ..errors import InputError
from ..loggers.grid import sampled
from ..loggers.recording import Recording, Signal
from ..units import convert
from .between import through
from .problem import Array, Problem, Record, pace

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from ..network import Network

#: a channel that comes so much more often than the slowest is filtered, not picked from
PICKED = 0.7
#: of the low-pass: its cut-off in Nyquist frequencies of the comparison, half its length over its cut-off
CUTOFF, HALF = 0.85, 3.5
LEAST = 64  # compared samples


@dataclass(frozen=True)
class Reading:
    """How simulated outputs on a record's grid become what is compared: a matrix (compared, grid) a channel.

    `filtered`: whether a low-pass is in one of them.
    """

    matrices: tuple[Any, ...]
    filtered: bool

    def __call__(self, out: Array) -> Array:
        """Outputs (grid, channels, lanes) -> (compared, channels, lanes)."""
        return np.stack([m @ out[:, j] for j, m in enumerate(self.matrices)], axis=1)

    def part(self, first: int, stop: int, cut: slice) -> Reading:
        """That of compared samples first..stop-1, over the grid's samples `cut`."""
        return Reading(tuple(m[first:stop, cut] for m in self.matrices), self.filtered)


def reference(recording: Recording, network: Network) -> str:
    """The clock by which a run is told: that of its inputs. Raises `InputError` where they have several of unknown lag."""
    clocks = list(dict.fromkeys(recording.signals[c.name].clock for c in network.inputs))
    unknown = [c for c in clocks if c not in recording.lags]
    if len(unknown) > 1 or (unknown and len(clocks) > len(unknown)):
        own = {c.name: recording.signals[c.name].clock for c in network.inputs}
        told = ", ".join(f"{n} on {k}" for n, k in own.items())
        raise InputError(
            f"{recording.name}: the inputs come from loggers with clocks of their own ({told}): a lag between inputs cannot be "
            'fitted; tell each of these loggers\' "lag" in the map'
        )
    if clocks:
        return clocks[0]
    every = [recording.signals[c.name].clock for c in network.outputs]
    return max(dict.fromkeys(every), key=every.count)


def gate(
    recording: Recording, network: Network, accepted: Sequence[str], notes: list[str], scale: Scale
) -> None:
    """The data gate for every raster by itself, at the rig's own `scale`. Raises `InputError`."""
    kinds: dict[str, dict[str, str]] = {
        "inputs": {c.name: c.spoken for c in network.inputs},
        "outputs": {c.name: c.spoken for c in network.outputs},
    }
    groups: list[tuple[Signal, list[str]]] = []
    for name, s in recording.signals.items():
        for first, names in groups:
            if first.clock == s.clock and np.array_equal(first.time, s.time):
                names.append(name)
                break
        else:
            groups.append((s, [name]))
    for first, names in groups:
        even = np.linspace(first.time[0], first.time[-1], len(first.time))
        stray = float(np.abs(first.time - even).max()) / (even[1] - even[0])
        if stray > 0.1:
            notes.append(
                f"{recording.name}: the stamps of {', '.join(names)} stray by {stray:.2g} of a step: compared at their own instants"
            )
        table = Table(
            even,
            {n: recording.signals[n].values for n in names},
            recording.name,
            {n: recording.signals[n].unit for n in names},
        )
        own = {side: {n: q for n, q in of.items() if n in names} for side, of in kinds.items()}
        found = check(table, inputs=own["inputs"], outputs=own["outputs"], scale=scale)
        admit(table, found, notes, accepted)


def record_of(
    recording: Recording,
    network: Network,
    lags: Mapping[str, float] | None = None,
    notes: list[str] | None = None,
    *,
    thin: int | None = None,
    cutoff: float | None = None,
) -> Record:
    """A record whose outputs are compared at their own instants.

    lags: clock -> how late its stamps are [s], for the clocks whose lag is not known; `thin` and `cutoff` [Hz]: what is
    compared of all channels is filtered below `cutoff` and taken at every `thin`-th sample of the grid.
    """
    notes = [] if notes is None else notes
    own = reference(recording, network)
    late = {**dict.fromkeys(recording.clocks, 0.0), **(lags or {}), **recording.lags}
    origin = late[own] if own in recording.lags else 0.0
    at = {n: s.time - (late[s.clock] - origin) for n, s in recording.signals.items()}
    outputs, inputs = [[c.name for c in side] for side in (network.outputs, network.inputs)]
    steps = {n: recording.signals[n].step for n in at}
    slow = max(steps[n] for n in outputs)
    base = min(inputs or outputs, key=lambda n: steps[n])
    fine = min(min(steps.values()), slow)
    count = max(1, round(slow / fine))
    step = slow / count
    own_grid = base in inputs and abs(steps[base] * count / slow - 1) < 0.01
    if own_grid:
        step = steps[base]
    every = count if thin is None else max(count, thin)
    rate = every * step
    width = {n: HALF / (cutoff or 0.5 * CUTOFF / rate) for n in outputs if cutoff or steps[n] < PICKED * rate}
    reach = max([width.get(n, 0.6 * steps[n]) for n in outputs]) + 3 * step
    margin = math.ceil(reach / rate)
    start = max(float(t[0]) for t in at.values())
    stop = min(float(t[-1]) for t in at.values())
    if own_grid:  # the inputs as they were logged
        t = at[base]
        start = float(t[np.searchsorted(t, start - 1e-3 * step)])
    size = int((stop - start) / rate + 1e-6) - 2 * margin + 1
    if size < LEAST:
        raise InputError(f"{recording.name}: its channels have only {max(stop - start, 0.0):.4g} s in common")
    grid = start + step * np.arange((size - 1 + 2 * margin) * every + 1)
    driven: dict[str, Array] = {}
    for c in network.inputs:
        s = recording.signals[c.name]
        moved = Signal(at[c.name], s.values, s.unit, s.clock, s.column)
        x, how = sampled(moved, grid, c.quantity)
        driven[c.name] = convert(x, s.unit, c.si)
        if how:
            told = f"{recording.name}: input {c.name}, logged at {1 / s.step:.5g} Hz, is taken at {1 / step:.5g} Hz: {how}"
            if told not in notes:
                notes.append(told)
    instants = start + rate * (margin + np.arange(size))
    matrices, measured = [], []
    for c in network.outputs:
        s = recording.signals[c.name]
        pick = _taken(at[c.name], instants, width.get(c.name))
        used = np.unique(pick.indices)
        matrices.append((pick[:, used] @ _between(at[c.name][used], start, step, len(grid))).tocsr())
        measured.append(pick @ convert(s.values, s.unit, c.unit))
    for n in width:
        told = f"{recording.name}: {n}, logged at {1 / steps[n]:.5g} Hz, is compared at {1 / rate:.5g} Hz behind a low-pass that the model passes, too"
        if cutoff is None and told not in notes:
            notes.append(told)
    free = tuple(k for k in recording.clocks if k != own and k not in recording.lags)
    return Record(
        Path(recording.name).name,
        step,
        driven,
        np.stack(measured, axis=1),
        {},
        start,
        thin=every,
        margin=margin,
        reading=Reading(tuple(matrices), bool(width)),
        clocks=free,
        late=tuple(np.array([recording.signals[n].clock == k for n in outputs]) for k in free),
        lags={k: late[k] for k in free},
        size=len(grid),
        source=recording,
    )


def _taken(time: np.ndarray, at: np.ndarray, half: float | None) -> Any:
    """Matrix (compared, samples) that takes the nearest sample, or a low-pass of `half` [s] to either side, at the instants `at`."""
    n = len(time)
    if half is None:
        near = np.clip(np.searchsorted(time, at), 1, n - 1)
        near = near - (at - time[near - 1] < time[near] - at)
        return csr_matrix((np.ones(len(at)), near, np.arange(len(at) + 1)), shape=(len(at), n))
    first = np.searchsorted(time, at - half)
    most = int((np.searchsorted(time, at + half) - first).max())
    index = np.minimum(first[:, None] + np.arange(most), n - 1)
    x = (time[index] - at[:, None]) / half
    fresh = np.arange(most)[None, :] + first[:, None] < n
    weight = (
        np.sinc(2 * HALF * x) * np.i0(6.0 * np.sqrt(np.clip(1 - x**2, 0, None))) * (np.abs(x) < 1) * fresh
    )
    weight /= weight.sum(axis=1, keepdims=True)
    rows = np.repeat(np.arange(len(at)), most)
    made = csr_matrix((weight.ravel(), (rows, index.ravel())), shape=(len(at), n))
    made.eliminate_zeros()
    return made


def _between(time: Array, start: float, step: float, size: int) -> Any:
    """Matrix (instants, grid) of the cubic through four neighbours on the grid."""
    place = (time - start) / step
    first = np.clip(np.floor(place).astype(int) - 1, 0, size - 4)
    u = place - first
    nodes = np.arange(4.0)
    weight = np.ones((len(time), 4))
    for k in range(4):
        for m in range(4):
            if m != k:
                weight[:, k] *= (u - nodes[m]) / (nodes[k] - nodes[m])
    weight[np.abs(weight) < 1e-7] = 0.0
    made = csr_matrix(
        (weight.ravel(), (first[:, None] + np.arange(4)).ravel(), 4 * np.arange(len(time) + 1)),
        shape=(len(time), size),
    )
    made.eliminate_zeros()
    return made


FINER = 4  # times the grid, to see motion between its samples
FEW = 8.0  # samples in a period of the middle of the motion: below that it is looked at
EDGE = 0.9  # share of a channel's power below the frequency that its motion reaches


def fast_enough(record: Record, network: Network) -> None:
    """Raise `InputError` where a channel comes less than twice in a period of its motion, as the model has it for these inputs."""
    own = {
        c.name: record.source.signals[c.name].step if record.source is not None else record.step
        for c in network.outputs
    }
    middle = [
        1.0 / (2 * math.pi * pace(record.measured[:, j], record.rate)) for j in range(len(network.outputs))
    ]
    slow = [
        j
        for j, c in enumerate(network.outputs)
        if own[c.name] > 1.9 * record.step or own[c.name] * middle[j] * FEW > 1.0
    ]
    if not slow or not network.inputs:
        return
    held = {c.name for c in network.inputs if c.quantity == "current"}
    inputs = {
        n: np.repeat(x, FINER)[: FINER * (len(x) - 1) + 1] if n in held else through(x, FINER)
        for n, x in record.inputs.items()
    }
    fine = replace(record.unread(), step=record.step / FINER, inputs=inputs, slopes={}, size=0)
    try:
        said = Problem(network, [fine], ["fit"]).simulate([network], 0)[:, :, 0]
    except (InputError, np.linalg.LinAlgError):
        return
    for j in slow:
        c, y = network.outputs[j], said[:, j]
        if not np.isfinite(y).all() or not y.std() > 0:
            continue
        f, s = welch(y - y.mean(), 1 / fine.step, nperseg=min(len(y), 4096 * FINER))
        total = np.cumsum(s)
        edge = float(np.interp(EDGE * total[-1], total, f))
        if 2.0 * edge * own[c.name] > 1.0:
            raise InputError(
                f"{record.name}: {c.name} is logged at {1 / own[c.name]:.4g} Hz, below twice the motion, which reaches {edge:.3g} Hz: "
                "log it faster, or leave it out of the --map or of the model's outputs"
            )
