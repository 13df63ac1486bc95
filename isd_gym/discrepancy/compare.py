"""Decisions between two candidates: which predicts better, what an effect is needed for, which candidates are rivals."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from .candidate import Candidate, relative
from .criteria import is_material
from .fit import gap
from .imitate import apart, sound
from .judge import moved
from .refits import Refits
from .structure import in_line, twin

if TYPE_CHECKING:
    from collections.abc import Sequence

    from .trial import Trial


class Compared(Refits):
    """Decisions of the search about candidates of one trial."""

    def predicts_better(self, trial: Trial, first: Candidate, second: Candidate) -> bool:
        """Return whether the first candidate predicts the held-out records better than the second, beyond chance."""
        return trial.of(first).versus(trial.of(second)).is_better(self.criteria)

    def clearly_better(self, trial: Trial, first: Candidate, second: Candidate) -> bool:
        """Return whether the first candidate is worth more parameters than the second.

        Its prediction is better by one standard error, and by more than unmodelled effects make.
        """
        versus = trial.of(first).versus(trial.of(second))
        return versus.is_preferred(self.criteria) and self.matters(trial, first, second)

    def simplest(self, trial: Trial, candidates: Sequence[Candidate]) -> Candidate:
        """Return the plainest of the well-formed candidates that none is clearly better than; the first where none is well-formed."""
        able = [r for r in candidates if trial.follows(r) and sound(self.problem, r)]
        if not able:
            return candidates[0]
        best = able[0]
        for r in able[1:]:
            best = r if trial.of(r).versus(trial.of(best)).elpd_diff > 0 else best
        plain = [
            r for r in able if len(r.fit.x) < len(best.fit.x) and not self.clearly_better(trial, best, r)
        ]
        return min(
            [best, *plain], key=lambda r: (len(r.fit.x), -trial.of(r).versus(trial.of(best)).elpd_diff)
        )

    def trifling(self, trial: Trial, candidate: Candidate) -> bool:
        """Return whether the error that a candidate leaves is no more than several unmodelled effects make."""
        left = trial.of(candidate).excess(trial.floor) ** 2
        return bool(np.all(left < self.criteria.several * self.worth(candidate) ** 2))

    def matters(self, trial: Trial, chosen: Candidate, without: Candidate) -> bool:
        """Return whether two candidates differ by more than unmodelled effects make.

        Their forces differ by more than an unmodelled effect has, and the error of a channel falls by more than the envelope of
        unmodelled effects, or by half of its excess.
        """
        c, now, then = self.criteria, trial.of(chosen), trial.of(without)
        if self.differs(chosen, without) < c.small:
            return False
        change = np.sqrt(np.maximum(then.nrmse**2 - now.nrmse**2, 0.0))
        # training records may show what held-out ones, driven otherwise, hardly do
        on_training = 1.0 - gap(self.problem, chosen.fit) / gap(self.problem, without.fit)
        return (
            bool(np.any(change > self.worth(without))) or max(trial.share(then, now), on_training) >= c.half
        )

    def differs(self, chosen: Candidate, without: Candidate) -> float:
        """Return by how much the forces of the law that was replaced differ (RMS), as a share of the force at the place.

        Infinite where the candidates differ by more than one law, or a force is no curve over elongation or rate.
        """
        k = next((i for i, h in enumerate(chosen.hypotheses) if h not in without.hypotheses), None)
        if k is None or len(chosen.hypotheses) != len(without.hypotheses):
            return math.inf
        return float(self.judge.sizes(chosen)[k] * apart(self.problem, chosen, without, k))

    def needed(self, trial: Trial, chosen: Candidate, without: Candidate, effect: int | None) -> bool:
        """Return whether the chosen candidate needs what another lacks: an effect, or parameters of one (`effect` None)."""
        if effect is None:
            return self.clearly_better(trial, chosen, without)
        if not trial.of(chosen).versus(trial.of(without)).is_preferred(self.criteria):
            return False
        c, now, then = self.criteria, trial.of(chosen), trial.of(without)
        large = self.is_material(trial, chosen, without, self.judge.sizes(chosen)[effect])
        return large and trial.share(then, now) >= c.half and moved(then, now) >= c.material

    def is_material(self, trial: Trial, chosen: Candidate, without: Candidate, size: float) -> bool:
        """Return whether an effect is large enough to be named.

        Args:
            trial: Scores of the candidates.
            chosen: A candidate with the effect.
            without: The candidate without the effect.
            size: Share of the force, current or signal at the effect's place.
        """
        return is_material(*self.removed(trial, chosen, without), size, self.criteria)

    def removed(self, trial: Trial, chosen: Candidate, without: Candidate) -> tuple[float, float, bool]:
        """Return what an effect removes of the error without it.

        Args:
            trial: Scores of the candidates.
            chosen: A candidate with the effect.
            without: The candidate without the effect.

        Returns:
            Share of the excess error; excess error without the effect, mean over channels, as a share of the deviation; whether that
            excess is larger in a channel than unmodelled effects make it.
        """
        now, then = trial.of(chosen), trial.of(without)
        excess = then.excess(trial.floor)
        return trial.share(then, now), float(excess.mean()), bool(np.any(excess > self.worth(without)))

    # -- rivals -------------------------------------------------------------------------------------------
    def beaten(self, trial: Trial, rival: Candidate, best: Candidate) -> bool:
        """Return whether a rival predicts worse, or predicts no better with more parameters."""
        if self.predicts_better(trial, best, rival):
            return True
        return len(rival.fit.x) > len(best.fit.x) and not self.clearly_better(trial, rival, best)

    def same(self, rival: Candidate, best: Candidate) -> bool:
        """Return whether a rival states the same as the best candidate.

        The last effects are the same law at the same place, or in series along the same force, or the rival contains the best's law
        as a special case.
        """
        a, b = rival.hypotheses[-1], best.hypotheses[-1]
        if a.effect == b.effect:
            known = self.problem.network.nodes
            links = (tuple(twin(n, known) for n in h.where) for h in (a, b))
            return a.where == b.where or (a.kind.series and in_line(self.problem.network, *links))
        return relative(a, b)

    def abreast(self, trial: Trial) -> list[Candidate]:
        """Return the rivals of another kind that the best candidate is not told apart from."""
        best = trial.foremost
        return [
            r
            for r in trial.rivals()
            if sound(self.problem, r) and not self.beaten(trial, r, best) and not self.same(r, best)
        ]
