"""Tendons on any route: against shooting, closed forms, and the virtual work of their path length."""

import casadi as ca
import numpy as np
import pytest
from scipy.optimize import root

from pisplit.models import rod
from pisplit.models.rod.terms.routing import sample

STEEL = rod.Elastic(207e9, 207e9 / 2.6, 8000.0)
LENGTH = 0.4
#: Steps of the shooting method.
STEPS = 25


def body(strains: str = "kirchhoff", **options: object) -> rod.Rod:
    return rod.Rod(LENGTH, rod.Circle(1e-3), STEEL, strains, **options)  # type: ignore[arg-type]


def stress_and_length(scene: rod.Scene) -> ca.Function:
    """``(xi, u) -> (generalised force of the tendons, path lengths)`` in a Cosserat rod."""
    xi, u, balance = scene.static_balance
    stress = ca.vertcat(balance.loads.stress_w, balance.loads.stress_v)
    weighted = stress * ca.repmat(ca.DM(scene.rule.weights).T, 6, 1)
    return ca.Function("f", [xi, u], [ca.vec(weighted), balance.loads.outputs["length"]])


def wavy(s: float) -> tuple[float, float]:
    return (0.01 + 0.3 * s**2, 0.02 * np.sin(9.0 * s))


@pytest.mark.parametrize(
    "tendons",
    [
        rod.Tendons.parallel(0.012, (30,), rod.Tension()),
        rod.Tendons.helical(0.012, 0.3, (30,), rod.Tension()),
        rod.Tendons.converging(0.02, 0.005, LENGTH, (30,), rod.Tension()),
        rod.Tendons([wavy], rod.Tension()),
        rod.Tendons([wavy], rod.Tension(), end=0.25),
    ],
)
def test_the_load_of_a_tendon_is_the_gradient_of_its_path_length(tendons: rod.Tendons) -> None:
    """Virtual work: tau dl = sum_k b_k stress_k . d strain_k, for any strains, by central differences."""
    scene = rod.Scene(body("cosserat", elements=(0.25, 0.15)), tendons, nodes=(4, 3))
    f = stress_and_length(scene)
    rng = np.random.default_rng(0)
    xi = scene.rest_coordinates + np.tile([3.0, -2.0, 4.0, 0.02, 0.01, 0.05], 7) * rng.standard_normal(42)
    force = np.asarray(f(xi, [2.5])[0]).ravel()
    for _ in range(5):
        way = np.tile([1.0, 1.0, 1.0, 0.01, 0.01, 0.01], 7) * rng.standard_normal(42)
        h = 1e-5
        longer, shorter = (float(f(xi + e * h * way, [2.5])[1]) for e in (1.0, -1.0))
        assert 2.5 * (longer - shorter) / (2.0 * h) == pytest.approx(force @ way, rel=1e-6)


def test_a_line_without_slope_and_a_helix_without_turns_are_parallel() -> None:
    u = np.array([3.0])
    scenes = [
        rod.Scene(body(), rod.Tendons([route], rod.Tension()), nodes=4)
        for route in (
            (0.01, 0.0),
            rod.Line((0.01, 0.0), (0.01, 0.0), LENGTH),
            rod.Helix(0.01, 1e9),
            lambda s: (0.01, 0.0),
        )
    ]
    tips = [scene.statics().solve(u).tip for scene in scenes]
    assert all(tip == pytest.approx(tips[0], abs=1e-10) for tip in tips)


def test_slopes_of_user_routes_are_those_of_the_helpers() -> None:
    helix = rod.Helix(0.012, 0.25, 0.4)
    scenes = [rod.Scene(body(), rod.Tendons([r], rod.Tension()), nodes=6) for r in (helix, lambda s: helix(s))]
    tips = [scene.statics().solve([4.0]).tip for scene in scenes]
    assert tips[0] == pytest.approx(tips[1], abs=1e-11)


def shooting_tip(route: rod.Helix | rod.Line, tension: float, backbone: rod.Rod) -> np.ndarray:
    """Tip position by the strong form of Rucker & Webster (T-RO 2011) on an extensible, shearable rod, by shooting.

    Unknown internal force and moment at the base; along s the tendon loads the rod with f_t = tau dt/ds and
    l_t = r x f_t (t: world tangent of the tendon path), at the tip with -tau t and -r x tau t:
    n' = -f_t, m' = -p' x n - l_t.
    """
    stiffness = np.array(backbone.stiffness)

    def hat(a: np.ndarray) -> np.ndarray:
        return np.array([[0, -a[2], a[1]], [a[2], 0, -a[0]], [-a[1], a[0], 0]])

    def local(s: float) -> tuple[np.ndarray, np.ndarray]:
        return np.array([*route(s), 0.0]), np.array([*route.slope(s), 0.0])

    def fun(s: float, y: np.ndarray) -> np.ndarray:
        R, n, m = y[3:12].reshape(3, 3), y[12:15], y[15:18]
        # Contact loads without the tendon: body strains from the material law.
        w, v = (R.T @ m) / stiffness[:3], np.array([0, 0, 1.0]) + (R.T @ n) / stiffness[3:]
        r, dr = local(s)
        # f_t = tau d(R a/|a|)/ds depends on w', v' linearly: solve the 6 x 6 system of the strong form.
        a = v + np.cross(w, r) + dr
        norm = np.linalg.norm(a)
        project = tension * (np.eye(3) - np.outer(a, a) / norm**2) / norm
        ddr = np.array([*(np.array(route.slope(s + 1e-6)) - np.array(route.slope(s - 1e-6))) / 2e-6, 0.0])
        # a' = v' + w' x r + w x r' + r''; world derivative: R (a' + w x a)
        known = project @ (np.cross(w, dr) + ddr + np.cross(w, a))
        k_w, k_v = np.diag(stiffness[:3]), np.diag(stiffness[3:])
        # n = R K_v (v - v*), n' = -f_t  ->  K_v v' + w x K_v(v - v*) = -[known + project (v' - r x w')]
        # m' = -p' x n - r x f_t (in body axes, about the centreline)
        left = np.block([[k_v + project, -project @ hat(r)], [hat(r) @ project, k_w - hat(r) @ project @ hat(r)]])
        n_body, m_body = R.T @ n, R.T @ m
        right = np.concatenate(
            [
                -np.cross(w, n_body) - known,
                -np.cross(w, m_body) - np.cross(v, n_body) - np.cross(r, known),
            ]
        )
        slopes = np.linalg.solve(left, right)
        n_s = R @ (k_v @ slopes[:3] + np.cross(w, n_body))
        m_s = R @ (k_w @ slopes[3:] + np.cross(w, m_body))
        return np.concatenate([R @ v, (R @ hat(w)).ravel(), n_s, m_s])

    def end(wrench: np.ndarray) -> np.ndarray:
        y, h = np.concatenate([np.zeros(3), np.eye(3).ravel(), wrench]), LENGTH / STEPS
        for s in h * np.arange(STEPS):  # the classical Runge-Kutta method
            a = fun(s, y)
            b = fun(s + 0.5 * h, y + 0.5 * h * a)
            c = fun(s + 0.5 * h, y + 0.5 * h * b)
            y = y + h / 6.0 * (a + 2.0 * b + 2.0 * c + fun(s + h, y + h * c))
        return np.asarray(y)

    def miss(x: np.ndarray) -> np.ndarray:
        y = end(x * scale)
        R, n, m = y[3:12].reshape(3, 3), y[12:15], y[15:18]
        w, v = (R.T @ m) / stiffness[:3], np.array([0, 0, 1.0]) + (R.T @ n) / stiffness[3:]
        r, dr = local(LENGTH)
        a = v + np.cross(w, r) + dr
        pull = tension * a / np.linalg.norm(a)
        return np.concatenate([R.T @ n + pull, R.T @ m + np.cross(r, pull)]) / scale

    scale = np.array([tension] * 3 + [tension * 0.01] * 3)
    found = root(miss, np.concatenate([[0, 0, -1.0], np.zeros(3)]), tol=1e-9)
    assert np.abs(found.fun).max() < 1e-7
    tip: np.ndarray = end(found.x * scale)[:3]
    return tip


@pytest.mark.parametrize(
    "route", [rod.Helix(0.012, LENGTH, 0.5), rod.Line((0.015, 0.004), (0.004, -0.003), LENGTH)], ids=["helix", "line"]
)
def test_routed_tendons_agree_with_shooting_in_strong_form(route: rod.Helix | rod.Line) -> None:
    backbone = rod.Rod(LENGTH, rod.Circle(1e-3), STEEL, "cosserat")
    scene = rod.Scene(backbone, rod.Tendons([route], rod.Tension()), nodes=8)
    solved = scene.statics().solve([8.0])
    exact = shooting_tip(route, 8.0, backbone)
    assert solved.success
    assert np.linalg.norm(exact[:2]) > 0.01
    assert solved.tip == pytest.approx(exact, abs=3e-6 * LENGTH)


def test_unpulled_helical_tendons_carry_nothing_at_rest() -> None:
    """Length of a helix: L sqrt(1 + (2 pi r / pitch)^2); pulling by a displacement starts from there."""
    tendons = rod.Tendons.helical(0.012, 0.4, (0, 180), rod.Displacement(1e-4, slack_smoothing=1e-6))
    scene = rod.Scene(body(), tendons, nodes=6)
    length = LENGTH * np.sqrt(1.0 + (2.0 * np.pi * 0.012 / 0.4) ** 2)
    assert tendons.unpulled_lengths(scene.rod, scene.rule) == pytest.approx(np.full(2, length), rel=1e-12)
    rest = scene.statics().solve([0.0, 0.0])
    assert np.abs(rest.tensions).max() < 1e-5 and np.abs(rest.strains).max() < 1e-6
    with pytest.raises(ValueError, match="pulls a tendon"):
        scene.statics().solve([(1.0 + 1e-12) * length, 0.0])
    assert scene.statics().solve([2e-3, -1e-3]).tensions[0] > 0.5


# Ending before the tip -----------------------------------------------------------------------------------------------


def test_a_tendon_that_ends_leaves_the_rest_of_the_rod_straight() -> None:
    """Constant curvature to the end of the tendon (closed form), none beyond: the termination wrench is in the load."""
    end, tension, offset = 0.25, 6.0, 0.012
    backbone = body(elements=(end, LENGTH - end))
    tendon = rod.Tendons([[offset, 0.0]], rod.Tension(), end=end)
    solved = rod.Scene(backbone, tendon, nodes=(4, 3)).statics().solve([tension])
    k = tension * offset / backbone.stiffness[1]
    angle = k * end
    knee = np.array([(1.0 - np.cos(angle)) / k, 0.0, np.sin(angle) / k])
    way = np.array([np.sin(angle), 0.0, np.cos(angle)])
    assert solved.strains.reshape(-1, 3)[:, 1] == pytest.approx(np.r_[np.full(4, k), np.zeros(3)], abs=1e-9)
    assert solved.tip == pytest.approx(knee + (LENGTH - end) * way, abs=1e-7)


def test_a_tendon_to_the_end_of_the_rod_is_one_without_an_end() -> None:
    scenes = [rod.Scene(body(), rod.Tendons([[0.01, 0.0]], rod.Displacement(1e-4), end=e)) for e in (None, LENGTH)]
    assert scenes[0].statics().solve([5e-3]).tip == pytest.approx(scenes[1].statics().solve([5e-3]).tip, abs=1e-12)


def test_an_end_inside_an_element_is_refused() -> None:
    with pytest.raises(ValueError, match="elements"):
        rod.Scene(body(), rod.Tendons([[0.01, 0.0]], rod.Tension(), end=0.3))


def test_two_sections_bend_two_ways() -> None:
    """Proximal and distal tendons on opposite sides: an S; each piece has the curvature of its own tensions."""
    backbone = body("planar", elements=(0.2, 0.2))
    near = rod.Tendons([[0.01, 0.0]], rod.Tension(), name="near", end=0.2)
    far = rod.Tendons([[-0.01, 0.0]], rod.Tension(), name="far")
    strains = rod.Scene(backbone, near, far, nodes=3).statics().solve([9.0, 4.0]).strains
    k = 0.01 / backbone.stiffness[1]
    assert strains == pytest.approx(np.r_[np.full(3, 5.0 * k), np.full(3, -4.0 * k)], rel=1e-9)


# Friction ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("strains", ["planar", "kirchhoff"])
def test_capstan_friction_on_a_rod_of_constant_curvature(strains: str) -> None:
    """EI w = r tau_0 exp(-mu theta) with theta' = w: exp(mu theta) = 1 + mu (r tau_0 / EI) s, in closed form."""
    offset, tension, mu = 0.012, 60.0, 0.3
    backbone = body(strains)
    scene = rod.Scene(backbone, rod.Tendons([[offset, 0.0]], rod.Tension(), friction=mu), nodes=8)
    solved = scene.statics().solve([tension])
    k = offset * tension / backbone.stiffness[1]
    theta = np.log1p(mu * k * LENGTH) / mu
    _, R = solved.pose(LENGTH)
    assert solved.success
    assert theta < 0.95 * k * LENGTH  # friction matters here
    assert np.arctan2(R[0, 2], R[2, 2]) == pytest.approx(theta, rel=3e-6)
    assert solved.tensions == pytest.approx([tension])


def test_friction_on_a_rod_that_cannot_bend_is_none() -> None:
    """A straight path does not turn; a helix on it turns by 2 pi cos(alpha) a turn."""
    hard = rod.Rod(LENGTH, rod.Circle(1e-3), rod.Elastic(1e18, 1e18, 8000.0))

    def moments(route: rod.Helix | tuple[float, float]) -> np.ndarray:
        scene = rod.Scene(hard, rod.Tendons([route], rod.Tension(), friction=0.2), nodes=24)
        xi, u, balance = scene.static_balance
        f = ca.Function("f", [xi, u], [ca.sqrt(ca.sum1(balance.loads.stress_v**2))])
        return np.asarray(f(np.zeros(scene.n_strains), [5.0])).ravel()

    assert moments((0.01, 0.0)) == pytest.approx(np.full(24, 5.0), rel=1e-12)
    helix = rod.Helix(0.01, LENGTH)
    lead = LENGTH / (2.0 * np.pi)
    turn = 0.01 / (0.01**2 + lead**2) * np.sqrt(1.0 + (0.01 / lead) ** 2)  # curvature times length of path
    s = rod.Scene(hard, nodes=24).rule.nodes
    assert moments(helix) == pytest.approx(5.0 * np.exp(-0.2 * turn * s), rel=1e-6)


def test_displaced_tendons_with_friction_pull_harder_at_the_base() -> None:
    """The stretch is that of the mean tension: the base carries more than without friction at the same mean."""
    rough, smooth = (
        rod.Scene(body(), rod.Tendons([[0.012, 0.0]], rod.Displacement(1e-4), friction=mu), nodes=6).statics()
        for mu in (0.3, 0.0)
    )
    assert rough.solve([8e-3]).tensions[0] > 1.05 * smooth.solve([8e-3]).tensions[0]
    assert rough.solve([0.0]).tensions == pytest.approx(smooth.solve([0.0]).tensions, rel=1e-4)


def test_options_of_tendons_that_are_not_used_leave_no_node() -> None:
    def size(tendons: rod.Tendons) -> int:
        xi, u, balance = rod.Scene(body(), tendons).static_balance
        return int(ca.Function("s", [xi, u], [balance.residual], {"cse": True}).n_instructions())

    plain = rod.Tendons([[0.01, 0.0]], rod.Displacement(1e-4))
    assert size(rod.Tendons([[0.01, 0.0]], rod.Displacement(1e-4), friction=0.0)) == size(plain)
    assert size(rod.Tendons([lambda s: (0.01, 0.0)], rod.Displacement(1e-4))) <= size(plain)
    assert size(rod.Tendons([[0.01, 0.0]], rod.Displacement(1e-4), friction=0.1)) > size(plain)


@pytest.mark.parametrize(
    ("build", "part"),
    [
        (lambda: rod.Helix(0.01, 0.0), "pitch"),
        (lambda: rod.Helix(-0.01, 1.0), "radius"),
        (lambda: rod.Line((0.0, 0.0), (0.0, 0.0, 0.0), 1.0), "end"),  # type: ignore[arg-type]
        (lambda: rod.Tendons([[0.01, 0.0]], rod.Tension(), friction=-0.1), "friction"),
        (
            lambda: rod.Tendons([lambda s: (1.0, 0.0, 0.0), (0.01, 0.0)], rod.Tension()).check(
                body(), rod.Scene(body()).rule
            ),
            "route",
        ),
        (lambda: rod.Scene(body("planar"), rod.Tendons.helical(0.01, 0.4, (0,), rod.Tension())), "planar"),
    ],
)
def test_what_does_not_fit_is_refused_in_one_line(build: object, part: str) -> None:
    with pytest.raises(ValueError, match=part) as caught:
        build()  # type: ignore[operator]
    assert "\n" not in str(caught.value)


def test_slopes_of_functions_hold_at_the_ends_of_the_rod() -> None:
    s = np.array([0.0, 1e-4, 0.2, LENGTH - 1e-4, LENGTH])
    helix = rod.Helix(0.012, 0.25, 0.4)
    exact = np.array([helix.slope(x) for x in s]).T
    assert sample(lambda x: helix(x), s, LENGTH)[1][:2] == pytest.approx(exact, abs=1e-8 * np.abs(exact).max())


def test_slack_tendons_of_a_weak_rod_leave_it_as_straight_as_those_of_a_stiff_one() -> None:
    """Rods alike but for their stiffness, tendons in proportion: the rounding of slack scales with the tendons."""
    shapes = []
    for young in (1e4, 1e12):
        body = rod.Rod(0.5, rod.Circle(1e-3), rod.Elastic(young, young / 3.0, 1000.0), "cosserat")
        drive = rod.Displacement(compliance=1e-2 / body.stiffness[0])
        found = rod.Scene(body, rod.Tendons.parallel(0.01, (0, 120, 240), drive), nodes=3).statics().solve([5e-3, 0, 0])
        assert found.success
        shapes.append(found.strains)
    assert shapes[0] == pytest.approx(shapes[1], abs=1e-9)
    assert rod.Displacement(1e-4).tension(1.0, 1.0, 0.0) == pytest.approx(0.1 * np.log(2.0))


@pytest.mark.parametrize("friction", [0.0, 0.4])
def test_a_tendon_stretches_outside_the_rod_too(friction: float) -> None:
    """Equal pulls on both sides: tau c (L - u + o) = u. Bent over disks: c (sum h tau + o tau_0) is the stretch."""
    c, outside, u = 1e-4, 0.3, 2e-3
    drive = rod.Displacement(c, outside=outside)
    straight = rod.Scene(body("planar"), rod.Tendons.parallel(0.01, (0, 180), drive, friction=friction), nodes=3)
    even = straight.statics().solve([u, u])
    assert even.tensions == pytest.approx(u / (c * (LENGTH - u + outside)), rel=1e-6)
    if friction:
        elements = {"elements": (LENGTH / 4,) * 4}
        over = rod.Tendons.parallel(0.01, (0, 180), drive, friction=friction, disks=4)
        scene = rod.Scene(body("planar", **elements), over, nodes=2)
        found = scene.statics().solve([u, 0.0])
        xi, inputs, balance = scene.static_balance
        names = ("chord_tension", "length", "unpulled_length")
        read = ca.Function("read", [xi, inputs], [balance.loads.outputs[name] for name in names])
        tension, length, slack_at = (np.asarray(v).ravel() for v in read(found.strains, [u, 0.0]))
        carried = c * (LENGTH / 4 * tension[:4].sum() + outside * tension[0])
        share = (slack_at[0] + outside) / (LENGTH + outside)  # of the unstretched tendon
        assert found.tensions[0] > tension[3] and carried * share == pytest.approx(length[0] - slack_at[0], rel=1e-6)
