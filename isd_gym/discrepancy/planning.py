"""Before the test: which effects could be told from which, how small each could be and still be named, which sensor helps."""

from __future__ import annotations

import functools
import math
import time as clock
from collections.abc import Callable, Container, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..data import Table
from ..elements import Start, parameter_fields
from ..errors import InputError, shown
from ..network import Network
from .candidate import BROKEN
from .criteria import CRITERIA, Criteria, Gate, decide
from .design import Design
from .excitation import Excitation, Rig, candidates, default, record_of, rig_of
from .field import NOTHING, Field, Shape, sensors, starts_of
from .foreseen import Amount, Foreseen, Plan, Sensor
from .hypotheses import hypotheses
from .problem import Array, Record
from .prospect import Prospect, no_alternative, oppose, prospect
from .stand import Stand, measured_noise
from .structure import Hypothesis, owner_pair

#: 2 log L by which a rival has to be behind
NEEDED = 50.0
RIVALS = 4  # that are refitted to a truth
#: multiples of what is needed, by the linear reckoning, beyond which a rival need not be refitted
CLEAR = 12.0
#: a size, in those of the starts (a twentieth of the typical force), that is no size to be asked for
FAR = 20.0
BRIEF = 6000  # samples of a test that are simulated while tests are compared
Say = Callable[[str, float], None]


def plan(
    model: Network | str | Path | Mapping[str, Any],
    data: Sequence[Table | str | Path] = (),
    *,
    excitation: Excitation | str | None = None,
    rig: Rig | None = None,
    noise: Mapping[str, float] | None = None,
    only: Sequence[str] = (),
    add_sensors: bool = True,
    criteria: Criteria = CRITERIA,
    notes: Sequence[str] = (),
    progress: Say | None = None,
) -> Plan:
    """What a test could tell: which effects from which, and how small each could be and still be named by `diagnose`.

    Every hypothesis is simulated at a size, the owner's model and the rivals that come closest are refitted to it, and the
    diagnosis' own criteria decide on what that leaves, the noise reckoned with in expectation.

    model: the owner's model. data: records whose inputs are the test (outputs, where they are there, tell the noise); else `excitation` (one, or its
    kind) within what `rig` can do. noise: RMS of each output [its unit], before what the model file says. only: words, effects or nodes, that a
    hypothesis has to hold (its rivals are still all). add_sensors: ask what one more sensor would bring. criteria: those of the diagnosis. notes: lines to begin with. progress: called with a stage
    and its share. Raises `InputError` with one line.
    """
    begun = clock.perf_counter()
    say = progress or (lambda name, share: None)
    network = Network.load(model)
    notes = list(notes)
    records, text, played, own_noise = tests(network, data, excitation, rig, notes)
    known = {**own_noise, **dict(noise or {})}
    stand = Stand(network, records, noise=known, criteria=criteria, notes=notes)
    wanted = chosen(network, only)
    more = sensors(stand.network) if add_sensors else []
    say("small effects", 0.0)
    field_ = Field(stand, more=more, say=lambda share: say("small effects", share))
    effects, matrix = foresee(stand, field_, wanted, say)
    return Plan(
        stand.network,
        tuple(effects),
        matrix,
        tuple(sensor_gains(field_, say)) if more else (),
        text,
        played,
        tuple(records),
        {c.name: float(s) for c, s in zip(network.outputs, stand.noise, strict=True)},
        float(sum(r.samples * r.step for r in records)),
        tuple(notes),
        clock.perf_counter() - begun,
    )


# ------------------------------------------------------------------------------------------------------ the test


def tests(
    network: Network,
    data: Sequence[Table | str | Path],
    excitation: Excitation | str | None,
    rig: Rig | None,
    notes: list[str],
) -> tuple[list[Record], str, dict[str, Any] | None, dict[str, float]]:
    """(the records to be played, the test in words, the excitation as numbers, noise that measured outputs tell)."""
    several = [data] if isinstance(data, Table | str | Path) else list(data)
    if several:
        if excitation is not None:
            raise InputError("the test is either the inputs of DATA or --excitation, not both")
        read = [planned(d, network) for d in several]
        found = measured_noise([r for _, r in read], network)
        names = ", ".join(Path(t.source).name for t, _ in read)
        return [r for _, r in read], f"the inputs of {names}", None, found
    rig = rig or rig_of(network, notes=notes)
    chosen_one = (
        excitation if isinstance(excitation, Excitation) else default(network, rig, excitation or "multisine")
    )
    return [record_of(network, rig, chosen_one)], chosen_one.describe(network, rig), chosen_one.to_dict(), {}


def planned(source: Table | str | Path, network: Network) -> tuple[Table, Record]:
    """A table's inputs as a record [SI], and its outputs where it has all of them; displacements begin at zero."""
    from ..data import read_table
    from ..units import convert

    if not network.inputs:
        raise InputError(f"model '{network.name}' has no inputs: there is no test to play")
    expected = {c.name: c.unit for c in network.inputs}
    if not isinstance(source, Table):
        every = expected | {c.name: c.unit for c in network.outputs}
        try:
            table = read_table(source, expected=every)
        except InputError:
            table = read_table(source, expected=expected)
    else:
        table = source
    for name in expected:
        table[name]
    stamps = np.diff(table.time)
    if (
        len(table) < 400
        or not np.isfinite(table.time).all()
        or stamps.min() < 0.5 * table.step
        or stamps.max() > 1.5 * table.step
    ):
        raise InputError(f"{table.source}: a test needs 400 or more evenly spaced samples of time")
    inputs = {}
    for c in network.inputs:
        x = convert(np.asarray(table[c.name]), table.units.get(c.name) or c.unit, c.si)
        if not np.isfinite(x).all():
            raise InputError(f"{table.source}: {c.name} has values that are not finite")
        inputs[c.name] = x - x[0] if c.quantity == "displacement" else x
    whole = all(c.name in table.columns for c in network.outputs)
    measured = np.zeros((len(table), len(network.outputs)))
    if whole:
        columns = [
            convert(np.asarray(table[c.name]), table.units.get(c.name) or c.unit, c.unit)
            for c in network.outputs
        ]
        measured = np.stack(columns, axis=1)
    return table, Record(Path(table.source).stem, table.step, inputs, measured)


def chosen(network: Network, only: Sequence[str]) -> list[Hypothesis]:
    """The hypotheses that hold all of the words `only`: effects, nodes or channels."""
    every = list(hypotheses(network))
    for word in only:
        known = {w for h in every for w in (h.effect, *h.where)}
        if word not in known:
            raise InputError(
                f"--only: no effect, node or channel {shown(word)} among the hypotheses (there are: {', '.join(sorted(known))})"
            )
    kinds = {h.effect for h in every}
    effects, places = [w for w in only if w in kinds], [w for w in only if w not in kinds]
    return [h for h in every if (not effects or h.effect in effects) and all(w in h.where for w in places)]


# ------------------------------------------------------------------------------------------------ every hypothesis


def foresee(
    stand: Stand, field_: Field, wanted: Sequence[Hypothesis], say: Say
) -> tuple[list[Foreseen], Array]:
    """(what could be said of each of `wanted`, the matrix of distances among them)."""
    left, size = field_.left(), field_.size()
    distance, amplitude = field_.apart(left, size)
    typical = {field_.shapes[k].hypothesis: t for t, k in enumerate(field_.typical)}
    groups = field_.rivals()
    closest = {h: distance[:, ks].min(axis=1) for h, ks in groups.items()}
    out, scales = [], []
    for n, h in enumerate(wanted):
        say("sizes", n / len(wanted))
        if h not in typical:
            out.append(_told(stand, h, "untried"))
            scales.append(1.0)
            continue
        t = typical[h]
        shape = field_.shapes[field_.typical[t]]
        a = shape.columns[0]
        if size[a] < 1e-6:
            out.append(_told(stand, h, "unseen"))
            scales.append(1.0)
            continue
        whole = math.sqrt(max(left[a, a], 0.0))
        if whole < NOTHING * size[a]:
            out.append(_told(stand, h, "hidden"))
            scales.append(1.0)
            continue
        ranked = [(float(d[t]), r) for r, d in closest.items() if _rival(stand, r, h)]
        ranked.sort(key=lambda p: p[0])
        tries = {r: _tries(field_, groups[r], distance[t], amplitude[t]) for _, r in ranked[: 2 * RIVALS]}
        found, scale = _sized(stand, shape, ranked, tries)
        out.append(found)
        scales.append(scale)
    say("sizes", 1.0)
    matrix = np.full((len(wanted), len(wanted)), np.nan)
    for i, h in enumerate(wanted):
        if h not in typical:
            continue
        a = field_.shapes[field_.typical[typical[h]]].columns[0]
        for j, r in enumerate(wanted):
            if i == j:
                matrix[i, j] = scales[i] * math.sqrt(max(left[a, a], 0.0))
            elif r in closest:
                matrix[i, j] = scales[i] * closest[r][typical[h]]
    return out, matrix


def _rival(stand: Stand, r: Hypothesis, h: Hypothesis) -> bool:
    """Whether a hypothesis could be named in the place of another: one with more parameters that gains nothing is not."""
    if r == h or no_alternative(stand, r, h):
        return False
    return _parameters(stand, r) <= _parameters(stand, h)


def _parameters(stand: Stand, h: Hypothesis) -> int:
    fields = [f for f in parameter_fields(h.kind) if not f.metadata["fixed"]]
    tied = h.kind.tied(stand.network, h.where) if h.place == "between" else {}
    return len([f for f in fields if f.name not in tied])


def _tries(
    field_: Field, shapes: Sequence[int], distance: Array, amplitude: Array
) -> list[tuple[Shape, Array]]:
    """The two shapes of a rival that come closest, with their amplitudes."""
    order = sorted(shapes, key=lambda k: float(distance[k]))[:2]
    return [(field_.shapes[k], amplitude[k]) for k in order if np.any(amplitude[k] != 0)]


def _sized(
    stand: Stand,
    shape: Shape,
    ranked: Sequence[tuple[float, Hypothesis]],
    tries: Mapping[Hypothesis, list[tuple[Shape, Array]]],
) -> tuple[Foreseen, float]:
    """The smallest size that is named, and that size in those of the start."""
    h, start = shape.hypothesis, shape.start
    simulated = _alone(stand, h, start)
    if simulated is None:
        return _told(stand, h, "untried"), 1.0
    p, at, k = simulated
    if not at * k <= FAR:
        return _told(stand, h, "hidden", limited_by=_failing(p, FAR / at, False)), 1.0
    near = [r for d, r in ranked if d * at * k < CLEAR * math.sqrt(NEEDED)][:RIVALS]
    full = math.inf
    for _ in range(2):
        _confront(p, near, tries, at)
        full = p.smallest(p.named)
        if not at * full <= FAR or full < 1.6 * max(k, 1.0):
            break
        try:
            p, at, k = prospect(stand, h, h.kind.grown(start, at * full)), at * full, 1.0
        except BROKEN:
            break
    reached = full if math.isfinite(full) else k
    near_by = [(r.hypothesis.label, math.sqrt(max(r.left.gain(reached), 0.0))) for r in p.rivals]
    common: dict[str, Any] = {"varied": _varied(h, start), "near": tuple(sorted(near_by, key=lambda x: x[1]))}
    seen = p.smallest(
        lambda f: not {g.name for g in _gates(p, f) if not g.passed} & {"significant", "replicated"}
    )
    if math.isfinite(seen):
        common["seen"] = h.kind.grown(start, at * seen)
    if not at * full <= FAR:
        lost = tuple(r.hypothesis.label for r in p.rivals if not p.told(r, FAR / at))
        return _told(
            stand, h, "confused", confused_with=lost or tuple(x for x, _ in near_by[:1]), **common
        ), 1.0
    common["smallest"] = h.kind.grown(start, at * full)
    common["share"] = p.evidence(full).effects[0].share
    return _told(stand, h, "named", limited_by=_failing(p, 0.93 * full, True), **common), at * full


def _alone(stand: Stand, h: Hypothesis, start: Start) -> tuple[Prospect, float, float] | None:
    """(a prospect, its size in those of the start, the multiple of it that is named if there were no rivals)."""
    scale, found = 1.0, None
    for _ in range(4):  # the response is not quite linear in the size
        try:
            p = prospect(stand, h, h.kind.grown(start, scale))
        except BROKEN:
            if found is not None or scale < 0.05:
                break
            scale *= 0.2
            continue
        k = p.smallest(functools.partial(p.named, rivals=False))
        found = p, scale, k
        if not math.isfinite(k) or 0.8 < k < 1.25 or scale * k > FAR:
            break
        scale *= min(max(k, 0.05), 10.0)
    return found


def _confront(
    p: Prospect, near: Sequence[Hypothesis], tries: Mapping[Hypothesis, list[tuple[Shape, Array]]], at: float
) -> None:
    """The rivals refitted to a prospect, from where small effects of theirs come closest."""
    p.rivals = []
    for r in near:
        starts = [s.hypothesis.kind.sized(s.start, at * a[: len(s.columns)]) for s, a in tries.get(r, [])]
        rival = oppose(p, r, starts) if starts else None
        if rival is not None:
            p.rivals.append(rival)


def _gates(p: Prospect, k: float) -> tuple[Gate, ...]:
    """The gates at k times the size, rivals aside."""
    return decide(p.evidence(k, False), p.stand.criteria).gates


def _failing(p: Prospect, k: float, rivals: bool) -> tuple[str, ...]:
    """What holds back an effect k times as large: gates, with the rivals that are abreast."""
    evidence = p.evidence(k, rivals)
    decision = decide(evidence, p.stand.criteria)
    names = [g.name for g in decision.gates if not g.passed]
    out = [f"{n}: {', '.join(evidence.abreast)}" if n == "ahead" and evidence.abreast else n for n in names]
    return tuple(out) or ("agrees within what is material",)


def _varied(h: Hypothesis, start: Start) -> tuple[str, ...]:
    one, two = h.kind.grown(start, 1.0), h.kind.grown(start, 2.0)
    return tuple(key for key in one if one[key] != two[key])


def _told(stand: Stand, h: Hypothesis, status: str, **more: Any) -> Foreseen:
    units = {f.name: f.metadata["unit"] for f in parameter_fields(h.kind)}
    if h.place == "channel":
        own = next(c.unit for c in stand.network.outputs if c.name == h.where[0])
        units = {k: own if u == "unit of the channel" else u for k, u in units.items()}
    for key in ("smallest", "seen"):
        if key in more:
            more[key] = {k: Amount(float(v), units.get(k, "")) for k, v in more[key].items() if k in units}
    where = owner_pair(stand.network, h) or h.where
    return Foreseen(h.label, h.effect, tuple(where), tuple(h.choices.items()), status, **more)


# -------------------------------------------------------------------------------------------------------- sensors


def best_test(
    network: Network,
    rig: Rig,
    noise: Array,
    *,
    only: Sequence[str] = (),
    progress: Say | None = None,
) -> Design | None:
    """The test within `rig` that tells most of the hypotheses from one another, each as large as a twentieth of the force
    under a multisine over all of the band.

    noise (channels,): RMS of the outputs [their units]. only: as for `plan`. None where no test can be simulated.
    """
    say = progress or (lambda name, share: None)
    known = {c.name: float(s) for c, s in zip(network.outputs, noise, strict=True)}
    every = [e for e in candidates(network, rig) if e.level == 1.0]
    usual = default(network, rig)
    first = Stand(network, [_brief(network, rig, usual)], noise=known)
    begun = starts_of(first, list(hypotheses(first.network)), 1)
    wanted = set(chosen(network, only))
    rated = []
    for k, e in enumerate([usual, *every]):
        say("tests", k / (len(every) + 1))
        try:
            stand = Stand(network, [_brief(network, rig, e)], noise=known)
            sizes = _needed_sizes(Field(stand, begun), (), wanted)
        except BROKEN:
            continue
        score = float(np.mean(-np.log(np.clip(sizes, 0.05, 20.0)))) if len(sizes) else -9.0
        rated.append((score, e, int(np.sum(sizes <= 1.0)), len(sizes)))
    say("tests", 1.0)
    if not rated:
        return None
    _, e, told, of = max(rated, key=lambda r: r[0])
    before = rated[0][2] if rated[0][1] is usual else 0
    record = record_of(network, rig, e, "designed")
    return Design(e, rig, record, e.describe(network, rig), tried=len(every), told=(told, before, of))


def _brief(network: Network, rig: Rig, e: Excitation) -> Record:
    record = record_of(network, rig, e)
    return record if len(record) <= BRIEF else record.part(0, BRIEF, record.name)


def sensor_gains(field_: Field, say: Say) -> Iterator[Sensor]:
    """What each sensor that is not there would bring, best first, by the linear reckoning."""
    now = _needed_sizes(field_, ())
    found = []
    for k, c in enumerate(field_.more):
        say("sensors", k / len(field_.more))
        then = _needed_sizes(field_, (k,))
        told = int(np.sum((now > FAR) & (then <= FAR)))
        both = (now <= FAR) & (then <= FAR)
        factor = float(np.exp(np.median(np.log(now[both] / then[both])))) if both.any() else 1.0
        where = "-".join(c.between) if c.between else c.at or " and ".join(c.elements)
        noise = float(field_.noise[len(field_.stand.noise) + k])
        found.append(Sensor(c.name, c.quantity, where, noise, c.unit, told, factor))
    say("sensors", 1.0)
    yield from sorted(found, key=lambda s: (-s.told, -s.factor))


def _needed_sizes(field_: Field, extra: Sequence[int], wanted: Container[Hypothesis] | None = None) -> Array:
    """The size of each typical shape, in those of its start, from which noise lets it be told from everything."""
    left, size = field_.left(extra), field_.size(extra)
    distance, _ = field_.apart(left, size)
    groups = field_.rivals()
    out = []
    for t, k in enumerate(field_.typical):
        s = field_.shapes[k]
        if wanted is not None and s.hypothesis not in wanted:
            continue
        a = s.columns[0]
        least = math.sqrt(max(left[a, a], 0.0))
        for r, ks in groups.items():
            if _rival(field_.stand, r, s.hypothesis):
                least = min(least, float(distance[t, ks].min()))
        floor = NOTHING * size[a]
        out.append(math.sqrt(NEEDED) / least if least > floor and least > 0 else math.inf)
    return np.array(out)


__all__ = ["Foreseen", "Plan", "Rig", "Sensor", "plan"]
