"""Responses to small effects that every rig has and no model contains."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from ...physics.elements import PROBE
from ...physics.network import assemble
from .._estimation.multiple_shooting import is_lightly_damped
from .._estimation.structure import add
from .._simulation.problem import BROKEN, bare
from .forces import DISSIPATIVE, lossy_share, place_forces
from .library import hypotheses
from .motion import motions, setting, simulate_variants

if TYPE_CHECKING:
    from ..._common.arrays import Array
    from .._estimation.gauss_newton import Fit
    from .._simulation.problem import Problem


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
            try:
                built = add(replace(fit.structure, network=fit.network), h, start.ways[0]).network
                assemble(bare(built))
            except BROKEN:
                continue
            networks.append(built)
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
