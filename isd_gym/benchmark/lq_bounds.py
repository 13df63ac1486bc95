"""The causal bound of every score, on the mean over roads.

The **causal bound** is the linear-quadratic optimum of body and wheel with an arbitrary force between them:
full state, no friction, no limits, a road of white velocity. Every suspension is a special case, so that no
suspension is better on average. The reachable mean squares form a convex set; the Riccati solutions of all
weights are therefore its complete border, and `best_acceleration` finds the smallest acceleration at given
travel and tyre load exactly, by duality.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.linalg import null_space, solve_continuous_are, solve_continuous_lyapunov
from scipy.optimize import minimize

from .._common.errors import InputError
from ..physics import elements as el
from ..physics.cost import StageCost
from ..physics.network import GROUND, Channel, Network, linearise
from ..physics.road import REFERENCE_FREQUENCY, Road
from ..physics.road import road as find_road
from ..physics.vehicle import require_quarter_car, vehicle

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from ..physics.car_prediction import CarModel, CarWeights

__all__ = ["Best", "LQPoint", "best_acceleration", "lq_bound"]

# ============================================================================================ the causal bound


@dataclass(frozen=True)
class Linear:
    """A car on a rough road as ``dx/dt = A x + B F + G w`` and ``y = C x + D F``, with positions above the road and white w.

    Unobservable states are removed.

    Attributes:
        A: State matrix (n, n).
        B: Input matrix (n, 1) of the force F [N], or the current [A].
        G: Noise matrix (n,).
        C: Output matrix (3, n): body acceleration [m/s^2], suspension travel [m], tyre load [N].
        D: Feedthrough (3,).
        intensity: Two-sided intensity of w [m^2/s].
    """

    A: np.ndarray
    B: np.ndarray
    G: np.ndarray
    C: np.ndarray
    D: np.ndarray
    intensity: float


@dataclass(frozen=True)
class LQPoint:
    """A point of the surface of reachable mean squares.

    Attributes:
        acceleration: RMS of the body acceleration [m/s^2].
        travel: RMS of the suspension travel [m].
        tyre_load: RMS of the dynamic tyre load [N].
        cost: Riccati value ``trace(P G G') intensity``, equal to the weighted mean square of a rollout.
        weights: Weights (3,) on the squares of acceleration, travel and tyre load, in SI units.
        gain: Gain (n,) of ``F = -gain @ x``.
    """

    acceleration: float
    travel: float
    tyre_load: float
    cost: float
    weights: np.ndarray
    gain: np.ndarray

    @property
    def triple(self) -> np.ndarray:
        """RMS (3,) of acceleration [m/s^2], travel [m] and tyre load [N]."""
        return np.array([self.acceleration, self.travel, self.tyre_load])


def ideal(network: Network | str | Path) -> Network:
    """Return a car with a force actuator of 1 N/A between body and wheel of each corner, in place of the suspension.

    Args:
        network: A car, by name, file or network.

    Returns:
        The changed network.

    Raises:
        InputError: The network is no car, or has other parts than body, wheels, tyres and suspension, for which the
            bound would not hold.
    """
    network = Network.load(network)
    car = vehicle(network)
    masses = len(network.masses) + len(network.bodies)
    if masses != 1 + len(car.corners) or network.levers:
        raise InputError(
            f"network '{network.name}': the causal bound is that of a body and wheels without other masses"
        )
    between = [e for e in network.elements if e.place == "between"]
    tyres = [{c.wheel, c.road} for c in car.corners]
    outside = {GROUND, *network.moved_nodes}
    if not all(set(e.where) in tyres for e in between if outside & set(e.where)):
        raise InputError(
            f"network '{network.name}': the causal bound is that of a car on its tyres alone"
        )
    kept = [e for e in between if set(e.where) in tyres]
    currents = []
    for c in car.corners:
        name = f"actuator_{c.name}"
        kept.append(el.Motor(name, (c.body, c.wheel), thrust_constant=1.0, ratio=1.0))  # type: ignore[call-arg]
        currents.append(Channel(f"current_{c.name}", "current", "A", element=name))
    roads = [c for c in network.inputs if c.quantity == "displacement"]
    return replace(
        network,
        name=f"{network.name}-ideal",
        elements=tuple(kept),
        inputs=(*roads, *currents),
        outputs=(),
        uncertainty={},
    )


def linear_car(
    network: Network | str | Path, *, speed: float = 20.0, road: str | Road = "paper"
) -> Linear:
    """Return a car on a rough road without friction and stops, with other laws by their slope at rest.

    Args:
        network: A car, by name, file or network.
        speed: Speed [m/s].
        road: A rough road.

    Returns:
        The linear car.

    Raises:
        InputError: The road is not rough, the car is tied to the ground, or the tyre load has no RMS.
    """
    network = Network.load(network)
    require_quarter_car(network, "the causal bound is that")
    ground = find_road(road)
    if not ground.roughness > 0:
        raise InputError(
            f"road '{ground.name}' is not random: the causal bound needs a rough road"
        )
    moving = [
        e
        for e in network.elements
        if e.place == "between"
        and e.bound is None
        and not isinstance(e, el.BumpStop | el.TyreLiftOff)
    ]
    bare = Network(network.name, network.masses, tuple(moving), network.inputs)
    channels = [
        c
        for c in vehicle(bare).channels
        if c.name in ("body_acceleration", "suspension_travel", "tyre_load")
    ]
    ss = linearise(bare, outputs=channels)
    name = next(c.name for c in network.inputs if c.quantity == "displacement")
    column = {n: j for j, n in enumerate(ss.inputs)}
    n = len(ss.A)
    r = column[name]
    left = np.vstack([ss.A, ss.C])
    right = np.concatenate([ss.B[:, r], ss.D[:, r]])
    # state of a car that is lifted by 1 m together with the road
    T = np.linalg.lstsq(left, -right, rcond=None)[0]
    if np.abs(left @ T + right).max() > 1e-6 * np.abs(right).max():
        raise InputError(
            f"network '{network.name}' is tied to the ground: its travel has no stationary value"
        )
    rate = column.get(f"{name}'")
    G = (ss.B[:, rate] if rate is not None else 0.0) - T
    if (rate is not None and np.any(ss.D[:, rate])) or f"{name}''" in column:
        raise InputError(
            f"network '{network.name}': white road velocity acts on the tyre load through a damper; it has no RMS"
        )
    current = next((c.name for c in network.inputs if c.quantity == "current"), None)
    B = ss.B[:, [column[current]]] if current is not None else np.zeros((n, 1))
    D = ss.D[:, column[current]] if current is not None else np.zeros(3)
    # a free device may drift unobserved (its travel has no cost): these states are removed
    unseen = null_space(left)
    seen = null_space(unseen.T) if unseen.size else np.eye(n)
    A = seen.T @ ss.A @ seen
    B = seen.T @ B
    G = seen.T @ G
    C = ss.C @ seen
    n = len(A)
    # coloured road: the height of the road is an additional state
    if ground.cutoff > 0:
        pole = 2 * math.pi * ground.cutoff * speed
        A = np.block([[A, -pole * G[:, None]], [np.zeros((1, n)), np.array([[-pole]])]])
        B = np.vstack([B, [[0.0]]])
        G = np.append(G, 1.0)
        C = np.hstack([C, np.zeros((3, 1))])
    intensity = (
        (2 * math.pi) ** 2 * 0.5 * ground.roughness * REFERENCE_FREQUENCY**2 * speed
    )
    return Linear(A, B, G, C, D, intensity)


def stationary(car: Linear, gain: np.ndarray | None = None) -> np.ndarray:
    """Return the stationary RMS of the outputs under the feedback ``F = -gain @ x``.

    Args:
        car: The linear car.
        gain: Gain (n,); None for zero.

    Returns:
        RMS (3,) of acceleration [m/s^2], travel [m] and tyre load [N].
    """
    k = np.zeros(len(car.A)) if gain is None else gain
    X = solve_continuous_lyapunov(
        car.A - np.outer(car.B[:, 0], k), -car.intensity * np.outer(car.G, car.G)
    )
    Y = car.C - np.outer(car.D, k)
    return np.sqrt(np.einsum("ij,jk,ik->i", Y, X, Y))


def _solve(car: Linear, weights: np.ndarray) -> LQPoint:
    """Return the optimum of an unlimited force for weights of the squares of acceleration, travel and tyre load."""
    w = np.asarray(weights, float)
    Q = car.C.T @ (w[:, None] * car.C)
    N = (car.C.T @ (w * car.D))[:, None]
    R = np.array([[car.D @ (w * car.D)]])
    # scaled to unit weight on the first output, to keep the Riccati solver well conditioned
    scale = R[0, 0]
    P = solve_continuous_are(car.A, car.B, Q / scale, R / scale, s=N / scale) * scale
    gain = ((car.B.T @ P + N.T) / scale)[0]
    cost = float(car.G @ P @ car.G) * car.intensity
    acceleration, travel, tyre = map(float, stationary(car, gain))
    return LQPoint(acceleration, travel, tyre, cost, w, gain)


def lq_bound(
    network: Network | str | Path = "quarter-car-isd",
    *,
    speed: float = 20.0,
    road: str | Road = "paper",
    weights: Sequence[float] = (1.0, 1.0, 1.0),
) -> LQPoint:
    """Return the causal linear-quadratic optimum for given weights.

    Weights refer to (a/a0)^2, (l/l0)^2 and (F/F0)^2 with the RMS a0, l0 and F0 of the conventional passive
    car.

    Args:
        network: The plant.
        speed: Speed [m/s].
        road: A rough road.
        weights: Weights of acceleration, travel and tyre load [-].

    Returns:
        The optimum.

    Raises:
        InputError: Weights are invalid, or the bound does not exist for the car or the road.
    """
    base = reference(network, speed=speed, road=road)
    w = np.asarray(weights, float)
    if w.shape != (3,) or not np.all(w >= 0) or not w[0] > 0:
        raise InputError(
            f"weights must be three numbers >= 0, the first > 0, not {weights!r}"
        )
    return _solve(linear_car(ideal(network), speed=speed, road=road), w / base**2)


def reference(
    network: Network | str | Path = "quarter-car-isd",
    *,
    speed: float = 20.0,
    road: str | Road = "paper",
) -> np.ndarray:
    """Return the expected RMS of the conventional passive car.

    Args:
        network: A car, by name, file or network.
        speed: Speed [m/s].
        road: A rough road.

    Returns:
        RMS (3,) of acceleration [m/s^2], travel [m] and tyre load [N].

    Raises:
        InputError: The road is not rough, or the network is no car.
    """
    from .policies import conventional

    passive = conventional(Network.load(network))
    return stationary(linear_car(passive, speed=speed, road=road))


@dataclass(frozen=True)
class Best:
    """The smallest acceleration at given travel and tyre load; changes are fractions against `reference`.

    Attributes:
        acceleration_change: Change of the RMS acceleration [-].
        travel_change: Change of the RMS travel [-].
        tyre_change: Change of the RMS tyre load [-].
        point: The optimal regulator.
        reference: RMS (3,) of the reference.
    """

    acceleration_change: float
    travel_change: float
    tyre_change: float
    point: LQPoint
    reference: np.ndarray


def best_acceleration(
    travel_change: float | None,
    tyre_change: float | None,
    *,
    network: Network | str | Path = "quarter-car-isd",
    speed: float = 20.0,
    road: str | Road = "paper",
) -> Best:
    """Return the smallest acceleration of any causal controller with limited changes of travel and tyre load.

    Changes are fractions of the RMS; -0.17 means 17 % less.

    Args:
        travel_change: Largest change of the travel; None for no limit.
        tyre_change: Largest change of the tyre load; None for no limit.
        network: A car, by name, file or network.
        speed: Speed [m/s].
        road: A rough road.

    Returns:
        The optimum.

    Raises:
        InputError: No causal controller reaches the changes, or the bound does not exist for the car or the
            road.
    """
    base = reference(network, speed=speed, road=road)
    car = linear_car(ideal(network), speed=speed, road=road)
    allowed = [1 + c if c is not None else None for c in (travel_change, tyre_change)]
    if any(a is not None and not a > 0 for a in allowed):
        raise InputError("changes must be above -1")
    limit = np.array([a if a is not None else np.inf for a in allowed])
    bound = np.isfinite(limit)

    def at(q: np.ndarray) -> LQPoint:
        multipliers = np.where(bound, np.exp(q), 1e-8)
        return _solve(car, np.array([1.0, *multipliers]) / base**2)

    def negative_dual(q: np.ndarray) -> tuple[float, np.ndarray]:
        point = at(q)
        squares = (point.triple / base) ** 2
        excess = np.where(bound, squares[1:] - np.where(bound, limit, 0.0) ** 2, 0.0)
        return -(squares[0] + np.exp(q) @ excess), -np.exp(q) * excess

    ends = [(-16.0, 9.0)] * 2
    found = min(
        (
            minimize(
                negative_dual,
                s,
                jac=True,
                method="L-BFGS-B",
                bounds=ends,
                options={"ftol": 1e-14, "gtol": 1e-9},
            )
            for s in ((-0.5, -0.3), (-4.0, 0.0))
        ),
        key=lambda o: o.fun,
    )
    point = at(found.x)
    change = point.triple / base - 1
    if np.any((found.x > 8.5) & bound) or np.any(
        (change[1:] > limit - 1 + 1e-3) & bound
    ):
        raise InputError(
            f"no causal controller reaches travel {100 * (limit[0] - 1):+.1f} % with tyre load {100 * (limit[1] - 1):+.1f} %"
        )
    return Best(float(change[0]), float(change[1]), float(change[2]), point, base)


def lq_front(
    tyre_change: float, travel_changes: Sequence[float], **options: Any
) -> np.ndarray:
    """Return the border of reachable travel and acceleration changes at a given change of the tyre load.

    Args:
        tyre_change: Largest change of the tyre load [-].
        travel_changes: Changes of the travel [-].
        options: Further arguments of `best_acceleration`.

    Returns:
        Pairs (k, 2) of travel change and acceleration change; unreachable changes are omitted.
    """
    rows = []
    for change in travel_changes:
        try:
            best = best_acceleration(float(change), tyre_change, **options)
        except InputError:
            continue
        rows.append((change, best.acceleration_change))
    return np.array(rows).reshape(-1, 2)


# ============================================================================================ cars with several corners


@dataclass(frozen=True)
class CarBound:
    """The linear-quadratic optimum of a car with a front and a rear axle on a white road.

    Attributes:
        cost: Mean stage cost of the optimum that knows what the front wheels met [-].
        blind: Mean stage cost of the optimum of independent roads, which takes the rear road for a new one [-].
        passive: Mean stage cost of the conventional passive car [-].
    """

    cost: float
    blind: float
    passive: float

    @property
    def change(self) -> float:
        """Change of the cost against the passive car, as a fraction."""
        return self.cost / self.passive - 1

    @property
    def blind_change(self) -> float:
        """Change of the cost against the passive car without knowledge of the rear road, as a fraction."""
        return self.blind / self.passive - 1


def wheelbase_bound(
    network: Network | str | Path = "half-car-isd",
    *,
    speed: float = 20.0,
    road: str | Road = "paper",
    cost: StageCost | None = None,
    step: float = 1e-3,
) -> CarBound:
    """Return the linear-quadratic bound of a half car whose rear wheel meets the road of the front wheel.

    Full state, no friction, no limits, any force between body and wheels. No controller that does not see the road ahead of the
    front axle costs less on average. The forces are held over `step`; half the step changes the change by less than 0.1 %.

    Args:
        network: Car, by name, file or itself.
        speed: Speed [m/s].
        road: Rough road without cut-off.
        cost: Stage cost, that of the car by default.
        step: Step over which the forces are held [s].

    Raises:
        InputError: The road is not white in velocity, or the car has two tracks, whose coherence the model leaves out.
    """
    from ..physics.car_prediction import CarWeights, car_model, car_regulator
    from .policies import conventional

    network = Network.load(network)
    ground = find_road(road)
    car = vehicle(network)
    if not ground.roughness > 0 or ground.profile is not None or ground.cutoff > 0:
        raise InputError(
            f"road '{ground.name}': the bound of a whole car needs a rough road without cut-off"
        )
    if len(car.corners) < 2 or car.wheels.tracks != 1:
        raise InputError(
            f"network '{network.name}': the wheelbase bound is that of axles in one track, as of a half car; the coherence of a "
            "left and a right track is not part of its model"
        )
    intensity = (
        (2 * math.pi) ** 2 * 0.5 * ground.roughness * REFERENCE_FREQUENCY**2 * speed
    )
    stage = StageCost.of(cost, car.axes, len(car.corners))
    plant = ideal(network)
    weights = CarWeights(stage, effort=1e-14, centring=0.0)
    known, blind = (
        car_model(plant, step, speed, wheelbase=way, road_intensity=intensity)
        for way in (True, False)
    )
    _, best = car_regulator(known, weights)
    K, _ = car_regulator(blind, weights)
    own = conventional(network)
    passive = car_model(own, step, speed, road_intensity=intensity)
    idle = np.zeros((len(passive.car.driven), passive.n))
    return CarBound(
        cost=best,
        blind=simulated_cost(known, weights, blind_gain(known, blind, K)),
        passive=simulated_cost(passive, CarWeights(stage, centring=0.0), idle),
    )


def blind_gain(model: CarModel, blind: CarModel, K: np.ndarray) -> np.ndarray:
    """Return the gain of a regulator that treats the rises under the rear wheels as new.

    Args:
        model: Model of the car with its delay line.
        blind: Model of the same car with `wheelbase=False`.
        K: Gain on the state of the blind model.

    Returns:
        Gain (currents, n).
    """
    return np.hstack([K, -K @ blind.lift @ model.heights])


def simulated_cost(model: CarModel, weights: CarWeights, K: np.ndarray) -> float:
    """Return the mean cost of ``I = -K x`` on a white road from the covariance of the closed loop.

    Args:
        model: Model of the car.
        weights: Weights of the cost.
        K: Gain (currents, n).

    Returns:
        Mean cost per step [-].
    """
    from ..physics.prediction import stationary

    q, r = weights.of(model)
    loop = model.A - model.inputs @ K
    X = stationary(loop, model.W)
    C = model.C @ loop - model.feedthrough @ K
    now = np.einsum("i,ij,jk,ik->", q, C, X, C) + np.einsum("i,ij,jk,ik->", r, K, X, K)
    return float(now + np.trace(model.C.T @ (q[:, None] * model.C) @ model.W))
