"""Motions of nodes at the first sample: the values of ``--initial``, their state, and the motions in a state."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from ..._common.errors import InputError, shown
from ...physics.network import assemble

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from ...physics.network import Network

MOTION = ("displacement", "velocity")
LOOSE = 1e-6  # weight of "at rest" for nodes without a given motion


def motions_of(words: Sequence[str]) -> dict[str, dict[str, float]]:
    """Return the motions that ``--initial`` names: displacement [m] and velocity [m/s] by node.

    Words are ``NODE=VALUE`` [m] or ``NODE.velocity=VALUE`` [m/s].
    """
    out: dict[str, dict[str, float]] = {}
    for word in words:
        name, _, value = word.partition("=")
        node, _, key = name.rpartition(".")
        if not node or key not in MOTION:
            node, key = name, "displacement"
        try:
            x = float(value)
        except ValueError:
            x = math.nan
        if not math.isfinite(x):
            raise InputError(
                f"--initial {shown(word)}: give NODE=VALUE or NODE.velocity=VALUE (SI units), or fit"
            )
        out.setdefault(node, {})[key] = x
    return out


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
    told = [motions.get(n, {}).get(key, math.nan) for key in MOTION for n in free]
    known = ~np.isnan(told)
    weight = np.where(known, 1.0, LOOSE)
    target = np.where(known, told, 0.0) - given
    state = np.linalg.lstsq(rows * weight[:, None], target * weight, rcond=None)[0]
    off = np.abs(rows @ state - target)[known]
    size = np.abs(target[known]).max(initial=1e-12)
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
    kinds = [c.name for c in network.inputs if c.quantity == "displacement"]
    first = np.array([np.asarray(inputs[n], float)[:2] for n in kinds])
    given = np.zeros(len(rows))
    if len(kinds) == r.stop - r.start > 0:
        speed = (first[:, 1] - first[:, 0]) / step
        given = rows[:, r] @ first[:, 0] + rows[:, v] @ speed
    return free, rows[:, x], given


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
