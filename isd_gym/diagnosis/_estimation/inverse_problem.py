"""The inverse problem: motion in, force out, in place of force in, motion out.

A mass that no spring holds integrates its force twice: a small error of the force soon leads the simulated motion away from the measured one,
and a fit of this motion compares positions that have nothing in common. The force that the measured motion needs has no such memory. This is
the usual identification of robots and machine axes (Gautier 1997).

References:
    Gautier, Dynamic identification of robots with power model, Proc. IEEE ICRA (1997) 1922.
    Janot, Gautier, Brunot, Data set and reference models of EMPS, Workshop on Nonlinear System Identification Benchmarks (2019).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from ..._common.errors import InputError
from ...physics.network import GROUND, Channel, assemble, natural_frequencies, transfer
from .._simulation.problem import bare
from .direct_problem import swap_channels, swap_roles

if TYPE_CHECKING:
    from collections.abc import Sequence

    from ...physics.network import Network
    from .._simulation.problem import Record


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
        (drive,), (force,), (position,) = self.direct.inputs, self.pushed.inputs, self.pushed.outputs
        pushed = [replace(r, inputs={force.name: self.gain * r.inputs[drive.name]}) for r in records]
        return [swap_channels(r, self.pushed, force, position) for r in pushed]

    def restore(self, found: Network) -> Network | None:
        """Return the direct model with the parameters and added elements of a completed inverse one; None where one acts on the force
        alone."""
        if any(e.place != "between" for e in found.elements):
            return None
        own, known = {e.name: e for e in found.elements}, {e.name for e in self.direct.elements}
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
    if len(network.inputs) != 1 or len(network.outputs) != 1 or len(network.masses) != 1 or network.moving:
        return None
    (drive,), (position,), (node,) = network.inputs, network.outputs, network.masses
    if position.quantity != "displacement" or position.at != node or natural_frequencies(network).size:
        return None
    motor = next((e for e in network.elements if e.name == drive.element), None)
    if drive.quantity == "current" and motor is not None and {*motor.where} == {node, GROUND}:
        left = [e for e in network.elements if motor.name not in (e.name, *e.where)]
        if len(left) < len(network.elements) - 1:  # an effect at the motor
            return None
        name = f"{motor.name}_force"
    elif drive.quantity == "force" and drive.at == node:
        left, name = [*network.elements], drive.name
    else:
        return None
    force = Channel(name, "force", at=node, unit="N m" if node in network.turning else "N")
    try:
        pushed = replace(network, elements=tuple(left), inputs=(force,), uncertainty={})
        pushed = pushed.with_uncertainty(network.uncertainty)
        at = np.array([1.0])  # [Hz]
        gain = float(np.real(transfer(network, at)[0, 0, 0] / transfer(pushed, at)[0, 0, 0]))
        inverse = swap_roles(pushed, force, position)
        if assemble(bare(inverse)).size[0]:
            return None
    except (InputError, np.linalg.LinAlgError):
        return None
    return InverseProblem(inverse, network, pushed, gain)
