"""The balanced split: equilibria kept whatever the gains, exact without an unknown part, second order with one."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import scipy.linalg

from pisplit import Dictionary, Episodes, PhaseSamples, PIEDMDc
from pisplit import observables as ob

A = np.array([[0.0, 1.0, 0.0], [-4.0, -0.4, 1.0], [0.5, 0.0, -2.0]])
E = np.array([[1.0, 0.2], [0.0, 0.0], [0.3, -0.5]])  # equilibrium x = E u
PORT = np.array([[0.0], [1.0], [0.3]])
LOAD = np.array([[1.0, 0.0, 0.5]])
GAIN = -1.7
OPTIONS = {"equilibrium": E, "ports": PORT, "loads": LOAD}


def run(drift: np.ndarray, dt: float, steps: int, seed: int, first: bool) -> tuple[np.ndarray, np.ndarray]:
    """x' = drift (x - E u), u constant over a step or (``first``) linear from its last value, in closed form."""
    rng = np.random.default_rng(seed)
    u, x = np.cumsum(0.3 * rng.normal(size=(steps, 2)), axis=0), [rng.normal(size=3)]
    f, inverse = scipy.linalg.expm(drift * dt), np.linalg.inv(drift)
    for k in range(steps):
        before = u[k - 1] if k and first else u[k]
        slope = E @ (u[k] - before) / dt
        # x - E u + drift^-1 (d/dt E u) decays under the drift while u is linear.
        x.append(E @ u[k] + inverse @ slope + f @ (x[-1] - E @ before - inverse @ slope))
    return np.array(x), u


def data(drift: np.ndarray, dt: float = 0.05, first: bool = False) -> Episodes:
    runs = [run(drift, dt, 30, seed, first) for seed in range(4)]
    return Episodes([x for x, _ in runs], [u for _, u in runs], dt=dt)


def known() -> PhaseSamples:
    rng = np.random.default_rng(9)
    x, u = rng.normal(size=(40, 3)), rng.normal(size=(40, 2))
    return PhaseSamples(x, u, (x - u @ E.T) @ A.T)


def dictionary(first: bool = False, constant: bool = True) -> Dictionary:
    parts: list[Any] = [ob.Constant()] if constant else []
    return Dictionary(*parts, ob.Identity(), ob.Delays(inputs=int(first)), n_states=3, n_inputs=2)


def fitted(d1: Episodes, first: bool = False, alpha: float | str = 0.0, **options: Any) -> PIEDMDc:
    return PIEDMDc(dictionary(first), alpha=alpha, split="balanced", options=OPTIONS | options).fit(d1, known())


@pytest.mark.parametrize("first", [True, False])
@pytest.mark.parametrize("alpha", [0.0, 1e-3, 1e6])
def test_every_equilibrium_is_a_fixed_point_whatever_the_gains(first: bool, alpha: float) -> None:
    noisy = data(A + 3.0 * np.eye(3), first=first)  # not the system it takes for known
    model = fitted(noisy, first, alpha).lifted
    for u in (np.zeros(2), np.array([0.7, -1.3])):
        np.testing.assert_allclose(model.read(model.fixed_point(u)), E @ u, atol=1e-9)


def test_plain_strang_loses_the_equilibrium_that_the_balanced_split_keeps() -> None:
    # Known: the free system. Unknown: the load that holds the equilibria, of which "ports" see one direction only.
    rng = np.random.default_rng(1)
    x = rng.normal(size=(40, 3))
    free = PhaseSamples(x, np.zeros((40, 2)), x @ A.T)
    d1, u = data(A, dt=0.5), np.array([1.0, 0.5])
    strang = PIEDMDc(dictionary(), alpha=0.0, penalty="ridge", rows=["x2"]).fit(d1, free).lifted
    assert np.abs(strang.read(strang.fixed_point(u)) - E @ u).max() > 1e-2
    balanced = fitted(d1).lifted
    np.testing.assert_allclose(balanced.read(balanced.fixed_point(u)), E @ u, atol=1e-9)


@pytest.mark.parametrize("constant", [True, False])
def test_without_an_unknown_part_it_is_exact_and_the_gains_vanish(constant: bool) -> None:
    d1 = data(A, dt=0.4)
    model = PIEDMDc(dictionary(constant=constant), alpha=0.0, split="balanced", options=OPTIONS).fit(d1, known())
    np.testing.assert_allclose(model.fit_.details["gains"], 0.0, atol=1e-9)
    for x, u in zip(d1.xs, d1.us, strict=True):
        np.testing.assert_allclose(model.predict(x[0], u), x, atol=1e-9)


@pytest.mark.parametrize("first", [True, False])
def test_gains_are_found_to_second_order_in_the_step(first: bool) -> None:
    # One kick over dt is dt P H D with exp(dt P GAIN D) = 1 + dt P H D.
    errors, rate = [], float((LOAD @ PORT)[0, 0])
    for dt in (0.04, 0.02, 0.01):
        gains = fitted(data(A + GAIN * PORT @ LOAD, dt, first), first).fit_.details["gains"]
        errors.append(abs(gains[0][0] - np.expm1(rate * GAIN * dt) / (rate * dt)))
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert orders.min() > 1.7 and errors[-1] < 1e-2


def test_more_ports_and_loads_follow_the_data_better() -> None:
    d1 = data(A + GAIN * PORT @ LOAD, 0.2)
    few, many = (
        PIEDMDc(dictionary(), alpha=0.0, split="balanced", options=o).fit(d1, known()).score(d1).median
        for o in (OPTIONS, {"equilibrium": E})
    )
    assert many < 0.1 * few and many < 1e-12  # with all of them any map that keeps the equilibria is reached


def test_a_large_alpha_leaves_the_known_part_and_cv_does_not_take_it() -> None:
    d1 = data(A + GAIN * PORT @ LOAD, 0.05)
    np.testing.assert_allclose(fitted(d1, alpha=1e12).fit_.details["gains"], 0.0, atol=1e-6)
    chosen = fitted(d1, alpha="cv")
    assert chosen.alpha_ < 1.0 and chosen.score(d1).median < 0.01 * fitted(d1, alpha=1e12).score(d1).median


def test_units_of_ports_and_loads_do_not_change_a_regularised_fit() -> None:
    d1 = data(A + GAIN * PORT @ LOAD)
    one = fitted(d1, alpha=0.1)
    other = fitted(d1, alpha=0.1, ports=1e6 * PORT, loads=1e-3 * LOAD)
    np.testing.assert_allclose(other.K_, one.K_, atol=1e-12)


@pytest.mark.parametrize(
    ("options", "theta", "message"),
    [
        ({}, dictionary(), "needs options"),
        ({"equilibrium": E.T}, dictionary(), "equilibrium"),
        ({"equilibrium": E, "knots": 1}, dictionary(), "options of split='balanced'"),
        ({"equilibrium": E, "loads": np.zeros((1, 3))}, dictionary(), "no direction"),
        ({"equilibrium": E}, Dictionary(ob.Identity(), ob.Delays(states=1), n_states=3, n_inputs=2), "no delays"),
        ({"equilibrium": E, "tangent": 3}, dictionary(), "needs PhaseSamples"),
    ],
)
def test_misuse_is_refused_in_one_line(options: dict[str, Any], theta: Dictionary, message: str) -> None:
    with pytest.raises(ValueError, match=message) as error:
        PIEDMDc(theta, alpha=0.0, split="balanced", options=options).fit(data(A), known())
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("penalty", ["ridge", "lasso"])
def test_alpha_has_the_units_in_which_ports_and_loads_are_of_size_one(penalty: str) -> None:
    d1 = data(A + GAIN * PORT @ LOAD, 0.05)
    fits = [
        PIEDMDc(dictionary(), alpha=0.3, split="balanced", penalty=penalty, options=options).fit(d1, known())
        for options in (OPTIONS, OPTIONS | {"ports": 70.0 * PORT, "loads": 0.01 * LOAD})
    ]
    np.testing.assert_allclose(fits[0].fit_.K, fits[1].fit_.K, rtol=0, atol=1e-9)
    assert np.abs(fits[0].fit_.details["gains"]).max() > 0.1


def gain(alpha: float, penalty: str, dt: float = 0.05) -> float:
    d1 = data(A + GAIN * PORT @ LOAD, dt)
    model = PIEDMDc(dictionary(), alpha=alpha, split="balanced", penalty=penalty, options=OPTIONS).fit(d1, known())
    return float(model.fit_.details["gains"][0][0])


def test_of_one_gain_ridge_of_weight_one_leaves_half_and_lasso_of_weight_one_nothing() -> None:
    # One unknown: |y - h a|^2 + w h^2 is least at h_0 / (1 + w / |a|^2), and w = alpha |a|^2.
    free = gain(0.0, "ridge")
    assert gain(0.0, "lasso") == pytest.approx(free, rel=1e-12)
    for alpha in (0.5, 1.0, 3.0):
        assert gain(alpha, "ridge") == pytest.approx(free / (1.0 + alpha), rel=1e-9)
    # |y - h a|^2 + w |h|: h falls linearly with w and is zero from the largest slope 2 |a y| on, where alpha = 1.
    for alpha in (0.25, 0.5, 0.999):
        assert gain(alpha, "lasso") == pytest.approx(free * (1.0 - alpha), rel=1e-6)
    assert gain(1.0, "lasso") == 0.0
