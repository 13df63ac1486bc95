"""Other laws at the place of a found one, begun from where they give the same force: one fit may hide in a place of its own."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from scipy.optimize import least_squares

from .. import elements as el
from .candidate import BROKEN, Candidate, values_of
from .forces import place_forces
from .hypotheses import hypotheses
from .motion import motions, setting
from .structure import Hypothesis, Structure, rebuilt

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from .problem import Array, Problem

POINTS = 240  # of the motion at which forces are compared
NEAR = 0.5  # share of the found force that an imitation may miss
MOST = 3  # imitations of one effect
PERIODS = 1.5  # of a law that must lie within the travel: one alone is any curve that goes up and down again
MOSTLY = 0.95  # share of the samples that lie within the travel that counts


def imitations(problem: Problem, candidate: Candidate) -> Iterator[Structure]:
    """The candidate with one of its laws replaced by another that gives nearly the same force over the motion at hand."""
    found = [(h, values_of(e)) for h, e in zip(candidate.hypotheses, candidate.elements, strict=True)]
    motion, forces = motions(problem, candidate.fit), place_forces(problem, candidate.fit)
    for k, element in enumerate(candidate.elements):
        m = motion.get(element.between) if element.place == "between" else None
        # of what repeats, and does not do so within the travel, only a curve is left
        curve = bool(m and not repeats(element, m))
        if m is None or not (curve or _plain_curve(type(element))):
            continue
        # an arc of a wave is steep, whatever spring it lies on
        own = _yielding(problem, element) if curve else []
        near: list[tuple[float, Hypothesis, dict[str, float]]] = []
        for h in curves(problem, element):
            # special and general cases of one law are weighed against one another elsewhere
            if element.type in h.kind.contains or h.effect in (element.type, *element.contains):
                continue
            fitted = _imitate(h, [element], setting(problem, problem.network, h, m, forces.at(h.where)), own)
            if fitted is not None and fitted[0] < NEAR:
                near.append((fitted[0], h, fitted[1]))
        for _, h, values in sorted(near, key=lambda t: t[0])[:MOST]:
            try:
                yield rebuilt(problem.network, [*found[:k], (h, values), *found[k + 1 :]])
            except (*BROKEN, KeyError, StopIteration):
                continue


def joined(problem: Problem, candidate: Candidate) -> Iterator[Structure]:
    """The candidate with one law for several over one plane at one place: begun from the values of one of those, it may end in a
    place of its own."""
    found = [(h, values_of(e)) for h, e in zip(candidate.hypotheses, candidate.elements, strict=True)]
    motion, forces = motions(problem, candidate.fit), place_forces(problem, candidate.fit)
    alike: dict[tuple[object, ...], list[int]] = {}
    for k, e in enumerate(candidate.elements):
        # what is a function of the rate has no memory
        if e.place == "between" and e.between in motion and (_plain_curve(type(e)) or e.plane == "rate"):
            alike.setdefault((e.between, e.plane), []).append(k)
    for members in alike.values():
        several = [candidate.elements[k] for k in members]
        if len(several) < 2:
            continue
        near: list[tuple[float, Hypothesis, dict[str, float]]] = []
        for h in curves(problem, several[0]):
            at = setting(problem, problem.network, h, motion[several[0].between], forces.at(h.where))
            fitted = _imitate(h, several, at)
            if fitted is not None and fitted[0] < NEAR:
                near.append((fitted[0], h, fitted[1]))
        rest = [effect for k, effect in enumerate(found) if k not in members]
        for _, h, values in sorted(near, key=lambda t: t[0])[:MOST]:
            try:
                yield rebuilt(problem.network, [*rest, (h, values)])
            except (*BROKEN, KeyError, StopIteration):
                continue


def curves(problem: Problem, like: el.Element) -> Iterator[Hypothesis]:
    """The laws whose force is a curve over the plane of `like`, at its place."""
    for h in hypotheses(problem.network):
        there = h.place == "between" and set(h.where) == set(like.where) and h.kind.plane == like.plane
        if there and _plain_curve(h.kind):
            yield h


def repeats(element: el.Element, motion: el.Motion) -> bool:
    """Whether an element is not periodic, or shows enough periods within the travel for that to be seen."""
    if not element.periodic:
        return True
    # where the motion rarely goes, nothing is seen twice
    low, high = np.quantile(motion.d, [0.5 - 0.5 * MOSTLY, 0.5 + 0.5 * MOSTLY])
    return bool(PERIODS * getattr(element, element.periodic[0]) <= high - low)


def sound(problem: Problem, candidate: Candidate) -> bool:
    """Whether its effects are what their names say, and what repeats is seen to."""
    waves = [e for e in candidate.elements if e.periodic and e.place == "between"]
    if not waves or not candidate.well_formed():
        return candidate.well_formed()
    there = motions(problem, candidate.fit)  # a simulation
    return all(e.between not in there or repeats(e, there[e.between]) for e in waves)


def apart(problem: Problem, candidate: Candidate, other: Candidate, effect: int) -> float:
    """By how much the force of one effect differs from that of the law in its place (RMS, share); 0 where no curve tells."""
    new = next(j for j, h in enumerate(other.hypotheses) if h not in candidate.hypotheses)
    one, two = candidate.elements[effect], other.elements[new]
    motion = motions(problem, candidate.fit).get(one.between) if one.place == "between" else None
    if motion is None or one.plane not in ("rate", "elongation") or two.plane != one.plane:
        return 0.0
    axis = motion.v if one.plane == "rate" else motion.d
    force = one.curve(axis)
    return float(el.rms(force - two.curve(axis)) / max(el.rms(force), 1e-300))


def _plain_curve(kind: type[el.Element]) -> bool:
    """Whether its force is a curve over its plane, without memory, and has one optimum."""
    return kind.plane != "time" and not kind.series and kind.curve is el.Element.curve and not kind.periodic


def _yielding(problem: Problem, element: el.Element) -> list[el.Element]:
    """The owner's laws at the same place and over the same plane that are not known for sure: they take up what differs."""
    loose = {path.rpartition(".")[0] for path in problem.network.uncertainty}
    here = [e for e in el.beside(problem.network, element.where) if e.plane == element.plane]
    return [e for e in here if e.name in loose]


def _imitate(
    h: Hypothesis, found: Sequence[el.Element], at: el.Setting, own: Sequence[el.Element] = ()
) -> tuple[float, dict[str, float]] | None:
    """(share of the force that is missed, values) of the best imitation of what was `found`, over one plane, by another law.

    own: laws beside it that may give more or less than they do.
    """
    travel = at.moves.v if h.kind.plane == "rate" else at.moves.d
    axis = np.sort(travel[:: max(1, len(travel) // POINTS)])
    target = np.sum([e.curve(axis) for e in found], axis=0)
    scale = el.rms(target)
    taken, _ = (
        np.linalg.qr(np.stack([e.curve(axis) for e in own], axis=1)) if own else (np.zeros((len(axis), 0)), 0)
    )
    free = [f for f in el.parameter_fields(h.kind) if not f.metadata["fixed"]]
    log = [f.metadata["minimum"] >= 0 for f in free]
    best: tuple[float, dict[str, float]] | None = None
    for start in h.kind.starts(at)[:6]:
        fixed = {k: v for k, v in start.values.items() if k not in {f.name for f in free}}
        unit = [max(abs(start.values[f.name]), 1e-12) for f in free]

        def values_at(
            x: Array, fixed: dict[str, float] = fixed, unit: list[float] = unit
        ) -> dict[str, float]:
            values = (
                u * math.exp(min(v, 50.0)) if lg else u * v for u, v, lg in zip(unit, x, log, strict=True)
            )
            return fixed | dict(zip([f.name for f in free], map(float, values), strict=True))

        def miss(x: Array, values_at: Callable[..., dict[str, float]] = values_at) -> Array:
            curve = h.kind(name="trial", where=h.where, **values_at(x), **dict(h.options)).curve(axis)
            apart = (curve - target) / scale
            return np.asarray(apart - taken @ (taken.T @ apart), dtype=np.float64)

        x0 = np.array([0.0 if lg else 1.0 for lg in log])
        try:
            done = least_squares(miss, x0, max_nfev=60)
        except (*BROKEN, ValueError, OverflowError):
            continue
        share = el.rms(done.fun)
        if best is None or share < best[0]:
            best = share, values_at(done.x)
    return best
