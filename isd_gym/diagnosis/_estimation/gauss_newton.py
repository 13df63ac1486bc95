"""Simulation-error fit: Gauss-Newton with the stated uncertainty of the base parameters as prior (MAP).

Initial states of each record and offsets of the sensors are fitted with the parameters and eliminated from the normal equations.
The offset of a sensor is one number for all records, unless the model has an offset per record. The training records determine the
offset, and validation and test records use it (`Structure.offsets`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from ..._common.errors import InputError
from ...physics.network import Network, assemble
from .._simulation.problem import BROKEN, Problem
from .initial_states import guess, motion_rows
from .least_squares import PROBE, QuadraticModel, Slope, Step, damped
from .sensitivities import tangents

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from ..._common.arrays import Array
    from ...physics.elements import Element
    from .._simulation.problem import Problem
    from .noise import Weights
    from .structure import Hypothesis, Structure


#: damping of the first step, and the smallest one; dampings of a step of initial states alone
DAMPING, LEAST_DAMPING, EASED = 1e-4, 1e-6, (0.0, 0.03, 0.3, 3.0, 100.0)
#: further dampings that a step tries, tenfold each
TRIES = 5
#: decrease of the cost, as a share, below which a fit ends
TOLERANCE = 1e-4
#: error of a lost record, as a share of the deviation
LOST = 0.5


@dataclass
class Point:
    """A point of a fit: parameters, initial states and offsets, with the outputs and the cost of each record."""

    x: Array
    initial: dict[int, Array]
    offset: dict[int, Array]
    outputs: dict[int, Array] = field(default_factory=dict)  # offsets included
    #: weighted squares and the initial state's prior, by record
    costs: dict[int, float] = field(default_factory=dict)
    prior: float = 0.0  # of the parameters
    #: derivatives by record, where they are known
    slopes: dict[int, Slope] = field(default_factory=dict)

    @property
    def total(self) -> float:
        return sum(self.costs.values()) + self.prior if self.costs else math.inf

    def take(self, other: Point, i: int) -> None:
        """Take over initial state, offsets, outputs and cost of a record from another point."""
        self.initial[i], self.offset[i] = other.initial[i], other.offset[i]
        self.costs[i] = other.costs[i]
        if i in other.outputs:
            self.outputs[i] = other.outputs[i]


@dataclass(eq=False)
class Fit:
    """A fitted structure, with the estimate of the shared offsets: free parameters (transformed), initial states, offsets and outputs by
    record."""

    structure: Structure
    x: Array
    initial: dict[int, Array]
    offset: dict[int, Array]
    outputs: dict[int, Array]  # record -> (n, channels), offsets included
    cost: float  # sum of squares of weighted residuals over its records
    prior: float

    @property
    def network(self) -> Network:
        return self.structure.at(self.x)

    @property
    def values(self) -> dict[str, float]:
        """Fitted parameters by path, transformed."""
        return dict(
            zip((f.path for f in self.structure.free), self.x.tolist(), strict=True)
        )

    @property
    def hypotheses(self) -> tuple[Hypothesis, ...]:
        """Effects and places."""
        return self.structure.hypotheses

    @property
    def label(self) -> str:
        """Effects and places in words."""
        return " and ".join(h.label for h in self.hypotheses) or "the model refitted"

    @property
    def elements(self) -> list[Element]:
        """The elements of the effects, with fitted values."""
        network = self.network
        return [network.element(name) for name in self.structure.names]


class Fitter:
    """Gauss-Newton fits of parameters and initial states, or of initial states alone, over the records of a problem."""

    def __init__(self, problem: Problem, weights: Weights):
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

    def price(
        self, structure: Structure, at: Point, outputs: Mapping[int, Array]
    ) -> Point:
        """Return the point with outputs and costs; the cost is infinite where the simulation breaks down."""
        for i, y in outputs.items():
            at.outputs[i] = y + at.offset[i]
            square = math.inf
            if np.isfinite(y).all() and np.abs(y).max() <= 1e12:
                square = float(
                    np.sum(
                        self.weights(self.problem.records[i].measured - at.outputs[i])
                        ** 2
                    )
                )
            x0 = at.initial[i]
            at.costs[i] = square + (
                float(x0 @ self._information(structure, i) @ x0) if len(x0) else 0.0
            )
        return at

    def seen(self, structure: Structure, at: Point, records: Sequence[int]) -> Point:
        """Simulate the records."""
        return self.seen_all(structure, [at], records)[0]

    def seen_all(
        self, structure: Structure, points: Sequence[Point], records: Sequence[int]
    ) -> list[Point]:
        """Simulate the records at several points, side by side."""
        networks = [structure.at(at.x) for at in points]
        begun = {i: np.stack([at.initial[i] for at in points], axis=1) for i in records}
        try:
            found = self.problem.simulate_all(networks, records, begun)
        except BROKEN:
            if len(points) > 1:
                return [self.seen(structure, at, records) for at in points]
            points[0].costs = dict.fromkeys(records, math.inf)
            return list(points)
        return [
            self.price(structure, at, {i: y[:, :, lane] for i, y in found.items()})
            for lane, at in enumerate(points)
        ]

    # -- slopes -----------------------------------------------------------------------------------------
    def linearise(
        self, structure: Structure, at: Point, records: Sequence[int], moves: bool
    ) -> bool:
        """Fill in outputs, costs and derivatives of a point, also derivatives by parameters if `moves`; return False where the simulation
        breaks down."""
        try:
            found = tangents(
                self.problem,
                structure,
                at.x,
                {i: at.initial[i] for i in records},
                moves=moves,
            )
        except BROKEN:
            return False
        self.price(structure, at, {i: t.outputs for i, t in found.items()})
        out = {}
        for i, t in found.items():
            free = self.problem.nuisances(t.outputs)
            common = self.problem.common(t.outputs)[:, :, : None if moves else 0]
            stack = np.concatenate([t.by_parameter, common, t.by_state, free], axis=2)
            if not (math.isfinite(at.costs[i]) and np.isfinite(stack).all()):
                return False
            rows, columns = stack.shape[0] * stack.shape[1], stack.shape[2]
            by = (
                self.weights(stack).reshape(rows, columns)
                if columns
                else np.zeros((rows, 0))
            )
            if not (np.abs(by) < 1e100).all():  # their squares would overflow
                return False
            gram = by.T @ by
            p, n0 = t.by_parameter.shape[2] + common.shape[2], t.by_state.shape[2]
            own = gram[p:, p:].copy()
            known = self._information(structure, i) if n0 else np.zeros((0, 0))
            own[:n0, :n0] += known
            own[np.arange(len(own)), np.arange(len(own))] *= 1 + 1e-9
            out[i] = Slope(by, gram, own, known)
        at.slopes = out
        return True

    def _downhill(self, at: Point, i: int, slope: Slope) -> Array:
        """Return the negative gradient of half the cost (parameters, shared offsets, nuisances)."""
        left = self.weights(self.problem.records[i].measured - at.outputs[i]).ravel()
        down = slope.by.T @ left
        p, n0 = len(down) - len(slope.own), len(slope.known)
        down[p : p + n0] -= slope.known @ at.initial[i]
        return np.asarray(down, dtype=np.float64)

    def _moved(
        self,
        at: Point,
        x: Array,
        moves: Mapping[int, NDArray[np.floating]],
        common: Array | None = None,
    ) -> Point:
        """Return a point with parameters `x`, moved nuisances, and shared offsets moved by `common`."""
        initial, offset = dict(at.initial), {i: o.copy() for i, o in at.offset.items()}
        for i, move in moves.items():
            n0 = len(at.initial[i])
            initial[i] = at.initial[i] + move[:n0]
            offset[i][self.problem.record_offset] += move[n0:]
            if common is not None:
                offset[i][self.problem.shared_offset] += common
        return Point(x, initial, offset)

    # -- fits -------------------------------------------------------------------------------------------
    def begin(
        self,
        structure: Structure,
        x: Array,
        initial: Mapping[int, Array] | None,
        offset: Mapping[int, Array] | None,
        records: Sequence[int],
    ) -> Point:
        net = structure.at(x)
        n0 = assemble(net.mechanical).size[0]
        given, known, problem = initial or {}, offset or {}, self.problem
        shared = structure.offsets
        if known and problem.shared_offset.any():
            shared = tuple(np.mean([*known.values()], axis=0).tolist())
        common = 0.0 if shared is None else shared
        fixed = np.where(problem.shared_offset, common, 0.0)
        out = Point(x.copy(), {}, {})
        for i in records:
            there = i in given and len(given[i]) == n0
            out.initial[i] = (
                given[i].copy() if there else guess(problem, net, i, offsets=shared)
            )
            own = known.get(i, fixed)
            out.offset[i] = np.where(problem.record_offset, own, fixed)
        return out

    def with_offsets(
        self,
        structure: Structure,
        x: Array,
        records: Sequence[int],
    ) -> Structure:
        """Return the structure with the sensor offsets that records share, at fixed parameters."""
        if not self.problem.shared_offset.any():
            return structure
        known = replace(structure, network=structure.at(x), free=())
        fit = self.fit(known, np.zeros(0), records=records)
        return replace(structure, offsets=fit.structure.offsets)

    def fit(
        self,
        structure: Structure,
        x: Array | None = None,
        initial: Mapping[int, Array] | None = None,
        offset: Mapping[int, Array] | None = None,
        *,
        iterations: int = 8,
        records: Sequence[int] | None = None,
    ) -> Fit:
        """Fit the structure to records, by default those to fit by."""
        records = self.problem.estimation if records is None else records
        x = structure.start if x is None else x
        at = self.begin(structure, x, initial, offset, records)
        mean, sigma = structure.mean, structure.sigma
        if iterations:
            is_sound = self.linearise(structure, at, records, True)
        else:
            is_sound = math.isfinite(self.seen(structure, at, records).total)
        if not is_sound:
            raise InputError("the simulation breaks down at the start values")
        at.prior = float(np.sum(((at.x - mean) / sigma) ** 2))
        damping = DAMPING
        for _ in range(iterations):
            if not (at.slopes or self.linearise(structure, at, records, True)):
                break
            then, damping = self._step(structure, at, records, damping)
            if then is None:
                break
            gain, at = 1.0 - then.total / at.total, then
            if gain < TOLERANCE:
                break
        return self._result(structure, at)

    def _step(
        self,
        structure: Structure,
        at: Point,
        records: Sequence[int],
        damping: float,
    ) -> tuple[Point | None, float]:
        """Return a point with a smaller cost, or None, and the next damping: less after a success. Where the first try fails, the best of
        several dampings is taken, each accelerated along a curved valley."""
        shared = int(self.problem.shared_offset.sum())
        down = {i: self._downhill(at, i, s) for i, s in at.slopes.items()}
        model = QuadraticModel(structure, at.x, shared, at.slopes, down)

        def after(step: Step) -> Point:
            x = at.x + step.x[: len(at.x)]
            then = self._moved(at, x, step.nuisances, step.x[len(at.x) :])
            distance = (x - structure.mean) / structure.sigma
            then.prior = float(np.sum(distance**2))
            return then

        then = after(model.step(damping))
        # mostly taken: the next step begins with its slopes
        self.linearise(structure, then, records, True)
        if then.total < at.total:
            return then, max(0.2 * damping, LEAST_DAMPING)
        least = max(10 * damping, 1e-3 if math.isfinite(then.total) else 1.0)
        dampings = [least * 10**k for k in range(TRIES)]
        steps = [model.step(d) for d in dampings]
        probes = [after(step.scaled(PROBE)) for step in steps]
        self.seen_all(structure, probes, records)
        for k, probe in enumerate(probes):
            if math.isfinite(probe.total):
                changes = {
                    i: self.weights(probe.outputs[i] - at.outputs[i]).ravel()
                    for i in records
                }
                steps[k] = model.accelerated(steps[k], changes, dampings[k])
        points = self.seen_all(structure, [after(step) for step in steps], records)
        k = int(np.argmin([then.total for then in points]))
        then, damping = points[k], dampings[k]
        if not then.total < at.total:
            return None, damping
        return then, max(0.2 * damping, LEAST_DAMPING)

    def _states(
        self,
        structure: Structure,
        at: Point,
        records: Sequence[int],
        iterations: int,
    ) -> Point:
        """Fit initial states and offsets of each record; parameters and shared offsets stay."""
        left = list(records)
        for turn in range(max(iterations, 1)):
            is_sound = self.linearise(structure, at, left, False)
            if not is_sound and turn == 0:
                raise InputError("the simulation breaks down at the start values")
            if not is_sound or not iterations:
                break
            slopes = at.slopes
            left = [i for i in left if len(slopes[i].own)]
            if not left:
                break
            down = {i: self._downhill(at, i, slopes[i]) for i in left}
            tried = []
            for damping in EASED:
                own = {i: damped(slopes[i].own, damping) for i in left}
                moves = {i: np.linalg.solve(own[i], down[i]) for i in left}
                tried.append(self._moved(at, at.x, moves))
            points = self.seen_all(structure, tried, left)
            gains = {}
            for i in left:
                best = min(points, key=lambda then: then.costs[i])
                gains[i] = 1.0 - best.costs[i] / max(at.costs[i], 1e-300)
                if gains[i] > 0.0:
                    at.take(best, i)
            left = [i for i in left if gains[i] > TOLERANCE]
        return at

    def _result(self, structure: Structure, at: Point) -> Fit:
        known = sum(
            float(x0 @ self._information(structure, i) @ x0)
            for i, x0 in at.initial.items()
            if len(x0)
        )
        own = np.flatnonzero(self.problem.shared_offset)
        if len(own):
            offsets = np.zeros(len(self.problem.channels))
            offsets[own] = next(iter(at.offset.values()))[own]
            structure = replace(structure, offsets=tuple(offsets.tolist()))
        return Fit(
            structure,
            at.x,
            at.initial,
            at.offset,
            at.outputs,
            sum(at.costs.values()) - known,
            at.prior,
        )

    def follow(
        self,
        structure: Structure,
        x: Array,
        records: Sequence[int],
        initial: Mapping[int, Array] | None = None,
        *,
        iterations: int = 8,
    ) -> Fit:
        """Fit initial states and offsets of records, from `initial` or from a guess by the first samples; the parameters stay. Over many
        periods the phase of a nonlinear motion follows its amplitude: a lost record starts again from a fit of its first samples."""
        problem = self.problem
        if structure.offsets is None:
            structure = self.with_offsets(structure, x, problem.estimation or records)
        at = self.begin(structure, x, initial, None, records)
        at = self._states(structure, at, records, iterations)
        lost = [
            i
            for i in records
            if not _mean_power(
                problem.records[i].measured - at.outputs[i], problem.deviation([i])
            )
            < LOST**2
        ]
        if lost:
            few = Fitter(problem.heads, self.weights)
            begun = few.begin(structure, x, None, None, lost)
            begun = few._states(structure, begun, lost, iterations)
            again = self.begin(structure, x, begun.initial, None, lost)
            again = self._states(structure, again, lost, iterations)
            for i in lost:
                if again.costs[i] < at.costs[i]:
                    at.take(again, i)
        return self._result(structure, at)

    def normal_equations(
        self,
        structure: Structure,
        x: Array,
        initial: Mapping[int, Array],
        responses: Mapping[int, Array],
        *,
        over: Array | None = None,
    ) -> tuple[Array, Array, dict[int, tuple[Array, Array]]]:
        """Return the normal equations of responses (samples, channels, m), nuisances eliminated: the matrix by parameters and shared
        offsets (p, p) with the prior, the right-hand sides (p, m), and by record the weighted derivatives (rows, p) and responses (rows,
        m). `over`: see `tangents`."""
        problem = self.problem
        p, q = len(x), int(problem.shared_offset.sum())
        H = np.diag(np.append(1 / structure.sigma**2, np.zeros(q)))
        m = next(iter(responses.values())).shape[2]
        g = np.zeros((p + q, m))
        parts = {}
        begun = {i: initial[i] for i in responses}
        for i, t in tangents(problem, structure, x, begun, over=over).items():
            s = responses[i]
            free = problem.nuisances(t.outputs)
            stack = np.concatenate(
                [t.by_parameter, problem.common(t.outputs), t.by_state, free, s], axis=2
            )
            W = self.weights(stack).reshape(-1, stack.shape[2])
            a, b, c = (
                W[:, : p + q],
                W[:, p + q : W.shape[1] - m],
                W[:, W.shape[1] - m :],
            )
            H[np.arange(p, p + q), np.arange(p, p + q)] += 1e-9 * np.sum(
                a[:, p:] ** 2, axis=0
            )
            if b.shape[1]:
                Q, _ = np.linalg.qr(b)
                a, c = a - Q @ (Q.T @ a), c - Q @ (Q.T @ c)
            H += a.T @ a
            g += a.T @ c
            parts[i] = a, c
        return H, g, parts

    def unabsorbed(self, fit: Fit, responses: Mapping[int, Array]) -> dict[int, Array]:
        """Return by record the weighted part of responses (samples, channels, m) that a fit would not absorb to first order."""
        H, g, parts = self.normal_equations(
            fit.structure, fit.x, fit.initial, responses
        )
        shift = np.asarray(np.linalg.solve(H, g), dtype=np.float64)
        return {
            i: (c - a @ shift).reshape(responses[i].shape)
            for i, (a, c) in parts.items()
        }


def residuals(problem: Problem, fit: Fit) -> list[Array]:
    """Return the residuals of each record of a fit (samples, channels)."""
    return [problem.records[i].measured - y for i, y in fit.outputs.items()]


def gap(problem: Problem, fit: Fit) -> float:
    """Return the geometric mean over channels, which limits the influence of a drifting one, of the residual's power over the signal's
    power."""
    return _mean_power(
        np.concatenate(residuals(problem, fit)), problem.deviation(list(fit.outputs))
    )


def _mean_power(residual: Array, deviation: Array) -> float:
    """Return the power of a residual (samples, channels) over the square of a deviation (channels,), geometric mean over channels."""
    share = np.mean(residual**2, axis=0) / np.maximum(deviation**2, 1e-300)
    return float(np.exp(np.mean(np.log(np.maximum(share, 1e-300)))))
