"""`mpc-friction` as plain C without dependencies (C99 and libm): estimator and differential dynamic programming of one car.

Offline results are written as numbers. A step allocates nothing, and its work is bounded: `iterations` sweeps
of the horizon with at most five trials each. The loops are those of `friction` in the same order, in double
precision, so that commands agree to rounding.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

import numpy as np

from isd_gym._common.errors import InputError
from isd_gym._common.files import make_folder, write_text
from isd_gym.baselines._model import N_SENSORS
from isd_gym.baselines.friction import FrictionMpc
from isd_gym.env._environment import MEASURED
from isd_gym.physics._vehicle import CURRENT_LIMIT, SLEW_LIMIT

if TYPE_CHECKING:
    from pathlib import Path

HEADER = """\
/* {title}: predictive control that knows of the seal's friction, for network {network}.
 *
 * One call of {id}_step every {step:g} s with what was measured at its end; it returns the commanded current [A], within
 * +-{limit:g} A and {slew:g} A of the present one. At most {sweeps} sweeps over {horizon} steps; nothing is allocated.
 *
 * observation, double, SI units, in this order:
{order}
 *
 * A reading that is not finite counts as 0, a current that is not as the last command. {id}_reset before the first step and
 * whenever a drive begins anew. {id}_state.fallbacks counts plans that came out broken and were given up.
 */
#ifndef {ID}_H
#define {ID}_H

#define {ID}_SIGNALS {signals}
#define {ID}_HORIZON {horizon}
#define {ID}_STEP {step:.9g}

typedef struct {{
    double x[{n}];              /* estimate */
    double moves[{horizon}];    /* planned changes of current [A] */
    double road[{horizon}];     /* rises of the road ahead [m], 0 where it is not known */
    double last;                /* command [A] */
    long fallbacks;
}} {id}_state;

void {id}_reset({id}_state *s);
double {id}_step({id}_state *s, const double observation[{ID}_SIGNALS]);

#endif
"""
SOURCE = """\
#include "@id@.h"
#include <math.h>
#include <string.h>

#define NX @n@
#define N @horizon@
#define NL @laws@
#define NL1 (NL > 0 ? NL : 1)
#define NY @signals@
#define POINTS @points@
#define SLEW @slew@
#define LIMIT @limit@

@constants@
static double clip(double v, double low, double high) { return v < low ? low : v > high ? high : v; }

/* a rollout: states, currents, forces of the laws, their slopes, signals */
typedef struct { double x[N + 1][NX], c[N + 1], f[N][NL1], d[N][NL1], y[N][NY]; } plan;

static void forces(const double *rate, const double *wide, double *f, double *d) {
    for (int pass = 0; pass < (NL < 2 ? 1 : 2); pass++)
        for (int j = 0; j < NL; j++) {
            double rest = rate[j];
            for (int i = 0; i < NL; i++) if (i != j) rest += coupling[j * NL + i] * f[i];
            const double g = coupling[j * NL + j];
            if (dry[j]) { /* v = rest + g f erf(v / (sqrt 2 sigma)): Newton, kept within its bracket */
                const double s = sqrt(2.0) * wide[j], steep = level[j] * 2.0 / sqrt(3.14159265358979323846);
                double low = rest + g * level[j], high = rest - g * level[j];
                double v = rest / (1.0 - g * steep / s);
                for (int k = 0; k < 8; k++) {
                    const double h = v - rest - g * level[j] * erf(v / s);
                    d[j] = steep / s * exp(-(v / s) * (v / s));
                    if (h > 0.0) high = v; else low = v;
                    double next = v - h / (1.0 - g * d[j]);
                    if (!(low <= next && next <= high)) next = 0.5 * (low + high);
                    if (fabs(next - v) < 1e-9) break;
                    v = next;
                }
                f[j] = level[j] * erf(v / s);
            } else {
                const double over = fabs(rest) - clearance[j];
                if (over > 0.0) {
                    f[j] = copysign(slope[j] * over / (1.0 - slope[j] * g), rest);
                    d[j] = slope[j];
                } else f[j] = d[j] = 0.0;
            }
        }
}

/* the plan forward; its cost. With alpha > 0 along the feedback of the sweep about `was` */
static double roll(const double *x0, double i0, double *moves, const double (*gains)[NX + 1], const plan *was,
                   const double *gain, double alpha, const double *road, plan *p) {
    double cost = 0.0, rate[NL1];
    memcpy(p->x[0], x0, sizeof p->x[0]);
    p->c[0] = i0;
    for (int k = 0; k < N; k++) {
        double w = moves[k];
        if (alpha > 0.0) {
            w += alpha * gain[k] + gains[k][NX] * (p->c[k] - was->c[k]);
            for (int i = 0; i < NX; i++) w += gains[k][i] * (p->x[k][i] - was->x[k][i]);
            const double least = fmax(-SLEW, -LIMIT - p->c[k]), most = fmin(SLEW, LIMIT - p->c[k]);
            w = fmin(fmax(w, least), most);
            moves[k] = w;
        }
        const double c = p->c[k] + w;
        p->c[k + 1] = c;
        for (int i = 0; i < NX; i++) {
            double t = B[i] * c + P[i] * road[k];
            for (int j = 0; j < NX; j++) t += A[i * NX + j] * p->x[k][j];
            p->x[k + 1][i] = t;
        }
        for (int j = 0; j < NL; j++) {
            double t = SI[j] * c;
            for (int i = 0; i < NX; i++) t += S[j * NX + i] * p->x[k + 1][i];
            rate[j] = t;
            p->f[k][j] = 0.0;
        }
        forces(rate, spread + k * NL, p->f[k], p->d[k]);
        for (int i = 0; i < NX; i++)
            for (int j = 0; j < NL; j++) p->x[k + 1][i] += G[i * NL + j] * p->f[k][j];
        cost += 0.5 * (Q_MOVE * w * w + Q_CURRENT * c * c);
        for (int r = 0; r < NY; r++) {
            double t = D[r] * c;
            for (int i = 0; i < NX; i++) t += C[r * NX + i] * p->x[k + 1][i];
            for (int j = 0; j < NL; j++) t += F[r * NL + j] * p->f[k][j];
            p->y[k][r] = t;
            cost += 0.5 * Q[r] * t * t;
        }
    }
    for (int i = 0; i < NX; i++) {
        for (int j = 0; j < NX; j++) cost += 0.5 * V[i * (NX + 1) + j] * p->x[N][i] * p->x[N][j];
        cost += V[i * (NX + 1) + NX] * p->x[N][i] * p->c[N];
    }
    return cost + 0.5 * V[NX * (NX + 1) + NX] * p->c[N] * p->c[N];
}

/* the sweep back: feedback gains and open-loop changes of the moves, within their box */
static void sweep(const double *moves, const plan *at, double (*gains)[NX + 1], double *gain) {
    double W[NX + 1][NX + 1], p[NX + 1], Z[NX][NX + 1], J[NL1][NX + 1], Y[NY][NX + 1], L[NL1][NL1];
    double T[NX + 1][NX + 1], H[NX + 1][NX + 1], g[NX + 1];
    for (int i = 0; i <= NX; i++)
        for (int j = 0; j <= NX; j++) W[i][j] = V[i * (NX + 1) + j];
    for (int i = 0; i <= NX; i++) {
        double t = W[i][NX] * at->c[N];
        for (int j = 0; j < NX; j++) t += W[i][j] * at->x[N][j];
        p[i] = t;
    }
    for (int k = N - 1; k >= 0; k--) {
        int active = 0;
        for (int i = 0; i < NX; i++) {
            for (int j = 0; j < NX; j++) Z[i][j] = A[i * NX + j];
            Z[i][NX] = B[i];
        }
        memset(J, 0, sizeof J);
        for (int j = 0; j < NL; j++) active |= at->d[k][j] != 0.0;
        if (active) {
            for (int j = 0; j < NL; j++) {
                if (at->d[k][j] != 0.0)
                    for (int i = 0; i <= NX; i++) {
                        double t = i == NX ? SI[j] : 0.0;
                        for (int r = 0; r < NX; r++) t += S[j * NX + r] * Z[r][i];
                        J[j][i] = at->d[k][j] * t;
                    }
                for (int i = 0; i < NL; i++) L[j][i] = (i == j ? 1.0 : 0.0) - at->d[k][j] * coupling[j * NL + i];
            }
            for (int j = 0; j < NL; j++)
                for (int i = j + 1; i < NL; i++)
                    if (L[i][j] != 0.0) {
                        const double t = L[i][j] / L[j][j];
                        for (int r = j; r < NL; r++) L[i][r] -= t * L[j][r];
                        for (int r = 0; r <= NX; r++) J[i][r] -= t * J[j][r];
                    }
            for (int j = NL - 1; j >= 0; j--)
                for (int r = 0; r <= NX; r++) {
                    double t = J[j][r];
                    for (int i = j + 1; i < NL; i++) t -= L[j][i] * J[i][r];
                    J[j][r] = t / L[j][j];
                }
            for (int j = 0; j < NL; j++)
                if (at->d[k][j] != 0.0)
                    for (int i = 0; i < NX; i++)
                        for (int r = 0; r <= NX; r++) Z[i][r] += G[i * NL + j] * J[j][r];
        }
        for (int r = 0; r < NY; r++)
            for (int i = 0; i <= NX; i++) {
                double t = i == NX ? D[r] : 0.0;
                for (int j = 0; j < NX; j++) t += C[r * NX + j] * Z[j][i];
                for (int j = 0; j < NL; j++) t += F[r * NL + j] * J[j][i];
                Y[r][i] = t;
            }
        for (int i = 0; i <= NX; i++)
            for (int r = 0; r <= NX; r++) {
                double t = r == NX ? W[i][NX] : 0.0;
                for (int j = 0; j < NX; j++) t += W[i][j] * Z[j][r];
                T[i][r] = t;
            }
        for (int i = 0; i <= NX; i++) {
            double t = i == NX ? p[NX] : 0.0;
            for (int j = 0; j < NX; j++) t += Z[j][i] * p[j];
            for (int r = 0; r < NY; r++) t += Y[r][i] * Q[r] * at->y[k][r];
            g[i] = t;
            for (int r = i; r <= NX; r++) {
                t = i == NX ? T[NX][r] : 0.0;
                for (int j = 0; j < NX; j++) t += Z[j][i] * T[j][r];
                for (int j = 0; j < NY; j++) t += Y[j][i] * Q[j] * Y[j][r];
                H[i][r] = H[r][i] = t;
            }
        }
        H[NX][NX] += Q_CURRENT;
        g[NX] += Q_CURRENT * at->c[k + 1];
        const double qww = H[NX][NX] + Q_MOVE, qw = g[NX] + Q_MOVE * moves[k], best = -qw / qww;
        const double low = fmax(-SLEW, -LIMIT - at->c[k]) - moves[k], high = fmin(SLEW, LIMIT - at->c[k]) - moves[k];
        const double step = fmin(fmax(best, low), high);
        const int within = low < best && best < high;
        gain[k] = step;
        for (int i = 0; i <= NX; i++) gains[k][i] = within ? -H[NX][i] / qww : 0.0;
        for (int i = 0; i <= NX; i++) {
            p[i] = within ? g[i] - H[NX][i] * qw / qww : g[i] + H[NX][i] * step;
            for (int r = 0; r <= NX; r++) W[i][r] = within ? H[i][r] - H[NX][i] * H[NX][r] / qww : H[i][r];
        }
    }
}

static int improve(const double *x, double current, double *moves, const double *road) {
    plan one, two, *now = &one, *other = &two;
    double gains[N][NX + 1], gain[N], trial[N], c = current;
    for (int k = 0; k < N; k++) { /* the warm start must be allowed from where the current is now */
        const double least = fmax(-SLEW, -LIMIT - c), most = fmin(SLEW, LIMIT - c);
        moves[k] = fmin(fmax(moves[k], least), most);
        c += moves[k];
    }
    memset(gains, 0, sizeof gains);
    memset(gain, 0, sizeof gain);
    memset(&one, 0, sizeof one);
    memset(&two, 0, sizeof two);
    double cost = roll(x, current, moves, (const double (*)[NX + 1])gains, now, gain, 0.0, road, now);
    for (int it = 0; it < @sweeps@; it++) {
        double alpha = 1.0, next = 0.0;
        int better = 0;
        sweep(moves, now, gains, gain);
        for (int tries = 0; tries < 5 && !better; tries++) {
            memcpy(trial, moves, sizeof trial);
            next = roll(x, current, trial, (const double (*)[NX + 1])gains, now, gain, alpha, road, other);
            better = next < cost;
            alpha *= 0.4;
        }
        if (!better) break;
        const double gained = cost - next;
        plan *swap = now;
        now = other;
        other = swap;
        cost = next;
        memcpy(moves, trial, sizeof trial);
        if (gained < 1e-4 * cost) break;
    }
    if (isfinite(cost)) return 0;
    memset(moves, 0, sizeof trial);
    return 1;
}

/* the Kalman estimate after a step, its friction the force that holds or resists */
static void estimate(double *x, const double *y, double risen) {
    double rest[NX], f[NL1] = {0};
    for (int i = 0; i < NX; i++) {
        double t = 0.0;
        for (int j = 0; j < NX; j++) t += A[i * NX + j] * x[j];
        rest[i] = t + B[i] * y[5] + P[i] * risen;
    }
    for (int pass = 0; pass < FRICTION_PASSES; pass++)
        for (int j = 0; j < NL; j++)
            if (dry[j]) {
                double t = 0.0;
                for (int i = 0; i < NX; i++) t += S[j * NX + i] * rest[i];
                for (int i = 0; i < NL; i++) if (i != j) t += implicit[j * NL + i] * f[i];
                f[j] = clip(t / -implicit[j * NL + j], -level[j], level[j]);
            }
    for (int i = 0; i < NX; i++)
        for (int j = 0; j < NL; j++) rest[i] += G[i * NL + j] * f[j];
    for (int i = 0; i < NX; i++) x[i] = rest[i];
    for (int r = 0; r < @sensors@; r++) {
        double t = sees_current[r] * y[5];
        for (int i = 0; i < NX; i++) t += sees[r * NX + i] * rest[i];
        for (int j = 0; j < NL; j++) t += sees_force[r * NL + j] * f[j];
        for (int i = 0; i < NX; i++) x[i] += kalman[i * @sensors@ + r] * (y[r] - t);
    }
}

void @id@_reset(@id@_state *s) { memset(s, 0, sizeof *s); }

double @id@_step(@id@_state *s, const double observation[@ID@_SIGNALS]) {
    double y[6], before = 0.0, risen = s->road[0];
    for (int i = 0; i < 6; i++) {
        y[i] = isfinite(observation[i]) ? observation[i] : i == 5 ? s->last : 0.0;
        y[i] = clip(y[i], -bound[i], bound[i]);
    }
    for (int k = 0; k < POINTS; k++) {
        const double height = isfinite(observation[6 + k]) ? observation[6 + k] : 0.0;
        s->road[k] = height - before;
        before = height;
    }
    estimate(s->x, y, POINTS > 0 ? risen : 0.0);
    memmove(s->moves, s->moves + 1, (N - 1) * sizeof *s->moves);
    s->moves[N - 1] = 0.0;
    s->fallbacks += improve(s->x, y[5], s->moves, s->road);
    double wanted = y[5] + s->moves[0];
    if (!isfinite(wanted)) wanted = y[5];
    wanted = y[5] + clip(wanted - y[5], -SLEW, SLEW);
    s->last = clip(wanted, -LIMIT, LIMIT);
    return s->last;
}
"""


def _array(name: str, values: Any, kind: str = "double") -> str:
    flat = [f"{float(v):.17g}" if kind == "double" else str(int(v)) for v in np.asarray(values).ravel()]
    flat = [v.replace("inf", "HUGE_VAL") for v in flat] or ["0"]
    lines = [", ".join(flat[i : i + 6]) for i in range(0, len(flat), 6)]
    return f"static const {kind} {name}[{len(flat)}] = {{\n    " + ",\n    ".join(lines) + "};\n"


def export_c(controller: FrictionMpc, folder: str | Path) -> tuple[Path, Path]:
    """Write a controller as C code.

    Args:
        controller: A friction-aware MPC.
        folder: Folder of the files; created if missing.

    Returns:
        Paths of the header NAME.h and the source NAME.c.

    Raises:
        InputError: The car has no motor, the horizon is shorter than the preview, or a file cannot be
            written.
    """
    if not isinstance(controller, FrictionMpc) or controller._idle:
        raise InputError(f"no C for '{controller.name}': there is for mpc-friction, on a car with a motor")
    folder = make_folder(folder)
    name = re.sub(r"\W", "_", controller.name, flags=re.ASCII)
    A, B, G, P, C, D, F, S, SI, coupling, dry, level, slope, clear, spread, q, qc, qm, V, slew = (
        controller._problem
    )
    m, estimator, step = controller.prediction, controller.estimator, controller.prediction.step
    points, horizon, laws = controller._points, controller.settings.horizon, len(dry)
    if points > horizon:
        raise InputError(f"the horizon of {horizon} steps is shorter than the preview of {points}")
    constants = [
        f"#define Q_CURRENT {qc:.17g}\n#define Q_MOVE {qm:.17g}",
        f"#define FRICTION_PASSES {3 if len(m.friction) > 1 else 1}\n",
        *(_array(k, v) for k, v in dict(A=A, B=B, G=G, P=P, C=C, D=D, F=F, S=S, SI=SI, V=V, Q=q).items()),
        *(
            _array(k, v)
            for k, v in dict(coupling=coupling, level=level, slope=slope, clearance=clear).items()
        ),
        _array("spread", spread),
        _array("dry", dry, "int"),
        _array("implicit", m.S @ m.G + m.SF),
        _array("kalman", estimator.gain),
        _array("sees", m.C[:N_SENSORS]),
        _array("sees_current", m.D[:N_SENSORS]),
        _array("sees_force", m.F[:N_SENSORS]),
        _array("bound", [bound for _, _, bound in MEASURED]),
    ]
    order = [f" *   {i}: {signal} [{unit}]" for i, (signal, unit, _) in enumerate(MEASURED)]
    if points:
        order.append(
            f" *   6 to {5 + points}: height of the road above that under the wheel [m], {step:g} s, {2 * step:g} s, ... "
            f"{points * step:g} s ahead"
        )
    words = {
        "id": name,
        "ID": name.upper(),
        "n": m.n,
        "horizon": horizon,
        "laws": laws,
        "signals": len(q),
        "points": points,
        "slew": repr(slew),
        "limit": repr(CURRENT_LIMIT),
        "sweeps": controller.settings.iterations,
        "sensors": N_SENSORS,
        "constants": "\n".join(constants),
    }
    source = re.sub(r"@(\w+)@", lambda found: str(words[found[1]]), SOURCE)
    header = HEADER.format(
        **{k: words[k] for k in ("id", "ID", "n", "horizon", "sweeps")},
        title=controller.name,
        network=re.sub(r"[^ -~]|[*/\\]", " ", controller.model.name),
        step=step,
        limit=CURRENT_LIMIT,
        slew=SLEW_LIMIT,
        order="\n".join(order),
        signals=6 + points,
    )
    paths = folder / f"{name}.h", folder / f"{name}.c"
    write_text(paths[0], header)
    write_text(paths[1], source)
    return paths
