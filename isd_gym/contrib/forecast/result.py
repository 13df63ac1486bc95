"""Results of a plan: forecasts for all effects, gains by additional sensors, JSON document."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from isd_gym._common.files import write_text
from isd_gym.diagnosis.result import _plain

if TYPE_CHECKING:
    from pathlib import Path

    from isd_gym._common.arrays import Array
    from isd_gym.diagnosis._simulation.problem import Record
    from isd_gym.physics.network import Network

#: function that receives the stage and the finished share

SCHEMA = "isd-plan/1"
#: status of an effect, in words
STATUS = {
    "named": "named",
    "confused": "not distinguishable from a rival at any size",
    "hidden": "hidden: refitted parameters have the same effect",
    "unseen": "not visible in any sensor",
    "untried": "the simulation failed",
}


@dataclass(frozen=True)
class Amount:
    """A value with its unit."""

    value: float
    unit: str


@dataclass(frozen=True)
class EffectForecast:
    """Predicted result of a diagnosis for one hypothesis."""

    label: str  # effect and place
    effect: str  # type of the element
    where: tuple[str, ...]  # nodes, motor or channel of the owner's model
    options: tuple[tuple[str, str], ...]  # non-numeric choices of the hypothesis
    #: `named` (from `smallest` on), `confused` (with a rival at any size), `hidden` (by refitted parameters),
    #: `unseen` (by the sensors) or `untried` (the simulation failed)
    status: str
    smallest: dict[str, Amount] = field(default_factory=dict)  # values at the smallest size that is named
    share: float | None = None  # of force, current or signal at the place, at that size
    seen: dict[str, Amount] = field(default_factory=dict)  # values at the smallest size that is significant
    varied: tuple[str, ...] = ()  # parameters that scale with the size; the rest is the shape
    limited_by: tuple[str, ...] = ()  # gates that a smaller size does not pass
    confused_with: tuple[str, ...] = ()  # labels of rivals
    #: label and distance [standard deviations of the noise] of refitted rivals, closest first
    near: tuple[tuple[str, float], ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """Return the forecast as JSON types."""
        near = [{"rival": label, "sigma": distance} for label, distance in self.near]
        return _plain({**asdict(self), "options": dict(self.options), "near": near})


@dataclass(frozen=True)
class SensorGain:
    """Gain by one additional sensor."""

    name: str  # of the channel
    quantity: str  # measured quantity
    where: str  # node, pair or elements
    noise: float  # assumed RMS noise [unit]
    unit: str  # of the noise
    told: int  # hypotheses that only the additional sensor makes distinguishable
    factor: float  # median factor by which the smallest distinguishable size falls

    def to_dict(self) -> dict[str, Any]:
        """Return the gain as JSON types."""
        return asdict(self)


@dataclass(frozen=True)
class Plan:
    """Predicted result of a diagnosis after a planned test."""

    network: Network  # the owner's model with the assumed noise
    effects: tuple[EffectForecast, ...]  # one per hypothesis
    #: distance [standard deviations of the noise] (effects, effects) of the row's effect at its smallest nameable
    #: size from the refitted rival of the column, linearised; on the diagonal from the refitted model
    matrix: Array
    sensors: tuple[SensorGain, ...]  # best first
    test: str  # in words
    excitation: dict[str, Any] | None  # None if the test is given as records
    records: tuple[Record, ...]  # inputs of the test
    noise: dict[str, float]  # RMS noise by output [unit of the output]
    length: float  # of the test [s]
    notes: tuple[str, ...] = ()  # assumptions
    seconds: float = 0.0  # computing time [s]

    def with_status(self, status: str) -> list[EffectForecast]:
        """Return the effects with one status."""
        return [e for e in self.effects if e.status == status]

    @property
    def summary(self) -> str:
        """The plan in a few sentences."""
        named = self.with_status("named")
        text = f"A diagnosis could name {len(named)} of {len(self.effects)} hypotheses."
        shares = [e.share for e in named if e.share is not None and e.share < 1]
        if shares:
            text += f" The median of the smallest sizes is {100 * np.median(shares):.0f} % of the force, current or signal at the place."
        words = {
            "confused": "not distinguishable from a rival",
            "hidden": "hidden by refitted parameters",
            "unseen": "not visible in any sensor",
        }
        rest = [f"{n} {word}" for k, word in words.items() if (n := len(self.with_status(k)))]
        text += f" The others: {', '.join(rest)}." if rest else ""
        best = self.sensors[0] if self.sensors else None
        if best is not None and (best.told or best.factor > 1.2):
            text += f" The most useful additional sensor is {best.name}: {best.told} more hypotheses become distinguishable, the others at sizes smaller by a factor of {best.factor:.1f}."
        return text

    def to_dict(self) -> dict[str, Any]:
        """Return the plan as an `isd-plan/1` document."""
        return _plain(
            {
                "schema": SCHEMA,
                "summary": self.summary,
                "model": self.network.name,
                "test": self.test,
                "excitation": self.excitation,
                "length": self.length,
                "noise": self.noise,
                "effects": [e.to_dict() for e in self.effects],
                "matrix": self.matrix.tolist(),
                "sensors": [s.to_dict() for s in self.sensors],
                "notes": list(self.notes),
            }
        )

    def save(self, path: str | Path) -> None:
        """Write the plan as a JSON file.

        Args:
            path: Path of the file.
        """
        write_text(path, json.dumps(self.to_dict(), indent=1, allow_nan=False) + "\n")
