"""choose: estimators and dictionaries, judged by the held-out roll-outs that choose alpha."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from pisplit import BilinearEDMDc, Dictionary, Episodes, LinearEDMDc, PIEDMDc, ReliftedEDMDc, StreamingEDMDc, choose
from pisplit import observables as ob

A = np.array([[0.9, 0.2], [-0.1, 0.8]])
B = np.array([[0.1], [0.3]])
N = np.array([[0.0, 0.3], [-0.3, 0.0]])


def recordings(
    number: int = 5, steps: int = 30, noise: float = 0.0, product: float = 1.0, lag: bool = False
) -> Episodes:
    """x+ = A x + B u + product u N x; ``lag``: under the last command."""
    rng = np.random.default_rng(3)
    xs, us = [], []
    for _ in range(number):
        x, u = [rng.normal(size=2)], rng.uniform(-1, 1, (steps, 1))
        for k in range(steps):
            command = u[k - 1 if lag and k else k]
            x.append(A @ x[-1] + B @ command + product * command * (N @ x[-1]))
        xs.append(np.array(x) + noise * rng.normal(size=(steps + 1, 2)))
        us.append(u)
    return Episodes(xs, us, dt=0.1)


def theta(*more: Any) -> Dictionary:
    return Dictionary(ob.Constant(), ob.States(), ob.Inputs(), *more, n_states=2, n_inputs=1)


def test_the_dictionary_that_holds_the_system_wins_and_is_fitted_to_all_pairs() -> None:
    d1 = recordings(noise=1e-4)
    found = choose([theta(), theta(ob.Polynomials(2)), theta(ob.Bilinear())], d1, progress=False)
    assert found.name == "3: BilinearEDMDc" and found.estimator.bounded_ is True
    assert_array_equal(found.estimator.K_, BilinearEDMDc(theta(), alpha="cv").fit(d1, d1.pairs()).K_)
    errors = [c.error for c in found.tried]
    assert errors[2] < 1e-3 * min(errors[:2])
    assert [c.fits for c in found.tried] == [14 * 5 + 1] * 3 and found.folds == tuple(
        f"recording {i}" for i in range(5)
    )
    table = str(found).splitlines()
    assert "fits" in table[0] and "on 5 folds" in table[0] and "(chosen)" in table[3]


def test_delays_are_judged_on_the_steps_of_those_without() -> None:
    d1 = recordings(noise=1e-3, product=0.0, lag=True)
    found = choose(
        {"now": theta(), "last": theta(ob.Delays(inputs=1)), "far": theta(ob.Delays(inputs=4))}, d1, progress=False
    )
    now, last, far = (c.error for c in found.tried)
    assert found.name in ("last", "far") and max(last, far) < 1e-2 * now
    fixed = choose({"now": LinearEDMDc(theta(), alpha=0.1), "far": theta(ob.Delays(inputs=4))}, d1, progress=False)
    assert fixed.tried[0].choice == "alpha = 0.1" and fixed.tried[0].fits == 6
    assert fixed.estimator.cv_.folds.shape[1] == 5


def test_the_first_within_the_tolerance_is_taken() -> None:
    d1 = recordings(noise=0.02, product=0.0)
    ordered = [theta(), theta(ob.Polynomials(3))]
    assert choose(ordered, d1, tolerance=2.0, progress=False).name.startswith("1")
    assert choose(ordered[::-1], d1, tolerance=2.0, progress=False).name.startswith("1")


def test_what_cannot_be_fitted_is_told_and_what_does_not_stay_bounded_comes_last() -> None:
    d1 = recordings(noise=1e-3)
    found = choose({"known": PIEDMDc(theta(), 0.1), "plain": theta()}, d1, progress=False)
    assert found.name == "plain" and found.tried[0].refusal == "PIEDMDc learns from phase samples too; give d2"
    growing = Episodes([1.3 ** np.arange(31)[:, None] * x for x in d1.xs], d1.us, 0.1)
    with pytest.warns(UserWarning, match="no candidate stays bounded under the excitation"):
        wild = choose([BilinearEDMDc(theta(), alpha=1e-9)], growing, progress=False)
    assert wild.tried[0].bounded is False and "does not stay bounded" in str(wild)


def test_relifted_models_take_part() -> None:
    relifted = ReliftedEDMDc((2,), (2,), (2,), (1e-9, 1e-3))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = choose({"linear": theta(), "re-lifted": relifted}, recordings(lag=False), progress=False)
    assert found.name == "re-lifted" and found.tried[1].fits == 11
    assert found.tried[1].choice.startswith("2 components")


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ([], "expected at least one estimator or dictionary"),
        ("LinearEDMDc", "expected at least one estimator or dictionary"),
        ([3.0], "candidate 1 is a float; expected an estimator"),
        ([StreamingEDMDc(theta())], "candidate 1 is a StreamingEDMDc; expected an estimator with alpha='cv'"),
        ({"a": PIEDMDc(theta(), 0.1)}, "no candidate can be fitted: a: PIEDMDc learns from phase samples too"),
    ],
)
def test_what_is_nothing_to_choose_from_is_refused_in_one_line(given: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        choose(given, recordings(2), progress=False)
