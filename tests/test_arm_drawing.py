"""Arms from drawings: what the words say is what the scene does."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import pisplit as ps
from pisplit.models import rod

WORDS: dict[str, Any] = {
    "length": 0.4,
    "radius": 0.6e-3,
    "material": "nitinol",
    "offset": 8e-3,
    "angles_deg": (0, 90, 180, 270),
    "mass": 0.02,
    "tip_mass": 0.012,
    "damping_ratio": 0.06,
    "nodes": 4,
}


def test_a_drawn_arm_weighs_and_rings_as_its_words_say() -> None:
    arm = ps.TendonArm(**WORDS, down="+z")
    modes = arm.scene.modes(arm.scene.statics().solve(arm.rest_inputs).state, 1)
    assert modes.damping[0] == pytest.approx(0.06, rel=1e-3)
    section = arm.scene.rod.section
    assert arm.scene.rod.material.density * section.area * 0.4 == pytest.approx(0.02)
    assert arm.scene.n_inputs == 4 and np.allclose(np.rad2deg(arm.tendon_angles) % 360, WORDS["angles_deg"])
    eq = arm.scene.statics().solve(arm.rest_inputs)
    np.testing.assert_allclose(eq.tip[:2], 0.0, atol=1e-9)  # it hangs straight
    assert (eq.tensions > 0.0).all()


def test_the_arm_of_the_paper_drawn_in_words_is_that_arm() -> None:
    paper = ps.TendonArm.paper(4)
    material = rod.Elastic(207e9, 207e9 / 2.6, 1.0)
    drawn = ps.TendonArm(
        length=0.7144, radius=0.675e-3, material=material, mass=0.034, offset=15.06e-3, down="-x", nodes=4
    )
    assert drawn.amplitude == pytest.approx(paper.amplitude) and drawn.time_step == paper.time_step == 0.03
    assert drawn.pretension == pytest.approx(paper.pretension, rel=0.1)
    u = np.add(paper.rest_inputs, [0.006, -0.003, -0.003])
    ours, theirs = (a.scene.statics().solve(u).tip for a in (drawn, paper))
    np.testing.assert_allclose(ours, theirs, atol=1e-8)


def test_a_shorter_arm_is_recorded_faster() -> None:
    long, short = (ps.TendonArm(**{**WORDS, "length": length}) for length in (0.4, 0.1))
    assert short.time_step < long.time_step


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"length": 400.0}, "is it in mm"),
        ({"material": "gold"}, "expected one of 'steel'"),
        ({"offset": 0.3e-3}, "tendons outside it"),
        ({"angles_deg": (0, 360)}, "two or more different angles"),
        ({"down": "z"}, "down"),
        ({"damping_ratio": 1.5}, "part of critical damping"),
        ({"length": None}, "misses length"),
    ],
)
def test_wrong_words_are_refused(change: dict[str, Any], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        ps.TendonArm(**{**WORDS, **change})


def test_a_scene_and_words_are_too_much() -> None:
    paper = ps.TendonArm.paper(4)
    with pytest.raises(ValueError, match="one or the other"):
        ps.TendonArm(paper.to_scene(), 1e-3, 1e-2, length=0.4)
    with pytest.raises(ValueError, match="pretension is missing"):
        ps.TendonArm(paper.to_scene())


def test_recordings_and_shapes_at_rest_of_a_drawn_arm() -> None:
    arm = ps.TendonArm(**WORDS)
    d1 = arm.record(2, steps=8, progress=False)
    assert len(d1) == 2 and d1.dt == arm.time_step and d1.n_states == 144
    again = arm.record(2, steps=8, progress=False)
    np.testing.assert_array_equal(d1.xs[1], again.xs[1])
    assert not np.array_equal(d1.us[0], arm.record(2, seed=1, steps=8, progress=False).us[0])
    exact, noisy = arm.rest_shapes(5), arm.rest_shapes(5, position_noise=1e-3, angle_noise=0.01)
    np.testing.assert_array_equal(exact.inputs, noisy.inputs)
    fields = exact.fields.reshape(5, 6, 24)
    np.testing.assert_allclose(fields[:, -1, :3], [arm.scene.statics().solve(u).tip for u in exact.inputs], atol=1e-7)
    frames = noisy.fields.reshape(5, 6, 24)[..., 3:12].reshape(-1, 3, 3)
    np.testing.assert_allclose(frames @ frames.transpose(0, 2, 1), np.tile(np.eye(3), (30, 1, 1)), atol=1e-12)
    assert noisy.position_error == 1e-3 and len(noisy) == 5 and noisy.stations == 6


@pytest.mark.parametrize(("down", "axis", "inverted"), [("+z", "z", True), ("-x", "x", False)])
def test_an_arm_is_drawn_the_way_it_hangs(down: str, axis: str, inverted: bool) -> None:
    figure = ps.TendonArm(**WORDS, down=down).plot(title="drawn")
    drawn: Any = figure.axes[0]
    assert getattr(drawn, f"{axis}axis_inverted")() == inverted
    assert "xyz"[drawn._vertical_axis] == axis
