"""Grades of statements about place, kind and law, and how often statements of a grade were true."""

from __future__ import annotations

from typing import Literal

Grade = Literal["certain", "probable", "possible"]

#: least probability of the grades; lower probabilities are possible
LEAST: dict[Grade, float] = {"certain": 0.8, "probable": 0.5}
#: statements and true statements by level and grade, each at the first look at a rig. Simulated: benchmarks/diagnosis.json, suites
#: `families` and `home` of seeds 463 and 472. Measured: benchmarks/first-looks.json.
OBSERVED: dict[str, dict[str, dict[Grade, tuple[int, int]]]] = {
    "simulated": {
        "place": {"certain": (264, 248), "probable": (5, 3), "possible": (18, 7)},
        "kind": {"certain": (229, 226), "probable": (2, 1), "possible": (16, 13)},
        "law": {"certain": (224, 223), "probable": (6, 4), "possible": (145, 25)},
    },
    "measured": {
        "place": {"certain": (13, 13), "probable": (1, 1), "possible": (4, 2)},
        "kind": {"certain": (11, 9), "probable": (3, 2), "possible": (11, 3)},
        "law": {"certain": (4, 3), "probable": (1, 1), "possible": (0, 0)},
    },
}


def grade(probability: float) -> Grade:
    """Return the grade of a probability: certain from 0.8 on, probable from 0.5 on, else possible."""
    return next((name for name, least in LEAST.items() if probability >= least), "possible")


def observed(level: str, name: Grade) -> str:
    """Return how often statements of a level and a grade were true, such as ``true: 248 of 264 on simulated rigs``.

    Args:
        level: place, kind or law.
        name: The grade.

    Returns:
        A phrase; empty where there were no such statements.
    """
    counts = {rigs: rows[level][name] for rigs, rows in OBSERVED.items()}
    told = [f"{true} of {stated} on {rigs} rigs" for rigs, (stated, true) in counts.items() if stated]
    return f"true: {', '.join(told)}" if told else ""
