"""Commands in the same table as the states whose stamps do not fit: found, said, and mended by one argument."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from pisplit import Dictionary, Episodes, LinearEDMDc
from pisplit import observables as ob

Array = NDArray[np.float64]

DT, N = 0.02, 600
#: A damped swing at 1.5 Hz, held command, exactly.
SWING = np.array([[0.978, 0.0191], [-1.70, 0.910]])
DRIVE = np.array([[0.0185], [1.78]])


def recorded(seed: int = 0, noise: float = 0.0) -> tuple[Array, Array]:
    """States (N, 2) and commands (N, 1) that each hold for the step after them; new ones at random steps."""
    rng = np.random.default_rng(seed)
    u = np.zeros((N, 1))
    for k in range(1, N):
        u[k] = rng.uniform(-1.0, 1.0) if rng.random() < 0.2 else u[k - 1]
    x = np.zeros((N, 2))
    for k in range(N - 1):
        x[k + 1] = SWING @ x[k] + DRIVE[:, 0] * u[k]
    return x + noise * rng.standard_normal(x.shape) * x.std(axis=0), u


def stamped(u: Array, late: int) -> Array:
    """The column of commands where each stands ``late`` rows too late (negative: too early)."""
    return np.vstack([np.repeat(u[:1], late, axis=0), u[: N - late]]) if late > 0 else np.vstack([u[-late:], u[late:]])


def table(path: Path, x: Array, u: Array) -> Path:
    rows = np.column_stack([DT * np.arange(N), x, u])
    np.savetxt(path, rows, delimiter=",", header="t,x,v,pull", comments="", fmt="%.10g")
    return path


def read(path: Path, **more: Any) -> Episodes:
    return Episodes.from_csv(path, "t", ["x", "v"], ["pull"], **more)


def error(found: Episodes) -> float:
    theta = Dictionary(ob.Identity(), n_states=2, n_inputs=1)
    return float(np.abs(LinearEDMDc(theta).fit(found).lifted.A - SWING).max())


@pytest.mark.parametrize("late", [3, 5, 8])
@pytest.mark.parametrize("noise", [0.0, 0.003])
def test_a_late_column_is_found_said_and_mended(tmp_path: Path, late: int, noise: float) -> None:
    x, u = recorded(late, noise)
    path = table(tmp_path / "run.csv", x, stamped(u, late))
    with pytest.warns(UserWarning, match=r"comes \d+ ms \(within \d+ ms\) before its commands: .* command_shift=-0"):
        found = read(path)
    assert found.provenance is not None
    within = found.provenance["latency_error"]
    assert found.provenance["latency"] == pytest.approx(-late * DT, abs=within) and within <= 2.0 * DT
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        mended = read(path, command_shift=-late * DT)
        read(path, command_shift=0)  # as they are, and nothing is said
    if noise == 0.0:
        assert error(mended) < 1e-6 < error(found)


def test_motion_that_follows_late_is_said_with_what_mpc_takes(tmp_path: Path) -> None:
    x, u = recorded(1)
    path = table(tmp_path / "run.csv", x, stamped(u, -4))
    with pytest.warns(UserWarning, match=r"follows its commands by 8\d ms .* command_delay=4.* command_shift=0.08"):
        read(path)


@pytest.mark.parametrize("seed", range(6))
def test_a_table_with_one_clock_is_silent(tmp_path: Path, seed: int) -> None:
    x, u = recorded(seed, noise=0.002 * (seed % 3))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = read(table(tmp_path / "run.csv", x, u))
    assert found.provenance is not None
    assert abs(found.provenance["latency"]) <= found.provenance["latency_error"]


@pytest.mark.parametrize("seed", range(6))
def test_commands_that_move_nothing_and_those_of_a_controller_are_silent(seed: int) -> None:
    rng = np.random.default_rng(seed)
    x, u = recorded(seed)
    t = DT * np.arange(N)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        Episodes.from_arrays(t, x, np.repeat(rng.standard_normal((N // 6, 1)), 6, axis=0))
        states, commands = np.zeros((N, 2)), np.zeros((N, 1))
        for k in range(N - 1):  # feedback beside a command
            commands[k] = u[k] - 0.3 * states[k, 0]
            states[k + 1] = SWING @ states[k] + DRIVE[:, 0] * commands[k]
        Episodes.from_arrays(t, states, commands)


def test_arrays_runs_and_units_are_shifted_alike() -> None:
    x, u = recorded(2)
    late = stamped(u, 5)
    t = DT * np.arange(N)
    runs = np.repeat([0, 1], N // 2)
    ms = Episodes.from_arrays(1e3 * t, x, late, episode=runs, time_unit="ms", command_shift=-0.1)
    assert len(ms) == 2 and error(ms) < 1e-6
    np.testing.assert_allclose(ms.us[0][:200], u[:200], atol=1e-12)
    with pytest.raises(ValueError, match="command_shift is not a number"):
        Episodes.from_arrays(t, x, late, command_shift="late")


@pytest.mark.parametrize("late", [-4, 0, 4])
def test_what_is_found_is_taken_away_either_way_when_asked(tmp_path: Path, late: int) -> None:
    """In a table and in arrays; a table with one clock keeps its times, and says so."""
    x, u = recorded(3)
    logged = stamped(u, late) if late else u
    path = table(tmp_path / "run.csv", x, logged)
    with pytest.warns(UserWarning, match="these are moved by that, as asked" if late else "commands keep their times"):
        found = read(path, command_shift="found")
    origin = found.provenance or {}
    assert origin["command_shift"] == pytest.approx(-late * DT, abs=0.25 * DT) and origin["latency_error"] <= 2.0 * DT
    assert error(found) < (0.3 * error(read(path, command_shift=0)) if late else 1e-6)
    with pytest.warns(UserWarning):
        alike = Episodes.from_arrays(DT * np.arange(N), x, logged, command_shift="found")
    np.testing.assert_allclose(alike.us[0], found.us[0], atol=1e-6)
