"""PI-EDMDc against EDMDc, against the exact operator, and on the slow manifold."""

from __future__ import annotations

import warnings
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from pisplit import Dictionary, Episodes, LinearEDMDc, PhaseSamples, PIEDMDc
from pisplit import observables as ob
from pisplit.models import systems
from pisplit.splitting import free_block

STEP = 1e-3


def slow_manifold_run(steps: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """From (0.3, 0.7) under inputs 0.1 N(0, 1) that change every three steps."""
    u = np.repeat(0.1 * np.random.default_rng(seed).normal(size=(steps // 3 + 1, 1)), 3, axis=0)[:steps]
    return systems.slow_manifold().simulate([0.3, 0.7], u, STEP), u


def phase_samples(flow: bool = False) -> PhaseSamples:
    x = np.random.default_rng(1).uniform(-1, 1, (200, 2))
    return PhaseSamples.from_system(systems.slow_manifold(), x, np.zeros((200, 1)), dt=STEP, flow=flow)


def closed_dictionary(*more: ob.Delays) -> Dictionary:
    square = ob.Expression(lambda x, u: x[0] ** 2, name="x1^2")
    return Dictionary(ob.Constant(), ob.Identity(), square, *more, n_states=2, n_inputs=1)


def x2_error(model: Any, seed: int = 100) -> float:
    x, u = slow_manifold_run(10_000, seed)
    return float(np.mean((model.predict(x[0], u) - x)[:, 1] ** 2))


@pytest.mark.parametrize("split", ["strang", "lie"])
@pytest.mark.parametrize("half_step", ["generator", "flow"])
@pytest.mark.parametrize("delays", [ob.Delays(), ob.Delays(states=1, inputs=1)])
@pytest.mark.parametrize("toward", ["zero", "identity"])
def test_without_a_regulariser_the_half_steps_cancel(
    split: str, half_step: str, delays: ob.Delays, toward: str
) -> None:
    rng = np.random.default_rng(5)
    system = systems.duffing()
    us = [rng.normal(size=(60, 1)) for _ in range(5)]
    xs = [system.simulate(rng.normal(size=2), u, 0.1, substeps=4) for u in us]
    d1 = Episodes(xs, us, dt=0.1, state_names=("x", "v"))
    x2 = rng.normal(size=(300, 2))
    d2 = PhaseSamples.from_system(system, x2, np.zeros((300, 1)), dt=0.1, flow=True)
    theta = Dictionary(ob.Constant(), ob.Identity(), ob.Polynomials(2), delays, n_states=2, n_inputs=1)
    plain = LinearEDMDc(theta).fit(d1)
    split_up = PIEDMDc(theta, alpha=0.0, split=split, half_step=half_step, toward=toward).fit(d1, d2)
    assert plain.fit_.rank == len(plain.K_) * (theta.n_columns - 1)
    np.testing.assert_allclose(split_up.K_, plain.K_, atol=1e-10)


def test_on_the_slow_manifold_the_half_steps_cancel_too() -> None:
    x, u = slow_manifold_run(256, 0)
    d1 = Episodes([x], [u], dt=STEP)
    plain = LinearEDMDc(closed_dictionary()).fit(d1)
    for penalty in ("ridge", "lasso"):
        split_up = PIEDMDc(closed_dictionary(), alpha=0.0, penalty=penalty).fit(d1, phase_samples())
        np.testing.assert_allclose(split_up.K_, plain.K_, atol=1e-10)


@pytest.mark.parametrize("n", [16, 256])
@pytest.mark.parametrize("half_step", ["generator", "flow"])
def test_a_known_f_leaves_only_the_input_to_learn(n: int, half_step: str) -> None:
    x, u = slow_manifold_run(n, 0)
    model = PIEDMDc(closed_dictionary(), alpha=0.0, half_step=half_step, rows="inputs")
    model.fit(Episodes([x], [u], dt=STEP), phase_samples(flow=True))
    assert x2_error(model) <= 1e-7


def test_lasso_toward_the_identity_keeps_the_known_physics_where_toward_zero_loses_it() -> None:
    x, u = slow_manifold_run(256, 0)
    d1, d2 = Episodes([x], [u], dt=STEP), phase_samples()
    errors = {t: x2_error(PIEDMDc(closed_dictionary(), alpha=1e-3, toward=t).fit(d1, d2)) for t in ("zero", "identity")}
    assert errors["identity"] <= 1e-7
    assert errors["zero"] >= 1e3 * errors["identity"]


@pytest.mark.parametrize("penalty", ["ridge", "lasso"])
def test_an_overwhelming_penalty_toward_the_identity_leaves_f_alone(penalty: str) -> None:
    x, u = slow_manifold_run(100, 0)
    model = PIEDMDc(closed_dictionary(), alpha=1e9, penalty=penalty, toward="identity", half_step="generator")
    model.fit(Episodes([x], [u], dt=STEP), phase_samples())
    a = model.lifted.A
    mu, lam = -0.1, -1.0
    np.testing.assert_allclose(np.diag(a), np.exp(STEP * np.array([0, mu, lam, 2 * mu])), atol=1e-9)
    np.testing.assert_allclose(model.lifted.B, 0, atol=1e-9)


@pytest.mark.parametrize("penalty", ["ridge", "lasso"])
def test_rows_without_h_take_the_known_half_step_twice(penalty: str) -> None:
    x, u = slow_manifold_run(200, 0)
    d1, d2 = Episodes([x], [u], dt=STEP), phase_samples()
    model = PIEDMDc(closed_dictionary(), alpha=1e-6, penalty=penalty, half_step="generator", rows=["x2"]).fit(d1, d2)
    # x1 and x1^2 do not read x2, so the kick in x2 cannot reach them: their rows are exactly those of f.
    np.testing.assert_allclose(model.K_[0], [0, np.exp(-0.1 * STEP), 0, 0, 0], atol=1e-11)
    np.testing.assert_allclose(model.K_[2], [0, 0, 0, np.exp(-0.2 * STEP), 0], atol=1e-11)
    by_mask = PIEDMDc(
        closed_dictionary(), alpha=1e-6, penalty=penalty, half_step="generator", rows=[False, True, False]
    )
    np.testing.assert_array_equal(by_mask.fit(d1, d2).K_, model.K_)


def test_ridge_on_the_composed_map_survives_a_singular_half_step() -> None:
    rng = np.random.default_rng(0)
    rates = np.array([-1.0, -5e3])  # the fast state forgets everything within half a step
    a = np.exp(rates * 0.1)
    us = [rng.normal(size=(40, 1)) for _ in range(4)]
    xs = []
    for u in us:
        x = np.zeros((41, 2))
        for k in range(40):
            x[k + 1] = a * x[k] + np.array([0.1, 0.02]) * u[k]
        xs.append(x + 1e-4 * rng.normal(size=x.shape))
    d1, x2 = Episodes(xs, us, dt=0.1), rng.normal(size=(50, 2))
    d2 = PhaseSamples(x2, np.zeros((50, 1)), x2 * rates)
    model = PIEDMDc(Dictionary(ob.Identity(), n_states=2, n_inputs=1), alpha=1e-8, penalty="ridge", rows=["x1"])
    with pytest.warns(UserWarning, match="cond"):
        model.fit(d1, d2)
    # What is left free, the slow row, is found; the half step in front of it takes half of the kick's decay.
    np.testing.assert_allclose(model.lifted.A[0, 0], a[0], atol=1e-3)
    np.testing.assert_allclose(model.lifted.B[0], 0.1, atol=1e-3)


def test_alpha_is_the_best_of_its_grid_on_held_out_roll_outs() -> None:
    runs = [slow_manifold_run(200, seed) for seed in range(6)]
    d1 = Episodes([x for x, _ in runs], [u for _, u in runs], dt=STEP)
    model = PIEDMDc(closed_dictionary(), alpha="cv", penalty="ridge", toward="identity").fit(d1, phase_samples())
    search = model.cv_
    assert search is not None and search.errors[list(search.alphas).index(search.chosen)] == search.errors.min()
    x, u = slow_manifold_run(200, 77)
    assert model.score(Episodes([x], [u], dt=STEP)).median < 1e-6
    assert model.lifted.provenance["details"]["half_step"] == "generator"


def test_phase_samples_and_episodes_are_not_changed() -> None:
    x, u = slow_manifold_run(60, 0)
    d1, d2 = Episodes([x], [u], dt=STEP), phase_samples(flow=True)
    copies = x.copy(), u.copy(), d2.x.copy(), d2.xdot.copy()
    for split in ("strang", "lie"):
        PIEDMDc(closed_dictionary(), alpha=1e-3, split=split, toward="identity").fit(d1, d2)
    for a, b in zip((x, u, d2.x, d2.xdot), copies, strict=True):
        np.testing.assert_array_equal(a, b)


def test_the_example_of_the_documentation_runs() -> None:
    sm = systems.slow_manifold(mu=-0.1, lam=-1.0, delta=10.0)
    x, u = slow_manifold_run(300, 0)
    rng = np.random.default_rng(0)
    x2, u2 = rng.uniform(-1, 1, (100, 2)), rng.uniform(-0.3, 0.3, (100, 1))
    d1 = Episodes([x], [u], dt=1e-3)
    d2 = PhaseSamples.from_system(sm, x2, u2)
    theta = Dictionary(
        ob.Constant(), ob.Identity(), ob.Expression(lambda x, u: x[0] ** 2, name="x1^2"), n_states=2, n_inputs=1
    )
    model = PIEDMDc(theta, alpha=0.0, half_step="generator", rows="inputs").fit(d1, d2)
    x_hat = model.predict(x[0], u)
    assert x_hat.shape == x.shape and np.abs(x_hat - x).max() < 1e-3


def test_input_rows_and_named_rows_free_what_they_name() -> None:
    theta = Dictionary(ob.Constant(), ob.Identity(), ob.Delays(1, 1), n_states=2, n_inputs=1, quantities=("p", "q"))
    rows, columns, affine = free_block(theta, "inputs")
    assert [theta.column_names[i] for i in columns] == ["u1[k-1]", "u1"] and list(rows) == [1, 2] and not affine
    for selection in (["q"], ["x2"], [False, True]):
        rows, columns, affine = free_block(theta, selection)
        assert list(rows) == [2] and len(columns) == theta.n_columns - 1 and affine


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"split": "yoshida"}, "split"),
        ({"toward": "one"}, "toward"),
        ({"half_step": "euler"}, "half_step"),
        ({"penalty": "huber"}, "penalty"),
        ({"alpha": -1.0}, "alpha"),
        ({"generator_alpha": -1.0}, "generator_alpha"),
        ({"half_step": "flow"}, "x_half"),
        ({"rows": "states"}, "rows"),
        ({"rows": ["x7"]}, "x7"),
        ({"rows": [True]}, "length 1"),
        ({"rows": [False, False, False]}, "no row free"),
    ],
)
def test_bad_options_are_refused_in_one_line(options: dict[str, Any], message: str) -> None:
    x, u = slow_manifold_run(10, 0)
    with pytest.raises(ValueError, match=message) as error, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        PIEDMDc(closed_dictionary(), **{"alpha": 0.0, **options}).fit(Episodes([x], [u], dt=STEP), phase_samples())
    assert "\n" not in str(error.value)


def test_a_missing_d2_is_refused() -> None:
    x, u = slow_manifold_run(10, 0)
    with pytest.raises(ValueError, match="PhaseSamples"):
        PIEDMDc(closed_dictionary(), alpha=0.0).fit(Episodes([x], [u], dt=STEP), x)  # type: ignore[arg-type]


def test_phase_samples_of_another_system_are_refused_by_name() -> None:
    x, u = slow_manifold_run(20, 0)
    d1, d2 = Episodes([x], [u], dt=STEP), phase_samples()
    named = replace(d1, state_names=("slow", "fast"), input_names=("force",))
    for names in ({"state_names": ("slow", "speed")}, {"input_names": ("torque",)}):
        with pytest.raises(ValueError, match=r"d2 has no .* of d1, but"):
            PIEDMDc(closed_dictionary()).fit(named, replace(d2, **names))
    for size in (1, 3):
        other = np.zeros((20, size))
        with pytest.raises(ValueError, match=f"d2 has {size} states"):
            PIEDMDc(closed_dictionary()).fit(d1, PhaseSamples(x=other, u=np.zeros((20, 1)), xdot=other))


def test_phase_samples_in_another_order_are_the_same_samples() -> None:
    x, u = slow_manifold_run(20, 0)
    d1, d2 = Episodes([x], [u], dt=STEP, state_names=("slow", "fast")), phase_samples()
    turned = replace(d2, x=d2.x[:, ::-1], xdot=d2.xdot[:, ::-1], state_names=("fast", "slow"))
    one, other = (
        PIEDMDc(closed_dictionary()).fit(d1, samples) for samples in (replace(d2, state_names=("slow", "fast")), turned)
    )
    np.testing.assert_allclose(one.K_, other.K_, atol=1e-12)


@pytest.mark.parametrize("penalty", ["ridge", "lasso"])
def test_weights_of_rows_lie_between_free_and_fixed(penalty: str) -> None:
    x, u = slow_manifold_run(300, 3)
    d1, d2 = Episodes([x], [u], dt=STEP), phase_samples()

    def fit(rows: Any, alpha: float = 1e-3) -> np.ndarray:
        options: dict[str, Any] = {"penalty": penalty, "toward": "identity", "rows": rows, "relative": False}
        return PIEDMDc(closed_dictionary(), alpha, **options).fit(d1, d2).K_

    every = ["x1", "x2", "x1^2"]
    np.testing.assert_array_equal(fit(dict.fromkeys(every, 1.0)), fit(every))
    np.testing.assert_allclose(fit(dict.fromkeys(every, 4.0)), fit(every, 4e-3), atol=1e-9)  # alpha, all over
    nearly = fit({"x1": 1e9, "x2": 1.0, "x1^2": 1e9})
    np.testing.assert_allclose(nearly, fit(["x2"]), atol=1e-7)
    with pytest.raises(ValueError, match=r"weight of rows\['x2'\] = 0; expected a positive"):
        fit({"x2": 0.0})
    with pytest.raises(ValueError, match="give rows without weights"):
        PIEDMDc(closed_dictionary(), rows={"x2": 1.0}, split="hold")
