"""Pairs come from one episode each, with the history of that episode."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pisplit import Episodes, PhaseSamples


def labelled(lengths: list[int]) -> Episodes:
    """State (episode, step), input 1000 episode + step: every row says where it is from."""
    xs = [np.column_stack([np.full(t + 1, float(i)), np.arange(t + 1.0)]) for i, t in enumerate(lengths)]
    us = [1000.0 * i + np.arange(float(t))[:, None] for i, t in enumerate(lengths)]
    return Episodes(xs, us, dt=0.1)


@settings(max_examples=40, deadline=None)
@given(st.lists(st.integers(1, 7), min_size=1, max_size=5), st.integers(0, 4))
def test_no_pair_crosses_a_seam_and_none_is_lost(lengths: list[int], delays: int) -> None:
    episodes = labelled(lengths)
    expected = sum(max(t - delays, 0) for t in lengths)
    if expected == 0:
        with pytest.raises(ValueError, match="n_delays"):
            episodes.pairs(delays)
        return
    pairs = episodes.pairs(delays)
    assert len(pairs) == expected
    assert pairs.x_history.shape == (expected, delays + 1, 2)
    assert pairs.u_history.shape == (expected, delays, 1)
    k = pairs.index[:, None]
    np.testing.assert_array_equal(pairs.x_history[:, :, 0], np.repeat(pairs.episode[:, None], delays + 1, axis=1))
    np.testing.assert_array_equal(pairs.x_history[:, :, 1], k + np.arange(-delays, 1))
    np.testing.assert_array_equal(pairs.u_history[:, :, 0], 1000 * pairs.episode[:, None] + k + np.arange(-delays, 0))
    np.testing.assert_array_equal(pairs.u[:, 0], 1000 * pairs.episode + pairs.index)
    np.testing.assert_array_equal(pairs.x_next, np.column_stack([pairs.episode, pairs.index + 1]))
    np.testing.assert_array_equal(pairs.x, pairs.x_history[:, -1])


def test_samples_are_seeded_pairs_without_repetition() -> None:
    pairs = labelled([9, 5, 7]).pairs(1)
    drawn = pairs.sample(10, seed=3)
    where = {(int(e), int(i)) for e, i in zip(drawn.episode, drawn.index, strict=True)}
    assert len(where) == 10
    np.testing.assert_array_equal(drawn.row, pairs.sample(10, seed=3).row)
    assert not np.array_equal(drawn.row, pairs.sample(10, seed=4).row)
    with pytest.raises(ValueError, match="hold 18"):
        pairs.sample(19, seed=0)


def test_blocks_give_all_pairs_in_order() -> None:
    pairs = labelled([9, 5, 7]).pairs(1)
    np.testing.assert_array_equal(np.concatenate([b.row for b in pairs.blocks(4)]), pairs.row)


def test_a_start_splits_an_episode_into_history_and_rest() -> None:
    start = labelled([3, 6]).start(1, n_delays=2)
    np.testing.assert_array_equal(start.x_history[:, 1], [0, 1, 2])
    np.testing.assert_array_equal(start.u_history[:, 0], [1000, 1001])
    np.testing.assert_array_equal(start.inputs[:, 0], [1002, 1003, 1004, 1005])
    np.testing.assert_array_equal(start.states[:, 1], [2, 3, 4, 5, 6])


def test_slices_and_subsets_keep_everything(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    episodes = Episodes(
        [rng.normal(size=(t + 1, 2)) for t in (3, 4, 5)],
        [rng.normal(size=(t, 1)) for t in (3, 4, 5)],
        dt=0.03,
        state_names=("p", "q"),
        input_names=("pull",),
        quantities=("p", "q"),
        units=("m", "m/s"),
        outputs={"tip": (0,)},
        extra={"raw": [np.full((t, 3), t) for t in (3, 4, 5)]},
        provenance={"seed": 7},
    )
    assert len(episodes[1:]) == 2
    part = episodes.subset([2, 0])
    np.testing.assert_array_equal(part.xs[0], episodes.xs[2])
    assert part.extra is not None and part.extra["raw"][0][0, 0] == 5
    part.save(tmp_path / "d1.h5")
    loaded = Episodes.load(tmp_path / "d1.h5")
    for name in ("dt", "state_names", "input_names", "quantities", "units", "outputs", "provenance"):
        assert getattr(loaded, name) == getattr(episodes, name), name
    for a, b in zip(loaded.xs, part.xs, strict=True):
        np.testing.assert_array_equal(a, b)
    assert loaded.extra is not None
    np.testing.assert_array_equal(loaded.extra["raw"][1], part.extra["raw"][1])


def test_the_input_subspace_of_zero_sum_inputs_is_a_plane() -> None:
    rng = np.random.default_rng(0)
    u = rng.normal(size=(50, 3))
    u -= u.mean(axis=1, keepdims=True)
    offset, basis = Episodes([np.zeros((51, 1))], [u + 0.5], dt=0.1).input_subspace()
    np.testing.assert_allclose(offset, u.mean(axis=0) + 0.5)
    assert basis.shape == (3, 2)
    np.testing.assert_allclose(basis.T @ basis, np.eye(2), atol=1e-12)
    np.testing.assert_allclose(basis.T @ np.ones(3), 0, atol=1e-12)
    _, constant = Episodes([np.zeros((51, 1))], [np.full((50, 3), 0.1)], dt=0.1).input_subspace()
    assert constant.shape == (3, 0)


X, U = np.zeros((4, 2)), np.zeros((3, 1))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"xs": [], "us": []}, ">= 1"),
        ({"xs": [X], "us": [U, U]}, "as many of both"),
        ({"xs": X, "us": U}, "lists of arrays"),
        ({"xs": [X[:1]], "us": [U[:0]]}, "at least two"),
        ({"xs": [X], "us": [U[:2]]}, "expected 3"),
        ({"xs": [X, np.zeros((4, 3))], "us": [U, U]}, "xs\\[1\\] has shape"),
        ({"xs": [X], "us": [np.full((3, 1), np.nan)]}, "3 NaN"),
        ({"xs": [X], "us": [U], "dt": 0.0}, "dt = 0"),
        ({"xs": [X], "us": [U], "state_names": ["a"]}, "expected 2"),
        ({"xs": [X], "us": [U], "state_names": ["a", "a"]}, "repeats"),
        ({"xs": [X], "us": [U], "outputs": {"tip": (2,)}}, "from 0 to 1"),
        ({"xs": [X], "us": [U], "extra": {"raw": []}}, "one an episode"),
        ({"xs": [X], "us": [U], "provenance": {"f": np.sin}}, "JSON"),
    ],
)
def test_bad_episodes_are_refused_in_one_line(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message) as error:
        Episodes(**{"dt": 0.1, **arguments})
    assert "\n" not in str(error.value)


def test_bad_phase_samples_are_refused() -> None:
    for arguments, message in (
        ((X, np.zeros((3, 1)), X), "u has shape"),
        ((X, np.zeros((4, 1)), np.zeros((4, 3))), "xdot has shape"),
        ((X[:0], U[:0], X[:0]), "no rows"),
        ((X, np.zeros((4, 1)), X, X), "without dt"),
    ):
        with pytest.raises(ValueError, match=message):
            PhaseSamples(*arguments)


def test_masks_of_extra_arrays_are_not_dropped() -> None:
    with pytest.raises(ValueError, match="masked, which would be lost"):
        Episodes([np.zeros((3, 1))], [np.zeros((2, 1))], 0.1, extra={"state": [np.ma.masked_equal([0, 1, 2], 1)]})
