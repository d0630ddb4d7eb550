"""Viscoelastic material: branches of a spring and a dashpot beside the elastic rod."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca

from pisplit.checks import non_negative, positive
from pisplit.models.rod.kinematics.kinematics import Motion
from pisplit.models.rod.terms.loads import Input, Loads


@dataclass(frozen=True)
class Maxwell:
    """A Maxwell branch in every free strain: a spring and a dashpot in series, beside the elastic rod.

    Its stress is ``K sigma`` with the stiffness K of the rod and the overstress sigma, which has the unit of the strain
    e it belongs to and is a state of the scene:

        sigma_t = fraction e_t - sigma / time

    One branch makes a standard linear solid, several make a generalised Maxwell model (Simo & Hughes, *Computational
    Inelasticity*, 1998, section 10.1): the rod creeps under loads and its stress relaxes where it is held. At rest
    every branch is relaxed and adds nothing, so that ``fraction = 0.2`` is a rod that resists 1.2 times as much at
    first, and as drawn in the end. Motions start with relaxed branches (sigma = 0) unless the state that they start
    from says otherwise.

    Args:
        fraction: stiffness of the branch in parts of that of the rod (its moduli E and G alike); zero leaves nothing.
        time: relaxation time in s: under constant strain the stress of the branch falls to 1/e.
    """

    fraction: float
    time: float

    def __post_init__(self) -> None:
        non_negative(self.fraction, "Maxwell fraction")
        positive(self.time, "Maxwell time", "s")

    @property
    def inputs(self) -> tuple[Input, ...]:
        """None."""
        return ()

    @property
    def state(self) -> str:
        """Name of the overstress among the symbols of a balance; branches of one scene differ in their times."""
        return f"overstress of the branch of {self.time!r} s"

    def apply(self, motion: Motion, loads: Loads) -> None:
        """Stress K sigma; nothing at rest. ``motion`` is that of the rod; ``loads`` takes what is added."""
        if self.state not in loads.inputs:
            return
        free, n_nodes = motion.rod.strain_set.free, motion.rule.n_nodes
        sigma = ca.reshape(loads.inputs[self.state], len(free), n_nodes)
        stress = [ca.SX(1, n_nodes)] * 6
        for row, component in enumerate(free):
            stress[component] = ca.DM(motion.profile.stiffness[component]).T * sigma[row, :]
        loads.stress_w += ca.vertcat(*stress[:3])
        loads.stress_v += ca.vertcat(*stress[3:])

    def describe(self, rod: Any) -> str:
        """Fraction and time. ``rod`` is that of the scene."""
        return f"Maxwell branch, {self.fraction:g} of the stiffness, relaxation time {self.time:g} s"
