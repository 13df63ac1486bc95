"""The summary of a diagnosis, written from the numbers of its JSON document alone."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ..._common.units import practical
from ...physics.elements import TYPES, spoken

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

#: an addition that makes the error on the test records larger
NOT_BORNE_OUT = "On the test records the error is larger with this addition."
#: what to do about a failed gate, most urgent first
ADVICE = {
    "sensor": "check the zero, the scale and the clock of the sensor before you trust a fault of it",
    "distinguishable": "record another excitation: other amplitudes, speeds or frequencies",
    "lack of fit": "compare the curve of the missing force with a law of your own (--elements): no known law has its shape",
    "adequate": "record slow motions, steps and other loads, and log further inputs: the candidate alone does not explain the records",
    "confirmed": "repeat the test: the test records do not confirm the candidate",
    "determined": "record a test in which the effect is larger, or state smaller uncertainties of the parameters that you know",
    "probable": "record more data of the same kind: several candidates share the probability",
    "material": "record larger amplitudes: the effect is small in these records",
    "predicts better": "record more data of the same kind: the gain is within its statistical error",
}
#: error of which a candidate removes a share (`Evidence.explained`)
EXCESS = "the squared held-out error beyond noise"
RELATIONS = {"<": "below", "<=": "at most", ">": "above", ">=": "at least"}
OVER = {"rate": "their rate", "elongation": "their distance", "both": "their distance and rate"}
#: parameters whose change is stated; laws of a kind that are stated
CHANGES, LAWS = 2, 2
#: probability from which on a further kind is mentioned, and from which on the title mentions a kind
POSSIBLE, PERHAPS = 0.2, 0.4
#: groups of records whose values are stated one by one; records of a group that are named
MOST_GROUPS, MOST_NAMES = 4, 5
#: ratio of the amplitudes of two groups of records from which on the groups differ in amplitude
UNLIKE = 1.3
#: test on the rig that shows whether an effect of a kind is there
TESTS = {
    "dry_friction": "move {parts} against each other slowly, at two or three constant speeds in both directions, and log the force: dry "
    "friction turns its sign with the motion and does not grow with the speed",
    "viscous": "move {parts} against each other at several constant speeds in both directions and log the force: a viscous force follows "
    "the speed, not the travel",
    "elastic": "move {parts} against each other slowly through the whole travel, out and back, and log the force: an elastic force is the "
    "same both ways",
    "play": "turn a slow motion of {parts} round at several positions and log the force: with play the travel changes and the force does not",
    "inertial": "shake {parts} with one amplitude at several frequencies and log the force: an inertia force grows with the square of the "
    "frequency",
    "position_periodic": "move {parts} against each other slowly and steadily through several periods and log the force: its pattern "
    "repeats with the position",
    "series_compliance": "load {parts} in steps and measure the deflection of each link between them: the compliance gives way under the load",
    "drive": "hold the mechanism, command steps and slow ramps of several sizes, and log the force: it must follow the command as the model says",
    "sensor": "compare the sensor with a reference at rest and in slow motion: zero, scale, sign and clock",
    "constant": "bring {parts} to rest from both sides and log the force: a constant force is the mean of both",
}
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


@dataclass(frozen=True)
class Statements:
    """Sentences about a diagnosis, by their use."""

    #: what is missing, in a line
    title: str
    #: what was found and how far it goes
    finding: tuple[str, ...]
    #: limits of the data and of the model
    remarks: tuple[str, ...]
    #: what to do next
    next_steps: tuple[str, ...]

    @property
    def text(self) -> str:
        """All sentences but the title."""
        steps = [f"Next: {step}" for step in self.next_steps]
        return " ".join(s for s in (*self.finding, *self.remarks, *steps) if s)


def summary_of(document: Mapping[str, Any]) -> str:
    """Return the summary of a diagnosis: the finding, the limits of the data, and what to do next.

    Args:
        document: JSON document of the diagnosis (`isd-diagnosis/1`); its `summary` is not read.

    Returns:
        Sentences.
    """
    return statements_of(document).text


def statements_of(document: Mapping[str, Any]) -> Statements:
    """Return the sentences about a diagnosis of a network.

    Args:
        document: JSON document of the diagnosis (`isd-diagnosis/1`); its `summary` is not read.

    Returns:
        Sentences by their use.
    """
    verdict, remarks = document["verdict"], []
    if verdict == "missing_effect":
        finding = [_missing(document), *map(_same_force, document["effects"]), _remaining(document)]
    elif verdict == "ambiguous":
        finding = [_ambiguous(document)]
        remarks = [_likely(document)]
        if document["reason"] == "kind_certain":
            finding, remarks = [*remarks, *finding], []
    elif verdict == "unknown_effect" and document["reason"] == "records_differ":
        finding, remarks = (
            [_record_differences(document)],
            [_likely(document), _best_candidate(document), _unnamed(document)],
        )
    elif verdict == "unknown_effect":
        table, shape = _table(document)
        likely, best = _likely(document), _best_candidate(document)
        finding, remarks = [likely, best], [_unknown(document), _unnamed(document), table]
        if document["tabulated"]:
            finding, remarks = [table, best], [likely, *remarks[:2], shape]
        elif not likely:
            finding, remarks = [remarks[0], best], remarks[1:]
        remarks.append(_where(document))
    else:
        finding = [_agreement(document), _reason(document), _changes(document)]
    if document.get("record_differences") and document["record_differences"]["tied"]:
        finding.append(_record_differences(document))
    if verdict not in ("no_discrepancy", "parameters_only"):
        remarks.append(_worse_refit(document))
    if _is_open(document):
        remarks.append(_worse_than_constant(document))
    remarks += [
        _small(document),
        _noise(document),
        _limits(document),
        _stretches(document),
        _simulation_fit(document),
        _closed_loop(document),
    ]
    finding.append(_not_tried(document))
    steps = [*_urgent(document), _test_of_kind(document), _next(document)]
    return Statements(_title(document), _kept(finding), _kept(remarks), _kept(steps))


def _not_tried(d: Mapping[str, Any]) -> str:
    """Return what the limit of the time left out; empty where nothing was left out."""
    if not d.get("not_tried"):
        return ""
    limit = plain_number(d["search"]["max_seconds"])
    return (
        f"The time limit of {limit} s ended the diagnosis early. Not tried: {', '.join(d['not_tried'])}. "
        "The result rests on the rest of the search."
    )


def unit_summary_of(document: Mapping[str, Any]) -> str:
    """Return the summary of a diagnosis whose model is an FMU.

    Args:
        document: JSON document of the diagnosis (`isd-diagnosis/1`); its `summary` is not read.

    Returns:
        Sentences.
    """
    return unit_statements_of(document).text


def unit_statements_of(document: Mapping[str, Any]) -> Statements:
    """Return the sentences about a diagnosis of an FMU.

    Args:
        document: JSON document of the diagnosis (`isd-diagnosis/1`); its `summary` is not read.

    Returns:
        Sentences by their use.
    """
    gap, verdict = document["gap"]["held_out"], document["verdict"]
    title, steps, remarks = _title(document), [_next(document)], [_noise(document), _limits(document)]
    if verdict == "no_discrepancy":
        finding = [
            f"The FMU agrees with the measurements; no effect is missing ({_errors(document, _widest(gap), 'refit')})."
        ]
    elif verdict == "parameters_only":
        most = _most_gained(gap, "before", "refit")
        finding = [
            f"Refitted parameters explain the difference; no effect is missing ({_errors(document, most, 'before', 'refit')})."
        ]
        steps = [
            "use the refitted parameters (parameters.ssv), and test them with a record of another excitation."
        ]
    else:
        title = "An effect is missing that no parameter of the FMU explains"
        finding = [
            f"An effect is missing that no parameter values of the FMU explain ({_errors(document, _widest(gap), 'before', 'refit')}).",
            _where(document),
        ]
        shifted = [n for n, share in document["constant"].items() if share is not None and share > 0.5]
        remarks = [
            *(
                f"A constant offset is {_percent(document['constant'][n], 0)} of the squared error in {n}."
                for n in shifted
            ),
            *remarks,
        ]
        steps = [f"check the zero of the sensor of {n}." for n in shifted]
        steps.append(
            "diagnose a network model of the rig (isd-model/1): the equations inside an FMU are hidden, so the effect and its place are not searched."
        )
    return Statements(title, _kept(finding), _kept(remarks), _kept(steps))


def _kept(sentences: Iterable[str]) -> tuple[str, ...]:
    """Return the sentences that are not empty, each once."""
    return tuple(dict.fromkeys(s for s in sentences if s))


def _is_open(d: Mapping[str, Any]) -> bool:
    """Return whether an effect is missing and neither its name nor its kind is certain."""
    return d["verdict"] in ("ambiguous", "unknown_effect") and d["reason"] != "kind_certain"


# ---------------------------------------------------------------------------------------------- numbers and names


def plain_number(value: float | None, digits: int = 4) -> str:
    """Return significant digits, without an exponent for values from 1e4 to 1e7; ``unknown`` for None."""
    if value is None:
        return "unknown"
    text = f"{value:.{digits}g}"
    return np.format_float_positional(float(text), trim="-") if 1e4 <= abs(value) < 1e7 else text


def described(effect: Mapping[str, Any]) -> str:
    """Return an effect of the JSON with its place and values."""
    figures = ", ".join(_parameter(k, q) for k, q in effect["parameters"].items() if q["value"] is not None)
    return f"{_placed(effect)} ({figures})"


def _same_force(effect: Mapping[str, Any]) -> str:
    """Return the two laws that together give the same force as an asymmetric friction; empty for another effect."""
    if effect["effect"] != "asymmetric_friction":
        return ""
    forward, back = effect["parameters"]["extension"], effect["parameters"]["compression"]
    level, offset = 0.5 * (forward["value"] + back["value"]), 0.5 * (forward["value"] - back["value"])
    unit = forward["unit"]
    return (
        f"Coulomb friction of {plain_value(level, unit)} and a constant force of {plain_value(offset, unit)} are the same "
        "force: an offset of a load or of a sensor looks like this."
    )


def _placed(effect: Mapping[str, Any]) -> str:
    """Return an effect of the JSON with its place."""
    kind = TYPES.get(effect["effect"])
    if "channel" in effect:
        return f"{spoken(effect['effect'])} in channel {effect['channel']}"
    spot = _between(effect["between"] or ())
    if kind is not None and kind.series:
        spot = f"in series with {effect.get('behind') or 'all elements'} {spot}"
    return f"{spoken(effect['effect'])}{',' if kind is not None and kind.series else ''} {spot}"


def _parameter(name: str, quantity: Mapping[str, Any]) -> str:
    """Return a parameter with its value and unit, such as ``level 1.2 N`` or ``exponent 2``."""
    return f"{spoken(name)} {plain_value(quantity['value'], quantity['unit'])}"


def plain_value(value: float | None, unit: str) -> str:
    """Return a value with four digits in a practical unit, such as ``0.79 mm`` for 0.00079 m."""
    factor, unit = (1.0, unit) if value is None else practical(value, unit)
    text = plain_number(None if value is None else factor * value)
    return text if unit in ("", "-") else f"{text} {unit}"


def _in_unit_of(other: float, value: float, unit: str) -> str:
    """Return a value in the practical unit of another value, without the unit."""
    return plain_number(practical(other, unit)[0] * value)


def candidate_text(candidate: Mapping[str, Any]) -> str:
    """Return the effects of a candidate (an item of `alternatives`, or `best_candidate`) with their places."""
    named = zip(candidate["effects"], candidate["where"], strict=True)
    return " and ".join(f"{spoken(effect)} {_spot(where)}" for effect, where in named)


def _spot(where: Sequence[str]) -> str:
    return _between(where) if len(where) == 2 else f"at {' and '.join(where)}"


def _between(nodes: Iterable[str]) -> str:
    return f"between {' and '.join(nodes)}"


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]


def _percent(value: float | None, digits: int = 1) -> str:
    return "an unknown share" if value is None else f"{round(100 * value, digits) + 0.0:.{digits}f} %"


def _errors(d: Mapping[str, Any], channel: str, *stages: str) -> str:
    """Return the errors of a channel, such as ``error in travel: 40.0 % before, 30.0 % refitted, noise 2.0 %``."""
    words = {"before": " before", "refit": " refitted"}
    gap = d["gap"]["held_out"]
    stated = [f"{_percent(gap[s][channel])}{words[s] if len(stages) > 1 else ''}" for s in stages]
    return f"error in {channel}: {', '.join(stated)}, {_noise_of(d, channel)}"


def _noise_of(d: Mapping[str, Any], channel: str) -> str:
    """Return the noise of a channel, or its bound where the data give no more."""
    e = d["evidence"]
    known = dict(zip(e["channels"], e["noise_known"], strict=True)).get(channel, True)
    noise = d["gap"]["held_out"]["noise_floor"][channel]
    if noise is not None and 0.0 < noise < 5e-4:
        return "noise below 0.1 %"
    return f"noise {'' if known else 'at most '}{_percent(noise)}"


def _square(value: float | None) -> float:
    return float("inf") if value is None else value**2


def _widest(gap: Mapping[str, Mapping[str, float]]) -> str:
    """Return the channel with the largest error of the refitted model."""
    return max(gap["refit"], key=lambda c: _square(gap["refit"][c]))


def _most_gained(gap: Mapping[str, Mapping[str, float]], old: str, new: str) -> str:
    return max(gap[old], key=lambda c: _square(gap[old][c]) - _square(gap[new][c]))


#: what a failed gate means, by name and relation; the subject is 'it'
FAILURES = {
    ("predicts better", ">"): "its better prediction may be chance",
    ("material", ">"): "its part in the error is too small",
    ("material", ">="): "it is too small",
    ("adequate", "<"): "it leaves more than the small effects that every rig has",
    ("adequate", "<="): "the fitted records do not agree with it",
    ("determined", "<="): "its values contradict its name",
    ("lack of fit", "<"): "another curve in its place fits better",
    ("confirmed", "<"): "it leaves more of the test records than the small effects that every rig has",
    ("sensor", ">="): "a force explains nearly as much as the fault of a sensor",
    ("open loop", "<="): "the law of a controller may look like it",
    ("open loop", "<"): "the law of a controller may look like it",
}


def failures(gates: Iterable[Mapping[str, Any]]) -> str:
    """Return what the failed gates mean, such as ``its values are uncertain by 95 %``."""
    *first, last = [_failure(g) for g in gates if not g["passed"]] or [""]
    return f"{', '.join(first)} and {last}" if first else last


def _failure(g: Mapping[str, Any]) -> str:
    name, value, limit = g["gate"], g["value"], g["limit"]
    if value is not None and g["relation"] == ">=" and name in ("adequate", "confirmed", "explains"):
        records = "the test records" if name == "confirmed" else "the validation records"
        if value < 0.0:
            return f"it increases the squared error on {records}"
        digits = 1 if round(100.0 * value) == round(100.0 * limit) else 0
        return f"it leaves {_percent(1.0 - value, digits)} of the squared error on {records} (at most {_percent(1.0 - limit, digits)})"
    if value is not None and name == "determined" and g["relation"] == "<":
        return (
            "a 95 % interval of its values contains zero"
            if value >= 1.0
            else f"its values are uncertain by {_percent(value, 0)} (less than {_percent(limit, 0)} needed)"
        )
    if value is not None and name == "probable":
        return f"other candidates are at least as likely (its probability is {_percent(value, 0)}, needed {_percent(limit, 0)})"
    if value is not None and name == "distinguishable":
        return f"{value:.0f} other {'laws predict' if value > 1 else 'law predicts'} as well"
    if value is not None and name == "not the controller":
        return f"the controller's input explains {_percent(value, 0)} of its force (less than {_percent(limit, 0)} needed)"
    known = FAILURES.get((name, g["relation"]))
    return (
        known
        or f"{name} is {plain_number(value, 3)} (needed {RELATIONS[g['relation']]} {plain_number(limit, 3)})"
    )


# ------------------------------------------------------------------------------------------------- the verdicts


def _title(d: Mapping[str, Any]) -> str:
    """Return the finding in a line."""
    effects, verdict = d["effects"], d["verdict"]
    if effects and all("channel" in e for e in effects):
        return "A sensor has a fault; no physical effect is missing"
    if len(effects) > 1:
        kind = "" if any("channel" in e for e in effects) else "physical "
        return f"{('Two', 'Three', 'Four')[min(len(effects), 4) - 2]} {kind}effects are missing"
    if effects:
        return f"Missing: {_placed(effects[0])}"
    if verdict in ("no_discrepancy", "parameters_only"):
        if not _agrees(d):
            return "No missing effect can be named"
        return (
            "The model agrees with the measurements"
            if verdict == "no_discrepancy"
            else "No missing effect found; refitted parameters suffice"
        )
    differences = d.get("record_differences")
    if differences:
        names = " and ".join(_parameter_name(p["path"]) for p in differences["parameters"])
        change = (
            f"{names} {'change' if len(differences['parameters']) > 1 else 'changes'} from record to record"
        )
        return (
            f"An effect is missing, or {change}" if differences["tied"] else f"The records differ: {change}"
        )
    if verdict == "unknown_effect" and d.get("not_tried"):
        return "An effect is missing; the time limit ended the search for it"
    kinds, places = _likely_kinds(d), _certain_places(d)
    if d["reason"] == "kind_certain" and kinds:
        place = f" {_spot(kinds[0]['place'])}; its law is" if kinds[0]["place"] else "; its place and law are"
        return f"Missing: {_lower(KINDS[kinds[0]['kind']])}{place} open"
    if d["tabulated"] and not _is_table_refuted(d):
        return f"Missing: a force {_between(d['tabulated']['between'])}; its law is open"
    if common := _in_all_rivals(d):
        sure = any(f["kind_probability"] >= d["criteria"]["certain"] for f in kinds)
        return (
            f"{'Missing' if sure else 'Probably missing'}: {candidate_text(common)}; a further effect is open"
        )
    if verdict == "ambiguous" and len(d["alternatives"]) > 1:
        return f"An effect is missing; these data leave {len(d['alternatives'])} candidates"
    if kinds:
        place = f" {_spot(kinds[0]['place'])}" if kinds[0]["place"] else ""
        return f"An effect is missing, probably {_lower(KINDS[kinds[0]['kind']])}{place}"
    possible = next((f for f in d["findings"] if f["kind"] != "other" and f["place"]), None)
    if possible is not None and possible["kind_probability"] >= PERHAPS:
        return f"An effect is missing, perhaps {_lower(KINDS[possible['kind']])} {_spot(possible['place'])}"
    if places:
        return f"An effect is missing {_spot(next(iter(places)))}; its kind is open"
    return "An effect is missing; no known law fits"


def _next(d: Mapping[str, Any]) -> str:
    """Return what to do next about the finding."""
    verdict = d["verdict"]
    if verdict in ("no_discrepancy", "parameters_only"):
        if not _agrees(d):
            return "log further motions or inputs, or record larger amplitudes."
        if verdict == "parameters_only":
            return (
                "use the refitted parameters (model.json), and test them with a record of another excitation."
            )
        return (
            "record other amplitudes, speeds or frequencies to see effects that these records do not excite."
        )
    if verdict == "missing_effect":
        gap = d["gap"]["held_out"]
        c = _most_gained(gap, "refit", "after")
        if not _square(gap["after"][c]) <= _square(gap["refit"][c]):
            return "repeat the test: the test records do not confirm the addition."
        return f"confirm it with a new record: the error of model.json in {c} must be about {_percent(gap['after'][c])}."
    if d.get("closed_loop"):
        return ""
    if d["reason"] == "records_differ":
        return "find out what changed between the records (load, temperature, wear, setting), and diagnose the records of one state alone."
    if d.get("record_differences"):
        return (
            "repeat the test of a record of each group with the excitation of the other: a parameter that differs keeps its value, and a law "
            "follows the motion."
        )
    if d["tabulated"]:
        if _is_table_refuted(d):
            return "repeat the test: the test records do not confirm the force."
        return (
            "confirm the force with a new record, and compare its curve with a law of your own (--elements)."
        )
    if d["next_experiment"]:
        return "run the test in next_experiment.csv."
    best = d["best_candidate"]
    failed = {g["gate"] for g in best["failed_gates"] if not g["passed"]} if best and is_gain(best) else set()
    advice = next((text for name, text in ADVICE.items() if name in failed), None)
    return f"{advice or 'log further motions or inputs: the missing force may depend on a quantity that is not measured'}."


def _test_of_kind(d: Mapping[str, Any]) -> str:
    """Return a test on the rig for the likeliest kind; empty where an effect is named, none is missing, or no kind is likelier than others."""
    if (
        d["verdict"] not in ("ambiguous", "unknown_effect")
        or d["reason"] == "records_differ"
        or d["next_experiment"]
    ):
        return ""
    found = [f for f in d["findings"] if f["kind"] in TESTS and f["place"]]
    first, second, *_ = *sorted(found, key=lambda f: -f["kind_probability"]), None, None
    if first is None or first["kind_probability"] < POSSIBLE:
        return ""
    if (
        second is not None and second["kind_probability"] == first["kind_probability"]
    ):  # effects of one candidate
        return ""
    for law in first["laws"][:1]:
        known = {k: plain_value(q["value"], q["unit"]) for k, q in law["parameters"].items()}
        test = TYPES[law["effect"]].test if law["effect"] in TYPES else ""
        if known and test:
            return (
                f"test for {spoken(law['effect'])} {_spot(first['place'])}: {_lower(test.format_map(known))}"
            )
    words = TESTS[first["kind"]].format(parts=" and ".join(first["place"]))
    return f"test for {_lower(KINDS[first['kind']])} {_spot(first['place'])}: {words}."


def _is_table_refuted(d: Mapping[str, Any]) -> bool:
    """Return whether the table of the missing force makes the error on the test records larger."""
    closed = d["gap"]["closed"]
    return closed is not None and closed < 0


def _urgent(d: Mapping[str, Any]) -> list[str]:
    """Return what to do before anything else."""
    steps = []
    if d.get("closed_loop"):
        steps.append("repeat the test with an input that does not depend on the outputs.")
    if _is_open(d) and _worse_than_constant(d):
        steps.append("check values, stated uncertainty, signs and units of the model.")
    return steps


def _lower(text: str) -> str:
    return text[:1].lower() + text[1:]


def _missing(d: Mapping[str, Any]) -> str:
    gap = d["gap"]["held_out"]
    c = _most_gained(gap, "refit", "after")
    found = " and ".join(described(e) for e in d["effects"])
    down = _square(gap["after"][c]) <= _square(gap["refit"][c])
    text = (
        f"The model lacks {found}. With {'these effects' if len(d['effects']) > 1 else 'this effect'} the error in {c} on held-out "
        f"data {'falls' if down else 'rises'} from {_percent(gap['refit'][c])} to {_percent(gap['after'][c])} "
        f"({_noise_of(d, c)})."
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
        f"The refit without an addition made the model worse on held-out data ({c}: {_percent(given)} as given, {_percent(refit)} refitted). The "
        "share of the gap that an addition closes is relative to the refitted model."
    )


def _worse_than_constant(d: Mapping[str, Any]) -> str:
    """Return a sentence where the refitted model errs more on held-out data than the mean of each record."""
    gap = d["gap"]["held_out"]
    c = _widest(gap)
    if not _square(gap["refit"][c]) > 1.0:
        return ""
    return f"The refitted model errs more in {c} than a constant would ({_percent(gap['refit'][c])} of the deviation)."


def _remaining(d: Mapping[str, Any]) -> str:
    left = d["remainder"]
    if not left:
        return ""
    most = f", largest when {left['when']}" if left["when"] != "everywhere" else ""
    text = (
        f"An error of {_percent(left['after'])} in {left['channel']} remains ({_noise_of(d, left['channel'])}){most}. "
        "Another effect may be missing."
    )
    if left["candidate"]:
        text += (
            f" The closest further effect, {candidate_text(left['candidate'])}, would reduce the error to "
            f"{_percent(left['candidate']['error'])} and was not kept."
        )
    return text


def _likely_kinds(d: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """Return the findings whose kind is probable."""
    least = d["criteria"]["probable"]
    return [f for f in d["findings"] if f["kind"] != "other" and f["kind_probability"] >= least]


def _certain_places(d: Mapping[str, Any]) -> dict[tuple[str, ...], float]:
    """Return the places that are certain, with their probabilities."""
    least = d["criteria"]["certain"]
    return {
        tuple(f["place"]): f["place_probability"] for f in d["findings"] if f["place_probability"] >= least
    }


def _likely(d: Mapping[str, Any]) -> str:
    """Return the most specific statements that are likely, with probabilities: kinds, or else places that are certain."""
    certain, findings = d["criteria"]["certain"], d["findings"]
    kinds, sentences = _likely_kinds(d), []
    for f in kinds:
        sure = "is missing" if f["kind_probability"] >= certain else "is probably missing"
        chance = f"(probability {f['kind_probability']:.2f})"
        if not f["place"]:
            open_places = " or ".join(
                f"{_spot(g['place'])} ({g['place_probability']:.2f})"
                for g in findings
                if g["place"] and g["kind"] == f["kind"]
            )
            sentences.append(
                f"{KINDS[f['kind']]} {sure} {chance}, but the data do not determine its place: {open_places}."
            )
            continue
        laws = "; less likely ".join(
            f"{spoken(law['effect'])} ({law['probability']:.2f}{_law_values(law)})"
            for law in f["laws"][:LAWS]
            if law is f["laws"][0] or law["probability"] >= d["criteria"]["reported"]
        )
        sentences.append(f"{KINDS[f['kind']]} {_spot(f['place'])} {sure} {chance}. Likeliest law: {laws}.")
    if not kinds:
        sentences = [
            f"An effect is missing {_spot(place)} (probability {chance:.2f}); the data do not determine its kind."
            for place, chance in _certain_places(d).items()
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
                f"{_lower(KINDS[f['kind']])} {_spot(f['place'])} (probability {f['kind_probability']:.2f})"
                for f in told
            )
            sentences.append(f"{words}: {' or '.join(listed)}.")
    return " ".join(sentences)


def _law_values(law: Mapping[str, Any]) -> str:
    values = [_parameter(k, q) for k, q in law["parameters"].items() if q["unit"] not in ("", "-")]
    return f", {', '.join(values)}" if values else ""


def _ambiguous(d: Mapping[str, Any]) -> str:
    rivals, best = d["alternatives"], d["best_candidate"]
    if common := _in_all_rivals(d):
        rest = " or ".join(
            f"{candidate_text(_without(r, common)) or 'no further effect'} (leaves {_left(r)})"
            for r in rivals
        )
        return (
            f"Each of {len(rivals)} candidates that these data do not tell apart contains {candidate_text(common)}. They differ in the "
            f"further effect: {rest}."
        )
    if d["reason"] != "kind_certain" and len(rivals) > 1:
        names = " or ".join(f"{candidate_text(r)} (leaves {_left(r)})" for r in rivals)
        return (
            f"An effect is missing, and these data do not decide between {len(rivals)} candidates: {names}."
        )
    subject = "The law is not certain" if d["reason"] == "kind_certain" else "An effect is missing"
    if not is_gain(best):
        return f"{subject}: {_no_gain(best)}"
    return (
        f"{subject}: {candidate_text(best)} removes {_percent(best['explained'], 0)} of {EXCESS}, "
        f"but {failures(best['failed_gates'])}."
    )


def _in_all_rivals(d: Mapping[str, Any]) -> Mapping[str, Any] | None:
    """Return the effects that each of several candidates contains at the same place; None where there are none."""
    rivals = d["alternatives"]
    if d["verdict"] != "ambiguous" or d["reason"] == "kind_certain" or len(rivals) < 2:
        return None
    named = [[(e, sorted(w)) for e, w in zip(r["effects"], r["where"], strict=True)] for r in rivals]
    first = rivals[0]
    shared = [k for k, effect in enumerate(named[0]) if all(effect in others for others in named[1:])]
    if not shared:
        return None
    return {key: [first[key][k] for k in shared] for key in ("effects", "where")}


def _without(rival: Mapping[str, Any], common: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return the effects of a candidate that are not among common effects."""
    known = [(e, sorted(w)) for e, w in zip(common["effects"], common["where"], strict=True)]
    rest = [
        (e, w) for e, w in zip(rival["effects"], rival["where"], strict=True) if (e, sorted(w)) not in known
    ]
    return {"effects": [e for e, _ in rest], "where": [w for _, w in rest]}


def _left(rival: Mapping[str, Any]) -> str:
    excess = rival["excess"]
    return "an unknown share" if excess is None else f"{_percent(max(excess, 0.0))} of the error beyond noise"


def _unknown(d: Mapping[str, Any]) -> str:
    gap = d["gap"]["held_out"]
    c = _widest(gap)
    why = (
        "the search for it is not finished"
        if d.get("not_tried")
        else "no known effect passes the checks for a name"
    )
    return f"An effect is missing, and {why} ({_errors(d, c, 'before', 'refit')})."


def _parameter_name(path: str) -> str:
    """Return a path of a parameter in words, such as ``damping of magnet``."""
    owner, _, name = path.rpartition(".")
    return f"{spoken(name)} of {owner}"


def _record_differences(d: Mapping[str, Any]) -> str:
    """Return the parameters that differ between records, with their values, and the error with and without."""
    found = d["record_differences"]
    sentences = []
    for p in found["parameters"]:
        groups = [
            [v for v in p["values"] if v["group"] == k]
            for k in range(1 + max(v["group"] for v in p["values"]))
        ]
        if all(len(g) == 1 for g in groups) or len(groups) <= MOST_GROUPS:
            stated = [f"{_range(g, p['unit'])} in {_records(g)}" for g in groups]
            values = f"{', '.join(stated[:-1])} and {stated[-1]}"
        else:
            values = f"{_range(p['values'], p['unit'])}, in {len(groups)} groups of records"
        sentences.append(f"{_capital(_parameter_name(p['path']))} differs between records: {values}.")
    error = found["error"]
    c = _most_gained(error, "joint", "differing")
    several = len(found["parameters"]) > 1
    text = (
        f"With {'values' if several else 'a value'} per record the error in {c}, on stretches of the records that took no part in the "
        f"fit, falls from {_percent(error['joint'][c])} to {_percent(error['differing'][c])}"
    )
    text = (
        f"{' '.join(sentences)} {text} ({_percent(found['explained'], 0)} of the squared error beyond noise)."
    )
    law, share = found["law"], _percent(max(found["explained_by_law"] or 0.0, 0.0), 0)
    if found["tied"]:
        text = (
            f"Perhaps the records differ. {text} {_capital(law)} with one value for all records removes {share}: the records do not "
            "decide between the two."
        )
    elif law is not None:
        text += f" No known law removes more than {share}."
    return f"{text} {_amplitudes(found)}".rstrip()


def _amplitudes(found: Mapping[str, Any]) -> str:
    """Return a sentence where the groups of records also differ in the size of the motion; empty where they do not."""
    groups = np.array([v["group"] for v in found["parameters"][0]["values"]])
    ratios = {}
    for c in found["amplitude"][0]:
        values = np.array([row[c] for row in found["amplitude"]])
        means = [float(np.mean(values[groups == k])) for k in range(1 + max(groups))]
        ratios[c] = max(means) / max(min(means), 1e-300)
    channel = max(ratios, key=lambda c: ratios[c])
    if ratios[channel] < UNLIKE:
        return ""
    return (
        f"The amplitude of {channel} differs between these records, too, by a factor of {plain_number(ratios[channel], 2)}: a law that is "
        "not in the library may look like a difference between records."
    )


def _range(values: Sequence[Mapping[str, Any]], unit: str) -> str:
    """Return the range of the values of a group of records with their unit."""
    low, high = (pick(v["value"] for v in values) for pick in (min, max))
    first, last = (plain_number(practical(high, unit)[0] * x, 3) for x in (low, high))
    end = practical(high, unit)[1]
    number = first if first == last else f"{first} to {last}"
    return f"{number} {end}".rstrip(" -")


def _records(values: Sequence[Mapping[str, Any]]) -> str:
    """Return the names of the records of a group, or their number where they are many."""
    names = [v["record"] for v in values]
    if len(names) > MOST_NAMES:
        return f"{len(names)} records"
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"


def _where(d: Mapping[str, Any]) -> str:
    """Return the channel with most of the error, and the motion at which the error is largest."""
    if not d["where"] or not d["where"][0]["share"]:
        return ""
    first = d["where"][0]
    parts = [f"{_percent(first['share'], 0)} of the gap is in {first['channel']}"] * (len(d["where"]) > 1)
    parts += [f"the gap is largest when {first['when']}"] * (first["when"] != "everywhere")
    return f"{_capital('; '.join(parts))}." if parts else ""


def is_gain(candidate: Mapping[str, Any] | None) -> bool:
    """Return whether a candidate reduces the error on validation records, and on test records over all channels.

    Args:
        candidate: Entry `best_candidate` of the JSON document; None without a candidate.
    """
    if candidate is None or not (candidate["explained"] or 0.0) > 0.0:
        return False
    before, after = (sum(map(_square, candidate["error"][s].values())) for s in ("refit", "after"))
    return after < before


def _no_gain(candidate: Mapping[str, Any]) -> str:
    if not (candidate["explained"] or 0.0) > 0.0:
        return "no known effect reduces the error on the validation records."
    error = candidate["error"]
    c = _most_gained(error, "after", "refit")
    return (
        f"no known effect reduces the error on the test records. With the likeliest, {candidate_text(candidate)}, the error in {c} is "
        f"{_percent(error['after'][c])} (refitted {_percent(error['refit'][c])})."
    )


def _best_candidate(d: Mapping[str, Any]) -> str:
    best = d["best_candidate"]
    if best is None and d.get("not_tried"):
        return ""
    if best is None:
        return "No known effect reduces the held-out error by enough to be kept."
    if not is_gain(best):
        return _capital(_no_gain(best))
    error = best["error"]
    c = _most_gained(error, "refit", "after")
    falls = f"the error in {c} falls from {_percent(error['refit'][c])} to {_percent(error['after'][c])}"
    likely = [law["effect"] for f in _likely_kinds(d)[:1] for law in f["laws"][:1]]
    is_likely = not likely or set(likely) & set(best["effects"])
    if not best.get("completes"):
        return f"With {'the best candidate' if is_likely else 'the candidate that errs least'}, {candidate_text(best)}, {falls}."
    closed, explained = d["gap"]["closed"] or 0.0, best["explained"] or 0.0
    other = "" if is_likely else f", not the likelier {spoken(likely[0])}"
    text = f"model.json has {candidate_text(best)}, which predicts best{other}: {falls}; {_percent(closed, 0)} of the gap is closed on the test records"
    if explained < 0.5 <= closed:
        return f"{text}, but only {_percent(explained, 0)} on the validation records: it is not yet the whole cause."
    return f"{text}." if closed >= 0.5 else f"{text}. The cause is not found; this law is a stopgap."


def _unnamed(d: Mapping[str, Any]) -> str:
    """Return why the best candidate has no name."""
    best = d["best_candidate"]
    if best is None or not is_gain(best):
        return ""
    return f"{_capital(candidate_text(best))} is not named because {failures(best['failed_gates'])}."


def _table(d: Mapping[str, Any]) -> tuple[str, str]:
    """Return the statement about the table of the missing force, and what is known of its shape."""
    t, tried = d["tabulated"], d["best_table"]
    if t:
        near = ", ".join(f"{spoken(x['effect'])} {_percent(x['share'], 0)}" for x in t["nearest"])
        alone = ", ".join(
            f"{OVER[k].removeprefix('their ')} alone {_percent(v, 0)}" for k, v in t["shares"].items()
        )
        text = (
            f"A force {_between(t['between'])} that depends on {OVER[t['over']]} removes {_percent(t['explained'], 0)} of {EXCESS}. "
            f"In model.json the force is the table '{t['element']}'."
        )
        text += f" {NOT_BORNE_OUT}" if _is_table_refuted(d) else ""
        shape = [f"Share of its power by argument: {alone}."] if alone else []
        shape += [f"Share of its power that the nearest known laws give: {near}."] if near else []
        return text, " ".join(shape)
    if tried is None and d.get("not_tried"):
        return "", ""
    return _rejected_table(tried, (d["best_candidate"] or {}).get("completes", False)), ""


def _rejected_table(tried: Mapping[str, Any] | None, is_surpassed: bool) -> str:
    if tried is None:
        return "No table of a force between two nodes could be fitted."
    explains = next(g for g in tried["gates"] if g["gate"] == "explains")
    text = (
        f"The best table of a force, {_between(tried['between'])} over {OVER[tried['over']]}, removes "
        f"{_percent(tried['explained'], 0)} of {EXCESS}"
    )
    if not (tried["explained"] or 0.0) > 0.0:
        return "No table of a force between two nodes reduces the held-out error."
    if not explains["passed"]:
        return (
            f"{text} (needed {_percent(explains['limit'], 0)}). The missing force may depend on time, on its own past, on an input, or "
            "on a motion that no sensor measures."
        )
    failed = failures(tried["gates"])
    if failed:
        return f"{text}, but {failed}."
    return (
        f"{text}, less than the best candidate."
        if is_surpassed
        else f"{text}, but its interval cannot be computed."
    )


def _agrees(d: Mapping[str, Any]) -> bool:
    """Return whether the refitted model errs by no material amount more than the noise."""
    gap = d["gap"]["held_out"]
    c = _most_gained(gap, "refit", "noise_floor")
    return _square(gap["refit"][c]) - _square(gap["noise_floor"][c]) <= d["criteria"]["material"] ** 2


def _agreement(d: Mapping[str, Any]) -> str:
    gap = d["gap"]["held_out"]
    worst = _most_gained(gap, "refit", "noise_floor")
    if not _agrees(d):
        return f"No missing effect can be named ({_errors(d, worst, 'before', 'refit')})."
    if d["verdict"] == "no_discrepancy":
        return f"The model agrees with the measurements; no effect is missing ({_errors(d, worst, 'refit')})."
    most = _most_gained(gap, "before", "refit")
    return f"Refitted parameters explain the difference; no effect is missing ({_errors(d, most, 'before', 'refit')})."


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
            f"On validation data the error in {worst} beyond noise is {_percent(over)}. Unmodelled effects of {_percent(c['small_effect'], 0)} of "
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
        return f"A sensor fault may explain the rest, but {failures(d['gates'])}."
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
        f"{path} from {_in_unit_of(q['value'], q['prior'], q['unit'])} to {plain_value(q['value'], q['unit'])} ({q['value'] / q['prior'] - 1.0:+.1%})"
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
    return f"Detected but not named: {names}, {shares} of the force, current or signal at its place; {failures(d['gates'])}."


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
        f"the past of {' and '.join(f['outputs'])} explains {_percent(f['share'], 0)} of the part of {f['input']} that the past of "
        f"{f['input']} does not predict"
        for f in found
    ]
    return (
        f"The records are of a closed loop: {'; '.join(inputs)}. A control law can look like an element, such as a spring to the "
        "ground."
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
        "feedback": "feedback makes a comparison of whole records invalid",
    }[s["reason"]]
    return f"These are errors over {s['count']} stretches of {length}, each with its own initial state, because {why}."
