"""Lags between the clocks of loggers, estimated with the nominal model by record.

The lags at which the nominal model correlates best with the measured outputs are fitted first. Gauss-Newton iterations over lags,
parameters and initial states of all records follow.
"""

from __future__ import annotations

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

    from ..._common.arrays import Array
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
    #: delay of the time stamps [s]
    value: float
    #: lower end of the 95 % interval [s]
    low: float
    #: upper end of the 95 % interval [s]
    high: float
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
    out = list(records)
    doubts: dict[int, str] = {}
    for i, r in enumerate(out):
        if r.clocks:
            out[i], doubts[i] = _search_lags(r, network, limit)
    fit = None
    for _ in range(ROUNDS if doubts else 0):
        try:
            fit = _fit(out, network, None if fit is None else fit.x, iterations=4)
        except InputError:  # the simulation diverges: the lags of the wide search stay
            break
        moved = 0.0
        for i in doubts:
            r, steps = out[i], _steps(fit, i, out[i])
            moved = max(moved, float(np.abs(steps).max()) / r.pace)
            lags = {
                k: r.lags[k] + float(s) for k, s in zip(r.clocks, steps, strict=True)
            }
            out[i] = _apply_lags(r, lags, network)
        if moved < 1e-3:
            break
    found = []
    if fit is not None:
        for i, doubt in doubts.items():
            found += _estimate_lags(out[i], fit.outputs[i], doubt)
    return out, found


def _fit(
    records: Sequence[Record], network: Network, x: Array | None, iterations: int
) -> Fit:
    """Return the fit of parameters, initial states and lags to records."""
    problem, structure = Problem(network, records), base_structure(network)
    fitter = Fitter(problem, white_weights(0.5 * ROUGH * problem.deviation()))
    return fitter.fit(
        structure, structure.start if x is None else x, iterations=iterations
    )


def _steps(fit: Fit, index: int, record: Record) -> Array:
    """Return the changes of the lags of a record that a fit asks for (clocks,) [s]."""
    steps = fit.offset[index][-len(record.clocks) :]
    return np.clip(steps, -STRIDE * record.pace, STRIDE * record.pace)


def _apply_lags(record: Record, lags: Mapping[str, float], network: Network) -> Record:
    """Return a record, built again from its recording with new lags [s]."""
    assert record.source is not None
    return replace(build_record(record.source, network, lags), name=record.name)


def _estimate_lags(record: Record, outputs: Array, doubt: str) -> list[Lag]:
    """Return the lags of a record after a fit with these outputs, with confidence intervals from the scatter of blocks."""
    n = min(len(outputs), len(record))
    residual = record.measured[:n] - outputs[:n]
    size = np.maximum(residual.std(axis=0), 1e-300)
    slope = np.gradient(outputs[:n], record.interval, axis=0) / size
    out = []
    for clock, own in zip(record.clocks, record.late, strict=True):
        score = np.sum(slope[:, own] * (residual / size)[:, own], axis=1)
        blocks = np.array_split(score - score.mean(), BLOCKS)
        information = max(float(np.sum(slope[:, own] ** 2)), 1e-300)
        half = Z95 * float(np.linalg.norm([b.sum() for b in blocks])) / information
        value = record.lags[clock]
        out.append(Lag(record.name, clock, value, value - half, value + half, doubt))
    return out


def _search_lags(record: Record, network: Network, limit: float) -> tuple[Record, str]:
    """Return a record with the lags of its clocks within a limit [s], and a reason to doubt them: of the lags with the highest
    correlation of simulated and measured outputs the one with the smallest error of a fit."""
    doubt = ""
    for k, clock in enumerate(record.clocks):
        tried = []
        for lag in _peaks(record, network, k, limit):
            r = _apply_lags(record, {**record.lags, clock: lag}, network)
            try:
                fit = _fit([r], network, None, iterations=5)
            except BROKEN:
                continue
            found = lag + float(_steps(fit, 0, r)[k])
            tried.append(((fit.cost + fit.prior) / len(r), found))
        if not tried:
            return record, "the model breaks down before anything is fitted"
        least, best = min(tried)
        alike = [lag for cost, lag in tried if cost < ALIKE * least]
        alike = [lag for lag in alike if abs(lag - best) > record.pace]
        if abs(best) > 0.97 * limit:
            doubt = f"at the limit of {limit:.3g} s within which it was sought"
        elif alike:
            doubt = f"{1e3 * min(alike, key=abs):.4g} ms would be nearly as good"
        record = _apply_lags(record, {**record.lags, clock: best}, network)
    return record, doubt


def _peaks(record: Record, network: Network, clock: int, limit: float) -> list[float]:
    """Return the lags [s] of a clock with the highest correlation of simulated and measured outputs, each a time scale from the others."""
    assert record.source is not None
    initial = guess(Problem(network, [record]), network, 0)[:, None]
    simulated = Problem(network, [record.unread()]).simulate([network], 0, initial)
    grid = record.start + record.step * np.arange(len(simulated))
    spacing = RASTER * record.pace
    count = int(min(limit, 0.25 * (grid[-1] - grid[0])) / spacing)
    lags = spacing * np.arange(-count, count + 1)
    inner = slice(*np.searchsorted(grid, [grid[0] - lags[0], grid[-1] + lags[0]]))
    score = np.zeros(len(lags))
    for j in np.flatnonzero(record.late[clock]):
        signal = record.source.signals[network.outputs[j].name]
        for n, lag in enumerate(lags):
            x = np.interp(grid[inner] + lag, signal.time, signal.values)
            score[n] += _correlation(x, simulated[inner, j, 0])
    found: list[float] = []
    for lag in lags[np.argsort(-score, kind="stable")]:
        if len(found) < PEAKS and all(abs(lag - x) > record.pace for x in found):
            found.append(float(lag))
    return found


def _correlation(x: Array, y: Array) -> float:
    """Return the correlation of two signals (n,); 0 for a constant."""
    x, y = x - x.mean(), y - y.mean()
    return float(x @ y) / max(float(np.linalg.norm(x) * np.linalg.norm(y)), 1e-300)
