"""Diagnosis of a co-simulation FMU: agreement with records, refitted parameters, remaining errors by channel and band."""

from __future__ import annotations

import math
import time as clock
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from isd_gym._common.arrays import Array, channel_rms
from isd_gym._common.errors import InputError, shown
from isd_gym._common.units import convert
from isd_gym.diagnosis._estimation.noise import Floor, floor_of, noise_of, resolution
from isd_gym.diagnosis._selection.criteria import CRITERIA, LEAST_NOISE, Criteria
from isd_gym.diagnosis._simulation.problem import Record, deviation_within
from isd_gym.diagnosis._verdict.evidence import Evidence, as_numbers
from isd_gym.diagnosis._verdict.explanation import bands, find_condition, near_reversals
from isd_gym.diagnosis._verdict.gates import decide
from isd_gym.diagnosis._verdict.wording import summary_of
from isd_gym.diagnosis.result import Diagnosis, Place, Trace
from isd_gym.records.data import Table, check, read_table
from isd_gym.records.data._quality import admit, known_check

from .comparison import FmuComparison, Progress, Segment
from .refit import FittedFmu, FmuRefit

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from numpy.typing import NDArray

    from ..cosimulation import Port, Unit, UnitModel

UNCERTAINTY = 0.2  # relative standard deviation of parameters without a stated uncertainty
MOST_FREE = 20  # parameters without a stated uncertainty that may be refitted


def diagnose_unit(
    data: Sequence[Table | str | Path],
    fmu: Unit,
    *,
    validate: Sequence[Table | str | Path] = (),
    accept: Sequence[str] = (),
    rename: Mapping[str, str] | None = None,
    units: Mapping[str, str] | None = None,
    uncertainty: Mapping[str, float] | None = None,
    progress: Progress | None = None,
    criteria: Criteria = CRITERIA,
) -> Diagnosis:
    """Compare a co-simulation FMU with records and refit the FMU's parameters.

    An FMU shows its terminals only, so the result names no effect and no place. Columns of the records have the names
    of the FMU's variables: all inputs and at least one output.

    Args:
        data: Records to fit.
        fmu: The opened FMU.
        validate: Records that take no part in fitting. Default: the last third of `data`.
        accept: Data checks that only warn.
        rename: Variable name by column name.
        units: Unit by column name.
        uncertainty: Relative standard deviation of each parameter that may be refitted. Default: 0.2 for each.
        progress: Function that receives a line per stage.
        criteria: Limits of the decision.

    Returns:
        The diagnosis, with the verdict 'no_discrepancy', 'parameters_only' or 'unknown_effect'.

    Raises:
        InputError: The records do not fit the FMU, or the FMU cannot simulate the records.
    """
    start, progress = clock.perf_counter(), progress or (lambda line: None)
    notes: list[str] = []
    for name in accept:
        known_check(name)
    sources = [
        source if isinstance(source, Table) else read_table(source, rename=rename or {}, units=units or {})
        for source in (*data, *validate)
    ]
    records, ports = _read_all(sources, fmu.model, notes, accept)
    free = _uncertainty(fmu.model, uncertainty or {}, notes)
    comparison = FmuComparison(
        fmu, replace(fmu.model, outputs=tuple(ports), uncertainty=free), records, ports
    )
    progress("measuring the input timing and the run-in of the FMU")
    notes += comparison.settle(progress)
    run_in, seen = comparison.run_in()
    notes.append(
        f"the run-in from rest takes {run_in:.3g} s{'' if seen else ' or more'}: "
        "this part of each record, at most a third, is not compared"
    )
    refit = FmuRefit(comparison, _segments(records, len(list(validate)), run_in, notes))
    errors = _fit_and_measure(refit, progress)
    notes.append(
        "the intervals include noise only: shifts by small unmodelled effects need a network of the rig"
    )
    result = _diagnosis(refit, errors, criteria, notes)
    result = replace(result, seconds=clock.perf_counter() - start)
    return replace(result, summary=summary_of(result.to_dict(), is_fmu=True))


# ------------------------------------------------------------------------------------------------------- reading


def _read_all(
    tables: Sequence[Table], model: UnitModel, notes: list[str], accept: Sequence[str]
) -> tuple[list[Record], list[Port]]:
    """Return the records of tables, with the outputs that all tables have."""
    read = [_read(table, model, notes, accept) for table in tables]
    if not read:
        raise InputError("data: no records")
    common = [p for p in read[0][1] if all(p in ports for _, ports in read)]
    if not common:
        raise InputError("the records have no output of the FMU in common")
    return [replace(r, measured=r.measured[:, [ports.index(p) for p in common]]) for r, ports in read], common


def _read(
    table: Table, model: UnitModel, notes: list[str], accept: Sequence[str]
) -> tuple[Record, list[Port]]:
    """Check one record; return the record in the FMU's units and the measured outputs."""
    outputs = [p for p in model.outputs if p.name in table.columns]
    if not outputs:
        some = ", ".join(p.name for p in model.outputs[:8])
        raise InputError(
            f"{table.source}: none of the FMU's outputs is a column (it has: {some}; --rename COLUMN=CHANNEL)"
        )
    ports = [*model.inputs, *outputs]
    columns = {p.name: _column(table, p, notes) for p in ports}
    table = Table(table.time, columns, table.source, {p.name: p.unit for p in ports if p.quantity})
    inputs, measured = ({p.name: p.quantity for p in some if p.quantity} for some in (model.inputs, outputs))
    admit(table, check(table, inputs=inputs, outputs=measured), notes, accept)
    table = table.uniform()
    driven = {p.name: np.asarray(table[p.name]) for p in model.inputs}
    seen = np.stack([table[p.name] for p in outputs], axis=1)
    return Record(Path(table.source).stem, table.step, driven, seen, start=float(table.time[0])), outputs


def _column(table: Table, port: Port, notes: list[str]) -> Array:
    """Return the column of a port (samples,) in the port's unit."""
    name = port.name
    if name not in table.columns:
        raise InputError(
            f"{table.source}: the FMU's input {shown(name)} is no column (--rename COLUMN={name}, or a constant one)"
        )
    values, unit = np.asarray(table[name], float), table.units.get(name) or port.unit
    if port.quantity:
        try:
            values = convert(values, unit, port.unit)
        except InputError as error:
            raise InputError(f"{table.source}: column {shown(name)}: {error}") from None
    elif unit != port.unit:
        own = port.unit or "none"
        notes.append(
            f"{table.source}: {name} is used without conversion, in {unit or 'no unit'}; the FMU states {own}"
        )
    if not np.isfinite(values).all():
        raise InputError(f"{table.source}: {name}: not every sample is finite")
    return values


def _uncertainty(model: UnitModel, stated: Mapping[str, float], notes: list[str]) -> dict[str, float]:
    """Return the relative standard deviation of each parameter that may be refitted."""
    for name, sigma in stated.items():
        model.with_parameters({name: 0.0})
        if not (math.isfinite(sigma) and sigma >= 0):
            raise InputError(f"--uncertain {name}: must be a share such as 0.05, not {sigma:g}")
    if stated:
        return {k: v for k, v in stated.items() if v > 0}
    able = [k for k, v in model.parameters.items() if v != 0 and math.isfinite(v)]
    if len(able) > MOST_FREE:
        raise InputError(
            f"FMU {shown(model.name)} has {len(able)} parameters that could be refitted: select some with --uncertain NAME=0.1"
        )
    if able:
        notes.append(
            f"no uncertainty was stated: {UNCERTAINTY:.0%} was assumed for each of {len(able)} parameters"
        )
    return dict.fromkeys(able, UNCERTAINTY)


def _segments(records: Sequence[Record], validation: int, run_in: float, notes: list[str]) -> list[Segment]:
    """Split the records into fitted and held-out segments after the run-in.

    Args:
        records: All records, validation records last.
        validation: Number of validation records. 0: the last third of the records, or of a single record.
        run_in: Run-in [s].
        notes: List that receives a note about the split.

    Returns:
        Segments in the order of the records.
    """
    first = [min(math.ceil(run_in / r.step), len(r) // 3) for r in records]
    if not validation and len(records) == 1:
        stop = len(records[0])
        cut = first[0] + 2 * (stop - first[0]) // 3
        notes.append("held out: the last third of the only record")
        return [Segment(0, first[0], cut, False), Segment(0, cut, stop, True)]
    if not validation:
        validation = max(1, len(records) // 3)
        notes.append(f"held out: {', '.join(r.name for r in records[-validation:])}")
    fitted = len(records) - validation
    return [Segment(i, first[i], len(r), i >= fitted) for i, r in enumerate(records)]


# ------------------------------------------------------------------------------------------------------- errors


@dataclass(frozen=True, eq=False)
class _Errors:
    """A refit and the errors of each channel."""

    found: FittedFmu
    floors: Array  # noise to be expected (channels,) [unit of the channel]
    floor_known: tuple[bool, ...]  # whether the measured signal shows the noise
    rows: dict[str, tuple[float, ...]]  # held-out RMS error over deviation, by stage
    constant: dict[str, float]  # constant part of the squared error, by channel


def _deviation(refit: FmuRefit, held_out: bool) -> np.ndarray:
    """Return the deviation (channels,) of the measured outputs within the records that are fitted or held out."""
    pick = [s for s in refit.segments if s.held_out == held_out]
    parts = [refit.comparison.records[s.record].measured[s.first : s.stop] for s in pick]
    return deviation_within(parts, [s.record for s in pick])


def _fit_and_measure(refit: FmuRefit, progress: Progress) -> _Errors:
    """Refit the parameters and return the errors before and after."""
    c = refit.comparison
    step = c.records[0].step
    measured = [c.records[s.record].measured[s.first : s.stop] for s in refit.segments]
    known = [_noise_floor([m[:, j] for m in measured], step) for j in range(len(c.channels))]
    least = LEAST_NOISE * _deviation(refit, held_out=False)
    floors = np.maximum([k.deviation for k in known], least)
    found = refit.fit(floors, progress)
    deviation = _deviation(refit, held_out=True)
    before, after = (refit.residuals(m, held_out=True) for m in (c.model, found.model))
    errors = [channel_rms(r) / deviation for r in (before, after)]
    noise = np.array([
        min(noise_of([r[:, j] for r in after], step, time=c.time_scale), k.deviation)
        for j, k in enumerate(known)
    ])  # fmt: skip
    rows = {
        "before": errors[0],
        "refit": errors[1],
        "after": errors[1],
        "noise_floor": np.minimum(noise / deviation, errors[1]),
    }
    mean = np.concatenate(after).mean(axis=0) / deviation
    constant = {
        name: float((m / max(e, 1e-300)) ** 2) for name, m, e in zip(c.channels, mean, errors[1], strict=True)
    }
    is_known, rounded = tuple(k.known for k in known), {k: as_numbers(v) for k, v in rows.items()}
    return _Errors(found, floors, is_known, rounded, constant)


def _noise_floor(series: Sequence[Array], step: float) -> Floor:
    """Return the noise floor of a channel, at least the sensor's resolution."""
    floor = floor_of(series, step)
    return replace(floor, deviation=max(floor.deviation, resolution(series)))


def _diagnosis(refit: FmuRefit, errors: _Errors, criteria: Criteria, notes: list[str]) -> Diagnosis:
    """Decide and collect the result; the summary is still empty."""
    c, rows, found = refit.comparison, errors.rows, errors.found
    evidence = Evidence(
        channels=tuple(c.channels),
        before=rows["before"],
        refit=rows["refit"],
        after=rows["after"],
        noise=rows["noise_floor"],
        noise_known=errors.floor_known,
        envelope=(criteria.material,) * len(c.channels),
        limits=refit.parameters_at_limits(found.x),
    )
    decision = decide(evidence, criteria)
    agrees = decision.verdict == "no_discrepancy"
    return Diagnosis(
        verdict=decision.verdict,
        summary="",
        reason=decision.reason,
        constant=errors.constant,
        effects=(),
        contenders=(),
        where=() if agrees else _remaining_errors(refit, errors),
        parameters=refit.intervals(found, errors.floors),
        gap={k: dict(zip(c.channels, v, strict=True)) for k, v in rows.items()},
        closed=None,
        gates=(),
        next_experiment=None,
        base=c.model,
        refitted=found.model,
        model=found.model,
        traces=tuple(_traces(refit, found.model)),
        notes=tuple(notes),
        units={p.name: p.unit for p in c.outputs},
        evidence=evidence,
        criteria=criteria,
    )


def _remaining_errors(refit: FmuRefit, errors: _Errors) -> tuple[Place, ...]:
    """Return each channel's share of the error after the refit, with bands and condition; largest share first."""
    c, fitted = refit.comparison, [s for s in refit.segments if not s.held_out]
    residuals = refit.residuals(errors.found.model, held_out=False)
    square = np.mean(np.concatenate(residuals) ** 2, axis=0) - errors.floors**2
    excess = np.maximum(square, 0.0) / _deviation(refit, held_out=False) ** 2
    total, step = float(excess.sum()) or 1.0, c.records[fitted[0].record].step
    places = []
    for j, name in enumerate(c.channels):
        r = residuals[0][:, j]
        found = tuple(bands(r, float(errors.floors[j]), step))
        width = max(1, int(0.2 * c.time_scale / step))
        condition = find_condition(r, width, _conditions(c, fitted[0], width))
        places.append(Place(name, float(excess[j]) / total, found, condition))
    return tuple(sorted(places, key=lambda p: -p.share))


def _conditions(c: FmuComparison, segment: Segment, width: int) -> Iterator[tuple[NDArray[np.bool_], str]]:
    """Yield conditions on inputs and measured outputs: the samples (n,) where true, and words."""
    record, cut = c.records[segment.record], slice(segment.first, segment.stop)
    signals = [(p, record.inputs[p.name][cut]) for p in c.model.inputs]
    signals += [(p, record.measured[cut, j]) for j, p in enumerate(c.outputs)]
    for p, x in signals:
        x = x - np.median(x)
        rate = np.gradient(x, record.step)
        is_input = p.causality == "input"  # noise changes the sign of a measured output's rate
        if is_input:
            yield near_reversals(rate, width), f"{p.name} turns"
        for q in (0.8, 0.95):
            level, speed = (float(np.quantile(np.abs(s), q)) for s in (x, rate))
            yield np.abs(x) > level, f"{p.name} is more than {level:.3g} {p.unit} from its middle"
            if is_input:
                unit = p.unit or "units"
                yield np.abs(rate) > speed, f"{p.name} changes faster than {speed:.3g} {unit} a second"


def _traces(refit: FmuRefit, fitted: UnitModel) -> Iterator[Trace]:
    """Yield measured and simulated signals of each segment."""
    c = refit.comparison

    def by_channel(y: Array) -> dict[str, Array]:
        return {name: y[:, j] for j, name in enumerate(c.channels)}

    for s in refit.segments:
        record, cut = c.records[s.record], slice(s.first, s.stop)
        before, after = (by_channel(c.simulate(m, s.record)[cut]) for m in (c.model, fitted))
        inputs = {k: v[cut] for k, v in record.inputs.items()}
        name = record.name if len(c.records) > 1 or not s.held_out else f"{record.name} (later part)"
        measured = by_channel(record.measured[cut])
        yield Trace(name, s.held_out, record.time[cut], inputs, measured, before, after, after)
