"""Rough road of a left and a right track, drawn ahead with the numbers that a control step draws step by step."""

from __future__ import annotations

import numpy as np

from ..._common.jit import compiled
from .cars import road_noise


@compiled(error_model="numpy")
def track_noise(seed_sum, seed_difference, poles, gains, split, states, out):
    """Fill `out` (2, count) with the heights [m] of the left and the right track, and return the next counters (uint64) of the noise
    of their sum and difference.

    `poles` and `gains` (n,) are those of `isd_gym.physics.tracks.track_filters`. The first `split` sections belong to the sum; their
    `states` (n,) [m] are continued in place.
    """
    count = out.shape[1]
    seed_sum = road_noise(
        seed_sum, 1.0, 0.0, 0.0, out[0]
    )  # unit variance, replaced by heights below
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
