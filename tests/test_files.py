"""Files are written whole or not at all, and what cannot be written is told in one line."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest

from pisplit import Episodes
from pisplit.files import replacing, write_text

ROOT = Path(__file__).resolve().parent.parent


def refused(path: Path, told: str) -> None:
    with pytest.raises(ValueError, match=told) as error:
        write_text(path, "text")
    assert "\n" not in str(error.value) and os.fspath(path) in str(error.value)


def test_places_that_cannot_be_written_are_told_in_one_line(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("kept")
    refused(tmp_path, "it is a folder")
    refused(tmp_path / "none" / "a.txt", "does not exist; create it first")
    refused(tmp_path / "file" / "a.txt", "is a file")
    refused(Path("/dev/null"), "no regular file")
    with pytest.raises(ValueError, match="cannot write"), replacing(tmp_path / "file" / "a" / "b", make_folders=True):
        pass
    assert [p.name for p in tmp_path.iterdir()] == ["file"] and (tmp_path / "file").read_text() == "kept"


def test_a_folder_without_permission_is_told_in_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def denied(*_: object) -> int:
        raise PermissionError(13, "Permission denied", "hidden name")

    monkeypatch.setattr(os, "open", denied)
    refused(tmp_path / "a.txt", "Permission denied")


@pytest.mark.parametrize("error", [RuntimeError("broken"), KeyboardInterrupt(), OSError(28, "No space left on device")])
def test_a_write_that_breaks_leaves_the_old_file_and_nothing_else(tmp_path: Path, error: BaseException) -> None:
    path = tmp_path / "a.txt"
    write_text(path, "old")
    with pytest.raises((type(error), ValueError)), replacing(path) as part:
        part.write_text("half")
        raise error
    assert path.read_text() == "old" and [p.name for p in tmp_path.iterdir()] == ["a.txt"]


def test_the_unfinished_file_has_the_suffix_and_the_finished_one_the_usual_permissions(tmp_path: Path) -> None:
    usual = tmp_path / "usual"
    usual.touch()
    with replacing(tmp_path / "new" / "picture.png", make_folders=True) as part:
        assert part.suffix == ".png" and part.name.startswith(".")
    assert (tmp_path / "new" / "picture.png").stat().st_mode == usual.stat().st_mode
    write_text(tmp_path / ("n" * 250 + ".txt"), "a name as long as file systems allow")


def test_a_link_stays_a_link(tmp_path: Path) -> None:
    (tmp_path / "real").mkdir()
    (tmp_path / "link.txt").symlink_to(tmp_path / "real" / "a.txt")
    write_text(tmp_path / "link.txt", "text")
    assert (tmp_path / "link.txt").is_symlink() and (tmp_path / "real" / "a.txt").read_text() == "text"


def test_of_many_writers_one_wins_whole(tmp_path: Path) -> None:
    texts = [str(k) * 100_000 for k in range(8)]
    threads = [threading.Thread(target=write_text, args=(tmp_path / "a.txt", text)) for text in texts]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert (tmp_path / "a.txt").read_text() in texts and len(list(tmp_path.iterdir())) == 1


FULL = """
import resource, signal, sys
import numpy as np
from pisplit import Episodes
d1 = Episodes([np.ones((300, 3))], [np.ones((299, 1))], 0.1, extra={"state": [np.ones((300, 4))]})
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
for size in map(int, sys.argv[2:]):
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, resource.RLIM_INFINITY))
    try:
        d1.save(sys.argv[1])
    except ValueError as error:
        print(error)
"""


def test_a_disk_that_is_full_at_any_byte_is_told_in_one_line(tmp_path: Path) -> None:
    """The limit on the size of files stands for a full disk. The HDF5 library's own files end the process here."""
    path = tmp_path / "d1.h5"
    Episodes([np.ones((300, 3))], [np.ones((299, 1))], 0.1, extra={"state": [np.ones((300, 4))]}).save(path)
    before = path.read_bytes()
    sizes = [0, 100, 513, 3000, *(len(before) - k for k in (9000, 2100, 1500, 700, 100, 1))]
    ran = subprocess.run(
        [sys.executable, "-c", FULL, str(path), *map(str, sizes)], capture_output=True, text=True, check=False
    )
    assert ran.returncode == 0, ran.stderr
    assert ran.stdout.splitlines() == [
        f"cannot write {path}: File too large; make room and permit it, or give another path"
    ] * len(sizes)
    assert path.read_bytes() == before and len(list(tmp_path.iterdir())) == 1


def test_only_one_place_replaces_files() -> None:
    """Whoever writes a file asks ``pisplit.files``: no other module moves one into place or makes a temporary one."""
    words = ("os.replace", "os.rename", "mkstemp", "NamedTemporaryFile", "savez", '.with_suffix(".tmp')
    for folder in ("pisplit", "models", "controllers", "scripts"):
        for path in (ROOT / folder).rglob("*.py"):
            if path != ROOT / "pisplit" / "files.py":
                found = [word for word in words if word in path.read_text()]
                assert not found, f"{path.relative_to(ROOT)} uses {found}"
