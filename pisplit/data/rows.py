"""Memory that nobody else can change: read-only arrays, and episodes as views of one block of them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pisplit.data.mapped import is_mapped

Array = NDArray[np.float64]


def frozen(array: NDArray[Any]) -> NDArray[Any]:
    """``array`` as a read-only array that shares no memory a caller could write to.

    It is copied unless it is one already, or a file that is mapped.
    """
    if not array.flags.writeable and is_mapped(array):
        return array
    owner = array if array.base is None else array.base
    if not array.flags.writeable and type(owner) is np.ndarray and owner.base is None and not owner.flags.writeable:
        return array
    copy = np.array(array)
    copy.setflags(write=False)
    return copy


def refrozen(state: dict[str, Any]) -> dict[str, Any]:
    """Attributes ``state`` of an unpickled or copied object with its arrays, which arrive writable, read-only again."""
    return {name: frozen(value) if isinstance(value, np.ndarray) else value for name, value in state.items()}


class Rows(tuple[Array, ...]):
    """Arrays (T_i, k), one an episode, that are read-only views of one block of memory.

    stacked  (sum of T_i, k) all rows, read-only
    lengths  T_i of every episode; they add up to the rows of ``stacked``
    """

    stacked: Array

    def __new__(cls, stacked: Array, lengths: Sequence[int]) -> Rows:
        if sum(lengths) != len(stacked):
            raise ValueError(
                f"{len(stacked)} rows for episodes of {sum(lengths)} in all; the file or array is incomplete"
            )
        memory = frozen(stacked)
        rows = super().__new__(cls, np.split(memory, np.cumsum(lengths)[:-1]))
        rows.stacked = memory
        return rows

    def __reduce__(self) -> tuple[Any, ...]:
        return Rows, (np.asarray(self.stacked), [len(part) for part in self])

    @classmethod
    def joined(cls, parts: Sequence[Array]) -> Rows:
        """Copies of ``parts``, arrays (T_i, k), in one block."""
        memory = np.empty((sum(map(len, parts)), parts[0].shape[1]))
        np.concatenate(list(parts), out=memory)
        memory.setflags(write=False)
        return cls(memory, [len(part) for part in parts])

    def take(self, which: Iterable[int]) -> Rows:
        """The arrays at the positions ``which``, at least one; neighbours in order share the memory of these."""
        chosen = list(which)
        ends = np.cumsum([len(part) for part in self])
        if all(b == a + 1 for a, b in pairwise(chosen)) and chosen[0] >= 0:
            first = int(ends[chosen[0]]) - len(self[chosen[0]])
            return Rows(self.stacked[first : int(ends[chosen[-1]])], [len(self[i]) for i in chosen])
        return Rows.joined([self[i] for i in chosen])
