"""The training environment of Stable-Baselines3: the batched car, seen through `Memory`."""

from __future__ import annotations

import time

import numpy as np
from gymnasium import spaces
from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper
from stable_baselines3.common.vec_env.base_vec_env import VecEnvStepReturn

from isd_gym.env import N_MEASURED

from .memory import Memory
from .policy import FEATURE_LIMIT, Head

ROAD_STRIDE = 2  # control steps between the points of the road ahead
ROAD_RISE = 2e-3  # m, RMS of the paper's road over them


class Remember(VecEnvWrapper):
    """Observations become features of `memory`; actions in [-1, 1] become currents by `head`.

    With ``observation="preview"`` the rises of the road ahead follow, for a critic; `seen` columns are the policy's.

    The reward is `reward_scale` * (reward + `reward_offset`): a matter of conditioning, it changes no optimum
    (episodes end by time alone).
    """

    def __init__(
        self, venv: VecEnv, memory: Memory, head: Head, reward_scale: float = 1.0, reward_offset: float = 0.0
    ) -> None:
        points = venv.observation_space.shape[0] - N_MEASURED  # type: ignore[index]
        self.seen = memory.width(N_MEASURED)
        width = self.seen + points // ROAD_STRIDE
        self._road = np.arange(N_MEASURED + ROAD_STRIDE - 1, N_MEASURED + points, ROAD_STRIDE)
        box = spaces.Box(-FEATURE_LIMIT, FEATURE_LIMIT, (width,), np.float32)
        super().__init__(venv, observation_space=box, action_space=spaces.Box(-1.0, 1.0, (1,), np.float32))
        self.memory, self.head = memory, head
        self.reward_scale, self.reward_offset = reward_scale, reward_offset
        #: time spent in the environment and its memory [s]
        self.seconds = 0.0

    def reset(self) -> np.ndarray:
        obs = self.venv.reset()
        assert isinstance(obs, np.ndarray)
        self._recall = self.memory.start(obs[:, :N_MEASURED])
        self._obs = obs
        return self._features(obs)

    def _features(self, obs: np.ndarray) -> np.ndarray:
        features = self._recall.features
        if len(self._road):
            rise = np.diff(obs[:, self._road], axis=1, prepend=np.float32(0.0)) / np.float32(ROAD_RISE)
            features = np.concatenate([features, rise], axis=1)
        return np.clip(features, -FEATURE_LIMIT, FEATURE_LIMIT)

    @property
    def observations(self) -> np.ndarray:
        """Present measured signals (cars, signals), in SI units."""
        return self._obs[:, :N_MEASURED]

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
            self._recall.see(last[:, :N_MEASURED])
            final = self._features(last)
            for i in which:
                infos[i]["terminal_observation"] = final[i]
            self._recall.begin(done, obs[:, :N_MEASURED])
        else:
            self._recall.see(obs[:, :N_MEASURED])
        self._obs = obs
        features = self._features(obs)
        rewards = self.reward_scale * (rewards + np.float32(self.reward_offset))
        self.seconds += time.perf_counter() - self._begin
        return features, rewards, done, infos
