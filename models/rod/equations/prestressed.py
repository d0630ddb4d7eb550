"""A rod under prestress: its motion about any equilibrium, without knowing what keeps it there."""

from __future__ import annotations

from typing import TYPE_CHECKING

import casadi as ca

if TYPE_CHECKING:
    from pisplit.models.rod.scene import Scene


def prestressed_acceleration(scene: Scene) -> ca.Function:
    """``(xi, xi_t, xi_rest) -> xi_tt`` of a scene with the internal stress that keeps it at rest in ``xi_rest``.

    The stress is what the static balance (paper, eq. cosserat_rod_eq) lacks in that shape. For the backbone of an arm
    it is the load of the actuators at the equilibrium with that shape, known from statics alone; what the actuators add
    when the arm leaves the equilibrium is not in it.

    Args:
        scene: the rod and what acts on it, without the terms that the stress stands for. All three arguments of the
            function are (n_strains,): strains, their rates per s, and the strains at rest.

    Raises ValueError for a scene with inputs or Maxwell branches.
    """
    n = scene.n_strains
    if scene.branches:
        raise ValueError(
            "a prestressed scene has no Maxwell branches, whose stress no shape tells; leave them out with "
            "scene.without(rod.Maxwell)"
        )
    if scene.n_inputs:
        raise ValueError(
            f"a prestressed scene has no inputs; this one has {', '.join(scene.input_names)}: leave their terms out"
        )
    xi, xi_t, xi_tt, _, balance = scene.dynamic_balance
    shape, _, static = scene.static_balance
    scale = 1.0 / ca.DM(scene.nominal_residual)
    mass = ca.diag(scale) @ ca.jacobian(balance.residual, xi_tt)
    left = scale * ca.substitute(balance.residual, xi_tt, ca.SX.zeros(n))
    parts = ca.Function("parts", [xi, xi_t], [mass, left])
    stress = ca.Function("stress", [shape], [scale * static.residual])
    x, v, rest = (ca.MX.sym(name, n) for name in ("xi", "xi_t", "xi_rest"))
    m, r = parts(x, v)
    acceleration = -ca.solve(m, r - stress(rest), "qr", {"eps": 1e-30})
    return ca.Function("prestressed_acceleration", [x, v, rest], [acceleration], ["xi", "xi_t", "xi_rest"], ["xi_tt"])
