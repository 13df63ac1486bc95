"""Dry friction whose level grows with the load that a gear or a screw transmits.

The load is the force of a named element of the model, such as the elasticity of a gear, the weight that hangs on the output, or the
motor. The kernel passes that force instead of the elongation, which the law does not read.

The level of a step follows from the load at the start of the step. The friction dissipates energy under any load, since its level is
never negative.

References:
    Duclusaud, M., Passault, G., Padois, V. and Ly, O. (2025). Extended friction models for the physics simulation of servo actuators.
    ICRA 2025, arXiv:2410.08650.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

from ._base import GROUND, Element, Setting, Start, parameter, register, rms
from ._friction import known_level, rubs_unevenly
from ._linear import LinearStiffness, Motor

if TYPE_CHECKING:
    from ..._common.arrays import Array
    from ..network import Network


def _loaded(p: Array, d: float, v: float) -> float:
    return p[0] + p[1] * abs(d)


def transmits(element: Element) -> bool:
    """Return whether the force of an element can be the load of a friction: no other dry friction, and no inertia force.

    Args:
        element: The element.
    """
    parts = element.parts()
    is_dry = any(type(part).bound is not None for part in parts)
    has_force = isinstance(element, Motor) or bool(parts) or any(element.linear()[:2])
    return (
        element.place == "between"
        and has_force
        and not is_dry
        and not element.linear()[2]
    )


@register
class LoadDependentFriction(Element):
    type = "load_dependent_friction"
    mechanism = "dry_friction"
    equation = "F in (f + g |L|) Sgn(v); L is the force of the element `load`"
    source = "gears and screws; Duclusaud et al., ICRA 2025, arXiv:2410.08650"
    signature = "Coulomb friction whose level grows with the load that a gear or a screw transmits"
    test = "Repeat a slow motion under two loads: the jump at each reversal must change by twice {gain} times their difference."
    plane = "time"
    loaded: ClassVar[bool] = True
    contains = ("coulomb_friction",)
    replaces = ("coulomb_friction",)
    bound = staticmethod(_loaded)
    level: float = parameter("N", 5.0, 2000.0)
    gain: float = parameter("-", 0.01, 0.5)
    load: str = ""

    @classmethod
    def stands(cls, network: Network, where: tuple[str, ...]) -> bool:
        return not rubs_unevenly(network, where) and super().stands(network, where)

    @classmethod
    def variants(cls, network: Network, where: tuple[str, ...]) -> list[dict[str, str]]:
        """Return the loads: springs, constant forces and weights that end at a node of the place, and a motor at the place."""
        here, turns = set(where) - {GROUND}, bool(set(where) & set(network.rotating))
        loads = []
        for e in network.elements:
            is_load = isinstance(e, LinearStiffness | Motor) or e.mechanism in (
                "elastic",
                "constant",
            )
            same = set(e.where) == set(where)
            if (
                e.place != "between"
                or not is_load
                or not here & set(e.where)
                or not transmits(e)
            ):
                continue
            if turns == bool(set(e.where) & set(network.rotating)) and (
                not same or isinstance(e, Motor)
            ):
                loads.append({"load": e.name})
        return loads

    @classmethod
    def starts(cls, at: Setting) -> list[Start]:
        if at.samples is None:
            return []
        known = known_level(at)
        level = known or at.small
        return [
            Start(
                {
                    "level": share * level,
                    "gain": (1.0 - share) * level / rms(at.samples),
                },
                grows=() if known else ("level", "gain"),
                signed=bool(known),
            )
            for share in (0.5, 0.1)
        ]
