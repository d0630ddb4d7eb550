"""Lag and play between command and motion, found from recordings of the commands alone."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from itertools import product
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
from pisplit.lifted.operators import excited_inputs

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

#: Maps from positions to motion to scan with: components, leading ones, degree and ridge. Few or noisy pairs want less.
MAPS = tuple(Structure(16, *rest) for rest in ((4, 2, 1e-9), (4, 2, 1e-4), (4, 2, 1e-2), (1, 2, 1e-4), (1, 2, 1e-2)))
#: A lag or a play is there if what it takes off the residual is more than this part of it, more than what rounding
#: makes, and, over stretches of the recordings, more than so many of its standard errors; where there are fewer
#: stretches than that, more than the second part.
WORTH, WORTH_UNTOLD, ROUNDING, CERTAIN, STRETCHES = 0.01, 0.05, 1e-6, 3.0, 3
#: Pairs of a stretch: every second one is judged on.
STRETCH = 10
#: Squared residual of a component, in parts of its steps, below which it is rounding.
EXACT = 1e-26
#: Times that the grid is narrowed around the best.
REFINEMENTS = 4


@brief
@dataclass(frozen=True, eq=False)
class FoundActuator:
    """The ``actuator`` that explains recordings best, and how well.

    actuator  lag and play, zero where they explain nothing
    residual  root mean square of one-step residuals on pairs that the map did not learn from, over that of the steps
              themselves: the geometric mean over the principal components of the states
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
    fitted to one half of the pairs and judged on the other. Positions count in the directions in which commands move,
    the same for all candidates. Every component weighs by its own residual, which is what a likelihood with unknown
    noise does: those that are noise say nothing. The grid of lags and plays is narrowed around the best of all pairs
    four times; lag alone, play alone and neither are looked for in the same way, and the simplest is taken that is not
    worse by 1 % and by three standard errors of the difference, over stretches of ten pairs.

    episodes  recordings whose inputs are commands, each from the moment on at which the actuators rest
    lags      in s; 0 and 0.25 to 4 time steps if not given
    plays     in units of the commands; 0 and 0.01 to 0.3 of their spread if not given
    start     (m,) position at rest before each recording; the first command if not given
    inputs    whether commands are reached linearly over a step ("ramp") or held ("step")

    What the states follow later than one step, such as slow damping in the arm, looks like a lag: trust a lag that
    ``without`` needs. Raises ValueError for negative candidates and for fewer than 20 pairs.

    Source: the two-step identification of hysteretic input elements, Giri and Bai (eds.), Block-oriented Nonlinear
    System Identification, Springer 2010; the likelihood with unknown noise: Ljung, System Identification, 1999,
    section 15.2.
    """
    spread = float(episodes.stacked_inputs().std(axis=0).max(initial=0.0))
    steps = episodes.dt * np.array([0.0, 0.25, 0.5, 1.0, 2.0, 4.0])
    lag_grid = _grid(steps if lags is None else lags, "lags")
    play_grid = _grid(spread * np.array([0.0, 0.01, 0.03, 0.1, 0.3]) if plays is None else plays, "plays")
    pairs = episodes.pairs(1)
    if len(pairs) < 20:
        raise ValueError(f"the recordings hold {len(pairs)} pairs; expected at least 20 to learn from and to judge on")
    tried: dict[tuple[float, float], Array] = {}
    structure = min(MAPS, key=lambda s: _size(_missed(episodes, s)))

    def missed(lag: float, play: float) -> Array:
        if (lag, play) not in tried:
            tried[lag, play] = _missed(positions(episodes, Actuator(lag=lag, play=play), start, inputs), structure)
        return tried[lag, play]

    found = []
    for of_lags, of_plays in (([0.0], [0.0]), ([0.0], play_grid), (lag_grid, [0.0]), (lag_grid, play_grid)):
        grids = [sorted({0.0, *grid}) for grid in (of_lags, of_plays)]
        best = min(product(*grids), key=lambda key: _size(missed(*key)))
        steps_of = [_step(v, grid) for v, grid in zip(best, grids, strict=True)]
        for _ in range(REFINEMENTS if any(steps_of) else 0):
            near = [
                sorted({max(0.0, v + s * d) for d in (-0.5, 0.0, 0.5)}) for v, s in zip(best, steps_of, strict=True)
            ]
            best = min(product(*near), key=lambda key: _size(missed(*key)))
            steps_of = [0.5 * s for s in steps_of]
        found.append(best)
    kept = next(key for key in found if not _worse(missed(*key), missed(*found[-1])))
    rows = np.array([(*key, _size(value)) for key, value in tried.items()])
    residual, without = _size(missed(*kept)), _size(missed(0.0, 0.0))
    return FoundActuator(Actuator(lag=kept[0], play=kept[1]), residual, without, rows)


def positions(episodes: Episodes, actuator: Actuator, start: ArrayLike | None = None, inputs: str = "ramp") -> Episodes:
    """The ``episodes`` with positions of an ``actuator`` in the place of commands, in the directions of these.

    Play moves positions across those directions, too, but by little: what it does there cannot be learned. ``start``
    and ``inputs`` as in :meth:`Episodes.through`.
    """
    plane = excited_inputs(episodes.pairs(1))
    moved = episodes.through(actuator, start, inputs)
    return replace(moved, us=[plane.offset + (u - plane.offset) @ plane.basis @ plane.basis.T for u in moved.us])


def _missed(episodes: Episodes, structure: Structure) -> Array:
    """Squared one-step residuals (K, r) on every second stretch of pairs; a map of this ``structure`` knows the others.

    They are in parts of the mean squared step of each component.
    """
    pairs, theta = episodes.pairs(1), state_dictionary(episodes)
    even = (np.arange(len(pairs)) // STRETCH) % 2 == 0
    training, test = pairs.take(even), pairs.take(~even)
    coordinates = Coordinates.of(training, theta.names.quantities, (), structure.components, noise_margins(episodes))
    r = coordinates.sizes[0]
    regression = ReliftedRegression(coordinates, training, min(structure.leading, r), structure.degree)
    model = regression.model(structure, episodes, training, theta)
    now = model.rollout(model.lift(test.x_history, test.u_history), test.u[:, None]).z[:, 1, :r]
    before, after = ((x - coordinates.mean) @ coordinates.encode.T for x in (test.x, test.x_next))
    steps = ((after - before) ** 2).mean(axis=0)
    return np.asarray((after - now) ** 2 / np.maximum(steps, 1e-300))


def _size(missed: Array) -> float:
    """The geometric mean over the components of what is ``missed`` (K, r)."""
    return float(np.exp(0.5 * np.mean(np.log(missed.mean(axis=0) + EXACT))))


def _worse(this: Array, best: Array) -> bool:
    """Whether what ``this`` missed (K, r) is more than what the ``best`` did, by more than chance."""
    gain = _size(this) - _size(best)
    edges = np.arange(0, len(this), STRETCH)
    lost, least = (np.log(np.add.reduceat(missed, edges) + EXACT).sum(axis=1) for missed in (this, best))
    certain = lost - least
    n = len(certain)
    if n < STRETCHES:
        return bool(gain > max(WORTH_UNTOLD * _size(this), ROUNDING))
    error = float(certain.std(ddof=1)) / np.sqrt(n)
    return bool(gain > max(WORTH * _size(this), ROUNDING) and certain.mean() > CERTAIN * error)


def _grid(values: ArrayLike, name: str) -> list[float]:
    found = finite_array(values, name, (None,))
    if not len(found) or (found < 0.0).any():
        raise ValueError(f"{name} = {found.tolist()}; expected numbers of at least zero, at least one")
    return sorted(set(found.tolist()))


def _step(value: float, grid: list[float]) -> float:
    """The distance of a grid's ``value`` to its farther neighbour."""
    at = grid.index(value)
    return max((abs(grid[i] - value) for i in (at - 1, at + 1) if 0 <= i < len(grid)), default=0.0)
