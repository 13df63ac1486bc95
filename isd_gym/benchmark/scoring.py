"""Scores of policies: the same environment, the same roads, paired differences (`isd-score/1`)."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from .._common.errors import InputError, shown
from .._common.seeds import named_roads
from .._common.version import __version__
from ..physics.cost import StageCost, square
from ..physics.network import Network
from ..physics.vehicle import Vehicle, vehicle
from .comparability import Comparable, comparable
from .driving import Conditions, Controller, Crew, Entry, Idle, rounded, travel
from .policies import find_all, passive

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

__all__ = [
    "LIMITS",
    "PAPER",
    "SCHEMA",
    "Conditions",
    "Controller",
    "Entry",
    "Idle",
    "Run",
    "Score",
    "comfort_point",
    "drive",
    "frequency_weighting",
    "score",
    "weighted_rms",
]

SCHEMA = "isd-score/1"
_RESISTANCE = 3.8  # Ohm, Table 1
# Table 5
LIMITS = {
    "body_acceleration": 5.0,
    "suspension_travel": 0.08,
    "current": 5.0,
    "current_change": 0.5,
}
_RESAMPLES = 4000
_TIMED = 1500  # number of decisions of a batched policy that are repeated one at a time to measure the time
#: Tables 7 and 8: passive, active RMS of acceleration [m/s^2], travel [m], tyre load [N]
PAPER = {
    "Table 7 (simulation)": ((0.8306, 7.6e-3, 518.0), (0.6565, 6.3e-3, 515.0)),
    "Table 8 (bench)": ((1.0030, 7.9580e-3, 915.9), (0.8416, 7.2479e-3, 941.0)),
}


def _of_corners(kind: str, unit: str) -> property:
    """Return the property of a `Run` that joins the signals of a kind."""

    def joined(run: Run) -> np.ndarray:
        found = run.of(kind)
        return found[0] if len(found) == 1 else np.stack(found, axis=-1)

    return property(
        joined,
        doc=f"{kind} [{unit}] (steps, episodes), of several corners (steps, episodes, corners).",
    )


@dataclass
class Run:
    """Signals of one policy over all episodes."""

    car: Vehicle  # the driven car
    #: signals (steps, episodes) by name, in SI units. A quarter car has body_acceleration, suspension_travel,
    #: device_travel_rate, tyre_load and current. A car with several corners has the signals of each corner,
    #: with the name of the corner appended, and pitch_acceleration and roll_acceleration
    signals: dict[str, np.ndarray]
    control_step: float  # control step [s]
    times: np.ndarray  # processor times of single decisions [s]
    fallbacks: int  # number of safe substitute decisions
    preview: float = 0.0  # length of the previewed road [s]

    def of(self, kind: str) -> list[np.ndarray]:
        """Return the signals of a kind: of every corner, or of the body.

        Args:
            kind: Name of the signal without the name of the corner.

        Returns:
            Signals (steps, episodes).
        """
        names = dict.fromkeys([kind, *(c.named(kind) for c in self.car.corners)])
        return [self.signals[name] for name in names if name in self.signals]

    @property
    def body_acceleration(self) -> np.ndarray:
        """Vertical acceleration of the body at its centre of gravity [m/s^2] (steps, episodes)."""
        return self.signals["body_acceleration"]

    @property
    def _motions(self) -> list[np.ndarray]:
        """Accelerations of the body (steps, episodes): vertical [m/s^2], then of each axis [rad/s^2]."""
        axes = [self.signals[f"{axis}_acceleration"] for axis in self.car.axes]
        return [self.body_acceleration, *axes]

    suspension_travel = _of_corners("suspension_travel", "m")
    tyre_load = _of_corners("tyre_load", "N")
    device_travel_rate = _of_corners("device_travel_rate", "m/s")
    current = _of_corners("current", "A")

    def acceleration_at(self, point: str) -> np.ndarray:
        """Return the vertical acceleration of a point of the body.

        Args:
            point: Name of the point.

        Returns:
            Acceleration (steps, episodes) [m/s^2].

        Raises:
            InputError: The body has no such point.
        """
        where = _position(self.car, point)
        total = np.zeros_like(self.body_acceleration)
        for arm, motion in zip(self.car.arms(*where), self._motions, strict=True):
            total += arm * motion
        return total

    @property
    def limit_violations(self) -> dict[str, int]:
        """Number of samples beyond each of the `LIMITS`."""
        changes = np.diff(self.current, axis=0, prepend=0.0)
        signals = {
            "body_acceleration": (self.body_acceleration, 0.0),
            "suspension_travel": (self.suspension_travel, 0.0),
            "current": (self.current, 1e-9),
            "current_change": (changes, 1e-9),
        }
        return {
            name: int(np.sum(np.abs(signal) > LIMITS[name] + tolerance))
            for name, (signal, tolerance) in signals.items()
        }

    def cost(self, cost: StageCost) -> np.ndarray:
        """Return the mean stage cost of each episode.

        Args:
            cost: Stage cost of the driven car.

        Returns:
            Mean cost (episodes,) [-].
        """
        currents = self.of("current")
        all_signals = [
            *self._motions,
            *self.of("suspension_travel"),
            *self.of("tyre_load"),
            *currents,
        ]
        factors = cost.factors(self.car.axes, len(self.car.corners), len(currents))
        total = square(factors[0], all_signals[0])
        for factor, signal in zip(factors[1:], all_signals[1:], strict=True):
            total = total + square(factor, signal)
        return total.mean(axis=0)


def _position(car: Vehicle, point: str) -> tuple[float, float]:
    """Return the position of a point of the body. Raise `InputError` for an unknown point."""
    if point not in car.points:
        raise InputError(
            f"no point {shown(point)} on the body of network '{car.network.name}': there are {', '.join(car.points)}"
        )
    return car.points[point]


def comfort_point(car: Vehicle) -> str:
    """Return the default point of the evaluation by ISO 2631-1: the driver, or the centre of gravity.

    Args:
        car: The car.
    """
    return "driver" if "driver" in car.points else car.body


def frequency_weighting(frequency: np.ndarray) -> np.ndarray:
    """Return the magnitude of the frequency weighting W_k for vertical vibration of a seated person.

    Args:
        frequency: Frequencies (n,) [Hz].

    Returns:
        Magnitude (n,) [-].

    References:
        ISO 2631-1:1997, Mechanical vibration and shock, Evaluation of human exposure to whole-body vibration,
            annex A.
    """
    s = 2j * np.pi * np.asarray(frequency, float)

    def second_order(f: float, q: float) -> np.ndarray:
        w = 2 * np.pi * f
        return s**2 + s * w / q + w**2

    w2, w3 = 2 * np.pi * 100.0, 2 * np.pi * 12.5
    high = s**2 / second_order(0.4, np.sqrt(0.5))
    low = w2**2 / second_order(100.0, np.sqrt(0.5))
    transition = (1 + s / w3) * w3**2 / second_order(12.5, 0.63)
    step = second_order(2.37, 0.91) / second_order(3.35, 0.91)
    return np.abs(high * low * transition * step)


def weighted_rms(acceleration: np.ndarray, step: float) -> np.ndarray:
    """Return the W_k-weighted RMS of accelerations along the first axis.

    Args:
        acceleration: Accelerations (n, ...) [m/s^2].
        step: Sampling step [s].

    Returns:
        RMS (...) [m/s^2].
    """
    n = len(acceleration)
    spectrum = np.fft.rfft(acceleration, axis=0)
    gain = frequency_weighting(np.fft.rfftfreq(n, step)).reshape(
        -1, *[1] * (acceleration.ndim - 1)
    )
    return np.sqrt(np.mean(np.fft.irfft(spectrum * gain, n, axis=0) ** 2, axis=0))


def drive(
    entry: Entry,
    network: Network,
    conditions: Conditions,
    *,
    first: int = 0,
    timed: int = _TIMED,
    progress: Callable[[float], None] | None = None,
) -> Run:
    """Drive one policy over all episodes.

    Args:
        entry: The policy, on its own plant, if any.
        network: Plant of a policy without a plant of its own.
        conditions: Road, speed, episodes and sensors.
        first: Index of the first episode.
        timed: Number of decisions of a batched policy that are repeated one at a time to measure the time.
        progress: Called now and then with the finished share.

    Raises:
        InputError: A car breaks, or an argument is invalid.
    """
    from ..env import ISDSuspensionVectorEnv
    from ..env.task import CONTROL_STEP

    plant = entry.network or network
    conditions.check(vehicle(plant))
    episodes = conditions.episodes
    crew = Crew(entry, episodes)
    env = ISDSuspensionVectorEnv(
        episodes,
        network=plant,
        allow_passive=True,
        road=conditions.road,
        speed=conditions.speed,
        observation=crew.observation,
        preview=crew.preview or None,
        duration=conditions.duration,
        sensors=conditions.sensors,
        autoreset_mode="disabled",
    )
    steps = round(conditions.duration / CONTROL_STEP)
    car, batch = env.task.vehicle, env.task.batch
    names = [*(c.name for c in car.channels), *(c.named("current") for c in car.driven)]
    width = len(car.channels)
    signals = np.empty((len(names), steps, episodes))
    seen = []
    legs = travel(
        crew, env, steps, seed=conditions.seed, first=first, progress=progress
    )
    for leg in legs:
        k = leg.step
        signals[:width, k], signals[width:, k] = batch.out[:width], batch.currents
        if crew.batched and k < timed:
            seen.append(leg.seen[0].copy())
    times = crew.times
    if seen:  # one decision at a time, as in a real car
        alone = entry.driver()
        alone.reset()
        for row in seen:
            alone.act(row)
        times = alone.times
    return Run(
        car,
        dict(zip(names, signals, strict=True)),
        control_step=CONTROL_STEP,
        times=np.array(times),
        fallbacks=crew.fallbacks,
        preview=crew.preview,
    )


#: names and units of the results of `measures`
MEASURES = {
    "cost": "-",
    "body_acceleration_rms": "m/s^2",
    "suspension_travel_rms": "m",
    "tyre_load_rms": "N",
    "weighted_acceleration_rms": "m/s^2",
    "current_rms": "A",
    "energy": "J",
    "peak_body_acceleration": "m/s^2",
    "peak_suspension_travel": "m",
    # share of the control steps in which a travel exceeds its limit, and in which a linear tyre would pull on the road
    "travel_exceedance": "-",
    "wheel_lift": "-",
}


def units(car: Vehicle) -> dict[str, str]:
    """Return the unit of each measure of a car: `MEASURES`, and the measures of axes and corners."""
    own = {f"{axis}_acceleration_rms": "rad/s^2" for axis in car.axes}
    if len(car.corners) > 1:
        for kind, unit in (
            ("suspension_travel", "m"),
            ("tyre_load", "N"),
            ("current", "A"),
        ):
            corners = car.driven if kind == "current" else car.corners
            own |= {f"{c.named(kind)}_rms": unit for c in corners}
    return MEASURES | own


def measures(
    run: Run, cost: StageCost, point: str | None = None
) -> dict[str, tuple[np.ndarray, str]]:
    """Return mean squares (means for cost and energy, maxima for peaks) by episode (episodes,), and units,
    for the names of `units`.

    Travel, tyre load and current without the name of a corner combine all corners: the mean of the mean
    squares, and the largest peak. Energy is the sum over all motors. `point` is the point of the
    evaluation by ISO 2631-1.
    """
    dt, car = run.control_step, run.car

    def mean_square(signals: list[np.ndarray]) -> np.ndarray:
        return sum(np.mean(signal**2, axis=0) for signal in signals) / len(signals)

    def peak(signals: list[np.ndarray]) -> np.ndarray:
        return np.max([np.abs(signal).max(axis=0) for signal in signals], axis=0)

    def share(corners: list[np.ndarray]) -> np.ndarray:
        return np.any(corners, axis=0).mean(axis=0)

    energy = np.zeros(run.body_acceleration.shape[1])
    for corner in car.driven:
        current = run.signals[corner.named("current")]
        rate = run.signals[corner.named("device_travel_rate")]
        power = _RESISTANCE * current**2 - car.thrust(corner) * current * rate
        energy = energy + np.sum(power, axis=0) * dt
    found = {
        "cost": run.cost(cost),
        "weighted_acceleration_rms": weighted_rms(
            run.acceleration_at(point or comfort_point(car)), dt
        )
        ** 2,
        "energy": energy,
        "peak_body_acceleration": peak([run.body_acceleration]),
        "peak_suspension_travel": peak(run.of("suspension_travel")),
        "travel_exceedance": share(
            [
                np.abs(l) > LIMITS["suspension_travel"]
                for l in run.of("suspension_travel")
            ]
        ),
        "wheel_lift": share(
            [
                np.zeros_like(load, bool) if static is None else load < -static
                for load, static in zip(
                    run.of("tyre_load"), car.static_tyre_loads, strict=True
                )
            ]
        ),
    }
    out = {}
    for name, unit in units(car).items():
        if name not in found:
            kind = name.removesuffix("_rms")
            is_single = kind in run.signals
            found[name] = mean_square(
                [run.signals[kind]] if is_single else run.of(kind)
            )
        out[name] = (found[name], unit)
    return out


#: kinds of signals in a table, with heading, unit as it is printed, scale and decimals
PRINTED: tuple[dict[str, tuple[str, str, float, int]], ...] = (
    {
        "pitch_acceleration": ("pitch acc.", "rad/s²", 1.0, 3),
        "roll_acceleration": ("roll acc.", "rad/s²", 1.0, 3),
    },
    {"suspension_travel": ("travel", "mm", 1e3, 2)},
    {"tyre_load": ("tyre load", "N", 1.0, 0)},
)


def corner_measures(
    row: dict[str, Any],
) -> list[dict[str, tuple[str, str, int, float]]]:
    """Return heading, unit with the name of the corner, decimals and scale of the measures of axes and corners, one group per
    table; no groups for a quarter car."""
    out = []
    for kinds in PRINTED:
        group = {}
        for name in row:
            kind = next(
                (k for k in kinds if name.startswith(k) and name not in MEASURES), None
            )
            if kind is not None:
                head, unit, scale, digits = kinds[kind]
                words = name.removeprefix(kind).removesuffix("_rms").split("_")
                corner = " ".join(filter(None, words))
                place = f"{corner}, {unit}" if corner else unit
                group[name] = head, place, digits, scale
        out += [group] if group else []
    return out


def _pool(name: str, values: np.ndarray) -> np.ndarray:
    """Return the value over episodes (last axis): root of the mean square, mean, or maximum."""
    if name.endswith("_rms"):
        return np.sqrt(values.mean(axis=-1))
    return values.max(axis=-1) if name.startswith("peak") else values.mean(axis=-1)


def compare(
    name: str, values: np.ndarray, ground: np.ndarray, unit: str
) -> dict[str, Any]:
    """Return value, unit, change, low and high of a quantity of a score, from values (episodes,) of a policy
    and of its reference.

    The 95 % interval is that of the ratio of the pooled values over `_RESAMPLES` draws of the episodes,
    with common draws for all quantities and policies.
    """
    quantity: dict[str, Any] = {"value": float(_pool(name, values)), "unit": unit}
    if np.all(ground > 0):
        episodes = len(values)
        draws = np.random.default_rng(0).integers(episodes, size=(_RESAMPLES, episodes))
        ratio = _pool(name, values[draws]) / _pool(name, ground[draws]) - 1.0
        low, high = np.quantile(ratio, [0.025, 0.975])
        change = float(_pool(name, values) / _pool(name, ground) - 1.0)
        quantity |= {"change": change, "low": float(low), "high": float(high)}
    return quantity


def _policy_row(
    name: str,
    run: Run,
    own: dict[str, tuple[np.ndarray, str]],
    reference: dict[str, tuple[np.ndarray, str]],
) -> dict[str, Any]:
    """Return the row of a policy in a score, from its `measures` and those of the reference."""
    row: dict[str, Any] = {"policy": name}
    row |= {
        key: compare(key, values, reference[key][0], unit)
        for key, (values, unit) in own.items()
    }
    return row | {
        "limit_violations": run.limit_violations,
        "fallbacks": run.fallbacks,
        "control_time": {
            "median": float(np.median(run.times)),
            "p99_9": float(np.quantile(run.times, 0.999)),
        },
        "share_of_reachable_gain": None,
        "preview": {"value": run.preview, "unit": "s"},
        "share_of_causal_gain": None,
    }


@dataclass
class Score:
    """Result of `score`."""

    plant: Network  # the network
    conditions: Conditions  # road, speed, episodes and sensors
    policies: list[dict[str, Any]]  # one row per policy (`isd-score/1`)
    #: values of `measures` by policy and name, one per episode
    raw: dict[str, dict[str, list[float]]] = field(repr=False, default_factory=dict)
    # signals by policy, for reports
    runs: dict[str, Run] = field(repr=False, default_factory=dict)
    # bounds and published figures, as sentences
    references: dict[str, Any] = field(default_factory=dict)
    # allowed bounds and published figures
    comparable: Comparable = field(default_factory=Comparable)
    cost: StageCost = field(default_factory=StageCost)  # stage cost of the car
    reference: str = "passive"  # name of the reference of the changes
    point: str = ""  # point of the body of the evaluation by ISO 2631-1
    # model of the controllers, where it is not the plant
    model: Network | None = field(repr=False, default=None)

    @property
    def shift(self) -> dict[str, float]:
        """Parameters of the plant over those of the controllers' model, where both have them and differ [-]."""
        if self.model is None:
            return {}
        assumed = {
            name: value for name, value in self.model.parameters.items() if value
        }
        true = self.plant.parameters
        return {
            name: true[name] / assumed[name]
            for name in assumed
            if true.get(name, assumed[name]) != assumed[name]
        }

    @property
    def drives(self) -> str:
        """Name of the roads, such as 'scoring roads 0 to 31'."""
        return named_roads(self.conditions.seed, self.conditions.episodes)

    @property
    def comfort(self) -> str:
        """Point of the body of the evaluation by ISO 2631-1, for a car with several points; otherwise ''."""
        return self.point if self.plant.bodies else ""

    def to_dict(self) -> dict[str, Any]:
        """Return the score as plain data.

        Returns:
            Content of a score file (`isd-score/1`).
        """
        conditions = self.conditions
        out: dict[str, Any] = {
            "schema": SCHEMA,
            "version": __version__,
            "road": conditions.road.name,
            "speed": {"value": conditions.speed, "unit": "m/s"},
            "network": self.plant.name,
            "episodes": conditions.episodes,
            "duration": {"value": conditions.duration, "unit": "s"},
            "seed": conditions.seed,
        }
        if not conditions.sensors.perfect:
            out["sensors"] = conditions.sensors.to_dict()
        if self.comfort:
            out["comfort_point"] = self.comfort
        if self.model is not None:
            out["model"] = {"name": self.model.name, "shift": self.shift}
        return out | {
            "policies": self.policies,
            "references": self.references,
            "roads": conditions.fingerprints,
            "raw": self.raw,
        }


def unscored(
    entries: Sequence[Entry], network: Network, conditions: Conditions
) -> Score:
    """Return the conditions of a score before driving, without quantities and episodes."""
    rows = [
        {"policy": e.name, "preview": {"value": Crew(e, 1).preview, "unit": "s"}}
        for e in entries
    ]
    return Score(network, conditions, rows)


#: relative difference from the cost J of zero current within which a policy is said to do nothing
IDLE = 0.005
#: advice for a trained policy with the cost of zero current
LEARN = "A trained policy with this cost learned nothing: train longer, on ISDSuspensionLearning-v0, see docs/tutorials/train.md."


def idle_policies(result: Score) -> list[str]:
    """Return the policies of a score whose cost J is that of zero current, within `IDLE`.

    Args:
        result: The score.

    Returns:
        Names; none for a network without motors.
    """
    network = result.plant
    idle = ("passive", "isd-passive")
    acting = [row for row in result.policies if row["policy"] not in idle]
    has_motor = any(corner.motor is not None for corner in vehicle(network).corners)
    if not acting or not has_motor:
        return []
    entry = Entry("isd-passive", lambda: Idle("isd-passive", network))
    still = drive(entry, network, result.conditions, timed=0)
    cost = float(still.cost(result.cost).mean())
    return [
        row["policy"] for row in acting if abs(row["cost"]["value"] / cost - 1.0) < IDLE
    ]


def score(
    policies: str | Entry | Sequence[str | Entry],
    network: Network | str = "quarter-car-isd",
    *,
    reference: Entry | None = None,
    cost: StageCost | None = None,
    point: str | None = None,
    progress: Callable[[str, float], None] | None = None,
    **conditions: Any,
) -> Score:
    """Score policies against a reference on the same roads.

    Changes are paired: the 95 % interval is that of the ratio of the pooled values over a bootstrap of the
    episodes, with common draws for policy and reference.

    Args:
        policies: Names or entries.
        network: The plant.
        reference: Reference of the changes; None for the conventional passive car.
        cost: Stage cost; None for the usual one of the car.
        point: Point of the body of the evaluation by ISO 2631-1; None for `comfort_point`.
        progress: Called now and then with the name of a policy and its finished share.
        conditions: Values of `Conditions` by name: `road`, `speed` [m/s], `episodes`, `seed`, `duration` [s] and `sensors`.

    Raises:
        InputError: An argument is invalid, a policy is unknown or named twice, or a car breaks.
    """
    network = Network.load(network)
    car = vehicle(network)
    drives = Conditions(**conditions)
    drives.check(car)
    cost = StageCost.of(cost, car.axes, len(car.corners))
    point = point or comfort_point(car)
    _position(car, point)
    named = [policies] if isinstance(policies, str | Entry) else policies
    entries = find_all(named, network, cost=cost, speed=drives.speed)
    reference = reference or passive(network)
    names = [e.name for e in entries]
    if twice := next((n for n in names if names.count(n) > 1), None):
        raise InputError(f"policy {shown(twice, 200)} is named twice")
    todo = list(entries) if reference.name in names else [reference, *entries]
    runs = {}
    for entry in todo:
        tell = progress and partial(progress, entry.name)
        runs[entry.name] = drive(entry, network, drives, progress=tell)
    found = {name: measures(run, cost, point) for name, run in runs.items()}
    rows = [
        _policy_row(name, run, found[name], found[reference.name])
        for name, run in runs.items()
    ]
    return Score(
        network,
        drives,
        rows,
        raw={
            name: {key: rounded(values) for key, (values, _) in own.items()}
            for name, own in found.items()
        },
        runs=runs,
        comparable=comparable(network, drives, reference=reference.name),
        cost=cost,
        reference=reference.name,
        point=point,
    )
