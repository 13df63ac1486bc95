"""The table of limits: every number that can change a verdict, with its unit, reason and source."""

from __future__ import annotations

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
    one_more_leaves: float = limit(
        0.35,
        "share of the squared error beyond noise, geometric mean of validation and training records",
        "each further law must leave less of what the smaller set leaves",
        "as above; 0.3 to 0.36 give the same answers but one",
    )
    wide_gap: float = limit(
        0.10,
        "share of the deviation, mean over channels",
        "a model that misses so much of the records never agrees, and a noise that is only bounded explains no more",
        "no measured rig has noise of a tenth",
    )
    alone_removes: float = limit(
        0.90,
        "share of the excess",
        "a law that removes less, on validation or on test records, is less often right",
        "first looks: 9 of 26 such names wrong",
    )
    least_removed: float = limit(
        0.50,
        "share of the excess",
        "a controller must explain less of the force of a name; places and kinds are weak below",
        "half: it leads. A spring centred in a bang-bang cycle is the controller's to 0.9, friction to less than 0.3",
    )
    forces_first: float = limit(
        4.0,
        "ratio of excess errors, in power",
        "a sensor or drive is only blamed where every force leaves twice the error",
        "sensors are checked, and can be checked again; laws of friction are not. Of measured rigs, three were given a large sensor fault for "
        "friction; of 18 faults of sensors at seeds 2001 to 2301 the true ones have 10 and more, the one wrong 2.4",
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
        "a periodic law must be seen to repeat within the travel",
        "a single period may be any curve with a hump",
    )
    certain: float = limit(
        0.8,
        "probability",
        "a kind at a place is stated as certain",
        "four in five; calibrated on first looks",
    )

    @property
    def on_its_way(self) -> float:
        """Share of the squared error below which a law is worth a further step: the root of `one_more_leaves`, half of the way there."""
        return float(self.one_more_leaves**0.5)

    @property
    def least_explained(self) -> float:
        """Share of the excess error from which on a gap counts as explained: half of what `least_removed` allows is left, 0.75."""
        return 1.0 - 0.5 * self.least_removed


CRITERIA = Criteria()


def table(c: Criteria = CRITERIA) -> list[dict[str, str | float]]:
    """The criteria as rows: id, limit, unit, why, source."""
    return [
        {"id": f.name, "limit": getattr(c, f.name), **f.metadata} for f in fields(c)
    ]
