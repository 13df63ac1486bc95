"""Generalized coordinates of a network: the independent nodes under the constraints of rigid bodies and levers.

Every node moves as a linear combination of the coordinates, node = T [free coordinates; moved nodes]. The
points of a body follow the centre of gravity and the angles; each lever eliminates a node. Without bodies and
levers, the coordinates are the nodes.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from ..._common.errors import InputError

if TYPE_CHECKING:
    from ._model import Network

GROUND = "ground"
NOTHING = 1e-12  # share of the largest coefficient of a constraint below which a coefficient has cancelled


@dataclass(frozen=True)
class Coordinates:
    """Coordinates in the order of all matrices (free, then moved), and nodes as rows over the coordinates."""

    # all nodes of the network except the ground, in the order of `Network.nodes`
    nodes: tuple[str, ...]
    free: tuple[str, ...]  # coordinates that no input moves
    moved: tuple[str, ...]  # nodes that inputs move
    # row over the coordinates of every node that is not a coordinate
    dependent: dict[str, np.ndarray]

    @property
    def count(self) -> int:
        """Number of coordinates, including moved nodes."""
        return len(self.free) + len(self.moved)

    @cached_property
    def index(self) -> dict[str, int]:
        """Index of each coordinate."""
        return {n: i for i, n in enumerate(self.free + self.moved)}

    def row(self, node: str) -> np.ndarray:
        """Return the motion of a node as a row (coordinates,); zeros for the ground."""
        return self.incidence((node, GROUND))

    def incidence(self, pair: tuple[str, str]) -> np.ndarray:
        """Return the distance between two nodes, first minus second, as a row (coordinates,)."""
        row = np.zeros(self.count)
        for node, sign in zip(pair, (1.0, -1.0), strict=True):
            if node in self.index:
                row[self.index[node]] += sign
            elif node != GROUND:
                row += sign * self.dependent[node]
        return row

    def of_nodes(self, rows: np.ndarray) -> np.ndarray:
        """Return rows (nodes, n) of all nodes from rows (coordinates, n)."""
        if not self.dependent:
            return rows
        return np.array([self.row(n) for n in self.nodes]) @ rows


def coordinates(network: Network) -> Coordinates:
    """Return the generalized coordinates of a network."""
    moved = network.moved_nodes
    if not network.bodies and not network.levers:
        return Coordinates(
            network.nodes, tuple(n for n in network.nodes if n not in moved), moved, {}
        )
    elimination = _Elimination(network)
    for body in network.bodies:
        for point in body.points:
            arms = {node: -point.arm(axis) for axis, node in body.angles.items()}
            elimination.impose(
                {point.name: 1.0, body.name: -1.0} | arms, f"body '{body.name}'"
            )
    for lever in network.levers:
        first, second = lever.between
        elimination.impose(
            {first: 1.0, second: -float(lever.ratio)}, f"lever '{lever.name}'"
        )
    free = tuple(
        n for n in network.nodes if n not in moved and n not in elimination.eliminated
    )
    kept = [elimination.index[n] for n in free + moved]
    dependent = {
        n: elimination.rows[elimination.index[n], kept] for n in elimination.eliminated
    }
    return Coordinates(network.nodes, free, moved, dependent)


class _Elimination:
    """Nodes as combinations of the nodes that are not yet eliminated."""

    def __init__(self, network: Network) -> None:
        self.names = network.nodes
        self.index = {n: i for i, n in enumerate(self.names)}
        self.rows = np.eye(len(self.names))
        self.moved = set(network.moved_nodes)
        self.eliminated: list[str] = []
        points = {p.name for b in network.bodies for p in b.points}
        angles = {n for b in network.bodies for n in b.angles.values()}
        centres = {b.name for b in network.bodies}
        # the inertia of a shaft, seen at its rack, is comparable with the other masses: rotational nodes are
        # eliminated first
        self.rank = {
            n: 0
            if n in points
            else 3
            if n in angles
            else 4
            if n in centres
            else 1
            if n in network.rotating
            else 2
            for n in self.names
        }

    def impose(self, constraint: dict[str, float], where: str) -> None:
        """Eliminate a node by a constraint: the sum of coefficient times node is zero."""
        full = np.zeros(len(self.names))
        for node, coefficient in constraint.items():
            full[self.index[node]] = coefficient
        reduced = full @ self.rows
        least = NOTHING * (np.abs(full) @ np.abs(self.rows)).max()
        left = [
            n
            for n, share in zip(self.names, reduced, strict=True)
            if abs(share) > least
        ]
        candidates = [n for n in left if n not in self.moved]
        if not left:
            raise InputError(
                f"{where} closes a loop: other levers and bodies say the same; leave it out"
            )
        if not candidates:
            both = ", ".join(f"'{n}'" for n in left)
            raise InputError(
                f"{where}: inputs move {both}, which it ties together: let one of them move, and leave the other input out"
            )
        if len(left) == 1:
            raise InputError(
                f"{where} contradicts the other levers and bodies: together they hold '{left[0]}' still; "
                "correct a ratio or leave one out"
            )
        order = list(constraint)
        pivot = min(
            candidates,
            key=lambda n: (self.rank[n], order.index(n) if n in order else len(order)),
        )
        at = self.index[pivot]
        substitute = -reduced / reduced[at]
        substitute[np.abs(reduced) <= least] = 0.0
        substitute[at] = 0.0
        column = self.rows[:, at].copy()
        self.rows[:, at] = 0.0
        self.rows += np.outer(column, substitute)
        self.eliminated.append(pivot)
