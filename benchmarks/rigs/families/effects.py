"""What is hidden in a rig, in proportion to the motion and the force where it sits.

Every function here draws a shape and returns how the effect depends on one number, its size; `case` then finds the size
at which the effect leaves, in the best fit of the model without it, the share of the signal that was asked for. So no
number in this file is a newton or a millimetre.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.random import Generator

if TYPE_CHECKING:
    from .plant import Element

Pair = tuple[str, str]


@dataclass(frozen=True)
class Scale:
    """RMS elongation [m], rate [m/s] and force [N] at a pair of terminals, without the hidden effect; the rig's time scale [s]."""

    travel: float
    rate: float
    force: float
    time: float

    @property
    def stiffness(self) -> float:
        return self.force / self.travel

    @property
    def damping(self) -> float:
        return self.force / self.rate


@dataclass(frozen=True)
class Change:
    """How a rig differs from what its owner believes."""

    elements: tuple[
        Element, ...
    ] = ()  # side by side with what stands there; or `channel`, or `element` (a motor)
    play: tuple[
        tuple[str, float], ...
    ] = ()  # (spring, gap [m]): the spring is had with play
    bushings: tuple[
        tuple[str, Element], ...
    ] = ()  # (damper, what it stands on: its effect and parameters)
    masses: tuple[tuple[str, float], ...] = ()  # bodies that the owner does not know of

    def __add__(self, other: Change) -> Change:
        return Change(
            self.elements + other.elements,
            self.play + other.play,
            self.bushings + other.bushings,
            self.masses + other.masses,
        )


Sized = Callable[[float], Change]
Shape = Callable[[Generator, Scale, Pair], Sized]


@dataclass(frozen=True)
class Hidden:
    """A kind: shapes at their places, what a diagnosis should say, and how large a gap it may leave (shares of the signal)."""

    parts: tuple[tuple[Shape, Any], ...] = ()
    answer: list[list[Any]] | str = field(default_factory=list)
    gap: tuple[float, float] = (0.08, 0.5)
    linear: bool = False  # what is hidden is linear itself: parameters without limits would make up for it

    def __and__(self, other: Hidden) -> Hidden:
        assert isinstance(self.answer, list) and isinstance(other.answer, list)
        return replace(
            self,
            parts=self.parts + other.parts,
            answer=self.answer + other.answer,
            gap=(0.15, 0.6),
        )


NOTHING = Hidden()
FIRST = "first output"
"""Stands for the channel of that place in whatever model is drawn."""


LINEAR = (
    "linear_damping",
    "linear_stiffness",
    "inertance",
    "sensor_gain",
    "sensor_delay",
    "actuator_lag",
)


def at(name: str, shape: Shape, place: Pair | str, **more: Any) -> Hidden:
    """An effect of the library at two terminals, a motor or a channel."""
    where: Any = list(place) if isinstance(place, tuple) else place
    # an effect of the one drive is told with the drive's terminals
    answer: list[list[Any]] = [
        [name, None if name in ("actuator_lag", "thrust_saturation") else where]
    ]
    return Hidden(((shape, place),), answer, linear=name in LINEAR, **more)


def unknown(shape: Shape, place: Pair | str) -> Hidden:
    """An effect that the library does not have."""
    return Hidden(((shape, place),), "unknown", gap=(0.12, 0.5))


def link(kind: str, place: Pair, **parameters: Any) -> Change:
    """One element between two terminals."""
    return Change(({"type": kind, "between": list(place), **parameters},))


def fixed(kind: str, law: Callable[[float, Scale], dict[str, float]]) -> Shape:
    """Return a shape without a draw: `law` gives the parameters at a size."""
    return lambda r, s, place: lambda x: link(kind, place, **law(x, s))


# ------------------------------------------------------------------------------------------------ at two terminals
coulomb = fixed("coulomb_friction", lambda x, s: {"level": x * s.force})


def stribeck(r: Generator, s: Scale, place: Pair) -> Sized:
    rise, speed = r.uniform(1.8, 2.8), r.uniform(0.15, 0.4) * s.rate
    return lambda x: link(
        "stribeck_friction",
        place,
        level=x * s.force,
        static_level=rise * x * s.force,
        stribeck_velocity=speed,
    )


quadratic = fixed("quadratic_damping", lambda x, s: {"damping": x * s.damping / s.rate})


linear_damping = fixed("linear_damping", lambda x, s: {"damping": x * s.damping})


linear_stiffness = fixed(
    "linear_stiffness", lambda x, s: {"stiffness": x * s.stiffness}
)


inertance = fixed(
    "inertance", lambda x, s: {"inertance": x * s.damping * s.travel / s.rate}
)


def asymmetric(r: Generator, s: Scale, place: Pair) -> Sized:
    out = r.random() < 0.5
    return lambda x: link(
        "asymmetric_damping",
        place,
        extension=x * s.damping if out else 0.0,
        compression=0.0 if out else x * s.damping,
    )


hardening = fixed(
    "cubic_stiffness", lambda x, s: {"stiffness": x * s.stiffness / s.travel**2}
)


softening = fixed(
    "cubic_stiffness",
    lambda x, s: {"stiffness": -min(x, 0.06) * s.stiffness / s.travel**2},
)


# gravity on a pendulum: the smaller the length of a radian, the further from linear; the stiffness is that of the rig
sine = fixed(
    "x_sine_less_linear",
    lambda x, s: {
        "stiffness": s.stiffness,
        "length": s.travel / min(np.sqrt(2.0 * x), 0.7),
    },
)


def gas(r: Generator, s: Scale, place: Pair) -> Sized:
    length, n = r.uniform(3.5, 6.0) * s.travel, 1.3
    return lambda x: link(
        "gas_spring",
        place,
        force=x * s.stiffness * length / n,
        length=length,
        exponent=n,
    )


def stop(r: Generator, s: Scale, place: Pair) -> Sized:
    clearance, side = (
        r.uniform(0.8, 1.4) * s.travel,
        str(r.choice(["both", "both", "extension", "compression"])),
    )
    return lambda x: link(
        "bump_stop",
        place,
        clearance=clearance,
        stiffness=8.0 * x * s.stiffness,
        side=side,
    )


def hysteresis(r: Generator, s: Scale, place: Pair) -> Sized:
    way = r.uniform(0.15, 0.5) * s.travel
    return lambda x: link(
        "hysteresis",
        place,
        level=x * s.force,
        stiffness=x * s.force / way,
        exponent=1.0,
        shape=0.5,
    )


def cogging(r: Generator, s: Scale, place: Pair) -> Sized:
    pitch, phase = r.uniform(0.8, 2.2) * s.travel, r.uniform(-np.pi, np.pi)
    return lambda x: link(
        "cogging_force", place, amplitude=x * s.force, pitch=pitch, phase=phase
    )


def play(spring: str) -> Hidden:
    """A joint in line with a spring has play."""
    return Hidden(
        (
            (
                lambda r, s, place: (
                    lambda x: Change(play=((spring, 1.5 * x * s.travel),))
                ),
                spring,
            ),
        ),
        [["backlash", None]],
    )


def bushing(damper: str) -> Shape:
    """The damper's mounting gives way: the softer, the larger the effect."""

    def shape(r: Generator, s: Scale, place: Pair) -> Sized:
        return lambda x: Change(
            bushings=(
                (
                    damper,
                    {
                        "type": "series_compliance",
                        "stiffness": s.force / (x * s.travel),
                    },
                ),
            )
        )

    return shape


def loose_mount(damper: str) -> Shape:
    """The damper's mounting has play, and is stiff beyond it."""

    def shape(r: Generator, s: Scale, place: Pair) -> Sized:
        stiffness = 100.0 * s.stiffness
        return lambda x: Change(
            bushings=(
                (
                    damper,
                    {"type": "backlash", "stiffness": stiffness, "gap": x * s.travel},
                ),
            )
        )

    return shape


# --------------------------------------------------------------------------------------------- at a motor, a channel
def sensor_gain(r: Generator, s: Scale, channel: Any) -> Sized:
    sign = r.choice([-1.0, 1.0])
    return lambda x: Change(
        ({"type": "sensor_gain", "channel": channel, "gain": 1.0 + sign * min(x, 0.5)},)
    )


def sensor_delay(r: Generator, s: Scale, channel: Any) -> Sized:
    return lambda x: Change(
        (
            {
                "type": "sensor_delay",
                "channel": channel,
                "delay": 0.3 * min(x, 3.0) * s.time,
            },
        )
    )


def saturation(r: Generator, s: Scale, motor: Any) -> Sized:
    # `force` is the current's own scale at a motor
    return lambda x: Change(
        ({"type": "thrust_saturation", "element": motor, "current": s.force / x},)
    )


def lag(r: Generator, s: Scale, motor: Any) -> Sized:
    return lambda x: Change(
        ({"type": "actuator_lag", "element": motor, "time_constant": x * s.time},)
    )


# ------------------------------------------------------------------------------------- what the library does not have
def tanh_spring(r: Generator, s: Scale, place: Pair) -> Sized:
    """A spring that gives in altogether: far beyond where a cubic could follow it."""
    depth = r.uniform(0.25, 0.4)
    return lambda x: link(
        "x_tanh_less_linear",
        place,
        stiffness=min(x, 0.9) * s.stiffness,
        length=depth * s.travel,
    )


def switched_spring(r: Generator, s: Scale, place: Pair) -> Sized:
    period, duty = r.uniform(9.0, 23.0) * s.time, r.uniform(0.3, 0.6)
    return lambda x: link(
        "x_switched_stiffness",
        place,
        stiffness=x * s.stiffness,
        period=period,
        duty=duty,
    )


position_damping = fixed(
    "x_position_damping",
    lambda x, s: {"damping": x * s.damping, "length": s.travel},
)


def timed_friction(r: Generator, s: Scale, place: Pair) -> Sized:
    period, duty = r.uniform(9.0, 23.0) * s.time, r.uniform(0.3, 0.6)
    return lambda x: link(
        "x_timed_friction", place, level=2.0 * x * s.force, period=period, duty=duty
    )


def resonator(r: Generator, s: Scale, place: Pair) -> Sized:
    """A body on a spring that nobody drew: at `place[0]`, tuned near the rig's own rate."""
    w, zeta = r.uniform(0.8, 2.5) / s.time, r.uniform(0.02, 0.08)
    mass = s.damping * s.travel / s.rate

    def sized(x: float) -> Change:
        body = {"between": ["absorber", place[0]]}
        return Change(
            (
                {"type": "linear_stiffness", **body, "stiffness": x * mass * w**2},
                {"type": "linear_damping", **body, "damping": 2 * zeta * x * mass * w},
            ),
            masses=(("absorber", x * mass),),
        )

    return sized


def knocks(r: Generator, s: Scale, place: Pair) -> Sized:
    """Something hits the rig every now and then, and no channel tells when."""
    period, width = r.uniform(11.0, 27.0) * s.time, r.uniform(0.4, 1.0) * s.time
    return lambda x: link(
        "x_impulse", place, force=4.0 * x * s.force, period=period, width=width
    )


#: what a kind is called -> the effect's name and its shape
DEVICES = {
    "friction": ("coulomb_friction", coulomb),
    "stribeck": ("stribeck_friction", stribeck),
    "quadratic": ("quadratic_damping", quadratic),
    "asymmetric": ("asymmetric_damping", asymmetric),
    "cubic": ("cubic_stiffness", hardening),
    "gas": ("gas_spring", gas),
    "stop": ("bump_stop", stop),
    "hysteresis": ("hysteresis", hysteresis),
    "cogging": ("cogging_force", cogging),
    "softening": ("cubic_stiffness", softening),
    "inertance": ("inertance", inertance),
    "damping": ("linear_damping", linear_damping),
    "stiffness": ("linear_stiffness", linear_stiffness),
}


def devices(place: tuple[str, str], *names: str, suffix: str = "") -> dict[str, Hidden]:
    """Kinds of a family: each of `names` hidden at one place."""
    return {f"{n}{suffix}": at(*DEVICES[n], place) for n in names}
