"""From markers to physics: what positions of a few points tell of an arm, and what they do not."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pisplit import Episodes
from pisplit.models.arm import ArmPredictor, MotionCapture, TendonArm
from pisplit.models.arm.energy_prior import energy_root
from pisplit.models.arm.marker_fit import MarkerFit
from pisplit.models.arm.marker_sight import MarkerSight
from pisplit.models.arm.recording import random_differential
from pisplit.models.calibration import calibrate_from_markers, calibrate_from_shapes, nominal_parameters

DT, NOISE, LENGTH = 0.03, 3e-4, 0.7144
pytestmark = pytest.mark.filterwarnings("ignore::pisplit.models.rod.Unresolved")


@pytest.fixture(scope="module")
def arm() -> TendonArm:
    return TendonArm.paper(nodes=3)


@pytest.fixture(scope="module")
def capture() -> MotionCapture:
    return MotionCapture((0.5, 1.0), NOISE, stations_in="L")


@pytest.fixture(scope="module")
def motions(arm: TendonArm) -> Episodes:
    """Two recordings of 40 steps, all fields."""
    return arm.record(2, seed=3, steps=40, dt=DT, workers=1, progress=False)


def seen(arm: TendonArm, motions: Episodes, capture: MotionCapture, seed: int, noise: float = NOISE) -> Episodes:
    """What the markers see of ``motions``."""
    sight, n, rng = MarkerSight(arm.scene, capture), arm.scene.n_strains, np.random.default_rng(seed)
    states = (motions.extra or {})["state"]
    xs = [np.stack([sight.look(row[: 2 * n])[0] for row in rows]) for rows in states]
    noisy = [x + noise / NOISE * sight.sizes * rng.standard_normal(x.shape) for x in xs]
    return Episodes(noisy, motions.us, motions.dt, state_names=capture.names, units=["m"] * capture.n_columns)


def test_markers_on_a_straight_arm_are_where_they_sit_in_whatever_axes(arm: TendonArm) -> None:
    """p = position + R (s e_z + offset), frames are R; derivatives against central differences."""
    turn, position, aside = np.array([0.3, -0.8, 2.0]), np.array([1.0, 2.0, 3.0]), [[0.01, 0.0, 0.0], [0.0, 0.02, 0.0]]
    capture = MotionCapture((0.2, 0.7), NOISE, frames=(2,), offsets=aside, position=position, turn=turn)
    sight, n = MarkerSight(arm.scene, capture), arm.scene.n_strains
    axes = Rotation.from_rotvec(turn)
    y = sight.look(np.zeros(2 * n))[0]
    np.testing.assert_allclose(y[:3], position + axes.apply([0.01, 0.0, 0.2]), atol=1e-12)
    np.testing.assert_allclose(y[3:6], position + axes.apply([0.0, 0.02, 0.7]), atol=1e-12)
    np.testing.assert_allclose(y[6:].reshape(3, 3), axes.as_matrix(), atol=1e-12)
    rng, pose = np.random.default_rng(0), np.concatenate([position, turn])
    state, way, turned = rng.standard_normal(2 * n), rng.standard_normal(2 * n), rng.standard_normal(6)
    _, of_state, of_pose = sight.look(state, pose)
    ahead, behind = (sight.look(state + h * way, pose + h * turned)[0] for h in (1e-5, -1e-5))
    np.testing.assert_allclose(of_state @ way + of_pose @ turned, (ahead - behind) / 2e-5, atol=1e-7)


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"stations": ()}, "one or more, above 0 and increasing"),
        ({"stations": (0.5, 0.2)}, "one or more, above 0 and increasing"),
        ({"stations": (0.5, 1.2)}, "parts of the length, up to 1"),
        ({"noise": 0.0}, "noise = 0 m"),
        ({"frames": (3,)}, "different numbers from 1 to 2"),
        ({"pose": "free"}, "expected one of 'given', 'estimated'"),
        ({"offsets": [[0.0, 0.0, 0.0]]}, r"offsets has shape \(1, 3\)"),
        ({"columns": ("x", "y")}, "2 columns; expected 6 different names"),
    ],
)
def test_markers_that_cannot_be_are_refused_in_one_line(change: dict[str, Any], text: str) -> None:
    with pytest.raises(ValueError, match=text) as told:
        MotionCapture(**{"stations": (0.5, 1.0), "noise": NOISE, "stations_in": "L", **change})
    assert "\n" not in str(told.value)


def test_columns_are_found_by_name_and_unit(arm: TendonArm, motions: Episodes) -> None:
    names = [f"p_{axis}[{k}]" for k in (6, 3) for axis in "xyz"]
    capture = MotionCapture.named(names, LENGTH, 6, NOISE)
    assert capture.at(LENGTH) == pytest.approx((LENGTH / 2, LENGTH))
    read = capture.read(motions, LENGTH)  # from all fields
    at = [(motions.state_names or ()).index(n) for n in capture.names]
    np.testing.assert_array_equal(read[0], motions.xs[0][:, at])
    table = Episodes([1e3 * read[0]], [motions.us[0]], DT, state_names=capture.names, units=["mm"] * 6)
    np.testing.assert_allclose(capture.read(table, LENGTH)[0], read[0], rtol=1e-12)
    with pytest.raises(ValueError, match="is it in mm"):
        capture.read(Episodes([1e3 * read[0]], [motions.us[0]], DT, state_names=capture.names), LENGTH)
    with pytest.raises(ValueError, match=r"no state is named 'p_x\[3\]'"):
        capture.read(Episodes([read[0]], [motions.us[0]], DT), LENGTH)
    with pytest.raises(ValueError, match="6 states, 1 markers 3 columns; name them"):
        MotionCapture((0.3,), NOISE).read(table, LENGTH)
    with pytest.raises(ValueError, match="the last marker sits at 1 m"):
        MotionCapture((1.0,), NOISE).at(LENGTH)
    with pytest.raises(ValueError, match="marker 7 of 6 stations"):
        MotionCapture.named([f"p_{a}[7]" for a in "xyz"], LENGTH, 6, NOISE)


def test_the_prior_of_motion_is_its_energy(arm: TendonArm) -> None:
    """Half the squared root times the energy: the kinetic energy of rates, and what a small bend stores and lifts.

    To the error of three nodes, 0.3 %.
    """
    rng, n, scene = np.random.default_rng(1), arm.scene.n_strains, arm.passive
    rest = scene.statics().solve([]).state  # bent by its weight
    root = energy_root(scene, rest[:n], np.zeros(0), energy=2e-3)

    def energy(change: np.ndarray) -> float:
        return float(scene.energies((rest + change)[None]).total[0])

    for part in (slice(0, n), slice(n, 2 * n)):
        change = np.zeros(2 * n)
        change[part] = 3e-3 * rng.standard_normal(n)
        stored = 0.5 * (energy(change) + energy(-change)) - energy(np.zeros(2 * n))
        assert 0.5 * 2e-3 * np.sum((root @ change) ** 2) == pytest.approx(stored, rel=1e-2)


def test_the_state_now_is_found_from_markers_within_what_is_told(
    arm: TendonArm, capture: MotionCapture, motions: Episodes
) -> None:
    """Position and velocity of the tip, four times, in standard deviations; one marker was lost on the way."""
    fit, n, d = MarkerFit(arm, capture, DT), arm.scene.n_strains, seen(arm, motions, capture, 0)
    truth = (motions.extra or {})["state"]
    tip = arm.scene.field_map(1).function
    far, spread = [], []
    for episode, k in [(e, k) for e in (0, 1) for k in (16, 32)]:
        rows = d.xs[episode][k - 8 : k + 1].copy()
        rows[3, 3:] = np.nan
        found = fit(rows, truth[episode][k - 8 : k + 1, 2 * n :])
        assert found.residual < 1.5
        y, state = (
            np.asarray(tip(np.concatenate([s, truth[episode][k, 2 * n :]]))).ravel()
            for s in (truth[episode][k, : 2 * n], found.state)
        )
        entries, slope, _ = fit.sight.look(found.state)
        sd = np.sqrt(np.diag(slope @ found.covariance @ slope.T))[-3:]
        assert (sd < 2.0 * NOISE).all()  # eight instants tell more than one, fast modes less
        far.append((y - np.asarray(tip(np.concatenate([found.state, truth[episode][k, 2 * n :]]))).ravel())[:3] / sd)
        spread.append(np.linalg.norm((y - state)[18:21]))
        assert entries[-3:] == pytest.approx(state[:3], abs=1e-9)
    assert np.sqrt(np.mean(np.square(far))) < 1.5
    assert np.median(spread) < 0.05  # m/s, of 0.3


def test_a_few_positions_in_motion_give_stiffness_and_damping_with_honest_errors(
    arm: TendonArm, capture: MotionCapture, motions: Episodes
) -> None:
    """Two markers; a drawing 15 % too stiff and damped twice too much."""
    start = replace(nominal_parameters(arm), bending=1.15, damping=2.0)
    d = seen(arm, motions, capture, 1)
    found = calibrate_from_markers(arm, d, capture, ("bending", "damping"), start, windows=4, steps=6)
    assert found.residual == pytest.approx(1.0, abs=0.15)
    for e in found.estimates:
        assert e.identified and e.error < 0.1
        assert abs(e.value - 1.0) < 3.0 * e.error
    again = calibrate_from_markers(arm, d, replace(capture, noise=NOISE / 3), ("damping",), windows=2, steps=5)
    assert again.residual > 2.0 and "times the noise told" in again.report()
    with pytest.raises(ValueError, match="longest recording has 40 steps; expected 51"):
        calibrate_from_markers(arm, d, capture, ("damping",), steps=50)


@pytest.mark.parametrize("aside", [0.0, 0.02])
def test_the_twist_of_a_straight_arm_is_seen_by_markers_beside_its_axis_alone(aside: float) -> None:
    """It hangs at rest: points on the axis do not move when it twists, and all of the spread is left."""
    arm = TendonArm(length=0.4, radius=0.7e-3, material="nitinol", offset=0.01, nodes=3)
    capture = MotionCapture((0.5, 1.0), 1e-4, stations_in="L", offsets=[[aside, 0.0, 0.0]] * 2)
    u = np.tile(arm.rest_inputs, (8, 1))
    rest = MarkerSight(arm.scene, capture).look(arm.scene.statics().solve(u[0]).state[: 2 * arm.scene.n_strains])[0]
    d = Episodes([np.tile(rest, (9, 1))], [u], arm.time_step)
    said = calibrate_from_markers(arm, d, capture, ("damping",), windows=1, steps=4).report()
    assert "damping" in said and "not identified" in said
    assert ("twist of the tip: not seen by these markers (100 % of its spread is left)" in said) == (aside == 0.0)


def test_the_pose_of_the_base_is_found_with_the_tendons(arm: TendonArm, capture: MotionCapture) -> None:
    """Nothing is told of it; the arm reaches out sideways, so that its weight says where up is."""
    turn, position = np.array([0.4, 1.0, -2.0]), np.array([0.3, -0.2, 1.1])
    u = arm.rest_inputs + random_differential(arm, 8, np.random.default_rng(0))
    states = arm.scene.statics().solve_many(u).states
    there = MarkerSight(arm.scene, capture.placed(position, turn))
    rng = np.random.default_rng(4)
    y = np.stack([there.look(s[: 2 * arm.scene.n_strains])[0] for s in states]) + NOISE * rng.standard_normal((8, 6))
    y[2, :3] = np.nan
    free = replace(capture, pose="estimated")
    found = calibrate_from_shapes(arm, u, y, free=("bending",), capture=free)
    told = {e.name: e for e in found.estimates}
    for name, value in zip(
        ("base_x", "base_y", "base_z", "turn_x", "turn_y", "turn_z"), [*position, *turn], strict=True
    ):
        assert told[name].error < 0.02
        assert abs(told[name].value - value) < 3.5 * told[name].error
    assert found.capture is not None and found.capture.pose == "given"
    with pytest.raises(ValueError, match="take the capture of a calibration"):
        ArmPredictor(arm, DT, capture=free)
    with pytest.raises(ValueError, match="lie on one line"):
        calibrate_from_shapes(arm, u[:1], y[:1], capture=free)


def test_the_predictor_starts_from_the_history_of_markers(
    arm: TendonArm, capture: MotionCapture, motions: Episodes
) -> None:
    """Without noise it follows the arm; from the last instant alone velocities are missing, and it is far off."""
    ahead = ArmPredictor(arm, DT, capture=replace(capture, noise=1e-4))
    clean = seen(arm, motions, capture, 0, noise=0.0)
    score = ahead.score(clean[:1], start=20)
    assert np.median(np.sqrt(np.concatenate(score.squared))) < 5e-4
    x, u = clean.xs[0], clean.us[0]
    before = np.vstack([arm.rest_inputs, u[:20]])
    blind = ahead.predict(x[20], u[20:24], before)
    known = ahead.predict(x[12:21], u[20:24], before)
    np.testing.assert_array_equal(known[0], x[20])
    assert np.abs(known - x[20:25]).max() < 0.2 * np.abs(blind - x[20:25]).max()
    with pytest.raises(ValueError, match="x0 has 9 instants, before 3 commands"):
        ahead.predict(x[12:21], u[20:24], before[:3])
    with pytest.warns(UserWarning, match="markers before the start are missed by"):
        ahead.predict(x[12:21] + np.array([0.0, 0.0, 0.02, 0.0, 0.0, 0.0]), u[20:21], before)
