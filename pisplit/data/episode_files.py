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
from pisplit.data.mapped import mapped as mapped_array
from pisplit.data.rows import Rows

KIND = "pisplit/episodes"
#: Bytes that are copied at once where files are joined.
CHUNK_BYTES = 1 << 24
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


def read(path: str | os.PathLike[str], mapped: bool = False) -> dict[str, Any]:
    """The fields of :class:`pisplit.Episodes` (by name) in the file ``path``.

    States and inputs stay there if ``mapped``. Raises one line for files that are missing, damaged, foreign or of
    another kind.
    """
    with store.reading(path, KIND) as file:
        more = file.get("extra", {})
        rows = (lambda name: _mapped_rows(path, file, name)) if mapped else (lambda name: _read_rows(file, name))
        return {
            "xs": rows("x"),
            "us": rows("u"),
            "dt": float(file.attrs["dt"]),
            "outputs": store.read_json(file, "outputs"),
            "extra": {store.from_key(key): _read_ragged(more, key) for key in more},
            "provenance": store.read_json(file, "provenance"),
            **{name: store.read_strings(file, name) for name in LABELS if name in file},
        }


def join(paths: Sequence[str | os.PathLike[str]], path: str | os.PathLike[str]) -> None:
    """Write the episodes of the files ``paths`` to one file ``path``, a chunk of rows at a time.

    Raises ValueError if there is no file, or if they differ in anything but their rows and provenance.
    """
    heads = [_head(other) for other in paths]
    if not heads:
        raise ValueError("paths is empty; give the files to join")
    for other, head in zip(paths, heads, strict=True):
        for name, value in head["same"].items():
            if value != heads[0]["same"][name]:
                raise ValueError(
                    f"{os.fspath(other)} has {name} = {str(value)[:80]}, {os.fspath(paths[0])} "
                    f"{str(heads[0]['same'][name])[:80]}; join files of one kind"
                )
    with store.writing(path, KIND) as file:
        file.create_group("extra", track_order=True)
        for name in heads[0]["same"]["arrays"]:
            group = file.create_group(name)
            group["lengths"] = np.concatenate([head["lengths"][name] for head in heads])
        begins = dict.fromkeys(heads[0]["same"]["arrays"], 0)
        for other in paths:
            with store.reading(other, KIND) as source:
                for name in begins:
                    begins[name] = _append(file[name], source[name]["values"], begins[name])
        file.attrs["dt"] = heads[0]["same"]["dt"]
        for name in LABELS:
            store.write_strings(file, name, heads[0]["same"][name])
        store.write_json(file, "outputs", heads[0]["same"]["outputs"])
        store.write_json(file, "provenance", {"joined": [head["provenance"] for head in heads]})


def _head(path: str | os.PathLike[str]) -> dict[str, Any]:
    """What the file ``path`` says beside its rows: what all must have the "same", "lengths" by array, provenance."""
    with store.reading(path, KIND) as file:
        extra = [f"extra/{key}" for key in file.get("extra", {})]
        arrays = {name: (file[name]["values"].dtype, file[name]["values"].shape[1:]) for name in ("x", "u", *extra)}
        same = {"arrays": arrays, "dt": float(file.attrs["dt"]), "outputs": store.read_json(file, "outputs")}
        same |= {name: store.read_strings(file, name) if name in file else () for name in LABELS}
        lengths = {name: np.asarray(file[name]["lengths"][()]) for name in arrays}
        return {"same": same, "lengths": lengths, "provenance": store.read_json(file, "provenance")}


def _append(group: h5py.Group, values: h5py.Dataset, begin: int) -> int:
    """Write ``values`` from row ``begin`` on into those of ``group``; where they end."""
    if "values" not in group:
        group.create_dataset("values", (int(group["lengths"][()].sum()), *values.shape[1:]), values.dtype)
    step = max(1, CHUNK_BYTES // (8 * max(int(np.prod(values.shape[1:])), 1)))
    for first in range(0, len(values), step):
        part = values[first : first + step]
        group["values"][begin + first : begin + first + len(part)] = part
    return begin + len(values)


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


def _mapped_rows(path: str | os.PathLike[str], file: h5py.File, name: str) -> Rows:
    values, lengths = file[name]["values"], file[name]["lengths"][()].tolist()
    offset = values.id.get_offset()
    if values.dtype != np.float64 or offset is None or values.ndim != 2:  # of other programs, or no rows
        return _read_rows(file, name)
    return Rows(mapped_array(path, offset, values.shape, f"{name} of the file"), lengths)
