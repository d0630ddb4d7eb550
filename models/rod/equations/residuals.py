"""The residual of a moving scene as solvers take it: scaled, with the iteration matrix as its Jacobian."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import casadi as ca

if TYPE_CHECKING:
    from pisplit.models.rod.scene import Scene

#: Derivatives of a residual with a given Jacobian go through that Jacobian, never past it.
THROUGH_JACOBIAN: dict[str, Any] = {"never_inline": True, "enable_forward": False, "enable_reverse": False}


def motion_residual(scene: Scene) -> ca.Function:
    """``(xi, xi_t, xi_tt, u) -> residual`` in parts of ``nominal_residual``, with a simplified Jacobian.

    The balance of ``scene`` (paper, eq. cosserat_rod_eq).

    The Jacobian takes the inertia forces as dead loads: how they change with shape and rate is left out (it scales with
    the square of an integrator's step), how they stiffen the shape is not.
    """
    n = scene.n_strains
    xi, xi_t, xi_tt, u, full = scene.dynamic_balance
    scale = ca.diag(1.0 / ca.DM(scene.nominal_residual))
    force = ca.SX.sym("force", 3, scene.nodes)
    at_rest = scene.balance(xi, ca.SX(n, 1), None, u, dead_force=force).residual
    (stiffness,) = ca.substitute([ca.jacobian(at_rest, xi)], [force], [full.inertial_force])
    massless = scene.balance(xi, xi_t, None, u).residual
    blocks = [
        scale @ stiffness,
        scale @ ca.jacobian(massless, xi_t),
        scale @ ca.jacobian(full.residual, xi_tt),
        scale @ ca.jacobian(massless, u),
    ]
    names = ["xi", "xi_t", "xi_tt", "u"]
    symbols = [xi, xi_t, xi_tt, u]
    jacobian = ca.Function(
        "jac_balance",
        [*symbols, ca.SX.sym("residual", n)],
        blocks,
        [*names, "out_residual"],
        [f"jac_residual_{name}" for name in names],
        {"cse": True},
    )
    options = {"cse": True, "custom_jacobian": jacobian, **THROUGH_JACOBIAN}
    return ca.Function("balance", symbols, [scale @ full.residual], names, ["residual"], options)
