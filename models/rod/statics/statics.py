"""Static equilibria of a scene, and what depends on them."""

from __future__ import annotations

import os
from dataclasses import replace
from functools import cached_property

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from pisplit.checks import Array, count, finite_array, real_array
from pisplit.mapping import Mapped
from pisplit.models.rod.equations.tangent import PoseSensitivity, Stability, Tangent, checked_state, stability
from pisplit.models.rod.output.paying import Compiled, checked_compiled
from pisplit.models.rod.scene import Scene
from pisplit.models.rod.sharing import Rebuilt, in_turn
from pisplit.models.rod.statics.boundary import FixedTip
from pisplit.models.rod.statics.branch import LOST, Branches, Verdict
from pisplit.models.rod.statics.equilibrium import Equilibrium, EquilibriumBatch
from pisplit.models.rod.statics.fixed_tip import FixedTipEquilibrium, after
from pisplit.models.rod.statics.held_scene import HeldScene
from pisplit.models.rod.statics.inverse import InverseSolution, inverse
from pisplit.models.rod.statics.jointed import JointedScene
from pisplit.models.rod.statics.machine import by_machine
from pisplit.models.rod.statics.resolution import Resolution
from pisplit.models.rod.statics.rows import follow_rows, one_by_one, solve_rows
from pisplit.models.rod.statics.search import TOLERANCE, Search
from pisplit.models.rod.terms.base import joint_of
from pisplit.models.rod.terms.held import held_tip


class Statics(Rebuilt):
    """Equilibria of a scene: the shape that slow loading reaches, or a word that it is another (see ``Branches``).

    KINSOL or Newton's method finds a root; unless it is the only one, it is unloaded step by step, or loading is
    followed from nothing. Where the tip is held (``HeldTip``), the free rod is loaded first, and its tip is then moved
    to its place as ``pin_tip`` does. A base with a hinge or slides is let go where it is and comes to rest downhill:
    see ``JointedScene``.

    May be copied, pickled and sent to workers; calls from several threads wait for one another.

    Args:
        scene: the rod and what acts on it.
    """

    def __init__(self, scene: Scene) -> None:
        self.scene = scene

    @cached_property
    def search(self) -> Search:
        """The scaled balance and its rootfinders."""
        return Search(self.scene)

    @cached_property
    def branches(self) -> Branches:
        """Tells which equilibrium it is."""
        return Branches(self.search)

    @cached_property
    def held(self) -> HeldScene | None:
        """Moves the tip to where it is held, None where it is free."""
        tip = held_tip(self.scene.terms)
        return None if tip is None else HeldScene(self.scene, tip)

    @cached_property
    def jointed(self) -> JointedScene | None:
        """Lets the base come to rest, None where it is clamped or the tip is held (``held`` lets it go then)."""
        base = joint_of(self.scene.terms)
        return None if base is None or self.held is not None else JointedScene(self.scene, base)

    @cached_property
    def resolution(self) -> Resolution:
        """Tells whether the nodes are enough."""
        return Resolution(self.scene)

    @property
    def residual_function(self) -> ca.Function:
        """``(x, u) -> residual`` in scaled form: see ``Search``."""
        return self.search.residual_function

    @property
    def kinsol(self) -> ca.Function:
        """``(x_guess, u) -> x`` in scaled unknowns: see ``Search``."""
        return self.search.kinsol

    @cached_property
    def readings(self) -> Mapped:
        """``(xi, u) -> `` tensions, lengths and unpulled lengths of the tendons, behind one another."""
        xi, u, balance = self.scene.static_balance
        empty = ca.SX(0, 1)
        outputs = [balance.loads.outputs.get(name, empty) for name in ("tension", "length", "unpulled_length")]
        return Mapped(ca.Function("readings", [xi, u], [ca.vertcat(*outputs)]))

    def _need_clamp(self) -> None:
        if self.scene.n_joint:
            raise ValueError(
                "this needs a base that is clamped, and the scene has one with a hinge or slides; ask for it of the "
                "rod on Base(position, rotation)"
            )

    # Solving ---------------------------------------------------------------------------------------------------------

    @in_turn()
    def solve(self, u: ArrayLike | None = None, guess: ArrayLike | None = None) -> Equilibrium:
        """Equilibrium under constant inputs.

        A failed search is returned with ``success=False`` and a message, never raised.

        Args:
            u: inputs (n_inputs,), zeros when not given.
            guess: state (n_states,) or strains (n_strains,) to start from, the straight rod when not given.

        Raises ValueError for arrays of another shape or with entries that are not finite.
        """
        scene, search = self.scene, self.search
        u = scene.checked_inputs(np.zeros(scene.n_inputs) if u is None else u, "u", (scene.n_inputs,))
        x0 = np.zeros(scene.n_strains) if guess is None else self._scaled(guess)
        if self.jointed is not None:
            return self.jointed.solve(u, None if guess is None else search.strains(x0))
        if self.held is not None:
            return self._solve_held(self.held, u, None if guess is None else search.strains(x0))
        x, iterations, solver = search.find(u, x0, self.branches.unique(u))
        residual = search.worst(x, u)
        verdict = self._verdict(x, u, residual <= TOLERANCE, x0 if guess is not None else None, guess)
        if verdict.x is not x:
            x, iterations, solver = verdict.x, None, "path"
            residual = search.worst(x, u)
        success = bool(residual <= TOLERANCE and verdict.branch not in LOST)
        tensions, slack = self.read(x, u)
        state = scene.at_rest(search.strains(x), u)
        self.check(state[None], residual <= TOLERANCE and verdict.branch != "unverified")
        return Equilibrium(
            state=state,
            success=success,
            residual=residual,
            iterations=iterations,
            solver=solver,
            tensions=tensions,
            slack=slack,
            message=verdict.message if success or verdict.message else f"not converged: residual {residual:.1e} EI/L",
            stable=verdict.stable,
            branch=verdict.branch if residual <= TOLERANCE else "unverified",
            load_factor=verdict.load_factor,
            scene=scene,
        )

    def _solve_held(self, held: HeldScene, u: Array, start: Array | None) -> Equilibrium:
        """Equilibrium with a held tip, near the strains ``start`` (n_strains,) if given."""
        found = held.solve(u, start)
        strains = found.state[: self.scene.n_strains]
        state = self.scene.at_rest(strains, u)
        self.check(state[None], found.success)
        tensions, slack = self.read(self.search.scaled(strains), u)
        return Equilibrium(
            state=state,
            success=found.success,
            residual=found.residual,
            iterations=None,
            solver="path",
            tensions=tensions,
            slack=slack,
            message=found.message,
            stable=found.stable,
            branch=found.branch,
            load_factor=found.load_factor,
            scene=self.scene,
        )

    def _verdict(self, x: Array, u: Array, converged: bool, start: Array | None, guess: ArrayLike | None) -> Verdict:
        """What is known of the candidate ``x``; where it is not on the branch that was asked for, the one that is."""
        branches = self.branches
        if start is None:
            return branches.of_root(x, u, converged)
        given = real_array(guess, "guess").ravel()  # type: ignore[arg-type]  # there is one where there is a start
        if given.size == self.scene.n_states:
            before = self.scene.layout.split(given).inputs
            if branches.rests(start, before):
                return branches.of_state(x, u, start, before, converged)
        return branches.near(x, u) if converged else branches.of_root(x, u, converged)

    @in_turn()
    def solve_many(
        self,
        inputs: ArrayLike,
        progress: bool = False,
        chunk: int = 512,
        near: ArrayLike | None = None,
        threads: int = 1,
        compiled: Compiled = "auto",
    ) -> EquilibriumBatch:
        """Equilibria of many inputs, each from a guess that is affine in them; one bad row is flagged, never raised.

        Args:
            inputs: (N, n_inputs).
            progress: whether to show a bar.
            chunk: rows solved by one call.
            near: states at rest (N, n_states) from which the inputs are moved to ``inputs``; rows that are not at rest
                are loaded from nothing, as all are when not given.
            threads: chunks solved side by side, -1 for one a core; the numbers are the same.
            compiled: whether by machine code, which is made first: five times faster, the same numbers. By default
                where there is a compiler and enough rows to gain by it. Tips that are held and bases on joints, whose
                rows are followed one by one, use neither threads nor machine code.

        Raises ValueError for arrays of another shape or with entries that are not finite, and for other values of the
        rest, used or not.
        """
        checked_compiled(compiled)
        count(chunk, "chunk")
        rows = self.scene.checked_inputs(inputs, "U", (None, self.scene.n_inputs))
        states = None if near is None else finite_array(near, "near", (len(rows), self.scene.n_states))
        side_by_side = (os.cpu_count() or 1) if threads == -1 else count(threads, "threads")
        if self.held is not None or self.jointed is not None:
            return one_by_one(self, rows, states, False, progress)
        serving = by_machine(self, compiled, len(rows))
        found = solve_rows(serving, rows, states, chunk, progress, side_by_side)
        return found if serving is self else replace(found, scene=self.scene)

    @in_turn()
    def sweep(self, inputs: ArrayLike) -> EquilibriumBatch:
        """Equilibria along a path: each starts where the tangent of the last one leads.

        This follows one branch of equilibria; a row that fails is flagged and the next starts from the last good one.

        Args:
            inputs: (N, n_inputs) in the order of the path.
        """
        rows = self.scene.checked_inputs(inputs, "U", (None, self.scene.n_inputs))
        if self.held is not None or self.jointed is not None:
            return one_by_one(self, rows, None, True, False)
        return follow_rows(self, rows)

    # What an equilibrium depends on ----------------------------------------------------------------------------------

    @in_turn()
    def sensitivity(self, state: ArrayLike, s: float | None = None) -> PoseSensitivity:
        """Tendon Jacobian and compliance of the pose at an equilibrium.

        Args:
            state: equilibrium [xi, 0, u] (n_states,).
            s: arclength of the pose in m, the tip when not given.

        Raises ValueError where the equilibrium has no derivatives (at the load at which it buckles).
        """
        self._need_clamp()
        s = self.scene.rod.length if s is None else float(s)
        if s not in self._tangents:
            self._tangents[s] = Tangent(self.scene, s)
        return self._tangents[s].sensitivity(checked_state(self.scene, state))

    @cached_property
    def _tangents(self) -> dict[float, Tangent]:
        return {}

    @in_turn()
    def margin(self, state: ArrayLike) -> float:
        """Least stiffness of a ``state`` [xi, 0, u] (n_states,) at rest, in parts of the elastic one.

        Negative: unstable. Without an energy (follower loads, friction) it is the least real part of the eigenvalues,
        which rules out buckling, not flutter: see ``stability``.
        """
        strains, *_, u = self.scene.layout.split(checked_state(self.scene, state))
        if self.jointed is not None:
            return self.jointed.margin(strains, u)
        if self.held is not None:
            return self.held.margin(strains, u)
        return self.branches.margin(self.search.scaled(strains), u)

    @in_turn()
    def stability(self, state: ArrayLike) -> Stability:
        """Stability of an equilibrium ``state`` [xi, 0, u] (n_states,): see ``Stability``.

        Raises ValueError for a tip that is held: ``margin`` tells of it.
        """
        self._need_clamp()
        if self.held is not None:
            raise ValueError("stability is that of a free tip; statics().margin(state) tells of one that is held")
        x = checked_state(self.scene, state)
        found = stability(self.scene, x)
        if self.branches.judge.has_energy:
            return found
        strains, *_, u = self.scene.layout.split(x)
        whitened, judge = self.branches.whitened, self.branches.judge
        y = whitened.of(self.search.scaled(strains))
        margin, direction = judge.softest(whitened.stiffness(y, u))
        mode = direction / whitened.sizes[0] * self.scene.nominal_strains
        vibration = self.branches.flutter.at(y, u)
        return replace(
            found,
            margin=margin,
            mode=mode / mode[np.abs(mode).argmax()],
            growth=0.0 if vibration is None else vibration.value.real,
        )

    @in_turn()
    def inverse(
        self,
        target: ArrayLike,
        limits: ArrayLike | None = None,
        start: ArrayLike | None = None,
        tolerance: float = 1e-8,
    ) -> InverseSolution:
        """Inputs that bring the tip to ``target`` (3,) in m; NaN leaves a coordinate free.

        Gauss-Newton with the exact Jacobian from ``start`` (zeros when not given): of all inputs that do, those found
        by smallest steps. Targets out of reach are flagged, never raised.

        Args:
            target: coordinates of the tip in world axes.
            limits: (low, high) for all inputs or (2, n_inputs).
            start: inputs (n_inputs,) to start from, e.g. the pretension of the tendons.
            tolerance: of the position in parts of the length.
        """
        return inverse(self, target, limits, start, tolerance)

    def pin_tip(
        self, position: ArrayLike, u: ArrayLike | None = None, guess: ArrayLike | None = None
    ) -> FixedTipEquilibrium:
        """Equilibrium with the tip pinned: its position is prescribed, it turns freely.

        The tip is moved there on a straight way in steps under which the rod stays stable; where it ceases to be it
        buckles or snaps through, and the way goes on from where it rests behind. A straight rod that cannot be
        compressed buckles at once. A place that cannot be reached is flagged, never raised.

        Args:
            position: of the tip (3,) in m, in world axes.
            u: inputs (n_inputs,), zeros when not given.
            guess: state (n_states,) or strains (n_strains,) from which the tip is moved if a wrench at the tip keeps
                it at rest (any ``state`` of a fixed tip), else near which the equilibrium is; the free equilibrium
                when not given.
        """
        return self._fix_tip(False, position, None, u, guess, 0.0)

    def clamp_tip(
        self,
        position: ArrayLike,
        rotation: ArrayLike,
        u: ArrayLike | None = None,
        guess: ArrayLike | None = None,
        turns: float = 0.0,
    ) -> FixedTipEquilibrium:
        """Equilibrium with the tip clamped: position and rotation are prescribed; reached as in ``pin_tip``.

        Args:
            position: of the tip (3,) in m, in world axes.
            rotation: of the tip (3, 3), body axes as columns.
            u: inputs (n_inputs,), zeros when not given.
            guess: as in ``pin_tip``.
            turns: by which the tip is twisted about its own axis on the way, beyond ``rotation``.

        Raises ValueError for a matrix that is no rotation, and for turns of a planar rod.
        """
        return self._fix_tip(True, position, rotation, u, guess, turns)

    @in_turn()
    def _fix_tip(
        self,
        clamped: bool,
        position: ArrayLike,
        rotation: ArrayLike | None,
        u: ArrayLike | None,
        guess: ArrayLike | None,
        turns: float,
    ) -> FixedTipEquilibrium:
        self._need_clamp()
        if self.held is not None:
            raise ValueError("the tip of this scene is held by a HeldTip; solve() finds its equilibria")
        scene, twist = self.scene, float(finite_array(turns, "turns", ()))
        if twist and scene.rod.strain_set.planar:
            raise ValueError(f"turns = {twist:g} of a planar rod; give a rod that twists, such as strains='kirchhoff'")
        inputs = scene.checked_inputs(np.zeros(scene.n_inputs) if u is None else u, "u", (scene.n_inputs,))
        if guess is None:
            free = self.solve(inputs)
            start, rests = free.state, free.success
        else:
            free, start, rests = None, self.search.strains(self._scaled(guess)), False
        tip = self.fixed_tip(clamped)
        found = tip.solve(inputs, position, rotation, twist, start, rests)
        tip.check(found)
        return found if free is None else after(found, free)

    def fixed_tip(self, clamped: bool) -> FixedTip:
        """What moves the tip: ``clamped``, or pinned."""
        if clamped not in self._fixed_tips:
            self._fixed_tips[clamped] = FixedTip(self.branches.whitened, clamped)
        return self._fixed_tips[clamped]

    @cached_property
    def _fixed_tips(self) -> dict[bool, FixedTip]:
        return {}

    def check(self, states: Array, success: np.ndarray | bool) -> None:
        """Warn if the nodes do not resolve the most bent of the ``states`` (N, n_states) of ``success`` (N,)."""
        self.resolution.check(states[np.broadcast_to(success, len(states))])

    @in_turn()
    def error(self, state: ArrayLike) -> float:
        """Estimated error of a ``state`` [xi, 0, u] (n_states,) at rest: largest distance from the true shape.

        In parts of the length, along the whole rod; that of the grid alone: see ``Resolution``.
        """
        x = checked_state(self.scene, state)
        return (self.resolution if self.jointed is None else self.jointed.resolution).error(x)

    # Guesses and readings --------------------------------------------------------------------------------------------

    def read(self, x: Array, u: Array) -> tuple[Array, Array]:
        """Tensions in N and slack in m of every tendon at scaled strains ``x`` (n_strains,) under ``u`` (n_inputs,).

        Tendons driven by tension are never slack.
        """
        tension, length, unpulled = self.readings(self.search.strains(x)[None], u[None]).reshape(3, -1)
        return tension, np.maximum(0.0, unpulled - length)

    def _scaled(self, guess: ArrayLike) -> Array:
        values = real_array(guess, "guess").ravel()
        if values.size not in (self.scene.n_strains, self.scene.n_states):
            raise ValueError(
                f"guess has {values.size} entries; expected {self.scene.n_states} (a state) "
                f"or {self.scene.n_strains} (strains)"
            )
        return self.search.scaled(finite_array(values[: self.scene.n_strains], "guess", (None,)))
