"""Lags between the clocks of loggers, estimated with the nominal model by record.

The lags at which the nominal model correlates best with the measured outputs are fitted first. Gauss-Newton iterations over lags,
parameters and initial states of all records follow.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from ..._common.arrays import Z95
from ..._common.errors import InputError
from .._records.multirate import build_record
from .._simulation.problem import BROKEN, Problem, Record
from .gauss_newton import Fit, Fitter
from .initial_states import guess
from .noise import white_weights
from .structure import base_structure

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from ...physics.network import Network

#: largest lag in the search [s]
LIMIT = 0.5
#: interval of the lags that are tried, in time scales of the record, and largest number of fitted lags
RASTER, PEAKS = 0.25, 6
#: assumed model error before any fit, as a share of a signal's deviation
ROUGH = 0.1
#: number of blocks for the confidence interval by scatter
BLOCKS = 20
#: largest number of Gauss-Newton rounds
ROUNDS = 6
#: largest change of a lag per round, in time scales of the record: outputs are linear over shorter times only
STRIDE = 0.3
#: ratio to the least cost of fits below which a lag is nearly as good
ALIKE = 1.3


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
) -> tuple[list[Record], list[Lag]]:
    """Return records with the lags between their clocks, fitted with the parameters of a model, and these lags. `limit`: largest lag [s]."""
    if not any(r.clocks for r in records):
        return list(records), []
    out = list(records)
    doubts: dict[int, str] = {}
    structure = base_structure(network)
    for i, r in enumerate(out):
        if r.clocks:
            out[i], doubts[i] = _search_lags(r, network, limit)
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


def _search_lags(record: Record, network: Network, limit: float) -> tuple[Record, str]:
    """Return a record with the lags of its clocks within a limit [s], and a reason to doubt them: of the lags with the highest
    correlation of simulated and measured outputs the one with the smallest error of a fit."""
    structure, doubt = base_structure(network), ""
    deviation = np.maximum(record.measured.std(axis=0), 1e-300)
    weights = white_weights(0.5 * ROUGH * deviation)
    for k, clock in enumerate(record.clocks):
        tried = []
        for lag in _peaks(record, network, k, limit):
            r = _apply_lags(record, {**record.lags, clock: lag}, network)
            try:
                fit = Fitter(Problem(network, [r]), weights).fit(
                    structure, iterations=5
                )
            except BROKEN:
                continue
            step = fit.offset[0][len(network.outputs) + k]
            found = lag + float(np.clip(step, -STRIDE * r.pace, STRIDE * r.pace))
            tried.append(((fit.cost + fit.prior) / len(r), found))
        if not tried:
            return record, "the model breaks down before anything is fitted"
        least, best = min(tried)
        alike = [
            lag
            for cost, lag in tried
            if cost < ALIKE * least and abs(lag - best) > record.pace
        ]
        if abs(best) > 0.97 * limit:
            doubt = f"at the limit of {limit:.3g} s within which it was sought"
        elif alike:
            doubt = f"{1e3 * min(alike, key=abs):.4g} ms would be nearly as good"
        record = _apply_lags(record, {**record.lags, clock: best}, network)
    return record, doubt


def _peaks(record: Record, network: Network, clock: int, limit: float) -> list[float]:
    """Return the lags [s] of a clock with the highest correlation of simulated and measured outputs, each a time scale from the others."""
    assert record.source is not None
    problem = Problem(network, [record.unread()])
    initial = guess(Problem(network, [record]), network, 0)[:, None]
    simulated = problem.simulate([network], 0, initial)[:, :, 0]
    grid = record.start + record.step * np.arange(len(simulated))
    spacing = RASTER * record.pace
    count = int(min(limit, 0.25 * (grid[-1] - grid[0])) / spacing)
    lags = spacing * np.arange(-count, count + 1)
    inner = slice(*np.searchsorted(grid, [grid[0] - lags[0], grid[-1] + lags[0]]))
    score = np.zeros(len(lags))
    for j in np.flatnonzero(record.late[clock]):
        signal = record.source.signals[problem.channels[j]]
        y = simulated[inner, j] - simulated[inner, j].mean()
        for n, lag in enumerate(lags):
            x = np.interp(grid[inner] + lag, signal.time, signal.values)
            size = float(np.linalg.norm(x - x.mean()) * np.linalg.norm(y))
            score[n] += float((x - x.mean()) @ y) / max(size, 1e-300)
    found: list[float] = []
    for n in np.argsort(-score, kind="stable"):
        if len(found) < PEAKS and all(abs(lags[n] - x) > record.pace for x in found):
            found.append(float(lags[n]))
    return found
