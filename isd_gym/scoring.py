"""Scoring policies: the same environment, the same roads, paired differences (`isd-score/1`)."""

from __future__ import annotations

import time as clock
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from . import elements as el
from .comparability import Comparable, comparable
from .cost import StageCost
from .driving import Controller, Crew, Entry, Idle, travel
from .errors import InputError
from .network import Network
from .policies import find, passive
from .road import road as find_road
from .sensors import Sensors
from .vehicle import require_quarter_car

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from .road import Road

__all__ = [
    "LIMITS",
    "PAPER",
    "SCHEMA",
    "Controller",
    "Entry",
    "Idle",
    "Run",
    "Score",
    "drive",
    "frequency_weighting",
    "score",
    "weighted_rms",
]

SCHEMA = "isd-score/1"
RESISTANCE = 3.8  # Ohm, Table 1
LIMITS = {
    "body_acceleration": 5.0,
    "suspension_travel": 0.08,
    "current": 5.0,
    "current_change": 0.5,
}  # Table 5
RESAMPLES = 4000
TIMED = 1500  # decisions of a batched policy that are made again one at a time, against the clock
#: Tables 7 and 8: passive, active RMS of acceleration [m/s^2], travel [m], tyre load [N]
PAPER = {
    "Table 7 (simulation)": ((0.8306, 7.6e-3, 518.0), (0.6565, 6.3e-3, 515.0)),
    "Table 8 (bench)": ((1.0030, 7.9580e-3, 915.9), (0.8416, 7.2479e-3, 941.0)),
}


@dataclass
class Run:
    """Signals of one policy over all episodes, each (steps, episodes); processor times of single decisions [s].

    body_acceleration [m/s^2], suspension_travel [m], tyre_load [N], device_travel_rate [m/s], current [A];
    control_step [s]; fallbacks: a count.
    """

    body_acceleration: np.ndarray
    suspension_travel: np.ndarray
    tyre_load: np.ndarray
    device_travel_rate: np.ndarray
    current: np.ndarray
    thrust: float  # N/A at the terminals
    control_step: float
    times: np.ndarray
    fallbacks: int
    preview: float = 0.0  # s of road ahead that the policy saw

    def cost(self, cost: StageCost) -> np.ndarray:
        """Mean stage cost of each episode (episodes,)."""
        return cost(self.body_acceleration, self.suspension_travel, self.tyre_load, self.current).mean(axis=0)


def frequency_weighting(frequency: np.ndarray) -> np.ndarray:
    """Magnitude of W_k, vertical vibration of a seated person, at `frequency` [Hz] (ISO 2631-1:1997, annex A)."""
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
    """W_k-weighted RMS [m/s^2] along the first axis of `acceleration` sampled every `step` [s]."""
    n = len(acceleration)
    spectrum = np.fft.rfft(acceleration, axis=0)
    gain = frequency_weighting(np.fft.rfftfreq(n, step)).reshape(-1, *[1] * (acceleration.ndim - 1))
    return np.sqrt(np.mean(np.fft.irfft(spectrum * gain, n, axis=0) ** 2, axis=0))


def drive(
    entry: Entry,
    network: Network,
    *,
    road: Any = "paper",
    speed: float = 20.0,
    episodes: int = 32,
    seed: int = 0,
    duration: float = 20.0,
    cost: StageCost | None = None,
    randomize: dict[str, Any] | None = None,
    sensors: Sensors | None = None,
    timed: int = TIMED,
    progress: Callable[[float], None] | None = None,
) -> Run:
    """Drive one policy over all episodes; episode i has the road of environment seed ``seed + i``.

    entry: the policy, on its own plant where it has one, else on `network`. road, randomize, speed [m/s],
    duration [s], sensors: as the environment takes them. episodes: how many. cost: of the reward. timed: decisions of a policy
    for many cars at once that are made again, one at a time, for their processor time. progress(share): told now and then.
    """
    from .env import CONTROL_STEP, ISDSuspensionVectorEnv

    plant = entry.network or network
    crew = Crew(entry, episodes)
    env = ISDSuspensionVectorEnv(
        episodes,
        network=plant,
        road=road,
        speed=speed,
        observation=crew.observation,
        preview=crew.preview or CONTROL_STEP,
        cost=cost,
        randomize=randomize,
        duration=duration,
        sensors=sensors,
        autoreset_mode="disabled",
    )
    steps = round(duration / CONTROL_STEP)
    signals = np.empty((5, steps, episodes))
    seen = []
    for leg in travel(crew, env, steps, seed=seed, progress=progress):
        out, k = env.task.batch.out, leg.step
        signals[0, k], signals[1, k], signals[2, k], signals[3, k] = out[0], out[1], out[5], out[4]
        signals[4, k] = env.task.batch.current
        if crew.batched and k < timed:
            seen.append(leg.seen[0].copy())
    times = crew.times
    if seen:  # one decision at a time, as a controller on a car would make it
        alone = entry.make()
        alone.reset()
        for row in seen:
            begin = clock.process_time()
            alone.act(row)
            times.append(clock.process_time() - begin)
    motor = next((e for e in plant.elements if isinstance(e, el.Motor)), None)
    return Run(
        signals[0],
        signals[1],
        signals[2],
        signals[3],
        signals[4],
        thrust=motor.thrust_constant * motor.ratio if motor else 0.0,
        control_step=CONTROL_STEP,
        times=np.array(times),
        fallbacks=crew.fallbacks,
        preview=crew.preview,
    )


#: what `measures` gives, and in which unit
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
}


def measures(run: Run, cost: StageCost) -> dict[str, tuple[np.ndarray, str]]:
    """Mean squares (or means, for cost and energy) by episode, and the unit of the value."""
    dt = run.control_step
    power = RESISTANCE * run.current**2 - run.thrust * run.current * run.device_travel_rate
    found = {
        "cost": run.cost(cost),
        "body_acceleration_rms": np.mean(run.body_acceleration**2, axis=0),
        "suspension_travel_rms": np.mean(run.suspension_travel**2, axis=0),
        "tyre_load_rms": np.mean(run.tyre_load**2, axis=0),
        "weighted_acceleration_rms": weighted_rms(run.body_acceleration, dt) ** 2,
        "current_rms": np.mean(run.current**2, axis=0),
        "energy": np.sum(power, axis=0) * dt,
        "peak_body_acceleration": np.abs(run.body_acceleration).max(axis=0),
        "peak_suspension_travel": np.abs(run.suspension_travel).max(axis=0),
    }
    return {name: (found[name], unit) for name, unit in MEASURES.items()}


def _pool(name: str, values: np.ndarray) -> np.ndarray:
    """Value over episodes (last axis): root of the mean square, mean, or greatest."""
    if name.endswith("_rms"):
        return np.sqrt(values.mean(axis=-1))
    return values.max(axis=-1) if name.startswith("peak") else values.mean(axis=-1)


def compare(name: str, values: np.ndarray, ground: np.ndarray, unit: str) -> dict[str, Any]:
    """A quantity of the score: the value of episodes (episodes,), and its change against `ground`, episode by episode.

    Both as `measures` gives them for `name`. The 95 % interval is that of the ratio of the pooled values over `RESAMPLES`
    draws of the episodes, the same for every quantity and policy.
    """
    quantity: dict[str, Any] = {"value": float(_pool(name, values)), "unit": unit}
    if np.all(ground > 0):
        episodes = len(values)
        draws = np.random.default_rng(0).integers(episodes, size=(RESAMPLES, episodes))
        ratio = _pool(name, values[draws]) / _pool(name, ground[draws]) - 1.0
        low, high = np.quantile(ratio, [0.025, 0.975])
        change = float(_pool(name, values) / _pool(name, ground) - 1.0)
        quantity |= {"change": change, "low": float(low), "high": float(high)}
    return quantity


def fingerprints(road: Any, speed: float, duration: float, seed: int, episodes: int) -> list[list[float]]:
    """Of each episode's road: its height [m] at every tenth of it, by which others tell that theirs are the same.

    road, speed [m/s], duration [s], seed, episodes: as those of `drive`.
    """
    from gymnasium.utils import seeding

    ground = find_road(road)
    out = []
    for i in range(seed, seed + episodes):
        heights = ground.heights(duration, speed=speed, rng=seeding.np_random(i)[0])
        rows = heights[np.linspace(0, len(heights) - 1, 11).astype(int)[1:]]
        out.append([float(f"{h:.9g}") for h in rows])
    return out


@dataclass
class Score:
    """The outcome of `score`; `to_dict` is `isd-score/1`. `runs` keeps the signals for reports.

    road, network: their names. speed [m/s], duration [s]. episodes: how many, seeds from `seed` on. policies: a
    row each, as the contract has it. sensors: what they saw by. raw: what `measures` says
    of each episode, by policy. roads: a fingerprint of each, see `fingerprints`. references: what puts them in place.
    plant, ground: the network and the road themselves. comparable: which bounds and published figures may stand beside it.
    """

    road: str
    speed: float
    network: str
    episodes: int
    duration: float
    seed: int
    policies: list[dict[str, Any]]
    sensors: Sensors = field(default_factory=Sensors)
    raw: dict[str, dict[str, list[float]]] = field(repr=False, default_factory=dict)
    roads: list[list[float]] = field(repr=False, default_factory=list)
    runs: dict[str, Run] = field(repr=False, default_factory=dict)
    references: dict[str, Any] = field(default_factory=dict)
    plant: Network | None = field(repr=False, default=None)
    ground: Road | None = field(repr=False, default=None)
    comparable: Comparable = field(default_factory=Comparable)

    def to_dict(self) -> dict[str, Any]:
        """The score as the contract has it."""
        return {
            "schema": SCHEMA,
            "road": self.road,
            "speed": {"value": self.speed, "unit": "m/s"},
            "network": self.network,
            "episodes": self.episodes,
            "duration": {"value": self.duration, "unit": "s"},
            "seed": self.seed,
            **({} if self.sensors.perfect else {"sensors": self.sensors.to_dict()}),
            "policies": self.policies,
            "references": self.references,
            "roads": self.roads,
            "raw": self.raw,
        }


def unscored(
    entries: Sequence[Entry],
    network: Network,
    *,
    road: Any,
    speed: float,
    episodes: int,
    duration: float,
    seed: int,
    sensors: Sensors | None = None,
) -> Score:
    """Return the conditions of a score before anything is driven: no quantities, no episodes.

    Args:
        entries: Policies; only their names and previews are told.
        network: Plant.
        road: Road, as `score` takes it.
        speed: Speed [m/s].
        episodes: Number of episodes.
        duration: Length of an episode [s].
        seed: Seed of the first episode.
        sensors: Imperfections of the sensors, if any.
    """
    rows = [{"policy": e.name, "preview": {"value": Crew(e, 1).preview, "unit": "s"}} for e in entries]
    return Score(
        road=getattr(road, "name", str(road)),
        speed=speed,
        network=network.name,
        episodes=episodes,
        duration=duration,
        seed=seed,
        policies=rows,
        sensors=sensors or Sensors(),
        roads=fingerprints(road, speed, duration, seed, episodes),
    )


def score(
    policies: str | Entry | Sequence[str | Entry],
    network: Network | str = "quarter-car-isd",
    *,
    reference: Entry | None = None,
    road: Any = "paper",
    speed: float = 20.0,
    episodes: int = 32,
    seed: int = 0,
    duration: float = 20.0,
    cost: StageCost | None = None,
    randomize: dict[str, Any] | None = None,
    sensors: Sensors | None = None,
    clairvoyant: np.ndarray | None = None,
    ceiling: Callable[[float], dict[str, Any] | None] | None = None,
    progress: Callable[[str, float], None] | None = None,
) -> Score:
    """Score policies, by name or as entries, against `reference` (the conventional passive car) on the same roads.

    Changes are paired: episodes are drawn with replacement, the same ones for both, and the 95 % interval is that of
    the ratio of the pooled values. `clairvoyant`: the least cost known for each episode (episodes,), for the share of the
    reachable gain. `ceiling(preview)`: the bound for controllers that know so many seconds of road (its `change`), for the
    share of the causal gain, which is left out where the sample is too small for it (`comparability`).

    network: the plant. road, randomize, sensors, speed [m/s], duration [s], seed: as those of `drive`. progress(name,
    share): told now and then.
    """
    if episodes < 1:
        raise InputError(f"episodes must be at least 1, not {episodes}")
    if not duration > 0:
        raise InputError(f"duration must be positive, not {duration}")
    network = Network.load(network)
    require_quarter_car(network, "a score is that")
    cost = cost or StageCost()
    named = [policies] if isinstance(policies, str | Entry) else policies
    entries = [find(p, network, cost=cost) if isinstance(p, str) else p for p in named]
    reference = reference or passive(network)
    ground = find_road(road)
    allowed = comparable(
        network,
        ground,
        speed,
        episodes,
        duration,
        randomize=randomize,
        sensors=sensors,
        reference=reference.name,
    )
    if allowed.ceiling:
        ceiling = None
    names = [e.name for e in entries]
    if len(set(names)) != len(names):
        raise InputError("a policy is named twice")
    todo = list(entries) if reference.name in names else [reference, *entries]
    runs: dict[str, Run] = {}
    for entry in todo:
        runs[entry.name] = drive(
            entry,
            network,
            road=road,
            speed=speed,
            episodes=episodes,
            seed=seed,
            duration=duration,
            cost=cost,
            randomize=randomize,
            sensors=sensors,
            progress=None if progress is None else (lambda share, n=entry.name: progress(n, share)),  # type: ignore[misc]
        )
    base = measures(runs[reference.name], cost)
    rows = []
    raw: dict[str, dict[str, list[float]]] = {}
    for entry in todo:
        run = runs[entry.name]
        row: dict[str, Any] = {"policy": entry.name}
        found = measures(run, cost)
        raw[entry.name] = {name: [float(f"{v:.9g}") for v in values] for name, (values, _) in found.items()}
        for name, (values, unit) in found.items():
            row[name] = compare(name, values, base[name][0], unit)
        slew = np.abs(np.diff(run.current, axis=0, prepend=0.0))
        row["limit_violations"] = {
            "body_acceleration": int(np.sum(np.abs(run.body_acceleration) > LIMITS["body_acceleration"])),
            "suspension_travel": int(np.sum(np.abs(run.suspension_travel) > LIMITS["suspension_travel"])),
            "current": int(np.sum(np.abs(run.current) > LIMITS["current"] + 1e-9)),
            "current_change": int(np.sum(slew > LIMITS["current_change"] + 1e-9)),
        }
        row["fallbacks"] = run.fallbacks
        row["control_time"] = {
            "median": float(np.median(run.times)),
            "p99_9": float(np.quantile(run.times, 0.999)),
        }
        row["share_of_reachable_gain"] = None
        if clairvoyant is not None:
            before, own = runs[reference.name].cost(cost).mean(), run.cost(cost).mean()
            row["share_of_reachable_gain"] = float((before - own) / (before - np.mean(clairvoyant)))
        row["preview"] = {"value": run.preview, "unit": "s"}
        bound = ceiling(run.preview) if ceiling is not None else None
        row["share_of_causal_gain"] = row["cost"]["change"] / bound["change"] + 0.0 if bound else None
        rows.append(row)
    kept = [r for r in rows if r["policy"] in names] if reference.name in names else rows
    return Score(
        road=getattr(road, "name", str(road)),
        speed=speed,
        network=network.name,
        episodes=episodes,
        duration=duration,
        seed=seed,
        policies=kept,
        sensors=sensors or Sensors(),
        raw=raw,
        roads=[] if randomize else fingerprints(road, speed, duration, seed, episodes),
        runs=runs,
        plant=network,
        ground=ground,
        comparable=allowed,
    )
