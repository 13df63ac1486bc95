"""Findings: probabilities of place, kind and law of a missing effect."""

from __future__ import annotations

import functools
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

    from .._selection.forward_backward import Search
    from .._selection.weights import WeightedCandidate
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

    def to_dict(self) -> dict[str, Any]:
        """Return the entry of the JSON file."""
        levels = {"place": grade(self.place_probability), "kind": grade(self.kind_probability)}
        head = {k: v for k, v in vars(self).items() if k not in ("laws", "named")}
        return head | {"grade": levels, "laws": [law.to_dict() for law in self.laws], "named": self.named}


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
    """Return findings, largest probability of the kind first: sums of weights as probabilities of places, kinds and laws. A kind that is
    certain at none of several places has an open place. `own`: statements of the foremost candidate; `is_doubted`: whether a free curve
    or a controller explains its force."""
    c = search.criteria
    share = functools.partial(share_mistaken, e=evidence, c=c, is_named=is_named)
    every: dict[tuple[tuple[str, ...], str], dict[str, Statement]] = {}
    for w in candidates:
        for s in sorted(w.statements, key=lambda s: (s.place, s.kind, s.law)):
            every.setdefault((s.place, s.kind), {})[s.law] = s
    passed = frozenset[Statement]() if is_doubted else own
    free_places = {place for (place, _), laws in every.items() if FREE_FORCE in laws}

    own_places = {s.place for s in own}
    foremost_first = sorted(candidates, key=lambda w: w.statements != own)

    def of_place(place: tuple[str, ...]) -> float:
        """Return the probability of a place, less where it belongs to an effect beside the foremost candidate's that did not pass the
        inclusion test."""
        whole = probability(candidates, place=place)
        if place in free_places:
            return whole * (1.0 - MISTAKEN["place"])
        beside = [
            w for w in candidates if place not in own_places and own_places & {s.place for s in w.statements}
        ]
        further = probability(beside, place=place)
        return (whole - further) * (1.0 - share("place")) + further * (
            1.0 - max(MISTAKEN["extra"], share("place"))
        )

    def finding(place: tuple[str, ...], kind: str, laws: Mapping[str, Statement]) -> Finding:
        """Return the finding of a kind at a place, or at any place where `place` is empty."""
        where: dict[str, object] = {"kind": kind} | ({"place": place} if place else {})
        own_here = {s for s in own if s.kind == kind and place in (s.place, ())}
        is_passed = bool(own_here & passed)
        is_free = FREE_FORCE in laws  # the free force stands for laws outside the library
        doubt = 0.0 if is_passed or is_free else MISTAKEN["extra"]
        of_table = MISTAKEN["free" if kind in NAMELESS else "kind"]
        mistaken = of_table if is_free else max(doubt, share("kind"))
        of_kind = probability(candidates, **where) * (1.0 - mistaken)

        def of_law(law: str) -> float:
            """Return the probability of a law. Beside a law of the foremost candidate it did not pass the inclusion test."""
            whole = probability(candidates, **where, law=law)
            is_own = any(s.law == law for s in own_here)
            beside = [] if is_own else [w for w in candidates if own_here & w.statements]
            further = probability(beside, **where, law=law)
            is_sum = law in TYPES and TYPES[law].is_sum()
            wrong = max(mistaken if is_free else doubt, share("law", is_sum=is_sum))
            return (whole - further) * (1.0 - wrong) + further * (1.0 - max(MISTAKEN["extra"], wrong))

        entries = [
            LawProbability(law, of_law(law), _values(foremost_first, statement, quantities) if place else {})
            for law, statement in laws.items()
        ]
        return Finding(
            place,
            of_place(place) if place else of_kind,
            kind,
            of_kind,
            tuple(sorted(entries, key=lambda e: (-e.probability, e.effect))),
            is_named and any(s in own for s in laws.values()),
        )

    found = [
        finding(place, kind, laws)
        for (place, kind), laws in every.items()
        if probability(candidates, place=place, kind=kind) >= REPORTED
    ]
    for kind in sorted({f.kind for f in found} - set(NAMELESS)):
        at_places = [f for f in found if f.kind == kind]
        whole = probability(candidates, kind=kind)
        is_settled = any(
            f.named or probability(candidates, place=f.place, kind=kind) >= c.certain * whole
            for f in at_places
        )
        if len(at_places) > 1 and not is_settled:
            laws = {s.law: s for (_, k), own_laws in every.items() if k == kind for s in own_laws.values()}
            found.append(replace(finding((), kind, laws), named=False))
    return tuple(sorted(found, key=lambda f: (not f.named, -f.kind_probability, f.place, f.kind)))


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
