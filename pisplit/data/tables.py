"""Recordings in text tables: one header line, one line a sample."""

from __future__ import annotations

import csv
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pisplit.data import recordings

Array = NDArray[np.float64]

#: What a cell may hold; float() alone would read 1_00.5 as 100.5.
NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?|nan", re.ASCII | re.IGNORECASE)


def from_csv(
    path: str | os.PathLike[str],
    time: str,
    states: str | Sequence[str],
    inputs: str | Sequence[str],
    delimiter: str = ",",
    episode: str | None = None,
    **options: Any,
) -> dict[str, Any]:
    """Fields of :class:`pisplit.Episodes`, by name, of a table with one header line.

    path            file, UTF-8
    time            name of the column of times: numbers, or dates as in ISO 8601
    states, inputs  names of columns; no inputs: []
    delimiter       one character
    episode         name of a column that names the run of every sample, for clocks that restart
    options         as in :func:`pisplit.data.recordings.from_arrays`

    Empty cells and "nan" are missing. Raises FileNotFoundError, and ValueError for missing or repeated columns, lines
    with too many cells, and cells that are no numbers.
    """
    groups = [[names] if isinstance(names, str) else list(names) for names in (states, inputs)]
    names = [*groups[0], *groups[1]]
    if episode is not None and not isinstance(episode, str):
        raise ValueError(f"episode is a {type(episode).__name__}; expected the name of a column")
    runs = [] if episode is None else [episode]
    table = _read(Path(path), [time, *names, *runs], delimiter)
    columns: dict[str, ArrayLike] = {name: _numbers(path, table, name) for name in names}
    columns[time] = _times(path, table, time)
    if episode is not None:
        options["episode"] = [cell for _, cell in table[episode]]
    return from_columns(columns, Path(path).name, time, groups[0], groups[1], options)


def from_columns(
    columns: Mapping[str, ArrayLike], source: str, time: str, states: Sequence[str], inputs: Sequence[str], options: Any
) -> dict[str, Any]:
    """Fields of Episodes of named ``columns`` (N,) of the file ``source``: those of ``time``, ``states``, ``inputs``.

    ``options`` as in :func:`pisplit.data.recordings.from_arrays`. Raises ValueError if no state is named.
    """
    if not states:
        raise ValueError("states names no columns; give at least one")
    given = {"state_names": tuple(states), "input_names": tuple(inputs), **options}
    given["provenance"] = {"file": source, **(options.get("provenance") or {})}
    size = len(np.asarray(columns[time]))
    x, u = (
        np.column_stack([np.asarray(columns[name]) for name in group]) if group else np.zeros((size, 0))
        for group in (states, inputs)
    )
    return recordings.from_arrays(columns[time], x, u, **given)


def _read(path: Path, wanted: Sequence[str], delimiter: str) -> dict[str, list[tuple[int, str]]]:
    """Line and text of the cells of the wanted columns."""
    if not path.is_file():
        raise FileNotFoundError(f"{path} does not exist; expected a table with a header line")
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            rows = csv.reader(file, delimiter=delimiter)
            header = [name.strip() for name in next(rows, [])]
            for name in wanted:
                if header.count(name) != 1:
                    what = "no column" if name not in header else "several columns"
                    raise ValueError(f"{path} has {what} {name!r}; it has {', '.join(header[:8]) or 'none'}")
            where = [header.index(name) for name in wanted]
            cells = [(line, [row[i].strip() for i in where]) for line, row in _lines(path, rows, len(header))]
    except UnicodeDecodeError:
        raise ValueError(f"{path} is no UTF-8 text; save it as UTF-8") from None
    except csv.Error as error:
        raise ValueError(f"{path} is no table: {error}") from None
    if not cells:
        raise ValueError(f"{path} has a header and no rows; expected samples")
    return {name: [(line, row[i]) for line, row in cells] for i, name in enumerate(wanted)}


def _lines(path: Path, rows: Any, size: int) -> Iterator[tuple[int, list[str]]]:
    """Number and cells of every line that holds something; a line that was cut off has empty cells."""
    for row in rows:
        if any(cell.strip() for cell in row):
            if any(cell.strip() for cell in row[size:]):
                raise ValueError(f"{path}, line {rows.line_num} has {len(row)} cells; the header has {size}")
            yield rows.line_num, row + [""] * (size - len(row))


def _numbers(path: str | os.PathLike[str], table: Mapping[str, list[tuple[int, str]]], name: str) -> Array:
    values = np.empty(len(table[name]))
    for i, (line, cell) in enumerate(table[name]):
        if cell and not NUMBER.fullmatch(cell):
            raise ValueError(f"{path}, line {line}: {cell!r} is not a number")
        values[i] = float(cell) if cell else np.nan
    return values


def _times(path: str | os.PathLike[str], table: Mapping[str, list[tuple[int, str]]], name: str) -> ArrayLike:
    """Times as numbers, or as dates where the first one is a date."""
    first = next((cell for _, cell in table[name] if cell), "")
    if not first or NUMBER.fullmatch(first):
        return _numbers(path, table, name)
    found = []
    for line, cell in table[name]:
        try:
            found.append(datetime.fromisoformat(cell.replace("Z", "+00:00")) if cell else None)
        except ValueError:
            raise ValueError(f"{path}, line {line}: {cell!r} is not a number, and no date as in ISO 8601") from None
    return np.array(found, dtype=object)
