"""Cost of a fit and its derivatives: whitened residuals, and the stated uncertainty as a prior."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from ..._common.errors import InputError
from .initial_states import motion_rows
from .sensitivities import tangents

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from ..._common.arrays import Array
    from .._simulation.problem import Problem
    from .noise import Whitener
    from .structure import Structure


@dataclass
class Point:
    """A point of a fit: parameters, initial states and offsets, with the outputs and the cost of each record."""

    x: Array
    initial: dict[int, Array]
    offset: dict[int, Array]
    outputs: dict[int, Array] = field(default_factory=dict)  # offsets included
    #: whitened squares and the initial state's prior, by record
    costs: dict[int, float] = field(default_factory=dict)
    prior: float = 0.0  # of the parameters

    @property
    def total(self) -> float:
        return sum(self.costs.values()) + self.prior if self.costs else math.inf

    def take(self, other: Point, i: int) -> None:
        """Take over initial state, offsets, outputs and cost of a record from another point."""
        self.initial[i], self.offset[i] = other.initial[i], other.offset[i]
        self.costs[i] = other.costs[i]
        if i in other.outputs:
            self.outputs[i] = other.outputs[i]


@dataclass
class Slope:
    """Whitened derivatives of a record (rows, parameters + shared offsets + nuisances), with their normal equations."""

    by: Array
    gram: Array
    own: Array  # of the nuisances (initial state, offsets of the record, lags), prior included
    known: Array  # the prior of the initial state (states, states)


class Objective:
    """Cost of a structure over records, with derivatives."""

    def __init__(self, problem: Problem, weights: Whitener):
        self.problem = problem
        self.weights = weights
        self._rows: dict[int, tuple[Structure, Array]] = {}

    # -- costs ------------------------------------------------------------------------------------------
    def _information(self, structure: Structure, index: int) -> Array:
        """Return the inverse prior covariance of the initial state (states, states), at the start values."""
        key = id(structure.network)
        if key not in self._rows:
            rows = motion_rows(self.problem, structure.network)
            self._rows[key] = structure, rows.T @ rows
        return self._rows[key][1] / self.problem.span(index) ** 2

    def price(self, structure: Structure, at: Point, outputs: Mapping[int, Array]) -> Point:
        """Return the point with outputs and costs; the cost is infinite where the simulation breaks down."""
        for i, y in outputs.items():
            at.outputs[i] = self.problem.shifted(i, y, at.offset[i])
            square = math.inf
            if np.isfinite(y).all() and np.abs(y).max() <= 1e12:
                square = float(np.sum(self.weights(self.problem.records[i].measured - at.outputs[i]) ** 2))
            x0 = at.initial[i]
            at.costs[i] = square + (float(x0 @ self._information(structure, i) @ x0) if len(x0) else 0.0)
        return at

    def seen(self, structure: Structure, at: Point, records: Sequence[int]) -> Point:
        """Simulate the records."""
        net = structure.at(at.x)
        try:
            begun = {i: at.initial[i][:, None] for i in records}
            found = self.problem.simulate_all([net], records, begun)
        except (InputError, np.linalg.LinAlgError):
            at.costs = dict.fromkeys(records, math.inf)
            return at
        return self.price(structure, at, {i: y[:, :, 0] for i, y in found.items()})

    def cost(
        self,
        structure: Structure,
        x: Array,
        initial: dict[int, Array],
        offset: dict[int, Array],
        records: Sequence[int],
    ) -> float:
        """Return the sum of squares of the whitened residuals with the initial states' prior; infinite where the simulation breaks
        down."""
        return self.seen(structure, Point(x, initial, offset), records).total

    # -- slopes -----------------------------------------------------------------------------------------
    def slopes(
        self, structure: Structure, at: Point, records: Sequence[int], moves: bool
    ) -> dict[int, Slope] | None:
        """Return derivatives at a point, whose outputs and costs are filled in, also by parameters if `moves`; None where the simulation
        breaks down."""
        try:
            found = tangents(self.problem, structure, at.x, {i: at.initial[i] for i in records}, moves=moves)
        except (InputError, np.linalg.LinAlgError):
            return None
        self.price(structure, at, {i: t.outputs for i, t in found.items()})
        out = {}
        for i, t in found.items():
            free = self.problem.nuisances(i, t.outputs)
            common = self.problem.common(t.outputs)[:, :, : None if moves else 0]
            stack = np.concatenate([t.by_parameter, common, t.by_state, free], axis=2)
            if not (math.isfinite(at.costs[i]) and np.isfinite(stack).all()):
                return None
            rows, columns = stack.shape[0] * stack.shape[1], stack.shape[2]
            by = self.weights(stack).reshape(rows, columns) if columns else np.zeros((rows, 0))
            if not (np.abs(by) < 1e100).all():  # their squares would overflow
                return None
            gram = by.T @ by
            p, n0 = t.by_parameter.shape[2] + common.shape[2], t.by_state.shape[2]
            own = gram[p:, p:].copy()
            known = self._information(structure, i) if n0 else np.zeros((0, 0))
            own[:n0, :n0] += known
            own[np.arange(len(own)), np.arange(len(own))] *= 1 + 1e-9
            out[i] = Slope(by, gram, own, known)
        return out

    def _downhill(self, at: Point, i: int, slope: Slope) -> Array:
        """Return the negative gradient of half the cost (parameters, shared offsets, nuisances)."""
        left = self.weights(self.problem.records[i].measured - at.outputs[i]).ravel()
        down = slope.by.T @ left
        p, n0 = len(down) - len(slope.own), len(slope.known)
        down[p : p + n0] -= slope.known @ at.initial[i]
        return np.asarray(down, dtype=np.float64)

    def _moved(
        self, at: Point, x: Array, moves: Mapping[int, NDArray[np.floating]], common: Array | None = None
    ) -> Point:
        """Return a point with parameters `x`, moved nuisances, and shared offsets moved by `common`."""
        initial, offset = dict(at.initial), {i: o.copy() for i, o in at.offset.items()}
        for i, move in moves.items():
            n0 = len(at.initial[i])
            initial[i] = at.initial[i] + move[:n0]
            offset[i][self.problem.moves(i)] += move[n0:]
            if common is not None:
                offset[i][np.flatnonzero(self.problem.shared_offset)] += common
        return Point(x, initial, offset)
