"""Friction that turns round with the sign of slip: gates of it as joint columns of re-lifted models."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from pisplit import Episodes, ReliftedEDMDc, rollout_errors
from pisplit import observables as ob
from pisplit.models.arm.multi_section_arm import MultiSectionArm
from pisplit.models.arm.tendon_arm import TendonArm

pytestmark = pytest.mark.filterwarnings("ignore")
DT, PARTS = 0.05, 20


def rubbing(episodes: int, seed: int) -> Episodes:
    """A mass on a spring that rubs: x'' = 9 (u - x) - 2 x' - 1.5 tanh(x' / 0.05)."""
    knots = np.random.default_rng(seed).uniform(-1.0, 1.0, (episodes, 11))
    u = np.stack([np.interp(np.arange(80) / 8.0, np.arange(11), row) for row in knots])
    x, v, rows = np.zeros(episodes), np.zeros(episodes), [np.zeros((episodes, 2))]
    for k in range(80):
        before = u[:, max(k - 1, 0)]
        for part in (np.arange(PARTS) + 0.5) / PARTS:
            force = 9.0 * (before + part * (u[:, k] - before) - x) - 2.0 * v - 1.5 * np.tanh(v / 0.05)
            v = v + DT / PARTS * force
            x = x + DT / PARTS * v
        rows.append(np.stack([x, v], axis=1))
    xs = np.stack(rows, axis=1)
    return Episodes(list(xs), list(u[..., None]), DT, state_names=["x", "v"], quantities=["x", "v"])


def test_friction_is_learned_by_gates_of_slip() -> None:
    x = ca.MX.sym("x", 2)
    slip = ob.Slip(ca.Function("slip", [x], [x[1]]))
    data, test = rubbing(16, 0), rubbing(4, 1)
    options = {"components": (2,), "leading": (0, 2), "alphas": (1e-8, 1e-5, 1e-3), "cv_folds": 1}
    plain, gated = (ReliftedEDMDc(degrees=(2, 3), slip=s, **options).fit(data) for s in (None, slip))  # type: ignore[arg-type]
    errors = [rollout_errors(fit.lifted, test).median for fit in (plain, gated)]
    assert errors[1] < errors[0] / 4.0


def test_slip_of_an_arm_is_how_fast_the_way_of_its_tendons_to_the_tip_grows() -> None:
    arm, stations, step = TendonArm.paper(nodes=3), 4, 1e-4
    rng, n = np.random.default_rng(0), arm.scene.n_strains
    xi, rate = 0.5 * rng.normal(size=n), rng.normal(size=n)
    states = np.stack([np.concatenate([xi + d * rate, rate, arm.rest_inputs]) for d in (-step, 0.0, step)])
    fields = arm.scene.fields(states, stations).reshape(3, -1)
    speeds = arm.slip(stations).speeds(fields)
    stretch = arm.tension(stations).along(fields, 3)
    np.testing.assert_allclose(speeds[1, :3], stretch[1][1], atol=1e-9)  # at the base it is that of the whole tendon
    points, weights = arm.tendons.points(0.0, arm.scene.rod.length), arm.scene.rule.weights  # type: ignore[union-attr]
    fine = arm.scene.rod.length * (np.arange(400) + 0.5) / 400
    curvature = arm.scene.rule.interpolate(fine) @ states[:, :n].reshape(3, len(weights), 3)
    ways = np.einsum("tki,im->tkm", curvature[..., :2], np.array([[p[1], -p[0]] for p in points]).T)
    for k in range(stations):  # sections at 0, L/4, L/2, 3L/4
        beyond = ways[:, 100 * k :].sum(axis=1) * arm.scene.rod.length / 400
        grows = (beyond[2] - beyond[0]) / (2 * step)
        np.testing.assert_allclose(speeds[1, 3 * k : 3 * k + 3], grows, atol=1e-4 * np.abs(grows).max())


def test_what_is_no_slip_is_refused() -> None:
    x = ca.MX.sym("x", 2)
    with pytest.raises(ValueError, match=r"arm\.slip"):
        ob.Slip(lambda x: x)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="Slip width"):
        ob.Slip(ca.Function("slip", [x], [x[1]]), (0.0,))
    with pytest.raises(ValueError, match="takes 2 states; expected 3"):
        ob.Slip(ca.Function("slip", [x], [x[1]])).speeds(np.zeros((4, 3)))
    with pytest.raises(ValueError, match=r"expected pisplit\.observables\.Slip"):
        ReliftedEDMDc(slip=True)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="slip"):
        MultiSectionArm(sections=2, tendons=3).slip()
