"""Arms of several sections: closed forms, what common pulls do, data, models, control."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pisplit import BilinearEDMDc, Dictionary, Episodes
from pisplit import observables as ob
from pisplit.controllers import MPC, ClosedLoop, references
from pisplit.models import rod
from pisplit.models.arm import MultiSectionArm, TendonArm, equilibrium_table, make_episodes
from pisplit.models.arm.recording import random_displacements, random_targets
from pisplit.models.calibration import nominal_parameters

STATIONS = 2
NODES = 3


@pytest.fixture(scope="module")
def arm() -> MultiSectionArm:
    return MultiSectionArm(sections=2, tendons=3, nodes=NODES)


@pytest.fixture(scope="module")
def episodes(arm: MultiSectionArm, tmp_path_factory: pytest.TempPathFactory) -> Episodes:
    path = tmp_path_factory.mktemp("d1") / "d1.h5"
    return make_episodes(arm, path, 10, 80, stations=STATIONS, workers=1, progress=False)


@pytest.fixture(scope="module")
def model(episodes: Episodes) -> BilinearEDMDc:
    theta = Dictionary(
        ob.Constant(),
        ob.States(),
        ob.Inputs(),
        ob.Delays(inputs=1),
        ob.Bilinear(),
        n_states=episodes.n_states,
        n_inputs=episodes.n_inputs,
    )
    return BilinearEDMDc(theta, alpha=1e-4, penalty="ridge").fit(episodes[:8])


def weightless(sections: int = 2, tendons: int = 3) -> rod.Scene:
    return MultiSectionArm(sections, tendons, NODES).scene.without(rod.Gravity)


def curvatures(scene: rod.Scene, state: np.ndarray, sections: int) -> np.ndarray:
    """(S, 2) bending of the sections, which must be the same at all nodes, and no torsion."""
    found = state[: scene.n_strains].reshape(sections, NODES, 3)
    np.testing.assert_allclose(found, np.broadcast_to(found[:, :1], found.shape), atol=1e-8)
    np.testing.assert_allclose(found[..., 2], 0.0, atol=1e-8)
    return found[:, 0, :2]


# Closed forms ---------------------------------------------------------------------------------------------------------


def test_tensions_bend_the_inner_section_together_and_the_outer_one_alone() -> None:
    length, inner, outer = 0.4, 2.5, 1.5
    backbone = rod.Rod(length, rod.Circle(1e-3), rod.Elastic(200e9, 80e9, 8000.0), elements=(0.15, 0.25))
    scene = rod.Scene(
        backbone,
        rod.Tendons.parallel(0.01, (0, 120, 240), rod.Tension(), "first", end=0.15),
        rod.Tendons.parallel(0.012, (0, 120, 240), rod.Tension(), "second"),
        nodes=NODES,
    )
    arm = MultiSectionArm(scene=scene)
    assert arm.ends == (0.15, length)
    u = np.array([inner, 0, 0, outer, 0, 0])
    found = curvatures(scene, scene.statics().solve(u).state, 2)
    stiffness = backbone.stiffness[1]
    expected = np.array([0.01 * inner + 0.012 * outer, 0.012 * outer]) / stiffness
    np.testing.assert_allclose(np.abs(found[:, 1]), expected, rtol=1e-9)
    np.testing.assert_allclose(found[:, 0], 0.0, atol=1e-9)
    common = np.array([3.0, 3.0, 3.0, 7.0, 7.0, 7.0])  # no moment: the shape does not see it
    np.testing.assert_allclose(curvatures(scene, scene.statics().solve(u + common).state, 2), found, atol=1e-8)


@pytest.mark.parametrize(("sections", "tendons"), [(1, 3), (2, 3), (2, 4), (3, 3)])
def test_taut_displaced_tendons_give_constant_curvatures(sections: int, tendons: int) -> None:
    """EI k_j = sum of tension times offset over the tendons that pass; tension linear in all curvatures they pass."""
    scene = weightless(sections, tendons)
    arm = MultiSectionArm(scene=scene)
    u = random_targets(arm, 1, np.random.default_rng(0))[0]
    solved = scene.statics().solve(u)
    assert solved.success and solved.tensions.min() > 1.0
    length, stiffness, size = scene.rod.length, scene.rod.stiffness[0], scene.rod.length / sections
    points = np.concatenate([g.points(0.0, length) for g in arm.groups])
    ends = np.repeat(arm.ends, tendons)
    passes = ends[:, None] > size * np.arange(sections) + 1e-9  # (m, S)
    lever = np.stack([points[:, 1], -points[:, 0]], axis=1)  # stretch of a path by bending, and minus its moment
    path = (passes[:, :, None] * lever[:, None, :]).reshape(len(u), -1)
    pulled = ends - u
    tension = size * path / (1e-4 * pulled)[:, None]
    matrix = stiffness * np.eye(2 * sections) + path.T @ tension
    expected = -np.linalg.solve(matrix, path.T @ (u / (1e-4 * pulled))).reshape(sections, 2)
    np.testing.assert_allclose(curvatures(scene, solved.state, sections), expected, rtol=1e-6, atol=1e-7)


def test_a_section_bends_alone_where_the_others_follow(arm: MultiSectionArm) -> None:
    """``shares``: what passes through the bent section moves along, so the other section stays nearly straight."""
    scene = weightless()
    for k in range(2):
        u = arm.pretension + 8e-3 * arm.shares[:, k] * np.cos(arm.tendon_angles - 0.4)
        bent = np.linalg.norm(curvatures(scene, scene.statics().solve(u).state, 2), axis=1)
        assert bent[k] > 1.0 and bent[1 - k] < 0.03 * bent[k]


# One section is the arm that exists -----------------------------------------------------------------------------------


def test_one_section_is_the_arm_of_the_paper_to_the_last_bit() -> None:
    one, paper = MultiSectionArm(sections=1, nodes=NODES), TendonArm.paper(nodes=NODES)
    assert one.scene == paper.scene and one.scene.fingerprint() == paper.scene.fingerprint()
    draws = [random_displacements(a, 40, np.random.default_rng(5)) for a in (one, paper)]
    assert draws[0].tobytes() == draws[1].tobytes()
    assert one.differential_basis.tobytes() == paper.differential_basis.tobytes()


# Redundancy, statics --------------------------------------------------------------------------------------------------


def test_common_pulls_of_a_group_leave_a_straight_arm_straight() -> None:
    scene = weightless()
    for common in ([2e-3] * 3 + [0.0] * 3, [0.0] * 3 + [2e-3] * 3, [1e-3] * 6):
        solved = scene.statics().solve(common)
        assert np.abs(solved.state[: scene.n_strains]).max() < 1e-9
        assert solved.tensions.max() > 10.0


def test_six_inputs_reach_a_tip_in_several_ways(arm: MultiSectionArm) -> None:
    target = arm.scene.statics().solve(random_targets(arm, 1, np.random.default_rng(2))[0]).tip
    starts = arm.rest_inputs + np.array([0.0, 3e-3])[:, None] * arm.differential_basis[:, 2]
    found = [arm.scene.inverse(target, limits=(-0.03, 0.03), start=start) for start in starts]
    for way in found:
        assert way.success, way.message
        np.testing.assert_allclose(arm.scene.statics().solve(way.u).tip, target, atol=1e-6)
    assert np.abs(found[0].u - found[1].u).max() > 1e-3


def test_random_displacements_are_zero_sum_in_every_group_and_keep_tendons_taut(arm: MultiSectionArm) -> None:
    u = random_targets(arm, 100, np.random.default_rng(0))
    np.testing.assert_allclose(u.reshape(-1, 2, 3).sum(axis=2), 3 * arm.pretension, rtol=1e-9)
    b = arm.differential_basis
    np.testing.assert_allclose(b.T @ b, np.eye(4), atol=1e-12)
    moves = u - arm.pretension
    np.testing.assert_allclose(moves @ b @ b.T, moves, atol=1e-15)
    assert all(arm.scene.statics().solve(row).tensions.min() > 1.0 for row in u[:20])


# Data, models, control ------------------------------------------------------------------------------------------------


def test_data_of_six_inputs_are_named_and_start_at_rest(arm: MultiSectionArm, episodes: Episodes) -> None:
    assert episodes.n_inputs == 6 and episodes.input_names == arm.scene.input_names
    assert episodes.input_names[3:] == ("section2[0]", "section2[1]", "section2[2]")
    assert set(episodes.input_units) <= {"", "m"}
    assert episodes.input_subspace()[1].shape == (6, 4)  # common pulls were not moved
    rest = arm.scene.statics().solve(arm.rest_inputs).state
    for state in (episodes.extra or {})["state"]:
        np.testing.assert_allclose(state[0], rest, atol=1e-9)


def test_a_model_of_six_inputs_predicts_held_out_motion(model: BilinearEDMDc, episodes: Episodes) -> None:
    """Roll-outs of 2.4 s miss the tip by 5 % at most of what a prediction that stays at the start does."""
    tip = list((episodes.outputs or {})["tip"])
    for held in episodes[8:]:
        y = held.xs[0][:, tip]
        still = np.mean(np.sum((y - y[0]) ** 2, axis=1))
        assert model.score(held, "tip").median < 0.05**2 * still


def test_mpc_moves_the_tip_of_two_sections(arm: MultiSectionArm, model: BilinearEDMDc) -> None:
    plant = arm.scene.simulator(dt=0.03, stations=STATIONS)
    mpc = MPC(model.lifted, horizon=12, u_min=-0.03, u_max=0.032, du_max=0.002, track="tip", rate_weight=0.1)
    reference = references.circle(radius=0.05, period=4.0)
    log = ClosedLoop(plant, mpc).run(reference, steps=60, u0=arm.rest_inputs, progress=False)
    assert log.message == "" and log.limit_violations == 0
    missed = (log.x[:, list(log.tracked)] - log.reference)[20:, :2]  # z is free
    assert np.abs(missed).max() < 1e-3
    moved = np.abs(log.u - log.u0).reshape(-1, 2, 3).max(axis=(0, 2))
    assert (moved > 2e-4).all()  # both sections take part


# Refusals, copies -----------------------------------------------------------------------------------------------------


def own(*ends: float | None) -> rod.Scene:
    backbone = rod.Rod(0.4, rod.Circle(1e-3), rod.Elastic(200e9, 80e9, 8000.0), elements=(0.2, 0.2))
    groups = [
        rod.Tendons.parallel(0.01, (0, 120, 240), rod.Displacement(1e-4), f"g{k}", end) for k, end in enumerate(ends)
    ]
    return rod.Scene(backbone, rod.KelvinVoigt(1e-3, 1e-3), *groups, nodes=NODES)


@pytest.mark.parametrize(
    ("build", "part"),
    [
        (lambda: MultiSectionArm(sections=0), "sections = 0"),
        (lambda: MultiSectionArm(tendons=2), "tendons = 2"),
        (lambda: MultiSectionArm(2, scene=own(0.2, None)), "leave sections out"),
        (lambda: MultiSectionArm(scene=3), "rod.Scene"),  # type: ignore[arg-type]
        (lambda: MultiSectionArm(scene=own()), "0 groups of tendons"),
        (lambda: MultiSectionArm(scene=own(None, 0.2)), "ends that increase"),
        (lambda: MultiSectionArm(scene=own(0.2, 0.2)), "ends that increase"),
        (lambda: MultiSectionArm(scene=own(0.2, None) + rod.TipWrench(force=rod.Input("f", 3))), "inputs g0, g1, f"),
        (lambda: MultiSectionArm(pretension=np.nan), "pretension"),
        (lambda: MultiSectionArm(amplitude=-1.0), "amplitude"),
        (lambda: TendonArm(own(0.2, None), 0.0, 1e-3), "MultiSectionArm takes several"),
        (lambda: equilibrium_table(MultiSectionArm(nodes=NODES), 0.01), "has 2"),  # type: ignore[arg-type]
        (lambda: nominal_parameters(MultiSectionArm(nodes=NODES)), "has 2"),  # type: ignore[arg-type]
    ],
)
def test_what_does_not_fit_is_refused_in_one_line(build: Callable[[], Any], part: str) -> None:
    with pytest.raises(ValueError, match=r".+") as refused:
        build()
    assert part in str(refused.value) and "\n" not in str(refused.value)


def test_copies_are_the_same_arm(arm: MultiSectionArm, tmp_path: Path) -> None:
    again = pickle.loads(pickle.dumps(arm))
    assert again == arm and again.scene.fingerprint() == arm.scene.fingerprint()
    calm = replace(arm, amplitude=1e-3)
    assert calm.scene is arm.scene and calm.amplitude == 1e-3 and calm != arm
