"""Fits of candidates on a problem: the owner's model refitted, special cases and parts of what was found begun anew."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from .candidate import BROKEN, Candidate, level, reckoned, settled, transferred
from .fit import Fitter, residuals
from .initial import carried
from .noise import whitener
from .shooting import begun, remembers
from .structure import Structure, base_structure

if TYPE_CHECKING:
    from .criteria import Criteria
    from .judge import Judge
    from .problem import Array, Problem
    from .settings import SearchSettings

Say = Callable[[str], None]


class Refits:
    """A problem, its judge, and the numbers that steer and decide; how candidates are fitted again."""

    def __init__(self, judge: Judge, settings: SearchSettings, criteria: Criteria, say: Say):
        self.judge, self.settings, self.criteria, self.say = judge, settings, criteria, say
        self.problem: Problem = judge.problem
        self.floors: Array = judge.floors
        self.slight = remembers(judge.problem.network)

    def refitted(self) -> Candidate:
        """The owner's model with the parameters that it holds moved within their stated uncertainty."""
        structure = base_structure(self.problem.network)
        found = settled(self.problem, structure, structure.start, self.floors)
        again = self.by_stretches(structure, structure.start, found)
        return again if again is not None and again.likelihood < found.likelihood else found

    def by_stretches(
        self, structure: Structure, x: Array, like: Candidate, least: Array | None = None
    ) -> Candidate | None:
        """A fit that begins where one over brief stretches ends; None where the motion is soon forgotten, or that breaks down."""
        p = self.problem
        if not self.slight:
            return None
        least = reckoned(p, like.fit, self.floors) if least is None else least
        try:
            there = begun(p, structure, x, Fitter(p, whitener(residuals(p, like.fit), least)))
            return None if there is None else settled(p, structure, there, self.floors, rounds=2, least=least)
        except BROKEN:
            return None

    def worth(self, candidate: Candidate) -> Array:
        return self.judge.worth(candidate, self.criteria.small, self.criteria.material)

    def loss(self, other: Candidate, best: Candidate) -> float:
        """By how much `other` is the less likely one (2 log L), with the noise that `best` leaves."""
        return level(self.problem, other, best, self.floors) - level(self.problem, best, best, self.floors)

    def anew(self, structure: Structure, like: Candidate, outrun: float = math.inf) -> Candidate | None:
        """A fit from the start values of `structure`, a simpler form of `like`; None where it breaks down.

        `outrun`: or where, seen roughly, it errs so many times as much (in power).
        """
        p, least = self.problem, reckoned(self.problem, like.fit, self.floors)
        near = level(p, like, like, self.floors) + self.criteria.deviance_gain
        # the owner's parameters as they are there; what was added begins as `structure` says
        own = zip(like.fit.structure.free, like.fit.x, strict=True)
        known = {f.path: v for f, v in own if f.owner < 0}
        there = np.array([known.get(f.path, v) for f, v in zip(structure.free, structure.start, strict=True)])
        found: list[Candidate] = []
        try:  # from where it is, and, where that ends far off, from what the owner believes
            initial = carried(p, like.fit.network, like.fit.initial, structure)
            f = self.judge.rough.fit(structure, there, initial, like.fit.offset)
            if outrun < math.inf and f.cost > outrun * self.roughly(like):
                return None
            f = f if p.rough is p else transferred(p, f, self.floors)
            found.append(settled(p, structure, f.x, self.floors, f, rounds=2, least=least))
        except BROKEN:
            pass
        try:
            if not found or found[0].likelihood > near:
                found.append(settled(p, structure, structure.start, self.floors, rounds=2, least=least))
            if min(c.likelihood for c in found) > near:
                again = self.by_stretches(structure, there, like, least)
                found += [again] if again is not None else []
            return min(found, key=lambda c: c.likelihood)
        except (*BROKEN, ValueError):
            return None

    def roughly(self, candidate: Candidate) -> float:
        """What a candidate costs on no more samples than the motion needs."""
        fit = candidate.fit
        return self.judge.rough.cost(fit.structure, fit.x, fit.initial, fit.offset, self.problem.estimation)
