"""Where the gap lives, in plain words; the law that was found, drawn; and the experiment that would separate rivals."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.signal import welch

from .. import elements as el
from ..errors import InputError
from ..network import Network
from .choose import Rival, motions
from .fit import Fit
from .hypotheses import Motion
from .problem import Array, Problem, Record
from .result import Law, Place, Quantity


def bands(residual: Array, floor: float, step: float) -> list[tuple[float, float]]:
    """Bands [Hz] that together hold 80 % of what the residual's spectrum has above white noise of deviation `floor`."""
    f, s = welch(residual - residual.mean(), 1 / step, nperseg=min(2048, len(residual)))
    s = np.maximum(np.asarray(s, float) - 2 * floor**2 * step, 0.0)
    if s.sum() <= 0:
        return []
    order = np.argsort(-s)
    needed = order[: int(np.searchsorted(np.cumsum(s[order]), 0.8 * s.sum())) + 1]
    keep = np.zeros(len(f), bool)
    keep[needed] = True
    width = max(1, round(0.5 / (f[1] - f[0])))
    out: list[tuple[float, float]] = []
    for k in np.flatnonzero(keep):
        low, high = float(max(f[k] - 0.5 * f[1], 0.0)), float(f[k] + 0.5 * f[1])
        if out and low - out[-1][1] <= width * f[1]:
            out[-1] = (out[-1][0], high)
        else:
            out.append((low, high))
    power = [float(s[(f >= a) & (f <= b)].sum()) for a, b in out]
    best = sorted(np.argsort(power)[::-1][:3])
    return [(round(out[k][0], 2), round(out[k][1], 2)) for k in best]


def when(
    problem: Problem, fit: Fit, residual: dict[int, Array], motion: dict[tuple[str, str], Motion]
) -> str:
    """The condition under which the residual's energy per sample is highest above its mean: in plain words."""
    i = problem.estimation[0]
    record = problem.records[i]
    e = residual[i] ** 2
    n = len(e)
    if not e.mean() > 0:
        return "everywhere"
    width = max(1, int(0.02 / record.rate))
    e = np.asarray(np.convolve(e, np.ones(width) / width, mode="same"), dtype=np.float64)
    best = (1.6, "everywhere")  # a condition must raise the energy by this factor to be worth saying

    def consider(mask: NDArray[np.bool_], text: str) -> None:
        nonlocal best
        share = mask.mean()
        if 0.01 < share < 0.5:
            ratio = float(e[mask].mean() / e.mean())
            if ratio > best[0]:
                best = (ratio, text)

    for (a, b), m in motion.items():
        d, v = record.seen(m.d[: record.samples]), record.seen(m.v[: record.samples])
        if len(d) < n:
            continue
        turn = np.zeros(n, bool)
        turn[1:] = np.sign(v[1:]) != np.sign(v[:-1])
        near = np.convolve(turn, np.ones(2 * width + 1), mode="same") > 0
        consider(near, f"velocity of {a}-{b} changes sign")
        for q in (0.8, 0.95):
            level = float(np.quantile(np.abs(d), q))
            consider(np.abs(d) > level, f"|travel of {a}-{b}| beyond {1e3 * level:.3g} mm")
            level = float(np.quantile(np.abs(v), q))
            consider(np.abs(v) > level, f"|velocity of {a}-{b}| above {level:.3g} m/s")
            consider(v > np.quantile(v, q), f"{a}-{b} extends faster than {np.quantile(v, q):.3g} m/s")
            consider(
                v < np.quantile(v, 1 - q), f"{a}-{b} compresses faster than {-np.quantile(v, 1 - q):.3g} m/s"
            )
    for c in problem.network.inputs:
        if c.quantity == "current":
            current = np.abs(record.seen(record.inputs[c.name]))
            level = float(np.quantile(current, 0.8))
            consider(current > level, f"{c.name} above {level:.3g} A")
    return best[1]


def places(problem: Problem, fit: Fit, floor: Array) -> tuple[Place, ...]:
    """Every channel's share of the refitted model's excess error, in units of its noise; where in frequency and motion."""
    try:
        motion = motions(problem, fit)
    except (InputError, np.linalg.LinAlgError):
        motion = {}
    excess = []
    for j in range(len(problem.channels)):
        every = np.concatenate(
            [problem.records[i].measured[:, j] - fit.outputs[i][:, j] for i in problem.estimation]
        )
        spread = max(
            float(np.std(np.concatenate([problem.records[i].measured[:, j] for i in problem.estimation]))),
            1e-300,
        )
        excess.append(max(float(np.mean(every**2)) - floor[j] ** 2, 0.0) / spread**2)
    total = sum(excess) or 1.0
    out = []
    for j, name in enumerate(problem.channels):
        r = {i: problem.records[i].measured[:, j] - fit.outputs[i][:, j] for i in problem.estimation}
        first = problem.estimation[0]
        out.append(
            Place(
                name,
                excess[j] / total,
                tuple(bands(r[first], floor[j], problem.records[first].rate)),
                when(problem, fit, r, motion),
            )
        )
    return tuple(sorted(out, key=lambda p: -p.share))


def law(problem: Problem, fit: Fit, name: str, quantities: dict[str, Quantity]) -> Law | None:
    """The force of a found two-terminal effect over travel or rate, with the band of its parameters' intervals."""
    e = fit.network.element(name)
    if e.place != "between":
        return None
    motion = motions(problem, fit).get(e.between)
    if motion is None:
        return None
    rate = isinstance(
        e,
        el.LinearDamping
        | el.QuadraticDamping
        | el.AsymmetricDamping
        | el.CoulombFriction
        | el.StribeckFriction,
    )
    visited = motion.v if rate else motion.d
    reach = float(np.quantile(np.abs(visited), 0.999)) or 1e-6
    axis = np.linspace(-reach, reach, 1601)  # a cogging may have dozens of periods

    def force(element: el.Element) -> Array:
        p = np.array(element.law_parameters())
        k, c, b = element.linear()
        cls = type(element)
        if cls.bound is not None:
            return np.array([cls.bound(p, 0.0, v) * np.sign(v) for v in axis])
        if cls.law is not None:
            if isinstance(element, el.Hysteresis):
                loop, z, last, out = np.concatenate([axis, axis[::-1], axis]), 0.0, axis[0], []
                for d in loop:
                    f, z = cls.law(p, d, 0.0, last, z, 1e-3)
                    last = d
                    out.append(f)
                return np.array(out[-len(axis) :])
            return np.array(
                [
                    cls.law(p, 0.0, x, 0.0, 0.0, 1e-3)[0] if rate else cls.law(p, x, 0.0, x, 0.0, 1e-3)[0]
                    for x in axis
                ]
            )
        return (c if rate else k) * axis

    middle = force(e)
    spread = np.zeros(len(axis))
    for key, q in quantities.items():
        for value in (q.low, q.high):
            try:
                changed = fit.network.with_parameters({f"{name}.{key}": value}).element(name)
            except InputError:
                continue
            spread = np.maximum(spread, np.abs(force(changed) - middle))
    return Law(
        name,
        "rate" if rate else "travel",
        axis,
        middle,
        middle - spread,
        middle + spread,
        visited[:: max(1, len(visited) // 2000)],
        np.zeros(0),
    )


def experiments(network: Network, record: Record) -> list[tuple[str, dict[str, Array], float]]:
    """Candidate tests: (description, inputs, step): sines, a slow triangle, a bump and current steps."""
    step = 2e-3
    t = np.arange(0.0, 10.0, step)
    moved = [c for c in network.inputs if c.quantity == "displacement"]
    current = [c for c in network.inputs if c.quantity == "current"]
    forces = [c for c in network.inputs if c.quantity == "force"]
    silent = {c.name: np.zeros(len(t)) for c in network.inputs}
    out: list[tuple[str, dict[str, Array], float]] = []
    window = np.minimum(1.0, np.minimum(t, t[-1] - t) / 0.5)
    for c in moved:
        x = record.inputs[c.name]
        reach = float(np.ptp(x)) / 2 or 0.01
        for scale in (0.5, 1.5):
            a = scale * reach
            for f in (0.5, 1.5, 4.0, 10.0):
                amplitude = min(a, 0.6 / (2 * math.pi * f))
                out.append(
                    (
                        f"sine of {1e3 * amplitude:.3g} mm at {f:g} Hz at {c.name}",
                        silent | {c.name: amplitude * window * np.sin(2 * math.pi * f * t)},
                        step,
                    )
                )
            out.append(
                (
                    f"triangle of {1e3 * a:.3g} mm at 0.1 Hz at {c.name}",
                    silent | {c.name: a * (2 / math.pi) * np.arcsin(np.sin(2 * math.pi * 0.1 * t))},
                    step,
                )
            )
        bump = np.where((t > 1) & (t < 1.2), 0.5 * (1 - np.cos(2 * math.pi * (t - 1) / 0.2)), 0.0)
        out.append(
            (
                f"bump of {2e3 * reach:.3g} mm, 0.2 s long, at {c.name}",
                silent | {c.name: 2 * reach * bump},
                step,
            )
        )
    for c in current:
        top = float(np.abs(record.inputs[c.name]).max()) or 1.0
        out.append(
            (
                f"steps of {top:.3g} A in {c.name}",
                silent | {c.name: top * np.sign(np.sin(2 * math.pi * 0.7 * t))},
                step,
            )
        )
        out.append(
            (
                f"sine of {top:.3g} A at 1.5 Hz in {c.name}",
                silent | {c.name: top * np.sin(2 * math.pi * 1.5 * t)},
                step,
            )
        )
    for c in forces:
        top = float(np.abs(record.inputs[c.name]).max()) or 1.0
        for f in (0.3, 1.5, 5.0):
            out.append(
                (
                    f"sine of {top:.3g} N at {f:g} Hz at {c.name}",
                    silent | {c.name: top * np.sin(2 * math.pi * f * t)},
                    step,
                )
            )
    return out


def next_experiment(problem: Problem, rivals: list[Rival], floor: Array) -> dict[str, Any] | None:
    """The candidate test whose outcome the two foremost rivals predict most differently, in noise standard deviations."""
    if len(rivals) < 2:
        return None
    first = problem.records[problem.estimation[0]]
    best: tuple[float, str, str] = (0.0, "", "")
    for text, inputs, step in experiments(problem.network, first):
        n = len(next(iter(inputs.values())))
        blank = Record("experiment", step, inputs, np.zeros((n, len(problem.channels))))
        trial = Problem(problem.network, [blank], [False], problem.step)
        try:
            a, b = (trial.simulate([r.fit.network], 0)[:, :, 0] for r in rivals[:2])
        except (InputError, np.linalg.LinAlgError):
            continue
        if not (np.isfinite(a).all() and np.isfinite(b).all()):
            continue
        separation = np.sqrt(np.mean((a - b) ** 2, axis=0)) / np.maximum(floor, 1e-300)
        j = int(np.argmax(separation))
        if separation[j] > best[0]:
            best = float(separation[j]), text, problem.channels[j]
    if not best[1]:
        return None
    names = [" and ".join(h.label for h in r.hypotheses) for r in rivals[:2]]
    return {"do": best[1], "watch": best[2], "separates": names, "separation_sigma": best[0]}
