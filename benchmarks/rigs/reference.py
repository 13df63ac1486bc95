"""An independent simulator of `isd-model/1` models, against which the project's kernel is validated.

The simulator has no import from `isd_gym` and no algorithm in common with the kernel. `simulate` writes the force balance of every free node and
integrates that descriptor system
    M dv/dt = P(t) - C v - K x - D F,   dx/dt = v,   M singular wherever a node is massless,
as it stands, by the two-stage, L-stable, stiffly accurate SDIRK of order 2 (Alexander 1977) at some 10 us. No
null space is split off: a massless node's balance is one more equation of the stage. Dry friction is a stiff
elasto-plastic contact: a spring-damper of `PRESLIDING` metres of travel in series with a slider; its limit is
Coulomb's law, and no velocity is regularised, so a stuck contact does not creep.

Sign of forces, inputs and outputs: as in a model file. Displacement and force inputs are linear between
samples, currents are held (zero order) and were zero before the record. Where inertia acts on a moved node,
its motion is the cubic spline of the samples, or the quintic Hermite spline of displacement, velocity and
acceleration where `derivatives` has them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numba
import numpy as np
from numpy.typing import ArrayLike, NDArray
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
MOTOR_EFFECTS = (
    "thrust_saturation",
    "actuator_lag",
    "actuator_delay",
    "drive_dead_zone",
    "quadratic_thrust",
)
SENSOR_EFFECTS = (
    "sensor_gain",
    "sensor_bias",
    "sensor_delay",
    "sensor_dead_zone",
    "sensor_magnitude",
)
LOGGED = ("temperature", "pressure", "speed")
SIDES = {"both": 0.0, "extension": 1.0, "compression": -1.0}

# laws of the elongation alone, of the speed alone, and others
(
    CUBIC,
    GAS,
    BACKLASH,
    COGGING,
    LIFT,
    SINE,
    TABLE,
    PARAMETRIC,
    CONSTANT,
    QUADRATIC,
    DEGRESSIVE,
    RATE_TABLE,
    ASYMMETRIC,
    SCHEDULED,
    CONTROLLED,
    FRICTION,
    DIRECTED,
    SCHEDULED_FRICTION,
    LOADED_FRICTION,
    TIMED,
    HYSTERESIS,
    BUMP,
    FADING,
    POSITION,
) = range(24)
LAST_SPRING, LAST_DAMPER = CONSTANT, CONTROLLED
# laws with a contact that sticks
CONTACTS = (FRICTION, TIMED, DIRECTED, SCHEDULED_FRICTION, LOADED_FRICTION)
# columns of a law's parameters: its own, the stiffness and damping of a contact, what a signal feeds, and a table
STIFFNESS, DAMPER, FED, KNOTS, ROWS = 3, 4, 5, 6, 7

# type -> (law, its parameters in order with their defaults; None: must be given). Those named x_... are
# no members of the project's library: laws that a diagnosis has to call unknown.
LAWS: dict[str, tuple[int, dict[str, Any]]] = {
    "coulomb_friction": (FRICTION, {"level": None}),
    "stribeck_friction": (
        FRICTION,
        {"level": None, "static_level": None, "stribeck_velocity": None},
    ),
    "quadratic_damping": (QUADRATIC, {"damping": None}),
    "asymmetric_damping": (ASYMMETRIC, {"extension": None, "compression": None}),
    "cubic_stiffness": (CUBIC, {"stiffness": None}),
    "gas_spring": (GAS, {"force": None, "length": None, "exponent": None}),
    "bump_stop": (
        BUMP,
        {"clearance": None, "stiffness": None, "damping": 0.0, "side": "both"},
    ),
    "backlash": (BACKLASH, {"gap": None, "stiffness": None}),
    "hysteresis": (
        HYSTERESIS,
        {"level": None, "stiffness": None, "exponent": 1.0, "shape": 1.0},
    ),
    "cogging_force": (COGGING, {"amplitude": None, "pitch": None, "phase": None}),
    "tyre_lift_off": (LIFT, {"stiffness": None, "load": None}),
    "controlled_damper": (CONTROLLED, {"low": None, "high": None, "current": None}),
    "asymmetric_friction": (DIRECTED, {"extension": None, "compression": None}),
    "constant_force": (CONSTANT, {"force": None}),
    "degressive_damping": (DEGRESSIVE, {"damping": None, "knee": None}),
    "gravity_sine": (SINE, {"torque": None, "rest": 0.0}),
    "scheduled_damping": (SCHEDULED, {"slope": None, "reference": 0.0}),
    "scheduled_friction": (
        SCHEDULED_FRICTION,
        {"level": None, "slope": None, "reference": 0.0},
    ),
    "load_dependent_friction": (LOADED_FRICTION, {"level": None, "gain": None}),
    "tabulated_force": (TABLE, {"scale": 1.0}),  # RATE_TABLE where its knots are rates
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
            return np.asarray(
                sum((f * self.row(n) for n, f in self.tied[node].items()), r)
            )
        if node != "ground":
            r[nodes.index(node)] = 1.0
        return r


def _ties(
    model: Model, moved: list[str]
) -> tuple[dict[str, float], dict[str, dict[str, float]]]:
    """Inertia of the coordinates that bodies add, and what follows them: z_point = z - x pitch + y roll; levers."""
    inertia: dict[str, float] = {}
    tied: dict[str, dict[str, float]] = {}
    for name, body in model.get("bodies", {}).items():
        turns = body.get("inertia", {})
        inertia |= {name: body["mass"]} | {
            f"{name}.{axis}": value for axis, value in turns.items()
        }
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
    moved = [
        i["at"] for i in model.get("inputs", []) if i["quantity"] == "displacement"
    ]
    inertia, tied = _ties(model, moved)
    inertia |= model.get("masses", {}) | model.get("inertias", {})
    nodes = [n for n in inertia if n != "ground"]
    for e in model["elements"]:
        nodes += [n for n in e.get("between", []) if n != "ground" and n not in nodes]
    nodes += [
        n for v in model.get("levers", []) for n in v["between"] if n not in nodes
    ]
    free = [n for n in dict.fromkeys(nodes) if n not in moved and n not in tied]
    size = len(free) + len(moved)
    plant = _Plant(
        free,
        moved,
        np.zeros((size, size)),
        np.zeros((size, size)),
        np.zeros((size, size)),
        [],
        [],
        [],
        tied,
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
            code = RATE_TABLE if "rate" in e else code
            values = [e.get(k, v) for k, v in defaults.items()]
            values = [SIDES[v] if isinstance(v, str) else v for v in values]
            if None in values:
                raise ValueError(
                    f"element {e.get('name')}: {kind} needs {', '.join(defaults)}"
                )
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
    model: Model,
    plant: _Plant,
    time: Array,
    interval: float,
    inputs: Any,
    derivatives: Any,
) -> Array:
    """The moved nodes' motion as polynomials of the time since the sample, (nodes, intervals, 6)."""
    size, T = len(time), interval
    coef = np.zeros((len(plant.moved), size - 1, 6))
    names = {
        i["at"]: i["name"]
        for i in model.get("inputs", [])
        if i["quantity"] == "displacement"
    }
    for j, node in enumerate(plant.moved):
        x = _column(inputs, names[node], size)
        extra = (derivatives or {}).get(names[node])
        inertial = np.any(plant.mass[:, len(plant.free) + j]) or np.any(
            plant.mass[len(plant.free) + j]
        )
        if extra is not None:
            v, a = (np.asarray(c, dtype=float) for c in extra)
            x0, x1, v0, v1, a0, a1 = x[:-1], x[1:], v[:-1], v[1:], a[:-1], a[1:]
            coef[j] = np.stack(
                [
                    x0,
                    v0,
                    a0 / 2,
                    (20 * (x1 - x0) - (8 * v1 + 12 * v0) * T - (3 * a0 - a1) * T**2)
                    / (2 * T**3),
                    (
                        30 * (x0 - x1)
                        + (14 * v1 + 16 * v0) * T
                        + (3 * a0 - 2 * a1) * T**2
                    )
                    / (2 * T**4),
                    (12 * (x1 - x0) - 6 * (v1 + v0) * T - (a0 - a1) * T**2)
                    / (2 * T**5),
                ],
                axis=1,
            )
        elif inertial:
            coef[j, :, :4] = CubicSpline(np.arange(size) * T, x).c[::-1].T
        else:
            coef[j, :, 0] = x[:-1]
            coef[j, :, 1] = np.diff(x) / T
    return coef


def _initial(
    plant: _Plant, initial: Mapping[str, tuple[float, float]] | None
) -> tuple[Array, Array]:
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
def _contact(level, slope, p, v, z, hg):
    """A spring-damper with a slider of this level in series; `slope`: of the level, by v."""
    stiffness, damping = p[STIFFNESS], p[DAMPER]
    trial = stiffness * (z + hg * v) + damping * v
    if abs(trial) <= level:
        return trial, stiffness * hg + damping, z + hg * v
    force = np.copysign(level, trial)
    if stiffness == 0.0:
        return force, 0.0, z
    return (
        force,
        np.copysign(slope, trial * slope),
        (force + damping * z / hg) / (stiffness + damping / hg),
    )


@numba.njit(cache=True)
def _dry_friction(p, v, z, hg):
    if p[2] == 0.0:
        return _contact(p[0], 0.0, p, v, z, hg)
    rise = (p[1] - p[0]) * np.exp(-((v / p[2]) ** 2))
    return _contact(p[0] + rise, -2.0 * v / p[2] ** 2 * rise, p, v, z, hg)


@numba.njit(cache=True)
def _directed_friction(p, v, z, hg):
    extends = p[STIFFNESS] * (z + hg * v) + p[DAMPER] * v > 0.0
    return _contact(p[0] if extends else p[1], 0.0, p, v, z, hg)


@numba.njit(cache=True)
def _bump_stop(p, d, v):
    """Force and its derivatives by d and v."""
    side = 1.0 if d > 0.0 else -1.0
    depth = abs(d) - p[0]
    push = p[1] * depth + p[2] * side * v
    if depth > 0.0 and side * p[3] >= 0.0 and push > 0.0:
        return side * push, p[1], p[2]
    return 0.0, 0.0, 0.0


@numba.njit(cache=True)
def _backlash(p, d):
    depth = abs(d) - 0.5 * p[0]
    if depth > 0.0:
        return np.copysign(p[1] * depth, d), p[1]
    return 0.0, 0.0


@numba.njit(cache=True)
def _hysteresis(p, v, z, hg):
    """Bouc and Wen's law, whose implicit step is solved by Newton's method."""
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


@numba.njit(cache=True)
def _table(p, x):
    """Force, linear between knots and held beyond them, and its slope."""
    count = int(p[KNOTS])
    knots, forces = p[ROWS : ROWS + count], p[ROWS + count : ROWS + 2 * count]
    if x <= knots[0]:
        return p[0] * forces[0], 0.0
    if x >= knots[-1]:
        return p[0] * forces[-1], 0.0
    j = np.searchsorted(knots, x, side="right") - 1
    slope = p[0] * (forces[j + 1] - forces[j]) / (knots[j + 1] - knots[j])
    return p[0] * forces[j] + slope * (x - knots[j]), slope


@numba.njit(cache=True)
def _spring(code, p, d, t):
    """Force of a law of the elongation alone, and its slope."""
    if code == CUBIC:
        return p[0] * d**3, 3.0 * p[0] * d * d
    if code == GAS:
        s = 1.0 + d / p[1]
        return p[0] * (1.0 - s ** (-p[2])), p[0] * p[2] / p[1] * s ** (-p[2] - 1.0)
    if code == BACKLASH:
        return _backlash(p, d)
    if code == COGGING:
        k = 2.0 * np.pi / p[1]
        return p[0] * np.sin(k * d + p[2]), p[0] * k * np.cos(k * d + p[2])
    if code == LIFT:
        return min(p[1] - p[0] * d, 0.0), -p[0] if p[0] * d > p[1] else 0.0
    if code == SINE:
        return p[0] * np.sin(d + p[1]), p[0] * np.cos(d + p[1])
    if code == TABLE:
        return _table(p, d)
    if code == PARAMETRIC:
        k = p[0] * np.sin(2.0 * np.pi * p[1] * t)
        return k * d, k
    return p[0], 0.0  # CONSTANT


@numba.njit(cache=True)
def _damper(code, p, v):
    """Force of a law of the speed alone, and its slope."""
    if code == QUADRATIC:
        return p[0] * v * abs(v), 2.0 * p[0] * abs(v)
    if code == DEGRESSIVE:
        over = 1.0 + abs(v) / p[1]
        return p[0] * v / over, p[0] / over**2
    if code == RATE_TABLE:
        return _table(p, v)
    if code == ASYMMETRIC:
        c = p[0] if v > 0.0 else p[1]
    elif code == SCHEDULED:
        c = p[0] * (p[FED] - p[1])
    else:  # CONTROLLED
        c = p[0] + (p[1] - p[0]) * min(max((p[FED] + p[2]) / (2.0 * p[2]), 0.0), 1.0)
    return c * v, c


@numba.njit(cache=True)
def _law(code, p, d, v, z, hg, t):
    """Force, its derivative by v (where d moves by hg dv), and the law's state after a stage of length hg."""
    if code <= LAST_SPRING:
        force, slope = _spring(code, p, d, t)
        return force, slope * hg, z
    if code <= LAST_DAMPER:
        force, slope = _damper(code, p, v)
        return force, slope, z
    if code == FRICTION:
        return _dry_friction(p, v, z, hg)
    if code == DIRECTED:
        return _directed_friction(p, v, z, hg)
    if code == SCHEDULED_FRICTION:
        return _contact(max(p[0] + p[1] * (p[FED] - p[2]), 0.0), 0.0, p, v, z, hg)
    if code == LOADED_FRICTION:
        return _contact(p[0] + p[1] * abs(p[FED]), 0.0, p, v, z, hg)
    if code == TIMED:  # dry friction that is there only a part of the time
        return _contact(p[0] if (t / p[1]) % 1.0 < p[2] else 0.0, 0.0, p, v, z, hg)
    if code == HYSTERESIS:
        return _hysteresis(p, v, z, hg)
    if code == BUMP:
        force, by_travel, by_speed = _bump_stop(p, d, v)
        return force, by_travel * hg + by_speed, z
    if code == FADING:  # heat z thins the oil
        c = p[0] / (1.0 + z / p[1])
        return c * v, c, z + hg * c * v * v
    c = p[0] * (d / p[1]) ** 2  # POSITION
    return c * v, c + 2.0 * p[0] * d / p[1] ** 2 * hg * v, z


@numba.njit(cache=True)
def _alone(code, p, da, z, hg, t, aim, G):
    """Speed and force of one law that solve u + G f(u) = aim, by bisection: the left side grows with u."""
    reach = 1e-6
    while reach <= 1e3:
        below = _law(code, p, da + hg * (aim - reach), aim - reach, z, hg, t)[0]
        above = _law(code, p, da + hg * (aim + reach), aim + reach, z, hg, t)[0]
        if G * below <= reach and G * above >= -reach:
            break
        reach *= 4.0
    low, high = aim - reach, aim + reach
    u, f = aim, 0.0
    for _ in range(80):
        u = 0.5 * (low + high)
        f = _law(code, p, da + hg * u, u, z, hg, t)[0]
        if u + G * f > aim:
            high = u
        else:
            low = u
    return u, f


@numba.njit(cache=True)
def _row(matrix, i, x):
    """Element i of the product of a matrix with a vector."""
    total = 0.0
    for j in range(len(x)):
        total += matrix[i, j] * x[j]
    return total


@numba.njit(cache=True)
def _solve(A, b):
    """Solve A x = b in place by elimination with row pivoting; x is left in b."""
    m = len(b)
    for i in range(m):
        pivot = i
        for k in range(i + 1, m):
            if abs(A[k, i]) > abs(A[pivot, i]):
                pivot = k
        for j in range(i, m):
            A[i, j], A[pivot, j] = A[pivot, j], A[i, j]
        b[i], b[pivot] = b[pivot], b[i]
        for k in range(i + 1, m):
            w = A[k, i] / A[i, i]
            for j in range(i, m):
                A[k, j] -= w * A[i, j]
            b[k] -= w * b[i]
    for i in range(m - 1, -1, -1):
        for j in range(i + 1, m):
            b[i] -= A[i, j] * b[j]
        b[i] /= A[i, i]


@numba.njit(cache=True)
def _stage(codes, params, da, q, G, z, hg, t, u, f, z_new, A, r):
    """Solve u = q - G f(u) for the laws' speeds u; True where it converged. A and r are for the matrix and residual.

    Newton's method; where it hops between sticking and slipping, law by law by bisection, then Newton again.
    """
    m = len(q)
    for iteration in range(100):
        if iteration % 20 == 19:
            for _ in range(30):
                for i in range(m):
                    aim = q[i] - _row(G, i, f) + G[i, i] * f[i]
                    u[i], f[i] = _alone(
                        codes[i], params[i], da[i], z[i], hg, t, aim, G[i, i]
                    )
        for i in range(m):
            at = da[i] + hg * u[i]
            f[i], slope, z_new[i] = _law(codes[i], params[i], at, u[i], z[i], hg, t)
            for j in range(m):
                A[j, i] = G[j, i] * slope
            A[i, i] += 1.0
        scale, worst = 1e-9, 0.0
        for i in range(m):
            r[i] = q[i] - u[i] - _row(G, i, f)
            scale = max(scale, abs(u[i]), abs(q[i]))
            worst = max(worst, abs(r[i]))
        if worst <= 1e-11 * scale:
            return True
        _solve(A, r)
        for i in range(m):
            u[i] += r[i]
    return False


class Matrices(NamedTuple):
    """Mass, damping and stiffness of the free nodes (n, n), and how they couple with the p moved ones (n, p)."""

    M: Array
    C: Array
    K: Array
    # inverse of M + hg C + hg^2 K
    S: Array
    Mw: Array
    Cw: Array
    Kw: Array
    # pseudo-inverse of M, and the projection on what carries no momentum
    Mpinv: Array
    null: Array


class Laws(NamedTuple):
    """The m laws: columns of the free (n, m) and moved (p, m) nodes between which each acts, code and parameters."""

    D: Array
    Dw: Array
    codes: Array
    params: Array
    # the current or logged channel that feeds each, or -1
    drives: Array
    # factors of all nodes' displacement in the load of a friction (m, n), (m, p)
    loads: Array
    loads_moved: Array


class Sources(NamedTuple):
    """Polynomials of the moved nodes' motion (p, samples - 1, 6), force inputs and currents, with their places."""

    motion: Array
    push: Array
    push_at: Array
    current: Array
    # thrust on the free nodes per ampere (currents, n)
    motor_at: Array
    # per current: delay in steps, decay over the first stage and the step, limit, dead zone, square reference
    motor: Array


class Samples(NamedTuple):
    """Displacement, velocity and acceleration (delays, samples, n), and the laws' forces (delays, samples, m)."""

    X: Array
    V: Array
    A: Array
    F: Array


@numba.njit(cache=True)
def _moved(motion, segment, tau, w, wv, wa):
    """Displacement w, velocity wv and acceleration wa of the moved nodes, `tau` seconds into a segment."""
    for j in range(len(w)):
        c = motion[j, segment]
        w[j] = c[0] + tau * (
            c[1] + tau * (c[2] + tau * (c[3] + tau * (c[4] + tau * c[5])))
        )
        wv[j] = c[1] + tau * (
            2 * c[2] + tau * (3 * c[3] + tau * (4 * c[4] + tau * 5 * c[5]))
        )
        wa[j] = 2 * c[2] + tau * (6 * c[3] + tau * (12 * c[4] + tau * 20 * c[5]))


@numba.njit(cache=True)
def _thrust_current(actual, motor):
    """Current that makes thrust, after the drive's even law and its saturation."""
    limit, reference = motor[3], motor[5]
    if reference != 0.0:
        actual = actual * (abs(actual) if reference > 0.0 else -actual) / reference
    return limit * np.tanh(actual / limit) if limit > 0.0 else actual


@numba.njit(cache=True)
def _outside(value, zone):
    """What a dead zone lets pass."""
    return value - min(max(value, -zone), zone)


@numba.njit(cache=True)
def _drive_motors(sources, laws, stage, step, per_sample, lagged, drive):
    """Take the motors' thrust from `drive`, and feed the laws that hang on a current or a logged channel."""
    current, motors, at_nodes, drives = (
        sources.current,
        sources.motor,
        sources.motor_at,
        laws.drives,
    )
    for j in range(len(current)):
        motor = motors[j]
        at = step - 1 - int(motor[0])
        command = _outside(current[j, at // per_sample] if at >= 0 else 0.0, motor[4])
        actual = command + (lagged[j] - command) * motor[1 + stage]
        if stage == 1:
            lagged[j] = actual
        actual = _thrust_current(actual, motor)
        for i in range(len(drive)):
            drive[i] -= at_nodes[j, i] * actual
        for e in range(len(drives)):
            if drives[e] == j:
                laws.params[e, FED] = actual


@numba.njit(cache=True)
def _integrate(
    samples, per_sample, h, interval, t0, matrices, laws, sources, x, v, z, offsets, out
):
    """March from the state x, v, z and write the samples, each offset steps earlier; the count of failed stages."""
    M, C, K, S, Mw, Cw, Kw, Mpinv, null = matrices
    D, codes, params, loads, loads_moved = (
        laws.D,
        laws.codes,
        laws.params,
        laws.loads,
        laws.loads_moved,
    )
    push, push_at = sources.push, sources.push_at
    across, across_moved = D.T.copy(), laws.Dw.T.copy()
    n, m, p = len(x), len(codes), len(sources.motion)
    hg = GAMMA * h
    again = (1.0 - GAMMA) / GAMMA
    SD = hg * (S @ D)
    G = across @ SD
    # momentum at the beginning of a step, at that of a stage and at its end; so are the laws' states
    mu, mu_base, mu_1 = M @ v, np.zeros(n), np.zeros(n)
    z_base, z1 = np.zeros(m), np.zeros(m)
    xa, V1, v_old, drive, rest = (
        np.zeros(n),
        np.zeros(n),
        v.copy(),
        np.zeros(n),
        np.zeros(n),
    )
    w, wv, wa = np.zeros(p), np.zeros(p), np.zeros(p)
    u, f, q, da, r, A = (
        np.zeros(m),
        np.zeros(m),
        np.zeros(m),
        np.zeros(m),
        np.zeros(m),
        np.zeros((m, m)),
    )
    lagged = np.zeros(len(sources.current))
    failures = 0
    for step in range((samples - 1) * per_sample + 1):
        v_old[:] = v
        for stage in range(2 if step > 0 else 0):
            segment = (step - 1) // per_sample
            part = GAMMA if stage == 0 else 1.0
            tau = ((step - 1) % per_sample + part) * h
            _moved(sources.motion, segment, tau, w, wv, wa)
            for i in range(n):
                drive[i] = -_row(Kw, i, w) - _row(Cw, i, wv) - _row(Mw, i, wa)
            for j in range(len(push)):
                rise = (push[j, segment + 1] - push[j, segment]) * tau / interval
                drive[push_at[j]] += push[j, segment] + rise
            _drive_motors(sources, laws, stage, step, per_sample, lagged, drive)
            for i in range(n):
                mu_base[i] = mu[i] + stage * again * (mu_1[i] - mu[i])
                xa[i] = x[i] + stage * (1.0 - GAMMA) * h * V1[i]
            for e in range(m):
                z_base[e] = z[e] + stage * again * (z1[e] - z[e])
            for i in range(n):
                rest[i] = mu_base[i] + hg * (drive[i] - _row(K, i, xa))
            for i in range(n):
                V1[i] = _row(S, i, rest)
            for e in range(m):
                q[e] = _row(across, e, V1) + _row(across_moved, e, wv)
                da[e] = (
                    _row(across, e, xa)
                    + _row(across_moved, e, w)
                    - hg * _row(across_moved, e, wv)
                )
                if codes[e] == LOADED_FRICTION:
                    free = _row(loads, e, xa) + hg * _row(loads, e, V1)
                    params[e, FED] = free + _row(loads_moved, e, w)
            time = t0 + (step - 1 + part) * h
            if m > 0 and not _stage(
                codes, params, da, q, G, z_base, hg, time, u, f, z1, A, r
            ):
                failures += 1
            for i in range(n):
                V1[i] -= _row(SD, i, f)
            for i in range(n):
                mu_1[i] = _row(M, i, V1)
        if step > 0:
            for i in range(n):
                x[i], v[i], mu[i] = xa[i] + hg * V1[i], V1[i], mu_1[i]
            z[:] = z1
        for o in range(len(offsets)):
            k, between = divmod(step + offsets[o], per_sample)
            if between != 0 or k >= samples:
                continue
            out.X[o, k], out.V[o, k], out.F[o, k] = x, v, f
            if step == 0:
                continue
            for i in range(
                n
            ):  # the rest of the balance is the rate of change of momentum
                rest[i] = drive[i] - _row(K, i, x) - _row(C, i, v) - _row(D, i, f)
            for i in range(n):
                out.A[o, k, i] = (
                    _row(Mpinv, i, rest) + (_row(null, i, v) - _row(null, i, v_old)) / h
                )
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


def _law_parameters(plant: _Plant) -> Array:
    """Parameters of every law, a row each, with the stiffness and damping of its contact and its table."""
    knots = max(
        [
            len(e.get("force", []))
            for e, code, *_ in plant.laws
            if code in (TABLE, RATE_TABLE)
        ],
        default=0,
    )
    params = np.zeros((len(plant.laws), ROWS + 2 * knots))
    for row, (e, code, values, _) in zip(params, plant.laws, strict=True):
        row[: len(values)] = values
        if code in CONTACTS:
            has_two_levels = code == DIRECTED or e["type"] == "stribeck_friction"
            row[STIFFNESS] = (
                max(values[:2] if has_two_levels else values[:1]) / PRESLIDING
            )
            row[DAMPER] = row[STIFFNESS] * CONTACT_TIME
        if code in (TABLE, RATE_TABLE):
            count = len(e["force"])
            row[KNOTS] = count
            row[ROWS : ROWS + count] = e["rate" if code == RATE_TABLE else "elongation"]
            row[ROWS + count : ROWS + 2 * count] = e["force"]
    return params


def _laws(plant: _Plant, params: Array, driven: list[Any]) -> Laws:
    """`driven`: the elements and channels that each current or logged channel feeds, in order."""
    n, count = len(plant.free), len(plant.laws)
    across = np.array([a for *_, a in plant.laws]).reshape(count, n + len(plant.moved))
    loads = np.zeros_like(across)
    drives = np.full(count, -1, dtype=np.int64)
    for at, (e, code, _, _) in enumerate(plant.laws):
        if code == LOADED_FRICTION:  # the load is a spring
            loads[at] = sum(
                s["stiffness"] * a
                for s, a in plant.linear
                if s.get("name") == e["load"]
            )
        feed = e.get("channel", e)
        if feed in driven:
            drives[at] = driven.index(feed)
    codes = np.array([code for _, code, _, _ in plant.laws], dtype=np.int64)
    free, moved = across[:, :n].T.copy(), across[:, n:].T.copy()
    return Laws(
        free, moved, codes, params, drives, loads[:, :n].copy(), loads[:, n:].copy()
    )


def _motor(model: Model, e: dict[str, Any], h: float) -> list[float]:
    """Delay in steps, decay of the lag over the first stage and the step, limit, dead zone and square reference."""
    effects = {f["type"]: f for f in model["elements"] if f.get("element") == e["name"]}
    tau = effects.get("actuator_lag", {}).get("time_constant", 0.0)
    decay = [
        float(np.exp(-part * h / tau)) if tau > 0 else 0.0 for part in (GAMMA, 1.0)
    ]
    square = effects.get("quadratic_thrust", {})
    return [
        round(effects.get("actuator_delay", {}).get("delay", 0.0) / h),
        *decay,
        effects.get("thrust_saturation", {}).get("current", 0.0),
        effects.get("drive_dead_zone", {}).get("threshold", 0.0),
        square.get("reference", 0.0)
        * (-1.0 if square.get("form") == "square" else 1.0),
    ]


def _sources(
    model: Model, plant: _Plant, inputs: Any, motion: Array, size: int, h: float
) -> tuple[Sources, list[Any]]:
    """The inputs as columns, and the element or logged channel that each current column feeds."""
    n = len(plant.free)
    push, push_at, current, motor_at, motor = [], [], [], [], []
    for i in model.get("inputs", []):
        if i["quantity"] == "force":
            row = plant.row(i["at"])[:n]
            for k in np.flatnonzero(row):
                push.append(row[k] * _column(inputs, i["name"], size))
                push_at.append(k)
    driven: list[Any] = [e for e, _ in plant.motors]
    commands = {
        i["element"]: i["name"]
        for i in model.get("inputs", [])
        if i["quantity"] == "current"
    }
    for e, direction in plant.motors:
        name = commands.get(e["name"])
        current.append(_column(inputs, name, size) if name else np.zeros(size))
        motor.append(_motor(model, e, h))
        motor_at.append(
            e.get("thrust_constant", 0.0) * e.get("ratio", 1.0) * direction[:n]
        )
    for i in model.get("inputs", []):
        if i["quantity"] in LOGGED:  # feeds laws as a current does, and drives nothing
            driven.append(i["name"])
            current.append(_column(inputs, i["name"], size))
            motor.append([0.0] * 6)
            motor_at.append(np.zeros(n))
    columns = Sources(
        motion,
        np.array(push).reshape(len(push), size),
        np.array(push_at, dtype=np.int64),
        np.array(current).reshape(len(current), size),
        np.array(motor_at).reshape(len(current), n),
        np.array(motor, dtype=float).reshape(len(current), 6),
    )
    return columns, driven


def _matrices(plant: _Plant, h: float) -> Matrices:
    n = len(plant.free)
    M, C, K = (a[:n, :n].copy() for a in (plant.mass, plant.damping, plant.stiffness))
    moved = (a[:n, n:].copy() for a in (plant.mass, plant.damping, plant.stiffness))
    inverse = _inverse(M + GAMMA * h * C + (GAMMA * h) ** 2 * K)
    Mpinv = np.linalg.pinv(M, rcond=1e-10) if M.any() else np.zeros((n, n))
    return Matrices(M, C, K, inverse, *moved, Mpinv, np.eye(n) - Mpinv @ M)


def _blank(delays: int, samples: int, nodes: int, laws: int) -> Samples:
    return Samples(
        *(np.zeros((delays, samples, width)) for width in (nodes, nodes, nodes, laws))
    )


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
    n, m, size = len(plant.free), len(plant.laws), len(t)
    per_sample = max(1, int(np.ceil(interval / step - 1e-9)))
    h = interval / per_sample
    motion = _motion(model, plant, t, interval, inputs, derivatives)
    sources, driven = _sources(model, plant, inputs, motion, size, h)
    laws = _laws(plant, _law_parameters(plant), driven)

    # The first sample: massless nodes find their balance, stuck contacts their force, in two steps of 1 us.
    x, v = _initial(plant, initial)
    z = np.zeros(m)
    contact = np.isin(laws.codes, CONTACTS)
    rigid = laws.params.copy()
    rigid[contact, STIFFNESS : DAMPER + 1] *= 1e6
    start = _blank(1, 2, n, m)
    rigid_laws = laws._replace(params=rigid)
    _integrate(
        2,
        2,
        1e-6,
        interval,
        t[0],
        _matrices(plant, 1e-6),
        rigid_laws,
        sources,
        x,
        v,
        z,
        np.zeros(1, dtype=np.int64),
        start,
    )
    start.X[0, 1] -= 2e-6 * start.V[0, 1]
    start.V[0, 1] -= 2e-6 * start.A[0, 1]
    x, v = start.X[0, 1].copy(), start.V[0, 1].copy()
    z[contact] = start.F[0, 1, contact] / np.maximum(
        laws.params[contact, STIFFNESS], 1e-300
    )

    offsets = np.array([round(d / h) for d in delays], dtype=np.int64)
    out = _blank(len(offsets), size, n, m)
    failures = _integrate(
        size,
        per_sample,
        h,
        interval,
        t[0],
        _matrices(plant, h),
        laws,
        sources,
        x,
        v,
        z,
        offsets,
        out,
    )
    for o, offset in enumerate(offsets):
        for signal, first in zip(out, start, strict=True):
            signal[o, : offset // per_sample + 1] = first[0, 1]
    if not all(np.isfinite(signal).all() for signal in out):
        raise ArithmeticError("the simulation diverged")
    # A contact with damping jumps at touch-down, where no stage equation holds exactly; more is an error.
    if failures > 1e-3 * 2 * size * per_sample:
        raise ArithmeticError(f"{failures} stages did not converge")
    return [
        _trajectory(
            model, plant, t, sources, offset * h, h, [signal[o] for signal in out]
        )
        for o, offset in enumerate(offsets)
    ]


def _element_force(
    e: dict[str, Any],
    across: Array,
    plant: _Plant,
    motion: tuple[Array, ...],
    currents: dict[str, Array],
) -> Array:
    """Force of a linear element (samples,) [N]."""
    x, v, a = motion
    kind = e["type"]
    if kind == "motor":
        return e["thrust_constant"] * e.get("ratio", 1.0) * currents[e["name"]]
    factor = e[LINEAR[kind]]
    if kind == "linear_damping":
        return factor * (v @ across)
    if kind == "inertance":
        return factor * (a @ across)
    if kind == "terminal_inertia":
        return factor * (a @ _terminal(e, *(plant.row(n) for n in e["between"])))
    return factor * (x @ across)


def _trajectory(
    model: Model,
    plant: _Plant,
    t: Array,
    sources: Sources,
    delay: float,
    h: float,
    signals: list[Array],
) -> Trajectory:
    """Join the free and the moved nodes and evaluate the linear elements."""
    size, interval = len(t), float((t[-1] - t[0]) / (len(t) - 1))
    since = np.maximum(np.arange(size) * interval - delay, 0.0)
    segment = np.clip(np.ceil(since / interval - 1e-9).astype(int) - 1, 0, size - 2)
    powers = (since - segment * interval)[:, None] ** np.arange(6)
    coefficients = sources.motion[:, segment]
    moved = []
    for _ in range(3):
        moved.append(
            np.einsum("pkc,kc->kp", coefficients, powers[:, : coefficients.shape[2]])
        )
        coefficients = coefficients[:, :, 1:] * np.arange(1, coefficients.shape[2])
    *free, law_forces = signals
    motion = tuple(
        np.concatenate(pair, axis=1) for pair in zip(free, moved, strict=True)
    )
    currents = {
        e["name"]: _actual_current(column, motor, h, since)
        for (e, _), column, motor in zip(
            plant.motors, sources.current, sources.motor, strict=False
        )
    }
    forces = [
        (e, _element_force(e, across, plant, motion, currents))
        for e, across in plant.linear
    ]
    forces += [(e, law_forces[:, i]) for i, (e, *_) in enumerate(plant.laws)]
    load = {"ground": np.zeros(size)}
    for node in plant.moved:
        load[node] = model.get("masses", {}).get(node, 0.0) * (
            motion[2] @ plant.row(node)
        )
    for e, force in forces:
        for node, sign in zip(e["between"], (1.0, -1.0), strict=True):
            if node in load:
                load[node] = load[node] + sign * force
    nodes = plant.free + plant.moved + list(plant.tied)
    by_node = ({n: signal @ plant.row(n) for n in nodes} for signal in motion)
    return Trajectory(
        t, *by_node, {e["name"]: f for e, f in forces if "name" in e}, load
    )


def _actual_current(command: Array, motor: Array, h: float, since: Array) -> Array:
    """The current that makes thrust, just before each instant, by the same rounding as the integrator's."""
    delay, decay, zone = int(motor[0]), motor[2], motor[4]
    per_sample = round((since[-1] - since[-2]) / h)
    actual = np.empty(len(since))
    value, at = command[0] if delay == 0 and decay == 0 else 0.0, 0
    for k, target in enumerate(np.round(since / h).astype(int)):
        while at < target:
            source = at - delay
            # as far as the command stays the same
            span = min(target - at, per_sample - source % per_sample)
            held = _outside(command[source // per_sample] if source >= 0 else 0.0, zone)
            value = held + (value - held) * decay**span
            at += span
        actual[k] = _thrust_current(value, motor)
    return actual


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
    model: Model, time: ArrayLike, inputs: Mapping[str, ArrayLike], **options: Any
) -> dict[str, Array]:
    """The model's outputs at `time`, by name.

    model: `isd-model/1` as read from JSON. time (samples,) [s], uniform. inputs: by name, (samples,), in SI.
    options, as for `trajectories`: step: the longest step [s]. initial: node -> (displacement [m], velocity [m/s])
    of free nodes, others at rest at zero. derivatives: input name -> (velocity, acceleration) of a displacement input.
    """
    delay = {
        e["channel"]: e["delay"]
        for e in model["elements"]
        if e["type"] == "sensor_delay"
    }
    delays = tuple(sorted({0.0, *delay.values()}))
    runs = trajectories(model, time, inputs, delays=delays, **options)
    table = {}
    for output in model["outputs"]:
        name = output["name"]
        y = _channel(output, runs[delays.index(delay.get(name, 0.0))])
        for e in model["elements"]:
            if e.get("channel") == name:
                y = y * e["gain"] if e["type"] == "sensor_gain" else y
                y = y + e["bias"] if e["type"] == "sensor_bias" else y
                y = np.abs(y) if e["type"] == "sensor_magnitude" else y
                y = (
                    y - np.clip(y, -e["width"], e["width"])
                    if e["type"] == "sensor_dead_zone"
                    else y
                )
        table[name] = np.array(y)
    return table
