"""Records of channels with different time stamps.

The simulation runs on one grid. Simulated outputs are interpolated at the instants of each channel, and measured values are
not resampled. Faster channels pass a low-pass, model and data alike, and are compared at the rate of the slowest
channel. Stamps of another clock are late by an unknown lag (`clock_lag`).
"""

from __future__ import annotations

import itertools
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
from .._simulation.interpolation import OutputSampler, interpolated
from .._simulation.problem import Record, simulate_from_rest

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

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
    groups: dict[tuple[str, bytes], dict[str, Signal]] = {}
    for name, s in recording.signals.items():
        groups.setdefault((s.clock, s.time.tobytes()), {})[name] = s
    for signals in groups.values():
        time = next(iter(signals.values())).time
        even = np.linspace(time[0], time[-1], len(time))
        stray = float(np.abs(time - even).max()) / (even[1] - even[0])
        if stray > 0.1:
            notes.append(
                f"{recording.name}: time stamps of {', '.join(signals)} deviate from even spacing by {stray:.2g} intervals; "
                "outputs are compared at their own instants"
            )
        columns = {n: s.values for n, s in signals.items()}
        units = {n: s.unit for n, s in signals.items()}
        table = Table(even, columns, recording.name, units)
        inputs = {c.name: c.spoken for c in network.inputs if c.name in signals}
        outputs = {c.name: c.spoken for c in network.outputs if c.name in signals}
        findings = check(table, inputs=inputs, outputs=outputs, scale=scale)
        admit(table, findings, notes, accepted)


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
    clock = _find_reference_clock(recording, network)
    late = {**dict.fromkeys(recording.clocks, 0.0), **(lags or {}), **recording.lags}
    origin = late[clock] if clock in recording.lags else 0.0
    signals = {
        n: replace(s, time=s.time - (late[s.clock] - origin))
        for n, s in recording.signals.items()
    }
    grid, halves = _choose_grid(recording.name, signals, network, thin, cutoff)
    rate = 1.0 / (grid.every * grid.step)
    told = []
    inputs: dict[str, Array] = {}
    for c in network.inputs:
        s = signals[c.name]
        values, how = sampled(s, grid.time, c.quantity)
        inputs[c.name] = convert(values, s.unit, c.si)
        if how:
            told.append(
                f"input {c.name}, logged at {1 / s.step:.5g} Hz, is taken at {1 / grid.step:.5g} Hz: {how}"
            )
    matrices, measured = [], []
    for c in network.outputs:
        s, half = signals[c.name], halves.get(c.name)
        if half is None:
            pick = _pick_nearest(s.time, grid.instants)
        else:
            pick = _pass_low(s.time, grid.instants, half)
        used = np.unique(pick.indices)
        matrices.append((pick[:, used] @ _interpolate(s.time[used], grid)).tocsr())
        measured.append(pick @ convert(s.values, s.unit, c.unit))
        if half is not None and cutoff is None:
            told.append(
                f"output {c.name}, logged at {1 / s.step:.5g} Hz, is compared at {rate:.5g} Hz behind a low-pass that the model passes, too"
            )
    if notes is not None:
        notes += [f"{recording.name}: {line}" for line in told]
    free = tuple(k for k in recording.clocks if k != clock and k not in recording.lags)
    clocks = np.array([signals[c.name].clock for c in network.outputs])
    return Record(
        Path(recording.name).name,
        grid.step,
        inputs,
        np.stack(measured, axis=1),
        start=grid.start,
        thin=grid.every,
        margin=grid.margin,
        reading=OutputSampler(tuple(matrices), bool(halves)),
        clocks=free,
        late=tuple(clocks == k for k in free),
        lags={k: late[k] for k in free},
        size=len(grid.time),
        source=recording,
    )


def _find_reference_clock(recording: Recording, network: Network) -> str:
    """Return the clock of the inputs; without inputs the clock of most outputs."""
    clock_of = {c.name: recording.signals[c.name].clock for c in network.inputs}
    clocks = dict.fromkeys(clock_of.values())
    if len(clocks) > 1 and not recording.lags.keys() >= clocks.keys():
        told = ", ".join(f"{name} on {clock}" for name, clock in clock_of.items())
        raise InputError(
            f"{recording.name}: the inputs come from loggers with different clocks ({told}). A lag between inputs cannot be "
            'fitted: state the lag of each logger as "lag" in the map'
        )
    if clocks:
        return next(iter(clocks))
    every = [recording.signals[c.name].clock for c in network.outputs]
    return max(dict.fromkeys(every), key=every.count)


def _choose_grid(
    name: str,
    signals: Mapping[str, Signal],
    network: Network,
    thin: int,
    cutoff: float | None,
) -> tuple[_Grid, dict[str, float]]:
    """Return the grid of a recording, and half the length [s] of the low-pass by filtered output."""
    steps = {n: s.step for n, s in signals.items()}
    outputs = [c.name for c in network.outputs]
    slow = max(steps[n] for n in outputs)
    count = max(1, round(slow / min(steps.values())))
    step = slow / count
    start = max(float(s.time[0]) for s in signals.values())
    stop = min(float(s.time[-1]) for s in signals.values())
    base = min((c.name for c in network.inputs), key=lambda n: steps[n], default="")
    if base and abs(steps[base] / step - 1) < 0.01:  # the grid is that of an input
        step = steps[base]
        stamps = signals[base].time
        start = float(stamps[np.searchsorted(stamps, start - 1e-3 * step)])
    every = max(count, thin)
    rate = every * step
    reach, halves = 0.0, {}
    for n in outputs:
        if cutoff or steps[n] < PICKED * rate:
            halves[n] = HALF / (cutoff or 0.5 * CUTOFF / rate)
        reach = max(reach, halves.get(n, 0.6 * steps[n]))
    margin = math.ceil((reach + 3 * step) / rate)
    size = int((stop - start) / rate + 1e-6) - 2 * margin + 1
    if size < LEAST:
        raise InputError(
            f"{name}: its channels have only {max(stop - start, 0.0):.4g} s in common"
        )
    return _Grid(start, step, every, margin, size), halves


def _pick_nearest(time: Array, instants: Array) -> Any:
    """Return the matrix (instants, samples) of the nearest sample."""
    near = np.clip(np.searchsorted(time, instants), 1, len(time) - 1)
    near = near - (instants - time[near - 1] < time[near] - instants)
    return _matrix(np.ones((len(near), 1)), near[:, None], len(time))


def _pass_low(time: Array, instants: Array, half: float) -> Any:
    """Return the matrix (instants, samples) of a low-pass of `half` [s] to either side."""
    first = np.searchsorted(time, instants - half)
    count = int((np.searchsorted(time, instants + half) - first).max())
    index = first[:, None] + np.arange(count)
    is_inside = index < len(time)
    index = np.minimum(index, len(time) - 1)
    x = (time[index] - instants[:, None]) / half
    kaiser = np.i0(6.0 * np.sqrt(np.clip(1 - x**2, 0, None)))
    weight = np.sinc(2 * HALF * x) * kaiser * (np.abs(x) < 1) * is_inside
    return _matrix(weight / weight.sum(axis=1, keepdims=True), index, len(time))


def _interpolate(time: Array, grid: _Grid) -> Any:
    """Return the matrix (instants, grid) of cubic interpolation through four neighbours on the grid."""
    place = (time - grid.start) / grid.step
    first = np.clip(np.floor(place).astype(int) - 1, 0, len(grid.time) - 4)
    u = place - first
    weight = np.ones((len(time), 4))
    for k, m in itertools.permutations(range(4), 2):
        weight[:, k] *= (u - m) / (k - m)
    weight[np.abs(weight) < 1e-7] = 0.0
    return _matrix(weight, first[:, None] + np.arange(4), len(grid.time))


def _matrix(weight: Array, column: NDArray[np.int_], width: int) -> Any:
    """Return the sparse matrix with weights (rows, count) in columns (rows, count)."""
    rows, count = weight.shape
    ends = count * np.arange(rows + 1)
    made = csr_matrix((weight.ravel(), column.ravel(), ends), shape=(rows, width))
    made.eliminate_zeros()
    return made


def check_sampling_rates(record: Record, network: Network) -> None:
    """Refuse records with an output sampled below twice the bandwidth of its motion, simulated with the nominal model."""
    steps = np.full(len(network.outputs), record.step)
    if record.source is not None:
        steps[:] = [record.source.signals[c.name].step for c in network.outputs]
    paces = np.array([pace(y, record.interval) for y in record.measured.T])
    is_slow = (steps > 1.9 * record.step) | (steps * FEW > 2 * math.pi * paces)
    if not is_slow.any() or not network.inputs:
        return
    inputs = {
        c.name: interpolated(
            record.inputs[c.name],
            FINER,
            record.step,
            held=c.quantity in HELD,
            sparse=True,
        )
        for c in network.inputs
    }
    step = record.step / FINER
    fine = replace(record.unread(), step=step, inputs=inputs, slopes={}, size=0)
    simulated = simulate_from_rest(network, fine)
    if simulated is None:
        return
    for j in np.flatnonzero(is_slow):
        y = simulated[:, j]
        if not y.std() > 0:
            continue
        f, density = welch(y - y.mean(), 1 / step, nperseg=min(len(y), 4096 * FINER))
        total = np.cumsum(density)
        edge = float(np.interp(EDGE * total[-1], total, f))
        if 2.0 * edge * steps[j] > 1.0:
            raise InputError(
                f"{record.name}: {network.outputs[j].name} is logged at {1 / steps[j]:.4g} Hz, below twice the motion's "
                f"bandwidth of {edge:.3g} Hz. Log it faster, or leave it out of the --map or of the model's outputs"
            )
