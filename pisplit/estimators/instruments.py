"""Regression on noisy states without the bias that noise brings: earlier samples as instrumental variables."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pisplit.data.pairs import Pairs
from pisplit.dictionary.dictionary import Dictionary
from pisplit.regression.moments import Moments, accumulate, block_rows

Array = NDArray[np.float64]

#: Singular value of the instruments, each of length one, below which a direction holds nothing.
DEPENDENT = 1e-10


def instrumented_moments(
    theta: Dictionary, pairs: Pairs, instruments: int, equilibria: tuple[Array, Array] | None = None
) -> Moments:
    """Moments of [Theta(k) | learned columns of psi(k+1)] of ``pairs``, projected on what the past says of them.

    Noise on x_k is part of Theta(k): it adds its variance to the Gram matrix, and least squares pulls every eigenvalue
    toward zero, whatever the number of pairs. Noise at other times is independent of it. The rows are therefore
    projected on instruments W, the present columns at ``instruments`` samples before all that Theta(k) holds, and the
    inputs since then: any regression on these moments is a two-stage least squares (Theil 1953; Soderstrom, Stoica:
    System Identification, 1989, section 8). Nothing is squared: the triangle of [W | Theta | psi'] holds the projected
    rows as they are. Products of a bilinear dictionary are instrumented by those of u_k and earlier columns.

    theta       dictionary with the names of the data, M columns, S of them learned
    equilibria  x (N, n) and u (N, m) at which the system rests; each counts as a pair that has always been there

    Consistent where the noise is independent from sample to sample, the inputs are known and do not react to it (in
    open loop, or in closed loop around other sensors), and columns are linear in the states that are noisy: the mean of
    x^2 holds the variance of the noise, which no instrument takes away.

    Raises ValueError if no pair has so long a history.
    """
    lags = instruments + theta.state_delays
    depth = max(theta.state_delays + lags, theta.input_delays)
    deep = replace(pairs.take(pairs.index >= depth), n_delays=depth)
    if len(deep) == 0:
        raise ValueError(
            f"instruments = {instruments} with {theta.state_delays} delays needs {depth + 1} steps before a pair; "
            "no pair has them: give longer episodes, or fewer instruments"
        )

    def blocks() -> Iterator[Array]:
        for b in deep.blocks(block_rows((lags + 1) * (theta.n_present + theta.n_features) + theta.n_columns)):
            own = replace(b, n_delays=theta.n_delays)
            w = _instruments(theta, b.x_history[:, : depth - theta.state_delays], b.u_history, b.u, lags)
            yield np.hstack([w, theta.evaluate(own), theta.next_learned(own)])
        if equilibria is not None:
            x, u = equilibria
            past = np.repeat(x[:, None], depth - theta.state_delays, axis=1), np.repeat(u[:, None], depth, axis=1)
            w = _instruments(theta, *past, u, lags)
            yield np.hstack([w, theta.evaluate_static(x, u), theta.present(x)[:, theta.learned_columns]])

    return _projected(accumulate(blocks()), theta.n_columns + len(theta.learned_columns))


def _instruments(theta: Dictionary, states: Array, inputs: Array, u: Array, lags: int) -> Array:
    """W (N, w) from states (N, L, n) before all that Theta(k) holds, past inputs (N, D, m) and u_k (N, m)."""
    rows, parts = len(u), [theta.features(u)]
    for past in range(inputs.shape[1]):
        parts.append(theta.features(np.ascontiguousarray(inputs[:, past])))
    for lag in range(1, lags + 1):
        columns = theta.present(np.ascontiguousarray(states[:, -lag]))
        parts.append(columns)
        if theta.is_bilinear:
            parts.append((u[:, :, None] * columns[:, None]).reshape(rows, -1))
    return np.hstack(parts)


def _projected(moments: Moments, size: int) -> Moments:
    """Moments of the last ``size`` columns, projected on those before them."""
    split = len(moments.mean) - size
    w, rest = moments.factor[:, :split], moments.factor[:, split:]
    length = np.linalg.norm(w, axis=0)
    u, values, _ = np.linalg.svd(w[:, length > 0.0] / length[length > 0.0], full_matrices=False)
    kept = values > DEPENDENT * values.max(initial=0.0)
    return Moments(moments.n_samples, moments.mean[split:], u[:, kept].T @ rest)
