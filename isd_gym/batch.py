"""Cars on roads in lockstep: what the single and the vector environment both are, without spaces or rewards.

A batch of one and a batch of a thousand run the same code in the same order, so car i of a batch is the single car
of its seed to the last bit.
"""

from __future__ import annotations

import math
import os
from queue import SimpleQueue
from threading import Thread
from typing import TYPE_CHECKING, Any

import numpy as np

from . import elements as el
from .errors import InputError
from .kernel import layout as place
from .kernel.layout import TOGETHER, WIDTH, aligned
from .network import GROUND, Channel, Network
from .road import Road, road
from .simulate import PHYSICS_STEP, Plant, discretise

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

CURRENT_LIMIT = 5.0  # A, Table 5
SLEW_LIMIT = 0.5  # A per control step, Table 5
NO_SATURATION = 1e9
LATE = 100  # groups of cars that this thread does while another one wakes (some 40 us)

#: what every car reports, in the order of the outputs of the kernel
SIGNALS = (
    "body_acceleration",
    "suspension_travel",
    "suspension_travel_rate",
    "device_travel",
    "device_travel_rate",
    "tyre_load",
)


def signal_channels(network: Network) -> list[Channel]:
    """The signals of a car, as channels of its network.

    body and wheel are the first two masses, the device is what stands between the motor's terminals, the road is the
    moved node. A car without a motor reports its suspension in the device's place.
    """
    masses = list(network.masses)
    if len(masses) < 2 or not any(c.quantity == "displacement" for c in network.moving):
        raise InputError(
            f"network '{network.name}' is no car: it needs two masses and a displacement input (the road)"
        )
    body, wheel = masses[0], masses[1]
    motor = next((e for e in network.elements if isinstance(e, el.Motor)), None)
    device = motor.between if motor is not None else (body, wheel)
    return [
        Channel("body_acceleration", "acceleration", "m/s^2", at=body),
        Channel("suspension_travel", "displacement", "m", between=(body, wheel)),
        Channel("suspension_travel_rate", "velocity", "m/s", between=(body, wheel)),
        Channel("device_travel", "displacement", "m", between=device),
        Channel("device_travel_rate", "velocity", "m/s", between=device),
        Channel("tyre_load", "force", "N", at=network.moved_nodes[0]),
    ]


def state_channels(network: Network) -> list[Channel]:
    """Displacement and velocity of every free node, for the full observation and for pictures."""
    out = []
    for node in network.nodes:
        if node not in network.moved_nodes:
            out.append(Channel(f"{node}_displacement", "displacement", "m", at=node))
            out.append(Channel(f"{node}_velocity", "velocity", "m/s", at=node))
    return out


class Batch:
    """`count` cars of one network (or of a spread of it), each on its own road.

    network: the plant. road, speed [m/s]: fixed, or ranges in `randomize`. control_step must be a whole multiple of
    physics_step [s]. duration [s] is the length of fixed profiles. randomize: parameter path -> (low, high) factors on its
    value; 'speed' -> (low, high) [m/s]; 'road' -> a list of roads. preview [s] of road, in whole control steps, is
    drawn ahead.
    """

    def __init__(
        self,
        count: int,
        network: Network,
        *,
        road_: str | Road = "paper",
        speed: float = 20.0,
        control_step: float = 5e-3,
        physics_step: float = PHYSICS_STEP,
        duration: float = 20.0,
        randomize: Mapping[str, Any] | None = None,
        preview: float = 0.0,
        extra: Sequence[Channel] = (),
    ) -> None:
        self.count, self.network = count, network
        self.substeps = round(control_step / physics_step)
        if self.substeps < 1 or abs(self.substeps * physics_step - control_step) > 1e-9 * control_step:
            raise InputError(
                f"control step {control_step} s is not a whole multiple of physics step {physics_step} s"
            )
        if not (isinstance(speed, int | float) and math.isfinite(speed) and speed > 0):
            raise InputError(f"speed must be a positive number of m/s, not {speed!r}")
        self.control_step, self.speed, self.duration = control_step, float(speed), duration
        self.road = road(road_)
        self.randomize = dict(randomize or {})
        self._check_randomize()
        self._spread = {k: v for k, v in self.randomize.items() if k not in ("speed", "road")}
        self._roads = [road(r) for r in self.randomize.get("road", [])]
        # the network's own outputs are not needed here: the signals take their place
        bare = Network(
            network.name,
            network.masses,
            tuple(e for e in network.elements if e.place != "channel"),
            network.inputs,
        )
        self._bare = bare
        self.channels = [*signal_channels(network), *extra]
        self.groups = -(-count // WIDTH)
        networks: Network | list[Network] = [bare] * WIDTH if self._spread else bare
        self.plant = plant = Plant(networks, physics_step, lanes=WIDTH, extra=self.channels)
        self._mats = plant.mats
        if self._spread:
            self._mats = aligned(self.groups, *plant.mats.shape[1:])
            self._mats[:] = plant.mats
        columns = {part: -1 for part in ("r", "v", "alpha")}
        for j, (part, name) in enumerate(plant.labels):
            if part in columns and name == plant.networks[0].inputs[self._road_input()].name:
                columns[part] = j
        if any(c.quantity == "condition" for c in network.inputs):
            raise InputError(
                f"network '{network.name}': the environment has no logged channels; leave them out"
            )
        if len(plant.currents) > 1:
            raise InputError(
                f"network '{network.name}' has more than one current; the environment drives one"
            )
        self._states = aligned(self.groups, plant.at.height, WIDTH)
        wide = self.groups * WIDTH  # rows hold whole groups of cars; those beyond `count` stand still
        self._cars = aligned(place.SIGNALS + len(self.channels), wide)
        self._ways = np.zeros((3, wide), np.int64)
        self._cars[place.SATURATION] = NO_SATURATION
        known = (el.ActuatorLag, el.ActuatorDelay, el.ThrustSaturation)
        for e in network.elements:
            if e.place == "element" and not isinstance(e, known):
                raise InputError(f"element '{e.name}': the environment's drive has no {e.type}; leave it out")
        lag, delay, saturation = (
            next((e for e in network.elements if isinstance(e, kind)), None) for kind in known
        )
        if isinstance(lag, el.ActuatorLag) and lag.time_constant > 0:
            self._cars[place.LAG_POLE] = math.exp(-physics_step / lag.time_constant)
        if isinstance(saturation, el.ThrustSaturation):
            self._cars[place.SATURATION] = saturation.current
        if isinstance(delay, el.ActuatorDelay):
            self._cars[place.DELAY] = delay.delay / physics_step
        steps_late = self._cars[place.DELAY].max()
        self._past = np.zeros((int(steps_late) + 2 if steps_late else 0, wide))
        self.points = round(preview / control_step)
        # the road drawn ahead: of every physics step of a control step a ring that begins at ints[-1], and the last of them
        # once more, a car's points side by side
        self._rings = aligned(self.substeps, self.points, wide)
        self._ahead = np.zeros((wide, self.points))
        self.table = np.zeros(0)
        driven = any(e is not None for e in (lag, delay, saturation))
        self._ints = np.concatenate(
            [plant.ints, [count, self.substeps, *columns.values(), driven, False, place.MEASURED, 0]]
        )
        self._settings = np.zeros(place.LIFTED + len(self.channels))
        self._settings[[place.CURRENT_LIMIT, place.SLEW_LIMIT]] = CURRENT_LIMIT, SLEW_LIMIT
        self._settings[place.BOUNDS : place.LIFTED] = math.inf
        self.seen = np.zeros((count, 6), np.float32)
        self._said = np.zeros((place.SAID, wide))
        self.speeds = np.full(count, self.speed)
        self.threads = 1
        self._arguments()

    def _arguments(self) -> None:
        """The arguments of the kernel, and what is seen of them from here: views, made once."""
        at, count = self.plant.at, self.count
        self._drive: Callable[..., int] | None = None
        self._drive_arguments = (
            *(self._mats.reshape(-1), self._ints, self._states.reshape(-1), self._cars, self._ways),
            *(self.table, self._past, self._rings, self._ahead, self._settings),
        )
        threads = max(1, min(self.threads, self.groups))
        late = min(LATE, self.groups // threads)
        ends = [0, *(late + (self.groups - late) * i // threads for i in range(1, threads + 1))]
        inputs = (self.substeps + 1) * at.inputs + self.substeps * at.currents
        self._shares = [
            (aligned(TOGETHER, inputs, WIDTH).ravel(), begin, stop)
            for begin, stop in zip(ends[:-1], ends[1:], strict=True)
        ]
        self._calls: list[tuple[Any, ...]] = []
        self._crew: Crew | None = None
        self.cars, self.out = self._cars[:, :count], self._cars[place.SIGNALS :, :count]
        self.counters = self._ways[place.COUNTER].view(np.uint64)
        self.target = self.cars[place.TARGET]  # currents that are asked for [A] (count,)
        self._write_to(self._said, self.seen)

    def _write_to(self, said: np.ndarray, seen: np.ndarray) -> None:
        self._said, self.seen = said, seen
        self._first_said, self.first_seen = said[:, 0], seen[0]
        self._calls = [(*self._drive_arguments, said, seen, *share) for share in self._shares]

    def renew(self) -> None:
        """What the last step said and showed is somebody else's now; the next one writes elsewhere."""
        self._write_to(np.empty(self._said.shape), np.empty(self.seen.shape, np.float32))

    def __getstate__(self) -> dict[str, Any]:
        views = ("cars", "out", "counters", "target")
        return {
            k: v
            for k, v in self.__dict__.items()
            if k
            not in (
                *views,
                "_drive",
                "_drive_arguments",
                "_shares",
                "_calls",
                "_crew",
                "_first_said",
                "first_seen",
            )
        }

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._arguments()

    def judge(
        self,
        weights: Sequence[float],
        bounds: Sequence[float],
        *,
        width: int = 6,
        shows: int = place.MEASURED,
        lifted: Sequence[bool] = (),
        threads: int = 1,
    ) -> None:
        """Have every step limit the currents that `target` asks for, and give rewards, costs and observations.

        weights: factors on the squares of acceleration, travel, tyre load and current; bounds of the five measured signals;
        width of an observation, and what it `shows` (`layout`); of which outputs the road's height is taken off.
        threads: how many share the cars. The results do not depend on it.
        """
        self._ints[-3], self._ints[-2] = True, shows
        self._settings[place.WEIGHTS : place.BOUNDS] = weights
        self._settings[place.BOUNDS : place.LIFTED] = bounds
        self._settings[place.LIFTED : place.LIFTED + len(lifted)] = lifted
        self.seen, self.threads = np.zeros((self.count, width), np.float32), threads
        self._arguments()

    def _road_input(self) -> int:
        return next(i for i, c in enumerate(self.network.inputs) if c.quantity == "displacement")

    def _check_randomize(self) -> None:
        known = self.network.parameters
        for key, value in self.randomize.items():
            if key == "road":
                if isinstance(value, str) or not len(value):
                    raise InputError("randomize: 'road' must be a list of roads")
                continue
            if key != "speed" and key not in known:
                raise InputError(
                    f"randomize: no parameter '{key}' (there are speed, road, {', '.join(known)})"
                )
            try:
                low, high = (float(v) for v in value)
            except (TypeError, ValueError):
                raise InputError(f"randomize: '{key}' must be a pair (low, high), not {value!r}") from None
            if not 0 < low <= high < math.inf:
                raise InputError(f"randomize: '{key}' needs 0 < low <= high, not ({low:g}, {high:g})")

    # ---------------------------------------------------------------------------------------- reset

    def reset(self, i: int, rng: np.random.Generator) -> None:
        """Put car i at rest at the start of a new road, all drawn from its own generator."""
        if self._spread:
            self._redraw(i, rng)
        speed = self.speed
        if "speed" in self.randomize:
            speed = float(rng.uniform(*self.randomize["speed"]))
        ground = self._roads[int(rng.integers(len(self._roads)))] if self._roads else self.road
        self.speeds[i] = speed
        h, cars = self.plant.step, self._cars
        cars[place.ROUGH_GAIN, i], cars[place.ROUGH_POLE, i] = ground.noise(speed, h)
        for row in (place.CURRENT, place.LAGGED, place.HEIGHT, place.HEIGHT_RATE, place.ROUGH, place.TARGET):
            cars[row, i] = 0.0
        self._past[:, i] = 0.0
        self.counters[i] = rng.integers(0, 2**64, dtype=np.uint64)
        fixed = ground.fixed(speed, h, round(self.duration / h) + self.points * self.substeps, rng)
        self._give(i, fixed)
        group, lane = divmod(i, WIDTH)
        self._states[group, :, lane] = 0.0
        if self.points:
            from .kernel.cars import road_noise

            rough = np.empty(self.points * self.substeps)
            self.counters[i] = road_noise(
                self.counters[i], cars[place.ROUGH_GAIN, i], cars[place.ROUGH_POLE, i], 0.0, rough
            )
            cars[place.ROUGH, i] = rough[-1]
            if len(fixed):
                count = min(len(rough), len(fixed))
                rough[:count] += fixed[:count]
                rough[count:] += fixed[-1]
                self._ways[place.PROFILE, i] += count
            ring = np.roll(rough.reshape(self.points, self.substeps), self._ints[-1], axis=0)
            self._rings[:, :, i], self._ahead[i] = ring.T, ring[:, -1]

    def _give(self, i: int, fixed: np.ndarray) -> None:
        """Give car i its fixed profile, in a slot of the table; the kernel holds the last height after its end."""
        ways = self._ways[: place.COUNTER, : self.count]
        if not len(fixed):
            ways[:, i] = 0
            return
        slot = len(self.table) // self.count
        if len(fixed) > slot:
            table = np.zeros((self.count, len(fixed)))
            table[:, :slot] = self.table.reshape(self.count, slot)
            begin, old = np.arange(self.count), ways.copy()
            ways[:] = np.where(old[1] > 0, old + begin * (len(fixed) - slot), 0)
            self.table, slot = table.ravel(), len(fixed)
            self._arguments()
        self.table[i * slot : i * slot + len(fixed)] = fixed
        ways[:, i] = i * slot, i * slot + len(fixed)

    def _redraw(self, i: int, rng: np.random.Generator) -> None:
        from .network import assemble

        nominal = self._bare.parameters
        values = {k: nominal[k] * float(rng.uniform(*v)) for k, v in self._spread.items() if k in nominal}
        asm = assemble(self._bare.with_parameters(values), self.channels)
        part = discretise(asm, self.plant.step, self.plant.u_columns)
        self.plant.place(self._mats, i, part)

    # ----------------------------------------------------------------------------------------- step

    def step(self) -> np.ndarray:
        """Run one control step with the currents in `current` (after `judge`: `target`); returns `out` (signals, count), SI units."""
        drive = self._drive or self._compiled()
        if len(self._calls) == 1:
            self.broken = drive(*self._calls[0])
        else:
            if self._crew is None or self._crew.process != os.getpid():  # threads do not outlive a fork
                self._crew = Crew(len(self._calls))
            self.broken = sum(self._crew.do(drive, self._calls))
        if self.points:
            self._ints[-1] = (self._ints[-1] + 1) % self.points
        return self.out

    def _compiled(self) -> Callable[..., int]:
        """The kernel for the types of these arguments, which stay: they need not be looked up at every step."""
        from numba import typeof

        self._drive = self.plant.kernel.drive.compile(tuple(map(typeof, self._calls[0])))  # type: ignore[attr-defined]
        return self._drive

    @property
    def current(self) -> np.ndarray:
        """Present commanded current [A] (count,)."""
        return self.cars[place.CURRENT]

    def alone(self) -> tuple[float, ...]:
        """Of the first car: reward, four terms of the cost, dynamic tyre load [N], and 1 where it broke."""
        return self._first_said.tolist()

    @property
    def judged(self) -> np.ndarray:
        """Of the last step, rows: reward, four terms of the cost, dynamic tyre load [N] (6, count)."""
        return self._said[: place.BROKEN, : self.count]

    def forget(self, which: np.ndarray | slice) -> None:
        """Nothing is said of the cars `which`, which have just begun; what has been handed out stays."""
        said = self._said.copy()
        said[: place.BROKEN, which] = 0.0
        self.out[:, which] = 0.0
        self._write_to(said, self.seen)

    @property
    def gone(self) -> np.ndarray:
        """Which cars left their bounds, or reason, in the last step (count,)."""
        return self._said[place.BROKEN, : self.count] != 0.0

    @property
    def levels(self) -> np.ndarray:
        """Variance that each physics step adds to the rough road under the wheel [m^2] (count,): what a linear car's cost grows with."""
        return self.cars[place.ROUGH_GAIN] ** 2

    @property
    def road_height(self) -> np.ndarray:
        """Height of the road under the wheel now [m] (count,)."""
        return self.cars[place.HEIGHT]

    def road_ahead(self, points: int | None = None) -> np.ndarray:
        """Road ahead relative to the height under the wheel [m], one point a control step, (count, points)."""
        begin = int(self._ints[-1])
        ahead = np.roll(self._ahead[: self.count], -begin, axis=1)[:, :points]
        return ahead - self.road_height[:, None]


class Crew:
    """Threads that wait for work, as many as there are shares of it; this one takes the first."""

    def __init__(self, size: int) -> None:
        self.process = os.getpid()
        self.asked: list[SimpleQueue[Any]] = [SimpleQueue() for _ in range(size - 1)]
        self.done: SimpleQueue[Any] = SimpleQueue()
        for queue in self.asked:
            Thread(target=_work, args=(queue, self.done), daemon=True).start()

    def do(self, function: Callable[..., int], shares: Sequence[tuple[Any, ...]]) -> list[int]:
        for queue, share in zip(self.asked, shares[1:], strict=True):
            queue.put((function, share))
        results = [function(*shares[0])]
        results += [self.done.get() for _ in self.asked]
        for result in results:
            if isinstance(result, BaseException):
                raise result
        return results

    def __del__(self) -> None:
        for queue in self.asked:
            queue.put(None)


def _work(asked: SimpleQueue[Any], done: SimpleQueue[Any]) -> None:
    while (task := asked.get()) is not None:
        function, share = task
        try:
            done.put(function(*share))
        except BaseException as error:
            done.put(error)


def nodes_of_device(network: Network) -> tuple[str | None, str | None]:
    """The terminals of the motor that are neither mass nor ground, for pictures."""
    motor = next((e for e in network.elements if isinstance(e, el.Motor)), None)
    if motor is None:
        return None, None
    first, second = (n if n != GROUND else None for n in motor.between)
    return first, second
