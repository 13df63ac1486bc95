"""The summary of a diagnosis, written from the numbers of its JSON document alone. The sentences are in `templates/statements.txt`."""

from __future__ import annotations

import functools
import json
import re
from dataclasses import dataclass
from importlib import resources
from typing import TYPE_CHECKING, Any

import numpy as np

from ..._common.units import practical
from ...physics.elements import TYPES, spoken
from .grades import REPORTED

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from jinja2 import Template

#: an addition that makes the error on the test records larger
NOT_BORNE_OUT = "On the test records the error is larger with this addition."
WORDS: dict[str, dict[str, str]] = json.loads(
    (resources.files(__package__) / "templates" / "words.json").read_text(
        encoding="utf-8"
    )
)
#: what to do about a failed gate, most urgent first; kinds of effects in words; test on the rig that shows whether an effect of a kind is there
ADVICE, KINDS, TESTS = WORDS["advice"], WORDS["kinds"], WORDS["tests"]
#: parameters whose change is stated
CHANGES = 2
#: probability from which on a kind has a test, and from which on the title mentions the kind
POSSIBLE, PERHAPS = 0.2, 0.4


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
        return " ".join(
            [
                *self.finding,
                *self.remarks,
                *(f"Next: {step}" for step in self.next_steps),
            ]
        )


def summary_of(document: Mapping[str, Any]) -> str:
    """Return the summary of a diagnosis: the finding, the limits of the data, and what to do next."""
    return statements_of(document).text


def statements_of(document: Mapping[str, Any]) -> Statements:
    """Return the sentences about the JSON document of a diagnosis (`isd-diagnosis/1`); its `summary` is not read."""
    d = {"not_tried": [], "closed_loop": [], **document}
    uses: dict[str, dict[str, None]] = {
        "title": {},
        "finding": {},
        "remark": {},
        "next": {},
    }
    rendered = _template().render(d=d, facts=Facts(d))
    for use, text in re.findall(
        r"^(title|finding|remark|next):(.*?)(?=^(?:title|finding|remark|next):|\Z)",
        rendered,
        re.M | re.S,
    ):
        uses[use][" ".join(text.split())] = None  # a sentence stands once
    title, *others = (tuple(text for text in texts if text) for texts in uses.values())
    return Statements(title[0], *others)


@functools.cache
def _template() -> Template:
    """Return the template of all sentences. White space within a value is one space: only the template begins an entry."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    env = Environment(
        loader=PackageLoader("isd_gym.diagnosis._verdict"),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        finalize=lambda value: (
            re.sub(r"\s+", " ", value) if isinstance(value, str) else value
        ),
    )  # plain text: nothing is escaped
    filters = (
        candidate_text, described, failures, plain_number, plain_value, spoken, _capital, _in_unit_of, _kind, _parameter,
        _parameter_name, _percent, _placed, _spot, _square, _test_of_kind, _test_of_law,
    )  # fmt: skip
    env.filters |= {f.__name__.removeprefix("_"): f for f in filters}
    env.globals |= {
        "CHANGES": CHANGES, "NOT_BORNE_OUT": NOT_BORNE_OUT, "PERHAPS": PERHAPS, "REPORTED": REPORTED, "TYPES": TYPES,
    }  # fmt: skip
    return env.get_template("statements.txt")


# ---------------------------------------------------------------------------------------------- numbers and names


def plain_number(value: float | None, digits: int = 4) -> str:
    """Return significant digits, without an exponent for values from 1e4 to 1e7; ``unknown`` for None."""
    if value is None:
        return "unknown"
    text = f"{value:.{digits}g}"
    return (
        np.format_float_positional(float(text), trim="-")
        if 1e4 <= abs(value) < 1e7
        else text
    )


def described(effect: Mapping[str, Any]) -> str:
    """Return an effect of the JSON with its place and values, together with a damper at the same place."""
    totals = effect.get("totals", {})
    stated = {**effect["parameters"], **totals}
    figures = [_parameter(k, q) for k, q in stated.items() if q["value"] is not None]
    if totals:
        figures.append("with the damper beside it")
    return f"{_placed(effect)} ({', '.join(figures)})"


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
    return (
        "an unknown share"
        if value is None
        else f"{round(100 * value, digits) + 0.0:.{digits}f} %"
    )


def _square(value: float | None) -> float:
    return float("inf") if value is None else value**2


def _lower(text: str) -> str:
    return text[:1].lower() + text[1:]


def _parameter_name(path: str) -> str:
    """Return a path of a parameter in words, such as ``damping of magnet``."""
    owner, _, name = path.rpartition(".")
    return f"{spoken(name)} of {owner}"


def failures(gates: Iterable[Mapping[str, Any]]) -> str:
    """Return what the failed gates mean, such as ``its values are uncertain by 95 %``."""
    *first, last = [_failure(g) for g in gates if not g["passed"]] or [""]
    return f"{', '.join(first)} and {last}" if first else last


def _failure(g: Mapping[str, Any]) -> str:
    name, value, limit = g["gate"], g["value"], g["limit"]
    if value is None:
        return f"{name} is unknown"
    if name == "distinguishable":
        return f"{value:.0f} other {'laws predict' if value > 1 else 'law predicts'} as well"
    if name == "not the controller":
        return f"the controller's input explains {_percent(value, 0)} of its force (less than {_percent(limit, 0)} needed)"
    return WORDS["failures"][name]  # the subject is 'it'


def _test_of_law(finding: Mapping[str, Any]) -> str:
    """Return a test on the rig for the likeliest law of a finding; empty where the law has none."""
    if not finding["laws"]:
        return ""
    law = finding["laws"][0]
    known = {
        k: plain_value(q["value"], q["unit"]) for k, q in law["parameters"].items()
    }
    test = TYPES[law["effect"]].test if law["effect"] in TYPES else ""
    return _lower(test.format_map(known)) if known and test else ""


def _kind(finding: Mapping[str, Any]) -> str:
    return _lower(KINDS[finding["kind"]])


def _test_of_kind(finding: Mapping[str, Any]) -> str:
    return f"{TESTS[finding['kind']].format(parts=' and '.join(finding['place']))}."


# -------------------------------------------------------------------------------------------- facts of a document


def is_gain(candidate: Mapping[str, Any] | None) -> bool:
    """Return whether a candidate (`best_candidate`) reduces the error on validation records, and on test records over all channels."""
    if candidate is None or not (candidate["explained"] or 0.0) > 0.0:
        return False
    before, after = (
        sum(map(_square, candidate["error"][s].values())) for s in ("refit", "after")
    )
    return after < before


def most_gained(errors: Mapping[str, Mapping[str, float]], old: str, new: str) -> str:
    """Return the channel whose squared error falls most."""
    return max(
        errors[old], key=lambda c: _square(errors[old][c]) - _square(errors[new][c])
    )


class Facts:
    """What follows from the JSON document of a diagnosis, for the template."""

    most_gained = staticmethod(most_gained)

    def __init__(self, document: Mapping[str, Any]):
        self.d = document
        #: error of the refitted model on held-out data by channel
        self.refit: Mapping[str, float] = document["gap"]["held_out"]["refit"]

    @property
    def widest(self) -> str:
        """The channel with the largest error of the refitted model."""
        return max(self.refit, key=lambda c: _square(self.refit[c]))

    @property
    def agrees(self) -> bool:
        """Whether the refitted model errs by no material amount more than the noise."""
        gap, least = self.d["gap"]["held_out"], self.d["criteria"]["material"]
        c = most_gained(gap, "refit", "noise_floor")
        return _square(gap["refit"][c]) - _square(gap["noise_floor"][c]) <= least**2

    @property
    def is_gain(self) -> bool:
        """Whether the best candidate reduces the error."""
        return is_gain(self.d["best_candidate"])

    @property
    def bounded(self) -> dict[str, float]:
        """Channels whose noise is only bounded, with the bound."""
        e = self.d["evidence"]
        rows = zip(e["channels"], e["noise"], e["noise_known"], strict=True)
        return {name: floor for name, floor, known in rows if not known}

    @property
    def excess(self) -> dict[str, Any]:
        """Largest error of the refitted model beyond noise, with its channel and noise."""
        e = self.d["evidence"]
        names = ("channels", "refit", "noise")
        rows = [
            {
                "channel": c,
                "excess": max(r**2 - f**2, 0.0) ** 0.5,
                "noise": f,
            }
            for c, r, f in zip(*(e[k] for k in names), strict=True)
            if None not in (r, f)
        ]
        return max(rows, key=lambda row: row["excess"], default={})

    @property
    def moved(self) -> list[tuple[str, Mapping[str, Any]]]:
        """Parameters whose 95 % interval excludes the value of the nominal model, largest change first."""
        moved = [
            (path, q)
            for path, q in self.d["parameters"].items()
            if q.get("prior") and None not in (q["value"], q["low"], q["high"])
            and not q["low"] <= q["prior"] <= q["high"]
        ]  # fmt: skip
        return sorted(
            moved, key=lambda item: -abs(item[1]["value"] / item[1]["prior"] - 1.0)
        )

    @property
    def kinds(self) -> list[Mapping[str, Any]]:
        """Findings whose kind is probable."""
        least = self.d["criteria"]["probable"]
        return [
            f
            for f in self.d["findings"]
            if f["kind"] != "other" and f["kind_probability"] >= least
        ]

    @property
    def places(self) -> dict[tuple[str, ...], float]:
        """Places that are certain, with their probabilities."""
        found, least = self.d["findings"], self.d["criteria"]["certain"]
        return {
            tuple(f["place"]): f["place_probability"]
            for f in found
            if f["place_probability"] >= least
        }

    @property
    def kind_to_test(self) -> Mapping[str, Any] | None:
        """The likeliest kind; None where an effect is named, none is missing, or no kind is likelier than others."""
        d = self.d
        is_open = d["verdict"] in ("ambiguous", "unknown_effect")
        if not is_open or d["next_experiment"]:
            return None
        found = sorted(
            (f for f in d["findings"] if f["kind"] in TESTS and f["place"]),
            key=lambda f: -f["kind_probability"],
        )
        chances = [f["kind_probability"] for f in found]
        # kinds that are as likely are effects of one candidate
        return (
            found[0]
            if chances and chances[0] >= POSSIBLE and chances[0] not in chances[1:]
            else None
        )

    @property
    def advice(self) -> str:
        """What to do about the most urgent failed gate; empty where none failed."""
        best = self.d["best_candidate"]
        failed = (
            {g["gate"] for g in best["failed_gates"] if not g["passed"]}
            if self.is_gain
            else set()
        )
        return next((text for name, text in ADVICE.items() if name in failed), "")
