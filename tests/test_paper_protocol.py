"""Draws, roll-out errors and summaries of a protocol."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pisplit import Dictionary, Episodes, LinearEDMDc, PhaseSamples
from pisplit import observables as ob

SCRIPTS = Path(__file__).parent.parent / "scripts"


@pytest.fixture(scope="module")
def protocol() -> Any:
    sys.path.insert(0, str(SCRIPTS))
    try:
        return importlib.import_module("common.protocol")
    finally:
        sys.path.remove(str(SCRIPTS))


@pytest.fixture(scope="module")
def episodes() -> Episodes:
    """A stable linear system: two points and a distal velocity, known exactly."""
    rng = np.random.default_rng(0)
    a = 0.9 * np.linalg.qr(rng.normal(size=(9, 9)))[0]
    b = rng.normal(size=(9, 2))
    xs, us = [], []
    for _ in range(9):
        u, x = rng.normal(size=(20, 2)), [rng.normal(size=9)]
        for move in u:
            x.append(a @ x[-1] + b @ move)
        xs.append(np.array(x))
        us.append(u)
    return Episodes(xs, us, dt=0.1, outputs={"shape": range(6), "tip_velocity": range(6, 9)})


def test_pairs_are_distinct_nested_and_leave_held_out_episodes_alone(protocol: Any, episodes: Episodes) -> None:
    total = protocol.all_pairs(episodes)
    assert total == (9 - protocol.HELD_OUT) * (20 - protocol.HISTORY)
    rows = protocol.random_pairs(episodes, total, seed=3)
    assert len({tuple(row) for row in rows}) == total
    assert rows[:, 0].max() < 9 - protocol.HELD_OUT and rows[:, 1].min() == protocol.HISTORY
    np.testing.assert_array_equal(protocol.random_pairs(episodes, 7, seed=3), rows[:7])
    with pytest.raises(ValueError, match="81 pairs"):
        protocol.random_pairs(episodes, total + 1, seed=3)


def test_one_recording_is_consecutive_steps_of_one_training_episode(protocol: Any, episodes: Episodes) -> None:
    for seed in range(5):
        rows = protocol.contiguous(episodes, 12, seed)
        assert len(set(rows[:, 0])) == 1 and rows[0, 0] < 9 - protocol.HELD_OUT
        np.testing.assert_array_equal(np.diff(rows[:, 1]), 1)
        assert rows[0, 1] >= protocol.HISTORY and rows[-1, 1] < 20
    with pytest.raises(ValueError, match="17 steps"):
        protocol.contiguous(episodes, 17, 0)


def test_pairs_of_a_draw_are_those_of_the_episodes(protocol: Any, episodes: Episodes) -> None:
    rows = protocol.random_pairs(episodes, 11, seed=1)
    pairs = protocol.pairs_at(episodes, rows, 2)
    for i, (episode, k) in enumerate(rows):
        x, u = episodes.xs[episode], episodes.us[episode]
        np.testing.assert_array_equal(pairs.x[i], x[k])
        np.testing.assert_array_equal(pairs.x_next[i], x[k + 1])
        np.testing.assert_array_equal(pairs.u[i], u[k])
        np.testing.assert_array_equal(pairs.x_history[i], x[k - 2 : k + 1])
        np.testing.assert_array_equal(pairs.u_history[i], u[k - 2 : k])


@pytest.mark.parametrize("delays", [0, 2, 4])
def test_an_exact_model_has_no_error_whatever_its_delays(protocol: Any, episodes: Episodes, delays: int) -> None:
    parts = [ob.Identity()] + ([ob.Delays(states=delays)] if delays else [])
    theta = Dictionary(*parts, n_states=9, n_inputs=2)
    draw = protocol.Draw(
        "any", episodes, protocol.random_pairs(episodes, 70, 0), PhaseSamples(*3 * [np.ones((1, 9))]), 0
    )
    model = LinearEDMDc(theta, alpha=1e-14).fit(draw.episodes, pairs=draw.pairs(delays)).lifted
    errors = protocol.evaluate(protocol.Lifted(model), draw.held_out)
    assert errors.shape.shape == errors.velocity.shape == (protocol.HELD_OUT, 20 - protocol.HISTORY)
    assert errors.diverged == 0.0 and errors.shape.max() < 1e-12 and errors.velocity.max() < 1e-12


def test_divergent_roll_outs_are_infinite_from_their_step_on_and_counted(protocol: Any, episodes: Episodes) -> None:
    def predictor(test: Episodes, start: int) -> Any:
        truth = np.stack([x[start + 1 :] for x in test.xs])
        points, velocity = truth[:, :, :6].copy(), truth[:, :, 6:].copy()
        points[:, :, 0] += 0.5
        points[0, 7, 1] = np.nan
        points[1, 3, 2] += 1e200
        return protocol.Prediction(points, velocity, np.array([-1, -1, 5, -1]))

    errors = protocol.evaluate(predictor, episodes[-4:])
    np.testing.assert_array_equal(errors.diverged_at, [7, 3, 5, -1])
    assert np.isinf(errors.shape[0, 7:]).all() and np.isinf(errors.velocity[1, 3:]).all()
    np.testing.assert_allclose(errors.shape[np.isfinite(errors.shape)], 0.25)
    found = protocol.summary([errors])
    # 31 of 64 steps are finite.
    assert found.diverged == 0.75 and found.lower == pytest.approx(0.25) and np.isinf(found.median)


def test_quartiles_pool_steps_roll_outs_and_draws(protocol: Any) -> None:
    parts = [
        protocol.Errors(np.full((2, 5), value), np.full((2, 5), 10.0 * value), np.array([-1, -1]))
        for value in (1.0, 2.0, 3.0, 4.0)
    ]
    found = protocol.summary(parts, "velocity")
    assert (found.lower, found.median, found.upper, found.diverged) == (10.0, 20.0, 30.0, 0.0)
