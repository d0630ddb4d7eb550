"""The residual of a moving scene as solvers take it: scaled, with the iteration matrix as its Jacobian."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import casadi as ca

from pisplit.models.rod.equations.held import constrained, with_wrench
from pisplit.models.rod.terms.drag import AnisotropicDrag, LinearDrag, QuadraticDrag

if TYPE_CHECKING:
    from pisplit.models.rod.scene import Scene

Drag = LinearDrag | QuadraticDrag | AnisotropicDrag
#: Derivatives of a residual with a given Jacobian go through that Jacobian, never past it.
THROUGH_JACOBIAN: dict[str, Any] = {"never_inline": True, "enable_forward": False, "enable_reverse": False}


def motion_residual(scene: Scene, *, shared: bool = False) -> ca.Function:
    """``(xi, xi_t, xi_tt, u) -> residual`` in parts of ``nominal_residual``, with a simplified Jacobian.

    The balance of ``scene`` (paper, eq. cosserat_rod_eq). With ``shared`` its common subexpressions are computed once:
    the same numbers in 7 to 12 % less time, for three times the time it takes to build.

    The Jacobian takes the inertia forces as dead loads: how they change with shape and rate is left out (it scales with
    the square of an integrator's step), how they stiffen the shape is not. Drag that is weak beside inertia is left out
    too: a quarter to a third of the operations.
    """
    n = scene.n_strains
    xi, xi_t, xi_tt, u, full = scene.dynamic_balance
    scale = ca.diag(1.0 / ca.DM(scene.nominal_residual))
    force = ca.SX.sym("force", 3, scene.nodes)
    wrench = None if full.reaction is None else ca.SX.sym("wrench", 6)
    at_rest = with_wrench(scene.balance(xi, ca.SX(n, 1), None, u, force, full.motion), wrench)
    (stiffness,) = ca.substitute([at_rest.slope], [force], [full.inertial_force])
    massless = with_wrench(scene.balance(xi, xi_t, None, u, shape=full.motion), wrench)
    felt = tuple(t for t in scene.terms if not (isinstance(t, Drag) and t.weak(scene.rod)))
    resisting = (massless if felt == scene.terms else replace(massless, terms=felt)).residual
    moving = with_wrench(full, wrench).residual
    blocks = [stiffness, ca.jacobian(resisting, xi_t), ca.jacobian(moving, xi_tt), ca.jacobian(massless.residual, u)]
    if full.holding is not None and full.reaction is not None and wrench is not None:
        blocks = list(ca.substitute(blocks, [wrench], [full.reaction]))
        rate, slope = scene.rod.bending_rate, full.holding.slope
        asked = [slope, 2.0 / rate * slope, slope / rate**2, ca.jacobian(full.holding.asked, u)]
        blocks = constrained(full.holding, blocks, asked)
    blocks = [scale @ block for block in blocks]
    symbols = {"xi": xi, "xi_t": xi_t, "xi_tt": xi_tt, "u": u}
    return with_slopes("balance", symbols, scale @ full.residual, blocks, shared)


def with_slopes(
    name: str, symbols: dict[str, ca.SX], residual: ca.SX, blocks: list[ca.SX], shared: bool = False
) -> ca.Function:
    """A ``residual`` (n,) as a function whose Jacobian consists of ``blocks``.

    Args:
        name: of the function.
        symbols: its arguments by name.
        residual: (n,).
        blocks: derivative (n, k) with respect to each argument.
        shared: whether common subexpressions are computed once.
    """
    jacobian = ca.Function(
        f"jac_{name}",
        [*symbols.values(), ca.SX.sym("residual", residual.numel())],
        blocks,
        [*symbols, "out_residual"],
        [f"jac_residual_{key}" for key in symbols],
        {"cse": shared},
    )
    options = {"cse": shared, "custom_jacobian": jacobian, **THROUGH_JACOBIAN}
    return ca.Function(name, list(symbols.values()), [residual], list(symbols), ["residual"], options)
