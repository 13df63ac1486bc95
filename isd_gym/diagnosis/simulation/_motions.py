"""Motions of nodes at the first sample: the values of ``--initial``, their state, and the motions in a state."""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..._common.errors import InputError, shown
from ..._common.inputs import number, read_json
from ...physics.network import assemble

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from ...physics.network import Network

MOTION = ("displacement", "velocity")
LOOSE = 1e-6  # weight of "at rest" for nodes without a given motion


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
            if not isinstance(data, dict) or not all(
                isinstance(v, dict) for v in data.values()
            ):
                raise InputError(
                    f"{word}: must be an object {{node: {{displacement, velocity}}}}"
                )
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


def _put(
    out: dict[str, dict[str, float]], node: str, key: str, value: float, word: str
) -> None:
    if key not in MOTION:
        raise InputError(
            f"--initial {word}: no {shown(key)} of a node (there are {', '.join(MOTION)})"
        )
    out.setdefault(node, {})[key] = value


def state_of(
    network: Network,
    motions: Mapping[str, Mapping[str, float]],
    inputs: Mapping[str, Any],
    step: float,
) -> np.ndarray:
    """Return the state in which nodes have given motions and all other nodes rest.

    Args:
        network: The model.
        motions: Displacement [m] and velocity [m/s] by node.
        inputs: Inputs of the simulation [SI] by channel; the first samples move nodes.
        step: Sampling step of the inputs [s].

    Returns:
        State (n,) in the coordinates of the assembly.

    Raises:
        InputError: A node does not exist or is moved by an input, or no state has these motions.
    """
    free, rows, given = free_motions(network, inputs, step)
    for node in motions:
        if node not in free:
            why = (
                "is moved by an input"
                if node in network.moved_nodes
                else "is no node of the model"
            )
            raise InputError(
                f"--initial: {shown(node)} {why} (free are {', '.join(free)})"
            )
    told = np.array(
        [motions.get(node, {}).get(key, math.nan) for key in MOTION for node in free]
    )
    known = ~np.isnan(told)
    b, w = np.where(known, told, 0.0) - given, np.where(known, 1.0, LOOSE)
    state = np.linalg.lstsq(rows * w[:, None], b * w, rcond=None)[0]
    off = np.abs(rows @ state - b)[known]
    size = max(float(np.abs(b[known]).max(initial=0.0)), 1e-12)
    if off.max(initial=0.0) > 1e-3 * size:
        raise InputError(
            "--initial: no state of the model has these motions (a node without mass follows its neighbours)"
        )
    return np.asarray(state, dtype=np.float64)


def free_motions(
    network: Network, inputs: Mapping[str, Any], step: float
) -> tuple[list[str], np.ndarray, np.ndarray]:
    """Return the free nodes, their displacements and velocities as rows (2 nodes, n) over the state, and the
    contribution of the inputs."""
    asm = assemble(network)
    free = [n for n in asm.network.nodes if n not in asm.network.moved_nodes]
    x, r, v = (asm.columns(part) for part in ("x", "r", "v"))
    rows = np.vstack([asm.position[: len(free)], asm.velocity[: len(free)]])
    lead = [
        np.asarray(inputs[c.name], float)
        for c in network.inputs
        if c.quantity == "displacement"
    ]
    given = np.zeros(len(rows))
    if len(lead) == r.stop - r.start:
        given = rows[:, r] @ [u[0] for u in lead] + rows[:, v] @ [
            (u[1] - u[0]) / step for u in lead
        ]
    return free, rows[:, x], np.asarray(given, dtype=np.float64)


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
