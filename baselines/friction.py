"""Friction-aware MPC: stick, slip, slew limit and end stop in the prediction, solved as a box-limited DDP.

The prediction is the car at the control step, with an exact linear part and implicit friction (which holds or
resists at the end of the step). The effect of the unknown road on the friction's rate is averaged: the
expected friction is ``f erf(v / (sqrt(2) sigma_k))`` with the spread sigma_k that the road causes k steps
ahead. This is a statistical linearisation about the plan instead of about rest, and makes the problem smooth.
Gauss-Newton differential dynamic programming (Tassa, Mansard and Todorov, 2014) improves the plan. One input
with its box needs no solver: only a compiled backward and forward sweep over the horizon. There is no
quadratic program and no OSQP; the optimum is local.

Tuned one setting at a time on roads 1000-1015, J against passive: -23.86 % as shipped; horizon 40 -23.87, six
sweeps -23.86, no weight on tyre load -23.86 (with +3.0 % tyre load instead of +2.5), centring 0.01/0.1
-23.29/-23.48, move 0.01/0.1 -23.67/-23.35; with the true state instead of the estimate -24.21. The optimum is
flat; `docs/explanation/baselines.md` has the complete table.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from isd_gym._common import jit
from isd_gym._common.errors import InputError
from isd_gym.physics.prediction import (
    ROAD_INTENSITY,
    Model,
    Sensors,
    Weights,
    device_reach,
    equivalent_damping,
    move_regulator,
    prediction_model,
)
from isd_gym.physics.vehicle import CURRENT_LIMIT

from ._estimator import Estimator
from .controller import CURRENT, DesignedController, rises, steps_ahead

__all__ = [
    "FrictionMpcSettings",
]


class _Problem(NamedTuple):
    """The prediction model and the weights of a plan, for compiled code.

    The states are n, the laws nl, the weighted signals ny, and the steps of the horizon N.
    """

    A: np.ndarray  # state matrix (n, n)
    B: np.ndarray  # response of the state to the current (n,)
    G: np.ndarray  # response of the state to the forces (n, nl)
    P: np.ndarray  # response of the state to a rise of the road (n,)
    C: np.ndarray  # weighted signals by the state (ny, n)
    D: np.ndarray  # weighted signals by the current (ny,)
    F: np.ndarray  # weighted signals by the forces (ny, nl)
    #: rate of a friction or elongation of a stop, by the state (nl, n)
    motion: np.ndarray
    motion_current: np.ndarray  # and by the current (nl,)
    coupling: np.ndarray  # and by the forces (nl, nl)
    is_dry: np.ndarray  # whether a law is friction (nl,)
    level: np.ndarray  # level of a friction (nl,) [N]
    stiffness: np.ndarray  # stiffness of a stop (nl,) [N/m]
    clearance: np.ndarray  # clearance of a stop (nl,) [m]
    spread: np.ndarray  # spread of the rate of a friction (N, nl) [m/s]
    weights: np.ndarray  # weights of the signals (ny,)
    current_weight: float  # weight of the current [1/A^2]
    move_weight: float  # weight of the change of current [1/A^2]
    value: np.ndarray  # cost-to-go of the state and the current (n + 1, n + 1)
    slew: float  # largest change of current per step [A]


class _Path(NamedTuple):
    """Course of a plan over N steps, for compiled code."""

    states: np.ndarray  # (N + 1, n)
    currents: np.ndarray  # (N + 1,) [A]
    forces: np.ndarray  # forces of the laws at the end of a step (N, nl) [N]
    slopes: np.ndarray  # derivative of these forces by their rate or elongation (N, nl)
    signals: np.ndarray  # weighted signals (N, ny)


class _Feedback(NamedTuple):
    """Result of a backward sweep, for compiled code."""

    gains: np.ndarray  # gains of the move on state and current (N, n + 1)
    changes: np.ndarray  # open-loop changes of the moves (N,) [A]
    nominal: np.ndarray  # states and currents about which the gains hold (N, n + 1)


@jit.compiled(error_model="numpy")
def _empty_path(problem, steps):
    """Return a path of zeros."""
    n, laws, signals = len(problem.A), len(problem.level), len(problem.weights)
    return _Path(
        states=np.zeros((steps + 1, n)),
        currents=np.zeros(steps + 1),
        forces=np.zeros((steps, laws)),
        slopes=np.zeros((steps, laws)),
        signals=np.zeros((steps, signals)),
    )


@jit.compiled(error_model="numpy")
def _empty_feedback(problem, steps):
    """Return a feedback of zeros."""
    width = len(problem.A) + 1
    return _Feedback(
        np.zeros((steps, width)), np.zeros(steps), np.zeros((steps, width))
    )


@jit.compiled(error_model="numpy")
def _scale(out, vector, factor):
    """Write a multiple of a vector."""
    for i in range(len(out)):
        out[i] = vector[i] * factor


@jit.compiled(error_model="numpy")
def _start_with(out, last):
    """Write zeros, and `last` into the last column."""
    width = out.shape[1]
    for i in range(out.shape[0]):
        for k in range(width):
            out[i, k] = 0.0
        out[i, width - 1] = last[i]


@jit.compiled(error_model="numpy")
def _add_product(out, left, right):
    """Add the product of two matrices; columns of `left` beyond the rows of `right` are ignored."""
    for i in range(out.shape[0]):
        for k in range(out.shape[1]):
            total = out[i, k]
            for j in range(right.shape[0]):
                total += left[i, j] * right[j, k]
            out[i, k] = total


@jit.compiled(error_model="numpy")
def _add_upper_half(out, left, right):
    """Add the upper half of ``left.T @ right``; rows of `right` beyond those of `left` are ignored."""
    for i in range(out.shape[0]):
        for k in range(i, out.shape[1]):
            total = out[i, k]
            for j in range(left.shape[0]):
                total += left[j, i] * right[j, k]
            out[i, k] = total


@jit.compiled(error_model="numpy")
def _add_image(out, matrix, vector):
    """Add the product of a matrix and a vector; columns beyond the length of the vector are ignored."""
    for i in range(len(out)):
        total = out[i]
        for j in range(len(vector)):
            total += matrix[i, j] * vector[j]
        out[i] = total


@jit.compiled(error_model="numpy")
def _add_transposed_image(out, matrix, vector):
    """Add ``matrix.T @ vector``."""
    for i in range(len(out)):
        total = out[i]
        for j in range(matrix.shape[0]):
            total += matrix[j, i] * vector[j]
        out[i] = total


@jit.compiled(error_model="numpy")
def _solve(matrix, right):
    """Replace `right` by the solution of ``matrix @ x = right``, by elimination without pivots; `matrix` is overwritten.

    The matrix is a perturbed identity with a growing diagonal.
    """
    size = len(matrix)
    columns = right.shape[1]
    for j in range(size):
        for i in range(j + 1, size):
            share = matrix[i, j] / matrix[j, j]
            for k in range(j, size):
                matrix[i, k] -= share * matrix[j, k]
            for k in range(columns):
                right[i, k] -= share * right[j, k]
    for j in range(size - 1, -1, -1):
        for k in range(columns):
            for i in range(j + 1, size):
                right[j, k] -= matrix[j, i] * right[i, k]
            right[j, k] /= matrix[j, j]


@jit.compiled(error_model="numpy")
def _friction(rest, gain, level, spread):
    """Return the expected friction and its derivative by the rate, for a rate `rest` without the friction.

    The rate is the only root of ``v = rest + gain * level * erf(v / (sqrt(2) * spread))`` with a gain below 0, found by a
    bracketed Newton iteration.
    """
    s = math.sqrt(2.0) * spread
    low, high = rest + gain * level, rest - gain * level
    v = rest / (1.0 - gain * level * 2.0 / math.sqrt(math.pi) / s)
    slope = 0.0
    for _ in range(8):
        error = v - rest - gain * level * math.erf(v / s)
        slope = level * 2.0 / math.sqrt(math.pi) / s * math.exp(-((v / s) ** 2))
        if error > 0.0:
            high = v
        else:
            low = v
        new = v - error / (1.0 - gain * slope)
        if not (low <= new <= high):
            new = 0.5 * (low + high)
        if abs(new - v) < 1e-9:
            break
        v = new
    return level * math.erf(v / s), slope


@jit.compiled(error_model="numpy")
def _stop(rest, gain, stiffness, clearance):
    """Return the force of a stop and its derivative by the elongation, for an elongation `rest` without the force."""
    over = abs(rest) - clearance
    if over <= 0.0:
        return 0.0, 0.0
    return math.copysign(stiffness * over / (1.0 - stiffness * gain), rest), stiffness


@jit.compiled(error_model="numpy")
def _forces(
    free, k, is_dry, level, stiffness, clearance, coupling, spread, forces, slopes
):
    """Compute the forces of the laws at the end of step `k`, and their slopes.

    `free` (nl,) are the rates (friction) or elongations (stops) without the forces.
    """
    laws = len(free)
    for j in range(laws):
        forces[k, j] = 0.0
    for _ in range(min(laws, 2)):  # a single law needs no repetition
        for j in range(laws):
            rest = free[j]
            for i in range(laws):
                if i != j:
                    rest += coupling[j, i] * forces[k, i]
            gain = coupling[j, j]
            if is_dry[j]:
                forces[k, j], slopes[k, j] = _friction(
                    rest, gain, level[j], spread[k, j]
                )
            else:
                forces[k, j], slopes[k, j] = _stop(
                    rest, gain, stiffness[j], clearance[j]
                )


@jit.compiled(error_model="numpy")
def _allowed(move, current, slew):
    """Return the nearest move that obeys the limits of current and slew."""
    return min(
        max(move, -slew, -CURRENT_LIMIT - current), slew, CURRENT_LIMIT - current
    )


@jit.compiled(error_model="numpy")
def _roll(start, current, moves, feedback, share, road, problem, path):
    """Roll the plan forward and return its cost (half the stage costs).

    A `share` above 0 changes the moves by this share of the open-loop changes and by the feedback.
    """
    # named once: compiled code counts references at every access to an array of a tuple
    A, B, G, P, C, D, F = (
        problem.A,
        problem.B,
        problem.G,
        problem.P,
        problem.C,
        problem.D,
        problem.F,
    )
    motion, motion_current, coupling = (
        problem.motion,
        problem.motion_current,
        problem.coupling,
    )
    is_dry, level, stiffness = problem.is_dry, problem.level, problem.stiffness
    clearance, spread, weights, value = (
        problem.clearance,
        problem.spread,
        problem.weights,
        problem.value,
    )
    states, currents, forces, slopes = (
        path.states,
        path.currents,
        path.forces,
        path.slopes,
    )
    signals, gains, changes, nominal = (
        path.signals,
        feedback.gains,
        feedback.changes,
        feedback.nominal,
    )
    n, steps, laws = len(A), len(moves), len(level)
    free = np.empty(laws)
    cost = 0.0
    states[0], currents[0] = start, current
    for k in range(steps):
        move = moves[k]
        if share > 0.0:
            move += share * changes[k] + gains[k, n] * (currents[k] - nominal[k, n])
            for i in range(n):
                move += gains[k, i] * (states[k, i] - nominal[k, i])
            move = _allowed(move, currents[k], problem.slew)
            moves[k] = move
        current = currents[k] + move
        currents[k + 1] = current
        for i in range(n):
            after = B[i] * current + P[i] * road[k]
            for j in range(n):
                after += A[i, j] * states[k, j]
            states[k + 1, i] = after
        for j in range(laws):
            rate = motion_current[j] * current
            for i in range(n):
                rate += motion[j, i] * states[k + 1, i]
            free[j] = rate
        _forces(
            free,
            k,
            is_dry,
            level,
            stiffness,
            clearance,
            coupling,
            spread,
            forces,
            slopes,
        )
        for i in range(n):
            for j in range(laws):
                states[k + 1, i] += G[i, j] * forces[k, j]
        cost += 0.5 * (
            problem.move_weight * move * move
            + problem.current_weight * current * current
        )
        for r in range(len(weights)):
            signal = D[r] * current
            for i in range(n):
                signal += C[r, i] * states[k + 1, i]
            for j in range(laws):
                signal += F[r, j] * forces[k, j]
            signals[k, r] = signal
            cost += 0.5 * weights[r] * signal * signal
    for i in range(n):
        for j in range(n):
            cost += 0.5 * value[i, j] * states[steps, i] * states[steps, j]
        cost += value[i, n] * states[steps, i] * currents[steps]
    return cost + 0.5 * value[n, n] * currents[steps] ** 2


@jit.compiled(error_model="numpy")
def _differentiate_step(problem, slopes, k, state, forces, signals, system):
    """Compute the derivatives of next state, forces and signals by (state, current) at step `k`; `system` (nl, nl) is scratch."""
    A, B, coupling = problem.A, problem.B, problem.coupling
    n, laws = len(A), len(coupling)
    is_free = True
    for j in range(laws):
        is_free = is_free and slopes[k, j] == 0.0
    for i in range(n):
        for r in range(n):
            state[i, r] = A[i, r]
        state[i, n] = B[i]
    _start_with(forces, problem.motion_current)
    if is_free:
        for j in range(laws):
            forces[j, n] = 0.0
    else:
        _add_product(forces, problem.motion, state)
        for j in range(laws):
            for r in range(n + 1):
                forces[j, r] *= slopes[k, j]
            for r in range(laws):
                system[j, r] = -slopes[k, j] * coupling[j, r]
            system[j, j] += 1.0
        _solve(system, forces)
        _add_product(state, problem.G, forces)
    _start_with(signals, problem.D)
    _add_product(signals, problem.C, state)
    _add_product(signals, problem.F, forces)


@jit.compiled(error_model="numpy")
def _sweep(moves, problem, path, feedback):
    """Run the backward sweep over a plan, and write the feedback of the moves within their limits."""
    weights, states, currents, slopes = (
        problem.weights,
        path.states,
        path.currents,
        path.slopes,
    )
    gains, changes, nominal = feedback.gains, feedback.changes, feedback.nominal
    n, steps, laws, ny = len(problem.A), len(moves), len(problem.level), len(weights)
    state, forces, signals = (
        np.empty((n, n + 1)),
        np.empty((laws, n + 1)),
        np.empty((ny, n + 1)),
    )
    system = np.empty((laws, laws))
    weighted = np.empty((ny, n + 1))
    value, across, curvature = (
        problem.value.copy(),
        np.empty((n + 1, n + 1)),
        np.empty((n + 1, n + 1)),
    )
    slope, gradient = np.empty(n + 1), np.empty(n + 1)
    _scale(slope, value[:, n], currents[steps])
    _add_image(slope, value, states[steps])
    for k in range(steps - 1, -1, -1):
        current, after = currents[k], currents[k + 1]
        _differentiate_step(problem, slopes, k, state, forces, signals, system)
        for r in range(ny):
            for i in range(n + 1):
                weighted[r, i] = signals[r, i] * weights[r]
        _start_with(across, value[:, n])
        _add_product(across, value, state)
        for i in range(n + 1):
            gradient[i] = 0.0
            for r in range(n + 1):
                curvature[i, r] = 0.0
        gradient[n] = slope[n]
        _add_transposed_image(gradient, state, slope)
        _add_transposed_image(gradient, weighted, path.signals[k])
        gradient[n] += problem.current_weight * after
        for r in range(n + 1):
            curvature[n, r] = across[n, r]
        _add_upper_half(curvature, state, across)
        _add_upper_half(curvature, weighted, signals)
        for i in range(n + 1):
            for r in range(i):
                curvature[i, r] = curvature[r, i]
        curvature[n, n] += problem.current_weight
        by_move = gradient[n] + problem.move_weight * moves[k]
        twice_by_move = curvature[n, n] + problem.move_weight
        best = -by_move / twice_by_move
        low = max(-problem.slew, -CURRENT_LIMIT - current) - moves[k]
        high = min(problem.slew, CURRENT_LIMIT - current) - moves[k]
        change = min(max(best, low), high)
        changes[k] = change
        nominal[k, n] = current
        for i in range(n):
            nominal[k, i] = states[k, i]
        is_within = low < best < high
        for i in range(n + 1):
            by_both = curvature[i, n]
            if is_within:
                gains[k, i] = -by_both / twice_by_move
                slope[i] = gradient[i] - by_both * by_move / twice_by_move
            else:
                gains[k, i] = 0.0
                slope[i] = gradient[i] + by_both * change
            for r in range(n + 1):
                value[i, r] = curvature[i, r]
                if is_within:
                    value[i, r] -= by_both * curvature[r, n] / twice_by_move


@jit.compiled(error_model="numpy")
def _improve(
    start, current, moves, road, problem, iterations, path, other, feedback, trial
):
    """Improve the plan of a car in place, and return its cost; `path` to `trial` are scratch."""
    cost = _roll(start, current, moves, feedback, 0.0, road, problem, path)
    for _ in range(iterations):
        _sweep(moves, problem, path, feedback)
        share, new = 1.0, cost
        for _ in range(5):
            trial[:] = moves
            new = _roll(start, current, trial, feedback, share, road, problem, other)
            if new < cost:
                break
            share *= 0.4
        if not new < cost:
            break
        gained = cost - new
        cost = new
        moves[:] = trial
        path, other = other, path
        if gained < 1e-4 * cost:
            break
    return cost


@jit.compiled(error_model="numpy")
def _plan(x, current, moves, road, problem, iterations):
    """Improve the plans of all cars in place, and return the number of discarded plans (not finite).

    x (n, cars), current (cars,), moves (cars, N), road (cars, N) [m] per step.
    """
    cars, steps = moves.shape
    path, other = _empty_path(problem, steps), _empty_path(problem, steps)
    feedback, trial = _empty_feedback(problem, steps), np.empty(steps)
    broken = 0
    for e in range(cars):
        start, plan, present = np.ascontiguousarray(x[:, e]), moves[e], current[e]
        # the warm start must be feasible from the present current
        for k in range(steps):
            plan[k] = _allowed(plan[k], present, problem.slew)
            present += plan[k]
        cost = _improve(
            start,
            current[e],
            plan,
            road[e],
            problem,
            iterations,
            path,
            other,
            feedback,
            trial,
        )
        if not math.isfinite(cost):
            plan[:] = 0.0
            broken += 1
    return broken


@dataclass(frozen=True)
class FrictionMpcSettings:
    """Settings of the friction-aware MPC. Weights are in addition to the stage cost.

    Raises:
        InputError: The horizon or the number of sweeps is smaller than 1.
    """

    horizon: int = 20  # horizon [steps]
    iterations: int = 2  # largest number of sweeps per step
    move: float = 0.05  # weight of the change of current [1/A^2]
    effort: float = 0.0  # weight of the current [1/A^2]
    tyre_load: float = 0.1  # weight of the tyre load [-]
    centring: float = 0.05  # weight of the device's travel over its stop [-]
    spread: float = 1.0  # factor on the road's share in the friction's rate [-]
    floor: float = 0.005  # smallest spread of the friction's rate [m/s]
    # rate of the linearisation of friction in the cost-to-go [m/s]
    terminal_rate: float = 0.2
    # standard deviation of the estimator's friction per step [N]
    friction_noise: float = 300.0
    # known road ahead [s]; only the road beyond contributes to the spread
    preview: float = 0.0
    #: standard deviations of the measurements in the estimator
    sensors: Sensors = field(default_factory=Sensors)
    # two-sided intensity of the road's velocity [m^2/s]
    road_intensity: float = ROAD_INTENSITY

    def __post_init__(self) -> None:
        if self.horizon < 1 or self.iterations < 1:
            raise InputError("horizon and iterations must be at least 1")


def with_preview(
    settings: FrictionMpcSettings, preview: float, control_step: float
) -> FrictionMpcSettings:
    """Return the settings for a preview [s]: a horizon of at least the preview, and more sweeps for the
    longer plan.

    J against passive on roads 1000-1007, 0.1 s: 2 sweeps -33.10 %, 6 sweeps -33.31; 20 steps more of
    horizon -33.09 (2 sweeps).
    """
    horizon = max(steps_ahead(preview, control_step), settings.horizon)
    return replace(settings, preview=preview, horizon=horizon, iterations=6)


class FrictionMpc(DesignedController[FrictionMpcSettings]):
    """The friction-aware MPC of many cars. `moves` (cars, horizon) are the planned changes of current [A]."""

    usual = "mpc-friction"
    default = FrictionMpcSettings()

    def _design(self) -> None:
        s, model = self.settings, self.model
        self.prediction = m = prediction_model(
            model, self.step, road_intensity=s.road_intensity
        )
        self.weights = w = Weights(
            self.cost, s.move, s.effort, s.centring, device_reach(model)
        )
        self.estimator = Estimator(m, s.sensors, s.friction_noise)
        stops = {e.name: 0.0 for e in m.laws if e.bound is None}
        levels = m.levels()
        damping = {
            m.laws[j].name: equivalent_damping(levels[j], s.terminal_rate)
            for j in m.friction
        }
        linear = prediction_model(
            model, self.step, damping=damping | stops, road_intensity=s.road_intensity
        )
        self._idle = m.thrust == 0.0
        if not self._idle:
            design = replace(w, move=max(w.move, 1e-3), centring=max(w.centring, 1e-3))
            _, V = move_regulator(linear, design)
            self._problem = self._pack(m, linear.A, V)

    def _pack(self, m: Model, A_linear: np.ndarray, value: np.ndarray) -> _Problem:
        is_dry = np.array([e.bound is not None for e in m.laws], bool)
        # friction depends on its rate, a stop on its elongation
        motion = np.where(is_dry[:, None], m.S, m.E)
        coupling = motion @ m.G + np.where(is_dry[:, None], m.SF, 0.0)
        weights = self.weights.signals
        rows = np.flatnonzero(weights)
        return _Problem(
            A=np.ascontiguousarray(m.A),
            B=np.ascontiguousarray(m.B),
            G=np.ascontiguousarray(m.G),
            P=np.ascontiguousarray(m.P),
            C=m.C[rows],
            D=m.D[rows],
            F=m.F[rows],
            motion=motion,
            motion_current=np.where(is_dry, m.SI, 0.0),
            coupling=coupling,
            is_dry=is_dry,
            level=m.levels(),
            stiffness=np.array([getattr(e, "stiffness", 0.0) for e in m.laws]),
            clearance=np.array([getattr(e, "clearance", np.inf) for e in m.laws]),
            spread=self._spread(m, A_linear, motion),
            weights=weights[rows],
            current_weight=float(self.weights.current),
            move_weight=float(self.weights.move),
            value=np.ascontiguousarray(value),
            slew=self.slew,
        )

    def _spread(self, m: Model, A_linear: np.ndarray, motion: np.ndarray) -> np.ndarray:
        """Return the spread of rates or elongations (horizon, laws) that the unknown road causes ahead."""
        s = self.settings
        spread = np.empty((s.horizon, len(m.laws)))
        W = np.zeros((m.n, m.n))
        for k in range(s.horizon):
            if k >= self._points:
                W = A_linear @ W @ A_linear.T + m.W
            deviation = np.sqrt(np.einsum("ji,ik,jk->j", motion, W, motion))
            spread[k] = np.hypot(s.spread * deviation, s.floor)
        return spread

    def _start(self, count: int) -> None:
        self.estimator.reset(count)
        self.moves = np.zeros((count, self.settings.horizon))
        self._road = np.zeros_like(self.moves)

    def _command(self, obs: np.ndarray) -> np.ndarray:
        if self._points:
            width = min(self._points, self.settings.horizon)
            last = self._road[:, 0].copy()
            self._road[:, :width] = rises(obs, width).T
            x = self.estimator.update(obs, last)
        else:
            x = self.estimator.update(obs)
        if self._idle:
            return np.zeros(obs.shape[1])
        self.moves[:, :-1] = self.moves[:, 1:]
        self.moves[:, -1] = 0.0
        # one type of argument: the sweeps are compiled once
        present = np.ascontiguousarray(obs[CURRENT])
        self.fallbacks += _plan(
            x, present, self.moves, self._road, self._problem, self.settings.iterations
        )
        return present + self.moves[:, 0]
