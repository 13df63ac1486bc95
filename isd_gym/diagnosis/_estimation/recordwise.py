"""Fits with parameters of their own for each group of records, beside parameters that all records share.

The parameters of a group have the stated uncertainty as prior, each group for itself (no pooling; Gelman and Hill, Data Analysis Using
Regression and Multilevel/Hierarchical Models, 2007, chapter 12). Initial states, offsets and lags are eliminated per record as in `Fitter`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..._common.errors import InputError
from .gauss_newton import Fitter
from .least_squares import bounded_step, damped_step

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from ..._common.arrays import Array
    from .gauss_newton import Point, Slope
    from .structure import Structure

#: largest step of a parameter that is a logarithm
LARGEST_STEP = 1.5


@dataclass(frozen=True, eq=False)
class RecordwiseFit:
    """A fit with some parameters of their own for each group of records."""

    structure: Structure
    #: transformed parameters of each group (groups, parameters)
    x: Array
    #: mask of the parameters with a value per group (parameters,)
    own: NDArray[np.bool_]
    #: fitted point of each group
    points: tuple[Point, ...]
    #: derivatives by record, of each group, at the last point at which they were computed
    slopes: tuple[Mapping[int, Slope], ...]
    #: sum of squares with all priors
    cost: float


class RecordwiseFitter(Fitter):
    """Gauss-Newton fits of parameters that groups of records share or have for themselves."""

    def fit_groups(
        self,
        structure: Structure,
        x: Array,
        groups: Sequence[Sequence[int]],
        own: NDArray[np.bool_],
        *,
        iterations: int = 8,
        tolerance: float = 1e-3,
    ) -> RecordwiseFit:
        """Fit a structure without shared offsets to groups of records, from transformed start values; `own` marks the parameters with a
        value per group."""
        layout = _Layout(structure, own, len(groups))
        z = layout.pack(np.broadcast_to(x, (len(groups), len(own))))
        each = layout.unpack(z)
        points = [self.begin(structure, row, None, None, g) for row, g in zip(each, groups, strict=True)]
        damping, cost, slopes = 1e-4, math.inf, []
        for turn in range(iterations + 1):
            fresh = [self.slopes(structure, p, g, True) for p, g in zip(points, groups, strict=True)]
            if any(s is None for s in fresh):
                if turn == 0:
                    raise InputError("the simulation breaks down at the start values")
                break
            slopes = [s for s in fresh if s is not None]
            now = self._total(points, layout, z)
            has_converged = turn > 0 and now > (1.0 - tolerance) * cost
            cost = now
            if has_converged or turn == iterations:
                break
            found, _, damping = self._step_groups(structure, points, groups, slopes, layout, z, cost, damping)
            if found is None:
                break
            z, points = found
        return RecordwiseFit(structure, layout.unpack(z), own, tuple(points), tuple(slopes), cost)

    def gradient(self, point: Point, slopes: Mapping[int, Slope]) -> dict[int, Array]:
        """Return the descent direction of half the cost of each record (parameters,), nuisances eliminated."""
        out = {}
        for i, s in slopes.items():
            down, p = self._downhill(point, i, s), len(s.gram) - len(s.own)
            g = down[:p]
            if len(s.own):
                g = g - s.gram[:p, p:] @ np.linalg.solve(s.own, down[p:])
            out[i] = g
        return out

    def information(self, slopes: Mapping[int, Slope]) -> dict[int, Array]:
        """Return the information of each record on the parameters (parameters, parameters), nuisances eliminated."""
        return {i: self._hessian({i: s}) for i, s in slopes.items()}

    def _total(self, points: Sequence[Point], layout: _Layout, z: Array) -> float:
        return sum(sum(p.costs.values()) for p in points) + layout.prior(z)

    def _step_groups(
        self,
        structure: Structure,
        points: Sequence[Point],
        groups: Sequence[Sequence[int]],
        slopes: Sequence[Mapping[int, Slope]],
        layout: _Layout,
        z: Array,
        cost: float,
        damping: float,
    ) -> tuple[tuple[Array, list[Point]] | None, float, float]:
        """Return the parameters and points with a smaller cost, or None, the cost, and the next damping."""
        H, g = np.diag(1.0 / layout.sigma**2), (layout.mean - z) / layout.sigma**2
        for k, (point, own) in enumerate(zip(points, slopes, strict=True)):
            place = layout.index[k]
            H[np.ix_(place, place)] += self._hessian(own)
            g[place] += np.sum(list(self.gradient(point, own).values()), axis=0)

        def take(damping: float) -> tuple[tuple[Array, list[Point]], float]:
            then = z + bounded_step(H, g, z, layout.low, layout.high, layout.stride(z), damping)
            moved = []
            for k, (point, own, row) in enumerate(zip(points, slopes, layout.unpack(then), strict=True)):
                p, step = len(row), row - point.x
                moves = {
                    i: np.linalg.solve(s.own, self._downhill(point, i, s)[p:] - s.gram[p:, :p] @ step)
                    for i, s in own.items()
                }
                moved.append(self.seen(structure, self._moved(point, row, moves), groups[k]))
            return (then, moved), self._total(moved, layout, then)

        return damped_step(take, cost, damping, tries=6)


class _Layout:
    """Order in one vector of shared parameters, then those of each group (mask `own`)."""

    def __init__(self, structure: Structure, own: NDArray[np.bool_], count: int):
        p, shared = len(own), int(np.sum(~own))
        each = p - shared
        #: position of each parameter of each group (groups, parameters)
        self.index = np.empty((count, p), dtype=int)
        self.index[:, ~own] = np.arange(shared)
        self.index[:, own] = shared + each * np.arange(count)[:, None] + np.arange(each)
        size = shared + each * count
        source = np.empty(size, dtype=int)
        source[self.index] = np.arange(p)
        free = [structure.free[k] for k in source]
        self.mean, self.sigma = structure.mean[source], structure.sigma[source]
        self.low, self.high = np.array([f.low for f in free]), np.array([f.high for f in free])
        self._stride = np.array([min(f.stride, LARGEST_STEP if f.log else math.inf) for f in free])

    def pack(self, x: Array) -> Array:
        """Return the vector of the parameters (groups, parameters); shared parameters are those of the first group."""
        z = np.empty(len(self.mean))
        for place, row in zip(self.index[::-1], x[::-1], strict=True):
            z[place] = row
        return z

    def unpack(self, z: Array) -> Array:
        """Return the parameters of each group (groups, parameters)."""
        return np.asarray(z[self.index])

    def stride(self, z: Array) -> Array:
        """Return the largest permitted steps."""
        wide = 3.0 * np.maximum(np.abs(z), self.sigma)
        return np.where(np.isfinite(self._stride), self._stride, wide)

    def prior(self, z: Array) -> float:
        """Return the cost of the prior."""
        return float(np.sum(((z - self.mean) / self.sigma) ** 2))
