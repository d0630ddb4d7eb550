"""Objects in MATLAB files, whose properties stand in a part of their own: tables, timetables, durations, dates.

The layout of that part (a "FileWrapper__": numbers that link names, classes, objects and cells) is the same in files of
version 5 and 7.3; only how its cells are read differs. It is not published by MATLAB's makers.
Source: the notes on the format by F. Rajan, "Subsystem data format", github.com/foreverallama/matio.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

#: The first number of an array that stands for objects.
MARK = 0xDD000000
#: Cells before the first with a property; numbers of a class, of an object.
FIRST_CELL, CLASS_WORDS, OBJECT_WORDS = 2, 4, 6
#: Regions of the metadata, by the place of their offset.
CLASSES, SAVED, OBJECTS, PLAIN = 0, 1, 2, 3
#: What a property is: a cell with a value, or the value itself.
CELL = 1


class Variables(dict[str, Any]):
    """The ``columns`` of a table by name; ``units`` of those that name one."""

    units: Mapping[str, str]

    def __init__(self, columns: Mapping[str, Any], units: Mapping[str, str]) -> None:
        super().__init__(columns)
        self.units = units


class NotRead(Exception):
    """An object of a class that is not read; its text is the class."""


def is_reference(value: Any) -> bool:
    """Whether ``value`` stands for objects of the file."""
    kind = isinstance(value, np.ndarray) and value.dtype == np.uint32
    return bool(kind and value.size >= 5 and value.flat[0] == MARK)


@dataclass(frozen=True, eq=False)
class Objects:
    """The objects of a file.

    Attributes:
        metadata: bytes that link them.
        order: "<" or ">", of the numbers there.
        cell: value of the cell of that number: arrays, texts, lists (cells), dictionaries (structures).
        n_cells: number of cells.
    """

    metadata: bytes
    order: str
    cell: Callable[[int], Any]
    n_cells: int

    def value(self, reference: Any) -> Any:
        """What the ``reference`` stands for: seconds of durations, dates, :class:`Variables` of tables.

        Raises NotRead for objects of other classes, and ValueError, IndexError, KeyError for damaged files.
        """
        words = np.asarray(reference).ravel()
        size = int(words[1])
        ids, kind = words[2 + size : -1], int(words[-1])
        name = self._name(int(self._region(CLASSES)[CLASS_WORDS * kind + 1]))
        if name not in READ or len(ids) != 1:
            raise NotRead(name if len(ids) == 1 else f"{name} array")
        given = {**self._defaults(kind), **self._properties(int(ids[0]))}
        return READ[name]({key: self._resolved(part) for key, part in given.items()})

    def _defaults(self, kind: int) -> dict[str, Any]:
        """Values of the properties of a class that its objects need not say; they are in the last cell."""
        known = self.cell(self.n_cells - 1)
        found = known[kind] if isinstance(known, list) and kind < len(known) else {}
        return dict(found) if isinstance(found, Mapping) else {}

    def _resolved(self, part: Any) -> Any:
        """Nested objects of the classes that are read; what is of another class stays a NotRead where it stands."""
        if is_reference(part):
            try:
                return self.value(part)
            except NotRead as error:
                return error
        if isinstance(part, list):
            return [self._resolved(each) for each in part]
        if isinstance(part, dict):
            return {name: self._resolved(each) for name, each in part.items()}
        return part

    def _words(self) -> NDArray[np.uint32]:
        return np.frombuffer(self.metadata[: len(self.metadata) // 4 * 4], self.order + "u4")

    def _region(self, which: int) -> NDArray[np.uint32]:
        words = self._words()
        start, end = int(words[2 + which]), int(words[3 + which])
        if not 0 < start <= end <= len(self.metadata):
            raise ValueError("the objects of the file are damaged")
        return words[start // 4 : end // 4]

    def _name(self, number: int) -> str:
        """The name of that ``number``, from 1 on."""
        text = self.metadata[40 : int(self._words()[2])]
        return text.split(b"\0")[number - 1].decode("utf-8", "replace") if number else ""

    def _properties(self, number: int) -> dict[str, Any]:
        """Values of the properties of the object of that ``number``."""
        row = self._region(OBJECTS)[OBJECT_WORDS * number : OBJECT_WORDS * (number + 1)]
        saved, plain = int(row[3]), int(row[4])
        words, block = (self._region(SAVED), saved) if saved else (self._region(PLAIN), plain)
        at = 0
        for _ in range(block):  # blocks of three numbers a property, padded to eight bytes
            at += 1 + 3 * int(words[at])
            at += at % 2
        found = {}
        for k in range(int(words[at])):
            name, kind, value = (int(w) for w in words[at + 1 + 3 * k : at + 4 + 3 * k])
            if kind == CELL:
                if value + FIRST_CELL >= self.n_cells:
                    raise ValueError("the objects of the file are damaged")
                found[self._name(name)] = self.cell(value + FIRST_CELL)
        return found


def _durations(properties: Mapping[str, Any]) -> NDArray[np.float64]:
    """Durations in s."""
    return np.asarray(properties["millis"], dtype=np.float64) / 1e3


def _dates(properties: Mapping[str, Any]) -> NDArray[np.datetime64]:
    """Dates to the nanosecond; the imaginary part holds what a double of milliseconds leaves over."""
    data = np.asarray(properties["data"])
    whole = np.floor(data.real)
    rest = np.round(1e6 * ((data.real - whole) + data.imag))
    known = np.isfinite(whole)
    epoch = np.full(data.shape, "NaT", dtype="datetime64[ns]")
    ns = np.where(known, whole, 0.0).astype(np.int64) * 1_000_000 + np.where(known, rest, 0.0).astype(np.int64)
    epoch[known] = ns[known].astype("datetime64[ns]")
    return epoch


def _table(properties: Mapping[str, Any]) -> Variables:
    names = _texts(properties["varnames"])
    units = properties.get("props", {}).get("VariableUnits", [])
    return _columns(names, properties["data"], units)


def _timetable(properties: Mapping[str, Any]) -> Variables:
    inside = properties["any"]
    names = _texts(inside["varNames"])
    found = _columns(names, inside["data"], inside.get("varUnits", []))
    rows = inside["rowTimes"]
    if isinstance(rows, Mapping):  # evenly spaced: a start, and a step or a rate
        count = int(np.asarray(inside["numRows"]).item())
        rate, step = rows.get("sampleRate"), rows.get("stepSize")
        dt = 1.0 / float(np.asarray(rate).item()) if bool(np.asarray(rows["specifiedAsRate"]).item()) else step
        if isinstance(dt, Exception):
            raise dt  # calendar months and days are no seconds
        seconds = np.asarray(float(np.asarray(dt).item()) * np.arange(count), dtype=np.float64)
        start = np.asarray(rows["origin"])
        rows = start.item() + seconds if start.dtype.kind == "f" else start.ravel() + _nanoseconds(seconds)
    if isinstance(rows, Exception):
        raise rows
    label = _texts(inside["dimNames"])[0]
    return Variables({label: rows, **found}, found.units)


def _nanoseconds(seconds: NDArray[np.float64]) -> NDArray[np.timedelta64]:
    return np.round(1e9 * seconds).astype("timedelta64[ns]")


def _columns(names: list[str], data: Any, units: Any) -> Variables:
    values = data if isinstance(data, list) else [data]
    told = _texts(units) if isinstance(units, list) else []
    known = dict(zip(names, told, strict=False)) if len(told) == len(names) else {}
    return Variables(dict(zip(names, values, strict=True)), {name: unit for name, unit in known.items() if unit})


def _texts(cells: Any) -> list[str]:
    found = cells if isinstance(cells, list) else [cells] if isinstance(cells, str) else []
    return [text if isinstance(text, str) else "" for text in found]


#: Classes that are read.
READ: dict[str, Callable[[Mapping[str, Any]], Any]] = {
    "duration": _durations,
    "datetime": _dates,
    "table": _table,
    "timetable": _timetable,
}
