"""Quadratic programs on native OSQP: set up once, new vectors and values every step."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import osqp
from numpy.typing import NDArray
from scipy import sparse

from pisplit.checks import Array

RHO = 0.1  # OSQP's default, put back at a restart so that runs repeat
PRIMAL_TOLERANCE = 1e-2  # constraint rows are scaled to unit size; what is left is removed by the projection of u0

_Entries = tuple[NDArray[np.intp], NDArray[np.intp]]


@dataclass(frozen=True)
class QPSettings:
    """OSQP settings. The first solve has no warm start and gets more iterations than those in the loop."""

    eps: float = 1e-4
    max_iterations: int = 100
    first_max_iterations: int = 4000


@dataclass(frozen=True)
class QPResult:
    """Outcome of one solve. ``x`` is None unless the status (with the residual, at the iteration limit) vouches for it.

    ``primal_residual`` is the largest constraint violation of the iterate, in the units of the rows.
    """

    status: str
    x: Array | None
    iterations: int
    primal_residual: float


class QP:
    """minimise x'P x/2 + q'x subject to l <= A x <= u, solved again and again with warm starts.

    P (n, n) symmetric and A (k, n) are dense arrays; the solver sees their non-zeros, or those of the boolean patterns
    where given: the patterns stay fixed when ``solve`` brings new values, so an entry that may become non-zero later
    must be in them.

    Source: Stellato, Banjac, Goulart, Bemporad and Boyd, Mathematical Programming Computation 12 (2020).
    """

    def __init__(
        self,
        P: Array,
        A: Array,
        P_pattern: NDArray[np.bool_] | None = None,
        A_pattern: NDArray[np.bool_] | None = None,
        settings: QPSettings | None = None,
    ) -> None:
        self._settings = settings or QPSettings()
        self._k, self._n = A.shape
        P_csc, self._P_entries = _csc(P, np.triu(P != 0.0 if P_pattern is None else P_pattern))
        A_csc, self._A_entries = _csc(A, A != 0.0 if A_pattern is None else A_pattern)
        self._solver: Any = osqp.OSQP()
        self._solver.setup(
            P_csc,
            np.zeros(self._n),
            A_csc,
            np.full(self._k, -1.0),
            np.full(self._k, 1.0),
            eps_abs=self._settings.eps,
            eps_rel=self._settings.eps,
            max_iter=self._settings.first_max_iterations,
            check_termination=10,
            rho=RHO,
            adaptive_rho=True,
            scaling=10,
            polishing=False,
            warm_starting=True,
            verbose=False,
        )
        self._first = True
        self._y = np.zeros(self._k)

    @property
    def multipliers(self) -> Array:
        """Lagrange multipliers (k,) of the last accepted solve, zeros before."""
        return self._y

    def restart(self) -> None:
        """Forget the iterates: the next solve counts as the first."""
        self._first = True
        self._y = np.zeros(self._k)
        self._solver.update_settings(max_iter=self._settings.first_max_iterations, rho=RHO)
        self._solver.warm_start(x=np.zeros(self._n), y=self._y)

    def solve(
        self,
        q: Array,
        lower: Array,
        upper: Array,
        P: Array | None = None,
        A: Array | None = None,
        x0: Array | None = None,
        y0: Array | None = None,
    ) -> QPResult:
        """Solve for q (n,), lower and upper (k,) from the warm start x0 (n,), y0 (k,) or the last iterates.

        P and A, where given, replace the values inside the patterns.
        """
        if not np.isfinite(q).all():
            return QPResult("cost not finite", None, 0, np.inf)
        if not (lower <= upper).all():  # OSQP refuses the update and would solve the old problem; False on NaN too
            return QPResult("bounds crossed", None, 0, np.inf)
        solver = self._solver
        new_values = {}
        if P is not None:
            new_values["Px"] = P[self._P_entries]
        if A is not None:
            new_values["Ax"] = A[self._A_entries]
        solver.update(q=q, l=lower, u=upper, **new_values)
        if x0 is not None:
            solver.warm_start(x=x0, y=y0)
        answer = solver.solve(raise_error=False)
        if self._first:
            solver.update_settings(max_iter=self._settings.max_iterations)
            self._first = False
        info = answer.info
        # Statuses decide: OSQP 1.1 leaves finite numbers of 2e9 in x when the problem is infeasible.
        accepted = info.status == "solved" or (
            info.status in ("solved inaccurate", "maximum iterations reached") and info.prim_res <= PRIMAL_TOLERANCE
        )
        if accepted:
            x = np.array(answer.x)
            self._y = np.array(answer.y)
            return QPResult(info.status, x, int(info.iter), float(info.prim_res))
        self._y = np.zeros(self._k)
        solver.warm_start(x=np.zeros(self._n), y=self._y)
        return QPResult(info.status, None, int(info.iter), float(info.prim_res))


def _csc(
    matrix: Array, pattern: NDArray[np.bool_]
) -> tuple[sparse.csc_matrix, tuple[NDArray[np.intp], NDArray[np.intp]]]:
    """The matrix on a pattern as CSC, explicit zeros included, and the (rows, columns) of its values in order."""
    columns, rows = np.nonzero(pattern.T)
    indptr = np.concatenate([[0], np.cumsum(pattern.sum(axis=0))])
    return sparse.csc_matrix((matrix[rows, columns], rows, indptr), shape=matrix.shape), (rows, columns)
