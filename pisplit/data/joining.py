"""Tables of recordings, of whatever files, become one recording: their units agree, their runs keep their names."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pisplit.data import headers, recordings
from pisplit.data.units import conversion

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Table:
    """Columns of one file.

    source    its name
    columns   {name: (N,) numbers}
    units     {name: unit that the file itself names}
    times     (N,) numbers, or dates; None where no column has them
    clock     unit of the times that the file names, or "s" for dates; None where only the caller knows
    runs      (N,) names of runs, or None
    """

    source: str
    columns: Mapping[str, Array]
    units: Mapping[str, str]
    times: ArrayLike | None
    clock: str | None
    runs: Sequence[str] | None


def from_columns(
    tables: Sequence[Table], states: Sequence[str], inputs: Sequence[str], options: Mapping[str, Any]
) -> dict[str, Any]:
    """Fields of Episodes of ``tables`` with columns ``states`` and ``inputs``, one after another.

    ``options`` as in :func:`pisplit.data.recordings.from_arrays`. Raises ValueError, in one line, where the units of
    tables differ from each other or from those that are given.
    """
    named = {} if "" in (options.get("state_units"), options.get("input_units")) else tables[0].units
    short = _labels([*states, *inputs], named)
    labels = {"state_names": tuple(short[: len(states)]), "input_names": tuple(short[len(states) :])}
    given: dict[str, Any] = {**labels, **options}
    x, given["state_units"] = _stacked(tables, states, given.get("state_units"), "state_units")
    u, given["input_units"] = _stacked(tables, inputs, given.get("input_units"), "input_units")
    if options.get("units") is not None and options.get("state_units") is None:
        given["state_units"] = None
    given["time_unit"] = _clock(tables, given.get("time_unit"))
    origin: dict[str, Any] = {"file": tables[0].source} if len(tables) == 1 else {"files": [t.source for t in tables]}
    if tables[0].units:
        origin["units_of_file"] = dict(tables[0].units)
    given["provenance"] = {**origin, **(options.get("provenance") or {})}
    sizes = [len(next(iter(t.columns.values()))) for t in tables]
    runs = _runs(tables, sizes)
    if runs is not None:
        given["episode"] = runs
    return recordings.from_arrays(_times(tables), x, u, **given)


def _labels(names: Sequence[str], units: Mapping[str, str]) -> list[str]:
    """Names without the units behind them, which numbers have no more; as they are where that makes two the same."""
    short = [headers.without_unit(name)[0] if name in units else name for name in names]
    return short if len(set(short)) == len(set(names)) else list(names)


def _stacked(tables: Sequence[Table], names: Sequence[str], given: Any, key: str) -> tuple[Array, Any]:
    """Columns ``names`` of all tables, one below the other, and their units: those ``given``, or those of the first."""
    told = [given] * len(names) if given is None or isinstance(given, str) else list(given)
    columns: list[Array] = []
    units: list[str] = []
    for name, unit in zip(names, [*told, *[None] * (len(names) - len(told))], strict=False):
        own = [t.units.get(name, "") for t in tables]
        unit = own[0] if unit is None else unit
        parts = []
        for t, mine in zip(tables, own, strict=True):
            factor = conversion(mine, unit) if mine and unit else 1.0
            if factor is None or (given is not None and factor != 1.0):
                raise ValueError(f"{name} is in {mine} by {t.source}, not in {unit}; leave {key} out, or mend the file")
            if given is None and bool(mine) != bool(unit):
                raise ValueError(f"{name} has a unit in one file and none in another; give {key}=")
            parts.append(t.columns[name] * factor if factor != 1.0 else t.columns[name])
        columns.append(np.concatenate(parts))
        units.append(unit)
    size = sum(len(next(iter(t.columns.values()))) for t in tables)
    return np.column_stack([np.zeros((size, 0)), *columns]), units if given is None else given


def _clock(tables: Sequence[Table], given: Any) -> Any:
    """Unit of time: that ``given``, or that which the tables name."""
    found = {t.clock for t in tables}
    if given is None:
        if len(found) > 1:
            raise ValueError(f"files name their times in {' and '.join(sorted(map(str, found)))}; give time_unit=")
        return found.pop()
    odd = [unit for unit in found if unit is not None and isinstance(given, str) and conversion(given, unit) != 1.0]
    if odd:
        raise ValueError(f"times are in {odd[0]} by their file, time_unit says {given!r}; leave time_unit out")
    return given


def _times(tables: Sequence[Table]) -> ArrayLike | None:
    parts = [np.asarray(t.times) for t in tables if t.times is not None]
    if not parts:
        return None
    if len({part.dtype.kind == "O" for part in parts}) > 1:
        raise ValueError("some files have dates, others numbers for times; give files of one kind")
    return np.concatenate(parts)


def _runs(tables: Sequence[Table], sizes: Sequence[int]) -> list[str] | None:
    """Name of the run of every sample, with that of its file where there are several."""
    if len(tables) == 1:
        return None if tables[0].runs is None else list(tables[0].runs)
    return [
        t.source if t.runs is None else f"{t.source}, {run}" if run else ""
        for t, n in zip(tables, sizes, strict=True)
        for run in (t.runs or [""] * n)
    ]
