"""Model of a controller of a whole car: all corners in one discrete model, with the rear road known from the front.

The state is that of the assembly, relative to the heights of the road under the foremost wheel of each track,
followed by the delay line: the rises of the road under that wheel in the last control steps. A wheel that
runs d steps behind stands lower than the foremost wheel by the sum of the last d rises, and rises in the next
step by the rise of d steps ago. A delay with a fraction of a step is interpolated linearly, as in the
environment. The only unknown road is therefore the next rise under the foremost wheels, which is white. A
Kalman filter of this state predicts the rear road without a sensor.

Left and right track are modelled as independent; a coherent road is easier.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from .prediction import (
    ROAD_INTENSITY,
    Equations,
    Laws,
    Sensors,
    device_reach,
    equations,
    feedback,
    held_over_step,
    lift,
    of_currents,
    riccati,
    steady_gain,
    weighted,
    white_covariance,
)
from .vehicle import Vehicle, state_channels, vehicle

if TYPE_CHECKING:
    from collections.abc import Mapping

    from . import elements as el
    from .cost import StageCost
    from .network import Network


class WholeCar(Laws):
    """Channels and motors of a model of a `car` with an output matrix `C` (channels, n)."""

    car: Vehicle

    @property
    def network(self) -> Network:
        """Network of the car."""
        return self.car.network

    @cached_property
    def thrusts(self) -> np.ndarray:
        """Thrust of each motor at its terminals per current (currents,) [N/A]; 0 without a motor."""
        return np.array([self.car.thrust(c) for c in self.car.driven])

    @cached_property
    def device_rates(self) -> np.ndarray:
        """Rates of the devices by the state (currents, n)."""
        names = [c.name for c in self.car.channels]
        return self.C[
            [names.index(c.named("device_travel_rate")) for c in self.car.driven]
        ]

    def rows(self, kind: str) -> list[int]:
        """Return the rows of the channels of a kind, one per corner."""
        names = [c.name for c in self.car.channels]
        return [names.index(c.named(kind)) for c in self.car.corners]


@dataclass(frozen=True)
class CarModel(WholeCar):
    """One control step of a car: ``x+ = A x + inputs I + G f + gamma w``, ``y = C x + feedthrough I + F f``."""

    car: Vehicle  # car
    step: float  # control step [s]
    # system matrix (n, n) of the state: motion of the car, then the delay line [m]
    A: np.ndarray
    inputs: np.ndarray  # effect (n, currents) of the currents [A], held over the step
    G: np.ndarray  # effect (n, laws) of the forces [N] of the laws that are kept apart (friction, stops)
    gamma: np.ndarray  # effect (n, tracks) of the next rise of each track [m]
    #: covariance (n, n) of the state per step: of these rises, and of the road between the samples
    W: np.ndarray
    C: np.ndarray  # channels of the car (channels, n): `Vehicle.channels`
    # effect (channels, currents) of the currents on the channels
    feedthrough: np.ndarray
    F: np.ndarray  # effect (channels, laws) of the forces on the channels
    S: np.ndarray  # rates (laws, n) of the laws
    SF: np.ndarray  # effect (laws, laws) of the forces on these rates
    laws: tuple[el.Element, ...]  # laws that are kept apart
    motion: int  # number of states of the car's motion; the delay line follows
    # delay of each corner behind the foremost wheel of its track [steps]
    delays: np.ndarray
    #: height of each corner over the foremost wheel of its track, by the delay line (corners, line)
    heights: np.ndarray
    # rise of each corner over the next step, by the delay line (corners, line)
    rises: np.ndarray
    lift: np.ndarray  # shift of the motion when a track rises by 1 m (motion, tracks)
    drifts: np.ndarray  # states (n, motions) of a car whose body moves at constant speed, each wheel with it
    road_intensity: float  # two-sided intensity of the road's velocity [m^2/s]

    @property
    def current_places(self) -> slice:
        """Places of the present currents in an observation."""
        signals = len(self.car.measured)
        return slice(signals - len(self.car.driven), signals)

    def rises_ahead(self, corner: int) -> np.ndarray:
        """Return the rises of the road under a wheel in the next control steps, as far as the delay line knows the road
        (points, line)."""
        points = int(self.delays[corner])
        size = self.n - self.motion
        rows = np.zeros((points, size))
        line = self.rises[corner]
        for k in range(points):  # the line advances without new rises
            rows[k] = line
            line = line @ self.A[self.motion :, self.motion :]
        return rows

    def kalman_gain(
        self, sensors: Sensors, noise: np.ndarray | None = None
    ) -> np.ndarray:
        """Return the steady gain (n, measured) of a Kalman filter; angular accelerations are as accurate as
        the difference of two accelerometers at the axles."""
        apart = max(abs(place) for c in self.car.corners for place in (c.x, c.y))
        errors = []
        for signal in self.car.measured[: self.current_places.start]:
            if (
                signal.kind.endswith("_acceleration")
                and signal.kind != "body_acceleration"
            ):
                errors.append(sensors.body_acceleration / apart)
            else:
                errors.append(getattr(sensors, signal.kind))
        return steady_gain(
            self.network,
            self,
            np.diag(np.square(errors)),
            sensors.memory,
            self.drifts,
            noise,
        )


@dataclass(frozen=True)
class CarWeights:
    """Quadratic weights of a design; each weight is shared equally by the corners."""

    cost: StageCost  # stage cost of the car
    effort: float = 0.0  # weight of the currents [1/A^2]
    centring: float = 0.01  # weight of the devices' travels over their reach [-]

    def of(self, model: WholeCar) -> tuple[np.ndarray, np.ndarray]:
        """Return the weights of the channels (channels,) and of the currents (currents,) of a model."""
        car = model.car
        corners = len(car.corners)
        currents = len(car.driven)
        motions = 1 + len(car.axes)
        factors = self.cost.factors(car.axes, corners, currents)
        q = np.zeros(len(car.channels))
        q[:motions] = factors[:motions]
        q[model.rows("suspension_travel")] = factors[motions : motions + corners]
        q[model.rows("tyre_load")] = factors[motions + corners : motions + 2 * corners]
        reach = np.array([device_reach(car.quarter_car(c)) for c in car.corners])
        q[model.rows("device_travel")] += self.centring / corners / reach**2
        return q, np.array(factors[motions + 2 * corners :]) + self.effort / currents


@dataclass(frozen=True)
class _Line:
    """The delay line: relation between past rises and the corners."""

    #: height of each corner over the foremost wheel of its track, by the line (corners, states)
    heights: np.ndarray
    # rise of each corner over the next step, by the line (corners, states)
    rises: np.ndarray
    #: rise of each corner over the next step, by the next rise of each track (corners, tracks)
    new: np.ndarray
    shift: np.ndarray  # the line one step later (states, states)
    # state in which the next rise of each track enters (states, tracks)
    entry: np.ndarray

    @classmethod
    def of(cls, delays: np.ndarray, tracks: list[int]) -> _Line:
        count = max(tracks) + 1
        lengths = [
            max(int(np.ceil(d)) for d, t in zip(delays, tracks, strict=True) if t == i)
            for i in range(count)
        ]
        starts = np.concatenate([[0], np.cumsum(lengths)]).astype(int)
        size = int(starts[-1])
        heights = np.zeros((len(delays), size))
        rises = np.zeros((len(delays), size))
        new = np.zeros((len(delays), count))
        shift = np.zeros((size, size))
        entry = np.zeros((size, count))
        for t, length in enumerate(lengths):
            shift[starts[t] + 1 : starts[t + 1], starts[t] : starts[t + 1] - 1] = (
                np.eye(max(length - 1, 0))
            )
            entry[starts[t] : starts[t] + min(length, 1), t] = 1.0
        for c, (delay, t) in enumerate(zip(delays, tracks, strict=True)):
            low, part = int(delay), delay - int(delay)
            first = starts[t]
            heights[c, first : first + low] = -1.0
            for place, share in ((low, 1 - part), (low + 1, part)):
                if share == 0.0:
                    continue
                if place == 0:
                    new[c, t] += share
                else:
                    rises[c, first + place - 1] += share
            if part:
                heights[c, first + low] = -part
        return cls(heights, rises, new, shift, entry)


def car_model(
    network: Network,
    step: float,
    speed: float,
    *,
    wheelbase: bool = True,
    damping: Mapping[str, float] | None = None,
    road_intensity: float = ROAD_INTENSITY,
) -> CarModel:
    """Return the model of a car at a control step.

    Dry friction and stops are kept as laws. Every other law is linearised by its slope at rest. The speed [m/s] gives the
    delays of the rear wheels. Without `wheelbase`, the roads of all wheels are independent. `road_intensity` is the two-sided
    intensity of the road's velocity [m^2/s].
    """
    car = vehicle(network)
    channels = [*car.channels, *state_channels(network)]
    parts = equations(network, channels, damping or {})
    count, corners = len(car.channels), len(car.corners)
    tracks = list(car.wheels.track) if wheelbase else list(range(corners))
    behind = car.wheels.delays(speed, step)
    first = [
        min(d for d, t in zip(behind, tracks, strict=True) if t == i)
        for i in range(max(tracks) + 1)
    ]
    delays = behind - np.array([first[t] for t in tracks])
    line = _Line.of(delays, tracks)
    x, (r, _, currents) = parts.columns["x"], columns(car, parts)
    roads = np.zeros((corners, max(tracks) + 1))
    for road, t in zip(r, tracks, strict=True):
        roads[road - parts.columns["r"].start, t] = 1.0
    T = lift(network, parts, roads, count)
    leader = [
        next(c for c in range(corners) if tracks[c] == t and delays[c] == 0.0)
        for t in range(max(tracks) + 1)
    ]
    n = len(parts.rate)
    size = n + corners
    A, inputs, white = continuous(car, parts)
    # motion above the leaders' roads, and heights of the corners over their leaders
    for t, c in enumerate(leader):
        white[:n, c] -= T[:, t]
        white[n:, c] -= [float(track == t) for track in tracks]
    last = size + inputs.shape[1]
    phi = held_over_step(A, np.hstack([inputs, white]), step)[:n]
    move, ramps = phi[:, :size], phi[:, last:] / step
    total, states = n + len(line.shift), slice(n, None)
    full = np.zeros((total, total))
    full[:n, :n] = move[:, :n]
    full[:n, states] = move[:, n:] @ line.heights + ramps @ line.rises
    full[states, states] = line.shift
    gamma = np.vstack([ramps @ line.new, line.entry])
    variance = road_intensity * step  # of a rise
    W = variance * gamma @ gamma.T
    for c in range(corners):  # the road between the samples
        between = white_covariance(A, white[:, [c]], road_intensity, step)[:n, :n]
        W[:n, :n] += between - variance * np.outer(ramps[:, c], ramps[:, c])

    def widened(rows: np.ndarray) -> np.ndarray:
        return np.hstack([rows[:, x], rows[:, r] @ line.heights])

    below = np.zeros((len(line.shift), inputs.shape[1]))
    effects = np.vstack([phi[:, size:last], below])
    out = parts.out[:count]
    return CarModel(
        car=car,
        step=step,
        A=full,
        inputs=effects[:, : len(currents)],
        G=effects[:, len(currents) :],
        gamma=gamma,
        W=0.5 * (W + W.T),
        C=widened(out),
        feedthrough=of_currents(out, currents),
        F=out[:, parts.apart],
        S=widened(parts.R),
        SF=parts.R[:, parts.apart],
        laws=parts.laws,
        motion=n,
        delays=delays,
        heights=line.heights,
        rises=line.rises,
        lift=T,
        drifts=drifts(car, parts.out[:, x], total),
        road_intensity=road_intensity,
    )


def continuous(
    car: Vehicle, parts: Equations
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the rates (n + corners, .) of the states and of the heights of the road under the corners: by states and heights,
    by currents and forces of the laws, and by the velocity of the road under each corner."""
    x, (r, v, currents) = parts.columns["x"], columns(car, parts)
    n, corners = len(parts.rate), len(r)
    A = np.zeros((n + corners, n + corners))
    A[:n, :n], A[:n, n:] = parts.rate[:, x], parts.rate[:, r]
    inputs = np.zeros((n + corners, len(currents) + len(parts.laws)))
    inputs[:n, : len(currents)] = of_currents(parts.rate, currents)
    inputs[:n, len(currents) :] = parts.rate[:, parts.apart]
    white = np.vstack([parts.rate[:, v], np.eye(corners)])
    return A, inputs, white


def columns(
    car: Vehicle, parts: Equations
) -> tuple[list[int], list[int], list[int | None]]:
    """Return the columns of displacements and velocities of the roads and of the currents (None without a motor), in the order of
    the corners."""
    moving = [c.name for c in car.network.moving]
    named = [c.name for c in car.network.inputs if c.quantity == "current"]
    order = [moving.index(c.road_input) for c in car.corners]
    r, v = ([parts.columns[part].start + i for i in order] for part in ("r", "v"))
    first = parts.columns["I"].start
    inputs = [c.current_input for c in car.driven]
    return (
        r,
        v,
        [None if name is None else first + named.index(name) for name in inputs],
    )


def drifts(car: Vehicle, out: np.ndarray, total: int) -> np.ndarray:
    """Return the states of a body that moves at 1 m/s or 1 rad/s, wheels with it, at the heights of the roads
    (total, motions)."""
    nodes = state_channels(car.network)
    count = len(car.channels)
    travels = [j for j, c in enumerate(car.channels) if "travel" in c.name]
    carried = car.network.carried
    speeds = [
        count + j
        for j, c in enumerate(nodes)
        if c.name.endswith("_velocity") and c.at in carried
    ]
    heights = [
        count + j for j, c in enumerate(nodes) if c.name.endswith("_displacement")
    ]
    rows = out[[*speeds, *heights, *travels]]
    at = {car.body: car.arms(0.0, 0.0)} | {
        c.wheel: car.arms(c.x, c.y) for c in car.corners
    }
    states = []
    for motion in range(1 + len(car.axes)):
        wanted = np.zeros(len(rows))
        for j, place in enumerate(speeds):
            node = nodes[place - count].at
            if node in at:
                wanted[j] = at[node][motion]
            elif motion and node == car.angles[car.axes[motion - 1]]:
                wanted[j] = 1.0
        states.append(np.linalg.lstsq(rows, wanted, rcond=None)[0])
    return np.vstack(
        [np.array(states).T, np.zeros((total - out.shape[1], len(states)))]
    )


# ------------------------------------------------------------------------------------ linear-quadratic


def car_regulator(model: CarModel, weights: CarWeights) -> tuple[np.ndarray, float]:
    """Return gain K (currents, n) of ``I = -K x`` of a car without friction, and its mean cost per step on a white road.

    The currents do not change the delay line, so that the value of the motion alone is that of a car on even
    road. A line of d states is empty after d steps; as many steps of the Riccati recursion add the value of
    the line exactly.
    """
    q, r = weights.of(model)
    A, B, k = model.A, model.inputs, model.motion
    C, D = model.C @ A, model.C @ B + model.feedthrough
    Q, R, N = weighted(C, D, q)
    R += np.diag(r)
    V = np.zeros((model.n, model.n))
    V[:k, :k] = riccati(model.network, A[:k, :k], B[:k], Q[:k, :k], R, N[:k])
    for _ in range(model.n - k + 1):
        K = feedback(A, B, V, R, N)
        V = Q + A.T @ V @ A - (B.T @ V @ A + N.T).T @ K
        V = 0.5 * (V + V.T)
    worth = V + model.C.T @ (q[:, None] * model.C)
    return K, float(np.trace(worth @ model.W))
