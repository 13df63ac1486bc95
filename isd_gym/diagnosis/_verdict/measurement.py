"""Measurements of the foremost candidate: the evidence from which the verdict follows."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from ..._common.errors import InputError
from ...physics import elements as el
from .._estimation.structure import owner_pair
from .._hypotheses.forces import element_forces, place_forces
from .._hypotheses.motion import motions
from .._selection.admissibility import repeats
from .._selection.candidate import Candidate, same_effects, simpler_structures
from .._selection.candidate_comparison import excess_loss
from .._selection.criteria import CRITERIA
from .._selection.free_force import fit_in_place_of
from .._selection.screening import BENDS
from .._selection.uncertainty import (
    covariance,
    differing_part,
    intervals,
    parameters_at_limits,
    relative_uncertainty,
    sums_with_dampers,
)
from .._selection.weights import WeightedCandidate, weigh_candidates
from .._simulation.problem import BROKEN
from .evidence import EffectEvidence, Evidence, as_numbers

if TYPE_CHECKING:
    from collections.abc import Iterator

    from ..._common.arrays import Array
    from .._estimation.gauss_newton import Fit
    from .._selection.candidate_comparison import CandidateComparison
    from .._selection.criteria import Criteria
    from .._selection.forward_backward import Search
    from .._selection.held_out import HeldOutScore
    from .._simulation.problem import Problem
    from ..result import Quantity


#: multiple of the motion beyond which a length or a rate of a law is beyond the records: at 20 times the motion a law and its limit differ by 5 %
FURTHEST = 20.0
#: multiple of the typical force from which on a law is balanced by another law: forces in parallel that cancel to a tenth
LARGEST = 10.0


@dataclass(frozen=True, eq=False)
class Measurements:
    """Measurements of the foremost candidate of a search."""

    evidence: Evidence
    #: parameters with intervals, by path
    quantities: dict[str, Quantity]
    #: rivals of another kind that the foremost candidate is not distinguished from
    indistinguishable: list[Candidate]
    #: candidates with weights, largest weight first
    weighted: tuple[WeightedCandidate, ...]
    #: damping of added laws together with the dampers beside them, with intervals, by path
    sums: dict[str, Quantity] = field(default_factory=dict)


def collect_evidence(search: Search, scores: CandidateComparison, seed: int = 0) -> Measurements:
    """Measure the foremost candidate."""
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
        return Measurements(Evidence(after=as_numbers(refit.nrmse), **common), quantities, [], ())
    weighted = weigh_candidates(scores, seed=seed)
    stated = next(w.statements for w in weighted if w.candidate is best)
    rivals = scores.rivals()
    indistinguishable = scores.indistinguishable()
    others = [r for r in rivals if not scores.states_the_same(r, best)]
    forces = [r for r in rivals if all(h.place != "channel" for h in r.hypotheses)] + [refitted]
    own = excess_loss(after, scores.noise_score)

    def loss_ratio(candidates: list[Candidate]) -> float:
        """Return the smallest excess loss of candidates over that of the foremost one."""
        losses = (scores.score(r).mean_square - scores.noise_score for r in candidates)
        return min(losses, default=math.inf) / own

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
        probability=sum(w.weight for w in weighted if w.statements >= stated),
        lack_of_fit=lack_of_fit(search, scores),
        test_explained=scores.explained_on_test(best),
        test_gap=max(
            float(np.max(s.test_excess(scores.test_noise) / w))
            for s, w in ((refit, envelope), (after, envelope_after))
        ),
        rival_loss=loss_ratio(others),
        indistinguishable=tuple(r.label for r in indistinguishable),
        force_loss=loss_ratio(forces),
        training_refit=as_numbers(evaluator.training_nrmse(refitted)),
        training_after=as_numbers(evaluator.training_nrmse(best)),
        richest=as_numbers(richest.nrmse),
        richest_share=max(evaluator.effect_sizes(scores.richest), default=1.0),
        nominal_removed=_removed_of_nominal(evaluator.nominal_nrmse, (after.nrmse, after.test_nrmse)),
        largest_left=float(max(after.excess(scores.noise).max(), after.test_excess(scores.test_noise).max())),
        imitated=is_imitated(search, scores),
        **common,
    )
    sums: dict[str, Quantity] = {}
    for element in best.elements:
        if matrix is not None and element.place == "between":
            sums |= sums_with_dampers(best.fit.network, best.fit.structure, best.fit.x, element, matrix)
    return Measurements(evidence, quantities, indistinguishable, weighted, sums)


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
    """Return the evidence for each effect of the foremost candidate."""
    problem, best = search.problem, scores.foremost
    out = []
    sizes = search.evaluator.effect_sizes(best)
    for k, (h, e, size) in enumerate(zip(best.hypotheses, best.elements, sizes, strict=True)):
        difference = differing_part(problem.network, best.fit.structure, best.fit.x, e, matrix)
        removed, width, is_beyond = _removed_by(search, scores, k)
        motion = motions(problem, best.fit).get(e.between) if e.place == "between" else None
        out.append(
            EffectEvidence(
                label=h.label,
                share=size,
                spread=relative_uncertainty(e, quantities, difference),
                contradiction=find_contradiction(problem, best.fit, e, search.criteria),
                sensor=h.place == "channel",
                fault=e.fault(problem.time),
                removed=removed,
                width=width,
                beyond_small=is_beyond,
                support=1.0 if motion is None else e.support(motion),
            )
        )
    return tuple(out)


def _removed_by(search: Search, scores: CandidateComparison, effect: int) -> tuple[float, float, bool]:
    """Return what one effect of the foremost candidate removes of the error without it (`CandidateComparison.removed`)."""
    best = scores.foremost
    others = [h for k, h in enumerate(best.hypotheses) if k != effect]
    without = next(
        (r for r in scores.candidates() if list(r.hypotheses) == others and scores.can_score(r)), None
    )
    if without is None:
        simpler = simpler_structures(search.problem, best)
        structure = next((s for _, s in simpler if list(s.hypotheses) == others), None)
        without = search.refit(structure, best) if structure is not None else None
    if without is None or not scores.can_score(without):
        return 0.0, 0.0, False
    return scores.removed(best, without)


def is_imitated(search: Search, scores: CandidateComparison) -> bool:
    """Return whether a candidate with a special case of a law of the foremost candidate leaves no more than unmodelled effects, a fault of
    a sensor explains as much, or another law explains nearly all of the rest."""
    best, c = scores.foremost, search.criteria
    if any(scores.blames_needlessly(r, best) for r in scores.rivals()):
        return True
    others = [r for r in scores.candidates() if len(r.hypotheses) == len(best.hypotheses) and r is not best]
    for r in filter(scores.can_score, others):
        score, is_special = scores.score(r), len(r.fit.x) < len(best.fit.x)
        is_special = is_special and same_effects(r.hypotheses, best.hypotheses)
        if is_special and np.all(score.excess(scores.noise) <= scores.unmodelled_envelope(r)):
            return True
        closes = scores.explained_fraction(scores.score(best), score) >= c.alone_removes
        if closes and scores.predicts_better(r, best):
            return True
    return False


# ------------------------------------------------------------------------------------------------- values of a law


def find_contradiction(problem: Problem, fit: Fit, element: el.Element, c: Criteria = CRITERIA) -> str:
    """Return how the values of a law contradict its name on these records; empty where they do not."""
    if not element.well_formed():
        return "its values contradict its name"
    if element.place != "between" or element.series:
        return ""
    motion = motions(problem, fit).get(element.between)
    if motion is None:
        return ""
    if not repeats(element, motion, c):
        return "the travel covers too little of a period for the law to repeat"
    if not element.differs_from_limit(motion):
        return "on this motion the law is the limit of another law"
    scales = {"m": motion.reach, "m/s": float(np.abs(motion.v).max())}
    for f in el.parameter_fields(type(element)):
        scale = scales.get(f.metadata["unit"])
        if scale and not f.metadata["fixed"] and getattr(element, f.name) > FURTHEST * scale:
            return f"its {f.name.replace('_', ' ')} is far beyond the measured motion"
    if element.plane != "time":
        axis = motion.v if element.plane == "rate" else motion.d
        force = element.curve(axis[:: max(1, len(axis) // 500)])
        inertia = problem.network.largest_inertia(*element.where) * el.rms(motion.a)
        typical = place_forces(problem, fit, without=element.name).at(element.where)
        if el.rms(force) > LARGEST * max(typical, inertia):
            return "its force is many times the forces of the records"
    return ""


# ------------------------------------------------------------------------------------------------- lack of fit


def lack_of_fit(search: Search, scores: CandidateComparison) -> float:
    """Return the share of the remaining excess error that a free curve in the place of the foremost effect removes; 0 where unmodelled
    effects make that error.

    The share is 1 for as many effects at one place as a curve has bends (`BENDS`), laws of the model at their limits over the same plane
    included, and where one free curve explains the gap (`Criteria.least_explained`) in place of as many effects at several places.
    """
    c, best = search.criteria, scores.foremost
    if len(best.hypotheses) > 1:
        # an element in series adds a motion, and no bend
        curves = [h for h in best.hypotheses if not h.kind.series]
        places = {frozenset(owner_pair(search.problem.network, h) or h.where) for h in curves}
        if len(places) == 1 and len(curves) >= BENDS:
            return 1.0
        if len(_laws_over_one_plane(search, best)) >= BENDS:
            return 1.0
        if len(best.hypotheses) < BENDS:
            return 0.0
        refit = scores.score(scores.refitted)
        shares = (share for e in best.elements for share in _removed_by_curves(search, scores, refit, e))
        return float(any(share >= c.least_explained for share in shares))
    after = scores.score(best)
    if after.excess(scores.noise).max() < c.wide_gap and scores.leaves_unmodelled_only(best):
        return 0.0
    found = 0.0
    for share in _removed_by_curves(search, scores, after, best.elements[0]):
        found = max(found, share)
        if found >= c.least_removed:
            break
    return found


def _removed_by_curves(
    search: Search, scores: CandidateComparison, without: HeldOutScore, named: el.Element
) -> Iterator[float]:
    """Yield the shares of an error that free curves in an effect's place remove, over the law's argument and over both; a curve with
    nearly the same force is no other law."""
    for over in (None, "both"):
        curve = fit_in_place_of(search.evaluator, scores.refitted, named, over)
        try:
            now = scores.score(curve) if curve is not None else None
        except BROKEN:
            continue
        if (
            now is not None
            and now.compare_with(without).is_better(search.criteria)
            and _force_difference(search.problem, without.candidate, now.candidate, named)
            >= search.criteria.small_effect
        ):
            yield scores.explained_fraction(without, now)


def _force_difference(problem: Problem, one: Candidate, other: Candidate, named: el.Element) -> float:
    """Return the RMS difference of the forces of two fits at an element's place, as a share of the typical force there."""
    try:
        a, b = (np.sum([*element_forces(problem, c.fit, named.where).values()], axis=0) for c in (one, other))
    except InputError:
        return math.inf
    typical = max(el.rms(a), place_forces(problem, one.fit, without=named.name).at(named.where))
    return float(el.rms(a - b) / max(typical, 1e-300))


def _laws_over_one_plane(search: Search, best: Candidate) -> list[str]:
    """Return the effects and the laws of the model at their limits, if all effects are at one place (or along one chain) over one
    plane."""
    network = search.problem.network
    where = {frozenset(owner_pair(network, h) or h.where) for h in best.hypotheses}
    planes = {e.plane for e in best.elements}
    is_between = all(e.place == "between" for e in best.elements)
    if not is_between or len(best.elements) < 2 or len(where) > 1 or len(planes) > 1:
        return []
    at_limits = {path.rpartition(".")[0] for path in parameters_at_limits(best)}
    own = el.beside(network, tuple(*where))
    return [e.name for e in (*best.elements, *(e for e in own if e.name in at_limits and e.plane in planes))]
