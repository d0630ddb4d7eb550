"""Dynamics by IDAS: a whole trajectory as one call, or one step at a time."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from pisplit.checks import Array, finite_array, one_of, positive

if TYPE_CHECKING:
    from pisplit.models.rod.scene import Scene

#: Order limit of the BDF formulas where nothing damps the free strains: orders above 2 are unstable on undamped waves.
UNDAMPED_ORDER = 2
#: Internal steps over one control interval, or over one natural period where that is longer, after which IDAS gives up.
#: Ordinary motions take 20 to 200 of them, undamped waves at tight tolerances a few thousand.
MAX_STEPS = 10_000
#: Ways to start IDAS in the order they are tried: what of y0' the motion of ``Simulator._build`` carries (strain rates,
#: accelerations), and whether ``calc_ic`` corrects the start. Carried strain rates make smooth starts so easy that IDAS
#: doubles its step, fails the error test, and stays at order 1 for the whole interval, ten times as many steps: they
#: are the second choice, for the few starts that fail without. Shapes far from the slow motions of the rod, whose
#: first accelerations are 1e7 times those that follow, start with ``calc_ic`` from plain states.
STARTS = ((0.0, 1.0, False), (1.0, 1.0, False), (0.0, 0.0, True))


@dataclass(frozen=True)
class Trajectory:
    """States over time.

    Attributes:
        t: (T+1,) in s; x: (T+1, n_states) states [xi, xi_t, u]; u: (T, n_inputs) commands.
        success: False when the integrator gave up; t, x and u then end at the last good step.
        message: why it gave up, empty on success.
        stats: counters of the integrator (steps, Jacobians, error-test failures).
    """

    t: Array
    x: Array
    u: Array
    success: bool
    message: str
    stats: dict[str, int]
    scene: Scene = field(repr=False, compare=False)

    def fields(self, stations: int | ArrayLike = 6) -> Array:
        """The 24 fields (T+1, S, 24) at stations; see ``Fields``."""
        return self.scene.fields(self.x, stations)


@dataclass(frozen=True)
class Step:
    """One step of the arm as a plant: measured state (24 S,), whether the integrator succeeded, and why not."""

    state: Array
    ok: bool
    message: str = ""


class Simulator:
    """Motion of a scene in steps of ``dt``; also the plant of a closed loop.

    Args:
        scene: what moves.
        dt: control interval in s.
        rtol: relative tolerance of IDAS; absolute tolerances are ``rtol`` times the nominal size of each state.
        hold: ``"first"``: inputs move linearly to the command over the step, as a servo does; ``"zero"``: they jump at
            its start (2 to 10 times as many integrator steps).
        stations: stations whose fields ``reset`` and ``step`` measure (see ``Fields``).

    The iteration matrix of the integrator takes the inertia forces as dead loads: how they change with shape and rate
    is left out (it scales with the square of the internal step, about 1 ms), how they stiffen the shape is not: without
    that part one trajectory in ten takes 5 to 10 times as many iterations. Same answer, 60 % of the cost.
    """

    def __init__(
        self, scene: Scene, dt: float, rtol: float = 1e-4, hold: str = "first", stations: int | ArrayLike = 6
    ) -> None:
        self.scene = scene
        self.dt = positive(dt, "Simulator dt", "s")
        self.rtol = positive(rtol, "Simulator rtol")
        if not 1e-12 <= self.rtol <= 0.1:
            raise ValueError(f"Simulator rtol = {self.rtol:g}; expected 1e-12 to 0.1")
        self.hold = one_of(hold, "Simulator hold", ("first", "zero"))
        self.field_map = scene.field_map(stations)
        self._integrators: dict[tuple[int, bool], ca.Function] = {}
        self._state: Array | None = None

    # Trajectories ----------------------------------------------------------------------------------------------------

    def run(self, u: ArrayLike, x0: ArrayLike | None = None) -> Trajectory:
        """Trajectory under commands ``u`` (T, n_inputs) from state ``x0``, or from rest under zero inputs.

        With first-order hold the inputs start where ``x0`` has them and reach ``u[k]`` at the end of step k. An
        integrator that gives up ends the trajectory at the last good step (``success=False``); it never raises.
        """
        commands = self.scene.checked_inputs(u, "u", (None, self.scene.n_inputs))
        if len(commands) == 0:
            raise ValueError("u has no rows; give at least one command")
        start = self._rest(None) if x0 is None else finite_array(x0, "x0", (self.scene.n_states,))
        try:
            states, stats = self._integrate(start, commands)
            success, message = True, ""
        except RuntimeError:
            states, stats, message = self._as_far_as_possible(start, commands)
            success = not message
        done = len(states)
        return Trajectory(
            t=self.dt * np.arange(done + 1, dtype=np.float64),
            x=np.vstack([start, np.hstack([states, commands[:done]])]),
            u=commands[:done].copy(),
            success=success,
            message=message,
            stats=stats,
            scene=self.scene,
        )

    def _integrate(self, start: Array, commands: Array) -> tuple[Array, dict[str, int]]:
        """States [xi, xi_t] after each command: the first start (see ``_build``) that IDAS takes."""
        n, steps = self.scene.n_strains, len(commands)
        if self.hold == "first":
            origin = np.vstack([start[2 * n :], commands[:-1]])
            slope = (commands - origin) / self.dt
        else:
            origin, slope = commands, np.zeros_like(commands)
        controls = np.hstack([origin, slope, self.dt * np.arange(steps)[:, None]])
        t = self.dt * np.arange(1, steps + 1)
        moving = start[n : 2 * n]
        accelerations = np.asarray(self.scene.acceleration(start[:n], moving, origin[0])).ravel()
        failure: RuntimeError | None = None
        for of_strains, of_rates, correct in STARTS:
            integrator = self._integrator(steps, correct)
            rates = np.concatenate([of_strains * moving, of_rates * accelerations])
            given = {"x0": np.zeros(2 * n), "z0": accelerations, "p": np.concatenate([start[: 2 * n], rates])}
            try:
                deviation = np.asarray(integrator(**given, u=controls.T)["xf"]).T
            except RuntimeError as error:
                failure = error
                continue
            states = start[: 2 * n] + self.dt * -np.expm1(-t / self.dt)[:, None] * rates + deviation
            if np.all(np.isfinite(states)):
                return states, _counters(integrator.stats())
            failure = RuntimeError("the integrator returned states that are not finite")
        assert failure is not None
        raise failure

    def _as_far_as_possible(self, start: Array, commands: Array) -> tuple[Array, dict[str, int], str]:
        """Step by step until a step fails."""
        states: list[Array] = []
        state, total = start, dict.fromkeys(_COUNTERS, 0)
        for k, command in enumerate(commands):
            try:
                found, stats = self._integrate(state, command[None, :])
            except RuntimeError as error:
                message = f"IDAS gave up in step {k} at t = {k * self.dt:g} s: {_reason(error)}"
                return np.array(states).reshape(len(states), 2 * self.scene.n_strains), total, message
            states.append(found[0])
            state = np.concatenate([found[0], command])
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
            return Step(self._measure(self.state), False, f"IDAS gave up: {_reason(error)}")
        self._state = np.concatenate([found[0], command])
        return Step(self._measure(self._state), True)

    def _measure(self, state: Array) -> Array:
        return self.field_map.evaluate(state).ravel()

    def _rest(self, u0: ArrayLike | None) -> Array:
        equilibrium = self.scene.statics().solve(u0)
        if not equilibrium.success:
            raise RuntimeError(f"no rest position to start from: {equilibrium.message}")
        return equilibrium.state

    # The integrator --------------------------------------------------------------------------------------------------

    @cached_property
    def _balance(self) -> ca.Function:
        """The residual with its simplified iteration matrix: see ``motion_residual``."""
        return self.scene.native(self.scene.motion_residual)

    def _integrator(self, steps: int, correct_first: bool) -> ca.Function:
        key = (steps, correct_first)
        if key not in self._integrators:
            self._integrators[key] = self._build(steps, correct_first)
        return self._integrators[key]

    def _build(self, steps: int, correct_first: bool) -> ca.Function:
        """IDAS over a grid of steps, in the deviation from a motion with the right first derivative.

        CasADi starts IDAS with zero time derivatives. For a rod that moves this is inconsistent: with plain states 7 %
        of the starts fail, with ``calc_ic`` a step costs twice as much. With
        y = y0 + y0' T (1 - exp(-t/T)) + deviation, the deviation truly starts with zero derivative; ``STARTS`` says
        what of y0' is carried so.
        """
        scene = self.scene
        n, m = scene.n_strains, scene.n_inputs
        deviation, z = ca.MX.sym("deviation", 2 * n), ca.MX.sym("z", n)
        start = ca.MX.sym("start", 4 * n)
        control, t = ca.MX.sym("control", 2 * m + 1), ca.MX.sym("t")
        fade = ca.exp(-t / self.dt)
        x = start[: 2 * n] + self.dt * (1.0 - fade) * start[2 * n :] + deviation
        u = control[:m] + control[m : 2 * m] * (t - control[2 * m])
        dae = {
            "x": deviation,
            "z": z,
            "p": start,
            "u": control,
            "t": t,
            "ode": ca.vertcat(x[n:], z) - fade * start[2 * n :],
            "alg": self._balance(x[:n], x[n:], z, u),
        }
        rate = scene.rod.bending_rate
        nominal = np.concatenate([scene.nominal_strains * rate**k for k in range(3)])
        options = {
            "reltol": self.rtol,
            "abstolv": (self.rtol * nominal).tolist(),
            "suppress_algebraic": True,
            "calc_ic": correct_first,
            "linear_solver": "csparse",
            "max_num_steps": int(MAX_STEPS * max(1.0, self.dt * rate / (2.0 * np.pi))),
            "max_multistep_order": 5 if scene.damped else UNDAMPED_ORDER,
            "disable_internal_warnings": True,
            "show_eval_warnings": False,
        }
        grid = (self.dt * np.arange(1, steps + 1)).tolist()
        return ca.integrator("arm", "idas", dae, 0.0, grid, options)


_COUNTERS = ("nsteps", "nlinsetups", "netfails")


def _counters(stats: dict[str, object]) -> dict[str, int]:
    return {name: int(str(stats.get(name, 0))) for name in _COUNTERS}


def _reason(error: RuntimeError) -> str:
    """The part of CasADi's message that names the failure."""
    text = str(error)
    start = text.find("returned")
    return text[start:].split(".")[0] if start >= 0 else text.strip().splitlines()[-1]
