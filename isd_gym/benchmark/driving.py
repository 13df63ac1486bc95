"""Policies that drive: the interface of controllers, and the loop in which a policy drives many cars."""

from __future__ import annotations

import time as clock
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np

from .._common.errors import InputError
from ..physics._vehicle import CURRENT_LIMIT, kind, vehicle

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from numpy.typing import DTypeLike

    from ..env._environment import ISDSuspensionVectorEnv
    from ..physics.network import Network

__all__ = [
    "Controller",
    "Entry",
    "cost_of",
]


class Controller(Protocol):
    """Interface of a controller.

    A quarter car has one current per observation (6,). A car with several motors has currents (currents,) per
    observation (signals,).

    Optional attributes: `reset_batch(n)` and `act_batch(observations (n, signals)) -> (n,) or (n, currents)`
    for many cars, `fallbacks` (a count), `observation` ("measured", "full" or "preview": the wanted
    observation), and `preview` [s] (the wanted length of the road ahead).
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
        return np.zeros(count) if self.currents == 1 else np.zeros((count, self.currents))


class Crew:
    """A policy in several cars, with a common controller or a controller per car.

    `observation` is the wanted observation, `preview` [s] the wanted length of the road ahead, and `times`
    [s] the processor times of single decisions with one controller per car.
    """

    def __init__(self, entry: Entry, cars: int) -> None:
        first: Any = entry.make()
        self.name, self.cars = entry.name, cars
        self.observation: str = getattr(first, "observation", "measured")
        self.preview = float(getattr(first, "preview", 0.25)) if self.observation == "preview" else 0.0
        self.batched = hasattr(first, "act_batch")
        self.controllers = [first] if self.batched else [first, *(entry.make() for _ in range(cars - 1))]
        self.times: list[float] = []

    def reset(self) -> None:
        """Clear the memory: new roads begin."""
        if self.batched:
            self.controllers[0].reset_batch(self.cars)
        else:
            for c in self.controllers:
                c.reset()

    def act(self, observations: np.ndarray) -> np.ndarray:
        """Return the commanded currents (cars,) or (cars, currents) [A] for observations (cars, n)."""
        if self.batched:
            return np.asarray(self.controllers[0].act_batch(observations))
        out = []
        for c, observation in zip(self.controllers, observations, strict=True):
            begin = clock.process_time()
            out.append(c.act(observation))
            self.times.append(clock.process_time() - begin)
        return np.asarray(out)

    @property
    def fallbacks(self) -> int:
        """Number of safe substitute decisions of all controllers."""
        return sum(int(getattr(c, "fallbacks", 0)) for c in self.controllers)


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
    obs, _ = env.reset(options={"scoring_road": first}) if seed is None else env.reset(seed=seed + first)
    for k in range(steps):
        seen = obs
        actions = _commands(crew, seen, env, dtype)
        obs, rewards, terminated, _, _ = env.step(actions)
        if terminated.any():
            raise InputError(f"'{crew.name}' broke the car in episode {int(np.argmax(terminated))}")
        yield _Leg(k, seen, actions, rewards, obs)
        if progress is not None and (k % 100 == 99 or k == steps - 1):
            progress((k + 1) / steps)


def _commands(crew: Crew, seen: np.ndarray, env: ISDSuspensionVectorEnv, dtype: DTypeLike) -> np.ndarray:
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
    hold: int = 1,
) -> float:
    """Return J of a policy of the environment for learning, on the roads of the score.

    Args:
        act: ``act(observations (roads, n)) -> actions (roads, currents)``.
        roads: Number of roads.
        duration: Length of each road [s].
        name: Name of the environment.
        hold: Number of control steps per action; a policy that was trained with a hold may drive without one.

    Returns:
        Mean stage cost J [-].
    """
    import gymnasium

    env = gymnasium.make_vec(
        name, roads, hold=hold, duration=duration, reward="cost", autoreset_mode="disabled"
    )
    observations, _ = env.reset(options={"scoring_road": 0})
    costs, over = [], False
    while not over:
        observations, _, _, truncated, info = env.step(act(observations))
        costs.append(info["cost"].mean())
        over = bool(truncated.any())
    return float(np.mean(costs))
