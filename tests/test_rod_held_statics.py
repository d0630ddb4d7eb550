"""Equilibria with the tip held: on the stable branch, against elliptic integrals, buckling and twist."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation
from scipy.special import ellipe, ellipk

from pisplit.models import rod

LENGTH, SECTION, MATERIAL = 0.3, rod.Circle(2.5e-3), rod.Elastic(1e6, 4e5, 1070.0)


def body(strains: str) -> rod.Rod:
    return rod.Rod(LENGTH, SECTION, MATERIAL, strains)


EI, _, GJ = body("kirchhoff").stiffness[:3]


def strip(share: float) -> tuple[float, float]:
    """Height of the middle in parts of L and force in EI/L^2 of a strip with both ends clamped at ``share`` L.

    Euler's elastica: four equal arcs of modulus m with 2 E(m) / K(m) - 1 = share.
    """
    m = brentq(lambda m: 2.0 * ellipe(m) / ellipk(m) - 1.0 - share, 1e-9, 0.9)
    return np.sqrt(m) / ellipk(m), 16.0 * ellipk(m) ** 2


@pytest.mark.parametrize(("share", "nodes"), [(0.99, 12), (0.8, 20), (0.5, 28)])
def test_a_strip_with_ends_brought_together_is_the_elastica(share: float, nodes: int) -> None:
    """It is flagged that it buckled, and the shape is that of the elliptic integrals to 1e-6 L."""
    scene = rod.Scene(body("planar"), nodes=nodes)
    held = scene.statics().clamp_tip((0.0, 0.0, share * LENGTH), np.eye(3))
    assert held.success and held.stable and held.branch == "snapped" and "buckling" in held.message
    height, force = strip(share)
    assert abs(scene.fields(held.state, [0.5 * LENGTH])[0, 0]) == pytest.approx(height * LENGTH, abs=1e-6 * LENGTH)
    assert -held.force[2] == pytest.approx(force * EI / LENGTH**2, rel=3e-6)
    assert held.residual < 1e-10 and not held.state[scene.n_strains :].any()


@pytest.mark.parametrize("strains", ["kirchhoff", "extensible"])
def test_the_plane_in_which_it_buckles_is_free(strains: str) -> None:
    scene = rod.Scene(body(strains), nodes=8)
    held = scene.statics().clamp_tip((0.0, 0.0, 0.8 * LENGTH), np.eye(3))
    assert held.success and held.branch == "snapped"
    middle = scene.fields(held.state, [0.5 * LENGTH])[0]
    assert np.hypot(*middle[:2]) / LENGTH == pytest.approx(strip(0.8)[0], rel=3e-3)
    assert -held.force[2] * LENGTH**2 / EI == pytest.approx(strip(0.8)[1], rel=3e-3)


def test_a_rod_that_can_be_compressed_buckles_at_the_load_of_euler() -> None:
    """Shortened by 4 pi^2 EI / (EA L) before it leaves the straight line (clamped at both ends)."""
    scene = rod.Scene(rod.Rod(LENGTH, SECTION, MATERIAL, "extensible"), nodes=8)
    stretch = scene.rod.stiffness[5]
    at_load = 4.0 * np.pi**2 * EI / (stretch * LENGTH)
    goal = 2.0 * at_load
    held = scene.statics().clamp_tip((0.0, 0.0, LENGTH - goal), np.eye(3))
    assert held.success and held.branch == "snapped"
    assert held.load_factor == pytest.approx(at_load / goal, rel=5e-3)
    short = scene.statics().clamp_tip((0.0, 0.0, LENGTH - 0.9 * at_load), np.eye(3))
    assert short.branch == "followed" and short.load_factor == 1.0 and not short.message
    assert -short.force[2] == pytest.approx(0.9 * 4.0 * np.pi**2 * EI / LENGTH**2, rel=1e-9)


def test_turns_twist_the_rod_on_the_way() -> None:
    """One turn of a straight rod that is pulled: M = 2 pi G J / L; the pose at the end is that without the turn."""
    scene = rod.Scene(body("extensible"), nodes=5)
    goal = (0.0, 0.0, 1.001 * LENGTH)
    held = scene.statics().clamp_tip(goal, np.eye(3), turns=1.0)
    assert held.success and held.branch == "followed"
    assert held.moment[2] == pytest.approx(2.0 * np.pi * GJ / LENGTH, rel=1e-6)
    tip = scene.fields(held.state, [LENGTH])[0]
    assert tip[3:12].reshape(3, 3) == pytest.approx(np.eye(3), abs=1e-8)
    again = scene.statics().clamp_tip(goal, np.eye(3), guess=held.state, turns=-1.0)
    assert again.success and np.abs(again.moment).max() < 1e-9 * GJ / LENGTH
    with pytest.raises(ValueError, match="twists"):
        rod.Scene(body("planar")).statics().clamp_tip(goal, np.eye(3), turns=1.0)


def test_a_guess_at_rest_is_moved_on_and_another_names_the_branch() -> None:
    scene = rod.Scene(body("planar"), nodes=12)
    statics = scene.statics()
    first = statics.clamp_tip((0.0, 0.0, 0.9 * LENGTH), np.eye(3))
    on = statics.clamp_tip((0.0, 0.0, 0.8 * LENGTH), np.eye(3), guess=first.state)
    straight = statics.clamp_tip((0.0, 0.0, 0.8 * LENGTH), np.eye(3))
    assert on.success and on.branch == "followed"
    assert np.abs(on.force) == pytest.approx(np.abs(straight.force), abs=1e-9 * EI / LENGTH**2)
    other = statics.clamp_tip((0.0, 0.0, 0.8 * LENGTH), np.eye(3), guess=-0.9 * on.state[: scene.n_strains])
    assert other.success and other.branch == "given"
    assert other.state == pytest.approx(-on.state, abs=1e-8)


def test_the_second_mode_is_unstable_and_not_an_answer() -> None:
    """A strip near the shape of two waves: an equilibrium, which the conditions do not keep from sinking."""
    scene = rod.Scene(body("planar"), nodes=16)
    s = scene.rule.nodes / LENGTH
    guess = 9.0 * np.cos(4.0 * np.pi * s) / LENGTH  # four half waves: twice those of the first buckling mode
    held = scene.statics().clamp_tip((0.0, 0.0, 0.9 * LENGTH), np.eye(3), guess=guess)
    assert held.residual < 1e-9 and not held.success and held.branch == "unverified" and "unstable" in held.message
    assert -held.force[2] * LENGTH**2 / EI > 3.0 * strip(0.9)[1]


def test_it_is_the_wrench_alone_that_holds_the_tip() -> None:
    """The scene with the reactions as dead loads has the same residual; gravity and a moving tip do not matter."""
    scene = rod.Scene(body("kirchhoff"), rod.Gravity((-9.81, 0.0, 0.0)), nodes=6)
    turn = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
    held = scene.statics().clamp_tip((0.05, 0.03, 0.2), turn)
    assert held.success and held.stable
    loaded = scene + rod.TipWrench(tuple(held.force), tuple(held.moment))
    x = loaded.statics().search.scaled(held.state[: scene.n_strains])
    assert loaded.statics().search.worst(x, np.empty(0)) < 1e-8
    tip = scene.fields(held.state, [LENGTH])[0]
    assert tip[:3] == pytest.approx([0.05, 0.03, 0.2], abs=1e-8) and tip[3:12].reshape(3, 3) == pytest.approx(turn)


@pytest.mark.parametrize(("strains", "clamped", "nodes"), [("planar", False, 4), ("kirchhoff", True, 5)])
def test_a_held_tip_tells_whether_the_nodes_are_enough(strains: str, clamped: bool, nodes: int) -> None:
    """The free rod is straight and resolved by any grid: it is the held one that is looked at."""
    place, found, c, s = (0.4 * LENGTH, 0.0, 0.4 * LENGTH), [], np.cos(2.5), np.sin(2.5)
    turn = np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])
    for k in (nodes, 10):
        statics = rod.Scene(body(strains), nodes=k).statics()
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            found.append(statics.clamp_tip(place, turn) if clamped else statics.pin_tip(place))
        assert found[-1].success
        assert bool(said) == (k == nodes), k
        assert all(w.category is rod.Unresolved and w.filename == __file__ for w in said)
    shapes = [f.scene.fields(f.state, np.linspace(0.05, 1.0, 20) * LENGTH)[:, :3] for f in found]
    shapes[0][:, 0] *= np.sign(shapes[0][9, 0] * shapes[1][9, 0])
    off = np.linalg.norm(shapes[0] - shapes[1], axis=1).max() / LENGTH
    assert found[0].error == pytest.approx(off, rel=0.35) and off > 2e-3
    assert found[1].error < 1e-3
    assert found[1].tip == pytest.approx(place, abs=1e-8)


def test_a_held_tip_is_checked_on_any_base() -> None:
    """A base that is turned by an input, or out of the plane: the estimate is that of the rod turned as a whole."""
    turn, place = np.array([0.0, 0.4, 0.0]), np.array([0.4 * LENGTH, 0.0, 0.4 * LENGTH])
    straight = rod.Scene(body("planar"), nodes=5).statics()
    turned = rod.Scene(body("planar"), rod.Base(rotation=rod.Input("turn", 3)), nodes=5).statics()
    rotation = Rotation.from_rotvec(turn)
    with pytest.warns(rod.Unresolved, match="nodes=") as said:
        found = [straight.pin_tip(place), turned.pin_tip(rotation.apply(place), turn)]
    assert len(said) == 2 and found[0].error > 1e-3
    assert found[1].error == pytest.approx(found[0].error, rel=1e-4)
    assert turned.clamp_tip(rotation.apply(place), rotation.as_matrix(), turn).error > 1e-3
