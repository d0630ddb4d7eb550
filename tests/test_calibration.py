"""Tendons identified from equilibria or pairs: the truth is found from a wrong drawing."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from pisplit.models import rod
from pisplit.models.arm.recording import random_differential
from pisplit.models.arm.tendon_arm import TendonArm
from pisplit.models.calibration.fit import (
    calibrate_from_equilibria,
    calibrate_from_pairs,
    calibrate_from_shapes,
    nominal_parameters,
)
from pisplit.models.calibration.parameters import TendonParameters
from pisplit.models.calibration.parametrised import CalibratedTendons
from pisplit.models.calibration.recordings import calibrate_from_recordings


@pytest.fixture(scope="module")
def arm() -> TendonArm:
    return TendonArm.paper(nodes=3)


@pytest.fixture(scope="module")
def wrong(arm: TendonArm) -> TendonParameters:
    told = nominal_parameters(arm)
    c, s = np.cos(0.14), np.sin(0.14)
    offset = 1.15 * told.offset @ np.array([[c, s], [-s, c]])
    return replace(told, offset=offset, stiffness=0.5 * told.stiffness, slack=told.slack + 5e-4)


def equilibria(arm: TendonArm, n: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    u = arm.rest_inputs + random_differential(arm, n, np.random.default_rng(seed))
    found = arm.scene.statics().solve_many(u)
    assert found.success.all()
    return u, found.states[:, : arm.scene.n_strains]


def test_parameters_and_their_vector_are_the_same() -> None:
    values = np.random.default_rng(0).normal(size=24)
    values[-2] = abs(values[-2])  # friction
    found = TendonParameters.of_vector(values, 0.015).vector(0.015)
    np.testing.assert_allclose(found, values, atol=1e-12)


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"stiffness": np.ones(2)}, r"offset has shape \(3, 2\); expected \(2, 2\)"),
        ({"stiffness": np.array([1.0, -1.0, 1.0])}, "stiffness = -1 N/m"),
        ({"slack": np.array([0.0, np.nan, 0.0])}, "slack has 1 NaN"),
        ({"damping": 0.0}, "damping = 0"),
        ({"friction": -0.1}, "friction = -0.1"),
    ],
)
def test_parameters_that_cannot_be_are_refused_in_one_line(arm: TendonArm, change: dict[str, Any], text: str) -> None:
    with pytest.raises(ValueError, match=text) as found:
        replace(nominal_parameters(arm), **change)
    assert "\n" not in str(found.value)


def test_sixteen_equilibria_and_a_wrong_drawing_give_the_arm_to_a_twentieth_of_a_millimetre(
    arm: TendonArm, wrong: TendonParameters
) -> None:
    found = calibrate_from_equilibria(arm, *equilibria(arm, 16, 0), start=wrong)
    assert found.residual < 1e-3
    u, strains = equilibria(arm, 20, 1)
    solved = found.arm.scene.statics().solve_many(u)
    n = arm.scene.n_strains
    exact = arm.scene.fields(np.hstack([strains, np.zeros_like(strains), u]))[..., :3]
    twin = arm.scene.fields(np.hstack([solved.states[:, :n], np.zeros_like(strains), u]))[..., :3]
    assert np.abs(twin - exact).max() < 5e-5
    np.testing.assert_allclose(found.parameters.offset, nominal_parameters(arm).offset, atol=1e-4)
    assert found.parameters.bending == pytest.approx(1.0, abs=1e-4)


def test_noisy_shapes_give_an_arm_whose_statics_are_below_the_noise(arm: TendonArm, wrong: TendonParameters) -> None:
    """1 mm on positions: a fit of the balance of forces takes the tendons to the axis, one of shapes does not."""
    u, strains = equilibria(arm, 16, 0)
    rng = np.random.default_rng(3)
    states = np.hstack([strains, np.zeros_like(strains), u])
    fields = arm.scene.fields(states, 6).reshape(16, -1).copy()
    positions = np.array([q == "p" for q in arm.scene.field_map(6).quantities])
    fields[:, positions] += 1e-3 * rng.standard_normal((16, int(positions.sum())))
    found = calibrate_from_shapes(arm, u, fields, 1e-3, 0.02, start=wrong)
    assert found.residual < 1.0
    v, exact_strains = equilibria(arm, 20, 1)
    exact = arm.scene.fields(np.hstack([exact_strains, np.zeros_like(exact_strains), v]))[..., :3]
    twin = found.arm.scene.fields(found.arm.scene.statics().solve_many(v).states)[..., :3]
    assert np.sqrt(np.mean((twin - exact) ** 2)) < 3e-4


def test_a_backbone_told_too_stiff_is_found_by_its_weight(arm: TendonArm, wrong: TendonParameters) -> None:
    body = arm.scene.rod
    stiff = replace(body, material=replace(body.material, young=1.2 * 207e9, shear=1.2 * 207e9 / 2.6))
    known = replace(arm, scene=rod.Scene(stiff, *arm.scene.terms, nodes=arm.scene.nodes))
    found = calibrate_from_equilibria(known, *equilibria(arm, 16, 0), start=wrong)
    assert found.parameters.bending == pytest.approx(1.0 / 1.2, rel=2e-3)


def test_damping_is_found_from_pairs_and_the_twin_moves_like_the_arm(arm: TendonArm, wrong: TendonParameters) -> None:
    n = arm.scene.n_strains
    rng = np.random.default_rng(2)
    u = arm.rest_inputs + random_differential(arm, 9, rng)
    motion = arm.scene.simulator(dt=0.03, rtol=1e-7).run(u[1:], arm.scene.statics().solve(u[0]).state, check=False).x
    terms = [rod.KelvinVoigt(1e-3, 1e-3) if isinstance(t, rod.KelvinVoigt) else t for t in arm.scene.terms]
    known = replace(arm, scene=rod.Scene(arm.scene.rod, *terms, nodes=arm.scene.nodes))
    first = calibrate_from_equilibria(known, *equilibria(arm, 16, 0), start=wrong)
    before, after = motion[:-1, : 2 * n], motion[1:, : 2 * n]
    moves = np.stack([u[:-1], u[1:]], axis=1)
    found = calibrate_from_pairs(known, before, after, moves, 0.03, ("damping",), first.parameters)
    assert found.parameters.damping == pytest.approx(0.5, rel=5e-3)
    assert found.samples == 8
    twin = first.with_damping(found.parameters.damping).arm.scene
    moved = twin.simulator(dt=0.03, rtol=1e-7).run(u[1:], motion[0], check=False).x
    exact = arm.scene.fields(motion)[..., :3]
    assert np.abs(arm.scene.fields(moved)[..., :3] - exact).max() < 5e-3 * np.abs(exact - exact[0]).max()


def test_calibrated_tendons_are_the_tendons_they_were_identified_from(arm: TendonArm) -> None:
    """The same geometry and stiffness, Hooke's law of what is not pulled in: statics agree to the rounding of slack."""
    told = nominal_parameters(arm)
    radius = 0.015
    damping = next(t for t in arm.scene.terms if isinstance(t, rod.KelvinVoigt))
    term = CalibratedTendons(3, radius, tuple(replace(told, rounding=1e-5).vector(radius).tolist()), damping)
    twin = arm.passive + term
    u = arm.rest_inputs + np.array([8e-3, -4e-3, -4e-3])
    exact, found = arm.scene.statics().solve(u), twin.statics().solve(u)
    assert exact.success
    assert found.success
    np.testing.assert_allclose(found.state[:12], exact.state[:12], atol=1e-6 * np.abs(exact.state[:12]).max())


@pytest.mark.parametrize(("options", "friction"), [({"disks": (0.3, 0.7144)}, 0.2), ({"disks": 2}, 0.0), ({}, 0.2)])
def test_calibrated_tendons_load_the_rod_as_those_of_the_scene_do(
    arm: TendonArm, options: dict[str, Any], friction: float
) -> None:
    """At rest and in motion, over disks and along the backbone, with and without friction that turns round."""
    slip = {"slip_speed": 3e-3} if options and friction else {}
    drawn = replace(arm.tendons, friction=friction, **options, **slip)
    real = replace(arm, scene=rod.Scene(arm.scene.rod, *[drawn if t is arm.tendons else t for t in arm.scene.terms]))
    damping = next(t for t in arm.scene.terms if isinstance(t, rod.KelvinVoigt))
    values = tuple(nominal_parameters(real).vector(0.015).tolist())
    term = CalibratedTendons(3, 0.015, values, damping, disks=options.get("disks"), rubs=friction > 0.0)
    scenes = (real.scene, real.passive + term)
    rng = np.random.default_rng(0)
    xi, rates = 0.5 * rng.standard_normal((2, 12))
    u = np.full(3, 0.05)  # taut
    moving = [s.native(s.motion_residual)(xi, rates, np.zeros(12), u) for s in scenes]
    resting = [s.statics().residual_function(xi, u) for s in scenes]
    for found in (moving, resting):
        expected = np.asarray(found[0])
        np.testing.assert_allclose(np.asarray(found[1]), expected, atol=1e-9 * np.abs(expected).max())


def test_straight_tendons_that_converge_are_those_of_the_rod_scene(arm: TendonArm) -> None:
    told = nominal_parameters(arm)
    damping = next(t for t in arm.scene.terms if isinstance(t, rod.KelvinVoigt))
    tendons = next(t for t in arm.scene.terms if isinstance(t, rod.Tendons))
    length = arm.scene.rod.length
    tips = 0.6 * told.offset @ np.array([[0.9, 0.4], [-0.4, 0.9]])
    lines = [rod.Line(tuple(a), tuple(b), length) for a, b in zip(told.offset.tolist(), tips.tolist(), strict=True)]
    exact = arm.passive + replace(tendons, offsets=lines)
    values = replace(told, rounding=1e-5, shift=tips - told.offset).vector(0.015)
    twin = arm.passive + CalibratedTendons(3, 0.015, tuple(values.tolist()), damping)
    u = arm.rest_inputs + np.array([8e-3, -4e-3, -4e-3])
    states = [scene.statics().solve(u) for scene in (exact, twin)]
    assert all(found.success for found in states)
    expected = states[0].state[:12]
    np.testing.assert_allclose(states[1].state[:12], expected, atol=1e-5 * np.abs(expected).max())


def test_tendons_that_turn_about_the_backbone_are_found_from_equilibria(arm: TendonArm) -> None:
    """20 degrees over the length: with parallel tendons 9 mm of the shape are left, with straight ones 0.06."""
    tendons = next(t for t in arm.scene.terms if isinstance(t, rod.Tendons))
    pitch = arm.scene.rod.length * 18.0
    helices = [rod.Helix(float(np.hypot(*p)), pitch, float(np.arctan2(*p[::-1]))) for p in tendons.offsets]
    turned = replace(tendons, offsets=helices)
    terms = [turned if t is tendons else t for t in arm.scene.terms]
    real = replace(arm, scene=rod.Scene(arm.scene.rod, *terms, nodes=arm.scene.nodes))
    u, v = (arm.rest_inputs + random_differential(arm, 20, np.random.default_rng(seed)) for seed in (0, 1))
    shapes, unseen = (real.scene.statics().solve_many(x) for x in (u, v))
    exact = real.scene.fields(unseen.states, 6)[..., :3]
    misses = []
    for free in (("tendons", "bending"), ("tendons", "bending", "routing")):
        found = calibrate_from_equilibria(arm, u, shapes.states[:, : arm.scene.n_strains], free)
        twin = found.arm.scene.fields(found.arm.scene.statics().solve_many(v).states, 6)[..., :3]
        misses.append(float(np.sqrt(np.mean((twin - exact) ** 2))))
    assert misses == pytest.approx([9e-3, 6e-5], rel=0.2)


def test_a_mass_at_the_tip_is_found_from_equilibria(arm: TendonArm, wrong: TendonParameters) -> None:
    """10 g on an arm of 34 g, in statics and in motion the same as the point mass of a scene."""
    real = replace(arm, scene=arm.scene + rod.PointMass(arm.scene.rod.length, 0.01))
    free = ("tendons", "bending", "load")
    found = calibrate_from_equilibria(arm, *equilibria(real, 16, 0), free, wrong)
    assert found.parameters.tip_mass == pytest.approx(0.01, rel=1e-3)
    assert found.parameters.bending == pytest.approx(1.0, abs=1e-3)
    u = arm.rest_inputs + random_differential(arm, 6, np.random.default_rng(1))
    exact, twin = (
        a.scene.simulator(dt=0.03, rtol=1e-6).run(u, check=False).fields(6)[..., :3] for a in (real, found.arm)
    )
    assert np.abs(twin - exact).max() < 1e-2 * np.abs(exact - exact[0]).max()


def test_play_between_servo_and_tendons_is_told_from_the_arm(arm: TendonArm, wrong: TendonParameters) -> None:
    """Displacements off by 0.2 mm: counted as errors of the displacements they hardly touch what is identified."""
    u, strains = equilibria(arm, 12, 0)
    fields = arm.scene.fields(np.hstack([strains, np.zeros_like(strains), u]), 6).reshape(12, -1)
    late = u + 2e-4 * np.random.default_rng(11).standard_normal(u.shape)
    misses = []
    for error in (0.0, 2e-4):
        found = calibrate_from_shapes(arm, late, fields, 3e-4, 6e-3, start=wrong, input_error=error)
        misses.append(float(np.abs(found.parameters.offset - nominal_parameters(arm).offset).max()))
    assert misses[1] < 5e-4
    assert misses[1] < 0.3 * misses[0]


def recordings(arm: TendonArm, number: int, noise: float) -> tuple[np.ndarray, np.ndarray]:
    """Fields of recordings of four steps with noise in parts of 1 mm, 0.02 and 5 %, and displacements."""
    rng = np.random.default_rng(5)
    fields, moves = [], []
    simulator = arm.scene.simulator(dt=0.03)
    for _ in range(number):
        ends = random_differential(arm, 2, rng)
        u = arm.rest_inputs + ends[0] + np.linspace(0.0, 1.0, 7)[:, None] * (ends[1] - ends[0])
        motion = simulator.run(u[1:], arm.scene.statics().solve(u[0]).state, check=False)
        fields.append(motion.fields(6)[2:].reshape(5, -1))
        moves.append(u[2:])
    clean = np.stack(fields)
    quantities = np.array(arm.scene.field_map(6).quantities)
    error = np.zeros(len(quantities))
    for name, size in (("p", 1e-3), ("R", 0.02)):
        error[quantities == name] = size
    for name in ("w", "q", "omega"):
        values = clean[..., quantities == name]
        error[quantities == name] = 0.05 * np.sqrt(np.mean((values - values.mean(axis=(0, 1))) ** 2))
    return clean + noise * error * rng.standard_normal(clean.shape), np.stack(moves)


def test_damping_is_found_from_noisy_recordings(arm: TendonArm) -> None:
    """1 mm, 1 degree, 5 % of rates: initial states are unknown, so that their noise does not pass for motion."""
    fields, moves = recordings(arm, 10, noise=1.0)
    found = calibrate_from_recordings(arm, fields, moves, 0.03, start=replace(nominal_parameters(arm), damping=2.0))
    assert found.samples == 10
    assert found.residual == pytest.approx(1.0, abs=0.2)
    assert found.parameters.damping == pytest.approx(1.0, rel=0.1)


def test_displacements_with_errors_do_not_pass_for_damping() -> None:
    arm = TendonArm.paper(nodes=4)
    fields, moves = recordings(arm, 8, noise=0.0)
    moves = moves + 2e-4 * np.random.default_rng(12).standard_normal((8, 1, 3))
    start = replace(nominal_parameters(arm), damping=2.0)
    misses = []
    for error in (0.0, 2e-4):
        found = calibrate_from_recordings(arm, fields, moves, 0.03, 3e-4, 6e-3, 0.015, start=start, input_error=error)
        misses.append(abs(found.parameters.damping - 1.0))
    assert misses[1] < 1e-3
    assert misses[1] < 0.5 * misses[0]


def test_shapes_at_rest_and_in_motion_give_the_whole_arm(arm: TendonArm, wrong: TendonParameters) -> None:
    """Shapes at rest say little of the stiffness of stiff tendons, motion says nothing of where slow ones end."""
    u, strains = equilibria(arm, 12, 0)
    rest = arm.scene.fields(np.hstack([strains, np.zeros_like(strains), u]), 6).reshape(12, -1)
    fields, moves = recordings(arm, 6, noise=0.0)
    found = calibrate_from_recordings(
        arm, fields, moves, 0.03, free=("tendons", "bending", "damping"), start=wrong, equilibria=(u, rest)
    )
    assert found.residual < 0.1
    np.testing.assert_allclose(found.parameters.offset, nominal_parameters(arm).offset, atol=2e-4)
    assert found.parameters.damping == pytest.approx(1.0, rel=0.03)


def test_a_calibrated_arm_can_be_calibrated_again_by_every_way(arm: TendonArm, wrong: TendonParameters) -> None:
    """From its own parameters, which are the answer already; damping from pairs and from recordings."""
    u, strains = equilibria(arm, 12, 0)
    n = arm.scene.n_strains
    rest = arm.scene.fields(np.hstack([strains, np.zeros_like(strains), u]), 6).reshape(12, -1)
    first = calibrate_from_equilibria(arm, u, strains, start=wrong)
    assert nominal_parameters(first.arm).vector(0.015) == pytest.approx(first.parameters.vector(0.015), abs=1e-12)
    again = calibrate_from_equilibria(first.arm, u, strains)
    assert again.residual <= 1.01 * first.residual
    np.testing.assert_allclose(again.parameters.offset, first.parameters.offset, atol=1e-4)
    seen = calibrate_from_shapes(first.arm, u[:4], rest[:4], free=("bending",))
    assert seen.parameters.bending == pytest.approx(1.0, abs=1e-3)
    motion = arm.scene.simulator(dt=0.03).run(u[1:3], arm.scene.statics().solve(u[0]).state, check=False).x
    moves = np.stack([u[:2], u[1:3]], axis=1)
    slow = first.with_damping(2.0)
    assert nominal_parameters(slow.arm).damping == 2.0
    pairs = calibrate_from_pairs(slow.arm, motion[:-1, : 2 * n], motion[1:, : 2 * n], moves, 0.03, ("damping",))
    assert pairs.parameters.damping == pytest.approx(1.0, rel=1e-2)
    fields, displacements = recordings(arm, 1, noise=0.0)
    found = calibrate_from_recordings(slow.arm, fields, displacements, 0.03)
    assert found.parameters.damping == pytest.approx(1.0, rel=2e-2)


def test_arms_that_cannot_be_calibrated_are_refused_in_one_line(arm: TendonArm) -> None:
    u, strains = equilibria(arm, 2, 0)
    tensed = replace(arm, scene=arm.passive + rod.Tendons.parallel(0.01, (0, 120, 240), rod.Tension()))
    with pytest.raises(ValueError, match="give start for others") as found:
        calibrate_from_equilibria(tensed, u, strains)
    assert "\n" not in str(found.value)


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (lambda scene: scene.without(rod.Tendons), "0 groups of tendons"),
        (lambda scene: scene + rod.Tendons([[0.01, 0.0]], name="others"), "2 groups of tendons"),
        (lambda scene: scene + rod.TipWrench(rod.Input("push", 3)), "the inputs tendons, push"),
    ],
)
def test_an_arm_has_one_group_of_tendons(arm: TendonArm, change: Callable[[rod.Scene], rod.Scene], text: str) -> None:
    with pytest.raises(ValueError, match=text) as found:
        replace(arm, scene=change(arm.scene))
    assert "\n" not in str(found.value)


def test_identified_tendons_cannot_be_pulled_in_whole(arm: TendonArm) -> None:
    told = nominal_parameters(arm)
    damping = next(t for t in arm.scene.terms if isinstance(t, rod.KelvinVoigt))
    values = replace(told, slack=np.full(3, 2e-3)).vector(0.015)
    scene = arm.passive + CalibratedTendons(3, 0.015, tuple(values.tolist()), damping)
    with pytest.raises(ValueError, match=r"pulls a tendon of 0\.7124 m by 0\.713 m"):
        scene.statics().solve([0.713, 0.0, 0.0])


def test_recordings_that_do_not_fit_are_refused_in_one_line(arm: TendonArm) -> None:
    fields, moves = np.zeros((2, 3, 144)), np.zeros((2, 3, 3))
    for given, text in (
        ((fields[:, :1], moves[:, :1]), "recordings hold one instant"),
        ((fields, moves[:, :2]), "inputs"),
        ((fields[..., :100], moves), "fields"),
    ):
        with pytest.raises(ValueError, match=text) as found:
            calibrate_from_recordings(arm, *given, 0.03)
        assert "\n" not in str(found.value)


def test_wrong_arguments_are_refused_in_one_line(arm: TendonArm) -> None:
    u, strains = equilibria(arm, 2, 0)
    for arguments, text in (
        ({"free": ("damping",)}, "equilibria say nothing of damping"),
        ({"free": ("colour",)}, "expected some of tendons, bending, damping"),
        (
            {
                "start": replace(
                    nominal_parameters(arm),
                    stiffness=np.ones(2),
                    offset=np.ones((2, 2)),
                    slack=np.zeros(2),
                    shift=np.zeros((2, 2)),
                )
            },
            "the arm has 3 inputs",
        ),
    ):
        with pytest.raises(ValueError, match=text) as found:
            calibrate_from_equilibria(arm, u, strains, **arguments)
        assert "\n" not in str(found.value)
