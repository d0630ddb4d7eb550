"""Recordings go to xarray and back; dictionaries serve pipelines of scikit-learn."""

from __future__ import annotations

import numpy as np
import pytest

from pisplit import Dictionary, DictionaryFeatures, Episodes, from_xarray, to_xarray
from pisplit import observables as ob
from pisplit.models import systems


def recordings() -> Episodes:
    rng = np.random.default_rng(0)
    runs = [rng.uniform(-1, 1, (steps, 1)) for steps in (20, 31)]
    found = Episodes.from_system(systems.duffing(), rng.normal(size=(2, 2)), runs, dt=0.05)
    return Episodes(found.xs, found.us, 0.05, ["x", "v"], ["f"], ["x", "v"], ["m", "m/s"], input_units=["N"])


def test_there_and_back_is_the_same() -> None:
    pytest.importorskip("xarray")
    d1 = recordings()
    sets = to_xarray(d1)
    assert [len(s.time) for s in sets] == [21, 32] and float(sets[0].x.sel(state="v", time=0.05)) == d1.xs[0][1, 1]
    back = from_xarray(sets)
    for name in ("dt", "state_names", "input_names", "units", "input_units", "quantities", "provenance"):
        assert getattr(back, name) == getattr(d1, name), name
    for ours, theirs in zip((*d1.xs, *d1.us), (*back.xs, *back.us), strict=True):
        np.testing.assert_array_equal(ours, theirs)


def test_datasets_of_others_need_labels_and_even_times_alone() -> None:
    xarray = pytest.importorskip("xarray")
    t = 0.1 * np.arange(5)
    plain = xarray.Dataset(
        {"x": (("state", "time"), np.ones((2, 5))), "u": (("step", "input"), np.ones((4, 1)))}, coords={"time": t}
    )
    found = from_xarray(plain)
    assert found.xs[0].shape == (5, 2) and found.dt == pytest.approx(0.1) and found.state_names == ("x1", "x2")
    for wrong, said in (
        (plain.drop_vars("u"), "no variable 'u'"),
        (plain.assign_coords(time=t**2), "not evenly spaced"),
        ([plain, plain.assign_coords(time=2 * t)], "steps of 0.2 s"),
        ([], "expected an xarray.Dataset"),
    ):
        with pytest.raises(ValueError, match=said) as caught:
            from_xarray(wrong)
        assert "\n" not in str(caught.value)


def test_columns_of_a_dictionary_are_features_of_a_pipeline() -> None:
    from sklearn.base import clone
    from sklearn.linear_model import LinearRegression
    from sklearn.pipeline import make_pipeline

    rng = np.random.default_rng(1)
    theta = Dictionary(ob.Constant(), ob.Polynomials(3), ob.Inputs(), n_states=2, n_inputs=1)
    rows = rng.normal(size=(60, 3))
    y = rows[:, 0] ** 3 - 2.0 * rows[:, 0] * rows[:, 1] + rows[:, 2]
    made = make_pipeline(DictionaryFeatures(theta), LinearRegression()).fit(rows, y)
    assert made.score(rows, y) == pytest.approx(1.0, abs=1e-12)
    features = clone(made[0])
    assert list(features.get_feature_names_out()) == list(theta.column_names)
    d1 = recordings()
    delayed = Dictionary(ob.States(), ob.Inputs(), ob.Delays(2, 1), n_states=2, n_inputs=1)
    assert DictionaryFeatures(delayed).fit_transform(d1).shape == (20 + 31 - 2 * 2, delayed.n_columns)
    with pytest.raises(ValueError, match="expected a Dictionary"):
        DictionaryFeatures(3)  # type: ignore[arg-type]
