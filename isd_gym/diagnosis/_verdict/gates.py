"""Conditions for a name, with the figures that decide, and the verdict that follows from the band of sets of laws. Nothing is fitted here."""

from __future__ import annotations

import operator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

from .._selection.answer import share_left
from .._selection.criteria import CRITERIA, Criteria

if TYPE_CHECKING:
    from collections.abc import Callable

    from .._selection.answer import Answer
    from .evidence import Evidence

#: comparison of the value of a gate with its limit
Relation = Literal["<", "<=", ">", ">="]
COMPARE: dict[Relation, Callable[[float, float], bool]] = {
    "<": operator.lt, "<=": operator.le, ">": operator.gt, ">=": operator.ge,
}  # fmt: skip
#: largest magnitude of a gate's value: an infinite one is stated as this
MAX_GATE_VALUE = 1e6


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
            k: getattr(self, k)
            for k in ("passed", "value", "relation", "limit", "text")
        }


def gate(name: str, value: float, relation: Relation, limit: float, text: str) -> Gate:
    """Return a gate that passes if ``value relation limit`` is true. Infinite values become `MAX_GATE_VALUE`."""
    value = min(max(float(value), -MAX_GATE_VALUE), MAX_GATE_VALUE)
    return Gate(
        name, COMPARE[relation](value, limit), value, float(limit), text, relation
    )


Verdict = Literal[
    "missing_effect", "no_discrepancy", "parameters_only", "unknown_effect", "ambiguous"
]
#: Condition that led to a verdict without a name.
#:
#: - gates: a gate failed, or all passed.
#: - immaterial: the refitted model errs by less than `Criteria.material` beyond noise.
#: - noise: the refitted model errs by less than the noise.
Reason = Literal["gates", "immaterial", "noise"]


@dataclass(frozen=True)
class Decision:
    """A verdict and its gates."""

    verdict: Verdict
    gates: tuple[Gate, ...]
    #: condition of `decide` that led to the verdict
    reason: Reason = "gates"


def gates_of(answer: Answer, c: Criteria = CRITERIA) -> tuple[Gate, ...]:
    """Return the conditions for a name, with the figures of the foremost set; none where no law was fitted."""
    if not answer.foremost.members:
        return ()
    density = "standard errors by which the log predictive density exceeds the refitted model's, over blocks of validation and training records"
    fall = max(answer.refit.error**2 - answer.foremost.error**2, 0.0) ** 0.5
    falls = "root of the decrease of the squared error over all channels, as a share of the deviation"
    found = [
        gate("predicts better", answer.gain.errors, ">", c.elpd_errors, density),
        gate("material", fall, ">", c.material, falls),
    ]
    if answer.band:
        others = "laws of the simplest set without their kind and place in every set of the band"
        open_laws = sum(not certain for certain in answer.certain)
        found.append(gate("distinguishable", open_laws, "<=", 0, others))
    else:
        share = share_left(answer.foremost, answer.refit, answer.noise, c)
        leaves = "share of the refitted model's squared error beyond noise that the laws leave, geometric mean of validation and training records"
        allowed = c.one_more_leaves ** len(answer.best.members)
        found.append(gate("adequate", share, "<", allowed, leaves))
    return tuple(found)


def decide(answer: Answer, e: Evidence, c: Criteria = CRITERIA) -> Decision:
    """Return the verdict: a name where a law of the simplest set has its kind and place in every set of the band; where no law is needed,
    agreement if the refitted model leaves no material error or less than the noise."""
    gates = gates_of(answer, c)
    if answer.band:
        return Decision("missing_effect" if any(answer.certain) else "ambiguous", gates)
    excess = e.excess(e.refit)
    agrees_before = all(x < c.material for x in e.excess(e.before))
    agreed: Verdict = "no_discrepancy" if agrees_before else "parameters_only"
    # a wide gap is no agreement, and neither is a noise that only the gap itself bounds
    widest = max(e.width(e.refit), e.width(e.training_refit))
    if widest >= c.wide_gap or not e.has_credible_noise(c.wide_gap):
        return Decision("unknown_effect", gates)
    if all(x < c.material for x in excess):
        return Decision(agreed, gates, "immaterial")
    if all(x < f for x, f in zip(excess, e.noise, strict=True)):
        return Decision(agreed, gates, "noise")
    return Decision("unknown_effect", gates)
