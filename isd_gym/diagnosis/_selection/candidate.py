"""A fitted set of effects, and fits that are weighted with the noise of their own residuals."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from ...physics import elements as el
from .._estimation.gauss_newton import Fit, Fitter, residuals
from .._estimation.noise import innovations, refined_noise, trusted_noise, white_filters, whitener
from .._estimation.structure import Hypothesis, Structure, rebuilt
from .._hypotheses.motion import motions
from .._simulation.problem import BROKEN
from .admissibility import is_admissible, travels

if TYPE_CHECKING:
    from collections.abc import Sequence

    from ..._common.arrays import Array
    from .._simulation.problem import Problem


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

    @property
    def freedom(self) -> int:
        """Number of fitted parameters and of fitted start values of the states: an inner state that no sensor shows is free in each record."""
        return len(self.fit.x) + sum(len(state) for state in self.fit.initial.values())

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
