"""Runs on a cluster: workers compute, the process that asked writes; the results are those of one process."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import joblib
import numpy as np
import pytest

from pisplit.models.arm.blocks import Block, run_blocks, unordered

distributed = pytest.importorskip("distributed", reason="Dask is not installed: pip install pisplit[cluster]")


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Two worker processes, each in a folder of its own, in which HDF5 files cannot be made."""
    place = tmp_path_factory.mktemp("workers")

    def settle(folder: str) -> None:
        import os
        from pathlib import Path

        import h5py

        own = Path(folder) / str(os.getpid())
        own.mkdir()
        os.chdir(own)

        def refuse(*arguments: Any, **options: Any) -> None:
            raise PermissionError("a worker writes nothing")

        h5py.File = refuse

    options = {"n_workers": 2, "threads_per_worker": 1, "processes": True, "dashboard_address": None}
    with (
        distributed.LocalCluster(local_directory=str(place / "dask"), **options) as local,
        distributed.Client(local) as client,
    ):
        client.wait_for_workers(2)
        client.run(settle, str(place))
        yield place


def drawing() -> Callable[[int], Block]:
    """A task that travels by value: numbers of a seed of their own, and where they were drawn."""

    def drawn(k: int) -> Block:
        import time

        time.sleep(0.05)  # so that one worker alone does not take all
        x = np.random.default_rng([7, k]).normal(size=(5, 3))
        return {"x": x, "where": np.array([os.getcwd()]), "process": np.array([os.getpid()])}

    return drawn


def test_blocks_are_computed_elsewhere_and_written_here(cluster: Path, tmp_path: Path) -> None:
    task, identity = drawing(), {"seed": 7}
    with joblib.parallel_config(backend="dask"):
        there = run_blocks(task, 8, tmp_path / "parts", identity, progress=False)
    here = run_blocks(task, 8, tmp_path / "here", identity, workers=1, progress=False)
    for a, b in zip(there, here, strict=True):
        assert a["x"].tobytes() == b["x"].tobytes()
    processes = {int(block["process"][0]) for block in there}
    folders = {str(block["where"][0]) for block in there}
    assert len(processes) == len(folders) == 2 and os.getpid() not in processes
    assert all(Path(folder).parent == cluster and not list(Path(folder).iterdir()) for folder in folders)
    assert len(list((tmp_path / "parts").glob("[0-9]*.h5"))) == 8


def test_a_block_that_fails_elsewhere_is_told_here_and_the_run_goes_on_from_what_is_there(
    cluster: Path, tmp_path: Path
) -> None:
    def failing(k: int) -> Block:
        if k == 3:
            raise RuntimeError("block 3 broke")
        return {"x": np.full(2, k)}

    with joblib.parallel_config(backend="dask", n_jobs=2):
        with pytest.raises(RuntimeError, match="block 3 broke"):
            run_blocks(failing, 6, tmp_path, {"run": 1}, workers=2, progress=False)
        kept = {path.name for path in tmp_path.glob("[0-9]*.h5")}
        blocks = run_blocks(lambda k: {"x": np.full(2, k)}, 6, tmp_path, {"run": 1}, workers=2, progress=False)
    assert "000003.h5" not in kept
    assert [int(block["x"][0]) for block in blocks] == [0, 1, 2, 3, 4, 5]


def test_what_comes_back_may_be_anything(cluster: Path) -> None:
    with joblib.parallel_config(backend="dask"):
        found = dict(unordered(lambda k: [k, {"text": "a" * k}], range(5)))
    assert found == {k: [k, {"text": "a" * k}] for k in range(5)}
