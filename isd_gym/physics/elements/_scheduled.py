"""Laws whose coefficient depends on a logged channel, such as a temperature or a speed, or on a commanded current.

The channel is an input of the model that acts on no node. The kernel passes its value, or the current, instead
of the elongation, which these laws do not read.

References:
    Rugh, W. J. and Shamma, J. S. (2000). Research on gain scheduling. Automatica 36, 1401.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from ._base import Element, Setting, Start, parameter, register, rms
from ._friction import known_level, rubs_unevenly

if TYPE_CHECKING:
    from ..._common.arrays import Array
    from ..network import Network

#: smallest standard deviation of a logged channel, as a share of its largest value, for a visible influence
LEAST_SPREAD = 1e-3


def _scheduled_damping(
    p: Array, d: float, v: float, d_last: float, z: float, h: float
) -> tuple[float, float]:
    return p[0] * (d - p[1]) * v, z


def _controlled_damping(
    p: Array, d: float, v: float, d_last: float, z: float, h: float
) -> tuple[float, float]:
    share = min(max(0.5 + 0.5 * d / p[2], 0.0), 1.0)
    return (p[0] + (p[1] - p[0]) * share) * v, z


def _scheduled_friction(p: Array, d: float, v: float) -> float:
    return max(p[0] + p[1] * (d - p[2]), 0.0)


class _Scheduled(Element):
    """An element whose `channel` is the name of an input without a node."""

    plane = "time"
    scheduled: ClassVar[bool] = True

    @classmethod
    def variants(cls, network: Network, where: tuple[str, ...]) -> list[dict[str, str]]:
        return [
            {"channel": c.name} for c in network.inputs if c.quantity == "condition"
        ]


def _spread(at: Setting) -> tuple[float, float]:
    """Return mean and standard deviation of the logged channel; 0 for the deviation of a nearly constant channel."""
    values = np.zeros(1) if at.samples is None else at.samples
    mean, deviation = float(np.mean(values)), float(np.std(values))
    return mean, deviation if deviation > LEAST_SPREAD * float(
        np.abs(values).max()
    ) else 0.0


@register
class ScheduledDamping(_Scheduled):
    type = "scheduled_damping"
    mechanism = "viscous"
    equation = "F = s (T - T_0) v, beside what stands there; T is a logged channel"
    source = (
        "oil that thins as it warms up (ISO 3448 gives its viscosity over temperature)"
    )
    signature = "damping that changes with a logged channel, such as a temperature"
    test = "Repeat one motion at two values of the channel: the damping must change by {slope} times their difference."
    law = staticmethod(_scheduled_damping)
    slope: float = parameter(
        "N s/m per unit of the channel", -100.0, 100.0, minimum=-math.inf
    )
    reference: float = parameter(
        "unit of the channel",
        -100.0,
        1000.0,
        default=0.0,
        minimum=-math.inf,
        fixed=True,
    )
    channel: str = ""

    @classmethod
    def starts(cls, at: Setting) -> list[Start]:
        mean, deviation = _spread(at)
        if not deviation or at.samples is None or len(at.samples) != len(at.moves.v):
            return []
        slope = at.small / rms((at.samples - mean) * at.moves.v)
        return [
            Start({"slope": slope, "reference": mean}, grows=("slope",), signed=True)
        ]


@register
class ScheduledFriction(_Scheduled):
    type = "scheduled_friction"
    mechanism = "dry_friction"
    equation = "F in max(f + s (T - T_0), 0) Sgn(v); T is a logged channel"
    source = "seals and grease that warm up; Bittencourt and Gunnarsson, J. Dyn. Sys. Meas. Control 134 (2012)"
    signature = "Coulomb friction whose level changes with a logged channel, such as a temperature"
    test = "Repeat a slow motion at two values of the channel: the jump at each reversal must change by twice {slope} times their difference."
    contains = ("coulomb_friction",)
    replaces = ("coulomb_friction",)
    bound = staticmethod(_scheduled_friction)
    level: float = parameter("N", 5.0, 2000.0)
    slope: float = parameter(
        "N per unit of the channel", -50.0, 50.0, minimum=-math.inf
    )
    reference: float = parameter(
        "unit of the channel",
        -100.0,
        1000.0,
        default=0.0,
        minimum=-math.inf,
        fixed=True,
    )
    channel: str = ""

    @classmethod
    def stands(cls, network: Network, where: tuple[str, ...]) -> bool:
        return not rubs_unevenly(network, where) and super().stands(network, where)

    @classmethod
    def starts(cls, at: Setting) -> list[Start]:
        mean, deviation = _spread(at)
        if not deviation:
            return []
        known = known_level(at)
        level = known or at.small
        return [
            Start(
                {"level": level, "slope": share * level / deviation, "reference": mean},
                grows=() if known else ("level", "slope"),
                signed=bool(known),
            )
            for share in (0.2, -0.2)
        ]


@register
class ControlledDamper(Element):
    """A semi-active damper: a current sets the damping between two limits, half way without current."""

    type = "controlled_damper"
    mechanism = "viscous"
    equation = "F = (c_l + (c_h - c_l) (1 + sat(I / I_h)) / 2) v"
    source = "Karnopp, Crosby and Harwood, J. Eng. Ind. 96, 619 (1974); continuously controlled car dampers"
    signature = "force that opposes the motion at any current; damping in proportion to the current between two limits"
    test = "Move the damper at one speed and step the current from -{current} to {current}: the force must rise from {low} to {high} times the speed."
    plane = "time"
    scheduled: ClassVar[bool] = True
    driven: ClassVar[bool] = True
    law = staticmethod(_controlled_damping)
    low: float = parameter("N s/m", 100.0, 1500.0)
    high: float = parameter("N s/m", 1000.0, 5000.0)
    current: float = parameter("A", 0.5, 5.0, open_end=True)

    @classmethod
    def stands(cls, network: Network, where: tuple[str, ...]) -> bool:
        return False  # a controlled damper is never overlooked
