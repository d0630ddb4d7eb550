"""Values of MATLAB files of all versions: arrays, dictionaries (structures), lists (cells, arrays of structures)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import h5py
import numpy as np

#: What only MATLAB reads.
OBJECTS = ("table", "timetable", "datetime", "duration", "timeseries", "string", "containers.Map")
HDF5_FROM = 512


def load(source: Path, wanted: Sequence[str]) -> dict[str, Any]:
    """The variables ``wanted`` of the MATLAB file ``source`` that are there.

    Raises FileNotFoundError if it is missing, and ValueError for files of another format, and for objects in it.
    """
    if not source.is_file():
        raise FileNotFoundError(f"{source} does not exist; expected a MATLAB file")
    with source.open("rb") as file:  # what cannot be opened says so itself
        start = file.read(HDF5_FROM + 8)
    if start[HDF5_FROM:] == b"\x89HDF\r\n\x1a\n" or start.startswith(b"\x89HDF"):
        return _from_hdf5(source, wanted)
    from scipy.io import loadmat
    from scipy.io.matlab import MatlabOpaque, MatReadError

    with source.open("rb") as file:
        try:
            content: Mapping[str, Any] = loadmat(file, variable_names=list(wanted), simplify_cells=True)
        except (MatReadError, ValueError, NotImplementedError, TypeError, OSError):  # scipy's, for damage
            raise ValueError(f"{source} is no MATLAB file; save it with '-v7'") from None
    found = {name: content[name] for name in wanted if name in content}
    for name, value in found.items():
        if isinstance(value, MatlabOpaque) or (getattr(value, "dtype", None) is not None and value.dtype.names):
            raise _object(name, source)
    return {name: _plain(value) for name, value in found.items()}


def _object(name: str, source: Path, kind: str = "table or another object") -> ValueError:
    return ValueError(
        f"{name!r} in {source} is a {kind}, which only MATLAB reads: save its columns as matrices, or as CSV by "
        f"writetimetable"
    )


def _plain(value: Any) -> Any:
    """Cells and arrays of structures as lists."""
    if isinstance(value, np.ndarray) and value.dtype.kind == "O":
        return [_plain(part) for part in value.ravel(order="F").tolist()]
    if isinstance(value, dict):
        return {name: _plain(part) for name, part in value.items()}
    return [_plain(part) for part in value] if isinstance(value, list) else value


def _from_hdf5(source: Path, wanted: Sequence[str]) -> dict[str, Any]:
    """Variables of version 7.3, whose arrays stand in the file with their axes reversed."""
    try:
        with h5py.File(source, "r") as file:
            return {name: _value(file[name], file, name, source) for name in wanted if name in file}
    except (OSError, RuntimeError, KeyError):
        raise ValueError(f"{source} is damaged, or no MATLAB file; save it again") from None


def _value(node: Any, file: h5py.File, name: str, source: Path) -> Any:
    kind = node.attrs.get("MATLAB_class", b"")
    kind = kind.decode() if isinstance(kind, bytes) else str(kind)
    if kind in OBJECTS or "MATLAB_object_decode" in node.attrs:
        raise _object(name, source, kind or "object")
    if isinstance(node, h5py.Group):
        fields = {key: _value(node[key], file, f"{name}.{key}", source) for key in node}
        apart = [v for key, v in fields.items() if _is_field_of_many(node[key])]
        if fields and len(apart) == len(fields):  # an array of structures: every field is a list
            return [dict(zip(fields, parts, strict=True)) for parts in zip(*fields.values(), strict=True)]
        return fields
    if node.attrs.get("MATLAB_empty", 0):
        return np.zeros((0, 0))
    if h5py.check_ref_dtype(node.dtype) is not None:
        return [_value(file[ref], file, name, source) for ref in np.asarray(node[()]).T.ravel(order="F").tolist()]
    if kind == "char":
        return "".join(map(chr, np.asarray(node[()]).ravel(order="F").tolist()))
    return np.squeeze(np.asarray(node[()]).T)


def _is_field_of_many(node: Any) -> bool:
    return (
        isinstance(node, h5py.Dataset)
        and h5py.check_ref_dtype(node.dtype) is not None
        and "MATLAB_class" not in node.attrs
    )
