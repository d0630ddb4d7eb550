"""What is odd about columns of recordings: constant, doubled, saturated, stalled, with spikes; and their noise."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pisplit.data.stalls import stalled
from pisplit.data.stretches import stretches

if TYPE_CHECKING:
    from pisplit.data.episodes import Episodes

Array = NDArray[np.float64]
Index = NDArray[np.int64]

#: Spread, relative to the largest magnitude, up to which a column is constant.
CONSTANT = 1e-9
#: Columns whose correlation is so near to one are multiples of each other.
SAME = 1.0 - 1e-10
#: A sensor saturates if it stays at its least or largest value in so many stretches, for this part of the time.
STOPS, STOPPED = 3, 0.02
#: A spike is off the mean of its neighbours by so many of the usual such distances (95th percentile).
SPIKE = 8.0
#: So few values are those of a switch.
FEW = 6
#: Noise of third differences is white if neighbours have a correlation below this; that of white noise is -0.75.
WHITE = -0.5


def rows_of(lengths: Sequence[int]) -> list[Index]:
    """Positions of the rows of every episode of these ``lengths`` in all of them, one below the other."""
    ends = np.cumsum(lengths)
    return [np.arange(end - size, end) for end, size in zip(ends, lengths, strict=True)]


def of_states(episodes: Episodes, runs: Sequence[Index]) -> list[list[str]]:
    """What is odd about every state of ``episodes``, whose rows are ``runs``, in words."""
    x = episodes.stacked_states()
    commands = np.concatenate([np.vstack([u, u[-1:]]) for u in episodes.us])
    still = stalled(x, commands, runs)
    found = _shared(x, episodes.state_names or ())
    for i, said in enumerate(found):
        column = x[:, i]
        if said[:1] == ["constant"]:
            continue
        said += _saturated(column, runs)
        if still[:, i].any():
            said.append(f"stalled: {int(still[:, i].sum())} readings repeat the last one")
        if spikes := _spikes(column, runs):
            said.append(f"{spikes} spikes")
        said += _few(column)
    return found


def of_inputs(episodes: Episodes) -> list[list[str]]:
    """What is odd about every input of ``episodes``, in words."""
    u = episodes.stacked_inputs()
    found = _shared(u, episodes.input_names or ())
    for i, said in enumerate(found):
        if said[:1] != ["constant"]:
            said += _few(u[:, i])
    return found


def noise_level(column: Array, runs: Sequence[Index]) -> float | None:
    """Standard deviation of white noise on a ``column`` (N,), robust, from third differences within the ``runs``.

    None where motion hides it: their neighbours are not as those of white noise, whose correlation is -3/4. Source:
    von Neumann's ratio for higher differences, Rice, Annals of Statistics 12, 1984.
    """
    parts = [np.diff(column[rows], 3) for rows in runs if len(rows) > 4]
    if not parts or sum(map(len, parts)) < 20:
        return None
    third = np.concatenate(parts)
    size = float((third**2).sum())
    if size <= (1e-12 * np.abs(column).max()) ** 2 * len(third):
        return 0.0
    middle = float(np.median(np.abs(third))) / (0.6745 * np.sqrt(20.0))
    clipped = [np.clip(part, *(np.array([-1.0, 1.0]) * 4.0 * np.sqrt(20.0) * max(middle, 1e-300))) for part in parts]
    power = sum(float((part**2).sum()) for part in clipped)
    beside = sum(float((part[1:] * part[:-1]).sum()) for part in clipped)
    return middle if middle > 0.0 and power > 0.0 and beside / power < WHITE else None


def usual_hold(column: Array, runs: Sequence[Index]) -> float:
    """Median number of steps for which a ``column`` (N,) stays the same within the ``runs``."""
    lengths = []
    for rows in runs:
        new = np.flatnonzero(np.append(True, np.diff(column[rows]) != 0.0))
        lengths.append(np.diff(np.append(new, len(rows))))
    return float(np.median(np.concatenate(lengths)))


def _shared(values: Array, names: Sequence[str]) -> list[list[str]]:
    """Columns that are constant, and that are others or multiples of others."""
    spread, largest = values.std(axis=0), np.abs(values).max(axis=0, initial=0.0)
    constant = spread <= CONSTANT * largest
    found: list[list[str]] = [["constant"] if still else [] for still in constant]
    moving = np.flatnonzero(~constant)
    unit = (values[:, moving] - values[:, moving].mean(axis=0)) / spread[moving] / np.sqrt(max(len(values), 1))
    alike = np.abs(unit.T @ unit)
    for b in range(len(moving)):
        for a in range(b):
            if alike[a, b] > SAME:
                i, j = int(moving[a]), int(moving[b])
                same = np.array_equal(values[:, i], values[:, j])
                found[j].append(f"{'the same as' if same else 'follows from'} {names[i]}")
                break
    return found


def _saturated(column: Array, runs: Sequence[Index]) -> list[str]:
    found = []
    for value, word in ((column.min(), "least"), (column.max(), "largest")):
        at = [pair for rows in runs for pair in stretches(column[rows] == value) if pair[1] - pair[0] > 1]
        if len(at) >= STOPS and sum(b - a for a, b in at) > STOPPED * len(column):
            found.append(f"saturated: {len(at)} times at its {word}")
    return found if len(np.unique(column)) > FEW else []


def _spikes(column: Array, runs: Sequence[Index]) -> int:
    off = np.concatenate([np.abs(column[r][1:-1] - 0.5 * (column[r][2:] + column[r][:-2])) for r in runs])
    apart = np.concatenate([np.abs(column[r][2:] - column[r][:-2]) for r in runs])
    if len(off) < 20:
        return 0
    usual = max(float(np.quantile(off, 0.95)), 1e-300)
    return int(((off > SPIKE * usual) & (off > 2.0 * apart)).sum())


def _few(column: Array) -> list[str]:
    values = np.unique(column)
    return [f"takes {len(values)} values"] if 1 < len(values) < FEW and len(column) > 10 * FEW else []
