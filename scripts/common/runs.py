"""Cells of a protocol: law x method x |D1| x |D2| x seed, in parallel, on disk as soon as a chain of them is there."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from tqdm import tqdm

from common.data import PaperData
from common.protocol import Draw, Errors, Method, all_pairs, evaluate, random_pairs
from pisplit import PhaseSamples
from pisplit.data import store
from pisplit.models.arm.blocks import unordered

KIND = "pisplit/cell"


@dataclass(frozen=True)
class Cell:
    """One fit: a method on n1 pairs of a seed and the first n2 phase-space samples."""

    law: str
    method: str
    n1: int
    n2: int
    seed: int

    def path(self, folder: Path) -> Path:
        """File of its errors."""
        return folder / self.law / self.method / f"{self.n1}-{self.n2}-{self.seed}.h5"


@dataclass(frozen=True)
class Result:
    """Errors of a cell, the CPU time of its fit in s, facts about the fit; a refused fit diverges everywhere."""

    errors: Errors
    seconds: float
    facts: Mapping[str, Any]


class Source(Protocol):
    """Where the data of a law come from."""

    def load_or_make(self) -> PaperData:
        """The data; a killed run continues."""

    def __hash__(self) -> int:
        """Equal sources are read once."""


@dataclass(frozen=True)
class Chain:
    """Cells of one law, method and seed that are not on disk, by growing n1: nested draws share their moments."""

    source: Source
    method: Method
    cells: tuple[Cell, ...]

    def __call__(self) -> list[Result]:
        """Fit and evaluate."""
        data = _data(self.source)
        return [run_cell(cell, self.method, data) for cell in self.cells]


@dataclass(frozen=True)
class Chains:
    """Chains by their numbers, as a task of blocks."""

    chains: tuple[Chain, ...]

    def __call__(self, k: int) -> list[Result]:
        """Results of the chain ``k``."""
        return self.chains[k]()


def run_cell(cell: Cell, method: Method, data: PaperData) -> Result:
    """Draw, fit, roll out."""
    rows = random_pairs(data.training, cell.n1, cell.seed)
    draw = Draw(cell.law, data.training, rows, _first(data.d2, cell.n2), cell.seed)
    begin = time.process_time()
    try:
        predictor = method.fit(draw)
    except ValueError as error:
        return Result(_refused(data), time.process_time() - begin, {"refused": str(error)})
    seconds = time.process_time() - begin
    model = getattr(predictor, "model", None)
    return Result(evaluate(predictor, data.test), seconds, dict(getattr(model, "provenance", {})))


def run_cells(
    sources: Mapping[str, Source],
    methods: Sequence[Method],
    cells: Sequence[Cell],
    folder: Path,
    settings: Mapping[str, Any],
    workers: int = -1,
    progress: bool = True,
) -> dict[Cell, Result]:
    """Results of all cells. Those on disk are read, if they were made with the same ``settings``.

    Workers fit and evaluate, this process writes: where they are on other machines (docs/cluster.md), they need to see
    the data that ``sources`` name, not ``folder``. Raises ValueError for a folder of other settings. Results do not
    depend on ``workers``.
    """
    claim(folder, settings)
    by_name = {method.name: method for method in methods}
    groups: dict[tuple[str, str, int], list[Cell]] = {}
    for cell in sorted(cells, key=lambda c: (c.n1, c.n2)):
        if not _finished(cell, folder):
            groups.setdefault((cell.law, cell.method, cell.seed), []).append(cell)
    chains = [Chain(sources[law], by_name[name], tuple(group)) for (law, name, _), group in groups.items()]
    chains.sort(key=lambda chain: -sum(cell.n1 for cell in chain.cells))  # long ones first
    total = sum(len(chain.cells) for chain in chains)
    with tqdm(total=total, desc=folder.name, disable=not progress, unit="fit") as bar:
        for k, results in unordered(Chains(tuple(chains)), range(len(chains)), workers):
            for cell, result in zip(chains[k].cells, results, strict=True):
                write(cell, folder, result)
                if "refused" in result.facts:
                    said = f"{cell.law}, {cell.method}, {cell.n1} pairs, draw {cell.seed}"
                    tqdm.write(f"{said}: no fit, counted as divergence: {result.facts['refused']}")
            bar.update(len(results))
    return {cell: read(cell, folder) for cell in cells}


def curve_cells(laws: Sequence[str], methods: Sequence[str], sizes: Mapping[int, int], n2: int) -> Iterator[Cell]:
    """Cells of the error over |D1|: ``sizes`` maps n1 to its number of draws."""
    for law in laws:
        for method in methods:
            for n1, draws in sizes.items():
                for seed in range(draws):
                    yield Cell(law, method, n1, n2, seed)


def grid_cells(laws: Sequence[str], method: str, sizes: Mapping[int, int], n2s: Sequence[int]) -> Iterator[Cell]:
    """Cells of the error over |D1| x |D2| for one method."""
    for n2 in n2s:
        yield from curve_cells(laws, [method], sizes, n2)


def largest(data: PaperData) -> int:
    """Number of training pairs of all episodes."""
    return all_pairs(data.training)


def claim(folder: Path, settings: Mapping[str, Any]) -> None:
    """A folder belongs to runs of one kind of settings. Raises ValueError if it holds others."""
    marker = folder / "run.json"
    try:
        if store.load_json(marker) != json.loads(json.dumps(settings)):
            raise ValueError(f"{folder} holds results of other settings; delete it or choose another --out")
    except FileNotFoundError:
        store.save_json(marker, settings)


def read(cell: Cell, folder: Path) -> Result:
    """Result of a finished cell. Raises FileNotFoundError if there is none, ValueError if damaged or another's."""
    with store.reading(cell.path(folder), KIND) as file:
        if store.read_json(file, "cell") != asdict(cell):
            raise ValueError("this is the result of another cell; delete it")
        found = store.read_arrays(file["errors"])
        errors = Errors(found["shape"].astype(float), found["velocity"].astype(float), found["diverged_at"])
        return Result(errors, float(file.attrs["seconds"]), store.read_json(file, "facts"))


def _finished(cell: Cell, folder: Path) -> bool:
    """Whether the result of a cell is there and whole."""
    try:
        read(cell, folder)
    except (FileNotFoundError, ValueError):
        return False
    return True


def write(cell: Cell, folder: Path, result: Result) -> None:
    """Keep the result of a cell."""
    path = cell.path(folder)
    path.parent.mkdir(parents=True, exist_ok=True)
    arrays: dict[str, Any] = asdict(result.errors)
    with np.errstate(over="ignore"), store.writing(path, KIND) as file:
        half = {name: arrays[name].astype(np.float32) for name in ("shape", "velocity")}
        store.write_arrays(file.create_group("errors"), half | {"diverged_at": arrays["diverged_at"]})
        store.write_json(file, "cell", asdict(cell))
        file.attrs["seconds"] = result.seconds
        store.write_json(file, "facts", dict(result.facts))


def _refused(data: PaperData) -> Errors:
    from common.protocol import HISTORY

    shape = (len(data.test), len(data.test.us[0]) - HISTORY)
    return Errors(np.full(shape, np.inf), np.full(shape, np.inf), np.zeros(len(data.test), dtype=np.int64))


@lru_cache(maxsize=2)
def _data(source: Source) -> PaperData:
    return source.load_or_make()


_FIRST: dict[tuple[int, int], tuple[PhaseSamples, PhaseSamples]] = {}


def _first(d2: PhaseSamples, count: int) -> PhaseSamples:
    """The first ``count`` samples, the same object every time: methods keep what they learned from it."""
    key = (id(d2), count)
    if key not in _FIRST:
        if count > len(d2):
            raise ValueError(f"{count} phase-space samples asked for; there are {len(d2)}")
        _FIRST[key] = (d2, d2 if count == len(d2) else d2.take(np.arange(count)))
    return _FIRST[key][1]
