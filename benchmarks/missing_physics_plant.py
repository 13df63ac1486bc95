"""Simulation and fit of the models of MissingPhysBench for tools that have none: masses, springs, dampers and one missing force.

Needs numpy, scipy and numba; nothing of isd_gym.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numba
import numpy as np
from scipy.interpolate import CubicSpline
from scipy.optimize import least_squares
from scipy.signal import savgol_filter

if TYPE_CHECKING:
    from pathlib import Path

Columns = dict[str, np.ndarray]
Place = tuple[str, str]
#: law -> code, names of its parameters
LAWS = {
    "coulomb_friction": (2, ("level",)),
    "stribeck_friction": (3, ("level", "static_level", "stribeck_velocity")),
    "quadratic_damping": (4, ("damping",)),
    "asymmetric_damping": (5, ("extension",)),
    "cubic_stiffness": (6, ("stiffness",)),
    "bump_stop": (7, ("clearance", "stiffness")),
    "linear_damping": (1, ("damping",)),
    "linear_stiffness": (0, ("stiffness",)),
}
#: code of a force given as a table over distance and rate
TABLE = 8
#: rate below which dry friction is linear, as a share of the RMS rate
CREEP = 0.05
#: windows [samples] and order of the filter that differentiates records; a tool chooses among the windows
WINDOWS, ORDER = (7, 11, 21, 41), 3


@numba.njit(cache=True)
def _force(code, p, grid, d, v):
    if code == 0:
        return p[0] * d
    if code == 1:
        return p[0] * v
    if code == 2:
        return p[0] * min(max(v / p[3], -1.0), 1.0)
    if code == 3:
        level = p[0] + (p[1] - p[0]) * np.exp(-((v / p[2]) ** 2))
        return level * min(max(v / p[3], -1.0), 1.0)
    if code == 4:
        return p[0] * v * abs(v)
    if code == 5:
        return p[0] * max(v, 0.0)
    if code == 6:
        return p[0] * d**3
    if code == 7:
        return p[1] * (max(d - p[0], 0.0) + min(d + p[0], 0.0))
    rows, columns = grid.shape  # bilinear; p: largest distance, largest rate
    i = min(max((d / p[0] + 1.0) * 0.5 * (rows - 1), 0.0), rows - 1.0)
    j = min(max((v / p[1] + 1.0) * 0.5 * (columns - 1), 0.0), columns - 1.0)
    k, m = min(int(i), rows - 2), min(int(j), columns - 2)
    s, t = i - k, j - m
    low = (1 - t) * grid[k, m] + t * grid[k, m + 1]
    return (1 - s) * low + s * ((1 - t) * grid[k + 1, m] + t * grid[k + 1, m + 1])


@numba.njit(cache=True)
def _rates(x, v, n, ends, codes, P, grid, mass, push, a):
    for i in range(n):
        a[i] = push[i]
    for k in range(len(codes)):
        i, j = ends[k, 0], ends[k, 1]
        f = _force(codes[k], P[k], grid, x[i] - x[j], v[i] - v[j])
        if i < n:
            a[i] -= f
        if j < n:
            a[j] += f
    for i in range(n):
        a[i] /= mass[i]


@numba.njit(cache=True)
def _march(n, ends, codes, P, grid, mass, moved, moved_rate, push, step, substeps):
    """Runge-Kutta of fourth order from rest; inputs are linear between samples. Nodes: masses, moved nodes, ground."""
    size, m = moved.shape
    X, V, A = (
        np.zeros((size, n + m + 1)),
        np.zeros((size, n + m + 1)),
        np.zeros((size, n)),
    )
    x, v, h = np.zeros(n + m + 1), np.zeros(n + m + 1), step / substeps
    xs, vs = np.zeros((4, n)), np.zeros((4, n))
    a, xt, vt, f = np.zeros(n), np.zeros(n + m + 1), np.zeros(n + m + 1), np.zeros(n)
    for k in range(size):
        x[n : n + m], v[n : n + m] = moved[k], moved_rate[k]
        X[k], V[k] = x, v
        _rates(x, v, n, ends, codes, P, grid, mass, push[k], a)
        A[k] = a
        if k == size - 1:
            break
        for q in range(substeps):
            for stage in range(4):
                share = 0.0 if stage == 0 else (1.0 if stage == 3 else 0.5)
                s = (q + share) / substeps
                for i in range(n):
                    xt[i] = x[i] + (h * share * xs[stage - 1, i] if stage else 0.0)
                    vt[i] = v[i] + (h * share * vs[stage - 1, i] if stage else 0.0)
                    f[i] = (1 - s) * push[k, i] + s * push[k + 1, i]
                for i in range(m):
                    xt[n + i] = (1 - s) * moved[k, i] + s * moved[k + 1, i]
                    vt[n + i] = (1 - s) * moved_rate[k, i] + s * moved_rate[k + 1, i]
                _rates(xt, vt, n, ends, codes, P, grid, mass, f, a)
                for i in range(n):
                    xs[stage, i], vs[stage, i] = vt[i], a[i]
            for i in range(n):
                x[i] += h / 6 * (xs[0, i] + 2 * xs[1, i] + 2 * xs[2, i] + xs[3, i])
                v[i] += h / 6 * (vs[0, i] + 2 * vs[1, i] + 2 * vs[2, i] + vs[3, i])
                if not abs(x[i]) < 1e6:
                    X[:] = np.nan
                    return X, V, A
    return X, V, A


@dataclass(frozen=True)
class Extra:
    """A force beside the model: a law with parameters, a table, or a sensor (gain and delay of a channel)."""

    law: str
    place: tuple[str, ...]
    values: tuple[float, ...]
    #: force over distance (rows) and rate (columns) for the law "table"; values: the largest distance and rate
    grid: np.ndarray | None = None


class Plant:
    """The model of a case."""

    def __init__(self, case: Path) -> None:
        self.model: dict[str, Any] = json.loads(
            (case / "model.json").read_text(encoding="utf-8")
        )
        self.window = WINDOWS[2]
        self.masses = list(self.model["masses"])
        self.moved = {
            i["at"]: i["name"]
            for i in self.model["inputs"]
            if i["quantity"] == "displacement"
        }
        self.pushed = {
            i["at"]: i["name"] for i in self.model["inputs"] if i["quantity"] == "force"
        }
        self.nodes = [*self.masses, *self.moved, "ground"]
        self.uncertain: dict[str, float] = self.model["uncertainty"]
        self.outputs: list[dict[str, Any]] = self.model["outputs"]
        # sampling step of the records [s]
        with (case / "test_input.csv").open(encoding="utf-8") as file:
            first, second = (
                float(line.split(",")[0]) for line in file.read().splitlines()[1:3]
            )
        self.step = second - first

    @property
    def places(self) -> list[Place]:
        """Pairs of nodes that have an element, and every mass with the ground."""
        pairs = [tuple(e["between"]) for e in self.model["elements"]]
        return list(dict.fromkeys([*pairs, *((m, "ground") for m in self.masses)]))

    def values(self, theta: np.ndarray) -> dict[str, float]:
        """Return the uncertain parameters: the nominal values times exp(theta)."""
        elements = {e["name"]: e for e in self.model["elements"]}
        out = {}
        for path, q in zip(self.uncertain, theta, strict=True):
            name, key = path.split(".")
            nominal = (
                self.model["masses"][name] if key == "mass" else elements[name][key]
            )
            out[path] = nominal * float(np.exp(q))
        return out

    def terms(
        self, theta: np.ndarray
    ) -> tuple[np.ndarray, list[tuple[Place, str, float]]]:
        """Return the masses, and place, law and parameter of every element of the model."""
        values = self.values(theta)
        mass = np.array(
            [values.get(f"{n}.mass", self.model["masses"][n]) for n in self.masses]
        )
        key = {"linear_stiffness": "stiffness", "linear_damping": "damping"}
        elements = [
            (
                tuple(e["between"]),
                e["type"],
                values.get(f"{e['name']}.{key[e['type']]}", e[key[e["type"]]]),
            )
            for e in self.model["elements"]
        ]
        return mass, elements

    def simulate(
        self, theta: np.ndarray, extras: list[Extra], table: Columns
    ) -> Columns:
        """Return the outputs for the inputs of a table, from rest."""
        mass, elements = self.terms(theta)
        step, n = float(table["time"][1] - table["time"][0]), len(self.masses)
        moved = np.zeros((len(table["time"]), len(self.moved)))
        rate, push = np.zeros_like(moved), np.zeros((len(table["time"]), n))
        for j, name in enumerate(self.moved.values()):
            moved[:, j], rate[:, j] = (
                table[name],
                CubicSpline(table["time"], table[name])(table["time"], 1),
            )
        for node, name in self.pushed.items():
            push[:, self.masses.index(node)] += table[name]
        speed = self._speed(table)
        ends, codes, P = [], [], []
        for place, law, value in elements:
            ends.append([self.nodes.index(k) for k in place])
            codes.append(LAWS[law][0])
            P.append([value, 0.0, 0.0, 1.0])
        grid, substeps = np.zeros((2, 2)), 2
        for e in extras:
            if len(e.place) != 2:
                continue
            ends.append([self.nodes.index(k) for k in e.place])
            codes.append(TABLE if e.grid is not None else LAWS[e.law][0])
            grid = e.grid if e.grid is not None else grid
            P.append([*e.values, *[0.0] * (3 - len(e.values)), CREEP * speed])
            if e.law in ("coulomb_friction", "stribeck_friction"):
                slope = max(abs(x) for x in e.values[:2]) / (CREEP * speed) / mass.min()
                substeps = min(max(substeps, int(np.ceil(step * slope / 2.0))), 60)
        X, V, A = _march(
            n,
            np.array(ends),
            np.array(codes),
            np.array(P),
            grid,
            mass,
            moved,
            rate,
            push,
            step,
            substeps,
        )
        out = {}
        for o in self.outputs:
            i, j = (
                self.nodes.index(k) for k in (o.get("between") or (o["at"], "ground"))
            )
            if o["quantity"] == "acceleration":
                y = A[:, i]
            else:
                y = (X if o["quantity"] == "displacement" else V)[:, i] - (
                    X if o["quantity"] == "displacement" else V
                )[:, j]
            for e in extras:
                if e.place == (o["name"],) and e.law == "sensor_gain":
                    y = e.values[0] * y
                elif e.place == (o["name"],) and e.law == "sensor_delay":
                    y = np.interp(table["time"] - e.values[0], table["time"], y)
            out[o["name"]] = y
        return out

    def _speed(self, table: Columns) -> float:
        """Return a typical rate: that of the fastest differentiated displacement."""
        if not hasattr(self, "_typical"):
            names = [o["name"] for o in self.outputs if o["quantity"] == "displacement"]
            step = float(table["time"][1] - table["time"][0])
            self._typical = max(
                float(np.std(savgol_filter(table[n], WINDOWS[2], ORDER, 1, step)))
                for n in names
            )
        return self._typical

    def fit(
        self,
        tables: list[Columns],
        extras: list[Extra] | None = None,
        weight: dict[str, float] | None = None,
    ) -> tuple[np.ndarray, list[Extra], float, dict[str, float]]:
        """Fit the uncertain parameters and those of `extras` by output error, with the stated deviations as prior.

        Args:
            tables: Records.
            extras: Forces with the values to start from.
            weight: Deviation of the residual of every channel; estimated from a fit with equal relative weights if None.

        Returns:
            Logarithms of the factors, extras with fitted values, the deviance -2 log L, and the deviations of the residuals.
        """
        extras = extras or []
        sigma = np.array(list(self.uncertain.values()))
        start = np.concatenate(
            [np.zeros(len(sigma)), *(np.ones(len(e.values)) for e in extras)]
        )
        scale = {o["name"]: float(np.std(tables[0][o["name"]])) for o in self.outputs}

        def unpack(x: np.ndarray) -> tuple[np.ndarray, list[Extra]]:
            rest, out = x[len(sigma) :], []
            for e in extras:
                own, rest = rest[: len(e.values)], rest[len(e.values) :]
                out.append(
                    Extra(
                        e.law,
                        e.place,
                        tuple(float(a * b) for a, b in zip(own, e.values, strict=True)),
                        e.grid,
                    )
                )
            return x[: len(sigma)], out

        def errors(x: np.ndarray) -> dict[str, np.ndarray]:
            theta, now = unpack(x)
            runs = [(self.simulate(np.clip(theta, -2, 2), now, t), t) for t in tables]
            return {
                c: np.nan_to_num(
                    np.concatenate([y[c] - t[c] for y, t in runs]),
                    nan=1e3 * s,
                    posinf=1e3 * s,
                    neginf=-1e3 * s,
                )
                for c, s in scale.items()
            }

        def solve(x: np.ndarray, by: dict[str, float]) -> np.ndarray:
            def residual(x: np.ndarray) -> np.ndarray:
                e = errors(x)
                return np.concatenate(
                    [
                        *(np.clip(e[c] / by[c], -1e6, 1e6) for c in e),
                        x[: len(sigma)] / sigma,
                    ]
                )

            return least_squares(
                residual, x, method="trf", max_nfev=15, diff_step=1e-4
            ).x

        x = start
        if weight is None:
            x = solve(x, {c: 0.05 * s for c, s in scale.items()})
            weight = {c: float(np.std(e)) for c, e in errors(x).items()}
        x = solve(x, weight)
        left = errors(x)
        deviance = sum(len(e) * np.log(np.mean(e**2)) for e in left.values())
        deviance += float(np.sum((x[: len(sigma)] / sigma) ** 2))
        theta, fitted = unpack(x)
        return (
            theta,
            fitted,
            float(deviance),
            {c: float(np.std(e)) for c, e in left.items()},
        )

    def error(self, theta: np.ndarray, extras: list[Extra], table: Columns) -> float:
        """Return the error of a free run: root mean square over channels of RMS over deviation."""
        y = self.simulate(theta, extras, table)
        parts = [np.mean((y[c] - table[c]) ** 2) / np.var(table[c]) for c in y]
        return float(np.sqrt(np.mean(parts))) if np.isfinite(parts).all() else np.inf

    def motion(self, table: Columns) -> tuple[Columns, Columns, Columns]:
        """Return displacement, velocity and acceleration of every node, by differentiating the displacements."""
        step = float(table["time"][1] - table["time"][0])
        node = {"ground": np.zeros(len(table["time"]))} | {
            k: table[name] for k, name in self.moved.items()
        }
        while len(node) < len(self.nodes):
            for o in self.outputs:
                if o["quantity"] == "displacement":
                    first, second = o.get("between") or (o["at"], "ground")
                    if second in node and first not in node:
                        node[first] = node[second] + table[o["name"]]
        return tuple(  # type: ignore[return-value]
            {
                k: savgol_filter(x, self.window, ORDER, order, step)
                for k, x in node.items()
            }
            for order in range(3)
        )

    def residual_forces(
        self, theta: np.ndarray, table: Columns
    ) -> tuple[Columns, dict[Place, tuple[np.ndarray, np.ndarray]]]:
        """Return the force on every mass that the model does not explain, and distance and rate at every place."""
        x, v, a = self.motion(table)
        mass, elements = self.terms(theta)
        force = {n: m * a[n] for n, m in zip(self.masses, mass, strict=True)}
        for node, name in self.pushed.items():
            force[node] = force[node] - table[name]
        for (i, j), law, value in elements:
            f = value * (x[i] - x[j] if law == "linear_stiffness" else v[i] - v[j])
            for node, sign in ((i, 1.0), (j, -1.0)):
                if node in force:
                    force[node] = force[node] + sign * f
        inner = slice(self.window, -self.window)  # the filter extrapolates at the ends
        at = {p: (x[p[0]] - x[p[1]], v[p[0]] - v[p[1]]) for p in self.places}
        return {n: f[inner] for n, f in force.items()}, {
            p: (d[inner], w[inner]) for p, (d, w) in at.items()
        }
