"""Candidates of a search, scored on the same held-out records with the same weights: which predicts better, whether an effect
is needed, and which candidates are rivals."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from ...physics import elements as el
from .._estimation.gauss_newton import gap
from .._estimation.structure import in_line, twin
from .._hypotheses.forces import element_forces
from .._hypotheses.motion import motions
from .._simulation.problem import BROKEN
from .admissibility import is_sound
from .candidate import Candidate, is_special_case
from .criteria import Criteria, is_material
from .held_out import HeldOutEvaluator, compare, error_reduction

if TYPE_CHECKING:
    from collections.abc import Sequence

    from ..._common.arrays import Array
    from .._estimation.structure import Hypothesis
    from .._simulation.problem import Problem
    from .held_out import HeldOutScore

#: candidates of a stage that are compared with the best
RIVALS = 6


def excess_loss(score: HeldOutScore, noise: float) -> float:
    """Return the mean weighted square of a score beyond that of noise, at least 1 % of the latter."""
    return max(score.mean_square - noise, 0.01 * noise)


def force_difference(problem: Problem, candidate: Candidate, other: Candidate, effect: int) -> float:
    """Return the RMS difference of the force of an effect and of the law that replaces it, over the former, along the motion with the
    effect; infinite if the laws are at different places or in series."""
    new = next(j for j, h in enumerate(other.hypotheses) if h not in candidate.hypotheses)
    one, two = candidate.elements[effect], other.elements[new]
    motion = motions(problem, candidate.fit).get(one.between) if one.place == "between" else None
    if motion is None or two.place != "between" or two.where != one.where or one.series or two.series:
        return math.inf

    def force(law: el.Element, owner: Candidate) -> Array:
        if law.plane in ("rate", "elongation") and type(law).curve is el.Element.curve:
            return law.curve(motion.v if law.plane == "rate" else motion.d)
        return element_forces(problem, owner.fit, law.where)[law.name]

    try:
        first, second = force(one, candidate), force(two, other)
    except BROKEN:
        return math.inf
    return float(el.rms(first - second) / max(el.rms(first), 1e-300))


@dataclass(eq=False)
class CandidateComparison:
    """Scores of the candidates of a search, weighted by the residuals of the candidate with most effects."""

    evaluator: HeldOutEvaluator
    criteria: Criteria
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
        self.weights = self.evaluator.weights(self.richest)
        #: noise of each channel on the validation records, as a share of the deviation (channels,)
        self.noise = self.evaluator.noise_share(self.score(self.richest))
        #: mean weighted square of pure noise
        self.noise_score = self.evaluator.expected_noise_score(self.score(self.richest), self.weights)

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
            self._scores[candidate] = self.evaluator.score(candidate, self.weights, self._similar)
        return self._scores[candidate]

    def can_score(self, candidate: Candidate) -> bool:
        """Return whether the held-out records can be simulated with a candidate."""
        try:
            self.score(candidate)
        except BROKEN:
            return False
        return True

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

    def unmodelled_envelope(self, candidate: Candidate) -> Array:
        """Return the excess error of unmodelled effects (channels,), as a share of the deviation."""
        return self.evaluator.unmodelled_envelope(
            candidate, self.criteria.small_effect, self.criteria.material
        )

    # -- two candidates -----------------------------------------------------------------------------------
    def predicts_better(self, first: Candidate, second: Candidate) -> bool:
        """Return whether the first candidate predicts better than the second, beyond chance."""
        return self.score(first).compare_with(self.score(second)).is_better(self.criteria)

    def is_worth_more_parameters(self, first: Candidate, second: Candidate) -> bool:
        """Return whether the first candidate is preferred to the second although it has more parameters: better by one standard error and
        by more than unmodelled effects make, and not worse on the validation records alone."""
        now, then = self.score(first), self.score(second)
        is_worse = compare(then.validation_lpd, now.validation_lpd).errors > self.criteria.simpler_errors
        return (
            not is_worse
            and now.compare_with(then).is_preferred(self.criteria)
            and self.differs_materially(first, second)
        )

    def differs_materially(self, chosen: Candidate, other: Candidate) -> bool:
        """Return whether the forces of the differing laws, and the error of a channel, change by more than unmodelled effects make, or
        half of the excess is removed on held-out or training records."""
        c, now, then = self.criteria, self.score(chosen), self.score(other)
        if self.law_difference(chosen, other) < c.small_effect:
            return False
        problem = self.evaluator.problem
        on_training = 1.0 - gap(problem, chosen.fit) / gap(problem, other.fit)
        removed = max(self.explained_fraction(then, now), on_training)
        return self.exceeds_envelope(chosen, other) or removed >= c.least_removed

    def exceeds_envelope(self, chosen: Candidate, other: Candidate) -> bool:
        """Return whether the error of a channel falls by more than the envelope of unmodelled effects."""
        now, then = self.score(chosen), self.score(other)
        change = np.sqrt(np.maximum(then.nrmse**2 - now.nrmse**2, 0.0))
        return bool(np.any(change > self.unmodelled_envelope(other)))

    def law_difference(self, chosen: Candidate, other: Candidate) -> float:
        """Return the RMS difference of the forces of the law that differs, as a share of the force at the place; infinite where
        several laws differ at the place."""
        own = [i for i, h in enumerate(chosen.hypotheses) if h not in other.hypotheses]
        if len(own) != 1 or len(chosen.hypotheses) != len(other.hypotheses):
            return math.inf
        size = self.evaluator.effect_sizes(chosen)[own[0]]
        return float(size * force_difference(self.evaluator.problem, chosen, other, own[0]))

    def simplest(self, candidates: Sequence[Candidate]) -> Candidate:
        """Return the sound candidate with fewest parameters that no candidate with more parameters is preferred to; the first where none
        is sound."""
        sound = [
            r for r in candidates if self.can_score(r) and is_sound(self.evaluator.problem, r, self.criteria)
        ]
        if not sound:
            return candidates[0]

        def lead(r: Candidate, other: Candidate) -> float:
            return self.score(r).compare_with(self.score(other)).elpd_diff

        sound = [r for r in sound if not any(self.blames_needlessly(r, other) for other in sound)]
        best = sound[0]
        for r in sound[1:]:
            best = r if lead(r, best) > 0 else best
        plain = [
            r for r in sound if len(r.fit.x) < len(best.fit.x) and not self.is_worth_more_parameters(best, r)
        ]
        return min([best, *plain], key=lambda r: (len(r.fit.x), -lead(r, best)))

    # -- one effect ---------------------------------------------------------------------------------------
    def leaves_unmodelled_only(self, candidate: Candidate) -> bool:
        """Return whether the error that a candidate leaves is no more than several unmodelled effects make."""
        left = self.score(candidate).excess(self.noise) ** 2
        return bool(np.all(left < self.criteria.small_effects * self.unmodelled_envelope(candidate) ** 2))

    def removed(self, chosen: Candidate, without: Candidate) -> tuple[float, float, bool]:
        """Return the share of the excess error that an effect removes, the excess error without it (mean share of the deviation), and
        whether that is larger in a channel than unmodelled effects make it."""
        now, then = self.score(chosen), self.score(without)
        excess = then.excess(self.noise)
        is_beyond = bool(np.any(excess > self.unmodelled_envelope(without)))
        return self.explained_fraction(then, now), float(excess.mean()), is_beyond

    def is_material(self, chosen: Candidate, without: Candidate, size: float) -> bool:
        """Return whether an effect with a share `size` of the force, current or signal at its place is large enough to be named."""
        return is_material(*self.removed(chosen, without), size, self.criteria)

    def passes_inclusion(self, before: Candidate, after: Candidate) -> bool:
        """Return whether the last effect of a candidate predicts better, is material, and removes half of the excess error; the test is
        noted."""
        c = self.criteria
        a, b = self.score(before), self.score(after)
        share, moved = self.explained_fraction(a, b), error_reduction(a, b)
        size = self.evaluator.effect_sizes(after)[-1]
        # held-out records that are driven harder than training records may show more of the unmodelled effects
        removes = share >= c.least_removed or (
            self.leaves_unmodelled_only(after)
            and self.explained_on_training(before, after) >= c.least_explained
        )
        self.notes.append(
            f"{after.hypotheses[-1].label}: {f'removes {share:.0%} of' if share > 0 else 'adds to'} the held-out excess "
            f"error (needed {c.least_removed:.0%}), moves a channel by {moved:.1%} of its deviation (needed {c.material:.0%}), "
            f"gives {size:.1%} of the force, current or signal at its place (needed {c.share:.0%})"
        )
        return (
            removes
            and self.predicts_better(after, before)
            and moved >= c.material
            and self.is_material(after, before, size)
        )

    def passes_deletion(self, chosen: Candidate, without: Candidate, effect: int | None) -> bool:
        """Return whether an effect of a candidate, by its index, is needed, or with None a parameter of a law, compared with the
        candidate `without` it. Several effects have a part in what is explained: each must remove half of an equal part."""
        if effect is None:
            return self.is_worth_more_parameters(chosen, without)
        c, now, then = self.criteria, self.score(chosen), self.score(without)
        if not now.compare_with(then).is_preferred(c):
            return False
        large = self.is_material(chosen, without, self.evaluator.effect_sizes(chosen)[effect])
        return (
            large
            and self.explained_fraction(then, now) >= c.least_removed / len(chosen.hypotheses)
            and error_reduction(then, now) >= c.material
        )

    # -- rivals -------------------------------------------------------------------------------------------
    def is_dominated(self, rival: Candidate, best: Candidate) -> bool:
        """Return whether a rival predicts worse, has more parameters and predicts no better, or blames a sensor needlessly."""
        if self.predicts_better(best, rival) or self.blames_needlessly(rival, best):
            return True
        return rival.freedom > best.freedom and not self.is_worth_more_parameters(rival, best)

    def blames_needlessly(self, rival: Candidate, best: Candidate) -> bool:
        """Return whether a candidate has a fault of a sensor although one with forces alone leaves nearly as little (`forces_first`)."""
        is_blamed, *others = (any(h.place == "channel" for h in r.hypotheses) for r in (rival, best))
        if not is_blamed or any(others) or not best.hypotheses:
            return False
        left, by_force = (excess_loss(self.score(r), self.noise_score) for r in (rival, best))
        return by_force < self.criteria.forces_first * left

    def states_the_same(self, rival: Candidate, best: Candidate) -> bool:
        """Return whether the last effects are the same law at the same place or in series along the same force, or the rival's contains
        the best one's as a special case."""
        a, b = rival.hypotheses[-1], best.hypotheses[-1]
        if a.effect == b.effect:
            network = self.evaluator.problem.network
            links = (tuple(twin(n, network.nodes) for n in h.where) for h in (a, b))
            return a.where == b.where or (a.kind.series and in_line(network, *links))
        return is_special_case(a, b)

    def indistinguishable(self) -> list[Candidate]:
        """Return the sound rivals of another kind that the foremost candidate is not distinguished from."""
        best = self.foremost
        found: dict[frozenset[Hypothesis], Candidate] = {}
        for r in self.rivals():
            is_sound_law = is_sound(self.evaluator.problem, r, self.criteria)
            if is_sound_law and not self.is_dominated(r, best) and not self.states_the_same(r, best):
                found.setdefault(frozenset(r.hypotheses), r)  # the best of several fits of the same effects
        return [*found.values()]
