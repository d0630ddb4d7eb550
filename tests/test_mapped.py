"""Episodes that stay in their file are the same data, and are learned from in little memory."""

from __future__ import annotations

import pickle
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pisplit import Dictionary, Episodes, LinearEDMDc
from pisplit import observables as ob
from pisplit.data import mapped

RNG = np.random.default_rng(6)


def recordings(episodes: int = 4, steps: int = 50, n: int = 3) -> Episodes:
    xs = [RNG.normal(size=(steps + 1 + i, n)) for i in range(episodes)]
    us = [RNG.normal(size=(steps + i, 2)) for i in range(episodes)]
    extra = {"time": [np.arange(len(x)) for x in xs], "note": [np.array(["a", "b"]) for _ in xs]}
    return Episodes(xs, us, 0.1, units=("m",) * n, outputs={"tip": (0, 1)}, extra=extra, provenance={"seed": 6})


def test_what_stays_in_the_file_is_what_is_loaded(tmp_path: Path) -> None:
    data = recordings()
    data.save(tmp_path / "d.h5")
    kept = Episodes.load(tmp_path / "d.h5", mapped=True)
    assert mapped.is_mapped(kept.xs[1]) and mapped.is_mapped(kept.pairs(2).states)
    assert not mapped.is_mapped(Episodes.load(tmp_path / "d.h5").xs[1])
    for name in ("xs", "us"):
        for one, other in zip(getattr(data, name), getattr(kept, name), strict=True):
            np.testing.assert_array_equal(one, other)
            assert not other.flags.writeable
    assert kept.extra is not None and kept.outputs == data.outputs and kept.units == data.units
    theta = Dictionary(ob.Constant(), ob.Identity(), ob.Delays(1, 1), n_states=3, n_inputs=2)
    for alpha in (1e-6, "cv"):
        fits = [LinearEDMDc(theta, alpha=alpha).fit(d) for d in (data, kept)]
        np.testing.assert_array_equal(fits[0].K_, fits[1].K_)
        np.testing.assert_array_equal(fits[0].lifted.state_range, fits[1].lifted.state_range)
    copies = [pickle.loads(pickle.dumps(kept)), kept[1:3], replace(kept, dt=0.2)]
    np.testing.assert_array_equal(copies[0].xs[3], data.xs[3])
    np.testing.assert_array_equal(copies[1].xs[1], data.xs[2])
    assert mapped.is_mapped(copies[1].xs[1]) and mapped.is_mapped(copies[2].xs[0])
    autonomous = Episodes(data.xs, [u[:, :0] for u in data.us], 0.1)
    autonomous.save(tmp_path / "a.h5")
    np.testing.assert_array_equal(Episodes.load(tmp_path / "a.h5", mapped=True).xs[0], data.xs[0])


def test_joined_files_are_the_episodes_of_all(tmp_path: Path) -> None:
    parts = [recordings(n) for n in (1, 3, 2)]
    paths = [tmp_path / f"{i}.h5" for i in range(3)]
    for part, path in zip(parts, paths, strict=True):
        part.save(path)
    Episodes.join(paths, tmp_path / "all.h5")
    whole = Episodes.load(tmp_path / "all.h5", mapped=True)
    assert mapped.is_mapped(whole.xs[0]) and len(whole) == 6
    assert whole.extra is not None and parts[1].extra is not None
    for name in ("xs", "us"):
        for one, other in zip((a for part in parts for a in getattr(part, name)), getattr(whole, name), strict=True):
            np.testing.assert_array_equal(one, other)
    np.testing.assert_array_equal(whole.extra["time"][2], parts[1].extra["time"][1])
    assert whole.extra["note"][5].tolist() == ["a", "b"]
    assert (whole.dt, whole.units, whole.outputs) == (0.1, parts[0].units, parts[0].outputs)
    assert whole.provenance == {"joined": [{"seed": 6}] * 3}


def test_files_of_different_kinds_are_not_joined(tmp_path: Path) -> None:
    data = recordings()
    data.save(tmp_path / "a.h5")
    others = {"dt": replace(data, dt=0.2), "units": replace(data, units=("mm",) * 3), "arrays": recordings(n=4)}
    for name, other in others.items():
        other.save(tmp_path / "b.h5")
        with pytest.raises(ValueError, match=rf"b.h5 has {name} = .*join files of one kind") as error:
            Episodes.join([tmp_path / "a.h5", tmp_path / "b.h5"], tmp_path / "c.h5")
        assert "\n" not in str(error.value) and not (tmp_path / "c.h5").exists()
    with pytest.raises(ValueError, match="paths is empty"):
        Episodes.join([], tmp_path / "c.h5")
    with pytest.raises(FileNotFoundError, match=r"none.h5"):
        Episodes.join([tmp_path / "none.h5"], tmp_path / "c.h5")


def test_damage_is_found_before_anything_is_mapped(tmp_path: Path) -> None:
    recordings().save(tmp_path / "d.h5")
    whole = (tmp_path / "d.h5").read_bytes()
    (tmp_path / "d.h5").write_bytes(whole[:-9] + bytes([whole[-9] ^ 1]) + whole[-8:])
    with pytest.raises(ValueError, match="is damaged"):
        Episodes.load(tmp_path / "d.h5", mapped=True)


LEARN = """
import resource, sys
import numpy as np
from pisplit import Dictionary, Episodes, LinearEDMDc, observables as ob
theta = Dictionary(ob.Constant(), ob.Identity(), n_states=40, n_inputs=2)
small, large = sys.argv[1:]
LinearEDMDc(theta, alpha=1e-6).fit(Episodes.load(small, mapped=True))
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
LinearEDMDc(theta, alpha=1e-6).fit(Episodes.load(large, mapped=True))
print((resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1e3)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="pages are given back by madvise, memory is counted as on Linux")
def test_a_file_is_learned_from_in_less_memory_than_it_has(tmp_path: Path) -> None:
    paths = [tmp_path / "small.h5", tmp_path / "large.h5"]
    for path, steps in zip(paths, (3000, 250_000), strict=True):
        Episodes([RNG.normal(size=(steps + 1, 40))], [RNG.normal(size=(steps, 2))], 0.1).save(path)
    command = [sys.executable, "-c", LEARN, *map(str, paths)]
    grown = float(subprocess.run(command, capture_output=True, text=True, check=True).stdout)
    size = paths[1].stat().st_size / 1e6
    assert size > 80.0 and grown < 0.5 * size, f"{grown:.0f} MB for a file of {size:.0f} MB"
