"""Long runs in blocks: parallel, resumable, every finished block on disk, on one machine or on many."""

from __future__ import annotations

import json
import logging
import os
import shutil
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any, TypeVar

import joblib
from numpy.typing import NDArray
from tqdm import tqdm

from pisplit.checks import count
from pisplit.data import store

Block = dict[str, NDArray[Any]]

Result = TypeVar("Result")

KIND = "pisplit/block"

log = logging.getLogger(__name__)


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

    A run that was killed continues where it stopped: blocks on disk are verified and read, not computed again; one that
    is damaged is computed again, with a warning in the log.

    Args:
        task: the work of a block: its number -> arrays of numbers or texts by name. It must depend on nothing else, so
            that results do not depend on ``workers``, and write nothing: its result travels back to this process.
        n_blocks: number of blocks; a finished run goes on from fewer to more.
        folder: where the blocks are kept, made if it is missing.
        identity: JSON-able facts that decide what ``task`` computes (seed, arm, ...); every block holds them.
        workers: processes; -1 = one a core. Any joblib backend that is set by ``joblib.parallel_config`` is used, so
            the same run can go to a cluster (docs/cluster.md), whose machines need not see ``folder``.
        label: text before the progress bar.
        progress: whether to show it.

    Raises ValueError in one line if the folder holds blocks of a run with another identity, or cannot be written.
    """
    count(n_blocks, "n_blocks")
    place = Path(folder).resolve()
    origin = json.dumps(identity, sort_keys=True)
    _claim(place, origin)
    blocks = {k: block for k in range(n_blocks) if (block := _read(place, k, origin)) is not None}
    todo = [k for k in range(n_blocks) if k not in blocks]
    jobs = unordered(task, todo, workers)
    for k, block in tqdm(jobs, desc=label, total=n_blocks, initial=len(blocks), disable=not progress, unit="block"):
        _write(place, k, origin, block)
    for k in todo:
        with store.reading(_file(place, k), KIND) as file:
            blocks[k] = store.read_arrays(file["arrays"])
    return [blocks[k] for k in range(n_blocks)]


def unordered(task: Callable[[int], Result], numbers: Iterable[int], workers: int = -1) -> Iterator[tuple[int, Result]]:
    """Pairs (k, task(k)) of all ``numbers`` k, as soon as each is done.

    ``task`` runs in ``workers`` processes, -1 = one a core, or wherever the backend of ``joblib.parallel_config`` is;
    this process alone sees the results, and is the one to keep them. An error of a task is raised here.
    """
    jobs = (joblib.delayed(_numbered)(task, k) for k in numbers)
    found: Iterator[tuple[int, Result]] = joblib.Parallel(n_jobs=workers, return_as="generator_unordered")(jobs)
    return found


def discard_blocks(folder: str | os.PathLike[str]) -> None:
    """Remove the folder of the blocks of a run whose result is safely stored elsewhere."""
    shutil.rmtree(folder, ignore_errors=True)


def _file(place: Path, k: int) -> Path:
    return place / f"{k:06d}.h5"


def _numbered(task: Callable[[int], Result], k: int) -> tuple[int, Result]:
    return k, task(k)


def _write(place: Path, k: int, origin: str, block: Block) -> None:
    with store.writing(_file(place, k), KIND) as file:
        file.attrs["number"] = k
        store.write_text(file, "origin", origin)
        store.write_arrays(file.create_group("arrays", track_order=True), block)


def _read(place: Path, k: int, origin: str) -> Block | None:
    """Block ``k``, or None if it is to be computed. Raises ValueError if it is there but of another run."""
    path = _file(place, k)
    try:
        with store.reading(path, KIND) as file:
            whose, number = store.read_text(file, "origin"), int(file.attrs["number"])
            block = store.read_arrays(file["arrays"])
    except FileNotFoundError:
        return None
    except ValueError as error:
        log.warning("%s; the block is computed again", error)
        return None
    if (whose, number) != (origin, k):
        raise ValueError(f"{path} is block {number} of {_other(whose == origin)}; delete it or choose another folder")
    return block


def _other(same: bool) -> str:
    return "the same run under another name" if same else "a run with other settings"


def _claim(place: Path, origin: str) -> None:
    """Blocks in a folder belong to one run; a file in it says which."""
    marker = place / "run.json"
    try:
        if json.dumps(store.load_json(marker), sort_keys=True) != origin:
            raise ValueError(f"{place} holds blocks of a run with other settings; delete the folder or choose another")
    except FileNotFoundError:
        store.save_json(marker, json.loads(origin))
