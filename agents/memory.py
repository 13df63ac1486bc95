"""What a policy sees: measured signals, their changes, leaky integrals and a Kalman estimate, over fixed scales.

One observation is not the state of the car. Changes over the last steps carry what the sensors do not measure (the
tyre's force follows from the balance of forces, the oil's deflection from the body's acceleration), and the leaky
integral of the body's acceleration is its absolute velocity. A `Filter` says the same in the coordinates of the state:
the estimate that the LQG acts on, and what the LQG would do. Fixed scales instead of running statistics: a
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


@dataclass(frozen=True)
class Filter:
    """The steady Kalman filter of `baselines.lqg`, as plain matrices, in coordinates z of about unit size.

    ``free = A z + B I``; friction f in [-1, 1] of its level holds, ``S free = K f``, or slides, one row of S and K each;
    ``z+ = x + L (y - C x - D I - F f)`` with ``x = free + G f``; y: the first signals, I: `current` among them [A].
    Then the law ``I* = law z - force tanh(rate z)`` [A], of which ``(I* - I) / slew`` within ±`reach` is told, and
    the `offset` [A] that the policy's head keeps from it, if it does.

    Where the road ahead is seen: `road` (n,), what a known rise of 1 m over the last step does to z; `law_ahead` and
    `rate_ahead` (points,), what the rises of the next steps add to the law and to its rate [1/m].
    """

    A: tuple[tuple[float, ...], ...]
    B: tuple[float, ...]
    G: tuple[tuple[float, ...], ...]
    S: tuple[tuple[float, ...], ...]
    K: tuple[tuple[float, ...], ...]
    C: tuple[tuple[float, ...], ...]
    D: tuple[float, ...]
    F: tuple[tuple[float, ...], ...]
    L: tuple[tuple[float, ...], ...]
    law: tuple[float, ...]
    rate: tuple[float, ...]
    force: float
    slew: float = 0.5
    reach: float = 2.0
    current: int = 5
    road: tuple[float, ...] = ()
    law_ahead: tuple[float, ...] = ()
    rate_ahead: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        try:
            n, nf, ny = len(self.B), len(self.K), len(self.D)
            ahead, known = len(self.law_ahead), len(self.road)
        except TypeError:
            raise InputError(
                "memory: filter's B, K, D, road and law_ahead must be lists of numbers"
            ) from None
        if not (0 < n <= STATES and nf <= STATES and ny <= SIGNALS and ahead <= SIGNALS):
            raise InputError(f"memory: filter has more than {STATES} states or {SIGNALS} signals")
        if known not in (0, n):
            raise InputError(f"memory: filter's road must have {n} numbers or none, not {known}")
        shapes = dict(
            A=(n, n), B=(n,), G=(n, nf), S=(nf, n), K=(nf, nf), C=(ny, n), D=(ny,), F=(ny, nf), L=(n, ny)
        )
        views = dict(road=(known,), law_ahead=(ahead,), rate_ahead=(ahead,))
        for name, shape in (shapes | dict(law=(n,), rate=(n,)) | views).items():
            try:
                value = np.array(getattr(self, name), float)
            except (TypeError, ValueError, OverflowError):
                raise InputError(f"memory: filter's {name} is not a matrix") from None
            if not (value.shape == shape or value.size == math.prod(shape) == 0):
                raise InputError(f"memory: filter's {name} must have shape {shape}, not {value.shape}")
            if not (np.abs(value) <= LARGEST).all():
                raise InputError(f"memory: filter's {name} must be finite, at most {LARGEST:g}")
        for name in ("force", "slew", "reach"):
            size = number(getattr(self, name), f"memory: filter's {name}")
            if not (abs(size) <= LARGEST and (name == "force" or size > 0)):
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

    @property
    def width(self) -> int:
        """Number of features: the estimate, the friction, the law, the offset from it."""
        return len(self.B) + len(self.K) + 2

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Filter:
        return cls(**{k: tuples(v) for k, v in data.items()})


def tuples(value: Any) -> Any:
    return tuple(tuples(v) for v in value) if isinstance(value, list | tuple) else value


@dataclass(frozen=True)
class Memory:
    """How features are made of observations.

    scale: of each signal [its SI unit]. change: of its change over one control step; changes of order 1 to `order` are
    fed, each over it. leak: signal index -> (time constant [s], scale) of leaky integrals.
    ahead: points of the road ahead that follow the signals in an observation, one a control step; their rises are fed over
    `rise` [m]. filter: an estimate fed besides. step: control step [s]. No scale means that the signals pass unchanged.
    """

    scale: tuple[float, ...] = ()
    change: tuple[float, ...] = ()
    order: int = 0
    leak: tuple[tuple[int, float, float], ...] = ()
    step: float = 5e-3
    filter: Filter | None = None
    ahead: int = 0
    rise: float = 1.4e-3  # RMS of the paper's road over a control step

    def __post_init__(self) -> None:
        if not 0 <= self.order <= ORDERS:
            raise InputError(f"memory: order must be 0 to {ORDERS}, not {shown(self.order)}")
        if max(len(self.scale), len(self.change), len(self.leak)) > SIGNALS:
            raise InputError(f"memory: more than {SIGNALS} signals or leaks")
        if not 0 <= self.ahead <= SIGNALS or not 1 / LARGEST < self.rise < LARGEST:
            raise InputError(f"memory: ahead must be 0 to {SIGNALS} points and rise > 0")
        if self.filter and len(self.filter.law_ahead) > self.ahead:
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
        return len(self.leak) + self.ahead + (self.filter.width if self.filter else 0)

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
        self._road = slice(first, first + memory.ahead)  # columns of the rises
        self._rise = np.float32(memory.rise)
        self.filter = _Filter(memory.filter, count) if memory.filter else None
        self.begin(np.ones(count, bool), observations)

    def begin(self, which: np.ndarray, observations: np.ndarray) -> None:
        """Forget the cars `which` (mask): they start anew at `observations` (count, signals)."""
        f, n = self.features, self._signals
        f[which] = 0.0
        f[which, :n] = observations[which, :n] / self.scale
        if self.memory.ahead:
            f[which, self._road] = self._rises(observations[which])
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
        if self.memory.ahead:
            risen = f[:, self._road.start].copy() * self._rise
            f[:, self._road] = self._rises(observations)
            ahead = f[:, self._road]
        if self.filter:
            self.filter.see(f[:, -self.filter.width :], observations, risen, ahead, self._rise)
        return f


class _Filter:
    """The arithmetic of `Filter`, on rows of its features."""

    def __init__(self, given: Filter, count: int) -> None:
        #: what the law commands [A] (count, 1)
        self.wanted = np.zeros((count, 1), np.float32)

        def array(name: str, *shape: int) -> np.ndarray:
            return np.array(getattr(given, name), float).reshape(shape)

        n, nf, ny = len(given.B), len(given.K), len(given.D)
        L, C, S = array("L", n, ny), array("C", ny, n), array("S", nf, n)
        self.width, self.n, self.nf, self.ny = given.width, n, nf, ny
        self.given = given
        # rows: estimate and current; then friction; then signals
        predict = np.vstack([array("A", n, n).T, array("B", 1, n)])
        correct = np.eye(n) - L @ C
        K = array("K", nf, nf)
        self.stick = (predict @ S.T / np.diag(K)).astype(np.float32)
        self.others = (K / np.diag(K)[:, None] - np.eye(nf)).T.astype(np.float32)
        self.free = np.vstack([predict[:n] @ correct.T, predict[n:] @ correct.T - (L @ array("D", ny))[None]])
        self.free = self.free.astype(np.float32)
        self.force = (array("G", n, nf).T @ correct.T - (L @ array("F", ny, nf)).T).astype(np.float32)
        self.gain = L.T.astype(np.float32)
        self.rows = np.stack([array("law", n), array("rate", n)], axis=1).astype(np.float32)
        # the road: how a rise moves the rate at which a friction would slide, and the estimate; and the law ahead
        road = array("road", n) if given.road else np.zeros(n)
        self.road_stick = (S @ road / np.diag(K)).astype(np.float32)
        self.road = (correct @ road).astype(np.float32)
        self.ahead = np.stack([given.law_ahead, given.rate_ahead], axis=1).astype(np.float32)

    def see(
        self,
        features: np.ndarray,
        observations: np.ndarray,
        risen: np.ndarray | None = None,
        ahead: np.ndarray | None = None,
        rise: np.float32 | float = 1.0,
    ) -> None:
        """Take in observations; `risen` (count,) [m]: of the road over the last step, `ahead` (count, points): over `rise`."""
        n, given = self.n, self.given
        current = observations[:, given.current : given.current + 1]
        now = np.concatenate([features[:, :n], current], axis=1)
        rest = now @ self.stick
        if risen is not None and given.road:
            rest += risen[:, None] * self.road_stick
        friction = np.clip(rest, -1.0, 1.0)
        for _ in range(2 if self.nf > 1 else 0):
            for j in range(self.nf):
                friction[:, j] = np.clip(rest[:, j] - friction @ self.others[:, j], -1.0, 1.0)
        z = now @ self.free + friction @ self.force + observations[:, : self.ny] @ self.gain
        if risen is not None and given.road:
            z += risen[:, None] * self.road
        features[:, :n] = z
        features[:, n:-2] = friction
        rows = z @ self.rows
        if ahead is not None and len(self.ahead):
            rows += ahead[:, : len(self.ahead)] @ self.ahead * np.float32(rise)
        self.wanted = rows[:, :1] - np.float32(given.force) * np.tanh(rows[:, 1:])
        share = (self.wanted - current) / np.float32(given.slew)
        features[:, -2:-1] = np.clip(share, -given.reach, given.reach)
