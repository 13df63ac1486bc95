"""The likelihood of records under a linear model whose road is white in velocity, by the innovations of its Kalman filter.

Harvey, Forecasting, Structural Time Series Models and the Kalman Filter, 1989, chapter 3.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numba as nb
import numpy as np
from scipy.linalg import LinAlgError, expm, solve_discrete_are

from ..errors import InputError
from ..network import Network, linearise

if TYPE_CHECKING:
    from ..arrays import Array
    from .structure import Structure

#: [s] at the beginning of a record in which the filter finds its state
SETTLE = 1.0
#: Singular value, as a share of the largest, below which a direction of the state counts as unseen.
UNSEEN = 1e-10
#: Deviance in place of that of numbers without a stationary filter.
IMPOSSIBLE = 1e12


@nb.njit(cache=True)
def _innovations(A: Array, B: Array, C: Array, D: Array, K: Array, u: Array, y: Array, out: Array) -> None:
    """Prediction errors (n, outputs) of ``x+ = A x + B u + K e``, ``e = y - C x - D u``."""
    n, p, m = A.shape[0], C.shape[0], B.shape[1]
    x, new = np.zeros(n), np.zeros(n)
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


def seen_states(A: Array, C: Array) -> Array:
    """Return orthonormal directions of the state without the constants that no output sees.

    A damper in series has an elongation that drifts freely, and that neither a force nor an output depends on. The variance of this
    elongation grows without bound, so the stationary Riccati equation has no solution as long as the state contains it.

    Args:
        A: State matrix (n, n), continuous time.
        C: Output matrix (outputs, n).

    Returns:
        Basis (n, m), m <= n, such that ``basis.T @ A @ basis`` is the state matrix of the rest.
    """
    kept = np.eye(len(A))
    while True:
        a, c = kept.T @ A @ kept, C @ kept
        rows = np.vstack([a, c])
        rows = rows / np.maximum(np.abs(rows).max(axis=1, keepdims=True), 1e-300)  # units differ by row
        _, sizes, directions = np.linalg.svd(rows)
        rank = int(np.sum(sizes > UNSEEN * max(sizes.max(initial=0.0), 1e-300)))
        if rank == kept.shape[1]:
            return kept
        kept = kept @ directions[:rank].T


@dataclass(frozen=True)
class Number:
    """A logarithm that is fitted, with its prior."""

    name: str
    mean: float
    sigma: float


@dataclass(frozen=True)
class Prediction:
    """One-step prediction errors of the Kalman filter."""

    errors: tuple[Array, ...]  # of each record, (samples, outputs), without the first `SETTLE` seconds
    covariance: Array  # that the filter expects of them, (outputs, outputs)

    @cached_property
    def whitening(self) -> Array:
        """Matrix W (outputs, outputs) such that W e has the covariance 1."""
        return np.linalg.inv(np.linalg.cholesky(self.covariance))

    @property
    def samples(self) -> int:
        return sum(len(e) for e in self.errors)

    @cached_property
    def deviance(self) -> float:
        """-2 log L, without constants."""
        logdet = -2.0 * float(np.sum(np.log(np.diag(self.whitening))))
        power = sum(float(np.sum((e @ self.whitening.T) ** 2)) for e in self.errors)
        return power + self.samples * logdet


@dataclass(frozen=True)
class Likelihood:
    """-2 log L of records (inputs (n, inputs) and outputs (n, channels) in SI, every `step` [s]) under a model without its road.

    road: name of the input, others: those that were measured; rubs: laws that count as dampers of unknown strength.
    """

    structure: Structure
    road: str
    records: tuple[tuple[Array, Array], ...]
    step: float
    rubs: tuple[str, ...]
    others: tuple[str, ...]
    numbers: tuple[Number, ...] = field(default=())

    def network(self, x: Array) -> Network:
        return self.structure.at(x[: len(self.structure.free)])

    def prior(self, x: Array) -> float:
        """Return -2 log of the prior density of the numbers `x`, without constants."""
        return float(sum(((v - n.mean) / n.sigma) ** 2 for v, n in zip(x, self.numbers, strict=True)))

    def __call__(self, x: Array) -> float:
        """Return -2 log L with the prior, or `IMPOSSIBLE` where the numbers `x` give no stationary filter."""
        found = self.predict(x)
        return IMPOSSIBLE if found is None else self.prior(x) + found.deviance

    def predict(self, x: Array) -> Prediction | None:
        """Return the prediction errors at the numbers `x`, or None where the numbers give no stationary filter."""
        own = len(self.structure.free)
        rest = np.exp(np.clip(x[own:], -80.0, 80.0))
        level, damping, noise = rest[0], rest[1 : 1 + len(self.rubs)], rest[1 + len(self.rubs) :]
        try:
            with np.errstate(all="ignore"):  # of an unstable filter the errors overflow: it has no deviance
                space = linearise(
                    self.network(x), damping=dict(zip(self.rubs, damping.tolist(), strict=True))
                )
                found = self._of(space, level, noise)
                return found if math.isfinite(found.deviance) else None
        except (InputError, ArithmeticError, ValueError, LinAlgError):
            return None

    def _of(self, space: Any, level: float, noise: Array) -> Prediction:
        h, j = self.step, space.inputs.index(self.road)
        if {*space.inputs} - {self.road, *self.others}:
            raise InputError(f"an output sees the acceleration of '{self.road}' itself")
        known = [space.inputs.index(c) for c in self.others]
        kept = seen_states(space.A, space.C)
        A, B, C = kept.T @ space.A @ kept, kept.T @ space.B, space.C @ kept
        n, G = len(A), B[:, [j]]
        big = np.zeros((2 * n, 2 * n))  # Van Loan: the noise that the road adds over a step
        big[:n, :n], big[:n, n:], big[n:, n:] = -A * h, level * G @ G.T * h, A.T * h
        phi = expm(big)
        hold = np.zeros((n + len(known), n + len(known)))
        hold[:n, :n], hold[:n, n:] = A * h, B[:, known] * h
        A = phi[n:, n:].T
        Q = A @ phi[:n, n:]
        B = expm(hold)[:n, n:]
        D, R = space.D[:, known], np.diag(noise**2)
        P = solve_discrete_are(A.T, C.T, 0.5 * (Q + Q.T), R)
        S = C @ P @ C.T + R
        K = np.linalg.solve(S, C @ P @ A.T).T
        skip, errors = round(SETTLE / h), []
        A, B, C, D, K = (np.ascontiguousarray(m) for m in (A, B, C, D, K))
        for u, y in self.records:
            e = np.empty_like(y)
            _innovations(A, B, C, D, K, u, y, e)
            errors.append(e[skip:])
        return Prediction(tuple(errors), S)
