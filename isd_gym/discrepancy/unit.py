"""A model that shows no inside: the diagnosis of a unit for co-simulation.

What can be said of it ends at its terminals: whether it agrees, with which parameters, and in which channel, band and
condition it does not. An effect, and a place for it, takes a network.
"""

from __future__ import annotations

import math
import time as clock
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..data import Table, check, read_table
from ..data.quality import admit, known_check
from ..errors import InputError, shown
from ..units import convert
from .blackbox import Comparison, Refit, Say, Stretch
from .criteria import CRITERIA, Criteria, decide
from .evidence import Evidence
from .explain import bands
from .noise import Floor, floor_of, noise_of, quantum
from .problem import Array, Record
from .result import Diagnosis, Place, Trace
from .words import unit_summary_of

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from ..cosimulation import Port, Unit, UnitModel

UNCERTAIN = 0.2  # relative one-sigma of a unit's parameters where nobody states any
MOST_FREE = 20  # parameters that are refitted where nobody says which
LEAST_NOISE = 0.01  # share of the signal: no model is better


def _read(
    source: Table | str | Path, model: UnitModel, notes: list[str], accept: Sequence[str],
    rename: Mapping[str, str], units: Mapping[str, str],
) -> tuple[Record, list[Port]]:  # fmt: skip
    """A checked record in the unit's own units, and the unit's outputs that it holds."""
    table = source if isinstance(source, Table) else read_table(source, rename=rename, units=units)
    there = [p for p in model.outputs if p.name in table.columns]
    if not there:
        some = ", ".join(p.name for p in model.outputs[:8])
        raise InputError(
            f"{table.source}: none of the unit's outputs is a column (it has: {some}; --rename COLUMN=CHANNEL)"
        )
    ports = [*model.inputs, *there]
    columns, named = {}, {}
    for p in ports:
        if p.name not in table.columns:
            raise InputError(
                f"{table.source}: the unit's input {shown(p.name)} is no column (--rename COLUMN={p.name}, or a constant one)"
            )
        values, unit = np.asarray(table[p.name], float), table.units.get(p.name) or p.unit
        if p.quantity:
            try:
                values = convert(values, unit, p.unit)
            except InputError as error:
                raise InputError(f"{table.source}: column {shown(p.name)}: {error}") from None
            named[p.name] = p.unit
        elif unit != p.unit:
            notes.append(
                f"{table.source}: {p.name} is taken as it is, in {unit or 'no unit'}; the unit says {p.unit or 'none'}"
            )
        if not np.isfinite(values).all():
            raise InputError(f"{table.source}: {p.name}: not every sample is finite")
        columns[p.name] = values
    table = Table(table.time, columns, table.source, named)
    quantity = {p.name: p.quantity for p in ports if p.quantity}
    findings = check(
        table,
        inputs={p.name: quantity[p.name] for p in model.inputs if p.name in quantity},
        outputs={p.name: quantity[p.name] for p in there if p.name in quantity},
    )
    admit(table, findings, notes, accept)
    table = table.uniform()
    inputs = {p.name: np.asarray(table[p.name]) for p in model.inputs}
    measured = np.stack([table[p.name] for p in there], axis=1)
    return Record(Path(table.source).stem, table.step, inputs, measured, {}, float(table.time[0])), there


def _uncertainty(model: UnitModel, stated: Mapping[str, float], notes: list[str]) -> dict[str, float]:
    """Relative one-sigma of what may be refitted."""
    for name, sigma in stated.items():
        model.with_parameters({name: 0.0})
        if not (math.isfinite(sigma) and sigma >= 0):
            raise InputError(f"--uncertain {name}: must be a share such as 0.05, not {sigma:g}")
    if stated:
        return {k: v for k, v in stated.items() if v > 0}
    able = [k for k, v in model.parameters.items() if v != 0 and math.isfinite(v)]
    if len(able) > MOST_FREE:
        raise InputError(
            f"unit {shown(model.name)} has {len(able)} parameters that could be refitted: say which with --uncertain NAME=0.1"
        )
    if able:
        notes.append(
            f"no uncertainty was stated: each of {len(able)} parameters was taken as known to {UNCERTAIN:.0%}"
        )
    return dict.fromkeys(able, UNCERTAIN)


def _stretches(records: Sequence[Record], held: int, run_in: float, notes: list[str]) -> list[Stretch]:
    """What is fitted and what is held out: whole records, or the later part of a single one; after the run-in."""
    out = []
    begins = [min(math.ceil(run_in / r.step), len(r) // 3) for r in records]
    if not held and len(records) == 1:
        first, stop = begins[0], len(records[0])
        cut = first + 2 * (stop - first) // 3
        notes.append("held out: the last third of the only record")
        return [Stretch(0, first, cut, False), Stretch(0, cut, stop, True)]
    if not held:
        held = max(1, len(records) // 3)
        notes.append(f"held out: {', '.join(r.name for r in records[-held:])}")
    for i, (r, first) in enumerate(zip(records, begins, strict=True)):
        out.append(Stretch(i, first, len(r), i >= len(records) - held))
    return out


def diagnose_unit(
    data: Sequence[Table | str | Path],
    unit: Unit,
    *,
    validate: Sequence[Table | str | Path] = (),
    accept: Sequence[str] = (),
    rename: Mapping[str, str] | None = None,
    units: Mapping[str, str] | None = None,
    uncertainty: Mapping[str, float] | None = None,
    progress: Say | None = None,
    criteria: Criteria = CRITERIA,
) -> Diagnosis:
    """Compare a unit for co-simulation with records, and refit its parameters.

    unit: as it was opened. data: records to fit by; validate: records that take no part in fitting (without them the last third of `data` is held
    out). Columns are named as the unit's variables: every input, and at least one output; rename: column -> variable;
    units: unit of a column. accept: checks of the data gate that only warn. uncertainty: relative one-sigma of the
    parameters that may be refitted; each of them by 0.2 where nothing is stated. progress: called with a line now and
    then. criteria: what decides. The verdict is 'no_discrepancy', 'parameters_only' or 'unknown_effect': of a model that
    shows no inside no effect and no place is named. Raises `InputError`.
    """
    begun, say = clock.perf_counter(), progress or (lambda line: None)
    notes: list[str] = []
    for name in accept:
        known_check(name)
    model = unit.model
    read = [_read(d, model, notes, accept, rename or {}, units or {}) for d in [*data, *validate]]
    if not read:
        raise InputError("data: no records")
    both = [p for p in read[0][1] if all(p in there for _, there in read)]
    if not both:
        raise InputError("the records have no output of the unit in common")
    records = [replace(r, measured=r.measured[:, [there.index(p) for p in both]]) for r, there in read]
    model = replace(model, outputs=tuple(both), uncertainty=_uncertainty(model, uncertainty or {}, notes))
    c = Comparison(unit, model, records, both)
    say("finding out how the unit takes its inputs, and how long it remembers its beginning")
    notes += c.settle(say)
    run_in, seen = c.run_in()
    notes.append(
        f"the unit starts at rest and was seen to remember that for {run_in:.3g} s"
        + ("" if seen else " at least (what sticks does for ever)")
        + "; of each record that much is not compared, and no more than a third of it"
    )
    stretches = _stretches(records, len(list(validate)), run_in, notes)
    measured = [records[s.record].measured[s.first : s.stop] for s in stretches]
    known = [_floor([m[:, j] for m in measured], records[0].step) for j in range(len(both))]
    fitted = np.concatenate([m for m, s in zip(measured, stretches, strict=True) if not s.held])
    judged = np.concatenate([m for m, s in zip(measured, stretches, strict=True) if s.held])
    floors = np.maximum([k.deviation for k in known], LEAST_NOISE * fitted.std(axis=0))
    refit = Refit(c, stretches)
    found = refit.fit(floors, say)
    spread = np.maximum(judged.std(axis=0), 1e-300)
    before, after = (refit.residuals(m, held=True) for m in (model, found.model))
    rows = {"before": _error(before, spread), "refit": _error(after, spread)}
    rows["after"] = rows["refit"]
    noise = np.array([
        min(noise_of([r[:, j] for r in after], records[0].step, time=c.time).deviation, k.deviation)
        for j, k in enumerate(known)
    ])  # fmt: skip
    rows["noise_floor"] = np.minimum(noise / spread, rows["refit"])
    quantities = refit.intervals(found, floors)
    at_limit = tuple(
        f.path for f, x in zip(refit.free, found.x, strict=True)
        if x <= f.low + 1e-6 * f.sigma or x >= f.high - 1e-6 * f.sigma
    )  # fmt: skip
    row = {k: tuple(map(float, v)) for k, v in rows.items()}
    evidence = Evidence(
        channels=tuple(c.channels), before=row["before"], refit=row["refit"], after=row["after"],
        floor=row["noise_floor"], floor_known=tuple(k.known for k in known),
        worth=(criteria.material,) * len(both), limits=at_limit,
    )  # fmt: skip
    decision = decide(evidence, criteria)
    verdict = decision.verdict
    mean = np.concatenate(after).mean(axis=0) / spread
    constant = {
        n: float((m / max(e, 1e-300)) ** 2) for n, m, e in zip(c.channels, mean, rows["refit"], strict=True)
    }
    left = refit.residuals(found.model, held=False)
    where = () if verdict == "no_discrepancy" else _places(c, stretches, left, floors)
    gap = {k: dict(zip(c.channels, v, strict=True)) for k, v in row.items()}
    notes.append(
        "the intervals count noise alone: what small effects drag along cannot be told without an inside"
    )
    said = Diagnosis(
        verdict=verdict,
        summary="",
        reason=decision.reason,
        constant=constant,
        effects=(),
        contenders=(),
        where=where,
        parameters=quantities,
        gap=gap,
        closed=None,
        gates=(),
        next_experiment=None,
        base=model,
        refitted=found.model,
        model=found.model,
        traces=_traces(c, stretches, model, found.model),
        notes=tuple(notes),
        seconds=clock.perf_counter() - begun,
        units={p.name: p.unit for p in both},
        evidence=evidence,
        criteria=criteria,
    )
    return replace(said, summary=unit_summary_of(said.to_dict()))


def _floor(series: Sequence[Array], step: float) -> Floor:
    seen = floor_of(series, step)
    return replace(seen, deviation=max(seen.deviation, quantum(series)))


def _error(left: Sequence[Array], spread: Array) -> Array:
    return np.asarray(np.sqrt(np.mean(np.concatenate(left) ** 2, axis=0)) / spread, dtype=np.float64)


def _places(
    c: Comparison, stretches: Sequence[Stretch], left: Sequence[Array], floors: Array
) -> tuple[Place, ...]:
    """Every channel's share of what the refitted unit leaves; where in frequency, and under which condition."""
    fit = [s for s in stretches if not s.held]
    joined = np.concatenate(left)
    spread = np.concatenate([c.records[s.record].measured[s.first : s.stop] for s in fit]).std(axis=0)
    excess = np.maximum(np.mean(joined**2, axis=0) - floors**2, 0.0) / np.maximum(spread, 1e-300) ** 2
    total = float(excess.sum()) or 1.0
    out = []
    for j, name in enumerate(c.channels):
        r = left[0][:, j]
        said = tuple(bands(r, float(floors[j]), c.records[fit[0].record].step))
        out.append(Place(name, float(excess[j]) / total, said, _when(c, fit[0], r)))
    return tuple(sorted(out, key=lambda p: -p.share))


def _when(c: Comparison, stretch: Stretch, residual: Array) -> str:
    """The condition on a measured signal under which the residual's energy is highest above its mean: in plain words."""
    record, e = c.records[stretch.record], residual**2
    cut = slice(stretch.first, stretch.stop)
    width = max(1, int(0.2 * c.time / record.step))
    e = np.convolve(e, np.ones(width) / width, mode="same")
    best = (1.6, "everywhere")

    def consider(mask: np.ndarray, text: str) -> None:
        nonlocal best
        if (
            0.01 < mask.mean() < 0.5
            and e.mean() > 0
            and (ratio := float(e[mask].mean() / e.mean())) > best[0]
        ):
            best = (ratio, text)

    signals = [(p, record.inputs[p.name][cut]) for p in c.model.inputs]
    signals += [(p, record.measured[cut, j]) for j, p in enumerate(c.outputs)]
    for p, x in signals:
        x = x - np.median(x)
        v = np.gradient(x, record.step)
        turn = np.concatenate([[False], np.sign(v[1:]) != np.sign(v[:-1])])
        if p.causality == "input":  # of a measured output noise turns the sign
            consider(np.convolve(turn, np.ones(2 * width + 1), mode="same") > 0, f"{p.name} turns")
        for q in (0.8, 0.95):
            level, rate = (float(np.quantile(np.abs(s), q)) for s in (x, v))
            consider(np.abs(x) > level, f"{p.name} is more than {level:.3g} {p.unit} from its middle")
            if p.causality == "input":
                consider(
                    np.abs(v) > rate, f"{p.name} changes faster than {rate:.3g} {p.unit or 'units'} a second"
                )
    return best[1]


def _traces(
    c: Comparison, stretches: Sequence[Stretch], before: UnitModel, after: UnitModel
) -> tuple[Trace, ...]:
    out = []
    for s in stretches:
        record, cut = c.records[s.record], slice(s.first, s.stop)
        says = [c.simulate(m, s.record)[cut] for m in (before, after)]
        before_row, after_row = ({n: y[:, j] for j, n in enumerate(c.channels)} for y in says)
        measured = {n: record.measured[cut, j] for j, n in enumerate(c.channels)}
        inputs = {k: v[cut] for k, v in record.inputs.items()}
        name = record.name if len(c.records) > 1 or not s.held else f"{record.name} (later part)"
        out.append(Trace(name, s.held, record.time[cut], inputs, measured, before_row, after_row, after_row))
    return tuple(out)
