"""Directions of the inputs that recordings excite: which of them a model knows, who is told, who may overrule it."""

from __future__ import annotations

import numpy as np
import pytest

from pisplit import Dictionary, Episodes, LinearEDMDc
from pisplit import observables as ob
from pisplit.controllers import MPC

A = np.array([[0.9, 0.2], [-0.1, 0.8]])
B = np.array([[0.4, -0.2, -0.2], [0.0, 0.3, -0.3]])
NAMES = ("left", "right", "back")


def recorded(decimals: int, stray: float = 0.0, unit: float = 1.0) -> Episodes:
    """Three pulls that sum to zero, as a log with so many decimals has them; ``stray`` moves all of them alike."""
    rng, xs, us = np.random.default_rng(0), [], []
    for _ in range(6):
        u = rng.uniform(-8e-3, 8e-3, (60, 3))
        u += stray * rng.uniform(-8e-3, 8e-3, (60, 1)) - u.mean(axis=1, keepdims=True)
        x = np.zeros((61, 2))
        for k in range(60):
            x[k + 1] = A @ x[k] + B @ u[k]
        xs.append(x)
        us.append(unit * np.round(u, decimals))
    return Episodes(xs, us, 0.05, input_names=NAMES, outputs={"tip": (0, 1)})


def fitted(data: Episodes) -> LinearEDMDc:
    return LinearEDMDc(Dictionary(ob.Identity(), n_states=2, n_inputs=3)).fit(data)


@pytest.mark.parametrize("unit", [1.0, 1e3])
@pytest.mark.parametrize("decimals", [17, 5, 4])
def test_the_rounding_of_a_log_excites_nothing(decimals: int, unit: float) -> None:
    found = recorded(decimals, unit=unit).input_directions()
    assert found.basis.shape == (3, 2)
    np.testing.assert_allclose(found.basis.T @ np.ones(3), 0.0, atol=1e-2)
    *_, last = found.lines(NAMES)
    assert last.startswith(("+0.58 left +0.58 right +0.58 back", "-0.58 left -0.58 right -0.58 back"))
    assert last.endswith("of the largest spread, held")


@pytest.mark.parametrize(("stray", "kept"), [(0.01, 2), (0.2, 3)])
def test_a_direction_counts_from_three_percent_of_the_largest(stray: float, kept: int) -> None:
    found = recorded(17, stray).input_directions()
    assert found.basis.shape == (3, kept) and (found.shares[2] > 0.03) == (kept == 3)
    np.testing.assert_allclose(found.basis.T @ found.basis, np.eye(kept), atol=1e-12)


def test_what_is_held_is_said_by_model_and_controller_and_can_be_overruled() -> None:
    model = fitted(recorded(5)).lifted
    assert sum("held" in line for line in model.provenance["input_directions"]) == 1
    mpc = MPC(model, 5, -0.01, 0.01, 0.005)
    assert "input_basis overrides" in mpc.notes[0] and any("held" in line for line in mpc.notes)
    u = mpc.step([0.01, 0.0], np.full((5, 2), [0.02, 0.01])).u
    assert np.abs(u).max() > 1e-3 and abs(u.sum()) < 1e-5
    free = MPC(model, 5, -0.01, 0.01, 0.005, input_basis=np.eye(3))
    assert "as given in input_basis" in free.notes[0]
    one = MPC(model, 5, -0.01, 0.01, 0.005, input_basis=[[1.0], [-1.0], [0.0]])
    moved = one.step([0.01, 0.0], np.full((5, 2), [0.02, 0.01])).u - model.input_offset
    assert abs(moved[0]) > 1e-3 and moved[0] == pytest.approx(-moved[1], abs=1e-9) and abs(moved[2]) < 1e-9
    with pytest.raises(ValueError, match="give independent directions"):
        MPC(model, 5, -0.01, 0.01, 0.005, input_basis=np.ones((3, 2)))


def test_inputs_of_different_units_are_compared_in_their_own_spread() -> None:
    rng = np.random.default_rng(1)
    u = np.column_stack([rng.normal(size=80), 1e4 * rng.normal(size=80)])
    data = Episodes([np.zeros((81, 1))], [u], 0.1, input_units=("m", "Pa"))
    assert data.input_subspace()[1].shape == (2, 2)
    alike = Episodes([np.zeros((81, 1))], [u], 0.1, input_units=("Pa", "Pa"))
    assert alike.input_subspace()[1].shape == (2, 1)


def test_all_directions_free_need_no_word() -> None:
    assert MPC(fitted(recorded(17, 1.0)), 5, -0.01, 0.01, 0.005).notes == ()
