"""Cells of text tables: numbers of both decimal marks, times of all spellings, what is missing."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from datetime import datetime

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pisplit.data.units import to_si, written

Array = NDArray[np.float64]
Cells = Sequence[tuple[int, str]]

#: What a cell may hold; float() alone would read 1_00.5 as 100.5.
NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)
#: Columns of these characters, and a line end, hold nothing that float() reads and NUMBER does not.
PLAIN = re.compile(r"[0-9+\-.eE\n]*")
WITH_COMMA = re.compile(r"[+-]?(\d+,\d*|,\d+)([eE][+-]?\d+)?", re.ASCII)
#: A decimal fraction, or thousands.
AMBIGUOUS = re.compile(r"[+-]?[1-9]\d{0,2}(,\d{3})+", re.ASCII)
#: Thousands in groups, with a decimal mark behind them: which is which is plain.
GROUPED = {
    ".": re.compile(r"[+-]?\d{1,3}([,'\u2019 \u00a0\u202f])\d{3}(\1\d{3})*\.\d+", re.ASCII),
    ",": re.compile(r"[+-]?\d{1,3}([.'\u2019 \u00a0\u202f])\d{3}(\1\d{3})*,\d+", re.ASCII),
}
MISSING = {"", "nan", "na", "n/a", "<na>", "nat", "null", "none", "nil", "-", "--", "---", "missing"}
#: The same as C libraries and spreadsheets write it.
MISSING |= {"-nan", "nan(ind)", "-nan(ind)", "1.#ind", "-1.#ind", "1.#qnan", "#n/a", "#div/0!", "#value!", "#num!"}
MISSING |= {"nan(snan)", "#ref!", "#null!", "#name?", "n.a."}
#: A clock of the day that falls by more than this [s] has passed midnight.
DAY, MIDNIGHT = 86400.0, 0.9 * 86400.0
TRUTH = {"true": 1.0, "false": 0.0}
DURATION = re.compile(r"([+-]?[\d.]+(?:[eE][+-]?\d+)?)\s*([a-zµμ]+)", re.ASCII | re.IGNORECASE)
CLOCK = re.compile(r"(?:(\d+):)?(\d{1,2}):(\d{1,2}(?:[.,]\d*)?)(?: ?([AaPp])[Mm])?", re.ASCII)
DATES = ("%d-%b-%Y", "%Y/%m/%d", "%d.%m.%Y", "%m/%d/%Y", "%d/%m/%Y")
HOURS = ("%H:%M:%S.%f", "%H:%M:%S,%f", "%H:%M:%S", "%I:%M:%S.%f %p", "%I:%M:%S %p", "%H:%M")


def is_missing(cell: str) -> bool:
    """Whether a ``cell`` says that there is no reading."""
    return cell.lower() in MISSING


def is_number(cell: str) -> bool:
    """Whether a ``cell`` is a number, with either decimal mark."""
    return bool(
        NUMBER.fullmatch(cell) or WITH_COMMA.fullmatch(cell) or any(g.fullmatch(cell) for g in GROUPED.values())
    )


def is_cell(cell: str) -> bool:
    """Whether a ``cell`` may stand among samples: a number, a time or a mark of what is missing, and no name."""
    return is_number(cell) or is_missing(cell) or _seconds(cell) is not None or _date(cell) is not None


def decimal_mark(cells: Sequence[Cells], path: object) -> str:
    """The decimal mark of columns of ``cells``: "," where no number has a point. ``path`` is for the message.

    Raises ValueError where numbers are written in both ways, and where 1,234 may be a thousand.
    """
    if not any("," in "".join([cell for _, cell in column]) for column in cells):
        return "."
    commas = [(line, cell) for column in cells for line, cell in column if WITH_COMMA.fullmatch(cell)]
    thousands = [(line, cell) for column in cells for line, cell in column if cell.count(",") > 1]
    if not commas and not thousands:
        return "."
    point = next(((line, c) for column in cells for line, c in column if "." in c and NUMBER.fullmatch(c)), None)
    line, comma = (thousands or commas)[0]
    if thousands or point is not None:
        other = f", line {point[0]}: {point[1]!r}" if point else ""
        raise ValueError(f"{path}, line {line}: {comma!r}{other}; write all numbers with one decimal mark")
    if all(AMBIGUOUS.fullmatch(cell) for _, cell in commas):
        raise ValueError(
            f"{path}, line {line}: {comma!r} may be {comma.replace(',', '.')} or a thousand; give decimal=','"
        )
    return ","


def numbers(path: object, cells: Cells, decimal: str) -> Array:
    """Numbers (N,) of ``cells`` (line, text), NaN where missing; ``decimal`` mark "." or ",".

    Raises ValueError for the first that is none, in a line of ``path``.
    """
    if decimal == "." and PLAIN.fullmatch("\n".join([cell for _, cell in cells])):
        try:
            return np.array([float(cell) for _, cell in cells])
        except ValueError:  # missing cells, or no number: told apart below
            pass
    values, pattern = np.empty(len(cells)), NUMBER if decimal == "." else WITH_COMMA
    for i, (line, cell) in enumerate(cells):
        text = cell.replace("\u2212", "-")
        if pattern.fullmatch(text) or (decimal == "," and NUMBER.fullmatch(text) and "." not in text):
            values[i] = float(text.replace(",", "."))
        elif is_missing(text):
            values[i] = np.nan
        elif text.lower() in TRUTH:
            values[i] = TRUTH[text.lower()]
        elif match := GROUPED[decimal].fullmatch(text):
            values[i] = float(text.replace(match.group(1), "").replace(",", "."))
        else:
            mark = f" with decimal = {decimal!r}" if is_number(text) else ""
            raise ValueError(f"{path}, line {line}: {cell!r} is not a number{mark}")
    return values


def times(path: object, cells: Cells, decimal: str) -> tuple[ArrayLike, bool]:
    """Times (N,) of ``cells`` (line, text), and whether they are plain numbers, whose unit they do not tell.

    decimal  mark of numbers, "." or ","

    Integers stay integers: ticks since 1970 have more digits than a float. Durations are seconds, dates as in ISO 8601
    or as MATLAB, Windows and spreadsheets write them. Raises ValueError for the first that is none, in a line of
    ``path``, and for dates whose day and month cannot be told apart.
    """
    known = [(line, cell) for line, cell in cells if not is_missing(cell)]
    first = known[0][1] if known else ""
    if not first or is_number(first):
        if len(known) == len(cells) and all(re.fullmatch(r"[+-]?\d{1,18}|\d{19}", cell, re.ASCII) for _, cell in cells):
            ticks = [int(cell) for _, cell in cells]
            if max(ticks) < 2**63:
                return np.array(ticks, dtype=np.int64), True
        return numbers(path, cells, decimal), True
    read = _reader([cell for _, cell in known])
    found: list[float | datetime | None] = []
    for line, cell in cells:
        value = None if is_missing(cell) else read(cell)
        if value is None and not is_missing(cell):
            raise ValueError(f"{path}, line {line}: {cell!r} is not a number, and no date as in ISO 8601")
        found.append(value)
    if any(isinstance(value, datetime) for value in found):
        return np.array(found, dtype=object), False
    return _past_midnight(np.array([np.nan if v is None else v for v in found], dtype=np.float64)), False


def _past_midnight(times: Array) -> Array:
    """Times of day [s] that go on after midnight."""
    known = np.isfinite(times)
    steps = np.diff(times[known])
    days = np.cumsum(np.append(0.0, (steps < -MIDNIGHT) & (times[known][1:] < DAY)))[: int(known.sum())]
    found = times.copy()
    found[known] += DAY * days
    return found


def _reader(cells: Sequence[str]) -> Callable[[str], float | datetime | None]:
    """How the ``cells`` of times are read: durations, or dates by the one order of day and month that all allow."""
    if _seconds(cells[0]) is not None:
        return _seconds
    if not re.match(r"\d{1,2}/\d{1,2}/\d{4} ", cells[0]):
        return _date
    kinds = [kind for kind in DATES[3:] if all(_as(cell, kind) is not None for cell in cells)]
    if len(kinds) == 2 and len({cell.split(" ")[0] for cell in cells}) > 1:
        raise ValueError(f"dates such as {cells[0]!r} may have day or month first; write them as in ISO 8601")
    return lambda cell: _as(cell, kinds[0] if kinds else DATES[3])


def _seconds(cell: str) -> float | None:
    """A duration or a time of day [s]: "0.01 sec", "00:00:01.5", "11:59:59.5 PM"."""
    match = DURATION.fullmatch(cell)
    if match and NUMBER.fullmatch(match.group(1)):
        unit = written(match.group(2).lower())
        if unit is not None and to_si(unit, "")[0] == "s":
            return float(match.group(1)) * to_si(unit, "")[1]
    match = CLOCK.fullmatch(cell)
    if match is None:
        return None
    hours, minutes, seconds, half = match.groups()
    if half is not None:
        if hours is None or not 1 <= int(hours) <= 12:
            return None
        hours = str(int(hours) % 12 + (12 if half in "pP" else 0))
    return 3600.0 * int(hours or 0) + 60.0 * int(minutes) + float(seconds.replace(",", "."))


def _date(cell: str) -> datetime | None:
    try:
        return datetime.fromisoformat(cell.replace("Z", "+00:00"))
    except ValueError:
        pass
    return next((found for day in DATES[:3] if (found := _as(cell, day)) is not None), None)


def _as(cell: str, day: str) -> datetime | None:
    """A date whose days are spelled as ``day``."""
    for hour in HOURS:
        try:
            return datetime.strptime(cell, f"{day} {hour}")
        except ValueError:
            continue
    return None
