"""Force and motion with exchanged roles, where that makes the better problem.

The direct problem is force in, motion out, in place of motion in, force out: a model that computes a force from a measured motion amplifies
the noise of the motion, and a model that integrates the measured force does not. It is used if the refitted model predicts the motion far
better than a straight line does, and if no controller sets the force (Van den Hof 1998).

The inverse problem is motion in, force out. A mass that no spring holds integrates its force twice: a small error of the force soon leads
the simulated motion away from the measured one. The force that the measured motion needs has no such memory. This is the usual
identification of robots and machine axes (Gautier 1997).

References:
    Van den Hof, Closed-loop issues in system identification, Annual Reviews in Control 22 (1998) 173.
    Gautier, Dynamic identification of robots with power model, Proc. IEEE ICRA (1997) 1922.
    Janot, Gautier, Brunot, Data set and reference models of EMPS, Workshop on Nonlinear System Identification Benchmarks (2019).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from ..._common.arrays import rms
from ..._common.errors import InputError
from ..._common.units import convert
from ...physics.network import GROUND, Channel, assemble, natural_frequencies, transfer
from .._records.feedback import find_feedback
from .._records.filtering import find_computed_forces
from .._simulation.problem import BROKEN, Problem
from .gauss_newton import Fitter, residuals
from .noise import floors_of, propagate_input_noise, white_weights
from .structure import base_structure

if TYPE_CHECKING:
    from collections.abc import Sequence

    from ...physics.network import Network
    from .._simulation.problem import Record


#: smallest noise that residuals are weighted with, as a share of the signal's deviation
LEAST_NOISE = 0.01


def prefer_direct_problem(
    records: Sequence[Record],
    network: Network,
    training: int,
    least_noise: float,
    largest_error: float,
) -> tuple[list[Record], Network, str] | None:
    """Return records, model and a note with motion and force swapped; None where the computed force has less noise than `least_noise`
    (share of its deviation), or where the refitted direct model errs more than `largest_error` times a straight line."""
    pairs = find_computed_forces(network)
    if len(pairs) != 1 or any(r.source is not None for r in records):
        return None
    motion, force = pairs[0]
    inverse = Problem(network, records[:training])
    noise = (propagate_input_noise(inverse) / inverse.deviation())[
        network.outputs.index(force)
    ]
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
    floors = np.maximum(
        [f.deviation for f in floors_of(direct)], LEAST_NOISE * direct.deviation()
    )
    try:
        fit = Fitter(direct, white_weights(floors)).fit(base_structure(swapped))
    except BROKEN:
        return None
    lines = [(r.time, r.measured[:, channel]) for r in direct.records]
    straight = rms(
        np.concatenate([y - np.polyval(np.polyfit(t, y, 1), t) for t, y in lines])
    )
    if (
        not rms(np.concatenate(residuals(direct, fit))[:, channel])
        < largest_error * straight
    ):
        return None
    note = (
        f"{force.name} is taken as input and {motion.name} as output: noise of {motion.name}, differentiated twice, would be "
        f"{noise:.0%} of the deviation of {force.name}"
    )
    return turned, swapped, note


def swap_roles(network: Network, given: Channel, computed: Channel) -> Network:
    """Return the model with the force at a node and the displacement of the node as input and output, either way."""
    to_input, to_output = (
        replace(c, offset=None, noise=None) for c in (computed, given)
    )
    return replace(
        network,
        inputs=tuple(to_input if c == given else c for c in network.inputs),
        outputs=tuple(to_output if c == computed else c for c in network.outputs),
    )


def swap_channels(
    record: Record, network: Network, given: Channel, computed: Channel
) -> Record:
    """Return an unfiltered record of `network` with the channels of the model after `swap_roles`."""
    j = network.outputs.index(computed)
    inputs = {k: v for k, v in record.inputs.items() if k != given.name}
    inputs[computed.name] = convert(record.measured[:, j], computed.unit, computed.si)
    measured = record.measured.copy()
    measured[:, j] = convert(record.inputs[given.name], given.si, given.unit)
    return replace(record, inputs=inputs, measured=measured)


@dataclass(frozen=True)
class InverseProblem:
    """A model whose mass is moved as measured, with the force of its drive as output."""

    network: Network
    #: the model with the drive as input
    direct: Network
    #: the model with the force of the drive as input
    pushed: Network
    #: force at the mass by unit of the drive [N/A] or [-]
    gain: float

    def records(self, records: Sequence[Record]) -> list[Record]:
        """Return unfiltered records with the measured position as input and the force of the drive as output."""
        (drive,), (force,), (position,) = (
            self.direct.inputs,
            self.pushed.inputs,
            self.pushed.outputs,
        )
        pushed = [
            replace(r, inputs={force.name: self.gain * r.inputs[drive.name]})
            for r in records
        ]
        return [swap_channels(r, self.pushed, force, position) for r in pushed]

    def restore(self, found: Network) -> Network | None:
        """Return the direct model with the parameters and added elements of a completed inverse model; None for an element at a
        channel."""
        if any(e.place != "between" for e in found.elements):
            return None
        own, known = (
            {e.name: e for e in found.elements},
            {e.name for e in self.direct.elements},
        )
        elements = [own.get(e.name, e) for e in self.direct.elements]
        elements += [e for e in found.elements if e.name not in known]
        out = replace(
            self.direct,
            masses=found.masses,
            elements=tuple(elements),
            description=found.description,
            uncertainty={},
        )
        return out.with_uncertainty({**self.direct.uncertainty, **found.uncertainty})


def invert(network: Network) -> InverseProblem | None:
    """Return the inverse problem of one driven mass that no spring holds, with its displacement as output; None for another model."""
    if (
        len(network.inputs) != 1
        or len(network.outputs) != 1
        or len(network.masses) != 1
        or network.moving
    ):
        return None
    (drive,), (position,), (node,) = network.inputs, network.outputs, network.masses
    if (
        position.quantity != "displacement"
        or position.at != node
        or natural_frequencies(network).size
    ):
        return None
    motor = next((e for e in network.elements if e.name == drive.element), None)
    if (
        drive.quantity == "current"
        and motor is not None
        and {*motor.where} == {node, GROUND}
    ):
        left = [e for e in network.elements if motor.name not in (e.name, *e.where)]
        if len(left) < len(network.elements) - 1:  # an effect at the motor
            return None
        name = f"{motor.name}_force"
    elif drive.quantity == "force" and drive.at == node:
        left, name = [*network.elements], drive.name
    else:
        return None
    force = Channel(
        name, "force", at=node, unit="N m" if node in network.turning else "N"
    )
    try:
        pushed = replace(network, elements=tuple(left), inputs=(force,), uncertainty={})
        pushed = pushed.with_uncertainty(network.uncertainty)
        at = np.array([1.0])  # [Hz]
        gain = float(
            np.real(transfer(network, at)[0, 0, 0] / transfer(pushed, at)[0, 0, 0])
        )
        inverse = swap_roles(pushed, force, position)
        if assemble(inverse.mechanical).size[0]:
            return None
    except BROKEN:
        return None
    return InverseProblem(inverse, network, pushed, gain)
