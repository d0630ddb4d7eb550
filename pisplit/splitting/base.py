"""What all splittings share: what they are given, the three steps of Algorithm 1 that they take, what they return."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from pisplit.data.episodes import Pairs
from pisplit.data.phase import PhaseSamples
from pisplit.dictionary.dictionary import Dictionary
from pisplit.generator import HalfStep, KnownOptions, half_step
from pisplit.generator.product_half_step import with_products
from pisplit.regression import absolute_weight
from pisplit.regression.moments import Moments, accumulate, block_rows
from pisplit.splitting.rows import Rows

Array = NDArray[np.float64]
KnownT = TypeVar("KnownT")


@dataclass(frozen=True)
class SplitContext:
    """What a splitting may use besides the pairs: a dictionary, scales, phase samples, options of the estimator.

    theta            dictionary with M columns, S of them learned
    scale            (M,) units of the columns in the regressions
    dt               step [s]
    samples          phase samples of the known part (D2), or None
    penalty, solver  of the regression of K_h: "ridge" or "lasso", and what solves the LASSO
    toward           what the penalty pulls K_h to: "zero" or "identity"
    half_step        kind of the known half step
    rows             where K_h may differ from the identity (:func:`pisplit.splitting.rows.free_block`)
    relative         what alpha is relative to (:func:`pisplit.regression.absolute_weight`)
    generator_alpha  weight of the penalty in the regression of the known part
    known            other options of that regression
    options          of the splitting itself
    """

    theta: Dictionary
    scale: Array
    dt: float
    samples: PhaseSamples | None = None
    penalty: str = "ridge"
    solver: str = "auto"
    toward: str = "zero"
    half_step: str = "auto"
    rows: Rows = None
    relative: bool | str = True
    generator_alpha: float = 0.0
    known: KnownOptions = field(default_factory=KnownOptions)
    options: Mapping[str, Any] = field(default_factory=dict)

    def weight(self, alpha: float, unit: float, n_samples: int) -> float:
        """The weight of the penalty on a sum over ``n_samples`` for ``alpha``, relative to ``unit`` if it is so."""
        return absolute_weight(alpha, self.relative, unit, n_samples)

    def scaled(self, moments: Moments, centred: bool) -> tuple[Array, Array, Array, Array]:
        """Rows of Theta (r, M) and Theta' (r, S) on scaled columns that stand for ``moments``, and their means.

        ``centred``: rows are about the means, as a regression with a free constant wants them.
        """
        size, learned = self.theta.n_columns, self.theta.learned_columns
        found = moments.scaled(np.concatenate([self.scale, self.scale[learned]]))
        rows = found.rows(centred)
        return rows[:, :size], rows[:, size:], found.mean[:size], found.mean[size:]


@dataclass(frozen=True)
class Unknown:
    """What was learned from trajectories, on scaled columns.

    K        K_h (M, M), gains of ports and loads, or a departure (S, M) from the map ``around``
    alpha    absolute weight of the penalty
    rank     numerical rank of the regression, if it has one
    gap      largest relative duality gap, for LASSO
    details  JSON-able facts
    around   (S, M) or None
    """

    K: Array
    alpha: float
    rank: int | None = None
    gap: float | None = None
    details: Mapping[str, Any] = field(default_factory=dict)
    around: Array | None = None


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

    @classmethod
    def of(cls, context: SplitContext, rows: Array, unknown: Unknown, details: Mapping[str, Any]) -> SplitFit:
        """The fit of learned ``rows`` (S, M) on scaled columns of ``context``; ``details`` and those of ``unknown``."""
        k = rows * context.scale[context.theta.learned_columns][:, None] / context.scale
        return cls(k, unknown.alpha, unknown.rank, unknown.gap, {**details, **unknown.details})


class Splitting(Protocol[KnownT]):
    """Algorithm 1 of the paper (alg:pi-edmdc) in three steps, prepared for one context."""

    def known(self) -> KnownT:
        """The known part from phase samples: lines 1 and 2."""

    def unknown(self, k_f: KnownT, moments: Moments, alpha: float) -> Unknown:
        """The unknown part from ``moments`` of pairs, beside the known one ``k_f``, for a weight ``alpha``: line 3."""

    def composed(self, k_f: KnownT, k_h: Unknown) -> SplitFit:
        """The operator of both parts, ``k_f`` known and ``k_h`` learned: line 4."""


def pair_moments(theta: Dictionary, pairs: Pairs, equilibria: tuple[Array, Array] | None = None) -> Moments:
    """Moments of [Theta(k) | learned columns of psi(k+1)] (M + S columns) of ``pairs``, accumulated in blocks.

    ``theta`` has M columns, S of them learned. Theta(X, U) and Theta(X', U) are those of the paper (eq. theta_matrix),
    a sample a row. ``equilibria``: x (N, n) and u (N, m) at which the actuated system rests; each counts as a pair that
    maps to itself.
    """

    def blocks() -> Iterator[Array]:
        for b in pairs.blocks(block_rows(theta.n_columns)):
            yield np.hstack([theta.evaluate(b), theta.next_learned(b)])
        if equilibria is not None:
            x, u = equilibria
            yield np.hstack([theta.evaluate_static(x, u), theta.present(x)[:, theta.learned_columns]])

    return accumulate(blocks())


def known_half_step(context: SplitContext) -> HalfStep:
    """K_f(dt/2) of the phase samples of ``context`` (paper, alg:pi-edmdc, lines 1 and 2)."""
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
        options=context.known,
    )
    return replace(half, K=with_products(context.theta, half.K, context.scale)) if context.theta.is_bilinear else half


def facts(half: HalfStep) -> dict[str, Any]:
    """What a fit says of its half step, JSON-able."""
    found: dict[str, Any] = {
        "half_step": half.kind,
        "reason": half.reason,
        "growth": half.growth,
        "condition": half.condition,
        "errors": dict(half.errors),
        "drift": half.drift,
    }
    if half.spectrum is not None:
        found |= {"max_real": half.max_real, "spurious": list(half.spectrum.report()[:5])}
    return found
