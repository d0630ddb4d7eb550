"""Pictures show what the states say, and matplotlib is there only when something is drawn."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from pisplit.models import rod
from pisplit.models.rod.dynamics.trajectory import Trajectory
from pisplit.models.rod.output import pictures

OFFSET = 0.015
ARM = rod.Scene(
    rod.Rod(0.5, rod.Circle(1e-3), rod.Elastic(207e9, 207e9 / 2.6, 8000.0)),
    rod.Gravity((-9.81, 0.0, 0.0)),
    rod.KelvinVoigt(bending=5e-4, torsion=5e-4),
    rod.Tendons.parallel(OFFSET, (0, 120, 240), rod.Displacement(1e-4)),
    nodes=3,
)
PULL = np.array([0.006, -0.003, -0.003])


@pytest.fixture(scope="module")
def motion() -> Trajectory:
    """A short motion under tendons."""
    return ARM.simulator(0.03).run(np.tile(PULL, (8, 1)), check=False)


def test_tensions_are_those_of_the_equilibrium() -> None:
    equilibrium = ARM.statics().solve(PULL)
    assert np.allclose(pictures.tensions(ARM, equilibrium.state), equilibrium.tensions, rtol=1e-12, atol=1e-12)


def test_tendons_keep_their_offset_from_the_backbone(motion: Trajectory) -> None:
    shape = pictures.shape_of(ARM, motion.x)
    assert np.allclose(shape.backbone[:, 0], 0.0)
    for line in shape.tendons:
        assert np.allclose(np.linalg.norm(line - shape.backbone, axis=-1), 1e3 * OFFSET, rtol=1e-6)


def test_a_rod_without_tendons_is_drawn_too(tmp_path: Path) -> None:
    bare = ARM.without(rod.Tendons)
    shape = pictures.shape_of(bare, bare.statics().solve().state)
    assert shape.tendons == () and shape.tensions.shape == (1, 0)
    run = bare.simulator(0.03).run(np.zeros((4, 0)), check=False)
    for figure in (pictures.plot_arm(bare, run.x), pictures.plot_strip(run, moments=3)):
        figure.savefig(tmp_path / "bare.png")
    for pull, down in ((9.81, True), (-9.81, False)):  # what hangs is drawn hanging
        scene = bare.without(rod.Gravity) + rod.Gravity((0.0, 0.0, pull))
        strip = pictures.plot_strip(scene.simulator(0.03).run(np.zeros((1, 0)), check=False), moments=2)
        assert strip.axes[0].yaxis_inverted() == down


def test_tendons_are_coloured_by_their_tension() -> None:
    state = ARM.statics().solve(PULL).state
    tension = pictures.tensions(ARM, state)[0]
    axis = pictures.plot_arm(ARM, state).axes[0]
    drawn = [line.get_color() for line in axis.get_lines()[-3:]]
    assert np.argmax(tension) == 0 and drawn[0] != drawn[1]
    assert drawn[1] == pytest.approx(drawn[2], abs=0.02)  # equal pulls, equal colours up to gravity's share


def test_figures_are_pictures(motion: Trajectory, tmp_path: Path) -> None:
    energies = {"kinetic": np.sin(motion.t) ** 2, "elastic": np.cos(motion.t) ** 2}
    made = {
        "arm": pictures.plot_arm(ARM, motion.x),
        "strip": pictures.plot_strip(motion, moments=4),
        "energy": pictures.plot_energy(motion.t, energies),
    }
    for name, figure in made.items():
        figure.savefig(tmp_path / f"{name}.png")
        pixels = np.asarray(Image.open(tmp_path / f"{name}.png").convert("L"))
        assert pixels.shape[0] > 400 and 0.002 < (pixels < 200).mean() < 0.5


def test_an_animation_runs_in_real_time(motion: Trajectory, tmp_path: Path) -> None:
    made = pictures.animate_arm(motion, tmp_path / "arm.gif", fps=20)
    with Image.open(made) as film:
        seconds = film.n_frames * film.info["duration"] / 1000.0
    assert abs(seconds - motion.t[-1]) < 0.06
    assert [p.name for p in tmp_path.iterdir()] == ["arm.gif"]


def test_bad_arguments_are_one_line(motion: Trajectory, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"gif or \.mp4"):
        pictures.animate_arm(motion, tmp_path / "arm.avi")
    with pytest.raises(ValueError, match="kinetic"):
        pictures.plot_energy(motion.t, {"kinetic": [1.0, 2.0]})
    with pytest.raises(ValueError, match="energies is empty"):
        pictures.plot_energy(motion.t, {})
    with pytest.raises(ValueError, match="states"):
        pictures.plot_arm(ARM, np.zeros(3))


def test_matplotlib_is_imported_when_a_picture_is_drawn() -> None:
    code = "import sys, pisplit.models.rod.output.pictures; sys.exit('matplotlib' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False, timeout=60).returncode == 0
