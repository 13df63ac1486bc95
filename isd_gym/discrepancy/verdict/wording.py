"""The summary of a diagnosis, written from the numbers of its JSON document alone."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ...elements import TYPES

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

#: an addition that makes the error on the test records larger
NOT_BORNE_OUT = (
    "On the test records the error is larger with this addition: confirm the addition with a new record."
)
#: error of which a candidate removes a share (`Evidence.explained`)
EXCESS = "the squared held-out error beyond noise"
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
        document: JSON document of the diagnosis (`isd-diagnosis/1`); its `summary` is not read.

    Returns:
        Sentences: the finding with its figures, the reason, the limits of the data, and what to do next.
    """
    verdict = document["verdict"]
    if verdict == "missing_effect":
        parts = [_missing(document), _remaining(document)]
    elif verdict == "ambiguous":
        parts = [_likely(document), _ambiguous(document)]
    elif verdict == "unknown_effect":
        parts = [_unknown(document), _likely(document), _best_candidate(document), _table(document)]
    else:
        parts = [_agreement(document), _reason(document), _changes(document)]
    if verdict in {"missing_effect", "ambiguous", "unknown_effect"}:
        parts += [_worse_refit(document), _worse_than_constant(document)]
    parts += [
        _small(document),
        _noise(document),
        _limits(document),
        _stretches(document),
        _simulation_fit(document),
        _closed_loop(document),
    ]
    return " ".join(p for p in parts if p)


def unit_summary_of(document: Mapping[str, Any]) -> str:
    """Return the summary of a diagnosis whose model is an FMU."""
    gap, verdict = document["gap"]["held_out"], document["verdict"]
    if verdict == "no_discrepancy":
        worst = _widest(gap)
        text = f"The FMU agrees with the measurements; no effect is missing ({_errors(gap, worst, 'refit')})."
    elif verdict == "parameters_only":
        most = _most_gained(gap, "before", "refit")
        text = f"Refitted parameters explain the difference; no effect is missing ({_errors(gap, most, 'before', 'refit')})."
    else:
        worst = _widest(gap)
        parts = [
            f"An effect is missing that no parameter values of the FMU explain ({_errors(gap, worst, 'before', 'refit')}).",
            _where(document),
            "The equations inside an FMU are hidden. To find the effect and its place, diagnose a network model of the rig (isd-model/1).",
            *(
                f"A constant offset is {_percent(share, 0)} of the squared error in {name}: check the zero of the sensor."
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
    figures = ", ".join(_parameter(k, q) for k, q in effect["parameters"].items() if q["value"] is not None)
    return f"{what} {spot} ({figures})"


def _parameter(name: str, quantity: Mapping[str, Any]) -> str:
    """Return a parameter with its value and unit, such as ``level 1.2 N`` or ``exponent 2``."""
    unit = "" if quantity["unit"] == "-" else f" {quantity['unit']}"
    return f"{name.replace('_', ' ')} {plain_number(quantity['value'])}{unit}"


def candidate_text(candidate: Mapping[str, Any]) -> str:
    """Return the effects of a candidate (an item of `alternatives`, or `best_candidate`) with their places."""
    named = zip(candidate["effects"], candidate["where"], strict=True)
    return " and ".join(f"{effect.replace('_', ' ')} {_spot(where)}" for effect, where in named)


def _spot(where: Sequence[str]) -> str:
    return _between(where) if len(where) == 2 else f"at {' and '.join(where)}"


def _between(nodes: Iterable[str]) -> str:
    return f"between {' and '.join(nodes)}"


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]


def _percent(value: float | None, digits: int = 1) -> str:
    return "an unknown share" if value is None else f"{round(100 * value, digits) + 0.0:.{digits}f} %"


def _errors(gap: Mapping[str, Mapping[str, float]], channel: str, *stages: str) -> str:
    """Return the errors of a channel, such as ``error in travel: 40.0 % before, 30.0 % refitted, noise 2.0 %``."""
    words = {"before": " before", "refit": " refitted"}
    stated = [f"{_percent(gap[s][channel])}{words[s] if len(stages) > 1 else ''}" for s in stages]
    noise = _percent(gap["noise_floor"][channel])
    return f"error in {channel}: {', '.join(stated)}, noise {noise}"


def _square(value: float | None) -> float:
    return float("inf") if value is None else value**2


def _widest(gap: Mapping[str, Mapping[str, float]]) -> str:
    """Return the channel with the largest error of the refitted model."""
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
        f"The model lacks {found}. With {'these effects' if len(d['effects']) > 1 else 'this effect'} the error in {c} on held-out "
        f"data {'falls' if down else 'rises'} from {_percent(gap['refit'][c])} to {_percent(gap['after'][c])} "
        f"(noise {_percent(gap['noise_floor'][c])})."
    )
    return text if down else f"{text} {NOT_BORNE_OUT}"


def _worse_refit(d: Mapping[str, Any]) -> str:
    """Return a sentence where the refitted model errs more on held-out data than the model as given, by a material share."""
    gap = d["gap"]["held_out"]
    c = _most_gained(gap, "refit", "before")
    given, refit = gap["before"][c], gap["refit"][c]
    if not _square(refit) - _square(given) >= d["criteria"]["material"] ** 2:
        return ""
    return (
        f"On held-out data the refitted model errs more in {c} ({_percent(refit)}) than the model as given ({_percent(given)}): the share "
        "of the error that an addition removes is relative to the refitted model."
    )


def _worse_than_constant(d: Mapping[str, Any]) -> str:
    """Return a sentence where the refitted model errs more on held-out data than the mean of each record."""
    gap = d["gap"]["held_out"]
    c = _widest(gap)
    if not _square(gap["refit"][c]) > 1.0:
        return ""
    return (
        f"The refitted model errs more in {c} than a constant would ({_percent(gap['refit'][c])} of the deviation): first check values, "
        "stated uncertainty, signs and units of the model."
    )


def _remaining(d: Mapping[str, Any]) -> str:
    left = d["remainder"]
    if not left:
        return ""
    most = f", largest when {left['when']}" if left["when"] != "everywhere" else ""
    text = (
        f"An error of {_percent(left['after'])} in {left['channel']} remains (noise {_percent(left['noise_floor'])}){most}. "
        "Another effect may be missing."
    )
    if left["candidate"]:
        text += (
            f" The closest further effect, {candidate_text(left['candidate'])}, would reduce the error to "
            f"{_percent(left['candidate']['error'])} and was not kept."
        )
    return text


def _likely(d: Mapping[str, Any]) -> str:
    """Return the most specific statements that are likely, with probabilities: kinds, or else places that are certain."""
    certain, findings = d["criteria"]["certain"], d["findings"]
    kinds = [
        f for f in findings if f["kind"] != "other" and f["kind_probability"] >= d["criteria"]["probable"]
    ]
    sentences = []
    for f in kinds:
        explains = (
            "explains the error"
            if f["kind_probability"] >= certain
            else "probably explains a part of the error"
        )
        if not f["place"]:
            open_places = " or ".join(
                f"{_spot(g['place'])} ({g['place_probability']:.2f})"
                for g in findings
                if g["place"] and g["kind"] == f["kind"]
            )
            sentences.append(
                f"{KINDS[f['kind']]} {explains} (probability {f['kind_probability']:.2f}), but the data do not determine "
                f"its place: {open_places}."
            )
            continue
        laws = " or ".join(
            f"{law['effect'].replace('_', ' ')} (probability {law['probability']:.2f}{_law_values(law)})"
            for law in f["laws"][:LAWS]
            if law is f["laws"][0] or law["probability"] >= d["criteria"]["reported"]
        )
        sentences.append(
            f"{KINDS[f['kind']]} {_spot(f['place'])} {explains} (probability {f['kind_probability']:.2f}). "
            f"Likeliest: {laws}."
        )
    if not kinds:
        places = {
            tuple(f["place"]): f["place_probability"] for f in findings if f["place_probability"] >= certain
        }
        sentences = [
            f"An effect is missing {_spot(place)} (probability {chance:.2f}); the data do not determine its kind."
            for place, chance in places.items()
        ]
    others = [
        f
        for f in findings
        if f not in kinds
        and f["kind"] not in {"other", *(g["kind"] for g in kinds if not g["place"])}
        and f["kind_probability"] >= POSSIBLE
    ]
    # candidates without the likeliest kind have the rest of the weight: a kind that is twice as likely stands mostly beside it
    rest = 1.0 - max((f["kind_probability"] for f in kinds), default=0.0)
    for words, told in (
        ("Perhaps beside it", [f for f in others if f["kind_probability"] > 2.0 * rest]),
        ("Also possible", [f for f in others if f["kind_probability"] <= 2.0 * rest]),
    ):
        if kinds and told:
            listed = (
                f"{KINDS[f['kind']].lower()} {_spot(f['place'])} (probability {f['kind_probability']:.2f})"
                for f in told
            )
            sentences.append(f"{words}: {' or '.join(listed)}.")
    return " ".join(sentences)


def _law_values(law: Mapping[str, Any]) -> str:
    values = [_parameter(k, q) for k, q in law["parameters"].items()]
    return f", {', '.join(values)}" if values else ""


def _ambiguous(d: Mapping[str, Any]) -> str:
    rivals = d["alternatives"]
    if d["reason"] == "kind_certain":
        best = d["best_candidate"]
        return (
            f"The law is not certain: {candidate_text(best)} removes {_percent(best['explained'], 0)} of {EXCESS}, "
            f"but fails {failures(best['failed_gates'])}."
        )
    if len(rivals) > 1:
        names = " or ".join(f"{candidate_text(r)} (leaves {_left(r)})" for r in rivals)
        text = (
            f"An effect is missing, and these data do not decide between {len(rivals)} explanations: {names}."
        )
    else:
        text = (
            f"An effect is missing. {_capital(candidate_text(d['best_candidate']))} explains the error, but fails "
            f"{failures(d['best_candidate']['failed_gates'])}."
        )
    test = d["next_experiment"]
    return f"{text} Next: run the test in next_experiment.csv." if test else text


def _left(rival: Mapping[str, Any]) -> str:
    excess = rival["excess"]
    return "an unknown share" if excess is None else f"{_percent(max(excess, 0.0))} of the error beyond noise"


def _unknown(d: Mapping[str, Any]) -> str:
    gap = d["gap"]["held_out"]
    c = _widest(gap)
    return f"An effect is missing, and no known effect passes every gate ({_errors(gap, c, 'before', 'refit')}). {_where(d)}".rstrip()


def _where(d: Mapping[str, Any]) -> str:
    if not d["where"] or not d["where"][0]["share"]:
        return ""
    first = d["where"][0]
    most = f"; the gap is largest when {first['when']}" if first["when"] != "everywhere" else ""
    return f"{_percent(first['share'], 0)} of the gap is in {first['channel']}{most}."


def _best_candidate(d: Mapping[str, Any]) -> str:
    best = d["best_candidate"]
    if best is None:
        return "No known effect reduces the held-out error by enough to be kept."
    error = best["error"]
    c = _most_gained(error, "refit", "after")
    down = _square(error["after"][c]) <= _square(error["refit"][c])
    failed = [g for g in best["failed_gates"] if not g["passed"]]
    return (
        f"The best candidate, {candidate_text(best)}, {'reduces' if down else 'raises'} the error in {c} from "
        f"{_percent(error['refit'][c])} to {_percent(error['after'][c])} and fails {len(failed)} of {len(d['gates'])} gates: "
        f"{failures(failed)}."
    )


def _table(d: Mapping[str, Any]) -> str:
    t, tried = d["tabulated"], d["best_table"]
    if t:
        near = ", ".join(f"{x['effect'].replace('_', ' ')} {_percent(x['share'], 0)}" for x in t["nearest"])
        alone = ", ".join(
            f"{OVER[k].removeprefix('their ')} alone {_percent(v, 0)}" for k, v in t["shares"].items()
        )
        text = (
            f"A force {_between(t['between'])} that depends on {OVER[t['over']]} removes {_percent(t['explained'], 0)} of {EXCESS}. "
            f"In model.json the force is the table '{t['element']}'."
        )
        text += f" Share of its power by argument: {alone}." if alone else ""
        text += f" Share of its power that the nearest known laws give: {near}." if near else ""
        closed = d["gap"]["closed"]
        return f"{text} {NOT_BORNE_OUT}" if closed is not None and closed < 0 else text
    if tried is None:
        return "No table of a force between two nodes could be fitted."
    explains = next(g for g in tried["gates"] if g["gate"] == "explains")
    text = (
        f"The best table of a force, {_between(tried['between'])} over {OVER[tried['over']]}, removes "
        f"{_percent(tried['explained'], 0)} of {EXCESS}"
    )
    if not explains["passed"]:
        return (
            f"{text} (needed {_percent(explains['limit'], 0)}). The missing force may depend on time, on its own past, on an input, or "
            "on a motion that no sensor measures."
        )
    failed = failures(tried["gates"])
    return f"{text}, but fails {failed}." if failed else f"{text}, but its interval cannot be computed."


def _agreement(d: Mapping[str, Any]) -> str:
    gap, least = d["gap"]["held_out"], d["criteria"]["material"] ** 2
    refit, noise = gap["refit"], gap["noise_floor"]
    worst = max(refit, key=lambda c: _square(refit[c]) - _square(noise[c]))
    if _square(refit[worst]) - _square(noise[worst]) > least:
        return f"No missing effect can be named ({_errors(gap, worst, 'before', 'refit')})."
    if d["verdict"] == "no_discrepancy":
        return (
            f"The model agrees with the measurements; no effect is missing ({_errors(gap, worst, 'refit')})."
        )
    most = _most_gained(gap, "before", "refit")
    return f"Refitted parameters explain the difference; no effect is missing ({_errors(gap, most, 'before', 'refit')})."


def _reason(d: Mapping[str, Any]) -> str:
    e, c = d["evidence"], d["criteria"]
    rows = zip(e["channels"], e["refit"], e["noise"], e["envelope"], strict=True)
    excess = [
        (name, max(_square(r) - _square(f), 0.0) ** 0.5, f, w)
        for name, r, f, w in rows
        if None not in (r, f, w)
    ]
    if not excess:
        return ""
    if d["reason"] == "small_effects":
        worst, over, _, small = max(excess, key=lambda x: x[1] / max(x[3], 1e-12))
        return (
            f"On validation data the error in {worst} beyond noise is {_percent(over)}. Unmodelled effects of {_percent(c['small'], 0)} of "
            f"the typical force, which every rig has, leave up to {_percent(small)}."
        )
    if d["reason"] == "closed_by_small":
        return (
            f"Effects of at most {_percent(e['richest_share'])} of the force at their places close the gap. A name needs at least "
            f"{_percent(c['share'], 0)}."
        )
    if d["reason"] == "noise":
        worst, over, floor, _ = max(excess, key=lambda x: x[1] / max(x[2], 1e-12))
        return f"On validation data the error in {worst} beyond noise is {_percent(over)} (noise {_percent(floor)}), and no known effect reduces the error."
    if d["reason"] == "doubtful_sensor":
        return f"A sensor fault may explain the rest, but fails {failures(d['gates'])}."
    if d["reason"] == "immaterial":
        return (
            f"On validation data the error beyond noise is at most {_percent(max(x[1] for x in excess))} of the standard deviation in every channel "
            f"(limit {_percent(c['material'], 0)})."
        )
    return ""


def _changes(d: Mapping[str, Any]) -> str:
    """Return the parameters whose 95 % interval excludes the value of the nominal model, largest change first."""
    if d["verdict"] != "parameters_only":
        return ""
    moved = [
        (abs(q["value"] / q["prior"] - 1.0), path, q)
        for path, q in d["parameters"].items()
        if q.get("prior") and None not in (q["value"], q["low"], q["high"])
        and not q["low"] <= q["prior"] <= q["high"]
    ]  # fmt: skip
    stated = [
        f"{path} from {plain_number(q['prior'])} to {plain_number(q['value'])} {q['unit']} ({q['value'] / q['prior'] - 1.0:+.1%})"
        for _, path, q in sorted(moved, key=lambda t: -t[0])[:CHANGES]
    ]
    more = f" and {len(moved) - CHANGES} more" if len(moved) > CHANGES else ""
    return f"Largest changes: {', '.join(stated)}{more}." if stated else ""


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
    return f"Detected but not named: {names}, {shares} of the force, current or signal at its place; the effect fails {failures(d['gates'])}."


def _noise(d: Mapping[str, Any]) -> str:
    e = d["evidence"]
    if d["verdict"] not in ("no_discrepancy", "parameters_only", "unknown_effect"):
        return ""
    rows = zip(e["channels"], e["noise"], e["noise_known"], strict=True)
    bounded = [f"{name} (at most {_percent(floor)})" for name, floor, known in rows if not known]
    if not bounded:
        return ""
    return f"These data give only an upper bound on the noise of {', '.join(bounded)}. If you know the noise, state 'noise' of the output in the model file."


def _limits(d: Mapping[str, Any]) -> str:
    final = d["verdict"] == "missing_effect" or not d["gates"]
    asked = d["evidence"]["limits" if final else "refit_limits"]
    if not asked:
        return ""
    return f"Parameters at the limit of their stated uncertainty: {', '.join(asked)}. Check their values."


def _closed_loop(d: Mapping[str, Any]) -> str:
    found = d.get("closed_loop")
    if not found:
        return ""
    inputs = [
        f"past {' and '.join(f['outputs'])} explain {_percent(f['share'], 0)} of the part of {f['input']} that the past of "
        f"{f['input']} does not predict"
        for f in found
    ]
    return (
        f"The records are of a closed loop: {'; '.join(inputs)}. A control law can look like an element, such as a spring to the "
        "ground. Next: repeat the test with an input that does not depend on the outputs."
    )


def _simulation_fit(d: Mapping[str, Any]) -> str:
    """Return sentences on the last fit, and on its values outside the intervals of the search."""
    fit = d.get("simulation_fit")
    if not fit:
        return ""
    before, after = fit["data"]["before"], fit["data"]["after"]
    c = max(before, key=lambda name: _square(before[name]) - _square(after[name]))
    text = (
        f"model.json is fitted once more to all training data for the smallest error of its simulation, which falls from "
        f"{_percent(before[c])} to {_percent(after[c])} in {c}; the other figures are those of the search."
    )
    moved = [
        f"{path} {plain_number(fit['values'][path])} {q['unit']} ({plain_number(q['low'])} to {plain_number(q['high'])})"
        for path, q in fit["outside"].items()
    ]
    return (
        f"{text} Values of the last fit outside the interval of the search: {', '.join(moved)}."
        if moved
        else text
    )


def _stretches(d: Mapping[str, Any]) -> str:
    s = d["stretches"]
    if not s:
        return ""
    low, high = f"{s['shortest']:.2g}", f"{s['longest']:.2g}"
    length = f"{low} s" if low == high else f"{low} to {high} s"
    why = {
        "diverges": "the refitted model diverges over whole records",
        "astray": f"over whole records the mean error of the refitted model is {_percent(s['error'])} (limit {_percent(s['limit'], 0)})",
        "unnamed": "over whole records no candidate passes every gate",
        "feedback": "feedback makes a comparison of whole records invalid",
    }[s["reason"]]
    return f"These are errors over {s['count']} stretches of {length}, each with its own initial state, because {why}."
