"""What moving a tip to a place returns."""

from __future__ import annotations

import os
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from pisplit.brief import brief
from pisplit.checks import Array
from pisplit.models.rod.statics.equilibrium import Equilibrium, Shape

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from pisplit.models.rod.scene import Scene


@brief
@dataclass(frozen=True)
class FixedTipEquilibrium(Shape):
    """An equilibrium whose tip is pinned (its position is prescribed) or clamped (its rotation too).

    Attributes:
        state: [xi, 0, u] (n_states,).
        force: (3,) in N and moment: (3,) in N m at the tip, in world axes; the moment of a pinned tip is zero.
        success: whether balance and pose are met by a stable shape; message: why not, or where stability was lost on
            the way to it.
        residual: largest error of balance (parts of EI/L) and pose (parts of L, rad).
        stable: whether no deformation that leaves the tip in its place goes on by itself and no such vibration grows.
        branch: ``"followed"``, ``"snapped"``, ``"given"``, ``"flutters"`` or ``"unverified"`` as in
            ``Equilibrium``, for the motion of the tip from where it started.
        load_factor: part of the way of the tip at which stability was lost first; 1 if it was not.
        clamped: whether the rotation of the tip is prescribed beside its position.
        scene: the scene in equilibrium.
    """

    state: Array
    force: Array
    moment: Array
    success: bool
    residual: float
    message: str
    stable: bool = False
    branch: str = "unverified"
    load_factor: float = 1.0
    clamped: bool = False
    scene: Scene = field(repr=False, compare=False, kw_only=True)

    @property
    def error(self) -> float:
        """Estimated distance from the true shape, in parts of the length, where it is largest: see ``Resolution``.

        That of the grid alone, with the tip where it is. Infinite for a search that failed.
        """
        return self.scene.statics().fixed_tip(self.clamped).error(self.state) if self.success else float("inf")

    def plot(self, path: str | os.PathLike[str] | None = None) -> Figure:
        """The shape and the force at its tip; written to ``path`` where one is given."""
        from pisplit.models.rod.output.results import plot_fixed_tip

        return plot_fixed_tip(self, path)


def after(found: FixedTipEquilibrium, free: Equilibrium) -> FixedTipEquilibrium:
    """``found`` by moving the tip of a ``free`` rod; if that had lost stability under its loads, it says so."""
    if not found.success or free.branch != "snapped" or found.branch == "snapped":
        return found
    return replace(
        found, branch="snapped", load_factor=0.0, message=f"before its tip was moved, the rod {free.message}"
    )
