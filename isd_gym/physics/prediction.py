"""Model of a controller: the network as a discrete prediction model, and linear-quadratic tools.

Positions are relative to the road (``x~ = x - T r`` with the rigid shift T). The road then enters as white
velocity only, and the model of equation (9) has no unobservable integrator.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass, field, fields, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.linalg import expm, solve_discrete_are

from .._common.errors import InputError
from . import elements as el
from .network import Channel, Network, assemble
from .network._linear import slopes
from .road import paper_road
from .vehicle import require_quarter_car, state_channels, vehicle

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from .cost import StageCost

PAPER_CAR = "quarter-car-isd"
# typical rate of the device on the paper's road, at which the level of a friction is evaluated [m/s]
SLIDING = 0.05
N_SENSORS = 5  # number of measured signals that depend on the physics; the sixth is the present current
DESIGN_SPEED = 20.0  # speed of the road intensity below [m/s]
#: two-sided intensity of the road's vertical velocity [m^2/s], the paper's road at 20 m/s
ROAD_INTENSITY = (
    (2 * math.pi) ** 2 * 0.5 * paper_road().roughness * 0.1**2 * DESIGN_SPEED
)


@dataclass(frozen=True)
class Sensors:
    """Standard deviations in a Kalman filter; small, since the environment's sensors are exact by default."""

    body_acceleration: float = 0.02  # body acceleration [m/s^2]
    suspension_travel: float = 2e-5  # suspension travel [m]
    suspension_travel_rate: float = 2e-3  # rate of the suspension travel [m/s]
    device_travel: float = 2e-5  # travel of the device [m]
    device_travel_rate: float = 2e-3  # rate of the device [m/s]
    #: time over which the car's absolute speed, which is not measured, is integrated from the acceleration
    #: before the mean level of the road dominates [s]. Exact sensors would allow minutes; the bias of an
    #: accelerometer does not
    memory: float = 5.0

    @property
    def covariance(self) -> np.ndarray:
        """Diagonal covariance (5, 5) of the measured signals."""
        return np.diag(
            np.square([getattr(self, f.name) for f in fields(self)[:N_SENSORS]])
        )


class Laws:
    """States and laws of a model with a state matrix `A` (n, n) and nonlinear `laws`."""

    step: float  # control step [s]
    A: np.ndarray
    C: np.ndarray  # signals by the state (signals, n)
    W: np.ndarray  # covariance of the road's effect per step (n, n)
    road_intensity: float  # two-sided intensity of the road's velocity [m^2/s]
    laws: tuple[el.Element, ...]

    @property
    def n(self) -> int:
        """Number of states."""
        return len(self.A)

    @property
    def friction(self) -> list[int]:
        """Indices of the laws that are dry friction."""
        return dry(self.laws)

    def levels(self, rate: float = SLIDING) -> np.ndarray:
        """Return the friction level of each law (laws,) [N] at a sliding rate [m/s]; 0 for laws that are not dry friction."""
        out = np.zeros(len(self.laws))
        for j in self.friction:
            e = self.laws[j]
            out[j] = e.bound(np.array(e.law_parameters()), 0.0, rate)  # type: ignore[misc]
        return out


@dataclass(frozen=True)
class Model(Laws):
    """One control step of a car: ``x+ = A x + B I + G f + w``, ``y = C x + D I + F f``, ``v = S x + SI I + SF f``.

    x (n,) are states with positions above the road, I [A] the current of the step, f (nl,) [N] the forces of
    the nonlinear `laws` (friction, stops), w the road, y (6,) the signals of `Vehicle.channels`, and v (nl,)
    [m/s] the rates of the laws.
    """

    network: Network  # the network
    step: float  # control step [s]
    A: np.ndarray  # state matrix (n, n)
    B: np.ndarray  # response of the state to the current (n,)
    G: np.ndarray  # response of the state to the forces (n, nl)
    W: np.ndarray  # covariance of the road's effect per step (n, n)
    P: np.ndarray  # response of the state to a linear rise of the road by 1 m over the step (n,), for preview
    C: np.ndarray  # output matrix (6, n)
    D: np.ndarray  # response of the outputs to the current (6,)
    F: np.ndarray  # response of the outputs to the forces (6, nl)
    S: np.ndarray  # rates of the laws by the state (nl, n)
    SI: np.ndarray  # rates of the laws by the current (nl,)
    SF: np.ndarray  # rates of the laws by the forces (nl, nl)
    E: np.ndarray  # elongations of the laws by the state (nl, n)
    laws: tuple[el.Element, ...]  # elements with a nonlinear law
    thrust: float  # force at the terminals of the motor [N/A]; 0 without a motor
    motor_rate: np.ndarray  # rate of the device by the state (n,)
    road_intensity: float  # two-sided intensity of the road's velocity [m^2/s]
    #: displacement and velocity of every node by the state, in the order of the full observation
    nodes: np.ndarray
    lift: np.ndarray  # state of the assembly when car and road are lifted by 1 m: x = x_assembly - lift r

    @property
    def heave(self) -> np.ndarray:
        """State (n,) of a car that rises as a whole at 1 m/s without relative motion."""
        channels = state_channels(self.network)
        speed = [
            i
            for i, c in enumerate(channels)
            if c.quantity == "velocity" and c.at in self.network.masses
        ]
        height = [i for i, c in enumerate(channels) if c.quantity == "displacement"]
        rows = np.vstack([self.nodes[speed], self.nodes[height], self.C[1:N_SENSORS]])
        return np.linalg.lstsq(rows, np.arange(len(rows)) < len(speed), rcond=None)[0]

    @property
    def inputs(self) -> np.ndarray:
        """Effect (n, 1) of the current on the state."""
        return self.B[:, None]

    @property
    def feedthrough(self) -> np.ndarray:
        """Effect (6, 1) of the current on the signals."""
        return self.D[:, None]


def dry(laws: Sequence[el.Element]) -> list[int]:
    """Return the indices of the laws that are dry friction."""
    return [j for j, e in enumerate(laws) if e.bound is not None]


def equivalent_damping(level: float, rate_rms: float) -> float:
    """Return the damping [N s/m] that is equivalent to dry friction of a level [N] at a Gaussian rate: the
    least-squares gain of f sgn(v) on v is f sqrt(2/pi)/sigma (section 4.2)."""
    return level * math.sqrt(2 / math.pi) / rate_rms


@dataclass(frozen=True)
class Equations:
    """Linear equations of a car; dry friction and stops are inputs, and other laws are linearised by their slope at rest.

    Columns of all matrices are the base vector of `Assembly`; the columns of linearised laws are zero.
    """

    rate: np.ndarray  # derivative of the state
    out: np.ndarray  # channels
    E: np.ndarray  # elongations [m] of the laws
    R: np.ndarray  # rates [m/s] of the laws
    #: columns of the states 'x', displacements 'r' [m] and velocities 'v' [m/s] of the roads, and currents
    #: 'I' [A]
    columns: dict[str, slice]
    apart: list[int]  # columns of the forces of the laws
    laws: tuple[el.Element, ...]  # dry frictions and stops


def equations(
    network: Network, channels: Sequence[Channel], damping: Mapping[str, float]
) -> Equations:
    """Return the linear equations of a car; linear `damping` [N s/m] by name of a law replaces the law."""
    bare = replace(network, outputs=(), uncertainty={})
    asm = assemble(bare.mechanical, channels)
    cols = {part: asm.columns(part) for part in ("x", "r", "v", "I", "f")}
    kept = [
        j
        for j, e in enumerate(asm.laws)
        if (e.bound is not None or isinstance(e, el.BumpStop))
        and e.name not in damping
        and not asm.by_difference[j]
    ]
    slopes_k, slopes_c = slopes(asm.laws, damping)
    slopes_k[kept] = slopes_c[kept] = 0.0
    rows = slopes_k[:, None] * asm.elongation + slopes_c[:, None] * asm.elongation_rate
    f_all = cols["f"]
    gain = np.linalg.solve(np.eye(len(asm.laws)) - rows[:, f_all], rows)
    apart = [f_all.start + j for j in kept]
    gain[:, f_all] = 0.0

    def close(block: np.ndarray) -> np.ndarray:
        return block + block[:, f_all] @ gain

    return Equations(
        rate=close(asm.rate),
        out=close(asm.outputs),
        E=close(asm.elongation)[kept],
        R=close(asm.elongation_rate)[kept],
        columns=cols,
        apart=apart,
        laws=tuple(asm.laws[j] for j in kept),
    )


def lift(
    network: Network, parts: Equations, roads: np.ndarray, outputs: int
) -> np.ndarray:
    """Return the shift of the state (n, rises) when roads (roads, rises) rise by 1 m, without a change of elongations and of the
    first `outputs` signals."""
    x, r = parts.columns["x"], parts.columns["r"]
    blocks = (parts.rate, parts.out[:outputs], parts.E, parts.R)
    left = np.vstack([block[:, x] for block in blocks])
    right = np.vstack([block[:, r] for block in blocks]) @ roads
    T = np.linalg.lstsq(left, -right, rcond=None)[0]
    if np.abs(left @ T + right).max() > 1e-6 * np.abs(right).max():
        raise InputError(
            f"network '{network.name}' is tied to the ground: a controller's car moves freely"
        )
    return T


def prediction_model(
    network: Network,
    step: float,
    *,
    damping: Mapping[str, float] | None = None,
    road_intensity: float = ROAD_INTENSITY,
) -> Model:
    """Return the prediction model of a quarter car.

    Dry friction and stops are kept as laws. Every other law is linearised by its slope at rest, or replaced by linear
    `damping` [N s/m] by its name. `road_intensity` is the two-sided intensity of the road's velocity [m^2/s].
    """
    require_quarter_car(network, "the prediction model is that")
    parts = equations(
        network,
        [*vehicle(network).channels, *state_channels(network)],
        dict(damping or {}),
    )
    rate = parts.rate
    out = parts.out
    R = parts.R
    cols = parts.columns
    apart = parts.apart
    if cols["r"].stop - cols["r"].start != 1:
        raise InputError(
            f"network '{network.name}': a controller's car stands on one road"
        )
    T = lift(network, parts, np.eye(1), 6)
    x, v = cols["x"], cols["v"]
    A = rate[:, x]
    white = rate[:, v] - T
    motor = next((e for e in network.elements if isinstance(e, el.Motor)), None)
    currents = [None if motor is None else cols["I"].start]
    n, k = len(A), len(parts.laws)
    inputs = np.hstack([of_currents(rate, currents), rate[:, apart], white])
    phi = held_over_step(A, inputs, step)
    return Model(
        network=network,
        step=step,
        A=phi[:, :n],
        B=phi[:, n],
        G=phi[:, n + 1 : n + 1 + k],
        W=white_covariance(A, white, road_intensity, step),
        P=phi[:, n + 1 + k] / step,
        C=out[:6, x],
        D=of_currents(out, currents)[:6, 0],
        F=out[:6, apart],
        S=R[:, x],
        SI=of_currents(R, currents)[:, 0],
        SF=R[:, apart],
        E=parts.E[:, x],
        laws=parts.laws,
        thrust=motor.thrust_constant * motor.ratio if motor is not None else 0.0,
        motor_rate=out[4, x],
        road_intensity=road_intensity,
        nodes=out[6:, x],
        lift=T[:, 0],
    )


def of_currents(rows: np.ndarray, currents: Sequence[int | None]) -> np.ndarray:
    """Return the columns of the currents (rows, currents); zero for a corner without a motor."""
    return np.column_stack(
        [np.zeros(len(rows)) if j is None else rows[:, j] for j in currents]
    )


def held_over_step(A: np.ndarray, inputs: np.ndarray, step: float) -> np.ndarray:
    """Return the state after a step by the state and by held inputs (n, n + inputs), from the rates by both."""
    n = len(A)
    big = np.zeros((n + inputs.shape[1],) * 2)
    big[:n, :n], big[:n, n:] = A * step, inputs * step
    return expm(big)[:n]


def white_covariance(
    A: np.ndarray, white: np.ndarray, intensity: float, step: float
) -> np.ndarray:
    """Return the covariance (n, n) that white velocities of two-sided `intensity` [m^2/s] at the inputs `white` (n, k) cause over
    one step.

    The block exponential grows as fast as the fastest mode decays. The step is therefore halved until no mode decays by
    more than e^4, and the covariance of the part is doubled back to the step.

    References:
        Van Loan, "Computing integrals involving the matrix exponential", IEEE Transactions on Automatic
            Control, 1978.
    """
    n = len(A)
    decay = np.abs(np.linalg.eigvals(A)).max() * step
    halvings = max(0, math.frexp(decay / 4.0)[1])
    part = step / 2**halvings
    loan = expm(
        np.block([[-A, intensity * white @ white.T], [np.zeros((n, n)), A.T]]) * part
    )
    phi = loan[n:, n:].T
    W = phi @ loan[:n, n:]
    for _ in range(halvings):
        W = W + phi @ W @ phi.T
        phi = phi @ phi
    return 0.5 * (W + W.T)


# ------------------------------------------------------------------------------------ linear-quadratic


def device_reach(network: Network) -> float:
    """Return the travel at which the stop of the motor is met [m]; that of the paper's device without a stop."""
    motor = next((e for e in network.elements if isinstance(e, el.Motor)), None)
    stops = [e for e in network.elements if isinstance(e, el.BumpStop)]
    beside = [
        e.clearance
        for e in stops
        if motor is not None and set(e.where) == set(motor.where)
    ]
    return min(beside) if beside else paper_reach()


@functools.cache
def paper_reach() -> float:
    """Return the travel of the paper's device: the stroke of the deputy cylinder over the area ratio (Table 1)."""
    return next(
        e.clearance
        for e in Network.load(PAPER_CAR).elements
        if isinstance(e, el.BumpStop)
    )


@dataclass(frozen=True)
class Weights:
    """Quadratic weights of a design."""

    cost: StageCost  # stage cost
    move: float = 0.0  # weight of the change of current per step [1/A^2]
    effort: float = 0.0  # weight of the current [1/A^2]
    #: weight of the device's travel over `reach` [-]; without this weight, the device is free to drift
    centring: float = 0.01
    #: travel of the device up to its stop [m], see `device_reach`
    reach: float = field(default_factory=paper_reach)

    @property
    def signals(self) -> np.ndarray:
        """Diagonal (6,) of the weights of the signals."""
        a, l, f, _ = self.cost.quadratic
        return np.array([a, l, 0.0, self.centring / self.reach**2, 0.0, f])

    @property
    def current(self) -> float:
        """Weight of the squared current [1/A^2]."""
        return self.cost.quadratic[3] + self.effort


def riccati(
    network: Network,
    A: np.ndarray,
    B: np.ndarray,
    Q: np.ndarray,
    R: np.ndarray,
    N: np.ndarray | None = None,
) -> np.ndarray:
    """Return the solution (n, n) of a discrete Riccati equation of A, B, Q, R and optionally N."""
    try:
        return solve_discrete_are(A, B, Q, R, s=N)
    # no solution; matrices that overflow or are ill-conditioned
    except (np.linalg.LinAlgError, ValueError):
        raise InputError(
            f"no linear-quadratic controller can be computed for network '{network.name}': a part of it neither decays "
            "nor can be moved or seen, or a value is out of proportion; check values and units of its elements"
        ) from None


def regulator(model: Model, weights: Weights) -> tuple[np.ndarray, np.ndarray]:
    """Return gain K (n,) of ``I = -K x`` and value matrix (n, n) of the linear-quadratic regulator without friction."""
    # signals at the end of the step
    C = model.C @ model.A
    D = model.C @ model.B + model.D
    Q, R, N = weighted(C, D[:, None], weights.signals)
    R += weights.current
    V = riccati(model.network, model.A, model.inputs, Q, R, N)
    return feedback(model.A, model.inputs, V, R, N)[0], V


def weighted(
    C: np.ndarray, D: np.ndarray, q: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the weights Q of the state, R of the inputs and N of their product, from weights q of the signals ``C x + D u``."""
    q = q[:, None]
    return C.T @ (q * C), D.T @ (q * D), C.T @ (q * D)


def feedback(
    A: np.ndarray, B: np.ndarray, V: np.ndarray, R: np.ndarray, N: np.ndarray
) -> np.ndarray:
    """Return the optimal gain (inputs, n) of ``u = -K x`` for the value V (n, n) of the next state."""
    return np.linalg.solve(R + B.T @ V @ B, B.T @ V @ A + N.T)


def preview_regulator(
    model: Model, weights: Weights, points: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return gains K (n,) and G (points,) [1/m] of the linear-quadratic regulator ``I = -K x - G . rises`` with a known road ahead.

    The value of a state x with known rises is ``x' V x + 2 x' s``; s follows from the rises backwards through
    the closed loop. K is the gain of `regulator`.

    References:
        Tomizuka, "Optimal continuous finite preview problem", ASME Journal of Dynamic Systems 97, 1975.
    """
    K, V = regulator(model, weights)
    q = weights.signals[:, None]
    Mxx = V + model.C.T @ (q * model.C)
    # slope by the current due to a change of the next state
    across = model.B @ Mxx + model.D @ (q * model.C)
    size = across @ model.B + model.B @ (model.C.T @ (q[:, 0] * model.D))
    size += model.D @ (q[:, 0] * model.D) + weights.current
    loop = model.A - np.outer(model.B, K)
    s = model.A.T @ (Mxx @ model.P) - K * (across @ model.P)
    G = np.empty(points)
    for i in range(points):
        if i == 0:
            G[i] = across @ model.P / size
            continue
        G[i] = model.B @ s / size
        s = loop.T @ s
    return K, G


def move_regulator(model: Model, weights: Weights) -> tuple[np.ndarray, np.ndarray]:
    """Return gain (n+1,) and value matrix of the regulator of the change of current, with the state (x, preceding I)."""
    A, B = _with_current(model)
    D = (model.C @ model.B + model.D)[:, None]
    C = np.hstack([model.C @ model.A, D])
    Q, R, N = weighted(C, D, weights.signals)
    Q[-1, -1] += weights.current
    R += weights.current + weights.move
    N[-1] += weights.current
    V = riccati(model.network, A, B, Q, R, N)
    return feedback(A, B, V, R, N)[0], V


def _with_current(model: Model) -> tuple[np.ndarray, np.ndarray]:
    """Return state matrix and response to the change of current of a model with the state (x, preceding I)."""
    A = np.block([[model.A, model.inputs], [np.zeros(model.n), 1.0]])
    return A, A[:, -1:].copy()


def kalman_gain(
    model: Model, sensors: Sensors, noise: np.ndarray | None = None
) -> np.ndarray:
    """Return the steady gain L (n, 5) of ``x += L (y - C x - D I)``; covariance `noise` (n, n) is added to that of the road."""
    return steady_gain(
        model.network,
        model,
        sensors.covariance,
        sensors.memory,
        model.heave[:, None],
        noise,
    )


def steady_gain(
    network: Network,
    model: Laws,
    covariance: np.ndarray,
    memory: float,
    drifts: np.ndarray,
    noise: np.ndarray | None,
) -> np.ndarray:
    """Return the steady gain L (n, signals) of a Kalman filter, ``x += L (y - C x - D I)``.

    `covariance` is that of the measured signals, the first rows of C; `memory` the time constant of the absolute speeds,
    which are not measured [s]; `drifts` (n, k) the states of a car that moves with the roads at constant speed.
    """
    C = model.C[: len(covariance)]
    W = model.W + (0.0 if noise is None else noise)
    # rounding may leave W slightly indefinite; a tiny noise on every state keeps the equation well posed
    W = W + 1e-12 * np.eye(model.n) * max(np.trace(W), 1e-12)
    # random walk of the absolute speed whose filter, against white road velocity, has this time constant
    for drift in drifts.T:
        W = W + model.road_intensity * model.step / memory**2 * np.outer(drift, drift)
    V = riccati(network, model.A.T, C.T, W, covariance)
    return np.linalg.solve(C @ V @ C.T + covariance, C @ V).T


def stationary(A: np.ndarray, W: np.ndarray) -> np.ndarray:
    """Return the covariance of ``x+ = A x + w`` after 2^14 steps (80 s at 5 ms), finite even for a drifting device."""
    A, S = A.copy(), W.copy()
    for _ in range(14):
        S = S + A @ S @ A.T
        A = A @ A
    return S


@dataclass(frozen=True)
class Linearised:
    """A model with dampers instead of friction."""

    model: Model  # the model
    damping: dict[str, float]  # damping [N s/m] by name of a law
    rate_rms: dict[str, float]  # RMS of the rate [m/s] by name of a law
    #: covariance of the state per step due to the difference between friction and dampers (n, n)
    friction_noise: np.ndarray


def statistical_linearisation(
    network: Network,
    step: float,
    weights: Weights,
    *,
    road_intensity: float = ROAD_INTENSITY,
) -> Linearised:
    """Return a model with dampers whose level is consistent with their closed-loop rate (section 4.2, equation 9).

    The RMS rate is that of the linear car under its own linear-quadratic regulator of the current's change.
    Half steps are taken until the rate no longer changes. A car that tends to stick ends at a large damping
    (RMS of at least 1 mm/s).
    """
    free = prediction_model(network, step, road_intensity=road_intensity)
    names = [free.laws[j].name for j in free.friction]
    stops = {e.name: 0.0 for e in free.laws if e.bound is None}
    rms = {name: 0.1 for name in names}
    levels = {}
    for _ in range(60):
        for j in free.friction:
            name = free.laws[j].name
            levels[name] = float(free.levels(rms[name])[j])
        damping = {name: equivalent_damping(levels[name], rms[name]) for name in names}
        model = prediction_model(
            network, step, damping=damping | stops, road_intensity=road_intensity
        )
        if not names or model.thrust == 0.0:
            break
        K, _ = move_regulator(model, weights)
        A, B = _with_current(model)
        W = np.zeros_like(A)
        W[:-1, :-1] = model.W
        spread = stationary(A - B * K, W)
        change = 0.0
        for j in free.friction:
            row = np.append(free.S[j], 0.0)
            new = max(math.sqrt(max(row @ spread @ row, 0.0)), 1e-3)
            name = free.laws[j].name
            change = max(change, abs(math.log(new / rms[name])))
            rms[name] = math.sqrt(rms[name] * new)
        if change < 1e-4:
            break
    noise = np.zeros((free.n, free.n))
    for j in free.friction:
        residual = levels[free.laws[j].name] * math.sqrt(1 - 2 / math.pi)
        noise += residual**2 * np.outer(free.G[:, j], free.G[:, j])
    return Linearised(model, damping, rms, noise)
