"""The gallery: enough pictures, each with a caption of its own, drawn by the function that it names."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from PIL import Image

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "scripts"))

from gallery import caption, pictures  # noqa: E402


def test_there_are_pictures_with_captions() -> None:
    found = pictures()
    captions = [caption(picture) for picture in found.values()]
    assert len(found) >= 20 and len(set(captions)) == len(captions)
    assert all(len(text) > 40 and text.endswith(".") for text in captions)


def test_the_script_draws_what_it_is_asked_for(tmp_path: Path) -> None:
    names = ["elastica", "errors_over_time", "way_points"]
    command = [sys.executable, "scripts/make_gallery.py", "--out", str(tmp_path), "--only", *names]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert sorted(p.stem for p in tmp_path.iterdir()) == sorted(names)
    for path in tmp_path.iterdir():
        low, high = Image.open(path).convert("L").getextrema()
        assert low < 100 and high == 255  # something is drawn on white
    wrong = subprocess.run([*command[:5], "elastic"], cwd=ROOT, capture_output=True, text=True)
    assert wrong.returncode and "expected some of elastica, euler_column" in wrong.stderr
