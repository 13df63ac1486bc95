"""Estimate and law of a car with several corners whose rear wheels meet the road of the front wheels later.

The model is the whole car: states of the network, heights of the road under the wheels, and the last heights
under the leading wheels. A steady Kalman filter estimates all states from the measured signals. The smoothed
rise under a leading wheel, delayed by the distance between the axles over the speed, is the rise under the
following wheel (`isd_gym.agents._memory.Echo`). The delay line is outside of the model, unlike that of `isd_gym.physics._car_prediction`: it
can be set for another speed without a change of a policy's features. The law is the linear-quadratic
regulator with preview of the rear road (Tomizuka and Whitney, ASME Journal of Dynamic Systems, Measurement,
and Control 97, 1975), with a friction compensation as in `isd_gym.baselines.lqg`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.linalg import block_diag, expm

from isd_gym._common.errors import InputError
from isd_gym.agents._memory import Echo, Filter, Memory, tuples
from isd_gym.baselines.lqg import LawSettings
from isd_gym.env._environment import ISDSuspensionVectorEnv
from isd_gym.env._sensors import ANGULAR_NOISE, NOISE
from isd_gym.physics._car_prediction import CarWeights, WholeCar, columns, continuous, drifts, of_currents
from isd_gym.physics._prediction import dry, equations, riccati, white_covariance
from isd_gym.physics._vehicle import SLEW_LIMIT, state_channels, vehicle
from isd_gym.physics.cost import StageCost
from isd_gym.physics.road import paper_road

if TYPE_CHECKING:
    from isd_gym.physics import elements as el
    from isd_gym.physics._vehicle import Vehicle
    from isd_gym.physics.network import Network

LAG = 2  # age of the estimated rise [control steps]: later measurements correct the estimate
ROAD_MEMORY = 2.0  # time constant of the estimated height of the road [s]
TRUST = 0.1  # standard deviation of the error of the road from the leading wheel, over that of the road
ANGULAR = 0.02  # assumed standard deviation of angular accelerations [rad/s^2]
CARS, STEPS, FORGET = 32, 1500, 300  # drive that gives the spread of the state
SEED = 800_000  # seed of roads without other use


@dataclass(frozen=True)
class RoadModel(WholeCar):
    """One control step of a whole car and the road under its wheels: ``x+ = A x + B I + P w + G f``, ``y = C x + D I + F f``, ``v = S x + SF f``.

    Attributes:
        car: The car.
        step: Control step [s].
        A: (n, n). The states are those of the network and, last, the heights of the road under the corners [m].
        B: (n, currents), response to currents [A] held over the step.
        P: (n, corners), response to a rise of the road by 1 m under a corner over the step.
        W: (corners, n, n), covariance per m^2/s of white velocity of the road under a corner.
        G: (n, laws), response to friction forces [N] held over the step.
        C: (channels, n), channels of the car at the end of the step (`Vehicle.channels`).
        D: (channels, currents).
        F: (channels, laws).
        S: (laws, n), sliding rates [m/s] of the frictions.
        SF: (laws, laws).
        laws: Dry frictions.
        rigid: (n, motions), states of a car that moves as a whole at 1 m/s or 1 rad/s.
    """

    car: Vehicle
    step: float
    A: np.ndarray
    B: np.ndarray
    P: np.ndarray
    W: np.ndarray
    G: np.ndarray
    C: np.ndarray
    D: np.ndarray
    F: np.ndarray
    S: np.ndarray
    SF: np.ndarray
    laws: tuple[el.Element, ...]
    rigid: np.ndarray


def road_model(network: Network, step: float) -> RoadModel:
    """Return the prediction model of a car with any number of corners; heights of the road are among the states.

    Every law except dry friction is linearised by its slope at rest; end stops are ignored.

    Args:
        network: Network of a car.
        step: Control step [s].

    Returns:
        The model.

    Raises:
        InputError: The network is no car.
    """
    car = vehicle(network)
    parts = equations(network, [*car.channels, *state_channels(network)], {})
    x, (r, _, currents) = parts.columns["x"], columns(car, parts)
    rubs, m, count = dry(parts.laws), len(currents), len(car.channels)
    A, inputs, white = continuous(car, parts)
    size, corners = len(A), len(r)
    wide = np.hstack([inputs[:, [*range(m), *(m + j for j in rubs)]], white])
    big = np.zeros((size + wide.shape[1],) * 2)
    big[:size, :size], big[:size, size:] = A, wide
    phi = expm(big * step)[:size]
    phi[size - corners :, size - corners : size] *= np.exp(-step / ROAD_MEMORY)
    ends = np.cumsum([size, m, len(rubs), corners])
    b, g, p = (phi[:, begin:end] for begin, end in pairwise(ends))
    laws = [parts.apart[j] for j in rubs]
    seen, slide, states = parts.out[:count], parts.R[rubs], [*range(x.stop), *r]
    return RoadModel(
        car=car,
        step=step,
        A=phi[:, :size],
        B=b,
        P=p / step,
        W=np.array([white_covariance(A, white[:, [i]], 1.0, step) for i in range(corners)]),
        G=g,
        C=seen[:, states],
        D=of_currents(seen, currents),
        F=seen[:, laws],
        S=slide[:, states],
        SF=slide[:, laws],
        laws=tuple(parts.laws[j] for j in rubs),
        rigid=drifts(car, parts.out[:, x], size),
    )


# ----------------------------------------------------------------------------------------------- the law


@dataclass(frozen=True)
class Law:
    """``I = law x + law_ahead . rises - force tanh((rate x + rate_ahead . rises) / width)``.

    Attributes:
        law: (currents, n).
        rate: (currents, n), rate of the device [m/s] that the law is about to cause.
        law_ahead: (currents, followers * points) [A/m], of the rises of the road before each wheel that follows.
        rate_ahead: (currents, followers * points) [1/s].
        force: Friction over thrust constant of each motor [A] (currents,).
    """

    law: np.ndarray
    rate: np.ndarray
    law_ahead: np.ndarray
    rate_ahead: np.ndarray
    force: np.ndarray


def preview_law(model: RoadModel, settings: LawSettings, followers: list[int], points: int) -> Law:
    """Return the linear-quadratic regulator with a known road before some wheels.

    Args:
        model: The car.
        settings: Weights and leads, those of `isd_gym.baselines.lqg`.
        followers: Corners with a known road ahead.
        points: Number of known control steps.

    Returns:
        The law.

    Raises:
        InputError: The Riccati equation has no solution.
    """
    m, car = model, model.car
    cost = StageCost.of(None, car.axes, len(car.corners))
    cost = replace(cost, tyre_load=cost.tyre_load + settings.tyre_load)
    weights, efforts = CarWeights(cost, settings.effort, settings.centring).of(m)
    q, r = weights[:, None], np.diag(efforts)
    C, D = m.C @ m.A, m.C @ m.B + m.D
    Q, R, N = C.T @ (q * C), D.T @ (q * D) + r, C.T @ (q * D)
    V = riccati(m.network, m.A, m.B, Q, R, N)
    K = np.linalg.solve(R + m.B.T @ V @ m.B, m.B.T @ V @ m.A + N.T)
    value = V + m.C.T @ (q * m.C)
    across = m.B.T @ value + m.D.T @ (q * m.C)
    size = across @ m.B + m.B.T @ m.C.T @ (q * m.D) + m.D.T @ (q * m.D) + r
    loop, P = m.A - m.B @ K, m.P[:, followers]
    slope = m.A.T @ value @ P - K.T @ (across @ P)
    gains = np.zeros((points, *(across @ P).shape))
    for i in range(points):
        gains[i] = np.linalg.solve(size, across @ P if i == 0 else m.B.T @ slope)
        if i > 0:
            slope = loop.T @ slope
    lead, foresight = settings.lead / m.step, settings.foresight / m.step
    at, by, later = _ahead(m, K, gains, P, lead)
    law, law_ahead = -K @ at, -np.einsum("mn,pnq->pmq", K, by) - later
    at, by, _ = _ahead(m, K, gains, P, foresight)
    row = m.device_rates
    levels = {frozenset(e.where): level for e, level in zip(m.laws, m.levels(), strict=True)}
    beside = np.array([levels.get(frozenset(c.device), 0.0) for c in car.driven])
    force = settings.compensation * beside / m.thrusts

    def flat(
        block: np.ndarray,
    ) -> np.ndarray:  # (points, currents, followers) -> (currents, followers * points)
        return block.transpose(1, 2, 0).reshape(block.shape[1], -1)

    return Law(law, row @ at, flat(law_ahead), flat(np.einsum("mn,pnq->pmq", row, by)), force)


def _ahead(
    m: RoadModel, K: np.ndarray, gains: np.ndarray, P: np.ndarray, steps: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the state some steps later in the closed loop, by the present state (n, n) and the rises ahead
    (points, n, followers).

    The third result are the gains (points, currents, followers) on the later rises.
    """
    points = len(gains)
    low, part = int(steps), steps - int(steps)
    at, by = np.eye(len(m.A)), np.zeros((points, len(m.A), P.shape[1]))
    out = []
    for k in range(low + 2):
        later = np.zeros_like(gains)
        later[k:] = gains[: max(points - k, 0)]
        out.append((at, by, later))
        current = -np.einsum("mn,pnq->pmq", K, by) - later
        by = np.einsum("ij,pjq->piq", m.A, by) + np.einsum("nm,pmq->pnq", m.B, current)
        if k < points:
            by[k] += P
        at = (m.A - m.B @ K) @ at
    first, second = out[low], out[low + 1]
    return tuple((1 - part) * a + part * b for a, b in zip(first, second, strict=True))  # type: ignore[return-value]


# ------------------------------------------------------------------------------------------ the estimate


def car_filter(
    network: Network, speed: float, control_step: float = 5e-3, noise: float = 0.0
) -> tuple[Filter, Echo | None]:
    """Return estimate and law of a car, in coordinates of unit spread, and the delay of its rear road.

    Args:
        network: Network of a car with a motor at some corners.
        speed: Speed of the delay [m/s].
        control_step: Control step [s].
        noise: White noise of the sensors that the filter assumes, as a multiple of `sensors.NOISE`.

    Returns:
        The filter, and the delay line; None without following wheels, or for wheels that follow too soon.

    Raises:
        InputError: The network is no car, or has no motor.
    """
    car = vehicle(network)
    if not any(c.motor for c in car.driven):
        raise InputError(f"network '{network.name}' has no motor")
    settings = LawSettings()
    m = road_model(network, control_step)
    wheels = car.wheels
    followers = [i for i, behind in enumerate(wheels.behind) if behind > 0.0]
    sources = [wheels.leaders[wheels.track[i]] for i in followers]
    delays = wheels.delays(speed, control_step)
    points = max((int(delays[i]) - LAG + 1 for i in followers), default=0)
    if points < 1:
        followers, sources = [], []
    law = preview_law(m, settings, followers, max(points, 0))
    # states in addition to those of the model: heights of the last steps under the leading wheels
    leading = sorted(set(sources))
    A, rows = _with_last_heights(m, leading)
    kept = len(A) - len(m.A)

    def longer(block: np.ndarray, axis: int = 1) -> np.ndarray:
        width = [(0, kept if i == axis else 0) for i in range(2)]
        return np.pad(block, width)

    measured = [i for i, c in enumerate(car.channels) if not c.name.startswith("tyre_load")]
    B, P, G = (longer(block, 0) for block in (m.B, m.P, m.G))
    rough = block_diag(
        sum(W * (TRUST**2 if i in followers else 1.0) for i, W in enumerate(m.W)), np.zeros((kept, kept))
    )
    C, S, rigid = longer(m.C[measured]), longer(m.S), longer(m.rigid, 0)
    D, F = m.D[measured], m.F[measured]
    gain = _kalman_gain(m, A, rough, G, C, rigid, settings, noise)
    levels = m.levels()
    plain = dict(
        A=A,
        B=B,
        G=G * levels,
        S=S,
        K=-(S @ G + m.SF) * levels,
        C=C,
        D=D,
        F=F * levels,
        L=gain,
        law=longer(law.law),
        rate=longer(law.rate) / settings.width,
        force=law.force,
        road=P[:, followers],
        law_ahead=law.law_ahead,
        rate_ahead=law.rate_ahead / settings.width,
    )
    echo = None
    if followers:
        echo = Echo(
            rows=tuples(rows.tolist()),
            followers=tuple(
                (leading.index(s), float(wheels.behind[i])) for i, s in zip(followers, sources, strict=True)
            ),
            speed=float(speed),
            lag=LAG,
            points=points,
            rise=float(paper_road().noise(20.0, control_step)[0]),
        )
    current = len(measured)
    first = _filter(plain, current)
    back = np.linalg.cholesky(_spread(first, echo, network, speed, control_step))
    T = np.linalg.inv(back)
    for name in ("A", "B", "G", "L", "road"):
        plain[name] = T @ plain[name]
    for name in ("A", "S", "C", "law", "rate"):
        plain[name] = plain[name] @ back
    if echo is not None:
        echo = replace(echo, rows=tuples((rows @ back).tolist()))
    return _filter(plain, current), echo


def _with_last_heights(m: RoadModel, leading: list[int]) -> tuple[np.ndarray, np.ndarray]:
    """Return A with the last `LAG` heights under each leading wheel as further states, and the rows of the oldest rise."""
    n, kept = len(m.A), len(leading) * LAG
    A, rows = block_diag(m.A, np.zeros((kept, kept))), np.zeros((len(leading), n + kept))
    for k, leader in enumerate(leading):
        places = [n - len(m.car.corners) + leader, *range(n + k * LAG, n + (k + 1) * LAG)]
        for newer, older in pairwise(places):
            A[older, newer] = 1.0
        rows[k, places[-1]], rows[k, places[-2]] = -1.0, 1.0
    return A, rows


def _filter(matrices: dict[str, np.ndarray], current: int) -> Filter:
    values: dict[str, Any] = {k: tuples(np.asarray(v).tolist()) for k, v in matrices.items()}
    return Filter(**values, slew=SLEW_LIMIT, current=current)


def _kalman_gain(
    m: RoadModel,
    A: np.ndarray,
    rough: np.ndarray,
    G: np.ndarray,
    C: np.ndarray,
    rigid: np.ndarray,
    settings: LawSettings,
    noise: float,
) -> np.ndarray:
    """Return the steady Kalman gain (n, signals) on the measured signals."""
    intensity, step = settings.road_intensity, m.step
    W = intensity * rough + settings.friction_noise**2 * G @ G.T
    W += intensity * step / settings.sensors.memory**2 * rigid @ rigid.T
    W += 1e-12 * np.eye(len(W)) * np.trace(W)
    kinds = [signal.kind for signal in m.car.measured if signal.kind != "current"]
    usual = NOISE | ANGULAR_NOISE
    deviations = [getattr(settings.sensors, k, ANGULAR) for k in kinds]
    R = np.diag([d**2 + (noise * usual[k]) ** 2 for d, k in zip(deviations, kinds, strict=True)])
    V = riccati(m.network, A.T, C.T, W, R)
    return np.linalg.solve(C @ V @ C.T + R, C @ V).T


def _spread(
    given: Filter, echo: Echo | None, network: Network, speed: float, control_step: float
) -> np.ndarray:
    """Return second moments (n, n) of the estimate while the law drives `network` on the paper's road."""
    env = ISDSuspensionVectorEnv(
        CARS, network=network, speed=speed, control_step=control_step, autoreset_mode="disabled"
    )
    memory = Memory(step=control_step, filter=given, echo=echo)
    obs, _ = env.reset(seed=SEED)
    recall = memory.start(obs)
    assert recall.filter is not None
    n = len(given.B)
    seen = []
    for k in range(STEPS):
        obs, *_ = env.step(np.clip(recall.filter.wanted, -5.0, 5.0))
        recall.see(obs)
        if k >= FORGET:
            begin = recall.features.shape[1] - given.width
            seen.append(recall.features[:, begin : begin + n].astype(float))
    x = np.concatenate(seen)
    moments = x.T @ x / len(x)
    return moments + 1e-6 * np.diag(np.diag(moments))
