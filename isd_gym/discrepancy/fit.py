"""Simulation-error fit: Gauss-Newton with the stated uncertainty of the base parameters as prior (MAP).

The Jacobian comes from lanes: the base point and one variant a parameter run in the same call of the kernel. Initial
states and free offsets of every record are fitted along.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..network import Channel, Network, assemble
from .hypotheses import Structure
from .problem import Problem, Whitener, bare, motion_rows_of

Array = NDArray[np.float64]


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
    jacobian: dict[int, Array] | None = None  # whitened, (n * channels, parameters), nuisances projected out
    white: dict[int, Array] | None = None

    @property
    def network(self) -> Network:
        return self.structure.at(self.x)


class Fitter:
    def __init__(self, problem: Problem, weights: Whitener):
        self.problem = problem
        self.weights = weights
        self._known: dict[tuple[int, int], tuple[Structure, tuple[Array, Array]]] = {}

    # -- initial states ---------------------------------------------------------------------------------
    def state_scale(self, network: Network, index: int) -> tuple[Array, Array]:
        """(reference rows over the states, prior standard deviation of each row): wide, from the data's own motion."""
        asm = assemble(bare(network))
        rows = motion_rows_of(asm)
        record = self.problem.records[index]
        spans = [0.0]
        for c in network.inputs:
            if c.quantity == "displacement":
                spans.append(float(np.ptp(record.inputs[c.name])))
        for j, c in enumerate(network.outputs):
            y = record.measured[:, j] / self.problem.factors[j]
            if c.quantity == "displacement":
                spans.append(float(np.ptp(y)))
            elif c.quantity == "velocity":
                spans.append(float(np.ptp(y)) / 6.0)
            elif c.quantity == "acceleration":
                spans.append(float(np.ptp(y)) / 36.0)
        span = max(spans) or 0.01
        return rows, np.full(len(rows), 2.0 * span)

    def guess(self, network: Network, index: int, about: Array | None = None) -> Array:
        """An initial state from the first samples: displacements and their slopes as measured, the rest small.

        Where the motion has several resting places (detents, friction), a fit from rest ends in the wrong one.
        `about` (states,): where a simulation of what came before ended; it is believed to a tenth of the motion.
        """
        record = self.problem.records[index]
        pure = bare(network)
        moved = [c for c in pure.outputs if c.quantity == "displacement"]
        rates = tuple(Channel(f"_{c.name}", "velocity", "m/s", at=c.at, between=c.between) for c in moved)
        asm = assemble(pure, rates)
        n0 = asm.size[0]
        if not n0:
            return np.zeros(0)
        rows, scale = self.state_scale(network, index)
        if about is not None:
            scale = 0.05 * scale
        centre = np.zeros(n0) if about is None else about
        A, b = [rows / scale[:, None]], [rows @ centre / scale]
        count = min(max(5, int(0.02 / record.rate)), len(record))
        t = np.arange(count) * record.rate
        x, r, f = asm.columns("x"), asm.columns("r"), asm.columns("f")
        road = np.array([record.inputs[c.name][0] for c in pure.inputs if c.quantity == "displacement"])
        for j, c in enumerate(pure.outputs):
            if c.quantity == "acceleration" or asm.outputs_by_difference[j] or np.any(asm.outputs[j, f]):
                continue
            y = record.measured[:count, j] / self.problem.factors[j]
            slope, value = np.polyfit(t, y, 1)
            sigma = float(np.std(record.measured[:, j])) / self.problem.factors[j] * 0.02 + 1e-12
            A.append(asm.outputs[j : j + 1, x] / sigma)
            b.append(np.array([(value - asm.outputs[j, r] @ road) / sigma]))
            if c in moved:
                k = len(pure.outputs) + moved.index(c)
                if not asm.outputs_by_difference[k]:
                    wide = sigma / max(t[-1], 1e-9) * 2
                    A.append(asm.outputs[k : k + 1, x] / wide)
                    b.append(np.array([slope / wide]))
        x0 = np.linalg.lstsq(np.vstack(A), np.concatenate(b), rcond=None)[0]
        return x0 if np.isfinite(x0).all() else np.zeros(n0)

    def along(
        self, structure: Structure, x: Array, index: int, initial: Array, at: Sequence[int]
    ) -> list[Array]:
        """States (states,) that the simulation from `initial` has at the compared samples `at`.

        They are read off the motion of the nodes, so that records can be cut and joined anywhere.
        """
        net = structure.at(x)
        pure = bare(net)
        nodes = [n for n in pure.nodes if n not in pure.moved_nodes]
        record = self.problem.records[index]
        watched = replace(pure, outputs=tuple(Channel(f"_{n}", "displacement", "m", at=n) for n in nodes))
        probe = Problem(watched, [replace(record, taps=None, thin=1)], [False], self.problem.step)
        network = replace(
            net, outputs=watched.outputs, elements=tuple(e for e in net.elements if e.place != "channel")
        )
        y = probe.simulate([network], 0, initial[:, None], like=net)[:, :, 0]
        v = np.gradient(y, record.step, axis=0)
        asm = assemble(pure)
        moved = [c.name for c in pure.inputs if c.quantity == "displacement"]
        r = np.stack([record.inputs[c] for c in moved], axis=1) if moved else np.zeros((len(y), 0))
        rate = np.gradient(r, record.step, axis=0) if moved else r
        cols = {part: asm.columns(part) for part in ("x", "r", "v")}
        position, velocity = asm.position[: len(nodes)], asm.velocity[: len(nodes)]
        rows = np.vstack([position[:, cols["x"]], 0.05 * velocity[:, cols["x"]]])
        out = []
        for k in at:
            k = min(k * record.thin, len(y) - 1)
            rest = [m[:, cols["r"]] @ r[k] + m[:, cols["v"]] @ rate[k] for m in (position, velocity)]
            seen = np.concatenate([y[k] - rest[0], 0.05 * (v[k] - rest[1])])
            out.append(np.linalg.lstsq(rows, seen, rcond=None)[0])
        return out

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
        rows, scale = self.state_scale(nets[0], index)
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
                starts = [self.guess(net, i)]
                if last is not None and problem.records[i].follows(problem.records[last[0]]):
                    k, end = last[0], len(problem.records[last[0]]) - 1
                    before, now = self.along(structure, x, k, last[1].initial[k], (end - 1, end))
                    ahead = 2 * now - before
                    starts = [self.guess(net, i, ahead), ahead, *starts]
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
        keep: bool = False,
        frozen: bool = False,
        quit_above: float = math.inf,
    ) -> Fit:
        """Fit the structure to the given records (the estimation records by default).

        `frozen`: only initial states and offsets move. `quit_above`: give up where two steps leave the cost above it.
        """
        problem = self.problem
        records = problem.estimation if records is None else records
        x = structure.start if x is None else x.copy()
        net = structure.at(x)
        n0 = assemble(bare(net)).size[0]
        initial = {
            i: initial[i].copy() if initial and i in initial and len(initial[i]) == n0 else self.guess(net, i)
            for i in records
        }
        ny = len(problem.channels)
        offset = {i: (offset[i].copy() if offset and i in offset else np.zeros(ny)) for i in records}
        mean = np.array([f.mean for f in structure.free])
        sigma = np.array([f.sigma for f in structure.free])
        low = np.array([f.low for f in structure.free])
        high = np.array([f.high for f in structure.free])
        p = 0 if frozen else len(x)
        damping = 1e-4
        point = self._linearise(structure, x, initial, offset, records, p)
        cost = point[0] + self._prior(structure, x, initial, mean, sigma)
        if not math.isfinite(cost):
            raise InputError("the simulation breaks down at the start values")
        for iteration in range(iterations):
            total, H, g, nuisance, outs = point
            H, g = H.copy(), g.copy()
            H[np.arange(p), np.arange(p)] += 1.0 / sigma[:p] ** 2
            g[:p] += (mean[:p] - x[:p]) / sigma[:p] ** 2
            improved = False
            for _ in range(6):
                D = np.diag(H).copy()
                if p:
                    A = H + np.diag(damping * D)
                    free = np.ones(p, bool)
                    for _ in range(3):  # steps that leave the limits are held there
                        step = np.zeros(p)
                        idx = np.flatnonzero(free)
                        if len(idx):
                            step[idx] = np.linalg.solve(A[np.ix_(idx, idx)], g[idx])
                        out = (x + step < low - 1e-12) & (x <= low + 1e-9) | (x + step > high + 1e-12) & (
                            x >= high - 1e-9
                        )
                        if not np.any(out & free):
                            break
                        free &= ~out
                    limit = np.where([f.log for f in structure.free], 1.5, 3.0 * np.maximum(np.abs(x), sigma))
                    limit[[f.path.endswith(".phase") for f in structure.free]] = 1.0
                    step = np.clip(step, -limit, limit)
                    trial = np.clip(x + step, low, high)
                    step = trial - x
                else:
                    step, trial = np.zeros(0), x
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
            if iteration >= 2 and cost > quit_above:
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
            self._known[key] = (structure, self.state_scale(structure.network, index))
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
