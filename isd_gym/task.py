"""Common part of the single and the vector environment: options, spaces, sensors, cost and limits."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any

import numpy as np
from gymnasium import spaces

from . import elements as el
from .batch import CURRENT_LIMIT, Batch
from .cost import StageCost
from .errors import InputError, shown
from .network import Network
from .road import Road, road
from .sensors import Sensors, Sight
from .tyre_contact import warn_of_pulling_tyres
from .vehicle import Vehicle, state_channels, vehicle

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from pathlib import Path


CONTROL_STEP = 5e-3  # s
STATE_BOUND = 1e3  # m or m/s, of the full observation
ROAD_BOUND = 10.0  # m, of the preview
PICTURE_WINDOW = 5.5  # road before the foremost and behind the rearmost wheel in a picture [m]
OBSERVATIONS = ("measured", "full", "preview")  # in the order of `layout`: MEASURED, WHOLE, AHEAD


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
    # measured, full (adds the state) or preview (adds the road ahead)
    observation: str = "measured"
    # stage cost, a `StageCost` or its weights, such as {"tyre_load": 0.1}
    cost: StageCost | Mapping[str, Any] | None = None
    # ranges drawn at every reset: factors on parameters of the network, speeds [m/s], roads, such as
    # {"body.mass": (0.8, 1.2), "speed": (15, 30), "road": ["A", "B"]}
    randomize: Mapping[str, Any] | None = None
    # time between two actions [s]
    control_step: float = CONTROL_STEP
    # road ahead of the first axle in an observation [s], with observation preview
    preview: float = 0.25
    # length of recorded and fixed roads [s]; the time limit is max_episode_steps
    duration: float = 20.0
    # imperfections of the sensors (`isd_gym.sensors.Sensors`), such as {"noise": 1.0, "road_error": 0.001}
    sensors: Sensors | Mapping[str, Any] | str | None = None

    def __post_init__(self) -> None:
        if self.observation not in OBSERVATIONS:
            raise InputError(
                f"observation must be one of {', '.join(OBSERVATIONS)}, not {shown(self.observation)}"
            )
        if not (isinstance(self.speed, int | float) and math.isfinite(self.speed) and self.speed > 0):
            raise InputError(f"speed must be a positive number of m/s, not {shown(self.speed)}")
        network = Network.load(self.network)
        put = object.__setattr__
        put(self, "network", network)
        put(self, "road", road(self.road))
        car = vehicle(network)
        put(self, "cost", StageCost.of(self.cost, car.axes, len(car.corners)))
        put(self, "sensors", Sensors.of(self.sensors))

    @classmethod
    def of(cls, given: Mapping[str, Any]) -> Options:
        """Return options from a mapping, with defaults for missing names.

        Args:
            given: Options by name.

        Returns:
            The options.

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


class Task:
    """Cars with the spaces, sensors, costs and limits of the environments.

    Args:
        count: Number of cars.
        options: Options of the environment.
        picture: Whether pictures of the cars will be drawn.
        threads: Number of threads that share the cars.

    Attributes:
        options: Options of the environment.
        network: Network of the cars.
        vehicle: The network as a car.
        batch: Cars on their roads.
        labels: Name and unit of each number of an observation.
        slowest: Lowest speed of a car [m/s].
        step_info: Names of the numbers in `info` of a step after the speed, in the order of `Batch.judged`.
        is_faulty: Whether a policy sees signals with errors.

    Raises:
        InputError: The network is no car, or an option is invalid.
    """

    def __init__(self, count: int, options: Options, *, picture: bool = False, threads: int = 1) -> None:
        """Create `count` cars."""
        assert isinstance(options.network, Network) and isinstance(options.cost, StageCost)
        assert isinstance(options.sensors, Sensors)
        self.options, self.network, self.cost = options, options.network, options.cost
        self.vehicle: Vehicle = vehicle(self.network)
        self.measured = self.vehicle.measured
        self.step_info = (*self.vehicle.costs, *self.vehicle.tyre_loads)
        control_step, varied = options.control_step, options.randomize or {}
        speed, speeds = options.speed, varied.get("speed", (options.speed,))
        self.slowest = min(speed, *speeds)
        extra = state_channels(self.network) if options.observation == "full" or picture else []
        self.points = round(options.preview / control_step) if options.observation == "preview" else 0
        look = self.points * control_step
        if picture:  # a picture shows the road in front of the car
            look = max(look, PICTURE_WINDOW / self.slowest)
            look = control_step * math.ceil(look / control_step)
        self.batch = Batch(
            count,
            self.network,
            road_=options.road,
            speed=speed,
            control_step=control_step,
            duration=options.duration,
            randomize=options.randomize,
            preview=look,
            extra=extra,
        )
        of = self.batch.of
        self._make_spaces(extra)
        self.batch.judge(
            self.cost.factors(self.vehicle.axes, of.corners, of.currents),
            [signal.bound for signal in self.measured[: of.measured]],
            width=self.width,
            shows=OBSERVATIONS.index(options.observation),
            lifted=[(0.0,) * of.corners] * of.signals + [self.vehicle.shares(c) for c in extra],
            threads=threads,
        )
        names = [signal.name for signal in self.measured]
        self._channel_faults = [
            e for e in self.network.elements if e.place == "channel" and e.where[0] in names
        ]
        for e in self._channel_faults:
            if isinstance(e, el.SensorDelay) and e.delay < 0:
                raise InputError(
                    f"element '{e.name}': no sensor of an environment can lead; delay must be >= 0 s"
                )
        self._histories: dict[str, np.ndarray] = {}
        self.sensors = options.sensors
        self._sight = (
            None
            if self.sensors.perfect
            else Sight(
                self.sensors,
                count,
                [signal.kind for signal in self.measured],
                of.tracks,
                self.points,
                control_step,
            )
        )
        self.is_faulty = bool(self._channel_faults) or self._sight is not None
        warn_of_pulling_tyres(
            self.vehicle, [road(r) for r in varied.get("road", (options.road,))], max(map(float, speeds))
        )

    def _make_spaces(self, extra: list[Any]) -> None:
        high = [signal.bound for signal in self.measured]
        self.labels = [f"{signal.name} [{signal.unit}]" for signal in self.measured]
        step, tracks = self.options.control_step, self.batch.of.tracks
        if self.options.observation == "full":
            high += [STATE_BOUND] * len(extra)
            self.labels += [
                f"{c.name} [{c.unit}]" + (", above the road" if any(self.vehicle.shares(c)) else "")
                for c in extra
            ]
        elif self.options.observation == "preview":
            high += [ROAD_BOUND] * self.points * tracks
            sides = [""] if tracks == 1 else ["left ", "right "]
            self.labels += [
                f"{side}road ahead {(i + 1) * step:.3f} s [m]" for side in sides for i in range(self.points)
            ]
        self.high = np.array(high, np.float32)
        self.width = len(high)
        currents = self.batch.of.currents
        self.action_space = spaces.Box(-CURRENT_LIMIT, CURRENT_LIMIT, (currents,), np.float32)
        self.observation_space = spaces.Box(-self.high, self.high, dtype=np.float32)

    def first(self, which: np.ndarray | slice = slice(None)) -> np.ndarray:
        """Return the observations of cars at rest at the start of their roads.

        Args:
            which: Indices of the cars.

        Returns:
            Observations (cars, width).
        """
        obs = np.zeros((self.batch.count, self.width), np.float32)[which]
        if self.points:
            tracks = range(self.batch.of.tracks)
            ahead = [self.batch.road_ahead(self.points, track)[which] for track in tracks]
            obs[:, len(self.measured) :] = np.hstack(ahead)
        return self._sense(obs, which, first=True) if self.is_faulty else obs

    def observe(self) -> np.ndarray:
        """Return the observations after a step; observations of broken cars are clipped to their bounds.

        Returns:
            Observations (count, width) float32.
        """
        obs = self.batch.seen
        if self.is_faulty:
            obs = self._sense(obs)
        if self.batch.broken:
            obs = np.clip(np.nan_to_num(obs), -self.high, self.high)
        return obs

    def _sense(
        self, obs: np.ndarray, which: np.ndarray | slice = slice(None), *, first: bool = False
    ) -> np.ndarray:
        """Return reported values of exact observations: first faults of the model's channels, then `sensors`.

        Physics and reward use the exact signals.
        """
        names = [signal.name for signal in self.measured]
        step = self.batch.control_step
        for e in self._channel_faults:
            j = names.index(e.where[0])
            if isinstance(e, el.SensorDelay):  # the same as `apply` for a record, one sample at a time
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
        """Start a car on a new road.

        Args:
            i: Index of the car.
            rng: Generator of the car, after the draw of the road.
        """
        if self._sight is not None:
            self._sight.begin(i, rng)
        for past in self._histories.values():
            past[:, i] = 0.0


def info_maker(names: Sequence[str]) -> Callable[[float, Sequence[float]], dict[str, float]]:
    """Return a function that makes `info` from the speed and the numbers of the kernel.

    A dictionary display takes a third of the time of `dict` and `zip`.

    Args:
        names: Names of the numbers after the first number of the kernel.

    Returns:
        ``info(speed [m/s], numbers) -> dict``.
    """
    pairs = ", ".join(f"{name!r}: told[{i}]" for i, name in enumerate(names, 1))
    return eval(f"lambda speed, told: {{'speed': speed, {pairs}}}")
