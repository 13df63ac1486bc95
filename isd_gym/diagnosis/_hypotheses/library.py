"""The library of hypotheses: every registered effect at every place where the effect makes physical sense."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations
from typing import TYPE_CHECKING

from ...physics import elements as el
from ...physics.network import GROUND, Network
from ...physics.network.frames import frames, order_told
from .._estimation.structure import Hypothesis

if TYPE_CHECKING:
    from collections.abc import Iterator

__all__ = ["Hypothesis", "hypotheses", "pairs"]


def pairs(network: Network) -> list[tuple[str, str]]:
    """Return the pairs of nodes that can carry a force and whose distance or rate the inputs determine: joined pairs, pairs of masses or
    points of a body, and each mass with the ground."""
    riding = frames(network)
    out: dict[frozenset[str], tuple[str, str]] = {}
    for e in network.elements:
        if e.place == "between" and not e.series and order_told(network, e.between) < 2:
            out.setdefault(frozenset(e.where), e.between)
    seen = {
        m: network.tied[m] if m in riding else -1
        for m in network.masses
        if m not in network.moved_nodes or not riding
    }
    for pair in combinations(seen, 2):
        if seen[pair[0]] == seen[pair[1]] and (pair[0] in network.rotating) == (
            pair[1] in network.rotating
        ):
            out.setdefault(frozenset(pair), pair)
    for m in network.carried:
        if order_told(network, (m, GROUND)) < 2 and (
            m not in network.moved_nodes or not riding
        ):
            out.setdefault(frozenset((m, GROUND)), (m, GROUND))
    return list(out.values())


def places(network: Network, kind: type[el.Element]) -> list[tuple[str, ...]]:
    """Return the places of an element class: pairs of nodes, motors, or channels."""
    if kind.place == "element":
        return [(e.name,) for e in network.elements if isinstance(e, el.Motor)]
    if kind.place == "channel":
        return [(c.name,) for c in network.outputs]
    # a law of travel needs the distance; an element in series has an elongation of its own
    travel = kind.plane == "elongation" and not kind.series
    return [p for p in pairs(network) if not (travel and order_told(network, p))]


def hypotheses(network: Network) -> Iterator[Hypothesis]:
    """Yield every registered effect at every place, unless the effect is another value of a known parameter."""
    el.discover()
    for kind in el.TYPES.values():
        for where in places(network, kind):
            # an element in series carries all elements of the place, or each of several parallel ones
            here = (
                [e.name for e in el.beside(network, where) if not e.series]
                if kind.series
                else []
            )
            for behind in ["", *here] if len(here) > 1 else [""]:
                bare = Hypothesis(kind.type, where, (), behind)
                if bare.stands(network):
                    for options in kind.variants(network, where):
                        yield replace(bare, options=tuple(options.items()))
