"""The paper's model predictive control (section 4.2) from measured signals, under the limits of Table 5.

Equation (9) is the car with its friction as a damper (statistical linearisation). A Kalman filter estimates
state and road. A small quadratic program at every step gives the changes of current over the horizon, of
which the first is used. The objective is the stage cost at every step of the horizon.

Tuned on roads 1000-1007, J against passive: -21.88 % as shipped, move 0.03 -21.67, centring 0.1 -21.50, tyre
load weight 0.1 -21.95 (on roads 3000-3015 -20.97 instead of -20.90). The tyre load weight is an option and
not the default, since the paper has no such term.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from scipy.special import erf

from isd_gym._common.errors import InputError
from isd_gym.physics.prediction import (
    ROAD_INTENSITY,
    Model,
    Sensors,
    Weights,
    device_reach,
    move_regulator,
    prediction_model,
    statistical_linearisation,
)
from isd_gym.physics.vehicle import CURRENT_LIMIT

from ._estimator import Estimator
from ._qp import Osqp, Program
from .controller import CURRENT, DesignedController

__all__ = [
    "MpcSettings",
]


ACCELERATION_LIMIT = 5.0  # m/s^2, Table 5
TRAVEL_LIMIT = 0.08  # m, Table 5
# weights of a violated limit, far above the stage cost at the limits
SLACK_LINEAR, SLACK_QUADRATIC = 1e2, 1e3


@dataclass(frozen=True)
class MpcSettings:
    """Settings of the paper's controller, including choices that the paper leaves open. Weights are in addition
    to the stage cost.

    Raises:
        InputError: Moves do not fit into the horizon, or the kind of friction is unknown.
    """

    horizon: int = 20  # horizon [steps]
    #: lengths of the pieces with constant change of current [steps]; the change is zero afterwards
    moves: tuple[int, ...] = (1, 1, 2, 3, 5, 8)
    move: float = 0.05  # weight of the change of current [1/A^2]
    tyre_load: float = 0.0  # weight of the tyre load [-]
    centring: float = 0.05  # weight of the device's travel over its stop [-]
    terminal: bool = True  # whether the cost-to-go of the linear regulator is added after the horizon
    #: 'equivalent' for the damper of equation (9) alone; 'planned' adds the difference between friction and
    #: damper along the last plan, whose rates are known in advance, averaged over the effect of the road
    friction: str = "planned"
    spread: float = 1.0  # factor on the effect of the road in 'planned' [-]
    # standard deviation of the estimator's friction per step [N]
    friction_noise: float = 300.0
    #: class of the quadratic program (`_qp.Program`); other solvers are compared in
    #: `docs/explanation/baselines.md`
    solver: Callable[[np.ndarray, np.ndarray], Program] = Osqp
    #: standard deviations of the measurements in the estimator
    sensors: Sensors = field(default_factory=Sensors)
    # two-sided intensity of the road's velocity [m^2/s]
    road_intensity: float = ROAD_INTENSITY

    def __post_init__(self) -> None:
        if (
            self.horizon < 1
            or not self.moves
            or min(self.moves) < 1
            or sum(self.moves) > self.horizon
        ):
            raise InputError(
                f"moves {self.moves} must be positive lengths that fit into the horizon of {self.horizon}"
            )
        if self.friction not in ("equivalent", "planned"):
            raise InputError(
                f"friction must be equivalent or planned, not {self.friction!r}"
            )


#: horizons as the default of a toolbox: 10 steps with 2 moves, no cost-to-go, a tenth of the move weight's
#: unit
PAPER = MpcSettings(
    horizon=10,
    moves=(1, 1),
    move=0.1 / CURRENT_LIMIT**2,
    terminal=False,
    friction="equivalent",
    centring=0.0,
)


class Mpc(DesignedController[MpcSettings]):
    """The predictive controller of many cars, with a quadratic program each. `status` is the last status of a solver."""

    usual = "mpc"
    default = MpcSettings()

    def _design(self) -> None:
        s, model = self.settings, self.model
        self.weights = w = Weights(
            self.cost, move=s.move, centring=s.centring, reach=device_reach(model)
        )
        # a regulator must hold the device at some position
        design = replace(w, centring=max(w.centring, 1e-3))
        self.linear = statistical_linearisation(
            model, self.step, design, road_intensity=s.road_intensity
        )
        linear = self.linear.model
        free = prediction_model(model, self.step, road_intensity=s.road_intensity)
        self.planned = (
            s.friction == "planned" and bool(free.friction) and free.thrust > 0.0
        )
        if s.friction == "planned":
            self.estimator = Estimator(free, s.sensors, s.friction_noise)
        else:
            self.estimator = Estimator(
                linear, s.sensors, 0.0, self.linear.friction_noise
            )
        self._passive = free.thrust == 0.0
        if not self._passive:
            self._condense(linear, free, design)

    # -------------------------------------------------------------------------------------- offline

    def _condense(self, m: Model, free: Model, design: Weights) -> None:
        """Express the whole horizon as a matrix on (state, present current, friction beyond the damper, moves)."""
        s = self.settings
        N = self.settings.horizon
        n = m.n
        pieces = len(s.moves)
        spread_out = np.zeros((N, pieces))  # change of current per step, by move
        start = 0
        for j, length in enumerate(s.moves):
            spread_out[start : start + length, j] = 1.0
            start += length
        self._steps = spread_out
        self._currents = np.cumsum(spread_out, axis=0)
        # the plan one step later, in the same pieces
        later = np.vstack([spread_out[1:], np.zeros((1, pieces))])
        self._later = np.linalg.lstsq(spread_out, later, rcond=None)[0]
        nf = len(free.friction) if self.planned else 0
        G = free.G[:, free.friction]
        S = free.S[free.friction]
        self._damping = np.array(
            [self.linear.damping[free.laws[j].name] for j in free.friction]
        )
        self._levels = free.levels()[free.friction]
        # columns: x (n), present current (1), friction (N * nf), moves
        width = n + 1 + N * nf + pieces
        x = np.zeros((n, width))
        x[:, :n] = np.eye(n)
        signals = np.empty((N, 6, width))
        rates = np.empty((N, len(free.friction), width))
        for k in range(N):
            current = np.zeros(width)
            current[n] = 1.0
            current[n + 1 + N * nf :] = self._currents[k]
            x = m.A @ x + np.outer(m.B, current)
            for j in range(nf):
                x[:, n + 1 + k * nf + j] += G[:, j]
            signals[k] = m.C @ x + np.outer(m.D, current)
            rates[k] = S @ x
        u = slice(n + 1 + N * nf, width)
        given = slice(0, u.start)
        q = self.weights.signals
        H = np.einsum("kiu,i,kiw->uw", signals[:, :, u], q, signals)
        effort = np.zeros((N, width))
        effort[:, n], effort[:, u] = 1.0, self._currents
        H += self.weights.current * effort[:, u].T @ effort
        H[:, u] += s.move * spread_out.T @ spread_out
        if s.terminal:
            _, V = move_regulator(m, design)
            end = np.vstack([x, effort[-1]])
            H += end[:, u].T @ V @ end
        P = 2 * H[:, u]
        self._P = 0.5 * (P + P.T)
        self._linear_term = 2 * H[:, given]
        self._inverse = np.linalg.inv(self._P)
        ends = np.cumsum(s.moves) - 1
        self._rows = np.vstack([np.eye(pieces), self._currents[ends]])
        # without the present current, the second half
        self._high = np.repeat([self.slew, CURRENT_LIMIT], pieces)
        self._low = -self._high
        # one solver per car, created on demand: it starts from its last solution
        self._programs: dict[int, Program] = defaultdict(
            partial(s.solver, self._P, self._rows)
        )
        # acceleration and travel have soft limits: two additional slacks, in a program that is rarely needed
        self._soft_given = signals[:, :2, given].transpose(1, 0, 2).reshape(2 * N, -1)
        self._soft_moves = signals[:, :2, u].transpose(1, 0, 2).reshape(2 * N, -1)
        self._soft_limits = np.repeat([ACCELERATION_LIMIT, TRAVEL_LIMIT], N)
        slack = np.zeros((2 * N, 2))
        slack[:N, 0], slack[N:, 1] = ACCELERATION_LIMIT, TRAVEL_LIMIT
        P_soft = np.zeros((pieces + 2,) * 2)
        P_soft[:pieces, :pieces] = self._P
        P_soft[pieces:, pieces:] = 2 * SLACK_QUADRATIC * np.eye(2)
        hard = np.hstack([self._rows, np.zeros((len(self._rows), 2))])
        soft = np.vstack(
            [
                hard,
                np.hstack([self._soft_moves, -slack]),
                np.hstack([self._soft_moves, slack]),
                np.hstack([np.zeros((2, pieces)), np.eye(2)]),
            ]
        )
        self._soft_programs: dict[int, Program] = defaultdict(
            partial(s.solver, P_soft, soft)
        )
        self._rates_given = rates[:, :, given]
        self._rates_moves = rates[:, :, u]
        # effect of the road on the rates k steps ahead, without feedback
        V = np.zeros((n, n))
        deviations = np.empty((N, len(free.friction)))
        for k in range(N):
            V = m.A @ V @ m.A.T + m.W
            deviations[k] = np.sqrt(np.einsum("ji,ik,jk->j", S, V, S))
        self._deviations = np.maximum(s.spread * deviations, 1e-4)
        self._nf = nf

    # --------------------------------------------------------------------------------------- online

    def _start(self, count: int) -> None:
        self.estimator.reset(count)
        self.status = "idle"
        if not self._passive:
            self._moves = np.zeros((len(self.settings.moves), count))
            self._rates = np.zeros((self.settings.horizon, len(self._levels), count))
            self._has_plan = np.zeros(count, bool)

    def _command(self, obs: np.ndarray) -> np.ndarray:
        x = self.estimator.update(obs)
        present = obs[CURRENT]
        return (
            np.zeros_like(present)
            if self._passive
            else present + self._solve(x, present)[0]
        )

    @property
    def plan(self) -> np.ndarray:
        """Planned currents over the horizon (horizon, cars), relative to the current at the time of planning [A]."""
        return self._currents @ self._moves

    def _solve(self, x: np.ndarray, present: np.ndarray) -> np.ndarray:
        """Return moves (pieces, cars) [A per step] for states (n, cars) and currents (cars,); failures are
        counted as fallbacks."""
        parts = [x, present[None]]
        if self._nf:
            share = self._rates / (np.sqrt(2) * self._deviations)[:, :, None]
            beyond = (
                self._levels[:, None] * erf(share)
                - self._damping[:, None] * self._rates
            )
            parts.append(beyond.reshape(-1, len(present)))
        given = np.concatenate(parts)
        q = self._linear_term @ given
        guess = self._later @ self._moves
        low, high = (
            np.repeat(v[:, None], len(present), axis=1) for v in (self._low, self._high)
        )
        low[len(guess) :] -= present
        high[len(guess) :] -= present
        moves = -self._inverse @ q  # the optimum without limits is often feasible
        self.status = "solved"
        rows = self._rows @ moves
        for i in np.flatnonzero(((rows < low) | (rows > high)).any(axis=0)).tolist():
            outcome = self._programs[i].solve(
                q[:, i], low[:, i], high[:, i], guess[:, i]
            )
            self.status = outcome.status
            moves[:, i] = np.nan if outcome.x is None else outcome.x
        ahead = self._soft_given @ given
        beyond = np.abs(ahead + self._soft_moves @ moves) > self._soft_limits[:, None]
        for i in np.flatnonzero(beyond.any(axis=0)).tolist():
            self._soften(
                i, q[:, i], low[:, i], high[:, i], ahead[:, i], guess[:, i], moves[:, i]
            )
        lost = np.isnan(moves[0])
        if lost.any():
            # the rest of the last plan; without a plan, towards zero current
            self.fallbacks += int(lost.sum())
            moves[:, lost] = guess[:, lost]
            fresh = lost & ~self._has_plan
            moves[:, fresh] = 0.0
            moves[0, fresh] = -np.clip(present[fresh], -self.slew, self.slew)
        self._has_plan |= ~lost
        self._moves = moves
        if self._nf:
            rates = self._rates_given @ given + self._rates_moves @ moves
            self._rates[:-1], self._rates[-1] = rates[1:], rates[-1]
        return moves

    def _soften(
        self,
        car: int,
        q: np.ndarray,
        low: np.ndarray,
        high: np.ndarray,
        ahead: np.ndarray,
        guess: np.ndarray,
        moves: np.ndarray,
    ) -> None:
        """Plan again in place with soft limits, for plans that exceed a limit of acceleration or travel."""
        none = np.full_like(ahead, np.inf)
        outcome = self._soft_programs[car].solve(
            np.append(q, [SLACK_LINEAR, SLACK_LINEAR]),
            np.concatenate([low, -none, -self._soft_limits - ahead, [0.0, 0.0]]),
            np.concatenate([high, self._soft_limits - ahead, none, [np.inf, np.inf]]),
            np.append(guess, [0.0, 0.0]),
        )
        self.status = outcome.status
        if outcome.x is None:  # without the soft limits
            self.fallbacks += 1
        else:
            moves[:] = outcome.x[: len(moves)]
