"""Conditions under which bounds may be shown beside a score.

Every bound belongs to a road, a car and a sample. `comparable` decides for all of them; the command, its JSON and
the report page show the allowed bounds and one line about the others.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import TYPE_CHECKING

from ..physics.vehicle import vehicle

if TYPE_CHECKING:
    from ..physics.network import Network
    from .driving import Conditions

#: smallest sample for statements about the mean over roads, equal to the benchmark's; duration in seconds
EPISODES, DURATION = 32, 20.0


@dataclass(frozen=True)
class Comparable:
    """Reasons against showing a bound beside a score; an empty reason allows the bound."""

    # linear-quadratic bound of the mean over random roads
    lq_bound: str = ""
    # causal ceiling of the mean over random roads
    ceiling: str = ""
    # clairvoyant optimum of single roads
    clairvoyant: str = ""

    @property
    def left_out(self) -> str | None:
        """One line about the omitted bounds, with the reasons; None if all bounds are shown."""
        by_reason: dict[str, list[str]] = {}
        for f in fields(self):
            if reason := getattr(self, f.name):
                by_reason.setdefault(reason, []).append(NAMES[f.name])
        if not by_reason:
            return None
        return (
            "Left out: "
            + "; ".join(f"{_listed(n)} ({reason})" for reason, n in by_reason.items())
            + "."
        )


#: names of the bounds in `Comparable.left_out`
NAMES = {
    "lq_bound": "the LQ bound",
    "ceiling": "the causal ceiling",
    "clairvoyant": "the clairvoyant optimum",
}


def comparable(
    network: Network, conditions: Conditions, *, reference: str = "passive"
) -> Comparable:
    """Decide which bounds may be shown beside a score."""
    ground = conditions.road
    episodes = conditions.episodes
    duration = conditions.duration
    if reference != "passive":
        return Comparable(
            *[f"changes are against {reference}, not passive"] * len(fields(Comparable))
        )
    few = ""
    if episodes < EPISODES or duration < DURATION:
        few = f"{episodes} x {duration:g} s is too small a sample: {EPISODES} x {DURATION:g} s at least"
    rough = ground.roughness > 0 and ground.profile is None
    mean = few if rough else "the road is not a random one"
    bound, ceiling, clairvoyant = mean, mean, ""
    if network.bodies:
        ceiling = clairvoyant = "known of quarter cars only"
        if vehicle(network).wheels.tracks > 1:
            bound = "known of cars whose wheels run in one track"
    return Comparable(bound, ceiling, clairvoyant)


def _listed(names: list[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
