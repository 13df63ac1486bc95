"""Multiple shooting: a fit to brief segments, each with its own initial state, gives the start of a fit to whole records.

A slightly damped motion remembers for many periods. Parameters that are a little off lose its phase, and the error over a whole
record then has valleys that do not lead to its least; over brief stretches it has one (Bock, Springer Series in Chemical
Physics 18 (1981) 102; Ljung, System Identification, section 10.4).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..._common.errors import InputError
from ...physics.network import Network, linearise
from .._records.splitting import cut_segments
from .._simulation.problem import BROKEN, Problem
from .gauss_newton import Fitter

if TYPE_CHECKING:
    from ..._common.arrays import Array
    from .structure import Structure

#: how long a mode is remembered, in its own time (one over the circular frequency), from which on its phase may be lost: damping
#: ratios below 0.03
LONG = 30.0
STRETCH = 40.0  # length of the stretches, in the rig's own time: some six periods
LEAST = 60  # samples of one
SHORT = 0.25  # length of the first segments
GROWTH = 1.6  # of the length of segments, from one fit to the next


def is_lightly_damped(network: Network) -> bool:
    """Return whether a mode of the network, about rest, lasts for many periods."""
    still = network.mechanical
    try:
        poles = np.linalg.eigvals(linearise(still).A)
    except InputError:  # a law without a slope: the linear part
        poles = np.linalg.eigvals(linearise(still, laws=True).A)
    swings = poles[np.abs(poles.imag) > 1e-9 * np.abs(poles).max(initial=0.0)]
    return bool(np.any(np.abs(swings) > LONG * np.abs(swings.real)))


def segments_of(problem: Problem, length: float = 1.0) -> Problem | None:
    """Return the problem with the training records in segments of a multiple of the usual length; None where no record is longer."""
    seconds = length * STRETCH * problem.time
    pieces = [
        s
        for i in problem.estimation
        for s in cut_segments(problem.records[i], seconds, LEAST)
    ]
    if len(pieces) <= len(problem.estimation):
        return None
    return problem.with_records(pieces, ["fit"] * len(pieces))


def fit_segments(
    problem: Problem, structure: Structure, x: Array, weights: Fitter
) -> Array | None:
    """Return the parameters (parameters,), transformed, of fits to segments that grow; None where no record is longer, or a fit breaks
    down."""
    length, found = SHORT, None
    try:
        while (brief := segments_of(problem, length)) is not None:
            found = x = Fitter(brief, weights.weights).fit(structure, x, iterations=8).x
            length *= GROWTH
    except BROKEN:
        return None
    return found
