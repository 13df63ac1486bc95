"""Common part of the single and the vector environment: options, spaces, sensors, cost and limits."""

from __future__ import annotations

import copy
import hashlib
import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from gymnasium import spaces

from .._common.errors import InputError, shown
from .._common.inputs import is_number
from ..physics import elements as el
from ..physics._batch import Batch, ranges
from ..physics._kernel.layout import REWARD
from ..physics._tyre_contact import warn_of_pulling_tyres
from ..physics.cost import StageCost
from ..physics.network import Network
from ..physics.road import Road, road
from ..physics.vehicle import CURRENT_LIMIT, SLEW_RATE, Vehicle, state_channels, vehicle
from ._sensors import Sensors, Sight
from .history import BOUND, Remembered, history_of

if TYPE_CHECKING:
    from ..physics._value import Value

CONTROL_STEP = 5e-3  # s
#: limits of options: control step [s], duration of an episode and preview [s], speed [m/s], control steps per action
STEPS, LONGEST, FARTHEST, FASTEST, HELD = (1e-3, 1.0), 1e5, 10.0, 1e3, 1000
SCALES = (1e-6, 1e6)  # factors on the reward
PREVIEW = 0.25  # s, with observation preview
STATE_BOUND = 1e3  # m or m/s, of the full observation
ROAD_BOUND = 10.0  # m, of the preview
# road before the foremost and behind the rearmost wheel in a picture [m]
PICTURE_WINDOW = 5.5
# in the order of `layout`: MEASURED, WHOLE, AHEAD
SHOWN = (
    "measured",
    "full",
    "preview",
)
OBSERVATIONS = (*SHOWN, "history")
EXCEEDS = ("exceeds_acceleration", "exceeds_travel")
USUAL_SPEED = 20.0  # m/s
REWARDS, ACTIONS = ("cost", "relative", "shaped"), ("current", "share", "increment")
#: factor on the relative reward: the sum over a discounted second is then about 2 in an untrained car
RELATIVE_SCALE = 0.1


@dataclass(frozen=True)
class Options:
    """Options of the environments: keyword arguments of ``gymnasium.make`` and ``gymnasium.make_vec``.

    Raises:
        InputError: A value is invalid.
    """

    # vehicle: name of a built-in network, file or content (`isd-model/1`), or a `Network`
    network: str | Path | Mapping[str, Any] | Network = "quarter-car-isd"
    # paper, A ... H, bump, pothole, sweep, a CSV file, a sum such as C+bump, or a `Road`
    road: str | Road = "paper"
    # speed of the vehicle [m/s]
    speed: float = 20.0
    # measured, full (adds the state), preview (adds the road ahead) or history (scaled signals,
    # their changes, velocities of the body, and the front corners as they were before the rear wheels arrive)
    observation: str = "measured"
    # cost: minus the stage cost; shaped: minus the stage cost, the change of the state's value, and without the
    # effect of the road's news, by a linear model of the car (`isd_gym.physics._value`); relative: the cost of a
    # reference on the same road minus the own cost, times `RELATIVE_SCALE`. The reference is the same car without
    # current, or the mean of a group (`cars_per_road`)
    reward: str = "cost"
    # current: commanded currents [A]; share: commanded currents as shares of 5 A; increment: their rates as shares of
    # the drive's fastest rate (100 A/s)
    action: str = "current"
    # number of control steps for which an action is held; the reward is the mean over them
    hold: int = 1
    # whether the reward is divided by the level of the rough road (1 on the paper's road at 20 m/s), so that rough
    # and smooth roads have equal weight
    per_level: bool = False
    # factor on the reward, for learners that weigh it against something else, as SAC does against its entropy bonus
    reward_scale: float = 1.0
    # stage cost, a `StageCost` or its weights, such as {"tyre_load": 0.1}
    cost: StageCost | Mapping[str, Any] | None = None
    # ranges drawn at every reset: factors on parameters of the network, speeds [m/s], roads, such as
    # {"body.mass": (0.8, 1.2), "speed": (15, 30), "road": ["A", "B"]}. Or the folder of a diagnosis, "found" or
    # {"found": "found", "speed": (15, 30)}: the 95 % intervals of its parameters, for network="found/model.json"
    randomize: Mapping[str, Any] | str | Path | None = None
    # whether the network may lack motors, so that actions do nothing
    allow_passive: bool = False
    # time between two actions [s]
    control_step: float = CONTROL_STEP
    # road ahead of the first axle in an observation [s], for observation preview alone; None for 0.25 s there
    preview: float | None = None
    # length of an episode, and of recorded and fixed roads [s]
    duration: float = 20.0
    # imperfections of the sensors (`isd_gym.env.Sensors`), such as {"noise": 1.0, "road_error": 0.001}
    sensors: Sensors | Mapping[str, Any] | str | None = None

    def __post_init__(self) -> None:
        put = object.__setattr__
        for name, known in (
            ("observation", OBSERVATIONS),
            ("reward", REWARDS),
            ("action", ACTIONS),
        ):
            if getattr(self, name) not in known:
                raise InputError(
                    f"{name} must be one of {', '.join(known)}, not {shown(getattr(self, name))}"
                )
        if self.preview is not None and self.observation != "preview":
            raise InputError('preview is for observation="preview" alone; leave it out')
        if self.reward == "shaped" and self.observation == "preview":
            raise InputError(
                'reward="shaped" is for policies that do not see the road ahead; choose another observation, or '
                'reward="relative"'
            )
        if self.preview is None and self.observation == "preview":
            put(self, "preview", PREVIEW)
        for name, low, high, unit in (
            ("speed", 1e-3, FASTEST, "m/s"),
            ("control_step", *STEPS, "s"),
            ("duration", STEPS[0], LONGEST, "s"),
            ("reward_scale", *SCALES, ""),
            *([("preview", 0.0, FARTHEST, "s")] if self.preview is not None else []),
        ):
            value = getattr(self, name)
            if (
                isinstance(value, bool)
                or not isinstance(value, int | float | np.number)
                or not low <= value <= high
            ):
                raise InputError(
                    f"{name} must be a number from {low:g} to {high:g} {unit}".rstrip()
                    + f", not {shown(value)}"
                )
            put(self, name, float(value))
        if (
            isinstance(self.hold, bool)
            or not isinstance(self.hold, int | np.integer)
            or not 1 <= self.hold <= HELD
        ):
            raise InputError(
                f"hold must be a whole number of control steps from 1 to {HELD}, not {shown(self.hold)}"
            )
        kinds = {
            "cost": (StageCost, Mapping),
            "sensors": (Sensors, Mapping, str),
            "randomize": (Mapping, str, Path),
        }
        for name, types in kinds.items():
            value = getattr(self, name)
            if value is not None and not isinstance(value, types):
                raise InputError(
                    f"{name} must be a mapping of names to values, not {shown(value)}"
                )
        if self.network is None or isinstance(self.network, list | tuple):
            raise InputError(
                f"network must be a name, a file, its content or a Network, not {shown(self.network)}"
            )
        network = Network.load(self.network)
        put(self, "network", network)
        put(self, "road", road(self.road))
        put(self, "randomize", ranges(network, self.randomize))
        car = vehicle(network)
        if not self.allow_passive and all(
            corner.motor is None for corner in car.corners
        ):
            raise InputError(
                f"network '{network.name}' has no motor, so that actions would do nothing: choose a network with one, "
                "such as quarter-car-isd, or give allow_passive=True"
            )
        put(self, "cost", StageCost.of(self.cost, car.axes, len(car.corners)))
        put(self, "sensors", Sensors.of(self.sensors))

    @property
    def is_plain(self) -> bool:
        """Whether a decision is one control step with commanded currents and minus its cost as reward."""
        return (
            self.hold == 1
            and self.action == "current"
            and self.reward == "cost"
            and self.observation != "history"
            and not self.per_level
            and self.reward_scale == 1.0
        )

    @property
    def is_direct(self) -> bool:
        """Whether a decision is one control step whose currents and reward are multiples of the action and of a result."""
        return (
            self.hold == 1
            and self.action != "increment"
            and self.reward != "relative"
            and not self.per_level
        )

    @classmethod
    def of(cls, given: Mapping[str, Any]) -> Options:
        """Return options from a mapping, with defaults for missing names.

        Args:
            given: Options by name.

        Raises:
            TypeError: A name is unknown; libraries that try the options of other environments rely on this
                error.
            InputError: A value is invalid.
        """
        known = [f.name for f in fields(cls)]
        for key in given:
            if key not in known:
                raise TypeError(
                    f"the environment got an unexpected keyword argument {shown(key)}; options are {', '.join(known)}"
                )
        return cls(**given)


def _channel_faults(network: Network, names: Sequence[str]) -> list[el.Element]:
    """Return the elements at measured channels. Raise `InputError` for a sensor that leads."""
    faults = [
        e for e in network.elements if e.place == "channel" and e.where[0] in names
    ]
    for e in faults:
        if isinstance(e, el.SensorDelay) and e.delay < 0:
            raise InputError(
                f"element '{e.name}': no sensor of an environment can lead; delay must be >= 0 s"
            )
    return faults


class Task:
    """Cars with the spaces, sensors, costs and limits of the environments.

    `picture` tells whether pictures of the cars will be drawn, `threads` how many threads share them.
    `group` is the number of consecutive cars on one road; with 1 the reference of a relative reward is a
    car without current. The environment writes `actions` (currents, cars) of the next decision, and reads
    `batch.judged`: minus the cost, then the numbers of `step_info`.
    """

    def __init__(
        self,
        count: int,
        options: Options,
        *,
        picture: bool = False,
        threads: int = 1,
        group: int = 1,
    ) -> None:
        """Create `count` cars."""
        assert isinstance(options.network, Network) and isinstance(
            options.cost, StageCost
        )
        assert isinstance(options.sensors, Sensors) and isinstance(
            options.randomize, Mapping
        )
        self.options = options
        self.network = options.network
        self.cost = options.cost
        self.vehicle: Vehicle = vehicle(self.network)
        self.measured = self.vehicle.measured
        self.step_info = (*self.vehicle.costs, *self.vehicle.tyre_loads, *EXCEEDS)
        control_step = options.control_step
        varied = options.randomize
        speed = options.speed
        speeds = varied.get("speed", (options.speed,))
        self.slowest = min(speed, *speeds)
        self.decision = control_step * options.hold
        self.episode = max(1, round(options.duration / self.decision))
        extra = (
            state_channels(self.network)
            if options.observation == "full" or picture
            else []
        )
        self.points = round(options.preview / control_step) if options.preview else 0
        look = self.points * control_step
        if picture:  # a picture shows the road in front of the car
            look = max(look, PICTURE_WINDOW / self.slowest)
            look = control_step * math.ceil(look / control_step)
        drive: dict[str, Any] = {
            "road_": options.road,
            "speed": speed,
            "control_step": control_step,
        }
        drive |= {"duration": options.duration, "randomize": options.randomize}
        self.batch = Batch(count, self.network, **drive, preview=look, extra=extra)
        of = self.batch.of
        signals = len(self.measured)
        self.history = (
            history_of(self.vehicle, control_step, speed)
            if options.observation == "history"
            else None
        )
        self._remembered = (
            Remembered(self.history, count, signals) if self.history else None
        )
        self._make_spaces(extra)
        weights = self.cost.factors(self.vehicle.axes, of.corners, of.currents)
        bounds = [signal.bound for signal in self.measured[: of.measured]]
        self.batch.set_cost(
            weights,
            bounds,
            width=signals if self.history else self.width,
            shows=SHOWN.index(options.observation)
            if options.observation in SHOWN
            else 0,
            lifted=[(0.0,) * of.corners] * of.signals
            + [self.vehicle.shares(c) for c in extra],
            threads=threads,
            value=self._value(),
        )
        self.group = group
        self._reference: Batch | None = None
        if options.reward == "relative" and group == 1:
            self._reference = Batch(count, self.network, **drive)
            self._reference.set_cost(weights, bounds, width=signals, threads=threads)
        self._weights = np.ones(count)
        self._usual = usual_level(self.batch) if options.per_level else 0.0
        self._slew = SLEW_RATE * control_step
        self.actions = np.zeros((of.currents, count))
        #: whether a decision of a single car needs numbers alone: `gain` times the action, and `reward_scale` times a result
        self.is_direct = options.is_direct
        self.gain = CURRENT_LIMIT if options.action == "share" else 1.0
        self.reward_row = of.shaped if options.reward == "shaped" else REWARD
        self._bind()
        self.is_plain = options.is_plain
        self._channel_faults = _channel_faults(
            self.network, [signal.name for signal in self.measured]
        )
        self._histories: dict[str, np.ndarray] = {}
        self.sensors = options.sensors
        self._sight: Sight | None = None
        if not self.sensors.perfect:
            kinds = [signal.kind for signal in self.measured]
            self._sight = Sight(
                self.sensors, count, kinds, of.tracks, self.points, control_step
            )
        self.is_faulty = bool(self._channel_faults) or self._sight is not None
        warn_of_pulling_tyres(
            self.vehicle,
            [road(r) for r in varied.get("road", (options.road,))],
            max(map(float, speeds)),
        )

    def _value(self) -> Value | None:
        """Return the value of the linear car for a shaped reward."""
        if self.options.reward != "shaped":
            return None
        from ..physics._value import value_of

        return value_of(
            self.network, self.cost, self.options.control_step, self.options.speed
        )

    def _bind(self) -> None:
        """Let commanded currents be written where the cars read them."""
        if self.options.action == "current":
            self.actions = self.batch.target

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._bind()

    def _make_spaces(self, extra: list[Any]) -> None:
        high = [signal.bound for signal in self.measured]
        self.labels = [f"{signal.name} [{signal.unit}]" for signal in self.measured]
        step = self.options.control_step
        tracks = self.batch.of.tracks
        if self.options.observation == "full":
            high += [STATE_BOUND] * len(extra)
            self.labels += [
                f"{c.name} [{c.unit}]"
                + (", above the road" if any(self.vehicle.shares(c)) else "")
                for c in extra
            ]
        elif self.options.observation == "preview":
            high += [ROAD_BOUND] * self.points * tracks
            sides = [""] if tracks == 1 else ["left ", "right "]
            self.labels += [
                f"{side}road ahead {(i + 1) * step:.3f} s [m]"
                for side in sides
                for i in range(self.points)
            ]
        self._bounds = np.array(high, np.float32)  # of the signals
        if self.history is not None:
            self.labels = self.history.labels([signal.name for signal in self.measured])
            high = [BOUND] * len(self.labels)
        self.high = np.array(high, np.float32)
        self.width = len(high)
        currents = self.batch.of.currents
        largest = CURRENT_LIMIT if self.options.action == "current" else 1.0
        self.action_space = spaces.Box(-largest, largest, (currents,), np.float32)
        self.observation_space = spaces.Box(-self.high, self.high, dtype=np.float32)
        # Stable-Baselines3 stores the attributes of the spaces in its archives
        self.observation_space.isd_gym = {  # type: ignore[attr-defined]
            "network": self.network.name,
            **{
                k: getattr(self.options, k)
                for k in ("observation", "action", "hold", "control_step", "preview")
            },
        }

    def first(self, which: np.ndarray | slice = slice(None)) -> np.ndarray:
        """Return the observations of cars at rest at the start of their roads."""
        obs = np.zeros(self.batch.seen.shape, np.float32)[which]
        if self.points:
            tracks = range(self.batch.of.tracks)
            ahead = [
                self.batch.road_ahead(self.points, track)[which] for track in tracks
            ]
            obs[:, len(self.measured) :] = np.hstack(ahead)
        if self.is_faulty:
            obs = self._sense(obs, which, first=True)
        if self._remembered is not None:
            self._remembered.begin(which, obs)
            obs = np.clip(self._remembered.features[which], -BOUND, BOUND)
        return obs

    def advance(self) -> np.ndarray:
        """Run one decision: `hold` control steps with the same action.

        `batch.judged` then holds the mean terms of the cost over the control steps, the last tyre loads,
        and whether a limit was exceeded.
        """
        batch = self.batch
        of = self.batch.of
        hold = self.options.hold
        means = 1 + len(self.vehicle.costs)
        watch = self.is_faulty or self._remembered is not None
        earned: Any = 0.0
        reference = 0.0
        for k in range(hold):
            if self.options.action == "increment":
                np.multiply(
                    np.clip(self.actions, -1.0, 1.0), self._slew, out=batch.target
                )
                np.add(batch.target, batch.currents, out=batch.target)
            elif self.options.action == "share":
                # which the kernel limits
                np.multiply(self.actions, CURRENT_LIMIT, out=batch.target)
            batch.step()
            results = batch.results
            earned = earned + results[self.reward_row, : batch.count]
            if k == 0 and hold > 1:
                sums = results[:means].copy()
                marks = results[of.exceeds :].copy()
                broken = batch.broken
            elif k > 0:
                sums += results[:means]
                np.maximum(marks, results[of.exceeds :], out=marks)
                broken = max(broken, batch.broken)
            if watch and k + 1 < hold:
                self.observe()
            if self._reference is not None:
                self._reference.step()
                reference = reference + self._reference.judged[0]
        if hold > 1:
            results[:means], results[of.exceeds :] = sums / hold, marks
            batch.broken = broken
        reward = earned / hold
        if self.options.reward == "relative":
            if self.group > 1:
                by_road = reward.reshape(-1, self.group)
                reward = (by_road - by_road.mean(axis=1, keepdims=True)).ravel()
            else:
                reward = reward - reference / hold
            reward = RELATIVE_SCALE * reward
        if self.options.per_level:
            reward = reward * self._weights
        return (
            reward
            if self.options.reward_scale == 1.0
            else self.options.reward_scale * reward
        )

    def observe(self) -> np.ndarray:
        """Return the observations after a step; observations of broken cars are clipped to their bounds."""
        obs = self.batch.seen
        if self.is_faulty:
            obs = self._sense(obs)
        if self.batch.broken:
            obs = np.clip(np.nan_to_num(obs), -self._bounds, self._bounds)
        if self._remembered is not None:
            self._remembered.see(obs)
            obs = self._remembered.clipped()
        return obs

    def _sense(
        self,
        obs: np.ndarray,
        which: np.ndarray | slice = slice(None),
        *,
        first: bool = False,
    ) -> np.ndarray:
        """Return reported values of exact observations: first faults of the model's channels, then `sensors`."""
        names = [signal.name for signal in self.measured]
        step = self.batch.control_step
        for e in self._channel_faults:
            j = names.index(e.where[0])
            # the same as `apply` for a record, one sample at a time
            if isinstance(e, el.SensorDelay):
                low = int(e.delay / step)
                part = e.delay / step % 1.0
                past = self._histories.setdefault(
                    e.name, np.zeros((low + 2, self.batch.count))
                )
                past[1:, which] = past[:-1, which]
                past[0, which] = obs[:, j]
                obs[:, j] = (1 - part) * past[low, which] + part * past[low + 1, which]
            else:
                obs[:, j] = e.apply(obs[:, j], step)
        if self._sight is not None:
            obs = self._sight.see(obs, self.batch.speeds[which], which, first=first)
        return np.clip(obs, -self._bounds, self._bounds)

    @cached_property
    def made(self) -> dict[str, Any]:
        """What must agree for a state of one task to be a state of another."""
        text = json.dumps(self.network.to_dict(), sort_keys=True)
        return {
            "network": hashlib.sha256(text.encode()).hexdigest()[:16],
            "control_step": self.options.control_step,
            "observation": self.options.observation,
            "preview": self.batch.points,
            "reward": self.options.reward == "shaped" or self._reference is not None,
            "sensors": self.sensors.to_dict(),
            "randomize": sorted(self.batch.drawn),
            "longest delay of a rear wheel": self.batch.kept,
        }

    def get_state(self, i: int) -> dict[str, Any]:
        """Return all that the future of a car depends on, except the actions and the generator of its next roads."""
        return {
            "made": copy.deepcopy(self.made),
            "car": self.batch.get_state(i),
            "reference": None
            if self._reference is None
            else self._reference.get_state(i),
            "sight": None if self._sight is None else self._sight.get_state(i),
            "faults": {
                name: past[:, i].copy() for name, past in self._histories.items()
            },
            "history": None
            if self._remembered is None
            else self._remembered.get_state(i),
            "weight": float(self._weights[i]),
        }

    def set_state(self, i: int, state: Mapping[str, Any]) -> None:
        """Put a car into a state of `get_state`."""
        if not (isinstance(state, Mapping) and isinstance(state.get("made"), Mapping)):
            raise InputError(
                f"a state comes from get_state(), it is not {shown(state)}"
            )
        other = [
            name
            for name, value in self.made.items()
            if state["made"].get(name) != value
        ]
        if other:
            raise InputError(
                f"the state is of a car with another {', another '.join(other)}"
            )
        self.batch.set_state(i, state["car"])
        if self._reference is not None:
            self._reference.set_state(i, state["reference"])
        if self._sight is not None:
            self._sight.set_state(i, state["sight"])
        for name, past in state["faults"].items():
            self._histories.setdefault(name, np.zeros((len(past), self.batch.count)))[
                :, i
            ] = past
        if self._remembered is not None:
            self._remembered.set_state(i, state["history"])
        self._weights[i] = state["weight"]

    def drive_on(self, options: Mapping[str, Any]) -> None:
        """Take road and speed from the options of a reset, for this and all following episodes."""
        if "road" not in options and "speed" not in options:
            return
        ground = road(options.get("road", self.batch.road))
        speed = options.get("speed", self.batch.speed)
        if not is_number(speed) or not 1e-3 <= speed <= FASTEST:
            raise InputError(
                f"speed must be a number from 0.001 to {FASTEST:g} m/s, not {shown(speed)}"
            )
        for batch in (self.batch, self._reference):
            if batch is not None:
                batch.drive_on(ground, float(speed))
        warn_of_pulling_tyres(self.vehicle, [ground], float(speed))

    def begin(self, i: int, rng: np.random.Generator) -> None:
        """Put a car, and its reference, at rest at the start of a new road."""
        if self._reference is not None:
            self._reference.reset(i, copy.deepcopy(rng))
        self.batch.reset(i, rng)
        if self._sight is not None:
            self._sight.begin(i, rng)
        for past in self._histories.values():
            past[:, i] = 0.0
        if self.options.per_level:
            level = float(self.batch.levels[i])
            # a bump has weight 1
            self._weights[i] = self._usual / level if level > 0.0 else 1.0


def usual_level(batch: Batch) -> float:
    """Return the level of the paper's road at the usual speed."""
    ground, step = road("paper"), batch.plant.step
    if batch.of.tracks == 1:
        return float(ground.noise(USUAL_SPEED, step)[0] ** 2)
    return float(
        ground.track_filters(batch.vehicle.wheels.width, USUAL_SPEED, step)[1][0] ** 2
    )


def info_maker(
    names: Sequence[str],
) -> Callable[[float, Sequence[float]], dict[str, float]]:
    """Return a function that makes `info` from the speed and the numbers of the kernel, the first of which is
    minus the cost; a dictionary display takes a third of the time of `dict` and `zip`."""
    pairs = ", ".join(f"{name!r}: told[{i}]" for i, name in enumerate(names, 1))
    return eval(f"lambda speed, told: {{'speed': speed, 'cost': -told[0], {pairs}}}")
