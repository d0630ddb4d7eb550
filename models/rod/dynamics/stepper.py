"""Dynamics by Gauss collocation in time with a fixed step."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from pisplit.checks import Array, count, finite_array, positive
from pisplit.models.rod.analysis.energy import powers
from pisplit.models.rod.dynamics.trajectory import Propagation, StepSensitivity
from pisplit.models.rod.kinematics.gauss import GaussRule

if TYPE_CHECKING:
    from pisplit.models.rod.scene import Scene

#: Newton iterations with one matrix before their convergence is looked at.
ITERATIONS = 3
#: Contraction of the iteration beyond which its matrix is formed anew.
SLOW = 0.1
#: Matrices formed for one step before it is halved.
MATRICES = 6
#: Correction of the strains in parts of their nominal size beyond which an iteration is given up.
LARGEST_CORRECTION = 1.0
#: Correction that counts as rounding once it shrinks no further.
ROUNDING = 1e-9
#: How often a step may be halved before the scheme gives up (1 ms becomes 1 microsecond).
MAX_HALVINGS = 10


@dataclass(frozen=True, eq=False)
class _Piece:
    """A step ``h`` from ``x`` to ``end`` with accelerations ``z`` (n, s) at its stages and inputs at both ends."""

    x: Array
    z: Array
    u: tuple[Array, Array]
    h: float
    end: Array


class Stepper(Propagation):
    """Motion of a scene in equal internal steps: for undamped rods and for hard real time.

    Gauss collocation has order ``2 * stages``, keeps quadratic invariants and damps nothing, so that the energy of an
    undamped rod stays where it is; strongly overdamped modes settle no faster than the step (IDAS is better there).
    Undamped spatial scenes move by their ``variational`` equations, which the energy needs as much as the scheme.

    The accelerations at the stages are found by Newton's method with the simplified iteration matrix (see
    ``motion_residual``), kept from step to step and formed again when it contracts by less than 10. A step that does
    not converge is halved, up to ten times; ``stats["halvings"]`` counts, and a real-time loop that must not pay for
    this asserts that it is zero.

    Args:
        scene: what moves.
        dt: control interval in s.
        step: internal step in s, at most; ``dt`` is cut into equal ones.
        stages: 1 (implicit midpoint), 2 or 3.
        tolerance: of the strains in parts of their nominal size (1/L), below which the last Newton correction must be.
        stations: stations whose fields ``reset`` and ``step`` measure (see ``Fields``).
        balance: ``"auto"``, ``"direct"`` or ``"variational"`` equations: see ``equations_of_motion``.
    """

    scheme = "Gauss"
    counters = ("nsteps", "iterations", "halvings")

    def __init__(
        self,
        scene: Scene,
        dt: float,
        step: float = 1e-3,
        stages: int = 2,
        tolerance: float = 1e-10,
        stations: int | ArrayLike = 6,
        balance: str = "auto",
    ) -> None:
        super().__init__(scene, dt, stations, balance)
        self.substeps = int(np.ceil(self.dt / positive(step, "Stepper step", "s") - 1e-9))
        self.tolerance = positive(tolerance, "Stepper tolerance")
        self.stages = count(stages, "Stepper stages")
        if self.stages > 3:
            raise ValueError(f"Stepper stages = {stages}; expected 1, 2 or 3")
        rule = GaussRule(1.0, self.stages)
        self._c, self._b, self._a = rule.nodes, rule.weights, rule.integration
        self._guess: Array | None = None
        self._matrix: tuple[float, ca.DM] | None = None
        self._iterations = 0

    # Functions of the equations --------------------------------------------------------------------------------------

    @cached_property
    def _newton(self) -> ca.Function:
        """``(x, u0, u1, h, z) -> z, last two corrections, inverse matrix``: iterations with a new matrix."""
        x, u0, u1, h, z = self._symbols
        n, s = self.scene.n_strains, self.stages
        residual = self.equations.native(self.equations.motion_residual)
        at = self._at_stages(x, z, (u0, u1), h)
        blocks = residual.jacobian().map(s)(*at, ca.DM(n, s))
        matrix = self._iteration_matrix([ca.horzsplit(block, n) for block in blocks[:3]], h)
        inverse = ca.solve(matrix, ca.DM.eye(s * n), "lapacklu")
        sizes = [ca.MX(np.inf)]
        for _ in range(ITERATIONS):
            z, size = self._corrected(x, u0, u1, h, z, inverse)
            sizes.append(size)
        return ca.Function("newton", list(self._symbols), [z, *sizes[-2:], inverse])

    @cached_property
    def _iteration(self) -> ca.Function:
        """``(x, u0, u1, h, z, inverse) -> z, correction``."""
        inverse = ca.MX.sym("inverse", *[self.stages * self.scene.n_strains] * 2)
        symbols = [*self._symbols, inverse]
        return ca.Function("iteration", symbols, list(self._corrected(*symbols)))

    @cached_property
    def _symbols(self) -> tuple[ca.MX, ...]:
        n, m = self.scene.n_strains, self.scene.n_inputs
        sizes = {"x": (2 * n, 1), "u0": (m, 1), "u1": (m, 1), "h": (1, 1), "z": (n, self.stages)}
        return tuple(ca.MX.sym(name, *size) for name, size in sizes.items())

    def _corrected(self, x: ca.MX, u0: ca.MX, u1: ca.MX, h: ca.MX, z: ca.MX, inverse: ca.MX) -> tuple[ca.MX, ca.MX]:
        residual = self.equations.native(self.equations.motion_residual).map(self.stages)
        change = ca.reshape(inverse @ ca.vec(residual(*self._at_stages(x, z, (u0, u1), h))), *z.shape)
        nominal = ca.DM(np.tile(self.scene.nominal_strains, (self.stages, 1)).T)
        return z - change, h**2 * ca.norm_fro(change / nominal)  # norm_inf of CasADi passes over NaN

    @cached_property
    def _derivatives(self) -> ca.Function:
        """The same without simplification."""
        xi, xi_t, xi_tt, u, balance = self.equations.dynamic_balance
        residual = balance.residual / ca.DM(self.equations.nominal_residual)
        symbols = [xi, xi_t, xi_tt, u]
        blocks = [ca.jacobian(residual, symbol) for symbol in symbols]
        return ca.Function("derivatives", symbols, blocks, {"cse": True}).map(self.stages)

    @cached_property
    def _powers(self) -> ca.Function:
        return powers(self.equations).map(self.stages)

    # One internal step -----------------------------------------------------------------------------------------------

    def _at_stages(self, x: Any, z: Any, u: tuple[Any, Any], h: Any) -> tuple[Any, Any, Any, Any]:
        """Strains, rates, accelerations (n, s) and inputs (m, s) at the stages of a step from ``x``; numpy or MX."""
        n, c, one = self.scene.n_strains, self._c[None, :], np.ones((1, self.stages))
        xi, xi_t = x[:n].reshape((n, 1)), x[n : 2 * n].reshape((n, 1))
        start, end = (value.reshape((self.scene.n_inputs, 1)) for value in u)
        shape = xi @ one + h * (xi_t @ c) + h * h * (z @ (self._a @ self._a).T)
        return shape, xi_t @ one + h * (z @ self._a.T), z, start @ (1.0 - c) + end @ c

    def _iteration_matrix(self, blocks: Sequence[Sequence[Any]], h: Any) -> Any:
        """Derivative (s n, s n) of the stage residuals with respect to the stage accelerations.

        ``blocks`` are the derivatives with respect to strains, rates and accelerations, each a list over the stages.
        """
        a, stages = self._a, range(self.stages)
        twice = a @ a
        of_shape, of_rate, mass = blocks
        rows = [[h * h * twice[i, j] * of_shape[i] + h * a[i, j] * of_rate[i] for j in stages] for i in stages]
        for i in stages:
            rows[i][i] = rows[i][i] + mass[i]
        return np.block(rows) if isinstance(mass[0], np.ndarray) else ca.blockcat(rows)

    def _end(self, x: Array, z: Array, h: float) -> Array:
        """State [xi, xi_t] at the end of the step."""
        n = self.scene.n_strains
        xi, xi_t = x[:n], x[n : 2 * n]
        return np.concatenate([xi + h * xi_t + h * h * z @ (self._b @ self._a), xi_t + h * z @ self._b])

    def _solve_by_last_matrix(self, x: Array, u: tuple[Array, Array], h: float, z: Array) -> Array | None:
        """Stage accelerations (n, s) by the matrix of the step before, or None where that contracts too slowly."""
        if self._matrix is None or self._matrix[0] != h:
            return None
        last = LARGEST_CORRECTION
        while True:
            self._iterations += 1
            found, correction = self._iteration(x, *u, h, z, self._matrix[1])
            z, size = np.asarray(found, float), float(correction)
            if size <= self.tolerance:
                return z
            if not size < SLOW * last:
                return z if size <= ROUNDING else None
            last = size

    def _solve(self, x: Array, u: tuple[Array, Array], h: float, z: Array) -> Array | None:
        """Stage accelerations (n, s) from the guess ``z``, or None where Newton's method does not converge."""
        known = self._solve_by_last_matrix(x, u, h, z)
        if known is not None:
            return known
        self._matrix = None
        best = LARGEST_CORRECTION
        for _ in range(MATRICES):
            self._iterations += ITERATIONS
            try:
                found, before, after, inverse = self._newton(x, *u, h, z)
            except RuntimeError:  # a singular matrix
                return None
            last, size = float(before), float(after)
            while self.tolerance < size < SLOW * last:
                self._iterations += 1
                found, after = self._iteration(x, *u, h, found, inverse)
                last, size = size, float(after)
            if not size <= best:  # far away there are solutions that no motion leads to
                return None
            z, best = np.asarray(found, float), size
            if size <= max(self.tolerance, ROUNDING):
                self._matrix = (h, inverse)
                return z
        return None

    def _advance(self, x: Array, u: tuple[Array, Array], h: float, depth: int = 0) -> list[_Piece]:
        """One step ``h`` from ``x`` with inputs from ``u[0]`` to ``u[1]``, in one piece or in halves."""
        zero = np.zeros((self.scene.n_strains, self.stages))
        for guess in (self._guess, zero) if self._guess is not None else (zero,):
            z = self._solve(x, u, h, guess)
            if z is not None:
                self._guess = z @ self._onwards
                return [_Piece(x, z, u, h, self._end(x, z, h))]
        if depth == MAX_HALVINGS:
            raise RuntimeError(f"Newton's method does not converge in steps of {h:.1e} s")
        self._guess = None
        middle = 0.5 * (u[0] + u[1])
        first = self._advance(x, (u[0], middle), 0.5 * h, depth + 1)
        return first + self._advance(first[-1].end, (middle, u[1]), 0.5 * h, depth + 1)

    @cached_property
    def _onwards(self) -> Array:
        """Weights (s, s) that extrapolate a polynomial at the stages of one step to those of the next."""
        here, there = np.vander(self._c, self.stages), np.vander(1.0 + self._c, self.stages)
        return np.asarray(np.linalg.solve(here.T, there.T), dtype=np.float64)

    def _interval(self, x: Array, before: Array, command: Array) -> list[_Piece]:
        """All pieces of one ``dt``; inputs move linearly from ``before`` to ``command``."""
        pieces: list[_Piece] = []
        for k in range(self.substeps):
            ends = (before + (command - before) * (k + j) / self.substeps for j in (0, 1))
            made = self._advance(x, tuple(ends), self.dt / self.substeps)  # type: ignore[arg-type]
            if len(made) > 1:
                self._guess = None
            x = made[-1].end
            pieces += made
        return pieces

    # Trajectories ----------------------------------------------------------------------------------------------------

    def _integrate(self, start: Array, commands: Array, energy: bool = False) -> tuple[Array, dict[str, int]]:
        n = self.scene.n_strains
        x, before = start[: 2 * n], start[2 * n :]
        self._guess, self._matrix, self._iterations, taken = None, None, 0, 0
        work = np.zeros(len(self.scene.terms) if energy else 0)
        rows = []
        for command in commands:
            pieces = self._interval(x, before, command)
            if energy:
                work = work + sum(self._work(piece) for piece in pieces)
            x, before = pieces[-1].end, command
            taken += len(pieces)
            rows.append(np.concatenate([x, work]))
        halvings = taken - self.substeps * len(commands)
        return np.array(rows), {"nsteps": taken, "iterations": self._iterations, "halvings": halvings}

    def _work(self, piece: _Piece) -> Array:
        """Work (n_terms,) of the terms over one piece, by the quadrature of the scheme."""
        shape, rate, _, inputs = self._at_stages(piece.x, piece.z, piece.u, piece.h)
        work: Array = piece.h * np.asarray(self._powers(shape, rate, inputs)) @ self._b
        return work

    # Sensitivities ---------------------------------------------------------------------------------------------------

    def sensitivity(self, x: ArrayLike, u: ArrayLike) -> StepSensitivity:
        """One step of ``dt`` from state ``x`` (n_states,) under command ``u`` (n_inputs,), and its exact derivatives.

        The derivatives are those of the discrete step, by the implicit function theorem on every stage.
        Raises RuntimeError where the step fails.
        """
        n, m = self.scene.n_strains, self.scene.n_inputs
        start = finite_array(x, "x", (self.scene.n_states,))
        command = self.scene.checked_inputs(u, "u", (m,))
        self._guess = self._matrix = None
        slope = np.hstack([np.eye(2 * n), np.zeros((2 * n, 2 * m))])  # d [xi, xi_t] / d [xi, xi_t, u before, command]
        time = 0.0
        end = start[: 2 * n]
        for piece in self._interval(start[: 2 * n], start[2 * n :], command):
            ends = np.array([time, time + piece.h]) / self.dt
            slope = self._slope(piece, slope, ends)
            time, end = time + piece.h, piece.end
        below = np.zeros((m, 2 * n + m))
        return StepSensitivity(
            x=np.concatenate([end, command]),
            d_state=np.vstack([slope[:, : 2 * n + m], below]),
            d_input=np.vstack([slope[:, 2 * n + m :], np.eye(m)]),
        )

    def _slope(self, piece: _Piece, slope: Array, ends: Array) -> Array:
        """Derivative of [xi, xi_t] after a piece from that before it; ``ends`` are its times in parts of ``dt``."""
        n, m, s, h = self.scene.n_strains, self.scene.n_inputs, self.stages, piece.h
        derivatives = self._derivatives(*self._at_stages(piece.x, piece.z, piece.u, h))
        of_shape, of_rate, mass, of_input = (np.split(np.asarray(block), s, axis=1) for block in derivatives)
        matrix = self._iteration_matrix([of_shape, of_rate, mass], h)
        d_xi, d_xi_t = slope[:n], slope[n:]
        d_inputs = np.zeros((2, m, slope.shape[1]))  # of the inputs at both ends of the piece
        for k, fraction in enumerate(ends):
            d_inputs[k, :, 2 * n : 2 * n + m] = (1.0 - fraction) * np.eye(m)
            d_inputs[k, :, 2 * n + m :] = fraction * np.eye(m)
        rows = []
        for i, c in enumerate(self._c):
            d_u = d_inputs[0] + c * (d_inputs[1] - d_inputs[0])
            rows.append(of_shape[i] @ (d_xi + h * c * d_xi_t) + of_rate[i] @ d_xi_t + of_input[i] @ d_u)
        d_z = -np.linalg.solve(matrix, np.vstack(rows)).reshape(s, n, -1)
        shape = d_xi + h * d_xi_t + h * h * np.tensordot(self._b @ self._a, d_z, 1)
        return np.vstack([shape, d_xi_t + h * np.tensordot(self._b, d_z, 1)])
