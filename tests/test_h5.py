"""HDF5 files say what they are, and a damaged one is refused before anything in it is read."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import casadi as ca
import h5py
import numpy as np
import pytest

from pisplit import Dictionary, Episodes, LiftedModel, LinearEDMDc, PhaseSamples
from pisplit import observables as ob
from pisplit.data import store

#: Bytes of every file that the damages below write over.
BODY = store.USER_BLOCK


def small_episodes() -> Episodes:
    rng = np.random.default_rng(0)
    xs, us = [rng.normal(size=(k + 1, 2)) for k in (6, 9)], [rng.normal(size=(k, 1)) for k in (6, 9)]
    return Episodes(xs, us, dt=0.1, units=("m", "rad"), outputs={"tip": (0,)}, provenance={"seed": 3})


def small_samples() -> PhaseSamples:
    rng = np.random.default_rng(1)
    return PhaseSamples(rng.normal(size=(5, 2)), rng.normal(size=(5, 1)), rng.normal(size=(5, 2)))


def small_dictionary() -> Dictionary:
    return Dictionary(ob.Identity(), ob.Delays(states=1), ob.Polynomials(2), n_states=2, n_inputs=1)


def small_model() -> LiftedModel:
    return LinearEDMDc(small_dictionary(), alpha=0.1).fit(small_episodes()).lifted


MADE: dict[type, Callable[[], Any]] = {
    Episodes: small_episodes,
    PhaseSamples: small_samples,
    Dictionary: small_dictionary,
    LiftedModel: small_model,
}
KINDS = pytest.mark.parametrize("kind", MADE, ids=lambda kind: kind.__name__)


def refused(kind: Any, path: Path, told: str) -> None:
    with pytest.raises(ValueError, match=told) as error:
        kind.load(path)
    assert "\n" not in str(error.value) and str(path) in str(error.value)


def test_a_failed_write_leaves_the_old_file_and_nothing_else(tmp_path: Path) -> None:
    path = tmp_path / "d1.h5"
    small_episodes().save(path)
    before = path.read_bytes()
    with pytest.raises(RuntimeError, match="killed"), store.writing(path, "pisplit/episodes") as file:
        file["x"] = np.zeros(1000)
        raise RuntimeError("killed")
    assert path.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["d1.h5"]


@KINDS
def test_every_bit_counts(tmp_path: Path, kind: Any) -> None:
    """A flipped bit anywhere in the file, whether it holds numbers, names, structure of HDF5 or nothing, is refused."""
    path = tmp_path / "file.h5"
    MADE[kind]().save(path)
    content = path.read_bytes()
    for at in np.random.default_rng(0).choice(len(content), 150, replace=False):
        path.write_bytes(content[:at] + bytes([content[at] ^ 1 << int(at) % 8]) + content[at + 1 :])
        refused(kind, path, "damaged")
    path.write_bytes(content)
    kind.load(path)


def test_every_bit_of_the_first_block_counts(tmp_path: Path) -> None:
    path = tmp_path / "file.h5"
    small_samples().save(path)
    content = path.read_bytes()
    for at in range(BODY):
        path.write_bytes(content[:at] + bytes([content[at] ^ 1 << at % 8]) + content[at + 1 :])
        refused(PhaseSamples, path, "damaged")


DAMAGES: dict[str, Callable[[bytes], bytes]] = {
    "cut at the end": lambda b: b[:-1],
    "cut in the middle": lambda b: b[: len(b) // 2],
    "cut in its first block": lambda b: b[:300],
    "garbage at the end": lambda b: b + b"\0",
    "garbage before it": lambda b: b"\0" * 512 + b,
    "zeros in the middle": lambda b: b[:400] + bytes(1000) + b[1400:],
    "blocks swapped": lambda b: b[:512] + b[1024:1536] + b[512:1024] + b[1536:],
    "first block lost": lambda b: b[512:],
    "all zeros": lambda b: bytes(len(b)),
    "another file's beginning": lambda b: b[:400] + b"{}" + b[402:],
    "doubled": lambda b: b + b,
}


@KINDS
@pytest.mark.parametrize("damage", DAMAGES)
def test_damage_is_refused_in_one_line(tmp_path: Path, kind: Any, damage: str) -> None:
    path = tmp_path / "file.h5"
    MADE[kind]().save(path)
    path.write_bytes(DAMAGES[damage](path.read_bytes()))
    refused(kind, path, "no checksum" if damage == "first block lost" else "damaged")


def test_numbers_changed_by_another_program_are_refused(tmp_path: Path) -> None:
    """Not only broken bits: what is changed since the file was written is not what was written."""
    small_model().save(tmp_path / "model.h5")
    with h5py.File(tmp_path / "model.h5", "r+") as file:
        file["A"][0, 0] += 1.0
    refused(LiftedModel, tmp_path / "model.h5", "changed since it was written")
    small_episodes().save(tmp_path / "d1.h5")
    with h5py.File(tmp_path / "d1.h5", "r+") as file:
        file.attrs["dt"] = 1.0
    refused(Episodes, tmp_path / "d1.h5", "changed since it was written")


def test_nothing_of_a_damaged_file_reaches_the_libraries(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """HDF5 and CasADi may end the process where a file is damaged: they are not even called."""
    small_model().save(tmp_path / "model.h5")
    content = (tmp_path / "model.h5").read_bytes()
    (tmp_path / "model.h5").write_bytes(content[:-1] + bytes([content[-1] ^ 1]))

    def called(*_: Any, **__: Any) -> Any:
        raise AssertionError("called")

    monkeypatch.setattr(h5py, "File", called)
    monkeypatch.setattr(ca.Function, "deserialize", called)
    refused(LiftedModel, tmp_path / "model.h5", "damaged")


@KINDS
def test_any_reader_of_hdf5_opens_the_files(tmp_path: Path, kind: Any) -> None:
    MADE[kind]().save(tmp_path / "file.h5")
    with h5py.File(tmp_path / "file.h5", "r") as file:
        assert file.userblock_size == store.USER_BLOCK
        assert file.attrs["kind"].startswith("pisplit/") and file.attrs["casadi"] == store.CASADI
    assert (tmp_path / "file.h5").read_bytes().startswith(b"pisplit file")


def test_missing_files_folders_and_other_kinds_are_named(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="does not exist"):
        Episodes.load(tmp_path / "none.h5")
    with pytest.raises(ValueError, match="create it first"):
        small_episodes().save(tmp_path / "no" / "folder.h5")
    refused(Episodes, tmp_path, "is a folder")
    refused(Episodes, Path("/dev/zero"), "no regular file")
    small_episodes().save(tmp_path / "d1.h5")
    for other in (PhaseSamples, LiftedModel, Dictionary):
        refused(other, tmp_path / "d1.h5", "holds 'pisplit/episodes'")


def test_files_of_others_are_called_what_they_are(tmp_path: Path) -> None:
    path = tmp_path / "file.h5"
    path.write_bytes(b"")
    refused(Episodes, path, "is empty")
    path.write_text("time,x,u\n0,1,2\n")
    refused(Episodes, path, "no file of pisplit")
    with h5py.File(path, "w") as file:
        file["x"] = np.ones((3, 2))
    refused(Episodes, path, "another program")
    with pytest.raises(ValueError, match="not written by pisplit"):
        store.seal(path)


def test_a_file_without_one_of_its_parts_is_refused_in_one_line(tmp_path: Path) -> None:
    with store.writing(tmp_path / "d1.h5", "pisplit/episodes") as file:
        file["nothing"] = 1.0
    refused(Episodes, tmp_path / "d1.h5", "lacks a part")


def test_a_newer_format_is_refused(tmp_path: Path) -> None:
    with store.writing(tmp_path / "d1.h5", "pisplit/episodes") as file:
        file.attrs["version"] = store.FORMAT_VERSION + 1
    refused(Episodes, tmp_path / "d1.h5", "update pisplit")


def test_a_file_of_a_newer_casadi_is_not_called_damaged(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its functions are not even tried; arrays do not care which CasADi wrote them."""
    monkeypatch.setattr(store, "CASADI", "99.1.0")
    for made in MADE.values():
        made().save(tmp_path / f"{made.__name__}.h5")
    monkeypatch.setattr(store, "CASADI", "3.7.0")
    monkeypatch.setattr(ca.Function, "deserialize", None)
    for kind in (Dictionary, LiftedModel):
        refused(kind, tmp_path / f"{MADE[kind].__name__}.h5", "CasADi 99.1.0, newer than 3.7.0 here: update CasADi")
    for kind in (Episodes, PhaseSamples):
        kind.load(tmp_path / f"{MADE[kind].__name__}.h5")


def test_functions_that_cannot_be_built_are_not_called_damaged(tmp_path: Path) -> None:
    class Foreign:
        @staticmethod
        def serialize() -> str:
            return "words of another CasADi"

    with store.writing(tmp_path / "f.h5", "pisplit/functions") as file:
        store.write_function(file, "f", Foreign())
    with (
        pytest.raises(ValueError, match=f"cannot build f, a function of CasADi {store.CASADI}") as error,
        store.reading(tmp_path / "f.h5", "pisplit/functions") as file,
    ):
        store.read_function(file, "f")
    assert "\n" not in str(error.value)


def test_files_without_a_digest_are_refused_until_they_are_sealed(tmp_path: Path) -> None:
    path = tmp_path / "model.h5"
    model = small_model()
    model.save(path)
    with h5py.File(path, "r") as new, h5py.File(tmp_path / "old.h5", "w") as old:  # as format 1 was
        for name in new:
            new.copy(name, old)
        old.attrs.update({**new.attrs, "version": 1})
        del old.attrs["casadi"], old.attrs["pisplit"]
    refused(LiftedModel, tmp_path / "old.h5", r"pisplit.data.store.seal\(path\)")
    store.seal(tmp_path / "old.h5")
    np.testing.assert_array_equal(LiftedModel.load(tmp_path / "old.h5").A, model.A)
    before = path.read_bytes()
    store.seal(path)
    assert path.read_bytes() == before
    path.write_bytes(before[:-1])
    with pytest.raises(ValueError, match="damaged"):
        store.seal(path)


def test_json_files_are_verified_to_the_byte(tmp_path: Path) -> None:
    path, value = tmp_path / "new" / "run.json", {"seed": 3, "dt": 0.1, "names": ["a", "ä"], "none": None}
    store.save_json(path, value)
    assert store.load_json(path) == value
    content = path.read_bytes()
    damaged = [content[:at] + bytes([content[at] ^ 1]) + content[at + 1 :] for at in range(len(content))]
    for other in (*damaged, b"", content + b"\n", content[:-1], b"[" * 100_000, b'{"seed": 3}'):
        path.write_bytes(other)
        with pytest.raises(ValueError, match="is damaged, or no file of pisplit; delete it"):
            store.load_json(path)


def test_what_a_file_cannot_hold_is_told_when_it_is_written(tmp_path: Path) -> None:
    d1 = small_episodes()
    for extra, told in (
        ([np.array(["2026-01-01"], dtype="datetime64[D]")] * 2, "datetime64"),
        ([np.zeros((2, 1)), np.zeros((2, 3))], "rows of one kind"),
        ([np.zeros(2), np.zeros(2, dtype=int)], "rows of one kind"),
        ([np.array(1.0), np.array(2.0)], "rows of one kind"),
    ):
        with pytest.raises(ValueError, match=told) as error:
            Episodes(d1.xs, d1.us, 0.1, extra={"when": extra}).save(tmp_path / "d1.h5")
        assert "\n" not in str(error.value)
    with pytest.raises(ValueError, match="provenance cannot be written as JSON"):
        PhaseSamples(np.ones((1, 1)), np.ones((1, 1)), np.ones((1, 1)), provenance={"a": {1, 2}}).save(tmp_path / "d2")
    assert not list(tmp_path.iterdir())


def test_extra_arrays_of_any_name_and_kind_survive_a_file(tmp_path: Path) -> None:
    d1 = small_episodes()
    numbers = [np.array([2**62 + 1, 3]), np.array([], dtype=np.int64)]
    extra = {
        "a/b": numbers,
        ".": [np.array(["x", "yy"])] * 2,
        "": [np.array([True])] * 2,
        "50 %": [np.ones((1, 2))] * 2,
    }
    Episodes(d1.xs, d1.us, 0.1, extra=extra).save(tmp_path / "d1.h5")
    loaded = Episodes.load(tmp_path / "d1.h5").extra
    assert loaded is not None and set(loaded) == set(extra)
    for name, arrays in extra.items():
        for one, other in zip(arrays, loaded[name], strict=True):
            np.testing.assert_array_equal(one, other, strict=True)
