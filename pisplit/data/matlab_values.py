"""Values of MATLAB files of all versions: arrays, dictionaries (structures, tables), lists (cells, many structures)."""

from __future__ import annotations

import io
import warnings
import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from pisplit.data.matlab_objects import NotRead, Objects, Variables, is_reference
from pisplit.data.text import OTHERS

#: What only MATLAB reads, or what could not be read, and what makes of it there, under the name {0}, what anyone reads.
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
#: Bytes of the header of a file of version 5, where scipy puts the part with objects, and its name for those.
HEADER, SUBSYSTEM, HIDDEN = 124, "__function_workspace__", "None"
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

    asked = [*wanted, HIDDEN, SUBSYSTEM]
    with source.open("rb") as file, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of several objects, which all have the name None
        try:
            content: Mapping[str, Any] = loadmat(file, variable_names=asked, simplify_cells=True)
        except (*DAMAGE, MatReadError):
            raise ValueError(f"{source} {_fault(start, source.stat().st_size)}") from None
    hidden = content.get(HIDDEN)  # where scipy puts objects, which say their name and class themselves
    found = {name: content[name] for name in wanted if name in content and not (name == HIDDEN and hidden is not None)}
    if isinstance(hidden, MatlabOpaque) and len(found) < len(wanted):
        found |= _objects_5(source, [name for name in wanted if name not in found], content.get(SUBSYSTEM))
    for name, value in found.items():
        if isinstance(value, MatlabOpaque) or (getattr(value, "dtype", None) is not None and value.dtype.names):
            raise unread(name, source)
    return {name: _plain(value) for name, value in found.items()}


def _objects_5(source: Path, wanted: Sequence[str], part: Any) -> dict[str, Any]:
    """Those ``wanted`` variables of a file of version 5 that are objects; ``part`` is the one with properties."""
    from scipy.io import loadmat
    from scipy.io.matlab import varmats_from_mat

    objects, found = _subsystem_5(part), {}
    with source.open("rb") as file:
        for _, stream in varmats_from_mat(file):
            hidden = loadmat(stream).get(HIDDEN)
            if hidden is None:
                continue
            name, kind = _text(hidden[0]["s0"]), _text(hidden[0]["s2"])
            if name in wanted:
                found[name] = _understood(objects, hidden[0]["arr"], name, source, kind)
    return found


def _subsystem_5(part: Any) -> Objects | None:
    """The objects of a file of version 5, whose properties are in a file within the file; None where there are none."""
    from scipy.io import loadmat

    if not isinstance(part, np.ndarray) or part.dtype != np.uint8 or part.size < 16:
        return None
    raw = part.tobytes()
    order = "little" if raw[2:4] == b"IM" else "big"
    inner = b"MATLAB 5.0 MAT-file".ljust(HEADER) + raw[:4] + raw[8 : 16 + int.from_bytes(raw[12:16], order)]  # type: ignore[arg-type]
    try:
        cells = loadmat(io.BytesIO(inner))[SUBSYSTEM][0, 0]["MCOS"][0]["arr"].ravel(order="F")
        metadata = cells[0].tobytes()
    except (*DAMAGE, AttributeError):
        return None
    return Objects(metadata, "<" if order == "little" else ">", lambda k: _of_5(cells[k]), len(cells))


def _of_5(value: Any) -> Any:
    """What scipy reads of version 5 as arrays, texts, lists (cells), dictionaries (structures)."""
    if not isinstance(value, np.ndarray):
        return value
    if value.dtype.names:
        many = [{name: _of_5(one[name]) for name in value.dtype.names} for one in value.ravel(order="F")]
        return many[0] if len(many) == 1 else many
    if value.dtype.kind == "O":
        return [_of_5(part) for part in value.ravel(order="F")]
    if value.dtype.kind == "U":
        return "".join(value.ravel().tolist())
    return value if is_reference(value) else np.squeeze(value)


def _understood(objects: Objects | None, reference: Any, name: str, source: Path, kind: str) -> Any:
    """The object that a ``reference`` stands for; the refusal says what to do in MATLAB where it is not read."""
    try:
        if objects is not None:
            return objects.value(reference)
    except (NotRead, *DAMAGE):
        pass
    raise unread(name, source, kind)


def unread(name: str, source: Path, kind: str = "object") -> ValueError:
    """What is said of the variable ``name`` of ``source``, an object of a ``kind`` that could not be read."""
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
    if isinstance(value, dict) and not isinstance(value, Variables):
        return {name: _plain(part) for name, part in value.items()}
    return [_plain(part) for part in value] if isinstance(value, list) else value


def _from_hdf5(source: Path, wanted: Sequence[str]) -> dict[str, Any]:
    """Variables of version 7.3, whose arrays stand in the file with their axes reversed."""
    try:
        with h5py.File(source, "r") as file:
            return {name: _value(file[name], file, name, source) for name in wanted if name in file}
    except (OSError, RuntimeError, KeyError):
        raise ValueError(f"{source} is damaged, or no MATLAB file; save it again") from None


def _value(node: Any, file: h5py.File, name: str, source: Path, inside: bool = False) -> Any:
    """The variable ``node``; where it is ``inside`` an object, references to other objects are left as they are."""
    kind = node.attrs.get("MATLAB_class", b"")
    kind = kind.decode() if isinstance(kind, bytes) else str(kind)
    if kind in OBJECTS or "MATLAB_object_decode" in node.attrs:
        reference = np.asarray(node[()]) if isinstance(node, h5py.Dataset) else None
        return (
            reference if inside else _understood(_subsystem_7(file, source), reference, name, source, kind or "object")
        )
    if isinstance(node, h5py.Group):
        fields = {key: _value(node[key], file, f"{name}.{key}", source, inside) for key in node}
        apart = [v for key, v in fields.items() if _is_field_of_many(node[key])]
        if fields and len(apart) == len(fields):  # an array of structures: every field is a list
            return [dict(zip(fields, parts, strict=True)) for parts in zip(*fields.values(), strict=True)]
        return fields
    if node.attrs.get("MATLAB_empty", 0):
        return np.zeros((0, 0))
    if h5py.check_ref_dtype(node.dtype) is not None:
        return [
            _value(file[ref], file, name, source, inside) for ref in np.asarray(node[()]).T.ravel(order="F").tolist()
        ]
    if kind == "char":
        return "".join(map(chr, np.asarray(node[()]).ravel(order="F").tolist()))
    found = np.asarray(node[()]).T
    if found.dtype.names == ("real", "imag"):
        found = found["real"] + 1j * found["imag"]
    return np.squeeze(found)


def _subsystem_7(file: h5py.File, source: Path) -> Objects | None:
    """The objects of a ``file`` of version 7.3; None where it has none."""
    part = file.get("#subsystem#/MCOS")
    if not isinstance(part, h5py.Dataset) or h5py.check_ref_dtype(part.dtype) is None:
        return None
    cells = np.asarray(part[()]).ravel()
    metadata = np.asarray(file[cells[0]][()]).tobytes()
    return Objects(metadata, "<", lambda k: _value(file[cells[k]], file, "", source, True), len(cells))


def _is_field_of_many(node: Any) -> bool:
    return (
        isinstance(node, h5py.Dataset)
        and h5py.check_ref_dtype(node.dtype) is not None
        and "MATLAB_class" not in node.attrs
    )
