"""The adapter to cosseratbench: within the error of its own references, and rods that are twisted."""

import sys
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "scripts"))

pytest.importorskip("cosseratbench")

from cosseratbench import registry
from cosseratbench.experiments.twist import critical_moment
from cosseratbench.solver import Solver

from benchmarks import cosseratbench_driven
from benchmarks.cosseratbench_plugin import TARGETS, PisplitSolver


@pytest.mark.parametrize(("name", "metric"), [("cantilever", "tip_deflection_error"), ("catenary", "shape_error")])
def test_equilibria_are_those_of_the_suite(name: str, metric: str) -> None:
    experiment, solver = registry.load_experiment(name), PisplitSolver()
    assert isinstance(solver, Solver)
    scenario = experiment.scenario_for()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = solver.run(scenario, n_elements=20, n_frames=3)
    assert experiment.metrics[metric](scenario, found) <= TARGETS[metric]
    assert experiment.metrics["settling_residual"](scenario, found) == 0.0
    directors, positions = found.directors[0], found.positions[0]
    chords = np.diff(positions[-1], axis=0)
    assert np.abs(np.linalg.norm(directors, axis=2) - 1.0).max() < 1e-9
    assert np.abs(np.sum(directors[-1] * chords, axis=1) / np.linalg.norm(chords, axis=1)).max() < 0.05


def test_a_cable_swings_with_its_period_and_keeps_its_amplitude() -> None:
    experiment = registry.load_experiment("pendulum")
    scenario = experiment.scenario_for()
    found = PisplitSolver().run(scenario, n_elements=20, n_frames=101)
    assert found.positions[0][0] == pytest.approx(scenario.rods[0].nodes(20), abs=1e-6)
    assert found.directors[0][:, :, 1] == pytest.approx(1.0, abs=1e-9)
    assert experiment.metrics["period_error"](scenario, found) <= TARGETS["period_error"]
    assert abs(experiment.metrics["amplitude_change"](scenario, found)) < 1e-5


def test_what_the_adapter_cannot_do_is_said() -> None:
    for name in ("crossing", "capstan"):
        with pytest.raises(NotImplementedError):
            PisplitSolver().run(registry.load_experiment(name).scenario_for(), n_elements=20, n_frames=3)


def test_a_twisted_rod_buckles_where_greenhill_says() -> None:
    """The margin of the straight, twisted rod of the adapter goes through zero at the critical moment."""
    spec, tension = registry.load_experiment("twist").scenario_for().rods[0], 1.0
    bending = spec.material.youngs_modulus * spec.second_moment_of_area
    scene, _ = cosseratbench_driven._plant(
        spec.length, spec.radius, spec.material, (0.0, 0.0, tension * bending), 0.0, 0.05
    )
    twist = critical_moment(tension) * scene.rod.stiffness[0] / scene.rod.stiffness[2]

    def margin(level: float) -> float:
        state, n = np.zeros(scene.n_states), scene.n_strains
        state[2:n:3] = state[2 * n + 2] = level * twist
        return scene.statics().margin(state)

    levels = np.array([0.99, 1.01])
    below, above = (margin(level) for level in levels)
    assert below > 0.0 > above
    assert np.interp(0.0, [above, below], levels[::-1]) == pytest.approx(1.0, abs=1.5e-3)


def test_twisted_rods_turn_with_their_clamp(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cosseratbench_driven, "NODES", 5)
    scenario = registry.load_experiment("twist").scenario_for()
    scenario = replace(scenario, rods=scenario.rods[3:5], duration=1.0)
    found = PisplitSolver().run(scenario, n_elements=10, n_frames=11)
    for spec, positions, directors in zip(scenario.rods, found.positions, found.directors, strict=True):
        assert positions[0] == pytest.approx(spec.nodes(10), abs=2e-6)
        assert np.abs(positions[:, 0] - spec.centerline[0]).max() < 1e-12
        assert directors[0] == pytest.approx(spec.directors(10), abs=1e-3)
        angle = np.interp(1.0, spec.end_motion.times, np.array(spec.end_motion.rotation)[:, 0])
        turned = np.arctan2(-directors[-1][:, 1], directors[-1][:, 2])  # about x, from z
        assert np.unwrap(turned) == pytest.approx(angle * (np.arange(10) + 0.5) / 10, abs=0.02 * angle)
        assert (
            np.abs(positions[-1, :, 1:] - positions[0, 0, 1:]).max() < 2e-4 and abs(positions[-1, -1, 0] - 1.0) < 1e-3
        )
