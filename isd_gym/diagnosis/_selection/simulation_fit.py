"""Last fit of a diagnosis: the completed model, for the smallest error of its simulation over all training data.

The search fits a part of the data and holds out the rest. The last fit takes all of the data that the user gave for training, held-out
parts included, and minimises the error of the simulation (output-error fit; Ljung, System Identification, section 7.2). No verdict and
no reported held-out error depends on the last fit.

The error is that of a free run: the first samples of a record give its initial state, and the simulation gets no other measurement.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from ..._common.arrays import channel_rms
from ...physics.network import assemble
from .._estimation.gauss_newton import Fitter
from .._estimation.least_squares import bounded_step, damped_step
from .._estimation.noise import white_weights
from .._simulation.problem import BROKEN, bare
from ..result import SimulationFit

if TYPE_CHECKING:
    from collections.abc import Sequence

    from ..._common.arrays import Array
    from .._estimation.structure import Structure
    from .._simulation.problem import Problem
    from .candidate import Candidate
    from .held_out import HeldOutEvaluator

#: share by which the mean square error of the free runs must fall
LEAST_GAIN = 0.1
#: error of the free runs, as a share of the deviation, above which the motion is lost: a fit would trade phase for amplitude
LOST = 0.2
#: largest number of Gauss-Newton steps; tries of each; relative decrease of the cost that ends the fit
ITERATIONS, TRIES, TOLERANCE = 15, 6, 1e-3


def fit_simulation_error(
    evaluator: HeldOutEvaluator, candidate: Candidate, held_from: Sequence[float]
) -> tuple[Structure, Array, SimulationFit] | None:
    """Fit a candidate to all training data for the smallest error of its free runs: structure, parameters (transformed) and errors; None
    where the error falls too little over all data or rises from `held_from` [s] on, or where the motion is lost."""
    whole, old = evaluator.whole, candidate.fit
    if whole is None or not old.structure.free or any(r.clocks for r in whole.records):
        return None
    data, others = whole.estimation, whole.held
    try:
        before = run_freely(whole, old.structure, old.x, evaluator.least_noise)
        deviation = whole.deviation(data)
        noise = np.maximum(channel_rms([before[i] for i in data]), evaluator.least_noise)
        if not float(np.mean(noise / deviation)) < LOST:
            return None
        structure, x = _minimise(whole, old.structure, old.x, noise, evaluator.least_noise)
        after = run_freely(whole, structure, x, evaluator.least_noise)
    except BROKEN:
        return None
    held = [whole.records[i].time >= held_from[i] for i in range(len(whole.records))]
    everything = {i: np.ones(len(whole.records[i]), bool) for i in data}
    pieces = {"data": everything, "held_out": {i: held[i] for i in others or data}}
    error = {}
    for name, places in pieces.items():
        rows = [channel_rms([e[i][place] for i, place in places.items()]) for e in (before, after)]
        gain = 1.0 - float(np.mean((rows[1] / np.maximum(rows[0], 1e-300)) ** 2))
        if not gain >= (LEAST_GAIN if name == "data" else 0.0):
            return None
        error[name] = {
            stage: {c: float(v) for c, v in zip(whole.channels, row / deviation, strict=True)}
            for stage, row in zip(("before", "after"), rows, strict=True)
        }
    fit = replace(old, structure=structure, x=x)
    if candidate.well_formed() and not replace(candidate, fit=fit).well_formed():
        return None
    values = {f.path: f.back(float(v)) for f, v in zip(structure.free, x, strict=True)}
    return structure, x, SimulationFit(values, error["data"], error["held_out"])


def _minimise(
    whole: Problem, structure: Structure, x: Array, noise: Array, least: Array
) -> tuple[Structure, Array]:
    """Minimise the squared free-run errors of the training data over the noise (channels,), with the stated uncertainty as prior."""
    own = np.flatnonzero(whole.shared_offset)
    free, p, q = structure.free, len(x), len(own)
    mean, sigma, none = structure.mean, structure.sigma, np.full(q, math.inf)
    low, high = np.append([f.low for f in free], -none), np.append([f.high for f in free], none)
    steps = np.append([f.step(v) for f, v in zip(free, x, strict=True)], 0.1 * noise[own])

    def at(z: Array) -> Structure:
        if not q:
            return structure
        offsets = np.array(structure.offsets)
        offsets[own] = z[p:]
        return replace(structure, offsets=tuple(offsets.tolist()))

    def left(z: Array) -> Array:
        e = run_freely(whole, at(z), z[:p], least, whole.estimation)
        parts = [np.ravel(e[i] / noise) for i in whole.estimation]
        return np.concatenate([*parts, (z[:p] - mean) / sigma])

    def take(damping: float) -> tuple[tuple[Array, Array] | None, float]:
        step = bounded_step(slopes.T @ slopes, -slopes.T @ now, z, low, high, stride, damping)
        try:
            then = left(z + step)
        except BROKEN:
            return None, math.inf
        return (z + step, then), float(then @ then)

    z = np.append(x, np.array(structure.offsets)[own] if q else [])
    now, damping = left(z), 1e-3
    cost = float(now @ now)
    for turn in range(ITERATIONS):
        # a step at a limit goes inwards
        signed = np.where(z + steps > high, -steps, steps)
        columns = [(left(z + h * e) - now) / h for h, e in zip(signed, np.eye(p + q), strict=True)]
        slopes = np.stack(columns, axis=1)
        ahead = float(np.sum((np.linalg.qr(slopes)[0].T @ now) ** 2))
        if turn == 0 and ahead < 0.5 * LEAST_GAIN * cost:  # to first order, the error cannot fall by enough
            break
        own_stride = [
            min(f.stride, 1.5 if f.log else 3.0 * max(abs(v), f.sigma))
            for f, v in zip(free, z[:p], strict=True)
        ]
        stride = np.append(own_stride, none)
        before = cost
        found, cost, damping = damped_step(take, before, damping, tries=TRIES)
        if found is None:
            break
        z, now = found
        if cost > (1.0 - TOLERANCE) * before:
            break
    return at(z), z[:p]


def run_freely(
    problem: Problem, structure: Structure, x: Array, noise: Array, records: Sequence[int] | None = None
) -> dict[int, Array]:
    """Return the residuals (samples, channels) of records, simulated from the initial states that their first samples give."""
    network = structure.at(x)
    every = list(range(len(problem.records))) if records is None else list(records)
    begun = None
    if assemble(bare(network)).size[0]:
        initial = (
            Fitter(problem.heads, white_weights(noise)).follow(structure, x, every, iterations=8).initial
        )
        begun = {i: initial[i][:, None] for i in every}
    outputs = problem.simulate_all([network], every, begun)
    residuals = {}
    for i, y in outputs.items():
        offset = problem.nothing(i, structure.offsets)
        e = problem.records[i].measured - problem.shifted(i, y[:, :, 0], offset)
        residuals[i] = e - np.where(problem.record_offset, e.mean(axis=0), 0.0)
    return residuals
