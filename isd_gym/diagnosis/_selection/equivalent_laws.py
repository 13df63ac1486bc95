"""Replacement of fitted laws by others with nearly the same force, or at places that move alike: a check against local optima."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from scipy.optimize import least_squares

from ...physics import elements as el
from .._estimation.structure import Hypothesis, Structure, in_line, rebuilt, twin
from .._hypotheses.forces import element_forces, place_forces
from .._hypotheses.library import hypotheses
from .._hypotheses.motion import motions, setting
from .._simulation.problem import BROKEN
from .admissibility import is_admissible, travels
from .candidate import Candidate, parameter_values
from .criteria import CRITERIA

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

    from ..._common.arrays import Array
    from ...physics.network import Network
    from .._simulation.problem import Problem
    from .criteria import Criteria

    Effect = tuple[Hypothesis, dict[str, float]]

POINTS = 240  # of the motion at which forces are compared: a resolution
NEAR = 0.5  # largest error of a match, as a share of the force
MAX_MATCHES = 3  # matches per effect
STARTS = 6  # of a law at most
EVALUATIONS = 60  # of a law per start
TRAVEL = 0.95  # share of the samples that define the travel: rare excursions show no repetition
ALIKE = 0.25  # largest difference of two motions that a fit bridges, as a share of the motion


def equivalent_structures(
    problem: Problem, candidate: Candidate, c: Criteria = CRITERIA
) -> Iterator[Structure]:
    """Replace each law of a candidate by other laws with nearly the same force, best match first, and by itself at places that move
    alike."""
    found = [(h, parameter_values(e)) for h, e in zip(candidate.hypotheses, candidate.elements, strict=True)]
    motion, forces = motions(problem, candidate.fit), place_forces(problem, candidate.fit)
    known = travels(problem, problem.network, motion)
    for k, element in enumerate(candidate.elements):
        m = motion.get(element.between) if element.place == "between" else None
        if m is not None:
            elsewhere = _places_alike(problem, candidate.hypotheses[k], motion)
            yield from _rebuild(problem, ([*found[:k], (h, found[k][1]), *found[k + 1 :]] for h in elsewhere))
        # without visible repetition a periodic law is a mere curve
        is_part_of_period = bool(m and not repeats(element, m, c))
        if m is None or not (is_part_of_period or _plain_curve(type(element))):
            continue
        # a part of a period is steep, whatever the stiffness beside it
        uncertain = {path.rpartition(".")[0] for path in problem.network.uncertainty}
        beside = [e for e in el.beside(problem.network, element.where) if e.plane == element.plane]
        absorbing = [e for e in beside if e.name in uncertain] if is_part_of_period else []
        # special and general cases of the same law are compared elsewhere
        others = [
            h
            for h in curves(problem, element)
            if is_admissible(h, known)
            and element.type not in h.kind.contains
            and h.effect not in (element.type, *element.contains)
        ]
        matches = _match_laws(problem, others, [element], m, forces.at, absorbing)
        yield from _rebuild(problem, ([*found[:k], match, *found[k + 1 :]] for match in matches))


def _places_alike(
    problem: Problem, h: Hypothesis, motion: Mapping[tuple[str, str], el.Motion]
) -> list[Hypothesis]:
    """Return an effect at other places that move as its own place does, such as the other end of a stiff shaft."""
    if h.kind.series:
        return []
    own = motion.get((h.where[0], h.where[-1]))
    if own is None:
        return []
    out = []
    for other in hypotheses(problem.network):
        there = motion.get((other.where[0], other.where[-1]))
        is_same = other.effect == h.effect and other.options == h.options
        if not is_same or there is None or other.where == h.where:
            continue
        alike = ((there.d - there.d.mean(), own.d - own.d.mean()), (there.v, own.v))
        if all(el.rms(a - b) < ALIKE * el.rms(b) for a, b in alike):
            out.append(other)
    return out


def joint_structures(problem: Problem, candidate: Candidate) -> Iterator[Structure]:
    """Replace several laws over one plane at one place by a single law, and several series laws along one line by one of them."""
    found = [(h, parameter_values(e)) for h, e in zip(candidate.hypotheses, candidate.elements, strict=True)]
    motion, forces = motions(problem, candidate.fit), place_forces(problem, candidate.fit)
    groups: dict[tuple[tuple[str, str], object], list[int]] = {}
    for k, e in enumerate(candidate.elements):
        # a function of the rate has no memory
        if e.place == "between" and e.between in motion and (_plain_curve(type(e)) or e.plane == "rate"):
            groups.setdefault((e.between, e.plane), []).append(k)
    for (pair, _), members in groups.items():
        if len(members) < 2:
            continue
        laws = [candidate.elements[k] for k in members]
        matches = _match_laws(problem, curves(problem, laws[0]), laws, motion[pair], forces.at)
        rest = [effect for k, effect in enumerate(found) if k not in members]
        yield from _rebuild(problem, ([*rest, match] for match in matches))
    yield from _rebuild(problem, _series_alone(problem.network, found))


def _series_alone(network: Network, found: Sequence[Effect]) -> Iterator[list[Effect]]:
    """Yield the effects with one series law, at every link of its line, in place of all series laws along the line."""
    links = [tuple(twin(n, network.nodes) for n in h.where) for h, _ in found]
    for k, (h, values) in enumerate(found):
        line = [
            j
            for j, (other, _) in enumerate(found)
            if other.kind.series and in_line(network, links[k], links[j])
        ]
        if not h.kind.series or len(line) < 2:
            continue
        rest = [effect for j, effect in enumerate(found) if j not in line]
        for other in hypotheses(network):
            if other.effect == h.effect and not other.behind and in_line(network, links[k], other.where):
                yield [*rest, (other, values)]


def _rebuild(problem: Problem, variants: Iterator[list[Effect]]) -> Iterator[Structure]:
    """Yield the owner's model with each set of effects, unless the effects cannot be added."""
    for effects in variants:
        try:
            yield rebuilt(problem.network, effects)
        except (*BROKEN, KeyError, StopIteration):
            continue


def curves(problem: Problem, like: el.Element) -> Iterator[Hypothesis]:
    """Yield the laws without memory at the place of `like` and over the same plane."""
    for h in hypotheses(problem.network):
        there = h.place == "between" and set(h.where) == set(like.where) and h.kind.plane == like.plane
        if there and _plain_curve(h.kind):
            yield h


def repeats(element: el.Element, motion: el.Motion, c: Criteria = CRITERIA) -> bool:
    """Return False for a periodic law with fewer than `Criteria.periods` periods within the travel."""
    if not element.periodic:
        return True
    low, high = np.quantile(motion.d, [0.5 - 0.5 * TRAVEL, 0.5 + 0.5 * TRAVEL])
    return bool(c.periods * getattr(element, element.periodic[0]) <= high - low)


def is_sound(problem: Problem, candidate: Candidate, c: Criteria = CRITERIA) -> bool:
    """Return whether the values of a candidate's effects agree with their names: periods repeat, and laws differ from limits with another
    name."""
    if not candidate.well_formed():
        return False
    default = el.Element.differs_from_limit
    asked = [
        e
        for e in candidate.elements
        if e.place == "between" and (e.periodic or type(e).differs_from_limit is not default)
    ]
    if not asked:
        return True
    motion = motions(problem, candidate.fit)  # a simulation
    return all(
        repeats(e, motion[e.between], c) and e.differs_from_limit(motion[e.between])
        for e in asked
        if e.between in motion
    )


def force_difference(problem: Problem, candidate: Candidate, other: Candidate, effect: int) -> float:
    """Return the RMS difference of the force of an effect and of the law that replaces it, over the former, along the motion with the
    effect; infinite if the laws are at different places or in series."""
    new = next(j for j, h in enumerate(other.hypotheses) if h not in candidate.hypotheses)
    one, two = candidate.elements[effect], other.elements[new]
    motion = motions(problem, candidate.fit).get(one.between) if one.place == "between" else None
    if motion is None or two.place != "between" or two.where != one.where or one.series or two.series:
        return math.inf

    def force(law: el.Element, owner: Candidate) -> Array:
        if law.plane in ("rate", "elongation") and type(law).curve is el.Element.curve:
            return law.curve(motion.v if law.plane == "rate" else motion.d)
        return element_forces(problem, owner.fit, law.where)[law.name]

    try:
        first, second = force(one, candidate), force(two, other)
    except BROKEN:
        return math.inf
    return float(el.rms(first - second) / max(el.rms(first), 1e-300))


def _plain_curve(kind: type[el.Element]) -> bool:
    """Return whether the force is a curve over the plane: without memory and without local optima of the fit."""
    return kind.plane != "time" and not kind.series and kind.curve is el.Element.curve and not kind.periodic


def _match_laws(
    problem: Problem,
    laws: Iterable[Hypothesis],
    found: Sequence[el.Element],
    motion: el.Motion,
    force_at: Callable[[Sequence[str]], float],
    absorbing: Sequence[el.Element] = (),
) -> list[Effect]:
    """Return at most `MAX_MATCHES` laws with an error below `NEAR`, best first, matched to the total force of elements over one plane,
    beside the coefficients of `absorbing` laws. `force_at`: typical force [N] of a place."""
    travel = motion.v if found[0].plane == "rate" else motion.d
    axis = np.sort(travel[:: max(1, len(travel) // POINTS)])
    target = np.sum([e.curve(axis) for e in found], axis=0)
    scale, basis = el.rms(target), np.zeros((len(axis), 0))
    if absorbing:
        basis, _ = np.linalg.qr(np.stack([e.curve(axis) for e in absorbing], axis=1))
    near: list[tuple[float, Effect]] = []
    for h in laws:

        def residual(values: dict[str, float], h: Hypothesis = h) -> Array:
            law = h.kind(name="trial", where=h.where, **values, **dict(h.options))
            difference = (law.curve(axis) - target) / scale
            return np.asarray(difference - basis @ (basis.T @ difference), dtype=np.float64)

        starts = h.kind.starts(setting(problem, problem.network, h, motion, force_at(h.where)))[:STARTS]
        match = match_law(h.kind, (s.values for s in starts), residual)
        if match is not None and match[0] < NEAR:
            near.append((match[0], (h, match[1])))
    return [effect for _, effect in sorted(near, key=lambda t: t[0])[:MAX_MATCHES]]


def match_law(
    kind: type[el.Element],
    starts: Iterable[Mapping[str, float]],
    residual: Callable[[dict[str, float]], Array],
) -> tuple[float, dict[str, float]] | None:
    """Return the RMS error and the values of the best match of a law's free parameters to a curve over several starts; None if no fit
    succeeds. Parameters with a minimum of zero or more are fitted by their logarithm."""
    matches = [m for start in starts if (m := _match_from(start, kind, residual)) is not None]
    return min(matches, key=lambda m: m[0], default=None)


def _match_from(
    start: Mapping[str, float], kind: type[el.Element], residual: Callable[[dict[str, float]], Array]
) -> tuple[float, dict[str, float]] | None:
    """Return the fit from one start; None where it breaks down."""
    free = [f for f in el.parameter_fields(kind) if not f.metadata["fixed"] and f.name in start]
    unit = [max(abs(start[f.name]), 1e-12) for f in free]
    log = [f.metadata["minimum"] >= 0 for f in free]

    def values_at(x: Array) -> dict[str, float]:
        scaled = (u * math.exp(min(v, 50.0)) if lg else u * v for u, v, lg in zip(unit, x, log, strict=True))
        return {**start, **dict(zip([f.name for f in free], map(float, scaled), strict=True))}

    x0 = np.array([0.0 if lg else 1.0 for lg in log])
    try:
        fit = least_squares(lambda x: residual(values_at(x)), x0, max_nfev=EVALUATIONS)
    except (*BROKEN, ValueError, OverflowError):
        return None
    return el.rms(fit.fun), values_at(fit.x)
