"""The value of news of the road for a linear car."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from isd_gym._common.errors import InputError
from isd_gym.physics import elements as el
from isd_gym.physics._prediction import (
    Model,
    Weights,
    device_reach,
    prediction_model,
    statistical_linearisation,
)
from isd_gym.physics.simulate import PHYSICS_STEP

if TYPE_CHECKING:
    from isd_gym.physics.cost import StageCost
    from isd_gym.physics.network import Network
    from isd_gym.physics.road import Road

CONTROL_STEP = 5e-3


@dataclass(frozen=True)
class Penalty:
    """Deduction from the summed cost of an episode: ``constant + sum_k on_state[k] . x[k] + on_current[k] I[k]``.

    x (n,) are the network's states at the start of control step k, and I [A] is the current of the step.

    Attributes:
        on_state: Slopes (steps, n).
        on_current: Slopes (steps,) [1/A].
        constant: Constant [-].
    """

    on_state: np.ndarray
    on_current: np.ndarray
    constant: float


@dataclass(frozen=True)
class CeilingSettings:
    """Parameters of the penalty's value function; any choice gives a valid bound.

    Attributes:
        move: Weight on the change of current, instead of the slew limit [1/A^2].
        effort: Weight on the current, instead of the current limit [1/A^2].
        centring: Weight on the device's travel over its stop, instead of the stop [-].

    Raises:
        InputError: A weight is negative.
    """

    move: float = 0.1
    effort: float = 0.0
    centring: float = 0.04

    def __post_init__(self) -> None:
        if not (self.move >= 0 and self.effort >= 0 and self.centring >= 0):
            raise InputError("weights of the penalty must be >= 0")


class NewsValue:
    """The linear-quadratic car over one episode, and the value of news of the road.

    X (n + 1,) is the state above the road with the preceding current. M[k] are weights of (x after step k, I
    of step k) including the stage cost of step k; V[k] are weights of X_k. loop[k] maps X_k to (x_k+1, I_k)
    under the optimal law; worth[k] is the curvature with respect to the current.

    Args:
        network: The plant.
        road: A rough road.
        speed: Speed [m/s].
        steps: Number of control steps.
        cost: Stage cost.
        control_step: Control step [s].
        settings: Weights of the value function; None for the defaults.

    Raises:
        InputError: The road has a fixed profile, or the network has no motor.
    """

    def __init__(
        self,
        network: Network,
        road: Road,
        speed: float,
        steps: int,
        cost: StageCost,
        control_step: float = CONTROL_STEP,
        settings: CeilingSettings | None = None,
    ) -> None:
        s = settings or CeilingSettings()
        weights = Weights(cost, s.move, s.effort, s.centring, reach=device_reach(network))
        self.noise, self.pole = road.noise(speed, PHYSICS_STEP)
        if not self.noise > 0 or road.profile is not None:
            raise InputError(
                f"road '{road.name}' is no rough road alone (paper, A ... H): nothing about it is news"
            )
        self.sub = round(control_step / PHYSICS_STEP)
        intensity = self.noise**2 / PHYSICS_STEP
        linear = statistical_linearisation(
            network, control_step, replace(weights, move=max(s.move, 1e-3)), road_intensity=intensity
        )
        self.model: Model = linear.model
        if self.model.thrust == 0.0:
            raise InputError(f"network '{network.name}' has no motor")
        dampers = {e.name: 0.0 for e in network.elements if isinstance(e, el.BumpStop)} | linear.damping
        fine = prediction_model(network, PHYSICS_STEP, damping=dampers, road_intensity=intensity)
        # response of the state after a control step to a rise of the road in each of its physics steps
        powers = [np.linalg.matrix_power(fine.A, self.sub - 1 - i) @ fine.P for i in range(self.sub)]
        self.response = np.array(powers).T  # (n, sub)
        self.W = self.noise**2 * self.response @ self.response.T
        self._riccati(weights, steps)

    def _riccati(self, weights: Weights, steps: int) -> None:
        m, n = self.model, self.model.n
        F = np.zeros((n + 1, n + 1))
        F[:n, :n], F[:n, n], F[n, n] = m.A, m.B, 1.0
        b = np.append(m.B, 1.0)
        Y = np.column_stack([m.C, m.D])  # signals at the end of a step, as rows over (x, I)
        stage = Y.T @ (weights.signals[:, None] * Y)
        stage[n, n] += weights.current
        V = np.zeros((n + 1, n + 1))
        self.M, self.loop = np.zeros((steps, n + 1, n + 1)), np.zeros((steps, n + 1, n + 1))
        self.worth, self.V = np.zeros(steps), np.zeros((steps, n + 1, n + 1))
        for k in range(steps - 1, -1, -1):
            M = V + stage
            g = M @ b
            r = b @ g + weights.move
            self.M[k], self.worth[k] = M, r
            self.loop[k] = F - np.outer(b, g @ F) / r
            V = F.T @ M @ F - np.outer(F.T @ g, g @ F) / r
            self.V[k] = V = 0.5 * (V + V.T)
        self.b = b

    def value(self, preview: int = 0) -> float:
        """Return the mean cost per step of the linear car from rest, from the Riccati equation.

        Args:
            preview: Known road ahead [control steps].

        Returns:
            Mean stage cost [-].
        """
        n = self.model.n
        if preview == 0:
            return float(np.einsum("kij,ji->", self.M[:, :n, :n], self.W) / len(self.M))
        return -self._ahead(np.zeros((len(self.M), n)), preview)[2] / len(self.M)

    def news(self, heights: np.ndarray) -> np.ndarray:
        """Return the news of the road in each control step, as changes of the state.

        Args:
            heights: Heights of the road at every physics step [m].

        Returns:
            Changes (steps, n).
        """
        rises = heights[1:] - self.pole * heights[:-1]
        return rises.reshape(-1, self.sub) @ self.response.T

    def penalty(self, heights: np.ndarray, preview: int = 0) -> tuple[Penalty, np.ndarray]:
        """Return the penalty of a road for policies with a given preview.

        Args:
            heights: Heights of the road at every physics step [m].
            preview: Known road ahead [control steps].

        Returns:
            The penalty, and the slope (steps, n + 1) of the value of X_k due to the known road: ``X' V X + 2
                slope . X``.

        Raises:
            InputError: The preview is negative or too long.
        """
        if preview < 0:
            raise InputError(f"a preview of {preview} steps is none")
        d, n = self.news(heights), self.model.n
        steps = len(d)
        if preview == 0:
            seen = np.einsum("ki,kij->kj", d, self.M[:, :n])  # d' M, on (x, I)
            by_state = 2 * seen[:, :n] @ self.model.A
            by_current = 2 * (seen[:, :n] @ self.model.B + seen[:, n])
            constant = float(np.sum(seen[:, :n] * d)) - steps * self.value()
            slope = np.zeros((steps, n + 1))
        else:
            by_state, by_current, constant, slope = self._ahead(d, preview)
        # in the coordinates of the assembly, positions are not relative to the road
        lifted = float(heights[:: self.sub][:-1] @ (by_state @ self.model.lift))
        return Penalty(by_state, by_current, constant - lifted), slope

    def _ahead(self, d: np.ndarray, preview: int) -> tuple[np.ndarray, np.ndarray, float, np.ndarray]:
        """Return slopes of the penalty by state and current, its constant, and the known part, for a preview of
        at least one step.

        The news of step m are known from step m - preview + 1 on, before the current of that step. Their
        effect on the value is propagated backwards: `slope[m]` is the slope of the value of (x, I) after step
        m - lag due to the news of step m.
        """
        n, steps = self.model.n, len(d)
        M, r, b = self.M, self.worth, self.b
        slope = M[:, :, :n].copy()
        own = np.einsum("kij,kj->ki", slope, d)  # (steps, n + 1)
        # of the news alone: d' (M - g g' / r) d minus its mean
        across = np.einsum("kij,i->kj", slope, b)
        left = M[:, :n, :n] - np.einsum("ki,kj->kij", across, across) / r[:, None, None]
        constant = float(np.einsum("ki,kij,kj->", d, left, d) - np.einsum("kij,ji->", left, self.W))
        # slope of the value of (x, I) after step j due to the known road of later steps
        known = np.zeros((steps, n + 1))
        for lag in range(1, min(preview, steps)):
            back = np.zeros_like(slope)
            back[lag:] = np.einsum("kij,kil->kjl", self.loop[1 : steps - lag + 1], slope[lag:])
            slope = back
            j = slice(0, steps - lag)  # steps whose law depends on the news of step j + lag
            new = np.einsum("kij,kj->ki", slope[lag:], d[lag:])
            old = own[j] + known[j]
            spread = np.einsum("kij,i->kj", slope[lag:], b)
            mean = np.einsum("ki,ij,kj->k", spread, self.W, spread)
            terms = 2 * np.einsum("ki,ki->k", d[j], new[:, :n])
            terms -= (2 * (old @ b) * (new @ b) + (new @ b) ** 2 - mean) / r[j]
            constant += float(terms.sum())
            known[j] += new
        # on (x, I) after step k, due to the news of step k + preview
        on = np.zeros((steps, n + 1))
        if preview < steps:
            last = np.einsum("kij,kil->kjl", self.loop[1 : steps - preview + 1], slope[preview:])
            on[: steps - preview] = 2 * np.einsum("kij,kj->ki", last, d[preview:])
        by_state = np.zeros((steps, n))
        by_state[1:] = on[:-1, :n]
        before = np.zeros_like(known)
        before[1:] = (known + 0.5 * on)[:-1]  # the state of rest at the start contributes nothing
        return by_state, on[:, n], constant, before
