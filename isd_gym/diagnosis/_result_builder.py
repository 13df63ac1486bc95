"""The result of a diagnosis, put together from a search, its evidence and the decision."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from ._estimation.gauss_newton import Fitter
from ._estimation.noise import white_weights
from ._estimation.structure import (
    base_structure,
    owner_pair,
    parameter_values,
    with_sensor_offsets,
)
from ._planning.design import next_experiment
from ._selection.answer import beyond_noise, removed_share
from ._selection.uncertainty import intervals, with_posterior
from ._simulation.problem import BROKEN
from ._simulation.time_limit import RESULT, TimeUp
from ._verdict.explanation import locate_errors
from ._verdict.findings import Finder, weighted_sets
from ._verdict.wording import summary_of
from .result import (
    BestCandidate,
    Diagnosis,
    Effect,
    LawSet,
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
    from ._estimation.gauss_newton import Fit
    from ._estimation.structure import Structure
    from ._records.feedback import Feedback
    from ._selection.answer import Answer
    from ._selection.held_out_table import Row
    from ._selection.law_sets import Search
    from ._selection.uncertainty import Quantity
    from ._simulation.problem import Problem
    from ._verdict.evidence import Measurements
    from ._verdict.explanation import Place
    from ._verdict.findings import Finding
    from ._verdict.gates import Decision


T = TypeVar("T")
#: largest number of sets of laws that the result lists
MOST_SETS = 5


@dataclass(frozen=True, eq=False)
class ResultBuilder:
    """Builds the result of a diagnosis."""

    search: Search
    answer: Answer
    measured: Measurements
    decision: Decision
    #: the whole records
    whole: Problem
    #: time from which each whole record takes no part in fitting [s]
    held_from: Sequence[float]
    #: inputs that follow from outputs
    feedback: tuple[Feedback, ...]
    #: notes in words, also on parts of the result that could not be made
    notes: list[str]

    def build(self, over: Stretches | None = None) -> Diagnosis:
        """Build the result; `over` describes the segments over which records were compared, None for whole records."""
        search, measured, decision = self.search, self.measured, self.decision
        problem, network = search.problem, search.problem.network
        verdict, refit = decision.verdict, self.answer.refit
        final = self.answer.foremost
        is_named = verdict == "missing_effect"
        findings = self._attempt("the probabilities", self._findings) or ()
        completes = verdict == "unknown_effect" and self._is_supported()
        if not completes and verdict not in ("missing_effect", "ambiguous"):
            final = refit
        quantities = posterior = measured.quantities
        if not is_named:
            found = self._attempt(
                "the intervals", intervals, search.evaluator, refit.fit
            )
            quantities = found or {}
        if final is refit:
            posterior = quantities
        effects = self._effects(findings) if is_named else ()
        rows = self._errors(final)
        noise = measured.noise * search.evaluator.validation_deviation
        test, inputs = None, None
        if verdict == "ambiguous":
            test, inputs = self._next_test(noise)
        where: tuple[Place, ...] = ()
        if verdict != "no_discrepancy":
            where = locate_errors(problem, refit.fit, noise)
        fitted = with_sensor_offsets(final.fit.network, final.fit.structure.offsets)
        own = {path: q for path, q in quantities.items() if path in network.parameters}
        result = Diagnosis(
            verdict=verdict,
            summary="",
            best_candidate=self._rejected(rows, completes),
            reason=decision.reason,
            remainder=self._remainder(rows) if is_named else None,
            stretches=over,
            closed_loop=self.feedback,
            effects=effects,
            findings=findings,
            sets=self.sets,
            where=where,
            places=self._places(),
            parameters=own,
            gap={stage: self._by_channel(row) for stage, row in rows.items()},
            closed=None if final is refit else closed(rows),
            gates=decision.gates,
            next_experiment=test,
            test=inputs,
            base=network,
            refitted=refit.fit.network,
            model=self._described(with_posterior(fitted, posterior), completes),
            traces=self._traces(final),
            units={c.name: c.unit for c in network.outputs},
            evidence=measured.evidence,
            criteria=search.criteria,
            settings=search.settings,
        )
        result = replace(
            result,
            notes=tuple(dict.fromkeys(self.notes)),
            not_tried=tuple(search.clock.left_out),
        )
        return replace(result, summary=summary_of(result.to_dict()))

    def _is_supported(self) -> bool:
        """Return whether the foremost set completes the model: it removes `Criteria.least_removed` on validation and on test records."""
        best, e = self.answer.foremost, self.measured.evidence
        removed = min(e.explained, e.test_explained)
        is_real = bool(best.members) and best.is_sound
        return is_real and removed >= self.search.criteria.least_removed

    def _described(self, network: Network, completes: bool) -> Network:
        """Return a model with a description of its law as uncertain."""
        if self.decision.verdict == "ambiguous":
            kind = "Likeliest"
        elif completes:
            kind = "Best supported"
        else:
            return network
        law = "; ".join(h.label for h in self.answer.foremost.fit.hypotheses)
        text = f"{network.description} {kind} law, not certain: {law}."
        return replace(network, description=text.strip())

    def _attempt(self, what: str, make: Callable[..., T], *args: Any) -> T | None:
        """Return a part of the result, or None and a note where its simulation breaks down or the time is up."""
        clock = self.search.clock
        try:
            with clock.until(RESULT):
                return make(*args)
        except TimeUp:
            clock.leave_out(what)
        except BROKEN as error:
            self.notes.append(f"{what} could not be made: {error}")
        return None

    def _findings(self) -> tuple[Finding, ...]:
        """Return the findings; none where no effect is missing."""
        answer, verdict = self.answer, self.decision.verdict
        is_agreement = verdict in ("no_discrepancy", "parameters_only")
        if is_agreement or not answer.foremost.members:
            return ()
        named = set()
        if verdict == "missing_effect":
            for m, is_certain in zip(
                answer.foremost.members, answer.certain, strict=True
            ):
                if is_certain:
                    named.add(m)
        # a name under feedback is no multiple of the controller's input
        is_doubted = not answer.band or (bool(self.feedback) and not named)
        finder = Finder(
            self.search.criteria,
            weighted_sets(answer),
            self.measured.evidence,
            self.measured.quantities,
            frozenset(named),
            is_doubted,
        )
        out = []
        for f in finder.find():
            kind = (f.kind, tuple(sorted(f.place)))
            rows = zip(self.sets, answer.band, strict=False)
            files = [s.file for s, row in rows if kind in row.kinds]
            out.append(replace(f, sets=tuple(files)))
        return tuple(out)

    @functools.cached_property
    def sets(self) -> tuple[LawSet, ...]:
        """The sets of the band, the simplest first, at most `MOST_SETS`."""
        answer, out = self.answer, []
        before = max(beyond_noise(answer.refit, answer.noise), 1e-12)
        rows = zip(answer.band[:MOST_SETS], answer.weights, strict=False)
        for k, (row, weight) in enumerate(rows):
            found = LawSet(
                **_effects_of(row.fit),
                options=tuple(h.choices for h in row.fit.hypotheses),
                excess=(beyond_noise(row, answer.noise) / before) ** 2,
                weight=weight,
                error=row.error,
                file=f"set_{k + 1}.json" if k else "model.json",
                model=row.fit.network,
            )
            out.append(found)
        return tuple(out)

    def _errors(self, final: Row) -> dict[str, Array]:
        """Return the NRMSE on the test records by stage, (channels,) each."""
        evaluator = self.search.evaluator
        return {
            "before": evaluator.nominal_nrmse[1],
            "refit": self.answer.refit.test,
            "after": final.test,
            "noise_floor": np.minimum(
                evaluator.test_noise(self.measured.noise), final.test
            ),
        }

    def _by_channel(self, row: Array) -> dict[str, float]:
        return {
            n: float(v) for n, v in zip(self.search.problem.channels, row, strict=True)
        }

    def _places(self) -> tuple[ScreenedPlace, ...]:
        """Return the law that removes most at each place, alone."""
        answer = self.answer
        out: dict[tuple[str, ...], ScreenedPlace] = {}
        for row in sorted(answer.singles, key=lambda row: row.error):
            (member,) = row.members
            share = 1.0 - (row.error / max(answer.refit.error, 1e-300)) ** 2
            if share > 0.0:
                out.setdefault(
                    member.place, ScreenedPlace(member.place, member.effect, share)
                )
        return tuple(out.values())

    def _effects(self, findings: Sequence[Finding]) -> tuple[Effect, ...]:
        """Return the certain effects of the foremost set."""
        row, network, out = self.answer.foremost, self.search.problem.network, []
        chances = {}
        for f in findings:
            for law in f.laws:
                chances[f.kind, f.place, law.effect] = law.probability
        rows = zip(
            row.fit.hypotheses,
            row.fit.structure.names,
            row.members,
            self.answer.certain,
            strict=True,
        )
        for h, element, member, is_certain in rows:
            if not is_certain:
                continue
            found = Effect(
                effect=h.effect,
                between=owner_pair(network, h),
                channel=h.where[0] if h.place == "channel" else None,
                confidence=chances.get((*member.kind, h.effect), math.nan),
                parameters=_of_owner(element, self.measured.quantities),
                element=element,
                behind=h.behind,
                totals=_of_owner(element, self.measured.sums),
            )
            out.append(found)
        return tuple(out)

    def _next_test(self, noise: Array) -> tuple[dict[str, Any] | None, Table | None]:
        """Return the test that would decide between sets, and its inputs."""
        self.search.say("designing the test that would decide")
        fits = [r.fit for r in self.answer.band]
        found = self._attempt("the next test", next_experiment, self.whole, fits, noise)
        if found is None:
            return None, None
        network = self.whole.network
        return found.to_dict(network), found.table(network)

    def _rejected(
        self, rows: Mapping[str, Array], completes: bool
    ) -> BestCandidate | None:
        """Return the foremost set if it is not named."""
        best, decision = self.answer.foremost, self.decision
        if decision.verdict == "missing_effect" or not best.members:
            return None
        stages = {k: rows[k] for k in ("before", "refit")} | {"after": best.test}
        return BestCandidate(
            **_effects_of(best.fit),
            explained=self.measured.evidence.explained,
            error={k: self._by_channel(row) for k, row in stages.items()},
            failed_gates=tuple(g for g in decision.gates if not g.passed),
            completes=completes,
        )

    def _remainder(self, rows: Mapping[str, Array]) -> Remainder | None:
        """Return the error beside the named effects; None where it is small."""
        beyond = rows["after"] ** 2 - rows["noise_floor"] ** 2
        j = int(np.argmax(beyond))
        if beyond[j] < self.search.criteria.wide_gap**2:
            return None
        channel = self.search.problem.channels[j]
        return Remainder(
            channel, float(rows["after"][j]), float(rows["noise_floor"][j])
        )

    def _traces(self, final: Row) -> tuple[Trace, ...]:
        """Return every whole record with the outputs of the three models; initial states and offsets are those of the record."""
        whole, out = self.whole, []
        nominal = base_structure(whole.network)
        models = [(nominal, nominal.start)]
        models += [(row.fit.structure, row.fit.x) for row in (self.answer.refit, final)]
        for i, record in enumerate(whole.records):
            outputs = [record.measured, *(self._trace(i, *model) for model in models)]
            measured, before, refit, after = (
                dict(zip(whole.channels, y.T, strict=True)) for y in outputs
            )
            since = self.held_from[i]
            trace = Trace(
                name=record.name,
                held_out=since == -math.inf,
                time=record.time,
                inputs={k: record.seen(v) for k, v in record.inputs.items()},
                measured=measured,
                before=before,
                refit=refit,
                after=after,
                held_from=since if math.isfinite(since) else None,
            )
            out.append(trace)
        return tuple(out)

    def _trace(self, index: int, structure: Structure, x: Array) -> Array:
        """Return the outputs (samples, channels) of a model over a whole record; NaN where the simulation breaks down."""
        record = self.whole.records[index]
        fitter = Fitter(self.whole, white_weights(self.search.least_noise))
        try:
            return fitter.follow(structure, x, [index], iterations=3).outputs[index]
        except BROKEN:
            pass
        self.notes.append(
            f"a model does not simulate the whole record {record.name}: no curve is drawn there"
        )
        return np.full_like(record.measured, np.nan)


def _of_owner(owner: str, quantities: Mapping[str, Quantity]) -> dict[str, Quantity]:
    """Return the quantities of an element by the names of its parameters."""
    start = f"{owner}."
    return {
        k.removeprefix(start): q for k, q in quantities.items() if k.startswith(start)
    }


def _effects_of(fit: Fit) -> dict[str, Any]:
    """Return types, places and values of the effects of a fit."""
    return {
        "effects": tuple(h.effect for h in fit.hypotheses),
        "where": tuple(h.where for h in fit.hypotheses),
        "values": tuple(parameter_values(e) for e in fit.elements),
    }


def closed(rows: Mapping[str, Array]) -> float | None:
    """Return the closed share of the gap: (refit - after) / (refit - noise), of the squares, over all channels.

    None where the refitted model errs more than a constant: any model that errs less would close most of the gap.
    """
    refit, noise = rows["refit"], rows["noise_floor"]
    share = removed_share(refit, rows["after"], noise)
    is_worse_than_constant = not np.mean(refit**2) < 1.0
    is_noise = not np.any(refit > noise)
    if is_noise or not math.isfinite(share) or (share > 0 and is_worse_than_constant):
        return None
    return min(1.0, share)
