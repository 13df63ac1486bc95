"""Scaled signals with memory, the observation ``"history"``.

One observation is not the state of the car. The change of a signal over a control step contains quantities
without a sensor: the force of the tyre follows from the balance of forces, the deflection of the oil from the
body's acceleration. The leaky integral of the body's acceleration is the velocity of the body. All scales are
fixed, so that a policy has the same meaning in training, in a file and in a car. Rear wheels meet the road of the front
wheels later: numbers of the front corners, as they were then, are the road ahead of the rear wheels.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from .._common import jit
from .._common.errors import InputError, shown

if TYPE_CHECKING:
    from ..physics.vehicle import Vehicle

#: limits of a history: signals, orders of change, age of a number [control steps], magnitude of numbers
SIGNALS, ORDERS, AGES, LARGEST = 1024, 8, 2048, 1e12
#: bound of every number of a history
BOUND = 10.0
#: RMS of each kind of signal on the paper's road, rounded, and of its change in a control step of 5 ms, in SI units
SCALES = {
    "body_acceleration": (1.0, 0.25),
    "pitch_acceleration": (0.5, 0.12),
    "roll_acceleration": (0.8, 0.2),
    "suspension_travel": (0.01, 0.001),
    "suspension_travel_rate": (0.2, 0.06),
    "device_travel": (0.01, 0.0005),
    "device_travel_rate": (0.05, 0.012),
    "current": (2.5, 0.45),
}
#: velocities of the body are leaky integrals of its accelerations: time constants [s], and scales over the scale of the
#: acceleration. A combination of several is closer to the velocity than any one of them
LEAKS = ((0.3, 0.042), (1.0, 0.07), (3.0, 0.091))
#: times before the rear wheels arrive for which a history has numbers of the front corners [s]
LEADS = (0.0, 0.01, 0.02, 0.03, 0.045, 0.06, 0.08, 0.1)


@dataclass(frozen=True)
class History:
    """Definition of the numbers of a history. Without scales, the signals are unchanged."""

    scale: tuple[float, ...] = ()  # scale of each signal [SI unit of the signal]
    change: tuple[float, ...] = ()  # scale of each signal's change over a control step
    order: int = 0  # highest order of change
    #: index of the signal, time constant [s] and scale of each leaky integral
    leak: tuple[tuple[int, float, float], ...] = ()
    step: float = 5e-3  # control step [s]
    #: column of a number, distance of the following wheel behind the leading one [m], and time before its
    #: arrival [s], for each number that is repeated later
    late: tuple[tuple[int, float, float], ...] = ()
    speed: float = 20.0  # speed of the car [m/s], which turns distances into delays

    def __post_init__(self) -> None:
        if not 0 <= self.order <= ORDERS:
            raise InputError(
                f"memory: order must be 0 to {ORDERS}, not {shown(self.order)}"
            )
        if max(len(self.scale), len(self.change), len(self.leak)) > SIGNALS:
            raise InputError(f"memory: more than {SIGNALS} signals or leaks")
        if self.order > 0 and len(self.change) != len(self.scale):
            raise InputError("memory: change needs one scale for each signal")
        if any(not 1 / LARGEST < s < LARGEST for s in (*self.scale, *self.change)):
            raise InputError(f"memory: scales must be > 0, at most {LARGEST:g}")
        if not 0 < self.step <= 10:
            raise InputError(
                f"memory: step must be > 0 and at most 10 s, not {self.step:g}"
            )
        for signal, tau, scale in self.leak:
            if not (
                0 <= signal < len(self.scale)
                and self.step < tau < LARGEST
                and 1 / LARGEST < scale < LARGEST
            ):
                raise InputError(
                    f"memory: leak ({signal}, {tau:g}, {scale:g}) is not (signal, seconds, scale)"
                )
        if len(self.late) > SIGNALS:
            raise InputError(f"memory: more than {SIGNALS} late numbers")
        if not 1e-3 <= self.speed <= 1e3:
            raise InputError(
                f"memory: speed must be 0.001 to 1000 m/s, not {self.speed:g}"
            )
        columns = self.numbers(len(self.scale)) - len(self.late)
        for column, distance, lead in self.late:
            if not (
                isinstance(column, int)
                and 0 <= column < columns
                and 0 < distance <= 1e3
                and 0 <= lead <= 1e3
            ):
                raise InputError(
                    f"memory: late ({column}, {distance:g}, {lead:g}) is not (column, metres behind, seconds before)"
                )
        if self.late and max(self.ages) > AGES:
            slowest = self.speed * max(self.ages) / AGES
            raise InputError(
                f"at {self.speed:g} m/s the rear wheels follow after {max(self.ages) * self.step:.3g} s; give a speed of "
                f"{slowest:.3g} m/s or more"
            )

    @property
    def ages(self) -> tuple[int, ...]:
        """Age of each late number [control steps]; 0 where the front wheel passes when the number is wanted."""
        return tuple(
            max(round((distance / self.speed - lead) / self.step), 0)
            for _, distance, lead in self.late
        )

    def numbers(self, signals: int) -> int:
        """Return the number of scaled signals, changes and leaky integrals."""
        return signals * (1 + self.order) + len(self.leak) + len(self.late)

    def labels(self, names: list[str]) -> list[str]:
        """Return a name for each number."""
        changes = ["", "change of ", "second change of "]
        of = [
            changes[k] if k < 3 else f"change of order {k} of "
            for k in range(self.order + 1)
        ]
        kept = [
            f"leaky integral of {names[i]} over {tau:g} s" for i, tau, _ in self.leak
        ]
        labels = [f"{what}{name}" for what in of for name in names] + kept
        labels += [
            f"{labels[column]}, {1e3 * lead:g} ms before the rear wheel arrives"
            for column, _, lead in self.late
        ]
        return [f"{label} [-]" for label in labels]


def history_of(car: Vehicle, step: float = 5e-3, speed: float = 20.0) -> History:
    """Return the history of a car: its signals, their first and second changes, and the velocities of the
    body.

    With following wheels, it also has numbers of each leading corner and of the body as they were before
    the following wheel met this road (`LEADS`).
    """
    kinds = [signal.kind for signal in car.measured]
    scale = tuple(SCALES[kind][0] for kind in kinds)
    change = tuple(SCALES[kind][1] * (step / 5e-3) for kind in kinds)
    leak = tuple(
        (i, tau, share * scale[i])
        for i in range(1 + len(car.axes))
        for tau, share in LEAKS
    )
    axes, n = 1 + len(car.axes), len(kinds)
    travels = [i for i, kind in enumerate(kinds) if kind == "suspension_travel"]
    rates = [i for i, kind in enumerate(kinds) if kind == "suspension_travel_rate"]
    wheels, late = car.wheels, []
    # with the middle time constant
    body = [
        *range(axes),
        *(3 * n + len(LEAKS) * axis + 1 for axis in range(axes)),
    ]
    for follower, distance in enumerate(wheels.behind):
        if distance:
            track = [
                w for w, t in enumerate(wheels.track) if t == wheels.track[follower]
            ]
            leader = min(track, key=wheels.behind.__getitem__)
            own = [travels[leader], rates[leader], n + rates[leader]]
            late += [
                (c, distance - wheels.behind[leader], lead)
                for c in body + own
                for lead in LEADS
            ]
            body = []
    return History(
        scale, change, order=2, leak=leak, step=step, late=tuple(late), speed=speed
    )


class Remembered:
    """The histories of several cars; `features` (count, width) float32 are the present ones, not clipped, in
    the first of `width` columns."""

    def __init__(
        self, history: History, count: int, signals: int, width: int | None = None
    ) -> None:
        self.signals = signals
        self.order = history.order
        own = history.numbers(signals)
        self.features = np.zeros((count, own if width is None else width), np.float32)
        self.scale = np.array(history.scale or [1.0] * signals, np.float32)
        #: factors that turn differences of scaled signals into scaled differences
        self.ratio = self.scale / np.array(
            history.change or [1.0] * signals, np.float32
        )
        self.leaks = np.array([i for i, _, _ in history.leak], np.int64)
        self.keep = np.array(
            [1 - history.step / tau for _, tau, _ in history.leak], np.float32
        )
        self.gain = np.array(
            [history.step / scale for _, _, scale in history.leak], np.float32
        )
        repeated = sorted({column for column, _, _ in history.late})
        self.repeated = np.array(repeated, np.int64)
        #: place among the repeated numbers, and age, of each late number
        self.places = np.array(
            [repeated.index(column) for column, _, _ in history.late], np.int64
        )
        self.ages = np.array(history.ages, np.int64)
        #: earlier values of the repeated numbers, in a ring whose newest row is `newest` (count, rows, repeated)
        self._first_late = own - len(history.late)
        self.past = np.zeros(
            (count, max(history.ages, default=-1) + 1, len(repeated)), np.float32
        )
        self.newest = 0

    def begin(self, which: np.ndarray | slice, observations: np.ndarray) -> None:
        """Start the histories of some cars anew."""
        self.features[which] = 0.0
        self.past[which] = 0.0
        self.features[which, : self.signals] = (
            observations[:, : self.signals] / self.scale
        )

    def get_state(self, i: int) -> np.ndarray:
        """Return the state of a car's history."""
        return np.concatenate(
            [self.features[i], np.roll(self.past[i], -self.newest, axis=0).ravel()]
        )

    def set_state(self, i: int, state: np.ndarray) -> None:
        """Put a car's history into a state of `get_state`."""
        width = self.features.shape[1]
        self.features[i] = state[:width]
        self.past[i] = np.roll(
            state[width:].reshape(self.past.shape[1:]), self.newest, axis=0
        )

    def see(self, observations: np.ndarray) -> np.ndarray:
        """Update the histories with the signals after one more control step."""
        _advance(
            self.features,
            observations,
            self.scale,
            self.ratio,
            self.order,
            self.leaks,
            self.keep,
            self.gain,
        )
        if len(self.places):
            self.newest = (self.newest + 1) % self.past.shape[1]
            rows = (self.newest - self.ages) % self.past.shape[1]
            _repeat(
                self.features,
                self.past,
                self.newest,
                self.repeated,
                rows,
                self.places,
                self._first_late,
            )
        return self.features

    def clipped(self) -> np.ndarray:
        """Return the features within ±`BOUND`, as a new array."""
        out = np.empty_like(self.features)
        _clip(self.features, BOUND, out)
        return out


@jit.compiled(error_model="numpy")
def _clip(features, bound, out):  # type: ignore[no-untyped-def]
    """Write the features within ±bound; `np.clip` takes five times as long for one car."""
    for i in range(features.shape[0]):
        for j in range(features.shape[1]):
            value = features[i, j]
            if value > bound:
                value = np.float32(bound)
            elif value < -bound:
                value = np.float32(-bound)
            out[i, j] = value


@jit.compiled(error_model="numpy")
def _advance(features, observations, scale, ratio, order, leaks, keep, gain):  # type: ignore[no-untyped-def]
    """Write scaled signals, their changes and leaky integrals of the next observations into the features."""
    n = scale.shape[0]
    for i in range(features.shape[0]):
        for j in range(n):
            new = observations[i, j] / scale[j]
            for k in range(order):
                old = features[i, n * k + j]
                features[i, n * k + j] = new
                new = new - old
                if k == 0:
                    new = new * ratio[j]
            features[i, n * order + j] = new
        for l in range(leaks.shape[0]):
            j = n * (order + 1) + l
            features[i, j] = (
                features[i, j] * keep[l] + observations[i, leaks[l]] * gain[l]
            )


@jit.compiled(error_model="numpy")
def _repeat(features, past, newest, repeated, rows, places, first):  # type: ignore[no-untyped-def]
    """Keep the repeated numbers and write the late ones into the features."""
    for i in range(features.shape[0]):
        for j in range(past.shape[2]):
            past[i, newest, j] = features[i, repeated[j]]
        for l in range(places.shape[0]):
            features[i, first + l] = past[i, rows[l], places[l]]
