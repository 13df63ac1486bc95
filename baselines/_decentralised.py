"""Decentralised control of a car with several corners: one controller of a quarter car per corner, with local measurements.

The corner of a half or full car measures the vertical acceleration of the body above, z - x pitch + y roll,
its own travels and rates, and its own current. Its model is the quarter car of `Vehicle.quarter_car`.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from isd_gym.physics.vehicle import Vehicle, vehicle

from .controller import BatchController, steps_ahead
from .lqg import STEEPEST

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from isd_gym.physics.cost import StageCost
    from isd_gym.physics.network import Network

#: measured signals of a corner, in the order of a quarter car's observation after the acceleration
OWN = (
    "suspension_travel",
    "suspension_travel_rate",
    "device_travel",
    "device_travel_rate",
    "current",
)


def _corner_view(car: Vehicle) -> np.ndarray:
    """Return the matrix (corners with a current, 6, signals) from the observation of a car to those of quarter cars."""
    names = [signal.name for signal in car.measured]
    view = np.zeros((len(car.driven), 1 + len(OWN), len(names)))
    for i, corner in enumerate(car.driven):
        view[i, 0, : 1 + len(car.axes)] = car.arms(corner.x, corner.y)
        for j, kind in enumerate(OWN, 1):
            view[i, j, names.index(corner.named(kind))] = 1.0
    return view


def at_each_corner(
    model: Network,
    cost: StageCost,
    make: Callable[[Network, StageCost], BatchController],
) -> list[BatchController]:
    """Return a controller for each corner with a current."""
    car = vehicle(model)
    return [make(car.quarter_car(corner), cost.of_corner) for corner in car.driven]


class Decentralised(BatchController):
    """Independent controllers of quarter cars at the corners of a car, in the order of the currents."""

    def __init__(
        self, name: str, model: Network, corners: Sequence[BatchController]
    ) -> None:
        """Store the controllers of the corners."""
        super().__init__(name, model)
        self.corners = list(corners)
        self._view = _corner_view(self.car)
        self.reset()

    def _start(self, count: int) -> None:
        for c in self.corners:
            c.reset_batch(count)

    def act_batch(self, observations: np.ndarray) -> np.ndarray:
        own = self.observed(np.asarray(observations, float))
        self._last = np.stack(
            [c.act_batch(obs) for c, obs in zip(self.corners, own, strict=True)]
        )
        self.fallbacks = sum(c.fallbacks for c in self.corners)
        return self._last.T

    def _command(self, obs: np.ndarray) -> np.ndarray:
        raise NotImplementedError  # the corners clean their observations and limit their currents

    def observed(self, observations: np.ndarray) -> list[np.ndarray]:
        """Return the local observations of the corners."""
        seen = observations[:, : self._view.shape[2]]
        with np.errstate(invalid="ignore"):
            return [_through(view, seen) for view in self._view]


class Previewing(Decentralised):
    """Controllers with preview at the corners of a car that sees its tracks ahead of the first axle.

    The road ahead of a wheel behind the first axle begins with the heights that the first axle has met.

    Args:
        speed: Speed of the car [m/s].
    """

    observation = "preview"

    def __init__(
        self,
        name: str,
        model: Network,
        corners: Sequence[BatchController],
        speed: float,
        control_step: float,
    ) -> None:
        """Store the controllers of the corners."""
        super().__init__(name, model, corners)
        self.preview = corners[0].preview
        self._points = steps_ahead(self.preview, control_step)
        wheels = self.car.wheels
        delays = wheels.delays(speed, control_step)
        driven = map(self.car.corners.index, self.car.driven)
        self._wheels = [(wheels.track[i], float(delays[i])) for i in driven]
        self._tracks = wheels.tracks
        self._kept = math.ceil(max(delays)) + 1
        self.reset()

    def _start(self, count: int) -> None:
        super()._start(count)
        if hasattr(self, "_tracks"):
            # heights met by the first axle, newest last [m]
            self._met = np.zeros((count, self._tracks, self._kept))
            # rise of the next control step [m]
            self._next = np.zeros((count, self._tracks))

    def observed(self, observations: np.ndarray) -> list[np.ndarray]:
        """Return the local observations of the corners, each with the road ahead of its wheel."""
        width = self._view.shape[2]
        shown = np.nan_to_num(observations[:, width:], nan=0.0, posinf=0.0, neginf=0.0)
        ahead = shown.reshape(len(shown), self._tracks, -1)[:, :, : self._points]
        now = self._met[:, :, -1:] + self._next[:, :, None]
        self._met = np.concatenate([self._met[:, :, 1:], now], axis=2)
        self._next = np.clip(ahead[:, :, 0], -STEEPEST, STEEPEST)
        # of each track, over time
        profile = np.concatenate([self._met, now + ahead], axis=2)
        out = []
        for own, (track, delay) in zip(
            super().observed(observations), self._wheels, strict=True
        ):
            places = self._kept - 1 - delay + np.arange(self._points + 1)
            low = np.floor(places + 1e-9).astype(int)
            part = places - low
            heights = (1.0 - part) * profile[:, track, low]
            heights += (
                part * profile[:, track, np.minimum(low + 1, profile.shape[2] - 1)]
            )
            out.append(np.hstack([own, heights[:, 1:] - heights[:, :1]]))
        return out


def _through(view: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """Return ``seen @ view.T``, in which a broken signal breaks only the signals that are made of it."""
    out = np.zeros((len(seen), len(view)))
    for i, j in zip(*np.nonzero(view), strict=True):
        out[:, i] += view[i, j] * seen[:, j]
    return out
