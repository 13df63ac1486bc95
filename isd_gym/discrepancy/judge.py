"""What held-out records say of a candidate: its error on them, what of it is noise, and how large its effects are."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from ..arrays import rms
from ..errors import InputError
from ..simulate import effective_current
from .candidate import BROKEN, Candidate, reckoned
from .fit import Fit, Fitter, residuals
from .forces import element_forces, place_forces
from .initial import carried, next_states
from .noise import Floor, Noise, Whitener, floors_of, noise_of, passed, plain, whitener
from .structure import Structure, base_structure
from .unmodelled import unmodelled

if TYPE_CHECKING:
    from collections.abc import Sequence

    from .. import elements as el
    from ..network import Network
    from .problem import Array, Problem

BLOCKS = 20  # in which a held-out stretch is weighed
LEAST_NOISE = 0.01  # share of the signal: no model is better
#: share of the typical force that each small effect, unmodelled, may have (one sigma)
SMALL = 0.005


@dataclass(frozen=True, eq=False)
class Outcome:
    """A candidate on the held-out records. `score`: mean whitened square of what it leaves of those to choose by.

    `blocks` (blocks in time, channels) of it; `nrmse` (channels,) on those to choose by, `reported` on those to report by;
    `fitted`: on those it was fitted to, which may show what the others, driven harder or more softly, hardly do;
    `start`: initial states that the records were followed from.
    """

    candidate: Candidate
    score: float
    blocks: Array
    nrmse: Array
    reported: Array
    fitted: Array
    start: dict[int, Array]
    held: Fit

    def excess(self, floor: Array) -> Array:
        """Error beyond noise (channels,), as a share of a channel's deviation."""
        return np.asarray(np.sqrt(np.maximum(self.nrmse**2 - floor**2, 0.0)), dtype=np.float64)


class Judge:
    """The held-out records of a problem, and everything that is measured on them."""

    def __init__(self, problem: Problem):
        self.problem = problem
        self.known: list[Floor] = floors_of(problem)
        deviation = problem.deviation()
        self.floors = np.maximum([f.deviation for f in self.known], LEAST_NOISE * deviation)
        self.spread = problem.deviation(problem.choosing)
        self.spread_reported = problem.deviation(problem.reporting)
        self.spread_fitted = deviation
        self._worth: dict[int, tuple[Candidate, Array]] = {}
        self._fitted: dict[int, tuple[Candidate, Array]] = {}
        self._own: dict[int, tuple[Candidate, Outcome]] = {}
        self._begun: dict[int, tuple[float, Fit]] = {}  # held-out record -> least plain error, and whose
        self._responses: tuple[Candidate, dict[int, Array]] | None = None  # they are large: the last alone

    @cached_property
    def plain(self) -> Fitter:
        return Fitter(self.problem, plain(self.floors))

    @cached_property
    def rough(self) -> Fitter:
        """With no more samples than the motion needs."""
        return Fitter(self.problem.rough, plain(self.floors))

    def weights(self, candidate: Candidate) -> Whitener:
        """Filters from what a candidate leaves of the records it was fitted to."""
        p = self.problem
        return whitener(residuals(p, candidate.fit), reckoned(p, candidate.fit, self.floors))

    # -- errors -------------------------------------------------------------------------------------------
    def error(self, fit: Fit, records: Sequence[int], spread: Array) -> Array:
        r = np.concatenate([self.problem.records[i].measured - fit.outputs[i] for i in records])
        return np.asarray(np.sqrt(np.mean(r**2, axis=0)) / spread, dtype=np.float64)

    def fitted(self, candidate: Candidate) -> Array:
        """NRMSE on the records that it was fitted to, as it is on others: initial states and offsets from the plain error.

        A fit under coloured noise may leave slow errors there that nobody weighed.
        """
        if id(candidate) not in self._fitted:
            p, fit = self.problem, candidate.fit
            f = self.plain.follow(fit.structure, fit.x, p.estimation, fit.initial)
            self._fitted[id(candidate)] = candidate, self.error(f, p.estimation, self.spread_fitted)
        return self._fitted[id(candidate)][1]

    def owner(self) -> tuple[Array, Array]:
        """NRMSE of the owner's model as it is, on the records to choose by and to report by."""
        p, structure = self.problem, base_structure(self.problem.network)
        f = self.plain.follow(structure, structure.start, p.held)
        return self.error(f, p.choosing, self.spread), self.error(f, p.reporting, self.spread_reported)

    def outcome(self, candidate: Candidate, W: Whitener, before: Outcome | None = None) -> Outcome:
        """Parameters as found; initial states and offsets from each record's own samples.

        `before`: an earlier outcome of the same candidate. Raises where it breaks down.
        """
        p, fit = self.problem, candidate.fit
        begun = self.begun(fit.structure)
        start, about = (before.start, ()) if before else (None, (self.after_fitted(fit), begun))
        f = Fitter(p, W).follow(fit.structure, fit.x, p.held, start, about)
        held = self.plain.follow(fit.structure, fit.x, p.held, f.initial, (begun,))
        f = self.lower(f, held, W)
        self.remember(held)
        blocks = []
        for i in p.choosing:
            e = W(p.records[i].measured - f.outputs[i]) ** 2
            edges = np.linspace(0, len(e), BLOCKS + 1).astype(int)
            blocks += [e[a:b].mean(axis=0) for a, b in pairwise(edges) if b > a]
        rows = np.array(blocks)
        return Outcome(
            candidate,
            float(rows.mean()),
            rows,
            self.error(held, p.choosing, self.spread),
            self.error(held, p.reporting, self.spread_reported),
            self.error(fit, p.estimation, self.spread_fitted),
            f.initial,
            held,
        )

    def own(self, candidate: Candidate) -> Outcome:
        """The outcome behind the filters of its own residual, once."""
        if id(candidate) not in self._own:
            self._own[id(candidate)] = candidate, self.outcome(candidate, self.weights(candidate))
        return self._own[id(candidate)][1]

    def lower(self, f: Fit, plainly: Fit, W: Whitener) -> Fit:
        """The same, begun again where `plainly` errs less behind the filters, too: where friction holds there are many ways to begin."""

        def cost(found: Fit, i: int) -> float:
            return float(np.sum(W(self.problem.records[i].measured - found.outputs[i]) ** 2))

        astray = {i: plainly.initial[i] for i in f.outputs if cost(plainly, i) < (1.0 - 1e-3) * cost(f, i)}
        if not astray:
            return f
        g = Fitter(self.problem, W).follow(f.structure, f.x, list(astray), astray)
        return replace(
            f, initial=f.initial | g.initial, offset=f.offset | g.offset, outputs=f.outputs | g.outputs
        )

    def remember(self, held: Fit) -> None:
        """Where held-out records begin is a matter of the records: who came nearest to one says it to all who follow."""
        for i, y in held.outputs.items():
            error = float(np.sum(((self.problem.records[i].measured - y) / self.floors) ** 2))
            if i not in self._begun or error < self._begun[i][0]:
                self._begun[i] = error, held

    def begun(self, structure: Structure) -> dict[int, Array]:
        """That, for each held-out record, in the coordinates of `structure`."""
        whose = {id(fit): fit for _, fit in self._begun.values()}
        out: dict[int, Array] = {}
        for key, fit in whose.items():
            its = {i: fit.initial[i] for i, (_, f) in self._begun.items() if id(f) == key}
            out |= carried(self.problem, fit.network, its, structure)
        return out

    def after_fitted(self, fit: Fit) -> dict[int, Array]:
        """Where the simulation of fitted records ended: initial states of held-out ones that go on from there."""
        p = self.problem
        goes_on = {j: i for j in p.held for i in p.estimation if p.records[j].follows(p.records[i])}
        if not goes_on or not len(next(iter(fit.initial.values()))):
            return {}
        ends = next_states(p, fit.structure, fit.x, {i: fit.initial[i] for i in goes_on.values()})
        return {j: ends[i] for j, i in goes_on.items()}

    def responses(self, candidate: Candidate) -> dict[int, Array]:
        """What small effects, `SMALL` of the typical force each, do to the records fitted to: record -> (n, channels, laws)."""
        if self._responses is None or self._responses[0] is not candidate:
            self._responses = candidate, unmodelled(self.problem, candidate.fit, SMALL)
        return self._responses[1]

    # -- noise --------------------------------------------------------------------------------------------
    def noise(self, outcome: Outcome) -> list[Noise]:
        """Every channel's noise: as its owner or its own spectrum tells, and no more than is left above the motion.

        It is never read off a misfit alone: what the measured signal has above its band bounds it.
        """
        p, out = self.problem, []
        first = p.records[p.held[0]]
        for j, known in enumerate(self.known):
            series = [p.records[i].measured[:, j] - y[:, j] for i, y in outcome.held.outputs.items()]
            left = noise_of(series, first.rate, time=p.time, white=first.filtered)
            share = 1.0
            if known.source == "owner" or left.deviation > known.deviation:
                share = (known.deviation / max(left.deviation, 1e-300)) ** 2
            out.append(Noise(left.white * share, left.drive * share, left.phi))
        return out

    def floor(self, outcome: Outcome) -> Array:
        """That noise as a share of each channel's deviation, and no more than the error itself."""
        deviation = np.array([n.deviation for n in self.noise(outcome)]) / self.spread
        return np.asarray(np.minimum(deviation, outcome.nrmse), dtype=np.float64)

    def quiet(self, outcome: Outcome, W: Whitener) -> float:
        """The score of pure noise."""
        return min(float(passed(W, self.noise(outcome)).mean()), 0.999 * outcome.score)

    # -- sizes --------------------------------------------------------------------------------------------
    def worth(self, candidate: Candidate, small: float, least: float) -> Array:
        """Excess (channels,), as a share of a channel's deviation, that no small effect beside a candidate makes once it is refitted.

        `small`: its share of the typical force. Where a coordinate drifts, or has many rests, a small force may show up large.
        """
        if id(candidate) not in self._worth:
            p = self.problem
            change = {i: y * (small / SMALL) for i, y in self.responses(candidate).items()}
            worth = np.full(len(p.channels), least)
            if next(iter(change.values())).shape[2]:
                _, left = self.plain.refit(candidate.fit, change)
                r = np.concatenate([*left.values()]) * self.floors[:, None]
                shares = np.sqrt(np.mean(r**2, axis=0)) / p.deviation()[:, None]
                worth = np.maximum(least, np.quantile(shares, 0.95, axis=1))
            self._worth[id(candidate)] = candidate, worth
        return self._worth[id(candidate)][1]

    def sizes(self, candidate: Candidate) -> list[float]:
        """What each of its effects does, as a share of the force, current or signal at its place."""
        return [share_at_place(self.problem, candidate.fit, name) for name in candidate.fit.structure.names]


def share_at_place(problem: Problem, fit: Fit, name: str) -> float:
    """RMS of what an effect does over RMS of what is there: force between its terminals, current, or signal."""
    net = fit.network
    e = net.element(name)
    if e.place == "channel":
        return _share_of_signal(problem, fit, e)
    if e.place == "element":
        return _share_of_current(problem, net, e)
    if e.series:
        return 1.0  # force and deflection are shared in series: what it changes in the outputs decides
    try:
        forces = element_forces(problem, fit, e.where)
    except InputError:
        return 1.0
    own = forces[name] * e.own_share([net.element(x) for x in forces])
    return rms(own) / max(rms(np.sum([*forces.values()], axis=0)), _force_around(problem, fit, e), 1e-300)


def _force_around(problem: Problem, fit: Fit, e: el.Element) -> float:
    """Typical force [N] of the other elements at the nodes of an element that is alone at its place; 0 where it is not alone."""
    alone = sum(1 for x in fit.network.elements if x.place == "between" and set(x.where) == set(e.where)) == 1
    return place_forces(problem, fit, without=e.name).at(e.where) if alone else 0.0


def _share_of_signal(problem: Problem, fit: Fit, e: el.Element) -> float:
    i, j = problem.estimation[0], problem.channels.index(e.where[0])
    without = problem.simulate(
        [fit.network.without_element(e.name)], i, fit.initial[i][:, None], like=fit.network
    )[:, j, 0]
    change = fit.outputs[i][:, j] - fit.offset[i][j] - without
    return rms(change) / max(float(np.std(problem.records[i].measured[:, j])), 1e-300)


def _share_of_current(problem: Problem, net: Network, e: el.Element) -> float:
    record = problem.records[problem.estimation[0]]
    command = next(c.name for c in net.inputs if c.quantity == "current" and c.element == e.where[0])
    current = record.inputs[command][:, None]
    others = effective_current(net.without_element(e.name), e.where[0], current, record.step)
    changed = effective_current(net, e.where[0], current, record.step)
    return rms(changed - others) / max(rms(others), 1e-300)


def moved(last: Outcome, now: Outcome) -> float:
    """Largest share of a channel's deviation by which `now` comes nearer to the records, held out or fitted to."""
    pairs = ((last.nrmse, now.nrmse), (last.fitted, now.fitted))
    return max(float(np.sqrt(np.maximum(a**2 - b**2, 0.0)).max()) for a, b in pairs)


def block_lead(rival: Outcome, best: Outcome) -> float:
    """By how many of its own standard errors, over blocks, the rival's score is behind."""
    d = (rival.blocks - best.blocks).mean(axis=1)
    if len(d) < 2:
        return 0.0
    return float(d.mean() / max(d.std(ddof=1) / math.sqrt(len(d)), 1e-12))


def replication(rival: Outcome, best: Outcome) -> float:
    """By how many standard errors, over blocks, the rival's error is the larger one, by the logarithm of its ratio.

    In a decay nearly all of the error's power lies in the first few blocks; that it is there again in the others counts.
    """
    ratio = np.log(
        np.maximum(rival.blocks.mean(axis=1), 1e-300) / np.maximum(best.blocks.mean(axis=1), 1e-300)
    )
    if len(ratio) < 2:
        return 0.0
    return float(ratio.mean() / max(ratio.std(ddof=1) / math.sqrt(len(ratio)), 1e-12))


__all__ = ["BROKEN", "Judge", "Outcome", "block_lead", "moved", "replication", "share_at_place"]
