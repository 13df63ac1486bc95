"""The result of a diagnosis, its JSON document (`isd-diagnosis/1`) and the new model."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, is_dataclass
from html import escape
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from .._common.files import claim_folder, write_text
from ..records.data import Table, write_table
from ._selection.uncertainty import Quantity
from ._verdict.explanation import Place

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from .._common.arrays import Array
    from ..physics.network import Network
    from ._estimation.clock_lag import Lag
    from ._records.feedback import Feedback
    from ._selection.criteria import Criteria
    from ._selection.settings import SearchSettings
    from ._verdict.evidence import Evidence
    from ._verdict.findings import Finding
    from ._verdict.gates import Gate, Reason

__all__ = [
    "Diagnosis",
    "Effect",
    "LawSet",
    "Place",
    "Quantity",
    "Trace",
]


SCHEMA = "isd-diagnosis/1"
#: entries of the JSON document in their order: fields of `Diagnosis`, or made of them
_DOCUMENT = (
    "schema", "verdict", "summary", "effects", "findings", "alternatives", "where", "places", "parameters", "gap", "gates", "reason",
    "best_candidate", "remainder", "stretches", "closed_loop",
    "next_experiment", "evidence", "criteria", "search", "clocks", "not_tried", "notes",
)  # fmt: skip
#: kind, mark and parts of the folder of a diagnosis, with its report
FOLDER = (
    "diagnosis",
    "diagnosis.json",
    (
        "report.html",
        "diagnosis.json",
        "model.json",
        "next_experiment.csv",
        "set_*.json",
        "*.svg",
    ),
)


@dataclass(frozen=True)
class Effect:
    """An effect that a diagnosis found."""

    #: type of the element, such as 'coulomb_friction'
    effect: str
    #: terminals; None for an effect of a sensor or motor
    between: tuple[str, str] | None
    #: channel of a sensor effect
    channel: str | None
    #: probability that the name is right, in [0, 1]
    confidence: float
    #: fitted parameters by name
    parameters: dict[str, Quantity]
    #: name of the element in the new model
    element: str
    #: for an element in series: the element that the effect carries; empty for all elements between the terminals
    behind: str = ""
    #: parameters together with those of a damper of the model at the same place
    totals: dict[str, Quantity] = field(default_factory=dict)

    @property
    def stated(self) -> dict[str, Quantity]:
        """The parameters for people: totals where the model has a damper at the same place."""
        return self.parameters | self.totals

    def to_dict(self) -> dict[str, Any]:
        """Return the entry of the JSON document, without what the effect has not."""
        return {
            k: v
            for k, v in vars(self).items()
            if k == "parameters" or v not in (None, "", {})
        }


@dataclass(frozen=True, eq=False)
class LawSet:
    """A set of laws that the held-out records do not tell from the best one."""

    #: types of the effects
    effects: tuple[str, ...]
    #: place of each effect
    where: tuple[tuple[str, ...], ...]
    #: parameters of each effect by name
    values: tuple[dict[str, float], ...]
    #: options of each effect that are not numbers
    options: tuple[dict[str, str], ...]
    #: share of the refitted model's squared error beyond noise that the set leaves
    excess: float
    #: weight beside the other sets
    weight: float
    #: error on the validation records, as a share of the deviation, root of the mean square over channels
    error: float
    #: file of the completed model in the folder of the diagnosis
    file: str
    #: the completed model
    model: Network

    def to_dict(self) -> dict[str, Any]:
        """Return the entry of the JSON document."""
        return {k: v for k, v in vars(self).items() if k != "model"}


@dataclass(frozen=True)
class ScreenedPlace:
    """A place of the model, with the law there that removes most of what the refitted model leaves."""

    #: terminals, channel or motor
    where: tuple[str, ...]
    #: type of the law
    effect: str
    #: share of the squared residual that the law removes to first order, from 0 to 1
    share: float


@dataclass(frozen=True)
class Trace:
    """Measured and simulated signals of one record."""

    #: name of the record
    name: str
    #: whether no sample of the record was fitted
    held_out: bool
    #: time [s] (n,)
    time: Array
    #: inputs by channel (n,)
    inputs: dict[str, Array]
    #: measured outputs by channel (n,)
    measured: dict[str, Array]
    #: outputs of the nominal model by channel (n,)
    before: dict[str, Array]
    #: outputs of the refitted nominal model by channel (n,)
    refit: dict[str, Array]
    #: outputs of the new model by channel (n,)
    after: dict[str, Array]
    #: start of the held-out part of a record that is fitted before that time [s]; None for other records
    held_from: float | None = None

    @property
    def use(self) -> str:
        """Use of the record in words."""
        if self.held_from is None:
            return "held out" if self.held_out else "fitted"
        return f"fitted up to {self.held_from:.4g} s, then held out"


@dataclass(frozen=True)
class BestCandidate:
    """The best set of effects of a diagnosis that names no effect."""

    #: types of the effects
    effects: tuple[str, ...]
    #: place of each effect
    where: tuple[tuple[str, ...], ...]
    #: parameters of each effect by name
    values: tuple[dict[str, float], ...]
    #: share of the squared held-out error beyond noise that the set removes
    explained: float
    #: NRMSE on the test records: `before`, `refit`, `after` -> channel -> error
    error: dict[str, dict[str, float]]
    #: gates that the set fails
    failed_gates: tuple[Gate, ...]
    #: whether the new model has the effects, although they are not certain
    completes: bool = False


@dataclass(frozen=True)
class Remainder:
    """A wide error that remains with the named effects."""

    #: channel with the largest remaining error
    channel: str
    #: NRMSE of the new model on the test records
    after: float
    #: NRMSE of noise on the test records
    noise_floor: float


@dataclass(frozen=True)
class Stretches:
    """Stretches over which records were compared, each with its own initial state."""

    #: number of stretches
    count: int
    #: length of the shortest stretch [s]
    shortest: float
    #: length of the longest stretch [s]
    longest: float
    #: reason for the comparison over stretches:
    #:
    #: - diverges: the simulation of whole records diverges.
    #: - astray: the error over whole records exceeds `limit`.
    #: - feedback: an input follows from outputs.
    reason: Literal["diverges", "astray", "feedback"]
    #: NRMSE of the refitted model over whole records, mean over channels
    error: float
    #: largest `error` at which whole records are compared
    limit: float


@dataclass(frozen=True, repr=False)
class Diagnosis:
    """Result of a diagnosis.

    `summary` states the result in words, `to_dict` is the JSON document (`isd-diagnosis/1`), and `save` writes the files.
    """

    #: 'missing_effect', 'no_discrepancy', 'parameters_only', 'ambiguous' or 'unknown_effect'
    verdict: str
    #: result in words
    summary: str
    #: named effects
    effects: tuple[Effect, ...]
    #: part of the gap in each channel, largest first
    where: tuple[Place, ...]
    #: refitted parameters of the nominal model by path
    parameters: dict[str, Quantity]
    #: NRMSE on held-out data: `before`, `refit`, `after`, `noise_floor` -> channel -> error
    gap: dict[str, dict[str, float]]
    #: share of the squared gap beyond noise that the new model removes; None without a new model
    closed: float | None
    #: conditions for a name, for the best candidate
    gates: tuple[Gate, ...]
    #: test that would decide between the candidates
    next_experiment: dict[str, Any] | None
    #: nominal model
    base: Network
    #: nominal model with refitted parameters
    refitted: Network
    #: new model
    model: Network
    #: measured and simulated signals of each record
    traces: tuple[Trace, ...]
    #: notes in words
    notes: tuple[str, ...] = ()
    #: parts of the work that the limit of the time left out, in words
    not_tried: tuple[str, ...] = ()
    #: wall-clock time of the diagnosis [s]
    seconds: float = 0.0
    #: unit of each channel
    units: dict[str, str] = field(default_factory=dict)
    #: evidence for the best candidate
    evidence: Evidence | None = None
    #: limits of the decision
    criteria: Criteria | None = None
    #: settings of the search
    settings: SearchSettings | None = None
    #: complete model with the effects, if only a part of the model was diagnosed (`cut`)
    whole: Network | None = None
    #: lags between the clocks of loggers
    lags: tuple[Lag, ...] = ()
    #: inputs of `next_experiment`
    test: Table | None = None
    #: best set of effects, if no effect is named
    best_candidate: BestCandidate | None = None
    #: condition that led to the verdict
    reason: Reason = "gates"
    #: wide error that remains with the named effects
    remainder: Remainder | None = None
    #: stretches of the comparison, if records were not compared whole
    stretches: Stretches | None = None
    #: probabilities of places, kinds and laws
    findings: tuple[Finding, ...] = ()
    #: sets of laws that the records do not tell apart, the simplest first
    sets: tuple[LawSet, ...] = ()
    #: places by the share of the squared error that a law there removes alone, largest first
    places: tuple[ScreenedPlace, ...] = ()
    #: inputs that follow from outputs
    closed_loop: tuple[Feedback, ...] = ()

    @property
    def alternatives(self) -> tuple[LawSet, ...]:
        """The sets of laws that the records do not tell apart, without a named one."""
        return self.sets if self.verdict == "ambiguous" else self.sets[1:]

    def __repr__(self) -> str:
        found = [
            f"{e.effect} {e.channel or '-'.join(e.between or ())}".strip()
            for e in self.effects
        ]
        closed = "" if self.closed is None else f", closed={self.closed:.3g}"
        return f"Diagnosis({self.verdict!r}, found={found}{closed}, {len(self.traces)} record(s))"

    def _repr_html_(self) -> str:
        """Return verdict, effects and gap as HTML for notebooks."""
        effects = [["effect", "where", "parameter", "value", "95 % interval"]]
        for e in self.effects:
            where = e.channel or "-".join(e.between or ())
            for name, q in e.stated.items():
                value = f"{q.value:.4g} {q.unit}"
                interval = f"{q.low:.4g} to {q.high:.4g}"
                effects.append([e.effect, where, name, value, interval])
        errors = [["error on held-out data", *self.gap]]
        for channel in self.gap["refit"]:
            shares = [f"{100 * row[channel]:.1f} %" for row in self.gap.values()]
            errors.append([channel, *shares])
        out = f"<p><b>{escape(self.verdict)}</b>: {escape(self.summary)}</p>"
        for rows in (effects, errors):
            out += _html_table(rows) if len(rows) > 1 else ""
        return out

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON document (`isd-diagnosis/1`)."""
        own = {k: getattr(self, k, None) for k in _DOCUMENT}
        made = {
            "schema": SCHEMA, "gap": {"held_out": self.gap, "closed": self.closed},
            "search": self.settings, "clocks": self.lags,
        }  # fmt: skip
        return {k: _plain(v) for k, v in (own | made).items()}

    def save(self, folder: str | Path) -> None:
        """Write the result to a folder. Each file is written completely or not at all.

        Files: `diagnosis.json`, `model.json`, a file for each further set of laws, and `next_experiment.csv` if a test would decide.
        `isd_gym.view.write_report` writes the page too.

        Args:
            folder: New, empty or an earlier diagnosis.

        Raises:
            InputError: The folder holds other files, or cannot be written.
        """
        folder = claim_folder(folder, *FOLDER)
        document = json.dumps(self.to_dict(), indent=1, allow_nan=False)
        write_text(folder / "diagnosis.json", document + "\n")
        (self.whole or self.model).save(folder / "model.json")
        for other in self.sets[1:]:
            other.model.save(folder / other.file)
        if self.test is not None:
            write_table(folder / "next_experiment.csv", self.test)


def _html_table(rows: Sequence[Sequence[str]]) -> str:
    """Return a table as HTML; the first row is its head."""
    out = ""
    for k, row in enumerate(rows):
        tag = "td" if k else "th"
        cells = "".join(f"<{tag}>{escape(c)}</{tag}>" for c in row)
        out += f"<tr>{cells}</tr>"
    return f"<table>{out}</table>"


def _plain(value: Any) -> Any:
    """Return JSON types: dataclasses by their `to_dict`, or by their fields; infinite numbers and NaN become null."""
    if hasattr(value, "to_dict"):
        return _plain(value.to_dict())
    if is_dataclass(value):
        return {f.name: _plain(getattr(value, f.name)) for f in fields(value)}
    if isinstance(value, Mapping):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    if isinstance(value, np.ndarray | np.generic):
        return _plain(value.tolist())
    return None if isinstance(value, float) and not math.isfinite(value) else value
