"""Nonlinear least-squares match of a law to a given curve."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.optimize import least_squares

from ...physics import elements as el
from .._simulation.problem import BROKEN

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping

    from ..._common.arrays import Array

EVALUATIONS = 60  # of a law per start


@dataclass(frozen=True, eq=False)
class LawMatch:
    """A law fitted to a curve."""

    values: dict[str, float]  # parameters of the law
    residual: Array  # residual of the match (samples,)

    @property
    def error(self) -> float:
        """Root mean square of the residual."""
        return el.rms(self.residual)


def match_law(
    kind: type[el.Element],
    starts: Iterable[Mapping[str, float]],
    residual: Callable[[dict[str, float]], Array],
    *,
    mirrored: bool = False,
) -> LawMatch | None:
    """Return the match of a law's free parameters to a curve with the smallest error over several starts; positive ones by their
    logarithm."""
    matches = [m for start in starts for m in _matches_from(start, kind, residual, mirrored)]
    return min(matches, key=lambda m: m.error, default=None)


def _matches_from(
    start: Mapping[str, float],
    kind: type[el.Element],
    residual: Callable[[dict[str, float]], Array],
    mirrored: bool,
) -> Iterator[LawMatch]:
    """Yield the fits from one start. See `match_law` for the arguments."""
    free = [f for f in el.parameter_fields(kind) if not f.metadata["fixed"] and f.name in start]
    unit = [max(abs(start[f.name]), 1e-12) for f in free]
    log = [f.metadata["minimum"] >= 0 for f in free]

    def values_at(x: Array) -> dict[str, float]:
        scaled = (u * math.exp(min(v, 50.0)) if lg else u * v for u, v, lg in zip(unit, x, log, strict=True))
        return {**start, **dict(zip([f.name for f in free], map(float, scaled), strict=True))}

    for sign in (1.0, -1.0) if mirrored and not all(log) else (1.0,):
        x0 = np.array([0.0 if lg else sign for lg in log])
        try:
            fit = least_squares(lambda x: residual(values_at(x)), x0, max_nfev=EVALUATIONS)
        except (*BROKEN, ValueError, OverflowError):
            continue
        yield LawMatch(values_at(fit.x), fit.fun)
