"""Cuts of a network at a node of measured motion: the motion becomes an input, and the part behind the node is removed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from ..._common.errors import InputError, shown
from ._model import GROUND, MOTIONS, Channel, Network


def cut(network: Network, node: str) -> Network:
    """Return the part of a model on the far side of a node from the moved nodes, driven by the measured motion of the node.

    The removed part consists of all nodes that are connected with a moved node only. A car cut at its wheel
    keeps everything above the wheel; tyre and road, and their outputs, are removed. The output that measured
    the node becomes an input, and the mass of the node has no effect.

    Args:
        network: The whole model.
        node: Name of the node.

    Raises:
        InputError: No output measures the motion of the node, or no moved node lies behind the node.
    """
    seen = _motions_at(network, node)
    drive = min(seen, key=lambda c: MOTIONS.index(c.quantity))
    behind = _behind(network, node)
    between = [
        e
        for e in network.elements
        if e.place == "between" and _stays(e.where, node, behind)
    ]
    bodies = tuple(b for b in network.bodies if b.name not in behind)
    levers = tuple(v for v in network.levers if _stays(v.between, node, behind))
    alive = set(network.masses) - set(behind)
    alive = alive.union(
        *(e.where for e in between),
        *(b.nodes for b in bodies),
        *(v.between for v in levers),
    )
    names = {e.name for e in between}
    masses = {n: m for n, m in network.masses.items() if n in alive - {node}}
    if not masses and not between and not bodies:
        raise InputError(f"cut: nothing is left on this side of '{node}'")
    inputs = [c for c in network.inputs if _heard(c, alive - {node}, names)]
    moved = Channel(drive.name, drive.quantity, drive.unit, at=node, axis=drive.axis)
    fixed = {node, GROUND, *(str(c.at) for c in inputs if c.quantity in MOTIONS)}
    others = [c for c in network.outputs if c is not drive and _heard(c, alive, names)]
    outputs = [
        c
        for c in others
        if not _idle(c, fixed) and not _is_foreign_force(c, fixed - {node})
    ]
    places = names | {c.name for c in outputs}  # of effects at elements and channels
    kept = [
        e
        for e in network.elements
        if (e.name in names if e.place == "between" else e.where[0] in places)
    ]
    if not outputs:
        raise InputError(
            f"cut: no output is left to compare with on this side of '{node}'"
        )
    part = replace(
        network,
        name=f"{network.name} (cut at {node})",
        masses=masses,
        turning=network.turning & set(masses),
        bodies=bodies,
        levers=levers,
        elements=tuple(kept),
        inputs=(moved, *inputs),
        outputs=tuple(outputs),
        uncertainty={},
    )
    return part.with_uncertainty(network.uncertainty)


def _motions_at(network: Network, node: str) -> list[Channel]:
    """Return the outputs that measure the motion of a node at which a model can be cut."""
    if node not in network.nodes:
        raise InputError(
            f"cut: no node {shown(node)}; there are {', '.join(network.nodes)}"
        )
    body = next((b.name for b in network.bodies if node in b.nodes), None)
    if body is not None:
        raise InputError(
            f"cut: '{node}' is part of body '{body}', and its motion is not that of the whole body: cut at another node"
        )
    if node in network.moved_nodes:
        raise InputError(
            f"cut: '{node}' is moved by an input already: there is nothing to leave out"
        )
    seen = [c for c in network.outputs if c.at == node and c.quantity in MOTIONS]
    if not seen:
        raise InputError(
            f"cut: no output measures the motion of '{node}'; its accelerometer would be an output with "
            f'"quantity": "acceleration", "at": "{node}"'
        )
    return seen


def _is_foreign_force(c: Channel, fixed: set[str]) -> bool:
    """Return whether an output is the force at a node that no input moves any more."""
    return c.quantity == "force" and c.at is not None and c.at not in fixed


def cut_nodes(network: Network) -> list[str]:
    """Return the nodes at which a model can be cut."""
    places = []
    for node in dict.fromkeys(
        c.at for c in network.outputs if c.at is not None and c.quantity in MOTIONS
    ):
        try:
            cut(network, node)
        except InputError:
            continue
        places.append(node)
    return places


def without(network: Network, name: str) -> str:
    """Return advice for an input that was not measured, as the end of a message; '' without advice."""
    if any(c.name == name and c.quantity == "condition" for c in network.inputs):
        return "; where nobody logged it, leave the input and the elements that read it out of the model"
    road = next(
        (c for c in network.moving if c.name == name and c.quantity == "displacement"),
        None,
    )
    if road is None:
        return ""
    places = cut_nodes(network)
    if not places:
        return "; where nobody measured it, isd-gym diagnose --cut NODE wants an output that sees the node's motion"
    return f"; where nobody measured it, isd-gym diagnose --cut {places[0]} compares what it moves"


def rejoin(whole: Network, part: Network) -> Network:
    """Return the whole model with the results of a diagnosis of a part: new parameters and added elements.

    Args:
        whole: Model before the cut.
        part: Result of `cut`, changed by the diagnosis.
    """
    node = next((n for n in part.moved_nodes if n not in whole.moved_nodes), None)
    behind = _behind(whole, node) if node is not None else set()
    away = [
        e
        for e in whole.elements
        if e.place == "between" and not _stays(e.where, node or "", behind)
    ]
    names = {c.name for c in (*part.outputs,)}
    away += [
        e for e in whole.elements if e.place == "channel" and e.where[0] not in names
    ]
    own = {e.name for e in part.elements}
    elements = (*part.elements, *(e for e in away if e.name not in own))
    cells = {c.name: c for c in part.outputs}
    bodies = {b.name: b for b in part.bodies}
    levers = {v.name: v for v in part.levers}
    joined = replace(
        whole,
        masses={n: part.masses.get(n, m) for n, m in whole.masses.items()},
        bodies=tuple(bodies.get(b.name, b) for b in whole.bodies),
        levers=tuple(levers.get(v.name, v) for v in whole.levers),
        elements=elements,
        outputs=tuple(cells.get(c.name, c) for c in whole.outputs),
        description=part.description,
        uncertainty={},
    )
    return joined.with_uncertainty({**whole.uncertainty, **part.uncertainty})


def _behind(network: Network, node: str) -> set[str]:
    """Return the nodes that, without `node`, are connected with a moved node; raise `InputError` without any.

    If all nodes are, as in a half car cut at one wheel, the part with the largest mass stays.
    """
    links: dict[str, set[str]] = {n: set() for n in network.nodes}
    pairs = [
        e.where
        for e in network.elements
        if e.place == "between" and GROUND not in e.where
    ]
    pairs += [v.between for v in network.levers] + [
        (b.name, n) for b in network.bodies for n in b.nodes[1:]
    ]
    for first, second in pairs:
        if node not in (first, second):
            links[first].add(second)
            links[second].add(first)
    parts: list[set[str]] = []
    for moved in network.moved_nodes:
        if moved == node or any(moved in part for part in parts):
            continue
        part, frontier = set(), [moved]
        while frontier:
            here = frontier.pop()
            if here not in part:
                part.add(here)
                frontier += links[here]
        parts.append(part)
    if not parts:
        raise InputError(f"cut: no moved node is behind '{node}'")
    out = set().union(*parts)
    if out >= set(network.nodes) - {node} and len(parts) > 1:
        out -= max(
            parts,
            key=lambda part: sum(m for n, m in network.carried.items() if n in part),
        )
    if out >= set(network.nodes) - {node}:
        raise InputError(
            f"cut: the other nodes are all connected without '{node}': nothing would be left"
        )
    return out


def _stays(where: Sequence[str], node: str, behind: set[str]) -> bool:
    """Return whether an element or a lever between the nodes `where` stays."""
    return not set(where) & behind and set(where) != {node, GROUND}


def _heard(c: Channel, nodes: set[str], names: set[str]) -> bool:
    """Return whether all nodes and elements of a channel stay."""
    about = {n for n in (c.at, *(c.between or ())) if n is not None and n != GROUND}
    return about <= nodes and set(c.elements) <= names


def _idle(c: Channel, fixed: set[str]) -> bool:
    """Return whether an output measures only the motion of inputs."""
    ends = {c.at, GROUND} if c.at is not None else set(c.between or ())
    return c.quantity in MOTIONS and ends <= fixed
