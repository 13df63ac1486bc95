"""Findings: probabilities of place, kind and law of a missing effect."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from ...physics.elements import TYPES
from .._selection.candidate import parameter_values
from .._selection.weights import FREE_FORCE, Statement, probability
from ..result import Quantity
from .gates import NAMELESS
from .grades import MISTAKEN, REPORTED, grade, share_mistaken

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from .._selection.criteria import Criteria
    from .._selection.law_sets import Search
    from .._selection.weights import WeightedCandidate
    from ..result import LawSet
    from .evidence import Evidence


@dataclass(frozen=True)
class LawProbability:
    """A law of a finding with its probability, and its values in the foremost candidate or else in the likeliest that contains the law."""

    effect: str
    probability: float
    parameters: Mapping[str, Quantity]

    def to_dict(self) -> dict[str, Any]:
        """Return the entry of the JSON file."""
        return {
            "effect": self.effect,
            "probability": self.probability,
            "grade": grade(self.probability),
            "parameters": {k: q.to_dict() for k, q in self.parameters.items()},
        }


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
    #: sets of laws with the kind at the place
    sets: tuple[LawSet, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """Return the entry of the JSON file."""
        levels = {"place": grade(self.place_probability), "kind": grade(self.kind_probability)}
        head = {k: v for k, v in vars(self).items() if k not in ("laws", "named", "sets")}
        lists = {"laws": [x.to_dict() for x in self.laws], "sets": [x.to_dict() for x in self.sets]}
        return head | {"grade": levels, "named": self.named} | lists


def find(
    search: Search,
    candidates: Sequence[WeightedCandidate],
    evidence: Evidence,
    quantities: Mapping[str, Quantity],
    own: frozenset[Statement],
    *,
    is_named: bool,
    is_doubted: bool,
) -> tuple[Finding, ...]:
    """Return findings, largest probability of the kind first.

    Args:
        search: The search, for its criteria.
        candidates: Candidates with weights.
        evidence: Evidence for the foremost candidate.
        quantities: Parameters with intervals, by path.
        own: Statements of the foremost candidate.
        is_named: Whether its effects are named.
        is_doubted: Whether a free curve or a controller explains its force.
    """
    return _Finder(search.criteria, candidates, evidence, quantities, own, is_named, is_doubted).find()


@dataclass(frozen=True)
class _Finder:
    """Sums of weights of candidates as probabilities of places, kinds and laws, less the share of such statements that are wrong."""

    criteria: Criteria
    candidates: Sequence[WeightedCandidate]
    evidence: Evidence
    quantities: Mapping[str, Quantity]
    own: frozenset[Statement]
    is_named: bool
    is_doubted: bool

    def find(self) -> tuple[Finding, ...]:
        """Return the findings. A kind that is certain at none of several places has an open place."""
        every = self._laws()
        found = []
        for (place, kind), laws in every.items():
            if probability(self.candidates, place=place, kind=kind) >= REPORTED:
                found.append(self._finding(place, kind, laws))
        for kind in sorted({f.kind for f in found} - set(NAMELESS)):
            if self._is_place_open(kind, [f for f in found if f.kind == kind]):
                laws = {}
                for (_, other), of_place in every.items():
                    if other == kind:
                        laws |= of_place
                found.append(replace(self._finding((), kind, laws), named=False))
        return tuple(sorted(found, key=lambda f: (not f.named, -f.kind_probability, f.place, f.kind)))

    def _laws(self) -> dict[tuple[tuple[str, ...], str], dict[str, Statement]]:
        """Return the statements of all candidates by place and kind, then by law."""
        every: dict[tuple[tuple[str, ...], str], dict[str, Statement]] = {}
        for candidate in self.candidates:
            for s in sorted(candidate.statements, key=lambda s: (s.place, s.kind, s.law)):
                every.setdefault((s.place, s.kind), {})[s.law] = s
        return every

    def _is_place_open(self, kind: str, found: Sequence[Finding]) -> bool:
        """Return whether a kind is found at several places and certain at none of them."""
        whole = probability(self.candidates, kind=kind)
        for f in found:
            at_place = probability(self.candidates, place=f.place, kind=kind)
            if f.named or at_place >= self.criteria.certain * whole:
                return False
        return len(found) > 1

    def _finding(self, place: tuple[str, ...], kind: str, laws: Mapping[str, Statement]) -> Finding:
        """Return the finding of a kind at a place, or at any place where `place` is empty."""
        of_kind = probability(self.candidates, **_where(place, kind)) * (
            1.0 - self._mistaken(place, kind, laws)
        )
        entries = []
        for law, statement in laws.items():
            values = self._values(statement) if place else {}
            entries.append(LawProbability(law, self._of_law(place, kind, laws, law), values))
        return Finding(
            place,
            self._of_place(place) if place else of_kind,
            kind,
            of_kind,
            tuple(sorted(entries, key=lambda e: (-e.probability, e.effect))),
            self.is_named and any(s in self.own for s in laws.values()),
        )

    def _share(self, level: str, *, is_sum: bool = False) -> float:
        """Return the share of statements of a level that are wrong."""
        return share_mistaken(level, self.evidence, self.criteria, is_named=self.is_named, is_sum=is_sum)

    def _own_here(self, place: tuple[str, ...], kind: str) -> set[Statement]:
        """Return the statements of the foremost candidate about a kind at a place."""
        return {s for s in self.own if s.kind == kind and place in (s.place, ())}

    def _doubt(self, place: tuple[str, ...], kind: str) -> float:
        """Return the share of kinds that are wrong where the foremost candidate, if it passed, does not have the kind."""
        has_passed = bool(self._own_here(place, kind)) and not self.is_doubted
        return 0.0 if has_passed else MISTAKEN["extra"]

    def _mistaken(self, place: tuple[str, ...], kind: str, laws: Mapping[str, Statement]) -> float:
        """Return the share of such kinds that are wrong. The free force stands for laws outside the library."""
        if FREE_FORCE in laws:
            return MISTAKEN["free" if kind in NAMELESS else "kind"]
        return max(self._doubt(place, kind), self._share("kind"))

    def _of_place(self, place: tuple[str, ...]) -> float:
        """Return the probability of a place, less where it belongs to an effect beside the foremost candidate's that did not pass the
        inclusion test."""
        whole = probability(self.candidates, place=place)
        if self._has_free_force(place):
            return whole * (1.0 - MISTAKEN["place"])
        own_places = {s.place for s in self.own}
        beside = [
            w
            for w in self.candidates
            if place not in own_places and own_places & {s.place for s in w.statements}
        ]
        further = probability(beside, place=place)
        return _less(whole, further, self._share("place"))

    def _has_free_force(self, place: tuple[str, ...]) -> bool:
        return any(s.place == place and s.law == FREE_FORCE for w in self.candidates for s in w.statements)

    def _of_law(self, place: tuple[str, ...], kind: str, laws: Mapping[str, Statement], law: str) -> float:
        """Return the probability of a law, less where it stands beside a law of the foremost candidate without passing the inclusion
        test."""
        where, own_here = _where(place, kind), self._own_here(place, kind)
        whole = probability(self.candidates, **where, law=law)
        is_own = any(s.law == law for s in own_here)
        beside = [] if is_own else [w for w in self.candidates if own_here & w.statements]
        further = probability(beside, **where, law=law)
        is_sum = law in TYPES and TYPES[law].is_sum()
        usual = self._mistaken(place, kind, laws) if FREE_FORCE in laws else self._doubt(place, kind)
        return _less(whole, further, max(usual, self._share("law", is_sum=is_sum)))

    def _values(self, statement: Statement) -> dict[str, Quantity]:
        """Return the values of a law in the foremost candidate, or else in the likeliest that contains the law."""
        foremost_first = sorted(self.candidates, key=lambda w: w.statements != self.own)
        return _values(foremost_first, statement, self.quantities)


def _where(place: tuple[str, ...], kind: str) -> dict[str, object]:
    """Return the wanted fields of statements about a kind at a place, or at any place where `place` is empty."""
    return {"kind": kind, "place": place} if place else {"kind": kind}


def _less(whole: float, further: float, wrong: float) -> float:
    """Return the probability of statements, of which a `further` part did not pass the inclusion test, less the share that is wrong."""
    return (whole - further) * (1.0 - wrong) + further * (1.0 - max(MISTAKEN["extra"], wrong))


def _values(
    candidates: Sequence[WeightedCandidate], statement: Statement, quantities: Mapping[str, Quantity]
) -> dict[str, Quantity]:
    """Return the values of a law in the first candidate with the statement; without an interval if it is not the foremost."""
    for w in candidates:
        if statement not in w.statements:
            continue
        structure = w.candidate.fit.structure
        for h, name, element in zip(structure.hypotheses, structure.names, w.candidate.elements, strict=True):
            if h.effect != statement.law:
                continue
            network, out = w.candidate.fit.network, {}
            for key, value in parameter_values(element).items():
                path = f"{name}.{key}"
                known = quantities.get(path)
                if known is not None and known.value == value:
                    out[key] = known
                else:
                    out[key] = Quantity(value, float("nan"), float("nan"), network.unit_of(path))
            return out
    return {}
