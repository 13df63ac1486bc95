"""The workflow from records and a model to a verdict: read, search, measure, decide, report."""

from __future__ import annotations

import contextlib
import math
import time as clock
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from threadpoolctl import threadpool_limits

from .._common.errors import InputError
from ..physics.network import Network, assemble, rejoin
from ..physics.network import cut as network_cut
from ..physics.simulate import pace
from ..records.data import Table
from ..records.loggers.recording import Recording
from ._estimation.clock_lag import align_clocks
from ._estimation.exchanged_roles import invert, prefer_direct_problem
from ._records.agreement import find_misreading
from ._records.feedback import Feedback, find_feedback
from ._records.filtering import differentiate_inputs
from ._records.reading import read_record, thin_long_record
from ._records.resampling import check_sampling_rates
from ._records.splitting import LEAD_IN, cut_segments, split_records
from ._result_builder import ResultBuilder
from ._selection.criteria import CRITERIA, Criteria
from ._selection.held_out import HeldOutEvaluator
from ._selection.held_out_table import row_of
from ._selection.law_sets import Search
from ._selection.settings import SearchSettings
from ._simulation.problem import BROKEN, Problem, Record, Role
from ._simulation.time_limit import EVIDENCE, SEARCH, TimeLimit, TimeUp, running
from ._verdict.closed_loop import decide_under_feedback
from ._verdict.evidence import collect_evidence
from ._verdict.gates import decide
from .result import Diagnosis, Stretches

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence

    from ._estimation.gauss_newton import Fit


def diagnose(
    data: Sequence[Table | Recording | str | Path],
    model: Network | str | Path | Mapping[str, Any],
    *,
    validate: Sequence[Table | Recording | str | Path] = (),
    accept: Sequence[str] = (),
    progress: Callable[[str], None] | None = None,
    settings: SearchSettings | None = None,
    criteria: Criteria = CRITERIA,
    cut: str | None = None,
) -> Diagnosis:
    """Find where simulation and measurement disagree, and name the physical effect that is missing.

    Args:
        data: Records to fit by: tables, recordings of loggers, or files.
        model: The nominal model.
        validate: Records that take no part in fitting. A part of them chooses between explanations; the reported figures are of the
            rest. By default whole records of `data`, or the later part of a single record, are held out.
        accept: Names of data checks that only warn, or 'all'.
        progress: Function that receives a line per stage.
        settings: Settings of the search; returned with the result.
        criteria: Limits of the decision; returned with the result.
        cut: A node whose motion an output measures. That motion drives the model on this side of the node; the model behind the node
            (tyre and road) is left out (`isd_gym.physics.network.cut`).

    Returns:
        The diagnosis. Parts that the limit of the time left out are its `not_tried`.

    Raises:
        InputError: The data or the model cannot be used, or the time is up before the nominal model is compared with the records.
    """
    steps, start, notes = settings or SearchSettings(), clock.perf_counter(), []
    limit = running() or TimeLimit(steps.max_seconds, clock.monotonic)
    network = Network.load(model)
    if not network.outputs:
        raise InputError(f"model '{network.name}' has no outputs to compare with")
    sources = (
        _several(data, "data"),
        _several(validate, "validate") if len(validate) else [],
    )
    part = network if cut is None else network_cut(network, cut)
    if cut is not None:
        kept = {e.name for e in part.elements}
        left = [e.name for e in network.elements if e.name not in kept]
        notes.append(
            f"cut at {cut}, which {part.inputs[0].name} moves; left out: {', '.join(left)}"
        )
    with _answering(limit, steps):
        fit, held = (
            [read_record(d, part, notes, accept) for d in side] for side in sources
        )
        _check_copies([*fit, *held])
        records = [thin_long_record(r, part, notes) for r in (*fit, *held)]
        for record in records:
            check_sampling_rates(record, part)
        with limit.until(SEARCH):
            records, lags = align_clocks(records, part, steps.max_lag)
            direct = prefer_direct_problem(
                records, part, len(fit), steps.input_noise, steps.swapped_error
            )
        if direct is not None:
            records, part, note = direct
            notes.append(note)
        feedback = find_feedback(records, part)
        whole = _whole(records, part, len(fit))
        with limit.until(SEARCH):
            misreading = find_misreading(whole)
        if misreading:
            if not {"sign", "all"} & set(accept):
                raise InputError(f"{misreading} (--accept sign goes on)")
            notes.append(misreading)
        flow = Workflow(
            *_split(whole, notes),
            notes,
            progress or (lambda line: None),
            steps,
            criteria,
            feedback,
            clock=limit,
        )
        # one thread for linear algebra: sums do not depend on the number of cores
        with threadpool_limits(1):
            # where a closed loop is found, brief stretches of the motion come first
            found = None if feedback else _diagnose_inverse(flow, records)
            if found is None:
                found = flow.run()
            if feedback and found.verdict == "unknown_effect":
                found = _diagnose_inverse(flow, records) or found
    found = replace(
        found,
        lags=tuple(lags),
        notes=(*found.notes, *map(str, lags)),
        seconds=clock.perf_counter() - start,
    )
    if cut is not None:
        found = replace(found, whole=rejoin(network, found.model))
    return found


@contextlib.contextmanager
def _answering(limit: TimeLimit, steps: SearchSettings) -> Iterator[None]:
    """Let simulations within the block look at the clock, and refuse an answer that the time does not suffice for."""
    try:
        with limit.until(math.inf):
            yield
    except TimeUp:
        raise InputError(
            f"the time limit of {steps.max_seconds:g} s is over before the nominal model is refitted and compared with the records: "
            "raise --max-seconds, or give shorter records"
        ) from None


def _whole(records: list[Record], network: Network, training: int) -> Problem:
    """Return whole records with differentiated inputs, the first of them for training."""
    roles: list[Role] = [
        "fit" if i < training else "report" for i in range(len(records))
    ]
    return Problem(network, differentiate_inputs(records, network), roles)


def _split(
    whole: Problem, notes: list[str]
) -> tuple[Problem, Problem, tuple[float, ...]]:
    """Return training, validation and test records, the whole records, and the time [s] from which each of these is held out; how they
    are split is added to the notes."""
    training = len(whole.estimation)
    # where the whole motion is prescribed, only the memory of laws needs a lead-in
    lead = 0.0 if assemble(whole.network.mechanical).size[0] else LEAD_IN * whole.time
    records, roles = split_records(
        whole.records[:training], whole.records[training:], notes, whole.time, lead
    )
    problem = Problem(whole.network, records, roles)
    return problem, whole, held_from(whole, problem)


def _diagnose_inverse(flow: Workflow, records: list[Record]) -> Diagnosis | None:
    """Return the diagnosis of the force that the measured motion needs, where the simulation of a mass that no spring holds drifts away;
    None without an inverse of the model, without a name, or where the named laws leave as much. Its `whole` is the completed model."""
    inverse = invert(flow.network)
    if inverse is None or any(r.source is not None for r in records):
        return None
    limit = flow.clock
    try:
        with limit.until(SEARCH):
            error = flow.error_of_whole_records
        if error <= flow.settings.drifted:
            return None
        note = (
            f"{inverse.network.inputs[0].name} is taken as input and {inverse.network.outputs[0].name} as output: no spring holds the motion, "
            f"and the simulated one errs by {error:.0%}"
        )
        own = [*flow.notes, note]
        whole = _whole(
            inverse.records(records), inverse.network, len(flow.whole.estimation)
        )
        problem, _, held = _split(whole, own)
        # a controller that sets the force changes nothing in the force that a motion needs
        turned = replace(
            flow, problem=problem, whole=whole, held_from=held, notes=own, feedback=()
        )
        with limit.until(EVIDENCE):
            found = turned.run()
    except TimeUp:
        limit.leave_out("the force that the measured motion needs")
        return None
    except (InputError, *BROKEN):
        return None
    left = [*found.gap["after"].values()]
    if found.evidence is not None:
        left += found.evidence.after
    if found.verdict != "missing_effect" or max(left) > flow.settings.drifted:
        return None
    return replace(found, whole=inverse.restore(found.model))


def held_from(whole: Problem, problem: Problem) -> tuple[float, ...]:
    """Return the time [s] from which each whole record takes no part in fitting; infinite for records that are fitted to the end."""
    out = []
    for record in whole.records:
        own: dict[bool, list[float]] = {True: [], False: []}
        for part, role in zip(problem.records, problem.roles, strict=True):
            if np.may_share_memory(part.measured, record.measured):
                own[role == "fit"].append(float(part.time[0]))
        out.append(min(own[False], default=math.inf) if own[True] else -math.inf)
    return tuple(out)


def _check_copies(records: Sequence[Record]) -> None:
    """Raise `InputError` for two records with equal samples: a copy confirms nothing."""
    known: dict[tuple[bytes, ...], str] = {}
    for r in records:
        samples = (r.measured.tobytes(), *(x.tobytes() for x in r.inputs.values()))
        if samples in known:
            raise InputError(
                f"{r.name} has the samples of {known[samples]}: give each record once"
            )
        known[samples] = r.name


def _several(data: Any, name: str) -> list[Any]:
    """Return a list of sources; raise InputError where there is none."""
    out = [data] if isinstance(data, Table | Recording | str | Path) else list(data)
    if not out:
        raise InputError(f"{name}: no records")
    return out


@dataclass(eq=False)
class Workflow:
    """One diagnosis: search, evidence, decision and result."""

    #: training, validation and test records
    problem: Problem
    #: the whole records
    whole: Problem
    #: time from which each whole record takes no part in fitting [s]
    held_from: tuple[float, ...]
    notes: list[str]
    say: Callable[[str], None]
    settings: SearchSettings
    criteria: Criteria
    #: inputs that follow from outputs
    feedback: tuple[Feedback, ...] = ()
    #: whether the records of the problem are segments
    is_segmented: bool = False
    clock: TimeLimit = field(default_factory=TimeLimit)

    def __post_init__(self) -> None:
        self.network = self.problem.network
        evaluator = HeldOutEvaluator(self.problem, self.whole)
        self.search = Search(
            evaluator, self.settings, self.criteria, self.say, self.clock
        )

    def run(self) -> Diagnosis:
        """Run the diagnosis of whole records; where the refitted model loses the measured motion, that of segments first, each from an
        initial state of its own."""
        p = self.problem
        self.say(
            f"{len(p.estimation)} stretches to fit, {len(p.held)} held out; refitting the model"
        )
        with self.clock.until(SEARCH):
            refitted, error = self.refitted, self.error_of_whole_records
        if self.feedback or not error <= self.settings.astray:
            found = self._diagnose_segments(error)
            if found is not None:
                return found
        return self.conclude(refitted).build()

    def conclude(self, refitted: Fit) -> ResultBuilder:
        """Search from the refitted model, measure the answer and decide on it; a set that cannot be measured loses."""
        evaluator, c = self.search.evaluator, self.criteria
        answer = self.search.run(refitted)
        try:
            with self.clock.until(EVIDENCE):
                measured = collect_evidence(evaluator, answer)
        except (TimeUp, *BROKEN) as error:
            if isinstance(error, TimeUp):
                self.clock.leave_out(f"the tests of {answer.foremost.fit.label}")
            answer = replace(answer, band=(), weights=(), best=answer.refit)
            with self.clock.until(1.0):
                measured = collect_evidence(evaluator, answer)
        decision = decide_under_feedback(
            decide(answer, measured.evidence, c),
            self.problem,
            answer.foremost.fit,
            self.feedback,
            self.is_segmented,
            c,
        )
        return ResultBuilder(
            self.search,
            answer,
            measured,
            decision,
            self.whole,
            self.held_from,
            self.feedback,
            [*self.notes],
        )

    # -- segments -----------------------------------------------------------------------------------------
    def has_free_motion(self) -> bool:
        """Return whether an input ties the motion to the record, and a motion can start anew."""
        return (
            bool(self.network.inputs) and assemble(self.network.mechanical).size[0] > 0
        )

    @cached_property
    def refitted(self) -> Fit:
        """The refitted nominal model."""
        return self.search.refit_nominal()

    @cached_property
    def error_of_whole_records(self) -> float:
        """The error of the refitted model over whole records, as a share of the deviation, mean over channels: the larger one of training
        and validation records; NaN where the simulation breaks down, 0 where no motion can start anew."""
        if not self.has_free_motion():
            return 0.0
        try:
            row = row_of(self.search.evaluator, self.refitted)
        except BROKEN:
            return math.nan
        return float(max(row.training.mean(), row.validation.mean()))

    def _segmented(self) -> Problem:
        """Return the problem with the records in segments, each from an initial state of its own."""
        p, s = self.problem, self.settings
        slowest = max(pace(y, r.interval) for r in p.records for y in r.measured.T)
        seconds = max(s.segment * p.time, s.least_segment * slowest)
        pieces: dict[Role, list[Record]] = {"fit": [], "choose": [], "report": []}
        for r, role in zip(p.records, p.roles, strict=True):
            pieces[role] += cut_segments(r, seconds, s.shortest)
        records: list[Record] = []
        roles: list[Role] = []
        for role, own in pieces.items():
            kept = own[:: max(1, math.ceil(len(own) / s.segments))]
            records += kept
            roles += [role] * len(kept)
        return Problem(self.network, records, roles, p.step, p.time)

    def _diagnose_segments(self, error: float) -> Diagnosis | None:
        """Diagnose over segments: no simulation follows a rig for long that has many positions of rest, hits stops or drifts. None
        where nothing is decided."""
        if not self.has_free_motion():
            return None
        flow = replace(self, problem=self._segmented(), is_segmented=True)
        if len(flow.problem.records) == len(self.problem.records) and not self.feedback:
            return None  # no record is long enough to be cut
        lengths = [len(r) * r.interval for r in flow.problem.records]
        reason: Literal["diverges", "astray", "feedback"] = "diverges"
        if self.feedback:
            reason = "feedback"
        elif math.isfinite(error):
            reason = "astray"
        over = Stretches(
            count=len(lengths),
            shortest=min(lengths),
            longest=max(lengths),
            reason=reason,
            error=error,
            limit=self.settings.astray,
        )
        self.say(
            f"comparing over {over.count} stretches of {over.shortest:.2g} to {over.longest:.2g} s, each from its own state"
        )
        try:
            with self.clock.until(SEARCH):
                refitted = flow.refitted
            found = flow.conclude(refitted)
        except TimeUp:
            self.clock.leave_out("a comparison over brief stretches")
            return None
        except BROKEN:
            return None
        # under feedback whole records are no valid comparison
        if found.decision.verdict == "unknown_effect" and not self.feedback:
            return None
        return found.build(over)
