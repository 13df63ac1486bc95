"""Additional sensors: possible channels, and their gains for a planned test."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from isd_gym.diagnosis._simulation.problem import BROKEN, bare
from isd_gym.physics.network import Channel, Network, assemble

from .result import SensorGain
from .sensitivity import FARTHEST

if TYPE_CHECKING:
    from .planning._design import Progress
    from .sensitivity import Sensitivities


def list_additional_sensors(network: Network) -> list[Channel]:
    """List sensors that the model lacks: accelerations of masses, elongations and forces of joined pairs."""
    probes = [
        network.probe(f"{m.replace('.', '_')}_acceleration", "acceleration", at=m) for m in network.carried
    ]
    joined: dict[frozenset[str], list[tuple[str, tuple[str, str]]]] = {}
    for e in network.elements:
        if e.place == "between" and not e.series:
            joined.setdefault(frozenset(e.where), []).append((e.name, e.between))
    for members in joined.values():
        first, second = pair = members[0][1]
        probes.append(network.probe(f"{first}_{second}_travel", "displacement", between=pair))
        same = tuple(name for name, own in members if own == pair)
        cell = network.probe(f"{first}_{second}_force", "force", element=same[0])
        probes.append(replace(cell, element=same) if len(same) > 1 else cell)
    moved = {str(c.at) for c in network.inputs if c.quantity == "displacement"}
    probes += [network.probe(f"{n}_force", "force", at=n) for n in sorted(moved)]
    existing = {_measurand(c) for c in network.outputs}
    names = {c.name for c in (*network.inputs, *network.outputs)}
    out = []
    for c in probes:
        is_prescribed = bool(c.between) and set(c.between or ()) <= moved | {"ground"}
        if _measurand(c) in existing or c.name in names or is_prescribed:
            continue
        try:
            assemble(bare(replace(network, outputs=(*network.outputs, c))))
        except BROKEN:
            continue
        out.append(c)
    return out


def _measurand(c: Channel) -> tuple[object, ...]:
    """Return the measured quantity and place of a channel."""
    return c.quantity, c.at, frozenset(c.between or ()), frozenset(c.elements)


def rank_sensors(responses: Sensitivities, progress: Progress) -> tuple[SensorGain, ...]:
    """Rank the additional channels by their gain, linearised.

    Returns:
        Gains, best first.
    """
    now, gains = responses.smallest_sizes(), []
    for k, c in enumerate(responses.more):
        progress("sensors", k / len(responses.more))
        then = responses.smallest_sizes(k)
        told = int(np.sum((now > FARTHEST) & (then <= FARTHEST)))
        both = (now <= FARTHEST) & (then <= FARTHEST)
        factor = float(np.exp(np.median(np.log(now[both] / then[both])))) if both.any() else 1.0
        where = "-".join(c.between) if c.between else c.at or " and ".join(c.elements)
        noise = float(responses.noise[len(responses.bench.noise) + k])
        gains.append(SensorGain(c.name, c.quantity, where, noise, c.unit, told, factor))
    progress("sensors", 1.0)
    return tuple(sorted(gains, key=lambda g: (-g.told, -g.factor)))
