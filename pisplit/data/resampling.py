"""From samples at their own times to steps of one length: states are interpolated, commands are held."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Index = NDArray[np.int64]

#: A signal is bridged over gaps of so many of its own sample spacings.
BRIDGED = 3.0
#: Part of a step that rounding of a clock may add or take.
ROUNDING = 1e-6

Interval = tuple[float, float]


@dataclass(frozen=True)
class Signal:
    """Columns of a recording that were read at the same times: ``columns`` (k,), times (N,), values (N, k), finite."""

    columns: Index
    times: Array
    values: Array

    @property
    def spacing(self) -> float:
        """Median time between readings [s]; infinite for fewer than two."""
        return float(np.median(np.diff(self.times))) if len(self.times) > 1 else np.inf

    def covered(self, gap: float) -> list[Interval]:
        """Spans of time without a gap longer than ``gap`` [s] between readings."""
        if len(self.times) == 0:
            return []
        cuts = np.flatnonzero(np.diff(self.times) > gap)
        first, last = np.append(0, cuts + 1), np.append(cuts, len(self.times) - 1)
        return list(zip(self.times[first].tolist(), self.times[last].tolist(), strict=True))

    def interpolated(self, grid: Array, gap: float, kind: str) -> Array:
        """Values (T+1, k) at times ``grid`` (T+1,) [s]; ``kind`` "linear" or "cubic".

        The grid lies in one span that is covered without a gap longer than ``gap`` [s].
        """
        low, high = next(span for span in self.covered(gap) if span[0] <= grid[0] <= span[1])
        own = (self.times >= low) & (self.times <= high)
        times, values = self.times[own], self.values[own]
        if kind == "cubic" and len(times) > 3:
            from scipy.interpolate import CubicSpline  # brings scipy.optimize, half of the import time of the package

            return np.asarray(CubicSpline(times, values, axis=0)(grid))
        return np.column_stack([np.interp(grid, times, column) for column in values.T])

    def held(self, grid: Array) -> Array:
        """Mean (T, k) over every step of ``grid`` (T+1,) of commands that hold from one reading to the next.

        A step within which no command arrives has the command itself, to the last digit.
        """
        slack = ROUNDING * float(np.diff(grid).min())
        first = np.searchsorted(self.times, grid[:-1] + slack, side="right") - 1
        last = np.searchsorted(self.times, grid[1:] - slack, side="left") - 1
        found = self.values[first]
        changing = np.flatnonzero(last > first)
        if len(changing):
            times = np.append(self.times, max(self.times[-1], grid[-1]))
            parts = self.values * np.diff(times)[:, None]
            integral = np.vstack([np.zeros(parts.shape[1]), np.cumsum(parts, axis=0)])
            ends = np.stack([grid[changing], grid[changing + 1]])
            at = np.stack([np.interp(ends, times, column) for column in integral.T], axis=-1)
            found[changing] = (at[1] - at[0]) / (ends[1] - ends[0])[:, None]
        return found


def signals(times: Array, values: Array) -> list[Signal]:
    """Columns of ``values`` (N, k) at ``times`` (N,), increasing, grouped by the times at which they are finite."""
    read = np.isfinite(values)
    groups: dict[bytes, list[int]] = {}
    for column in range(values.shape[1]):
        groups.setdefault(read[:, column].tobytes(), []).append(column)
    found = []
    for columns in groups.values():
        rows = np.flatnonzero(read[:, columns[0]])
        found.append(Signal(np.array(columns), times[rows], values[rows[:, None], columns]))
    return found


def pieces(
    states: Sequence[Signal], inputs: Sequence[Signal], step: float, max_gap: float | None
) -> tuple[list[Array], list[Interval]]:
    """Grids (T_i + 1,) of steps [s] that all signals cover, and the spans of time that are shorter than a step.

    states   the signals that are interpolated: no grid reaches over a gap in any of them
    inputs   the commands, each held from its first reading on, however long
    max_gap  longest gap [s]; None: 3 times the spacing of the signal, or 3 steps
    """
    spans: list[Interval] = [(max((s.times[0] for s in inputs if len(s.times)), default=-np.inf), np.inf)]
    if not all(len(s.times) for s in inputs):
        return [], []
    for signal in states:
        spans = _both(spans, signal.covered(longest_gap(signal, step, max_gap)))
    grids, short = [], []
    finest = min(states, key=lambda signal: signal.spacing).times
    for low, high in spans:
        at = int(np.searchsorted(finest, low - ROUNDING * step))
        if at < len(finest) and finest[at] <= high:
            low = max(low, float(finest[at]))  # where commands come late a grid begins with a reading all the same
        count = int(np.floor((high - low) / step * (1.0 + 1e-9) + ROUNDING))  # rounding must not cost the last step
        if count < 1:
            short.append((low, high))
        else:
            grids.append(np.minimum(low + step * np.arange(count + 1), high))
    return grids, short


def longest_gap(signal: Signal, step: float, max_gap: float | None) -> float:
    """The longest gap [s] of ``signal`` that is bridged at ``step``: ``max_gap``, or by default from its spacing."""
    if max_gap is not None:
        return max_gap
    return BRIDGED * max(signal.spacing if len(signal.times) > 1 else 0.0, step)


def columns_at(signals: Sequence[Signal], parts: Sequence[Array], rows: int) -> Array:
    """One array (rows, k) of ``parts``, one (rows, k_i) for each of the ``signals``, in the columns of its signal."""
    found = np.empty((rows, sum(len(signal.columns) for signal in signals)))
    for signal, part in zip(signals, parts, strict=True):
        found[:, signal.columns] = part
    return found


def _both(first: Sequence[Interval], second: Sequence[Interval]) -> list[Interval]:
    """Spans that lie in one of ``first`` and in one of ``second``; both are in order."""
    found, i, j = [], 0, 0
    while i < len(first) and j < len(second):
        low, high = max(first[i][0], second[j][0]), min(first[i][1], second[j][1])
        if low <= high:
            found.append((low, high))
        if first[i][1] < second[j][1]:
            i += 1
        else:
            j += 1
    return found
