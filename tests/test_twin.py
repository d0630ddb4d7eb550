"""EDMDc with a physical twin: its limits, its equivalence with pooled data, and what a wrong twin costs."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from pisplit import BilinearEDMDc, Dictionary, Episodes, LinearEDMDc, Pairs, PhaseSamples, TwinEDMDc
from pisplit import observables as ob

A = np.array([[0.95, 0.10], [-0.08, 0.90]])
B = np.array([[0.0], [0.3]])


def episodes(a, b, n=6, steps=40, seed=0, noise=0.0, product=0.0, dt=0.1):
    rng = np.random.default_rng(seed)
    xs, us = [], []
    for _ in range(n):
        u = rng.uniform(-1, 1, (steps, 1))
        x = [rng.standard_normal(2)]
        for k in range(steps):
            x.append(a @ x[-1] + b @ u[k] + product * u[k, 0] * x[-1])
        xs.append(np.array(x) + noise * rng.standard_normal((steps + 1, 2)))
        us.append(u)
    return Episodes(xs, us, dt)


def theta():
    return Dictionary(ob.Constant(), ob.States(), ob.Inputs(), n_states=2, n_inputs=1)


def test_the_truth_is_found_from_a_perfect_twin_and_one_pair_whatever_alpha():
    d1, twin = episodes(A, B), episodes(A, B, seed=1)
    for alpha in (1e-6, 1.0, 1e6):
        model = TwinEDMDc(theta(), alpha=alpha, twin_alpha=1e-14).fit(d1, twin, d1.pairs().take([7])).lifted
        assert_allclose(model.A[1:, 1:], A, atol=1e-7)
        assert_allclose(model.B[1:], B, atol=1e-7)


def test_alpha_goes_from_the_data_to_the_twin():
    d1, twin = episodes(A, B), episodes(0.8 * A, 1.5 * B, seed=1)
    data = TwinEDMDc(theta(), alpha=1e-12, twin_alpha=1e-13).fit(d1, twin).lifted
    assert_allclose(data.A, LinearEDMDc(theta(), alpha=0.0).fit(d1).lifted.A, atol=1e-7)
    physics = TwinEDMDc(theta(), alpha=1e10, twin_alpha=1e-12).fit(d1, twin).lifted
    assert_allclose(physics.A, LinearEDMDc(theta(), alpha=0.0).fit(twin).lifted.A, atol=1e-7)


def test_equal_weight_of_every_pair_is_edmdc_on_the_pooled_data():
    d1, twin = episodes(A, B, noise=0.05, n=3), episodes(0.9 * A, B, seed=1, noise=0.05)
    pooled = Episodes([*d1.xs, *twin.xs], [*d1.us, *twin.us], d1.dt)
    ratio = len(twin.pairs()) / len(d1.pairs())
    model = TwinEDMDc(theta(), alpha=ratio, twin_alpha=1e-14, scale=None).fit(d1, twin).lifted
    expected = LinearEDMDc(theta(), alpha=0.0, scale=None).fit(pooled).lifted
    assert_allclose(model.A, expected.A, atol=1e-9)
    assert_allclose(model.B, expected.B, atol=1e-9)


def test_roll_outs_choose_the_data_when_the_twin_is_wrong_and_the_twin_when_data_are_few_and_noisy():
    d1 = episodes(A, B, n=12)
    wrong = TwinEDMDc(theta(), alpha="cv").fit(d1, episodes(0.5 * A, -B, seed=1))
    assert wrong.score(d1).median < 1e-8
    noisy = episodes(A, B, n=12, noise=0.3)
    right = TwinEDMDc(theta(), alpha="cv").fit(noisy, episodes(A, B, seed=1), noisy.pairs().take(np.arange(4)))
    assert right.alpha_ > 1e-2
    assert_allclose(right.lifted.A[1:, 1:], A, atol=0.05)


def test_a_bilinear_dictionary_makes_a_bilinear_model():
    d1, twin = episodes(A, B, product=0.2), episodes(A, B, product=0.2, seed=1)
    dictionary = Dictionary(ob.Constant(), ob.States(), ob.Inputs(), ob.Bilinear(), n_states=2, n_inputs=1)
    model = TwinEDMDc(dictionary, alpha=1.0, twin_alpha=1e-14).fit(d1, twin, d1.pairs().take([3, 4])).lifted
    expected = BilinearEDMDc(theta(), alpha=0.0).fit(twin).lifted
    assert_allclose(model.N, expected.N, atol=1e-7)
    assert_allclose(model.N[0, 1:, 1:], 0.2 * np.eye(2), atol=1e-7)


def test_what_is_omitted_predicts_nothing_and_is_predicted_and_no_data_are_kept():
    d1, twin = episodes(A, B), episodes(A, B, seed=1)
    estimator = TwinEDMDc(theta(), alpha=1.0, omit=["x2"]).fit(d1, twin)
    assert not any(isinstance(value, Episodes | Pairs) for value in vars(estimator).values())
    model = estimator.lifted
    column = model.column_names.index("x2")
    assert_allclose(model.A[:, column], 0.0, atol=1e-14)
    assert np.abs(model.A[column]).max() > 0.01
    with pytest.raises(ValueError, match="omit names"):
        TwinEDMDc(theta(), omit=["x7"]).fit(d1, twin)


def test_a_read_out_is_learned_from_the_twin_too():
    d1, twin = episodes(A, B), episodes(A, B, seed=1)
    cubes = ob.Expression(lambda x, u: [x[0] + x[1], x[0] - x[1]], name=["sum", "difference"])
    dictionary = Dictionary(ob.Constant(), cubes, ob.Inputs(), n_states=2, n_inputs=1)
    model = TwinEDMDc(dictionary, alpha=1.0).fit(d1, twin, d1.pairs().take([5])).lifted
    x = np.array([[0.3, -0.7]])
    assert_allclose(model.read(model.lift(x, np.zeros((0, 1)))), x[0], atol=1e-6)


@pytest.mark.parametrize(
    ("twin", "text"),
    [
        (PhaseSamples(np.zeros((2, 2)), np.zeros((2, 1)), np.zeros((2, 2))), "expected Episodes"),
        (episodes(A, B, dt=0.2), "twin has dt = 0.2 s, d1 0.1 s"),
        (Episodes([np.zeros((4, 3))], [np.zeros((3, 1))], 0.1), "has 3 states, d1"),
    ],
)
def test_twins_that_do_not_fit_are_refused_in_one_line(twin, text):
    with pytest.raises(ValueError, match=text) as found:
        TwinEDMDc(theta()).fit(episodes(A, B), twin)
    assert "\n" not in str(found.value)
