"""What a kind hides, and the case that comes of it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from numpy.random import Generator

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


@dataclass(frozen=True)
class Case:
    """One rig: what its owner has, and what was hidden."""

    kind: str
    seed: int
    model: Model
    """`isd-model/1`, as its owner believes it."""
    estimation: dict[str, Array]
    validation: dict[str, Array]
    answer: list[list[Any]] | str
    """Pairs of an effect's name and its terminals, or channel, or None where several places are the same;
    "unknown"; or empty where nothing is hidden. As in the shared blind rigs' `truth.json`."""
    truth: dict[str, Any]
    """`model`: the true network; `hidden`, `nuisances`: what of it the owner does not know."""
    snr_db: float
    spread: float
    visibility: dict[str, float]
    """RMS change of each channel that the hidden effect makes, in standard deviations of the noise."""

    @property
    def name(self) -> str:
        return f"{self.kind}_{self.seed:03d}"

    def record(self) -> dict[str, Any]:
        """The case's entry of a `truth.json`."""
        return {
            "kind": self.kind,
            "answer": self.answer,
            "truth": {
                "hidden": self.truth["hidden"],
                "nuisances": self.truth["nuisances"],
            },
            "snr_db": self.snr_db,
            "spread": self.spread,
            "visibility": [round(v, 2) for v in self.visibility.values()],
        }


@dataclass
class Secret:
    """What a kind hides: how the truth differs from the owner's network."""

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


def element(kind: str, first: str, second: str, **parameters: Any) -> Element:
    return {"type": kind, "between": [first, second], **parameters}


def add(kind: str, first: str, second: str, **parameters: float | str) -> Secret:
    return Secret(add=[{"type": kind, "between": [first, second], **parameters}])


def motor(kind: str, **parameters: float) -> Secret:
    return Secret(add=[{"type": kind, "element": "motor", **parameters}])


def sensor(kind: str, channel: str, **parameters: float) -> Secret:
    return Secret(add=[{"type": kind, "channel": channel, **parameters}])


def both(*secrets: Secret) -> Secret:
    total = Secret(level=max(s.level for s in secrets))
    for s in secrets:
        total.add += s.add
        total.drop += s.drop
        total.series += s.series
        total.replace |= s.replace
    return total


def absorber(r: Generator, at: str, mass: float, frequency: float) -> Secret:
    """A second body on a spring: a mode that no element between known nodes can make."""
    w = 2 * np.pi * frequency
    return Secret(
        add=[
            element(
                "linear_stiffness",
                "hidden_mass",
                at,
                stiffness=mass * w**2,
                name="hidden_spring",
            ),
            element(
                "linear_damping",
                "hidden_mass",
                at,
                damping=2 * r.uniform(0.03, 0.08) * mass * w,
                name="hidden_damper",
            ),
        ],
        masses={"hidden_mass": mass},
        unknown=True,
    )


def relaxation(
    r: Generator, first: str, second: str, stiffness: float, time: float
) -> Secret:
    """A Maxwell branch: spring and damper in series over a node that the owner does not have."""
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


def strange(kind: str, first: str, second: str, **parameters: float) -> Secret:
    secret = add(kind, first, second, **parameters)
    secret.unknown = True
    return secret


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
