"""What an arm's tendons feel of its measured fields: for models that have to know which are slack, and which slide."""

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
    of_strains = _lengthened(arm, "tension", np.zeros(1))
    read, n = arm.scene.coordinates(count(stations, "stations")).function, arm.scene.n_strains
    x = ca.MX.sym("x", read.size1_in(0))
    rods, rows = read(x), ca.DM(of_strains)
    return ob.Tension(ca.Function("stretch", [x], [ca.vertcat(rows @ rods[:n], rows @ rods[n:])]))


def slip(arm: Arm, stations: int = 6) -> ob.Slip:
    """How fast the tendons of an ``arm`` slide through its section at every one of so many ``stations`` but the tip.

    A tendon is held at the tip: it slides by as much as its way from the section to there grows, here to first order in
    the curvature, see :func:`tension`. In m/s, tendon by tendon at one station after the other.

    Raises ValueError for arms of several sections and those on joints.
    """
    places = arm.scene.rod.length * np.linspace(0.0, 1.0, count(stations, "stations") + 1)[:-1]
    of_strains = _lengthened(arm, "slip", places)
    read, n = arm.scene.coordinates(stations).function, arm.scene.n_strains
    x = ca.MX.sym("x", read.size1_in(0))
    return ob.Slip(ca.Function("slip", [x], [ca.DM(of_strains) @ read(x)[n:]]))


def _lengthened(arm: Arm, what: str, places: Array) -> Array:
    """Rows (P m, n): how the way of each tendon from the arclengths ``places`` (P,) to the tip grows with strains.

    Raises ValueError, which tells ``what`` was asked for, for arms of several sections and those on joints.
    """
    arm.check_one_section(what)
    scene, term = arm.scene, arm.groups[0]
    free, nodes = scene.rod.strain_set.free, np.asarray(scene.rule.nodes)
    m, n = scene.n_inputs, scene.n_strains
    if n != len(free) * len(nodes):
        raise ValueError("the arm stands on joints, whose coordinates are no strains; expected a clamped arm")
    beyond = np.asarray(scene.rule.weights) - scene.rule.integrate_to(places)  # (P, K)
    points = np.array([term.points(float(s), scene.rod.length) for s in nodes])  # (K, m, 2)
    found: Array = np.zeros((len(places), m, n))
    for k, axis in enumerate(free):
        lever = {ABOUT_X: points[..., 1], ABOUT_Y: -points[..., 0], ALONG: np.ones(points.shape[:2])}.get(axis)
        if lever is not None:
            found[:, :, k :: len(free)] = beyond[:, None, :] * lever.T
    return found.reshape(-1, n)
