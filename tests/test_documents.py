"""Every block of Python in README and docs runs as printed, one after another, with smaller numbers where it is long.

What a page takes for granted (an arm, data, a fitted model) is made here; names are those of the page.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parent.parent

#: What stands before the first block of a page, and replacements of text that shorten its blocks.
BEFORE = {
    "README.md": "",
    "docs/recordings.md": f"""
import sys
sys.path.insert(0, {str(ROOT / "scripts")!r})
import numpy as np
from pathlib import Path
import messy_log
rng = np.random.default_rng(0)
messy_log.write(Path("out/messy-log"), [messy_log.simulated(rng, 6.0) for _ in range(3)], rng)
sys.path.pop(0)
""",
    "docs/front.md": """
import numpy as np
import pisplit as ps
from pisplit.models import systems
def swing(k):
    rng = np.random.default_rng(k)
    u = np.repeat(rng.uniform(-1, 1, (20, 1)), 6, axis=0)
    x = systems.duffing(stiffness=1.0).simulate(rng.uniform(-1, 1, 2), u, 0.05)
    t = 0.05 * np.arange(len(x))
    table = np.column_stack([t, x, np.vstack([u, u[-1:]])])
    np.savetxt(f"run{k}.csv", table, delimiter=",", header="t,x,v,u", comments="")
for k in range(4):
    swing(k)
""",
}
#: Pages that take nothing for granted: they begin in an empty folder.
BEFORE |= {f"docs/tutorials/{name}.md": "" for name in ("rod", "koopman", "arm", "robot")}
BEFORE |= {f"docs/{name}.md": "" for name in ("rod", "identification", "control")}
SHORTER = {
    "docs/tutorials/arm.md": {
        'alpha="cv", penalty="ridge"': 'alpha=1e-3, penalty="ridge"',
        "samples=300": "samples=60",
        "points=17": "points=9",
        "steps=120": "steps=40",
    },
    "README.md": {
        "arm.record(10), arm.record(4, seed=1)": "arm.record(6, steps=120), arm.record(1, steps=60, seed=1)",
        "arm=arm": "arm=arm, candidates=['L-EDMDc']",
        "steps=400": "steps=20",
    },
    "docs/front.md": {
        "nodes=4,\n)": "nodes=3,\n)",
        "rest_shapes(16": "rest_shapes(4",
        "identify(d1, progress": "identify(d1, candidates=['L-EDMDc', 'L-EDMDc, cubic'], progress",
        "TendonArm.paper()": "TendonArm.paper(3)",
        "episodes=10": "episodes=3, steps=40",
        "samples=4000": "samples=200",
        "half_width=0.022": "half_width=0.022, points=9",
        "steps=400": "steps=20",
    },
    "docs/rod.md": {
        "nodes=5,\n)": "nodes=4,\n)",
        "tendons=3)": "tendons=3, nodes=3)",
        "np.linspace(0.0, 1.0, 20)": "np.linspace(0.0, 0.1, 3)",
    },
    "docs/control.md": {
        "TendonArm.paper()\nd1": "TendonArm.paper(3)\nd1",
        "arm.record(10)": "arm.record(3, steps=60, workers=1, progress=False)",
        "steps=400": "steps=10",
    },
    "docs/identification.md": {
        "TendonArm.paper()": "TendonArm.paper(3)",
        "arm.record(10)": "arm.record(4, steps=40, workers=1, progress=False)",
        "standard_normal((16, 3))": "standard_normal((4, 3))",
        "episodes=96": "episodes=4, steps=40, progress=False",
        "in range(64)": "in range(4)",
        "windows=4, steps=8": "windows=2, steps=4",
        'alpha="cv", twin_alpha=1e-5': "alpha=1e-3, twin_alpha=1e-5",
        "sizes=[16, 64, 256], seeds=range(5)": "sizes=[16, 64], seeds=range(2)",
    },
}
#: What a block claims, by the page and a text of the block: checked after it has run.
AFTER = {
    ("docs/rod.md", "statics.sweep"): """
assert path.success.all() and pinned.success
assert found.success and np.allclose(found.equilibrium.tip[:2], (0.1, -0.05), atol=1e-7)
""",
    ("docs/rod.md", "arm.stepper"): """
assert traj.success and low.frequency.shape == (4,)
assert np.abs(account.imbalance).max() <= 1e-2 * np.abs(account.work["Tendons"]).max()
assert one.d_input.shape == (27, 3) and lin.B.shape == (24, 3)
""",
}


def blocks(page: str) -> list[str]:
    """The blocks of Python of a page."""
    return re.findall(r"```python\n(.*?)```", (ROOT / page).read_text(), re.S)


def test_every_page_with_code_is_run() -> None:
    pages = {p.relative_to(ROOT).as_posix() for p in [ROOT / "README.md", *(ROOT / "docs").rglob("*.md")]}
    assert {page for page in pages if blocks(page)} == set(BEFORE)


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("page", BEFORE)
def test_the_code_of_a_page_runs_as_printed(page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "board").mkdir()
    names: dict[str, Any] = {"__name__": "page"}
    exec(BEFORE[page], names)
    for code in blocks(page):
        claimed = "".join(AFTER[where, text] for where, text in AFTER if where == page and text in code)
        for long, short in SHORTER.get(page, {}).items():
            code = code.replace(long, short)
        exec(compile(code, page, "exec", dont_inherit=True), names)
        exec(claimed, names)
    assert page not in ("README.md", "docs/front.md") or names["log"].u.shape == (20, 3)


def test_every_claim_has_its_block() -> None:
    assert all(sum(text in code for code in blocks(page)) == 1 for page, text in AFTER)


@pytest.mark.parametrize("page", SHORTER)
def test_what_is_shortened_stands_on_the_page(page: str) -> None:
    for text in SHORTER[page]:
        assert text in (ROOT / page).read_text()
