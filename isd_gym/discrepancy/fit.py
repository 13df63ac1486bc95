"""Simulation-error fit: Gauss-Newton with the stated uncertainty of the base parameters as prior (MAP).

The Jacobian comes from lanes: the base point and one variant a parameter run in the same call of the kernel. Initial
states and free offsets of every record are fitted along.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..errors import InputError
from ..network import Network, assemble
from .initial import along, guess, state_scale
from .least_squares import bounded_step
from .noise import Whitener
from .problem import Array, Problem, bare
from .structure import Structure


@dataclass
class Fit:
    """What a structure says when fitted: `x` (free parameters, transformed), per-record initial states and outputs."""

    structure: Structure
    x: Array
    initial: dict[int, Array]
    offset: dict[int, Array]
    outputs: dict[int, Array]  # record -> (n, channels), offsets included
    cost: float  # sum of squares of whitened residuals over estimation records
    prior: float
    hessian: Array | None = None  # of the structure's parameters, initial states and offsets eliminated

    @property
    def network(self) -> Network:
        return self.structure.at(self.x)


class Fitter:
    def __init__(self, problem: Problem, weights: Whitener):
        self.problem = problem
        self.weights = weights
        self._known: dict[tuple[int, int], tuple[Structure, tuple[Array, Array]]] = {}

    def simulate_point(self, structure: Structure, x: Array, index: int, initial: Array) -> Array:
        net = structure.at(x)
        return self.problem.simulate([net], index, initial[:, None], like=net)[:, :, 0]

    def lanes(self, structure: Structure, x: Array, index: int, initial: Array, with_parameters: bool = True):
        """(outputs at the point (n, ny), derivatives (n, ny, parameters), by initial state (n, ny, states))."""
        p = len(x) if with_parameters else 0
        n0 = len(initial)
        nets = [structure.at(x)]
        steps = np.empty(p)
        for k in range(p):
            f = structure.free[k]
            h = 2e-3 if f.log else 1e-3 * max(abs(x[k]), 0.03 * f.sigma, 1e-12)
            if x[k] + h > f.high:
                h = -h
            steps[k] = h
            shifted = x.copy()
            shifted[k] += h
            nets.append(structure.at(shifted))
        rows, scale = state_scale(self.problem, nets[0], index)
        state_step = np.array(
            [1e-3 * float(scale[0]) / max(np.abs(rows[:, i]).max(), 1e-9) for i in range(n0)]
        )
        start = np.repeat(initial[:, None], 1 + p + n0, axis=1)
        for i in range(n0):
            nets.append(nets[0])
            start[i, 1 + p + i] += state_step[i]
        out = self.problem.simulate(nets, index, start, like=nets[0])
        point = out[:, :, 0]
        with np.errstate(over="ignore", invalid="ignore"):  # one that breaks down is seen by who asked
            dp = (out[:, :, 1 : 1 + p] - point[:, :, None]) / steps
            ds = (out[:, :, 1 + p :] - point[:, :, None]) / state_step
        return point, dp, ds

    def follow(
        self,
        structure: Structure,
        x: Array,
        records: Sequence[int],
        initial: dict[int, Array] | None = None,
        about: dict[int, Array] | None = None,
        *,
        iterations: int = 4,
    ) -> Fit:
        """Initial states and offsets of `records` with the parameters as they are, one record after the other.

        `initial`: where to begin. Else the cheapest of a guess, of `about`, and, for a record that goes on where the one
        before it ended, of where the simulation of that one ended.
        """
        problem, net = self.problem, structure.at(x)
        n0 = assemble(bare(net)).size[0]
        fits: list[Fit] = []
        last: tuple[int, Fit] | None = None
        for i in records:
            starts = []
            if initial and i in initial and len(initial[i]) == n0:
                starts = [initial[i]]
            elif n0:
                starts = [guess(problem, net, i)]
                if last is not None and problem.records[i].follows(problem.records[last[0]]):
                    k, end = last[0], len(problem.records[last[0]]) - 1
                    before, now = along(problem, structure, x, k, last[1].initial[k], (end - 1, end))
                    ahead = 2 * now - before
                    starts = [guess(problem, net, i, ahead), ahead, *starts]
                if about and len(about.get(i, ())) == n0:
                    starts.append(about[i])
                if len(starts) > 1:
                    zero = {i: np.zeros(len(problem.channels))}
                    costs = [self.cost(structure, x, {i: s}, zero, [i]) for s in starts]
                    starts = [starts[int(np.argmin(costs))]]
            f = self.fit(
                structure,
                x,
                {i: starts[0]} if starts else None,
                records=[i],
                frozen=True,
                iterations=iterations,
            )
            last = (i, f)
            fits.append(f)
        total = fits[0]
        for f in fits[1:]:
            total.initial |= f.initial
            total.offset |= f.offset
            total.outputs |= f.outputs
            total.cost += f.cost
        return total

    # -- fitting ----------------------------------------------------------------------------------------
    def fit(
        self,
        structure: Structure,
        x: Array | None = None,
        initial: dict[int, Array] | None = None,
        offset: dict[int, Array] | None = None,
        *,
        iterations: int = 8,
        records: list[int] | None = None,
        tolerance: float = 1e-4,
        frozen: bool = False,
    ) -> Fit:
        """Fit the structure to the given records (the estimation records by default).

        `frozen`: only initial states and offsets move.
        """
        problem = self.problem
        records = problem.estimation if records is None else records
        x = structure.start if x is None else x.copy()
        net = structure.at(x)
        n0 = assemble(bare(net)).size[0]
        initial = {
            i: initial[i].copy()
            if initial and i in initial and len(initial[i]) == n0
            else guess(problem, net, i)
            for i in records
        }
        ny = len(problem.channels)
        offset = {i: (offset[i].copy() if offset and i in offset else np.zeros(ny)) for i in records}
        mean = np.array([f.mean for f in structure.free])
        sigma = np.array([f.sigma for f in structure.free])
        low = np.array([f.low for f in structure.free])
        high = np.array([f.high for f in structure.free])
        p = 0 if frozen else len(x)
        stride = np.array([min(f.stride, 1.5 if f.log else math.inf) for f in structure.free])
        damping = 1e-4
        point = self._linearise(structure, x, initial, offset, records, p)
        cost = point[0] + self._prior(structure, x, initial, mean, sigma)
        if not math.isfinite(cost):
            raise InputError("the simulation breaks down at the start values")
        for _ in range(iterations):
            _, H, g, nuisance, _ = point
            H, g = H.copy(), g.copy()
            H[np.arange(p), np.arange(p)] += 1.0 / sigma[:p] ** 2
            g[:p] += (mean[:p] - x[:p]) / sigma[:p] ** 2
            wide = np.where(np.isfinite(stride), stride, 3.0 * np.maximum(np.abs(x), sigma))
            improved = False
            for _ in range(6):
                step = bounded_step(H, g, x, low, high, wide, damping) if p else np.zeros(0)
                trial = x + step if p else x
                ti, to = {}, {}
                for i in records:
                    B, C, rhs = nuisance[i]
                    move = np.linalg.solve(C, rhs - B @ step)
                    ti[i] = initial[i] + move[:n0]
                    to[i] = offset[i].copy()
                    to[i][problem.free_offset] += move[n0:]
                new_cost = self.cost(structure, trial, ti, to, records) + self._prior(
                    structure, trial, ti, mean, sigma
                )
                if np.isfinite(new_cost) and new_cost < cost:
                    improved = True
                    break
                damping = max(damping * 10, 1e-3)
                if not np.isfinite(new_cost) or damping > 1e4:
                    damping = max(damping, 1.0)
            if not improved:
                break
            gain = (cost - new_cost) / max(cost, 1e-300)
            x, initial, offset, cost = trial, ti, to, new_cost
            damping = max(damping * 0.2, 1e-6)
            new = self._linearise(structure, x, initial, offset, records, p)
            if not math.isfinite(new[0]):
                break
            point = new
            if gain < tolerance:
                break
        total, H, g, nuisance, outs = point
        prior = float(np.sum(((x - mean) / sigma) ** 2)) if len(x) else 0.0
        return Fit(structure, x, initial, offset, outs, total, prior, H if p else None)

    def refit(self, fit: Fit, responses: dict[int, Array]) -> tuple[Array, dict[int, Array]]:
        """What a fit would make of `responses` (n, channels, m) in the records, to first order.

        By how much the parameters would be off (parameters, m), and what would be left (n, channels, m), whitened.
        """
        problem, structure = self.problem, fit.structure
        p = len(fit.x)
        sigma = np.array([f.sigma for f in structure.free])
        H = np.diag(1 / sigma**2)
        m = next(iter(responses.values())).shape[2]
        g = np.zeros((p, m))
        parts = {}
        for i, s in responses.items():
            y, dp, ds = self.lanes(structure, fit.x, i, fit.initial[i])
            const = problem.constants(i)
            W = self.weights(np.concatenate([dp, ds, const, s], axis=2)).reshape(len(y) * y.shape[1], -1)
            a, b, c = W[:, :p], W[:, p : W.shape[1] - m], W[:, W.shape[1] - m :]
            if b.shape[1]:
                Q, _ = np.linalg.qr(b)
                a, c = a - Q @ (Q.T @ a), c - Q @ (Q.T @ c)
            H += a.T @ a
            g += a.T @ c
            parts[i] = a, c
        shift = np.linalg.solve(H, g)
        return np.asarray(shift, dtype=np.float64), {
            i: (c - a @ shift).reshape(responses[i].shape) for i, (a, c) in parts.items()
        }

    def cost(
        self,
        structure: Structure,
        x: Array,
        initial: dict[int, Array],
        offset: dict[int, Array],
        records: Sequence[int],
    ) -> float:
        """Sum of squares of the whitened residuals over `records`; infinite where the simulation breaks down."""
        total = 0.0
        for i in records:
            try:
                y = self.simulate_point(structure, x, i, initial[i]) + offset[i]
            except (InputError, np.linalg.LinAlgError):
                return math.inf
            if not np.isfinite(y).all() or np.abs(y).max() > 1e12:
                return math.inf
            total += float(np.sum(self.weights(self.problem.records[i].measured - y) ** 2))
        return total

    def _prior(
        self, structure: Structure, x: Array, initial: dict[int, Array], mean: Array, sigma: Array
    ) -> float:
        out = float(np.sum(((x - mean) / sigma) ** 2)) if len(x) else 0.0
        for i, x0 in initial.items():
            if len(x0):
                rows, scale = self._scales(structure, x, i)
                out += float(np.sum((rows @ x0 / scale) ** 2))
        return out

    def _scales(self, structure: Structure, x: Array, index: int) -> tuple[Array, Array]:
        key = (id(structure), index)
        if key not in self._known:  # the prior of the initial state: that of the start values will do
            self._known[key] = (structure, state_scale(self.problem, structure.network, index))
        return self._known[key][1]

    def _linearise(self, structure, x, initial, offset, records, p):
        """Normal equations with the per-record nuisances (initial state, offsets) eliminated."""
        problem = self.problem
        H, g, total = np.zeros((p, p)), np.zeros(p), 0.0
        nuisance, outs = {}, {}
        for i in records:
            record = problem.records[i]
            try:
                y, dp, ds = self.lanes(structure, x, i, initial[i], with_parameters=p > 0)
            except (InputError, np.linalg.LinAlgError):
                return math.inf, H, g, {}, {}
            y = y + offset[i]
            outs[i] = y
            if not (np.isfinite(y).all() and np.isfinite(dp).all() and np.isfinite(ds).all()):
                return math.inf, H, g, {}, {}
            const = problem.constants(i)
            stack = np.concatenate([(record.measured - y)[:, :, None], dp, ds, const], axis=2)
            W = self.weights(stack).reshape(-1, stack.shape[2])
            G = W.T @ W
            total += G[0, 0]
            a, b = slice(1, 1 + p), slice(1 + p, None)
            C = G[b, b].copy()
            rhs = G[b, 0].copy()
            n0 = len(initial[i])
            if n0:
                rows, scale = self._scales(structure, x, i)
                R = rows / scale[:, None]
                C[:n0, :n0] += R.T @ R
                rhs[:n0] -= R.T @ R @ initial[i]
            C[np.arange(len(C)), np.arange(len(C))] *= 1 + 1e-9
            B = G[b, a]
            if len(C):
                S = np.linalg.solve(C, np.column_stack([B, rhs]))
                H += G[a, a] - B.T @ S[:, :p]
                g += G[a, 0] - B.T @ S[:, p]
            else:
                H += G[a, a]
                g += G[a, 0]
            nuisance[i] = (B, C if len(C) else np.zeros((0, 0)), rhs)
        return total, H, g, nuisance, outs


def residuals(problem: Problem, fit: Fit) -> list[Array]:
    """What the fit leaves of each of its records (n, channels)."""
    return [problem.records[i].measured - y for i, y in fit.outputs.items()]


def gap(problem: Problem, fit: Fit) -> float:
    """Geometric mean over channels of the residual's power over the signal's: how wide the gap is, whatever its spectrum.

    One channel that drifts does not drown the others.
    """
    r = np.concatenate(residuals(problem, fit))
    y = problem.measured(list(fit.outputs))
    share = np.mean(r**2, axis=0) / np.maximum(np.var(y, axis=0), 1e-300)
    return float(np.exp(np.mean(np.log(np.maximum(share, 1e-300)))))
