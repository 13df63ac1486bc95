"""Grades of statements about place, kind and law, and how often statements of a grade were true."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

from .._selection.criteria import CRITERIA, Criteria

if TYPE_CHECKING:
    from .evidence import Evidence

Grade = Literal["certain", "probable", "possible"]

#: least probability of the grades; lower probabilities are possible
LEAST: dict[Grade, float] = {"certain": CRITERIA.certain, "probable": CRITERIA.probable}
#: probability below which a kind at a place, or a further law, is not reported: 1 in 20
REPORTED = 0.05
#: share of statements that are wrong although no resampling of the records shows it, by Laplace's rule from first looks
MISTAKEN = {
    # a law that nobody has written down, or another with the same force here: 25 of 428 names given at 0.91 to 0.93 (seeds 305 to 308 of
    # all families, rigs of another hand)
    "law": 0.06,
    "kind": 0.05,
    "place": 0.03,
    # a law that leaves more than `Criteria.alone_removes` or a wide gap; places and kinds of such a candidate, without a name or below
    # `Criteria.least_explained`. Wrong: 9 of 26 names and 9 of 32 places and kinds (seeds 310 to 317), 2 of 10 names that remove half to
    # three quarters. Also a law whose special case leaves no more than unmodelled effects, and a law that leaves more than
    # `Criteria.alone_removes` on the test records: 1 of 3 names wrong, against 3 of 190 (seeds 1801 and 1901, measured rigs)
    "partly": 0.36,
    # kinds and laws that did not pass the inclusion test, or whose force a free curve or a controller explains too: 7 of 10 such kinds on
    # sixteen measured rigs
    "extra": 0.67,
    # places and kinds of a candidate that explains less than `Criteria.least_removed`: 8 of 15 such places (seed 463, sealed rigs)
    "weak": 0.53,
}
#: share of the samples at the edge of which a law's slip, clearance or transition is weakly supported: such a law counts as `partly`
SUPPORT = 0.01
#: statements and true statements by level and grade, each at the first look at a rig. Simulated: benchmarks/diagnosis.json, suite
#: `families` of seed 3201. Measured, with the search before: benchmarks/first-looks.json.
OBSERVED: dict[str, dict[str, dict[Grade, tuple[int, int]]]] = {
    "simulated": {
        "place": {"certain": (94, 93), "probable": (5, 2), "possible": (11, 9)},
        "kind": {"certain": (93, 90), "probable": (3, 3), "possible": (2, 1)},
        "law": {"certain": (86, 84), "probable": (10, 6), "possible": (2, 0)},
    },
    "measured": {
        "place": {"certain": (46, 45), "probable": (17, 17), "possible": (20, 15)},
        "kind": {"certain": (40, 30), "probable": (21, 16), "possible": (63, 25)},
        "law": {"certain": (13, 10), "probable": (36, 21), "possible": (58, 21)},
    },
}


def grade(probability: float) -> Grade:
    """Return the grade of a probability: certain from 0.8 on, probable from 0.5 on, else possible."""
    return next(
        (name for name, least in LEAST.items() if probability >= least), "possible"
    )


def share_mistaken(level: str, e: Evidence, c: Criteria = CRITERIA) -> float:
    """Return the share of statements of a level (place, kind or law) that are wrong although no resampling shows it."""
    is_law = level == "law"
    explained = min(e.explained, e.test_explained) if is_law else e.explained
    is_partly = explained < (c.alone_removes if is_law else c.least_explained)
    is_doubtful = is_law and (e.width(e.after) > c.wide_gap or e.support < SUPPORT)
    own = (
        max(MISTAKEN[level], MISTAKEN["partly"])
        if is_partly or is_doubtful
        else MISTAKEN[level]
    )
    return max(own, MISTAKEN["weak"]) if e.explained < c.least_removed else own


def observed(level: str, name: Grade) -> str:
    """Return how often statements of a level and a grade were true, such as ``true: 248 of 264 on simulated rigs``; empty if there were none."""
    counts = {rigs: rows[level][name] for rigs, rows in OBSERVED.items()}
    told = [
        f"{true} of {stated} on {rigs} rigs"
        for rigs, (stated, true) in counts.items()
        if stated
    ]
    return f"true: {', '.join(told)}" if told else ""
