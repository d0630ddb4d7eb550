"""Static solutions of the actuated system as data: fixed points that every model of them keeps."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pytest

from pisplit import BilinearEDMDc, Dictionary, Episodes, LinearEDMDc, PhaseSamples, PIEDMDc
from pisplit import observables as ob

RNG = np.random.default_rng(12)
A = np.array([[0.9, 0.1], [-0.2, 0.8]])
B = np.array([[0.1], [0.4]])
POINTS = np.linspace(-2, 2, 9)[:, None]


def rest(u: np.ndarray) -> np.ndarray:
    """Fixed points of x+ = A x + B sin u."""
    return np.linalg.solve(np.eye(2) - A, B @ np.sin(u).T).T


def run(steps: int) -> Episodes:
    u, x = RNG.uniform(-1, 1, (steps, 1)), [np.array([0.5, -0.5])]
    for k in range(steps):
        x.append(A @ x[-1] + B @ np.sin(u[k]))
    return Episodes([np.array(x)], [u], dt=0.1)


def dictionary(*more: Any) -> Dictionary:
    return Dictionary(ob.Identity(), ob.Expression(lambda x, u: u**3, name="u^3"), *more, n_states=2, n_inputs=1)


def with_sine(*more: Any) -> Dictionary:
    sine = ob.Expression(lambda x, u: ca.sin(u), name="sin u")
    return Dictionary(ob.States(), sine, *more, n_states=2, n_inputs=1)


def test_equilibria_complete_trajectories_that_are_too_short() -> None:
    d1, equilibria = run(2), (rest(POINTS), POINTS)  # two pairs for three unknowns a row
    model = LinearEDMDc(with_sine()).fit(d1, equilibria=equilibria)
    np.testing.assert_allclose(model.lifted.A, A, atol=1e-9)
    np.testing.assert_allclose(model.lifted.B, B, atol=1e-9)
    assert model.lifted.provenance["equilibria"] == 9
    assert np.abs(LinearEDMDc(with_sine()).fit(d1).lifted.A - A).max() > 1e-3


@pytest.mark.parametrize("delays", [ob.Delays(), ob.Delays(states=2, inputs=1)])
def test_fixed_points_are_kept_with_the_past_equal_to_the_present(delays: ob.Delays) -> None:
    model = LinearEDMDc(with_sine(delays), alpha=1e-12).fit(run(40), equilibria=(rest(POINTS), POINTS)).lifted
    for u in POINTS:
        np.testing.assert_allclose(model.read(model.fixed_point(u)), rest(u[None])[0], atol=1e-5)


@pytest.mark.parametrize("kind", [LinearEDMDc, BilinearEDMDc])
def test_a_dictionary_that_cannot_be_exact_moves_its_fixed_points_toward_the_equilibria(kind: Any) -> None:
    d1, point = run(60), np.array([2.0])
    many = np.repeat(POINTS, 50, axis=0)
    errors = []
    for equilibria in (None, (rest(many), many)):
        model = kind(dictionary(), alpha=1e-10).fit(d1, equilibria=equilibria).lifted
        errors.append(np.abs(model.read(model.fixed_point(point)) - rest(point[None])[0]).max())
    assert errors[1] < 0.5 * errors[0]


def test_splits_take_equilibria_and_cv_does_not_hold_them_out() -> None:
    x = RNG.normal(size=(30, 2))
    d2 = PhaseSamples(x, np.zeros((30, 1)), x @ (A - np.eye(2)).T / 0.1)
    d1, equilibria = run(60), (rest(POINTS), POINTS)
    fitted = PIEDMDc(with_sine(), alpha="cv", penalty="ridge").fit(d1, d2, equilibria=equilibria)
    assert fitted.score(d1).median < 1e-10
    both = [PIEDMDc(with_sine(), alpha=1e-3, penalty="ridge").fit(d1, d2, equilibria=e).K_ for e in (None, equilibria)]
    assert np.abs(both[0] - both[1]).max() > 1e-8


@pytest.mark.parametrize(
    "equilibria",
    [rest(POINTS), (rest(POINTS), POINTS[1:]), (POINTS, POINTS), ([[np.nan, 0.0]], [[0.0]])],
)
def test_other_arrays_are_refused_in_one_line(equilibria: Any) -> None:
    with pytest.raises(ValueError, match=r"of equilibria|two arrays") as error:
        LinearEDMDc(dictionary()).fit(run(10), equilibria=equilibria)
    assert "\n" not in str(error.value)
