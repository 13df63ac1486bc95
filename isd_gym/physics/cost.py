"""The stage cost of the environment's reward, of model predictive control and of the score."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any, TypeVar

import numpy as np

from .._common.errors import InputError, shown
from .._common.inputs import is_number

__all__ = [
    "FULL_CAR",
    "HALF_CAR",
    "QUARTER_CAR",
    "StageCost",
    "square",
]


Signal = TypeVar("Signal", float, np.ndarray)
MOTIONS = ("acceleration", "pitch", "roll")
_TERMS = (*MOTIONS, "travel", "tyre_load", "current")
LARGEST = 1e12  # of weights and references, and of one over a reference


def square(weight: Any, signal: Any) -> Any:
    """Return a factor times the square of a signal, also in compiled code.

    Args:
        weight: Factor [1/unit^2].
        signal: Number or array of any shape [unit].

    Returns:
        Number or array of the shape of `signal` [-].
    """
    return weight * (signal * signal)


@dataclass(frozen=True)
class StageCost:
    """Weighted squares of signals over their reference values; the reward is minus the sum.

    The weights [-] 0.6 and 0.3 are those of section 4.2. The references are Table 7's passive row, so that a
    passive quarter car costs about 0.9.

    A half car and a full car have `HALF_CAR` and `FULL_CAR`. The weight 0.6 is shared equally by the
    accelerations of the body: 0.3 each for vertical and pitch acceleration, or 0.2 each with roll
    acceleration. The weights of travel, tyre load and current are shared equally by the corners. Each
    reference is the RMS of the signal in the passive car on the paper's road at 20 m/s; the passive car then
    costs 0.9 as well.

    References:
        Liu, Zhao, Yang, Chen, Shen, "Predictive Control of Vehicle ISD Suspension Based on a Hydraulic
            Electric Inerter", Shock and Vibration, 2019, section 4.2 and Table 7.
    """

    acceleration: float = 0.6  # weight of the vertical acceleration of the body [-]
    travel: float = 0.3  # weight of the suspension travel [-]
    tyre_load: float = 0.0  # weight of the dynamic tyre load [-]
    current: float = 0.0  # weight of the motor current [-]
    acceleration_reference: float = 0.8306  # vertical acceleration of the body [m/s^2]
    #: suspension travel [m], one value, or one per corner
    travel_reference: float | tuple[float, ...] = 7.6e-3
    #: dynamic tyre load [N], one value, or one per corner
    tyre_load_reference: float | tuple[float, ...] = 518.0
    current_reference: float = 5.0  # motor current [A]
    pitch: float = 0.0  # weight of the pitch acceleration of the body [-]
    roll: float = 0.0  # weight of the roll acceleration of the body [-]
    pitch_reference: float = 1.0  # pitch acceleration [rad/s^2]
    roll_reference: float = 1.0  # roll acceleration [rad/s^2]

    def __post_init__(self) -> None:
        for name in _TERMS:
            weight, reference = getattr(self, name), getattr(self, f"{name}_reference")
            if not (is_number(weight) and 0.0 <= weight <= LARGEST):
                raise InputError(
                    f"the weight of {name} must be from 0 to {LARGEST:g}, not {shown(weight)}"
                )
            if name in ("travel", "tyre_load") and isinstance(reference, list | tuple):
                reference = tuple(reference)
                object.__setattr__(self, f"{name}_reference", reference)
            values = reference if isinstance(reference, tuple) else (reference,)
            if not (
                values
                and all(
                    is_number(value) and 1 / LARGEST <= value <= LARGEST
                    for value in values
                )
            ):
                raise InputError(
                    f"the reference of {name} must be from {1 / LARGEST:g} to {LARGEST:g}, not {shown(reference)}"
                )

    @classmethod
    def of(
        cls,
        given: StageCost | Mapping[str, Any] | None,
        axes: tuple[str, ...] = (),
        corners: int = 1,
    ) -> StageCost:
        """Return the stage cost of a car: the given cost, or the usual cost with some attributes changed.

        Args:
            given: Stage cost, or attributes that differ from the usual cost; None for the usual cost.
            axes: Axes about which the body rotates, of 'pitch' and 'roll'.
            corners: Number of corners. A car with an unusual number of corners gets the mean of the usual
                references.

        Raises:
            InputError: An attribute does not exist, or an axis with a weight is not an axis of the body.
        """
        if not isinstance(given, StageCost):
            usual = _USUAL.get(axes, QUARTER_CAR)
            means = {
                name: float(np.mean(value))
                for name in ("travel_reference", "tyre_load_reference")
                if isinstance(value := getattr(usual, name), tuple)
                and len(value) != corners
            }
            known = [f.name for f in fields(cls)]
            for key in given or {}:
                if key not in known:
                    raise InputError(
                        f"cost: no {shown(key)}, there are {', '.join(known)}"
                    )
            given = replace(usual, **{**means, **(given or {})})
        for axis in MOTIONS[1:]:
            if getattr(given, axis) > 0.0 and axis not in axes:
                raise InputError(
                    f"cost: the body of this car does not {axis}; leave the weight of {axis} at 0"
                )
        return given

    @property
    def of_corner(self) -> StageCost:
        """Stage cost of a quarter car: the sum of the weights of vertical, pitch and roll acceleration, and the
        references of the quarter car."""
        return StageCost(
            acceleration=round(self.acceleration + self.pitch + self.roll, 12),
            travel=self.travel,
            tyre_load=self.tyre_load,
            current=self.current,
            current_reference=self.current_reference,
        )

    @cached_property
    def quadratic(self) -> tuple[float, float, float, float]:
        """Return the factors on the squares of acceleration [m/s^2], travel [m], tyre load [N] and current [A]
        of a quarter car."""
        a, l, f, i = self.factors()
        return a, l, f, i

    def factors(
        self, axes: tuple[str, ...] = (), corners: int = 1, currents: int = 1
    ) -> tuple[float, ...]:
        """Return the factors on the squares of accelerations, travels, tyre loads and currents, in this order.

        Args:
            axes: Axes about which the body turns, of 'pitch' and 'roll'.
            corners: Number of corners.
            currents: Number of currents.

        Returns:
            Factors (1 + axes + 2 corners + currents,) on the squares of vertical acceleration [m/s^2], angular
            accelerations [rad/s^2], travels [m], tyre loads [N] and currents [A].

        Raises:
            InputError: There are references for another number of corners.
        """
        out = [
            self._factor(name, getattr(self, f"{name}_reference"), 1)
            for name in (MOTIONS[0], *axes)
        ]
        for name in ("travel", "tyre_load"):
            reference = getattr(self, f"{name}_reference")
            each = reference if isinstance(reference, tuple) else (reference,) * corners
            if len(each) != corners:
                raise InputError(
                    f"cost: {name}_reference has {len(each)} values for {corners} corners; give one number, or one for each"
                )
            out += [self._factor(name, value, corners) for value in each]
        return (
            *out,
            *[self._factor("current", self.current_reference, currents)] * currents,
        )

    def _factor(self, name: str, reference: float, shared_by: int) -> float:
        return getattr(self, name) / shared_by / reference**2

    def __call__(
        self,
        acceleration: Signal,
        travel: Signal,
        tyre_load: Signal | float = 0.0,
        current: Signal | float = 0.0,
    ) -> Signal:
        """Return the cost of a quarter car.

        Args:
            acceleration: Vertical acceleration of the body [m/s^2].
            travel: Suspension travel [m].
            tyre_load: Dynamic tyre load [N].
            current: Motor current [A].

        Returns:
            Cost [-], a number or an array of the shape of the signals.
        """
        a, l, f, i = self.quadratic
        return (
            square(a, acceleration)
            + square(l, travel)
            + square(f, tyre_load)
            + square(i, current)
        )


QUARTER_CAR = StageCost()
#: references: RMS of the passive car of the network half-car-passive on the paper's road at 20 m/s, stationary
HALF_CAR = StageCost(
    acceleration=0.3,
    pitch=0.3,
    acceleration_reference=0.5903,
    pitch_reference=0.4431,
    travel_reference=(7.059e-3, 7.250e-3),
    tyre_load_reference=(515.1, 516.9),
)
#: references: the same of the network full-car-passive
FULL_CAR = StageCost(
    acceleration=0.2,
    pitch=0.2,
    roll=0.2,
    acceleration_reference=0.4878,
    pitch_reference=0.3485,
    roll_reference=0.7455,
    travel_reference=(6.983e-3, 6.983e-3, 6.924e-3, 6.924e-3),
    tyre_load_reference=(513.6, 513.6, 515.2, 515.2),
)
#: usual stage costs of cars, by the axes about which the body rotates
_USUAL: dict[tuple[str, ...], StageCost] = {
    (): QUARTER_CAR,
    ("pitch",): HALF_CAR,
    ("pitch", "roll"): FULL_CAR,
}
