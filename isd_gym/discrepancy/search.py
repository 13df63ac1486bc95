"""The search: one effect added at a time, those that do not earn their place taken away, runners-up given their turn."""

from __future__ import annotations

import functools
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from .candidate import (
    BROKEN,
    Candidate,
    akin,
    level,
    relative,
    simpler,
)
from .compare import Compared
from .fit import gap
from .imitate import imitations, joined
from .judge import Outcome, moved
from .race import compete
from .trial import RIVALS, Trial

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from .structure import Structure


class Search(Compared):
    """The search itself: there, back, and the rivals."""

    # -- forward ------------------------------------------------------------------------------------------
    def walk(
        self,
        path: Sequence[Candidate],
        stages: Sequence[list[Candidate]] = (),
        depth: int | None = None,
        worthwhile: Callable[[Candidate], bool] = lambda last: True,
    ) -> tuple[list[Candidate], list[list[Candidate]]]:
        """Forward addition, one effect at a time, from the last candidate of `path` on, as long as the last is `worthwhile`."""
        c = self.criteria
        path, stages = list(path), list(stages)
        while len(path) <= (depth or self.settings.depth) and worthwhile(path[-1]):
            now = path[-1]
            here = self.judge.along(path)[-1]
            left = here.excess(self.judge.floor(here))
            # a noise that is only bounded must not hide what is wide
            sure = all(k.known or e < c.misses for k, e in zip(self.judge.known, here.nrmse, strict=True))
            quiet = sure and left.max() < c.material
            if len(path) > 1 and sure and (quiet or bool(np.all(left < self.worth(now)))):
                break
            what = "; ".join(h.label for h in now.hypotheses) or "refitted model"
            self.say(f"looking for what is missing ({what}: excess up to {100 * left.max():.1f} %)")
            if quiet:
                hint = self.hint(now)
                if hint is None:
                    break
                if not self.moves(hint, now, here):  # too little to be named, but it may be told
                    path.append(hint)
                    stages.append([hint])
                    break
            best = self.stage(now, stages)
            if best is None:
                break
            try:
                then = self.judge.outcome(best, self.judge.weights(now), (here,))
            except BROKEN:
                break
            path.append(best)
            idle = len(path) > 2 and not then.versus(here).is_better(c)  # nothing to build on
            if moved(here, then) < c.material or idle:
                break
        return path, stages

    def hint(self, now: Candidate) -> Candidate | None:
        """What explains best what looks like noise: a signal as broad as noise hides its own misfit. A few are tried."""
        few = replace(self.settings, heats=3, finals=2)
        finish = compete(self.problem, now.fit, self.floors, few)
        here = level(self.problem, now, now, np.maximum(self.floors, 0.1 * finish.white))
        best = next(iter(finish.ranked), None)
        return best if best is not None and here - best.likelihood > self.criteria.deviance_gain else None

    def moves(self, candidate: Candidate, now: Candidate, here: Outcome) -> bool:
        """Whether a candidate moves a channel of the held-out records enough to be named."""
        try:
            then = self.judge.outcome(candidate, self.judge.weights(now), (here,))
        except BROKEN:
            return False
        return moved(here, then) >= self.criteria.material

    def stage(self, now: Candidate, stages: list[list[Candidate]]) -> Candidate | None:
        """The best single addition to `now`; who ran is appended to `stages`. None where nothing is gained."""
        p, c = self.problem, self.criteria
        finish = compete(p, now.fit, self.floors, self.settings)
        ranked = list(finish.ranked)
        if not ranked:
            return None
        here = level(p, now, now, np.maximum(self.floors, 0.1 * finish.white))
        best = ranked[0]
        gain = here - best.likelihood
        self.say(f"  best: {best.hypotheses[-1].label} (2 log L {gain:+.0f})")
        stages.append(ranked)
        weak = gain < c.deviance_gain and c.half * gap(p, now.fit) < gap(p, best.fit)
        return None if weak else best

    # -- back ---------------------------------------------------------------------------------------------
    def weigh(self, path: Sequence[Candidate], stages: list[list[Candidate]]) -> Trial:
        """Of the effects added on the way, those that earn their place."""
        trial = Trial(self.judge, path, stages)
        depth = len(path) - 1
        while depth > 0 and not self.earns(trial, path[depth - 1], path[depth]):
            depth -= 1
        trial.foremost = path[max(depth, min(1, len(path) - 1))]
        if not depth:
            return trial
        chosen = self.prune(trial, path[depth])
        trial.chosen = trial.foremost = self.challenged(trial, self.merged(trial, chosen))
        return trial

    def merged(self, trial: Trial, chosen: Candidate) -> Candidate:
        """Return one law for several over one plane at one place, where the several predict no better."""
        for structure in joined(self.problem, chosen):
            r = self.anew(structure, chosen)
            if r is None or not r.well_formed() or not trial.follows(r):
                continue
            if not self.needed(trial, chosen, r, None):
                several = "; ".join(h.label for h in chosen.hypotheses)
                trial.notes.append(f"{r.label}: predicts as well as {several} together")
                trial.stages[len(r.hypotheses) - 1].insert(0, r)
                return r
        return chosen

    def challenged(self, trial: Trial, chosen: Candidate) -> Candidate:
        """Return the simplest candidate with as many effects that none predicts better than: rivals, and other laws for the same force."""
        runners = trial.stages[len(chosen.hypotheses) - 1]
        for structure in imitations(self.problem, chosen):
            r = self.anew(structure, chosen, self.settings.outrun)
            if r is not None and trial.follows(r):
                runners.insert(1, r)
        others = [r for r in runners if r is not chosen][:RIVALS]
        best = self.simplest(trial, [chosen, *others])
        if best is not chosen:
            runners.append(chosen)
        return best

    def earns(self, trial: Trial, last: Candidate, now: Candidate) -> bool:
        """Whether the last effect of `now` removes half of what is left without it, and is there to be seen."""
        c = self.criteria
        a, b = trial.of(last), trial.of(now)
        share = trial.share(a, b)
        nearer = moved(a, b)
        size = self.judge.sizes(now)[-1]
        material = self.is_material(trial, now, last, size)
        # records that are driven harder than those fitted to may show more of what is small than of what is missing
        removes = share >= c.half or (
            self.trifling(trial, now) and trial.fitted_explained(a, b, self.worth(last)) >= c.adequate
        )
        trial.notes.append(
            f"{now.hypotheses[-1].label}: {f'removes {share:.0%} of' if share > 0 else 'adds to'} the held-out excess "
            f"error (needed {c.half:.0%}), moves a channel by {nearer:.1%} of its deviation (needed {c.material:.0%}), "
            f"gives {size:.1%} of the force, current or signal at its place (needed {c.share:.0%})"
        )
        better = self.predicts_better(trial, now, last)
        return removes and better and nearer >= c.material and material

    def prune(self, trial: Trial, chosen: Candidate) -> Candidate:
        """Try each effect's removal, and each one's special cases, anew: what was named first may have stood for another."""
        known = [r for stage in trial.stages for r in stage]
        while True:
            for gone, structure in simpler(self.problem, chosen):
                r = self.replacement(trial, structure, chosen, known)
                if r is None:
                    continue
                swapped = len(structure.hypotheses) == len(chosen.hypotheses)
                k = chosen.hypotheses.index(gone)
                try:
                    needed = self.needed(trial, chosen, r, None if swapped else k)
                except BROKEN:
                    continue
                if not needed:
                    gain = -self.loss(r, chosen)
                    trial.notes.append(
                        f"{gone.label}: not needed (without it, twice the log likelihood: {gain:+.0f})"
                    )
                    chosen = r
                    break
                runners = trial.stages[len(structure.hypotheses) - 1]
                if swapped and not any(q is r for q in runners):
                    runners.insert(1, r)
            else:
                return chosen

    def replacement(
        self, trial: Trial, structure: Structure, chosen: Candidate, known: Sequence[Candidate]
    ) -> Candidate | None:
        """The best fit of a simpler structure: one that ran before, or a new one from the values found."""

        def rank(q: Candidate) -> float:
            return level(self.problem, q, chosen, self.floors)

        swapped = len(structure.hypotheses) == len(chosen.hypotheses)
        r = next((r for r in known if r.hypotheses == structure.hypotheses), None)
        if r is None or (swapped and rank(r) > rank(chosen) + self.settings.chance):
            tried = [q for q in (r, self.anew(structure, chosen)) if q is not None]
            r = min(tried, key=rank, default=None)
        return r

    # -- rivals -------------------------------------------------------------------------------------------
    def leads(self, trial: Trial, candidate: Candidate) -> bool:
        """Return whether a path from a runner-up is new, and its candidate not worse than that of the first path with as many effects."""
        effects = len(candidate.hypotheses)
        if effects < 2 or effects > len(trial.stages):
            return True
        there = trial.stages[effects - 1][0]
        if akin(
            candidate.hypotheses, there.hypotheses
        ):  # the same effects, maybe from a better local optimum
            return self.predicts_better(trial, candidate, there)
        return not self.predicts_better(trial, there, candidate)

    def runners_up(self, trial: Trial, enough: Callable[[Trial], bool]) -> Trial:
        """Return the best trial that starts from the first candidate, or from those that predict best where that is not enough."""
        if enough(trial) or not trial.stages:
            return trial
        begun, base = trial.stages[0][0], trial.of(trial.base).score
        for score, runner in trial.runners_up()[: self.settings.turns]:
            # the first way went through it, or there is no way on
            if relative(begun.hypotheses[-1], runner.hypotheses[-1]) or score > base:
                continue
            self.say(f"starting over with {runner.hypotheses[-1].label}")
            try:
                leads = functools.partial(self.leads, trial)
                path, stages = self.walk([trial.base, runner], trial.stages[:1], worthwhile=leads)
                if not self.leads(trial, path[-1]):
                    continue
                other = self.weigh(path, stages)
                trial = other if self.improves(other, trial) else trial
            except BROKEN:
                continue
        return trial

    def improves(self, other: Trial, best: Trial) -> bool:
        """Return whether another trial's choice predicts better, or no worse with fewer effects.

        Both choices are scored behind the filters of the trial whose richest candidate is the likelier one: filters from a poor fit
        distinguish nothing.
        """
        mine, theirs = other.chosen, best.chosen
        common = min(other, best, key=lambda trial: trial.richest.likelihood)
        if not common.follows(mine):
            return False
        if not common.follows(theirs):
            return True
        if len(mine.hypotheses) < len(theirs.hypotheses):
            return bool(mine.hypotheses) and not self.predicts_better(common, theirs, mine)
        return self.predicts_better(common, mine, theirs)

    def run(self, base: Candidate, enough: Callable[[Trial], bool]) -> Trial:
        """From the owner's model refitted to the set of effects that earns its place."""
        return self.runners_up(self.weigh(*self.walk([base])), enough)
