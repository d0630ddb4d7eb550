"""Lines of a text table in which a cell is missing, so that all later ones stand one column too far to the left."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from pisplit.data import cells

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Line = tuple[int, Sequence[str]]

#: A line is looked at where it has fewer cells than this part of all lines have; more such lines are sparse by design.
SELDOM = 0.2
#: Cells are out of place from so many usual steps of their column on, in place below so many,
FAR, NEAR = 6.0, 3.0
#: and the most lines that are compared.
MOST = 200
#: Steps of a column are known from so many lines on.
ENOUGH = 8


def check(
    path: str | os.PathLike[str],
    counts: Sequence[tuple[int, int, int]],
    delimiter: str,
    read: Callable[[], Iterable[Line]],
) -> None:
    """Raise ValueError for a line of ``path`` whose cells fit the lines beside only when they are moved.

    counts     number of every line of samples, its cells, and these without empty ones at its end
    delimiter  that between the cells; where it is a blank, a line of fewer cells than others is refused as it is: an
               empty cell leaves no trace there
    read       gives number and cells of all lines of the file; called where a line is odd
    """
    if not counts:
        return
    widths, used = np.array(counts)[:, 1:].T
    usual, full = int(np.bincount(widths).argmax()), int(np.bincount(used).argmax())
    if delimiter == " ":
        odd = np.flatnonzero((widths < usual) | ((widths > usual) & ((widths > usual).mean() < SELDOM)))
        if len(odd):
            at = int(odd[0])
            raise ValueError(
                f"{path}, line {counts[at][0]} has {widths[at]} cells, others {usual}: between blanks an empty cell "
                "leaves no trace; write nan where a reading is missing, or take the line out"
            )
        return
    odd = np.flatnonzero((widths != usual) | (used < full))
    if not len(odd) or len(odd) > max(SELDOM * len(counts), 1.0):
        return
    wanted = {line for line, _, _ in counts}
    lines = [(line, row) for line, row in read() if line in wanted]
    even = np.ones(len(lines), dtype=bool)
    even[odd] = False
    table = np.array([_numbers(row, full) for _, row in lines])
    steps = _usual_steps(table[even])
    for at in odd[:MOST].tolist():
        missing = full - int(used[at])
        beside = [
            int(k[0]) for k in (np.flatnonzero(even[:at])[::-1], at + 1 + np.flatnonzero(even[at + 1 :])) if len(k)
        ]
        row = _numbers(lines[at][1], max(full, int(used[at])))
        as_it_is = _off(row[:full], table[beside], steps)
        moved = [_off(_moved(row, g, missing, full), table[beside], steps) for g in range(min(full, int(used[at])) + 1)]
        if missing and as_it_is > FAR and min(moved) < min(NEAR, as_it_is / FAR):
            what = "a cell is missing" if missing > 0 else "a cell is too many"
            raise ValueError(
                f"{path}, line {lines[at][0]} has {used[at]} cells, the lines beside {full}, and fits them only when "
                f"moved: {what} at column {int(np.argmin(moved)) + 1}; mend the line, or take it out"
            )


def check_rows(values: Array, times: Array, members: Mapping[str, Index]) -> None:
    """Raise ValueError for a row of arrays whose last entries are missing and that fits its neighbours when moved.

    values   (N, k) states beside inputs at ``times`` (N,) [s]
    members  {run: positions of its samples, in order of time}
    """
    if values.shape[1] < 2:
        return
    known = np.isfinite(values)
    odd = ~known[:, -1]
    if not odd.any() or odd.sum() > max(SELDOM * len(values), 1.0):
        return
    steps = np.nanmin([_usual_steps(values[rows[~odd[rows]]]) for rows in members.values()], axis=0)
    for rows in members.values():
        even = rows[~odd[rows]]
        for at in rows[odd[rows]][:MOST].tolist():
            k = int(np.searchsorted(even, at))
            beside = values[even[max(k - 1, 0) : k + 1]]
            missing = values.shape[1] - int(np.max(np.flatnonzero(known[at]), initial=-1)) - 1
            if not len(beside) or missing == values.shape[1]:
                continue
            row = values[at]
            moved = [_off(_moved(row, g, missing, len(row)), beside, steps) for g in range(len(row) - missing + 1)]
            if (off := _off(row, beside, steps)) > FAR and min(moved) < min(NEAR, off / FAR):
                raise ValueError(
                    f"the sample at {times[at]:.6g} s fits those beside only when moved: its column "
                    f"{int(np.argmin(moved)) + 1} of states and inputs is missing, and all later ones stand one too "
                    "far to the left; mend it, or give NaN"
                )


def filled(row: Sequence[str]) -> int:
    """Cells of a ``row`` without empty ones at its end."""
    return len(row) - next((i for i, cell in enumerate(reversed(row)) if cell), len(row))


def _numbers(row: Sequence[str], size: int) -> Array:
    """The first ``size`` cells as numbers, NaN where there is none, infinite for words."""
    found = np.full(size, np.nan)
    for i, cell in enumerate(row[:size]):
        if cell and not cells.is_missing(cell):
            plain = cell.replace(",", ".", 1) if "." not in cell else cell
            found[i] = float(plain) if cells.NUMBER.fullmatch(plain) else np.inf
    return found


def _usual_steps(table: Array) -> Array:
    """Large steps (k,) of every column from line to line; NaN where too few are known."""
    with np.errstate(invalid="ignore"):
        steps = np.abs(np.diff(table, axis=0))
    found = np.full(table.shape[1], np.nan)
    for c, column in enumerate(steps.T):
        known = column[np.isfinite(column)]
        if len(known) >= ENOUGH:
            values = table[np.isfinite(table[:, c]), c]
            found[c] = max(float(np.quantile(known, 0.95)), 1e-3 * float(np.ptp(values)), 1e-12 * np.abs(values).max())
    return found


def _moved(row: Array, at: int, missing: int, size: int) -> Array:
    """The ``row`` with ``missing`` cells put in, or so many taken out where it is negative, before cell ``at``."""
    if missing > 0:
        return np.concatenate([row[:at], np.full(missing, np.nan), row[at:]])[:size]
    return np.delete(row, slice(at, at - missing))[:size]


def _off(row: Array, beside: Array, steps: Array) -> float:
    """How many usual steps the farthest cell of a ``row`` (k,) is from the lines ``beside`` (1 or 2, k)."""
    low, high = np.fmin.reduce(beside, axis=0), np.fmax.reduce(beside, axis=0)
    words = np.isinf(low) & ~np.isnan(row)
    with np.errstate(invalid="ignore", divide="ignore"):
        away = np.fmax(low - row, row - high) / steps
    away[np.isnan(away)] = 0.0
    away[words] = np.where(np.isinf(row[words]), 0.0, np.inf)
    away[np.isinf(row) & np.isfinite(low)] = np.inf
    return float(away.max(initial=0.0))
