"""Noise: estimates from the signal, and weights of residuals."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.signal import welch

from .._records.filtering import estimate_white_noise, find_computed_forces
from .._simulation.interpolation import differences
from .._simulation.problem import BROKEN, low_pass
from .initial_states import guess

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from ..._common.arrays import Array
    from .._simulation.problem import Problem, Record


#: lags up to which samples of a residual count as dependent
LAGS = 20


@dataclass(frozen=True)
class Weights:
    """White noise that residuals are weighted with: its level (channels,) and the share of independent samples (channels,)."""

    level: Array
    share: Array

    def __call__(self, residual: Array) -> Array:
        """Return residuals (samples, channels, ...) over the level, so that their squares sum to the number of independent samples."""
        scale = np.sqrt(self.share) / np.maximum(self.level, 1e-300)
        return np.asarray(residual * scale.reshape(-1, *[1] * (residual.ndim - 2)))


def white_weights(level: Array) -> Weights:
    """Return weights for noise of a known level (channels,)."""
    return Weights(np.asarray(level, dtype=np.float64), np.ones(len(level)))


def weights_of(residuals: Sequence[Array], least: Array) -> Weights:
    """Return weights by the level of residuals [(samples, channels), ...], at least `least` (channels,)."""
    return white_weights(
        np.maximum(np.sqrt(np.mean(np.concatenate(residuals) ** 2, axis=0)), least)
    )


def balanced_weights(residuals: Sequence[Array], least: Array) -> Weights:
    """Return weights whose ratios between channels are those of the level of residuals
    [(samples, channels), ...], with the geometric mean of the smallest noise `least`
    (channels,): a channel with much noise counts as much as the others where the model
    misses all of them."""
    level, root = weights_of(residuals, least).level, 1.0 / len(least)
    mean = float(np.prod(least)) ** root
    return white_weights(mean * (level / float(np.prod(level)) ** root))


def independent_share(residuals: Sequence[Array]) -> Array:
    """Return the share (channels,) of the samples of residuals [(samples, channels), ...] that count as independent, from their
    autocorrelation: the variance of a product with a signal of the same spectrum (Bartlett, J. R. Stat. Soc. Suppl. 8 (1946) 27)."""
    lags = min(LAGS, min(map(len, residuals)) // 8)
    power, total = np.sum([np.sum(r**2, axis=0) for r in residuals], axis=0), 1.0
    for k in range(1, lags + 1):
        product = np.sum([np.sum(r[k:] * r[:-k], axis=0) for r in residuals], axis=0)
        total = total + 2.0 * (product / np.maximum(power, 1e-300)) ** 2
    return np.asarray(1.0 / total)


def noise_of(
    series: Sequence[Array], step: float, *, time: float, white: bool = False
) -> float:
    """Return the deviation of white plus AR(1) noise of residuals (samples,), at most that of the series, from the spectrum above three
    frequencies of a motion that changes in `time` [s]; `white`: behind a low-pass, which leaves a level but no colour."""
    length = min(1024, min(len(x) for x in series))
    frequency, s, _ = _density(series, step, length)
    top = frequency[-1]
    low = max(min(3.0 / (2 * math.pi * time), 0.3 * top), 2 * float(frequency[1]))
    noise, _ = _noise_above(
        frequency, s, step, low, (0.7 if white else 0.98) * top, white
    )
    return min(noise, float(np.std(np.concatenate(series))))


def _density(
    series: Sequence[Array], step: float, length: int
) -> tuple[Array, Array, float]:
    """Return frequencies [Hz], mean power density, and the number of averaged spectra."""
    density, frequency, averages = [], np.zeros(0), 0.0
    for x in series:
        n = min(length, len(x))
        if n < length:
            continue
        frequency, s = welch(x - x.mean(), 1.0 / step, nperseg=n)
        density.append(s * len(x))
        averages += max(1.0, 1.6 * (len(x) / n) - 0.6)  # halves overlap, Hann window
    total = sum(len(x) for x in series if len(x) >= length)
    return frequency, np.maximum(np.sum(density, axis=0) / total, 1e-300), averages


def _noise_above(
    frequency: Array, s: Array, step: float, low: float, high: float, white: bool
) -> tuple[float, float]:
    """Fit white plus AR(1) noise to a spectrum between two frequencies [Hz]; return the deviation and the mean log distance."""
    w = 2 * np.pi * frequency * step
    pick = (frequency > low) & (frequency < high)
    if np.sum(pick) < 4:
        pick = frequency > 0.5 * frequency[-1]
    best = (math.inf, 0.0)
    for phi in (0.0,) if white else (0.0, 0.3, 0.5, 0.6, 0.7, 0.8, 0.87, 0.93):
        shape = 1.0 / (1 + phi**2 - 2 * phi * np.cos(w[pick]))
        for share in (
            (1.0,) if phi == 0 else (0.0, 0.02, 0.05, 0.1, 0.2, 0.35, 0.5, 0.7, 0.9)
        ):
            model = share + (1 - share) * shape * (1 - phi) ** 2
            logs = np.log(s[pick] / model)
            # a median: peaks of unexplained motion do not lift the level
            level = float(np.median(logs))
            error = float(np.mean(np.minimum(np.abs(logs - level), 1.0)))
            if error < best[0] - 1e-9:
                unit = math.exp(level) / (2 * step)
                best = (
                    error,
                    math.sqrt(unit * (share + (1 - share) * (1 - phi) / (1 + phi))),
                )
    return best[1], best[0]


# ------------------------------------------------------------------------------ what is known of it beforehand


@dataclass(frozen=True)
class Floor:
    """Noise of a channel before any model is fitted: its deviation, whether the signal or the owner tells it or only bounds it, and its
    source ('owner', 'spectrum' above the motion, 'bound', or 'input': a motion that is differentiated twice)."""

    deviation: float
    known: bool
    source: str


def floor_of(series: Sequence[Array], step: float, *, white: bool = False) -> Floor:
    """Return the noise of a measured channel (segments (samples,)) above the lowest frequency from which on the spectrum looks like white
    or AR(1) noise; without one, the top of the spectrum is a bound."""
    shortest = min(map(len, series))
    length = min(1024, max(64, shortest // 2), shortest)
    frequency, s, averages = _density(series, step, length)
    top = frequency[-1]
    chance = 0.8 / math.sqrt(
        averages
    )  # mean distance of the logarithm of an averaged periodogram from its law
    ceiling = (0.7 if white else 0.98) * top
    for low in np.geomspace(max(0.02 * top, 3 * frequency[1]), 0.6 * top, 12):
        found, error = _noise_above(frequency, s, step, float(low), ceiling, white)
        if error < 1.35 * chance + 0.03:
            return Floor(found, True, "spectrum")
    found, _ = _noise_above(frequency, s, step, 0.6 * top, ceiling, True)
    return Floor(found, False, "bound")


def resolution(series: Sequence[Array]) -> float:
    """Return the deviation by the resolution of a sensor: its step over the root of twelve."""
    levels = np.unique(np.concatenate(series))
    steps = np.diff(levels)
    steps = steps[steps > 1e-9 * max(float(np.ptp(levels)), 1e-300)]
    return float(np.quantile(steps, 0.1)) / math.sqrt(12.0) if len(steps) else 0.0


def floors_of(problem: Problem) -> list[Floor]:
    """Return the noise of each channel: sensor noise, and noise of a force that is computed from a measured motion."""
    out = []
    for j, propagated in enumerate(propagate_input_noise(problem)):
        floor = _floor_of_sensor(problem, j)
        total = math.hypot(floor.deviation, propagated)
        out.append(
            Floor(total, True, "input")
            if propagated > floor.deviation
            else replace(floor, deviation=total)
        )
    return out


def _floor_of_sensor(problem: Problem, channel: int) -> Floor:
    """Estimate the noise of a sensor."""
    c = problem.network.outputs[channel]
    if c.noise is not None:
        return Floor(c.noise, True, "owner")
    records = [
        problem.records[i]
        for i in dict.fromkeys((*problem.estimation, *problem.choosing))
    ]
    series, first = [r.measured[:, channel] for r in records], records[0]
    seen = floor_of(series, first.interval, white=first.filtered)
    grain = resolution(series) if not first.filtered else 0.0
    return replace(seen, deviation=max(seen.deviation, grain))


def propagate_input_noise(problem: Problem) -> Array:
    """Return the RMS noise (channels,) of forces computed from twice differentiated motions: their change by a second noise of the median
    level."""
    network, noise = problem.network, np.zeros(len(problem.channels))
    pairs = find_computed_forces(network)
    training = problem.estimation
    if not pairs or not training:
        return noise
    names = dict.fromkeys(motion.name for motion, _ in pairs)
    records = list(problem.records)
    levels = {}
    for n in names:
        known = [
            r.input_noise.get(n, estimate_white_noise(r.inputs[n]))
            for r in (records[i] for i in training)
        ]
        levels[n] = float(np.median(known))
    rng = np.random.default_rng(0)
    for i in training:
        records[i] = _with_noise(records[i], levels, rng)
    try:
        initial = {i: guess(problem, network, i)[:, None] for i in training}
        clean = problem.simulate_all([network], training, initial)
        noisy = problem.with_records(records).simulate_all([network], training, initial)
    except BROKEN:
        return noise
    change = np.concatenate([noisy[i] - clean[i] for i in training])[:, :, 0]
    computed = [network.outputs.index(force) for _, force in pairs]
    noise[computed] = np.nan_to_num(
        np.sqrt(np.mean(change[:, computed] ** 2, axis=0)), posinf=0.0
    )
    return noise


def _with_noise(
    record: Record, levels: Mapping[str, float], rng: np.random.Generator
) -> Record:
    """Return a record with white noise of given levels added to its inputs, behind the record's low-pass."""
    inputs, slopes = dict(record.inputs), dict(record.slopes)
    for name, level in levels.items():
        noise = level * rng.standard_normal(record.samples)
        inputs[name] = inputs[name] + (
            noise if record.taps is None else low_pass(noise, record.taps)
        )
        if name in slopes:
            slopes[name] = differences(inputs[name], record.step)
    return replace(record, inputs=inputs, slopes=slopes)
