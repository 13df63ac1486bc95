"""The batched environment as a `VecEnv` of Stable-Baselines3, without a wrapper or a loop over single environments.

from stable_baselines3 import PPO
from isd_gym.sb3 import ScoreCallback, make_vec_env

env = make_vec_env("ISDSuspensionLearning-v0", 1024)
model = PPO("MlpPolicy", env, n_steps=128, batch_size=4096)
model.learn(20_000_000, callback=ScoreCallback())
"""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecEnv

from ._common.errors import InputError
from ._common.files import check_file, whole
from ._common.inputs import is_whole
from .benchmark.driving import Entry
from .benchmark.policies import find, passive
from .benchmark.scoring import IDLE, LEARN, Conditions, drive
from .env import ISDSuspensionVectorEnv
from .env.history import history_of
from .env.task import CONTROL_STEP, Task
from .physics.road import road as find_road
from .physics.vehicle import CURRENT_LIMIT, SLEW_RATE

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from stable_baselines3.common.base_class import BaseAlgorithm
    from stable_baselines3.common.vec_env.base_vec_env import (
        VecEnvIndices,
        VecEnvObs,
        VecEnvStepReturn,
    )


__all__ = [
    "BatchedVecEnv",
    "ScoreCallback",
    "make_vec_env",
    "save_model",
]


DEFAULT_ID = "ISDSuspensionLearning-v0"


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
        env_id: str = DEFAULT_ID,
        count: int = 64,
        *,
        cars_per_road: int = 1,
        rescale: bool = True,
        stagger: bool = False,
        **options: Any,
    ) -> None:
        env = gym.make_vec(
            env_id,
            count,
            autoreset_mode="same_step",
            cars_per_road=cars_per_road,
            **options,
        )
        if not isinstance(env.unwrapped, ISDSuspensionVectorEnv):
            raise InputError(f"'{env_id}' is not one of this package's environments")
        self.env: ISDSuspensionVectorEnv = env.unwrapped
        box = self.env.single_action_space
        assert isinstance(box, spaces.Box)
        self._gain = box.high if rescale else None
        action_space = spaces.Box(-1.0, 1.0, box.shape, np.float32) if rescale else box
        self._seeds: list[int | None] = [
            None
        ] * count  # before super().__init__, which resets the seeds
        self.render_mode = self.env.render_mode
        super().__init__(count, self.env.single_observation_space, action_space)
        self._stagger = stagger
        self._returns = np.zeros(count)
        self._lengths = np.zeros(count, np.int64)
        self._begun = time.time()

    def reset(self) -> VecEnvObs:
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
        self._actions = actions if self._gain is None else actions * self._gain

    def step_wait(self) -> VecEnvStepReturn:
        obs, rewards, terminated, truncated, info = self.env.step(self._actions)
        done = terminated | truncated
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        ended = "final_obs" in info
        self._returns -= (
            np.where(done, info["final_info"]["cost"], info["cost"])
            if ended
            else info["cost"]
        )
        self._lengths += 1
        if ended:
            now = time.time() - self._begun
            hold = self.env.task.options.hold
            for i in np.flatnonzero(done):
                statistics = {
                    "r": hold * float(self._returns[i]),
                    "l": int(self._lengths[i]),
                    "t": now,
                }
                infos[i] = {
                    "terminal_observation": info["final_obs"][i],
                    "TimeLimit.truncated": bool(truncated[i] and not terminated[i]),
                    "episode": statistics,
                }
            self._returns[done], self._lengths[done] = 0.0, 0
        return obs, rewards.astype(np.float32), done, infos

    def close(self) -> None:
        self.env.close()

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        if seed is None:
            seed = int(np.random.default_rng().integers(2**31))
        self._seeds = [seed + i // self.env.cars_per_road for i in range(self.num_envs)]
        return list(self._seeds)

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        value = getattr(self.env, attr_name)
        return [value for _ in self._get_indices(indices)]

    def set_attr(
        self, attr_name: str, value: Any, indices: VecEnvIndices = None
    ) -> None:
        raise InputError(
            "the cars of a batch share their attributes: give options to make_vec_env instead"
        )

    def env_method(
        self, method_name: str, *args: Any, indices: VecEnvIndices = None, **kwargs: Any
    ) -> list[Any]:
        raise InputError(
            f"the cars of a batch have no methods of their own (env_method '{method_name}')"
        )

    def env_is_wrapped(
        self,
        wrapper_class: type[gym.Wrapper[Any, Any, Any, Any]],
        indices: VecEnvIndices = None,
    ) -> list[bool]:
        # a batch has no wrappers of single cars
        return [False for _ in self._get_indices(indices)]

    def get_images(self) -> Sequence[np.ndarray | None]:
        frames: list[np.ndarray | None] = [
            *(self.env.render() or [None] * self.num_envs)
        ]
        return frames


def make_vec_env(
    env_id: str | int = DEFAULT_ID,
    n_envs: int = 64,
    seed: int | None = None,
    *,
    env_kwargs: Mapping[str, Any] | None = None,
    **options: Any,
) -> BatchedVecEnv:
    """Return a batch of cars as a vector environment of Stable-Baselines3.

    The arguments are those of `make_vec_env` of Stable-Baselines3, as far as a batch has them.

    Args:
        env_id: Name of the environment, by default the one for learning; or the number of cars of that one.
        n_envs: Number of cars.
        seed: Seed of the first car; None for random roads.
        env_kwargs: Options of the environment (network, road, speed, randomize, ...).
        options: Further options of the environment, and arguments of `BatchedVecEnv`.

    Raises:
        InputError: The name is no environment of this package, or an option is invalid.
    """
    name, count = (env_id, n_envs) if isinstance(env_id, str) else (DEFAULT_ID, env_id)
    env = BatchedVecEnv(name, count, **{**(env_kwargs or {}), **options})
    if seed is not None:
        env.seed(seed)
    return env


#: seed of the first validation road, far from the seeds of trainings; scoring roads have no seed
VALIDATION_SEED = 4_100_000_000
#: time of the training per time of its evaluations, where no interval is given
_PATIENCE = 20.0


class ScoreCallback(BaseCallback):
    """Score of the policy on validation roads, while a model of Stable-Baselines3 is in training.

    The policy drives deterministically and decides at every control step, without a hold. Vehicle, road, speed, stage
    cost and sensors are those of the training; nothing of `randomize` is drawn. The cost J and the change
    against `passive` appear on the terminal, and in TensorBoard as ``score/J`` and ``score/change_percent``. The
    same roads and the same policies are the scale: ``score/mpc_percent``, ... The training is not influenced: with and
    without the callback, a seed gives the same weights.

    Args:
        every: Number of transitions between evaluations; None for as often as costs a twentieth of the time.
        references: Policies to compare with, which drive once; names for `isd_gym.benchmark.policies.find`.
        roads: Number of validation roads.
        duration: Length of a validation road [s].
        save: File (.zip) of the best model on the validation roads, replaced at every improvement; a VecNormalize
            is saved beside it as <name>_vecnormalize.pkl. None to save nothing.
        verbose: Whether evaluations are printed, 1 or 0.

    Attributes:
        history: Number of transitions, J and change against `passive` [%] of each evaluation.
        references: Change of each reference against `passive` [%].
        seconds: Wall-clock time of all evaluations, without the references [s].

    Raises:
        InputError: An argument is invalid.
    """

    def __init__(
        self,
        every: int | None = None,
        *,
        references: Sequence[str] = ("mpc", "skyhook"),
        roads: int = 32,
        duration: float = 5.0,
        save: str | Path | None = None,
        verbose: int = 1,
    ) -> None:
        super().__init__(verbose)
        for name, value in (("every", every), ("roads", roads)):
            if value is not None and not is_whole(value, 1):
                raise InputError(f"{name} must be a whole number >= 1, not {value!r}")
        if not 0.1 <= duration <= 1e3:
            raise InputError(f"duration must be 0.1 to 1000 s, not {duration!r}")
        if isinstance(references, str):
            raise InputError(
                f"references must be a list of names, such as ['{references}']"
            )
        self._save = None if save is None else str(save).removesuffix(".zip") + ".zip"
        if self._save is not None:
            check_file(self._save)
        self.every = every
        self.roads = roads
        self.duration = float(duration)
        self._wanted = tuple(references)
        self.references: dict[str, float] = {}
        self.history: list[tuple[int, float, float]] = []
        self.seconds = 0.0

    def _on_training_start(self) -> None:
        try:
            task: Task = self.training_env.get_attr("task", [0])[0]
            self._task, options = task, task.options
        except AttributeError:
            raise InputError(
                "ScoreCallback is for the environments of isd_gym"
            ) from None
        space = self.model.observation_space
        if len(space.shape or ()) != 1 or space.shape[0] % task.width:  # type: ignore[index]
            raise InputError(
                f"ScoreCallback: the model has observations of shape {space.shape}, the environment gives ({task.width},)"
            )
        if abs(options.control_step - CONTROL_STEP) > 1e-9:
            raise InputError(
                f"ScoreCallback is for a control step of {CONTROL_STEP:g} s"
            )
        begin = time.perf_counter()
        self._passive = self._cost(passive(task.network))
        self._idle = self._cost(find("isd-passive", task.network))
        found = [
            find(name, task.network, cost=task.cost, speed=options.speed)
            for name in self._wanted
        ]
        self.references = {
            entry.name: self._change(self._cost(entry)) for entry in found
        }
        if self.verbose:
            beside = "".join(
                f", {name} {change:+.1f} %" for name, change in self.references.items()
            )
            print(
                f"score: {self.roads} validation roads of {self.duration:g} s, passive J {self._passive:.4f}{beside}"
                f" ({time.perf_counter() - begin:.1f} s)"
            )
        self._evaluated = self.num_timesteps
        self._free = 0.0
        self._last = time.perf_counter()

    def _cost(self, entry: Entry) -> float:
        """Return J of a policy on the validation roads."""
        task, options = self._task, self._task.options
        conditions = Conditions(
            find_road(options.road),
            options.speed,
            self.roads,
            VALIDATION_SEED,
            self.duration,
            task.sensors,
        )
        run = drive(entry, task.network, conditions, timed=0)
        return float(run.cost(task.cost).mean())

    def _change(self, cost: float) -> float:
        return 100.0 * (cost / self._passive - 1.0)

    def _on_step(self) -> bool:
        if self.every is not None:
            due = self.num_timesteps - self._evaluated >= self.every
        else:
            due = time.perf_counter() - self._last >= max(_PATIENCE * self._free, 2.0)
        if due:
            self._evaluate()
        return True

    def _on_training_end(self) -> None:
        if not self.history or self.history[-1][0] != self.num_timesteps:
            self._evaluate()

    def _evaluate(self) -> None:
        begin = time.perf_counter()
        cost = self._cost(Entry("policy", lambda: _Learner(self.model, self._task)))
        change = self._change(cost)
        best = min((before for _, before, _ in self.history), default=np.inf)
        self.history.append((self.num_timesteps, cost, change))
        self.logger.record("score/J", cost)
        self.logger.record("score/change_percent", change)
        for name, reference in self.references.items():
            self.logger.record(f"score/{name}_percent", reference)
        self.logger.record(
            "time/total_timesteps", self.num_timesteps, exclude="tensorboard"
        )
        self.logger.dump(self.num_timesteps)
        if self.verbose:
            print(
                f"score: {self.num_timesteps:>11,} transitions, J {cost:.4f}, {change:+.2f} % against passive"
            )
            if abs(cost / self._idle - 1.0) < IDLE:
                print(f"score: that is the cost of zero current. {LEARN}")
        if self._save is not None and cost < best:
            save_model(self.model, self._save)
        self._last, self._evaluated = time.perf_counter(), self.num_timesteps
        self._free = self._last - begin
        self.seconds += self._free


def save_model(model: BaseAlgorithm, path: str | Path) -> None:
    """Save a model and its VecNormalize, each as a whole file or not at all.

    Args:
        model: The model.
        path: The .zip file; a VecNormalize is saved beside it as <name>_vecnormalize.pkl, where `isd-gym score`
            finds it.

    Raises:
        InputError: A file cannot be written.
    """
    normalize = model.get_vec_normalize_env()
    if normalize is not None:
        with whole(str(path).removesuffix(".zip") + "_vecnormalize.pkl") as part:
            normalize.save(str(part))
    with whole(path) as part:
        model.save(part)


class _Learner:
    """A model in training as a controller: observations of the environment, alone or stacked; actions to currents [A]."""

    name, fallbacks = "policy", 0

    def __init__(self, model: BaseAlgorithm, task: Task) -> None:
        self.model = model
        self.observation = task.options.observation
        self.preview = task.options.preview
        self._normalize = model.get_vec_normalize_env()
        self._inputs = int(np.prod(model.observation_space.shape or ()))
        self._stack = np.zeros((1, self._inputs), np.float32)
        box = model.action_space
        assert isinstance(box, spaces.Box)
        self._share = 1.0 / box.high  # of the largest action
        signals = len(task.measured)
        currents = len(task.vehicle.driven)
        self._present = slice(signals - currents, signals)
        scales = history_of(task.vehicle).scale[self._present]
        self._unit = (
            np.array(scales) if self.observation == "history" else np.ones(currents)
        )
        self._is_increment = task.options.action == "increment"

    def reset(self) -> None:
        """Clear the memory of a single car."""
        self.reset_batch(1)

    def reset_batch(self, count: int) -> None:
        """Clear the stack of observations; the environment has the rest of the memory."""
        self._stack = np.zeros((count, self._inputs), np.float32)

    def _stacked(self, observations: np.ndarray) -> np.ndarray:
        """Return the last observations (cars, inputs), the newest last, as VecFrameStack gives them."""
        width = observations.shape[1]
        self._stack[:, :-width] = self._stack[:, width:]
        self._stack[:, -width:] = observations
        return self._stack

    def act(self, observation: np.ndarray) -> np.ndarray:
        """Return the currents [A] (currents,) for an observation (width,)."""
        return self.act_batch(observation[None])[0]

    def act_batch(self, observations: np.ndarray) -> np.ndarray:
        """Return the currents [A] (cars, currents) for observations (cars, width)."""
        seen: Any = observations
        steps = [self._stacked]
        if self._normalize is not None:  # before or after the stack, as in the training
            statistics: Any = self._normalize.obs_rms
            is_first = statistics.mean.shape[0] == observations.shape[1]
            steps.insert(0 if is_first else 1, self._normalize.normalize_obs)  # type: ignore[arg-type]
        for step in steps:
            seen = step(seen)
        actions, _ = self.model.predict(seen, deterministic=True)
        shares = np.asarray(actions, float) * self._share
        if not self._is_increment:
            return shares * CURRENT_LIMIT
        return observations[:, self._present] * self._unit + shares * (
            SLEW_RATE * CONTROL_STEP
        )
