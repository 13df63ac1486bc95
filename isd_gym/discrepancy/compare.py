"""Candidates compared: which of two is the better one, what an effect is needed for, who is a rival."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .candidate import BROKEN, Candidate, relative
from .fit import gap
from .imitate import apart, sound
from .judge import block_lead, moved
from .refits import Refits
from .structure import in_line, twin

if TYPE_CHECKING:
    from .trial import Trial


class Compared(Refits):
    """What the search asks of two candidates of one trial."""

    # -- one for another ----------------------------------------------------------------------------------
    def replaces(self, trial: Trial, other: Candidate, best: Candidate, chosen: Candidate) -> bool:
        """Whether another law for the same force is the better one by Schwarz's criterion, and on held-out records."""
        better = self.schwarz(other, chosen) < self.schwarz(best, chosen) - self.criteria.decisive
        return better and trial.beyond(other) < trial.beyond(best)

    def stands_in(self, trial: Trial, other: Candidate, chosen: Candidate) -> bool:
        """Whether another law explains as much as one that is not what its name says, or all but what small effects make."""
        c = self.criteria
        if not trial.follows(other):
            return False
        as_much = trial.left(other) < c.ahead * trial.left(chosen) and self.loses_little(trial, other, chosen)
        nearly = trial.share(trial.of(trial.base), trial.of(other)) >= c.alone
        return as_much or (nearly and self.trifling(trial, other))

    def loses_little(self, trial: Trial, other: Candidate, best: Candidate) -> bool:
        """Whether what `other` loses is little beside what `best` gains: friction ends each fit in a place of its own."""
        gain = self.loss(trial.base, best)
        return self.loss(other, best) < max(self.criteria.significant, self.criteria.small * gain)

    def trifling(self, trial: Trial, candidate: Candidate) -> bool:
        """Whether what it leaves is no more than so many small effects make about it, whose powers add up."""
        left = trial.of(candidate).excess(trial.floor) ** 2
        return bool(np.all(left < self.criteria.several * self.worth(candidate) ** 2))

    # -- one effect less ------------------------------------------------------------------------------------
    def needed(self, trial: Trial, chosen: Candidate, without: Candidate, effect: int | None) -> bool:
        """Whether what `without` lacks (an effect, or parameters of one) earns more than small effects make."""
        p, c = self.problem, self.criteria
        now, then = trial.of(chosen), trial.of(without)
        loss = self.loss(without, chosen)
        change = np.sqrt(np.maximum(then.nrmse**2 - now.nrmse**2, 0.0))
        wide = gap(p, without.fit)
        # a gap that nobody minds may halve by chance
        wider = wide / gap(p, chosen.fit) if wide > c.material**2 else 1.0
        share = trial.share(then, now)
        if effect is None:
            more = bool(np.any(change > self.worth(without)))
            if not more:
                # small effects come in several: one law that takes away nearly all of what is left with whatever force, or half of it,
                # here or on the records fitted to, with a force that none of them has, is none of them
                halved = loss > c.significant and (share >= c.half or wider > 1.0 / c.half)
                more = share >= c.alone or (halved and self.differs(chosen, without) >= c.small)
            earned = loss > self.settings.chance or wider > 1.5
            return self.beaten(trial, without, chosen) and more and earned
        large = self.judge.sizes(chosen)[effect] >= c.share
        return (
            share >= c.half
            and moved(then, now) >= c.material
            and large
            and (loss > c.significant or wider > 2.0)
        )

    def differs(self, chosen: Candidate, without: Candidate) -> float:
        """By how much the forces of the law that was replaced differ (RMS), as a share of the force at its place."""
        k = next(i for i, h in enumerate(chosen.hypotheses) if h not in without.hypotheses)
        return float(self.judge.sizes(chosen)[k] * apart(self.problem, chosen, without, k))

    # -- rivals -------------------------------------------------------------------------------------------
    def beaten(self, trial: Trial, rival: Candidate, best: Candidate) -> bool:
        """Whether the rival's held-out excess is larger by a tenth, and not by chance."""
        if self.outclassed(trial, rival, best):
            return True
        ahead, theirs = self.criteria.ahead, trial.of(rival).score - trial.quiet
        if theirs < ahead * trial.beyond(best):
            return False
        sure = rival.likelihood - best.likelihood > 50.0
        return sure or block_lead(trial.of(rival), trial.of(best)) > self.criteria.replicated

    def outclassed(self, trial: Trial, rival: Candidate, best: Candidate) -> bool:
        """Whether the rival has more parameters that gain nothing, here or on the held-out records (Schwarz's criterion)."""
        richer = len(rival.fit.x) > len(best.fit.x)
        if not richer or self.criteria.ahead * trial.left(rival) <= trial.left(best):
            return False
        return self.schwarz(rival, best) - self.schwarz(best, best) > self.criteria.decisive

    def same(self, rival: Candidate, best: Candidate) -> bool:
        """Whether the rival is no alternative.

        It has more parameters without gain, the best as a special case, or is in series somewhere else along the same force.
        """
        a, b = rival.hypotheses[-1], best.hypotheses[-1]
        # more parameters, a worse fit, and nothing gained on the held-out records: a mimic
        wordy = (
            len(rival.fit.x) > len(best.fit.x) and rival.likelihood - best.likelihood > self.settings.chance
        )
        if a.effect == b.effect:
            known = self.problem.network.nodes
            links = (tuple(twin(n, known) for n in h.where) for h in (a, b))
            return a.where == b.where or (a.kind.series and in_line(self.problem.network, *links))
        return relative(a, b) or wordy

    def abreast(self, trial: Trial) -> list[Candidate]:
        """Rivals of another kind that explain as much."""
        best = trial.foremost
        return [
            r
            for r in trial.rivals()
            if sound(self.problem, r) and not self.beaten(trial, r, best) and not self.same(r, best)
        ]

    def better(self, other: Trial, best: Trial) -> bool:
        """Whether the excess that `other` leaves is smaller by a tenth, or as small with fewer effects."""
        try:
            mine, theirs = other.beyond(other.chosen), other.beyond(best.chosen)
        except BROKEN:
            return True
        fewer = len(other.chosen.hypotheses) < len(best.chosen.hypotheses)
        ahead = self.criteria.ahead
        return mine < ahead * theirs if fewer else ahead * mine < theirs
