"""Facts of the rod's equations: moments act as the transpose of turning, and what is stable."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pisplit.models import rod
from pisplit.models.rod.equations.tangent import Stability


@pytest.mark.parametrize("elements", [(), (0.2, 0.3)])
@pytest.mark.parametrize("strains", ["kirchhoff", "cosserat"])
def test_moments_act_on_strains_as_the_transpose_of_turning(strains: str, elements: tuple[float, ...]) -> None:
    """sum_k m_k . dO_k + m . dO(L) is the work of the conjugate moments on the rates of w, at any shape."""
    body = rod.Rod(0.5, rod.Circle(0.01), rod.Elastic(1e6, 4e5, 1000.0), strains=strains, elements=elements)
    scene = rod.Scene(body, nodes=4).variational()
    xi, xi_t, _, _, balance = scene.dynamic_balance
    motion, rng = balance.motion, np.random.default_rng(0)
    m, tip = ca.SX.sym("m", 3, scene.nodes), ca.SX.sym("tip", 3)
    turning = [motion.spin, motion.spin_at([0.5])]
    function = ca.Function("f", [xi, xi_t, m, tip], [*turning, motion.conjugate(m, tip)])
    free = scene.rod.strain_set.n_fields
    for _ in range(3):
        moments, end = rng.normal(size=(3, scene.nodes)), rng.normal(size=3)
        rates = rng.normal(size=scene.n_strains)
        spin, spin_at_tip, acting = (
            np.asarray(v) for v in function(3.0 * rng.normal(size=scene.n_strains), rates, moments, end)
        )
        work = float((moments * spin).sum() + end @ spin_at_tip.ravel())
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
