"""The comparison of recipes on a system whose right recipe is known."""

from __future__ import annotations

import importlib
import sys
from argparse import Namespace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pisplit import Episodes

SCRIPTS = Path(__file__).parent.parent / "scripts"


@pytest.fixture(scope="module")
def recipes() -> Any:
    sys.path.insert(0, str(SCRIPTS))
    try:
        return importlib.import_module("recipes")
    finally:
        sys.path.remove(str(SCRIPTS))


def late(number: int, steps: int, seed: int) -> Episodes:
    """A swing whose commands arrive two steps late, by their cube: exact with cubes and delays of inputs, or more."""
    rng = np.random.default_rng(seed)
    xs, us = [], []
    for _ in range(number):
        u, x = rng.uniform(-1.0, 1.0, (steps, 1)), [rng.normal(size=2)]
        for k in range(steps):
            push = u[k] + u[k] ** 3 + (u[k - 2] if k >= 2 else 0.0)
            x.append(np.array([[0.95, 0.1], [-0.3, 0.9]]) @ x[-1] + np.array([0.01, 0.1]) * push)
        xs.append(np.array(x))
        us.append(u)
    return Episodes(xs, us, 0.1, quantities=["p", "p"], outputs={"shape": (0, 1)})


def test_the_recipe_that_holds_the_system_wins_and_is_chosen(
    recipes: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(recipes, "ROBOTS", {"late swing": late})
    monkeypatch.setattr(recipes, "RECIPES", {k: v for k, v in recipes.RECIPES.items() if not v.bilinear})
    report = recipes.Report("recipes", {})
    recipes.measure("late swing", Namespace(quick=True, draws=1, seed=0, out=tmp_path), report)
    found = {name: figure["value"] for name, figure in report.figures.items()}

    def error(name: str) -> float:
        return float(found[f"late swing, 6 recordings, {name}: squared error of roll-outs"])

    assert error("cubic inputs, delays of inputs") < 1e-9 < 1e-4 < error("delays of inputs")
    assert error(recipes.CHOSEN) < 1e-9
    assert error("states") < found["late swing, predicting the mean"]
    told = capsys.readouterr().out
    assert recipes.CHOSEN in told and "late swing" in told
    again = recipes.recordings("late swing", 9, 100, 0, tmp_path)  # from its file
    np.testing.assert_array_equal(again.xs[0], late(9, 100, 0).xs[0])
