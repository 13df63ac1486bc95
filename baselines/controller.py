"""What every baseline is: a belief, a memory, and a current for an observation."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from typing import TYPE_CHECKING

import numpy as np

from isd_gym.batch import CURRENT_LIMIT, SLEW_LIMIT
from isd_gym.env import MEASURED
from isd_gym.errors import InputError
from isd_gym.vehicle import vehicle

if TYPE_CHECKING:
    from isd_gym.network import Network
    from isd_gym.vehicle import Vehicle

_BOUNDS = np.array([[bound] for _, _, bound in MEASURED])
CURRENT = 5  # place of the present current in the observation


class Controller(ABC):
    """Observation (6,) in, commanded current [A] out; of a car with several motors (signals,) in and (currents,) out.

    `name`; `model`: the network it believes in, whatever the plant is; `fallbacks`: how often it could not do what it is
    meant to and did something safe instead. Whatever comes in, the command is finite, at most 5 A, and at most 0.5 A
    from the present current (Table 5).
    """

    observation: str = "measured"  # what it wants to see of the environment
    preview: float = 0.0  # s of road ahead, where it wants that

    def __init__(self, name: str, model: Network) -> None:
        self.name, self.model = name, model
        self.fallbacks = 0

    @abstractmethod
    def reset(self) -> None:
        """Forget everything: a new road begins at rest. The count of fallbacks stays."""

    @abstractmethod
    def act(self, observation: np.ndarray) -> float | np.ndarray:
        """Commanded current [A] for one observation (6,), or currents (currents,)."""


class BatchController(Controller):
    """A controller of many cars at once; one car is a batch of one. Subclasses give `_start` and `_command`.

    name: under which it is scored. model: the network it believes in.
    """

    def reset(self) -> None:
        self.reset_batch(1)

    def reset_batch(self, count: int) -> None:
        """Forget everything and drive `count` cars."""
        self._last = np.zeros(count)
        self._start(count)

    def act(self, observation: np.ndarray) -> float:
        return float(self.act_batch(np.asarray(observation)[None])[0])

    def act_batch(self, observations: np.ndarray) -> np.ndarray:
        """Commanded currents [A] (n,) for observations (n, 6), car i with its own memory."""
        obs = clean(observations, self._last)
        self._last = limit(self._command(obs), obs[CURRENT])
        return self._last

    @abstractmethod
    def _start(self, count: int) -> None: ...

    @abstractmethod
    def _command(self, obs: np.ndarray) -> np.ndarray:
        """Wanted currents (n,) for clean observations (6+, n)."""

    def __repr__(self) -> str:
        return f"<{type(self).__name__} {self.name!r} of {self.model.name!r}>"


class Signals:
    """Places and bounds of the signals in the observation of a car.

    Attributes:
        bounds: Bounds (signals, 1) of the measured signals.
        currents: Places of the present currents.
    """

    def __init__(self, car: Vehicle) -> None:
        """Find the places.

        Args:
            car: Car.
        """
        self.bounds = np.array([[signal.bound] for signal in car.measured])
        self.currents = slice(len(car.measured) - len(car.driven), len(car.measured))

    def clean(self, observations: np.ndarray, last: np.ndarray) -> np.ndarray:
        """Return observations as clean columns, see `clean`.

        Args:
            observations: As the environment gives them (cars, signals).
            last: Last commands [A] (currents, cars).
        """
        return clean(observations, last, self.bounds, self.currents)


class WholeCarController(BatchController):
    """A controller that commands all currents of a car from all of its signals.

    Subclasses give `_start` and `_command`, with signals (signals, cars) in and wanted currents (currents, cars) out.

    Attributes:
        name: Name under which it is scored.
        model: Network of the car that is believed in.
        car: The network as a car.
        signals: Places of the signals in an observation.
    """

    def __init__(self, name: str, model: Network) -> None:
        """Prepare for the observations of a car.

        Args:
            name: Name under which it is scored.
            model: Network of the car that is believed in.
        """
        super().__init__(name, model)
        self.car = vehicle(model)
        self.signals = Signals(self.car)

    def reset_batch(self, count: int) -> None:
        """Forget everything and drive `count` cars.

        Args:
            count: Number of cars.
        """
        self._last = np.zeros((len(self.car.driven), count))
        self._start(count)

    def act(self, observation: np.ndarray) -> np.ndarray:  # type: ignore[override]
        return self.act_batch(np.asarray(observation)[None])[0]

    def act_batch(self, observations: np.ndarray) -> np.ndarray:
        """Return commanded currents [A] (cars, currents) for observations (cars, signals), car i with its own memory.

        Args:
            observations: As the environment gives them.
        """
        obs = self.signals.clean(observations, self._last)
        self._last = limit(self._command(obs), obs[self.signals.currents])
        return self._last.T


def steps_ahead(preview: float, control_step: float) -> int:
    """Control steps of road in `preview` [s]; `InputError` unless it is a whole number of them, or 0.

    control_step [s].
    """
    if not (math.isfinite(preview) and preview >= 0):
        raise InputError(f"the preview must be 0 s or more, not {preview:g} s")
    points = round(preview / control_step)
    if abs(points * control_step - preview) > 1e-6 * control_step:
        raise InputError(
            f"a preview of {preview:g} s is no whole number of control steps of {control_step:g} s"
        )
    return points


def rises(obs: np.ndarray, points: int) -> np.ndarray:
    """By how much the road rises in each of the next control steps (points, cars) [m], of observations (6 + .., cars).

    obs: columns, as `clean` gives them.
    """
    if len(obs) < len(_BOUNDS) + points:
        raise InputError(f"the observation shows {len(obs) - len(_BOUNDS)} points of road, not {points}")
    return np.diff(obs[len(_BOUNDS) : len(_BOUNDS) + points], axis=0, prepend=0.0)


def clean(
    observations: np.ndarray,
    last: np.ndarray,
    bounds: np.ndarray = _BOUNDS,
    currents: int | slice = CURRENT,
) -> np.ndarray:
    """Observations (n, 6+) as columns (6+, n) float64; a broken number becomes 0, a broken current the last command.

    observations: as the environment gives them. bounds (signals, 1): of the measured signals; currents: places of the present
    currents among them, those of a quarter car by default.
    """
    obs = np.array(np.asarray(observations).T, float)
    if not np.isfinite(obs.sum()):
        broken = ~np.isfinite(obs)
        obs[broken] = 0.0
        obs[currents] = np.where(broken[currents], last, obs[currents])
    signals = obs[: len(bounds)]  # minimum and maximum: np.clip costs a single car several times as much
    np.minimum(np.maximum(signals, -bounds, out=signals), bounds, out=signals)
    return obs


def limit(wanted: np.ndarray, present: np.ndarray) -> np.ndarray:
    """Table 5: |I| <= 5 A and |dI| <= 0.5 A; a command that is not a number holds the present current.

    wanted, present (n,) [A].
    """
    wanted = np.where(np.isfinite(wanted), wanted, present)
    step = np.minimum(np.maximum(wanted - present, -SLEW_LIMIT), SLEW_LIMIT)
    return np.minimum(np.maximum(present + step, -CURRENT_LIMIT), CURRENT_LIMIT)
