"""Regression on data that stream in: the triangle of all data so far, with forgetting."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pisplit.checks import count, finite_array, finite_number, non_negative, positive, real_array
from pisplit.regression.lasso import lasso
from pisplit.regression.least_squares import ridge
from pisplit.regression.multi_target import Regression
from pisplit.regression.penalties import check_penalty

Array = NDArray[np.float64]


class RecursiveRegression:
    """Y ~ A K^T for samples that arrive one after another: recursive least squares in square-root form.

    The R of a QR factorisation of all weighted samples is updated by rotations (Golub, Van Loan: Matrix Computations,
    section 6.5), so that the answer is the batch answer to rounding, whatever the condition number, and any of the
    regressions can be asked for at any time. A sample that is j samples old has the weight ``forgetting`` ** j.

    columns     M of the regressors
    targets     S
    forgetting  in (0, 1]; 1 remembers everything; the memory is 1 / (1 - forgetting) samples

    Raises ValueError for a forgetting factor outside (0, 1].
    """

    def __init__(self, columns: int, targets: int, forgetting: float = 1.0) -> None:
        self.columns, self.targets = count(columns, "columns"), count(targets, "targets")
        self.forgetting = positive(finite_number(forgetting, "forgetting"), "forgetting")
        if self.forgetting > 1.0:
            raise ValueError(f"forgetting = {self.forgetting:g}; expected a factor above 0 and at most 1")
        self.n_samples = 0
        self._triangle = np.zeros((0, self.columns + self.targets))

    @property
    def effective_samples(self) -> float:
        """Sum of the weights of all samples so far."""
        if self.forgetting == 1.0:
            return float(self.n_samples)
        return float((1.0 - self.forgetting**self.n_samples) / (1.0 - self.forgetting))

    def update(self, a: ArrayLike, y: ArrayLike) -> RecursiveRegression:
        """Add samples a (M,) and y (S,), or rows (N, M) and (N, S), oldest first. Returns itself."""
        rows_a, rows_y = (np.atleast_2d(real_array(v, name)) for v, name in ((a, "a"), (y, "y")))
        rows_a = finite_array(rows_a, "a", (None, self.columns))
        rows_y = finite_array(rows_y, "y", (len(rows_a), self.targets))
        fresh = np.hstack([rows_a, rows_y])
        size = len(fresh)
        weight = np.sqrt(self.forgetting)
        aged = self._triangle * weight**size
        weighted = fresh * (weight ** np.arange(size - 1, -1, -1.0))[:, None]
        self._triangle = np.asarray(np.linalg.qr(np.vstack([aged, weighted]), mode="r"))
        self.n_samples += size
        return self

    @property
    def rows(self) -> tuple[Array, Array]:
        """A and Y of at most M + S rows that stand for all weighted samples in any regression."""
        return self._triangle[:, : self.columns].copy(), self._triangle[:, self.columns :].copy()

    def solve(
        self, alpha: float = 0.0, penalty: str = "ridge", prior: Array | None = None, solver: str = "auto"
    ) -> Regression:
        """Regression on all samples so far, with the weight ``alpha`` of a ``penalty`` (ridge or lasso) on K - prior.

        ``prior`` (S, M), default zero; ``solver`` of a LASSO as in :func:`pisplit.regression.lasso`.
        """
        check_penalty(penalty, solver, relative=False)
        if self.n_samples == 0:
            raise ValueError("there are no samples yet; call update first")
        a, y = self.rows
        weight = non_negative(alpha, "alpha")
        return lasso(a, y, weight, prior, solver=solver) if penalty == "lasso" else ridge(a, y, weight, prior)
