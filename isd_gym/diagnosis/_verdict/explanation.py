"""Where the error is: channels, bands and conditions; and curves of the laws for drawings."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.signal import welch

from ..._common.errors import InputError
from ...physics.network.frames import order_told
from .._hypotheses.motion import motions
from .._selection.admissibility import travels
from .._simulation.problem import BROKEN
from ..result import Law, Place, Quantity, Tabulated

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from numpy.typing import NDArray

    from ..._common.arrays import Array
    from ...physics.elements import Motion
    from .._estimation.gauss_newton import Fit
    from .._simulation.problem import Problem


def bands(residual: Array, floor: float, step: float) -> list[tuple[float, float]]:
    """Return the bands [Hz] with 80 % of the residual's power above white noise of deviation `floor`."""
    f, s = welch(residual - residual.mean(), 1 / step, nperseg=min(2048, len(residual)))
    s = np.maximum(np.asarray(s, float) - 2 * floor**2 * step, 0.0)
    if s.sum() <= 0:
        return []
    order = np.argsort(-s)
    needed = order[: int(np.searchsorted(np.cumsum(s[order]), 0.8 * s.sum())) + 1]
    keep = np.zeros(len(f), bool)
    keep[needed] = True
    width = max(1, round(0.01 * len(f)))
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


def find_condition(
    residual: Array, width: int, conditions: Iterable[tuple[NDArray[np.bool_], str]]
) -> str:
    """Return the words of the condition (mask of samples (n,), words) under which a residual's energy over `width` samples is highest;
    "everywhere" below 1.6 times the mean."""
    energy = residual**2
    if not energy.mean() > 0:
        return "everywhere"
    energy = np.convolve(energy, np.ones(width) / width, mode="same")
    mean, best = energy.mean(), (1.6, "everywhere")
    for mask, text in conditions:
        if 0.01 < mask.mean() < 0.5:
            best = max(
                best, (float(energy[mask].mean() / mean), text), key=lambda b: b[0]
            )
    return best[1]


def near_reversals(rate: Array, width: int) -> NDArray[np.bool_]:
    """Return the samples (n,) within `width` samples of a change of sign of `rate` (n,)."""
    turn = np.concatenate([[False], np.sign(rate[1:]) != np.sign(rate[:-1])])
    return np.asarray(np.convolve(turn, np.ones(2 * width + 1), mode="same") > 0)


def conditions(
    problem: Problem, motion: dict[tuple[str, str], Motion], n: int, width: int
) -> Iterator[tuple[NDArray[np.bool_], str]]:
    """Yield conditions on the motion of node pairs and on currents in the first fitted record: masks of samples (n,) and their words."""
    record, known = (
        problem.records[problem.estimation[0]],
        travels(problem, problem.network, motion),
    )
    for (a, b), m in motion.items():
        turns = {a, b} & problem.network.rotating
        scale, length, speed = (1.0, "rad", "rad/s") if turns else (1e3, "mm", "m/s")
        d, v = record.seen(m.d[: record.samples]), record.seen(m.v[: record.samples])
        if len(d) < n:
            continue
        yield near_reversals(v, width), f"velocity of {a}-{b} changes sign"
        for q in (0.8, 0.95):
            level = float(np.quantile(np.abs(d), q))
            if known[a, b].is_known and not order_told(problem.network, (a, b)):
                yield (
                    np.abs(d) > level,
                    f"|travel of {a}-{b}| is beyond {scale * level:.3g} {length}",
                )
            level = float(np.quantile(np.abs(v), q))
            yield (
                np.abs(v) > level,
                f"|velocity of {a}-{b}| is above {level:.3g} {speed}",
            )
            low, high = np.quantile(v, 1 - q), np.quantile(v, q)
            if low < 0.0 < high:
                yield v > high, f"{a}-{b} extends faster than {high:.3g} {speed}"
                yield v < low, f"{a}-{b} compresses faster than {-low:.3g} {speed}"
    for c in problem.network.inputs:
        if c.quantity == "current":
            current = np.abs(record.seen(record.inputs[c.name]))
            level = float(np.quantile(current, 0.8))
            yield current > level, f"{c.name} is above {level:.3g} A"


def locate_errors(problem: Problem, fit: Fit, floor: Array) -> tuple[Place, ...]:
    """Return each channel's share of the excess error, with its bands and the condition of the motion, largest share first."""
    try:
        motion = motions(problem, fit)
    except BROKEN:
        motion = {}
    excess, spread = [], problem.deviation()
    for j in range(len(problem.channels)):
        every = np.concatenate(
            [
                problem.records[i].measured[:, j] - fit.outputs[i][:, j]
                for i in problem.estimation
            ]
        )
        excess.append(
            max(float(np.mean(every**2)) - floor[j] ** 2, 0.0) / float(spread[j]) ** 2
        )
    total = sum(excess) or 1.0
    out = []
    first = problem.estimation[0]
    record = problem.records[first]
    width = max(1, int(0.2 * problem.time / record.interval))
    tried = list(conditions(problem, motion, len(record), width))
    for j, name in enumerate(problem.channels):
        r = record.measured[:, j] - fit.outputs[first][:, j]
        condition = find_condition(r, width, tried)
        found = tuple(bands(r, floor[j], record.interval))
        out.append(Place(name, excess[j] / total, found, condition))
    return tuple(sorted(out, key=lambda p: -p.share))


def draw_law(
    problem: Problem, fit: Fit, name: str, quantities: dict[str, Quantity]
) -> Law | None:
    """Return the force of an effect over travel or rate, with a band from the intervals of its parameters."""
    e = fit.network.element(name)
    motion = (
        motions(problem, fit, (e.between,)).get(e.between)
        if e.place == "between"
        else None
    )
    if motion is None or e.plane == "time":
        return None
    visited = motion.v if e.plane == "rate" else motion.d
    reach = float(np.quantile(np.abs(visited), 0.999)) or 1e-6
    axis = np.linspace(-reach, reach, 1601)  # a cogging may have dozens of periods
    middle = e.curve(axis)
    spread = np.zeros(len(axis))
    for key, q in quantities.items():
        for value in (q.low, q.high):
            try:
                changed = fit.network.with_parameters({f"{name}.{key}": value}).element(
                    name
                )
            except InputError:
                continue
            spread = np.maximum(spread, np.abs(changed.curve(axis) - middle))
    return _law(
        name,
        e.plane == "rate",
        axis,
        (middle, middle - spread, middle + spread),
        visited,
    )


def draw_table(problem: Problem, fit: Fit, t: Tabulated) -> Law:
    """Return a tabulated force over rate or elongation; a force of both over elongation at zero rate."""
    motion = motions(problem, fit, (t.between,))[t.between]
    is_rate = t.over == "rate"
    still = int(np.argmin(np.abs(t.rate))) if t.over == "both" else slice(None)
    force, low, high = (
        x[:, still] if t.over == "both" else x for x in (t.force, t.low, t.high)
    )
    axis = np.array(t.rate if is_rate else t.elongation)
    return _law(
        t.element, is_rate, axis, (force, low, high), motion.v if is_rate else motion.d
    )


def _law(
    name: str,
    is_rate: bool,
    axis: Array,
    curves: tuple[Array, Array, Array],
    visited: Array,
) -> Law:
    """Return a curve with its band, and some of the operating points."""
    return Law(
        name,
        "rate" if is_rate else "travel",
        axis,
        *curves,
        visited[:: max(1, len(visited) // 2000)],
    )
