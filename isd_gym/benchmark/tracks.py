"""Tracks: a car, its roads, and the road ahead that a policy may see. Policies are compared within a track."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from .._common.errors import InputError, hint, shown
from .driving import Crew, Entry

if TYPE_CHECKING:
    from collections.abc import Sequence


__all__ = ["TRACKS", "Track", "find_track"]


@dataclass(frozen=True)
class Track:
    """A track."""

    card: str  # name of the card
    name: str  # name of the track in the card
    network: str  # built-in network of the car
    road: str = "paper"  # name of the road
    speed: float = 20.0  # speed [m/s]
    preview: float = 0.0  # road ahead that a policy may see [s]
    episodes: int = 32  # number of roads of 20 s

    def check(self, entries: Sequence[Entry]) -> None:
        """Check that policies see no more than the track shows.

        Args:
            entries: The policies.

        Raises:
            InputError: A policy sees the state, or more of the road than `preview`.
        """
        for entry in entries:
            crew = Crew(entry, 1)
            if crew.observation == "full":
                raise InputError(
                    f"'{entry.name}' sees the state, which no track shows: use the measured observation"
                )
            if crew.preview > self.preview + 1e-9:
                shows = f"{self.preview:g} s" if self.preview else "none"
                raise InputError(
                    f"'{entry.name}' sees {crew.preview:g} s of road ahead, but track {self.name} shows {shows}"
                )


#: speed of each road of the active and the semi-active car [m/s]; rough classes are driven slowly, since the linear
#: tyre would pull on the road
_SPEEDS = {"A": 20.0, "B": 20.0, "C": 20.0, "D": 10.0, "E": 5.0, "bump": 10.0}


def _on_each_road(network: str, prefix: str) -> dict[str, Track]:
    """Return the tracks of a car on roads A to E and on a bump, which is the same in every episode."""
    out = {}
    for road, speed in _SPEEDS.items():
        name = f"{prefix}-{road.lower()}"
        episodes = 1 if road == "bump" else 32
        out[name] = Track(network, name, network, road, speed, episodes=episodes)
    return out


#: tracks by the name on the command line
TRACKS = {
    "standard": Track("ISDSuspension-v0", "standard", "quarter-car-isd"),
    "preview-0.1": Track(
        "ISDSuspension-v0", "preview-0.1", "quarter-car-isd", preview=0.1
    ),
    "preview-0.2": Track(
        "ISDSuspension-v0", "preview-0.2", "quarter-car-isd", preview=0.2
    ),
    "half-car": Track("ISDHalfCar-v0", "standard", "half-car-isd"),
    "full-car": Track("ISDFullCar-v0", "standard", "full-car-isd"),
    "full-car-preview-0.2": Track(
        "ISDFullCar-v0", "preview-0.2", "full-car-isd", preview=0.2
    ),
    **_on_each_road("quarter-car-active", "active"),
    **_on_each_road("quarter-car-semiactive", "semiactive"),
}


def find_track(name: str) -> Track:
    """Return a track.

    Args:
        name: A key of `TRACKS`.

    Raises:
        InputError: No track has the name.
    """
    if name not in TRACKS:
        raise InputError(f"no track {shown(name)}; {hint(name, list(TRACKS))}")
    return TRACKS[name]
