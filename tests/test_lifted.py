"""The lifted model: roll-outs, divergence, features, files."""

from __future__ import annotations

import pickle
from dataclasses import replace
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest

from pisplit import Dictionary, Episodes, LiftedModel, LinearEDMDc
from pisplit import observables as ob

RNG = np.random.default_rng(4)


def data(episodes: int = 3, steps: int = 40) -> Episodes:
    us = [RNG.normal(size=(steps, 2)) for _ in range(episodes)]
    xs = []
    for u in us:
        x = np.zeros((steps + 1, 2))
        x[0] = RNG.normal(size=2)
        for k in range(steps):
            x[k + 1] = 0.8 * x[k] + np.array([0.1, -0.1]) * x[k, ::-1] + np.array([max(u[k, 0], 0), u[k, 1]])
        xs.append(x)
    return Episodes(xs, us, dt=0.1, outputs={"tip": (1,)}, provenance={"seed": 4})


def fitted(*more: Any) -> LiftedModel:
    theta = Dictionary(ob.Constant(), ob.Identity(), ob.Delays(1, 1), *more, n_states=2, n_inputs=2)
    return LinearEDMDc(theta, alpha=1e-6).fit(data()).lifted


def table() -> ca.Function:
    grid = np.linspace(-6, 6, 30)
    return ca.interpolant("table", "bspline", [grid], np.tanh(grid))


def with_table() -> LiftedModel:
    u = ca.MX.sym("u", 2)
    return fitted(ob.Equilibrium(ca.Function("map", [u], [table()(u[0])])), ob.Slack(width=0.1))


def test_a_roll_out_is_its_steps() -> None:
    model, episode = with_table(), data(1)
    start = episode.start(0, 1)
    result = model.predict(start.x_history, start.u_history, start.inputs)
    z = model.lift(start.x_history, start.u_history)
    for k, u in enumerate(start.inputs):
        np.testing.assert_allclose(result.x[k], model.read(z), atol=1e-12)
        z = model.step(z, u)
    assert result.diverged is False and result.diverged_at is None
    np.testing.assert_allclose(result.z[-1], z, atol=1e-12)


def test_episodes_side_by_side_equal_episodes_one_by_one() -> None:
    model = with_table()
    z0, inputs = RNG.normal(size=(5, model.n_lifted)), RNG.normal(size=(5, 30, 2))
    together = model.rollout(z0, inputs)
    for i in range(5):
        np.testing.assert_allclose(together.x[i], model.rollout(z0[i], inputs[i]).x, atol=1e-10)
    assert together.x.shape == (5, 31, 2) and together.z.shape == (5, 31, model.n_lifted)


def test_delay_rows_shift_exactly() -> None:
    model = fitted()
    columns = {name: i for i, name in enumerate(model.column_names)}
    z, u = RNG.normal(size=model.n_lifted), RNG.normal(size=2)
    following = model.step(z, u)
    for i in (1, 2):
        assert following[columns[f"x{i}[k-1]"]] == z[columns[f"x{i}"]]
        assert following[columns[f"u{i}[k-1]"]] == u[i - 1]
    assert following[columns["1"]] == z[columns["1"]]


def test_divergence_is_a_flag_and_never_a_nan() -> None:
    model = fitted()
    for gain in (1.5, 1e300):
        wild = replace(model, A=gain * np.eye(model.n_lifted))
        z0 = np.stack([np.zeros(model.n_lifted), np.ones(model.n_lifted)])
        result = wild.rollout(z0, np.zeros((2, 3000, 2)))
        assert list(result.diverged) == [False, True]  # type: ignore[arg-type]
        assert np.isfinite(result.x).all() and np.abs(result.x).max() <= 1e3 * model.state_range.max()
        at = int(np.asarray(result.diverged_at)[1])
        np.testing.assert_array_equal(result.x[1, at:], np.broadcast_to(result.x[1, at - 1], (3001 - at, 2)))
        single = wild.rollout(z0[1], np.zeros((3000, 2)))
        assert single.diverged is True and single.diverged_at == at
    assert np.asarray(result.diverged_at)[0] == -1


def test_the_feature_jacobian_is_the_derivative_of_the_features() -> None:
    model = with_table()
    u, h = RNG.normal(size=(20, 2)), 1e-6
    jacobian = model.feature_jacobian(u)
    assert jacobian.shape == (20, model.n_features, 2)
    for j in range(2):
        step = h * np.eye(2)[j]
        np.testing.assert_allclose(
            jacobian[:, :, j], (model.features(u + step) - model.features(u - step)) / (2 * h), atol=1e-6
        )


def test_only_the_identity_counts_as_linear_in_u() -> None:
    assert fitted().linear_in_u
    assert not with_table().linear_in_u
    theta = Dictionary(ob.States(), ob.Expression(lambda x, u: u**3, name="cubes"), n_states=2, n_inputs=2)
    assert not LinearEDMDc(theta).fit(data()).lifted.linear_in_u


@pytest.mark.parametrize("make", [fitted, with_table])
def test_a_saved_model_predicts_the_same(tmp_path: Path, make: Any) -> None:
    model, start = make(), data(1).start(0, 1)
    model.save(tmp_path / "model.h5")
    for copy in (LiftedModel.load(tmp_path / "model.h5"), pickle.loads(pickle.dumps(model))):
        np.testing.assert_array_equal(
            copy.predict(start.x_history, start.u_history, start.inputs).x,
            model.predict(start.x_history, start.u_history, start.inputs).x,
        )
        for name in ("dt", "n_delays", "state_names", "input_names", "column_names", "feature_names", "outputs"):
            assert getattr(copy, name) == getattr(model, name)
        assert copy.provenance == model.provenance
        np.testing.assert_array_equal(copy.input_basis, model.input_basis)


def test_outputs_names_and_origin_come_from_the_training_data() -> None:
    model = fitted()
    assert model.outputs == {"tip": (1,)}
    assert model.provenance["estimator"] == "LinearEDMDc" and model.provenance["data"] == {"seed": 4}
    assert model.feature_names == ("u1", "u2") and model.n_delays == 1


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"A": np.eye(2)}, "A has shape"),
        ({"B": np.zeros((7, 3))}, "B has shape"),
        ({"C": np.full((2, 7), np.nan)}, "NaN"),
        ({"dt": -1.0}, "dt"),
        ({"n_delays": 0}, "lift_function"),
        ({"input_function": None}, "casadi.Function"),
        ({"outputs": {"tip": (9,)}}, "outputs"),
        ({"provenance": {"f": np.sin}}, "JSON"),
        ({"input_basis": np.zeros(2)}, "input_basis"),
    ],
)
def test_inconsistent_models_are_refused_in_one_line(change: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message) as error:
        replace(fitted(), **change)
    assert "\n" not in str(error.value)


def test_wrong_histories_and_inputs_are_refused() -> None:
    model = fitted()
    with pytest.raises(ValueError, match="x_history"):
        model.lift(np.zeros((1, 2)), np.zeros((1, 2)))
    with pytest.raises(ValueError, match="u_history"):
        model.lift(np.zeros((2, 2)), np.zeros((2, 2)))
    with pytest.raises(ValueError, match="U"):
        model.rollout(np.zeros(model.n_lifted), np.zeros((4, 3)))
    with pytest.raises(ValueError, match="z0"):
        model.rollout(np.zeros(3), np.zeros((4, 2)))


def test_arrays_of_a_model_are_its_own() -> None:
    model = fitted()
    matrix = model.A.copy()
    other = replace(model, A=matrix)
    matrix[0, 0] = 99.0
    assert np.array_equal(other.A, model.A)
    for again in (model, pickle.loads(pickle.dumps(model))):
        with pytest.raises(ValueError, match="read-only"):
            again.A[0, 0] = 99.0


def test_states_that_are_columns_are_taken_and_others_are_read_by_a_product() -> None:
    rng = np.random.default_rng(4)
    data = Episodes([rng.normal(size=(41, 2))], [rng.normal(size=(40, 1))], 0.1)
    for terms in ((ob.Constant(), ob.Identity(), ob.Polynomials(2)), (ob.Constant(), ob.Polynomials(3))):
        model = LinearEDMDc(Dictionary(*terms, n_states=2, n_inputs=1), alpha=1e-3).fit(data).lifted
        z = rng.normal(size=(3, 4, model.n_lifted))
        read = model.read(z)
        np.testing.assert_allclose(read, z @ model.C.T + model.d, rtol=1e-13, atol=1e-13)
        read[:] = 0.0
        assert z.all()  # what is read is not a view
        with pytest.raises(ValueError, match=r"z has shape \(3,\)"):
            model.read(np.zeros(3 if model.n_lifted != 3 else 4))
