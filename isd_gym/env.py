"""`ISDSuspension-v0`: a quarter car with a hydraulic electric inerter on a road, one car or many.

Physics lives in `Batch`; spaces, rewards and episodes live here.
"""

from __future__ import annotations

import math
import os
from collections import deque
from typing import TYPE_CHECKING, Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv

from . import elements as el
from .batch import CURRENT_LIMIT, SIGNALS, Batch, nodes_of_device, state_channels
from .cost import StageCost
from .errors import InputError, plain
from .network import Network
from .sensors import Sensors, Sight

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from .rendering import Renderer, Snapshot
    from .road import Road

CONTROL_STEP = 5e-3  # s

#: measured signals: name, unit, bound
MEASURED = (
    ("body_acceleration", "m/s^2", 200.0),
    ("suspension_travel", "m", 1.0),
    ("suspension_travel_rate", "m/s", 50.0),
    ("device_travel", "m", 1.0),
    ("device_travel_rate", "m/s", 50.0),
    ("current", "A", CURRENT_LIMIT),
)
STATE_BOUND = 1e3  # m or m/s, of the full observation
ROAD_BOUND = 10.0  # m, of the preview
PICTURES = 50.0  # a simulated second, in a window; `render` may be called at every step
GRAVITY = 9.81  # m/s^2
PICTURE_WINDOW = 5.5  # m of road before and behind the wheel in a picture
PICTURE_PAST = 4.0  # s of its curves
Past = deque[tuple[float, float, float]]  # a `moment` per control step
N_MEASURED = len(MEASURED)
#: what `Batch.judged` says behind the reward
STEP_INFO = ("cost_acceleration", "cost_travel", "cost_tyre_load", "cost_current", "tyre_load")
OBSERVATIONS = ("measured", "full", "preview")  # in the order of `layout`: MEASURED, WHOLE, AHEAD


class Task:
    """What the single and the vector environment share: spaces, sensors, cost, limits."""

    def __init__(
        self,
        count: int,
        *,
        network: str | Path | Mapping[str, Any] | Network,
        road: str | Road,
        speed: float,
        observation: str,
        cost: StageCost | Mapping[str, float] | None,
        randomize: Mapping[str, Any] | None,
        control_step: float,
        preview: float,
        duration: float,
        sensors: Sensors | Mapping[str, Any] | str | None = None,
        picture: bool = False,
        threads: int = 1,
    ) -> None:
        if observation not in OBSERVATIONS:
            raise InputError(f"observation must be one of {', '.join(OBSERVATIONS)}, not {observation!r}")
        self.network = net = Network.load(network)
        self.observation = observation
        self.cost = cost if isinstance(cost, StageCost) else StageCost(**(cost or {}))
        extra = state_channels(net) if observation == "full" or picture else []
        self.points = round(preview / control_step) if observation == "preview" else 0
        look = self.points * control_step
        if picture:  # the road in front of the car is part of the picture
            look = max(look, PICTURE_WINDOW / min(speed, *(randomize or {}).get("speed", (speed,))))
            look = control_step * math.ceil(look / control_step)
        self.batch = Batch(
            count,
            net,
            road_=road,
            speed=speed,
            control_step=control_step,
            duration=duration,
            randomize=randomize,
            preview=look,
            extra=extra,
        )
        high = [bound for _, _, bound in MEASURED]
        self.labels = [f"{name} [{unit}]" for name, unit, _ in MEASURED]
        if observation == "full":
            high += [STATE_BOUND] * len(extra)
            self.labels += [
                f"{c.name} [{c.unit}], above the road" if "disp" in c.name else f"{c.name} [{c.unit}]"
                for c in extra
            ]
        elif observation == "preview":
            high += [ROAD_BOUND] * self.points
            self.labels += [f"road ahead {(i + 1) * control_step:.3f} s [m]" for i in range(self.points)]
        self.high = np.array(high, np.float32)
        self.width = len(high)
        self.action_space = spaces.Box(-CURRENT_LIMIT, CURRENT_LIMIT, (1,), np.float32)
        self.observation_space = spaces.Box(-self.high, self.high, dtype=np.float32)
        self.batch.judge(
            self.cost.quadratic,
            [bound for _, _, bound in MEASURED[:-1]],
            width=self.width,
            shows=OBSERVATIONS.index(observation),
            lifted=[False] * len(SIGNALS) + [c.quantity == "displacement" for c in extra],
            threads=threads,
        )
        names = [name for name, _, _ in MEASURED]
        self._sensors = [e for e in net.elements if e.place == "channel" and e.where[0] in names]
        for e in self._sensors:
            if isinstance(e, el.SensorDelay) and e.delay < 0:
                raise InputError(
                    f"element '{e.name}': no sensor of an environment can lead; delay must be >= 0 s"
                )
        self._histories: dict[str, np.ndarray] = {}
        self.sensors = Sensors.of(sensors)
        self._sight = (
            None
            if self.sensors.perfect
            else Sight(self.sensors, count, N_MEASURED, self.points, control_step)
        )
        #: whether a policy sees anything else than what is
        self.faulty = bool(self._sensors) or self._sight is not None

    def first(self, which: np.ndarray | slice = slice(None)) -> np.ndarray:
        """Observations (cars, width) of the cars `which`, at rest at the start of their roads."""
        obs = np.zeros((self.batch.count, self.width), np.float32)[which]
        if self.observation == "preview":
            obs[:, N_MEASURED:] = self.batch.road_ahead(self.points)[which]
        return self._sense(obs, which, first=True) if self.faulty else obs

    def observe(self) -> np.ndarray:
        """Observations (count, width) float32 after a step; those of cars that broke are cut off at their bounds."""
        obs = self.batch.seen
        if self.faulty:
            obs = self._sense(obs)
        if self.batch.broken:
            obs = np.clip(np.nan_to_num(obs), -self.high, self.high)
        return obs

    def _sense(
        self, obs: np.ndarray, which: np.ndarray | slice = slice(None), *, first: bool = False
    ) -> np.ndarray:
        """Faults of channels of the model, then `sensors`: what is reported (the physics and the reward do not see it)."""
        names = [name for name, _, _ in MEASURED]
        step = self.batch.control_step
        for e in self._sensors:
            j = names.index(e.where[0])
            if isinstance(e, el.SensorDelay):  # what `apply` does to a record, a sample at a time
                low, part = int(e.delay / step), e.delay / step % 1.0
                past = self._histories.setdefault(e.name, np.zeros((low + 2, self.batch.count)))
                past[1:, which] = past[:-1, which]
                past[0, which] = obs[:, j]
                obs[:, j] = (1 - part) * past[low, which] + part * past[low + 1, which]
            else:
                obs[:, j] = e.apply(obs[:, j], step)
        if self._sight is not None:
            obs = self._sight.see(obs, self.batch.speeds[which], which, first=first)
        return np.clip(obs, -self.high, self.high)

    def forget(self, i: int, rng: np.random.Generator) -> None:
        """Car i starts on a new road; `rng` has drawn it."""
        if self._sight is not None:
            self._sight.begin(i, rng)
        for past in self._histories.values():
            past[:, i] = 0.0


class ISDSuspensionEnv(gym.Env):
    """A vehicle suspension with a hydraulic electric inerter, driven by its motor's current.

    ## Description
    The quarter car of Liu, Zhao, Yang, Chen and Shen, "Predictive Control of Vehicle ISD Suspension Based on a
    Hydraulic Electric Inerter", Shock and Vibration (2019): body and wheel, main spring and tyre, and between body
    and wheel, in series, a damper and a hydraulic inerter whose fluid drives a linear motor. Dry friction, leakage,
    oil elasticity and the end stop are part of the device. The goal is a quiet body on a rough road without using
    up the working space.

    ## Action space
    `Box(-5, 5, (1,), float32)`: commanded motor current [A]. The drive slews the current by at most 0.5 A per
    control step of 5 ms (Table 5). A value that is not finite, or of another shape, raises `InputError`.

    ## Observation space
    `Box(-high, high, (6,), float32)`, what a car can measure:

    | # | signal | unit | bound |
    |---|---|---|---|
    | 0 | body acceleration | m/s² | 200 |
    | 1 | suspension travel, body over wheel | m | 1 |
    | 2 | its rate | m/s | 50 |
    | 3 | device travel (the motor's encoder) | m | 1 |
    | 4 | its rate | m/s | 50 |
    | 5 | present current | A | 5 |

    `observation="full"` appends displacement above the road [m] and velocity [m/s] of every node;
    `observation="preview"` appends the road ahead, relative to the height under the wheel [m], one point per control
    step over `preview` seconds.

    ## Reward
    `-[0.6 (a / 0.8306 m/s²)² + 0.3 (l / 7.6 mm)²]` per step, of body acceleration a and suspension travel l at the
    end of the step: section 4.2's weights over Table 7's passive row, about -0.9 for the passive car. Dynamic tyre load
    and current can be given weights (`cost={"tyre_load": ..., "current": ...}`).

    ## Episode
    Starts at rest at the beginning of a new road. Truncated after 4000 steps (20 s). Terminated only if the state leaves
    the bounds of the observation, which does not happen by itself.

    ## Info
    Of `reset` and of `step`: `speed` [m/s], `tyre_load` [N] (dynamic, positive in compression) and the terms of the
    cost, `cost_acceleration`, `cost_travel`, `cost_tyre_load`, `cost_current`.

    ## Arguments
    `network`: a built-in name, a file (`isd-model/1`) or a `Network`. `road`: paper, A-H, bump, pothole, sweep, a CSV
    file, `C+bump`. `speed` [m/s]. `observation`: measured, full, preview. `preview` [s]. `cost`: a `StageCost` or its
    weights. `randomize`: {"body.mass": (0.8, 1.2), "speed": (15, 30), "road": ["A", "B"]}, factors on parameters of
    the network, drawn at every reset. `control_step` [s]. `render_mode`: human, rgb_array.
    `duration` [s]: length of roads that are drawn whole; the time limit is `max_episode_steps`. `sensors`: how imperfect
    they are, see `isd_gym.sensors.Sensors`, e.g. {"noise": 1.0, "road_error": 0.001}.

    ## Versions
    v0: first release. `ISDSuspensionEq8-v0` is the same with the paper's equation (8) as printed.
    """

    metadata: dict[str, Any] = {"render_modes": ["human", "rgb_array"], "render_fps": 200}  # noqa: RUF012

    def __init__(
        self,
        network: str | Path | Mapping[str, Any] | Network = "quarter-car-isd",
        road: str | Road = "paper",
        speed: float = 20.0,
        observation: str = "measured",
        cost: StageCost | Mapping[str, float] | None = None,
        randomize: Mapping[str, Any] | None = None,
        control_step: float = CONTROL_STEP,
        preview: float = 0.25,
        duration: float = 20.0,
        sensors: Sensors | Mapping[str, Any] | str | None = None,
        render_mode: str | None = None,
    ) -> None:
        if render_mode is not None and render_mode not in self.metadata["render_modes"]:
            raise InputError(f"render_mode must be human or rgb_array, not {render_mode!r}")
        self.task = Task(
            1,
            network=network,
            road=road,
            speed=speed,
            observation=observation,
            cost=cost,
            randomize=randomize,
            control_step=control_step,
            preview=preview,
            duration=duration,
            sensors=sensors,
            picture=render_mode is not None,
        )
        self.action_space = self.task.action_space
        self.observation_space = self.task.observation_space
        self.render_mode = render_mode
        self.metadata = {
            **self.metadata,
            "render_fps": round(1 / control_step),
        }  # one picture a step: real time
        self._renderer: Renderer | None = None
        self._ready = False
        self._steps = 0
        self._total_cost = 0.0
        self._trail: deque[float] = deque(maxlen=1 + math.ceil(PICTURE_WINDOW / (speed * control_step)))
        self._past: Past = deque(maxlen=1 + math.ceil(PICTURE_PAST / control_step))

    @property
    def network(self) -> Network:
        """The plant."""
        return self.task.network

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        super().reset(seed=seed)
        batch = self.task.batch
        batch.reset(0, self.np_random)
        self.task.forget(0, self.np_random)
        self._ready = True
        self._steps = 0
        self._total_cost = 0.0
        self._trail.clear()
        self._trail.append(0.0)
        self._past.clear()
        batch.forget(slice(None))
        if self.render_mode == "human":
            self.render()
        self._speed = float(batch.speeds[0])
        return self.task.first()[0], {"speed": self._speed, **dict.fromkeys(STEP_INFO, 0.0)}

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        if not self._ready:
            raise gym.error.ResetNeeded("call reset() before step()")
        try:
            (target,) = action.tolist() if isinstance(action, np.ndarray) else action
            if type(target) is not float:
                if isinstance(target, str | bytes) or isinstance(action, bytes):
                    raise TypeError  # float() would make a number of it
                target = float(target)
        except (TypeError, ValueError, OverflowError):
            raise InputError(
                f"the action must have shape (1,), a current in A, not {plain(repr(action), 60)}"
            ) from None
        if not math.isfinite(target):
            raise InputError(f"the action must be finite, not {target}")
        batch = self.task.batch
        batch.target[0] = target
        batch.step()
        self._steps += 1
        reward, by_acceleration, by_travel, by_load, by_current, tyre_load, broke = batch.alone()
        broken = broke != 0.0
        obs = self.task.observe()[0] if broken or self.task.faulty else batch.first_seen.copy()
        info = {
            "speed": self._speed,
            "tyre_load": tyre_load,
            "cost_acceleration": by_acceleration,
            "cost_travel": by_travel,
            "cost_tyre_load": by_load,
            "cost_current": by_current,
        }
        if self.render_mode is not None:
            self._total_cost -= reward
            self._trail.append(float(batch.road_height[0]))
            self._past.append(moment(self.task, 0, self._steps))
            if self.render_mode == "human":
                self.render()
        return obs, reward, broken, False, info

    def render(self) -> np.ndarray | None:
        if self.render_mode is None:
            gym.logger.warn(
                'render() needs a render_mode, e.g. gymnasium.make("ISDSuspension-v0", render_mode="rgb_array")'
            )
            return None
        from .rendering import Renderer

        if self._renderer is None:
            self._renderer = Renderer(self.render_mode, fps=PICTURES)  # type: ignore[arg-type]
        return self._renderer.draw(self.snapshot())

    def snapshot(self) -> Snapshot:
        """What a picture of the car needs."""
        return snapshot(
            self.task,
            0,
            self._steps,
            np.array(self._trail),
            self._past,
            self._total_cost / max(self._steps, 1),
        )

    def close(self) -> None:
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_renderer": None}


def _currents(actions: Any) -> np.ndarray:
    """Actions as an array of floats; raises `InputError` for text, objects and numbers that no float holds."""
    if isinstance(actions, np.ndarray) and actions.dtype.kind == "f":
        return actions
    try:
        found = np.asarray(actions)
        if found.dtype.kind not in "fiub":
            raise ValueError
        return found.astype(float)
    except (TypeError, ValueError, OverflowError):
        raise InputError("the actions must be numbers, currents in A") from None


class ISDSuspensionVectorEnv(VectorEnv):
    """Many cars at once, natively: `gymnasium.make_vec("ISDSuspension-v0", 1024)`.

    Car i is exactly the single environment seeded with ``seed + i``. Arguments as `ISDSuspensionEnv`'s, and
    `num_envs`, `max_episode_steps` [control steps], `autoreset_mode`: next_step (Gymnasium's default), same_step (`final_obs` and `final_info` in `info`), disabled
    (reset with ``options={"reset_mask": mask}``). With ``render_mode="rgb_array"``, `render` gives a picture of every car.
    `threads` share the cars, by default one for every 2048 cars as far as there are cores; what comes out does not depend
    on them.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012
        "render_modes": ["rgb_array"],
        "render_fps": 200,
        "autoreset_mode": AutoresetMode.NEXT_STEP,
    }

    def __init__(
        self,
        num_envs: int = 1,
        network: str | Path | Mapping[str, Any] | Network = "quarter-car-isd",
        road: str | Road = "paper",
        speed: float = 20.0,
        observation: str = "measured",
        cost: StageCost | Mapping[str, float] | None = None,
        randomize: Mapping[str, Any] | None = None,
        control_step: float = CONTROL_STEP,
        preview: float = 0.25,
        duration: float = 20.0,
        max_episode_steps: int = 4000,
        autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
        sensors: Sensors | Mapping[str, Any] | str | None = None,
        render_mode: str | None = None,
        threads: int | None = None,
    ) -> None:
        if render_mode not in (None, "rgb_array"):
            raise InputError(
                f"render_mode of a batch must be rgb_array, not {render_mode!r}: a window shows one car"
            )
        if not isinstance(num_envs, int) or num_envs < 1:
            raise InputError(f"num_envs must be a positive whole number, not {num_envs!r}")
        try:
            mode = autoreset_mode if isinstance(autoreset_mode, AutoresetMode) else _MODES[autoreset_mode]
        except KeyError:
            raise InputError(
                f"autoreset_mode must be one of {', '.join(_MODES)}, not {autoreset_mode!r}"
            ) from None
        self.autoreset_mode = mode
        self.num_envs = num_envs
        self.render_mode = render_mode
        self.max_episode_steps = max_episode_steps
        self.task = Task(
            num_envs,
            network=network,
            road=road,
            speed=speed,
            observation=observation,
            cost=cost,
            randomize=randomize,
            control_step=control_step,
            preview=preview,
            duration=duration,
            sensors=sensors,
            picture=render_mode is not None,
            threads=_threads(num_envs) if threads is None else threads,
        )
        self.metadata = {
            **self.metadata,
            "autoreset_mode": mode,
            "render_fps": round(1 / control_step),
        }
        self.single_action_space = self.task.action_space
        self.single_observation_space = self.task.observation_space
        self.action_space = gym.vector.utils.batch_space(self.single_action_space, num_envs)
        self.observation_space = gym.vector.utils.batch_space(self.single_observation_space, num_envs)
        self._rngs: list[np.random.Generator] = []
        self.steps = np.zeros(num_envs, np.int64)
        self._done = np.zeros(num_envs, bool)
        self._any_done = False
        self._last = np.zeros((num_envs, self.task.width), np.float32)
        self._oldest = 0
        window = 1 + math.ceil(PICTURE_WINDOW / (speed * control_step))
        #: of each car, for its picture: the road it has come over [m], and what it has cost
        self._trails: list[deque[float]] = [
            deque(maxlen=window) for _ in range(num_envs if render_mode is not None else 0)
        ]
        kept = 1 + math.ceil(PICTURE_PAST / control_step)
        self._pasts: list[Past] = [deque(maxlen=kept) for _ in self._trails]
        self._total_cost = np.zeros(num_envs)
        self._zeros = np.zeros(num_envs)
        self._renderers: list[Renderer] = []

    @property
    def network(self) -> Network:
        """The plant."""
        return self.task.network

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        mask = np.ones(self.num_envs, bool)
        if options and "reset_mask" in options:
            mask = np.asarray(options["reset_mask"])
            if mask.shape != (self.num_envs,) or mask.dtype != bool or not mask.any():
                raise InputError(f"reset_mask must be {self.num_envs} booleans, at least one of them true")
        seeds: list[int | None]
        if seed is None:
            seeds = [None] * self.num_envs
        elif isinstance(seed, int | np.integer):
            seeds = [int(seed) + i for i in range(self.num_envs)]
        else:
            seeds = list(seed)
            if len(seeds) != self.num_envs:
                raise InputError(f"{len(seeds)} seeds for {self.num_envs} environments")
        if not self._rngs:
            self._rngs = [seeding.np_random(s)[0] for s in seeds]
        else:
            for i, s in enumerate(seeds):
                if s is not None:
                    self._rngs[i] = seeding.np_random(s)[0]
        self._restart(np.flatnonzero(mask))
        obs = self._last.copy()  # the others stay where they are
        obs[mask] = self.task.first(np.flatnonzero(mask))
        self._last = obs
        return obs, self._info()

    def _info(self) -> dict[str, Any]:
        """`info` of all cars as they stand."""
        return {"speed": self._speeds, **dict(zip(STEP_INFO, self.task.batch.judged[1:].copy(), strict=True))}

    def _restart(self, which: np.ndarray) -> None:
        batch = self.task.batch
        for i in which:
            batch.reset(int(i), self._rngs[i])
            self.task.forget(int(i), self._rngs[i])
        batch.forget(which)
        self._speeds = batch.speeds.copy()
        self._speeds.setflags(write=False)  # one array is handed out until a car starts again
        for i in which if self._trails else ():
            self._trails[i].clear()
            self._trails[i].append(0.0)
            self._pasts[i].clear()
        self._total_cost[which] = 0.0
        self.steps[which] = 0
        self._done[which] = False
        self._any_done = bool(self._done.any())
        self._oldest = int(self.steps.max())

    def step(
        self, actions: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        if not self._rngs:
            raise gym.error.ResetNeeded("call reset() before step()")
        target = _currents(actions)
        if target.shape != (self.num_envs, 1):
            raise InputError(
                f"the actions must have shape ({self.num_envs}, 1), currents in A, not {target.shape}"
            )
        batch = self.task.batch
        batch.target[:] = target[:, 0]
        if batch.target.dot(self._zeros) != 0.0:  # 0 times what is not finite is nan: cheaper than a mask
            raise InputError(f"action {int(np.argmin(np.isfinite(batch.target)))} is not finite")
        revived = (
            np.flatnonzero(self._done)
            if self._any_done and self.autoreset_mode is AutoresetMode.NEXT_STEP
            else None
        )
        batch.renew()
        batch.step()
        self.steps += 1
        self._oldest += 1
        obs = self.task.observe()
        terminated = batch.gone if batch.broken else np.zeros(self.num_envs, bool)
        if revived is not None:
            self._restart(revived)
            obs[revived] = self.task.first(revived)
            terminated[revived] = False
        reward, *terms = batch.judged
        info = {"speed": self._speeds, **dict(zip(STEP_INFO, terms, strict=True))}
        if self._trails:
            self._total_cost -= reward
            for i in np.flatnonzero(self.steps):  # not where a car has just started again
                self._trails[i].append(float(batch.road_height[i]))
                self._pasts[i].append(moment(self.task, int(i), int(self.steps[i])))
        if self._oldest >= self.max_episode_steps or (batch.broken and terminated.any()):
            truncated = (self.steps >= self.max_episode_steps) & ~terminated
            self._done = terminated | truncated
            self._any_done = bool(self._done.any())
            if self._any_done and self.autoreset_mode is AutoresetMode.SAME_STEP:
                obs = self._restart_now(obs, info)
        else:
            truncated = np.zeros(self.num_envs, bool)
        self._last = obs
        return obs, reward, terminated, truncated, info

    def _restart_now(self, obs: np.ndarray, info: dict[str, Any]) -> np.ndarray:
        which = np.flatnonzero(self._done)
        done = self._done.copy()
        final = np.empty(self.num_envs, object)
        for i in which:
            final[i] = obs[i].copy()
        info["final_obs"], info["_final_obs"] = final, done
        info["final_info"] = {
            k: v.copy() for k, v in info.items() if isinstance(v, np.ndarray) and v.dtype == float
        }
        info["_final_info"] = done
        self._restart(which)
        obs[which] = self.task.first(which)
        info["speed"] = self._speeds
        for name in STEP_INFO:
            info[name][which] = 0.0
        return obs

    def render(self) -> tuple[np.ndarray, ...] | None:
        """A picture (height, width, 3) uint8 of every car; None, with a warning, without a `render_mode`."""
        if self.render_mode is None:
            gym.logger.warn('render() needs a render_mode, e.g. make_vec(..., render_mode="rgb_array")')
            return None
        if not self._rngs:
            raise gym.error.ResetNeeded("call reset() before render()")
        from .rendering import Renderer

        if not self._renderers:
            self._renderers = [Renderer(self.render_mode, fps=PICTURES) for _ in range(self.num_envs)]  # type: ignore[arg-type]
        mean = self._total_cost / np.maximum(self.steps, 1)
        shots = (
            snapshot(self.task, i, int(self.steps[i]), np.array(trail), self._pasts[i], float(mean[i]))
            for i, trail in enumerate(self._trails)
        )
        return tuple(r.draw(s) for r, s in zip(self._renderers, shots, strict=True))  # type: ignore[misc]

    def close_extras(self, **kwargs: Any) -> None:
        for renderer in self._renderers:
            renderer.close()
        self._renderers = []

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_renderers": []}


def _threads(cars: int) -> int:
    """Threads that pay: handing over work costs what some hundred cars take."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return max(1, min(cores, cars // 2048))


_MODES = {
    "next_step": AutoresetMode.NEXT_STEP,
    "same_step": AutoresetMode.SAME_STEP,
    "disabled": AutoresetMode.DISABLED,
}


def moment(task: Task, i: int, steps: int) -> tuple[float, float, float]:
    """Time [s], body acceleration [m/s^2] and suspension travel [m] of car i, for the curves of a picture."""
    out = task.batch.out
    return steps * task.batch.control_step, float(out[0, i]), float(out[1, i])


def snapshot(task: Task, i: int, steps: int, trail: np.ndarray, past: Past, cost: float) -> Snapshot:
    """Car i as a picture shows it; `trail` [m] is the road it has come over, a height per control step, `past` its moments."""
    from .rendering import Snapshot

    batch, net = task.batch, task.network
    out = batch.out[:, i]
    place = {
        c.name.removesuffix("_displacement"): float(out[j])
        for j, c in enumerate(batch.channels)
        if c.name.endswith("_displacement")
    }
    masses = list(net.masses)
    first, second = nodes_of_device(net)
    stops = [e for e in net.elements if isinstance(e, el.BumpStop) and e.between == (first, second)]
    height, step = float(batch.road_height[i]), batch.control_step * float(batch.speeds[i])
    return Snapshot(
        time=steps * batch.control_step,
        body=place[masses[0]],
        wheel=place[masses[1]],
        piston=place.get(str(first)) if first not in masses else None,
        joint=place.get(str(second)) if second not in masses else None,
        road_profile=np.concatenate([trail, height + batch.road_ahead()[i]]),
        road_step=step,
        road_behind=(len(trail) - 1) * step,
        speed=float(batch.speeds[i]),
        current=float(batch.current[i]),
        current_limit=CURRENT_LIMIT if first is not None else None,
        body_acceleration=float(out[0]),
        suspension_travel=float(out[1]),
        tyre_load=float(out[5]),
        static_tyre_load=GRAVITY * sum(net.masses.values()),
        device_travel_limit=stops[0].clearance if stops else None,
        label=net.name,
        cost=cost,
        past=tuple(past),
    )
