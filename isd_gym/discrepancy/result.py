"""The result of a diagnosis, its JSON document (`isd-diagnosis/1`) and the new model."""

from __future__ import annotations

import html
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from ..data import Table, write_table
from ..files import claim_folder, write_text
from ..fmi.cosimulation import UnitModel

if TYPE_CHECKING:
    from pathlib import Path

    from ..network import Network
    from .estimation.clock_lag import Lag
    from .records import Feedback
    from .selection.criteria import Criteria
    from .selection.settings import SearchSettings
    from .simulation.problem import Array
    from .verdict.evidence import Evidence
    from .verdict.findings import Finding
    from .verdict.gates import Gate, Reason

SCHEMA = "isd-diagnosis/1"
#: what a force without a name is a function of
Over = Literal["rate", "elongation", "both"]
#: kind, mark and parts of the folder of a diagnosis, with its report
FOLDER = (
    "diagnosis",
    "diagnosis.json",
    ("report.html", "diagnosis.json", "model.json", "parameters.ssv", "next_experiment.csv", "*.png"),
)


@dataclass(frozen=True)
class Quantity:
    """A fitted number [unit] with its 95 % interval; `prior` is what the owner's model says, where it does.

    value, low, high: in `unit`.
    """

    value: float
    low: float
    high: float
    unit: str
    prior: float | None = None

    def to_dict(self) -> dict[str, Any]:
        """Return the entry of the JSON document."""
        head = {} if self.prior is None else {"prior": self.prior}
        return head | {"value": self.value, "low": self.low, "high": self.high, "unit": self.unit}


@dataclass(frozen=True)
class Effect:
    """An effect that was found: what, where, how sure, how large. `element`: its name in the new model.

    between: its terminals, or channel: of a sensor. confidence: in [0, 1]. parameters: by name. behind: of what is in series there,
    the one element of several side by side that it carries; empty for all of them.
    """

    effect: str
    between: tuple[str, str] | None
    channel: str | None
    confidence: float
    parameters: dict[str, Quantity]
    element: str
    behind: str = ""

    def to_dict(self) -> dict[str, Any]:
        """Return the entry of the JSON document."""
        out: dict[str, Any] = {"effect": self.effect}
        if self.channel is not None:
            out["channel"] = self.channel
        else:
            out["between"] = list(self.between) if self.between else None
        if self.behind:
            out["behind"] = self.behind
        out["confidence"] = self.confidence
        out["parameters"] = {k: q.to_dict() for k, q in self.parameters.items()}
        return out


@dataclass(frozen=True)
class Contender:
    """A set of effects that was tried: `score` is its excess error on held-out data (1: as the refit, 0: noise).

    where: the place of each. why_not: in words. values: of each effect, by parameter; options: its choices that are not
    numbers.
    """

    effects: tuple[str, ...]
    where: tuple[tuple[str, ...], ...]
    score: float
    likelihood: float  # -2 log L behind the best
    why_not: str
    values: tuple[dict[str, float], ...] = ()
    options: tuple[dict[str, str], ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """Return the entry of the JSON document."""
        return {
            "effects": list(self.effects),
            "where": [list(w) for w in self.where],
            "excess": self.score,
            "why_not": self.why_not,
            "values": [dict(v) for v in self.values],
            "options": [dict(o) for o in self.options],
        }


@dataclass(frozen=True)
class Place:
    """Where the gap lives in one channel: its `share`, the bands [Hz] that hold most of it, and `when`.

    bands_hz: (low, high) each.
    """

    channel: str
    share: float
    bands_hz: tuple[tuple[float, float], ...]
    when: str

    def to_dict(self) -> dict[str, Any]:
        """Return the entry of the JSON document."""
        return {
            "channel": self.channel,
            "share": self.share,
            "bands_hz": [list(b) for b in self.bands_hz],
            "when": self.when,
        }


@dataclass(frozen=True)
class Trace:
    """One record: `time` (n,), and per channel what was measured and what each model says (n,).

    name: of the record; held_out: whether no sample of it took part in fitting. inputs and measured; before, refit, after:
    the owner's model, the same refitted, the new one. held_from: [s] time from which a record took no part in fitting whose
    earlier samples did; None where it was fitted or held out as a whole.
    """

    name: str
    held_out: bool
    time: Array
    inputs: dict[str, Array]
    measured: dict[str, Array]
    before: dict[str, Array]
    refit: dict[str, Array]
    after: dict[str, Array]
    held_from: float | None = None

    @property
    def use(self) -> str:
        """Use of the record in words."""
        if self.held_from is None:
            return "held out" if self.held_out else "fitted"
        return f"fitted up to {self.held_from:.4g} s, then held out"


@dataclass(frozen=True)
class Law:
    """The force [N] of a found effect over its elongation [m] or rate [m/s], with its 95 % band; and the operating points.

    element: its name in the new model. axis (n,): elongation or rate; low, high (n,): the band.
    """

    element: str
    kind: str  # 'rate' or 'travel'
    axis: Array
    force: Array
    low: Array
    high: Array
    visited: Array  # where the measurements have been
    residual_before: Array  # force-like residual at `visited`, empty where there is none


@dataclass(frozen=True)
class Tabulated:
    """A force without a name: where, over what, its table with the 95 % band, and the known laws that come nearest.

    between: the terminals; over: 'rate', 'elongation' or 'both'; element: its name in the new model; explained: share of the
    held-out excess that it removes. elongation, rate: knots [m], [m/s] (rad where it turns); force, low, high: at them [N] (N m).
    nearest: (effect, share of the force's square that the law gives over the measured motion), best first.
    shares: of a table over both, (argument, share of the force's square that a function of that argument alone gives).
    """

    between: tuple[str, str]
    over: Over
    element: str
    explained: float
    elongation: tuple[float, ...]
    rate: tuple[float, ...]
    force: Array
    low: Array
    high: Array
    nearest: tuple[tuple[str, float], ...] = ()
    shares: tuple[tuple[str, float], ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """Return the entry of the JSON document."""
        axes = {k: list(v) for k, v in (("elongation", self.elongation), ("rate", self.rate)) if v}
        return {
            "between": list(self.between),
            "over": self.over,
            "element": self.element,
            "explained": self.explained,
            **axes,
            "force": self.force.tolist(),
            "low": self.low.tolist(),
            "high": self.high.tolist(),
            "nearest": [{"effect": name, "share": share} for name, share in self.nearest],
            "shares": dict(self.shares),
        }


@dataclass(frozen=True)
class BestTable:
    """The table of a force that explains the held-out records best, stated or not.

    between: the terminals. over: what the force is a function of. explained: share of the held-out excess error that the table removes.
    gates: the conditions for a table to be stated.
    """

    between: tuple[str, str]
    over: Over
    explained: float
    gates: tuple[Gate, ...]

    @property
    def accepted(self) -> bool:
        """Whether the table passes every gate."""
        return all(g.passed for g in self.gates)

    def to_dict(self) -> dict[str, Any]:
        """Return the entry of the JSON document."""
        return {
            "between": list(self.between),
            "over": self.over,
            "explained": self.explained,
            "gates": [g.to_dict() for g in self.gates],
        }


@dataclass(frozen=True)
class BestCandidate:
    """The best set of effects where nothing is named.

    effects: names of the effects. where: the place of each. values: of each, by parameter. explained: share of the held-out excess error
    removed. error: `before`, `refit`, `after` -> channel -> NRMSE on the records to report by. failed_gates: why it is not named.
    """

    effects: tuple[str, ...]
    where: tuple[tuple[str, ...], ...]
    values: tuple[dict[str, float], ...]
    explained: float
    error: dict[str, dict[str, float]]
    failed_gates: tuple[Gate, ...]

    def to_dict(self) -> dict[str, Any]:
        """Return the entry of the JSON document."""
        return {
            "effects": list(self.effects),
            "where": [list(w) for w in self.where],
            "values": [dict(v) for v in self.values],
            "explained": self.explained,
            "error": self.error,
            "failed_gates": [g.to_dict() for g in self.failed_gates],
        }


@dataclass(frozen=True)
class Remainder:
    """The error that a named effect leaves, where it is wide.

    channel: with the widest rest. after, noise_floor: its NRMSE on the records to report by. when: the condition under which the
    rest is largest. effects, where: the closest addition that was tried and not kept, with its places; error: NRMSE with it.
    """

    channel: str
    after: float
    noise_floor: float
    when: str
    effects: tuple[str, ...] = ()
    where: tuple[tuple[str, ...], ...] = ()
    error: float = math.nan

    def to_dict(self) -> dict[str, Any]:
        """Return the entry of the JSON document."""
        addition = {
            "effects": list(self.effects),
            "where": [list(w) for w in self.where],
            "error": self.error,
        }
        return {
            "channel": self.channel,
            "after": self.after,
            "noise_floor": self.noise_floor,
            "when": self.when,
            "candidate": addition if self.effects else None,
        }


@dataclass(frozen=True)
class Stretches:
    """The brief stretches over which records were compared, each from an initial state of its own.

    count: of stretches. shortest, longest: their lengths [s]. reason: 'diverges' (the simulation of whole records breaks down),
    'astray' (it errs by more than the limit), 'feedback' (an input follows from outputs) or 'unnamed' (over whole records no name
    passes every gate). error: of the refitted model
    over whole records, as a share of the deviation, mean over channels. limit: of that error.
    """

    count: int
    shortest: float
    longest: float
    reason: Literal["diverges", "astray", "unnamed", "feedback"]
    error: float
    limit: float


@dataclass(frozen=True, repr=False)
class Diagnosis:
    """The outcome of `diagnose`. `summary` says it in a sentence; `to_dict` is the contract's JSON.

    verdict: the contract's word. effects: what was found; contenders: what else was tried. where: the gap lives.
    parameters: of the owner's model, refitted. closed: share of the gap. gates: what had to hold.
    next_experiment: what would decide, where something would; test: its inputs, as a rig plays them. base, refitted, model: the owner's network, the
    same refitted, the new one (of a unit for co-simulation, what its description says). traces and laws: for pictures. notes: in words. seconds: of work. units: of the
    channels. lags: of loggers' clocks. evidence, criteria, settings: what was weighed, by which limits, and how it was searched. tabulated: the force that
    is missing where no known law gives it. best_table: the best table that was fitted, stated or not. best_candidate: the best set of
    effects where nothing is named. reason: the condition that led to the verdict (`criteria.Reason`). remainder: what a named effect leaves.
    stretches: over which records were compared where these are not whole. constant: by channel, the share of the squared error that is
    constant (units for co-simulation alone). findings: probabilities of places, kinds and laws. whole: the owner's whole model with what was found, where a part of it was diagnosed.
    """

    verdict: str
    summary: str
    effects: tuple[Effect, ...]
    contenders: tuple[Contender, ...]
    where: tuple[Place, ...]
    parameters: dict[str, Quantity]
    gap: dict[str, dict[str, float]]  # before, refit, after, noise_floor -> channel -> NRMSE
    closed: float | None
    gates: tuple[Gate, ...]
    next_experiment: dict[str, Any] | None
    base: Network | UnitModel
    refitted: Network | UnitModel
    model: Network | UnitModel
    traces: tuple[Trace, ...]
    laws: tuple[Law, ...] = ()
    notes: tuple[str, ...] = ()
    seconds: float = 0.0
    units: dict[str, str] = field(default_factory=dict)
    small_effects: tuple[Effect, ...] = ()  # there, but too small to be named
    evidence: Evidence | None = None
    criteria: Criteria | None = None
    settings: SearchSettings | None = None
    tabulated: Tabulated | None = None
    whole: Network | None = None  # where the model was cut: all of it, with what was found
    lags: tuple[Lag, ...] = ()  # of loggers' clocks
    test: Table | None = None
    best_table: BestTable | None = None
    best_candidate: BestCandidate | None = None
    reason: Reason = "gates"
    remainder: Remainder | None = None
    stretches: Stretches | None = None
    constant: dict[str, float] = field(default_factory=dict)
    findings: tuple[Finding, ...] = ()
    #: inputs that follow from outputs
    closed_loop: tuple[Feedback, ...] = ()

    def __repr__(self) -> str:
        found = [f"{e.effect} {e.channel or '-'.join(e.between or ())}".strip() for e in self.effects]
        if self.tabulated is not None:
            found = [f"force without a name {'-'.join(self.tabulated.between)}"]
        closed = "" if self.closed is None else f", closed={self.closed:.3g}"
        return f"Diagnosis({self.verdict!r}, found={found}{closed}, {len(self.traces)} record(s))"

    def _repr_html_(self) -> str:
        """Return verdict, effects and gap as HTML for notebooks."""
        stages = [s for s in ("before", "refit", "after", "noise_floor") if s in self.gap]
        rows = [
            [e.effect, e.channel or "-".join(e.between or ()), name, f"{q.value:.4g} {q.unit}", f"{q.low:.4g} to {q.high:.4g}"]
            for e in self.effects
            for name, q in e.parameters.items()
        ]  # fmt: skip
        out = f"<p><b>{html.escape(self.verdict)}</b>: {html.escape(self.summary)}</p>"
        if rows:
            out += _table(["effect", "where", "parameter", "value", "95 % interval"], rows)
        gap = [[c, *(f"{100 * self.gap[s][c]:.1f} %" for s in stages)] for c in self.gap.get("refit", {})]
        return out + _table(["error on held-out data", *stages], gap)

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON document (`isd-diagnosis/1`)."""
        return _plain(
            {
                "schema": SCHEMA,
                "verdict": self.verdict,
                "summary": self.summary,
                "effects": [e.to_dict() for e in self.effects],
                "findings": [f.to_dict() for f in self.findings],
                "small_effects": [e.to_dict() for e in self.small_effects],
                "alternatives": [c.to_dict() for c in self.contenders],
                "where": [p.to_dict() for p in self.where],
                "parameters": {k: q.to_dict() for k, q in self.parameters.items()},
                "gap": {"held_out": self.gap, "closed": self.closed},
                "gates": [g.to_dict() for g in self.gates],
                "reason": self.reason,
                "best_candidate": self.best_candidate.to_dict() if self.best_candidate else None,
                "best_table": self.best_table.to_dict() if self.best_table else None,
                "remainder": self.remainder.to_dict() if self.remainder else None,
                "stretches": asdict(self.stretches) if self.stretches else None,
                "constant": self.constant,
                "closed_loop": [asdict(f) | {"outputs": list(f.outputs)} for f in self.closed_loop],
                "next_experiment": self.next_experiment,
                "tabulated": self.tabulated.to_dict() if self.tabulated else None,
                "evidence": _finite(asdict(self.evidence)) if self.evidence else None,
                "criteria": asdict(self.criteria) if self.criteria else None,
                "search": asdict(self.settings) if self.settings else None,
                "clocks": [
                    {
                        "record": x.record,
                        "clock": x.clock,
                        "lag": {"value": x.value, "low": x.low, "high": x.high, "unit": "s"},
                        **({"doubt": x.doubt} if x.doubt else {}),
                    }
                    for x in self.lags
                ],
                "notes": list(self.notes),
            }
        )

    def save(self, folder: str | Path) -> None:
        """Write diagnosis.json, model.json (of a unit its parameters.ssv) and, where a test would decide, next_experiment.csv
        into `folder`, each whole or not at all.

        The folder is new, empty or an earlier diagnosis; raises `InputError` for any other.
        """
        folder = claim_folder(folder, *FOLDER)
        write_text(folder / "diagnosis.json", json.dumps(self.to_dict(), indent=1, allow_nan=False) + "\n")
        model = self.whole or self.model
        model.save(folder / ("parameters.ssv" if isinstance(model, UnitModel) else "model.json"))
        if self.test is not None:
            write_table(folder / "next_experiment.csv", self.test)


def _table(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    def line(tag: str, cells: Sequence[str]) -> str:
        return "<tr>" + "".join(f"<{tag}>{html.escape(c)}</{tag}>" for c in cells) + "</tr>"

    return f"<table><thead>{line('th', heads)}</thead><tbody>{''.join(line('td', r) for r in rows)}</tbody></table>"


def _finite(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return the entries without infinite numbers, such as the loss ratio without a rival."""
    return {k: v for k, v in values.items() if not (isinstance(v, float) and math.isinf(v))}


def _plain(value: Any) -> Any:
    """Return JSON types; a number that is not finite becomes null."""
    if isinstance(value, Mapping):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    if isinstance(value, bool | np.bool_):
        return bool(value)
    if isinstance(value, float | int | np.floating | np.integer):
        if isinstance(value, int | np.integer):
            return int(value)
        return float(value) if math.isfinite(value) else None
    return value
