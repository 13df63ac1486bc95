"""LQG: the linear-quadratic regulator on a Kalman estimate, its current shifted past the friction."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from isd_gym.batch import state_channels
from isd_gym.cost import StageCost

from .controller import BatchController, rises, steps_ahead
from .estimator import Estimator
from .model import (
    ROAD_INTENSITY,
    Sensors,
    Weights,
    device_reach,
    prediction_model,
    preview_regulator,
)

if TYPE_CHECKING:
    from isd_gym.network import Network

STEEPEST = 0.1  # [m] that a road rises in a control step at most


@dataclass(frozen=True)
class LawSettings:
    """effort [1/A^2], tyre_load [-], centring [-]: weights beside the stage cost. compensation [-]: share of the friction
    made up for. lead [s], foresight [s]: how far ahead the law and the sign of the device's rate are read, for the
    drive slews. width [m/s]: the sign is smoothed below it.

    sensors: how well the estimate takes them to measure. road_intensity [m^2/s]: of the road's velocity, two-
    sided.
    """

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


@dataclass(frozen=True)
class LqgSettings(LawSettings):
    """preview [s]: road ahead that is seen and planned with.

    Those of `LawSettings`: effort, tyre_load, centring, compensation, lead, foresight, width, friction_noise, sensors,
    road_intensity.
    """

    preview: float = 0.0


class Lqg(BatchController):
    """``I = -K x`` of the frictionless car, plus friction over thrust constant in the direction the device shall move.

    model: the network it believes in, whatever the plant is. cost: what it minimises. control_step [s]. settings:
    its own, the defaults without. name: under which it is scored.
    """

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
        self.preview = s.preview
        self._points = steps_ahead(s.preview, control_step)
        if self._points:
            self.observation = "preview"
        if m.thrust == 0.0:
            self._law = self._rate = np.zeros(m.n)
            self._law_ahead = self._rate_ahead = np.zeros(self._points)
            self._force = 0.0
        else:
            K, G = preview_regulator(m, self.weights, self._points)
            at, by = self._ahead(K, G, s.lead / control_step)
            self._law, self._law_ahead = -K @ at, -K @ by - _later(G, s.lead / control_step)
            at, by = self._ahead(K, G, s.foresight / control_step)
            self._rate, self._rate_ahead = m.motor_rate @ at, m.motor_rate @ by
            self._force = s.compensation * sum(m.levels()) / m.thrust
        self.reset()

    def _ahead(self, K: np.ndarray, G: np.ndarray, steps: float) -> tuple[np.ndarray, np.ndarray]:
        """The state `steps` later in the closed loop, of the state (n, n) and the rises of the road (n, points) now."""
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
        self._rises = np.clip(
            seen, -STEEPEST, STEEPEST
        )  # a sensor that talks nonsense is not believed for ever
        return self.law(self.estimator.update(obs, last), self._rises)

    def law(self, x: np.ndarray, ahead: np.ndarray | None = None) -> np.ndarray:
        """Wanted current (cars,) for states (n, cars) and rises of the road ahead (points, cars) [m]."""
        wanted, rate = self._law @ x, self._rate @ x
        if ahead is not None:
            wanted, rate = wanted + self._law_ahead @ ahead, rate + self._rate_ahead @ ahead
        return wanted - self._force * np.tanh(rate / self.settings.width)


class FullStateLqr(Lqg):
    """The same law on the true state (``observation="full"``): what the estimate costs, and the bar for the MPC.

    model, cost: as those of `Lqg`.
    """

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


def _later(G: np.ndarray, steps: float) -> np.ndarray:
    """Weights of the rises as they will be `steps` later, as weights of those that are ahead now."""
    low, part = int(steps), steps - int(steps)

    def shifted(by: int) -> np.ndarray:
        return np.concatenate([np.zeros(min(by, len(G))), G[: max(len(G) - by, 0)]])

    return (1 - part) * shifted(low) + part * shifted(low + 1)
