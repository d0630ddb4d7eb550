"""Damaged files: what befalls their bytes, and how each kind of file is written, loaded and written again."""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Protocol

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # the other rooms of scripts/

import numpy as np

from common.protocol import Errors
from common.runs import Cell, Result, read, write
from pisplit import BilinearEDMDc, Dictionary, Episodes, LiftedModel, PhaseSamples
from pisplit import observables as ob
from pisplit.data import store
from pisplit.models.arm.blocks import Block, run_blocks

Case = dict[str, Any]
Outcome = dict[str, Any]

#: What a load may end in; the first two are right.
REFUSED, SAME, OTHER, RAW = "refused", "same numbers", "other numbers", "raw error"
#: What a worker says of a load that never came back.
LOST = ("crash", "hang")


class Saved(Protocol):
    """What is written to a file."""

    def save(self, path: Path) -> None:
        """Write it."""


@dataclass(frozen=True)
class Kind:
    """A kind of file: ``make(seed)`` writes one below a folder and says which, ``again`` loads it and writes it anew.

    Both files are equal to the last byte if, and only if, what was loaded is what was saved.
    """

    make: Callable[[Path, int], Path]
    again: Callable[[Path, Path], None]


def work(case: Case) -> Outcome:
    """Damage one file of ``case["kind"]`` as the generator of ``case["seed"]`` says, and load it."""
    kind = KINDS[case["kind"]]
    if case["unverified"]:
        store._fault = lambda stream: None  # the worker does nothing else
    tree, at = written(case["kind"], 0)
    foreign, _ = written(case["kind"], 1)
    damage, content = damaged(tree[at], foreign[at], np.random.default_rng([17, case["seed"]]))
    with tempfile.TemporaryDirectory() as name:
        for place, whole in (tree | {at: content}).items():
            Path(name, place).parent.mkdir(parents=True, exist_ok=True)
            Path(name, place).write_bytes(whole)
        return {"damage": damage, **judge(kind, Path(name, at), Path(name, "again"), tree[at])}


@lru_cache(maxsize=16)
def written(kind: str, seed: int) -> tuple[dict[str, bytes], str]:
    """Files that lie in the folder of a whole file of a kind, by their path in it, and the path of the file."""
    with tempfile.TemporaryDirectory() as name:
        at = KINDS[kind].make(Path(name), seed).relative_to(name)
        paths = [path for path in Path(name).rglob("*") if path.is_file()]
        return {str(path.relative_to(name)): path.read_bytes() for path in paths}, str(at)


def judge(kind: Kind, path: Path, again: Path, whole: bytes) -> Outcome:
    """What becomes of a damaged file that held ``whole``."""
    try:
        kind.again(path, again)
    except ValueError as error:
        text = str(error)
        true = "\n" not in text and path.name in text
        return {"outcome": REFUSED if true else RAW, "message": text}
    except Exception as error:  # whatever it is: that is what is counted
        return {"outcome": RAW, "message": f"{type(error).__name__}: {error}"}
    return {"outcome": SAME if again.read_bytes() == whole else OTHER, "message": ""}


def damaged(whole: bytes, foreign: bytes, rng: np.random.Generator) -> tuple[str, bytes]:
    """Name of a damage and what it makes of the bytes ``whole`` (or of them and those of another file of the kind)."""
    while True:
        name = str(rng.choice(list(DAMAGES)))
        content = DAMAGES[name](whole, foreign, rng)
        if content not in (whole, foreign):  # zeros over zeros are no damage, nor is all of the other file
            return name, content


def _flip(bits: int) -> Callable[[bytes, bytes, np.random.Generator], bytes]:
    def flip(whole: bytes, _: bytes, rng: np.random.Generator) -> bytes:
        content = bytearray(whole)
        for bit in rng.integers(8 * len(whole), size=bits):
            content[bit // 8] ^= 1 << bit % 8
        return bytes(content)

    return flip


def _stretch(whole: bytes, rng: np.random.Generator) -> tuple[int, int]:
    """First and last byte of a stretch of 1 to 4096 bytes, short ones as likely as long ones."""
    first = int(rng.integers(len(whole)))
    return first, min(len(whole), first + int(2.0 ** rng.uniform(0.0, 12.0)))


def _over(whole: bytes, fill: Callable[[int], bytes], rng: np.random.Generator) -> bytes:
    first, last = _stretch(whole, rng)
    return whole[:first] + fill(last - first) + whole[last:]


def _swap(whole: bytes, _: bytes, rng: np.random.Generator) -> bytes:
    blocks = [whole[k : k + 512] for k in range(0, len(whole), 512)]
    i, j = rng.integers(len(blocks), size=2)
    blocks[i], blocks[j] = blocks[j], blocks[i]
    return b"".join(blocks)


def _insert(whole: bytes, _: bytes, rng: np.random.Generator) -> bytes:
    at, size = int(rng.integers(len(whole))), int(rng.integers(1, 65))
    return whole[:at] + rng.bytes(size) + whole[at:]


def _remove(whole: bytes, _: bytes, rng: np.random.Generator) -> bytes:
    first, last = _stretch(whole, rng)
    return whole[:first] + whole[last:]


def _splice(whole: bytes, foreign: bytes, rng: np.random.Generator) -> bytes:
    at = int(rng.integers(1, min(len(whole), len(foreign))))
    return whole[:at] + foreign[at:]


DAMAGES: dict[str, Callable[[bytes, bytes, np.random.Generator], bytes]] = {
    "one bit": _flip(1),
    "some bits": _flip(8),
    "cut": lambda whole, _, rng: whole[: int(rng.integers(1, len(whole)))],
    "empty": lambda *_: b"",
    "overwritten": lambda whole, _, rng: _over(whole, rng.bytes, rng),
    "zeros": lambda whole, _, rng: _over(whole, bytes, rng),
    "ones": lambda whole, _, rng: _over(whole, lambda size: b"\xff" * size, rng),
    "blocks swapped": _swap,
    "appended": lambda whole, _, rng: whole + rng.bytes(int(rng.integers(1, 5000))),
    "inserted": _insert,
    "removed": _remove,
    "half of another file": _splice,
}


@lru_cache(maxsize=2)
def episodes(seed: int) -> Episodes:
    """Two short episodes of three states."""
    rng = np.random.default_rng([1, seed])
    us = [rng.normal(size=(k, 2)) for k in (20, 30)]
    xs = [np.cumsum(rng.normal(size=(len(u) + 1, 3)), axis=0) for u in us]
    extra = {"state": [rng.normal(size=(len(x), 4)) for x in xs], "names": [np.array(["a", "b"])] * 2}
    return Episodes(
        xs, us, 0.1, units=("m", "m", "rad"), outputs={"tip": (0, 1)}, extra=extra, provenance={"seed": seed}
    )


@lru_cache(maxsize=2)
def samples(seed: int) -> PhaseSamples:
    """Fifty samples with their flow."""
    rng = np.random.default_rng([2, seed])
    x, u, xdot, half = (rng.normal(size=(50, n)) for n in (3, 2, 3, 3))
    return PhaseSamples(x, u, xdot, half, 0.1, ("a", "b", "c"), ("u", "v"), {"seed": seed}, rng.uniform(size=50))


@lru_cache(maxsize=2)
def dictionary(seed: int) -> Dictionary:
    """Columns with delays, slack, squares and products."""
    kinds = ob.Identity(), ob.Slack(), ob.Polynomials(2 + seed), ob.Delays(states=1, inputs=1)
    return Dictionary(*kinds, n_states=3, n_inputs=2)


@lru_cache(maxsize=2)
def model(seed: int) -> LiftedModel:
    """A bilinear model."""
    return BilinearEDMDc(dictionary(seed), alpha=0.1).fit(episodes(seed)).lifted


def _saved(name: str, made: Callable[[int], Saved]) -> Callable[[Path, int], Path]:
    def make(folder: Path, seed: int) -> Path:
        made(seed).save(folder / name)
        return folder / name

    return make


def _loaded(load: Callable[[Path], Saved]) -> Callable[[Path, Path], None]:
    return lambda path, again: load(path).save(again)


def block(k: int) -> Block:
    """Arrays of numbers and of texts."""
    return {"x": np.random.default_rng([3, k]).normal(size=(20, 3)), "failures": np.array(["", f"block {k}"])}


def _run(folder: Path, seed: int) -> None:
    run_blocks(block, 2, folder / "parts", {"seed": seed}, workers=1, progress=False)


def _make_block(folder: Path, seed: int) -> Path:
    _run(folder, seed)
    return folder / "parts" / "000001.h5"


def _make_marker(folder: Path, seed: int) -> Path:
    _run(folder, seed)
    return folder / "parts" / "run.json"


def _continue(path: Path, again: Path) -> None:
    """The run goes on from a damaged file, and its other copy is what is there then."""
    _run(path.parents[1], 0)
    again.write_bytes(path.read_bytes())


CELL = Cell("law", "method", 16, 300, 0)


def _make_cell(folder: Path, seed: int) -> Path:
    rng = np.random.default_rng([4, seed])
    errors = Errors(rng.uniform(size=(4, 50)), rng.uniform(size=(4, 50)), np.full(4, -1))
    write(CELL, folder, Result(errors, 0.5, {"alpha": 0.1, "seed": seed}))
    return CELL.path(folder)


def _again_cell(path: Path, again: Path) -> None:
    write(CELL, again.with_name("copy"), read(CELL, path.parents[2]))
    again.write_bytes(CELL.path(again.with_name("copy")).read_bytes())


def _again_json(path: Path, again: Path) -> None:
    store.save_json(again, store.load_json(path))


def _make_json(folder: Path, seed: int) -> Path:
    rows = [{"outcome": "ok", "error": float(e)} for e in np.random.default_rng([5, seed]).normal(size=20)]
    store.save_json(folder / "unfinished.json", {"arguments": {"seed": seed}, "outcomes": rows})
    return folder / "unfinished.json"


KINDS: dict[str, Kind] = {
    "model": Kind(_saved("model.h5", model), _loaded(LiftedModel.load)),
    "dictionary": Kind(_saved("theta.h5", dictionary), _loaded(Dictionary.load)),
    "episodes": Kind(_saved("d1.h5", episodes), _loaded(Episodes.load)),
    "phase samples": Kind(_saved("d2.h5", samples), _loaded(PhaseSamples.load)),
    "block of a run": Kind(_make_block, _continue),
    "marker of a run": Kind(_make_marker, _continue),
    "cell of a protocol": Kind(_make_cell, _again_cell),
    "cases of a stress run": Kind(_make_json, _again_json),
}
