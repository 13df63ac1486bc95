"""Conditions for a name where an input follows from outputs.

Under feedback a simulation of whole records is no valid comparison: an element that keeps the simulation near the record, such as a
spring to the ground, takes the place of the disturbances that the controller answered to. Over brief stretches, each from a
state of its own, the disturbances before a stretch are in its initial state. And an element whose force is a multiple of
the controller's force cannot be told from an error of the drive.

References:
    Ljung, System Identification, 2nd ed. (1999), section 13.3 (closed loop and the direct method).
    Van den Hof, Closed-loop issues in system identification, Annual Reviews in Control 22 (1998) 173.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from ..._common.errors import InputError
from .._hypotheses.forces import element_forces
from .._hypotheses.motion import motions
from .._records.feedback import LINEAR
from .._selection.criteria import CRITERIA
from .gates import gate

if TYPE_CHECKING:
    from collections.abc import Sequence

    from ..._common.arrays import Array
    from ...physics.elements import Element
    from .._estimation.gauss_newton import Fit
    from .._records.feedback import Feedback
    from .._selection.criteria import Criteria
    from .._simulation.problem import Problem
    from .gates import Decision


#: share of a force's power beyond multiples of travel and rate, below which the force counts as linear in them
NEARLY_LINEAR = 0.1


def decide_under_feedback(
    decision: Decision,
    problem: Problem,
    fit: Fit,
    feedback: Sequence[Feedback],
    brief: bool,
    c: Criteria = CRITERIA,
) -> Decision:
    """Return the decision with a gate for each condition, and `unknown_effect` for a name that feedback may have caused. `brief`: whether
    records were compared over brief stretches."""
    if not feedback or decision.verdict != "missing_effect":
        return decision
    gates = [*decision.gates]
    if not brief:
        worst = max(feedback, key=lambda f: f.share)
        text = f"share of {worst.input} that past outputs explain; under feedback whole records are no comparison"
        gates.append(
            gate("open loop", max(worst.share, LINEAR[0]), "<", LINEAR[0], text)
        )
    for e in fit.elements:
        for f in feedback:
            share = imitated_share(problem, fit, e, f.input)
            text = f"share of the force of {e.type} that {f.input}, which follows from {' and '.join(f.outputs)}, explains"
            gates.append(gate("not the controller", share, "<", c.least_removed, text))
    if all(g.passed for g in gates):
        return replace(decision, gates=tuple(gates))
    return replace(decision, verdict="unknown_effect", gates=tuple(gates))


def imitated_share(problem: Problem, fit: Fit, element: Element, name: str) -> float:
    """Return the share of an element's force that an input explains as a multiple: their squared correlation within records, given travel
    and rate of the element, since a drive always works against friction; the plain one for a force that is linear in travel and rate."""
    if element.place != "between":
        return 0.0
    try:
        force = element_forces(problem, fit, element.where)[element.name]
    except InputError:
        return 0.0
    inputs = [problem.records[i].inputs[name] for i in problem.estimation]
    edges = np.cumsum([len(u) for u in inputs])[:-1]

    def centred(values: Array) -> Array:
        return np.concatenate([part - part.mean() for part in np.split(values, edges)])

    def correlation(a: Array, b: Array) -> float:
        return float(a @ b) ** 2 / max(float(a @ a) * float(b @ b), 1e-300)

    f, u = centred(force), centred(np.concatenate(inputs))
    motion = motions(problem, fit).get((element.where[0], element.where[1]))
    if motion is None:
        return correlation(f, u)
    terms = np.stack([centred(motion.d), centred(motion.v)], axis=1)
    beyond = [y - terms @ np.linalg.lstsq(terms, y, rcond=None)[0] for y in (f, u)]
    if float(beyond[0] @ beyond[0]) < NEARLY_LINEAR * float(f @ f):
        return correlation(f, u)
    # a controller that switches with the position imitates forces over travel
    return (
        correlation(*beyond)
        if element.plane == "rate"
        else max(correlation(f, u), correlation(*beyond))
    )
