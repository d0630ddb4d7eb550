"""Motions of a scene in steps of ``dt``: trajectories, and the arm as a plant; what moves it is up to the scheme."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from pisplit.checks import Array, finite_array, one_of, positive
from pisplit.models.rod.equations.balance import Balance
from pisplit.models.rod.terms.base import Base
from pisplit.models.rod.terms.damping import KelvinVoigt, Retardation

if TYPE_CHECKING:
    from pisplit.models.rod.analysis.energy import EnergyAccount
    from pisplit.models.rod.scene import Scene

#: Which equations move a scene: see ``equations_of_motion``.
BALANCES = ("auto", "direct", "variational")
#: Damping ratio of the first bending mode, by the material, from which the usual equations need no energy keeping.
DAMPING = 1e-3


@dataclass(frozen=True)
class Trajectory:
    """States over time.

    Attributes:
        t: (T+1,) in s; x: (T+1, n_states) states [xi, xi_t, u]; u: (T, n_inputs) commands.
        success: False when the integrator gave up; t, x and u then end at the last good step.
        message: why it gave up, empty on success.
        stats: counters of the scheme over the steps that succeeded (``nsteps`` and others), zeros when none did.
        work: (T+1, n_terms) work in J of every term since the start, when ``run`` was asked for the energy.
    """

    t: Array
    x: Array
    u: Array
    success: bool
    message: str
    stats: dict[str, int]
    scene: Scene = field(repr=False, compare=False)
    work: Array | None = field(default=None, repr=False)

    def fields(self, stations: int | ArrayLike = 6) -> Array:
        """The 24 fields (T+1, S, 24) at stations; see ``Fields``."""
        return self.scene.fields(self.x, stations)

    def energy(self) -> EnergyAccount:
        """Stored energies, work of every term and dissipation over time; needs ``run(..., energy=True)``."""
        from pisplit.models.rod.analysis.energy import account

        if self.work is None:
            raise ValueError("the work of the terms was not integrated; call run(u, x0, energy=True)")
        return account(self.scene, self.t, self.x, self.work)


@dataclass(frozen=True)
class StepSensitivity:
    """One step and its derivatives.

    Attributes:
        x: state (n_states,) after the step.
        d_state: (n_states, n_states) derivative with respect to the state before it (its inputs included).
        d_input: (n_states, n_inputs) derivative with respect to the command.
    """

    x: Array
    d_state: Array
    d_input: Array


@dataclass(frozen=True)
class Step:
    """One step of the arm as a plant: measured state (24 S,), whether the integrator succeeded, and why not."""

    state: Array
    ok: bool
    message: str = ""


class Propagation(ABC):
    """A scene that moves in steps of ``dt`` seconds.

    Subclasses advance the state; this class turns that into trajectories (``run``) and a plant (``reset``, ``step``).
    ``equations`` is the scene whose equations move it: see ``equations_of_motion``.
    """

    #: Name of the scheme in messages.
    scheme: str
    #: Names of its counters in ``Trajectory.stats``.
    counters: tuple[str, ...]

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

    # Trajectories ----------------------------------------------------------------------------------------------------

    def run(self, u: ArrayLike, x0: ArrayLike | None = None, energy: bool = False) -> Trajectory:
        """Trajectory under commands ``u`` (T, n_inputs) from state ``x0``, or from rest under zero inputs.

        Inputs that ramp start where ``x0`` has them and reach ``u[k]`` at the end of step k. An
        integrator that gives up ends the trajectory at the last good step (``success=False``); it never raises.
        ``energy=True`` integrates the work of every term along the way, for ``Trajectory.energy()``.
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
        return Trajectory(
            t=self.dt * np.arange(done + 1, dtype=np.float64),
            x=np.vstack([start, np.hstack([states[:, :size], commands[:done]])]),
            u=commands[:done].copy(),
            success=success,
            message=message,
            stats=stats,
            scene=self.equations,
            work=np.vstack([np.zeros(states.shape[1] - size), states[:, size:]]) if energy else None,
        )

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
    def state(self) -> Array:
        """Present state [xi, xi_t, u] of the plant."""
        if self._state is None:
            raise RuntimeError("the plant has no state yet; call reset() first")
        return self._state

    def reset(self, u0: ArrayLike | None = None) -> Array:
        """Go to rest under inputs ``u0`` (zeros when not given); the measured fields (24 S,)."""
        self._state = self._rest(u0)
        return self._measure(self._state)

    def step(self, u: ArrayLike) -> Step:
        """Apply one command over ``dt`` and measure. A failed step leaves the plant where it was."""
        command = self.scene.checked_inputs(u, "u", (self.scene.n_inputs,))
        try:
            found, _ = self._integrate(self.state, command[None, :])
        except RuntimeError as error:
            return Step(self._measure(self.state), False, f"{self.scheme} gave up: {_reason(error)}")
        self._state = np.concatenate([found[0], command])
        return Step(self._measure(self._state), True)

    def _measure(self, state: Array) -> Array:
        return self.field_map.evaluate(state).ravel()

    def _rest(self, u0: ArrayLike | None) -> Array:
        equilibrium = self.equations.statics().solve(u0)
        if not equilibrium.success:
            raise RuntimeError(f"no rest position to start from: {equilibrium.message}")
        return equilibrium.state


def equations_of_motion(scene: Scene, balance: str = "auto") -> Scene:
    """The scene whose equations move ``scene``: itself (``"direct"``) or its ``variational`` twin.

    ``"auto"`` takes the twin for a spatial rod unless the material damps bending and torsion (see ``DAMPING``), a scene
    with a base that moves, and a scene that is variational already, as they are.

    Measured on rods released from a tip load: without damping of the material the usual equations are off by a tenth of
    the motion within 0.2 s at 3 to 6 nodes, where the twin is off by 1e-3, and steel rods blow up; drag of any strength
    changes nothing. From ``DAMPING`` on both agree.
    """
    one_of(balance, "balance", BALANCES)
    if balance == "variational":
        return scene if scene.balance_type is not Balance else scene.variational()
    moving_base = any(isinstance(t, Base) and (t.inputs or t.moves) for t in scene.terms)
    if balance == "direct" or scene.balance_type is not Balance or moving_base:
        return scene
    turning = [c for c in scene.rod.strain_set.free if c < 3]
    if scene.rod.strain_set.planar or all(_damping_ratio(scene, c) >= DAMPING for c in turning):
        return scene
    return scene.variational()


def _damping_ratio(scene: Scene, component: int) -> float:
    """Damping of one strain by the material in parts of the critical one at the first bending frequency."""
    stiffness = scene.rod.stiffness[component]
    viscous = sum(t.coefficient(component) for t in scene.terms if isinstance(t, KelvinVoigt)) / stiffness
    retarded = sum(t.time for t in scene.terms if isinstance(t, Retardation))
    return 0.5 * scene.rod.bending_rate * (viscous + retarded)


def _reason(error: RuntimeError) -> str:
    """The part of CasADi's message that names the failure."""
    text = str(error)
    start = text.find("returned")
    return text[start:].split(".")[0] if start >= 0 else text.strip().splitlines()[-1]
