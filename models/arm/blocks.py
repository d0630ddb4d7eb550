"""Long runs in blocks: parallel, resumable, every finished block on disk."""

from __future__ import annotations

import json
import os
import shutil
import tempfile
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import joblib
import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from pisplit.checks import count

Block = dict[str, NDArray[Any]]


def run_blocks(
    task: Callable[[int], Block],
    n_blocks: int,
    folder: str | os.PathLike[str],
    identity: dict[str, Any],
    workers: int = -1,
    label: str = "blocks",
    progress: bool = True,
) -> list[Block]:
    """Results of ``task(0) .. task(n_blocks - 1)``, each kept in ``folder`` as soon as it is done.

    A run that was killed continues where it stopped: blocks on disk are read, not computed again. Blocks of a run with
    another ``identity`` (seed, arm, ...) raise ValueError. ``task`` must depend on nothing but its
    number, so results do not depend on ``workers`` (processes; -1 = one a core). Any joblib backend that is set by
    ``joblib.parallel_config`` is used, so the same run can go to a cluster.
    """
    count(n_blocks, "n_blocks")
    place = Path(folder).resolve()  # a worker may stand in another folder
    place.mkdir(parents=True, exist_ok=True)
    _claim(place, identity)
    todo = [k for k in range(n_blocks) if not zipfile.is_zipfile(_file(place, k))]  # a truncated file is none
    jobs = joblib.Parallel(n_jobs=workers, return_as="generator_unordered")(
        joblib.delayed(_compute)(task, k, str(place)) for k in todo
    )
    bar = tqdm(jobs, desc=label, total=n_blocks, initial=n_blocks - len(todo), disable=not progress, unit="block")
    for _ in bar:
        pass
    return [_read(_file(place, k)) for k in range(n_blocks)]


def discard_blocks(folder: str | os.PathLike[str]) -> None:
    """Remove the blocks of a run whose result is safely stored elsewhere."""
    shutil.rmtree(folder, ignore_errors=True)


def _file(place: Path, k: int) -> Path:
    return place / f"{k:06d}.npz"


def _compute(task: Callable[[int], Block], k: int, place: str) -> int:
    handle, name = tempfile.mkstemp(dir=place, suffix=".part")
    try:
        with os.fdopen(handle, "wb") as file:
            np.savez(file, **task(k))  # type: ignore[arg-type]
        os.replace(name, _file(Path(place), k))
    finally:
        Path(name).unlink(missing_ok=True)
    return k


def _read(path: Path) -> Block:
    with np.load(path) as data:
        return {name: data[name] for name in data.files}


def _claim(place: Path, identity: dict[str, Any]) -> None:
    """Blocks in a folder belong to one run; the file that says so is written whole."""
    text = json.dumps(identity, sort_keys=True, indent=1)
    marker = place / "run.json"
    if marker.exists():
        if marker.read_text() != text:
            raise ValueError(f"{place} holds blocks of a run with other settings; delete the folder or choose another")
        return
    handle, name = tempfile.mkstemp(dir=place, suffix=".part")
    with os.fdopen(handle, "w") as file:
        file.write(text)
    os.replace(name, marker)
