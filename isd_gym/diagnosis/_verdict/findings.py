"""Findings: probabilities of place, kind and law of a missing effect."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from .._estimation.structure import parameter_values
from .._selection.uncertainty import Quantity
from .._selection.weights import FREE_FORCE, Statement, probability
from .gates import NAMELESS
from .grades import MISTAKEN, REPORTED, grade, share_mistaken

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from .._selection.criteria import Criteria
    from .._selection.weights import WeightedSet
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


@dataclass(frozen=True)
class Finder:
    """Sums of weights of sets as probabilities of places, kinds and laws, less the share of such statements that are wrong."""

    criteria: Criteria
    sets: Sequence[WeightedSet]
    evidence: Evidence
    #: parameters of the first set with intervals, by path
    quantities: Mapping[str, Quantity]
    #: statements that are named
    named: frozenset[Statement]
    #: whether no set is needed, or a controller may imitate a law
    is_doubted: bool

    def find(self) -> tuple[Finding, ...]:
        """Return the findings, named ones first, then by the probability of the kind. A kind that is certain at none of several places has
        an open place."""
        every = self._laws()
        found = []
        for (place, kind), laws in every.items():
            if probability(self.sets, place=place, kind=kind) >= REPORTED:
                found.append(self._finding(place, kind, laws))
        for kind in sorted({f.kind for f in found} - set(NAMELESS)):
            if self._is_place_open(kind, [f for f in found if f.kind == kind]):
                laws = {}
                for (_, other), of_place in every.items():
                    if other == kind:
                        laws |= of_place
                found.append(replace(self._finding((), kind, laws), named=False))
        return tuple(
            sorted(
                found, key=lambda f: (not f.named, -f.kind_probability, f.place, f.kind)
            )
        )

    def _laws(self) -> dict[tuple[tuple[str, ...], str], dict[str, Statement]]:
        """Return the statements of all sets by place and kind, then by law."""
        every: dict[tuple[tuple[str, ...], str], dict[str, Statement]] = {}
        for one in self.sets:
            for s in sorted(one.statements, key=lambda s: (s.place, s.kind, s.law)):
                every.setdefault((s.place, s.kind), {})[s.law] = s
        return every

    def _is_place_open(self, kind: str, found: Sequence[Finding]) -> bool:
        """Return whether a kind is found at several places and certain at none of them."""
        whole = probability(self.sets, kind=kind)
        for f in found:
            at_place = probability(self.sets, place=f.place, kind=kind)
            if f.named or at_place >= self.criteria.certain * whole:
                return False
        return len(found) > 1

    def _finding(
        self, place: tuple[str, ...], kind: str, laws: Mapping[str, Statement]
    ) -> Finding:
        """Return the finding of a kind at a place, or at any place where `place` is empty."""
        where: dict[str, object] = (
            {"kind": kind, "place": place} if place else {"kind": kind}
        )
        of_kind = probability(self.sets, **where) * (
            1.0 - self._mistaken("kind", kind, laws)
        )
        of_place = of_kind
        if place:
            of_place = probability(self.sets, place=place) * (
                1.0 - self._mistaken("place", kind, laws)
            )
        entries = []
        for law, statement in laws.items():
            own = probability(self.sets, **where, law=law) * (
                1.0 - self._mistaken("law", kind, laws)
            )
            entries.append(
                LawProbability(law, own, self._values(statement) if place else {})
            )
        ranked = tuple(sorted(entries, key=lambda e: (-e.probability, e.effect)))
        return Finding(
            place,
            of_place,
            kind,
            of_kind,
            ranked,
            any(s in self.named for s in laws.values()),
        )

    def _mistaken(self, level: str, kind: str, laws: Mapping[str, Statement]) -> float:
        """Return the share of statements of a level that are wrong. The free force stands for laws outside the library."""
        if FREE_FORCE in laws:
            return MISTAKEN["free" if kind in NAMELESS and level != "place" else "kind"]
        usual = share_mistaken(level, self.evidence, self.criteria)
        return (
            max(usual, MISTAKEN["extra"])
            if self.is_doubted and level != "place"
            else usual
        )

    def _values(self, statement: Statement) -> dict[str, Quantity]:
        """Return the values of a law in the likeliest set with the statement; the foremost set has intervals."""
        fit = next(s.fit for s in self.sets if statement in s.statements)
        for h, element in zip(fit.hypotheses, fit.elements, strict=True):
            if h.effect != statement.law:
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
