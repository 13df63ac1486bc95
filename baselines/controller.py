"""Base classes of the baselines: a model, a memory, and a current for each observation."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import replace
from typing import Any, Generic, TypeVar

import numpy as np

from isd_gym._common.errors import InputError
from isd_gym.physics.cost import StageCost
from isd_gym.physics.network import Network
from isd_gym.physics.vehicle import CURRENT_LIMIT, SLEW_LIMIT, SLEW_RATE, vehicle

__all__ = [
    "BatchController",
    "DesignedController",
    "clean",
    "limit",
    "rises",
    "steps_ahead",
]


_BOUNDS = np.array(
    [[signal.bound] for signal in vehicle(Network.load("quarter-car-isd")).measured]
)
CURRENT = 5  # index of the present current in the observation of a quarter car
Settings = TypeVar("Settings")


class BatchController(ABC):
    """A controller of one car or of many: observations in, commanded currents out.

    A quarter car has observations (6,) and a current; a car with several corners has observations (signals,)
    and currents (currents,). A single car is a batch of one. For any input, commands are finite, at most 5 A,
    and at most `slew` from the present current (Table 5). Subclasses define `_start` and `_command`.

    Args:
        name: Name in scores.
        model: The network that the controller assumes; the plant may differ.
        control_step: Control step [s].

    Attributes:
        name: Name in scores.
        model: The assumed network.
        car: The assumed network as a car.
        step: Control step [s].
        slew: Largest change of a current per control step [A].
        fallbacks: Number of steps with a safe substitute for the intended command.

    Raises:
        InputError: The network is no car.
    """

    observation: str = "measured"  # observation of the environment
    preview: float = 0.0  # length of the previewed road, if any [s]

    def __init__(self, name: str, model: Network, control_step: float = 5e-3) -> None:
        self.name = name
        self.model = model
        self.car = vehicle(model)
        self.step = control_step
        self.slew = SLEW_RATE * control_step
        self.fallbacks = 0
        signals = len(self.car.measured)
        currents = len(self.car.driven)
        self._bounds = np.array([[signal.bound] for signal in self.car.measured])
        self._is_quarter = len(self.car.corners) == 1
        self._present = (
            CURRENT if self._is_quarter else slice(signals - currents, signals)
        )

    def reset(self) -> None:
        """Clear the memory: a new road starts at rest. The number of fallbacks is kept."""
        self.reset_batch(1)

    def reset_batch(self, count: int) -> None:
        """Clear the memory, and start a number of cars.

        Args:
            count: Number of cars.
        """
        self._last = np.zeros(
            count if self._is_quarter else (len(self.car.driven), count)
        )
        self._start(count)

    def act(self, observation: np.ndarray) -> float | np.ndarray:
        """Return the commanded current for one observation.

        Args:
            observation: Observation (signals,), or longer with preview.

        Returns:
            Current [A], or currents (currents,) [A].
        """
        found = self.act_batch(np.asarray(observation)[None])[0]
        return float(found) if self._is_quarter else found

    def act_batch(self, observations: np.ndarray) -> np.ndarray:
        """Return the commanded currents; each car has a separate memory.

        Args:
            observations: Observations (n, signals), or wider with preview.

        Returns:
            Currents (n,) or (n, currents) [A].
        """
        obs = clean(observations, self._last, self._bounds, self._present)
        self._last = limit(self._command(obs), obs[self._present], self.slew)
        return self._last.T

    @abstractmethod
    def _start(self, count: int) -> None:
        """Clear the memory of a number of cars."""

    @abstractmethod
    def _command(self, obs: np.ndarray) -> np.ndarray:
        """Return the wanted currents (n,) or (currents, n) for clean observations (signals, n)."""

    def __repr__(self) -> str:
        return f"<{type(self).__name__} {self.name!r} of {self.model.name!r}>"


class DesignedController(BatchController, Generic[Settings]):
    """A controller that is designed from a model, a stage cost and settings. Subclasses define `_design`, too.

    Args:
        model: The network that the controller assumes; the plant may differ.
        cost: Minimised stage cost; None for the environment's.
        control_step: Control step [s].
        settings: Settings; None for the defaults of the class.
        name: Name in scores; the usual name of the class unless given.

    Attributes:
        settings: Settings. `tyre_load` is added to the stage cost, `preview` [s] is the known road ahead.
        cost: Minimised stage cost.

    Raises:
        InputError: The network is no car of the controller, or a setting does not fit.
    """

    usual: str
    default: Settings

    def __init__(
        self,
        model: Network,
        cost: StageCost | None = None,
        control_step: float = 5e-3,
        settings: Settings | None = None,
        name: str = "",
    ) -> None:
        super().__init__(name or self.usual, model, control_step)
        self.settings: Any = settings or self.default
        cost = StageCost.of(cost, self.car.axes, len(self.car.corners))
        self.cost = replace(
            cost, tyre_load=cost.tyre_load + getattr(self.settings, "tyre_load", 0.0)
        )
        self.preview = getattr(self.settings, "preview", 0.0)
        self._points = steps_ahead(self.preview, control_step)
        if self._points:
            self.observation = "preview"
        self._design()
        self.reset()

    @abstractmethod
    def _design(self) -> None:
        """Compute all that does not depend on observations."""


def steps_ahead(preview: float, control_step: float) -> int:
    """Return the number of control steps in a preview.

    Args:
        preview: Preview [s].
        control_step: Control step [s].

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
        raise InputError(
            f"the observation shows {len(obs) - len(_BOUNDS)} points of road, not {points}"
        )
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
    # minimum and maximum: np.clip takes several times as long for a single car
    signals = obs[: len(bounds)]
    np.minimum(np.maximum(signals, -bounds, out=signals), bounds, out=signals)
    return obs


def limit(
    wanted: np.ndarray, present: np.ndarray, slew: float = SLEW_LIMIT
) -> np.ndarray:
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
