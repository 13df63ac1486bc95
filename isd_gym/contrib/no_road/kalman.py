"""Kalman filter of a linear model driven by a road with white, unmeasured velocity.

The one-step prediction errors (innovations) of the stationary filter give the deviance, -2 log L, of measured records.

References:
    Harvey, Forecasting, Structural Time Series Models and the Kalman Filter, 1989, chapter 3.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from scipy.linalg import LinAlgError, expm, solve_discrete_are

from isd_gym._common.errors import InputError
from isd_gym.physics._kernel.jit import compiled
from isd_gym.physics.network import Network, linearise

if TYPE_CHECKING:
    from isd_gym._common.arrays import Array
    from isd_gym.diagnosis._estimation.structure import Structure
    from isd_gym.physics.network import StateSpace

#: Settling time of the filter at the beginning of a record, without prediction errors [s].
SETTLE = 1.0
#: Singular value, relative to the largest, below which a direction of the state is unobservable.
UNOBSERVABLE = 1e-10
#: Gain of the road's acceleration, relative to the largest gain of its velocity, that counts as zero.
ROUND_OFF = 1e-9
#: Deviance of parameters without a stationary filter.
IMPOSSIBLE = 1e12


@compiled()
def _compute_innovations(A: Array, B: Array, C: Array, D: Array, K: Array, u: Array, y: Array) -> Array:
    """Return prediction errors e (samples, outputs) of ``x+ = A x + B u + K e``, ``e = y - C x - D u``."""
    n, p, m = A.shape[0], C.shape[0], B.shape[1]
    x, new, out = np.zeros(n), np.zeros(n), np.empty_like(y)
    for k in range(y.shape[0]):
        for i in range(p):
            s = y[k, i]
            for j in range(n):
                s -= C[i, j] * x[j]
            for j in range(m):
                s -= D[i, j] * u[k, j]
            out[k, i] = s
        for i in range(n):
            s = 0.0
            for j in range(n):
                s += A[i, j] * x[j]
            for j in range(m):
                s += B[i, j] * u[k, j]
            for j in range(p):
                s += K[i, j] * out[k, j]
            new[i] = s
        x[:] = new
    return out


def find_observable_states(A: Array, C: Array) -> Array:
    """Return orthonormal directions of the observable states.

    The elongation of a damper in series drifts freely, and no output depends on the elongation. The variance of the
    elongation grows without bound, so the stationary Riccati equation has no solution for the whole state.

    Args:
        A: State matrix (n, n), continuous time.
        C: Output matrix (outputs, n).

    Returns:
        Basis (n, m), m <= n; ``basis.T @ A @ basis`` is the state matrix of the observable states.
    """
    kept = np.eye(len(A))
    while True:
        rows = np.vstack([kept.T @ A @ kept, C @ kept])
        rows = rows / np.maximum(np.abs(rows).max(axis=1, keepdims=True), 1e-300)  # units differ by row
        _, sizes, directions = np.linalg.svd(rows)
        rank = int(np.sum(sizes > UNOBSERVABLE * max(sizes.max(initial=0.0), 1e-300)))
        if rank == kept.shape[1]:
            return kept
        kept = kept @ directions[:rank].T


@dataclass(frozen=True)
class Prior:
    """Gaussian prior of a fitted number."""

    name: str
    mean: float
    sigma: float


@dataclass(frozen=True)
class Prediction:
    """One-step prediction errors of the Kalman filter."""

    #: Errors by record (samples, outputs) in SI units, without the first `SETTLE` seconds.
    errors: tuple[Array, ...]
    covariance: Array  # predicted covariance of the errors (outputs, outputs)

    @cached_property
    def whitening(self) -> Array:
        """Matrix W (outputs, outputs) for unit covariance of W e."""
        return np.linalg.inv(np.linalg.cholesky(self.covariance))

    @property
    def samples(self) -> int:
        """Number of samples in the records."""
        return sum(len(e) for e in self.errors)

    @cached_property
    def deviance(self) -> float:
        """-2 log L of the records, without constants."""
        logdet = -2.0 * float(np.sum(np.log(np.diag(self.whitening))))
        power = sum(float(np.sum((e @ self.whitening.T) ** 2)) for e in self.errors)
        return power + self.samples * logdet


@dataclass(frozen=True)
class KalmanModel:
    """Linear model of records without their road.

    The fitted numbers x (n,) are, in this order: the free parameters of the structure, the logarithm of the road level, the
    logarithms of the damping in place of friction, and the logarithms of the noise of the outputs.
    """

    structure: Structure  # the network in the frame of the road, with its free parameters
    road: str  # name of the unmeasured input
    #: Inputs (samples, inputs) and outputs (samples, outputs) by record about the means, in SI units.
    records: tuple[tuple[Array, Array], ...]
    step: float  # sampling interval [s]
    frictions: tuple[str, ...]  # friction elements, replaced by dampers of unknown strength
    inputs: tuple[str, ...]  # names of the measured inputs
    #: Priors of the fitted numbers (n,).
    priors: tuple[Prior, ...] = ()

    def network(self, x: Array) -> Network:
        """Return the network with the parameters in `x` (n,)."""
        return self.structure.at(x[: len(self.structure.free)])

    def penalty(self, x: Array) -> float:
        """Return -2 log of the prior density at `x` (n,), without constants."""
        return float(sum(((v - p.mean) / p.sigma) ** 2 for v, p in zip(x, self.priors, strict=True)))

    def deviance(self, x: Array) -> float:
        """Return -2 log of likelihood and prior at `x` (n,); `IMPOSSIBLE` without a stationary filter."""
        prediction = self.predict(x)
        return IMPOSSIBLE if prediction is None else self.penalty(x) + prediction.deviance

    def predict(self, x: Array) -> Prediction | None:
        """Return the prediction errors at `x` (n,); None without a stationary filter."""
        own, frictions = len(self.structure.free), len(self.frictions)
        level, *rest = np.exp(np.clip(x[own:], -80.0, 80.0))
        damping = dict(zip(self.frictions, map(float, rest[:frictions]), strict=True))
        try:
            with np.errstate(all="ignore"):  # prediction errors of an unstable filter overflow
                space = linearise(self.network(x), damping=damping)
                found = self._filter(space, level, np.array(rest[frictions:]))
                return found if math.isfinite(found.deviance) else None
        except (InputError, ArithmeticError, ValueError, LinAlgError):
            return None

    def _filter(self, space: StateSpace, level: float, noise: Array) -> Prediction:
        """Return the prediction errors of a linear model.

        Args:
            space: State space of the network, continuous time, SI units.
            level: Two-sided intensity of the road's velocity [m^2/s].
            noise: Standard deviation of the noise (outputs,) in SI units.

        References:
            Van Loan, IEEE Transactions on Automatic Control 23 (1978) 395: discrete time, with the noise of the road
            over a sampling interval.
        """
        h, road = self.step, space.inputs.index(self.road)
        known = [space.inputs.index(c) for c in self.inputs]
        gains = np.abs(np.vstack([space.B, space.D]))
        derived = [j for j in range(gains.shape[1]) if j not in (road, *known)]
        if gains[:, derived].max(initial=0.0) > ROUND_OFF * gains[:, road].max():
            raise InputError(f"an output depends on the acceleration of '{self.road}' itself")
        kept = find_observable_states(space.A, space.C)
        A, B, C = kept.T @ space.A @ kept, kept.T @ space.B, space.C @ kept
        n, G = len(A), B[:, [road]]
        block = np.zeros((2 * n, 2 * n))
        block[:n, :n], block[:n, n:], block[n:, n:] = -A * h, level * G @ G.T * h, A.T * h
        phi = expm(block)
        hold = np.zeros((n + len(known), n + len(known)))
        hold[:n, :n], hold[:n, n:] = A * h, B[:, known] * h
        A = phi[n:, n:].T
        Q = A @ phi[:n, n:]
        B = expm(hold)[:n, n:]
        D, R = space.D[:, known], np.diag(noise**2)
        P = solve_discrete_are(A.T, C.T, 0.5 * (Q + Q.T), R)
        S = C @ P @ C.T + R
        K = np.linalg.solve(S, C @ P @ A.T).T
        A, B, C, D, K = (np.ascontiguousarray(m) for m in (A, B, C, D, K))
        skip = round(SETTLE / h)
        return Prediction(tuple(_compute_innovations(A, B, C, D, K, u, y)[skip:] for u, y in self.records), S)
