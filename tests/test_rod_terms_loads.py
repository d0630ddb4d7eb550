"""Loads and masses on the rod: closed forms, shooting, and equality with what they amount to."""

import pickle
import re
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from pisplit.models import rod

STEEL = rod.Elastic(207e9, 207e9 / 2.6, 8000.0)
GRAVITY = rod.Gravity((-9.81, 0.0, 0.0))
LENGTH = 0.4


def body(strains: str = "kirchhoff", **options: Any) -> rod.Rod:
    return rod.Rod(LENGTH, rod.Circle(1e-3), STEEL, strains, **options)


def size(scene: rod.Scene) -> tuple[int, int]:
    """Instructions of the static and the dynamic residual."""
    xi, u, static = scene.static_balance
    q, q_t, q_tt, v, moving = scene.dynamic_balance
    functions = [ca.Function("s", [xi, u], [static.residual], {"cse": True})]
    functions.append(ca.Function("d", [q, q_t, q_tt, v], [moving.residual], {"cse": True}))
    return tuple(int(f.n_instructions()) for f in functions)  # type: ignore[return-value]


def swinging(scene: rod.Scene, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Strains and rates of a bent rod in motion."""
    rng = np.random.default_rng(seed)
    n = scene.nodes
    sizes = np.array([1.0, 1.0, 1.0, 1e-2, 1e-2, 1e-2])[list(scene.rod.strain_set.free)]
    xi = scene.rest_coordinates + np.tile(sizes, n) * rng.standard_normal(scene.n_strains)
    return xi, 5.0 * np.tile(sizes, n) * rng.standard_normal(scene.n_strains)


def mass_matrix(scene: rod.Scene, xi: np.ndarray, xi_t: np.ndarray) -> np.ndarray:
    q, q_t, q_tt, u, balance = scene.dynamic_balance
    jacobian = ca.Function("m", [q, q_t, q_tt, u], [ca.jacobian(balance.residual, q_tt)])
    weights = np.repeat(scene.rule.weights, scene.rod.strain_set.n_fields)
    return -weights[:, None] * np.asarray(jacobian(xi, xi_t, 0 * xi, np.zeros(scene.n_inputs)))


def first_rate(scene: rod.Scene) -> float:
    """First natural frequency in rad/s at rest."""
    eigenvalues = scene.linearise(scene.statics().solve().state).eigenvalues
    return float(np.abs(eigenvalues.imag[np.abs(eigenvalues.imag) > 1e-6]).min())


def same_motion(a: rod.Scene, b: rod.Scene, tolerance: float = 1e-9) -> None:
    """Equal static equilibria and equal accelerations in motion."""
    assert a.statics().solve().tip == pytest.approx(b.statics().solve().tip, abs=1e-10)
    xi, xi_t = swinging(a)
    found, expected = np.asarray(a.acceleration(xi, xi_t, [])), np.asarray(b.acceleration(xi, xi_t, []))
    assert np.abs(found - expected).max() <= tolerance * np.abs(expected).max()


# Buoyancy and drag ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("section", [rod.Circle(1e-3), rod.Tapered(rod.Circle(2e-3), rod.Circle(1e-3))])
def test_buoyancy_is_less_gravity(section: Any) -> None:
    backbone = rod.Rod(LENGTH, section, STEEL)
    less = rod.Gravity((-9.81 * (1.0 - 1000.0 / 8000.0), 0.0, 0.0))
    same_motion(rod.Scene(backbone, GRAVITY, rod.Buoyancy(1000.0)), rod.Scene(backbone, less))


def test_the_order_of_terms_does_not_matter_to_what_has_weight() -> None:
    mass = rod.PointMass(0.3, 0.01, offset=(0.0, 0.01, 0.0))
    same_motion(
        rod.Scene(body(), rod.Buoyancy(1000.0), mass, GRAVITY), rod.Scene(body(), GRAVITY, mass, rod.Buoyancy(1000.0))
    )


def test_a_rod_of_the_density_of_its_medium_floats() -> None:
    tip = rod.Scene(body(), GRAVITY, rod.Buoyancy(8000.0)).statics().solve().tip
    assert tip == pytest.approx([0.0, 0.0, LENGTH], abs=1e-14)


@pytest.mark.parametrize("strains", ["kirchhoff", "cosserat", "planar"])
def test_equal_linear_drag_in_all_directions_is_isotropic(strains: str) -> None:
    damping = rod.KelvinVoigt(bending=1e-4, torsion=1e-4)
    same_motion(
        rod.Scene(body(strains), damping, rod.AnisotropicDrag(normal=0.02, tangential=0.02)),
        rod.Scene(body(strains), damping, rod.LinearDrag(0.02)),
    )


def test_drag_of_a_towed_rod_is_that_of_its_two_directions() -> None:
    """A straight rod towed with (V_x, 0, V_z) feels -(c + d |V|) V across and along it."""
    v_x, v_z = 0.7, -1.3
    drag = rod.AnisotropicDrag(normal=0.3, tangential=0.02, normal_quadratic=0.5, tangential_quadratic=0.04)
    scene = rod.Scene(body(), rod.Base(velocity=(v_x, 0.0, v_z)), drag)
    xi, xi_t, xi_tt, u, balance = scene.dynamic_balance
    force = ca.Function("f", [xi, xi_t, xi_tt, u], [balance.loads.force])
    zero = np.zeros(scene.n_strains)
    expected = np.array([-(0.3 + 0.5 * v_x) * v_x, 0.0, -(0.02 + 0.04 * abs(v_z)) * v_z])
    assert np.asarray(force(zero, zero, zero, [])) == pytest.approx(np.tile(expected[:, None], 4), abs=1e-9)


# Loads per length ----------------------------------------------------------------------------------------------------


def test_a_dead_load_per_length_is_a_weight() -> None:
    load = (0.3, -0.2, 0.1)
    weight = rod.Gravity(tuple(np.array(load) / body().mass_per_length))
    same_motion(rod.Scene(body(), rod.DistributedWrench(force=load)), rod.Scene(body(), weight))
    scene = rod.Scene(body(), rod.DistributedWrench(force=rod.Input("f", 3)))
    fixed = rod.Scene(body(), rod.DistributedWrench(force=lambda s: load))
    assert scene.statics().solve(load).tip == pytest.approx(fixed.statics().solve().tip, abs=1e-12)


def test_a_triangular_load_bends_as_in_the_tables() -> None:
    """q0 (1 - s/L) on a cantilever: q0 L^4 / (30 EI)."""
    q0 = 1e-4
    scene = rod.Scene(
        body("planar"), rod.DistributedWrench(force=lambda s: (q0 * (1.0 - s / LENGTH), 0.0, 0.0)), nodes=6
    )
    assert scene.statics().solve().tip[0] == pytest.approx(q0 * LENGTH**4 / (30.0 * body().stiffness[1]), rel=1e-6)


def test_a_moment_per_length_turns_the_tip() -> None:
    """theta(L) = l L^2 / (2 EI) for a constant moment per length."""
    scene = rod.Scene(body(), rod.DistributedWrench(moment=(0.0, 0.8, 0.0)))
    _, R = scene.statics().solve().pose(LENGTH)
    assert np.arctan2(R[0, 2], R[2, 2]) == pytest.approx(0.8 * LENGTH**2 / (2.0 * body().stiffness[1]), rel=1e-9)


@pytest.mark.parametrize(("strains", "tolerance"), [("planar", 1e-7), ("kirchhoff", 2e-5)])
def test_a_follower_pressure_on_one_side_agrees_with_integration_from_the_tip(strains: str, tolerance: float) -> None:
    """q along body axis 1: in the frame of the tip the free end is an initial value, no shooting needed."""
    backbone = body(strains)
    ei = backbone.stiffness[1]
    q = 12.0 * ei / LENGTH**3

    def fun(s: float, y: np.ndarray) -> list[float]:
        theta, moment, n_x, n_z = y[:4]
        c, sine = np.cos(theta), np.sin(theta)
        return [moment / ei, -(c * n_x - sine * n_z), -q * c, q * sine, sine, c]

    y = solve_ivp(fun, (LENGTH, 0.0), np.zeros(6), rtol=1e-11, atol=1e-13).y[:, -1]
    turn, x, z = -y[0], -y[4], -y[5]
    exact = np.array([np.cos(turn) * x + np.sin(turn) * z, 0.0, -np.sin(turn) * x + np.cos(turn) * z])
    load = rod.DistributedWrench(force=(q, 0.0, 0.0), follower=True)
    solved = rod.Scene(backbone, load, nodes=12).statics().solve()
    assert solved.success and abs(turn) > 1.5
    assert solved.tip == pytest.approx(exact, abs=tolerance * LENGTH)


# Points --------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("follower", [False, True])
def test_a_wrench_at_the_last_point_is_a_tip_wrench(follower: bool) -> None:
    force, moment = (0.5, -0.2, 0.1), (0.01, 0.02, -0.01)
    same_motion(
        rod.Scene(body(), rod.PointWrench(LENGTH, force, moment, follower)),
        rod.Scene(body(), rod.TipWrench(force, moment, follower)),
    )


def test_a_force_within_the_rod_deflects_it_as_in_the_tables() -> None:
    """F a^2 (3 L - a) / (6 EI) at the tip, exact with an element that ends at a; close to it without."""
    a, force = 0.25, 1e-3
    exact = force * a**2 * (3.0 * LENGTH - a) / (6.0 * body().stiffness[1])
    split = body("planar", elements=(a, LENGTH - a))
    load = rod.PointWrench(a, (force, 0.0, 0.0))
    assert rod.Scene(split, load, nodes=3).statics().solve().tip[0] == pytest.approx(exact, rel=1e-6)
    assert rod.Scene(body("planar"), load, nodes=8).statics().solve().tip[0] == pytest.approx(exact, rel=5e-3)


def test_a_follower_at_a_border_is_the_tip_of_a_shorter_rod() -> None:
    a = 0.25
    short = rod.Rod(a, rod.Circle(1e-3), STEEL)
    tip = rod.Scene(short, rod.TipWrench((2.0, 1.0, 0.0), (0.0, 0.02, 0.05), True), nodes=6).statics().solve().tip
    whole = rod.Scene(
        body(elements=(a, LENGTH - a)), rod.PointWrench(a, (2.0, 1.0, 0.0), (0.0, 0.02, 0.05), True), nodes=(6, 3)
    )
    assert whole.statics().solve().pose(a)[0] == pytest.approx(tip, abs=1e-9)


@pytest.mark.parametrize("s", [0.17, 0.25, 0.3, LENGTH])
def test_the_work_of_a_force_is_that_on_the_interpolated_point(s: float) -> None:
    """Weighted internal moment at the nodes = gradient of F . p(s) by the strains: the load is the exact adjoint."""
    force = np.array([0.7, 0.0, -0.4])
    scene = rod.Scene(body("planar", elements=(0.25, 0.15)), rod.PointWrench(s, tuple(force)), nodes=(4, 3))
    xi, u, balance = scene.static_balance
    elastic = scene.rod.stiffness[1] * xi
    work = ca.gradient(ca.dot(ca.DM(force), balance.motion.position_at([s])), xi)
    both = ca.Function("g", [xi, u], [(balance.residual + elastic) * ca.DM(scene.rule.weights), work])
    load, gradient = both(3.0 * np.random.default_rng(1).standard_normal(7), [])
    assert np.asarray(load) == pytest.approx(np.asarray(gradient), abs=1e-15)


def test_a_spring_pulls_with_its_stretch() -> None:
    point, k, rest = np.array([0.15, 0.1, 0.3]), 8.0, 0.05
    solved = rod.Scene(body(), rod.Spring(tuple(point), k, rest)).statics().solve()
    way = point - solved.tip
    force = k * (np.linalg.norm(way) - rest) * way / np.linalg.norm(way)
    assert solved.success
    dead = rod.Scene(body(), rod.TipWrench(force=tuple(force))).statics().solve(guess=solved.strains)
    assert solved.tip == pytest.approx(dead.tip, abs=1e-9)


def test_a_spring_within_the_rod_is_the_force_at_its_place() -> None:
    backbone, k, point = body(elements=(0.25, 0.15)), 5.0, np.array([0.2, -0.1, 0.3])
    solved = rod.Scene(backbone, rod.Spring(rod.Input("p", 3), k, s=0.25)).statics().solve(point)
    force = k * (point - solved.pose(0.25)[0])
    assert solved.success and abs(solved.tip[0]) > 1e-2
    dead = rod.Scene(backbone, rod.PointWrench(0.25, tuple(force))).statics().solve(guess=solved.strains)
    assert solved.tip == pytest.approx(dead.tip, abs=1e-9)


def test_a_mass_at_the_tip_swings_at_the_exact_frequency() -> None:
    """1 + cos b cosh b + mu b (cos b sinh b - sin b cosh b) = 0, omega = (b/L)^2 sqrt(EI / rho A) (Euler-Bernoulli)."""
    backbone = body("planar")
    rod_mass = backbone.mass_per_length * LENGTH
    for ratio in (0.2, 1.0, 5.0):

        def characteristic(b: float, mu: float = ratio) -> float:
            swing = np.cos(b) * np.sinh(b) - np.sin(b) * np.cosh(b)
            return float(1.0 + np.cos(b) * np.cosh(b) + mu * b * swing)

        b = brentq(characteristic, 0.1, 1.9)
        exact = b**2 * np.sqrt(backbone.stiffness[1] / (backbone.mass_per_length * LENGTH**4))
        scene = rod.Scene(backbone, rod.PointMass(LENGTH, ratio * rod_mass), nodes=8)
        assert first_rate(scene) == pytest.approx(exact, rel=1e-5)


def test_a_disc_twists_at_the_exact_frequency() -> None:
    """b tan b = rho J L / J_disc with omega = b / L sqrt(G / rho) for the torsion of a shaft with a disc."""
    disc = rod.PointMass.disc(LENGTH, mass=0.02, radius=0.01)
    backbone = rod.Rod(LENGTH, rod.Circle(1e-3), STEEL, rod.StrainSet("torsion", (2,)))
    ratio = backbone.inertia_per_length[2] * LENGTH / disc.inertia[2]
    b = brentq(lambda b: b * np.tan(b) - ratio, 1e-6, 1.5)
    exact = b / LENGTH * np.sqrt(STEEL.shear / STEEL.density)
    assert first_rate(rod.Scene(backbone, disc, nodes=5)) == pytest.approx(exact, rel=1e-6)


def test_weight_of_a_mass_is_a_wrench_at_its_place() -> None:
    mass, a, arm = 0.02, 0.25, 0.03
    backbone = body(elements=(a, LENGTH - a))
    heavy = rod.Scene(backbone, rod.Gravity((0.0, 0.0, -9.81)), rod.PointMass(a, mass, offset=(arm, 0.0, 0.0)))
    plain = rod.Scene(backbone, rod.Gravity((0.0, 0.0, -9.81)))
    solved = heavy.statics().solve()
    R = solved.pose(a)[1]
    weight = np.array([0.0, 0.0, -9.81 * mass])
    moment = np.cross(R @ np.array([arm, 0.0, 0.0]), weight)
    assert solved.success and solved.tip[0] > 1e-3
    same = (plain + rod.PointWrench(a, tuple(weight), tuple(moment))).statics().solve(guess=solved.strains)
    assert solved.tip == pytest.approx(same.tip, abs=1e-8)


@pytest.mark.parametrize("strains", ["planar", "kirchhoff", "cosserat"])
@pytest.mark.parametrize("s", [0.17, 0.25, LENGTH])
def test_masses_keep_the_mass_matrix_symmetric_and_positive(strains: str, s: float) -> None:
    offset = (0.02, 0.0, 0.01) if strains == "planar" else (0.02, -0.01, 0.01)
    mass = rod.PointMass(s, 0.05, inertia=(1e-5, 2e-5, 3e-5), offset=offset)
    bare = rod.Scene(body(strains, elements=(0.25, 0.15)), nodes=(3, 2))
    m, plain = (mass_matrix(scene, *swinging(bare)) for scene in (bare + mass, bare))
    assert np.abs(m - m.T).max() <= 1e-12 * np.abs(m).max()
    added = np.linalg.eigvalsh(0.5 * (m + m.T) - plain)
    assert added.min() >= -1e-12 * added.max()
    assert np.linalg.matrix_rank(m - plain, tol=1e-10 * added.max()) <= 6


def test_a_heavy_tip_moves_through_the_simulator() -> None:
    """One period of a small swing comes back to its start."""
    scene = rod.Scene(body("planar"), rod.PointMass(LENGTH, 0.02), nodes=4)
    period = 2.0 * np.pi / first_rate(scene)
    start = (scene + rod.TipWrench(force=(1e-3, 0.0, 0.0))).statics().solve().state
    trajectory = scene.simulator(dt=period / 16.0, rtol=1e-6).run(np.zeros((16, 0)), x0=start, check=False)
    tips = trajectory.fields([LENGTH])[:, 0, 0]
    assert trajectory.success
    assert tips[8] == pytest.approx(-tips[0], rel=1e-2)
    assert tips[16] == pytest.approx(tips[0], rel=1e-2)


# Pressure ------------------------------------------------------------------------------------------------------------


def test_a_pressure_chamber_bends_the_rod_into_an_arc() -> None:
    """EI k = -p A r: constant curvature away from the chamber; EA e = p A where the rod stretches."""
    area, offset, pressure = 4e-6, 3e-3, 2e5
    for strains in ("kirchhoff", "cosserat", "planar"):
        scene = rod.Scene(body(strains), rod.Chambers(area, [[offset, 0.0]]))
        solved = scene.statics().solve([pressure])
        k = -pressure * area * offset / scene.rod.stiffness[1]
        stretch = 1.0 + (pressure * area / scene.rod.stiffness[5] if strains == "cosserat" else 0.0)
        exact = stretch * np.array([(1.0 - np.cos(k * LENGTH)) / k, 0.0, np.sin(k * LENGTH) / k])
        assert exact[0] < -1e-3
        assert solved.tip == pytest.approx(exact, abs=1e-9)


def test_chambers_in_balance_only_stretch() -> None:
    scene = rod.Scene(body("cosserat"), rod.Chambers.parallel(4e-6, 3e-3, (0, 120, 240)))
    exact = LENGTH * (1.0 + 3.0 * 2e5 * 4e-6 / scene.rod.stiffness[5])
    assert scene.statics().solve([2e5] * 3).tip == pytest.approx([0.0, 0.0, exact], abs=1e-12)


def test_chambers_that_end_bend_the_rod_up_to_there() -> None:
    backbone = body(elements=(0.25, 0.15))
    strains = rod.Scene(backbone, rod.Chambers(4e-6, [[3e-3, 0.0]], end=0.25), nodes=3).statics().solve([2e5]).strains
    k = -2e5 * 4e-6 * 3e-3 / backbone.stiffness[1]
    assert strains.reshape(-1, 3)[:, 1] == pytest.approx(np.r_[np.full(3, k), np.zeros(3)], abs=1e-9)
    with pytest.raises(ValueError, match="elements"):
        rod.Scene(backbone, rod.Chambers(4e-6, [[3e-3, 0.0]], end=0.2))


# Damping in proportion to stiffness ----------------------------------------------------------------------------------


def test_retardation_is_kelvin_voigt_of_the_stiffness() -> None:
    k = body("cosserat").stiffness
    explicit = rod.KelvinVoigt(1e-3 * k[0], 1e-3 * k[2], 1e-3 * k[3], 1e-3 * k[5])
    same_motion(rod.Scene(body("cosserat"), rod.Retardation(1e-3)), rod.Scene(body("cosserat"), explicit))
    assert rod.Scene(body("cosserat"), rod.Retardation(1e-3)).damped


def test_every_mode_of_a_retarded_tapered_rod_decays_by_half_of_time_omega_squared() -> None:
    """q'' + T w^2 q' + w^2 q = 0 for each mode, whatever the section."""
    taper = rod.Rod(LENGTH, rod.Tapered(rod.Circle(2e-3), rod.Circle(1e-3)), STEEL, "planar")
    undamped = rod.Scene(taper, nodes=6)
    damped = undamped + rod.Retardation(1e-5)
    rates, decays = (s.linearise(np.zeros(s.n_states)).eigenvalues for s in (undamped, damped))
    omega, slow = np.sort(rates.imag[rates.imag > 0])[:3], decays[decays.imag > 0]
    slow = slow[np.argsort(slow.imag)][:3]
    assert -slow.real == pytest.approx(0.5e-5 * omega**2, rel=1e-4)


# What is not there ---------------------------------------------------------------------------------------------------

EXTRA: tuple[Any, ...] = (
    rod.Buoyancy(1000.0),
    rod.AnisotropicDrag(normal=0.1, tangential_quadratic=0.1),
    rod.DistributedWrench(force=(0.1, 0.0, 0.0)),
    rod.PointWrench(0.2, (0.1, 0.0, 0.0)),
    rod.Spring((0.1, 0.0, 0.3), 5.0),
    rod.PointMass(0.2, 0.01),
    rod.Chambers(1e-6, [[0.01, 0.0]]),
    rod.Retardation(1e-3),
    rod.Base(position=(0.1, 0.0, 0.0), spin=(0.0, 0.0, 1.0)),
)


@pytest.mark.parametrize("term", EXTRA, ids=lambda t: type(t).__name__)
def test_terms_taken_out_leave_nothing_behind(term: Any) -> None:
    plain = rod.Scene(body(), GRAVITY)
    whole = plain + term
    assert size(whole - term) == size(plain)
    assert size(whole)[1] >= size(plain)[1]
    assert (whole - term).n_inputs == plain.n_inputs
    assert type(term).__name__ and whole.terms[1].describe(plain.rod)


def test_terms_without_effect_leave_no_node() -> None:
    plain = rod.Scene(body(), GRAVITY)
    for term in (rod.DistributedWrench(), rod.PointWrench(0.2), rod.Base(), rod.AnisotropicDrag()):
        assert size(plain + term) == size(plain), term
    for term in (rod.PointMass(0.2, 0.01, inertia=(1e-6, 1e-6, 1e-6)), rod.AnisotropicDrag(normal=1.0)):
        no_gravity = rod.Scene(body())
        assert size(no_gravity + term)[0] == size(no_gravity)[0], term  # nothing of the motion in statics


@pytest.mark.parametrize(
    ("build", "part"),
    [
        (lambda: rod.Scene(body(), rod.PointMass(0.5, 1.0)), "0.5"),
        (lambda: rod.Scene(body(), rod.PointWrench(0.41)), "0.41"),
        (lambda: rod.Scene(body(), rod.Spring((0, 0, 0), 1.0, s=-0.1)), "Spring"),
        (lambda: rod.PointMass(0.1, -1.0), "mass"),
        (lambda: rod.PointMass(0.1, 1.0, inertia=(0.0, -1.0, 0.0)), "inertia"),
        (lambda: rod.Buoyancy(-1.0), "density"),
        (lambda: rod.AnisotropicDrag(normal=-1.0), "normal"),
        (lambda: rod.DistributedWrench(force=(1.0, 2.0)), "force"),
        (lambda: rod.Scene(body(), rod.DistributedWrench(force=lambda s: (1.0,))), "force"),
        (lambda: rod.Chambers(0.0, [[0.01, 0.0]]), "area"),
        (lambda: rod.Scene(body("planar"), rod.Chambers(1e-6, [[0.0, 0.01]])), "planar"),
        (lambda: rod.Scene(body(), *[rod.Chambers(1e-6, [[0.0, 0.01]])] * 2), "pressures"),
    ],
)
def test_what_does_not_fit_is_refused_in_one_line(build: Any, part: str) -> None:
    with pytest.raises(ValueError, match=part) as caught:
        build()
    assert "\n" not in str(caught.value)


# A user's own term ---------------------------------------------------------------------------------------------------


def documented(part: str) -> str:
    """The block of the documentation that contains a text."""
    text = (Path(__file__).parents[1] / "docs" / "rod.md").read_text()
    return next(block for block in re.findall(r"```python\n(.*?)```", text, re.S) if part in block)


def test_the_varying_rod_of_the_documentation_bends_swings_and_is_copied() -> None:
    names: dict[str, Any] = {"rod": rod}
    exec(documented("Tapered"), names)
    finger, bent = names["finger"], names["bent"]
    assert bent.success and bent.tensions.shape == (3,) and np.linalg.norm(bent.tip[:2]) > 0.05
    assert pickle.loads(pickle.dumps(finger)) == finger
    commands = np.linspace(bent.state[-3:], [0.0, 0.0, 0.0], 6)
    trajectory = finger.simulator(dt=0.03).run(commands, x0=bent.state, check=False)
    assert trajectory.success and np.all(np.isfinite(trajectory.fields(4)))


def test_the_term_of_the_documentation_is_the_wrench_it_computes() -> None:
    code = documented("class TipMagnet")
    assert len(code.strip().splitlines()) < 30
    arm = rod.Scene(body(), GRAVITY)
    names: dict[str, Any] = {"arm": arm, "__name__": "docs"}
    exec(code, names)
    magnet, scene = names["TipMagnet"]((0.1, 0.0, 0.7), 0.05), names["scene"]
    solved = scene.statics().solve()
    force = magnet.stiffness * (np.array(magnet.point) - solved.tip)
    same = (arm + rod.TipWrench(force=tuple(force))).statics().solve()
    assert solved.success and "magnet" in str(scene)
    assert solved.tip == pytest.approx(same.tip, abs=1e-9)
    same_motion(scene, arm + rod.Spring((0.1, 0.0, 0.7), 0.05))


def test_masses_elements_and_rest_curvature_keep_the_energy() -> None:
    """Variational equations in fixed steps on a stepped, curved rod with a rigid body off its axis, undamped."""
    sections = (rod.Circle(2e-3), rod.Tube(1.5e-3, 1e-3))
    backbone = rod.Rod(0.3, sections, rod.Elastic(2e8, 7e7, 1200.0), "kirchhoff", (0.0, 1.0, 0.5), (0.2, 0.1))
    mass = rod.PointMass(0.2, 2e-3, (1e-7, 1e-7, 2e-7), (4e-3, 2e-3, 1e-3))
    scene = rod.Scene(backbone, GRAVITY, mass, nodes=(3, 2))
    pull = rod.TipWrench(force=(0.0, 2.0 * backbone.stiffness[0] / 0.09, 0.0))
    start = (scene + pull).statics().solve().state
    period = 2.0 * np.pi / backbone.bending_rate
    run = scene.stepper(dt=period / 40.0, step=period / 400.0).run(np.zeros((60, 0)), x0=start, check=False)
    energy = scene.variational().energies(run.x)
    assert run.success
    assert np.ptp(energy.total) <= 1e-3 * np.ptp(energy.kinetic)
