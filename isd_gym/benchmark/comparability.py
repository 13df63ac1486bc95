"""Conditions under which bounds and published figures may be shown beside a score.

Every bound, and every figure of the paper, belongs to a road, a speed, a car and a sample. `comparable`
decides for all of them; the command, its JSON and the report page show the allowed statements and one line
about the others.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any

from ..physics.network import Network
from ..physics.road import paper_road
from ..physics.road import road as find_road
from ..physics.vehicle import vehicle

if TYPE_CHECKING:
    from ..env import Sensors
    from ..physics.road import Road

#: smallest sample for statements about the mean over roads, equal to the benchmark's; duration in seconds
EPISODES, DURATION = 32, 20.0
PAPER_SPEED = 20.0  # m/s
#: built-in networks of the paper's car: with the oil spring in series, and with the printed equation (8)
PAPER_CARS = ("quarter-car-isd", "quarter-car-eq8")


@dataclass(frozen=True)
class Comparable:
    """Reasons against showing a statement beside a score; an empty reason allows the statement."""

    # Tables 7 and 8 of the paper
    tables: str = ""
    # linear-quadratic bound of the mean over random roads
    lq_bound: str = ""
    # causal ceiling of the mean over random roads
    ceiling: str = ""
    # clairvoyant optimum of single roads
    clairvoyant: str = ""

    @property
    def left_out(self) -> str | None:
        """One line about the omitted statements, with the reasons; None if all statements are shown."""
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


#: names of the statements in `Comparable.left_out`
NAMES = {
    "tables": "Tables 7 and 8 of the paper",
    "lq_bound": "the LQ bound",
    "ceiling": "the causal ceiling",
    "clairvoyant": "the clairvoyant optimum",
}


def comparable(
    network: Network,
    road: str | Road,
    speed: float,
    episodes: int,
    duration: float,
    *,
    randomize: Any = None,
    sensors: Sensors | None = None,
    reference: str = "passive",
) -> Comparable:
    """Decide which statements may be shown beside a score."""
    ground = find_road(road)
    if reference != "passive":
        return Comparable(
            *[f"changes are against {reference}, not passive"] * len(fields(Comparable))
        )
    if randomize:
        return Comparable(
            *["cars or roads vary from episode to episode"] * len(fields(Comparable))
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
    return Comparable(
        _tables(network, ground, speed, sensors) or few, bound, ceiling, clairvoyant
    )


def _tables(
    network: Network, ground: Road, speed: float, sensors: Sensors | None
) -> str:
    """Return the reason against the paper's tables; '' for the conditions of the paper."""
    paper = paper_road()
    if ground.profile is not None or (ground.roughness, ground.cutoff) != (
        paper.roughness,
        paper.cutoff,
    ):
        return "another road"
    if abs(speed - PAPER_SPEED) > 1e-9:
        return "another speed"
    if not any(_same_car(network, Network.load(name)) for name in PAPER_CARS):
        return "another car"
    return "" if sensors is None or sensors.perfect else "imperfect sensors"


def _same_car(one: Network, other: Network) -> bool:
    parts = ("masses", "bodies", "levers", "elements", "inputs")
    return all(getattr(one, part) == getattr(other, part) for part in parts)


def _listed(names: list[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
