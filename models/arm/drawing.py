"""An arm from a drawing: the words on it, checked, made into a rod scene with a pretension that keeps tendons taut."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from pisplit.checks import Array, finite_array, non_negative, one_of, positive
from pisplit.models import rod

if TYPE_CHECKING:
    from pisplit.models.arm.base import Arm

#: Young's modulus in Pa, Poisson's ratio, density in kg/m^3: usual values of handbooks, nitinol below its plateau. What
#: is on the desk may differ by a tenth, and fibres by more.
MATERIALS = {
    "steel": (207e9, 0.30, 7850.0),
    "nitinol": (60e9, 0.33, 6450.0),
    "carbon fibre": (120e9, 0.30, 1600.0),
    "fibreglass": (40e9, 0.25, 1900.0),
    "nylon": (2.6e9, 0.39, 1140.0),
}
DIRECTIONS = {f"{sign}{axis}": k for axis, k in zip("xyz", range(3), strict=True) for sign in "+-"}
GRAVITY = 9.81
#: Angle in rad by which the tip turns under the usual displacement, that of the paper's arm: 10 mm at 15.06 mm.
TURN = 10.0 / 15.06
#: Times that the tendons' common tension exceeds what holds the bent arm and its weight.
TAUT = 1.5
#: Lengths in m and forces in N outside of which a number is taken for one in another unit.
LONGEST, THINNEST = 20.0, 1e-6


def drawn_scene(
    length: float,
    radius: float,
    material: str | rod.Elastic,
    offset: float,
    angles_deg: Sequence[float],
    mass: float | None,
    tip_mass: float,
    damping_ratio: float,
    down: str,
    tendon_stiffness: float,
    nodes: int,
) -> tuple[rod.Scene, float, float]:
    """Scene, pretension in m and usual displacement in m of the arm with these words.

    length, radius, material, offset, angles_deg, mass, tip_mass, damping_ratio, down, tendon_stiffness, nodes: those of
    :class:`TendonArm`, which says what they raise.
    """
    L, r, d = (_length(v, n) for v, n in ((length, "length"), (radius, "radius"), (offset, "offset")))
    if not (r < 0.1 * L and r < d < L):
        raise ValueError(
            f"radius = {r:g}, offset = {d:g}, length = {L:g} m; expected a thin backbone (radius below a tenth of the "
            "length) with tendons outside it (radius < offset < length)"
        )
    angles = finite_array(angles_deg, "angles_deg", (None,))
    if len(angles) < 2 or len(np.unique(np.round(angles % 360.0, 6))) < len(angles):
        raise ValueError(f"angles_deg = {angles.tolist()}; expected two or more different angles in degrees")
    axis = DIRECTIONS[one_of(down, "down", tuple(DIRECTIONS))]
    gravity = np.zeros(3)
    gravity[axis] = GRAVITY if down[0] == "+" else -GRAVITY
    section, elastic = rod.Circle(r), _material(material)
    if mass is not None:
        elastic = rod.Elastic(elastic.young, elastic.shear, positive(mass, "mass", "kg") / (L * section.area))
    stiff, load = positive(tendon_stiffness, "tendon_stiffness", "N"), non_negative(tip_mass, "tip_mass", "kg")
    ratio = positive(damping_ratio, "damping_ratio")
    if ratio > 1.0:
        raise ValueError(f"damping_ratio = {ratio:g}; expected a part of critical damping, above 0 and up to 1")
    terms: list[Any] = [rod.Gravity(tuple(gravity.tolist()))]
    if load > 0.0:
        terms.append(rod.PointMass(L, load))
    bending = elastic.young * np.pi * r**4 / 4.0
    amplitude = TURN * d
    weight = GRAVITY * (elastic.density * section.area * L / 2.0 + load) * L
    pretension = TAUT * (bending * TURN / L + weight) / d * L / stiff

    def scene(damping: float) -> rod.Scene:
        return rod.Scene(
            rod.Rod(length=L, section=section, material=elastic, strains="kirchhoff"),
            *terms,
            rod.KelvinVoigt(bending=damping, torsion=damping),
            rod.Tendons.parallel(offset=d, angles_deg=angles.tolist(), drive=rod.Displacement(compliance=1.0 / stiff)),
            nodes=nodes,
        )

    rest, coefficient = np.full(len(angles), pretension), ratio * bending
    coefficient *= _factor(scene(coefficient), rest, ratio)
    return scene(coefficient), float(pretension), float(amplitude)


def _factor(scene: rod.Scene, rest: Array, ratio: float) -> float:
    """Factor of the damping of ``scene`` that gives its slowest mode the damping ``ratio``."""
    n = scene.n_strains
    A = scene.linearise(_at_rest(scene, rest)).A[: 2 * n, : 2 * n].copy()
    rates = A[n:, n:].copy()
    A[n:, n:] = 0.0
    factor = ratio
    for _ in range(20):  # the ratio is nearly proportional to the factor
        A[n:, n:] = factor * rates
        values = np.linalg.eigvals(A)
        mode = values[np.argmin(np.abs(values))]
        factor *= ratio / float(-mode.real / np.abs(mode))
    return factor


def usual_move(arm: Arm) -> float:
    """Time in s of a raised-cosine move by the usual displacement of ``arm`` that accelerates its tip by g/2."""
    radius = np.hypot(*np.concatenate([g.points(0.0, arm.scene.rod.length) for g in arm.groups]).T).mean()
    travel = 0.5 * arm.scene.rod.length * arm.amplitude / float(radius)
    return float(np.pi * np.sqrt(travel / GRAVITY))


def slowest(scene: rod.Scene, inputs: Array) -> tuple[float, float]:
    """Angular frequency in rad/s and damping ratio of the slowest mode of ``scene`` at rest under ``inputs`` (m,).

    Raises ValueError where the arm does not rest: a drawing that buckles under its weight.
    """
    scene = scene.without(rod.Maxwell)  # creep is no motion of its own
    modes = scene.modes(_at_rest(scene, inputs), 1)
    return float(2.0 * np.pi * modes.frequency[0]), float(modes.damping[0])


def _at_rest(scene: rod.Scene, inputs: Array) -> Array:
    found = scene.statics().solve(inputs)
    if not found.success:
        raise ValueError(f"the drawn arm does not rest under its own weight: {found.message or 'no equilibrium'}")
    return found.state


def _material(material: str | rod.Elastic) -> rod.Elastic:
    if isinstance(material, rod.Elastic):
        return material
    if material not in MATERIALS:
        known = ", ".join(map(repr, MATERIALS))
        raise ValueError(
            f"material = {material!r}; expected one of {known}, or for others, such as rubbers that differ tenfold, "
            "rod.Elastic(young, shear, density) in Pa, Pa and kg/m^3 (from pisplit.models import rod)"
        )
    young, poisson, density = MATERIALS[material]
    return rod.Elastic(young=young, shear=young / (2.0 * (1.0 + poisson)), density=density)


def _length(value: float, name: str) -> float:
    found = positive(value, name, "m")
    if not THINNEST < found < LONGEST:
        raise ValueError(f"{name} = {found:g} m; expected metres, {THINNEST:g} to {LONGEST:g}: is it in mm?")
    return found
