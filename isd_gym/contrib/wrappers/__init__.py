"""The options for learning as Gymnasium wrappers, for environments of other packages.

The environments of this package have the same as options, in compiled form and for batches: ``hold=``,
``reward="relative"`` and ``observation="history"``.
"""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces

from isd_gym._common.errors import InputError, shown
from isd_gym._common.inputs import is_whole
from isd_gym.env._history import BOUND, History, Remembered

__all__ = [
    "HistoryObservation",
    "Hold",
    "RelativeReward",
]


class Hold(gym.Wrapper[Any, Any, Any, Any]):
    """Hold each action for several steps; the reward is the mean over these steps.

    Args:
        env: The environment.
        steps: Number of steps.

    Raises:
        InputError: `steps` is no whole number >= 1.
    """

    def __init__(self, env: gym.Env[Any, Any], steps: int) -> None:
        """Wrap an environment."""
        super().__init__(env)
        if not is_whole(steps, 1):
            raise InputError(f"hold must be a whole number of steps from 1 on, not {shown(steps)}")
        self.steps = steps

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Run the steps with one action; an episode may end within them.

        Args:
            action: Action of the environment.

        Returns:
            Last observation, mean reward, whether the episode ended, and the last `info`.
        """
        rewards = []
        for _ in range(self.steps):
            observation, reward, terminated, truncated, info = self.env.step(action)
            rewards.append(float(reward))
            if terminated or truncated:
                break
        return observation, float(np.mean(rewards)), terminated, truncated, info


class RelativeReward(gym.Wrapper[Any, Any, Any, Any]):
    """Reward minus the reward of a reference that meets the same disturbances.

    The reference is a second environment with the same seed and a constant action. Its reward does not depend on the
    actions, so that the optimal policy stays the same, while the common effect of the disturbance cancels (Mao,
    Venkatakrishnan, Schwarzkopf, Alizadeh, "Variance reduction for reinforcement learning in input-driven
    environments", ICLR 2019). `info["reward"]` is the reward of the environment.

    Args:
        env: The environment.
        reference: A second environment with equal options.
        action: Action of the reference.
        scale: Factor on the difference.

    Raises:
        InputError: The action is none of the reference, or the spaces differ.
    """

    def __init__(
        self, env: gym.Env[Any, Any], reference: gym.Env[Any, Any], action: Any, scale: float = 1.0
    ) -> None:
        """Wrap an environment."""
        super().__init__(env)
        if reference is env or reference.unwrapped is env.unwrapped:
            raise InputError("the reference must be an environment of its own")
        if reference.action_space != env.action_space or not reference.action_space.contains(action):
            raise InputError(
                f"the reference cannot do {shown(action)}: it needs an action of the environment"
            )
        self.reference, self.action, self.scale = reference, action, scale
        self._draws: np.random.Generator | None = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Start both environments with the same seed.

        Args:
            seed: Seed of the episode; None for a new one.
            options: Options of both environments.

        Returns:
            Observation and `info`.
        """
        if seed is not None or self._draws is None:
            self._draws = np.random.default_rng(seed)
        if seed is None:
            seed = int(self._draws.integers(2**31))
        self.reference.reset(seed=seed, options=options)
        return self.env.reset(seed=seed, options=options)

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Run a step of both environments.

        Args:
            action: Action of the environment.

        Returns:
            Observation, relative reward, whether the episode ended, and `info`.

        Raises:
            InputError: The reference ended before the environment.
        """
        observation, reward, terminated, truncated, info = self.env.step(action)
        _, other, gone, over, _ = self.reference.step(self.action)
        if (gone or over) and not (terminated or truncated):
            raise InputError("the reference cannot go on: its episode ended before that of the environment")
        relative = self.scale * (float(reward) - float(other))
        return observation, relative, terminated, truncated, {**info, "reward": float(reward)}


class HistoryObservation(gym.Wrapper[Any, Any, Any, Any]):
    """Scaled signals, their changes and leaky integrals, each within ±10 (`isd_gym.env._history`).

    Args:
        env: Environment whose observation is a vector of signals.
        history: Definition of the numbers; its `step` is the time between two observations.

    Raises:
        InputError: The observation is no vector with a scale for each signal.
    """

    def __init__(self, env: gym.Env[Any, Any], history: History) -> None:
        """Wrap an environment."""
        super().__init__(env)
        shape = env.observation_space.shape
        if shape != (len(history.scale),):
            raise InputError(
                f"the history is one of {len(history.scale)} signals, the observation has the shape {shape}"
            )
        self._remembered = Remembered(history, 1, len(history.scale))
        width = self._remembered.features.shape[1]
        self.observation_space = spaces.Box(-BOUND, BOUND, (width,), np.float32)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Start an episode without a past.

        Args:
            seed: Seed of the episode.
            options: Options of the environment.

        Returns:
            Observation and `info`.
        """
        signals, info = self.env.reset(seed=seed, options=options)
        self._remembered.begin(np.array([0]), np.asarray(signals, np.float32)[None])
        return self._present(), info

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Run a step.

        Args:
            action: Action of the environment.

        Returns:
            Observation, reward, whether the episode ended, and `info`.
        """
        signals, reward, terminated, truncated, info = self.env.step(action)
        self._remembered.see(np.asarray(signals, np.float32)[None])
        return self._present(), reward, terminated, truncated, info

    def _present(self) -> np.ndarray:
        return np.clip(self._remembered.features[0], -BOUND, BOUND)
