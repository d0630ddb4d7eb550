"""Errors of the grid in motion: the estimate beside motions on more nodes, over all kinds of motions."""

import sys
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "scripts"))

from pisplit.models import rod
from pisplit.models.rod.dynamics.motion_error import MotionError, motion_error
from pisplit.models.rod.dynamics.space_error import SpaceError
from pisplit.models.rod.dynamics.trajectory import Trajectory
from stress.motions import Motion, motions
from stress.random_scenes import build, unloaded

NAMED = motions()


def moved(motion: Motion) -> Trajectory:
    """The motion with hardly an error in time."""
    return motion.scene.simulator(motion.dt, rtol=1e-7, **motion.options).run(motion.u, motion.start, check=False)


def grown(error: MotionError) -> float:
    """Largest error of a way since the start, in parts of the travel."""
    return float(error.drift.max()) / error.travel


@pytest.mark.parametrize(
    ("name", "nodes"),
    [
        ("ring-down from 0.1 L, planar", 3),
        ("ring-down from 0.001 L, planar", 4),
        ("swimmer", 5),
        ("chamber arm", 3),
        ("rolled 2 turns", 6),
        ("2 mm on one tendon, servos there, kirchhoff", 4),
    ],
)
def test_the_estimate_is_the_error(name: str, nodes: int) -> None:
    """Within 0.6 to 1.3 of the distance from the motion on three more nodes, from 3e-4 to 0.1 of the travel."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", rod.Unresolved)
        coarse, fine = NAMED[name](nodes), NAMED[name](nodes + 3)
        found = moved(coarse)
        estimate = SpaceError(coarse.scene.statics().resolution).of(found)
        true = grown(motion_error(found, moved(fine)))
    assert 1e-5 < true < 0.1
    assert 0.6 < grown(estimate) / true < 1.3


def test_a_first_run_on_too_few_nodes_says_so() -> None:
    motion = NAMED["swimmer"](4)
    with pytest.warns(rod.Unresolved, match="from step 0 .*give more nodes than 4"):
        found = motion.scene.simulator(motion.dt).run(motion.u, motion.start)
    assert found.error is not None and 0.05 < found.error.of_travel < 0.3


def test_a_rod_at_rest_is_off_by_its_equilibrium_alone() -> None:
    """Held by its load it stays: the error does not grow, and is that of the equilibrium."""
    scene = NAMED["rolled 1 turns"](4).scene
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", rod.Unresolved)
        held = scene.statics().solve([0.0, 1.5 * np.pi * scene.rod.stiffness[1] / 0.5, 0.0])
        found = scene.simulator(0.1, rtol=1e-8).run(np.tile(held.state[-3:], (10, 1)), held.state, check=False)
    error = SpaceError(scene.statics().resolution).of(found)
    assert abs(error.distance[0] / (held.error * scene.rod.length) - 1.0) < 0.1
    assert np.abs(error.distance / error.distance[0] - 1.0).max() < 0.01


def test_a_scene_of_one_input_is_checked_too() -> None:
    """CasADi takes no entries of a vector of one for a row, which made the defect one entry too long."""
    body = rod.Rod(0.3, rod.Circle(5e-3), rod.Elastic(2e6, 8e5, 1070.0), "planar")
    pulled = rod.Tendons([(0.004, 0.0)], rod.Tension())
    run = rod.Scene(body, pulled, rod.Retardation(0.02), nodes=4).simulator(0.02).run(np.full((6, 1), 0.02))
    assert run.success and run.error is not None


@pytest.mark.parametrize(("nodes", "silent"), [(4, False), (7, True)])
@pytest.mark.parametrize("scheme", ["fast", "gauss"])
def test_steps_of_any_scheme_are_judged_in_space(scheme: str, nodes: int, silent: bool) -> None:
    """A soft rod that is let go under its weight: its error is known, and told where it is large."""
    body = rod.Rod(0.3, rod.Circle(4e-3), rod.Elastic(4e6, 1.4e6, 1100.0), "planar")
    scene = rod.Scene(body, rod.Retardation(0.02), rod.Gravity((9.81, 0.0, 0.0)), nodes=nodes)
    mover = scene.fast_stepper(0.02) if scheme == "fast" else scene.stepper(0.02, step=5e-3)
    commands, start = np.empty((15, 0)), np.zeros(2 * nodes)
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        found = mover.run(commands, start)
    fine = Motion(scene.with_nodes(nodes + 4), 0.02, commands, np.zeros(2 * nodes + 8))
    true = grown(motion_error(found, moved(fine)))
    assert found.error is not None and grown(found.error) == pytest.approx(true, rel=0.3, abs=3e-4)
    assert (true < 1e-3) == silent == (not told)
    assert silent or "give more nodes than 4" in str(told[0].message)


def test_waves_that_are_taken_for_errors_are_looked_at_on_the_finer_grid() -> None:
    """Shear of a thin steel rod that is let go: by its accelerations the motion is off by a hundred of its travel."""
    terms: list[dict[str, Any]] = [{"term": "damping", "ratio": 1.1}]
    terms += [{"term": "tip force", "size": 0.02, "angle_deg": 45.0, "follower": False}]
    terms += [{"term": "chambers", "offset": 0.01, "size": 0.0504}]
    described = {"strains": "planar-cosserat", "nodes": 5, "elements": 1, "section": "circle", "terms": terms}
    described |= {"length": 0.0367, "slenderness": 0.00281, "young": 149e9, "density": 1030.0, "rest_curvature": 0.5}
    scene, dt, commands = build({**described, "interval": 0.196, "steps": 5, "pattern": "random", "inputs": 0})
    mover, start = scene.simulator(dt), unloaded(scene)
    with warnings.catch_warnings():
        warnings.simplefilter("error", rod.Unresolved)
        found = mover.run(commands, start)
    assert grown(mover.space_error.of(found)) > 1.0
    true = mover.finer.run(commands, mover.resolution.on_finer(start), check=False)
    assert found.error is not None and grown(motion_error(found, true)) < found.error.of_travel < 1e-3
