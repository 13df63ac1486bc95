"""The training environment of Stable-Baselines3: the batched car, seen through `Memory`."""

from __future__ import annotations

import time

import numpy as np
from gymnasium import spaces
from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper
from stable_baselines3.common.vec_env.base_vec_env import VecEnvStepReturn

from .memory import Memory
from .policy import FEATURE_LIMIT, Head


class Remember(VecEnvWrapper):
    """Observations become features of `memory`; actions in [-1, 1] become currents by `head`.

    The reward is `reward_scale` * (reward + `reward_offset`): a matter of conditioning, it changes no optimum
    (episodes end by time alone).
    """

    def __init__(
        self, venv: VecEnv, memory: Memory, head: Head, reward_scale: float = 1.0, reward_offset: float = 0.0
    ) -> None:
        width = memory.width(venv.observation_space.shape[0])  # type: ignore[index]
        box = spaces.Box(-FEATURE_LIMIT, FEATURE_LIMIT, (width,), np.float32)
        super().__init__(venv, observation_space=box, action_space=spaces.Box(-1.0, 1.0, (1,), np.float32))
        self.memory, self.head = memory, head
        self.reward_scale, self.reward_offset = reward_scale, reward_offset
        #: time spent in the environment and its memory [s]
        self.seconds = 0.0

    def reset(self) -> np.ndarray:
        obs = self.venv.reset()
        assert isinstance(obs, np.ndarray)
        self._recall = self.memory.start(obs)
        self._obs = obs
        return self._features()

    def _features(self) -> np.ndarray:
        return np.clip(self._recall.features, -FEATURE_LIMIT, FEATURE_LIMIT)

    def step_async(self, actions: np.ndarray) -> None:
        self._begin = time.perf_counter()
        self.venv.step_async(self.head.current(actions, self._obs))

    def step_wait(self) -> VecEnvStepReturn:
        obs, rewards, done, infos = self.venv.step_wait()
        assert isinstance(obs, np.ndarray)
        if done.any():
            which = np.flatnonzero(done)
            last = obs.copy()
            for i in which:
                last[i] = infos[i]["terminal_observation"]
            self._recall.see(last)
            final = self._features()
            for i in which:
                infos[i]["terminal_observation"] = final[i]
            self._recall.begin(done, obs)
        else:
            self._recall.see(obs)
        self._obs = obs
        features = self._features()
        rewards = self.reward_scale * (rewards + np.float32(self.reward_offset))
        self.seconds += time.perf_counter() - self._begin
        return features, rewards, done, infos
