"""Policies that drive: the interface of controllers, and the loop in which a policy drives many cars."""

from __future__ import annotations

import math
import time as clock
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np

from .._common.errors import InputError, shown
from .._common.inputs import check_memory
from .._common.seeds import generators
from ..env import Sensors
from ..physics.road import Road, paper_road
from ..physics.road import road as find_road
from ..physics.vehicle import CURRENT_LIMIT, Vehicle, kind, vehicle

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from numpy.typing import DTypeLike

    from ..env import ISDSuspensionVectorEnv
    from ..physics.network import Network

__all__ = [
    "Conditions",
    "Controller",
    "Entry",
    "cost_of",
]


def rounded(values: np.ndarray) -> list[float]:
    """Return values with nine significant digits, as files store them."""
    return [float(f"{value:.9g}") for value in values]


@dataclass(frozen=True)
class Conditions:
    """Conditions under which policies drive.

    Attributes:
        road: Road; a name or a file is read.
        speed: Speed [m/s].
        episodes: Number of episodes, on consecutive roads.
        seed: Seed of episode 0; None for the scoring roads.
        duration: Length of an episode [s].
        sensors: Imperfections of the sensors.
    """

    road: Road = field(default_factory=paper_road)
    speed: float = 20.0
    episodes: int = 32
    seed: int | None = None
    duration: float = 20.0
    sensors: Sensors = field(default_factory=Sensors)

    def __post_init__(self) -> None:
        object.__setattr__(self, "road", find_road(self.road))
        object.__setattr__(self, "sensors", Sensors.of(self.sensors))

    @property
    def fingerprints(self) -> list[list[float]]:
        """Fingerprint of each episode's road: its heights [m] at every tenth of the episode."""
        out = []
        for rng in generators(self.seed, 0, self.episodes):
            heights = self.road.heights(self.duration, speed=self.speed, rng=rng)
            rows = heights[np.linspace(0, len(heights) - 1, 11).astype(int)[1:]]
            out.append(rounded(rows))
        return out

    def check(self, car: Vehicle) -> None:
        """Check before long work that number and length of episodes are positive, and that their signals fit into the memory."""
        from ..env.task import CONTROL_STEP

        episodes = self.episodes
        duration = self.duration
        if episodes < 1:
            raise InputError(f"episodes must be at least 1, not {episodes}")
        if not 0 < duration < math.inf:
            raise InputError(f"duration must be positive and finite, not {duration}")
        # twice: the signals and their measures
        signals = 2 * (len(car.channels) + len(car.driven))
        what = f"{shown(episodes)} episode{'s' * (episodes != 1)} of {duration:g} s"
        # huge integers have no float
        size = 8.0 * signals * duration / CONTROL_STEP * min(episodes, 10**30)
        check_memory(size, what, "score fewer or shorter episodes")


class Controller(Protocol):
    """Interface of a controller.

    A quarter car has one current per observation (6,). A car with several motors has currents (currents,) per
    observation (signals,).

    Only `act` is required. A controller without a memory needs no `reset`. Optional attributes:

    - `act_batch(observations (n, signals)) -> (n,) or (n, currents)`: currents of many cars at once, in place of `act`.
    - `reset_batch(n)`: clear the memory of n cars; by default `reset`.
    - `name`, `fallbacks` (a count of safe substitute decisions).
    - `observation` ("measured", "full", "history" or "preview"), and `preview` [s], the length of the road ahead.
    """

    name: str

    def reset(self) -> None:
        """Clear the memory: a new road starts at rest."""

    def act(self, observation: np.ndarray) -> float | np.ndarray:
        """Return the commanded current.

        Args:
            observation: Observation (signals,).

        Returns:
            Current [A], or currents (currents,) [A].
        """
        ...


@dataclass(frozen=True)
class Entry:
    """A policy in a score."""

    name: str  # name in the score
    make: Callable[[], Controller]  # returns a new controller at every call
    network: Network | None = None  # plant of the policy; None for the common plant

    def driver(self) -> Driver:
        """Return a new controller with the whole interface."""
        return Driver(self.make(), self.name)


class Driver:
    """A controller of any kind with the whole interface, whose values are checked.

    Args:
        controller: Object with `act`, `act_batch` or both (`Controller`).
        name: Name for messages.

    Attributes:
        observation: Wanted observation.
        preview: Wanted length of the road ahead [s]; 0 without observation "preview".
        is_batched: Whether the controller decides for many cars at once.
        times: Processor times of the decisions of `act` [s].

    Raises:
        InputError: The object has neither `act` nor `act_batch`.
    """

    def __init__(self, controller: Any, name: str) -> None:
        self._controller, self._name = controller, name
        self._act: Callable[[np.ndarray], Any] | None = getattr(controller, "act", None)
        self.is_batched = hasattr(controller, "act_batch")
        if self._act is None and not self.is_batched:
            raise InputError(f"controller '{name}' has no method act(observation)")
        self.observation: str = getattr(controller, "observation", "measured")
        self.preview = (
            float(getattr(controller, "preview", 0.25))
            if self.observation == "preview"
            else 0.0
        )
        self.times: list[float] = []

    @property
    def fallbacks(self) -> int:
        """Number of safe substitute decisions, if the controller counts them."""
        return int(getattr(self._controller, "fallbacks", 0))

    def reset(self, cars: int | None = None) -> None:
        """Clear the memory, if there is one; `cars` is the number of cars of `act_batch`, None for `act`."""
        is_alone = cars is None and self._act is not None
        if not is_alone and hasattr(self._controller, "reset_batch"):
            self._controller.reset_batch(cars or 1)
        elif hasattr(self._controller, "reset"):
            self._controller.reset()

    def act(self, observation: np.ndarray) -> np.ndarray:
        """Return the commanded currents [A] for an observation (signals,)."""
        begin = clock.process_time()
        value = (
            self._act(observation)
            if self._act
            else self._controller.act_batch(observation[None])[0]
        )
        self.times.append(clock.process_time() - begin)
        return self._currents(value, "act")

    def act_batch(self, observations: np.ndarray) -> np.ndarray:
        """Return the commanded currents [A] of all cars for observations (cars, signals)."""
        return self._currents(self._controller.act_batch(observations), "act_batch")

    def _currents(self, value: Any, method: str) -> np.ndarray:
        try:
            found = np.asarray(value, float)
        except (TypeError, ValueError):
            found = np.array(np.nan)
        if not np.isfinite(found).all():
            raise InputError(
                f"'{self._name}': {method} returned {shown(value)}, not a current [A]"
            )
        return found


class Idle:
    """A controller with zero current.

    Args:
        name: Name in the score.
        model: The car, which gives the number of currents; None for a quarter car.
    """

    observation = "measured"
    fallbacks = 0

    def __init__(self, name: str, model: Network | None = None) -> None:
        self.name, self.model = name, model
        self.currents = 1 if model is None else len(vehicle(model).driven)

    def reset(self) -> None:
        """Do nothing: there is no memory."""

    def act(self, observation: np.ndarray) -> float | np.ndarray:
        """Return zero current for each motor."""
        return 0.0 if self.currents == 1 else np.zeros(self.currents)

    def reset_batch(self, count: int) -> None:
        """Do nothing: there is no memory."""

    def act_batch(self, observations: np.ndarray) -> np.ndarray:
        """Return zero current for each motor of each car: (n,) or (n, currents)."""
        count = len(observations)
        return (
            np.zeros(count) if self.currents == 1 else np.zeros((count, self.currents))
        )


class Crew:
    """A policy in several cars, with a common controller or a controller per car.

    `observation` is the wanted observation, `preview` [s] the wanted length of the road ahead.
    """

    def __init__(self, entry: Entry, cars: int) -> None:
        first = entry.driver()
        self.name = entry.name
        self.cars = cars
        self.batched = first.is_batched
        self.observation = first.observation
        self.preview = first.preview
        self._drivers = (
            [first]
            if self.batched
            else [first, *(entry.driver() for _ in range(cars - 1))]
        )

    def reset(self) -> None:
        """Clear the memory: new roads begin."""
        for driver in self._drivers:
            driver.reset(self.cars if self.batched else None)

    def act(self, observations: np.ndarray) -> np.ndarray:
        """Return the commanded currents (cars,) or (cars, currents) [A] for observations (cars, n)."""
        if self.batched:
            return self._drivers[0].act_batch(observations)
        pairs = zip(self._drivers, observations, strict=True)
        return np.asarray([driver.act(observation) for driver, observation in pairs])

    @property
    def times(self) -> list[float]:
        """Processor times of single decisions with one controller per car [s]."""
        return [time for driver in self._drivers for time in driver.times]

    @property
    def fallbacks(self) -> int:
        """Number of safe substitute decisions of all controllers."""
        return sum(driver.fallbacks for driver in self._drivers)


class _Leg(NamedTuple):
    """One control step of all cars."""

    step: int  # index of the step
    seen: np.ndarray  # observations before the step (cars, n)
    actions: np.ndarray  # commanded currents (cars, currents) [A]
    rewards: np.ndarray  # rewards of the step (cars,)
    ahead: np.ndarray  # observations after the step (cars, n)


def travel(
    crew: Crew,
    env: ISDSuspensionVectorEnv,
    steps: int,
    *,
    seed: int | None = None,
    first: int = 0,
    dtype: DTypeLike = float,
    progress: Callable[[float], None] | None = None,
) -> Iterator[_Leg]:
    """Drive all cars from their start, and yield each control step.

    Episode i has the road of seed ``seed + first + i``, or scoring road ``first + i``. Commands are
    limited to the action space; `progress` is called now and then with the finished share.
    """
    crew.reset()
    obs, _ = (
        env.reset(options={"scoring_road": first})
        if seed is None
        else env.reset(seed=seed + first)
    )
    for k in range(steps):
        seen = obs
        actions = _commands(crew, seen, env, dtype)
        obs, rewards, terminated, _, _ = env.step(actions)
        if terminated.any():
            raise InputError(
                f"'{crew.name}' broke the car in episode {int(np.argmax(terminated))}"
            )
        yield _Leg(k, seen, actions, rewards, obs)
        if progress is not None and (k % 100 == 99 or k == steps - 1):
            progress((k + 1) / steps)


def _commands(
    crew: Crew, seen: np.ndarray, env: ISDSuspensionVectorEnv, dtype: DTypeLike
) -> np.ndarray:
    """Return the commands of a crew within the action space (cars, currents) [A]."""
    count = len(env.task.vehicle.driven)
    found = np.asarray(crew.act(seen), dtype)
    if found.size != crew.cars * count:
        own = found.size // crew.cars
        raise InputError(
            f"'{crew.name}' commands {own} current{'s' * (own != 1)}, but network '{env.network.name}' is a "
            f"{kind(env.network)} with {count}: choose a policy of that car"
        )
    return found.reshape(crew.cars, count).clip(-CURRENT_LIMIT, CURRENT_LIMIT)


def cost_of(
    act: Callable[[np.ndarray], np.ndarray],
    *,
    roads: int = 32,
    duration: float = 20.0,
    name: str = "ISDSuspensionLearning-v0",
    **options: Any,
) -> float:
    """Return J of a policy of the environment for learning, on the roads of the score.

    Args:
        act: ``act(observations (roads, n)) -> actions (roads, currents)``.
        roads: Number of roads.
        duration: Length of each road [s].
        name: Name of the environment.
        options: Options of the environment, such as the `action` of the training.

    Returns:
        Mean stage cost J [-].
    """
    import gymnasium

    env = gymnasium.make_vec(
        name,
        roads,
        duration=duration,
        reward="cost",
        autoreset_mode="disabled",
        **options,
    )
    observations, _ = env.reset(options={"scoring_road": 0})
    costs, over = [], False
    while not over:
        observations, _, _, truncated, info = env.step(act(observations))
        costs.append(info["cost"].mean())
        over = bool(truncated.any())
    return float(np.mean(costs))
