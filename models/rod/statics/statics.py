"""Static equilibria by CasADi's rootfinders."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike
from tqdm import tqdm

from pisplit.checks import Array, finite_array
from pisplit.models.rod.equations.tangent import PoseSensitivity, Stability, Tangent, checked_state, stability
from pisplit.models.rod.scene import Scene
from pisplit.models.rod.statics.boundary import HeldEquilibrium, HeldTip
from pisplit.models.rod.statics.continuation import follow, relax
from pisplit.models.rod.statics.inverse import InverseSolution, inverse

#: Largest scaled residual (parts of EI/L) of a state that counts as an equilibrium.
TOLERANCE = 1e-8
#: The same of a state that a relaxation hands over to Newton's method.
COARSE = 1e-4


@dataclass(frozen=True)
class Equilibrium:
    """A static equilibrium, or the best that was found.

    Attributes:
        state: [xi, 0, u] (n_states,).
        success: whether the residual is below tolerance.
        residual: largest residual in parts of EI/L (moments) and EI/L^2 (forces).
        iterations: Newton iterations of the solver that ended the search (all loads of a continuation together); None
            after kinsol, whose CasADi interface does not report them.
        solver: ``"kinsol"``, ``"newton"``, ``"continuation"`` or ``"relaxation"``.
        tensions: tendon tensions in N.
        slack: by how much each tendon is longer than its path, in m (0 when taut).
        message: why the search failed, empty on success.
    """

    state: Array
    success: bool
    residual: float
    iterations: int | None
    solver: str
    tensions: Array
    slack: Array
    message: str = ""
    scene: Scene = field(repr=False, compare=False, kw_only=True)

    @property
    def strains(self) -> Array:
        """Free strains xi (n_strains,)."""
        return self.state[: self.scene.n_strains]

    def pose(self, s: float) -> tuple[Array, Array]:
        """Position (3,) in m and rotation (3, 3) at arclength ``s`` in m."""
        y = self.scene.field_map([s]).evaluate(self.state)[0]
        return y[:3], y[3:12].reshape(3, 3)

    @property
    def tip(self) -> Array:
        """Position of the tip (3,) in m."""
        return self.pose(self.scene.rod.length)[0]


@dataclass(frozen=True)
class EquilibriumBatch:
    """Equilibria of many inputs: ``states`` (N, n_states), ``success``, ``residual`` (N,), ``tensions`` (N, tendons).

    Rows that failed hold the last iterate; ``success`` tells them apart.
    """

    states: Array
    success: np.ndarray
    residual: Array
    tensions: Array


class Statics:
    """Equilibria of a scene: kinsol first, then Newton, then the loads in steps, then by relaxation.

    The unknowns are scaled by 1/L and the residual by EI/L, so tolerances mean the same for every rod.
    """

    def __init__(self, scene: Scene) -> None:
        self.scene = scene

    @cached_property
    def _graph(self) -> tuple[ca.SX, ca.SX, ca.SX, ca.SX]:
        """Scaled unknowns, inputs, load factor and scaled residual; the load factor multiplies what deforms the rod."""
        scene = self.scene
        n = scene.n_strains
        x, load = ca.SX.sym("x", n), ca.SX.sym("load")
        xi, u, balance = scene.static_balance
        bare = scene.without(object).balance(xi, ca.SX(n, 1), None, ca.SX(0, 1)).residual
        residual = (load * balance.residual + (1.0 - load) * bare) / ca.DM(scene.nominal_residual)
        scaled = ca.DM(scene.rest_coordinates) + ca.DM(scene.nominal_strains) * x
        return x, u, load, ca.substitute(residual, xi, scaled)

    @cached_property
    def residual_function(self) -> ca.Function:
        """``(x, u) -> residual`` in scaled form."""
        x, u, load, residual = self._graph
        return ca.Function("residual", [x, u], [ca.substitute(residual, load, ca.SX(1))], {"cse": True})

    @cached_property
    def _readings(self) -> ca.Function:
        xi, u, balance = self.scene.static_balance
        empty = ca.SX(0, 1)
        outputs = [balance.loads.outputs.get(name, empty) for name in ("tension", "length", "unpulled_length")]
        return ca.Function("readings", [xi, u], outputs, {"cse": True})

    def _rootfinder(self, solver: str, loaded: bool, raises: bool = True) -> ca.Function:
        x, u, load, residual = self._graph
        if loaded:
            function = self.scene.native(self.residual_function)
        else:
            function = ca.Function("g", [x, u, load], [residual], {"cse": True})
        options: dict[str, Any] = {
            "error_on_fail": raises,
            "abstol": 1e-10,
            "max_iter": 60,
            "linear_solver": "qr",
            "show_eval_warnings": False,
        }
        if solver == "kinsol":  # plain kinsol steps with stale Jacobians and solves 2 % of stiff tendon arms cold
            options |= {"strategy": "linesearch", "disable_internal_warnings": True}
        return ca.rootfinder("equilibrium", solver, function, options)

    @cached_property
    def kinsol(self) -> ca.Function:
        """``(x_guess, u) -> x`` in scaled unknowns."""
        return self._rootfinder("kinsol", True)

    @cached_property
    def _kinsol_of_rows(self) -> ca.Function:
        """The same for a map: a row that fails neither ends it nor prints its inputs; the residual tells."""
        return self._rootfinder("kinsol", True, raises=False)

    @cached_property
    def newton(self) -> ca.Function:
        """``(x_guess, u) -> x`` in scaled unknowns, by damped Newton."""
        return self._rootfinder("newton", True)

    @cached_property
    def _continuation(self) -> ca.Function:
        return self._rootfinder("newton", False)

    # Solving ---------------------------------------------------------------------------------------------------------

    def solve(self, u: ArrayLike | None = None, guess: ArrayLike | None = None) -> Equilibrium:
        """Equilibrium under inputs ``u`` (n_inputs,), from the straight rod or from the state or strains ``guess``.

        A failed search is returned with ``success=False`` and a message, never raised.
        """
        scene = self.scene
        u = scene.checked_inputs(np.zeros(scene.n_inputs) if u is None else u, "u", (scene.n_inputs,))
        x0 = np.zeros(scene.n_strains) if guess is None else self._scaled(guess)
        x, iterations, solver = self._search(u, x0)
        residual = self._worst(x, u)
        success = bool(residual <= TOLERANCE)
        tensions, slack = self._read(x, u)
        return Equilibrium(
            state=np.concatenate([self._strains(x), np.zeros(scene.n_strains), u]),
            success=success,
            residual=residual,
            iterations=iterations,
            solver=solver,
            tensions=tensions,
            slack=slack,
            message=""
            if success
            else f"no equilibrium found: residual {residual:.1e} EI/L after kinsol, Newton, continuation, relaxation",
            scene=scene,
        )

    def solve_many(self, inputs: ArrayLike, progress: bool = False, chunk: int = 512) -> EquilibriumBatch:
        """Equilibria under each row of ``inputs`` (N, n_inputs): one ``EquilibriumBatch``."""
        scene = self.scene
        rows = scene.checked_inputs(inputs, "U", (None, scene.n_inputs))
        found = np.empty((len(rows), scene.n_strains))
        worst = np.empty(len(rows))
        guess = self._affine_guess(rows)
        for start in tqdm(range(0, len(rows), chunk), disable=not progress, desc="equilibria", unit="block"):
            block = rows[start : start + chunk]
            x = self._solve_block(guess(block), block)
            g = np.abs(np.asarray(self.scene.native(self.residual_function).map(len(block))(x.T, block.T)))
            found[start : start + len(block)] = x
            worst[start : start + len(block)] = np.where(np.isfinite(g), g, np.inf).max(axis=0, initial=0.0)
        for k in np.flatnonzero(worst > TOLERANCE):
            found[k], _, _ = self._search(rows[k], np.zeros(scene.n_strains))
            worst[k] = self._worst(found[k], rows[k])
        states = np.hstack([self._strains(found), np.zeros_like(found), rows])
        readings = self._readings.map(len(rows)) if len(rows) else None
        tensions = np.asarray(readings(self._strains(found).T, rows.T)[0]).T if readings else np.empty((0, 0))
        return EquilibriumBatch(states, worst <= TOLERANCE, worst, tensions)

    def sweep(self, inputs: ArrayLike) -> EquilibriumBatch:
        """Equilibria along a path of ``inputs`` (N, n_inputs): each starts where the tangent of the last one leads.

        This follows one branch of equilibria; a row that fails is flagged and the next starts from the last good one.
        """
        scene = self.scene
        rows = scene.checked_inputs(inputs, "U", (None, scene.n_inputs))
        found, tensions = np.empty((len(rows), scene.n_strains)), []
        worst = np.empty(len(rows))
        x, before = np.zeros(scene.n_strains), None
        for k, u in enumerate(rows):
            guess = x if before is None else x + self._along(x, before, u - before)
            found[k] = _attempt(self.newton, guess, u)
            worst[k] = self._worst(found[k], u)
            if worst[k] > TOLERANCE:
                found[k], _, _ = self._search(u, x)
                worst[k] = self._worst(found[k], u)
            if worst[k] <= TOLERANCE:
                x, before = found[k], u
            tensions.append(self._read(found[k], u)[0])
        states = np.hstack([self._strains(found), np.zeros_like(found), rows])
        return EquilibriumBatch(states, worst <= TOLERANCE, worst, np.array(tensions))

    @cached_property
    def _slopes(self) -> ca.Function:
        """``(x, u) -> `` derivatives of the scaled residual with respect to both."""
        x, u, load, residual = self._graph
        residual = ca.substitute(residual, load, ca.SX(1))
        return ca.Function("slopes", [x, u], [ca.jacobian(residual, x), ca.jacobian(residual, u)], {"cse": True})

    def _along(self, x: Array, u: Array, change: Array) -> Array:
        """Change of the scaled unknowns with the inputs, to first order."""
        of_x, of_u = (np.asarray(v) for v in self._slopes(x, u))
        try:
            return np.asarray(-np.linalg.solve(of_x, of_u @ change), dtype=np.float64)
        except np.linalg.LinAlgError:
            return np.zeros_like(x)

    # What an equilibrium depends on ----------------------------------------------------------------------------------

    def sensitivity(self, state: ArrayLike, s: float | None = None) -> PoseSensitivity:
        """Tendon Jacobian and compliance of the pose at arclength ``s`` in m (the tip), at an equilibrium state."""
        s = self.scene.rod.length if s is None else float(s)
        tangents: dict[float, Tangent] = self.__dict__.setdefault("_tangents", {})
        if s not in tangents:
            tangents[s] = Tangent(self.scene, s)
        return tangents[s].sensitivity(checked_state(self.scene, state))

    def stability(self, state: ArrayLike) -> Stability:
        """Stability of an equilibrium state: see ``Stability``."""
        return stability(self.scene, checked_state(self.scene, state))

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
            start: inputs to start from, e.g. the pretension of the tendons.
            tolerance: of the position in parts of the length.
        """
        return inverse(self, target, limits, start, tolerance)

    def hold_tip(
        self, position: ArrayLike, rotation: ArrayLike | None = None, u: ArrayLike | None = None
    ) -> HeldEquilibrium:
        """Equilibrium with the tip held at ``position`` (3,) in m and, when given, ``rotation`` (3, 3).

        The tip is moved there from the free equilibrium on a straight way, so that one branch is followed; a place that
        cannot be reached is flagged, never raised.
        """
        inputs = np.zeros(self.scene.n_inputs) if u is None else u
        free = self.solve(inputs)
        held: dict[bool, HeldTip] = self.__dict__.setdefault("_held", {})
        turned = rotation is not None
        if turned not in held:
            held[turned] = HeldTip(self.scene, turned)
        return held[turned].solve(free.state[2 * self.scene.n_strains :], position, rotation, free.state)

    def _affine_guess(self, rows: Array) -> Callable[[Array], Array]:
        """A guess affine in u, fitted to the equilibria of the first rows: a third of a zero guess's iterations."""
        n, pilots = self.scene.n_strains, 4 * (self.scene.n_inputs + 1)
        if len(rows) < 4 * pilots:
            return lambda block: np.zeros((len(block), n))
        solved = np.array([self._search(u, np.zeros(n))[0] for u in rows[:pilots]])
        lift = np.hstack([np.ones((pilots, 1)), rows[:pilots]])
        coefficients = np.linalg.lstsq(lift, solved, rcond=None)[0]
        return lambda block: coefficients[0] + block @ coefficients[1:]

    def _solve_block(self, guess: Array, block: Array) -> Array:
        """kinsol on every row; rows that fail come back as they are."""
        return np.asarray(self._kinsol_of_rows.map(len(block))(guess.T, block.T)).T

    def _search(self, u: Array, x0: Array) -> tuple[Array, int | None, str]:
        """Solver after solver until one converges; the last iterate, its iterations and the solver's name."""
        for name, solver in (("kinsol", self.kinsol), ("newton", self.newton)):
            x = _attempt(solver, x0, u)
            if self._worst(x, u) <= TOLERANCE:
                return x, _iterations(solver) if name == "newton" else None, name
        total = 0

        def at_load(load: float, guess: Array) -> Array | None:
            nonlocal total
            x = _attempt(self._continuation, guess, u, load)
            total += _iterations(self._continuation)
            return x if np.all(np.isfinite(x)) else None

        x, _ = follow(at_load, np.zeros_like(x0))
        if self._worst(x, u) <= TOLERANCE:
            return x, total, "continuation"
        sunk = relax(lambda x: self._residual(x, u), lambda x: np.asarray(self._slopes(x, u)[0]), x, COARSE)
        refined = _attempt(self.newton, sunk, u)
        if np.all(np.isfinite(refined)):
            x, total = refined, _iterations(self.newton)
        return x, total, "relaxation"

    def _residual(self, x: Array, u: Array) -> Array:
        return np.asarray(self.scene.native(self.residual_function)(x, u)).ravel()

    def _worst(self, x: Array, u: Array) -> float:
        g = np.abs(self._residual(x, u))
        return float(g.max(initial=0.0)) if np.all(np.isfinite(g)) else float("inf")

    def _read(self, x: Array, u: Array) -> tuple[Array, Array]:
        """Tensions in N and slack in m of every tendon; tendons driven by tension are never slack."""
        tension, length, unpulled = (np.asarray(v).ravel() for v in self._readings(self._strains(x), u))
        return tension, np.maximum(0.0, unpulled - length)

    def _strains(self, x: Array) -> Array:
        strains: Array = self.scene.rest_coordinates + x * self.scene.nominal_strains
        return strains

    def _scaled(self, guess: ArrayLike) -> Array:
        values = np.asarray(guess, float).ravel()
        if values.size not in (self.scene.n_strains, self.scene.n_states):
            raise ValueError(
                f"guess has {values.size} entries; expected {self.scene.n_states} (a state) "
                f"or {self.scene.n_strains} (strains)"
            )
        rest = self._strains(np.zeros(self.scene.n_strains))
        scaled: Array = (
            finite_array(values[: self.scene.n_strains], "guess", (None,)) - rest
        ) / self.scene.nominal_strains
        return scaled


def _attempt(solver: ca.Function, x0: Array, *parameters: Array | float) -> Array:
    """One call of a rootfinder; NaN where it fails."""
    try:
        return np.asarray(solver(x0, *parameters)).ravel()
    except RuntimeError:
        return np.full(len(x0), np.nan)


def _iterations(solver: ca.Function) -> int:
    return int(solver.stats()["iter_count"])
