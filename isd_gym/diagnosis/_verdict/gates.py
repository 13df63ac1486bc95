"""The gates that a name has to pass, and the verdict that follows. `decide` reads evidence and limits; nothing is fitted.

The verdict is the conjunction of the gates that the report shows.
"""

from __future__ import annotations

import math
import operator
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any, Literal

from .._selection.criteria import CRITERIA, Criteria
from .grades import share_mistaken

if TYPE_CHECKING:
    from collections.abc import Callable

    from .._selection.answer import Answer
    from .evidence import EffectEvidence, Evidence

Verdict = Literal["missing_effect", "no_discrepancy", "parameters_only", "unknown_effect", "ambiguous"]
#: Condition that led to a verdict without a name.
#:
#: - gates: a gate failed, or all passed.
#: - immaterial: the refitted model errs by less than `Criteria.material` beyond noise.
#: - noise: the refitted model errs by less than the noise, and no effect predicts better.
#: - small_effects: the refitted model errs by no more than unmodelled effects make.
#: - closed_by_small: effects that are too small to be named close the gap.
#: - too_small: the effect that was found is too small to be named.
#: - doubtful_sensor: a fault of a sensor may explain a narrow gap.
#: - kind_certain: the kind of the effect is certain, its law is not.
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
#: comparison of the value of a gate with its limit
Relation = Literal["<", "<=", ">", ">="]
COMPARE: dict[Relation, Callable[[float, float], bool]] = {
    "<": operator.lt, "<=": operator.le, ">": operator.gt, ">=": operator.ge,
}  # fmt: skip
#: size of a sensor's fault (of the gain, or of the motion's time) that is not believed without a second look, since sensors off by a quarter are
#: found before; factor of `Criteria.forces_first` for such a fault
DOUBTFUL, FAR = 0.25, 5.0
#: largest magnitude of a gate's value: an infinite one is stated as this
MAX_GATE_VALUE = 1e6
#: meanings of values of several gates
REMOVED = "share of the squared error beyond noise removed"
MOVED = "largest share of a channel's standard deviation by which the error falls"


@dataclass(frozen=True)
class Gate:
    """One condition for a name."""

    name: str
    #: truth of ``value relation limit``
    passed: bool
    value: float
    limit: float
    #: meaning of the value
    text: str
    relation: Relation = ">"

    def to_dict(self) -> dict[str, Any]:
        """As the JSON of a diagnosis has it."""
        return {"gate": self.name} | {
            k: getattr(self, k) for k in ("passed", "value", "relation", "limit", "text")
        }


def gate(name: str, value: float, relation: Relation, limit: float, text: str) -> Gate:
    """Return a gate that passes if ``value relation limit`` is true. Infinite values become `MAX_GATE_VALUE`."""
    value = min(max(float(value), -MAX_GATE_VALUE), MAX_GATE_VALUE)
    return Gate(name, COMPARE[relation](value, limit), value, float(limit), text, relation)


def all_of(*conditions: Gate) -> Gate:
    """Return the first condition that fails, or the first condition if all pass."""
    return next((g for g in conditions if not g.passed), conditions[0])


def any_of(*conditions: Gate) -> Gate:
    """Return the first condition that passes, or the first condition if all fail."""
    return next((g for g in conditions if g.passed), conditions[0])


@dataclass(frozen=True)
class Decision:
    """A verdict and its gates."""

    verdict: Verdict
    gates: tuple[Gate, ...]
    #: whether an effect was found that is too small, or not certain enough, to be named
    small: bool = False
    #: condition of `decide` that led to the verdict
    reason: Reason = "gates"


def gates_of(e: Evidence, c: Criteria = CRITERIA) -> tuple[Gate, ...]:
    """Return the gates. A gate with several conditions has the value and limit of the decisive condition."""
    rivals = "rivals of another kind that predict as well"
    if e.indistinguishable:
        rivals += f": {'; '.join(e.indistinguishable)}"
    if e.rival_loss < MAX_GATE_VALUE:
        rivals += f"; the nearest leaves {e.rival_loss:.3g} times the excess error"
    curve = "share of the remaining excess error that a free curve in the effect's place removes"
    return (
        _predicts_better(e, c),
        _material(e, c),
        _adequate(e, c),
        _determined(e, c),
        gate("distinguishable", len(e.indistinguishable), "<=", 0, rivals),
        gate("lack of fit", e.lack_of_fit, "<", c.least_removed, curve),
        gate(
            "probable",
            e.probability,
            ">=",
            c.probable,
            "weight of the candidates that contain all of its laws",
        ),
        _confirmed(e, c),
        _forces_first(e, c),
    )


def _predicts_better(e: Evidence, c: Criteria) -> Gate:
    is_so = partial(gate, "predicts better")
    text = "by which the log predictive density exceeds the refitted model's, over blocks of validation and training records"
    return all_of(
        is_so(e.elpd_diff / max(e.elpd_dse, 1e-12), ">", c.elpd_errors, f"standard errors {text}"),
        is_so(e.elpd_diff, ">", c.elpd_diff, f"nats {text}"),
    )


def _confirmed(e: Evidence, c: Criteria) -> Gate:
    is_so = partial(gate, "confirmed")
    silent = "error beyond noise on the test records over that of small effects, without and with the effect: they show no gap"
    return any_of(
        is_so(e.test_explained, ">=", c.least_removed, f"{REMOVED} on the test records"),
        is_so(e.test_gap, "<", 1.0, silent),
    )


def _material(e: Evidence, c: Criteria) -> Gate:
    size = min(x.share for x in e.effects)
    moves = f"it moves a channel by {100 * e.moved:.1f} % of the standard deviation (needed {100 * c.material:.0f} %)"
    text = f"{MOVED}; its force is {100 * size:.1f} % of the force at its place"
    conditions = [_large_or_closing(x, c, moves) for x in e.effects]
    return all_of(*conditions, gate("material", e.moved, ">=", c.material, text))


def _large_or_closing(x: EffectEvidence, c: Criteria, moves: str) -> Gate:
    """Return the gate for the size of one effect, with the figures of the condition that decides (`is_material`)."""
    is_so = partial(gate, "material")
    large = f"share of the force, current or signal at the place of {x.label}, or of the work dissipated where damping is slight; {moves}"
    instead = f"the force of {x.label} is only {100 * x.share:.1f} % of the force at its place (otherwise needed {100 * c.share:.0f} %); {moves}"
    closes = f"share of the squared held-out error beyond noise removed from a wide gap; {instead}"
    wide = [is_so(x.width, ">", c.wide_gap, f"mean excess error without {x.label} over channels")]
    if x.beyond_small:
        wide.append(is_so(x.share, ">", c.small_effect, "share of the force at its place"))
    return any_of(
        is_so(x.share, ">=", c.share, large),
        all_of(is_so(x.removed, ">=", c.alone_removes, closes), any_of(*wide)),
    )


def _adequate(e: Evidence, c: Criteria) -> Gate:
    is_so = partial(gate, "adequate")
    removed = "share of the squared held-out error beyond noise removed, in all and in the channel with the widest gap"
    rest = f"the rest is {e.excess_ratio:.3g} times the power that small effects leave"
    excused = f"enough, since {rest} (limit {c.small_effects:g})"
    fitted = f"{REMOVED} on the training records; {excused}; held out: {100 * e.explained:.0f} %"
    # where the training records are explained, unmodelled effects may leave the rest
    by_few = all_of(
        is_so(e.training_explained, ">=", c.alone_removes, fitted),
        is_so(e.excess_ratio, "<", c.small_effects, "remaining power over that which small effects leave"),
    )
    ratio = "error on the fitted records over the refitted model's, geometric mean over channels"
    return all_of(
        any_of(is_so(e.explained, ">=", c.least_removed, f"{removed}; {rest}"), by_few),
        is_so(e.training_ratio, "<=", 1.0, ratio),
        is_so(e.nominal_removed, ">", 0.0, "share of the nominal model's squared held-out error removed"),
        is_so(
            e.largest_left, "<", 1.0, "largest error beyond noise that remains, over the channel's deviation"
        ),
    )


def _determined(e: Evidence, c: Criteria) -> Gate:
    worst = max((x.spread for x in e.effects), default=0.0)
    odd = [x for x in e.effects if x.contradiction]
    # a factor of 10 by which a value may be too large: nine tenths of the value are uncertain
    spread = "half of the widest 95 % interval over the value (1: the interval holds zero); without the parameter that shapes the law"
    values = "effects with values that contradict their names"
    if odd:
        values += f": {odd[0].label}: {odd[0].contradiction}"
    return all_of(
        gate("determined", -math.expm1(-worst), "<", -math.expm1(-c.determined), spread),
        gate("determined", len(odd), "<=", 0, values),
    )


def _forces_first(e: Evidence, c: Criteria) -> Gate:
    sensors = [x for x in e.effects if x.sensor]
    if not sensors:
        return gate("sensor", 0, "<=", 0, "sensor faults in the candidate")
    largest, far = max(x.fault for x in sensors), FAR * c.forces_first
    limit = c.forces_first if all(x.fault < DOUBTFUL for x in sensors) else far
    text = (
        f"excess error of the best candidate with a force over that of the sensor fault of {largest:.2g} (of the gain, or of "
        f"the motion's time; from {DOUBTFUL:g} on the limit is {far:g})"
    )
    return gate("sensor", e.force_loss, ">=", limit, text)


def table_gates(
    explained: float, moved: float, errors: float, confirmed: float, c: Criteria = CRITERIA
) -> tuple[Gate, ...]:
    """Return the conditions for a table of a force, by explained fraction, error reduction, standard errors of the gain and explained
    fraction of the test records."""
    density = "standard errors by which the log predictive density exceeds the refitted model's"
    return (
        gate(
            "explains",
            explained,
            ">=",
            c.least_removed,
            "share of the squared held-out error beyond noise removed",
        ),
        gate("material", moved, ">=", c.material, MOVED),
        gate("predicts better", errors, ">", c.elpd_errors, density),
        gate("confirmed", confirmed, ">=", c.least_removed, f"{REMOVED} on the test records"),
    )


def decide(e: Evidence, c: Criteria = CRITERIA) -> Decision:
    """Return the verdict that follows from the evidence of the foremost candidate."""
    agreed: Verdict = "no_discrepancy" if e.agrees_before else "parameters_only"
    gates = gates_of(e, c) if e.effects else ()
    failed, excess = {g.name for g in gates if not g.passed}, e.excess(e.refit)
    is_there = bool(gates) and not failed & {"predicts better", "determined"}
    if gates and not failed:
        return Decision("missing_effect", gates)
    if "distinguishable" in failed and failed <= {"distinguishable", "probable"}:
        return Decision("ambiguous", gates)  # an effect whose law alone is open is no agreement
    credible = e.has_credible_noise(c.wide_gap) and not _shown_by_training(e, failed, c)
    narrow = credible and e.width < c.wide_gap  # a wide gap is no agreement
    if credible and all(x < c.material for x in excess):
        return Decision(agreed, gates, is_there, "immaterial")
    # no effect predicts better, and the excess error is below the noise
    is_found = bool(gates) and "predicts better" not in failed
    if narrow and not is_found and all(x < f for x, f in zip(excess, e.noise, strict=True)):
        return Decision(agreed, gates, reason="noise")
    # unmodelled effects make gaps as large, or effects too small to be named close the gap
    if narrow and all(x < w for x, w in zip(excess, e.envelope, strict=True)):
        return Decision(agreed, gates, is_there, "small_effects")
    if narrow and gates and e.closed_by_small(c.share):
        return Decision(agreed, gates, is_there, "closed_by_small")
    if narrow and failed == {"material"}:
        return Decision(agreed, gates, True, "too_small")
    if "sensor" in failed and failed <= {"distinguishable", "sensor", "probable"}:
        # a doubtful sensor fault behind a narrow gap is no finding
        return Decision(agreed, gates, True, "doubtful_sensor") if narrow else Decision("ambiguous", gates)
    return Decision("unknown_effect", gates)


def decide_by_sets(answer: Answer, e: Evidence, c: Criteria = CRITERIA) -> Decision:
    """Return the decision on the band of a search: a name where a member of the simplest set is in every set of the band."""
    if not answer.band:
        plain = decide(e, c)
        is_open = plain.verdict in ("missing_effect", "ambiguous")
        return replace(plain, verdict="unknown_effect", reason="gates") if is_open else plain
    others = sum(not certain for certain in answer.certain)
    gates = (
        _predicts_better(e, c),
        gate(
            "material",
            answer.falls,
            ">",
            answer.width,
            "decrease of the error beyond noise over all channels, as a share of the deviation",
        ),
        gate(
            "distinguishable",
            others,
            "<=",
            0,
            "laws of the simplest set without their kind and place in every set of the band",
        ),
    )
    return Decision("missing_effect" if any(answer.certain) else "ambiguous", gates)


def _shown_by_training(e: Evidence, failed: set[str], c: Criteria) -> bool:
    """Return whether the training records have a wide gap, or a material one closed by a found effect: no agreement, even if validation
    records have none."""
    if e.training_width >= c.wide_gap:
        return True
    is_found = bool(e.effects) and not failed & {"predicts better", "material", "determined"}
    is_closed = e.training_explained >= c.least_explained
    is_told = is_found and is_closed and bool(e.training_refit)
    return is_told and max(e.excess(e.training_refit)) >= c.material


def confidence(e: Evidence, c: Criteria = CRITERIA, *, is_sum: bool = False) -> float:
    """Return the probability of a name: the weight of the candidates with the name, times the share of such names that are right."""
    return (1.0 - share_mistaken("law", e, c, is_sum=is_sum)) * e.probability
