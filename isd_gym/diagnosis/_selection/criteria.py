"""The table of limits: every number that can change a verdict, with its unit, reason and source."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields
from typing import Any

#: smallest noise that residuals are weighted with, as a share of a channel's deviation: models of measured rigs err by more
LEAST_NOISE = 0.01


def limit(value: float, unit: str, why: str, source: str) -> Any:
    """A criterion: its limit and unit, why it is asked for, and how the figure was found."""
    return field(default=value, metadata={"unit": unit, "why": why, "source": source})


@dataclass(frozen=True)
class Criteria:
    """The limits that decide. The metadata of each field has the unit, the reason and the source of the calibration."""

    deviance_gain: float = limit(
        20.0,
        "2 log L",
        "what chance, and the choice among some hundred hypotheses, gains on the training records",
        "a hundred hypotheses of two parameters each: 2 ln 100 + 2 x 4 is 17",
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
    least_width: float = limit(
        0.006,
        "share of a channel's deviation",
        "sets of laws whose errors differ by less are one band, whatever they leave",
        "small effects of simulated rigs",
    )
    width_growth: float = limit(
        0.3,
        "share of the error beyond noise",
        "the band of the best set widens with what the set leaves, up to `material`",
        "simulated and measured rigs together",
    )
    within_kind: float = limit(
        0.95,
        "share of the removed squared error",
        "the simplest law of a kind that removes so much of what the best law of the kind removes is the law",
        "as above",
    )
    one_more_leaves: float = limit(
        0.4,
        "share of the squared error beyond noise",
        "each further law must leave less of what the smaller set leaves",
        "as above",
    )
    share: float = limit(
        0.05,
        "share of the force, current or signal at its place",
        "every rig has effects of a few per cent that no model holds",
        "as above",
    )
    small_effect: float = limit(
        0.02,
        "share of the typical force",
        "the size of those effects, for what they make of the outputs",
        "as above",
    )
    wide_gap: float = limit(
        0.10,
        "share of the deviation, mean over channels",
        "a gap so wide, or wider than small effects make it, is worth a name whatever the force, where one effect closes it; a model that misses "
        "so much of a channel never agrees within a noise that is only bounded",
        "slightly damped rigs, where 3 % of the force is a quarter of the motion; no measured rig has noise of a tenth",
    )
    alone_removes: float = limit(
        0.90, "share of the excess", "what a small effect must close of such a gap", "as above"
    )
    least_removed: float = limit(
        0.50,
        "share of the excess",
        "what a name must remove of the gap, and one more effect of what is left; a controller must explain less of the force",
        "half: it leads. A spring centred in a bang-bang cycle is the controller's to 0.9, friction to less than 0.3",
    )
    small_effects: float = limit(
        3.0,
        "powers",
        "where less is explained, what is left may be so many small effects' sum",
        "two to four a rig",
    )
    forces_first: float = limit(
        4.0,
        "ratio of excess errors, in power",
        "a sensor is only blamed where every force leaves twice the error; five times as much power is asked for a fault of a quarter of the gain "
        "or of the motion's time",
        "sensors are checked, and can be checked again; laws of friction are not. Of measured rigs, three were given a large sensor fault for "
        "friction; of 18 faults of sensors at seeds 2001 to 2301 the true ones have 10 and more, the one wrong 2.4",
    )
    determined: float = limit(
        math.log(10.0),
        "logarithm of a factor",
        "a name needs a number",
        "the 95 % interval leaves out zero and what is ten times less: three laws at a pair, a curve fit, span decades",
    )
    probable: float = limit(
        0.5,
        "weight of candidates",
        "a name is more likely right than not",
        "pseudo-BMA+ weights over blocks of validation and training records (Yao et al. 2018)",
    )
    periods: float = limit(
        1.5,
        "periods",
        "a periodic law must be seen to repeat within the travel, and a travel that no output tells within a record; where it does neither, twice as "
        "many periods are asked for",
        "a single period may be any curve with a hump; a force of a travel that does not return is any force of time; a coast-down passes each "
        "travel once, a full swing twice",
    )
    certain: float = limit(
        0.8,
        "probability",
        "a kind at a place is stated as certain",
        "four in five; calibrated on first looks",
    )

    @property
    def least_explained(self) -> float:
        """Share of the excess error from which on a gap counts as explained: half of what `least_removed` allows is left, 0.75."""
        return 1.0 - 0.5 * self.least_removed


CRITERIA = Criteria()


def is_material(
    removed: float, width: float, beyond_small: bool, size: float, c: Criteria = CRITERIA
) -> bool:
    """Return whether an effect is large enough to be named: with a large force, or a smaller one that closes a wide gap, beyond the size
    that every rig has."""
    is_wide = width > c.wide_gap or (beyond_small and size > c.small_effect)
    return size >= c.share or (removed >= c.alone_removes and is_wide)


def table(c: Criteria = CRITERIA) -> list[dict[str, str | float]]:
    """The criteria as rows: id, limit, unit, why, source."""
    return [{"id": f.name, "limit": getattr(c, f.name), **f.metadata} for f in fields(c)]
