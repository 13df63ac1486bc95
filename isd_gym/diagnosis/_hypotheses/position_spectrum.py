"""Periods of a force over travel, read off the spectrum of the missing force over the position.

A force that repeats over travel has a line in its spectrum over position, whatever the motion in time. The missing force is
the residual of the outputs divided by the linear response of the model to a force between the two nodes.

References:
    Lomb, N. R. (1976). Least-squares frequency analysis of unequally spaced data. Astrophysics and Space Science 39, 447.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..._common.errors import InputError
from .missing_force import Deconvolution

if TYPE_CHECKING:
    from collections.abc import Sequence

    from ..._common.arrays import Array
    from ...physics.elements import Motion
    from .._estimation.gauss_newton import Fit
    from .._simulation.problem import Problem

LINES = 4  # periods that are returned
RESOLUTION = 0.25  # step of the spectrum, in periods over the whole travel
RESOLVED = 2.5  # samples of a period, at the typical speed, below which the period cannot be seen
MOST_PERIODS = 20_000  # over the travel
ALL = 1e9  # no upper limit of the band but the sampling
BAND = 0.9  # of the thinned records' band that their low-pass keeps
LOST = 0.25  # share of the residual's power beyond the noise that must not be lost
MATERIAL = (
    3.0  # power of the residual beyond the noise, over that of the noise, from which on the question is asked
)


def typical_advance(travels: Sequence[Array]) -> float:
    """Return the median distance between consecutive samples of travels (n,) each, samples at rest left out."""
    way = np.abs(np.concatenate([np.diff(d) for d in travels]))
    moving = way[way > 1e-3 * way.max(initial=0.0)]
    return float(np.median(moving)) if len(moving) else 0.0


def spectral_pitches(
    problem: Problem, fit: Fit, pair: tuple[str, str], motion: Motion, periods: float
) -> tuple[float, ...]:
    """Return at most `LINES` periods [m, or rad] of the missing force over the travel of two nodes, the strongest line first, of those
    that records show and the travel holds more than `periods` times."""
    span = float(np.ptp(motion.d))
    edges = np.cumsum([problem.records[i].samples for i in problem.estimation])[:-1]
    advance = typical_advance(np.split(motion.d, edges))
    if span <= 0 or advance <= 0:
        return ()
    most = min(span / (RESOLVED * advance), MOST_PERIODS)
    if most <= periods:
        return ()
    power = np.zeros(0)
    first = 0
    for i in problem.estimation:
        record = problem.records[i]
        travel = record.seen(motion.d[first : first + record.samples])
        first += record.samples
        if record.reading is not None or len(travel) != len(record):
            continue
        force = _missing_force(problem, fit, i, pair)
        if force is None:
            continue
        lines = _spectrum((travel - motion.d.min()) / span, force, most)
        power = lines if not len(power) else power + lines
    return tuple(span / p for p in _strongest(power, periods))


def _missing_force(problem: Problem, fit: Fit, index: int, pair: tuple[str, str]) -> Array | None:
    """Return the force [N] (n,) that the residual of a record shows; None for a model without a linear response."""
    record, names = problem.records[index], problem.channels
    residual = record.measured - fit.outputs[index]
    signals = {n: record.measured[:, j] for j, n in enumerate(names)}
    left = {n: residual[:, j] for j, n in enumerate(names)}
    try:
        response = Deconvolution.of(fit.network, pair, record.time, signals, highest=ALL)
        force, _ = response.force(left, {n: float(np.std(r)) for n, r in left.items()})
    except (InputError, ValueError, np.linalg.LinAlgError):
        return None
    return force if np.isfinite(force).all() else None


def _spectrum(position: Array, force: Array, most: float) -> Array:
    """Compute the power spectrum of a force over a position from 0 to 1, at multiples of `RESOLUTION` up to `most` periods."""
    cells = int(8 * most) + 1
    place = np.minimum((position * cells).astype(int), cells - 1)
    profile = np.bincount(place, force - force.mean(), cells)
    padded = np.zeros(int(cells / RESOLUTION))
    padded[:cells] = profile
    lines = np.abs(np.fft.rfft(padded)[: int(most / RESOLUTION) + 1]) ** 2
    return np.asarray(lines / max(float(np.sum((force - force.mean()) ** 2)), 1e-300), dtype=np.float64)


def _strongest(power: Array, periods: float) -> list[float]:
    """Return the numbers of periods of the strongest lines of a spectrum that are not beside a stronger one."""
    found: list[float] = []
    left = power.copy()
    left[: int(periods / RESOLUTION) + 1] = 0.0
    apart = int(2 / RESOLUTION)
    while len(found) < LINES and len(left) and left.max() > 0.0:
        k = int(np.argmax(left))
        found.append(k * RESOLUTION)
        left[max(k - apart, 0) : k + apart + 1] = 0.0
    return found


def thinning_loses(problem: Problem, fit: Fit, floors: Array) -> bool:
    """Return whether thinned records lack a quarter of the residual's power beyond the noise in any output, such as a force that repeats
    over travel."""
    lost, power, rows = np.zeros(len(floors)), np.zeros(len(floors)), 0
    for i in problem.estimation:
        record, thin = problem.records[i], problem.rough.records[i]
        residual = record.measured - fit.outputs[i]
        residual = residual - residual.mean(axis=0)
        lines = np.abs(np.fft.rfft(residual, axis=0)) ** 2
        lines[1:] *= 2.0
        beyond = np.fft.rfftfreq(len(residual), record.interval) > 0.5 * BAND / thin.interval
        lost += lines[beyond].sum(axis=0) / len(residual) - beyond.mean() * len(residual) * floors**2
        power += np.sum(residual**2, axis=0) - len(residual) * floors**2
        rows += len(residual)
    material = power > MATERIAL * rows * floors**2
    return bool(np.any(material & (lost > LOST * power)))
