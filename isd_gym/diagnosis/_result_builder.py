"""The result of a diagnosis, put together from a search, its evidence and the decision."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from ._estimation.gauss_newton import Fitter
from ._estimation.noise import white_weights
from ._estimation.structure import base_structure, owner_pair, with_sensor_offsets
from ._hypotheses.library import hypotheses
from ._hypotheses.motion import loads_of, tell_gain
from ._planning.design import next_experiment, played
from ._selection.candidate import Candidate, parameter_values
from ._selection.free_force import FreeForce, fit_free_force
from ._selection.uncertainty import intervals, with_posterior
from ._selection.weights import weigh_candidates
from ._simulation.problem import BROKEN
from ._simulation.time_limit import RESULT, TimeUp
from ._verdict.explanation import draw_law, draw_table, locate_errors
from ._verdict.findings import find
from ._verdict.gates import Decision, confidence, table_gates
from ._verdict.wording import summary_of
from .result import (
    BestCandidate,
    Contender,
    Diagnosis,
    Effect,
    LawSet,
    Quantity,
    Remainder,
    ScreenedPlace,
    Stretches,
    Trace,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from .._common.arrays import Array
    from ..physics.network import Network
    from ..records.data import Table
    from ._estimation.structure import Structure
    from ._selection.candidate_comparison import CandidateComparison
    from ._selection.law_sets import Search
    from ._verdict.findings import Finding
    from ._verdict.measurement import Measurements
    from ._workflow import Workflow
    from .result import Law, Tabulated


T = TypeVar("T")
#: largest number of sets of laws with a completed model
MOST_SETS = 5


@dataclass(frozen=True, eq=False)
class ResultBuilder:
    """Builds the result of a diagnosis."""

    search: Search
    scores: CandidateComparison
    measured: Measurements
    flow: Workflow
    #: parts of the result that could not be made
    lost: list[str] = field(default_factory=list)

    def build(self, decision: Decision, over: Stretches | None = None) -> Diagnosis:
        """Build the result; `over` describes the segments over which records were compared, None for whole records."""
        search, scores, measured = self.search, self.scores, self.measured
        p, network, criteria = search.problem, search.problem.network, search.criteria
        refitted, quantities, rivals = scores.refitted, measured.quantities, self.scores.indistinguishable()
        # under feedback a free curve would draw the controller's law
        is_free = decision.verdict == "unknown_effect" and not self.flow.feedback
        what = "a table of the missing force"
        free = (self._attempt(what, self._free_force) if is_free else None) or FreeForce()
        found = self._attempt("the probabilities", self._findings, decision, free)
        decision, findings = found or (decision, ())
        is_named, is_ambiguous = decision.verdict == "missing_effect", decision.verdict == "ambiguous"
        if is_ambiguous:  # a law of the library stands for the force
            free = FreeForce()
        completes = decision.verdict == "unknown_effect" and self._is_supported(free)
        if completes:
            free = FreeForce(free.best)
        # the likeliest law of several that the records do not tell apart, or the best supported one
        final = scores.foremost if is_named or is_ambiguous or completes else refitted
        tabulated, final = free.tabulated, free.candidate or final
        is_sum = any(h.kind.is_sum() for h in scores.foremost.hypotheses)
        probability = confidence(measured.evidence, criteria, is_sum=is_sum)
        effects = self._effects(quantities, probability) if is_named else []
        rows = self._errors(final)
        deviation = search.evaluator.validation_deviation
        noise = scores.noise * deviation
        posterior = quantities if final is scores.foremost else {}
        if not is_named:
            quantities = self._attempt("the intervals", intervals, search.evaluator, refitted) or {}
        posterior = quantities if final is refitted else posterior
        laws = self._laws(final, effects, tabulated)
        test, played = self._next_test([scores.foremost, *rivals], noise) if is_ambiguous else (None, None)
        result = Diagnosis(
            verdict=decision.verdict,
            summary="",
            tabulated=tabulated,
            best_table=free.best,
            best_candidate=self._rejected(decision, rows, completes),
            reason=decision.reason,
            remainder=self._remainder(noise, rows) if is_named else None,
            stretches=over,
            closed_loop=self.flow.feedback,
            effects=tuple(effects),
            small_effects=tuple(self._effects(measured.quantities, probability) if decision.small else []),
            contenders=tuple(self._contenders(rivals, is_ambiguous and decision.reason != "kind_certain")),
            findings=findings,
            sets=tuple(s for s, _ in self.sets),
            where=() if decision.verdict == "no_discrepancy" else locate_errors(p, refitted.fit, noise),
            places=self._places(),
            parameters={path: q for path, q in quantities.items() if path in network.parameters},
            gap={stage: self._by_channel(row) for stage, row in rows.items()},
            closed=None if final is refitted else closed(rows),
            gates=decision.gates,
            next_experiment=test,
            test=played,
            base=network,
            refitted=refitted.fit.network,
            model=self._described(
                with_posterior(
                    with_sensor_offsets(final.fit.network, final.fit.structure.offsets), posterior
                ),
                decision,
                completes,
            ),
            traces=self._traces(final),
            laws=laws,
            notes=tuple(dict.fromkeys((*self.flow.notes, *self._tried(), *self.lost))),
            units={c.name: c.unit for c in network.outputs},
            evidence=measured.evidence,
            criteria=criteria,
            settings=search.settings,
        )
        result = replace(result, not_tried=tuple(search.clock.left_out))
        return replace(result, summary=summary_of(result.to_dict()))

    def _is_supported(self, free: FreeForce) -> bool:
        """Return whether the foremost candidate completes the model: it errs less than the refitted model, on test records by a material
        amount, and less than the table of a free force on validation records."""
        scores, best = self.scores, self.scores.foremost
        if not best.hypotheses or not best.well_formed():
            return False
        refit, after = scores.score(scores.refitted), scores.score(best)
        if not after.mean_square < refit.mean_square:
            return False
        rows = self._errors(best)
        less = np.sum(rows["refit"] ** 2 - rows["after"] ** 2)
        moved = np.max(rows["refit"] ** 2 - rows["after"] ** 2)
        if not (less > 0.0 and moved >= self.search.criteria.material**2):
            return False
        return free.candidate is None or after.mean_square < scores.score(free.candidate).mean_square

    def _described(self, network: Network, decision: Decision, completes: bool) -> Network:
        """Return a model with a description of its law as uncertain."""
        if decision.verdict != "ambiguous" and not completes:
            return network
        law = "; ".join(h.label for h in self.scores.foremost.hypotheses)
        text = f"{'Best supported' if completes else 'Likeliest'} law, not certain: {law}."
        return replace(network, description=f"{network.description} {text}".strip())

    def _attempt(self, what: str, make: Callable[..., T], *args: Any) -> T | None:
        """Return a part of the result, or None and a note where its simulation breaks down or the time is up."""
        clock = self.search.clock
        try:
            with clock.until(RESULT):
                return make(*args)
        except TimeUp:
            clock.leave_out(what)
        except BROKEN as error:
            self.lost.append(f"{what} could not be made: {error}")
        return None

    # -- decision -----------------------------------------------------------------------------------------
    def _free_force(self) -> FreeForce:
        """Fit a table of the missing force."""
        self.flow.say("no known law explains it: following the missing force")
        gates = functools.partial(table_gates, c=self.search.criteria)
        free = fit_free_force(self.search.evaluator, self.scores.refitted, gates)
        return free if free.candidate is None or self.scores.can_score(free.candidate) else FreeForce()

    def _findings(self, decision: Decision, free: FreeForce) -> tuple[Decision, tuple[Finding, ...]]:
        """Return the decision and the findings, with the free force among the candidates where one was fitted."""
        scores, measured = self.scores, self.measured
        if decision.verdict in ("no_discrepancy", "parameters_only") or not scores.foremost.hypotheses:
            return decision, ()
        weighted = weigh_candidates(scores, free.candidate)
        own = (w.statements for w in weighted if w.candidate is scores.foremost)
        findings = find(
            self.search,
            weighted,
            measured.evidence,
            measured.quantities,
            next(own, frozenset()),
            is_named=decision.verdict == "missing_effect",
            # a name under feedback is no multiple of the controller's input
            is_doubted=not scores.answer.band
            or (bool(self.flow.feedback) and decision.verdict != "missing_effect"),
        )
        sets = self.sets
        return decision, tuple(
            replace(f, sets=tuple(s for s, kinds in sets if (f.kind, tuple(sorted(f.place))) in kinds))
            for f in findings
        )

    @functools.cached_property
    def sets(self) -> list[tuple[LawSet, frozenset[tuple[str, tuple[str, ...]]]]]:
        """The sets of the band, the simplest first, at most `MOST_SETS`, each with its kinds and places."""
        answer, out = self.scores.answer, []
        for k, (row, weight) in enumerate(zip(answer.band[:MOST_SETS], answer.weights, strict=False)):
            members = tuple((m.effect, m.place) for m in row.members)
            file = f"set_{k + 1}.json" if k else "model.json"
            out.append((LawSet(members, weight, row.error, file, row.fit.network), row.kinds))
        return out

    # -- parts of the result ------------------------------------------------------------------------------
    def _errors(self, final: Candidate) -> dict[str, Array]:
        """Return the NRMSE on the test records by stage, (channels,) each."""
        scores = self.scores
        after = scores.score(final).test_nrmse
        return {
            "before": self.search.evaluator.nominal_nrmse[1],
            "refit": scores.score(scores.refitted).test_nrmse,
            "after": after,
            "noise_floor": np.minimum(scores.test_noise, after),
        }

    def _by_channel(self, row: Array) -> dict[str, float]:
        return {n: float(v) for n, v in zip(self.search.problem.channels, row, strict=True)}

    def _tried(self) -> list[str]:
        """Return what was tried, in words."""
        p = self.search.problem
        every = list(hypotheses(p.network))
        loads = loads_of(p, self.scores.refitted.fit, every)
        told = {name for name, load in loads.items() if tell_gain(load)}
        every = [h for h in every if not h.kind.loaded or dict(h.options)["load"] in told]
        where = dict.fromkeys("-".join(h.where) for h in every)
        return [
            f"tried {len({h.effect for h in every})} effects at {len(where)} places: {', '.join(where)}",
        ]

    def _places(self) -> tuple[ScreenedPlace, ...]:
        """Return the law that removes most at each place, alone."""
        answer = self.scores.answer
        out: dict[tuple[str, ...], ScreenedPlace] = {}
        for row in sorted(answer.singles, key=lambda row: row.error):
            (member,) = row.members
            share = 1.0 - (row.error / max(answer.refit.error, 1e-300)) ** 2
            if share > 0.0:
                out.setdefault(member.place, ScreenedPlace(member.place, member.effect, share))
        return tuple(out.values())

    def _effects(self, quantities: Mapping[str, Quantity], probability: float) -> list[Effect]:
        """Return the certain effects of the foremost set."""
        best, network, out = self.scores.foremost, self.search.problem.network, []
        certain = self.scores.answer.certain or (True,) * len(best.hypotheses)
        for h, element, named in zip(best.hypotheses, best.fit.structure.names, certain, strict=True):
            if not named:
                continue
            parts = [(*path.rpartition("."), q) for path, q in quantities.items()]
            own = {key: q for owner, _, key, q in parts if owner == element}
            sums = {key: self.measured.sums.get(f"{element}.{key}") for key in own}
            totals = {key: q for key, q in sums.items() if q is not None}
            channel = h.where[0] if h.place == "channel" else None
            pair = owner_pair(network, h)
            out.append(Effect(h.effect, pair, channel, probability, own, element, h.behind, totals))
        return out

    def _laws(
        self, final: Candidate, effects: Sequence[Effect], tabulated: Tabulated | None
    ) -> tuple[Law, ...]:
        """Return the laws of the found effects and of the table of a free force, each as a curve."""
        p, what = self.search.problem, "the picture of a law"
        laws = [self._attempt(what, draw_law, p, final.fit, e.element, e.parameters) for e in effects]
        if tabulated:
            laws.append(self._attempt(what, draw_table, p, final.fit, tabulated))
        return tuple(law for law in laws if law is not None)

    def _next_test(
        self, candidates: Sequence[Candidate], noise: Array
    ) -> tuple[dict[str, Any] | None, Table | None]:
        """Return the test that would decide between candidates, and its inputs."""
        self.flow.say("designing the test that would decide")

        def design() -> tuple[dict[str, Any], Table] | None:
            found = next_experiment(self.flow.whole, candidates, noise)
            if found is None:
                return None
            return found.to_dict(), played(self.flow.whole.network, found.record)

        return self._attempt("the next test", design) or (None, None)

    def _rejected(
        self, decision: Decision, rows: Mapping[str, Array], completes: bool
    ) -> BestCandidate | None:
        """Return the foremost candidate if it is not named."""
        best = self.scores.foremost
        if decision.verdict == "missing_effect" or not best.hypotheses:
            return None
        stages = {k: rows[k] for k in ("before", "refit")} | {"after": self.scores.score(best).test_nrmse}
        return BestCandidate(
            **_effects_of(best),
            explained=self.measured.evidence.explained,
            error={k: self._by_channel(row) for k, row in stages.items()},
            failed_gates=tuple(g for g in decision.gates if not g.passed),
            completes=completes,
        )

    def _contenders(self, rivals: Sequence[Candidate], is_tied: bool) -> list[Contender]:
        """Return the other candidates, and why they are not named; where several are tied, the foremost candidate too."""
        scores = self.scores
        refit, best = scores.score(scores.refitted), scores.foremost
        out = []
        for r in [best, *rivals] if is_tied else scores.rivals():
            loss = scores.score(r).mean_square
            why = "explains less of the held-out records"
            if r in rivals or is_tied:
                why = "cannot be told apart on these data"
            elif loss > refit.mean_square:
                why = "errs more on the held-out records than the old model does"
            excess = (loss - scores.noise_score) / max(refit.mean_square - scores.noise_score, 1e-12)
            options = tuple(h.choices for h in r.hypotheses)
            likelihood = r.deviance - best.deviance
            out.append(
                Contender(**_effects_of(r), score=excess, likelihood=likelihood, why_not=why, options=options)
            )
        return out

    def _remainder(self, noise: Array, rows: Mapping[str, Array]) -> Remainder | None:
        """Return the error beside the named effects; None where it is small."""
        scores, p = self.scores, self.search.problem
        found, richest = scores.foremost, scores.richest
        beyond = rows["after"] ** 2 - rows["noise_floor"] ** 2
        j = int(np.argmax(beyond))
        if beyond[j] < self.search.criteria.wide_gap**2:
            return None
        channel = p.channels[j]
        place = next(x for x in locate_errors(p, found.fit, noise) if x.channel == channel)
        left = Remainder(channel, float(rows["after"][j]), float(rows["noise_floor"][j]), place.when)
        if not set(found.hypotheses) < set(richest.hypotheses):
            return left
        more = [h for h in richest.hypotheses if h not in found.hypotheses]
        then = scores.score(richest).test_nrmse
        if not then[j] < rows["after"][j]:
            return left
        effects, where = tuple(h.effect for h in more), tuple(h.where for h in more)
        return replace(left, effects=effects, where=where, error=float(then[j]))

    def _traces(self, final: Candidate) -> tuple[Trace, ...]:
        """Return every whole record with the outputs of the three models; initial states and offsets are those of the record."""
        whole, refitted, evaluator, out = self.flow.whole, self.scores.refitted, self.search.evaluator, []
        nominal = base_structure(whole.network)
        models = [
            (nominal, nominal.start, {}),
            *(
                (c.fit.structure, c.fit.x, evaluator.first_states(c.fit, self.scores.score(c).fit))
                for c in (refitted, final)
            ),
        ]
        for i, record in enumerate(whole.records):
            before, refit, after = (
                dict(zip(whole.channels, self._trace(*model, i).T, strict=True)) for model in models
            )
            measured = {c: record.measured[:, j] for j, c in enumerate(whole.channels)}
            inputs = {k: record.seen(v) for k, v in record.inputs.items()}
            since = self.flow.held_from[i]
            cut = since if math.isfinite(since) else None
            held_out = since == -math.inf
            out.append(Trace(record.name, held_out, record.time, inputs, measured, before, refit, after, cut))
        return tuple(out)

    def _trace(self, structure: Structure, x: Array, initial: Mapping[int, Array], index: int) -> Array:
        """Return the outputs (samples, channels) of a model over a whole record; NaN where the simulation breaks down."""
        fitter = Fitter(self.flow.whole, white_weights(self.search.least_noise))
        for begun in ({}, {k: v for k, v in initial.items() if k == index}):
            try:
                fit = fitter.fit(structure, x, begun, records=[index], frozen=True, iterations=3)
            except BROKEN:
                continue
            return fit.outputs[index]
        name = self.flow.whole.records[index].name
        self.lost.append(f"a model does not simulate the whole record {name}: no curve is drawn there")
        return np.full_like(self.flow.whole.records[index].measured, np.nan)


def _effects_of(candidate: Candidate) -> dict[str, Any]:
    """Return types, places and values of the effects of a candidate."""
    return {
        "effects": tuple(h.effect for h in candidate.hypotheses),
        "where": tuple(h.where for h in candidate.hypotheses),
        "values": tuple(parameter_values(e) for e in candidate.elements),
    }


def closed(rows: Mapping[str, Array]) -> float | None:
    """Return the closed share of the gap: (refit - after) / (refit - noise), of the squares, over all channels.

    None where the refitted model errs more than a constant: any model that errs less would close most of the gap.
    """
    top = float(np.sum(rows["refit"] ** 2 - rows["after"] ** 2))
    bottom = float(np.sum(np.maximum(rows["refit"] ** 2 - rows["noise_floor"] ** 2, 0.0)))
    is_worse_than_constant = not np.mean(rows["refit"] ** 2) < 1.0
    if not bottom > 0 or not math.isfinite(top) or (top > 0 and is_worse_than_constant):
        return None
    return min(1.0, top / bottom)
