"""Calibration of arms with disks, friction and servos; fits that failed; slopes by the implicit function."""

from dataclasses import replace

import numpy as np
import pytest

from pisplit import Actuator
from pisplit.models import rod
from pisplit.models.arm.recording import random_differential
from pisplit.models.arm.sight import Sight
from pisplit.models.arm.tendon_arm import TendonArm
from pisplit.models.calibration import CalibrationError, calibrate_from_recordings, calibrate_from_shapes
from pisplit.models.calibration.model import ParametrisedArm, nominal_parameters
from pisplit.models.calibration.resting_shapes import RestingShapes, central_slope

DT = 0.03
pytestmark = pytest.mark.filterwarnings("ignore::pisplit.models.rod.Unresolved")


@pytest.fixture(scope="module")
def arm() -> TendonArm:
    return TendonArm.paper(nodes=3)


@pytest.fixture(scope="module")
def over_disks(arm: TendonArm) -> TendonArm:
    drawn = replace(arm.tendons, disks=3, friction=0.1)  # type: ignore[type-var]
    terms = [drawn if t is arm.tendons else t for t in arm.scene.terms]
    return replace(arm, scene=rod.Scene(arm.scene.rod, *terms, nodes=3))


@pytest.fixture(scope="module")
def shapes(over_disks: TendonArm) -> tuple[np.ndarray, np.ndarray]:
    u = over_disks.rest_inputs + random_differential(over_disks, 8, np.random.default_rng(0))
    solved = over_disks.scene.statics().solve_many(u)
    assert solved.success.all()
    return u, over_disks.scene.fields(solved.states, 6).reshape(8, -1)


def test_slopes_of_resting_shapes_are_those_of_the_implicit_function(
    over_disks: TendonArm, shapes: tuple[np.ndarray, np.ndarray]
) -> None:
    """Against central differences of solved shapes, and no shape is loaded from nothing a second time."""
    model = ParametrisedArm(over_disks, None, ("tendons", "bending", "friction"))
    resting = RestingShapes(model, shapes[0][:2], shapes[1][:2], 1e-3, 0.02, 6)
    x = model.first + 0.02 * np.random.default_rng(1).standard_normal(len(model.first))
    slope = resting.slope(x)
    chosen = [0, 3, 7, 13, 14]  # a point, a stiffness, the stiffness of the backbone, friction
    exact = central_slope(lambda y: resting.misses(with_entries(x, chosen, y)))(x[chosen])
    np.testing.assert_allclose(slope[:, chosen], exact, atol=2e-4 * np.abs(exact).max())


def with_entries(x: np.ndarray, where: list[int], values: np.ndarray) -> np.ndarray:
    found = x.copy()
    found[where] = values
    return found


def test_an_arm_over_disks_is_found_from_its_shapes(
    over_disks: TendonArm, shapes: tuple[np.ndarray, np.ndarray]
) -> None:
    """Its own parameters from a wrong drawing; tendons along the backbone miss the same shapes by far."""
    told = nominal_parameters(over_disks)
    start = replace(told, offset=1.1 * told.offset, stiffness=0.7 * told.stiffness, friction=0.0)
    free = ("tendons", "bending", "friction")
    found = calibrate_from_shapes(over_disks, *shapes, 2e-4, 4e-3, free=free, start=start)
    assert found.residual < 0.05
    np.testing.assert_allclose(found.parameters.offset, told.offset, atol=2e-4)
    assert found.parameters.friction == pytest.approx(0.1, abs=0.03)
    assert found.arm.tendons.disks == 3
    by_name = {e.name: e for e in found.estimates}
    assert len(by_name) == 16 and by_name["friction"].value == found.parameters.friction
    assert by_name["offset_x[1]"].identified and by_name["offset_x[1]"].error < 1e-3
    assert not by_name["slip_speed"].identified  # shapes at rest say nothing of it
    missed = abs(by_name["bending"].value - 1.0)
    assert missed < 3.0 * by_name["bending"].error < 0.3
    assert "slip_speed" in found.report() and "not identified" in found.report().splitlines()[-1]
    along = replace(over_disks.tendons, disks=None)  # type: ignore[type-var]
    scene = rod.Scene(over_disks.scene.rod, *over_disks.passive.terms, along, nodes=3)
    wrong = calibrate_from_shapes(replace(over_disks, scene=scene), *shapes, 2e-4, 4e-3, free=free, start=start)
    assert wrong.residual > 5.0 * found.residual


def test_the_state_is_found_from_positions_and_frames_where_curvatures_are_another_grids(arm: TendonArm) -> None:
    """Fields of five nodes seen by three: points are those measured, not those of a polynomial through curvatures."""
    fine = arm.scene.with_nodes(6)
    rng = np.random.default_rng(3)
    state = np.zeros(fine.n_states)
    state[: fine.n_strains] = np.linspace(0.0, 2.0, fine.n_strains) * rng.standard_normal(fine.n_strains)
    fields = fine.fields(state, 6)
    seen = Sight(arm.scene, 6)
    curvatures = np.asarray(arm.scene.coordinates(6).function(fields.ravel())).ravel()
    misses = []
    for found in (seen.state(fields.ravel()), curvatures):
        points = arm.scene.fields(np.concatenate([found, np.zeros(3)]), 6)[:, :3]
        misses.append(np.abs(points - fields[:, :3]).max())
    assert misses[0] < 0.3 * misses[1]
    own = np.concatenate([rng.standard_normal(9), 5.0 * rng.standard_normal(9), np.zeros(3)])
    again = seen.state(arm.scene.fields(own, 6).ravel())
    np.testing.assert_allclose(again, own[:18], atol=1e-6)


def test_lag_and_play_of_servos_are_found_with_the_damping(arm: TendonArm) -> None:
    """Two recordings of 12 steps whose commands are known from rest on."""
    servo, rng = Actuator(lag=0.03, play=4e-4), np.random.default_rng(5)
    fields, logs = [], []
    for _ in range(2):
        ends = random_differential(arm, 3, rng)
        way = np.linspace(0.0, 1.0, 8)[:, None]
        there, back = way * ends[0], ends[0] + way[1:] * (ends[1] - ends[0])
        log = arm.rest_inputs + np.concatenate([there, back])[:14]
        moved = servo.simulate(log, DT)[0]
        motion = arm.scene.fast_stepper(DT, step=0.015).run(
            moved[1:], arm.scene.statics().solve(log[0]).state, check=False
        )
        fields.append(motion.fields(6)[2:].reshape(12, -1))
        logs.append(log)
    start = replace(nominal_parameters(arm), damping=2.0)
    found = calibrate_from_recordings(
        arm, np.stack(fields), logs, DT, free=("damping", "lag", "play"), start=start, actuator=Actuator(0.01, 1e-4)
    )
    assert found.actuator.lag == pytest.approx(0.03, abs=1e-3)
    assert found.actuator.play == pytest.approx(4e-4, abs=2e-5)
    assert found.parameters.damping == pytest.approx(1.0, rel=0.05)
    with pytest.raises(ValueError, match="expected some of tendons"):
        calibrate_from_recordings(arm, np.stack(fields), np.stack(logs)[:, 2:], DT, free=("lag",))
    with pytest.raises(ValueError, match="inputs are 1 command logs; expected 2 of 12 rows or more"):
        calibrate_from_recordings(arm, np.stack(fields), logs[:1], DT, actuator=servo)


def test_a_fit_that_did_not_end_raises_and_says_why(
    over_disks: TendonArm, shapes: tuple[np.ndarray, np.ndarray], monkeypatch: pytest.MonkeyPatch
) -> None:
    start = replace(nominal_parameters(over_disks), bending=1.5, damping=3.0)
    fit = RestingShapes.fit
    monkeypatch.setattr(RestingShapes, "fit", lambda self: fit(self, steps=2))
    with pytest.raises(CalibrationError, match=r"no end after 2 evaluations.*1 parameters, residual") as told:
        calibrate_from_shapes(over_disks, shapes[0][:2], shapes[1][:2], free=("bending",), start=start)
    assert told.value.calibration.parameters.bending != 1.5
    assert "\n" not in str(told.value)


def test_masses_stay_masses(arm: TendonArm) -> None:
    """A backbone told too heavy has no tip of negative mass, whose motion would grow without end."""
    heavy = replace(arm.scene.rod.material, density=1.4 * arm.scene.rod.material.density)  # type: ignore[type-var, union-attr]
    known = replace(arm, scene=rod.Scene(replace(arm.scene.rod, material=heavy), *arm.scene.terms, nodes=3))
    u = arm.rest_inputs + random_differential(arm, 5, np.random.default_rng(2))
    solved = arm.scene.statics().solve_many(u)
    fields = arm.scene.fields(solved.states, 6).reshape(5, -1)
    found = calibrate_from_shapes(known, u, fields, free=("load",))
    assert found.parameters.tip_mass == pytest.approx(0.0, abs=1e-6)
