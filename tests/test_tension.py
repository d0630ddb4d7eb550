"""Tendons that go slack: what they feel of state and coming command as joint columns of re-lifted models."""

from __future__ import annotations

from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from pisplit import Episodes, LiftedModel, ReliftedEDMDc, rollout_errors
from pisplit import observables as ob
from pisplit.lifted.relifting import GATE, HINGE, ReliftedTerm
from pisplit.models.arm.multi_section_arm import MultiSectionArm
from pisplit.models.arm.tendon_arm import TendonArm

pytestmark = pytest.mark.filterwarnings("ignore")
DT = 0.05


def mass(episodes: int, seed: int) -> Episodes:
    """A mass on a spring between two tendons that pull where they are stretched: x'' = -x - 0.4 x' - 20 (e1+ - e2+)."""
    rng, xs, us = np.random.default_rng(seed), [], []
    for _ in range(episodes):
        knots = rng.uniform(-1.0, 1.0, (9, 2))
        u = np.stack([np.interp(np.arange(64) / 8.0, np.arange(9), k) for k in knots.T], axis=1)
        x, before, rows = np.zeros(2), u[0], [np.zeros(2)]
        for now in u:
            for part in (np.arange(20) + 0.5) / 20:
                a, b = before + part * (now - before)
                pull = max(0.0, a + x[0]) - max(0.0, b - x[0])
                x = x + DT / 20 * np.array([x[1], -x[0] - 0.4 * x[1] - 20.0 * pull])
            before = now
            rows.append(x)
        xs.append(np.array(rows))
        us.append(u)
    return Episodes(xs, us, DT, state_names=["x", "v"], quantities=["x", "v"])


@pytest.fixture(scope="module")
def stretch() -> ob.Tension:
    x = ca.MX.sym("x", 2)
    return ob.Tension(ca.Function("stretch", [x], [ca.vertcat(x[0], -x[0], x[1], -x[1])]))


@pytest.fixture(scope="module")
def model(stretch: ob.Tension) -> LiftedModel:
    options = {"components": (2,), "leading": (0, 2), "degrees": (2,), "alphas": (1e-8, 1e-5), "cv_folds": 1}
    return ReliftedEDMDc(**options, tension=stretch).fit(mass(12, 0)).lifted  # type: ignore[arg-type]


def test_slack_is_learned_where_its_columns_are_joint(model: LiftedModel) -> None:
    test = mass(4, 1)
    plain = ReliftedEDMDc((2,), (0, 2), (2, 3), (1e-8, 1e-5), cv_folds=1).fit(mass(12, 0))
    errors = [rollout_errors(m, test).median for m in (plain, model)]
    assert errors[1] < errors[0] / 20.0


def test_kinks_have_their_derivatives_and_are_kept_in_files(model: LiftedModel, tmp_path: Path) -> None:
    assert model.relifted is not None and set(model.relifted.kinks[:, -2]) == {HINGE, GATE}
    rng, step = np.random.default_rng(0), 1e-6
    model.save(tmp_path / "model.h5")
    again = LiftedModel.load(tmp_path / "model.h5")
    for _ in range(3):
        z, u = rng.normal(size=model.n_lifted), rng.uniform(-1.0, 1.0, 2)
        of_z, of_u = model.jacobian(z, u)
        ahead = [(model.step(z + step * d, u) - model.step(z - step * d, u)) / (2 * step) for d in np.eye(len(z))]
        np.testing.assert_allclose(of_z, np.array(ahead).T, atol=1e-7)
        ahead = [(model.step(z, u + step * d) - model.step(z, u - step * d)) / (2 * step) for d in np.eye(2)]
        np.testing.assert_allclose(of_u, np.array(ahead).T, atol=1e-7)
        np.testing.assert_array_equal(again.step(z, u), model.step(z, u))


def test_the_stretch_of_an_arm_is_that_of_its_tendons() -> None:
    arm = TendonArm.paper(nodes=3)
    u = arm.rest_inputs + np.array([[4e-3, -2e-3, -2e-3], [-3e-3, 5e-3, -2e-3]])
    solved = arm.scene.statics().solve_many(u)
    told, rate = arm.tension(4).along(arm.scene.fields(solved.states, 4).reshape(2, -1), 3)
    term = arm.tendons
    points = term.points(0.0, arm.scene.rod.length)
    curvature = solved.states[:, : arm.scene.n_strains].reshape(2, 3, 3)
    weights = arm.scene.rule.weights
    exact = [  # stretch of what runs at r along a backbone that does not stretch
        [
            sum(
                w * (np.linalg.norm(np.array([0.0, 0.0, 1.0]) + np.cross(k, [*r, 0.0])) - 1.0)
                for w, k in zip(weights, row, strict=True)
            )
            for r in points
        ]
        for row in curvature
    ]
    np.testing.assert_allclose(told, exact, atol=2e-3 * np.abs(exact).max())
    np.testing.assert_allclose(rate, 0.0, atol=1e-9)


def test_what_is_no_stretch_is_refused(stretch: ob.Tension) -> None:
    with pytest.raises(ValueError, match=r"arm\.tension"):
        ob.Tension(lambda x: x)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="Tension width"):
        ob.Tension(stretch.function, gate=0.0)
    with pytest.raises(ValueError, match="takes 2 states and gives 4 values; expected 3 and 4"):
        stretch.along(np.zeros((5, 3)), 2)
    with pytest.raises(ValueError, match=r"expected pisplit\.observables\.Tension"):
        ReliftedEDMDc(tension=stretch.function)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="widths of kinks"):
        ReliftedTerm(np.eye(2), np.zeros(2), np.zeros((0, 2)), np.zeros((1, 0)), np.zeros((1, 5)))
    with pytest.raises(ValueError, match="tension"):
        MultiSectionArm(sections=2, tendons=3).tension()
