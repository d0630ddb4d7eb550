"""Systems without inputs: what has inputs elsewhere has none here, and everything else is the same."""

from __future__ import annotations

import pickle
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pisplit import (
    BilinearEDMDc,
    Dictionary,
    Episodes,
    LiftedModel,
    LinearEDMDc,
    PhaseSamples,
    PIEDMDc,
    StreamingEDMDc,
    TwinEDMDc,
    compare,
    horizon_errors,
    learning_curve,
    modes,
)
from pisplit import observables as ob
from pisplit.lifted import balanced_truncation, input_jacobian, stabilised, to_c_header, to_numpy, to_state_space

A = np.array([[0.9, 0.2], [-0.1, 0.8]])
THETA = Dictionary(ob.Constant(), ob.Identity(), ob.Delays(1, 1), ob.Slack(), n_states=2, n_inputs=0)


def episodes(seed: int = 0, count: int = 5, steps: int = 30) -> Episodes:
    rng, xs = np.random.default_rng(seed), []
    for _ in range(count):
        x = np.empty((steps + 1, 2))
        x[0] = rng.normal(size=2)
        for k in range(steps):
            x[k + 1] = A @ x[k]
        xs.append(x)
    return Episodes(xs, [np.zeros((steps, 0))] * count, 0.1)


def samples() -> PhaseSamples:
    x = np.random.default_rng(1).normal(size=(40, 2))
    return PhaseSamples(x=x, u=np.zeros((40, 0)), xdot=x @ (A - np.eye(2)).T / 0.1)


FITS: dict[str, Callable[[Episodes], Any]] = {
    "linear": lambda d: LinearEDMDc(THETA, alpha=1e-10).fit(d),
    "chosen alpha": lambda d: LinearEDMDc(THETA, alpha="cv").fit(d),
    "lasso": lambda d: LinearEDMDc(THETA, alpha=1e-6, penalty="lasso").fit(d),
    "bilinear": lambda d: BilinearEDMDc(THETA, alpha=1e-10).fit(d),
    "streaming": lambda d: StreamingEDMDc(THETA, alpha=1e-10).update(d),
    "split": lambda d: PIEDMDc(THETA, alpha=1e-10, penalty="ridge").fit(d, samples()),
    "twin": lambda d: TwinEDMDc(THETA, alpha=1e-3, twin_alpha=1e-10).fit(d, episodes(7)),
}


@pytest.mark.parametrize("kind", FITS)
def test_every_estimator_finds_the_motion(kind: str) -> None:
    model = FITS[kind](episodes()).lifted
    assert model.n_inputs == 0 and model.n_features == 0 and not model.is_bilinear
    test = episodes(3, count=1)
    predicted = model.predict(test.xs[0][:2], np.zeros((1, 0)), test.us[0][1:]).x
    np.testing.assert_allclose(predicted, test.xs[0][1:], atol=2e-3)


@pytest.fixture(scope="module")
def model() -> LiftedModel:
    return LinearEDMDc(THETA, alpha=1e-10).fit(episodes()).lifted


def test_every_tool_takes_such_a_model(model: LiftedModel, tmp_path: Path) -> None:
    test, nothing = episodes(4), np.zeros(0)
    assert compare({"a": model}, test, horizons=[3]).errors["a"].median < 1e-8
    assert horizon_errors(model, test, [5]).normalised[0] < 1e-4
    assert np.isfinite(learning_curve({"a": LinearEDMDc(THETA)}, test, test, [20], [0]).errors["a"]).all()
    radius = np.abs(np.linalg.eigvals(A)).max()
    assert np.isclose(np.sort(np.abs(modes(model).eigenvalues))[-2], radius, atol=1e-3)  # the constant is 1
    assert modes(stabilised(model, 0.5)).radius <= 0.5 + 1e-9
    z = model.fixed_point(nothing)
    np.testing.assert_allclose(model.step(z, nothing), z, atol=1e-12)
    assert model.features(np.zeros((4, 0))).shape == (4, 0) and input_jacobian(model, np.zeros((4, 0))).size == 0
    model.save(tmp_path / "model.h5")
    for same in (LiftedModel.load(tmp_path / "model.h5"), pickle.loads(pickle.dumps(model))):
        np.testing.assert_array_equal(same.step(z + 1.0, nothing), model.step(z + 1.0, nothing))
    assert to_numpy(model)["B"].shape == (model.n_lifted, 0) and to_state_space(model).A.shape == model.A.shape
    THETA.save(tmp_path / "theta.h5")
    assert Dictionary.load(tmp_path / "theta.h5").n_features == 0


def test_a_reduction_needs_something_that_moves_the_model(model: LiftedModel) -> None:
    with pytest.raises(ValueError, match="give starts"):
        balanced_truncation(model, 2)
    starts = np.stack([model.lift(x[:2], np.zeros((1, 0))) for x in episodes(5).xs])
    reduced = balanced_truncation(model, 3, starts).model
    start = episodes(6, count=1)
    history = (start.xs[0][:2], np.zeros((1, 0)), start.us[0][1:])
    np.testing.assert_allclose(reduced.predict(*history).x, model.predict(*history).x, atol=0.05)


@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")
def test_the_c_header_compiles_without_inputs(model: LiftedModel, tmp_path: Path) -> None:
    to_c_header(model, tmp_path / "model.h")
    (tmp_path / "main.c").write_text(
        """#include <stdio.h>
#include "model.h"
int main(void) {
  double xs[] = {1, 2, 3, 4}, u[1] = {0}, z[MODEL_LIFTED], next[MODEL_LIFTED], x[MODEL_STATES];
  model_lift(xs, u, z); model_step(z, u, next); model_read(next, x);
  printf("%.17g %.17g", x[0], x[1]);
  return 0;
}
"""
    )
    command = ["cc", "-std=c99", "-Wall", "-Werror", "-Wno-unused-function", "main.c", "-lm", "-o", "main"]
    built = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert built.returncode == 0, built.stderr
    printed = subprocess.run([str(tmp_path / "main")], capture_output=True, text=True, check=True).stdout
    z = model.step(model.lift([[1.0, 2.0], [3.0, 4.0]], np.zeros((1, 0))), np.zeros(0))
    np.testing.assert_allclose([float(v) for v in printed.split()], model.read(z), rtol=1e-12)
