"""Conditions for a name, with the figures that decide."""

from __future__ import annotations

import operator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

from .criteria import CRITERIA, Criteria

if TYPE_CHECKING:
    from collections.abc import Callable

#: comparison of the value of a gate with its limit
Relation = Literal["<", "<=", ">", ">="]
COMPARE: dict[Relation, Callable[[float, float], bool]] = {
    "<": operator.lt, "<=": operator.le, ">": operator.gt, ">=": operator.ge,
}  # fmt: skip
#: largest magnitude of a gate's value: an infinite one is stated as this
MAX_GATE_VALUE = 1e6


@dataclass(frozen=True)
class Gate:
    """One condition for a name."""

    name: str
    #: truth of ``value relation limit``
    passed: bool
    value: float
    limit: float
    #: meaning of the value
    text: str
    relation: Relation = ">"

    def to_dict(self) -> dict[str, Any]:
        """As the JSON of a diagnosis has it."""
        return {"gate": self.name} | {
            k: getattr(self, k)
            for k in ("passed", "value", "relation", "limit", "text")
        }


def gate(name: str, value: float, relation: Relation, limit: float, text: str) -> Gate:
    """Return a gate that passes if ``value relation limit`` is true. Infinite values become `MAX_GATE_VALUE`."""
    value = min(max(float(value), -MAX_GATE_VALUE), MAX_GATE_VALUE)
    return Gate(
        name, COMPARE[relation](value, limit), value, float(limit), text, relation
    )


def table_gates(
    explained: float,
    moved: float,
    errors: float,
    confirmed: float,
    c: Criteria = CRITERIA,
) -> tuple[Gate, ...]:
    """Return the conditions for a table of a force, by explained fraction, error reduction, standard errors of the gain and explained
    fraction of the test records."""
    removed = "share of the squared error beyond noise removed on"
    moves = "largest share of a channel's standard deviation by which the error falls"
    density = "standard errors by which the log predictive density exceeds the refitted model's"
    return (
        gate(
            "explains",
            explained,
            ">=",
            c.least_removed,
            f"{removed} the validation records",
        ),
        gate("material", moved, ">=", c.material, moves),
        gate("predicts better", errors, ">", c.elpd_errors, density),
        gate(
            "confirmed", confirmed, ">=", c.least_removed, f"{removed} the test records"
        ),
    )
