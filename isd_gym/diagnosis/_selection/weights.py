"""Weights of the sets of the band, and the probability of a place, a kind and a law: the sum of the weights of the sets with it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from .free_force import Table

if TYPE_CHECKING:
    from collections.abc import Sequence

    from .._estimation.gauss_newton import Fit
    from .answer import Answer

#: word for a force whose law is not in the library
FREE_FORCE = "free_force"
#: weight of a table of a force beside the best set, where no set explains the records
OF_TABLE = 0.5


@dataclass(frozen=True)
class Statement:
    """Place, kind and law of one effect of a set."""

    #: terminals in alphabetical order, or the channel
    place: tuple[str, ...]
    kind: str
    law: str


@dataclass(frozen=True, eq=False)
class WeightedSet:
    """A fitted set with its weight and its statements."""

    fit: Fit
    weight: float
    statements: frozenset[Statement]


def _statement_of_table(fit: Fit) -> Statement:
    """Return the statement of a table of a force: a force of the distance alone is elastic, whatever its law."""
    structure = fit.structure
    assert isinstance(structure, Table)
    kind = "elastic" if structure.over == "elongation" else "other"
    return Statement(tuple(sorted(structure.pair)), kind, FREE_FORCE)


def weigh(answer: Answer, table: Fit | None = None) -> tuple[WeightedSet, ...]:
    """Return the sets of the band with their weights, largest first; where no set is in the band, the best one beside a table."""
    rows = answer.band or ((answer.best,) if answer.best.members else ())
    weights = answer.weights or (1.0,) * len(rows)
    share = OF_TABLE if table is not None else 0.0
    found = []
    for row, weight in zip(rows, weights, strict=True):
        own = frozenset(Statement(m.place, m.mechanism, m.effect) for m in row.members)
        found.append(WeightedSet(row.fit, (1.0 - share) * weight, own))
    if table is not None:
        found.append(WeightedSet(table, share, frozenset({_statement_of_table(table)})))
    return tuple(sorted(found, key=lambda s: -s.weight))


def probability(sets: Sequence[WeightedSet], **wanted: object) -> float:
    """Return the sum of the weights of the sets with a statement whose fields have the wanted values."""
    total = 0.0
    for s in sets:
        if any(
            all(getattr(x, k) == v for k, v in wanted.items()) for x in s.statements
        ):
            total += s.weight
    return total
