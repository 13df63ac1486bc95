"""Frames that move with a node of unknown position: nodes whose input is a velocity or an acceleration."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ..._common.errors import InputError
from ..._common.units import TURNING
from ._model import GROUND, MOTIONS, Network


def frames(network: Network) -> dict[str, int]:
    """Return the free nodes that are described in the frame of a moved node, with the index of the input in `Network.moving`."""
    out: dict[str, int] = {}
    for j, c in enumerate(network.moving):
        if c.quantity == "displacement":
            continue
        part = network.tied[str(c.at)]
        other = next(
            (
                o
                for o in network.moving
                if o is not c and network.tied[str(o.at)] == part
            ),
            None,
        )
        if other is not None:
            raise InputError(
                f"input '{c.name}': the {c.spoken} of '{c.at}' says nothing of its distance from '{other.at}', which "
                f"'{other.name}' moves and the network ties to it: give both as displacements, or leave one out"
            )
        lever = next(
            (v for v in network.levers if part in {network.tied[n] for n in v.between}),
            None,
        )
        if lever is not None:
            raise InputError(
                f"input '{c.name}': lever '{lever.name}' needs the displacement of what it couples, which the {c.spoken} of "
                f"'{c.at}' does not tell: give that as a displacement"
            )
        out |= {n: j for n, p in network.tied.items() if p == part and n != c.at}
    return out


def order_told(network: Network, pair: tuple[str, str]) -> int:
    """Return the lowest derivative of the distance between two nodes that the inputs determine: 0 for a known
    distance, 1 for a known rate only (a node moved by its velocity), 2 for a known acceleration only."""
    frame = frames(network)
    frame |= {
        str(c.at): j
        for j, c in enumerate(network.moving)
        if c.quantity != "displacement"
    }
    first, second = (frame.get(node) for node in pair)
    if first == second:
        return 0
    return max(
        MOTIONS.index(network.moving[j].quantity)
        for j in (first, second)
        if j is not None
    )


def unknown(network: Network, spans: Mapping[str, slice]) -> list[tuple[int, str]]:
    """Return the columns of the base vector that no input determines, each with 'displacement' or 'velocity'."""
    told = [MOTIONS.index(c.quantity) for c in network.moving]
    places = [
        (spans["r"].start + j, "displacement")
        for j, order in enumerate(told)
        if order > 0
    ]
    return places + [
        (spans["v"].start + j, "velocity") for j, order in enumerate(told) if order > 1
    ]


def complete(
    network: Network,
    unknown: Sequence[tuple[int, str]],
    rate: Any,
    d: Any,
    v: Any,
    outputs: Sequence[Any],
) -> None:
    """Check that equations and outputs do not need the unknown position or velocity of a moved node."""
    moving = [c for c in network.moving if c.quantity != "displacement"]

    def first(rows: Any) -> tuple[int, str] | None:
        """Return the first row with an unknown quantity, and the quantity."""
        for k, row in enumerate(rows):
            for column, lacking in unknown:
                if abs(row[column]) > 1e-9 * max(np.abs(row).max(), 1e-300):
                    return k, lacking
        return None

    dynamics = first(rate) or first(d) or first(v)
    if dynamics is not None:
        for c in moving:
            part = network.tied[str(c.at)]
            ties = [
                e
                for e in network.elements
                if e.place == "between" and GROUND in e.where
            ]
            ties = [
                e
                for e in ties
                if network.tied[next(n for n in e.where if n != GROUND)] == part
            ]
            lacking = dynamics[1]
            ties = [
                e
                for e in ties
                if e.law is not None or e.bound is not None or any(e.linear()[:2])
            ] or ties
            if ties:
                what = {
                    ("displacement", True): "angle",
                    ("velocity", True): "angular velocity",
                }.get((lacking, c.si in TURNING), lacking)
                raise InputError(
                    f"input '{c.name}': element '{ties[0].name}' ties '{ties[0].where[0]}' to '{ties[0].where[1]}', and needs "
                    f"the {what} of '{c.at}', which its {c.spoken.replace('_', ' ')} does not tell: measure that too and "
                    "give it as the input instead"
                )
        raise InputError(
            f"input '{moving[0].name}': the {dynamics[1]} of '{moving[0].at}' is missing"
        )
    seen = first(outputs)
    if seen is not None:
        every = {k: c for k, c in enumerate(network.outputs)}
        name = f"output '{every[seen[0]].name}'" if seen[0] in every else "a channel"
        node = every[seen[0]].at if seen[0] in every else None
        raise InputError(
            f"{name}: the {seen[1]} {f'of {node!r} ' if node else ''}against the ground is not told by input "
            f"'{moving[0].name}', the {moving[0].spoken.replace('_', ' ')} of '{moving[0].at}': measure it \"between\" "
            "that node and another"
        )
