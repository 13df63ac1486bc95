"""Lags between the clocks of loggers, estimated once with the nominal model, for each record alone.

Fits of the nominal model start at the lags at which it correlates best with the measured outputs. Each fit of parameters and initial state
gives a Gauss-Newton step of the lag, and the record is resampled at the next lag.
"""

from __future__ import annotations

import contextlib
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from ..._common.arrays import Z95
from .._records.resampling import build_record, find_reference_clock
from .._simulation.problem import BROKEN, Problem, Record
from .gauss_newton import Fitter
from .initial_states import guess
from .noise import white_weights
from .structure import base_structure

if TYPE_CHECKING:
    from collections.abc import Sequence

    from ..._common.arrays import Array
    from ...physics.network import Network
    from ...records.loggers.recording import Recording

#: largest lag in the search [s]
LIMIT = 0.5
#: interval of the lags that are tried, in time scales of the record, and largest number of fitted lags
RASTER, PEAKS = 0.25, 6
#: assumed model error before any fit, as a share of a signal's deviation
ROUGH = 0.1
#: number of blocks for the confidence interval by scatter
BLOCKS = 20
#: largest number of refits at the best lag, and of iterations of a refit
ROUNDS, ITERATIONS = 6, 5
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
    """Return records whose unknown lags between clocks are found and taken out, and these lags.

    Args:
        records: Measured records; only those of recordings with clocks of unknown lag change.
        network: Nominal model; its parameters and the initial state of a record are fitted with each lag.
        limit: Largest lag [s].
    """
    out, found = list(records), []
    for i, record in enumerate(out):
        if record.source is None:
            continue
        recording = record.source
        known = {find_reference_clock(recording, network), *recording.lags}
        clocks = dict.fromkeys(recording.signals[c.name].clock for c in network.outputs)
        for clock in clocks:
            if clock not in known:
                lag = _find_lag(recording, clock, network, limit)
                recording = _with_lag(recording, clock, lag.value)
                out[i] = build_record(recording, network)
                found.append(lag)
    return out, found


@dataclass(frozen=True)
class _LagFit:
    """Gauss-Newton step of a lag from a simulation with nominal or refitted parameters."""

    #: parameters
    x: Array
    #: next estimate of the lag [s]
    lag: float
    #: half the 95 % interval of the lag [s], from the scatter of blocks
    half: float
    #: cost per sample at the next estimate, to first order
    cost: float


def _find_lag(recording: Recording, clock: str, network: Network, limit: float) -> Lag:
    """Return the lag of a clock: of the lags of highest correlation the one with the smallest error of a refit.

    A refit removes errors of parameters from the lag. Where an effect is missing, the nominal parameters are often closer. Of the lags
    with either parameters the one with the narrower interval is taken.
    """
    record = build_record(recording, network)
    tried = []
    for lag in _peaks(recording, clock, network, limit):
        with contextlib.suppress(*BROKEN):
            tried.append(_fit_lag(recording, clock, network, lag, ITERATIONS))
    if not tried:
        doubt = "the model breaks down before anything is fitted"
        return Lag(record.name, clock, 0.0, -limit, limit, doubt)
    start = min(tried, key=lambda fit: fit.cost)
    alike = [fit.lag for fit in tried if fit.cost < ALIKE * start.cost]
    alike = [lag for lag in alike if abs(lag - start.lag) > record.pace]
    refined = []
    for iterations in (0, ITERATIONS):
        found = start
        x = start.x if iterations else None
        with contextlib.suppress(*BROKEN):
            for _ in range(ROUNDS):
                found = _fit_lag(recording, clock, network, found.lag, iterations, x)
                x = found.x
            refined.append(found)
    best = min(refined or [start], key=lambda fit: fit.half)
    doubt = ""
    if abs(best.lag) > 0.97 * limit:
        doubt = f"at the limit of {limit:.3g} s within which it was sought"
    elif alike:
        doubt = f"{1e3 * min(alike, key=abs):.4g} ms would be nearly as good"
    low, high = best.lag - best.half, best.lag + best.half
    return Lag(record.name, clock, best.lag, low, high, doubt)


def _late(recording: Recording, clock: str, network: Network) -> list[int]:
    """Return the outputs with the stamps of a clock."""
    outputs = enumerate(network.outputs)
    return [j for j, c in outputs if recording.signals[c.name].clock == clock]


def _with_lag(recording: Recording, clock: str, lag: float) -> Recording:
    """Return a recording with a known lag [s] of a clock."""
    return replace(recording, lags={**recording.lags, clock: lag})


def _fit_lag(
    recording: Recording,
    clock: str,
    network: Network,
    lag: float,
    iterations: int,
    x: Array | None = None,
) -> _LagFit:
    """Return the step from a lag [s], after a refit of parameters and initial state from `x` unless there are no iterations."""
    record = build_record(_with_lag(recording, clock, lag), network)
    problem = Problem(network, [record])
    weights = white_weights(0.5 * ROUGH * problem.deviation())
    fitter = Fitter(problem, weights)
    fit = fitter.fit(base_structure(network), x, iterations=iterations)
    # measured outputs are the simulated ones, later by what the lag lacks
    late = _late(recording, clock, network)
    slope = np.zeros_like(record.measured)
    slope[:, late] = -np.gradient(fit.outputs[0], record.interval, axis=0)[:, late]
    by_lag = weights(slope)
    if iterations:
        by_lag = fitter.refit(fit, {0: slope[:, :, None]})[1][0][:, :, 0]
    residual = weights(record.measured - fit.outputs[0])
    information = max(float(np.sum(by_lag**2)), 1e-300)
    stride = STRIDE * record.pace
    step = float(np.clip(np.sum(by_lag * residual) / information, -stride, stride))
    rest = residual - step * by_lag
    score = np.sum(by_lag * rest, axis=1)
    blocks = np.array_split(score - score.mean(), BLOCKS)
    half = Z95 * float(np.linalg.norm([b.sum() for b in blocks])) / information
    cost = (float(np.sum(rest**2)) + fit.prior) / len(record)
    return _LagFit(fit.x, lag + step, half, cost)


def _peaks(
    recording: Recording, clock: str, network: Network, limit: float
) -> list[float]:
    """Return the lags [s] of a clock with the highest correlation of simulated and measured outputs, each a time scale from the others."""
    record = build_record(recording, network)
    problem = Problem(network, [record])
    initial = guess(problem, network, 0)[:, None]
    simulated = problem.simulate([network], 0, initial)[:, :, 0]
    time = record.time
    spacing = RASTER * record.pace
    count = int(min(limit, 0.25 * (time[-1] - time[0])) / spacing)
    lags = spacing * np.arange(-count, count + 1)
    inner = slice(*np.searchsorted(time, [time[0] - lags[0], time[-1] + lags[0]]))
    score = np.zeros(len(lags))
    for j in _late(recording, clock, network):
        for n, lag in enumerate(lags):
            x = np.interp(time[inner] + lag, time, record.measured[:, j])
            score[n] += _correlation(x, simulated[inner, j])
    found: list[float] = []
    for lag in lags[np.argsort(-score, kind="stable")]:
        if len(found) < PEAKS and all(abs(lag - x) > record.pace for x in found):
            found.append(float(lag))
    return found


def _correlation(x: Array, y: Array) -> float:
    """Return the correlation of two signals (n,); 0 for a constant."""
    x, y = x - x.mean(), y - y.mean()
    return float(x @ y) / max(float(np.linalg.norm(x) * np.linalg.norm(y)), 1e-300)
