"""Noise: estimates from the signal, filters that whiten residuals, and the likelihood under coloured noise."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.signal import welch

from ...physics._kernel.jit import compiled
from .._records.filtering import estimate_white_noise, find_computed_forces
from .._simulation.interpolation import differences
from .._simulation.problem import BROKEN, low_pass
from .initial_states import guess

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from ..._common.arrays import Array
    from .._simulation.problem import Problem, Record


#: order of the autoregressive filters
ORDER = 20
#: values that a filter handles at a time
IN_CACHE = 1024


@dataclass(frozen=True)
class Whitener:
    """Autoregressive filters that turn the residuals of each channel into innovations of unit variance."""

    taps: tuple[Array, ...]

    def __call__(self, residual: Array) -> Array:
        """Return residuals (samples, channels, ...), whitened along time."""
        wide = residual.reshape(*residual.shape[:2], -1)
        out = np.empty(wide.shape)
        for j, a in enumerate(self.taps):
            rows = np.ascontiguousarray(wide[:, j])
            out[:, j] = _filter(a, rows.ravel(), rows.shape[1]).reshape(rows.shape)
        return out.reshape(residual.shape)


@compiled(nogil=True)
def _filter(taps: Array, x: Array, width: int) -> Array:
    """Return y[t] = sum over k of taps[k] x[t - k] for rows of `width` values, one row after the other (rows * width,)."""
    out = taps[0] * x
    for begin in range(0, len(x), IN_CACHE):
        end = min(begin + IN_CACHE, len(x))
        for k in range(1, len(taps)):
            first = max(begin, k * width)
            if first < end:  # slices, so that the loop over them is compiled to vector instructions
                y, late = out[first:end], x[first - k * width : end - k * width]
                for i in range(len(y)):
                    y[i] += taps[k] * late[i]
    return out


def lagged(series: Sequence[Array], order: int) -> tuple[Array, Array, float, int]:
    """Return the Gram matrix of the lags (order, order), their products with the present (order,), its power, and the number of samples."""
    gram: Array = np.zeros((order, order))
    rhs: Array = np.zeros(order)
    count, total = 0, 0.0
    for x in series:
        lags = np.lib.stride_tricks.sliding_window_view(x, order + 1)[:, ::-1]
        gram += lags[:, 1:].T @ lags[:, 1:]
        rhs += lags[:, 1:].T @ lags[:, 0]
        total += float(lags[:, 0] @ lags[:, 0])
        count += len(lags)
    return gram, rhs, total, count


def predicted(gram: Array, rhs: Array, total: float, count: int, least: float) -> tuple[Array, float]:
    """Return least-squares AR taps (1, -a1, ...) and the innovation deviation from the moments of `lagged`, with white noise of deviation
    `least` added: a limit of the weight of quiet bands."""
    order = len(rhs)
    total += count * least**2
    gram = gram + count * least**2 * np.eye(order)
    ridge = 1e-9 * float(np.trace(gram)) / order + 1e-300
    a = np.linalg.solve(gram + ridge * np.eye(order), rhs)
    variance = max(float(total - 2 * a @ rhs + a @ gram @ a), 1e-300) / max(count, 1)
    return np.concatenate([[1.0], -a]), math.sqrt(variance)


def channel_moments(residuals: Sequence[Array]) -> list[tuple[Array, Array, float, int]]:
    """Return the moments (`lagged`) of each channel of residuals [(samples, channels), ...] about the means of the records."""
    order = min(ORDER, min(map(len, residuals)) // 8)
    every = range(residuals[0].shape[1])
    return [lagged([r[:, j] - r[:, j].mean() for r in residuals], order) for j in every]


def whitener(residuals: Sequence[Array], floor: Array) -> Whitener:
    """Return filters that whiten residuals [(samples, channels), ...], with white noise `floor` (channels,) added."""
    found = [predicted(*m, float(s)) for m, s in zip(channel_moments(residuals), floor, strict=True)]
    return Whitener(tuple(a / max(sigma, 1e-300) for a, sigma in found))


def innovations(residuals: Sequence[Array], floor: Array) -> float:
    """Return -2 log L of residuals under coloured noise: the sum over channels of n log(innovation variance)."""
    total, samples = 0.0, sum(map(len, residuals))
    for moments, least in zip(channel_moments(residuals), floor, strict=True):
        _, sigma = predicted(*moments, float(least))
        total += 2 * samples * math.log(max(sigma, 1e-300))
    return total


def noise_of(series: Sequence[Array], step: float, *, time: float, white: bool = False) -> Noise:
    """Return white plus AR(1) noise of residuals (samples,), at most the series, from the spectrum above three frequencies of a motion
    that changes in `time` [s]; `white`: behind a low-pass, which leaves a level but no colour."""
    length = min(1024, min(len(x) for x in series))
    frequency, s, _ = _density(series, step, length)
    top = frequency[-1]
    low = max(min(3.0 / (2 * math.pi * time), 0.3 * top), 2 * float(frequency[1]))
    noise, _ = _noise_above(frequency, s, step, low, (0.7 if white else 0.98) * top, white)
    share = min(1.0, float(np.var(np.concatenate(series))) / max(noise.deviation**2, 1e-300))
    return Noise(noise.white * share, noise.drive * share, noise.phi)


def _density(series: Sequence[Array], step: float, length: int) -> tuple[Array, Array, float]:
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
) -> tuple[Noise, float]:
    """Fit white plus AR(1) noise to a spectrum between two frequencies [Hz]; return the noise and the mean log distance."""
    w = 2 * np.pi * frequency * step
    pick = (frequency > low) & (frequency < high)
    if np.sum(pick) < 4:
        pick = frequency > 0.5 * frequency[-1]
    best: tuple[float, Noise] = (math.inf, Noise(0.0, 0.0, 0.0))
    for phi in (0.0,) if white else (0.0, 0.3, 0.5, 0.6, 0.7, 0.8, 0.87, 0.93):
        shape = 1.0 / (1 + phi**2 - 2 * phi * np.cos(w[pick]))
        for share in (1.0,) if phi == 0 else (0.0, 0.02, 0.05, 0.1, 0.2, 0.35, 0.5, 0.7, 0.9):
            model = share + (1 - share) * shape * (1 - phi) ** 2
            logs = np.log(s[pick] / model)
            # a median: peaks of unexplained motion do not lift the level
            level = float(np.median(logs))
            error = float(np.mean(np.minimum(np.abs(logs - level), 1.0)))
            if error < best[0] - 1e-9:
                unit = math.exp(level) / (2 * step)
                best = error, Noise(unit * share, unit * (1 - share) * (1 - phi) ** 2, phi)
    return best[1], best[0]


@dataclass(frozen=True)
class Noise:
    """White noise and AR(1) noise together: `white` variance, innovation variance `drive`, coefficient `phi`."""

    white: float
    drive: float
    phi: float

    @property
    def deviation(self) -> float:
        return math.sqrt(self.white + self.drive / (1 - self.phi**2))

    def density(self, w: Array) -> Array:
        return self.white + self.drive / (1 + self.phi**2 - 2 * self.phi * np.cos(w))


def noise_after_filters(W: Whitener, noise: Sequence[Noise]) -> Array:
    """Return the mean square of pure noise after the filters (channels,)."""
    w = np.linspace(0, math.pi, 2048)
    out = []
    for a, n in zip(W.taps, noise, strict=True):
        response = np.abs(np.exp(-1j * np.outer(w, np.arange(len(a)))) @ a) ** 2
        out.append(float(np.mean(response * n.density(w))))
    return np.array(out)


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
            return Floor(found.deviation, True, "spectrum")
    found, _ = _noise_above(frequency, s, step, 0.6 * top, ceiling, True)
    return Floor(found.deviation, False, "bound")


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
            Floor(total, True, "input") if propagated > floor.deviation else replace(floor, deviation=total)
        )
    return out


def _floor_of_sensor(problem: Problem, channel: int) -> Floor:
    """Estimate the noise of a sensor."""
    c = problem.network.outputs[channel]
    if c.noise is not None:
        return Floor(c.noise, True, "owner")
    records = [problem.records[i] for i in dict.fromkeys((*problem.estimation, *problem.choosing))]
    series, first = [r.measured[:, channel] for r in records], records[0]
    seen = floor_of(series, first.interval, white=first.filtered)
    grain = resolution(series) if not first.filtered else 0.0
    return replace(seen, deviation=max(seen.deviation, grain))


def white_filters(floors: Array) -> Whitener:
    """Return filters for white noise of given deviations (channels,)."""
    return Whitener(tuple(np.array([1 / max(h, 1e-300)]) for h in floors))


def trusted_noise(residuals: Sequence[Array], floors: Array) -> Array:
    """Return the white noise of weights (channels,): that of the measurement, or missing physics as ten times its power, so that a
    crowded tenth of the band keeps its weight."""
    square = np.mean(np.concatenate(residuals) ** 2, axis=0)
    return np.asarray(np.sqrt(np.maximum(floors**2, 10.0 * (square - floors**2))), dtype=np.float64)


def refined_noise(least: Array, floors: Array) -> Array:
    """Return the white noise for comparing fits (channels,): a tenth of the noise of their weights."""
    return np.asarray(np.maximum(floors, 0.1 * least), dtype=np.float64)


def propagate_input_noise(problem: Problem) -> Array:
    """Return the RMS noise (channels,) of forces computed from twice differentiated motions: their change by a second noise of the median
    level."""
    network, noise = problem.network, np.zeros(len(problem.channels))
    pairs = find_computed_forces(network)
    training = [i for i in problem.estimation if problem.records[i].reading is None]
    if not pairs or not training:
        return noise
    names = dict.fromkeys(motion.name for motion, _ in pairs)
    records = list(problem.records)
    levels = {}
    for n in names:
        known = [
            r.input_noise.get(n, estimate_white_noise(r.inputs[n])) for r in (records[i] for i in training)
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
    noise[computed] = np.nan_to_num(np.sqrt(np.mean(change[:, computed] ** 2, axis=0)), posinf=0.0)
    return noise


def _with_noise(record: Record, levels: Mapping[str, float], rng: np.random.Generator) -> Record:
    """Return a record with white noise of given levels added to its inputs, behind the record's low-pass."""
    inputs, slopes = dict(record.inputs), dict(record.slopes)
    for name, level in levels.items():
        noise = level * rng.standard_normal(record.samples)
        inputs[name] = inputs[name] + (noise if record.taps is None else low_pass(noise, record.taps))
        if name in slopes:
            slopes[name] = differences(inputs[name], record.step)
    return replace(record, inputs=inputs, slopes=slopes)
