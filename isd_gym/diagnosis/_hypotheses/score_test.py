"""The score test: the expected decrease of the cost by each effect, beyond the parameters of the model."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.linalg import block_diag

from ..._common.errors import InputError
from ...physics.elements import PERIODS
from ...physics.network import assemble
from .._estimation.sensitivities import tangents
from .._estimation.structure import Hypothesis, Structure, add
from .._simulation.problem import Problem, bare
from .forces import place_forces
from .loads import loads_of, tell_gain
from .motion import motions, setting, simulate_variants
from .position_spectrum import spectral_pitches

if TYPE_CHECKING:
    from collections.abc import Sequence

    from ..._common.arrays import Array
    from ...physics.elements import Start
    from .._estimation.gauss_newton import Fit, Fitter


@dataclass(frozen=True)
class ScoredStart:
    """A start of a hypothesis: values at the amplitude of the score test, and the expected decrease of the cost."""

    hypothesis: Hypothesis
    start: Start
    values: dict[str, float]
    gain: float


def with_fitted_effects(fit: Fit) -> Structure:
    """Return the structure with fitted values of the effects and nominal values of the model."""
    free = fit.structure.free
    found = {f.path: f.back(float(v)) for f, v in zip(free, fit.x, strict=True) if f.owner >= 0}
    if not found:
        return fit.structure
    return replace(fit.structure, network=fit.structure.network.with_parameters(found))


@dataclass(frozen=True)
class Residual:
    """Whitened residual of a fit, orthogonal to the derivatives by parameters, initial states and offsets.

    `left` (rows,); `basis` (rows, directions); `spans`: record -> (first row, last row, outputs of the fit).
    """

    left: Array
    basis: Array
    spans: dict[int, tuple[int, int, Array]]

    def without(self, columns: Array) -> Array:
        return np.asarray(columns - self.basis @ (self.basis.T @ columns), dtype=np.float64)


def residual_of(problem: Problem, fitter: Fitter, fit: Fit) -> Residual:
    structure, own = fit.structure, len(fit.x)
    p = own + int(problem.shared_offset.sum())  # parameters, and offsets that all records share
    parts, spans, at = [], {}, 0
    begun = {i: fit.initial[i] for i in problem.estimation}
    for i, t in tangents(problem, structure, fit.x, begun).items():
        r = (problem.records[i].measured - problem.shifted(i, t.outputs, fit.offset[i]))[:, :, None]
        free = problem.nuisances(i, t.outputs)
        common = problem.common(t.outputs)
        W = fitter.weights(np.concatenate([r, t.by_parameter, common, t.by_state, free], axis=2))
        parts.append(W.reshape(-1, W.shape[2]))
        spans[i] = (at, at + len(parts[-1]), t.outputs)
        at += len(parts[-1])
    by_record = block_diag(*(W[:, 1 + p :] for W in parts))
    J = np.zeros((at + own, p + by_record.shape[1]))
    J[:at, :p], J[:at, p:] = np.concatenate([W[:, 1 : 1 + p] for W in parts]), by_record
    J[at:, :own] = np.diag(1 / structure.sigma)  # the stated uncertainty
    r = np.concatenate([*(W[:, 0] for W in parts), (structure.mean - fit.x) / structure.sigma])
    norm = np.linalg.norm(J, axis=0)
    Q, R = np.linalg.qr(J / np.where(norm > 0, norm, 1))
    Q = Q[:, np.abs(np.diag(R)) > 1e-7]
    return Residual(r - Q @ (Q.T @ r), Q, spans)


def score_hypotheses(
    problem: Problem, fitter: Fitter, fit: Fit, candidates: Sequence[Hypothesis], lost: bool = False
) -> list[ScoredStart]:
    """Return every hypothesis at every start with its expected gain, largest gain first.

    `lost`: the simulation has lost its phase, so that small effects say nothing about large ones, and nobody is left out.
    """
    residual = residual_of(problem, fitter, fit)
    jobs = build_starts(problem, fit, candidates)
    responses = _responses(problem, fitter, fit, residual, [built for _, _, built in jobs])
    found = []
    for (h, start, _), s in zip(jobs, responses, strict=True):
        seen = _scored(h, start, s, residual, lost)
        if seen is not None:
            found.append(seen)
    found.sort(key=lambda c: -c.gain)
    return found


def build_starts(
    problem: Problem, fit: Fit, candidates: Sequence[Hypothesis]
) -> list[tuple[Hypothesis, Start, list[Structure]]]:
    """Return every start of every hypothesis, built into the fitted model in each of its ways."""
    motion, forces = motions(problem, fit), place_forces(problem, fit)
    fitted = replace(fit.structure, network=fit.network)
    out = []
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
        for start in h.kind.starts(at):
            try:
                built = [add(fitted, h, way) for way in start.ways]
                for b in built:
                    assemble(bare(b.network))
            except (InputError, np.linalg.LinAlgError):
                continue
            out.append((h, start, built))
    return out


def _responses(
    problem: Problem, fitter: Fitter, fit: Fit, residual: Residual, built: Sequence[Sequence[Structure]]
) -> list[Array]:
    """Return the change of the whitened outputs by each start (rows, ways)."""
    out = [np.zeros((len(residual.left), len(ways))) for ways in built]
    members = [(k, way) for k, ways in enumerate(built) for way in range(len(ways))]
    networks = [built[k][way].network for k, way in members]
    for chunk, i, y in simulate_variants(problem, fit, networks):
        first, last, point = residual.spans[i]
        with np.errstate(over="ignore", invalid="ignore"):  # one that breaks down is left out
            w = fitter.weights(y - point[:, :, None]).reshape(last - first, -1)
        for lane, member in enumerate(chunk):
            k, way = members[member]
            out[k][first:last, way] = w[:, lane]
    return out


def _scored(h: Hypothesis, start: Start, s: Array, residual: Residual, lost: bool) -> ScoredStart | None:
    if not (np.abs(s) < 1e100).all():  # the variant diverges, or its squares would overflow
        return None
    size = np.linalg.norm(s, axis=0)
    if not np.all(size > 0):
        return None
    s = residual.without(s)
    if np.any(np.linalg.norm(s, axis=0) < 1e-3 * size):
        return None
    amplitude = np.asarray(np.linalg.lstsq(s, residual.left, rcond=None)[0], dtype=np.float64)
    wrong = not start.signed and bool(np.any(amplitude <= 0))
    if wrong and not h.kind.series and not lost:
        return None
    # what is put in series changes the order of the equations: a small one says little about a large one
    gain = 0.0 if wrong else float(residual.left @ (s @ amplitude))
    return ScoredStart(h, start, h.kind.sized(start, np.ones_like(amplitude) if wrong else amplitude), gain)
