"""HDF5 files that are written whole or not at all, that say what they contain, and that are verified before use.

A file begins with a block of 512 bytes, which HDF5 leaves to its users: any HDF5 reader opens the file. The block holds
the SHA-256 digest of all other bytes of the file. It is compared before the HDF5 library or CasADi see a single byte:
both may return other numbers, ask for any amount of memory or end the process where a file is damaged. The digest
guards against accidents, not against people who compute it anew.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, BinaryIO
from urllib.parse import quote, unquote

import casadi as ca
import h5py
import numpy as np
from numpy.typing import NDArray

from pisplit.files import reason, replacing
from pisplit.files import write_text as write_file

#: 1 had no digest; :func:`seal` adds it.
FORMAT_VERSION = 2
USER_BLOCK = 512
BEGINNING = b"pisplit file, verified when it is read\nsha256 "
DIGITS = 64
ABOUT = b"\nis the digest of all bytes but itself and those before it. Any HDF5 reader opens this file.\n"
HDF5_SIGNATURE = b"\x89HDF\r\n\x1a\n"
CASADI = str(ca.CasadiMeta.version())
#: Bytes that are hashed at a time.
CHUNK = 1 << 20


@contextmanager
def writing(path: str | os.PathLike[str], kind: str) -> Iterator[h5py.File]:
    """Open a new HDF5 file of ``kind``; it replaces ``path`` only if the body of the ``with`` succeeds.

    Kind, format and the versions of pisplit and CasADi are attributes of the file. Raises ValueError in one line where
    the file cannot be written (:func:`pisplit.files.replacing`).
    """
    # Through a Python file: at the end of a full disk the HDF5 library's own ends the process.
    with replacing(path) as part, part.open("r+b") as stream:
        with h5py.File(stream, "w", userblock_size=USER_BLOCK) as file:
            file.attrs["kind"] = kind
            file.attrs["version"] = FORMAT_VERSION
            file.attrs["pisplit"] = _pisplit_version()
            file.attrs["casadi"] = CASADI
            yield file
        stream.seek(0)
        stream.write(BEGINNING + b"0" * DIGITS + ABOUT.ljust(USER_BLOCK - len(BEGINNING) - DIGITS))
        digest = _digest(stream)
        stream.seek(len(BEGINNING))
        stream.write(digest)


@contextmanager
def reading(path: str | os.PathLike[str], kind: str) -> Iterator[h5py.File]:
    """Open an HDF5 file ``path`` of :func:`writing` that must be of ``kind``, once its digest has been verified.

    Raises FileNotFoundError if it is missing, ValueError in one line that names the file if it is damaged, foreign, of
    another kind, of a newer version, cannot be read, or lacks a part that the body reads.
    """
    with _verified(path) as stream:
        try:
            with h5py.File(stream, "r") as file:
                _check_kind(file, kind)
                yield file
        except KeyError as error:
            raise ValueError(f"{os.fspath(path)} lacks a part: {reason(error)}; write it again") from None
        except (ValueError, OSError, RuntimeError) as error:
            raise ValueError(f"{os.fspath(path)}: {reason(error)}") from None


def seal(path: str | os.PathLike[str]) -> None:
    """Write a file of format 1, which had no digest, anew with one; a file that has it is verified and left alone.

    What format 1 holds cannot be verified: use it on files that are known to be whole. Raises FileNotFoundError if
    ``path`` is missing, ValueError if it is no HDF5 file that pisplit wrote, or if it is damaged.
    """
    if _begins(path, BEGINNING):
        with _verified(path):
            return
    try:
        with h5py.File(path, "r") as old:
            kind = old.attrs.get("kind")
            if not isinstance(kind, str) or not kind.startswith("pisplit/"):
                raise ValueError(f"{os.fspath(path)} was not written by pisplit: it names no kind of its own")
            with writing(path, kind) as new:
                for name in old:
                    old.copy(name, new)
                for name in old.attrs.keys() - new.attrs.keys():
                    new.attrs[name] = old.attrs[name]
                new.attrs["casadi"] = "unknown"
    except (OSError, RuntimeError, KeyError) as error:
        raise ValueError(f"{os.fspath(path)} is no readable HDF5 file: {reason(error)}") from None


def write_strings(group: h5py.Group, name: str, values: Sequence[str]) -> None:
    """Write the texts ``values`` as one dataset ``name`` of ``group``, of variable-length UTF-8 strings."""
    group.create_dataset(name, data=list(values), shape=(len(values),), dtype=h5py.string_dtype())


def read_strings(group: h5py.Group, name: str) -> tuple[str, ...]:
    """Read what :func:`write_strings` wrote as ``name`` into ``group``."""
    return tuple(str(value) for value in group[name].asstr()[()])


def write_text(group: h5py.Group, name: str, value: str) -> None:
    """Write one text ``value`` of any length as dataset ``name`` of ``group``."""
    group.create_dataset(name, data=value, dtype=h5py.string_dtype())


def read_text(group: h5py.Group, name: str) -> str:
    """Read what :func:`write_text` wrote as ``name`` into ``group``."""
    return str(group[name].asstr()[()])


def write_json(group: h5py.Group, name: str, value: Any) -> None:
    """Write a JSON-able ``value`` (dict, list, number, text) as text ``name`` of ``group``; ValueError for others."""
    try:
        write_text(group, name, json.dumps(value))
    except TypeError as error:
        raise ValueError(f"{name} cannot be written as JSON: {error}; use numbers, texts, lists, dicts") from None


def read_json(group: h5py.Group, name: str) -> Any:
    """Read what :func:`write_json` wrote as ``name`` into ``group``."""
    return json.loads(read_text(group, name))


def as_key(name: str) -> str:
    """``name`` as HDF5 takes it for a part of a file: plain names as they are, "a/b" as "a%2Fb"."""
    return quote(name, safe=" +-,:;()[]*^=<>").replace(".", "%2E") or "%"


def from_key(key: str) -> str:
    """The name that :func:`as_key` made ``key`` of."""
    return "" if key == "%" else unquote(key)


def write_arrays(group: h5py.Group, arrays: Mapping[str, NDArray[Any]]) -> None:
    """Write ``arrays`` of numbers, truth values or texts into ``group`` under their names. ValueError for others."""
    for name, given in arrays.items():
        array = np.asarray(given)
        try:
            if array.dtype.kind == "U":
                group.create_dataset(as_key(name), data=array.astype(object), dtype=h5py.string_dtype())
            else:
                group.create_dataset(as_key(name), data=array)
        except TypeError:
            raise ValueError(
                f"{name!r} is an array of {array.dtype}; a file holds numbers, truth values and texts: convert it"
            ) from None


def read_arrays(group: h5py.Group) -> dict[str, NDArray[Any]]:
    """Read what :func:`write_arrays` wrote into ``group``.

    They come in the order of writing if that is kept (``track_order``).
    """
    found: dict[str, NDArray[Any]] = {}
    for key, dataset in group.items():
        name = from_key(key)
        if h5py.check_string_dtype(dataset.dtype) is None:
            found[name] = np.asarray(dataset[()])
        else:
            found[name] = np.asarray(dataset.asstr()[()], dtype=str)
    return found


def write_function(group: h5py.Group, name: str, function: ca.Function) -> None:
    """Write a CasADi ``function`` as one text ``name`` of ``group``, number by number exact."""
    write_text(group, name, function.serialize())


def read_function(group: h5py.Group, name: str) -> ca.Function:
    """Read what :func:`write_function` wrote as ``name`` into ``group``.

    Raises ValueError if a newer CasADi wrote it (its texts mean nothing to older ones), or if it refers to something
    that is not there, such as a shared library.
    """
    wrote = str(group.file.attrs["casadi"])
    if _release(wrote) > _release(CASADI):
        raise ValueError(f"{name} is a function of CasADi {wrote}, newer than {CASADI} here: update CasADi")
    try:
        return ca.Function.deserialize(read_text(group, name))
    except RuntimeError as error:
        raise ValueError(
            f"CasADi {CASADI} cannot build {name}, a function of CasADi {wrote}: {reason(error)}"
        ) from None


def save_json(path: str | os.PathLike[str], value: Any) -> None:
    """Write a JSON-able ``value`` to a text file ``path`` with its digest, whole or not at all.

    Missing folders are made.
    """
    write_file(path, _verifiable(value), make_folders=True)


def load_json(path: str | os.PathLike[str]) -> Any:
    """Read what :func:`save_json` wrote to ``path``.

    Raises FileNotFoundError if it is missing, ValueError in one line if it is damaged or was written by something else.
    """
    with _open(path) as stream:
        try:
            text = stream.read().decode()
            value = json.loads(text)["content"]
            if _verifiable(value) == text:  # not one byte may differ
                return value
        except (OSError, ValueError, KeyError, TypeError, RecursionError):
            pass
    raise ValueError(f"{os.fspath(path)} is damaged, or no file of pisplit; delete it")


def _verifiable(value: Any) -> str:
    digest = hashlib.sha256(json.dumps(value).encode()).hexdigest()
    return json.dumps({"sha256": digest, "content": value}, indent=1) + "\n"


@contextmanager
def _verified(path: str | os.PathLike[str]) -> Iterator[BinaryIO]:
    """The open file, whose digest has been found right: what is read from it is what was written."""
    with _open(path) as stream:
        try:
            fault = _fault(stream)
            stream.seek(0)
        except OSError as error:
            fault = f"cannot be read: {reason(error)}"
        if fault is not None:
            raise ValueError(f"{os.fspath(path)} {fault}")
        yield stream


def _fault(stream: BinaryIO) -> str | None:
    """What is wrong with a file, in words that follow its name; None if its digest is that of its content."""
    first = stream.read(USER_BLOCK)
    if not first.startswith(BEGINNING):
        return _foreign(first)
    if first[len(BEGINNING) :][:DIGITS] != _digest(stream):
        return "is damaged: cut, overwritten or changed since it was written; restore a copy or write it again"
    return None


def _digest(stream: BinaryIO) -> bytes:
    """Hexadecimal digest of all that follows the digest in the file."""
    digest, chunk = hashlib.sha256(), memoryview(bytearray(CHUNK))
    stream.seek(len(BEGINNING) + DIGITS)
    while size := stream.readinto(chunk):  # type: ignore[attr-defined]
        digest.update(chunk[:size])
    return digest.hexdigest().encode()


def _check_kind(file: h5py.File, kind: str) -> None:
    found, given = file.attrs["kind"], int(file.attrs["version"])
    if found != kind:
        raise ValueError(f"it holds {found!r}; expected {kind!r}")
    if given > FORMAT_VERSION:
        wrote = file.attrs["pisplit"]
        raise ValueError(f"format {given} of pisplit {wrote}; this one reads up to {FORMAT_VERSION}: update pisplit")


def _open(path: str | os.PathLike[str]) -> BinaryIO:
    target = Path(path)
    try:
        if target.exists() and not target.is_file():
            raise ValueError(f"{target} is {'a folder' if target.is_dir() else 'no regular file'}; give a file")
        return target.open("rb")
    except FileNotFoundError:
        raise FileNotFoundError(f"{target} does not exist") from None
    except OSError as error:
        raise ValueError(f"{target} cannot be read: {reason(error)}") from None


def _begins(path: str | os.PathLike[str], signature: bytes) -> bool:
    with _open(path) as stream:
        return stream.read(len(signature)) == signature


def _foreign(first: bytes) -> str:
    """What a file is that does not begin as pisplit's do."""
    if not first:
        return "is empty; write it again"
    if first.startswith(HDF5_SIGNATURE):
        return (
            "has no checksum of pisplit: if an older pisplit wrote it, pisplit.data.store.seal(path) adds one; "
            "if another program did, read it with h5py and give its arrays to Episodes or PhaseSamples"
        )
    return "is no file of pisplit, or its beginning is damaged; restore a copy or write it again"


def _release(number: str) -> tuple[int, ...]:
    """Major and minor number of a version; () if it is unknown."""
    return tuple(int(part) for part in number.split(".")[:2] if part.isdecimal())


def _pisplit_version() -> str:
    try:
        return version("pisplit")
    except PackageNotFoundError:  # a source tree that is run in place
        return "unknown"
