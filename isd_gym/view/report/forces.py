"""Forces between two nodes over the motion of the nodes: measured, reconstructed from residuals, and simulated."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from ..._common.errors import InputError
from ..._common.units import convert
from ...diagnosis._estimation.gauss_newton import Fitter
from ...diagnosis._estimation.noise import white_weights
from ...diagnosis._estimation.structure import base_structure
from ...diagnosis._hypotheses.forces import element_forces
from ...diagnosis._hypotheses.library import pairs
from ...diagnosis._hypotheses.motion import motions
from ...diagnosis._hypotheses.pair_forces import Deconvolution
from ...diagnosis._simulation.problem import Problem, Record
from ...physics import elements as el
from ...physics.network import GROUND, Network
from ...physics.simulate import pace

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from ..._common.arrays import Array
    from ...diagnosis.result import Diagnosis, Effect, Trace

#: share of a record at either end in which the reconstruction fades out
TAPER = 20
#: points of a law over its axis
GRID = 1601


@dataclass(frozen=True)
class Curve:
    """A force over the motion of its terminals, sample by sample."""

    travel: Array  # elongation (n,) [m]
    rate: Array  # rate of elongation (n,) [m/s]
    force: Array  # force (n,) [N], positive in tension

    def part(self, samples: slice) -> Curve:
        """Return the curve of some samples."""
        return Curve(self.travel[samples], self.rate[samples], self.force[samples])


@dataclass(frozen=True)
class Loops:
    """The force between two nodes in the measurement and in the models, over the motion of the nodes."""

    name: str  # name of the force in words
    pair: tuple[str, str]  # the two nodes
    samples: slice  # samples of the record that the curves contain
    measured: Curve  # measured force, or the force that the residuals require
    nominal: (
        Curve | None
    )  # force of the model as given; None where it cannot be simulated
    new: Curve  # force of the completed model, or of the refitted model where nothing is added
    is_measured: bool  # whether a channel measures the force


@dataclass(frozen=True)
class Law:
    """Force of an effect over elongation or rate, with its 95 % band."""

    element: str  # name of the element in the new model
    kind: str  # 'rate' or 'travel'
    axis: Array  # rate [m/s] or elongation [m] (n,)
    force: Array  # force [N] (n,)
    low: Array  # lower end of the band [N] (n,)
    high: Array  # upper end of the band [N] (n,)
    visited: Array  # operating points of the completed model, in the unit of `axis`


@dataclass(frozen=True)
class Cloud:
    """Force between two nodes that the measurements require, sample by sample, over the motion of the nodes."""

    pair: tuple[str, str]  # the two nodes
    #: force of the completed model's elements minus that of the refitted model's elements, over rate or
    #: travel, with its band; None without a law over the motion of the pair
    law: Law | None
    effects: tuple[str, ...]  # names of the effects
    travel: Array  # elongation (n,) [m]
    rate: Array  # rate of elongation (n,) [m/s]
    before: Array  # force in addition to the refitted model (n,) [N]
    after: (
        Array | None
    )  # force in addition to the model with the result (n,) [N]; None without a result
    loops: Loops  # the whole force between the nodes


def laws_of(d: Diagnosis, trace: Trace) -> list[Law]:
    """Return the curves of the named effects, or of the table of a force, where a law over rate or elongation gives them."""
    out = []
    for effect in d.effects:
        if effect.between is None:
            continue
        e = d.model.element(effect.element)
        if e.place != "between" or e.plane == "time":
            continue
        try:
            motion = _simulated(d.model, trace, e.between)
        except (InputError, np.linalg.LinAlgError):
            continue
        visited = motion.rate if e.plane == "rate" else motion.travel
        reach = float(np.quantile(np.abs(visited), 0.999)) or 1e-6
        axis = np.linspace(-reach, reach, GRID)
        middle = e.curve(axis)
        spread = np.zeros(GRID)
        for key, q in effect.parameters.items():
            for value in (q.low, q.high):
                try:
                    changed = d.model.with_parameters({f"{e.name}.{key}": value})
                except InputError:
                    continue
                spread = np.maximum(
                    spread, np.abs(changed.element(e.name).curve(axis) - middle)
                )
        kind = "rate" if e.plane == "rate" else "travel"
        out.append(
            Law(e.name, kind, axis, middle, middle - spread, middle + spread, visited)
        )
    t = d.tabulated
    if t is not None:
        try:
            motion = _simulated(d.model, trace, t.between)
        except (InputError, np.linalg.LinAlgError):
            return out
        kind, axis, visited = "travel", np.array(t.elongation), motion.travel
        if t.over == "rate":
            kind, axis, visited = "rate", np.array(t.rate), motion.rate
        out.append(Law(t.element, kind, axis, t.force, t.low, t.high, visited))
    return out


def clouds(d: Diagnosis, trace: Trace, found: Iterable[Law]) -> list[Cloud]:
    """Return a cloud for every pair of nodes with an effect, or for the best candidate."""
    laws = {law.element: law for law in found}
    pairs: dict[tuple[str, str], list[Effect]] = {}
    for e in d.effects:
        kind = el.TYPES.get(e.effect)
        if (
            e.between is not None
            and e.element in laws
            and kind is not None
            and kind.place == "between"
        ):
            pairs.setdefault((e.between[0], e.between[1]), []).append(e)
    if d.tabulated is not None and d.tabulated.element in laws:
        pairs[d.tabulated.between] = []
    elif not d.effects:
        first = d.best_candidate or next(iter(d.alternatives), None)
        where = first.where[-1] if first else ()
        if len(where) == 2:
            pairs[(where[0], where[1])] = []
    out = []
    for pair, effects in pairs.items():
        try:
            names = [e.element for e in effects] or (
                [d.tabulated.element] if d.tabulated else []
            )
            cloud = _cloud(d, trace, pair, [laws[n] for n in names], effects)
        except (InputError, np.linalg.LinAlgError):
            continue
        if cloud is not None:
            out.append(cloud)
    return out


def _cloud(
    d: Diagnosis,
    trace: Trace,
    pair: tuple[str, str],
    laws: list[Law],
    effects: list[Effect],
) -> Cloud | None:
    base, refitted, model = d.base, d.refitted, d.model
    if not set(pair) <= {*refitted.nodes, GROUND}:
        return None
    names = [c.name for c in refitted.outputs if c.name in trace.refit]
    noise = {
        n: d.gap["noise_floor"][n] * float(np.std(trace.measured[n])) for n in names
    }
    response = Deconvolution.of(
        refitted, pair, trace.time, {n: trace.measured[n] for n in names}
    )
    before, moved = response.force(
        {n: trace.measured[n] - trace.refit[n] for n in names}, noise
    )
    after, is_new = None, bool(d.effects or d.tabulated)
    if is_new:
        after, _ = response.force(
            {n: trace.measured[n] - trace.after[n] for n in names}, noise
        )
    series = [e.element for e in effects if el.TYPES[e.effect].series]
    seen = _simulated(model if is_new else refitted, trace, pair, series)
    travel, rate, whole = seen.travel, seen.rate, seen.force
    if after is not None:
        whole = whole + after
    else:  # motion of the old model, plus the motion due to the missing force
        travel, rate = travel + moved[:, 0], rate + moved[:, 1]
        whole = whole + before + _static(refitted, pair, travel, rate)
        whole = whole - _static(refitted, pair, seen.travel, seen.rate)
    edge = max(1, len(trace.time) // TAPER)
    keep = slice(edge, len(trace.time) - edge)
    loops = Loops(
        "force", pair, keep, Curve(travel, rate, whole).part(keep), _nominal(base, trace, pair, keep),
        seen.part(keep), is_measured=False,
    )  # fmt: skip
    law = None if series else _difference(refitted, model, pair, laws)
    kinds = tuple(e.effect for e in effects)
    rest = None if after is None else after[keep]
    return Cloud(pair, law, kinds, travel[keep], rate[keep], before[keep], rest, loops)


def _simulated(
    network: Network, trace: Trace, pair: tuple[str, str], series: Sequence[str] = ()
) -> Curve:
    """Return the motion of two nodes of a model that starts like a record, and their force with that of elements in series."""
    network = replace(network, uncertainty={})
    step = float(trace.time[1] - trace.time[0])
    measured = np.stack([trace.measured[c.name] for c in network.outputs], axis=1)
    problem = Problem(network, [Record(trace.name, step, trace.inputs, measured)])
    fit = Fitter(problem, white_weights(measured.std(axis=0))).fit(
        base_structure(network), frozen=True, iterations=3
    )
    found = motions(problem, fit, () if pair[::-1] in pairs(network) else (pair,))
    if pair in found:
        m, sign = found[pair], 1.0
    elif pair[::-1] in found:
        m, sign = found[pair[::-1]], -1.0
    else:
        raise InputError(f"no motion between {pair[0]} and {pair[1]}")
    force = np.zeros(len(m.d))
    for name, values in element_forces(problem, fit, pair).items():
        if network.element(name).mechanism != "drive":
            force = force + values
    for name in series:
        where = network.element(name).between
        along = 1.0 if where[0] == pair[0] or where[1] == pair[1] else -1.0
        force = force + along * element_forces(problem, fit, where)[name]
    return Curve(sign * m.d, sign * m.v, force)


def _nominal(
    base: Network, trace: Trace, pair: tuple[str, str], keep: slice
) -> Curve | None:
    """Return the force of the model as given between two nodes; None where the simulation breaks down."""
    try:
        return _simulated(base, trace, pair).part(keep)
    except (InputError, np.linalg.LinAlgError):
        return None


def _over(
    elements: Iterable[el.Element], pair: tuple[str, str], kind: str, axis: Array
) -> Array:
    """Return the sum of the forces between two nodes that depend on rate, or on travel, alone."""
    plane, total = {"rate": "rate", "travel": "elongation"}[kind], np.zeros(len(axis))
    for e in elements:
        if e.place == "between" and e.plane == plane and not e.series:
            if e.where == pair:
                total = total + e.curve(axis)
            elif e.where == pair[::-1]:
                total = total - e.curve(-axis)
    return total


def _static(
    network: Network, pair: tuple[str, str], travel: Array, rate: Array
) -> Array:
    """Return the force of the elements between two nodes at a motion, without elements with memory."""
    total = np.zeros(len(travel))
    for kind, x in (("travel", travel), ("rate", rate)):
        axis = np.linspace(float(x.min()), float(x.max()) + 1e-12, GRID)
        total = total + np.interp(x, axis, _over(network.elements, pair, kind, axis))
    return total


def _difference(
    refitted: Network, model: Network, pair: tuple[str, str], laws: list[Law]
) -> Law | None:
    """Return the force that the completed model has in addition to the refitted model, with the bands of the laws.

    A law that replaces an element counts as its difference to that element, and so do parallel elements with other parameters.
    """
    same = [law for law in laws if law.kind == laws[0].kind]
    if not same:
        return None
    axis, kind = same[0].axis, same[0].kind
    parts = [
        np.stack([np.interp(axis, w.axis, y - w.force) for y in (w.low, w.high)])
        for w in same
    ]
    low, high = np.sum(parts, axis=0)
    own = np.sum([np.interp(axis, w.axis, w.force) for w in same], axis=0)
    others = [e for e in model.elements if e.name not in {w.element for w in same}]
    force = (
        own
        + _over(others, pair, kind, axis)
        - _over(refitted.elements, pair, kind, axis)
    )
    return Law(
        same[0].element, kind, axis, force, force + low, force + high, same[0].visited
    )


# --------------------------------------------------------------------------------------------- measured forces


def measured_loops(d: Diagnosis, trace: Trace) -> list[Loops]:
    """Return the loops of every measured force whose terminals have a measured or simulated motion."""
    out = []
    for name, pair, factor in _force_channels(d.base):
        if name not in trace.measured:
            continue
        try:
            out.append(_loops_of(d, trace, name, pair, factor))
        except (InputError, np.linalg.LinAlgError):
            continue
    return out


def _force_channels(network: Network) -> Iterator[tuple[str, tuple[str, str], float]]:
    """Yield the measured forces: channel, terminals, and SI value of its unit."""
    driven = {c.at for c in network.moving}
    for c in network.outputs:
        if c.quantity != "force":
            continue
        places = {network.element(e).between for e in c.elements}
        if len(places) == 1:
            yield c.name, places.pop(), convert(1.0, c.unit, c.si)
        elif not places and c.at in driven:
            yield c.name, (str(c.at), GROUND), convert(1.0, c.unit, c.si)


def _loops_of(
    d: Diagnosis, trace: Trace, name: str, pair: tuple[str, str], factor: float
) -> Loops:
    step = float(trace.time[1] - trace.time[0])
    simulated = _simulated(d.model, trace, pair)
    at = _displacement(d.base, pair)

    def curve(values: dict[str, Array], motion: Curve) -> Curve:
        travel, rate = motion.travel, motion.rate
        if at is not None and at[0] in values:
            travel = at[1] * values[at[0]]
            rate = _rate(travel, step)
        return Curve(travel, rate, factor * values[name])

    try:
        nominal = curve(trace.before, _simulated(d.base, trace, pair))
    except (InputError, np.linalg.LinAlgError):
        nominal = None
    return Loops(
        name, pair, slice(0, len(trace.time)), curve(trace.measured, simulated), nominal,
        curve(trace.after, simulated), is_measured=True,
    )  # fmt: skip


def _displacement(network: Network, pair: tuple[str, str]) -> tuple[str, float] | None:
    """Return the output that measures the elongation of a pair, and its SI value with the sign of the pair."""
    for c in network.outputs:
        ends = c.between or (
            (c.at, GROUND) if c.at is not None and not c.axis else None
        )
        if c.quantity == "displacement" and ends is not None and set(ends) == set(pair):
            return c.name, convert(1.0, c.unit, c.si) * (
                1.0 if tuple(ends) == pair else -1.0
            )
    return None


def _rate(travel: Array, step: float) -> Array:
    """Return the rate of a measured travel, smoothed over a tenth of the period of the motion."""
    from scipy.signal import savgol_filter

    width = 2 * round(0.1 * np.pi * pace(travel, step) / step) + 1
    width = min(max(width, 5), len(travel) - 1 + len(travel) % 2)
    return np.asarray(savgol_filter(travel, width, 2, deriv=1, delta=step), np.float64)


def loops_of(d: Diagnosis, trace: Trace, found: Iterable[Cloud]) -> list[Loops]:
    """Return the loops to draw, those at the places of the finding first: measured forces, and the forces at the places of the
    finding that no channel measures.
    """
    own = measured_loops(d, trace)
    at = [set(cloud.pair) for cloud in found]
    return [
        *(x for x in own if set(x.pair) in at),
        *(
            cloud.loops
            for cloud in found
            if set(cloud.pair) not in [set(x.pair) for x in own]
        ),
        *(x for x in own if set(x.pair) not in at),
    ]
