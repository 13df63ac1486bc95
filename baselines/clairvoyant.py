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
PIECE = 40  # control steps that share a step length
CAUTION = 0.5
ALPHAS = (1.0, 0.4, 0.1, 0.0)
SLACK = 1e-9  # the currents stay this far inside the limits [A]


def _forward(
    size, tag, mats, ints, u, start, current, nominal, ff, fb, values, slopes, alphas, piece, caution, rows, sub, q, qi, mu, limits, Z, S, I, Y, chosen
):
    """Roll out ``dI = nominal + alpha ff - fb (z - z_nominal)``, kept inside the barriers; fills Z, S, I, Y.

    Of several `alphas` every `piece` steps take their own: that of the least cost of the piece plus the value function
    (`values`, `slopes`) at its end, with `caution` times its curvature more. Friction bends the model here and
    there, and one alpha for all would be that of the worst place.
    """
    steps, nz = current.shape[0], rows.shape[0]
    slew, most = limits[0], limits[1]
    state, begin = start.copy(), start.copy()
    c = np.zeros((sub, max(1, ints[1]), 1))
    y = np.empty((ints[4], 1))
    dz = np.empty(nz + 1)
    last_begin = 0.0
    many = alphas.shape[0]
    first = 0
    while first < steps:
        stop = min(first + piece, steps) if many > 1 else steps
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
                last_nominal = current[k - 1] if k > 0 else 0.0
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
                inside = step if low < step < high else min(max(step, 0.99 * low + 0.01 * high), 0.01 * low + 0.99 * high)
                d = min(max(d, inside + 0.995 * (low - inside)), inside + 0.995 * (high - inside))
                last = last + d
                I[k] = last
                for i in range(sub):
                    c[i, 0, 0] = last
                advance(size, tag, mats, ints, state, u[k * sub : (k + 1) * sub + 1], c, 1)  # noqa: F821
                measure(size, tag, mats, ints, state, u[(k + 1) * sub], c[sub - 1], 1, y)  # noqa: F821
                total += qi * last * last
                for m in range(3):
                    Y[k, m] = y[m, 0]
                    total += q[m] * y[m, 0] * y[m, 0]
                if mu > 0.0:
                    total -= mu * math.log((slew - d) * (slew + d) * (most - last) * (most + last))
            if stop < steps:
                for i in range(nz):
                    dz[i] = state[rows[i], 0] - nominal[stop, i]
                dz[nz] = last - current[stop - 1]
                for i in range(nz + 1):
                    t = slopes[stop, i]
                    for j in range(nz + 1):
                        t += 0.5 * (1.0 + caution) * values[stop, i, j] * dz[j]
                    total += t * dz[i]
            if total < best:
                best, best_at = total, trial
        if many > 1:
            chosen[first // piece] = alphas[best_at]
        last_begin = last
        first = stop


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
def _backward(FZ, YZ, Y, I, q, qi, mu, duals, limits, reg, piece, ff, fb, values, slopes):
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
        h2 = 2.0 * qi + duals[k, 2] / (most - now) + duals[k, 3] / (most + now)
        p[nz] += h1
        g += h1
        Q[nz, nz] += h2
        s[nz] += h2
        r0 += h2
        g += mu * (1.0 / (slew - d) - 1.0 / (slew + d))
        r0 += duals[k, 0] / (slew - d) + duals[k, 1] / (slew + d)
        r1 = r0 + reg[k // piece]
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
        values[k], slopes[k] = V, v
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
        Z, S, _, Y, _ = self._roll(self.single.mats, np.asarray(currents, float), wide=True)
        return Y, Z, S

    def _roll(
        self,
        mats: np.ndarray,
        current: np.ndarray,
        plan: tuple[np.ndarray, ...] | None = None,
        alphas: Sequence[float] = (0.0,),
        mu: float = 0.0,
        wide: bool = False,
    ) -> tuple[np.ndarray, ...]:
        N, n = self.steps, self.nz + 1
        if plan is None:
            nothing = np.zeros((N, n, n))
            plan = (np.zeros((N, n - 1)), np.zeros(N), nothing[:, 0], nothing, nothing[:, 0])
        Z, S, I, Y = np.zeros((N, n - 1)), np.zeros((N, len(self.start))), np.zeros(N), np.zeros((N, 3))
        chosen = np.zeros(-(-N // PIECE))
        p = self.single
        limits = np.array([1e9, 1e9]) if wide else self.limits
        _compiled()[0](
            *(p.size, p.tag, mats, p.ints, self.u, self.start, current, *plan, np.array(alphas), PIECE, CAUTION),
            *(self.rows, self.sub, self.q, self.qi, mu, limits, Z, S, I, Y, chosen),
        )
        return Z, S, I, Y, chosen

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
        jacobian = _compiled()[1]
        one, many = self.softened(softness)
        p = self.many
        N, nz = self.steps, self.nz
        ff, fb = np.zeros(N), np.zeros((N, nz + 1))
        values, slopes = np.zeros((N, nz + 1, nz + 1)), np.zeros((N, nz + 1))
        FZ, YZ = np.zeros((N, nz, nz + 1)), np.zeros((N, 3, nz + 1))

        def slack(I):
            d = np.diff(I, prepend=0.0)
            return np.stack(
                [self.limits[0] - d, self.limits[0] + d, self.limits[1] - I, self.limits[1] + I], axis=1
            )

        def merit(Y, I):
            inside = slack(I)
            if inside.min() <= 0:
                return np.inf
            return self.value(Y, I) - mu * float(np.sum(np.log(inside))) / N

        Z, S, I, Y, _ = self._roll(one, np.asarray(currents, float).copy())
        best = merit(Y, I)
        reg = np.zeros(-(-N // PIECE))
        inside = slack(I)
        duals = mu / inside
        failed = 0
        for it in range(iterations):
            if not failed:
                jacobian(p.size, p.tag, many, p.ints, self.u, S, I, self.rows, self.sub, 1e-7, FZ, YZ)
            while True:
                drop, ok = _backward(
                    FZ, YZ, Y, I, self.q, self.qi, mu, duals, self.limits, reg, PIECE, ff, fb, values, slopes
                )
                if ok:
                    break
                reg = np.maximum(4 * reg, 1e-2)
            Z1, S1, I1, Y1, chosen = self._roll(one, I, (Z, ff, fb, values, slopes), ALPHAS, mu)
            new = merit(Y1, I1)
            if trace is not None:
                trace.append((softness, mu, it, new, self.value(Y1, I1), chosen.mean(), np.median(reg), drop / N))
            if new < best:
                gained, failed = best - new, 0
                Z, S, I, Y, best = Z1, S1, I1, Y1, new
                s0, inside = inside, slack(I)
                duals = np.maximum(mu / s0 - duals / s0 * (inside - s0), 0.005 * duals)
                duals = np.clip(duals, 0.01 * mu / inside, 100 * mu / inside)
                reg = np.where(chosen >= 1.0, reg / 4, np.where(chosen < 0.3, np.maximum(4 * reg, 0.03), reg))
                reg[reg < 1e-3] = 0.0
                if gained < tolerance * best:
                    break
            else:
                failed += 1
                reg = np.maximum(5 * reg, 0.03)
                if failed > 6:
                    break
        return I
