"""Cars on roads in lockstep: what the single and the vector environment both are, without spaces or rewards.

A batch of one and a batch of a thousand run the same code in the same order, so car i of a batch is the single car
of its seed to the last bit.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from . import elements as el
from .errors import InputError
from .network import GROUND, Channel, Network
from .road import Road, road
from .simulate import PHYSICS_STEP, Plant, discretise

LANES = 128  # cars that share an instruction stream; their state fits the first-level cache
CURRENT_LIMIT = 5.0  # A, Table 5
SLEW_LIMIT = 0.5  # A per control step, Table 5
NO_SATURATION = 1e9

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
    if len(masses) < 2 or not network.moved_nodes:
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
        self.lanes = min(count, LANES)
        self.blocks = -(-count // self.lanes)
        # the network's own outputs are not needed here: the signals take their place
        bare = Network(
            network.name,
            network.masses,
            tuple(e for e in network.elements if e.place != "channel"),
            network.inputs,
        )
        self._bare = bare
        self.channels = [*signal_channels(network), *extra]
        networks: Network | list[Network] = [bare] * self.lanes if self._spread else bare
        self.plant = plant = Plant(networks, physics_step, lanes=self.lanes, extra=self.channels)
        self.mats = np.tile(plant.mats, (self.blocks, 1)) if self._spread else plant.mats
        columns = {part: -1 for part in ("r", "v", "alpha")}
        for j, (part, name) in enumerate(plant.labels):
            if part in columns and name == plant.networks[0].inputs[self._road_input()].name:
                columns[part] = j
        if len(plant.currents) > 1:
            raise InputError(
                f"network '{network.name}' has more than one current; the environment drives one"
            )
        self._blank = plant.state()
        _, m, nc = (int(i) for i in plant.ints[:3])
        # behind the states of the blocks the kernel puts their inputs
        self._work = np.zeros(
            (self.blocks * len(self._blank) + (self.substeps + 1) * m + self.substeps * nc, self.lanes)
        )
        self._cars = np.zeros((10 + len(self.channels), count))
        self._cars[7] = NO_SATURATION
        lag, delay, saturation = (
            next((e for e in network.elements if isinstance(e, kind)), None)
            for kind in (el.ActuatorLag, el.ActuatorDelay, el.ThrustSaturation)
        )
        if isinstance(lag, el.ActuatorLag) and lag.time_constant > 0:
            self._cars[6] = math.exp(-physics_step / lag.time_constant)
        if isinstance(saturation, el.ThrustSaturation):
            self._cars[7] = saturation.current
        if isinstance(delay, el.ActuatorDelay):
            self._cars[8] = delay.delay / physics_step
        depth = int(self._cars[8].max()) + 2 if self._cars[8].any() else 0
        self.points = round(preview / control_step)
        self._belts = np.zeros((count, depth + self.points * self.substeps))
        self._ways = np.zeros((3, count), np.int64)
        self.table = np.zeros(0)
        driven = any(e is not None for e in (lag, delay, saturation))
        self._ints = np.concatenate(
            [plant.ints, [self.lanes, self.substeps, *columns.values(), driven, depth, 0]]
        )
        self.speeds = np.full(count, self.speed)
        self._arguments()

    def _arguments(self) -> None:
        """The arguments of the kernel, and what is seen of them from here: views, made once."""
        self._drive = self.plant.kernel.drive
        self._drive_arguments = (
            *(self.mats.reshape(-1), self._ints, self._work.reshape(-1), self._cars),
            *(self._ways, self.table, self._belts),
        )
        depth = self._ints[-2]
        self.states = self._work[: self.blocks * len(self._blank)]
        self.cars, self.rough, self.out = self._cars[:9], self._cars[9], self._cars[10:]
        self.commands = self._belts[:, :depth]
        # one control step after another is a ring that begins at ints[-1]; a car's points lie side by side
        self.rings = self._belts[:, depth:].reshape(self.count, self.substeps, self.points)
        self.ways, self.counters = self._ways[:2], self._ways[2].view(np.uint64)

    def __getstate__(self) -> dict[str, Any]:
        views = ("states", "cars", "rough", "out", "commands", "rings", "ways", "counters")
        return {k: v for k, v in self.__dict__.items() if k not in (*views, "_drive", "_drive_arguments")}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
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
        h = self.plant.step
        self.cars[2, i], self.cars[3, i] = ground.noise(speed, h)
        self.cars[[0, 1, 4, 5], i] = 0.0
        self.commands[i] = 0.0
        self.counters[i] = rng.integers(0, 2**64, dtype=np.uint64)
        self.rough[i] = 0.0
        fixed = ground.fixed(speed, h, round(self.duration / h) + self.points * self.substeps, rng)
        self._place(i, fixed)
        block, lane = divmod(i, self.lanes)
        size = len(self._blank)
        self.states[block * size : (block + 1) * size, lane] = self._blank[:, lane]
        if self.points:
            from .kernel import road_noise

            rough = np.empty(self.points * self.substeps)
            self.counters[i] = road_noise(self.counters[i], self.cars[2, i], self.cars[3, i], 0.0, rough)
            self.rough[i] = rough[-1]
            if len(fixed):
                count = min(len(rough), len(fixed))
                rough[:count] += fixed[:count]
                rough[count:] += fixed[-1]
                self.ways[0, i] += count
            self.rings[i] = np.roll(rough.reshape(self.points, self.substeps), self._ints[-1], axis=0).T

    def _place(self, i: int, fixed: np.ndarray) -> None:
        """Give car i its fixed profile, in a slot of the table; the kernel holds the last height after its end."""
        if not len(fixed):
            self.ways[:, i] = 0
            return
        slot = len(self.table) // self.count
        if len(fixed) > slot:
            table = np.zeros((self.count, len(fixed)))
            table[:, :slot] = self.table.reshape(self.count, slot)
            begin, old = np.arange(self.count), self.ways.copy()
            self.ways[:] = np.where(old[1] > 0, old + begin * (len(fixed) - slot), 0)
            self.table, slot = table.ravel(), len(fixed)
            self._arguments()
        self.table[i * slot : i * slot + len(fixed)] = fixed
        self.ways[:, i] = i * slot, i * slot + len(fixed)

    def _redraw(self, i: int, rng: np.random.Generator) -> None:
        from .network import assemble

        nominal = self._bare.parameters
        values = {k: nominal[k] * float(rng.uniform(*v)) for k, v in self._spread.items() if k in nominal}
        asm = assemble(self._bare.with_parameters(values), self.channels)
        part = discretise(asm, self.plant.step, self.plant.u_columns)
        block, lane = divmod(i, self.lanes)
        size = len(self.plant.mats)
        self.mats[block * size : (block + 1) * size, lane] = part.numbers

    # ----------------------------------------------------------------------------------------- step

    def step(self) -> np.ndarray:
        """Run one control step with the currents in `self.cars[0]`; returns `out` (signals, count), SI units."""
        self._drive(*self._drive_arguments)
        return self.out

    @property
    def current(self) -> np.ndarray:
        """Present commanded current [A] (count,)."""
        return self.cars[0]

    @property
    def road_height(self) -> np.ndarray:
        """Height of the road under the wheel now [m] (count,)."""
        return self.cars[4]

    def road_ahead(self, out: np.ndarray | None = None) -> np.ndarray:
        """Road ahead relative to the height under the wheel [m], one point a control step, (count, points).

        out (count, up to `points`): where to write, in its own type.
        """
        from .kernel import preview

        if out is None:
            out = np.empty((self.count, self.points))
        if self.points:
            preview(self.rings[:, -1], self._ints[-1], self.cars[4], out)
        return out


def nodes_of_device(network: Network) -> tuple[str | None, str | None]:
    """The terminals of the motor that are neither mass nor ground, for pictures."""
    motor = next((e for e in network.elements if isinstance(e, el.Motor)), None)
    if motor is None:
        return None, None
    first, second = (n if n != GROUND else None for n in motor.between)
    return first, second
