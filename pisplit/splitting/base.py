"""Operator splittings: how the known half step and trajectory data make one operator K.

A splitting is built once a fit (:class:`SplitContext`), then gives a solver for a set of pairs, which gives a fit for
every alpha: cross-validation calls the last step for a whole grid.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from pisplit.checks import positive
from pisplit.data.episodes import Pairs
from pisplit.data.phase import PhaseSamples
from pisplit.dictionary.dictionary import Dictionary
from pisplit.generator.generator import HalfStep, half_step
from pisplit.generator.product_half_step import with_products
from pisplit.regression import Regression, absolute_weight, alpha_max, composed_ridge, lasso
from pisplit.regression.moments import Moments, accumulate, block_rows

Array = NDArray[np.float64]
Index = NDArray[np.int64]
#: Where K_h may differ from the identity (:func:`free_block`).
Rows = str | Sequence[str] | Sequence[bool] | Mapping[str, float] | None


@dataclass(frozen=True)
class SplitContext:
    """What a splitting may use besides the pairs: dictionary, column scales (M,), dt [s], D2, estimator options.

    ``equilibria``: x (N, n) and u (N, m) at which the actuated system rests; each counts as a pair that maps to itself.
    ``known``: pairs whose moments are there already; they take most of the time of a fit.
    """

    theta: Dictionary
    scale: Array
    dt: float
    samples: PhaseSamples | None
    penalty: str
    toward: str
    half_step: str
    rows: Rows
    relative: bool | str
    generator_alpha: float
    options: Mapping[str, Any] = field(default_factory=dict)
    equilibria: tuple[Array, Array] | None = None
    known: tuple[Pairs, Moments] | None = None
    solver: str = "auto"

    def weight(self, alpha: float, unit: float, n_samples: int) -> float:
        """The weight of the penalty for ``alpha`` (:func:`pisplit.regression.absolute_weight`)."""
        return absolute_weight(alpha, self.relative, unit, n_samples)

    def moments(self, pairs: Pairs) -> Moments:
        """Moments of [Theta(k) | learned columns of psi(k+1)] (:func:`pair_moments`)."""
        if self.known is not None and self.known[0] is pairs:
            return self.known[1]
        return pair_moments(self.theta, pairs, self.equilibria)


@dataclass(frozen=True)
class SplitFit:
    """Rows K (S, M) of the operator for the learned columns, in physical units: psi_learned(k+1) = K Theta(k).

    alpha    the absolute weight of the penalty
    rank     numerical rank of the regression, if it has one
    gap      relative duality gap, for LASSO
    details  JSON-able facts
    """

    K: Array
    alpha: float
    rank: int | None = None
    gap: float | None = None
    details: Mapping[str, Any] = field(default_factory=dict)


Solver = Callable[[float], SplitFit]


class Splitting(Protocol):
    """A splitting prepared for one dictionary and one set of phase samples."""

    def solver(self, pairs: Pairs) -> Solver:
        """A function alpha -> fit for these pairs."""


@runtime_checkable
class Stiffening(Protocol):
    """A splitting whose own regularisation can be raised."""

    def solver(self, pairs: Pairs) -> Solver:
        """A function alpha -> fit for these pairs."""

    def stiffer(self) -> Splitting:
        """The same with ten times the regularisation."""


def pair_moments(theta: Dictionary, pairs: Pairs, equilibria: tuple[Array, Array] | None = None) -> Moments:
    """Moments of [Theta(k) | learned columns of psi(k+1)] (M + S columns), accumulated in blocks."""

    def blocks() -> Iterator[Array]:
        for b in pairs.blocks(block_rows(theta.n_columns)):
            yield np.hstack([theta.evaluate(b), theta.next_learned(b)])
        if equilibria is not None:
            x, u = equilibria
            yield np.hstack([theta.evaluate_static(x, u), theta.present(x)[:, theta.learned_columns]])

    return accumulate(blocks())


class Direct:
    """No splitting: K_h is the whole operator (EDMDc, paper, eq. discrete-time-koop)."""

    def __init__(self, context: SplitContext) -> None:
        self.context = context

    def solver(self, pairs: Pairs) -> Solver:
        """A function alpha -> fit for these pairs."""
        identity = np.eye(self.context.theta.n_columns)
        return composed_solver(self.context, identity, identity, pairs)


class Strang:
    """K = K_f(dt/2) K_h(dt) K_f(dt/2) (paper, eq. koopman_strang_splitting)."""

    def __init__(self, context: SplitContext) -> None:
        self.context = context
        self.half = known_half_step(context)

    def solver(self, pairs: Pairs) -> Solver:
        """A function alpha -> fit for these pairs."""
        return composed_solver(self.context, self.half.K, self.half.K, pairs, _facts(self.half))


class Lie:
    """K = K_h(dt) K_f(dt), first order in dt (paper, before eq. koopman_strang_splitting)."""

    def __init__(self, context: SplitContext) -> None:
        self.context = context
        self.half = known_half_step(context)

    def solver(self, pairs: Pairs) -> Solver:
        """A function alpha -> fit for these pairs."""
        identity = np.eye(self.context.theta.n_columns)
        return composed_solver(self.context, identity, self.half.K @ self.half.K, pairs, _facts(self.half))


def known_half_step(context: SplitContext) -> HalfStep:
    """K_f(dt/2) of the context's phase samples."""
    if context.samples is None:
        raise ValueError("a splitting needs phase samples of the known vector field; give d2")
    theta = context.theta.without_products() if context.theta.is_bilinear else context.theta
    half = half_step(
        theta,
        context.samples,
        context.dt,
        context.scale[: theta.n_columns],
        context.half_step,
        context.generator_alpha,
        inverted=context.penalty == "lasso",
    )
    return replace(half, K=with_products(context.theta, half.K, context.scale)) if context.theta.is_bilinear else half


def composed_solver(
    context: SplitContext, left: Array, right: Array, pairs: Pairs, details: Mapping[str, Any] | None = None
) -> Solver:
    """Fit the free block of K_h in K = left K_h right; left and right (M, M) act on scaled columns.

    K_h is the identity outside the block of free rows and columns (``rows`` of the estimator). Least squares and ridge
    minimise the composed residual |left K_h right Theta - Theta'|^2, LASSO the pulled-back one that the paper prints,
    |K_h right Theta - left^+ Theta'|^2 + alpha |K_h - prior|_1. The constant's column of K_h carries no penalty.
    """
    theta, scale = context.theta, context.scale
    learned, size = theta.learned_columns, theta.n_columns
    moments = context.moments(pairs).scaled(np.concatenate([scale, scale[learned]]))
    rows, columns, affine = free_block(theta, context.rows)
    constant = theta.constant_column if affine else None
    data = moments.rows(centred=affine)
    a, y = data[:, :size], data[:, size:]
    mean, mean_next = moments.mean[:size], moments.mean[size:]

    fixed = np.eye(size)  # K_h without its free block
    fixed[np.ix_(rows, columns)] = 0.0
    prior = np.eye(size)[np.ix_(rows, columns)] if context.toward == "identity" else np.zeros((len(rows), len(columns)))
    w = a @ right.T
    regressors = w[:, columns]
    if context.penalty == "lasso":
        back = np.linalg.pinv(left[np.ix_(learned, learned)])
        others = np.setdiff1d(np.arange(size), learned)
        pull = (back @ left[np.ix_(learned, others)] @ right[others])[np.searchsorted(learned, rows)]
        back = back[np.searchsorted(learned, rows)]
        factor = np.eye(len(rows))
        known = pull + fixed[rows] @ right
    else:
        factor = left[np.ix_(learned, rows)]
        back = np.eye(len(learned))
        known = left[learned] @ fixed @ right
    # Both forms are now |factor H regressors - (back Theta' - known Theta)|^2 for the free block H.
    target = y @ back.T - a @ known.T
    residual = target - regressors @ prior.T @ factor.T
    # A weight w on the penalty of a row of H is none on that of another unknown: H = w G where targets are rows of
    # their own (LASSO), H = G / sqrt(w) in a square.
    weights = row_weights(theta, context.rows, rows)
    size_of_rows: Array = weights if context.penalty == "lasso" else 1.0 / np.sqrt(weights)
    if context.penalty == "lasso":
        residual = residual / weights
        unit = alpha_max(regressors, residual)
    else:
        unit = float((regressors**2).sum() / len(columns) * (factor**2).sum() / len(rows))

    left_factor = factor if context.penalty == "lasso" else factor * size_of_rows

    def solve(alpha: float) -> SplitFit:
        weight = context.weight(alpha, unit, moments.n_samples)
        if weight == 0.0 or context.penalty != "lasso":
            fit: Regression = composed_ridge(left_factor, regressors, residual, weight)
        else:
            fit = lasso(regressors, residual, weight, solver=context.solver)
        block = prior + size_of_rows[:, None] * fit.K
        k_h = fixed.copy()
        k_h[np.ix_(rows, columns)] = block
        if constant is not None:
            middle = right @ mean
            offset = back @ mean_next - known @ mean - factor @ (block @ middle[columns])
            k_h[rows, constant] = np.linalg.pinv(factor) @ offset / middle[constant]
        k = (left[learned] @ k_h @ right) * scale[learned][:, None] / scale
        return SplitFit(K=k, alpha=weight, rank=fit.rank, gap=fit.gap, details=dict(details or {}))

    return solve


def free_block(theta: Dictionary, rows: Rows) -> tuple[Index, Index, bool]:
    """Free rows and columns of K_h, and whether its constant column is free too (it then carries no penalty).

    ``rows``: None = all learned rows and all columns; "inputs" = all learned rows, but only the columns of inputs, past
    and present, and their products; names of learned columns or of quantities, or a boolean mask over learned columns =
    rows where h acts. A mapping from such names to numbers > 0 also weighs the penalty of these rows.
    """
    learned = theta.learned_columns
    everything = np.array([i for i in range(theta.n_columns) if i != theta.constant_column], dtype=np.int64)
    affine = theta.constant_column is not None
    if rows is None:
        return learned, everything, affine
    if isinstance(rows, str):
        if rows != "inputs":
            raise ValueError(f"rows = {rows!r}; expected None, 'inputs', a list of names, or a boolean mask")
        first = theta.n_present + theta.state_delays * theta.n_states
        if first == theta.n_columns:
            raise ValueError("rows = 'inputs', but the dictionary has no input columns; add ob.Inputs()")
        return learned, np.arange(first, theta.n_columns), False
    entries = list(rows)
    if all(isinstance(entry, bool | np.bool_) for entry in entries):
        if len(entries) != len(learned):
            raise ValueError(f"rows is a mask of length {len(entries)}; expected {len(learned)}, one a learned column")
        chosen = np.array(entries, dtype=bool)
    else:
        labels = [(theta.column_names[i], theta.column_quantities[i]) for i in learned]
        unknown = [entry for entry in entries if not any(entry in label for label in labels)]
        if unknown:
            raise ValueError(f"rows names {unknown[:3]}; expected names or quantities of learned columns")
        chosen = np.array([any(entry in label for entry in entries) for label in labels])
    if not chosen.any():
        raise ValueError("rows leaves no row free; h must act on at least one column")
    return learned[chosen], everything, affine


def row_weights(theta: Dictionary, rows: Rows, free: Index) -> Array:
    """Weights (len(free),) of the penalty of the free rows: 1 unless ``rows`` is a mapping; a name beats a quantity."""
    if not isinstance(rows, Mapping):
        return np.ones(len(free))
    for name, weight in rows.items():
        positive(weight, f"weight of rows[{name!r}]")
    labels = [(theta.column_names[i], theta.column_quantities[i]) for i in free]
    return np.array([float(rows[name] if name in rows else rows[quantity]) for name, quantity in labels])


def _facts(half: HalfStep) -> dict[str, Any]:
    facts: dict[str, Any] = {
        "half_step": half.kind,
        "reason": half.reason,
        "growth": half.growth,
        "condition": half.condition,
        "errors": dict(half.errors),
        "drift": half.drift,
    }
    if half.spectrum is not None:
        facts |= {"max_real": half.max_real, "spurious": list(half.spectrum.report()[:5])}
    return facts
