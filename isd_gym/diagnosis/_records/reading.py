"""Reading of measured records: data checks and conversion of units."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..._common.errors import InputError, MissingColumn
from ..._common.units import HELD, convert
from ...physics.network import Channel, Network, own_time, slowest_time, without
from ...physics.simulate import COARSE
from ...records.data import Table, check, read_table
from ...records.data._quality import CAR, Scale, admit, known_check, rises_unevenly
from ...records.loggers.recording import Recording, Signal
from .._simulation.problem import BROKEN, Record, simulate_from_rest, thinned
from .filtering import count_derivatives
from .resampling import build_record, check_recording

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from ..._common.arrays import Array

#: number of samples of a record above which samples are left out, as far as the others resolve the motion
LONG = 100_000
LEAST_SAMPLES = 32  # least number of samples of a record from which the scale of the outputs is estimated


def read_record(
    source: Table | Recording | str | Path,
    network: Network,
    notes: list[str],
    accept: Sequence[str] = (),
) -> Record:
    """Return a measured record in SI units (inputs) and units of the channels (outputs) after the data checks; those in `accept` (or
    'all') only warn."""
    for name in accept:
        known_check(name)
    if isinstance(source, Recording):
        notes += source.notes
        table = source.table()
        if table is None:  # channels with different time stamps
            return _read_recording(source, network, notes, accept)
    else:
        expected = {c.name: c.unit for c in (*network.inputs, *network.outputs)}
        table = (
            source
            if isinstance(source, Table)
            else read_table(source, expected=expected)
        )
    channels = (*network.inputs, *network.outputs)
    for c in channels:
        try:
            table[c.name]
        except MissingColumn as error:
            raise InputError(f"{error}{without(network, c.name)}") from None
    if rises_unevenly(table.time):
        signals = {
            c.name: Signal(
                table.time,
                table[c.name],
                table.units.get(c.name) or c.unit,
                "time",
                c.name,
            )
            for c in channels
        }
        return _read_recording(Recording(table.source, signals), network, notes, accept)
    findings = check(
        table,
        inputs={c.name: c.spoken for c in network.inputs},
        outputs={c.name: c.spoken for c in network.outputs},
        scale=_estimate_scale(network, lambda: _convert_table(table, network)),
    )
    admit(table, findings, notes, accept)
    return _convert_table(table.uniform(), network)


def thin_long_record(record: Record, network: Network, notes: list[str]) -> Record:
    """Return a record of at most `LONG` samples, or as few as resolve the motion, behind a low-pass; shorter records stay as they are."""
    if record.samples <= LONG or record.source is not None:
        return record
    by = min(math.ceil(record.samples / LONG), int(COARSE * record.pace / record.step))
    if by < 2:
        return record
    notes.append(
        f"{record.name}: {record.samples} samples are more than the motion needs: every {by}th sample is compared "
        f"({1.0 / (record.step * by):.4g} Hz), inputs are low-pass filtered"
    )
    return thinned(record, by, {c.name for c in network.inputs if c.quantity in HELD})


def _read_recording(
    recording: Recording, network: Network, notes: list[str], accept: Sequence[str]
) -> Record:
    """Return a record resampled onto a uniform grid, after the data checks."""
    scale = _estimate_scale(network, lambda: build_record(recording, network))
    check_recording(recording, network, accept, notes, scale)
    return build_record(recording, network, notes)


def _convert_table(table: Table, network: Network) -> Record:
    """Return the record of a uniformly sampled table, in the units of the model."""

    def values(c: Channel, unit: str) -> Array:
        return convert(
            np.asarray(table[c.name]), table.units.get(c.name) or c.unit, unit
        )

    inputs = {c.name: values(c, c.si) for c in network.inputs}
    measured = np.stack([values(c, c.unit) for c in network.outputs], axis=1)
    return Record(
        Path(table.source).stem, table.step, inputs, measured, {}, float(table.time[0])
    )


def _estimate_scale(network: Network, read: Callable[[], Record]) -> Scale:
    """Return the time scale of the rig and, where a simulation from rest tells them, the standard deviations of the outputs."""
    time, slowest = own_time(network), slowest_time(network)
    scale = Scale(
        time or CAR,
        slowest=slowest or math.nan,
        period=2.0 * math.pi * time if time else math.inf,
    )
    if not network.inputs or 2 in count_derivatives(network).values():
        return scale
    try:
        raw = read().unread()
        is_sound = raw.step > 0 and all(
            np.isfinite(x).all() for x in (*raw.inputs.values(), raw.measured)
        )
        if not is_sound or raw.samples < LEAST_SAMPLES:
            return scale
        outputs = simulate_from_rest(network, raw)
    except BROKEN:
        return scale
    if outputs is None:
        return scale
    spread = {
        c.name: float(convert(y[raw.samples // 2 :].std(), c.unit, c.si))
        for c, y in zip(network.outputs, outputs.T, strict=True)
    }
    return replace(scale, spread={n: s for n, s in spread.items() if s > 0})
