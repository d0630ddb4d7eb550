"""Damaged files of every kind, a small run of scripts/stress/stress_files.py."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "scripts"))

from stress.damage import DAMAGES, KINDS, OTHER, RAW, REFUSED, SAME, Kind, damaged, judge, work, written


@pytest.mark.parametrize("kind", KINDS)
def test_damaged_files_are_refused_in_one_line_or_whole(kind: str) -> None:
    """A block of a run is computed again, everything else is refused."""
    found = [work({"kind": kind, "seed": seed, "unverified": False}) for seed in range(40)]
    right = SAME if kind == "block of a run" else REFUSED
    assert [row for row in found if row["outcome"] != right] == []


@pytest.mark.parametrize("kind", KINDS)
def test_whole_files_are_loaded_and_written_again_to_the_last_byte(kind: str, tmp_path: Path) -> None:
    path = KINDS[kind].make(tmp_path, 0)
    whole = path.read_bytes()
    assert judge(KINDS[kind], path, tmp_path / "again", whole)["outcome"] == SAME
    tree, at = written(kind, 0)
    assert tree[at] == whole and written(kind, 1)[0][at] != whole


def test_every_damage_changes_the_file() -> None:
    whole, foreign = bytes(3000), bytes(2000) + b"\1" * 1500
    rng = np.random.default_rng(0)
    found = [damaged(whole, foreign, rng) for _ in range(300)]
    assert all(content not in (whole, foreign) for _, content in found)
    assert {name for name, _ in found} == set(DAMAGES) - {"blocks swapped", "zeros"}  # of zeros


def raising(error: Exception) -> Callable[[Path, Path], None]:
    def again(path: Path, copy: Path) -> None:
        raise error

    return again


def test_what_is_wrong_is_counted_as_such(tmp_path: Path) -> None:
    path = tmp_path / "d1.h5"
    for again, outcome in (
        (raising(ValueError("d1.h5 is damaged")), REFUSED),
        (raising(ValueError("something is damaged")), RAW),
        (raising(ValueError("d1.h5 is damaged:\nsee above")), RAW),
        (raising(OSError("d1.h5: unable to open file")), RAW),
        (raising(KeyError("x")), RAW),
        (lambda path, copy: copy.write_bytes(b"other"), OTHER),
        (lambda path, copy: copy.write_bytes(b"whole"), SAME),
    ):
        assert judge(Kind(lambda folder, seed: folder, again), path, tmp_path / "again", b"whole")["outcome"] == outcome
