"""What an arm's tendons feel of its measured fields: for models that have to know which of them are slack."""

from __future__ import annotations

from typing import TYPE_CHECKING

import casadi as ca
import numpy as np

from pisplit import observables as ob
from pisplit.checks import Array, count

if TYPE_CHECKING:
    from pisplit.models.arm.base import Arm

#: Strains by their place: curvatures about x and y, stretch along z.
ABOUT_X, ABOUT_Y, ALONG = 0, 1, 5


def tension(arm: Arm, stations: int = 6) -> ob.Tension:
    """Stretch of the tendons of an ``arm``, and its rate, from the fields measured at so many ``stations``.

    To first order in the curvature: a tendon at r in the section is lengthened by the integral of w_x r_y - w_y r_x,
    and of the stretch of the backbone where it has one. Between disks, whose chords are shorter than the arc, it is the
    same within the square of their spacing.

    Raises ValueError for arms of several sections and those on joints.
    """
    arm.check_one_section("tension")
    scene, term = arm.scene, arm.groups[0]
    count(stations, "stations")
    free, nodes, weights = scene.rod.strain_set.free, np.asarray(scene.rule.nodes), np.asarray(scene.rule.weights)
    m, n = scene.n_inputs, scene.n_strains
    if n != len(free) * len(nodes):
        raise ValueError("the arm stands on joints, whose coordinates are no strains; expected a clamped arm")
    points = np.array([term.points(float(s), scene.rod.length) for s in nodes])  # (K, m, 2)
    of_strains: Array = np.zeros((n, m))
    for k, axis in enumerate(free):
        lever = {ABOUT_X: points[..., 1], ABOUT_Y: -points[..., 0], ALONG: np.ones(points.shape[:2])}.get(axis)
        if lever is not None:
            of_strains[k :: len(free)] = weights[:, None] * lever
    read = scene.coordinates(stations).function
    x = ca.MX.sym("x", read.size1_in(0))
    rods, rows = read(x), ca.DM(of_strains.T)
    return ob.Tension(ca.Function("stretch", [x], [ca.vertcat(rows @ rods[:n], rows @ rods[n:])]))
