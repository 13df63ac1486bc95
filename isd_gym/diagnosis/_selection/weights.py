"""Weights of candidates by their log predictive density, and the probability of a place, a kind and a law.

The weights are those of pseudo-Bayesian model averaging with the Bayesian bootstrap. The probability of a statement is the sum of the
weights of the candidates that contain it.

References:
    Yao, Vehtari, Simpson, Gelman: Using stacking to average Bayesian predictive distributions, Bayesian Analysis 13 (2018), section 3.4.
    Rubin: The Bayesian bootstrap, Annals of Statistics 9 (1981).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from .._estimation.structure import owner_pair
from .admissibility import is_sound
from .candidate import is_special_case
from .free_force import Table

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from ..._common.arrays import Array
    from .candidate import Candidate
    from .candidate_comparison import CandidateComparison

#: draws of the Bayesian bootstrap: the standard error of a weight is at most 0.016
DRAWS = 1000
#: word for a force whose law is not in the library
FREE_FORCE = "free_force"


def pseudo_bma_weights(lpd: Array, seed: int = 0) -> Array:
    """Return pseudo-BMA+ weights (candidates,), which add up to one, from log predictive densities (candidates, blocks) [nats]."""
    lpd = np.asarray(lpd, float)
    share = np.random.default_rng(seed).dirichlet(np.ones(lpd.shape[1]), size=DRAWS)
    total = lpd.shape[1] * (share @ lpd.T)
    odds = np.exp(total - total.max(axis=1, keepdims=True))
    return np.asarray(np.mean(odds / odds.sum(axis=1, keepdims=True), axis=0))


@dataclass(frozen=True)
class Statement:
    """Place, kind and law of one effect of a candidate."""

    #: terminals in alphabetical order, or the channel
    place: tuple[str, ...]
    kind: str
    law: str


@dataclass(frozen=True, eq=False)
class WeightedCandidate:
    """A candidate with its weight and its statements."""

    candidate: Candidate
    weight: float
    statements: frozenset[Statement]


def statements_of(scores: CandidateComparison, candidate: Candidate, best: Candidate) -> frozenset[Statement]:
    """Return the statements of a candidate: of a free force, of its own effects, or those of the foremost candidate with equivalent
    effects."""
    structure = candidate.fit.structure
    if isinstance(structure, Table):
        pair = structure.network.element(structure.element).between
        # a force of the distance alone is elastic, whatever its law
        kind = "elastic" if structure.over == "elongation" else "other"
        return frozenset({Statement(tuple(sorted(pair)), kind, FREE_FORCE)})
    alike = (
        candidate is not best
        and best.hypotheses
        and len(candidate.hypotheses) == len(best.hypotheses)
        and candidate.hypotheses[:-1] == best.hypotheses[:-1]
        and scores.states_the_same(candidate, best)
        and not is_special_case(candidate.hypotheses[-1], best.hypotheses[-1])
    )
    chosen = best if alike else candidate
    network = scores.evaluator.problem.network
    places = [owner_pair(network, h) for h in chosen.hypotheses]
    return frozenset(
        Statement(tuple(sorted(pair)) if pair else h.where, h.kind.mechanism, h.effect)
        for h, pair in zip(chosen.hypotheses, places, strict=True)
    )


def weigh_candidates(
    scores: CandidateComparison, extra: Iterable[Candidate] = (), seed: int = 0
) -> tuple[WeightedCandidate, ...]:
    """Weigh the sound candidates of a search on the blocks of validation and training records; more parameters or effects than the
    foremost one's take part only where they predict better by more than unmodelled effects make."""
    best = scores.foremost

    def is_worth_its_parameters(r: Candidate) -> bool:
        has_more = len(r.fit.x) > len(best.fit.x)
        return not has_more or scores.is_worth_more_parameters(r, best)

    taking_part: list[Candidate] = [scores.refitted]
    if best is not scores.refitted:
        taking_part.append(best)
    for r in scores.candidates():
        if (
            any(r is q for q in taking_part)
            or not scores.can_score(r)
            or not is_sound(scores.evaluator.problem, r, scores.criteria)
        ):
            continue
        if not is_worth_its_parameters(r) or scores.blames_needlessly(r, best):
            continue
        if len(r.hypotheses) > len(best.hypotheses) > 0 and not scores.exceeds_envelope(r, best):
            continue
        taking_part.append(r)
    taking_part += [r for r in extra if scores.can_score(r) and is_worth_its_parameters(r)]
    weights = pseudo_bma_weights(np.stack([scores.score(r).lpd for r in taking_part]), seed)
    found = [
        WeightedCandidate(r, float(w), statements_of(scores, r, best))
        for r, w in zip(taking_part, weights, strict=True)
    ]
    return tuple(sorted(found, key=lambda c: -c.weight))


def probability(candidates: Sequence[WeightedCandidate], **wanted: object) -> float:
    """Return the sum of the weights of the candidates with a statement whose fields have the wanted values."""
    return float(
        sum(
            c.weight
            for c in candidates
            if any(all(getattr(s, k) == v for k, v in wanted.items()) for s in c.statements)
        )
    )
