"""Equations of motion of a network, and their state space.

The generalized coordinates q are the displacements of the free nodes (fewer with rigid bodies and levers, see
`coordinates`). With the moved nodes r(t), and the incidence E of motors, friction and force laws f::

    M q'' + C q' + K q + M_r r'' + C_r r' + K_r r + E f = F

M is singular if nodes have no mass. Its singular value decomposition separates the directions V of q = V a +
... with momentum (two states each) from the rest. Damped directions of the rest are first-order states;
undamped directions are algebraic. The momentum p = a' + (U^T M V)^-1 U^T M_r r' is a state instead of the
velocity, so that only outputs need r''. V depends on which nodes have mass, not on the size of the masses
(`_upright`).

A node that is moved by its velocity or acceleration has a position that is unknown up to constants. The nodes
tied to it are described in a frame that moves with it: q = q_rel + 1 r, and every mass feels -m r''
(`frames`). Then r is not needed if only dampers tie the node to the ground, and r' is not needed without such
a tie; momentum remains a state if r' is known.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

from ..._common.errors import InputError
from ..._common.units import HELD
from .. import elements as el
from ._coordinates import coordinates
from ._frames import complete, frames, unknown
from ._model import GROUND, MOTIONS, Channel, Network

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from ._coordinates import Coordinates


@dataclass(frozen=True, eq=False)
class Assembly:
    """Equations of motion of a network; the force f of every law is an input of the linear part.

    The columns of all matrices are the base vector (x, r, v, alpha, F, I, f): states, displacement [m],
    velocity and acceleration of the moved nodes, force inputs [N], currents [A], law forces [N].
    """

    network: Network  # the model
    channels: tuple[Channel, ...]  # channels of the outputs
    size: tuple[int, int, int, int, int]  # numbers of states, moved nodes, force inputs, currents and laws
    laws: tuple[el.Element, ...]  # elements with a law
    rate: np.ndarray  # time derivative of the states, rows (states, columns)
    elongation: np.ndarray  # elongation of each law [m], rows (laws, columns)
    elongation_rate: np.ndarray  # rate of elongation of each law [m/s], rows (laws, columns)
    #: whether each law acts on an algebraic node, whose velocity is the difference of its positions
    by_difference: tuple[bool, ...]
    outputs: np.ndarray  # rows (channels, columns)
    outputs_by_difference: tuple[bool, ...]  # whether each output is on an algebraic node
    position: np.ndarray  # positions of the nodes, moved nodes last, rows (nodes, columns)
    velocity: np.ndarray  # velocities of the nodes, moved nodes last, rows (nodes, columns)

    def columns(self, part: str) -> slice:
        """Return the columns of a part of the base vector.

        Args:
            part: 'x', 'r', 'v', 'alpha', 'F', 'I' or 'f'.
        """
        return _spans(self.size)[part]


def assemble(network: Network, extra: Sequence[Channel] = ()) -> Assembly:
    """Return the equations of motion of a network, and the rows of its outputs.

    Args:
        network: The model.
        extra: Further output channels, after those of the model.

    Raises:
        InputError: The massless part is singular, or an output is not defined in the network, such as the
            acceleration of a massless node.
    """
    return _assemble(network, extra) if extra else network._assembly


def _assemble(network: Network, extra: Sequence[Channel]) -> Assembly:
    nodes = coordinates(network)
    between = [e for e in network.elements if e.place == "between"]
    laws = tuple(part for e in between for part in e.parts())
    matrices = _matrices(network, nodes, between)
    ties = _ties(network, nodes, matrices)
    split = _split(matrices, ties, nodes)
    counts = [
        sum(c.quantity == "force" for c in network.inputs),
        sum(c.quantity in HELD for c in network.inputs),
    ]
    states = 2 * len(split.accelerates) + len(split.yields)
    size = (states, len(nodes.moved), counts[0], counts[1], len(laws))
    pushes = _pushes(network, nodes, laws, size)
    motion = _motion(nodes, matrices, ties, split, pushes.nodes, size)
    law_rows = np.array([nodes.incidence(e.between) for e in laws]).reshape(len(laws), nodes.count)
    outputs = _Outputs(network, nodes, laws, pushes.motors, motion, size)
    channels = (*network.outputs, *extra)
    found = [outputs.row(channel) for channel in channels]
    rows = [row for row, _ in found]
    elongation, elongation_rate = law_rows @ motion.position, law_rows @ motion.velocity
    for j, e in enumerate(laws):
        if e.loaded:  # the kernel passes the load instead of the elongation
            elongation[j] = outputs.force_of(network.element(getattr(e, "load", "")), f"element '{e.name}'")
    if any(c.quantity != "displacement" for c in network.moving):
        lacking = unknown(network, _spans(size))
        places = [column for column, what in lacking if what == "displacement"]
        for e, row in zip(laws, elongation, strict=True):
            if e.plane == "rate" and GROUND in e.where:
                row[places] = 0.0
        rows = [np.where(np.abs(row) < ROUNDING * np.abs(row).max(initial=0.0), 0.0, row) for row in rows]
        complete(network, lacking, motion.rate, elongation, elongation_rate, rows)
    if not all(np.isfinite(m).all() for m in (motion.rate, motion.position, motion.velocity, *rows)):
        raise InputError(TOO_FAR_APART)
    algebraic = np.abs(nodes.of_nodes(motion.algebraic)).sum(axis=1) > NO_SHARE
    by_difference = tuple(_hangs_on(row, motion.algebraic) for row in law_rows)
    _schedule(network, laws, elongation, by_difference, size)
    return Assembly(
        network=network,
        channels=channels,
        size=size,
        laws=laws,
        rate=motion.rate,
        elongation=elongation,
        elongation_rate=elongation_rate,
        by_difference=by_difference,
        outputs=np.array(rows).reshape(len(rows), sum(_widths(size))),
        outputs_by_difference=tuple(difference for _, difference in found),
        position=nodes.of_nodes(motion.position),
        velocity=np.where(algebraic[:, None], 0.0, nodes.of_nodes(motion.velocity)),
    )


def _schedule(
    network: Network,
    laws: Sequence[el.Element],
    elongation: np.ndarray,
    by_difference: Sequence[bool],
    size: Size,
) -> None:
    """Give laws that read a current or a logged channel its value instead of the elongation. Logged channels
    follow the currents in the base vector."""
    currents = [c for c in network.inputs if c.quantity == "current"]
    logged = [c.name for c in network.inputs if c.quantity == "condition"]
    for j, e in enumerate(laws):
        if by_difference[j] and (e.scheduled or e.loaded):
            raise InputError(f"element '{e.name}': the velocity of an algebraic node is not defined")
        if e.driven:
            entries = _entries(size, "I", len(currents))
            elongation[j] = sum(row for row, c in zip(entries, currents, strict=True) if e.name in c.elements)
        elif e.scheduled:
            column = len(currents) + logged.index(getattr(e, "channel", ""))
            elongation[j] = _entries(size, "I", 1, column)[0]


# ---------------------------------------------------------------------------------- the parts of an assembly

#: message for equations that are not finite
TOO_FAR_APART = "the model's parameters differ by too many orders of magnitude: its equations are not finite"

NO_MASS = 1e-10  # share of the largest singular value below which a direction carries no momentum or damping
NO_SHARE = 1e-9  # share of a direction in a row below which the direction is rounding
ROUNDING = 1e-12  # share of the largest number of its kind below which a number has cancelled
NO_HOLD = 1e-12  # share of the largest stiffness below which a stiffness holds nothing
UPRIGHT = 0.3  # share of the largest node of a space from which a node is a direction of the basis

Size = tuple[int, int, int, int, int]


def _widths(size: Size) -> tuple[int, ...]:
    states, moved, forces, currents, laws = size
    return states, moved, moved, moved, forces, currents, laws


@cache
def _spans(size: Size) -> Mapping[str, slice]:
    """Return the slices of the parts of the base vector."""
    ends = np.cumsum([0, *_widths(size)]).tolist()
    names = ("x", "r", "v", "alpha", "F", "I", "f")
    return MappingProxyType(
        {name: slice(begin, end) for name, begin, end in zip(names, ends[:-1], ends[1:], strict=True)}
    )


def _entries(size: Size, part: str, rows: int, start: int = 0) -> np.ndarray:
    """Return the entries from `start` of a part of the base vector, as rows over the base vector."""
    out = np.zeros((rows, sum(_widths(size))))
    out[np.arange(rows), _spans(size)[part].start + start + np.arange(rows)] = 1.0
    return out


def _hangs_on(row: np.ndarray, directions: np.ndarray) -> bool:
    return bool(np.abs(row @ directions).max(initial=0.0) > NO_SHARE)


@dataclass(frozen=True)
class _Matrices:
    """Inertia [kg], damping [N s/m] and stiffness [N/m] of all coordinates."""

    inertia: np.ndarray
    damping: np.ndarray
    stiffness: np.ndarray


def _matrices(network: Network, nodes: Coordinates, between: Sequence[el.Element]) -> _Matrices:
    inertia, damping, stiffness = (np.zeros((nodes.count, nodes.count)) for _ in range(3))
    for node, mass in network.carried.items():
        row = nodes.row(node)
        inertia += mass * np.outer(row, row)
    for e in between:
        row = nodes.incidence(e.between)
        k, c, b = e.linear()
        stiffness += k * np.outer(row, row)
        damping += c * np.outer(row, row)
        inertia += b * np.outer(row, row)
        if isinstance(e, el.TerminalInertia):
            node = e.between[0 if e.terminal == "first" else 1]
            inertia += e.mass * np.outer(row, nodes.row(node))
    return _Matrices(inertia, damping, stiffness)


@dataclass(frozen=True)
class _Ties:
    """Matrices (free, moved) that tie free nodes to moved nodes, including nodes seen from a frame (`frames`)."""

    frame: np.ndarray  # 1 for a free node seen from the frame of a moved node
    inertia: np.ndarray
    momentum: np.ndarray  # the inertia, for moved nodes of known velocity
    damping: np.ndarray
    stiffness: np.ndarray


def _ties(network: Network, nodes: Coordinates, matrices: _Matrices) -> _Ties:
    free, riding = len(nodes.free), frames(network)
    frame = np.zeros((free, len(nodes.moved)))
    for node, j in riding.items():
        if node in nodes.index:
            frame[nodes.index[node], j] = 1.0
    ties = []
    for m in (matrices.inertia, matrices.damping, matrices.stiffness):
        tie = m[:free, free:] + m[:free, :free] @ frame
        if riding:
            tie[np.abs(tie) < ROUNDING * np.abs(m).max(initial=0.0)] = 0.0
        ties.append(tie)
    told = np.array([MOTIONS.index(c.quantity) < 2 for c in network.moving], bool)
    return _Ties(frame, ties[0], ties[0] * told, ties[1], ties[2])


@dataclass(frozen=True)
class _Split:
    """Directions of the free nodes (free, .), and matrices (., free) from the forces on the free nodes.

    `inertial` directions carry momentum; the `massless` rest is partly damped, partly algebraic.
    `accelerates` and `yields` give the acceleration of the inertial and the rate of the damped directions per
    force. `left_algebraic` gives the equations without inertia and damping.
    """

    inertial: np.ndarray
    accelerates: np.ndarray
    massless: np.ndarray
    damped: np.ndarray
    yields: np.ndarray
    algebraic: np.ndarray
    left_algebraic: np.ndarray


def _split(matrices: _Matrices, ties: _Ties, nodes: Coordinates) -> _Split:
    """Return the directions of the free nodes; raise `InputError` for an inertia between a massless and a moved node."""
    free = len(nodes.free)
    inertia, damping = matrices.inertia[:free, :free], matrices.damping[:free, :free]
    left, values, right = np.linalg.svd(inertia) if free else (np.eye(0), np.zeros(0), np.eye(0))
    rank = int(np.sum(values > NO_MASS * values[0])) if free and values[0] > 0 else 0
    left_massless, massless = left[:, rank:], right[rank:].T
    if left_massless.size:
        carried = np.abs(left_massless.T @ ties.inertia).max(initial=0.0)
        if carried > NO_SHARE * np.abs(matrices.inertia).max():
            raise InputError("an inertia between a massless node and a moved node is not supported here")
    turn, strengths, turn_right = np.linalg.svd(left_massless.T @ damping @ massless)
    least = NO_MASS * max(np.abs(damping).max(initial=0.0), 1e-300)
    damped = int(np.sum(strengths > least)) if strengths.size else 0
    inertial, resisted = _upright(right[:rank].T), _upright(massless @ turn_right[:damped].T)
    pushed, dragged = _upright(left[:, :rank]), left_massless @ turn[:, :damped]
    return _Split(
        inertial=inertial,
        accelerates=np.linalg.solve(pushed.T @ inertia @ inertial, pushed.T),
        massless=massless,
        damped=resisted,
        yields=np.linalg.solve(dragged.T @ damping @ resisted, dragged.T),
        algebraic=massless @ turn_right[damped:].T,
        left_algebraic=left_massless @ turn[:, damped:],
    )


def _upright(directions: np.ndarray) -> np.ndarray:
    """Return another orthonormal basis (free, .) of the space of `directions` (free, .), which depends on the space alone.

    Singular vectors rotate near crossing singular values. The meaning of a state would then change with the
    tenth digit of a mass, and the state could not be kept during a fit of the mass. The basis consists of the
    projections of one node after another.
    """
    nodes, rank = directions.shape
    if rank == nodes:
        return np.eye(nodes)
    out, left = np.zeros((nodes, rank)), directions @ directions.T
    for k in range(rank):
        size = np.linalg.norm(left, axis=0)
        node = int(np.argmax(size > UPRIGHT * size.max()))
        out[:, k] = left[:, node] / size[node]
        left = left - np.outer(out[:, k], out[:, k] @ left)
    return out


@dataclass(frozen=True)
class _Pushes:
    """Forces besides inertia, damping and stiffness as rows over the base vector: on the nodes, and of each motor."""

    nodes: np.ndarray
    motors: dict[str, np.ndarray]


def _pushes(network: Network, nodes: Coordinates, laws: Sequence[el.Element], size: Size) -> _Pushes:
    """Return the forces on the nodes: forces push inwards, motors and laws (positive in tension) outwards."""
    at, width = _spans(size), sum(_widths(size))
    push = np.zeros((nodes.count, width))
    for j, channel in enumerate(c for c in network.inputs if c.quantity == "force"):
        push[:, at["F"].start + j] += nodes.row(str(channel.at))
    motors: dict[str, np.ndarray] = {}
    for e in network.elements:
        if isinstance(e, el.Motor):
            motors[e.name] = np.zeros(width)
            for j, channel in enumerate(c for c in network.inputs if c.quantity == "current"):
                if channel.element == e.name:
                    motors[e.name][at["I"].start + j] = e.thrust_constant * e.ratio
            push -= np.outer(nodes.incidence(e.between), motors[e.name])
    for j, e in enumerate(laws):
        push[:, at["f"].start + j] -= nodes.incidence(e.between)
    return _Pushes(push, motors)


@dataclass(frozen=True)
class _Motion:
    """Rows over the base vector: rates of the states; position, velocity and acceleration of all nodes.

    The velocity excludes the algebraic directions. `massless` and `algebraic` are directions of all nodes.
    """

    rate: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray
    massless: np.ndarray
    algebraic: np.ndarray


def _motion(
    nodes: Coordinates, matrices: _Matrices, ties: _Ties, split: _Split, push: np.ndarray, size: Size
) -> _Motion:
    """Return the motion of all nodes; raise `InputError` for a massless node without support."""
    (free, moved), s = ties.frame.shape, split
    inertias, dampings = len(s.accelerates), len(s.yields)
    r, v, alpha = (_entries(size, part, moved) for part in ("r", "v", "alpha"))
    C, K = matrices.damping[:free, :free], matrices.stiffness[:free, :free]
    # states: displacement and momentum of the inertial directions, displacement of the damped directions
    inertial, momentum = _entries(size, "x", inertias), _entries(size, "x", inertias, inertias)
    damped = _entries(size, "x", dampings, 2 * inertias)
    inertial_rate = momentum - s.accelerates @ ties.momentum @ v
    known = (
        C @ s.inertial @ inertial_rate
        + K @ (s.inertial @ inertial + s.damped @ damped)
        + ties.damping @ v
        + ties.stiffness @ r
        - push[:free]
    )
    algebraic = _algebraic(K, split, known, nodes.free)
    known_all = known + K @ s.algebraic @ algebraic
    damped_rate = -s.yields @ known_all
    resisted = known_all + C @ s.damped @ damped_rate + ties.inertia @ alpha
    inertial_acceleration = -s.accelerates @ resisted
    momentum_rate = inertial_acceleration + s.accelerates @ ties.momentum @ alpha
    position = s.inertial @ inertial + s.damped @ damped + s.algebraic @ algebraic
    velocity = s.inertial @ inertial_rate + s.damped @ damped_rate
    still = np.zeros((moved, s.massless.shape[1]))
    return _Motion(
        rate=np.vstack([inertial_rate, momentum_rate, damped_rate]),
        position=np.vstack([position + ties.frame @ r, r]),
        velocity=np.vstack([velocity + ties.frame @ v, v]),
        acceleration=np.vstack([s.inertial @ inertial_acceleration + ties.frame @ alpha, alpha]),
        massless=np.vstack([s.massless, still]),
        algebraic=np.vstack([s.algebraic, still[:, : s.algebraic.shape[1]]]),
    )


def _algebraic(K: np.ndarray, split: _Split, known: np.ndarray, free: Sequence[str]) -> np.ndarray:
    """Return displacements along the algebraic directions, in which springs alone balance the `known` forces."""
    left = split.left_algebraic.T
    held = left @ K @ split.algebraic
    if not held.size:
        return np.zeros((split.algebraic.shape[1], known.shape[1]))
    scale = np.abs(K).max()
    if scale == 0.0 or np.linalg.svd(held, compute_uv=False)[-1] < NO_HOLD * scale:
        direction = split.algebraic @ np.linalg.svd(held)[2][-1]
        names = ", ".join(f"'{n}'" for n, share in zip(free, direction, strict=True) if abs(share) > 0.1)
        raise InputError(
            f"the massless part is singular: nothing holds {names} (add a spring, damper or mass)"
        )
    return -np.linalg.solve(held, left @ known)


@dataclass(frozen=True)
class _Outputs:
    """Rows of channels over the base vector."""

    network: Network
    nodes: Coordinates
    laws: Sequence[el.Element]
    motors: Mapping[str, np.ndarray]
    motion: _Motion
    size: Size

    def row(self, channel: Channel) -> tuple[np.ndarray, bool]:
        """Return the row of a channel, and whether the channel is the difference quotient of the row."""
        where = f"output '{channel.name}'"
        total = np.zeros(sum(_widths(self.size)))
        if channel.element is not None:
            for name in channel.elements:
                total = total + self.force_of(self.network.element(name), where)
            return total, False
        if channel.quantity != "force":
            pair = channel.between or (str(channel.at), GROUND)
            return self.of(self.nodes.incidence(pair), channel.quantity, where)
        return self.mover(str(channel.at), where), False

    def mover(self, node: str, where: str) -> np.ndarray:
        """Return the force that moves a moved node, as measured by a load cell between drive and node."""
        total, at = np.zeros(sum(_widths(self.size))), self.nodes.index[node]
        for e in self.network.elements:
            sign = self.nodes.incidence(e.between)[at] if e.place == "between" else 0.0
            if sign:
                total = total + sign * self.force_of(e, where)
        total = total + self.network.masses.get(node, 0.0) * self.motion.acceleration[at]
        if not self.nodes.dependent:
            return total
        for other, mass in self.network.carried.items():  # masses of bodies and levers tied to the node
            row = self.nodes.row(other)
            if row[at] and not (other == node and node in self.network.masses):
                total = total + row[at] * mass * (row @ self.motion.acceleration)
        for j, c in enumerate(c for c in self.network.inputs if c.quantity == "force"):
            share = self.nodes.row(str(c.at))[at]
            if share and c.at != node:
                total = total - share * _entries(self.size, "F", 1, j)[0]
        return total

    def of(self, row: np.ndarray, quantity: str, where: str) -> tuple[np.ndarray, bool]:
        """Return displacement, velocity or acceleration of a combination of nodes."""
        if quantity == "displacement":
            return row @ self.motion.position, False
        if quantity == "velocity":
            if _hangs_on(row, self.motion.algebraic):
                return row @ self.motion.position, True
            return row @ self.motion.velocity, False
        if _hangs_on(row, self.motion.massless):
            raise InputError(f"{where}: the acceleration of a massless node is not defined")
        return row @ self.motion.acceleration, False

    def force_of(self, e: el.Element, where: str) -> np.ndarray:
        """Return the force of an element, positive in tension."""
        row = self.nodes.incidence(e.between)
        if e.parts():
            return np.asarray(
                sum(_entries(self.size, "f", 1, self.laws.index(part))[0] for part in e.parts())
            )
        if isinstance(e, el.Motor):
            return self.motors[e.name]
        if isinstance(e, el.TerminalInertia):
            node = e.between[0 if e.terminal == "first" else 1]
            return e.mass * self.of(self.nodes.incidence((node, GROUND)), "acceleration", where)[0]
        k, c, b = e.linear()
        out = k * (row @ self.motion.position)
        if c:
            rate, difference = self.of(row, "velocity", where)
            if difference:
                raise InputError(f"{where}: the velocity of an algebraic node is not defined")
            out = out + c * rate
        return out + b * self.of(row, "acceleration", where)[0] if b else out
