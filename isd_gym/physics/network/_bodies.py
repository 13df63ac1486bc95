"""Rigid bodies with named points, and levers: ideal constraints between the nodes of a network."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from ..._common.errors import InputError, shown
from ..._common.inputs import is_number

MASSES = (1e-9, 1e9)  # [kg] or [kg m^2]
#: axes of rotation of a body
AXES = ("pitch", "roll")
FARTHEST = 1e3  # largest distance of a point from the centre of gravity [m]
RATIOS = (1e-9, 1e9)  # magnitudes of a lever's ratio
#: unit of a lever's ratio -> whether the first and the second node rotate
LEVER_UNITS = {
    "m/m": (False, False),
    "m/rad": (False, True),
    "rad/m": (True, False),
    "rad/rad": (True, True),
}


def angle_node(body: str, axis: str) -> str:
    """Return the name of the node that is the angle of a body about an axis, such as 'body.pitch'."""
    return f"{body}.{axis}"


@dataclass(frozen=True)
class Point:
    """A point of a rigid body, an ordinary node of the network."""

    name: str  # name of the node
    x: float = 0.0  # distance in front of the centre of gravity [m]
    y: float = 0.0  # distance to the left of the centre of gravity [m]

    def arm(self, axis: str) -> float:
        """Return the upward motion of the point per angle about an axis.

        Axes as in ISO 8855: x forward, y left, z up; pitch is positive nose down, roll positive right side
        down.

        Args:
            axis: 'pitch' or 'roll'.

        Returns:
            Lever arm [m/rad].

        References:
            ISO 8855, Road vehicles: Vehicle dynamics and road-holding ability, Vocabulary.
        """
        return -self.x if axis == "pitch" else self.y


@dataclass(frozen=True)
class Body:
    """A rigid body: a mass that moves up and down, and rotates about each axis with an inertia.

    The centre of gravity is a node with the name of the body, and the angle about an axis a rotational node
    ('body.pitch'). Every point is a node that follows: z_point = z - x pitch + y roll.

    Raises:
        InputError: A value is not a number, or is outside its limits.
    """

    name: str  # name of the body and of the node at its centre of gravity
    mass: float  # mass [kg]
    #: moment of inertia about the y axis [kg m^2]; None for a body that does not pitch
    pitch: float | None = None
    #: moment of inertia about the x axis [kg m^2]; None for a body that does not roll
    roll: float | None = None
    points: tuple[Point, ...] = ()  # named points

    def __post_init__(self) -> None:
        where, (low, high) = f"body {shown(self.name)}", MASSES
        if not is_number(self.mass) or not low <= self.mass <= high:
            raise InputError(
                f"{where}: the mass must be a positive number of kg, {low:g} to {high:g}, not {shown(self.mass)}"
            )
        for axis, inertia in self.inertias.items():
            if not is_number(inertia) or not low <= inertia <= high:
                raise InputError(
                    f"{where}: the inertia '{axis}' must be a positive number of kg m^2, {low:g} to {high:g}, not "
                    f"{shown(inertia)}; leave it out of a body that does not {axis}"
                )
        for point in self.points:
            for axis_name, value in (("x", point.x), ("y", point.y)):
                if not is_number(value) or abs(value) > FARTHEST:
                    raise InputError(
                        f"{where}: {axis_name} of point '{point.name}' must be a number of m, at most {FARTHEST:g}, "
                        f"not {shown(value)}"
                    )

    @property
    def inertias(self) -> dict[str, float]:
        """Moment of inertia [kg m^2] by axis of rotation."""
        both = {"pitch": self.pitch, "roll": self.roll}
        return {axis: inertia for axis, inertia in both.items() if inertia is not None}

    @property
    def angles(self) -> dict[str, str]:
        """Rotational node by axis of rotation."""
        return {axis: angle_node(self.name, axis) for axis in self.inertias}

    @property
    def nodes(self) -> tuple[str, ...]:
        """Names of the nodes: centre of gravity, angles and points."""
        return (self.name, *self.angles.values(), *(p.name for p in self.points))

    @property
    def carried(self) -> dict[str, float]:
        """Mass [kg] or moment of inertia [kg m^2] of the centre of gravity and the angles."""
        turning = {
            angle_node(self.name, axis): inertia
            for axis, inertia in self.inertias.items()
        }
        return {self.name: self.mass, **turning}

    @property
    def parameters(self) -> dict[str, float]:
        """Parameters of the body by path: 'body.mass', 'body.inertia.pitch'."""
        inertias = {
            f"{self.name}.inertia.{axis}": float(value)
            for axis, value in self.inertias.items()
        }
        return {f"{self.name}.mass": float(self.mass), **inertias}

    def to_dict(self) -> dict[str, Any]:
        """Return the body as an object of a model file."""
        out: dict[str, Any] = {"mass": self.mass}
        if self.inertias:
            out["inertia"] = self.inertias
        if self.points:
            out["points"] = {
                p.name: {"x": p.x} | ({"y": p.y} if p.y else {}) for p in self.points
            }
        return out


@dataclass(frozen=True)
class Lever:
    """A ratio between the motions of two nodes, of translation or rotation: z_first = ratio z_second.

    A lever has no mass and no play. Examples are a rocker or bell crank (m/m), a rack and pinion (m/rad), a
    drum (rad/m) and a gear (rad/rad).

    Raises:
        InputError: The ratio, the unit or the pair of nodes is invalid.
    """

    name: str  # name of the lever
    between: tuple[str, str]  # first and second node
    ratio: float  # motion of the first node per motion of the second
    unit: str  # unit of the ratio, one of `LEVER_UNITS`

    def __post_init__(self) -> None:
        where, (low, high) = f"lever {shown(self.name)}", RATIOS
        if not isinstance(self.unit, str) or self.unit not in LEVER_UNITS:
            raise InputError(
                f"{where}: unit {shown(self.unit)} is not that of a ratio (known: {', '.join(LEVER_UNITS)})"
            )
        if not is_number(self.ratio) or not low <= abs(self.ratio) <= high:
            raise InputError(
                f"{where}: the ratio must be a number other than zero, {low:g} to {high:g} or its negative, not "
                f"{shown(self.ratio)}"
            )
        if len(set(self.between)) != 2:
            raise InputError(f"{where}: it couples '{self.between[0]}' to itself")

    @property
    def turning(self) -> tuple[str, ...]:
        """Rotational nodes of the lever."""
        return tuple(
            n
            for n, turns in zip(self.between, LEVER_UNITS[self.unit], strict=True)
            if turns
        )

    def to_dict(self) -> dict[str, Any]:
        """Return the lever as an object of a model file."""
        return {
            "name": self.name,
            "between": list(self.between),
            "ratio": self.ratio,
            "unit": self.unit,
        }


def body_of(name: str, data: Mapping[str, Any]) -> Body:
    """Return the body of an entry of a model file whose keys are valid."""
    inertia = data.get("inertia", {})
    points = tuple(
        Point(p, at.get("x", 0.0), at.get("y", 0.0))
        for p, at in data.get("points", {}).items()
    )
    return Body(name, data["mass"], inertia.get("pitch"), inertia.get("roll"), points)
