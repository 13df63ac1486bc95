"""Records of channels with different time stamps.

The simulation runs on one grid. Simulated outputs are interpolated at the instants of each channel, and measured values are
not resampled. Faster channels pass a low-pass, model and data alike, and are compared at the rate of the slowest
channel. Stamps of another clock are late by an unknown lag (`clock_lag`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.signal import welch
from scipy.sparse import csr_matrix

from ..._common.errors import InputError
from ..._common.units import HELD, convert
from ...physics.simulate import pace
from ...records.data import Table, check
from ...records.data._quality import Scale, admit
from ...records.loggers.recording import Recording, Signal, sampled
from .._simulation.interpolation import OutputSampler, through
from .._simulation.problem import Record, simulate_from_rest

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from ..._common.arrays import Array
    from ...physics.network import Network

#: Ratio of sampling intervals (channel to comparison) below which a channel is low-passed instead of picked from.
PICKED = 0.7
CUTOFF = (
    0.85  # cutoff of the low-pass as a share of the Nyquist frequency of the comparison
)
HALF = 3.5  # half the length of the low-pass, as a multiple of one over its cutoff
LEAST = 64  # least number of compared samples
FINER = 4  # refinement of the grid on which the bandwidth of the simulated motion is estimated
FEW = 8.0  # samples per period of the middle frequency of the motion below which the sampling rate is checked
EDGE = 0.9  # share of a channel's power below the frequency that counts as the upper end of the motion


@dataclass(frozen=True)
class _Grid:
    """Simulation grid and comparison instants of a recording."""

    start: float  # start time [s]
    step: float  # grid interval [s]
    every: int  # grid intervals per comparison interval
    margin: int  # comparison intervals at either end without compared samples
    size: int  # number of compared samples

    @property
    def time(self) -> np.ndarray:
        """Grid instants [s]."""
        return self.start + self.step * np.arange(
            (self.size - 1 + 2 * self.margin) * self.every + 1
        )

    @property
    def instants(self) -> np.ndarray:
        """Comparison instants [s]."""
        return self.start + self.every * self.step * (
            self.margin + np.arange(self.size)
        )


def check_recording(
    recording: Recording,
    network: Network,
    accepted: Sequence[str],
    notes: list[str],
    scale: Scale,
) -> None:
    """Run the data checks separately for each group of channels with common time stamps; the `accepted` checks only warn."""
    inputs = {c.name: c.spoken for c in network.inputs}
    outputs = {c.name: c.spoken for c in network.outputs}
    groups: dict[tuple[str, bytes], list[str]] = {}
    for name, s in recording.signals.items():
        groups.setdefault((s.clock, s.time.tobytes()), []).append(name)
    for names in groups.values():
        time = recording.signals[names[0]].time
        even = np.linspace(time[0], time[-1], len(time))
        stray = float(np.abs(time - even).max()) / (even[1] - even[0])
        if stray > 0.1:
            notes.append(
                f"{recording.name}: time stamps of {', '.join(names)} deviate from even spacing by {stray:.2g} intervals; "
                "outputs are compared at their own instants"
            )
        table = Table(
            even,
            {n: recording.signals[n].values for n in names},
            recording.name,
            {n: recording.signals[n].unit for n in names},
        )
        own = [
            {n: q for n, q in side.items() if n in names} for side in (inputs, outputs)
        ]
        admit(
            table,
            check(table, inputs=own[0], outputs=own[1], scale=scale),
            notes,
            accepted,
        )


def build_record(
    recording: Recording,
    network: Network,
    lags: Mapping[str, float] | None = None,
    notes: list[str] | None = None,
    *,
    thin: int = 1,
    cutoff: float | None = None,
) -> Record:
    """Return a record with outputs compared at the instants of their samples, behind a low-pass with a cutoff [Hz] or for faster outputs
    only. `lags`: delays [s] of the stamps of clocks."""
    notes = [] if notes is None else notes
    clock = _find_reference_clock(recording, network)
    late = {**dict.fromkeys(recording.clocks, 0.0), **(lags or {}), **recording.lags}
    origin = late[clock] if clock in recording.lags else 0.0
    stamps = {
        n: s.time - (late[s.clock] - origin) for n, s in recording.signals.items()
    }
    grid, halves = _choose_grid(recording, network, stamps, thin, cutoff)
    time, rate = grid.time, grid.every * grid.step
    inputs: dict[str, Array] = {}
    told = []
    for c in network.inputs:
        s = recording.signals[c.name]
        values, how = sampled(
            Signal(stamps[c.name], s.values, s.unit, s.clock, s.column),
            time,
            c.quantity,
        )
        inputs[c.name] = convert(values, s.unit, c.si)
        if how:
            told.append(
                f"input {c.name}, logged at {1 / s.step:.5g} Hz, is taken at {1 / grid.step:.5g} Hz: {how}"
            )
    matrices, measured = [], []
    for c in network.outputs:
        s = recording.signals[c.name]
        pick = _build_selection(stamps[c.name], grid.instants, halves.get(c.name))
        used = np.unique(pick.indices)
        interpolation = _build_interpolation(
            stamps[c.name][used], grid.start, grid.step, len(time)
        )
        matrices.append((pick[:, used] @ interpolation).tocsr())
        measured.append(pick @ convert(s.values, s.unit, c.unit))
    if cutoff is None:
        told += [
            f"output {n}, logged at {1 / recording.signals[n].step:.5g} Hz, is compared at {1 / rate:.5g} Hz behind a low-pass "
            "that the model passes, too"
            for n in halves
        ]
    lines = [f"{recording.name}: {line}" for line in told]
    notes += [line for line in lines if line not in notes]
    free = tuple(k for k in recording.clocks if k != clock and k not in recording.lags)
    return Record(
        Path(recording.name).name,
        grid.step,
        inputs,
        np.stack(measured, axis=1),
        {},
        grid.start,
        thin=grid.every,
        margin=grid.margin,
        reading=OutputSampler(tuple(matrices), bool(halves)),
        clocks=free,
        late=tuple(
            np.array([recording.signals[c.name].clock == k for c in network.outputs])
            for k in free
        ),
        lags={k: late[k] for k in free},
        size=len(time),
        source=recording,
    )


def _find_reference_clock(recording: Recording, network: Network) -> str:
    """Return the clock of the inputs; without inputs the clock of most outputs."""
    clocks = list(
        dict.fromkeys(recording.signals[c.name].clock for c in network.inputs)
    )
    unknown = [c for c in clocks if c not in recording.lags]
    if len(unknown) > 1 or (unknown and len(clocks) > len(unknown)):
        told = ", ".join(
            f"{c.name} on {recording.signals[c.name].clock}" for c in network.inputs
        )
        raise InputError(
            f"{recording.name}: the inputs come from loggers with different clocks ({told}). A lag between inputs cannot be "
            'fitted: state the lag of each logger as "lag" in the map'
        )
    if clocks:
        return clocks[0]
    every = [recording.signals[c.name].clock for c in network.outputs]
    return max(dict.fromkeys(every), key=every.count)


def _choose_grid(
    recording: Recording,
    network: Network,
    stamps: Mapping[str, Array],
    thin: int,
    cutoff: float | None,
) -> tuple[_Grid, dict[str, float]]:
    """Return the grid of a recording with time stamps [s] by channel, and half the length [s] of the low-pass by filtered output."""
    outputs, inputs = [
        [c.name for c in side] for side in (network.outputs, network.inputs)
    ]
    steps = {n: recording.signals[n].step for n in stamps}
    slow = max(steps[n] for n in outputs)
    base = min(inputs or outputs, key=lambda n: steps[n])
    count = max(1, round(slow / min(min(steps.values()), slow)))
    step = slow / count
    on_input = (
        base in inputs and abs(steps[base] * count / slow - 1) < 0.01
    )  # the grid is that of an input
    if on_input:
        step = steps[base]
    every = max(count, thin)
    rate = every * step
    halves = {
        n: HALF / (cutoff or 0.5 * CUTOFF / rate)
        for n in outputs
        if cutoff or steps[n] < PICKED * rate
    }
    reach = max([halves.get(n, 0.6 * steps[n]) for n in outputs]) + 3 * step
    margin = math.ceil(reach / rate)
    start = max(float(t[0]) for t in stamps.values())
    stop = min(float(t[-1]) for t in stamps.values())
    if on_input:
        t = stamps[base]
        start = float(t[np.searchsorted(t, start - 1e-3 * step)])
    size = int((stop - start) / rate + 1e-6) - 2 * margin + 1
    if size < LEAST:
        raise InputError(
            f"{recording.name}: its channels have only {max(stop - start, 0.0):.4g} s in common"
        )
    return _Grid(start, step, every, margin, size), halves


def _build_selection(time: np.ndarray, instants: np.ndarray, half: float | None) -> Any:
    """Return the matrix (instants, samples) of the nearest sample, or of a low-pass of `half` [s] to either side."""
    n = len(time)
    if half is None:
        near = np.clip(np.searchsorted(time, instants), 1, n - 1)
        near = near - (instants - time[near - 1] < time[near] - instants)
        return csr_matrix(
            (np.ones(len(instants)), near, np.arange(len(instants) + 1)),
            shape=(len(instants), n),
        )
    first = np.searchsorted(time, instants - half)
    most = int((np.searchsorted(time, instants + half) - first).max())
    index = np.minimum(first[:, None] + np.arange(most), n - 1)
    x = (time[index] - instants[:, None]) / half
    inside = np.arange(most)[None, :] + first[:, None] < n
    kaiser = np.i0(6.0 * np.sqrt(np.clip(1 - x**2, 0, None)))
    weight = np.sinc(2 * HALF * x) * kaiser * (np.abs(x) < 1) * inside
    weight /= weight.sum(axis=1, keepdims=True)
    rows = np.repeat(np.arange(len(instants)), most)
    made = csr_matrix((weight.ravel(), (rows, index.ravel())), shape=(len(instants), n))
    made.eliminate_zeros()
    return made


def _build_interpolation(time: Array, start: float, step: float, size: int) -> Any:
    """Return the matrix (instants, grid) of cubic interpolation through four neighbours on the grid."""
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
        (
            weight.ravel(),
            (first[:, None] + np.arange(4)).ravel(),
            4 * np.arange(len(time) + 1),
        ),
        shape=(len(time), size),
    )
    made.eliminate_zeros()
    return made


def check_sampling_rates(record: Record, network: Network) -> None:
    """Refuse records with an output sampled below twice the bandwidth of its motion, simulated with the nominal model."""
    signals = record.source.signals if record.source is not None else {}
    steps = [signals[c.name].step if signals else record.step for c in network.outputs]
    periods = [2 * math.pi * pace(y, record.interval) for y in record.measured.T]
    slow = [
        j
        for j, (step, period) in enumerate(zip(steps, periods, strict=True))
        if step > 1.9 * record.step or step * FEW > period
    ]
    if not slow or not network.inputs:
        return
    held = {c.name for c in network.inputs if c.quantity in HELD}
    inputs = {
        n: np.repeat(x, FINER)[: FINER * (len(x) - 1) + 1]
        if n in held
        else through(x, FINER)
        for n, x in record.inputs.items()
    }
    fine = replace(
        record.unread(), step=record.step / FINER, inputs=inputs, slopes={}, size=0
    )
    simulated = simulate_from_rest(network, fine)
    if simulated is None:
        return
    for j in slow:
        y = simulated[:, j]
        if not y.std() > 0:
            continue
        f, density = welch(
            y - y.mean(), 1 / fine.step, nperseg=min(len(y), 4096 * FINER)
        )
        total = np.cumsum(density)
        edge = float(np.interp(EDGE * total[-1], total, f))
        if 2.0 * edge * steps[j] > 1.0:
            raise InputError(
                f"{record.name}: {network.outputs[j].name} is logged at {1 / steps[j]:.4g} Hz, below twice the motion's "
                f"bandwidth of {edge:.3g} Hz. Log it faster, or leave it out of the --map or of the model's outputs"
            )
