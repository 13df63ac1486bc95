"""Fits of periodic laws at neighbouring periods: a periodic law has one optimum per period."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from .motion import motions

if TYPE_CHECKING:
    from .._estimation.gauss_newton import Fit, Fitter
    from .._simulation.problem import Problem


def try_neighbouring_periods(problem: Problem, fitter: Fitter, fit: Fit, name: str) -> Fit:
    """A periodic law has one optimum per period: scan pitch and phase around the fit, and fit again from the best.

    The span of travel holds n periods; a pitch that is off by one part in 2n fits the middle but not the ends.
    """
    motion = motions(problem, fit)
    element = fit.network.element(name)
    d = motion[element.between].d
    span = float(np.ptp(d))
    paths = {f.path: k for k, f in enumerate(fit.structure.free)}
    assert element.periodic is not None
    kp, kf = (paths[f"{name}.{key}"] for key in element.periodic)
    if (
        fit.structure.free[kp].low == fit.structure.free[kp].high
    ):  # a whole fraction of a turn has no neighbours
        return fit
    centre = float(np.exp(fit.x[kp]))
    middle = float(np.median(d))
    step = 0.12 * centre / span  # relative: an eighth of a period over the span
    trials = []
    for k in range(-20, 21):
        pitch = centre * (1 + k * step)
        if pitch <= 0:
            continue
        for phase in np.arange(6) * (math.pi / 3):
            x = fit.x.copy()
            x[kp] = math.log(pitch)
            # keep the phase in the middle of the travel, and turn it through a whole period
            x[kf] = fit.x[kf] + 2 * math.pi * middle * (1 / centre - 1 / pitch) + phase
            trials.append(x)
    costs = np.zeros(len(trials))
    net = fit.network
    # enough to tell pitches apart: the travel's span does it, not the time
    window = [r.part(0, max(len(r) // 3, min(len(r), 2000)), r.name) for r in problem.records]
    short = problem.with_records(window)
    for first in range(0, len(trials), 41):
        chunk = trials[first : first + 41]
        nets = [fit.structure.at(x) for x in chunk]
        begun = {i: np.repeat(fit.initial[i][:, None], len(nets), axis=1) for i in problem.estimation}
        for i, y in short.simulate_all(nets, problem.estimation, begun, like=net).items():
            r = window[i].measured[:, :, None] - short.shifted(i, y, fit.offset[i])
            r = r - np.where(problem.free_offset[:, None], r.mean(axis=0), 0.0)
            costs[first : first + len(nets)] += np.sum(fitter.weights(r) ** 2, axis=(0, 1))
    best = fit
    seen: list[tuple[float, float]] = []
    for k in np.argsort(costs):
        if len(seen) >= 4:
            break
        x = trials[k]
        if any(
            abs(x[kp] - a) < 2.5 * step and abs((x[kf] - b + math.pi) % (2 * math.pi) - math.pi) < 1.2
            for a, b in seen
        ):
            continue
        seen.append((x[kp], x[kf]))
        f = fitter.fit(fit.structure, x, fit.initial, fit.offset, iterations=6)
        if f.cost + f.prior < best.cost + best.prior:
            best = f
    return best
