"""Readings that are none: what a tracker writes where it saw nothing is missing, what a robot did at rest is kept."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from pisplit import Dictionary, Episodes, LinearEDMDc
from pisplit import observables as ob

Array = NDArray[np.float64]

DT, N = 0.02, 300
TURN = 5.0 * DT
A = 0.97 * np.array([[np.cos(TURN), np.sin(TURN)], [-np.sin(TURN), np.cos(TURN)]])


def arm(hold: int = 5, seed: int = 0, digits: int | None = None, offset: float = 0.3) -> tuple[Array, Array, Array]:
    """Times, two markers (N, 6) that hang at ``offset``, and commands (N, 2) of two oscillators; noise-free."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform(-1.0, 1.0, (N // hold + 1, 2)), hold, axis=0)[:N]
    q = np.zeros((N, 2, 2)) if not offset else np.full((N, 2, 2), 0.01)
    for k in range(N - 1):
        q[k + 1] = q[k] @ A.T + np.outer(u[k], [0.005, 0.03])
    tip = np.column_stack([q[:, 0, 0], q[:, 1, 0], offset + 0.2 * q[:, 0, 0] - 0.1 * q[:, 1, 0]])
    x = np.hstack([tip, tip @ [[0.4, 0.1, 0.0], [-0.1, 0.5, 0.1], [0.0, 0.0, 0.5]] + offset])
    return DT * np.arange(N), x if digits is None else np.round(x, digits), u


def load(x: Array, u: Array, t: Array | None = None, **options: Any) -> Episodes:
    return Episodes.from_arrays(DT * np.arange(N) if t is None else t, x, u, **options)


TRUE, U = arm()[1:]


def screened(episodes: Episodes) -> dict[str, dict[str, int]]:
    found: dict[str, dict[str, int]] = (episodes.provenance or {}).get("screened", {})
    return found


@pytest.mark.parametrize("length", [1, 3, 30])
@pytest.mark.parametrize("start", [0, 111, -1], ids=["first", "middle", "last"])
@pytest.mark.parametrize("columns", [slice(0, 6), slice(3, 6)], ids=["tracker", "marker"])
def test_zeros_of_lost_markers_are_missing(columns: slice, start: int, length: int) -> None:
    x = TRUE.copy()
    first = start if start >= 0 else N - length
    x[first : first + length, columns] = 0.0
    with pytest.warns(UserWarning, match=rf"{length} of {N} readings, from .* at exactly 0, far from"):
        found = load(x, U, max_gap=0.1)
    lost = len(range(*columns.indices(6)))
    assert screened(found) == {"at 0": {f"x{i + 1}": length for i in range(6)[columns]}} and lost in (3, 6)
    for piece in found.xs:  # what is left is the arm: bridged over three samples, cut at thirty
        at = int(np.argmin(np.abs(TRUE - piece[0]).sum(axis=1)))
        np.testing.assert_allclose(piece, TRUE[at : at + len(piece)], atol=0.03)
    assert [len(x) for x in load(x, U, max_gap=0.1, screen=()).xs] == [N]


def test_a_logger_s_own_value_is_missing_and_said() -> None:
    x = TRUE.copy()
    x[50:52] = x[200] = -9999.0
    with pytest.warns(UserWarning, match="at exactly -9999"):
        found = load(x, U)
    np.testing.assert_allclose(found.xs[0], TRUE, atol=0.03)


@pytest.mark.parametrize("length", [1, 3, 25])
@pytest.mark.parametrize("columns", [slice(0, 6), slice(3, 6)], ids=["tracker", "marker"])
def test_what_a_stalled_tracker_repeats_is_missing(columns: slice, length: int) -> None:
    x = TRUE.copy()
    x[121 : 121 + length, columns] = x[120, columns]
    if length == 1 and columns.start:
        with warnings.catch_warnings():  # a single repeat of one marker is less than a usual step off
            warnings.simplefilter("error")
            load(x, U)
        return
    with pytest.warns(UserWarning, match=f"{length} of {N} readings, from 2.42 s on, that repeat the last one"):
        found = load(x, U, max_gap=0.1)
    assert screened(found) == {"stalled": {f"x{i + 1}": length for i in range(6)[columns]}}
    np.testing.assert_allclose(found.xs[0], TRUE[: len(found.xs[0])], atol=0.03)
    assert len(found) == (1 if length < 5 else 2)
    assert screened(load(x, U, screen="zeros")) == {}


def test_a_model_is_exact_again_without_what_was_no_reading() -> None:
    """One oscillator, seen whole: stalls and zeros cut the recording, and what is left obeys its law to the digit."""
    rng = np.random.default_rng(3)
    u, x = rng.uniform(-1.0, 1.0, (N, 1)), np.zeros((N, 2))
    for k in range(N - 1):
        x[k + 1] = A @ x[k] + [0.05, 0.3] * u[k]
    x[100:130], x[200:215] = x[99], 0.0
    theta = Dictionary(ob.Identity(), n_states=2, n_inputs=1)
    with pytest.warns(UserWarning, match="readings"):
        mended = LinearEDMDc(theta).fit(load(x, u, max_gap=1.5 * DT)).lifted.A
    np.testing.assert_allclose(mended, A, atol=1e-10)
    assert np.abs(LinearEDMDc(theta).fit(load(x, u, screen=())).lifted.A - A).max() > 0.01


@pytest.mark.parametrize("period", [2, 4, 10])
def test_a_slow_camera_in_a_fast_log_is_read_at_its_own_rate(period: int) -> None:
    t, x, u = arm(hold=7)
    held = x[(np.arange(N) // period) * period]
    with pytest.warns(UserWarning, match=f"new at every {period}. sample only"):
        found = load(held, u)
    assert found.dt == pytest.approx(period * DT)
    np.testing.assert_allclose(found.xs[0], x[::period][: len(found.xs[0])], atol=1e-12)
    assert t[-1] == pytest.approx((N - 1) * DT)


@pytest.mark.parametrize("digits", [None, 3, 2], ids=["fine", "coarse", "coarser"])
@pytest.mark.parametrize("hold", [1, 20, 100])
@pytest.mark.parametrize("offset", [0.0, 0.3], ids=["at zero", "hanging"])
def test_rest_coarse_sensors_and_starts_from_zero_are_left_alone(hold: int, digits: int | None, offset: float) -> None:
    for seed in range(3):
        t, x, u = arm(hold, seed, digits, offset)
        u[:10] = u[150:200] = 0.0
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            for columns in (slice(0, 6), slice(0, 2), slice(0, 1)):
                assert screened(load(x[:, columns], u, t)) == {}


def settle(u: Array) -> Array:
    """A plant that is there within a step, read by a sensor of four digits."""
    return np.round(np.vstack([np.zeros((1, 2)), u[:-1] @ [[0.3, 0.1], [-0.1, 0.4]]]), 4)


def test_what_a_robot_does_is_no_fault_of_its_sensors() -> None:
    """A step from rest, an end stop, a joint that waits for its command, a setpoint among the states."""
    t, x, u = arm()
    step = np.ones((N, 1))
    step[:40] = 0.0
    rng = np.random.default_rng(0)
    waits = np.repeat(np.arange(60), rng.integers(2, 12, 60))[:N]
    in_turn = np.cumsum(np.where(np.arange(60)[:, None] // 5 % 2 == [0, 1], rng.normal(size=(60, 2)), 0.0), axis=0)[
        waits
    ]
    cases = [
        (np.round(1.0 - np.exp(-np.maximum(t - 40 * DT, 0.0) / 0.1), 4)[:, None] * [1.0, 2.0], step),
        (np.clip(x[:, :2], -0.05, 0.05), u),
        (settle(in_turn), in_turn),
        (np.column_stack([x[:, 0], np.repeat(u[::10, 0], 10)]), np.repeat(u[::10], 10, axis=0)),
    ]
    for states, inputs in cases:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            assert screened(load(states, inputs, t)) == {}


def test_what_is_screened_is_chosen_by_name() -> None:
    with pytest.raises(ValueError, match=r"screen names 'spikes'; expected any of 'zeros', 'stalls', or \(\)"):
        load(TRUE, U, screen=["spikes"])


def test_a_body_that_is_lost_is_turned_by_nothing() -> None:
    """Position zero and quaternion (0, 0, 0, 1): the last is missing with the others."""
    t, x, u = arm()
    turned = np.column_stack([0.1 * x[:, :3], np.sqrt(1.0 - 0.01 * (x[:, :3] ** 2).sum(axis=1))])
    body = np.column_stack([x[:, :3], turned])
    body[80:90] = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]
    with pytest.warns(UserWarning, match="at exactly 1"):
        found = load(body, u, t)
    assert screened(found) == {"at 0": {f"x{i + 1}": 10 for i in range(6)}, "at 1": {"x7": 10}}


def test_a_sensor_that_was_off_is_said() -> None:
    with pytest.warns(UserWarning, match="x1 is 0 in all 300 readings, and no state moves: was the sensor on"):
        load(np.zeros((N, 3)), U)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        load(np.zeros((N, 3)), np.zeros((N, 1)))
