"""The estimate that LQG and both predictive controllers act on: a steady Kalman filter that knows of dry friction."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .controller import CURRENT
from .model import Model, Sensors, kalman_gain

if TYPE_CHECKING:
    from .car import CarModel


class Estimator:
    """Steady Kalman filter of the state above the road, many cars at once, friction as a known force.

    Friction enters the prediction as the projected force at the estimate (it holds or resists with its level), and the
    road as white velocity; both are corrected by what is measured.

    model: what is believed. sensors: how well it is measured. friction_noise [N]: how little the model's friction is
    trusted, per step. noise (n, n): covariance of the state per step, beyond the road's and the friction's.
    `x` (n, cars): the estimate; `f` (laws, cars) [N]: the friction it was predicted with.
    """

    def __init__(
        self,
        model: Model | CarModel,
        sensors: Sensors,
        friction_noise: float,
        noise: np.ndarray | None = None,
    ) -> None:
        self.model = model
        noise = sum(
            (friction_noise**2 * np.outer(model.G[:, j], model.G[:, j]) for j in model.friction),
            np.zeros((model.n, model.n)) if noise is None else noise,
        )
        if isinstance(model, Model):
            self.gain, self._currents = kalman_gain(model, sensors, noise), slice(CURRENT, CURRENT + 1)
        else:
            self.gain, self._currents = model.kalman_gain(sensors, noise), model.current_places
        self._measured = self.gain.shape[1]
        self._inputs, self._feedthrough = model.inputs, model.feedthrough[: self._measured]
        self.levels = model.levels()
        self._dry = model.friction
        self._implicit = model.S @ model.G + model.SF  # rate of a law at the end of the step, by its force
        self.reset(1)

    def reset(self, count: int) -> None:
        """Forget everything: `count` cars at rest."""
        self.x = np.zeros((self.model.n, count))
        self.f = np.zeros((len(self.model.laws), count))

    def friction(self, x_free: np.ndarray) -> np.ndarray:
        """Forces (nl, n) that hold or resist at the end of a step that would end at `x_free` (n, cars) without them."""
        f = np.zeros_like(self.f)
        free = self.model.S @ x_free
        for _ in range(3 if len(self._dry) > 1 else 1):
            for j in self._dry:
                rest = free[j] + self._implicit[j] @ f - self._implicit[j, j] * f[j]
                f[j] = np.minimum(np.maximum(rest / -self._implicit[j, j], -self.levels[j]), self.levels[j])
        return f

    def update(self, obs: np.ndarray, road: np.ndarray | None = None) -> np.ndarray:
        """Estimate (n, cars) after the step that ended in clean observations (6+, cars).

        `road` (cars,) [m]: how much the road rose over that step, where it is known.
        """
        m, measured = self.model, self._measured
        currents = obs[self._currents]
        free = m.A @ self.x + self._inputs @ currents
        if road is not None:
            assert isinstance(m, Model)
            free += m.P[:, None] * road
        self.f = self.friction(free)
        x = free + m.G @ self.f
        seen = m.C[:measured] @ x + self._feedthrough @ currents + m.F[:measured] @ self.f
        self.x = x + self.gain @ (obs[:measured] - seen)
        return self.x
