"""Scores of candidates on held-out records: errors, noise, log predictive density, and the size of effects.

The difference of two expected log predictive densities and its standard error are those of `arviz_stats.compare` (``elpd_diff`` and
``dse``), with blocks of consecutive samples in place of single observations, since neighbouring residuals are correlated.

References:
    Vehtari, Gelman, Gabry: Practical Bayesian model evaluation using leave-one-out cross-validation and WAIC, Statistics and
    Computing 27 (2017), section 5.2. Sivula, Magnusson, Matamoros, Vehtari: Uncertainty in Bayesian leave-one-out
    cross-validation based model comparison, arXiv:2008.10296 (2020): differences below 4 are too small to rely on their error.
    Breiman, Friedman, Olshen, Stone: Classification and Regression Trees (1984), section 3.4.3: the rule of one standard error.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from ..._common.arrays import rms
from ..._common.errors import InputError
from ...physics.simulate import effective_current
from .._estimation.gauss_newton import Fit, Fitter
from .._estimation.initial_states import next_states, transfer_states
from .._estimation.multiple_shooting import is_lightly_damped
from .._estimation.noise import (
    Floor,
    Weights,
    floors_of,
    noise_of,
    white_weights,
)
from .._estimation.structure import Structure, base_structure
from .._hypotheses.forces import element_forces, place_forces, work_share
from .._hypotheses.law_matching import simulate_unmodelled_effects
from .._simulation.problem import BROKEN
from .candidate import Candidate, share_of, weights_for
from .criteria import LEAST_NOISE

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from ..._common.arrays import Array
    from ...physics import elements as el
    from ...physics.network import Network
    from .._simulation.problem import Problem
    from .criteria import Criteria


#: blocks per record
BLOCKS = 20
#: least number of samples in a block
LEAST_BLOCK = 10
#: force of each unmodelled effect (one sigma), as a share of the typical force
SMALL = 0.005


@dataclass(frozen=True, eq=False)
class HeldOutScore:
    """Score of a candidate on validation, training and test records."""

    candidate: Candidate
    #: mean weighted square of the residuals on the validation records
    mean_square: float
    #: log predictive density of the blocks of the validation records (blocks,) [nats], without constants
    validation_lpd: Array
    #: the same of the training records, less one nat per parameter (Akaike 1974), spread over the blocks
    training_lpd: Array
    #: RMS error on the validation records over their deviation (channels,)
    nrmse: Array
    #: the same on the test records
    test_nrmse: Array
    #: the same on the training records, with the initial states of the fit
    training_nrmse: Array
    #: mean weighted square on the test records
    test_mean_square: float
    #: simulation of the held-out records
    fit: Fit

    @property
    def lpd(self) -> Array:
        """Log predictive density of the blocks of validation and training records (blocks,) [nats]."""
        return np.concatenate([self.validation_lpd, self.training_lpd])

    def compare_with(self, other: HeldOutScore) -> Comparison:
        """Compare with the score of another candidate that was weighted by the same noise."""
        return compare(self.lpd, other.lpd)

    def excess(self, noise: Array) -> Array:
        """Return the error beyond noise (channels,), both as shares of a channel's deviation."""
        return _beyond(self.nrmse, noise)

    def test_excess(self, noise: Array) -> Array:
        """Return the error beyond noise on the test records (channels,), both as shares of a channel's deviation there."""
        return _beyond(self.test_nrmse, noise)

    def explained_on_test(self, before: HeldOutScore, noise: Array, noise_score: float) -> float:
        """Return the share of the excess error of another score that this score removes on the test records, with a floor of a hundredth
        of the noise: of the weighted error, or of the plain error if that falls by more. `noise`: share of the deviation (channels,)."""
        weighted = before.test_mean_square - self.test_mean_square
        weighted /= max(before.test_mean_square - noise_score, 0.01 * noise_score)
        power = noise**2
        weights = 1.0 / np.maximum(power, 1e-24)
        top = float(np.sum((before.test_nrmse**2 - self.test_nrmse**2) * weights))
        excess = float(np.sum(np.maximum(before.test_nrmse**2 - power, 0.0) * weights))
        return max(weighted, top / max(excess, 0.01))


class HeldOutEvaluator:
    """Scores candidates on the held-out records of a problem; every candidate must simulate the user's `whole` records, if any."""

    def __init__(self, problem: Problem, whole: Problem | None = None):
        self.problem = problem
        self.whole = whole
        #: noise of each channel, as the owner or the signal tells
        self.noise_estimates: list[Floor] = floors_of(problem)
        deviation = problem.deviation()
        #: smallest noise that residuals are weighted with (channels,) [unit of the channel]
        self.least_noise = np.maximum([f.deviation for f in self.noise_estimates], LEAST_NOISE * deviation)
        self.validation_deviation = problem.deviation(problem.choosing)
        self.test_deviation = problem.deviation(problem.reporting)
        self.training_deviation = deviation
        self._envelopes: dict[Candidate, Array] = {}
        self._paths: dict[tuple[Candidate, ...], HeldOutScore] = {}
        self._responses: tuple[Candidate, dict[int, Array]] | None = None  # they are large: only the last

    @cached_property
    def plain_fitter(self) -> Fitter:
        """Fitter with white noise."""
        return Fitter(self.problem, white_weights(self.least_noise))

    def weights(self, candidate: Candidate) -> Weights:
        """Return weights by the training residuals of a candidate."""
        p = self.problem
        weights = weights_for(p, candidate.fit, self.least_noise)
        return replace(weights, share=share_of(p, candidate.fit))

    # -- errors -------------------------------------------------------------------------------------------
    def nrmse(self, fit: Fit, records: Sequence[int], deviation: Array) -> Array:
        """Return the RMS error over the deviation (channels,)."""
        r = np.concatenate([self.problem.records[i].measured - fit.outputs[i] for i in records])
        return np.asarray(np.sqrt(np.mean(r**2, axis=0)) / deviation, dtype=np.float64)

    def training_nrmse(self, candidate: Candidate) -> Array:
        """Return the NRMSE on the training records (channels,)."""
        return self.nrmse(candidate.fit, self.problem.estimation, self.training_deviation)

    @cached_property
    def nominal_nrmse(self) -> tuple[Array, Array]:
        """The NRMSE of the nominal model on the validation and on the test records, (channels,) each; NaN where it breaks down."""
        p, structure = self.problem, base_structure(self.problem.network)
        try:
            f = self.plain_fitter.follow(structure, structure.start, p.held)
        except BROKEN:
            unknown = np.full(len(p.channels), np.nan)
            return unknown, unknown
        return (
            self.nrmse(f, p.choosing, self.validation_deviation),
            self.nrmse(f, p.reporting, self.test_deviation),
        )

    def score(
        self, candidate: Candidate, weights: Weights, similar: Sequence[HeldOutScore] = ()
    ) -> HeldOutScore:
        """Score a candidate: parameters as fitted, initial states and offsets from each held-out record, started from guesses and from
        those of similar scores."""
        p, fit = self.problem, candidate.fit
        nearest = self._nearest_states(similar, fit.structure)
        f = Fitter(p, white_weights(weights.level)).follow(
            fit.structure, fit.x, p.held, None, (self._states_after_training(fit), nearest)
        )
        self._check_whole_records(fit, f)
        test = np.concatenate([weights(p.records[i].measured - f.outputs[i]) ** 2 for i in p.reporting])
        squares, validation = self._score_blocks(p.choosing, f, weights)
        _, training = self._score_blocks(p.estimation, fit, weights)
        return HeldOutScore(
            candidate=candidate,
            mean_square=float(squares[:, 0].sum() / squares[:, 1].sum()),
            validation_lpd=validation,
            training_lpd=training - len(fit.x) / len(training),
            nrmse=self.nrmse(f, p.choosing, self.validation_deviation),
            test_nrmse=self.nrmse(f, p.reporting, self.test_deviation),
            training_nrmse=self.training_nrmse(candidate),
            test_mean_square=float(test.mean()),
            fit=f,
        )

    # -- whole records ------------------------------------------------------------------------------------
    @cached_property
    def _simulated_by_nominal(self) -> list[int]:
        """Whole records that the nominal model simulates."""
        if self.whole is None:
            return []
        structure = base_structure(self.problem.network)
        broken = self._broken_records(structure, structure.start, range(len(self.whole.records)), {})
        return [i for i in range(len(self.whole.records)) if i not in broken]

    def first_states(self, *fits: Fit) -> dict[int, Array]:
        """Return the initial states of whole records, from fits of the records that begin with them."""
        out: dict[int, Array] = {}
        pieces = [(self.problem.records[j], f.initial[j]) for f in fits for j in f.initial]
        for i, record in enumerate(self.whole.records if self.whole else []):
            for piece, state in pieces:
                if piece.name == record.name and abs(piece.start - record.start) < 0.5 * record.interval:
                    out[i] = state
        return out

    def _broken_records(
        self, structure: Structure, x: Array, records: Sequence[int], initial: Mapping[int, Array]
    ) -> list[int]:
        """Return the whole records on which a simulation breaks down."""
        assert self.whole is not None
        fitter = Fitter(self.whole, white_weights(self.least_noise))
        out = []
        for i in records:  # one by one: a record that breaks down must not hide the others
            at = fitter.begin(structure, x, {k: v for k, v in initial.items() if k == i}, None, [i])
            if not np.isfinite(fitter.seen(structure, at, [i]).total):
                out.append(i)
        return out

    def _check_whole_records(self, fit: Fit, held: Fit) -> None:
        """Raise InputError for effects that break down on a whole record of the user."""
        if not fit.structure.hypotheses or self.whole is None:
            return
        # a model that breaks down from the start that the first samples tell owes its success to start values that no sensor sees
        for states in (self.first_states(fit, held), {}):
            broken = self._broken_records(fit.structure, fit.x, self._simulated_by_nominal, states)
            if broken:
                raise InputError(
                    f"the simulation breaks down on the record {self.whole.records[broken[0]].name}"
                )

    def _score_blocks(self, records: Sequence[int], fit: Fit, weights: Weights) -> tuple[Array, Array]:
        """Return sum and number of weighted squares (blocks, 2), and the log density (blocks,) [nats]."""
        squares, lpd = [], []
        floor = np.minimum(weights.mean_square(self.least_noise), 1.0)
        for i in records:
            y = self.problem.records[i].measured
            e = weights(y - fit.outputs[i]) ** 2
            edges = block_edges(y, BLOCKS, LEAST_BLOCK)
            for a, b in pairwise(edges):
                squares.append((float(e[a:b].sum()), e[a:b].size))
                lpd.append(log_density(e[a:b], len(e) / (len(edges) - 1) * weights.share, floor))
        return np.array(squares), np.array(lpd)

    def score_path(self, path: Sequence[Candidate]) -> tuple[HeldOutScore, ...]:
        """Score the candidates of a path, each with its own weights and the initial states of the preceding ones."""
        out: tuple[HeldOutScore, ...] = ()
        for k, candidate in enumerate(path):
            key = tuple(path[: k + 1])
            if key not in self._paths:
                self._paths[key] = self.score(candidate, self.weights(candidate), out)
            out = (*out, self._paths[key])
        return out

    def score_alone(self, candidate: Candidate) -> HeldOutScore:
        """Score a candidate with its own weights."""
        return self.score_path((candidate,))[0]

    def _nearest_states(self, scores: Sequence[HeldOutScore], structure: Structure) -> dict[int, Array]:
        """Return, for each held-out record, the initial state of the score with the least error, for a structure."""
        nearest: dict[int, tuple[float, Fit]] = {}
        for fit in (s.fit for s in scores):
            for i, y in fit.outputs.items():
                error = float(np.sum(((self.problem.records[i].measured - y) / self.least_noise) ** 2))
                if i not in nearest or error < nearest[i][0]:
                    nearest[i] = error, fit
        out: dict[int, Array] = {}
        for fit in {id(f): f for _, f in nearest.values()}.values():
            own = {i: fit.initial[i] for i, (_, f) in nearest.items() if f is fit}
            out |= transfer_states(self.problem, fit.network, own, structure)
        return out

    def _states_after_training(self, fit: Fit) -> dict[int, Array]:
        """Return the initial states of held-out records that continue a training record."""
        p = self.problem
        continues = {j: i for j in p.held for i in p.estimation if p.records[j].follows(p.records[i])}
        if not continues or not len(next(iter(fit.initial.values()))):
            return {}
        ends = next_states(p, fit.structure, fit.x, {i: fit.initial[i] for i in continues.values()})
        return {j: ends[i] for j, i in continues.items()}

    # -- noise --------------------------------------------------------------------------------------------
    def channel_noise(self, score: HeldOutScore) -> Array:
        """Return the deviation of the noise (channels,): as the owner or the spectrum tells, and no more than is left above the motion of the
        validation records."""
        p, out = self.problem, []
        first = p.records[p.choosing[0]]
        for j, known in enumerate(self.noise_estimates):
            series = [p.records[i].measured[:, j] - score.fit.outputs[i][:, j] for i in p.choosing]
            left = noise_of(series, first.interval, time=p.time, white=first.filtered)
            out.append(known.deviation if known.source in ("owner", "input") else min(left, known.deviation))
        return np.array(out)

    def noise_share(self, score: HeldOutScore) -> Array:
        """Return the noise as a share of each channel's deviation (channels,), at most the error itself."""
        deviation = self.channel_noise(score) / self.validation_deviation
        return np.asarray(np.minimum(deviation, score.nrmse), dtype=np.float64)

    def test_noise(self, noise: Array) -> Array:
        """Return the noise as a share of the deviation on the test records, from that on the validation records (channels,)."""
        return np.asarray(noise * self.validation_deviation / self.test_deviation)

    def expected_noise_score(self, score: HeldOutScore, weights: Weights) -> float:
        """Return the mean weighted square of pure noise."""
        return min(float(weights.mean_square(self.channel_noise(score)).mean()), 0.999 * score.mean_square)

    # -- sizes --------------------------------------------------------------------------------------------
    def unmodelled_responses(self, candidate: Candidate) -> dict[int, Array]:
        """Return the responses (samples, channels, effects) of the training records to unmodelled effects of `SMALL` of the typical force
        each."""
        if self._responses is None or self._responses[0] is not candidate:
            self._responses = candidate, simulate_unmodelled_effects(self.problem, candidate.fit, SMALL)
        return self._responses[1]

    def unmodelled_envelope(self, candidate: Candidate, size: float, least: float) -> Array:
        """Return the excess error (channels,), as a share of the deviation, that unmodelled effects of a share `size` of the typical
        force leave beside a refitted candidate."""
        if candidate not in self._envelopes:
            p = self.problem
            change = {i: y * (size / SMALL) for i, y in self.unmodelled_responses(candidate).items()}
            envelope = np.full(len(p.channels), least)
            if next(iter(change.values())).shape[2]:
                _, left = self.plain_fitter.refit(candidate.fit, change)
                r = np.concatenate([*left.values()]) * self.least_noise[:, None]
                shares = np.sqrt(np.mean(r**2, axis=0)) / p.deviation()[:, None]
                envelope = np.maximum(least, np.quantile(shares, 0.95, axis=1))
            self._envelopes[candidate] = envelope
        return self._envelopes[candidate]

    def effect_sizes(self, candidate: Candidate) -> list[float]:
        """Return the size of each effect, as a share of the force, current or signal at its place."""
        return [effect_size(self.problem, candidate.fit, name) for name in candidate.fit.structure.names]


def _beyond(error: Array, noise: Array) -> Array:
    """Return the part of an RMS error (channels,) beyond independent noise."""
    return np.asarray(np.sqrt(np.maximum(error**2 - noise**2, 0.0)), dtype=np.float64)


def effect_size(problem: Problem, fit: Fit, name: str) -> float:
    """Return the RMS of the force, current or signal of an element over that at its place; or its share of the dissipated work in
    a lightly damped structure, if that is larger."""
    net = fit.network
    e = net.element(name)
    if e.place == "channel":
        return _share_of_signal(problem, fit, e)
    if e.place == "element":
        return _share_of_current(problem, net, e)
    if e.series:
        return 1.0  # force and deflection are shared in series: the change of the outputs decides
    try:
        forces = element_forces(problem, fit, e.where)
    except InputError:
        return 1.0
    part = e.own_share([net.element(x) for x in forces])
    around = place_forces(problem, fit, without=name).at(e.where) if len(forces) == 1 else 0.0
    total = max(rms(np.sum([*forces.values()], axis=0)), around, 1e-300)
    work = work_share(problem, fit, name) if is_lightly_damped(problem.network) else 0.0
    return part * max(rms(forces[name]) / total, work)


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


@dataclass(frozen=True)
class Comparison:
    """Difference of the held-out log predictive density between two candidates."""

    #: Log predictive density of the first candidate minus that of the second [nats], summed over blocks.
    elpd_diff: float
    #: Standard error of the difference [nats].
    dse: float

    @property
    def errors(self) -> float:
        """The difference in standard errors."""
        return self.elpd_diff / max(self.dse, 1e-12)

    def is_better(self, c: Criteria) -> bool:
        """Return whether the first candidate predicts better, beyond chance."""
        return self.elpd_diff > c.elpd_diff and self.errors > c.elpd_errors

    def is_preferred(self, c: Criteria) -> bool:
        """Return whether the first candidate, with more parameters, is preferred by the rule of one standard error."""
        return self.elpd_diff > c.elpd_diff and self.errors > c.simpler_errors


def compare(first: Array, second: Array) -> Comparison:
    """Return the difference of log predictive densities (blocks,) [nats] and its standard error, which is infinite for a single block."""
    difference = np.asarray(first) - np.asarray(second)
    count = len(difference)
    dse = math.sqrt(count * float(np.var(difference, ddof=1))) if count > 1 else math.inf
    return Comparison(float(difference.sum()), dse)


def log_density(squares: Array, weight: Array, floor: Array) -> float:
    """Return the log predictive density [nats], without constants, of a block of squared weighted residuals (samples, channels) with
    unknown noise variance: a Student t density, in which a gross error counts by its logarithm (Gelman et al.: Bayesian Data Analysis,
    3rd edition (2013), sections 3.2 and 17.2). `weight`: independent samples; `floor` (channels,): scale of the prior."""
    return -float(np.sum(weight * np.log1p(squares.mean(axis=0) / floor)))


def block_edges(measured: Array, blocks: int, least: int) -> Array:
    """Return indices (edges,) of blocks of equal signal energy of measured channels (samples, channels): a decay has most in its first
    periods."""
    deviation = measured - measured.mean(axis=0)
    power = np.sum((deviation / np.maximum(measured.std(axis=0), 1e-300)) ** 2, axis=1)
    energy = np.cumsum(power + 0.02 * max(float(power.mean()), 1e-300))
    wanted = np.searchsorted(energy, np.linspace(0.0, energy[-1], blocks + 1)[1:-1]) + 1
    edges = [0]
    for edge in wanted:
        if edge - edges[-1] >= least and len(measured) - edge >= least:
            edges.append(int(edge))
    return np.array([*edges, len(measured)])
