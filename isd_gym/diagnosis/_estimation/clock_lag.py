"""Lags between the clocks of loggers, estimated once with the nominal model, for each record alone.

Fits of the nominal model start at the lags at which it correlates best with the measured outputs. Each fit of parameters and initial state
gives a Gauss-Newton step of the lag, and the record is resampled at the next lag.
"""

from __future__ import annotations

import math
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
        recording = record.source
        if recording is None:
            continue
        known = {find_reference_clock(recording, network), *recording.lags}
        clocks = dict.fromkeys(recording.signals[c.name].clock for c in network.outputs)
        for clock in clocks:
            if clock not in known:
                lag = _LagSearch(recording, clock, network).find(limit)
                lags = {**recording.lags, clock: lag.value}
                recording = replace(recording, lags=lags)
                out[i] = build_record(recording, network)
                found.append(lag)
    return out, found


@dataclass(frozen=True)
class _LagFit:
    """Gauss-Newton step of a lag from a simulation with nominal or refitted parameters."""

    #: parameters
    x: Array | None
    #: next estimate of the lag [s]
    lag: float
    #: half the 95 % interval of the lag [s], from the scatter of blocks
    half: float = math.inf
    #: cost per sample at the next estimate, to first order
    cost: float = math.inf


class _LagSearch:
    """Search for the lag of a clock.

    A refit removes errors of parameters from the lag. Where an effect is missing, the nominal parameters are often closer.
    """

    def __init__(self, recording: Recording, clock: str, network: Network):
        self.recording = recording
        self.clock = clock
        self.network = network
        self.late = [recording.signals[c.name].clock == clock for c in network.outputs]

    def find(self, limit: float) -> Lag:
        """Return the lag with the smallest error of a refit, and of its estimates with nominal and refitted parameters the one with the
        narrower interval."""
        record = self._record(0.0)
        fits = [self._refine(lag, ITERATIONS, 1) for lag in self._peaks(record, limit)]
        start = min(fits, key=lambda fit: fit.cost)
        alike = [fit.lag for fit in fits if fit.cost < ALIKE * start.cost]
        alike = [lag for lag in alike if abs(lag - start.lag) > record.pace]
        refined = [self._refine(start.lag, k, ROUNDS) for k in (0, ITERATIONS)]
        best = min(refined, key=lambda fit: fit.half)
        half = min(best.half, limit)
        doubt = ""
        if math.isinf(best.half):
            doubt = "the model breaks down before anything is fitted"
        elif abs(best.lag) > 0.97 * limit:
            doubt = f"at the limit of {limit:.3g} s within which it was sought"
        elif alike:
            doubt = f"{1e3 * min(alike, key=abs):.4g} ms would be nearly as good"
        low, high = best.lag - half, best.lag + half
        return Lag(record.name, self.clock, best.lag, low, high, doubt)

    def _record(self, lag: float) -> Record:
        """Return the record at a lag [s], compared at the raster of the lags: the low-pass removes noise, whose slope says nothing about a
        lag."""
        lags = {**self.recording.lags, self.clock: lag}
        recording = replace(self.recording, lags=lags)
        record = build_record(recording, self.network)
        thin = max(1, int(RASTER * record.pace / record.step))
        return build_record(recording, self.network, thin=thin)

    def _refine(self, lag: float, iterations: int, rounds: int) -> _LagFit:
        """Return the last of several steps from a lag [s]; its interval is infinite where the simulation breaks down."""
        fit = _LagFit(None, lag)
        try:
            for _ in range(rounds):
                fit = self._step(fit, iterations)
        except BROKEN:
            return _LagFit(None, lag)
        return fit

    def _step(self, start: _LagFit, iterations: int) -> _LagFit:
        """Return the next step, after a refit of parameters and initial state unless there are no iterations."""
        record = self._record(start.lag)
        problem = Problem(self.network, [record])
        weights = white_weights(0.5 * ROUGH * problem.deviation())
        fitter = Fitter(problem, weights)
        structure = base_structure(self.network)
        fit = fitter.fit(structure, start.x, iterations=iterations)
        # measured outputs are the simulated ones, later by what the lag lacks
        slope = -np.gradient(fit.outputs[0], record.interval, axis=0) * self.late
        by_lag = weights(slope)
        if iterations:
            by_lag = fitter.unabsorbed(fit, {0: slope[:, :, None]})[0][:, :, 0]
        residual = weights(record.measured - fit.outputs[0])
        information = max(float(np.sum(by_lag**2)), 1e-300)
        stride = STRIDE * record.pace
        step = float(np.clip(np.sum(by_lag * residual) / information, -stride, stride))
        rest = residual - step * by_lag
        score = np.sum(by_lag * rest, axis=1)
        blocks = np.array_split(score - score.mean(), BLOCKS)
        half = Z95 * float(np.linalg.norm([b.sum() for b in blocks])) / information
        cost = (float(np.sum(rest**2)) + fit.prior) / len(record)
        return _LagFit(fit.x, start.lag + step, half, cost)

    def _peaks(self, record: Record, limit: float) -> list[float]:
        """Return the lags [s] with the highest correlation of simulated and measured outputs, each a time scale from the others."""
        problem = Problem(self.network, [record])
        initial = guess(problem, self.network, 0)[:, None]
        simulated = problem.simulate([self.network], 0, initial)[:, :, 0]
        time = record.time
        spacing = RASTER * record.pace
        count = int(min(limit, 0.25 * (time[-1] - time[0])) / spacing)
        lags = spacing * np.arange(-count, count + 1)
        inner = slice(*np.searchsorted(time, [time[0] - lags[0], time[-1] + lags[0]]))
        score = np.zeros(len(lags))
        for j in np.flatnonzero(self.late):
            for n, lag in enumerate(lags):
                x = np.interp(time[inner] + lag, time, record.measured[:, j])
                with np.errstate(all="ignore"):  # a constant has no correlation
                    r = np.corrcoef(x, simulated[inner, j])[0, 1]
                score[n] += np.nan_to_num(r)
        found: list[float] = []
        for lag in lags[np.argsort(-score, kind="stable")]:
            if len(found) < PEAKS and all(abs(lag - x) > record.pace for x in found):
                found.append(float(lag))
        return found
