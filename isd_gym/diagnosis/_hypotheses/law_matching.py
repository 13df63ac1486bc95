"""The residual of a fit beside what the fit absorbs, start values of all laws, and what small effects do to the outputs."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from ..._common.errors import InputError
from ...physics.elements import PROBE
from .._estimation.multiple_shooting import is_lightly_damped
from .._estimation.sensitivities import tangents
from .._estimation.structure import Hypothesis, add
from .forces import DISSIPATIVE, lossy_share, place_forces
from .library import hypotheses
from .motion import loads_of, motions, setting, simulate_variants, tell_gain

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from ..._common.arrays import Array
    from ...physics.elements import Motion, Start
    from .._estimation.gauss_newton import Fit, Fitter
    from .._simulation.problem import Problem


#: norm of a derivative, orthogonal to the others, over its whole norm: a smaller ratio counts as linear dependence
DEPENDENT = 1e-7


@dataclass(frozen=True)
class Residual:
    """Whitened residual of a fit after the projection orthogonal to the derivatives (`left`, (rows,)), with the rows of each record, and
    orthonormal bases of the nuisances of each record and of the parameters."""

    left: Array
    rows: dict[int, slice]
    nuisances: dict[int, Array]
    basis: Array

    def without(self, columns: Array) -> Array:
        """Return columns (rows, columns) without what parameters and nuisances absorb to first order."""
        out = columns - self.basis @ (self.basis.T @ columns)
        for i, Q in self.nuisances.items():
            out[self.rows[i]] -= Q @ (Q.T @ columns[self.rows[i]])
        return np.asarray(out, dtype=np.float64, order="F")


def residual_of(problem: Problem, fitter: Fitter, fit: Fit) -> Residual:
    """Return the residual of a fit on the training records."""
    structure, own = fit.structure, len(fit.x)
    # parameters, and offsets that all records share
    p = own + int(problem.shared_offset.sum())
    parts, rows, nuisances, at = [], {}, {}, 0
    begun = {i: fit.initial[i] for i in problem.estimation}
    for i, t in tangents(problem, structure, fit.x, begun).items():
        seen = t.outputs + fit.offset[i]
        r = (problem.records[i].measured - seen)[:, :, None]
        free = problem.nuisances(t.outputs)
        common = problem.common(t.outputs)
        stack = np.concatenate([r, t.by_parameter, common, t.by_state, free], axis=2)
        W = fitter.weights(stack).reshape(-1, stack.shape[2])
        nuisances[i] = _orthogonal(W[:, 1 + p :])
        parts.append(W[:, : 1 + p])
        rows[i] = slice(at, at + len(W))
        at += len(W)
    J = np.zeros((at + own, 1 + p))
    J[:at] = np.concatenate(parts)
    J[at:, 0] = (structure.mean - fit.x) / structure.sigma
    J[at:, 1 : 1 + own] = np.diag(1 / structure.sigma)  # the stated uncertainty
    norm = np.linalg.norm(J[:, 1:], axis=0)
    for i, Q in nuisances.items():
        J[rows[i]] -= Q @ (Q.T @ J[rows[i]])
    basis = _orthogonal(J[:, 1:], norm)
    left = J[:, 0] - basis @ (basis.T @ J[:, 0])
    return Residual(left, rows, nuisances, basis)


def _orthogonal(columns: Array, norm: Array | None = None) -> Array:
    """Return an orthonormal basis of columns (rows, columns); dependence is relative to `norm`, their own norms by default."""
    norm = np.linalg.norm(columns, axis=0) if norm is None else norm
    Q, R = np.linalg.qr(columns / np.where(norm > 0, norm, 1))
    return np.asarray(Q[:, np.abs(np.diag(R)) > DEPENDENT])


def starts_of(
    problem: Problem,
    fit: Fit,
    motion: Mapping[tuple[str, str], Motion],
    candidates: Sequence[Hypothesis],
) -> list[tuple[Hypothesis, Start]]:
    """Return every start of every hypothesis."""
    forces, out = place_forces(problem, fit), []
    loads = loads_of(problem, fit, candidates)
    for h in candidates:
        load = loads.get(dict(h.options)["load"]) if h.kind.loaded else None
        if h.kind.loaded and (load is None or not tell_gain(load)):
            continue
        pair = motion.get((h.where[0], h.where[1])) if len(h.where) == 2 else None
        at = setting(
            problem,
            fit.network,
            h,
            pair,
            forces.at(h.where),
            load,
        )
        out += [(h, start) for start in h.kind.starts(at)]
    return out


def simulate_unmodelled_effects(
    problem: Problem, fit: Fit, share: float
) -> dict[int, Array]:
    """Return what each force law of the library, with a share of the typical force (of the dissipating forces, for a law that dissipates
    in a lightly damped structure), does to the outputs (samples, channels, laws) of the training records."""
    motion, forces = motions(problem, fit), place_forces(problem, fit)
    lossy = lossy_share(problem, fit) if is_lightly_damped(problem.network) else 1.0
    structure, networks, sizes = replace(fit.structure, network=fit.network), [], []
    for h in hypotheses(fit.network):
        simpler = (
            set(h.kind.contains) & {e.type for e in fit.network.elements}
            or h.kind.replaces
        )
        if h.place != "between" or h.kind.series or simpler:
            continue
        tried = h.kind.starts(
            setting(
                problem,
                fit.network,
                h,
                motion.get((h.where[0], h.where[1])),
                forces.at(h.where),
            )
        )
        for start in tried[:: max(1, len(tried) // 2)][:2]:
            # the model may have no place for it; `simulate_variants` leaves out what cannot be assembled
            with contextlib.suppress(InputError):
                networks.append(add(structure, h, start.ways[0]).network)
                sizes.append(lossy if h.kind.mechanism in DISSIPATIVE else 1.0)
    out = {i: np.zeros((*y.shape, len(networks))) for i, y in fit.outputs.items()}
    ((_, point),) = simulate_variants(problem, fit, [fit.network])
    for chunk, seen in simulate_variants(problem, fit, networks):
        for i, y in seen.items():
            with np.errstate(over="ignore", invalid="ignore"):
                change = (y - point[i]) * (share / PROBE) * np.array(sizes)[chunk]
                most = np.abs(change).max(axis=(0, 1))
            # a diverged variant is no evidence
            out[i][:, :, chunk] = np.where(
                most < 1e6 * np.abs(point[i]).max(), change, 0.0
            )
    return out
