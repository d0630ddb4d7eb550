"""A scene as a control system x' = f + h: f is what the rod does without its actuators, h what these add."""

from __future__ import annotations

import casadi as ca

from pisplit.models import rod
from pisplit.models.control_system import ControlSystem
from pisplit.models.rod.analysis.coordinates import StrainCoordinates
from pisplit.models.rod.terms.pull import TendonTerm


def rod_system(scene: rod.Scene, actuation: type = TendonTerm) -> ControlSystem:
    """x = [xi, xi_t] (2n,): free strains at the nodes and their rates; u (m,): the inputs of the scene.

    With Maxwell branches x = [xi, xi_t, sigma], and their relaxation belongs to f.

    f = (xi_t, acceleration without the terms of type ``actuation``) and h = (0, what they add to it), as in
    eq. cosserat_rod_eq; both solve the mass matrix exactly. Inputs of other terms (a base that moves, a wrench) belong
    to f. ``simulate`` needs ``method="idas"``: damped rods are stiff (rates up to 1e8 1/s). Inputs jump at the start of
    a step and stay, as with ``scene.simulator(dt, inputs="step")``.

    Args:
        scene: the rod with its terms.
        actuation: type of the terms that are unknown; tendons of every kind when not given.

    Raises ValueError if the scene has no such term.
    """
    if not any(isinstance(term, actuation) for term in scene.terms):
        kind = "Tendons" if actuation is TendonTerm else actuation.__name__
        raise ValueError(f"the scene has no {kind} that could be the unknown part; give it one")
    if scene.n_joint:
        raise ValueError("a control system needs a base that is clamped; this scene has a Base with a hinge or slides")
    passive, n = scene.without(actuation), scene.n_strains
    if passive.branches != scene.branches:
        raise ValueError("Maxwell branches relax by what is known of them: they cannot be the unknown part")
    layout = scene.layout
    x, u = ca.MX.sym("x", layout.n_moving), ca.MX.sym("u", scene.n_inputs)
    strains, rates, hidden = x[layout.strains], x[layout.rates], x[layout.overstress]
    remaining = [scene.input_names.index(name) for name in passive.input_names]
    others = u[remaining] if remaining else ca.MX(0, 1)
    free = passive.acceleration(strains, rates, ca.vertcat(hidden, others))
    whole = scene.acceleration(strains, rates, ca.vertcat(hidden, u))
    names = StrainCoordinates(scene, ()).names
    stress = [name.replace("[", f"_s{k + 1}[") for k in range(layout.n_branches) for name in names[:n]]
    bends = [name.startswith("w") for name in names[:n]]
    hidden_units = ["1/m" if b else "" for b in bends] * layout.n_branches
    return ControlSystem(
        x,
        u,
        known=ca.vertcat(rates, free, scene.overstress_rates(rates, hidden)),
        unknown=ca.vertcat(ca.MX.zeros(n), whole - free, ca.MX.zeros(layout.n_overstress)),
        state_names=(*names, *stress),
        input_names=scene.input_names,
        state_units=(*("1/m" if b else "" for b in bends), *("1/(m s)" if b else "1/s" for b in bends), *hidden_units),
        input_units=scene.input_units,
    )
