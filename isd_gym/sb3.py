"""The batched environment as a `VecEnv` of Stable-Baselines3, without a wrapper or a loop over single environments.

from stable_baselines3 import PPO
from isd_gym.sb3 import make_vec_env

PPO("MlpPolicy", make_vec_env(1024, cars_per_road=8), n_steps=128, batch_size=4096).learn(20_000_000)
"""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from stable_baselines3.common.vec_env import VecEnv

from .env import ISDSuspensionVectorEnv
from .errors import InputError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from stable_baselines3.common.vec_env.base_vec_env import VecEnvIndices, VecEnvObs, VecEnvStepReturn


class BatchedVecEnv(VecEnv):
    """A batch of cars as a vector environment of Stable-Baselines3.

    Observations (count, width) and actions (count, currents) are those of the environment. With ``rescale``, actions are
    in [-1, 1], as Stable-Baselines3 recommends: shares of the limits of the environment's actions. The cars of group k
    equal the single environment of seed ``s + k`` after ``seed(s)``; without groups, car k.

    When an episode ends, `infos` holds its statistics as `Monitor` has them, ``{"r": return, "l": decisions, "t":
    seconds}``. The return is minus the sum of the stage costs of all control steps, whatever the reward of the training
    is. It compares with the returns and the `reward_threshold` of the environment without options.

    Args:
        env_id: Name of the environment.
        count: Number of cars.
        cars_per_road: Number of cars in a group on one road; a relative reward compares the cars of a group.
        rescale: Whether actions are shares of the limits.
        stagger: Whether the ends of the first episodes are spread over the cars, so that the cars do not all
            restart in one step.
        options: Options of the environment (network, road, speed, randomize, ...).

    Raises:
        InputError: The name is no environment of this package, or an option is invalid.
    """

    def __init__(
        self,
        env_id: str = "ISDSuspension-v0",
        count: int = 64,
        *,
        cars_per_road: int = 1,
        rescale: bool = True,
        stagger: bool = False,
        **options: Any,
    ) -> None:
        env = gym.make_vec(env_id, count, autoreset_mode="same_step", cars_per_road=cars_per_road, **options)
        if not isinstance(env.unwrapped, ISDSuspensionVectorEnv):
            raise InputError(f"'{env_id}' is not one of this package's environments")
        self.env: ISDSuspensionVectorEnv = env.unwrapped
        box = self.env.single_action_space
        assert isinstance(box, spaces.Box)
        self._gain = box.high if rescale else None
        action_space = spaces.Box(-1.0, 1.0, box.shape, np.float32) if rescale else box
        self._seeds: list[int | None] = [None] * count  # before super().__init__, which resets the seeds
        self.render_mode = self.env.render_mode
        super().__init__(count, self.env.single_observation_space, action_space)
        self._stagger = stagger
        self._nothing: list[dict[str, Any]] = [{} for _ in range(count)]
        self._returns, self._lengths = np.zeros(count), np.zeros(count, np.int64)
        self._begun = time.time()

    def reset(self) -> VecEnvObs:
        """Put all cars at the start of new roads.

        Returns:
            Observations (count, width).
        """
        given = any(s is not None for s in self._seeds)
        obs, _ = self.env.reset(seed=list(self._seeds) if given else None)
        self._reset_seeds()
        self._reset_options()
        if self._stagger:
            each = self.env.cars_per_road
            share = np.arange(self.num_envs) // each * each / self.num_envs
            self.env.steps[:] = (share * self.env.max_episode_steps).astype(np.int64)
            self.env._oldest = int(self.env.steps.max())
        self._returns[:], self._lengths[:] = 0.0, 0
        return obs

    def step_async(self, actions: np.ndarray) -> None:
        """Store the actions of the next step.

        Args:
            actions: Actions (count, currents).
        """
        self._actions = actions if self._gain is None else actions * self._gain

    def step_wait(self) -> VecEnvStepReturn:
        """Run one decision with the stored actions.

        Returns:
            Observations (count, width), rewards (count,), ends of episodes (count,) and information per car.
        """
        obs, rewards, terminated, truncated, info = self.env.step(self._actions)
        done = terminated | truncated
        infos = self._nothing
        ended = "final_obs" in info
        self._returns -= np.where(done, info["final_info"]["cost"], info["cost"]) if ended else info["cost"]
        self._lengths += 1
        if ended:
            infos, now = list(self._nothing), time.time() - self._begun
            hold = self.env.task.options.hold
            for i in np.flatnonzero(done):
                statistics = {"r": hold * float(self._returns[i]), "l": int(self._lengths[i]), "t": now}
                infos[i] = {
                    "terminal_observation": info["final_obs"][i],
                    "TimeLimit.truncated": bool(truncated[i] and not terminated[i]),
                    "episode": statistics,
                }
            self._returns[done], self._lengths[done] = 0.0, 0
        return obs, rewards.astype(np.float32), done, infos

    def close(self) -> None:
        """Close the environment."""
        self.env.close()

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        """Set the seeds of the next `reset`.

        Args:
            seed: Seed of the first road; None for a random seed.

        Returns:
            Seed of each car.
        """
        if seed is None:
            seed = int(np.random.default_rng().integers(2**31))
        self._seeds = [seed + i // self.env.cars_per_road for i in range(self.num_envs)]
        return self._seeds

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """Return an attribute of the environment for each car.

        Args:
            attr_name: Name of the attribute.
            indices: Indices of the cars; None for all.

        Returns:
            The same value for each car.
        """
        value = getattr(self.env, attr_name)
        return [value for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:
        """Raise an error: the cars of a batch share their attributes.

        Args:
            attr_name: Name of the attribute.
            value: Value.
            indices: Indices of the cars.

        Raises:
            InputError: Always.
        """
        raise InputError("the cars of a batch share their attributes: give options to make_vec_env instead")

    def env_method(
        self, method_name: str, *args: Any, indices: VecEnvIndices = None, **kwargs: Any
    ) -> list[Any]:
        """Raise an error: the cars of a batch have no separate methods.

        Args:
            method_name: Name of the method.
            args: Arguments.
            indices: Indices of the cars.
            kwargs: Arguments by name.

        Returns:
            Nothing; the function never returns.

        Raises:
            InputError: Always.
        """
        raise InputError(f"the cars of a batch have no methods of their own (env_method '{method_name}')")

    def env_is_wrapped(
        self, wrapper_class: type[gym.Wrapper[Any, Any, Any, Any]], indices: VecEnvIndices = None
    ) -> list[bool]:
        """Return whether cars are wrapped; a batch has no wrappers of single cars.

        Args:
            wrapper_class: Class of a wrapper.
            indices: Indices of the cars; None for all.

        Returns:
            False for each car.
        """
        return [False for _ in self._get_indices(indices)]

    def get_images(self) -> Sequence[np.ndarray | None]:
        """Return the pictures of the cars.

        Returns:
            Picture (height, width, 3) of each car; None without pictures.
        """
        frames: list[np.ndarray | None] = [*(self.env.render() or [None] * self.num_envs)]
        return frames


def make_vec_env(
    count: int = 64, *, env_id: str = "ISDSuspensionLearning-v0", **options: Any
) -> BatchedVecEnv:
    """Return a batch of cars as a vector environment of Stable-Baselines3.

    Args:
        count: Number of cars.
        env_id: Name of the environment, by default the one for learning.
        options: Arguments of `BatchedVecEnv` and options of the environment (network, road, speed, randomize,
            ...).

    Returns:
        The vector environment.

    Raises:
        InputError: The name is no environment of this package, or an option is invalid.
    """
    return BatchedVecEnv(env_id, count, **options)
