"""Results of a diagnosis against the hidden truth: grades, the table by family, calibration by level, values, time.

Everything here reads `Diagnosis.to_dict()` and the truth beside it; nothing of the workflow's inside.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from isd_gym.diagnosis._selection.criteria import CRITERIA
from isd_gym.physics.elements import TYPES

Row = dict[str, Any]
Name = tuple[str, frozenset[str]]
#: a row ends as one of these; "missed" also where the diagnosis broke off, ran out of time or could not decide
GRADES = ("right", "wrong", "missed")
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
    """The effects that the diagnosis gave names to, each with its place."""
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


# ------------------------------------------------------------------------------------------------ values and truths
#: parameter of an effect -> its name in the sealed truth of the shared cars
CARS = {
    "quadratic_damping.damping": "c2dev",
    "cubic_stiffness.stiffness": "k3",
    "bump_stop.clearance": "bump_gap",
    "bump_stop.stiffness": "bump_k",
    "thrust_saturation.current": "sat_I",
    "actuator_lag.time_constant": "lag_tau",
    "linear_damping.damping": "ct",
    "cogging_force.amplitude": "cog_amp",
    "cogging_force.pitch": "cog_pitch",
    "stribeck_friction.level": "f",
    "stribeck_friction.static_level": "stribeck_fs",
    "stribeck_friction.stribeck_velocity": "stribeck_vs",
}
#: the same for the shared rigs, whose truth has a number for each of their three links
RIGS = {
    "coulomb_friction.level": "fc",
    "quadratic_damping.damping": "c2",
    "cubic_stiffness.stiffness": "k3",
    "bump_stop.clearance": "gap",
    "bump_stop.stiffness": "kg",
    "hysteresis.level": "bwl",
    "hysteresis.stiffness": "bwk",
}


def true_values(row: Row) -> dict[str, float]:
    """The sealed values of the parameters of what was named, as far as the truth tells them."""
    truth = row.get("truth") or {}
    if "hidden" in truth:
        return {
            f"{e['type']}.{k}": float(v)
            for e in truth["hidden"]
            for k, v in e.items()
            if isinstance(v, int | float) and not isinstance(v, bool)
        }
    if "fc" in truth:
        return {
            k: max(truth[v], key=abs)
            for k, v in RIGS.items()
            if max(truth.get(v, [0.0]), key=abs)
        }
    out = {k: truth[v] for k, v in CARS.items() if v in truth}
    if (
        "bw_A" in truth
    ):  # dz = A v - beta (|v| z + v |z|): stiffness A, saturation at A / (2 beta)
        out["hysteresis.stiffness"] = truth["bw_A"]
        out["hysteresis.level"] = truth["bw_A"] / (2 * truth["bw_beta"])
    strut = any(
        w == {"body", "wheel"} for e, w in named(row) if e == "coulomb_friction"
    )
    if ("strut_f" if strut else "f") in truth:
        out["coulomb_friction.level"] = truth["strut_f" if strut else "f"]
    return out


def values(rows: Iterable[Row]) -> tuple[list[float], list[bool], list[bool]]:
    """Of what was named rightly: relative errors, and whether intervals hold the truth; the latter for base parameters too."""
    errors, inside, base = [], [], []
    for row in rows:
        if graded(row) != "right" or not isinstance(row["answer"], list):
            continue
        known = true_values(row)
        for e in row["diagnosis"]["effects"]:
            for k, q in e["parameters"].items():
                value = known.get(f"{e['effect']}.{k}")
                if value and None not in (q["value"], q["low"], q["high"]):
                    errors.append(abs(q["value"] / value - 1))
                    inside.append(q["low"] <= value <= q["high"])
        for path, value in ((row.get("truth") or {}).get("base") or {}).items():
            q = row["diagnosis"]["parameters"].get(path)
            if q is not None and None not in (q["low"], q["high"]):
                base.append(q["low"] <= value <= q["high"])
    return errors, inside, base


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
        n = {
            s: sum(v for (k, _), v in count.items() if k == s)
            for s in ("effect", "clean", "unknown")
        }
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


def _closed(rows: Sequence[Row], wanted: str) -> list[float]:
    """Shares of the gap that diagnoses of rigs of a sort close, where they have one."""
    gaps = [
        r["diagnosis"]["gap"]["closed"]
        for r in rows
        if "diagnosis" in r and sort(r) == wanted
    ]
    return [gap for gap in gaps if gap is not None]


def figures(rows: Sequence[Row]) -> dict[str, Any]:
    """The figures of a run, as numbers: those of the table's last row, names, gap, intervals, values, time."""
    grades = {
        s: [graded(r) for r in rows if sort(r) == s]
        for s in ("effect", "clean", "unknown")
    }
    kinds = [kind_graded(r) for r in rows if sort(r) == "effect"]

    def rate(s: str, wanted: str) -> float | None:
        return _mean([g == wanted for g in grades[s]])

    stated = names_with_confidence(rows)
    sure = [ok for c, ok in stated if c >= 0.99]
    mid = [ok for c, ok in stated if 0.9 <= c < 0.99]
    closed = _closed(rows, "effect")
    errors, inside, base = values(rows)
    seconds = [r["seconds"] for r in rows]
    return {
        "rigs": len(rows),
        "right": rate("effect", "right"),
        "wrong": rate("effect", "wrong"),
        "missed": rate("effect", "missed"),
        "counts": {s: len(of_sort) for s, of_sort in grades.items()},
        "kind_wrong": _mean([kind == "wrong" for kind in kinds]),
        "clean_left_alone": rate("clean", "right"),
        "unknown_recognised": rate("unknown", "right"),
        "unknown_named": rate("unknown", "wrong"),
        "undecided_with_the_truth_among_rivals": sum(rival(r) for r in rows),
        "broke_off": sum("error" in r for r in rows),
        "out_of_time": sum(bool(r.get("timed_out")) for r in rows),
        "names_at_0.99": len(sure),
        "names_at_0.99_right": _mean(sure),
        "names_at_0.9_to_0.99": len(mid),
        "names_at_0.9_to_0.99_right": _mean(mid),
        "closed_median": _median(closed),
        "closed_least": min(closed, default=None),
        "closed_unknown_median": _median(_closed(rows, "unknown")),
        "value_error_median": _median(errors),
        "intervals": len(inside),
        "intervals_hold": _mean(inside),
        "base_intervals": len(base),
        "base_intervals_hold": _mean(base),
        "kind_right": _mean([kind == "right" for kind in kinds]),
        "reliability": {level: reliability(rows, level) for level in LEVELS},
        "seconds_median": _median(seconds),
        "seconds_longest": max(seconds, default=None),
    }


def rival(row: Row) -> bool:
    """Whether the diagnosis could not decide, and the truth is among what it lists."""
    d = row.get("diagnosis", {})
    if (
        d.get("verdict") != "ambiguous"
        or not isinstance(row["answer"], list)
        or not row["answer"]
    ):
        return False
    wanted = sorted(a[0] for a in row["answer"])
    listed = [*d["alternatives"], *filter(None, [d.get("best_candidate")])]
    return any(sorted(c["effects"]) == wanted for c in listed)


def report(rows: Sequence[Row]) -> str:
    """Everything there is to say about a run, as text."""
    f = figures(rows)

    def percent(x: float | None) -> str:
        return "-" if x is None else f"{100 * x:.1f} %"

    lines = [table(rows), ""]
    if f["broke_off"] or f["out_of_time"]:
        lines.append(
            f"counted as missed: {f['broke_off']} broke off, {f['out_of_time']} ran out of time"
        )
    if f["undecided_with_the_truth_among_rivals"]:
        lines.append(
            f"of what was missed, undecided with the truth among the rivals: {f['undecided_with_the_truth_among_rivals']}"
        )
    lines.append(
        f"names at >= 0.99: {f['names_at_0.99']}, right {percent(f['names_at_0.99_right'])}; "
        f"at 0.9 to 0.99: {f['names_at_0.9_to_0.99']}, right {percent(f['names_at_0.9_to_0.99_right'])}"
    )
    lines.append(
        f"gap closed: median {percent(f['closed_median'])}, least {percent(f['closed_least'])}; unknown law: median {percent(f['closed_unknown_median'])}"
    )
    lines.append(
        f"values: error median {percent(f['value_error_median'])}; 95 % intervals hold {percent(f['intervals_hold'])} of {f['intervals']}"
        f", of base parameters {percent(f['base_intervals_hold'])} of {f['base_intervals']}"
    )
    if f["seconds_median"] is not None:
        lines.append(
            f"processor time: median {f['seconds_median']:.1f} s, longest {f['seconds_longest']:.1f} s"
        )
    measured = [r for r in rows if isinstance(r["answer"], Mapping)]
    if measured:
        kinds = Counter(kind_graded(r) for r in measured)
        lines.append(
            f"measured rigs: law right or rightly silent {sum(graded(r) == 'right' for r in measured)} of {len(measured)}, "
            f"place and kind right {kinds['right']}, wrong name {sum(graded(r) == 'wrong' for r in measured)}"
        )
    for level in (None, *LEVELS):
        curve = reliability(rows, level)
        if curve:
            lines += [
                "",
                f"{level or 'name':5s} stated at        count   mean stated   right   95 % interval",
            ]
            lines += [
                f"{b['low']:7.3f} to {b['high']:5.3f}   {b['names']:8d}   {b['stated']:11.3f}   {b['right']:5.2f}   {b['least']:.2f} to {b['most']:.2f}"
                for b in curve
            ]
    lines += ["", "what was hidden -> what was said"]
    lines += [
        f"  {truth:45s} -> {said:45s} {n}"
        for (truth, said), n in sorted(confusion(rows).items())
    ]
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
