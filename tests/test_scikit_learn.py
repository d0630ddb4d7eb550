"""scikit-learn over recordings: folds, scores in units, searches, clones."""

from __future__ import annotations

import re
import warnings

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from sklearn.base import clone
from sklearn.model_selection import GridSearchCV, cross_val_score

from pisplit import Dictionary, Episodes, LinearEDMDc, PhaseSamples, PIEDMDc, horizon_errors, rollout_errors
from pisplit import observables as ob
from pisplit.evaluation import EpisodeSplit, RolloutScore
from pisplit.models import systems


def recordings(number: int = 5, steps: int = 30, seed: int = 0) -> Episodes:
    rng = np.random.default_rng(seed)
    inputs = [rng.normal(size=(steps, 1)) for _ in range(number)]
    found = Episodes.from_system(systems.duffing(), rng.normal(size=(number, 2)), inputs, dt=0.1)
    units, quantities = ["m", "m/s"], ["x", "v"]
    return Episodes(found.xs, found.us, 0.1, found.state_names, found.input_names, quantities, units)


def theta(degree: int = 1) -> Dictionary:
    more = (ob.Polynomials(degree),) if degree > 1 else ()
    return Dictionary(ob.Constant(), ob.States(), ob.Inputs(), *more, n_states=2, n_inputs=1)


def test_scores_are_those_of_fits_without_the_recording_that_is_judged() -> None:
    d1 = recordings()
    found = cross_val_score(LinearEDMDc(theta(), 1e-3), d1, cv=EpisodeSplit(), scoring=RolloutScore("x"))
    ahead = cross_val_score(LinearEDMDc(theta(), 1e-3), d1, cv=EpisodeSplit(), scoring=RolloutScore("x", horizon=4))
    for i, (score, later) in enumerate(zip(found, ahead, strict=True)):
        model = LinearEDMDc(theta(), 1e-3).fit(d1[[j for j in range(5) if j != i]])
        assert_allclose(score, -np.sqrt(rollout_errors(model, d1[i], "x").mean), rtol=1e-12)
        assert_allclose(later, -horizon_errors(model, d1[i], [4], "x").rms[0, 0], rtol=1e-12)


def test_scores_are_in_the_unit_of_the_states() -> None:
    d1 = recordings()
    scaled = [1e3, 1e3] * np.ones(2)
    millimetres = Episodes([x * scaled for x in d1.xs], d1.us, 0.1, ["x", "v"], None, d1.quantities, ["mm", "mm/s"])
    model, other = LinearEDMDc(theta()).fit(d1), LinearEDMDc(theta()).fit(millimetres)
    assert RolloutScore("x")(other, millimetres) == pytest.approx(1e3 * RolloutScore("x")(model, d1), rel=1e-6)
    with pytest.raises(ValueError, match=re.escape("states have the units 'm', 'm/s'; give states of one unit")):
        RolloutScore()(model, d1)


def test_a_search_finds_the_dictionary_and_fits_it_to_all_recordings() -> None:
    d1 = recordings(6)
    grid = {"theta": [theta(), theta(3)], "alpha": [1e-9, 10.0]}
    search = GridSearchCV(LinearEDMDc(theta()), grid, cv=EpisodeSplit(3), scoring=RolloutScore("x", horizon=5))
    best = search.fit(d1).best_estimator_
    assert search.best_params_["alpha"] == 1e-9 and search.best_params_["theta"] is grid["theta"][1]
    assert search.n_splits_ == 3 and len(search.cv_results_["params"]) == 4
    assert_allclose(best.K_, LinearEDMDc(theta(3), 1e-9).fit(d1).K_, atol=1e-9)


def test_what_a_fit_learns_from_beside_recordings_is_handed_on() -> None:
    d1, rng = recordings(4), np.random.default_rng(1)
    points = rng.normal(size=(200, 2))
    d2 = PhaseSamples.from_system(systems.duffing(), points, np.zeros((200, 1)))
    estimator = PIEDMDc(theta(3), 0.0, "ridge", rows="inputs")
    found = cross_val_score(estimator, d1, cv=EpisodeSplit(), scoring=RolloutScore("x", horizon=2), params={"d2": d2})
    assert (found > -0.1).all()


def test_a_model_that_diverges_scores_minus_infinity() -> None:
    d1 = recordings()
    growing = Episodes([3.0 ** np.arange(4)[:, None] * x[:1] for x in d1.xs], [0.0 * u[:3] for u in d1.us], 0.1)
    named = Episodes(d1.xs, d1.us, 0.1)
    assert RolloutScore(["x1"])(LinearEDMDc(theta()).fit(growing), named) == -np.inf


@pytest.mark.parametrize(("size", "folds"), [(2, 2), (9, 9), (10, 5), (11, 5)])
def test_folds_part_the_recordings(size: int, folds: int) -> None:
    d1, split = recordings(size, 3), EpisodeSplit()
    parts = list(split.split(d1))
    assert len(parts) == split.get_n_splits(d1) == folds
    assert_array_equal(np.sort(np.concatenate([held for _, held in parts])), np.arange(size))
    for training, held in parts:
        assert_array_equal(np.sort(np.concatenate([training, held])), np.arange(size))


def test_folds_that_cannot_be_are_refused() -> None:
    with pytest.raises(ValueError, match="n_splits = 1"):
        EpisodeSplit(1)
    with pytest.raises(ValueError, match="4 folds of 3 recordings; give at least 4"):
        list(EpisodeSplit(4).split(recordings(3)))
    with pytest.raises(ValueError, match="the number of folds depends on the recordings"):
        EpisodeSplit().get_n_splits()


def test_parameters_are_cloned_and_changed() -> None:
    estimator = LinearEDMDc(theta(), alpha="cv", cv_horizon=5, cv_folds=3)
    copy = clone(estimator)
    assert copy is not estimator and copy.get_params() == estimator.get_params()
    assert copy.set_params(cv_horizon=7).cv_horizon == 7 and estimator.cv_horizon == 5
    for name in ("cv_horizon", "cv_folds"):
        with pytest.raises(ValueError, match=name):
            copy.set_params(**{name: 0})


def test_several_recordings_in_a_list_are_one() -> None:
    first, second = recordings(2), recordings(3, seed=1)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        model = LinearEDMDc(theta(3), 1e-6).fit([first, second])
    assert_array_equal(model.K_, LinearEDMDc(theta(3), 1e-6).fit(first + second).K_)
    with pytest.raises(ValueError, match="d1 is a list; expected Episodes"):
        LinearEDMDc(theta()).fit([first, 3.0])  # type: ignore[list-item]


def test_a_search_without_a_scorer_is_refused_instead_of_being_scored_by_nan() -> None:
    with pytest.raises((TypeError, ValueError), match="scoring must return a number"):
        cross_val_score(LinearEDMDc(theta(), 1e-3), recordings(4), cv=4)
