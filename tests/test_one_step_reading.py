"""The reading under which the paper's figure appears: its time stepping, its methods, its errors."""

from __future__ import annotations

import importlib
import sys
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np
import pytest

from pisplit import BilinearEDMDc, Dictionary, Episodes, LinearEDMDc, PhaseSamples, PIEDMDc
from pisplit import observables as ob
from pisplit.estimators.edmdc import TOWARD
from pisplit.models.arm.tendon_arm import TendonArm

SCRIPTS = Path(__file__).parent.parent / "scripts"


@pytest.fixture(scope="module")
def modules() -> Any:
    sys.path.insert(0, str(SCRIPTS))
    try:
        rooms = {"paper": ("one_step", "till", "reproduce_paper")}
        return SimpleNamespace(
            **{name: importlib.import_module(f"{room}.{name}") for room, names in rooms.items() for name in names}
        )
    finally:
        sys.path.remove(str(SCRIPTS))


@pytest.fixture(scope="module")
def slow() -> Episodes:
    """Two points and their velocities that move slowly, a linear system known exactly."""
    rng = np.random.default_rng(0)
    a = np.eye(9) + 0.05 * rng.normal(size=(9, 9))
    a /= 1.01 * np.abs(np.linalg.eigvals(a)).max()
    b = 0.02 * rng.normal(size=(9, 2))
    xs, us = [], []
    for _ in range(9):
        u, x = rng.normal(size=(30, 2)), [rng.normal(size=9)]
        for move in u:
            x.append(a @ x[-1] + b @ move)
        xs.append(np.array(x))
        us.append(u)
    outputs = {"shape": range(6), "tip_velocity": range(6, 9)}
    return Episodes(xs, us, dt=0.1, quantities=["p"] * 6 + ["q"] * 3, outputs=outputs)


def test_steps_are_bdf2_of_the_balance_and_rest_stays_at_rest(modules: Any) -> None:
    arm, dt = TendonArm.paper(), 0.03
    scene, n = arm.scene, arm.scene.n_strains
    rest = scene.statics().solve(arm.rest_inputs).state
    pulls = arm.rest_inputs + 1e-3 * np.arange(1, 5)[:, None] * np.array([1.0, -0.5, -0.5])
    run = modules.till.bdf2(scene, dt, 4)
    found, corrections = (np.asarray(v).T for v in run(rest[: 2 * n], pulls.T))
    assert corrections.max() < modules.till.CONVERGED
    states = np.vstack([rest[: 2 * n], rest[: 2 * n], found])
    slopes = (3.0 * states[2:] - 4.0 * states[1:-1] + states[:-2]) / (2.0 * dt)
    np.testing.assert_allclose(slopes[:, :n], found[:, n:], atol=1e-9 * np.abs(found[:, n:]).max())
    x, v, u = (ca.MX.sym(name, size) for name, size in (("x", n), ("v", n), ("u", 3)))
    acceleration = ca.Function("a", [x, v, u], [scene.acceleration(x, v, u)])
    exact = np.array([np.ravel(acceleration(s[:n], s[n:], p)) for s, p in zip(found, pulls, strict=True)])
    np.testing.assert_allclose(slopes[:, n:], exact, atol=1e-5 * np.abs(exact).max())
    still = np.asarray(run(rest[: 2 * n], np.tile(arm.rest_inputs, (4, 1)).T)[0]).T
    np.testing.assert_allclose(still, np.tile(rest[: 2 * n], (4, 1)), atol=1e-6)


def test_smaller_steps_come_nearer_to_the_motion_with_their_square(modules: Any) -> None:
    arm = TendonArm.paper()
    scene, n = arm.scene, arm.scene.n_strains
    rest = scene.statics().solve(arm.rest_inputs).state
    ends = []
    for k in (16, 32, 64):
        blend = 0.5 - 0.5 * np.cos(np.pi * np.arange(1, k + 1) / k)
        pulls = arm.rest_inputs + 5e-3 * blend[:, None] * np.array([1.0, -0.5, -0.5])
        states = np.asarray(modules.till.bdf2(scene, 0.48 / k, k)(rest[: 2 * n], pulls.T)[0]).T
        ends.append(scene.fields(np.concatenate([states[-1], pulls[-1]]))[:, :3])
    coarse, fine = (np.linalg.norm(a - b) for a, b in pairwise(ends))
    assert 1.7 < np.log2(coarse / fine) < 3.0


@pytest.mark.parametrize("penalty", ["ridge", "lasso"])
def test_edmdc_toward_the_identity_is_the_split_of_an_f_that_moves_nothing(slow: Episodes, penalty: str) -> None:
    theta = Dictionary(ob.Identity(), ob.Delays(states=2), n_states=9, n_inputs=2)
    options: dict[str, Any] = {"alpha": 0.03, "penalty": penalty, "toward": "identity", "scale": None}
    rng = np.random.default_rng(1)
    nothing = PhaseSamples(rng.normal(size=(40, 9)), rng.normal(size=(40, 2)), np.zeros((40, 9)))
    direct = LinearEDMDc(theta, **options).fit(slow).K_
    split = PIEDMDc(theta, half_step="first-order", **options).fit(slow, nothing).K_
    np.testing.assert_allclose(direct, split, atol=1e-9)
    stay = np.eye(9, theta.n_columns)
    still = LinearEDMDc(theta, **{**options, "alpha": 1e9}).fit(slow).K_
    np.testing.assert_allclose(still, stay, atol=1e-6)
    present = Dictionary(ob.Identity(), n_states=9, n_inputs=2)
    free, plain = (LinearEDMDc(present, **{**options, "alpha": 0.0, "toward": t}).fit(slow).K_ for t in TOWARD)
    np.testing.assert_allclose(free, plain, atol=1e-9)


def test_a_bilinear_model_may_be_pulled_to_the_identity_too(slow: Episodes) -> None:
    theta = Dictionary(ob.Constant(), ob.Identity(), n_states=9, n_inputs=2)
    found = BilinearEDMDc(theta, alpha=1e9, toward="identity").fit(slow, excitation=None).lifted
    x, u = slow.xs[0], slow.us[0]
    ahead = found.rollout(found.lift(x[:1]), u).x
    centre = slow.stacked_states().mean(axis=0)  # the constant is free: what moves on average is learned
    assert np.abs(ahead[1] - x[0]).max() < 0.1 * np.abs(x[0] - centre).max()
    with pytest.raises(ValueError, match="toward = 'physics'"):
        LinearEDMDc(theta, toward="physics")


def test_a_lasso_toward_the_identity_needs_less_where_little_moves(modules: Any, slow: Episodes) -> None:
    """The mechanism of the reading on a system that is not the arm: one step ahead, few pairs."""
    theta = Dictionary(ob.Identity(), n_states=9, n_inputs=2)
    pairs = slow.pairs(0).take(np.arange(6))
    options: dict[str, Any] = {"alpha": 0.5, "relative": False, "penalty": "lasso", "scale": None}
    errors = {
        toward: np.median(
            modules.one_step.errors_ahead(LinearEDMDc(theta, toward=toward, **options).fit(slow, pairs).lifted, slow, 1)
        )
        for toward in ("zero", "identity")
    }
    assert errors["identity"] < 0.1 * errors["zero"]


@pytest.mark.parametrize("ahead", [1, 5, 0])
def test_an_exact_model_has_no_error_however_far_ahead(modules: Any, slow: Episodes, ahead: int) -> None:
    theta = Dictionary(ob.Identity(), ob.Delays(states=4), n_states=9, n_inputs=2)
    model = LinearEDMDc(theta, alpha=1e-13).fit(slow).lifted
    shape, velocity = modules.one_step.errors_ahead(model, slow, ahead)
    windows = {1: 26, 5: 5, 0: 26}[ahead]
    assert shape.shape == velocity.shape == (9 * windows,)
    assert shape.max() < 1e-9 and velocity.max() < 1e-9


def test_errors_ahead_are_those_of_roll_outs_from_true_histories(modules: Any, slow: Episodes) -> None:
    theta = Dictionary(ob.Identity(), ob.Delays(states=4), n_states=9, n_inputs=2)
    model = LinearEDMDc(theta, alpha=0.3).fit(slow).lifted
    shape, _ = modules.one_step.errors_ahead(model, slow, 5)
    x, u = slow.xs[2], slow.us[2]
    found = model.predict(x[5:10], u[5:9], u[9:14]).x[-1]
    assert shape.reshape(9, 5)[2, 1] == pytest.approx(((found - x[14])[:6] ** 2).sum(), rel=1e-9)


def test_the_estimators_are_those_of_the_text(modules: Any, slow: Episodes) -> None:
    one = modules.one_step
    for penalty, at_100 in (("fixed", 0.64), ("printed", 1.0)):
        fitted = one.estimator("PI-EDMDc", slow, 40, penalty)
        assert fitted.get_params()["toward"] == "identity" and fitted.get_params()["scale"] is None
        rng = np.random.default_rng(0)
        x = rng.normal(size=(40, 9))
        samples = one.kinematic_part(PhaseSamples(x, np.zeros((40, 2)), np.roll(x, 6, axis=1)), slow.quantities)
        assert not samples.xdot[:, 6:].any() and samples.xdot[:, :6].any()
        made = fitted.fit(slow, samples, slow.pairs(4).take(np.arange(100)))
        assert made.fit_.alpha == pytest.approx(at_100)
    planned = one.planned({64: 2, 0: 1}, {64: 1}, (8, 20), 200)
    assert {f.n2 for f in planned if f.method == "PI-EDMDc"} == {8, 20}
    assert {f.n1 for f in planned} == {64, 200} and len({replace(f) for f in planned}) == len(planned)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--hold", "64"), "--hold and --penalty are of --reading one-step"),
        (("--reading", "one-step", "--reasons"), "--vary and --reasons are of the printed protocol"),
    ],
)
def test_options_of_one_reading_are_refused_by_the_other(
    modules: Any, monkeypatch: pytest.MonkeyPatch, arguments: tuple[str, ...], said: str
) -> None:
    monkeypatch.setattr(sys, "argv", ["reproduce_paper.py", "--quick", *arguments])
    with pytest.raises(ValueError, match=said):
        modules.reproduce_paper.main()
