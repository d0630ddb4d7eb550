"""Tables and timetables of MATLAB files of both formats: every number, time and unit, or one line.

No MATLAB is here: files are laid out as it lays them out, objects in a part of their own, linked by numbers.
"""

from __future__ import annotations

import io
import struct
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from scipy.io import savemat

from pisplit import Episodes

Properties = dict[str, Any]
#: An object: its class, its properties, and whether a method of its own saves it.
Object = tuple[str, Properties, bool]

N = 60
T = 0.02 * np.arange(N)
X, U = np.sin(3.0 * T), np.cos(3.0 * T)
PAIR = np.column_stack([X, 2.0 * X])


def reference(number: int, kind: int) -> np.ndarray:
    return np.array([[0xDD000000], [2], [1], [1], [number], [kind]], dtype=np.uint32)


def linked(objects: Sequence[Object], cells: list[Any]) -> tuple[bytes, list[str]]:
    """The numbers that link names, classes, objects and cells; values of properties go to ``cells``."""
    kinds = list(dict.fromkeys(kind for kind, _, _ in objects))
    names = list(dict.fromkeys([*kinds, *(name for _, values, _ in objects for name in values)]))
    classes = [0, 0, 0, 0] + [w for kind in kinds for w in (0, 1 + names.index(kind), 0, 0)]
    blocks: tuple[list[int], list[int]] = ([0, 0], [0, 0])
    numbers, rows = [0, 0], [0] * 6
    for kind, values, saved in objects:
        which = 0 if saved else 1
        numbers[which] += 1
        block = [len(values)]
        for name, value in values.items():
            block += [1 + names.index(name), 1, len(cells) - 2]
            cells.append(value)
        blocks[which].extend(block + [0] * (len(block) % 2))
        rows += [1 + kinds.index(kind), 0, 0, numbers[0] if saved else 0, 0 if saved else numbers[1], 0]
    text = b"".join(name.encode() + b"\0" for name in names)
    text += b"\0" * (-len(text) % 8)
    regions, at, offsets = [classes, blocks[0], rows, blocks[1]], 40 + len(text), []
    for region in regions:
        offsets.append(at)
        at += 4 * len(region)
    head = struct.pack("<10I", 4, len(names), *offsets, at, at, at, at)
    return head + text + b"".join(struct.pack(f"<{len(r)}I", *r) for r in regions), kinds


def element(kind: int, content: bytes) -> bytes:
    """An element of a MATLAB 5 file: tag, content, zeros to the next multiple of eight."""
    return struct.pack("<II", kind, len(content)) + content + b"\0" * (-len(content) % 8)


def matrix(value: Any) -> bytes:
    """A matrix, cell or structure as an element, as scipy writes it."""
    made = io.BytesIO()
    savemat(made, {"v": value})
    return made.getvalue()[128:]


def opaque(name: str, kind: str, content: bytes) -> bytes:
    words = b"".join(element(1, word.encode()) for word in (name, "MCOS", kind))
    return element(14, element(6, struct.pack("<II", 17, 0)) + words + content)


def cell(parts: Sequence[Any]) -> np.ndarray:
    found = np.empty((len(parts), 1), dtype=object)
    for k, part in enumerate(parts):
        found[k, 0] = cell(part) if isinstance(part, list) else part
    return found


def version_5(path: Path, objects: Sequence[Object], variables: dict[str, int]) -> None:
    cells: list[Any] = [None, np.zeros((0, 0))]
    metadata, kinds = linked(objects, cells)
    cells[0] = np.frombuffer(metadata, np.uint8)[:, None]
    whole = [_plain(c) for c in [*cells, [], [], [np.zeros((0, 0))] * (len(kinds) + 1)]]
    wrapper = opaque("", "FileWrapper__", matrix(cell(whole)))
    shape = element(6, struct.pack("<II", 2, 0)) + element(5, struct.pack("<ii", 1, 1)) + element(1, b"")
    inside = element(14, shape + struct.pack("<HHI", 5, 4, 8) + element(1, b"MCOS\0\0\0\0") + wrapper)
    raw = b"\0\1IM\0\0\0\0" + inside
    hidden = element(6, struct.pack("<II", 9, 0)) + element(5, struct.pack("<ii", 1, len(raw))) + element(1, b"")
    with path.open("wb") as file:
        savemat(file, {"plain": U})
        for name, number in variables.items():
            kind = objects[number - 1][0]
            file.write(opaque(name, kind, matrix(reference(number, 1 + kinds.index(kind)))))
        file.write(element(14, hidden + element(2, raw)))


def _plain(value: Any) -> Any:
    """Lists as cells, dictionaries with those in them as structures."""
    if isinstance(value, list):
        return cell([_plain(v) for v in value])
    return {k: _plain(v) for k, v in value.items()} if isinstance(value, dict) else value


def version_7(path: Path, objects: Sequence[Object], variables: dict[str, int]) -> None:
    cells: list[Any] = [None, np.zeros((0, 0))]
    metadata, kinds = linked(objects, cells)
    cells[0] = np.frombuffer(metadata, np.uint8)[:, None]
    with h5py.File(path, "w", userblock_size=512) as file:

        def put(place: str, value: Any) -> h5py.Reference:
            if isinstance(value, dict):
                group = file.create_group(place)
                for key, part in value.items():
                    put(f"{place}/{key}", part)
                group.attrs["MATLAB_class"] = np.bytes_("struct")
                return group.ref
            if isinstance(value, list):
                refs = [put(f"#refs#/{len(file['#refs#'])}", part) for part in value]
                made = file.create_dataset(place, data=np.array(refs, dtype=h5py.ref_dtype).reshape(-1, 1))
                made.attrs["MATLAB_class"] = np.bytes_("cell")
                return made.ref
            if isinstance(value, str):
                made = file.create_dataset(place, data=np.array([[ord(c)] for c in value], dtype=np.uint16))
                made.attrs["MATLAB_class"] = np.bytes_("char")
                return made.ref
            array = np.atleast_2d(np.asarray(value))
            if np.iscomplexobj(array):
                pairs = np.empty(array.shape, dtype=[("real", "f8"), ("imag", "f8")])
                pairs["real"], pairs["imag"] = array.real, array.imag
                array = pairs
            made = file.create_dataset(place, data=array.T)
            made.attrs["MATLAB_class"] = np.bytes_("uint32" if array.dtype == np.uint32 else "double")
            if array.dtype == np.uint32:
                made.attrs["MATLAB_object_decode"] = 3
            return made.ref

        file.create_group("#refs#")
        put("plain", U[:, None])
        refs = [put(f"#refs#/c{k}", c) for k, c in enumerate([*cells, np.zeros((0, 0)), np.zeros((0, 0)), [0.0]])]
        wrapper = file.create_dataset("#subsystem#/MCOS", data=np.array([refs], dtype=h5py.ref_dtype))
        wrapper.attrs["MATLAB_class"], wrapper.attrs["MATLAB_object_decode"] = np.bytes_("FileWrapper__"), 3
        for name, number in variables.items():
            kind = objects[number - 1][0]
            made = file.create_dataset(name, data=reference(number, 1 + kinds.index(kind)).T)
            made.attrs["MATLAB_class"], made.attrs["MATLAB_object_decode"] = np.bytes_(kind), 3


WRITERS = {"5": version_5, "7.3": version_7}
written = pytest.mark.parametrize("version", WRITERS)


def timetable(rows: Any, data: dict[str, Any], units: list[str] | None = None) -> Object:
    inside = {
        "data": [np.asarray(v).reshape(N, -1) if not _is_reference(v) else v for v in data.values()],
        "dimNames": ["Time", "Variables"],
        "varNames": list(data),
        "numRows": np.array([[float(N)]]),
        "rowTimes": rows,
        "varUnits": units or [],
    }
    return "timetable", {"any": inside}, True


def _is_reference(value: Any) -> bool:
    return isinstance(value, np.ndarray) and value.dtype == np.uint32


def rate(hz: float, origin: Any) -> dict[str, Any]:
    return {
        "origin": origin,
        "specifiedAsRate": np.array([[1.0]]),
        "sampleRate": np.array([[hz]]),
        "stepSize": np.array([[np.nan]]),
    }


@written
def test_a_timetable_gives_its_numbers_times_and_units(tmp_path: Path, version: str) -> None:
    durations: Object = ("duration", {"millis": 1e3 * T[:, None], "fmt": "s"}, False)
    table = timetable(reference(1, 1), {"x": 1e3 * PAIR, "u": U}, ["mm", ""])
    path = tmp_path / "run.mat"
    WRITERS[version](path, [durations, table], {"log": 2})
    found = Episodes.from_mat(path, "log.Time", ["log.x"], ["log.u"])
    assert found.state_names == ("x1", "x2") and found.dt == pytest.approx(0.02) and found.units == ("m", "m")
    np.testing.assert_allclose(found.xs[0], PAIR, atol=1e-12)
    np.testing.assert_allclose(found.us[0][:, 0], U[:-1], atol=1e-12)


@written
def test_dates_keep_their_microseconds_and_rates_make_times(tmp_path: Path, version: str) -> None:
    fine = 0.0002 * np.arange(N)  # faster than a millisecond
    dates: Object = ("datetime", {"data": (1.7e12 + 1e3 * fine + 0j)[:, None], "tz": ""}, False)
    start: Object = ("duration", {"millis": np.array([[500.0]])}, False)
    objects = [dates, start, timetable(reference(1, 1), {"x": X}), timetable(rate(50.0, reference(2, 2)), {"x": X})]
    path = tmp_path / "run.mat"
    WRITERS[version](path, objects, {"dated": 3, "even": 4})
    for name, dt in (("dated", 0.0002), ("even", 0.02)):
        found = Episodes.from_mat(path, f"{name}.Time", f"{name}.x", [])
        assert found.dt == pytest.approx(dt, rel=1e-3)
        np.testing.assert_allclose(found.xs[0][:, 0], X, atol=2e-3 if name == "dated" else 1e-9)


@written
def test_a_table_beside_plain_variables_and_times_of_their_own(tmp_path: Path, version: str) -> None:
    times: Object = ("duration", {"millis": 1e3 * T[:, None]}, False)
    props = {"VariableUnits": ["deg", ""]}
    table: Object = (
        "table",
        {"data": [np.rad2deg(X)[:, None], reference(3, 3)], "varnames": ["angle", "label"], "props": props},
        False,
    )
    text: Object = ("string", {"any": np.array([[1.0]])}, True)
    path = tmp_path / "run.mat"
    WRITERS[version](path, [times, table, text], {"t": 1, "log": 2})
    found = Episodes.from_mat(path, "t", "log.angle", "plain")
    np.testing.assert_allclose(found.xs[0][:, 0], X, atol=1e-12)  # rad
    np.testing.assert_allclose(found.us[0][:, 0], U[:-1], atol=1e-12)
    for ask, said in (
        ("log", "'log' in .* is a structure; name a field: 'log.angle', 'log.label'"),
        ("log.label", "is a string, which only MATLAB reads"),
        ("log.none", "has no field 'none' in log; it has angle, label"),
    ):
        with pytest.raises(ValueError, match=said) as error:
            Episodes.from_mat(path, "t", ask, [])
        assert "\n" not in str(error.value)


@written
def test_objects_of_other_classes_and_damage_are_one_line(tmp_path: Path, version: str) -> None:
    durations: Object = ("duration", {"millis": 1e3 * T[:, None]}, False)
    months: Object = ("calendarDuration", {"components": np.array([[1.0]])}, False)
    objects = [durations, months, timetable(reference(2, 2), {"x": X}), ("Robot", {"q": X[:, None]}, False)]
    path = tmp_path / "run.mat"
    WRITERS[version](path, objects, {"t": 1, "monthly": 3, "robot": 4})
    for name, kind in (("monthly.x", "timetable"), ("robot", "Robot")):
        with pytest.raises(ValueError, match=f"is a {kind}, which only MATLAB reads: there ") as error:
            Episodes.from_mat(path, "t", name, [])
        assert "\n" not in str(error.value)
    raw = path.read_bytes()
    place = raw.index(b"duration\0")  # names, behind the offsets of what they are for
    for offset in range(place - 40, place, 8):
        path.write_bytes(raw[:offset] + b"\xff\xff\xff\x7f" + raw[offset + 4 :])
        try:
            found = Episodes.from_mat(path, "t", "plain", [])
        except ValueError as error:
            assert "\n" not in str(error)
        else:
            np.testing.assert_allclose(found.xs[0][:, 0], U, atol=1e-12)
