"""Differential dynamic programming through the simulator's kernel, for one car with one current on one road.

Gauss-Newton over the control steps, with the state (z, preceding current) and the input dI; z are the
network's states and the memory of its laws. The limits are primal-dual log barriers, and the Jacobians are
differences through the kernel, so that any network is possible. Besides squares, the cost may have terms
linear in z and the current at every step (`Objective`).
"""

from __future__ import annotations

import functools
import math
import types
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from isd_gym.physics._kernel import jit
from isd_gym.physics._kernel.compiled import Kernel, kernel_of

if TYPE_CHECKING:
    from collections.abc import Callable

    from isd_gym.physics._kernel.layout import Layout

PIECE = 40  # control steps with a common step length
CAUTION = 0.5  # additional curvature, as a share of the value function's, of deviations at the end of a piece
ALPHAS = (1.0, 0.4, 0.1, 0.0)  # trial step lengths

# functions of the kernel, bound at compilation, see `compiled`
advance: Callable
measure: Callable


class Car(NamedTuple):
    """Kernel data of a car: numbers, start, and the road of the episode, as created by `Plant`.

    Attributes:
        mats: Numbers of the plant.
        ints: Sizes of the plant.
        start: State of the kernel (states, 1).
        road: Inputs (physics steps + 1, inputs, 1).
        rows: Rows (nz,) of the kernel's state that form z.
        substeps: Physics steps per control step.
        currents: Number of currents, at least 1; the first is driven.
        outputs: Number of outputs; the first three are in the cost.
    """

    mats: np.ndarray
    ints: np.ndarray
    start: np.ndarray
    road: np.ndarray
    rows: np.ndarray
    substeps: int
    currents: int
    outputs: int


class Objective(NamedTuple):
    """Sum over the steps of ``squares . y^2 + current I^2 + slope_z . z + slope_i I`` and the barriers of |dI| and |I|.

    y is at the end of the step, z at its start; I is held over the step.

    Attributes:
        squares: Weights (3,) of the squared outputs.
        current: Weight of the squared current [1/A^2].
        slope_z: Linear weights (steps, nz) of z.
        slope_i: Linear weights (steps,) of I [1/A].
        slew: Limit of |dI| [A].
        most: Limit of |I| [A].
        barrier: Weight of the barriers.
    """

    squares: np.ndarray
    current: float
    slope_z: np.ndarray
    slope_i: np.ndarray
    slew: float
    most: float
    barrier: float


class Plan(NamedTuple):
    """Feedback law ``dI = nominal + alpha feedforward - feedback (z - z nominal, I - I nominal)`` with its value function.

    Attributes:
        z: Nominal z (steps, nz).
        current: Nominal current (steps,) [A].
        feedforward: Changes (steps,) [A].
        feedback: Gains (steps, nz + 1).
        values: Curvature of the value function (steps, nz + 1, nz + 1).
        slopes: Slope of the value function (steps, nz + 1).
    """

    z: np.ndarray
    current: np.ndarray
    feedforward: np.ndarray
    feedback: np.ndarray
    values: np.ndarray
    slopes: np.ndarray


class Path(NamedTuple):
    """A rollout.

    Attributes:
        z: z at the start of each step (steps, nz).
        state: State of the kernel at the start of each step (steps, ...).
        current: Current of each step (steps,) [A].
        outputs: Outputs at the end of each step (steps, 3).
    """

    z: np.ndarray
    state: np.ndarray
    current: np.ndarray
    outputs: np.ndarray


class Slopes(NamedTuple):
    """Derivatives by (z, I) at every step.

    Attributes:
        z: Derivatives of the next z (steps, nz, nz + 1).
        outputs: Derivatives of the outputs (steps, 3, nz + 1).
    """

    z: np.ndarray
    outputs: np.ndarray


def rollout(car, objective, plan, alphas, path, chosen):
    """Roll out a plan within the barriers, and fill `path`.

    Every `PIECE` steps use one of the `alphas` (`chosen`): the step length with the least cost of the piece
    plus the value function at its end, with `CAUTION` times additional curvature. Friction bends the model in
    places; a common step length would be that of the worst place.

    Args:
        car: Kernel data of the car.
        objective: Minimised cost.
        plan: Feedback law.
        alphas: Trial step lengths.
        path: Rollout, filled.
        chosen: Step length of each piece, filled.
    """
    steps, nz = plan.current.shape[0], car.rows.shape[0]
    slew, most, barrier, sub = objective.slew, objective.most, objective.barrier, car.substeps
    state, begin = car.start.copy(), car.start.copy()
    c = np.zeros((sub, car.currents, 1))
    y = np.empty((car.outputs, 1))
    lanes = y.shape[1]  # a literal 1 would compile the kernel once more
    dz = np.empty(nz + 1)
    last_begin = 0.0
    many = alphas.shape[0]
    first = 0
    while first < steps:
        stop = min(first + PIECE, steps) if many > 1 else steps
        begin[:] = state
        best, best_at = np.inf, 0
        # the last round repeats the best trial, unless the best was the last
        for trial in range(many + 1):
            if trial == many and best_at == many - 1:
                break
            alpha = alphas[trial] if trial < many else alphas[best_at]
            state[:] = begin
            last = last_begin
            total = 0.0
            for k in range(first, stop):
                last_nominal = plan.current[k - 1] if k > 0 else 0.0
                path.state[k] = state[:, 0]
                for i in range(nz):
                    path.z[k, i] = state[car.rows[i], 0]
                    total += objective.slope_z[k, i] * path.z[k, i]
                step = plan.current[k] - last_nominal
                d = step + alpha * plan.feedforward[k]
                for i in range(nz):
                    d -= plan.feedback[k, i] * (path.z[k, i] - plan.z[k, i])
                d -= plan.feedback[k, nz] * (last - last_nominal)
                # a feedback must not cross a barrier: at most 99.5 % of the distance from the nominal value
                high = min(slew, most - last)
                low = max(-slew, -most - last)
                inside = (
                    step
                    if low < step < high
                    else min(max(step, 0.99 * low + 0.01 * high), 0.01 * low + 0.99 * high)
                )
                d = min(max(d, inside + 0.995 * (low - inside)), inside + 0.995 * (high - inside))
                last = last + d
                path.current[k] = last
                for i in range(sub):
                    c[i, 0, 0] = last
                advance(car.mats, car.ints, state, car.road[k * sub : (k + 1) * sub + 1], c, lanes)
                measure(car.mats, car.ints, state, car.road[(k + 1) * sub], c[sub - 1], lanes, y)
                total += objective.current * last * last + objective.slope_i[k] * last
                for m in range(3):
                    path.outputs[k, m] = y[m, 0]
                    total += objective.squares[m] * y[m, 0] * y[m, 0]
                if barrier > 0.0:
                    total -= barrier * math.log((slew - d) * (slew + d) * (most - last) * (most + last))
            if stop < steps:
                for i in range(nz):
                    dz[i] = state[car.rows[i], 0] - plan.z[stop, i]
                dz[nz] = last - plan.current[stop - 1]
                for i in range(nz + 1):
                    t = plan.slopes[stop, i]
                    for j in range(nz + 1):
                        t += 0.5 * (1.0 + CAUTION) * plan.values[stop, i, j] * dz[j]
                    total += t * dz[i]
            if total < best:
                best, best_at = total, trial
        if many > 1:
            chosen[first // PIECE] = alphas[best_at]
        last_begin = last
        first = stop


def jacobian(car, path, delta, slopes):
    """Fill `slopes` with difference quotients of the next z and the outputs by (z, I) for every control step.

    Args:
        car: Kernel data with nz + 2 lanes.
        path: Rollout.
        delta: Increments (nz + 1,).
        slopes: Derivatives, filled.
    """
    steps, nz, sub = path.current.shape[0], car.rows.shape[0], car.substeps
    lanes = nz + 2
    state = np.empty((path.state.shape[1], lanes))
    c = np.zeros((sub, car.currents, lanes))
    y = np.empty((car.outputs, lanes))
    w = np.empty((sub + 1, car.road.shape[1], lanes))
    for k in range(steps):
        for i in range(sub + 1):
            for j in range(car.road.shape[1]):
                w[i, j, :] = car.road[k * sub + i, j, 0]
        for l in range(lanes):
            state[:, l] = path.state[k]
            if l < nz:
                state[car.rows[l], l] += delta
            for i in range(sub):
                c[i, 0, l] = path.current[k] + (delta if l == nz else 0.0)
        advance(car.mats, car.ints, state, w, c, lanes)
        measure(car.mats, car.ints, state, w[sub], c[sub - 1], lanes, y)
        for l in range(nz + 1):
            for i in range(nz):
                slopes.z[k, i, l] = (state[car.rows[i], l] - state[car.rows[i], nz + 1]) / delta
            for i in range(3):
                slopes.outputs[k, i, l] = (y[i, l] - y[i, nz + 1]) / delta


@jit.compiled(error_model="numpy")
def backward(slopes, path, objective, duals, caution, plan):
    """Run one Riccati sweep about a trajectory, and fill the plan and its value function.

    Args:
        slopes: Derivatives along the trajectory.
        path: The trajectory.
        objective: Minimised cost.
        duals: Multipliers (steps, 4) of the upper and lower barriers of dI and of I.
        caution: Curvature added in each piece.
        plan: Feedback law, filled.

    Returns:
        False for a problem that is not convex.
    """
    Y, I = path.outputs, path.current
    FZ, YZ = slopes.z, slopes.outputs
    steps, nz = I.shape[0], FZ.shape[1]
    n = nz + 1
    slew, most, qi, mu = objective.slew, objective.most, objective.current, objective.barrier
    V, v = np.zeros((n, n)), np.zeros(n)
    F, b = np.zeros((n, n)), np.zeros(n)
    VF = np.empty((n, n))
    Q, p = np.empty((n, n)), np.empty(n)
    s = np.empty(n)
    for k in range(steps - 1, -1, -1):
        now = I[k]
        d = now - (I[k - 1] if k > 0 else 0.0)
        for i in range(nz):
            for j in range(n):
                F[i, j] = FZ[k, i, j]
            b[i] = FZ[k, i, nz]
        for j in range(nz):
            F[nz, j] = 0.0
        F[nz, nz], b[nz] = 1.0, 1.0
        # cost to go through the dynamics
        for i in range(n):
            for j in range(n):
                t = 0.0
                for r in range(n):
                    t += V[i, r] * F[r, j]
                VF[i, j] = t
        for i in range(n):
            t = objective.slope_z[k, i] if i < nz else 0.0
            for r in range(n):
                t += F[r, i] * v[r]
            p[i] = t
            for j in range(i + 1):
                t = 0.0
                for r in range(n):
                    t += F[r, i] * VF[r, j]
                Q[i, j] = t
                Q[j, i] = t
            t = 0.0
            for r in range(n):
                t += b[r] * VF[r, i]
            s[i] = t
        r0, g = 0.0, 0.0
        for i in range(n):
            t = 0.0
            for r in range(n):
                t += V[i, r] * b[r]
            r0 += b[i] * t
            g += b[i] * v[i]
        # stage cost; the outputs depend on (z, I), and I is the last state plus the input
        for m in range(3):
            w = 2.0 * objective.squares[m]
            if w != 0.0:
                yi = YZ[k, m, nz]
                for i in range(n):
                    p[i] += w * Y[k, m] * YZ[k, m, i]
                    s[i] += w * yi * YZ[k, m, i]
                    for j in range(n):
                        Q[i, j] += w * YZ[k, m, i] * YZ[k, m, j]
                g += w * Y[k, m] * yi
                r0 += w * yi * yi
        h1 = 2.0 * qi * now + objective.slope_i[k] + mu * (1.0 / (most - now) - 1.0 / (most + now))
        h2 = 2.0 * qi + duals[k, 2] / (most - now) + duals[k, 3] / (most + now)
        p[nz] += h1
        g += h1
        Q[nz, nz] += h2
        s[nz] += h2
        r0 += h2
        g += mu * (1.0 / (slew - d) - 1.0 / (slew + d))
        r0 += duals[k, 0] / (slew - d) + duals[k, 1] / (slew + d)
        r1 = r0 + caution[k // PIECE]
        if not r1 > 0.0:
            return False
        plan.feedforward[k] = -g / r1
        for i in range(n):
            plan.feedback[k, i] = s[i] / r1
        for i in range(n):
            v[i] = p[i] + s[i] * plan.feedforward[k] - plan.feedback[k, i] * (g + r0 * plan.feedforward[k])
            for j in range(i + 1):
                t = Q[i, j] - plan.feedback[k, i] * s[j] - s[i] * plan.feedback[k, j]
                t += plan.feedback[k, i] * r0 * plan.feedback[k, j]
                V[i, j] = t
                V[j, i] = t
        plan.values[k], plan.slopes[k] = V, v
    return True


class Compiled(NamedTuple):
    """`rollout` and `jacobian` compiled with the kernel of the registered laws.

    Attributes:
        rollout: See `rollout`.
        jacobian: See `jacobian`.
    """

    rollout: Callable
    jacobian: Callable


@functools.cache
def _bind(own: Kernel) -> Compiled:
    names: dict[str, Any] = {**globals(), "advance": own.advance, "measure": own.measure}
    flavour = own.advance.__qualname__.partition("_")[2]  # the name includes the compiled laws
    made = []
    for plain in (rollout, jacobian):
        twin = types.FunctionType(plain.__code__, names, plain.__name__)
        twin.__qualname__ = f"{plain.__name__}_{flavour}"
        made.append(jit.compiled(nogil=True, error_model="numpy")(twin))
    return Compiled(*made)


def compiled(at: Layout) -> Compiled:
    """Return the compiled functions of the descent.

    Args:
        at: Layout of the networks.

    Returns:
        `rollout` and `jacobian`.
    """
    return _bind(kernel_of(at))
