"""Exact values in the place of readings that were lost: zeros of a tracker, -9999 of a logger."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from pisplit.data.stretches import stretches

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]

#: A value is lost if it is farther from the readings beside it than so many of the larger steps between readings;
#: the second: in one column alone.
FAR, FAR_ALONE = 4.0, 8.0
#: The same at the start, where an arm may rest at zero, and where a command changes with it.
FAR_AT_START, FAR_FROM_REST = 10.0, 30.0
#: One column alone is at a value of lost readings in less than this part of its samples; a force may rest at zero.
SELDOM = 0.2
#: An extreme value that comes once is lost if it is beyond so many times the range of all others.
BEYOND = 10.0
#: Readings that are needed before steps between them are known.
ENOUGH = 4
#: Gaps of so many samples may lie between the sides of a value that interpolation tells to be lost.
SHORT = 5


def dropouts(times: Array, states: Array, inputs: Array, runs: Sequence[Index]) -> Iterator[tuple[float, Mask]]:
    """Values that stand for lost readings, and where (N, n) they do.

    times, states, inputs  (N,), (N, n), (N, m), NaN where missing
    runs                   positions of the samples of every run, in order of time

    Zero is looked for in several columns at once, as a marker or a tracker loses them, and in single ones where they
    are seldom zero; of other values, the least and the largest of a column where it jumps to them at least twice.
    An arm that rests at zero, or passes it, is told by readings beside that are near.
    """
    zeros = _lost(times, states, inputs, runs, np.zeros(states.shape[1]), together=True)
    if zeros.any():
        yield 0.0, zeros
        ones = _identity(states, zeros)
        if ones.any():
            yield 1.0, ones
        zeros = zeros | ones
    rest = np.where(zeros, np.nan, states)
    for pick in (np.fmin, np.fmax):
        with np.errstate(invalid="ignore"):
            extreme = pick.reduce(rest, axis=0)
        found = _lost(times, rest, inputs, runs, extreme, together=False)
        for value in np.unique(extreme[found.any(axis=0)]):
            yield float(value), found & (extreme == value)


def _identity(states: Array, zeros: Mask) -> Mask:
    """Where a lost body is turned by nothing: columns that are 1 where three others are lost, and only there."""
    rows = zeros.sum(axis=1) >= 3
    one = states == 1.0
    return one & rows[:, None] & ((one == rows[:, None]) | ~np.isfinite(states)).all(axis=0)


def _lost(times: Array, states: Array, inputs: Array, runs: Sequence[Index], values: Array, together: bool) -> Mask:
    """Readings (N, n) that are at the value (n,) of their column and far from those beside them.

    Columns that come to it and leave it at the same samples are one marker, which is lost where one of them is far.
    """
    hit = states == values
    seldom = hit.sum(axis=0) < SELDOM * np.isfinite(states).sum(axis=0)
    groups: dict[tuple[int, int], list[tuple[int, Index, bool, bool]]] = {}
    for c in np.flatnonzero(hit.any(axis=0)).tolist():
        size = _usual_step(states[:, c], hit[:, c], runs)
        if size is None or not (together or _apart(states[:, c], values[c], size[1])):
            continue
        for rows in runs:
            read = rows[np.isfinite(states[rows, c])]
            for start, end in stretches(hit[read, c]):
                far, alone = _far(times, states[:, c], inputs, read, start, end, float(values[c]), size)
                own = read[start:end]
                groups.setdefault((int(own[0]), int(own[-1])), []).append((c, own, far, alone))
    lost = np.zeros_like(hit)
    for group in groups.values():
        several = len(group) > 1 and any(far for _, _, far, _ in group)
        for c, own, _, alone in group:
            lost[own, c] = several or (alone and seldom[c])
    return lost if together else lost & np.array([_returns(*pair) for pair in zip(states.T, lost.T, strict=True)])


def _returns(column: Array, lost: Mask) -> bool:
    """Whether an extreme value comes back, or is beyond all that a sensor reads."""
    rest = column[np.isfinite(column) & ~lost]
    beyond = len(rest) > 0 and np.abs(column[lost] - rest.mean()).min(initial=np.inf) > BEYOND * np.ptp(rest)
    return len(stretches(lost)) >= 2 or bool(lost.any() and beyond)


def _far(
    times: Array,
    column: Array,
    inputs: Array,
    read: Index,
    start: int,
    end: int,
    value: float,
    size: tuple[float, float],
) -> tuple[bool, bool]:
    """Whether readings start to end - 1 are far from those beside them: as one of several columns, and alone."""
    spacing = float(np.median(np.diff(times[read]))) if len(read) > 1 else 1.0
    sides, steps = [], []
    for inner, outer in ((start, start - 1), (end - 1, end)):
        if 0 <= outer < len(read):
            waited = max(1.0, abs(times[read[outer]] - times[read[inner]]) / spacing)
            sides.append(abs(column[read[outer]] - value) / (size[1] * waited))
            steps.append(column[read[outer]] - value)
    if not sides:
        return False, False
    if len(sides) == 1:
        if start > 0:
            return sides[0] > FAR, sides[0] > FAR_ALONE
        least = FAR_FROM_REST if _moves(inputs, read[end - 1], read[end]) else FAR_AT_START
        return sides[0] > least, sides[0] > FAR_FROM_REST
    middle, between = abs(steps[0] + steps[1]) / 2.0, abs(steps[0] - steps[1])
    between_far = end - start <= SHORT and middle > 2.0 * between + 3.0 * size[0]
    return max(sides) > FAR or between_far, min(sides) > FAR_ALONE


def _apart(column: Array, value: float, size: float) -> bool:
    """Whether no other reading is near a ``value``: a sensor that saturates comes there step by step."""
    others = column[np.isfinite(column) & (column != value)]
    return bool(np.abs(others - value).min(initial=np.inf) > FAR * size)


def _moves(inputs: Array, first: int, last: int) -> bool:
    """Whether a command changes between two samples: a step from rest is no loss."""
    part = inputs[first : last + 1]
    return bool((np.abs(np.diff(part, axis=0)) > 0.0).any())


def _usual_step(column: Array, hit: Mask, runs: Sequence[Index]) -> tuple[float, float] | None:
    """Median and 90th percentile of the steps that are none between readings that are not ``hit``."""
    found = []
    for rows in runs:
        read = rows[np.isfinite(column[rows])]
        good = ~(hit[read][1:] | hit[read][:-1])
        found.append(np.abs(np.diff(column[read]))[good])
    steps = np.concatenate(found)
    steps = steps[steps > 0.0]
    if len(steps) < ENOUGH:
        return None
    middle, large = np.quantile(steps, [0.5, 0.9])
    return float(middle), float(large)
