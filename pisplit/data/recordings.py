"""Recordings of real robots: clocks that jitter, gaps, units, rows that are missing."""

from __future__ import annotations

import csv
import os
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import CubicSpline

from pisplit.checks import finite_number, one_of, positive
from pisplit.data.episodes import Episodes
from pisplit.data.units import columns_to_si, to_si

Array = NDArray[np.float64]

INTERPOLATIONS = ("linear", "cubic")


def from_arrays(
    t: ArrayLike,
    x: ArrayLike,
    u: ArrayLike,
    dt: float | None = None,
    interpolation: str = "linear",
    max_gap: float | None = None,
    state_units: str | Sequence[str] | None = None,
    input_units: str | Sequence[str] | None = None,
    time_unit: str = "s",
    ranges: Mapping[str, tuple[float, float]] | None = None,
    **labels: Any,
) -> Episodes:
    """Episodes from one recording: times t (N,), states x (N, n) and inputs u (N, m) at these times.

    dt             step of the episodes [s]; default: the median step of t
    interpolation  of the states between samples, "linear" or "cubic". Inputs are commands: each holds until the next,
                   and the input of a step is its mean over the step
    max_gap        longest time between samples that is bridged [s], default 3 times the median step; at longer ones the
                   recording is split into episodes. Rows with NaN are missing samples
    state_units, input_units, time_unit   units of the data (one for all, or one a column); converted to SI
    ranges         {column name: (low, high)} in SI units that samples must lie in
    labels         state_names, input_names, quantities, outputs, provenance of :class:`pisplit.Episodes`

    Pieces shorter than one step are dropped with a warning. Raises ValueError for times that do not increase, unknown
    units, samples out of range, and if no piece is left.
    """
    one_of(interpolation, "interpolation", INTERPOLATIONS)
    second, factor = to_si(time_unit, "time_unit")
    if second != "s":
        raise ValueError(f"time_unit = {time_unit!r}; expected a unit of time: s, ms, us or ns")
    times = _column(t, "t") * factor
    states, inputs = _rows(x, "x", len(times)), _rows(u, "u", len(times))
    units, factors = columns_to_si(state_units, "state_units", states.shape[1])
    states = states * factors
    commanded, scales = columns_to_si(input_units, "input_units", inputs.shape[1])
    inputs = inputs * scales
    whole = np.isfinite(states).all(axis=1) & np.isfinite(inputs).all(axis=1) & np.isfinite(times)
    times, states, inputs = times[whole], states[whole], inputs[whole]
    if len(times) < 2:
        raise ValueError(f"{len(times)} of {len(whole)} samples are complete; a recording needs at least two")
    steps = np.diff(times)
    if (steps <= 0.0).any():
        at = int(np.argmax(steps <= 0.0))
        raise ValueError(f"t does not increase after sample {at} ({times[at]:g} s); sort it and drop repeated samples")
    typical = float(np.median(steps))
    step = typical if dt is None else positive(dt, "dt", "s")
    gap = 3.0 * max(typical, step) if max_gap is None else positive(max_gap, "max_gap", "s")
    names = _names(labels, states.shape[1], inputs.shape[1])
    _check_ranges(ranges or {}, names, np.hstack([states, inputs]), times)
    pieces = np.split(np.arange(len(times)), np.flatnonzero(steps > gap) + 1)
    xs, us = [], []
    for piece in pieces:
        # Rounding of the clock must not cost the last step.
        count = int(np.floor((times[piece[-1]] - times[piece[0]]) / step * (1.0 + 1e-9) + 1e-6))
        if count < 1:
            continue
        grid = np.minimum(times[piece[0]] + step * np.arange(count + 1), times[piece[-1]])
        xs.append(_resampled(times[piece], states[piece], grid, interpolation))
        us.append(_held(times[piece], inputs[piece], grid))
    if not xs:
        raise ValueError(
            f"no piece of the recording is longer than dt = {step:g} s; give a smaller dt or larger max_gap"
        )
    if len(xs) < len(pieces):
        warnings.warn(f"{len(pieces) - len(xs)} of {len(pieces)} pieces are shorter than dt and dropped", stacklevel=2)
    origin = {
        "samples": len(whole),
        "incomplete_samples": int(len(whole) - whole.sum()),
        "pieces": len(pieces),
        "jitter": float(np.abs(steps[steps <= gap] - typical).max(initial=0.0)),
        "interpolation": interpolation,
    }
    provenance = {**origin, **(labels.get("provenance") or {})}
    return Episodes(xs, us, step, **{"units": units, "input_units": commanded, **labels, "provenance": provenance})


def from_csv(
    path: str | os.PathLike[str],
    time: str,
    states: Sequence[str],
    inputs: Sequence[str],
    delimiter: str = ",",
    **options: Any,
) -> Episodes:
    """Episodes from a table with one header line; ``time``, ``states`` and ``inputs`` are names of its columns.

    Empty cells are missing samples. ``options`` as in :func:`from_arrays`. Raises FileNotFoundError, and ValueError for
    missing columns and cells that are not numbers.
    """
    columns = _read_table(Path(path), [time, *states, *inputs], delimiter)
    return _from_columns(columns, Path(path).name, time, states, inputs, options)


def from_mat(
    path: str | os.PathLike[str], time: str, states: str | Sequence[str], inputs: str | Sequence[str], **options: Any
) -> Episodes:
    """Episodes from a MATLAB file (up to version 7.2) with variables of these names, each (N,) or (N, k).

    Columns of a matrix ``q`` are named q1, q2, ... ``options`` as in :func:`from_arrays`. Raises FileNotFoundError,
    PermissionError, and ValueError for missing variables and files of another format.
    """
    from scipy.io import loadmat
    from scipy.io.matlab import MatReadError

    source = Path(path)
    if not source.is_file():
        raise FileNotFoundError(f"{source} does not exist; expected a MATLAB file")
    groups = [[names] if isinstance(names, str) else list(names) for names in (states, inputs)]
    wanted = [time, *groups[0], *groups[1]]
    with source.open("rb") as file:  # what cannot be opened says so itself
        try:
            content = loadmat(file, variable_names=wanted)
        except (MatReadError, ValueError, NotImplementedError, TypeError, OSError):
            raise ValueError(f"{source} is no MATLAB file up to version 7.2; save it with '-v7'") from None
    missing = [name for name in wanted if name not in content]
    if missing:
        raise ValueError(f"{source} has no variable {missing[0]!r}; give names of its variables")
    size = np.size(content[time])
    columns: dict[str, Array] = {time: np.ravel(content[time]).astype(np.float64)}
    labelled: list[list[str]] = []
    for group in groups:
        found: list[str] = []
        for name in group:
            value = np.asarray(content[name], dtype=np.float64)
            value = value.T if value.shape[0] != size and value.shape[-1] == size else value
            if value.ndim != 2 or len(value) != size:
                raise ValueError(f"{name!r} in {source} has shape {value.shape}; expected {size} rows, one a time")
            labels = [name] if value.shape[1] == 1 else [f"{name}{i + 1}" for i in range(value.shape[1])]
            columns |= dict(zip(labels, value.T, strict=True))
            found += labels
        labelled.append(found)
    return _from_columns(columns, source.name, time, labelled[0], labelled[1], options)


def _from_columns(
    columns: Mapping[str, Array], source: str, time: str, states: Sequence[str], inputs: Sequence[str], options: Any
) -> Episodes:
    if not states or not inputs:
        raise ValueError("states and inputs name no columns; give at least one of each")
    given = {"state_names": tuple(states), "input_names": tuple(inputs), **options}
    given["provenance"] = {"file": source, **(options.get("provenance") or {})}
    x, u = (np.column_stack([columns[name] for name in group]) for group in (states, inputs))
    return from_arrays(columns[time], x, u, **given)


def _read_table(path: Path, wanted: Sequence[str], delimiter: str) -> dict[str, Array]:
    if not path.is_file():
        raise FileNotFoundError(f"{path} does not exist; expected a table with a header line")
    with path.open(newline="", encoding="utf-8-sig") as file:
        rows = csv.reader(file, delimiter=delimiter)
        header = [name.strip() for name in next(rows, [])]
        missing = [name for name in wanted if name not in header]
        if missing:
            raise ValueError(f"{path} has no column {missing[0]!r}; it has {', '.join(header[:8]) or 'none'}")
        where = [header.index(name) for name in wanted]
        values = []
        for row in rows:
            if not any(cell.strip() for cell in row):
                continue
            cells = [row[i].strip() if i < len(row) else "" for i in where]
            try:
                values.append([float(cell) if cell else np.nan for cell in cells])
            except ValueError:
                bad = next(cell for cell in cells if cell and not _is_number(cell))
                raise ValueError(f"{path}, line {rows.line_num}: {bad!r} is not a number") from None
    if not values:
        raise ValueError(f"{path} has a header and no rows; expected samples")
    return dict(zip(wanted, np.array(values).T, strict=True))


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


def _resampled(times: Array, values: Array, grid: Array, interpolation: str) -> Array:
    if interpolation == "cubic" and len(times) > 3:
        return np.asarray(CubicSpline(times, values, axis=0)(grid))
    return np.column_stack([np.interp(grid, times, column) for column in values.T])


def _held(times: Array, values: Array, grid: Array) -> Array:
    """Mean (T, m) over every step of the grid (T+1,) of inputs that hold from one time to the next."""
    integral = np.vstack([np.zeros(values.shape[1]), np.cumsum(values[:-1] * np.diff(times)[:, None], axis=0)])
    at = np.column_stack([np.interp(grid, times, column) for column in integral.T])
    return np.asarray(np.diff(at, axis=0) / np.diff(grid)[:, None])


def _check_ranges(ranges: Mapping[str, tuple[float, float]], names: Sequence[str], values: Array, times: Array) -> None:
    for name, bounds in ranges.items():
        if name not in names:
            raise ValueError(f"ranges names {name!r}; expected names of columns ({', '.join(names[:8])})")
        low, high = (finite_number(bound, f"ranges[{name!r}]") for bound in bounds)
        column = values[:, names.index(name)]
        outside = np.flatnonzero((column < low) | (column > high))
        if len(outside):
            raise ValueError(
                f"{name} is {column[outside[0]]:g} at {times[outside[0]]:g} s and outside [{low:g}, {high:g}] in "
                f"{len(outside)} samples; check its unit or remove them"
            )


def _names(labels: Mapping[str, Any], n: int, m: int) -> list[str]:
    states = labels.get("state_names") or [f"x{i + 1}" for i in range(n)]
    inputs = labels.get("input_names") or [f"u{i + 1}" for i in range(m)]
    return [*states, *inputs]


def _column(value: ArrayLike, name: str) -> Array:
    array = np.asarray(value, dtype=np.float64)
    if array.ndim != 1:
        raise ValueError(f"{name} has shape {array.shape}; expected (N,)")
    return array


def _rows(value: ArrayLike, name: str, size: int) -> Array:
    array = np.asarray(value, dtype=np.float64)
    array = array[:, None] if array.ndim == 1 else array
    if array.ndim != 2 or len(array) != size:
        raise ValueError(f"{name} has shape {array.shape}; expected ({size}, columns), one row a time")
    return array
