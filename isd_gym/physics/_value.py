"""Value of a car's state and of the news of the road: the terms of a shaped reward.

The shaped reward of a control step is ``-(c + V(X') - V(X) - p)`` with the stage cost c and the states X before and X'
after the step. V is the value of the linear car under its linear-quadratic regulator, with friction as a damper
(statistical linearisation) and weights on the change of the currents and on the devices' travels instead of the limits.
p is the part of V(X') that the road of this step causes; with d, the effect of the road's innovations on X',

    p = 2 d' M z + d' M d,    z = (A x + B I, I),    M = V + weights of the stage cost.

V cancels over a drive, whatever the car (Ng, Harada and Russell 1999). The innovations are independent of the past. The
mean of p is therefore the constant tr(M W) for every policy that does not see the road ahead, on the real car too. The sum of
the rewards over a drive is thus a constant minus the sum of the costs, up to the value of the last state and a sum of zero mean.
On a linear car without limits, the reward of a step is minus the loss by a current that is not the best current.

References:
    A. Y. Ng, D. Harada and S. Russell, "Policy invariance under reward transformations", ICML 1999.
    D. B. Brown, J. E. Smith and P. Sun, "Information relaxations and duality in stochastic dynamic programs",
    Operations Research 58, 2010.
"""

from __future__ import annotations

import functools
import json
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from .._common.errors import InputError
from . import elements as el
from .car_prediction import CarWeights, car_model
from .network import Network
from .prediction import (
    DESIGN_SPEED,
    ROAD_INTENSITY,
    Weights,
    device_reach,
    riccati,
    statistical_linearisation,
)
from .simulate import PHYSICS_STEP
from .vehicle import Vehicle, vehicle

if TYPE_CHECKING:
    from .cost import StageCost

#: weights of the causal ceiling: of the change of current instead of the slew limit [1/A^2], and of the
#: devices' travel over their stop [-]
MOVE, CENTRING = 0.1, 0.04


@dataclass(frozen=True)
class Value:
    """Weights of the value of a state X: the state of `CarModel`, followed by the currents of the preceding step."""

    line: int  # rises of each track behind the first axle in a state [control steps]
    lift: np.ndarray  # shift of the motion (states, tracks) when a track rises by 1 m
    state: np.ndarray  # V (X, X)
    #: p by the innovations of the tracks in the physics steps and by the state with the current of the step (innovations, X)
    slope: np.ndarray
    news: np.ndarray  # p by the innovations alone (innovations, innovations)

    @property
    def numbers(self) -> np.ndarray:
        """All weights in the order of the kernel (`cars.foresee`)."""
        return np.concatenate(
            [
                self.lift.ravel(),
                _packed(self.state),
                self.slope.ravel(),
                _packed(self.news),
            ]
        )


def _packed(square: np.ndarray) -> np.ndarray:
    """Return the upper triangle of a symmetric matrix row by row, with twice the numbers off the diagonal."""
    doubled = 2.0 * square - np.diag(np.diag(square))
    return doubled[np.triu_indices(len(square))]


def value_of(network: Network, cost: StageCost, step: float, speed: float) -> Value:
    """Return the value of a car's state on the paper's road.

    Args:
        network: Network of the car, with at least one motor.
        cost: Stage cost of the car.
        step: Control step [s], a multiple of the physics step.
        speed: Speed [m/s].

    Returns:
        Value of the linear car.

    Raises:
        InputError: The network has no motor, or a controlled damper.
    """
    return _value_of(json.dumps(network.to_dict()), cost, step, speed)


@functools.lru_cache(maxsize=16)  # the cars of a training are often equal
def _value_of(text: str, cost: StageCost, step: float, speed: float) -> Value:
    network = Network.load(json.loads(text))
    car = vehicle(network)
    if not any(corner.motor for corner in car.corners):
        raise InputError(
            f"network '{network.name}' has no motor: a shaped reward is for a car that acts"
        )
    if any(isinstance(e, el.ControlledDamper) for e in network.elements):
        raise InputError(
            f"network '{network.name}' has a controlled damper, for which no linear model is known: choose "
            'reward="relative"'
        )
    intensity = ROAD_INTENSITY * speed / DESIGN_SPEED
    damping = _dampers(car, cost, step, intensity)
    model = car_model(network, step, speed, damping=damping, road_intensity=intensity)
    weights, of_currents = CarWeights(cost, centring=CENTRING).of(model)
    n = model.n
    motion = model.motion
    currents = len(of_currents)
    # X+ = F X + b u, with the changes u of the currents
    F = np.eye(n + currents)
    F[:n, :n], F[:n, n:] = model.A, model.inputs
    b = np.vstack([model.inputs, np.eye(currents)])
    signals = np.hstack([model.C, model.feedthrough])
    stage = _symmetric(signals.T @ (weights[:, None] * signals))
    stage[n:, n:] += np.diag(of_currents)
    move = MOVE / currents * np.eye(currents)
    # the currents do not change the line: first the motion and the currents alone, then a step for each rise of the line
    own = np.r_[:motion, n : n + currents]
    part = np.ix_(own, own)
    A, B, Q = F[part], b[own], stage[part]
    V = np.zeros_like(F)
    V[part] = riccati(
        network,
        A,
        B,
        _symmetric(A.T @ Q @ A),
        _symmetric(B.T @ Q @ B) + move,
        A.T @ Q @ B,
    )
    for _ in range(n - motion):
        M = V + stage
        across = b.T @ M @ F
        V = _symmetric(
            F.T @ M @ F - across.T @ np.linalg.solve(move + b.T @ M @ b, across)
        )
    device = model.rows("device_travel")
    # the cost has no such weight
    M = V + stage - signals[device].T @ (weights[device, None] * signals[device])
    fine = car_model(
        network, PHYSICS_STEP, speed, damping=damping, road_intensity=intensity
    )
    tracks = model.lift.shape[1]
    line = (n - motion) // tracks
    effects = []  # of an innovation on X at the end of the control step, later physics steps first
    response = fine.gamma
    for _ in range(round(step / PHYSICS_STEP)):
        effect = np.zeros((tracks, n + currents))
        effect[:, :motion] = response[:motion].T
        if line:
            effect[np.arange(tracks), motion + line * np.arange(tracks)] = 1.0
        effects.append(effect)
        response = fine.A @ response
    d = np.stack(effects[::-1], axis=1).reshape(-1, n + currents)
    return Value(line, model.lift, V, 2.0 * d @ M @ F, d @ M @ d.T)


def _dampers(
    car: Vehicle, cost: StageCost, step: float, intensity: float
) -> dict[str, float]:
    """Return dampers [N s/m] in place of the frictions of a car, and none in place of its stops."""
    dampers = {e.name: 0.0 for e in car.network.elements if isinstance(e, el.BumpStop)}
    cost = cost if len(car.corners) == 1 else cost.of_corner
    for corner in car.driven:
        quarter = car.quarter_car(corner)
        weights = Weights(cost, MOVE, 0.0, CENTRING, device_reach(quarter))
        dampers |= statistical_linearisation(
            quarter, step, weights, road_intensity=intensity
        ).damping
    return dampers


def _symmetric(square: np.ndarray) -> np.ndarray:
    return 0.5 * (square + square.T)
