"""Windows of recordings that a calibration learns from, and stretches of held-out ones that it is judged on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pisplit import Episodes
from pisplit.checks import Array, count, finite_array

#: Steps of windows, the longest first, that the recorded spans may be cut into, and the fewest windows of such a length
#: that are enough: slow motions and friction tell themselves over long ones, and start states cost unknowns.
LENGTHS, ENOUGH = (64, 32, 16, 8, 5), 8
#: Steps of all windows together; more of them say little that is new.
BUDGET = 640
#: The same, and steps of the longest window, of those by which forms and groups are compared.
FEW, SHORT = 128, 16
#: Most held-out stretches.
MOST = 8


@dataclass(frozen=True, eq=False)
class Windows:
    """N windows of T steps.

    Attributes:
        fields: measured fields (N, T+1, n).
        logs: for each of them all commands (D, m) up to its end, from rest on.
        rows: (N, 2) recording and step at which each begins.
    """

    fields: Array
    logs: tuple[Array, ...]
    rows: NDArray[np.int64]

    @property
    def steps(self) -> int:
        """Steps T of each."""
        return self.fields.shape[1] - 1

    def __len__(self) -> int:
        return len(self.fields)

    @classmethod
    def of(
        cls,
        recordings: Episodes,
        spans: ArrayLike | None,
        before: Array,
        budget: int = BUDGET,
        longest: int = LENGTHS[0],
    ) -> Windows:
        """Windows of equal length from the recorded spans: the longest of which there are eight, spread evenly.

        Args:
            recordings: episodes of fields.
            spans: (K, 3) recording, first and last step of what may be used; spans that overlap or touch are joined.
                All of every recording if not given.
            before: commands (m,) at rest, before each recording.
            budget: most steps of all windows together.
            longest: steps that no window is longer than.

        Raises ValueError for spans outside the recordings.
        """
        joined = _joined(recordings, spans)
        found = [(e, a, b) for e, parts in joined.items() for a, b in parts if b > a]
        if not found:
            raise ValueError("spans hold no step; give the first and the last of two or more instants each")
        allowed = [n for n in LENGTHS if n <= longest]
        lengths = [n for n in allowed if any(b - a >= n for _, a, b in found)] or [max(b - a for _, a, b in found)]
        for length in lengths:  # the shortest where no length gives enough of them
            rows = [(e, a + k * length) for e, a, b in found for k in range((b - a) // length)]
            if len(rows) >= ENOUGH:
                break
        most = max(ENOUGH, count(budget, "budget") // length)
        if len(rows) > most:
            rows = [rows[i] for i in np.linspace(0, len(rows) - 1, most).astype(int)]
        fields = np.stack([recordings.xs[e][a : a + length + 1] for e, a in rows])
        logs = tuple(np.vstack([before, recordings.us[e][: a + length]]) for e, a in rows)
        return cls(fields, logs, np.array(rows, dtype=np.int64))


def stretches(recordings: Episodes, steps: int, first: int = 4, most: int = MOST) -> list[tuple[int, int, int]]:
    """Recording, first and last step of what roll-outs of so many ``steps`` are compared with.

    Each recording of ``recordings`` is cut from its step ``first`` on; one that is shorter gives what it has. Where
    they make more than ``most`` stretches, these are spread evenly over them.
    """
    found = []
    for e, u in enumerate(recordings.us):
        begin = min(first, len(u) - 1)
        whole = max(1, (len(u) - begin) // count(steps, "steps"))
        found += [(e, begin + k * steps, min(begin + (k + 1) * steps, len(u))) for k in range(whole)]
    return [found[i] for i in np.unique(np.linspace(0, len(found) - 1, min(most, len(found))).astype(int))]


def _joined(recordings: Episodes, spans: ArrayLike | None) -> dict[int, list[tuple[int, int]]]:
    """First and last steps of spans by recording, those that overlap or touch as one."""
    if spans is None:
        return {e: [(0, len(u))] for e, u in enumerate(recordings.us)}
    rows: Sequence[Sequence[int]] = finite_array(spans, "spans", (None, 3)).astype(int).tolist()
    found: dict[int, list[tuple[int, int]]] = {}
    for e, first, last in sorted(map(tuple, rows)):
        if not 0 <= e < len(recordings) or not 0 <= first <= last <= len(recordings.us[e]):
            raise ValueError(f"span {e, first, last} is outside the recordings; expected (recording, first, last step)")
        parts = found.setdefault(e, [])
        if parts and first <= parts[-1][1]:
            parts[-1] = parts[-1][0], max(parts[-1][1], last)
        else:
            parts.append((first, last))
    return found
