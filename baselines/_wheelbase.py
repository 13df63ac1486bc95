"""Control of a whole car with the rear road known from the front: LQG with a delay line, and predictive control.

The front axle meets the road before the rear axle, wheelbase / speed earlier. No sensor measures the road; an
estimator whose state includes the delay line of `car_model` infers the road from the motion of the front
wheels.

References:
    R. S. Sharp and C. Pilbeam, "On the ride comfort benefits available from road preview with slow-active car
    suspensions",
    Vehicle System Dynamics 23 (supplement), 1994.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from isd_gym._common.errors import InputError
from isd_gym.physics.car_prediction import (
    CarModel,
    CarWeights,
    car_model,
    car_regulator,
)
from isd_gym.physics.cost import StageCost
from isd_gym.physics.prediction import DESIGN_SPEED, prediction_model

from ._decentralised import Decentralised
from ._estimator import Estimator
from .controller import DesignedController, clean
from .friction import FrictionMpc, FrictionMpcSettings, with_preview
from .lqg import STEEPEST, LawSettings

if TYPE_CHECKING:
    from isd_gym.physics.network import Network


@dataclass(frozen=True)
class WheelbaseSettings(LawSettings):
    """Settings of an LQG with a known rear road."""

    # J against passive on roads 1000-1007 of the half car: 0.01 -28.99 %, 0.02 -30.09, 0.03 -30.22, 0.04 -30.05
    effort: float = 0.03
    #: speed of the car [m/s], to which the intensity of the road's velocity is proportional
    speed: float = DESIGN_SPEED
    #: whether the estimator knows that the rear wheels meet the road of the front wheels
    is_known: bool = True

    def __post_init__(self) -> None:
        """Check the speed."""
        if not 0.0 < self.speed < np.inf:
            raise InputError(
                f"speed must be a positive number of m/s, not {self.speed:g}"
            )


@dataclass(frozen=True)
class WheelbaseMpcSettings(FrictionMpcSettings):
    """Settings of the planner at each corner, in addition to `FrictionMpcSettings`; the previews follow from the speed."""

    speed: float = DESIGN_SPEED  # speed of the car [m/s]


class WheelbaseLqg(DesignedController[WheelbaseSettings]):
    """The law ``I = -K x`` of the frictionless car and its delay line, plus the friction over the thrust
    constant at each corner."""

    usual = "lqg-wheelbase"
    default = WheelbaseSettings()

    def _design(self) -> None:
        s = self.settings
        self.prediction, self.estimator = m, _ = wheelbase_model(
            self.name, self.model, self.step, s
        )
        self.weights = CarWeights(self.cost, s.effort, s.centring)
        thrusts = m.thrusts
        if not np.all(thrusts):
            self._law = self._rates = np.zeros((len(thrusts), m.n))
            self._forces = np.zeros((len(thrusts), 1))
        else:
            K, _ = car_regulator(m, self.weights)
            loop = m.A - m.inputs @ K
            self._law = -K @ _later(loop, s.lead / self.step)
            self._rates = m.device_rates @ _later(loop, s.foresight / self.step)
            self._forces = (
                s.compensation * _levels(m, self.step)[:, None] / thrusts[:, None]
            )

    def _start(self, count: int) -> None:
        self.estimator.reset(count)

    def _command(self, obs: np.ndarray) -> np.ndarray:
        return self.law(self.estimator.update(obs))

    def law(self, x: np.ndarray) -> np.ndarray:
        """Return the wanted currents."""
        return self._law @ x - self._forces * np.tanh(
            self._rates @ x / self.settings.width
        )


class WheelbaseMpc(Decentralised):
    """The friction-aware MPC at each corner, with the road of the rear wheels as its preview.

    A Kalman filter of the whole car infers the road from the motion of the front wheels. Each corner plans
    for its quarter car; the feedback handles the coupling of the corners by the body.
    """

    default = WheelbaseMpcSettings()

    def __init__(
        self,
        model: Network,
        cost: StageCost | None = None,
        control_step: float = 5e-3,
        settings: WheelbaseMpcSettings | None = None,
        name: str = "mpc-wheelbase",
    ) -> None:
        """Create the planners of the corners."""
        base = settings or self.default
        own = WheelbaseSettings(
            speed=base.speed,
            sensors=base.sensors,
            friction_noise=base.friction_noise,
            road_intensity=base.road_intensity,
        )
        self.prediction, self.estimator = m, _ = wheelbase_model(
            name, model, control_step, own
        )
        car = m.car
        cost = StageCost.of(cost, car.axes, len(car.corners)).of_corner
        base = replace(base, road_intensity=m.road_intensity)
        self._ahead = [
            m.rises_ahead(car.corners.index(corner)) for corner in car.driven
        ]
        corners = []
        for corner, ahead in zip(car.driven, self._ahead, strict=True):
            known = len(ahead) * control_step
            planned = with_preview(base, known, control_step) if known else base
            corners.append(
                FrictionMpc(car.quarter_car(corner), cost, control_step, planned, name)
            )
        super().__init__(name, model, corners)

    def _start(self, count: int) -> None:
        super()._start(count)
        self.estimator.reset(count)

    def observed(self, observations: np.ndarray) -> list[np.ndarray]:
        """Return the local observations of the corners with the known road."""
        obs = clean(observations, self._last, self._bounds, self._present)
        state = self.estimator.update(obs)
        line = state[self.prediction.motion :]
        ahead = [
            np.cumsum(np.clip(rows @ line, -STEEPEST, STEEPEST), axis=0).T
            for rows in self._ahead
        ]
        seen = super().observed(observations)
        return [
            np.hstack([own, heights]) for own, heights in zip(seen, ahead, strict=True)
        ]


def wheelbase_model(
    name: str, network: Network, control_step: float, settings: WheelbaseSettings
) -> tuple[CarModel, Estimator]:
    """Return model and estimator of a car with a known rear road, at the speed of the settings."""
    m = car_model(
        network,
        control_step,
        settings.speed,
        wheelbase=settings.is_known,
        road_intensity=settings.road_intensity * settings.speed / DESIGN_SPEED,
    )
    if len(m.car.corners) == 1:
        raise InputError(
            f"'{name}' is a controller of a car with two axles, but network '{network.name}' is a quarter car: choose "
            "half-car-isd, full-car-isd or another network with a rear axle"
        )
    return m, Estimator(m, settings.sensors, settings.friction_noise)


def _levels(model: CarModel, control_step: float) -> np.ndarray:
    """Return the level of the dry friction at each driven corner [N] (currents,)."""
    quarters = (model.car.quarter_car(c) for c in model.car.driven)
    return np.array(
        [prediction_model(q, control_step).levels().sum() for q in quarters]
    )


def _later(loop: np.ndarray, steps: float) -> np.ndarray:
    """Return the matrix (n, n) that leads to the state `steps` later, between whole steps by linear interpolation."""
    low, part = int(steps), steps - int(steps)
    first = np.linalg.matrix_power(loop, low)
    return (1 - part) * first + part * (loop @ first)
