"""Lag and play between command and motion, found from recordings of the commands alone."""

from __future__ import annotations

import os
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pisplit.brief import brief
from pisplit.checks import finite_array
from pisplit.data.actuator import Actuator
from pisplit.data.episodes import Episodes
from pisplit.data.noise import noise_margins
from pisplit.estimators.relifted import ReliftedRegression, Structure, state_dictionary
from pisplit.estimators.relifted_coordinates import Coordinates

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

#: The map from positions to motion in the scan: components, leading ones, degree and ridge.
MAP = Structure(16, 4, 2, 1e-9)
#: A lag or a play is not there if it takes less than this part off the residual that is left without it, or less than
#: the second part off the residual without an actuator: grids are finite, and one of the two makes up for the other.
WORTH, WORTH_OF_ALL = 0.05, 0.02
#: Times that the grid is narrowed around the best.
REFINEMENTS = 4


@brief
@dataclass(frozen=True, eq=False)
class FoundActuator:
    """The ``actuator`` that explains recordings best, and how well.

    actuator  lag and play, zero where they explain nothing
    residual  root mean square of one-step residuals on pairs that the map did not learn from, over the spread of the
              steps themselves
    without   the same without an actuator
    tried     (G, 3) lags in s, plays in units of the commands, and residuals
    """

    actuator: Actuator
    residual: float
    without: float
    tried: Array

    def __str__(self) -> str:
        a = self.actuator
        return (
            f"lag {a.lag:.3g} s, play {a.play:.3g}: one-step residual {self.residual:.3g} ({self.without:.3g} without)"
        )

    def plot(self, path: str | os.PathLike[str] | None = None) -> Figure:
        """Residuals over the lags and plays that were tried; written to ``path`` where one is given."""
        from pisplit.estimators.pictures import plot_actuator

        return plot_actuator(self, path)


def find_actuator(
    episodes: Episodes,
    lags: ArrayLike | None = None,
    plays: ArrayLike | None = None,
    start: ArrayLike | None = None,
    inputs: str = "ramp",
) -> FoundActuator:
    """Scan lag and play: the positions they make of the commands should explain the motion, one step ahead.

    For each candidate a quadratic map from principal components of the states and from positions to the next states is
    fitted to one half of the pairs and judged on the other. The grid is narrowed around the best four times.

    episodes  recordings whose inputs are commands, each from the moment on at which the actuators rest
    lags      in s; 0 and 0.25 to 4 time steps if not given
    plays     in units of the commands; 0 and 0.01 to 0.3 of their spread if not given
    start     (m,) position at rest before each recording; the first command if not given
    inputs    whether commands are reached linearly over a step ("ramp") or held ("step")

    What the states follow later than one step, such as slow damping in the arm, looks like a lag: trust a lag that
    ``without`` needs. Raises ValueError for negative candidates and for fewer than 20 pairs.

    Source: the two-step identification of hysteretic input elements, Giri and Bai (eds.), Block-oriented Nonlinear
    System Identification, Springer 2010.
    """
    spread = float(episodes.stacked_inputs().std(axis=0).max(initial=0.0))
    steps = episodes.dt * np.array([0.0, 0.25, 0.5, 1.0, 2.0, 4.0])
    lag_grid = _grid(steps if lags is None else lags, "lags")
    play_grid = _grid(spread * np.array([0.0, 0.01, 0.03, 0.1, 0.3]) if plays is None else plays, "plays")
    pairs = episodes.pairs(1)
    if len(pairs) < 20:
        raise ValueError(f"the recordings hold {len(pairs)} pairs; expected at least 20 to learn from and to judge on")
    tried: dict[tuple[float, float], float] = {}

    @cache
    def residual(lag: float, play: float) -> float:
        found = _residual(episodes.through(Actuator(lag=lag, play=play), start, inputs))
        tried[lag, play] = found
        return found

    without = residual(0.0, 0.0)
    best = min(((a, b) for a in lag_grid for b in play_grid), key=lambda key: residual(*key))
    steps_of = [_step(best[0], lag_grid), _step(best[1], play_grid)]
    for _ in range(REFINEMENTS):
        near = [[max(0.0, v + s * d) for d in (-0.5, 0.0, 0.5)] for v, s in zip(best, steps_of, strict=True)]
        best = min(((a, b) for a in near[0] for b in near[1]), key=lambda key: residual(*key))
        steps_of = [0.5 * s for s in steps_of]
    for simpler in ((0.0, 0.0), (0.0, best[1]), (best[0], 0.0)):
        gain = residual(*simpler) - residual(*best)
        if gain <= max(WORTH * residual(*simpler), WORTH_OF_ALL * without):
            best = simpler
            break
    rows = np.array([(*key, value) for key, value in tried.items()])
    return FoundActuator(Actuator(lag=best[0], play=best[1]), residual(*best), without, rows)


def _residual(episodes: Episodes) -> float:
    """One-step residual on every second stretch of ten pairs, of a map fitted to the others."""
    pairs, theta = episodes.pairs(1), state_dictionary(episodes)
    even = (np.arange(len(pairs)) // 10) % 2 == 0
    training, test = pairs.take(even), pairs.take(~even)
    coordinates = Coordinates.of(training, theta.names.quantities, (), MAP.components, noise_margins(episodes))
    r = coordinates.sizes[0]
    model = ReliftedRegression(coordinates, training, min(MAP.leading, r), MAP.degree).model(
        MAP, episodes, training, theta
    )
    now = model.rollout(model.lift(test.x_history, test.u_history), test.u[:, None]).z[:, 1, :r]
    before, after = ((x - coordinates.mean) @ coordinates.encode.T for x in (test.x, test.x_next))
    return float(np.sqrt(((after - now) ** 2).sum() / max(float(((after - before) ** 2).sum()), 1e-300)))


def _grid(values: ArrayLike, name: str) -> list[float]:
    found = finite_array(values, name, (None,))
    if not len(found) or (found < 0.0).any():
        raise ValueError(f"{name} = {found.tolist()}; expected numbers of at least zero, at least one")
    return sorted(set(found.tolist()))


def _step(value: float, grid: list[float]) -> float:
    """The distance of a grid's ``value`` to its farther neighbour."""
    at = grid.index(value)
    return max((abs(grid[i] - value) for i in (at - 1, at + 1) if 0 <= i < len(grid)), default=0.0)
