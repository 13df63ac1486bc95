"""Records of channels with different time stamps, resampled onto one uniform grid.

Inputs are interpolated on the grid of the simulation. Outputs are interpolated there too (cubic spline) and compared at the rate of the
slowest output. Where outputs have different rates, all outputs pass a low-pass, model and data alike.
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from scipy.signal import firwin, welch

from ..._common.errors import InputError
from ..._common.units import HELD, convert
from ...physics.simulate import pace
from ...records.data import Table, check
from ...records.data._quality import Scale, admit
from ...records.loggers.recording import Recording, Signal, sampled
from .._simulation.interpolation import interpolated
from .._simulation.problem import Record, low_pass, simulate_from_rest

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from ..._common.arrays import Array
    from ...physics.network import Network

#: Cutoff of the low-pass as a share of the Nyquist frequency of the compared samples; the roll-off takes the rest.
CUTOFF = 0.85
LEAST = 64  # least number of compared samples of a recording
FINER = 4  # refinement of the grid on which the bandwidth of the simulated motion is estimated
FEW = 8.0  # samples per period of the middle frequency of the motion below which the sampling rate is checked
EDGE = 0.9  # share of a channel's power below the frequency that counts as the upper end of the motion
#: Deviation of a sampling interval from the grid interval, as a share, below which the grid is that of an input.
ALIKE = 0.01


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
                "outputs are interpolated on a uniform grid"
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
    notes: list[str] | None = None,
    *,
    thin: int = 1,
    passes: int = 1,
) -> Record:
    """Return a recording resampled onto a uniform grid.

    Args:
        recording: Recording. Stamps of a clock are late by the lag in `recording.lags`, or zero.
        network: Model with the channels of the record.
        notes: List that receives a line per resampled channel.
        thin: Every `thin`-th sample of the grid is compared, behind a low-pass; fewer where an output is slower.
        passes: Number of passes of the low-pass: 2 where inputs pass the low-pass, too.

    Returns:
        The record. Its outputs pass a low-pass where outputs have different rates, or `thin` is above 1.

    Raises:
        InputError: The channels have too little time in common, or inputs come from clocks with an unknown lag.
    """
    find_reference_clock(recording, network)  # raises for an unknown lag of inputs
    signals = {}
    for c in (*network.inputs, *network.outputs):
        s = recording.signals[c.name]
        signals[c.name] = replace(s, time=s.time - recording.lags.get(s.clock, 0.0))
    slowest = max(signals[c.name].step for c in network.outputs)
    grid, count = _choose_grid(recording.name, signals, network)
    step = float(grid[1] - grid[0])
    told = []
    inputs: dict[str, Array] = {}
    for c in network.inputs:
        s = signals[c.name]
        values, how = sampled(s, grid, c.quantity)
        inputs[c.name] = convert(values, s.unit, c.si)
        if how:
            told.append(
                f"input {c.name}, logged at {1 / s.step:.5g} Hz, is taken at {1 / step:.5g} Hz: {how}"
            )
    measured = []
    for c in network.outputs:
        s = signals[c.name]
        values, _ = sampled(s, grid, "displacement")
        measured.append(convert(values, s.unit, c.unit))
        if round(slowest / s.step) > 1:
            thin = max(thin, count)
            told.append(
                f"output {c.name}, logged at {1 / s.step:.5g} Hz, is compared at {1 / (count * step):.5g} Hz behind a low-pass that the model passes, too"
            )
    if notes is not None:
        notes += [f"{recording.name}: {line}" for line in told]
    record = Record(
        Path(recording.name).name,
        step,
        inputs,
        np.stack(measured, axis=1),
        start=float(grid[0]),
        source=recording,
    )
    if thin > 1:
        return compare_behind_low_pass(record, max(count, thin), passes)
    return replace(record, measured=record.measured[::count], thin=count)


def find_reference_clock(recording: Recording, network: Network) -> str:
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
    name: str, signals: Mapping[str, Signal], network: Network
) -> tuple[Array, int]:
    """Return the instants of the grid [s], at the fastest rate, and the number of its intervals per sample of the slowest output."""
    slowest = max((signals[c.name] for c in network.outputs), key=lambda s: s.step)
    count = max(1, round(slowest.step / min(s.step for s in signals.values())))
    base, step = slowest, slowest.step / count
    for c in network.inputs:
        if abs(signals[c.name].step / step - 1) < ALIKE:
            base, step = signals[c.name], signals[c.name].step
            break
    start, stop = Recording(name, signals).together()
    if stop - start < LEAST * count * step:
        raise InputError(
            f"{name}: its channels have only {max(stop - start, 0.0):.4g} s in common"
        )
    first = slowest.time[np.searchsorted(slowest.time, start)]
    first = base.time[np.searchsorted(base.time, first - 1e-3 * step)]
    size = count * int((stop - first) / (count * step) + 1e-6) + 1
    return first + step * np.arange(size), count


def compare_behind_low_pass(record: Record, thin: int, passes: int) -> Record:
    """Return an unfiltered record of which every `thin`-th sample is compared, behind a low-pass; near the ends, where `passes` of the
    low-pass extrapolate, nothing is compared."""
    half = min(math.ceil(8.0 * thin / CUTOFF), record.samples // 8)
    taps = firwin(2 * half + 1, CUTOFF / thin, window=("kaiser", 6.0))
    margin = min(math.ceil(passes * (half + 0.5) / thin), record.samples // (8 * thin))
    kept = slice(margin * thin, record.samples - margin * thin, thin)
    measured = low_pass(record.measured, taps)[kept]
    return replace(record, measured=measured, taps=taps, margin=margin, thin=thin)


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
    fine = replace(record.unread(), step=step, inputs=inputs, slopes={})
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
