"""What can be said of a test before it is done: of each effect, of one more sensor, and all of it as a file."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from ..files import write_text
from .result import _plain

if TYPE_CHECKING:
    from pathlib import Path

    from ..arrays import Array
    from ..network import Network
    from .problem import Record

SCHEMA = "isd-plan/1"


@dataclass(frozen=True)
class Amount:
    """A value and its unit."""

    value: float
    unit: str


@dataclass(frozen=True)
class Foreseen:
    """What a planned test could say of one hypothesis.

    effect, where (in the owner's words), options: the hypothesis. status: `named` (from `smallest` on), `confused` (with `confused_with`, at any
    size), `hidden` (the owner's parameters, refitted, make up for it), `unseen` (it moves no sensor), `untried` (it
    broke down). smallest: its values when it is just large enough to be named; share: what that is of the force,
    current or signal at its place. seen: its values when it is just noticed, though not named. varied: which values
    were scaled; the rest is its shape. limited_by: the gates that hold a smaller one back. near: rivals by how hard they
    are to tell from it: label and distance, in standard deviations of the noise, once refitted.
    """

    label: str
    effect: str
    where: tuple[str, ...]
    options: tuple[tuple[str, str], ...]
    status: str
    smallest: dict[str, Amount] = field(default_factory=dict)
    share: float | None = None
    seen: dict[str, Amount] = field(default_factory=dict)
    varied: tuple[str, ...] = ()
    limited_by: tuple[str, ...] = ()
    confused_with: tuple[str, ...] = ()
    near: tuple[tuple[str, float], ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """JSON types."""

        def amounts(of: dict[str, Amount]) -> dict[str, dict[str, Any]]:
            return {k: {"value": a.value, "unit": a.unit} for k, a in of.items()}

        return {
            "label": self.label,
            "effect": self.effect,
            "where": list(self.where),
            "options": dict(self.options),
            "status": self.status,
            "smallest": amounts(self.smallest),
            "share": self.share,
            "seen": amounts(self.seen),
            "varied": list(self.varied),
            "limited_by": list(self.limited_by),
            "confused_with": list(self.confused_with),
            "near": [{"rival": label, "sigma": d} for label, d in self.near],
        }


@dataclass(frozen=True)
class Sensor:
    """A sensor more: `told` of the hypotheses that could not be told from one another now could be, and by which factor
    (`factor`, median) what noise allows to tell would be smaller.

    name: of the channel; quantity: what it measures; where: the node, pair or elements at which it sits; noise: that was reckoned with, in `unit`.
    """

    name: str
    quantity: str
    where: str
    noise: float
    unit: str
    told: int
    factor: float

    def to_dict(self) -> dict[str, Any]:
        """JSON types."""
        return dict(self.__dict__)


@dataclass(frozen=True)
class Plan:
    """What a test could tell. `summary` says it; `to_dict` is `isd-plan/1`.

    network: the owner's model, with the noise reckoned with. effects: every hypothesis. matrix (effects, effects): distance, in standard
    deviations of the noise, of the row's effect at its smallest nameable size (of a twentieth of the force where it has none) from the
    closest that the column's comes when it and the model are refitted, to first order; the diagonal is that of the
    refitted model alone. sensors: what one more would bring. test: in words; excitation: as numbers, where it was not
    given as data. records: the inputs that were reckoned with. noise: of every output [its unit]. length [s], notes, seconds of work.
    """

    network: Network
    effects: tuple[Foreseen, ...]
    matrix: Array
    sensors: tuple[Sensor, ...]
    test: str
    excitation: dict[str, Any] | None
    records: tuple[Record, ...]
    noise: dict[str, float]
    length: float
    notes: tuple[str, ...] = ()
    seconds: float = 0.0

    def of(self, status: str) -> list[Foreseen]:
        """The hypotheses of one status."""
        return [e for e in self.effects if e.status == status]

    @property
    def summary(self) -> str:
        """In two sentences."""
        named = self.of("named")
        text = f"Of {len(self.effects)} hypotheses {len(named)} could be named"
        at_place = [e.share for e in named if e.share is not None and e.share < 1]
        if at_place:
            text += f", half of them from {np.median(at_place):.0%} of the force, current or signal at their place on"
        other = {"confused": "told from no rival", "hidden": "hidden in the parameters", "unseen": "unseen"}
        rest = [f"{len(self.of(k))} {what}" for k, what in other.items() if self.of(k)]
        text += f"; {', '.join(rest)}." if rest else "."
        best = self.sensors[0] if self.sensors else None
        if best is not None and (best.told or best.factor > 1.2):
            text += f" The sensor that would help most: {best.name} ({best.told} more told apart, others {best.factor:.1f} times smaller)."
        return text

    def to_dict(self) -> dict[str, Any]:
        """`isd-plan/1`."""
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
        """Write `to_dict` as JSON to `path`, whole or not at all."""
        write_text(path, json.dumps(self.to_dict(), indent=1, allow_nan=False) + "\n")
