"""Recordings with their own clock become episodes: resampling, gaps, units, ranges, tables and MATLAB files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.io import savemat

from pisplit import Dictionary, Episodes, LinearEDMDc
from pisplit import observables as ob

Array = NDArray[np.float64]


def recording(n: int = 200, jitter: float = 0.2, seed: int = 0) -> tuple[Array, Array, Array]:
    rng = np.random.default_rng(seed)
    t = 5.0 + 0.01 * (np.arange(n) + jitter * rng.uniform(-1, 1, n))
    return t, np.column_stack([np.sin(3 * t), np.cos(3 * t)]), np.sin(t)[:, None]


def test_a_regular_clock_keeps_every_sample() -> None:
    t, x, u = recording(50, 0.0)
    episodes = Episodes.from_arrays(t, x, u)
    assert len(episodes) == 1 and episodes.dt == pytest.approx(0.01)
    np.testing.assert_allclose(episodes.xs[0], x, atol=1e-12)
    np.testing.assert_allclose(episodes.us[0], u[:-1], atol=1e-10)


@pytest.mark.parametrize(("interpolation", "order"), [("linear", 2), ("cubic", 4)])
def test_resampling_has_the_order_of_its_interpolation(interpolation: str, order: int) -> None:
    errors = []
    for n in (100, 200):
        t = np.linspace(0, 2, n) + 0.2 * 2 / n * np.sin(40 * np.linspace(0, 2, n))
        t[0], t[-1] = 0, 2
        found = Episodes.from_arrays(t, np.sin(3 * t), t, dt=0.0137, interpolation=interpolation)
        grid = 0.0137 * np.arange(len(found.xs[0]))
        errors.append(np.abs(found.xs[0][5:-5, 0] - np.sin(3 * grid)[5:-5]).max())
    assert np.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.5)


def test_an_input_is_the_mean_of_held_commands() -> None:
    t = np.array([0.0, 1.0, 2.0, 3.0, 4.0])
    u = np.array([1.0, 3.0, 5.0, 7.0, 9.0])
    np.testing.assert_allclose(Episodes.from_arrays(t, t, u, dt=2.0).us[0][:, 0], [2.0, 6.0])
    np.testing.assert_allclose(Episodes.from_arrays(t, t, u, dt=0.5).us[0][:4, 0], [1.0, 1.0, 3.0, 3.0])


def test_gaps_and_missing_rows_split_episodes() -> None:
    t, x, u = recording(200, 0.0)
    x[60:70] = np.nan  # 0.1 s are missing
    x[120, 0] = np.nan  # one sample is bridged
    keep = (t < 5.0 + 1.6) | (t > 5.0 + 1.8)
    episodes = Episodes.from_arrays(t[keep], x[keep], u[keep])
    assert [len(x) for x in episodes.xs] == [60, 90, 19]
    assert episodes.provenance is not None and episodes.provenance["incomplete_samples"] == 11
    np.testing.assert_allclose(episodes.xs[1][0], np.array([np.sin(3 * t[70]), np.cos(3 * t[70])]))
    assert len(Episodes.from_arrays(t[keep], x[keep], u[keep], max_gap=1.0)) == 1
    lonely = np.concatenate([t[:50], [9.0]])
    with pytest.warns(UserWarning, match="1 of 2 pieces"):
        assert len(Episodes.from_arrays(lonely, np.sin(lonely), lonely)) == 1


def test_units_become_si_and_are_kept() -> None:
    t, x, u = recording(20, 0.0)
    episodes = Episodes.from_arrays(
        1e3 * t, x, u, time_unit="ms", state_units=["mm", "deg/s"], input_units="mm", state_names=["p", "w"]
    )
    assert episodes.dt == pytest.approx(0.01) and episodes.units == ("m", "rad/s")
    np.testing.assert_allclose(episodes.xs[0], x * [1e-3, np.pi / 180], atol=1e-12)
    np.testing.assert_allclose(episodes.us[0], 1e-3 * u[:-1], atol=1e-12)


def test_a_table_is_read_back_and_identified(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    u = rng.normal(size=(300, 1))
    x = np.zeros((300, 2))
    a, b = np.array([[0.9, 0.2], [-0.2, 0.9]]), np.array([0.0, 0.1])
    for k in range(299):
        x[k + 1] = a @ x[k] + b * u[k]
    lines = ["time [ms],p,comment,q,pull"]
    lines += [f"{20 * k},{float(x[k, 0])!r},ok,{float(x[k, 1])!r},{float(u[k, 0])!r}" for k in range(300)]
    lines[151] = "3000,,sensor off,,"
    (tmp_path / "run.csv").write_text("\n".join(lines) + "\n")
    d1 = Episodes.from_csv(
        tmp_path / "run.csv", "time [ms]", ["p", "q"], ["pull"], time_unit="ms", max_gap=0.03, ranges={"p": (-9, 9)}
    )
    assert d1.dt == pytest.approx(0.02) and d1.state_names == ("p", "q") and [len(x) for x in d1.xs] == [150, 149]
    assert d1.provenance is not None and d1.provenance["file"] == "run.csv"
    found = LinearEDMDc(Dictionary(ob.Identity(), n_states=2, n_inputs=1)).fit(d1).lifted
    np.testing.assert_allclose(found.A, a, atol=1e-9)
    np.testing.assert_allclose(found.B[:, 0], b, atol=1e-9)


def test_a_matlab_file_is_read_back(tmp_path: Path) -> None:
    t, x, u = recording(30, 0.0)
    savemat(tmp_path / "run.mat", {"t": t, "q": x, "pull": u.T, "note": "x"})
    episodes = Episodes.from_mat(tmp_path / "run.mat", "t", "q", "pull", dt=0.01)
    assert episodes.state_names == ("q1", "q2") and episodes.input_names == ("pull",)
    np.testing.assert_allclose(episodes.xs[0], x, atol=1e-9)
    with pytest.raises(ValueError, match="no variable 'qd'"):
        Episodes.from_mat(tmp_path / "run.mat", "t", "qd", "pull")
    (tmp_path / "bad.mat").write_text("no matlab")
    with pytest.raises(ValueError, match="no MATLAB file"):
        Episodes.from_mat(tmp_path / "bad.mat", "t", "q", "pull")


T, X, U = recording(10, 0.0)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"t": T[::-1]}, "does not increase after sample 0"),
        ({"t": T[:, None]}, "t has shape"),
        ({"x": X[:5]}, "x has shape"),
        ({"x": np.full_like(X, np.nan)}, "x1 has 0 readings"),
        ({"dt": 0.0}, "dt = 0"),
        ({"dt": 10.0}, "no piece"),
        ({"interpolation": "spline"}, "interpolation"),
        ({"state_units": "furlong"}, "no known unit"),
        ({"state_units": ["m"]}, "expected 2"),
        ({"time_unit": "mm"}, "unit of time"),
        ({"ranges": {"x1": (-0.1, 0.1)}}, "x1 is .* outside"),
        ({"ranges": {"y": (0, 1)}}, "ranges names 'y'"),
    ],
)
def test_bad_recordings_are_refused_in_one_line(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message) as error:
        Episodes.from_arrays(**{"t": T, "x": X, "u": U, **arguments})
    assert "\n" not in str(error.value)


def test_bad_tables_are_refused_in_one_line(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    for text, message in (
        ("", "no column 't'; it has none"),
        ("t,x\n0,1\n", "no column 'u'"),
        ("t,x,u\n", "no rows"),
        ("t,x,u\n0,1,2\n1,left,3\n", "line 3: 'left' is not a number"),
    ):
        path.write_text(text)
        with pytest.raises(ValueError, match=message):
            Episodes.from_csv(path, "t", ["x"], ["u"])
    with pytest.raises(FileNotFoundError, match="does not exist"):
        Episodes.from_csv(tmp_path / "none.csv", "t", ["x"], ["u"])


def test_the_worked_example_of_the_guide_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    guide = (Path(__file__).parent.parent / "docs" / "identification.md").read_text()
    code = next(block for block in guide.split("```python\n") if "from_csv(" in block).split("```")[0]
    monkeypatch.chdir(tmp_path)
    exec(compile(code, "identification.md", "exec"), {})
    assert "0 % diverged" in capsys.readouterr().out
