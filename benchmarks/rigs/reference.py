"""An independent simulator of `isd-model/1` models, against which the project's kernel is validated.

It imports nothing of `isd_gym` and shares none of its ideas. Two integrators stand here:

`simulate` (compiled) writes the force balance of every free node and integrates that descriptor system
    M dv/dt = P(t) - C v - K x - D F,   dx/dt = v,   M singular wherever a node is massless,
as it stands, by the two-stage, L-stable, stiffly accurate SDIRK of order 2 (Alexander 1977) at some 10 us. No
null space is split off: a massless node's balance is one more equation of the stage. Dry friction is a stiff
elasto-plastic contact: a spring-damper of `PRESLIDING` metres of travel in series with a slider; its limit is
Coulomb's law, and no velocity is regularised, so a stuck contact does not creep.

`simulate_events` (slow) gives each massless node a very small mass, integrates with `scipy` and finds the
instants of sticking and slipping as events, the stuck contact's force being a Lagrange multiplier.

Sign of forces, inputs and outputs: as in a model file. Displacement and force inputs are linear between
samples, currents are held (zero order) and were zero before the record. Where inertia acts on a moved node,
its motion is the cubic spline of the samples, or the quintic Hermite spline of displacement, velocity and
acceleration where `derivatives` has them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numba
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

if TYPE_CHECKING:
    from collections.abc import Mapping

Array = NDArray[np.float64]
Model = dict[str, Any]

PRESLIDING = 1e-9
"""Elastic travel of a friction contact at its full level [m]."""
CONTACT_TIME = 2e-5
"""Ratio of a friction contact's damping to its stiffness [s]."""

GAMMA = 1.0 - 1.0 / np.sqrt(2.0)
MOTOR_EFFECTS = ("thrust_saturation", "actuator_lag", "actuator_delay", "drive_dead_zone", "quadratic_thrust")
SENSOR_EFFECTS = ("sensor_gain", "sensor_bias", "sensor_delay", "sensor_dead_zone", "sensor_magnitude")
SIDES = {"both": 0.0, "extension": 1.0, "compression": -1.0}

(
    FRICTION,
    QUADRATIC,
    ASYMMETRIC,
    CUBIC,
    GAS,
    BUMP,
    BACKLASH,
    HYSTERESIS,
    COGGING,
    LIFT,
    FADING,
    POSITION,
    TIMED,
    PARAMETRIC,
    CONTROLLED,
    DIRECTED,
    CONSTANT,
    DEGRESSIVE,
    SINE,
    SCHEDULED,
    SCHEDULED_FRICTION,
    LOADED_FRICTION,
    TABLE,
) = range(23)
# laws with a contact that sticks
CONTACTS = (FRICTION, TIMED, DIRECTED, SCHEDULED_FRICTION, LOADED_FRICTION)
# columns of a law's parameters: its own, the stiffness and damping of a contact, what a signal feeds, and a table
STIFFNESS, DAMPER, FED, KNOTS, ROWS = 3, 4, 5, 6, 7

# type -> (law, its parameters in order with their defaults; None: must be given). Those named x_... are
# no members of the project's library: laws that a diagnosis has to call unknown.
LAWS: dict[str, tuple[int, dict[str, Any]]] = {
    "coulomb_friction": (FRICTION, {"level": None}),
    "stribeck_friction": (FRICTION, {"level": None, "static_level": None, "stribeck_velocity": None}),
    "quadratic_damping": (QUADRATIC, {"damping": None}),
    "asymmetric_damping": (ASYMMETRIC, {"extension": None, "compression": None}),
    "cubic_stiffness": (CUBIC, {"stiffness": None}),
    "gas_spring": (GAS, {"force": None, "length": None, "exponent": None}),
    "bump_stop": (BUMP, {"clearance": None, "stiffness": None, "damping": 0.0, "side": "both"}),
    "backlash": (BACKLASH, {"gap": None, "stiffness": None}),
    "hysteresis": (HYSTERESIS, {"level": None, "stiffness": None, "exponent": 1.0, "shape": 1.0}),
    "cogging_force": (COGGING, {"amplitude": None, "pitch": None, "phase": None}),
    "tyre_lift_off": (LIFT, {"stiffness": None, "load": None}),
    "controlled_damper": (CONTROLLED, {"low": None, "high": None, "current": None}),
    "asymmetric_friction": (DIRECTED, {"extension": None, "compression": None}),
    "constant_force": (CONSTANT, {"force": None}),
    "degressive_damping": (DEGRESSIVE, {"damping": None, "knee": None}),
    "gravity_sine": (SINE, {"torque": None, "rest": 0.0}),
    "scheduled_damping": (SCHEDULED, {"slope": None, "reference": 0.0}),
    "scheduled_friction": (SCHEDULED_FRICTION, {"level": None, "slope": None, "reference": 0.0}),
    "load_dependent_friction": (LOADED_FRICTION, {"level": None, "gain": None}),
    "tabulated_force": (TABLE, {"scale": 1.0}),
    "x_fading_damping": (FADING, {"damping": None, "energy": None}),
    "x_position_damping": (POSITION, {"damping": None, "length": None}),
    "x_timed_friction": (TIMED, {"level": None, "period": None, "duty": None}),
    "x_parametric_stiffness": (PARAMETRIC, {"stiffness": None, "frequency": None}),
}
LINEAR = {
    "linear_stiffness": "stiffness",
    "series_compliance": "stiffness",
    "linear_damping": "damping",
    "inertance": "inertance",
    "terminal_inertia": "mass",
    "motor": "thrust_constant",
}


# ------------------------------------------------------------------------------------------- reading a model
@dataclass
class _Plant:
    """A model as node balances. Rows and columns of the matrices: free nodes first, then moved ones."""

    free: list[str]
    moved: list[str]
    mass: Array
    damping: Array
    stiffness: Array
    linear: list[tuple[dict[str, Any], Array]]
    laws: list[tuple[dict[str, Any], int, Array, Array]]
    motors: list[tuple[dict[str, Any], Array]]
    tied: dict[str, dict[str, float]]
    """Points of bodies and one end of each lever, as factors on other nodes."""

    def row(self, node: str) -> Array:
        """Selects a node's coordinate, or combines those that a tied node follows; a row of zeros for ground."""
        nodes = self.free + self.moved
        r = np.zeros(len(nodes))
        if node in self.tied:
            return np.asarray(sum((f * self.row(n) for n, f in self.tied[node].items()), r))
        if node != "ground":
            r[nodes.index(node)] = 1.0
        return r


def _ties(model: Model, moved: list[str]) -> tuple[dict[str, float], dict[str, dict[str, float]]]:
    """Inertia of the coordinates that bodies add, and what follows them: z_point = z - x pitch + y roll; levers."""
    inertia: dict[str, float] = {}
    tied: dict[str, dict[str, float]] = {}
    for name, body in model.get("bodies", {}).items():
        turns = body.get("inertia", {})
        inertia |= {name: body["mass"]} | {f"{name}.{axis}": value for axis, value in turns.items()}
        for point, at in body.get("points", {}).items():
            arms = {"pitch": -at.get("x", 0.0), "roll": at.get("y", 0.0)}
            tied[point] = {name: 1.0} | {f"{name}.{axis}": arms[axis] for axis in turns}
    for lever in model.get("levers", []):
        first, second = lever["between"]
        if first in moved or first in tied:
            tied[second] = {first: 1.0 / lever["ratio"]}
        else:
            tied[first] = {second: lever["ratio"]}
    return inertia, tied


def _plant(model: Model) -> _Plant:
    moved = [i["at"] for i in model.get("inputs", []) if i["quantity"] == "displacement"]
    inertia, tied = _ties(model, moved)
    inertia |= model.get("masses", {}) | model.get("inertias", {})
    nodes = [n for n in inertia if n != "ground"]
    for e in model["elements"]:
        nodes += [n for n in e.get("between", []) if n != "ground" and n not in nodes]
    nodes += [n for v in model.get("levers", []) for n in v["between"] if n not in nodes]
    free = [n for n in dict.fromkeys(nodes) if n not in moved and n not in tied]
    size = len(free) + len(moved)
    plant = _Plant(
        free, moved, np.zeros((size, size)), np.zeros((size, size)), np.zeros((size, size)), [], [], [], tied
    )
    for node, mass in inertia.items():
        r = plant.row(node)
        plant.mass += mass * np.outer(r, r)
    for e in model["elements"]:
        kind = e["type"]
        if kind in MOTOR_EFFECTS + SENSOR_EFFECTS:
            continue
        first, second = (plant.row(n) for n in e["between"])
        across = first - second
        if kind == "motor":
            plant.motors.append((e, across))
        elif kind == "inertance":
            plant.mass += e["inertance"] * np.outer(across, across)
        elif kind == "terminal_inertia":
            plant.mass += e["mass"] * np.outer(across, _terminal(e, first, second))
        elif kind == "linear_damping":
            plant.damping += e["damping"] * np.outer(across, across)
        elif kind in ("linear_stiffness", "series_compliance"):
            plant.stiffness += e["stiffness"] * np.outer(across, across)
        elif kind in LAWS:
            if kind == "controlled_damper":
                plant.motors.append((e, across))
            code, defaults = LAWS[kind]
            values = [e.get(k, v) for k, v in defaults.items()]
            values = [SIDES[v] if isinstance(v, str) else v for v in values]
            if None in values:
                raise ValueError(f"element {e.get('name')}: {kind} needs {', '.join(defaults)}")
            plant.laws.append((e, code, np.array(values, dtype=float), across))
            continue
        else:
            raise ValueError(f"element {e.get('name')}: unknown type {kind!r}")
        plant.linear.append((e, across))
    return plant


def _terminal(e: Mapping[str, Any], first: Array, second: Array) -> Array:
    return first if e.get("terminal", "second") == "first" else second


def _uniform(time: ArrayLike) -> tuple[Array, float]:
    t = np.asarray(time, dtype=float)
    if t.ndim != 1 or len(t) < 2:
        raise ValueError("time needs two samples or more")
    interval = (t[-1] - t[0]) / (len(t) - 1)
    if not np.allclose(np.diff(t), interval, rtol=1e-3):
        raise ValueError("time is not uniform")
    return t, float(interval)


def _column(inputs: Mapping[str, ArrayLike], name: str, size: int) -> Array:
    if name not in inputs:
        raise ValueError(f"no data for input {name!r}")
    column = np.asarray(inputs[name], dtype=float)
    if column.shape != (size,) or not np.isfinite(column).all():
        raise ValueError(f"input {name!r} needs {size} finite samples")
    return column


def _motion(
    model: Model, plant: _Plant, time: Array, interval: float, inputs: Any, derivatives: Any
) -> Array:
    """The moved nodes' motion as polynomials of the time since the sample, (nodes, intervals, 6)."""
    size, T = len(time), interval
    coef = np.zeros((len(plant.moved), size - 1, 6))
    names = {i["at"]: i["name"] for i in model.get("inputs", []) if i["quantity"] == "displacement"}
    for j, node in enumerate(plant.moved):
        x = _column(inputs, names[node], size)
        extra = (derivatives or {}).get(names[node])
        inertial = np.any(plant.mass[:, len(plant.free) + j]) or np.any(plant.mass[len(plant.free) + j])
        if extra is not None:
            v, a = (np.asarray(c, dtype=float) for c in extra)
            x0, x1, v0, v1, a0, a1 = x[:-1], x[1:], v[:-1], v[1:], a[:-1], a[1:]
            coef[j] = np.stack(
                [
                    x0,
                    v0,
                    a0 / 2,
                    (20 * (x1 - x0) - (8 * v1 + 12 * v0) * T - (3 * a0 - a1) * T**2) / (2 * T**3),
                    (30 * (x0 - x1) + (14 * v1 + 16 * v0) * T + (3 * a0 - 2 * a1) * T**2) / (2 * T**4),
                    (12 * (x1 - x0) - 6 * (v1 + v0) * T - (a0 - a1) * T**2) / (2 * T**5),
                ],
                axis=1,
            )
        elif inertial:
            coef[j, :, :4] = CubicSpline(np.arange(size) * T, x).c[::-1].T
        else:
            coef[j, :, 0] = x[:-1]
            coef[j, :, 1] = np.diff(x) / T
    return coef


def _initial(plant: _Plant, initial: Mapping[str, tuple[float, float]] | None) -> tuple[Array, Array]:
    x, v = np.zeros(len(plant.free)), np.zeros(len(plant.free))
    for node, (position, velocity) in (initial or {}).items():
        if node not in plant.free:
            raise ValueError(f"initial state of {node!r}, which is no free node")
        x[plant.free.index(node)], v[plant.free.index(node)] = position, velocity
    return x, v


def _inverse(system: Array) -> Array:
    """Inverse of a matrix whose rows differ in size by many orders."""
    if not len(system):
        return np.zeros((0, 0))
    size = np.abs(system).max(axis=1, keepdims=True)
    if not np.all(size > 0) or np.linalg.cond(system / size) > 1e15:
        raise ValueError("the force balances do not determine every node's motion")
    return np.linalg.inv(system / size) / size.T


# ------------------------------------------------------------------------------------ the compiled integrator
@numba.njit(cache=True)
def _law(code, p, d, v, z, hg, t):
    """Force, its derivative by v (where d moves by hg dv), and the law's state after a stage of length hg."""
    if code == FRICTION:
        level = p[0]
        slope = 0.0
        if p[2] > 0.0:
            rise = (p[1] - p[0]) * np.exp(-((v / p[2]) ** 2))
            level += rise
            slope = -2.0 * v / p[2] ** 2 * rise
        k, c = p[3], p[4]
        trial = k * (z + hg * v) + c * v
        if abs(trial) <= level:
            return trial, k * hg + c, z + hg * v
        force = np.copysign(level, trial)
        if k == 0.0:
            return force, 0.0, z
        return force, np.copysign(slope, trial * slope), (force + c * z / hg) / (k + c / hg)
    if code == QUADRATIC:
        return p[0] * v * abs(v), 2.0 * p[0] * abs(v), z
    if code == ASYMMETRIC:
        c = p[0] if v > 0.0 else p[1]
        return c * v, c, z
    if code == CUBIC:
        return p[0] * d**3, 3.0 * p[0] * d * d * hg, z
    if code == GAS:
        s = 1.0 + d / p[1]
        return p[0] * (1.0 - s ** (-p[2])), p[0] * p[2] / p[1] * s ** (-p[2] - 1.0) * hg, z
    if code == BUMP:
        side = 1.0 if d > 0.0 else -1.0
        depth = abs(d) - p[0]
        if depth > 0.0 and side * p[3] >= 0.0:
            push = p[1] * depth + p[2] * side * v
            if push > 0.0:
                return side * push, p[1] * hg + p[2], z
        return 0.0, 0.0, z
    if code == BACKLASH:
        depth = abs(d) - 0.5 * p[0]
        if depth > 0.0:
            return np.copysign(p[1] * depth, d), p[1] * hg, z
        return 0.0, 0.0, z
    if code == HYSTERESIS:
        y = z
        n = p[2]
        for _ in range(50):
            size = abs(y)
            w = (size / p[0]) ** n
            bend = p[3] * abs(v) * np.sign(y) + (1.0 - p[3]) * v
            residual = y - z - hg * p[1] * (v - bend * w)
            dw = n * w / size * np.sign(y) if size > 0.0 else 0.0
            change = residual / (1.0 + hg * p[1] * bend * dw)
            y -= change
            if abs(change) < 1e-12 * p[0]:
                break
        w = (abs(y) / p[0]) ** n
        grow = 1.0 - (p[3] * np.sign(v) * np.sign(y) + (1.0 - p[3])) * w
        return y, hg * p[1] * grow, y
    if code == COGGING:
        k = 2.0 * np.pi / p[1]
        return p[0] * np.sin(k * d + p[2]), p[0] * k * np.cos(k * d + p[2]) * hg, z
    if code == LIFT:
        over = p[0] * d - p[1]
        if over > 0.0:
            return -over, -p[0] * hg, z
        return 0.0, 0.0, z
    if code == FADING:  # heat z thins the oil
        c = p[0] / (1.0 + z / p[1])
        return c * v, c, z + hg * c * v * v
    if code == POSITION:
        c = p[0] * (d / p[1]) ** 2
        return c * v, c + 2.0 * p[0] * d / p[1] ** 2 * hg * v, z
    if code == TIMED:  # dry friction that is there only a part of the time
        on = p[0] if (t / p[1]) % 1.0 < p[2] else 0.0
        k, c = p[3], p[4]
        trial = k * (z + hg * v) + c * v
        if abs(trial) <= on:
            return trial, k * hg + c, z + hg * v
        force = np.copysign(on, trial)
        return force, 0.0, (force + c * z / hg) / (k + c / hg)
    if code in (DIRECTED, SCHEDULED_FRICTION, LOADED_FRICTION):
        k, c = p[STIFFNESS], p[DAMPER]
        trial = k * (z + hg * v) + c * v
        if code == DIRECTED:
            on = p[0] if trial > 0.0 else p[1]
        elif code == SCHEDULED_FRICTION:
            on = max(p[0] + p[1] * (p[FED] - p[2]), 0.0)
        else:
            on = p[0] + p[1] * abs(p[FED])
        if abs(trial) <= on:
            return trial, k * hg + c, z + hg * v
        force = np.copysign(on, trial)
        return force, 0.0, (force + c * z / hg) / (k + c / hg)
    if code == CONSTANT:
        return p[0], 0.0, z
    if code == DEGRESSIVE:
        over = 1.0 + abs(v) / p[1]
        return p[0] * v / over, p[0] / over**2, z
    if code == SINE:
        return p[0] * np.sin(d + p[1]), p[0] * np.cos(d + p[1]) * hg, z
    if code == SCHEDULED:
        c = p[0] * (p[FED] - p[1])
        return c * v, c, z
    if code == TABLE:  # linear between knots, held beyond them
        count, by_rate = int(p[KNOTS]), p[1] > 0.0
        x = v if by_rate else d
        first, values = ROWS, ROWS + count
        if x <= p[first] or x >= p[first + count - 1]:
            return p[0] * (p[values] if x <= p[first] else p[values + count - 1]), 0.0, z
        j = 0
        while x >= p[first + j + 1]:
            j += 1
        slope = p[0] * (p[values + j + 1] - p[values + j]) / (p[first + j + 1] - p[first + j])
        return p[0] * p[values + j] + slope * (x - p[first + j]), slope * (1.0 if by_rate else hg), z
    if code == CONTROLLED:
        c = p[0] + (p[1] - p[0]) * min(max((p[FED] + p[2]) / (2.0 * p[2]), 0.0), 1.0)
        return c * v, c, z
    # PARAMETRIC
    k = p[0] * np.sin(2.0 * np.pi * p[1] * t)
    return k * d, k * hg, z


@numba.njit(cache=True)
def _stage(codes, params, xa_d, q, G, z, hg, t, u, f, z_new, J, r):
    """Solve u = q - G f(u) for the laws' speeds u; True where it converged.

    Newton's method; where it hops between sticking and slipping, law by law by bisection, then Newton again.
    """
    m = len(codes)
    for iteration in range(100):
        if iteration % 20 == 19:
            for _ in range(30):
                for i in range(m):
                    aim = q[i]
                    for j in range(m):
                        if j != i:
                            aim -= G[i, j] * f[j]
                    reach = 1e-6
                    while True:  # u + G f(u) grows with u: bracket the root around `aim`
                        below, _, _ = _law(
                            codes[i], params[i], xa_d[i] + hg * (aim - reach), aim - reach, z[i], hg, t
                        )
                        above, _, _ = _law(
                            codes[i], params[i], xa_d[i] + hg * (aim + reach), aim + reach, z[i], hg, t
                        )
                        if (G[i, i] * below <= reach and G[i, i] * above >= -reach) or reach > 1e3:
                            break
                        reach *= 4.0
                    low, high = aim - reach, aim + reach
                    for _ in range(80):
                        u[i] = 0.5 * (low + high)
                        f[i], _, _ = _law(codes[i], params[i], xa_d[i] + hg * u[i], u[i], z[i], hg, t)
                        if u[i] + G[i, i] * f[i] > aim:
                            high = u[i]
                        else:
                            low = u[i]
        scale = 1e-9
        for i in range(m):
            f[i], J[i, i], z_new[i] = _law(codes[i], params[i], xa_d[i] + hg * u[i], u[i], z[i], hg, t)
        worst = 0.0
        for i in range(m):
            r[i] = q[i] - u[i]
            for j in range(m):
                r[i] -= G[i, j] * f[j]
            scale = max(scale, abs(u[i]), abs(q[i]))
            worst = max(worst, abs(r[i]))
        if worst <= 1e-11 * scale:
            return True
        if m == 1:
            step = r[0] / (1.0 + G[0, 0] * J[0, 0])
            u[0] += step
            continue
        slopes = np.empty(m)
        for i in range(m):
            slopes[i] = J[i, i]
        for i in range(m):
            for j in range(m):
                J[i, j] = G[i, j] * slopes[j]
            J[i, i] += 1.0
        for i in range(m):  # elimination with row pivoting
            pivot = i
            for k in range(i + 1, m):
                if abs(J[k, i]) > abs(J[pivot, i]):
                    pivot = k
            if pivot != i:
                for j in range(i, m):
                    J[i, j], J[pivot, j] = J[pivot, j], J[i, j]
                r[i], r[pivot] = r[pivot], r[i]
            for k in range(i + 1, m):
                w = J[k, i] / J[i, i]
                if w != 0.0:
                    for j in range(i, m):
                        J[k, j] -= w * J[i, j]
                    r[k] -= w * r[i]
        for i in range(m - 1, -1, -1):
            for j in range(i + 1, m):
                r[i] -= J[i, j] * r[j]
            r[i] /= J[i, i]
        for i in range(m):
            u[i] += r[i]
    return False


@numba.njit(cache=True)
def _integrate(
    samples,
    per_sample,
    h,
    interval,
    t0,
    M,
    C,
    K,
    S,
    Mw,
    Cw,
    Kw,
    Mpinv,
    null,
    D,
    Dw,
    codes,
    params,
    drives,
    loads,
    loads_moved,
    motion,
    push,
    push_at,
    current,
    motor_at,
    motor,
    x,
    v,
    z,
    offsets,
    X,
    V,
    A,
    F,
):
    n, p, m = len(x), len(motion), len(codes)
    q_in, q_motor = len(push), len(current)
    gamma = 1.0 - 1.0 / np.sqrt(2.0)
    hg = gamma * h
    SD = hg * (S @ D)
    G = D.T @ SD
    mu, u = M @ v, np.zeros(m)
    mu_base, mu_1, xa, z_base = np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(m)
    rhs, V1, q, da, f, z1 = np.zeros(n), np.zeros(n), np.zeros(m), np.zeros(m), np.zeros(m), np.zeros(m)
    J, r, drive = np.zeros((m, m)), np.zeros(m), np.zeros(n)
    w, wv, wa = np.zeros(p), np.zeros(p), np.zeros(p)
    lagged = np.zeros(q_motor)
    v_old = v.copy()
    failures = 0
    steps = (samples - 1) * per_sample
    for step in range(steps + 1):
        if step > 0:
            segment = (step - 1) // per_sample
            inside = (step - 1) % per_sample
            v_old[:] = v
        for s in range(2):
            if step == 0:
                break
            part = gamma if s == 0 else 1.0
            tau = (inside + part) * h
            for j in range(p):
                c = motion[j, segment]
                w[j] = c[0] + tau * (c[1] + tau * (c[2] + tau * (c[3] + tau * (c[4] + tau * c[5]))))
                wv[j] = c[1] + tau * (2 * c[2] + tau * (3 * c[3] + tau * (4 * c[4] + tau * 5 * c[5])))
                wa[j] = 2 * c[2] + tau * (6 * c[3] + tau * (12 * c[4] + tau * 20 * c[5]))
            for i in range(n):
                drive[i] = 0.0
                for j in range(p):
                    drive[i] -= Kw[i, j] * w[j] + Cw[i, j] * wv[j] + Mw[i, j] * wa[j]
            for j in range(q_in):
                value = push[j, segment] + (push[j, segment + 1] - push[j, segment]) * tau / interval
                drive[push_at[j]] += value
            for j in range(q_motor):
                at = step - 1 - int(motor[j, 0])
                command = current[j, at // per_sample] if at >= 0 else 0.0
                command -= min(max(command, -motor[j, 4]), motor[j, 4])
                actual = command + (lagged[j] - command) * (motor[j, 1] if s == 0 else motor[j, 2])
                if s == 1:
                    lagged[j] = actual
                if motor[j, 5] != 0.0:
                    other = abs(actual) if motor[j, 5] > 0.0 else -actual
                    actual = actual * other / motor[j, 5]
                if motor[j, 3] > 0.0:
                    actual = motor[j, 3] * np.tanh(actual / motor[j, 3])
                for i in range(n):
                    drive[i] -= motor_at[j, i] * actual
                for e in range(m):
                    if drives[e] == j:
                        params[e, FED] = actual
            if s == 0:
                mu_base[:] = mu
                xa[:] = x
                z_base[:] = z
            else:
                for i in range(n):
                    mu_base[i] = mu[i] + (1.0 - gamma) / gamma * (mu_1[i] - mu[i])
                    xa[i] = x[i] + (1.0 - gamma) * h * V1[i]
                for i in range(m):
                    z_base[i] = z[i] + (1.0 - gamma) / gamma * (z1[i] - z[i])
            for i in range(n):
                a = drive[i]
                for j in range(n):
                    a -= K[i, j] * xa[j]
                rhs[i] = mu_base[i] + hg * a
            for i in range(n):
                a = 0.0
                for j in range(n):
                    a += S[i, j] * rhs[j]
                V1[i] = a
            for e in range(m):
                q[e] = 0.0
                da[e] = 0.0
                for i in range(n):
                    q[e] += D[i, e] * V1[i]
                    da[e] += D[i, e] * xa[i]
                for j in range(p):
                    q[e] += Dw[j, e] * wv[j]
                    da[e] += Dw[j, e] * (w[j] - hg * wv[j])
                if codes[e] == LOADED_FRICTION:
                    params[e, FED] = 0.0
                    for i in range(n):
                        params[e, FED] += loads[e, i] * (xa[i] + hg * V1[i])
                    for j in range(p):
                        params[e, FED] += loads_moved[e, j] * w[j]
            time = t0 + (step - 1 + part) * h
            if m > 0 and not _stage(codes, params, da, q, G, z_base, hg, time, u, f, z1, J, r):
                failures += 1
            for i in range(n):
                for e in range(m):
                    V1[i] -= SD[i, e] * f[e]
            for i in range(n):
                a = 0.0
                for j in range(n):
                    a += M[i, j] * V1[j]
                mu_1[i] = a
        if step > 0:
            for i in range(n):
                x[i] = xa[i] + hg * V1[i]
                v[i] = V1[i]
                mu[i] = mu_1[i]
            z[:] = z1
        for o in range(len(offsets)):
            if (step + offsets[o]) % per_sample != 0:
                continue
            k = (step + offsets[o]) // per_sample
            if k >= samples:
                continue
            for i in range(n):
                X[o, k, i] = x[i]
                V[o, k, i] = v[i]
            for e in range(m):
                F[o, k, e] = f[e]
            if step > 0:
                for i in range(n):  # what is left of the balance is the rate of change of momentum
                    rhs[i] = drive[i]
                    for j in range(n):
                        rhs[i] -= K[i, j] * x[j] + C[i, j] * v[j]
                    for e in range(m):
                        rhs[i] -= D[i, e] * f[e]
                for i in range(n):
                    a = 0.0
                    for j in range(n):
                        a += Mpinv[i, j] * rhs[j] + null[i, j] * (v[j] - v_old[j]) / h
                    A[o, k, i] = a
    return failures


@dataclass
class Trajectory:
    """What happened: displacement [m], velocity [m/s] and acceleration [m/s^2] of every node, and the force
    [N] of every element with a name, all of shape (samples,)."""

    time: Array
    displacement: dict[str, Array]
    velocity: dict[str, Array]
    acceleration: dict[str, Array]
    force: dict[str, Array]
    load: dict[str, Array]
    """Force that the mover exerts on a moved node (on ground: minus what ground feels) [N]."""


def trajectories(
    model: Model,
    time: ArrayLike,
    inputs: Mapping[str, ArrayLike],
    *,
    step: float = 1e-5,
    initial: Mapping[str, tuple[float, float]] | None = None,
    derivatives: Mapping[str, tuple[ArrayLike, ArrayLike]] | None = None,
    delays: tuple[float, ...] = (0.0,),
) -> list[Trajectory]:
    """Motion and forces at `time`, and at `time` minus each further delay [s] (rounded to a step)."""
    t, interval = _uniform(time)
    plant = _plant(model)
    n, size = len(plant.free), len(t)
    per_sample = max(1, int(np.ceil(interval / step - 1e-9)))
    h = interval / per_sample
    motion = _motion(model, plant, t, interval, inputs, derivatives)
    M, C, K = (a[:n, :n].copy() for a in (plant.mass, plant.damping, plant.stiffness))
    Mw, Cw, Kw = (a[:n, n:].copy() for a in (plant.mass, plant.damping, plant.stiffness))
    across = np.array([a for *_, a in plant.laws]).reshape(len(plant.laws), n + len(plant.moved))
    D, Dw = across[:, :n].T.copy(), across[:, n:].T.copy()
    codes = np.array([code for _, code, _, _ in plant.laws], dtype=np.int64)
    knots = max([len(e.get("force", [])) for e, code, *_ in plant.laws if code == TABLE], default=0)
    params = np.zeros((len(codes), ROWS + 2 * knots))
    loads = np.zeros((len(codes), n + len(plant.moved)))
    for at, (row, (e, code, values, _)) in enumerate(zip(params, plant.laws, strict=True)):
        row[: len(values)] = values
        if code in CONTACTS:
            static = code == DIRECTED or (code == FRICTION and len(values) > 1)
            row[STIFFNESS] = max(values[0], values[1] if static else 0.0) / PRESLIDING
            row[DAMPER] = row[STIFFNESS] * CONTACT_TIME
        if code == TABLE:
            by_rate = "rate" in e
            axis, force = e["rate" if by_rate else "elongation"], e["force"]
            row[1], row[KNOTS] = by_rate, len(force)
            row[ROWS : ROWS + len(force)], row[ROWS + len(force) : ROWS + 2 * len(force)] = axis, force
        if code == LOADED_FRICTION:  # the load is a spring
            loads[at] = sum(s["stiffness"] * a for s, a in plant.linear if s.get("name") == e["load"])
    # directions that carry no momentum
    scale = np.abs(M).max() if n else 0.0
    Mpinv = np.linalg.pinv(M, rcond=1e-10) if scale > 0 else np.zeros((n, n))
    null = np.eye(n) - Mpinv @ M
    push, push_at, current, motor_at, motor = [], [], [], [], []
    for i in model.get("inputs", []):
        if i["quantity"] == "force":
            row, column = plant.row(i["at"])[:n], _column(inputs, i["name"], size)
            for k in np.flatnonzero(row):
                push.append(row[k] * column)
                push_at.append(k)
    for e, direction in plant.motors:
        names = [
            i["name"] for i in model["inputs"] if i["quantity"] == "current" and i["element"] == e["name"]
        ]
        current.append(_column(inputs, names[0], size) if names else np.zeros(size))
        effects = {f["type"]: f for f in model["elements"] if f.get("element") == e["name"]}
        tau = effects.get("actuator_lag", {}).get("time_constant", 0.0)
        delay = effects.get("actuator_delay", {}).get("delay", 0.0)
        limit = effects.get("thrust_saturation", {}).get("current", 0.0)
        decay = [float(np.exp(-part * h / tau)) if tau > 0 else 0.0 for part in (GAMMA, 1.0)]
        zone = effects.get("drive_dead_zone", {}).get("threshold", 0.0)
        square = effects.get("quadratic_thrust", {})
        reference = square.get("reference", 0.0) * (-1.0 if square.get("form") == "square" else 1.0)
        motor.append([round(delay / h), *decay, limit, zone, reference])
        motor_at.append(e.get("thrust_constant", 0.0) * e.get("ratio", 1.0) * direction[:n])
    driven: list[Any] = [e for e, _ in plant.motors]
    for i in model.get("inputs", []):
        if i["quantity"] in (
            "temperature",
            "pressure",
            "speed",
        ):  # a logged channel feeds laws as a current does, and drives nothing
            driven.append(i["name"])
            current.append(_column(inputs, i["name"], size))
            motor.append([0, 0.0, 0.0, 0.0, 0.0, 0.0])
            motor_at.append(np.zeros(n))
    feeds = [e.get("channel", e) for e, *_ in plant.laws]
    drives = np.array([driven.index(f) if f in driven else -1 for f in feeds], dtype=np.int64)
    offsets = np.zeros(1, dtype=np.int64)

    def run(samples: int, steps: int, h: float, params: Array, x: Array, v: Array, z: Array, out: Any) -> int:
        matrices = M, C, K, _inverse(M + GAMMA * h * C + (GAMMA * h) ** 2 * K), Mw, Cw, Kw, Mpinv, null, D, Dw
        laws = codes, params, drives, loads[:, :n].copy(), loads[:, n:].copy()
        sources = (
            motion,
            np.array(push).reshape(len(push), size),
            np.array(push_at, dtype=np.int64),
            np.array(current).reshape(len(current), size),
            np.array(motor_at).reshape(len(current), n),
            np.array(motor, dtype=float).reshape(len(current), 6),
        )
        return int(
            _integrate(samples, steps, h, interval, t[0], *matrices, *laws, *sources, x, v, z, offsets, *out)
        )

    # The first sample: massless nodes find their balance, stuck contacts their force, in two steps of 1 us.
    x, v = _initial(plant, initial)
    z = np.zeros(len(codes))
    rigid = params.copy()
    contact = np.isin(codes, CONTACTS)
    rigid[contact, STIFFNESS : DAMPER + 1] *= 1e6
    start = [np.zeros((len(offsets), 2, n)) for _ in range(3)] + [np.zeros((len(offsets), 2, len(codes)))]
    run(2, 2, 1e-6, rigid, x, v, z, start)
    for signal, rate in ((start[0], start[1]), (start[1], start[2])):
        signal[0, 1] -= 2e-6 * rate[0, 1]
    x, v = start[0][0, 1].copy(), start[1][0, 1].copy()
    z[contact] = start[3][0, 1, contact] / np.maximum(params[contact, 3], 1e-300)
    offsets = np.array([round(d / h) for d in delays], dtype=np.int64)
    shape = (len(offsets), size)
    out = [np.zeros((*shape, n)) for _ in range(3)] + [np.zeros((*shape, len(codes)))]
    failures = run(size, per_sample, h, params, x, v, z, out)
    X, V, A, F = out
    for o, offset in enumerate(offsets):
        for signal, first in zip(out, start, strict=True):
            signal[o, : offset // per_sample + 1] = first[0, 1]
    if not all(np.isfinite(a).all() for a in (X, V, A, F)):
        raise ArithmeticError("the simulation diverged")
    # A contact with damping jumps at touch-down, where no stage equation holds exactly; more is an error.
    if failures > 1e-3 * 2 * size * per_sample:
        raise ArithmeticError(f"{failures} stages did not converge")
    results = []
    for o, delay in enumerate(offsets):
        results.append(
            _trajectory(
                model, plant, t, interval, motion, delay * h, X[o], V[o], A[o], F[o], current, motor, h
            )
        )
    return results


def _trajectory(
    model: Model,
    plant: _Plant,
    t: Array,
    interval: float,
    motion: Array,
    delay: float,
    X: Array,
    V: Array,
    A: Array,
    F: Array,
    current: list[Array],
    motor: list[list[float]],
    h: float,
) -> Trajectory:
    """Join the free and the moved nodes and evaluate the linear elements."""
    size = len(t)
    since = np.maximum(np.arange(size) * interval - delay, 0.0)
    segment = np.clip(np.ceil(since / interval - 1e-9).astype(int) - 1, 0, size - 2)
    tau = since - segment * interval
    powers = tau[:, None] ** np.arange(6)
    W = np.einsum("pkc,kc->kp", motion[:, segment], powers)
    Wv = np.einsum("pkc,kc->kp", motion[:, segment, 1:] * np.arange(1, 6), powers[:, :5])
    Wa = np.einsum("pkc,kc->kp", motion[:, segment, 2:] * np.array([2.0, 6.0, 12.0, 20.0]), powers[:, :4])
    x, v, a = (np.concatenate(pair, axis=1) for pair in ((X, W), (V, Wv), (A, Wa)))
    forces: list[tuple[dict[str, Any], Array, Array]] = []
    for e, across in plant.linear:
        if e["type"] in ("linear_stiffness", "series_compliance"):
            force = e["stiffness"] * (x @ across)
        elif e["type"] == "linear_damping":
            force = e["damping"] * (v @ across)
        elif e["type"] == "inertance":
            force = e["inertance"] * (a @ across)
        elif e["type"] == "terminal_inertia":
            force = e["mass"] * (a @ _terminal(e, *(plant.row(n) for n in e["between"])))
        else:
            j = [m["name"] for m, _ in plant.motors].index(e["name"])
            force = (
                e["thrust_constant"] * e.get("ratio", 1.0) * _actual_current(current[j], motor[j], h, since)
            )
        forces.append((e, across, force))
    forces += [(e, across, F[:, i]) for i, (e, _, _, across) in enumerate(plant.laws)]
    load = {}
    for node in [*plant.moved, "ground"]:
        total = np.zeros(size)
        for e, _, force in forces:
            first, second = e["between"]
            total += force if first == node else -force if second == node else 0.0
        if node != "ground":
            total += model.get("masses", {}).get(node, 0.0) * (a @ plant.row(node))
        load[node] = total
    nodes = plant.free + plant.moved + list(plant.tied)
    return Trajectory(
        t,
        *({n: signal @ plant.row(n) for n in nodes} for signal in (x, v, a)),
        {e["name"]: f for e, _, f in forces if "name" in e},
        load,
    )


def _actual_current(command: Array, motor: list[float], h: float, since: Array) -> Array:
    """The current that makes thrust, just before each instant, by the same rounding as the integrator's."""
    delay, _, decay, limit, zone, reference = motor
    per_sample = round((since[-1] - since[-2]) / h)
    actual = np.empty(len(since))
    value, at = command[0] if delay == 0 and decay == 0 else 0.0, 0
    for k, target in enumerate(np.round(since / h).astype(int)):
        while at < target:
            source = at - int(delay)
            # as far as the command stays the same
            span = min(target - at, per_sample - source % per_sample)
            held = command[source // per_sample] if source >= 0 else 0.0
            held -= min(max(held, -zone), zone)
            value = held + (value - held) * decay**span
            at += span
        actual[k] = value
    if reference:
        actual = actual * (np.abs(actual) if reference > 0.0 else -actual) / reference
    return limit * np.tanh(actual / limit) if limit > 0 else actual


def _channel(output: Mapping[str, Any], run: Trajectory) -> Array:
    quantity = output["quantity"]
    if quantity == "force" and "element" in output:
        # A list: elements side by side, whose forces one cell reads together.
        names = output["element"]
        names = [names] if isinstance(names, str) else names
        return np.sum([run.force[name] for name in names], axis=0)
    if quantity == "force":
        return run.load[output["at"]]
    turning = {
        "angle": "displacement",
        "angular_velocity": "velocity",
        "angular_acceleration": "acceleration",
    }
    signal = getattr(run, turning.get(quantity, quantity))
    zero = np.zeros_like(run.time)
    if "axis" in output:
        return signal[f"{output['body']}.{output['axis']}"]
    if "at" in output:
        return signal.get(output["at"], zero)
    first, second = output["between"]
    return signal.get(first, zero) - signal.get(second, zero)


def simulate(
    model: Model,
    time: ArrayLike,
    inputs: Mapping[str, ArrayLike],
    *,
    step: float = 1e-5,
    initial: Mapping[str, tuple[float, float]] | None = None,
    derivatives: Mapping[str, tuple[ArrayLike, ArrayLike]] | None = None,
) -> dict[str, Array]:
    """The model's outputs at `time`, by name.

    model: `isd-model/1` as read from JSON. time (samples,) [s], uniform. inputs: by name, (samples,), in SI.
    step: the longest step [s]. initial: node -> (displacement [m], velocity [m/s]) of free nodes, others at
    rest at zero. derivatives: input name -> (velocity, acceleration) of a displacement input.
    """
    delay = {e["channel"]: e["delay"] for e in model["elements"] if e["type"] == "sensor_delay"}
    delays = tuple(sorted({0.0, *delay.values()}))
    runs = trajectories(
        model, time, inputs, step=step, initial=initial, derivatives=derivatives, delays=delays
    )
    table = {}
    for output in model["outputs"]:
        name = output["name"]
        y = _channel(output, runs[delays.index(delay.get(name, 0.0))])
        for e in model["elements"]:
            if e.get("channel") == name:
                y = y * e["gain"] if e["type"] == "sensor_gain" else y
                y = y + e["bias"] if e["type"] == "sensor_bias" else y
                y = np.abs(y) if e["type"] == "sensor_magnitude" else y
                y = y - np.clip(y, -e["width"], e["width"]) if e["type"] == "sensor_dead_zone" else y
        table[name] = np.array(y)
    return table


# ----------------------------------------------------------------------------- the event-detecting integrator
class _Hybrid:
    """The model with very small masses at massless nodes, and each friction contact sticking or slipping."""

    def __init__(self, model: Model, node_mass: float) -> None:
        self.plant = plant = _plant(model)
        self.model = model
        n = self.n = len(plant.free)
        masses = plant.mass[:n, :n].copy()
        for i, node in enumerate(plant.free):
            if node not in model.get("masses", {}):
                masses[i, i] += node_mass
        self.M = masses
        self.elements = [e for e in model["elements"] if "between" in e]
        if any(e["type"] in ("actuator_lag", "actuator_delay", "sensor_delay") for e in model["elements"]):
            raise ValueError("no lag and no delay here")
        self.across = {id(e): plant.row(e["between"][0]) - plant.row(e["between"][1]) for e in self.elements}
        self.frictions = [e for e in self.elements if e["type"].endswith("_friction")]
        self.stated = [e for e in self.elements if e["type"] == "hysteresis"]
        self.mode = [0] * len(self.frictions)  # 0 sticks, +1 or -1 slips
        self.D = np.array([self.across[id(e)][:n] for e in self.frictions]).reshape(len(self.frictions), n)
        moved = [self.across[id(e)][n:] for e in self.frictions]
        self.Dw = np.array(moved).reshape(len(self.frictions), len(plant.moved))

    @staticmethod
    def level(e: Mapping[str, Any], v: float) -> float:
        if e["type"] == "coulomb_friction":
            return float(e["level"])
        rise = e["static_level"] - e["level"]
        return float(e["level"] + rise * np.exp(-((v / e["stribeck_velocity"]) ** 2)))

    def force(self, e: Mapping[str, Any], x: Array, v: Array, z: Array, amps: Mapping[str, float]) -> float:
        """Force of an element that has no inertia and does not stick."""
        a = self.across[id(e)]
        d, s = float(a @ x), float(a @ v)
        match e["type"]:
            case "linear_stiffness" | "series_compliance":
                return e["stiffness"] * d
            case "linear_damping":
                return e["damping"] * s
            case "motor":
                amp = amps.get(e["name"], 0.0)
                for f in self.model["elements"]:
                    if f.get("element") == e["name"] and f["type"] == "thrust_saturation":
                        amp = f["current"] * np.tanh(amp / f["current"])
                return e["thrust_constant"] * e.get("ratio", 1.0) * amp
            case "controlled_damper":
                middle, half = 0.5 * (e["low"] + e["high"]), 0.5 * (e["high"] - e["low"])
                share = np.clip(amps.get(e["name"], 0.0) / e["current"], -1.0, 1.0)
                return float((middle + half * share) * s)
            case "quadratic_damping":
                return e["damping"] * abs(s) * s
            case "asymmetric_damping":
                return (e["extension"] if s > 0 else e["compression"]) * s
            case "cubic_stiffness":
                return e["stiffness"] * d * d * d
            case "gas_spring":
                return e["force"] - e["force"] * (e["length"] / (e["length"] + d)) ** e["exponent"]
            case "bump_stop":
                c, side = e.get("damping", 0.0), e.get("side", "both")
                if d > e["clearance"] and side != "compression":
                    return max(e["stiffness"] * (d - e["clearance"]) + c * s, 0.0)
                if -d > e["clearance"] and side != "extension":
                    return min(e["stiffness"] * (d + e["clearance"]) + c * s, 0.0)
                return 0.0
            case "backlash":
                return e["stiffness"] * (d - float(np.clip(d, -e["gap"] / 2, e["gap"] / 2)))
            case "hysteresis":
                return float(z[[id(o) for o in self.stated].index(id(e))])
            case "cogging_force":
                return e["amplitude"] * np.sin(2 * np.pi * d / e["pitch"] + e["phase"])
            case "tyre_lift_off":
                return min(e["load"] - e["stiffness"] * d, 0.0)
        return 0.0

    def solve(self, t: float, y: Array, moved: Any, push: Any, amps: Any) -> tuple[Array, Array, Array]:
        """Accelerations of the free nodes, forces of the frictions, rates of the states."""
        n = self.n
        w, wv, wa = moved(t)
        x, v = np.concatenate([y[:n], w]), np.concatenate([y[n : 2 * n], wv])
        z = y[2 * n :]
        balance = push(t) - self.plant.mass[:n, n:] @ wa
        for e in self.elements:
            balance = balance - self.across[id(e)][:n] * self.force(e, x, v, z, amps(t))
        friction = np.zeros(len(self.frictions))
        for i, (e, mode) in enumerate(zip(self.frictions, self.mode, strict=True)):
            if mode:
                friction[i] = mode * self.level(e, float(self.across[id(e)] @ v))
        balance = balance - self.D.T @ friction
        stuck = [i for i, mode in enumerate(self.mode) if mode == 0]
        accelerations = np.linalg.solve(self.M, balance)
        if stuck:
            D = self.D[stuck]
            resist = D @ np.linalg.solve(self.M, D.T)
            friction[stuck] = np.linalg.solve(resist, D @ accelerations + self.Dw[stuck] @ wa)
            accelerations = np.linalg.solve(self.M, balance - D.T @ friction[stuck])
        rates = np.zeros(len(self.stated))
        for i, e in enumerate(self.stated):
            s, n_, shape = float(self.across[id(e)] @ v), e.get("exponent", 1.0), e.get("shape", 1.0)
            bend = (shape * abs(s) * z[i] + (1 - shape) * s * abs(z[i])) * abs(z[i]) ** (n_ - 1)
            rates[i] = e["stiffness"] * (s - bend / e["level"] ** n_)
        return accelerations, friction, rates


def simulate_events(
    model: Model,
    time: ArrayLike,
    inputs: Mapping[str, ArrayLike],
    *,
    initial: Mapping[str, tuple[float, float]] | None = None,
    derivatives: Mapping[str, tuple[ArrayLike, ArrayLike]] | None = None,
    node_mass: float = 1e-3,
    rtol: float = 1e-7,
    atol: float = 1e-10,
) -> dict[str, Array]:
    """`simulate` by event-detecting integration (Radau IIA); slow, without lags, delays or sensor effects.

    node_mass: what a massless node weighs [kg].
    """
    t, interval = _uniform(time)
    rig = _Hybrid(model, node_mass)
    plant, n, size = rig.plant, rig.n, len(t)
    motion = _motion(model, plant, t, interval, inputs, derivatives)
    pushes = [
        (plant.free.index(i["at"]), _column(inputs, i["name"], size))
        for i in model.get("inputs", [])
        if i["quantity"] == "force"
    ]
    currents = {
        i["element"]: _column(inputs, i["name"], size)
        for i in model.get("inputs", [])
        if i["quantity"] == "current"
    }
    k = 0

    def moved(s: float) -> tuple[Array, Array, Array]:
        polynomials = [np.polynomial.Polynomial(c) for c in motion[:, k]]
        tau = s - t[k]
        return (
            np.array([q(tau) for q in polynomials]),
            np.array([q.deriv()(tau) for q in polynomials]),
            np.array([q.deriv(2)(tau) for q in polynomials]),
        )

    def push(s: float) -> Array:
        total = np.zeros(n)
        for at, column in pushes:
            total[at] += column[k] + (column[k + 1] - column[k]) * (s - t[k]) / interval
        return total

    def amps(s: float) -> dict[str, float]:
        return {name: column[k] for name, column in currents.items()}

    def slip(s: float, y: Array, i: int) -> float:
        return float(rig.D[i] @ y[n : 2 * n] + rig.Dw[i] @ moved(s)[1])

    def settle(s: float, y: Array) -> None:
        """Choose the modes: what is at rest sticks if it can, else slips the way it is pushed."""
        for i in range(len(rig.mode)):
            speed = slip(s, y, i)
            if abs(speed) > 1e-7:
                rig.mode[i] = 1 if speed > 0 else -1
            elif rig.mode[i] == 0:
                needed = rig.solve(s, y, moved, push, amps)[1][i]
                if abs(needed) > rig.level(rig.frictions[i], 0.0):
                    rig.mode[i] = 1 if needed > 0 else -1

    def rate(s: float, y: Array) -> Array:
        a, _, z = rig.solve(s, y, moved, push, amps)
        return np.concatenate([y[n : 2 * n], a, z])

    x0, v0 = _initial(plant, initial)
    y = np.concatenate([x0, v0, np.zeros(len(rig.stated))])
    settle(t[0], y)
    a, friction, _ = rig.solve(t[0], y, moved, push, amps)
    states, accelerations, frictions, moved_at = [y], [a], [friction], [moved(t[0])]
    for k in range(size - 1):
        s, restarts = t[k], 0
        settle(s, y)
        while s < t[k + 1]:
            events = []
            for i, mode in enumerate(rig.mode):

                def event(s: float, y: Array, i: int = i, mode: int = mode) -> float:
                    if mode:
                        return mode * slip(s, y, i)
                    needed = rig.solve(s, y, moved, push, amps)[1][i]
                    return rig.level(rig.frictions[i], 0.0) - abs(needed)

                event.terminal, event.direction = True, -1  # type: ignore[attr-defined]
                events.append(event)
            run = solve_ivp(
                rate, (s, t[k + 1]), y, method="Radau", rtol=rtol, atol=atol, events=events or None
            )
            if not run.success:
                raise ArithmeticError(run.message)
            s, y = float(run.t[-1]), run.y[:, -1]
            for i, found in enumerate(run.t_events or []):
                if not len(found):
                    continue
                restarts += 1
                if restarts > 1000:
                    raise ArithmeticError(f"friction chatters at {s} s")
                if rig.mode[i]:
                    before, rig.mode[i] = rig.mode[i], 0
                    needed = rig.solve(s, y, moved, push, amps)[1][i]
                    if abs(needed) > rig.level(rig.frictions[i], 0.0):
                        rig.mode[i] = 1 if needed > 0 else -1
                        if rig.mode[i] == before:
                            rig.mode[i] = -before
                    else:  # take out what the event finder left of the speed
                        D, speed = rig.D[i], slip(s, y, i)
                        y = y.copy()
                        y[n : 2 * n] -= np.linalg.solve(rig.M, D) * speed / (D @ np.linalg.solve(rig.M, D))
                else:
                    needed = rig.solve(s, y, moved, push, amps)[1][i]
                    rig.mode[i] = 1 if needed > 0 else -1
        a, friction, _ = rig.solve(s, y, moved, push, amps)
        states.append(y)
        accelerations.append(a)
        frictions.append(friction)
        moved_at.append(moved(s))
    Y, A, R = np.array(states), np.array(accelerations), np.array(frictions)
    W = [np.array([m[i] for m in moved_at]).reshape(size, -1) for i in range(3)]
    x, v, a = (
        np.concatenate([f, w], axis=1) for f, w in ((Y[:, :n], W[0]), (Y[:, n : 2 * n], W[1]), (A, W[2]))
    )
    force, load = {}, {node: np.zeros(size) for node in [*plant.moved, "ground"]}
    for e in rig.elements:
        across = rig.across[id(e)]
        first, second = e["between"]
        if e["type"] == "inertance":
            values = e["inertance"] * (a @ across)
        elif e["type"] == "terminal_inertia":
            values = e["mass"] * (a @ _terminal(e, plant.row(first), plant.row(second)))
        elif e in rig.frictions:
            values = R[:, [id(o) for o in rig.frictions].index(id(e))]
        else:
            # a current is held: what acts at a sample acted since the one before
            held = [{m: c[max(i - 1, 0)] for m, c in currents.items()} for i in range(size)]
            values = np.array([rig.force(e, x[i], v[i], Y[i, 2 * n :], held[i]) for i in range(size)])
        force[e["name"]] = values
        for node in load:
            load[node] += values if first == node else -values if second == node else 0.0
    for node in plant.moved:
        load[node] += model.get("masses", {}).get(node, 0.0) * (a @ plant.row(node))
    nodes = plant.free + plant.moved
    at, rate_of, rise = ({name: s[:, i] for i, name in enumerate(nodes)} for s in (x, v, a))
    run_ = Trajectory(t, at, rate_of, rise, force, load)
    return {o["name"]: np.array(_channel(o, run_)) for o in model["outputs"]}
