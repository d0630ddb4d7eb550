"""Files are written whole or not at all: beside their place first, then moved there in one step."""

from __future__ import annotations

import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

#: Characters of a file's name that the name of its unfinished copy begins with: file systems allow 255.
NAME_KEPT = 100


@contextmanager
def replacing(path: str | os.PathLike[str], make_folders: bool = False) -> Iterator[Path]:
    """Path of a new empty file that takes the place of ``path`` once the body of the ``with`` has succeeded.

    It lies in the same folder and has the same suffix. Its content is on disk before it is moved, so a killed process,
    a full disk or a power cut leaves the old file or none, never half a file; of two writers the later one wins. A link
    is followed.

    Args:
        path: the file to write.
        make_folders: create the folders above it that are missing, instead of refusing.

    Raises ValueError in one line if the folder is missing or cannot be written, ``path`` is a folder or a device, or
    the body meets an OSError, such as that of a full disk.
    """
    target = Path(os.path.realpath(path))
    try:
        if make_folders:
            target.parent.mkdir(parents=True, exist_ok=True)
        _check_place(path, target)
        part = _create_beside(target)
    except OSError as error:
        raise _unwritable(path, error) from None
    try:
        yield part
        _flush(part)
        os.replace(part, target)
        with suppress(OSError):  # not every system can flush a folder
            _flush(target.parent)
    except OSError as error:
        raise _unwritable(path, error) from None
    finally:
        with suppress(OSError):
            part.unlink()  # gone already if it was moved


def write_text(path: str | os.PathLike[str], text: str, make_folders: bool = False) -> None:
    """Write ``text`` in UTF-8 to ``path``, whole or not at all; ``make_folders`` and errors as in :func:`replacing`."""
    with replacing(path, make_folders) as part:
        part.write_bytes(text.encode())


def reason(error: BaseException) -> str:
    """What an error says, in one line; of an OSError what the system says, without its number and path."""
    told = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
    return " ".join(told.split()) or type(error).__name__


def _check_place(path: str | os.PathLike[str], target: Path) -> None:
    if target.is_dir():
        raise ValueError(f"cannot write {os.fspath(path)}: it is a folder; give the path of a file in it")
    if target.exists() and not target.is_file():
        raise ValueError(f"cannot write {os.fspath(path)}: it is no regular file; give another path")
    if not target.parent.is_dir():
        what = "is a file" if target.parent.exists() else "does not exist"
        raise ValueError(f"cannot write {os.fspath(path)}: folder {target.parent} {what}; create it first")


def _create_beside(target: Path) -> Path:
    """A new hidden file with the permissions that any new file gets."""
    name = f".{target.name[:NAME_KEPT]}.{secrets.token_hex(8)}.part{target.suffix[:NAME_KEPT]}"
    part = target.with_name(name)
    os.close(os.open(part, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o666))
    return part


def _flush(path: Path) -> None:
    """Wait until what was written to a file, or the entries of a folder, have reached the disk."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def _unwritable(path: str | os.PathLike[str], error: OSError) -> ValueError:
    return ValueError(f"cannot write {os.fspath(path)}: {reason(error)}; make room and permit it, or give another path")
