"""The base: pose, and motion as seen from a frame that moves with it."""

import casadi as ca
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pisplit.models import rod

STEEL = rod.Elastic(207e9, 207e9 / 2.6, 8000.0)
LENGTH = 0.4
TURN = np.array([0.4, -0.9, 0.7])
R0 = Rotation.from_rotvec(TURN).as_matrix()


def body(strains: str = "kirchhoff") -> rod.Rod:
    return rod.Rod(LENGTH, rod.Circle(1e-3), STEEL, strains)


def vector(values: np.ndarray) -> tuple[float, ...]:
    return tuple(np.asarray(values).tolist())


@pytest.mark.parametrize("strains", ["kirchhoff", "cosserat"])
def test_a_turned_base_with_turned_gravity_turns_the_answer(strains: str) -> None:
    g, p0 = np.array([-9.81, 2.0, 1.0]), np.array([0.1, 0.2, 0.3])
    plain = rod.Scene(body(strains), rod.Gravity(vector(g)))
    turned = rod.Scene(body(strains), rod.Gravity(vector(R0 @ g)), rod.Base(position=vector(p0), rotation=vector(TURN)))
    p, R = plain.statics().solve().pose(0.3)
    q, S = turned.statics().solve().pose(0.3)
    assert q == pytest.approx(p0 + R0 @ p, abs=1e-9)
    assert np.abs(S - R0 @ R).max() < 1e-8


def test_a_plane_rod_may_stand_on_a_turned_base() -> None:
    """Horizontal along +x under gravity along -z, as the spatial rod."""
    terms = (rod.Gravity((0.0, 0.0, -9.81)), rod.Base(rotation=(0.0, np.pi / 2.0, 0.0)))
    tips = [rod.Scene(body(s), *terms, nodes=8).statics().solve().tip for s in ("planar", "kirchhoff")]
    assert tips[0] == pytest.approx(tips[1], abs=1e-6)
    assert tips[0][0] > 0.3 and tips[0][2] < -1e-3


def test_follower_loads_turn_with_the_base_and_dead_loads_do_not() -> None:
    for follower in (True, False):
        wrench = rod.TipWrench(force=(1.0, 0.5, 0.0), moment=(0.0, 0.02, 0.03), follower=follower)
        damped = rod.Scene(body(), wrench, rod.Retardation(1.0))  # little damping of the material lets it flutter
        tip = damped.statics().solve().tip
        turned = (damped + rod.Base(rotation=vector(TURN))).statics().solve()
        assert turned.success
        assert np.allclose(turned.tip, R0 @ tip, atol=1e-8) == follower


def test_a_pose_may_be_an_input() -> None:
    scene = rod.Scene(
        body(), rod.Gravity((-9.81, 0.0, 0.0)), rod.Base(position=rod.Input("p", 3), rotation=rod.Input("turn", 3))
    )
    fixed = rod.Scene(body(), rod.Gravity((-9.81, 0.0, 0.0)), rod.Base((0.1, 0.0, 0.2), vector(TURN)))
    assert scene.input_names == ("p[0]", "p[1]", "p[2]", "turn[0]", "turn[1]", "turn[2]")
    found = scene.statics().solve([0.1, 0.0, 0.2, *TURN])
    assert found.tip == pytest.approx(fixed.statics().solve().tip, abs=1e-9)


@pytest.mark.parametrize("strains", ["kirchhoff", "cosserat", "planar"])
def test_an_accelerated_base_is_changed_gravity(strains: str) -> None:
    a = np.array([3.0, 0.0, -2.0])
    damping = rod.KelvinVoigt(bending=1e-4, torsion=1e-4)
    shaken = rod.Scene(body(strains), rod.Gravity((0.0, 0.0, -9.81)), damping, rod.Base(acceleration=rod.Input("a", 3)))
    tilted = rod.Scene(body(strains), rod.Gravity(vector(np.array([0.0, 0.0, -9.81]) - a)), damping)
    rng = np.random.default_rng(0)
    xi = tilted.rest_coordinates + 0.1 * rng.standard_normal(tilted.n_strains)
    xi_t = rng.standard_normal(tilted.n_strains)
    found, expected = shaken.acceleration(xi, xi_t, a), tilted.acceleration(xi, xi_t, [])
    assert np.asarray(found) == pytest.approx(np.asarray(expected), rel=1e-6)


def test_a_spinning_rod_carries_its_centrifugal_force() -> None:
    """Straight along +x, turning about the vertical: n_3 = rho A Omega^2 (L^2 - s^2) / 2, and no moment."""
    omega = 7.0
    scene = rod.Scene(body("cosserat"), rod.Base(rotation=(0.0, np.pi / 2.0, 0.0), spin=(0.0, 0.0, omega)))
    xi, xi_t, xi_tt, u, balance = scene.dynamic_balance
    f = ca.Function(
        "f", [xi, xi_t, xi_tt, u], [balance.elastic_force, balance.motion.acceleration, balance.motion.spin]
    )
    zero = np.zeros(scene.n_strains)
    force, acceleration, spin = (np.asarray(v) for v in f(scene.rest_coordinates, zero, zero, []))
    s = scene.rule.nodes
    exact = scene.rod.mass_per_length * omega**2 * (LENGTH**2 - s**2) / 2.0
    assert force == pytest.approx(np.array([0 * s, 0 * s, exact]), abs=1e-12)
    assert acceleration == pytest.approx(np.array([-(omega**2) * s, 0 * s, 0 * s]), abs=1e-9)
    assert spin == pytest.approx(np.tile([[0.0], [0.0], [omega]], 4), abs=1e-12)


def test_a_base_that_spins_up_pushes_sideways() -> None:
    """Euler acceleration of a straight rod: alpha x p."""
    scene = rod.Scene(body(), rod.Base(spin_rate=(0.0, 5.0, 0.0)))
    xi, xi_t, xi_tt, u, balance = scene.dynamic_balance
    f = ca.Function("f", [xi, xi_t, xi_tt, u], [balance.motion.acceleration])
    zero = np.zeros(scene.n_strains)
    assert np.asarray(f(zero, zero, zero, [])) == pytest.approx(
        np.array([5.0 * scene.rule.nodes, np.zeros(4), np.zeros(4)]), abs=1e-12
    )


def test_fields_are_those_in_the_world() -> None:
    base = rod.Base((0.1, 0.0, 0.0), vector(TURN), velocity=(1.0, 2.0, 3.0), spin=(0.0, 0.0, 2.0))
    scene = rod.Scene(body(), base)
    y = scene.fields(np.zeros(scene.n_states), [0.2, LENGTH])
    for k, s in enumerate((0.2, LENGTH)):
        p = np.array([0.1, 0.0, 0.0]) + R0 @ np.array([0.0, 0.0, s])
        velocity = np.array([1.0, 2.0, 3.0]) + np.cross([0.0, 0.0, 2.0], p - [0.1, 0.0, 0.0])
        assert y[k, :3] == pytest.approx(p, abs=1e-12)
        assert y[k, 3:12].reshape(3, 3) == pytest.approx(R0, abs=1e-11)
        assert R0 @ y[k, 18:21] == pytest.approx(velocity, abs=1e-10)
        assert R0 @ y[k, 21:24] == pytest.approx([0.0, 0.0, 2.0], abs=1e-11)


def test_a_shaken_rod_follows_the_simulation_in_the_frame_of_its_base() -> None:
    """Acceleration of the base as an input against gravity as an input with the other sign."""
    damping = rod.KelvinVoigt(bending=2e-4)
    shaken = rod.Scene(body("planar"), damping, rod.Base(acceleration=rod.Input("a", 3)))
    felt = rod.Scene(body("planar"), damping, rod.Gravity(rod.Input("g", 3)))
    a = np.zeros((20, 3))
    a[:, 0] = 4.0 * np.sin(0.6 * np.arange(1, 21))
    runs = [
        s.simulator(dt=0.02, rtol=1e-6).run(u, np.zeros(s.n_states), check=False) for s, u in ((shaken, a), (felt, -a))
    ]
    assert runs[0].success and runs[1].success
    tips = [run.fields([LENGTH])[:, 0, :3] for run in runs]
    assert np.abs(tips[0][:, 0]).max() > 2e-3
    assert tips[0] == pytest.approx(tips[1], abs=1e-6)


def test_rest_on_an_accelerated_base_is_rest_in_changed_gravity() -> None:
    a = np.array([4.0, -2.0, 1.0])
    mass = rod.PointMass(LENGTH, 0.01, offset=(0.0, 0.01, 0.0))
    carried = rod.Scene(body(), rod.Gravity((0.0, 0.0, -9.81)), mass, rod.Base(acceleration=rod.Input("a", 3)))
    felt = rod.Scene(body(), rod.Gravity(vector(np.array([0.0, 0.0, -9.81]) - a)), mass)
    assert carried.statics().solve(a).tip == pytest.approx(felt.statics().solve().tip, abs=1e-9)


def test_a_towed_rod_leans_back_by_its_drag() -> None:
    """Small constant load c V: c V L^4 / (8 EI)."""
    scene = rod.Scene(body("planar"), rod.Base(velocity=(0.5, 0.0, 0.0)), rod.LinearDrag(2e-3))
    exact = -2e-3 * 0.5 * LENGTH**4 / (8.0 * body().stiffness[1])
    assert scene.statics().solve().tip[0] == pytest.approx(exact, rel=1e-4)


def test_a_rod_that_rests_on_a_turning_base_does_not_accelerate() -> None:
    """Clamped at 30 degrees to a vertical axis of spin under gravity; it leans outwards, and further when faster."""

    def rest(spin: float) -> np.ndarray:
        turning = rod.Base(rotation=(0.0, np.pi / 6.0, 0.0), spin=(0.0, 0.0, spin))
        scene = rod.Scene(body(), rod.Gravity((0.0, 0.0, -9.81)), turning, nodes=6)
        found = scene.statics().solve()
        assert found.success
        rates = np.asarray(scene.acceleration(found.strains, np.zeros(scene.n_strains), []))
        assert np.abs(rates).max() < 1e-6 * scene.rod.bending_rate**2 / LENGTH
        return found.tip

    tips = [rest(spin) for spin in (0.0, 10.0, 20.0)]
    assert tips[0][0] < tips[1][0] < tips[2][0]
    assert np.abs([tip[1] for tip in tips]).max() < 1e-9


def test_one_base_a_scene() -> None:
    with pytest.raises(ValueError, match="one Base"):
        rod.Scene(body(), rod.Base(), rod.Base())
    with pytest.raises(ValueError, match="Base position"):
        rod.Base(position=(0.0, 1.0))
    with pytest.raises(ValueError, match="does not turn"):
        rod.Scene(body(), rod.Base(spin=(0.0, 0.0, 1.0))).coordinates(6)


def test_energies_and_variational_equations_are_for_a_base_that_rests() -> None:
    pose, spinning = rod.Base(rotation=vector(TURN)), rod.Base(spin=(0.0, 0.0, 1.0))
    moving = rod.Scene(body(), rod.Gravity((0.0, 0.0, -9.81)), spinning)
    assert np.isfinite(rod.Scene(body(), pose).energies(np.zeros((1, 24))).total).all()
    for call in (lambda: moving.energies(np.zeros((1, moving.n_states))), moving.variational):
        with pytest.raises(ValueError, match="resting base"):
            call()
