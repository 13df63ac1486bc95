"""Policies at the wheel: what can drive, and the one loop in which it drives many cars."""

from __future__ import annotations

import time as clock
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np

from .batch import CURRENT_LIMIT
from .errors import InputError
from .vehicle import kind, vehicle

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from numpy.typing import DTypeLike

    from .env import ISDSuspensionVectorEnv
    from .network import Network


class Controller(Protocol):
    """What can drive. `act` gives the commanded current [A] for an observation (6,), see the environment.

    A controller of a car with several motors gives their currents (currents,) for an observation (signals,).

    Optional: `reset_batch(n)` and `act_batch(observations (n, signals)) -> (n,) or (n, currents)` for many cars at once,
    `fallbacks` (a count), `observation` ("measured", "full" or "preview": what it wants to see), `preview` [s]: how much of
    the road ahead.
    """

    name: str

    def reset(self) -> None:
        """Forget everything: a new road begins at rest."""

    def act(self, observation: np.ndarray) -> float | np.ndarray:
        """Commanded current [A] for one observation, or currents (currents,)."""
        ...


@dataclass(frozen=True)
class Entry:
    """A policy: its name, how to make a controller, and the plant if it is not everybody's.

    name: under which it is scored. make: a fresh controller at every call. network: its plant, None for
    everybody's.
    """

    name: str
    make: Callable[[], Controller]
    network: Network | None = None


class Idle:
    """No current, whatever is seen.

    name: under which it is scored. model: the car, whose motors are left without current; a quarter car if None.
    """

    observation = "measured"
    fallbacks = 0

    def __init__(self, name: str, model: Network | None = None) -> None:
        self.name, self.model = name, model
        self.currents = 1 if model is None else len(vehicle(model).driven)

    def reset(self) -> None:
        """Nothing to forget."""

    def act(self, observation: np.ndarray) -> float | np.ndarray:
        """0 A, for each motor.

        Whatever the observation.
        """
        return 0.0 if self.currents == 1 else np.zeros(self.currents)

    def reset_batch(self, count: int) -> None:
        """Nothing to forget, in any number of cars.

        count: of cars.
        """

    def act_batch(self, observations: np.ndarray) -> np.ndarray:
        """0 A for each of the observations (n, signals): (n,), or (n, currents)."""
        count = len(observations)
        return np.zeros(count) if self.currents == 1 else np.zeros((count, self.currents))


class Crew:
    """One policy at the wheel of `cars` cars: a controller that commands all of them at once, or one in each.

    `observation`: what it wants to see; `preview` [s]: of the road ahead; `times`: processor times of single decisions [s], where there is one controller a car.

    entry: the policy. cars: how many.
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
        """Forget everything: new roads begin."""
        if self.batched:
            self.controllers[0].reset_batch(self.cars)
        else:
            for c in self.controllers:
                c.reset()

    def act(self, observations: np.ndarray) -> np.ndarray:
        """Commanded currents [A] (cars,) or (cars, currents) for observations (cars, n)."""
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
        """How often one of them could not do what it is meant to and did something safe instead."""
        return sum(int(getattr(c, "fallbacks", 0)) for c in self.controllers)


class Leg(NamedTuple):
    """One control step of all cars: what the policy saw (cars, n), commanded [A] (cars, currents) and earned (cars,), and
    what it will see next (cars, n).

    In the order of the fields: step, seen, rewards of `actions`, ahead.
    """

    step: int
    seen: np.ndarray
    actions: np.ndarray
    rewards: np.ndarray
    ahead: np.ndarray


def travel(
    crew: Crew,
    env: ISDSuspensionVectorEnv,
    steps: int,
    *,
    seed: int = 0,
    dtype: DTypeLike = float,
    progress: Callable[[float], None] | None = None,
) -> Iterator[Leg]:
    """Drive all cars of `env` from their start for a number of steps; episode i has the road of seed ``seed + i``.

    dtype: of the commands, which are limited to the action space. progress(share): told now and then. Raises `InputError`
    where a car breaks, and for a policy of a car with another number of currents.

    crew: who drives. env: with as many cars. steps: how many.
    """
    crew.reset()
    obs, _ = env.reset(seed=seed)
    for k in range(steps):
        seen = obs
        actions = _commands(crew, seen, env, dtype)
        obs, rewards, terminated, _, _ = env.step(actions)
        if terminated.any():
            raise InputError(f"'{crew.name}' broke the car in episode {int(np.argmax(terminated))}")
        yield Leg(k, seen, actions, rewards, obs)
        if progress is not None and (k % 100 == 99 or k == steps - 1):
            progress((k + 1) / steps)


def _commands(crew: Crew, seen: np.ndarray, env: ISDSuspensionVectorEnv, dtype: DTypeLike) -> np.ndarray:
    """Return what `crew` commands, within the action space: currents [A] (cars, currents)."""
    count = len(env.task.vehicle.driven)
    found = np.asarray(crew.act(seen), dtype)
    if found.size != crew.cars * count:
        own = found.size // crew.cars
        raise InputError(
            f"'{crew.name}' commands {own} current{'s' * (own != 1)}, but network '{env.network.name}' is a "
            f"{kind(env.network)} with {count}: choose a policy of that car"
        )
    return found.reshape(crew.cars, count).clip(-CURRENT_LIMIT, CURRENT_LIMIT)
