"""Initial states from positions and velocities of nodes at the first sample."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from ..._common.errors import InputError, shown
from ...physics.network import Network, assemble

if TYPE_CHECKING:
    from collections.abc import Mapping

MOTION = ("displacement", "velocity")
LOOSE = 1e-6  # weight of "at rest" for nodes without a given motion


def state_of(
    network: Network, motions: Mapping[str, Mapping[str, float]], inputs: Mapping[str, Any], step: float
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
            why = "is moved by an input" if node in network.moved_nodes else "is no node of the model"
            raise InputError(f"--initial: {shown(node)} {why} (free are {', '.join(free)})")
    told = np.array([motions.get(node, {}).get(key, math.nan) for key in MOTION for node in free])
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
    lead = [np.asarray(inputs[c.name], float) for c in network.inputs if c.quantity == "displacement"]
    given = np.zeros(len(rows))
    if len(lead) == r.stop - r.start:
        given = rows[:, r] @ [u[0] for u in lead] + rows[:, v] @ [(u[1] - u[0]) / step for u in lead]
    return free, rows[:, x], np.asarray(given, dtype=np.float64)
