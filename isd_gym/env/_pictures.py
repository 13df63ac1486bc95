"""Content of a picture of a car: state, road behind and ahead, and recent history."""

from __future__ import annotations

import math
from collections import deque
from typing import TYPE_CHECKING

import numpy as np

from ..physics import elements as el
from ..physics.network import GROUND
from ..physics.vehicle import CURRENT_LIMIT, Corner
from .task import PICTURE_WINDOW, Task

if TYPE_CHECKING:
    from ..view.rendering import CarSnapshot, CornerSnapshot

PAST = 4.0  # length of the curves [s]


class Onlooker:
    """Follows one car of a task that was made with `picture`, and makes snapshots of the car."""

    def __init__(self, task: Task, car: int) -> None:
        """Follow a car from its next start."""
        self.task, self.car = task, car
        step = task.decision
        window = PICTURE_WINDOW + max(task.vehicle.wheels.behind)
        #: heights of the tracks under their first wheels [m], one row per decision
        self._trail: deque[tuple[float, ...]] = deque(
            maxlen=1 + math.ceil(window / (task.slowest * step))
        )
        #: time [s] and values of the curves [SI], one row per decision
        self._past: deque[tuple[float, ...]] = deque(maxlen=1 + math.ceil(PAST / step))
        self._static = task.vehicle.static_tyre_loads
        self.start()

    def start(self) -> None:
        """Clear the memory: the car is at rest at the start of a new road."""
        self._steps = 0
        self._cost = 0.0
        self._trail.clear()
        self._trail.append((0.0,) * self.task.batch.of.tracks)
        self._past.clear()

    def see(self, steps: int, reward: float) -> None:
        """Store a decision."""
        batch = self.task.batch
        self._steps = steps
        self._cost -= reward
        self._trail.append(tuple(batch.track_heights[:, self.car].tolist()))
        # signals with a curve: a quarter car shows its travel, too
        curves = batch.of.accelerations + (not self.task.network.bodies)
        self._past.append(
            (steps * self.task.decision, *batch.out[:curves, self.car].tolist())
        )

    def snapshot(self) -> CarSnapshot:
        """Return the content of a picture of the car."""
        from ..view.rendering import CarSnapshot

        batch, car = self.task.batch, self.task.vehicle
        values = batch.out[:, self.car].tolist()
        accelerations = dict(zip(("vertical", *car.axes), values, strict=False))
        places = self._places()
        heave = places[car.body]
        angles = {axis: places[node] for axis, node in car.angles.items()}
        corners = []
        for number, corner in enumerate(car.corners):
            above = (
                heave
                - corner.x * angles.get("pitch", 0.0)
                + corner.y * angles.get("roll", 0.0)
            )
            corners.append(self._corner(number, corner, places, above))
        carried = {car.body, *(corner.body for corner in car.corners)}
        speed = float(batch.speeds[self.car])
        step = self.task.decision * speed
        return CarSnapshot(
            time=self._steps * self.task.decision,
            heave=heave,
            pitch=angles.get("pitch"),
            roll=angles.get("roll"),
            corners=tuple(corners),
            points={
                name: place for name, place in car.points.items() if name not in carried
            },
            road_profiles=np.array(
                [self._road(track) for track in range(batch.of.tracks)]
            ),
            road_step=step,
            road_behind=(len(self._trail) - 1) * step,
            speed=speed,
            body_acceleration=accelerations["vertical"],
            pitch_acceleration=accelerations.get("pitch"),
            roll_acceleration=accelerations.get("roll"),
            suspension_travel=None
            if self.task.network.bodies
            else values[batch.of.accelerations],
            cost=self._cost / max(self._steps, 1),
            label=self.task.network.name,
            past=tuple(self._past),
        )

    def _places(self) -> dict[str, float]:
        """Return displacement [m] or angle [rad] of every free node."""
        batch = self.task.batch
        return {
            channel.name.removesuffix("_displacement"): float(batch.out[j, self.car])
            for j, channel in enumerate(batch.channels)
            if channel.name.endswith("_displacement")
        }

    def _corner(
        self, number: int, corner: Corner, places: dict[str, float], body: float
    ) -> CornerSnapshot:
        from ..view.rendering import CornerSnapshot

        batch, net = self.task.batch, self.task.network
        first, second = (
            (n if n != GROUND else None for n in corner.device)
            if corner.motor is not None
            else (None, None)
        )
        stops = [
            e
            for e in net.elements
            if isinstance(e, el.BumpStop) and e.between == (first, second)
        ]
        driven = self.task.vehicle.driven
        current = (
            batch.currents[driven.index(corner), self.car] if corner in driven else 0.0
        )
        return CornerSnapshot(
            name=corner.name,
            x=corner.x,
            y=corner.y,
            body=body,
            wheel=places[corner.wheel],
            piston=places.get(str(first)) if first not in net.masses else None,
            joint=places.get(str(second)) if second not in net.masses else None,
            current=float(current),
            current_limit=CURRENT_LIMIT if first is not None else None,
            tyre_load=float(batch.out[batch.of.measured + number, self.car]),
            static_tyre_load=self._static[number],
            device_travel_limit=stops[0].clearance if stops else None,
        )

    def _road(self, track: int) -> np.ndarray:
        batch = self.task.batch
        trail = np.array([heights[track] for heights in self._trail])
        here = float(batch.track_heights[track, self.car])
        return np.concatenate([trail, here + batch.road_ahead(track=track)[self.car]])
