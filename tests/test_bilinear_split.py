"""Splits of bilinear dictionaries: f moves u_i psi as psi, h is control-affine."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import scipy.linalg

from pisplit import BilinearEDMDc, Dictionary, Episodes, PhaseSamples, PIEDMDc
from pisplit import observables as ob

DT = 0.1
L = np.array([[-0.3, 1.0], [-1.0, -0.1]])
OFFSET = np.array([0.2, -0.1])  # f = L x + OFFSET
B = np.array([[0.0, 0.1], [0.3, 0.0]])
N = np.array([[[0.0, 0.0], [0.2, -0.1]], [[0.1, 0.0], [0.0, 0.05]]])


def half(x: np.ndarray) -> np.ndarray:
    step = scipy.linalg.expm(0.5 * DT * np.block([[L, OFFSET[:, None]], [np.zeros((1, 3))]]))
    return np.asarray(step[:2, :2] @ x + step[:2, 2])


def kick(x: np.ndarray, u: np.ndarray) -> np.ndarray:
    return np.asarray(x + DT * (B @ u + sum(u[i] * N[i] @ x for i in range(2))))


def run(steps: int, count: int = 1, seed: int = 0) -> Episodes:
    rng = np.random.default_rng(seed)
    us = [rng.normal(size=(steps, 2)) for _ in range(count)]
    xs = []
    for u in us:
        x = [rng.normal(size=2)]
        for k in range(steps):
            x.append(half(kick(half(x[-1]), u[k])))
        xs.append(np.array(x))
    return Episodes(xs, us, DT)


def known(inputs: bool = False) -> PhaseSamples:
    rng = np.random.default_rng(1)
    x, u = rng.normal(size=(40, 2)), rng.normal(size=(40, 2))
    return PhaseSamples(x, u, x @ L.T + OFFSET + (u if inputs else 0.0))


def theta(*more: Any) -> Dictionary:
    return Dictionary(ob.Constant(), ob.Identity(), *more, n_states=2, n_inputs=2)


@pytest.mark.parametrize("split", ["strang", "lie"])
@pytest.mark.parametrize("penalty", ["ridge", "lasso"])
@pytest.mark.parametrize("delays", [ob.Delays(), ob.Delays(inputs=1)])
def test_without_a_regulariser_the_half_steps_cancel(split: str, penalty: str, delays: ob.Delays) -> None:
    rng = np.random.default_rng(3)
    clean = run(60, 3)
    d1 = Episodes([x + 0.01 * rng.normal(size=x.shape) for x in clean.xs], clean.us, DT)
    plain = BilinearEDMDc(theta(delays)).fit(d1)
    found = PIEDMDc(theta(delays).bilinear(), 0.0, split=split, penalty=penalty).fit(d1, known())
    np.testing.assert_allclose(found.K_, plain.K_, atol=1e-9)


def test_few_pairs_identify_a_control_affine_unknown_part() -> None:
    d1, test = run(6), run(200, seed=9)
    model = PIEDMDc(theta(ob.Bilinear()), 0.0, penalty="ridge", rows="inputs").fit(d1, known())
    assert len(d1.pairs()) < model.theta_.n_columns - 1  # fewer than EDMDc needs
    predicted = model.predict(test.xs[0][0], test.us[0])
    np.testing.assert_allclose(predicted, test.xs[0], atol=1e-9)
    step = scipy.linalg.expm(0.5 * DT * L)
    assert model.lifted.N is not None
    np.testing.assert_allclose(model.lifted.N[:, 1:, 1:], [DT * step @ n @ step for n in N], atol=1e-10)


def test_products_that_f_takes_out_of_the_dictionary_are_refused() -> None:
    d1 = run(60)
    for dictionary, d2 in ((theta(ob.Bilinear(("x1",))), known()), (theta(ob.Bilinear()), known(inputs=True))):
        with pytest.raises(ValueError, match="out of the dictionary"):
            PIEDMDc(dictionary, 0.0).fit(d1, d2)
    with pytest.raises(ValueError, match="belong to BilinearEDMDc"):
        PIEDMDc(theta(ob.Bilinear()), 0.0, split="hold").fit(d1, known())
