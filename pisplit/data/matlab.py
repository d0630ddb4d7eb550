"""Recordings in MATLAB files: matrices, fields of structures, and runs in cells or arrays of structures."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pisplit.checks import real_array
from pisplit.data.joining import Table, from_columns
from pisplit.data.matlab_objects import NotRead, Variables
from pisplit.data.matlab_values import load, unread

Array = NDArray[np.float64]


def from_mat(
    path: str | os.PathLike[str],
    time: str | None,
    states: str | Sequence[str],
    inputs: str | Sequence[str],
    episode: str | None = None,
    **options: Any,
) -> dict[str, Any]:
    """Fields of :class:`pisplit.Episodes`, by name, of a MATLAB file of any version (4 to 7.3).

    path            file
    time            name of the variable of times, a vector of N; None: samples are ``dt`` apart
    states, inputs  names of variables, each (N,), (N, k) or (k, N); columns of a matrix ``q`` are named q1, q2, ...;
                    no inputs: []. "log.q" is the field ``q`` of a structure. Where variables are cells, or fields of an
                    array of structures, each element is a run of its own; what is no cell counts for every run.
                    "log.q" is the variable ``q`` of a table or timetable too, "log.Time" the times of its rows; units
                    that it names count where ``state_units`` and ``input_units`` are not given
    episode         name of a variable, a vector of N numbers of runs, for clocks that restart
    options         as in :func:`pisplit.data.recordings.from_arrays`

    Raises FileNotFoundError, PermissionError, and ValueError for missing variables, those that hold no real numbers,
    objects other than tables, timetables, durations and dates (it tells what makes matrices of them in MATLAB),
    runs of different number, and files that are damaged or of another format.
    """
    source = Path(path)
    groups = [[names] if isinstance(names, str) else list(names) for names in (states, inputs)]
    if not groups[0]:
        raise ValueError("states names no variables; give at least one")
    wanted = [*([] if time is None else [time]), *groups[0], *groups[1], *([] if episode is None else [episode])]
    content = load(source, sorted({name.split(".")[0] for name in wanted}))
    values = {name: _found(content, name, source) for name in wanted}
    units = {name: _unit(content, name) for name in wanted}
    counts = {len(value) for value in values.values() if isinstance(value, list)}
    if len(counts) > 1:
        told = ", ".join(f"{name!r} {len(v)}" for name, v in values.items() if isinstance(v, list))
        raise ValueError(f"variables in {source} have different numbers of runs: {told}; give as many of each")
    tables, labels = [], [[""], [""]]
    several = bool(counts)
    for k in range(counts.pop() if several else 1):
        run = {name: value[k] if isinstance(value, list) else value for name, value in values.items()}
        name = f"{source.name}, run {k + 1}" if several else source.name
        table, labels = _table(name, run, units, time, groups, episode, source)
        tables.append(table)
    return from_columns(tables, labels[0], labels[1], options)


def _found(content: Mapping[str, Any], name: str, source: Path) -> Any:
    """The variable ``name``, a list where it has runs."""
    value: Any = content
    for depth, part in enumerate(name.split(".")):
        levels = value if isinstance(value, list) else [value]
        if any(not isinstance(level, Mapping) or part not in level for level in levels):
            known = sorted(levels[0])[:8] if isinstance(levels[0], Mapping) else []
            where = f"field {part!r} in {'.'.join(name.split('.')[:depth])}" if depth else f"variable {part!r}"
            hint = f"it has {', '.join(known)}" if depth and known else "give names of its variables"
            raise ValueError(f"{source} has no {where}; {hint}")
        below = [level[part] for level in levels]
        value = below if isinstance(value, list) else below[0]
    if isinstance(value, NotRead):
        raise unread(name, source, str(value))
    if isinstance(value, Mapping):
        fields = ", ".join(f"'{name}.{field}'" for field in sorted(value)[:6])
        raise ValueError(f"{name!r} in {source} is a structure; name a field: {fields}")
    return value


def _table(
    name: str,
    run: Mapping[str, Any],
    units: Mapping[str, str],
    time: str | None,
    groups: Sequence[Sequence[str]],
    episode: str | None,
    source: Path,
) -> tuple[Table, list[list[str]]]:
    """Columns of one run, and their names: of states and of inputs."""
    first = np.asarray(run[groups[0][0]])
    size = np.size(run[time]) if time is not None else max(first.shape, default=1)
    columns: dict[str, Array] = {}
    labels: list[list[str]] = []
    told: dict[str, str] = {}
    for group in groups:
        found: list[str] = []
        for variable in group:
            value = np.atleast_1d(real_array(run[variable], f"{variable!r} in {source}"))
            value = value.reshape(len(value), -1) if value.ndim == 1 else value
            value = value.T if value.shape[0] != size and value.shape[-1] == size else value
            if value.ndim != 2 or len(value) != size:
                shape = np.shape(run[variable])
                raise ValueError(f"{variable!r} in {source} has shape {shape}; expected {size} rows, one a time")
            short = variable.split(".")[-1]
            short = variable if short in columns else short
            names = [short] if value.shape[1] == 1 else [f"{short}{i + 1}" for i in range(value.shape[1])]
            columns |= dict(zip(names, value.T, strict=True))
            told |= dict.fromkeys(names, units[variable]) if units[variable] else {}
            found += names
        labels.append(found)
    runs = None if episode is None else [str(label) for label in np.ravel(run[episode]).tolist()]
    times = None if time is None else np.ravel(run[time])
    return Table(name, columns, told, times, None, runs), labels


def _unit(content: Mapping[str, Any], name: str) -> str:
    """The unit that a table of MATLAB names for a column, an empty text where there is none."""
    *above, last = name.split(".")
    value: Any = content
    for part in above:
        value = value.get(part) if isinstance(value, Mapping) else None
    return value.units.get(last, "") if isinstance(value, Variables) else ""
