"""Runs in blocks: resumable after a kill, independent of the number of workers."""

from __future__ import annotations

import shutil
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
    assert sorted(p.name for p in (tmp_path / "parts").glob("[0-9]*.h5")) == ["000000.h5", "000001.h5"]
    again = subprocess.run([*command, "live"], capture_output=True, text=True)
    assert again.returncode == 0, again.stderr
    assert again.stdout.split() == ["0", "1", "2", "3"]
    assert computed(tmp_path / "log") == [0, 1, 2, 2, 3]


DAMAGES: dict[str, Callable[[bytes], bytes]] = {
    "cut": lambda b: b[:-30],
    "empty": lambda b: b"",
    "a bit of its numbers": lambda b: b[:-9] + bytes([b[-9] ^ 1]) + b[-8:],
    "a bit of its structure": lambda b: b[:600] + bytes([b[600] ^ 16]) + b[601:],
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_damaged_blocks_are_computed_again(tmp_path: Path, damage: str, caplog: pytest.LogCaptureFixture) -> None:
    parts = tmp_path / "parts"
    whole = run(counted(tmp_path / "log"), parts)
    file = parts / "000002.h5"
    file.write_bytes(DAMAGES[damage](file.read_bytes()))
    (parts / ".000004.h5.abc.part.h5").write_bytes(b"half")
    again = run(counted(tmp_path / "again"), parts)
    assert computed(tmp_path / "again") == [2]
    assert str(file) in caplog.text and "computed again" in caplog.text
    for a, b in zip(whole, again, strict=True):
        np.testing.assert_array_equal(a["x"], b["x"])


def test_blocks_that_are_not_what_their_name_says_are_refused(tmp_path: Path) -> None:
    """A copied file is whole; what it holds is of another place in the run, or of another run."""
    ours, others = tmp_path / "ours", tmp_path / "others"
    run(counted(tmp_path / "log"), ours, n=2)
    run(counted(tmp_path / "log"), others, n=2, seed=4)
    shutil.copy(ours / "000000.h5", ours / "000001.h5")
    with pytest.raises(ValueError, match=r"000001.h5 is block 0 of the same run.*delete it"):
        run(counted(tmp_path / "log"), ours, n=2)
    shutil.copy(others / "000001.h5", ours / "000001.h5")
    with pytest.raises(ValueError, match=r"000001.h5 is block 1 of a run with other settings") as error:
        run(counted(tmp_path / "log"), ours, n=2)
    assert "\n" not in str(error.value)


def test_a_damaged_marker_is_told_and_may_be_deleted(tmp_path: Path) -> None:
    """Blocks know their run themselves: without the marker those of another are still refused."""
    run(counted(tmp_path / "log"), tmp_path / "parts", n=2)
    marker = tmp_path / "parts" / "run.json"
    marker.write_bytes(marker.read_bytes().replace(b"3", b"4", 1))
    with pytest.raises(ValueError, match=r"run.json is damaged.*delete it"):
        run(counted(tmp_path / "log"), tmp_path / "parts", n=2)
    marker.unlink()
    with pytest.raises(ValueError, match="other settings"):
        run(counted(tmp_path / "log"), tmp_path / "parts", n=2, seed=4)
    marker.unlink()
    run(counted(tmp_path / "again"), tmp_path / "parts", n=2)
    assert not (tmp_path / "again").exists()


def test_arrays_of_numbers_and_texts_come_back_as_they_were(tmp_path: Path) -> None:
    made = {
        "texts": np.array([["a", "ä"], ["", "long one"]]),
        "no texts": np.array([], dtype=str),
        "whole": np.array([2**63 - 1]),
        "half": np.float32([0.1, np.nan]),
        "bits": np.float64([-0.0, 5e-324, np.inf]),
        "truth": np.array([True, False]),
        "complex": np.array(1j),
    }
    task = lambda k: made  # noqa: E731
    run(task, tmp_path, n=1)
    (again,) = run(task, tmp_path, n=1)
    for name, array in made.items():
        assert again[name].tobytes() == np.asarray(array).tobytes() and again[name].shape == np.shape(array), name


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
        assert sorted(p.name for p in (tmp_path / name / "parts").glob("[0-9]*.h5")) == ["000000.h5", "000001.h5"]
