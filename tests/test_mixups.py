"""Columns that stand in each other's place in a part of a recording, or in one file of several, without a jump."""

from __future__ import annotations

import re
import warnings
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from test_late_commands import recorded
from test_screening import arm

from pisplit import Episodes
from pisplit.models import systems

Array = NDArray[np.float64]

DT, N = 0.02, 300


def said(t: Array | None, x: Array, u: Array, **options: object) -> list[str]:
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        Episodes.from_arrays(t, x, u, **options)  # type: ignore[arg-type]
    return [str(w.message) for w in found]


def noisy(seed: int, hold: int = 5) -> tuple[Array, Array, Array]:
    """Two markers, with noise of 0.1 % of their spread, and the commands of two motors that hold."""
    t, x, u = arm(hold, seed)
    return t, x + 1e-3 * x.std(axis=0) * np.random.default_rng(seed).standard_normal(x.shape), u


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("hold", [1, 5, 20])
@pytest.mark.parametrize(
    ("columns", "factors", "text"),
    [
        ([1, 0], [1, 1], "u1 and u2 have changed places: so it looks"),
        ([0, 1], [1, -1], "u2 has turned the sign"),
        ([0, 1], [1e-3, 1], r"u1 is (1e\+03|0.001) times as large"),
    ],
    ids=["cables", "sign", "unit"],
)
def test_commands_of_motors_that_are_exchanged_turned_or_in_another_unit_are_said(
    columns: list[int], factors: list[float], text: str, hold: int, seed: int
) -> None:
    for t, x, u in (arm(hold, seed), noisy(seed, hold)):
        v, at = u.copy(), 120 + 20 * seed
        v[at:] = u[at:, columns] * factors
        lines = said(t, x, v)
        assert len(lines) == 1 and re.search(text, lines[0]), lines


@pytest.mark.parametrize("odd", [0, 2, 3])
@pytest.mark.parametrize("noise", [0.0, 3e-3])
def test_a_file_of_another_order_sign_or_unit_is_said(tmp_path: Path, odd: int, noise: float) -> None:
    """Four files of a session, without headers: one was written by another version of the logger."""
    changes = {
        "x1 and x2 have changed places": lambda x: x[:, [1, 0, 2, 3, 4, 5]],
        "x1 and x4, x2 and x5, x3 and x6 have changed places": lambda x: x[:, [3, 4, 5, 0, 1, 2]],
        "x2 has turned the sign": lambda x: x * [1, -1, 1, 1, 1, 1],
        r"all states are (1e\+03|0.001) times": lambda x: 1e-3 * x,
    }
    ask = ("t", [f"x{k + 1}" for k in range(6)], ["u1", "u2"])
    for text, change in {"": lambda x: x, **changes}.items():
        for k in range(4):
            t, x, u = arm(5, k)
            x = x + noise * x.std(axis=0) * np.random.default_rng(k).standard_normal(x.shape)
            np.savetxt(tmp_path / f"run{k}.csv", np.column_stack([t, change(x) if k == odd else x, u]), "%.8g", ",")
        with warnings.catch_warnings(record=True) as found:
            warnings.simplefilter("always")
            Episodes.from_csv(str(tmp_path / "run*.csv"), *ask, names=[ask[0], *ask[1], *ask[2]])
        lines = [str(w.message) for w in found]
        assert (len(lines) == 1 and re.search(text, lines[0])) if text else not lines, (text, lines)
        assert not text or re.search(r"from run\d\.csv, \S+ s to run\d\.csv,", lines[0])


def test_a_state_that_changes_places_where_both_are_equal_is_said() -> None:
    """An oscillator's position and speed: there is no jump that tells."""
    x, u = recorded(0, 0.003)
    x[300:] = x[300:, ::-1]
    at = 300 + int(np.abs(x[300:, 0] - x[300:, 1]).argmin())
    assert any("x1 and x2 have changed places" in line for line in said(DT * np.arange(len(x)), x, u)), at


@pytest.mark.parametrize("seed", range(3))
def test_plants_in_other_places_and_of_other_sizes_are_left_alone(seed: int) -> None:
    """Not linear, at rest, ringing down: what was learned in a part fits the rest badly, and that is all."""
    rng = np.random.default_rng(seed)
    for system in (systems.duffing(), systems.van_der_pol(), systems.slow_manifold()):
        runs, states, inputs = [], [], []
        for k, size in enumerate((0.01, 0.1, 1.0, 3.0, 0.0, 1.0)):
            v = size * np.repeat(rng.uniform(-1.0, 1.0, (30, system.n_inputs)), 8, axis=0)
            x = system.simulate(rng.uniform(-1.0, 1.0, system.n_states) * (1.0, 1.0, 1.0, 0.1, 2.0, 0.5)[k], v, 0.05)
            states.append(x)
            inputs.append(np.vstack([v, v[-1:]]))
            runs += [k] * len(x)
        lines = said(None, np.vstack(states), np.vstack(inputs), dt=0.05, episode=np.array(runs))
        assert not [line for line in lines if "so it looks" in line], lines
