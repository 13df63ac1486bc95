"""Dry friction: a set-valued law that holds up to `bound` and slides against `bound`; the kernel projects."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from ._base import (
    Element,
    Motion,
    Setting,
    Start,
    beside,
    growing,
    held_still,
    parameter,
    register,
    rms,
)
from ._laws import ConstantForce

if TYPE_CHECKING:
    from collections.abc import Mapping

    from ..._common.arrays import Array
    from ..network import Network


def _constant(p: Array, d: float, v: float) -> float:
    return p[0]


def _stribeck(p: Array, d: float, v: float) -> float:
    return p[0] + (p[1] - p[0]) * math.exp(-((v / p[2]) ** 2))


@register
class CoulombFriction(Element):
    type = "coulomb_friction"
    mechanism = "dry_friction"
    equation = "F in f Sgn(v)"
    source = "f = 0.5 kN, section 3.2, Figure 6"
    signature = "a step in force where the velocity changes sign; sticking"
    test = (
        "Move the two parts slowly against each other (triangle, 0.1 Hz): beside what springs and dampers there give, the force "
        "must jump by twice {level} at each reversal, at half the amplitude as well."
    )
    plane = "rate"
    bound = staticmethod(_constant)
    level: float = parameter("N", 5.0, 2000.0)

    @classmethod
    def stands(cls, network: Network, where: tuple[str, ...]) -> bool:
        return not any(
            isinstance(e, CoulombFriction | StribeckFriction)
            for e in beside(network, where)
        )

    @classmethod
    def starts(cls, at: Setting) -> list[Start]:
        return [growing(level=at.small)]


def known_level(at: Setting) -> float:
    """Return the level of the Coulomb friction that the model has at the place [N]; 0 without one."""
    levels = (e.level for e in at.beside if isinstance(e, CoulombFriction))
    return next(levels, 0.0)


@register
class StribeckFriction(Element):
    type = "stribeck_friction"
    mechanism = "dry_friction"
    equation = "F in [f + (f_s - f) exp(-(v/v_s)^2)] Sgn(v)"
    source = "Stribeck; Armstrong-Helouvry et al., Automatica 30 (1994)"
    signature = "Coulomb friction with a higher level near zero velocity"
    test = (
        "Move the two parts slowly and ever slower: the force must rise from {level} towards "
        "{static_level} below {stribeck_velocity}, and jump at each reversal."
    )
    plane = "rate"
    contains = ("coulomb_friction",)
    replaces = ("coulomb_friction",)  # the curve includes the constant level
    shaped_by = "stribeck_velocity"
    bound = staticmethod(_stribeck)
    level: float = parameter("N", 5.0, 2000.0)
    static_level: float = parameter("N", 5.0, 4000.0)
    stribeck_velocity: float = parameter("m/s", 1e-3, 0.2, open_end=True)

    def support(self, motion: Motion) -> float:
        """Return the share of the samples below or above the Stribeck velocity, whichever is smaller."""
        below = float(np.mean(np.abs(motion.v) < self.stribeck_velocity))
        return min(below, 1.0 - below)

    @classmethod
    def starts(cls, at: Setting) -> list[Start]:
        level = known_level(at)
        rises = (at.small, level) if level else (at.small,)
        return [
            Start(
                {
                    "level": level + 0.3 * at.small,
                    "static_level": level + 0.3 * at.small + rise,
                    "stribeck_velocity": share * rms(at.moves.v),
                },
                grows=("level", "static_level") if not level else (),
                signed=bool(level),
            )
            for share in (0.1, 0.3, 1.0)
            for rise in rises
        ]

    @classmethod
    def special(
        cls, simple: str, values: Mapping[str, float], motion: Motion | None
    ) -> dict[str, float]:
        rate = rms(motion.v) if motion is not None else 0.0
        share = math.exp(-((rate / values["stribeck_velocity"]) ** 2))
        return {
            "level": values["level"]
            + (values["static_level"] - values["level"]) * share
        }

    def well_formed(self) -> bool:
        return (
            self.level <= self.static_level
        )  # a level that rises with speed mimics damping


@register
class AsymmetricFriction(Element):
    type = "asymmetric_friction"
    mechanism = "dry_friction"
    equation = (
        "F in [-f_c, f_e]: f_e for v > 0 (extension), -f_c for v < 0 (compression)"
    )
    source = "seals and drives that rub differently either way; Armstrong-Helouvry et al., Automatica 30 (1994)"
    signature = (
        "Coulomb friction about a constant force: it creeps to one side under vibration"
    )
    test = (
        "Pull the two parts slowly one way and the other: the force must be {extension} out and {compression} in, "
        "at every speed."
    )
    plane = "rate"
    contains = ("coulomb_friction",)
    replaces = ("coulomb_friction",)
    extension: float = parameter("N", 5.0, 2000.0)
    compression: float = parameter("N", 5.0, 2000.0)

    def parts(self) -> tuple[Element, ...]:
        # exact in sliding and sticking: a friction of the mean level plus a constant force
        mean, lean = (
            0.5 * (self.extension + self.compression),
            0.5 * (self.extension - self.compression),
        )
        return (
            CoulombFriction(self.name, self.where, mean),  # type: ignore[call-arg]
            ConstantForce(f"{self.name} (lean)", self.where, lean),  # type: ignore[call-arg]
        )

    def curve(self, axis: Array) -> Array:
        return np.where(
            axis > 0, self.extension, np.where(axis < 0, -self.compression, 0.0)
        )

    @classmethod
    def stands(cls, network: Network, where: tuple[str, ...]) -> bool:
        # if only a spring defines the zero, the constant part is a preload of the spring
        return not rubs_unevenly(network, where) and not held_still(network, where)

    @classmethod
    def starts(cls, at: Setting) -> list[Start]:
        level = known_level(at)
        pairs = ((1.3, 0.7), (0.7, 1.3))
        return [
            Start({"extension": a * (level or at.small), "compression": b * (level or at.small)},
                  grows=() if level else ("extension", "compression"), signed=bool(level))
            for a, b in pairs
        ]  # fmt: skip

    @classmethod
    def special(
        cls, simple: str, values: Mapping[str, float], motion: Motion | None
    ) -> dict[str, float]:
        return {"level": 0.5 * (values["extension"] + values["compression"])}


def rubs_unevenly(network: Network, where: tuple[str, ...]) -> bool:
    """Return whether a place has a friction whose level depends on the rate."""
    kinds = StribeckFriction | AsymmetricFriction
    return any(isinstance(e, kinds) for e in beside(network, where))
