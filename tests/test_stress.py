"""The stress run survives hangs and crashes, and random scenes end with a clean status."""

import sys
from pathlib import Path

from hypothesis import given, settings
from hypothesis import strategies as st

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "scripts"))

from stress_cases import sweeps, work
from watched import run_watched


def test_hangs_and_crashes_cost_a_worker_and_not_the_run() -> None:
    fine = "{'outcome': 'ok', 'message': ''}"
    cases = [fine, "__import__('time').sleep(600)", fine, "__import__('os')._exit(3)", fine]
    found = run_watched(cases, eval, limit=4.0, workers=1)  # type: ignore[arg-type]
    assert [row["outcome"] for row in found] == ["ok", "hang", "ok", "crash", "ok"]


@settings(max_examples=8, deadline=None, derandomize=True)
@given(st.integers(0, 2**31 - 1))
def test_random_scenes_end_with_a_clean_status(seed: int) -> None:
    assert work({"kind": "random", "seed": seed})["outcome"] in ("ok", "failed")


def test_every_sweep_of_the_issue_is_there() -> None:
    cases = sweeps(quick=False, seed=0)
    young = [c["young"] for c in cases if c["sweep"].startswith("stiffness")]
    assert min(young) <= 1e4 * (1 + 1e-9) and max(young) >= 1e12 * (1 - 1e-9)
    assert sum(c["kind"] == "random" for c in cases) >= 500
    assert {c["load"] for c in cases if c["kind"] == "cold"} >= {100.0, 300.0}
    assert len(sweeps(quick=True, seed=0)) < len(cases) / 5
