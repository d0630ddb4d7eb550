"""Reference trajectories pass where and when they say, as smoothly as they say."""

import numpy as np
import pytest

from pisplit.controllers import Reference, references


def test_a_circle_keeps_its_radius_and_period() -> None:
    circle = references.circle(0.05, 6.0, center=(0.1, -0.2), plane="yz", approach=0.0)
    flat = references.circle(0.05, 6.0, center=(0.1, -0.2), phase=0.5 * np.pi, approach=0.0, width=2)
    np.testing.assert_allclose(flat([0.0, 1.5]), [[0.1, -0.15], [0.05, -0.2]])
    t = np.linspace(0.0, 12.0, 200)
    y = circle(t)
    assert np.isnan(y[:, 0]).all() and circle.track == "tip"
    np.testing.assert_allclose(np.hypot(y[:, 1] - 0.1, y[:, 2] + 0.2), 0.05)
    np.testing.assert_allclose(circle(t + 6.0), y, atol=1e-12)
    np.testing.assert_allclose(circle([1.5])[0, 1:], [0.1, -0.15])  # a quarter turn, from the first axis to the second


def test_a_circle_without_centre_is_around_the_start() -> None:
    circle = references.circle(0.05, 6.0)
    with pytest.raises(ValueError, match="starting_at"):
        circle([0.0])
    start = np.array([0.3, 0.4, 0.5])
    y = circle.starting_at(start)(np.linspace(0.0, 12.0, 400))
    np.testing.assert_allclose(y[0, :2], start[:2])
    np.testing.assert_allclose(np.hypot(*(y[100:, :2] - start[:2]).T), 0.05)
    np.testing.assert_array_equal(circle.starting_at(start).starting_at(2 * start)([0.0]), y[:1])


def test_the_approach_joins_rest_and_circle_with_two_derivatives() -> None:
    circle = references.circle(0.05, 6.0, center=(0.0, 0.0), approach=2.0).starting_at([0.01, -0.02, 0.5])
    plain, h = references.circle(0.05, 6.0, center=(0.0, 0.0), approach=0.0), 1e-3

    def derivatives(reference: Reference, t: float) -> np.ndarray:
        y = reference(t + h * np.arange(3))[:, :2]
        return np.array([y[0], (y[1] - y[0]) / h, (y[2] - 2 * y[1] + y[0]) / h**2])

    np.testing.assert_allclose(derivatives(circle, 0.0), [[0.01, -0.02], [0, 0], [0, 0]], atol=1e-3)
    np.testing.assert_allclose(derivatives(circle, 2.0 - 2 * h), derivatives(plain, 2.0 - 2 * h), atol=1e-3)
    np.testing.assert_array_equal(circle([2.0, 3.0])[:, :2], plain([2.0, 3.0])[:, :2])


def test_setpoints_switch_at_their_times() -> None:
    reference = references.setpoint([[1.0, np.nan], [2.0, 3.0]], times=[0.3, 0.6])
    y = reference.starting_at([7.0, 8.0])(0.1 * np.arange(8))  # 3 * 0.1 exceeds 0.3, 6 * 0.1 exceeds 0.6, by rounding
    np.testing.assert_array_equal(y[:, 0], [7, 7, 7, 1, 1, 1, 2, 2])
    np.testing.assert_array_equal(y[:, 1], [8, 8, 8, np.nan, np.nan, np.nan, 3, 3])
    np.testing.assert_array_equal(references.setpoint([[1.0]], [0.0])([0.0, 9.0]), [[1.0], [1.0]])


def test_waypoints_are_reached_at_rest_on_straight_lines() -> None:
    points = np.array([[1.0, 0.0, 0.0], [1.0, 2.0, 0.0]])
    reference = references.waypoints(points, times=[1.0, 3.0]).starting_at(np.zeros(3))
    np.testing.assert_allclose(reference([0.0, 1.0, 3.0, 9.0]), [np.zeros(3), points[0], points[1], points[1]])
    for stop in (0.0, 1.0, 3.0):
        speed = np.diff(reference(stop + np.array([0.0, 1e-4])), axis=0) / 1e-4
        np.testing.assert_allclose(speed, 0.0, atol=1e-5)
    peak = np.diff(reference(np.array([0.5 - 1e-5, 0.5 + 1e-5]))[:, 0])[0] / 2e-5
    assert peak == pytest.approx(1.875, rel=1e-6)  # minimum jerk: 15/8 of the mean speed, at half time


def test_a_sequence_hands_over_the_end_of_each_segment() -> None:
    reference = references.sequence(
        (references.waypoints([[0.1, 0.0, 0.0]], [1.0]), 2.0),
        (references.circle(0.05, 4.0, approach=1.0), 4.0),
        (references.constant(), np.inf),
    ).starting_at([0.0, 0.0, 0.3])
    np.testing.assert_allclose(reference([1.5, 2.0])[:, :2], [[0.1, 0.0], [0.1, 0.0]], atol=1e-12)
    y = reference(np.linspace(3.0, 5.9, 50))
    np.testing.assert_allclose(np.hypot(y[:, 0] - 0.1, y[:, 1]), 0.05)
    np.testing.assert_allclose(reference([6.0, 60.0]), [[0.15, 0.0, 0.0]] * 2, atol=1e-12)


def test_samples_are_met_exactly_and_joined_linearly() -> None:
    y = np.random.default_rng(0).standard_normal((6, 2))
    y[3, 0] = np.nan
    reference = references.from_array(y, 0.03)
    np.testing.assert_array_equal(reference(0.03 * np.arange(6)), y)
    np.testing.assert_allclose(reference([0.015, 99.0]), [(y[0] + y[1]) / 2, y[5]])


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: references.circle(-1.0, 2.0), "radius = -1; expected"),
        (lambda: references.circle(1.0, 2.0, plane="uv"), "plane = 'uv'"),
        (lambda: references.circle(1.0, 2.0, plane="xz", width=2), "width = 2; the plane 'xz' needs 3 coordinates"),
        (lambda: references.constant([0.0, 0.0], width=3), "width = 3, but the point has 2 coordinates"),
        (lambda: references.constant([[0.0, 0.0]]), "point has shape"),
        (lambda: references.from_array(np.ones((3, 2)) * 1j, 0.1), "complex"),
        (lambda: references.circle(1.0, 2.0, center=(0.0, 0.0, 0.0)), "center has shape"),
        (lambda: references.setpoint([[1.0], [2.0]], [0.0]), "times has shape"),
        (lambda: references.waypoints([[1.0], [2.0]], [1.0, 1.0]), "increasing"),
        (lambda: references.constant([np.inf, 0.0]), "infinite"),
        (lambda: references.sequence(), "empty"),
        (lambda: references.sequence((references.constant(), 1.0), (references.constant(width=2), 1.0)), "differ"),
        (lambda: references.from_array([[1.0]], 0.0), "dt = 0 s"),
        (lambda: references.constant().approached(0.0), "duration = 0"),
    ],
)
def test_wrong_arguments_raise(make: object, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make()  # type: ignore[operator]
