"""Values of MATLAB files of all versions: arrays, dictionaries (structures), lists (cells, arrays of structures)."""

from __future__ import annotations

import warnings
import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from pisplit.data.text import OTHERS

#: What only MATLAB reads, and what makes of it there, under the name {0}, what anyone reads.
OBJECTS = {
    "table": "S = table2struct({0}, 'ToScalar', true); save('run.mat', '-struct', 'S'), or writetable({0}, 'run.csv')",
    "timetable": "S = table2struct(timetable2table({0}, 'ConvertRowTimes', false), 'ToScalar', true); "
    "S.t = seconds({0}.Properties.RowTimes - {0}.Properties.RowTimes(1)); save('run.mat', '-struct', 'S'), "
    "or writetimetable({0}, 'run.csv')",
    "datetime": "t = seconds({0} - {0}(1)); save t",
    "duration": "t = seconds({0}); save t",
    "timeseries": "t = {0}.Time; x = {0}.Data; save t and x",
    "string": "c = cellstr({0}); save c",
    "containers.Map": "c = values({0}); save c",
}
OTHER = "save its numbers as matrices, or a table as CSV by writetable or writetimetable"
HDF5_FROM = 512
#: What scipy raises for damaged files.
DAMAGE = (
    ValueError,
    NotImplementedError,
    TypeError,
    OSError,
    IndexError,
    KeyError,
    EOFError,
    OverflowError,
    zlib.error,
)
#: Numbers of types in the first word of a file of version 4 are at most this.
VERSION_4 = 4052


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

    with source.open("rb") as file, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of several objects, which all have the name None
        try:
            content: Mapping[str, Any] = loadmat(file, variable_names=[*wanted, "None"], simplify_cells=True)
        except (*DAMAGE, MatReadError):
            raise ValueError(f"{source} {_fault(start, source.stat().st_size)}") from None
    hidden = content.get("None")  # where scipy puts objects, which say their name and class themselves
    found = {name: content[name] for name in wanted if name in content}
    if isinstance(hidden, MatlabOpaque) and (len(found) < len(wanted) or "None" in wanted):
        name, _, kind = (_text(hidden[0][key]) for key in ("s0", "s1", "s2"))
        raise _object(name if name in wanted else next(n for n in wanted if n not in content), source, kind)
    for name, value in found.items():
        if isinstance(value, MatlabOpaque) or (getattr(value, "dtype", None) is not None and value.dtype.names):
            raise _object(name, source)
    return {name: _plain(value) for name, value in found.items()}


def _object(name: str, source: Path, kind: str = "object") -> ValueError:
    what = OBJECTS.get(kind, OTHER).format(name)
    return ValueError(f"{name!r} in {source} is a {kind}, which only MATLAB reads: there {what}")


def _text(value: Any) -> str:
    return value.decode() if isinstance(value, bytes) else str(value)


def _fault(start: bytes, size: int) -> str:
    """What is wrong with a file of ``size`` bytes that begins with ``start`` and that scipy does not read."""
    if size == 0:
        return "is empty"
    if start.startswith(b"MATLAB"):
        return "is a MATLAB file that is damaged or was cut short; copy it again, or save it again with '-v7'"
    for beginning, what in OTHERS.items():
        if start.startswith(beginning):
            return f"is no MATLAB file but {what}"
    if start.startswith(b"\x93NUMPY"):
        return "is no MATLAB file but one of NumPy; give np.load's arrays to Episodes.from_arrays"
    if start.isascii() and start.replace(b"\r", b"").replace(b"\n", b"").replace(b"\t", b"").decode().isprintable():
        return "is no MATLAB file but text; read a table by Episodes.from_csv"
    if len(start) >= 20 and any(0 <= int.from_bytes(start[:4], end) <= VERSION_4 for end in ("little", "big")):
        return "is a damaged MATLAB file of version 4, or none; save it again with '-v7'"
    return "is no MATLAB file; save it with '-v7'"


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
