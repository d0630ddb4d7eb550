"""Quadratic programs by a dual active-set method, DAQP: exact, and quick at the sizes of MPC."""

from __future__ import annotations

import importlib
from typing import Any

import numpy as np

from pisplit.checks import Array
from pisplit.controllers.mpc.qp import PRIMAL_TOLERANCE, QPResult, QPSettings, QPState, unsolvable

#: Exit flags of DAQP.
STATUS = {
    1: "solved",
    2: "solved",
    -1: "primal infeasible",
    -2: "cycling",
    -3: "unbounded",
    -4: "maximum iterations reached",
    -5: "nonconvex",
    -6: "overdetermined start",
    -7: "time limit reached",
}


class ActiveSetQP:
    """minimise x'P x/2 + q'x subject to l <= A x <= u, with P (n, n) positive definite and A (k, n).

    Every solve is one of its own that starts from the active set of the multipliers: it depends on nothing else.
    ``settings``: ``eps`` is what a row may be violated by.

    Raises ImportError where DAQP is not installed, which ``QPSettings`` say before.

    Source: Arnstrom, Bemporad and Axehill, IEEE Transactions on Automatic Control 67 (2022).
    """

    def __init__(self, P: Array, A: Array, settings: QPSettings) -> None:
        self._solve: Any = importlib.import_module("daqp").solve
        self._settings = settings
        self._P, self._A = P.copy(), A.copy()
        self._y = np.zeros(A.shape[0])

    @property
    def multipliers(self) -> Array:
        """Lagrange multipliers (k,) of the last accepted solve, zeros before."""
        return self._y.copy()

    def snapshot(self) -> QPState:
        """The state from which ``restore`` goes on."""
        return QPState(self._P.copy(), self._A.copy(), 0.0, np.zeros(len(self._P)), self._y.copy(), False)

    def restore(self, state: QPState) -> None:
        """Go on from a ``state`` of a program of the same size; raises ValueError for others."""
        if (state.P.shape, state.A.shape) != (self._P.shape, self._A.shape):
            raise ValueError(
                "the snapshot is of another problem: its matrices differ in size; restore it where it is from"
            )
        self._P, self._A = state.P.copy(), state.A.copy()
        self._y = state.y.copy()

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
        """Solve for q (n,), lower and upper (k,) from the active set of y0 (k,) or of the last multipliers.

        P (n, n) and A (k, n), where given, replace the matrices. ``x0`` (n,) is not needed.
        """
        if (refused := unsolvable(q, lower, upper)) is not None:
            return refused
        self._P = self._P if P is None else P.copy()
        self._A = self._A if A is None else A.copy()
        start = self._y if y0 is None else y0
        x, _, flag, info = self._solve(
            self._P,
            q,
            self._A,
            upper,
            lower,
            primal_tol=self._settings.eps,
            iter_limit=self._settings.first_max_iterations,
            dual_start=start,
        )
        x, y = np.array(x), np.array(info["lam"])
        reached = self._A @ x
        missed = float(max(np.max(lower - reached, initial=0.0), np.max(reached - upper, initial=0.0)))
        accepted = flag > 0 and bool(np.isfinite(x).all()) and missed <= PRIMAL_TOLERANCE
        self._y = y if accepted else np.zeros(len(self._A))
        status = STATUS.get(int(flag), f"exit flag {flag}")
        if flag > 0 and not accepted:
            status = "not feasible"
        return QPResult(status, x if accepted else None, int(info["iterations"]), missed)
