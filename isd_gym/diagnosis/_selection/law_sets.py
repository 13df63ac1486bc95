"""Search for the missing laws: sets of one to three, found by plain fits with a beam by held-out error."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from .._estimation.gauss_newton import Fitter, gap, residuals
from .._estimation.multiple_shooting import fit_segments, is_lightly_damped
from .._estimation.noise import balanced_weights
from .._estimation.structure import add, base_structure, parameter_values
from .._simulation.problem import BROKEN
from .._simulation.time_limit import SEARCH, TimeLimit, TimeUp
from .answer import answer_of, simplest_law
from .held_out_table import row_of
from .plain_fits import FAILS, Stage, freed, go_on, try_fit

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from ..._common.arrays import Array
    from .._estimation.gauss_newton import Fit
    from .._simulation.problem import Problem
    from .answer import Answer
    from .criteria import Criteria
    from .held_out import HeldOutEvaluator
    from .held_out_table import Row
    from .settings import SearchSettings

#: factor by which the nominal model must err less than every refit, to stand in for it
ASTRAY = 1.1
#: largest number of Gauss-Newton steps of the refit
REFIT = 20
#: number of the law that is looked for, in words
ORDINALS = ("a first", "a second", "a third", "a further")


@dataclass(frozen=True, eq=False)
class Search:
    """Search for the laws that a model lacks."""

    evaluator: HeldOutEvaluator
    settings: SearchSettings
    criteria: Criteria
    #: receives a line of progress
    say: Callable[[str], None]
    clock: TimeLimit = field(default_factory=TimeLimit)

    @property
    def problem(self) -> Problem:
        """Model and records."""
        return self.evaluator.problem

    @property
    def least_noise(self) -> Array:
        """Smallest noise that residuals are weighted with (channels,)."""
        return self.evaluator.least_noise

    @property
    def noise(self) -> Array:
        """Noise of the validation records as a share of the deviation (channels,)."""
        deviations = [f.deviation for f in self.evaluator.noise_estimates]
        return np.asarray(deviations) / self.evaluator.validation_deviation

    def run(self, refitted: Fit) -> Answer:
        """Search from the refitted nominal model."""
        rows = self.score([self._polished(refitted)])
        try:
            with self.clock.until(SEARCH):
                self._extend(rows)
        except TimeUp:
            count = max(len(row.members) for row in rows)
            self.clock.leave_out(
                f"the search for {ORDINALS[min(count, len(ORDINALS) - 1)]} effect"
            )
        return answer_of(rows, self.least_noise, self.noise, self.criteria)

    def _extend(self, rows: list[Row]) -> None:
        """Append the rows of sets with one more law each, from the best sets of the step before. The search ends where no further law can
        be material, or where the last law is not on its way to being needed."""
        s, c, noise = self.settings, self.criteria, float(np.mean(self.noise**2))
        if np.all(rows[0].validation < c.material):
            return
        front = [rows[0].fit]
        for depth in range(s.depth):
            label = (
                "; ".join(h.label for h in front[0].structure.hypotheses)
                or "refitted model"
            )
            self.say(
                f"looking for {ORDINALS[min(depth, len(ORDINALS) - 1)]} effect (beside the {label})"
            )
            found: dict[frozenset[object], Fit] = {}
            fitter = self._balanced(front[0])
            for fit in front:
                for more in Stage(fitter, fit, s).run():
                    key = frozenset(more.structure.hypotheses)
                    if key not in found or more.cost < found[key].cost:
                        found[key] = more
            ranked = sorted(found.values(), key=lambda f: f.cost)
            most = s.scored_further if depth else s.scored
            new = self.score([self._polished(fit) for fit in ranked[:most]])
            before = min(row.error for row in rows if row.is_sound)
            sound = [row for row in new if row.is_sound]
            best = min(sound, key=lambda row: row.error, default=None)
            rows += new
            if best is not None and depth:
                rows += self.score(self._with_fewer(best.fit))
            if best is None or (best.error / before) ** 2 > c.on_its_way:
                break
            if best.error**2 - noise < c.material**2:
                break
            front = [row.fit for row in self._front(sound)]

    def _with_fewer(self, fit: Fit) -> list[Fit]:
        """Return fits with one law less, from the values of a fit: alone, a law may have ended in another optimum."""
        laws = [*zip(fit.hypotheses, fit.elements, strict=True)]
        fitter, steps = self._balanced(fit), self.settings.further_steps
        out = []
        for gone, _ in laws:
            structure = base_structure(self.problem.network)
            try:
                for law, element in laws:
                    if law is not gone:
                        structure = add(
                            freed(structure, law), law, parameter_values(element)
                        )
                x = structure.start_from(fit.values)
            except FAILS:
                continue
            fewer = try_fit(fitter, structure, x, None, None, steps)
            out += [fewer] if fewer is not None else []
        return out

    def _front(self, rows: Sequence[Row]) -> list[Row]:
        """Return the best sets of distinct kinds on validation and training records, each with the simplest law of its kinds."""
        out: dict[object, Row] = {}
        c = self.criteria
        for row in sorted(rows, key=lambda row: row.error * row.training_error):
            if row.kinds not in out and len(out) < self.settings.beam:
                out[row.kinds] = simplest_law(rows, row, 0.0, c, c.on_its_way)
        return list(out.values())

    def score(self, fits: Sequence[Fit]) -> list[Row]:
        """Return the rows of the fits that can simulate all records; lost ones start again from the states of the best one."""
        found = [row for fit in fits if (row := self._row(fit)) is not None]
        best = min(found, key=lambda row: row.error, default=None)
        out = []
        for row in found:
            again = (
                self._row(row.fit, best.held)
                if best is not None and row.is_lost
                else None
            )
            out.append(row if again is None or row.error < again.error else again)
        return out

    def _polished(self, fit: Fit) -> Fit:
        """Return a fit with the channels balanced by its own residual."""
        return go_on(self._balanced(fit), fit, self.settings.further_steps) or fit

    def _balanced(self, fit: Fit) -> Fitter:
        """Return the fitter with the channels balanced by the residual of a fit."""
        left = residuals(self.problem, fit)
        return Fitter(self.problem, balanced_weights(left, self.least_noise))

    def _row(self, fit: Fit, near: Fit | None = None) -> Row | None:
        """Return the row of a fit; None where a record cannot be simulated."""
        try:
            return row_of(self.evaluator, fit, near)
        except FAILS:
            return None

    def refit_nominal(self) -> Fit:
        """Refit the nominal model within its stated uncertainty from the nominal values and, where the motion is lightly damped, from
        segments; the nominal model where every refit errs more on the training records."""
        p, fitter = self.problem, self.evaluator.plain_fitter
        structure = base_structure(p.network)
        found = [fitter.fit(structure, iterations=REFIT)]
        try:
            if not p.network.inputs or is_lightly_damped(p.network):
                x = fit_segments(p, structure, structure.start, fitter)
                found += (
                    [fitter.fit(structure, x, iterations=REFIT)]
                    if x is not None
                    else []
                )
        except TimeUp:
            self.clock.leave_out("further starts of the refit")
        except BROKEN:
            pass
        plainly = fitter.follow(structure, structure.start, p.estimation)
        found.append(
            fitter.fit(structure, None, plainly.initial, plainly.offset, iterations=0)
        )
        gaps = [gap(p, fit) for fit in found]
        # the nominal model where every refit has lost the motion
        return found[int(np.argmin(np.append(gaps[:-1], ASTRAY * gaps[-1])))]
