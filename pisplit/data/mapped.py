"""Arrays that stay in their file: pages are read when they are used, and given back once a block has been."""

from __future__ import annotations

import mmap
import os
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: Rows that are looked at at once where a whole array is.
CHUNK = 1 << 16


def mapped(path: str | os.PathLike[str], offset: int, shape: tuple[int, int], name: str) -> Array:
    """Read-only array of ``shape``, the double-precision numbers at byte ``offset`` of the file ``path``.

    Raises ValueError, which calls it ``name``, for entries that are not finite.
    """
    with open(path, "rb") as file:
        memory = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
    array = np.frombuffer(memory, np.float64, shape[0] * shape[1], offset).reshape(shape)
    for first in range(0, len(array), CHUNK):
        finite = np.isfinite(array[first : first + CHUNK]).all(axis=1)
        if not finite.all():
            raise ValueError(f"{name} has NaN or infinite entries in row {first + int(np.argmin(finite))}")
        release(array)
    return array


def is_mapped(array: NDArray[Any]) -> bool:
    """Whether ``array`` is a view of a file that :func:`mapped` made."""
    return _memory(array) is not None


def release(array: NDArray[Any]) -> None:
    """Give back the pages of ``array``, where it is mapped: they are read again when they are asked for."""
    memory = _memory(array)
    if memory is not None and hasattr(memory, "madvise"):
        memory.madvise(mmap.MADV_DONTNEED)


def _memory(array: NDArray[Any]) -> mmap.mmap | None:
    base: Any = array
    while isinstance(base, np.ndarray):
        base = base.base
    found = base.obj if isinstance(base, memoryview) else base
    return found if isinstance(found, mmap.mmap) else None
