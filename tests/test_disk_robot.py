"""The other robot, and an arm's own equations as predictor."""

from __future__ import annotations

from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from pisplit import Actuator, Episodes
from pisplit.models import rod
from pisplit.models.arm import ArmPredictor, DiskRobot, TendonArm, disk_robot
from pisplit.models.rod.terms.disks import slipping

DT = 0.03


@pytest.fixture(scope="module")
def robot() -> DiskRobot:
    """Lag and play alone, on three nodes: quick to move."""
    made = disk_robot(1, disks=False, friction=False, noise=False)
    return DiskRobot(TendonArm.paper(3), made.drawing, made.actuator, made.noise, made.noise_angle)


@pytest.fixture(scope="module")
def recorded(robot: DiskRobot) -> Episodes:
    return robot.record(2, seed=3, steps=30, workers=1, progress=False)


def test_presets_differ_and_parts_can_be_left_out() -> None:
    whole = [disk_robot(preset) for preset in (1, 2, 3)]
    assert len({str(r.arm.scene) + str(r.actuator) for r in whole}) == 3
    for r in whole:
        tendons = r.arm.tendons
        assert isinstance(tendons, rod.Tendons) and tendons.disks and tendons.friction > 0.0 and tendons.slip_speed
        assert r.drawing == TendonArm.paper() and r.actuator.lag > 0.0 and r.actuator.play > 0.0 and r.noise
    bare = disk_robot(1, disks=False, friction=False, servos=False, noise=False)
    assert bare.arm.tendons == TendonArm.paper().tendons  # preset 1 has the drawing's stiffness and mass
    assert bare.actuator == Actuator() and not bare.noise
    with pytest.raises(ValueError, match="preset = 5; expected one of 1, 2, 3, 4"):
        disk_robot(5)


def test_the_fourth_preset_is_built_as_no_form_has_it() -> None:
    """A disk out of place, moduli that fall along the arm, friction that is larger at slow slip; same mass."""
    odd, even = disk_robot(4), disk_robot(1)
    tendons, body = odd.arm.tendons, odd.arm.scene.rod
    assert isinstance(tendons, rod.Tendons)
    moved = tendons.holes(body.length) - even.arm.tendons.holes(body.length)
    np.testing.assert_allclose(moved, [0, 0, 0, 0, 0.01, 0, 0, 0, 0], atol=1e-12)
    stiffness = body.profile([0.0, 0.5 * body.length, body.length]).stiffness[0]
    np.testing.assert_allclose(stiffness / even.arm.scene.rod.stiffness[0], [1.15, 1.0, 0.85], rtol=1e-9)
    assert body.mass_per_length == pytest.approx(even.arm.scene.rod.mass_per_length)
    shapes = [r.arm.scene.statics().solve(r.arm.rest_inputs + np.array([5e-3, -5e-3, 0.0])) for r in (odd, even)]
    tips = [r.arm.scene.fields(s.state, 2)[1, :3] for r, s in zip((odd, even), shapes, strict=True)]
    assert all(s.success for s in shapes) and np.linalg.norm(tips[0] - tips[1]) > 1e-3
    even_disks = disk_robot(4, disks=False, noise=False).arm.tendons
    assert isinstance(even_disks, rod.Tendons) and even_disks.stiction == 0.0 and even_disks.disks is None


def test_friction_at_slow_slip_is_larger_by_the_stiction() -> None:
    rates = ca.SX.sym("rates", 2, 1)
    plain, sticky = (ca.Function("sign", [rates], [slipping(rates, 1e-3, more)]) for more in (0.0, 0.5))
    for speed, factor in ((1e-6, 1.5), (5e-3, 1.0 + 0.5 * np.exp(-1.0)), (5e-2, 1.0)):
        moved = np.array([0.0, -speed])
        assert float(sticky(moved)) == pytest.approx(factor * float(plain(moved)), rel=1e-6)
    with pytest.raises(ValueError, match="give slip_speed= too"):
        rod.Tendons([(0.01, 0.0)], friction=0.1, disks=3, stiction=0.5)


def test_a_robot_that_creeps_differs_from_its_twin_in_motion_alone() -> None:
    """Same shapes at rest; under the same commands the tip is elsewhere by millimetres on the way."""
    plain, soft = (disk_robot(1, disks=False, friction=False, noise=False, creep=creep) for creep in (False, True))
    assert soft.arm.scene.without(rod.Maxwell) == plain.arm.scene and soft.drawing == plain.drawing
    assert len({disk_robot(preset, creep=True).arm.scene.branches for preset in (1, 2, 3)}) == 3
    there = [r.rest_shapes(2, seed=1).fields for r in (plain, soft)]
    assert np.abs(there[0] - there[1]).max() < 1e-8
    moved = [r.record(1, seed=1, steps=12, workers=1, progress=False).xs[0][:, -24:-21] for r in (plain, soft)]
    assert np.array_equal(moved[0][0], moved[1][0]) and np.abs(moved[0] - moved[1]).max() > 1e-3


def test_recordings_hold_commands_and_noise_of_their_seed(robot: DiskRobot, recorded: Episodes, tmp_path: Path) -> None:
    noisy = DiskRobot(robot.arm, robot.drawing, robot.actuator, {"m": 1e-3}, 0.01)
    seen = [noisy.record(2, 3, 30, path=tmp_path / "d1.h5", workers=1, progress=False) for _ in range(2)]
    np.testing.assert_array_equal(seen[0].xs[0], seen[1].xs[0])
    np.testing.assert_array_equal(Episodes.load(tmp_path / "d1.h5").xs[1], seen[0].xs[1])
    np.testing.assert_array_equal(seen[0].us[0], recorded.us[0])
    assert seen[0].provenance["noise"] == {"m": 1e-3} and seen[0].provenance["noise_angle"] == 0.01
    missed = seen[0].stacked_states() - recorded.stacked_states()
    units = np.array(recorded.units)
    assert np.std(missed[:, units == "m"]) == pytest.approx(1e-3, rel=0.1)
    assert not missed[:, units == "1/m"].any()
    frames = seen[0].xs[0][:, 3:12].reshape(-1, 3, 3)
    np.testing.assert_allclose(frames @ frames.transpose(0, 2, 1), np.broadcast_to(np.eye(3), frames.shape), atol=1e-9)
    assert np.std(frames - recorded.xs[0][:, 3:12].reshape(-1, 3, 3)) == pytest.approx(0.01 * np.sqrt(2 / 3), rel=0.3)


def test_the_arm_predicts_itself_where_it_is_told_its_servos(robot: DiskRobot, recorded: Episodes) -> None:
    told = ArmPredictor(robot.arm, DT, actuator=robot.actuator).score(recorded)
    assert told.median < 1e-8 and told.unit == "m^2" and not told.diverged.any()
    untold = ArmPredictor(robot.arm, DT).score(recorded)
    assert untold.median > 1e3 * told.median
    ahead = ArmPredictor(robot.arm, DT, actuator=robot.actuator)
    x = ahead.predict(recorded.xs[0][0], recorded.us[0])
    np.testing.assert_allclose(x, recorded.xs[0], atol=0.05, rtol=0.0)
    assert x.shape == recorded.xs[0].shape
    with pytest.raises(ValueError, match=r"0\.02"):
        ArmPredictor(robot.arm, 0.02).score(recorded)
    with pytest.raises(ValueError, match="states = 'tail'; expected one of"):
        ahead.score(recorded, "tail")
    with pytest.raises(ValueError, match="before is empty"):
        ahead.predict(recorded.xs[0][0], recorded.us[0], np.zeros((0, 3)))


def test_shapes_at_rest_are_where_play_leaves_the_arm(robot: DiskRobot) -> None:
    shapes = robot.rest_shapes(4, seed=1, stations=3)
    assert len(shapes) == 4 and shapes.stations == 3
    scene = robot.arm.scene
    exact = scene.fields(scene.statics().solve_many(shapes.inputs).states, 3).reshape(4, -1)
    off = np.abs(shapes.fields - exact)[:, -24:-21].max()
    assert 1e-4 < off < 0.05  # the play of 0.3 mm at 15 mm from the axis


def test_a_state_that_is_no_shape_of_the_arm_is_said(recorded: Episodes) -> None:
    """Positions in centimetres, or of an arm half as long."""
    ahead = ArmPredictor(TendonArm.paper(3), DT)
    x = recorded.xs[0][0].copy()
    points = np.array(recorded.units) == "m"
    for factor in (100.0, 0.5):
        wrong = np.where(points, factor * x, x)
        with pytest.warns(UserWarning, match="no shape of this arm"):
            ahead.predict(wrong, recorded.us[0][:2])


def test_columns_of_recordings_are_found_by_name_and_unit(robot: DiskRobot, recorded: Episodes) -> None:
    order = list(range(recorded.n_states))[::-1]
    mixed = Episodes(
        [x[:, order] for x in recorded.xs],
        list(recorded.us),
        DT,
        state_names=[recorded.state_names[i] for i in order],
        input_names=recorded.input_names,
        units=[recorded.units[i] for i in order],
    )
    ahead = ArmPredictor(robot.arm, DT, actuator=robot.actuator)
    found = ahead.score(mixed, "tip_velocity")
    assert found.median == pytest.approx(ahead.score(recorded, "tip_velocity").median) and found.unit == "(m/s)^2"
    with pytest.raises(ValueError, match="start"):
        ahead.score(recorded, start=-1)
