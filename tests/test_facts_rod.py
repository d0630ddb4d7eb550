"""Facts of the rod's equations: moments act as the transpose of turning, and what is stable."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

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
