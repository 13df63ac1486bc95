"""The hidden part of a test rig."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

Array = NDArray[Any]
Model = dict[str, Any]
Element = dict[str, Any]

FINE = 1e-3
"""Interval at which the truth gets its inputs [s]; records keep every second sample."""
MAIN = {
    "linear_stiffness": "stiffness",
    "linear_damping": "damping",
    "inertance": "inertance",
    "coulomb_friction": "level",
}
"""The parameter of each type that the owner knows only roughly."""


@dataclass
class Secret:
    """Difference between the true network and the network of the owner."""

    add: list[Element] = field(default_factory=list)
    """What the owner lacks: elements side by side with what stands there, or at a motor or channel."""
    drop: list[str] = field(default_factory=list)
    """Base elements that the owner lacks."""
    series: list[Element] = field(default_factory=list)
    """Elements put in series with the base elements named in `into`."""
    replace: dict[str, Element] = field(default_factory=dict)
    """Base elements that are of another type in truth."""
    masses: dict[str, float] = field(default_factory=dict)
    unknown: bool = False
    level: float = 1.0
    """Strength of the excitation."""
    passive: bool = False


Draw = Callable[[Generator], Secret]
Pair = tuple[str, str]


def element(kind: str, first: str, second: str, **parameters: Any) -> Element:
    """Return an element between two terminals."""
    return {"type": kind, "between": [first, second], **parameters}


def add(kind: str, first: str, second: str, **parameters: Any) -> Secret:
    """Return a secret that adds an element between two terminals."""
    return Secret(add=[element(kind, first, second, **parameters)])


def drawn(r: Generator, parameters: dict[str, Any]) -> dict[str, Any]:
    """Return parameters with a value from each range (low, high), drawn in order."""
    return {
        name: r.uniform(*value) if isinstance(value, tuple) else value
        for name, value in parameters.items()
    }


def effect(kind: str, place: Pair, *, unknown: bool = False, **ranges: Any) -> Draw:
    """Return a kind that adds an element between two terminals."""
    return lambda r: Secret(
        add=[element(kind, *place, **drawn(r, ranges))], unknown=unknown
    )


def fault(kind: str, **ranges: Any) -> Draw:
    """Return a kind that adds an effect of the motor, or of the channel among its parameters."""
    place = {} if "channel" in ranges else {"element": "motor"}
    return lambda r: Secret(add=[{"type": kind, **place, **drawn(r, ranges)}])


def sensor_gain(channel: str, low: float, high: float) -> Draw:
    """Return a kind whose sensor reads too much or too little by a share between two limits."""

    def draw(r: Generator) -> Secret:
        gain = 1 + r.choice([-1, 1]) * r.uniform(low, high)
        return Secret(add=[{"type": "sensor_gain", "channel": channel, "gain": gain}])

    return draw


def replaced(name: str, kind: str, **ranges: Any) -> Draw:
    """Return a kind in which an element of the base is of another type."""
    return lambda r: Secret(replace={name: {"type": kind, **drawn(r, ranges)}})


def in_series(name: str, kind: str, **ranges: Any) -> Draw:
    """Return a kind that puts an element in series with an element of the base."""
    return lambda r: Secret(series=[{"type": kind, **drawn(r, ranges), "into": [name]}])


def fading(name: str, place: Pair, damping: float, energy: tuple[float, float]) -> Draw:
    """Return a kind whose damper thins with the work [J] that it has done."""
    return lambda r: Secret(
        add=[
            element(
                "x_fading_damping", *place, damping=damping, energy=r.uniform(*energy)
            )
        ],
        replace={name: {"type": "linear_damping", "damping": 1.0}},
        unknown=True,
    )


def both(*secrets: Secret) -> Secret:
    """Return the sum of secrets."""
    total = Secret(level=max(s.level for s in secrets))
    for s in secrets:
        total.add += s.add
        total.drop += s.drop
        total.series += s.series
        total.replace |= s.replace
    return total


def absorber(
    at: str, masses: tuple[float, float], frequencies: tuple[float, float]
) -> Draw:
    """Return a kind with a second body on a spring: a mode that no element between known nodes can make."""

    def draw(r: Generator) -> Secret:
        mass, w = r.uniform(*masses), 2 * np.pi * r.uniform(*frequencies)
        ends = ("hidden_mass", at)
        damping = 2 * r.uniform(0.03, 0.08) * mass * w
        return Secret(
            add=[
                element(
                    "linear_stiffness",
                    *ends,
                    stiffness=mass * w**2,
                    name="hidden_spring",
                ),
                element("linear_damping", *ends, damping=damping, name="hidden_damper"),
            ],
            masses={"hidden_mass": mass},
            unknown=True,
        )

    return draw


def relaxation(
    place: Pair, stiffnesses: tuple[float, float], times: tuple[float, float]
) -> Draw:
    """Return a kind with a Maxwell branch: spring and damper in series over a node that the owner does not have."""

    def draw(r: Generator) -> Secret:
        stiffness, time = r.uniform(*stiffnesses), r.uniform(*times)
        first, second = place
        return Secret(
            add=[
                element(
                    "linear_stiffness",
                    first,
                    "hidden_node",
                    stiffness=stiffness,
                    name="hidden_spring",
                ),
                element(
                    "linear_damping",
                    "hidden_node",
                    second,
                    damping=stiffness * time,
                    name="hidden_damper",
                ),
            ],
            unknown=True,
        )

    return draw


def band_noise(
    r: Generator, size: int, low: float, high: float, slope: float = 0.0
) -> Array:
    """Gaussian noise of unit RMS between two frequencies [Hz], its amplitude as frequency**-slope."""
    f = np.fft.rfftfreq(2 * size, FINE)
    with np.errstate(divide="ignore"):
        shape = np.where(f > 0, f**-slope, 0.0) / (1 + (f / high) ** 8)
        shape[1:] /= 1 + (low / f[1:]) ** 4
    noise = np.fft.irfft(np.fft.rfft(r.standard_normal(2 * size)) * shape)[:size]
    return np.asarray(noise / np.sqrt(np.mean(noise**2)))
