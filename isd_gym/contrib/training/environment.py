"""Training environment of Stable-Baselines3: the batched car with the features of `Memory`."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

import numpy as np
from gymnasium import spaces
from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper

from isd_gym.agents.policy import FEATURE_LIMIT, Head
from isd_gym.env._task import usual_level

if TYPE_CHECKING:
    from collections.abc import Sequence

    from stable_baselines3.common.vec_env.base_vec_env import VecEnvStepReturn

    from isd_gym.agents._memory import Memory

ROAD_STRIDE = 2  # control steps between the points of the road ahead
ROAD_RISE = 2e-3  # m, RMS of the rises of the paper's road between the points


class Remember(VecEnvWrapper):
    """Vector environment whose observations are features of `memory` and whose actions in [-1, 1], one per
    motor, are currents by `head`.

    The rises of `critic` points of the road ahead of each track follow the features, for a critic; the policy
    sees the first `seen` columns. Cars in groups of `group` drive on the same road, see `ppo` and `sac`. The
    reward is `reward_scale` * (reward + `reward_offset`), for conditioning; this changes no optimum, since
    episodes end by time alone.

    Args:
        venv: Vector environment of cars.
        memory: Features of the observations.
        head: Conversion of an action to a current.
        reward_scale: Factor on the reward.
        reward_offset: Offset of the reward.
        group: Number of consecutive cars on one road.
        critic: Number of points of the road ahead for the critic.
        even: Whether rewards are divided by the level of the road (1 on the paper's road at 20 m/s), so that
            all roads have equal weight; otherwise a rough, fast road has fifty times the weight of a smooth,
            slow road.
    """

    def __init__(
        self,
        venv: VecEnv,
        memory: Memory,
        head: Head,
        reward_scale: float = 1.0,
        reward_offset: float = 0.0,
        group: int = 1,
        critic: int = 0,
        even: bool = False,
    ) -> None:
        task: Any = venv.env.task  # type: ignore[attr-defined]
        signals, currents = len(task.measured), task.batch.of.currents
        self._width = signals + memory.ahead  # number of columns of an observation that the policy sees
        self._present = slice(signals - currents, signals)
        self.seen = memory.width(signals)
        # columns of the state: the estimate and the current
        kept = memory.filter.width if memory.filter else 0
        self.core = [*range(signals - currents, signals), *range(self.seen - kept, self.seen)] if kept else []
        begins = range(signals, signals + task.batch.of.tracks * task.points, max(task.points, 1))
        #: columns of the road ahead that a critic knows, track after track
        self._roads = [slice(b + ROAD_STRIDE - 1, b + critic, ROAD_STRIDE) for b in begins] if critic else []
        self._points = critic // ROAD_STRIDE
        width = self.seen + self._points * len(self._roads)
        box = spaces.Box(-FEATURE_LIMIT, FEATURE_LIMIT, (width,), np.float32)
        acts = spaces.Box(-1.0, 1.0, (currents,), np.float32)
        super().__init__(venv, observation_space=box, action_space=acts)
        self.memory, self.head, self.group = memory, head, group
        self.reward_scale, self.reward_offset = reward_scale, reward_offset
        self.even = even
        self._weights = np.ones(1, np.float32)
        #: time spent in the environment, without the memory [s]
        self.seconds = 0.0

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        seeds = self.venv.seed(seed)
        inner: Any = self.venv
        # equal seeds give equal cars on equal roads for the whole training
        inner._seeds = [seeds[i - i % self.group] for i in range(self.num_envs)]
        return inner._seeds

    def reset(self) -> np.ndarray:
        obs = self.venv.reset()
        inner: Any = self.venv
        if self.group > 1 and inner._stagger:
            leaders = np.arange(self.num_envs) // self.group * self.group
            inner.env.steps[:] = inner.env.steps[leaders]
        assert isinstance(obs, np.ndarray)
        self._recall = self.memory.start(obs[:, : self._width])
        self._obs = obs
        self._weigh()
        return self._features(obs)

    def _weigh(self) -> None:
        """Set the weights of the cars' rewards on their present roads."""
        if self.even:
            inner: Any = self.venv
            batch = inner.env.task.batch
            usual = usual_level(batch)
            levels = np.where(batch.levels > 0.0, batch.levels, usual)  # a bump has weight 1
            self._weights = (usual / levels).astype(np.float32)

    def _features(self, obs: np.ndarray) -> np.ndarray:
        out = np.empty((len(obs), self.observation_space.shape[0]), np.float32)  # type: ignore[index]
        out[:, : self.seen] = self._recall.features
        for k, columns in enumerate(self._roads):
            begin = self.seen + k * self._points
            heights, rises = obs[:, columns], out[:, begin : begin + self._points]
            rises[:, 0] = heights[:, 0]
            np.subtract(heights[:, 1:], heights[:, :-1], out=rises[:, 1:])
            rises *= np.float32(1 / ROAD_RISE)
        return np.clip(out, -FEATURE_LIMIT, FEATURE_LIMIT, out=out)

    @property
    def observations(self) -> np.ndarray:
        """Present observations of the policy (cars, signals, then the road ahead) [SI]."""
        return self._obs[:, : self._width]

    @property
    def present(self) -> np.ndarray:
        """Present currents [A] (cars, currents)."""
        return self._obs[:, self._present]

    def step_async(self, actions: np.ndarray) -> None:
        self.venv.step_async(self.head.current(actions, self.present, self._recall))

    def step_wait(self) -> VecEnvStepReturn:
        begin = time.perf_counter()
        obs, rewards, done, infos = self.venv.step_wait()
        self.seconds += time.perf_counter() - begin
        assert isinstance(obs, np.ndarray)
        if done.any():
            which = np.flatnonzero(done)
            last = obs.copy()
            for i in which:
                last[i] = infos[i]["terminal_observation"]
            self._recall.see(last[:, : self._width])
            final = self._features(last)
            for i in which:
                infos[i]["terminal_observation"] = final[i]
            self._recall.begin(done, obs[done, : self._width])
        else:
            self._recall.see(obs[:, : self._width])
        self._obs = obs
        features = self._features(obs)
        rewards = self.reward_scale * (rewards * self._weights + np.float32(self.reward_offset))
        if done.any():
            self._weigh()
        return features, rewards, done, infos
