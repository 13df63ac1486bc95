"""Sensitivities: a simulation and its derivatives by finite differences, one variant per parameter and state in one call."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from .initial_states import motion_rows

if TYPE_CHECKING:
    from collections.abc import Mapping

    from ...common.arrays import Array
    from ..simulation.problem import Problem
    from .structure import Structure


@dataclass(frozen=True, eq=False)
class Tangent:
    """Outputs (n, channels) of a record, and their derivatives (n, channels, parameters) and (n, channels, states)."""

    outputs: Array
    by_parameter: Array
    by_state: Array


def tangents(
    problem: Problem, structure: Structure, x: Array, initial: Mapping[int, Array], *, moves: bool = True
) -> dict[int, Tangent]:
    """Return the simulation of each record from its initial state, with derivatives by free parameters and states.

    The latest results are cached, since a fit often continues from the end of another fit with other weights.

    Args:
        problem: Model and records.
        structure: The structure.
        x: Free parameters, transformed (parameters,).
        initial: Initial state by record.
        moves: Whether derivatives by the parameters are needed.
    """
    p = len(x) if moves else 0

    def name(i: int, full: bool) -> tuple[object, ...]:
        return id(structure.network), id(structure.free), x.tobytes(), i, initial[i].tobytes(), full

    known = {i: problem.memory.get(name(i, moves)) or problem.memory.get(name(i, True)) for i in initial}
    todo = [i for i, kept in known.items() if kept is None]
    out = {i: Tangent(k[0], k[1][:, :, :p], k[2]) for i, k in known.items() if k is not None}
    if not todo:
        return {i: out[i] for i in initial}
    nets, steps = [structure.at(x)], np.empty(p)
    for k in range(p):
        f = structure.free[k]
        h = f.step(x[k])
        if x[k] + h > f.high:
            h = -h
        steps[k] = h
        shifted = x.copy()
        shifted[k] += h
        nets.append(structure.at(shifted))
    n0 = len(initial[todo[0]])
    reach = np.maximum(np.abs(motion_rows(problem, nets[0])).max(axis=0), 1e-9) if n0 else np.zeros(0)
    begun, state_steps = {}, {}
    for i in todo:
        state_steps[i] = 1e-3 * problem.span(i) / reach
        begun[i] = np.repeat(initial[i][:, None], 1 + p + n0, axis=1)
        begun[i][:, 1 + p :] += np.diag(state_steps[i])
    every = [*nets, *[nets[0]] * n0]
    for i, y in problem.simulate_all(every, todo, begun, like=nets[0]).items():
        point = y[:, :, 0]
        with np.errstate(over="ignore", invalid="ignore"):  # the caller detects a diverged simulation
            dp = (y[:, :, 1 : 1 + p] - point[:, :, None]) / steps
            ds = (y[:, :, 1 + p :] - point[:, :, None]) / state_steps[i]
        kept = point.copy(), dp, ds
        problem.memory.put(name(i, moves), structure, kept)
        out[i] = Tangent(*kept)
    return {i: out[i] for i in initial}
