"""What held-out records say of a candidate: its error on them, what of it is noise, and how large its effects are."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from ..arrays import rms
from ..errors import InputError
from ..simulate import effective_current
from .candidate import BROKEN, Candidate, reckoned
from .comparison import Comparison, block_edges, compare, log_density
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
LEAST_BLOCK = 10  # samples
LEAST_NOISE = 0.01  # share of the signal: no model is better
#: share of the typical force that each small effect, unmodelled, may have (one sigma)
SMALL = 0.005


@dataclass(frozen=True, eq=False)
class Outcome:
    """A candidate on the held-out records. `score`: mean whitened square of what it leaves of those to choose by.

    `lpd` (blocks,): log predictive density of validation records [nats], without constants; `training_lpd` (blocks,): the same of
    training records, less one nat per parameter (Akaike 1974), spread over the blocks; `squares` (blocks, 2): sum of
    whitened squares and their number; `nrmse` (channels,) on those to choose by, `reported` on those to report by;
    `fitted`: on those it was fitted to, which may show what the others, driven harder or more softly, hardly do;
    `tested`: mean whitened square on the test records, which take no part in a choice.
    """

    candidate: Candidate
    score: float
    lpd: Array
    training_lpd: Array
    squares: Array
    nrmse: Array
    reported: Array
    fitted: Array
    tested: float
    held: Fit

    @property
    def blocks_lpd(self) -> Array:
        """Log predictive density of the blocks of validation and training records (blocks,) [nats]."""
        return np.concatenate([self.lpd, self.training_lpd])

    def versus(self, other: Outcome) -> Comparison:
        """Compare with another candidate behind the same filters, on the blocks of validation and training records."""
        return compare(self.blocks_lpd, other.blocks_lpd)

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
        self._along: dict[
            tuple[int, ...], tuple[Candidate, Outcome]
        ] = {}  # the candidate keeps its id in use
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

    def outcome(self, candidate: Candidate, W: Whitener, like: Sequence[Outcome] = ()) -> Outcome:
        """Score a candidate on the held-out records: parameters as fitted, initial states and offsets from each record's own samples.

        Args:
            candidate: fitted set of effects.
            W: filters that whiten the residuals.
            like: scores of other candidates, whose initial states are starting points beside the candidate's own guesses.

        Returns:
            The score, a function of the arguments alone.

        Raises:
            InputError, LinAlgError: the simulation breaks down.
        """
        p, fit = self.problem, candidate.fit
        begun = self.nearest_starts(like, fit.structure)
        f = Fitter(p, W).follow(fit.structure, fit.x, p.held, None, (self.after_fitted(fit), begun))
        held = self.plain.follow(fit.structure, fit.x, p.held, f.initial, (begun,))
        f = self.lower(f, held, W)
        tested = np.concatenate([W(p.records[i].measured - f.outputs[i]) ** 2 for i in p.reporting])
        squares, lpd = self._blocks(p.choosing, f, W)
        _, training = self._blocks(p.estimation, fit, W)
        return Outcome(
            candidate,
            float(squares[:, 0].sum() / squares[:, 1].sum()),
            lpd,
            training - len(fit.x) / len(training),
            squares,
            self.error(held, p.choosing, self.spread),
            self.error(held, p.reporting, self.spread_reported),
            self.error(fit, p.estimation, self.spread_fitted),
            float(tested.mean()),
            held,
        )

    def _blocks(self, records: Sequence[int], fit: Fit, W: Whitener) -> tuple[Array, Array]:
        """Return the whitened residuals of records in blocks: sum and number of squares (blocks, 2), log density (blocks,) [nats]."""
        squares, lpd = [], []
        for i in records:
            y = self.problem.records[i].measured
            e = W(y - fit.outputs[i]) ** 2
            edges = block_edges(y, BLOCKS, LEAST_BLOCK)
            for a, b in pairwise(edges):
                squares.append((float(e[a:b].sum()), e[a:b].size))
                lpd.append(log_density(e[a:b], len(e) / (len(edges) - 1)))
        return np.array(squares), np.array(lpd)

    def along(self, path: Sequence[Candidate]) -> tuple[Outcome, ...]:
        """Return the scores of a path of candidates, each behind its own filters and with the initial states of those before it.

        Args:
            path: candidates, each with one more effect than the candidate before it.
        """
        out: tuple[Outcome, ...] = ()
        for k, candidate in enumerate(path):
            key = tuple(id(c) for c in path[: k + 1])
            if key not in self._along:
                self._along[key] = candidate, self.outcome(candidate, self.weights(candidate), out)
            out = (*out, self._along[key][1])
        return out

    def own(self, candidate: Candidate) -> Outcome:
        """Return the score of a candidate behind the filters of its own residual."""
        return self.along((candidate,))[0]

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

    def nearest_starts(self, like: Sequence[Outcome], structure: Structure) -> dict[int, Array]:
        """Return, for each held-out record, the initial state of the score that errs least there, in the coordinates of `structure`."""
        nearest: dict[int, tuple[float, Fit]] = {}
        for held in (o.held for o in like):
            for i, y in held.outputs.items():
                error = float(np.sum(((self.problem.records[i].measured - y) / self.floors) ** 2))
                if i not in nearest or error < nearest[i][0]:
                    nearest[i] = error, held
        out: dict[int, Array] = {}
        for fit in {id(f): f for _, f in nearest.values()}.values():
            own = {i: fit.initial[i] for i, (_, f) in nearest.items() if f is fit}
            out |= carried(self.problem, fit.network, own, structure)
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

        It is never read off a misfit alone: what the measured signal has above its band bounds it. Test records take no part.
        """
        p, out = self.problem, []
        first = p.records[p.choosing[0]]
        for j, known in enumerate(self.known):
            series = [p.records[i].measured[:, j] - outcome.held.outputs[i][:, j] for i in p.choosing]
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


__all__ = ["BROKEN", "Judge", "Outcome", "moved", "share_at_place"]
