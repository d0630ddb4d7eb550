"""The static map of a tendon arm as a smooth table: input observables that cost microseconds."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from pisplit.checks import Array, count, positive
from pisplit.models.tendon_arm import TendonArm


@dataclass(frozen=True)
class EquilibriumTable:
    """Equilibrium strains and station positions as a cubic spline over differential displacements.

    Attributes:
        function: CasADi ``u (m,) -> [strains xi (n,), positions (3 S,)]``; only the differential part of u counts, the
            common displacement is that of the arm at rest.
        names, quantities: of its entries; strains share the scaling group of the rod coordinates.
        n_strains: number of strains n.
        half_width: largest differential displacement in m along each axis of the table.
        error: largest position error in m at the centres of its cells, against the statics.
    """

    function: ca.Function
    names: tuple[str, ...]
    quantities: tuple[str, ...]
    n_strains: int
    half_width: float
    error: float


def equilibrium_table(arm: TendonArm, half_width: float, stations: int = 6, points: int = 33) -> EquilibriumTable:
    """Solve the statics on a grid of differential displacements and fit a spline.

    Raises RuntimeError where the statics have no solution on the grid.
    """
    positive(half_width, "half_width", "m")
    count(points, "points", 8)
    basis = arm.differential_basis
    grid = np.linspace(-half_width, half_width, points)
    values, strains = _solve(arm, basis, grid, stations)
    table = ca.interpolant("equilibrium", "bspline", [grid, grid], values.transpose(2, 0, 1).ravel(order="F"))
    u = ca.MX.sym("u", arm.scene.n_inputs)
    function = ca.Function("equilibrium", [u], [table(ca.DM(basis.T) @ (u - ca.DM(arm.rest_inputs)))], ["u"], ["x_eq"])
    centres = 0.5 * (grid[1:] + grid[:-1])[:: max(1, points // 8)]
    exact, _ = _solve(arm, basis, centres, stations)
    at = np.array(np.meshgrid(centres, centres, indexing="ij")).reshape(2, -1)
    difference = np.asarray(table.map(at.shape[1])(at)).T - exact.reshape(at.shape[1], -1)
    coordinates = arm.scene.coordinates(stations)
    positions = tuple(f"p_{axis}[{k + 1}]" for k in range(stations) for axis in "xyz")
    return EquilibriumTable(
        function=function,
        names=tuple(f"{name}_eq" for name in (*coordinates.names[:strains], *positions)),
        quantities=(*coordinates.quantities[:strains], *("p",) * len(positions)),
        n_strains=strains,
        half_width=half_width,
        error=float(np.abs(difference[:, strains:]).max()),
    )


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
