"""Cars in the view of the environment: motions of the body, corners with a suspension and a wheel, and their signals.

A corner is a road input with the wheel on that road. In a network without rigid bodies, a quarter car, body
and wheel are the first two masses. In a network with a rigid body, each wheel carries the point of the body
that is nearest along the elements.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from .._common.errors import InputError
from . import elements as el
from .network import GROUND, Channel, Network
from .tracks import WheelPositions

CURRENT_LIMIT = 5.0  # A, Table 5
SLEW_RATE = 100.0  # A/s: 0.5 A per control step of 5 ms, Table 5
# A, largest change of a current in a control step of 5 ms
SLEW_LIMIT = SLEW_RATE * 5e-3
GRAVITY = 9.81  # m/s^2
AXES = ("pitch", "roll")
ROAD = "road_"  # prefix of the road inputs of cars with several corners


class Signal(NamedTuple):
    """A measured signal of a car."""

    name: str  # name, followed by the name of the corner
    unit: str  # SI unit
    bound: float  # bound of its magnitude in an observation [unit]
    kind: str  # name without the name of the corner


@dataclass(frozen=True)
class Corner:
    """A wheel, its suspension and the road under the wheel."""

    name: str  # name such as 'front' or 'rear_left'; '' in a quarter car
    body: str  # node of the body above the suspension
    wheel: str  # node of the wheel
    # nodes of the motor; body and wheel in a corner without a motor
    device: tuple[str, str]
    road: str  # node that the road moves
    road_input: str  # name of the road input
    motor: str | None  # name of the motor; None without a motor
    current_input: str | None  # name of the motor's input; None without a motor
    x: float = 0.0  # distance in front of the centre of gravity [m]
    y: float = 0.0  # distance to the left of the centre of gravity [m]

    def named(self, signal: str) -> str:
        """Return the name of a signal of this corner."""
        return f"{signal}_{self.name}" if self.name else signal


@dataclass(frozen=True)
class Vehicle:
    """A network as a car."""

    network: Network  # the network
    body: str  # node of the body, at its centre of gravity
    # node of the body's angle by axis of rotation, 'pitch' before 'roll'
    angles: dict[str, str]
    corners: tuple[Corner, ...]  # corners in the order of the road inputs

    @property
    def axes(self) -> tuple[str, ...]:
        """Axes of rotation of the body."""
        return tuple(self.angles)

    @cached_property
    def wheels(self) -> WheelPositions:
        """Positions of the wheels, and with them the tracks of the road."""
        return WheelPositions(
            tuple(c.x for c in self.corners), tuple(c.y for c in self.corners)
        )

    @cached_property
    def driven(self) -> tuple[Corner, ...]:
        """Corners with a commanded current, in the order of an action; all corners if no corner has a motor."""
        return tuple(c for c in self.corners if c.motor is not None) or self.corners

    @cached_property
    def channels(self) -> tuple[Channel, ...]:
        """Channels of the network that the environment reads: accelerations, four signals of each corner, tyre loads."""
        out = [Channel("body_acceleration", "acceleration", "m/s^2", at=self.body)]
        out += [
            Channel(f"{axis}_acceleration", "acceleration", "rad/s^2", at=n)
            for axis, n in self.angles.items()
        ]
        for c in self.corners:
            pairs = (
                ("suspension_travel", (c.body, c.wheel)),
                ("device_travel", c.device),
            )
            for name, pair in pairs:
                out.append(Channel(c.named(name), "displacement", "m", between=pair))
                out.append(
                    Channel(c.named(f"{name}_rate"), "velocity", "m/s", between=pair)
                )
        out += [
            Channel(c.named("tyre_load"), "force", "N", at=c.road) for c in self.corners
        ]
        return tuple(out)

    @cached_property
    def measured(self) -> tuple[Signal, ...]:
        """Measured signals in the order of an observation; the currents come last."""
        out = [
            Signal("body_acceleration", "m/s^2", 200.0, "body_acceleration"),
            *(
                Signal(f"{axis}_acceleration", "rad/s^2", 200.0, f"{axis}_acceleration")
                for axis in self.axes
            ),
        ]
        for c in self.corners:
            for name in ("suspension_travel", "device_travel"):
                out.append(Signal(c.named(name), "m", 1.0, name))
                out.append(Signal(c.named(f"{name}_rate"), "m/s", 50.0, f"{name}_rate"))
        return (
            *out,
            *(
                Signal(c.named("current"), "A", CURRENT_LIMIT, "current")
                for c in self.driven
            ),
        )

    @property
    def costs(self) -> tuple[str, ...]:
        """Names of the terms of the cost."""
        return tuple(
            f"cost_{name}"
            for name in ("acceleration", *self.axes, "travel", "tyre_load", "current")
        )

    @property
    def tyre_loads(self) -> tuple[str, ...]:
        """Names of the dynamic tyre loads."""
        return tuple(c.named("tyre_load") for c in self.corners)

    def thrust(self, corner: Corner) -> float:
        """Return the thrust of a corner's motor at its terminals per current [N/A]; 0 without a motor."""
        motor = next((e for e in self.network.elements if e.name == corner.motor), None)
        return (
            motor.thrust_constant * motor.ratio if isinstance(motor, el.Motor) else 0.0
        )

    def arms(self, x: float, y: float) -> tuple[float, ...]:
        """Return the factors (1 + axes,) on vertical and angular accelerations, in the order of `measured`, that give the vertical
        acceleration of a point x [m] in front and y [m] to the left of the centre of gravity.
        """
        return (1.0, *(-x if axis == "pitch" else y for axis in self.axes))

    @cached_property
    def points(self) -> dict[str, tuple[float, float]]:
        """Named points of the body: distances (x, y) in front and to the left of the centre of gravity [m]."""
        bodies = self.network.bodies[:1]
        return {self.body: (0.0, 0.0)} | {
            p.name: (p.x, p.y) for body in bodies for p in body.points
        }

    @cached_property
    def resting_masses(self) -> tuple[float, ...]:
        """Share of the body's mass that rests on each corner [kg]: the shares balance the weight about the
        centre of gravity, with the least sum of squares."""
        mass = self.network.carried[self.body]
        rows = np.array([self.arms(c.x, c.y) for c in self.corners]).T
        rows = rows[np.abs(rows).max(axis=1) > 0]
        wanted = np.eye(len(rows))[0]
        parts = rows.T @ np.linalg.lstsq(rows @ rows.T, wanted, rcond=None)[0]
        if np.abs(rows @ parts - wanted).max() > 1e-9 or parts.min() <= 0:
            raise InputError(
                f"network '{self.network.name}': the body does not rest on its wheels; put wheels on both sides of the "
                "centre of gravity"
            )
        return tuple(mass * round(float(part), 12) for part in parts)

    @cached_property
    def static_tyre_loads(self) -> tuple[float | None, ...]:
        """Static load of each tyre [N]; None where the wheels do not carry the body."""
        if not self.network.bodies:
            return (GRAVITY * sum(self.network.masses.values()),)
        try:
            resting = self.resting_masses
        except InputError:
            return (None,) * len(self.corners)
        return tuple(
            GRAVITY * (mass + self.network.masses[corner.wheel])
            for mass, corner in zip(resting, self.corners, strict=True)
        )

    def quarter_car(self, corner: Corner) -> Network:
        """Return a corner as a quarter car: the elements of the corner, and the share of the body's mass that
        rests on the corner.

        If the inertias are those of masses at the corners, such as a pitch inertia of m a b, the corner moves
        exactly like this quarter car.
        """
        network = self.network
        if not network.bodies:
            return network
        body = {n for b in network.bodies for n in b.nodes}
        others = {n for c in self.corners if c is not corner for n in (c.wheel, c.road)}
        own, frontier = {corner.wheel}, [corner.wheel]
        pairs = [e.where for e in network.elements if e.place == "between"]
        pairs += [v.between for v in network.levers]
        while frontier:
            node = frontier.pop()
            for pair in pairs:
                if node in pair:
                    reached = set(pair) - own - body - others - {GROUND}
                    own |= reached
                    frontier += reached - {corner.road}
        mass = self.resting_masses[self.corners.index(corner)]
        place = {n: n for n in (*own, GROUND)} | dict.fromkeys(body, corner.body)
        elements, names = [], set()
        for e in network.elements:
            if (
                e.place == "between"
                and set(e.where) <= set(place)
                and set(e.where) & own
            ):
                elements.append(replace(e, where=tuple(place[n] for n in e.where)))
                names.add(e.name)
        elements += [
            e for e in network.elements if e.place == "element" and e.where[0] in names
        ]
        inputs = [
            c
            for c in network.inputs
            if c.name in (corner.road_input, corner.current_input)
        ]
        return replace(
            network,
            name=f"{network.name} ({corner.name})",
            masses={corner.body: mass, corner.wheel: network.masses[corner.wheel]}
            | {
                n: m
                for n, m in network.masses.items()
                if n in own and n != corner.wheel
            },
            turning=network.turning & own,
            bodies=(),
            levers=tuple(v for v in network.levers if set(v.between) <= own),
            elements=tuple(elements),
            inputs=tuple(inputs),
            outputs=(),
            uncertainty={},
        )

    def shares(self, channel: Channel) -> tuple[float, ...]:
        """Return the shares of the road heights in the reference of a node's displacement: a node of a corner
        is measured from the road of the corner, a node of the body from the mean of all roads."""
        count = len(self.corners)
        if channel.quantity != "displacement" or channel.at in self.angles.values():
            return (0.0,) * count
        node = str(channel.at)
        if count > 1 and node != self.body:
            ends = {n: i for i, c in enumerate(self.corners) for n in (c.body, c.wheel)}
            near = _nearest(self.network, node, ends)
            if near is not None:
                return tuple(float(i == ends[near]) for i in range(count))
        return (1.0 / count,) * count


def vehicle(network: Network) -> Vehicle:
    """Return a network as a car."""
    if network.bodies:
        return _with_body(network)
    masses = list(network.masses)
    if len(masses) < 2 or not any(c.quantity == "displacement" for c in network.moving):
        raise InputError(
            f"network '{network.name}' is no car: it needs two masses and a displacement input (the road)"
        )
    currents = [c for c in network.inputs if c.quantity == "current"]
    if len(currents) > 1:
        raise InputError(
            f"network '{network.name}' has {len(currents)} currents and no rigid body: the environment of a car with several "
            'corners needs a body with points ("bodies")'
        )
    body, wheel = masses[0], masses[1]
    motor = next((e for e in network.elements if e.driven), None)
    road_input = next(c.name for c in network.inputs if c.quantity == "displacement")
    corner = Corner(
        "",
        body,
        wheel,
        motor.between if motor is not None else (body, wheel),
        network.moved_nodes[0],
        road_input,
        motor.name if motor is not None else None,
        currents[0].name if currents else None,
    )
    return Vehicle(network, body, {}, (corner,))


def _with_body(network: Network) -> Vehicle:
    body = network.bodies[0]
    points = {p.name: p for p in body.points}
    place = {body.name: (0.0, 0.0)} | {p.name: (p.x, p.y) for p in body.points}
    roads = [c for c in network.moving if c.quantity == "displacement"]
    if not roads:
        raise InputError(
            f"network '{network.name}' is no car: it needs a displacement input (the road) under each wheel"
        )
    wheels: dict[str, str] = {}  # by road input
    for c in roads:
        wheel = _nearest(
            network,
            str(c.at),
            set(network.masses) - {body.name, *body.angles.values()},
            stop=points,
        )
        if wheel is None or wheel in wheels.values():
            raise InputError(
                f"network '{network.name}' is no car: no wheel of its own, a mass, stands on the road '{c.name}'"
            )
        wheels[c.name] = wheel
    motors: dict[str, el.Element] = {}
    for e in network.elements:
        if e.driven:
            wheel = _nearest(network, e.between, set(wheels.values()), stop=points)
            if wheel is None or wheel in motors:
                raise InputError(
                    f"network '{network.name}': motor '{e.name}' is not the only one of a wheel; the environment drives "
                    "one at each"
                )
            motors[wheel] = e
    corners = []
    for c in roads:
        wheel = wheels[c.name]
        above = _nearest(network, wheel, place)
        if above is None:
            raise InputError(
                f"network '{network.name}' is no car: wheel '{wheel}' does not carry the body '{body.name}'"
            )
        motor = motors.get(wheel)
        current = None
        if motor is not None:
            current = next(
                (i.name for i in network.inputs if motor.name in i.elements), None
            )
            if current is None:
                raise InputError(
                    f"network '{network.name}': motor '{motor.name}' has no input with \"quantity\": \"current\""
                )
        x, y = place[above]
        device = motor.between if motor is not None else (above, wheel)
        corners.append(
            Corner(
                c.name.removeprefix(ROAD), above, wheel, device, str(c.at), c.name,
                motor.name if motor is not None else None, current, x, y,
            )
        )  # fmt: skip
    return Vehicle(
        network,
        body.name,
        {a: body.angles[a] for a in AXES if a in body.angles},
        tuple(corners),
    )


def _nearest(
    network: Network,
    start: str | Iterable[str],
    wanted: Collection[str],
    *,
    stop: Collection[str] = (),
) -> str | None:
    """Return the node of `wanted` that is the fewest elements away from `start`, on paths outside of `stop`."""
    frontier = [start] if isinstance(start, str) else list(start)
    reached = set(frontier)
    while frontier:
        for node in frontier:
            if node in wanted:
                return node
        following = []
        for node in frontier:
            if node in stop:
                continue
            for e in network.elements:
                if e.place == "between" and node in e.where:
                    other = e.where[1] if e.where[0] == node else e.where[0]
                    if other != GROUND and other not in reached:
                        reached.add(other)
                        following.append(other)
        frontier = following
    return None


def kind(network: Network) -> str:
    """Return the kind of a car: 'quarter car', 'half car', 'full car' or 'car with 3 corners'."""
    corners = len(vehicle(network).corners)
    return {1: "quarter car", 2: "half car", 4: "full car"}.get(
        corners, f"car with {corners} corners"
    )


def require_quarter_car(network: Network, what: str) -> None:
    """Check that a network is a quarter car."""
    found = kind(network)
    if found != "quarter car":
        raise InputError(
            f"{what} of a quarter car, but network '{network.name}' is a {found}: choose a network with one corner"
        )


def state_channels(network: Network) -> list[Channel]:
    """Return displacement and velocity of every free node, for the full observation and for pictures."""
    # points follow the body
    points = {p.name for body in network.bodies for p in body.points}
    out = []
    for node in network.nodes:
        if node not in points and node not in network.moved_nodes:
            for quantity in ("displacement", "velocity"):
                out.append(network.probe(f"{node}_{quantity}", quantity, at=node))
    return out
