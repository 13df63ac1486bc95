"""The training environment of Stable-Baselines3: the batched car, seen through `Memory`."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from stable_baselines3.common.buffers import ReplayBuffer, RolloutBuffer
from stable_baselines3.common.type_aliases import ReplayBufferSamples
from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper, VecNormalize
from stable_baselines3.common.vec_env.base_vec_env import VecEnvStepReturn

from isd_gym.env import N_MEASURED

from .memory import Memory
from .policy import CURRENT_SIGNAL, FEATURE_LIMIT, Head

ROAD_STRIDE = 2  # control steps between the points of the road ahead
ROAD_RISE = 2e-3  # m, RMS of the paper's road over them


class Remember(VecEnvWrapper):
    """Observations become features of `memory`; actions in [-1, 1] become currents by `head`.

    With ``observation="preview"`` the rises of the road ahead follow, for a critic; `seen` columns are the policy's.

    Cars in groups of `group` drive on the same road, see `GroupBuffer`.

    The reward is `reward_scale` * (reward + `reward_offset`): a matter of conditioning, it changes no optimum
    (episodes end by time alone).
    """

    def __init__(
        self,
        venv: VecEnv,
        memory: Memory,
        head: Head,
        reward_scale: float = 1.0,
        reward_offset: float = 0.0,
        group: int = 1,
    ) -> None:
        points = venv.observation_space.shape[0] - N_MEASURED  # type: ignore[index]
        self.seen = memory.width(N_MEASURED)
        # the columns that are a state: the estimate and the current
        kept = memory.filter.width if memory.filter else 0
        self.core = [CURRENT_SIGNAL, *range(self.seen - kept, self.seen)] if kept else []
        width = self.seen + points // ROAD_STRIDE
        self._road = np.arange(N_MEASURED + ROAD_STRIDE - 1, N_MEASURED + points, ROAD_STRIDE)
        box = spaces.Box(-FEATURE_LIMIT, FEATURE_LIMIT, (width,), np.float32)
        super().__init__(venv, observation_space=box, action_space=spaces.Box(-1.0, 1.0, (1,), np.float32))
        self.memory, self.head, self.group = memory, head, group
        self.reward_scale, self.reward_offset = reward_scale, reward_offset
        #: time spent in the environment and its memory [s]
        self.seconds = 0.0

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        seeds = self.venv.seed(seed)
        inner: Any = self.venv
        # the same generator, so the same car on the same roads for ever
        inner._seeds = [seeds[i - i % self.group] for i in range(self.num_envs)]
        return inner._seeds

    def reset(self) -> np.ndarray:
        obs = self.venv.reset()
        inner: Any = self.venv
        if self.group > 1 and inner._stagger:
            leaders = np.arange(self.num_envs) // self.group * self.group
            inner.env.steps[:] = inner.env.steps[leaders]
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
        self.venv.step_async(self.head.current(actions, self._obs, self._recall))

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


class GroupBuffer(RolloutBuffer):
    """Advantages relative to the other cars of a group, which drive on the same road with their own exploration.

    A road decides more of the next second than any action does; what it does to all cars alike is no longer noise in
    the gradient. The others' advantages do not depend on a car's own actions, so that nothing is biased.
    """

    def __init__(self, *args: Any, group: int = 1, **kwargs: Any) -> None:
        self.group = group
        super().__init__(*args, **kwargs)

    def compute_returns_and_advantage(self, last_values: torch.Tensor, dones: np.ndarray) -> None:
        super().compute_returns_and_advantage(last_values, dones)
        if self.group > 1:
            self.mean_reward = float(self.rewards.mean())
            grouped = self.advantages.reshape(self.buffer_size, -1, self.group)
            grouped -= grouped.mean(axis=2, keepdims=True)
            # nor is it noise in what the critic learns: how the cars of a group differ
            self.returns = self.advantages + self.values


class GroupReplayBuffer(ReplayBuffer):
    """Samples whole groups: `group` cars in a row drove on the same road at the same time; returns over `n_steps`."""

    def __init__(
        self, *args: Any, group: int = 1, n_steps: int = 1, gamma: float = 1.0, **kwargs: Any
    ) -> None:
        self.group, self.n_steps, self.gamma = group, n_steps, gamma
        super().__init__(*args, **kwargs)

    def sample(self, batch_size: int, env: VecNormalize | None = None) -> ReplayBufferSamples:
        """`discounts` (rows, 1) is what is left of the value after the steps: episodes end by time alone."""
        count = max(batch_size // self.group, 1)
        held = self.buffer_size if self.full else self.pos
        steps = min(self.n_steps, held)
        # the newest transitions begin no whole window
        start = np.random.randint(held - steps + 1, size=count)  # noqa: NPY002 (seeded by SB3)
        rows = np.repeat((start + (self.pos if self.full else 0)) % self.buffer_size, self.group)
        first = np.random.randint(self.n_envs // self.group, size=count) * self.group  # noqa: NPY002
        cars = (first[:, None] + np.arange(self.group)).ravel()
        reward, discount = np.zeros(len(rows), np.float32), np.ones(len(rows), np.float32)
        last, running = rows.copy(), np.ones(len(rows), bool)
        for k in range(steps):
            now = (rows + k) % self.buffer_size
            last = np.where(running, now, last)
            reward += np.where(running, discount * self.rewards[now, cars], 0.0)
            discount = np.where(running, discount * np.float32(self.gamma), discount)
            running &= self.dones[now, cars] == 0.0
        data = (
            self.observations[rows, cars],
            self.actions[rows, cars],
            self.next_observations[last, cars],
            np.zeros((len(rows), 1), np.float32),
            reward[:, None],
            discount[:, None],
        )
        return ReplayBufferSamples(*(torch.from_numpy(d) for d in data))
