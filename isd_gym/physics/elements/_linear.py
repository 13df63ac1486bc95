"""Springs, dampers, inerters and the motor: linear elements, which are assembled instead of stepped."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

from ._base import (
    GROUND,
    Element,
    Setting,
    Start,
    beside,
    growing,
    held_by_parameter,
    parameter,
    register,
    rms,
)

if TYPE_CHECKING:
    from ..network import Network


@register
class LinearStiffness(Element):
    type = "linear_stiffness"
    mechanism = "elastic"
    equation = "F = k d"
    source = "Table 6 (main spring, tyre), Table 4 (oil)"
    signature = "force in phase with travel, the same at every amplitude"
    test = (
        "Load the two parts slowly: the force must follow travel with an extra {stiffness} at every "
        "amplitude."
    )
    stiffness: float = parameter("N/m", 1e2, 1e6)

    def linear(self) -> tuple[float, float, float]:
        return self.stiffness, 0.0, 0.0

    @classmethod
    def stands(cls, network: Network, where: tuple[str, ...]) -> bool:
        return not any(isinstance(e, LinearStiffness) for e in beside(network, where))

    @classmethod
    def starts(cls, at: Setting) -> list[Start]:
        return [growing(stiffness=at.small / rms(at.moves.d))]


@register
class SeriesCompliance(LinearStiffness):
    type = "series_compliance"
    mechanism = "series_compliance"
    equation = "F = k d, in series with what stands at the terminal (by hand: a node between the two)"
    source = "oil elasticity of section 3, in series as the 0.1 Hz test demands"
    signature = "nothing at low frequency, growing with the force that passes through"
    test = (
        "Block the device and load it: it must give way elastically with {stiffness}; at low force "
        "nothing changes."
    )
    series = True
    stiffness: float = parameter("N/m", 1e4, 1e7, open_end=True)

    @classmethod
    def stands(cls, network: Network, where: tuple[str, ...]) -> bool:
        # in series with a lone spring, the effect is only a softer spring
        return bool({e.type for e in beside(network, where)} - {"linear_stiffness"})

    @classmethod
    def starts(cls, at: Setting) -> list[Start]:
        return [
            Start(
                {"stiffness": at.force / (0.02 * rms(at.moves.d))},
                grows=("stiffness",),
                inverse=True,
            )
        ]


@register
class LinearDamping(Element):
    type = "linear_damping"
    mechanism = "viscous"
    equation = "F = c v"
    source = "Table 6 (damper), Table 4 (leak)"
    signature = "force in phase with velocity, the same at every amplitude"
    test = "Double the speed at the same amplitude: the extra force ({damping}) must double, at every amplitude."
    plane = "rate"
    damping: float = parameter("N s/m", 10.0, 1e4)

    def linear(self) -> tuple[float, float, float]:
        return 0.0, self.damping, 0.0

    @classmethod
    def starts(cls, at: Setting) -> list[Start]:
        return [growing(damping=at.small / rms(at.moves.v))]


@register
class Inertance(Element):
    type = "inertance"
    mechanism = "inertial"
    equation = "F = b dv/dt"
    source = "equation (5), Table 6"
    signature = "force in phase with relative acceleration"
    test = "Double the frequency at the same amplitude: the extra force ({inertance}) must grow fourfold."
    plane = "time"
    inertance: float = parameter("kg", 1.0, 500.0)

    def linear(self) -> tuple[float, float, float]:
        return 0.0, 0.0, self.inertance

    @classmethod
    def stands(cls, network: Network, where: tuple[str, ...]) -> bool:
        # an inertance to the ground is a change of a mass that is uncertain already
        return super().stands(network, where) and not held_by_parameter(network, where)

    @classmethod
    def starts(cls, at: Setting) -> list[Start]:
        return [growing(inertance=at.small / rms(at.moves.a))]


@register
class TerminalInertia(Element):
    type = "terminal_inertia"
    mechanism = "inertial"
    equation = "F = m a_terminal (absolute acceleration of one terminal)"
    source = "the m n dv1/dt term that equation (3) has and equation (4) drops"
    signature = "force in phase with absolute, not relative, acceleration"
    test = (
        "Shake both terminals together, so that the device does not extend: a force of {mass} times the "
        "acceleration must remain."
    )
    plane = "time"
    choices: ClassVar[dict[str, tuple[str, ...]]] = {"terminal": ("first", "second")}
    mass: float = parameter("kg", 0.5, 60.0)
    terminal: str = "second"

    @classmethod
    def stands(cls, network: Network, where: tuple[str, ...]) -> bool:
        here = beside(network, where)
        inert = any(isinstance(e, Inertance) for e in here)
        # a device has moving parts; to the ground, their effect is an inertance
        return super().stands(network, where) and (
            inert or (is_device(network, where) and GROUND not in where)
        )

    @classmethod
    def variants(cls, network: Network, where: tuple[str, ...]) -> list[dict[str, str]]:
        return [
            {"terminal": t}
            for t, node in zip(("first", "second"), where, strict=True)
            if node != GROUND
        ]

    @classmethod
    def starts(cls, at: Setting) -> list[Start]:
        return [growing(mass=at.small / rms(at.moves.a))]


@register
class Motor(Element):
    type = "motor"
    mechanism = "drive"
    equation = "F1 = K_f r I"
    source = "F1 of equations (6) and (8); area ratio S_R/S_r = 4.056 of Table 1"
    signature = "force in proportion to current"
    plane = "time"
    driven: ClassVar[bool] = True
    thrust_constant: float = parameter("N/A", 20.0, 200.0)
    ratio: float = parameter("-", 1.0, 10.0, default=1.0, open_end=True)

    @classmethod
    def stands(cls, network: Network, where: tuple[str, ...]) -> bool:
        return False  # a motor is never overlooked


def is_device(network: Network, where: tuple[str, ...]) -> bool:
    """Return whether a motor or an inerter is between two nodes; in a network without any, every connected pair is a device."""
    devices = {
        frozenset(e.where) for e in network.elements if isinstance(e, Motor | Inertance)
    }
    return frozenset(where) in devices if devices else bool(beside(network, where))
