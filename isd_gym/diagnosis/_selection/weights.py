"""Weights of the sets of the band, and the probability of a place, a kind and a law: the sum of the weights of the sets with it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from .free_force import Table

if TYPE_CHECKING:
    from collections.abc import Sequence

    from .candidate import Candidate
    from .candidate_comparison import CandidateComparison
    from .held_out_table import Row

#: word for a force whose law is not in the library
FREE_FORCE = "free_force"
#: weight of a table of a force beside the sets, none of which explains the records
OF_TABLE = 0.5


@dataclass(frozen=True)
class Statement:
    """Place, kind and law of one effect of a candidate."""

    #: terminals in alphabetical order, or the channel
    place: tuple[str, ...]
    kind: str
    law: str


@dataclass(frozen=True, eq=False)
class WeightedCandidate:
    """A candidate with its weight and its statements."""

    candidate: Candidate
    weight: float
    statements: frozenset[Statement]


def _statements_of_row(row: Row) -> frozenset[Statement]:
    """Return the statements of a set."""
    return frozenset(Statement(m.place, m.mechanism, m.effect) for m in row.members)


def _statements_of_table(candidate: Candidate) -> frozenset[Statement]:
    """Return the statement of a table of a force: a force of the distance alone is elastic, whatever its law."""
    structure = candidate.fit.structure
    assert isinstance(structure, Table)
    pair = structure.network.element(structure.element).between
    kind = "elastic" if structure.over == "elongation" else "other"
    return frozenset({Statement(tuple(sorted(pair)), kind, FREE_FORCE)})


def weigh_candidates(
    scores: CandidateComparison, table: Candidate | None = None
) -> tuple[WeightedCandidate, ...]:
    """Return the sets of the band with their weights, largest first; where no set is in the band, the best one beside a table."""
    answer = scores.answer
    rows = answer.band or ((answer.best,) if answer.best.members else ())
    weights = answer.weights or (1.0,) * len(rows)
    share = OF_TABLE if table is not None else 0.0
    found = [
        WeightedCandidate(scores.of(row), (1.0 - share) * w, _statements_of_row(row))
        for row, w in zip(rows, weights, strict=True)
    ]
    if table is not None:
        found.append(WeightedCandidate(table, share, _statements_of_table(table)))
    return tuple(sorted(found, key=lambda c: -c.weight))


def probability(candidates: Sequence[WeightedCandidate], **wanted: object) -> float:
    """Return the sum of the weights of the candidates with a statement whose fields have the wanted values."""
    return float(
        sum(
            c.weight
            for c in candidates
            if any(all(getattr(s, k) == v for k, v in wanted.items()) for s in c.statements)
        )
    )
