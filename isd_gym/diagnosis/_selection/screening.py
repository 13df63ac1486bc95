"""One stage of forward addition: every law is matched to the residual, and the best matches are fitted to the records."""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from ..._common.errors import InputError
from ...physics.elements import beside
from ...physics.network import GROUND
from .._estimation.gauss_newton import Fit, Fitter, Point, gap, residuals
from .._estimation.initial_states import guess, transfer_states
from .._estimation.multiple_shooting import GROWTH, in_segments, is_lightly_damped, segments_of, states_within
from .._estimation.noise import trusted_noise, white_weights
from .._hypotheses.law_matching import follows_motion
from .._hypotheses.library import Hypothesis, hypotheses
from .._hypotheses.motion import motions
from .._hypotheses.pair_forces import law_forces, thinning_loses
from .._simulation.problem import BROKEN
from .._simulation.time_limit import adopt, running
from .admissibility import admissible_matches, travels
from .candidate import (
    Candidate,
    deviance,
    filters_for,
    settle,
    share_of,
    simplest_first,
    transfer,
    weights_for,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

    from ..._common.arrays import Array
    from ...physics.elements import Motion
    from .._estimation.structure import Structure
    from .._hypotheses.law_matching import Match
    from .._simulation.problem import Problem
    from .admissibility import Travel
    from .settings import SearchSettings

    T = TypeVar("T")
    R = TypeVar("R")

#: starts of a law that are simulated, and starts that are fitted; a law over travel has an optimum per period
TRIED, FITTED, PERIODS = 6, 2, 4
#: laws that are simulated where the gap is wide, as a multiple of the number that is fitted
SIMULATED = 3
#: variants of a law at one place that are fitted, such as the sides of a stop
VARIANTS = 2
#: multiples of the matched size at which an effect in series, at a drive or at a sensor is tried
SIZES = (1.0, 4.0, 20.0, 80.0)
#: kinds of laws that dissipate, and shares of the damping with which they are tried
DISSIPATING, DAMPING = ("dry_friction", "viscous"), (0.5, 0.25)
#: ratio of mean squared errors to the closest candidate, from which on a candidate has no prospect
INFERIOR = 4.0
#: laws at one place that are as good as a free curve: a polynomial of degree three fits any smooth curve with three bends
BENDS = 3
#: lengths of segments that keep the phase, as multiples of the usual length
LENGTHS = (1.0, 0.5, 0.25, 0.12, 0.06, 0.03)
#: Gauss-Newton steps of the first fit of each start, of the fit of the best start, and of a fit from segments to whole records
FIRST, FURTHER, WHOLE = 3, 5, 8


@dataclass(frozen=True)
class ScreeningResult:
    """Candidates of a stage."""

    #: best candidate first
    ranked: tuple[Candidate, ...]
    #: share of independent samples with which the candidates were compared (channels,)
    share: Array
    #: match with the largest share, by place
    places: tuple[Match, ...]


@dataclass(frozen=True)
class Screening:
    """A stage: the fit to which an effect is added, and the records of the first fits."""

    problem: Problem
    current: Fit
    #: smallest noise of weights (channels,)
    least_noise: Array
    settings: SearchSettings
    #: travel of every pair over all samples (default: over the samples of the problem)
    known: Mapping[tuple[str, str], Travel] | None = None
    #: length of the segments, as a multiple of the usual length
    length: float = math.inf

    @cached_property
    def share(self) -> Array:
        """Share of independent samples in the residuals of the current fit (channels,)."""
        return share_of(self.problem, self.current)

    @cached_property
    def motion(self) -> dict[tuple[str, str], Motion]:
        """Motion of every pair of nodes in the current fit."""
        return motions(self.problem, self.current)

    @cached_property
    def fitter(self) -> Fitter:
        """Fitter with filters that whiten the residual of the current fit."""
        return Fitter(self.problem, filters_for(self.problem, self.current, self.least_noise))

    @cached_property
    def plain(self) -> Fitter:
        """Fitter with weights by the level of the residual of the current fit."""
        return Fitter(self.problem, weights_for(self.problem, self.current, self.least_noise))

    @cached_property
    def coarse(self) -> Screening:
        """The same stage on as few samples as the motion needs."""
        p, few = self.problem, self.problem.rough
        if few is p or thinning_loses(p, self.current, self.least_noise):
            return self
        known = travels(p, self.current.network, self.motion)
        now = transfer(few, self.current, self.least_noise)
        coarse = replace(self, problem=few, current=now, known=known)
        return coarse if coarse.keeps_phase else self

    @cached_property
    def brief(self) -> Screening:
        """The same stage on segments with initial states of their own, where the simulation may have lost the phase of a motion."""
        p, s = self.problem, self.settings
        if self.is_driven or gap(p, self.current) < s.wide_gap**2:
            return self
        best = self
        for length in LENGTHS:
            found = in_segments(p, self.current, self.least_noise, length)
            if found is None:
                continue
            best = replace(self, problem=found[0], current=found[1], length=length)
            if gap(best.problem, best.current) < s.lost_phase:
                break
        return best

    @property
    def keeps_phase(self) -> bool:
        """Return whether the simulation of the stage, or of its brief segments, follows the phase of the motion."""
        return self.brief is self or gap(self.brief.problem, self.brief.current) < self.settings.lost_phase

    def each(self, function: Callable[[T], R], items: Iterable[T]) -> list[R]:
        """Return the function's value for every item, in order; threads share the work."""
        with ThreadPoolExecutor(self.settings.jobs, initializer=adopt, initargs=(running(),)) as pool:
            return list(pool.map(function, items))

    # -- hypotheses ---------------------------------------------------------------------------------------
    @cached_property
    def matches(self) -> list[Match]:
        """Every admissible law at every place, the largest share of the residual first."""
        tried = [h for h in hypotheses(self.current.structure.network) if self.is_sensible(h)]
        return admissible_matches(
            self.problem,
            self.fitter,
            self.current,
            trusted_noise(residuals(self.problem, self.current), self.least_noise),
            tried,
            self.known,
        )

    def shortlist(self) -> list[list[Match]]:
        """Return the laws of the first fits with their matches; an element in series with a moved node always enters, since a small one
        says little about a large one."""
        moved, most = set(self.problem.network.moved_nodes), self.settings.matches
        groups: dict[Hypothesis, list[Match]] = {}
        for m in self.matches:
            groups.setdefault(m.hypothesis, []).append(m)
        order = list(groups)
        if self.is_wide:
            # the motion of the fit tells little about the force: every other law is the closest in simulation
            near = order[: SIMULATED * most]
            misfits = self.each(lambda h: self.misfit(groups[h][0]), near)
            closest = [near[k] for k in np.argsort(misfits, kind="stable")]
            order = list(dict.fromkeys([h for both in zip(near, closest, strict=True) for h in both] + order))
        first: list[Hypothesis] = []
        for h in order:
            alike = sum(g.effect == h.effect and set(g.where) == set(h.where) for g in first)
            if len(first) < most and alike < VARIANTS:
                first.append(h)
        series = [h for h in order if h.kind.series and set(h.where) & moved and h not in first]
        return [groups[h] for h in (*first, *series)]

    def is_sensible(self, h: Hypothesis) -> bool:
        """Return False for effects that the model has at the place, for as many laws at one place as a curve has bends, and for periodic
        laws at a node that an element in series brought."""
        if h.place != "between":
            return True
        network, found = self.current.structure.network, self.current.structure.names
        is_joint = not {*self.problem.network.nodes, GROUND}.issuperset(h.where)
        is_repeated = any(e.type == h.effect and e.name in found for e in beside(network, h.where))
        here = [q for q in self.current.structure.hypotheses if set(q.where) == set(h.where)]
        is_curve = sum(not q.kind.series for q in (*here, h)) >= BENDS
        return not (is_repeated or is_curve or h.behind in found or (h.kind.periodic and is_joint))

    @cached_property
    def is_driven(self) -> bool:
        """Return whether inputs and damping hold the phase of the motion."""
        return bool(self.problem.network.inputs) and not is_lightly_damped(self.problem.network)

    @cached_property
    def is_wide(self) -> bool:
        """Return whether the gap is so wide that matches, which are linear, may miss the law or its size, and a simulation tells more."""
        return self.is_driven and gap(self.problem, self.current) > self.settings.wide_gap**2

    @cached_property
    def bases(self) -> tuple[dict[str, float], dict[str, float]]:
        """Parameters of the current fit, and the nominal ones with the effects of the fit, transformed, by path."""
        free = self.current.structure.free
        known = {f.path: float(v) for f, v in zip(free, self.current.x, strict=True)}
        return known, {f.path: known[f.path] if f.owner >= 0 else f.mean for f in free}

    def sized(
        self, m: Match, sizes: Sequence[float], bases: Sequence[dict[str, float]]
    ) -> list[list[tuple[Structure, Array]]]:
        """Return starts of a match, for each size a list: from several values of the parameters of the fit."""
        out: list[list[tuple[Structure, Array]]] = []
        for size in sizes if m.start.grows else (1.0,):
            own = []
            for base in bases:
                with suppress(InputError):
                    own.append(replace(m, moved=base).sized(size).begin(self.current.structure))
            out += [own] if own else []
        return out

    def misfit(self, m: Match) -> float:
        """Return the smallest misfit of a match, and of larger ones, in simulation."""
        tries = [t for own in self.sized(m, SIZES[:3], (m.moved, self.bases[1])) for t in own]
        return float(np.min(_misfit(self, tries))) if tries else math.inf

    # -- fits ---------------------------------------------------------------------------------------------
    def starts(self, group: Sequence[Match]) -> list[tuple[Structure, Array]]:
        """Return the starts of a law with the smallest error, from the parameters that the match moves, the fitted and the nominal ones,
        the best one with less damping, and a larger one that is closer: structure and start values (parameters,), transformed."""
        kind, (known, nominal) = group[0].hypothesis.kind, self.bases
        is_plain = kind.place == "between" and not kind.series
        tries: list[list[tuple[Structure, Array]]] = []
        for m in group[: PERIODS if kind.periodic else TRIED]:
            bases = (m.moved, known) if kind.periodic else (m.moved, known, nominal)
            tries += self.sized(m, SIZES[:1] if is_plain else SIZES, bases)
        if not tries:
            return []
        usual = len(tries)
        tries += [[begun] for m in group[:TRIED] for begun in self.starts_with_less_damping(m)]
        lighter = range(usual, len(tries))
        if is_plain and self.is_wide and not kind.periodic:
            larger = self.sized(group[0], SIZES[1:3], (group[0].moved, nominal))
            tries += [[t for own in larger for t in own]] if larger else []
        scores = iter(_misfit(self, [t for own in tries for t in own]))
        best = [min(((next(scores), k) for k in range(len(own))), key=lambda t: t[0]) for own in tries]
        order = list(range(usual))
        if not kind.periodic:
            order.sort(key=lambda k: best[k][0])
            order = list(dict.fromkeys([*order[: FITTED - 1], 0, *order]))[:FITTED]
        order += [min(lighter, key=lambda k: best[k][0])] if lighter else []
        order += [k for k in range(lighter.stop, len(tries)) if best[k][0] < min(best[:usual])[0]]
        return [tries[k][best[k][1]] for k in order]

    def starts_with_less_damping(self, m: Match) -> Iterator[tuple[Structure, Array]]:
        """Yield starts with a share of the damping at the place of a law that dissipates, which takes over the damping's work: the law
        may have an optimum at either split."""
        h, current = m.hypothesis, self.current
        if h.kind.mechanism not in DISSIPATING or not follows_motion(h):
            return
        here = {f"{e.name}.damping" for e in beside(current.network, h.where) if e.type == "linear_damping"}
        free = [f for f in current.structure.free if f.path in here]
        motion = self.motion.get((h.where[0], h.where[1]))
        if not free or motion is None:
            return
        step = self.problem.records[self.problem.estimation[0]].step
        force = law_forces(current.network, (h.where[0], h.where[1]), motion, step, [(h, m.values)])[:, 0]
        work, square = float(np.mean(force * motion.v)), float(np.mean(motion.v**2))
        if not work > 0:
            return
        for share in DAMPING:
            less = {f.path: f.forward(max(share * f.back(m.moved[f.path]), f.back(f.low))) for f in free}
            taken = square * sum(f.back(m.moved[f.path]) - f.back(less[f.path]) for f in free)
            with suppress(InputError):
                yield replace(m, moved=m.moved | less).sized(1 + taken / work).begin(current.structure)

    def fit(self, group: Sequence[Match]) -> list[Candidate]:
        """Fit a law to the records from its best starts; return the best fit."""
        tries: list[tuple[Candidate, Fitter]] = []
        for structure, x in self.starts(group):
            for fitter in (self.fitter, self.plain):
                with suppress(*BROKEN):
                    known = self.states(fitter, structure, x)
                    f = fitter.fit(structure, x, known, self.current.offset, iterations=FIRST)
                    tries.append((self._candidate(f), fitter))
        out = []
        for r in best_of_each_law(r for r, _ in tries):
            fitter = next(own for q, own in tries if q is r)
            with suppress(*BROKEN):
                f = fitter.fit(r.fit.structure, r.fit.x, r.fit.initial, r.fit.offset, iterations=FURTHER)
                out.append(self._candidate(f))
        return out

    def states(self, fitter: Fitter, structure: Structure, x: Array) -> dict[int, Array]:
        """Return the initial states of the current fit or guesses from the first samples, whichever cost less."""
        p = self.problem
        known = transfer_states(p, self.current.network, self.current.initial, structure)
        guessed = {i: guess(p, structure.at(x), i) for i in p.estimation}
        own, other = (
            fitter.seen(structure, Point(x, s, self.current.offset), p.estimation) for s in (known, guessed)
        )
        return guessed if other.total < own.total else known

    def leading(self, found: Iterable[Candidate | None]) -> list[Candidate]:
        """Return the best fit of each set of effects, smallest deviance first, at most `SearchSettings.finals`."""
        return best_of_each_law(found)[: self.settings.finals]

    def _candidate(self, fit: Fit) -> Candidate:
        return Candidate(fit, deviance(self.problem, fit, self.least_noise, self.share))

    def continued(self, r: Candidate, brief: Screening) -> Candidate | None:
        """Return a candidate of brief segments, fitted to segments that grow to whole records; None where the fit breaks down."""
        f, pieces, length, whole = r.fit, brief.problem, brief.length, self.problem
        weights = filters_for(pieces, f, self.least_noise)
        try:
            while pieces is not whole:
                longer = segments_of(whole, length := GROWTH * length) or whole
                if len(longer.records) == len(pieces.records) and longer is not whole:
                    continue
                known = (states_within(pieces, f, longer),)
                plainly = Fitter(longer, white_weights(self.least_noise))
                states = plainly.follow(f.structure, f.x, longer.estimation, about=known).initial
                steps = WHOLE if longer is whole else FURTHER
                f = Fitter(longer, weights).fit(f.structure, f.x, states, iterations=steps)
                pieces = longer
            return self._candidate(f)
        except BROKEN:
            return None

    def settle(self, r: Candidate, share: Array, least: float) -> Candidate | None:
        """Fit a candidate until its weights have converged; only once where the gap is far above the `least` gap."""
        p = self.problem
        rounds = 1 if gap(p, r.fit) > INFERIOR * least else 3
        try:
            return settle(
                p, r.fit.structure, r.fit.x, self.least_noise, r.fit, rounds=rounds, iterations=4, share=share
            )
        except BROKEN:
            return None

    def first_round(self) -> list[Candidate]:
        """Fit the laws of the shortlist: to whole records, to segments where the phase is lost, or to both where it may be lost."""
        brief = self.brief
        if brief is self:
            return self.fit_shortlist()
        found = brief.fit_shortlist()
        ranked = best_of_each_law(self.each(lambda r: self.continued(r, brief), found))
        if gap(self.problem, self.current) < self.settings.wide_gap:
            ranked = self.leading([*ranked, *self.fit_shortlist()])
        return ranked

    def fit_shortlist(self) -> list[Candidate]:
        """Fit the laws of the shortlist to the records of this stage."""
        groups, _ = self.shortlist(), (self.fitter, self.plain, self.share)
        return self.leading(r for found in self.each(self.fit, groups) for r in found)

    def run(self) -> ScreeningResult:
        """Run the stage."""
        ranked = self.coarse.first_round()
        places: dict[frozenset[str], Match] = {}
        for m in self.coarse.brief.matches:
            places.setdefault(frozenset(m.hypothesis.where), m)
        best = tuple(places.values())
        if self.coarse is not self:
            found = []
            for r in ranked:
                with suppress(*BROKEN):
                    found.append(self._candidate(transfer(self.problem, r.fit, self.least_noise)))
            ranked = best_of_each_law(found)
        if not ranked:
            return ScreeningResult((), self.share, best)
        closest = min(ranked, key=lambda r: gap(self.problem, r.fit))
        share = share_of(self.problem, closest.fit)
        least = gap(self.problem, closest.fit)
        ranked = best_of_each_law(self.each(lambda r: self.settle(r, share, least), ranked))
        first = simplest_first(ranked, self.settings.chance, self.settings.sure)
        return ScreeningResult(tuple(first), share, best)


def best_of_each_law(found: Iterable[Candidate | None]) -> list[Candidate]:
    """Return the fit of each set of effects with the smallest deviance, smallest deviance first."""
    out: dict[tuple[Hypothesis, ...], Candidate] = {}
    fitted = (r for r in found if r is not None and math.isfinite(r.deviance))
    for r in sorted(fitted, key=lambda r: r.deviance):
        out.setdefault(r.hypotheses, r)
    return [*out.values()]


def _misfit(stage: Screening, tries: Sequence[tuple[Structure, Array]]) -> Array:
    """Return the sum over channels of the logarithm of the residual's variance (tries,): a drifting channel does not hide other
    channels."""
    problem, current = stage.problem, stage.current
    scores = np.zeros(len(tries))
    try:
        nets = [t.at(x) for t, x in tries]
        initial = [transfer_states(problem, current.network, current.initial, t) for t, _ in tries]
        at = {i: np.stack([b[i] for b in initial], axis=1) for i in problem.estimation}
        seen = problem.simulate_all(nets, problem.estimation, at, like=tries[0][0].network)
    except BROKEN:
        return np.full(len(tries), math.inf)
    for i, y in seen.items():
        with np.errstate(over="ignore", invalid="ignore"):
            v = np.var(problem.records[i].measured[:, :, None] - y, axis=0)
            v = v + stage.least_noise[:, None] ** 2
        is_finite = np.isfinite(v).all(axis=0)
        scores += np.where(is_finite, np.sum(np.log(np.where(np.isfinite(v), v, 1.0)), axis=0), math.inf)
    return scores
