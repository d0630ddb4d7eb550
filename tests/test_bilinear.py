"""Bilinear systems are found exactly, rolled out exactly, and stay what they are in files and controllers."""

from __future__ import annotations

import pickle
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pisplit import BilinearEDMDc, Dictionary, Episodes, LiftedModel, LinearEDMDc, PhaseSamples, PIEDMDc
from pisplit import observables as ob
from pisplit.controllers import MPC, QPSettings
from pisplit.controllers.mpc.relinearise import AlongPlan
from pisplit.dictionary.products import BilinearTerm

RNG = np.random.default_rng(8)
N_STATES, N_INPUTS = 3, 2
A = np.array([[0.9, 0.1, 0.0], [-0.1, 0.8, 0.1], [0.0, -0.2, 0.85]])
B = np.array([[0.1, 0.0], [0.0, 0.2], [0.1, -0.1]])
N = 0.1 * RNG.normal(size=(N_INPUTS, N_STATES, N_STATES))
SHIFT = np.array([0.02, 0.0, -0.01])


def trajectory(steps: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """x+ = A x + B u + u_1 N_1 x + u_2 N_2 x + shift."""
    rng = np.random.default_rng(seed)
    u, x = rng.uniform(-1, 1, (steps, N_INPUTS)), np.zeros((steps + 1, N_STATES))
    x[0] = rng.normal(size=N_STATES)
    for k in range(steps):
        x[k + 1] = (A + np.tensordot(u[k], N, axes=1)) @ x[k] + B @ u[k] + SHIFT
    return x, u


def data(episodes: int = 4, steps: int = 60) -> Episodes:
    runs = [trajectory(steps, seed) for seed in range(episodes)]
    return Episodes([x for x, _ in runs], [u for _, u in runs], dt=0.1, outputs={"tip": (0, 1)})


def dictionary(*more: Any) -> Dictionary:
    return Dictionary(ob.Constant(), ob.Identity(), *more, n_states=N_STATES, n_inputs=N_INPUTS)


@pytest.fixture(scope="module")
def model() -> LiftedModel:
    return BilinearEDMDc(dictionary()).fit(data()).lifted


def test_the_operators_of_a_bilinear_system_are_found(model: LiftedModel) -> None:
    names = list(model.column_names)
    states = [names.index(name) for name in model.state_names]
    assert model.N is not None
    np.testing.assert_allclose(model.A[np.ix_(states, states)], A, atol=1e-9)
    np.testing.assert_allclose(model.B[states], B, atol=1e-9)
    np.testing.assert_allclose(model.A[states, names.index("1")], SHIFT, atol=1e-9)
    for found, true in zip(model.N, N, strict=True):
        np.testing.assert_allclose(found[np.ix_(states, states)], true, atol=1e-9)
        assert not found[names.index("1")].any() and not found[:, names.index("1")].any()


def test_a_bilinear_system_rolls_out_exactly_one_by_one_and_side_by_side(model: LiftedModel) -> None:
    runs = [trajectory(400, seed) for seed in range(10, 15)]
    z0 = np.stack([model.lift(x[0]) for x, _ in runs])
    together = model.rollout(z0, np.stack([u for _, u in runs]))
    for i, (x, u) in enumerate(runs):
        np.testing.assert_allclose(together.x[i], x, atol=1e-10)
        np.testing.assert_allclose(model.predict(x[0], None, u).x, x, atol=1e-10)


def test_a_roll_out_is_its_steps_and_its_transitions() -> None:
    theta = dictionary(ob.Delays(states=2, inputs=1), ob.Slack(width=0.1))
    fitted = BilinearEDMDc(theta, alpha=1e-6).fit(data())
    model, start = fitted.lifted, data().start(0, 2)
    z = model.lift(start.x_history, start.u_history)
    result = model.predict(start.x_history, start.u_history, start.inputs)
    for k, u in enumerate(start.inputs[:20]):
        by_matrix = model.transition(u) @ z + model.B @ model.features(u[None])[0] + model.c
        z = model.step(z, u)
        np.testing.assert_allclose(z, by_matrix, atol=1e-12)
        np.testing.assert_allclose(result.z[k + 1], z, atol=1e-12)


def test_delays_multiply_too_and_a_bilinear_delay_system_is_exact() -> None:
    # x_{k+1} = 0.6 x_k + 0.3 u_k x_{k-1} - 0.2 u_k u_{k-1} + u_k
    rng = np.random.default_rng(1)
    u, x = rng.uniform(-1, 1, (300, 1)), np.zeros((301, 1))
    x[:2] = rng.normal(size=(2, 1))
    for k in range(1, 300):
        x[k + 1] = 0.6 * x[k] + 0.3 * u[k] * x[k - 1] - 0.2 * u[k] * u[k - 1] + u[k]
    theta = Dictionary(ob.Identity(), ob.Delays(states=1, inputs=1), n_states=1, n_inputs=1)
    model = BilinearEDMDc(theta).fit(Episodes([x[:100]], [u[:99]], dt=1.0))
    np.testing.assert_allclose(model.predict((x[:2], u[:1]), u[1:]), x[1:], atol=1e-10)
    assert model.theta_.column_names[-3:] == ("u1*x1", "u1*x1[k-1]", "u1*u1[k-1]")


def test_without_inputs_as_columns_the_constant_is_multiplied_as_in_the_paper() -> None:
    theta = Dictionary(ob.Constant(), ob.States(), n_states=N_STATES, n_inputs=N_INPUTS)
    fitted = BilinearEDMDc(theta).fit(data())
    assert fitted.theta_.column_names[4:8] == ("u1*1", "u1*x1", "u1*x2", "u1*x3")
    x, u = trajectory(100, 20)
    np.testing.assert_allclose(fitted.predict(x[0], u), x, atol=1e-10)


def test_a_linear_system_has_no_products() -> None:
    x, u = np.zeros((41, 1)), RNG.normal(size=(40, 1))
    x[1:] = np.cumsum(u, axis=0)
    theta = Dictionary(ob.Identity(), n_states=1, n_inputs=1)
    found = BilinearEDMDc(theta).fit(Episodes([x], [u], dt=1.0)).lifted
    np.testing.assert_allclose(found.N, 0.0, atol=1e-12)
    linear = LinearEDMDc(theta).fit(Episodes([x], [u], dt=1.0)).lifted
    assert linear.N is None and linear.linear_in_u and not found.linear_in_u


@pytest.mark.parametrize("penalty", ["ridge", "lasso"])
def test_alpha_is_chosen_on_roll_outs_as_for_the_linear_estimator(penalty: str) -> None:
    fitted = BilinearEDMDc(dictionary(), alpha="cv", penalty=penalty, alphas=(1e-7, 1e-2, 1.0)).fit(data())
    assert fitted.cv_ is not None and fitted.alpha_ == 1e-7
    linear = LinearEDMDc(dictionary(), alpha="cv", penalty=penalty, alphas=(1e-7, 1e-2, 1.0)).fit(data())
    assert fitted.score(data()).median < 1e-6 * linear.score(data()).median


def test_chosen_products_leave_the_others_zero() -> None:
    fitted = BilinearEDMDc(dictionary(ob.Bilinear(("x2",)))).fit(data())
    assert fitted.theta_.n_columns == 1 + N_STATES + 2 * N_INPUTS and fitted.lifted.N is not None
    np.testing.assert_array_equal(np.flatnonzero(fitted.lifted.N.any(axis=(0, 1))), [2])


def test_a_bilinear_model_survives_files_and_pickles(model: LiftedModel, tmp_path: Path) -> None:
    model.save(tmp_path / "model.h5")
    x, u = trajectory(20, 30)
    for copy in (LiftedModel.load(tmp_path / "model.h5"), pickle.loads(pickle.dumps(model))):
        np.testing.assert_array_equal(copy.predict(x[0], None, u).x, model.predict(x[0], None, u).x)
    replace(model, N=None).save(tmp_path / "linear.h5")
    assert LiftedModel.load(tmp_path / "linear.h5").N is None


def test_divergence_of_a_bilinear_model_is_a_flag(model: LiftedModel) -> None:
    assert model.N is not None
    wild = replace(model, N=1e200 * np.ones_like(model.N))
    result = wild.rollout(np.ones((2, model.n_lifted)), np.ones((2, 50, 2)))
    assert np.all(result.diverged) and np.isfinite(result.x).all()


def test_a_fixed_point_is_mapped_to_itself_and_is_that_of_the_system(model: LiftedModel) -> None:
    u = np.array([0.3, -0.5])
    z = model.fixed_point(u)
    np.testing.assert_allclose(model.step(z, u), z, atol=1e-12)
    exact = np.linalg.solve(np.eye(N_STATES) - A - np.tensordot(u, N, axes=1), B @ u + SHIFT)
    np.testing.assert_allclose(model.read(z), exact, atol=1e-8)


def test_the_fixed_point_does_not_depend_on_units() -> None:
    d1 = data()
    scale = np.array([1e-9, 1.0, 1e9])
    units = Episodes([x * scale for x in d1.xs], d1.us, dt=0.1)
    points = []
    for episodes in (d1, units):
        lifted = BilinearEDMDc(dictionary(ob.Delays(1, 1))).fit(episodes).lifted
        points.append(lifted.read(lifted.fixed_point([0.1, 0.2])))
    np.testing.assert_allclose(points[1] / scale, points[0], rtol=1e-5)


def test_an_integrator_has_no_fixed_point() -> None:
    x, u = np.zeros((41, 1)), RNG.normal(size=(40, 1))
    x[1:] = np.cumsum(u, axis=0)
    lifted = LinearEDMDc(Dictionary(ob.Identity(), n_states=1, n_inputs=1)).fit(Episodes([x], [u], dt=1.0)).lifted
    exact = replace(lifted, A=np.eye(1))
    with pytest.raises(ValueError, match="integrator"):
        exact.fixed_point([1.0])


def test_zero_rows_and_columns_of_the_term_cost_nothing_and_change_nothing() -> None:
    full = np.zeros((2, 6, 6))
    full[:, 1:3, 4:] = RNG.normal(size=(2, 2, 2))
    term = BilinearTerm(full)
    z, u = RNG.normal(size=(7, 6)), RNG.normal(size=(7, 2))
    expected = np.einsum("em,mij,ej->ei", u, full, z)
    np.testing.assert_allclose(term(z, u), expected[:, [1, 2]], atol=1e-14)
    assert list(term.rows) == [1, 2] and list(term.columns) == [4, 5]
    np.testing.assert_allclose(term.slopes(z[0]) @ u[0], expected[0, [1, 2]], atol=1e-14)
    np.testing.assert_allclose(term.matrix(u[0]) @ z[0, 4:], expected[0, [1, 2]], atol=1e-14)


def test_the_condensed_prediction_is_the_roll_out_and_its_derivative() -> None:
    theta = dictionary(ob.Delays(states=1, inputs=1), ob.Slack(width=0.3))
    model = BilinearEDMDc(theta, alpha=1e-6).fit(data()).lifted
    T, w = RNG.normal(size=(2, 2)), 1e-3 * RNG.normal(size=model.n_lifted)
    along = AlongPlan(model, model.C[:2], model.d[:2], T)
    start, v = data().start(0, 1), RNG.uniform(-0.5, 0.5, (6, 2))
    z = model.lift(start.x_history, start.u_history)
    S, y = along(z, w, v @ T.T)
    moved = replace(model, c=model.c + w)
    np.testing.assert_allclose(y.reshape(6, 2), moved.rollout(z, v @ T.T).x[1:, :2], atol=1e-12)
    for i in range(v.size):
        step = 1e-6 * np.eye(v.size)[i].reshape(v.shape)
        difference = along(z, w, (v + step) @ T.T)[1] - along(z, w, (v - step) @ T.T)[1]
        np.testing.assert_allclose(S[:, i], difference / 2e-6, atol=1e-7)


def controller(model: LiftedModel) -> MPC:
    return MPC(model, 8, -1.0, 1.0, 0.5, track="tip", rate_weight=1e-3, qp=QPSettings(eps=1e-8, max_iterations=20000))


def test_a_controller_of_a_bilinear_model_without_products_is_the_linear_one() -> None:
    linear = LinearEDMDc(dictionary(), alpha=1e-3).fit(data()).lifted
    bilinear = replace(linear, N=np.zeros((2, linear.n_lifted, linear.n_lifted)))
    controllers, window = [controller(linear), controller(bilinear)], np.full((8, 2), 0.2)
    for seed in range(5):
        x = 0.1 * np.random.default_rng(seed).normal(size=3)
        one, other = (mpc.step(x, window).u for mpc in controllers)
        np.testing.assert_allclose(one, other, atol=1e-4)


def test_mpc_drives_a_bilinear_system_to_a_reachable_set_point(model: LiftedModel) -> None:
    target = model.read(model.fixed_point([0.4, -0.3]))[:2]
    x, mpc = np.zeros(3), controller(model)
    for _ in range(60):
        u = mpc.step(x, np.tile(target, (8, 1))).u
        x = (A + np.tensordot(u, N, axes=1)) @ x + B @ u + SHIFT
    np.testing.assert_allclose(x[:2], target, atol=1e-5)
    np.testing.assert_allclose(mpc.disturbance, 0.0, atol=1e-9)


@pytest.mark.parametrize(
    ("use", "message"),
    [
        (lambda m: LinearEDMDc(dictionary(ob.Bilinear())).fit(data()), "belong to BilinearEDMDc"),
        (
            lambda m: PIEDMDc(dictionary(ob.Bilinear()), split="hold").fit(
                data(), PhaseSamples(np.zeros((2, 3)), np.zeros((2, 2)), np.zeros((2, 3)))
            ),
            "belong to BilinearEDMDc",
        ),
        (lambda m: dictionary(ob.Bilinear(("x9",))), "Bilinear names"),
        (lambda m: dictionary(ob.Bilinear(), ob.Bilinear()), "2 Bilinear"),
        (lambda m: replace(m, N=np.zeros((1, 2, 2))), "N has shape"),
        (lambda m: m.transition([1.0]), "u has shape"),
        (lambda m: BilinearEDMDc(dictionary(), penalty="elastic"), "penalty"),
    ],
)
def test_misuse_is_refused_in_one_line(model: LiftedModel, use: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message) as error:
        use(model)
    assert "\n" not in str(error.value)
