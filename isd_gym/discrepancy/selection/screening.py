"""One stage of the search: many hypotheses fitted to a stretch of the records, the foremost to all of them."""

from __future__ import annotations

import functools
import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from ...elements import beside
from ...errors import InputError
from ...network import GROUND
from ..estimation.gauss_newton import Fit, Fitter, gap, residuals
from ..estimation.initial_states import along, carried, guess
from ..estimation.multiple_shooting import begun, remembers
from ..estimation.noise import finer, plain, whitener
from ..estimation.structure import Structure, add
from ..hypotheses.library import Hypothesis, hypotheses
from ..hypotheses.neighbouring_periods import comb
from ..hypotheses.position_spectrum import thinning_loses
from ..hypotheses.score_test import Screened, advanced, screen
from .candidate import (
    BROKEN,
    Candidate,
    begun_again,
    likelihood,
    reckoned,
    settled,
    simplest_first,
    transferred,
    with_fit,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from ..simulation.problem import Array, Problem, Record
    from .settings import SearchSettings

#: multiples of the amplitude that the score test gives, of one that it says little about, and of one whose sign may be either
AMPLITUDES, LARGE, OTHER = (0.5, 1.0, 2.0, 5.0, 12.0, 30.0), (80.0,), (-2.0, -12.0, -80.0)
COARSE = (1.0, 5.0, 30.0)  # of those, where every hypothesis is tried
THREADS = 2  # the kernel and the linear algebra let go of the interpreter


@dataclass(frozen=True)
class Window:
    """Samples first..first+size-1 of a record."""

    first: int
    size: int

    def of(self, record: Record) -> Record:
        return record.part(self.first, self.first + self.size, record.name)


@dataclass(frozen=True)
class Finish:
    """The order in which the candidates came in, best first, and the white noise (channels,) they were compared under."""

    ranked: tuple[Candidate, ...]
    white: Array


def shape_of(r: Candidate) -> int | None:
    """Which free number shapes its last effect."""
    path = f"{r.fit.structure.names[-1]}.{r.hypotheses[-1].kind.shaped_by}"
    return next((k for k, f in enumerate(r.fit.structure.free) if f.path == path), None)


def widest(record: Record, residual: Array, settings: SearchSettings) -> Window:
    """The stretch of a record in which the whitened residual (n, channels) is largest: elsewhere an effect may be silent."""
    size = min(max(int(settings.window * len(record)), settings.least_window), len(record))
    energy = np.concatenate([[0.0], np.cumsum(np.sum(residual**2, axis=1))])
    gain = energy[size:] - energy[:-size]
    # a start from rest is known, one in mid-motion must be fitted: the beginning wins where it is nearly as good
    return Window(0 if gain[0] > 0.7 * gain.max() else int(np.argmax(gain)), size)


@dataclass(frozen=True)
class Race:
    """What all stages share: the fit from which they set out, its noise, and the stretches over which heats are run."""

    problem: Problem
    current: Fit
    floors: Array
    settings: SearchSettings
    lost: bool = False

    @cached_property
    def hot(self) -> Array:
        """White noise to reckon with before anything is explained."""
        return reckoned(self.problem, self.current, self.floors)

    @cached_property
    def fitter(self) -> Fitter:
        return Fitter(self.problem, whitener(residuals(self.problem, self.current), self.hot))

    @cached_property
    def slight(self) -> bool:
        """Whether the motion is remembered for many periods."""
        return remembers(self.problem.network)

    @cached_property
    def windows(self) -> dict[int, Window]:
        p = self.problem
        left = dict(zip(p.estimation, residuals(p, self.current), strict=True))
        return {i: widest(p.records[i], self.fitter.weights(left[i]), self.settings) for i in p.estimation}

    @cached_property
    def short(self) -> Problem:
        cut = [self.windows[i].of(r) if i in self.windows else r for i, r in enumerate(self.problem.records)]
        return self.problem.with_records(cut)

    @cached_property
    def heat(self) -> Fitter:
        return Fitter(self.short, self.fitter.weights)

    @cached_property
    def begin(self) -> dict[int, Array]:
        """Initial states of the stretches in the current fit."""
        p, now = self.problem, self.current
        out = {}
        for i, w in self.windows.items():
            if w.first == 0:
                out[i] = now.initial[i]
            else:
                there = along(p, now.structure, now.x, {i: now.initial[i]}, [w.first])[i][0]
                out[i] = guess(self.short, now.network, i, there, now.structure.offsets)
        return out

    # -- stages -----------------------------------------------------------------------------------------
    def shortlist(self) -> list[list[Screened]]:
        """The hypotheses that the score test puts first, each with its starts."""
        tried = [h for h in hypotheses(self.current.structure.network) if self.sensible(h)]
        moved = set(self.problem.network.moved_nodes)
        groups: dict[object, list[Screened]] = {}
        # where the motion is remembered for long, its phase turns a sign about
        found = screen(self.problem, self.fitter, self.current, tried, self.lost or self.slight)
        for s in found:
            # it says little about what is put in series
            always = s.hypothesis.kind.series and bool(set(s.hypothesis.where) & moved)
            if s.hypothesis in groups or len(groups) < self.entries or always:
                groups.setdefault(s.hypothesis, []).append(s)
        if gap(self.problem, self.current) < self.settings.far:
            return list(groups.values())
        return [*groups.values(), *(g for g in self.nearest(found) if g[0].hypothesis not in groups)]

    @property
    def entries(self) -> int:
        """How many hypotheses run: the score test, which looks at small steps, chooses only where not all can be afforded."""
        samples = sum(len(self.short.records[i]) for i in self.short.estimation)
        return max(self.settings.heats, self.settings.cheap // samples)

    def sensible(self, h: Hypothesis) -> bool:
        """Whether a hypothesis of the network as it is now is one: what was found is not put in line again, nor beside itself, and
        detents are between parts that the owner knows (at a node without mass, which a joint brought, they leave the motion many
        ways to go on)."""
        if h.place != "between":
            return True
        network, found = self.current.structure.network, self.current.structure.names
        joint = not {*self.problem.network.nodes, GROUND}.issuperset(h.where)
        twice = any(e.type == h.effect and e.name in found for e in beside(network, h.where))
        return not twice and h.behind not in found and not (h.kind.periodic and joint)

    def nearest(self, found: Sequence[Screened]) -> list[list[Screened]]:
        """Of a gap so wide that small steps say little: the hypotheses that come nearest as they stand, at large amplitudes."""
        every: dict[object, list[Screened]] = {}
        for s in found:
            every.setdefault(s.hypothesis, []).append(s)
        came = []
        for group in every.values():
            scores = _misfit(self, [t for s in group for t in amplified(self, s, COARSE)])
            if scores is not None and len(scores):
                came.append((float(scores.min()), group))
        came.sort(key=lambda t: t[0])
        return [group for _, group in came[: self.settings.nearest]]

    def try_out(self, group: list[Screened]) -> Candidate | None:
        """A hypothesis fitted to the stretches, from its best starts."""
        tries: list[Candidate] = []
        for structure, x in starts(self, group):
            known = carried(self.short, self.current.network, self.begin, structure)
            try:
                if structure.hypotheses[-1].kind.periodic:  # which of its rests holds is to be seen first
                    seen = {i: guess(self.short, structure.at(x), i) for i in self.short.estimation}
                    known = min(
                        (known, seen),
                        key=lambda s: self.heat.cost(
                            structure, x, s, self.current.offset, self.short.estimation
                        ),
                    )
                f = self.heat.fit(structure, x, known, self.current.offset, iterations=3)
            except BROKEN:
                continue
            tries.append(self._candidate(self.short, f))
        if not tries:
            return None
        f = min(tries, key=lambda c: c.likelihood).fit
        try:
            f = self.heat.fit(f.structure, f.x, f.initial, f.offset, iterations=4)
        except BROKEN:
            return None
        return self._candidate(self.short, f)

    def _candidate(self, problem: Problem, fit: Fit) -> Candidate:
        return Candidate(fit, likelihood(problem, fit, finer(self.hot, self.floors)))

    def lengthen(self, r: Candidate) -> Candidate | None:
        """From the stretch to the whole of the records, with the heat's coarse weights."""
        try:
            W = whitener(residuals(self.short, r.fit), reckoned(self.short, r.fit, self.floors))
            known = carried(self.problem, self.current.network, self.current.initial, r.fit.structure)
            known |= {i: r.fit.initial[i] for i, w in self.windows.items() if w.first == 0}
            fitter = Fitter(self.problem, W)
            f = fitter.fit(r.fit.structure, r.fit.x, known, r.fit.offset, iterations=5)
            there = begun(self.problem, f.structure, r.fit.x, fitter) if self.slight else None
            if there is not None:
                again = fitter.fit(f.structure, there, iterations=5)
                f = again if again.cost + again.prior < f.cost + f.prior else f
        except BROKEN:
            return None
        return self._candidate(self.problem, f)

    def polish(self, r: Candidate, cold: Array) -> Candidate | None:
        """Fitted until its own noise does not change any more; what repeats over travel also at neighbouring periods."""
        p = self.problem
        try:
            r = settled(p, r.fit.structure, r.fit.x, self.floors, r.fit, iterations=4, least=cold)
            for _ in range(3 if r.hypotheses[-1].kind.periodic else 0):
                W = whitener(residuals(p, r.fit), cold)
                f = comb(p, Fitter(p, W), r.fit, r.fit.structure.names[-1])
                again = settled(p, f.structure, f.x, self.floors, f, rounds=2, iterations=4, least=cold)
                if again.likelihood > r.likelihood - 5:
                    break
                r = again
        except BROKEN:
            return None
        return r

    def elsewhere(self, r: Candidate, factor: float, cold: Array) -> Candidate:
        """The fit begun again with another shape, where that is better: from one start it may end in a place of its own."""
        return begun_again(self.problem, r, shape_of(r), factor, self.floors, cold) or r

    @cached_property
    def rough(self) -> Race:
        """The same race with no more samples than the motion needs."""
        p, few = self.problem, self.problem.rough
        if few is p or thinning_loses(p, self.current, self.floors):
            return self
        share = sum(len(few.records[i]) for i in few.estimation) / sum(
            len(p.records[i]) for i in p.estimation
        )
        settings = replace(self.settings, least_window=math.ceil(share * self.settings.least_window))
        return replace(
            self, problem=few, current=transferred(few, self.current, self.floors), settings=settings
        )

    def heats(self) -> list[Candidate]:
        """The foremost of all hypotheses, fitted to all of the records."""
        groups, _ = self.shortlist(), (self.heat, self.begin)
        with ThreadPoolExecutor(THREADS) as pool:
            came = _came_in(pool.map(self.try_out, groups))
            ranked = came[: self.settings.finals]
            # a likelihood under coloured noise may miss who closes most of the gap
            closest = min(came, key=lambda r: gap(self.short, r.fit), default=None)
            ranked += [closest] if closest is not None and closest not in ranked else []
            return _came_in(pool.map(self.lengthen, ranked))

    def run(self) -> Finish:
        ranked = self.rough.heats()
        if self.rough is not self:
            ranked = _came_in(map(self.transferred, ranked))
        if not ranked:
            return Finish((), self.hot)
        # what the best of them leaves is what is trusted now
        cold = np.min([reckoned(self.problem, r.fit, self.floors) for r in ranked], axis=0)
        with ThreadPoolExecutor(THREADS) as pool:
            ranked = _came_in(pool.map(lambda r: self.polish(r, cold), ranked))
            again = [(r, k) for r in ranked[:2] if shape_of(r) is not None for k in (0.5, 2.0)]
            for r, other in zip(
                [r for r, _ in again],
                pool.map(lambda t: self.elsewhere(t[0], t[1], cold), again),
                strict=True,
            ):
                ranked = [other if q is r and other.likelihood < q.likelihood else q for q in ranked]
        return Finish(tuple(self.order(ranked)), cold)

    def transferred(self, r: Candidate) -> Candidate | None:
        try:
            return self._candidate(self.problem, transferred(self.problem, r.fit, self.floors))
        except BROKEN:
            return None

    def order(self, ranked: Sequence[Candidate]) -> list[Candidate]:
        """By likelihood; one that closes half of the gap, where the likeliest does not, goes first."""
        ranked = sorted(ranked, key=lambda r: r.likelihood)
        widths = [gap(self.problem, r.fit) for r in ranked]
        if ranked and min(widths) < 0.5 * gap(self.problem, self.current) < widths[0]:
            closest = ranked[int(np.argmin(widths))]
            ranked = [closest, *(r for r in ranked if r is not closest)]
        return simplest_first(ranked, self.settings.chance, self.settings.sure)


def _came_in(found: Iterable[Candidate | None]) -> list[Candidate]:
    """Those that did not break down, best first, each set of effects once."""
    best: dict[object, Candidate] = {}
    for r in found:
        if r is not None and math.isfinite(r.likelihood):
            old = best.get(r.hypotheses)
            best[r.hypotheses] = r if old is None or r.likelihood < old.likelihood else old
    return sorted(best.values(), key=lambda r: r.likelihood)


# ------------------------------------------------------------------------------------------ where fits begin


def starts(race: Race, group: list[Screened]) -> list[tuple[Structure, Array]]:
    """Where joint fits begin: the screened starts at several amplitudes, base at its prior, simulated and compared.

    The score test looks at small effects; a large one is found by trying.
    """
    current, kind = race.current, group[0].hypothesis.kind
    if kind.periodic:  # a step too far leads to another period: from the base as fitted
        known = dict(zip((f.path for f in current.structure.free), current.x, strict=True))
        near = [t for s in group[:3] for t in amplified(race, s, (1.0,))]
        return [
            (t, np.array([known.get(f.path, v) for f, v in zip(t.free, t.start, strict=True)])) for t in near
        ]
    tries = []
    for s in group[:6]:
        more = LARGE * (s.start.inverse or race.lost) + OTHER * s.start.signed
        tries += amplified(race, s, AMPLITUDES + more)
    if not tries:
        return []
    scores = _misfit(race, tries)
    if scores is None:
        return [(tries[0], tries[0].start)]
    order = np.argsort(scores)
    picked = [tries[0]] if order[0] == 0 else [tries[order[0]], tries[0]]
    if kind.shaped_by and len(order) > 2:
        other = next((tries[k] for k in order[1:] if tries[k] not in picked), None)
        picked += [other] if other is not None else []
    return [(t, t.start) for t in picked]


def amplified(race: Race, s: Screened, factors: Sequence[float]) -> list[Structure]:
    """A screened start at multiples of its amplitude, where it has one."""
    out = []
    for factor in factors if s.start.grows else (1.0,):
        values = dict(s.values)
        for key in s.start.grows:
            values[key] *= 1 / factor if s.start.inverse else factor
        try:
            out.append(add(advanced(race.current), s.hypothesis, values))
        except InputError:
            continue
    return out


def _misfit(race: Race, tries: Sequence[Structure]) -> Array | None:
    """Sum over channels of the logarithm of the residual's variance, as they stand: one that drifts does not drown others."""
    problem, current = race.short, race.current
    if not tries:
        return None
    scores, nets = np.zeros(len(tries)), [t.network for t in tries]
    begun = [carried(problem, current.network, race.begin, t) for t in tries]
    at = {i: np.stack([b[i] for b in begun], axis=1) for i in problem.estimation}
    try:
        seen = problem.simulate_all(nets, problem.estimation, at, like=nets[0])
    except BROKEN:
        return None
    for i, y in seen.items():
        with np.errstate(over="ignore", invalid="ignore"):
            v = np.var(problem.records[i].measured[:, :, None] - y, axis=0) + race.floors[:, None] ** 2
        whole = np.isfinite(v).all(axis=0)
        scores += np.where(whole, np.sum(np.log(np.where(np.isfinite(v), v, 1.0)), axis=0), math.inf)
    return scores


# -------------------------------------------------------------------------------------------- free decays


def compete(problem: Problem, current: Fit, floors: Array, settings: SearchSettings) -> Finish:
    """One stage of forward addition. A free decay whose frequency the model misses is compared on its beginning, which
    then grows: later on the phase is anything."""
    if problem.network.inputs or gap(problem, current) < settings.lost:
        return Race(problem, current, floors, settings).run()
    return _growing(problem, current, floors, settings)


def _growing(problem: Problem, current: Fit, floors: Array, settings: SearchSettings) -> Finish:
    share, part, fit = 1.0, problem, current
    while gap(part, fit) >= settings.lost and share * max(map(len, problem.records)) > settings.shortest:
        share /= 2
        part = beginning(problem, share, settings.shortest)
        # from the state as measured: the one that fits a wrong frequency best is nobody's
        fit = Fitter(part, plain(floors)).fit(current.structure, current.x, iterations=0)
    ranked = list(Race(part, fit, floors, replace(settings, heats=100, finals=8), lost=True).run().ranked)

    def each(change: Callable[[Candidate], Candidate]) -> None:
        for r in list(ranked):
            try:
                ranked[ranked.index(r)] = change(r)
            except BROKEN:
                ranked.remove(r)

    while share < 1.0:
        share = min(1.4 * share, 1.0)
        part = beginning(problem, share, settings.shortest) if share < 1.0 else problem
        fitter = Fitter(part, plain(floors))
        each(functools.partial(_refit, fitter))
    white = np.min([reckoned(problem, r.fit, floors) for r in ranked], axis=0) if ranked else floors
    each(lambda r: settled(problem, r.fit.structure, r.fit.x, floors, r.fit, least=white))
    ranked.sort(key=lambda r: r.likelihood)
    return Finish(tuple(simplest_first(ranked, settings.chance, settings.sure)), white)


def _refit(fitter: Fitter, r: Candidate) -> Candidate:
    return with_fit(r, fitter.fit(r.fit.structure, r.fit.x, r.fit.initial, r.fit.offset), math.nan)


def beginning(problem: Problem, share: float, least: int) -> Problem:
    """The first `share` of every record, and at least `least` samples where it has them."""
    return problem.with_records(
        [r.part(0, max(int(share * len(r)), min(len(r), least)), r.name) for r in problem.records]
    )
