"""A fitted set of effects, and its fit to self-consistency under its own coloured noise."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from ... import elements as el
from ...errors import InputError
from ..estimation.gauss_newton import Fit, Fitter, residuals
from ..estimation.noise import finer, innovations, plain, trust, whitener
from ..estimation.structure import Hypothesis, Structure, rebuilt
from ..hypotheses.motion import motions

if TYPE_CHECKING:
    from collections.abc import Sequence

    from ..simulation.problem import Array, Problem

#: what a fit or a simulation that breaks down raises
BROKEN = (InputError, np.linalg.LinAlgError)


@dataclass(frozen=True, eq=False)
class Candidate:
    """A set of effects as it was fitted. `likelihood`: -2 log L on the records to fit by, under its own coloured noise."""

    fit: Fit
    likelihood: float

    @property
    def hypotheses(self) -> tuple[Hypothesis, ...]:
        return self.fit.structure.hypotheses

    @property
    def label(self) -> str:
        return " and ".join(h.label for h in self.hypotheses) or "the model refitted"

    @property
    def elements(self) -> list[el.Element]:
        """The elements that it adds, at their fitted values."""
        network = self.fit.network
        return [network.element(name) for name in self.fit.structure.names]

    def well_formed(self, last: bool = False) -> bool:
        """Whether its effects (or the last one) are what their names say."""
        return all(e.well_formed() for e in (self.elements[-1:] if last else self.elements))


def likelihood(problem: Problem, fit: Fit, white: Array) -> float:
    """-2 log L (but for a constant) of a fit on its records, the parameters' prior included."""
    return innovations(residuals(problem, fit), white) + fit.prior


def reckoned(problem: Problem, fit: Fit, floors: Array) -> Array:
    """White noise to reckon with (channels,) when weights are taken from what this fit leaves."""
    return trust(residuals(problem, fit), floors)


def settled(
    problem: Problem,
    structure: Structure,
    x: Array,
    floors: Array,
    fit: Fit | None = None,
    *,
    rounds: int = 3,
    iterations: int = 6,
    least: Array | None = None,
) -> Candidate:
    """Fit with weights from the fit's own residual, until the likelihood under own coloured noise stops falling.

    `least`: white noise to reckon with; that of the first round where it is not given.
    """
    initial = offset = None
    if fit is not None:
        initial, offset = fit.initial, fit.offset
        least = reckoned(problem, fit, floors) if least is None else least
    W = plain(floors) if fit is None or least is None else whitener(residuals(problem, fit), least)
    best: Candidate | None = None
    for _ in range(rounds):
        f = Fitter(problem, W).fit(structure, x, initial, offset, iterations=iterations)
        least = reckoned(problem, f, floors) if least is None else least
        value = likelihood(problem, f, finer(least, floors))
        enough = best is not None and value > best.likelihood - 2.0
        if best is None or value < best.likelihood:
            best = Candidate(f, value)
        if enough:
            break
        x, initial, offset = f.x, f.initial, f.offset
        W = whitener(residuals(problem, f), least)
    assert best is not None
    return best


def transferred(problem: Problem, fit: Fit, floors: Array) -> Fit:
    """A fit as it stands, on other samples of the same records."""
    return Fitter(problem, plain(floors)).fit(
        fit.structure, fit.x, fit.initial, fit.offset, records=list(fit.initial), iterations=0
    )


def begun_again(
    problem: Problem, r: Candidate, shape: int | None, factor: float, floors: Array, least: Array
) -> Candidate | None:
    """A candidate fitted once more with free number `shape` begun at `factor` times its value; None where that leads
    back to where it was, or nowhere. Where it leads is seen on as few samples as the motion needs."""
    rough, x = Fitter(problem.rough, plain(least)), r.fit.x.copy()
    if shape is None:
        return None
    x[shape] += math.log(factor)
    try:
        there = rough.cost(r.fit.structure, r.fit.x, r.fit.initial, r.fit.offset, problem.estimation)
        begun = rough.fit(r.fit.structure, x, r.fit.initial, r.fit.offset, iterations=6)
        back = abs(begun.x[shape] - r.fit.x[shape]) < 0.3 * abs(math.log(factor))
        if back or begun.cost + begun.prior > 1.5 * there + r.fit.prior:
            return None
        f = begun if problem.rough is problem else transferred(problem, begun, floors)
        return settled(problem, f.structure, f.x, floors, f, iterations=4, least=least)
    except BROKEN:
        return None


def level(problem: Problem, candidate: Candidate, best: Candidate, floors: Array) -> float:
    """-2 log L of a candidate, with the noise that `best` leaves to be reckoned with."""
    return likelihood(problem, candidate.fit, finer(reckoned(problem, best.fit, floors), floors))


def values_of(element: el.Element) -> dict[str, float]:
    return {f.name: getattr(element, f.name) for f in el.parameter_fields(type(element))}


def simpler(problem: Problem, candidate: Candidate) -> list[tuple[Hypothesis, Structure]]:
    """What a set of effects becomes with one of them left out, or replaced by a special case of it.

    Each with the hypothesis that went, starting from the values found.
    """
    network = candidate.fit.network
    found = [(h, values_of(e)) for h, e in zip(candidate.hypotheses, candidate.elements, strict=True)]
    motion = motions(problem, candidate.fit)
    out = []
    for k, (h, values) in enumerate(found):
        swaps: list[list[tuple[Hypothesis, dict[str, float]]]] = [[]] if len(found) > 1 else []
        here = {e.type for e in el.beside(network, h.where)}
        for simple in h.kind.contains:
            if simple in here:  # that would be another value of a parameter which is known
                continue
            special = h.kind.special(simple, values, motion.get((h.where[0], h.where[-1])))
            plainer = replace(
                h, effect=simple, options=(), behind=h.behind if el.TYPES[simple].series else ""
            )
            if plainer.behind and not plainer.stands(problem.network):
                continue
            swaps.append([(plainer, special)])
        for swap in swaps:
            try:
                out.append((h, rebuilt(problem.network, [*found[:k], *swap, *found[k + 1 :]])))
            except (*BROKEN, KeyError, StopIteration):
                continue
    return out


def relative(general: Hypothesis, special: Hypothesis) -> bool:
    """Whether the first holds the second as a special case, at the same place."""
    there = set(general.where) == set(special.where) and general.behind == special.behind
    return special.effect in general.kind.contains and there


def akin(some: Sequence[Hypothesis], others: Sequence[Hypothesis]) -> bool:
    """Whether two sets of effects are the same, in whatever order, but for special cases of one another."""
    rest = list(others)
    for h in some:
        twin = next((q for q in rest if q == h or relative(q, h) or relative(h, q)), None)
        if twin is None:
            return False
        rest.remove(twin)
    return not rest


def simplest_first(ranked: list[Candidate], chance: float, sure: float) -> list[Candidate]:
    """Of relatives that fit as well, the one with fewer parameters leads.

    `chance` (2 log L): what a richer relative may gain for nothing; `sure`: what one that is not what its name says may.
    """
    if not ranked:
        return ranked
    best = ranked[0]
    for r in ranked[1:]:
        behind = r.likelihood - best.likelihood
        mimic = not best.well_formed(last=True) and r.well_formed(last=True) and behind < sure
        if mimic or (relative(best.hypotheses[-1], r.hypotheses[-1]) and behind < chance):
            return [r, *(q for q in ranked if q is not r)]
    return ranked


def with_fit(candidate: Candidate, fit: Fit, value: float) -> Candidate:
    return replace(candidate, fit=fit, likelihood=value)
