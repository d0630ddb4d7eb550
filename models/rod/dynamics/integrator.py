"""Dynamics by IDAS: a whole trajectory as one call, or one step at a time."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, NoReturn

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from pisplit.checks import Array, one_of, positive
from pisplit.models.rod.analysis.energy import powers
from pisplit.models.rod.dynamics.propagation import Propagation

if TYPE_CHECKING:
    from pisplit.models.rod.scene import Scene

#: Order limit of the BDF formulas where nothing damps the free strains: orders above 2 are unstable on undamped waves.
UNDAMPED_ORDER = 2
#: Internal steps over one control interval, or over one natural period where that is longer, after which IDAS gives up.
#: Ordinary motions take 20 to 200 of them.
MAX_STEPS = 10_000
#: The same where some free strain is not damped: waves take a few thousand, under jumping tendons up to 25 000.
MAX_STEPS_UNDAMPED = 50_000
#: The same while many intervals are one call: a run that is bound to fail spends its steps in one interval and once.
MAX_STEPS_TOGETHER = 2_000
#: Ways to start IDAS in the order they are tried: what of y0' the motion of ``Simulator._build`` carries (strain rates,
#: accelerations), and whether ``calc_ic`` corrects the start. Carried strain rates make smooth starts so easy that IDAS
#: doubles its step, fails the error test, and stays at order 1 for the whole interval, ten times as many steps: they
#: are the second choice, for the few starts that fail without. Shapes far from the slow motions of the rod, whose
#: first accelerations are 1e7 times those that follow, start with ``calc_ic`` from plain states.
STARTS = ((0.0, 1.0, False), (1.0, 1.0, False), (0.0, 0.0, True))
#: Shortest time for which a first derivative is carried, in parts of dt.
LEAST_FADING = 1e-3
#: Least size of a motion, in parts of a typical one, that absolute tolerances follow; below ``AT_REST`` there is none.
LEAST_SIZE, AT_REST = 1e-4, 1e-8
#: Change of a scaled strain in motions for which the absolute tolerances are those of nominal sizes.
TYPICAL = 0.3
#: The least tolerance that IDAS takes.
LEAST_RTOL = 1e-12
#: Intervals after which it pays to share the subexpressions of the residual and of its Jacobian.
MANY = 1000
#: Commands of a run by which its size is judged, and the step of differences of scaled strains.
JUDGED, STEP = 64, 1e-6


class Simulator(Propagation):
    """Motion of a scene in steps of ``dt``; also the plant of a closed loop.

    Args:
        scene: what moves.
        dt: control interval in s.
        rtol: relative tolerance of IDAS; absolute tolerances are ``rtol`` times the nominal size of each state, over a
            ``run`` that moves less than that ``rtol`` times the size of its motion.
        inputs: ``"ramp"``: inputs move linearly to the command over the step, as a servo does; ``"step"``: they jump at
            its start (2 to 10 times as many integrator steps).
        stations: stations whose fields ``reset`` and ``step`` measure (see ``Fields``).
        balance: ``"auto"``, ``"direct"`` or ``"variational"`` equations: see ``equations_of_motion``.

    The iteration matrix of the integrator takes the inertia forces as dead loads: how they change with shape and rate
    is left out (it scales with the square of the internal step, about 1 ms), how they stiffen the shape is not: without
    that part one trajectory in ten takes 5 to 10 times as many iterations. Same answer, 60 % of the cost.
    """

    scheme = "IDAS"
    counters = ("nsteps", "nlinsetups", "netfails")
    remedy = "give a smaller rtol"
    checked_steps = 5000
    damps_waves = True

    def __init__(
        self,
        scene: Scene,
        dt: float,
        rtol: float = 1e-5,
        inputs: str = "ramp",
        stations: int | ArrayLike = 6,
        balance: str = "auto",
    ) -> None:
        super().__init__(scene, dt, stations, balance)
        self.rtol = positive(rtol, "Simulator rtol")
        if not LEAST_RTOL <= self.rtol <= 0.1:
            raise ValueError(f"Simulator rtol = {self.rtol:g}; expected 1e-12 to 0.1")
        self.inputs = one_of(inputs, "Simulator inputs", ("ramp", "step"))
        self.balance = balance
        self._intervals = 0

    def _on(self, scene: Scene, finer: float = 0.1) -> Simulator:
        rtol = max(finer * self.rtol, LEAST_RTOL)
        return Simulator(scene, self.dt, rtol, self.inputs, balance=self.balance)

    @property
    def setting(self) -> tuple[object, ...]:
        return self.scheme, self.rtol, self.inputs

    def integrate(self, start: Array, commands: Array, energy: bool = False) -> tuple[Array, dict[str, int]]:
        """States (T, n_moving) after each command: see ``Propagation.integrate``.

        One interval takes the first start (see ``_build``) that IDAS does; many take the first of all or fail, and
        ``run`` goes on interval by interval. Too much work is the fault of the motion: no other start is tried.

        Args:
            start: state [xi, xi_t, u] (n_states,).
            commands: (T, n_inputs).
            energy: whether to add the work of every term since the start.
        """
        layout, steps = self.scene.layout, len(commands)
        self._intervals += steps
        strains, moving, overstress, before = layout.split(start)
        if self.inputs == "ramp":
            origin = np.vstack([before, commands[:-1]])
            slope = (commands - origin) / self.dt
        else:
            origin, slope = commands, np.zeros_like(commands)
        controls = np.hstack([origin - slope * self.dt * np.arange(steps)[:, None], slope])
        t = self.dt * np.arange(1, steps + 1)
        level = self._level(start, commands) if steps > 1 else 0
        accelerations = np.asarray(
            self.equations.acceleration(strains, moving, np.concatenate([overstress, origin[0]]))
        ).ravel()
        fractions, relaxing = self.equations.relaxation
        failure: RuntimeError | None = None
        for of_strains, of_rates, correct in STARTS if steps == 1 else STARTS[:1]:
            integrator = self._integrator(steps, correct, energy, level)
            sigma_t = of_strains * (
                fractions * np.tile(moving[: layout.n_free], layout.n_branches) - relaxing * overstress
            )
            rates = np.concatenate([of_strains * moving, of_rates * accelerations, sigma_t])
            fading = self._fading_time(rates)
            held = np.concatenate([start[layout.moving], rates, [fading]])
            given = {"x0": np.zeros(layout.n_moving), "z0": accelerations, "p": held}
            try:
                found = integrator(**given, u=controls.T)
            except RuntimeError as error:
                failure = error
                if "IDA_TOO_MUCH_WORK" in str(error):
                    break
                continue
            carried = -fading * np.expm1(-t / fading)[:, None] * rates
            states = start[layout.moving] + carried + np.asarray(found["xf"]).T
            if energy:
                states = np.hstack([states, np.asarray(found["qf"]).T])
            if np.all(np.isfinite(states)):
                stats = integrator.stats()
                return states, {name: int(str(stats.get(name, 0))) for name in self.counters}
            failure = RuntimeError("the integrator returned states that are not finite")
        assert failure is not None
        raise failure

    def sensitivity(self, x: ArrayLike, u: ArrayLike) -> NoReturn:
        """Raises NotImplementedError: forward sensitivities of IDAS take minutes on a spatial rod.

        Args:
            x: state (n_states,) before the step.
            u: command (n_inputs,). ``Stepper.sensitivity`` takes both.
        """
        raise NotImplementedError(
            "IDAS gives no derivatives of a step; use scene.stepper(dt, step=...).sensitivity(x, u), of fixed steps"
        )

    @cached_property
    def _nominal(self) -> Array:
        """Typical strains, rates, overstress and accelerations (3 n_strains + b n_strains,)."""
        scene = self.equations
        hidden = np.tile(scene.nominal_strains[: scene.layout.n_free], len(scene.branches))
        strains, moving, bends = (scene.nominal_strains * scene.nominal_rates**k for k in range(3))
        return np.concatenate([strains, moving, hidden, bends])

    def _fading_time(self, rates: Array) -> float:
        """T [s] of the motion that ``_build`` carries from the first derivative ``rates`` (n_moving,).

        It is dt, but where an input jumps: accelerations of 1e10 that last for a microsecond would be carried to rates
        that the rod never has, and IDAS would measure its errors by them. No state is carried farther than is typical.
        """
        largest = float(np.max(np.abs(rates) / self._nominal[: len(rates)], initial=0.0))
        return min(self.dt, max(1.0 / largest, LEAST_FADING * self.dt)) if largest > 0.0 else self.dt

    def _level(self, start: Array, commands: Array) -> int:
        """Half decades (0 to -8) by which the motion under ``commands`` is smaller than a typical one, rounded up."""
        size = self._size(start, commands)
        if not AT_REST < size < 1.0:
            return 0
        return int(np.ceil(2.0 * np.log10(max(size, LEAST_SIZE))))

    def _size(self, start: Array, commands: Array) -> float:
        """Estimated size of the motion, in parts of a typical one.

        The way from the shape at the start to the equilibrium of every command, by the stiffness at the start, and the
        strain rates and the overstress there.
        """
        n, unit, residual = self.scene.n_strains, self.equations.nominal_strains, self.equations.nominal_residual
        xi, moving, overstress, _ = self.scene.layout.split(start)
        rest, relaxed = np.zeros(n), np.zeros(len(overstress))

        def balance(strains: Array, u: Array) -> Array:
            return np.asarray(self._balance(strains, rest, rest, np.concatenate([relaxed, u]))).ravel() / residual

        rows = commands[np.unique(np.linspace(0, len(commands) - 1, JUDGED).astype(int))]
        forces = np.array([balance(xi, u) for u in rows])
        stiffness = np.array([balance(xi + STEP * unit * e, rows[0]) for e in np.eye(n)]) - forces[0]
        try:
            ways = np.linalg.solve(stiffness.T / STEP, forces.T)
        except np.linalg.LinAlgError:
            return 1.0
        rates = np.abs(moving) / self._nominal[self.scene.layout.rates]
        stress = np.abs(overstress) / np.tile(unit[: self.scene.layout.n_free], self.scene.layout.n_branches)
        size = max(float(np.abs(ways).max()), float(rates.max()), float(stress.max(initial=0.0)))
        return size / TYPICAL if np.isfinite(size) else 1.0

    # The integrator --------------------------------------------------------------------------------------------------

    @cached_property
    def _balance(self) -> ca.Function:
        """The residual with its simplified iteration matrix: see ``motion_residual``."""
        return self.equations.native(self.equations.motion_residual)

    @cached_property
    def _shared_balance(self) -> ca.Function:
        return self.equations.native(self.equations.shared_motion_residual)

    @cached_property
    def _integrators(self) -> dict[tuple[int, bool, bool, int, bool], ca.Function]:
        return {}

    def _integrator(self, steps: int, correct_first: bool, energy: bool, level: int) -> ca.Function:
        key = (steps, correct_first, energy, level, self._intervals > MANY)
        if key not in self._integrators:
            self._integrators[key] = self._build(*key)
        return self._integrators[key]

    def _build(self, steps: int, correct_first: bool, energy: bool, level: int, shared: bool) -> ca.Function:
        """IDAS over a grid of steps, in the deviation from a motion with the right first derivative.

        CasADi starts IDAS with zero time derivatives. For a rod that moves this is inconsistent: with plain states 7 %
        of the starts fail, with ``calc_ic`` a step costs twice as much. With
        y = y0 + y0' T (1 - exp(-t/T)) + deviation, the deviation truly starts with zero derivative; ``STARTS`` says
        what of y0' is carried so.
        """
        scene = self.equations
        n, m, q = scene.n_strains, scene.n_inputs, scene.layout.n_moving
        deviation, z = ca.MX.sym("deviation", q), ca.MX.sym("z", n)
        start, fading = ca.MX.sym("start", 2 * q), ca.MX.sym("fading")
        control, t = ca.MX.sym("control", 2 * m), ca.MX.sym("t")
        fade = ca.exp(-t / fading)
        x = start[:q] + fading * (1.0 - fade) * start[q:] + deviation
        strains, moving, overstress = x[:n], x[n : 2 * n], x[2 * n :]
        acting = ca.vertcat(overstress, control[:m] + control[m:] * t)
        dae = {
            "x": deviation,
            "z": z,
            "p": ca.vertcat(start, fading),
            "u": control,
            "t": t,
            "ode": ca.vertcat(moving, z, scene.overstress_rates(moving, overstress)) - fade * start[q:],
            "alg": (self._shared_balance if shared else self._balance)(strains, moving, z, acting),
        }
        if energy:
            dae["quad"] = powers(scene)(strains, moving, acting)
        rate, alone = scene.rod.bending_rate, MAX_STEPS if scene.damped else MAX_STEPS_UNDAMPED
        most = alone if steps == 1 else MAX_STEPS_TOGETHER
        options = {
            "reltol": self.rtol,
            "abstolv": (10.0 ** (0.5 * level) * self.rtol * self._nominal).tolist(),
            "suppress_algebraic": True,
            "calc_ic": correct_first,
            "linear_solver": "csparse",
            "max_num_steps": int(most * max(1.0, self.dt * rate / (2.0 * np.pi))),
            "max_multistep_order": 5 if scene.damped else UNDAMPED_ORDER,
            "disable_internal_warnings": True,
            "show_eval_warnings": False,
        }
        grid = (self.dt * np.arange(1, steps + 1)).tolist()
        return ca.integrator("arm", "idas", dae, 0.0, grid, options)
