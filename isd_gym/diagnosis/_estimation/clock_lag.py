"""Lags between the clocks of loggers, estimated with the nominal model by record.

A wide search with the model linear in parameters and initial state comes first. Gauss-Newton iterations over lags,
parameters and initial state follow.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from ..._common.arrays import Z95, Array
from ..._common.errors import InputError
from .._records.multirate import build_record
from .._simulation.problem import Problem, Record
from .gauss_newton import Fit, Fitter
from .initial_states import guess
from .noise import white_weights
from .sensitivities import tangents
from .structure import Structure, base_structure

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from ...physics.network import Network

LIMIT = 0.5  # largest lag in the search [s]
TRIALS = 400  # number of lags in the wide search
ROWS = 1500  # largest number of samples of a channel in the wide search
FEWEST = 16  # least number of samples of a channel in the wide search
ROUGH = 0.1  # assumed model error before any fit, as a share of a signal's deviation
#: Widths of the refinement about the best lag of the wide search, in time scales of the record.
WIDTHS = (0.15, 0.06, 0.025, 0.01)
BLOCKS = 20  # number of blocks for the confidence interval by scatter
ROUNDS = 6  # largest number of Gauss-Newton rounds
#: Largest change of a lag per round, in time scales of the record: outputs are linear over shorter times only.
STRIDE = 0.3
ALIKE = 1.15  # ratio to the least cost below which a lag is nearly as good


@dataclass(frozen=True)
class Lag:
    """Estimated lag of a clock in a record."""

    record: str
    clock: str
    value: float  # delay of the time stamps [s]
    low: float  # lower end of the 95 % interval [s]
    high: float  # upper end of the 95 % interval [s]
    #: Reason to doubt the lag, such as a second lag of nearly equal cost; empty without doubt.
    doubt: str = ""

    def __str__(self) -> str:
        half = 0.5 * (self.high - self.low)
        text = f"{self.record}: the clock of {self.clock.partition(' ')[2] or self.clock} is {abs(1e3 * self.value):.2f} ms "
        text += f"{'late' if self.value >= 0 else 'early'} (+- {1e3 * half:.2g} ms)"
        return f"{text}; {self.doubt}" if self.doubt else text


def align_clocks(
    records: Sequence[Record],
    network: Network,
    limit: float = LIMIT,
    previous: Sequence[Lag] | None = None,
) -> tuple[list[Record], list[Lag]]:
    """Return records with the lags between their clocks, fitted with the parameters of a model, and these lags. `limit`: largest lag [s];
    `previous`: lags of an earlier model in place of the wide search."""
    if not any(r.clocks for r in records):
        return list(records), []
    out = list(records)
    doubts = {
        i: x.doubt
        for i, r in enumerate(out)
        for x in previous or ()
        if x.record == r.name
    }
    structure = base_structure(network)
    problem = Problem(network, out)
    for i, r in enumerate(out):
        if r.clocks and previous is None:
            found, doubts[i] = _search_lags(problem, structure, i, limit)
            out[i] = _apply_lags(r, found, network)
    x, fit = structure.start, None
    for _ in range(ROUNDS):
        problem = Problem(network, out)
        deviation = problem.deviation()
        try:
            fit = Fitter(problem, white_weights(0.5 * ROUGH * deviation)).fit(
                structure, x, iterations=4
            )
        except InputError:  # the simulation diverges: the lags of the wide search stay
            break
        x, moved = fit.x, 0.0
        for i, r in enumerate(out):
            if r.clocks:
                step = np.clip(
                    fit.offset[i][len(problem.channels) :],
                    -STRIDE * r.pace,
                    STRIDE * r.pace,
                )
                moved = max(moved, float(np.abs(step).max() / r.pace))
                lags = {
                    k: r.lags[k] + float(s) for k, s in zip(r.clocks, step, strict=True)
                }
                out[i] = _apply_lags(r, lags, network)
        if moved < 1e-3:
            break
    if fit is None:
        return out, []
    problem = Problem(network, out)
    return out, [
        lag
        for i in range(len(out))
        for lag in _estimate_lags(problem, fit, i, doubts.get(i, ""))
    ]


def _apply_lags(record: Record, lags: Mapping[str, float], network: Network) -> Record:
    """Return a record, built again from its recording with new lags [s]."""
    assert record.source is not None
    return replace(build_record(record.source, network, lags), name=record.name)


def _estimate_lags(problem: Problem, fit: Fit, index: int, doubt: str) -> list[Lag]:
    """Return the lags of a record after a fit, with confidence intervals from the scatter of blocks."""
    r, out = problem.records[index], []
    if not r.clocks or index not in fit.outputs:
        return []
    y = fit.outputs[index]
    n = min(len(y), len(r.measured))
    residual = r.measured[:n] - y[:n]
    size = np.maximum(residual.std(axis=0), 1e-300)
    slope = np.gradient(y[:n], r.interval, axis=0)
    for k, (clock, own) in enumerate(zip(r.clocks, r.late, strict=True)):
        s = slope[:, own] / size[own]
        score, information = (
            (s * residual[:, own] / size[own]).sum(axis=1),
            (s**2).sum(axis=1),
        )
        parts = np.array(
            [p.sum() for p in np.array_split(score - score.mean(), BLOCKS)]
        )
        half = (
            Z95
            * math.sqrt(float(np.sum(parts**2)))
            / max(float(information.sum()), 1e-300)
        )
        value = r.lags[clock] + float(fit.offset[index][len(problem.channels) + k])
        out.append(Lag(r.name, clock, value, value - half, value + half, doubt))
    return out


@dataclass(frozen=True)
class _Samples:
    """Smoothed and thinned samples of a measured channel."""

    time: Array  # time stamps [s] (n,)
    values: Array  # values in the units of the model (n,)
    deviation: float  # standard deviation of the values


@dataclass(frozen=True)
class _LagCost:
    """Least squares of a record as a function of one clock's lag, minimised over parameters and initial state."""

    #: Samples of channels with a known clock and of late channels, by channel index.
    samples: Mapping[int, _Samples]
    known: Sequence[int]  # indices of the channels with a known clock
    late: Sequence[int]  # indices of the late channels
    grid: np.ndarray  # simulation grid [s]
    step: float  # interval of the grid [s]
    #: Simulated outputs and their derivatives by parameters and initial state (grid, channels, 1 + unknowns).
    columns: Array
    prior: Array  # one over the prior standard deviation by unknown
    free_offset: NDArray[
        np.bool_
    ]  # whether the offset of a channel is free (channels,)

    def __call__(self, lag: float) -> float:
        """Return the least sum of squares at a lag [s]."""
        rows = np.concatenate([*self._fixed, *(self._rows(j, lag) for j in self.late)])
        b, A = rows[:, 0] - rows[:, 1], rows[:, 2:]
        if not A.shape[1]:
            return float(b @ b)
        H = A.T @ A + np.diag(self.prior**2)
        g = A.T @ b
        return float(
            b @ b
            - g @ np.linalg.solve(H + 1e-12 * np.trace(H) * np.eye(len(H)) / len(H), g)
        )

    @cached_property
    def _fixed(self) -> list[Array]:
        return [self._rows(j, 0.0) for j in self.known]

    def _rows(self, channel: int, lag: float) -> Array:
        """Return measured values, simulated values and derivatives of a channel (n, 2 + unknowns), weighted."""
        samples = self.samples[channel]
        place = (samples.time - lag - self.grid[0]) / self.step
        k = np.clip(place.astype(int), 0, len(self.grid) - 2)
        u = (place - k)[:, None]
        simulated = (1 - u) * self.columns[k, channel] + u * self.columns[
            k + 1, channel
        ]
        out = np.column_stack([samples.values, simulated])
        mean = out.mean(axis=0) * self.free_offset[channel]
        return np.asarray((out - mean) / (ROUGH * samples.deviation))


def _search_lags(
    problem: Problem, base: Structure, index: int, limit: float
) -> tuple[dict[str, float], str]:
    """Return the lags of a record's clocks [s] within a limit, and a reason to doubt them."""
    record = problem.records[index]
    x0 = guess(problem, base.at(base.start), index)
    fine = Problem(problem.network, [record.unread()], time=problem.time)
    tangent = tangents(fine, base, base.start, {0: x0})[0]
    columns = np.concatenate(
        [tangent.outputs[:, :, None], tangent.by_parameter, tangent.by_state], axis=2
    )
    lags, doubt = dict(record.lags), ""
    if not np.isfinite(columns).all():
        return lags, "the model breaks down before anything is fitted"
    prior = np.append(1 / base.sigma, np.full(tangent.by_state.shape[2], 1e-9))
    grid = record.start + record.step * np.arange(len(columns))
    reach = min(limit, 0.25 * (grid[-1] - grid[0]))
    free_offset = problem.shared_offset | problem.record_offset
    known = np.flatnonzero(~np.any(record.late, axis=0)).tolist()
    for clock, own in zip(record.clocks, record.late, strict=True):
        late = np.flatnonzero(own).tolist()
        samples = {
            j: _thin_samples(problem, record, j, grid, reach) for j in (*known, *late)
        }
        if min(len(s.values) for s in samples.values()) < FEWEST:
            return lags, "too short to look for it"
        cost = _LagCost(
            samples, known, late, grid, record.step, columns, prior, free_offset
        )
        trials = _choose_trials(cost, record.pace, reach)
        costs = np.array([cost(float(t)) for t in trials])
        best = float(trials[np.argmin(costs)])
        for width in WIDTHS:
            near = best + width * record.pace * np.arange(-2, 3)
            best = float(near[int(np.argmin([cost(float(t)) for t in near]))])
        lags[clock] = best
        far = np.abs(trials - best) > 2.0 * record.pace
        count = sum(len(s.values) for s in samples.values())
        if abs(best) > 0.97 * reach:
            doubt = f"at the limit of {reach:.3g} s within which it was sought"
        elif far.any() and costs[far].min() < ALIKE * cost(best) + 0.02 * count:
            rival = float(trials[far][int(np.argmin(costs[far]))])
            doubt = f"{1e3 * rival:.4g} ms would be nearly as good"
    return lags, doubt


def _thin_samples(
    problem: Problem, record: Record, channel: int, grid: np.ndarray, reach: float
) -> _Samples:
    """Return about `ROWS` samples of a channel, on the grid for every lag up to `reach` [s]."""
    assert record.source is not None
    signal = record.source.signals[problem.channels[channel]]
    inside = (signal.time > grid[0] + reach) & (signal.time < grid[-1] - reach)
    time, values = (
        signal.time[inside],
        (signal.values * problem.factors[channel])[inside],
    )
    stride = max(1, len(time) // ROWS)
    if stride > 1:  # the motion tells a lag, not the noise above the motion
        values = np.convolve(values, np.ones(stride) / stride, mode="same")
    return _Samples(time[::stride], values[::stride], max(float(values.std()), 1e-300))


def _choose_trials(cost: _LagCost, pace: float, reach: float) -> Array:
    """Return lags [s] for the wide search, a quarter of the time scale `pace` [s] apart: all, or the `TRIALS` with the highest
    correlation of simulated and measured outputs."""
    every = np.arange(-reach, reach + 0.25 * pace, 0.25 * pace)
    if 0.25 * pace >= 2 * reach / TRIALS:
        return every
    score = np.zeros(len(every))
    for j in cost.late:
        time, v = cost.samples[j].time, cost.samples[j].values
        x = np.stack(
            [np.interp(time - lag, cost.grid, cost.columns[:, j, 0]) for lag in every]
        )
        x = x - x.mean(axis=1, keepdims=True)
        size = np.linalg.norm(x, axis=1) * np.linalg.norm(v - v.mean())
        score += x @ (v - v.mean()) / np.maximum(size, 1e-300)
    return every[np.sort(np.argsort(-score)[:TRIALS])]
