"""LQG: the linear-quadratic regulator on a Kalman estimate, its current shifted past the friction."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from isd_gym.batch import state_channels
from isd_gym.cost import StageCost
from isd_gym.network import Network

from .controller import BatchController
from .estimator import Estimator
from .model import (
    ROAD_INTENSITY,
    Sensors,
    Weights,
    device_reach,
    prediction_model,
    regulator,
)


@dataclass(frozen=True)
class LqgSettings:
    """effort [1/A^2], tyre_load [-], centring [-]: weights beside the stage cost. compensation [-]: share of the friction
    made up for. lead [s], foresight [s]: how far ahead the law and the sign of the device's rate are read, for the
    drive slews. width [m/s]: the sign is smoothed below it."""

    effort: float = 0.01
    tyre_load: float = 0.0
    centring: float = 0.03
    compensation: float = 1.0
    lead: float = 0.01
    foresight: float = 0.025
    width: float = 0.02
    friction_noise: float = 300.0  # N, per step: how little the estimate trusts its friction
    sensors: Sensors = field(default_factory=Sensors)
    road_intensity: float = ROAD_INTENSITY


class Lqg(BatchController):
    """``I = -K x`` of the frictionless car, plus friction over thrust constant in the direction the device shall move."""

    def __init__(
        self,
        model: Network,
        cost: StageCost | None = None,
        control_step: float = 5e-3,
        settings: LqgSettings | None = None,
        name: str = "lqg",
    ) -> None:
        super().__init__(name, model)
        self.settings = s = settings or LqgSettings()
        cost = cost or StageCost()
        self.prediction = m = prediction_model(model, control_step, road_intensity=s.road_intensity)
        self.weights = Weights(
            replace(cost, tyre_load=cost.tyre_load + s.tyre_load),
            effort=s.effort,
            centring=s.centring,
            reach=device_reach(model),
        )
        self.estimator = Estimator(m, s.sensors, s.friction_noise)
        if m.thrust == 0.0:
            self._law = self._rate = np.zeros(m.n)
            self._force = 0.0
        else:
            K, _ = regulator(m, self.weights)
            loop = m.A - np.outer(m.B, K)
            ahead = lambda t: _power(loop, t / control_step)  # noqa: E731
            self._law = -K @ ahead(s.lead)
            self._rate = m.motor_rate @ ahead(s.foresight)
            self._force = s.compensation * sum(m.levels()) / m.thrust
        self.reset()

    def _start(self, count: int) -> None:
        self.estimator.reset(count)

    def _command(self, obs: np.ndarray) -> np.ndarray:
        x = self.estimator.update(obs)
        return self.law(x)

    def law(self, x: np.ndarray) -> np.ndarray:
        """Wanted current (cars,) for states (n, cars)."""
        return self._law @ x - self._force * np.tanh(self._rate @ x / self.settings.width)


class FullStateLqr(Lqg):
    """The same law on the true state (``observation="full"``): what the estimate costs, and the bar for the MPC."""

    observation = "full"

    def __init__(self, model: Network, cost: StageCost | None = None, *args: Any, **options: Any) -> None:
        options.setdefault("name", "lqr-full")
        super().__init__(model, cost, *args, **options)
        m = self.prediction
        heights = [i for i, c in enumerate(state_channels(model)) if c.quantity == "displacement"]
        speeds = [
            i
            for i, c in enumerate(state_channels(model))
            if c.quantity == "velocity" and c.at in model.masses
        ]
        # velocities of massless nodes depend on forces, not on the state alone: the device's rate stands for them
        self._places = [1, 2, 3, 4, *(6 + i for i in heights), *(6 + i for i in speeds)]
        self._state = np.linalg.pinv(np.vstack([m.C[1:5], m.nodes[heights], m.nodes[speeds]]))

    def _command(self, obs: np.ndarray) -> np.ndarray:
        return self.law(self._state @ obs[self._places])


def _power(A: np.ndarray, exponent: float) -> np.ndarray:
    """A to a power that need not be whole, by interpolation between the whole ones."""
    low = int(exponent)
    part = exponent - low
    base = np.linalg.matrix_power(A, low)
    return base if part == 0.0 else (1 - part) * base + part * A @ base
