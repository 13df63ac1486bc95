"""What a controller believes: the network as a discrete prediction model, and the linear-quadratic tools on it.

Positions are taken relative to the road (``x~ = x - T r`` with the rigid shift T), so the road enters as white
velocity only and the model of equation (9) has no integrator that nothing can see.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.linalg import expm, solve_discrete_are

from isd_gym import elements as el
from isd_gym.batch import signal_channels, state_channels
from isd_gym.errors import InputError
from isd_gym.network import Network, assemble
from isd_gym.road import paper_road
from isd_gym.vehicle import require_quarter_car

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from isd_gym.cost import StageCost
    from isd_gym.network import Channel

    from .car import CarModel

PAPER_CAR = "quarter-car-isd"
SLIDING = 0.05  # m/s, a rate of the device on the paper's road: where a friction's level is read
N_SENSORS = 5  # the measured signals that the physics determines; the sixth is the present current
TYRE = 5  # row of the tyre load among the signals
#: two-sided intensity of the road's vertical velocity [m^2/s], the paper's road at 20 m/s
ROAD_INTENSITY = (2 * math.pi) ** 2 * 0.5 * paper_road().roughness * 0.1**2 * 20.0


@dataclass(frozen=True)
class Sensors:
    """Standard deviations a Kalman filter assumes; small, as the environment's sensors are clean.

    `memory` [s]: how long the car's absolute speed, which nothing measures, is integrated from the acceleration before
    the road's mean level is trusted more. Clean sensors would allow minutes; an accelerometer's bias does not.
    """

    body_acceleration: float = 0.02  # m/s^2
    suspension_travel: float = 2e-5  # m
    suspension_travel_rate: float = 2e-3  # m/s
    device_travel: float = 2e-5  # m
    device_travel_rate: float = 2e-3  # m/s
    memory: float = 5.0

    @property
    def covariance(self) -> np.ndarray:
        values = [
            self.body_acceleration,
            self.suspension_travel,
            self.suspension_travel_rate,
            self.device_travel,
            self.device_travel_rate,
        ]
        return np.diag(np.square(values))


@dataclass(frozen=True)
class Model:
    """One control step of a car: ``x+ = A x + B I + G f + w``, ``y = C x + D I + F f``, ``v = S x + SI I + SF f``.

    x (n,): state, positions above the road. I [A]: current held over the step. f (nl,) [N]: forces of the `laws` that
    were kept apart (friction, stops). w: road, covariance `W` over one step. y (6,): the signals of `signal_channels`.
    v (nl,) [m/s] and e (nl,) [m] (rows `E`): rates and elongations of the laws. P: response of x to a road that moves
    linearly by 1 m over the step (preview).
    """

    network: Network
    step: float
    A: np.ndarray
    B: np.ndarray
    G: np.ndarray
    W: np.ndarray
    P: np.ndarray
    C: np.ndarray
    D: np.ndarray
    F: np.ndarray
    S: np.ndarray
    SI: np.ndarray
    SF: np.ndarray
    E: np.ndarray
    laws: tuple[el.Element, ...]
    thrust: float  # N/A at the terminals of the motor; 0 without one
    motor_rate: np.ndarray  # row that gives the device's rate
    road_intensity: float  # m^2/s
    # rows of displacement and velocity of every node, as the full observation has them
    nodes: np.ndarray
    lift: np.ndarray  # state of the assembly when car and road are lifted by 1 m: x = x_assembly - lift r

    @property
    def heave(self) -> np.ndarray:
        """The state (n,) of a car that rises as a whole at 1 m/s, nothing in it moving against anything."""
        channels = state_channels(self.network)
        speed = [
            i for i, c in enumerate(channels) if c.quantity == "velocity" and c.at in self.network.masses
        ]
        height = [i for i, c in enumerate(channels) if c.quantity == "displacement"]
        rows = np.vstack([self.nodes[speed], self.nodes[height], self.C[1:N_SENSORS]])
        return np.linalg.lstsq(rows, np.arange(len(rows)) < len(speed), rcond=None)[0]

    @property
    def n(self) -> int:
        return len(self.A)

    @property
    def inputs(self) -> np.ndarray:
        """Effect (n, 1) of the current on the state."""
        return self.B[:, None]

    @property
    def feedthrough(self) -> np.ndarray:
        """Effect (6, 1) of the current on the signals."""
        return self.D[:, None]

    @property
    def friction(self) -> list[int]:
        """Which of the laws are dry friction."""
        return dry(self.laws)

    def levels(self, rate: float = SLIDING) -> np.ndarray:
        """Friction level [N] of each law at a sliding rate [m/s]; 0 for laws that are not dry friction."""
        return friction_levels(self.laws, rate)


def dry(laws: Sequence[el.Element]) -> list[int]:
    """Return which of the laws are dry friction.

    Args:
        laws: Laws that are kept apart.
    """
    return [j for j, e in enumerate(laws) if e.bound is not None]


def friction_levels(laws: Sequence[el.Element], rate: float = SLIDING) -> np.ndarray:
    """Return the friction level [N] of each law; 0 for laws that are not dry friction.

    Args:
        laws: Laws that are kept apart.
        rate: Sliding rate [m/s].
    """
    out = np.zeros(len(laws))
    for j in dry(laws):
        e = laws[j]
        out[j] = e.bound(np.array(e.law_parameters()), 0.0, rate)  # type: ignore[misc]
    return out


def equivalent_damping(level: float, rate_rms: float) -> float:
    """Damping [N s/m] that loses what friction of `level` [N] loses at a Gaussian rate of `rate_rms` [m/s].

    The quasi-linearisation of section 4.2: the least-squares gain of f sgn(v) on v is f sqrt(2/pi)/sigma.
    """
    return level * math.sqrt(2 / math.pi) / rate_rms


@dataclass(frozen=True)
class Equations:
    """Linear equations of a car whose dry friction and stops are inputs, and whose other laws count by their slope at rest.

    Columns of all matrices are the base vector of `Assembly`; the columns of the laws inside are zero.

    Attributes:
        rate: Derivative of the state.
        out: Channels.
        E: Elongations [m] of the laws.
        R: Rates [m/s] of the laws.
        columns: Columns of the states 'x', displacements 'r' [m] and velocities 'v' [m/s] of the roads, and currents 'I' [A].
        apart: Columns of the forces of the laws.
        laws: Laws that are kept apart.
    """

    rate: np.ndarray
    out: np.ndarray
    E: np.ndarray
    R: np.ndarray
    columns: dict[str, slice]
    apart: list[int]
    laws: tuple[el.Element, ...]


def equations(network: Network, channels: Sequence[Channel], damping: Mapping[str, float]) -> Equations:
    """Return the linear equations of a car.

    Args:
        network: Network of the car.
        channels: Outputs.
        damping: Dry frictions and stops that become linear dampers [N s/m], by name.
    """
    bare = replace(
        network,
        elements=tuple(e for e in network.elements if e.place == "between"),
        outputs=(),
        uncertainty={},
    )
    asm = assemble(bare, channels)
    cols = {part: asm.columns(part) for part in ("x", "r", "v", "I", "f")}
    kept, slopes_k, slopes_c = [], np.zeros(len(asm.laws)), np.zeros(len(asm.laws))
    for j, e in enumerate(asm.laws):
        if e.name in damping:
            slopes_c[j] = damping[e.name]
        elif (e.bound is not None or isinstance(e, el.BumpStop)) and not asm.by_difference[j]:
            kept.append(j)
        elif e.law is not None:
            p, d = np.array(e.law_parameters()), 1e-7
            slopes_k[j] = (e.law(p, d, 0.0, 0.0, 0.0, 1e-9)[0] - e.law(p, -d, 0.0, 0.0, 0.0, 1e-9)[0]) / (
                2 * d
            )
            slopes_c[j] = (e.law(p, 0.0, d, 0.0, 0.0, 1e-9)[0] - e.law(p, 0.0, -d, 0.0, 0.0, 1e-9)[0]) / (
                2 * d
            )
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


def lift(network: Network, parts: Equations, roads: np.ndarray, outputs: int) -> np.ndarray:
    """Return the shift of the state when the roads rise by 1 m and nothing changes, nothing is felt: (n, rises).

    Args:
        network: Network of the car, for the message.
        parts: Equations of the car.
        roads: How much each road rises (roads, rises) [m].
        outputs: Number of channels that feel nothing.

    Raises:
        InputError: The car feels the rise: something ties the car to the ground.
    """
    x, r = parts.columns["x"], parts.columns["r"]
    blocks = (parts.rate, parts.out[:outputs], parts.E, parts.R)
    left = np.vstack([block[:, x] for block in blocks])
    right = np.vstack([block[:, r] for block in blocks]) @ roads
    T = np.linalg.lstsq(left, -right, rcond=None)[0]
    if np.abs(left @ T + right).max() > 1e-6 * np.abs(right).max():
        raise InputError(f"network '{network.name}' is tied to the ground: a controller's car moves freely")
    return T


def prediction_model(
    network: Network,
    step: float,
    *,
    damping: Mapping[str, float] | None = None,
    road_intensity: float = ROAD_INTENSITY,
) -> Model:
    """The model of a quarter car at a control `step` [s].

    Dry friction and stops are kept as laws, unless `damping` [N s/m] names them: then they are linear dampers, inside
    A and C. Every other law counts by its slope at rest. Raises `InputError` for a network that is no quarter car.
    """
    require_quarter_car(network, "the prediction model is that")
    parts = equations(network, [*signal_channels(network), *state_channels(network)], dict(damping or {}))
    rate, out, R, cols, apart = parts.rate, parts.out, parts.R, parts.columns, parts.apart
    if cols["r"].stop - cols["r"].start != 1:
        raise InputError(f"network '{network.name}': a controller's car stands on one road")
    T = lift(network, parts, np.eye(1), 6)
    x, v = cols["x"], cols["v"]
    A = rate[:, x]
    white = rate[:, v] - T
    motor = next((e for e in network.elements if isinstance(e, el.Motor)), None)
    current = rate[:, cols["I"]] if motor is not None else np.zeros((len(A), 1))
    n, k = len(A), len(parts.laws)
    inputs = np.hstack([current, rate[:, apart], white])
    big = np.zeros((n + inputs.shape[1],) * 2)
    big[:n, :n], big[:n, n:] = A * step, inputs * step
    phi = expm(big)

    def through(block: np.ndarray) -> np.ndarray:
        return block[:, cols["I"]][:, :1] if motor is not None else np.zeros((len(block), 1))

    return Model(
        network=network,
        step=step,
        A=phi[:n, :n],
        B=phi[:n, n],
        G=phi[:n, n + 1 : n + 1 + k],
        W=white_covariance(A, white, road_intensity, step),
        P=phi[:n, n + 1 + k] / step,
        C=out[:6, x],
        D=through(out)[:6, 0],
        F=out[:6, apart],
        S=R[:, x],
        SI=through(R)[:, 0],
        SF=R[:, apart],
        E=parts.E[:, x],
        laws=parts.laws,
        thrust=motor.thrust_constant * motor.ratio if motor is not None else 0.0,
        motor_rate=out[4, x],
        road_intensity=road_intensity,
        nodes=out[6:, x],
        lift=T[:, 0],
    )


def white_covariance(A: np.ndarray, white: np.ndarray, intensity: float, step: float) -> np.ndarray:
    """Return the covariance (n, n) that white velocity of the road causes over one step (Van Loan, 1978).

    Args:
        A: Continuous system matrix (n, n).
        white: Inputs (n, k) of independent white velocities.
        intensity: Two-sided intensity of each [m^2/s].
        step: Step [s].
    """
    n = len(A)
    loan = expm(np.block([[-A, intensity * white @ white.T], [np.zeros((n, n)), A.T]]) * step)
    W = loan[n:, n:].T @ loan[:n, n:]
    return 0.5 * (W + W.T)


# ------------------------------------------------------------------------------------ linear-quadratic


def device_reach(network: Network) -> float:
    """Travel [m] at which the stop beside the motor of `network` is met; that of the paper's device where it has none."""
    motor = next((e for e in network.elements if isinstance(e, el.Motor)), None)
    stops = [e for e in network.elements if isinstance(e, el.BumpStop)]
    beside = [e.clearance for e in stops if motor is not None and set(e.where) == set(motor.where)]
    return min(beside) if beside else paper_reach()


@functools.cache
def paper_reach() -> float:
    """Travel [m] of the paper's device: the deputy cylinder's stroke over the ratio of areas (Table 1)."""
    return next(e.clearance for e in Network.load(PAPER_CAR).elements if isinstance(e, el.BumpStop))


@dataclass(frozen=True)
class Weights:
    """Quadratic weights of a design: the stage cost, and what shapes it.

    move [1/A^2] on the change of current per step; effort [1/A^2] on the current; centring [-] on the device's travel
    over its `reach` [m], see `device_reach`: nothing else holds it in the middle.
    """

    cost: StageCost
    move: float = 0.0
    effort: float = 0.0
    centring: float = 0.01
    reach: float = field(default_factory=paper_reach)

    @property
    def signals(self) -> np.ndarray:
        """Diagonal (6,) on the signals."""
        a, l, f, _ = self.cost.quadratic
        return np.array([a, l, 0.0, self.centring / self.reach**2, 0.0, f])

    @property
    def current(self) -> float:
        return self.cost.quadratic[3] + self.effort


def _riccati(model: Model | CarModel, *matrices: np.ndarray) -> np.ndarray:
    try:
        return solve_discrete_are(*matrices[:4], s=matrices[4] if len(matrices) > 4 else None)
    except np.linalg.LinAlgError:
        raise InputError(
            f"network '{model.network.name}' has no linear-quadratic controller: "
            "something in it neither decays nor can be moved or seen"
        ) from None


def regulator(model: Model, weights: Weights) -> tuple[np.ndarray, np.ndarray]:
    """LQR without friction: (gain K (n,) of ``I = -K x``, value matrix V (n, n))."""
    q = weights.signals[:, None]
    C, D = model.C @ model.A, model.C @ model.B + model.D  # signals at the end of the step
    Q, R = C.T @ (q * C), np.array([[D @ (q[:, 0] * D) + weights.current]])
    N = (C.T @ (q[:, 0] * D))[:, None]
    V = _riccati(model, model.A, model.B[:, None], Q, R, N)
    K = np.linalg.solve(R + model.B[None] @ V @ model.B[:, None], model.B[None] @ V @ model.A + N.T)[0]
    return K, V


def preview_regulator(model: Model, weights: Weights, points: int) -> tuple[np.ndarray, np.ndarray]:
    """LQR that knows the road `points` steps ahead: (K (n,), G (points,)) of ``I = -K x - G . rises`` [1/m].

    The value of a state x with known rises is ``x' V x + 2 x' s``, and s follows from the rises backwards through the closed
    loop (Tomizuka, ASME Journal of Dynamic Systems 97, 1975). K is `regulator`'s.
    """
    K, V = regulator(model, weights)
    q = weights.signals[:, None]
    Mxx = V + model.C.T @ (q * model.C)
    across = model.B @ Mxx + model.D @ (
        q * model.C
    )  # what a change of the next state adds to the slope by the current
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
    """LQR of the change of current, state (x, I before): (gain (n+1,), value matrix (n+1, n+1))."""
    n = model.n
    A = np.zeros((n + 1, n + 1))
    A[:n, :n], A[:n, n], A[n, n] = model.A, model.B, 1.0
    B = np.append(model.B, 1.0)[:, None]
    C = np.column_stack([model.C @ model.A, model.C @ model.B + model.D])
    D = (model.C @ model.B + model.D)[:, None]
    q = weights.signals[:, None]
    Q, R, N = C.T @ (q * C), D.T @ (q * D), C.T @ (q * D)
    Q[n, n] += weights.current
    R += weights.current + weights.move
    N[n] += weights.current
    V = _riccati(model, A, B, Q, R, N)
    K = np.linalg.solve(R + B.T @ V @ B, B.T @ V @ A + N.T)[0]
    return K, V


def kalman_gain(model: Model, sensors: Sensors, noise: np.ndarray | None = None) -> np.ndarray:
    """Steady gain L (n, 5) of ``x += L (y - C x - D I)`` on the measured signals; `noise`: added to the road's."""
    return steady_gain(model, sensors.covariance, sensors.memory, model.heave[:, None], noise)


def steady_gain(
    model: Model | CarModel,
    covariance: np.ndarray,
    memory: float,
    drifts: np.ndarray,
    noise: np.ndarray | None,
) -> np.ndarray:
    """Return the steady gain L (n, signals) of a Kalman filter, ``x += L (y - C x - D I)``.

    Args:
        model: Model of a car.
        covariance: Covariance of the errors of the measured signals, the first rows of the model's C.
        memory: Time constant [s] of the absolute speeds, which nothing measures.
        drifts: States (n, k) of a car that moves with the roads at constant speed, nothing moving against anything.
        noise: Covariance of the state per step, added to the road's.
    """
    C = model.C[: len(covariance)]
    W = model.W + (0.0 if noise is None else noise)
    # rounding may leave W indefinite by a hair; a whisper of noise on every state keeps the equation well posed
    W = W + 1e-12 * np.eye(model.n) * max(np.trace(W), 1e-12)
    # a random walk of the absolute speed whose filter, against white road velocity, has this time constant
    for drift in drifts.T:
        W = W + model.road_intensity * model.step / memory**2 * np.outer(drift, drift)
    V = _riccati(model, model.A.T, C.T, W, covariance)
    return np.linalg.solve(C @ V @ C.T + covariance, C @ V).T


def closed_loop_spread(model: Model, K: np.ndarray, noise: np.ndarray | None = None) -> np.ndarray:
    """Stationary covariance (n, n) of the state under ``I = -K x``."""
    W = model.W + (0.0 if noise is None else noise)
    return stationary(model.A - np.outer(model.B, K), W)


def stationary(A: np.ndarray, W: np.ndarray, doublings: int = 14) -> np.ndarray:
    """Covariance of ``x+ = A x + w`` after 2^doublings steps (80 s at 5 ms): a free device wanders, and that is finite."""
    A, S = A.copy(), W.copy()
    for _ in range(doublings):
        S = S + A @ S @ A.T
        A = A @ A
    return S


@dataclass(frozen=True)
class Linearised:
    """A model whose friction is dampers, and the dampers [N s/m] and rate RMS [m/s] it was made with."""

    model: Model
    damping: dict[str, float]
    rate_rms: dict[str, float]
    friction_noise: np.ndarray  # covariance of the state per step, of what friction is beyond the dampers


def statistical_linearisation(
    network: Network,
    step: float,
    weights: Weights,
    *,
    road_intensity: float = ROAD_INTENSITY,
    iterations: int = 60,
) -> Linearised:
    """Friction as dampers whose level and closed-loop rate agree (section 4.2, equation 9).

    The rate RMS is that of the linear car under its own linear-quadratic regulator of the current's change; half steps
    towards it until it no longer changes. A car that would rather stick ends at a large damping (RMS at least 1 mm/s).
    """
    free = prediction_model(network, step, road_intensity=road_intensity)
    names = [free.laws[j].name for j in free.friction]
    stops = {e.name: 0.0 for e in free.laws if e.bound is None}
    rms = {name: 0.1 for name in names}
    levels = {}
    for _ in range(iterations):
        for j in free.friction:
            name = free.laws[j].name
            levels[name] = float(free.levels(rms[name])[j])
        damping = {name: equivalent_damping(levels[name], rms[name]) for name in names}
        model = prediction_model(network, step, damping=damping | stops, road_intensity=road_intensity)
        if not names or model.thrust == 0.0:
            break
        K, _ = move_regulator(model, weights)
        A = np.zeros((model.n + 1,) * 2)
        A[:-1, :-1], A[:-1, -1], A[-1, -1] = model.A, model.B, 1.0
        B = np.append(model.B, 1.0)
        W = np.zeros_like(A)
        W[:-1, :-1] = model.W
        spread = stationary(A - np.outer(B, K), W)
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
