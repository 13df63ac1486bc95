"""The vector environment as learning algorithms of any library like it: cars that share a road, scaled features, increments.

env = SharedRoads(gymnasium.make_vec("ISDSuspension-v0", 512, autoreset_mode="same_step"), each=8, seed=1_000_000)
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv, VectorWrapper
from gymnasium.vector.utils import batch_space

from .batch import SLEW_LIMIT
from .env import CONTROL_STEP, MEASURED
from .errors import InputError

if TYPE_CHECKING:
    from collections.abc import Callable

#: RMS of each kind of measured signal on the paper's road, rounded, and of its change in one control step, in SI units
SIZES = {
    "body_acceleration": (1.0, 0.25),
    "pitch_acceleration": (0.4, 0.1),
    "roll_acceleration": (0.75, 0.25),
    "suspension_travel": (0.01, 0.001),
    "suspension_travel_rate": (0.2, 0.06),
    "device_travel": (0.01, 0.0005),
    "device_travel_rate": (0.05, 0.012),
    "current": (2.5, 0.45),
}
#: the same for the signals of a quarter car
SCALE, CHANGE = (np.array([SIZES[name][i] for name, _, _ in MEASURED], np.float32) for i in (0, 1))
#: of the body's velocity [m/s], pitch and roll rate [rad/s], the same
VELOCITIES = {"vertical": 0.07, "pitch": 0.025, "roll": 0.027}
FADES = 1.0  # s in which their integrals forget
REWARD = 0.1  # of what a car gains on the others


class SharedRoads(VectorWrapper):
    """Groups of `each` cars on one road; what a car is rewarded for is how much better it does than its group.

    What the road does to all of a group is no noise any more: one action changes a thousandth of it. Observations (cars,
    `features`): the measured signals over their size, their changes over theirs, and the velocities of the body, as leaky
    integrals of its accelerations: 13 numbers of a quarter car, 26 of a half car, 49 of a full car. Actions (cars,
    `increments`) in [-1, 1]: by which share of what the drive allows in a step each current changes. Group k has the
    road of seed ``seed + k``, and then that seed's next ones. `cost`: mean stage cost of the last step, whose mean is J.
    """

    def __init__(self, env: VectorEnv[Any, Any, Any], *, each: int = 8, seed: int = 1_000_000) -> None:
        """env: of measured observations."""
        super().__init__(env)
        if env.num_envs % each:
            raise InputError(f"{env.num_envs} cars are no groups of {each}")
        task: Any = env.unwrapped.task  # type: ignore[attr-defined]
        signals = [signal.kind for signal in task.measured]
        if env.single_observation_space.shape != (len(signals),):
            raise InputError(f"SharedRoads wants the measured observation, {len(signals)} signals")
        self._motions, self._currents = task.batch.of.accelerations, task.batch.of.currents
        self._scale, self._change = (
            np.array([SIZES[kind][i] for kind in signals], np.float32) for i in (0, 1)
        )
        motions = ("vertical", *task.vehicle.axes)
        self._velocity_scale = np.array([VELOCITIES[motion] for motion in motions], np.float32)
        width = 2 * len(signals) + self._motions
        self.features = spaces.Box(-np.inf, np.inf, (width,), np.float32)
        self.increments = spaces.Box(-1.0, 1.0, (self._currents,), np.float32)
        self.single_observation_space, self.single_action_space = self.features, self.increments
        self.observation_space = batch_space(self.features, env.num_envs)
        self.action_space = batch_space(self.increments, env.num_envs)
        self.autoreset_mode = env.metadata["autoreset_mode"]  # where TorchRL looks for it
        self.each = each
        self.seeds: Any = np.repeat(seed + np.arange(env.num_envs // each), each).tolist()
        self.cost = 0.0

    def reset(self, *, seed: Any = None, options: Any = None) -> tuple[np.ndarray, dict[str, Any]]:
        """All groups at the start of their first roads, whatever `seed`."""
        self._seen, info = self.env.reset(seed=self.seeds, options=options)
        self._velocity = np.zeros((self.num_envs, self._motions), np.float32)
        self._ended = np.zeros(self.num_envs, bool)
        return self._told(self._seen), info

    def _told(self, last: np.ndarray) -> np.ndarray:
        return self._features(self._seen, last, self._velocity)

    def _features(self, seen: np.ndarray, last: np.ndarray, velocity: np.ndarray) -> np.ndarray:
        parts = [seen / self._scale, (seen - last) / self._change, velocity / self._velocity_scale]
        return np.hstack(parts).astype(np.float32)

    def step(
        self, actions: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """One control step; the rewards sum up to zero in every group."""
        last = self._seen
        currents = last[:, -self._currents :] + SLEW_LIMIT * np.clip(actions, -1.0, 1.0)
        self._seen, reward, terminated, truncated, info = self.env.step(currents)
        ended = np.flatnonzero(info.get("_final_obs", np.zeros(0)))
        for i in ended:  # the last of a road, in the features' terms, too
            final = info["final_obs"][i][None]
            info["final_obs"][i] = self._features(final, last[i][None], _faded(self._velocity[i], final))[0]
        self._velocity = _faded(self._velocity, self._seen)
        end = terminated | truncated
        begin = self._ended if self.autoreset_mode is AutoresetMode.NEXT_STEP else end
        self._ended = end
        if begin.any():  # a new road: nothing of the last one is remembered
            last = np.where(begin[:, None], self._seen, last)
            self._velocity[begin] = 0.0
        self.cost = -float(reward.mean())
        by_road = reward.reshape(-1, self.each)
        better = REWARD * (by_road - by_road.mean(axis=1, keepdims=True)).ravel()
        return self._told(last), better, terminated, truncated, info


def _faded(velocity: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """The body's velocities (cars, motions) a control step later: the leaky integrals of its accelerations, the first signals."""
    motions = velocity.shape[-1]
    faded: np.ndarray = velocity + CONTROL_STEP * (seen[:, :motions] - velocity / FADES)
    return faded


def cost_of(
    act: Callable[[np.ndarray], np.ndarray],
    *,
    roads: int = 32,
    steps: int = 4000,
    name: str = "ISDSuspension-v0",
) -> float:
    """Return J of ``act(features (roads, n)) -> actions (roads, currents)`` on the score's roads.

    Nothing should be trained on these roads.

    Args:
        act: Actions for features, see `SharedRoads`.
        roads: Number of roads.
        steps: Control steps on each road, 20 s unless given.
        name: Name of the environment.
    """
    env = SharedRoads(gym.make_vec(name, roads, autoreset_mode="disabled"), each=1, seed=0)
    features, _ = env.reset()
    costs = []
    for _ in range(steps):
        features, *_ = env.step(act(features))
        costs.append(env.cost)
    return float(np.mean(costs))
