"""Base classes of the baselines: a model, a memory, and a current for each observation."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from typing import TYPE_CHECKING

import numpy as np

from isd_gym._common.errors import InputError
from isd_gym.env._environment import MEASURED
from isd_gym.physics._vehicle import CURRENT_LIMIT, SLEW_LIMIT, vehicle

if TYPE_CHECKING:
    from isd_gym.physics._vehicle import Vehicle
    from isd_gym.physics.network import Network

__all__ = [
    "BatchController",
    "Controller",
    "Signals",
    "WholeCarController",
    "clean",
    "limit",
    "rises",
    "steps_ahead",
]


_BOUNDS = np.array([[bound] for _, _, bound in MEASURED])
CURRENT = 5  # index of the present current in the observation


class Controller(ABC):
    """A controller of one car: observation in, commanded current out.

    A quarter car has observations (6,) and a current; a car with several motors has observations (signals,)
    and currents (currents,). For any input, commands are finite, at most 5 A, and at most 0.5 A from the
    present current (Table 5).

    Args:
        name: Name in scores.
        model: The network that the controller assumes; the plant may differ.

    Attributes:
        name: Name in scores.
        model: The assumed network.
        fallbacks: Number of steps with a safe substitute for the intended command.
    """

    observation: str = "measured"  # observation of the environment
    preview: float = 0.0  # length of the previewed road, if any [s]

    def __init__(self, name: str, model: Network) -> None:
        self.name, self.model = name, model
        self.fallbacks = 0

    @abstractmethod
    def reset(self) -> None:
        """Clear the memory: a new road starts at rest. The number of fallbacks is kept."""

    @abstractmethod
    def act(self, observation: np.ndarray) -> float | np.ndarray:
        """Return the commanded current for one observation.

        Args:
            observation: Observation (signals,), or longer with preview.

        Returns:
            Current [A], or currents (currents,) [A].
        """


class BatchController(Controller):
    """A controller of many cars; a single car is a batch of one. Subclasses define `_start` and `_command`.

    Args:
        name: Name in scores.
        model: The network that the controller assumes.

    Attributes:
        slew: Largest change of a current per control step [A].
    """

    slew = SLEW_LIMIT

    def reset(self) -> None:
        self.reset_batch(1)

    def reset_batch(self, count: int) -> None:
        """Clear the memory, and start a number of cars.

        Args:
            count: Number of cars.
        """
        self._last = np.zeros(count)
        self._start(count)

    def act(self, observation: np.ndarray) -> float:
        return float(self.act_batch(np.asarray(observation)[None])[0])

    def act_batch(self, observations: np.ndarray) -> np.ndarray:
        """Return the commanded currents; each car has a separate memory.

        Args:
            observations: Observations (n, 6), or wider with preview.

        Returns:
            Currents (n,) [A].
        """
        obs = clean(observations, self._last)
        self._last = limit(self._command(obs), obs[CURRENT], self.slew)
        return self._last

    @abstractmethod
    def _start(self, count: int) -> None: ...

    @abstractmethod
    def _command(self, obs: np.ndarray) -> np.ndarray:
        """Return the wanted currents (n,) for clean observations (6+, n)."""

    def __repr__(self) -> str:
        return f"<{type(self).__name__} {self.name!r} of {self.model.name!r}>"


class Signals:
    """Positions and bounds of the signals in the observation of a car.

    Args:
        car: The car.

    Attributes:
        bounds: Bounds (signals, 1) of the measured signals.
        currents: Positions of the present currents.
    """

    def __init__(self, car: Vehicle) -> None:
        """Find the positions."""
        self.bounds = np.array([[signal.bound] for signal in car.measured])
        self.currents = slice(len(car.measured) - len(car.driven), len(car.measured))

    def clean(self, observations: np.ndarray, last: np.ndarray) -> np.ndarray:
        """Return observations as clean columns, see `clean`.

        Args:
            observations: Observations (cars, signals) of the environment.
            last: Last commands (currents, cars) [A].

        Returns:
            Clean observations (signals, cars).
        """
        return clean(observations, last, self.bounds, self.currents)


class WholeCarController(BatchController):
    """A controller that commands all currents of a car from all signals of the car.

    Subclasses define `_start` and `_command`, with signals (signals, cars) in and wanted currents (currents,
    cars) out.

    Args:
        name: Name in scores.
        model: Network of the assumed car.

    Attributes:
        name: Name in scores.
        model: Network of the assumed car.
        car: The network as a car.
        signals: Positions of the signals in an observation.
    """

    def __init__(self, name: str, model: Network) -> None:
        """Prepare for the observations of a car."""
        super().__init__(name, model)
        self.car = vehicle(model)
        self.signals = Signals(self.car)

    def reset_batch(self, count: int) -> None:
        self._last = np.zeros((len(self.car.driven), count))
        self._start(count)

    def act(self, observation: np.ndarray) -> np.ndarray:  # type: ignore[override]
        return self.act_batch(np.asarray(observation)[None])[0]

    def act_batch(self, observations: np.ndarray) -> np.ndarray:
        obs = self.signals.clean(observations, self._last)
        self._last = limit(self._command(obs), obs[self.signals.currents], self.slew)
        return self._last.T


def steps_ahead(preview: float, control_step: float) -> int:
    """Return the number of control steps in a preview.

    Args:
        preview: Preview [s].
        control_step: Control step [s].

    Returns:
        Number of control steps.

    Raises:
        InputError: The preview is negative or no integer multiple of the control step.
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
    """Return the rises of the road in the next control steps.

    Args:
        obs: Clean observations (6 + ..., cars), as returned by `clean`.
        points: Number of control steps.

    Returns:
        Rises (points, cars) [m].

    Raises:
        InputError: The observation shows fewer points.
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
    """Return observations as columns; an invalid number becomes 0, an invalid current the last command.

    Args:
        observations: Observations (n, 6+) of the environment.
        last: Last commands [A], (n,) or (currents, n).
        bounds: Bounds (signals, 1) of the measured signals; by default those of a quarter car.
        currents: Positions of the present currents in an observation; by default that of a quarter car.

    Returns:
        Clean observations (6+, n), float64.
    """
    obs = np.array(np.asarray(observations).T, float)
    if not np.isfinite(obs.sum()):
        broken = ~np.isfinite(obs)
        obs[broken] = 0.0
        obs[currents] = np.where(broken[currents], last, obs[currents])
    signals = obs[: len(bounds)]  # minimum and maximum: np.clip takes several times as long for a single car
    np.minimum(np.maximum(signals, -bounds, out=signals), bounds, out=signals)
    return obs


def limit(wanted: np.ndarray, present: np.ndarray, slew: float = SLEW_LIMIT) -> np.ndarray:
    """Limit currents as in Table 5: |I| <= 5 A and |dI| <= slew; an invalid command holds the present current.

    Args:
        wanted: Wanted currents (n,) [A].
        present: Present currents (n,) [A].
        slew: Largest change of a current [A]; by default that of a control step of 5 ms.

    Returns:
        Commanded currents (n,) [A].
    """
    wanted = np.where(np.isfinite(wanted), wanted, present)
    step = np.minimum(np.maximum(wanted - present, -slew), slew)
    return np.minimum(np.maximum(present + step, -CURRENT_LIMIT), CURRENT_LIMIT)
