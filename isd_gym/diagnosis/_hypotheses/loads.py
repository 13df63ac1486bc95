"""Loads that gears and screws transmit in a fitted simulation, and whether they tell the level of a friction from its gain.

Under a load that swings about zero, or under one constant load, a friction that grows with the load is nearly a friction of a constant
level. Two records with different mean loads separate the two, such as two payloads.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..._common.arrays import rms
from ..._common.errors import InputError
from .motion import watched

if TYPE_CHECKING:
    from collections.abc import Collection, Sequence

    from ..._common.arrays import Array
    from .._estimation.gauss_newton import Fit
    from .._estimation.structure import Hypothesis
    from .._simulation.problem import Problem

#: smallest difference of the magnitudes of two mean loads, as a share of the largest RMS load of a record
LEAST_DIFFERENCE = 0.3


def loads_of(problem: Problem, fit: Fit, candidates: Collection[Hypothesis]) -> dict[str, list[Array]]:
    """Return the load of each training record (samples,) [N], or [N m] where nodes turn, by loading element of the candidates, as a
    fitted simulation computes it; empty where the simulation breaks down."""
    names = list(dict.fromkeys(dict(h.options)["load"] for h in candidates if h.kind.loaded))
    if not names:
        return {}
    probes = tuple(fit.network.probe(f"_{n}", "force", element=n) for n in names)
    try:
        seen = watched(problem, fit, probes)
    except (InputError, np.linalg.LinAlgError):
        return {}
    return {n: [seen[i][:, k] for i in problem.estimation] for k, n in enumerate(names)}


def tell_gain(loads: Sequence[Array]) -> bool:
    """Return whether the loads of the records tell the level of a friction from its gain: the mean loads of two records must differ
    in magnitude."""
    means = [abs(float(np.mean(x))) for x in loads]
    return max(means) - min(means) > LEAST_DIFFERENCE * max(rms(x) for x in loads)
