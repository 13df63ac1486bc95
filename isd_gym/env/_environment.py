"""The environments: a car with hydraulic electric inerters on a road, single or vectorised.

`Batch` contains the physics, `Task` options, spaces, sensors and rewards, and this module the episodes.
"""

from __future__ import annotations

import copy
import os
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib.util import find_spec
from math import isfinite
from threading import Lock
from typing import TYPE_CHECKING, Any

import gymnasium as gym
import numpy as np
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.wrappers import TimeLimit

from .._common.errors import InputError, how_to_install, plain, shown
from .._common.inputs import is_whole
from .._common.seeds import road_index, scoring_generator
from ._pictures import Onlooker
from .task import Options, Task, info_maker

if TYPE_CHECKING:
    from gymnasium.envs.registration import EnvSpec

    from ..physics.network import Network
    from ..view.rendering import CarSnapshot, Renderer

PICTURES = 50.0  # pictures per simulated second in a window; `render` may be called at every step

RESET_OPTIONS = ("road", "speed", "scoring_road")
RENDER_MODES = ["human", "rgb_array"]  # of one car; a window shows no batch


def _can_draw() -> bool:
    """Return whether the drawing library is installed."""
    return find_spec("pygame") is not None


def _check_options(options: Mapping[str, Any], known: Sequence[str]) -> None:
    """Raise `InputError` for an option that a reset does not have."""
    unknown = [shown(name) for name in options if name not in known]
    if unknown:
        raise InputError(
            f"reset has the options {', '.join(known)}, not {', '.join(unknown)}"
        )


def _check_render_mode(mode: str | None, known: list[str]) -> None:
    """Check before a drive that a mode is known and that the drawing library is installed."""
    if mode is None:
        return
    if mode not in known:
        raise InputError(f"render_mode must be {' or '.join(known)}, not {mode!r}")
    if not _can_draw():
        raise gym.error.DependencyNotInstalled(
            f"pictures need pygame-ce: {how_to_install('render')}"
        )


class _KnowsItsLength:
    """An environment whose `spec` has the length of an episode, whatever options decide it."""

    max_episode_steps: int
    _spec: EnvSpec | None = None

    @property
    def spec(self) -> EnvSpec | None:
        """Description by which Gymnasium made the environment."""
        return self._spec

    @spec.setter
    def spec(self, spec: EnvSpec | None) -> None:
        if spec is not None:
            spec.max_episode_steps = self.max_episode_steps
        self._spec = spec


class ISDSuspensionEnv(_KnowsItsLength, gym.Env):
    """A vehicle suspension with a hydraulic electric inerter at each corner, driven by the currents of the motors.

    ## Description
    The corner of every car is the quarter car of Liu, Zhao, Yang, Chen and Shen, "Predictive Control of Vehicle ISD
    Suspension Based on a Hydraulic Electric Inerter", Shock and Vibration (2019). Its body and wheel are joined by the main
    spring and, in series, a damper and a hydraulic inerter whose fluid drives a linear motor. Dry friction, leakage,
    oil elasticity and the end stop are part of the device. The goal is a quiet body on a rough road without using
    up the working space.

    | environment | for | network | corners |
    |---|---|---|---|
    | `ISDSuspension-v0` | benchmarks, controllers, cards | quarter-car-isd | one |
    | `ISDSuspensionLearning-v0` | learning | quarter-car-isd | one |
    | `ISDSuspensionEq8-v0` | the paper's equation (8) as printed | quarter-car-eq8 | one |
    | `ISDHalfCar-v0` | benchmarks | half-car-isd: the body heaves and pitches | front, rear |
    | `ISDHalfCarLearning-v0` | learning | half-car-isd | front, rear |
    | `ISDFullCar-v0` | benchmarks | full-car-isd: the body heaves, pitches and rolls | front left, front right, rear left, rear right |
    | `ISDFullCarLearning-v0` | learning | full-car-isd | as above |

    Learning algorithms with default hyperparameters end at zero current on the environments for benchmarks. The
    environments for learning are the same cars with four options: `observation="history"`, `action="share"` (currents in
    [-1, 1]), `reward="shaped"` and `reward_scale=10`.

    The rear wheels meet the road of the front wheels after wheelbase / speed, 0.135 s at 20 m/s. The two tracks of
    the full car are those of an isotropic surface (`isd_gym.physics.tracks`). Corners, signals and currents follow from the network:
    `network` may be any with a rigid body, a wheel on each road input and at most one motor at each wheel.

    ## Action space
    `Box(-5, 5, (currents,), float32)`: commanded motor currents [A]. Each drive slews its current by at most 0.5 A per
    control step of 5 ms (Table 5). A value that is not finite, or an action of another shape, raises `InputError`.

    | # | quarter car | half car | full car | unit |
    |---|---|---|---|---|
    | 0 | current | front | front left | A |
    | 1 | | rear | front right | A |
    | 2 | | | rear left | A |
    | 3 | | | rear right | A |

    A network without motors is refused. With `allow_passive`, such a network has a current without effect for each corner.

    ## Observation space
    `Box(-high, high, (signals,), float32)`, the signals that a car can measure. Corners are in the order of the actions.

    | quarter car | half car | full car | signal | unit | bound |
    |---|---|---|---|---|---|
    | 0 | 0 | 0 | vertical acceleration of the body at its centre of gravity | m/s² | 200 |
    | | 1 | 1 | pitch acceleration, nose down positive | rad/s² | 200 |
    | | | 2 | roll acceleration, right side down positive | rad/s² | 200 |
    | 1 | 2, 6 | 3, 7, 11, 15 | suspension travel, body over wheel, of each corner | m | 1 |
    | 2 | 3, 7 | 4, 8, 12, 16 | its rate | m/s | 50 |
    | 3 | 4, 8 | 5, 9, 13, 17 | device travel (the motor's encoder) of each corner | m | 1 |
    | 4 | 5, 9 | 6, 10, 14, 18 | its rate | m/s | 50 |
    | 5 | 10, 11 | 19 to 22 | present current of each motor | A | 5 |

    `observation="full"` appends displacement and velocity of every node with a motion of its own: wheels, body, its angles
    [rad, rad/s], terminals of the devices. Displacements [m] count from the road, nodes of a corner from its own road
    and the body from the mean of all. `observation="preview"` appends the road ahead of the first axle, relative to the
    height under its wheel [m]: one point per control step over `preview` seconds, the left track before the right one.

    ## Reward
    Minus a stage cost of signals at the end of the step, see `StageCost`. For the quarter car it is
    `0.6 (a / 0.8306 m/s²)² + 0.3 (l / 7.6 mm)²` of body acceleration a and suspension travel l: section 4.2's weights over
    Table 7's passive row. The half car has the weights 0.3 and 0.3 for vertical and pitch acceleration, the full car
    three times 0.2 with roll acceleration, and both share 0.3 equally among the travels of the corners. Each signal is taken
    over its RMS in the passive car, which costs about 0.9 in all three. Dynamic tyre load and current can be given
    weights (`cost={"tyre_load": ..., "current": ...}`).

    `reward="shaped"` takes the road's luck out of the reward: minus the stage cost, minus the change of a value V of the
    state, plus the part of that change that the road of this step causes. V is knowledge of a linear model of the car,
    nearly as a teacher is. V cancels over a drive and the road's part has a constant mean, so that the order of policies that
    do not see the road ahead is unchanged; with a learner's discount factor below 1 that is approximate. `info["cost"]` and the score
    stay the same.

    ## Episode
    Starts at rest at the beginning of a new road. Truncated after `duration`, 20 s or 4000 steps by default, or after
    `max_episode_steps` of `gymnasium.make`, shorter or longer. Terminated only if the state leaves the bounds of the
    observation, which does not happen by itself.

    `reset(seed=..., options=...)` takes these options:

    | option | content |
    |---|---|
    | `road` | road of this and all following episodes, as in `isd_gym.env.Options`, such as "C" |
    | `speed` | speed of this and all following episodes [m/s] |
    | `scoring_road` | number of a scoring road, from 0, which no seed reaches; car i of a vector environment has that number + i |

    A vector environment also has `reset_mask`. Other cars take the road and the speed at their next episode. The shaped reward
    and the front corners in `observation="history"` keep the speed of the environment, as with `randomize`.

    ## Info
    Of `reset` and of `step`. `exceeds_...` are constraint signals for safe reinforcement learning:

    | key | content | unit |
    |---|---|---|
    | `speed` | speed of the car | m/s |
    | `cost` | stage cost, whatever the reward is | - |
    | `cost_acceleration`, `cost_pitch`, `cost_roll`, `cost_travel`, `cost_tyre_load`, `cost_current` | its terms; pitch and roll where the body turns | - |
    | `tyre_load`, or `tyre_load_front`, `tyre_load_rear_left` and so on | dynamic tyre load, positive in compression | N |
    | `exceeds_acceleration`, `exceeds_travel` | 1 beyond the limit of Table 5 (5 m/s², 80 mm), else 0 | - |
    | parameters and `road` of `randomize`, such as `body.mass` | drawn value of the episode | SI |

    ## Versions
    `ISDSuspension-v0`, `ISDSuspensionEq8-v0`: v0, first release. `ISDHalfCar-v0`, `ISDFullCar-v0`: v0, first release.

    Args:
        network: A built-in name, a file (`isd-model/1`), its content, or a `Network`.
        render_mode: None, 'human' for a window, or 'rgb_array' for arrays.
        options: Further fields of `isd_gym.env.Options`, which lists units and defaults.

    Raises:
        InputError: An argument or option is invalid.
        DependencyNotInstalled: A `render_mode` needs pygame-ce; an error of Gymnasium.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012
        "render_modes": RENDER_MODES if _can_draw() else [],
        "render_fps": 200,
    }

    def __init__(
        self,
        network: Any = Options.network,
        *,
        render_mode: str | None = None,
        **options: Any,
    ) -> None:
        _check_render_mode(render_mode, RENDER_MODES)
        chosen = Options.of({"network": network, **options})
        self.task = Task(1, chosen, picture=render_mode is not None)
        self._n_currents = self.task.batch.of.currents
        self._make_info = info_maker(self.task.step_info)
        self.action_space = self.task.action_space
        self.observation_space = self.task.observation_space
        self.render_mode = render_mode
        # one picture per step: real time
        self.metadata = {
            **self.metadata,
            "render_fps": max(1, round(1 / self.task.decision)),
        }
        self._renderer: Renderer | None = None
        self._ready = False
        self._steps = 0
        #: length of an episode by the options [decisions]
        self.max_episode_steps = self._limit = self.task.episode
        self._is_plain, self._is_direct = self.task.is_plain, self.task.is_direct
        self._gain = self.task.gain if self._is_direct else 1.0
        self._bind()
        self._drawn: dict[str, Any] = {}
        self._onlooker = Onlooker(self.task, 0) if render_mode is not None else None

    @property
    def network(self) -> Network:
        """Network of the car."""
        return self.task.network

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        super().reset(seed=seed)
        self._limit = _time_limit_around(self) or self.max_episode_steps
        options = options or {}
        _check_options(options, RESET_OPTIONS)
        self.task.drive_on(options)
        if "scoring_road" in options:
            self._np_random = scoring_generator(
                road_index(options["scoring_road"], "scoring_road")
            )
            self._np_random_seed = -1  # as Gymnasium says where the seed is not known
        batch = self.task.batch
        self.task.begin(0, self.np_random)
        self._ready = True
        self._steps = 0
        if self._onlooker is not None:
            self._onlooker.start()
        batch.forget(slice(None))
        if self.render_mode == "human":
            self.render()
        self._speed = float(batch.speeds[0])
        self._drawn = {name: values[0] for name, values in batch.drawn.items()}
        numbers = dict.fromkeys(("cost", *self.task.step_info), 0.0)
        return self.task.first()[0], {"speed": self._speed, **numbers, **self._drawn}

    def step(
        self, action: np.ndarray
    ) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        if not self._ready:
            raise gym.error.ResetNeeded("call reset() before step()")
        batch = self.task.batch
        try:
            targets = (
                action.tolist() if isinstance(action, np.ndarray) else _listed(action)
            )
            if len(targets) != self._n_currents:
                raise TypeError
            for i, target in enumerate(targets):
                current = target if type(target) is float else _number(target)
                if not isfinite(current):
                    raise InputError(f"the action must be finite, not {current}")
                self._actions[i] = self._gain * current
        except InputError:
            raise
        except (TypeError, ValueError, OverflowError):
            count = self._n_currents
            what = "a number" if count == 1 else "numbers"
            raise InputError(
                f"the action must have shape ({count},), {what}, not {plain(repr(action), 60)}"
            ) from None
        if self._is_plain:
            batch.step()
            told = batch.alone()
            reward, broken = told[0], told[-1] != 0.0
            obs = (
                self.task.observe()[0]
                if broken or self.task.is_faulty
                else batch.first_seen.copy()
            )
        else:
            if self._is_direct:
                batch.step()
                reward = self.task.options.reward_scale * float(
                    batch.results[self.task.reward_row, 0]
                )
            else:
                reward = float(self.task.advance()[0])
            told = batch.alone()
            broken = told[-1] != 0.0
            obs = self.task.observe()[0].copy()
        self._steps += 1
        info = self._make_info(self._speed, told)
        if self._drawn:
            info.update(self._drawn)
        if self._onlooker is not None:
            self._onlooker.see(self._steps, told[0])
            if self.render_mode == "human":
                self.render()
        return obs, reward, broken, self._steps >= self._limit and not broken, info

    def render(self) -> np.ndarray | None:
        if self.render_mode is None:
            gym.logger.warn(
                'render() needs a render_mode, e.g. gymnasium.make("ISDSuspension-v0", render_mode="rgb_array")'
            )
            return None
        from ..view.rendering import Renderer

        if self._renderer is None:
            self._renderer = Renderer(self.render_mode, fps=PICTURES)  # type: ignore[arg-type]
        return self._renderer.draw(self.snapshot())

    def get_state(self) -> dict[str, Any]:
        """Return the state of the episode: car, road, sensors, memory of the observation, random generator.

        Returns:
            A state for `set_state` of this or an equal environment, single or vectorised; it can be pickled.

        Raises:
            gymnasium.error.ResetNeeded: The environment was not reset.
        """
        if not self._ready:
            raise gym.error.ResetNeeded("call reset() before get_state()")
        return self.task.get_state(0) | {
            "steps": self._steps,
            "rng": copy.deepcopy(self.np_random),
        }

    def set_state(self, state: Mapping[str, Any]) -> None:
        """Continue from a state: the same actions give the same observations and rewards, to the last bit.

        Args:
            state: A state of `get_state`.

        Raises:
            InputError: The state is of another network, or of an environment with other options.
        """
        self.task.set_state(0, state)
        self._np_random = copy.deepcopy(state["rng"])
        self._steps = state["steps"]
        self._ready = True
        self._speed = float(self.task.batch.speeds[0])
        self._drawn = {
            name: values[0] for name, values in self.task.batch.drawn.items()
        }
        if self._onlooker is not None:
            self._onlooker.start()

    def snapshot(self) -> CarSnapshot:
        """Return the content of a picture of the car.

        Raises:
            InputError: The environment was made without a `render_mode`.
        """
        if self._onlooker is None:
            raise InputError(
                "a snapshot needs a render_mode: make the environment with render_mode='rgb_array'"
            )
        return self._onlooker.snapshot()

    def close(self) -> None:
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None

    def __getstate__(self) -> dict[str, Any]:
        return {
            k: v
            for k, v in self.__dict__.items()
            if k not in ("_make_info", "_actions")
        } | {"_renderer": None}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._make_info = info_maker(self.task.step_info)
        self._bind()

    def _bind(self) -> None:
        """Let actions be written where the car, or the task, reads them."""
        self._actions = (
            self.task.batch.target if self._is_direct else self.task.actions
        )[:, 0]


def _time_limit_around(env: ISDSuspensionEnv) -> int | None:
    """Return the limit [decisions] of Gymnasium's time limit around an environment, during a call of the environment.

    `gymnasium.make` gives `max_episode_steps` to this wrapper alone. The wrapper is among the callers of `reset`.
    """
    frame = sys._getframe(1).f_back
    while frame is not None:
        wrapper = frame.f_locals.get("self")
        if isinstance(wrapper, TimeLimit) and wrapper.unwrapped is env:
            return wrapper._max_episode_steps
        frame = frame.f_back
    return None


def _listed(action: Any) -> list[Any]:
    """Return an action that is no array as a list of its parts."""
    if isinstance(action, bytes | str):
        raise TypeError
    return list(action)


def _number(value: Any) -> float:
    """Return a part of an action as a float."""
    if isinstance(value, bytes | str):
        raise TypeError  # float() would accept the text
    return float(value)


def _currents(actions: Any) -> np.ndarray:
    """Return actions as an array of floats; raise `InputError` for text, objects and numbers beyond the range of floats."""
    if isinstance(actions, np.ndarray) and actions.dtype.kind == "f":
        return actions
    try:
        found = np.asarray(actions)
        if found.dtype.kind not in "fiub":
            raise ValueError
        return found.astype(float)
    except (TypeError, ValueError, OverflowError):
        raise InputError("the actions must be numbers, currents in A") from None


def _check_count(name: str, value: Any) -> None:
    """Raise `InputError` for a value that is no positive whole number."""
    is_whole_number = isinstance(value, int | np.integer) and value is not True
    if not is_whole_number or value < 1:
        raise InputError(f"{name} must be a positive whole number, not {shown(value)}")


class ISDSuspensionVectorEnv(_KnowsItsLength, VectorEnv):
    """A vector environment of many cars: `gymnasium.make_vec("ISDSuspension-v0", 1024)`, and likewise half and full cars.

    Car i equals the single environment with the seed ``seed + i``. The results do not depend on the number of
    threads. With groups (`cars_per_road`), car i has the seed ``seed + i // cars_per_road``: the cars of a group are
    equal and on equal roads, and end their episodes together. One thread at a time may call an environment.

    Args:
        num_envs: Number of cars.
        network: As in `ISDSuspensionEnv`.
        cars_per_road: Number of consecutive cars on one road. With ``reward="relative"``, the reward of a car of a
            group is the mean cost of the group minus its own cost, times `isd_gym.env.RELATIVE_SCALE`.
        max_episode_steps: Length of an episode [decisions]; None for the option `duration`.
        autoreset_mode: 'next_step' (Gymnasium's default), 'same_step' (`final_obs` and `final_info` in
            `info`) or 'disabled' (reset with ``options={"reset_mask": mask}``).
        render_mode: None, or 'rgb_array' for a picture of every car from `render`.
        threads: Number of threads that share the cars; None for a thread per 2048 cars, at most one per core.
        options: Further options of `ISDSuspensionEnv`.

    Raises:
        InputError: An argument or option is invalid.
    """

    # Gymnasium closes an environment whose arguments were refused
    _renderers: Sequence[Renderer] = ()
    metadata: dict[str, Any] = {  # noqa: RUF012
        "render_modes": ["rgb_array"] if _can_draw() else [],
        "render_fps": 200,
        "autoreset_mode": AutoresetMode.NEXT_STEP,
    }

    def __init__(
        self,
        num_envs: int = 1,
        network: Any = Options.network,
        *,
        cars_per_road: int = 1,
        max_episode_steps: int | None = None,
        autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
        render_mode: str | None = None,
        threads: int | None = None,
        **options: Any,
    ) -> None:
        _check_render_mode(render_mode, ["rgb_array"])
        _check_count("num_envs", num_envs)
        _check_count("cars_per_road", cars_per_road)
        if max_episode_steps is not None:
            _check_count("max_episode_steps", max_episode_steps)
        if threads is not None:
            _check_count("threads", threads)
        if num_envs % cars_per_road:
            raise InputError(
                f"{num_envs} cars cannot be shared out to roads of {cars_per_road} cars each"
            )
        try:
            mode = (
                autoreset_mode
                if isinstance(autoreset_mode, AutoresetMode)
                else _MODES[autoreset_mode]
            )
        except (KeyError, TypeError):
            raise InputError(
                f"autoreset_mode must be one of {', '.join(_MODES)}, not {autoreset_mode!r}"
            ) from None
        self.autoreset_mode = mode
        self.num_envs = num_envs
        self.render_mode = render_mode
        chosen = Options.of({"network": network, **options})
        self.task = Task(
            num_envs,
            chosen,
            picture=render_mode is not None,
            threads=_threads(num_envs) if threads is None else threads,
            group=cars_per_road,
        )
        self.cars_per_road = cars_per_road
        self.max_episode_steps = (
            self.task.episode if max_episode_steps is None else max_episode_steps
        )
        self.metadata = {
            **self.metadata,
            "autoreset_mode": mode,
            "render_fps": max(1, round(1 / self.task.decision)),
        }
        self.single_action_space = self.task.action_space
        self.single_observation_space = self.task.observation_space
        self.action_space = gym.vector.utils.batch_space(
            self.single_action_space, num_envs
        )
        self.observation_space = gym.vector.utils.batch_space(
            self.single_observation_space, num_envs
        )
        self._rngs: list[np.random.Generator] = []
        self.steps = np.zeros(num_envs, np.int64)
        self._done = np.zeros(num_envs, bool)
        self._any_done = False
        self._last = np.zeros((num_envs, self.task.width), np.float32)
        self._oldest = 0
        self._onlookers = [
            Onlooker(self.task, i)
            for i in range(num_envs if render_mode is not None else 0)
        ]
        names = ("speed", "cost", *self.task.step_info, *self.task.batch.drawn)
        self._info_names = (*names, *(f"_{name}" for name in names))
        self._lock = Lock()

    @property
    def network(self) -> Network:
        """Network of the cars."""
        return self.task.network

    def reset(
        self,
        *,
        seed: int | list[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[np.ndarray, dict[str, Any]]:
        with self._alone():
            options = options or {}
            _check_options(options, (*RESET_OPTIONS, "reset_mask"))
            mask = self._mask(options.get("reset_mask"))
            fresh = self._generators(seed, options.get("scoring_road"))
            self.task.drive_on(options)
            self._rngs = fresh
            self._restart(np.flatnonzero(mask))
            # the other cars keep their observations
            self._last[mask] = self.task.first(np.flatnonzero(mask))
            return self._last.copy(), self._info()

    def _mask(self, given: Any) -> np.ndarray:
        """Return the mask of the cars that a reset restarts (num_envs,)."""
        if given is None:
            return np.ones(self.num_envs, bool)
        mask = np.asarray(given)
        if mask.shape != (self.num_envs,) or mask.dtype != bool or not mask.any():
            raise InputError(
                f"reset_mask must be {self.num_envs} booleans, at least one of them true"
            )
        if not self._rngs and not mask.all():
            raise InputError(
                "the first reset must start all cars: call reset() without a reset_mask"
            )
        by_road = mask.reshape(-1, self.cars_per_road)
        if (by_road.any(axis=1) != by_road.all(axis=1)).any():
            raise InputError(
                "reset_mask must restart all cars of a road or none: they are compared"
            )
        return mask

    def _generators(self, seed: Any, scoring: Any) -> list[np.random.Generator]:
        """Return the generators of all cars after a reset with these arguments."""
        count, each = self.num_envs, self.cars_per_road
        roads = count // each
        if scoring is not None:
            first = road_index(scoring, "scoring_road")
            return [scoring_generator(first + i // each) for i in range(count)]
        if seed is None:
            if self._rngs:
                return self._rngs
            seeds: list[Any] = [
                int(s)
                for s in np.random.SeedSequence().generate_state(roads, np.uint64)
            ]
            seeds = [seeds[i // each] for i in range(count)]
        elif isinstance(seed, int | np.integer):
            seeds = [int(seed) + i // each for i in range(count)]
        else:
            given = seed.tolist() if isinstance(seed, np.ndarray) else seed
            seeds = list(given) if isinstance(given, Sequence) else [given]
            if not all(s is None or is_whole(s, 0) for s in seeds):
                raise InputError(
                    f"seed must be whole numbers >= 0, one or one for each environment, not {shown(seed)}"
                )
            if len(seeds) != count:
                raise InputError(f"{len(seeds)} seeds for {count} environments")
            for road in np.reshape(np.array(seeds, object), (roads, each)):
                if any(s != road[0] for s in road):
                    raise InputError(
                        "the cars of a road must have the same seed: they are compared"
                    )
            if not self._rngs and each > 1 and None in seeds:
                raise InputError("give all seeds of the first reset, or none")
        return [
            self._rngs[i] if s is None and self._rngs else seeding.np_random(s)[0]
            for i, s in enumerate(seeds)
        ]

    @contextmanager
    def _alone(self) -> Iterator[None]:
        """Refuse a second thread while this one uses the cars."""
        if not self._lock.acquire(blocking=False):
            raise InputError(
                "another thread is using this vector environment: one thread at a time may call it"
            )
        try:
            yield
        finally:
            self._lock.release()

    def _info(self) -> dict[str, Any]:
        """Return the `info` of all cars."""
        batch = self.task.batch
        judged = batch.judged.copy()
        drawn = [values.copy() for values in batch.drawn.values()]
        # every car has every number
        masks = np.ones((len(self._info_names) // 2, self.num_envs), bool)
        values = (batch.speeds.copy(), -judged[0], *judged[1:], *drawn, *masks)
        return dict(zip(self._info_names, values, strict=True))

    def _restart(self, which: np.ndarray) -> None:
        batch = self.task.batch
        for i in which:
            self.task.begin(int(i), self._rngs[i])
        batch.forget(which)
        for i in which if self._onlookers else ():
            self._onlookers[i].start()
        self.steps[which] = 0
        self._done[which] = False
        self._any_done = bool(self._done.any())
        self._oldest = int(self.steps.max())

    def step(
        self, actions: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        with self._alone():
            return self._step(actions)

    def _step(
        self, actions: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        if not self._rngs:
            raise gym.error.ResetNeeded("call reset() before step()")
        target = _currents(actions)
        task, batch = self.task, self.task.batch
        if target.shape != self.action_space.shape:
            raise InputError(
                f"the actions must have shape {self.action_space.shape}, not {target.shape}"
            )
        is_finite = np.isfinite(target)
        if not is_finite.all():
            first = int(np.argmin(is_finite.all(axis=1)))
            raise InputError(f"action {first} is not finite")
        task.actions[:] = target.T
        revived = (
            np.flatnonzero(self._done)
            if self._any_done and self.autoreset_mode is AutoresetMode.NEXT_STEP
            else None
        )
        if task.is_plain:
            batch.step()
            reward = batch.judged[0].copy()
        else:
            reward = task.advance()
        self.steps += 1
        self._oldest += 1
        obs = task.observe()
        terminated = batch.gone if batch.broken else np.zeros(self.num_envs, bool)
        if revived is not None:
            self._restart(revived)
            obs[revived] = self.task.first(revived)
            terminated[revived] = False
            reward[revived] = 0.0
        info = self._info()
        # except for cars that have just restarted
        for i in np.flatnonzero(self.steps) if self._onlookers else ():
            self._onlookers[i].see(int(self.steps[i]), -float(info["cost"][i]))
        if self._oldest >= self.max_episode_steps or (
            batch.broken and terminated.any()
        ):
            over = self.steps >= self.max_episode_steps
            if self.cars_per_road > 1:  # a road ends for all of its cars
                ended = terminated.reshape(-1, self.cars_per_road).any(axis=1)
                over = over | np.repeat(ended, self.cars_per_road)
            truncated = over & ~terminated
            self._done = terminated | truncated
            self._any_done = bool(self._done.any())
            if self._any_done and self.autoreset_mode is AutoresetMode.SAME_STEP:
                self._restart_now(obs, info)
        else:
            truncated = np.zeros(self.num_envs, bool)
        self._last = obs
        return obs.copy(), reward, terminated, truncated, info

    def _restart_now(self, obs: np.ndarray, info: dict[str, Any]) -> None:
        """Restart the cars whose episode ended, and replace their observations and numbers."""
        done = self._done.copy()
        final = np.empty(self.num_envs, object)
        which = np.flatnonzero(done)
        for i in which:
            final[i] = obs[i].copy()
        last = info.copy()
        self._restart(which)
        obs[which] = self.task.first(which)
        info |= self._info()
        info |= {
            "final_obs": final,
            "final_info": last,
            "_final_obs": done,
            "_final_info": done.copy(),
        }

    def get_state(self, car: int) -> dict[str, Any]:
        """Return the state of a car's episode, see `ISDSuspensionEnv.get_state`.

        Args:
            car: Index of the car.

        Returns:
            A state for `set_state` of this or an equal environment, single or vectorised.

        Raises:
            gymnasium.error.ResetNeeded: The environment was not reset.
        """
        if not self._rngs:
            raise gym.error.ResetNeeded("call reset() before get_state()")
        rng = copy.deepcopy(self._rngs[car])
        return self.task.get_state(car) | {"steps": int(self.steps[car]), "rng": rng}

    def set_state(self, car: int, state: Mapping[str, Any]) -> None:
        """Continue a car from a state: the same actions give the same observations and rewards, to the last bit.

        Args:
            car: Index of the car.
            state: A state of `get_state`.

        Raises:
            InputError: The state is of another network, or of an environment with other options.
            gymnasium.error.ResetNeeded: The environment was not reset.
        """
        if not self._rngs:
            raise gym.error.ResetNeeded("call reset() before set_state()")
        self.task.set_state(car, state)
        self._rngs[car], self.steps[car] = copy.deepcopy(state["rng"]), state["steps"]
        self._done[car], self._oldest = False, int(self.steps.max())
        self._any_done = bool(self._done.any())
        if self._onlookers:
            self._onlookers[car].start()

    def render(self) -> tuple[np.ndarray, ...] | None:
        """Return a picture of every car.

        Returns:
            Pictures (height, width, 3) uint8; None, with a warning, without a `render_mode`.
        """
        if self.render_mode is None:
            gym.logger.warn(
                'render() needs a render_mode, e.g. make_vec(..., render_mode="rgb_array")'
            )
            return None
        if not self._rngs:
            raise gym.error.ResetNeeded("call reset() before render()")
        from ..view.rendering import Renderer

        if not self._renderers:
            self._renderers = [
                Renderer(self.render_mode, fps=PICTURES)  # type: ignore[arg-type]
                for _ in range(self.num_envs)
            ]
        pairs = zip(self._renderers, self._onlookers, strict=True)
        return tuple(renderer.draw(onlooker.snapshot()) for renderer, onlooker in pairs)  # type: ignore[misc]

    def close_extras(self, **kwargs: Any) -> None:
        for renderer in self._renderers:
            renderer.close()
        self._renderers = ()

    def __getstate__(self) -> dict[str, Any]:
        return {k: v for k, v in self.__dict__.items() if k != "_lock"} | {
            "_renderers": ()
        }

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._lock = Lock()


def _threads(cars: int) -> int:
    """Return the useful number of threads: handing over work takes as long as some hundred cars."""
    cores = (
        len(os.sched_getaffinity(0))
        if hasattr(os, "sched_getaffinity")
        else os.cpu_count() or 1
    )
    return max(1, min(cores, cars // 2048))


_MODES = {mode.name.lower(): mode for mode in AutoresetMode}
