"""Every term against its formula: numbers and signs of the loads on a given shape, and closed forms of what they do."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import quad
from scipy.spatial.transform import Rotation

from pisplit.models import rod
from pisplit.models.calibration import CalibratedTendons, TendonParameters
from pisplit.models.rod.kinematics.rotations import compose, exponential, rotation_matrix
from pisplit.models.rod.terms.routing import sample

STEEL = rod.Elastic(207e9, 207e9 / 2.6, 8000.0)
LENGTH, RADIUS = 0.4, 1e-3
AREA, SECOND = np.pi * RADIUS**2, np.pi * RADIUS**4 / 4.0
EI, GJ, EA, GA = 207e9 * SECOND, 207e9 / 2.6 * 2.0 * SECOND, 207e9 * AREA, 207e9 / 2.6 * AREA


def body(strains: str = "cosserat", **options: Any) -> rod.Rod:
    return rod.Rod(LENGTH, rod.Circle(RADIUS), STEEL, strains, **options)


def loads_of(
    term: Any,
    w: Any = (0, 0, 0),
    v: Any = (0, 0, 1),
    w_t: Any = (0, 0, 0),
    v_t: Any = (0, 0, 0),
    u: Any = (),
    **more: Any,
) -> dict[str, np.ndarray]:
    """Loads of a term on a Cosserat rod of three nodes with the same strains and rates everywhere."""
    scene = rod.Scene(more.pop("body", body()), *more.pop("beside", ()), term, nodes=3)
    x, x_t, x_tt, inputs, balance = scene.dynamic_balance
    loads = balance.loads
    names = ("force", "moment", "tip_force", "tip_moment", "stress_w", "stress_v", "point_force", "point_inertia")
    f = ca.Function("loads", [x, x_t, x_tt, inputs], [getattr(loads, n) for n in names])
    given = [np.tile([*a, *b], 3).astype(float) for a, b in ((w, v), (w_t, v_t), ((0, 0, 0), (0, 0, 0)))]
    return dict(zip(names, (np.asarray(a) for a in f(*given, np.asarray(u, float))), strict=True))


def everywhere(column: Any) -> np.ndarray:
    return np.tile(np.asarray(column, float)[:, None], 3)


# Weight and drag -----------------------------------------------------------------------------------------------------


def test_gravity_pulls_with_the_mass_and_the_medium_lifts_by_its_own() -> None:
    g = np.array([1.0, -2.0, 3.0])
    assert loads_of(rod.Gravity(g))["force"] == pytest.approx(everywhere(8000.0 * AREA * g))
    wet = loads_of(rod.Buoyancy(1000.0), beside=(rod.Gravity(g),))
    assert wet["force"] == pytest.approx(everywhere(7000.0 * AREA * g))


@pytest.mark.parametrize("strains", ["planar", "kirchhoff"])
def test_a_cantilever_sags_by_its_weight_the_way_of_gravity(strains: str) -> None:
    """rho A g L^4 / (8 EI), for a small g."""
    g = -1e-2
    tip = rod.Scene(body(strains), rod.Gravity((g, 0.0, 0.0)), nodes=5).statics().solve().tip
    assert tip[0] == pytest.approx(8000.0 * AREA * g * LENGTH**4 / (8.0 * EI), rel=1e-6)


def test_drag_is_against_the_motion_and_grows_as_it_says() -> None:
    velocity = np.array([0.3, -0.4, 1.2])
    towed = (rod.Base(velocity=tuple(velocity)),)
    assert loads_of(rod.LinearDrag(0.7), beside=towed)["force"] == pytest.approx(everywhere(-0.7 * velocity))
    assert loads_of(rod.QuadraticDrag(0.7), beside=towed)["force"] == pytest.approx(everywhere(-0.7 * 1.3 * velocity))
    drag = rod.AnisotropicDrag(0.2, 0.03, 0.5, 0.07)
    across, along = (0.2 + 0.5 * 0.5) * velocity[:2], (0.03 + 0.07 * 1.2) * velocity[2]
    assert loads_of(drag, beside=towed)["force"] == pytest.approx(everywhere([*-across, -along]))


# Damping -------------------------------------------------------------------------------------------------------------


def test_damping_resists_every_strain_rate_by_its_own_coefficient() -> None:
    rates = {"w_t": (2.0, 3.0, 5.0), "v_t": (7.0, 11.0, 13.0)}
    found = loads_of(rod.KelvinVoigt(bending=0.1, torsion=0.2, shear=0.3, stretch=0.4), **rates)
    assert found["stress_w"] == pytest.approx(everywhere([0.2, 0.3, 1.0]))
    assert found["stress_v"] == pytest.approx(everywhere([2.1, 3.3, 5.2]))
    slow = loads_of(rod.Retardation(0.01), **rates)
    assert slow["stress_w"] == pytest.approx(everywhere(0.01 * np.array([2.0 * EI, 3.0 * EI, 5.0 * GJ])))
    assert slow["stress_v"] == pytest.approx(everywhere(0.01 * np.array([7.0 * GA, 11.0 * GA, 13.0 * EA])))


# Tendons -------------------------------------------------------------------------------------------------------------


def test_the_tension_of_a_displaced_tendon_is_its_strain_over_its_compliance() -> None:
    drive = rod.Displacement(compliance=2e-3, slack_smoothing=1e-3)
    taut = float(drive.tension(ca.SX(0.51), 0.5, ca.SX(0.02)))
    assert taut == pytest.approx((0.51 - 0.48) / (2e-3 * 0.48), rel=1e-12)
    assert float(drive.tension(ca.SX(0.47), 0.5, ca.SX(0.02))) == pytest.approx(0.0, abs=1e-300)
    assert float(drive.unstretched(ca.SX(0.51), 0.5, ca.SX(0.02))) == pytest.approx(0.48)
    assert float(rod.Tension().tension(ca.SX(0.51), 0.5, ca.SX(3.0))) == 3.0
    assert float(rod.Tension().unstretched(ca.SX(0.51), 0.5, ca.SX(3.0))) == 0.51
    loose = rod.Displacement(compliance=2e-3)
    assert float(loose.tension(ca.SX(0.48), 0.5, ca.SX(0.02))) == pytest.approx(1e-5 / 2e-3 * np.log(2.0), rel=1e-12)


@pytest.mark.parametrize("strains", ["planar", "kirchhoff"])
def test_a_pulled_tendon_bends_the_rod_towards_itself_into_an_arc(strains: str) -> None:
    """tau = u / (c (L - u) + r^2 L / EI), curvature tau r / EI; the tendon on the other side hangs loose."""
    c, r, u = 1e-4, 0.012, 8e-3
    tendons = rod.Tendons([[r, 0.0], [-r, 0.0]], rod.Displacement(c, slack_smoothing=1e-4))
    solved = rod.Scene(body(strains), tendons, nodes=3).statics().solve([u, -1e-2])
    tension = u / (c * (LENGTH - u) + r**2 * LENGTH / EI)
    k = tension * r / EI
    assert solved.tensions == pytest.approx([tension, 0.0], rel=1e-9, abs=1e-9)
    assert solved.tip == pytest.approx([(1.0 - np.cos(k * LENGTH)) / k, 0.0, np.sin(k * LENGTH) / k], rel=1e-7)


@pytest.mark.parametrize(
    "route", [rod.Line((0.015, 0.004), (0.004, -0.003), LENGTH), rod.Helix(0.012, 0.3, 0.5)], ids=["line", "helix"]
)
def test_a_tendon_pulls_along_its_own_path(route: rod.Line | rod.Helix) -> None:
    """On any strains: force tau t and moment tau r x t with t along v + w x r + r', and its length int |a| ds."""
    w, v, tension = np.array([2.0, -1.0, 3.0]), np.array([0.02, -0.01, 1.05]), 4.0
    found = loads_of(rod.Tendons([route]), w=w, v=v, u=[tension])
    for k, s in enumerate(rod.Scene(body(), nodes=3).rule.nodes):
        h = 1e-6
        slope = (np.array(route(s + h)) - np.array(route(s - h))) / (2.0 * h)
        r, dr = np.array([*route(s), 0.0]), np.array([*slope, 0.0])
        a = v + np.cross(w, r) + dr
        pull = tension * a / np.linalg.norm(a)
        assert found["stress_v"][:, k] == pytest.approx(pull, rel=1e-8, abs=1e-9)
        assert found["stress_w"][:, k] == pytest.approx(np.cross(r, pull), rel=1e-7, abs=1e-9)


def test_routes_are_where_they_say() -> None:
    helix = rod.Helix(0.01, 0.2, 0.3)
    for s in (0.0, 0.07, 0.2):
        angle = 2.0 * np.pi * s / 0.2 + 0.3
        assert helix(s) == pytest.approx((0.01 * np.cos(angle), 0.01 * np.sin(angle)))
        turn = 0.01 * 2.0 * np.pi / 0.2
        assert helix.slope(s) == pytest.approx((-turn * np.sin(angle), turn * np.cos(angle)))
    line = rod.Line((0.01, 0.02), (0.03, -0.02), 0.4)
    assert line(0.1) == pytest.approx((0.015, 0.01)) and line.slope(0.3) == pytest.approx((0.05, -0.1))
    tendons = rod.Tendons.converging(0.02, 0.005, LENGTH, (0, 90), rod.Tension())
    assert tendons.points(0.0, LENGTH) == pytest.approx(np.array([[0.02, 0.0], [0.0, 0.02]]))
    assert tendons.points(LENGTH, LENGTH) == pytest.approx(np.array([[0.005, 0.0], [0.0, 0.005]]))
    turning = rod.Tendons.helical(0.01, 0.4, (0, 90), rod.Tension())
    assert turning.points(0.1, LENGTH) == pytest.approx(np.array([[0.0, 0.01], [-0.01, 0.0]]))
    cubic = sample(lambda s: (s**3, 1.0 - 2.0 * s**4), np.array([0.0, 0.1, LENGTH]), LENGTH)
    assert cubic[1] == pytest.approx(
        np.array([[0.0, 0.03, 3.0 * LENGTH**2], [0.0, -8e-3, -8.0 * LENGTH**3], [0.0] * 3]), abs=1e-9
    )


@pytest.mark.parametrize("mu", [0.2, 0.5])
def test_the_stretch_of_a_tendon_with_friction_is_that_of_its_mean_tension(mu: float) -> None:
    """tau_0 int exp(-mu theta) ds / L = (l - l*) / (c l*), by quadrature along the shape that was found."""
    c, r, u = 1e-4, 0.012, 1.5e-2
    scene = rod.Scene(
        body("planar"), rod.Tendons([[r, 0.0]], rod.Displacement(c, slack_smoothing=1e-6), friction=mu), nodes=8
    )
    solved = scene.statics().solve([u])
    rule = scene.rule

    def turned(s: float) -> float:
        return float(rule.integrate_to([s])[0] @ solved.strains)

    mean = quad(lambda s: np.exp(-mu * turned(s)), 0.0, LENGTH)[0] / LENGTH
    length, unstretched = LENGTH - r * turned(LENGTH), LENGTH - u
    assert solved.success and mean < 0.95
    assert solved.tensions[0] * mean == pytest.approx((length - unstretched) / (c * unstretched), rel=1e-3)
    assert solved.tensions[0] == pytest.approx(
        solved.strains[0] * EI / r * np.exp(mu * turned(rule.nodes[0])), rel=2e-3
    )


def test_identified_tendons_pull_as_their_parameters_say() -> None:
    """Hooke's law of what is not pulled in; factors of stiffness and damping; a mass that weighs."""
    told = TendonParameters(
        offset=np.array([[0.012, 0.003]]),
        stiffness=np.array([2e4]),
        slack=np.array([3e-3]),
        rounding=1e-6,
        shift=np.array([[-0.004, 0.002]]),
        bending=1.3,
        damping=0.6,
        tip_mass=0.02,
    )
    viscous = rod.KelvinVoigt(bending=0.1, torsion=0.2)
    term = CalibratedTendons(1, 0.015, tuple(told.vector(0.015).tolist()), viscous)
    w, v, rate, u = np.array([0.5, -1.0, 2.0]), np.array([0.0, 0.0, 1.01]), np.array([2.0, 3.0, 5.0]), 4e-3
    gravity = np.array([-9.81, 0.0, 0.0])
    found = loads_of(term, w=w, v=v, w_t=rate, u=[u], beside=(rod.Gravity(gravity),))
    rule = rod.Scene(body(), nodes=3).rule
    shift = np.array([-0.004, 0.002, 0.0])
    a = [v + np.cross(w, np.array([0.012, 0.003, 0.0]) + s / LENGTH * shift) + shift / LENGTH for s in rule.nodes]
    shortened = 3e-3 + u
    stretch = np.linalg.norm(a, axis=1) @ rule.weights - np.hypot(LENGTH, np.linalg.norm(shift)) + shortened
    tension = 2e4 * LENGTH / (LENGTH - shortened) * stretch
    assert tension > 10.0
    for k, s in enumerate(rule.nodes):
        r = np.array([0.012, 0.003, 0.0]) + s / LENGTH * shift
        pull = tension * a[k] / np.linalg.norm(a[k])
        own = 0.3 * np.array([EI, EI, GJ]) * w - 0.4 * np.array([0.1, 0.1, 0.2]) * rate
        assert found["stress_v"][:, k] == pytest.approx(pull, rel=1e-9)
        assert found["stress_w"][:, k] == pytest.approx(np.cross(r, pull) + own, rel=1e-9)
    assert found["tip_force"].ravel() == pytest.approx(0.02 * gravity)
    assert term.points(LENGTH, LENGTH) == pytest.approx(np.array([[0.008, 0.005]]))


# Chambers, springs, bodies -------------------------------------------------------------------------------------------


def test_a_chamber_pushes_with_pressure_times_area() -> None:
    """-p A e3 at its centre (x, y): force -p A e3 and moment -p A (y, -x, 0)."""
    found = loads_of(rod.Chambers(3e-6, [[0.01, 0.02]]), w=(1.0, 2.0, 3.0), u=[1e5])
    assert found["stress_v"] == pytest.approx(everywhere([0.0, 0.0, -0.3]))
    assert found["stress_w"] == pytest.approx(everywhere([-0.3 * 0.02, 0.3 * 0.01, 0.0]))


@pytest.mark.parametrize("rest", [0.0, 0.1, 0.9])
def test_a_spring_pulls_when_it_is_stretched_and_pushes_when_it_is_short(rest: float) -> None:
    point = np.array([0.3, 0.0, 0.8])
    way = point - [0.0, 0.0, LENGTH]
    force = 5.0 * (np.linalg.norm(way) - rest) * way / np.linalg.norm(way)
    assert loads_of(rod.Spring(point, 5.0, rest))["tip_force"].ravel() == pytest.approx(force)


def test_a_disc_has_the_inertia_of_a_cylinder() -> None:
    """By quadrature over its volume: radius for the turn about its axis, radius and thickness for that across."""
    mass, radius, thickness = 0.3, 0.02, 0.05
    x, w = np.polynomial.legendre.leggauss(8)
    z, wz = 0.5 * thickness * x, 0.5 * w
    r, wr = 0.5 * radius * (x + 1.0), 0.5 * w * (x + 1.0)  # 2 r dr / R^2
    square = float(r**2 @ wr)
    across = mass * (0.5 * square + float(z**2 @ wz))
    disc = rod.PointMass.disc(0.1, mass, radius, thickness)
    assert disc.inertia == pytest.approx((across, across, mass * square), rel=1e-12)
    assert disc.mass == mass and disc.s == 0.1 and disc.offset == (0.0, 0.0, 0.0)


def test_a_body_resists_acceleration_and_turning() -> None:
    """At the tip of a rod whose base speeds up and spins: m (g - a) and -(J alpha + omega x J omega) at its centre."""
    mass, inertia, offset = 0.2, np.array([1e-3, 2e-3, 4e-3]), np.array([0.01, -0.02, 0.03])
    a, omega, alpha, g = (np.array(x) for x in ((1.0, 2.0, 3.0), (3.0, -2.0, 1.0), (5.0, 4.0, -6.0), (0.0, -9.81, 0.0)))
    base = rod.Base(acceleration=tuple(a), spin=tuple(omega), spin_rate=tuple(alpha))
    found = loads_of(rod.PointMass(LENGTH, mass, inertia, offset), beside=(rod.Gravity(g), base))
    centre = np.array([0.0, 0.0, LENGTH]) + offset
    inertial = -mass * (a + np.cross(alpha, centre) + np.cross(omega, np.cross(omega, centre)))
    turning = inertia * alpha + np.cross(omega, inertia * omega)
    assert found["tip_force"].ravel() == pytest.approx(mass * g)
    assert found["point_inertia"][:, 0] == pytest.approx(inertial)
    assert found["tip_moment"].ravel() == pytest.approx(np.cross(offset, mass * g + inertial) - turning)


def test_loads_at_a_point_and_along_the_rod_follow_the_sections_when_told_to() -> None:
    """A straight rod turned by its base: world axes for dead loads, those of the sections for followers."""
    turn = Rotation.from_rotvec([0.3, -0.5, 0.9])
    force, moment = np.array([1.0, 2.0, 3.0]), np.array([0.4, 0.5, 0.6])
    base = (rod.Base(rotation=tuple(turn.as_rotvec())),)
    for follower in (False, True):
        f, m = (turn.apply(x) if follower else x for x in (force, moment))
        tip = loads_of(rod.TipWrench(force, moment, follower), beside=base)
        assert tip["tip_force"].ravel() == pytest.approx(f, abs=1e-6)
        assert tip["tip_moment"].ravel() == pytest.approx(m, abs=1e-6)
        spread = loads_of(rod.DistributedWrench(force, moment, follower), beside=base)
        assert spread["force"] == pytest.approx(everywhere(f), abs=1e-6)
        assert spread["moment"] == pytest.approx(everywhere(m), abs=1e-6)
        backbone = body(elements=(0.25, 0.15))
        scene = rod.Scene(backbone, *base, rod.PointWrench(0.25, force, moment, follower), nodes=2)
        xi, _, balance = scene.static_balance
        turned = rod.Scene(backbone, *base, rod.PointWrench(0.25, (0.0,) * 3, moment, follower), nodes=2).static_balance
        below = np.array([1.0, 1.0, 0.0, 0.0])
        inside = ca.Function("f", [xi], [balance.loads.point_force])(scene.rest_coordinates)
        assert np.asarray(inside) == pytest.approx(np.outer(f, below), abs=1e-6)
        carried = ca.Function("m", turned[:1], [turned[2].residual])(scene.rest_coordinates)
        moments = np.asarray(carried).reshape(4, -1)[:, :3]
        assert moments == pytest.approx(np.outer(below, turn.inv().apply(m)), abs=1e-6)


# The rod -------------------------------------------------------------------------------------------------------------


def test_stiffness_mass_and_inertia_are_those_of_the_section() -> None:
    backbone = rod.Rod(LENGTH, rod.Circle(RADIUS, shear_factor=0.9), STEEL, "cosserat")
    assert backbone.stiffness == pytest.approx((EI, EI, GJ, 0.9 * GA, 0.9 * GA, EA))
    assert backbone.mass_per_length == pytest.approx(8000.0 * AREA)
    assert backbone.inertia_per_length == pytest.approx((8000.0 * SECOND, 8000.0 * SECOND, 16000.0 * SECOND))


def test_natural_rates_are_those_of_waves_in_the_rod() -> None:
    """Bending (1.8751 / L)^2 sqrt(EI / rho A); torsion, stretch: quarter waves; shear: sqrt(k G A / rho I)."""
    backbone = rod.Rod(LENGTH, rod.GeneralSection(AREA, (SECOND, 4.0 * SECOND), 3.0 * SECOND), STEEL, "cosserat")
    rates = backbone.natural_rates
    bending = (1.8751040687 / LENGTH) ** 2 * np.sqrt(EI / (8000.0 * AREA))
    assert backbone.bending_rate == pytest.approx(bending, rel=1e-9)
    g = 207e9 / 2.6
    expected = [bending, bending, 0.5 * np.pi / LENGTH * np.sqrt(g * 3.0 / (8000.0 * 5.0))]
    expected += [np.sqrt(g * AREA / (8000.0 * i * SECOND)) for i in (4.0, 1.0)]
    assert rates == pytest.approx((*expected, 0.5 * np.pi / LENGTH * np.sqrt(207e9 / 8000.0)), rel=1e-9)


def test_rotations_are_those_of_scipy() -> None:
    rng = np.random.default_rng(0)
    for _ in range(3):
        a, b = rng.normal(size=(2, 3))
        ra, rb = Rotation.from_rotvec(a), Rotation.from_rotvec(b)
        made = rotation_matrix(compose(exponential(ca.SX(ca.DM(a))), exponential(ca.SX(ca.DM(b)))))
        assert np.asarray(ca.DM(made)) == pytest.approx((ra * rb).as_matrix(), abs=1e-10)


@pytest.mark.parametrize("strains", ["planar", "planar-cosserat"])
def test_velocities_and_accelerations_are_derivatives_of_positions(strains: str) -> None:
    """Of points of a rod in the plane along xi + t xi_t + t^2 xi_tt / 2, with shear and stretch."""
    scene = rod.Scene(body(strains), nodes=3)
    x, x_t, x_tt, _, balance = scene.dynamic_balance
    points = [0.13, LENGTH]
    at = [f(points) for f in (balance.motion.position_at, balance.motion.velocity_at, balance.motion.acceleration_at)]
    turning = [f(points) for f in (balance.motion.spin_at, balance.motion.spin_rate_at)]
    f = ca.Function("f", [x, x_t, x_tt], [*at, *turning])
    rng, n = np.random.default_rng(1), scene.n_strains
    sizes = np.tile([2.0, 0.1, 0.1], 3)[:n] if strains != "planar" else np.full(n, 2.0)
    xi, rate, second = (scene.rest_coordinates * (k == 0) + sizes * rng.normal(size=n) for k in range(3))
    h = 1e-4
    before, now, after = (
        [np.asarray(v) for v in f(xi + t * rate + 0.5 * t**2 * second, rate + t * second, second)] for t in (-h, 0.0, h)
    )
    for k in (0, 1):
        slope = (after[k] - before[k]) / (2.0 * h)
        assert now[k + 1] == pytest.approx(slope, rel=1e-5, abs=1e-6 * np.abs(slope).max())
    assert now[4] == pytest.approx((after[3] - before[3]) / (2.0 * h), rel=1e-5, abs=1e-9)
