"""Files that a path, a pattern or a list of these names."""

from __future__ import annotations

import glob
import os
import re
from collections.abc import Iterable, Sequence
from pathlib import Path

Paths = str | os.PathLike[str] | Sequence[str | os.PathLike[str]]

DIGITS = re.compile(r"(\d+)")


def files_of(path: Paths) -> list[Path]:
    """The files of a ``path``: itself, those of a pattern in order of their names, or those of a list of these.

    Raises FileNotFoundError where a pattern fits no file, and ValueError for an empty list and files named twice.
    """
    if not isinstance(path, str | os.PathLike | Iterable):
        raise ValueError(f"path is a {type(path).__name__}; expected a file, a pattern or a list of these")
    if not isinstance(path, str | os.PathLike):
        found = [file for part in path for file in files_of(part)]
        if not found:
            raise ValueError("path is an empty list; give files or patterns")
        twice = sorted({str(file) for file in found if found.count(file) > 1})
        if twice:
            raise ValueError(f"{twice[0]} is named twice; its samples would count twice")
        return found
    text = os.fspath(path)
    if Path(text).exists() or not glob.has_magic(text):
        return [Path(text)]
    found = [Path(file) for file in sorted(glob.glob(text), key=_natural)]
    if not found:
        raise FileNotFoundError(f"{text} fits no file; expected a pattern such as 'run*.csv'")
    return found


def _natural(name: str) -> list[tuple[int, str]]:
    """Order of names by which run2 comes before run10."""
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in DIGITS.split(name)]
