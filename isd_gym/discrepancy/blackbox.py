"""A model that shows no inside: a unit for co-simulation compared with records, and its parameters refitted.

What can be said of it ends at its terminals: whether it agrees, with which parameters, and in which channel, band and
condition it does not. An effect, and a place for it, takes a network.
"""

from __future__ import annotations

import math
import time as clock
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from ..cosimulation import Port, Unit, UnitModel
from ..data import Table, check, read_table
from ..errors import InputError, shown
from ..units import convert
from .criteria import CRITERIA, Criteria, decide
from .evidence import Evidence
from .explain import bands
from .least_squares import bounded_step
from .noise import Floor, Whitener, finer, floor_of, innovations, noise_of, plain, quantum, trust, whitener
from .problem import Array, Record
from .records import UNACCEPTABLE, known_check
from .result import Diagnosis, Place, Quantity, Trace
from .structure import Free, Structure, base_structure

Say = Callable[[str], None]

UNCERTAIN = 0.2  # relative one-sigma of a unit's parameters where nobody states any
MOST_FREE = 20  # parameters that are refitted where nobody says which
AHEAD = (0.5, 0.0, 1.0)  # share of a step by which a unit's inputs may act late
COARSE = (
    0.02  # share of a deviation by which a unit stepped with the record may differ from one stepped finely
)
FINEST = 8  # communication steps a sample at most
RUN_IN = 0.02  # share of a deviation at which a unit has forgotten how it began
LEAST_NOISE = 0.01  # share of the signal: no model is better


@dataclass(frozen=True)
class Stretch:
    """Samples first..stop-1 of a record, compared after the run-in; `held`: they take no part in fitting."""

    record: int
    first: int
    stop: int
    held: bool


class Comparison:
    """Records, the unit that is to say the same, and how it is stepped.

    records: with inputs and measured outputs in the unit's own units. outputs: the ports compared.
    """

    def __init__(
        self, unit: Unit, model: UnitModel, records: Sequence[Record], outputs: Sequence[Port]
    ) -> None:
        self.unit, self.model, self.records = unit, model, list(records)
        self.outputs = list(outputs)
        self.channels = [p.name for p in outputs]
        self.ahead = dict.fromkeys(
            self.records[0].inputs, 0.5
        )  # share of a step by which each input is set early
        self.every = 1  # steps of the unit a sample
        self._known: dict[tuple[int, tuple[float, ...]], Array] = {}

    @cached_property
    def time(self) -> float:
        return float(np.median([r.pace for r in self.records]))

    def run(
        self, model: UnitModel, index: int, *, first: int = 0, stop: int | None = None, every: int = 0
    ) -> Array:
        """Outputs (samples, channels) of the unit with the values of `model`, from rest at sample `first`."""
        record = self.records[index]
        every = every or self.every
        n = len(record) if stop is None else stop
        fine = np.minimum(np.arange((n - first - 1) * every + 1) / every + first, n - 1)
        inputs = {
            name: np.interp(
                np.minimum(fine + self.ahead[name] / every, n - 1), np.arange(len(values)), values
            )
            for name, values in record.inputs.items()
        }
        own = self.unit.model.parameters
        start = {k: v for k, v in model.parameters.items() if v != own[k]}
        out = self.unit.run(inputs, len(fine), record.step / every, self.channels, start)
        return out[::every]

    def simulate(self, model: UnitModel, index: int) -> Array:
        """The whole record; what was simulated before is remembered."""
        key = (index, tuple(model.parameters.values()))
        if key not in self._known:
            if len(self._known) > 256:
                self._known.clear()
            self._known[key] = self.run(model, index)
        return self._known[key]

    def settle(self, say: Say) -> list[str]:
        """How far ahead of a step its inputs are to be set, and how many steps a sample takes; what was found, in words.

        A unit knows an input only at the beginning of a step, and may hold it, or go there while the step lasts. Which of
        the ways it is, a run with short steps tells, in which none of them matters.
        """
        record = self.records[0]
        n = min(len(record), max(200, math.ceil(20 * self.time / record.step)))
        self.unit.forgets({k: v[:n] for k, v in record.inputs.items()}, n, record.step, self.channels, {})
        fine = self.run(self.model, 0, stop=n, every=2 * FINEST)
        spread = np.maximum(fine.std(axis=0), 0.1 * np.maximum(record.measured.std(axis=0), 1e-300))

        def error() -> float:
            return float(np.max((self.run(self.model, 0, stop=n) - fine).std(axis=0) / spread))

        while True:
            say(f"stepping the unit every {1e3 * record.step / self.every:.3g} ms")
            left = error()
            for name in record.inputs:
                tried = {self.ahead[name]: left}
                for self.ahead[name] in AHEAD:
                    if self.ahead[name] not in tried:
                        tried[self.ahead[name]] = error()
                self.ahead[name] = min(tried, key=lambda a: tried[a])
                left = tried[self.ahead[name]]
            if left < COARSE or self.every >= FINEST:
                break
            self.every *= 2
        when = {0.0: "at the beginning", 0.5: "in the middle", 1.0: "at the end"}
        how = ", ".join(f"{name} as it is {when[a]} of a step" for name, a in self.ahead.items())
        notes = [
            f"the unit is stepped every {1e3 * record.step / self.every:.3g} ms" + (f", {how}" if how else "")
        ]
        if left >= COARSE:
            notes.append(f"its outputs still depend on the step, by {left:.1%} of their deviation")
        return notes

    def run_in(self) -> tuple[float, bool]:
        """How long the unit remembers how it began [s], and whether that was seen: two runs that began apart, until they agree."""
        index = int(np.argmax([len(r) for r in self.records]))
        record = self.records[index]
        half = len(record) // 2
        late = len(record) // 4
        whole, after = (self.run(self.model, index, first=k, stop=late + half) for k in (0, late))
        apart = np.abs(whole[late:] - after) / np.maximum(record.measured.std(axis=0), 1e-300)
        over = np.flatnonzero(apart.max(axis=1) > RUN_IN)
        last = int(over[-1]) + 1 if len(over) else 0
        return last * record.step, last < 0.9 * half


@dataclass
class Fitted:
    """Parameters (transformed), what the unit says with them, and what the fit's own noise makes of it."""

    x: Array
    model: UnitModel
    cost: float
    hessian: Array
    likelihood: float = math.inf


class Refit:
    """Gauss-Newton over whole runs of the unit, with the stated uncertainty as prior; derivatives by differences."""

    def __init__(self, comparison: Comparison, stretches: Sequence[Stretch]) -> None:
        self.c, self.stretches = comparison, list(stretches)
        self.structure: Structure = base_structure(comparison.model)  # type: ignore[arg-type]  # parameters alone are asked for
        self.free = tuple(_within(f, comparison.model) for f in self.structure.free)
        self.mean = np.array([f.mean for f in self.free])
        self.sigma = np.array([f.sigma for f in self.free])
        self.low, self.high = (np.array([getattr(f, k) for f in self.free]) for k in ("low", "high"))

    def at(self, x: Array) -> UnitModel:
        return self.c.model.with_parameters(
            {f.path: f.back(float(v)) for f, v in zip(self.free, x, strict=True)}
        )

    def residuals(self, model: UnitModel, held: bool) -> list[Array]:
        out = []
        for s in self.stretches:
            if s.held == held:
                y = self.c.simulate(model, s.record)
                out.append((self.c.records[s.record].measured - y)[s.first : s.stop])
        return out

    def _tried(self, x: Array, W: Whitener) -> float:
        try:
            left = self.residuals(self.at(x), held=False)
        except InputError:
            return math.inf
        return sum(float(np.sum(W(r) ** 2)) for r in left) + float(
            np.sum(((x - self.mean) / self.sigma) ** 2)
        )

    def linearised(self, x: Array, W: Whitener) -> tuple[Array, Array]:
        """Hessian and slope of half the cost, without the prior."""
        p = len(x)
        here = self.residuals(self.at(x), held=False)
        columns = []
        for k, f in enumerate(self.free):
            h = 2e-3 if f.log else 1e-3 * max(abs(x[k]), 0.03 * f.sigma)
            h = -h if x[k] + h > f.high else h
            moved = x.copy()
            moved[k] += h
            columns.append(
                [(b - a) / h for a, b in zip(here, self.residuals(self.at(moved), held=False), strict=True)]
            )
        H, g = np.zeros((p, p)), np.zeros(p)
        for i, r in enumerate(here):
            stack = np.stack([r, *(-c[i] for c in columns)], axis=2)
            G = W(stack).reshape(-1, p + 1)
            G = G.T @ G
            H += G[1:, 1:]
            g += G[1:, 0]
        return H, g

    def fit(self, floors: Array, say: Say, rounds: int = 3, iterations: int = 6) -> Fitted:
        """Rounds of a fit and of weights from what it left, until the likelihood under own coloured noise stops falling."""
        x, W, best = self.mean.copy(), plain(floors), None
        least: Array | None = None
        for number in range(rounds):
            say(
                f"refitting {len(x)} parameters (round {number + 1}, {self.c.unit.runs} runs of the unit so far)"
            )
            x, H = self._descended(x, W, iterations)
            left = self.residuals(self.at(x), held=False)
            least = trust(left, floors) if least is None else least
            prior = float(np.sum(((x - self.mean) / self.sigma) ** 2))
            value = innovations(left, finer(least, floors)) + prior
            enough = best is not None and value > best.likelihood - 2.0
            if best is None or value < best.likelihood:
                best = Fitted(x, self.at(x), self._tried(x, W), H, value)
            if enough or not len(x):
                break
            W = whitener(left, least)
        assert best is not None
        return best

    def _descended(self, x: Array, W: Whitener, iterations: int) -> tuple[Array, Array]:
        damping, cost = 1e-4, self._tried(x, W)
        if not math.isfinite(cost):
            raise InputError(f"{self.c.unit.path}: the simulation breaks down at the start values")
        H = np.zeros((len(x), len(x)))
        for _ in range(iterations if len(x) else 0):
            H, g = self.linearised(x, W)
            slope = g + (self.mean - x) / self.sigma**2
            full = H + np.diag(1 / self.sigma**2)
            for _ in range(5):
                new = x + bounded_step(full, slope, x, self.low, self.high, 2 * self.sigma, damping)
                value = self._tried(new, W)
                if value < cost:
                    break
                damping = max(10 * damping, 1e-3)
            else:
                break
            gain, x, cost, damping = (cost - value) / cost, new, value, max(0.2 * damping, 1e-6)
            if gain < 1e-4:
                break
        return x, H

    def intervals(self, found: Fitted, floors: Array) -> dict[str, Quantity]:
        """Every parameter with its 95 % interval, under the coloured noise that is left."""
        left = self.residuals(found.model, held=False)
        H, _ = self.linearised(found.x, whitener(left, trust(left, floors)))
        variance = np.diag(np.linalg.inv(H + np.diag(1 / self.sigma**2))) if len(found.x) else np.zeros(0)
        out = {}
        for f, x, v in zip(self.free, found.x, np.minimum(variance, self.sigma**2), strict=True):
            s, prior = 1.96 * math.sqrt(v), self.c.model.parameters[f.path]
            low, high = sorted((f.back(x - s), f.back(x + s)))
            out[f.path] = Quantity(f.back(float(x)), low, high, self.c.model.unit_of(f.path), prior)
        return out


def _within(f: Free, model: UnitModel) -> Free:
    """No further than the unit's own limits."""
    low, high = model.limits.get(f.path, (-math.inf, math.inf))
    own = [f.forward(v) if math.isfinite(v) and (v > 0 or not f.log) else v for v in (low, high)]
    return replace(
        f, low=max(f.low, own[0] if not (f.log and low <= 0) else -math.inf), high=min(f.high, own[1])
    )


# ------------------------------------------------------------------------------------------------------ records


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
    for f in findings:
        message = f"{table.source}: {f.channel + ': ' if f.channel else ''}{f.message}"
        if f.level == "error" and f.check in UNACCEPTABLE:
            raise InputError(message)
        if f.level == "error" and not {f.check, "all"} & set(accept):
            raise InputError(f"{message} (--accept {f.check} goes on)")
        notes.append(f"{Path(table.source).name}: {f}")
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


# ----------------------------------------------------------------------------------------------------- the whole


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
    verdict = decide(evidence, criteria).verdict
    left = refit.residuals(found.model, held=False)
    where = () if verdict == "no_discrepancy" else _places(c, stretches, left, floors)
    gap = {k: dict(zip(c.channels, v, strict=True)) for k, v in row.items()}
    notes.append(
        "the intervals count noise alone: what small effects drag along cannot be told without an inside"
    )
    return Diagnosis(
        verdict=verdict,
        summary=_sentence(verdict, gap, where, evidence, after, spread),
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


def _sentence(
    verdict: str, gap: dict[str, dict[str, float]], where: Sequence[Place], evidence: Evidence,
    left: Sequence[Array], spread: Array,
) -> str:  # fmt: skip
    worst = max(gap["refit"], key=lambda n: gap["refit"][n])
    most = max(gap["before"], key=lambda n: gap["before"][n] ** 2 - gap["refit"][n] ** 2)
    if verdict == "no_discrepancy":
        text = "The unit agrees with the measurement within noise; nothing is missing."
    elif verdict == "parameters_only":
        text = (
            f"Parameters explain the difference ({most}: {gap['before'][most]:.1%} before, {gap['refit'][most]:.1%} "
            "refitted); nothing is missing."
        )
    else:
        text = (
            f"Something is missing that no value of the unit's parameters explains ({worst}: {gap['before'][worst]:.1%} "
            f"before, {gap['refit'][worst]:.1%} refitted, noise {gap['noise_floor'][worst]:.1%}); it lives mostly in "
            f"{where[0].channel}, {where[0].when}. A unit shows no inside: which effect, and between which parts, only a "
            "network of the rig (isd-model/1) can be asked."
        )
        mean = np.abs(np.concatenate(left).mean(axis=0)) / spread
        off = [
            n
            for n, m, n_all in zip(gap["refit"], mean, gap["refit"].values(), strict=True)
            if m**2 > 0.5 * n_all**2
        ]
        if off:
            text += f" In {', '.join(off)} most of it is a constant: a sensor's zero?"
    unknown = [n for n, k in zip(evidence.channels, evidence.floor_known, strict=True) if not k]
    if unknown:
        text += f" How much of {', '.join(unknown)} is noise cannot be told from these data."
    if evidence.limits:
        text += f" The data ask for {', '.join(evidence.limits)} outside of what was allowed."
    return text
