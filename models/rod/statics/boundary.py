"""Equilibria with the tip pinned or clamped: the wrench at the tip is part of the solution."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from pisplit.checks import Array, finite_array
from pisplit.models.rod.sharing import Rebuilt
from pisplit.models.rod.statics.branch import RESTING, told
from pisplit.models.rod.statics.certificate import without_energy
from pisplit.models.rod.statics.descent import descend
from pisplit.models.rod.statics.fixed_tip import FixedTipEquilibrium
from pisplit.models.rod.statics.held import HeldJudge
from pisplit.models.rod.statics.held_resolution import HeldResolution
from pisplit.models.rod.statics.journey import Journey, checked_rotation, rotations, wound
from pisplit.models.rod.statics.path import Event, Walk, walk
from pisplit.models.rod.statics.search import TOLERANCE
from pisplit.models.rod.statics.twisted import doubt
from pisplit.models.rod.statics.whitened import Way
from pisplit.models.rod.terms.loads import Input
from pisplit.models.rod.terms.wrench import TipWrench

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

    from pisplit.models.rod.scene import Scene
    from pisplit.models.rod.statics.search import Search
    from pisplit.models.rod.statics.whitened import Whitened

_FORCE, _MOMENT = "force at the tip", "moment at the tip"
#: Unit of the multipliers in EI/L^2 and EI/L: the Euler load of a clamped strut, so that they compare with angles.
UNIT = 4.0 * np.pi**2
#: Least singular value of the conditions, in parts of the largest, at which the tip can be moved in every direction.
MOVABLE = 1e-4
#: Share of the way of a straight rod to its place that its first bend takes, and the largest bend [rad].
FIRST_WAY, FIRST_BEND = 0.1, 0.5
#: Stiffness that is added where a deformation may cost nothing.
NEUTRAL = 1e-6
#: Steps of differences along the way, and of scaled unknowns.
STEP, PROBE = 1e-5, 1e-6


class FixedTip(Rebuilt):
    """Equilibria of a scene with its tip in a given place; see ``Statics.pin_tip`` and ``Statics.clamp_tip``.

    The unknowns are whitened strains y (see ``Whitened``) and multipliers, of which the wrench at the tip consists.

    Args:
        whitened: the balance of the scene.
        clamped: whether the rotation of the tip is prescribed beside its position.
        axes: world axes along which the position is prescribed; all when not given.
    """

    def __init__(self, whitened: Whitened, clamped: bool, axes: Sequence[int] = (0, 1, 2)) -> None:
        self.whitened = whitened
        self.scene = scene = whitened.search.scene
        self.clamped = clamped
        planar = scene.rod.strain_set.planar
        self.axes = [k for k in axes if not (planar and k == 1)]
        self._turns = ([1] if planar else [0, 1, 2]) if clamped else []
        self._force_unit = UNIT * min(scene.rod.stiffness[:2]) / scene.rod.length**2
        self._moment_unit = self._force_unit * scene.rod.length

    @cached_property
    def judge(self) -> HeldJudge:
        """Tells stable shapes."""
        return HeldJudge(not without_energy(self.scene), self.scene.n_strains)

    @cached_property
    def _search(self) -> Search:
        return self.whitened.search

    @cached_property
    def _balance(self) -> tuple[list[ca.SX], ca.SX, ca.SX]:
        """Symbols x, multipliers, u and pose; errors of balance (paper, eq. cosserat_rod_eq) and of the pose."""
        scene = self.scene
        loaded = scene + TipWrench(Input(_FORCE, 3), Input(_MOMENT, 3))
        n, m = scene.n_strains, scene.n_inputs
        xi, inputs, balance = loaded.static_balance
        motion = balance.motion
        x, many = ca.SX.sym("x", n), ca.SX.sym("multipliers", len(self.axes) + len(self._turns))
        u, p, turn = ca.SX.sym("u", m), ca.SX.sym("p", 3), ca.SX.sym("turn", 3, 3)
        off = ca.inv_skew(turn.T @ motion.tip_frame) - ca.inv_skew(motion.tip_frame.T @ turn)
        # The moment acts along the axes of the prescribed frame, which does not turn with the rod.
        pose = ca.vertcat((motion.tip - p)[self.axes] / scene.rod.length, 0.5 * off[self._turns])
        residual = balance.residual / ca.DM(loaded.nominal_residual)
        known = ca.DM(scene.rest_coordinates) + ca.DM(scene.nominal_strains) * x
        wrench = self._wrench(many, turn, ca.SX.zeros(3), ca.SX.zeros(3))
        residual, pose = ca.substitute([residual, pose], [xi, inputs], [known, ca.vertcat(u, *wrench)])
        return [x, many, u, ca.vertcat(p, ca.vec(turn))], residual, pose

    @cached_property
    def _errors(self) -> ca.Function:
        """``(x, multipliers, u, pose) -> `` errors of balance and pose, and their slopes."""
        symbols, residual, pose = self._balance
        slopes = [ca.jacobian(residual, symbols[0]), ca.jacobian(residual, symbols[1]), ca.jacobian(pose, symbols[0])]
        return ca.Function("errors", symbols, [residual, pose, *map(ca.densify, slopes)])

    @cached_property
    def _tip(self) -> ca.Function:
        """``(xi, u) -> `` position (3,) and rotation (3, 3) of the tip."""
        xi, u, balance = self.scene.static_balance
        return ca.Function("tip", [xi, u], [balance.motion.tip, ca.densify(balance.motion.tip_frame)])

    @cached_property
    def _resolution(self) -> HeldResolution:
        """Tells whether the nodes are enough, with the tip held where it is."""
        return HeldResolution(self.scene, self._of)

    def _of(self, scene: Scene) -> FixedTip:
        """What holds the tip of another ``scene`` of the same rod."""
        if scene is self.scene:
            return self
        if id(scene) not in self._others:  # each keeps its scene
            self._others[id(scene)] = FixedTip(scene.statics().branches.whitened, self.clamped, self.axes)
        return self._others[id(scene)]

    @cached_property
    def _others(self) -> dict[int, FixedTip]:
        return {}

    def pose_of(self, state: Array) -> Array:
        """Position and columns of the rotation (12,) of the tip of a ``state`` (n_states,)."""
        place, frame = self._pose_of(state)
        return np.concatenate([place, frame.as_matrix().ravel(order="F")])

    @cached_property
    def _both(self) -> ca.Function:
        """``(x, multipliers, u, pose) -> `` errors of balance and pose in a column, of a column a probe."""
        symbols, residual, pose = self._balance
        return ca.Function("both", symbols, [ca.vertcat(residual, pose)]).map(sum(s.numel() for s in symbols[:2]) + 1)

    def newton_step(self, xi: Array, u: Array, pose: Array) -> Array:
        """Change of strains ``xi`` (n,) by a Newton step under ``u`` (n_inputs,) with the tip held at ``pose`` (12,).

        From the multipliers that balance them best; slopes by differences, for it is called once a grid. Raises
        LinAlgError where there is none.
        """
        x, n, held = self._search.scaled(xi), len(xi), len(self.axes) + len(self._turns)

        def slopes(y: Array) -> tuple[Array, Array]:
            columns = (y + np.vstack([np.zeros(n + held), PROBE * np.eye(n + held)])).T
            errors = np.asarray(self._both(columns[:n], columns[n:], u, pose)).T
            return errors[0], (errors[1:] - errors[0]).T / PROBE

        errors, by = slopes(np.append(x, np.zeros(held)))
        best = np.append(x, np.linalg.lstsq(by[:n, n:], -errors[:n], rcond=None)[0])
        errors, by = slopes(best)
        change: Array = self.scene.nominal_strains * np.linalg.solve(by, -errors)[:n]
        return change

    def error(self, state: Array) -> float:
        """Estimated error of the grid at a ``state`` (n_states,) at rest whose tip is held: see ``Resolution``."""
        return self._resolution.error(state)

    def check(self, found: FixedTipEquilibrium) -> None:
        """Warn if the nodes do not resolve what was ``found``."""
        if found.success:
            self._resolution.check(found.state[None])

    def _wrench(self, multipliers: Any, turn: Any, force: Any, moment: Any) -> tuple[Any, Any]:
        """World force and moment, (3,) each, of multipliers; ``force`` and ``moment`` come as zeros."""
        for k, axis in enumerate(self.axes):
            force[axis] = self._force_unit * multipliers[k]
        for k, axis in enumerate(self._turns):
            moment[axis] = self._moment_unit * multipliers[len(self.axes) + k]
        return force, turn @ moment

    def way(self, u: Array, journey: Journey) -> Way:
        """The tip goes along a ``journey`` under inputs ``u`` (n_inputs,)."""
        of_x, of_residual, of_slopes = self.whitened.sizes
        n = len(of_x)

        def way(y: Array, t: float) -> tuple[Array, Array, Array]:
            x, many = y[:n] / of_x, y[n:]
            residual, off, h, j, g = (np.asarray(v) for v in self._errors(x, many, u, journey.at(t)))
            force = np.concatenate([of_residual * residual.ravel(), UNIT * off.ravel()])
            slopes = -np.block(
                [[of_slopes * h, of_residual[:, None] * j], [UNIT * g / of_x, np.zeros((len(off), len(off)))]]
            )
            ahead, behind = (self._errors(x, many, u, journey.at(t + d))[:2] for d in (STEP, -STEP))
            changes = [np.asarray(a - b).ravel() / (2.0 * STEP) for a, b in zip(ahead, behind, strict=True)]
            return force, slopes, np.concatenate([of_residual * changes[0], UNIT * changes[1]])

        return way

    # Where the way starts --------------------------------------------------------------------------------------------

    def _pose(self, y: Array, u: Array) -> tuple[Array, Rotation]:
        n = self.scene.n_strains
        return self._pose_of(self.scene.at_rest(self._search.strains(self.whitened.unknowns(y[:n])), u))

    def _pose_of(self, state: Array) -> tuple[Array, Rotation]:
        strains, *_, u = self.scene.layout.split(state)
        place, frame = (np.asarray(v) for v in self._tip(strains, u))
        return place.ravel(), rotations().from_matrix(frame)

    def _held(self, y: Array, u: Array) -> tuple[Array, float]:
        """Unknowns at the strains ``y`` with the multipliers that hold them best, and the force that is left."""
        n = len(y)
        whole = np.concatenate([y, np.zeros(len(self.axes) + len(self._turns))])
        force, stiffness, _ = self._still(y, u)(whole, 0.0)
        whole[n:] = np.linalg.lstsq(stiffness[:n, n:], force[:n], rcond=1e-9)[0]
        return whole, float(np.abs(force[:n] - stiffness[:n, n:] @ whole[n:]).max())

    def _movable(self, y: Array, u: Array) -> bool:
        """Whether small deformations move the tip in every direction: that of a straight rod cannot go along it."""
        n = self.scene.n_strains
        stiffness = self._still(y, u)(y, 0.0)[1]
        values = np.linalg.svd(stiffness[n:, :n], compute_uv=False)
        return bool(values[-1] > MOVABLE * values[0])

    def _bent(self, y: Array, u: Array, goal: Array) -> Array:
        """``y`` slightly bent: towards a goal beside the rod, for one along it as it buckles."""
        n, (place, frame) = self.scene.n_strains, self._pose(y, u)
        length, bent = self.scene.rod.length, y.copy()
        way = frame.inv().apply(goal - place)
        size = np.sqrt(FIRST_WAY * float(np.linalg.norm(way)) / length)
        beside = way[:2] / max(float(np.linalg.norm(way)), 1e-300)
        if np.linalg.norm(beside) > 0.1:
            free = self.scene.rod.strain_set.free
            node = [{0: -beside[1], 1: beside[0]}.get(component, 0.0) for component in free]
            taper = 1.0 - self.scene.rule.nodes / length
            turned = np.append(np.outer(taper, node), np.zeros(self.scene.n_joint))
            bent[:n] += min(FIRST_BEND, size) * self.whitened.of(turned)
            return bent
        pressed = y.copy()
        pressed[n : n + len(self.axes)] -= frame.apply([0.0, 0.0, 1.0])[self.axes] / UNIT
        still = self._still(y, u)
        free_of, under = still(y, 0.0)[1], still(pressed, 0.0)[1]
        basis = self.judge.basis(free_of)
        loss = (free_of - under)[:n, :n]
        resists = free_of[:n, :n] + NEUTRAL * np.eye(n)  # a rod between two ball joints turns about its axis
        from scipy.linalg import eigh  # slow to load

        vectors = eigh(*(basis.T @ (0.5 * (k + k.T)) @ basis for k in (loss, resists)))[1]
        mode = basis @ vectors[:, -1]
        shortening = float(mode @ loss @ mode) / 2.0
        bent[:n] += min(FIRST_BEND, size / np.sqrt(max(shortening, 1e-12))) * mode
        return bent

    # Solving ---------------------------------------------------------------------------------------------------------

    def solve(
        self,
        u: Array,
        position: ArrayLike,
        rotation: ArrayLike | None,
        turns: float,
        start: Array,
        rests: bool,
        vector: Array | None = None,
        release: bool = False,
    ) -> FixedTipEquilibrium:
        """Equilibrium under inputs ``u`` (n_inputs,) reached by moving the tip.

        Args:
            u: inputs.
            position: of the tip (3,) in m.
            rotation: of a clamped tip (3, 3), None for a pinned one.
            turns: by which a clamped tip is twisted about its axis, beyond ``rotation``.
            start: state (n_states,) to start from.
            rests: whether it is meant to be an equilibrium, else a guess.
            vector: rotation vector (3,) of ``rotation`` from the unloaded tip, which tells whole turns; None: none.
            release: whether a base on a joint is let go first, with the tip held where it is.

        Raises ValueError for a rotation that is none.
        """
        n, place = self.scene.n_strains, finite_array(position, "position", (3,))
        wanted = None if rotation is None else checked_rotation(rotation)
        y, left = self._held(self.whitened.of(self._search.scaled(start[:n])), u)
        goal, events, branch = self._goal(y, u, place), list[Event](), "followed"
        if release and left > RESTING:
            y, settled = descend(self._still(y, u), y, 0.0, self.judge)
            goal, branch = self._goal(y, u, place), "settled"
            if not settled:
                lost = self._found(
                    Walk(y, 0.0, False, ()), u, Journey(goal, goal, self._pose(y, u)[1], np.zeros(3), 0.0)
                )
                return replace(lost, message="with its tip held where the loads put it the base does not come to rest")
        elif left > RESTING and not rests:
            return self._near(y, u, Journey(goal, goal, wanted or self._pose(y, u)[1], np.zeros(3), turns))
        if not self._movable(y, u):
            y = self._bent(y, u, goal)
            goal = self._goal(y, u, goal)
            y, settled = descend(self._still(y, u), y, 0.0, self.judge)
            events.append(Event(0.0, "bifurcation", settled))
        place, frame = self._pose(y, u)
        turn = np.zeros(3) if wanted is None else wound((frame.inv() * wanted).as_rotvec(), frame, vector)
        journey = Journey(place, goal, frame, turn, turns)
        if events and not events[0].at_rest:
            return self._found(Walk(y, 0.0, False, tuple(events)), u, journey)
        found = walk(self.way(u, journey), y, self.judge)
        return self._found(Walk(found.y, found.t, found.success, (*events, *found.events)), u, journey, branch)

    def loaded(self, bare: FixedTip, held: FixedTipEquilibrium, u: Array) -> FixedTipEquilibrium:
        """Equilibrium under loads that grow in proportion from nothing while the tip is held.

        Args:
            bare: the same rod without loads.
            held: its equilibrium, from which the loads grow.
            u: inputs (n_inputs,) of the whole loads.
        """
        none, n = np.zeros(0), self.scene.n_strains
        y, _ = bare._held(bare.whitened.of(bare._search.scaled(held.state[:n])), none)
        place, frame = bare._pose(y, none)
        still = Journey(place, place, frame, np.zeros(3), 0.0)
        with_loads, without = self.way(u, still), bare.way(none, still)

        def way(y: Array, t: float) -> tuple[Array, Array, Array]:
            a, b = with_loads(y, 1.0)[:2], without(y, 1.0)[:2]
            force, stiffness = (t * one + (1.0 - t) * other for one, other in zip(a, b, strict=True))
            return force, stiffness, a[0] - b[0]

        return self._found(walk(way, y, self.judge), u, still, of="of the loads")

    def _still(self, y: Array, u: Array) -> Way:
        """The tip stays where it is with the unknowns ``y``."""
        place, frame = self._pose(y, u)
        return self.way(u, Journey(place, place, frame, np.zeros(3), 0.0))

    def _goal(self, y: Array, u: Array, place: Array) -> Array:
        """``place`` (3,) along the prescribed axes, where the tip is along the others."""
        goal = self._pose(y, u)[0]
        goal[self.axes] = place[self.axes]
        return goal

    def _near(self, y: Array, u: Array, journey: Journey) -> FixedTipEquilibrium:
        """The equilibrium near a guess, by Newton's method."""
        way, last = self.way(u, journey), np.inf
        for _ in range(60):
            force, stiffness, _ = way(y, 1.0)
            worst = float(np.abs(force).max())
            if not np.isfinite(worst) or (worst < 1e-12 or (worst < 1e-9 and worst >= last)):
                break
            try:
                step: Array = np.asarray(np.linalg.solve(stiffness, force), dtype=np.float64)
            except np.linalg.LinAlgError:
                break
            y, last = y + min(1.0, 1.0 / max(self.judge.size(step), 1e-300)) * step, worst
        stable = self.judge.stable(way(y, 1.0)[1])
        return self._found(Walk(y, 1.0, stable, ()), u, journey, "given")

    def _found(
        self, walked: Walk, u: Array, journey: Journey, branch: str = "followed", of: str = "of the way"
    ) -> FixedTipEquilibrium:
        n, of_x, y = self.scene.n_strains, self.whitened.sizes[0], walked.y
        pose = journey.at(1.0)
        errors = self._errors(y[:n] / of_x, y[n:], u, pose)[:2]
        residual = max(float(np.abs(np.asarray(e)).max()) for e in errors)
        met = bool(residual <= TOLERANCE)
        success = met and walked.success
        lost = [told(e, of) for e in walked.events]
        first = walked.events[0].at if walked.events else 1.0
        what = "the loads of the held rod could grow" if of == "of the loads" else "the tip could be moved"
        where = f"{what} {100.0 * walked.t:.0f} % {of}"
        if success:
            branch = "snapped" if lost else branch
            message = f"lost stability at {', '.join(lost)}; this is where it rests behind" if lost else ""
        elif branch == "given":
            message = "the equilibrium near the guess is unstable; leave guess out" if met else "none near the guess"
        else:
            message = f"{where}; lost stability at {', '.join(lost)}" if lost else where
        wrench = self._wrench(y[n:], pose[3:].reshape(3, 3, order="F"), np.zeros(3), np.zeros(3))
        state = self.scene.at_rest(self._search.strains(self.whitened.unknowns(y[:n])), u)
        if not success:
            message = "; ".join(filter(None, [message, doubt(self.scene, state, walked.t)]))
        return FixedTipEquilibrium(
            state,
            *wrench,
            success,
            residual,
            message,
            stable=walked.success,
            branch=branch if success else "unverified",
            load_factor=first if success or branch == "given" else min(first, walked.t),
            clamped=self.clamped,
            scene=self.scene,
        )
