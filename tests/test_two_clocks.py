"""Sensors and commands that were logged apart: each on its own clock, brought together; what lies between is told."""

from __future__ import annotations

import importlib
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from pisplit import Dictionary, Episodes, LinearEDMDc
from pisplit import observables as ob
from pisplit.data.latency import find_latency

Array = NDArray[np.float64]

DT, N = 0.02, 400
TURN = 10.0 * DT
SWING = 0.96 * np.array([[np.cos(TURN), np.sin(TURN)], [-np.sin(TURN), np.cos(TURN)]])


def swing(seed: int = 0, delay: int = 0, hold: int = 4) -> tuple[Array, Array]:
    """States (N, 2) of an oscillator and commands (N, 1) that act ``delay`` steps later."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform(-1.0, 1.0, (N // hold + 1, 1)), hold, axis=0)[:N]
    x = np.zeros((N, 2))
    for k in range(N - 1):
        x[k + 1] = SWING @ x[k] + [0.02, 0.2] * u[max(k - delay, 0)]
    return x, u


def written(
    folder: Path, late: float = 0.0, seed: int = 0, start: float = 100.0, name: str = "0"
) -> tuple[Array, Array]:
    """Files of sensors (50 Hz), and of commands where they change, whose stamps are ``late`` [s]."""
    x, u = swing(seed)
    t = start + DT * np.arange(N)
    rows = [f"{a:.6f},{b!r},{c!r}" for a, (b, c) in zip(t.tolist(), x.tolist(), strict=True)]
    (folder / f"run{name}.csv").write_text("\n".join(["t,x,v", *rows]) + "\n")
    new = np.flatnonzero(np.append(True, np.diff(u[:, 0]) != 0.0))
    sent = [f"{t[k] + late:.6f},{float(u[k, 0])!r}" for k in new]
    (folder / f"servo{name}.csv").write_text("\n".join(["stamp,pull", *sent]) + "\n")
    return x, u


ASK: dict[str, Any] = {"time": "t", "states": ["x", "v"], "inputs": ["pull"], "command_time": "stamp"}


def exact(found: Episodes) -> float:
    theta = Dictionary(ob.Identity(), n_states=2, n_inputs=1)
    return float(np.abs(LinearEDMDc(theta).fit(found).lifted.A - SWING).max())


def test_commands_are_held_on_the_clock_of_the_sensors(tmp_path: Path) -> None:
    x, u = written(tmp_path)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = Episodes.from_csv(tmp_path / "run0.csv", **ASK, commands=tmp_path / "servo0.csv")
    np.testing.assert_allclose(found.xs[0], x, atol=1e-9)
    np.testing.assert_allclose(found.us[0], u[:-1], atol=1e-9)
    assert found.provenance is not None and abs(found.provenance["latency"]) <= found.provenance["latency_error"]
    assert found.provenance["command_shift"] == 0.0 and found.provenance["commands"] == ["servo0.csv"]
    assert exact(found) < 1e-8


@pytest.mark.parametrize("late", [0.05, 0.08, 0.2])
def test_commands_that_are_stamped_late_are_moved_back_and_it_is_said(tmp_path: Path, late: float) -> None:
    """The motion cannot come before its command."""
    written(tmp_path, late)
    files = {"path": tmp_path / "run0.csv", "commands": tmp_path / "servo0.csv"}
    with pytest.warns(UserWarning, match=r"the motion comes \d+ ms \(within \d+ ms\) before its commands"):
        found = Episodes.from_csv(**files, **ASK)
    assert found.provenance is not None
    assert found.provenance["command_shift"] == pytest.approx(-late, abs=found.provenance["latency_error"])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        known = Episodes.from_csv(**files, **ASK, command_shift=-late)
    assert exact(known) < 1e-8


def test_commands_that_act_later_are_left_and_said(tmp_path: Path) -> None:
    written(tmp_path, -0.1)
    with pytest.warns(UserWarning, match=r"follows its commands by \d+ ms .* MPC takes as command_delay|of clocks"):
        found = Episodes.from_csv(tmp_path / "run0.csv", **ASK, commands=tmp_path / "servo0.csv")
    assert found.provenance is not None and found.provenance["command_shift"] == 0.0
    assert found.provenance["latency"] == pytest.approx(0.1, abs=found.provenance["latency_error"])
    with pytest.warns(UserWarning, match="these are moved by that, as asked"):
        moved = Episodes.from_csv(tmp_path / "run0.csv", **ASK, commands=tmp_path / "servo0.csv", command_shift="found")
    assert moved.provenance is not None and abs(moved.provenance["latency"]) < 1e-12
    assert exact(moved) < 0.2 * exact(found)


def test_files_go_together_by_their_place_or_all_with_one(tmp_path: Path) -> None:
    for k in range(2):
        written(tmp_path, seed=k, start=100.0 + 20.0 * k, name=str(k))
    each = Episodes.from_csv(str(tmp_path / "run*.csv"), **ASK, commands=str(tmp_path / "servo*.csv"))
    whole = tmp_path / "all.csv"
    whole.write_text((tmp_path / "servo0.csv").read_text() + (tmp_path / "servo1.csv").read_text().split("\n", 1)[1])
    one = Episodes.from_csv(str(tmp_path / "run*.csv"), **ASK, commands=whole)
    assert len(each) == len(one) == 2 and exact(each) < 1e-8
    np.testing.assert_array_equal(each.stacked_states(), one.stacked_states())
    np.testing.assert_allclose(each.stacked_inputs(), one.stacked_inputs(), atol=1e-12)
    with pytest.raises(ValueError, match="1 files of sensors, 2 of commands"):
        Episodes.from_csv(tmp_path / "run0.csv", **ASK, commands=str(tmp_path / "servo*.csv"))


def test_clocks_of_other_units_and_dates_meet(tmp_path: Path) -> None:
    x, u = written(tmp_path, start=0.0)
    stamps = np.array(["2026-11-27T23:59:58"], "M8[us]") + (1e6 * DT * np.arange(N)).astype("m8[us]")
    sensors = "\n".join(["t,x,v", *(f"{t},{a!r},{b!r}" for t, (a, b) in zip(stamps, x.tolist(), strict=True))])
    commands = "\n".join(["stamp,pull", *(f"{t},{v!r}" for t, v in zip(stamps, u[:, 0].tolist(), strict=True))])
    for text, name in ((sensors, "a.csv"), (commands, "b.csv")):
        (tmp_path / name).write_text(text)
    found = Episodes.from_csv(tmp_path / "a.csv", **ASK, commands=tmp_path / "b.csv")
    np.testing.assert_allclose(found.us[0], u[:-1], atol=1e-9)
    ticks = [f"{1_790_000_000_000_000_000 + 20_000_000 * k}" for k in range(N)]
    for values, name, head in ((x.tolist(), "c.csv", "t [ns],x,v"), (u.tolist(), "d.csv", "stamp [ns],pull")):
        rows = [",".join([t, *map(repr, v)]) for t, v in zip(ticks, values, strict=True)]
        (tmp_path / name).write_text("\n".join([head, *rows]))
    found = Episodes.from_csv(tmp_path / "c.csv", **ASK, commands=tmp_path / "d.csv")
    np.testing.assert_allclose(found.us[0], u[:-1], atol=1e-9)
    with pytest.raises(ValueError, match="do not both have dates"):
        Episodes.from_csv(tmp_path / "c.csv", **ASK, commands=tmp_path / "b.csv")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"start": 900.0}, "have no time in common; give time_unit, or command_shift"),
        ({"options": {"time": None, "dt": DT}}, "need times in both"),
        ({"options": {"command_shift": "late"}}, "command_shift is not a number"),
    ],
)
def test_what_does_not_meet_is_one_line(tmp_path: Path, change: dict[str, Any], message: str) -> None:
    written(tmp_path, name="0")
    written(tmp_path, start=change.get("start", 100.0), name="1")
    ask = {**ASK, **change.get("options", {})}
    with pytest.raises(ValueError, match=message) as error:
        Episodes.from_csv(tmp_path / "run0.csv", **ask, commands=tmp_path / "servo1.csv")
    assert "\n" not in str(error.value)


def test_a_shift_without_commands_apart_is_refused(tmp_path: Path) -> None:
    written(tmp_path)
    with pytest.raises(ValueError, match="give commands="):
        Episodes.from_csv(tmp_path / "run0.csv", "t", ["x", "v"], [], command_time="stamp")


@pytest.mark.parametrize("delay", [-3, 0, 2, 5])
@pytest.mark.parametrize("noise", [0.0, 1e-3])
@pytest.mark.parametrize("columns", [[0, 1], [0]], ids=["whole state", "position"])
def test_the_delay_of_a_linear_system_is_found_within_what_is_told(
    columns: list[int], noise: float, delay: int
) -> None:
    x, u = swing(3, max(delay, 0))
    if delay < 0:
        x, u = x[-delay:], u[:delay]
    x = x[:, columns] + noise * np.random.default_rng(0).normal(size=(len(x), len(columns)))
    found = find_latency([x], [u[:-1]], DT)
    assert found.delay is not None and abs(found.delay - delay * DT) <= found.error <= 2.0 * DT


@pytest.mark.parametrize("explored", [0.1, 1.0])
@pytest.mark.parametrize("noise", [0.0, 1e-3])
def test_commands_of_a_controller_do_not_look_early(explored: float, noise: float) -> None:
    """Feedback knows the motion, and yet acts on it: the delay is none."""
    rng = np.random.default_rng(0)
    wanted = np.repeat(rng.uniform(-1.0, 1.0, N // 20), 20)
    x, u = np.zeros((N, 2)), np.zeros((N - 1, 1))
    for k in range(N - 1):
        seen = x[k] + noise * rng.normal(size=2)
        u[k] = 3.0 * (wanted[k] - seen[0]) - 2.0 * seen[1] + explored * rng.normal()
        x[k + 1] = SWING @ x[k] + [0.02, 0.2] * u[k]
    found = find_latency([x], [u], DT)
    assert found.delay is not None and abs(found.delay) <= found.error <= 2.0 * DT


def test_a_counter_of_frames_is_no_unit_of_commands(tmp_path: Path) -> None:
    x, u = swing()
    frames = [f"{k},{a!r},{b!r}" for k, (a, b) in enumerate(x.tolist())]
    (tmp_path / "run.csv").write_text("\n".join(["t,x,v", *frames]))
    for scale in (1.0, 1e3):
        sent = [f"{scale * DT * k:.6f},{float(u[k, 0])!r}" for k in range(N)]
        (tmp_path / "servo.csv").write_text("\n".join(["stamp,pull", *sent]))
        ask = {
            **ASK,
            "time_unit": DT,
            "commands": tmp_path / "servo.csv",
            "command_time_unit": "ms" if scale > 1 else None,
        }
        found = Episodes.from_csv(tmp_path / "run.csv", **ask)
        np.testing.assert_allclose(found.us[0], u[:-1], atol=1e-6)
    with pytest.warns(UserWarning, match="are its times in another unit. give command_time_unit"):
        Episodes.from_csv(tmp_path / "run.csv", **{**ask, "command_time_unit": "us"})


def test_of_commands_of_one_time_the_last_counts(tmp_path: Path) -> None:
    _, u = written(tmp_path)
    head, *rows = (tmp_path / "servo0.csv").read_text().splitlines()
    twice = [line for row in rows for line in (f"{row.split(',')[0]},7.0", row)]
    (tmp_path / "servo0.csv").write_text("\n".join([head, *twice]) + "\n")
    found = Episodes.from_csv(tmp_path / "run0.csv", **ASK, commands=tmp_path / "servo0.csv")
    np.testing.assert_allclose(found.us[0], u[:-1], atol=1e-9)


def test_a_steady_command_log_that_stops_or_pauses_is_said(tmp_path: Path) -> None:
    x, u = swing()
    t = DT * np.arange(N)
    rows = [f"{a:.6f},{b!r},{c!r}" for a, (b, c) in zip(t.tolist(), x.tolist(), strict=True)]
    (tmp_path / "run.csv").write_text("\n".join(["t,x,v", *rows]) + "\n")
    sent = [f"{a:.6f},{b!r}" for a, b in zip(t.tolist(), u[:, 0].tolist(), strict=True)]
    for kept, said in (([*sent[:200]], r"ends 4 s before run.csv"), ([*sent[:200], *sent[250:]], "pauses for 1.02 s")):
        (tmp_path / "servo.csv").write_text("\n".join(["stamp,pull", *kept]) + "\n")
        with pytest.warns(UserWarning, match=said):
            Episodes.from_csv(tmp_path / "run.csv", **ASK, commands=tmp_path / "servo.csv", command_shift=0.0)


def test_no_delay_is_told_where_inputs_say_nothing() -> None:
    rng = np.random.default_rng(0)
    x = swing()[0]
    for u in (np.zeros((N - 1, 1)), rng.normal(size=(N - 1, 1))):
        found = find_latency([x], [u], DT)
        assert found.delay is None and "not visible" in str(found)
    assert find_latency([x[:8]], [rng.normal(size=(7, 1))], DT).delay is None


def test_the_messy_log_of_the_script_is_what_was_simulated(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(Path(__file__).parent.parent / "scripts"))
    messy_log = importlib.import_module("messy_log")
    rng = np.random.default_rng(1)
    truths = [messy_log.simulated(rng, 6.0) for _ in range(2)]
    spoilt = messy_log.write(tmp_path, truths, rng)
    with pytest.warns(UserWarning, match="at exactly 0|repeat the last one|before its commands"):
        found = messy_log.load(tmp_path)
    assert found.provenance is not None and found.units == ("m",) * 3 and found.input_units == ("Pa",) * 2
    taken = sum(max(names.values()) for names in found.provenance["screened"].values())
    assert taken == spoilt - 2 * 3  # three cells of each run are empty
    assert found.provenance["command_shift"] == pytest.approx(-messy_log.LATE, abs=found.provenance["latency_error"])
    assert messy_log.worst_difference(found, truths) < 1e-3
