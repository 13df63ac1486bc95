"""An initial state from how the nodes stand and move at the first sample."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import InputError, shown
from ..inputs import number, read_json
from ..network import Network, assemble

MOTION = ("displacement", "velocity")
LOOSE = 1e-6  # weight of "at rest" where nothing is told of a node


def motions_of(words: Sequence[str]) -> dict[str, dict[str, float]]:
    """What ``--initial`` was given: ``NODE=VALUE``, ``NODE.velocity=VALUE``, or a JSON file {node: {displacement, velocity}}, in SI."""
    out: dict[str, dict[str, float]] = {}
    for word in words:
        name, joined, value = word.partition("=")
        if not joined:
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
    asm = assemble(network)
    free = [n for n in asm.network.nodes if n not in asm.network.moved_nodes]
    for node in motions:
        if node not in free:
            why = "is moved by an input" if node in network.moved_nodes else "is no node of the model"
            raise InputError(f"--initial: {shown(node)} {why} (free are {', '.join(free)})")
    x, r, v = (asm.columns(part) for part in ("x", "r", "v"))
    lead = [np.asarray(inputs[c.name], float) for c in network.inputs if c.quantity == "displacement"]
    at = np.array([u[0] for u in lead][: r.stop - r.start])
    rate = np.array([(u[1] - u[0]) / step for u in lead][: v.stop - v.start])
    rows, right, weight = [], [], []
    for matrix, key in ((asm.position, "displacement"), (asm.velocity, "velocity")):
        for k, node in enumerate(free):
            told = motions.get(node, {}).get(key)
            given = 0.0
            if len(at) == r.stop - r.start:
                given = float(matrix[k, r] @ at + matrix[k, v] @ rate)
            rows.append(matrix[k, x])
            right.append((told or 0.0) - given)
            weight.append(LOOSE if told is None else 1.0)
    A, b, w = np.array(rows), np.array(right), np.array(weight)
    state = np.linalg.lstsq(A * w[:, None], b * w, rcond=None)[0]
    off = np.abs(A @ state - b)[w == 1.0]
    size = max(float(np.abs(b[w == 1.0]).max(initial=0.0)), 1e-12)
    if off.max(initial=0.0) > 1e-3 * size:
        raise InputError(
            "--initial: no state of the model has these motions (a node without mass follows its neighbours)"
        )
    return np.asarray(state, dtype=np.float64)
