"""From a trial to its evidence: every number once, and the intervals of what was fitted."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ... import elements as el
from ...errors import InputError
from ..estimation.gauss_newton import Fit, Fitter, residuals
from ..estimation.noise import whitener
from ..estimation.structure import Hypothesis, Structure, owner_pair
from ..hypotheses.forces import element_forces, place_forces
from ..hypotheses.motion import motions
from ..result import Quantity
from ..selection.candidate import BROKEN, Candidate, reckoned, simpler
from ..selection.equivalent_laws import repeats
from ..selection.free_force import in_its_place
from ..selection.weights import WeightedCandidate, weigh_candidates, weight_of_all
from .evidence import EffectEvidence, Evidence, row

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from ...network import Network
    from ..selection.candidate_comparison import Trial
    from ..selection.forward_backward import Search
    from ..selection.held_out import Outcome
    from ..simulation.problem import Array, Problem

#: a law's force over the data's motion (RMS, as the typical force is: a decay begins far above it), as a multiple of their typical
#: force, beyond which its values mean something else
LARGEST = 10.0
#: a length or a rate of a law, as a multiple of the motion, beyond which the data do not show it
FURTHEST = 20.0


#: laws over one plane at one place that are as good as a free curve's bends
BENDS = 3


def covariance(search: Search, candidate: Candidate) -> Array | None:
    """Covariance (parameters, parameters) of the free parameters, in the coordinates of the fit; None where there are none.

    Noise counts by the curvature under the residual's own coloured noise; the small effects that every rig has and no
    model holds count by how far each of them, `SMALL` of the force, would drag the parameters.
    """
    problem, fit = search.problem, candidate.fit
    W = whitener(residuals(problem, fit), reckoned(problem, fit, search.floors))
    f = Fitter(problem, W).fit(fit.structure, fit.x, fit.initial, fit.offset, iterations=0)
    if f.hessian is None or not len(f.x):
        return None
    sigma = np.array([q.sigma for q in f.structure.free])
    out = np.linalg.inv(f.hessian + np.diag(1 / sigma**2))
    try:
        dragged, left = Fitter(problem, W).refit(f, search.judge.responses(candidate))
        # none is larger than what is left allows: where nothing holds a mass, little goes a long way, and would be seen
        seen = np.sqrt(sum(np.sum(part**2, axis=(0, 1)) for part in left.values()))
        dragged = dragged * np.minimum(1.0, math.sqrt(f.cost) / np.maximum(seen, 1e-300))
        dragged = np.clip(dragged, -1e6, 1e6)  # some have no end
        out = out + dragged @ dragged.T
    except BROKEN:
        pass
    return np.asarray(out)


def intervals(search: Search, candidate: Candidate, spread: Array | None = None) -> dict[str, Quantity]:
    """Every free parameter with its 95 % interval. `spread`: its `covariance`, where that is known already."""
    problem, f = search.problem, candidate.fit
    spread = covariance(search, candidate) if spread is None else spread
    out: dict[str, Quantity] = {}
    if spread is None:
        return out
    sigma = np.array([q.sigma for q in f.structure.free])
    # no wider than what was known before
    variance = np.minimum(np.maximum(np.diag(spread), 0.0), sigma**2)
    known = problem.network.parameters
    for k, q in enumerate(f.structure.free):
        s, x = math.sqrt(variance[k]), f.x[k]
        ends = (
            q.back(max(x - 1.96 * s, -700.0)),
            q.back(min(x + 1.96 * s, 700.0)) if q.log else x + 1.96 * s,
        )
        out[q.path] = Quantity(q.back(x), *ends, f.network.unit_of(q.path), known.get(q.path))
    return out


def beyond_limits(search: Search, candidate: Candidate) -> tuple[str, ...]:
    """Parameters of the owner's model that end where the owner allows them to go."""
    out = []
    for q, x in zip(candidate.fit.structure.free, candidate.fit.x, strict=True):
        if q.owner < 0 and (x <= q.low + 1e-6 * q.sigma or x >= q.high - 1e-6 * q.sigma):
            out.append(q.path)
    return tuple(out)


def beside(network: Network, elements: Sequence[el.Element]) -> tuple[str, ...]:
    """Parameters of the owner's laws that stand at the place of one of these, over its plane."""
    out = []
    for e in elements:
        here = el.beside(network, e.where) if e.place == "between" else []
        out += [
            f"{o.name}.{f.name}" for o in here if o.plane == e.plane for f in el.parameter_fields(type(o))
        ]
    return tuple(dict.fromkeys(out))


def difference(
    network: Network, structure: Structure, x: Array, element: el.Element, spread: Array | None
) -> Quantity | None:
    """The difference of the two parameters whose common part could be a parameter of the model's, where they have one."""
    here = [e for e in el.beside(network, element.where) if e.name != element.name]
    pair = element.differing(here)
    if pair is None or spread is None:
        return None
    free = structure.free
    paths = [q.path for q in free]
    wanted = [f"{element.name}.{name}" for name in pair]
    if any(w not in paths or free[paths.index(w)].log for w in wanted):
        return None
    a = np.zeros(len(paths))
    a[[paths.index(w) for w in wanted]] = 1.0, -1.0
    value, half = float(a @ x), 1.96 * math.sqrt(max(float(a @ spread @ a), 0.0))
    return Quantity(value, value - half, value + half, structure.network.unit_of(wanted[0]), None)


def spread_of(element: el.Element, quantities: dict[str, Quantity], beyond: Quantity | None = None) -> float:
    """Half of an effect's widest 95 % interval, as the logarithm of a factor; infinite where it holds zero.

    Of several parameters of one unit the largest counts: a damper may well be soft in one direction. `beyond`: what they
    differ by, which counts instead where what they have in common may be the model's.
    """
    by_unit: dict[str, tuple[float, float]] = {}
    for f in el.parameter_fields(type(element)):
        q = quantities.get(f"{element.name}.{f.name}")
        if q is None or f.metadata["stride"]:  # of a phase only the turn counts
            continue
        neutral = f.default if isinstance(f.default, int | float) else 0.0
        size = abs(q.value - neutral)
        half = q.value - q.low if f.metadata["minimum"] >= 0 else 0.5 * abs(q.high - q.low)
        old = by_unit.get(q.unit, (0.0, 0.0))
        by_unit[q.unit] = max(old[0], size), max(old[1], half)
    if beyond is not None:
        by_unit[beyond.unit] = abs(beyond.value), 0.5 * (beyond.high - beyond.low)
    return max((_factor(size, half) for size, half in by_unit.values()), default=0.0)


def _factor(size: float, half: float) -> float:
    """Logarithm of the factor by which a value of that size, known to +- half, may be too large."""
    return math.inf if half >= size else -math.log1p(-half / size)


def complaint(problem: Problem, fit: Fit, element: el.Element) -> str:
    """Why an effect's values cannot be what its name says on these data; empty where they can."""
    if not element.well_formed():
        return "its values are not what its name says"
    if element.place != "between" or element.series:
        return ""
    motion = motions(problem, fit).get(element.between)
    if motion is None:
        return ""
    if not repeats(element, motion):
        return "too little of a period lies within the travel for it to be seen to repeat"
    scales = {"m": motion.reach, "m/s": float(np.abs(motion.v).max())}
    for f in el.parameter_fields(type(element)):
        scale = scales.get(f.metadata["unit"])
        if scale and not f.metadata["fixed"] and getattr(element, f.name) > FURTHEST * scale:
            return f"its {f.name.replace('_', ' ')} lies far beyond what the data reach"
    if element.plane != "time":
        axis = motion.v if element.plane == "rate" else motion.d
        force = element.curve(axis[:: max(1, len(axis) // 500)])
        moved = max(problem.network.masses.values(), default=0.0) * el.rms(motion.a)
        typical = place_forces(problem, fit, without=element.name).at(element.where)
        if el.rms(force) > LARGEST * max(typical, moved):
            return "its force is many times what the data show"
    return ""


def blames_sensor(hypotheses: tuple[Hypothesis, ...]) -> bool:
    return any(h.place == "channel" for h in hypotheses)


@dataclass(frozen=True, eq=False)
class Measured:
    """What is measured of a trial's foremost candidate."""

    evidence: Evidence
    #: parameters with intervals, by path
    quantities: dict[str, Quantity]
    #: rivals of another kind that the foremost candidate is not told apart from
    indistinguishable: list[Candidate]
    #: candidates with weights, largest first
    weighted: tuple[WeightedCandidate, ...]


def measure(search: Search, trial: Trial, seed: int = 0) -> Measured:
    """Measure the foremost candidate of a trial.

    Args:
        search: The search.
        trial: Scores of the candidates.
        seed: Seed of the Bayesian bootstrap.
    """
    problem, judge = search.problem, search.judge
    base, best = trial.base, trial.foremost
    refit, after, closest = trial.of(base), trial.of(best), trial.of(trial.richest)
    before, _ = judge.owner()
    worth = search.worth(base)
    spread = covariance(search, best)
    quantities = intervals(search, best, spread)
    common = {
        "channels": tuple(problem.channels),
        "before": row(before),
        "refit": row(refit.nrmse),
        "floor": row(trial.floor),
        "floor_known": tuple(f.known for f in judge.known),
        "worth": row(worth),
        "limits": beyond_limits(search, best),
        "refit_limits": beyond_limits(search, base),
    }
    if not best.hypotheses:
        return Measured(Evidence(after=row(refit.nrmse), **common), quantities, [], ())  # type: ignore[arg-type]
    weighted = weigh_candidates(search, trial, seed=seed)
    effects = tuple(
        EffectEvidence(
            label=h.label,
            share=share,
            spread=spread_of(
                e, quantities, difference(problem.network, best.fit.structure, best.fit.x, e, spread)
            ),
            complaint=complaint(problem, best.fit, e),
            sensor=h.place == "channel",
            fault=e.fault(problem.time),
            **dict(
                zip(("removed", "width", "beyond_small"), removed_by(search, trial, best, k), strict=True)
            ),  # type: ignore[arg-type]
        )
        for k, (h, e, share) in enumerate(zip(best.hypotheses, best.elements, judge.sizes(best), strict=True))
    )
    rivals = trial.rivals()
    others = [r for r in rivals if not search.same(r, best)]
    abreast = search.abreast(trial)
    forces = [r for r in rivals if not blames_sensor(r.hypotheses)] + [base]
    own = trial.beyond(best)
    worth_after = search.worth(best)
    versus = after.versus(refit)
    evidence = Evidence(
        after=row(after.nrmse),
        effects=effects,
        elpd_diff=versus.elpd_diff,
        elpd_dse=versus.dse,
        explained=trial.explained(best, worth),
        worth_after=row(worth_after),
        fitted_explained=trial.fitted_explained(refit, after, worth),
        sure=weight_of_all(weighted, best),
        shapeless=shapeless(search, trial),
        confirmed=trial.confirmed(best),
        test_rest=trial.test_rest(best, worth_after),
        lead=min((trial.of(r).score - trial.quiet for r in others), default=math.inf) / own,
        abreast=tuple(r.label for r in abreast),
        force_lead=min(trial.of(r).score - trial.quiet for r in forces) / own,
        fitted_refit=row(judge.fitted(base)),
        fitted_after=row(judge.fitted(best)),
        beside=beside(problem.network, best.elements),
        closest=row(closest.nrmse),
        closest_share=max(judge.sizes(trial.richest), default=1.0),
        **common,  # type: ignore[arg-type]
    )
    return Measured(evidence, quantities, abreast, weighted)


def removed_by(search: Search, trial: Trial, best: Candidate, effect: int) -> tuple[float, float, bool]:
    """Return what one effect of the foremost candidate removes of the error without it (`Compared.removed`)."""
    others = [h for k, h in enumerate(best.hypotheses) if k != effect]
    without = next((r for r in trial.candidates() if list(r.hypotheses) == others and trial.follows(r)), None)
    if without is None:
        structure = next((s for _, s in simpler(search.problem, best) if list(s.hypotheses) == others), None)
        without = search.anew(structure, best) if structure is not None else None
    if without is None or not trial.follows(without):
        return 0.0, 0.0, False
    return search.removed(trial, best, without)


def shapeless(search: Search, trial: Trial) -> float:
    """Share of what the foremost candidate leaves that a free curve in its effect's place removes: then it is another law.

    Asked of a single effect, where much is left, or more than small effects make; else 0. Several over one plane at one place
    which, with the owner's own laws that went to their limits there, are as many as a curve has bends: all of it (1). So are
    as many anywhere, where one curve at one place explains the gap: one force without a name stands for many with one.
    """
    c, best = search.criteria, trial.foremost
    if len(best.hypotheses) > 1:
        if len(_over_one_plane(search, best)) >= BENDS:
            return 1.0
        if len(best.hypotheses) < BENDS:
            return 0.0
        base = trial.of(trial.base)
        one = (share for e in best.elements for share in _by_curve(search, trial, base, e))
        return float(any(share >= c.adequate for share in one))
    after = trial.of(best)
    if after.excess(trial.floor).max() < c.misses and search.trifling(trial, best):
        return 0.0
    found = 0.0
    for share in _by_curve(search, trial, after, best.elements[0]):
        found = max(found, share)
        if found >= c.half:
            break
    return found


def _by_curve(search: Search, trial: Trial, without: Outcome, named: el.Element) -> Iterator[float]:
    """Shares of what `without` leaves that free curves at an effect's place remove: over what its law reads, and over all there is.

    A curve whose force differs from that of `without` by less than a small effect's force is no other law.
    """
    for over in (None, "both"):
        curve = in_its_place(search.judge, trial.base, named, over)
        try:
            now = trial.of(curve) if curve is not None else None
        except BROKEN:
            continue
        if (
            now is not None
            and now.versus(without).is_better(search.criteria)
            and _force_apart(search.problem, without.candidate, now.candidate, named) >= search.criteria.small
        ):
            yield trial.share(without, now)


def _force_apart(problem: Problem, one: Candidate, other: Candidate, named: el.Element) -> float:
    """Root mean square by which the forces of two fits differ at an element's place, as a share of the typical force there."""
    try:
        a, b = (np.sum([*element_forces(problem, c.fit, named.where).values()], axis=0) for c in (one, other))
    except InputError:
        return math.inf
    typical = max(el.rms(a), place_forces(problem, one.fit, without=named.name).at(named.where))
    return float(el.rms(a - b) / max(typical, 1e-300))


def _over_one_plane(search: Search, best: Candidate) -> list[str]:
    """Several effects at one place and over one plane, if all of them are, with the owner's laws there that went to their limits.

    What is in series along a chain without masses is at one place.
    """
    network = search.problem.network
    where = {frozenset(owner_pair(network, h) or h.where) for h in best.hypotheses}
    planes = {e.plane for e in best.elements}
    between = all(e.place == "between" for e in best.elements)
    if not between or len(best.elements) < 2 or len(where) > 1 or len(planes) > 1:
        return []
    bent = {path.rpartition(".")[0] for path in beyond_limits(search, best)}
    own = el.beside(network, tuple(*where))
    return [e.name for e in (*best.elements, *(e for e in own if e.name in bent and e.plane in planes))]
