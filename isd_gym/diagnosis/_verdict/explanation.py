"""Where the error is: channels and bands."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.signal import welch

from .._estimation.gauss_newton import residuals

if TYPE_CHECKING:
    from ..._common.arrays import Array
    from .._estimation.gauss_newton import Fit
    from .._simulation.problem import Problem


@dataclass(frozen=True)
class Place:
    """Part of the gap in one channel."""

    channel: str
    #: share of the squared error beyond noise over all channels
    share: float
    #: frequency band (low, high) with 80 % of the error [Hz]; None without an error beyond noise
    band_hz: tuple[float, float] | None


def band(residual: Array, floor: float, step: float) -> tuple[float, float] | None:
    """Return the band [Hz] with 80 % of the residual's power above white noise of deviation `floor`; None without such power."""
    f, s = welch(residual - residual.mean(), 1 / step, nperseg=min(2048, len(residual)))
    total = np.cumsum(np.maximum(s - 2 * floor**2 * step, 0.0))
    if total[-1] <= 0:
        return None
    low, high = f[np.searchsorted(total, [0.1 * total[-1], 0.9 * total[-1]])]
    return round(float(low), 2), round(float(high), 2)


def locate_errors(problem: Problem, fit: Fit, floor: Array) -> tuple[Place, ...]:
    """Return each channel's share of the excess error over the training records, with its band in the first of them, largest share first."""
    power = np.mean(np.concatenate(residuals(problem, fit)) ** 2, axis=0)
    excess = np.maximum(power - floor**2, 0.0) / problem.deviation() ** 2
    share = excess / (excess.sum() or 1.0)
    first = problem.estimation[0]
    record = problem.records[first]
    left = record.measured - fit.outputs[first]
    out = []
    for j, name in enumerate(problem.channels):
        found = band(left[:, j], floor[j], record.interval)
        out.append(Place(name, float(share[j]), found))
    return tuple(sorted(out, key=lambda p: -p.share))
