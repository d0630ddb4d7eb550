"""Which inputs are rounded, and how coarsely beside their usual change."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from pisplit.data.episodes import Episodes

Array = NDArray[np.float64]

#: A step of inputs is one if they are multiples of it within this part of it; most of the steps of rounding in a range.
EXACT, MOST = 1e-3, 1e5
#: Rounding that is worth a word, by its standard deviation in parts of the usual change.
COARSE = 0.02
#: Inputs that stay for longer than this part of the steps are commands that are held, not smooth motion.
HELD = 0.5
#: Steps of the optimiser, at most.
ITERATIONS = 2000


def rounding(values: Array) -> float:
    """The step that all ``values`` (N,) are multiples of, 0 where there is none."""
    levels = np.diff(np.unique(values))
    size = float(np.ptp(values))
    gaps = levels[levels > 1e-9 * size] if size > 0.0 else levels[:0]
    if not len(gaps):
        return 0.0
    step = float(gaps.min())
    apart = np.abs(gaps / step - np.round(gaps / step)).max() * step  # gaps of a few steps tell the step too roughly
    fine = size / step < MOST and apart < EXACT * step * max(1.0, float(np.round(gaps / step).max()))
    return step if fine else 0.0


def coarse(episodes: Episodes) -> list[tuple[str, float, float]]:
    """Inputs of ``episodes`` that are rounded coarsely: names, steps, deviation of rounding over the usual change."""
    found = []
    for j, name in enumerate(episodes.input_names or ()):
        columns = [u[:, j] for u in episodes.us]
        step = rounding(np.concatenate(columns))
        moved = np.concatenate([np.diff(c) for c in columns])
        moved = moved[moved != 0.0]
        if step > 0.0 and len(moved) and not held(columns):
            part = step / np.sqrt(12.0 * float(np.mean(moved**2)))
            if COARSE < part < 1.0 / np.sqrt(12.0):
                found.append((name, step, part))
    return found


def held(columns: Sequence[Array]) -> bool:
    """Whether an input, with its ``columns`` (T_i,) of all recordings, stays as it is over most of its steps."""
    moved = np.concatenate([np.diff(c) for c in columns])
    return bool(len(moved) == 0 or np.mean(moved == 0.0) > HELD)


def smoothest(values: Array, step: float) -> Array:
    """The smoothest sequence within half a ``step`` of ``values`` (T,)."""
    if step == 0.0 or len(values) < 3:
        return values
    from scipy.optimize import minimize  # slow to load, and needed here alone

    scaled = (values - values[0]) / step

    def roughness(v: Array) -> tuple[float, Array]:
        second = np.diff(v, 2)
        gradient = np.zeros(len(v))
        gradient[:-2] += second
        gradient[1:-1] -= 2.0 * second
        gradient[2:] += second
        return 0.5 * float(second @ second), gradient

    bounds = np.column_stack([scaled - 0.5, scaled + 0.5])
    options = {"maxiter": ITERATIONS, "maxfun": 4 * ITERATIONS, "ftol": 1e-12, "gtol": 1e-7}
    found = minimize(roughness, scaled, jac=True, bounds=bounds, method="L-BFGS-B", options=options)
    return np.asarray(values[0] + step * np.clip(found.x, bounds[:, 0], bounds[:, 1]))
