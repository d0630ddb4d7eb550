"""MPC: optimal where the QP is solved, admissible always."""

import time
from dataclasses import replace
from typing import Any

import casadi as ca
import cvxpy as cp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from example_models import DIFFERENTIAL, EXACT, arm_model
from pisplit.controllers import MPC, QPSettings
from pisplit.controllers.mpc.qp import QP
from pisplit.lifted.model import LiftedModel


def optimal_inputs(
    model: LiftedModel,
    x: np.ndarray,
    r: np.ndarray,
    u0: np.ndarray,
    limits: tuple[np.ndarray, np.ndarray, np.ndarray],
    w: np.ndarray | None = None,
    y_min: np.ndarray | None = None,
    y_max: np.ndarray | None = None,
    output_weight: np.ndarray | float = 1.0,
    output_scale: np.ndarray | float = 1.0,
    output_slack_weight: float = 1e3,
) -> tuple[np.ndarray, np.ndarray]:
    """The MPC problem as its docstring states it, with states, solved by an interior-point method.

    Disturbance w (n,) and read-out y = x + (what C misses of the measured x); rate weight 1e-2, input weight 1e-5.
    """
    (low, high, rate), H, n = limits, len(r), model.n_states
    amplitude, tip = (high - low) / 2, [0, 1, 2]
    X, U, s = cp.Variable((H + 1, n)), cp.Variable((H, 3)), cp.Variable(H)
    size = np.broadcast_to(output_scale, (3,))
    read = X[1:] @ model.C[tip].T + np.tile(x[tip] - model.C[tip] @ x, (H, 1))
    v = cp.Variable((H, model.input_basis.shape[1]))
    moves = cp.diff(cp.vstack([u0[None, :], U]), axis=0)
    rules = [X[0] == x, np.tile(low, (H, 1)) <= U, np.tile(high, (H, 1)) >= U, s >= 0]
    rules += [cp.abs(moves) <= np.tile(rate, (H, 1))]
    rules += [np.tile(model.input_offset, (H, 1)) + v @ model.input_basis.T == U]
    rules += [X[j + 1] == model.A @ X[j] + model.B @ U[j] + model.c + (0.0 if w is None else w) for j in range(H)]
    slack = cp.reshape(s, (H, 1), order="C") @ size[None, :]
    if y_min is not None:
        rules += [read >= np.tile(y_min, (H, 1)) - slack]
    if y_max is not None:
        rules += [read <= np.tile(y_max, (H, 1)) + slack]
    weight = np.broadcast_to(output_weight, (3,)) * ~np.isnan(r)
    missed = cp.multiply(np.sqrt(weight) / size, read - np.nan_to_num(r))
    amplitudes = np.tile(amplitude, (H, 1))
    cost = cp.sum_squares(missed) + 1e-2 * cp.sum_squares(moves / amplitudes)
    cost += 1e-5 * cp.sum_squares((U - np.tile(model.input_offset, (H, 1))) / amplitudes)
    cp.Problem(cp.Minimize(1e2 * (cost + output_slack_weight * cp.sum_squares(s))), rules).solve(solver=cp.CLARABEL)
    return np.asarray(U.value), np.asarray(read.value)


SOFT: dict[str, dict[str, Any]] = {
    "inputs": {},
    "upper": {"y_max": np.full(3, 0.02)},
    "lower": {"y_min": np.array([-0.01, -0.02, -0.01]), "output_slack_weight": 50.0},
    "both, one absent": {"y_min": np.array([-0.03, -np.inf, -0.02]), "y_max": np.array([0.01, 0.02, np.inf])},
    "weights and sizes": {
        "y_max": np.full(3, 0.02),
        "output_weight": np.array([1.0, 0.2, 3.0]),
        "output_scale": np.array([1.0, 0.5, 2.0]),
        "output_slack_weight": 20.0,
    },
}


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("options", SOFT.values(), ids=SOFT)
def test_moves_solve_the_stated_problem(seed: int, options: dict[str, Any]) -> None:
    """At three successive steps: the input before, the disturbance and what is free differ."""
    rng = np.random.default_rng(seed)
    model = arm_model(seed, basis=DIFFERENTIAL if seed % 2 else np.eye(3))
    wrong, shift = 0.1 * rng.standard_normal((6, 6)), 0.02 * rng.standard_normal(6)
    model = replace(model, C=np.eye(6) + wrong, d=shift)
    H, limits = 8, (np.array([-0.01, -0.012, -0.009]), np.array([0.012, 0.01, 0.011]), np.array([0.004, 0.003, 0.005]))
    mpc = MPC(model, H, *limits, rate_weight=1e-2, input_weight=1e-5, qp=EXACT, **options)
    before = model.input_offset
    mpc.reset(before)
    bound, active = {"y_min": np.full(3, -np.inf), "y_max": np.full(3, np.inf)} | options, False
    for k in range(3):
        x, r = 0.03 * rng.standard_normal(6), 0.1 * rng.standard_normal(3) + 0.02 * rng.standard_normal((H, 3))
        r[:, 1] = np.nan if k == 1 else r[:, 1]
        move = mpc.step(x, r)
        U, y = optimal_inputs(model, x, r, before, limits, mpc.disturbance, **options)
        assert move.status == "solved" and not move.fallback
        np.testing.assert_allclose(move.u, U[0], atol=2e-6)
        np.testing.assert_allclose(move.predicted, y, atol=2e-5)
        change = np.abs(np.diff(U, axis=0, prepend=before[None]))
        active |= bool(np.isclose(change, limits[2], atol=1e-6).any())
        active |= bool((y > bound["y_max"] + 1e-5).any() or (y < bound["y_min"] - 1e-5).any())
        before = move.u
    assert active


def test_a_free_output_weighs_nothing() -> None:
    model, rng = arm_model(3), np.random.default_rng(0)
    full = MPC(model, 10, -0.01, 0.01, 0.003, qp=EXACT)
    two = MPC(model, 10, -0.01, 0.01, 0.003, axes=(0, 2), qp=EXACT)
    for mpc in (full, two):
        mpc.reset(model.input_offset)
    for _ in range(3):
        x, r = 0.02 * rng.standard_normal(6), 0.03 * rng.standard_normal((10, 3))
        r[:, 1] = np.nan
        np.testing.assert_allclose(full.step(x, r).u, two.step(x, r[:, [0, 2]]).u, atol=1e-7)
    x, r = 0.02 * rng.standard_normal(6), 0.03 * rng.standard_normal((10, 3))  # specified again
    fresh = MPC(model, 10, -0.01, 0.01, 0.003, qp=EXACT, estimator_gain=0.0)
    again = MPC(model, 10, -0.01, 0.01, 0.003, qp=EXACT, estimator_gain=0.0)
    for mpc in (fresh, again):
        mpc.reset(model.input_offset)
    again.step(x, np.full((10, 3), np.nan))  # nothing to track: the input stays
    np.testing.assert_allclose(again.step(x, r).u, fresh.step(x, r).u, atol=1e-7)


def test_new_values_equal_a_new_problem() -> None:
    rng = np.random.default_rng(0)
    n, k = 5, 8
    pattern = np.ones((k, n), dtype=bool)
    F = rng.standard_normal((n, n))
    A = np.zeros((k, n))
    A[:, 0] = 1.0
    old = QP(np.eye(n), A, np.ones((n, n), dtype=bool), pattern, EXACT)
    bound = np.ones(k)
    old.solve(np.ones(n), -bound, bound)
    P, A, q = F @ F.T + np.eye(n), rng.standard_normal((k, n)), 5 * rng.standard_normal(n)
    new = QP(P, A, settings=EXACT)
    x_old, x_new = old.solve(q, -bound, bound, P, A).x, new.solve(q, -bound, bound).x
    assert x_old is not None and x_new is not None
    np.testing.assert_allclose(x_old, x_new, atol=1e-6)


def test_an_infeasible_problem_has_no_solution_and_leaves_no_trace() -> None:
    qp = QP(np.eye(2), np.array([[1.0, 1.0], [1.0, 1.0]]))
    lower, upper = np.array([1.0, -5.0]), np.array([5.0, -1.0])  # the sum is both >= 1 and <= -1
    result = qp.solve(np.zeros(2), lower, upper)
    assert "infeasible" in result.status and result.x is None
    again = qp.solve(np.zeros(2), np.array([1.0, -5.0]), np.array([5.0, 5.0]))
    assert again.status == "solved" and again.x is not None
    np.testing.assert_allclose(again.x, [0.5, 0.5], atol=1e-3)
    assert qp.solve(np.zeros(2), np.ones(2), -np.ones(2)).status == "bounds crossed"
    # A lower bound that OSQP takes for infinite is one above the upper: it would go on with the bounds of before.
    assert qp.solve(np.zeros(2), np.full(2, 1e31), np.full(2, np.inf)).x is None
    assert qp.solve(np.array([np.nan, 0.0]), -np.ones(2), np.ones(2)).x is None


def test_without_a_solution_the_last_plan_goes_on_to_its_end() -> None:
    """One iteration cannot solve a reversed demand: what was planned is applied, flagged, and the target after it."""
    model, H = arm_model(1), 6
    mpc = MPC(model, H, -0.01, 0.01, 0.002, rate_weight=1.0, estimator_gain=0.0, qp=QPSettings(max_iterations=1))
    u0 = model.input_offset
    mpc.reset(u0)
    x = np.zeros(6)
    first = mpc.step(x, np.tile([0.2, 0.1, 0.0], (H, 1)))
    assert not first.fallback
    expected, u = first.predicted, first.u
    for k in range(H):
        x = model.step(x, u)
        move = mpc.step(x, np.tile([-20.0, 15.0, 3.0], (H, 1)))
        assert move.fallback and move.status == "maximum iterations reached"
        assert move.action == ("shifted plan" if k < H - 1 else "steady target")
        if k == H - 1:
            break
        np.testing.assert_allclose(move.predicted[:-1], expected[1:], atol=2e-4)
        expected, u = move.predicted, move.u


def test_a_lift_that_overflows_is_a_fallback_and_is_forgotten() -> None:
    base = arm_model(2)
    x, v = ca.SX.sym("x", 6), ca.SX.sym("v", 3, 0)
    fields = {name: getattr(base, name) for name in base.__dataclass_fields__}
    lift = ca.Function("lift", [x, v], [ca.vertcat(x[:5], ca.exp(x[5]) - 1)])
    model = LiftedModel(**(fields | {"lift_function": lift}))
    mpc = MPC(model, 6, -0.01, 0.01, 0.002)
    mpc.reset(model.input_offset)
    r = np.full((6, 3), 0.02)
    mpc.step(np.zeros(6), r)
    broken = mpc.step(np.array([0, 0, 0, 0, 0, 1e4]), r)
    assert broken.fallback and broken.status == "prediction not finite" and np.isfinite(broken.u).all()
    assert np.isfinite(mpc.disturbance).all()
    assert not mpc.step(np.zeros(6), r).fallback


@settings(max_examples=25, deadline=None)
@given(
    seed=st.integers(0, 10**6),
    size=st.floats(1e-3, 1e3),
    rate=st.floats(1e-4, 2e-2),
    on_plane=st.booleans(),
    weight=st.sampled_from([0.0, 10.0, 1e4]),
)
def test_applied_inputs_never_leave_the_limits(
    seed: int, size: float, rate: float, on_plane: bool, weight: float
) -> None:
    rng = np.random.default_rng(seed)
    model = arm_model(seed % 5)
    low, high = np.array([-0.01, -0.008, -0.002]), np.array([0.01, 0.004, 0.01])
    mpc = MPC(model, 5, low, high, rate, rate_weight=weight, qp=QPSettings(max_iterations=20, first_max_iterations=50))
    u = model.input_offset if on_plane else rng.uniform(low, high)
    mpc.reset(u)
    distance = []
    for _ in range(12):
        move = mpc.step(size * rng.standard_normal(6), size * rng.standard_normal((5, 3)))
        assert (move.u >= low).all() and (move.u <= high).all()
        assert (np.abs(move.u - u) <= rate * (1 + 1e-12)).all()
        u = move.u
        distance.append(abs(np.mean(u - model.input_offset)))
    if on_plane:
        assert max(distance) <= 1e-9
    else:
        assert (np.diff(distance) <= 1e-11).all()


def test_a_reset_controller_repeats_its_run() -> None:
    mpc = MPC(arm_model(4), 10, -0.01, 0.01, 0.003, y_max=0.02)

    def run() -> np.ndarray:
        rng = np.random.default_rng(1)
        mpc.reset([0.001, 0.001, 0.001])
        return np.array([mpc.step(0.05 * rng.standard_normal(6), rng.standard_normal((10, 3))).u for _ in range(15)])

    np.testing.assert_array_equal(run(), run())


def test_growth_over_the_horizon_is_warned_of() -> None:
    with pytest.warns(UserWarning, match="spectral radius"):
        MPC(arm_model(0, radius=1.5), 20, -0.01, 0.01, 0.002)
    with pytest.warns(UserWarning, match="spectral radius"):
        MPC(arm_model(0, n=80, radius=1.5), 20, -0.01, 0.01, 0.002)


def test_weights_have_no_unit() -> None:
    """The same arm in millimetres and in other input units moves alike."""
    mm = np.array([1e3, 1e3, 1e3, 1.0, 1.0, 1.0])
    metres, rng = arm_model(4), np.random.default_rng(4)
    metres = replace(metres, state_range=np.array([0.3, 0.3, 0.3, 1.0, 1.0, 1.0]))
    other = replace(
        metres,
        A=mm[:, None] * metres.A / mm,
        B=mm[:, None] * metres.B / 50.0,
        c=mm * metres.c,
        input_offset=50.0 * metres.input_offset,
        state_range=mm * metres.state_range,
    )
    one = MPC(metres, 10, -0.01, 0.01, 0.003, y_max=0.05, qp=EXACT)
    two = MPC(other, 10, -0.5, 0.5, 0.15, y_max=50.0, qp=EXACT)
    for mpc, scale in ((one, 1.0), (two, 50.0)):
        mpc.reset(scale * metres.input_offset)
    for _ in range(4):
        x, r = 0.05 * rng.standard_normal(6), 0.05 * rng.standard_normal((10, 3))
        np.testing.assert_allclose(50.0 * one.step(x, r).u, two.step(mm * x, 1e3 * r).u, atol=1e-5)


def test_a_larger_output_scale_counts_for_less() -> None:
    """Two outputs that one input moves against each other: the finer one decides."""
    model = replace(arm_model(0), A=np.zeros((6, 6)), B=np.vstack([[1.0, 0, 0], [-1.0, 0, 0], np.zeros((4, 3))]))
    model = replace(model, c=np.zeros(6), input_offset=np.zeros(3), input_basis=np.eye(3))
    r, found = np.full((4, 2), 1.0), []
    for scale in ([0.1, 10.0], [10.0, 0.1]):
        mpc = MPC(model, 4, -2.0, 2.0, 4.0, track=[0, 1], output_scale=scale, rate_weight=0.0, qp=EXACT)
        found.append(mpc.step(np.zeros(6), r).u[0])
    np.testing.assert_allclose(found, [1.0, -1.0], atol=1e-3)


def test_the_shifted_plan_and_its_multipliers_solve_the_next_problem() -> None:
    """Far from the end of the horizon nothing new comes: the solver has nothing left to do, limits active or not."""
    model = replace(arm_model(8, radius=0.3), input_basis=np.eye(3))
    mpc = MPC(model, 12, -0.01, 0.01, 0.001, rate_weight=1e-3, y_max=0.01, qp=QPSettings(eps=1e-7, max_iterations=5000))
    mpc.reset(model.input_offset)
    target = np.tile(model.read(model.fixed_point([0.008, -0.006, 0.005]))[:3], (12, 1))
    x, iterations, at_limit = np.zeros(6), [], 0
    before = model.input_offset
    for _ in range(10):
        move = mpc.step(x, target)
        x = model.step(x, move.u)
        iterations.append(move.iterations)
        at_limit += int(np.isclose(np.abs(move.u - before).max(), 0.001, atol=1e-8))
        before = move.u
    assert at_limit >= 3
    assert max(iterations[1:]) <= iterations[0] / 8 and iterations[-1] == 10  # the first check of the solver


def test_the_time_of_a_step_is_its_own() -> None:
    """Not the time that the thread has taken before."""
    model = arm_model(1)
    mpc = MPC(model, 8, -0.01, 0.01, 0.003)
    mpc.reset(model.input_offset)
    start = time.thread_time()
    while time.thread_time() - start < 0.3:
        pass
    assert 0.0 < mpc.step(np.zeros(6), np.zeros((8, 3))).cpu_time < 0.2


def test_the_weights_of_a_bilinear_model_are_those_at_the_middle_of_its_limits() -> None:
    """A model whose response does not depend on the state has the same problem written with products or without."""
    model = arm_model(2, basis=np.eye(3))
    limits = np.array([-0.02, 0.0, 0.01]), np.array([0.0, 0.03, 0.02]), 0.003
    moves = []
    for products in (None, np.zeros((3, 6, 6))):
        mpc = MPC(replace(model, N=products), 8, *limits, rate_weight=1e-2, qp=EXACT)
        mpc.reset(np.array([-0.01, 0.01, 0.015]))
        moves.append(mpc.step(0.02 * np.ones(6), 0.05 * np.ones((8, 3))).u)
    np.testing.assert_allclose(moves[0], moves[1], atol=1e-6)
