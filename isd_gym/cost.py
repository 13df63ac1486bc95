"""The one stage cost: the environment's reward, MPC's objective and the score are all this."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, TypeVar

import numpy as np

from .errors import InputError

Signal = TypeVar("Signal", float, np.ndarray)


def squares(
    by_a: Any, by_l: Any, by_f: Any, by_i: Any, a: Any, l: Any, f: Any, i: Any
) -> tuple[Any, Any, Any, Any]:
    """The terms of the cost, of floats or arrays, and in compiled code: factors times the squares of acceleration, travel, tyre load and current.

    by_a [s^4/m^2], by_l [1/m^2], by_f [1/N^2], by_i [1/A^2]: the factors, `StageCost.quadratic`'s. a: acceleration
    [m/s^2]; l: travel [m]; f: tyre load [N]; i: current [A].
    """
    return by_a * (a * a), by_l * (l * l), by_f * (f * f), by_i * (i * i)


@dataclass(frozen=True)
class StageCost:
    """Weighted squares of signals over their reference values; the reward is minus the sum.

    Weights [-] 0.6 and 0.3 are section 4.2's; references are Table 7's passive row, so a passive car costs about 0.9.

    acceleration, travel, tyre_load, current [-]: the weights.
    """

    acceleration: float = 0.6
    travel: float = 0.3
    tyre_load: float = 0.0
    current: float = 0.0
    acceleration_reference: float = 0.8306  # m/s^2
    travel_reference: float = 7.6e-3  # m
    tyre_load_reference: float = 518.0  # N
    current_reference: float = 5.0  # A

    def __post_init__(self) -> None:
        for name in ("acceleration", "travel", "tyre_load", "current"):
            if not getattr(self, name) >= 0.0:
                raise InputError(f"the weight of {name} must be >= 0, not {getattr(self, name)!r}")
            if not getattr(self, f"{name}_reference") > 0.0:
                raise InputError(f"the reference of {name} must be > 0")

    @cached_property
    def quadratic(self) -> tuple[float, float, float, float]:
        """Factors on the squares of acceleration [m/s^2], travel [m], tyre load [N] and current [A]."""
        return (
            self.acceleration / self.acceleration_reference**2,
            self.travel / self.travel_reference**2,
            self.tyre_load / self.tyre_load_reference**2,
            self.current / self.current_reference**2,
        )

    def terms(
        self,
        acceleration: Signal,
        travel: Signal,
        tyre_load: Signal | float = 0.0,
        current: Signal | float = 0.0,
    ) -> tuple[Signal, Signal, Signal | float, Signal | float]:
        """The four terms of the cost, of floats or arrays.

        acceleration [m/s^2], travel [m], tyre_load [N], current [A].
        """
        return squares(*self.quadratic, acceleration, travel, tyre_load, current)

    def __call__(
        self,
        acceleration: Signal,
        travel: Signal,
        tyre_load: Signal | float = 0.0,
        current: Signal | float = 0.0,
    ) -> Signal:
        """The cost: the sum of the terms."""
        a, l, f, i = self.terms(acceleration, travel, tyre_load, current)
        return a + l + f + i
