"""One look at recordings: what the report says of them is what was put into them."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from pisplit import Episodes
from pisplit.data.suspicions import noise_level

Array = NDArray[np.float64]

DT, STEPS = 0.01, 300
TURN = 4.0 * DT
SWING = 0.99 * np.array([[np.cos(TURN), np.sin(TURN)], [-np.sin(TURN), np.cos(TURN)]])


def recordings(noise: float = 0.0, delay: int = 0, number: int = 4, inputs: int = 2) -> Episodes:
    """Slow oscillators that follow held commands ``delay`` steps later."""
    rng = np.random.default_rng(0)
    xs, us = [], []
    for _ in range(number):
        u = np.repeat(rng.uniform(-1.0, 1.0, (STEPS // 5 + 1, inputs)), 5, axis=0)[:STEPS]
        x = np.zeros((STEPS + 1, 2, 2))
        for k in range(STEPS):
            x[k + 1] = x[k] @ SWING.T + np.outer(u[max(k - delay, 0), :2], [0.002, 0.03])
        xs.append(x.reshape(-1, 4) + noise * rng.normal(size=(STEPS + 1, 4)))
        us.append(u)
    return Episodes(xs, us, DT, state_names=["p", "v", "q", "w"], units=["m", "m/s", "m", "m/s"])


def with_column(d: Episodes, column: list[Array], name: str = "odd") -> Episodes:
    xs = [np.column_stack([x, c]) for x, c in zip(d.xs, column, strict=True)]
    names, units = (*(d.state_names or ()), name), (*(d.units or ()), "")
    return replace(d, xs=xs, state_names=names, quantities=None, units=units)


def test_lengths_ranges_directions_and_holds_are_those_of_the_data() -> None:
    d = recordings()
    report = d.report()
    assert (report.episodes, report.steps, report.excited) == (4, (STEPS,) * 4, 2)
    assert report.duration == pytest.approx(4 * STEPS * DT)
    x = d.stacked_states()
    for i, column in enumerate(report.columns[:4]):
        assert (column.low, column.high) == (x[:, i].min(), x[:, i].max()) and not column.suspicions
        assert column.spread == pytest.approx(x[:, i].std())
    assert [c.hold for c in report.columns[4:]] == [5.0, 5.0] and len(report.directions) == 2
    np.testing.assert_allclose(report.correlations, np.corrcoef(d.stacked_inputs().T))
    assert report.remarks == ()


@pytest.mark.parametrize("noise", [1e-3, 3e-3])
def test_noise_is_told_and_hidden_where_motion_is_larger(noise: float) -> None:
    columns = recordings(noise).report().columns
    for column in (columns[0], columns[2]):
        assert column.noise == pytest.approx(noise, rel=0.15)
    assert all(c.noise is None for c in recordings().report().columns[:4])
    rng = np.random.default_rng(1)
    white = rng.normal(size=2000)
    white[::50] += 100.0  # spikes are no noise
    assert noise_level(white, [np.arange(2000)]) == pytest.approx(1.0, rel=0.2)
    t = 0.3 * np.arange(2000)
    assert noise_level(np.sin(t), [np.arange(2000)]) is None
    assert noise_level(np.ones(2000), [np.arange(2000)]) == 0.0


@pytest.mark.parametrize("delay", [0, 4])
def test_the_delay_is_that_of_the_data(delay: int) -> None:
    report = recordings(1e-4, delay).report()
    assert report.latency.delay is not None
    assert abs(report.latency.delay - delay * DT) <= report.latency.error <= 2.0 * DT
    assert any("steps: take delays of inputs" in remark for remark in report.remarks) is (delay > 0)


def test_what_is_suspicious_is_named() -> None:
    d = recordings()
    p = [x[:, 0] for x in d.xs]
    level = float(np.quantile(np.concatenate(p), 0.9))
    spiky = [x.copy() for x in p]
    for column in spiky:
        column[[50, 120]] += 3.0
    stuck = [x.copy() for x in p]
    stuck[1][100:160] = stuck[1][100]
    cases: list[tuple[list[Array], str]] = [
        ([np.full(len(x), 0.7) for x in p], "constant"),
        (p, "the same as p"),
        ([2.0 * x + 1.0 for x in p], "follows from p"),
        ([np.minimum(x, level) for x in p], "saturated: .* at its largest"),
        (spiky, "8 spikes"),
        ([np.sign(x) for x in p], "takes [23] values"),
    ]
    for column, said in cases:
        report = with_column(d, column).report()
        (found,) = [c for c in report.columns if c.name == "odd"]
        assert len(found.suspicions) >= 1 and re.search(said, "; ".join(found.suspicions)), (said, found)
        assert any("odd" in remark for remark in report.remarks) and "odd" in str(report)
        assert all(not c.suspicions for c in report.columns if c.name != "odd")
    both = [np.column_stack([a, x[:, 1], x[:, 2:]]) for a, x in zip(stuck, d.xs, strict=True)]
    for column in both:
        column[100:160] = column[100] if np.ptp(column[100:160, 0]) == 0.0 else column[100:160]
    stalled = replace(d, xs=both).report()
    assert [c.suspicions for c in stalled.columns[:4]] == [("stalled: 59 readings repeat the last one",)] * 4


def test_inputs_that_do_not_tell_are_remarked() -> None:
    def told(us: list[Array]) -> str:
        d = recordings()
        return " / ".join(Episodes(d.xs, us, DT).report().remarks)

    u = [np.asarray(part) for part in recordings().us]
    rng = np.random.default_rng(0)
    assert "the inputs move in 1 of 2 directions" in told([part @ [[1.0, -1.0], [0.0, 0.0]] for part in u])
    assert "u1 and u2 move together (correlation 0.9" in told(
        [part[:, [0, 0]] + 0.15 * rng.normal(size=part.shape) for part in u]
    )
    assert "the inputs never change" in told([np.ones_like(part) for part in u])
    assert "there are no inputs" in told([part[:, :0] for part in u])
    assert "1 recording: little can be held out" in " / ".join(recordings(number=1).report().remarks)


def test_the_origin_of_all_parts_is_counted(tmp_path: Path) -> None:
    t = 0.01 * np.arange(200)
    x, u = np.column_stack([np.sin(t) + 0.5, np.cos(t)]), np.sin(3.0 * t)
    lost = x.copy()
    lost[50:53] = 0.0
    with pytest.warns(UserWarning, match="at exactly 0"):
        d = Episodes.from_arrays(t, x, u) + Episodes.from_arrays(t, lost, u)
    origin = d.report().origin
    assert (origin["samples"], origin["screened_readings"], origin["pieces"]) == (400, 3, 3)
    assert "400 samples" in str(d.report())


def test_the_report_is_json_and_a_picture(tmp_path: Path) -> None:
    for d in (recordings(1e-3), recordings(inputs=3), Episodes([np.zeros((5, 1))], [np.zeros((4, 0))], 0.1)):
        report = d.report()
        again = json.loads(json.dumps(report.as_dict(), allow_nan=False))
        assert again["episodes"] == len(d) and len(again["columns"]) == d.n_states + d.n_inputs
        report.plot(tmp_path / "d.png")
        pixels = np.asarray(Image.open(tmp_path / "d.png").convert("L"), dtype=float)
        assert pixels.shape[0] > 500 and pixels.std() > 5.0


def test_long_recordings_are_looked_at_in_little_memory() -> None:
    """Directions of inputs come from their triangular factor: samples by samples would be 20 GB here."""
    rng = np.random.default_rng(0)
    x, u = rng.normal(size=(50_001, 1)), rng.normal(size=(50_000, 2)) @ [[1.0, 0.5], [0.0, 1.0]]
    found = Episodes([x], [u], DT).input_directions()
    values = np.linalg.svd((u - u.mean(axis=0)) / u.std(axis=0).max(), compute_uv=False)
    assert found.basis.shape == (2, 2) and np.sort(found.shares) == pytest.approx(
        np.sort(values / values.max()), rel=0.1
    )
