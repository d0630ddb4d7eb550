"""The scripts as a user runs them, in a folder of their own."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from pisplit import Episodes, PhaseSamples

SCRIPTS = Path(__file__).parent.parent / "scripts"
RUNNABLE = sorted(p.relative_to(SCRIPTS).as_posix() for p in SCRIPTS.rglob("*.py") if "__main__" in p.read_text())


def script(name: str, *arguments: str, folder: Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, str(SCRIPTS / name), *arguments]
    return subprocess.run(
        command, cwd=folder, capture_output=True, text=True, timeout=300, env={**os.environ, "OMP_NUM_THREADS": "1"}
    )


def report(path: Path) -> dict[str, Any]:
    """The JSON of a script, with the parts that every report has."""

    def refuse(name: str) -> float:
        raise AssertionError(f"{name} is not JSON")

    found: dict[str, Any] = json.loads(path.read_text(), parse_constant=refuse)
    assert {"machine", "versions", "seed", "arguments", "figures"} <= set(found)
    assert found["machine"]["cores"] == os.cpu_count()
    for name in ("python", "pisplit", "casadi", "numpy", "osqp"):
        assert found["versions"][name]
    for name, figure in found["figures"].items():
        assert {"value", "unit", "target", "met"} <= set(figure), name
        assert isinstance(figure["value"], int | float) and np.isfinite(figure["value"]), name
        assert isinstance(figure["unit"], str)
        if figure["target"] is None:
            assert figure["met"] is None
        else:
            kind, bound = figure["target"].split()[:2]
            assert figure["met"] is (
                figure["value"] <= float(bound) if kind == "<=" else figure["value"] >= float(bound)
            )
    return found


@pytest.fixture(scope="module")
def demo(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any], str]:
    folder = tmp_path_factory.mktemp("demo")
    ended = script("mpc_demo.py", "--quick", "--episodes", "6", "--json", "deep/out.json", folder=folder)
    assert ended.returncode == 0, ended.stderr[-2000:]
    return folder, report(folder / "deep" / "out.json"), ended.stdout


def test_the_demo_reports_what_it_measured(demo: tuple[Path, dict[str, Any], str]) -> None:
    _, found, printed = demo
    figures = found["figures"]
    assert found["seed"] == 0 and found["arguments"]["quick"] is True and found["arguments"]["episodes"] == 6
    for model in ("L-EDMDc", "PI-EDMDc", "PI-EDMDc LASSO"):
        assert figures[f"circle {model} RMS"]["unit"] == "% of L" and figures[f"circle {model} RMS"]["value"] > 0.0
        assert figures[f"{model} divergent roll-outs"]["value"] == 0.0
        assert model in printed
    violations = [figure for name, figure in figures.items() if "limit violations" in name]
    assert len(violations) == 8 and all(figure["value"] == 0 and figure["met"] for figure in violations)


def test_the_demo_tracks_better_with_the_model_that_knows_the_arm(demo: tuple[Path, dict[str, Any], str]) -> None:
    figures = {name: figure["value"] for name, figure in demo[1]["figures"].items()}
    assert figures["circle PI-EDMDc RMS"] <= 0.15
    assert figures["circle PI-EDMDc gain over feed-forward"] >= 3.0
    assert figures["circle PI-EDMDc RMS"] < figures["circle feed-forward RMS"]
    assert figures["set-point PI-EDMDc steady error"] <= 0.1 * figures["set-point feed-forward steady error"]


def test_the_demo_draws_real_pictures(demo: tuple[Path, dict[str, Any], str]) -> None:
    (place,) = {p.parent for p in demo[0].rglob("*.png")}
    for name in ("arm.png", "tracking.png", "shapes.png", "arm.gif"):
        with Image.open(place / name) as picture:
            picture.load()
            assert min(picture.size) >= 300
            assert np.asarray(picture.convert("L")).std() > 5.0  # something is drawn
            if name == "arm.gif":
                assert getattr(picture, "n_frames", 1) >= 10
    assert not list(demo[0].rglob("*.part")) and not list(demo[0].rglob("*.parts"))


def test_data_are_generated_reported_and_used_again(tmp_path: Path) -> None:
    arguments = ("--quick", "--episodes", "2", "--steps", "20", "--samples", "30", "--workers", "1", "--seed", "7")
    first = script("generate_data.py", *arguments, "--json", "out.json", folder=tmp_path)
    assert first.returncode == 0, first.stderr[-2000:]
    found = report(tmp_path / "out.json")
    assert found["seed"] == 7
    assert found["figures"]["episodes"]["value"] == 2 and found["figures"]["phase samples"]["value"] == 30
    d1, d2 = sorted(tmp_path.rglob("*.h5"))
    assert len(Episodes.load(d1)) == 2 and len(PhaseSamples.load(d2)) == 30
    before = d1.stat().st_mtime_ns, d2.stat().st_mtime_ns
    again = script("generate_data.py", *arguments, folder=tmp_path)
    assert again.returncode == 0 and (d1.stat().st_mtime_ns, d2.stat().st_mtime_ns) == before
    other = script("generate_data.py", *arguments, "--dt", "0.02", folder=tmp_path)
    assert_one_line(other, "dt = 0.03, not 0.02")
    d1.write_bytes(d1.read_bytes()[:1000])
    assert_one_line(script("generate_data.py", *arguments, folder=tmp_path), d1.name)


#: Runs the scripts of its arguments with --help, one after another: what they import is loaded once.
HELP = """
import contextlib, io, json, runpy, sys
from pathlib import Path
found, scripts, places = {}, json.loads(sys.argv[1]), list(sys.path)
for name in scripts:
    out, sys.argv = io.StringIO(), [name, "--help"]
    sys.path[:] = [str(Path(name).parent), *places]
    with contextlib.redirect_stdout(out):
        try:
            runpy.run_path(name, run_name="__main__")
            code = None
        except SystemExit as end:
            code = end.code
    found[name] = [code, out.getvalue()]
print(json.dumps(found))
"""


def test_every_script_explains_itself(tmp_path: Path) -> None:
    names = [str(SCRIPTS / name) for name in RUNNABLE]
    ended = subprocess.run(
        [sys.executable, "-c", HELP, json.dumps(names)], cwd=tmp_path, capture_output=True, text=True, timeout=300
    )
    assert ended.returncode == 0, ended.stderr
    found = json.loads(ended.stdout)
    assert list(found) == names and len(names) > 20
    for name, (code, printed) in found.items():
        assert code in (0, None), name
        assert printed.startswith("usage:") and "--json" in printed, name
    assert not list(tmp_path.iterdir())


def assert_one_line(ended: subprocess.CompletedProcess[str], message: str) -> None:
    """An error in one line (after the usage where the command line itself is wrong), no traceback, no success."""
    lines = ended.stderr.strip().splitlines()
    assert ended.returncode != 0 and "Traceback" not in ended.stderr, ended.stderr[-2000:]
    assert "error: " in lines[-1] and message in lines[-1], lines[-1]


@pytest.mark.parametrize(
    ("name", "arguments", "message"),
    [
        ("mpc_demo.py", "--steps 10", "150 steps"),
        ("mpc_demo.py", "--radius -1", "radius"),
        ("mpc_demo.py", "--period nan", "period"),
        ("mpc_demo.py", "--seed -1", "seed"),
        ("generate_data.py", "--bogus", "--bogus"),
        ("generate_data.py", "--episodes 0", "episodes"),
        ("generate_data.py", "--dt -1", "dt"),
    ],
)
def test_bad_arguments_end_in_one_line(name: str, arguments: str, message: str, tmp_path: Path) -> None:
    assert_one_line(script(name, *arguments.split(), folder=tmp_path), message)
    assert not list(tmp_path.rglob("*.h5"))
