"""Damped Gauss-Newton steps within limits, nuisances eliminated (Levenberg 1944, Marquardt 1963; active set at the limits).

References:
    Transtrum, Sethna: Improvements to the Levenberg-Marquardt algorithm for nonlinear least-squares minimization, arXiv:1201.5885
    (2012): the geodesic acceleration.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Mapping

    from ..._common.arrays import Array
    from .structure import Structure

#: share of a step after which its curvature is measured, and largest ratio of twice the acceleration to the step
PROBE, BENT = 0.1, 0.75
#: largest step of a logarithm
STRIDE = 1.5


@dataclass
class Slope:
    """Whitened derivatives of a record (rows, parameters + shared offsets + nuisances), with their normal equations."""

    by: Array
    gram: Array
    own: Array  # of the nuisances (initial state, record offsets), prior included
    known: Array  # the prior of the initial state (states, states)


@dataclass(frozen=True)
class Step:
    """A step of parameters and shared offsets (p + q,), and of the nuisances of each record."""

    x: Array
    nuisances: dict[int, Array]

    def at(self, record: int) -> Array:
        """Return the whole step in the columns of the derivatives of a record."""
        return np.concatenate([self.x, self.nuisances[record]])

    def scaled(self, share: float) -> Step:
        """Return a share of the step."""
        return Step(share * self.x, {i: share * m for i, m in self.nuisances.items()})


class QuadraticModel:
    """The quadratic model of half the cost about parameters `x` with `shared` shared offsets: slopes and downhill directions by record."""

    def __init__(
        self,
        structure: Structure,
        x: Array,
        shared: int,
        slopes: Mapping[int, Slope],
        down: Mapping[int, Array],
    ):
        self.slopes, self.down = slopes, down
        free, mean, sigma = structure.free, structure.mean, structure.sigma
        none, still = np.full(shared, math.inf), np.zeros(shared)
        stride = np.array([min(f.stride, STRIDE if f.log else math.inf) for f in free])
        reach = 3.0 * np.maximum(np.abs(x), sigma)
        self.here = np.append(x, still)
        self.low = np.append([f.low for f in free], -none)
        self.high = np.append([f.high for f in free], none)
        self.wide = np.append(np.where(np.isfinite(stride), stride, reach), none)
        self.pull = np.append((mean - x) / sigma**2, still)
        self.prior = np.diag(np.append(1.0 / sigma**2, still))

    def step(self, damping: float) -> Step:
        """Return the damped step to the least cost within limits."""
        return self._solve(self.down, self.pull, damping)

    def accelerated(
        self, step: Step, changes: Mapping[int, Array], damping: float
    ) -> Step:
        """Return a step with half the acceleration that follows from the changes of the whitened outputs (rows,) by record after the share
        `PROBE` of the step; the step itself where the acceleration is large."""
        curving = {}
        for i, s in self.slopes.items():
            bend = changes[i] - PROBE * s.by @ step.at(i)
            curving[i] = -s.by.T @ bend / PROBE**2
        more = self._solve(curving, np.zeros(len(self.here)), damping)
        if not 2.0 * self._size(more) < BENT * self._size(step):
            return step
        x = np.clip(self.here + step.x + more.x, self.low, self.high) - self.here
        return Step(x, {i: m + more.nuisances[i] for i, m in step.nuisances.items()})

    def _size(self, step: Step) -> float:
        """Return the change of the whitened outputs by a step, to first order."""
        square = sum(np.sum((s.by @ step.at(i)) ** 2) for i, s in self.slopes.items())
        return float(np.sqrt(square))

    def _solve(self, down: Mapping[int, Array], pull: Array, damping: float) -> Step:
        """Return the step of a slope by record and of the prior, nuisances eliminated."""
        g, H, n = pull, self.prior, len(pull)
        solved = {}
        for i, s in self.slopes.items():
            cross = s.gram[:n, n:]
            both = np.column_stack([cross.T, down[i][n:]])
            solved[i] = inner = np.linalg.solve(damped(s.own, damping), both)
            H = H + s.gram[:n, :n] - cross @ inner[:, :-1]
            g = g + down[i][:n] - cross @ inner[:, -1]
        x = bounded_step(H, g, self.here, self.low, self.high, self.wide, damping)
        return Step(x, {i: s[:, -1] - s[:, :-1] @ x for i, s in solved.items()})


def damped(matrix: Array, damping: float) -> Array:
    """Return a matrix (n, n) with its diagonal grown by a share."""
    return np.asarray(matrix + damping * np.diag(np.diag(matrix)))


def bounded_step(
    hessian: Array,
    slope: Array,
    x: Array,
    low: Array,
    high: Array,
    stride: Array,
    damping: float,
) -> Array:
    """Return the minimum of the damped quadratic model of the cost within limits and strides (p,), from half its Hessian (p, p) and
    descent direction (p,); coordinates that would leave the limits stay."""
    p = len(x)
    curvature = damped(hessian, damping)
    free = np.ones(p, bool)
    step = np.zeros(p)
    for _ in range(p + 1):
        index = np.flatnonzero(free)
        step = np.zeros(p)
        if len(index):
            step[index] = np.linalg.solve(curvature[np.ix_(index, index)], slope[index])
        leaves = ((step < 0) & (x <= low + 1e-9)) | ((step > 0) & (x >= high - 1e-9))
        if not np.any(leaves & free):
            break
        free &= ~leaves
    return np.asarray(
        np.clip(x + np.clip(step, -stride, stride), low, high) - x, dtype=np.float64
    )
