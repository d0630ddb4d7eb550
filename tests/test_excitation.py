"""Excitation: models that do not stay bounded under inputs they are made for are not chosen."""

import warnings

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from pisplit import BilinearEDMDc, Dictionary, Episodes, LinearEDMDc, TwinEDMDc
from pisplit import observables as ob
from pisplit.estimators.alpha_search import preferred
from pisplit.estimators.boundedness import EXCURSION, Excitation
from pisplit.estimators.commands import resampled_commands
from pisplit.evaluation.rollouts import rollout_errors

STABLE = np.array([[0.95, 0.10], [-0.08, 0.90]])
B = np.array([[0.0], [0.3]])
ALPHAS = np.array([1e-4, 1e-2, 1.0, 100.0])


def inputs(n, steps, seed):
    return np.random.default_rng(seed).uniform(-1, 1, (n, steps, 1))


def episodes(n=6, steps=40, seed=0, noise=0.0, a=STABLE, curved=0.0):
    """x+ = A x + B u - curved x^3."""
    rng = np.random.default_rng(seed)
    xs, us = [], inputs(n, steps, seed + 100)
    for u in us:
        x = [0.5 * rng.standard_normal(2)]
        for k in range(steps):
            x.append(a @ x[-1] + B @ u[k] - curved * x[-1] ** 3)
        xs.append(np.array(x) + noise * rng.standard_normal((steps + 1, 2)))
    return Episodes(xs, list(us), 0.1)


def theta():
    return Dictionary(ob.Constant(), ob.States(), ob.Inputs(), n_states=2, n_inputs=1)


def rich():
    return Dictionary(ob.Constant(), ob.States(), ob.Polynomials(4), ob.Inputs(), ob.Bilinear(), n_states=2, n_inputs=1)


def test_a_stable_model_is_bounded_and_an_unstable_one_is_not():
    d1, us = episodes(), inputs(8, 200, 7)
    model = LinearEDMDc(theta()).fit(d1).lifted
    excitation = Excitation.of(us, [d1.pairs()], ("a", "b"))
    assert excitation.bounds(model)
    wild = LinearEDMDc(theta()).fit(episodes(a=1.12 * STABLE, steps=20)).lifted
    assert not excitation.bounds(wild)


def test_the_limit_is_three_times_the_data_of_a_quantity_and_a_start_is_where_the_input_is_alike():
    x, u = np.array([[0.0, 1.0], [2.0, -5.0], [0.0, 0.0]]), np.array([[0.1], [0.9]])
    pairs = Episodes([x], [u], 0.1).pairs()
    alone = Excitation.of(np.full((1, 4, 1), 0.8), [pairs], ("a", "b"))
    assert_array_equal(alone.limit, EXCURSION * np.array([2.0, 5.0]))
    assert_array_equal(alone.x_history[0, 0], x[1])
    assert_array_equal(Excitation.of(np.zeros((1, 4, 1)), [pairs], ("a", "a")).limit, 5.0 * EXCURSION)


def test_the_limit_of_several_data_sets_is_that_of_the_one_which_reaches_farthest_in_each_quantity():
    near = Episodes([np.array([[0.0, 1.0], [5.0, -2.0]])], [np.array([[0.1]])], 0.1).pairs()
    far = Episodes([np.array([[1.0, 10.0], [0.5, 2.0], [0.0, 0.0]])], [np.array([[0.3], [0.2]])], 0.1).pairs()
    for data in ([near, far], [far, near]):
        found = Excitation.of(np.full((1, 4, 1), 0.1), data, ("a", "b"))
        assert_array_equal(found.limit, EXCURSION * np.array([5.0, 10.0]))
        assert_array_equal(found.x_history[0, 0], [0.5, 2.0])  # roll-outs begin in the larger set


NOTHING = np.full(4, np.inf)


def test_the_first_alpha_in_order_of_preference_that_stays_bounded_is_taken():
    errors = np.array([4.0, 1.0, 1.04, 3.0])
    assert preferred(ALPHAS, errors, NOTHING, 0.0).best == 1
    assert preferred(ALPHAS, errors, NOTHING, 0.05).best == 2
    found = preferred(ALPHAS, errors, NOTHING, 0.05, lambda i: i == 3)
    assert (found.best, found.passed, found.bounded) == (3, (1, 2), True)
    tried = []
    preferred(ALPHAS, errors, NOTHING, 0.0, lambda i: bool(tried.append(i)) or len(tried) == 2)
    assert tried == [1, 2]  # nothing is rolled out that is not asked for


def test_where_nothing_stays_bounded_errors_alone_decide_and_all_are_named():
    found = preferred(ALPHAS, np.array([4.0, 1.0, np.inf, 3.0]), NOTHING, 0.0, lambda i: False)
    assert (found.best, found.passed, found.bounded) == (1, (0, 1, 3), False)


def test_where_everything_diverges_the_fewest_folds_decide_and_then_the_largest_alpha():
    few = np.array([np.inf, 2.0, 3.0, np.inf])
    assert preferred(ALPHAS, NOTHING, few, 0.0).best == 1
    assert preferred(ALPHAS, NOTHING, NOTHING, 0.0).best == 3


@pytest.mark.parametrize("estimator", [LinearEDMDc, BilinearEDMDc])
def test_an_excitation_that_the_choice_survives_changes_nothing(estimator):
    d1, us = episodes(noise=0.02), inputs(8, 200, 7)
    free, asked = (estimator(theta(), alpha="cv").fit(d1, excitation=e) for e in (None, us))
    assert (free.bounded_, asked.bounded_) == (None, True)
    assert_array_equal(free.K_, asked.K_)
    assert free.alpha_ == asked.alpha_


def test_small_twins_with_rich_dictionaries_diverge_unless_an_excitation_is_given():
    test, us = episodes(n=20, steps=100, seed=50, curved=0.05), inputs(32, 200, 9)
    diverged = {"free": 0.0, "asked": 0.0}
    for seed in range(5):
        twin = episodes(n=2, steps=12, seed=seed, curved=0.05, noise=0.02)
        d1 = episodes(n=2, steps=15, seed=seed + 20, curved=0.05)
        for name, e in (("free", None), ("asked", us)):
            fitted = TwinEDMDc(rich(), alpha=1.0, twin_alpha=1e-8).fit(d1, twin, excitation=e)
            diverged[name] += rollout_errors(fitted.lifted, test).diverged_fraction / 5
        assert fitted.bounded_ and fitted.twin_alpha_ > 1e-8
        assert fitted.lifted.provenance["bounded"] is True
    assert diverged["free"] > 0.5
    assert diverged["asked"] == 0.0


def test_the_smallest_ridge_that_helps_is_taken_when_alpha_is_given():
    d1, twin, us = episodes(), episodes(seed=1), inputs(8, 200, 7)
    fitted = TwinEDMDc(theta(), alpha=1.0, twin_alpha=1e-9).fit(d1, twin, excitation=us)
    assert fitted.twin_alpha_ == 1e-9


def test_an_unstable_plant_is_reported_and_kept():
    d1 = episodes(a=1.12 * STABLE, steps=20)
    with pytest.warns(UserWarning, match="the model does not stay bounded"):
        fitted = LinearEDMDc(theta(), alpha=1e-9).fit(d1, excitation=inputs(4, 400, 3))
    assert fitted.bounded_ is False
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert_array_equal(LinearEDMDc(theta(), alpha=1e-9).fit(d1).K_, fitted.K_)


@pytest.mark.parametrize("wrong", [np.zeros((4, 1)), np.zeros((4, 10, 2)), np.zeros((0, 10, 1)), [[[np.nan]]]])
def test_an_excitation_of_another_shape_is_refused_in_one_line(wrong):
    with pytest.raises(ValueError, match="excitation") as found:
        LinearEDMDc(theta()).fit(episodes(), excitation=wrong)
    assert "\n" not in str(found.value)


def test_commands_are_made_of_recorded_ones_and_lie_where_these_span():
    d1 = episodes(n=5, steps=30)
    two = Episodes(d1.xs, [np.hstack([u, 0 * u]) if i % 2 else np.hstack([0 * u, u]) for i, u in enumerate(d1.us)], 0.1)
    made = resampled_commands(two)
    assert made.shape == (32, 60, 2)
    assert_array_equal(made, resampled_commands(two))
    known = {tuple(row) for row in two.stacked_inputs()}
    assert {tuple(row) for row in made[:16].reshape(-1, 2)} <= known
    together = np.abs(made[16:]).min(axis=2) > 0.0  # averages move both inputs at once, within what one moves alone
    assert together.mean() > 0.5 and (np.abs(made[16:]).sum(axis=2) <= np.abs(two.stacked_inputs()).max() + 1e-12).all()
    assert resampled_commands(two, horizon=7).shape == (32, 7, 2)


def test_bilinear_models_are_tested_unless_nobody_wants_it_and_linear_ones_on_demand():
    d1 = episodes(noise=0.02)
    bilinear, linear = BilinearEDMDc(theta(), alpha=1e-3), LinearEDMDc(theta(), alpha=1e-3)
    assert bilinear.fit(d1).bounded_ is True and bilinear.fit(d1, excitation=None).bounded_ is None
    assert linear.fit(d1).bounded_ is None and linear.fit(d1, excitation="data").bounded_ is True
    with pytest.raises(ValueError, match="excitation = 'all'; expected 'auto', 'data', input sequences"):
        linear.fit(d1, excitation="all")


def test_a_bilinear_model_of_a_given_alpha_that_leaves_the_data_says_so():
    d1 = episodes(n=2, steps=12, curved=0.05, noise=0.05)
    with pytest.warns(UserWarning, match="the model does not stay bounded under the excitation"):
        assert BilinearEDMDc(rich()).fit(d1).bounded_ is False


def test_divergent_models_are_passed_over_by_default():
    """Single inputs move in few noisy pairs: without the test some choices diverge under what nobody recorded."""
    test, diverged = episodes(n=20, steps=100, seed=50, curved=0.05), {"auto": 0.0, None: 0.0}
    for seed in range(4):
        d1 = episodes(n=3, steps=12, seed=seed + 20, curved=0.05, noise=0.02)
        for e in diverged:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                fitted = BilinearEDMDc(rich(), alpha=1e-9 if e is None else "cv").fit(d1, excitation=e)
            diverged[e] += rollout_errors(fitted, test).diverged_fraction / 4
    assert diverged["auto"] == 0.0 < diverged[None]
