"""Sensitivities: a simulation and its derivatives by finite differences, one variant per parameter and state in one call."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from .initial_states import motion_rows

if TYPE_CHECKING:
    from collections.abc import Mapping

    from ..._common.arrays import Array
    from .._simulation.problem import Problem
    from .structure import Structure

#: smallest eigenvalue of a correlation: smaller values are rounding
LEAST_VARIANCE = 1e-12


@dataclass(frozen=True, eq=False)
class Tangent:
    """Outputs (n, channels) of a record, and their derivatives (n, channels, parameters) and (n, channels, states)."""

    outputs: Array
    by_parameter: Array
    by_state: Array


def tangents(
    problem: Problem,
    structure: Structure,
    x: Array,
    initial: Mapping[int, Array],
    *,
    moves: bool = True,
    over: Array | None = None,
) -> dict[int, Tangent]:
    """Return the simulation of each record from its initial state, with derivatives by parameters and states, and keep it. `over`: steps
    of central differences, transformed (steps, parameters); small forward steps by default."""
    p = len(x) if moves else 0

    def name(i: int, full: bool) -> tuple[object, ...]:
        where = (
            x.tobytes(),
            i,
            initial[i].tobytes(),
            None if over is None else over.tobytes(),
        )
        return id(structure.network), id(structure.free), *where, full

    known = {
        i: problem.memory.get(name(i, moves)) or problem.memory.get(name(i, True))
        for i in initial
    }
    todo = [i for i, kept in known.items() if kept is None]
    out = {
        i: Tangent(k[0], k[1][:, :, :p], k[2])
        for i, k in known.items()
        if k is not None
    }
    if not todo:
        return {i: out[i] for i in initial}
    moved = over if over is not None else _small_steps(structure, x)[:p]
    nets = [
        structure.at(v)
        for v in (x, *(x + moved), *(x - moved if over is not None else ()))
    ]
    lanes, n0 = len(nets), len(initial[todo[0]])
    reach = (
        np.maximum(np.abs(motion_rows(problem, nets[0])).max(axis=0), 1e-9)
        if n0
        else np.zeros(0)
    )
    begun, state_steps = {}, {}
    for i in todo:
        state_steps[i] = 1e-3 * problem.span(i) / reach
        begun[i] = np.repeat(initial[i][:, None], lanes + n0, axis=1)
        begun[i][:, lanes:] += np.diag(state_steps[i])
    every = [*nets, *[nets[0]] * n0]
    for i, y in problem.simulate_all(every, todo, begun).items():
        point = y[:, :, 0]
        with np.errstate(
            over="ignore", invalid="ignore"
        ):  # the caller detects a diverged simulation
            if over is None:
                dp = (y[:, :, 1:lanes] - point[:, :, None]) / np.diag(moved)
            else:
                dp = (
                    0.5
                    * (y[:, :, 1 : 1 + p] - y[:, :, 1 + p : lanes])
                    @ np.linalg.inv(moved).T
                )
            ds = (y[:, :, lanes:] - point[:, :, None]) / state_steps[i]
        kept = point.copy(), dp, ds
        problem.memory.put(name(i, moves), structure, kept)
        out[i] = Tangent(*kept)
    return {i: out[i] for i in initial}


def _small_steps(structure: Structure, x: Array) -> Array:
    """Return a small step of each parameter within its limits, transformed (parameters, parameters)."""
    steps = [
        f.step(v) if v + f.step(v) <= f.high else -f.step(v)
        for f, v in zip(structure.free, x, strict=True)
    ]
    return np.diag(np.array(steps, dtype=np.float64))


def deviations(structure: Structure, x: Array, covariance: Array) -> Array:
    """Return the principal axes of a correlation as steps of differences (steps, parameters), one standard deviation long, within limits:
    small steps of single parameters lose a direction in which the outputs hardly change."""
    deviation = np.sqrt(np.diag(covariance))
    variances, axes = np.linalg.eigh(covariance / np.outer(deviation, deviation))
    steps = deviation * (axes * np.sqrt(np.maximum(variances, LEAST_VARIANCE))).T
    small = np.abs(np.diag(_small_steps(structure, x)))
    room = np.maximum(
        [min(f.high - v, v - f.low) for f, v in zip(structure.free, x, strict=True)],
        small,
    )
    steps = steps / np.maximum((np.abs(steps) / room).max(axis=1), 1.0)[:, None]
    return np.asarray(
        steps / np.minimum((np.abs(steps) / small).max(axis=1), 1.0)[:, None]
    )
