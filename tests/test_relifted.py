"""Re-lifted models: a state is predicted, and its products are evaluated anew at every step."""

from __future__ import annotations

import pickle
from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from pisplit import Episodes, LiftedModel, ReliftedEDMDc, learning_curve, modes, stabilised, to_numpy
from pisplit.controllers import MPC, KalmanFilter
from pisplit.controllers.mpc.relinearise import AlongPlan
from pisplit.estimators.relifted_coordinates import product_table
from pisplit.lifted.relifting import ReliftedTerm

ARGUMENTS = {"components": (2,), "leading": (2,), "degrees": (2,), "alphas": (1e-16,)}


def following(x: np.ndarray, before: np.ndarray, u: np.ndarray) -> np.ndarray:
    """A quadratic system of the mean input and its change: no finite lift of it is closed."""
    mean, change = 0.5 * (u[0] + before[0]), u[0] - before[0]
    return np.array(
        [
            0.85 * x[0] + 0.2 * x[1] + 0.1 * x[1] ** 2 + 0.15 * mean + 0.1 * x[0] * mean,
            0.8 * x[1] - 0.1 * x[0] - 0.15 * x[0] * x[1] + 0.1 * mean + 0.2 * x[1] * change + 0.02,
        ]
    )


def recorded(episodes: int = 6, steps: int = 60, seed: int = 0) -> Episodes:
    rng = np.random.default_rng(seed)
    xs, us = [], []
    for _ in range(episodes):
        u, x = rng.uniform(-1.0, 1.0, (steps, 1)), [rng.uniform(-0.5, 0.5, 2)]
        for k in range(steps):
            x.append(following(x[-1], u[max(k - 1, 0)], u[k]))
        xs.append(np.array(x))
        us.append(u)
    return Episodes(xs, us, dt=0.1)


@pytest.fixture(scope="module")
def fitted() -> ReliftedEDMDc:
    return ReliftedEDMDc(**ARGUMENTS).fit(recorded())


def test_a_system_within_the_dictionary_is_found_exactly(fitted: ReliftedEDMDc) -> None:
    test = recorded(seed=1)
    assert fitted.score(test).quantile(1.0) < 1e-18
    propagated = replace(fitted.lifted, relifted=None)  # without its products it is another system
    from pisplit import rollout_errors

    assert rollout_errors(propagated, test).median > 1e-4


def test_jacobians_are_the_derivatives_of_a_step(fitted: ReliftedEDMDc) -> None:
    model, h = fitted.lifted, 1e-6
    z, u = np.array([0.4, -0.7, 0.3]), np.array([0.6])
    by_state, by_input = model.jacobian(z, u)
    for i, unit in enumerate(np.eye(3)):
        slope = (model.step(z + h * unit, u) - model.step(z - h * unit, u)) / (2 * h)
        np.testing.assert_allclose(by_state[:, i], slope, atol=1e-9)
    slope = (model.step(z, u + h) - model.step(z, u - h)) / (2 * h)
    np.testing.assert_allclose(by_input[:, 0], slope, atol=1e-9)


def test_cubic_products_have_exact_derivatives() -> None:
    rng = np.random.default_rng(2)
    factors = product_table(3, 2, 2, 3)
    term = ReliftedTerm(rng.normal(size=(5, 6)), rng.normal(size=5), factors, rng.normal(size=(4, len(factors))))
    z, u, h = rng.normal(size=4), rng.normal(size=2), 1e-6
    by_state, by_input = term.jacobian(z, u)
    for i, unit in enumerate(np.eye(4)):
        np.testing.assert_allclose(by_state[:, i], (term(z + h * unit, u) - term(z - h * unit, u)) / (2 * h), atol=1e-7)
    for i, unit in enumerate(np.eye(2)):
        np.testing.assert_allclose(by_input[:, i], (term(z, u + h * unit) - term(z, u - h * unit)) / (2 * h), atol=1e-7)


@pytest.mark.parametrize(("components", "inputs", "leading", "degree"), [(4, 2, 3, 2), (5, 4, 2, 3), (3, 2, 0, 2)])
def test_every_product_is_there_once(components: int, inputs: int, leading: int, degree: int) -> None:
    from math import comb

    table = product_table(components, inputs, leading, degree)
    first = leading + inputs
    expected = sum(comb(first + d - 1, d) for d in range(2, degree + 1)) + (components - leading) * inputs
    assert len(table) == len({tuple(sorted(row)) for row in table.tolist()}) == expected


def bilinear(seed: int = 0) -> tuple[LiftedModel, LiftedModel]:
    """One system twice: with matrices N_i, and with their products as a re-lifted term."""
    rng = np.random.default_rng(seed)
    M, m = 4, 2
    x, v, u = ca.SX.sym("x", M), ca.SX.sym("v", m, 0), ca.SX.sym("u", m)
    names = tuple(f"x{i}" for i in range(M))
    N = 0.2 * rng.normal(size=(m, M, M))
    first = LiftedModel(
        A=0.3 * rng.normal(size=(M, M)),
        B=rng.normal(size=(M, m)),
        c=0.1 * rng.normal(size=M),
        C=np.eye(M),
        d=np.zeros(M),
        dt=0.1,
        lift_function=ca.Function("lift", [x, v], [x]),
        input_function=ca.Function("phi", [u], [u]),
        n_delays=0,
        state_names=names,
        input_names=("u1", "u2"),
        column_names=names,
        feature_names=("u1", "u2"),
        input_offset=np.zeros(m),
        input_basis=np.eye(m),
        state_range=np.ones(M),
        N=N,
    )
    factors = np.array([(j, M + i) for i in range(m) for j in range(M)])
    term = ReliftedTerm(np.eye(M + m), np.zeros(M + m), factors, np.hstack(list(N)))
    return first, replace(first, N=None, relifted=term)


def test_bilinear_products_may_be_written_as_a_relifted_term() -> None:
    first, second = bilinear()
    rng = np.random.default_rng(3)
    z, u = rng.normal(size=(5, 4)), 0.5 * rng.normal(size=(5, 12, 2))
    np.testing.assert_allclose(first.rollout(z, u).z, second.rollout(z, u).z, atol=1e-12)
    for mine, theirs in zip(first.jacobian(z[0], u[0, 0]), second.jacobian(z[0], u[0, 0]), strict=True):
        np.testing.assert_allclose(mine, theirs, atol=1e-12)
    filters = [KalmanFilter(model, 0.01 * np.eye(4), 0.1, [0, 2]) for model in (first, second)]
    np.testing.assert_allclose(filters[0].gain, filters[1].gain, atol=1e-12)
    w, T = 0.01 * rng.normal(size=4), rng.normal(size=(2, 2))
    plans = [AlongPlan(model, np.eye(4)[:2], np.ones(2), T)(z[0], w, u[0]) for model in (first, second)]
    for mine, theirs in zip(*plans, strict=True):
        np.testing.assert_allclose(mine, theirs, atol=1e-12)


def test_a_copy_from_a_file_or_a_pickle_predicts_the_same(fitted: ReliftedEDMDc, tmp_path: Path) -> None:
    model, test = fitted.lifted, recorded(1, seed=4)
    model.save(tmp_path / "model.h5")
    z = model.lift(test.xs[0][:2], test.us[0][:1])
    expected = model.rollout(z, test.us[0][1:]).x
    for copy in (LiftedModel.load(tmp_path / "model.h5"), pickle.loads(pickle.dumps(model))):
        np.testing.assert_array_equal(copy.rollout(z, test.us[0][1:]).x, expected)


def test_mpc_reaches_a_set_point_of_the_true_system(fitted: ReliftedEDMDc) -> None:
    mpc = MPC(fitted.lifted, horizon=10, u_min=-1.0, u_max=1.0, du_max=0.5, track=[0], rate_weight=1e-3)
    x, before = np.zeros(2), np.zeros(1)
    for _ in range(60):
        u = mpc.step(x, np.full((10, 1), 0.4)).u
        x, before = following(x, before, u), u
    assert abs(x[0] - 0.4) < 1e-4


def test_products_that_overflow_end_in_a_status_and_are_forgotten(fitted: ReliftedEDMDc) -> None:
    model = fitted.lifted
    mpc = MPC(model, 12, -1.0, 1.0, 0.5, track=[0], estimator_gain=0.0)
    window = np.full((12, 1), 0.2)
    move = mpc.step(np.array([1e90, 1e90]), window)
    assert move.fallback and move.status == "prediction not finite"
    assert not mpc.step(np.array([0.1, 0.1]), window).fallback
    wild = replace(model, relifted=replace(model.relifted, weights=1e3 * model.relifted.weights))
    with pytest.raises(ValueError, match="too large over the horizon"):
        MPC(wild, 12, -1.0, 1.0, 0.5, track=[0])


def test_units_do_not_matter() -> None:
    d1, test = recorded(), recorded(seed=5)
    units = np.array([1e3, 1e3])
    scaled = [Episodes([x * units for x in d.xs], [1e-2 * u for u in d.us], d.dt) for d in (d1, test)]
    options = {**ARGUMENTS, "alphas": (1e-3, 1e-1)}
    plain = ReliftedEDMDc(**options).fit(d1)
    other = ReliftedEDMDc(**options).fit(scaled[0])
    assert plain.search_.chosen == other.search_.chosen
    assert other.score(scaled[1]).median == pytest.approx(1e6 * plain.score(test).median, rel=1e-6)


def test_the_structure_is_chosen_by_held_out_rollouts_and_the_bound() -> None:
    d1 = recorded()
    some = ReliftedEDMDc((1, 2), (0, 2), (2, 3), (1e-12, 1e-3)).fit(d1)
    chosen = some.search_.chosen
    assert (chosen.components, chosen.leading) == (2, 2) and some.bounded_ is True
    assert ReliftedEDMDc(**ARGUMENTS).fit(d1, excitation=None).bounded_ is None
    assert some.search_.error == some.search_.errors.min()
    usual = np.stack(d1.us)
    assert ReliftedEDMDc(**ARGUMENTS).fit(d1, excitation=usual).bounded_ is True
    with pytest.warns(UserWarning, match="no structure that was tried stays bounded"):
        far = ReliftedEDMDc(**ARGUMENTS).fit(d1, excitation=40.0 * usual)
    assert far.bounded_ is False


def test_it_takes_part_in_learning_curves() -> None:
    curve = learning_curve(
        {"re-lifted": ReliftedEDMDc(**ARGUMENTS)}, recorded(), recorded(seed=6), [40, 200], seeds=[0]
    )
    assert not curve.refusals and (curve.errors["re-lifted"] < 1e-16).all()


def test_what_needs_a_linear_step_says_so(fitted: ReliftedEDMDc) -> None:
    model = fitted.lifted
    calls = (
        lambda: modes(model),
        lambda: stabilised(model),
        lambda: to_numpy(model),
        lambda: model.transition([0.0]),
        lambda: model.fixed_point([0.0]),
    )
    for call in calls:
        with pytest.raises(ValueError, match="re-lifted"):
            call()
    assert not model.linear_in_u and model.varies


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"components": ()}, "components = "),
        ({"components": (0,)}, "components"),
        ({"leading": (-1,)}, "leading"),
        ({"degrees": (4,)}, "degrees"),
        ({"alphas": (-1.0,)}, "alphas"),
    ],
)
def test_options_that_can_be_nothing_are_refused(options: dict[str, object], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        ReliftedEDMDc(**options)  # type: ignore[arg-type]


def test_data_that_do_not_fit_are_refused() -> None:
    with pytest.raises(ValueError, match="expected Episodes"):
        ReliftedEDMDc().fit(None)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="omit"):
        ReliftedEDMDc(omit=("v",)).fit(recorded())
    with pytest.raises(ValueError, match="relifted is of"):
        replace(bilinear()[1], relifted=ReliftedTerm(np.eye(3), np.zeros(3), np.zeros((1, 2)), np.zeros((3, 1))))
