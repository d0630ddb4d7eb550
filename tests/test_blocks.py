"""Runs in blocks: resumable after a kill, independent of the number of workers."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pisplit.models.arm.blocks import Block, discard_blocks, run_blocks

RUN = {"kind": "numbers", "seed": 3}


def counted(log: Path, fail_at: int | None = None) -> Callable[[int], Block]:
    """A task that writes down which blocks it computed."""

    def task(k: int) -> Block:
        if k == fail_at:
            raise RuntimeError(f"block {k} broke")
        with log.open("a") as file:
            file.write(f"{k}\n")
        rng = np.random.default_rng([3, k])
        return {"x": rng.normal(size=(4, 2)), "names": np.array([f"block {k}"])}

    return task


def computed(log: Path) -> list[int]:
    return sorted(int(line) for line in log.read_text().split())


def run(task: Callable[[int], Block], folder: Path, n: int = 6, workers: int = 1, **identity: Any) -> list[Block]:
    return run_blocks(task, n, folder, {**RUN, **identity}, workers=workers, progress=False)


def test_a_run_that_broke_computes_only_what_is_missing(tmp_path: Path) -> None:
    first, second = tmp_path / "first", tmp_path / "second"
    with pytest.raises(RuntimeError, match="block 3 broke"):
        run(counted(first, fail_at=3), tmp_path / "parts")
    assert computed(first) == [0, 1, 2]
    blocks = run(counted(second), tmp_path / "parts")
    assert computed(second) == [3, 4, 5]
    whole = run(counted(tmp_path / "third"), tmp_path / "other")
    for a, b in zip(blocks, whole, strict=True):
        np.testing.assert_array_equal(a["x"], b["x"])
        np.testing.assert_array_equal(a["names"], b["names"])


KILLED = """
import os, signal, sys
from pathlib import Path
import numpy as np
from pisplit.models.arm.blocks import run_blocks

folder = Path(sys.argv[1])

def task(k):
    with open(folder / "log", "a") as file:
        file.write(f"{k}\\n")
    if k == 2 and sys.argv[2] == "die":
        class Deadly:
            def __array__(self, *args, **kwargs):  # the block is half on disk when the process dies
                os.kill(os.getpid(), signal.SIGKILL)
        return {"x": np.full(1000, k), "y": Deadly()}
    return {"x": np.full(1000, k), "y": np.arange(k)}

blocks = run_blocks(task, 4, folder / "parts", {"run": 1}, workers=1, progress=False)
print(*[int(b["x"][0]) for b in blocks])
"""


def test_a_killed_process_leaves_no_half_block_and_is_continued(tmp_path: Path) -> None:
    script = tmp_path / "job.py"
    script.write_text(KILLED)
    command = [sys.executable, str(script), str(tmp_path)]
    dead = subprocess.run([*command, "die"], capture_output=True, text=True)
    assert dead.returncode != 0
    assert sorted(p.name for p in (tmp_path / "parts").glob("*.npz")) == ["000000.npz", "000001.npz"]
    again = subprocess.run([*command, "live"], capture_output=True, text=True)
    assert again.returncode == 0, again.stderr
    assert again.stdout.split() == ["0", "1", "2", "3"]
    assert computed(tmp_path / "log") == [0, 1, 2, 2, 3]


def test_truncated_and_partial_files_do_not_count_as_done(tmp_path: Path) -> None:
    parts = tmp_path / "parts"
    whole = run(counted(tmp_path / "log"), parts)
    file = parts / "000002.npz"
    file.write_bytes(file.read_bytes()[:-30])
    (parts / "000004.npz").write_bytes(b"")
    (parts / "tmpabc.part").write_bytes(b"half")
    again = run(counted(tmp_path / "again"), parts)
    assert computed(tmp_path / "again") == [2, 4]
    for a, b in zip(whole, again, strict=True):
        np.testing.assert_array_equal(a["x"], b["x"])


def test_a_block_that_cannot_be_written_is_not_left_behind(tmp_path: Path) -> None:
    class Unwritable:
        def __array__(self, *args: Any, **kwargs: Any) -> np.ndarray:
            raise RuntimeError("disk full")

    def task(k: int) -> Block:
        return {"x": np.zeros(3), "y": Unwritable()}  # type: ignore[dict-item]

    with pytest.raises(RuntimeError, match="disk full"):
        run(task, tmp_path)
    assert [p.name for p in tmp_path.iterdir()] == ["run.json"]


def test_results_do_not_depend_on_the_number_of_workers(tmp_path: Path) -> None:
    one = run(counted(tmp_path / "a"), tmp_path / "one", workers=1)
    two = run(counted(tmp_path / "b"), tmp_path / "two", workers=2)
    assert computed(tmp_path / "b") == list(range(6))
    for a, b in zip(one, two, strict=True):
        assert a["x"].tobytes() == b["x"].tobytes()


def test_more_blocks_go_on_from_fewer(tmp_path: Path) -> None:
    few = run(counted(tmp_path / "a"), tmp_path / "parts", n=2)
    more = run(counted(tmp_path / "b"), tmp_path / "parts", n=5)
    assert computed(tmp_path / "b") == [2, 3, 4] and len(more) == 5
    np.testing.assert_array_equal(few[1]["x"], more[1]["x"])


def test_blocks_of_another_run_are_refused_in_one_line(tmp_path: Path) -> None:
    run(counted(tmp_path / "log"), tmp_path / "parts", n=1)
    with pytest.raises(ValueError, match="other settings") as error:
        run(counted(tmp_path / "log"), tmp_path / "parts", n=1, seed=4)
    assert "\n" not in str(error.value)
    discard_blocks(tmp_path / "parts")
    run(counted(tmp_path / "log"), tmp_path / "parts", n=1, seed=4)


@pytest.mark.parametrize("n", [0, -1, 2.5])
def test_the_number_of_blocks_is_checked(tmp_path: Path, n: Any) -> None:
    with pytest.raises(ValueError, match="n_blocks"):
        run(counted(tmp_path / "log"), tmp_path / "parts", n=n)


def test_a_relative_folder_is_that_of_the_caller(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Workers stay alive between runs and stand where the first one began."""
    for name in ("one", "two"):
        (tmp_path / name).mkdir()
        monkeypatch.chdir(tmp_path / name)
        run(counted(tmp_path / "log"), Path("parts"), 2, 2)
        assert sorted(p.name for p in (tmp_path / name / "parts").glob("*.npz")) == ["000000.npz", "000001.npz"]
