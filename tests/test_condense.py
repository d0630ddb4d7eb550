"""Condensed prediction is the roll-out, written as one affine map."""

import casadi as ca
import numpy as np
import pytest

from pisplit.controllers import condense
from pisplit.lifted.model import LiftedModel


def delayed_model(seed: int, n: int = 4, m: int = 2, delays: int = 2) -> LiftedModel:
    """Random model whose lifted state holds the state, its delays and a quadratic feature of the last input."""
    rng = np.random.default_rng(seed)
    x, v, u = ca.SX.sym("x", n, delays + 1), ca.SX.sym("v", m, delays), ca.SX.sym("u", m)
    phi = ca.vertcat(u, u**2)
    z = ca.vertcat(*[x[:, delays - i] for i in range(delays + 1)], v[:, -1], v[:, -1] ** 2)
    M, P, kept = z.numel(), phi.numel(), n * delays
    A = np.zeros((M, M))
    A[:n] = rng.standard_normal((n, M)) * 0.3
    A[n : n + kept, :kept] = np.eye(kept)
    B = np.vstack([rng.standard_normal((n, P)), np.zeros((kept, P)), np.eye(P)])
    c = np.concatenate([0.1 * rng.standard_normal(n), np.zeros(M - n)])
    return LiftedModel(
        A=A,
        B=B,
        c=c,
        C=np.eye(n, M) + 0.1 * rng.standard_normal((n, M)),
        d=rng.standard_normal(n),
        dt=0.1,
        lift_function=ca.Function("lift", [x, v], [z]),
        input_function=ca.Function("phi", [u], [phi]),
        n_delays=delays,
        state_names=tuple(f"x{i}" for i in range(n)),
        input_names=tuple(f"u{i}" for i in range(m)),
        column_names=tuple(f"z{i}" for i in range(M)),
        feature_names=tuple(f"f{i}" for i in range(P)),
        input_offset=np.zeros(m),
        input_basis=np.eye(m),
        state_range=np.full(n, 1e6),
        outputs={"tip": (1, 3)},
    )


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("horizon", [1, 7])
def test_condensed_prediction_is_the_rollout(seed: int, horizon: int) -> None:
    model, rng = delayed_model(seed), np.random.default_rng(seed + 10)
    tip = [1, 3]
    condensed = condense(model.A, model.B, model.c, model.C[tip], model.d[tip], horizon)
    x_history, u_history = rng.standard_normal((3, 4)), rng.standard_normal((2, 2))
    U = rng.standard_normal((horizon, 2))
    y = condensed.predict(model.lift(x_history, u_history), model.features(U))
    np.testing.assert_allclose(y, model.predict(x_history, u_history, U).x[1:, tip], rtol=1e-11, atol=1e-12)


def test_a_constant_disturbance_acts_like_a_change_of_c() -> None:
    model, rng = delayed_model(5), np.random.default_rng(0)
    z, w, phi = rng.standard_normal(model.n_lifted), rng.standard_normal(model.n_lifted), rng.standard_normal((6, 4))
    one = condense(model.A, model.B, model.c, model.C, model.d, 6).predict(z, phi, w)
    other = condense(model.A, model.B, model.c + w, model.C, model.d, 6).predict(z, phi)
    np.testing.assert_allclose(one, other, rtol=1e-11, atol=1e-12)


def test_outputs_do_not_depend_on_later_inputs() -> None:
    model = delayed_model(1)
    response = condense(model.A, model.B, model.c, model.C, model.d, 5).response()
    for j in range(5):
        assert not response[j, :, j + 1 :].any()
        np.testing.assert_allclose(response[j, :, j], model.C @ model.B)


def test_wrong_arguments_are_named() -> None:
    model = delayed_model(0)
    with pytest.raises(ValueError, match="horizon = 0; expected a whole number"):
        condense(model.A, model.B, model.c, model.C, model.d, 0)
    with pytest.raises(ValueError, match=r"A has shape \(3, 3\); expected \(16, 16\)"):
        condense(np.eye(3), model.B, model.c, model.C, model.d, 4)
