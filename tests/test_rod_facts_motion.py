"""Motion and balance against what they follow from: frames and their differential equation, Lagrange's equations."""

from functools import lru_cache

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from pisplit.models import rod
from pisplit.models.rod.equations.residuals import motion_residual
from pisplit.models.rod.kinematics import rotations
from pisplit.models.rod.kinematics.gauss import CompositeRule, GaussRule
from pisplit.models.rod.kinematics.kinematics import BaseState, Motion, columnwise_cross
from pisplit.models.rod.kinematics.strains import rotation_vector, turn_rows

LENGTH = 0.5
GRAVITY = np.array([1.5, -9.81, 3.0])
#: Stiff enough against bending and thick enough in rotation that every term of the balance counts.
SECTION = rod.GeneralSection(area=1e-3, second_moments=(4e-7, 9e-7), torsion_constant=6e-7)
MATERIAL = rod.Elastic(1e6, 4e5, 1100.0)


def scene(strains: str, nodes: int, *terms: object) -> rod.Scene:
    return rod.Scene(rod.Rod(LENGTH, SECTION, MATERIAL, strains), *terms, nodes=nodes)


def smooth(made: rod.Scene, seed: int, sizes: tuple[float, float, float] = (3.0, 20.0, 100.0)) -> list[np.ndarray]:
    """Strains, rates and accelerations (n,) that are smooth along the rod; shear and stretch a tenth of bending."""
    rng = np.random.default_rng(seed)
    s = made.rule.nodes / LENGTH
    shapes = np.stack([np.ones_like(s), s, np.cos(2.0 * s)])
    free = made.rod.strain_set.free
    scale = np.array([1.0 if c < 3 else 0.05 for c in free])
    found = [(shapes.T @ (size * rng.standard_normal((3, len(free))) * scale)).ravel() for size in sizes]
    found[0] += made.rest_coordinates
    return found


def hat(w: np.ndarray) -> np.ndarray:
    return np.array([[0.0, -w[2], w[1]], [w[2], 0.0, -w[0]], [-w[1], w[0], 0.0]])


def unhat(m: np.ndarray) -> np.ndarray:
    return np.array([m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]]) / 2.0


@lru_cache
def motion_function(made: rod.Scene, points: tuple[float, ...]) -> ca.Function:
    """``(xi, xi_t, xi_tt) -> p, p_t, p_tt (3, S), O, O_t (3, S), R (9, S)`` in world axes."""
    xi, xi_t, xi_tt, _, balance = made.dynamic_balance
    m = balance.motion
    frames = ca.horzcat(*[ca.vec(r) for r in m.frames_at(list(points))])
    at = [f(list(points)) for f in (m.position_at, m.velocity_at, m.acceleration_at, m.spin_at, m.spin_rate_at)]
    return ca.Function("motion", [xi, xi_t, xi_tt], [*at, frames])


# Collocation ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("rule", [GaussRule(0.7, 4), CompositeRule((GaussRule(0.3, 4), GaussRule(0.4, 5)))])
def test_polynomials_are_integrated_interpolated_and_differentiated_exactly(rule: GaussRule | CompositeRule) -> None:
    """Degree K - 1 in every matrix, 2 K - 1 in the weights, each within its element."""
    points = np.array([0.0, 0.1, 0.29, 0.33, 0.55, 0.7])
    for degree in range(4):
        g = rule.nodes**degree
        assert rule.interpolate(points) @ g == pytest.approx(points**degree, abs=1e-12)
        whole = points ** (degree + 1) / (degree + 1)
        assert rule.integrate_to(points) @ g == pytest.approx(whole, abs=1e-13)
        assert rule.integration @ g == pytest.approx(rule.nodes ** (degree + 1) / (degree + 1), abs=1e-13)
        slope = degree * rule.nodes ** max(degree - 1, 0)
        assert rule.differentiation @ g == pytest.approx(slope, abs=1e-11)
    for degree in range(8):
        assert rule.weights @ rule.nodes**degree == pytest.approx(0.7 ** (degree + 1) / (degree + 1), abs=1e-13)
    b, a = rule.weights, rule.integration
    assert b[:, None] * (b[None, :] - a) == pytest.approx((b[:, None] * a).T, abs=1e-15)
    assert rule.length == pytest.approx(0.7) and rule.n_nodes == len(rule.nodes)
    assert rule.step_ends == pytest.approx(sorted({*rule.borders[:-1], *rule.nodes}))


def test_strains_may_jump_where_an_element_ends() -> None:
    """1 before 0.3 m and 5 beyond: values, integrals and slopes know the border; it takes the value before it."""
    rule = CompositeRule((GaussRule(0.3, 3), GaussRule(0.4, 2)))
    g = np.where(rule.nodes < 0.3, 1.0, 5.0)
    points = np.array([0.1, 0.3, 0.31, 0.7])
    assert rule.interpolate(points) @ g == pytest.approx([1.0, 1.0, 5.0, 5.0], abs=1e-13)
    assert rule.integrate_to(points) @ g == pytest.approx([0.1, 0.3, 0.35, 2.3], abs=1e-13)
    assert rule.differentiation @ g == pytest.approx(np.zeros(5), abs=1e-12)


# Rotations -----------------------------------------------------------------------------------------------------------


def matrix_of(quaternion: ca.SX) -> np.ndarray:
    return np.asarray(ca.evalf(rotations.rotation_matrix(quaternion)), dtype=float)


@pytest.mark.parametrize("turn", [[0.3, -1.1, 2.0], [1e-9, 0.0, 0.0], [0.0, 0.0, 0.0]])
def test_exponentials_are_rotations_by_their_vectors(turn: list[float]) -> None:
    exact = Rotation.from_rotvec(turn).as_matrix()
    assert matrix_of(rotations.exponential(ca.SX(turn))) == pytest.approx(exact, abs=1e-11)
    first, second = (rotations.exponential(ca.SX(v)) for v in (turn, [0.5, 0.2, -0.4]))
    both = exact @ Rotation.from_rotvec([0.5, 0.2, -0.4]).as_matrix()
    assert matrix_of(rotations.compose(first, second)) == pytest.approx(both, abs=1e-11)
    y = np.asarray(ca.evalf(rotations.rotation_about_y(ca.SX(0.7))))
    assert y == pytest.approx(Rotation.from_rotvec([0.0, 0.7, 0.0]).as_matrix(), abs=1e-14)
    a, b = np.arange(6.0).reshape(3, 2), np.array([[1.0, -2.0], [0.5, 3.0], [2.0, 1.0]])
    assert np.asarray(ca.evalf(columnwise_cross(ca.SX(a), ca.SX(b)))) == pytest.approx(np.cross(a, b, axis=0))


@pytest.mark.parametrize(("nodes", "order"), [(2, 4), (3, 4), (6, 6), (8, 6)])
def test_a_magnus_step_has_its_order(nodes: int, order: int) -> None:
    """R' = R hat(w) with w linear, then quadratic in s: one step is off by h^(order + 1), whatever nodes carry w."""
    slopes = np.array([[4.0, 30.0, 200.0], [-3.0, 20.0, -150.0], [2.0, -25.0, 100.0]])[:, : min(nodes, 3)]

    def strain(s: np.ndarray | float) -> np.ndarray:
        return slopes @ np.power.outer(np.asarray(s), np.arange(slopes.shape[1])).T

    def error(h: float) -> float:
        rule = GaussRule(h, nodes)
        parts = ca.SX(ca.DM(strain(rule.nodes) @ turn_rows(rule, 0.0, h).T))
        omega = np.asarray(ca.evalf(rotation_vector(parts)), dtype=float).ravel()
        slope = lambda s, r: (r.reshape(3, 3) @ hat(strain(s))).ravel()  # noqa: E731
        exact = solve_ivp(slope, (0.0, h), np.eye(3).ravel(), method="DOP853", rtol=1e-13, atol=1e-15).y[:, -1]
        return float(np.abs(Rotation.from_rotvec(omega).as_matrix() - exact.reshape(3, 3)).max())

    assert np.log2(error(0.08) / error(0.04)) > order + 0.5


# Kinematics ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("strains", ["cosserat", "planar-cosserat"])
def test_frames_and_positions_solve_their_equations(strains: str) -> None:
    """R_s = R hat(w), p_s = R v from the base, by an integrator of Runge and Kutta; strains by interpolation."""
    made = scene(strains, 9)
    xi = smooth(made, 1)[0]
    rest = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
    full = np.tile(rest[:, None], (1, made.nodes))
    full[list(made.rod.strain_set.free)] = xi.reshape(made.nodes, -1).T

    def slope(s: float, y: np.ndarray) -> np.ndarray:
        e, r = full @ made.rule.interpolate([s])[0], y[3:].reshape(3, 3)
        return np.concatenate([r @ e[3:], (r @ hat(e[:3])).ravel()])

    points = (0.2 * LENGTH, LENGTH)
    start = np.concatenate([np.zeros(3), np.eye(3).ravel()])
    exact = solve_ivp(slope, (0.0, LENGTH), start, t_eval=points, rtol=1e-10, atol=1e-12).y
    p, *_, frames = (np.asarray(v) for v in motion_function(made, points)(xi, 0.0 * xi, 0.0 * xi))
    assert p == pytest.approx(exact[:3], abs=2e-5 * LENGTH)
    for k in range(2):
        assert frames[:, k].reshape(3, 3, order="F") == pytest.approx(exact[3:, k].reshape(3, 3), abs=2e-4)


def by_differences(made: rod.Scene, state: list[np.ndarray], points: tuple[float, ...]) -> list[np.ndarray]:
    """p_t, p_tt, O, O_t (3, S) along xi(t) = xi + t xi_t + t^2 xi_tt / 2 by central differences of p and R."""
    xi, xi_t, xi_tt = state
    h, found = 1e-4, []
    for t in (-h, 0.0, h):
        values = motion_function(made, points)(xi + t * xi_t + 0.5 * t * t * xi_tt, 0.0 * xi, 0.0 * xi)
        found.append(
            (np.asarray(values[0]), [np.asarray(values[5])[:, k].reshape(3, 3, order="F") for k in range(len(points))])
        )
    (p0, r0), (p1, r1), (p2, r2) = found
    spins = [unhat((c - a) @ b.T) / (2.0 * h) for a, b, c in zip(r0, r1, r2, strict=True)]
    rates = [unhat((c - 2.0 * b + a) @ b.T) / h**2 for a, b, c in zip(r0, r1, r2, strict=True)]  # skew of R_tt R^T
    return [(p2 - p0) / (2.0 * h), (p2 - 2.0 * p1 + p0) / h**2, np.array(spins).T, np.array(rates).T]


@pytest.mark.parametrize(
    ("strains", "variational", "nodes"), [("cosserat", True, 3), ("cosserat", False, 12), ("planar-cosserat", False, 3)]
)
def test_velocities_and_accelerations_are_time_derivatives(strains: str, variational: bool, nodes: int) -> None:
    """Of positions and frames: the variational motion at any number of nodes, the usual one as the nodes grow."""
    made = scene(strains, nodes)
    made = made.variational() if variational else made
    state = smooth(made, 2, (3.0, 6.0, 30.0))
    points = (0.37 * LENGTH, LENGTH)
    found = [np.asarray(v) for v in motion_function(made, points)(*state)][1:5]
    for mine, exact in zip(found, by_differences(made, state, points), strict=True):
        assert np.abs(exact).max() > 0.1
        assert np.abs(mine - exact).max() <= 1e-4 * np.abs(exact).max()


def test_a_moving_base_carries_the_rod() -> None:
    """A straight rod on a base that turns and accelerates moves as a rigid body: p_tt = a + O_t x r + O x (O x r)."""
    made = scene("kirchhoff", 3)
    n = made.n_strains
    zero = ca.SX(n, 1)
    turn = Rotation.from_rotvec([0.3, -0.5, 0.2])
    quaternion = turn.as_quat()[[3, 0, 1, 2]]
    given = [
        np.array(v) for v in ([0.1, 0.2, 0.3], [1.0, -2.0, 0.5], [3.0, 1.0, -1.0], [2.0, 1.0, -3.0], [5.0, -4.0, 2.0])
    ]
    position, velocity, acceleration, spin, spin_rate = given
    base = BaseState(*(ca.SX(ca.DM(v)) for v in (position, quaternion, velocity, acceleration, spin, spin_rate)))
    motion = Motion(made.rod, made.rule, zero, zero, zero, base)
    points = [0.2, LENGTH]
    read = lambda x: np.asarray(ca.evalf(x))  # noqa: E731
    for k, s in enumerate(points):
        r = turn.as_matrix() @ [0.0, 0.0, s]
        assert read(motion.position_at(points))[:, k] == pytest.approx(position + r)
        assert read(motion.velocity_at(points))[:, k] == pytest.approx(velocity + np.cross(spin, r))
        carried = np.cross(spin_rate, r) + np.cross(spin, np.cross(spin, r))
        assert read(motion.acceleration_at(points))[:, k] == pytest.approx(acceleration + carried)
    nodes = made.rule.nodes
    r = turn.as_matrix() @ np.outer([0.0, 0.0, 1.0], nodes)
    assert read(motion.position) == pytest.approx(position[:, None] + r)
    assert read(motion.velocity) == pytest.approx(velocity[:, None] + np.cross(spin, r.T).T)
    assert read(motion.acceleration) == pytest.approx(
        acceleration[:, None] + np.cross(spin_rate, r.T).T + np.cross(spin, np.cross(spin, r.T)).T
    )
    assert read(motion.spin) == pytest.approx(np.tile(spin[:, None], 3))
    assert read(motion.spin_rate) == pytest.approx(np.tile(spin_rate[:, None], 3))
    tip = turn.as_matrix() @ [0.0, 0.0, LENGTH]
    assert read(motion.tip).ravel() == pytest.approx(position + tip)
    assert read(motion.tip_velocity).ravel() == pytest.approx(velocity + np.cross(spin, tip))
    assert read(motion.tip_frame) == pytest.approx(turn.as_matrix())
    assert motion.is_tip(LENGTH) and not motion.is_tip(0.999 * LENGTH)


# Balance -------------------------------------------------------------------------------------------------------------


@lru_cache
def lagrange(made: rod.Scene) -> ca.Function:
    """``(xi, xi_t, xi_tt) -> d/dt dL/dxi_t - dL/dxi`` of the discrete rod, from its positions and frames alone."""
    xi, xi_t, xi_tt, _, balance = made.dynamic_balance
    motion, body, b = balance.motion, made.rod, made.rule.weights
    kinetic, potential = ca.SX(0.0), ca.SX(0.0)
    for k, s in enumerate(made.rule.nodes):
        p, frame = motion.position_at([s]), motion.frame_at(s)
        velocity = ca.jtimes(p, xi, xi_t)
        turning = frame.T @ ca.jtimes(frame, xi, xi_t)
        omega = (
            ca.vertcat(turning[2, 1] - turning[1, 2], turning[0, 2] - turning[2, 0], turning[1, 0] - turning[0, 1])
            / 2.0
        )
        inertia = ca.DM(list(body.inertia_per_length))
        kinetic += 0.5 * b[k] * (body.mass_per_length * ca.dot(velocity, velocity) + ca.dot(inertia * omega, omega))
        potential -= b[k] * body.mass_per_length * ca.dot(ca.DM(GRAVITY), p)
    strain = ca.reshape(xi - ca.DM(made.rest_coordinates), -1, made.nodes)
    stiffness = ca.DM([body.stiffness[c] for c in body.strain_set.free])
    for k in range(made.nodes):
        potential += 0.5 * b[k] * ca.dot(stiffness * strain[:, k], strain[:, k])
    momentum = ca.gradient(kinetic, xi_t)
    rate = ca.jtimes(momentum, ca.vertcat(xi, xi_t), ca.vertcat(xi_t, xi_tt))
    return ca.Function("lagrange", [xi, xi_t, xi_tt], [rate - ca.gradient(kinetic - potential, xi)], {"cse": True})


def residual_of(made: rod.Scene, state: list[np.ndarray]) -> np.ndarray:
    xi, xi_t, xi_tt, u, balance = made.dynamic_balance
    return np.asarray(ca.Function("balance", [xi, xi_t, xi_tt, u], [balance.residual])(*state, [])).ravel()


@pytest.mark.parametrize(("strains", "nodes"), [("cosserat", 2), ("kirchhoff", 3), ("planar-cosserat", 3)])
def test_the_variational_balance_is_lagranges_equation(strains: str, nodes: int) -> None:
    """Of kinetic, elastic and gravity energy by Gauss quadrature, inertia of rotation (omega x J omega) included."""
    weight = GRAVITY * (1.0, 0.0, 1.0) if strains.startswith("planar") else GRAVITY
    made = scene(strains, nodes, rod.Gravity(tuple(weight)))
    made = made.variational() if not strains.startswith("planar") else made
    state = smooth(made, 3)
    weights = np.repeat(made.rule.weights, made.rod.strain_set.n_fields)
    mine = -weights * residual_of(made, state)
    exact = np.asarray(lagrange(made)(*state)).ravel()
    assert np.abs(mine - exact).max() <= 1e-7 * np.abs(exact).max()


def test_the_usual_balance_tends_to_the_variational_one() -> None:
    """Moments and forces, each in parts of the largest, at a smooth state of a rod that turns fast."""
    made = scene("cosserat", 6, rod.Gravity(tuple(GRAVITY)), rod.TipWrench((0.2, -0.3, 0.1), (0.01, 0.02, -0.01)))
    state = smooth(made, 4, (1.5, 30.0, 60.0))
    usual, other = (residual_of(s, state).reshape(-1, 6) for s in (made, made.variational()))
    for rows in (slice(0, 3), slice(3, 6)):
        assert np.abs(usual - other)[:, rows].max() <= 1e-3 * np.abs(other)[:, rows].max()


def test_the_iteration_matrix_takes_inertia_as_a_dead_load() -> None:
    """Exact in accelerations, in rates and inputs but for inertia; the shape feels the inertia as a dead force."""
    made = scene(
        "cosserat",
        2,
        rod.Gravity(tuple(GRAVITY)),
        rod.KelvinVoigt(1e-2, 1e-2, 1.0, 1.0),
        rod.LinearDrag(5.0),
        rod.TipWrench(rod.Input("f", 3)),
    )
    assert not rod.LinearDrag(5.0).weak(made.rod)  # weak drag is left out
    xi, xi_t, xi_tt = smooth(made, 6)
    n, u = made.n_strains, np.array([0.3, -0.2, 0.4])
    blocks = [np.asarray(b) for b in motion_residual(made).jacobian()(xi, xi_t, xi_tt, u, np.zeros(n))]
    x, v, a, w = (ca.SX.sym(name, size) for name, size in (("x", n), ("v", n), ("a", n), ("w", 3)))
    scale = ca.DM(1.0 / made.nominal_residual)
    force = ca.SX.sym("force", 3, made.nodes)
    full = made.balance(x, v, a, w)
    dead = made.balance(x, ca.SX(n, 1), None, w, dead_force=force).residual
    massless = made.balance(x, v, None, w).residual
    slopes = [ca.jacobian(scale * r, s) for r, s in ((massless, v), (full.residual, a), (massless, w))]
    stiffness = ca.jacobian(scale * dead, x)
    inertia = np.asarray(ca.Function("inertia", [x, v, a, w], [full.inertial_force])(xi, xi_t, xi_tt, u))
    exact = [np.asarray(ca.Function("slope", [x, w, force], [stiffness])(xi, u, inertia))]
    exact += [np.asarray(ca.Function("slope", [x, v, a, w], [s])(xi, xi_t, xi_tt, u)) for s in slopes]
    for mine, wanted in zip(blocks, exact, strict=True):
        assert mine == pytest.approx(wanted, rel=1e-9, abs=1e-9 * np.abs(wanted).max())
    assert np.abs(inertia).max() > 0.1


def test_a_linearisation_differentiates_the_accelerations_of_a_moving_rod() -> None:
    """In shape, rate and inputs, at a state whose rates count (drag is quadratic): central differences."""
    made = scene("kirchhoff", 2, rod.QuadraticDrag(2.0), rod.KelvinVoigt(1e-2, 1e-2), rod.TipWrench(rod.Input("f", 3)))
    n = made.n_strains
    xi, xi_t, _ = smooth(made, 7, (2.0, 20.0, 0.0))
    point = np.concatenate([xi, xi_t, [0.3, -0.2, 0.4]])
    found = made.linearise(point)
    mine = np.hstack([found.A[n:], found.B[n:]])
    for k, h in enumerate(np.concatenate([np.full(n, 1e-5), np.full(n, 1e-3), np.full(3, 1e-4)])):
        ends = []
        for sign in (1.0, -1.0):
            moved = point.copy()
            moved[k] += sign * h
            ends.append(np.asarray(made.acceleration(moved[:n], moved[n : 2 * n], moved[2 * n :])).ravel())
        slope = (ends[0] - ends[1]) / (2.0 * h)
        assert mine[:, k] == pytest.approx(slope, rel=1e-5, abs=1e-5 * np.abs(slope).max())
    assert np.array_equal(found.A[:n], np.eye(n, 2 * n, n)) and not found.B[:n].any()


def test_tendons_have_no_friction_and_reach_the_tip_unless_told() -> None:
    made = (
        rod.Tendons.parallel(0.01, (0,), rod.Tension()),
        rod.Tendons.helical(0.01, 0.3, (0,), rod.Tension()),
        rod.Tendons.converging(0.01, 0.005, LENGTH, (0,), rod.Tension()),
    )
    assert {t.friction for t in made} == {0.0} and {t.end for t in made} == {None}
    assert {t.name for t in made} == {"tendons"}


def test_a_tendon_along_a_twisted_rod_is_a_helix() -> None:
    """Twist k at rest: length L sqrt(1 + (k r)^2) before it is pulled."""
    body = rod.Rod(LENGTH, SECTION, MATERIAL, rest_curvature=(0.0, 0.0, 9.0))
    lengths = rod.Tendons([[0.03, 0.04]], rod.Tension()).unpulled_lengths(body, rod.Scene(body, nodes=3).rule)
    assert lengths == pytest.approx([LENGTH * np.sqrt(1.0 + 0.45**2)], rel=1e-12)
