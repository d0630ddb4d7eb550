"""Copies of the source tree: the only place where mutated source ever stands."""

from __future__ import annotations

import hashlib
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from mutation.rooms import PACKAGE

COPIED = (*PACKAGE, "tests", "scripts", "docs", ".ci")
KEPT = {"__pycache__", ".hypothesis"}
#: Bytecode is matched by time and size: a mutated file has a time of its own, the same for every mutant.
MUTATED_TIME = 1_000_000_000


class Copy:
    """A copy of the tree at ``root`` in ``folder``; what is there already and unchanged is kept.

    Raises ValueError if ``root`` has no package or no tests.
    """

    def __init__(self, root: Path, folder: Path) -> None:
        if not (root / PACKAGE[0]).is_dir() or not (root / "tests").is_dir():
            raise ValueError(f"{root} has no folders {PACKAGE[0]} and tests; expected a source tree of the package")
        self.folder = folder
        wanted = dict(_files(root))
        for name in sorted(set(dict(_files(folder))) - set(wanted)):
            (folder / name).unlink()
        for name, source in wanted.items():
            target, stat = folder / name, source.stat()
            if target.exists() and _stamp(target.stat()) == _stamp(stat):
                continue
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(source, target)

    def take_bytecode(self, other: Copy) -> None:
        """Bytecode of the other copy, which is that of the same sources."""
        for path in other.folder.rglob("*.pyc"):
            target = self.folder / path.relative_to(other.folder)
            if not target.exists():
                target.parent.mkdir(parents=True, exist_ok=True)
                shutil.copy2(path, target)

    @contextmanager
    def changed(self, file: str, source: bytes) -> Iterator[None]:
        """The copy with other contents of one file."""
        path = self.folder / file
        before, stat = path.read_bytes(), path.stat()
        path.write_bytes(source)
        os.utime(path, (MUTATED_TIME, MUTATED_TIME))
        try:
            yield
        finally:
            path.write_bytes(before)
            os.utime(path, ns=(stat.st_atime_ns, stat.st_mtime_ns))

    def digest(self, *folders: str) -> str:
        """Hash of names and contents of all Python files in these folders."""
        found = hashlib.sha256()
        for folder in folders:
            for path in sorted((self.folder / folder).rglob("*.py")):
                found.update(path.relative_to(self.folder).as_posix().encode())
                found.update(hashlib.sha256(path.read_bytes()).digest())
        return found.hexdigest()[:16]


def file_digest(path: Path) -> str:
    """Hash of the contents of a file; empty if there is none."""
    return hashlib.sha256(path.read_bytes()).hexdigest()[:16] if path.is_file() else ""


def _files(root: Path) -> Iterator[tuple[str, Path]]:
    for path in sorted(root.iterdir()) if root.is_dir() else ():
        if path.is_file():
            yield path.name, path
        elif path.name in COPIED:
            for folder, folders, names in os.walk(path):
                folders[:] = [name for name in folders if name not in KEPT]
                for name in names:
                    inner = Path(folder) / name
                    yield inner.relative_to(root).as_posix(), inner


def _stamp(stat: os.stat_result) -> tuple[int, int]:
    return stat.st_mtime_ns, stat.st_size
