"""One table of criteria: what a name has to pass. `decide` reads evidence and nothing else; no fit happens inside.

The verdict is the conjunction of the gates that the report shows.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields
from typing import Any, Literal

from .evidence import Evidence

Verdict = Literal["missing_effect", "no_discrepancy", "parameters_only", "unknown_effect", "ambiguous"]


def limit(value: float, unit: str, why: str, source: str) -> Any:
    """A criterion: its limit and unit, why it is asked for, and how the figure was found."""
    return field(default=value, metadata={"unit": unit, "why": why, "source": source})


@dataclass(frozen=True)
class Criteria:
    """The limits that decide. Every one is documented by its metadata (unit, why, how it was calibrated)."""

    significant: float = limit(
        60.0,
        "2 log L",
        "what chance, and the choice among some hundred hypotheses, gains for nothing",
        "a hundred hypotheses of two parameters each: 2 ln 100 + 2 x 4 is 17; coloured noise that is itself estimated takes "
        "the rest (clean rigs of the hidden suite stay below 50)",
    )
    replicated: float = limit(
        2.0, "standard errors", "the gain is there again in held-out blocks", "two-sided 95 %"
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
    ahead: float = limit(
        1.1, "ratio of excess errors", "the nearest rival of another kind errs more", "a tenth, beyond chance"
    )
    decisive: float = limit(
        6.0,
        "difference of Schwarz's criterion",
        "a rival with more parameters that gains nothing by them is beaten",
        "strong evidence, Kass and Raftery, JASA 90 (1995)",
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
        "share of resamplings",
        "a name is more likely right than not",
        "held-out blocks drawn anew, with replacement; the share in which the choice stays",
    )
    misses: float = limit(
        0.10,
        "share of a channel's deviation",
        "a model that misses so much never agrees within a noise that is only bounded",
        "no measured rig has noise of a tenth",
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


CRITERIA = Criteria()


@dataclass(frozen=True)
class Gate:
    """One of the gates that a name has to pass: `value` against `limit`."""

    name: str
    passed: bool
    value: float
    limit: float
    text: str


@dataclass(frozen=True)
class Decision:
    """The verdict and the gates that it follows from; `small`: what there is, is too small to be named."""

    verdict: Verdict
    gates: tuple[Gate, ...]
    small: bool = False


def wide_enough(width: float, beyond_small: bool, size: float, c: Criteria = CRITERIA) -> bool:
    """Whether a gap is worth a name whatever the force of the one effect that closes it.

    width: of the gap, mean over channels; beyond_small: whether it is wider, in a channel, than small effects make it. One of those
    small effects, by its `size`, is no name, however much it moves.
    """
    return width > c.wide or (beyond_small and size > c.small)


def gates_of(e: Evidence, c: Criteria = CRITERIA) -> tuple[Gate, ...]:
    """The gates with their figures."""
    size = min(x.share for x in e.effects)
    alone = len(e.effects) == 1 and e.explained >= c.alone and wide_enough(e.width, e.beyond_small, size, c)
    left = "no more" if e.adequate_rest(c.several) else "more"
    worst = max((x.spread for x in e.effects), default=0.0)
    odd = [x for x in e.effects if x.complaint]
    sensors = [x for x in e.effects if x.sensor]
    return (
        Gate(
            "significant",
            e.gain > c.significant or e.halved,
            e.gain,
            c.significant,
            "twice the log likelihood gained over the refitted model, its own coloured noise allowed for"
            + (" (or half of the gap's power closed, as here)" if e.halved else ""),
        ),
        Gate(
            "replicated",
            e.again > c.replicated,
            e.again,
            c.replicated,
            "standard errors, over held-out blocks, by which it does better than the refitted model",
        ),
        Gate(
            "material",
            e.moved >= c.material and (size >= c.share or alone),
            e.moved,
            c.material,
            f"share of a channel's standard deviation that it moves; {size:.1%} of the force, current or signal at its place "
            + (
                f"(less than {c.share:.0%}, but it closes {e.explained:.0%} of a gap that is wide, or beyond what small effects make)"
                if alone and size < c.share
                else f"(needed {c.share:.0%})"
            ),
        ),
        Gate(
            "adequate",
            e.fits
            and (
                e.explained >= c.adequate
                # small effects excuse what is left: half of a name where that is no wide gap itself, a whole one anyway
                or (
                    e.adequate_rest(c.several)
                    and ((e.explained >= c.half and e.width_after < c.wide) or e.fitted_explained >= c.alone)
                )
            ),
            e.explained,
            c.adequate,
            "share of the held-out excess error removed, and of that in the channel with the widest gap; what is left is "
            f"{left} than small effects make ({e.fitted_explained:.0%} removed on the records that were fitted to)",
        ),
        Gate(
            "determined",
            worst < c.determined and not odd,
            worst,
            c.determined,
            "logarithm of the factor by which the least certain value may be off (95 %)"
            + (f"; {odd[0].label}: {odd[0].complaint}" if odd else ""),
        ),
        Gate(
            "plausible",
            not e.driven_out,
            len(e.driven_out),
            0,
            "parameters of the owner's laws over the same plane at its place that the name drives to the limit of what the owner allows"
            + (f": {', '.join(e.driven_out)}" if e.driven_out else ""),
        ),
        Gate(
            "ahead",
            not e.abreast,
            min(e.lead, 1e3),
            c.ahead,
            "excess error of the nearest rival of another kind over its own"
            + (f"; abreast: {'; '.join(e.abreast)}" if e.abreast else ""),
        ),
        Gate(
            "shape",
            e.shapeless < c.half,
            e.shapeless,
            c.half,
            "share of what is left that a free curve in the effect's place removes",
        ),
        Gate(
            "likely",
            e.sure >= c.likely,
            e.sure,
            c.likely,
            "share of resamplings of the held-out records in which the choice stays",
        ),
        Gate(
            "forces first",
            not sensors
            or e.force_lead
            >= (c.forces_first if all(x.fault < c.doubtful for x in sensors) else c.forces_far),
            min(e.force_lead, 1e3) if sensors else math.inf,
            c.forces_first,
            "no sensor is blamed"
            if not sensors
            else "excess error of the best explanation by a force over that by the sensor's fault",
        ),
    )


def decide(e: Evidence, c: Criteria = CRITERIA) -> Decision:
    """The verdict that the evidence allows."""
    agreed: Verdict = "no_discrepancy" if e.agrees_before else "parameters_only"
    gates = gates_of(e, c) if e.effects else ()
    failed = {g.name for g in gates if not g.passed}
    there = bool(gates) and not failed & {"significant", "replicated", "determined"}
    if gates and not failed:
        return Decision("missing_effect", gates)
    if all(x < c.material for x in e.excess_refit) and e.believed(c.misses):
        return Decision(agreed, gates, small=there)
    # nothing gains anything, and more of what is left is noise: that is no finding
    if not gates or "significant" in failed:
        hidden = all(x < f for x, f in zip(e.excess_refit, e.floor, strict=True))
        if hidden and e.width < c.wide and e.believed(c.misses):
            return Decision(agreed, gates)
    # small effects would make the gap, or do close it
    closes = bool(gates) and e.closed_by_small(c.share)
    little = all(x < w for x, w in zip(e.excess_refit, e.worth, strict=True))
    # what small effects make of a wide gap is no agreement
    if (little or closes) and e.width < c.wide and e.believed(c.misses):
        return Decision(agreed, gates, small=there)
    if failed == {"material"} and e.width < c.wide and e.believed(c.misses):
        return Decision(agreed, gates, small=True)  # found, and too small to be named
    if failed & {"ahead", "forces first"} and failed <= {"ahead", "forces first", "likely"}:
        # a sensor that is perhaps to blame for little is no finding
        little = "forces first" in failed and e.width < c.wide and e.believed(c.misses)
        return Decision(agreed, gates, small=True) if little else Decision("ambiguous", gates)
    return Decision("unknown_effect", gates)


def confidence(e: Evidence, c: Criteria = CRITERIA) -> float:
    """How sure a name is: the share of resamplings in which it stays, and of names with as much explained that were right."""
    return (1.0 - (c.mistaken if e.explained >= c.alone else c.partly)) * e.sure


def table(c: Criteria = CRITERIA) -> list[dict[str, str | float]]:
    """The criteria as rows: id, limit, unit, why, source."""
    return [{"id": f.name, "limit": getattr(c, f.name), **f.metadata} for f in fields(c)]
