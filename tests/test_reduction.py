"""Modes, sensitivities and balanced truncation against closed forms."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from numpy.typing import NDArray

from pisplit import LiftedModel
from pisplit.lifted.modes import modes
from pisplit.lifted.reduction import balanced_truncation
from pisplit.lifted.sensitivity import input_jacobian, rollout_jacobian

Array = NDArray[np.float64]
DT = 0.05


def model_of(a: Array, b: Array, c: Array | None = None, n: int = 2, seed: int = 0) -> LiftedModel:
    """States are n random combinations of the lifted ones; phi(u) = [u, sin u] for two features, else u."""
    size = len(a)
    x, v, u = ca.MX.sym("x", n), ca.MX.sym("v", 1, 0), ca.MX.sym("u")
    read = np.random.default_rng(seed).normal(size=(n, size))
    phi = ca.vertcat(u, ca.sin(u)) if b.shape[1] == 2 else u
    return LiftedModel(
        A=a,
        B=b,
        c=np.zeros(size) if c is None else c,
        C=read,
        d=np.zeros(n),
        dt=DT,
        lift_function=ca.Function("lift", [x, v], [ca.mtimes(ca.DM(np.linalg.pinv(read)), x)]),
        input_function=ca.Function("phi", [u], [phi]),
        n_delays=0,
        state_names=tuple(f"x{i}" for i in range(n)),
        input_names=("u",),
        column_names=tuple(f"z{i}" for i in range(size)),
        feature_names=("u", "sin")[: b.shape[1]],
        input_offset=np.zeros(1),
        input_basis=np.eye(1),
        state_range=np.array([1.0, 3.0])[:n],
    )


def stable(size: int = 12, seed: int = 1) -> LiftedModel:
    rng = np.random.default_rng(seed)
    a = rng.normal(size=(size, size))
    a *= 0.95 / np.abs(np.linalg.eigvals(a)).max()
    return model_of(a, rng.normal(size=(size, 2)) * np.logspace(0, -4, size)[:, None])


def gain(model: LiftedModel, angle: float) -> Array:
    z = np.exp(1j * angle)
    inverse = np.linalg.solve(z * np.eye(model.n_lifted) - model.A, np.column_stack([model.B, model.c]))
    return np.asarray(model.C / model.state_range[:, None] @ inverse)


def test_modes_of_an_oscillator_are_its_frequency_and_damping() -> None:
    omega, zeta = 7.0, 0.2
    rate = -zeta * omega + 1j * omega * np.sqrt(1 - zeta**2)
    turn = np.exp(rate * DT)
    a = np.block([[np.array([[turn.real, turn.imag], [-turn.imag, turn.real]]), np.zeros((2, 2))], [np.zeros((2, 4))]])
    a[2, 2] = np.exp(-20.0 * DT)
    mixing = np.linalg.qr(np.random.default_rng(0).normal(size=(4, 4)))[0]
    found = modes(model_of(mixing @ a @ mixing.T, np.zeros((4, 1))))
    np.testing.assert_allclose(found.rates[:3], [rate, rate.conjugate(), -20.0], atol=1e-9)
    np.testing.assert_allclose(found.frequencies[:2], abs(rate.imag) / (2 * np.pi))
    np.testing.assert_allclose(found.damping[:3], [zeta, zeta, 1.0], atol=1e-9)
    np.testing.assert_allclose(found.time_constants[:3], [1 / 1.4, 1 / 1.4, 0.05], atol=1e-9)
    assert found.radius == pytest.approx(abs(turn)) and found.condition < 10


def test_modes_rebuild_the_motion() -> None:
    model = stable()
    found, z = modes(model), np.random.default_rng(2).normal(size=12)
    after = np.linalg.matrix_power(model.A, 7) @ z
    np.testing.assert_allclose(
        (found.shapes * found.eigenvalues**7) @ (found.eigenfunctions @ z), model.C @ after, atol=1e-9
    )


@pytest.mark.parametrize("r", [2, 4, 8])
def test_the_error_of_a_reduced_model_is_within_its_bound_at_every_frequency(r: int) -> None:
    model = stable()
    found = balanced_truncation(model, r)
    assert found.model.n_lifted == r and found.kept == 0
    worst = max(np.linalg.norm(gain(model, w) - gain(found.model, w), 2) for w in np.linspace(0, np.pi, 300))
    assert found.singular_values[r] <= worst <= found.bound
    assert modes(found.model).radius < 1.0


def test_nothing_is_lost_where_nothing_is_left_out() -> None:
    model = stable(6)
    whole = balanced_truncation(model, 6)
    rng = np.random.default_rng(3)
    x, u = rng.normal(size=2), rng.normal(size=(50, 1))
    np.testing.assert_allclose(whole.model.predict(x, None, u).x, model.predict(x, None, u).x, atol=1e-8)
    assert whole.bound == 0.0 and whole.model.column_names[0] == "w1"


def test_a_constant_and_growing_modes_are_kept() -> None:
    rng = np.random.default_rng(4)
    base = stable(8)
    a = np.zeros((10, 10))
    a[:8, :8], a[8, 8], a[9, 9], a[:8, 8] = base.A, 1.0, 1.05, rng.normal(size=8)
    model = model_of(a, np.vstack([base.B, np.zeros((1, 2)), rng.normal(size=(1, 2))]))
    found = balanced_truncation(model, 7, starts=np.eye(10))
    assert found.kept == 2
    np.testing.assert_allclose(np.abs(modes(found.model).eigenvalues[:2]), [1.05, 1.0], atol=1e-9)
    with pytest.raises(ValueError, match="2 modes do not decay"):
        balanced_truncation(model, 1)


def test_starts_are_kept_even_where_no_input_reaches() -> None:
    a = np.diag([0.9, 0.8, 0.7])
    model = model_of(a, np.array([[1.0], [0.0], [0.0]]))
    z0 = np.array([0.0, 1.0, 0.0])
    forgotten = balanced_truncation(model, 2).model
    kept = balanced_truncation(model, 2, starts=z0[None]).model
    assert forgotten.n_lifted == 1  # inputs reach no more
    assert kept.n_lifted == 2
    u = np.random.default_rng(0).normal(size=(30, 1))
    np.testing.assert_allclose(kept.rollout(np.zeros(2), u).x, model.rollout(np.zeros(3), u).x, atol=1e-10)


def test_jacobians_are_the_slopes_of_the_roll_out() -> None:
    model = stable()
    rng = np.random.default_rng(5)
    z0, u, h = rng.normal(size=12), rng.normal(size=(6, 1)), 1e-6
    found = rollout_jacobian(model, u)
    assert found.shape == (6, 2, 6, 1)
    for j in range(6):
        step = np.zeros_like(u)
        step[j] = h
        slope = (model.rollout(z0, u + step).x - model.rollout(z0, u - step).x)[1:] / (2 * h)
        np.testing.assert_allclose(found[:, :, j, 0], slope, atol=1e-7)
    np.testing.assert_allclose(
        np.einsum("ij,njk->nik", model.C, input_jacobian(model, u))[:, :, 0], found[range(6), :, range(6), 0]
    )


def test_bilinear_models_are_refused_where_linearity_is_needed() -> None:
    from dataclasses import replace

    model = replace(stable(), N=np.zeros((1, 12, 12)))
    for build in (lambda: balanced_truncation(model, 2), lambda: input_jacobian(model, np.zeros((1, 1)))):
        with pytest.raises(ValueError, match="bilinear"):
            build()


def rotated(a: Array, b: Array, seed: int = 5) -> LiftedModel:
    turn = np.linalg.qr(np.random.default_rng(seed).normal(size=a.shape))[0]
    return model_of(turn @ a @ turn.T, turn @ b)


def test_modes_that_last_are_separated_from_those_that_drive_them() -> None:
    """A decaying part that feeds an integrator: nothing left out, nothing changed."""
    a = np.array([[1.0, 0.7, -0.4], [0.0, 0.8, 0.3], [0.0, 0.0, 0.5]])
    model = rotated(a, np.array([[0.1], [1.0], [-0.5]]))
    found = balanced_truncation(model, 3)
    assert found.kept == 1
    x, u = np.zeros(2), np.random.default_rng(3).normal(size=(40, 1))
    np.testing.assert_allclose(found.model.predict(x, None, u).x, model.predict(x, None, u).x, atol=1e-8)


def test_a_model_in_which_all_modes_last_is_kept() -> None:
    model = rotated(np.array([[1.0, 0.3], [0.0, 1.02]]), np.array([[0.2], [1.0]]))
    found = balanced_truncation(model, 2)
    assert found.kept == 2
    x, u = np.array([0.4, -0.2]), np.random.default_rng(3).normal(size=(30, 1))
    np.testing.assert_allclose(found.model.predict(x, None, u).x, model.predict(x, None, u).x, atol=1e-8)


def test_what_is_kept_does_not_depend_on_the_unit_of_the_inputs() -> None:
    base = stable(6)
    small = model_of(base.A, 1e-18 * base.B)
    assert balanced_truncation(small, 4).model.n_lifted == balanced_truncation(base, 4).model.n_lifted == 4
