"""Laws that the library does not have, hidden in rigs made by another integrator: how much of the gap is closed without a name.

python benchmarks/unknown_laws.py --seeds 1 2 3 [--laws NAME ...] [--rigs NAME ...] [--json FILE]

Five smooth laws, each in two rigs (a mass on a shaken base; a car on a rough road), integrated by a Runge-Kutta of this file's own. The
owner's model is off by some per cent and lacks the law. Of every case: the verdict, the place and plane of the table that was found, and
the share of the reducible gap that is closed on held-out records, reckoned with the true noise. FILE is gone on with when it is there.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

STEP, FINE = 5e-3, 5  # [s] between samples, steps of the integrator between them
NOISE = 0.01  # of a channel's deviation
STIFF = 0.3

#: (elongation over its scale, rate over its scale) -> force over that of the damper, or of `STIFF` of the spring
LAWS: dict[str, tuple[str, Callable[[float, float], float]]] = {
    "shear_thinning": ("rate", lambda d, v: 1.2 * v / math.sqrt(1.0 + (1.5 * v) ** 2)),
    "soft_saturation": ("elongation", lambda d, v: 1.5 * math.tanh(2.0 * d)),
    "bistable": ("elongation", lambda d, v: -1.4 * d * math.exp(-((1.2 * d) ** 2))),
    "falling_damping": ("rate", lambda d, v: 1.6 * v * math.exp(-((0.9 * v) ** 2))),
    "travel_damping": ("both", lambda d, v: 0.9 * d * d * v),
}


def excitation(
    rng: np.random.Generator, samples: int, band: tuple[float, float], size: float, slope: float
) -> np.ndarray:
    """A random multi-sine (samples * FINE + 1,) of deviation `size`, its amplitudes falling as frequency to the `slope`."""
    t = np.arange(samples * FINE + 1) * STEP / FINE
    f = rng.uniform(*band, 60)
    x = sum(fi**-slope * np.sin(2 * np.pi * fi * t + rng.uniform(0, 2 * np.pi)) for fi in f)
    x = (x - x[0]) * (1 - np.exp(-((t / 0.5) ** 2)))
    return size * x / x.std()


def integrate(rate: Callable[[np.ndarray, float, float], np.ndarray], r: np.ndarray, size: int) -> np.ndarray:
    """Classical Runge-Kutta from rest over moved displacement r; the states at every sample."""
    h = STEP / FINE
    speed = np.gradient(r, h)
    x, out = np.zeros(size), []
    for k in range(len(r) - 1):
        if k % FINE == 0:
            out.append(x)
        middle, pace = 0.5 * (r[k] + r[k + 1]), 0.5 * (speed[k] + speed[k + 1])
        a = rate(x, r[k], speed[k])
        b = rate(x + 0.5 * h * a, middle, pace)
        c = rate(x + 0.5 * h * b, middle, pace)
        d = rate(x + h * c, r[k + 1], speed[k + 1])
        x = x + h / 6 * (a + 2 * b + 2 * c + d)
    return np.array(out)


def element(kind: str, name: str, a: str, b: str, **values: float) -> dict[str, Any]:
    return {"name": name, "type": kind, "between": [a, b], **values}


def shaken(
    rng: np.random.Generator, plane: str, law: Callable[[float, float], float]
) -> tuple[dict[str, Any], Callable[..., Any]]:
    """A mass on a shaken base, seen by an encoder and an accelerometer."""
    m, w, zeta = float(np.exp(rng.uniform(-1, 3))), 2 * np.pi * rng.uniform(1.5, 4.0), rng.uniform(0.15, 0.35)
    k, c, size = m * w**2, 2 * zeta * m * w, float(np.exp(rng.uniform(-6, -4)))
    rates = w * size
    force = STIFF * k * size if plane == "elongation" else c * rates

    def run(seed: int, samples: int) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        r = excitation(np.random.default_rng(seed), samples, (0.3, 8.0), size, 1.0)

        def link(d: float, v: float) -> float:
            return k * d + c * v + force * law(d / size, v / rates)

        def rate(x: np.ndarray, u: float, du: float) -> np.ndarray:
            return np.array([x[1], -link(x[0] - u, x[1] - du) / m])

        x = integrate(rate, r, 2)
        u, du = r[:-1:FINE], np.gradient(r, STEP / FINE)[:-1:FINE]
        a = np.array([-link(p - q, s - t) / m for (p, s), q, t in zip(x, u, du, strict=True)])
        return u, {"travel": x[:, 0] - u, "acceleration": a}

    off = 1.0 + 0.03 * rng.standard_normal(3)
    model = {
        "schema": "isd-model/1", "name": "shaken", "masses": {"mass": m * off[0]},
        "elements": [
            element("linear_stiffness", "spring", "mass", "base", stiffness=k * off[1]),
            element("linear_damping", "damper", "mass", "base", damping=c * off[2]),
        ],
        "inputs": [{"name": "moved", "quantity": "displacement", "at": "base", "unit": "m"}],
        "outputs": [
            {"name": "travel", "quantity": "displacement", "between": ["mass", "base"], "unit": "m"},
            {"name": "acceleration", "quantity": "acceleration", "at": "mass", "unit": "m/s^2"},
        ],
        "uncertainty": {"mass.mass": 0.05, "spring.stiffness": 0.05, "damper.damping": 0.1},
    }  # fmt: skip
    return model, run


def car(
    rng: np.random.Generator, plane: str, law: Callable[[float, float], float]
) -> tuple[dict[str, Any], Callable[..., Any]]:
    """Body and wheel on a rough road; the law stands in the strut."""
    ms, mu = rng.uniform(250, 450), rng.uniform(30, 55)
    k, kt, c = (
        ms * (2 * np.pi * rng.uniform(1.1, 1.7)) ** 2,
        rng.uniform(1.6e5, 2.2e5),
        rng.uniform(900, 1500),
    )
    size = rng.uniform(0.008, 0.015)
    rates = 12.0 * size
    force = STIFF * k * size if plane == "elongation" else c * rates

    def run(seed: int, samples: int) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        r = excitation(np.random.default_rng(seed), samples, (0.3, 12.0), 1.3 * size, 1.0)

        def strut(d: float, v: float) -> float:
            return k * d + c * v + force * law(d / size, v / rates)

        def rate(x: np.ndarray, u: float, du: float) -> np.ndarray:
            f = strut(x[0] - x[1], x[2] - x[3])
            return np.array([x[2], x[3], -f / ms, (f - kt * (x[1] - u)) / mu])

        x = integrate(rate, r, 4)
        a = np.array([-strut(p - q, s - t) / ms for p, q, s, t in x])
        return r[:-1:FINE], {"body_acceleration": a, "suspension_travel": x[:, 0] - x[:, 1]}

    off = 1.0 + 0.03 * rng.standard_normal(5)
    model = {
        "schema": "isd-model/1", "name": "car", "masses": {"body": ms * off[0], "wheel": mu * off[1]},
        "elements": [
            element("linear_stiffness", "spring", "body", "wheel", stiffness=k * off[2]),
            element("linear_damping", "damper", "body", "wheel", damping=c * off[3]),
            element("linear_stiffness", "tyre", "wheel", "road", stiffness=kt * off[4]),
        ],
        "inputs": [{"name": "moved", "quantity": "displacement", "at": "road", "unit": "m"}],
        "outputs": [
            {"name": "body_acceleration", "quantity": "acceleration", "at": "body", "unit": "m/s^2"},
            {"name": "suspension_travel", "quantity": "displacement", "between": ["body", "wheel"], "unit": "m"},
        ],
        "uncertainty": {
            "body.mass": 0.05, "wheel.mass": 0.05, "spring.stiffness": 0.05, "damper.damping": 0.1, "tyre.stiffness": 0.05,
        },
    }  # fmt: skip
    return model, run


RIGS = {"shaken": shaken, "car": car}


def case(rig: str, law: str, seed: int, samples: int = 2400) -> dict[str, Any]:
    """Make a rig, diagnose it, and say what came of it."""
    from isd_gym.diagnosis import diagnose
    from isd_gym.records.data import Table

    rng = np.random.default_rng([seed, list(RIGS).index(rig), list(LAWS).index(law)])
    plane, force = LAWS[law]
    model, run = RIGS[rig](rng, plane, force)
    tables = []
    for k in range(4):
        u, out = run(int(rng.integers(1 << 31)), samples)
        noisy = {n: y + NOISE * y.std() * rng.standard_normal(len(y)) for n, y in out.items()}
        tables.append(
            Table(time=np.arange(samples) * STEP, columns={"moved": u, **noisy}, source=f"{rig}_{k}")
        )
    begun = time.process_time()
    result = diagnose(tables[:2], model, validate=tables[2:])
    refit, after = (np.array(list(result.gap[row].values())) for row in ("refit", "after"))
    closed = float(np.sum(refit**2 - after**2) / np.sum(refit**2 - NOISE**2))
    t = result.tabulated
    return {
        "rig": rig, "law": law, "seed": seed, "plane": plane, "verdict": result.verdict,
        "named": [e.effect for e in result.effects], "refit": refit.tolist(), "after": after.tolist(), "closed": closed,
        "table": None if t is None else {"between": list(t.between), "over": t.over, "explained": t.explained, "nearest": t.nearest},
        "seconds": time.process_time() - begun,
    }  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=int, nargs="+", required=True)
    parser.add_argument("--laws", nargs="+", choices=LAWS, default=list(LAWS))
    parser.add_argument("--rigs", nargs="+", choices=RIGS, default=list(RIGS))
    parser.add_argument("--json", type=Path)
    args = parser.parse_args()
    rows = json.loads(args.json.read_text()) if args.json and args.json.exists() else []
    done = {(r["rig"], r["law"], r["seed"]) for r in rows}
    for seed in args.seeds:
        for rig in args.rigs:
            for law in args.laws:
                if (rig, law, seed) in done:
                    continue
                row = case(rig, law, seed)
                rows.append(row)
                t = row["table"]
                what = (
                    f"table over {t['over']}, {'-'.join(t['between'])}"
                    if t
                    else ", ".join(row["named"]) or "nothing"
                )
                print(
                    f"{rig:7s} {law:16s} seed {seed}: {row['verdict']:15s} {what:40s} refit {max(row['refit']):6.1%} after "
                    f"{max(row['after']):6.1%} closed {row['closed']:6.1%} ({row['seconds']:.0f} s)", flush=True,
                )  # fmt: skip
                if args.json:
                    args.json.write_text(json.dumps(rows, indent=1) + "\n")
    mine = [r for r in rows if r["seed"] in args.seeds]
    for law in args.laws:
        of = [r["closed"] for r in mine if r["law"] == law]
        print(f"{law:16s} median closed {np.median(of):6.1%} of {len(of)}")
    print(
        f"all: median {np.median([r['closed'] for r in mine]):.1%}; verdict unknown in {np.mean([r['verdict'] == 'unknown_effect' for r in mine]):.0%}"
    )


if __name__ == "__main__":
    main()
