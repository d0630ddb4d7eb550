"""The adapter to cosseratbench: its cantilever and catenary within the error of their own references."""

import sys
import warnings
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "scripts"))

pytest.importorskip("cosseratbench")

from cosseratbench import registry
from cosseratbench.solver import Solver

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


def test_what_the_adapter_cannot_do_is_said() -> None:
    for name in ("pendulum", "twist", "capstan"):
        with pytest.raises(NotImplementedError):
            PisplitSolver().run(registry.load_experiment(name).scenario_for(), n_elements=20, n_frames=3)
