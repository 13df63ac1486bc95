"""Search for the missing effects: forward addition and backward elimination, and the fits of simpler structures that they need."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from .._estimation.gauss_newton import Fitter, gap
from .._estimation.initial_states import transfer_states
from .._estimation.multiple_shooting import fit_segments, is_lightly_damped
from .._estimation.structure import base_structure
from .._simulation.problem import BROKEN
from .._simulation.time_limit import EVIDENCE, SEARCH, SELECTION, TimeLimit, TimeUp
from .candidate import (
    Candidate,
    deviance,
    deviance_beside,
    filters_for,
    settle,
    share_of,
    simpler_structures,
    transfer,
)
from .candidate_comparison import RIVALS, CandidateComparison
from .held_out import HeldOutScore, error_reduction
from .screening import Screening

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from ..._common.arrays import Array
    from .._estimation.structure import Structure
    from .._hypotheses.law_matching import Match
    from .._simulation.problem import Problem
    from .criteria import Criteria
    from .held_out import HeldOutEvaluator
    from .settings import SearchSettings

#: a refit whose plain error is larger by this factor than the smallest of all refits is in another local optimum
ASTRAY = 1.1
#: stages of forward addition, in words
ORDINALS = ("a first", "a second", "a third", "a further")


@dataclass(frozen=True, eq=False)
class Search:
    """Search for the effects that a model lacks."""

    evaluator: HeldOutEvaluator
    settings: SearchSettings
    criteria: Criteria
    #: receives a line of progress
    say: Callable[[str], None]
    clock: TimeLimit = field(default_factory=TimeLimit)
    #: the match to the residual of the refitted model that removes most, at each place
    places: list[Match] = field(default_factory=list)

    @property
    def problem(self) -> Problem:
        """Model and records."""
        return self.evaluator.problem

    @property
    def least_noise(self) -> Array:
        """Smallest noise that residuals are weighted with (channels,)."""
        return self.evaluator.least_noise

    def run(self, refitted: Candidate) -> CandidateComparison:
        """Search from the refitted nominal model: add one effect at a time, then select."""
        path: list[Candidate] = [refitted]
        stages: list[list[Candidate]] = []
        try:
            with self.clock.until(SEARCH):
                self._extend(path, stages)
        except TimeUp:
            self.clock.leave_out(f"the search for {ORDINALS[min(len(path), len(ORDINALS)) - 1]} effect")
        return self.select(path, stages)

    # -- forward addition ---------------------------------------------------------------------------------
    def _extend(self, path: list[Candidate], stages: list[list[Candidate]]) -> None:
        """Append candidates with one more effect each to a path, and the stages."""
        c, e = self.criteria, self.evaluator
        while len(path) <= self.settings.depth:
            now = path[-1]
            score = e.score_path(path)[-1]
            excess = score.excess(e.noise_share(score))
            # a noise that is only bounded must not hide a wide gap
            is_known = all(
                k.known or x < c.wide_gap for k, x in zip(e.noise_estimates, score.nrmse, strict=True)
            )
            is_within_noise = is_known and excess.max() < c.material
            is_unmodelled = is_known and bool(
                np.all(excess < e.unmodelled_envelope(now, c.small_effect, c.material))
            )
            if len(path) > 1 and (is_within_noise or is_unmodelled):
                break
            label = "; ".join(h.label for h in now.hypotheses) or "refitted model"
            self.say(f"looking for what is missing ({label}: excess up to {100 * excess.max():.1f} %)")
            if is_within_noise:
                hint = self._hint(now)
                if hint is None:
                    break
                then = self._score_after(now, score, hint)
                if then is None or error_reduction(score, then) < c.material:
                    path.append(hint)  # reported, but too small to be named
                    stages.append([hint])
                    break
            best = self._add_best(now, stages, is_wide=float(excess.mean()) > c.wide_gap)
            if best is None:
                break
            then = self._score_after(now, score, best)
            if then is None:
                break
            path.append(best)
            if error_reduction(score, then) < c.material:
                break
            is_worse = then.mean_square > score.mean_square  # better on the training records alone
            if len(path) > 2 and (is_worse or not then.compare_with(score).is_better(c)):
                break
            is_small = e.effect_sizes(best)[-1] < c.share
            if is_small and float(then.excess(e.noise_share(then)).mean()) < c.wide_gap:
                break

    def _screen(self, now: Candidate, settings: SearchSettings) -> tuple[list[Candidate], float]:
        """Return candidates with one more effect, best first, and the deviance without it."""
        result = Screening(self.problem, now.fit, self.least_noise, settings).run()
        if not now.hypotheses:
            self.places[:] = result.places
        return list(result.ranked), deviance(self.problem, now.fit, self.least_noise, result.share)

    def _hint(self, now: Candidate) -> Candidate | None:
        """Return the best addition to a model that errs by noise, from few hypotheses: a signal as broad as noise hides its own misfit."""
        ranked, before = self._screen(now, replace(self.settings, matches=3, finals=2))
        return ranked[0] if ranked and before - ranked[0].deviance > self.criteria.deviance_gain else None

    def _score_after(self, now: Candidate, score: HeldOutScore, then: Candidate) -> HeldOutScore | None:
        """Return the score of a candidate with the filters of the preceding one; None where it breaks down."""
        try:
            return self.evaluator.score(then, self.evaluator.weights(now), (score,))
        except BROKEN:
            return None

    def _add_best(self, now: Candidate, stages: list[list[Candidate]], *, is_wide: bool) -> Candidate | None:
        """Return the best candidate with one more effect, or None without gain; append the candidates to the stages. Where the held-out
        error `is_wide`, the held-out records decide about a small gain."""
        p, c = self.problem, self.criteria
        ranked, before = self._screen(now, self.settings)
        if not ranked:
            return None
        best = self._best_on_validation(now, ranked) if now.hypotheses else ranked[0]
        gain = before - best.deviance
        self.say(f"  best: {best.hypotheses[-1].label} (2 log L {gain:+.0f})")
        stages.append(ranked)
        least = 0.0 if is_wide else c.deviance_gain
        is_weak = gain <= least and c.least_removed * gap(p, now.fit) < gap(p, best.fit)
        return None if is_weak else best

    def _best_on_validation(self, now: Candidate, ranked: Sequence[Candidate]) -> Candidate:
        """Return the candidate with the smallest weighted error on the validation records: beside a first effect, training records alone
        prefer laws that make up for its errors."""
        weights, errors = self.evaluator.weights(now), []
        for candidate in ranked:
            try:
                errors.append(self.evaluator.score(candidate, weights).mean_square)
            except BROKEN:
                errors.append(math.inf)
        return ranked[int(np.argmin(errors))]

    # -- backward elimination -----------------------------------------------------------------------------
    def select(self, path: Sequence[Candidate], stages: list[list[Candidate]]) -> CandidateComparison:
        """Select the effects of a path that pass the tests, and the simplest law for each; none where the time does not suffice."""
        try:
            with self.clock.until(SELECTION):
                return self._select(path, stages)
        except TimeUp:
            best = "; ".join(h.label for h in path[-1].hypotheses)
            self.clock.leave_out(
                "the comparison of the candidates" + (f" (the first was {best})" if best else "")
            )
        with self.clock.until(EVIDENCE):
            return CandidateComparison(self.evaluator, self.criteria, path[:1], [])

    def _select(self, path: Sequence[Candidate], stages: list[list[Candidate]]) -> CandidateComparison:
        scores = CandidateComparison(self.evaluator, self.criteria, path, stages)
        count = len(path) - 1
        while count > 0 and not scores.passes_inclusion(path[count - 1], path[count]):
            count -= 1
        if not count:
            scores.foremost = self._best_predictor(scores)
            return scores
        chosen = self._eliminate(scores, path[count])
        simplest = self._take_simplest(scores, chosen)
        if simplest is not chosen:  # a rival has not been simplified yet
            simplest = self._eliminate(scores, simplest)
        scores.chosen = scores.foremost = simplest
        return scores

    def _best_predictor(self, scores: CandidateComparison) -> Candidate:
        """Return the candidate with one effect and the best prediction; the first one, unless another is better beyond chance."""
        if len(scores.path) < 2:
            return scores.refitted
        first = scores.path[1]
        others = [r for r in scores.stages[0] if r is not first and scores.can_score(r)]
        better = [r for r in others if scores.predicts_better(r, first)]
        return min(better, key=lambda r: scores.score(r).mean_square, default=first)

    def _eliminate(self, scores: CandidateComparison, chosen: Candidate) -> Candidate:
        """Remove effects, and replace laws by their special cases, as long as the prediction is not worse."""
        known = [r for stage in scores.stages for r in stage]
        while True:
            for gone, structure in simpler_structures(self.problem, chosen):
                r = self._fit_simpler(structure, chosen, known)
                if r is None:
                    continue
                is_replaced = len(structure.hypotheses) == len(chosen.hypotheses)
                effect = None if is_replaced else chosen.hypotheses.index(gone)
                try:
                    is_needed = scores.passes_deletion(chosen, r, effect)
                except BROKEN:
                    continue
                if not is_needed:
                    own, without = (
                        deviance_beside(self.problem, q, chosen, self.least_noise) for q in (chosen, r)
                    )
                    scores.notes.append(
                        f"{gone.label}: not needed (without it, twice the log likelihood: {own - without:+.0f})"
                    )
                    chosen = r
                    break
                stage = scores.stages[len(structure.hypotheses) - 1]
                if is_replaced and r not in stage:
                    stage.insert(1, r)
            else:
                return chosen

    def _fit_simpler(
        self, structure: Structure, chosen: Candidate, known: Sequence[Candidate]
    ) -> Candidate | None:
        """Return the best fit of a simpler structure: a known candidate, or a new fit where that may be in a local optimum."""

        def rank(q: Candidate) -> float:
            return deviance_beside(self.problem, q, chosen, self.least_noise)

        r = next((r for r in known if r.hypotheses == structure.hypotheses), None)
        if r is None or rank(r) > rank(chosen) + self.settings.chance:
            tried = [q for q in (r, self.refit(structure, chosen)) if q is not None]
            r = min(tried, key=rank, default=None)
        return r

    def _take_simplest(self, scores: CandidateComparison, chosen: Candidate) -> Candidate:
        """Return the simplest of the chosen candidate, its rivals, and candidates with fewer effects."""
        count = len(chosen.hypotheses)
        stage = scores.stages[count - 1]
        # the path was found on the training records: a law beside it may predict better without a further effect
        fewer = [r for own in scores.stages[: count - 1] for r in own[:RIVALS]]
        others = [r for r in stage if r is not chosen][:RIVALS]
        best = scores.simplest([chosen, *others, *fewer])
        if best is not chosen:
            stage.append(chosen)
        return best

    # -- fits -----------------------------------------------------------------------------------------------
    def refit_nominal(self) -> Candidate:
        """Refit the nominal model within its stated uncertainty from the nominal values and, where the motion is lightly damped, from
        segments; the nominal model where every refit errs more on the training records."""
        p, least = self.problem, self.least_noise
        structure = base_structure(p.network)
        found = [settle(p, structure, structure.start, least)]
        try:
            again = self.from_segments(structure, structure.start, found[0])
            found += [again] if again is not None else []
        except TimeUp:
            self.clock.leave_out("further starts of the refit")
            return found[0]
        gaps = [gap(p, c.fit) for c in found]
        near = [c for c, g in zip(found, gaps, strict=True) if g <= ASTRAY * min(gaps)]
        plainly = self.evaluator.plain_fitter.follow(structure, structure.start, p.estimation)
        nominal = settle(p, structure, structure.start, least, plainly, iterations=0)
        # else every refit has lost the motion
        return min(near, key=lambda c: c.deviance) if gap(p, nominal.fit) >= min(gaps) / ASTRAY else nominal

    def from_segments(
        self, structure: Structure, x: Array, similar: Candidate, share: Array | None = None
    ) -> Candidate | None:
        """Fit a structure from a fit to brief segments, weighted by the residuals of a similar candidate; None where the motion is
        strongly damped."""
        p, least = self.problem, self.least_noise
        if p.network.inputs and not is_lightly_damped(p.network):
            return None
        try:
            start = fit_segments(p, structure, x, Fitter(p, filters_for(p, similar.fit, least)))
            return None if start is None else settle(p, structure, start, least, rounds=2, share=share)
        except BROKEN:
            return None

    def refit(self, structure: Structure, similar: Candidate) -> Candidate | None:
        """Return the best fit of a simpler structure from the values of a fitted candidate, then from nominal ones."""
        e, p, least = self.evaluator, self.problem, self.least_noise
        share = share_of(p, similar.fit)
        near = deviance_beside(p, similar, similar, least) + self.criteria.deviance_gain
        own = zip(similar.fit.structure.free, similar.fit.x, strict=True)
        known = {f.path: v for f, v in own if f.owner < 0}
        x = structure.start_from(known)
        found: list[Candidate] = []
        try:
            initial = transfer_states(p, similar.fit.network, similar.fit.initial, structure)
            f = e.coarse_fitter.fit(structure, x, initial, similar.fit.offset)
            f = f if p.rough is p else transfer(p, f, least)
            found.append(settle(p, structure, f.x, least, f, rounds=2, share=share))
        except BROKEN:
            pass
        try:
            if not found or found[0].deviance > near:
                found.append(settle(p, structure, structure.start, least, rounds=2, share=share))
            if min(c.deviance for c in found) > near:
                again = self.from_segments(structure, x, similar, share)
                found += [again] if again is not None else []
            return min(found, key=lambda c: c.deviance)
        except (*BROKEN, ValueError):
            return None
