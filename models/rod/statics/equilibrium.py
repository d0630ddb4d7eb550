"""What a search for static equilibria returns."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from pisplit.brief import brief
from pisplit.checks import Array

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from pisplit.models.rod.scene import Scene


class Shape:
    """Reads a state at rest.

    Attributes:
        state: [xi, 0, u] (n_states,).
        scene: the scene that it is of.
    """

    state: Array
    scene: Scene

    @property
    def strains(self) -> Array:
        """Free strains xi (n_strains,): 1/m for bending and torsion, 1 for shear and stretch."""
        return self.state[: self.scene.n_strains]

    def pose(self, s: float) -> tuple[Array, Array]:
        """Position (3,) in m and rotation (3, 3) at arclength ``s`` in m."""
        y = self.scene.field_map([s]).evaluate(self.state)[0]
        return y[:3], y[3:12].reshape(3, 3)

    @property
    def tip(self) -> Array:
        """Position of the tip (3,) in m."""
        return self.pose(self.scene.rod.length)[0]


@brief
@dataclass(frozen=True)
class Equilibrium(Shape):
    """A static equilibrium, or the best that was found.

    Attributes:
        state: [xi, 0, u] (n_states,).
        success: whether the residual is below tolerance and the shape is one that the rod takes: stable, and on the
            branch that ``branch`` says.
        residual: largest residual in parts of EI/L (moments) and EI/L^2 (forces).
        iterations: of Newton's method; None after kinsol, whose interface does not report them, and after a path.
        solver: ``"kinsol"``, ``"newton"`` or ``"path"``.
        tensions: (tendons,) in N.
        slack: (tendons,), by how much each tendon is longer than its path, in m (0 when taut).
        message: why the search failed, or where stability was lost on the way; empty if nothing happened.
        stable: whether no deformation goes on by itself and, where loads have no energy (followers, friction, spin),
            no vibration grows; None where nobody looked.
        branch: ``"unique"`` (there is no other equilibrium), ``"followed"`` (slow loading of the unloaded rod, or slow
            motion of the inputs from the given state, ends here), ``"snapped"`` (the same, and stability was lost on
            the way: the rod buckled or snapped through and came to rest again), ``"given"`` (stable and near the guess;
            how it is reached is not known), ``"settled"`` (a base on a joint was let go and came to rest),
            ``"flutters"`` (in balance, but a vibration about it grows with the inertia and damping of the scene) or
            ``"unverified"``; the last two without ``success``.
        load_factor: part of the loads, or of the change of inputs, at which stability was lost first; 1 if it was not.
        scene: the scene in equilibrium.
    """

    state: Array
    success: bool
    residual: float
    iterations: int | None
    solver: str
    tensions: Array
    slack: Array
    message: str = ""
    stable: bool | None = None
    branch: str = "unverified"
    load_factor: float = 1.0
    scene: Scene = field(repr=False, compare=False, kw_only=True)

    @property
    def margin(self) -> float:
        """Least stiffness against any deformation in parts of the elastic one: 1 without loads, below 0 unstable."""
        return self.scene.statics().margin(self.state)

    @property
    def error(self) -> float:
        """Estimated distance from the true shape, in parts of the length, where it is largest: see ``Resolution``.

        That of the grid alone. Infinite for a search that failed.
        """
        return self.scene.statics().error(self.state) if self.balanced else float("inf")

    @property
    def balanced(self) -> bool:
        """Whether it is an equilibrium that was found, be it one about which a vibration grows."""
        return self.success or self.branch == "flutters"

    def plot(self, path: str | os.PathLike[str] | None = None) -> Figure:
        """The shape with its tendons coloured by tension; written to ``path`` where one is given."""
        from pisplit.models.rod.output.results import plot_equilibrium

        return plot_equilibrium(self, path)


@brief
@dataclass(frozen=True)
class EquilibriumBatch:
    """Equilibria of many inputs; rows that failed hold the last iterate, and ``success`` tells them apart.

    Attributes:
        states: [xi, 0, u] (N, n_states).
        success: (N,) as in ``Equilibrium``.
        residual: (N,) in parts of EI/L.
        tensions: (N, tendons) in N.
        branch: (N,) as in ``Equilibrium``.
        load_factor: (N,) as in ``Equilibrium``.
        scene: the scene in equilibrium.
    """

    states: Array
    success: np.ndarray
    residual: Array
    tensions: Array
    branch: np.ndarray
    load_factor: Array
    scene: Scene = field(repr=False, compare=False, kw_only=True)

    def plot(self, path: str | os.PathLike[str] | None = None) -> Figure:
        """The last shape, others as ghosts; written to ``path`` where one is given. ValueError where none succeeded."""
        from pisplit.models.rod.output.results import plot_batch

        return plot_batch(self, path)
