"""Tendons over disks: lengths and loads of chords, their limit, friction at the disks."""

import pickle

import casadi as ca
import numpy as np
import pytest
from scipy.linalg import expm

from pisplit.models import rod

STEEL = rod.Elastic(207e9, 207e9 / 2.6, 8000.0)
LENGTH, OFFSET = 0.4, 0.012


def body(strains: str = "kirchhoff", **options: object) -> rod.Rod:
    return rod.Rod(LENGTH, rod.Circle(1e-3), STEEL, strains, **options)  # type: ignore[arg-type]


def pulled(disks: object = None, drive: object = None, strains: str = "planar", **options: object) -> rod.Scene:
    drive = rod.Tension() if drive is None else drive
    tendons = rod.Tendons([(OFFSET, 0.0)], drive, disks=disks, **options)  # type: ignore[arg-type]
    return rod.Scene(body(strains), tendons, nodes=4)


def readings(scene: rod.Scene, *names: str) -> ca.Function:
    """``(xi, xi_t, u) -> `` what the tendons offer in motion."""
    xi, xi_t, _, u, balance = scene.dynamic_balance
    return ca.Function("readings", [xi, xi_t, u], [balance.loads.outputs[name] for name in names])


def test_chords_of_a_circular_arc_have_their_length() -> None:
    """2 (R - d) sin(theta / 2) from disk to disk."""
    curvature, disks = 4.0, 5
    scene = pulled(disks).with_nodes(10)
    angle = curvature * LENGTH / disks
    found = float(readings(scene, "length")(np.full(10, curvature), np.zeros(10), [1.0]))
    assert found == pytest.approx(disks * 2.0 * (1.0 / curvature - OFFSET) * np.sin(angle / 2.0), rel=1e-10)


def test_chords_of_a_rod_that_turns_and_twists_are_right_on_few_nodes() -> None:
    """Constant strains are a screw, exp(h [w, v]) from hole to hole; positions between nodes do not come into it."""
    strains, disks = np.array([3.0, -2.0, 1.5]), 5
    tendons = rod.Tendons([(OFFSET, 0.0)], rod.Tension(), disks=disks)
    scene = rod.Scene(body(), tendons, nodes=3)
    twist = np.zeros((4, 4))
    twist[:3, :3], twist[2, 3] = [[0.0, -1.5, -2.0], [1.5, 0.0, -3.0], [2.0, 3.0, 0.0]], 1.0
    pose, r = expm(twist * LENGTH / disks), np.array([OFFSET, 0.0, 0.0])
    expected = disks * np.linalg.norm(pose[:3, 3] + pose[:3, :3] @ r - r)
    found = float(readings(scene, "length")(np.tile(strains, 3), np.zeros(9), [1.0]))
    assert found == pytest.approx(expected, rel=1e-9)
    assert abs(found - LENGTH) > 1e-3


@pytest.mark.parametrize("route", [(0.01, 0.004), rod.Helix(0.012, 0.3, 0.5)])
def test_the_load_is_the_gradient_of_the_chords(route: object) -> None:
    """Virtual work: tau dl = sum_k b_k stress_k . d strain_k for any strains, by central differences."""
    backbone = body("cosserat", elements=(0.25, 0.15))
    tendons = rod.Tendons([route], rod.Tension(), end=0.25, disks=(0.05, 0.15, 0.25))  # type: ignore[list-item]
    scene = rod.Scene(backbone, tendons, rod.Base(rotation=(0.3, -0.5, 0.2)), nodes=(4, 3))
    xi, u, balance = scene.static_balance
    stress = ca.vertcat(balance.loads.stress_w, balance.loads.stress_v) * ca.repmat(ca.DM(scene.rule.weights).T, 6, 1)
    f = ca.Function("f", [xi, u], [ca.vec(stress), balance.loads.outputs["length"]])
    rng = np.random.default_rng(0)
    at = scene.rest_coordinates + np.tile([3.0, -2.0, 4.0, 0.02, 0.01, 0.05], 7) * rng.standard_normal(42)
    force = np.asarray(f(at, [2.5])[0]).ravel()
    for _ in range(5):
        way = np.tile([1.0, 1.0, 1.0, 0.01, 0.01, 0.01], 7) * rng.standard_normal(42)
        longer, shorter = (float(f(at + h * way, [2.5])[1]) for h in (1e-5, -1e-5))
        assert 2.5 * (longer - shorter) / 2e-5 == pytest.approx(force @ way, rel=1e-6)


@pytest.mark.parametrize("drive", [rod.Tension(), rod.Displacement(1e-4)])
def test_many_disks_tend_to_the_continuous_tendon_with_the_square_of_the_distance(drive: object) -> None:
    u = [25.0] if isinstance(drive, rod.Tension) else [6e-3]
    tip = pulled(drive=drive).statics().solve(u).tip
    errors = [np.linalg.norm(pulled(n, drive).statics().solve(u).tip - tip) for n in (8, 16, 32)]
    assert np.log2(errors[:-1] / np.array(errors[1:])) == pytest.approx([2.0, 2.0], abs=0.1)
    assert errors[-1] < 1e-3 * LENGTH


def test_rods_between_disks_are_columns_under_an_eccentric_load() -> None:
    """Secant formula: a piece of length h turns by 2 d q tan(q h / 2), q^2 = tau / EI."""
    disks = 4
    backbone = body("planar", elements=(LENGTH / disks,) * disks)
    offset, h = 1e-3, LENGTH / disks
    tension = 0.25 * backbone.stiffness[1] * (np.pi / h) ** 2  # a quarter of the Euler load of a piece
    scene = rod.Scene(backbone, rod.Tendons([(offset, 0.0)], rod.Tension(), disks=disks), nodes=6)
    solved = scene.statics().solve([tension])
    q = np.sqrt(tension / backbone.stiffness[1])
    turned = np.arctan2(solved.pose(LENGTH)[1][0, 2], solved.pose(LENGTH)[1][2, 2])
    assert solved.success
    assert turned == pytest.approx(disks * 2.0 * offset * q * np.tan(q * h / 2.0), rel=1e-3)
    assert turned > 1.2 * offset * q**2 * LENGTH  # 27 % more than without disks


def test_the_force_of_the_tendon_reaches_strains_that_are_not_free() -> None:
    """A Kirchhoff rod reports the shortening of a stiff Cosserat rod under the same chords."""
    tips = []
    for strains in ("kirchhoff", "cosserat"):
        scene = pulled(6, strains=strains)
        tips.append(scene.fields(scene.statics().solve([15.0]).state, [0.1, 0.3])[:, 12:18])
    assert tips[0] == pytest.approx(tips[1], abs=1e-4 * np.abs(tips[1]).max())
    assert tips[0][:, 2] - 1.0 == pytest.approx(tips[1][:, 2] - 1.0, rel=1e-2)


def test_a_rod_that_its_nodes_do_not_resolve_between_disks_is_said_to_need_elements() -> None:
    with pytest.warns(rod.Unresolved, match="loads jump at disks: cut the rod into elements from disk to disk"):
        pulled(4).with_nodes(2).statics().solve([60.0])


# Friction ------------------------------------------------------------------------------------------------------------


def test_capstan_friction_falls_by_the_angle_at_every_disk() -> None:
    curvature, disks, mu = 4.0, 5, 0.3
    scene = pulled(disks, friction=mu)
    xi, u, balance = scene.static_balance
    found = ca.Function("f", [xi, u], [balance.loads.outputs["chord_tension"]])(np.full(4, curvature), [7.0])
    angles = curvature * LENGTH / disks * np.arange(disks)
    assert np.asarray(found).ravel() == pytest.approx(7.0 * np.exp(-mu * angles), rel=3e-6)


def test_friction_turns_round_with_the_sign_of_slip() -> None:
    curvature, disks, mu = 4.0, 5, 0.3
    read = readings(pulled(disks, friction=mu, slip_speed=1e-4), "chord_tension")
    angles = curvature * LENGTH / disks * np.arange(disks)
    for rate, sign in ((2.0, 1.0), (-2.0, -1.0), (0.0, 0.0)):
        found = np.asarray(read(np.full(4, curvature), np.full(4, rate), [7.0])).ravel()
        assert found == pytest.approx(7.0 * np.exp(-mu * sign * angles), rel=3e-6)


def test_displaced_tendons_with_friction_keep_their_mean_tension() -> None:
    rough, smooth = (pulled(8, rod.Displacement(1e-4), friction=mu) for mu in (0.2, 0.0))
    state = smooth.statics().solve([6e-3]).state
    means = []
    for scene in (rough, smooth):
        xi, u, balance = scene.static_balance
        read = ca.Function("f", [xi, u], [balance.loads.outputs["chord_tension"]])
        means.append(float(np.mean(np.asarray(read(state[:4], [6e-3])))))
    assert means[0] == pytest.approx(means[1], rel=1e-10)


def test_friction_takes_energy_and_gives_none() -> None:
    """Under a constant tension the work of tendons and the loss of tau times length is what friction has taken."""
    scene, tension = pulled(4, friction=0.3, slip_speed=2e-3), 8.0
    start = np.zeros(scene.n_states)
    start[-1] = tension
    motion = scene.stepper(5e-3, step=5e-4).run(np.full((60, 1), tension), start, energy=True, check=False)
    assert motion.success
    length = np.asarray(readings(scene, "length").map(61)(motion.x[:, :4].T, motion.x[:, 4:8].T, motion.u[:1].T))
    taken = -(motion.energy().work["Tendons"] + tension * (length.ravel() - length[0, 0]))
    swing = np.ptp(motion.energy().stored.kinetic)
    assert np.diff(taken).min() > -1e-6 * swing
    assert taken[-1] > 0.05 * swing
    smooth = pulled(4).stepper(5e-3, step=5e-4).run(np.full((60, 1), tension), start, energy=True, check=False)
    after = float(readings(scene, "length")(*np.split(smooth.x[-1], [4, 8])))
    assert smooth.energy().work["Tendons"][-1] == pytest.approx(tension * (length[0, 0] - after), rel=1e-5)


# The scene -----------------------------------------------------------------------------------------------------------


def test_both_schemes_move_a_rod_over_disks_alike() -> None:
    scene = pulled(4, rod.Displacement(1e-4)) + rod.Retardation(2e-3)
    u = 6e-3 * np.sin(np.linspace(0.0, 3.0, 10))[:, None]
    tips = [m.run(u).fields([LENGTH])[:, 0, :3] for m in (scene.simulator(0.02, rtol=1e-6), scene.stepper(0.02))]
    assert np.abs(tips[0] - tips[1]).max() < 1e-4 * LENGTH


def test_a_number_of_disks_is_that_many_at_equal_distances() -> None:
    even, listed = pulled(4), pulled([LENGTH * k / 4 for k in (1, 2, 3, 4)])
    assert even.fingerprint() == listed.fingerprint() == pickle.loads(pickle.dumps(listed)).fingerprint()
    assert even.fingerprint() != pulled(5).fingerprint()
    assert even.fingerprint() != pulled(4, friction=0.1).fingerprint()
    assert pulled(4, friction=0.1).fingerprint() != pulled(4, friction=0.1, slip_speed=1e-3).fingerprint()
    assert pulled(4, friction=0.0, slip_speed=1e-3).fingerprint() == even.fingerprint()


@pytest.mark.parametrize(
    ("disks", "options", "part"),
    [
        (0, {}, "disks"),
        ([0.3, 0.2], {}, "increasing"),
        ([], {}, "disks"),
        ([0.1, 0.3], {}, "end="),
        (None, {"slip_speed": 1e-3}, "slip_speed"),
        (3, {"slip_speed": 0.0}, "slip_speed"),
        (3, {"end": 0.3}, "element"),
    ],
)
def test_what_does_not_fit_is_refused_in_one_line(disks: object, options: dict[str, float], part: str) -> None:
    with pytest.raises(ValueError, match=part) as caught:
        pulled(disks, **options)
    assert "\n" not in str(caught.value)
