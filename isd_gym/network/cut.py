"""A network cut at a node whose motion was measured: that drives what is tied to it, and what lies behind is left out."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from ..errors import InputError, shown
from .model import GROUND, MOTIONS, Channel, Network

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence


def cut(network: Network, node: str) -> Network:
    """What lies on this side of a node, moved by the node's own measured motion.

    Behind it lies all that hangs on a moved node and on nothing else: a car cut at its wheel is what stands above the wheel, and
    tyre and road, with what was measured of them, are left out. The output that saw the node is the input now; its mass acts on
    nothing any more. network: the whole model; node: its name. Raises `InputError` with one line where no output sees the
    motion of the node, or where nothing that moves lies behind it.
    """
    if node not in network.nodes:
        raise InputError(f"cut: no node {shown(node)}; there are {', '.join(network.nodes)}")
    body = next((b.name for b in network.bodies if node in b.nodes), None)
    if body is not None:
        raise InputError(
            f"cut: '{node}' is part of body '{body}', and its motion is not that of the whole body: cut at another node"
        )
    if node in network.moved_nodes:
        raise InputError(f"cut: '{node}' is moved by an input already: there is nothing to leave out")
    seen = [c for c in network.outputs if c.at == node and c.quantity in MOTIONS]
    if not seen:
        raise InputError(
            f"cut: no output measures the motion of '{node}'; its accelerometer would be an output with "
            f'"quantity": "acceleration", "at": "{node}"'
        )
    drive = min(seen, key=lambda c: MOTIONS.index(c.quantity))
    behind = _behind(network, node)
    kept = [e for e in network.elements if e.place == "between" and _stays(e.where, node, behind)]
    bodies = tuple(b for b in network.bodies if b.name not in behind)
    levers = tuple(v for v in network.levers if _stays(v.between, node, behind))
    alive = {n for e in kept for n in e.where} | {n for n in network.masses if n not in behind}
    alive |= {n for b in bodies for n in b.nodes} | {n for v in levers for n in v.between}
    names = {e.name for e in kept}
    masses = {n: m for n, m in network.masses.items() if n in alive and n != node}
    if not masses and not kept and not bodies:
        raise InputError(f"cut: nothing is left on this side of '{node}'")
    inputs = [c for c in network.inputs if _heard(c, alive - {node}, names)]
    moved = Channel(drive.name, drive.quantity, drive.unit, at=node, axis=drive.axis)
    fixed = {node, GROUND, *(str(c.at) for c in inputs if c.quantity in MOTIONS)}
    outputs = [
        c for c in network.outputs if c is not drive and _heard(c, alive, names) and not _idle(c, fixed)
    ]
    outputs = [c for c in outputs if c.quantity != "force" or c.at is None or c.at in fixed - {node}]
    heard = {c.name for c in outputs}
    kept += [e for e in network.elements if e.place == "element" and e.where[0] in names]
    kept += [e for e in network.elements if e.place == "channel" and e.where[0] in heard]
    order = {e.name: k for k, e in enumerate(network.elements)}
    kept.sort(key=lambda e: order[e.name])
    if not outputs:
        raise InputError(f"cut: no output is left to compare with on this side of '{node}'")
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
    return _uncertain(part, network.uncertainty)


def cut_nodes(network: Network) -> list[str]:
    """Return the nodes of a `network` at which it can be cut."""
    places = []
    for node in dict.fromkeys(c.at for c in network.outputs if c.at is not None and c.quantity in MOTIONS):
        try:
            cut(network, node)
        except InputError:
            continue
        places.append(node)
    return places


def without(network: Network, name: str) -> str:
    """What helps where input `name` of a `network` was not measured, as the end of a message; '' where nothing does."""
    if any(c.name == name and c.quantity == "condition" for c in network.inputs):
        return "; where nobody logged it, leave the input and the elements that read it out of the model"
    road = next((c for c in network.moving if c.name == name and c.quantity == "displacement"), None)
    if road is None:
        return ""
    places = cut_nodes(network)
    ways = (
        f"--cut {places[0]} compares what it moves, "
        if places
        else "--cut NODE wants an output that sees the node's motion, "
    )
    return f"; where nobody measured it, isd-gym diagnose {ways}--unmeasured {name} takes it as white in velocity"


def rejoin(whole: Network, part: Network) -> Network:
    """The whole model with what a diagnosis made of a part of it: its elements at their new values, and those it added.

    whole: before the cut; part: what `cut` gave, changed since.
    """
    node = next((n for n in part.moved_nodes if n not in whole.moved_nodes), None)
    behind = _behind(whole, node) if node is not None else set()
    away = [e for e in whole.elements if e.place == "between" and not _stays(e.where, node or "", behind)]
    names = {c.name for c in (*part.outputs,)}
    away += [e for e in whole.elements if e.place == "channel" and e.where[0] not in names]
    own = {e.name for e in part.elements}
    elements = (*part.elements, *(e for e in away if e.name not in own))
    cells = {c.name: c for c in part.outputs}
    bodies, levers = {b.name: b for b in part.bodies}, {v.name: v for v in part.levers}
    joined = replace(
        whole,
        masses={n: part.masses.get(n, m) for n, m in whole.masses.items()},
        bodies=tuple(bodies.get(b.name, b) for b in whole.bodies),
        levers=tuple(levers.get(v.name, v) for v in whole.levers),
        elements=elements,
        outputs=tuple(cells.get(c.name, c) for c in whole.outputs),
        uncertainty={},
    )
    return _uncertain(joined, whole.uncertainty)


def _uncertain(network: Network, uncertainty: Mapping[str, float]) -> Network:
    """Return the network with those of the uncertainties whose parameters it has."""
    known = network.parameters
    return replace(network, uncertainty={k: v for k, v in uncertainty.items() if k in known})


def _behind(network: Network, node: str) -> set[str]:
    """Nodes that, without `node`, hang together with one that an input moves. Raises `InputError` where there is none.

    Where all do, as the roads of a half car cut at one wheel do, the part with the largest mass stays.
    """
    links: dict[str, set[str]] = {n: set() for n in network.nodes}
    pairs = [e.where for e in network.elements if e.place == "between" and GROUND not in e.where]
    pairs += [v.between for v in network.levers] + [(b.name, n) for b in network.bodies for n in b.nodes[1:]]
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
        raise InputError(f"cut: nothing that an input moves lies behind '{node}'")
    out = set().union(*parts)
    if out >= set(network.nodes) - {node} and len(parts) > 1:
        out -= max(parts, key=lambda part: sum(m for n, m in network.carried.items() if n in part))
    if out >= set(network.nodes) - {node}:
        raise InputError(
            f"cut: everything hangs together beside '{node}': leaving out what moves would leave nothing"
        )
    return out


def _stays(where: Sequence[str], node: str, behind: set[str]) -> bool:
    """Return whether an element or a lever between the nodes `where` is on this side of `node`."""
    return not set(where) & behind and set(where) != {node, GROUND}


def _heard(c: Channel, nodes: set[str], names: set[str]) -> bool:
    """Whether all that a channel is about is still there."""
    about = {n for n in (c.at, *(c.between or ())) if n is not None and n != GROUND}
    return about <= nodes and set(c.elements) <= names


def _idle(c: Channel, fixed: set[str]) -> bool:
    """Whether an output sees nothing but what an input already tells."""
    ends = {c.at, GROUND} if c.at is not None else set(c.between or ())
    return c.quantity in MOTIONS and ends <= fixed
