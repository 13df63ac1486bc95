"""Random generators of episodes: one for each seed, and a separate stream for the roads of the score.

Everybody's ``reset(seed=0)`` draws the road of seed 0. Scores on such roads would be scores on training roads.
The roads of the score therefore come from a stream that no seed reaches.
"""

from __future__ import annotations

import numpy as np

from .errors import InputError, shown

#: key of the stream of scoring roads among the children of a seed (`numpy.random.SeedSequence`)
_SCORING = 0x15D


def scoring_generator(index: int) -> np.random.Generator:
    """Return the generator of a scoring road; no seed of ``reset(seed=)`` gives the same draws."""
    return np.random.Generator(
        np.random.PCG64(np.random.SeedSequence(index, spawn_key=(_SCORING,)))
    )


def generators(seed: int | None, first: int, count: int) -> list[np.random.Generator]:
    """Return the generators of consecutive episodes."""
    from gymnasium.utils import seeding

    if seed is None:
        return [scoring_generator(first + i) for i in range(count)]
    return [seeding.np_random(seed + first + i)[0] for i in range(count)]


def named_roads(seed: int | None, episodes: int) -> str:
    """Return the name of the roads of a score."""
    what, first = ("scoring roads", 0) if seed is None else ("seeds", seed)
    return f"{what} {first} to {first + episodes - 1}"


def road_name(seed: int | None, index: int) -> str:
    """Return the name of one road of a score."""
    return f"scoring road {index}" if seed is None else f"seed {seed + index}"


def road_index(given: object, name: str) -> int:
    """Return a checked index of a road."""
    if isinstance(given, bool) or not isinstance(given, int | np.integer) or given < 0:
        raise InputError(f"{name} must be a whole number >= 0, not {shown(given)}")
    return int(given)
