"""A fitted set of effects, and fits that are weighted with the noise of their own residuals."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from ...physics import elements as el
from .._estimation.gauss_newton import Fit, Fitter, residuals
from .._estimation.noise import (
    Filters,
    Weights,
    deviance_of,
    filters_of,
    independent_share,
    trusted_noise,
    weights_of,
    white_weights,
)

if TYPE_CHECKING:
    from ..._common.arrays import Array
    from .._estimation.structure import Hypothesis, Structure
    from .._simulation.problem import Problem


#: decrease of the deviance (2 log L) below which a fit with its own noise has converged
CONVERGED = 2.0


@dataclass(frozen=True, eq=False)
class Candidate:
    """A fitted set of effects."""

    fit: Fit
    #: -2 log L on the training records
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


def deviance(problem: Problem, fit: Fit, least: Array, share: Array) -> float:
    """Return -2 log L of a fit on its records, without constants, with the prior. `least`: smallest noise (channels,); `share`: share of
    independent samples (channels,)."""
    return deviance_of(residuals(problem, fit), least, share) + fit.prior


def share_of(problem: Problem, fit: Fit) -> Array:
    """Return the share of independent samples (channels,) in the residuals of a fit."""
    return independent_share(residuals(problem, fit))


def filters_for(problem: Problem, fit: Fit, least: Array) -> Filters:
    """Return filters that whiten the residuals of a fit, limited by white noise of at least `least` (channels,)."""
    left = residuals(problem, fit)
    return filters_of(left, trusted_noise(left, least))


def weights_for(problem: Problem, fit: Fit, least: Array) -> Weights:
    """Return weights by the level of the residuals of a fit, at least `least` (channels,)."""
    return weights_of(residuals(problem, fit), least)


def settle(
    problem: Problem,
    structure: Structure,
    x: Array,
    least: Array,
    fit: Fit | None = None,
    *,
    rounds: int = 3,
    iterations: int = 6,
    share: Array | None = None,
) -> Candidate:
    """Fit a structure with filters and with weights from its residuals in turn until the deviance stops falling. Filters act like a
    prediction over few samples, with fewer optima; levels suit a model that misses much.

    `least`: smallest noise (channels,); `fit`: the start, or only initial states and offsets if of another structure; `share`: share of independent samples (channels,), by default that of the start
    or of the first fit."""
    if fit is None or fit.structure is not structure:
        weights = white_weights(least) if fit is None else weights_for(problem, fit, least)
        initial, offset = (None, None) if fit is None else (fit.initial, fit.offset)
        fit = Fitter(problem, weights).fit(structure, x, initial, offset, iterations=iterations)
    share = share_of(problem, fit) if share is None else share
    best = Candidate(fit, deviance(problem, fit, least, share))
    for _ in range(rounds):
        before = best.deviance
        for make in (filters_for, weights_for):
            f = best.fit
            fitter = Fitter(problem, make(problem, f, least))
            f = fitter.fit(structure, f.x, f.initial, f.offset, iterations=iterations)
            value = deviance(problem, f, least, share)
            best = Candidate(f, value) if value < best.deviance else best
        if best.deviance > before - CONVERGED:
            break
    return best


def transfer(problem: Problem, fit: Fit, least: Array) -> Fit:
    """Return a fit, unchanged, on the samples of `problem`: other samples of the same records."""
    return Fitter(problem, white_weights(least)).fit(
        fit.structure, fit.x, fit.initial, fit.offset, records=list(fit.initial), iterations=0
    )


def parameter_values(element: el.Element) -> dict[str, float]:
    """Return the parameters of an element by name."""
    return {f.name: getattr(element, f.name) for f in el.parameter_fields(type(element))}


def is_special_case(general: Hypothesis, special: Hypothesis) -> bool:
    """Return whether the law of `special` is a special case of the law of `general`, at the same place."""
    there = set(general.where) == set(special.where) and general.behind == special.behind
    return special.effect in general.kind.contains and there
