"""Paths at constant speed, rounded corners, letters of SVG files, and targets that can be reached."""

from __future__ import annotations

import pickle
import warnings

import numpy as np
import pytest

from pisplit import Dictionary, Episodes, LinearEDMDc
from pisplit import observables as ob
from pisplit.checks import Array
from pisplit.controllers import MPC, references, within_reach
from pisplit.lifted.model import LiftedModel

A = np.array([[0.9, 0.2], [-0.2, 0.85]])
GAIN = np.linalg.inv(np.eye(2) - A) @ np.array([[0.3, 0.0], [0.1, 0.4]])


def model() -> LiftedModel:
    rng, B = np.random.default_rng(0), np.array([[0.3, 0.0], [0.1, 0.4]])
    u = rng.uniform(-1.0, 1.0, (100, 2))
    x = [np.zeros(2)]
    for v in u:
        x.append(A @ x[-1] + B @ v)
    theta = Dictionary(ob.Identity(), n_states=2, n_inputs=2)
    return LinearEDMDc(theta, 1e-12).fit(Episodes([np.array(x)], [u], 0.1, outputs={"tip": (0, 1)})).lifted


def area(points: Array) -> float:
    x, y = points.T
    return 0.5 * abs(float(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y)))


@pytest.mark.parametrize("corner", [0.0, 0.02])
def test_a_square_is_run_at_constant_speed(corner: float) -> None:
    made = references.square(0.1, 4.0, [0.3, -0.2], corner, approach=0.0)
    length = 0.4 - (8.0 - 2.0 * np.pi) * corner
    t = np.linspace(0.0, 4.0, 4001)
    y = made(t)[:, :2] - [0.3, -0.2]
    assert np.isnan(made(t)[:, 2]).all()
    speed = np.linalg.norm(np.diff(y, axis=0), axis=1) / 1e-3
    assert np.median(speed) == pytest.approx(length / 4.0, rel=2e-3)
    np.testing.assert_allclose(y[0], y[-1], atol=1e-12)
    np.testing.assert_allclose(np.abs(y).max(), 0.05, atol=1e-12)
    assert area(y) == pytest.approx(0.01 - (4.0 - np.pi) * corner**2, rel=2e-3)
    again = pickle.loads(pickle.dumps(made))
    np.testing.assert_array_equal(again(t), made(t))


def test_rounded_corners_touch_both_sides_and_never_overlap() -> None:
    triangle = np.array([[0.0, 0.0], [4.0, 0.0], [0.0, 3.0]])
    points = references.rounded(triangle, 0.5)
    angles = (np.pi / 2, np.arctan2(3, 4), np.arctan2(4, 3))
    cut = sum(0.25 * (1.0 / np.tan(a / 2) - (np.pi - a) / 2) for a in angles)
    assert area(points) == pytest.approx(6.0 - cut, rel=1e-3)
    np.testing.assert_array_equal(references.rounded(triangle, 0.0), triangle)
    large = references.rounded(triangle, 100.0)
    assert (large >= -1e-12).all() and (3.0 * large[:, 0] + 4.0 * large[:, 1] <= 12.0 + 1e-9).all()
    with pytest.raises(ValueError, match="expected at most half of the side"):
        references.square(0.1, 4.0, corner=0.06)
    with pytest.raises(ValueError, match="fewer than two different points"):
        references.along([[1.0, 1.0], [1.0, 1.0]], 2.0)


def test_letters_are_those_of_the_svg_path() -> None:
    box = references.svg_points("M 1,2 h4 v3 H1 z")
    np.testing.assert_allclose(box, [[1, -2], [5, -2], [5, -5], [1, -5], [1, -2]])
    same = references.svg_points("m1 2l4 0 0 3-4 0z")
    np.testing.assert_allclose(same, box)
    k = 4.0 / 3.0 * (np.sqrt(2.0) - 1.0)  # a circle by four cubic curves, to 3e-4
    d = f"M1 0C1 {k} {k} 1 0 1S-1 {k} -1 0S-{k} -1 0 -1S1 -{k} 1 0"
    round_ = references.svg_points(d)
    np.testing.assert_allclose(np.linalg.norm(round_, axis=1), 1.0, atol=3e-4)
    parabola = references.svg_points("M0 0Q1 2 2 0T4 0", fine=2)
    np.testing.assert_allclose(parabola, [[0, 0], [1, -1], [2, 0], [3, 1], [4, 0]])
    y = references.lettering(d, 0.08, 2.0, [0.1, 0.2], approach=0.0)(np.linspace(0.0, 2.0, 200))
    np.testing.assert_allclose(np.linalg.norm(y[:, :2] - [0.1, 0.2], axis=1), 0.04, rtol=1e-2)


@pytest.mark.parametrize(
    ("path", "message"),
    [
        ("", "is no SVG path"),
        ("L 1 2", "begins with M"),
        ("M 1 2 A 1 1 0 0 0 3 4", "'A' of an SVG path is not known"),
        ("M 1 2 L 3", "takes 2 numbers; it has 1"),
        ("M 1 2 # 3 4", "is no SVG path"),
        ("M 0 0 L 1 1 Z 3 4", "is not known"),
    ],
)
def test_what_is_no_path_is_refused_in_one_line(path: str, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        references.svg_points(path)


def test_random_targets_are_equilibria_inside_the_limits() -> None:
    made = references.random_targets(model(), -0.5, [0.2, 0.4], 6, 1.5, seed=3)
    y = made.starting_at([0.0, 0.0])(1.5 * np.arange(7) + 0.1)[1:]
    u = np.linalg.solve(GAIN, y.T).T
    assert (u >= -0.5 - 1e-6).all() and (u <= np.array([0.2, 0.4]) + 1e-6).all() and len(np.unique(y, axis=0)) == 6


def test_a_reference_out_of_reach_is_put_at_the_nearest_rest_and_said() -> None:
    mpc = MPC(model(), 8, -0.5, 0.5, 0.2, output_scale=1.0)
    inside, outside = GAIN @ [0.2, -0.3], GAIN @ [0.5, 0.1] * 1.0 + 0.3 * np.linalg.inv(GAIN).T[:, 0]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        kept = within_reach(references.constant(inside), mpc, 5)
    np.testing.assert_allclose(kept(0.1 * np.arange(6)), np.tile(inside, (6, 1)))
    far = float(np.linalg.norm(outside - GAIN @ [0.5, 0.1]))  # straight off the side u1 = 0.5
    with pytest.warns(UserWarning, match=rf"6 of 11 samples .* by up to {far:.3g} at t = 0.50 s"):
        found = within_reach(references.setpoint([inside, outside], [0.0, 0.5]), mpc, 10)
    np.testing.assert_allclose(found([0.2, 0.9]), [inside, GAIN @ [0.5, 0.1]], atol=2e-3)
