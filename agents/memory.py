"""What a policy sees: measured signals, their latest changes and leaky integrals, each over a fixed physical scale.

One observation is not the state of the car. Changes over the last steps carry what the sensors do not measure (the
tyre's force follows from the balance of forces, the oil's deflection from the body's acceleration), and the leaky
integral of the body's acceleration is its absolute velocity. Fixed scales instead of running statistics: a
policy means the same thing in training, in a checkpoint and in a car. Numpy alone, float32, one row a car.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from isd_gym.errors import InputError


@dataclass(frozen=True)
class Memory:
    """How features are made of observations.

    scale: of each signal [its SI unit]. change: of its change over one control step; changes of order 1 to `order` are
    fed, each over it. leak: signal index -> (time constant [s], scale) of leaky integrals.
    step: control step [s]. No scale means that the signals pass unchanged.
    """

    scale: tuple[float, ...] = ()
    change: tuple[float, ...] = ()
    order: int = 0
    leak: tuple[tuple[int, float, float], ...] = ()
    step: float = 5e-3

    def __post_init__(self) -> None:
        if self.order < 0 or (self.order > 0 and len(self.change) != len(self.scale)):
            raise InputError("memory: change needs one scale for each signal")
        if any(not s > 0 for s in (*self.scale, *self.change)):
            raise InputError("memory: scales must be > 0")
        for signal, tau, scale in self.leak:
            if not (0 <= signal < len(self.scale) and tau > self.step and scale > 0):
                raise InputError(f"memory: leak ({signal}, {tau}, {scale}) is not (signal, seconds, scale)")

    def width(self, signals: int) -> int:
        """Number of features of `signals` measured signals."""
        if self.scale and signals != len(self.scale):
            raise InputError(f"memory: made for {len(self.scale)} signals, the observation has {signals}")
        return signals * (1 + self.order) + len(self.leak)

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
            )
        except (TypeError, ValueError, AttributeError) as error:
            raise InputError(f"memory: {error}") from None

    def start(self, observations: np.ndarray) -> Recall:
        """Memory of cars that begin now, at `observations` (count, signals)."""
        return Recall(self, observations)


class Recall:
    """The memory of `count` cars: `features` (count, width) float32 of what was seen so far."""

    def __init__(self, memory: Memory, observations: np.ndarray) -> None:
        self.memory = memory
        count, signals = observations.shape
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
        self.begin(np.ones(count, bool), observations)

    def begin(self, which: np.ndarray, observations: np.ndarray) -> None:
        """Forget the cars `which` (mask): they start anew at `observations` (count, signals)."""
        f, n = self.features, self._signals
        f[which] = 0.0
        f[which, :n] = observations[which] / self.scale

    def see(self, observations: np.ndarray) -> np.ndarray:
        """Take in the next observations (count, signals); returns `features`, valid until the next call."""
        f, n = self.features, self._signals
        new: np.ndarray = observations / self.scale
        for k, ratio in enumerate(self.ratios):
            old = f[:, n * k : n * (k + 1)].copy()
            f[:, n * k : n * (k + 1)] = new
            new = (new - old) * ratio
        f[:, n * self.memory.order : n * (self.memory.order + 1)] = new
        for j, (i, keep, gain) in enumerate(self.leaks, n * (self.memory.order + 1)):
            f[:, j] = f[:, j] * keep + observations[:, i] * gain
        return f
