"""The integrator behind the families: masses, moved nodes and links between them, by Runge-Kutta in small steps.

It knows `isd-model/1` and nothing of `isd_gym`, and shares no idea with its kernel or with `reference`: nothing is
assembled, eliminated or projected. Every free node has a mass; a rigid body heaves and pitches by the equations of Newton
and Euler, and its points ride on it; a link's force is a function of its elongation, its rate and one state of its own; dry friction is its level times `clip(v / creep, -1, 1)`, with a creep of 2e-4 of the speeds
that occur, and the step is so short that this stays stable. Motion of a moved node and force are quintic and cubic
between the samples, a motor's current is held.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numba
import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from collections.abc import Mapping

Array = NDArray[np.float64]
Element = dict[str, Any]
Model = dict[str, Any]

GROUND = "ground"
CREEP = 2e-4
"""Speed below which dry friction is viscous, as a share of the plant's typical speed."""

# springs, dampers, dry friction, and links with a state of their own
(
    SPRING,
    CUBIC,
    GAS,
    BUMP,
    PLAY,
    COGGING,
    SINE,
    TANH,
    SWITCHED,
    IMPULSE,
    DAMPER,
    QUADRATIC,
    ASYMMETRIC,
    POSITION,
    THINNING,
    COULOMB,
    STRIBECK,
    TIMED,
    WEDGE,
    BISTABLE,
    HYSTERESIS,
    MAXWELL,
    FADING,
    BUSHING,
) = range(24)
#: type -> (code, parameters in order, with what they are where an element does not say)
LAWS: dict[str, tuple[int, dict[str, float | None]]] = {
    "linear_stiffness": (SPRING, {"stiffness": None}),
    "linear_damping": (DAMPER, {"damping": None}),
    "coulomb_friction": (COULOMB, {"level": None}),
    "stribeck_friction": (
        STRIBECK,
        {"level": None, "static_level": None, "stribeck_velocity": None},
    ),
    "quadratic_damping": (QUADRATIC, {"damping": None}),
    "asymmetric_damping": (ASYMMETRIC, {"extension": None, "compression": None}),
    "cubic_stiffness": (CUBIC, {"stiffness": None}),
    "gas_spring": (GAS, {"force": None, "length": None, "exponent": 1.3}),
    "bump_stop": (BUMP, {"clearance": None, "stiffness": None, "side": 0.0}),
    "hysteresis": (
        HYSTERESIS,
        {"level": None, "stiffness": None, "exponent": 1.0, "shape": 0.5},
    ),
    "cogging_force": (COGGING, {"amplitude": None, "pitch": None, "phase": 0.0}),
    # the spring that stands there, with play: what a backlash in series makes of it
    "x_spring_with_play": (PLAY, {"stiffness": None, "gap": None}),
    # what a spring lacks to be a sine (gravity on a pendulum), or to be a tanh
    "x_sine_less_linear": (SINE, {"stiffness": None, "length": None}),
    "x_tanh_less_linear": (TANH, {"stiffness": None, "length": None}),
    "x_switched_stiffness": (
        SWITCHED,
        {"stiffness": None, "period": None, "duty": None},
    ),
    "x_position_damping": (POSITION, {"damping": None, "length": None}),
    "x_maxwell": (MAXWELL, {"stiffness": None, "time": None}),
    "x_timed_friction": (TIMED, {"level": None, "period": None, "duty": None}),
    "x_wedge_friction": (WEDGE, {"slope": None, "length": None}),
    "x_fading_damping": (FADING, {"damping": None, "energy": None}),
    "x_bistable_friction": (BISTABLE, {"level": None, "width": None}),
    "x_shear_thinning": (THINNING, {"damping": None, "velocity": None}),
    "x_impulse": (IMPULSE, {"force": None, "period": None, "width": None}),
    # the damper that stands there, on an elastic bushing: what a compliance in series makes of it, and a backlash where it has play
    "x_damper_on_bushing": (BUSHING, {"damping": None, "stiffness": None, "gap": 0.0}),
}
SIDES = {"both": 0.0, "extension": 1.0, "compression": -1.0}


@numba.njit(cache=True)
def _beyond_play(d, gap):
    return d - min(max(d, -0.5 * gap), 0.5 * gap)


@numba.njit(cache=True)
def _spring(code, p, d, t):
    if code == SPRING:
        return p[0] * d
    if code == CUBIC:
        return p[0] * d**3
    if code == GAS:
        return p[0] * (1.0 - (1.0 + d / p[1]) ** (-p[2]))
    if code == BUMP:
        if d > p[0] and p[2] >= 0.0:
            return p[1] * (d - p[0])
        return p[1] * (d + p[0]) if d < -p[0] and p[2] <= 0.0 else 0.0
    if code == PLAY:
        return p[0] * _beyond_play(d, p[1])
    if code == COGGING:
        return p[0] * math.sin(2.0 * math.pi * d / p[1] + p[2])
    if code == SINE:
        return p[0] * (p[1] * math.sin(d / p[1]) - d)
    if code == TANH:
        return p[0] * (p[1] * math.tanh(d / p[1]) - d)
    if code == SWITCHED:
        return p[0] * d if (t / p[1]) % 1.0 < p[2] else 0.0
    # IMPULSE: a knock every period that nobody measured
    s = (t / p[1]) % 1.0 * p[1] / p[2]
    return p[0] * math.sin(math.pi * s) if s < 1.0 else 0.0


@numba.njit(cache=True)
def _damper(code, p, d, v):
    if code == DAMPER:
        return p[0] * v
    if code == QUADRATIC:
        return p[0] * v * abs(v)
    if code == ASYMMETRIC:
        return (p[0] if v > 0.0 else p[1]) * v
    if code == POSITION:
        return p[0] * (d / p[1]) ** 2 * v
    return p[0] * v / math.sqrt(1.0 + (v / p[1]) ** 2)  # THINNING


@numba.njit(cache=True)
def _level(code, p, d, v, t):
    """Level of dry friction [N]."""
    if code == STRIBECK:
        return p[0] + (p[1] - p[0]) * math.exp(-((v / p[2]) ** 2))
    if code == TIMED:
        return p[0] if (t / p[1]) % 1.0 < p[2] else 0.0
    if code == WEDGE:  # the further out, the harder it rubs
        return p[0] * p[1] * (d / p[1]) ** 2
    if code == BISTABLE:  # rubs only near the middle
        return p[0] * math.exp(-((d / p[1]) ** 4))
    return p[0]


@numba.njit(cache=True)
def _force(code, p, d, v, z, t):
    """Force of a link and the rate of its own state."""
    if code < DAMPER:
        return _spring(code, p, d, t), 0.0
    if code < COULOMB:
        return _damper(code, p, d, v), 0.0
    if code < HYSTERESIS:
        return _level(code, p, d, v, t) * min(max(v / p[5], -1.0), 1.0), 0.0
    if code == HYSTERESIS:
        w = (abs(z) / p[0]) ** p[2]
        return z, p[1] * (
            v - (p[3] * abs(v) * math.copysign(1.0, z) + (1.0 - p[3]) * v) * w
        )
    if code == MAXWELL:  # spring and damper in series; z is the spring's force
        return z, p[0] * v - z / p[1]
    if code == FADING:  # the work done, z, thins it
        return p[0] * v / (1.0 + z / p[1]), p[0] * v * v / (1.0 + z / p[1])
    f = p[1] * _beyond_play(z, p[2])  # BUSHING: z is its elongation
    return f, v - f / p[0]


@numba.njit(cache=True)
def _moved(c, s, T, x, v, a):
    """Motion of the moved nodes a share `s` into a sample's interval of `T` seconds."""
    for j in range(c.shape[0]):
        p = c[j]
        x[j] = p[0] + s * (p[1] + s * (p[2] + s * (p[3] + s * (p[4] + s * p[5]))))
        v[j] = (
            p[1] + s * (2 * p[2] + s * (3 * p[3] + s * (4 * p[4] + s * 5 * p[5])))
        ) / T
        a[j] = (2 * p[2] + s * (6 * p[3] + s * (12 * p[4] + s * 20 * p[5]))) / (T * T)


@numba.njit(cache=True)
def _ride(points, arms, ground, q):
    """Displacement, speed or acceleration of the bodies' points, which come after the ground: that of the centre, and arm times angle."""
    for k in range(len(arms)):
        q[ground + 1 + k] = q[points[k, 0]] + arms[k] * q[points[k, 1]]


@numba.njit(cache=True)
def _apply(points, arms, n, ground, node, force, pull):
    """A force on a node: on its mass, or on the body that it rides on, where it has a moment about the centre."""
    if node < n:
        pull[node] += force
    elif node > ground:
        k = node - ground - 1
        pull[points[k, 0]] += force
        pull[points[k, 1]] += arms[k] * force


@numba.njit(cache=True)
def _rates(y, n, plant, inverse, Mfm, c, push, s, T, t, x, v, a, f, out):
    """Rates of (positions, speeds, link states); `f` gets the links' forces. plant: the bodies' points, their arms, and the links."""
    points, arms, ends, codes, P = plant
    x[:n] = y[:n]
    v[:n] = y[n : 2 * n]
    m = c.shape[0]
    _moved(c, s, T, x[n : n + m], v[n : n + m], a[n : n + m])
    _ride(points, arms, n + m, x)
    _ride(points, arms, n + m, v)
    pull = np.zeros(n)
    for i in range(n):
        q = push[i]
        pull[i] = q[0] + s * (q[1] + s * (q[2] + s * q[3]))
        for j in range(m):
            pull[i] -= Mfm[i, j] * a[n + j]
    for k in range(len(codes)):
        i, j = ends[k, 0], ends[k, 1]
        f[k], out[2 * n + k] = _force(
            codes[k], P[k], x[i] - x[j], v[i] - v[j], y[2 * n + k], t
        )
        _apply(points, arms, n, n + m, i, -f[k], pull)
        _apply(points, arms, n, n + m, j, f[k], pull)
    for i in range(n):
        out[i] = y[n + i]
        total = 0.0
        for j in range(n):
            total += inverse[i, j] * pull[j]
        out[n + i] = total
        a[i] = total
    _ride(points, arms, n + m, a)


@numba.njit(cache=True)
def _march(y, n, plant, inverse, Mfm, motion, push, T, substeps):
    """Classic Runge-Kutta from sample to sample; positions, speeds, accelerations of all nodes, forces of all links."""
    size, m, links = motion.shape[0], motion.shape[1], len(plant[3])
    nodes = (
        n + m + 1 + len(plant[1])
    )  # after the moved ones the ground, at rest, and the bodies' points
    X, V, A = np.zeros((size, nodes)), np.zeros((size, nodes)), np.zeros((size, nodes))
    F = np.zeros((size, links))
    x, v, a, f = np.zeros(nodes), np.zeros(nodes), np.zeros(nodes), np.zeros(links)
    k1, k2, k3, k4 = (
        np.zeros(len(y)),
        np.zeros(len(y)),
        np.zeros(len(y)),
        np.zeros(len(y)),
    )
    h, w = T / substeps, 1.0 / substeps
    for i in range(size):
        c, q = motion[i], push[i]
        for j in range(substeps):
            s, t = j * w, (i + j * w) * T
            _rates(y, n, plant, inverse, Mfm, c, q, s, T, t, x, v, a, f, k1)
            if j == 0:
                X[i], V[i], A[i], F[i] = x, v, a, f
            u = s + 0.5 * w
            _rates(
                y + 0.5 * h * k1,
                n,
                plant,
                inverse,
                Mfm,
                c,
                q,
                u,
                T,
                t + 0.5 * h,
                x,
                v,
                a,
                f,
                k2,
            )
            _rates(
                y + 0.5 * h * k2,
                n,
                plant,
                inverse,
                Mfm,
                c,
                q,
                u,
                T,
                t + 0.5 * h,
                x,
                v,
                a,
                f,
                k3,
            )
            _rates(
                y + h * k3,
                n,
                plant,
                inverse,
                Mfm,
                c,
                q,
                s + w,
                T,
                t + h,
                x,
                v,
                a,
                f,
                k4,
            )
            y = y + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
    return X, V, A, F


@dataclass(frozen=True)
class Signal:
    """A moved node's displacement [m], velocity [m/s] and acceleration [m/s^2], or a force [N] and its rate, at the samples.

    A current [A] is `held` from sample to sample and has no rate.
    """

    value: Array
    rate: Array
    second: Array
    held: bool = False


@dataclass(frozen=True)
class Run:
    """What a plant did: per node motion, per link force [N], per moved node the force that moved it [N]."""

    position: dict[str, Array]
    velocity: dict[str, Array]
    acceleration: dict[str, Array]
    link: dict[str, Array]
    load: dict[str, Array]


def integrate(
    model: Model,
    inputs: Mapping[str, Signal],
    size: int,
    interval: float,
    *,
    speed: float,
    initial: Mapping[str, tuple[float, float]] | None = None,
    creep: float = CREEP,
) -> Run:
    """Let `model` run for `size` samples, `interval` [s] apart. Raises ArithmeticError where it does not stay finite.

    inputs: by the names of the model's inputs. speed: typical speed [m/s], to which the creep of dry friction is in
    proportion. initial: displacement [m] and velocity [m/s] of free nodes. creep: see `CREEP`; ten times
    as much is ten times as quick.
    """
    by_node = {
        i["at"]: i["name"] for i in model["inputs"] if i["quantity"] == "displacement"
    }
    moved, carried = list(by_node), inertias(model)
    n, m = len(set(carried) - set(moved)), len(moved)
    nodes = [*(node for node in carried if node not in moved), *moved, GROUND]
    points, arms, riding = _riders(model, nodes)
    nodes += riding
    weights = np.eye(
        len(nodes), n + m + 1
    )  # of what moves by itself in the motion of every node
    for k, ((centre, angle), arm) in enumerate(zip(points, arms, strict=True)):
        weights[n + m + 1 + k, [centre, angle]] = 1.0, arm
    mass = np.diag([carried.get(node, 0.0) for node in nodes[: n + m + 1]])
    links = [e for e in model["elements"] if e["type"] in LAWS]
    inerters = [e for e in model["elements"] if e["type"] == "inertance"]
    ends = {
        e["name"]: tuple(nodes.index(k) for k in e["between"]) for e in links + inerters
    }
    for e in inerters:
        i, j = ends[e["name"]]
        mass += e["inertance"] * np.outer(
            weights[i] - weights[j], weights[i] - weights[j]
        )
    link_ends = [ends[e["name"]] for e in links]
    codes = [LAWS[e["type"]][0] for e in links]
    parameters = [_parameters(e, creep * speed) for e in links]
    inverse = np.linalg.inv(mass[:n, :n]) if n else np.zeros((0, 0))
    motion = np.zeros((size, m, 6))
    for j, node in enumerate(moved):
        motion[:, j] = _quintic(inputs[by_node[node]], interval)
    y = np.zeros(2 * n + len(codes))
    for node, (position, velocity) in (initial or {}).items():
        y[nodes.index(node)], y[n + nodes.index(node)] = position, velocity
    fastest = _fastest(weights[:, :n], inverse, link_ends, codes, parameters)
    steps = math.ceil(max(2.0, interval * fastest / 1.2))
    plant = (
        np.array(points, dtype=np.int64).reshape(-1, 2),
        np.array(arms, dtype=float),
        np.array(link_ends, dtype=np.int64).reshape(-1, 2),
        np.array(codes, dtype=np.int64),
        np.array(parameters, dtype=float).reshape(-1, 6),
    )
    push = _pushes(model, inputs, nodes[:n], size, interval)
    X, V, A, F = _march(
        y, n, plant, inverse, mass[:n, n : n + m].copy(), motion, push, interval, steps
    )
    if not (np.isfinite(X).all() and np.isfinite(V).all()):
        raise ArithmeticError("the plant does not stay finite")
    force = {e["name"]: F[:, k] for k, e in enumerate(links)}
    for e in inerters:
        i, j = ends[e["name"]]
        force[e["name"]] = e["inertance"] * (A[:, i] - A[:, j])
    load = {}
    for node in moved:
        j = nodes.index(node)
        load[node] = A[:, : n + m + 1] @ mass[j]
        for k, (first, second) in enumerate(link_ends):
            load[node] = load[node] + F[:, k] * ((first == j) - (second == j))
    columns = [dict(zip(nodes, c.T, strict=True)) for c in (X, V, A)]
    return Run(
        *columns,
        {e["name"]: force[e["name"]] for e in model["elements"] if e["name"] in force},
        load,
    )


def _riders(
    model: Model, nodes: list[str]
) -> tuple[list[tuple[int, int]], list[float], list[str]]:
    """Points of bodies: places of centre and angle among the nodes, arms [m] and names."""
    points, arms, names = [], [], []
    for name, body in model.get("bodies", {}).items():
        for point, place in body["points"].items():
            points.append((nodes.index(name), nodes.index(f"{name}.pitch")))
            arms.append(-place["x"])  # nose down is positive
            names.append(point)
    return points, arms, names


def _parameters(e: Element, creep: float) -> list[float]:
    """Parameters of a link, and at the end the speed [m/s] below which its friction is viscous."""
    values = [e.get(key, usual) for key, usual in LAWS[e["type"]][1].items()]
    numbers = [SIDES[v] if isinstance(v, str) else v for v in values]
    return [*numbers, *[0.0] * (5 - len(numbers)), creep]


def _pushes(
    model: Model,
    inputs: Mapping[str, Signal],
    free: list[str],
    size: int,
    interval: float,
) -> Array:
    """Forces of the inputs on the free nodes as polynomials (size, n, 4)."""
    push = np.zeros((size, len(free), 4))
    motors = {e["name"]: e for e in model["elements"] if e["type"] == "motor"}
    for i in model["inputs"]:
        if i["quantity"] == "force":
            push[:, free.index(i["at"])] += _cubic(inputs[i["name"]], interval)
        elif i["quantity"] == "current":
            motor = motors[i["element"]]
            thrust = (
                motor["thrust_constant"]
                * motor.get("ratio", 1.0)
                * _cubic(inputs[i["name"]], interval)
            )
            for node, sign in zip(motor["between"], (-1.0, 1.0), strict=True):
                if node in free:
                    push[:, free.index(node)] += sign * thrust
    return push


def inertias(model: Model) -> dict[str, float]:
    """Mass [kg] of every node that has one, and moment of inertia [kg m^2] of every body's angle."""
    out = dict(model["masses"])
    for name, body in model.get("bodies", {}).items():
        out |= {name: body["mass"], f"{name}.pitch": body["inertia"]["pitch"]}
    return out


def _fastest(
    weights: Array, inverse: Array, ends: Any, codes: list[int], P: list[list[float]]
) -> float:
    """Fastest rate [1/s] at which the plant can answer: the links' steepest slopes over the mass that they move."""
    slow, fast = 0.0, 0.0
    for (i, j), code, p in zip(ends, codes, P, strict=True):
        across = weights[i] - weights[j]  # what is moved or ground does not give way
        gives = float(across @ inverse @ across)
        if code in (SPRING, PLAY, SWITCHED, MAXWELL):
            slow += 4.0 * abs(p[0]) * gives
        elif code in (BUMP, HYSTERESIS, BUSHING):
            slow += 4.0 * p[1] * gives
        elif code in (DAMPER, POSITION, FADING, THINNING):
            fast += abs(p[0]) * gives
        elif code == ASYMMETRIC:
            fast += max(abs(p[0]), abs(p[1])) * gives
        elif COULOMB <= code < HYSTERESIS:
            level = {WEDGE: 4.0 * p[0] * p[1], STRIBECK: p[1]}.get(code, p[0])
            fast += level / p[5] * gives
        if code == BUSHING:
            fast += p[1] / p[0]
    # fifty steps to a period of the stiffest spring; dry friction within Runge-Kutta's limit of stability
    return max(fast, 8.0 * math.sqrt(slow))


def _quintic(signal: Signal, T: float) -> Array:
    """Polynomials, of the share of an interval, through value, rate and second rate at both of its ends."""
    x, v, a = signal.value, signal.rate * T, signal.second * T * T
    # what comes after the last sample is never read
    x1, v1, a1 = (np.append(q[1:], q[-1]) for q in (x, v, a))
    dx, dv, da = x1 - x - v - a / 2, v1 - v - a, a1 - a
    return np.stack(
        [
            x,
            v,
            a / 2,
            10 * dx - 4 * dv + da / 2,
            -15 * dx + 7 * dv - da,
            6 * dx - 3 * dv + da / 2,
        ],
        axis=1,
    )


def _cubic(signal: Signal, T: float) -> Array:
    x, v = signal.value, signal.rate * T
    if signal.held:
        return np.stack([x, 0 * x, 0 * x, 0 * x], axis=1)
    x1, v1 = np.append(x[1:], x[-1]), np.append(v[1:], v[-1])
    return np.stack([x, v, 3 * (x1 - x) - 2 * v - v1, 2 * (x - x1) + v + v1], axis=1)
