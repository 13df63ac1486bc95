"""A fitted set of effects, and fits that are weighted with the noise of their own residuals."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

from ...physics import elements as el
from .._estimation.gauss_newton import Fit, Fitter, Point, gap, residuals
from .._estimation.initial_states import transfer_states
from .._estimation.multiple_shooting import fit_segments, is_lightly_damped
from .._estimation.noise import innovations, refined_noise, trusted_noise, white_filters, whitener
from .._estimation.structure import Hypothesis, Structure, base_structure, rebuilt
from .._hypotheses.motion import motions
from .._simulation.problem import BROKEN
from .._simulation.time_limit import TimeUp, running
from .admissibility import is_admissible, travels

if TYPE_CHECKING:
    from collections.abc import Sequence

    from ..._common.arrays import Array
    from .._simulation.problem import Problem
    from .criteria import Criteria
    from .held_out import HeldOutEvaluator


#: decrease of the deviance (2 log L) below which a fit with its own noise has converged
CONVERGED = 2.0


@dataclass(frozen=True, eq=False)
class Candidate:
    """A fitted set of effects."""

    fit: Fit
    #: -2 log L on the training records, under the coloured noise of the residuals
    deviance: float

    @property
    def hypotheses(self) -> tuple[Hypothesis, ...]:
        """Effects and places."""
        return self.fit.structure.hypotheses

    @property
    def label(self) -> str:
        """Effects and places in words."""
        return " and ".join(h.label for h in self.hypotheses) or "the model refitted"

    @property
    def elements(self) -> list[el.Element]:
        """The elements of the effects, with fitted values."""
        network = self.fit.network
        return [network.element(name) for name in self.fit.structure.names]

    def well_formed(self, last: bool = False) -> bool:
        """Return whether the values of the effects agree with the effects' names."""
        return all(e.well_formed() for e in (self.elements[-1:] if last else self.elements))


def deviance(problem: Problem, fit: Fit, noise: Array) -> float:
    """Return -2 log L of a fit on its records, without constants, with the prior and with white noise (channels,) added to that of the
    residuals."""
    return innovations(residuals(problem, fit), noise) + fit.prior


def white_noise(problem: Problem, fit: Fit, least: Array) -> Array:
    """Return the white noise (channels,) of weights that are taken from the residuals of a fit, at least `least` (channels,)."""
    return trusted_noise(residuals(problem, fit), least)


def settle(
    problem: Problem,
    structure: Structure,
    x: Array,
    least: Array,
    fit: Fit | None = None,
    *,
    rounds: int = 3,
    iterations: int = 6,
    noise: Array | None = None,
) -> Candidate:
    """Fit a structure repeatedly, with weights from the residuals and the white noise (channels,) of the first fit, until the deviance
    stops falling; `fit` is the start."""
    initial = offset = None
    if fit is not None:
        initial, offset = fit.initial, fit.offset
        noise = white_noise(problem, fit, least) if noise is None else noise
    filters = (
        white_filters(least) if fit is None or noise is None else whitener(residuals(problem, fit), noise)
    )
    best: Candidate | None = None
    for _ in range(rounds):
        f = Fitter(problem, filters).fit(structure, x, initial, offset, iterations=iterations)
        noise = white_noise(problem, f, least) if noise is None else noise
        value = deviance(problem, f, refined_noise(noise, least))
        has_converged = best is not None and value > best.deviance - CONVERGED
        if best is None or value < best.deviance:
            best = Candidate(f, value)
        if has_converged:
            break
        x, initial, offset = f.x, f.initial, f.offset
        filters = whitener(residuals(problem, f), noise)
    assert best is not None
    return best


def transfer(problem: Problem, fit: Fit, least: Array) -> Fit:
    """Return a fit, unchanged, on the samples of `problem`: other samples of the same records."""
    return Fitter(problem, white_filters(least)).fit(
        fit.structure, fit.x, fit.initial, fit.offset, records=list(fit.initial), iterations=0
    )


def deviance_with_noise_of(problem: Problem, candidate: Candidate, best: Candidate, least: Array) -> float:
    """Return -2 log L of a candidate, with the white noise that the candidate `best` leaves, at least `least` (channels,)."""
    return deviance(problem, candidate.fit, refined_noise(white_noise(problem, best.fit, least), least))


def parameter_values(element: el.Element) -> dict[str, float]:
    """Return the parameters of an element by name."""
    return {f.name: getattr(element, f.name) for f in el.parameter_fields(type(element))}


def simpler_structures(problem: Problem, candidate: Candidate) -> list[tuple[Hypothesis, Structure]]:
    """Return the structures with one effect left out, or replaced by a special case of its law, each with the effect."""
    network = candidate.fit.network
    found = [(h, parameter_values(e)) for h, e in zip(candidate.hypotheses, candidate.elements, strict=True)]
    motion = motions(problem, candidate.fit)
    known = travels(problem, problem.network, motion)
    out = []
    for k, (h, values) in enumerate(found):
        swaps: list[list[tuple[Hypothesis, dict[str, float]]]] = [[]] if len(found) > 1 else []
        here = {e.type for e in el.beside(network, h.where)}
        for simple in h.kind.contains:
            if simple in here:  # another value of a known parameter
                continue
            special = h.kind.special(simple, values, motion.get((h.where[0], h.where[-1])))
            plainer = replace(
                h, effect=simple, options=(), behind=h.behind if el.TYPES[simple].series else ""
            )
            if plainer.behind and not plainer.stands(problem.network):
                continue
            if not is_admissible(plainer, known):
                continue
            swaps.append([(plainer, special)])
        for swap in swaps:
            try:
                out.append((h, rebuilt(problem.network, [*found[:k], *swap, *found[k + 1 :]])))
            except (*BROKEN, KeyError, StopIteration):
                continue
    return out


def is_special_case(general: Hypothesis, special: Hypothesis) -> bool:
    """Return whether the law of `special` is a special case of the law of `general`, at the same place."""
    there = set(general.where) == set(special.where) and general.behind == special.behind
    return special.effect in general.kind.contains and there


def same_effects(some: Sequence[Hypothesis], others: Sequence[Hypothesis]) -> bool:
    """Return whether two sets of effects are the same in any order; a law and its special case count as the same effect."""
    rest = list(others)
    for h in some:
        match = next((q for q in rest if q == h or is_special_case(q, h) or is_special_case(h, q)), None)
        if match is None:
            return False
        rest.remove(match)
    return not rest


def simplest_first(ranked: list[Candidate], chance: float, sure: float) -> list[Candidate]:
    """Move the simplest candidate that fits as well as the best one to the front: special cases within `chance`, sound values within
    `sure` (2 log L)."""
    seen: list[Candidate] = []
    while ranked and ranked[0] not in seen:
        best = ranked[0]
        seen.append(best)
        for r in ranked[1:]:
            behind = r.deviance - best.deviance
            is_imitation = not best.well_formed(last=True) and r.well_formed(last=True) and behind < sure
            if is_imitation or (is_special_case(best.hypotheses[-1], r.hypotheses[-1]) and behind < chance):
                ranked = [r, *(q for q in ranked if q is not r)]
                break
    return ranked


#: a refit whose plain error is larger by this factor than the smallest of all refits is in another local optimum
ASTRAY = 1.1


@dataclass(frozen=True, eq=False)
class CandidateFitter:
    """Fits candidates to the training records."""

    evaluator: HeldOutEvaluator
    criteria: Criteria

    @cached_property
    def is_lightly_damped(self) -> bool:
        """Whether the motion lasts for many periods, so that a fit to whole records may lose the phase."""
        return is_lightly_damped(self.evaluator.problem.network)

    def refit_nominal(self) -> Candidate:
        """Refit the nominal model within its stated uncertainty from the nominal values and, where the motion is lightly damped, from
        segments; the nominal model where every refit errs more on the training records."""
        p, least = self.evaluator.problem, self.evaluator.least_noise
        structure = base_structure(p.network)
        found = [settle(p, structure, structure.start, least)]
        try:
            again = self.from_segments(structure, structure.start, found[0])
            found += [again] if again is not None else []
        except TimeUp:
            limit = running()
            if limit is not None:
                limit.leave_out("further starts of the refit")
            return found[0]
        gaps = [gap(p, c.fit) for c in found]
        near = [c for c, g in zip(found, gaps, strict=True) if g <= ASTRAY * min(gaps)]
        best = min(near, key=lambda c: c.deviance)
        nominal = self.nominal()
        # else every refit has lost the motion
        return best if gap(p, nominal.fit) >= min(gaps) / ASTRAY else nominal

    def nominal(self) -> Candidate:
        """Return the nominal model with its own parameters, as a start of fits."""
        p, least = self.evaluator.problem, self.evaluator.least_noise
        structure = base_structure(p.network)
        nominal = Fitter(p, white_filters(least)).follow(structure, structure.start, p.estimation)
        return settle(p, structure, structure.start, least, nominal, iterations=0)

    def from_segments(
        self, structure: Structure, x: Array, similar: Candidate, noise: Array | None = None
    ) -> Candidate | None:
        """Fit a structure from a fit to brief segments, weighted by the residuals of a similar candidate; None where the motion is
        strongly damped."""
        p, least = self.evaluator.problem, self.evaluator.least_noise
        if p.network.inputs and not self.is_lightly_damped:
            return None
        noise = white_noise(p, similar.fit, least) if noise is None else noise
        try:
            start = fit_segments(p, structure, x, Fitter(p, whitener(residuals(p, similar.fit), noise)))
            return None if start is None else settle(p, structure, start, least, rounds=2, noise=noise)
        except BROKEN:
            return None

    def deviance_gain(self, candidate: Candidate, other: Candidate) -> float:
        """Return by how much the deviance of a candidate is below that of another one, with the candidate's noise (2 log L)."""
        p, least = self.evaluator.problem, self.evaluator.least_noise
        own, theirs = (deviance_with_noise_of(p, c, candidate, least) for c in (candidate, other))
        return theirs - own

    def refit(self, structure: Structure, similar: Candidate, worst: float = math.inf) -> Candidate | None:
        """Return the best fit of a simpler or equivalent structure from the values of a fitted candidate, then from nominal ones; None
        where its error on few samples is above `worst` times the candidate's (in power)."""
        e, p, least = self.evaluator, self.evaluator.problem, self.evaluator.least_noise
        noise = white_noise(p, similar.fit, least)
        near = deviance_with_noise_of(p, similar, similar, least) + self.criteria.deviance_gain
        own = zip(similar.fit.structure.free, similar.fit.x, strict=True)
        known = {f.path: v for f, v in own if f.owner < 0}
        x = structure.start_from(known)
        found: list[Candidate] = []
        try:
            initial = transfer_states(p, similar.fit.network, similar.fit.initial, structure)
            f = e.coarse_fitter.fit(structure, x, initial, similar.fit.offset)
            if worst < math.inf:  # the cost of the candidate on as few samples
                s = similar.fit
                at = e.coarse_fitter.seen(s.structure, Point(s.x, s.initial, s.offset), p.estimation)
                if f.cost > worst * at.total:
                    return None
            f = f if p.rough is p else transfer(p, f, least)
            found.append(settle(p, structure, f.x, least, f, rounds=2, noise=noise))
        except BROKEN:
            pass
        try:
            if not found or found[0].deviance > near:
                found.append(settle(p, structure, structure.start, least, rounds=2, noise=noise))
            if min(c.deviance for c in found) > near:
                again = self.from_segments(structure, x, similar, noise)
                found += [again] if again is not None else []
            return min(found, key=lambda c: c.deviance)
        except (*BROKEN, ValueError):
            return None
