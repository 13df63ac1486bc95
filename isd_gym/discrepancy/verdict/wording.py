"""The summary of a diagnosis, written from the numbers of its JSON document alone."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ...elements import TYPES

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

#: a result that makes the error on the reported records larger
NOT_BORNE_OUT = "The error on the reported records is larger with it: confirm it with a new record."
RELATIONS = {"<": "below", "<=": "at most", ">": "above", ">=": "at least"}
OVER = {"rate": "their rate", "elongation": "their distance", "both": "their distance and rate"}
#: parameters whose change is stated; laws of a kind that are stated
CHANGES, LAWS = 2, 2
#: probability from which on a further kind is mentioned
POSSIBLE = 0.2
#: kinds of effects in words
KINDS = {
    "dry_friction": "Dry friction",
    "viscous": "A viscous force",
    "elastic": "An elastic force",
    "play": "Play",
    "inertial": "An inertia force",
    "position_periodic": "A force that is periodic in position",
    "series_compliance": "A compliance in series",
    "drive": "A fault of the drive",
    "sensor": "A fault of the sensor",
    "constant": "A constant force",
    "other": "A force of another kind",
}


def summary_of(document: Mapping[str, Any]) -> str:
    """Return the summary of a diagnosis.

    Args:
        document: the diagnosis as its JSON has it (`isd-diagnosis/1`); its own `summary` is not read.

    Returns:
        Sentences: the finding with its figures, the reason, the limits of the data, and what to do next.
    """
    verdict = document["verdict"]
    if verdict == "missing_effect":
        parts = [_missing(document), _remaining(document)]
    elif verdict == "ambiguous":
        parts = [_certain(document), _ambiguous(document)]
    elif verdict == "unknown_effect":
        parts = [_unknown(document), _certain(document), _best_candidate(document), _table(document)]
    else:
        parts = [_agreement(document), _reason(document), _changes(document)]
    parts += [
        _small(document),
        _noise(document),
        _limits(document),
        _stretches(document),
        _closed_loop(document),
    ]
    return " ".join(p for p in parts if p)


def unit_summary_of(document: Mapping[str, Any]) -> str:
    """Return the summary of a diagnosis whose model is a unit for co-simulation.

    Args:
        document: the diagnosis as its JSON has it (`isd-diagnosis/1`); its own `summary` is not read.
    """
    gap, verdict = document["gap"]["held_out"], document["verdict"]
    if verdict == "no_discrepancy":
        worst = _widest(gap)
        text = f"The unit agrees with the measurements ({worst}: {_errors(gap, worst, 'refit')}); nothing is missing."
    elif verdict == "parameters_only":
        most = _most_gained(gap, "before", "refit")
        text = (
            f"Refitted parameters explain the difference ({most}: {_errors(gap, most, 'before', 'refit')}); nothing is "
            "missing."
        )
    else:
        worst = _widest(gap)
        parts = [
            f"Something is missing that no value of the unit's parameters explains ({worst}: "
            f"{_errors(gap, worst, 'before', 'refit')}).",
            _where(document),
            "A unit shows no inside: which effect is missing, and where, needs a network of the rig (isd-model/1).",
            *(
                f"A constant is {_percent(share, 0)} of the squared error in {name}: check the zero of the sensor."
                for name, share in document["constant"].items()
                if share is not None and share > 0.5
            ),
        ]
        text = " ".join(p for p in parts if p)
    return " ".join(p for p in (text, _noise(document), _limits(document)) if p)


# ---------------------------------------------------------------------------------------------- numbers and names


def plain_number(value: float | None, digits: int = 4) -> str:
    """Return significant digits, without an exponent for values from 1e4 to 1e7; ``unknown`` for None."""
    if value is None:
        return "unknown"
    text = f"{value:.{digits}g}"
    return np.format_float_positional(float(text), trim="-") if 1e4 <= abs(value) < 1e7 else text


def described(effect: Mapping[str, Any]) -> str:
    """Return an effect of the JSON with its place and values."""
    spot = f"in channel {effect['channel']}" if "channel" in effect else _between(effect["between"] or ())
    what, kind = effect["effect"].replace("_", " "), TYPES.get(effect["effect"])
    if kind is not None and kind.series:
        what, spot = f"{what},", f"in series with {effect.get('behind') or 'all elements'} {spot}"
    figures = ", ".join(
        f"{k.replace('_', ' ')} {plain_number(q['value'])} {q['unit']}"
        for k, q in effect["parameters"].items()
        if q["value"] is not None
    )
    return f"{what} {spot} ({figures})"


def candidate_text(candidate: Mapping[str, Any]) -> str:
    """Return the effects of a candidate (an item of `alternatives`, or `best_candidate`) with their places."""
    named = zip(candidate["effects"], candidate["where"], strict=True)
    return " and ".join(f"{effect.replace('_', ' ')} {_spot(where)}" for effect, where in named)


def _spot(where: Sequence[str]) -> str:
    return _between(where) if len(where) == 2 else f"at {' and '.join(where)}"


def _between(nodes: Iterable[str]) -> str:
    return f"between {' and '.join(nodes)}"


def _percent(value: float | None, digits: int = 1) -> str:
    return "an unknown share" if value is None else f"{round(100 * value, digits) + 0.0:.{digits}f} %"


def _errors(gap: Mapping[str, Mapping[str, float]], channel: str, *stages: str) -> str:
    words = {"before": "before", "refit": "refitted"}
    said = [f"{_percent(gap[s][channel])} {words[s] if len(stages) > 1 else 'error'}" for s in stages]
    return ", ".join([*said, f"noise {_percent(gap['noise_floor'][channel])}"])


def _square(value: float | None) -> float:
    return float("inf") if value is None else value**2


def _widest(gap: Mapping[str, Mapping[str, float]]) -> str:
    """The channel with the largest error of the refitted model."""
    return max(gap["refit"], key=lambda c: _square(gap["refit"][c]))


def _most_gained(gap: Mapping[str, Mapping[str, float]], old: str, new: str) -> str:
    return max(gap[old], key=lambda c: _square(gap[old][c]) - _square(gap[new][c]))


def failures(gates: Iterable[Mapping[str, Any]]) -> str:
    """Return failed gates with value and limit, such as ``determined (1, needed below 0.9)``."""
    return ", ".join(
        f"{g['gate']} ({plain_number(g['value'], 3)}, needed {RELATIONS[g['relation']]} {plain_number(g['limit'], 3)})"
        for g in gates
        if not g["passed"]
    )


# ------------------------------------------------------------------------------------------------- the verdicts


def _missing(d: Mapping[str, Any]) -> str:
    gap = d["gap"]["held_out"]
    c = _most_gained(gap, "refit", "after")
    found = " and ".join(described(e) for e in d["effects"])
    down = _square(gap["after"][c]) <= _square(gap["refit"][c])
    text = (
        f"The model lacks {found}; with it the error in {c} on held-out data {'falls' if down else 'rises'} from "
        f"{_percent(gap['refit'][c])} to {_percent(gap['after'][c])} (noise {_percent(gap['noise_floor'][c])})."
    )
    return text if down else f"{text} {NOT_BORNE_OUT}"


def _remaining(d: Mapping[str, Any]) -> str:
    left = d["remainder"]
    if not left:
        return ""
    most = f", most of all when: {left['when']}" if left["when"] != "everywhere" else ""
    text = (
        f"An error of {_percent(left['after'])} in {left['channel']} is left (noise {_percent(left['noise_floor'])}){most}: "
        "another effect may be missing."
    )
    if left["candidate"]:
        text += (
            f" The closest addition that was tried, {candidate_text(left['candidate'])}, would leave "
            f"{_percent(left['candidate']['error'])}; it was not kept."
        )
    return text


def _certain(d: Mapping[str, Any]) -> str:
    """Return the deepest statements that are certain: kinds, or places alone, each with its probability."""
    least, findings = d["criteria"]["certain"], d["findings"]
    kinds = [f for f in findings if f["kind"] != "other" and f["kind_probability"] >= least]
    sentences = []
    for f in kinds:
        laws = " or ".join(
            f"{law['effect'].replace('_', ' ')} ({law['probability']:.2f}{_law_values(law)})"
            for law in f["laws"][:LAWS]
        )
        sentences.append(f"{KINDS[f['kind']]} {_spot(f['place'])} ({f['kind_probability']:.2f}): {laws}.")
    if not kinds:
        places = {
            tuple(f["place"]): f["place_probability"] for f in findings if f["place_probability"] >= least
        }
        sentences = [
            f"Something is missing {_spot(place)} ({chance:.2f}); its kind is open."
            for place, chance in places.items()
        ]
    beside = [
        f"{KINDS[f['kind']].lower()} {_spot(f['place'])} ({f['kind_probability']:.2f})"
        for f in findings
        if f not in kinds and f["kind"] != "other" and f["kind_probability"] >= POSSIBLE
    ]
    if kinds and beside:
        sentences.append(f"Besides, perhaps {' or '.join(beside)}.")
    return " ".join(sentences)


def _law_values(law: Mapping[str, Any]) -> str:
    values = [
        f"{k.replace('_', ' ')} {plain_number(q['value'])} {q['unit']}" for k, q in law["parameters"].items()
    ]
    return f", {', '.join(values)}" if values else ""


def _ambiguous(d: Mapping[str, Any]) -> str:
    rivals = d["alternatives"]
    if d["reason"] == "kind_certain":
        best = d["best_candidate"]
        return (
            f"The law is not certain: {candidate_text(best)} removes {_percent(best['explained'], 0)} of the held-out excess error, "
            f"but fails {failures(best['failed_gates'])}."
        )
    if len(rivals) > 1:
        names = " or ".join(f"{candidate_text(r)} (leaves {_left(r)})" for r in rivals)
        text = f"Something is missing, and these data cannot tell which of {len(rivals)} explanations is right: {names}."
    else:
        text = (
            f"Something is missing: {candidate_text(d['best_candidate'])} explains it, but fails "
            f"{failures(d['best_candidate']['failed_gates'])}."
        )
    test = d["next_experiment"]
    return f"{text} Next: play the test in next_experiment.csv." if test else text


def _left(rival: Mapping[str, Any]) -> str:
    excess = rival["excess"]
    return "an unknown share" if excess is None else f"{_percent(max(excess, 0.0))} of the excess error"


def _unknown(d: Mapping[str, Any]) -> str:
    gap = d["gap"]["held_out"]
    c = _widest(gap)
    return (
        f"Something is missing that no known effect explains well enough to be named ({c}: {_errors(gap, c, 'before', 'refit')}). "
        f"{_where(d)}"
    ).rstrip()


def _where(d: Mapping[str, Any]) -> str:
    if not d["where"] or not d["where"][0]["share"]:
        return ""
    first = d["where"][0]
    most = f", most of all when: {first['when']}" if first["when"] != "everywhere" else ""
    return f"{first['channel']} has {_percent(first['share'], 0)} of the gap{most}."


def _best_candidate(d: Mapping[str, Any]) -> str:
    best = d["best_candidate"]
    if best is None:
        return "No known effect gains anything on these records."
    error = best["error"]
    c = _most_gained(error, "refit", "after")
    down = _square(error["after"][c]) <= _square(error["refit"][c])
    failed = [g for g in best["failed_gates"] if not g["passed"]]
    return (
        f"The best candidate, {candidate_text(best)}, {'takes' if down else 'raises'} the error in {c} from "
        f"{_percent(error['refit'][c])} to {_percent(error['after'][c])} and fails {len(failed)} of {len(d['gates'])} gates: "
        f"{failures(failed)}."
    )


def _table(d: Mapping[str, Any]) -> str:
    t, tried = d["tabulated"], d["best_table"]
    if t:
        near = ", ".join(f"{x['effect'].replace('_', ' ')} {_percent(x['share'], 0)}" for x in t["nearest"])
        alone = ", ".join(
            f"{OVER[k].removeprefix('their ')} alone gives {_percent(v, 0)} of it"
            for k, v in t["shares"].items()
        )
        text = (
            f"A force {_between(t['between'])} that depends on {OVER[t['over']]}{f' ({alone})' if alone else ''} removes "
            f"{_percent(t['explained'], 0)} of the held-out excess error; in model.json it is the element '{t['element']}'."
        )
        text += f" The nearest known laws give this share of its square: {near}." if near else ""
        closed = d["gap"]["closed"]
        return f"{text} {NOT_BORNE_OUT}" if closed is not None and closed < 0 else text
    if tried is None:
        return "No table of a force between two nodes could be fitted."
    explains = next(g for g in tried["gates"] if g["gate"] == "explains")
    text = (
        f"The best table of a force, {_between(tried['between'])} over {OVER[tried['over']]}, removes "
        f"{_percent(tried['explained'], 0)} of the held-out excess error"
    )
    if not explains["passed"]:
        return (
            f"{text} (needed {_percent(explains['limit'], 0)}). The missing force may depend on time, on its own past, or on a motion "
            "that was not measured."
        )
    return f"{text} and is not stated: {failures(tried['gates']) or 'its interval cannot be computed'}."


def _agreement(d: Mapping[str, Any]) -> str:
    gap, least = d["gap"]["held_out"], d["criteria"]["material"] ** 2
    refit, noise = gap["refit"], gap["noise_floor"]
    worst = max(refit, key=lambda c: _square(refit[c]) - _square(noise[c]))
    if _square(refit[worst]) - _square(noise[worst]) > least:
        return f"Nothing worth a name is missing ({worst}: {_errors(gap, worst, 'before', 'refit')})."
    if d["verdict"] == "no_discrepancy":
        return f"The model agrees with the measurements ({worst}: {_errors(gap, worst, 'refit')}); nothing is missing."
    most = _most_gained(gap, "before", "refit")
    return f"Refitted parameters explain the difference ({most}: {_errors(gap, most, 'before', 'refit')}); nothing is missing."


def _reason(d: Mapping[str, Any]) -> str:
    e, c = d["evidence"], d["criteria"]
    rows = zip(e["channels"], e["refit"], e["noise"], e["envelope"], strict=True)
    excess = {
        name: (max(_square(r) - _square(f), 0.0) ** 0.5, f, w)
        for name, r, f, w in rows
        if None not in (r, f, w)
    }
    if not excess:
        return ""
    worst = max(excess, key=lambda n: excess[n][0])
    over, _, small = excess[worst]
    if d["reason"] == "small_effects":
        worst = max(excess, key=lambda n: excess[n][0] / max(excess[n][2], 1e-12))
        over, _, small = excess[worst]
        return (
            f"On the held-out data that decide, {worst} errs by {_percent(over)} beyond the noise; effects of {_percent(c['small'], 0)} of the typical force, as every rig has "
            f"them, leave up to {_percent(small)}."
        )
    if d["reason"] == "closed_by_small":
        return (
            f"Effects of at most {_percent(e['closest_share'])} of the force at their places close the gap (an effect is named from "
            f"{_percent(c['share'], 0)} on)."
        )
    if d["reason"] == "noise":
        worst = max(excess, key=lambda n: excess[n][0] / max(excess[n][1], 1e-12))
        over, floor, _ = excess[worst]
        return f"On the held-out data that decide, {worst} errs by {_percent(over)} beyond the noise of {_percent(floor)}, and no known effect reduces it."
    if d["reason"] == "doubtful_sensor":
        return f"A sensor may be to blame for the rest, but is not named: {failures(d['gates'])}."
    if d["reason"] == "immaterial":
        return (
            f"On the held-out data that decide, no channel errs by more than {_percent(over)} of its standard deviation beyond the noise "
            f"(limit {_percent(c['material'], 0)})."
        )
    return ""


def _changes(d: Mapping[str, Any]) -> str:
    """Parameters whose 95 % interval leaves out the value of the model, largest change first."""
    if d["verdict"] != "parameters_only":
        return ""
    moved = [
        (abs(q["value"] / q["prior"] - 1.0), path, q)
        for path, q in d["parameters"].items()
        if q.get("prior") and None not in (q["value"], q["low"], q["high"])
        and not q["low"] <= q["prior"] <= q["high"]
    ]  # fmt: skip
    told = [
        f"{path} from {plain_number(q['prior'])} to {plain_number(q['value'])} {q['unit']} ({q['value'] / q['prior'] - 1.0:+.1%})"
        for _, path, q in sorted(moved, key=lambda t: -t[0])[:CHANGES]
    ]
    more = f" and {len(moved) - CHANGES} more" if len(moved) > CHANGES else ""
    return f"Largest changes: {', '.join(told)}{more}." if told else ""


# --------------------------------------------------------------------------------------------------- for all of them


def _small(d: Mapping[str, Any]) -> str:
    found = d["small_effects"]
    if not found:
        return ""
    seen, least = d["evidence"]["effects"], d["criteria"]["share"]
    names = " and ".join(described(e) for e in found)
    shares = " and ".join(f"{_percent(x['share'])}" for x in seen)
    if all((x["share"] or 0.0) < least for x in seen):
        return f"Too small to be named: {names}, {shares} of the force, current or signal at its place (needed {_percent(least, 0)})."
    return f"Seen, but not named: {names}, {shares} of the force, current or signal at its place; it fails {failures(d['gates'])}."


def _noise(d: Mapping[str, Any]) -> str:
    e = d["evidence"]
    if d["verdict"] not in ("no_discrepancy", "parameters_only", "unknown_effect"):
        return ""
    rows = zip(e["channels"], e["noise"], e["noise_known"], strict=True)
    bounded = [f"{name} (at most {_percent(floor)})" for name, floor, known in rows if not known]
    if not bounded:
        return ""
    return f"These data only bound the noise of {', '.join(bounded)}: state 'noise' of the output in the model file where you know it."


def _limits(d: Mapping[str, Any]) -> str:
    final = d["verdict"] == "missing_effect" or not d["gates"]
    asked = d["evidence"]["limits" if final else "refit_limits"]
    if not asked:
        return ""
    return f"At the limit that their stated uncertainty allows: {', '.join(asked)}. Check these values."


def _closed_loop(d: Mapping[str, Any]) -> str:
    found = d.get("closed_loop")
    if not found:
        return ""
    inputs = [
        f"{f['input']} follows from {' and '.join(f['outputs'])}: past outputs explain {_percent(f['share'], 0)} of what its own "
        "past leaves unpredicted"
        for f in found
    ]
    return (
        f"The records are of a closed loop ({'; '.join(inputs)}). A controller's law can look like an element, such as a spring to the "
        "ground. Repeat the test with an input that does not depend on the outputs."
    )


def _stretches(d: Mapping[str, Any]) -> str:
    s = d["stretches"]
    if not s:
        return ""
    low, high = f"{s['shortest']:.2g}", f"{s['longest']:.2g}"
    length = f"{low} s" if low == high else f"{low} to {high} s"
    why = {
        "diverges": "the simulation of the refitted model breaks down over whole records",
        "astray": f"over whole records the refitted model errs by {_percent(s['error'])} of the deviation (limit {_percent(s['limit'], 0)})",
        "unnamed": "over whole records no name passes every gate",
        "feedback": "under feedback whole records are no valid comparison",
    }[s["reason"]]
    return f"Compared over {s['count']} stretches of {length}, each from an initial state of its own: {why}."
