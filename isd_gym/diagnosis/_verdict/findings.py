"""Findings: probabilities of place, kind and law of a missing effect."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from .._estimation.structure import parameter_values
from .._selection.uncertainty import Quantity
from .grades import MISTAKEN, REPORTED, grade, share_mistaken

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from .._selection.answer import Answer
    from .._selection.criteria import Criteria
    from .._selection.held_out_table import Member, Row
    from .evidence import Evidence


@dataclass(frozen=True)
class LawProbability:
    """A law of a finding with its probability, and its values in the foremost set or else in the likeliest that contains the law."""

    effect: str
    probability: float
    parameters: Mapping[str, Quantity]

    def to_dict(self) -> dict[str, Any]:
        """Return the entry of the JSON file."""
        return vars(self) | {"grade": grade(self.probability)}


@dataclass(frozen=True)
class Finding:
    """A place, a kind of effect and the laws of that kind, with probabilities."""

    #: terminals, or the channel; empty where a kind is likely and its place is open
    place: tuple[str, ...]
    #: probability of the place; that of the kind where the place is open
    place_probability: float
    kind: str
    kind_probability: float
    #: largest probability first
    laws: tuple[LawProbability, ...]
    #: whether a law of the finding is among the named effects
    named: bool = False
    #: files of the completed models of the sets of laws with the kind at the place
    sets: tuple[str, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """Return the entry of the JSON file."""
        levels = {
            "place": grade(self.place_probability),
            "kind": grade(self.kind_probability),
        }
        return vars(self) | {"grade": levels}


def weighted_sets(answer: Answer) -> list[tuple[Row, float]]:
    """Return the sets of the band with their weights, largest first; the best set where no set is in the band."""
    rows = answer.band or ((answer.best,) if answer.best.members else ())
    weights = answer.weights or (1.0,) * len(rows)
    return sorted(zip(rows, weights, strict=True), key=lambda s: -s[1])


def probability(sets: Sequence[tuple[Row, float]], **wanted: object) -> float:
    """Return the sum of the weights of the sets with a member whose attributes have the wanted values."""
    total = 0.0
    for row, weight in sets:
        if any(all(getattr(m, k) == v for k, v in wanted.items()) for m in row.members):
            total += weight
    return total


@dataclass(frozen=True)
class Finder:
    """Sums of weights of sets as probabilities of places, kinds and laws, less the share of such statements that are wrong."""

    criteria: Criteria
    #: sets with their weights, largest first
    sets: Sequence[tuple[Row, float]]
    evidence: Evidence
    #: parameters of the first set with intervals, by path
    quantities: Mapping[str, Quantity]
    #: members that are named
    named: frozenset[Member]
    #: whether no set is needed, or a controller may imitate a law
    is_doubted: bool

    def find(self) -> tuple[Finding, ...]:
        """Return the findings, named ones first, then by the probability of the kind. A kind that is certain at none of several places has
        an open place."""
        every = self._laws()
        found = []
        for (kind, place), laws in every.items():
            if probability(self.sets, kind=(kind, place)) >= REPORTED:
                found.append(self._finding(place, kind, laws))
        for kind in sorted({f.kind for f in found}):
            if self._is_place_open(kind, [f for f in found if f.kind == kind]):
                laws = {}
                for (other, _), of_place in every.items():
                    if other == kind:
                        laws |= of_place
                found.append(replace(self._finding((), kind, laws), named=False))
        return tuple(
            sorted(
                found, key=lambda f: (not f.named, -f.kind_probability, f.place, f.kind)
            )
        )

    def _laws(self) -> dict[tuple[str, tuple[str, ...]], dict[str, Member]]:
        """Return the members of all sets by kind and place, then by law."""
        every: dict[tuple[str, tuple[str, ...]], dict[str, Member]] = {}
        for row, _ in self.sets:
            for m in sorted(row.members, key=lambda m: (m.place, m.kind, m.effect)):
                every.setdefault(m.kind, {})[m.effect] = m
        return every

    def _is_place_open(self, kind: str, found: Sequence[Finding]) -> bool:
        """Return whether a kind is found at several places and certain at none of them."""
        whole = probability(self.sets, mechanism=kind)
        for f in found:
            at_place = probability(self.sets, kind=(kind, f.place))
            if f.named or at_place >= self.criteria.certain * whole:
                return False
        return len(found) > 1

    def _finding(
        self, place: tuple[str, ...], kind: str, laws: Mapping[str, Member]
    ) -> Finding:
        """Return the finding of a kind at a place, or at any place where `place` is empty."""
        where: dict[str, object] = {"kind": (kind, place)}
        if not place:
            where = {"mechanism": kind}
        of_place = of_kind = probability(self.sets, **where) * self._right("kind")
        if place:
            of_place = probability(self.sets, place=place) * self._right("place")
        entries = []
        for law, member in laws.items():
            own = probability(self.sets, **where, effect=law) * self._right("law")
            values = self._values(member) if place else {}
            entries.append(LawProbability(law, own, values))
        ranked = tuple(sorted(entries, key=lambda e: (-e.probability, e.effect)))
        is_named = any(m in self.named for m in laws.values())
        return Finding(place, of_place, kind, of_kind, ranked, is_named)

    def _right(self, level: str) -> float:
        """Return the share of statements of a level that are right."""
        mistaken = share_mistaken(level, self.evidence, self.criteria)
        if self.is_doubted and level != "place":
            mistaken = max(mistaken, MISTAKEN["extra"])
        return 1.0 - mistaken

    def _values(self, member: Member) -> dict[str, Quantity]:
        """Return the values of a law in the likeliest set with the member; the foremost set has intervals."""
        fit = next(row.fit for row, _ in self.sets if member in row.members)
        for h, element in zip(fit.hypotheses, fit.elements, strict=True):
            if h.effect != member.effect:
                continue
            out = {}
            for key, value in parameter_values(element).items():
                path = f"{element.name}.{key}"
                known = self.quantities.get(path)
                is_own = known is not None and known.value == value
                unknown = Quantity(
                    value, float("nan"), float("nan"), fit.network.unit_of(path)
                )
                out[key] = known if known is not None and is_own else unknown
            return out
        return {}
