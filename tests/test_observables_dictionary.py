"""Dictionaries in files and as fingerprints; estimators as scikit-learn expects them."""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest

import pisplit
from pisplit import BilinearEDMDc, Dictionary, Episodes, LinearEDMDc, PIEDMDc
from pisplit import observables as ob

RNG = np.random.default_rng(6)

BUILD = """
import casadi as ca, numpy as np
from pisplit import Dictionary, observables as ob
grid = np.linspace(-2, 2, 20)
table = ca.interpolant("table", "bspline", [grid], np.sin(grid))
s, v, u = ca.SX.sym("s"), ca.SX.sym("v"), ca.MX.sym("u", 2)
root = ca.rootfinder("root", "newton", ca.Function("g", [s, v], [s**3 + s - v]))
statics = ca.Function("statics", [u], [ca.vertcat(root(0, u[0]), table(u[1]))])
theta = Dictionary(
    ob.Constant() + ob.Identity() + ob.Delays(1, 2), ob.Equilibrium(statics), ob.RandomFourier(4, seed=2),
    ob.Radial([[0.0, 1.0]]), ob.Polynomials(3) * ob.Fourier(1, variables=("x1",)), ob.Bilinear(("x1", "x2")),
    n_states=2, n_inputs=2,
)
"""


def build() -> Dictionary:
    scope: dict[str, Any] = {}
    exec(BUILD, scope)
    theta: Dictionary = scope["theta"]
    return theta


def episodes(**more: Any) -> Episodes:
    xs, us = [RNG.normal(size=(t + 1, 2)) for t in (12, 9)], [RNG.normal(size=(t, 2)) for t in (12, 9)]
    return Episodes(xs, us, dt=0.1, **more)


def test_the_fingerprint_is_the_same_in_another_process() -> None:
    path = os.pathsep.join(str(Path(p)) for p in (Path(pisplit.__file__).parent.parent, *sys.path) if str(p))
    code = BUILD + "\nprint(theta.fingerprint())"
    environment = {**os.environ, "PYTHONPATH": path, "PYTHONHASHSEED": "77"}
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == build().fingerprint() == build().fingerprint()


@pytest.mark.parametrize(
    "other",
    [
        Dictionary(ob.States(), ob.Polynomials(3), n_states=2, n_inputs=1),
        Dictionary(ob.States(), ob.Polynomials(2), n_states=2, n_inputs=1, state_names=("a", "b")),
        Dictionary(ob.States(), ob.Polynomials(2), n_states=2, n_inputs=1, quantities=("p", "p")),
        Dictionary(ob.States(), ob.Polynomials(2), ob.Delays(1), n_states=2, n_inputs=1),
        Dictionary(ob.States(), ob.Polynomials(2), ob.Bilinear(), n_states=2, n_inputs=1),
        Dictionary(ob.States(), ob.Polynomials(2), n_states=2, n_inputs=2),
    ],
    ids=repr,
)
def test_the_fingerprint_tells_dictionaries_apart(other: Dictionary) -> None:
    assert Dictionary(ob.States(), ob.Polynomials(2), n_states=2, n_inputs=1).fingerprint() != other.fingerprint()


def test_values_alone_change_the_fingerprint() -> None:
    one, other = (
        Dictionary(ob.States(), ob.Expression(lambda x, u, k=k: ca.sin(k * x[0]), name="s"), n_states=1, n_inputs=1)
        for k in (2.0, 2.0 + 1e-15)
    )
    assert one.fingerprint() != other.fingerprint()


def test_a_saved_dictionary_is_the_same_dictionary(tmp_path: Path) -> None:
    theta, pairs = build(), episodes().pairs(2)
    theta.save(tmp_path / "theta.h5")
    copy = Dictionary.load(tmp_path / "theta.h5")
    np.testing.assert_array_equal(copy.evaluate(pairs), theta.evaluate(pairs))
    np.testing.assert_array_equal(copy.next(pairs), theta.next(pairs))
    v = RNG.normal(size=pairs.x.shape)
    np.testing.assert_array_equal(copy.lie_derivative(pairs.x, pairs.u, v), theta.lie_derivative(pairs.x, pairs.u, v))
    for name in ("column_names", "column_quantities", "n_delays", "constant_column", "is_bilinear"):
        assert getattr(copy, name) == getattr(theta, name)
    assert copy.fingerprint() == theta.fingerprint()
    assert pickle.loads(pickle.dumps(copy)).fingerprint() == theta.fingerprint()
    copy.save(tmp_path / "again.h5")
    assert Dictionary.load(tmp_path / "again.h5").fingerprint() == theta.fingerprint()


def test_a_model_fitted_with_a_loaded_dictionary_is_the_same_model(tmp_path: Path) -> None:
    theta, d1 = build(), episodes()
    theta.save(tmp_path / "theta.h5")
    copy = Dictionary.load(tmp_path / "theta.h5")
    one, other = (BilinearEDMDc(t, alpha=1e-3).fit(d1) for t in (theta, copy))
    np.testing.assert_array_equal(one.K_, other.K_)
    assert one.lifted.provenance["dictionary"] == other.lifted.provenance["dictionary"] == one.theta_.fingerprint()
    Dictionary(ob.States(), n_states=2, n_inputs=2, state_names=("a", "b")).save(tmp_path / "named.h5")
    named = Dictionary.load(tmp_path / "named.h5")
    assert named.named_after(episodes()) is named  # data without names are matched by position
    with pytest.raises(ValueError, match="no states named a, b of the dictionary"):
        named.named_after(episodes(state_names=("p", "q")))
    with pytest.raises(ValueError, match=r"give Episodes\.arranged"):
        named.named_after(episodes(state_names=("b", "a")))


def test_files_of_another_kind_are_refused(tmp_path: Path) -> None:
    episodes().save(tmp_path / "d1.h5")
    with pytest.raises(ValueError, match="expected 'pisplit/dictionary'"):
        Dictionary.load(tmp_path / "d1.h5")
    with pytest.raises(FileNotFoundError):
        Dictionary.load(tmp_path / "none.h5")


def test_making_a_dictionary_bilinear_leaves_the_old_one_as_it_was() -> None:
    theta = Dictionary(ob.Identity(), n_states=2, n_inputs=2)
    before = theta.column_names, theta.fingerprint()
    more = theta.bilinear()
    assert more.column_names == (*before[0], "u1*x1", "u1*x2", "u2*x1", "u2*x2")
    assert (theta.column_names, theta.fingerprint()) == before and not theta.is_bilinear
    assert more.fingerprint() == Dictionary(ob.Identity(), ob.Bilinear(), n_states=2, n_inputs=2).fingerprint()


ESTIMATORS = [
    LinearEDMDc(build().bilinear(["x1"]), alpha="cv", penalty="lasso", alphas=(1.0, 2.0), cv_tolerance=0),
    BilinearEDMDc(Dictionary(ob.Identity(), n_states=2, n_inputs=2), alpha=1, scale=None),
    PIEDMDc(Dictionary(ob.Identity(), n_states=2, n_inputs=2), rows=["x1"], generator_alpha=1, options={}),
]


@pytest.mark.parametrize("estimator", ESTIMATORS, ids=lambda e: type(e).__name__)
def test_estimators_can_be_cloned_by_scikit_learn(estimator: Any) -> None:
    base = pytest.importorskip("sklearn.base")
    copy = base.clone(estimator)
    assert type(copy) is type(estimator) and copy is not estimator and copy.get_params() == estimator.get_params()


def test_options_stay_as_given_and_can_be_set() -> None:
    theta = Dictionary(ob.Identity(), n_states=2, n_inputs=2)
    model = LinearEDMDc(theta, alpha=1)
    assert model.set_params(alpha="cv", penalty="lasso") is model
    assert model.alpha == "cv" and model.penalty == "lasso" and model.theta is theta
    with pytest.raises(ValueError, match="no option 'beta'"):
        model.set_params(beta=1)
    with pytest.raises(ValueError, match="penalty"):
        model.set_params(penalty="elastic", alpha=3.0)
    assert model.alpha == "cv"
    assert "LinearEDMDc(theta=Dictionary(Identity()" in repr(model)


def test_cloned_estimators_fit_the_same_model() -> None:
    base = pytest.importorskip("sklearn.base")
    d1, estimator = episodes(), ESTIMATORS[1]
    copy = base.clone(estimator)
    assert copy.fit(d1) is copy and not hasattr(estimator, "lifted")
    np.testing.assert_array_equal(copy.K_, base.clone(copy).fit(d1).K_)
