"""What baselines and physics-informed methods of the ablation share: compact draws, quiet fits, the best of them."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from common.protocol import HELD_OUT, Draw


def compact(draw: Draw) -> Draw:
    """The draw with those episodes only that hold pairs or are held out."""
    used = np.unique(draw.rows[:, 0])
    total = len(draw.episodes)
    kept = [*used.tolist(), *range(total - HELD_OUT, total)]
    rows = np.stack([np.searchsorted(used, draw.rows[:, 0]), draw.rows[:, 1]], axis=1)
    return replace(draw, episodes=draw.episodes.subset(kept), rows=rows)


def best(fits: Sequence[Any], tolerance: float = 0.0) -> Any:
    """The fit that rolls held-out episodes out best, among those that stay bounded if there are any.

    Of those within ``tolerance`` of the smallest error it is the one with the fewest columns.
    """
    bounded = [fit for fit in fits if fit.bounded_ is not False] or list(fits)
    errors = [float(np.nan_to_num(fit.cv_.error, nan=np.inf)) for fit in bounded]
    level = [fit for fit, error in zip(bounded, errors, strict=True) if error <= (1.0 + tolerance) * min(errors)]
    return min(level, key=lambda fit: fit.theta_.n_columns)


def quietly(fit: Callable[..., Any], *arguments: Any, **options: Any) -> Any:
    """Fit without warnings: divergence on a grid of alphas is what cross-validation is for."""
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        return fit(*arguments, **options)
