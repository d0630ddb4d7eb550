"""Units travel from the data to the model and to what is made of it."""

from __future__ import annotations

import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pisplit import Dictionary, Episodes, LiftedModel, LinearEDMDc
from pisplit import observables as ob
from pisplit.lifted import balanced_truncation, stabilised, to_numpy


@pytest.fixture(scope="module")
def data() -> Episodes:
    rng = np.random.default_rng(5)
    x, u = np.zeros((61, 2)), rng.normal(size=(60, 1))
    for k in range(60):
        x[k + 1] = np.array([[0.9, 0.2], [-0.1, 0.8]]) @ x[k] + np.array([0.0, 0.5]) * u[k]
    return Episodes([x], [u], 0.1, state_names=["angle", "rate"], units=["rad", "rad/s"])


@pytest.fixture(scope="module")
def model(data: Episodes) -> LiftedModel:
    return LinearEDMDc(Dictionary(ob.Identity(), n_states=2, n_inputs=1)).fit(data).lifted


def test_a_model_has_the_units_of_its_data(model: LiftedModel, tmp_path: Path) -> None:
    path = tmp_path / "model.h5"
    model.save(path)
    reduced = balanced_truncation(model, 1).model
    for kept in (model, LiftedModel.load(path), pickle.loads(pickle.dumps(model)), stabilised(model, 0.5), reduced):
        assert kept.units == kept.state_units == ("rad", "rad/s")
    assert to_numpy(model)["state_units"] == ["rad", "rad/s"]


def test_units_are_one_text_a_column(model: LiftedModel) -> None:
    assert replace(model, state_units=None, input_units=["V"]).units == ("", "")
    for wrong in (("rad",), ("rad", 1.0)):
        with pytest.raises(ValueError, match=r"state_units = .* expected 2 texts"):
            replace(model, state_units=wrong)
    with pytest.raises(ValueError, match=r"input_units = .* expected 1 texts"):
        replace(model, input_units=("V", "V"))
