"""Candidates weighed against one another on the same held-out records, behind the same filters."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from .candidate import BROKEN, Candidate

if TYPE_CHECKING:
    from collections.abc import Sequence

    from .judge import Judge, Outcome
    from .problem import Array


#: candidates of a stage that are compared with the best
RIVALS = 6


@dataclass(eq=False)
class Trial:
    """Candidates weighed against one another on the same held-out records, behind the filters of the richest.

    `chosen`: the one that earned its place, the model refitted where none did; `foremost`: the best that there was to
    weigh; `richest`: with everything that was added; `stages`: who ran at each stage, best first.
    """

    judge: Judge
    path: Sequence[Candidate]
    stages: list[list[Candidate]]
    chosen: Candidate = field(init=False)
    foremost: Candidate = field(init=False)
    notes: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.chosen = self.foremost = self.base
        self.stages = [list(ran) for ran in self.stages]  # other trials keep theirs
        self._seen: dict[int, tuple[Candidate, Outcome]] = {}
        self._like = self.judge.along(self.path)
        self.filters = self.judge.weights(self.richest)
        self.floor = self.judge.floor(self.of(self.richest))
        self.quiet = self.judge.quiet(self.of(self.richest), self.filters)

    @property
    def base(self) -> Candidate:
        """The refitted nominal model."""
        return self.path[0]

    @property
    def richest(self) -> Candidate:
        """The candidate with every effect that was added."""
        return self.path[-1]

    def of(self, candidate: Candidate) -> Outcome:
        """Its outcome. Raises where it breaks down on the held-out records."""
        if id(candidate) not in self._seen:
            found = self.judge.outcome(candidate, self.filters, self._like)
            self._seen[id(candidate)] = candidate, found
        return self._seen[id(candidate)][1]

    def follows(self, candidate: Candidate) -> bool:
        """Whether it can be followed on the held-out records."""
        try:
            self.of(candidate)
        except BROKEN:
            return False
        return True

    def beyond(self, candidate: Candidate) -> float:
        """Excess of its score over that of noise."""
        return max(self.of(candidate).score - self.quiet, 0.01 * self.quiet)

    def left(self, candidate: Candidate) -> float:
        """The same, but no less than half a per cent of the refitted model's: what both explain tells nobody apart."""
        return max(self.beyond(candidate), 0.005 * (self.of(self.base).score - self.quiet))

    def share(self, last: Outcome, now: Outcome) -> float:
        """Share of the excess error of `last` that `now` removes: whitened, or plain where that is more."""
        return max(
            (last.score - now.score) / max(last.score - self.quiet, 1e-12), self.plain_share(last, now)
        )

    def plain_share(self, last: Outcome, now: Outcome) -> float:
        f = np.maximum(self.floor, 1e-12)
        top = float(np.sum((last.nrmse**2 - now.nrmse**2) / f**2))
        return top / max(float(np.sum(np.maximum(last.nrmse**2 - self.floor**2, 0.0) / f**2)), 1e-12)

    def explained(self, candidate: Candidate, worth: Array) -> float:
        """Share of the refitted model's excess that it removes, and no more than in the channel where the gap is widest.

        worth (channels,): what small effects make there; it is the measure, since friction lets some channels drift for little.
        """
        refit, after = self.of(self.base), self.of(candidate)
        before, left = refit.excess(self.floor) ** 2, after.excess(self.floor) ** 2
        return min(self.share(refit, after), _removed_where_widest(before, left, worth))

    def confirmed(self, candidate: Candidate) -> float:
        """Return the share of the refitted model's excess error that a candidate removes on the test records.

        The whitened error counts, or the plain error where the plain error falls by more. Where the refitted model errs by no more
        than noise on the test records, the share compares with a hundredth of the noise.
        """
        refit, after = self.of(self.base), self.of(candidate)
        whitened = (refit.tested - after.tested) / max(refit.tested - self.quiet, 0.01 * self.quiet)
        noise = self.test_floor**2
        weights = 1.0 / np.maximum(noise, 1e-24)
        top = float(np.sum((refit.reported**2 - after.reported**2) * weights))
        excess = float(np.sum(np.maximum(refit.reported**2 - noise, 0.0) * weights))
        return max(whitened, top / max(excess, 0.01))

    def test_rest(self, candidate: Candidate, worth: Array) -> float:
        """Return the largest ratio, over channels, of the power left on the test records to that of unmodelled effects."""
        left = np.maximum(self.of(candidate).reported ** 2 - self.test_floor**2, 0.0)
        return float(np.max(left / worth**2))

    @property
    def test_floor(self) -> Array:
        """Noise of the test records (channels,), as a share of the deviation there."""
        return np.asarray(self.floor * self.judge.spread / self.judge.spread_reported)

    def fitted_explained(self, last: Outcome, now: Outcome, worth: Array) -> float:
        """The same of what `now` removes of the excess of `last` on the records that were fitted to."""
        floor = self.floor * self.judge.spread / self.judge.spread_fitted
        before, left = (np.maximum(self.judge.fitted(o.candidate) ** 2 - floor**2, 0.0) for o in (last, now))
        return _removed_where_widest(before, left, worth)

    def rivals(self, count: int = RIVALS) -> list[Candidate]:
        """Those that ran beside the foremost one and can be followed on the held-out records."""
        depth = len(self.foremost.hypotheses)
        ran = self.stages[depth - 1][:count] if 0 < depth <= len(self.stages) else []
        return [r for r in ran if r is not self.foremost and self.follows(r)]

    def candidates(self) -> list[Candidate]:
        """Return the candidates of all stages, at most `RIVALS` per stage, and the path."""
        ran = [r for stage in self.stages for r in stage[:RIVALS]]
        found: list[Candidate] = []
        for r in [self.chosen, self.foremost, *self.path, *ran]:
            if not any(r is q for q in found):
                found.append(r)
        return found

    def runners_up(self) -> list[tuple[float, Candidate]]:
        """Those that ran first beside what began the path, with their scores, best on held-out records first."""
        scored = [(self.of(r).score, r) for r in self.stages[0][1:] if self.follows(r)]
        return sorted(scored, key=lambda t: t[0])


def _removed_where_widest(before: Array, left: Array, worth: Array) -> float:
    """Share that is removed of the power in the channel that has most of it, by what small effects make there."""
    widest = int(np.argmax(before / worth**2))
    return 1.0 - float(left[widest] / max(before[widest], 1e-12))
