"""Differential dynamic programming through the simulator's own kernel: one car, one road, one current.

Gauss-Newton over the control steps, state (z, current before), input dI; z: the network's states and the memory of its
laws. The limits are primal-dual log barriers, the Jacobians differences through the kernel, so any network will do. Besides
its squares the cost may hold terms that are linear in z and the current at every step (`Objective`).
"""

from __future__ import annotations

import functools
import math
import types
from typing import TYPE_CHECKING, Any, NamedTuple

import numba as nb
import numpy as np

from isd_gym.kernel.compiled import Kernel, kernel_of

if TYPE_CHECKING:
    from collections.abc import Callable

    from isd_gym.kernel.layout import Layout

PIECE = 40  # control steps that share a step length
CAUTION = 0.5  # how much more than its curvature a deviation at the end of a piece is taken to cost
ALPHAS = (1.0, 0.4, 0.1, 0.0)  # step lengths tried

# the kernel's functions: bound where this is compiled, see `compiled`
advance: Callable
measure: Callable


class Car(NamedTuple):
    """What the kernel needs of a car: its numbers, its start, and the road of the episode, as `Plant` makes them."""

    mats: np.ndarray
    ints: np.ndarray
    start: np.ndarray  # (states of the kernel, 1)
    road: np.ndarray  # (physics steps + 1, inputs, 1)
    rows: np.ndarray  # (nz,): rows of the kernel's state that make z
    substeps: int  # physics steps in a control step
    currents: int  # of the network, at least 1; the first is driven
    outputs: int  # of the kernel; the first three are in the cost


class Objective(NamedTuple):
    """Sum over the steps of ``squares . y^2 + current I^2 + slope_z . z + slope_i I`` and the barriers of |dI| and |I|.

    y at the end of the step, z at its start, I held over it.
    """

    squares: np.ndarray  # (3,)
    current: float
    slope_z: np.ndarray  # (steps, nz)
    slope_i: np.ndarray  # (steps,)
    slew: float  # A
    most: float  # A
    barrier: float


class Plan(NamedTuple):
    """``dI = nominal + alpha feedforward - feedback (z - z nominal, I - I nominal)`` and the value function it follows."""

    z: np.ndarray  # (steps, nz), nominal
    current: np.ndarray  # (steps,), nominal
    feedforward: np.ndarray  # (steps,)
    feedback: np.ndarray  # (steps, nz + 1)
    values: np.ndarray  # (steps, nz + 1, nz + 1)
    slopes: np.ndarray  # (steps, nz + 1)


class Path(NamedTuple):
    """A rollout: z (steps, nz) and the kernel's state (steps, ..) at the start of each step, its current, y at its end."""

    z: np.ndarray
    state: np.ndarray
    current: np.ndarray
    outputs: np.ndarray  # (steps, 3)


class Slopes(NamedTuple):
    """Derivatives of the next z and of y by (z, I), every step."""

    z: np.ndarray  # (steps, nz, nz + 1)
    outputs: np.ndarray  # (steps, 3, nz + 1)


def rollout(car, objective, plan, alphas, path, chosen):
    """Roll a plan out, kept inside the barriers; fills `path`.

    Of several `alphas` every `PIECE` steps take their own (`chosen`): that of the least cost of the piece plus the value
    function at its end, with `CAUTION` times its curvature more. Friction bends the model here and there, and one alpha
    for all would be that of the worst place.
    """
    steps, nz = plan.current.shape[0], car.rows.shape[0]
    slew, most, barrier, sub = objective.slew, objective.most, objective.barrier, car.substeps
    state, begin = car.start.copy(), car.start.copy()
    c = np.zeros((sub, car.currents, 1))
    y = np.empty((car.outputs, 1))
    lanes = y.shape[1]  # a literal 1 would have the kernel compiled once more
    dz = np.empty(nz + 1)
    last_begin = 0.0
    many = alphas.shape[0]
    first = 0
    while first < steps:
        stop = min(first + PIECE, steps) if many > 1 else steps
        begin[:] = state
        best, best_at = np.inf, 0
        # the last round repeats the best, unless it was the last one tried
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
                # a feedback may not leap over a barrier: at most 99.5 % of the way from the nominal to it
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
    """Differences of the next z and the outputs with respect to (z, I), every control step; `car` has nz + 2 lanes."""
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


@nb.njit(error_model="numpy", cache=True)
def backward(slopes, path, objective, duals, caution, plan):
    """One Riccati sweep about a trajectory: fills the plan and its value function; False where it is not convex.

    duals (steps, 4): of the barriers of dI above and below and of I; `caution`: curvature added in each piece.
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
        # stage cost; the outputs see (z, I), and I is the last state plus the input
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
    """`rollout` and `jacobian` with the kernel of the laws that are registered now."""

    rollout: Callable
    jacobian: Callable


@functools.cache
def _bind(own: Kernel) -> Compiled:
    names: dict[str, Any] = {**globals(), "advance": own.advance, "measure": own.measure}
    flavour = own.advance.__qualname__.partition("_")[2]  # its laws are compiled in
    made = []
    for plain in (rollout, jacobian):
        twin = types.FunctionType(plain.__code__, names, plain.__name__)
        twin.__qualname__ = f"{plain.__name__}_{flavour}"
        made.append(nb.njit(twin, nogil=True, error_model="numpy", cache=True))
    return Compiled(*made)


def compiled(at: Layout) -> Compiled:
    """Return the descent's functions, compiled when first needed.

    Args:
        at: Layout of the networks that they serve.
    """
    return _bind(kernel_of(at))
