"""Sensors of a controller: noise, delay, and an imperfect preview of the road.

The noise of a channel at a step is a hash of the car's key, the step and the channel. Car i of a batch
therefore has exactly the noise of a single car with the same seed.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from typing import Any

import numpy as np

from .._common.errors import InputError, shown
from .._common.inputs import is_number, is_whole
from .._common.jit import compiled

#: standard deviation of the white noise on each measured signal at noise 1; the current is known exactly
NOISE = {
    "body_acceleration": 0.1,  # m/s^2
    "suspension_travel": 5e-4,  # m
    "suspension_travel_rate": 0.02,  # m/s
    "device_travel": 1e-4,  # m
    "device_travel_rate": 0.01,  # m/s
}
#: standard deviation for the angular accelerations of a body
ANGULAR_NOISE = {
    "pitch_acceleration": 0.1,  # rad/s^2; two accelerometers of `NOISE`, 1.4 m apart
    "roll_acceleration": 0.1,  # rad/s^2
}
MOST_LATE = 100  # largest delay [control steps]


@dataclass(frozen=True)
class Sensors:
    """Imperfections of a controller's sensors; by default all signals are exact and immediate.

    The present current is always known, since the controller sets the current.

    Raises:
        InputError: A value is outside its limits.
    """

    #: white noise of the measured signals as a multiple of `NOISE` [-]; (low, high) to draw the multiple for
    #: every episode
    noise: float | tuple[float, float] = 0.0
    delay: int = 0  # delay of the measured signals [control steps]
    road_error: float = 0.0  # standard deviation of the white error of each height of the road ahead [m]
    # age of the picture of the road [s], which is not compensated
    road_lag: float = 0.0
    # range of the road sensor [m]; beyond, the road appears level
    road_range: float = math.inf

    def __post_init__(self) -> None:
        noise = self.noise
        if isinstance(noise, list | tuple):
            if not (
                len(noise) == 2
                and all(map(is_number, noise))
                and 0 <= noise[0] <= noise[1]
            ):
                raise InputError(
                    f"noise must be 0 or more, or such a (low, high), not {shown(noise)}"
                )
            object.__setattr__(self, "noise", (float(noise[0]), float(noise[1])))
        elif not (is_number(noise) and noise >= 0):
            raise InputError(
                f"noise must be 0 or more, or such a (low, high), not {shown(noise)}"
            )
        delay = self.delay
        if not is_whole(delay, 0, MOST_LATE):
            raise InputError(
                f"delay must be 0 to {MOST_LATE} whole control steps, not {shown(delay)}"
            )
        for name, unit in (("road_error", "m"), ("road_lag", "s")):
            if not (is_number(value := getattr(self, name)) and value >= 0):
                raise InputError(f"{name} must be 0 {unit} or more, not {shown(value)}")
        reach = self.road_range
        if not (reach == math.inf or (is_number(reach) and reach >= 0)):
            raise InputError(f"road_range must be 0 m or more, not {shown(reach)}")

    @classmethod
    def of(cls, given: Sensors | Mapping[str, Any] | str | None) -> Sensors:
        """Return sensors from their attributes.

        Args:
            given: Sensors, attributes by name, or a text such as ``noise=1,road_error=0.001``; None for exact
                sensors.

        Raises:
            InputError: An attribute or its value is invalid.
        """
        if isinstance(given, Sensors):
            return given
        if isinstance(given, str):
            given = _parse(given)
        known = [f.name for f in fields(cls)]
        for key in given or {}:
            if key not in known:
                raise InputError(
                    f"sensors: no {shown(key)}, there are {', '.join(known)}"
                )
        return cls(**(given or {}))

    @property
    def perfect(self) -> bool:
        """Whether all signals are exact and immediate."""
        return self == Sensors()

    def to_dict(self) -> dict[str, Any]:
        """Return the attributes that differ from exact sensors, as plain data."""
        usual = asdict(Sensors())
        return {
            k: list(v) if isinstance(v, tuple) else v
            for k, v in asdict(self).items()
            if v != usual[k]
        }


def _parse(text: str) -> dict[str, Any]:
    out: dict[str, Any] = {}
    for part in filter(None, (p.strip() for p in text.split(","))):
        key, joined, word = (p.strip() for p in part.partition("="))
        try:
            bounds = [float(w) for w in word.split(":")]
        except ValueError:
            bounds = []
        if not (joined and len(bounds) in (1, 2)):
            raise InputError(
                f"sensors: {shown(part)} is not such as noise=1, noise=0:2 or road_error=0.001"
            )
        value: Any = tuple(bounds) if len(bounds) == 2 else bounds[0]
        out[key] = int(value) if key == "delay" and value == int(value) else value
    return out


@compiled()
def _add_noise(
    seen: np.ndarray, keys: np.ndarray, steps: np.ndarray, first: int, sigma: np.ndarray
) -> None:
    """Add Gaussian noise sigma (cars, n) to the columns from `first` of seen (cars, width): two numbers per pair
    of hashes (splitmix64)."""
    for i in range(len(seen)):
        for j in range(0, sigma.shape[1], 2):
            u = np.empty(2)
            for k in range(2):
                x = keys[i] + (
                    steps[i] * np.uint64(4096) + np.uint64(first + j + k + 1)
                ) * np.uint64(0x9E3779B97F4A7C15)
                x = (x ^ (x >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
                x = (x ^ (x >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
                x ^= x >> np.uint64(31)
                u[k] = (float(x >> np.uint64(11)) + 0.5) / 9007199254740992.0
            size = math.sqrt(-2.0 * math.log(u[0]))
            angle = 2.0 * math.pi * u[1]
            seen[i, first + j] += sigma[i, j] * size * math.cos(angle)
            if j + 1 < sigma.shape[1]:
                seen[i, first + j + 1] += sigma[i, j + 1] * size * math.sin(angle)


class Sight:
    """`Sensors` in action on several cars.

    The measured signals come first in an observation, those of the kind 'current' are exact and last among
    them. The road ahead follows: `points` heights of each track, one per control step [s].
    """

    def __init__(
        self,
        sensors: Sensors,
        cars: int,
        signals: Sequence[str],
        tracks: int,
        points: int,
        control_step: float,
    ) -> None:
        """Start with `cars` cars at rest."""
        self.sensors = sensors
        self.signals = len(signals)
        self.step = control_step
        self.tracks, self.points = tracks, points
        self.keys = np.zeros(cars, np.uint64)
        self.count = np.zeros(cars, np.uint64)
        usual = NOISE | ANGULAR_NOISE
        self._usual = np.array([usual[kind] for kind in signals if kind != "current"])
        self.sigma = np.zeros((cars, len(self._usual)))
        self._road_sigma = np.full((cars, tracks * points), sensors.road_error)
        late = round(sensors.road_lag / control_step)
        if abs(late * control_step - sensors.road_lag) > 1e-6 * control_step:
            raise InputError(
                f"road_lag of {sensors.road_lag:g} s is no whole number of control steps of {control_step:g} s"
            )
        self._past = np.zeros((sensors.delay + 1, cars, len(self._usual)))
        self._roads = np.zeros((late + 1, cars, tracks * points))

    def begin(self, i: int, rng: np.random.Generator) -> None:
        """Start a car on a new road."""
        self.count[i] = 0
        self.keys[i] = rng.integers(2**64, dtype=np.uint64)
        noise = self.sensors.noise
        self.sigma[i] = self._usual * (
            rng.uniform(*noise) if isinstance(noise, tuple) else noise
        )

    def get_state(self, i: int) -> tuple[np.ndarray, ...]:
        """Return the memory of a car's sensors."""
        return tuple(part[i].copy() for part in self._parts())

    def set_state(self, i: int, state: Sequence[np.ndarray]) -> None:
        """Put a car's sensors into a state of `get_state`."""
        for part, value in zip(self._parts(), state, strict=True):
            part[i] = value

    def _parts(self) -> tuple[np.ndarray, ...]:
        """Return views of all arrays with a memory, cars first."""
        past, roads = (x.transpose(1, 0, 2) for x in (self._past, self._roads))
        return self.keys, self.count, self.sigma, past, roads

    def see(
        self,
        obs: np.ndarray,
        speeds: np.ndarray,
        which: np.ndarray | slice,
        *,
        first: bool,
    ) -> np.ndarray:
        """Return the reported values of exact observations (cars, width); `first` at the start of a road."""
        n, out = self.sigma.shape[1], obs.copy()
        for past, columns in (
            (self._past, slice(0, n)),
            (
                self._roads,
                slice(self.signals, self.signals + self.tracks * self.points),
            ),
        ):
            if first:  # the car stood still before
                past[:, which] = obs[:, columns]
            elif len(past) > 1:
                past[1:, which] = past[:-1, which]
                past[0, which] = obs[:, columns]
            if len(past) > 1:
                out[:, columns] = past[-1, which]
        keys = self.keys[which]
        count = self.count[which]
        if self.sigma.any():
            _add_noise(out, keys, count, 0, self.sigma[which])
        if self.points:
            if self.sensors.road_error:
                _add_noise(out, keys, count, self.signals, self._road_sigma[which])
            if math.isfinite(self.sensors.road_range):
                reach = (self.sensors.road_range / (speeds * self.step) + 1e-9).astype(
                    int
                )
                last = np.clip(reach - 1, 0, self.points - 1)
                beyond = np.arange(self.points) > last[:, None]
                for begin in range(self.signals, out.shape[1], self.points):
                    ahead = out[:, begin : begin + self.points]
                    ahead[reach == 0] = 0.0
                    end = ahead[np.arange(len(ahead)), last]
                    ahead[beyond] = np.broadcast_to(end[:, None], ahead.shape)[beyond]
        self.count[which] += np.uint64(1)
        return out
