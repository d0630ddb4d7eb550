"""A scene that moves in steps of ``dt``: trajectories, and the arm as a plant; what moves it is up to the scheme."""

from __future__ import annotations

import warnings
from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from pisplit.checks import Array, finite_array, positive
from pisplit.models.rod.analysis.fields import UNITS
from pisplit.models.rod.answers import Unresolved
from pisplit.models.rod.dynamics import motion_check
from pisplit.models.rod.dynamics.motion_check import SHARPER, reason
from pisplit.models.rod.dynamics.projection import Projection
from pisplit.models.rod.dynamics.space_error import SpaceError
from pisplit.models.rod.dynamics.trajectory import Trajectory
from pisplit.models.rod.equations.equations_of_motion import equations_of_motion
from pisplit.models.rod.sharing import Rebuilt, in_turn
from pisplit.models.rod.terms.base import joint_of

if TYPE_CHECKING:
    from pisplit.models.rod.scene import Scene
    from pisplit.models.rod.statics.resolution import Resolution

#: Rotation in rad of a ball joint at which motions end: its rotation vector is singular at 2 pi.
MOST_TURN = 6.0


@dataclass(frozen=True)
class Step:
    """One step of the arm as a plant.

    Attributes:
        state: measured fields (24 S,), see ``Fields``.
        ok: whether the integrator succeeded.
        message: why not, empty on success.
    """

    state: Array
    ok: bool
    message: str = ""


@dataclass(frozen=True)
class Snapshot:
    """All that the next steps of a plant depend on; may be copied, pickled and kept. See ``Propagation.restore``.

    Attributes:
        scheme: what moves the plant (``"IDAS"`` or ``"Gauss"``).
        names: of the inputs of its scene.
        state: [xi, xi_t, u]; empty where the plant was not at any state yet.
    """

    scheme: str
    names: tuple[str, ...]
    state: tuple[float, ...]


class Propagation(Rebuilt, ABC):
    """A scene that moves in steps of ``dt`` seconds.

    Subclasses advance the state; this class turns that into trajectories (``run``) and a plant (``reset``, ``step``).
    ``equations`` is the scene whose equations move it: see ``equations_of_motion``.

    A step depends on the state and the command alone, not on what was stepped before: copies, pickles and restored
    snapshots go on to the last bit. Calls from several threads wait for one another.

    Args:
        scene: what moves.
        dt: control interval in s.
        stations: number of stations or their arclengths in m, whose fields ``reset`` and ``step`` measure.
        balance: which equations move the scene: see ``equations_of_motion``.
    """

    #: Name of the scheme in messages.
    scheme: str
    #: Names of its counters in ``Trajectory.stats``.
    counters: tuple[str, ...]
    #: What makes its steps smaller, in warnings.
    remedy: str
    #: Internal steps at the start of a run that are checked without being asked: about a second of computing.
    checked_steps: int
    #: Whether waves that the steps do not resolve fade, as they do in the rod.
    damps_waves: bool

    def __init__(self, scene: Scene, dt: float, stations: int | ArrayLike, balance: str) -> None:
        self.scene = scene
        self.equations = equations_of_motion(scene, balance)
        self.dt = positive(dt, f"{type(self).__name__} dt", "s")
        self.field_map = scene.field_map(stations)
        self.projection = Projection.of(self.equations)
        self._state: Array | None = None

    @abstractmethod
    def integrate(self, start: Array, commands: Array, energy: bool = False) -> tuple[Array, dict[str, int]]:
        """States (T, n_moving) after each command, with the work (n_terms) of the terms if asked for.

        That is [xi, xi_t], of a scene with Maxwell branches [xi, xi_t, sigma].

        Args:
            start: state [xi, xi_t, u] (n_states,).
            commands: (T, n_inputs).
            energy: whether to add the work of every term since the start.

        Raises RuntimeError when the scheme gives up.
        """

    @abstractmethod
    def _on(self, scene: Scene, finer: float = 0.1) -> Propagation:
        """The same scheme on another grid of the scene, with errors in time of about ``finer`` of its own."""

    @property
    @abstractmethod
    def setting(self) -> tuple[object, ...]:
        """What tells simulators of one scene apart, of which checks of their motions hold."""

    @cached_property
    def finer(self) -> Propagation:
        """The same motion on two more nodes an element and with smaller errors in time, by which ``run`` checks."""
        return self._on(self.resolution.finer)

    @cached_property
    def sharper(self) -> Propagation:
        """The same motion on the same nodes with smaller errors in time, by which a first ``run`` is checked."""
        return self._on(self.scene, SHARPER)

    @cached_property
    def space_error(self) -> SpaceError:
        """Error of the grid of the equations in motion."""
        return SpaceError(self.resolution)

    @cached_property
    def resolution(self) -> Resolution:
        """Error of the grid of the equations at rest."""
        return self.equations.statics().resolution

    # Trajectories ----------------------------------------------------------------------------------------------------

    @in_turn("equations")
    def run(
        self, u: ArrayLike, x0: ArrayLike | None = None, energy: bool = False, check: bool | None = None
    ) -> Trajectory:
        """Trajectory under a sequence of commands; the plant stays where it is.

        Inputs that ramp start where ``x0`` has them and reach ``u[k]`` at the end of step k. An integrator that gives
        up ends the trajectory at the last good step (``success=False``); it never raises. An error above 1e-3 of the
        travel is warned of (``Unresolved``) where it is looked for, with the step from which on.

        Args:
            u: commands (T, n_inputs).
            x0: state [xi, xi_t, u] (n_states,) to start from, at rest under zero inputs when not given.
            energy: whether to integrate the work of every term along the way, for ``Trajectory.energy()``.
            check: True moves the scene once more on a finer grid in space and time (2 to 5 times the cost) for
                ``Trajectory.error``. None estimates both errors in the first run of a scene and in those that are
                longer, larger or rougher than the ones before, over their first 500 commands and, in time, 5000
                internal steps (a stepper: 1000; 2 to 4 times the cost of these). False looks for nothing.

        Raises ValueError for arrays of another shape or with entries that are not finite.
        """
        commands = self.scene.checked_inputs(u, "u", (None, self.scene.n_inputs))
        if len(commands) == 0:
            raise ValueError("u has no rows; give at least one command")
        start = self._rest(None) if x0 is None else self._started(x0)
        try:
            states, stats = self.integrate(start, commands, energy)
            message = ""
        except RuntimeError:
            states, stats, message = self._as_far_as_possible(start, commands, energy)
        states, lost = self._put_back(states, commands)
        message = lost or message
        done, size = len(states), self.scene.layout.n_moving
        found = Trajectory(
            t=self.dt * np.arange(done + 1, dtype=np.float64),
            x=np.vstack([start, np.hstack([states[:, :size], commands[:done]])]),
            u=commands[:done].copy(),
            success=not message,
            message=message,
            stats=stats,
            scene=self.equations,
            work=np.vstack([np.zeros(states.shape[1] - size), states[:, size:]]) if energy else None,
        )
        found, told = self._completed(found), ""
        error = None
        if check:
            error, told = motion_check.checked(self, found)
        elif check is None and done > 1 and motion_check.is_new(self, found):
            error, told = motion_check.checked_first(self, found)
        found = replace(found, error=error)
        if told:
            warnings.warn(told, Unresolved, stacklevel=3)
        return found

    def _as_far_as_possible(self, start: Array, commands: Array, energy: bool) -> tuple[Array, dict[str, int], str]:
        """Step by step until a step fails."""
        size = self.scene.layout.n_moving
        width = size + (len(self.scene.terms) if energy else 0)
        states: list[Array] = []
        total = dict.fromkeys(self.counters, 0)
        state, work = start, np.zeros(width - size)
        for k, command in enumerate(commands):
            try:
                found, stats = self.integrate(state, command[None, :], energy)
                found, lost = self._put_back(found, command[None, :])
                if lost:
                    raise RuntimeError(lost)
            except RuntimeError as error:
                message = f"{self.scheme} gave up in step {k} at t = {k * self.dt:g} s: {reason(error)}"
                return np.array(states).reshape(len(states), width), total, message
            work = work + found[0, size:]
            states.append(np.concatenate([found[0, :size], work]))
            state = np.concatenate([found[0, :size], command])
            total = {name: total[name] + stats[name] for name in total}
        return np.array(states), total, ""

    def _completed(self, found: Trajectory) -> Trajectory:
        """``found`` with what the scheme knows of its last integration."""
        return found

    # The arm as a plant ----------------------------------------------------------------------------------------------

    @property
    def n_inputs(self) -> int:
        """Number of input entries."""
        return self.scene.n_inputs

    @property
    def n_states(self) -> int:
        """Number of measured entries: 24 fields at every station."""
        return len(self.field_map.names)

    @property
    def state_names(self) -> tuple[str, ...]:
        """Names of the measured entries (24 S,)."""
        return self.field_map.names

    @property
    def state_units(self) -> tuple[str, ...]:
        """Their units."""
        return tuple(UNITS[quantity] for quantity in self.field_map.quantities)

    @property
    def input_names(self) -> tuple[str, ...]:
        """Names of the inputs (n_inputs,)."""
        return self.scene.input_names

    @property
    def input_units(self) -> tuple[str, ...]:
        """Their units, empty where a term does not tell."""
        return self.scene.input_units

    @property
    def state(self) -> Array:
        """Present state [xi, xi_t, u] of the plant: a copy."""
        return self._present().copy()

    @in_turn("equations")
    def reset(self, u0: ArrayLike | None = None, x0: ArrayLike | None = None) -> Array:
        """Go to rest, or to a given state; the measured fields (24 S,).

        Args:
            u0: inputs (n_inputs,) under which the arm rests, zeros when not given.
            x0: state [xi, xi_t, u] (n_states of the scene,) to go to instead.

        Raises ValueError where both are given, RuntimeError where no rest position is found.
        """
        if x0 is None:
            state = self._rest(u0)
        elif u0 is None:
            state = self._started(x0)
        else:
            raise ValueError("reset takes u0 (rest under inputs) or x0 (any state [xi, xi_t, u]); both are given")
        measured = self._measure(state)
        self._state = state
        return measured

    @in_turn("equations")
    def step(self, u: ArrayLike) -> Step:
        """Apply one command ``u`` (n_inputs,) over ``dt`` and measure. A failed step leaves the plant where it was.

        Raises RuntimeError before the first ``reset``.
        """
        command = self.scene.checked_inputs(u, "u", (self.scene.n_inputs,))
        try:
            found, _ = self.integrate(self._present(), command[None, :])
            found, lost = self._put_back(found, command[None, :])
            if lost:
                raise RuntimeError(lost)
            state = np.concatenate([found[0], command])
            measured = self._measure(state)
        except (RuntimeError, ValueError) as error:
            return Step(self._measure(self._present()), False, f"{self.scheme} gave up: {reason(error)}")
        self._state = state
        return Step(measured, True)

    @in_turn("equations")
    def snapshot(self) -> Snapshot:
        """What ``restore`` needs to go on from here to the last bit, also in another process."""
        state = () if self._state is None else tuple(self._state.tolist())
        return Snapshot(self.scheme, self.scene.input_names, state)

    @in_turn("equations")
    def restore(self, snapshot: Snapshot) -> None:
        """Put the plant where it was when ``snapshot`` was taken, of this plant or of one made alike.

        Raises ValueError for a snapshot of a plant of another scheme, with other inputs or another number of states,
        and for one whose tip is not where this one holds it.
        """
        if not isinstance(snapshot, Snapshot):
            raise ValueError(f"restore takes what snapshot() gave; got {type(snapshot).__name__}")
        if snapshot.scheme != self.scheme or snapshot.names != self.scene.input_names:
            raise ValueError(
                f"the snapshot is of a plant moved by {snapshot.scheme} with inputs {snapshot.names}; "
                f"this one is moved by {self.scheme} with inputs {self.scene.input_names}"
            )
        if snapshot.state and len(snapshot.state) != self.scene.n_states:
            raise ValueError(
                f"the snapshot holds {len(snapshot.state)} states; the scene of this plant has {self.scene.n_states}"
            )
        state = np.array(snapshot.state) if snapshot.state else None
        if state is not None and self.projection is not None:
            self.projection.state(state, "the snapshot")
        self._state = state

    def _started(self, x0: ArrayLike) -> Array:
        """A state to start from; where the tip is held, one that meets what is prescribed there."""
        start = finite_array(x0, "x0", (self.scene.n_states,)).copy()
        return start if self.projection is None else self.projection.state(start)

    def _put_back(self, rows: Array, commands: Array) -> tuple[Array, str]:
        """``rows`` (T, n_moving or more) after commands with the tip where it is held, if it is.

        They end where it cannot be put there; why is the second value.
        """
        if self.projection is None:
            return self._before_a_turn(rows)
        size, placed = self.scene.layout.n_moving, rows.copy()
        for k, row in enumerate(rows):
            at = f"the state after step {k}"
            try:
                placed[k, :size] = self.projection.state(np.concatenate([row[:size], commands[k]]), at)[:size]
            except ValueError as error:
                return placed[:k], f"{self.scheme} lost the tip: {error}"
        return self._before_a_turn(placed)

    def _before_a_turn(self, rows: Array) -> tuple[Array, str]:
        """``rows`` up to where a ball joint at the base has almost made a turn, if there is one, and why they end."""
        base = joint_of(self.scene.terms)
        if base is None or base.hinge != "ball":
            return rows, ""
        turns = rows[:, self.scene.layout.joint][:, -3:]
        far = np.linalg.norm(turns, axis=1) > MOST_TURN
        if not far.any():
            return rows, ""
        k = int(far.argmax())
        return rows[
            :k
        ], f"the ball joint at the base makes a turn in step {k}, which its rotation vector cannot go through"

    def _present(self) -> Array:
        if self._state is None:
            raise RuntimeError("the plant has no state yet; call reset() first")
        return self._state

    def _measure(self, state: Array) -> Array:
        return self.field_map.evaluate(state).ravel()

    def _rest(self, u0: ArrayLike | None) -> Array:
        equilibrium = self.equations.statics().solve(u0)
        if not equilibrium.success:
            raise RuntimeError(f"no rest position to start from: {equilibrium.message}")
        return equilibrium.state
