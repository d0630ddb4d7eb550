"""The static map of a tendon arm as a smooth table: input observables that cost microseconds."""

from __future__ import annotations

import os
import warnings
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from pisplit.brief import brief
from pisplit.checks import Array, count, finite_array, positive, real_array
from pisplit.models.arm.tendon_arm import TendonArm

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: Part of the table that its edges are taken at.
INSIDE = 1.0 - 1e-9
#: Part of the half-width beyond the edge that is rounding of whoever computed the inputs.
ROUNDING = 1e-9


#: Part of the way beyond the edge, back from it, over which the slope there is taken.
SECANT = 1e-3


class OutsideTable(UserWarning):
    """Inputs are outside the table of equilibria."""


@dataclass(frozen=True)
class TableRange:
    """Which inputs a table covers.

    Attributes:
        rest: displacements (m,) in m of the arm at rest, the middle of the table.
        basis: directions (m, 2) of its axes.
        half_width: largest move in m along each of them.
    """

    rest: Array
    basis: Array
    half_width: float

    def outside(self, inputs: ArrayLike) -> Array:
        """By how much inputs (..., m) in m are outside, (...) in m along the axes; zero within."""
        u = real_array(inputs, "inputs")
        if u.ndim == 0 or u.shape[-1] != len(self.rest):
            raise ValueError(f"inputs have shape {u.shape}; expected (..., {len(self.rest)})")
        beyond = np.abs((u - self.rest) @ self.basis).max(axis=-1) - self.half_width
        return np.where(beyond > ROUNDING * self.half_width, beyond, 0.0)

    def say(self, inputs: ArrayLike) -> None:
        """Warn (``OutsideTable``) where inputs (..., m) in m are outside."""
        beyond = np.atleast_1d(self.outside(inputs))
        if beyond.any():
            warnings.warn(
                f"{np.count_nonzero(beyond)} of {beyond.size} inputs are up to {1e3 * beyond.max():.3g} mm outside the "
                f"table of equilibria, which goes on linearly there; make it with half_width >= "
                f"{self.half_width + beyond.max():.3g}",
                OutsideTable,
                stacklevel=3,
            )


class TableFunction(ca.Function):
    """The CasADi function of a table; where it is called with numbers outside, it says so.

    Args:
        function: the function u -> x_eq.
        within: the inputs that the table covers.
    """

    def __init__(self, function: ca.Function, within: TableRange) -> None:
        ca.Function.__init__(self, function)
        self.within = within

    def __call__(self, *given: Any, **named: Any) -> Any:
        """As ``casadi.Function``."""
        inputs = given[0] if given else named.get("u")
        if not isinstance(inputs, ca.MX | ca.SX | None):
            self.within.say(np.asarray(inputs, dtype=float).reshape(self.numel_in(0), -1).T)
        return ca.Function.__call__(self, *given, **named)

    def __reduce__(self) -> tuple[Any, ...]:
        return _restored, (self.serialize(), self.within)

    def __deepcopy__(self, memo: dict[int, Any] | None = None) -> TableFunction:
        return self  # nothing in it changes


def _restored(text: str, within: TableRange) -> TableFunction:
    return TableFunction(ca.Function.deserialize(text), within)


@brief
@dataclass(frozen=True)
class EquilibriumTable:
    """Equilibrium strains and station positions as a cubic spline over differential displacements.

    Attributes:
        arm: the arm.
        function: CasADi ``u (m,) -> [strains xi (n,), positions (3 S,)]``; only the differential part of u counts, the
            common displacement is that of the arm at rest. Outside the table it goes on from the nearest edge with the
            value and the slope there; called with numbers it warns there (``OutsideTable``), in a graph it cannot:
            check the inputs that a model or a loop may see by ``outside``.
        names, quantities: of its entries; strains share the scaling group of the rod coordinates.
        n_strains: number of strains n.
        half_width: largest differential displacement in m along each axis of the table.
        error: largest position error in m at the centres of its cells, against the statics.
    """

    arm: TendonArm
    function: TableFunction
    names: tuple[str, ...]
    quantities: tuple[str, ...]
    n_strains: int
    half_width: float
    error: float

    def outside(self, inputs: ArrayLike) -> Array:
        """By how much inputs (..., m) in m are outside the table, (...) in m along its axes; zero within it."""
        return self.function.within.outside(inputs)

    def values(self, inputs: ArrayLike) -> Array:
        """Equilibria (..., n + 3 S) under inputs (..., m) in m; warns where they are outside the table."""
        u = real_array(inputs, "inputs")
        self.function.within.say(u)
        rows = u.reshape(-1, u.shape[-1])
        found = np.asarray(self.function.map(len(rows))(rows.T)).T
        return np.asarray(found.reshape(*u.shape[:-1], -1), dtype=np.float64)

    def displacements(self, moves: Array) -> Array:
        """Inputs (m,) of differential moves (2,) in m along the axes of the table."""
        inputs: Array = self.function.within.rest + self.function.within.basis @ moves
        return inputs

    def inverse(self, target: ArrayLike, guess: ArrayLike | None = None) -> Array:
        """Displacements (m,) whose equilibrium has its tip at ``target`` (3,) in m; NaN coordinates are free.

        Gauss-Newton from differential moves ``guess`` (2,); the nearest point where the tip cannot get there.
        """
        from scipy.optimize import least_squares  # slow to load, and needed here alone

        wanted = _target(target)
        given = np.flatnonzero(np.isfinite(wanted))
        tip, slope = self._tip

        def miss(moves: Array) -> Array:
            return 1e3 * (np.asarray(tip(moves)).ravel()[given] - wanted[given])

        def sensitivity(moves: Array) -> Array:
            return 1e3 * np.asarray(slope(moves))[given]

        start = np.zeros(2) if guess is None else np.clip(finite_array(guess, "guess", (2,)), *self._box)
        found = least_squares(miss, start, jac=sensitivity, bounds=self._box, x_scale=1e-3, xtol=1e-12, ftol=1e-15)
        return self.displacements(found.x)

    @property
    def _box(self) -> tuple[Array, Array]:
        return np.full(2, -self.half_width), np.full(2, self.half_width)

    @cached_property
    def _tip(self) -> tuple[ca.Function, ca.Function]:
        """Tip (3,) in m, and its derivative (3, 2), by differential moves (2,) in m."""
        within, moves = self.function.within, ca.MX.sym("moves", 2)
        tip = self.function(ca.DM(within.rest) + ca.DM(within.basis) @ moves)[-3:]
        return ca.Function("tip", [moves], [tip]), ca.Function("slope", [moves], [ca.jacobian(tip, moves)])

    def plot(self, path: str | os.PathLike[str] | None = None) -> Figure:
        """Where the tip gets, and how far by input; written to ``path`` where one is given."""
        from pisplit.models.arm.pictures import plot_table

        return plot_table(self, path)


def equilibrium_table(arm: TendonArm, half_width: float, stations: int = 6, points: int = 33) -> EquilibriumTable:
    """Solve the statics on a grid of differential displacements and fit a spline.

    Args:
        arm: the arm.
        half_width: largest differential displacement in m along each axis of the table.
        stations: number of stations whose positions are in the table.
        points: grid points along each axis, at least 8.

    Raises ValueError for an arm of several sections, RuntimeError where the statics have no solution on the grid.
    """
    arm.check_one_section("equilibrium_table")
    positive(half_width, "half_width", "m")
    count(points, "points", 8)
    basis = arm.differential_basis
    grid = np.linspace(-half_width, half_width, points)
    values, strains = _solve(arm, basis, grid, stations)
    table = ca.interpolant("equilibrium", "bspline", [grid, grid], values.transpose(2, 0, 1).ravel(order="F"))
    centres = 0.5 * (grid[1:] + grid[:-1])[:: max(1, points // 8)]
    exact, _ = _solve(arm, basis, centres, stations)
    at = np.array(np.meshgrid(centres, centres, indexing="ij")).reshape(2, -1)
    difference = np.asarray(table.map(at.shape[1])(at)).T - exact.reshape(at.shape[1], -1)
    coordinates = arm.scene.coordinates(stations)
    positions = tuple(f"p_{axis}[{k + 1}]" for k in range(stations) for axis in "xyz")
    within = TableRange(arm.rest_inputs, basis, half_width)
    return EquilibriumTable(
        arm=arm,
        function=TableFunction(_continued(arm, table, half_width), within),
        names=tuple(f"{name}_eq" for name in (*coordinates.names[:strains], *positions)),
        quantities=(*coordinates.quantities[:strains], *("p",) * len(positions)),
        n_strains=strains,
        half_width=half_width,
        error=float(np.abs(difference[:, strains:]).max()),
    )


def _continued(arm: TendonArm, table: ca.Function, half_width: float) -> ca.Function:
    """``u -> x_eq`` of a spline over differential moves, beyond its edges with the value and the slope there."""
    u = ca.MX.sym("u", arm.scene.n_inputs)
    moves = ca.DM(arm.differential_basis.T) @ (u - ca.DM(arm.rest_inputs))
    edge = half_width * INSIDE  # CasADi's splines are zero on and beyond the upper edge
    nearest = ca.fmax(-edge, ca.fmin(edge, moves))
    beyond = moves - nearest
    # The slope as a difference: with derivatives of the spline in the value, second derivatives would need its third.
    before = ca.fmax(-edge, ca.fmin(edge, nearest - SECANT * beyond))
    value = table(nearest)
    return ca.Function("equilibrium", [u], [value + (value - table(before)) / SECANT], ["u"], ["x_eq"])


def _target(target: ArrayLike) -> Array:
    wanted = real_array(target, "target")
    if wanted.shape != (3,) or np.isinf(wanted).any() or np.isnan(wanted).all():
        raise ValueError(f"target = {wanted.tolist()}; expected three coordinates in m, at least one of them not NaN")
    return wanted


def _solve(arm: TendonArm, basis: Array, grid: Array, stations: int) -> tuple[Array, int]:
    """Strains and positions (G, G, n + 3 S) at every pair of grid values."""
    moves = np.array(np.meshgrid(grid, grid, indexing="ij")).reshape(2, -1).T @ basis.T
    batch = arm.scene.statics().solve_many(arm.rest_inputs + moves)
    if not batch.success.all():
        worst = moves[int(np.argmin(batch.success))]
        raise RuntimeError(
            f"no equilibrium at differential displacements {worst.tolist()} m; choose a smaller half_width"
        )
    n = arm.scene.n_strains
    positions = arm.scene.fields(batch.states, stations)[..., :3].reshape(len(moves), -1)
    return np.hstack([batch.states[:, :n], positions]).reshape(len(grid), len(grid), -1), n
