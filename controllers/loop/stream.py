"""The log of a run on disk while it runs: an HDF5 file that grows, and that is valid up to its last flush if killed."""

from __future__ import annotations

import json
import os
import shutil
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from pisplit.checks import positive
from pisplit.controllers.loop.log import LoopLog
from pisplit.data.store import USER_BLOCK
from pisplit.files import reason

BEGINNING = b"pisplit log, written while it runs; LoopLog.load or h5py.File(path, swmr=True) opens it"
#: Numbers a step, beside states, reference and inputs.
PER_STEP = (
    "iterations",
    "fallback",
    "solve_time",
    "cpu_time",
    "plant_time",
    "missing",
    "rejected",
    "stuck",
    "jitter",
)
NAMES = ("state_names", "input_names", "state_units", "input_units")
#: Free space on the disk below which nothing more is written: HDF5 does not survive a full one.
SPARE = 1 << 24
#: Rows of a chunk, which HDF5 writes as one, and bytes of a text.
ROWS, TEXT = 64, 512
CUT = "the file ends here: the run was killed, or goes on"


class LogStream:
    """An HDF5 file at ``path`` to which the steps of a run are appended: by groups, ``every`` so many seconds.

    The file is in HDF5's mode for one writer and many readers: what was flushed stays readable whatever ends the
    process, and a reader may look at it while the run goes on. Chunks carry checksums.

    Args:
        path: of the file; one that is there is replaced.
        start: log of the run at its beginning, or of what was run before.
        every: seconds between two writings.

    Raises ValueError in one line where the file cannot be written.
    """

    def __init__(self, path: str | os.PathLike[str], start: LoopLog, every: float = 1.0) -> None:
        self.path, self.every = Path(path), positive(every, "every", "s")
        self._rows, self._notes = 0, 0
        try:
            if self.path.is_dir():
                raise ValueError(f"{self.path} is a folder; give a file")
            self._file = h5py.File(self.path, "w", libver="latest", userblock_size=USER_BLOCK)
            self._make(start)
            self._file.flush()
            with self.path.open("r+b") as stream:
                stream.write(BEGINNING)
            self._file.swmr_mode = True
        except (OSError, RuntimeError) as error:
            raise ValueError(f"{self.path} cannot be written: {reason(error)}") from None
        self._due = time.monotonic() + self.every

    def _make(self, log: LoopLog) -> None:
        still = {"dt": log.dt, "u0": log.u0, "tracked": np.array(log.tracked, dtype=np.int64)}
        for name, value in still.items():
            self._file[name] = value
        for name in NAMES:
            self._file[name] = np.bytes_(json.dumps(getattr(log, name)).encode())
        self._grow("notes", _texts(()))
        self._grow("limit_violations", np.zeros(0, dtype=np.int64))
        for name, rows in _rows(log).items():
            self._grow(name, rows[:0])
        self._append(log)

    def _grow(self, name: str, like: Any) -> None:
        shape = (None, *like.shape[1:])
        self._file.create_dataset(
            name, like.shape, like.dtype, maxshape=shape, chunks=(ROWS, *like.shape[1:]), fletcher32=True
        )

    def _append(self, log: LoopLog) -> None:
        """Write the rows of ``log``, which begins at the first step that is not in the file yet, and its notes."""
        for name, rows in _rows(log).items():
            if name in ("x", "reference") and self._rows:
                rows = rows[1:]  # its first row is the last of the file
            self._put(name, rows)
        self._rows += len(log.x) - (1 if self._rows else 0)
        self._put("limit_violations", np.array([log.limit_violations]))
        self._put("notes", _texts(log.notes[self._notes :]))
        self._notes = len(log.notes)

    def _put(self, name: str, rows: Any) -> None:
        if len(rows):
            data = self._file[name]
            first = len(data)
            data.resize(first + len(rows), axis=0)
            data[first:] = rows

    @property
    def steps(self) -> int:
        """How many steps are in the file."""
        return max(0, self._rows - 1)

    def due(self) -> bool:
        """Whether it is time to write."""
        return time.monotonic() >= self._due

    def write(self, log: LoopLog) -> None:
        """Append ``log``: the steps after those in the file. Raises ValueError where that fails, a full disk say."""
        free = shutil.disk_usage(self.path.parent).free
        if free < SPARE:
            raise ValueError(f"{self.path} cannot be written any further: {free >> 20} MB are left on the disk")
        try:
            self._append(log)
            self._file.flush()
        except (OSError, RuntimeError) as error:
            raise ValueError(f"{self.path} cannot be written any further: {reason(error)}") from None
        self._due = time.monotonic() + self.every

    def close(self) -> None:
        """Close the file."""
        self._file.close()


def begins_as_stream(path: str | os.PathLike[str]) -> bool:
    """Whether the file ``path`` is there and was begun by a :class:`LogStream`."""
    try:
        with open(path, "rb") as file:
            return file.read(len(BEGINNING)) == BEGINNING
    except OSError:
        return False


def read_stream(path: str | os.PathLike[str]) -> LoopLog:
    """The log in the file ``path`` of a :class:`LogStream`, up to its last flush; its ``message`` says so.

    Raises ValueError in one line where the file is damaged.
    """
    try:
        with h5py.File(path, "r", libver="latest", swmr=True) as file:
            N = min(len(file["x"]) - 1, *(len(file[name]) for name in (*PER_STEP, "statuses", "actions", "u")))
            parts: dict[str, Any] = {name: np.asarray(file[name][: N + 1]) for name in ("x", "reference")}
            parts |= {name: np.asarray(file[name][:N]) for name in (*PER_STEP, "u")}
            for name in ("statuses", "actions"):
                parts[name] = tuple(text.decode() for text in file[name][:N])
            parts["notes"] = tuple(text.decode() for text in file["notes"][()])
            for name in NAMES:
                parts[name] = tuple(json.loads(file[name][()]))
            dt = float(file["dt"][()])
            tracked = tuple(int(i) for i in file["tracked"][()])
            violations = int(file["limit_violations"][()].sum())
            return LoopLog(
                dt=dt,
                t=dt * np.arange(N + 1, dtype=np.float64),
                u0=np.asarray(file["u0"][()]),
                tracked=tracked,
                limit_violations=violations,
                message=CUT,
                **parts,
            )
    except (OSError, RuntimeError, KeyError, ValueError) as error:
        raise ValueError(
            f"{os.fspath(path)} is damaged, or was killed before its first step: {reason(error)}"
        ) from None


def _rows(log: LoopLog) -> dict[str, Any]:
    return {
        "x": log.x,
        "reference": log.reference,
        "u": log.u,
        "statuses": _texts(log.statuses),
        "actions": _texts(log.actions),
        **{name: getattr(log, name) for name in PER_STEP},
    }


def _texts(texts: Sequence[str]) -> NDArray[np.bytes_]:
    """Texts as HDF5 can append them: of one length, cut at a whole character."""
    cut = [text.encode()[:TEXT].decode(errors="ignore").encode() for text in texts]
    return np.array(cut, dtype=f"S{TEXT}")
