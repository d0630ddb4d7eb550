"""Statics beyond one solve: sweeps, Jacobians, compliance, stability, inverse statics, fixed tips, hard cold starts."""

import numpy as np
import pytest

from pisplit.models import rod
from pisplit.models.arm.tendon_arm import TendonArm

ARM = TendonArm.paper(nodes=5)
STATICS = ARM.scene.statics()
BODY = rod.Rod(0.4, rod.Circle(1e-3), rod.Elastic(207e9, 207e9 / 2.6, 8000.0), "kirchhoff")
EI = BODY.stiffness[0]


def planar(*terms: object, nodes: int = 8) -> rod.Scene:
    body = rod.Rod(BODY.length, BODY.section, BODY.material, "planar")
    return rod.Scene(body, *terms, nodes=nodes)


@pytest.mark.parametrize(("size", "flagged"), [(100.0, 0), (300.0, 2)])
def test_cold_tip_loads_in_random_directions_are_followed_or_flagged(size: float, flagged: int) -> None:
    """Those flagged push almost along the rod, 300 EI/L^2 on six nodes."""
    statics = rod.Scene(BODY, rod.TipWrench(force=rod.Input("f", 3)), nodes=6).statics()
    directions = np.random.default_rng(7).standard_normal((60, 3))
    found = [
        statics.solve(size * EI / BODY.length**2 * d) for d in directions / np.linalg.norm(directions, axis=1)[:, None]
    ]
    assert all(e.branch == "followed" and e.stable and e.margin > 0.0 for e in found if e.success)
    assert sum(not e.success for e in found) <= flagged and all(e.message for e in found if not e.success)


def test_a_sweep_gives_the_equilibria_of_single_solves() -> None:
    angle = np.linspace(0.0, 2.0, 25)[:, None]
    inputs = 1e-3 + 8e-3 * np.cos(angle + np.array([0.0, 2.1, 4.2]))
    sweep = STATICS.sweep(inputs)
    assert sweep.success.all()
    for k in (0, 11, 24):
        single = STATICS.solve(inputs[k])
        assert sweep.states[k] == pytest.approx(single.state, abs=1e-8)
        assert sweep.tensions[k] == pytest.approx(single.tensions, rel=1e-6)


def test_a_sweep_stays_on_a_buckled_branch_through_zero_side_load() -> None:
    """Twice the Euler load: a small side force chooses the branch, and the rod keeps it when the force is gone."""
    statics = planar(rod.TipWrench(force=rod.Input("f", 3))).statics()
    euler = np.pi**2 * EI / (4.0 * BODY.length**2)
    side = np.concatenate([np.full(21, 0.05), np.linspace(0.05, 0.0, 11)]) * euler
    down = np.concatenate([np.linspace(0.0, 2.0, 21), np.full(11, 2.0)]) * euler
    sweep = statics.sweep(np.stack([side, 0.0 * side, -down], axis=1))
    assert sweep.success.all()
    bent = statics.scene.fields(sweep.states[-1], [BODY.length])[0, 0]
    assert bent > 0.3 * BODY.length
    assert statics.stability(sweep.states[-1]).stable
    cold = statics.solve([0.0, 0.0, -2.0 * euler])
    assert cold.success and cold.branch == "snapped" and cold.load_factor == pytest.approx(0.5, abs=1e-3)
    assert abs(cold.tip[0]) == pytest.approx(bent, rel=1e-6) and "buckling" in cold.message


def test_stability_margin_of_a_column_is_linear_up_to_the_euler_load() -> None:
    """1 - F / F_E with F_E = pi^2 EI / (4 L^2); the mode is the curvature cos(pi s / 2 L)."""
    scene = planar(rod.TipWrench(force=rod.Input("f", 3)))
    euler = np.pi**2 * EI / (4.0 * BODY.length**2)
    for share in (0.0, 0.5, 0.99, 1.01):
        found = scene.statics().stability(scene.state(np.zeros(8), np.zeros(8), [0.0, 0.0, -share * euler]))
        assert found.margin == pytest.approx(1.0 - share, abs=1e-9)
        assert found.asymmetry < 1e-12
    shape = np.cos(0.5 * np.pi * scene.rule.nodes / BODY.length)
    assert found.mode == pytest.approx(shape / shape[0], abs=1e-6)


def test_variational_tangents_of_dead_loads_are_symmetric() -> None:
    terms = (rod.Gravity((-9.81, 0.0, 0.0)), rod.TipWrench(force=(0.05, 0.1, -0.1)))
    scene = rod.Scene(BODY, *terms, nodes=4).variational()
    follower = scene + rod.TipWrench(force=(0.3, 0.0, 0.0), follower=True)
    dead, turned = (s.statics().stability(s.statics().solve().state) for s in (scene, follower))
    assert dead.asymmetry < 1e-9 < 1e-4 < turned.asymmetry


def test_compliance_of_a_straight_rod() -> None:
    """Cantilever: L^3/3EI, L^2/2EI, L/EI and L/GJ."""
    scene = rod.Scene(BODY, nodes=6)
    found = scene.statics().sensitivity(np.zeros(scene.n_states)).compliance
    length, gj = BODY.length, BODY.stiffness[2]
    expected = np.zeros((6, 6))
    expected[0, 0] = expected[1, 1] = length**3 / (3.0 * EI)
    expected[0, 4] = expected[4, 0] = length**2 / (2.0 * EI)
    expected[1, 3] = expected[3, 1] = -(length**2) / (2.0 * EI)
    expected[3, 3] = expected[4, 4] = length / EI
    expected[5, 5] = length / gj
    assert found == pytest.approx(expected, rel=1e-6, abs=1e-7 * length / EI)


def test_jacobian_and_compliance_are_derivatives_of_equilibria() -> None:
    u = np.array([8e-3, -2e-3, -3e-3])
    state = STATICS.solve(u).state
    found = STATICS.sensitivity(state, s=0.5)
    for k in range(3):
        step = 1e-6 * np.eye(3)[k]
        poses = [STATICS.solve(u + sign * step, guess=state).pose(0.5) for sign in (1.0, -1.0)]
        assert found.jacobian[:3, k] == pytest.approx((poses[0][0] - poses[1][0]) / 2e-6, rel=1e-5, abs=1e-5)
        spin = (poses[0][1] - poses[1][1]) / 2e-6 @ found.R.T
        turn = np.array([spin[2, 1], spin[0, 2], spin[1, 0]])
        assert found.jacobian[3:, k] == pytest.approx(turn, rel=1e-4, abs=1e-4)
    pushed = (ARM.scene + rod.PointWrench(0.5, force=(0.0, 1e-5, 0.0))).statics().solve(u, guess=state)
    assert found.compliance[:3, 1] == pytest.approx((pushed.pose(0.5)[0] - found.p) / 1e-5, rel=1e-3, abs=1e-4)


def test_inverse_statics_finds_inputs_for_a_tip() -> None:
    rng = np.random.default_rng(3)
    for _ in range(5):
        pulls = 1e-3 + ARM.differential_basis @ rng.uniform(-6e-3, 6e-3, 2)
        target = STATICS.solve(pulls).tip
        target[2] = np.nan
        found = STATICS.inverse(target, limits=(-0.012, 0.012), start=ARM.rest_inputs)
        assert found.success and found.message == ""
        assert np.abs(found.equilibrium.tip - target)[:2].max() <= 1e-8 * ARM.scene.rod.length
        assert np.all(np.abs(found.u) <= 0.012)


def test_inverse_statics_keeps_its_limits_and_says_when_a_place_is_out_of_reach() -> None:
    found = ARM.scene.inverse([0.0, 0.3, np.nan], limits=(0.0, 2e-3), start=ARM.rest_inputs)
    assert not found.success and "out of reach" in found.message
    assert np.all((found.u >= 0.0) & (found.u <= 2e-3)) and found.error > 1e-3
    with pytest.raises(ValueError, match="target"):
        STATICS.inverse([np.nan, np.nan, np.nan])
    with pytest.raises(ValueError, match="limits"):
        STATICS.inverse([0.0, 0.0, 0.7], limits=(1.0, 0.0))
    with pytest.raises(ValueError, match="no inputs"):
        rod.Scene(BODY).statics().inverse([0.0, 0.0, 0.4])


def test_inverse_says_where_loading_from_nothing_ends_instead() -> None:
    """A bent strut under its weight falls to one side; pulled to the other it stays there when let go."""
    bent = rod.Rod(0.5, rod.Circle(3e-3), rod.Elastic(1e7, 3.4e6, 1000.0), "planar", rest_curvature=(0.0, 0.2, 0.0))
    scene = rod.Scene(bent, rod.Gravity((0.0, 0.0, -9.81)), rod.TipWrench(moment=rod.Input("m", 3)), nodes=8)
    pull = np.array([0.0, -bent.stiffness[1] / bent.length, 0.0])
    over, target = scene.statics().solve(pull), (-0.165, np.nan, np.nan)
    found = scene.inverse(target, start=pull)
    back = scene.statics().solve(found.u, over.state)
    assert found.success and back.tip == pytest.approx(found.equilibrium.tip, abs=1e-7) and back.tip[0] < -0.14
    there = scene.statics().solve(found.u)
    assert there.success and there.tip[0] > 0.1
    assert found.loaded == pytest.approx(np.linalg.norm(there.tip - back.tip), rel=1e-6)
    assert f"ends {1e3 * found.loaded:.3g} mm away" in found.message
    other = scene.inverse((0.19, np.nan, np.nan))
    assert other.success and other.loaded < 1e-7 and not other.message


def test_a_fixed_tip_needs_the_wrench_that_would_bring_it_there() -> None:
    force, moment = np.array([0.3, 0.4, -0.2]), np.array([0.02, -0.01, 0.015])
    scene = rod.Scene(BODY, rod.Gravity((-9.81, 0.0, 0.0)), nodes=6)
    loaded = (scene + rod.TipWrench(tuple(force), tuple(moment))).statics().solve()
    p, turn = loaded.pose(BODY.length)
    clamped = scene.statics().clamp_tip(p, turn)
    assert clamped.success and clamped.residual <= 1e-8
    assert clamped.force == pytest.approx(force, rel=1e-6, abs=1e-8)
    assert clamped.moment == pytest.approx(moment, rel=1e-6, abs=1e-8)
    pinned = scene.statics().pin_tip(p)
    assert pinned.success and not pinned.moment.any()
    assert scene.fields(pinned.state, [BODY.length])[0, :3] == pytest.approx(p, abs=1e-8)


def test_a_rod_clamped_at_both_ends_carries_a_side_load_as_in_the_book() -> None:
    """Small tip deflection d of a rod whose tip keeps its direction: 12 EI d / L^3 and 6 EI d / L^2."""
    d = 1e-5
    stretching = rod.Rod(BODY.length, BODY.section, BODY.material, "planar-cosserat")
    clamped = rod.Scene(stretching, nodes=6).statics().clamp_tip((d, 0.0, BODY.length), np.eye(3))
    assert clamped.success
    assert clamped.force[0] == pytest.approx(12.0 * EI * d / BODY.length**3, rel=1e-3)
    assert clamped.moment[1] == pytest.approx(-6.0 * EI * d / BODY.length**2, rel=1e-3)


def test_a_straight_rod_is_pushed_together() -> None:
    """The pinned tip of a straight inextensible rod moves towards the clamp: it buckles and pushes back."""
    for scene in (planar(), rod.Scene(BODY, nodes=6)):
        pinned = scene.statics().pin_tip((0.0, 0.0, 0.9 * BODY.length))
        assert pinned.success
        assert pinned.force[2] < -0.5 * np.pi**2 * EI / BODY.length**2


def test_a_place_beyond_the_length_is_flagged() -> None:
    pinned = rod.Scene(BODY, nodes=5).statics().pin_tip((0.0, 0.3, 0.4))
    assert not pinned.success and "of the way" in pinned.message and np.isfinite(pinned.state).all()
    with pytest.raises(ValueError, match="not a rotation"):
        rod.Scene(BODY, nodes=5).statics().clamp_tip((0.0, 0.1, 0.3), np.ones((3, 3)))
