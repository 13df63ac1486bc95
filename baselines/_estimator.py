"""State estimate of LQG and both predictive controllers: a steady Kalman filter with dry friction."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from isd_gym.physics.prediction import Model, Sensors, kalman_gain

from .controller import CURRENT

if TYPE_CHECKING:
    from isd_gym.physics.car_prediction import CarModel


class Estimator:
    """Steady Kalman filter of the state above the road for many cars, with friction as a known force.

    The friction in the prediction is the projected force at the estimate (it holds, or resists with its
    level); the road is white velocity. The measurements correct both. `friction_noise` is the standard
    deviation of the model's friction per step [N], `noise` an additional covariance of the state per step
    (n, n). `x` (n, cars) is the estimate, `f` (laws, cars) the friction of the prediction [N].
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
            (
                friction_noise**2 * np.outer(model.G[:, j], model.G[:, j])
                for j in model.friction
            ),
            np.zeros((model.n, model.n)) if noise is None else noise,
        )
        if isinstance(model, Model):
            self.gain = kalman_gain(model, sensors, noise)
            self._currents = slice(CURRENT, CURRENT + 1)
        else:
            self.gain = model.kalman_gain(sensors, noise)
            self._currents = model.current_places
        self._measured = self.gain.shape[1]
        self._inputs, self._feedthrough = (
            model.inputs,
            model.feedthrough[: self._measured],
        )
        self.levels = model.levels()
        self._dry = model.friction
        # rate of a law at the end of the step per force
        self._implicit = model.S @ model.G + model.SF
        self.reset(1)

    def reset(self, count: int) -> None:
        """Clear the memory, and start cars at rest."""
        self.x = np.zeros((self.model.n, count))
        self.f = np.zeros((len(self.model.laws), count))

    def friction(self, x_free: np.ndarray) -> np.ndarray:
        """Return the friction (laws, cars) [N] that holds or resists at the end of a step, from the state without friction."""
        f = np.zeros_like(self.f)
        free = self.model.S @ x_free
        for _ in range(3 if len(self._dry) > 1 else 1):
            for j in self._dry:
                rest = free[j] + self._implicit[j] @ f - self._implicit[j, j] * f[j]
                f[j] = np.minimum(
                    np.maximum(rest / -self._implicit[j, j], -self.levels[j]),
                    self.levels[j],
                )
        return f

    def update(self, obs: np.ndarray, road: np.ndarray | None = None) -> np.ndarray:
        """Return the estimate (n, cars) after a step; `road` (cars,) [m] is the rise of the road over the step, None if unknown."""
        m, measured = self.model, self._measured
        currents = obs[self._currents]
        free = m.A @ self.x + self._inputs @ currents
        if road is not None:
            assert isinstance(m, Model)
            free += m.P[:, None] * road
        self.f = self.friction(free)
        x = free + m.G @ self.f
        seen = (
            m.C[:measured] @ x + self._feedthrough @ currents + m.F[:measured] @ self.f
        )
        self.x = x + self.gain @ (obs[:measured] - seen)
        return self.x
