"""An initial state from how the nodes stand and move at the first sample."""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import InputError, shown
from ..inputs import number, read_json
from ..network import Network, assemble

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

MOTION = ("displacement", "velocity")
LOOSE = 1e-6  # weight of "at rest" where nothing is told of a node


def motions_of(words: Sequence[str]) -> dict[str, dict[str, float]]:
    """What ``--initial`` was given: ``NODE=VALUE``, ``NODE.velocity=VALUE``, or a JSON file {node: {displacement, velocity}}, in SI."""
    out: dict[str, dict[str, float]] = {}
    for word in words:
        name, joined, value = word.partition("=")
        if not joined:
            if not os.path.exists(word) and "." not in word:  # a node, and its value forgotten
                raise InputError(
                    f"--initial {shown(word)}: wants NODE=VALUE, NODE.velocity=VALUE (SI), a file, or fit"
                )
            data = read_json(Path(word))
            if not isinstance(data, dict) or not all(isinstance(v, dict) for v in data.values()):
                raise InputError(f"{word}: wants {{node: {{displacement, velocity}}}}")
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
            raise InputError(f"--initial {word}: wants NODE=VALUE or NODE.velocity=VALUE in SI, or a file")
        _put(out, node, key, x, word)
    return out


def _put(out: dict[str, dict[str, float]], node: str, key: str, value: float, word: str) -> None:
    if key not in MOTION:
        raise InputError(f"--initial {word}: no {shown(key)} of a node (there are {', '.join(MOTION)})")
    out.setdefault(node, {})[key] = value


def state_of(
    network: Network, motions: Mapping[str, Mapping[str, float]], inputs: Mapping[str, Any], step: float
) -> np.ndarray:
    """The state (n,) in the assembly's coordinates in which nodes stand [m] and move [m/s] as told, all others rest.

    inputs: of the simulation, by channel in SI, `step` [s] between their samples: what moves nodes at the first one. Raises
    `InputError` for a node that the model lacks or that an input moves, and for motions that no state of it has.
    """
    free, rows, given = _motion(network, inputs, step)
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


def motions_at(
    network: Network, state: np.ndarray, inputs: Mapping[str, Any], step: float
) -> dict[str, dict[str, float]]:
    """How the nodes stand [m] and move [m/s] in a state (n,): what `state_of` takes.

    inputs, step: as there.
    """
    free, rows, given = _motion(network, inputs, step)
    displacement, velocity = np.split(rows @ state + given, 2)
    return {
        n: dict(zip(MOTION, map(float, pair), strict=True))
        for n, *pair in zip(free, displacement, velocity, strict=True)
    }


def _motion(
    network: Network, inputs: Mapping[str, Any], step: float
) -> tuple[list[str], np.ndarray, np.ndarray]:
    """(free nodes, their displacements and velocities as rows (2 nodes, n) over the state, and what the inputs add at first)."""
    asm = assemble(network)
    free = [n for n in asm.network.nodes if n not in asm.network.moved_nodes]
    x, r, v = (asm.columns(part) for part in ("x", "r", "v"))
    rows = np.vstack([asm.position[: len(free)], asm.velocity[: len(free)]])
    lead = [np.asarray(inputs[c.name], float) for c in network.inputs if c.quantity == "displacement"]
    given = np.zeros(len(rows))
    if len(lead) == r.stop - r.start:
        given = rows[:, r] @ [u[0] for u in lead] + rows[:, v] @ [(u[1] - u[0]) / step for u in lead]
    return free, rows[:, x], np.asarray(given, dtype=np.float64)
