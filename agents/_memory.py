"""Features of a policy: measured signals, their changes, leaky integrals, the road ahead and a Kalman estimate,
over fixed scales.

A single observation is not the state of the car. Changes over the last steps contain quantities without a
sensor (the force of the tyre follows from the balance of forces, the deflection of the oil from the body's
acceleration). The leaky integral of the body's acceleration is its absolute velocity. A `Filter` gives the
same information in the coordinates of the state: the estimate and the command of the LQG. An `Echo` is the
road ahead of the rear wheels. Scales are fixed instead of running statistics, so that a policy has the same
meaning in training, in a checkpoint and in a car. The code needs only numpy, uses float32, and has one row
per car.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from isd_gym._common.errors import InputError, shown
from isd_gym._common.inputs import is_whole, number
from isd_gym.env.history import LARGEST, SIGNALS, History, Remembered, history_of

if TYPE_CHECKING:
    from isd_gym.physics.vehicle import Vehicle

#: limit of a policy's file: states of a filter
STATES = 64
FRAMES = 64  # limit of a stack
LONGEST, LEADERS = 1024, 8  # control steps of a delay, and wheels that lead


@dataclass(frozen=True)
class Filter:
    """A steady Kalman filter with a control law as plain matrices, in coordinates z of about unit size.

    ``free = A z + B I``. Friction f in [-1, 1] of its level holds, ``S free = K f``, or slides; each
    friction has one row of S and K. ``z+ = x + L (y - C x - D I - F f)`` with ``x = free + G f``. The law
    is ``I* = law z - force tanh(rate z)`` [A]. Features of each current are ``(I* - I) / slew`` within
    ±`reach`, and the offset [A] from the law in a policy's head.
    """

    A: tuple[tuple[float, ...], ...]  # state matrix (n, n)
    B: tuple[tuple[float, ...], ...]  # response to the currents (n, currents)
    G: tuple[tuple[float, ...], ...]  # response to the frictions (n, frictions)
    S: tuple[tuple[float, ...], ...]  # rates of the frictions (frictions, n)
    # rates of the frictions per friction (frictions, frictions)
    K: tuple[tuple[float, ...], ...]
    # output matrix of the first signals y (signals, n)
    C: tuple[tuple[float, ...], ...]
    # response of the signals to the currents (signals, currents)
    D: tuple[tuple[float, ...], ...]
    # response of the signals to the frictions (signals, frictions)
    F: tuple[tuple[float, ...], ...]
    L: tuple[tuple[float, ...], ...]  # gain of the filter (n, signals)
    law: tuple[tuple[float, ...], ...]  # currents by the state (currents, n)
    # rates in the friction compensation by the state (currents, n)
    rate: tuple[tuple[float, ...], ...]
    force: tuple[float, ...]  # friction over thrust constant (currents,) [A]
    slew: float = 0.5  # scale of the law's features [A]
    reach: float = 2.0  # bound of the law's features [-]
    # index of the first present current among the signals; the others follow
    current: int = 5
    #: change of z per known rise of the road by 1 m over the last step (n, roads); empty without a known road
    road: tuple[tuple[float, ...], ...] = ()
    #: currents per rise of the road in the next steps (currents, points) [A/m], road after road
    law_ahead: tuple[tuple[float, ...], ...] = ()
    #: rates in the friction compensation per rise of the road (currents, points)
    rate_ahead: tuple[tuple[float, ...], ...] = ()

    def __post_init__(self) -> None:
        try:
            n = len(self.B)
            nf = len(self.K)
            ny = len(self.D)
            m = len(self.law)
            ahead = len(self.law_ahead[0]) if self.law_ahead else 0
            known = len(self.road)
            roads = len(self.road[0]) if self.road else 0
        except TypeError:
            raise InputError(
                "memory: filter's B, K, D, law, road and law_ahead must be lists of numbers"
            ) from None
        if not (
            0 < n <= STATES
            and nf <= STATES
            and ny <= SIGNALS
            and ahead <= SIGNALS
            and 0 < m <= STATES
        ):
            raise InputError(
                f"memory: filter has more than {STATES} states or {SIGNALS} signals"
            )
        if known not in (0, n) or roads > STATES:
            raise InputError(
                f"memory: filter's road must have {n} rows or none, not {known}"
            )
        shapes: dict[str, tuple[int, ...]] = dict(
            A=(n, n),
            B=(n, m),
            G=(n, nf),
            S=(nf, n),
            K=(nf, nf),
            C=(ny, n),
            D=(ny, m),
            F=(ny, nf),
            L=(n, ny),
        )
        shapes |= dict(law=(m, n), rate=(m, n), force=(m,))
        views = dict(road=(known, roads), law_ahead=(m, ahead), rate_ahead=(m, ahead))
        for name, shape in (shapes | views).items():
            try:
                value = np.array(getattr(self, name), float)
            except (TypeError, ValueError, OverflowError):
                raise InputError(f"memory: filter's {name} is not a matrix") from None
            if not (value.shape == shape or value.size == math.prod(shape) == 0):
                raise InputError(
                    f"memory: filter's {name} must have shape {shape}, not {value.shape}"
                )
            if not (np.abs(value) <= LARGEST).all():
                raise InputError(
                    f"memory: filter's {name} must be finite, at most {LARGEST:g}"
                )
        for name in ("slew", "reach"):
            size = number(getattr(self, name), f"memory: filter's {name}")
            if not 0 < size <= LARGEST:
                raise InputError(
                    f"memory: filter's {name} must be > 0 and at most {LARGEST:g}, not {size:g}"
                )
        if not all(self.K[j][j] > 0 for j in range(nf)):
            raise InputError("memory: filter's diagonal of K must be > 0")
        if not is_whole(self.current, 0, SIGNALS - 1):
            raise InputError(
                f"memory: filter's current must be the place of a signal, not {shown(self.current)}"
            )

    @property
    def currents(self) -> int:
        """Number of commanded currents."""
        return len(self.law)

    @property
    def roads(self) -> int:
        """Number of wheels under which the road is known."""
        return len(self.road[0]) if self.road else 0

    @property
    def points(self) -> int:
        """Number of rises of the road ahead that the law reads."""
        return len(self.law_ahead[0]) if self.law_ahead else 0

    @property
    def width(self) -> int:
        """Number of features: the estimate, the frictions, and for each current the law and the offset from the law."""
        return len(self.B) + len(self.K) + 2 * self.currents


@dataclass(frozen=True)
class Echo:
    """Road ahead of the rear wheels: the delayed road of the leading wheels in the same track.

    The filter's estimate contains the rise of the road under each leading wheel in the control step that
    began `lag` steps ago. A following wheel meets that rise after distance / speed. The rises of the next
    `points` steps under each following wheel are features; unknown rises are 0. A delay with a fraction of
    a step is interpolated linearly.
    """

    #: rise under each leading wheel by the filter's estimate (leaders, n) [m]
    rows: tuple[tuple[float, ...], ...]
    #: index of the leading wheel, and distance behind the leading wheel [m], of each following wheel
    followers: tuple[tuple[int, float], ...]
    speed: float  # speed [m/s]
    lag: int  # age of the estimated rise [control steps]
    points: int  # number of rises per following wheel
    rise: float  # scale of a rise [m]

    def __post_init__(self) -> None:
        for name, low, high in (
            ("speed", 1e-3, 1e3),
            ("lag", 0, SIGNALS),
            ("points", 1, SIGNALS),
            ("rise", 1 / LARGEST, LARGEST),
        ):
            if not low <= number(getattr(self, name), f"memory: echo's {name}") <= high:
                raise InputError(f"memory: echo's {name} must be {low:g} to {high:g}")
        for name in ("lag", "points"):
            if not isinstance(getattr(self, name), int):
                raise InputError(
                    f"memory: echo's {name} must be a whole number of control steps"
                )
        try:
            rows = np.array(self.rows, float)
            pairs = [
                (int(leader), float(distance)) for leader, distance in self.followers
            ]
        except (TypeError, ValueError, OverflowError):
            raise InputError(
                "memory: echo's rows and followers must be lists of numbers"
            ) from None
        if not (
            rows.ndim == 2 and 0 < len(rows) <= LEADERS and 0 < rows.shape[1] <= STATES
        ):
            raise InputError(
                f"memory: echo's rows must be 1 to {LEADERS}, one for each leading wheel"
            )
        if not (np.abs(rows) <= LARGEST).all():
            raise InputError(f"memory: echo's rows must be finite, at most {LARGEST:g}")
        if not 0 < len(pairs) <= STATES or len(pairs) * self.points > SIGNALS:
            raise InputError(f"memory: echo must have 1 to {SIGNALS} rises ahead")
        for leader, distance in pairs:
            if not (0 <= leader < len(rows) and 0 < distance <= 1e3):
                raise InputError(
                    f"memory: echo's follower ({leader}, {distance:g}) is not (leading wheel, metres behind it)"
                )

    @property
    def width(self) -> int:
        """Number of features."""
        return len(self.followers) * self.points

    def weights(self, step: float) -> np.ndarray:
        """Return the weights (leaders, ages, width) of the measured rises in the rises ahead; a rise of age j
        was met in the step that began `lag` + j steps ago."""
        delays = [distance / (self.speed * step) for _, distance in self.followers]
        if max(delays) > LONGEST:
            raise InputError(
                f"at {self.speed:g} m/s the rear wheels follow after {max(delays) * step:.3g} s; give a speed of "
                f"{self.speed * max(delays) / LONGEST:.3g} m/s or more"
            )
        ages = max(int(max(delays)) - self.lag, 0) + 2
        out = np.zeros((len(self.rows), ages, len(self.followers), self.points))
        for f, ((leader, _), delay) in enumerate(
            zip(self.followers, delays, strict=True)
        ):
            whole = round(delay)
            delay = whole if abs(delay - whole) < 1e-9 * max(whole, 1) else delay
            for i in range(self.points):
                age = delay - self.lag - i
                low = math.floor(age)
                for a, part in ((low, 1.0 - (age - low)), (low + 1, age - low)):
                    if a >= 0 and part:
                        out[leader, a, f, i] = part
        return out.reshape(len(self.rows), ages, self.width)


def tuples(value: Any) -> Any:
    """Return nested lists as nested tuples."""
    return tuple(tuples(v) for v in value) if isinstance(value, list | tuple) else value


def _made(kind: type[Any], data: Mapping[str, Any] | None) -> Any:
    """Return a `Filter` or an `Echo` from plain data; None without data."""
    return kind(**{k: tuples(v) for k, v in data.items()}) if data else None


def _floats(values: Any) -> tuple[float, ...]:
    return tuple(map(float, values))


def _rows(values: Any) -> tuple[tuple[int, float, float], ...]:
    return tuple((int(i), float(a), float(b)) for i, a, b in values)


#: from plain data to each field of a `Memory`
_READERS: dict[str, Callable[[Any], Any]] = {
    "scale": _floats,
    "change": _floats,
    "order": int,
    "leak": _rows,
    "step": float,
    "late": _rows,
    "speed": float,
    "filter": partial(_made, Filter),
    "ahead": int,
    "rise": float,
    "echo": partial(_made, Echo),
    "frames": lambda frames: frames,
}


@dataclass(frozen=True)
class Memory(History):
    """Definition of the features of observations: a history, the road ahead, and an estimate."""

    # estimate among the features; None without an estimate
    filter: Filter | None = None
    #: number of heights of the road ahead after the signals in an observation, one per control step
    ahead: int = 0
    #: scale of the rises of the road ahead [m]; RMS of the paper's road over a control step by default
    rise: float = 1.4e-3
    #: road before following wheels, before the estimate among the features; None without following wheels
    echo: Echo | None = None
    #: number of observations in a row whose features are stacked, the newest last
    frames: int = 1

    def __post_init__(self) -> None:
        super().__post_init__()
        if not is_whole(self.frames, 1, FRAMES):
            raise InputError(
                f"memory: frames must be 1 to {FRAMES}, not {shown(self.frames)}"
            )
        if not 0 <= self.ahead <= SIGNALS or not 1 / LARGEST < self.rise < LARGEST:
            raise InputError(
                f"memory: ahead must be 0 to {SIGNALS} points and rise > 0"
            )
        if self.echo is not None:
            if self.ahead:
                raise InputError(
                    "memory: the road ahead is told by an echo or by the observation, not by both"
                )
            if self.filter is None or len(self.echo.rows[0]) != len(self.filter.B):
                raise InputError(
                    "memory: an echo needs a filter with as many states as its rows have numbers"
                )
            self.echo.weights(self.step)  # its delays can be kept
            if self.filter.roads != len(self.echo.followers):
                raise InputError(
                    "memory: its filter knows the road under other wheels than its echo"
                )
        elif self.filter and self.filter.roads > 1:
            raise InputError(
                "memory: its filter knows the road under several wheels, and no echo tells it"
            )
        if self.filter and self.filter.points > (
            self.echo.width if self.echo else self.ahead
        ):
            raise InputError(
                "memory: its filter looks farther ahead than the observation"
            )

    @classmethod
    def of(cls, car: Vehicle, step: float = 5e-3, speed: float = 20.0) -> Memory:
        """Return the memory whose features are the history of a car, the observation ``"history"``."""
        return cls(**vars(history_of(car, step, speed)))

    def at(self, speed: float) -> Memory:
        """Return the memory at another speed: the delays of following wheels follow the speed."""
        speed = float(speed)
        echo = replace(self.echo, speed=speed) if self.echo else None
        if echo:
            echo.weights(self.step)
        if echo == self.echo and (self.speed == speed or not self.late):
            return self
        return replace(self, echo=echo, speed=speed)

    def width(self, signals: int) -> int:
        """Return the number of features."""
        if self.scale and signals != len(self.scale):
            raise InputError(
                f"memory: made for {len(self.scale)} signals, the observation has {signals}"
            )
        return signals * (1 + self.order) + self.extra

    @property
    def extra(self) -> int:
        """Number of features besides the signals and their changes."""
        echo = self.echo.width if self.echo else 0
        return (
            len(self.leak)
            + len(self.late)
            + self.ahead
            + echo
            + (self.filter.width if self.filter else 0)
        )

    def to_dict(self) -> dict[str, Any]:
        """Return the memory as plain data."""
        return asdict(self)

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Memory:
        """Return a memory from plain data."""
        try:
            given = data.keys()
            return cls(
                **{
                    key: read(data[key])
                    for key, read in _READERS.items()
                    if key in given
                }
            )
        except InputError:
            raise
        except (
            TypeError,
            ValueError,
            OverflowError,
            AttributeError,
            RecursionError,
        ) as error:
            raise InputError(f"memory: {error}") from None

    def start(self, observations: np.ndarray) -> Recall:
        """Return the memory of cars at the start of an episode."""
        return Recall(self, observations)


class Recall(Remembered):
    """The memory of several cars, from their first observations (count, signals, then the road ahead);
    `features` (count, width) float32 are the present features."""

    def __init__(self, memory: Memory, observations: np.ndarray) -> None:
        count, columns = observations.shape
        signals = columns - memory.ahead
        super().__init__(memory, count, signals, memory.width(signals))
        self.memory = memory
        first = memory.numbers(signals)
        self.echo = _Echo(memory.echo, memory.step, count) if memory.echo else None
        # columns of the rises, and of those which the first step of each road ahead begins with
        width = memory.echo.width if memory.echo else memory.ahead
        self._road = slice(first, first + width)
        self._next = slice(
            first, first + width, memory.echo.points if memory.echo else max(width, 1)
        )
        self._rise = np.float32(memory.echo.rise if memory.echo else memory.rise)
        self.filter = _Filter(memory.filter, count) if memory.filter else None
        self._stack = np.zeros(
            (count, memory.frames, self.features.shape[1]), np.float32
        )
        self.begin(slice(None), observations)

    def stacked(self) -> np.ndarray:
        """Return the features behind those of the last observations (count, frames * width), zero before the start."""
        self._stack[:, :-1] = self._stack[:, 1:]
        self._stack[:, -1] = self.features
        return self._stack.reshape(len(self._stack), -1)

    @property
    def ratios(self) -> list[np.ndarray]:
        """Factors on the differences of each order of change, from the first (signals,) [-]."""
        ones = np.ones_like(self.ratio)
        return [ones if k else self.ratio for k in range(self.order)]

    def begin(self, which: np.ndarray | slice, observations: np.ndarray) -> None:
        super().begin(which, observations)
        if self.memory.ahead:
            self.features[which, self._road] = self._rises(observations)
        if self.echo:
            self.echo.met[which] = 0.0
        if self.filter:
            self.filter.wanted[which] = 0.0

    def _rises(self, observations: np.ndarray) -> np.ndarray:
        """Return the scaled rises of the road in the next control steps (count, ahead)."""
        heights = observations[:, self.signals :]
        out = heights / self._rise
        out[:, 1:] -= heights[:, :-1] / self._rise
        return out

    def see(self, observations: np.ndarray) -> np.ndarray:
        f = self.features
        risen = ahead = None
        if self.memory.ahead or self.echo:
            risen = f[:, self._next] * self._rise
        super().see(observations)
        if self.memory.ahead:
            f[:, self._road] = self._rises(observations)
        if self.filter:
            own = f[:, -self.filter.width :]
            self.filter.estimate(own, observations, risen)
            if self.echo:
                f[:, self._road] = self.echo.see(own[:, : self.filter.n])
            if self.memory.ahead or self.echo:
                ahead = f[:, self._road]
            self.filter.command(own, observations, ahead, self._rise)
        return f


class _Echo:
    """The arithmetic of `Echo`: rises that the leading wheels have met (count, leaders, ages) [m], the newest first."""

    def __init__(self, given: Echo, step: float, count: int) -> None:
        self.rows = np.array(given.rows, np.float32).T
        weights = given.weights(step)
        leaders, ages, width = weights.shape
        #: from the rises of all leaders to those ahead of the followers, over their scale
        self.weights = (
            (weights / given.rise).reshape(leaders * ages, width).astype(np.float32)
        )
        self.met = np.zeros((count, leaders, ages), np.float32)

    def see(self, estimate: np.ndarray) -> np.ndarray:
        """Take in the estimate (count, n); returns the rises ahead (count, followers * points) over their scale."""
        met = self.met
        met[:, :, 1:] = met[:, :, :-1].copy()
        met[:, :, 0] = estimate @ self.rows
        return met.reshape(len(met), -1) @ self.weights


class _Filter:
    """The arithmetic of `Filter` on rows of its features."""

    def __init__(self, given: Filter, count: int) -> None:
        n = len(given.B)
        nf = len(given.K)
        ny = len(given.D)
        m = given.currents
        #: what the law commands [A] (count, currents)
        self.wanted = np.zeros((count, m), np.float32)

        def array(name: str, *shape: int) -> np.ndarray:
            return np.array(getattr(given, name), float).reshape(shape)

        L = array("L", n, ny)
        C = array("C", ny, n)
        S = array("S", nf, n)
        self.width = given.width
        self.n = n
        self.nf = nf
        self.ny = ny
        self.m = m
        self.given = given
        # rows: estimate and currents; then friction; then signals
        predict = np.vstack([array("A", n, n).T, array("B", n, m).T])
        correct = np.eye(n) - L @ C
        K = array("K", nf, nf)
        self.stick = (predict @ S.T / np.diag(K)).astype(np.float32)
        self.others = (K / np.diag(K)[:, None] - np.eye(nf)).T.astype(np.float32)
        self.free = np.vstack(
            [
                predict[:n] @ correct.T,
                predict[n:] @ correct.T - (L @ array("D", ny, m)).T,
            ]
        )
        self.free = self.free.astype(np.float32)
        self.force = (
            array("G", n, nf).T @ correct.T - (L @ array("F", ny, nf)).T
        ).astype(np.float32)
        self.gain = L.T.astype(np.float32)
        self.rows = np.concatenate([array("law", m, n), array("rate", m, n)]).T.astype(
            np.float32
        )
        self.push = np.array(given.force, np.float32)
        # effect of a rise of the road on the sliding rate of each friction and on the estimate; and the law
        # ahead
        roads = given.roads
        road = array("road", n, roads) if roads else np.zeros((n, 0))
        self.road_stick = (S @ road / np.diag(K)[:, None]).T.astype(np.float32)
        self.road = (correct @ road).T.astype(np.float32)
        ahead = [array(name, m, given.points) for name in ("law_ahead", "rate_ahead")]
        self.ahead = np.concatenate(ahead).T.astype(np.float32)

    def estimate(
        self, features: np.ndarray, observations: np.ndarray, risen: np.ndarray | None
    ) -> None:
        """Take in observations; `risen` (count, roads) [m]: of the known roads over the last step."""
        n, given = self.n, self.given
        current = observations[:, given.current : given.current + self.m]
        now = np.concatenate([features[:, :n], current], axis=1)
        rest = now @ self.stick
        known = risen is not None and given.roads > 0
        if known:
            rest += risen @ self.road_stick
        friction = np.clip(rest, -1.0, 1.0)
        for _ in range(2 if self.nf > 1 else 0):
            for j in range(self.nf):
                friction[:, j] = np.clip(
                    rest[:, j] - friction @ self.others[:, j], -1.0, 1.0
                )
        # products of part of a row may raise the flag of an invalid value although all values are finite: the library reads past the part
        with np.errstate(invalid="ignore"):
            z = (
                now @ self.free
                + friction @ self.force
                + observations[:, : self.ny] @ self.gain
            )
        if known:
            z += risen @ self.road
        features[:, :n] = z
        features[:, n : n + self.nf] = friction

    def command(
        self,
        features: np.ndarray,
        observations: np.ndarray,
        ahead: np.ndarray | None = None,
        rise: np.float32 | float = 1.0,
    ) -> None:
        """Tell what the law commands at the estimate; `ahead` (count, points): rises of the road over `rise` [m]."""
        m = self.m
        given = self.given
        end = self.n + self.nf
        rows = features[:, : self.n] @ self.rows
        if ahead is not None and len(self.ahead):
            rows += ahead[:, : len(self.ahead)] @ self.ahead * np.float32(rise)
        self.wanted = rows[:, :m] - self.push * np.tanh(rows[:, m:])
        current = observations[:, given.current : given.current + m]
        share = (self.wanted - current) / np.float32(given.slew)
        features[:, end : end + m] = np.clip(share, -given.reach, given.reach)
