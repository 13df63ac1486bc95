"""Motions of nodes at the first sample: the values of ``--initial``, and the motions in a state."""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from isd_gym._common.errors import InputError, shown
from isd_gym._common.inputs import number, read_json
from isd_gym.records._loggers.start import MOTION, free_motions

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from isd_gym.physics.network import Network


def motions_of(words: Sequence[str]) -> dict[str, dict[str, float]]:
    """Return the motions that ``--initial`` names: displacement [m] and velocity [m/s] by node.

    Words are ``NODE=VALUE`` [m], ``NODE.velocity=VALUE`` [m/s], or a JSON file {node: {displacement, velocity}}.
    """
    out: dict[str, dict[str, float]] = {}
    for word in words:
        name, joined, value = word.partition("=")
        if not joined:
            if not os.path.exists(word) and "." not in word:  # a node without a value
                raise InputError(
                    f"--initial {shown(word)}: give NODE=VALUE or NODE.velocity=VALUE (SI units), a file, or fit"
                )
            data = read_json(Path(word))
            if not isinstance(data, dict) or not all(isinstance(v, dict) for v in data.values()):
                raise InputError(f"{word}: must be an object {{node: {{displacement, velocity}}}}")
            for node, motion in data.items():
                for key, x in motion.items():
                    _put(out, node, key, number(x, f"{word}: {shown(node)}"), word)
            continue
        node, dot, key = name.rpartition(".")
        if not dot or key not in MOTION:
            node, key = name, "displacement"
        try:
            x = float(value)
        except ValueError:
            x = math.nan
        if not math.isfinite(x):
            raise InputError(
                f"--initial {word}: give NODE=VALUE or NODE.velocity=VALUE in SI units, or a file"
            )
        _put(out, node, key, x, word)
    return out


def _put(out: dict[str, dict[str, float]], node: str, key: str, value: float, word: str) -> None:
    if key not in MOTION:
        raise InputError(f"--initial {word}: no {shown(key)} of a node (there are {', '.join(MOTION)})")
    out.setdefault(node, {})[key] = value


def motions_at(
    network: Network, state: np.ndarray, inputs: Mapping[str, Any], step: float
) -> dict[str, dict[str, float]]:
    """Return displacement [m] and velocity [m/s] of the nodes in a state (n,): the inverse of `state_of`."""
    free, rows, given = free_motions(network, inputs, step)
    displacement, velocity = np.split(rows @ state + given, 2)
    return {
        n: dict(zip(MOTION, map(float, pair), strict=True))
        for n, *pair in zip(free, displacement, velocity, strict=True)
    }
