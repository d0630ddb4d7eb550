"""Motions that are checked: the estimate beside the true error, what is said of it, and what cannot be checked."""

import pickle
import warnings

import numpy as np
import pytest

from pisplit.models import rod
from pisplit.models.rod.dynamics.extent import Checked, Extent
from pisplit.models.rod.dynamics.motion_error import MotionError, motion_error

BODY = rod.Rod(0.5, rod.Circle(0.01), rod.Elastic(1e6, 1e6 / 3, 1000.0), strains="planar")
RATE, STIFFNESS = BODY.bending_rate, BODY.stiffness[0]
DT = 0.1 * np.pi / RATE


def plucked(nodes: int) -> tuple[rod.Scene, np.ndarray]:
    """A rod at 2 % damping and its state when a tip load that bends it by a tenth of its length is let go."""
    damping = rod.KelvinVoigt(bending=0.04 * STIFFNESS / RATE)
    scene = rod.Scene(BODY, damping, rod.TipWrench(force=rod.Input("f", 3)), nodes=nodes)
    held = scene.statics().solve([0.1 * 3.0 * STIFFNESS / 0.25, 0.0, 0.0])
    return scene, np.concatenate([held.state[:-3], np.zeros(3)])


def dropped(nodes: int) -> rod.Scene:
    """A soft pendulum that is let go from the horizontal."""
    soft = rod.Rod(0.5, rod.Circle(5e-3), rod.Elastic(5e5, 5e5 / 3, 1000.0), strains="planar")
    return rod.Scene(soft, rod.Gravity((-9.81, 0, 0)), rod.KelvinVoigt(bending=1e-6), nodes=nodes)


def test_the_estimate_is_the_error_of_the_integration_in_time() -> None:
    """A ring-down, whose shape six nodes resolve: within a fifth of the distance from a motion at rtol 1e-8."""
    scene, start = plucked(6)
    still = np.zeros((40, 3))
    fine = scene.simulator(DT, rtol=1e-8).run(still, start)
    with pytest.warns(rod.Unresolved, match=r"off by 0.00\d of its travel.* from step \d+ .*smaller rtol"):
        found = scene.simulator(DT, rtol=3e-4).run(still, start, check=True)
    assert found.error is not None and found.success
    true = motion_error(found, fine)
    assert 1e-3 < true.of_travel < 1e-2
    assert 0.8 <= found.error.of_travel / true.of_travel <= 1.2


def test_a_motion_that_is_right_says_so_and_warns_of_nothing() -> None:
    scene, start = plucked(6)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = scene.simulator(DT, rtol=1e-6).run(np.zeros((40, 3)), start, check=True)
        fixed = scene.stepper(DT, step=0.1 * DT).run(np.zeros((40, 3)), start, check=True)
    for motion in (found, fixed):
        assert motion.error is not None and motion.error.of_travel < 2e-4
        assert motion.error.distance.shape == (41,) and motion.error.distance[0] < 1e-8
        assert 0.15 * 0.5 < motion.error.travel < 0.25 * 0.5


def test_the_estimate_sees_a_grid_that_is_too_coarse() -> None:
    """The pendulum bends sharply when it swings through: six nodes are off by far more than IDAS is."""
    scene, u = dropped(6), np.zeros((24, 0))
    true = dropped(12).simulator(0.02, rtol=1e-7).run(u, np.zeros(24))
    with pytest.warns(rod.Unresolved, match="more nodes than 6"):
        found = scene.simulator(0.02, rtol=1e-6).run(u, np.zeros(12), check=True)
    assert found.error is not None
    assert 0.5 <= found.error.of_travel / motion_error(found, true).of_travel <= 2.0


def test_the_motion_of_a_stepper_is_checked_by_half_its_step() -> None:
    scene, start = plucked(6)
    still = np.zeros((20, 3))
    with pytest.warns(rod.Unresolved, match="give a smaller step"):
        found = scene.stepper(DT, step=0.5 * DT, stages=1).run(still, start, check=True)
    true = motion_error(found, scene.stepper(DT, step=0.1 * DT).run(still, start))
    assert found.error is not None and 0.7 <= found.error.of_travel / true.of_travel <= 0.8  # 1 - 1/2^2: order two


def test_checking_changes_no_state_and_survives_pickling() -> None:
    scene, start = plucked(5)
    still = np.zeros((5, 3))
    simulator = scene.simulator(DT)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", rod.Unresolved)
        checked, plain = simulator.run(still, start, check=True), simulator.run(still, start, check=False)
        again = pickle.loads(pickle.dumps(simulator)).run(still, start, check=True)
    assert np.array_equal(checked.x, plain.x) and plain.error is None
    assert checked.error is not None and np.array_equal(checked.error.distance, again.error.distance)


def test_the_first_run_is_checked_and_those_that_are_like_it_are_not() -> None:
    """Loose tolerances are told of without being asked; a motion twice as long is a new one."""
    scene, start = plucked(6)
    simulator, still = scene.simulator(DT, rtol=1e-3), np.zeros((40, 3))
    with pytest.warns(rod.Unresolved, match=r"off by 0.0\d+ of its travel.* from step \d+ .*; give a smaller rtol$"):
        first = simulator.run(still, start)
    true = motion_error(first, scene.simulator(DT, rtol=1e-8).run(still, start, check=False))
    assert first.error is not None and 1.0 <= first.error.of_travel / true.of_travel < 2.0
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        again = simulator.run(still, start)
        simulator.run(still[:30], start)
        scene.simulator(DT).run(still, start)  # the default tolerance is right here
        simulator.run(np.zeros((400, 3)), start, check=False)
    assert np.array_equal(again.x, first.x) and again.error is None
    with pytest.warns(rod.Unresolved):
        simulator.run(np.zeros((80, 3)), start)


def test_a_motion_that_is_smaller_or_rougher_than_the_ones_before_is_new() -> None:
    before = Extent(duration=1.0, size=1.0, work=100.0)
    known = Checked()
    assert known.is_new(before) and not known.is_new(before)
    assert not known.is_new(Extent(0.01, 0.5, 10.0)) and not known.is_new(Extent(1.4, 1.4, 140.0))
    for other in (Extent(1.0, 0.05, 100.0), Extent(1.0, 2.0, 100.0), Extent(2.0, 1.0, 100.0), Extent(1.0, 1.0, 200.0)):
        assert known.is_new(other) and not known.is_new(other)


@pytest.mark.parametrize("pluck", [1e-3, 0.1])
def test_a_motion_is_right_by_default(pluck: float) -> None:
    """Five periods of a ring-down, beside Gauss steps: within 1e-3 of the travel at any size."""
    scene, start = plucked(4)
    start = np.concatenate([start[:4] * pluck / 0.1, start[4:]])
    still = np.zeros((100, 3))
    found, true = scene.simulator(DT).run(still, start), scene.stepper(DT, step=DT / 8).run(still, start, check=False)
    assert motion_error(found, true).of_travel < 4e-4


def test_intervals_under_which_nothing_changes_do_not_restart_the_integrator() -> None:
    """Constant inputs, and none: as many internal steps in 40 intervals as in 160 over the same time."""
    scene, start = plucked(4)
    few, many = (scene.simulator(DT / k).run(np.zeros((40 * k, 3)), start, check=False) for k in (1, 4))
    assert abs(many.stats["nsteps"] / few.stats["nsteps"] - 1.0) < 0.1
    loose = dropped(4)
    few, many = (loose.simulator(0.02 / k).run(np.zeros((10 * k, 0)), np.zeros(8), check=False) for k in (1, 4))
    assert abs(many.stats["nsteps"] / few.stats["nsteps"] - 1.0) < 0.1


def test_a_rod_that_stays_at_rest_is_right() -> None:
    scene, _ = plucked(6)
    held = scene.statics().solve([0.5 * STIFFNESS, 0.0, 0.0]).state
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = scene.simulator(DT).run(np.tile(held[-3:], (5, 1)), held, check=True)
    assert found.error is not None and found.error.largest < 1e-5


def test_a_motion_that_ends_early_is_checked_as_far_as_it_goes_or_says_that_it_cannot_be() -> None:
    scene, start = plucked(6)
    wild = start.copy()
    wild[6:12] = 1e9
    with pytest.warns(rod.Unresolved, match="cannot be checked"):
        found = scene.simulator(DT).run(np.zeros((3, 3)), wild, check=True)
    assert not found.success and found.error is None


def test_the_figures_of_an_error() -> None:
    there = np.zeros((4, 2, 3))
    here = there + np.array([1e-3, 1e-3, 3e-3, 2e-3])[:, None, None] * np.array([0.0, 0.0, 1.0])
    here[1, 0] = there[1, 0] = [0.0, 0.0, 1.001]  # goes there and back
    error = MotionError.between(here, there)
    assert error.largest == pytest.approx(3e-3) and error.of_travel == pytest.approx(3e-3)
    assert error.drift == pytest.approx([0.0, 1e-3, 2e-3, 1e-3])
    assert error.first_above(1.5e-3) == 1 and error.first_above(2.5e-3) is None
    assert error.first_above(1e-3, least=2.5e-3) is None
    turned = np.array([[[1e-3, 0.0, 0.0]], [[0.0, 1e-3, 0.0]]])  # as far off, elsewhere
    assert MotionError.between(turned, 0.0 * turned).drift[1] == pytest.approx(np.sqrt(2.0) * 1e-3)
    still = np.zeros((2, 1, 3))
    assert MotionError.between(still, still).of_travel == 0.0
    moved = np.array([0.0, 1.0])[:, None, None] + still
    assert MotionError.between(still, moved).of_travel == float("inf")
