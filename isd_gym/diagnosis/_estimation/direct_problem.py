"""The direct problem: force in, motion out, in place of motion in, force out.

A model that computes a force from a measured motion amplifies the noise of the motion. A model that integrates the measured force does
not. The direct problem is used if the refitted model predicts the motion far better than a straight line does, and if no controller sets
the force (Van den Hof 1998).

References:
    Van den Hof, Closed-loop issues in system identification, Annual Reviews in Control 22 (1998) 173.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from ..._common.arrays import rms
from ..._common.errors import InputError
from ..._common.units import convert
from .._records import find_computed_forces, find_feedback
from .._simulation.problem import BROKEN, Problem
from .gauss_newton import Fitter, residuals
from .input_noise import propagate_input_noise
from .noise import floors_of, white_filters
from .structure import base_structure

if TYPE_CHECKING:
    from collections.abc import Sequence

    from ...physics.network import Channel, Network
    from .._simulation.problem import Record

#: smallest noise that residuals are weighted with, as a share of the signal's deviation
LEAST_NOISE = 0.01


def prefer_direct_problem(
    records: Sequence[Record], network: Network, training: int, least_noise: float, largest_error: float
) -> tuple[list[Record], Network, str] | None:
    """Return records, model and a note with motion and force swapped; None where the computed force has less noise than `least_noise`
    (share of its deviation), or where the refitted direct model errs more than `largest_error` times a straight line."""
    pairs = find_computed_forces(network)
    if len(pairs) != 1 or any(r.reading is not None for r in records):
        return None
    motion, force = pairs[0]
    inverse = Problem(network, records[:training])
    noise = (propagate_input_noise(inverse) / inverse.deviation())[network.outputs.index(force)]
    if noise < least_noise:
        return None
    try:
        swapped = swap_roles(network, motion, force)
    except InputError:
        return None
    turned = [swap_channels(r, network, motion, force) for r in records]
    if find_feedback(turned, swapped):
        return None
    direct = Problem(swapped, turned[:training])
    channel = [c.name for c in swapped.outputs].index(motion.name)
    if not _refitted_error(direct, channel) < largest_error * _straight_error(direct, channel):
        return None
    note = (
        f"{force.name} is taken as input and {motion.name} as output: noise of {motion.name}, differentiated twice, would be "
        f"{noise:.0%} of the deviation of {force.name}"
    )
    return turned, swapped, note


def swap_roles(network: Network, given: Channel, computed: Channel) -> Network:
    """Return the model with the force at a node and the displacement of the node as input and output, either way."""
    to_input, to_output = (replace(c, offset=None, noise=None) for c in (computed, given))
    return replace(
        network,
        inputs=tuple(to_input if c == given else c for c in network.inputs),
        outputs=tuple(to_output if c == computed else c for c in network.outputs),
    )


def swap_channels(record: Record, network: Network, given: Channel, computed: Channel) -> Record:
    """Return an unfiltered record of `network` with the channels of the model after `swap_roles`."""
    j = network.outputs.index(computed)
    inputs = {k: v for k, v in record.inputs.items() if k != given.name}
    inputs[computed.name] = convert(record.measured[:, j], computed.unit, computed.si)
    measured = record.measured.copy()
    measured[:, j] = convert(record.inputs[given.name], given.si, given.unit)
    return replace(record, inputs=inputs, measured=measured)


def _straight_error(problem: Problem, channel: int) -> float:
    """Return the RMS error of a straight line through each record [unit of the channel]."""
    left = []
    for r in problem.records:
        y = r.measured[:, channel]
        left.append(y - np.polyval(np.polyfit(r.time, y, 1), r.time))
    return rms(np.concatenate(left))


def _refitted_error(problem: Problem, channel: int) -> float:
    """Return the RMS error of the refitted model [unit of the channel]; infinite where no fit succeeds."""
    floors = np.maximum([f.deviation for f in floors_of(problem)], LEAST_NOISE * problem.deviation())
    try:
        fit = Fitter(problem, white_filters(floors)).fit(base_structure(problem.network))
    except BROKEN:
        return math.inf
    return rms(np.concatenate(residuals(problem, fit))[:, channel])
