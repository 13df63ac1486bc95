"""The workflow from records and a model to a verdict: read, search, measure, decide, report."""

from __future__ import annotations

import math
import time as clock
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from threadpoolctl import threadpool_limits

from ..data import Table
from ..errors import InputError
from ..loggers.recording import Recording
from ..network import Network, assemble, rejoin
from ..network import cut as network_cut
from .estimation.gauss_newton import Fitter, residuals
from .estimation.noise import plain, whitener
from .estimation.structure import base_structure, owner_pair
from .hypotheses.library import hypotheses
from .hypotheses.score_test import screen
from .planning import next_experiment, played
from .records import (
    LEAD_IN,
    align_clocks,
    check_sampling_rates,
    cut_segments,
    differentiate_inputs,
    read_record,
    split_records,
)
from .result import BestCandidate, Contender, Diagnosis, Effect, Quantity, Remainder, Stretches, Trace
from .selection.candidate import BROKEN, Candidate, reckoned, values_of
from .selection.forward_backward import Search
from .selection.free_force import Followed, follow
from .selection.held_out import Judge
from .selection.settings import SearchSettings
from .selection.weights import weigh_candidates
from .simulation.problem import Problem, Record, Role, bare, pace
from .verdict.criteria import CRITERIA, Criteria, Decision, confidence, decide, with_findings
from .verdict.explanation import law, places, table_law
from .verdict.findings import find
from .verdict.measurement import Measured, intervals, measure
from .verdict.wording import summary_of

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from .selection.candidate_comparison import Trial
    from .selection.refits import Say
    from .verdict.evidence import Evidence
    from .verdict.findings import Finding


def diagnose(
    data: Sequence[Table | Recording | str | Path],
    model: Network | str | Path | Mapping[str, Any],
    *,
    validate: Sequence[Table | Recording | str | Path] = (),
    accept: Sequence[str] = (),
    progress: Callable[[str], None] | None = None,
    seed: int = 0,
    settings: SearchSettings | None = None,
    criteria: Criteria = CRITERIA,
    cut: str | None = None,
) -> Diagnosis:
    """Find where simulation and measurement disagree, and name the physical effect that is missing.

    data: records to fit by (tables, recordings of loggers, or files). model: the owner's model. validate: records that take no part in fitting:
    some of their stretches choose between explanations, the figures reported are of the others; without them whole
    records of `data`, or the later part of a single one, are held out. accept: checks of the data gate that only warn
    (their names, or 'all'). progress: called with a line now and then. seed: of the bootstrap. settings: what steers the
    search; criteria: what decides; both come back with the result. cut: a node whose motion an output measures: it drives what
    stands on this side of it, and what lies behind (tyre and road) is left out (`isd_gym.network.cut`). Raises `InputError` with one line for data that
    cannot be used.
    """
    begun = clock.perf_counter()
    whole_network = network = Network.load(model)
    if not network.outputs:
        raise InputError(f"model '{network.name}' has no outputs to compare with")
    notes: list[str] = []
    steps = settings or SearchSettings()
    if cut is not None:
        network = network_cut(network, cut)
        left = [e.name for e in whole_network.elements if e.name not in {x.name for x in network.elements}]
        notes.append(f"cut at {cut}, which {network.inputs[0].name} moves; left out: {', '.join(left)}")
    fit = [read_record(d, network, notes, accept) for d in _several(data, "data")]
    held = (
        [read_record(d, network, notes, accept) for d in _several(validate, "validate")]
        if len(validate)
        else []
    )

    for record in (*fit, *held):
        check_sampling_rates(record, network)
    loose, lags = align_clocks([*fit, *held], network, steps.max_lag)
    filtered = differentiate_inputs(loose, network)
    kept: list[Role] = ["fit"] * len(fit)
    kept += ["report"] * len(held)
    whole = Problem(network, filtered, kept)
    # a rig whose whole motion is prescribed begins a stretch with nothing but what its laws remember
    lead = 0.0 if assemble(bare(network)).size[0] else LEAD_IN * whole.time
    records, roles = split_records(filtered[: len(fit)], filtered[len(fit) :], notes, whole.time, lead)
    problem = Problem(network, records, roles)
    flow = Workflow(
        problem, whole, progress or (lambda line: None), seed, steps, criteria, held_from(whole, problem)
    )
    # sums in another order are other sums: the result is that of any number of cores
    with threadpool_limits(1):
        found = flow.run(notes, begun)
    if (
        found.verdict == "missing_effect" and lags and isinstance(found.model, Network)
    ):  # what was missing had a part in them
        _, lags = align_clocks(loose, found.model, previous=lags)
    found = replace(found, lags=tuple(lags), notes=(*found.notes, *map(str, lags)))
    if cut is not None and isinstance(found.model, Network):
        found = replace(found, whole=rejoin(whole_network, found.model))
    return found


def held_from(whole: Problem, problem: Problem) -> tuple[float, ...]:
    """Time [s] from which each whole record takes no part in fitting; infinite for the records that are fitted to the end.

    whole: the records as they came. problem: the same as `split_records` returns them, those to fit by first.
    """
    fitted = len(problem.estimation)
    if len(whole.records) == fitted == 1:
        return (float(problem.records[1].time[0]),)
    return tuple(math.inf if i < fitted else -math.inf for i in range(len(whole.records)))


def _several(data: Any, name: str) -> list[Any]:
    out = [data] if isinstance(data, Table | Recording | str | Path) else list(data)
    if not out:
        raise InputError(f"{name}: no records")
    return out


@dataclass(eq=False)
class Workflow:
    """The records cut for the search (`problem`) and as they came (`whole`), and the numbers that steer and decide.

    held_from [s]: the time from which each whole record takes no part in fitting.
    """

    problem: Problem
    whole: Problem
    say: Say
    seed: int
    settings: SearchSettings
    criteria: Criteria
    held_from: tuple[float, ...]

    def __post_init__(self) -> None:
        self.network = self.problem.network
        self.search = Search(Judge(self.problem), self.settings, self.criteria, self.say)
        self._last: tuple[Trial, Measured] | None = None

    def run(self, notes: list[str], begun: float) -> Diagnosis:
        p = self.problem
        self.say(
            f"{len(p.estimation)} record(s) to fit, {len(p.held)} stretches held out; refitting the model"
        )
        base = self.search.refitted()
        error = self.whole_error(base)
        early = not error <= self.settings.astray
        found = self.briefly(notes, begun, error, named_only=False) if early else None
        if found is not None:
            return found
        # what came second had its turn over brief stretches
        trial = self.search.weigh(*self.search.walk([base])) if early else self.search.run(base, self.enough)
        measured = self.measured(trial)
        decision = decide(measured.evidence, self.criteria)
        if decision.verdict == "unknown_effect" and not early:
            for times in (1.0, 2.0):
                found = self.briefly(notes, begun, error, named_only=True, times=times)
                if found is not None:
                    return found
        return self.report(trial, measured, decision, [*notes, *self.tried(trial)], begun)

    def measured(self, trial: Trial) -> Measured:
        """The evidence of a trial, once: the search asks for it, and the report again."""
        if self._last is None or self._last[0] is not trial:
            self._last = trial, measure(self.search, trial, self.seed)
        return self._last[1]

    def enough(self, trial: Trial) -> bool:
        """Whether a trial needs no runners-up."""
        found = decide(self.measured(trial).evidence, self.criteria)
        # a force whose place is known and whose law nobody has written down: other names would only be other curves
        nameless = {g.name for g in found.gates if not g.passed} == {"shape"}
        return nameless or found.verdict in ("missing_effect", "no_discrepancy", "parameters_only")

    def tried(self, trial: Trial) -> list[str]:
        every = list(hypotheses(self.network))
        where = dict.fromkeys("-".join(h.where) for h in every)
        return [
            f"tried {len({h.effect for h in every})} effects at {len(where)} places: {', '.join(where)}",
            *(f"tried {line}" for line in trial.notes),
        ]

    # -- brief stretches ----------------------------------------------------------------------------------
    def movable(self) -> bool:
        """Whether an input ties the motion to the record, and there is a motion to begin anew."""
        return bool(self.network.inputs) and assemble(bare(self.network)).size[0] > 0

    def whole_error(self, base: Candidate) -> float:
        """Error of the refitted model over whole records, as a share of the deviation, mean over channels.

        The larger of the errors on fitted and held-out records, which may be longer, or driven harder. NaN where the simulation breaks
        down; zero where nothing can begin anew.
        """
        if not self.movable():
            return 0.0
        try:
            seen = self.search.judge.own(base)
        except BROKEN:
            return math.nan
        return float(max(seen.fitted.mean(), seen.nrmse.mean()))

    def brief(self, times: float | None = None) -> Problem:
        """The same records in brief stretches, each from a state of its own.

        times: as many times the usual length, whatever the slowest channel, which in detents is slower than what holds in them.
        """
        p = self.problem
        slowest = max(pace(r.measured[:, j], r.rate) for r in p.records for j in range(len(p.channels)))
        seconds = self.settings.brief * p.time * (times or 1.0)
        seconds = seconds if times else max(seconds, self.settings.least_brief * slowest)
        pieces: dict[Role, list[Record]] = {"fit": [], "choose": [], "report": []}
        for r, role in zip(p.records, p.roles, strict=True):
            pieces[role] += cut_segments(r, seconds, self.settings.shortest)
        records: list[Record] = []
        roles: list[Role] = []
        for role, own in pieces.items():
            kept = own[:: max(1, math.ceil(len(own) / self.settings.pieces))]
            records += kept
            roles += [role] * len(kept)
        return Problem(self.network, records, roles, p.step, p.time)

    def compared(self, problem: Problem, error: float, named_only: bool) -> Stretches:
        """The stretches of a problem, and why records are compared over them."""
        lengths = [len(r) * r.rate for r in problem.records]
        reason: Literal["diverges", "astray", "unnamed"] = "unnamed"
        if not named_only:
            reason = "astray" if math.isfinite(error) else "diverges"
        return Stretches(len(lengths), min(lengths), max(lengths), reason, error, self.settings.astray)

    def briefly(
        self, notes: list[str], begun: float, error: float, *, named_only: bool, times: float | None = None
    ) -> Diagnosis | None:
        """The search over brief stretches; None where it comes to nothing.

        What has many rests, what hits stops while it resonates, what drifts: no simulation stays with it for long.
        error: of the refitted model over whole records. `named_only`: only what repeats over travel is looked for, and only a name
        counts. `times`: as of `brief`.
        """
        if not self.movable():
            return None
        problem = self.brief(times)
        over = self.compared(problem, error, named_only)
        self.say(
            f"comparing over {over.count} stretches of {over.shortest:.2g} to {over.longest:.2g} s, each from its own state"
        )
        flow = replace(self, problem=problem)
        search = flow.search
        try:
            base = search.refitted()
            if named_only and (flow.little(base) or not flow.repeats(base)):
                return None
            trial = (
                search.weigh(*search.walk([base], depth=1)) if named_only else search.run(base, flow.enough)
            )
            measured = flow.measured(trial)
        except BROKEN:  # it breaks down on the held-out records
            return None
        decision = decide(measured.evidence, self.criteria)
        named = decision.verdict == "missing_effect"
        if not named and (named_only or decision.verdict == "unknown_effect"):
            return None
        if named_only and not trial.foremost.hypotheses[0].kind.periodic:
            return None
        return flow.report(trial, measured, decision, [*notes, *flow.tried(trial)], begun, over)

    def little(self, base: Candidate) -> bool:
        """Whether the refitted model leaves less than a named effect moves."""
        here = self.search.judge.own(base)
        return float(here.excess(self.search.judge.floor(here)).max()) < self.criteria.material

    def repeats(self, base: Candidate) -> bool:
        """Whether what repeats over travel is among the foremost in the score test."""
        p, floors = self.problem, self.search.floors
        W = whitener(residuals(p, base.fit), reckoned(p, base.fit, floors))
        screened = screen(p, Fitter(p, W), base.fit, list(hypotheses(self.network)))
        foremost = list(dict.fromkeys(s.hypothesis for s in screened))[:3]
        return any(h.kind.periodic for h in foremost)

    def found(
        self, trial: Trial, measured: Measured, decision: Decision, drawn: Followed
    ) -> tuple[Decision, tuple[Finding, ...]]:
        """Return the decision and the findings, with the free force among the candidates where one was fitted."""
        if decision.verdict in ("no_discrepancy", "parameters_only") or not trial.foremost.hypotheses:
            return decision, ()
        weighted = measured.weighted
        if drawn.candidate is not None:
            weighted = weigh_candidates(self.search, trial, [drawn.candidate], self.seed)
        named = frozenset[tuple[tuple[str, ...], str]]()
        if decision.verdict == "missing_effect":
            own = next(w.statements for w in weighted if w.candidate is trial.foremost)
            named = frozenset((s.place, s.law) for s in own)
        findings = find(self.search, weighted, measured.evidence, measured.quantities, named)
        return with_findings(decision, findings, measured.evidence, self.criteria), findings

    # -- what is said -------------------------------------------------------------------------------------
    def traces(self, base: Candidate, final: Candidate) -> tuple[Trace, ...]:
        """Every record, whole, with what the three models say; initial states and offsets from the record itself."""
        out = []
        fitter = Fitter(self.whole, plain(self.search.floors))
        owner = base_structure(self.network)
        owner = fitter.with_offsets(owner, owner.start)
        says = [(owner, owner.start), (base.fit.structure, base.fit.x), (final.fit.structure, final.fit.x)]
        for i, record in enumerate(self.whole.records):
            fits = [fitter.fit(s, x, records=[i], frozen=True, iterations=3) for s, x in says]
            before, refit, after = (
                {c: f.outputs[i][:, j] for j, c in enumerate(self.whole.channels)} for f in fits
            )
            measured = {c: record.measured[:, j] for j, c in enumerate(self.whole.channels)}
            thin = {k: record.seen(v) for k, v in record.inputs.items()}
            since = self.held_from[i]
            cut = since if math.isfinite(since) else None
            out.append(
                Trace(record.name, since == -math.inf, record.time, thin, measured, before, refit, after, cut)
            )
        return tuple(out)

    def effects(self, candidate: Candidate, quantities: Mapping[str, Quantity], sure: float) -> list[Effect]:
        out = []
        for h, element in zip(candidate.hypotheses, candidate.fit.structure.names, strict=True):
            own = {
                path.rpartition(".")[2]: q
                for path, q in quantities.items()
                if path.rpartition(".")[0] == element
            }
            channel = h.where[0] if h.place == "channel" else None
            out.append(Effect(h.effect, owner_pair(self.network, h), channel, sure, own, element, h.behind))
        return out

    def drawn(self, base: Candidate) -> Followed:
        """The missing force as a table, where it can be followed."""
        self.say("no known law explains it: following the missing force")
        try:
            return follow(self.search.judge, base, self.criteria)
        except BROKEN:
            return Followed()

    def rejected(
        self, trial: Trial, evidence: Evidence, decision: Decision, rows: Mapping[str, np.ndarray]
    ) -> BestCandidate | None:
        """The best set of effects, where it is not named."""
        best = trial.foremost
        if decision.verdict == "missing_effect" or not best.hypotheses:
            return None
        stages = {k: rows[k] for k in ("before", "refit")} | {"after": trial.of(best).reported}
        return BestCandidate(
            tuple(h.effect for h in best.hypotheses),
            tuple(h.where for h in best.hypotheses),
            tuple(values_of(e) for e in best.elements),
            evidence.explained,
            {k: self.by_channel(row) for k, row in stages.items()},
            tuple(g for g in decision.gates if not g.passed),
        )

    def by_channel(self, row: np.ndarray) -> dict[str, float]:
        return {n: float(v) for n, v in zip(self.problem.channels, row, strict=True)}

    def contenders(self, trial: Trial, abreast: Sequence[Candidate], ambiguous: bool) -> list[Contender]:
        refit, best = trial.of(trial.base), trial.foremost
        shown = [best, *abreast] if ambiguous else [r for r in trial.rivals()]
        out = []
        for r in shown:
            score = trial.of(r).score
            why = "explains less of the held-out records"
            if r in abreast or ambiguous:
                why = "cannot be told apart on these data"
            elif score > refit.score:
                why = "errs more on the held-out records than the old model does"
            out.append(
                Contender(
                    tuple(h.effect for h in r.hypotheses),
                    tuple(h.where for h in r.hypotheses),
                    (score - trial.quiet) / max(refit.score - trial.quiet, 1e-12),
                    r.likelihood - best.likelihood,
                    why,
                    tuple(values_of(e) for e in r.elements),
                    tuple(h.choices for h in r.hypotheses),
                )
            )
        return out

    def remainder(self, trial: Trial, floor: np.ndarray, rows: Mapping[str, np.ndarray]) -> Remainder | None:
        """The error beside what was named; None where it is no more than rigs of known make leave."""
        found, richest = trial.foremost, trial.richest
        beyond = rows["after"] ** 2 - rows["noise_floor"] ** 2
        j = int(np.argmax(beyond))
        if beyond[j] < self.criteria.misses**2:
            return None
        channel = self.problem.channels[j]
        place = next(x for x in places(self.problem, found.fit, floor) if x.channel == channel)
        left = Remainder(channel, float(rows["after"][j]), float(rows["noise_floor"][j]), place.when)
        if not set(found.hypotheses) < set(richest.hypotheses):
            return left
        more, then = [h for h in richest.hypotheses if h not in found.hypotheses], trial.of(richest).reported
        if not then[j] < rows["after"][j]:
            return left
        effects, where = tuple(h.effect for h in more), tuple(h.where for h in more)
        return replace(left, effects=effects, where=where, error=float(then[j]))

    def report(
        self,
        trial: Trial,
        measured: Measured,
        decision: Decision,
        notes: list[str],
        begun: float,
        over: Stretches | None = None,
    ) -> Diagnosis:
        p, base = self.problem, trial.base
        evidence, quantities, abreast = measured.evidence, measured.quantities, measured.indistinguishable
        drawn = self.drawn(base) if decision.verdict == "unknown_effect" else Followed()
        decision, findings = self.found(trial, measured, decision, drawn)
        verdict = decision.verdict
        named, ambiguous = verdict == "missing_effect", verdict == "ambiguous"
        if ambiguous:  # a law is at hand
            drawn = Followed()
        final = trial.foremost if named or decision.reason == "kind_certain" else base
        tabulated, final = drawn.tabulated, drawn.candidate or final
        sure = confidence(evidence, self.criteria)
        found = self.effects(trial.foremost, quantities, sure) if named else []
        small = self.effects(trial.foremost, quantities, sure) if decision.small else []
        _, before = self.search.judge.owner()
        rows = {
            "before": before,
            "refit": trial.of(base).reported,
            "after": trial.of(final).reported,
            "noise_floor": np.minimum(
                trial.floor * self.search.judge.spread / self.search.judge.spread_reported,
                trial.of(final).reported,
            ),
        }
        gap = {k: self.by_channel(row) for k, row in rows.items()}
        floor = trial.floor * self.search.judge.spread
        where = places(p, base.fit, floor) if verdict not in ("no_discrepancy",) else ()
        if not named:
            quantities = intervals(self.search, base)
        laws = [law(p, final.fit, e.element, e.parameters) for e in found]
        laws += [table_law(p, final.fit, tabulated)] if tabulated else []
        contenders = [trial.foremost, *abreast]
        test = None
        if ambiguous:
            self.say("designing the test that would decide")
            test = next_experiment(self.whole, contenders, floor)
        said = Diagnosis(
            verdict=verdict,
            summary="",
            tabulated=tabulated,
            best_table=drawn.best,
            best_candidate=self.rejected(trial, evidence, decision, rows),
            reason=decision.reason,
            remainder=self.remainder(trial, floor, rows) if named else None,
            stretches=over,
            effects=tuple(found),
            small_effects=tuple(small),
            contenders=tuple(self.contenders(trial, abreast, ambiguous)),
            where=where,
            parameters={path: q for path, q in quantities.items() if path in self.network.parameters},
            gap=gap,
            closed=None if final is base else closed(rows),
            gates=decision.gates,
            next_experiment=test.to_dict() if test else None,
            test=played(self.network, test.record) if test else None,
            base=self.network,
            refitted=base.fit.network,
            model=final.fit.network,
            traces=self.traces(base, final),
            laws=tuple(x for x in laws if x is not None),
            notes=tuple(notes),
            seconds=clock.perf_counter() - begun,
            units={c.name: c.unit for c in self.network.outputs},
            evidence=evidence,
            criteria=self.criteria,
            settings=self.settings,
            findings=findings,
        )
        return replace(said, summary=summary_of(said.to_dict()))


def closed(rows: Mapping[str, np.ndarray]) -> float | None:
    """Share of the reducible gap that is closed: (refit - after) / (refit - noise), of the squares, over all channels."""
    top = float(np.sum(rows["refit"] ** 2 - rows["after"] ** 2))
    bottom = float(np.sum(np.maximum(rows["refit"] ** 2 - rows["noise_floor"] ** 2, 0.0)))
    return min(1.0, top / bottom) if bottom > 0 and math.isfinite(top) else None
