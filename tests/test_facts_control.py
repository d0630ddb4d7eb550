"""Facts of the controller: checked limits, growth of predictions, time that it takes."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

from pisplit import Dictionary, Episodes, LinearEDMDc
from pisplit import observables as ob
from pisplit.controllers import MPC
from pisplit.controllers.mpc.growth import spectral_radius, warn_of_growth
from pisplit.controllers.mpc.limits import input_limits
from pisplit.controllers.mpc.mpc import _each_output
from pisplit.controllers.mpc.qp import QP, QPSettings


@pytest.mark.parametrize("bad", [[0.0, np.nan], np.nan, [np.nan, np.nan], [1.0, 2.0, 3.0]])
def test_limits_of_outputs_are_numbers_one_each(bad: object) -> None:
    with pytest.raises(ValueError, match="y_min"):
        _each_output(bad, "y_min", 2)  # type: ignore[arg-type]
    assert _each_output(0.5, "y_min", 2).tolist() == [0.5, 0.5]
    assert _each_output([0.5, -np.inf], "y_min", 2).tolist() == [0.5, -np.inf]


@pytest.mark.parametrize("size", [3, 50, 51, 120])
def test_the_spectral_radius_is_the_largest_modulus(size: int) -> None:
    rng = np.random.default_rng(size)
    q, _ = np.linalg.qr(rng.normal(size=(size, size)))
    values = np.linspace(-0.9, 0.5, size)
    assert spectral_radius(q @ np.diag(values) @ q.T) == pytest.approx(0.9, rel=1e-3)


def test_growth_over_the_horizon_is_said_beyond_its_limit() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warn_of_growth(np.diag([1.01, 0.5]), 20)
    with pytest.warns(UserWarning, match=r"spectral radius 3.0000 grows 3.5e\+09 times over 20 steps"):
        warn_of_growth(np.diag([3.0, 0.5]), 20)


def test_an_output_may_have_no_weight_but_not_all() -> None:
    lifted = LinearEDMDc(Dictionary(ob.Identity(), n_states=2, n_inputs=1), 0.0).fit(recordings()).lifted
    assert MPC(lifted, 5, -1.0, 1.0, 0.5, track=[0, 1], output_weight=[1.0, 0.0]).horizon == 5
    for bad in ([0.0, 0.0], [1.0, -1.0]):
        with pytest.raises(ValueError, match="none negative, one positive"):
            MPC(lifted, 5, -1.0, 1.0, 0.5, track=[0, 1], output_weight=bad)


def recordings() -> Episodes:
    rng = np.random.default_rng(0)
    a, b, x, u = np.array([[0.9, 0.1], [0.0, 0.8]]), np.array([0.0, 1.0]), [np.zeros(2)], rng.normal(size=(50, 1))
    for value in u:
        x.append(a @ x[-1] + b * value[0])
    return Episodes([np.array(x)], [u], 0.1)


def test_multipliers_of_a_problem_that_was_not_solved_do_not_start_the_next() -> None:
    qp = QP(np.eye(1), np.ones((2, 1)), settings=QPSettings())
    assert qp.solve(np.array([-3.0]), np.array([-1.0, -1.0]), np.array([1.0, 5.0])).x == pytest.approx([1.0], abs=1e-3)
    assert qp._y[0] == pytest.approx(2.0, abs=1e-2)
    assert qp.solve(np.array([0.0]), np.array([1.0, -5.0]), np.array([5.0, -1.0])).x is None
    assert qp._y.tolist() == [0.0, 0.0] and qp._x.tolist() == [0.0]


@pytest.mark.parametrize("lost", [slice(0, 1), slice(None)])
def test_a_prediction_that_is_not_finite_in_any_entry_is_no_problem_to_solve(lost: slice) -> None:
    lifted = LinearEDMDc(Dictionary(ob.Identity(), n_states=2, n_inputs=1), 0.0).fit(recordings()).lifted
    problem = MPC(lifted, 5, -1.0, 1.0, 0.5, track=[0])._problem
    free = np.zeros(5)
    free[lost] = np.nan
    still = problem.hold(np.zeros(1))
    assert problem.solve(free, np.zeros(5), np.zeros(1), still).status == "prediction not finite"
    assert problem.solve(np.zeros(5), np.zeros(5), np.zeros(1), still).x == pytest.approx(np.zeros(5), abs=1e-4)


def test_the_first_solve_has_its_own_limit_of_iterations() -> None:
    rng = np.random.default_rng(0)
    q = rng.normal(size=(6, 6))
    P, A = np.eye(6) * np.logspace(0, 6, 6), q
    settings = QPSettings(eps=1e-12, max_iterations=10, first_max_iterations=20)
    problem = QP(P, A, settings=settings)
    ends = [problem.solve(np.ones(6), np.full(6, 1.0), np.full(6, 2.0)).iterations for _ in range(2)]
    assert ends == [20, 10]


@pytest.mark.parametrize(("m", "across"), [(2, (1.0, -2.0)), (3, (1.0, 1.0, 1.0)), (4, (1.0, -1.0, 0.0, 3.0))])
def test_an_input_goes_to_the_nearest_one_inside_its_limits(m: int, across: tuple[float, ...]) -> None:
    """Of a convex set, x is the point nearest to u where no point y of the set has (u - x) . (y - x) > 0."""
    rng = np.random.default_rng(m)
    normal = np.array(across) / np.linalg.norm(across)
    basis = np.linalg.svd(normal[None, :])[2][1:].T
    limits = input_limits(-1.0, 1.5, 0.4, m, 0.1 * normal, basis)
    on_bounds = 0
    for _ in range(200):
        before = limits.offset + basis @ limits.coordinates(rng.uniform(-1.0, 1.5, m))
        u = before + rng.normal(size=m)
        x = limits.project(u, before)
        low, high = np.maximum(-1.0, before - 0.4), np.minimum(1.5, before + 0.4)
        assert (x >= low).all() and (x <= high).all() and abs(normal @ (x - limits.offset)) < 1e-9
        on_bounds += int((np.minimum(x - low, high - x) < 1e-9).any())
        others = np.array([limits.project(before + rng.normal(size=m), before) for _ in range(20)])
        assert ((others - x) @ (u - x)).max() < 1e-8
        np.testing.assert_allclose(limits.project(x, before), x, atol=1e-9)
    assert on_bounds > 100


def test_a_box_that_the_plane_misses_is_refused_whatever_the_directions() -> None:
    for m in (2, 3):
        normal = np.ones(m) / np.sqrt(m)
        basis = np.linalg.svd(normal[None, :])[2][1:].T
        assert (
            input_limits(1.0, 2.0, 0.1, m, 2.0 * np.ones(m), basis).project(2.0 * np.ones(m), 2.0 * np.ones(m))[0]
            == 2.0
        )
        with pytest.raises(ValueError, match="contains no input of the training data"):
            input_limits(1.0, 2.0, 0.1, m, 2.01 * np.ones(m), basis)
