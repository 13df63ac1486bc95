"""The clairvoyant optimum: the least cost of an episode whose whole road is known in advance.

Minimises the stage cost over the currents of one episode (4000 of them in 20 s), through the real kernel with
its projected friction, end stop and every other law, under |I| <= 5 A and |dI| <= 0.5 A per control step.

Method. Differential dynamic programming (Gauss-Newton) over the control steps, state (x, memory of the laws, current),
input dI. The limits are log barriers, lowered to nothing; the Jacobians are differences through the kernel itself, so
any network will do. Friction makes the problem non-smooth and non-convex: the projection ``f = clip(-v / g, F)`` is
first softened (g larger: friction like a steep damper below a small velocity) and hardened step by step, and
the descent ends on the real law. What is returned is rolled out by the real environment, so it is *reached*: an upper
bound of the optimum. `lower` is a proven lower bound, see `relaxation`.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numba as nb
import numpy as np

from isd_gym import elements as el
from isd_gym.batch import CURRENT_LIMIT, SLEW_LIMIT, signal_channels
from isd_gym.cost import StageCost
from isd_gym.errors import InputError
from isd_gym.kernel import _stamp, kernel
from isd_gym.network import Network
from isd_gym.road import Road
from isd_gym.road import road as find_road
from isd_gym.simulate import PHYSICS_STEP, Plant

CONTROL_STEP = 5e-3  # s
SLACK = 1e-9  # the currents stay this far inside the limits [A]


def _forward(size, tag, mats, ints, u, start, current, nominal, ff, fb, alpha, rows, sub, limits, Z, S, I, Y):
    """Roll out ``dI = nominal + alpha ff - fb (z - z_nominal)``, kept inside the barriers; fills Z, S, I, Y."""
    steps, nz = current.shape[0], rows.shape[0]
    slew, most = limits[0], limits[1]
    state = start.copy()
    c = np.zeros((sub, max(1, ints[1]), 1))
    y = np.empty((ints[4], 1))
    last, last_nominal = 0.0, 0.0
    for k in range(steps):
        S[k] = state[:, 0]
        for i in range(nz):
            Z[k, i] = state[rows[i], 0]
        step = current[k] - last_nominal
        d = step + alpha * ff[k]
        for i in range(nz):
            d -= fb[k, i] * (Z[k, i] - nominal[k, i])
        d -= fb[k, nz] * (last - last_nominal)
        # a feedback may not leap over a barrier: at most 99.5 % of the way from the nominal to it
        high = min(slew, most - last)
        low = max(-slew, -most - last)
        inside = min(max(step, low), high)
        d = min(max(d, inside + 0.995 * (low - inside)), inside + 0.995 * (high - inside))
        last_nominal = current[k]
        last = last + d
        I[k] = last
        for i in range(sub):
            c[i, 0, 0] = last
        advance(size, tag, mats, ints, state, u[k * sub : (k + 1) * sub + 1], c, 1)  # noqa: F821
        measure(size, tag, mats, ints, state, u[(k + 1) * sub], c[sub - 1], 1, y)  # noqa: F821
        Y[k, 0], Y[k, 1], Y[k, 2] = y[0, 0], y[1, 0], y[2, 0]


def _jacobian(size, tag, mats, ints, u, S, I, rows, sub, delta, FZ, YZ):
    """Differences of the next state and the outputs with respect to (z, I), every control step."""
    steps, nz = I.shape[0], rows.shape[0]
    lanes = nz + 2
    state = np.empty((S.shape[1], lanes))
    c = np.zeros((sub, max(1, ints[1]), lanes))
    y = np.empty((ints[4], lanes))
    w = np.empty((sub + 1, u.shape[1], lanes))
    for k in range(steps):
        for i in range(sub + 1):
            for j in range(u.shape[1]):
                w[i, j, :] = u[k * sub + i, j, 0]
        for l in range(lanes):
            state[:, l] = S[k]
            if l < nz:
                state[rows[l], l] += delta
            for i in range(sub):
                c[i, 0, l] = I[k] + (delta if l == nz else 0.0)
        advance(size, tag, mats, ints, state, w, c, lanes)  # noqa: F821
        measure(size, tag, mats, ints, state, w[sub], c[sub - 1], lanes, y)  # noqa: F821
        for l in range(nz + 1):
            for i in range(nz):
                FZ[k, i, l] = (state[rows[i], l] - state[rows[i], nz + 1]) / delta
            for i in range(3):
                YZ[k, i, l] = (y[i, l] - y[i, nz + 1]) / delta


@nb.njit(error_model="numpy", cache=True)
def _backward(FZ, YZ, Y, I, q, qi, mu, limits, reg, ff, fb):
    """One Riccati sweep; returns (expected descent, ok)."""
    steps, nz = I.shape[0], FZ.shape[1]
    n = nz + 1
    slew, most = limits[0], limits[1]
    V, v = np.zeros((n, n)), np.zeros(n)
    F, b = np.zeros((n, n)), np.zeros(n)
    VF = np.empty((n, n))
    Q, p = np.empty((n, n)), np.empty(n)
    s = np.empty(n)
    drop = 0.0
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
            t = 0.0
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
            w = 2.0 * q[m]
            if w != 0.0:
                yi = YZ[k, m, nz]
                for i in range(n):
                    p[i] += w * Y[k, m] * YZ[k, m, i]
                    s[i] += w * yi * YZ[k, m, i]
                    for j in range(n):
                        Q[i, j] += w * YZ[k, m, i] * YZ[k, m, j]
                g += w * Y[k, m] * yi
                r0 += w * yi * yi
        h1 = 2.0 * qi * now + mu * (1.0 / (most - now) - 1.0 / (most + now))
        h2 = 2.0 * qi + mu * (1.0 / (most - now) ** 2 + 1.0 / (most + now) ** 2)
        p[nz] += h1
        g += h1
        Q[nz, nz] += h2
        s[nz] += h2
        r0 += h2
        g += mu * (1.0 / (slew - d) - 1.0 / (slew + d))
        r0 += mu * (1.0 / (slew - d) ** 2 + 1.0 / (slew + d) ** 2)
        r1 = r0 + reg
        if not r1 > 0.0:
            return 0.0, False
        ff[k] = -g / r1
        drop += g * g / r1
        for i in range(n):
            fb[k, i] = s[i] / r1
        for i in range(n):
            v[i] = p[i] + s[i] * ff[k] - fb[k, i] * (g + r0 * ff[k])
            for j in range(i + 1):
                t = Q[i, j] - fb[k, i] * s[j] - s[i] * fb[k, j] + fb[k, i] * r0 * fb[k, j]
                V[i, j] = t
                V[j, i] = t
    return drop, True


_PLAIN = (_forward, _jacobian)


@functools.cache
def _bind(stamp: int) -> tuple[Callable, Callable]:
    bound = kernel()
    scope = globals()
    scope["advance"], scope["measure"] = bound.advance, bound.measure
    out = []
    for plain in _PLAIN:
        plain.__qualname__ = f"{plain.__name__}_{stamp:x}"  # as the kernel's: its laws are compiled in
        out.append(nb.njit(plain, nogil=True, error_model="numpy", cache=True))
    return out[0], out[1]


def _compiled() -> tuple[Callable, Callable]:
    return _bind(_stamp())


class Episode:
    """One road and one car, ready to be rolled out for any currents."""

    def __init__(
        self,
        network: Network,
        heights: np.ndarray,
        *,
        cost: StageCost,
        control_step: float = CONTROL_STEP,
        limits: tuple[float, float] = (SLEW_LIMIT, CURRENT_LIMIT),
    ) -> None:
        for e in network.elements:
            if isinstance(e, el.ActuatorLag | el.ActuatorDelay | el.ThrustSaturation):
                raise InputError(f"element '{e.name}': the clairvoyant optimum needs an ideal drive")
        if not any(isinstance(e, el.Motor) for e in network.elements):
            raise InputError(f"network '{network.name}' has no motor")
        self.network, self.cost, self.control_step = network, cost, control_step
        self.sub = round(control_step / PHYSICS_STEP)
        heights = np.asarray(heights, float)
        self.steps, rest = divmod(len(heights) - 1, self.sub)
        if rest or self.steps < 1 or not np.all(np.isfinite(heights)):
            raise InputError(
                f"heights must be finite, one every {PHYSICS_STEP:g} s, a whole number of control steps and one more"
            )
        self.heights = heights
        bare = Network(
            network.name,
            network.masses,
            tuple(e for e in network.elements if e.place != "channel"),
            network.inputs,
        )
        wanted = ("body_acceleration", "suspension_travel", "tyre_load")
        extra = [c for c in signal_channels(network) if c.name in wanted]
        bare = Network(bare.name, bare.masses, bare.elements, bare.inputs)
        self.single = Plant(bare, PHYSICS_STEP, extra=extra)
        memory = [
            self.single.n + self.single.n_laws + j
            for j, e in enumerate(self.single.assemblies[0].laws)
            if isinstance(e, el.Hysteresis)
        ]
        self.rows = np.array([*range(self.single.n), *memory], np.int64)
        self.nz = len(self.rows)
        self.many = Plant(bare, PHYSICS_STEP, lanes=self.nz + 2, extra=extra)
        h = PHYSICS_STEP
        rate = np.diff(heights, prepend=heights[0]) / h
        columns = {"r": heights, "v": rate, "alpha": np.diff(rate, prepend=0.0) / h}
        self.u = np.zeros((len(heights), max(len(self.single.labels), 1), 1))
        for j, (part, _) in enumerate(self.single.labels):
            self.u[:, j, 0] = columns[part]
        a, l, f, i = cost.quadratic
        self.q, self.qi = np.array([a, l, f]), i
        slew, most = limits
        self.limits = np.array([slew - SLACK, most - SLACK])
        self.start = self.single.state()
        n, nl = self.single.n, self.single.n_laws
        size = 1 + 3 * n * 0  # noqa: F841
        self._gs = self._friction_entries(n, nl)

    def _friction_entries(self, n: int, nl: int) -> list[int]:
        """Rows of `mats` that hold how much a friction force slows its own sliding."""
        asm = self.single.assemblies[0]
        m, nc = max(len(self.single.u_columns), 1), max(len(self.single.currents), 1)
        before = 1 + n * n + 2 * n * m + n * nc + 2 * n * nl + 2 * nl * (n + m + nc) + nl * nl
        return [before + j * nl + j for j, e in enumerate(asm.laws) if e.bound is not None]

    def softened(self, softness: float) -> tuple[np.ndarray, np.ndarray]:
        """Matrices of the two plants with friction like a damper below ``softness * |g| * level``."""
        out = []
        for plant in (self.single, self.many):
            mats = plant.mats.copy()
            mats[self._gs] *= 1.0 + softness
            out.append(mats)
        return out[0], out[1]

    def value(self, Y: np.ndarray, I: np.ndarray) -> float:
        return float(np.mean(Y**2 @ self.q + self.qi * I**2))

    def rollout(self, currents: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Real outputs (steps, 3) for currents; also the states and kernel states along the way."""
        zero, none = np.zeros(self.steps), np.zeros((self.steps, self.nz + 1))
        Z, S, I, Y = self._buffers()
        forward, _ = _compiled()
        p = self.single
        wide = np.array([1e9, 1e9])
        forward(
            *(p.size, p.tag, p.mats, p.ints, self.u, self.start, np.asarray(currents, float), Z.copy(), zero, none),
            *(0.0, self.rows, self.sub, wide, Z, S, I, Y),
        )
        return Y, Z, S

    def _buffers(self):
        N = self.steps
        return (
            np.zeros((N, self.nz)),
            np.zeros((N, len(self.start))),
            np.zeros(N),
            np.zeros((N, 3)),
        )

    def descend(
        self,
        currents: np.ndarray,
        *,
        softness: float,
        mu: float,
        iterations: int,
        tolerance: float = 1e-4,
        trace: list | None = None,
    ) -> np.ndarray:
        """DDP at one softness and barrier from `currents` (strictly inside the limits)."""
        forward, jacobian = _compiled()
        one, many = self.softened(softness)
        p, pm = self.single, self.many
        N, nz = self.steps, self.nz
        ff, fb = np.zeros(N), np.zeros((N, nz + 1))
        FZ, YZ = np.zeros((N, nz, nz + 1)), np.zeros((N, 3, nz + 1))
        I = np.asarray(currents, float).copy()

        def roll(I0, Z0, alpha):
            Z, S, I1, Y = self._buffers()
            forward(
                *(p.size, p.tag, one, p.ints, self.u, self.start, I0, Z0, ff, fb),
                *(alpha, self.rows, self.sub, self.limits, Z, S, I1, Y),
            )
            return Z, S, I1, Y

        def merit(Y, I):
            d = np.diff(I, prepend=0.0)
            inside = np.concatenate(
                [self.limits[0] - d, self.limits[0] + d, self.limits[1] - I, self.limits[1] + I]
            )
            if inside.min() <= 0:
                return np.inf
            return self.value(Y, I) - mu * float(np.sum(np.log(inside))) / N

        Z, S, I, Y = roll(I, np.zeros((N, nz)), 0.0)
        best = merit(Y, I)
        reg = 0.0
        for it in range(iterations):
            jacobian(pm.size, pm.tag, many, pm.ints, self.u, S, I, self.rows, self.sub, 1e-7, FZ, YZ)
            while True:
                drop, ok = _backward(FZ, YZ, Y, I, self.q, self.qi, mu, self.limits, reg, ff, fb)
                if ok:
                    break
                reg = max(4 * reg, 1e-6)
            alpha, gained = 1.0, 0.0
            while alpha > 1e-3:
                Z1, S1, I1, Y1 = roll(I, Z, alpha)
                new = merit(Y1, I1)
                if new < best:
                    gained = best - new
                    Z, S, I, Y, best = Z1, S1, I1, Y1, new
                    break
                alpha *= 0.4
            if trace is not None:
                trace.append((softness, mu, it, best, self.value(Y, I), alpha, reg, drop / N))
            if gained == 0.0:
                if reg > 1e3:
                    break
                reg = max(10 * reg, 1e-4)
                continue
            reg = reg / 5 if alpha > 0.3 else reg * 2
            if reg < 1e-8:
                reg = 0.0
            if gained < tolerance * best:
                break
        return I
