"""Scores of the candidates of a search on the same held-out records, whitened with the same filters."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from .._simulation.problem import BROKEN

if TYPE_CHECKING:
    from collections.abc import Sequence

    from ..._common.arrays import Array
    from .candidate import Candidate
    from .held_out import HeldOutEvaluator, HeldOutScore

#: candidates of a stage that are compared with the best
RIVALS = 6


@dataclass(eq=False)
class CandidateComparison:
    """Scores of the candidates of a search, whitened with the filters of the candidate with most effects."""

    evaluator: HeldOutEvaluator
    #: the refitted nominal model, then candidates with one more effect each
    path: Sequence[Candidate]
    #: candidates that were fitted at each stage, best first
    stages: list[list[Candidate]]
    #: candidate whose effects all passed; the refitted nominal model where none did
    chosen: Candidate = field(init=False)
    #: best candidate with an effect, passed or not; the refitted nominal model if no effect was fitted
    foremost: Candidate = field(init=False)
    notes: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.chosen = self.foremost = self.refitted
        self._scores: dict[Candidate, HeldOutScore] = {}
        self._similar = self.evaluator.score_path(self.path)
        self.filters = self.evaluator.whitener(self.richest)
        #: noise of each channel on the validation records, as a share of the deviation (channels,)
        self.noise = self.evaluator.noise_share(self.score(self.richest))
        #: mean whitened square of pure noise
        self.noise_score = self.evaluator.expected_noise_score(self.score(self.richest), self.filters)

    @property
    def refitted(self) -> Candidate:
        """The refitted nominal model."""
        return self.path[0]

    @property
    def richest(self) -> Candidate:
        """The candidate with every effect that was added."""
        return self.path[-1]

    def score(self, candidate: Candidate) -> HeldOutScore:
        """Return the score of a candidate."""
        if candidate not in self._scores:
            self._scores[candidate] = self.evaluator.score(candidate, self.filters, self._similar)
        return self._scores[candidate]

    def can_score(self, candidate: Candidate) -> bool:
        """Return whether the held-out records can be simulated with a candidate."""
        try:
            self.score(candidate)
        except BROKEN:
            return False
        return True

    def excess_loss(self, candidate: Candidate) -> float:
        """Return the mean whitened square beyond noise, and at least a hundredth of that of noise."""
        return max(self.score(candidate).mean_square - self.noise_score, 0.01 * self.noise_score)

    # -- explained fractions ------------------------------------------------------------------------------
    def explained_fraction(self, before: HeldOutScore, after: HeldOutScore) -> float:
        """Return the share of the excess error of one score that another removes: of the whitened error, or of the plain error if that
        falls by more."""
        whitened = (before.mean_square - after.mean_square) / max(
            before.mean_square - self.noise_score, 1e-12
        )
        noise = np.maximum(self.noise, 1e-12)
        top = float(np.sum((before.nrmse**2 - after.nrmse**2) / noise**2))
        excess = float(np.sum(np.maximum(before.nrmse**2 - self.noise**2, 0.0) / noise**2))
        return max(whitened, top / max(excess, 1e-12))

    def explained(self, candidate: Candidate, envelope: Array) -> float:
        """Return the share of the refitted model's excess error that a candidate removes, in all and in the channel with the widest gap
        over the envelope (channels,)."""
        refit, after = self.score(self.refitted), self.score(candidate)
        before, left = refit.excess(self.noise) ** 2, after.excess(self.noise) ** 2
        return min(self.explained_fraction(refit, after), _removed_where_widest(before, left, envelope))

    def explained_on_training(self, before: HeldOutScore, after: HeldOutScore, envelope: Array) -> float:
        """Return the same share on the training records, in the channel with the widest gap."""
        e = self.evaluator
        noise = self.noise * e.validation_deviation / e.training_deviation
        powers = [np.maximum(e.training_nrmse(x.candidate) ** 2 - noise**2, 0.0) for x in (before, after)]
        return _removed_where_widest(powers[0], powers[1], envelope)

    def explained_on_test(self, candidate: Candidate) -> float:
        """Return the share of the refitted model's excess error that a candidate removes on the test records."""
        refit, after = self.score(self.refitted), self.score(candidate)
        return after.explained_on_test(refit, self.test_noise, self.noise_score)

    def test_excess_ratio(self, candidate: Candidate, envelope: Array) -> float:
        """Return the largest ratio, over channels, of the power left on the test records to the power of unmodelled effects."""
        left = np.maximum(self.score(candidate).test_nrmse ** 2 - self.test_noise**2, 0.0)
        return float(np.max(left / envelope**2))

    @property
    def test_noise(self) -> Array:
        """Noise of the test records as a share of the deviation there (channels,)."""
        return self.evaluator.test_noise(self.noise)

    # -- candidates ---------------------------------------------------------------------------------------
    def rivals(self) -> list[Candidate]:
        """Return the candidates with as many effects as the foremost one, at most `RIVALS`."""
        count = len(self.foremost.hypotheses)
        stage = self.stages[count - 1][:RIVALS] if 0 < count <= len(self.stages) else []
        return [r for r in stage if r is not self.foremost and self.can_score(r)]

    def candidates(self) -> list[Candidate]:
        """Return the chosen and the foremost candidate, the path, and at most `RIVALS` candidates of each stage."""
        stages = [r for stage in self.stages for r in stage[:RIVALS]]
        return list(dict.fromkeys([self.chosen, self.foremost, *self.path, *stages]))


def _removed_where_widest(before: Array, left: Array, envelope: Array) -> float:
    """Return the removed share of the power in the channel with the largest power relative to the envelope."""
    widest = int(np.argmax(before / envelope**2))
    return 1.0 - float(left[widest] / max(before[widest], 1e-12))
