"""max_radius: modes outside the circle move onto it, everything else stays."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from pisplit import BilinearEDMDc, Dictionary, Episodes, LinearEDMDc, PhaseSamples, PIEDMDc
from pisplit import observables as ob

A = np.array([[1.05, 0.2, 0.0], [-0.2, 1.05, 0.0], [0.3, -0.1, 0.6]])  # a growing spiral that drives a decay
B = np.array([[0.0], [0.3], [0.1]])


def growing(rng: np.random.Generator, steps: int = 40) -> Episodes:
    us = [rng.normal(size=(steps, 1)) for _ in range(6)]
    xs = []
    for u in us:
        x = [rng.normal(size=3)]
        for k in range(steps):
            x.append(A @ x[-1] + B @ u[k] + 0.1)
        xs.append(np.array(x))
    return Episodes(xs, us, dt=0.1)


def radius(model: Any) -> float:
    return float(np.abs(np.linalg.eigvals(model.lifted.A)).max())


@pytest.mark.parametrize("bound", [1.0, 0.8, 0.5])
def test_only_the_modes_outside_move(bound: float) -> None:
    d1 = growing(np.random.default_rng(1))
    theta = Dictionary(ob.Constant(), ob.Identity(), ob.Delays(inputs=1), n_states=3, n_inputs=1)
    with pytest.warns(UserWarning, match="ask for a spectral radius of 1.069"):
        model = LinearEDMDc(theta, max_radius=bound).fit(d1)
    k = model.lifted.A[1:4, 1:4]
    before = np.linalg.eigvals(A)
    expected = before * np.minimum(1.0, bound / np.abs(before))
    np.testing.assert_allclose(np.sort_complex(np.linalg.eigvals(k)), np.sort_complex(expected), atol=1e-8)
    if bound > 0.6:
        np.testing.assert_allclose(k[:, 2], A[:, 2], atol=1e-9)  # the direction of the decay is a mode of its own
    assert model.lifted.A[0, 0] == 1.0 and np.count_nonzero(model.lifted.A[4]) == 0
    assert model.fit_.details["unbounded_radius"] == pytest.approx(np.abs(before).max())
    np.testing.assert_allclose(model.lifted.B[1:4], B, atol=1e-8)


def test_a_model_inside_the_circle_is_not_touched() -> None:
    d1 = growing(np.random.default_rng(2))
    theta = Dictionary(ob.Constant(), ob.Identity(), n_states=3, n_inputs=1)
    free, held = LinearEDMDc(theta).fit(d1), LinearEDMDc(theta, max_radius=1.2).fit(d1)
    np.testing.assert_array_equal(free.K_, held.K_)
    assert "unbounded_radius" not in held.fit_.details


@pytest.mark.filterwarnings("ignore:the data ask for a spectral radius")
@pytest.mark.parametrize("growth", [(1.1, 0.5), (1.1, 1.2), (1.05 * np.exp(0.3j), 1.05 * np.exp(-0.3j))])
def test_delays_shift_exactly_under_a_bound(growth: tuple[complex, complex]) -> None:
    rng = np.random.default_rng(3)
    u, x = rng.normal(size=(60, 1)), np.zeros((61, 1))
    x[:2] = rng.normal(size=(2, 1))
    first, second = np.real(sum(growth)), np.real(np.prod(growth))
    for k in range(1, 60):
        x[k + 1] = first * x[k] - second * x[k - 1] + u[k]
    theta = Dictionary(ob.Identity(), ob.Delays(states=1), n_states=1, n_inputs=1)
    model = LinearEDMDc(theta, max_radius=0.95).fit(Episodes([x], [u], 0.1))
    np.testing.assert_array_equal(model.lifted.A[1], [1.0, 0.0])
    assert radius(model) == pytest.approx(0.95)
    if growth[1] == 0.5:  # one mode outside and one learned row: the other stays
        assert np.abs(np.linalg.eigvals(model.lifted.A)).min() == pytest.approx(0.5)


@pytest.mark.filterwarnings("ignore:the data ask for a spectral radius")
def test_the_bound_holds_for_every_estimator_and_within_cross_validation() -> None:
    rng = np.random.default_rng(4)
    d1 = growing(rng)
    theta = Dictionary(ob.Constant(), ob.Identity(), n_states=3, n_inputs=1)
    points = rng.normal(size=(50, 3))
    d2 = PhaseSamples(points, np.zeros((50, 1)), points @ np.diag([0.3, 0.3, -4.0]))
    split = PIEDMDc(theta, alpha="cv", penalty="ridge", max_radius=0.9).fit(d1, d2)
    bilinear = BilinearEDMDc(theta, max_radius=0.9).fit(d1)
    for model in (split, bilinear):
        assert np.abs(np.linalg.eigvals(model.lifted.A[1:, 1:])).max() == pytest.approx(0.9)
    assert split.cv_ is not None and np.isfinite(split.cv_.errors).all()


@pytest.mark.parametrize("bound", [0.0, -1.0, np.nan])
def test_a_bound_is_positive(bound: float) -> None:
    with pytest.raises(ValueError, match="max_radius"):
        LinearEDMDc(Dictionary(ob.Identity(), n_states=1, n_inputs=1), max_radius=bound)
