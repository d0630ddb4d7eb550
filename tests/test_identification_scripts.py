"""Stress test and benchmark of identification, as a user runs them."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

SCRIPTS = Path(__file__).parent.parent / "scripts"


def figures(name: str, folder: Path, *arguments: str) -> dict[str, Any]:
    command = [sys.executable, str(SCRIPTS / name), "--quick", "--json", "out.json", *arguments]
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    ended = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=200, env=environment)
    assert ended.returncode == 0, ended.stderr[-2000:]
    found: dict[str, Any] = json.loads((folder / "out.json").read_text())["figures"]
    return found


def test_awkward_data_end_in_a_correct_answer_or_one_clear_error(tmp_path: Path) -> None:
    found = figures("stress/stress_identification.py", tmp_path)
    assert found["silently wrong cases"]["value"] == 0
    assert found["correct cases"]["value"] >= 40 and found["refused cases"]["value"] >= 20
    assert found["flagged cases"]["value"] <= 8


def test_choices_on_little_data_are_good_or_say_that_they_may_not_be(tmp_path: Path) -> None:
    found = figures("stress/stress_choices.py", tmp_path)
    judged = {name: figure["met"] for name, figure in found.items() if figure["target"] is not None}
    assert len(judged) == 13 and all(judged.values()), judged


def test_the_benchmark_meets_the_targets_that_do_not_depend_on_the_machine(tmp_path: Path) -> None:
    found = figures("benchmarks/benchmark_identification.py", tmp_path)
    exact = [name for name in found if "gap" in name or "distance to cvxpy" in name or "u^3" in name or "'cv'" in name]
    assert len(exact) >= 11
    for name in exact:
        if "run of the training pairs" not in name:
            assert found[name]["met"] is True, name
    assert all(figure["value"] is not None for figure in found.values())
