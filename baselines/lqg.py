"""LQG: linear-quadratic regulator on a Kalman estimate, with a current that compensates the friction."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from isd_gym.physics.prediction import (
    ROAD_INTENSITY,
    Sensors,
    Weights,
    device_reach,
    prediction_model,
    preview_regulator,
)
from isd_gym.physics.vehicle import state_channels

from ._estimator import Estimator
from .controller import DesignedController, rises

__all__ = [
    "LqgSettings",
]


STEEPEST = 0.1  # largest rise of a road per control step [m]


@dataclass(frozen=True)
class LawSettings:
    """Settings of a linear-quadratic law with friction compensation. Weights are in addition to the stage cost."""

    effort: float = 0.01  # weight of the current [1/A^2]
    tyre_load: float = 0.0  # weight of the tyre load [-]
    centring: float = 0.03  # weight of the device's travel over its stop [-]
    compensation: float = 1.0  # compensated share of the friction [-]
    # time ahead for which the law is evaluated, since the drive slews [s]
    lead: float = 0.01
    # time ahead for which the sign of the device's rate is evaluated [s]
    foresight: float = 0.025
    width: float = 0.02  # rate below which the sign is smoothed [m/s]
    # standard deviation of the estimator's friction per step [N]
    friction_noise: float = 300.0
    #: standard deviations of the measurements in the estimator
    sensors: Sensors = field(default_factory=Sensors)
    # two-sided intensity of the road's velocity [m^2/s]
    road_intensity: float = ROAD_INTENSITY


@dataclass(frozen=True)
class LqgSettings(LawSettings):
    """Settings of the LQG, in addition to `LawSettings`."""

    preview: float = 0.0  # known road ahead [s]


class Lqg(DesignedController[LqgSettings]):
    """The law ``I = -K x`` of the frictionless car, plus friction over thrust constant in the intended direction of the device."""

    usual = "lqg"
    default = LqgSettings()

    def _design(self) -> None:
        s = self.settings
        self.prediction = m = prediction_model(
            self.model, self.step, road_intensity=s.road_intensity
        )
        self.weights = Weights(
            self.cost,
            effort=s.effort,
            centring=s.centring,
            reach=device_reach(self.model),
        )
        self.estimator = Estimator(m, s.sensors, s.friction_noise)
        if m.thrust == 0.0:
            self._law = self._rate = np.zeros(m.n)
            self._law_ahead = self._rate_ahead = np.zeros(self._points)
            self._force = 0.0
        else:
            K, G = preview_regulator(m, self.weights, self._points)
            at, by = self._ahead(K, G, s.lead / self.step)
            self._law, self._law_ahead = (
                -K @ at,
                -K @ by - _later(G, s.lead / self.step),
            )
            at, by = self._ahead(K, G, s.foresight / self.step)
            self._rate = m.motor_rate @ at
            self._rate_ahead = m.motor_rate @ by
            self._force = s.compensation * sum(m.levels()) / m.thrust

    def _ahead(
        self, K: np.ndarray, G: np.ndarray, steps: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return matrices to the state `steps` later in the closed loop, from the state (n, n) and the rises of
        the road (n, points)."""
        m, points = self.prediction, self._points
        low, part = int(steps), steps - int(steps)
        at, by = np.eye(m.n), np.zeros((m.n, points))
        out = []
        for k in range(low + 2):
            out.append((at, by))
            rise = np.zeros(points)
            rise[k : k + 1] = 1.0
            current = -K @ by - _later(G, k)
            by = m.A @ by + np.outer(m.B, current) + np.outer(m.P, rise)
            at = (m.A - np.outer(m.B, K)) @ at
        (at, by), (at1, by1) = out[low], out[low + 1]
        return (1 - part) * at + part * at1, (1 - part) * by + part * by1

    def _start(self, count: int) -> None:
        self.estimator.reset(count)
        self._rises = np.zeros((self._points, count))

    def _command(self, obs: np.ndarray) -> np.ndarray:
        if not self._points:
            return self.law(self.estimator.update(obs))
        last = self._rises[0]
        seen = np.nan_to_num(rises(obs, self._points), nan=0.0, posinf=0.0, neginf=0.0)
        # an invalid sensor value is limited
        self._rises = np.clip(seen, -STEEPEST, STEEPEST)
        return self.law(self.estimator.update(obs, last), self._rises)

    def law(self, x: np.ndarray, ahead: np.ndarray | None = None) -> np.ndarray:
        """Return the wanted currents (cars,) [A] for states (n, cars) and rises of the road `ahead` (points,
        cars) [m]."""
        wanted, rate = self._law @ x, self._rate @ x
        if ahead is not None:
            wanted = wanted + self._law_ahead @ ahead
            rate = rate + self._rate_ahead @ ahead
        return wanted - self._force * np.tanh(rate / self.settings.width)


class FullStateLqr(Lqg):
    """The law of `Lqg` on the true state (``observation="full"``): shows the cost of the estimate, and is the bar for the MPC."""

    usual = "lqr-full"
    observation = "full"

    def _design(self) -> None:
        super()._design()
        m = self.prediction
        channels = list(enumerate(state_channels(self.model)))
        heights = [i for i, c in channels if c.quantity == "displacement"]
        speeds = [
            i
            for i, c in channels
            if c.quantity == "velocity" and c.at in self.model.masses
        ]
        # velocities of massless nodes depend on forces, not only on the state: the device's rate replaces
        # them
        self._places = [1, 2, 3, 4, *(6 + i for i in heights), *(6 + i for i in speeds)]
        self._state = np.linalg.pinv(
            np.vstack([m.C[1:5], m.nodes[heights], m.nodes[speeds]])
        )

    def _command(self, obs: np.ndarray) -> np.ndarray:
        return self.law(self._state @ obs[self._places])


def _later(G: np.ndarray, steps: float) -> np.ndarray:
    """Return weights of the present rises that are equivalent to weights of the rises `steps` later."""
    low, part = int(steps), steps - int(steps)

    def shifted(by: int) -> np.ndarray:
        return np.concatenate([np.zeros(min(by, len(G))), G[: max(len(G) - by, 0)]])

    return (1 - part) * shifted(low) + part * shifted(low + 1)
