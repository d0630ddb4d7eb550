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
from pisplit.models.rod.dynamics.equations_of_motion import equations_of_motion
from pisplit.models.rod.dynamics.motion_error import motion_error
from pisplit.models.rod.dynamics.trajectory import Trajectory
from pisplit.models.rod.sharing import Rebuilt, in_turn

if TYPE_CHECKING:
    from pisplit.models.rod.scene import Scene
    from pisplit.models.rod.statics.resolution import Resolution

#: Error of a motion, in parts of its travel, above which a run that is checked warns, and least one in parts of L.
ALLOWED, LEAST = 1e-3, 1e-7


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

    def __init__(self, scene: Scene, dt: float, stations: int | ArrayLike, balance: str) -> None:
        self.scene = scene
        self.equations = equations_of_motion(scene, balance)
        self.dt = positive(dt, f"{type(self).__name__} dt", "s")
        self.field_map = scene.field_map(stations)
        self._state: Array | None = None

    @abstractmethod
    def _integrate(self, start: Array, commands: Array, energy: bool = False) -> tuple[Array, dict[str, int]]:
        """States [xi, xi_t] after each command, with the work (n_terms) of the terms since the start when asked for.

        Raises RuntimeError when the scheme gives up.
        """

    @abstractmethod
    def _on(self, scene: Scene) -> Propagation:
        """The same scheme with smaller errors in time on another grid of the scene."""

    @cached_property
    def finer(self) -> Propagation:
        """The same motion on two more nodes an element and with smaller errors in time, by which ``run`` checks."""
        return self._on(self._resolution.finer)

    @cached_property
    def _resolution(self) -> Resolution:
        return self.equations.statics().resolution

    # Trajectories ----------------------------------------------------------------------------------------------------

    @in_turn("equations")
    def run(self, u: ArrayLike, x0: ArrayLike | None = None, energy: bool = False, check: bool = False) -> Trajectory:
        """Trajectory under a sequence of commands; the plant stays where it is.

        Inputs that ramp start where ``x0`` has them and reach ``u[k]`` at the end of step k. An integrator that gives
        up ends the trajectory at the last good step (``success=False``); it never raises.

        Args:
            u: commands (T, n_inputs).
            x0: state [xi, xi_t, u] (n_states,) to start from, at rest under zero inputs when not given.
            energy: whether to integrate the work of every term along the way, for ``Trajectory.energy()``.
            check: whether to move the scene once more on a finer grid in space and time (2 to 5 times the cost) for
                ``Trajectory.error``; above 1e-3 of the travel it warns (``Unresolved``) and names the step.

        Raises ValueError for arrays of another shape or with entries that are not finite.
        """
        commands = self.scene.checked_inputs(u, "u", (None, self.scene.n_inputs))
        if len(commands) == 0:
            raise ValueError("u has no rows; give at least one command")
        start = self._rest(None) if x0 is None else finite_array(x0, "x0", (self.scene.n_states,))
        try:
            states, stats = self._integrate(start, commands, energy)
            success, message = True, ""
        except RuntimeError:
            states, stats, message = self._as_far_as_possible(start, commands, energy)
            success = not message
        done, size = len(states), 2 * self.scene.n_strains
        found = Trajectory(
            t=self.dt * np.arange(done + 1, dtype=np.float64),
            x=np.vstack([start, np.hstack([states[:, :size], commands[:done]])]),
            u=commands[:done].copy(),
            success=success,
            message=message,
            stats=stats,
            scene=self.equations,
            work=np.vstack([np.zeros(states.shape[1] - size), states[:, size:]]) if energy else None,
        )
        return self._checked(found) if check else found

    def _checked(self, found: Trajectory) -> Trajectory:
        """``found`` with its error; warns where that is large, or where there is nothing to compare with."""
        start = self._resolution.on_finer(found.x[0])
        finer = self.finer.run(found.u, start) if len(found.u) else None
        if finer is None or not finer.success:
            why = "it has no steps" if finer is None else f"the finer motion ends: {finer.message}"
            warnings.warn(f"the motion cannot be checked: {why}", Unresolved, stacklevel=4)
            return found
        error = motion_error(found, finer)
        step = error.first_above(ALLOWED, LEAST * self.scene.rod.length)
        if step is not None:
            warnings.warn(
                f"the motion is off by {error.of_travel:.1g} of its travel, by more than {ALLOWED:g} from step {step} "
                f"(t = {step * self.dt:g} s) on; {self.remedy}, or more nodes than {self.scene.nodes}",
                Unresolved,
                stacklevel=4,
            )
        return replace(found, error=error)

    def _as_far_as_possible(self, start: Array, commands: Array, energy: bool) -> tuple[Array, dict[str, int], str]:
        """Step by step until a step fails."""
        size = 2 * self.scene.n_strains
        width = size + (len(self.scene.terms) if energy else 0)
        states: list[Array] = []
        total = dict.fromkeys(self.counters, 0)
        state, work = start, np.zeros(width - size)
        for k, command in enumerate(commands):
            try:
                found, stats = self._integrate(state, command[None, :], energy)
            except RuntimeError as error:
                message = f"{self.scheme} gave up in step {k} at t = {k * self.dt:g} s: {_reason(error)}"
                return np.array(states).reshape(len(states), width), total, message
            work = work + found[0, size:]
            states.append(np.concatenate([found[0, :size], work]))
            state = np.concatenate([found[0, :size], command])
            total = {name: total[name] + stats[name] for name in total}
        return np.array(states), total, ""

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
            state = finite_array(x0, "x0", (self.scene.n_states,)).copy()
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
            found, _ = self._integrate(self._present(), command[None, :])
            state = np.concatenate([found[0], command])
            measured = self._measure(state)
        except (RuntimeError, ValueError) as error:
            return Step(self._measure(self._present()), False, f"{self.scheme} gave up: {_reason(error)}")
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

        Raises ValueError for a snapshot of a plant of another scheme, with other inputs or another number of states.
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
        self._state = np.array(snapshot.state) if snapshot.state else None

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


def _reason(error: Exception) -> str:
    """The part of CasADi's message that names the failure."""
    text = str(error)
    start = text.find("returned")
    return text[start:].split(".")[0] if start >= 0 else text.strip().splitlines()[-1]
