"""Equilibria of a scene whose tip is held: the tip of the free rod is moved to where it is held."""

from __future__ import annotations

import warnings
from functools import cached_property
from typing import TYPE_CHECKING

import casadi as ca
import numpy as np

from pisplit.checks import Array
from pisplit.models.rod.answers import Unresolved
from pisplit.models.rod.sharing import Rebuilt
from pisplit.models.rod.statics.boundary import FixedTip
from pisplit.models.rod.statics.branch import LOST
from pisplit.models.rod.statics.equilibrium import Equilibrium
from pisplit.models.rod.statics.fixed_tip import FixedTipEquilibrium, after
from pisplit.models.rod.statics.jointed import JointedScene
from pisplit.models.rod.statics.journey import Journey
from pisplit.models.rod.terms.base import Base, joint_of
from pisplit.models.rod.terms.held import HeldTip

if TYPE_CHECKING:
    from pisplit.models.rod.scene import Scene


class HeldScene(Rebuilt):
    """Equilibria of a scene with a ``HeldTip``: loads first, then the tip goes to its place, see ``Statics.pin_tip``.

    A base with a hinge or slides is clamped until the loads act, and let go before the tip is moved. Where the rod
    loses stability before its tip is held, the tip goes first and the loads grow then.

    Args:
        scene: the rod, what acts on it, and what holds its tip.
        tip: what holds it.
    """

    def __init__(self, scene: Scene, tip: HeldTip) -> None:
        self.scene, self.tip = scene, tip

    @cached_property
    def free(self) -> Scene:
        """The scene with a free tip."""
        scene = self.scene.without(HeldTip)
        return scene if self.base is None else JointedScene(scene, self.base).scene

    @cached_property
    def base(self) -> Base | None:
        """The base if it turns or slides freely."""
        return joint_of(self.scene.terms)

    @cached_property
    def _kept(self) -> list[int]:
        """Which inputs the free scene has."""
        names = self.scene.input_names
        return [names.index(name) for name in self.free.input_names]

    @cached_property
    def fixed(self) -> FixedTip:
        """Moves the tip."""
        planar = self.scene.rod.strain_set.planar
        whitened = self.free.statics().branches.whitened
        return FixedTip(whitened, self.tip.rotation is not None, self.tip.held_axes(planar))

    @cached_property
    def _pose(self) -> ca.Function:
        """``u -> `` position (3,), rotation (3, 3) and its vector (3,)."""
        symbols = {item.name: ca.SX.sym(item.name, item.size) for item in self.scene.inputs}
        u = ca.vertcat(ca.SX(0, 1), *symbols.values())
        return ca.Function("pose", [u], [*self.tip.pose(symbols), self.tip.turn(symbols)])

    def pose(self, u: Array) -> tuple[Array, Array | None]:
        """Where the tip is held under inputs ``u`` (n_inputs,): position (3,) and rotation (3, 3), None if it turns."""
        place, turn, _ = (np.asarray(v, dtype=np.float64) for v in self._pose(u))
        if self.tip.rotation is None:
            return place.ravel(), None
        left, _, right = np.linalg.svd(turn)  # the exponential is a rotation to 1e-13
        return place.ravel(), left @ right

    def solve(self, u: Array, start: Array | None) -> FixedTipEquilibrium:
        """Equilibrium under inputs ``u`` (n_inputs,), near or from the strains ``start`` (n_strains,) if given."""
        place, turn = self.pose(u)
        inputs = u[self._kept]
        vector = None if turn is None else np.asarray(self._pose(u)[2], dtype=np.float64).ravel()
        if start is not None:
            return self.fixed.solve(inputs, place, turn, 0.0, start, False, vector)
        free = self._loaded(inputs)
        if free.branch in ("snapped", *LOST):
            none = np.zeros(0)
            held = self._bare.solve(none, place, turn, 0.0, self._bare.scene.rest_coordinates, True, vector)
            if held.success and held.branch != "snapped":
                found = self.fixed.loaded(self._bare, held, inputs)
                if found.success:
                    return found
        q = np.zeros(0 if self.base is None else self.base.freedom)
        first = np.concatenate([free.strains, q])
        found = self.fixed.solve(inputs, place, turn, 0.0, first, free.success, vector, self.base is not None)
        return after(found, free)

    def _loaded(self, inputs: Array) -> Equilibrium:
        """The rod with a free tip and a base that is clamped under ``inputs``."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", Unresolved)  # of a shape that is on the way alone
            if self.base is None:
                return self.free.statics().solve(inputs)
            jointed = JointedScene(self.free, self.base)
            return jointed.clamped.statics().solve(jointed.inputs(np.zeros(self.base.freedom), inputs))

    @cached_property
    def _bare(self) -> FixedTip:
        """Moves the tip of the rod without loads."""
        bare = self.free.without(object)
        for base in (t for t in self.free.terms if isinstance(t, Base)):
            bare = bare + base
        return FixedTip(bare.statics().branches.whitened, self.fixed.clamped, self.fixed.axes)

    def margin(self, x: Array, u: Array) -> float:
        """Least stiffness of strains ``x`` (n_strains,) against deformations that leave the tip where it is held.

        In parts of the elastic one, under inputs ``u`` (n_inputs,).
        """
        whitened, inputs = self.fixed.whitened, u[self._kept]
        y, _ = self.fixed._held(whitened.of(whitened.search.scaled(x)), inputs)
        place, frame = self.fixed._pose(y[: len(x)], inputs)
        still = Journey(place, place, frame, np.zeros(3), 0.0)
        return self.fixed.judge.softest(self.fixed.way(inputs, still)(y, 0.0)[1])[0]
