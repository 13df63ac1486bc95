"""What a policy sees: measured signals, their changes, leaky integrals, the road ahead and a Kalman estimate, over fixed scales.

One observation is not the state of the car. Changes over the last steps carry what the sensors do not measure (the
tyre's force follows from the balance of forces, the oil's deflection from the body's acceleration), and the leaky
integral of the body's acceleration is its absolute velocity. A `Filter` says the same in the coordinates of the state:
the estimate that the LQG acts on, and what the LQG would do. An `Echo` is the road ahead of the rear wheels. Fixed scales instead of running statistics: a
policy means the same thing in training, in a checkpoint and in a car. Numpy alone, float32, one row a car.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from isd_gym.errors import InputError, shown
from isd_gym.inputs import number

if TYPE_CHECKING:
    from collections.abc import Mapping

#: what a policy's file may ask for: states of a filter, signals, orders of change, the size of any number
STATES, SIGNALS, ORDERS, LARGEST = 64, 1024, 8, 1e12
LONGEST, LEADERS = 1024, 8  # control steps of a delay, and wheels that lead


@dataclass(frozen=True)
class Filter:
    """A steady Kalman filter and the law behind it as plain matrices, in coordinates z of about unit size.

    ``free = A z + B I``; friction f in [-1, 1] of its level holds, ``S free = K f``, or slides, one row of S and K each;
    ``z+ = x + L (y - C x - D I - F f)`` with ``x = free + G f``. Then the law ``I* = law z - force tanh(rate z)`` [A], of
    which ``(I* - I) / slew`` within ±`reach` is a feature of each current. The offset [A] that the policy's head keeps from
    the law is another one.

    With one current, B, D, law, rate, road, law_ahead, rate_ahead and force may be given flat.

    Attributes:
        A: (n, n).
        B: (n, currents).
        G: (n, frictions).
        S: (frictions, n).
        K: (frictions, frictions).
        C: (signals, n), of the first signals y.
        D: (signals, currents).
        F: (signals, frictions).
        L: (n, signals).
        law: (currents, n).
        rate: (currents, n).
        force: Friction over thrust constant [A] (currents,).
        slew: [A].
        reach: [-].
        current: Place of the first present current among the signals; the others follow.
        road: (n, roads), effect on z of a known rise by 1 m over the last step; empty where no road is known.
        law_ahead: (currents, points), what the rises of the next steps add to the law [1/m], road after road.
        rate_ahead: (currents, points), what they add to the rate.
    """

    A: tuple[tuple[float, ...], ...]
    B: tuple[tuple[float, ...], ...]
    G: tuple[tuple[float, ...], ...]
    S: tuple[tuple[float, ...], ...]
    K: tuple[tuple[float, ...], ...]
    C: tuple[tuple[float, ...], ...]
    D: tuple[tuple[float, ...], ...]
    F: tuple[tuple[float, ...], ...]
    L: tuple[tuple[float, ...], ...]
    law: tuple[tuple[float, ...], ...]
    rate: tuple[tuple[float, ...], ...]
    force: tuple[float, ...]
    slew: float = 0.5
    reach: float = 2.0
    current: int = 5
    road: tuple[tuple[float, ...], ...] = ()
    law_ahead: tuple[tuple[float, ...], ...] = ()
    rate_ahead: tuple[tuple[float, ...], ...] = ()

    def __post_init__(self) -> None:
        try:
            for name in ("B", "D", "road"):
                self._nest(name, column=True)
            for name in ("law", "rate", "law_ahead", "rate_ahead"):
                self._nest(name, column=False)
            if isinstance(self.force, int | float):
                object.__setattr__(self, "force", (self.force,))
            n, nf, ny, m = len(self.B), len(self.K), len(self.D), len(self.law)
            ahead = len(self.law_ahead[0]) if self.law_ahead else 0
            known, roads = len(self.road), len(self.road[0]) if self.road else 0
        except TypeError:
            raise InputError(
                "memory: filter's B, K, D, law, road and law_ahead must be lists of numbers"
            ) from None
        if not (0 < n <= STATES and nf <= STATES and ny <= SIGNALS and ahead <= SIGNALS and 0 < m <= STATES):
            raise InputError(f"memory: filter has more than {STATES} states or {SIGNALS} signals")
        if known not in (0, n) or roads > STATES:
            raise InputError(f"memory: filter's road must have {n} rows or none, not {known}")
        shapes: dict[str, tuple[int, ...]] = dict(
            A=(n, n), B=(n, m), G=(n, nf), S=(nf, n), K=(nf, nf), C=(ny, n), D=(ny, m), F=(ny, nf), L=(n, ny)
        )
        shapes |= dict(law=(m, n), rate=(m, n), force=(m,))
        views = dict(road=(known, roads), law_ahead=(m, ahead), rate_ahead=(m, ahead))
        for name, shape in (shapes | views).items():
            try:
                value = np.array(getattr(self, name), float)
            except (TypeError, ValueError, OverflowError):
                raise InputError(f"memory: filter's {name} is not a matrix") from None
            if not (value.shape == shape or value.size == math.prod(shape) == 0):
                raise InputError(f"memory: filter's {name} must have shape {shape}, not {value.shape}")
            if not (np.abs(value) <= LARGEST).all():
                raise InputError(f"memory: filter's {name} must be finite, at most {LARGEST:g}")
        for name in ("slew", "reach"):
            size = number(getattr(self, name), f"memory: filter's {name}")
            if not 0 < size <= LARGEST:
                raise InputError(f"memory: filter's {name} must be > 0 and at most {LARGEST:g}, not {size:g}")
        if not all(self.K[j][j] > 0 for j in range(nf)):
            raise InputError("memory: filter's diagonal of K must be > 0")
        if (
            isinstance(self.current, bool)
            or not isinstance(self.current, int)
            or not 0 <= self.current < SIGNALS
        ):
            raise InputError(
                f"memory: filter's current must be the place of a signal, not {shown(self.current)}"
            )

    def _nest(self, name: str, *, column: bool) -> None:
        """Turn a flat list of numbers into one column or one row."""
        value = getattr(self, name)
        if len(value) and not any(isinstance(v, list | tuple) for v in value):
            object.__setattr__(self, name, tuple((v,) for v in value) if column else (tuple(value),))

    @property
    def currents(self) -> int:
        """Number of currents that the law commands."""
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
        """Number of features: the estimate, the frictions, and for each current the law and the offset from it."""
        return len(self.B) + len(self.K) + 2 * self.currents

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Filter:
        return cls(**{k: tuples(v) for k, v in data.items()})


@dataclass(frozen=True)
class Echo:
    """Road ahead of the rear wheels, as the leading wheels of the same track met it.

    The filter's estimate contains the rise of the road under each leading wheel in the control step that began `lag` steps
    ago. A wheel at a distance behind it meets that rise after distance / speed. The rises of the next `points` steps
    under it are features; those that no wheel has met yet are 0. A delay of a fraction of a step interpolates linearly.

    Attributes:
        rows: (leaders, n), rise [m] under each leading wheel by the filter's estimate.
        followers: For each wheel that follows: the number of its leading wheel, and its distance behind that wheel [m].
        speed: Speed [m/s].
        lag: Steps since the beginning of the step of that rise.
        points: Number of rises of each follower.
        rise: Scale of a rise [m].
    """

    rows: tuple[tuple[float, ...], ...]
    followers: tuple[tuple[int, float], ...]
    speed: float
    lag: int
    points: int
    rise: float

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
                raise InputError(f"memory: echo's {name} must be a whole number of control steps")
        try:
            rows = np.array(self.rows, float)
            pairs = [(int(leader), float(distance)) for leader, distance in self.followers]
        except (TypeError, ValueError, OverflowError):
            raise InputError("memory: echo's rows and followers must be lists of numbers") from None
        if not (rows.ndim == 2 and 0 < len(rows) <= LEADERS and 0 < rows.shape[1] <= STATES):
            raise InputError(f"memory: echo's rows must be 1 to {LEADERS}, one for each leading wheel")
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

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Echo:
        return cls(**{k: tuples(v) for k, v in data.items()})

    def weights(self, step: float) -> np.ndarray:
        """Return how the rises ahead follow from those that were met (leaders, ages, followers * points).

        A rise of age j was met in the step that began `lag` + j steps ago.

        Args:
            step: Control step [s].

        Raises:
            InputError: At this speed, a delay is longer than `LONGEST` steps.
        """
        delays = [distance / (self.speed * step) for _, distance in self.followers]
        if max(delays) > LONGEST:
            raise InputError(
                f"at {self.speed:g} m/s the rear wheels follow after {max(delays) * step:.3g} s; give a speed of "
                f"{self.speed * max(delays) / LONGEST:.3g} m/s or more"
            )
        ages = max(int(max(delays)) - self.lag, 0) + 2
        out = np.zeros((len(self.rows), ages, len(self.followers), self.points))
        for f, ((leader, _), delay) in enumerate(zip(self.followers, delays, strict=True)):
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
    return tuple(tuples(v) for v in value) if isinstance(value, list | tuple) else value


@dataclass(frozen=True)
class Memory:
    """How features are made of observations.

    scale: of each signal [its SI unit]. change: of its change over one control step; changes of order 1 to `order` are
    fed, each over it. leak: signal index -> (time constant [s], scale) of leaky integrals.
    ahead: points of the road ahead that follow the signals in an observation, one a control step; their rises are fed over
    `rise` [m]. filter: an estimate fed besides. echo: road before the rear wheels, fed before the estimate. step: control
    step [s]. No scale means that the signals pass unchanged.
    """

    scale: tuple[float, ...] = ()
    change: tuple[float, ...] = ()
    order: int = 0
    leak: tuple[tuple[int, float, float], ...] = ()
    step: float = 5e-3
    filter: Filter | None = None
    ahead: int = 0
    rise: float = 1.4e-3  # RMS of the paper's road over a control step
    echo: Echo | None = None

    def __post_init__(self) -> None:
        if not 0 <= self.order <= ORDERS:
            raise InputError(f"memory: order must be 0 to {ORDERS}, not {shown(self.order)}")
        if max(len(self.scale), len(self.change), len(self.leak)) > SIGNALS:
            raise InputError(f"memory: more than {SIGNALS} signals or leaks")
        if not 0 <= self.ahead <= SIGNALS or not 1 / LARGEST < self.rise < LARGEST:
            raise InputError(f"memory: ahead must be 0 to {SIGNALS} points and rise > 0")
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
                raise InputError("memory: its filter knows the road under other wheels than its echo")
        elif self.filter and self.filter.roads > 1:
            raise InputError("memory: its filter knows the road under several wheels, and no echo tells it")
        if self.filter and self.filter.points > (self.echo.width if self.echo else self.ahead):
            raise InputError("memory: its filter looks farther ahead than the observation")
        if self.order > 0 and len(self.change) != len(self.scale):
            raise InputError("memory: change needs one scale for each signal")
        if any(not 1 / LARGEST < s < LARGEST for s in (*self.scale, *self.change)):
            raise InputError(f"memory: scales must be > 0, at most {LARGEST:g}")
        if not 0 < self.step <= 10:
            raise InputError(f"memory: step must be > 0 and at most 10 s, not {self.step:g}")
        for signal, tau, scale in self.leak:
            if not (
                0 <= signal < len(self.scale) and self.step < tau < LARGEST and 1 / LARGEST < scale < LARGEST
            ):
                raise InputError(
                    f"memory: leak ({signal}, {tau:g}, {scale:g}) is not (signal, seconds, scale)"
                )

    def width(self, signals: int) -> int:
        """Number of features of `signals` measured signals (the road ahead not among them)."""
        if self.scale and signals != len(self.scale):
            raise InputError(f"memory: made for {len(self.scale)} signals, the observation has {signals}")
        return signals * (1 + self.order) + self.extra

    @property
    def extra(self) -> int:
        """Number of features besides the signals and their changes."""
        echo = self.echo.width if self.echo else 0
        return len(self.leak) + self.ahead + echo + (self.filter.width if self.filter else 0)

    def to_dict(self) -> dict[str, Any]:
        return asdict(self)

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Memory:
        try:
            return cls(
                scale=tuple(float(s) for s in data.get("scale", ())),
                change=tuple(float(s) for s in data.get("change", ())),
                order=int(data.get("order", 0)),
                leak=tuple((int(i), float(t), float(s)) for i, t, s in data.get("leak", ())),
                step=float(data.get("step", 5e-3)),
                filter=Filter.from_dict(data["filter"]) if data.get("filter") else None,
                ahead=int(data.get("ahead", 0)),
                rise=float(data.get("rise", 1.4e-3)),
                echo=Echo.from_dict(data["echo"]) if data.get("echo") else None,
            )
        except InputError:
            raise
        except (TypeError, ValueError, OverflowError, AttributeError, RecursionError) as error:
            raise InputError(f"memory: {error}") from None

    def start(self, observations: np.ndarray) -> Recall:
        """Memory of cars that begin now, at `observations` (count, signals, then the road ahead)."""
        return Recall(self, observations)


class Recall:
    """The memory of `count` cars: `features` (count, width) float32 of what was seen so far."""

    def __init__(self, memory: Memory, observations: np.ndarray) -> None:
        self.memory = memory
        count, columns = observations.shape
        signals = columns - memory.ahead
        self.features = np.empty((count, memory.width(signals)), np.float32)
        self._signals = signals
        self.scale = np.array(memory.scale or [1.0] * signals, np.float32)
        # factors that turn differences of scaled signals into features
        ratio = self.scale / np.array(memory.change or [1.0] * signals, np.float32)
        self.ratios = [ratio if k == 0 else np.float32(1.0) for k in range(memory.order)]
        self.leaks = [
            (i, np.float32(1 - memory.step / tau), np.float32(memory.step / scale))
            for i, tau, scale in memory.leak
        ]
        first = memory.width(signals) - memory.extra + len(memory.leak)
        self.echo = _Echo(memory.echo, memory.step, count) if memory.echo else None
        # columns of the rises, and of those which the first step of each road ahead begins with
        width = memory.echo.width if memory.echo else memory.ahead
        self._road = slice(first, first + width)
        self._next = slice(first, first + width, memory.echo.points if memory.echo else max(width, 1))
        self._rise = np.float32(memory.echo.rise if memory.echo else memory.rise)
        self.filter = _Filter(memory.filter, count) if memory.filter else None
        self.begin(np.ones(count, bool), observations)

    def begin(self, which: np.ndarray, observations: np.ndarray) -> None:
        """Forget the cars `which` (mask): they start anew at `observations` (count, signals)."""
        f, n = self.features, self._signals
        f[which] = 0.0
        f[which, :n] = observations[which, :n] / self.scale
        if self.memory.ahead:
            f[which, self._road] = self._rises(observations[which])
        if self.echo:
            self.echo.met[which] = 0.0
        if self.filter:
            self.filter.wanted[which] = 0.0

    def _rises(self, observations: np.ndarray) -> np.ndarray:
        """By how much the road rises in the next control steps, over its scale (count, ahead)."""
        heights = observations[:, self._signals :]
        out = heights / self._rise
        out[:, 1:] -= heights[:, :-1] / self._rise
        return out

    def see(self, observations: np.ndarray) -> np.ndarray:
        """Take in the next observations (count, signals); returns `features`, valid until the next call."""
        f, n = self.features, self._signals
        new: np.ndarray = observations[:, :n] / self.scale
        for k, ratio in enumerate(self.ratios):
            old = f[:, n * k : n * (k + 1)].copy()
            f[:, n * k : n * (k + 1)] = new
            new = (new - old) * ratio
        f[:, n * self.memory.order : n * (self.memory.order + 1)] = new
        for j, (i, keep, gain) in enumerate(self.leaks, n * (self.memory.order + 1)):
            f[:, j] = f[:, j] * keep + observations[:, i] * gain
        risen = ahead = None
        if self.memory.ahead or self.echo:
            risen = f[:, self._next] * self._rise
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
        self.weights = (weights / given.rise).reshape(leaders * ages, width).astype(np.float32)
        self.met = np.zeros((count, leaders, ages), np.float32)

    def see(self, estimate: np.ndarray) -> np.ndarray:
        """Take in the estimate (count, n); returns the rises ahead (count, followers * points) over their scale."""
        met = self.met
        met[:, :, 1:] = met[:, :, :-1].copy()
        met[:, :, 0] = estimate @ self.rows
        return met.reshape(len(met), -1) @ self.weights


class _Filter:
    """The arithmetic of `Filter`, on rows of its features."""

    def __init__(self, given: Filter, count: int) -> None:
        n, nf, ny, m = len(given.B), len(given.K), len(given.D), given.currents
        #: what the law commands [A] (count, currents)
        self.wanted = np.zeros((count, m), np.float32)

        def array(name: str, *shape: int) -> np.ndarray:
            return np.array(getattr(given, name), float).reshape(shape)

        L, C, S = array("L", n, ny), array("C", ny, n), array("S", nf, n)
        self.width, self.n, self.nf, self.ny, self.m = given.width, n, nf, ny, m
        self.given = given
        # rows: estimate and currents; then friction; then signals
        predict = np.vstack([array("A", n, n).T, array("B", n, m).T])
        correct = np.eye(n) - L @ C
        K = array("K", nf, nf)
        self.stick = (predict @ S.T / np.diag(K)).astype(np.float32)
        self.others = (K / np.diag(K)[:, None] - np.eye(nf)).T.astype(np.float32)
        self.free = np.vstack([predict[:n] @ correct.T, predict[n:] @ correct.T - (L @ array("D", ny, m)).T])
        self.free = self.free.astype(np.float32)
        self.force = (array("G", n, nf).T @ correct.T - (L @ array("F", ny, nf)).T).astype(np.float32)
        self.gain = L.T.astype(np.float32)
        self.rows = np.concatenate([array("law", m, n), array("rate", m, n)]).T.astype(np.float32)
        self.push = np.array(given.force, np.float32)
        # the road: how a rise moves the rate at which a friction would slide, and the estimate; and the law ahead
        roads = given.roads
        road = array("road", n, roads) if roads else np.zeros((n, 0))
        self.road_stick = (S @ road / np.diag(K)[:, None]).T.astype(np.float32)
        self.road = (correct @ road).T.astype(np.float32)
        ahead = [array(name, m, given.points) for name in ("law_ahead", "rate_ahead")]
        self.ahead = np.concatenate(ahead).T.astype(np.float32)

    def estimate(self, features: np.ndarray, observations: np.ndarray, risen: np.ndarray | None) -> None:
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
                friction[:, j] = np.clip(rest[:, j] - friction @ self.others[:, j], -1.0, 1.0)
        z = now @ self.free + friction @ self.force + observations[:, : self.ny] @ self.gain
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
        m, given, end = self.m, self.given, self.n + self.nf
        rows = features[:, : self.n] @ self.rows
        if ahead is not None and len(self.ahead):
            rows += ahead[:, : len(self.ahead)] @ self.ahead * np.float32(rise)
        self.wanted = rows[:, :m] - self.push * np.tanh(rows[:, m:])
        current = observations[:, given.current : given.current + m]
        share = (self.wanted - current) / np.float32(given.slew)
        features[:, end : end + m] = np.clip(share, -given.reach, given.reach)
