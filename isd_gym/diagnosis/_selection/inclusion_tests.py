"""Decisions about two candidates: which predicts better, whether an effect is needed, which candidates are rivals."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from .._estimation.gauss_newton import gap
from .._estimation.structure import in_line, twin
from .candidate import Candidate, is_special_case
from .comparison import compare
from .criteria import Criteria, is_material
from .equivalent_laws import force_difference, is_sound
from .held_out import HeldOutEvaluator, error_reduction

if TYPE_CHECKING:
    from collections.abc import Sequence

    from ..._common.arrays import Array
    from .candidate_comparison import CandidateComparison


@dataclass(frozen=True, eq=False)
class InclusionTests:
    """Tests of candidates on held-out records."""

    evaluator: HeldOutEvaluator
    criteria: Criteria

    def unmodelled_envelope(self, candidate: Candidate) -> Array:
        """Return the excess error of unmodelled effects (channels,), as a share of the deviation."""
        c = self.criteria
        return self.evaluator.unmodelled_envelope(candidate, c.small_effect, c.material)

    # -- two candidates -----------------------------------------------------------------------------------
    def predicts_better(self, scores: CandidateComparison, first: Candidate, second: Candidate) -> bool:
        """Return whether the first candidate predicts better than the second, beyond chance."""
        return scores.score(first).compare_with(scores.score(second)).is_better(self.criteria)

    def is_worth_more_parameters(
        self, scores: CandidateComparison, first: Candidate, second: Candidate
    ) -> bool:
        """Return whether the first candidate is preferred to the second although it has more parameters.

        Its prediction is better by one standard error, and by more than unmodelled effects make. On the validation records alone, which took
        no part in the fit, it is not worse by one standard error.
        """
        now, then = scores.score(first), scores.score(second)
        is_worse = compare(then.validation_lpd, now.validation_lpd).errors > self.criteria.simpler_errors
        return (
            not is_worse
            and now.compare_with(then).is_preferred(self.criteria)
            and self.differs_materially(scores, first, second)
        )

    def differs_materially(self, scores: CandidateComparison, chosen: Candidate, other: Candidate) -> bool:
        """Return whether two candidates differ by more than unmodelled effects make.

        The forces of their laws differ by more than an unmodelled effect has. The error of a channel falls by more than the envelope of
        unmodelled effects, or by half of its excess, on held-out or on training records.
        """
        c, now, then = self.criteria, scores.score(chosen), scores.score(other)
        if self.law_difference(chosen, other) < c.small_effect:
            return False
        problem = self.evaluator.problem
        on_training = 1.0 - gap(problem, chosen.fit) / gap(problem, other.fit)
        removed = max(scores.explained_fraction(then, now), on_training)
        return self.exceeds_envelope(scores, chosen, other) or removed >= c.least_removed

    def exceeds_envelope(self, scores: CandidateComparison, chosen: Candidate, other: Candidate) -> bool:
        """Return whether the error of a channel falls by more than the envelope of unmodelled effects."""
        now, then = scores.score(chosen), scores.score(other)
        change = np.sqrt(np.maximum(then.nrmse**2 - now.nrmse**2, 0.0))
        return bool(np.any(change > self.unmodelled_envelope(other)))

    def law_difference(self, chosen: Candidate, other: Candidate) -> float:
        """Return the RMS difference of the forces of the law that differs, as a share of the force at the place.

        Infinite where the candidates differ by more than one law, or the laws are at different places.
        """
        own = [i for i, h in enumerate(chosen.hypotheses) if h not in other.hypotheses]
        if len(own) != 1 or len(chosen.hypotheses) != len(other.hypotheses):
            return math.inf
        size = self.evaluator.effect_sizes(chosen)[own[0]]
        return float(size * force_difference(self.evaluator.problem, chosen, other, own[0]))

    def simplest(self, scores: CandidateComparison, candidates: Sequence[Candidate]) -> Candidate:
        """Return the sound candidate with fewest parameters that no candidate with more parameters is preferred to.

        The candidates have the same number of effects. The first is returned where no candidate is sound.
        """
        sound = [
            r
            for r in candidates
            if scores.can_score(r) and is_sound(self.evaluator.problem, r, self.criteria)
        ]
        if not sound:
            return candidates[0]

        def lead(r: Candidate, other: Candidate) -> float:
            return scores.score(r).compare_with(scores.score(other)).elpd_diff

        best = sound[0]
        for r in sound[1:]:
            best = r if lead(r, best) > 0 else best
        plain = [
            r
            for r in sound
            if len(r.fit.x) < len(best.fit.x) and not self.is_worth_more_parameters(scores, best, r)
        ]
        return min([best, *plain], key=lambda r: (len(r.fit.x), -lead(r, best)))

    # -- one effect ---------------------------------------------------------------------------------------
    def leaves_unmodelled_only(self, scores: CandidateComparison, candidate: Candidate) -> bool:
        """Return whether the error that a candidate leaves is no more than several unmodelled effects make."""
        left = scores.score(candidate).excess(scores.noise) ** 2
        return bool(np.all(left < self.criteria.small_effects * self.unmodelled_envelope(candidate) ** 2))

    def removed(
        self, scores: CandidateComparison, chosen: Candidate, without: Candidate
    ) -> tuple[float, float, bool]:
        """Return what an effect of the candidate `chosen` removes of the error of the candidate `without` it: the share of the excess
        error; the excess error without the effect, mean over channels, as a share of the deviation; and whether that excess is
        larger in a channel than unmodelled effects make it."""
        now, then = scores.score(chosen), scores.score(without)
        excess = then.excess(scores.noise)
        is_beyond = bool(np.any(excess > self.unmodelled_envelope(without)))
        return scores.explained_fraction(then, now), float(excess.mean()), is_beyond

    def is_material(
        self, scores: CandidateComparison, chosen: Candidate, without: Candidate, size: float
    ) -> bool:
        """Return whether an effect with a share `size` of the force, current or signal at its place is large enough to be named."""
        return is_material(*self.removed(scores, chosen, without), size, self.criteria)

    def passes_inclusion(self, scores: CandidateComparison, before: Candidate, after: Candidate) -> bool:
        """Return whether the last effect of the candidate `after` is kept; a note about the test is appended to `scores`.

        The effect is kept if it predicts better, is material, and removes half of the excess error.
        """
        c = self.criteria
        a, b = scores.score(before), scores.score(after)
        share, moved = scores.explained_fraction(a, b), error_reduction(a, b)
        size = self.evaluator.effect_sizes(after)[-1]
        # held-out records that are driven harder than training records may show more of the unmodelled effects
        removes = share >= c.least_removed or (
            self.leaves_unmodelled_only(scores, after)
            and scores.explained_on_training(a, b, self.unmodelled_envelope(before)) >= c.least_explained(1)
        )
        scores.notes.append(
            f"{after.hypotheses[-1].label}: {f'removes {share:.0%} of' if share > 0 else 'adds to'} the held-out excess "
            f"error (needed {c.least_removed:.0%}), moves a channel by {moved:.1%} of its deviation (needed {c.material:.0%}), "
            f"gives {size:.1%} of the force, current or signal at its place (needed {c.share:.0%})"
        )
        return (
            removes
            and self.predicts_better(scores, after, before)
            and moved >= c.material
            and self.is_material(scores, after, before, size)
        )

    def passes_deletion(
        self, scores: CandidateComparison, chosen: Candidate, without: Candidate, effect: int | None
    ) -> bool:
        """Return whether an effect of a candidate, or a parameter of a law, is needed.

        `without`: The candidate without the effect, or with a special case of its law.
        `effect`: Index of the effect; None for a special case.
        """
        if effect is None:
            return self.is_worth_more_parameters(scores, chosen, without)
        c, now, then = self.criteria, scores.score(chosen), scores.score(without)
        if not now.compare_with(then).is_preferred(c):
            return False
        large = self.is_material(scores, chosen, without, self.evaluator.effect_sizes(chosen)[effect])
        return (
            large
            and scores.explained_fraction(then, now) >= c.least_removed
            and error_reduction(then, now) >= c.material
        )

    # -- rivals -------------------------------------------------------------------------------------------
    def is_dominated(self, scores: CandidateComparison, rival: Candidate, best: Candidate) -> bool:
        """Return whether a rival predicts worse, or has more parameters and predicts no better."""
        if self.predicts_better(scores, best, rival):
            return True
        return len(rival.fit.x) > len(best.fit.x) and not self.is_worth_more_parameters(scores, rival, best)

    def states_the_same(self, rival: Candidate, best: Candidate) -> bool:
        """Return whether a rival states the same as the best candidate.

        The last effects are the same law at the same place, or in series along the same force, or the rival contains the best law as a
        special case.
        """
        a, b = rival.hypotheses[-1], best.hypotheses[-1]
        if a.effect == b.effect:
            network = self.evaluator.problem.network
            links = (tuple(twin(n, network.nodes) for n in h.where) for h in (a, b))
            return a.where == b.where or (a.kind.series and in_line(network, *links))
        return is_special_case(a, b)

    def indistinguishable(self, scores: CandidateComparison) -> list[Candidate]:
        """Return the sound rivals of another kind that the foremost candidate is not distinguished from."""
        best = scores.foremost
        return [
            r
            for r in scores.rivals()
            if is_sound(self.evaluator.problem, r, self.criteria)
            and not self.is_dominated(scores, r, best)
            and not self.states_the_same(r, best)
        ]
