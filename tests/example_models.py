"""Models that tests of controllers share."""

from dataclasses import replace

import casadi as ca
import numpy as np

from pisplit.controllers import QPSettings
from pisplit.lifted.model import LiftedModel

DIFFERENTIAL = np.linalg.svd(np.eye(3) - 1.0 / 3.0)[0][:, :2]  # three tendons without a common pull
EXACT = QPSettings(eps=1e-8, max_iterations=100_000, first_max_iterations=100_000)


def arm_model(seed: int = 0, n: int = 6, basis: np.ndarray = DIFFERENTIAL, radius: float = 0.95) -> LiftedModel:
    """Random stable model without delays, three inputs of a centimetre moving outputs by about ten."""
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((n, n))
    A *= radius / np.abs(np.linalg.eigvals(A)).max()
    x, v, u = ca.SX.sym("x", n), ca.SX.sym("v", 3, 0), ca.SX.sym("u", 3)
    return LiftedModel(
        A=A,
        B=2.0 * rng.standard_normal((n, 3)),
        c=1e-3 * rng.standard_normal(n),
        C=np.eye(n),
        d=np.zeros(n),
        dt=0.03,
        lift_function=ca.Function("lift", [x, v], [x]),
        input_function=ca.Function("phi", [u], [u]),
        n_delays=0,
        state_names=tuple(f"x{i}" for i in range(n)),
        input_names=("u1", "u2", "u3"),
        column_names=tuple(f"x{i}" for i in range(n)),
        feature_names=("u1", "u2", "u3"),
        input_offset=np.array([0.001, 0.001, 0.001]),
        input_basis=basis,
        state_range=np.ones(n),
        outputs={"tip": (0, 1, 2)},
    )


def delayed_model() -> LiftedModel:
    """z = [x_k, x_{k-1}, u_{k-1}] with a motion that depends on all of them."""
    base, rng = arm_model(3, basis=np.eye(3), radius=0.8), np.random.default_rng(3)
    A, B = np.zeros((15, 15)), np.zeros((15, 3))
    A[:6, :6], A[:6, 6:12], A[:6, 12:] = base.A, 0.05 * rng.standard_normal((6, 6)), base.B
    A[6:12, :6] = np.eye(6)
    B[:6], B[12:] = 0.5 * base.B, np.eye(3)
    x, v = ca.SX.sym("x", 6, 2), ca.SX.sym("v", 3, 1)
    names = (*base.column_names, *(f"{n}[k-1]" for n in base.column_names), "v1", "v2", "v3")
    return replace(
        base,
        A=A,
        B=B,
        c=np.zeros(15),
        C=np.eye(6, 15),
        n_delays=1,
        lift_function=ca.Function("lift", [x, v], [ca.vertcat(x[:, 1], x[:, 0], v)]),
        column_names=names,
    )
