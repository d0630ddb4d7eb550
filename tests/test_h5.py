"""Files are whole or absent, and say what they are."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pisplit import Episodes, LiftedModel, PhaseSamples
from pisplit.data import store


def small_episodes() -> Episodes:
    return Episodes([np.zeros((3, 2)), np.ones((2, 2))], [np.zeros((2, 1)), np.ones((1, 1))], dt=0.1)


def test_a_failed_write_leaves_the_old_file_and_nothing_else(tmp_path: Path) -> None:
    path = tmp_path / "d1.h5"
    small_episodes().save(path)
    before = path.read_bytes()
    with pytest.raises(RuntimeError, match="killed"), store.writing(path, "pisplit/episodes") as file:
        file["x"] = np.zeros(1000)
        raise RuntimeError("killed")
    assert path.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["d1.h5"]


@pytest.mark.parametrize("kept", [0.0, 0.3, 0.9])
@pytest.mark.parametrize("kind", [Episodes, PhaseSamples, LiftedModel])
def test_a_truncated_file_is_refused_in_one_line(
    tmp_path: Path, kind: type[Episodes | PhaseSamples | LiftedModel], kept: float
) -> None:
    path = tmp_path / "d1.h5"
    small_episodes().save(path)
    content = path.read_bytes()
    path.write_bytes(content[: int(kept * len(content))])
    with pytest.raises(ValueError, match="truncated") as error:
        kind.load(path)
    assert "\n" not in str(error.value)


def test_missing_files_and_other_kinds_are_named(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="does not exist"):
        Episodes.load(tmp_path / "none.h5")
    with pytest.raises(ValueError, match="create it first"):
        small_episodes().save(tmp_path / "no" / "folder.h5")
    small_episodes().save(tmp_path / "d1.h5")
    for other in (PhaseSamples, LiftedModel):
        with pytest.raises(ValueError, match="holds 'pisplit/episodes'"):
            other.load(tmp_path / "d1.h5")


def test_a_file_without_one_of_its_parts_is_refused_in_one_line(tmp_path: Path) -> None:
    with store.writing(tmp_path / "d1.h5", "pisplit/episodes") as file:
        file["nothing"] = 1.0
    with pytest.raises(ValueError, match="incomplete or damaged") as error:
        Episodes.load(tmp_path / "d1.h5")
    assert "\n" not in str(error.value)


def test_a_newer_format_is_refused(tmp_path: Path) -> None:
    with store.writing(tmp_path / "d1.h5", "pisplit/episodes") as file:
        file.attrs["version"] = store.FORMAT_VERSION + 1
    with pytest.raises(ValueError, match="update it"):
        Episodes.load(tmp_path / "d1.h5")


def test_phase_samples_survive_a_file(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    x, u, v, half = rng.normal(size=(5, 2)), rng.normal(size=(5, 1)), rng.normal(size=(5, 2)), rng.normal(size=(5, 2))
    for samples in (PhaseSamples(x, u, v), PhaseSamples(x, u, v, half, 0.1, ("a", "b"), ("f",), {"seed": 1})):
        samples.save(tmp_path / "d2.h5")
        loaded = PhaseSamples.load(tmp_path / "d2.h5")
        for name in ("x", "u", "xdot"):
            np.testing.assert_array_equal(getattr(loaded, name), getattr(samples, name))
        assert (loaded.dt, loaded.state_names, loaded.provenance) == (
            samples.dt,
            samples.state_names,
            samples.provenance,
        )
        assert (loaded.x_half is None) == (samples.x_half is None)
