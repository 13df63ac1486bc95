"""Records for the diagnosis: read and checked, in SI; displacements differentiated; held out and cut into stretches."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..data import Table, check, read_table
from ..data.quality import CAR, Scale, admit, known_check
from ..errors import InputError, MissingColumn
from ..loggers.recording import Recording
from ..network import Channel, Network, own_time, without
from ..units import convert
from .bandwidth import FILLED, decimation, differentiated
from .between import differences
from .problem import Array, Problem, Record, Role, low_pass
from .rasters import gate, record_of

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

#: length of the stretches in which held-out records are judged, in the rig's own time scale: some thirty periods
STRETCH = 200.0
LEAST_STRETCH = 40.0
#: how much before a stretch is simulated where laws remember and nothing else does
FORGETS = 100.0
WINDOWS = 8  # of a record in which its rest is looked for; so many stay
STILL = 4.0  # times the power of the quietest window, below which nothing moves
LEAST_SAMPLES = 32  # of a record that is simulated to see its scale


def read(
    source: Table | Recording | str | Path, network: Network, notes: list[str], accept: Sequence[str] = ()
) -> Record:
    """A checked record, inputs in SI, outputs in the channels' units. Raises `InputError` where it cannot be used.

    accept: names of checks (or 'all') whose errors are only warnings here.
    """
    for name in accept:
        known_check(name)
    expected = {c.name: c.unit for c in (*network.inputs, *network.outputs)}
    if isinstance(source, Recording):
        recording = source
        notes += recording.notes
        made = source.table()
        if made is None:
            gate(recording, network, accept, notes, _scale(network, lambda: record_of(recording, network)))
            return record_of(source, network, None, notes)
        source = made
    table = source if isinstance(source, Table) else read_table(source, expected=expected)
    for name in expected:
        try:
            table[name]  # raises with the nearest name
        except MissingColumn as error:
            raise InputError(f"{error}{without(network, name)}") from None
    findings = check(
        table,
        inputs={c.name: c.spoken for c in network.inputs},
        outputs={c.name: c.spoken for c in network.outputs},
        scale=_scale(network, lambda: _record(table, network)),
    )
    admit(table, findings, notes, accept)
    return _record(table.uniform(), network)


def _record(table: Table, network: Network) -> Record:
    def values(c: Channel, unit: str) -> Array:
        return convert(np.asarray(table[c.name]), table.units.get(c.name) or c.unit, unit)

    inputs = {c.name: values(c, c.si) for c in network.inputs}
    measured = np.stack([values(c, c.unit) for c in network.outputs], axis=1)
    return Record(Path(table.source).stem, table.step, inputs, measured, {}, float(table.time[0]))


def _scale(network: Network, read: Callable[[], Record]) -> Scale:
    """The rig's own time, and how large the model's outputs are from rest over the inputs of a record that may be anything yet.

    Where a moved node's noise would be differentiated twice that tells nothing, nor where there is no input.
    """
    own = Scale(own_time(network) or CAR)
    if not network.inputs or 2 in differentiated(network).values():
        return own
    try:
        raw = read().unread()
        sound = raw.step > 0 and all(np.isfinite(x).all() for x in (*raw.inputs.values(), raw.measured))
        if not sound or raw.samples < LEAST_SAMPLES:
            return own
        still = {c.name: raw.inputs[c.name][0] * (c.quantity == "displacement") for c in network.inputs}
        begun = replace(raw, inputs={n: x - still[n] for n, x in raw.inputs.items()})
        problem = Problem(network, [begun], ["fit"])
        said = problem.simulate([network], 0)[begun.samples // 2 :, :, 0] / problem.factors
    except (InputError, np.linalg.LinAlgError):
        return own
    spread = dict(zip(problem.channels, map(float, said.std(axis=0)), strict=True))
    return replace(own, spread={n: s for n, s in spread.items() if math.isfinite(s) and s > 0})


def derivatives(records: list[Record], network: Network) -> list[Record]:
    """Return the records with the derivatives of noisy inputs that move a node, where forces need them.

    Model and data pass one and the same low-pass then, in all records, so that filtering does not bias. The low-pass keeps
    every frequency at which an output holds a signal (`bandwidth.signal_band`).
    """
    orders = differentiated(network)
    step = records[0].step
    if not orders or any(abs(r.step - step) > 1e-3 * step for r in records):
        return records
    needs = [c for c in network.moving if c.name in orders]
    # what is compared is sampled so that next to nothing but the pass band is left
    thin = decimation(records, network)
    if thin < 2:
        return records
    cutoff = FILLED * 0.5 / (step * thin)
    from scipy.signal import firwin

    size = min(2 * math.ceil(4.0 / (cutoff * step)) + 1, 2 * (min(r.samples for r in records) // 8) + 1)
    taps = firwin(size, cutoff, fs=1 / step, window=("kaiser", 6.0))
    # derivative and comparison each pass the filter, which has to guess what was before and after the record
    margin = min(math.ceil(len(taps) / thin), min(r.samples for r in records) // (8 * thin))
    out = []
    for r in records:
        if r.source is not None:
            r = _filtered(r, network, thin, cutoff)
            inputs, slopes = _differentiated(r, needs, taps)
            out.append(replace(r, inputs=inputs, slopes=slopes, taps=taps))
            continue
        inputs, slopes = _differentiated(r, needs, taps)
        out.append(
            replace(
                r,
                inputs=inputs,
                slopes=slopes,
                measured=low_pass(r.measured, taps)[margin * thin : r.samples - margin * thin : thin],
                taps=taps,
                margin=margin,
                thin=thin,
            )
        )
    return out


def _differentiated(
    r: Record, needs: list[Channel], taps: Array
) -> tuple[dict[str, Array], dict[str, tuple[Array, Array]]]:
    """Inputs and the slopes of those that need them, filtered."""
    inputs, slopes = dict(r.inputs), {}
    for c in needs:
        x = low_pass(r.inputs[c.name], taps)
        inputs[c.name] = x
        slopes[c.name] = differences(x, r.step)
    return inputs, slopes


def _filtered(r: Record, network: Network, thin: int, cutoff: float) -> Record:
    """A record of loggers, compared behind a low-pass."""
    assert r.source is not None
    made = record_of(r.source, network, r.lags, None, thin=thin, cutoff=cutoff)
    return replace(made, name=r.name)


def dealt(
    data: list[Record], validate: list[Record], notes: list[str], time: float, lead: float = 0.0
) -> tuple[list[Record], list[Role]]:
    """Records with what each is for: to fit by, to choose among candidates by, to report by.

    What nobody set aside is set aside here: whole records, or the later part of a single one. Held-out records are cut
    into stretches of `STRETCH` times the rig's own `time` [s], every other one to choose and to report by. `lead` [s]: how much of
    what came before is simulated before each of them.
    """
    fit, held = data, validate
    if not held and len(fit) > 1:
        count = max(1, len(fit) // 3)
        fit, held = fit[:-count], fit[-count:]
        notes.append(f"held out: {', '.join(r.name for r in held)}")
    elif not held:
        fit, held = _cut(fit[0])
        whole, used = len(data[0]), len(held[0]) + len(fit[0])
        rest = f"; its last {1 - used / whole:.0%}, where nothing moves any more, is left out"
        notes.append(f"held out: the last third of the motion of the only record{rest * (used < whole)}")
    pieces = [piece for r in held for piece in stretches(r, _length(r, time), lead=lead)]
    roles: list[Role] = ["choose"] * len(pieces)
    if len(pieces) > 1:
        roles = ["choose" if k % 2 == 0 else "report" for k in range(len(pieces))]
        notes.append(
            f"{len(pieces)} held-out stretches: every other one chose between explanations, the figures are of the rest"
        )
    else:
        notes.append(
            "too little is held out for a set of its own: what chose between explanations is reported, too"
        )
    fitted: list[Role] = ["fit"] * len(fit)
    return [*fit, *pieces], fitted + roles


def _length(record: Record, time: float) -> float:
    """How long the stretches [s] of a held-out record are: a quarter of a short one, where something drives it on."""
    whole = len(record) * record.rate
    return min(STRETCH * time, max(0.25 * whole, LEAST_STRETCH * time)) if record.inputs else STRETCH * time


def _cut(record: Record) -> tuple[list[Record], list[Record]]:
    """A single record cut where two thirds of its motion have passed: a decay has next to none in its last third."""
    y = record.measured - record.measured.mean(axis=0)
    width = max(1, int(0.2 * record.pace / record.rate))
    smooth = np.apply_along_axis(lambda x: np.convolve(x, np.ones(width) / width, mode="valid"), 0, y)
    way = np.cumsum(np.sum(np.abs(np.diff(smooth, axis=0)) / np.maximum(y.std(axis=0), 1e-300), axis=1))
    end = _rest(record, y)
    way = way[: max(end - width, 1)]
    at = int(np.searchsorted(way, 2 / 3 * way[-1])) + width // 2
    # a steep decay has most of its way in its first moments
    at = min(max(at, end // 8, 32), end - max(end // 6, 32))
    return [record.part(0, at, record.name)], [record.part(at, end, record.name)]


def _rest(record: Record, y: Array) -> int:
    """The sample at which what is worth comparing ends: where over half of a record, at its end, shows nothing but noise.

    y (n, channels): what was measured, without its mean.
    """
    length = max(16, math.ceil(6 * record.pace / record.rate))
    count = len(y) // length
    if count < WINDOWS:
        return len(y)
    power = y[: count * length].reshape(count, length, -1).var(axis=1)
    moving = np.flatnonzero((power > STILL * power.min(axis=0)).any(axis=1))
    last = (int(moving[-1]) + 1 if len(moving) else count) * length
    # some of the rest stays: that it does not move is a fact, too
    return len(y) if last > len(y) // 2 else max(last + last // 4, WINDOWS * length)


def stretches(record: Record, seconds: float, least: int = 300, lead: float = 0.0) -> list[Record]:
    """A record in stretches of so many seconds, each judged from an initial state of its own, none below `least` samples.

    `lead` [s]: of what came before, led in by.
    """
    count = max(1, int(len(record) * record.rate / seconds))
    count = min(count, max(1, len(record) // least))
    edges = np.linspace(0, len(record), count + 1).astype(int)
    before = int(lead / record.rate)
    return [record.part(a, b, record.name, before) for a, b in pairwise(edges)]
