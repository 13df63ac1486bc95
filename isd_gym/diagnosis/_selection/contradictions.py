"""Contradictions between the values of a fitted law and its name, on the motion of the records."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ...physics import elements as el
from .._hypotheses.forces import place_forces
from .._hypotheses.motion import motions
from .criteria import CRITERIA

if TYPE_CHECKING:
    from .._estimation.gauss_newton import Fit
    from .._simulation.problem import Problem
    from .criteria import Criteria

#: multiple of the motion beyond which a length or a rate of a law is beyond the records: at 20 times the motion a law and its limit differ by 5 %
FURTHEST = 20.0
#: multiple of the typical force from which on a law is balanced by another law: forces in parallel that cancel to a tenth
LARGEST = 10.0
#: share of the samples that define the travel: rare excursions show no repetition
TRAVEL = 0.95


def repeats(element: el.Element, motion: el.Motion, c: Criteria = CRITERIA) -> bool:
    """Return False for a periodic law with fewer than `Criteria.periods` periods within the travel."""
    if not element.periodic:
        return True
    low, high = np.quantile(motion.d, [0.5 - 0.5 * TRAVEL, 0.5 + 0.5 * TRAVEL])
    return bool(c.periods * getattr(element, element.periodic[0]) <= high - low)


def find_contradiction(
    problem: Problem, fit: Fit, element: el.Element, c: Criteria = CRITERIA
) -> str:
    """Return how the values of a law contradict its name on these records; empty where they do not."""
    if not element.well_formed():
        return "its values contradict its name"
    if element.place != "between" or element.series:
        return ""
    motion = motions(problem, fit).get(element.between)
    if motion is None:
        return ""
    if not repeats(element, motion, c):
        return "the travel covers too little of a period for the law to repeat"
    if not element.differs_from_limit(motion):
        return "on this motion the law is the limit of another law"
    scales = {"m": motion.reach, "m/s": float(np.abs(motion.v).max())}
    for f in el.parameter_fields(type(element)):
        scale = scales.get(f.metadata["unit"])
        if (
            scale
            and not f.metadata["fixed"]
            and getattr(element, f.name) > FURTHEST * scale
        ):
            return f"its {f.name.replace('_', ' ')} is far beyond the measured motion"
    if element.plane != "time":
        axis = motion.v if element.plane == "rate" else motion.d
        force = element.curve(axis[:: max(1, len(axis) // 500)])
        inertia = problem.network.largest_inertia(*element.where) * el.rms(motion.a)
        typical = place_forces(problem, fit, without=element.name).at(element.where)
        if el.rms(force) > LARGEST * max(typical, inertia):
            return "its force is many times the forces of the records"
    return ""
