"""Dynamics by large collocation steps that damp what they cannot follow, a whole run as one call, steps checked."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from pisplit.checks import Array, positive
from pisplit.mapping import Buffered, Mapped
from pisplit.models.rod.dynamics.collocation import Collocation
from pisplit.models.rod.dynamics.march import March, Piece
from pisplit.models.rod.dynamics.motion_check import reason
from pisplit.models.rod.dynamics.pieces import MAX_HALVINGS, SMALL_DEFECT, Pieces, Step
from pisplit.models.rod.dynamics.simplified import SimplifiedNewton
from pisplit.models.rod.dynamics.stepper import Stepper
from pisplit.models.rod.dynamics.trajectory import Trajectory

if TYPE_CHECKING:
    from pisplit.models.rod.dynamics.integrator import Simulator
    from pisplit.models.rod.scene import Scene

#: Newton corrections of a step, all with one matrix, at least and at most.
CORRECTIONS = (3, 6)
#: Last correction of the strains in parts of their nominal size up to which a step converged.
CONVERGED = 1e-3
#: Control intervals that one call takes, at most: it ends with the first that does not pass.
CALL = 32
#: Intervals that are not tried whole, at most, behind some that did not converge so.
LONGEST_WAIT = 8
#: Points along the rod at which shapes are compared.
POINTS = 6


@dataclass
class _Taken:
    """Intervals of a run as they were taken: states and estimated errors in m, numbers of those that needed more.

    ``cuts``: where the last of those that were halved was cut, in parts of it. ``misses``: intervals one behind the
    other that did not converge in one step.
    """

    rows: list[Array] = field(default_factory=list)
    errors: list[float] = field(default_factory=list)
    halved: list[int] = field(default_factory=list)
    idas: list[int] = field(default_factory=list)
    steps: int = 0
    message: str = ""
    cuts: list[float] = field(default_factory=lambda: [0.0])
    misses: int = 0


class FastStepper(Stepper):
    """Motion of a scene in few large Radau steps, up to 32 of them in one CasADi call: for data, loops and predictions.

    Every step starts from zero accelerations and takes three to six Newton corrections with one matrix. The last one
    and its defect, what the balance misses at the start of the step in terms of strains, say whether it is taken: the
    step with the largest defect of every call is done again in two halves, which tells what a defect is worth in
    metres; intervals with a large defect or an error of more than ``accuracy`` L, and those that do not converge, are
    taken in halves, quarters and so on (``Pieces``), and by IDAS where that fails.
    ``Trajectory.fallbacks`` names them. A single ``step`` is judged by its defect alone, so that it depends on state
    and command only.

    Radau IIA steps (order 3 or 5) damp the modes that are too fast for them, which Gauss steps keep as a ripple from
    step to step.

    Source: Hairer and Wanner, *Solving Ordinary Differential Equations II* (1996), section IV.5.

    Args:
        scene: what moves.
        dt: control interval in s.
        step: internal step in s, at most; one a control interval when not given.
        stages: 2 or 3.
        accuracy: largest estimated error of the shape after one step, in parts of the length.
        stations: stations whose fields ``reset`` and ``step`` measure (see ``Fields``).
        balance: ``"auto"``, ``"direct"`` or ``"variational"`` equations: see ``equations_of_motion``.
    """

    scheme = "fast Radau"
    counters = ("nsteps", "halved", "idas")

    def __init__(
        self,
        scene: Scene,
        dt: float,
        step: float | None = None,
        stages: int = 3,
        accuracy: float = 3e-5,
        stations: int | ArrayLike = 6,
        balance: str = "auto",
    ) -> None:
        super().__init__(scene, dt, dt if step is None else step, stages, stations=stations, balance=balance)
        self.accuracy = positive(accuracy, "FastStepper accuracy")
        if self.stages < 2:
            raise ValueError(f"FastStepper stages = {stages}; expected 2 or 3")
        self._last = _Taken()

    @property
    def setting(self) -> tuple[object, ...]:
        return (*super().setting, self.accuracy)

    def _on(self, scene: Scene, finer: float = 0.1) -> FastStepper:
        half = self.dt / (2 * self.substeps)
        return FastStepper(scene, self.dt, half, self.stages, finer * self.accuracy, balance=self.balance)

    @cached_property
    def collocation(self) -> Collocation:
        """The functions of one internal step."""
        return Collocation(self.equations, self.stages, "radau")

    # One step --------------------------------------------------------------------------------------------------------

    @cached_property
    def one(self) -> ca.Function:
        """``(x, u0, u1, h) -> end, last correction, defect`` of one step; sizes as in ``Collocation``."""
        scheme, scene = self.collocation, self.equations
        n, s = scene.n_strains, scheme.stages
        x, u0, u1, h, _ = scheme.symbols
        residual = scene.native(scene.motion_residual)
        newton = SimplifiedNewton(scheme)
        inverses = newton.inverses(x, u0, u1, h)
        z, size = newton.converged(x, u0, u1, h, ca.MX(n, s), inverses, CORRECTIONS)
        end = scheme.end(x, z, h)
        # The residual at the start as a force that acts over the step: how far it would bend the rod.
        first = z @ ca.DM(np.linalg.solve(np.vander(scheme.c).T, np.eye(s)[-1]))
        missed = residual(x[:n], x[n : 2 * n], first, ca.vertcat(x[2 * n :], u0))
        bent = newton.applied(inverses, ca.repmat(missed, 1, s)) @ (scheme.b @ scheme.a)
        defect = h * h * ca.norm_2(bent / ca.DM(scene.nominal_strains)) / np.sqrt(scene.nodes)
        return ca.Function("one", [x, u0, u1, h], [end, size, defect])

    @cached_property
    def _one(self) -> Buffered:
        """``one`` without conversions."""
        return Buffered(self.one)

    @cached_property
    def _interval(self) -> ca.Function:
        """``([x, u], command) -> [x, u], [x; correction; defect], passes`` of one control interval."""
        layout = self.equations.layout
        state, command = ca.MX.sym("state", layout.size), ca.MX.sym("command", layout.n_inputs)
        x, before, sizes = state[layout.moving], state[layout.inputs], []
        for k in range(self.substeps):
            u0, u1 = (before + (command - before) * ((k + j) / self.substeps) for j in (0, 1))
            x, *found = self.one(x, u0, u1, self.dt / self.substeps)
            sizes.append(found)
        # a sum, unlike a maximum, passes NaN on, and nothing is as small as NaN
        correction, defect = (sum(column) for column in zip(*sizes, strict=True))
        passes = ca.logic_and(correction <= CONVERGED * self.substeps, defect <= SMALL_DEFECT * self.substeps)
        results = [ca.vertcat(x, command), ca.vertcat(x, correction, defect), passes]
        return ca.Function("interval", [state, command], results)

    @cached_property
    def _calls(self) -> dict[int, Buffered]:
        """One interval and ``CALL`` of them: ``([1, x, u], [1, commands]) -> [passes, x, u], [x; correction; defect]``.

        Intervals behind one that does not pass, and those with 0 before their command, are not taken.
        """
        layout = self.equations.layout
        state, command = ca.MX.sym("state", layout.size), ca.MX.sym("command", layout.n_inputs)
        skipped = ca.Function("skipped", [state, command], [state, ca.MX.inf(layout.n_moving + 2), ca.MX(0)])
        either = ca.Function.if_else("either", self._interval, skipped)
        at, asked = ca.MX.sym("at", 1 + layout.size), ca.MX.sym("asked", 1 + layout.n_inputs)
        end, row, passes = either(at[0] * asked[0], at[1:], asked[1:])
        step = ca.Function("step", [at, asked], [ca.vertcat(passes, end), row])
        return {size: Buffered(step.mapaccum(size)) for size in (1, CALL)}

    @cached_property
    def _idas(self) -> Simulator:
        return self.scene.simulator(self.dt, balance=self.balance)

    @cached_property
    def _shape(self) -> Mapped:
        """``(xi, u) -> `` positions in m (3 POINTS) along the rod."""
        scene = self.equations
        xi, u, balance = scene.static_balance
        points = (scene.rod.length * np.arange(1, POINTS + 1) / POINTS).tolist()
        return Mapped(ca.Function("shape", [xi, u], [ca.vec(balance.motion.position_at(points))]))

    def _distance(self, x: Array, y: Array, u: Array) -> float:
        """Largest distance in m of two shapes [xi, xi_t] under the inputs ``u``, infinite where one is none."""
        n = self.equations.n_strains
        there, here = self._shape(np.stack([x[:n], y[:n]]), np.stack([u, u]))
        found = float(np.linalg.norm((there - here).reshape(POINTS, 3), axis=1).max())
        return found if np.isfinite(found) else np.inf

    # Trajectories ----------------------------------------------------------------------------------------------------

    def integrate(self, start: Array, commands: Array, energy: bool = False) -> tuple[Array, dict[str, int]]:
        """States (T, n_moving) after each command: see ``Propagation.integrate``; the work of terms takes small steps.

        Args:
            start: state [xi, xi_t, u] (n_states,).
            commands: (T, n_inputs).
            energy: whether to add the work of every term since the start.
        """
        if energy:
            rows, stats = super().integrate(start, commands, energy=True)
            self._last = _Taken()
            return rows, {"nsteps": stats["nsteps"], "halved": stats["halvings"], "idas": 0}
        states, found, message = self._as_far_as_possible(start, commands, False)
        if message:
            raise RuntimeError(message)
        return states, found

    def _as_far_as_possible(self, start: Array, commands: Array, energy: bool) -> tuple[Array, dict[str, int], str]:
        if energy:
            return super()._as_far_as_possible(start, commands, energy)
        layout = self.scene.layout
        taken = self._last = _Taken()
        x, before, depth, wait = start[layout.moving], start[layout.inputs], 0, 0
        while len(taken.rows) < len(commands) and not taken.message:
            k = len(taken.rows)
            ahead = commands[k : k + CALL]
            good, whole, halves = self._together(taken, x, before, ahead) if wait == 0 else (0, None, 1)
            if wait == 0:
                wait = min(taken.misses * (taken.misses - 1), LONGEST_WAIT) if good < len(ahead) else 0
            else:
                wait -= 1
            if good:
                x, before = taken.rows[-1], ahead[good - 1]
            if good < len(ahead):
                depth = self._alone(taken, x, before, ahead[good], max(depth, halves), whole)
                x, before = taken.rows[-1] if taken.rows else x, ahead[good]
        stats = {"nsteps": taken.steps, "halved": len(taken.halved), "idas": len(taken.idas)}
        return np.array(taken.rows).reshape(len(taken.rows), layout.n_moving), stats, taken.message

    def _together(self, taken: _Taken, x: Array, before: Array, commands: Array) -> tuple[int, Step | None, int]:
        """How many of the first ``commands`` pass in one call; their states are appended.

        And of the one behind them, where it went in one step, if that converged, and how often it has to be halved at
        least.
        """
        moving, size = self.scene.layout.moving, len(commands)
        length = 1 if size == 1 else CALL
        asked = np.zeros((length, 1 + commands.shape[1]))
        asked[:size, 0], asked[:size, 1:] = 1.0, commands
        try:
            _, found = self._calls[length](np.concatenate([[1.0], x, before]), asked)
        except RuntimeError:  # a singular matrix, somewhere
            if size == 1:
                return 0, None, 0
            half = size // 2
            good, whole, halves = self._together(taken, x, before, commands[:half])
            if good < half:
                return good, whole, halves
            more, whole, halves = self._together(taken, taken.rows[-1], commands[half - 1], commands[half:])
            return half + more, whole, halves
        rows = found.reshape(length, -1)[:size].copy()
        states, corrections, defects = rows[:, moving], rows[:, -2], rows[:, -1]
        with np.errstate(invalid="ignore"):
            passes = (corrections <= CONVERGED * self.substeps) & (defects <= SMALL_DEFECT * self.substeps)
        good = size if passes.all() else int(np.argmin(passes))
        errors, halves = np.zeros(good), 0
        if size > 1 and good:
            worst = int(np.argmax(defects[:good]))
            at, u = (x, before) if worst == 0 else (states[worst - 1], commands[worst - 1])
            end = self._finer(at, u, commands[worst])
            error = np.inf if end is None else self._distance(end, states[worst], commands[worst])
            errors = error * defects[:good] / max(float(defects[worst]), 1e-300)
            over = errors > self.accuracy * self.scene.rod.length
            good = int(np.argmax(over)) if over.any() else good
            halves = int(over.any() and good == worst)
        taken.misses = 0 if good else taken.misses
        taken.rows += list(states[:good])
        taken.errors += errors[:good].tolist()
        taken.steps += good * self.substeps
        if good == size or halves or self.substeps > 1:
            return good, None, halves
        if not corrections[good] <= CONVERGED:
            taken.misses += 1
            return good, None, 1
        taken.misses = 0
        return good, Step(states[good], float(defects[good])), 0

    def _finer(self, x: Array, before: Array, command: Array) -> Array | None:
        """[xi, xi_t] after an interval in steps of half the length, or None where one of them does not converge."""
        pieces = 2 * self.substeps
        for k in range(pieces):
            u0, u1 = (before + (command - before) * (k + j) / pieces for j in (0, 1))
            found = self._step(x, u0, u1, self.dt / pieces)
            if found is None:
                return None
            x = found.end
        return x

    def _step(self, x: Array, u0: Array, u1: Array, h: float) -> Step | None:
        try:
            end, correction, defect = self._one(x, u0, u1, np.array([h]))
        except RuntimeError:
            return None
        return Step(end.copy(), float(defect[0])) if correction[0] <= CONVERGED else None

    def _alone(self, taken: _Taken, x: Array, before: Array, command: Array, depth: int, whole: Step | None) -> int:
        """One interval that did not pass, in pieces, first of ``dt / 2^depth``, or by IDAS; the last depth."""
        k = len(taken.rows)
        start = np.concatenate([x, before])
        try:
            coarsest = (self.substeps - 1).bit_length()  # no step is longer than was asked for
            pieces = Pieces(self._step, self._distance, self.dt, self.accuracy * self.scene.rod.length, coarsest)
            walk = pieces.through(x, (before, command), depth, whole)
            end, error, steps, depth = walk.end, walk.error, len(walk.cuts) - 1, walk.depth
            taken.cuts = walk.cuts
            taken.halved.append(k)
        except RuntimeError as too_rough:
            try:
                states, stats = self._idas.integrate(start, command[None, :])
            except RuntimeError as failure:
                taken.message = (
                    f"{self.scheme} gave up in step {k} at t = {k * self.dt:g} s: {too_rough}; "
                    f"and so did IDAS: {reason(failure)}"
                )
                return depth
            end, error, steps, depth = states[0, : len(x)], 0.0, stats["nsteps"], 0
            taken.idas.append(k)
        taken.rows.append(end)
        taken.errors.append(error)
        taken.steps += steps
        return depth

    def _pieces(self, start: Array, command: Array) -> tuple[Array, list[Piece]]:
        """As ``integrate`` takes the step; where IDAS takes it, the derivatives are those of steps of ``dt / 512``."""
        states, stats = self.integrate(start, command[None, :])
        layout, at = self.scene.layout, np.arange(self.substeps + 1) / self.substeps
        if stats["idas"]:
            at = np.arange((1 << MAX_HALVINGS) + 1) / (1 << MAX_HALVINGS)
        elif stats["halved"]:
            at = np.array(self._last.cuts)
        march = March(self.collocation, self.tolerance)
        return states[0], march.cut(start[layout.moving], start[layout.inputs], command, self.dt, at)

    def _completed(self, found: Trajectory) -> Trajectory:
        taken = self._last
        if len(taken.errors) != len(found.u):
            return found
        fallbacks = {"halved": tuple(taken.halved), "IDAS": tuple(taken.idas)}
        return replace(found, step_errors=np.array(taken.errors), fallbacks=fallbacks)
