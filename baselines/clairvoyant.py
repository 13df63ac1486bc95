"""The clairvoyant optimum: the least cost of an episode whose whole road is known in advance.

It minimises the stage cost over the currents of one episode (4000 in 20 s), through the real kernel with its projected
friction, end stop and every other law, under |I| <= 5 A and |dI| <= 0.5 A per control step.

**What is reached** (`Clairvoyant.value`). Differential dynamic programming (Gauss-Newton) over the control steps, state
(x, memory of the laws, current), input dI. The limits are primal-dual log barriers, lowered to nothing; the Jacobians are
differences through the kernel itself, so any network will do. Friction makes the problem non-smooth and non-convex: the
projection ``f = clip(-v / g, F)`` is first softened (g larger: a steep damper below a small velocity) and hardened step
by step until it is the real one. The currents found are rolled out as they are: the value is reached, and so an upper
bound of the optimum. Other schedules and starts end within some 0.5 % of it.

**What is proven** (`Clairvoyant.lower`). Let the friction be any force within its level, as if it were a second
actuator, and take the end stops away: the real friction is one of the choices, and the problem becomes convex. Its
Lagrange dual, evaluated exactly by one Riccati sweep, is a lower bound for the car without end stops. (With them it is
not proven, for a stop may push the right way. What is reached with and without them differs by 0.6 % at most, seeds 0-3.)
Without friction and stops the two methods meet within 0.05 %, which checks both.
"""

from __future__ import annotations

import functools
import hashlib
import json
import math
import os
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
from isd_gym.files import write_text
from isd_gym.kernel import _stamp, kernel
from isd_gym.network import Network
from isd_gym.road import Road
from isd_gym.road import road as find_road
from isd_gym.simulate import PHYSICS_STEP, Plant, discretise

CONTROL_STEP = 5e-3  # s
PIECE = 40  # control steps that share a step length
CAUTION = 0.5  # how much more than its curvature a deviation at the end of a piece is taken to cost
ALPHAS = (1.0, 0.4, 0.1, 0.0)  # step lengths tried
advance_one: Any = None  # the kernel's functions for one car and for many, bound when first needed: see _bind
measure_one: Any = None
advance: Any = None
measure: Any = None
SLACK = 1e-9  # the currents stay this far inside the limits [A]


def _forward(
    mats,
    ints,
    u,
    start,
    current,
    nominal,
    ff,
    fb,
    values,
    slopes,
    alphas,
    piece,
    caution,
    rows,
    sub,
    q,
    qi,
    mu,
    limits,
    Z,
    S,
    I,
    Y,
    chosen,
):
    """Roll out ``dI = nominal + alpha ff - fb (z - z_nominal)``, kept inside the barriers; fills Z, S, I, Y.

    Of several `alphas` every `piece` steps take their own: that of the least cost of the piece plus the value function
    (`values`, `slopes`) at its end, with `caution` times its curvature more. Friction bends the model here and
    there, and one alpha for all would be that of the worst place.
    """
    steps, nz = current.shape[0], rows.shape[0]
    slew, most = limits[0], limits[1]
    state, begin = start.copy(), start.copy()
    c = np.zeros((sub, max(1, ints[2]), 1))
    y = np.empty((ints[6], 1))
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
                inside = (
                    step
                    if low < step < high
                    else min(max(step, 0.99 * low + 0.01 * high), 0.01 * low + 0.99 * high)
                )
                d = min(max(d, inside + 0.995 * (low - inside)), inside + 0.995 * (high - inside))
                last = last + d
                I[k] = last
                for i in range(sub):
                    c[i, 0, 0] = last
                advance_one(mats, ints, state, u[k * sub : (k + 1) * sub + 1], c, 1)
                measure_one(mats, ints, state, u[(k + 1) * sub], c[sub - 1], 1, y)
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


def _jacobian(mats, ints, u, S, I, rows, sub, delta, FZ, YZ):
    """Differences of the next state and the outputs with respect to (z, I), every control step."""
    steps, nz = I.shape[0], rows.shape[0]
    lanes = nz + 2
    state = np.empty((S.shape[1], lanes))
    c = np.zeros((sub, max(1, ints[2]), lanes))
    y = np.empty((ints[6], lanes))
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
        advance(mats, ints, state, w, c, lanes)
        measure(mats, ints, state, w[sub], c[sub - 1], lanes, y)
        for l in range(nz + 1):
            for i in range(nz):
                FZ[k, i, l] = (state[rows[i], l] - state[rows[i], nz + 1]) / delta
            for i in range(3):
                YZ[k, i, l] = (y[i, l] - y[i, nz + 1]) / delta


@nb.njit(error_model="numpy", cache=True)
def _backward(FZ, YZ, Y, I, q, qi, mu, duals, limits, reg, piece, ff, fb, values, slopes):
    """One Riccati sweep about a trajectory: fills the plan (ff, fb) and its value function; False: not convex."""
    steps, nz = I.shape[0], FZ.shape[1]
    n = nz + 1
    slew, most = limits[0], limits[1]
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
            return False
        ff[k] = -g / r1
        for i in range(n):
            fb[k, i] = s[i] / r1
        for i in range(n):
            v[i] = p[i] + s[i] * ff[k] - fb[k, i] * (g + r0 * ff[k])
            for j in range(i + 1):
                t = Q[i, j] - fb[k, i] * s[j] - s[i] * fb[k, j] + fb[k, i] * r0 * fb[k, j]
                V[i, j] = t
                V[j, i] = t
        values[k], slopes[k] = V, v
    return True


@nb.njit(error_model="numpy", cache=True)
def _relaxed(A, B, G, W, C, CI, CF, YW, q, qi, sub, hf, gf, hd, gd, hI, gI, f, dI, I):
    """Least cost of the linear car over free f (a physics step) and dI (a control step): (value, ok).

    ``x+ = A x + B I + G f + W``, outputs ``C x + CI I + CF f + YW`` at the end of control steps, and the terms
    1/2 h u^2 + g u on each of f, dI, I. Fills f, dI, I with the minimiser.
    """
    total, n = W.shape
    steps = total // sub
    m = n + 1
    V, v, const = np.zeros((m, m)), np.zeros(m), 0.0
    kf, Kf = np.zeros(total), np.zeros((total, m))
    kd, Kd = np.zeros(steps), np.zeros((steps, m))
    F, g, w = np.zeros((m, m)), np.zeros(m), np.zeros(m)
    F[:n, :n], F[:n, n], F[n, n], g[:n] = A, B, 1.0, G
    VF, Q = np.empty((m, m)), np.empty((m, m))
    p, c, Vw = np.empty(m), np.empty(m), np.empty(m)
    for k in range(steps - 1, -1, -1):
        for i in range(sub - 1, -1, -1):
            j = k * sub + i
            if i == sub - 1:
                # the outputs, on (x+, I); what f feeds through directly comes below
                for r in range(3):
                    if q[r] != 0.0:
                        t = 2.0 * q[r]
                        for a in range(n):
                            v[a] += t * YW[k, r] * C[r, a]
                            for b in range(n):
                                V[a, b] += t * C[r, a] * C[r, b]
                            V[a, n] += t * C[r, a] * CI[r]
                            V[n, a] += t * C[r, a] * CI[r]
                        V[n, n] += t * CI[r] * CI[r]
                        v[n] += t * YW[k, r] * CI[r]
                        const += q[r] * YW[k, r] ** 2
            for a in range(n):
                w[a] = W[j, a]
            for a in range(m):
                t = 0.0
                for b in range(m):
                    t += V[a, b] * w[b]
                Vw[a] = t
            t = 0.0
            for a in range(m):
                t += w[a] * (0.5 * Vw[a] + v[a])
            const += t
            for a in range(m):
                for b in range(m):
                    t = 0.0
                    for r in range(m):
                        t += V[a, r] * F[r, b]
                    VF[a, b] = t
            rf, gg = hf[j], gf[j]
            for a in range(m):
                t = 0.0
                for b in range(m):
                    t += V[a, b] * g[b]
                rf += g[a] * t
                gg += g[a] * (v[a] + Vw[a])
            for a in range(m):
                t = 0.0
                u = 0.0
                for r in range(m):
                    t += F[r, a] * (v[r] + Vw[r])
                    u += g[r] * VF[r, a]
                p[a] = t
                c[a] = u
                for b in range(m):
                    t = 0.0
                    for r in range(m):
                        t += F[r, a] * VF[r, b]
                    Q[a, b] = t
            if i == sub - 1:
                for r in range(3):
                    if q[r] != 0.0 and CF[r] != 0.0:
                        # 2 q CF f (C x+ + CI I + YW) + q CF^2 f^2, x+ = F z + g f + w
                        t = 2.0 * q[r] * CF[r]
                        e = YW[k, r]
                        for a in range(n):
                            e += C[r, a] * w[a]
                        gg += t * e
                        rf += t * CF[r]
                        for b in range(m):
                            u = CI[r] if b == n else 0.0
                            for a in range(n):
                                u += C[r, a] * F[a, b]
                            c[b] += t * u
                        u = 0.0
                        for a in range(n):
                            u += C[r, a] * g[a]
                        rf += 2.0 * t * u
            if not rf > 0.0:
                return 0.0, False
            kf[j] = -gg / rf
            const -= 0.5 * gg * gg / rf
            for a in range(m):
                Kf[j, a] = -c[a] / rf
                v[a] = p[a] + c[a] * kf[j]
            for a in range(m):
                for b in range(m):
                    V[a, b] = Q[a, b] + c[a] * Kf[j, b]
            for a in range(m):
                for b in range(a):
                    t = 0.5 * (V[a, b] + V[b, a])
                    V[a, b] = t
                    V[b, a] = t
        # I after the change: its own terms, then dI
        V[n, n] += 2.0 * qi + hI[k]
        v[n] += gI[k]
        r0 = V[n, n] + hd[k]
        gg = v[n] + gd[k]
        if not r0 > 0.0:
            return 0.0, False
        kd[k] = -gg / r0
        const -= 0.5 * gg * gg / r0
        for a in range(m):
            c[a] = V[n, a]
        for a in range(m):
            Kd[k, a] = -c[a] / r0
            v[a] += c[a] * kd[k]
        for a in range(m):
            for b in range(m):
                V[a, b] += c[a] * Kd[k, b]
    z, y = np.zeros(m), np.zeros(m)
    for k in range(steps):
        t = kd[k]
        for a in range(m):
            t += Kd[k, a] * z[a]
        dI[k] = t
        z[n] += t
        I[k] = z[n]
        for i in range(sub):
            j = k * sub + i
            t = kf[j]
            for a in range(m):
                t += Kf[j, a] * z[a]
            f[j] = t
            for a in range(m):
                u = g[a] * t + (W[j, a] if a < n else 0.0)
                for b in range(m):
                    u += F[a, b] * z[b]
                y[a] = u
            z[:] = y
    return const, True


_PLAIN = (_forward, _jacobian)


@functools.cache
def _bind(stamp: int) -> tuple[Callable, Callable]:
    one, many = kernel("one"), kernel("shared")
    scope = globals()
    scope["advance_one"], scope["measure_one"] = one.advance, one.measure
    scope["advance"], scope["measure"] = many.advance, many.measure
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
        slew_limit: float = SLEW_LIMIT,
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
        self.single = Plant(bare, PHYSICS_STEP, extra=extra)
        self.rows = np.array([*range(self.single.n), *self.single.memory], np.int64)
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
        self.limits = np.array([slew_limit - SLACK, CURRENT_LIMIT - SLACK])
        self.start = self.single.state()

    def value(self, Y: np.ndarray, I: np.ndarray) -> float:
        """Mean stage cost of outputs (steps, 3) and currents (steps,)."""
        return float(np.mean(Y**2 @ self.q + self.qi * I**2))

    def rollout(self, currents: np.ndarray) -> np.ndarray:
        """Outputs (steps, 3) of the real car for currents: acceleration [m/s^2], travel [m], tyre load [N]."""
        return self._roll(self.single.mats, np.asarray(currents, float), wide=True)[3]

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
            *(
                mats,
                p.ints,
                self.u,
                self.start,
                current,
                *plan,
                np.array(alphas),
                PIECE,
                CAUTION,
            ),
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
    ) -> np.ndarray:
        """DDP at one softness of the friction and one barrier `mu`, from `currents` strictly inside the limits."""
        jacobian = _compiled()[1]
        one, many = (plant.softened(softness) for plant in (self.single, self.many))
        p = self.many
        N, nz = self.steps, self.nz
        ff, fb = np.zeros(N), np.zeros((N, nz + 1))
        values, slopes = np.zeros((N, nz + 1, nz + 1)), np.zeros((N, nz + 1))
        FZ, YZ = np.zeros((N, nz, nz + 1)), np.zeros((N, 3, nz + 1))

        def slack(I: np.ndarray) -> np.ndarray:
            d = np.diff(I, prepend=0.0)
            return np.stack(
                [self.limits[0] - d, self.limits[0] + d, self.limits[1] - I, self.limits[1] + I], axis=1
            )

        def merit(Y: np.ndarray, I: np.ndarray) -> float:
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
        for _ in range(iterations):
            if not failed:
                jacobian(many, p.ints, self.u, S, I, self.rows, self.sub, 1e-7, FZ, YZ)
            while True:
                ok = _backward(
                    FZ, YZ, Y, I, self.q, self.qi, mu, duals, self.limits, reg, PIECE, ff, fb, values, slopes
                )
                if ok:
                    break
                reg = np.maximum(4 * reg, 1e-2)
            Z1, S1, I1, Y1, chosen = self._roll(one, I, (Z, ff, fb, values, slopes), ALPHAS, mu)
            new = merit(Y1, I1)
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

    def optimise(self, schedule: Schedule, initial: np.ndarray | None = None) -> np.ndarray:
        """Currents (steps,) after the descents of a schedule."""
        I = np.zeros(self.steps) if initial is None else self._inside(initial)
        for softness, mu in schedule.stages:
            I = self.descend(I, softness=softness, mu=mu, iterations=schedule.iterations)
        return I

    def _inside(self, currents: np.ndarray) -> np.ndarray:
        """Currents a little inside all limits."""
        out, last = np.empty(self.steps), 0.0
        slew, most = 0.98 * self.limits
        for k, target in enumerate(np.asarray(currents, float)):
            last = min(max(target, last - slew, -most), last + slew, most)
            out[k] = last
        return out

    def relaxation(self) -> float | None:
        """A proven lower bound of the cost of the car without end stops (see the module); None where a law besides one friction and stops is present."""
        asm = self.single.assemblies[0]
        dry = [j for j, e in enumerate(asm.laws) if e.bound is not None]
        if len(dry) > 1 or any(e.bound is None and not isinstance(e, el.BumpStop) for e in asm.laws):
            return None
        part = discretise(asm, PHYSICS_STEP, self.single.u_columns)
        Ad, U0, U1, B, _, G1 = part.blocks[:6]
        OX, OU, OC, OF = part.outputs
        j = dry[0] if dry else 0
        element: Any = asm.laws[j] if dry else None
        level = float(getattr(element, "static_level", 0.0) or 0.0) if dry else 0.0
        level = max(level, float(element.level)) if dry else 0.0
        G = G1[:, j] * level if len(asm.laws) else np.zeros(len(Ad))
        CF = OF[-3:, j] * level if len(asm.laws) else np.zeros(3)
        u, N = self.u[:, :, 0], self.steps
        T = N * self.sub
        fixed = (
            *(Ad, np.ascontiguousarray(B[:, 0]), G, u[:-1] @ U0.T + u[1:] @ U1.T),
            *(OX[-3:].copy(), OC[-3:, 0].copy(), CF, u[self.sub :: self.sub] @ OU[-3:].T),
            *(self.q, self.qi, self.sub),
        )
        # primal-dual interior point; the dual's multipliers belong to f^2 <= 1, dI^2 <= slew^2, I^2 <= most^2
        limits = (1.0, float(self.limits[0]) + SLACK, CURRENT_LIMIT)
        now = [np.zeros(T), np.zeros(N), np.zeros(N)]
        mu = 0.1

        def slack(x: np.ndarray, limit: float) -> np.ndarray:
            return np.stack([limit - x, limit + x])

        duals = [mu / slack(x, l) for x, l in zip(now, limits, strict=True)]
        best = -np.inf
        for _ in range(80):
            terms: list[np.ndarray] = []
            for x, l, d in zip(now, limits, duals, strict=True):
                s = slack(x, l)
                h = (d / s).sum(axis=0)
                terms += [h, mu / s[0] - mu / s[1] - h * x]
            new = [np.empty_like(x) for x in now]
            if not _relaxed(*fixed, *terms, *new)[1]:
                break
            primal, dual, moves = 1.0, 1.0, []
            for x, y, l, d in zip(now, new, limits, duals, strict=True):
                s, ds = slack(x, l), np.stack([x - y, y - x])
                dd = mu / s - d - d / s * ds
                primal = min(
                    primal, 0.995 * float(np.min(np.where(ds < 0, -s / np.minimum(ds, -1e-300), np.inf)))
                )
                dual = min(
                    dual, 0.995 * float(np.min(np.where(dd < 0, -d / np.minimum(dd, -1e-300), np.inf)))
                )
                moves.append(dd)
            now = [x + primal * (y - x) for x, y in zip(now, new, strict=True)]
            duals = [d + dual * m for d, m in zip(duals, moves, strict=True)]
            left = sum(float(np.sum(d * slack(x, l))) for x, l, d in zip(now, limits, duals, strict=True)) / N
            if left < 1e-2:
                squares = [d.sum(axis=0) / (2 * l) for d, l in zip(duals, limits, strict=True)]
                terms = [t for m in squares for t in (2 * m, np.zeros_like(m))]
                value, ok = _relaxed(*fixed, *terms, *[np.empty_like(x) for x in now])
                if ok:  # any multipliers give a bound: this one is exact
                    lost = sum(float(m.sum()) * l**2 for m, l in zip(squares, limits, strict=True))
                    best = max(best, (value - lost) / N)
                if left < 2e-4:
                    break
            step = min(primal, dual)
            mu *= 0.3 if step > 0.3 else 0.6 if step > 0.1 else 1.0
        return float(best) if np.isfinite(best) else None


@dataclass(frozen=True)
class Schedule:
    """Stages (softness of the friction [-], barrier [-]) and DDP sweeps in each."""

    stages: tuple[tuple[float, float], ...]
    iterations: int

    @classmethod
    def of(cls, factor: float, power: float, iterations: int) -> Schedule:
        top, softness, stages = 40.0, 40.0, []
        while softness > 0.3:
            stages.append((softness, max(1e-2 * (softness / top) ** power, 3e-5)))
            softness /= factor
        return cls((*stages, (0.0, 3e-5)), iterations)


#: tried in this order; each ends in another local optimum, some 0.3 % apart
SCHEDULES = (Schedule.of(2.0, 1.0, 15), Schedule.of(2.0, 1.5, 15), Schedule.of(1.4, 1.5, 8))


@dataclass(frozen=True)
class Clairvoyant:
    """The outcome: `currents` (steps,) [A], the cost they reach, a lower bound (proven without end stops), and the costs of all starts.

    `rms` (3,): body acceleration [m/s^2], suspension travel [m], dynamic tyre load [N] at the ends of control steps.
    """

    currents: np.ndarray
    value: float
    lower: float | None
    rms: np.ndarray
    starts: tuple[float, ...]

    @property
    def gap(self) -> float | None:
        """What is between reached and proven, relative to the reached."""
        return None if self.lower is None else 1.0 - self.lower / self.value


def clairvoyant(
    network: Network | str | Path = "quarter-car-isd",
    *,
    heights: np.ndarray | None = None,
    seed: int | None = None,
    road: str | Road = "paper",
    speed: float = 20.0,
    duration: float = 20.0,
    cost: StageCost | None = None,
    control_step: float = CONTROL_STEP,
    slew_limit: float = SLEW_LIMIT,
    starts: int = 1,
    initial: Sequence[np.ndarray] = (),
    bound: bool = True,
) -> Clairvoyant:
    """The best currents for one road, known in advance.

    The road is that of the environment with this `seed`, or `heights` [m] at 0, 1 ms, ... `starts`: how many of the
    schedules to try (1 to 3); `slew_limit` [A] per control step; `initial`: currents (steps,) of other controllers to start from as well. `bound`: compute the
    lower bound too. Raises `InputError` for a network without a motor or with a lag or delay in its drive.
    """
    network = Network.load(network)
    if (heights is None) == (seed is None):
        raise InputError("give either heights or a seed")
    if heights is None:
        from gymnasium.utils import seeding

        heights = find_road(road).heights(duration, speed=speed, rng=seeding.np_random(seed)[0])
    episode = Episode(
        network, heights, cost=cost or StageCost(), control_step=control_step, slew_limit=slew_limit
    )
    tries = [episode.optimise(schedule) for schedule in SCHEDULES[:starts]]
    # a given start keeps its own pattern of sticking: begin at a friction that is but a little soft
    tries += [episode.optimise(Schedule(((2.0, 1e-4), (0.5, 1e-4), (0.0, 3e-5)), 15), I) for I in initial]
    if not tries:
        raise InputError(
            "nothing to start from: starts must be at least 1 where no initial currents are given"
        )
    outputs = [episode.rollout(I) for I in tries]
    costs = [episode.value(Y, I) for Y, I in zip(outputs, tries, strict=True)]
    best = int(np.argmin(costs))
    rms = np.sqrt(np.mean(outputs[best] ** 2, axis=0))
    return Clairvoyant(tries[best], costs[best], episode.relaxation() if bound else None, rms, tuple(costs))


# ------------------------------------------------------------------------------------- values that are known


def _key(network: Network, road: Road, speed: float, duration: float, cost: StageCost) -> str:
    """What the value of a seed depends on."""
    model = network.to_dict()
    car = {k: model[k] for k in ("masses", "elements", "inputs")}
    ground: list[Any] = [road.roughness, road.cutoff, road.over_time, road.shift]
    ground += [None if x is None else np.asarray(x).tolist() for x in (road.abscissa, road.profile)]
    text = json.dumps([car, ground, speed, duration, cost.quadratic], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def _shipped() -> Path:
    return Path(__file__).with_name("clairvoyant.json")


def _cached() -> Path:
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "isd_gym" / "clairvoyant.json"


def _read(path: Path) -> dict[str, Any]:
    try:
        return json.loads(path.read_text())
    except (OSError, ValueError):
        return {}


def _known(key: str) -> dict[int, dict[str, Any]]:
    """Seed -> figures of all episodes that have been computed: shipped, or in the user's cache."""
    out: dict[int, dict[str, Any]] = {}
    for path in (_cached(), _shipped()):
        out |= {int(seed): found for seed, found in _read(path).get(key, {}).get("seeds", {}).items()}
    return out


def reference(
    network: Network | str | Path = "quarter-car-isd",
    road: str | Road = "paper",
    speed: float = 20.0,
    episodes: int = 32,
    seed: int = 0,
    duration: float = 20.0,
    cost: StageCost | None = None,
    *,
    compute: bool = False,
    starts: int = 2,
    store: Path | None = None,
    progress: Callable[[float], None] | None = None,
) -> dict[str, np.ndarray] | None:
    """What is known of the episodes with seeds `seed`, `seed + 1`, ...; None where one of them is not known.

    Arrays (episodes,): `value` (the least cost known), `lower` (proven, NaN where there is none), and RMS of
    `acceleration` [m/s^2], `travel` [m], `tyre_load` [N] at that cost. With `compute`, what is missing is computed (some
    10 s an episode and start) and kept in the user's cache, or in the file `store`.
    """
    network, ground, cost = Network.load(network), find_road(road), cost or StageCost()
    key = _key(network, ground, speed, duration, cost)
    known = _known(key)
    wanted = range(seed, seed + episodes)
    if not compute and any(s not in known for s in wanted):
        return None
    for i, s in enumerate(wanted):
        if s not in known:
            found = clairvoyant(
                network, seed=s, road=ground, speed=speed, duration=duration, cost=cost, starts=starts
            )
            figures = (found.value, found.lower, *found.rms)
            known[s] = {
                n: None if x is None else float(f"{x:.6g}") for n, x in zip(FIGURES, figures, strict=True)
            }
            about = {"network": network.name, "road": ground.name, "speed": speed, "duration": duration}
            _keep(store or _cached(), key, about, s, known[s])
        if progress is not None:
            progress((i + 1) / episodes)
    return {n: np.array([math.nan if known[s][n] is None else known[s][n] for s in wanted]) for n in FIGURES}


FIGURES = ("value", "lower", "acceleration", "travel", "tyre_load")


def reachable(
    network: Network | str | Path,
    road: str | Road = "paper",
    speed: float = 20.0,
    episodes: int = 32,
    seed: int = 0,
    duration: float = 20.0,
    cost: StageCost | None = None,
    *,
    signals: dict[str, np.ndarray] | None = None,
) -> np.ndarray | None:
    """Least known cost of each episode (episodes,) for the score; None where one is not known (see `reference`).

    `signals`, where given, gets the RMS of body_acceleration, suspension_travel and tyre_load at that cost (episodes,).
    """
    found = reference(network, road, speed, episodes, seed, duration, cost)
    if found is None:
        return None
    if signals is not None:
        names = {"acceleration": "body_acceleration", "travel": "suspension_travel", "tyre_load": "tyre_load"}
        signals |= {name: found[own] for own, name in names.items()}
    return found["value"]


def _keep(path: Path, key: str, about: dict[str, Any], seed: int, figures: dict[str, Any]) -> None:
    data = _read(path)
    data.setdefault(key, {**about, "seeds": {}})["seeds"][str(seed)] = figures
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_text(path, json.dumps(data, indent=1) + "\n")
    except (OSError, InputError):
        pass  # a cache that cannot be written costs time, nothing else


def main() -> None:
    """``python -m baselines.clairvoyant``: compute what the shipped file lacks (delete it to begin anew)."""

    def say(share: float) -> None:
        print(f"{100 * share:.0f} %", flush=True)

    reference(compute=True, store=_shipped(), progress=say)


if __name__ == "__main__":
    main()
