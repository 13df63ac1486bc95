"""Measurements of the foremost set of laws: the evidence that the result states."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from .._hypotheses.motion import motions
from .._selection.contradictions import find_contradiction
from .._selection.uncertainty import (
    covariance,
    differing_part,
    intervals,
    parameters_at_limits,
    relative_uncertainty,
    sums_with_dampers,
)
from .evidence import EffectEvidence, Evidence, as_numbers

if TYPE_CHECKING:
    from ..._common.arrays import Array
    from .._selection.candidate_comparison import CandidateComparison
    from .._selection.law_sets import Search
    from ..result import Quantity


@dataclass(frozen=True, eq=False)
class Measurements:
    """Measurements of the foremost set of a search."""

    evidence: Evidence
    #: parameters with intervals, by path
    quantities: dict[str, Quantity]
    #: damping of added laws together with the dampers beside them, with intervals, by path
    sums: dict[str, Quantity] = field(default_factory=dict)


def collect_evidence(search: Search, scores: CandidateComparison) -> Measurements:
    """Measure the foremost set."""
    evaluator = search.evaluator
    refitted, best = scores.refitted, scores.foremost
    refit, after, richest = scores.score(refitted), scores.score(best), scores.score(scores.richest)
    envelope = scores.unmodelled_envelope(refitted)
    matrix = covariance(evaluator, best)
    quantities = intervals(evaluator, best, matrix)
    common: dict[str, Any] = {
        "channels": tuple(search.problem.channels),
        "before": as_numbers(evaluator.nominal_nrmse[0]),
        "refit": as_numbers(refit.nrmse),
        "noise": as_numbers(scores.noise),
        "noise_known": tuple(f.known for f in evaluator.noise_estimates),
        "envelope": as_numbers(envelope),
        "limits": parameters_at_limits(best),
        "refit_limits": parameters_at_limits(refitted),
    }
    if not best.hypotheses:
        return Measurements(Evidence(after=as_numbers(refit.nrmse), **common), quantities)
    envelope_after = scores.unmodelled_envelope(best)
    comparison = after.compare_with(refit)
    evidence = Evidence(
        after=as_numbers(after.nrmse),
        effects=_effects(search, scores, quantities, matrix),
        elpd_diff=comparison.elpd_diff,
        elpd_dse=comparison.dse,
        explained=scores.explained(best),
        envelope_after=as_numbers(envelope_after),
        training_explained=scores.explained_on_training(refitted, best),
        probability=scores.answer.probability,
        test_explained=scores.explained_on_test(best),
        test_gap=max(
            float(np.max(s.test_excess(scores.test_noise) / w))
            for s, w in ((refit, envelope), (after, envelope_after))
        ),
        indistinguishable=tuple(r.label for r in scores.indistinguishable()),
        training_refit=as_numbers(evaluator.training_nrmse(refitted)),
        training_after=as_numbers(evaluator.training_nrmse(best)),
        richest=as_numbers(richest.nrmse),
        richest_share=max(evaluator.effect_sizes(scores.richest), default=1.0),
        nominal_removed=_removed_of_nominal(evaluator.nominal_nrmse, (after.nrmse, after.test_nrmse)),
        largest_left=float(max(after.excess(scores.noise).max(), after.test_excess(scores.test_noise).max())),
        **common,
    )
    sums: dict[str, Quantity] = {}
    for element in best.elements:
        if matrix is not None and element.place == "between":
            sums |= sums_with_dampers(best.fit.network, best.fit.structure, best.fit.x, element, matrix)
    return Measurements(evidence, quantities, sums)


def _removed_of_nominal(nominal: tuple[Array, Array], after: tuple[Array, Array]) -> float:
    """Return the share of the nominal model's squared error that is removed on validation or on test records, the larger; 1 where that
    model breaks down."""
    shares = [
        1.0 - float(np.sum(a**2) / max(np.sum(b**2), 1e-12)) for b, a in zip(nominal, after, strict=True)
    ]
    return 1.0 if np.isnan(shares).any() else max(shares)


def _effects(
    search: Search, scores: CandidateComparison, quantities: dict[str, Quantity], matrix: Array | None
) -> tuple[EffectEvidence, ...]:
    """Return the evidence for each effect of the foremost set."""
    problem, best = search.problem, scores.foremost
    out = []
    sizes = search.evaluator.effect_sizes(best)
    for h, e, size in zip(best.hypotheses, best.elements, sizes, strict=True):
        difference = differing_part(problem.network, best.fit.structure, best.fit.x, e, matrix)
        motion = motions(problem, best.fit).get(e.between) if e.place == "between" else None
        out.append(
            EffectEvidence(
                label=h.label,
                share=size,
                spread=relative_uncertainty(e, quantities, difference),
                contradiction=find_contradiction(problem, best.fit, e, search.criteria),
                sensor=h.place == "channel",
                fault=e.fault(problem.time),
                support=1.0 if motion is None else e.support(motion),
            )
        )
    return tuple(out)
