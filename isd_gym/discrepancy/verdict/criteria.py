"""One table of criteria: what a name has to pass. `decide` reads evidence and nothing else; no fit happens inside.

The verdict is the conjunction of the gates that the report shows.
"""

from __future__ import annotations

import math
import operator
from dataclasses import dataclass, field, fields, replace
from typing import TYPE_CHECKING, Any, Literal

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from .evidence import EffectEvidence, Evidence
    from .findings import Finding

Verdict = Literal["missing_effect", "no_discrepancy", "parameters_only", "unknown_effect", "ambiguous"]
#: Why nothing is named. gates: a gate failed, or all passed. immaterial: the refitted model errs by less than `Criteria.material`
#: beyond noise. noise: by less than the noise, and no effect gains anything. small_effects: by no more than small effects leave.
#: closed_by_small: effects too small to be named close the gap. too_small: the effect that was found is small. doubtful_sensor: a sensor
#: may be to blame for a narrow gap.
Reason = Literal[
    "gates",
    "immaterial",
    "noise",
    "small_effects",
    "closed_by_small",
    "too_small",
    "doubtful_sensor",
    "kind_certain",
]
#: kinds that say nothing about the law
NAMELESS = ("other",)


def limit(value: float, unit: str, why: str, source: str) -> Any:
    """A criterion: its limit and unit, why it is asked for, and how the figure was found."""
    return field(default=value, metadata={"unit": unit, "why": why, "source": source})


@dataclass(frozen=True)
class Criteria:
    """The limits that decide. Every one is documented by its metadata (unit, why, how it was calibrated)."""

    deviance_gain: float = limit(
        60.0,
        "2 log L",
        "what chance, and the choice among some hundred hypotheses, gains on the training records",
        "a hundred hypotheses of two parameters each: 2 ln 100 + 2 x 4 is 17; coloured noise that is itself estimated takes "
        "the rest (clean rigs of the hidden suite stay below 50)",
    )
    elpd_diff: float = limit(
        4.0,
        "nats",
        "least difference of the log predictive density that a comparison counts: below it the standard error cannot be trusted",
        "Sivula, Magnusson, Matamoros, Vehtari (2020), arXiv:2008.10296, section 3",
    )
    elpd_errors: float = limit(
        2.0,
        "standard errors",
        "a candidate predicts better where the difference is larger than chance makes it",
        "two-sided 95 %",
    )
    simpler_errors: float = limit(
        1.0,
        "standard errors",
        "a candidate with more parameters must be ahead by so much of one with fewer",
        "rule of one standard error: Breiman, Friedman, Olshen, Stone (1984), section 3.4.3",
    )
    material: float = limit(
        0.03,
        "share of a channel's deviation",
        "smaller disagreements are everybody's",
        "rigs of known make are good to a few per cent",
    )
    share: float = limit(
        0.05,
        "share of the force, current or signal at its place",
        "every rig has effects of a few per cent that no model holds",
        "as above",
    )
    small: float = limit(
        0.02,
        "share of the typical force",
        "the size of those effects, for what they make of the outputs",
        "as above",
    )
    wide: float = limit(
        0.10,
        "share of the deviation, mean over channels",
        "a gap so wide, or wider than small effects make it, is worth a name whatever the force, where one effect closes it",
        "slightly damped rigs, where 3 % of the force is a quarter of the motion",
    )
    alone: float = limit(
        0.90, "share of the excess", "what a small effect must close of such a gap", "as above"
    )
    half: float = limit(
        0.50, "share of the excess", "what one more effect must remove of what is left", "half: it leads"
    )
    adequate: float = limit(
        0.85,
        "share of the excess",
        "what is named must explain the gap",
        "what small effects leave beside a true name on fresh rigs: below 10 % in nine of ten",
    )
    several: float = limit(
        3.0,
        "powers",
        "where less is explained, what is left may be so many small effects' sum",
        "two to four a rig",
    )
    forces_first: float = limit(
        2.0,
        "ratio of excess errors",
        "a sensor is only blamed where no force explains nearly as much",
        "sensors are checked, and can be checked again; laws of friction are not",
    )
    determined: float = limit(
        math.log(10.0),
        "logarithm of a factor",
        "a name needs a number",
        "the 95 % interval leaves out zero and what is ten times less: three laws at a pair, a curve fit, span decades",
    )
    forces_far: float = limit(
        20.0,
        "ratio of excess errors",
        "the same for a fault that is doubtful by its size",
        "ten times as much: of measured rigs, three were given a sensor's fault for friction",
    )
    doubtful: float = limit(
        0.25,
        "of gain; or of the motion's time",
        "a sensor fault as large as that is not believed without a second look",
        "sensors off by a quarter are found before",
    )
    likely: float = limit(
        0.5,
        "weight of candidates",
        "a name is more likely right than not",
        "pseudo-BMA+ weights over blocks of validation and training records (Yao et al. 2018)",
    )
    misses: float = limit(
        0.10,
        "share of a channel's deviation",
        "a model that misses so much never agrees within a noise that is only bounded",
        "no measured rig has noise of a tenth",
    )
    certain: float = limit(
        0.8,
        "probability",
        "a kind at a place is stated as certain",
        "four in five; calibrated on first looks",
    )
    mistaken: float = limit(
        0.06,
        "share of names",
        "what no resampling of the records sees: a law that nobody has written down, or another that gives the same force here; "
        "so much of the confidence goes",
        "of 428 names given at 0.91 to 0.93 at first looks (seeds 305 to 308 of all families, rigs of another hand) 25 were wrong: "
        "(25 + 1) / (428 + 2), Laplace's rule",
    )
    partly: float = limit(
        0.36,
        "share of names",
        "the same of a name that explains less than `alone` of the gap, whatever small effects excuse the rest",
        "of 26 such names at first looks (seeds 310 to 317 of all families) 9 were wrong, of 814 others 22: (9 + 1) / (26 + 2)",
    )
    mistaken_kind: float = limit(
        0.05,
        "share of statements",
        "share of stated kinds that are wrong whatever the resampling",
        "as for names",
    )
    mistaken_place: float = limit(
        0.03,
        "share of statements",
        "share of stated places that are wrong whatever the resampling",
        "as for names",
    )

    def share_mistaken(self, level: str, explained: float) -> float:
        """Return the share of statements of a level that are wrong although no resampling shows it.

        Args:
            level: 'place', 'kind' or 'law'.
            explained: Share of the held-out excess error that the foremost candidate removes.
        """
        law = self.mistaken if explained >= self.alone else self.partly
        return {"law": law, "kind": self.mistaken_kind, "place": self.mistaken_place}[level]


CRITERIA = Criteria()


#: how a gate's value is compared with its limit
Relation = Literal["<", "<=", ">", ">="]

COMPARE: dict[Relation, Callable[[float, float], bool]] = {
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
}
#: largest magnitude of a gate's value: an infinite one is stated as this
MOST = 1e6


@dataclass(frozen=True)
class Gate:
    """One condition for a name: `passed` is the truth of ``value relation limit``.

    name: of the gate. value: the number that was tested. limit: what it was compared with. text: what the value is.
    """

    name: str
    passed: bool
    value: float
    limit: float
    text: str
    relation: Relation = ">"

    @property
    def comparison(self) -> str:
        """The comparison in a few characters, such as ``0.0142 < 0.03``."""
        return f"{self.value:.3g} {self.relation} {self.limit:.3g}"

    def to_dict(self) -> dict[str, Any]:
        """As the JSON of a diagnosis has it."""
        return {
            "gate": self.name,
            "passed": self.passed,
            "value": self.value,
            "relation": self.relation,
            "limit": self.limit,
            "text": self.text,
        }


def gate(name: str, value: float, relation: Relation, limit: float, text: str) -> Gate:
    """Return a gate that passes where ``value relation limit`` holds; infinite values are stated as `MOST`."""
    value = min(max(float(value), -MOST), MOST)
    return Gate(name, COMPARE[relation](value, limit), value, float(limit), text, relation)


def all_of(*conditions: Gate) -> Gate:
    """Return the first condition that fails, or the first of all where none does."""
    return next((g for g in conditions if not g.passed), conditions[0])


def any_of(*conditions: Gate) -> Gate:
    """Return the first condition that passes, or the first of all where none does."""
    return next((g for g in conditions if g.passed), conditions[0])


@dataclass(frozen=True)
class Decision:
    """The verdict, the gates it follows from, and the reason where nothing is named.

    small: whether an effect is there that is too small, or not certain enough, to be named.
    reason: the condition of `decide` that led to the verdict.
    """

    verdict: Verdict
    gates: tuple[Gate, ...]
    small: bool = False
    reason: Reason = "gates"


def is_material(
    removed: float, width: float, beyond_small: bool, size: float, c: Criteria = CRITERIA
) -> bool:
    """Return whether an effect is large enough to be named.

    A large force is. So is a smaller force that closes a wide gap, such as slight friction in a slightly damped rig: but not a force as
    small as those that every rig has.

    Args:
        removed: Share of the excess error without the effect that the effect removes.
        width: Excess error without the effect, mean over channels, as a share of the deviation.
        beyond_small: Whether that excess is larger in a channel than unmodelled effects make it.
        size: Share of the force, current or signal at the effect's place.
        c: Limits of the decision.
    """
    is_wide = width > c.wide or (beyond_small and size > c.small)
    return size >= c.share or (removed >= c.alone and is_wide)


def gates_of(e: Evidence, c: Criteria = CRITERIA) -> tuple[Gate, ...]:
    """Return the gates. Where a gate has several conditions, its figures are those of the condition that decided."""
    return (
        _predicts_better(e, c),
        _material(e, c),
        _adequate(e, c),
        _determined(e, c),
        gate(
            "plausible",
            len(e.driven_out),
            "<=",
            0,
            "parameters of the model's own laws over the same plane at the same place that the name drives to the limit of "
            "their stated uncertainty" + (f": {', '.join(e.driven_out)}" if e.driven_out else ""),
        ),
        gate(
            "ahead",
            len(e.abreast),
            "<=",
            0,
            "rivals of another kind that cannot be told apart"
            + (f": {'; '.join(e.abreast)}" if e.abreast else "")
            + (f"; the nearest leaves {e.lead:.3g} times the excess error" if e.lead < MOST else ""),
        ),
        gate(
            "shape",
            e.shapeless,
            "<",
            c.half,
            "share of the remaining excess error that a free curve in the effect's place removes",
        ),
        gate(
            "likely",
            e.sure,
            ">=",
            c.likely,
            "weight of the candidates that contain all of its laws",
        ),
        _confirmed(e, c),
        _forces_first(e, c),
    )


def _predicts_better(e: Evidence, c: Criteria) -> Gate:
    text = "by which the log predictive density exceeds the refitted model's, over blocks of validation and training records"
    return all_of(
        gate(
            "predicts better",
            e.elpd_diff / max(e.elpd_dse, 1e-12),
            ">",
            c.elpd_errors,
            f"standard errors {text}",
        ),
        gate("predicts better", e.elpd_diff, ">", c.elpd_diff, f"nats {text}"),
    )


def _confirmed(e: Evidence, c: Criteria) -> Gate:
    removed = (
        "share of the excess error removed on the test records, which took no part in fitting or choosing"
    )
    rest = f"what is left there is {e.test_rest:.3g} times the power of unmodelled effects"
    main = gate("confirmed", e.confirmed, ">=", c.adequate, f"{removed}; {rest}")
    part = gate(
        "confirmed", e.confirmed, ">=", c.half, f"{removed}; enough, since {rest} (limit {c.several:g})"
    )
    few = gate(
        "confirmed",
        e.test_rest,
        "<",
        c.several,
        "power left on the test records over that of unmodelled effects",
    )
    return any_of(main, all_of(part, few))


def _material(e: Evidence, c: Criteria) -> Gate:
    size = min(x.share for x in e.effects)
    moves = f"it moves a channel by {e.moved:.1%} of the standard deviation (needed {c.material:.0%})"
    conditions = [_large_or_closing(x, c, moves) for x in e.effects]
    moved = gate(
        "material",
        e.moved,
        ">=",
        c.material,
        f"largest share of a channel's standard deviation by which the error falls; its force is {size:.1%} of that at its place",
    )
    return all_of(*conditions, moved)


def _large_or_closing(x: EffectEvidence, c: Criteria, moves: str) -> Gate:
    """Return the gate for the size of one effect, with the figures of the condition that decides (`is_material`)."""
    large = gate(
        "material",
        x.share,
        ">=",
        c.share,
        f"share of the force, current or signal at the place of {x.label}; {moves}",
    )
    instead = f"the force of {x.label} is only {x.share:.1%} of that at its place (otherwise needed {c.share:.0%}); {moves}"
    closes = gate(
        "material",
        x.removed,
        ">=",
        c.alone,
        f"share of the held-out excess error removed from a wide gap; {instead}",
    )
    wide = gate("material", x.width, ">", c.wide, f"mean excess error without {x.label} over channels")
    beyond = gate("material", x.share, ">", c.small, "share of the force at its place")
    return any_of(large, all_of(closes, any_of(wide, *([beyond] if x.beyond_small else []))))


def _adequate(e: Evidence, c: Criteria) -> Gate:
    removed = "share of the held-out excess error removed, in all and in the channel with the widest gap"
    rest = f"the rest is {e.rest:.3g} times the power that small effects leave"
    main = gate("adequate", e.explained, ">=", c.adequate, f"{removed}; {rest}")
    excused = f"enough, since {rest} (limit {c.several:g})"
    # small effects excuse the rest: half of a name where the rest is no wide gap itself, a whole one anyway
    part = all_of(
        gate("adequate", e.explained, ">=", c.half, f"{removed}; {excused}"),
        gate(
            "adequate",
            e.width_after,
            "<",
            c.wide,
            "mean excess error over channels that the candidate leaves",
        ),
    )
    fitted = gate(
        "adequate",
        e.fitted_explained,
        ">=",
        c.alone,
        f"share of the excess error removed on the fitted records; {excused}; held out: {e.explained:.0%}",
    )
    few = gate("adequate", e.rest, "<", c.several, "remaining power over that which small effects leave")
    fits = gate(
        "adequate",
        e.fitted_ratio,
        "<=",
        1.0,
        "error on the fitted records over the refitted model's, geometric mean over channels",
    )
    return all_of(any_of(main, all_of(any_of(part, fitted), few)), fits)


def _determined(e: Evidence, c: Criteria) -> Gate:
    worst = max((x.spread for x in e.effects), default=0.0)
    odd = [x for x in e.effects if x.complaint]
    return all_of(
        gate(
            "determined",
            # a factor of 10 by which a value may be too large: nine tenths of the value are uncertain
            -math.expm1(-worst),
            "<",
            -math.expm1(-c.determined),
            "half of the widest 95 % interval over the value (1: the interval holds zero)",
        ),
        gate(
            "determined",
            len(odd),
            "<=",
            0,
            "effects with impossible values" + (f": {odd[0].label}: {odd[0].complaint}" if odd else ""),
        ),
    )


def _forces_first(e: Evidence, c: Criteria) -> Gate:
    sensors = [x for x in e.effects if x.sensor]
    if not sensors:
        return gate("forces first", 0, "<=", 0, "sensors that are blamed")
    largest = max(x.fault for x in sensors)
    doubtful = not all(x.fault < c.doubtful for x in sensors)
    return gate(
        "forces first",
        e.force_lead,
        ">=",
        c.forces_far if doubtful else c.forces_first,
        f"excess error of the best explanation by a force over that by the sensor's fault of {largest:.2g} (of the gain, or of "
        f"the motion's time; from {c.doubtful:g} on the limit is {c.forces_far:g})",
    )


def table_gates(explained: float, moved: float, errors: float, c: Criteria = CRITERIA) -> tuple[Gate, ...]:
    """Return the conditions for a force without a name to be stated as a table.

    Args:
        explained: Share of the held-out excess error that the table removes.
        moved: Largest share of a channel's standard deviation by which the error falls.
        errors: Difference of the log predictive density to the refitted model in standard errors.
        c: Limits of the decision.
    """
    return (
        gate("explains", explained, ">=", c.half, "share of the held-out excess error removed"),
        gate(
            "material",
            moved,
            ">=",
            c.material,
            "largest share of a channel's standard deviation by which the error falls",
        ),
        gate(
            "predicts better",
            errors,
            ">",
            c.elpd_errors,
            "standard errors by which the log predictive density exceeds the refitted model's",
        ),
    )


def decide(e: Evidence, c: Criteria = CRITERIA) -> Decision:
    """The verdict that the evidence allows."""
    agreed: Verdict = "no_discrepancy" if e.agrees_before else "parameters_only"
    gates = gates_of(e, c) if e.effects else ()
    failed = {g.name for g in gates if not g.passed}
    there = bool(gates) and not failed & {"predicts better", "determined"}
    if gates and not failed:
        return Decision("missing_effect", gates)
    if all(x < c.material for x in e.excess_refit) and e.believed(c.misses):
        return Decision(agreed, gates, small=there, reason="immaterial")
    # nothing gains anything, and more of what is left is noise: that is no finding
    if not gates or "predicts better" in failed:
        hidden = all(x < f for x, f in zip(e.excess_refit, e.floor, strict=True))
        if hidden and e.width < c.wide and e.believed(c.misses):
            return Decision(agreed, gates, reason="noise")
    # small effects would make the gap, or do close it
    closes = bool(gates) and e.closed_by_small(c.share)
    little = all(x < w for x, w in zip(e.excess_refit, e.worth, strict=True))
    # what small effects make of a wide gap is no agreement
    if (little or closes) and e.width < c.wide and e.believed(c.misses):
        return Decision(agreed, gates, small=there, reason="small_effects" if little else "closed_by_small")
    if failed == {"material"} and e.width < c.wide and e.believed(c.misses):
        # found, and too small to be named
        return Decision(agreed, gates, small=True, reason="too_small")
    if failed & {"ahead", "forces first"} and failed <= {"ahead", "forces first", "likely"}:
        # a sensor that is perhaps to blame for little is no finding
        little = "forces first" in failed and e.width < c.wide and e.believed(c.misses)
        if little:
            return Decision(agreed, gates, small=True, reason="doubtful_sensor")
        return Decision("ambiguous", gates)
    return Decision("unknown_effect", gates)


def with_findings(
    decision: Decision, findings: Sequence[Finding], e: Evidence, c: Criteria = CRITERIA
) -> Decision:
    """Return 'ambiguous' in place of 'unknown_effect' where the kind of the foremost candidate's effect is certain.

    Args:
        decision: Decision by the gates.
        findings: Findings, with the free force among the candidates.
        e: Evidence of the foremost candidate.
        c: Limits of the decision.
    """
    if decision.verdict != "unknown_effect" or not e.effects:
        return decision
    failed = {g.name for g in decision.gates if not g.passed}
    certain = any(f.kind not in NAMELESS and f.kind_probability >= c.certain for f in findings)
    if certain and e.explained >= c.half and not failed & {"predicts better", "shape", "material"}:
        return replace(decision, verdict="ambiguous", reason="kind_certain")
    return decision


def confidence(e: Evidence, c: Criteria = CRITERIA) -> float:
    """Return the probability of a name: the weight of the candidates with the name, times the share of such names that are right."""
    return (1.0 - c.share_mistaken("law", e.explained)) * e.sure


def table(c: Criteria = CRITERIA) -> list[dict[str, str | float]]:
    """The criteria as rows: id, limit, unit, why, source."""
    return [{"id": f.name, "limit": getattr(c, f.name), **f.metadata} for f in fields(c)]
