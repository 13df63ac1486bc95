"""Six published laws for semi-active dampers, as controllers of `quarter-car-semiactive`.

isd-gym score benchmarks/paper_laws.py:{TwoStateSkyhook,LinearSkyhook,RelativeControl,AccelerationDriven,PowerDriven,SkyhookAdd}
    --track semiactive-c --json benchmarks/entries/semiactive-c-paper-laws.json

The laws have no gains of their own but the limits of the damper, which are the car's, and the crossover of SH-ADD. The
velocity of the body is the integral of the acceleration behind a high pass, as in the baseline `skyhook`.

References:
    Karnopp, Crosby, Harwood, Journal of Engineering for Industry 96 (1974), 619: skyhook.
    Rakheja, Sankar, Journal of Vibration, Acoustics, Stress, and Reliability in Design 107 (1985), 398: relative control.
    Sammier, Sename, Dugard, Vehicle System Dynamics 39 (2003), 279: linear skyhook.
    Savaresi, Silani, Bittanti, Journal of Dynamic Systems, Measurement, and Control 127 (2005), 218: ADD.
    Savaresi, Spelta, Journal of Dynamic Systems, Measurement, and Control 129 (2007), 382: SH-ADD.
    Morselli, Zanasi, Mechatronics 18 (2008), 364: power-driven damper.
    Poussot-Vassal, Spelta, Sename, Savaresi, Dugard, Annual Reviews in Control 36 (2012), 148: comparison.
"""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np

LOW, HIGH, LIMIT = 300.0, 2700.0, 2.0  # damping [N s/m] at -LIMIT and LIMIT [A]
SPRING, BODY = 22000.0, 345.0  # main spring [N/m] and mass of the body [kg]
STEP, FORGET = (
    5e-3,
    0.95,
)  # control step [s], high pass of the integrated acceleration [1/s]


class Law(ABC):
    """A damping for each observation, carried out as a current."""

    @property
    def name(self) -> str:
        return type(self).__name__

    def reset(self) -> None:
        self.reset_batch(1)

    def reset_batch(self, count: int) -> None:
        self.velocity = np.zeros(count)  # of the body [m/s]

    def act(self, observation: np.ndarray) -> float:
        return float(self.act_batch(np.asarray(observation)[None])[0])

    def act_batch(self, observations: np.ndarray) -> np.ndarray:
        acceleration, travel, rate = np.asarray(observations, float).T[:3]
        self.velocity = (self.velocity + STEP * acceleration) * (1.0 - FORGET * STEP)
        damping = np.clip(self.damping(acceleration, travel, rate), LOW, HIGH)
        return LIMIT * (2.0 * (damping - LOW) / (HIGH - LOW) - 1.0)

    @abstractmethod
    def damping(
        self, acceleration: np.ndarray, travel: np.ndarray, rate: np.ndarray
    ) -> np.ndarray:
        """Return the damping [N s/m]; the damper limits it."""


class TwoStateSkyhook(Law):
    def damping(
        self, acceleration: np.ndarray, travel: np.ndarray, rate: np.ndarray
    ) -> np.ndarray:
        return np.where(self.velocity * rate >= 0.0, HIGH, LOW)


class LinearSkyhook(Law):
    def damping(
        self, acceleration: np.ndarray, travel: np.ndarray, rate: np.ndarray
    ) -> np.ndarray:
        return HIGH * self.velocity * rate / np.maximum(rate**2, 1e-12)


class RelativeControl(Law):
    def damping(
        self, acceleration: np.ndarray, travel: np.ndarray, rate: np.ndarray
    ) -> np.ndarray:
        return np.where(travel * rate <= 0.0, HIGH, LOW)


class AccelerationDriven(Law):
    def damping(
        self, acceleration: np.ndarray, travel: np.ndarray, rate: np.ndarray
    ) -> np.ndarray:
        return np.where(acceleration * rate >= 0.0, HIGH, LOW)


class PowerDriven(Law):
    def damping(
        self, acceleration: np.ndarray, travel: np.ndarray, rate: np.ndarray
    ) -> np.ndarray:
        return -SPRING * travel * rate / np.maximum(rate**2, 1e-12)


class SkyhookAdd(Law):
    #: crossover of skyhook and ADD [rad/s], at the invariant point of the body's resonance
    crossover = np.sqrt(2.0 * SPRING / BODY)

    def damping(
        self, acceleration: np.ndarray, travel: np.ndarray, rate: np.ndarray
    ) -> np.ndarray:
        slow = acceleration**2 <= (self.crossover * self.velocity) ** 2
        return np.where(
            np.where(slow, self.velocity, acceleration) * rate > 0.0, HIGH, LOW
        )
