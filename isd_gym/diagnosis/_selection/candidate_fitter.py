"""Fits of candidates: the nominal model refitted, and simpler structures fitted from the values of a richer one."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

from .._estimation.gauss_newton import Fitter, gap, residuals
from .._estimation.initial_states import transfer_states
from .._estimation.multiple_shooting import fit_segments, is_lightly_damped
from .._estimation.noise import white_filters, whitener
from .._estimation.structure import Structure, base_structure
from .._simulation.problem import BROKEN
from .._simulation.time_limit import TimeUp, running
from .candidate import Candidate, deviance_with_noise_of, settle, transfer, white_noise

if TYPE_CHECKING:
    from ..._common.arrays import Array
    from .criteria import Criteria
    from .held_out import HeldOutEvaluator

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
                s, training = similar.fit, p.estimation
                if f.cost > worst * e.coarse_fitter.cost(s.structure, s.x, s.initial, s.offset, training):
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
