"""Equilibria of rods on a hinge, a ball joint or slides."""

import numpy as np
import pytest

from pisplit.models import rod

L = 0.5
WEIGHT = 9.81 * 1100.0 * np.pi * 4e-3**2 * L


def body(strains: str = "planar", young: float = 4e6) -> rod.Rod:
    material = rod.Elastic(young, young / 2.8, 1100.0)
    return rod.Rod(length=L, section=rod.Circle(4e-3), material=material, strains=strains)


HINGE = rod.Base(hinge=(0, 1, 0))


@pytest.mark.parametrize("start", [0.0, 2.5, -0.1])
@pytest.mark.parametrize(("gravity", "angle"), [((0, 0, 9.81), 0.0), ((9.81, 0, 0), np.pi / 2), ((0, 0, -9.81), np.pi)])
def test_a_soft_rod_hangs_straight_from_its_hinge(gravity, angle, start):
    """Wherever it is let go, upright above the hinge too, which is no place to stay."""
    scene = rod.Scene(body(), HINGE, rod.Gravity(gravity), nodes=4)
    found = scene.statics().solve(guess=np.append(np.zeros(4), start))
    assert found.success and found.stable and found.residual < 1e-10
    assert np.allclose(found.tip, L * np.array([np.sin(angle), 0.0, np.cos(angle)]), atol=1e-9)
    assert (found.branch == "settled") == (start != angle)
    assert found.margin == pytest.approx(scene.statics().solve().margin) and found.error < 1e-9
    assert np.allclose(scene.base_reactions(found.state)[:3], -WEIGHT / 9.81 * np.array(gravity), atol=1e-9)


def test_a_stiff_rod_turns_as_its_loads_say():
    """tan of the angle is force over half the weight; stiffness of the joint: what gravity and force pull."""
    push = rod.TipWrench(force=rod.Input("push", 3))
    scene = rod.Scene(body(young=4e13), HINGE, rod.Gravity((0, 0, 9.81)), push, nodes=3)
    forces = np.array([0.05, 0.1, -0.3])
    found = scene.statics().solve_many(np.outer(forces, [1.0, 0.0, 0.0]))
    assert found.success.all()
    assert np.allclose(found.states[:, 3], np.arctan(forces / (0.5 * WEIGHT)), atol=1e-5)
    ei = scene.rod.stiffness[1]
    stiffness = L * np.hypot(forces, 0.5 * WEIGHT) / (ei / L)
    assert np.allclose([scene.statics().margin(x) for x in found.states], stiffness, rtol=1e-4)


def test_a_base_slides_to_where_a_spring_lets_it_be():
    """Along x below the other end of the spring; nothing holds it along z."""
    spring = rod.Spring(point=(0.1, 0.0, L), stiffness=5.0)
    scene = rod.Scene(body(), rod.Base(slides="x"), rod.Gravity((0, 0, 9.81)), spring, nodes=3)
    found = scene.statics().solve()
    assert found.success and found.state[3] == pytest.approx(0.1, abs=1e-9)
    falls = rod.Scene(body(), rod.Base(slides="xz"), rod.Gravity((0, 0, 9.81)), nodes=3).statics().solve()
    assert not falls.success and falls.message == "nothing holds the base: it goes on along slide_z"


def test_motion_ends_where_the_equilibrium_is():
    """A soft rod on a ball joint in a medium under a dead force: both agree, and a run may start at rest there."""
    push, drag = rod.TipWrench(force=(0.02, 0.01, 0.0)), rod.LinearDrag(0.5)
    scene = rod.Scene(body("kirchhoff"), rod.Base(hinge="ball"), rod.Gravity((0, 0, 9.81)), push, drag, nodes=3)
    found = scene.statics().solve()
    assert found.success and found.branch == "settled"
    start = scene.at_rest(np.append(np.zeros(9), [0.2, -0.1, 0.0]), np.zeros(0))
    end = scene.fast_stepper(0.2).run(np.empty((30, 0)), start, check=False)
    assert np.abs(scene.fields(end.x[-1], 3)[:, :3] - scene.fields(found.state, 3)[:, :3]).max() < 1e-3 * L
    still = scene.fast_stepper(0.05).run(np.empty((2, 0)), check=False)
    assert np.abs(still.x[-1] - found.state)[:12].max() < 1e-6
