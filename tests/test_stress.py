"""The stress run survives hangs, crashes and being killed, and random scenes end with a clean status."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "scripts"))

from pisplit.models import rod
from stress import watched
from stress.cases import sweeps, work
from stress.elastica import PlaneElastica, followed
from stress.equilibria import judged
from stress.random_scenes import Description, build, unloaded
from stress.scene_strategy import drawn, scenes
from stress.watched import Finished, run_watched


def test_hangs_and_crashes_cost_a_worker_and_not_the_run(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(watched, "WAITING", 1.0)
    fine = "{'outcome': 'ok', 'message': ''}"
    cases = [fine, "__import__('time').sleep(600)", fine, "__import__('os')._exit(3)", fine]
    found = run_watched(cases, eval, limit=4.0, workers=1)  # type: ignore[arg-type]
    assert [row["outcome"] for row in found] == ["ok", "hang", "ok", "crash", "ok"]


def test_a_run_that_was_killed_goes_on_where_it_was(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What is finished is not run again with the same arguments, and is with others; nothing else is left behind."""
    monkeypatch.setattr(watched, "EVERY", 0.0)
    path, case = tmp_path / "unfinished.json", "{'outcome': 'ok', 'message': 'run'}"
    Finished(path, {"seed": 0}).put(case, {"outcome": "ok", "message": "kept"})  # type: ignore[arg-type]
    assert [p.name for p in tmp_path.iterdir()] == ["unfinished.json"]

    def messages(arguments: dict[str, int]) -> list[str]:
        finished = Finished(path, arguments)
        found = run_watched([case], eval, 60.0, 1, finished)  # type: ignore[list-item, arg-type]
        return [row["message"] for row in found]

    assert messages({"seed": 0}) == ["kept"]
    assert messages({"seed": 1}) == ["run"]
    Finished(path, {"seed": 1}).remove()
    assert not list(tmp_path.iterdir())


@settings(max_examples=14, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow])
@given(scenes())
def test_random_scenes_end_with_a_clean_status(described: Description) -> None:
    """Statics and two steps of motion: finite states, and success or one line that says why not."""
    scene, dt, inputs = build(described | {"steps": 2})
    still = scene.statics().solve(inputs[0])
    assert np.all(np.isfinite(still.state)) and (still.success or "\n" not in still.message)
    run = scene.simulator(dt).run(inputs, unloaded(scene), check=False)
    assert np.all(np.isfinite(run.x)) and np.all(np.isfinite(run.fields(1)))
    assert run.success or (run.message.startswith("IDAS gave up") and "\n" not in run.message)


def test_descriptions_are_drawn_by_the_seed_and_printed_ones_build_the_same_scene() -> None:
    made = drawn(10, seed=3)
    assert made == drawn(10, seed=3) and made != drawn(10, seed=4)
    assert len({json.dumps(d) for d in made}) == 10
    for described in made:
        scene, dt, inputs = build(described)
        again, dt_again, inputs_again = build(json.loads(json.dumps(described)))
        assert str(scene) == str(again) and dt == dt_again and np.array_equal(inputs, inputs_again)


def test_every_sweep_of_the_stress_run_is_there() -> None:
    cases = sweeps(quick=False, seed=0)
    young = [c["young"] for c in cases if c["sweep"].startswith("stiffness")]
    assert min(young) <= 1e4 * (1 + 1e-9) and max(young) >= 1e12 * (1 - 1e-9)
    assert len(cases) >= 2000
    assert sum(c["kind"] == "random" for c in cases) >= 120
    for sweep, least in (("sag", 200), ("tip load", 400), ("arm with tendons", 100)):
        of = [c for c in cases if c["sweep"] == f"truth: {sweep}"]
        assert len(of) >= least and {4, 8} <= {c["nodes"] for c in of}
    dead = [c for c in cases if c["kind"] == "dead truth"]
    assert min(c["load"] for c in dead) < 1.1 and max(c["load"] for c in dead) > 290.0
    assert any(c["nodes"] == "auto" for c in dead) and any(c["direction"] == [0.0, 0.0, -1.0] for c in dead)
    for arm in ("arm", "full arm"):
        of = [c for c in cases if c["sweep"].startswith(f"{arm}: ")]
        dts = [c["dt"] for c in of if c["sweep"].endswith("control interval")]
        assert min(dts) <= 1e-4 * (1 + 1e-9) and max(dts) >= 0.3 * (1 - 1e-9)
        assert max(c.get("amplitude", 0.0) for c in of) >= 0.3 * 0.7144 - 1e-9
        assert min(c.get("damping", 1.0) for c in of) == 0.0
        assert max(c["load"] for c in of if c["kind"] == "arm at rest") == 300.0
    assert len(sweeps(quick=True, seed=0)) < len(cases) / 10


def test_the_elastica_that_judges_is_the_published_one() -> None:
    """Cantilevers under a transverse tip force (Mattiasson, Int. J. Numer. Meth. Eng. 17, 1981), and Euler's load."""
    for load, across, shortening in ((1.0, 0.30172, 0.05643), (5.0, 0.71379, 0.38763), (10.0, 0.81061, 0.55500)):
        tip = PlaneElastica().shape(np.array([load, 0.0]), np.zeros(2))[-1]
        assert np.abs(tip - [across, 1.0 - shortening]).max() < 1e-5
    push = np.array([0.05, 0.0])
    straight, bent = (
        PlaneElastica().shape(np.array([0.0, -f * np.pi**2 / 4.0]), np.zeros(2), push)[-1] for f in (0.95, 1.05)
    )
    assert abs(straight[0]) < 1e-9 and bent[0] > 0.3


def test_the_fine_path_ends_where_the_rod_buckles() -> None:
    """A column under its own weight loses stability at 7.837 EI/L^3 (Greenhill); a sagging rod is the elastica."""
    body = rod.Rod(1.0, rod.Circle(0.01), rod.Elastic(1e6, 1e6 / 3.0, 1000.0), "planar")
    scene = rod.Scene(body, rod.Gravity(rod.Input("g", 3)), nodes=8)
    unit = body.stiffness[1] / body.mass_per_length
    state, part = followed(scene, np.array([0.0, 0.0, -10.0 * unit]))
    assert state is None and abs(part - 0.7837) < 0.03
    state, part = followed(scene, np.array([20.0 * unit, 0.0, 0.0]))
    assert state is not None and part == 1.0
    true = PlaneElastica().shape(np.zeros(2), np.array([20.0, 0.0]))
    assert np.abs(scene.fields(state, np.arange(1, 21) / 20)[:, [0, 2]] - true).max() < 1e-4


def test_what_is_off_without_a_word_is_wrong() -> None:
    assert [judged(*of)["outcome"] for of in ((2e-3, ""), (2e-3, "said"), (5e-4, ""))] == ["wrong", "flagged", "ok"]
    cases = [c for c in sweeps(quick=True, seed=0) if c["kind"] == "dead truth" and c["strains"] == "planar"]
    found = [work(case) for case in cases[:5]]
    assert {f["outcome"] for f in found} <= {"ok", "flagged"} and any(f["outcome"] == "ok" for f in found)


@pytest.mark.parametrize("kind", ["dead truth", "arm truth", "load"])
def test_answers_that_were_spoilt_do_not_pass(kind: str) -> None:
    """Moved by 3e-3 of the length or of the travel, a right answer is wrong."""
    cases = [c for c in sweeps(quick=False, seed=0) if c["kind"] == kind and c["nodes" if "truth" in kind else "ratio"]]
    mild = min(cases, key=lambda c: c.get("load", c.get("weight", abs(c.get("ratio", 0.0) - 0.01))))
    assert work(mild)["outcome"] == "ok" and work(mild | {"spoil": 3e-3})["outcome"] == "wrong"


def test_a_case_of_the_full_arm_is_solved() -> None:
    case = next(c for c in sweeps(quick=False, seed=0) if c["sweep"] == "full arm: tip load" and c["load"] == 1.0)
    found = work(case)
    assert found["outcome"] in ("ok", "flagged") and found["error"] < 0.3
