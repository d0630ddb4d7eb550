"""Quadratic programs, on native OSQP or on DAQP: set up once, new vectors and values every step."""

from __future__ import annotations

import importlib
from dataclasses import dataclass
from typing import Any

import numpy as np
import osqp
from numpy.typing import NDArray
from scipy import sparse

from pisplit.checks import Array, count, one_of, positive

SOLVERS = ("osqp", "daqp")
#: Beyond this OSQP takes a bound for infinite, a lower one of this size for one that crosses the upper.
LARGEST = 1e29
RHO = 0.1  # OSQP's default, put back at a restart so that runs repeat
PRIMAL_TOLERANCE = 1e-2  # constraint rows are scaled to unit size; what is left is removed by the projection of u0


def installed(name: str) -> bool:
    """Whether the module ``name`` can be imported."""
    try:
        importlib.import_module(name)
    except ImportError:
        return False
    return True


@dataclass(frozen=True)
class QPSettings:
    """Solver and its settings. The first solve has no warm start and gets more iterations than those in the loop.

    ``eps``: absolute and relative tolerance of both residuals, in the units of the scaled problem (cost per mean
    curvature, rows of unit size). ``max_iterations`` of every solve but the first, which gets
    ``first_max_iterations``. ``solver``: "osqp", or "daqp" (``pip install pisplit[daqp]``), a dual active-set method:
    exact, for ``eps`` bounds only what the rows are violated by, and its every solve has the limit of the first. Raises
    ValueError where a number is not positive, for other solvers and for one that is not installed.
    """

    eps: float = 1e-4
    max_iterations: int = 1000
    first_max_iterations: int = 4000
    solver: str = "osqp"

    def __post_init__(self) -> None:
        one_of(self.solver, "solver", SOLVERS)
        if self.solver == "daqp" and not installed("daqp"):
            raise ValueError('solver = "daqp" needs the package daqp; pip install pisplit[daqp], or take "osqp"')
        positive(self.eps, "eps")
        count(self.max_iterations, "max_iterations")
        count(self.first_max_iterations, "first_max_iterations")


@dataclass(frozen=True)
class QPResult:
    """Outcome of a solve in ``iterations``. ``x`` is None unless ``status`` (with the residual, at the iteration limit)
    vouches for it.

    ``primal_residual`` is the largest constraint violation of the iterate, in the units of the rows.
    """

    status: str
    x: Array | None
    iterations: int
    primal_residual: float


@dataclass(frozen=True)
class QPState:
    """All that the next solve depends on: values of P and A on their patterns, OSQP's rho, the iterates x (n,), y (k,),
    and whether the first solve is still to come."""

    P: Array
    A: Array
    rho: float
    x: Array
    y: Array
    first: bool


class QP:
    """minimise x'P x/2 + q'x subject to l <= A x <= u, solved again and again with warm starts.

    P (n, n) symmetric and A (k, n) are dense arrays; the solver sees their non-zeros, or those of the boolean patterns
    ``P_pattern`` and ``A_pattern`` where given: the patterns stay fixed when ``solve`` brings new values, so an entry
    that may become non-zero later must be in them. ``settings``: tolerances and limits of OSQP.

    A solve depends on the ``snapshot`` alone: a copy, or one that was sent to another process, goes on to the last bit.

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
        self._P_pattern = _Pattern.of(np.triu(P != 0.0 if P_pattern is None else P_pattern))
        self._A_pattern = _Pattern.of(A != 0.0 if A_pattern is None else A_pattern)
        zeros = np.zeros(self._n), np.zeros(self._k)
        self._set_up(QPState(self._P_pattern.values(P), self._A_pattern.values(A), RHO, *zeros, first=True))

    @property
    def multipliers(self) -> Array:
        """Lagrange multipliers (k,) of the last accepted solve, zeros before."""
        return self._y.copy()

    def snapshot(self) -> QPState:
        """The state from which ``restore`` goes on."""
        rho = float(self._solver._solver.get_settings().rho)  # OSQP adapts it and tells it nowhere else
        return QPState(self._P.copy(), self._A.copy(), rho, self._x.copy(), self._y.copy(), self._first)

    def restore(self, state: QPState) -> None:
        """Go on from a ``state`` that ``snapshot`` took of a QP of the same patterns; raises ValueError for others."""
        if (state.P.shape, state.A.shape) != (self._P.shape, self._A.shape):
            raise ValueError(
                "the snapshot is of another problem: its matrices differ in size; restore it where it is from"
            )
        self._set_up(state)

    def __getstate__(self) -> dict[str, Any]:
        kept = {name: value for name, value in self.__dict__.items() if name != "_solver"}
        return kept | {"state": self.snapshot()}

    def __setstate__(self, state: dict[str, Any]) -> None:
        state = dict(state)
        known = state.pop("state")
        self.__dict__.update(state)
        self._set_up(known)

    def _set_up(self, state: QPState) -> None:
        """A new solver in the given state; with q = 0, as in ``_bring``, so that its scaling is that of P and A."""
        self._P, self._A, self._first = state.P.copy(), state.A.copy(), state.first
        self._x, self._y = state.x.copy(), state.y.copy()
        self._solver: Any = osqp.OSQP()
        try:
            self._solver.setup(
                self._P_pattern.matrix(self._P),
                np.zeros(self._n),
                self._A_pattern.matrix(self._A),
                np.full(self._k, -1.0),
                np.full(self._k, 1.0),
                eps_abs=self._settings.eps,
                eps_rel=self._settings.eps,
                max_iter=self._settings.first_max_iterations if state.first else self._settings.max_iterations,
                check_termination=10,
                rho=state.rho,
                adaptive_rho=True,
                scaling=10,
                polishing=False,
                warm_starting=True,
                verbose=False,
            )
        except osqp.OSQPException as error:
            raise ValueError(
                f"the quadratic program cannot be factorised (OSQP's error {error}): the model's response is too large "
                "over the horizon, or not finite; shorten it or regularise the fit"
            ) from None

    def _bring(self, P: Array | None, A: Array | None) -> None:
        """New values of both matrices, under q = 0: how OSQP scales them must not depend on what was solved before."""
        self._P = self._P if P is None else self._P_pattern.values(P)
        self._A = self._A if A is None else self._A_pattern.values(A)
        self._solver.update(q=np.zeros(self._n))
        self._solver.update(Px=self._P, Ax=self._A)

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

        P (n, n) and A (k, n), where given, replace the values inside the patterns.
        """
        if (refused := unsolvable(q, lower, upper)) is not None:  # OSQP would solve the old problem
            return refused
        solver = self._solver
        if P is not None or A is not None:
            self._bring(P, A)
        solver.update(q=q, l=lower, u=upper)
        solver.warm_start(x=self._x if x0 is None else x0, y=self._y if y0 is None else y0)
        answer = solver.solve(raise_error=False)
        if self._first:
            solver.update_settings(max_iter=self._settings.max_iterations)
            self._first = False
        info = answer.info
        # Statuses decide: OSQP 1.1 leaves finite numbers of 2e9 in x when the problem is infeasible.
        accepted = info.status == "solved" or (
            info.status in ("solved inaccurate", "maximum iterations reached") and info.prim_res <= PRIMAL_TOLERANCE
        )
        self._x = np.array(answer.x) if accepted else np.zeros(self._n)
        self._y = np.array(answer.y) if accepted else np.zeros(self._k)
        return QPResult(info.status, self._x.copy() if accepted else None, int(info.iter), float(info.prim_res))


def unsolvable(q: Array, lower: Array, upper: Array) -> QPResult | None:
    """Why no solver is asked for the cost q (n,) and the bounds lower, upper (k,); None if one is."""
    if not np.isfinite(q).all():
        return QPResult("cost not finite", None, 0, np.inf)
    if not (lower <= upper).all():  # False on NaN too
        return QPResult("bounds crossed", None, 0, np.inf)
    if (lower > LARGEST).any() or (upper < -LARGEST).any():  # OSQP would keep the bounds of the step before
        return QPResult("bounds out of range", None, 0, np.inf)
    return None


@dataclass(frozen=True)
class _Pattern:
    """Where a matrix may have entries, in the order of CSC."""

    rows: NDArray[np.intp]
    columns: NDArray[np.intp]
    starts: NDArray[np.intp]
    shape: tuple[int, int]

    @classmethod
    def of(cls, pattern: NDArray[np.bool_]) -> _Pattern:
        columns, rows = np.nonzero(pattern.T)
        starts = np.concatenate([[0], np.cumsum(pattern.sum(axis=0))])
        return cls(rows, columns, starts, (pattern.shape[0], pattern.shape[1]))

    def values(self, matrix: Array) -> Array:
        """The entries of a dense matrix on the pattern."""
        return np.ascontiguousarray(matrix[self.rows, self.columns])

    def matrix(self, values: Array) -> sparse.csc_matrix:
        """The sparse matrix of these entries, zeros included."""
        return sparse.csc_matrix((values, self.rows, self.starts), shape=self.shape)
