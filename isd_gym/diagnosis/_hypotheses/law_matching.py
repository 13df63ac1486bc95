"""Matches of every law to the residual of a fit: one linear problem, in the space of the outputs.

The residual is a sum of responses: to changes of the parameters, to initial states and offsets, and to the force of the missing law. Laws
over the motion of two nodes have their force along the measured motion; laws in series, drives and sensors are simulated as a small effect.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import groupby
from typing import TYPE_CHECKING

import numpy as np

from ...physics.elements import PERIODS, PROBE
from ...physics.network import assemble
from .._estimation.multiple_shooting import is_lightly_damped
from .._estimation.sensitivities import tangents
from .._estimation.structure import Hypothesis, Structure, add
from .._simulation.problem import BROKEN, Problem, bare
from .forces import DISSIPATIVE, lossy_share, place_forces
from .library import hypotheses
from .motion import joined, loads_of, motions, setting, simulate_variants, tell_gain
from .pair_forces import force_responses, law_forces, measured_motions, spectral_pitches

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from ..._common.arrays import Array
    from ...physics.elements import Motion, Start
    from .._estimation.gauss_newton import Fit, Fitter
    from .._simulation.problem import Problem


#: norm of a derivative, orthogonal to the others, over its whole norm: a smaller ratio counts as linear dependence
DEPENDENT = 1e-7


@dataclass(frozen=True)
class Match:
    """A law at a place, matched to the residual of a fit."""

    hypothesis: Hypothesis
    start: Start
    #: matched values of the law
    values: dict[str, float]
    #: parameters of the fit, transformed, as the match moves them, by path
    moved: dict[str, float]
    #: share of the squared residual that the match removes
    share: float

    def sized(self, size: float) -> Match:
        """Return a match of another size."""
        by = 1 / size if self.start.inverse else size
        return replace(self, values=self.values | {k: self.values[k] * by for k in self.start.grows})

    def begin(self, structure: Structure) -> tuple[Structure, Array]:
        """Return a structure with the law, and start values (parameters,), transformed; raise InputError for impossible values."""
        built = add(structure, self.hypothesis, self.values)
        return built, built.start_from(self.moved)


@dataclass(frozen=True)
class Residual:
    """Whitened residual of a fit before (`whole`) and after (`left`) the projection orthogonal to the derivatives: (rows,), with the rows
    and outputs of each record, an orthonormal basis of its nuisances and of the parameters, and the map to the parameters that explain a
    residual."""

    whole: Array
    left: Array
    spans: dict[int, tuple[int, int, Array]]
    nuisances: dict[int, Array]
    basis: Array
    solve: Array

    def without(self, columns: Array) -> Array:
        out = columns - self.basis @ (self.basis.T @ columns)
        for i, Q in self.nuisances.items():
            first, last, _ = self.spans[i]
            out[first:last] -= Q @ (Q.T @ columns[first:last])
        return np.asarray(out, dtype=np.float64, order="F")


def residual_of(problem: Problem, fitter: Fitter, fit: Fit) -> Residual:
    structure, own = fit.structure, len(fit.x)
    p = own + int(problem.shared_offset.sum())  # parameters, and offsets that all records share
    parts, spans, nuisances, at = [], {}, {}, 0
    begun = {i: fit.initial[i] for i in problem.estimation}
    for i, t in tangents(problem, structure, fit.x, begun).items():
        r = (problem.records[i].measured - problem.shifted(i, t.outputs, fit.offset[i]))[:, :, None]
        free = problem.nuisances(i, t.outputs)
        common = problem.common(t.outputs)
        W = fitter.weights(np.concatenate([r, t.by_parameter, common, t.by_state, free], axis=2))
        W = W.reshape(-1, W.shape[2])
        nuisances[i], _, _ = _orthogonal(W[:, 1 + p :])
        parts.append(W[:, : 1 + p])
        spans[i] = (at, at + len(W), t.outputs)
        at += len(W)
    J = np.zeros((at + own, 1 + p))
    J[:at] = np.concatenate(parts)
    J[at:, 0] = (structure.mean - fit.x) / structure.sigma
    J[at:, 1 : 1 + own] = np.diag(1 / structure.sigma)  # the stated uncertainty
    whole, norm = J[:, 0].copy(), np.linalg.norm(J, axis=0)
    for i, (first, last, _) in spans.items():
        J[first:last] -= nuisances[i] @ (nuisances[i].T @ J[first:last])
    basis, Q, R = _orthogonal(J[:, 1:], norm[1:])
    solve = (np.linalg.pinv(R, rcond=DEPENDENT) @ Q.T)[:own] / np.where(norm > 0, norm, 1)[1 : 1 + own, None]
    return Residual(whole, J[:, 0] - basis @ (basis.T @ J[:, 0]), spans, nuisances, basis, solve)


def _orthogonal(columns: Array, norm: Array | None = None) -> tuple[Array, Array, Array]:
    """Return an orthonormal basis of columns (rows, columns), and their QR decomposition relative to `norm`, their own norms by
    default."""
    norm = np.linalg.norm(columns, axis=0) if norm is None else norm
    Q, R = np.linalg.qr(columns / np.where(norm > 0, norm, 1))
    return Q[:, np.abs(np.diag(R)) > DEPENDENT], Q, R


def match_laws(
    problem: Problem, fitter: Fitter, fit: Fit, noise: Array, candidates: Sequence[Hypothesis]
) -> list[Match]:
    """Return every law at every place from every start of its shape, the largest share first. `noise`: white noise (channels,) of the
    outputs."""
    residual = residual_of(problem, fitter, fit)
    motion = measured_motions(problem, fit, noise)
    starts = starts_of(problem, fit, {pair: joined(m) for pair, m in motion.items()}, candidates)
    small = [(h, start) for h, start in starts if not follows_motion(h)]
    found = _match_small_effects(problem, fitter, fit, residual, small)
    along = sorted(((h, s) for h, s in starts if follows_motion(h)), key=lambda t: t[0].where)
    for where, group in groupby(along, key=lambda t: t[0].where):
        pair = (where[0], where[1])
        found += _match_forces(problem, fitter, fit, residual, pair, motion[pair], list(group))
    return sorted(found, key=lambda m: -m.share)


def follows_motion(h: Hypothesis) -> bool:
    """Return whether the motion of its two nodes tells the force of a law."""
    return h.place == "between" and not (h.kind.series or h.kind.loaded or h.kind.scheduled)


def starts_of(
    problem: Problem,
    fit: Fit,
    motion: Mapping[tuple[str, str], Motion],
    candidates: Sequence[Hypothesis],
) -> list[tuple[Hypothesis, Start]]:
    """Return every start of every hypothesis."""
    forces, out = place_forces(problem, fit), []
    lines: dict[tuple[str, ...], tuple[float, ...]] = {}
    loads = loads_of(problem, fit, candidates)
    for h in candidates:
        load = loads.get(dict(h.options)["load"]) if h.kind.loaded else None
        if h.kind.loaded and (load is None or not tell_gain(load)):
            continue
        pair = motion.get((h.where[0], h.where[1])) if len(h.where) == 2 else None
        if pair is not None and h.kind.periodic and h.where not in lines:
            lines[h.where] = spectral_pitches(problem, fit, (h.where[0], h.where[1]), pair, PERIODS)
        at = setting(problem, fit.network, h, pair, forces.at(h.where), lines.get(h.where, ()), load)
        out += [(h, start) for start in h.kind.starts(at)]
    return out


def built_ways(fit: Fit, h: Hypothesis, start: Start) -> list[Structure]:
    """Return a start built into the fitted model in each of its ways; empty where the model has no place for it."""
    try:
        built = [add(replace(fit.structure, network=fit.network), h, way) for way in start.ways]
        for b in built:
            assemble(bare(b.network))
    except BROKEN:
        return []
    return built


def _match_small_effects(
    problem: Problem, fitter: Fitter, fit: Fit, residual: Residual, starts: Sequence[tuple[Hypothesis, Start]]
) -> list[Match]:
    jobs = [(h, start, built) for h, start in starts if (built := built_ways(fit, h, start))]
    out = [np.zeros((len(residual.left), len(built))) for *_, built in jobs]
    members = [(k, way) for k, (*_, built) in enumerate(jobs) for way in range(len(built))]
    for chunk, i, y in simulate_variants(problem, fit, [jobs[k][2][way].network for k, way in members]):
        first, last, point = residual.spans[i]
        with np.errstate(over="ignore", invalid="ignore"):  # one that breaks down is left out
            w = fitter.weights(y - point[:, :, None]).reshape(last - first, -1)
        for lane, member in enumerate(chunk):
            k, way = members[member]
            out[k][first:last, way] = w[:, lane]
    found = []
    for (h, start, _), s in zip(jobs, out, strict=True):
        bounded = _without_overflow(s)
        found.append(_match(fit, h, start, bounded, residual, residual.without(bounded)))
    return [m for m in found if m is not None]


def _match_forces(
    problem: Problem,
    fitter: Fitter,
    fit: Fit,
    residual: Residual,
    pair: tuple[str, str],
    motion: Mapping[int, Motion],
    starts: Sequence[tuple[Hypothesis, Start]],
) -> list[Match]:
    ways = [(h, way) for h, start in starts for way in start.ways]
    step = problem.records[problem.estimation[0]].step
    whole = law_forces(fit.network, pair, joined(motion), step, ways)
    whole = np.where(np.isfinite(whole).all(axis=0), whole, 0.0)
    edges = np.cumsum([len(m.d) for m in motion.values()])[:-1]
    forces = dict(zip(motion, np.split(whole, edges), strict=True))
    columns = np.zeros((len(residual.left), len(ways)), order="F")  # a law's columns stand together
    for i, y in force_responses(problem, fit, pair, forces).items():
        first, last, _ = residual.spans[i]
        columns[first:last] = fitter.weights(y).reshape(last - first, -1)
    found, at, whole = [], 0, residual.without(_without_overflow(columns))
    for h, start in starts:
        its = slice(at, at + len(start.ways))
        found.append(_match(fit, h, start, columns[:, its], residual, whole[:, its]))
        at += len(start.ways)
    return [m for m in found if m is not None]


def _without_overflow(columns: Array) -> Array:
    """Return columns; zeros in place of a column that diverges, or whose squares would overflow."""
    columns[:, ~(np.abs(columns) < 1e100).all(axis=0)] = 0.0
    return columns


def _match(fit: Fit, h: Hypothesis, start: Start, s: Array, residual: Residual, own: Array) -> Match | None:
    """Return the match of columns `s`, with their part `own` orthogonal to the derivatives (rows, ways); None where they show nothing."""
    size = np.linalg.norm(s, axis=0)
    if not np.all(size > 0):
        return None
    if np.any(np.linalg.norm(own, axis=0) < 1e-3 * size):
        return None
    amplitude = np.asarray(np.linalg.lstsq(own, residual.left, rcond=None)[0], dtype=np.float64)
    is_wrong = not start.signed and bool(np.any(amplitude <= 0))
    if is_wrong and not h.kind.series:
        return None
    # what is put in series changes the order of the equations: a small one says little about a large one
    share = 0.0 if is_wrong else float(residual.left @ (own @ amplitude) / (residual.left @ residual.left))
    move = residual.solve @ (residual.whole - (0.0 if is_wrong else s @ amplitude))
    moved = {
        f.path: float(np.clip(v + dv, f.low, f.high))
        for f, v, dv in zip(fit.structure.free, fit.x, move, strict=True)
    }
    return Match(
        h, start, h.kind.sized(start, np.ones_like(amplitude) if is_wrong else amplitude), moved, share
    )


def simulate_unmodelled_effects(problem: Problem, fit: Fit, share: float) -> dict[int, Array]:
    """Return what each force law of the library, with a share of the typical force (of the dissipating forces, for a law that dissipates
    in a lightly damped structure), does to the outputs (samples, channels, laws) of the training records."""
    motion, forces = motions(problem, fit), place_forces(problem, fit)
    lossy = lossy_share(problem, fit) if is_lightly_damped(problem.network) else 1.0
    networks, sizes = [], []
    for h in hypotheses(fit.network):
        simpler = set(h.kind.contains) & {e.type for e in fit.network.elements} or h.kind.replaces
        if h.place != "between" or h.kind.series or simpler:
            continue
        tried = h.kind.starts(
            setting(problem, fit.network, h, motion.get((h.where[0], h.where[1])), forces.at(h.where))
        )
        for start in tried[:: max(1, len(tried) // 2)][:2]:
            for built in built_ways(fit, h, replace(start, ways=start.ways[:1])):
                networks.append(built.network)
                sizes.append(lossy if h.kind.mechanism in DISSIPATIVE else 1.0)
    out = {i: np.zeros((*y.shape, len(networks))) for i, y in fit.outputs.items()}
    point = {i: y for _, i, y in simulate_variants(problem, fit, [fit.network])}
    for chunk, i, y in simulate_variants(problem, fit, networks):
        with np.errstate(over="ignore", invalid="ignore"):
            change = (y - point[i]) * (share / PROBE) * np.array(sizes)[chunk]
            most = np.abs(change).max(axis=(0, 1))
        # a diverged variant is no evidence
        out[i][:, :, chunk] = np.where(most < 1e6 * np.abs(point[i]).max(), change, 0.0)
    return out
