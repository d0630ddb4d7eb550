"""Columns alone in their unit that hardly move: how much of them is noise, and what it asks of their scale."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from pisplit.data.episodes import Episodes

Array = NDArray[np.float64]

#: The noise of a column is brought to this part of its scale, or to that of the clearest column if that is more.
CLEAR = 0.003
#: Noise of a smaller part of the spread than this is left as it is.
NOTABLE = 0.02
#: The most rows and entries that are looked at, rows that always are, and rows for each regressor of the prediction
#: that tells noise from motion.
ROWS, ENTRIES, FEW_ROWS, ROWS_EACH = 20_000, 200_000, 500, 4
#: Fewest third differences that noise is told by; it is white if their neighbours have a correlation below this, in
#: columns that mostly hold their value below that.
FEWEST, WHITE, JUMPS = 20, -0.5, -0.7


def noise_margins(episodes: Episodes) -> dict[str, float]:
    """Factors by which scales have to exceed spreads so that noise is not blown up, by quantity; 1 is left out.

    A quantity of one state alone has no other to take its scale from. Scaled to a spread of one, a column that hardly
    moves would be all noise; with the factor, its noise is as large as that of the clearest of the ``episodes``'
    states, or 3 parts in a thousand. Noise is what third differences find and neither states nor inputs of the step
    before predict: a state that follows its input within a step is no noise.
    """
    quantities = list(episodes.quantities or ())
    alone = np.array([quantities.count(q) == 1 for q in quantities])
    if not alone.any():
        return {}
    xs, us = _part(episodes)
    spread = np.concatenate(xs).std(axis=0)
    moving = spread > 0.0
    shares = _white(xs) / np.where(moving, spread, 1.0)
    clear = max(CLEAR, float(shares[moving].min(initial=np.inf)))
    asked = alone & moving & (shares > clear)
    if not asked.any():
        return {}
    shares[asked] = np.minimum(shares[asked], _unpredicted(xs, us, asked) / spread[asked])
    return {quantities[i]: float(shares[i] / clear) for i in np.flatnonzero(asked) if shares[i] > max(NOTABLE, clear)}


def _white(xs: list[Array]) -> Array:
    """Standard deviations (n,) of white noise on states (T_i + 1, n), by third differences; 0 where these are not its.

    Neighbours among third differences of white noise have a correlation of -3/4, those of single jumps of -2/3, which
    columns that mostly hold their value may be made of.
    """
    third = [np.diff(x, 3, axis=0) for x in xs if len(x) > 4]
    rows = sum(map(len, third))
    if rows < FEWEST:
        return np.zeros(xs[0].shape[1])
    power = sum((part**2).sum(axis=0) for part in third)
    beside = sum((part[1:] * part[:-1]).sum(axis=0) for part in third)
    held = sum((np.diff(x, axis=0) == 0.0).sum(axis=0) for x in xs) > 0.5 * sum(len(x) - 1 for x in xs)
    found: Array = np.where(beside < np.where(held, JUMPS, WHITE) * power, np.sqrt(power / (20.0 * rows)), 0.0)
    return found


def _part(episodes: Episodes) -> tuple[list[Array], list[Array]]:
    """States (T_i + 1, n) and inputs (T_i, m) of the first episodes, ``ROWS`` rows in all, fewer of many columns."""
    xs: list[Array] = []
    us: list[Array] = []
    left = max(FEW_ROWS, min(ROWS, ENTRIES // (episodes.n_states + episodes.n_inputs)))
    for x, u in zip(episodes.xs, episodes.us, strict=True):
        xs.append(np.asarray(x[:left], dtype=np.float64))
        us.append(np.asarray(u[: len(xs[-1]) - 1], dtype=np.float64))
        left -= len(xs[-1])
        if left < 2:
            break
    return xs, us


def _unpredicted(xs: list[Array], us: list[Array], which: NDArray[np.bool_]) -> Array:
    """Standard deviations of what one step back does not predict of the columns ``which``, by least squares."""
    now, after = np.concatenate([x[:-1] for x in xs]), np.concatenate([x[1:][:, which] for x in xs])
    told = [np.ones((len(now), 1)), np.concatenate(us), now]
    if sum(part.shape[1] for part in told) * ROWS_EACH > len(now):
        told[2] = now[:, which]
    a = np.hstack(told)
    size = np.abs(a).max(axis=0)
    a = a / np.where(size > 0.0, size, 1.0)
    free = len(a) - a.shape[1]
    if free < 1:
        return np.full(after.shape[1], np.inf)
    middle = after.mean(axis=0)
    found = np.linalg.lstsq(a, after - middle, rcond=1e-10)[0]
    residual: Array = np.sqrt(((after - middle - a @ found) ** 2).sum(axis=0) / free)
    return residual
