"""The command line does what the Python API does, in its words, with exit codes and JSON."""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pisplit as ps
from pisplit.front.commands import main, parser
from pisplit.models import systems

pytestmark = pytest.mark.filterwarnings("ignore")


def table(path: Path, seed: int) -> None:
    """A recording of a hard spring as a table."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform(-1, 1, (20, 1)), 6, axis=0)
    x = systems.duffing(stiffness=1.0).simulate(rng.uniform(-1, 1, 2), u, 0.05)
    rows = np.column_stack([0.05 * np.arange(len(x)), x, np.vstack([u, u[-1:]])])
    np.savetxt(path, rows, delimiter=",", header="t,x,v,u", comments="")


def test_tables_to_a_model_to_a_report_to_a_header(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    runs = [tmp_path / f"run{k}.csv" for k in range(4)]
    for k, path in enumerate(runs):
        table(path, k)
    model = tmp_path / "model.h5"
    columns = ["--states", "x", "v", "--inputs", "u", "--dt", "0.05"]
    assert main(["identify", *map(str, runs), *columns, "--out", str(model), "--json"]) == 0
    told: dict[str, Any] = json.loads(capsys.readouterr().out)
    assert main(["report", str(model), "--json"]) == 0
    again = json.loads(capsys.readouterr().out)
    assert again["chosen"] == told["chosen"] and again["tried"] == told["tried"]
    assert main(["report", str(model)]) == 0
    assert capsys.readouterr().out.startswith(f"model    {told['chosen']}")
    lean = ["--candidates", "L-EDMDc", "--out", str(model), "--json"]
    assert main(["identify", *map(str, runs), *columns, *lean]) == 0
    assert main(["export", str(model), "--c", str(tmp_path / "model.h")]) == 0
    assert "static const" in (tmp_path / "model.h").read_text()
    capsys.readouterr()
    for more, said in (
        ([], "is a model of x, v and inputs u; track runs models of the simulated arm (p_x[1], "),
        (["--out", "run.txt"], "expected .png, .html, .h5"),
    ):
        assert main(["track", str(model), *more]) == 1
        assert said in capsys.readouterr().err


def test_commands_in_files_of_their_own_and_other_words_of_tables(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """What the words say is what ``from_csv`` reads with them: the fitted models are the same."""
    for k in range(3):
        table(tmp_path / "all.csv", k)
        rows = np.loadtxt(tmp_path / "all.csv", delimiter=",", skiprows=1)
        head = "t;x;v"
        text = [";".join(f"{c!r}".replace(".", ",") for c in row) for row in (rows[:, :3] * [1e3, 1e3, 1.0]).tolist()]
        (tmp_path / f"run{k}.csv").write_text("\n".join([head, *text]) + "\n")
        sent = [f"{1e3 * (t + 0.05):.0f};{u!r}" for t, u in rows[:, [0, 3]].tolist()]  # stamped 50 ms late
        (tmp_path / f"servo{k}.csv").write_text("\n".join(["stamp;pull", *sent]) + "\n")
    words = [
        "--time-unit",
        "ms",
        "--state-units",
        "mm",
        "m/s",
        "--delimiter",
        ";",
        "--max-gap",
        "0.2",
    ]
    words += ["--commands", str(tmp_path / "servo*.csv"), "--command-time", "stamp", "--command-shift", "-0.05"]
    lean = ["--candidates", "L-EDMDc", "--out", str(tmp_path / "m.h5"), "--json"]
    files = str(tmp_path / "run*.csv")
    assert main(["identify", files, "--states", "x", "v", "--inputs", "pull", *words, *lean]) == 0
    capsys.readouterr()
    d1 = ps.Episodes.from_csv(
        files,
        "t",
        ["x", "v"],
        ["pull"],
        time_unit="ms",
        state_units=["mm", "m/s"],
        commands=str(tmp_path / "servo*.csv"),
        command_time="stamp",
        command_shift=-0.05,
        max_gap=0.2,
    )
    wanted = ps.identify(d1, candidates=["L-EDMDc"], progress=False).lifted
    found = ps.LiftedModel.load(tmp_path / "m.h5")
    np.testing.assert_allclose(found.A, wanted.A, atol=1e-12)
    assert found.state_units == ("m", "m/s") and found.input_names == ("pull",)


def test_matlab_files_and_headless_tables_are_read(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from scipy.io import savemat

    table(tmp_path / "run.csv", 0)
    rows = np.loadtxt(tmp_path / "run.csv", delimiter=",", skiprows=1)
    savemat(tmp_path / "run.mat", {"t": 50.0 * np.arange(len(rows)), "q": rows[:, 1:3], "u": rows[:, 3]})
    np.savetxt(tmp_path / "bare.csv", rows[:, 1:], delimiter=",")
    lean = ["--candidates", "L-EDMDc", "--out", str(tmp_path / "m.h5")]
    models, bare = [], ["--names", "a", "b", "c"]
    for argv in (
        [str(tmp_path / "run.mat"), "--states", "q", "--inputs", "u", "--time-unit", "ms"],
        [str(tmp_path / "bare.csv"), "--states", "a", "b", "--inputs", "c", "--no-time", "--dt", "0.05", *bare],
    ):
        assert main(["identify", *argv, *lean]) == 0, capsys.readouterr().err
        models.append(ps.LiftedModel.load(tmp_path / "m.h5"))
    np.testing.assert_allclose(models[0].A, models[1].A, atol=1e-9)
    odd = ["identify", str(tmp_path / "run.mat"), "--states", "q", "--inputs", "u", "--decimal", ",", *lean]
    assert main(odd) == 1
    assert "--decimal is a word of CSV files" in capsys.readouterr().err
    limits = [
        "identify",
        str(tmp_path / "run.csv"),
        "--states",
        "x",
        "--inputs",
        "u",
        "--range",
        "x",
        "0",
        "low",
        *lean,
    ]
    assert main(limits) == 1
    assert "has a limit that is no number" in capsys.readouterr().err


def test_what_does_not_work_is_one_line_and_a_code(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    table(tmp_path / "run.csv", 0)
    for argv, said in (
        (["report", str(tmp_path / "none.h5")], "none.h5"),
        (["identify", str(tmp_path / "run.csv"), "--out", "m.h5"], "need --states and --inputs"),
        (["record", "--episodes", "0", "--out", str(tmp_path / "d.h5")], "episodes"),
    ):
        assert main(argv) == 1
        error = capsys.readouterr().err.strip()
        assert error.startswith("error: ") and said in error and "\n" not in error
    with pytest.raises(SystemExit, match="2"):
        main(["identify"])


def test_a_saved_model_tracks_an_arm(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["record", "--episodes", "4", "--steps", "60", "--out", str(tmp_path / "d1.h5"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["dt"] == 0.03
    model, page = tmp_path / "model.h5", tmp_path / "run.html"
    hold = ["--arm", "paper", "--candidates", "PI-EDMDc, hold", "--out", str(model), "--json"]
    assert main(["identify", str(tmp_path / "d1.h5"), *hold]) == 0
    capsys.readouterr()
    assert main(["track", str(model), "--radius", "0.03", "--steps", "80", "--out", str(page), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["rms_error"] < 0.1 * 0.03 and found["steps"] == 80
    text = page.read_text()
    assert main(["track", str(model), "--radius", "0.03", "--steps", "5"]) == 0
    assert "the run ends before; give more --steps" in capsys.readouterr().out
    assert page.stat().st_size < 5e6 and "http" not in text and "<link" not in text and "src=" not in text


def test_bench_tells_times_beside_errors(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    from pisplit.front import bench

    monkeypatch.setattr(bench, "NODES", (3, 5))
    monkeypatch.setattr(bench, "TRUTH", 7)
    monkeypatch.setattr(bench, "MOVING", 3)
    assert main(["bench", "--steps", "30", "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)["measured"]
    error = {row["what"]: row["error"] for row in rows}
    coarse, fine = [e for what, e in error.items() if "equilibrium" in what]
    assert fine < 0.1 * coarse  # exponential in the nodes
    loose, tight = (next(e for what, e in error.items() if text in what) for text in ("rtol 1e-4", "rtol 1e-6"))
    assert tight < loose < 1e-2
    assert all(row["milliseconds"] > 0.0 for row in rows) and rows[-1]["error"] is None
    assert main(["bench", "--steps", "3"]) == 1


def test_the_program_is_there() -> None:
    run = [sys.executable, "-m", "pisplit.front.commands", "--version"]
    done = subprocess.run(run, capture_output=True, text=True, env=dict(os.environ))
    assert done.returncode == 0 and done.stdout.strip() == f"pisplit {ps.__version__}"


def test_every_argument_says_what_it_is() -> None:
    top = parser()
    (commands,) = [a for a in top._actions if isinstance(a, argparse._SubParsersAction)]
    for name, one in commands.choices.items():
        assert "--json" in one.format_help() and "exit codes: 0 done, 1 " in " ".join(one.format_help().split()), name
        assert [a.dest for a in one._actions if not a.help] == [], name
    assert "(default: 0.1)" in commands.choices["track"].format_help()


def test_a_shell_is_told_how_a_line_goes_on(tmp_path: Path) -> None:
    pytest.importorskip("argcomplete")
    for line, expected in (("pisplit re", {"record", "report"}), ("pisplit track --ref", {"--reference"})):
        told = {"COMP_LINE": line, "COMP_POINT": str(len(line)), "_ARGCOMPLETE": "1", "_ARGCOMPLETE_IFS": "|"}
        told["_ARGCOMPLETE_STDOUT_FILENAME"] = str(tmp_path / "answer")
        subprocess.run([sys.executable, "-m", "pisplit"], env={**os.environ, **told}, check=True)
        assert {word.strip() for word in (tmp_path / "answer").read_text().split("|")} == expected


def test_who_reads_no_further_is_no_error(tmp_path: Path) -> None:
    """As in ``pisplit report model.h5 --json | head -1``: an exit code, no traceback."""
    code = (
        "import sys; from pisplit.front import commands\n"
        "commands._export = lambda given: ({'long': 'x' * 1_000_000}, 0)\n"
        "sys.exit(commands.main(['export', 'm.h5', '--c', 'm.h', '--json']))"
    )
    reader, writer = os.pipe()
    os.close(reader)
    done = subprocess.run([sys.executable, "-c", code], stdout=writer, stderr=subprocess.PIPE, text=True)
    os.close(writer)
    assert done.returncode == 1 and done.stderr == ""
