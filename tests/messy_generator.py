"""One motion in many spellings: what files hold, how they are asked for, and how what comes back is checked."""

from __future__ import annotations

import re
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from pisplit import Episodes

Array = NDArray[np.float64]

N, DT = 150, 0.01
T = DT * np.arange(N)
RNG = np.random.default_rng(5)
U = np.round(np.repeat(RNG.uniform(-1.0, 1.0, N // 6), 6), 6)
#: Two markers in m: tip X, Y, Z, base X, Y, Z, as a tracker sees them, with noise of 0.1 mm.
X = np.column_stack([0.30 + 0.1 * np.sin(3 * T), 0.2 * np.cos(2 * T), 0.5 + 0.05 * np.sin(5 * T)])
X = np.round(np.hstack([X, 0.3 * X + [0.2, 0.15, 0.1]]) + 1e-4 * RNG.standard_normal((N, 6)), 6)
TIP, BASE = ["tip X", "tip Y", "tip Z"], ["base X", "base Y", "base Z"]


def lines(columns: Sequence[Sequence[object]], delimiter: str = ",", decimal: str = ".") -> str:
    """Rows of ``columns``, numbers with their shortest digits."""

    def cell(value: object) -> str:
        return value if isinstance(value, str) else repr(float(value)).replace(".", decimal)  # type: ignore[arg-type]

    return "".join(delimiter.join(map(cell, row)) + "\n" for row in zip(*columns, strict=True))


def plain(header: str = "t,x,y,u", delimiter: str = ",", decimal: str = ".", **scale: float) -> str:
    """A table of time, tip X, tip Y and the command."""
    columns = [T * scale.get("t", 1.0), X[:, 0] * scale.get("x", 1.0), X[:, 1], U * scale.get("u", 1.0)]
    columns = [np.round(column, 14) for column in columns]
    head = f"{header.replace(',', delimiter)}\n" if header else ""
    return head + lines(columns, delimiter, decimal)  # type: ignore[arg-type]


@dataclass(frozen=True)
class File:
    """What is in a file, how it is asked for, and what has to come back: columns of the truth, or one line."""

    name: str
    content: str | bytes
    ask: dict[str, Any] = field(default_factory=dict)
    refused: str = ""
    warned: str = ""
    states: tuple[int, ...] = (0, 1)
    inputs: bool = True
    scale: float = 1.0
    units: tuple[str, ...] | None = None
    pieces: int = 1
    tolerance: float = 2e-6
    inputs_within: float = 1e-6
    dt: float = DT


ASK = {"time": "t", "states": ["x", "y"], "inputs": ["u"]}


def vicon() -> str:
    head = "Trajectories\n100\n,,arm:tip,,,arm:base,,,\nFrame,Sub Frame,X,Y,Z,X,Y,Z\n,,mm,mm,mm,mm,mm,mm\n"
    return head + "".join(f"{k + 1},0,{','.join(f'{1e3 * v:.3f}' for v in X[k])}\n" for k in range(N))


def sections(first: bool) -> str:
    """Vicon's file with the forces of a plate before the markers, or angles after them, each with its own head."""
    rows = "".join(f"{k + 1},0,1.5,{k},3\n" for k in range(250))
    other = "{0}\n1000\n,,{1},,,\nFrame,Sub Frame,X,Y,Z\n,,{2},{2},{2}\n" + rows
    if first:
        return other.format("Devices", "plate", "N") + "\n" + vicon()
    return vicon() + "\n" + other.format("Model Outputs", "angle", "deg")


def optitrack(header: bool = True) -> str:
    words = ["Rigid Body"] * 3 + ["Marker"] * 3
    head = (
        "Format Version,1.23,Take Name,run 1,Capture Frame Rate,100.0,Length Units,Millimeters\n\n"
        f",Type,{','.join(words)}\n,Name,tip,tip,tip,base,base,base\n,ID,1,1,1,2:8,2:8,2:8\n"
        f",,{','.join(['Position'] * 6)}\nFrame,Time (Seconds),X,Y,Z,X,Y,Z\n"
    )
    head = head if header else "Frame,Time (Seconds),X,Y,Z,X,Y,Z\n"
    return head + "".join(f"{k},{T[k]:.6f},{','.join(f'{1e3 * v:.3f}' for v in X[k])}\n" for k in range(N))


def check(file: File, tmp_path: Path) -> None:
    """What comes back is the motion, or one line; what is said is what has to be."""
    path = tmp_path / "run.csv"
    path.write_bytes(file.content if isinstance(file.content, bytes) else file.content.encode())
    ask = {**ASK, **file.ask}
    if file.refused:
        with pytest.raises((ValueError, FileNotFoundError), match=file.refused) as error:
            Episodes.from_csv(path, **ask)
        assert "\n" not in str(error.value)
        return
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        found = Episodes.from_csv(path, **ask)
    texts = [str(w.message) for w in said]
    assert any(re.search(file.warned, text) for text in texts) if file.warned else not texts, texts
    assert len(found) == file.pieces and found.dt == pytest.approx(file.dt, rel=2e-6)
    truth = X[:, file.states]
    at = 0
    for x, u in zip(found.xs, found.us, strict=True):
        at = at + int(np.argmin(np.abs(truth[at:] - x[0]).sum(axis=1)))
        np.testing.assert_allclose(x, truth[at : at + len(x)], atol=file.tolerance)
        if file.inputs:
            np.testing.assert_allclose(u[:, 0], U[at : at + len(u)], atol=file.inputs_within)
        at += len(x)
    assert at >= 0.6 * N
    if file.units is not None:
        assert found.units == file.units
