"""One stage of forward addition: hypotheses are fitted to a window of the records, the best of them to whole records.

The stage is a successive halving (Jamieson and Talwalkar, AISTATS 2016): a score test orders all hypotheses, a first round fits a part
of them to a window, and the finals are fitted to whole records.
"""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from ..._common.errors import InputError
from ...physics.elements import beside
from ...physics.network import GROUND
from .._estimation.gauss_newton import Fit, Fitter, gap, residuals
from .._estimation.initial_states import guess, states_along, transfer_states
from .._estimation.multiple_shooting import fit_segments, is_lightly_damped
from .._estimation.noise import refined_noise, white_filters, whitener
from .._estimation.structure import Structure, add
from .._hypotheses.library import Hypothesis, hypotheses
from .._hypotheses.neighbouring_periods import try_neighbouring_periods
from .._hypotheses.position_spectrum import thinning_loses
from .._hypotheses.score_test import ScoredStart, with_fitted_effects
from .._simulation.problem import BROKEN
from .._simulation.time_limit import adopt, running
from .admissibility import admissible_starts
from .candidate import (
    Candidate,
    deviance,
    refit_with_other_shape,
    settle,
    simplest_first,
    transfer,
    white_noise,
    with_fit,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from ..._common.arrays import Array
    from .._simulation.problem import Problem, Record
    from .settings import SearchSettings

#: growth of the window in a free decay, and of the window in which the nominal model is refitted
GROWTH = 1.4


#: physics steps that cost as much as the rest of the work for a sample: outputs, filters and interpolation
STEPS_PER_SAMPLE = 5


@dataclass(frozen=True)
class Window:
    """Samples first to first + size - 1 of a record."""

    first: int
    size: int

    def of(self, record: Record) -> Record:
        """Return the window of a record."""
        return record.part(self.first, self.first + self.size, record.name)


@dataclass(frozen=True)
class ScreeningResult:
    """Candidates of a stage."""

    #: best candidate first
    ranked: tuple[Candidate, ...]
    #: white noise with which the candidates were compared (channels,)
    noise: Array


def shape_index(candidate: Candidate) -> int | None:
    """Return the index of the free parameter that shapes the last law; None where no parameter does."""
    path = f"{candidate.fit.structure.names[-1]}.{candidate.hypotheses[-1].kind.shaped_by}"
    return next((k for k, f in enumerate(candidate.fit.structure.free) if f.path == path), None)


def widest_window(record: Record, residual: Array, settings: SearchSettings) -> Window:
    """Return the window with the largest residual energy: elsewhere an effect may be invisible.

    Args:
        record: The record.
        residual: Whitened residual (samples, channels).
        settings: Size of the window.
    """
    size = min(max(int(settings.window * len(record)), settings.least_window), len(record))
    energy = np.concatenate([[0.0], np.cumsum(np.sum(residual**2, axis=1))])
    gain = energy[size:] - energy[:-size]
    return Window(0 if gain[0] > settings.beginning * gain.max() else int(np.argmax(gain)), size)


@dataclass(frozen=True)
class Screening:
    """A stage: the fit to which an effect is added, and the windows of the first round."""

    problem: Problem
    current: Fit
    #: smallest noise of weights (channels,)
    least_noise: Array
    settings: SearchSettings
    #: whether the simulation has lost the phase of a free decay, so that small effects say nothing about large ones
    has_lost_phase: bool = False

    @cached_property
    def first_noise(self) -> Array:
        """White noise of the current fit (channels,)."""
        return white_noise(self.problem, self.current, self.least_noise)

    @cached_property
    def fitter(self) -> Fitter:
        """Fitter to whole records with the weights of the current fit."""
        return Fitter(self.problem, whitener(residuals(self.problem, self.current), self.first_noise))

    @cached_property
    def is_lightly_damped(self) -> bool:
        """Whether the motion lasts for many periods."""
        return is_lightly_damped(self.problem.network)

    @cached_property
    def windows(self) -> dict[int, Window]:
        """Window of each training record."""
        p = self.problem
        left = dict(zip(p.estimation, residuals(p, self.current), strict=True))
        return {
            i: widest_window(p.records[i], self.fitter.weights(left[i]), self.settings) for i in p.estimation
        }

    @cached_property
    def windowed(self) -> Problem:
        """The problem with the windows in place of the training records."""
        cut = [self.windows[i].of(r) if i in self.windows else r for i, r in enumerate(self.problem.records)]
        return self.problem.with_records(cut)

    @cached_property
    def window_fitter(self) -> Fitter:
        """Fitter to the windows."""
        return Fitter(self.windowed, self.fitter.weights)

    @cached_property
    def window_states(self) -> dict[int, Array]:
        """Initial states of the windows in the current fit."""
        p, now = self.problem, self.current
        out = {}
        for i, w in self.windows.items():
            if w.first == 0:
                out[i] = now.initial[i]
            else:
                there = states_along(p, now.structure, now.x, {i: now.initial[i]}, [w.first])[i][0]
                out[i] = guess(self.windowed, now.network, i, there, now.structure.offsets)
        return out

    @cached_property
    def coarse(self) -> Screening:
        """The same stage on as few samples as the motion needs."""
        p, few = self.problem, self.problem.rough
        if few is p or thinning_loses(p, self.current, self.least_noise):
            return self
        counts = [sum(len(q.records[i]) for i in q.estimation) for q in (few, p)]
        least = math.ceil(counts[0] / counts[1] * self.settings.least_window)
        settings = replace(self.settings, least_window=least)
        return replace(
            self, problem=few, current=transfer(few, self.current, self.least_noise), settings=settings
        )

    # -- hypotheses ---------------------------------------------------------------------------------------
    def shortlist(self) -> list[list[ScoredStart]]:
        """Return the hypotheses of the first round, each with its starts.

        The score test chooses. An element in series with a moved node always enters, since a small compliance says little about a large
        one. Above a wide gap the hypotheses enter that come nearest to the records at large amplitudes.
        """
        tried = [h for h in hypotheses(self.current.structure.network) if self.is_sensible(h)]
        moved = set(self.problem.network.moved_nodes)
        groups: dict[object, list[ScoredStart]] = {}
        any_sign = self.has_lost_phase or self.is_lightly_damped  # a shifted phase may turn a sign around
        found = admissible_starts(self.problem, self.fitter, self.current, tried, any_sign)
        for s in found:
            always = s.hypothesis.kind.series and bool(set(s.hypothesis.where) & moved)
            if s.hypothesis in groups or len(groups) < self.entries or always:
                groups.setdefault(s.hypothesis, []).append(s)
        if gap(self.problem, self.current) < self.settings.wide_gap:
            return list(groups.values())
        return [*groups.values(), *(g for g in self.nearest(found) if g[0].hypothesis not in groups)]

    @property
    def entries(self) -> int:
        """Number of hypotheses of the first round: more where the windows take few physics steps."""
        p = self.windowed
        steps = sum(len(p.records[i]) * max(p.every(p.records[i]), STEPS_PER_SAMPLE) for i in p.estimation)
        return max(self.settings.first_round, self.settings.cheap_steps // steps)

    def is_sensible(self, h: Hypothesis) -> bool:
        """Return False for hypotheses that repeat an effect already in the model, in series or in parallel.

        A periodic law at a node without mass, which an element in series brought, is not sensible either.
        """
        if h.place != "between":
            return True
        network, found = self.current.structure.network, self.current.structure.names
        is_joint = not {*self.problem.network.nodes, GROUND}.issuperset(h.where)
        is_repeated = any(e.type == h.effect and e.name in found for e in beside(network, h.where))
        return not is_repeated and h.behind not in found and not (h.kind.periodic and is_joint)

    def nearest(self, found: Sequence[ScoredStart]) -> list[list[ScoredStart]]:
        """Return the hypotheses with the smallest error at large amplitudes, without a fit."""
        every: dict[object, list[ScoredStart]] = {}
        for s in found:
            every.setdefault(s.hypothesis, []).append(s)
        scored = []
        for group in every.values():
            scores = _misfit(
                self, [t for s in group for t in amplified(self, s, self.settings.amplitudes[1::2])]
            )
            if scores is not None and len(scores):
                scored.append((float(scores.min()), group))
        scored.sort(key=lambda t: t[0])
        return [group for _, group in scored[: self.settings.nearest]]

    # -- fits ---------------------------------------------------------------------------------------------
    def fit_to_windows(self, group: list[ScoredStart]) -> Candidate | None:
        """Fit a hypothesis to the windows from its best starts; None where every fit breaks down."""
        fitter, tries = self.window_fitter, []
        for structure, x in starts(self, group):
            known = transfer_states(self.windowed, self.current.network, self.window_states, structure)
            try:
                if structure.hypotheses[-1].kind.periodic:  # first find the position of rest that holds
                    guessed = {i: guess(self.windowed, structure.at(x), i) for i in self.windowed.estimation}
                    own, guess_cost = (
                        fitter.cost(structure, x, s, self.current.offset, self.windowed.estimation)
                        for s in (known, guessed)
                    )
                    known = guessed if guess_cost < own else known
                f = fitter.fit(structure, x, known, self.current.offset, iterations=3)
            except BROKEN:
                continue
            tries.append(self._candidate(self.windowed, f))
        if not tries:
            return None
        f = min(tries, key=lambda c: c.deviance).fit
        try:
            f = fitter.fit(f.structure, f.x, f.initial, f.offset, iterations=4)
        except BROKEN:
            return None
        return self._candidate(self.windowed, f)

    def _candidate(self, problem: Problem, fit: Fit) -> Candidate:
        return Candidate(fit, deviance(problem, fit, refined_noise(self.first_noise, self.least_noise)))

    def fit_to_records(self, r: Candidate) -> Candidate | None:
        """Fit a candidate of the windows to whole records; None where the fit breaks down."""
        try:
            p = self.windowed
            filters = whitener(residuals(p, r.fit), white_noise(p, r.fit, self.least_noise))
            known = transfer_states(self.problem, self.current.network, self.current.initial, r.fit.structure)
            known |= {i: r.fit.initial[i] for i, w in self.windows.items() if w.first == 0}
            fitter = Fitter(self.problem, filters)
            f = fitter.fit(r.fit.structure, r.fit.x, known, r.fit.offset, iterations=5)
            x = fit_segments(self.problem, f.structure, r.fit.x, fitter) if self.is_lightly_damped else None
            if x is not None:
                again = fitter.fit(f.structure, x, iterations=5)
                f = again if again.cost + again.prior < f.cost + f.prior else f
        except BROKEN:
            return None
        return self._candidate(self.problem, f)

    def settle_noise(self, r: Candidate, noise: Array) -> Candidate | None:
        """Fit a candidate until its own noise has converged; a periodic law also at neighbouring periods."""
        p = self.problem
        try:
            r = settle(p, r.fit.structure, r.fit.x, self.least_noise, r.fit, iterations=4, noise=noise)
            for _ in range(3 if r.hypotheses[-1].kind.periodic else 0):
                filters = whitener(residuals(p, r.fit), noise)
                f = try_neighbouring_periods(p, Fitter(p, filters), r.fit, r.fit.structure.names[-1])
                again = settle(p, f.structure, f.x, self.least_noise, f, rounds=2, iterations=4, noise=noise)
                if again.deviance > r.deviance - self.settings.better_period:
                    break
                r = again
        except BROKEN:
            return None
        return r

    def first_round(self) -> list[Candidate]:
        """Fit the hypotheses of the shortlist to the windows, and the best of them to whole records."""
        groups, _ = self.shortlist(), (self.window_fitter, self.window_states)
        with ThreadPoolExecutor(self.settings.jobs, initializer=adopt, initargs=(running(),)) as pool:
            fitted = _best_first(pool.map(self.fit_to_windows, groups))
            ranked = fitted[: self.settings.finals]
            # the deviance under coloured noise may miss the candidate that closes most of the gap
            closest = min(fitted, key=lambda r: gap(self.windowed, r.fit), default=None)
            ranked += [closest] if closest is not None and closest not in ranked else []
            return _best_first(pool.map(self.fit_to_records, ranked))

    def run(self) -> ScreeningResult:
        """Run the stage."""
        ranked = self.coarse.first_round()
        if self.coarse is not self:
            ranked = _best_first(map(self._transferred, ranked))
        if not ranked:
            return ScreeningResult((), self.first_noise)
        noise = np.min([white_noise(self.problem, r.fit, self.least_noise) for r in ranked], axis=0)
        with ThreadPoolExecutor(self.settings.jobs, initializer=adopt, initargs=(running(),)) as pool:
            ranked = _best_first(pool.map(lambda r: self.settle_noise(r, noise), ranked))
            again = [(r, k) for r in ranked[:2] for k in self.settings.shapes]

            def refit(t: tuple[Candidate, float]) -> Candidate | None:
                return refit_with_other_shape(
                    self.problem, t[0], shape_index(t[0]), t[1], self.least_noise, noise
                )

            for (r, _), other in zip(again, pool.map(refit, again), strict=True):
                if other is not None:
                    ranked = [other if q is r and other.deviance < q.deviance else q for q in ranked]
        return ScreeningResult(tuple(self.rank(ranked)), noise)

    def _transferred(self, r: Candidate) -> Candidate | None:
        try:
            return self._candidate(self.problem, transfer(self.problem, r.fit, self.least_noise))
        except BROKEN:
            return None

    def rank(self, ranked: Sequence[Candidate]) -> list[Candidate]:
        """Order candidates by deviance.

        If the first candidate leaves more than half of the gap, a candidate that closes half of the gap is moved to the front.
        """
        ranked = sorted(ranked, key=lambda r: r.deviance)
        widths = [gap(self.problem, r.fit) for r in ranked]
        if ranked and min(widths) < 0.5 * gap(self.problem, self.current) < widths[0]:
            closest = ranked[int(np.argmin(widths))]
            ranked = [closest, *(r for r in ranked if r is not closest)]
        return simplest_first(ranked, self.settings.chance, self.settings.sure)


def _best_first(found: Iterable[Candidate | None]) -> list[Candidate]:
    """Return the candidates that did not break down, smallest deviance first, each set of effects once."""
    best: dict[object, Candidate] = {}
    for r in found:
        if r is not None and math.isfinite(r.deviance):
            old = best.get(r.hypotheses)
            best[r.hypotheses] = r if old is None or r.deviance < old.deviance else old
    return sorted(best.values(), key=lambda r: r.deviance)


# ------------------------------------------------------------------------------------------ where fits start


def starts(screening: Screening, group: list[ScoredStart]) -> list[tuple[Structure, Array]]:
    """Return the starts of a hypothesis with the smallest error: structure and start values (parameters,), transformed.

    The starts of the score test are simulated at several amplitudes, with the nominal values of the model's own parameters. The score
    test is local; a large effect is found by trying.
    """
    current, kind = screening.current, group[0].hypothesis.kind
    if kind.periodic:  # a large step leads to another period: start from the refitted values
        known = dict(zip((f.path for f in current.structure.free), current.x, strict=True))
        near = [t for s in group[:3] for t in amplified(screening, s, (1.0,))]
        return [
            (t, np.array([known.get(f.path, v) for f, v in zip(t.free, t.start, strict=True)])) for t in near
        ]
    tries, c = [], screening.settings
    for s in group[:6]:
        more = c.large * (s.start.inverse or screening.has_lost_phase) + c.other_sign * s.start.signed
        tries += amplified(screening, s, c.amplitudes + more)
    if not tries:
        return []
    scores = _misfit(screening, tries)
    if scores is None:
        return [(tries[0], tries[0].start)]
    order = np.argsort(scores)
    picked = [tries[0]] if order[0] == 0 else [tries[order[0]], tries[0]]
    if kind.shaped_by and len(order) > 2:
        other = next((tries[k] for k in order[1:] if tries[k] not in picked), None)
        picked += [other] if other is not None else []
    return [(t, t.start) for t in picked]


def amplified(screening: Screening, s: ScoredStart, factors: Sequence[float]) -> list[Structure]:
    """Return a start at multiples of its amplitude; once where the effect has no amplitude."""
    out = []
    for factor in factors if s.start.grows else (1.0,):
        values = dict(s.values)
        for key in s.start.grows:
            values[key] *= 1 / factor if s.start.inverse else factor
        try:
            out.append(add(with_fitted_effects(screening.current), s.hypothesis, values))
        except InputError:
            continue
    return out


def _misfit(screening: Screening, tries: Sequence[Structure]) -> Array | None:
    """Return the sum over channels of the logarithm of the residual's variance (tries,): a drifting channel does not hide other channels."""
    problem, current = screening.windowed, screening.current
    if not tries:
        return None
    scores, nets = np.zeros(len(tries)), [t.network for t in tries]
    initial = [transfer_states(problem, current.network, screening.window_states, t) for t in tries]
    at = {i: np.stack([b[i] for b in initial], axis=1) for i in problem.estimation}
    try:
        seen = problem.simulate_all(nets, problem.estimation, at, like=nets[0])
    except BROKEN:
        return None
    for i, y in seen.items():
        with np.errstate(over="ignore", invalid="ignore"):
            v = np.var(problem.records[i].measured[:, :, None] - y, axis=0)
            v = v + screening.least_noise[:, None] ** 2
        is_finite = np.isfinite(v).all(axis=0)
        scores += np.where(is_finite, np.sum(np.log(np.where(np.isfinite(v), v, 1.0)), axis=0), math.inf)
    return scores


# -------------------------------------------------------------------------------------------- free decays


def screen_effects(
    problem: Problem, current: Fit, least_noise: Array, settings: SearchSettings
) -> ScreeningResult:
    """Run one stage of forward addition.

    A free decay whose frequency the model misses is compared over its beginning, which then grows: later the phase is arbitrary.

    Args:
        problem: Model and records.
        current: The fit to which an effect is added.
        least_noise: Smallest noise of weights (channels,).
        settings: Settings of the search.
    """
    if problem.network.inputs or gap(problem, current) < settings.lost_phase:
        return Screening(problem, current, least_noise, settings).run()
    return _screen_growing(problem, current, least_noise, settings)


def _screen_growing(
    problem: Problem, current: Fit, least_noise: Array, settings: SearchSettings
) -> ScreeningResult:
    share, part, fit = 1.0, problem, current
    longest = max(map(len, problem.records))
    while gap(part, fit) >= settings.lost_phase and share * longest > settings.shortest:
        share /= 2
        part = beginning(problem, share, settings.shortest)
        # from the measured state: a state that is fitted at a wrong frequency is no estimate
        fit = Fitter(part, white_filters(least_noise)).fit(current.structure, current.x, iterations=0)
    many = replace(settings, first_round=100, finals=8)
    ranked = list(Screening(part, fit, least_noise, many, has_lost_phase=True).run().ranked)

    def change_each(change: Callable[[Candidate], Candidate]) -> None:
        for r in list(ranked):
            try:
                ranked[ranked.index(r)] = change(r)
            except BROKEN:
                ranked.remove(r)

    while share < 1.0:
        share = min(GROWTH * share, 1.0)
        part = beginning(problem, share, settings.shortest) if share < 1.0 else problem
        fitter = Fitter(part, white_filters(least_noise))

        def refit(r: Candidate, fitter: Fitter = fitter) -> Candidate:
            f = fitter.fit(r.fit.structure, r.fit.x, r.fit.initial, r.fit.offset)
            return with_fit(r, f, math.nan)

        change_each(refit)
    noise = least_noise
    if ranked:
        noise = np.min([white_noise(problem, r.fit, least_noise) for r in ranked], axis=0)
    change_each(lambda r: settle(problem, r.fit.structure, r.fit.x, least_noise, r.fit, noise=noise))
    ranked.sort(key=lambda r: r.deviance)
    return ScreeningResult(tuple(simplest_first(ranked, settings.chance, settings.sure)), noise)


def beginning(problem: Problem, share: float, least: int) -> Problem:
    """Return the problem with the first `share` of every record, at least `least` samples where a record has as many."""
    return problem.with_records(
        [r.part(0, max(int(share * len(r)), min(len(r), least)), r.name) for r in problem.records]
    )
