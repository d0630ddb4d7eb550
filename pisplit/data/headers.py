"""Which columns a table has: a header of one row or of several, units beside or below the names, or none at all."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from difflib import get_close_matches
from itertools import pairwise

from pisplit.data.cells import is_cell, is_number
from pisplit.data.units import to_si, written

#: Lines in which a header is looked for, and rows that it may have.
TOP, ROWS = 120, 6
BRACKETS = re.compile(r"^(.*?)[\s_]*[\[(]([^\[\]()]*)[\])]$")
#: A unit behind a name without brackets: "x / mm" as in ISO 80000, "x, mm".
BEHIND = re.compile(r"^(.*\S)(?:\s+/|,)\s+(\S+)$")
#: What looks like a unit, and may be part of a name: "x_mm", "x in mm".
SUFFIX = re.compile(r"^.*\S(?:_| in |\.)([A-Za-z]{2,})$")
SEPARATORS = re.compile(r"[\s./_:]+")
#: Ends of names of clocks that name their unit.
CLOCK_UNITS = {"ms": "ms", "us": "us", "ns": "ns", "msec": "ms", "usec": "us", "nsec": "ns", "sec": "s", "s": "s"}

#: Words in brackets that are a unit of times alone: "flow (in)", "p (min)", "acc [g]" are no inches, minutes and grams.
OTHER_WORDS = ("min", "in", "d", "h", "g")

Row = tuple[int, list[str]]


@dataclass(frozen=True)
class Header:
    """Columns of a table.

    columns  words of every column, from the upper row of the header to the lowest
    line     number of the last line of the header
    units    {position: unit} that a row below the names, or the lines above, tell
    """

    columns: tuple[tuple[str, ...], ...]
    line: int
    units: dict[int, str] = field(default_factory=dict)

    @property
    def names(self) -> list[str]:
        """Names of the columns, as long as it takes to tell them apart."""
        short = [words[-1] if words else "" for words in self.columns]
        return [name if short.count(name) == 1 else " ".join(w) for name, w in zip(short, self.columns, strict=True)]

    def find(self, name: str) -> list[int]:
        """Positions of the columns that ``name`` may mean: the lowest words alone, without unit, or several words."""
        short = [words[-1] if words else "" for words in self.columns]
        for known in (short, [without_unit(text)[0] for text in short], [" ".join(w) for w in self.columns]):
            found = [i for i, text in enumerate(known) if text == name]
            if found:
                return found
        found = [i for i, text in enumerate(short) if (match := BRACKETS.match(text)) and match.group(1) == name]
        if found:
            return found
        asked = _words(name)
        return [
            i
            for i, words in enumerate(self.columns)
            if words and asked and _words(without_unit(words[-1])[0])[-1:] == asked[-1:] and _within(asked, words)
        ]

    def unit(self, position: int, clock: bool = False) -> str | None:
        """Unit of the column at ``position`` by a row of units or by its name; of a ``clock`` also by "time_ms"."""
        if position in self.units:
            return self.units[position]
        words = self.columns[position]
        unit = without_unit(words[-1])[1] if words else None
        if unit is None and clock and words:
            inside = BRACKETS.match(words[-1])
            last = SEPARATORS.split(words[-1].lower())
            unit = written(inside.group(2)) if inside else CLOCK_UNITS.get(last[-1]) if len(last) > 1 else None
        return unit


def header_of(rows: Sequence[Row], wanted: Sequence[str], limit: int | None = TOP) -> tuple[Header, bool]:
    """The header among the first ``limit`` ``rows`` of a table, and whether it has each of the ``wanted`` names once.

    Where none has, that which has most of them, or looks most like a header.
    """
    best, score = Header((), 0), -1
    for at, (line, row) in enumerate(rows[:limit]):
        cells = _plain(row)
        if not any(cells) or is_number(next(filter(None, cells))) or all(is_number(cell) for cell in cells if cell):
            continue
        found = Header(_stacked(rows, at, cells), line, _units(rows, at, cells))
        hits = [len(found.find(name)) for name in wanted]
        if all(n == 1 for n in hits):
            return found, True
        below = rows[at + 1][1] if at + 1 < len(rows) else []
        ready = len(below) == len(row) and any(is_number(cell) for cell in below)
        value = 10 * sum(n > 0 for n in hits) + 2 * ready + (len(cells) > 1)
        if value > score:
            best, score = found, value
    return best, False


def alike(name: str, names: Sequence[str]) -> str:
    """What to write in the place of ``name``, which is none of the ``names`` of columns: the end of a sentence."""
    known = [text for text in names if text]
    asked, plain = name.casefold(), {BRACKETS.sub(r"\1", text).casefold(): text for text in known}
    near = [text for text in known if _words(text.casefold())[: len(_words(asked))] == _words(asked)]
    near = near or [plain[text] for text in get_close_matches(asked, list(plain), n=3, cutoff=0.75)]
    if near:
        more = f" and {len(near) - 6} more" if len(near) > 6 else ""
        return f"; near it are {', '.join(map(repr, near[:6]))}{more}, out of {len(known)}: name each that is meant"
    more = f" and {len(known) - 12} more" if len(known) > 12 else ""
    return f"; it has {', '.join(known[:12]) or 'none'}{more}"


def start_of(rows: Sequence[Row], size: int) -> int:
    """Number of the last line before the samples of ``rows``, of ``size`` columns without names; -1 if none."""
    for at, (line, row) in enumerate(rows):
        cells = row[:size]
        if [cell for cell in cells if cell] == [str(i) for i in range(size)][-len(cells) :] and at == 0 and size > 1:
            continue  # numbers of columns, as pandas writes them
        short = len(cells) == size and not any(row[size:])
        if short and any(is_number(cell) for cell in cells) and all(not cell or is_cell(cell) for cell in cells):
            return rows[at - 1][0] if at else line - 1
    return -1


def _plain(row: Sequence[str]) -> list[str]:
    """Cells without the mark of a comment in front, which is part of a name in "%time"."""
    cells = list(row)
    if cells and re.match(r"^[#%]+\s", cells[0] + " ") and cells[0].strip("#% ") == "":
        return cells[1:]
    if cells and re.match(r"^#+\s*\S", cells[0]):
        cells[0] = cells[0].lstrip("# ")
    elif cells and re.match(r"^%+\s+\S", cells[0]):
        cells[0] = cells[0].lstrip("% ")
    return cells


def _stacked(rows: Sequence[Row], at: int, cells: Sequence[str]) -> tuple[tuple[str, ...], ...]:
    """Words of every column: those of the rows above, each of which reaches to the next word, and its own.

    Rows above are as long, or begin with an empty cell and are not longer but for empty cells, as Vicon writes them.
    """
    above: list[list[str]] = []
    for _, row in reversed(rows[max(0, at - ROWS) : at]):
        used = len(row) - next((i for i, cell in enumerate(reversed(row)) if cell), len(row))
        alike = len(row) == len(cells) or (len(row) > 1 and not row[0] and used <= len(cells))
        if not alike or len(row) < 2 or not any(cell and not is_number(cell) for cell in row):
            break
        row = [*row, *[""] * len(cells)][: len(cells)]
        reaching, last = [], ""
        for cell in row:
            last = cell or last
            reaching.append(last)
        above.insert(0, reaching)
    return tuple(
        tuple(word for word in (*(row[i] for row in above), cell) if word) if cell else ()
        for i, cell in enumerate(cells)
    )


def _units(rows: Sequence[Row], at: int, cells: Sequence[str]) -> dict[int, str]:
    """Units in the row below or above the names, and those that the lines above give for all positions (OptiTrack)."""
    below = rows[at + 1][1] if at + 1 < len(rows) else []
    above = rows[at - 1][1] if at > 0 and len(rows[at - 1][1]) == len(cells) > 1 else []
    for row in (below, above):
        if any(row) and not any(is_cell(cell) for cell in row if cell):
            found = {i: written(cell) for i, cell in enumerate(row[: len(cells)]) if cell}
            if found and all(unit is not None or _dashes(row[i]) for i, unit in found.items()):
                return {i: unit for i, unit in found.items() if unit}
    for _, row in rows[:at]:
        for key, value in pairwise(row):
            unit = written(value) if key.lower() == "length units" else None
            if unit:
                stacked = _stacked(rows, at, cells)
                return {i: unit for i, words in enumerate(stacked) if "Position" in words}
    return {}


def _dashes(cell: str) -> bool:
    return not cell.strip("-[]() ")


def without_unit(name: str) -> tuple[str, str | None]:
    """The ``name`` and the unit in brackets behind it, if it is one."""
    match = BRACKETS.match(name) or BEHIND.match(name)
    square = name.endswith("[in]")  # inches; "flow (in)" is none
    if match is None or not match.group(1) or (match.group(2).strip().lower() in OTHER_WORDS and not square):
        return name, None
    unit = written(match.group(2))
    return (match.group(1), unit) if unit else (name, None)


def suffix(name: str) -> str | None:
    """The unit other than that of SI that a ``name`` may end with, as "x_mm" does, and that nobody converts."""
    match = SUFFIX.match(name)
    unit = written(match.group(1)) if match and without_unit(name)[1] is None else None
    return unit if unit and to_si(unit, "")[1] != 1.0 and unit not in OTHER_WORDS else None


def _words(name: str) -> list[str]:
    return [word for word in SEPARATORS.split(name) if word]


def _within(asked: Sequence[str], words: Sequence[str]) -> bool:
    """Whether all words that are asked for stand among those of a column, in their order."""
    have = iter(_words(" ".join(words)))
    return all(any(word == other for other in have) for word in asked)
