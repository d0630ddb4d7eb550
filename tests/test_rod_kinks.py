"""Rigid kinks: a rod that turns at the end of an element, beside one with a short sharp bend, and its energy."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pisplit.models import rod
from pisplit.models.rod.analysis.energy import stored

LENGTH, AT, TURN = 0.5, 0.3, (0.4, 0.8, -0.5)


def body(strains: str = "kirchhoff", turn: tuple[float, ...] = TURN, **options: Any) -> rod.Rod:
    options = {"elements": (AT, LENGTH - AT), "kinks": ((AT, turn),)} | options
    return rod.Rod(LENGTH, rod.Circle(5e-3), rod.Elastic(1e7, 3.4e6, 1000.0), strains, **options)


LOADS = (rod.Gravity((-9.81, 1.0, 0.0)), rod.TipWrench(force=(0.02, 0.02, -0.02)))


def test_a_kink_is_the_limit_of_a_sharp_bend() -> None:
    """Shape and frequencies differ by the length of the bend, which falls with it."""
    kinked = rod.Scene(body(), *LOADS, nodes=3)
    found = kinked.statics().solve()
    assert found.success
    before, behind = (found.pose(s)[1] for s in (AT - 1e-9, AT))
    assert Rotation.from_matrix(before.T @ behind).as_rotvec() == pytest.approx(TURN, abs=1e-6)
    tips, frequencies = [], []
    for width in (2e-3, 1e-3):
        bent = body(
            kinks=(),
            elements=(AT, width, LENGTH - AT - width),
            rest_curvature=lambda s, h=width: tuple(np.array(TURN) / h * (AT < s < AT + h)),
        )
        scene = rod.Scene(bent, *LOADS, nodes=(3, 2, 3))
        sharp = scene.statics().solve()
        tips.append(np.linalg.norm(sharp.tip - found.tip) / LENGTH)
        frequencies.append(scene.modes(sharp.state, 2).frequency)
    assert tips[0] < 1e-3 and tips[1] == pytest.approx(0.5 * tips[0], rel=0.1)
    own = kinked.modes(found.state, 2).frequency
    assert 2.0 * frequencies[1] - frequencies[0] == pytest.approx(own, rel=1e-4)


def test_a_plane_kink_is_that_of_a_spatial_rod() -> None:
    loads, turn = rod.Gravity((-9.81, 0.0, 0.0)), (0.0, 1.0, 0.0)
    plane, space = (rod.Scene(body(s, turn), loads, nodes=3).statics().solve() for s in ("planar", "kirchhoff"))
    for s in (0.2, AT, 0.4, LENGTH):
        assert np.hstack(plane.pose(s)[:1]) == pytest.approx(space.pose(s)[0], abs=1e-9)
        assert plane.pose(s)[1] == pytest.approx(space.pose(s)[1], abs=1e-9)
    straight = rod.Scene(body(turn=(0.0, 0.0, 0.0)), *LOADS, nodes=3)
    assert straight.fingerprint() == rod.Scene(body(kinks=()), *LOADS, nodes=3).fingerprint()
    assert straight.fingerprint() != rod.Scene(body(), *LOADS, nodes=3).fingerprint()


def test_a_kinked_rod_keeps_its_energy() -> None:
    """The variational balance is Lagrange's equation: d(T + V)/dt = 0 at any state."""
    masses = [rod.PointMass(s, 0.05, offset=(0.05, 0.03, 0.02)) for s in (AT, 0.4)]
    scene = rod.Scene(body(), LOADS[0], *masses, nodes=3).variational()
    xi, xi_t, xi_tt, u, balance = scene.dynamic_balance
    residual = ca.DM(scene.weights) * balance.residual
    kinetic, elastic, gravity = stored(scene)(xi, xi_t, ca.SX(0, 1))
    way = (ca.vertcat(xi, xi_t), ca.vertcat(xi_t, xi_tt))
    gain = [ca.jtimes(energy, *way) for energy in (kinetic, kinetic + elastic + gravity)]
    read = ca.Function("read", [xi, xi_t, xi_tt, u], [-ca.jacobian(residual, xi_tt), residual, *gain])
    q, v = 1.5 * scene.nominal_strains * np.random.default_rng(0).standard_normal((2, scene.n_strains))
    mass, force = (np.array(m) for m in read(q, v, 0.0, [])[:2])
    *_, moved, lost = read(q, v, np.linalg.solve(mass, force), [])
    assert abs(float(lost)) < 1e-9 * abs(float(moved))


def test_finer_grids_keep_kinks_and_what_does_not_pass_them_is_refused() -> None:
    turn, push = (0.0, 0.8, 0.0), rod.PointWrench(0.2, force=(0.1, 0.0, 0.0))
    auto = rod.Scene(body("planar", turn), rod.Gravity((-9.81, 0.0, 0.0)), push, nodes="auto")
    assert auto.rod.kinks == ((AT, turn),) and len(auto.rod.elements) == 3
    assert auto.statics().solve().error < 1e-4
    with pytest.raises(ValueError, match="end of an element"):
        body(elements=())
    with pytest.raises(ValueError, match="in its plane"):
        body("planar")
    for options in ({"friction": 0.1}, {"disks": 3}):
        with pytest.raises(ValueError, match="kinks"):
            rod.Scene(body(), rod.Tendons.parallel(8e-3, (0,), rod.Tension(), **options))  # type: ignore[arg-type]
