"""Content of a frame of a car: plain numbers, independent of the simulation.

Signs are those of the model. A displacement is positive upwards, a travel is positive in extension, and a
positive current pulls the terminals of the device together (force positive in tension). Axes are those of ISO
8855: x forward, y to the left; pitch is positive nose down, roll positive right side down.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ..._common.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray


class Trace(NamedTuple):
    """A quantity with a live curve."""

    title: str  # title of the plot
    unit: str  # unit of the plot
    factor: float  # value in the unit of the plot per SI unit
    scale: float  # smallest unit of the axis, which has a range of three units [unit]
    digits: int  # number of decimals of the RMS


VERTICAL = Trace("Body acceleration", "m/s²", 1.0, 1.0, 2)
TRAVEL = Trace("Suspension travel", "mm", 1e3, 10.0, 1)
PITCH = Trace("Pitch acceleration", "rad/s²", 1.0, 1.0, 2)
ROLL = Trace("Roll acceleration", "rad/s²", 1.0, 1.0, 2)


def _check_finite(shot: Any, where: str) -> None:
    for each in fields(shot):
        value = getattr(shot, each.name)
        if isinstance(value, int | float | np.ndarray) and not np.isfinite(value).all():
            raise InputError(f"{where}: {each.name} is {value}, not a finite number")


@dataclass(frozen=True, kw_only=True)
class CornerSnapshot:
    """A wheel and its suspension in one frame. Displacements are absolute, upwards, about static equilibrium."""

    name: str = ""  # name of the corner; '' in a quarter car
    x: float = 0.0  # distance in front of the centre of gravity [m]
    y: float = 0.0  # distance to the left of the centre of gravity [m]
    body: float  # body above the suspension [m]
    wheel: float  # [m]
    # node between oil spring and inerter [m]; None: the model has none
    piston: float | None = None
    # node between inerter and damper [m]; None without a device
    joint: float | None = None
    current: float = 0.0  # [A]
    current_limit: float | None = None  # [A]; None without a motor
    tyre_load: float  # dynamic tyre load [N], in addition to the static load
    # [N]; if given, an unloaded tyre is drawn above the road
    static_tyre_load: float | None = None
    # end stop of the device [m]; None without end stop
    device_travel_limit: float | None = None

    def __post_init__(self) -> None:
        _check_finite(
            self, f"snapshot, corner '{self.name}'" if self.name else "snapshot"
        )

    @property
    def device_travel(self) -> float | None:
        """Extension of the device [m]; None without a device."""
        if self.joint is None:
            return None
        return (self.body if self.piston is None else self.piston) - self.joint

    @property
    def has_lifted(self) -> bool:
        """Whether the tyre carries no load."""
        return (
            self.static_tyre_load is not None
            and self.tyre_load <= -self.static_tyre_load
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class CarSnapshot:
    """A car with any number of corners in one frame; a quarter car has one. Displacements are absolute, about static equilibrium."""

    time: float  # [s]
    heave: float  # displacement of the body at its centre of gravity [m]
    pitch: float | None = None  # angle [rad]; None for a body without pitch
    roll: float | None = None  # angle [rad]; None for a body without roll
    # wheels with their suspensions; wheels with y < 0 run in the right track
    corners: tuple[CornerSnapshot, ...]
    # name and place (x, y) [m] of other points of the body
    points: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    # height of each track from behind the rearmost wheel to ahead of the foremost one [m], shape (1, n) or (2, n), left first
    road_profiles: NDArray[np.float64]
    road_step: float  # distance of two samples of a profile [m]
    road_behind: float  # length of the profiles behind the foremost wheel [m]
    speed: float  # [m/s]
    body_acceleration: float  # vertical acceleration at the centre of gravity [m/s^2]
    pitch_acceleration: float | None = None  # [rad/s^2]; None for a body without pitch
    roll_acceleration: float | None = None  # [rad/s^2]; None for a body without roll
    suspension_travel: float | None = None  # of a quarter car [m]
    cost: float | None = None  # mean cost so far
    label: str = ""  # name on the body
    # time [s] and values of earlier moments, in the order of `traces` [SI], for the curves
    past: Sequence[tuple[float, ...]] = ()

    def __post_init__(self) -> None:
        _check_finite(self, "snapshot")

    @property
    def is_wide(self) -> bool:
        """Whether the car has left and right wheels."""
        return len({corner.y for corner in self.corners}) > 1

    @property
    def is_long(self) -> bool:
        """Whether the car has more than one axle."""
        return len({corner.x for corner in self.corners}) > 1

    @property
    def traces(self) -> tuple[tuple[Trace, float], ...]:
        """Quantities with a live curve, and their values in SI units."""
        every = (
            (VERTICAL, self.body_acceleration),
            (PITCH, self.pitch_acceleration),
            (ROLL, self.roll_acceleration),
            (TRAVEL, self.suspension_travel),
        )
        return tuple((trace, value) for trace, value in every if value is not None)

    def height(self, x: float, y: float) -> float:
        """Return the displacement upwards [m] of a point x in front and y to the left of the centre of
        gravity [m]."""
        return self.heave - x * (self.pitch or 0.0) + y * (self.roll or 0.0)
