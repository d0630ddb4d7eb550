"""Recordings in MATLAB files."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pisplit.checks import real_array
from pisplit.data.joining import Table, from_columns

Array = NDArray[np.float64]


def from_mat(
    path: str | os.PathLike[str],
    time: str,
    states: str | Sequence[str],
    inputs: str | Sequence[str],
    episode: str | None = None,
    **options: Any,
) -> dict[str, Any]:
    """Fields of :class:`pisplit.Episodes`, by name, of a MATLAB file (up to version 7.2).

    path            file
    time            name of the variable of times, a vector of N
    states, inputs  names of variables, each (N,), (N, k) or (k, N); columns of a matrix ``q`` are named q1, q2, ...;
                    no inputs: []
    episode         name of a variable, a vector of N numbers of runs, for clocks that restart
    options         as in :func:`pisplit.data.recordings.from_arrays`

    Raises FileNotFoundError, PermissionError, and ValueError for missing variables, those that hold no real numbers,
    and files of another format.
    """
    source = Path(path)
    groups = [[names] if isinstance(names, str) else list(names) for names in (states, inputs)]
    content = _loaded(source, [time, *groups[0], *groups[1], *([] if episode is None else [episode])])
    columns: dict[str, Array] = {}
    size = np.size(content[time])
    labelled: list[list[str]] = []
    for group in groups:
        found: list[str] = []
        for name in group:
            value = real_array(content[name], f"{name!r} in {source}")
            value = value.T if value.shape[0] != size and value.shape[-1] == size else value
            if value.ndim != 2 or len(value) != size:
                raise ValueError(f"{name!r} in {source} has shape {value.shape}; expected {size} rows, one a time")
            names = [name] if value.shape[1] == 1 else [f"{name}{i + 1}" for i in range(value.shape[1])]
            columns |= dict(zip(names, value.T, strict=True))
            found += names
        labelled.append(found)
    if not labelled[0]:
        raise ValueError("states names no variables; give at least one")
    if episode is not None:
        options["episode"] = np.ravel(content[episode])
    found_table = Table(source.name, columns, {}, np.ravel(content[time]), None, None)
    return from_columns([found_table], labelled[0], labelled[1], options)


def _loaded(source: Path, wanted: Sequence[str]) -> Mapping[str, Any]:
    """The variables of these names."""
    from scipy.io import loadmat
    from scipy.io.matlab import MatReadError

    if not source.is_file():
        raise FileNotFoundError(f"{source} does not exist; expected a MATLAB file")
    with source.open("rb") as file:  # what cannot be opened says so itself
        try:
            content: Mapping[str, Any] = loadmat(file, variable_names=list(wanted))
        except (MatReadError, ValueError, NotImplementedError, TypeError, OSError):  # scipy's, for v7.3 and damage
            raise ValueError(f"{source} is no MATLAB file up to version 7.2; save it with '-v7'") from None
    missing = [name for name in wanted if name not in content]
    if missing:
        raise ValueError(f"{source} has no variable {missing[0]!r}; give names of its variables")
    return content
