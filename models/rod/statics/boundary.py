"""Equilibria with the tip pinned or clamped: the wrench at the tip is part of the solution."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from pisplit.checks import Array, finite_array
from pisplit.models.rod.sharing import Rebuilt
from pisplit.models.rod.statics.branch import RESTING, told
from pisplit.models.rod.statics.certificate import without_energy
from pisplit.models.rod.statics.descent import descend
from pisplit.models.rod.statics.fixed_tip import FixedTipEquilibrium
from pisplit.models.rod.statics.flutter import Flutter, Vibration
from pisplit.models.rod.statics.held import HeldJudge
from pisplit.models.rod.statics.held_balance import UNIT, HeldBalance
from pisplit.models.rod.statics.held_resolution import HeldResolution
from pisplit.models.rod.statics.journey import Journey, checked_rotation, rotations, wound
from pisplit.models.rod.statics.path import Event, Walk, walk
from pisplit.models.rod.statics.search import TOLERANCE
from pisplit.models.rod.statics.twisted import doubt
from pisplit.models.rod.statics.whitened import Way

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

    from pisplit.models.rod.statics.search import Search
    from pisplit.models.rod.statics.whitened import Whitened

#: Least singular value of the conditions, in parts of the largest, at which the tip can be moved in every direction.
MOVABLE = 1e-4
#: Share of the way of a straight rod to its place that its first bend takes, and the largest bend [rad].
FIRST_WAY, FIRST_BEND = 0.1, 0.5
#: Stiffness that is added where a deformation may cost nothing.
NEUTRAL = 1e-6
#: Step of differences along the way.
STEP = 1e-5


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
        self.scene = whitened.search.scene
        self._balance = HeldBalance(self.scene, clamped, axes)
        self.clamped, self.axes = clamped, self._balance.axes

    @cached_property
    def judge(self) -> HeldJudge:
        """Tells stable shapes."""
        return HeldJudge(not without_energy(self.scene), self.scene.n_strains)

    @cached_property
    def _search(self) -> Search:
        return self.whitened.search

    @cached_property
    def _resolution(self) -> HeldResolution:
        """Tells whether the nodes are enough, with the tip held where it is."""
        return HeldResolution(self.scene, self._balance)

    def error(self, state: Array) -> float:
        """Estimated error of the grid at a ``state`` (n_states,) at rest whose tip is held: see ``Resolution``."""
        return self._resolution.error(state)

    def check(self, found: FixedTipEquilibrium) -> None:
        """Warn if the nodes do not resolve what was ``found``."""
        if found.success:
            self._resolution.check(found.state[None])

    def way(self, u: Array, journey: Journey) -> Way:
        """The tip goes along a ``journey`` under inputs ``u`` (n_inputs,)."""
        of_x, of_residual, of_slopes = self.whitened.sizes
        n = len(of_x)

        def way(y: Array, t: float) -> tuple[Array, Array, Array]:
            x, many = y[:n] / of_x, y[n:]
            residual, off, h, j, g = (np.asarray(v) for v in self._balance.errors(x, many, u, journey.at(t)))
            force = np.concatenate([of_residual * residual.ravel(), UNIT * off.ravel()])
            slopes = -np.block(
                [[of_slopes * h, of_residual[:, None] * j], [UNIT * g / of_x, np.zeros((len(off), len(off)))]]
            )
            ahead, behind = (self._balance.errors(x, many, u, journey.at(t + d))[:2] for d in (STEP, -STEP))
            changes = [np.asarray(a - b).ravel() / (2.0 * STEP) for a, b in zip(ahead, behind, strict=True)]
            return force, slopes, np.concatenate([of_residual * changes[0], UNIT * changes[1]])

        return way

    # Where the way starts --------------------------------------------------------------------------------------------

    def _pose(self, y: Array, u: Array) -> tuple[Array, Rotation]:
        n = self.scene.n_strains
        state = self.scene.at_rest(self._search.strains(self.whitened.unknowns(y[:n])), u)
        place, frame = self._balance.pose(state)
        return place, rotations().from_matrix(frame)

    def _held(self, y: Array, u: Array) -> tuple[Array, float]:
        """Unknowns at the strains ``y`` with the multipliers that hold them best, and the force that is left."""
        n = len(y)
        whole = np.concatenate([y, np.zeros(self._balance.n_held)])
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

    def _vibration(self, y: Array, u: Array, journey: Journey) -> Vibration | None:
        """The vibration that grows about ``y`` at the end of a ``journey`` under ``u`` (n_inputs,), or None."""
        if self.judge.has_energy:
            return None
        n, stiffness = self.scene.n_strains, self.way(u, journey)(y, 1.0)[1]
        along = self.judge.basis(stiffness)
        across = np.linalg.svd(stiffness[:n, n:])[0][:, n - along.shape[1] :]
        return self._flutter.under(y[:n], u, stiffness[:n, :n], along, across)

    @cached_property
    def _flutter(self) -> Flutter:
        """Tells shapes about which vibrations grow that leave the tip in its place."""
        return Flutter(self.whitened)

    def _found(
        self, walked: Walk, u: Array, journey: Journey, branch: str = "followed", of: str = "of the way"
    ) -> FixedTipEquilibrium:
        n, of_x, y = self.scene.n_strains, self.whitened.sizes[0], walked.y
        pose = journey.at(1.0)
        errors = self._balance.errors(y[:n] / of_x, y[n:], u, pose)[:2]
        residual = max(float(np.abs(np.asarray(e)).max()) for e in errors)
        met = bool(residual <= TOLERANCE)
        vibration = self._vibration(y, u, journey) if met and walked.success else None
        success = met and walked.success and vibration is None
        lost = [told(e, of) for e in walked.events]
        first = walked.events[0].at if walked.events else 1.0
        what = "the loads of the held rod could grow" if of == "of the loads" else "the tip could be moved"
        where = f"{what} {100.0 * walked.t:.0f} % {of}"
        if success:
            branch = "snapped" if lost else branch
            message = f"lost stability at {', '.join(lost)}; this is where it rests behind" if lost else ""
        elif vibration is not None:
            message = "; ".join([f"lost stability at {event}" for event in lost] + [f"it flutters: {vibration}"])
        elif branch == "given":
            message = "the equilibrium near the guess is unstable; leave guess out" if met else "none near the guess"
        else:
            message = f"{where}; lost stability at {', '.join(lost)}" if lost else where
        wrench = self._balance.wrench(y[n:], pose[3:].reshape(3, 3, order="F"), np.zeros(3), np.zeros(3))
        state = self.scene.at_rest(self._search.strains(self.whitened.unknowns(y[:n])), u)
        if not success and vibration is None:
            message = "; ".join(filter(None, [message, doubt(self.scene, state, walked.t)]))
        return FixedTipEquilibrium(
            state,
            *wrench,
            success,
            residual,
            message,
            stable=walked.success and vibration is None,
            branch=branch if success else "unverified" if vibration is None else "flutters",
            load_factor=first if success or branch == "given" else min(first, walked.t),
            clamped=self.clamped,
            scene=self.scene,
        )
