"""The vector environment in a form for learning algorithms of any library: cars on shared roads, scaled
features, increments as actions.

env = SharedRoads(gymnasium.make_vec("ISDSuspension-v0", 512, autoreset_mode="same_step"), each=8,
seed=1_000_000)
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

#: RMS of each kind of measured signal on the paper's road, rounded, and RMS of its change in one control
#: step, in SI units
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
#: sizes for the signals of a quarter car
SCALE, CHANGE = (np.array([SIZES[name][i] for name, _, _ in MEASURED], np.float32) for i in (0, 1))
#: RMS of the body's vertical velocity [m/s], pitch rate and roll rate [rad/s]
VELOCITIES = {"vertical": 0.07, "pitch": 0.025, "roll": 0.027}
FADES = 1.0  # time constant of the leaky integrals [s]
REWARD = 0.1  # reward per advantage over the group


class SharedRoads(VectorWrapper):
    """Groups of cars on shared roads; the reward of a car is its advantage over its group.

    The common effect of the road on a group cancels: a single action changes only a thousandth of that
    effect. Group k drives on the road of seed ``seed + k``, and then on the next roads of that seed.

    Observations (cars, `features`) are the measured signals over their sizes, their changes over the sizes of
    the changes, and the velocities of the body, as leaky integrals of its accelerations: 13 numbers for a
    quarter car, 26 for a half car, 49 for a full car. Actions (cars, `increments`) in [-1, 1] are the change
    of each current as a share of the drive's largest change per step. `cost` is the mean stage cost of the
    last step; its mean over time is J.

    Args:
        env: Vector environment with the measured observation and automatic reset in the same step.
        each: Number of cars per group.
        seed: Seed of the first group.

    Raises:
        InputError: The cars are no multiple of `each`, or the observation is not the measured one.
    """

    def __init__(self, env: VectorEnv[Any, Any, Any], *, each: int = 8, seed: int = 1_000_000) -> None:
        """Wrap a vector environment."""
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
        self.autoreset_mode = env.metadata["autoreset_mode"]  # attribute that TorchRL reads
        self.each = each
        self.seeds: Any = np.repeat(seed + np.arange(env.num_envs // each), each).tolist()
        self.cost = 0.0

    def reset(self, *, seed: Any = None, options: Any = None) -> tuple[np.ndarray, dict[str, Any]]:
        """Put all groups at the start of their first roads.

        Args:
            seed: Without effect; the groups have fixed seeds.
            options: Options of the environment's `reset`.

        Returns:
            Observations (cars, features) and information.
        """
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
        """Run one control step.

        Args:
            actions: Actions (cars, increments) in [-1, 1].

        Returns:
            Observations (cars, features), rewards (cars,) of sum zero in every group, `terminated` (cars,),
                `truncated` (cars,) and information.
        """
        last = self._seen
        currents = last[:, -self._currents :] + SLEW_LIMIT * np.clip(actions, -1.0, 1.0)
        self._seen, reward, terminated, truncated, info = self.env.step(currents)
        ended = np.flatnonzero(info.get("_final_obs", np.zeros(0)))
        for i in ended:  # the last observation of a road, in terms of the features
            final = info["final_obs"][i][None]
            info["final_obs"][i] = self._features(final, last[i][None], _faded(self._velocity[i], final))[0]
        self._velocity = _faded(self._velocity, self._seen)
        end = terminated | truncated
        begin = self._ended if self.autoreset_mode is AutoresetMode.NEXT_STEP else end
        self._ended = end
        if begin.any():  # a new road: all memory of the preceding road is cleared
            last = np.where(begin[:, None], self._seen, last)
            self._velocity[begin] = 0.0
        self.cost = -float(reward.mean())
        by_road = reward.reshape(-1, self.each)
        better = REWARD * (by_road - by_road.mean(axis=1, keepdims=True)).ravel()
        return self._told(last), better, terminated, truncated, info


def _faded(velocity: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """Return the body's velocities (cars, motions) a control step later: leaky integrals of its accelerations,
    the first signals."""
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
    """Return J of a policy on the roads of the score.

    These roads should not be used for training.

    Args:
        act: ``act(features (roads, n)) -> actions (roads, currents)``, see `SharedRoads`.
        roads: Number of roads.
        steps: Number of control steps per road; 20 s by default.
        name: Name of the environment.

    Returns:
        Mean stage cost J [-].
    """
    env = SharedRoads(gym.make_vec(name, roads, autoreset_mode="disabled"), each=1, seed=0)
    features, _ = env.reset()
    costs = []
    for _ in range(steps):
        features, *_ = env.step(act(features))
        costs.append(env.cost)
    return float(np.mean(costs))
