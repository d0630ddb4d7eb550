"""Are the nodes enough? The error of a shape along the whole rod, from one Newton step on a finer grid."""

from __future__ import annotations

from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING

import casadi as ca
import numpy as np

from pisplit.checks import Array
from pisplit.models.rod.answers import warn_unresolved
from pisplit.models.rod.sharing import Rebuilt
from pisplit.models.rod.statics.refinement import MOST, cut_at, grids, places_of_jumps
from pisplit.models.rod.statics.twisted import doubt
from pisplit.models.rod.terms.pull import TendonTerm

if TYPE_CHECKING:
    from pisplit.models.rod.scene import Scene

#: Error of a shape, in parts of the length, above which a result warns, and the one that named nodes keep. Estimates
#: are 0.9 to 1.1 of the true errors: from ``CAUTION`` of the former on it is told.
COARSE, FINE, CAUTION = 1e-3, 1e-4, 0.8
#: Growth of the largest scaled strain from which on a shape is checked again.
GROWTH = 1.25
#: Nodes that the finer grid has more, on every element.
MORE = 2
#: Points along the rod at which shapes are compared.
POINTS = 20
#: Change of a scaled unknown by which the finer balance is differentiated.
STEP = 1e-6
#: Part of the largest singular value of the slopes by differences up to which a motion on joints costs nothing.
NEUTRAL = 1e-8
#: Newton steps that take an equilibrium to the next grid, and the scaled residual of states that are equilibria.
STEPS, BALANCED = 6, 1e-5


class Resolution(Rebuilt):
    """Error of the grid of a scene at rest.

    The strains are taken to a grid of two more nodes an element, with the end of one wherever a load or the rod itself
    jumps; one Newton step is made there, and both shapes are compared along the whole rod. A root there would tell no
    more: both grids differ by the error of the coarser one, which falls exponentially with the nodes. What neither grid
    sees (a jump in a term of the user's own) stays unseen.

    Args:
        scene: the rod and what acts on it.
        finer: the grid to compare with, if not that one.
    """

    def __init__(self, scene: Scene, finer: Scene | None = None) -> None:
        self.scene = scene
        self.checked = -1.0
        if finer is not None:
            self.finer = finer

    @cached_property
    def finer(self) -> Scene:
        """The scene on more nodes, cut where something jumps."""
        return cut_at(
            self.scene, places_of_jumps(self.scene.rod, self.scene.terms), [k + MORE for k in self.scene.element_nodes]
        )

    def error(self, state: Array) -> float:
        """Largest distance from the true shape, in parts of the length, of a ``state`` [xi, 0, u] at rest.

        Infinite where the finer balance has no slopes (at the load at which the rod buckles), or overflows.
        """
        return self.judged(state)[0]

    def judged(self, state: Array) -> tuple[float, Array]:
        """The error of ``state``, and what the strains of every element of the finer grid have in it (elements,)."""
        strains, *_, u = self.scene.layout.split(state)
        there = self.interpolated(strains)
        better = there + self._newton_step(there, u)
        if not np.isfinite(better).all():
            return float("inf"), np.ones(len(self.finer.element_nodes))
        shape, length = np.asarray(self.shapes[1](better, u)), self.scene.rod.length

        def distance(other: ca.DM) -> float:
            return float(np.linalg.norm(np.asarray(other) - shape, axis=0).max()) / length

        found, free = [], self.scene.rod.strain_set.n_fields
        ends = free * np.cumsum([0, *self.finer.element_nodes])
        for a, b in pairwise(ends.tolist()):
            left = better.copy()
            left[a:b] = there[a:b]
            found.append(distance(self.shapes[1](left, u)))
        return distance(self.shapes[0](strains, u)), np.array(found)

    def check(self, states: Array) -> None:
        """Warn (``Unresolved``) if the nodes do not resolve the most bent of ``states`` (N, n_states) at rest.

        States that are hardly more bent than one that was checked before are not checked again.
        """
        scaled = (self.scene.layout.split(states).strains - self.scene.rest_coordinates) / self.scene.nominal_strains
        bent = np.abs(scaled).max(axis=1, initial=0.0)
        if len(bent) == 0 or bent.max() <= GROWTH * self.checked:
            return
        worst = int(bent.argmax())
        self.checked = float(bent[worst])
        twisted = doubt(self.scene, states[worst])
        if twisted:
            warn_unresolved(twisted)
        error = self.error(states[worst])
        if error > CAUTION * COARSE:
            if self._bends_at_disks:
                what = "loads jump at disks: cut the rod into elements from disk to disk"
            else:
                what = self._told(self.would_do(states[worst], FINE))
            few = _shortest(self.scene.element_nodes)
            told = f"{few} nodes do not resolve this shape: off by {error:.1g} of the length along the rod; {what}"
            warn_unresolved(told)

    @cached_property
    def _bends_at_disks(self) -> bool:
        """Whether tendons run over disks within an element: more nodes hardly help, and take long to find out."""
        length, borders = self.scene.rod.length, np.array(self.scene.rule.borders)
        places = [t.holes(length) for t in self.scene.terms if isinstance(t, TendonTerm)]
        return any(np.abs(s - borders).min() > 1e-9 * length for s in np.concatenate([np.zeros(1), *places]))

    def would_do(self, state: Array, tolerance: float) -> Scene | None:
        """The scene on a grid that resolves the equilibrium near ``state`` to ``tolerance`` of the length.

        None if it takes more than ``MOST`` nodes an element or ``ALL``, or if no equilibrium is found there on more.
        """
        return next((finer.scene for finer, error in grids(self, state) if error <= tolerance), None)

    def _told(self, fine: Scene | None) -> str:
        """What to do, in words: the nodes and borders of ``fine``."""
        if fine is None:
            return f"not even {MOST} would do: cut the rod into elements"
        borders, own = fine.rule.borders[1:-1], np.array(self.scene.rule.borders)
        new = [s for s in borders if np.abs(own - s).min() > 1e-9 * self.scene.rod.length]
        if not new:
            return f"nodes={_shortest(fine.element_nodes)} would do"
        places = ", ".join(f"{s:.6g}" for s in new)
        nodes = _shortest(fine.element_nodes)
        return f"elements that end at s = {places} m too and nodes={nodes} would do: Scene.resolved makes them"

    def of(self, scene: Scene) -> Resolution:
        """That of another ``scene``."""
        return Resolution(scene)

    def on(self, scene: Scene) -> Resolution:
        """That of the same scene beside another ``scene`` than ``finer``."""
        return self if scene is self.finer else Resolution(self.scene, scene)

    def root(self, state: Array) -> Array | None:
        """Strains (n,) of the equilibrium of the finer grid near ``state``, None where the steps overflow."""
        strains, *_, u = self.scene.layout.split(state)
        return self._root_near(self.interpolated(strains), u)

    def on_finer(self, state: Array) -> Array:
        """``state`` [xi, xi_t, sigma, u] on the finer grid: all are interpolated, but strains so that forces are.

        An equilibrium so goes to the one there; what is let go is pulled back by what pulled it on its own grid.
        """
        strains, rates, overstress, u = self.scene.layout.split(state)
        if self.scene.n_joint:  # its balance at rest has no slopes where the joint is free
            moved = [self.interpolated(part) for part in (strains, rates)]
            return np.concatenate([*moved, self.interpolated(overstress, 0), u])
        xi, rates, overstress = (self.interpolated(part) for part in (strains, rates, overstress))
        force = self.interpolated(np.asarray(self._balance(strains, u)).ravel())
        root = self._root_near(xi, u, 0.0 if np.abs(force).max() < BALANCED else force)
        return np.concatenate([xi if root is None else root, rates, overstress, u])

    def interpolated(self, values: Array, joint: int | None = None) -> Array:
        """Strains, their rates or overstress ``values`` (..., b n) at the nodes of the finer grid.

        ``joint`` of each n entries are joint coordinates, those of the scene when not given, and stay as they are.
        """
        joint, free = self.scene.n_joint if joint is None else joint, self.scene.layout.n_free
        blocks = values.shape[-1] // (free + joint)
        each = values.reshape(*values.shape[:-1], blocks, free + joint)
        strains = each[..., :free]
        at_nodes = strains.reshape(*values.shape[:-1], blocks, self.scene.nodes, self.scene.rod.strain_set.n_fields)
        finer = np.asarray(self.scene.rule.interpolate(self.finer.rule.nodes) @ at_nodes)
        moved = finer.reshape(*values.shape[:-1], blocks, self.finer.layout.n_free)
        whole = np.concatenate([moved, each[..., free:]], axis=-1)
        return whole.reshape(*values.shape[:-1], blocks * (self.finer.layout.n_free + joint))

    def _root_near(self, xi: Array, u: Array, force: Array | float = 0.0) -> Array | None:
        """Strains (n,) of the finer grid near ``xi`` with the residual ``force``, None where the steps overflow."""
        for _ in range(STEPS):
            xi = xi + self._newton_step(xi, u, force)
        return xi if np.isfinite(xi).all() else None

    def _newton_step(self, xi: Array, u: Array, force: Array | float = 0.0) -> Array:
        """Change of the strains ``xi`` (n,) on the finer grid by one Newton step; slopes by differences."""
        unit = self.finer.nominal_strains
        probes = np.vstack([np.zeros(len(xi)), STEP * np.eye(len(xi))]) * unit
        values = np.asarray(self._balances((xi + probes).T, u)).T
        slopes, missed = (values[1:] - values[0]).T / STEP, values[0] - force
        try:
            if self.scene.n_joint:  # what costs nothing (a rod between ball joints about its axis) stays as it is
                step: Array = -unit * np.linalg.lstsq(slopes, missed, rcond=NEUTRAL)[0]
            else:
                step = -unit * np.linalg.solve(slopes, missed)
        except np.linalg.LinAlgError:
            return np.full(len(xi), np.inf)
        return step

    @cached_property
    def _balances(self) -> ca.Function:
        """``(xi, u) -> residual`` in scaled form, of a column a probe."""
        xi, u, balance = self.finer.static_balance
        residual = balance.residual / ca.DM(self.finer.nominal_residual)
        return ca.Function("balance", [xi, u], [residual]).map(len(self.finer.nominal_strains) + 1)

    @cached_property
    def _balance(self) -> ca.Function:
        """``(xi, u) -> residual`` of the scene's own grid in scaled form."""
        xi, u, balance = self.scene.static_balance
        return ca.Function("own", [xi, u], [balance.residual / ca.DM(self.scene.nominal_residual)])

    @cached_property
    def shapes(self) -> tuple[ca.Function, ca.Function]:
        """``(xi, u) -> positions`` (3, POINTS) on both grids."""
        points = (self.scene.rod.length * np.arange(1, POINTS + 1) / POINTS).tolist()
        made = []
        for scene in (self.scene, self.finer):
            xi, u, balance = scene.static_balance
            made.append(ca.Function("shape", [xi, u], [balance.motion.position_at(points)]))
        return made[0], made[1]


def _shortest(nodes: tuple[int, ...]) -> str:
    """One number where all elements have the same."""
    return str(nodes[0]) if len(set(nodes)) == 1 else str(list(nodes))
