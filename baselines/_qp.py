"""A small dense quadratic program with changing vectors, solved by OSQP."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from scipy import sparse


@dataclass(frozen=True)
class Outcome:
    """Result of a solver: solution (n,), None without a reliable one, and status."""

    x: np.ndarray | None
    status: str


class Program(Protocol):
    """The program min 1/2 x'Px + q'x with low <= Ax <= high; P and A are fixed at construction."""

    def solve(
        self, q: np.ndarray, low: np.ndarray, high: np.ndarray, guess: np.ndarray
    ) -> Outcome: ...


class Osqp:
    """OSQP with one setup and warm starts, for the cost P (n, n) and the constraints A (m, n). An inaccurate
    solution is accepted, since the controller limits its command."""

    def __init__(self, P: np.ndarray, A: np.ndarray) -> None:
        import osqp

        self._made = P, A
        self._solver: Any = osqp.OSQP()
        m, n = A.shape
        self._solver.setup(
            P=sparse.csc_matrix(np.triu(P)),
            q=np.zeros(n),
            A=sparse.csc_matrix(A),
            l=-np.ones(m),
            u=np.ones(m),
            verbose=False,
            eps_abs=1e-4,
            eps_rel=1e-4,
            max_iter=1000,
            check_termination=10,
            adaptive_rho=True,
            adaptive_rho_interval=25,  # the default of 50 cycles if two limits nearly coincide
            polishing=False,
        )
        # the wrapper copies every number, which takes longer than the solution
        self._bare = self._solver._solver
        self._infinite = self._solver.constant("OSQP_INFTY")
        self._good = (
            osqp.SolverStatus.OSQP_SOLVED,
            osqp.SolverStatus.OSQP_SOLVED_INACCURATE,
        )

    def __reduce__(self) -> tuple[Any, ...]:
        """Return a recipe for a new setup in another process, without the warm start; the solver itself cannot be pickled."""
        return type(self), self._made

    def solve(
        self, q: np.ndarray, low: np.ndarray, high: np.ndarray, guess: np.ndarray
    ) -> Outcome:
        """Solve the program."""
        bare, most = self._bare, self._infinite
        # the solver reads contiguous memory and ignores strides
        q = np.ascontiguousarray(q)
        guess = np.ascontiguousarray(guess)
        bare.update_data_vec(q=q, l=np.maximum(low, -most), u=np.minimum(high, most))
        bare.warm_start(guess, None)
        bare.solve()
        info, x = bare.info, bare.solution.x
        good = info.status_val in self._good and bool(np.isfinite(x).all())
        return Outcome(x.copy() if good else None, info.status)
