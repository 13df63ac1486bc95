"""Clipped control of a semi-active damper.

A controller of the active car, with a force in place of the variable part of the damping, commands the force.
The current of the damper is the one whose damping force is nearest.

References:
    Karnopp, Crosby and Harwood, "Vibration control using semi-active force generators", Journal of Engineering
        for Industry 96, 1974.
    Tseng and Hedrick, "Semi-active control laws - optimal and sub-optimal", Vehicle System Dynamics 23, 1994.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from isd_gym.physics import elements as el

from .controller import CURRENT, BatchController

if TYPE_CHECKING:
    from collections.abc import Callable

    from isd_gym.physics.network import Network

_THRUST = 1000.0  # thrust constant of the imagined actuator [N/A]
_DEVICE_RATE = 4  # index of the damper's rate in the observation of a quarter car
_SLOW = 0.01  # rate below which the division by the rate is smoothed [m/s]


def controlled_damper(network: Network) -> el.ControlledDamper | None:
    """Return the controlled damper of a quarter car; None for other cars."""
    if network.bodies:
        return None
    return next(
        (e for e in network.elements if isinstance(e, el.ControlledDamper)), None
    )


class Clipped(BatchController):
    """A controller of the active car whose force is clipped to that of a damper.

    Args:
        model: A quarter car with a controlled damper.
        make: Returns a controller of the active car.
        control_step: Control step [s].
    """

    def __init__(
        self,
        model: Network,
        make: Callable[[Network], BatchController],
        control_step: float,
    ) -> None:
        damper = controlled_damper(model)
        assert damper is not None
        self._limit = damper.current
        self._half = 0.5 * (damper.high - damper.low)
        middle = el.LinearDamping(
            damper.name, damper.where, damping=0.5 * (damper.low + damper.high)
        )  # type: ignore[call-arg]
        motor = el.Motor("actuator", damper.where, thrust_constant=_THRUST)  # type: ignore[call-arg]
        elements = [middle if e is damper else e for e in model.elements]
        inputs = [
            replace(c, element="actuator") if c.quantity == "current" else c
            for c in model.inputs
        ]
        active = replace(
            model, elements=(*elements, motor), inputs=tuple(inputs), uncertainty={}
        )
        self.active = make(active)
        super().__init__(self.active.name, model, control_step)
        self.observation, self.preview = self.active.observation, self.active.preview
        self.reset()

    def _start(self, count: int) -> None:
        self.active.reset_batch(count)

    def _command(self, obs: np.ndarray) -> np.ndarray:
        rate = obs[_DEVICE_RATE]
        share = np.clip(obs[CURRENT] / self._limit, -1.0, 1.0)
        seen = obs.copy()
        seen[CURRENT] = self._half * share * rate / _THRUST
        force = _THRUST * self.active.act_batch(seen.T)
        self.fallbacks = self.active.fallbacks
        damping = force * rate / (rate**2 + _SLOW**2)
        return self._limit * np.clip(damping / self._half, -1.0, 1.0)
