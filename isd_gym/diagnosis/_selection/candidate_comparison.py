"""Sets of laws of a search, scored on the same held-out records with the same weights."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from .._simulation.problem import BROKEN

if TYPE_CHECKING:
    from collections.abc import Mapping

    from ..._common.arrays import Array
    from .answer import Answer
    from .candidate import Candidate
    from .criteria import Criteria
    from .held_out import HeldOutEvaluator, HeldOutScore
    from .held_out_table import Row

#: sets beside the foremost one that the result lists
RIVALS = 6


@dataclass(eq=False)
class CandidateComparison:
    """Scores of the sets of a search, weighted by the residuals of the set with the smallest error."""

    evaluator: HeldOutEvaluator
    criteria: Criteria
    #: the refitted nominal model
    refitted: Candidate
    #: candidate of each row of the search, by the row's id
    candidates: Mapping[int, Candidate]
    answer: Answer
    #: the simplest set of the band; else the best set with a law; the refitted nominal model if no law was fitted
    foremost: Candidate = field(init=False)

    def __post_init__(self) -> None:
        self._scores: dict[Candidate, HeldOutScore] = {}
        self.foremost = self.of(self.answer.simplest if self.answer.band else self.answer.best)
        #: the set with the smallest error
        self.richest = self.of(self.answer.best)
        self._similar = self.evaluator.score_path([self.refitted])
        self.weights = self.evaluator.weights(self.richest)
        #: noise of each channel on the validation records, as a share of the deviation (channels,)
        self.noise = self.evaluator.noise_share(self.score(self.richest))
        #: mean weighted square of pure noise
        self.noise_score = self.evaluator.expected_noise_score(self.score(self.richest), self.weights)

    def give_up(self) -> None:
        """Keep the refitted model alone."""
        refit = self.answer.refit
        self.answer = replace(self.answer, band=(), weights=(), best=refit)
        self.foremost = self.richest = self.refitted

    def of(self, row: Row) -> Candidate:
        """Return the candidate of a row."""
        return self.candidates[id(row)]

    def score(self, candidate: Candidate) -> HeldOutScore:
        """Return the score of a candidate."""
        if candidate not in self._scores:
            self._scores[candidate] = self.evaluator.score(candidate, self.weights, self._similar)
        return self._scores[candidate]

    def can_score(self, candidate: Candidate) -> bool:
        """Return whether the held-out records can be simulated with a candidate."""
        try:
            self.score(candidate)
        except BROKEN:
            return False
        return True

    def rivals(self) -> list[Candidate]:
        """Return the other sets of the band, the simplest first, at most `RIVALS`."""
        others = [self.of(row) for row in self.answer.band]
        return [r for r in others if r is not self.foremost and self.can_score(r)][:RIVALS]

    def indistinguishable(self) -> list[Candidate]:
        """Return the sets of the band with another kind or place."""
        own = self.answer.simplest.kinds
        return [self.of(row) for row in self.answer.band if row.kinds != own][:RIVALS]

    def unmodelled_envelope(self, candidate: Candidate) -> Array:
        """Return the excess error of unmodelled effects (channels,), as a share of the deviation."""
        return self.evaluator.unmodelled_envelope(
            candidate, self.criteria.small_effect, self.criteria.material
        )

    # -- explained fractions ------------------------------------------------------------------------------
    def explained_fraction(self, before: HeldOutScore, after: HeldOutScore) -> float:
        """Return the share of a score's excess error that the second score removes: the larger one of weighted and plain error."""
        weighted = (before.mean_square - after.mean_square) / max(
            before.mean_square - self.noise_score, 1e-12
        )
        noise = np.maximum(self.noise, 1e-12)
        top = float(np.sum((before.nrmse**2 - after.nrmse**2) / noise**2))
        excess = float(np.sum(np.maximum(before.nrmse**2 - self.noise**2, 0.0) / noise**2))
        return max(weighted, top / max(excess, 1e-12))

    def explained(self, candidate: Candidate) -> float:
        """Return the share of the refitted model's excess error that a candidate removes, in all and in the channel with the widest gap."""
        refit, after = self.score(self.refitted), self.score(candidate)
        powers = [x.excess(self.noise) ** 2 for x in (refit, after)]
        return min(self.explained_fraction(refit, after), self._removed_where_widest(self.refitted, *powers))

    def explained_on_training(self, before: Candidate, after: Candidate) -> float:
        """Return the share of the excess error of a candidate that another removes on the training records, in the channel with the widest
        gap."""
        e = self.evaluator
        noise = self.noise * e.validation_deviation / e.training_deviation
        powers = [np.maximum(e.training_nrmse(x) ** 2 - noise**2, 0.0) for x in (before, after)]
        return self._removed_where_widest(before, *powers)

    def _removed_where_widest(self, before: Candidate, power: Array, left: Array) -> float:
        """Return the removed share of a power (channels,) in the channel with the largest one relative to the envelope of unmodelled
        effects, since friction lets some channels drift."""
        widest = int(np.argmax(power / self.unmodelled_envelope(before) ** 2))
        return 1.0 - float(left[widest] / max(power[widest], 1e-12))

    def explained_on_test(self, candidate: Candidate) -> float:
        """Return the share of the refitted model's excess error that a candidate removes on the test records."""
        refit, after = self.score(self.refitted), self.score(candidate)
        return after.explained_on_test(refit, self.test_noise, self.noise_score)

    @property
    def test_noise(self) -> Array:
        """Noise of the test records as a share of the deviation there (channels,)."""
        return self.evaluator.test_noise(self.noise)
