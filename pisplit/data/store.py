"""HDF5 files that are written whole or not at all, and that say what they contain."""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import h5py

FORMAT_VERSION = 1


@contextmanager
def writing(path: str | os.PathLike[str], kind: str) -> Iterator[h5py.File]:
    """Open a new HDF5 file of ``kind``; it replaces ``path`` only if the body of the ``with`` succeeds.

    The file is written beside its destination and moved there in one step, so a killed process leaves
    the old file or none, never half a file. Raises ValueError if the folder does not exist.
    """
    target = Path(path)
    if not target.parent.is_dir():
        raise ValueError(f"cannot write {target}: folder {target.parent} does not exist; create it first")
    handle, name = tempfile.mkstemp(dir=target.parent, prefix=f".{target.name}.", suffix=".part")
    os.close(handle)
    try:
        with h5py.File(name, "w") as file:
            file.attrs["kind"] = kind
            file.attrs["version"] = FORMAT_VERSION
            yield file
        os.chmod(name, 0o666 & ~_umask())
        os.replace(name, target)
    except BaseException:
        Path(name).unlink(missing_ok=True)
        raise


@contextmanager
def reading(path: str | os.PathLike[str], kind: str) -> Iterator[h5py.File]:
    """Open an HDF5 file that must be of ``kind``.

    Raises FileNotFoundError if it is missing, ValueError if it is truncated, no HDF5 file, of another kind,
    of a newer version, or lacks a part that the body reads.
    """
    target = Path(path)
    if not target.is_file():
        raise FileNotFoundError(f"{target} does not exist; expected a file of kind {kind!r}")
    try:
        file = h5py.File(target, "r")
    except OSError:
        raise ValueError(f"{target} is no readable HDF5 file (truncated or another format); write it again") from None
    with file:
        found = file.attrs.get("kind")
        if found != kind:
            raise ValueError(f"{target} holds {found!r}; expected {kind!r}")
        version = int(file.attrs.get("version", 0))
        if version > FORMAT_VERSION:
            raise ValueError(
                f"{target} has format version {version}; this pisplit reads up to {FORMAT_VERSION}: update it"
            )
        try:
            yield file
        except (KeyError, OSError, RuntimeError) as error:  # RuntimeError: a CasADi function that cannot be read
            raise ValueError(f"{target} is incomplete or damaged: {_one_line(error)}") from None


def write_strings(group: h5py.Group, name: str, values: Sequence[str]) -> None:
    """Write a list of texts as one dataset of variable-length UTF-8 strings."""
    group.create_dataset(name, data=list(values), shape=(len(values),), dtype=h5py.string_dtype())


def read_strings(group: h5py.Group, name: str) -> tuple[str, ...]:
    """Read what :func:`write_strings` wrote."""
    return tuple(str(value) for value in group[name].asstr()[()])


def write_text(group: h5py.Group, name: str, value: str) -> None:
    """Write one text of any length."""
    group.create_dataset(name, data=value, dtype=h5py.string_dtype())


def read_text(group: h5py.Group, name: str) -> str:
    """Read what :func:`write_text` wrote."""
    return str(group[name].asstr()[()])


def write_json(group: h5py.Group, name: str, value: Any) -> None:
    """Write a JSON-able value (dict, list, number, text) as one text."""
    write_text(group, name, json.dumps(value))


def read_json(group: h5py.Group, name: str) -> Any:
    """Read what :func:`write_json` wrote."""
    return json.loads(read_text(group, name))


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


def _one_line(error: BaseException) -> str:
    return " ".join(str(error).split())
