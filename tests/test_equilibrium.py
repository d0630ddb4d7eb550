"""The static map of an arm as a table: against statics, its slope, its inverse."""

from __future__ import annotations

import copy
import pickle
import warnings
from typing import Any

import casadi as ca
import numpy as np
import pytest

from pisplit.models.arm.static_table import EquilibriumTable, OutsideTable, equilibrium_table
from pisplit.models.arm.tendon_arm import TendonArm

HALF_WIDTH = 0.012


@pytest.fixture(scope="module")
def table() -> EquilibriumTable:
    return equilibrium_table(TendonArm.paper(nodes=3), HALF_WIDTH, stations=4, points=17)


def random_moves(n: int, seed: int, part: float = 1.0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-part * HALF_WIDTH, part * HALF_WIDTH, (n, 2))


def values(table: EquilibriumTable, moves: np.ndarray) -> np.ndarray:
    u = np.array([table.displacements(move) for move in moves])
    return np.asarray(table.function.map(len(u))(u.T)).T


def test_it_is_the_statics_of_the_arm(table: EquilibriumTable) -> None:
    moves = random_moves(60, 0)
    scene, n = table.arm.scene, table.n_strains
    exact = scene.statics().solve_many([table.displacements(move) for move in moves])
    assert exact.success.all()
    found = values(table, moves)
    positions = scene.fields(exact.states, 4)[..., :3].reshape(len(moves), -1)
    assert np.abs(found[:, n:] - positions).max() < 1e-6
    assert np.abs(found[:, :n] - exact.states[:, :n]).max() * scene.rod.length < 1e-5
    assert np.abs(found[:, n:] - positions).max() < 5 * table.error < 5e-6


def test_its_error_falls_with_the_fourth_power_of_the_spacing() -> None:
    arm = TendonArm.paper(nodes=3)
    coarse, fine = (equilibrium_table(arm, HALF_WIDTH, stations=3, points=k).error for k in (9, 17))
    assert coarse / fine > 8.0


def test_its_entries_are_named_and_share_the_scale_of_the_rod_coordinates(table: EquilibriumTable) -> None:
    coordinates = table.arm.scene.coordinates(4)
    n = table.n_strains
    assert len(table.names) == len(table.quantities) == table.function.numel_out(0) == n + 12
    assert table.names[:n] == tuple(f"{name}_eq" for name in coordinates.names[:n])
    assert table.names[-3:] == ("p_x[4]_eq", "p_y[4]_eq", "p_z[4]_eq")
    assert table.quantities[:n] == coordinates.quantities[:n]


def test_only_the_differential_part_of_the_displacements_counts(table: EquilibriumTable) -> None:
    u = table.displacements(np.array([0.004, -0.007]))
    np.testing.assert_allclose(table.function(u + 0.003), table.function(u), rtol=0, atol=1e-12)


def test_its_slope_is_that_of_the_statics(table: EquilibriumTable) -> None:
    u = ca.MX.sym("u", 3)
    slope = ca.Function("slope", [u], [ca.jacobian(table.function(u), u)])
    solve, basis, step = table.arm.scene.statics().solve, table.arm.differential_basis, 1e-5
    for move in random_moves(4, 1, 0.9):
        at = table.displacements(move)
        given = np.asarray(slope(at)) @ basis
        own = np.empty_like(given)
        exact = np.empty((3, 2))
        for k, direction in enumerate(basis.T):
            after, before = at + step * direction, at - step * direction
            own[:, k] = np.asarray(table.function(after) - table.function(before)).ravel() / (2 * step)
            exact[:, k] = (solve(after).tip - solve(before).tip) / (2 * step)
        np.testing.assert_allclose(given, own, rtol=1e-5, atol=1e-4 * np.abs(own).max())
        np.testing.assert_allclose(given[-3:], exact, atol=2e-4 * np.abs(exact).max())


def test_the_inverse_recovers_displacements_of_the_true_arm(table: EquilibriumTable) -> None:
    statics = table.arm.scene.statics()
    for move in random_moves(6, 2, 0.9):
        u = table.displacements(move)
        tip = statics.solve(u).tip
        np.testing.assert_allclose(table.inverse(tip), u, atol=1e-7)
        np.testing.assert_allclose(table.inverse([tip[0], tip[1], np.nan]), u, atol=1e-7)
        np.testing.assert_allclose(table.inverse(tip, guess=move + 0.003), u, atol=1e-7)
        one = statics.solve(table.inverse([np.nan, tip[1], np.nan])).tip
        assert abs(one[1] - tip[1]) < 1e-6


def test_out_of_reach_it_gives_the_nearest_point_of_the_table(table: EquilibriumTable) -> None:
    grid = np.linspace(-HALF_WIDTH, HALF_WIDTH, 41)
    moves = np.array(np.meshgrid(grid, grid)).reshape(2, -1).T
    tips = values(table, moves)[:, -3:]
    for target in ([1.0, 0.2, 0.5], [0.0, -0.6, 0.4], [-2.0, 2.0, 0.0]):
        u = table.inverse(target)
        found = table.arm.differential_basis.T @ (u - table.arm.rest_inputs)
        assert np.abs(found).max() <= HALF_WIDTH * (1 + 1e-12)
        distance = np.linalg.norm(np.asarray(table.function(u)).ravel()[-3:] - target)
        assert distance <= np.linalg.norm(tips - target, axis=1).min() + 1e-6


@pytest.mark.parametrize("move", [(1.0, 0.0), (0.0, 1.0), (1.0, 1.0), (-1.0, 0.3), (1.0 + 1e-12, -1.0)])
def test_at_its_edge_it_is_still_the_statics(table: EquilibriumTable, move: tuple[float, float]) -> None:
    u = table.displacements(HALF_WIDTH * np.array(move))
    np.testing.assert_allclose(
        np.asarray(table.function(u)).ravel()[-3:], table.arm.scene.statics().solve(u).tip, atol=1e-6
    )


def test_beyond_its_edge_it_goes_on_with_the_slope_there_and_says_so(table: EquilibriumTable) -> None:
    """Value and slope are continuous, second differences vanish; a graph says nothing, calls with numbers do."""
    edge, step = HALF_WIDTH * np.array([1.0, 0.2]), HALF_WIDTH * np.array([0.1, 0.0])
    u = np.array([table.displacements(edge + k * step) for k in range(4)])
    np.testing.assert_allclose(table.outside(u), HALF_WIDTH * np.array([0.0, 0.1, 0.2, 0.3]), atol=1e-15)
    with pytest.warns(OutsideTable, match=r"3 of 4 inputs are up to 3\.6 mm outside .* half_width >= 0\.0156"):
        found = table.values(u)
    assert np.abs(np.diff(found, n=2, axis=0)).max() < 1e-6 * np.abs(found).max()
    inner = values(table, np.array([edge - 1e-3 * step, edge]))
    slope = (inner[1] - inner[0]) / 1e-3
    np.testing.assert_allclose(found[1] - found[0], slope, atol=2e-3 * np.abs(slope).max())
    with pytest.warns(OutsideTable, match="1 of 1"):
        one = table.function(u[2])
    np.testing.assert_allclose(np.asarray(one).ravel(), found[2], atol=1e-12)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        table.values(u[0])
        table.function(ca.MX.sym("u", 3))


def test_a_copy_of_a_table_still_says_so(table: EquilibriumTable) -> None:
    u = table.displacements(HALF_WIDTH * np.array([0.0, -2.0]))
    for twin in (pickle.loads(pickle.dumps(table)), copy.deepcopy(table)):
        with pytest.warns(OutsideTable, match="12 mm"):
            np.testing.assert_allclose(np.asarray(twin.function(u)), np.asarray(table.function(u)))
    with pytest.raises(ValueError, match=r"inputs have shape \(2,\); expected \(\.\.\., 3\)"):
        table.outside([0.0, 0.0])


@pytest.mark.parametrize(
    "target", [[1.0, 2.0], [np.nan] * 3, "tip", [0.1, np.inf, 0.0], [[0.1, 0.0, 0.6]], None, [0.1, "x", 0.0]]
)
def test_bad_targets_are_refused_in_one_line(table: EquilibriumTable, target: Any) -> None:
    with pytest.raises(ValueError, match="target") as error:
        table.inverse(target)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("options", "message"),
    [({"half_width": 0.0}, "half_width"), ({"half_width": np.nan}, "half_width"), ({"points": 5}, "points")],
)
def test_bad_tables_are_refused_in_one_line(options: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message) as error:
        equilibrium_table(TendonArm.paper(nodes=3), **{"half_width": 0.01, **options})
    assert "\n" not in str(error.value)
