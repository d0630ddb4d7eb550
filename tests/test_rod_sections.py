"""Sections, materials, rest shapes and elements: what varies along the rod, against beam theory."""

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from pisplit.models import rod
from pisplit.models.arm.tendon_arm import TendonArm
from pisplit.models.rod.kinematics.gauss import CompositeRule, GaussRule

STEEL = rod.Elastic(207e9, 207e9 / 2.6, 8000.0)
RUBBER = rod.Elastic(1e6, 1e6 / 3.0, 1000.0)


def residual_size(scene: rod.Scene) -> tuple[int, int]:
    """Instructions of the static and the dynamic residual."""
    xi, u, static = scene.static_balance
    q, q_t, q_tt, v, moving = scene.dynamic_balance
    options = {"cse": True}
    return (
        int(ca.Function("s", [xi, u], [static.residual], options).n_instructions()),
        int(ca.Function("d", [q, q_t, q_tt, v], [moving.residual], options).n_instructions()),
    )


def natural_rates(scene: rod.Scene) -> np.ndarray:
    """Natural frequencies in rad/s at rest."""
    eigenvalues = scene.linearise(scene.statics().solve().state).eigenvalues
    return np.unique(np.round(np.abs(eigenvalues.imag[eigenvalues.imag > 0]), 9))


def mass_matrix(scene: rod.Scene, xi: np.ndarray) -> np.ndarray:
    """Symmetric mass matrix: derivative of the weighted residual by the accelerations."""
    q, q_t, q_tt, u, balance = scene.dynamic_balance
    jacobian = ca.Function("m", [q, q_t, q_tt, u], [ca.jacobian(balance.residual, q_tt)])
    weights = np.repeat(scene.rule.weights, scene.rod.strain_set.n_fields)
    return -weights[:, None] * np.asarray(jacobian(xi, 0.3 * xi, 0 * xi, np.zeros(scene.n_inputs)))


def test_the_uniform_paper_arm_pays_nothing_for_sections_that_could_vary() -> None:
    """Instructions at rest and in motion; a few more where a processor rounds constants so that they differ."""
    assert residual_size(TendonArm.paper(nodes=5).scene) == pytest.approx((1300, 2977), rel=5e-3)


@pytest.mark.parametrize("strains", ["kirchhoff", "cosserat", "planar"])
def test_what_is_constant_costs_nothing_as_a_function(strains: str) -> None:
    terms = (rod.Gravity((-9.81, 0.0, 0.0)), rod.KelvinVoigt(bending=1e-4))
    plain = rod.Scene(rod.Rod(0.5, rod.Circle(1e-3), STEEL, strains), *terms)
    varying = rod.Rod(0.5, lambda s: rod.Circle(1e-3), lambda s: STEEL, strains, lambda s: (0.0, 0.0, 0.0))
    scene = rod.Scene(varying, *terms)
    assert residual_size(scene) == residual_size(plain)
    x = np.random.default_rng(1).standard_normal(plain.n_strains)
    x += plain.rest_coordinates
    found, expected = (np.asarray(s.acceleration(x, x, [])) for s in (scene, plain))
    assert found == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize(("strains", "tolerance"), [("planar", 1e-7), ("kirchhoff", 3e-5)])
def test_tapered_cantilever(strains: str, tolerance: float) -> None:
    """delta = P L^3 / (3 E I0) r0 / r1 for a radius that is linear in s (Bernoulli beam, small force)."""
    section = rod.Tapered(rod.Circle(0.02), rod.Circle(0.01))
    body = rod.Rod(0.3, section, rod.Elastic(1e6, 1e6 / 3.0, 1000.0), strains)
    tip = rod.Scene(body, rod.TipWrench(force=(1e-4, 0.0, 0.0)), nodes=10).statics().solve().tip
    assert tip[0] == pytest.approx(1.4323944878270578e-05, rel=tolerance)


def test_tapers_by_helper_and_by_function_are_the_same() -> None:
    helper = rod.Rod(0.3, rod.Tapered(rod.Tube(0.02, 0.01), rod.Tube(0.01, 0.004)), RUBBER)
    function = rod.Rod(0.3, lambda s: rod.Tube(0.02 - 0.01 * s / 0.3, 0.01 - 0.006 * s / 0.3), RUBBER)
    s = np.linspace(0.0, 0.3, 7)
    assert helper.profile(s).stiffness == pytest.approx(function.profile(s).stiffness, rel=1e-12)
    assert helper.profile(s).mass == pytest.approx(function.profile(s).mass, rel=1e-12)
    assert helper.mass_per_length == pytest.approx(function.mass_per_length, rel=1e-12)


def test_mean_stiffness_is_that_of_the_rod_under_a_tip_moment() -> None:
    body = rod.Rod(0.3, rod.Tapered(rod.Circle(0.02), rod.Circle(0.01)), RUBBER, "planar")
    _, R = rod.Scene(body, rod.TipWrench(moment=(0.0, 1e-3, 0.0)), nodes=14).statics().solve().pose(0.3)
    assert np.arctan2(R[0, 2], R[2, 2]) == pytest.approx(1e-3 * 0.3 / body.stiffness[1], rel=1e-6)


def test_a_tube_is_the_difference_of_two_circles() -> None:
    outer, inner, tube = rod.Circle(0.01), rod.Circle(0.006), rod.Tube(0.01, 0.006)
    assert tube.area == pytest.approx(outer.area - inner.area, rel=1e-14)
    assert np.array(tube.second_moments) == pytest.approx(
        np.array(outer.second_moments) - np.array(inner.second_moments), rel=1e-14
    )
    thin = rod.Tube(0.01, 1e-9)
    assert np.array(thin.second_moments) == pytest.approx(np.array(outer.second_moments), rel=1e-12)


def test_a_general_section_with_the_numbers_of_a_circle_is_the_circle() -> None:
    circle = rod.Circle(2e-3, shear_factor=0.9)
    general = rod.GeneralSection(circle.area, circle.second_moments[:2], shear_factors=(0.9, 0.9))
    for material in (STEEL, RUBBER):
        assert np.array(material.stiffness(general)) == pytest.approx(np.array(material.stiffness(circle)), rel=1e-14)


def test_a_flat_strip_bends_by_its_own_second_moments() -> None:
    """Width 20 mm along body axis 2, thickness 1 mm along axis 1: I1 = t w^3 / 12, I2 = w t^3 / 12, J = w t^3 / 3."""
    w, t, length, force = 20e-3, 1e-3, 0.2, 1e-3
    strip = rod.GeneralSection(w * t, (t * w**3 / 12.0, w * t**3 / 12.0), torsion_constant=w * t**3 / 3.0)
    scene = rod.Scene(rod.Rod(length, strip, STEEL), rod.TipWrench(force=rod.Input("f", 3)), nodes=6)
    for axis, moment in ((0, strip.second_moments[1]), (1, strip.second_moments[0])):
        tip = scene.statics().solve(force * np.eye(3)[axis]).tip
        assert tip[axis] == pytest.approx(force * length**3 / (3.0 * STEEL.young * moment), rel=1e-4)


def test_stiffness_by_number_is_the_elastic_rod_of_the_same_stiffness() -> None:
    section = rod.Circle(1e-3)
    k = STEEL.stiffness(section)
    numbers = rod.Stiffness(bending=(k[0], k[1]), torsion=k[2], shear=(k[3], k[4]), stretch=k[5], density=8000.0)
    force = rod.TipWrench(force=(1.0, 0.5, -0.2))
    ours = rod.Scene(rod.Rod(0.4, section, numbers, "cosserat"), force).statics().solve().tip
    assert ours == pytest.approx(rod.Scene(rod.Rod(0.4, section, STEEL, "cosserat"), force).statics().solve().tip)


def test_a_rod_that_is_curved_at_rest_rests_on_its_arc() -> None:
    """Constant curvature k about axis 2: a circle of radius 1/k; a helix for curvature and twist together."""
    k = 2.5
    body = rod.Rod(0.8, rod.Circle(1e-3), STEEL, rest_curvature=(0.0, k, 0.0))
    equilibrium = rod.Scene(body, nodes=6).statics().solve()
    assert equilibrium.success
    assert equilibrium.tip == pytest.approx(np.array([(1 - np.cos(0.8 * k)) / k, 0.0, np.sin(0.8 * k) / k]), abs=1e-9)


@pytest.mark.parametrize("strains", ["planar", "kirchhoff", "cosserat", "planar-cosserat"])
def test_a_curved_rod_is_straightened_by_the_moment_of_its_curvature(strains: str) -> None:
    body = rod.Rod(0.5, rod.Circle(1e-3), STEEL, strains, rest_curvature=(0.0, 1.5, 0.0))
    moment = rod.TipWrench(moment=(0.0, -1.5 * body.stiffness[1], 0.0))
    assert rod.Scene(body, moment).statics().solve().tip == pytest.approx(np.array([0.0, 0.0, 0.5]), abs=1e-9)


def test_a_curvature_that_varies_is_integrated() -> None:
    """Angle theta = a s^2 / 2: a clothoid."""
    body = rod.Rod(1.0, rod.Circle(1e-3), STEEL, "planar", rest_curvature=lambda s: (0.0, 3.0 * s, 0.0))
    tip = rod.Scene(body, nodes=10).statics().solve().tip
    s = np.polynomial.legendre.leggauss(40)
    theta = 1.5 * (0.5 * (s[0] + 1.0)) ** 2
    assert tip == pytest.approx(np.array([0.5 * s[1] @ np.sin(theta), 0.0, 0.5 * s[1] @ np.cos(theta)]), abs=1e-8)


def test_tendons_of_a_curved_rod_are_slack_free_and_unloaded_at_rest() -> None:
    body = rod.Rod(0.5, rod.Circle(1e-3), STEEL, rest_curvature=(0.4, 1.5, 0.3))
    tendons = rod.Tendons.parallel(0.01, (0, 120, 240), rod.Displacement(1e-4, slack_smoothing=1e-6))
    equilibrium = rod.Scene(body, tendons, nodes=6).statics().solve(np.zeros(3))
    assert equilibrium.success
    assert np.abs(equilibrium.tensions).max() < 1e-5
    assert equilibrium.strains.reshape(-1, 3) == pytest.approx(np.tile([0.4, 1.5, 0.3], (6, 1)), abs=1e-6)


# Elements ------------------------------------------------------------------------------------------------------------


@pytest.fixture
def composite() -> CompositeRule:
    return CompositeRule((GaussRule(0.2, 3), GaussRule(0.5, 4), GaussRule(0.1, 2)))


def test_integration_from_the_tip_is_the_adjoint_of_integration_from_the_base(composite: CompositeRule) -> None:
    a, b = composite.integration, composite.weights
    assert b[:, None] * (b[None, :] - a) == pytest.approx((b[:, None] * a).T, abs=1e-17)


def test_composite_rules_are_exact_for_polynomials_on_each_element(composite: CompositeRule) -> None:
    borders = np.array(composite.borders)
    assert composite.borders == pytest.approx((0.0, 0.2, 0.7, 0.8))
    piece = np.searchsorted(borders[1:-1], composite.nodes)
    heights, slopes = np.array([1.0, -2.0, 5.0]), np.array([0.5, 3.0, -4.0])
    values = heights[piece] + slopes[piece] * (composite.nodes - borders[piece])
    points = np.array([0.05, 0.2, 0.45, 0.7, 0.75, 0.8])
    owner = np.searchsorted(borders[1:-1], points)
    assert composite.interpolate(points) @ values == pytest.approx(
        heights[owner] + slopes[owner] * (points - borders[owner]), abs=1e-12
    )
    assert composite.differentiation @ values == pytest.approx(slopes[piece], abs=1e-11)
    lengths = np.diff(borders)
    whole = np.concatenate([[0.0], np.cumsum(heights * lengths + 0.5 * slopes * lengths**2)])
    part = points - borders[owner]
    expected = whole[owner] + heights[owner] * part + 0.5 * slopes[owner] * part**2
    assert composite.integrate_to(points) @ values == pytest.approx(expected, abs=1e-14)


def test_one_element_is_no_element() -> None:
    plain = rod.Scene(rod.Rod(0.5, rod.Circle(1e-3), STEEL), rod.Gravity((-9.81, 0.0, 0.0)))
    single = rod.Scene(rod.Rod(0.5, rod.Circle(1e-3), STEEL, elements=(0.5,)), rod.Gravity((-9.81, 0.0, 0.0)))
    assert residual_size(single) == residual_size(plain)
    x = np.random.default_rng(2).standard_normal(plain.n_strains)
    assert np.array_equal(np.asarray(single.acceleration(x, x, [])), np.asarray(plain.acceleration(x, x, [])))


def test_elements_of_a_uniform_rod_change_nothing_but_the_error() -> None:
    terms = (rod.Gravity((0.0, -9.81, 0.0)), rod.TipWrench(force=(0.3, 0.0, -0.1)))
    one = rod.Scene(rod.Rod(0.5, rod.Circle(1e-3), STEEL), *terms, nodes=12)
    two = rod.Scene(rod.Rod(0.5, rod.Circle(1e-3), STEEL, elements=(0.2, 0.3)), *terms, nodes=(6, 7))
    assert two.nodes == 13
    for s in (0.1, 0.2, 0.35, 0.5):
        assert two.statics().solve().pose(s)[0] == pytest.approx(one.statics().solve().pose(s)[0], abs=1e-6)
        assert two.statics().solve().pose(s)[1] == pytest.approx(one.statics().solve().pose(s)[1], abs=1e-5)


def test_a_stepped_rod_deflects_as_its_pieces() -> None:
    """Small force at the tip of a cantilever with EI_1 on L_1 and EI_2 on L_2, by integrating M / EI twice."""
    l1, l2, force = 0.2, 0.15, 1e-4
    sections = (rod.Circle(2e-3), rod.Circle(1e-3))
    body = rod.Rod(l1 + l2, sections, STEEL, elements=(l1, l2))
    ei = [STEEL.young * c.second_moments[0] for c in sections]
    exact = force * (((l1 + l2) ** 3 - l2**3) / (3.0 * ei[0]) + l2**3 / (3.0 * ei[1]))
    assert rod.Scene(body, rod.TipWrench(force=(force, 0, 0)), nodes=3).statics().solve().tip[0] == pytest.approx(
        exact, rel=1e-7
    )


def test_a_stepped_rod_under_a_large_force_agrees_with_shooting() -> None:
    """theta'' = -F / EI(s) cos(theta) with continuous moment, integrated piece by piece from the clamp."""
    l1, l2 = 0.25, 0.25
    sections = (rod.Circle(2e-3), rod.Circle(1.2e-3))
    body = rod.Rod(l1 + l2, sections, STEEL, "planar", elements=(l1, l2))
    ei = [STEEL.young * c.second_moments[0] for c in sections]
    force = 8.0 * ei[1] / 0.25
    solved = rod.Scene(body, rod.TipWrench(force=(force, 0, 0)), nodes=9).statics().solve()

    def tip(moment: float) -> np.ndarray:
        y = np.array([0.0, moment, 0.0, 0.0])
        for k, length in enumerate((l1, l2)):
            fun = lambda s, y, k=k: [y[1] / ei[k], -force * np.cos(y[0]), np.sin(y[0]), np.cos(y[0])]  # noqa: E731
            y = solve_ivp(fun, (0.0, length), y, rtol=1e-11, atol=1e-13).y[:, -1]
        return y

    low, high = 0.0, force * 0.5
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if tip(middle)[1] < 0.0 else (low, middle)
    assert solved.success
    assert solved.tip[[0, 2]] == pytest.approx(tip(low)[2:], abs=1e-8)


def test_frequencies_of_a_stepped_rod_that_is_uniform_after_all() -> None:
    one = rod.Scene(rod.Rod(0.4, rod.Circle(1e-3), STEEL, "planar"), nodes=10)
    two = rod.Scene(rod.Rod(0.4, rod.Circle(1e-3), STEEL, "planar", elements=(0.1, 0.3)), nodes=(5, 7))
    assert natural_rates(two)[:3] == pytest.approx(natural_rates(one)[:3], rel=5e-5)


@pytest.mark.parametrize("strains", ["kirchhoff", "cosserat", "planar-cosserat"])
def test_the_mass_matrix_of_a_varying_rod_is_symmetric(strains: str) -> None:
    sections = (rod.Circle(2e-3), rod.Tube(1.5e-3, 1e-3))
    scene = rod.Scene(rod.Rod(0.5, sections, STEEL, strains, elements=(0.2, 0.3)))
    m = mass_matrix(scene, scene.rest_coordinates + 0.3 * np.random.default_rng(3).standard_normal(scene.n_strains))
    assert np.abs(m - m.T).max() <= 1e-13 * np.abs(m).max()
    assert np.linalg.eigvalsh(m).min() > -1e-13 * np.abs(m).max()


def test_nominal_sizes_follow_from_the_scene_that_varies() -> None:
    body = rod.Rod(0.3, rod.Tapered(rod.Circle(0.02), rod.Circle(0.01)), RUBBER, elements=(0.1, 0.2))
    scene = rod.Scene(body, nodes=(3, 4))
    thick, thin = (rod.Rod(0.3, rod.Circle(r), RUBBER) for r in (0.02, 0.01))
    assert thin.stiffness[0] < body.stiffness[0] < thick.stiffness[0]
    assert scene.nominal_strains.shape == scene.nominal_residual.shape == (scene.n_strains,)
    assert min(thin.bending_rate, thick.bending_rate) < body.bending_rate < max(thin.bending_rate, thick.bending_rate)


def test_plane_rods_that_shear_and_stretch_are_the_spatial_ones_in_their_plane() -> None:
    terms = (rod.Gravity((-9.81, 0.0, 1.0)), rod.TipWrench(force=(2e-3, 0.0, 5e-3)))
    tips = [
        rod.Scene(rod.Rod(0.2, rod.Circle(0.01), RUBBER, strains), *terms, nodes=8).statics().solve().tip
        for strains in ("planar-cosserat", "cosserat")
    ]
    assert tips[0] == pytest.approx(tips[1], abs=1e-6)


def test_strain_sets_are_extensible() -> None:
    """Bending about axis 2 and torsion only: neither named nor planar; a torque twists it by T L / GJ."""
    twisting = rod.StrainSet("bend-twist", (1, 2))
    body = rod.Rod(0.3, rod.Circle(1e-3), STEEL, twisting)
    _, R = rod.Scene(body, rod.TipWrench(moment=(0.0, 0.0, 0.05))).statics().solve().pose(0.3)
    assert np.arctan2(R[1, 0], R[0, 0]) == pytest.approx(0.05 * 0.3 / body.stiffness[2], rel=1e-9)


def test_coordinates_of_a_rod_of_two_elements_come_back_from_its_fields() -> None:
    scene = rod.Scene(rod.Rod(0.3, rod.Circle(1e-3), STEEL, elements=(0.1, 0.2)), nodes=3)
    coordinates = scene.coordinates(9)
    x = np.random.default_rng(5).standard_normal(scene.n_states)
    assert np.asarray(coordinates.function(scene.fields(x, 9).ravel())).ravel() == pytest.approx(x, abs=1e-8)
    with pytest.raises(ValueError, match="element"):
        scene.coordinates(6)


def test_the_tip_is_the_tip_though_the_elements_add_up_with_rounding() -> None:
    scene = rod.Scene(rod.Rod(0.3, rod.Circle(1e-3), STEEL, elements=(0.1, 0.2)))
    assert 0.1 + 0.2 != 0.3
    tips = [(scene + w).statics().solve().tip for w in (rod.PointWrench(0.3, (1, 0, 0)), rod.TipWrench((1, 0, 0)))]
    assert np.array_equal(tips[0], tips[1])


def test_extensible_rods_stretch_without_shear() -> None:
    body = rod.Rod(0.3, rod.Circle(0.01), RUBBER, "extensible")
    assert rod.Scene(body, rod.TipWrench(force=(0.0, 0.0, 10.0))).statics().solve().tip[2] == pytest.approx(
        0.3 * (1.0 + 10.0 / body.stiffness[5]), rel=1e-9
    )


@pytest.mark.parametrize(
    ("build", "part"),
    [
        (lambda: rod.Tube(0.01, 0.02), "inner"),
        (lambda: rod.Tapered(rod.Circle(1.0), rod.Tube(2.0, 1.0)), "Tapered"),
        (lambda: rod.GeneralSection(1.0, (1.0, -1.0)), "second_moments"),
        (lambda: rod.Stiffness((1.0, 1.0), 1.0, (1.0, 0.0), 1.0, 1.0), "shear"),
        (lambda: rod.StrainSet("twice", (1, 1)), "increasing"),
        (lambda: rod.Rod(1.0, lambda s: 3.0, STEEL), "section"),  # type: ignore[arg-type,return-value]
        (lambda: rod.Rod(1.0, rod.Circle(1e-3), STEEL, elements=(0.4, 0.5)), "0.9"),
        (lambda: rod.Rod(1.0, (rod.Circle(1e-3),), STEEL, elements=(0.5, 0.5)), "1 sections"),
        (lambda: rod.Rod(1.0, rod.Circle(1e-3), STEEL, "planar", rest_curvature=(1.0, 0.0, 0.0)), "planar"),
        (lambda: rod.Rod(1.0, rod.Circle(1e-3), STEEL, rest_curvature=lambda s: (1.0,)), "rest_curvature"),
        (lambda: rod.Scene(rod.Rod(1.0, rod.Circle(1e-3), STEEL), nodes=(3, 3)), "1 elements"),
    ],
)
def test_what_does_not_fit_is_refused_in_one_line(build: object, part: str) -> None:
    with pytest.raises(ValueError, match=part) as caught:
        build()  # type: ignore[operator]
    assert "\n" not in str(caught.value)
