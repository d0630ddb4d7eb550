"""Recordings in text tables, one line a sample: of one file or of several, with commands beside or apart."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from pisplit.data import cells, headers, merging, shifted_rows
from pisplit.data.joining import Table, from_columns
from pisplit.data.patterns import Paths, files_of
from pisplit.data.text import DELIMITERS, rows_of, text_of
from pisplit.data.warning import warn

#: Lines that tell the delimiter.
TOP = 200
#: Nanoseconds of fractions of a second, by what the name of their column has, the longest word first.
FRACTIONS = {r"n(ano)?_?s": 1, r"(u|micro)_?s|micros": 1_000, r"(m|milli)_?s|millis": 1_000_000}
SECOND_NS, MICROS = 1_000_000_000, 1_000_000
#: What helps where the line below a header holds words.
SECOND = "; a second line of names or units: take it out, or give names= for all columns"


def from_csv(
    path: Paths,
    time: str | Sequence[str] | None,
    states: str | Sequence[str],
    inputs: str | Sequence[str],
    delimiter: str | None = None,
    episode: str | None = None,
    names: Sequence[str] | None = None,
    decimal: str | None = None,
    encoding: str | None = None,
    commands: Paths | None = None,
    command_time: str | Sequence[str] | None = None,
    command_time_unit: str | float | None = None,
    command_shift: float | str | None = None,
    **options: Any,
) -> dict[str, Any]:
    """Fields of :class:`pisplit.Episodes`, by name, of text tables.

    path            a file, a pattern such as "run*.csv", or a list of these; each file is at least one episode
    time            name of the column of times: numbers, durations such as "0.01 sec", or dates as in ISO 8601; two
                    names, of seconds and of nanoseconds beyond; None: samples are ``dt`` apart
    states, inputs  names of columns; no inputs: []. Where the header has several rows, as many words of a column, from
                    top to bottom, as tell it from others: "tip X"; units in brackets behind a name may be left out
    delimiter       one character; default: that of comma, semicolon, tab, | and blanks which makes the columns
    episode         name of a column that names the run of every sample, for clocks that restart
    names           names of all columns, for files without a header; lines before the first sample are passed over
    decimal         "." or ","; default: what the numbers have
    encoding        default: UTF-8, what the first bytes say, or Latin-1
    commands        files of the inputs, where these have a clock of their own: one for each file of ``path``, or one
                    for all. They hold from their time to the next, and are brought to the steps of the sensors
    command_time    name of the column of times there; default: that of ``time``
    command_time_unit   unit of the times there, where their file names none; default: ``time_unit`` if that is a text,
                    or s
    command_shift   [s] that is added to the times of commands; default: found from the data where the motion comes
                    before the commands of files of their own; commands in the same file keep their times, and this is
                    warned of. How far the motion follows its commands is warned of, and stands in ``provenance``.
                    "found" moves them by what is found, either way
    options         as in :func:`pisplit.data.recordings.from_arrays`. Units that the file names, in brackets behind a
                    name or in a row below, count where ``state_units``, ``input_units``, ``time_unit`` are not given;
                    "" takes numbers as they are

    Empty cells, "nan", "NA", "null" and dashes are missing. Raises FileNotFoundError, and ValueError for missing or
    repeated columns, units that are not those which the file names, lines with too many cells, and cells that are no
    numbers.
    """
    groups = [[given] if isinstance(given, str) else list(given) for given in (states, inputs)]
    if not groups[0]:
        raise ValueError("states names no columns; give at least one")
    if both := sorted(set(groups[0]) & set(groups[1])):
        raise ValueError(f"{both[0]!r} is named as a state and as an input; give it once")
    if episode is not None and not isinstance(episode, str):
        raise ValueError(f"episode is a {type(episode).__name__}; expected the name of a column")
    if decimal is not None and decimal not in (".", ","):
        raise ValueError(f"decimal = {decimal!r}; expected '.' or ','")
    if isinstance(names, str):
        raise ValueError(f"names = {names!r} is one text; expected a list of the names of all columns")
    if commands is not None and not groups[1]:
        raise ValueError("inputs names no columns; give those of the files of commands")
    clock = [] if time is None else [time] if isinstance(time, str) else list(time)
    files = files_of(path)
    if commands is not None:
        other = (
            clock if command_time is None else [command_time] if isinstance(command_time, str) else list(command_time)
        )
        more = (delimiter, None, decimal, encoding)
        sensors = [table(file, clock, groups[0], episode, delimiter, names, decimal, encoding) for file in files]
        sent = [table(file, other, groups[1], None, *more) for file in files_of(commands)]
        say_suffixes(sensors[:1], groups[0], options, "state_units")
        say_suffixes(sent[:1], groups[1], options, "input_units")
        told = (command_time_unit, command_shift)
        return merging.from_two_clocks(sensors, sent, groups[0], groups[1], told, options)
    if command_time is not None or command_time_unit is not None:
        raise ValueError("command_time and _time_unit are of commands in files of their own; give commands=")
    read = [
        table(file, clock, [*groups[0], *groups[1]], episode, delimiter, names, decimal, encoding) for file in files
    ]
    say_suffixes(read[:1], groups[0], options, "state_units")
    say_suffixes(read[:1], groups[1], options, "input_units")
    return from_columns(read, groups[0], groups[1], {**options, "command_shift": command_shift})


def table(
    path: Path,
    clock: Sequence[str],
    columns: Sequence[str],
    episode: str | None = None,
    delimiter: str | None = None,
    names: Sequence[str] | None = None,
    decimal: str | None = None,
    encoding: str | None = None,
) -> Table:
    """The ``columns``, times and runs of the text table ``path``.

    ``clock``: names of the columns of times, none, one or two; ``episode``, ``delimiter``, ``names``, ``decimal``,
    ``encoding`` and what it raises as in :func:`from_csv`.
    """
    text = text_of(path, encoding)
    wanted = [*clock, *columns, *([] if episode is None else [episode])]
    header, mark = _header(path, text, wanted, delimiter, names)
    where = [header.find(name)[0] for name in wanted]
    rows = _samples(path, text, mark, header, where)
    found = {name: [(line, row[i]) for line, row in rows] for i, name in enumerate(wanted)}
    numeric = [found[name] for name in columns]
    times = [found[name] for name in clock]
    decimal = decimal or cells.decimal_mark([*numeric, *times], path)
    units = {name: header.unit(i) for name, i in zip(columns, where[len(clock) :], strict=False)}
    second = "" if any(cells.is_cell(cell) for cell in rows[0][1] if cell) else SECOND
    try:
        t, unit = _read_times(path, times, decimal, header, where)
    except ValueError as error:
        raise ValueError(f"{error}{second}") from None
    try:
        numbers = {name: cells.numbers(path, found[name], decimal) for name in columns}
    except ValueError as error:
        raise ValueError(f"{error}{second}") from None
    return Table(
        path.name,
        numbers,
        {name: unit for name, unit in units.items() if unit is not None},
        t,
        unit,
        None if episode is None else [cell for _, cell in found[episode]],
    )


def _read_times(
    path: Path, times: Sequence[cells.Cells], decimal: str, header: headers.Header, where: Sequence[int]
) -> tuple[ArrayLike | None, str | None]:
    if not times:
        return None, None
    if len(times) == 1:
        values, plain = cells.times(path, times[0], decimal)
        return values, header.unit(where[0], clock=True) if plain else "s"
    parts = [np.asarray(cells.times(path, part, decimal)[0]) for part in times]
    if len(parts) != 2 or any(part.dtype.kind != "i" for part in parts):
        raise ValueError(f"{path}: two columns of times are whole seconds and nanoseconds; got others")
    name = " ".join(header.columns[where[1]])
    fine = next((ns for word, ns in FRACTIONS.items() if re.search(word, name.lower())), 1)
    largest = int(parts[1].max(initial=0))
    if largest * fine >= SECOND_NS or (fine == 1 and largest < MICROS and len(parts[1]) > 1 and largest > 0):
        raise ValueError(
            f"{path}: {name!r} goes to {largest} beside whole seconds; expected nanoseconds, or a name that "
            "tells others, such as usec or msec"
        )
    return parts[0] * SECOND_NS + parts[1] * fine, "ns"


def say_suffixes(tables: Sequence[Table], names: Sequence[str], options: Mapping[str, Any], argument: str) -> None:
    """Warn of columns ``names`` that look as if they told a unit which nobody converts.

    Not where ``tables`` tell their units, or the ``options`` do by the ``argument`` "state_units" or "input_units".
    """
    known = {name for t in tables for name in t.units}
    bare = [name for name in names if name not in known] if options.get(argument) is None else []
    found = {name: unit for name in bare if (unit := headers.suffix(name))}
    if found:
        name, unit = next(iter(found.items()))
        more = f" and {len(found) - 1} more" if len(found) > 1 else ""
        warn(
            f"{name!r}{more}: in {unit} by its name? Numbers are taken as they are; {argument}={unit!r} converts them, "
            f"{argument}='' keeps them"
        )


def _header(
    path: Path, text: str, wanted: Sequence[str], delimiter: str | None, names: Sequence[str] | None
) -> tuple[headers.Header, str]:
    """The header and the delimiter, by which every wanted column is found once."""
    tried = []
    for mark in [delimiter] if delimiter is not None else DELIMITERS:
        try:
            rows = list(rows_of(text, mark, TOP))
        except (ValueError, TypeError) as error:
            if delimiter is not None:
                raise ValueError(f"{path} is no table: {error}") from None
            continue
        if names is not None:
            line = headers.start_of(rows, len(names))
            header = headers.Header(tuple((name,) for name in names), line)
            complete = line >= 0 and all(len(header.find(name)) == 1 for name in wanted)
        else:
            header, complete = headers.header_of(rows, wanted)
        if complete:
            return header, mark
        widths = [len(row) for _, row in rows[:20]]
        even = max(map(widths.count, widths), default=0)  # lines of as many cells: blanks within names make others
        hits = sum(bool(header.find(name)) for name in wanted)
        tried.append((hits, even if max(widths, default=0) > 1 else 0, max(widths, default=0), header, rows, mark))
    if not tried:
        raise ValueError(f"{path} is no table of text; save it as CSV")
    _, _, _, header, rows, mark = max(tried, key=lambda each: each[:3])
    if names is None and len(rows) == TOP:  # further down, behind another table
        later, complete = headers.header_of(list(rows_of(text, mark)), wanted, None)
        if complete:
            return later, mark
    raise ValueError(_fault(path, header, rows, wanted, names))


def _fault(
    path: Path,
    header: headers.Header,
    rows: Sequence[headers.Row],
    wanted: Sequence[str],
    names: Sequence[str] | None,
) -> str:
    """Why not every wanted column is found once."""
    if names is not None and header.line < 0:
        widths = {len(row) for _, row in rows if row}
        return (
            f"{path} has no line of {len(names)} numbers, as many as names; its lines have {sorted(widths)[:6]} cells"
        )
    if not header.columns and any(row for _, row in rows):
        return f"{path} has no header line; give names=, the names of all its columns, or names in its first line"
    for name in wanted:
        found = header.find(name)
        if len(found) > 1:
            longer = [header.names[i] for i in found]
            hint = f"; name one: {', '.join(map(repr, longer[:4]))}" if len(set(longer)) == len(longer) else ""
            hint = hint or "; rename them, or give names= for all columns"
            return f"{path} has several columns {name!r}; it has {', '.join(header.names[:8])}{hint}"
        if not found:
            return f"{path} has no column {name!r}{headers.alike(name, header.names)}"
    return f"{path} is no table"


def _samples(
    path: Path, text: str, mark: str, header: headers.Header, where: Sequence[int]
) -> list[tuple[int, list[str]]]:
    """Line and wanted cells of every line below the header that holds something; what a line lacks is empty."""
    size = len(header.columns)
    found: list[tuple[int, list[str]]] = []
    counts: list[tuple[int, int, int]] = []
    names = [header.columns[i][-1] for i in where]
    blank, widest = False, 0
    last = -1 if text.endswith(("\n", "\r")) else len(text.splitlines())
    try:
        for line, row in rows_of(text, mark):
            before, blank = blank, not row
            if line <= header.line or not row or (row[0].startswith("#") and not cells.is_missing(row[0])):
                continue
            if found and before and sum(map(bool, row)) == 1 and not any(cells.is_cell(cell) for cell in row if cell):
                warn(f"{path.name}: another table begins at line {line}; what follows is left out")
                break
            if any(row[size:]):
                raise ValueError(f"{path}, line {line} has {len(row)} cells; the header has {size}")
            cut = line == last and len(row) < size
            if cut:
                row = row[:-1]  # a logger that was killed left part of a number
            widest = max(widest, len(row))
            chosen = [row[i] if i < len(row) else "" for i in where]
            if not found and header.units and not any(cells.is_cell(cell) for cell in chosen if cell):
                continue  # the row of units
            if chosen == names and len(set(names)) == len(names):
                raise ValueError(f"{path}, line {line} repeats the header: several files in one; cut it there")
            found.append((line, chosen))
            if not cut:
                counts.append((line, len(row), shifted_rows.filled(row)))
        shifted_rows.check(path, counts, mark, lambda: rows_of(text, mark))
    except ValueError as error:
        text = str(error)
        raise ValueError(text if text.startswith(str(path)) else f"{path} is no table: {text}") from None
    if not found:
        raise ValueError(f"{path} has a header and no rows; expected samples")
    named = max(i for i, words in enumerate(header.columns) if words) + 1
    if widest < named:
        raise ValueError(
            f"{path} has a header of {named} cells and rows of at most {widest}: names do not stand above their "
            "columns; does the delimiter stand in a name? give names= for all columns"
        )
    return found
