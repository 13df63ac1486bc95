"""Skyhook and acceleration-driven damping.

Both laws define the force F of the strut, which is all between body and wheel but the main spring. The motor
gives this force less the forces of the passive elements of the strut.

A motor in series with a damper c cannot set the force: the strut has the force F when the device runs at
``w = travel rate - F / c``. An inner loop drives the device at this rate by inverse dynamics,

    K I = F_now - k d - c_p w_now - f sgn(w) - b (w - w_now) / tau,

with F_now from the measured body acceleration, and b, c_p, k, f of the elements parallel to the motor. Without a
damper in series, w is the travel rate, and F replaces F_now.
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from isd_gym.physics import elements as el
from isd_gym.physics.prediction import SLIDING
from isd_gym.physics.vehicle import require_quarter_car

from .controller import DesignedController

if TYPE_CHECKING:
    from isd_gym.physics.network import Network


@dataclass(frozen=True)
class Strut:
    """The strut of a car: all elements between body and wheel but the main spring, with the motor among them."""

    body_mass: float  # mass of the body [kg]
    spring: float  # stiffness of the main spring, between body and wheel [N/m]
    beside: float  # damping between body and wheel that is not parallel to the motor [N s/m]
    thrust: float = 0.0  # thrust constant at the terminals [N/A]; 0 without a motor
    # stiffness parallel to the motor, without the main spring [N/m]
    stiffness: float = 0.0
    damping: float = 0.0  # damping parallel to the motor [N s/m]
    inertance: float = 0.0  # inertance parallel to the motor [kg]
    friction: float = 0.0  # friction parallel to the motor [N]
    # damping in series with the motor [N s/m]; infinite without a damper
    series: float = np.inf

    @classmethod
    def of(cls, network: Network) -> Strut:
        """Return the strut of a car."""
        require_quarter_car(network, "the strut is that")
        body, wheel = list(network.masses)[:2]
        between = [e for e in network.elements if e.place == "between"]
        main = [e for e in between if set(e.between) == {body, wheel}]
        spring = sum(e.linear()[0] for e in main)
        motor = next((e for e in between if isinstance(e, el.Motor)), None)
        if motor is None:
            return cls(network.masses[body], spring, sum(e.linear()[1] for e in main))
        parallel = [e for e in between if set(e.between) == set(motor.between)]
        k, c, b = np.sum([e.linear() for e in parallel], axis=0)
        level = sum(
            e.bound(np.array(e.law_parameters()), 0.0, SLIDING)
            for e in parallel
            if e.bound is not None
        )
        joints = set(motor.between) - {body, wheel}
        series = [
            e.linear()[1]
            for e in between
            if e not in parallel and e.linear()[1] > 0 and joints & set(e.between)
        ]
        return cls(
            body_mass=network.masses[body],
            spring=spring,
            beside=sum(e.linear()[1] for e in main if e not in parallel),
            thrust=motor.thrust_constant * motor.ratio,
            stiffness=float(k) - spring if motor in main else float(k),
            damping=float(c),
            inertance=float(b),
            friction=float(level),
            series=series[0] if series else np.inf,
        )


@dataclass(frozen=True)
class StrutSettings:
    """Settings of skyhook and acceleration-driven damping (ADD)."""

    body: float  # skyhook damping, or difference of the two dampings of ADD [N s/m]
    travel: float  # damping on the suspension's rate [N s/m]
    forget: float = 0.5  # high pass of the integrated acceleration [1/s]
    tau: float = 0.02  # time constant of the inner loop [s]
    width: float = 0.02  # rate below which the sign of the friction is smoothed [m/s]
    #: product of acceleration and rate below which the switch of ADD is smoothed [m^2/s^3]
    softness: float = 0.02


class ForceControl(DesignedController[StrutSettings]):
    """The inner loop; subclasses define the force of the strut. The stage cost has no effect."""

    def _design(self) -> None:
        self.strut = Strut.of(self.model)

    def _start(self, count: int) -> None:
        self.velocity = np.zeros(count)  # high-passed velocity of the body [m/s]

    def _command(self, obs: np.ndarray) -> np.ndarray:
        s, z = self.strut, self.settings
        acceleration, travel, rate, device, device_rate = obs[:5]
        self.velocity = (self.velocity + self.step * acceleration) * (
            1.0 - z.forget * self.step
        )
        if s.thrust == 0.0:
            return np.zeros(obs.shape[1])
        wanted = self.force(acceleration, rate) - s.beside * rate
        goal = rate - wanted / s.series
        # the damper in series sets the force, and the motor the rate of the device
        if np.isfinite(s.series):
            carried = -s.body_mass * acceleration - s.spring * travel - s.beside * rate
        else:
            carried = wanted
        thrust = (
            carried
            - s.stiffness * device
            - s.damping * device_rate
            - s.friction * np.tanh(goal / z.width)
            - s.inertance * (goal - device_rate) / z.tau
        )
        return thrust / s.thrust

    @abstractmethod
    def force(self, acceleration: np.ndarray, rate: np.ndarray) -> np.ndarray:
        """Return the wanted force of the strut, positive in tension."""


class Skyhook(ForceControl):
    """Skyhook damping F = c_body v_body + c_travel (v_body - v_wheel): a damper to the sky, and a damper to
    the wheel (Karnopp, Crosby and Harwood, Journal of Engineering for Industry, 1974)."""

    usual = "skyhook"
    default = StrutSettings(
        body=2500.0, travel=1100.0, forget=0.95, tau=0.006, width=0.012
    )

    def force(self, acceleration: np.ndarray, rate: np.ndarray) -> np.ndarray:
        return self.settings.body * self.velocity + self.settings.travel * rate


class AccelerationDriven(ForceControl):
    """Acceleration-driven damping: firm while body acceleration and travel rate have the same sign, soft
    otherwise (Savaresi, Silani and Bittanti, Journal of Dynamic Systems, Measurement, and Control, 2005)."""

    usual = "add"
    default = StrutSettings(
        body=2600.0, travel=2300.0, forget=0.1, tau=0.0016, width=0.012, softness=0.06
    )

    def force(self, acceleration: np.ndarray, rate: np.ndarray) -> np.ndarray:
        z = self.settings
        return (
            z.travel + 0.5 * z.body * np.tanh(acceleration * rate / z.softness)
        ) * rate
