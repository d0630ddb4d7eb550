"""The ablation: scenarios, noise, draws without ballast, how methods are held against each other."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pisplit import Episodes
from pisplit.models.arm.tendon_arm import TendonArm

SCRIPTS = Path(__file__).parent.parent / "scripts"


def module(name: str) -> Any:
    sys.path.insert(0, str(SCRIPTS))
    try:
        return importlib.import_module(name)
    finally:
        sys.path.remove(str(SCRIPTS))


@pytest.fixture(scope="module")
def arm_episodes() -> Episodes:
    """Fields of the paper's arm at random shapes, as if recorded."""
    scene = TendonArm.paper(nodes=4).scene
    rng = np.random.default_rng(0)
    found = scene.field_map(6)
    xs = []
    for _ in range(7):
        states = np.zeros((400, scene.n_states))
        states[:, : scene.n_strains] = 0.5 * rng.standard_normal((400, scene.n_strains))
        states[:, scene.n_strains : 2 * scene.n_strains] = rng.standard_normal((400, scene.n_strains))
        xs.append(scene.fields(states, 6).reshape(400, -1))
    return Episodes(xs, [np.zeros((399, 3))] * 7, 0.03, quantities=found.quantities)


def test_noise_has_the_size_that_is_said_and_keeps_rotations_rotations(arm_episodes: Episodes) -> None:
    scenarios = module("ablation.scenarios")
    changed = scenarios.noisy(arm_episodes, 1.0, seed=0)
    q = np.array(arm_episodes.quantities)
    before, after = arm_episodes.stacked_states(), changed.stacked_states()
    difference = after - before
    assert difference[:, q == "p"].std() == pytest.approx(1e-3, rel=0.02)
    spread = np.sqrt(np.mean(before[:, q == "q"].std(axis=0) ** 2))
    assert difference[:, q == "q"].std() == pytest.approx(0.05 * spread, rel=0.02)
    frames = after[:, q == "R"].reshape(-1, 3, 3)
    np.testing.assert_allclose(frames @ frames.transpose(0, 2, 1), np.tile(np.eye(3), (len(frames), 1, 1)), atol=1e-9)
    turns = before[:, q == "R"].reshape(-1, 3, 3).transpose(0, 2, 1) @ frames
    angles = np.arccos(np.clip((np.trace(turns, axis1=1, axis2=2) - 1) / 2, -1, 1))
    assert np.sqrt(np.mean(angles**2) / 3) == pytest.approx(np.deg2rad(1.0), rel=0.02)
    np.testing.assert_array_equal(difference[:, q == "v"], 0.0)
    assert scenarios.noisy(arm_episodes, 0.0, seed=0) is arm_episodes


def test_wrong_physics_is_wrong_in_what_is_told_not_in_what_moves() -> None:
    found = module("ablation.scenarios").scenarios()
    paper = TendonArm.paper()
    stiff = found["E 20 % too high"]
    assert stiff.arm.scene == paper.scene
    np.testing.assert_allclose(stiff.known.scene.rod.stiffness[:3], 1.2 * np.array(paper.scene.rod.stiffness[:3]))
    assert found["capstan friction"].known.scene == paper.scene
    assert found["capstan friction"].arm.scene != paper.scene
    guess = found["paper arm"].first_guess
    np.testing.assert_allclose(np.hypot(*guess.offset.T), 1.15 * 15.06e-3)


def test_hysteresis_and_routing_are_in_the_arm_that_moves_alone() -> None:
    scenarios = module("ablation.scenarios")
    found = scenarios.scenarios()
    paper = TendonArm.paper()
    twisted = found["routing error"]
    assert twisted.known.scene == paper.scene
    np.testing.assert_allclose(twisted.arm.tendon_angles, paper.tendon_angles, atol=1e-12)
    term = next(t for t in twisted.arm.scene.terms if hasattr(t, "offsets"))
    tip, base = (np.array(term.offsets[0](s)) for s in (paper.scene.rod.length, 0.0))
    assert np.rad2deg(np.arctan2(*tip[::-1]) - np.arctan2(*base[::-1])) == pytest.approx(20.0)
    assert found["backlash"].arm.scene == paper.scene
    late, _ = scenarios.equilibria("backlash", 0)
    told, _ = scenarios.equilibria("paper arm", 0)
    np.testing.assert_array_equal(late, told)  # what is commanded; where the tendons are nobody knows


def test_the_tip_load_hangs_at_the_tip() -> None:
    """10 g pull a cantilever down by F L^3 / 12 EI where stiff tendons keep its tip from turning."""
    found = module("ablation.scenarios").scenarios()["tip load"]
    body, u = found.known.scene.rod, found.known.rest_inputs
    tips = [arm.scene.fields(arm.scene.statics().solve(u).state, 2)[1, :3] for arm in (found.arm, found.known)]
    expected = 0.01 * 9.81 * body.length**3 / (12.0 * body.stiffness[0])
    assert (tips[1] - tips[0])[0] == pytest.approx(expected, rel=0.3)


def test_errors_over_sizes_are_drawn_for_every_method(tmp_path: Path) -> None:
    figures, protocol = module("ablation.figures"), module("common.protocol")
    found = module("ablation.methods").methods(tmp_path, 0)
    table = {
        ("paper arm", method, size): protocol.Summary(np.inf if "Strang" in method else 1e-4, 1e-5, 1e-3, 0.0)
        for method in found
        for size in (16, 64)
    }
    figures.draw_sizes(table, tmp_path / "sizes.png", "shape")
    assert (tmp_path / "sizes.png").stat().st_size > 10_000


def test_recordings_hold_the_pair_its_history_and_where_the_servo_was(arm_episodes: Episodes) -> None:
    protocol, methods, scenarios = module("common.protocol"), module("ablation.twin"), module("ablation.scenarios")
    rng = np.random.default_rng(1)
    episodes = Episodes(arm_episodes.xs, [rng.standard_normal((399, 3)) for _ in range(7)], 0.03)
    draw = protocol.Draw("paper arm", episodes, np.array([[1, 4], [2, 30]]), None, 0)
    scenario = scenarios.scenarios()["paper arm"]
    fields, moves = methods.recordings(draw, scenario, 2)
    np.testing.assert_array_equal(fields[1], episodes.xs[2][26:32])
    np.testing.assert_array_equal(moves[1], episodes.us[2][25:31])
    np.testing.assert_array_equal(moves[0], np.vstack([scenario.known.rest_inputs, episodes.us[1][:5]]))


def test_the_other_robot_may_have_disks_and_the_papers_arm_too() -> None:
    direct = module("ablation.direct")
    assert direct.forms("other robot 2") == (None, 10)
    assert direct.forms("paper arm") == (None, direct.DISKS)


def test_curve_over_noise_is_drawn(tmp_path: Path) -> None:
    figures, protocol = module("ablation.figures"), module("common.protocol")
    levels = {"paper arm": 0.0, "noise": 1.0, "noise, twice": 2.0}
    table = {
        (name, method, 128): protocol.Summary(1e-4 * (1 + f), 1e-5, 1e-3, 0.0)
        for name, f in levels.items()
        for method in ("L-EDMDc", "PI twin")
    }
    figures.draw_noise({"shape": table, "velocity": table}, levels, 128, tmp_path / "noise.png")
    assert (tmp_path / "noise.png").stat().st_size > 10_000


def test_a_compact_draw_holds_the_same_pairs_and_held_out_episodes(arm_episodes: Episodes) -> None:
    protocol, methods = module("common.protocol"), module("ablation.shared")
    rows = np.array([[2, 7], [0, 30], [2, 5]])
    draw = protocol.Draw("paper arm", arm_episodes, rows, None, 0)
    small = methods.compact(draw)
    assert len(small.episodes) == 2 + protocol.HELD_OUT
    np.testing.assert_array_equal(small.pairs(1).x, draw.pairs(1).x)
    np.testing.assert_array_equal(small.pairs(1).x_next, draw.pairs(1).x_next)
    np.testing.assert_array_equal(small.held_out.stacked_states(), draw.held_out.stacked_states())


def test_gains_are_over_the_best_baseline_and_need_all_of_them() -> None:
    ablation, protocol = module("ablation.ablation"), module("common.protocol")
    made = {"L-EDMDc": 4e-3, "B-EDMDc": 2e-3, "PI twin": 1e-5}
    table = {("paper arm", name, 16): protocol.Summary(value, value, value, 0.0) for name, value in made.items()}
    assert ablation.gain(table, "paper arm", 16, ablation.BASELINES) == pytest.approx(200.0)
    del table["paper arm", "B-EDMDc", 16]
    assert ablation.gain(table, "paper arm", 16, ablation.BASELINES) is None
    lost = protocol.Summary(np.inf, 1.0, np.inf, 0.75)
    assert "diverges [75 %]" in ablation.text(table | {("paper arm", "L-EDMDc", 16): lost}, "paper arm")
