"""Admissibility of a law at a place: whether the motion of the records can show the law at all.

A force of travel is told from a force of time only if the travel is known or returns. In a coast-down whose speed is measured, the
angle of each record counts from an unknown start and never returns: a spring with a free start angle is any smooth function of time, and
so is the deflection of a compliance in line with a damper.
A force that repeats over travel shows its period only where the samples resolve the period.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from ..._common.errors import InputError
from ...physics import elements as el
from ...physics.network import linearise

if TYPE_CHECKING:
    from collections.abc import Mapping

    from ..._common.arrays import Array
    from ...physics.network import Network
    from .._estimation.structure import Hypothesis
    from .._simulation.problem import Problem

    Pair = tuple[str, str]

#: passes through each travel from which on an unobserved travel is known to return
THERE_AND_BACK = 2.0
#: singular value below which a shift of the travel changes nothing, relative to rows of unit length: rounding
NO_CHANGE = 1e-9


@dataclass(frozen=True)
class Travel:
    """What the records tell about the distance between two nodes."""

    #: whether the distance follows from the outputs
    is_observed: bool
    #: mean number of passes through each travel within a record
    passes: float
    #: whether an input drives the motion
    is_driven: bool = True

    @property
    def is_known(self) -> bool:
        """Whether the travel is observed, or passed there and back within the records."""
        return self.is_observed or self.passes >= THERE_AND_BACK


def is_observed(network: Network, pair: Pair) -> bool:
    """Return whether the outputs tell the distance between two nodes: the network must not rest at any distance with the same outputs."""
    told = tuple(c for c in network.outputs if c.offset != "record")
    try:
        probe = network.probe(network.free_name("travel"), "displacement", between=pair)
        space = linearise(
            replace(network, outputs=(*told, probe), uncertainty={}).mechanical
        )
    except (InputError, ArithmeticError, np.linalg.LinAlgError):
        return True
    rows = np.vstack([space.A, space.C[:-1]])
    size = np.linalg.norm(rows, axis=1)
    rows = rows[size > 0] / size[size > 0, None]
    if not rows.size:
        return not np.any(space.C[-1])
    _, values, directions = np.linalg.svd(rows)
    rank = int(np.sum(values > NO_CHANGE * values[0]))
    return bool(np.all(np.abs(directions[rank:] @ space.C[-1]) < NO_CHANGE))


def travels(
    problem: Problem, network: Network, motion: Mapping[Pair, el.Motion]
) -> dict[Pair, Travel]:
    """Return what the training records tell about the distance of every pair of nodes."""
    edges = np.cumsum([problem.records[i].samples for i in problem.estimation])[:-1]
    return {
        pair: _travel(network, pair, np.split(m.d, edges)) for pair, m in motion.items()
    }


def _travel(network: Network, pair: Pair, parts: list[Array]) -> Travel:
    spans = [float(np.ptp(d)) for d in parts]
    ways = [float(np.sum(np.abs(np.diff(d)))) for d in parts]
    return Travel(
        is_observed=is_observed(network, pair),
        passes=sum(ways) / max(sum(spans), 1e-300),
        is_driven=bool(network.inputs),
    )


def needs_travel(kind: type[el.Element]) -> bool:
    """Return whether the force of an element class depends on the distance between its terminals."""
    return (
        kind.place == "between"
        and kind.plane == "elongation"
        and not kind.series
        and kind.mechanism != "constant"
    )


def has_period(kind: type[el.Element]) -> bool:
    """Return whether the force of an element class repeats over travel."""
    return kind.periodic is not None or kind.period is not el.Element.period


def is_admissible(h: Hypothesis, known: Mapping[Pair, Travel]) -> bool:
    """Return whether the motion of the records can show an effect at a place."""
    if has_period(h.kind) or not (h.kind.series or needs_travel(h.kind)):
        return True
    travel = travel_of(h.where, known)
    return travel is None or travel.is_known or (h.kind.series and travel.is_driven)


def travel_of(where: tuple[str, ...], known: Mapping[Pair, Travel]) -> Travel | None:
    """Return what the records tell about a pair, in either order; None for another place."""
    if len(where) != 2:
        return None
    first, second = where
    return known.get((first, second)) or known.get((second, first))
