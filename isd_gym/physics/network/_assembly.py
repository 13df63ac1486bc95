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
from ._coordinates import Coordinates, coordinates
from ._model import GROUND, MOTIONS, Channel, Network
from .frames import complete, frames, unknown

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence


@dataclass(frozen=True, eq=False)
class Assembly:
    """Equations of motion of a network; the force f of every law is an input of the linear part.

    The columns of all matrices are the base vector (x, r, v, alpha, F, I, f): states, displacement [m],
    velocity and acceleration of the moved nodes, force inputs [N], currents [A], law forces [N].
    """

    network: Network  # the model
    channels: tuple[Channel, ...]  # channels of the outputs
    # numbers of states, moved nodes, force inputs, currents and laws
    size: tuple[int, int, int, int, int]
    laws: tuple[el.Element, ...]  # elements with a law
    rate: np.ndarray  # time derivative of the states, rows (states, columns)
    elongation: np.ndarray  # elongation of each law [m], rows (laws, columns)
    # rate of elongation of each law [m/s], rows (laws, columns)
    elongation_rate: np.ndarray
    #: whether each law acts on an algebraic node, whose velocity is the difference of its positions
    by_difference: tuple[bool, ...]
    outputs: np.ndarray  # rows (channels, columns)
    # whether each output is on an algebraic node
    outputs_by_difference: tuple[bool, ...]
    # positions of the nodes, moved nodes last, rows (nodes, columns)
    position: np.ndarray
    # velocities of the nodes, moved nodes last, rows (nodes, columns)
    velocity: np.ndarray

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
    return _assemble([network], extra)[0] if extra else network._assembly


def assemble_all(
    networks: Sequence[Network], extra: Sequence[Channel] = ()
) -> list[Assembly]:
    """Return the equations of motion of several networks; networks that differ in values alone are computed side by side.

    Args:
        networks: The models.
        extra: Further output channels, after those of the models.

    Raises:
        InputError: As `assemble`.
    """
    out: dict[int, Assembly] = {}
    groups: dict[tuple[object, ...], list[int]] = {}
    for k, network in enumerate(networks):
        if not extra and "_assembly" in network.__dict__:
            out[k] = network._assembly
        else:
            groups.setdefault(_topology(network), []).append(k)
    for members in groups.values():
        found = _assemble([networks[k] for k in members], extra)
        out |= dict(zip(members, found, strict=True))
    if not extra:
        for k, network in enumerate(networks):
            network.__dict__["_assembly"] = out[k]
    return [out[k] for k in range(len(networks))]


def _topology(network: Network) -> tuple[object, ...]:
    """Return the properties that networks must share for an assembly side by side."""
    elements = []
    for e in network.elements:
        if e.place == "between":
            words = (getattr(e, name, "") for name in ("terminal", "load", "channel"))
            elements.append(
                (
                    type(e),
                    e.name,
                    e.where,
                    *words,
                    *map(bool, e.linear()),
                    len(e.parts()),
                )
            )
    masses = tuple((node, mass > 0) for node, mass in network.carried.items())
    ties = (network.bodies, network.levers, network.turning)
    return (*elements, *masses, *ties, network.inputs, network.outputs)


def _assemble(networks: Sequence[Network], extra: Sequence[Channel]) -> list[Assembly]:
    """Return the assemblies of networks that differ in values alone. Directions and signs are those of the first network."""
    network = networks[0]
    nodes = coordinates(network)
    lanes = [[e for e in n.elements if e.place == "between"] for n in networks]
    matrices = _matrices(networks, nodes, lanes)
    ties = _ties(network, nodes, matrices)
    split = _split(matrices, ties, nodes)
    laws = [tuple(part for e in between for part in e.parts()) for between in lanes]
    counts = [
        sum(c.quantity == "force" for c in network.inputs),
        sum(c.quantity in HELD for c in network.inputs),
    ]
    states = 2 * split.inertial.shape[1] + split.damped.shape[1]
    size = (states, len(nodes.moved), counts[0], counts[1], len(laws[0]))
    pushes = _pushes(networks, nodes, laws[0], size)
    motion = _motion(nodes, matrices, ties, split, pushes.nodes, size)
    law_rows = np.array([nodes.incidence(e.between) for e in laws[0]]).reshape(
        len(laws[0]), nodes.count
    )
    outputs = _Outputs(networks, nodes, laws[0], pushes.motors, motion, size)
    channels = (*network.outputs, *extra)
    found = [outputs.row(channel) for channel in channels]
    rows = [row for row, _ in found]
    elongation = law_rows @ motion.position
    elongation_rate = law_rows @ motion.velocity
    for j, e in enumerate(laws[0]):
        if e.loaded:  # the kernel passes the load instead of the elongation
            elongation[:, j] = outputs.force_of(
                getattr(e, "load", ""), f"element '{e.name}'"
            )
    if any(c.quantity != "displacement" for c in network.moving):
        rows = _complete_motions(
            network, laws[0], motion, elongation, elongation_rate, rows, size
        )
    if not all(
        np.isfinite(m).all()
        for m in (motion.rate, motion.position, motion.velocity, *rows)
    ):
        raise InputError(TOO_FAR_APART)
    algebraic = np.abs(nodes.of_nodes(motion.algebraic)).sum(axis=1) > NO_SHARE
    by_difference = tuple(_hangs_on(row, motion.algebraic) for row in law_rows)
    _schedule(network, laws[0], elongation, by_difference, size)
    shape = (len(networks), len(rows), sum(_widths(size)))
    seen = np.stack(rows, axis=1) if rows else np.zeros(shape)
    position = nodes.of_nodes(motion.position)
    velocity = np.where(algebraic[:, None], 0.0, nodes.of_nodes(motion.velocity))
    by_output = tuple(difference for _, difference in found)
    return [
        Assembly(
            network=networks[k],
            channels=channels,
            size=size,
            laws=laws[k],
            rate=motion.rate[k],
            elongation=elongation[k],
            elongation_rate=elongation_rate[k],
            by_difference=by_difference,
            outputs=seen[k],
            outputs_by_difference=by_output,
            position=position[k],
            velocity=velocity[k],
        )
        for k in range(len(networks))
    ]


def _complete_motions(
    network: Network,
    laws: Sequence[el.Element],
    motion: _Motion,
    elongation: np.ndarray,
    elongation_rate: np.ndarray,
    rows: list[np.ndarray],
    size: Size,
) -> list[np.ndarray]:
    """Return the rows of the outputs without rounding, after a check that nothing needs a motion that no input tells."""
    lacking = unknown(network, _spans(size))
    places = [column for column, what in lacking if what == "displacement"]
    for j, e in enumerate(laws):
        if e.plane == "rate" and GROUND in e.where:
            elongation[:, j, places] = 0.0
    rows = [_without_rounding(row) for row in rows]
    for k in range(len(elongation)):
        seen = [row[k] for row in rows]
        complete(
            network, lacking, motion.rate[k], elongation[k], elongation_rate[k], seen
        )
    return rows


def _without_rounding(rows: np.ndarray) -> np.ndarray:
    """Return rows (networks, columns) without numbers that are the rounding of the largest one."""
    largest = np.abs(rows).max(axis=-1, keepdims=True, initial=0.0)
    return np.where(np.abs(rows) < ROUNDING * largest, 0.0, rows)


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
            raise InputError(
                f"element '{e.name}': the velocity of an algebraic node is not defined"
            )
        if e.driven:
            entries = _entries(size, "I", len(currents))
            elongation[:, j] = sum(
                row
                for row, c in zip(entries, currents, strict=True)
                if e.name in c.elements
            )
        elif e.scheduled:
            column = len(currents) + logged.index(getattr(e, "channel", ""))
            elongation[:, j] = _entries(size, "I", 1, column)[0]


# ---------------------------------------------------------------------------------- the parts of an assembly

#: message for equations that are not finite
TOO_FAR_APART = "the model's parameters differ by too many orders of magnitude: its equations are not finite"

NO_MASS = 1e-10  # share of the largest singular value below which a direction carries no momentum or damping
NO_SHARE = 1e-9  # share of a direction in a row below which the direction is rounding
# share of the largest number of its kind below which a number has cancelled
ROUNDING = 1e-12
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
        {
            name: slice(begin, end)
            for name, begin, end in zip(names, ends[:-1], ends[1:], strict=True)
        }
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
    """Inertia [kg], damping [N s/m] and stiffness [N/m] of all coordinates (networks, coordinates, coordinates)."""

    inertia: np.ndarray
    damping: np.ndarray
    stiffness: np.ndarray


def _matrices(
    networks: Sequence[Network],
    nodes: Coordinates,
    lanes: Sequence[Sequence[el.Element]],
) -> _Matrices:
    shape = (len(networks), nodes.count, nodes.count)
    inertia = np.zeros(shape)
    damping = np.zeros(shape)
    stiffness = np.zeros(shape)
    carried = [n.carried for n in networks]
    for node in carried[0]:
        row = nodes.row(node)
        masses = np.array([each[node] for each in carried])
        inertia += masses[:, None, None] * np.outer(row, row)
    for several in zip(*lanes, strict=True):
        first = several[0]
        row = nodes.incidence(first.between)
        square = np.outer(row, row)
        values = np.array([e.linear() for e in several])
        for matrix, column in zip((stiffness, damping, inertia), values.T, strict=True):
            if column.any():
                matrix += column[:, None, None] * square
        if isinstance(first, el.TerminalInertia):
            node = first.between[0 if first.terminal == "first" else 1]
            inertia += _values(several, "mass")[:, None, None] * np.outer(
                row, nodes.row(node)
            )
    return _Matrices(inertia, damping, stiffness)


def _values(elements: Sequence[el.Element], name: str) -> np.ndarray:
    """Return a parameter of an element in each network (networks,)."""
    return np.array([getattr(e, name) for e in elements])


@dataclass(frozen=True)
class _Ties:
    """Matrices (networks, free, moved) that tie free nodes to moved nodes, including nodes seen from a frame (`frames`)."""

    # 1 for a free node seen from the frame of a moved node (free, moved)
    frame: np.ndarray
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
        tie = m[:, :free, free:] + m[:, :free, :free] @ frame
        if riding:
            largest = np.abs(m).max(axis=(1, 2), keepdims=True, initial=0.0)
            tie[np.abs(tie) < ROUNDING * largest] = 0.0
        ties.append(tie)
    told = np.array([MOTIONS.index(c.quantity) < 2 for c in network.moving], bool)
    return _Ties(frame, ties[0], ties[0] * told, ties[1], ties[2])


@dataclass(frozen=True)
class _Split:
    """Directions of the free nodes (free, .), and matrices (., free) from the forces on the free nodes.

    `inertial` directions carry momentum; the `massless` rest is partly damped, partly algebraic.
    `accelerates` and `yields` (networks, ., free) give the acceleration of the inertial and the rate of the damped
    directions per force. `left_algebraic` gives the equations without inertia and damping.
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
    inertias = matrices.inertia[:, :free, :free]
    dampings = matrices.damping[:, :free, :free]
    inertia, damping = inertias[0], dampings[0]
    left, values, right = (
        np.linalg.svd(inertia) if free else (np.eye(0), np.zeros(0), np.eye(0))
    )
    rank = int(np.sum(values > NO_MASS * values[0])) if free and values[0] > 0 else 0
    left_massless = left[:, rank:]
    massless = right[rank:].T
    if left_massless.size:
        carried = np.abs(left_massless.T @ ties.inertia).max(axis=(1, 2), initial=0.0)
        if np.any(carried > NO_SHARE * np.abs(matrices.inertia).max(axis=(1, 2))):
            raise InputError(
                "an inertia between a massless node and a moved node is not supported here"
            )
    turn, strengths, turn_right = np.linalg.svd(left_massless.T @ damping @ massless)
    least = NO_MASS * max(np.abs(damping).max(initial=0.0), 1e-300)
    damped = int(np.sum(strengths > least)) if strengths.size else 0
    inertial = _upright(right[:rank].T)
    resisted = _upright(massless @ turn_right[:damped].T)
    pushed = _upright(left[:, :rank])
    dragged = left_massless @ turn[:, :damped]
    # [None]: older NumPy takes a right side with one axis fewer for a vector
    return _Split(
        inertial=inertial,
        accelerates=np.linalg.solve(pushed.T @ inertias @ inertial, pushed.T[None]),
        massless=massless,
        damped=resisted,
        yields=np.linalg.solve(dragged.T @ dampings @ resisted, dragged.T[None]),
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
    out = np.zeros((nodes, rank))
    left = directions @ directions.T
    for k in range(rank):
        size = np.linalg.norm(left, axis=0)
        node = int(np.argmax(size > UPRIGHT * size.max()))
        out[:, k] = left[:, node] / size[node]
        left = left - np.outer(out[:, k], out[:, k] @ left)
    return out


@dataclass(frozen=True)
class _Pushes:
    """Forces besides inertia, damping and stiffness as rows over the base vector: on the nodes (networks, nodes,
    columns), and of each motor (networks, columns)."""

    nodes: np.ndarray
    motors: dict[str, np.ndarray]


def _pushes(
    networks: Sequence[Network],
    nodes: Coordinates,
    laws: Sequence[el.Element],
    size: Size,
) -> _Pushes:
    """Return the forces on the nodes: forces push inwards, motors and laws (positive in tension) outwards."""
    network = networks[0]
    at = _spans(size)
    width = sum(_widths(size))
    push = np.zeros((len(networks), nodes.count, width))
    for j, channel in enumerate(c for c in network.inputs if c.quantity == "force"):
        push[:, :, at["F"].start + j] += nodes.row(str(channel.at))
    motors: dict[str, np.ndarray] = {}
    for e in network.elements:
        if isinstance(e, el.Motor):
            several = [n.element(e.name) for n in networks]
            motor = motors[e.name] = np.zeros((len(networks), width))
            for j, channel in enumerate(
                c for c in network.inputs if c.quantity == "current"
            ):
                if channel.element == e.name:
                    motor[:, at["I"].start + j] = _values(
                        several, "thrust_constant"
                    ) * _values(several, "ratio")
            push -= nodes.incidence(e.between)[:, None] * motor[:, None, :]
    for j, e in enumerate(laws):
        push[:, :, at["f"].start + j] -= nodes.incidence(e.between)
    return _Pushes(push, motors)


@dataclass(frozen=True)
class _Motion:
    """Rows over the base vector (networks, ., columns): rates of the states; position, velocity and acceleration of all nodes.

    The velocity excludes the algebraic directions. `massless` and `algebraic` are directions of all nodes.
    """

    rate: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray
    massless: np.ndarray
    algebraic: np.ndarray


def _motion(
    nodes: Coordinates,
    matrices: _Matrices,
    ties: _Ties,
    split: _Split,
    push: np.ndarray,
    size: Size,
) -> _Motion:
    """Return the motion of all nodes; raise `InputError` for a massless node without support."""
    (free, moved), s = ties.frame.shape, split
    inertias = s.inertial.shape[1]
    dampings = s.damped.shape[1]
    r, v, alpha = (_entries(size, part, moved) for part in ("r", "v", "alpha"))
    C = matrices.damping[:, :free, :free]
    K = matrices.stiffness[:, :free, :free]
    # states: displacement and momentum of the inertial directions, displacement of the damped directions
    inertial = _entries(size, "x", inertias)
    momentum = _entries(size, "x", inertias, inertias)
    damped = _entries(size, "x", dampings, 2 * inertias)
    inertial_rate = momentum - s.accelerates @ ties.momentum @ v
    known = (
        C @ s.inertial @ inertial_rate
        + K @ (s.inertial @ inertial + s.damped @ damped)
        + ties.damping @ v
        + ties.stiffness @ r
        - push[:, :free]
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
        rate=np.concatenate([inertial_rate, momentum_rate, damped_rate], axis=1),
        position=_above(position + ties.frame @ r, r),
        velocity=_above(velocity + ties.frame @ v, v),
        acceleration=_above(
            s.inertial @ inertial_acceleration + ties.frame @ alpha, alpha
        ),
        massless=np.vstack([s.massless, still]),
        algebraic=np.vstack([s.algebraic, still[:, : s.algebraic.shape[1]]]),
    )


def _above(rows: np.ndarray, shared: np.ndarray) -> np.ndarray:
    """Return the rows of each network (networks, ., columns), followed by rows that all networks share."""
    return np.concatenate(
        [rows, np.broadcast_to(shared, (len(rows), *shared.shape))], axis=1
    )


def _algebraic(
    K: np.ndarray, split: _Split, known: np.ndarray, free: Sequence[str]
) -> np.ndarray:
    """Return displacements along the algebraic directions, in which springs alone balance the `known` forces."""
    left = split.left_algebraic.T
    held = left @ K @ split.algebraic
    if not held.size:
        return np.zeros((len(known), split.algebraic.shape[1], known.shape[2]))
    scale = np.abs(K).max(axis=(1, 2))
    loose = (scale == 0.0) | (
        np.linalg.svd(held, compute_uv=False)[:, -1] < NO_HOLD * scale
    )
    if loose.any():
        direction = split.algebraic @ np.linalg.svd(held[int(np.argmax(loose))])[2][-1]
        names = ", ".join(
            f"'{n}'"
            for n, share in zip(free, direction, strict=True)
            if abs(share) > 0.1
        )
        raise InputError(
            f"the massless part is singular: nothing holds {names} (add a spring, damper or mass)"
        )
    return -np.linalg.solve(held, left @ known)


@dataclass(frozen=True)
class _Outputs:
    """Rows of channels over the base vector (networks, columns)."""

    networks: Sequence[Network]
    nodes: Coordinates
    laws: Sequence[el.Element]
    motors: Mapping[str, np.ndarray]
    motion: _Motion
    size: Size

    def nothing(self) -> np.ndarray:
        """Return rows of zeros."""
        return np.zeros((len(self.networks), sum(_widths(self.size))))

    def row(self, channel: Channel) -> tuple[np.ndarray, bool]:
        """Return the row of a channel, and whether the channel is the difference quotient of the row."""
        where = f"output '{channel.name}'"
        if channel.element is not None:
            total = self.nothing()
            for name in channel.elements:
                total = total + self.force_of(name, where)
            return total, False
        if channel.quantity != "force":
            pair = channel.between or (str(channel.at), GROUND)
            return self.of(self.nodes.incidence(pair), channel.quantity, where)
        return self.mover(str(channel.at), where), False

    def mover(self, node: str, where: str) -> np.ndarray:
        """Return the force that moves a moved node, as measured by a load cell between drive and node."""
        total = self.nothing()
        at = self.nodes.index[node]
        network = self.networks[0]
        for e in network.elements:
            sign = self.nodes.incidence(e.between)[at] if e.place == "between" else 0.0
            if sign:
                total = total + sign * self.force_of(e.name, where)
        masses = np.array([n.masses.get(node, 0.0) for n in self.networks])
        total = total + masses[:, None] * self.motion.acceleration[:, at]
        if not self.nodes.dependent:
            return total
        carried = [n.carried for n in self.networks]
        for other in carried[0]:  # masses of bodies and levers tied to the node
            row = self.nodes.row(other)
            if row[at] and not (other == node and node in network.masses):
                share = row[at] * np.array([each[other] for each in carried])
                total = total + share[:, None] * (row @ self.motion.acceleration)
        for j, c in enumerate(c for c in network.inputs if c.quantity == "force"):
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
            raise InputError(
                f"{where}: the acceleration of a massless node is not defined"
            )
        return row @ self.motion.acceleration, False

    def force_of(self, name: str, where: str) -> np.ndarray:
        """Return the force of an element, positive in tension."""
        several = [n.element(name) for n in self.networks]
        e = several[0]
        row = self.nodes.incidence(e.between)
        if e.parts():
            force = sum(
                _entries(self.size, "f", 1, self.laws.index(part))[0]
                for part in e.parts()
            )
            return self.nothing() + force
        if isinstance(e, el.Motor):
            return self.motors[e.name]
        if isinstance(e, el.TerminalInertia):
            node = e.between[0 if e.terminal == "first" else 1]
            acceleration = self.of(
                self.nodes.incidence((node, GROUND)), "acceleration", where
            )[0]
            return _values(several, "mass")[:, None] * acceleration
        k, c, b = np.array([e.linear() for e in several]).T[:, :, None]
        out = k * (row @ self.motion.position)
        if c.any():
            rate, difference = self.of(row, "velocity", where)
            if difference:
                raise InputError(
                    f"{where}: the velocity of an algebraic node is not defined"
                )
            out = out + c * rate
        return out + b * self.of(row, "acceleration", where)[0] if b.any() else out
