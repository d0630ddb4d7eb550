"""Inputs that were rounded come back smooth, never further off than half a step of rounding."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

from pisplit import Episodes
from pisplit.data import unrounded

DT, N = 0.05, 300
SWING, DRIVE = np.array([[0.9, 0.3], [-0.3, 0.9]]), np.array([[0.0], [0.5]])


def smooth(seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    t = DT * np.arange(N)
    waves = [rng.uniform(0.2, 1.0) * np.sin(rng.uniform(0.3, 3.0) * t + rng.uniform(0.0, 6.0)) for _ in range(6)]
    return np.sum(waves, axis=0)[:, None]


def recorded(step: float, runs: int = 4) -> tuple[Episodes, list[np.ndarray]]:
    """A swing under smooth commands, which its log rounds."""
    us, xs = [smooth(k) for k in range(runs)], []
    for u in us:
        x = np.zeros((N + 1, 2))
        for k in range(N):
            x[k + 1] = SWING @ x[k] + DRIVE @ u[k]
        xs.append(x)
    return Episodes(xs, [step * np.round(u / step) for u in us], DT, input_names=["pull"]), us


@pytest.mark.parametrize("step", [0.02, 0.05, 0.1])
def test_smooth_commands_come_back_within_half_a_step(step: float) -> None:
    logged, true = recorded(step)
    found = unrounded(logged)
    for u, raw, exact in zip(found.us, logged.us, true, strict=True):
        assert np.abs(u - raw).max() <= 0.5 * step * (1.0 + 1e-9)
        assert np.std(u - exact) < 0.9 * np.std(raw - exact)
        rough, smoothed, least = (np.std(np.diff(v, 2, axis=0)) for v in (raw, u, exact))
        assert smoothed - least < 0.2 * (rough - least)
    assert found.provenance is not None and found.provenance["unrounded"] == [pytest.approx(step)]
    told = unrounded(logged, step)
    np.testing.assert_allclose(told.us[0], found.us[0], atol=1e-3 * step)


def test_coarse_rounding_is_said_and_what_is_exact_or_held_is_not() -> None:
    logged, true = recorded(0.1)
    assert "! pull: rounded to 0.1, " in str(logged.report())
    exact = Episodes(logged.xs, true, DT)
    assert "rounded to" not in str(exact.report())
    with pytest.raises(ValueError, match="no multiples of one step; give step="):
        unrounded(exact)
    held = Episodes(logged.xs, [np.round(np.repeat(u[::6], 6, axis=0), 1) for u in true], DT, input_names=["pull"])
    assert "rounded to" not in str(held.report())
    with pytest.warns(UserWarning, match="pull: held for most of the time, and left as logged"):
        same = unrounded(held)
    np.testing.assert_array_equal(same.us[0], held.us[0])


@pytest.mark.parametrize(("step", "said"), [(-1.0, "steps of rounding"), ([0.1, 0.1], "step"), (np.nan, "step")])
def test_wrong_steps_are_one_line(step: object, said: str) -> None:
    with pytest.raises(ValueError, match=said) as error:
        unrounded(recorded(0.1, 1)[0], step)  # type: ignore[arg-type]
    assert "\n" not in str(error.value)


def test_columns_that_are_exact_stay_to_the_last_bit() -> None:
    logged, true = recorded(0.1)
    two = Episodes(logged.xs, [np.hstack([raw, u]) for raw, u in zip(logged.us, true, strict=True)], DT)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = unrounded(two)
    np.testing.assert_array_equal(found.us[0][:, 1], true[0][:, 0])
    np.testing.assert_allclose(found.us[0][:, :1], unrounded(logged).us[0], atol=1e-12)
