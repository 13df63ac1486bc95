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

import numpy as np

from isd_gym._common.errors import InputError
from isd_gym.physics import elements as el
from isd_gym.physics._kernel import jit
from isd_gym.physics._prediction import (
    ROAD_INTENSITY,
    Model,
    Sensors,
    Weights,
    device_reach,
    equivalent_damping,
    move_regulator,
    prediction_model,
)
from isd_gym.physics._vehicle import CURRENT_LIMIT

from ._estimator import Estimator
from .controller import CURRENT, DesignedController, rises, steps_ahead

__all__ = [
    "FrictionMpcSettings",
]


@jit.compiled(error_model="numpy")
def _forces(free, dry, level, slope, clear, coupling, spread, f, d):
    """Compute the forces f (nl,) of the laws at the end of a step, and their derivatives d (nl,) by their own rate or elongation.

    `free` are the rates (friction) or elongations (stops) without the forces.
    """
    nl = len(f)
    for _ in range(1 if nl < 2 else 2):
        for j in range(nl):
            rest = free[j]
            for i in range(nl):
                if i != j:
                    rest += coupling[j, i] * f[i]
            g = coupling[j, j]
            if dry[j]:
                # v = rest + g f erf(v / (sqrt 2 sigma)) has one root, since g < 0; bracketed Newton iteration
                s = math.sqrt(2.0) * spread[j]
                low, high = rest + g * level[j], rest - g * level[j]
                v = rest / (1.0 - g * level[j] * 2.0 / math.sqrt(math.pi) / s)
                for _ in range(8):
                    e = math.erf(v / s)
                    h = v - rest - g * level[j] * e
                    d[j] = level[j] * 2.0 / math.sqrt(math.pi) / s * math.exp(-((v / s) ** 2))
                    if h > 0.0:
                        high = v
                    else:
                        low = v
                    new = v - h / (1.0 - g * d[j])
                    if not (low <= new <= high):
                        new = 0.5 * (low + high)
                    if abs(new - v) < 1e-9:
                        break
                    v = new
                f[j] = level[j] * math.erf(v / s)
            else:
                over = abs(rest) - clear[j]
                if over > 0.0:
                    f[j] = math.copysign(slope[j] * over / (1.0 - slope[j] * g), rest)
                    d[j] = slope[j]
                else:
                    f[j] = d[j] = 0.0


@jit.compiled(error_model="numpy")
def _roll(x0, i0, moves, gains, nominal, gain_k, alpha, road, m, xs, cs, fs, ds, ys):
    """Roll the plan forward, with the feedback of the sweep for alpha > 0; return its cost (half the stage costs)."""
    A, B, G, P, C, D, F, Sc, SI, coupling, dry, level, slope, clear, spread, q, qc, qm, V, slew = m
    n, N, nl = len(A), len(moves), len(dry)
    free = np.empty(nl)
    cost = 0.0
    xs[0], cs[0] = x0, i0
    for k in range(N):
        w = moves[k]
        if alpha > 0.0:
            w += alpha * gain_k[k] + gains[k, n] * (cs[k] - nominal[k, n])
            for i in range(n):
                w += gains[k, i] * (xs[k, i] - nominal[k, i])
            w = min(max(w, -slew, -CURRENT_LIMIT - cs[k]), slew, CURRENT_LIMIT - cs[k])
            moves[k] = w
        c = cs[k] + w
        cs[k + 1] = c
        for i in range(n):
            t = B[i] * c + P[i] * road[k]
            for j in range(n):
                t += A[i, j] * xs[k, j]
            xs[k + 1, i] = t
        for j in range(nl):
            t = SI[j] * c
            for i in range(n):
                t += Sc[j, i] * xs[k + 1, i]
            free[j] = t
            fs[k, j] = 0.0
        _forces(free, dry, level, slope, clear, coupling, spread[k], fs[k], ds[k])
        for i in range(n):
            for j in range(nl):
                xs[k + 1, i] += G[i, j] * fs[k, j]
        cost += 0.5 * (qm * w * w + qc * c * c)
        for r in range(len(q)):
            t = D[r] * c
            for i in range(n):
                t += C[r, i] * xs[k + 1, i]
            for j in range(nl):
                t += F[r, j] * fs[k, j]
            ys[k, r] = t
            cost += 0.5 * q[r] * t * t
    for i in range(n):
        for j in range(n):
            cost += 0.5 * V[i, j] * xs[N, i] * xs[N, j]
        cost += V[i, n] * xs[N, i] * cs[N]
    return cost + 0.5 * V[n, n] * cs[N] ** 2


@jit.compiled(error_model="numpy")
def _sweep(moves, m, xs, cs, ds, ys, gains, gain_k):
    """Run the backward sweep: gains (N, n+1) and open-loop changes gain_k (N,) of the moves, within their box."""
    A, B, G, P, C, D, F, Sc, SI, coupling, dry, level, slope, clear, spread, q, qc, qm, Vend, slew = m
    n, N, nl, ny = len(A), len(moves), len(dry), len(q)
    V = Vend.copy()
    p = np.empty(n + 1)
    for i in range(n + 1):
        t = V[i, n] * cs[N]
        for j in range(n):
            t += V[i, j] * xs[N, j]
        p[i] = t
    Z = np.empty((n, n + 1))  # derivative of the next state by (state, current)
    J = np.empty((nl, n + 1))  # derivative of the forces
    Y = np.empty((ny, n + 1))  # derivative of the signals
    L = np.empty((nl, nl))
    T = np.empty((n + 1, n + 1))
    H = np.empty((n + 1, n + 1))
    g = np.empty(n + 1)
    for k in range(N - 1, -1, -1):
        for i in range(n):
            for j in range(n):
                Z[i, j] = A[i, j]
            Z[i, n] = B[i]
        active = False
        for j in range(nl):
            active = active or ds[k, j] != 0.0
        for j in range(nl):
            for i in range(n + 1):
                J[j, i] = 0.0
        if active:
            for j in range(nl):
                if ds[k, j] != 0.0:
                    for i in range(n + 1):
                        t = SI[j] if i == n else 0.0
                        for r in range(n):
                            t += Sc[j, r] * Z[r, i]
                        J[j, i] = ds[k, j] * t
                for i in range(nl):
                    L[j, i] = (1.0 if i == j else 0.0) - ds[k, j] * coupling[j, i]
            for j in range(nl):  # Gauss elimination; L is a perturbed identity with a growing diagonal
                for i in range(j + 1, nl):
                    if L[i, j] != 0.0:
                        t = L[i, j] / L[j, j]
                        for r in range(j, nl):
                            L[i, r] -= t * L[j, r]
                        for r in range(n + 1):
                            J[i, r] -= t * J[j, r]
            for j in range(nl - 1, -1, -1):
                for r in range(n + 1):
                    t = J[j, r]
                    for i in range(j + 1, nl):
                        t -= L[j, i] * J[i, r]
                    J[j, r] = t / L[j, j]
            for j in range(nl):
                if ds[k, j] != 0.0:
                    for i in range(n):
                        for r in range(n + 1):
                            Z[i, r] += G[i, j] * J[j, r]
        for r in range(ny):
            for i in range(n + 1):
                t = D[r] if i == n else 0.0
                for j in range(n):
                    t += C[r, j] * Z[j, i]
                for j in range(nl):
                    t += F[r, j] * J[j, i]
                Y[r, i] = t
        for i in range(n + 1):
            for r in range(n + 1):
                t = V[i, n] if r == n else 0.0
                for j in range(n):
                    t += V[i, j] * Z[j, r]
                T[i, r] = t
        for i in range(n + 1):
            t = p[n] if i == n else 0.0
            for j in range(n):
                t += Z[j, i] * p[j]
            for r in range(ny):
                t += Y[r, i] * q[r] * ys[k, r]
            g[i] = t
            for r in range(i, n + 1):
                t = T[n, r] if i == n else 0.0
                for j in range(n):
                    t += Z[j, i] * T[j, r]
                for j in range(ny):
                    t += Y[j, i] * q[j] * Y[j, r]
                H[i, r] = t
                H[r, i] = t
        H[n, n] += qc
        g[n] += qc * cs[k + 1]
        qww = H[n, n] + qm
        qw = g[n] + qm * moves[k]
        best = -qw / qww
        low = max(-slew, -CURRENT_LIMIT - cs[k]) - moves[k]
        high = min(slew, CURRENT_LIMIT - cs[k]) - moves[k]
        step = min(max(best, low), high)
        gain_k[k] = step
        if low < best < high:
            for i in range(n + 1):
                gains[k, i] = -H[n, i] / qww
            for i in range(n + 1):
                p[i] = g[i] - H[n, i] * qw / qww
                for r in range(n + 1):
                    V[i, r] = H[i, r] - H[n, i] * H[n, r] / qww
        else:
            for i in range(n + 1):
                gains[k, i] = 0.0
            for i in range(n + 1):
                p[i] = g[i] + H[n, i] * step
                for r in range(n + 1):
                    V[i, r] = H[i, r]


@jit.compiled(error_model="numpy")
def _plan(x, current, moves, road, m, iterations):
    """Improve the plans of all cars in place, and return the number of discarded plans (not finite).

    x (n, cars), current (cars,), moves (cars, N), road (cars, N) [m] per step.
    """
    n, cars, N, nl, ny = len(m[0]), x.shape[1], moves.shape[1], len(m[10]), len(m[15])
    xs, cs, fs, ds, ys = (
        np.zeros((N + 1, n)),
        np.zeros(N + 1),
        np.zeros((N, nl)),
        np.zeros((N, nl)),
        np.zeros((N, ny)),
    )
    xt, ct, ft, dt, yt = (
        np.zeros_like(xs),
        np.zeros_like(cs),
        np.zeros_like(fs),
        np.zeros_like(ds),
        np.zeros_like(ys),
    )
    gains, gain_k, nominal, trial = np.zeros((N, n + 1)), np.zeros(N), np.zeros((N, n + 1)), np.empty(N)
    broken, slew = 0, m[-1]
    for e in range(cars):
        x0 = np.ascontiguousarray(x[:, e])
        w = moves[e]
        c = current[e]
        for k in range(N):  # the warm start must be feasible from the present current
            w[k] = min(max(w[k], -slew, -CURRENT_LIMIT - c), slew, CURRENT_LIMIT - c)
            c += w[k]
        cost = _roll(x0, current[e], w, gains, nominal, gain_k, 0.0, road[e], m, xs, cs, fs, ds, ys)
        for _ in range(iterations):
            _sweep(w, m, xs, cs, ds, ys, gains, gain_k)
            for k in range(N):
                for i in range(n):
                    nominal[k, i] = xs[k, i]
                nominal[k, n] = cs[k]
            alpha, better = 1.0, False
            for _ in range(5):
                trial[:] = w
                new = _roll(
                    x0, current[e], trial, gains, nominal, gain_k, alpha, road[e], m, xt, ct, ft, dt, yt
                )
                if new < cost:
                    better = True
                    break
                alpha *= 0.4
            if not better:
                break
            gained = cost - new
            cost = new
            w[:] = trial
            xs, xt = xt, xs
            cs, ct = ct, cs
            fs, ft = ft, fs
            ds, dt = dt, ds
            ys, yt = yt, ys
            if gained < 1e-4 * cost:
                break
        if not math.isfinite(cost):
            w[:] = 0.0
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
    terminal_rate: float = 0.2  # rate of the linearisation of friction in the cost-to-go [m/s]
    friction_noise: float = 300.0  # standard deviation of the estimator's friction per step [N]
    preview: float = 0.0  # known road ahead [s]; only the road beyond contributes to the spread
    #: standard deviations of the measurements in the estimator
    sensors: Sensors = field(default_factory=Sensors)
    road_intensity: float = ROAD_INTENSITY  # two-sided intensity of the road's velocity [m^2/s]

    def __post_init__(self) -> None:
        if self.horizon < 1 or self.iterations < 1:
            raise InputError("horizon and iterations must be at least 1")


def with_preview(settings: FrictionMpcSettings, preview: float, control_step: float) -> FrictionMpcSettings:
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
        self.prediction = m = prediction_model(model, self.step, road_intensity=s.road_intensity)
        self.weights = w = Weights(self.cost, s.move, s.effort, s.centring, device_reach(model))
        self.estimator = Estimator(m, s.sensors, s.friction_noise)
        stops = {e.name: 0.0 for e in m.laws if e.bound is None}
        levels = m.levels()
        damping = {m.laws[j].name: equivalent_damping(levels[j], s.terminal_rate) for j in m.friction}
        linear = prediction_model(model, self.step, damping=damping | stops, road_intensity=s.road_intensity)
        self._idle = m.thrust == 0.0
        if not self._idle:
            design = replace(w, move=max(w.move, 1e-3), centring=max(w.centring, 1e-3))
            _, V = move_regulator(linear, design)
            self._problem = self._pack(m, linear.A, V)

    def _pack(self, m: Model, A_linear: np.ndarray, V: np.ndarray) -> tuple:
        s, nl = self.settings, len(m.laws)
        dry = np.array([e.bound is not None for e in m.laws], bool)
        # friction depends on its rate, a stop on its elongation
        S = np.where(dry[:, None], m.S, m.E) if nl else np.zeros((0, m.n))
        coupling = S @ m.G + np.where(dry[:, None], m.SF, 0.0) if nl else np.zeros((0, 0))
        slope = np.array([e.stiffness if isinstance(e, el.BumpStop) else 0.0 for e in m.laws])
        clear = np.array([e.clearance if isinstance(e, el.BumpStop) else np.inf for e in m.laws])
        spread = np.empty((s.horizon, nl))
        W = np.zeros((m.n, m.n))
        for k in range(s.horizon):
            if k >= self._points:
                W = A_linear @ W @ A_linear.T + m.W
            spread[k] = np.hypot(s.spread * np.sqrt(np.einsum("ji,ik,jk->j", S, W, S)), s.floor)
        q = self.weights.signals
        rows = np.flatnonzero(q)
        arrays = (
            *(m.A, m.B, m.G, m.P, m.C[rows], m.D[rows], m.F[rows], S, np.where(dry, m.SI, 0.0)),
            *(coupling, dry, m.levels(), slope, clear, spread, q[rows]),
        )
        return (
            *(np.ascontiguousarray(a) for a in arrays),
            float(self.weights.current),
            float(self.weights.move),
            np.ascontiguousarray(V),
            self.slew,
        )

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
        self.fallbacks += _plan(
            x, obs[CURRENT], self.moves, self._road, self._problem, self.settings.iterations
        )
        return obs[CURRENT] + self.moves[:, 0]
