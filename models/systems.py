"""Small systems with a known and an unknown part, for examples and exact-answer tests."""

from __future__ import annotations

import casadi as ca

from pisplit.checks import finite_number
from pisplit.models.control_system import ControlSystem


def slow_manifold(mu: float = -0.1, lam: float = -1.0, delta: float = 10.0) -> ControlSystem:
    """x1' = mu x1,  x2' = lam (x2 - x1^2) [known]  + delta sin u [unknown, in x2].

    [1, x1, x2, x1^2] spans a subspace that the known part leaves invariant, with eigenvalues 0, mu, lam, 2 mu
    (Brunton, Brunton, Proctor, Kutz: Koopman invariant subspaces and finite linear representations, 2016).
    """
    mu, lam, delta = (finite_number(v, k) for v, k in ((mu, "mu"), (lam, "lam"), (delta, "delta")))
    x, u = ca.SX.sym("x", 2), ca.SX.sym("u", 1)
    known = ca.vertcat(mu * x[0], lam * (x[1] - x[0] ** 2))
    return ControlSystem(x, u, known=known, unknown=ca.vertcat(0, delta * ca.sin(u[0])))


def duffing(damping: float = 0.5, stiffness: float = -1.0, cubic: float = 1.0, gain: float = 1.0) -> ControlSystem:
    """Forced Duffing oscillator: x' = v, v' = -damping v - stiffness x - cubic x^3 [known] + gain u [unknown].

    The defaults give two wells at x = -1 and x = 1.
    """
    x, u = ca.SX.sym("x", 2), ca.SX.sym("u", 1)
    known = ca.vertcat(x[1], -damping * x[1] - stiffness * x[0] - cubic * x[0] ** 3)
    return ControlSystem(x, u, known=known, unknown=ca.vertcat(0, gain * u[0]), state_names=("x", "v"))
