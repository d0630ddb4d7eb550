"""The penalty of every estimator: its unit, its solver, and what it pulls the map to."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from pisplit import BilinearEDMDc, Dictionary, Episodes, LinearEDMDc, PhaseSamples, PIEDMDc, TwinEDMDc
from pisplit import observables as ob
from pisplit.models import systems
from pisplit.regression import RecursiveRegression, absolute_weight, penalised, unit_weight

DT = 0.05
OPTIONS = {"equilibrium": np.array([[1.0], [0.0]])}
#: Every estimator with a LASSO.
FITS: dict[str, Callable[..., Any]] = {
    "linear": lambda **o: LinearEDMDc(theta(), **o).fit(recorded()),
    "bilinear": lambda **o: BilinearEDMDc(theta(), **o).fit(recorded()),
    "strang": lambda **o: PIEDMDc(theta(), **o).fit(recorded(), known()),
    "lie": lambda **o: PIEDMDc(theta(), split="lie", toward="identity", **o).fit(recorded(), known()),
    "physics": lambda **o: PIEDMDc(theta(), toward="physics", rows="inputs", **o).fit(recorded(), known()),
    "hold": lambda **o: PIEDMDc(theta(), split="hold", rows=["v"], **o).fit(recorded(), known()),
}


def theta() -> Dictionary:
    return Dictionary(ob.Constant(), ob.Identity(), ob.Polynomials(2), n_states=2, n_inputs=1)


def recorded() -> Episodes:
    rng = np.random.default_rng(0)
    return Episodes.from_system(
        systems.duffing(), rng.uniform(-1, 1, (4, 2)), [rng.uniform(-1, 1, (30, 1)) for _ in range(4)], DT
    )


def known() -> PhaseSamples:
    rng = np.random.default_rng(1)
    return PhaseSamples.from_system(systems.duffing(), rng.uniform(-1, 1, (200, 2)), np.zeros((200, 1)))


@pytest.mark.parametrize("name", FITS)
def test_both_solvers_of_a_lasso_find_the_same_operator(name: str) -> None:
    k = {s: FITS[name](alpha=0.03, penalty="lasso", solver=s).K_ for s in ("auto", "active-set", "cvxpy")}
    np.testing.assert_allclose(k["cvxpy"], k["active-set"], atol=1e-6 * np.abs(k["auto"]).max())
    np.testing.assert_allclose(k["auto"], k["active-set"], atol=1e-12)


@pytest.mark.parametrize("name", FITS)
@pytest.mark.parametrize("penalty", ["ridge", "lasso"])
def test_a_weight_for_every_sample_is_the_absolute_weight_times_their_number(name: str, penalty: str) -> None:
    pairs = len(recorded().pairs())
    each = FITS[name](alpha=1e-4, penalty=penalty, relative="samples")
    whole = FITS[name](alpha=1e-4 * pairs, penalty=penalty, relative=False)
    assert each.fit_.alpha == whole.fit_.alpha == pytest.approx(1e-4 * pairs)
    np.testing.assert_array_equal(each.K_, whole.K_)
    assert absolute_weight(0.01, "samples", 5.0, 300) == 3.0
    assert absolute_weight(0.01, True, 5.0, 300) == 0.05


@pytest.mark.parametrize("name", FITS)
def test_a_relative_weight_of_one_is_the_smallest_with_nothing_learned(name: str) -> None:
    pulled, free = FITS[name](alpha=1.0 + 1e-9, penalty="lasso"), FITS[name](alpha=0.9, penalty="lasso")
    limit = FITS[name](alpha=1e6, penalty="lasso").K_
    np.testing.assert_allclose(pulled.K_, limit, atol=1e-12)
    assert np.abs(free.K_ - limit).max() > 1e-6


def test_a_lasso_of_the_hold_split_departs_from_the_physical_map_in_few_entries() -> None:
    physical = FITS["hold"](alpha=1e12, penalty="ridge").K_
    sparse, dense = FITS["hold"](alpha=0.1, penalty="lasso"), FITS["hold"](alpha=0.1, penalty="ridge")
    assert 0 < np.count_nonzero(np.abs(sparse.K_ - physical) > 1e-10) < 10
    assert np.count_nonzero(np.abs(dense.K_ - physical) > 1e-10) > 20
    assert sparse.fit_.gap is not None and sparse.fit_.gap < 1e-6


def test_data_that_stream_in_take_either_solver() -> None:
    rng = np.random.default_rng(2)
    a, y = rng.normal(size=(40, 5)), rng.normal(size=(40, 3))
    regression = RecursiveRegression(5, 3).update(a, y)
    found = [regression.solve(4.0, "lasso", solver=s).K for s in ("active-set", "cvxpy")]
    np.testing.assert_allclose(*found, atol=1e-8)
    assert 0 < np.count_nonzero(found[0]) < 15


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"solver": "osqp"}, "solver = 'osqp'; expected one of"),
        ({"penalty": "ridge", "solver": "cvxpy"}, "leave solver out"),
        ({"relative": "pairs"}, "relative = 'pairs'; expected"),
        ({"penalty": "l1"}, "penalty"),
    ],
)
def test_penalties_that_do_not_exist_are_refused_in_one_line(options: dict[str, Any], message: str) -> None:
    for make in (LinearEDMDc, BilinearEDMDc, PIEDMDc):
        with pytest.raises(ValueError, match=message) as error:
            make(theta(), **{"alpha": 0.1, "penalty": "lasso", **options})
        assert "\n" not in str(error.value)


def test_one_regressor_has_a_closed_form_whose_sign_is_that_of_the_data() -> None:
    a, y = np.array([[1.0], [2.0], [-1.0]]), np.array([[-2.0, 0.2], [-4.5, 0.1], [1.0, 0.3]])
    size, cross = float((a**2).sum()), (a.T @ y)[0]
    np.testing.assert_allclose(penalised(a, y, 0.0, "lasso").K[:, 0], cross / size)
    np.testing.assert_allclose(penalised(a, y, 3.0, "ridge").K[:, 0], cross / (size + 3.0))
    thresholded = np.sign(cross) * np.maximum(np.abs(cross) - 1.5, 0.0) / size
    for solver in ("active-set", "cvxpy"):
        np.testing.assert_allclose(penalised(a, y, 3.0, "lasso", solver).K[:, 0], thresholded, atol=1e-9)
    assert unit_weight(a, y, "lasso") == pytest.approx(2.0 * np.abs(cross).max())
    assert unit_weight(np.hstack([a, 3.0 * a]), y, "ridge") == pytest.approx(5.0 * size)  # mean of both columns


def test_a_relative_ridge_is_in_parts_of_the_mean_variance_of_the_columns() -> None:
    d1 = recorded()
    psi = theta().evaluate(d1.pairs())[:, 1:]
    for scale in (None, "column"):
        centred = psi - psi.mean(axis=0)
        unit = 1.0 if scale is None else centred.std(axis=0)
        mean = float(((centred / unit) ** 2).sum(axis=0).mean())
        assert LinearEDMDc(theta(), 0.3, scale=scale).fit(d1).fit_.alpha == pytest.approx(0.3 * mean)


def test_the_choice_of_alpha_does_not_depend_on_the_units_of_states() -> None:
    """Errors of states in other units count as much: the search over metres and radians is that over millimetres."""
    d1, rng = recorded(), np.random.default_rng(4)
    noisy = Episodes([x + 0.02 * rng.normal(size=x.shape) for x in d1.xs], d1.us, DT)
    other = Episodes([x * [1.0, 1e3] for x in noisy.xs], d1.us, DT)
    plain = Dictionary(ob.Constant(), ob.Identity(), n_states=2, n_inputs=1)
    found = [LinearEDMDc(plain, "cv").fit(data).cv_ for data in (noisy, other)]
    assert found[0] is not None and found[1] is not None
    np.testing.assert_allclose(found[1].errors, found[0].errors, rtol=1e-6)
    assert found[1].chosen == found[0].chosen


def test_a_twin_that_is_the_recording_itself_changes_nothing_whatever_its_weight() -> None:
    """1/N |K Theta - psi'|^2 (1 + alpha) + (1 + alpha) mu |K|^2 has one minimiser for all alpha."""
    d1 = recorded()
    found = [TwinEDMDc(theta(), alpha, 0.1).fit(d1, d1).K_ for alpha in (0.0, 1.0, 100.0)]
    np.testing.assert_allclose(found[1], found[0], atol=1e-10)
    np.testing.assert_allclose(found[2], found[0], atol=1e-10)
    assert np.abs(found[0] - TwinEDMDc(theta(), 1.0, 0.2).fit(d1, d1).K_).max() > 1e-3  # the ridge is felt
