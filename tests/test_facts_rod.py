"""Facts of the rod's equations: moments act as the transpose of turning, and what is stable."""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pisplit.models import rod
from pisplit.models.rod.equations.tangent import Stability, stability
from pisplit.models.rod.kinematics.strains import turn_rows
from pisplit.models.rod.terms.routing import sample


@pytest.mark.parametrize("elements", [(), (0.2, 0.3)])
@pytest.mark.parametrize("strains", ["kirchhoff", "cosserat"])
def test_moments_act_on_strains_as_the_transpose_of_turning(strains: str, elements: tuple[float, ...]) -> None:
    """sum_k m_k . dO_k + m . dO(L) + m . dO(s) is the work of the conjugate moments on the rates of w, at any shape."""
    body = rod.Rod(0.5, rod.Circle(0.01), rod.Elastic(1e6, 4e5, 1000.0), strains=strains, elements=elements)
    scene = rod.Scene(body, nodes=4).variational()
    xi, xi_t, _, _, balance = scene.dynamic_balance
    motion, rng = balance.motion, np.random.default_rng(0)
    m, tip, point = ca.SX.sym("m", 3, scene.nodes), ca.SX.sym("tip", 3), ca.SX.sym("point", 3)
    turning = [motion.spin, motion.spin_at([0.5]), motion.spin_at([0.35])]
    function = ca.Function("f", [xi, xi_t, m, tip, point], [*turning, motion.conjugate(m, tip, {0.35: point})])
    free = scene.rod.strain_set.n_fields
    for _ in range(3):
        moments, end, between = rng.normal(size=(3, scene.nodes)), rng.normal(size=3), rng.normal(size=3)
        rates = rng.normal(size=scene.n_strains)
        spin, spin_at_tip, spin_between, acting = (
            np.asarray(v) for v in function(3.0 * rng.normal(size=scene.n_strains), rates, moments, end, between)
        )
        work = float((moments * spin).sum() + end @ spin_at_tip.ravel() + between @ spin_between.ravel())
        assert float((acting * rates.reshape(-1, free)[:, :3].T).sum()) == pytest.approx(work, rel=1e-9)


def test_a_margin_of_nothing_is_not_stable() -> None:
    mode = np.ones(3)
    assert not Stability(0.0, mode, 0.0).stable and not Stability(-1e-9, mode, 0.0).stable
    assert Stability(1e-9, mode, 0.0).stable


def test_a_rod_that_may_not_stretch_shows_the_strain_that_its_force_asks_for() -> None:
    """Kirchhoff: v = (0, 0, 1 + N / EA) is read from the force, along the whole rod."""
    body = rod.Rod(0.5, rod.Circle(0.01), rod.Elastic(1e6, 4e5, 1000.0))
    force = 0.05 * body.stiffness[5]
    scene = rod.Scene(body, rod.TipWrench(force=(0.0, 0.0, force)), nodes=4)
    fields = scene.fields(scene.statics().solve().state, 5)
    np.testing.assert_allclose(fields[:, 12:15], np.tile([0.0, 0.0, 1.05], (5, 1)), atol=1e-9)


def test_a_pose_turns_with_its_base() -> None:
    """Rotation of the tip by the inputs, base turned by an input: as by finite differences."""
    body = rod.Rod(0.5, rod.Circle(0.01), rod.Elastic(1e6, 4e5, 1000.0))
    scene = rod.Scene(body, rod.Gravity((0.0, 0.0, -1.0)), rod.Base(rotation=rod.Input("turn", 3)), nodes=4)
    statics, u, step = scene.statics(), np.array([0.3, -0.2, 0.4]), 1e-5
    found = statics.sensitivity(statics.solve(u).state).jacobian
    for k in range(3):
        after, before = (
            statics.sensitivity(statics.solve(u + sign * step * np.eye(3)[k]).state).R for sign in (1.0, -1.0)
        )
        turn = Rotation.from_matrix(after @ before.T).as_rotvec() / (2.0 * step)
        np.testing.assert_allclose(found[3:, k], turn, atol=1e-6)


def test_a_line_is_its_numbers() -> None:
    assert rod.Line([0.01, 0.0], np.array([0.005, 0.0]), 0.5) == rod.Line((0.01, 0.0), (0.005, 0.0), 0.5)  # type: ignore[arg-type]
    assert len({rod.Line([0.01, 0.0], [0.005, 0.0], 0.5), rod.Line((0.01, 0.0), (0.005, 0.0), 0.5)}) == 1  # type: ignore[arg-type]


def test_the_skew_part_of_a_tangent_is_weighed_against_the_symmetric_one() -> None:
    """|K - K^T| / |K + K^T| of the tangent by differences, under a load that follows the rod."""
    body = rod.Rod(0.5, rod.Circle(0.01), rod.Elastic(1e6, 4e5, 1000.0), strains="planar")
    scene = rod.Scene(body, rod.TipWrench(force=(-0.05, 0.0, 0.0), follower=True), nodes=4)
    found = scene.statics().solve().state
    xi, u, balance = scene.static_balance
    residual = ca.Function("r", [xi, u], [balance.residual])
    h, n = 1e-5, scene.n_strains
    columns = [np.asarray(residual(found[:n] + h * e, []) - residual(found[:n] - h * e, [])).ravel() for e in np.eye(n)]
    tangent = -np.diag(scene.rule.weights) @ np.array(columns).T / (2.0 * h)
    skew = float(np.linalg.norm(tangent - tangent.T) / np.linalg.norm(tangent + tangent.T))
    assert skew > 1e-3 and stability(scene, found).asymmetry == pytest.approx(skew, rel=1e-5)


def test_the_order_of_a_turn_is_that_of_the_element_it_lies_in() -> None:
    body = rod.Rod(0.5, rod.Circle(0.01), rod.Elastic(1e6, 4e5, 1000.0), elements=(0.2, 0.3))
    rule = rod.Scene(body, nodes=[4, 8]).rule
    assert len(turn_rows(rule, 0.0, 0.2)) == len(turn_rows(rule, 0.1, 0.2)) == 2
    assert len(turn_rows(rule, 0.2, 0.5)) == len(turn_rows(rule, 0.2, 0.25)) == len(turn_rows(rule, 0.4, 0.5)) == 3


def test_the_slope_of_a_route_is_taken_from_points_on_the_rod() -> None:
    seen: list[float] = []

    def route(s: float) -> Sequence[float]:
        seen.append(s)
        return 0.01 * np.cos(s), 0.01 * np.sin(s)

    points = np.array([0.0, 1e-5, 0.25, 0.5 - 1e-5, 0.5])
    _, slope = sample(route, points, 0.5)
    assert min(seen) >= 0.0 and max(seen) <= 0.5
    assert slope[0] == pytest.approx(-0.01 * np.sin(points), abs=1e-9)
    assert slope[1] == pytest.approx(0.01 * np.cos(points), abs=1e-9)


def test_a_tendon_that_is_barely_out_of_the_plane_is_refused_in_it() -> None:
    body = rod.Rod(0.5, rod.Circle(0.01), rod.Elastic(1e6, 4e5, 1000.0), strains="planar")
    with pytest.raises(ValueError, match="plane"):
        rod.Scene(body, rod.Tendons([(5e-3, 1e-9)]), nodes=4).statics().solve([1.0])


def test_the_offset_that_is_described_is_that_at_the_base() -> None:
    body = rod.Rod(0.5, rod.Circle(0.01), rod.Elastic(1e6, 4e5, 1000.0))
    tendons = rod.Tendons([rod.Line((0.01, 0.0), (0.005, 0.0), 0.5)])
    assert "offset 10 mm" in tendons.describe(body)


def test_friction_of_a_gentle_bend_does_not_depend_on_the_size_of_the_arm() -> None:
    """A straight tendon held at a turn of 1e-4 rad, where friction is rounded, on rods of 0.1 and of 10 m."""
    shares = []
    for scale in (0.1, 10.0):
        body = rod.Rod(scale, rod.Circle(0.01 * scale), rod.Elastic(1e6, 4e5, 1000.0), strains="planar")
        scene = rod.Scene(body, rod.Tendons([(5e-3 * scale, 0.0)], friction=5.0), nodes=4)
        free = rod.Scene(body, rod.Tendons([(5e-3 * scale, 0.0)]), nodes=4)
        pull = [3e-5 * body.stiffness[0] / scale / (5e-3 * scale)]
        bent = [s.statics().solve(pull).state[: s.n_strains] for s in (scene, free)]
        shares.append(bent[0] / bent[1])
    assert shares[0] == pytest.approx(shares[1], rel=1e-9) and shares[0].min() < 1.0 - 1e-6


def test_free_strains_may_be_given_as_a_list() -> None:
    given = rod.StrainSet("in the plane", [1])  # type: ignore[arg-type]
    assert given.free == (1,) and hash(given) == hash(rod.StrainSet("in the plane", (1,)))


def test_friction_of_a_tendon_that_ends_early_counts_its_own_length() -> None:
    """On a rod without other loads the half that a tendon runs along bends as a rod of that length does."""
    pulls = []
    for length, elements in ((0.25, (0.25,)), (0.5, (0.25, 0.25))):
        body = rod.Rod(length, rod.Circle(0.01), rod.Elastic(1e6, 4e5, 1000.0), elements=elements)
        drive = rod.Displacement(compliance=1e-2)
        scene = rod.Scene(body, rod.Tendons([(5e-3, 0.0)], drive, friction=0.4, end=0.25), nodes=5)
        pulls.append(scene.statics().solve([5e-3]).tensions[0])
    assert pulls[0] > 0.1
    assert pulls[1] == pytest.approx(pulls[0], rel=1e-3)  # the ends of the half bend into one another
