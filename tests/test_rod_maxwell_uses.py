"""Maxwell branches in whatever else is made of a scene, and what refuses them."""

import pickle

import numpy as np
import pytest

from pisplit.models import rod
from pisplit.models.arm import TendonArm, make_episodes
from pisplit.models.arm.predictor import ArmPredictor
from pisplit.models.calibration import calibrate_from_pairs
from pisplit.models.rod.equations.prestressed import prestressed_acceleration
from pisplit.models.rod.output.codegen import board_step
from pisplit.models.rod_system import rod_system

L, E = 0.4, 4e6
BRANCHES = (rod.Maxwell(0.4, 0.05), rod.Maxwell(0.3, 0.6))


def body(strains: str = "planar", **kwargs: object) -> rod.Rod:
    return rod.Rod(
        length=L, section=rod.Circle(4e-3), material=rod.Elastic(E, E / 2.8, 1100.0), strains=strains, **kwargs
    )


PLANE = rod.Scene(body(), rod.TipWrench(force=rod.Input("push", 3)), *BRANCHES, rod.Retardation(5e-3), nodes=2)
START = PLANE.state([0.5, 0.2], [1.0, -2.0], [0.0, 0.0, 0.0], [0.3, -0.1, 0.2, 0.4])


def test_derivatives_of_a_step_are_those_of_differences():
    """State and command, overstress included."""
    stepper, u = PLANE.stepper(0.03, step=0.01, tolerance=1e-13), np.array([0.01, 0.0, 0.02])
    found = stepper.sensitivity(START, u)

    def end(x: np.ndarray, command: np.ndarray) -> np.ndarray:
        return stepper.run(command[None], x, check=False).x[-1]

    d = 1e-5
    by_state = np.array([end(START + d * e, u) - end(START - d * e, u) for e in np.eye(len(START))]).T / (2 * d)
    by_input = np.array([end(START, u + d * e) - end(START, u - d * e) for e in np.eye(3)]).T / (2 * d)
    assert np.abs(found.d_state - by_state).max() < 1e-6 * np.abs(by_state).max()
    assert np.abs(found.d_input - by_input).max() < 1e-6 * np.abs(by_input).max()
    assert np.abs(found.x - end(START, u)).max() < 1e-10


def test_all_that_moves_a_scene_agrees():
    """IDAS, Gauss, large Radau steps, the step for a controller board, and linear dynamics for a small motion."""
    u = np.array([[0.01, 0.0, 0.0], [0.0, 0.0, 0.02]])
    fine = PLANE.stepper(0.03, step=0.002).run(u, START, check=False).x
    size = np.abs(fine[:, :8]).max(axis=0)
    for found in (
        PLANE.simulator(0.03, rtol=1e-7).run(u, START, check=False).x,
        PLANE.fast_stepper(0.03, step=0.01, accuracy=1e-6).run(u, START, check=False).x,
    ):
        assert np.abs((found - fine)[:, :8] / size).max() < 2e-4
    ends = []
    for substeps in (8, 16):
        state = START
        for command in u:
            state, left = (np.asarray(v).ravel() for v in board_step(PLANE, 0.03, substeps)(state, command))
            assert left < 1e-3
        ends.append(np.abs((state - fine[-1])[:8] / size).max())
    assert ends[1] < 5e-3 and ends[1] < 0.35 * ends[0]  # of second order
    rest = np.zeros(PLANE.n_states)
    line = PLANE.linearise(rest).discretise(0.03)
    pushed = PLANE.stepper(0.03, step=0.002).run([[1e-5, 0.0, 0.0]], rest, check=False).x[-1]
    assert np.abs(pushed[:8] - line.B @ [1e-5, 0.0, 0.0]).max() < 1e-6 * np.abs(pushed[:8]).max()


def test_motions_are_checked_and_plants_resume():
    """Both kinds of checks see the error that is there; a restored or pickled plant goes on to the last bit."""
    u, scene = np.tile([0.01, 0.0, 0.0], (6, 1)), PLANE.with_nodes(3)
    errors = []
    for check, still in ((True, scene), (None, scene)):
        with pytest.warns(rod.Unresolved, match="more nodes than 3"):
            run = still.simulator(0.03).run(u, check=check)
        errors.append(run.error.largest)
    truth = PLANE.with_nodes(8).simulator(0.03, rtol=1e-7).run(u, check=False).fields(20)[..., :3]
    off = np.linalg.norm(run.fields(20)[..., :3] - truth, axis=2).max()
    assert all(0.5 * off < error < 2.0 * off for error in errors)
    plant = PLANE.simulator(0.03)
    plant.reset(x0=START)
    plant.step(u[0])
    kept = pickle.loads(pickle.dumps(plant.snapshot()))
    there = plant.step(u[1]).state
    again = pickle.loads(pickle.dumps(PLANE)).simulator(0.03)
    again.restore(kept)
    assert np.array_equal(again.step(u[1]).state, there)


@pytest.mark.parametrize("strains", ["extensible", "cosserat"])
def test_every_free_strain_creeps(strains):
    """A tapered rod with shear and stretch under a branch that hardly relaxes moves as one of 1.4 times the moduli."""
    tapered = rod.Tapered(rod.Circle(4e-3), rod.Circle(3e-3))
    push = rod.TipWrench(force=(2e-3, 1e-3, -5e-2), moment=(0.0, 0.0, 1e-4))

    def made(young: float, *terms: rod.Maxwell) -> rod.Scene:
        material = rod.Elastic(young, young / 2.8, 1100.0)
        return rod.Scene(rod.Rod(length=L, section=tapered, material=material, strains=strains), push, *terms, nodes=2)

    ends = []
    for scene in (made(E, rod.Maxwell(0.4, 1e6)), made(1.4 * E)):
        start = scene.at_rest(scene.rest_coordinates, np.zeros(0))
        run = scene.stepper(0.002, step=1e-3).run(np.empty((2, 0)), start, check=False)
        ends.append(run.x[-1, : scene.n_strains] - scene.rest_coordinates)
        if scene.branches:
            sigma = scene.layout.split(run.x[-1]).overstress
            assert np.abs(sigma - 0.4 * ends[0]).max() < 1e-6 * np.abs(sigma).max()
    assert np.abs(ends[0] - ends[1]).max() < 1e-6 * np.abs(ends[1]).max()


def test_arms_with_branches_are_recorded_and_predicted(tmp_path):
    """Episodes hold the overstress beside the fields; a prediction from rest is the recording."""
    paper = TendonArm.paper()
    arm = TendonArm((paper.scene + rod.Maxwell(0.3, 0.4)).with_nodes(3), paper.pretension, paper.amplitude)
    made = make_episodes(arm, tmp_path / "d1.h5", 1, steps=6, workers=1, progress=False)
    states = made.extra["state"][0]
    assert states.shape == (7, 2 * 9 + 9 + 3) and np.abs(states[1:, 18:27]).max() > 0.01
    found = ArmPredictor(arm, 0.03).predict(made.xs[0][0], made.us[0])
    tips = [y[:, -24:-21] for y in (found, made.xs[0])]
    assert np.abs(tips[0] - tips[1]).max() < 1e-6
    assert arm.backbone == paper.passive.with_nodes(3)
    with pytest.raises(ValueError, match="Maxwell branches, whose stress no measured state tells"):
        calibrate_from_pairs(arm, states[:-1, :18], states[1:, :18], np.zeros((6, 2, 3)), 0.03)


def test_a_control_system_of_a_scene_holds_the_overstress():
    """x' of [xi, xi_t, sigma] is what the scene does; its names tell the branches."""
    scene = rod.Scene(body(), rod.Tendons.parallel(0.01, (0, 180), drive=rod.Tension()), *BRANCHES, nodes=2)
    system = rod_system(scene)
    x, u = np.random.default_rng(0).standard_normal(8), np.array([0.2, 0.1])
    wanted = [*x[2:4], *np.asarray(scene.acceleration(x[:2], x[2:4], [*x[4:], *u])).ravel()]
    wanted += [
        f * v - s / t
        for (f, t), pair in (((0.4, 0.05), (4, 5)), ((0.3, 0.6), (6, 7)))
        for v, s in zip(x[2:4], x[list(pair)], strict=True)
    ]
    assert np.allclose(np.asarray(system.rhs(x, u)).ravel(), wanted, rtol=1e-9)
    assert system.state_names[4:] == ("w2_s1[1]", "w2_s1[2]", "w2_s2[1]", "w2_s2[2]")


def test_what_makes_no_sense_is_refused_in_one_line():
    """Numbers, branches that are one, states of other scenes, and uses that know no overstress."""
    for bad in ((-0.1, 1.0), (0.3, 0.0), (0.3, -1.0), (np.nan, 1.0), (0.3, np.inf)):
        with pytest.raises(ValueError, match=r"Maxwell (fraction|time)"):
            rod.Maxwell(*bad)
    with pytest.raises(ValueError, match=r"two Maxwell branches of 0.05 s.*give Maxwell\(0.8, 0.05\)"):
        PLANE + rod.Maxwell(0.4, 0.05)
    with pytest.raises(ValueError, match="overstress"):
        PLANE.state([0.5, 0.2], [1.0, -2.0], np.zeros(3), [0.3, -0.1])
    plain = PLANE.without(rod.Maxwell)
    for simulator in (PLANE.simulator(0.03), PLANE.stepper(0.03)):
        with pytest.raises(ValueError, match="x0"):
            simulator.run(np.zeros((2, 3)), np.zeros(plain.n_states))
    with pytest.raises(ValueError, match="Maxwell branches"):
        prestressed_acceleration(rod.Scene(body(), *BRANCHES, nodes=2))
    with pytest.raises(ValueError, match="cannot be the unknown part"):
        rod_system(PLANE, rod.Maxwell)
    assert "2 x 2 strains and rates + 4 overstresses + 3 inputs" in str(PLANE)
    assert "Maxwell branch, 0.4 of the stiffness, relaxation time 0.05 s" in str(PLANE)
