"""Proven lower bound of an episode's cost: friction as a second actuator, in a convex program.

Let the friction be any force within its level, and remove the end stops. The real friction is one of the
choices, and the minimum over currents and friction is a convex quadratic program. A primal-dual
interior-point method solves the program with one Riccati sweep per iteration. Any multipliers of the limits
give a lower bound, evaluated exactly by one more sweep.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from isd_gym.physics._kernel import jit


class LinearCar(NamedTuple):
    """Linear car ``x+ = A x + B I + G f + W`` per physics step, with outputs ``C x + CI I + CF f + YW`` at the
    end of control steps.

    The cost of a control step is ``squares . y^2 + current I^2 + slope_x . x``, with x at its start.

    Attributes:
        A: State matrix (n, n).
        B: Response to the current (n,).
        G: Response to a friction at its level (n,).
        W: Effect of the road (physics steps, n).
        C: Output matrix (3, n).
        CI: Response of the outputs to the current (3,).
        CF: Response of the outputs to a friction at its level (3,).
        YW: Effect of the road on the outputs (control steps, 3).
        squares: Weights (3,) of the squared outputs.
        current: Weight of the squared current [1/A^2].
        slope_x: Linear weights (control steps, n) of the state.
        substeps: Physics steps per control step.
    """

    A: np.ndarray
    B: np.ndarray
    G: np.ndarray
    W: np.ndarray
    C: np.ndarray
    CI: np.ndarray
    CF: np.ndarray
    YW: np.ndarray
    squares: np.ndarray
    current: float
    slope_x: np.ndarray
    substeps: int


class Terms(NamedTuple):
    """Cost ``1/2 curvature u^2 + slope u`` of a kind of variable.

    Attributes:
        curvature: Curvatures, one per variable.
        slope: Slopes, one per variable.
    """

    curvature: np.ndarray
    slope: np.ndarray


class Choice(NamedTuple):
    """Variables of the program.

    Attributes:
        friction: Friction as a share of its level (physics steps,).
        change: Change of current (control steps,) [A].
        current: Current (control steps,) [A].
    """

    friction: np.ndarray
    change: np.ndarray
    current: np.ndarray


@jit.compiled(error_model="numpy")
def least(car, on_friction, on_change, on_current, choice):
    """Minimise the cost of the linear car over free friction and changes of current, and fill `choice`.

    Args:
        car: The linear car.
        on_friction: Cost of the friction.
        on_change: Cost of the change of current.
        on_current: Cost of the current.
        choice: Optimal variables, filled.

    Returns:
        Least cost, and False for a problem that is not convex.
    """
    A, B, G, W, C, CI, CF, YW, q, qi, slope_x, sub = car
    hf, gf = on_friction
    hd, gd = on_change
    hI, gI = on_current
    f, dI, I = choice
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
                # the outputs, on (x+, I); the direct feedthrough of f follows below
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
        for a in range(n):
            v[a] += slope_x[k, a]
        # terms of I after the change, then terms of dI
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


def bound(car: LinearCar, slew: float, most: float, on_current: np.ndarray) -> float | None:
    """Return a lower bound of the total cost under |friction| <= 1, |dI| <= `slew` and |I| <= `most`.

    Args:
        car: The linear car.
        slew: Limit of the change of current per control step [A].
        most: Limit of the current [A].
        on_current: Linear cost of the current (control steps,) [1/A].

    Returns:
        Lower bound; None if none was found.
    """
    total = len(car.W)
    steps = total // car.substeps
    limits = (1.0, slew, most)
    now = [np.zeros(total), np.zeros(steps), np.zeros(steps)]
    mu = 0.1

    def slack(x: np.ndarray, limit: float) -> np.ndarray:
        return np.stack([limit - x, limit + x])

    # multipliers of f^2 <= 1, dI^2 <= slew^2, I^2 <= most^2
    duals = [mu / slack(x, l) for x, l in zip(now, limits, strict=True)]
    best = -np.inf
    for _ in range(80):
        terms = []
        for x, l, d in zip(now, limits, duals, strict=True):
            s = slack(x, l)
            h = (d / s).sum(axis=0)
            terms.append(Terms(h, mu / s[0] - mu / s[1] - h * x))
        friction, change, current = terms
        current = current._replace(slope=current.slope + on_current)
        new = [np.empty_like(x) for x in now]
        if not least(car, friction, change, current, Choice(*new))[1]:
            break
        primal, dual, moves = 1.0, 1.0, []
        for x, y, l, d in zip(now, new, limits, duals, strict=True):
            s, ds = slack(x, l), np.stack([x - y, y - x])
            dd = mu / s - d - d / s * ds
            primal = min(
                primal, 0.995 * float(np.min(np.where(ds < 0, -s / np.minimum(ds, -1e-300), np.inf)))
            )
            dual = min(dual, 0.995 * float(np.min(np.where(dd < 0, -d / np.minimum(dd, -1e-300), np.inf))))
            moves.append(dd)
        now = [x + primal * (y - x) for x, y in zip(now, new, strict=True)]
        duals = [d + dual * m for d, m in zip(duals, moves, strict=True)]
        left = sum(float(np.sum(d * slack(x, l))) for x, l, d in zip(now, limits, duals, strict=True)) / steps
        if left < 1e-2:
            squares = [d.sum(axis=0) / (2 * l) for d, l in zip(duals, limits, strict=True)]
            terms = [Terms(2 * m, np.zeros_like(m)) for m in squares]
            friction, change, current = terms
            current = current._replace(slope=on_current)
            value, ok = least(car, friction, change, current, Choice(*(np.empty_like(x) for x in now)))
            if ok:  # any multipliers give a bound; the sweep is exact
                best = max(
                    best, value - sum(float(m.sum()) * l**2 for m, l in zip(squares, limits, strict=True))
                )
            if left < 2e-4:
                break
        step = min(primal, dual)
        mu *= 0.3 if step > 0.3 else 0.6 if step > 0.1 else 1.0
    return float(best) if np.isfinite(best) else None
