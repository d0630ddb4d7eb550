"""alpha="cv" on little data: folds over recordings, roll-outs of limited length, and what it says against itself."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from pisplit import Dictionary, Episodes, LiftedModel, LinearEDMDc, horizon_errors, rollout_errors
from pisplit import observables as ob
from pisplit.estimators.fold_errors import FoldErrors, reasons
from pisplit.estimators.folds import Fold, fold_moments, make_folds
from pisplit.splitting import pair_moments

A = np.array([[0.9, 0.2], [-0.1, 0.8]])
B = np.array([[0.1, 0.0], [0.0, 0.3]])


def recordings(steps: list[int], seed: int = 0, noise: float = 0.0, moved: list[list[int]] | None = None) -> Episodes:
    """x+ = A x + B u; ``moved``: inputs that each recording moves."""
    rng = np.random.default_rng(seed)
    xs, us = [], []
    for i, size in enumerate(steps):
        u = rng.normal(size=(size, 2))
        if moved is not None:
            u[:, [j for j in range(2) if j not in moved[i]]] = 0.0
        x = [rng.normal(size=2)]
        for k in range(size):
            x.append(A @ x[-1] + B @ u[k])
        xs.append(np.array(x) + noise * rng.normal(size=(size + 1, 2)))
        us.append(u)
    return Episodes(xs, us, dt=0.1)


def theta(delays: int = 0) -> Dictionary:
    more = (ob.Delays(states=delays, inputs=delays),) if delays else ()
    return Dictionary(ob.Constant(), ob.States(), ob.Inputs(), *more, n_states=2, n_inputs=2)


@pytest.mark.parametrize(("size", "folds"), [(2, 2), (9, 9), (10, 5), (23, 5)])
def test_no_model_is_judged_on_what_it_has_seen_and_every_recording_is_held_out_once(size: int, folds: int) -> None:
    d1 = recordings([12] * size)
    made = make_folds(d1, d1.pairs(), 0, 0)
    assert len(made) == folds
    held = [i for fold in made for i in fold.numbers]
    assert len(held) == len(set(held)) == min(size, 4 * folds)
    for fold in made:
        assert not set(fold.numbers) & set(fold.training.episode.tolist())
        assert len(fold.episodes) == len(fold.numbers)
        for x, i in zip(fold.episodes.xs, fold.numbers, strict=True):
            assert_array_equal(x, d1.xs[i])


def test_recordings_without_a_pair_judge_alone_where_there_are_four_of_them() -> None:
    d1 = recordings([12] * 8)
    pairs = d1.pairs()
    part = pairs.take(pairs.episode < 4)
    (fold,) = make_folds(d1, part, 0, 0)
    assert fold.numbers == (4, 5, 6, 7) and fold.training is part
    assert len(make_folds(d1, pairs.take(pairs.episode < 5), 0, 0)) == 8


def test_one_recording_is_cut_into_stretches_of_time_that_no_pair_of_their_fold_comes_from() -> None:
    d1 = recordings([50])
    made = make_folds(d1, d1.pairs(1), 1, 1)
    assert [fold.name for fold in made] == [f"steps {k} to {k + 10}" for k in range(0, 50, 10)]
    for k, fold in enumerate(made):
        assert not ((fold.training.index >= 10 * k) & (fold.training.index < 10 * k + 10)).any()
        assert len(fold.training) == 49 - (9 if k == 0 else 10)
        assert_array_equal(fold.episodes.xs[0], d1.xs[0][10 * k : 10 * k + 11])
    pairs = d1.pairs(1)
    early = make_folds(d1, pairs.take(pairs.index < 15), 1, 1)  # the rest of the recording costs nothing
    assert [fold.name for fold in early] == ["steps 20 to 30", "steps 30 to 40", "steps 40 to 50"]
    with pytest.raises(ValueError, match="one episode is too short to hold out a part of it"):
        make_folds(recordings([3]), recordings([3]).pairs(1), 1, 1)


@pytest.mark.parametrize("delays", [0, 2])
def test_a_horizon_cuts_roll_outs_that_begin_five_times_a_horizon(delays: int) -> None:
    d1 = recordings([40, 23])
    made = {fold.numbers: fold for fold in make_folds(d1, d1.pairs(delays), delays, 3, horizon=10, folds=2)}
    first, second = made[0,], made[1,]
    assert [len(u) for u in first.episodes.us] == [10 + delays] * 14  # 37 steps after the history of three
    assert [len(u) for u in second.episodes.us] == [10 + delays] * 6
    for j, (x, u) in enumerate(zip(first.episodes.xs, first.episodes.us, strict=True)):
        begin = 3 + 2 * j - delays
        assert_array_equal(x, d1.xs[0][begin : begin + 11 + delays])
        assert_array_equal(u, d1.us[0][begin : begin + 10 + delays])


def test_with_a_horizon_halves_of_few_recordings_are_held_out() -> None:
    d1 = recordings([40, 23])
    pairs = d1.pairs(1)
    made = make_folds(d1, pairs, 1, 2, horizon=10)  # the second one is too short for 12 steps in each half
    assert [fold.name for fold in made] == ["recording 0, steps 0 to 20", "recording 0, steps 20 to 40", "recording 1"]
    held = [~fold.kept for fold in made]
    assert (np.sum(held, axis=0) == 1).all()
    assert pairs.index[held[1]].min() == 20 and set(pairs.episode[held[1]]) == {0}
    assert_array_equal(made[1].episodes.xs[0], d1.xs[0][21 : 20 + 13])  # history of one before the step 22
    assert len(make_folds(recordings([40] * 10), recordings([40] * 10).pairs(1), 1, 2, horizon=10)) == 5


def test_few_pairs_of_long_recordings_are_judged_where_none_was_learned_from() -> None:
    """With a horizon: no roll-out passes a pair, or begins where one ends; the model is that of all pairs."""
    d1 = recordings([150] * 4)
    pairs = d1.pairs(1).sample(30, 0)
    (fold,) = make_folds(d1, pairs, 1, 2, horizon=10)
    assert fold.name == "steps without a pair" and fold.numbers == (0, 1, 2, 3)
    assert fold.training is pairs and fold.kept.all()
    found = []
    for x in fold.episodes.xs:
        ((k, at),) = [(k, at) for k in range(4) for at in np.flatnonzero((d1.xs[k] == x[1]).all(axis=1)).tolist()]
        found.append((k, at))  # after its history of one
    used = set(zip(pairs.episode.tolist(), pairs.index.tolist(), strict=True))
    free = [(k, a) for k in range(4) for a in range(2, 141) if used.isdisjoint((k, j) for j in range(a - 1, a + 10))]
    assert found == free
    assert "without a pair" not in make_folds(d1, d1.pairs(1).sample(300, 0), 1, 2, horizon=10)[0].name


@pytest.mark.parametrize("rested", [False, True])
def test_moments_of_folds_are_those_of_their_pairs(rested: bool) -> None:
    d1 = recordings([7, 30, 12, 9], noise=0.1)
    named, pairs = theta(1).named_after(d1), d1.pairs(1)
    rest = (np.ones((3, 2)), np.zeros((3, 2))) if rested else None
    resting = pair_moments(named, pairs.take(np.zeros(len(pairs), dtype=bool)), rest) if rested else None
    folds = make_folds(d1, pairs, 1, 1)
    whole = pair_moments(named, pairs, rest)
    for fold, found in zip(
        folds, fold_moments(folds, pairs, whole, lambda p: pair_moments(named, p), resting), strict=True
    ):
        direct = pair_moments(named, fold.training, rest)
        assert found.n_samples == direct.n_samples
        assert_allclose(found.mean, direct.mean, atol=1e-13)
        assert_allclose(found.factor.T @ found.factor, direct.factor.T @ direct.factor, atol=1e-11)


def table(errors: list[list[float]], unseen: tuple[str, ...] | None = None) -> FoldErrors:
    values = np.array(errors)
    d1 = recordings([5])
    pairs = d1.pairs()
    kept = np.ones(len(pairs), dtype=bool)
    names = unseen or ("",) * values.shape[1]
    folds = tuple(Fold(pairs, kept, d1, (i,), f"recording {i}", None, name) for i, name in enumerate(names))
    return FoldErrors(
        folds, values, np.repeat(values[:, :, None], 2, axis=2), np.isinf(values), np.full(values.shape[1], 1e9)
    )


def test_ratios_count_and_not_the_size_of_a_hard_fold() -> None:
    found = table([[1e-4, 1e-4, 60.0], [1e-2, 1e-2, 50.0]])
    assert found.joint().argmin() == 0
    assert_allclose(found.joint(), [(1e-8 * 60.0) ** (1 / 3), (1e-4 * 50.0) ** (1 / 3)])


def test_what_diverges_where_another_does_not_is_out_and_a_fold_that_beats_all_says_nothing() -> None:
    found = table([[1.0, np.inf, 1e-3], [np.inf, np.inf, 1e-4], [2.0, np.inf, 1e-2]])
    assert_allclose(found.joint(), [np.sqrt(1e-3), np.inf, np.sqrt(2e-2)])
    everywhere = table([[1.0, np.inf, 5.0], [np.inf, 1e-3, np.inf], [4.0, 9.0, np.inf]])
    assert not np.isfinite(everywhere.joint()).any()
    assert_allclose(everywhere.fallback(), [np.sqrt(5.0), np.inf, 6.0])


def test_folds_whose_input_direction_nothing_else_moves_are_left_out_of_the_choice() -> None:
    found = table([[1.0, 1.0, 1e6], [2.0, 2.0, 1e-6]], ("", "", "+1.00 u2"))
    assert found.joint().argmin() == 0
    said = reasons(found, ["a", "b"], 0, np.ones(2, dtype=bool), 0.0)
    assert said == ("pairs beside recording 2 do not move +1.00 u2, nothing can be judged there; record more of it",)


def test_one_recording_that_decides_is_named() -> None:
    found = table([[1.0, 1.0, 1e9], [10.0, 10.0, 1.0]])
    assert found.joint().argmin() == 1
    said = reasons(found, ["a", "b"], 1, np.ones(2, dtype=bool), 0.0)
    assert said == ("recording 2 decided for b; the others ask for a, with errors 3.2 times smaller",)
    assert not reasons(found, ["a", "b"], 1, np.array([False, True]), 0.0)  # a is not bounded


def test_a_recording_that_alone_moves_an_input_is_named_by_the_fit() -> None:
    d1 = recordings([20] * 4, noise=0.01, moved=[[0], [1], [0], [0]])
    with pytest.warns(UserWarning, match=r"pairs beside recording 1 do not move \+1\.00 u2"):
        LinearEDMDc(theta(), alpha="cv").fit(d1)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        LinearEDMDc(theta(), alpha="cv").fit(recordings([20] * 4, noise=0.01, moved=[[0], [1], [0], [1]]))


def test_a_saved_model_still_says_what_speaks_against_it(tmp_path: Path) -> None:
    with pytest.warns(UserWarning, match="parts of one recording"):
        model = LinearEDMDc(theta(), alpha="cv").fit(recordings([40], noise=0.01))
    model.lifted.save(tmp_path / "model.h5")
    told = LiftedModel.load(tmp_path / "model.h5").provenance["choice"]
    assert model.cv_ is not None and told["reasons"] == list(model.cv_.reasons) and told["error"] == model.cv_.error
    assert told["folds"][0] == "steps 0 to 8"
    assert LinearEDMDc(theta()).fit(recordings([40])).lifted.provenance["choice"] is None


def test_one_recording_is_never_enough_to_be_sure() -> None:
    with pytest.warns(UserWarning, match="was chosen on parts of one recording, others may differ"):
        model = LinearEDMDc(theta(), alpha="cv").fit(recordings([40], noise=0.01))
    assert model.cv_ is not None and len(model.cv_.names) == model.cv_.folds.shape[1] == 5


def pendulum(n: int, seed: int, steps: int = 150) -> Episodes:
    """An inverted pendulum, sampled at 20 Hz, under a stabilising law with an exploring command; noisy."""
    rng, dt = np.random.default_rng(seed), 0.05
    xs, us = [], []
    for _ in range(n):
        x, command = [rng.normal(size=2) * [0.1, 0.1]], np.repeat(rng.normal(size=steps // 5 + 1), 5)[:steps]
        u = np.zeros((steps, 1))
        for k in range(steps):
            u[k] = -25.0 * x[-1][0] - 7.0 * x[-1][1] + 4.0 * command[k]
            angle, rate = x[-1]
            for _ in range(10):
                rate += dt / 10 * (9.81 * np.sin(angle) - 0.1 * rate + u[k, 0])
                angle += dt / 10 * rate
            x.append(np.array([angle, rate]))
        xs.append(np.array(x) + 0.002 * rng.normal(size=(steps + 1, 2)))
        us.append(u)
    return Episodes(xs, us, dt)


@pytest.mark.parametrize("seed", [0, 8, 52])
def test_roll_outs_of_limited_length_choose_for_an_unstable_plant(seed: int) -> None:
    """The error ten steps ahead is within 1.2 times that of the best alpha of the grid."""
    d1, test = pendulum(4, seed), pendulum(6, seed + 100)
    columns = Dictionary(ob.Constant(), ob.States(), ob.Inputs(), ob.Polynomials(3), n_states=2, n_inputs=1)
    pairs = d1.pairs().sample(40, seed)
    ridges = np.logspace(-10, 1, 12).tolist()
    model = LinearEDMDc(columns, alpha="cv", alphas=ridges, cv_horizon=10).fit(d1, pairs)

    def error(alpha: float) -> float:
        return float(horizon_errors(LinearEDMDc(columns, alpha).fit(d1, pairs), test, [10]).normalised[0])

    assert error(model.alpha_) <= 1.2 * min(map(error, ridges))


def test_estimators_of_different_delays_are_judged_on_the_same_steps_where_their_pairs_are_the_same() -> None:
    d1 = recordings([20] * 3, noise=0.05)
    pairs = d1.pairs(4)
    for delays in (0, 2):
        model = LinearEDMDc(theta(delays), alpha="cv", alphas=[0.0]).fit(d1, pairs)
        kept = pairs.take(pairs.episode != 0)
        once = LinearEDMDc(theta(delays)).fit(d1, kept)
        held = Episodes([d1.xs[0][4 - delays :]], [d1.us[0][4 - delays :]], d1.dt)
        weights = 1.0 / pairs.x.std(axis=0)
        assert model.cv_ is not None
        assert_allclose(model.cv_.folds[0, 0], rollout_errors(once, held, weights=weights).median, rtol=1e-9)
