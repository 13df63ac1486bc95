"""Where the error is: channels, bands and conditions."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.signal import welch

from ...physics.network.frames import order_told
from .._estimation.gauss_newton import residuals
from .._hypotheses.motion import motions
from .._selection.admissibility import travels
from .._simulation.problem import BROKEN
from ..result import Place

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from numpy.typing import NDArray

    from ..._common.arrays import Array
    from ...physics.elements import Motion
    from .._estimation.gauss_newton import Fit
    from .._simulation.problem import Problem


def band(residual: Array, floor: float, step: float) -> tuple[float, float] | None:
    """Return the band [Hz] with 80 % of the residual's power above white noise of deviation `floor`; None without such power."""
    f, s = welch(residual - residual.mean(), 1 / step, nperseg=min(2048, len(residual)))
    total = np.cumsum(np.maximum(s - 2 * floor**2 * step, 0.0))
    if total[-1] <= 0:
        return None
    low, high = f[np.searchsorted(total, [0.1 * total[-1], 0.9 * total[-1]])]
    return round(float(low), 2), round(float(high), 2)


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
    """Yield conditions on the motion of node pairs in the first fitted record: masks of samples (n,) and their words."""
    network, record = problem.network, problem.records[problem.estimation[0]]
    known = travels(problem, network, motion)
    for (a, b), m in motion.items():
        turns = {a, b} & network.rotating
        scale, length, speed = (1.0, "rad", "rad/s") if turns else (1e3, "mm", "m/s")
        d, v = record.seen(m.d[: record.samples]), record.seen(m.v[: record.samples])
        if len(d) < n:
            continue
        yield near_reversals(v, width), f"velocity of {a}-{b} changes sign"
        for q in (0.8, 0.95):
            if known[a, b].is_known and not order_told(network, (a, b)):
                level = float(np.quantile(np.abs(d), q))
                far = f"|travel of {a}-{b}| is beyond {scale * level:.3g} {length}"
                yield np.abs(d) > level, far
            level = float(np.quantile(np.abs(v), q))
            yield (
                np.abs(v) > level,
                f"|velocity of {a}-{b}| is above {level:.3g} {speed}",
            )
            low, high = np.quantile(v, [1 - q, q])
            if low < 0.0 < high:
                yield v > high, f"{a}-{b} extends faster than {high:.3g} {speed}"
                yield v < low, f"{a}-{b} compresses faster than {-low:.3g} {speed}"


def locate_errors(problem: Problem, fit: Fit, floor: Array) -> tuple[Place, ...]:
    """Return each channel's share of the excess error, with its band and the condition of the motion, largest share first."""
    try:
        motion = motions(problem, fit)
    except BROKEN:
        motion = {}
    power = np.mean(np.concatenate(residuals(problem, fit)) ** 2, axis=0)
    excess = np.maximum(power - floor**2, 0.0) / problem.deviation() ** 2
    share = excess / (excess.sum() or 1.0)
    first = problem.estimation[0]
    record = problem.records[first]
    left = record.measured - fit.outputs[first]
    width = max(1, int(0.2 * problem.time / record.interval))
    tried = list(conditions(problem, motion, len(record), width))
    out = []
    for j, name in enumerate(problem.channels):
        own = left[:, j]
        condition = find_condition(own, width, tried)
        found = band(own, floor[j], record.interval)
        out.append(Place(name, float(share[j]), found, condition))
    return tuple(sorted(out, key=lambda p: -p.share))
