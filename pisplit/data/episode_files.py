"""Episodes in HDF5 files: all arrays of one kind in one data set, with the lengths of the episodes beside it."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from pisplit.checks import finite_array
from pisplit.data import store
from pisplit.data.rows import Rows

KIND = "pisplit/episodes"
LABELS = ("state_names", "input_names", "quantities", "units", "input_units")


def write(path: str | os.PathLike[str], fields: Mapping[str, Any]) -> None:
    """Write the ``fields`` of :class:`pisplit.Episodes` (by name) to the file ``path``, whole or not at all."""
    with store.writing(path, KIND) as file:
        _write_ragged(file, "x", fields["xs"])
        _write_ragged(file, "u", fields["us"])
        extra = file.create_group("extra", track_order=True)
        for name, arrays in fields["extra"].items():
            _write_ragged(extra, store.as_key(name), arrays)
        file.attrs["dt"] = fields["dt"]
        for name in LABELS:
            store.write_strings(file, name, fields[name])
        store.write_json(file, "outputs", fields["outputs"])
        store.write_json(file, "provenance", fields["provenance"])


def read(path: str | os.PathLike[str]) -> dict[str, Any]:
    """The fields of :class:`pisplit.Episodes` (by name) in the file ``path``.

    Raises one line for files that are missing, damaged, foreign or of another kind.
    """
    with store.reading(path, KIND) as file:
        more = file.get("extra", {})
        return {
            "xs": _read_rows(file, "x"),
            "us": _read_rows(file, "u"),
            "dt": float(file.attrs["dt"]),
            "outputs": store.read_json(file, "outputs"),
            "extra": {store.from_key(key): _read_ragged(more, key) for key in more},
            "provenance": store.read_json(file, "provenance"),
            **{name: store.read_strings(file, name) for name in LABELS if name in file},
        }


def _write_ragged(group: h5py.Group, name: str, arrays: Sequence[NDArray[Any]]) -> None:
    rows = {(a.dtype if a.dtype.kind != "U" else "text", a.shape[1:]) for a in arrays}
    if len(rows) > 1 or any(a.ndim == 0 for a in arrays):
        raise ValueError(f"arrays of {name} differ in type or shape of their rows; a file holds rows of one kind")
    values = arrays.stacked if isinstance(arrays, Rows) else np.concatenate(list(arrays))
    store.write_arrays(group.create_group(name), {"lengths": np.array([len(a) for a in arrays]), "values": values})


def _read_ragged(group: h5py.Group, name: str) -> list[NDArray[Any]]:
    part = store.read_arrays(group[name])
    return np.split(part["values"], np.cumsum(part["lengths"])[:-1])


def _read_rows(group: h5py.Group, name: str) -> Rows:
    part = store.read_arrays(group[name])
    values = finite_array(part["values"], f"{name} of the file", (None, None))
    values.setflags(write=False)  # nobody else holds it: it need not be copied
    return Rows(values, part["lengths"].tolist())
