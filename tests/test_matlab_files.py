"""MATLAB files of all versions: matrices, structures, cells, arrays of structures, as they were recorded."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.io import savemat

from pisplit import Episodes

Array = NDArray[np.float64]

T = 0.01 * np.arange(60)
X = np.column_stack([np.sin(5.0 * T), np.cos(3.0 * T), T])
U = np.sin(7.0 * T)
RUNS = [slice(0, 25), slice(25, 60)]


def cells(*parts: Any) -> NDArray[Any]:
    """A cell array (1, k) as scipy writes it."""
    found = np.empty((1, len(parts)), dtype=object)
    for k, part in enumerate(parts):
        found[0, k] = part
    return found


def column(values: Array) -> Array:
    return values[:, None]


def save_73(path: Path, content: dict[str, Any]) -> None:
    """Write as MATLAB 7.3 does: reversed axes, classes as attributes, cells and arrays of structures by references."""
    with h5py.File(path, "w", userblock_size=512) as file:
        hidden = file.create_group("#refs#")

        def put(where: h5py.Group, name: str, value: Any, field: bool = False) -> h5py.Dataset | h5py.Group:
            if isinstance(value, dict):
                group = where.create_group(name)
                group.attrs["MATLAB_class"] = np.bytes_("struct")
                for key, part in value.items():
                    put(group, key, part)
                return group
            if isinstance(value, list) and isinstance(value[0], dict):
                group = where.create_group(name)
                group.attrs["MATLAB_class"] = np.bytes_("struct")
                for key in value[0]:
                    put(group, key, [part[key] for part in value], field=True)
                return group
            if isinstance(value, list):
                refs = [put(hidden, f"r{len(hidden)}", part).ref for part in value]
                data = where.create_dataset(name, (len(refs), 1), dtype=h5py.ref_dtype)
                data[:, 0] = refs
                if not field:
                    data.attrs["MATLAB_class"] = np.bytes_("cell")
                return data
            data = where.create_dataset(name, data=np.atleast_2d(value).T)
            data.attrs["MATLAB_class"] = np.bytes_("double")
            return data

        for name, value in content.items():
            put(file, name, value)
    with path.open("r+b") as stream:
        stream.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM")


def whole(found: Episodes) -> None:
    assert len(found) == 1
    np.testing.assert_allclose(found.xs[0], X, atol=1e-12)
    np.testing.assert_allclose(found.us[0][:, 0], U[:-1], atol=1e-12)


def in_two(found: Episodes, source: str = "run.mat") -> None:
    assert found.provenance is not None and found.provenance["runs"] == [f"{source}, run 1", f"{source}, run 2"]
    for x, u, run in zip(found.xs, found.us, RUNS, strict=True):
        np.testing.assert_allclose(x, X[run], atol=1e-12)
        np.testing.assert_allclose(u[:, 0], U[run][:-1], atol=1e-12)


@pytest.fixture(params=["v4", "v5", "v7.3"])
def file(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    path = tmp_path / "run.mat"
    flat = {"t": T[:, None], "x": X, "u": U[None]}
    if request.param == "v4":
        savemat(path, flat, format="4")
        return path
    deep: dict[str, Any] = {"log": {"t": T, "arm": {"x": X.T, "u": U}}}
    apart = {"tc": [column(T[r]) for r in RUNS], "xc": [X[r] for r in RUNS], "uc": [column(U[r]) for r in RUNS]}
    many = [{"t": column(T[r]), "x": X[r], "u": column(U[r])} for r in RUNS]
    if request.param == "v5":
        savemat(path, {**flat, **deep, "many": cells(*many), **{name: cells(*parts) for name, parts in apart.items()}})
    else:
        save_73(path, {**flat, **deep, "many": many, **apart})
    return path


def test_matrices_of_every_version_are_read(file: Path) -> None:
    whole(Episodes.from_mat(file, "t", "x", "u"))
    whole(Episodes.from_mat(file, None, "x", "u", dt=0.01))
    with pytest.raises(ValueError, match="has no variable 'y'; give names"):
        Episodes.from_mat(file, "t", "y", "u")


def test_structures_cells_and_arrays_of_structures_are_read(file: Path) -> None:
    with file.open("rb") as stream:
        if stream.read(6) != b"MATLAB":
            pytest.skip("version 4 has matrices alone")
    found = Episodes.from_mat(file, "log.t", "log.arm.x", "log.arm.u")
    whole(found)
    assert found.state_names == ("x1", "x2", "x3") and found.input_names == ("u",)
    in_two(Episodes.from_mat(file, "tc", "xc", "uc"))
    in_two(Episodes.from_mat(file, "many.t", "many.x", "many.u"))
    for ask, message in (
        (("log.t", "log.arm", "log.arm.u"), r"is a structure; name a field: 'log.arm.u', 'log.arm.x'"),
        (("log.t", "log.arm.z", "log.arm.u"), r"has no field 'z' in log.arm; it has u, x"),
        (("t", "xc", "uc"), "expected 60 rows"),
    ):
        with pytest.raises(ValueError, match=message) as error:
            Episodes.from_mat(file, *ask)
        assert "\n" not in str(error.value)


def test_an_array_of_structures_is_read_from_version_5_too(tmp_path: Path) -> None:
    many = np.empty((1, 2), dtype=[("t", object), ("x", object), ("u", object)])
    for k, rows in enumerate(RUNS):
        many[0, k] = (T[rows], X[rows], U[rows])
    savemat(tmp_path / "run.mat", {"many": many})
    in_two(Episodes.from_mat(tmp_path / "run.mat", "many.t", "many.x", "many.u"))


def message(path: Path, *ask: str) -> str:
    """The one line that a file is refused with."""
    with pytest.raises(ValueError) as error:
        Episodes.from_mat(path, None, *(ask or ("x",)), [], dt=0.1)
    assert "\n" not in str(error.value)
    return str(error.value)


def element(kind: int, content: bytes) -> bytes:
    """An element of a MATLAB 5 file: tag, content, zeros to the next multiple of eight."""
    return struct.pack("<II", kind, len(content)) + content + b"\0" * (-len(content) % 8)


def opaque(name: str, kind: str) -> bytes:
    """A table, or another object, as MATLAB writes it to files of version 5 (class 17, its data in another place)."""
    numbers = element(6, struct.pack("<II", 13, 0)) + element(5, struct.pack("<ii", 6, 1)) + element(1, b"")
    data = element(14, numbers + element(6, struct.pack("<6I", 0xDD000000, 2, 1, 1, 1, 1)))
    words = b"".join(element(1, word.encode()) for word in (name, "MCOS", kind))
    return element(14, element(6, struct.pack("<II", 17, 0)) + words + data)


@pytest.mark.parametrize(
    ("kind", "does"),
    [
        ("table", "S = table2struct(log, 'ToScalar', true); save('run.mat', '-struct', 'S'), or writetable(log"),
        ("timetable", "S.t = seconds(log.Properties.RowTimes - log.Properties.RowTimes(1))"),
        ("duration", "t = seconds(log); save t"),
        ("datetime", "t = seconds(log - log(1))"),
        ("string", "c = cellstr(log)"),
        ("Robot", "save its numbers as matrices"),
    ],
)
def test_objects_of_version_5_are_named_and_what_to_do_in_matlab(tmp_path: Path, kind: str, does: str) -> None:
    path = tmp_path / "run.mat"
    savemat(path, {"x": X})
    path.write_bytes(path.read_bytes() + opaque("log", kind))
    assert Episodes.from_mat(path, None, "x", [], dt=0.1).n_states == 3  # what is beside it is read
    said = message(path, "log")
    assert said.startswith(f"'log' in {path} is a {kind}, which only MATLAB reads: there ") and does in said


def test_why_a_file_is_not_read_is_said(tmp_path: Path) -> None:
    path = tmp_path / "run.mat"
    savemat(path, {"x": X})
    version_5 = path.read_bytes()
    savemat(path, {"x": X}, format="4")
    version_4 = path.read_bytes()
    for content, said in (
        (b"", "is empty"),
        (version_5[: len(version_5) // 2], "is a MATLAB file that is damaged or was cut short; copy it again"),
        (version_5[:200], "is a MATLAB file that is damaged or was cut short"),
        (version_4[:60], "is a damaged MATLAB file of version 4, or none"),
        (b"t,x,u\n0.0,1.0,2.0\n", "is no MATLAB file but text; read a table by Episodes.from_csv"),
        (b"PK\x03\x04" + bytes(40), "is no MATLAB file but an Excel workbook"),
        (b"\x93NUMPY\x01\x00" + bytes(40), "is no MATLAB file but one of NumPy"),
        (bytes(range(200, 256)), "is no MATLAB file; save it with '-v7'"),
    ):
        path.write_bytes(content)
        assert said in message(path), content[:20]


def test_runs_of_different_number_and_objects_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "run.mat"
    savemat(path, {"t": cells(T, T), "x": cells(X, X, X), "u": cells(U, U)})
    with pytest.raises(ValueError, match="different numbers of runs: 't' 2, 'x' 3, 'u' 2"):
        Episodes.from_mat(path, "t", "x", "u")
    with h5py.File(path, "w", userblock_size=512) as file:
        data = file.create_dataset("log", data=np.zeros((6, 1), dtype=np.uint32))
        data.attrs["MATLAB_class"], data.attrs["MATLAB_object_decode"] = np.bytes_("timetable"), 3
    with pytest.raises(ValueError, match=r"'log' in .* is a timetable, which only MATLAB reads: .* writetimetable"):
        Episodes.from_mat(path, None, "log", [], dt=0.1)
    assert "S = table2struct(timetable2table(log, 'ConvertRowTimes', false), 'ToScalar', true)" in message(path, "log")
    path.write_bytes(path.read_bytes()[:700])
    with pytest.raises(ValueError, match="damaged, or no MATLAB file"):
        Episodes.from_mat(path, "t", "x", "u")
