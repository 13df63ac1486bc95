"""Noise of a force that a model computes from a measured motion by differentiating the motion twice.

The noise of an encoder is small beside the motion and large beside the acceleration. A force that inertia makes of this noise is noise
of the computed force, and no missing effect.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from .._records import estimate_white_noise, find_computed_forces
from .._simulation.interpolation import differences
from .._simulation.problem import BROKEN, low_pass
from .initial_states import guess

if TYPE_CHECKING:
    from collections.abc import Mapping

    from ..._common.arrays import Array
    from .._simulation.problem import Problem, Record


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
    levels = {n: float(np.median([_white_noise(records[i], n) for i in training])) for n in names}
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


def _white_noise(record: Record, name: str) -> float:
    """Return the RMS white noise of an input before any low-pass [SI unit of the input]."""
    known = record.input_noise.get(name)
    return estimate_white_noise(record.inputs[name]) if known is None else known


def _with_noise(record: Record, levels: Mapping[str, float], rng: np.random.Generator) -> Record:
    """Return a record with white noise of given levels added to its inputs, behind the record's low-pass."""
    inputs, slopes = dict(record.inputs), dict(record.slopes)
    for name, level in levels.items():
        noise = level * rng.standard_normal(record.samples)
        inputs[name] = inputs[name] + (noise if record.taps is None else low_pass(noise, record.taps))
        if name in slopes:
            slopes[name] = differences(inputs[name], record.step)
    return replace(record, inputs=inputs, slopes=slopes)
