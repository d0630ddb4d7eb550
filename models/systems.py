"""Small systems with a known and an unknown part, for examples and exact-answer tests."""

from __future__ import annotations

import casadi as ca

from pisplit.checks import finite_number, non_negative, positive
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


def van_der_pol(mu: float = 1.0, gain: float = 1.0) -> ControlSystem:
    """Forced Van der Pol oscillator: x' = v, v' = mu (1 - x^2) v - x [known] + gain u [unknown].

    Its limit cycle has amplitude 2 and period 2 pi for small mu (Strogatz: Nonlinear Dynamics and Chaos, section 7.6).
    """
    mu, gain = finite_number(mu, "mu"), finite_number(gain, "gain")
    x, u = ca.SX.sym("x", 2), ca.SX.sym("u", 1)
    known = ca.vertcat(x[1], mu * (1.0 - x[0] ** 2) * x[1] - x[0])
    return ControlSystem(x, u, known=known, unknown=ca.vertcat(0, gain * u[0]), state_names=("x", "v"))


def two_link_arm(
    masses: tuple[float, float] = (1.0, 0.8),
    lengths: tuple[float, float] = (0.4, 0.3),
    viscous: float = 0.2,
    coulomb: float = 0.05,
    gain: float = 1.0,
) -> ControlSystem:
    """Planar arm of two uniform links, horizontal: joint angles q (2) [rad], their rates w (2), torques u (2).

    M(q) w' + C(q, w) w = gain u - viscous w - coulomb tanh(w / 0.05): inertia is known, f = (w, -M^-1 C w); motors and
    friction are not, h = (0, M^-1 (gain u - friction)). f keeps the kinetic energy w^T M w / 2 (Siciliano et al.:
    Robotics, section 7.3.2).

    masses [kg], lengths [m], viscous [N m s], coulomb [N m], gain [N m per unit of u].
    """
    (m1, m2), (l1, l2) = (
        tuple(positive(value, f"{what}[{i}]") for i, value in enumerate(pair))
        for pair, what in ((masses, "masses"), (lengths, "lengths"))
    )
    viscous, coulomb = non_negative(viscous, "viscous"), non_negative(coulomb, "coulomb")
    gain = finite_number(gain, "gain")
    x, u = ca.SX.sym("x", 4), ca.SX.sym("u", 2)
    w = x[2:]
    inertia, rates = two_link_inertia(x[:2], w, (m1, m2), (l1, l2))
    friction = viscous * w + coulomb * ca.tanh(w / 0.05)
    # The inverse of a 2 x 2 matrix in closed form keeps the graph small.
    inverse = ca.blockcat([[inertia[1, 1], -inertia[0, 1]], [-inertia[1, 0], inertia[0, 0]]]) / (
        inertia[0, 0] * inertia[1, 1] - inertia[0, 1] * inertia[1, 0]
    )
    return ControlSystem(
        x,
        u,
        known=ca.vertcat(w, -ca.mtimes(inverse, rates)),
        unknown=ca.vertcat(0, 0, ca.mtimes(inverse, gain * u - friction)),
        state_names=("q1", "q2", "w1", "w2"),
        input_names=("torque1", "torque2"),
        state_units=("rad", "rad", "rad/s", "rad/s"),
        input_units=("N m", "N m"),
    )


def tendon_arm(nodes: int = 5) -> ControlSystem:
    """The tendon arm of the paper in its own coordinates: the backbone with its weight, damping and drag is f, the
    tendons are h (:func:`pisplit.models.rod_system.rod_system` takes any scene). Simulate with ``method="idas"``.

    ``nodes`` is the number of Gauss nodes.
    """
    from pisplit.models.arm.tendon_arm import TendonArm
    from pisplit.models.rod_system import rod_system  # the other systems need no rods

    return rod_system(TendonArm.paper(nodes).scene)


def two_link_inertia(
    q: ca.SX, w: ca.SX, masses: tuple[float, float], lengths: tuple[float, float]
) -> tuple[ca.SX, ca.SX]:
    """Mass matrix M(q) (2, 2) [kg m^2], Coriolis and centrifugal torques C(q, w) w (2,) [N m] of two uniform links.

    ``masses`` in kg and ``lengths`` in m.
    """
    (m1, m2), (l1, l2) = masses, lengths
    coupling = 0.5 * m2 * l1 * l2
    outer = m2 * l2**2 / 3.0
    cosine, sine = ca.cos(q[1]), ca.sin(q[1])
    off = outer + coupling * cosine
    inertia = ca.blockcat([[m1 * l1**2 / 3.0 + m2 * l1**2 + outer + 2.0 * coupling * cosine, off], [off, outer]])
    rates = coupling * sine * ca.vertcat(-(2.0 * w[0] * w[1] + w[1] ** 2), w[0] ** 2)
    return inertia, rates
