"""Cars on roads in lockstep: the common part of the single and the vector environment, without spaces or rewards.

A batch of one and a batch of a thousand run the same code in the same order. Car i of a batch therefore
equals a single car with the same seed bit by bit.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from .._common.arrays import Z95
from .._common.errors import InputError
from . import elements as el
from ._kernel import layout as place
from ._kernel.layout import TOGETHER, WIDTH, aligned
from .network import Channel, Network
from .road import Road, road
from .simulate import PHYSICS_STEP, Plant, discretise
from .tracks import SUM_STATES
from .vehicle import CURRENT_LIMIT, SLEW_RATE, vehicle

if TYPE_CHECKING:
    from ._value import Value

NO_SATURATION = 1e9
LATE = 100  # groups of cars that this thread handles while another thread wakes (about 40 us)


class Batch:
    """Cars of one network (or of a distribution of it), each on a separate road.

    `control_step` [s] is an integer multiple of `physics_step`, `duration` [s] the length of fixed
    profiles, and `preview` [s] the length of the road that is drawn ahead. Speed [m/s] and road hold
    unless `randomize` (`ranges`) has them.
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
        randomize: Mapping[str, Any] | str | Path | None = None,
        preview: float = 0.0,
        extra: Sequence[Channel] = (),
    ) -> None:
        self.count, self.network = count, network
        self.substeps = round(control_step / physics_step)
        if (
            self.substeps < 1
            or abs(self.substeps * physics_step - control_step) > 1e-9 * control_step
        ):
            raise InputError(
                f"control step {control_step} s is not a whole multiple of physics step {physics_step} s"
            )
        self.control_step = control_step
        self.speed = float(speed)
        self.duration = duration
        self.road = road(road_)
        self.randomize = ranges(network, randomize)
        self._spread = {
            k: v for k, v in self.randomize.items() if k not in ("speed", "road")
        }
        self._roads = list(self.randomize.get("road", []))
        nominal = network.parameters
        #: present value of each drawn parameter and name of the drawn road, by car
        self.drawn: dict[str, np.ndarray] = {
            k: np.full(count, nominal[k]) for k in self._spread
        }
        if self._roads:
            self.drawn["road"] = np.full(count, self._roads[0].name, object)
        self.vehicle = car = vehicle(network)
        # the signals replace the network's own outputs
        bare = replace(
            network,
            elements=tuple(e for e in network.elements if e.place != "channel"),
            outputs=(),
            uncertainty={},
        )
        self._bare = bare
        self.channels = [*car.channels, *extra]
        self.groups = -(-count // WIDTH)
        networks: Network | list[Network] = [bare] * WIDTH if self._spread else bare
        self.plant = plant = Plant(
            networks, physics_step, lanes=WIDTH, extra=self.channels
        )
        self._mats = plant.mats
        if self._spread:
            self._mats = aligned(self.groups, *plant.mats.shape[1:])
            self._mats[:] = plant.mats
        if any(c.quantity == "condition" for c in network.inputs):
            raise InputError(
                f"network '{network.name}': the environment has no logged channels; leave them out"
            )
        self.points = round(preview / control_step)
        self.size = place.CarSize(
            1 + len(car.axes), len(car.corners), len(car.driven), car.wheels.tracks
        )
        self.of = of = place.cars_layout(self.size)
        # a single integer array saves a tenth of a microsecond per call of the kernel
        self._ints = np.concatenate([plant.ints, self._tables()])
        self._setup = self._ints[len(plant.ints) :]
        self._states = aligned(self.groups, plant.at.height, WIDTH)
        # rows hold whole groups of cars; cars beyond `count` stand still
        wide = self.groups * WIDTH
        self._cars = aligned(of.outputs + len(self.channels), wide)
        self._ways = np.zeros((of.counter + of.tracks, wide), np.int64)
        steps_late = self._set_drives()
        self._past = np.zeros((steps_late, of.currents, wide))
        self._setup[[place.ALL, place.DEPTH]] = wide, steps_late
        # the road drawn ahead: one ring per track and physics step of a control step, starting at `NOW`, with
        # its last point repeated; the points of the cars are contiguous
        self._rings = aligned(of.tracks, self.substeps, self.points, wide)
        self._ahead = np.zeros((wide, of.tracks * self.points))
        slowest = min(self.speed, *self.randomize.get("speed", (self.speed,)))
        longest = max(car.wheels.delays(slowest, physics_step))
        self.kept = math.ceil(longest) + self.substeps + 2 if longest else 0
        self._setup[place.KEPT] = self.kept
        self._history = aligned(self.groups, of.tracks, self.kept, WIDTH)
        self.table = np.zeros(0)
        self._settings = np.zeros(of.lifted + len(self.channels) * of.corners)
        self._settings[[place.CURRENT_LIMIT, place.SLEW_LIMIT]] = (
            CURRENT_LIMIT,
            SLEW_RATE * control_step,
        )
        self._settings[of.bounds : of.bounds + of.measured] = math.inf
        self.seen = np.zeros((count, of.measured + of.currents), np.float32)
        #: results of the last step, with the cars that complete the last group (`layout`)
        self.results = np.zeros((of.results, wide))
        self.speeds = np.full(count, self.speed)
        self.threads = 1
        self._value_rows = 0
        self._arguments()

    def _tables(self) -> np.ndarray:
        """Return the integers of the kernel's control step (`layout`)."""
        car = self.vehicle
        plant = self.plant
        wheels = self.vehicle.wheels
        columns = dict.fromkeys(
            ((c.road_input, part) for c in car.corners for part in ("r", "v", "alpha")),
            -1,
        )
        for j, (part, name) in enumerate(plant.labels):
            if (name, part) in columns:
                columns[name, part] = j
        current_of = [
            next(
                (
                    i
                    for i, c in enumerate(car.driven)
                    if c.current_input == channel.name
                ),
                0,
            )
            for channel in plant.currents
        ] or [0]
        head = np.zeros(place.TABLES, np.int64)
        head[[place.COUNT, place.SUBSTEPS, place.SHOWS]] = (
            self.count,
            self.substeps,
            place.MEASURED,
        )
        late = [int(behind > 0.0) for behind in wheels.behind]
        return np.array(
            [
                *head,
                *columns.values(),
                *wheels.track,
                *late,
                *wheels.leaders,
                *current_of,
            ],
            np.int64,
        )

    def _set_drives(self) -> int:
        """Write the numbers of each motor's drive into the cars, and return how many past currents the drives need."""
        of, step = self.of, self.plant.step
        kinds = (el.ActuatorLag, el.ActuatorDelay, el.ThrustSaturation)
        for e in self.network.elements:
            if e.place == "element" and not isinstance(e, kinds):
                raise InputError(
                    f"element '{e.name}': the environment's drive has no {e.type}; leave it out"
                )
        self._cars[of.saturation : of.saturation + of.currents] = NO_SATURATION
        for j, corner in enumerate(self.vehicle.driven):
            acting: set[type] = set()
            for e in self.network.elements:
                if (
                    not isinstance(e, kinds)
                    or e.where[0] != corner.motor
                    or type(e) in acting
                ):
                    continue
                acting.add(type(e))
                self._setup[place.DRIVE_ACTS] = True
                if isinstance(e, el.ActuatorLag) and e.time_constant > 0:
                    self._cars[of.lag_pole + j] = math.exp(-step / e.time_constant)
                elif isinstance(e, el.ActuatorDelay):
                    self._cars[of.delay + j] = e.delay / step
                elif isinstance(e, el.ThrustSaturation):
                    self._cars[of.saturation + j] = e.current
        steps_late = self._cars[of.delay : of.delay + of.currents].max()
        return int(steps_late) + 2 if steps_late else 0

    def _arguments(self) -> None:
        """Create the arguments of the kernel, and the views of them."""
        at, count = self.plant.at, self.count
        self._drive: Callable[..., int] | None = None
        arguments = (
            *(
                self._mats.reshape(-1),
                self._ints,
                self._states.reshape(-1),
                self._cars.reshape(-1),
            ),
            *(
                self._ways.reshape(-1),
                self.table,
                self._past.reshape(-1),
                self._rings.reshape(-1),
                self._ahead,
            ),
            *(self._history.reshape(-1), self._settings),
            *(self.results.reshape(-1), self.seen),
        )
        threads = max(1, min(self.threads, self.groups))
        late = min(LATE, self.groups // threads)
        ends = [
            0,
            *(
                late + (self.groups - late) * i // threads
                for i in range(1, threads + 1)
            ),
        ]
        inputs = (self.substeps + 1) * at.inputs + self.substeps * (
            at.currents + 2 + self.of.tracks
        )
        inputs += self._value_rows
        self._calls = [
            (*arguments, aligned(TOGETHER, inputs, WIDTH).ravel(), begin, stop)
            for begin, stop in zip(ends[:-1], ends[1:], strict=True)
        ]
        # process and its threads
        self._crew: tuple[int, ThreadPoolExecutor] | None = None
        of = self.of
        self.cars, self.out = self._cars[:, :count], self._cars[of.outputs :, :count]
        self._setup = self._ints[len(self.plant.ints) :]
        self.counters = self._ways[of.counter :].view(np.uint64)  # (tracks, cars)
        #: commanded currents [A] (currents, count)
        self.target = self.cars[of.target : of.target + of.currents]
        self._first_results, self.first_seen = self.results[:, 0], self.seen[0]

    def __getstate__(self) -> dict[str, Any]:
        views = (
            "cars",
            "out",
            "counters",
            "target",
            "_setup",
            "_first_results",
            "first_seen",
        )
        made = (*views, "_drive", "_calls", "_crew")
        return {k: v for k, v in self.__dict__.items() if k not in made}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._arguments()

    def set_cost(
        self,
        weights: Sequence[float],
        bounds: Sequence[float],
        *,
        width: int,
        shows: int = place.MEASURED,
        lifted: Sequence[Sequence[float]] = (),
        threads: int = 1,
        value: Value | None = None,
    ) -> None:
        """Let every step limit the commanded currents in `target`, and compute rewards, costs and
        observations.

        `weights` are the factors of `StageCost.factors`, `bounds` those of the measured signals without
        the currents. An observation has `width` numbers and shows `MEASURED`, `WHOLE` or `AHEAD` of
        `layout`. `lifted` (outputs, corners) is the share of the road's height that is subtracted from
        each output. The results do not depend on `threads`. With the `value` of the linear car, every step also
        computes the shaped reward.
        """
        of = self.of
        self._setup[place.IS_COMMANDED], self._setup[place.SHOWS] = True, shows
        self._settings[of.weights : of.bounds] = weights
        self._settings[of.bounds : of.lifted] = bounds
        shares = np.ravel(lifted)
        self._settings[of.lifted : of.lifted + len(shares)] = shares
        if value is not None:
            self._setup[[place.SHAPE, place.LINE]] = len(self._settings), value.line
            self._settings = np.concatenate([self._settings, value.numbers])
            self._value_rows = sum(value.slope.shape) + self.substeps
        self.seen = np.zeros((self.count, width), np.float32)
        self.threads = threads
        self._arguments()

    # ---------------------------------------------------------------------------------------- reset

    def drive_on(self, ground: Road, speed: float) -> None:
        """Set road and speed [m/s] of all following episodes.

        Raises:
            InputError: `randomize` draws the road or the speed, or the rear wheels follow later than at any speed of the
                options.
        """
        for name, is_new in (
            ("road", ground is not self.road),
            ("speed", speed != self.speed),
        ):
            if is_new and name in self.randomize:
                raise InputError(
                    f"randomize draws the {name}: leave it out of the options of reset"
                )
        late = math.ceil(max(self.vehicle.wheels.delays(speed, self.plant.step)))
        if late and late + self.substeps + 2 > self.kept:
            raise InputError(
                f"at {speed:g} m/s the rear wheels follow later than at the speed of the environment: make the "
                f"environment with speed={speed:g}"
            )
        self.road, self.speed = ground, speed

    def reset(self, i: int, rng: np.random.Generator) -> None:
        """Put a car at rest at the start of a new road."""
        if self._spread:
            self._redraw(i, rng)
        speed = self.speed
        if "speed" in self.randomize:
            speed = float(rng.uniform(*self.randomize["speed"]))
        ground = (
            self._roads[int(rng.integers(len(self._roads)))]
            if self._roads
            else self.road
        )
        if self._roads:
            self.drawn["road"][i] = ground.name
        self.speeds[i] = speed
        h = self.plant.step
        cars = self._cars
        of = self.of
        poles, gains = self._filters(ground, speed)
        cars[of.pole : of.rough, i], cars[of.gain : of.pole, i] = poles, gains
        cars[of.late : of.gain, i] = self.vehicle.wheels.delays(speed, h)
        for begin, end in (
            (of.current, of.lag_pole), (of.target, of.late), (of.rough, of.outputs)
        ):  # fmt: skip
            cars[begin:end, i] = 0.0
        self._past[:, :, i] = 0.0
        self.counters[:, i] = [
            rng.integers(0, 2**64, dtype=np.uint64) for _ in range(of.tracks)
        ]
        fixed = ground.fixed_tracks(
            of.tracks,
            speed,
            h,
            round(self.duration / h) + self.points * self.substeps,
            rng,
        )
        self._give(i, fixed)
        group, lane = divmod(i, WIDTH)
        self._states[group, :, lane] = 0.0
        self._history[group, :, :, lane] = 0.0
        if self.points:
            self._look_ahead(i, poles, gains, fixed)

    def _filters(self, ground: Road, speed: float) -> tuple[np.ndarray, np.ndarray]:
        """Return poles and gains [m] of the sections of the rough tracks."""
        if self.of.tracks == 2:
            return ground.track_filters(
                self.vehicle.wheels.width, speed, self.plant.step
            )
        gain, pole = ground.noise(speed, self.plant.step)
        return np.array([pole]), np.array([gain])

    def _look_ahead(
        self, i: int, poles: np.ndarray, gains: np.ndarray, fixed: np.ndarray
    ) -> None:
        """Draw the road of car i up to the end of its preview; `fixed` (tracks, n) [m] is its fixed profile."""
        of, cars = self.of, self._cars
        rough = np.empty((of.tracks, self.points * self.substeps))
        if of.tracks == 2:
            from ._kernel.tracks import track_noise

            states = np.zeros(of.filters)
            first, second = self.counters[:, i]
            self.counters[:, i] = track_noise(
                first, second, poles, gains, SUM_STATES, states, rough
            )
            cars[of.rough : of.value, i] = states
        else:
            from ._kernel.cars import road_noise

            self.counters[0, i] = road_noise(
                self.counters[0, i], gains[0], poles[0], 0.0, rough[0]
            )
            cars[of.rough, i] = rough[0, -1]
        length = fixed.shape[1]
        if length:
            count = min(rough.shape[1], length)
            rough[:, :count] += fixed[:, :count]
            rough[:, count:] += fixed[:, -1:]
            self._ways[of.profile : of.profile_end, i] += count
        rings = rough.reshape(of.tracks, self.points, self.substeps)
        rings = np.roll(rings, self._setup[place.NOW], axis=1)
        self._rings[:, :, :, i], self._ahead[i] = (
            rings.transpose(0, 2, 1),
            rings[:, :, -1].ravel(),
        )

    def _give(self, i: int, fixed: np.ndarray) -> None:
        """Store the fixed profile (tracks, n) of car i in slots of the table; the kernel holds the last height after the end."""
        tracks = self.of.tracks
        ways = self._ways[: 2 * tracks, : self.count].reshape(2, tracks, self.count)
        length = fixed.shape[1]
        if not length:
            ways[:, :, i] = 0
            return
        slots = self.count * tracks
        slot = len(self.table) // slots
        begin = np.arange(slots).reshape(self.count, tracks).T
        if length > slot:
            table = np.zeros((slots, length))
            table[:, :slot] = self.table.reshape(slots, slot)
            old = ways.copy()
            ways[:] = np.where(old[1] > 0, old + begin * (length - slot), 0)
            self.table, slot = table.ravel(), length
            self._arguments()
        for t, heights in enumerate(fixed):
            at = begin[t, i] * slot
            self.table[at : at + length] = heights
            ways[:, t, i] = at, at + length

    def _redraw(self, i: int, rng: np.random.Generator) -> None:
        nominal = self._bare.parameters
        values = {
            k: nominal[k] * float(rng.uniform(*v))
            for k, v in self._spread.items()
            if k in nominal
        }
        for name, value in values.items():
            self.drawn[name][i] = value
        self._build(i, values)

    def _build(self, i: int, values: Mapping[str, float]) -> None:
        """Give car i these values of the drawn parameters."""
        from .network import assemble

        asm = assemble(self._bare.with_parameters(values), self.channels)
        part = discretise(asm, self.plant.step, self.plant.u_columns)
        self.plant.place(self._mats, i, part)

    def get_state(self, i: int) -> dict[str, Any]:
        """Return the state of a car and of its road, for `set_state` of any batch with the same network and options."""
        (group, lane), of, tracks = divmod(i, WIDTH), self.of, self.of.tracks
        slot = len(self.table) // (self.count * tracks)
        ways = self._ways[:, i].copy()
        begin = slot * (i * tracks + np.arange(tracks))
        ends = ways[of.profile_end : of.profile_end + tracks]
        profile = [
            self.table[a:b].copy() for a, b in zip(begin, ends, strict=True) if b > 0
        ]
        if profile:
            ways[of.profile : of.profile_end] -= begin
        now = int(self._setup[place.NOW])
        kept = int(self._setup[place.KEPT_NOW])
        return {
            "states": self._states[group, :, lane].copy(),
            "cars": self._cars[:, i].copy(),
            "ways": ways,
            "profile": np.array(profile) if profile else np.empty((tracks, 0)),
            "past": self._past[:, :, i].copy(),
            "rings": np.roll(self._rings[:, :, :, i], -now, axis=2),
            "ahead": np.roll(self._ahead[i].reshape(tracks, self.points), -now, axis=1),
            "history": np.roll(self._history[group, :, :, lane], -kept, axis=1),
            "results": self.results[:, i].copy(),
            "seen": self.seen[i].copy(),
            "speed": float(self.speeds[i]),
            "drawn": {name: values[i] for name, values in self.drawn.items()},
        }

    def set_state(self, i: int, state: Mapping[str, Any]) -> None:
        """Put a car into a state of `get_state`."""
        (group, lane), of, tracks = divmod(i, WIDTH), self.of, self.of.tracks
        if self._spread:
            self._build(i, {name: state["drawn"][name] for name in self._spread})
        for name, value in state["drawn"].items():
            self.drawn[name][i] = value
        self._give(i, state["profile"])
        begin = self._ways[of.profile : of.profile_end, i].copy()
        ways = state["ways"].copy()
        if state["profile"].shape[1]:
            ways[of.profile : of.profile_end] += begin
            ways[of.profile_end : of.profile_end + tracks] = self._ways[
                of.profile_end : of.profile_end + tracks, i
            ]
        now = int(self._setup[place.NOW])
        kept = int(self._setup[place.KEPT_NOW])
        self._states[group, :, lane], self._cars[:, i], self._ways[:, i] = (
            state["states"],
            state["cars"],
            ways,
        )
        self._past[:, :, i] = state["past"]
        self._rings[:, :, :, i] = np.roll(state["rings"], now, axis=2)
        self._ahead[i] = np.roll(state["ahead"], now, axis=1).ravel()
        self._history[group, :, :, lane] = np.roll(state["history"], kept, axis=1)
        self.results[:, i], self.seen[i] = state["results"], state["seen"]
        self.speeds[i] = state["speed"]

    # ----------------------------------------------------------------------------------------- step

    def step(self) -> np.ndarray:
        """Run one control step with the present currents (after `set_cost`: `target`); return the signals (signals, count) [SI]."""
        drive = self._drive or self._compiled()
        if len(self._calls) == 1:
            self.broken = drive(*self._calls[0])
        else:
            # threads do not survive a fork
            if self._crew is None or self._crew[0] != os.getpid():
                self._crew = os.getpid(), ThreadPoolExecutor(len(self._calls) - 1)
            others = [self._crew[1].submit(drive, *call) for call in self._calls[1:]]
            self.broken = drive(*self._calls[0]) + sum(
                other.result() for other in others
            )
        if self.points:
            self._setup[place.NOW] = (self._setup[place.NOW] + 1) % self.points
        if self.kept:
            self._setup[place.KEPT_NOW] = (
                self._setup[place.KEPT_NOW] + self.substeps
            ) % self.kept
        return self.out

    def _compiled(self) -> Callable[..., int]:
        """Return the kernel for the types of these arguments, which are constant: no lookup at every step."""
        from numba import typeof

        from ._kernel.compiled import kernel_of

        of_car = kernel_of(self.plant.at, self.size)
        self._drive = of_car.drive.compile(tuple(map(typeof, self._calls[0])))  # type: ignore[attr-defined]
        return self._drive

    @property
    def currents(self) -> np.ndarray:
        """Present commanded currents [A] (currents, count)."""
        return self.cars[self.of.current : self.of.current + self.of.currents]

    def alone(self) -> tuple[float, ...]:
        """Return the results of the first car: minus the cost, terms of the cost, dynamic tyre loads [N], 1 for each exceeded limit,
        and 1 for a broken car.
        """
        return self._first_results.tolist()

    @property
    def judged(self) -> np.ndarray:
        """Results of the last step (rows, count): minus the cost, terms of the cost, dynamic tyre loads [N], and
        whether acceleration and travel are beyond the limits of Table 5."""
        return self.results[: self.of.shaped, : self.count]

    def forget(self, which: np.ndarray | slice) -> None:
        """Clear the results of restarted cars."""
        self.judged[:, which] = 0.0
        self.out[:, which] = 0.0

    @property
    def gone(self) -> np.ndarray:
        """Whether each car left its bounds, or became not finite, in the last step (count,)."""
        return self.results[self.of.broken, : self.count] != 0.0

    @property
    def levels(self) -> np.ndarray:
        """Level of the rough road (count,) [m^2], to which the cost of a linear car is proportional; with one
        track, the variance that each physics step adds to the height."""
        return self.cars[self.of.gain] ** 2

    @property
    def road_heights(self) -> np.ndarray:
        """Present heights of the road under all corners (corners, count) [m]."""
        return self.cars[self.of.height : self.of.height + self.of.corners]

    @property
    def track_heights(self) -> np.ndarray:
        """Height of each track under its first wheel now [m] (tracks, count)."""
        return self.road_heights[
            self._setup[self.of.leader : self.of.leader + self.of.tracks]
        ]

    def road_ahead(self, points: int | None = None, track: int = 0) -> np.ndarray:
        """Return a track ahead relative to the height under its first wheel (count, points) [m], one point
        per control step; the left track comes before the right track."""
        begin = int(self._setup[place.NOW])
        ahead = self._ahead[: self.count].reshape(
            self.count, self.of.tracks, self.points
        )[:, track]
        return (
            np.roll(ahead, -begin, axis=1)[:, :points]
            - self.track_heights[track][:, None]
        )


#: smallest factor on a parameter
LEAST_FACTOR = 0.01


def posterior_ranges(
    network: Network, found: str | Path
) -> dict[str, tuple[float, float]]:
    """Return the 95 % intervals of the parameters that a diagnosis determined, as factors on their values."""
    path = Path(found)
    path = path / "model.json" if path.is_dir() else path
    model = Network.load(path)
    own, known = network.parameters, model.parameters
    out = {}
    for key, sigma in model.uncertainty.items():
        value = known[key]
        if sigma <= 0 or value == 0:
            continue
        if not math.isclose(own.get(key, math.nan), value, rel_tol=1e-9):
            raise InputError(
                f"randomize: the network has not the value of '{key}' that was found: give network='{path}'"
            )
        wide = (1.0 + sigma) ** Z95
        out[key] = (1.0 / wide, wide)
        if value < 0:
            out[key] = (max(1.0 - Z95 * sigma, LEAST_FACTOR), 1.0 + Z95 * sigma)
    if not out:
        raise InputError(
            f"randomize: {path} states no uncertainty of a parameter, so that there is nothing to draw"
        )
    return out


def with_found_ranges(
    network: Network, given: Mapping[str, Any] | str | Path | None
) -> dict[str, Any]:
    """Return ranges of `randomize` with the intervals of a diagnosis in place of its folder, the key 'found'."""
    out = {"found": given} if isinstance(given, str | Path) else dict(given or {})
    if "found" not in out:
        return out
    found = out.pop("found")
    if not isinstance(found, str | Path):
        raise InputError(
            f"randomize: 'found' must be the folder of a diagnosis, not {found!r}"
        )
    return posterior_ranges(network, found) | out


def ranges(
    network: Network, given: Mapping[str, Any] | str | Path | None
) -> dict[str, Any]:
    """Return checked ranges of `randomize`.

    Parameter path -> (low, high) factors on its value; 'speed' -> (low, high) [m/s]; 'road' -> list of
    roads; 'found' -> folder of a diagnosis, whose intervals are ranges of parameters without an own entry;
    or that folder alone.
    """
    known = network.parameters
    out: dict[str, Any] = {}
    for key, value in with_found_ranges(network, given).items():
        if key == "road":
            if not isinstance(value, list | tuple) or not value:
                raise InputError("randomize: 'road' must be a list of roads")
            out[key] = [road(one) for one in value]
            continue
        if key != "speed" and key not in known:
            raise InputError(
                f"randomize: no parameter '{key}' (there are speed, road, {', '.join(known)})"
            )
        try:
            low, high = (float(v) for v in value)
        except (TypeError, ValueError, OverflowError):
            raise InputError(
                f"randomize: '{key}' must be a pair (low, high), not {value!r}"
            ) from None
        if not 0 < low <= high < math.inf:
            raise InputError(
                f"randomize: '{key}' needs 0 < low <= high, not ({low:g}, {high:g})"
            )
        if key != "speed" and isinstance(given, Mapping) and key in given:
            _check_factors(key, low, high, known[key])
        out[key] = (low, high)
    return out


def _check_factors(key: str, low: float, high: float, nominal: float) -> None:
    """Refuse factors that look like values of the parameter."""
    if low >= 0.1 and high <= 10.0:
        return
    share = (
        f"({low / nominal:.3g}, {high / nominal:.3g})" if nominal > 0 else "(0.8, 1.2)"
    )
    raise InputError(
        f"randomize: '{key}' has factors on {nominal:g}, 0.1 to 10, not ({low:g}, {high:g}): "
        f"for values from {low:g} to {high:g} give {share}"
    )
