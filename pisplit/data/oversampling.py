"""Readings of a sensor that is slower than the log, which are written again until the next one."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from pisplit.data.stretches import coarse, held

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]

#: A slow sensor in a fast log: longest period in samples, least number of periods, part of them that is regular.
PERIOD, PERIODS, REGULAR = 50, 20, 0.8


def oversampled(states: Array, inputs: Array, runs: Sequence[Index]) -> tuple[Mask, int]:
    """Where (N, n) a slow sensor's reading is written again, and its period in samples; 1 where none is.

    The ``states`` (N, n), ``inputs`` (N, m) and ``runs`` are those of :func:`pisplit.data.stalls.stalled`. Columns that
    change at the same samples are of one sensor. Regular stretches of repeats make a slow one, unless others change in
    between and these only with the commands: a setpoint among the states is no slow sensor.
    """
    repeated, longest = np.zeros(states.shape, dtype=bool), 1
    commands = held(inputs)
    groups = _together(states, runs)
    for columns in groups:
        first = columns[0]
        spans = [_spans(states[:, first], rows) for rows in runs]
        found = np.concatenate([last - start + 1 for start, last, _ in spans])
        if len(found) < PERIODS or not 2 <= np.median(found) <= PERIOD:
            continue
        period, slack = round(float(np.median(found))), max(1, round(0.1 * float(np.median(found))))
        regular = float(np.mean(np.abs(found - period) <= slack))
        start, last, after = (np.concatenate(part) for part in zip(*spans, strict=True))
        setpoint = len(groups) > 1 and _moved(commands, start, last) < 0.1 and _moved(commands, last, after) > 0.9
        rough = len(columns) == 1 and coarse(states[:, first], runs)
        if regular < REGULAR or rough or setpoint:
            continue
        longest = max(longest, period)
        for rows in runs:
            read = rows[np.isfinite(states[rows, first])]
            new = np.append(True, np.diff(states[read, first]) != 0.0)
            since = np.arange(len(read)) - np.maximum.accumulate(np.where(new, np.arange(len(read)), 0))
            old = read[since % (period + slack) != 0]
            repeated[old[:, None], columns] = True
    return repeated, longest


def _spans(column: Array, rows: Index) -> tuple[Index, Index, Index]:
    """Positions of the first and last sample of every stretch of equal readings, and of the one after it."""
    read = rows[np.isfinite(column[rows])]
    new = np.flatnonzero(np.append(True, np.diff(column[read]) != 0.0)[: len(read)])
    return read[new[:-1]], read[new[1:] - 1], read[new[1:]]


def _moved(commands: Array, first: Index, last: Index) -> float:
    """Part of the spans from ``first`` to ``last`` over which a command changes."""
    return float((commands[first] != commands[last]).any(axis=1).mean())


def _together(states: Array, runs: Sequence[Index]) -> list[list[int]]:
    """Columns that change, grouped by the samples at which they do."""
    groups: dict[bytes, list[int]] = {}
    for c in range(states.shape[1]):
        key = []
        for rows in runs:
            read = np.isfinite(states[rows, c])
            key += [read.tobytes(), (np.diff(states[rows[read], c]) != 0.0).tobytes()]
        groups.setdefault(b"|".join(key), []).append(c)
    return list(groups.values())
