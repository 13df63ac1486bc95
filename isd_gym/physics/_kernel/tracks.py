"""Rough road of a left and a right track, drawn ahead with the numbers that a control step draws step by step."""

from __future__ import annotations

import numpy as np

from .cars import road_noise
from .jit import compiled


@compiled(error_model="numpy")
def track_noise(seed_sum, seed_difference, poles, gains, split, states, out):
    """Fill `out` with the rough road of two tracks, continuing from the counters and the states of its sections.

    Args:
        seed_sum: Counter of the noise that drives the sum, uint64.
        seed_difference: Counter of the noise that drives the difference, uint64.
        poles: Discrete poles of the sections (n,), as `isd_gym.physics.tracks.track_filters` returns them.
        gains: Gains of the sections [m] (n,).
        split: Number of sections of the sum; the others belong to the difference.
        states: States of the sections [m] (n,), continued in place.
        out: Heights of the left and the right track [m] (2, count), filled.
    """
    count = out.shape[1]
    seed_sum = road_noise(seed_sum, 1.0, 0.0, 0.0, out[0])  # unit variance, replaced by heights below
    seed_difference = road_noise(seed_difference, 1.0, 0.0, 0.0, out[1])
    for k in range(count):
        for i in range(split):
            states[i] = poles[i] * states[i] + gains[i] * out[0, k]
        for i in range(split, poles.shape[0]):
            states[i] = poles[i] * states[i] + gains[i] * out[1, k]
        half_sum, half_difference = states[0], states[split]
        for i in range(1, split):
            half_sum += states[i]
        for i in range(split + 1, poles.shape[0]):
            half_difference += states[i]
        out[0, k] = half_sum + half_difference
        out[1, k] = half_sum - half_difference
    return np.uint64(seed_sum), np.uint64(seed_difference)
