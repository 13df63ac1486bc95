"""Motion of the nodes at an initial state, and the transfer of initial states between networks."""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from ..._common.arrays import Array
    from ...physics.network import Assembly

#: matrices that are kept
LATEST = 200


def motion_rows_of(
    asm: Assembly, time: float, nodes: Sequence[str] | None = None
) -> Array:
    """Return displacement, and velocity times `time` [s], of nodes as rows over the states."""
    x = asm.columns("x")
    every = [n for n in asm.network.nodes if n not in asm.network.moved_nodes]
    pick = [every.index(n) for n in (every if nodes is None else nodes)]
    return np.vstack([asm.position[pick, x], time * asm.velocity[pick, x]])


@lru_cache(maxsize=LATEST)
def transfer_matrix(source: Assembly, target: Assembly, time: float) -> Array:
    """Return the matrix from initial states of `source` to those of `target`, with equal motion of common nodes."""
    moved = source.network.moved_nodes
    both = [
        n for n in source.network.nodes if n in target.network.nodes and n not in moved
    ]
    if not both or not target.size[0]:
        return np.zeros((target.size[0], source.size[0]))
    own, other = motion_rows_of(target, time, both), motion_rows_of(source, time, both)
    return np.asarray(np.linalg.lstsq(own, other, rcond=None)[0], dtype=np.float64)
