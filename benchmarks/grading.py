"""Results of a diagnosis against the hidden truth: grades, the table by family, calibration by level, time.

Everything here reads `Diagnosis.to_dict()` and the truth beside it; nothing of the workflow's inside.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from isd_gym.diagnosis import CRITERIA
from isd_gym.physics.elements import TYPES

Row = dict[str, Any]
#: a row ends as one of these; "missed" also where the diagnosis broke off, ran out of time or could not decide
GRADES = ("right", "wrong", "missed")
#: what a rig hides
SORTS = ("effect", "clean", "unknown")
#: edges of the bins of stated confidence
BINS = (0.0, 0.5, 0.8, 0.9, 0.95, 0.99, 0.999, 1.0 + 1e-12)


def pair(place: Any) -> frozenset[str] | None:
    """Terminals whatever their order, or a channel; None: anywhere."""
    return (
        None
        if place is None
        else frozenset([place] if isinstance(place, str) else place)
    )


def named(row: Row) -> list[tuple[str, frozenset[str]]]:
    """Return the named effects with their places."""
    effects = row.get("diagnosis", {}).get("effects", [])
    return [
        (e["effect"], pair(e.get("channel") or e.get("between") or []) or frozenset())
        for e in effects
    ]


def same(
    found: Sequence[tuple[str, Any]], answer: Sequence[Any], allowed: Iterable[Any] = ()
) -> bool:
    """Every effect named, in the right place (None: anywhere), and nothing else but what is `allowed`."""
    left = list(found)
    for what, where in answer:
        hit = next(
            (
                f
                for f in left
                if f[0] == what and (where is None or f[1] == pair(where))
            ),
            None,
        )
        if hit is None:
            return False
        left.remove(hit)
    return all(
        any(f[0] == what and f[1] == pair(where) for what, where in allowed)
        for f in left
    )


def nuisances(row: Row) -> list[tuple[str, Any]]:
    """Small effects that are really there: naming one is no error, but is not asked for."""
    truth = row.get("truth")
    small = truth.get("nuisances", []) if isinstance(truth, Mapping) else []
    return [(e["type"], e.get("between") or e.get("channel")) for e in small]


def grade(
    verdict: str,
    found: Sequence[tuple[str, Any]],
    answer: Any,
    allowed: Iterable[Any] = (),
) -> str:
    """right, wrong (a name that is not true), or missed. `answer`: pairs of effect and place, [] or "unknown"."""
    if answer == "unknown":
        return (
            "right" if verdict == "unknown_effect" else "wrong" if found else "missed"
        )
    if isinstance(answer, Mapping):
        return _measured(found, answer)
    if same(found, answer, allowed):
        return (
            "right"
            if answer or verdict in ("no_discrepancy", "parameters_only")
            else "missed"
        )
    return "wrong" if found else "missed"


def _measured(found: Sequence[tuple[str, Any]], expected: Mapping[str, Any]) -> str:
    """Grade the names of a measured rig.

    Args:
        found: Named effects with their places.
        expected: `needs` lists the required effects, an inner list alternatives; `allows` lists permitted further effects; with
            `silent`, a diagnosis without a name is right as well.
    """
    names = {f[0] for f in found}
    choices = [{n} if isinstance(n, str) else set(n) for n in expected["needs"]]
    if names - set(expected.get("allows", ())) - set().union(*choices):
        return "wrong"
    if all(names & c for c in choices) or (not names and expected.get("silent")):
        return "right"
    return "wrong" if names else "missed"


def graded(row: Row) -> str:
    if "diagnosis" not in row:
        return "missed"
    return grade(row["diagnosis"]["verdict"], named(row), row["answer"], nuisances(row))


def sort(row: Row) -> str:
    answer = row["answer"]
    return "unknown" if answer == "unknown" else "effect" if answer else "clean"


# ------------------------------------------------------------------------------------------------------- reliability
#: levels of an answer, from coarse to fine
LEVELS = ("place", "kind", "law")


def kind_of(effect: str) -> str | None:
    """Return the kind of an effect; None for a law that is not in the library."""
    return TYPES[effect].mechanism if effect in TYPES else None


def statements(
    row: Row, level: str, *, is_placed: bool = False
) -> list[tuple[float, bool]]:
    """Return the statements of a diagnosis at a level: stated probability, and whether the statement is true.

    Kinds and laws of a hidden law that is not in the library are left out: only its place can be right or wrong.

    Args:
        row: The row of a case.
        level: One of `LEVELS`.
        is_placed: Whether findings with an open place are left out.
    """
    answer, findings = row["answer"], row.get("diagnosis", {}).get("findings", [])
    if isinstance(answer, Mapping):
        places: set[Any] = {pair(p) for p in answer["places"]}
        kinds = {(p, k) for p in places for k in answer["kinds"]}
        names = [
            n
            for need in answer["needs"]
            for n in ([need] if isinstance(need, str) else need)
        ]
        laws = {(p, n) for p in places for n in [*names, *answer.get("allows", ())]}
    elif answer == "unknown":
        if level != "place":
            return []
        places = {
            pair(e.get("between") or e.get("channel"))
            for e in (row.get("truth") or {}).get("hidden", [])
        }
        kinds, laws = set(), set()
    else:
        truth = [*((effect, where) for effect, where in answer), *nuisances(row)]
        places = {pair(where) for _, where in truth}
        kinds = {(pair(where), kind_of(effect)) for effect, where in truth}
        laws = {(pair(where), effect) for effect, where in truth}
    out: dict[Any, tuple[float, bool]] = {}
    for f in findings:
        if is_placed and not f["place"]:
            continue
        place = pair(f["place"])

        def is_true(what: set[Any], *rest: str, place: Any = place) -> bool:
            if not place:  # an open place: the kind or the law counts
                return any(t[1:] == rest for t in what)
            return (place, *rest) in what or (None, *rest) in what

        if level == "place":
            if place:
                out[place] = f["place_probability"], bool(places & {place, None})
        elif level == "kind":
            out[place, f["kind"]] = f["kind_probability"], is_true(kinds, f["kind"])
        else:
            for law in f["laws"]:
                out[place, law["effect"]] = (
                    law["probability"],
                    is_true(laws, law["effect"]),
                )
    return list(out.values())


def kind_graded(row: Row) -> str:
    """Return 'right' where a true kind at a true place is stated as more likely than not, 'wrong' where only others are, else 'missed'."""
    if graded(row) == "right":
        return "right"
    likely = [
        ok
        for p, ok in statements(row, "kind", is_placed=True)
        if p >= CRITERIA.probable
    ]
    return "right" if any(likely) else "wrong" if likely else "missed"


def names_with_confidence(rows: Iterable[Row]) -> list[tuple[float, bool]]:
    """Return every name: the stated confidence, and whether the whole answer is right."""
    return [
        (float(e["confidence"]), graded(row) == "right")
        for row in rows
        for e in row.get("diagnosis", {}).get("effects", [])
    ]


def reliability(
    rows: Iterable[Row], level: str | None = None
) -> list[dict[str, float]]:
    """Return stated against observed probability by bin, with the 95 % Wilson interval of the observed share.

    Args:
        rows: Rows of cases.
        level: Level of the statements; None for the names of verdicts.
    """
    rows = list(rows)
    given = (
        [s for r in rows for s in statements(r, level)]
        if level
        else names_with_confidence(rows)
    )
    out = []
    for low, high in zip(BINS, BINS[1:], strict=False):
        here = [(c, ok) for c, ok in given if low <= c < high]
        if here:
            k, n = sum(ok for _, ok in here), len(here)
            least, most = wilson(k, n)
            stated = float(np.mean([c for c, _ in here]))
            out.append(
                {
                    "low": low,
                    "high": min(high, 1.0),
                    "names": n,
                    "stated": stated,
                    "right": k / n,
                    "least": least,
                    "most": most,
                }
            )
    return out


def wilson(k: int, n: int, z: float = 1.96) -> tuple[float, float]:
    """95 % interval of a share of k in n (Wilson, 1927)."""
    p, d = k / n, 1 + z * z / n
    half = z * math.sqrt(p * (1 - p) / n + z * z / (4 * n * n)) / d
    middle = (p + z * z / (2 * n)) / d
    return max(0.0, middle - half), min(1.0, middle + half)


# ------------------------------------------------------------------------------------------------------------ tables
def share(part: int, whole: int) -> str:
    return f"{part:4d} {100 * part / whole:4.0f} %" if whole else "   -       "


def table(rows: Sequence[Row]) -> str:
    """Right, named wrongly, missed of the rigs with an effect; clean ones left alone; unknown ones recognised; by family."""
    families = list(dict.fromkeys(r["family"] for r in rows))
    head = f"{'family':14s} {'rigs':>4s} | {'effects':>7s} {'right':>11s} {'wrong':>11s} {'missed':>11s} | {'clean':>5s} {'left alone':>11s} | {'unknown':>7s} {'recognised':>11s} {'named':>6s}"
    lines = [head, "-" * len(head)]
    for family in [*families, "all"] if len(families) > 1 else families:
        mine = [r for r in rows if family in ("all", r["family"])]
        count = Counter((sort(r), graded(r)) for r in mine)
        n = {s: sum(v for (k, _), v in count.items() if k == s) for s in SORTS}
        effect = " ".join(share(count["effect", g], n["effect"]) for g in GRADES)
        if family == "all":
            lines.append("-" * len(head))
        lines.append(
            f"{family:14s} {len(mine):4d} | {n['effect']:7d} {effect} | {n['clean']:5d} {share(count['clean', 'right'], n['clean'])}"
            f" | {n['unknown']:7d} {share(count['unknown', 'right'], n['unknown'])} {count['unknown', 'wrong']:6d}"
        )
    return "\n".join(lines)


def _mean(values: Sequence[float]) -> float | None:
    return float(np.mean(values)) if len(values) else None


def _median(values: Sequence[float]) -> float | None:
    return float(np.median(values)) if len(values) else None


def intervals(rows: Sequence[Row]) -> dict[str, list[bool]]:
    """Return whether 95 % intervals of right answers hold the true values: of the model's parameters, and of the named effects'."""
    out: dict[str, list[bool]] = {"model": [], "effects": []}
    for row in rows:
        truth = row.get("truth") or {}
        if graded(row) != "right" or not {"parameters", "hidden"} <= truth.keys():
            continue
        true, d = truth["parameters"], row["diagnosis"]
        hidden = {e["type"]: e for e in truth["hidden"]}
        found = [("model", true.get(path), q) for path, q in d["parameters"].items()]
        for e in d["effects"]:
            own = hidden.get(e["effect"], {})
            found += [("effects", own.get(k), q) for k, q in e["parameters"].items()]
        for whose, value, q in found:
            if None not in (value, q["low"], q["high"]):
                out[whose].append(q["low"] <= value <= q["high"])
    return out


def figures(rows: Sequence[Row]) -> dict[str, Any]:
    """Return the figures of a run: shares by grade, stated against observed probability, processor time."""
    of_sort = {s: [r for r in rows if sort(r) == s] for s in SORTS}

    def rate(s: str, wanted: str) -> float | None:
        return _mean([graded(r) == wanted for r in of_sort[s]])

    kinds = [kind_graded(r) for r in of_sort["effect"]]
    seconds = [r["seconds"] for r in rows]
    return {
        "rigs": len(rows),
        "counts": {s: len(some) for s, some in of_sort.items()},
        **{g: rate("effect", g) for g in GRADES},
        "kind_right": _mean([kind == "right" for kind in kinds]),
        "kind_wrong": _mean([kind == "wrong" for kind in kinds]),
        "clean_left_alone": rate("clean", "right"),
        "unknown_recognised": rate("unknown", "right"),
        "broke_off": sum("error" in r for r in rows),
        "out_of_time": sum(bool(r.get("timed_out")) for r in rows),
        "reliability": {level: reliability(rows, level) for level in LEVELS},
        "intervals": {
            whose: {"count": len(held), "hold": _mean(held)}
            for whose, held in intervals(rows).items()
        },
        "seconds_median": _median(seconds),
        "seconds_longest": max(seconds, default=None),
    }


def report(rows: Sequence[Row]) -> str:
    """Return the figures of a run as text."""
    f = figures(rows)
    lines = [table(rows), ""]
    if f["broke_off"] or f["out_of_time"]:
        lines.append(
            f"counted as missed: {f['broke_off']} broke off, {f['out_of_time']} ran out of time"
        )
    if rows:
        lines.append(
            f"processor time: median {f['seconds_median']:.1f} s, longest {f['seconds_longest']:.1f} s"
        )
    for whose, own in f["intervals"].items():
        if own["count"]:
            lines.append(
                f"95 % intervals of the {whose}: {own['hold']:.0%} of {own['count']} hold the true value"
            )
    for level in (None, *LEVELS):
        lines += [
            "",
            f"{level or 'name':5s} stated at        count   mean stated   right   95 % interval",
        ]
        for b in reliability(rows, level):
            lines.append(
                f"{b['low']:7.3f} to {b['high']:5.3f}   {b['names']:8d}   {b['stated']:11.3f}   {b['right']:5.2f}"
                f"   {b['least']:.2f} to {b['most']:.2f}"
            )
    lines += ["", "what was hidden -> what was said"]
    for (truth, said), count in sorted(confusion(rows).items()):
        lines.append(f"  {truth:45s} -> {said:45s} {count}")
    return "\n".join(lines)


def confusion(rows: Iterable[Row]) -> Counter[tuple[str, str]]:
    count: Counter[tuple[str, str]] = Counter()
    for r in rows:
        answer = r["answer"]
        if isinstance(answer, Mapping):
            truth = "+".join(
                n if isinstance(n, str) else "/".join(n) for n in answer["needs"]
            )
        else:
            truth = (
                "unknown"
                if answer == "unknown"
                else "+".join(sorted(a[0] for a in answer)) or "nothing"
            )
        said = "+".join(sorted(n for n, _ in named(r)))
        count[truth, said or outcome(r)] += 1
    return count


def outcome(row: Row) -> str:
    """The verdict, or why there is none."""
    if "diagnosis" in row:
        return str(row["diagnosis"]["verdict"])
    return (
        "out of time"
        if row.get("timed_out")
        else str(row.get("error", "?")).split(":")[0]
    )
