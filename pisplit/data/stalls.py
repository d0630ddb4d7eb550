"""Readings that repeat the last one: of a tracker that has lost its object."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pisplit.data.stretches import coarse, held, stretches

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]

#: Repeats in a row from which a stall is looked for, and from which one is believed that does not end in a jump.
REPEATS, LONG = 3, 7
#: What inputs move in a stall, in parts of their range; the second where it does not end in a jump.
MOVED, MOVED_MUCH = 0.05, 0.1
#: A stall ends in a jump of more than so many of the larger steps, or begins in the middle of a motion: after a step of
#: more than this part of the median one.
JUMP, KINK = 2.0, 0.5
#: A column lives if this part of its readings is in no stretch of repeats, and if among these few repeat.
ALIVE, REPEATING = 0.2, 0.2


@dataclass(frozen=True)
class Stretch:
    """Readings ``start`` to ``end`` of the positions ``read`` that are all the same, in ``columns``."""

    read: Index
    start: int
    end: int
    columns: tuple[int, ...]


def stalled(states: Array, inputs: Array, runs: Sequence[Index]) -> Mask:
    """Where (N, n) readings repeat the last one, to the last digit, though the robot moves.

    states, inputs  (N, n) and (N, m), NaN where missing
    runs            positions of the samples of every run, in order of time

    At least two columns repeat together (or the only one that lives, if it is fine), while commands move, and jump when
    they come back or stood still in the middle of a motion. Single repeats count where all columns of a fine sensor
    repeat amid a motion. A robot at rest, a joint whose command rests, an end stop that is reached again and again are
    no stalls.
    """
    still = np.zeros(states.shape, dtype=bool)
    alive = [c for c in range(states.shape[1]) if _alive(states[:, c], runs)]
    usual = {c: _usual(states[:, c], runs) for c in alive}
    fine = {c for c in alive if not coarse(states[:, c], runs)}
    commands = held(inputs)
    spread = np.ptp(commands, axis=0) if len(commands) else np.zeros(commands.shape[1])
    for stretch in _stretches(states, runs, alive):
        repeats = stretch.end - stretch.start
        if len(stretch.columns) < 2 and (len(alive) > 1 or not fine):
            continue
        if repeats >= REPEATS:
            bad = _believed(stretch, states, commands, spread, usual, fine.issuperset(stretch.columns))
        else:
            bad = len(stretch.columns) == len(alive) > 1 and fine.issuperset(alive) and _amid(stretch, states, usual)
        if bad:
            nothing = len(stretch.columns) > 1 and not states[stretch.read[stretch.start], list(stretch.columns)].any()
            first = stretch.start + (0 if nothing else 1)  # zeros were no reading from the first on
            still[stretch.read[first : stretch.end + 1][:, None], list(stretch.columns)] = True
    return still


def _believed(
    stretch: Stretch, states: Array, commands: Array, spread: Array, usual: dict[int, tuple[float, float]], fine: bool
) -> bool:
    read, start, end, columns = stretch.read, stretch.start, stretch.end, list(stretch.columns)
    steps = np.array([usual[c] for c in columns])
    value = states[read[start], columns]
    jump = np.abs(states[read[end + 1], columns] - value) if end + 1 < len(read) else np.zeros(len(columns))
    before = np.abs(value - states[read[start - 1], columns]) if start else np.zeros(len(columns))
    jumps, kinks = bool((jump > JUMP * steps[:, 1]).any()), bool((before > KINK * steps[:, 0]).any())
    if fine and kinks and (jumps or (len(columns) > 1 and not _at_a_stop(stretch, states))):
        return True  # what was seen to move to the last digit does not stop dead
    if not commands.shape[1]:
        return False
    moving = spread > 0.0
    part = commands[read[start] : max(read[end] - 1, read[start] + 1) + 1]
    moved = float((np.ptp(part[:, moving], axis=0) / spread[moving]).max(initial=0.0))
    if moved > MOVED and jumps:
        return True
    long = end - start >= LONG and moved > MOVED_MUCH and not _at_a_stop(stretch, states)
    return long and (kinks or (fine and len(columns) > 2))


def _amid(stretch: Stretch, states: Array, usual: dict[int, tuple[float, float]]) -> bool:
    """One or two repeats of all columns, between two steps of a motion that a fine sensor saw."""
    read, start, end, columns = stretch.read, stretch.start, stretch.end, list(stretch.columns)
    if start == 0 or end + 1 >= len(read):
        return False
    middle = np.array([usual[c][0] for c in columns])
    before = np.abs(states[read[start], columns] - states[read[start - 1], columns])
    after = np.abs(states[read[end + 1], columns] - states[read[start], columns])
    return bool((before > KINK * middle).any() and (after > KINK * middle).any())


def _at_a_stop(stretch: Stretch, states: Array) -> bool:
    """Whether a column stands at its least or largest value, and has been there in another stretch too."""
    at = stretch.read[stretch.start]
    inside = stretch.read[stretch.start : stretch.end + 1]
    for c in stretch.columns:
        column, value = states[:, c], states[at, c]
        if value in (np.nanmin(column), np.nanmax(column)) and (column == value).sum() > len(inside) + 1:
            return True
    return False


def _alive(column: Array, runs: Sequence[Index]) -> bool:
    """Whether a column changes at most samples that are in no long stretch of repeats."""
    outside = repeats = total = 0
    for rows in runs:
        values = column[rows[np.isfinite(column[rows])]]
        same = np.diff(values) == 0.0
        long = np.zeros(len(same), dtype=bool)
        for start, end in stretches(same):
            long[start:end] = end - start >= REPEATS
        total += len(values)
        outside += int((~long).sum())
        repeats += int((same & ~long).sum())
    return outside >= max(5, ALIVE * total) and repeats < REPEATING * outside + 1


def _usual(column: Array, runs: Sequence[Index]) -> tuple[float, float]:
    """Median and 90th percentile of steps that are none, those at the end of long stretches of repeats left out."""
    found = []
    for rows in runs:
        steps = np.abs(np.diff(column[rows[np.isfinite(column[rows])]]))
        for start, end in stretches(steps == 0.0):
            if end - start >= REPEATS and end < len(steps):
                steps[end] = 0.0
        found.append(steps[steps > 0.0])
    middle, large = np.quantile(np.concatenate(found), [0.5, 0.9])
    return float(middle), float(large)


def _stretches(states: Array, runs: Sequence[Index], columns: Sequence[int]) -> Iterator[Stretch]:
    """Stretches of repeats, those of several columns at the same samples as one."""
    for rows in runs:
        for read, group in _read_together(states, rows, columns):
            found: dict[tuple[int, int], list[int]] = {}
            for c in group:
                for start, end in stretches(np.diff(states[read, c]) == 0.0):
                    found.setdefault((start, end), []).append(c)
            for (start, end), members in found.items():
                yield Stretch(read, start, end, tuple(members))


def _read_together(states: Array, rows: Index, columns: Sequence[int]) -> Iterator[tuple[Index, list[int]]]:
    """Positions of readings, and the columns that were read at these."""
    groups: dict[bytes, list[int]] = {}
    for c in columns:
        groups.setdefault(np.isfinite(states[rows, c]).tobytes(), []).append(c)
    for group in groups.values():
        yield rows[np.isfinite(states[rows, group[0]])], group
