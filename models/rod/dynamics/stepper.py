"""Dynamics by Gauss collocation in time with a fixed step."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from pisplit.checks import Array, count, finite_array, positive
from pisplit.models.rod.dynamics.collocation import Collocation
from pisplit.models.rod.dynamics.march import March, Piece
from pisplit.models.rod.dynamics.propagation import Propagation
from pisplit.models.rod.dynamics.trajectory import StepSensitivity
from pisplit.models.rod.sharing import in_turn

if TYPE_CHECKING:
    from pisplit.models.rod.scene import Scene

#: Internal steps after which it pays to share the subexpressions of the residual and of its Jacobian.
MANY = 3000


class Stepper(Propagation):
    """Motion of a scene in equal internal steps: for undamped rods and for hard real time.

    Gauss collocation has order ``2 * stages``, keeps quadratic invariants and damps nothing, so that the energy of an
    undamped rod stays where it is; strongly overdamped modes, and Maxwell branches that start under stress and relax
    within a step, settle no faster than the step (IDAS is better there).
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
    remedy = "give a smaller step"
    checked_steps = 1000
    damps_waves = False

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
        self.balance = balance
        self._moved = 0

    @property
    def setting(self) -> tuple[object, ...]:
        return self.scheme, self.dt / self.substeps, self.stages

    def _on(self, scene: Scene, finer: float = 0.1) -> Stepper:
        half = self.dt / (2 * self.substeps)
        return Stepper(scene, self.dt, half, self.stages, self.tolerance, balance=self.balance)

    @cached_property
    def collocation(self) -> Collocation:
        """The functions of one internal step."""
        return Collocation(self.equations, self.stages)

    @cached_property
    def _shared(self) -> Collocation:
        return Collocation(self.equations, self.stages, self.collocation.family, shared=True)

    # Trajectories ----------------------------------------------------------------------------------------------------

    def integrate(self, start: Array, commands: Array, energy: bool = False) -> tuple[Array, dict[str, int]]:
        """States (T, n_moving) after each command: see ``Propagation.integrate``.

        Args:
            start: state [xi, xi_t, u] (n_states,).
            commands: (T, n_inputs).
            energy: whether to add the work of every term since the start.
        """
        layout = self.scene.layout
        x, before = start[layout.moving], start[layout.inputs]
        self._moved += self.substeps * len(commands)
        march, taken = March(self._shared if self._moved > MANY else self.collocation, self.tolerance), 0
        work = np.zeros(len(self.scene.terms) if energy else 0)
        rows = []
        for command in commands:
            pieces = march.interval(x, before, command, self.dt, self.substeps)
            if energy:
                work = work + sum(self._work(piece) for piece in pieces)
            x, before = pieces[-1].end, command
            taken += len(pieces)
            rows.append(np.concatenate([x, work]))
        halvings = taken - self.substeps * len(commands)
        return np.array(rows), {"nsteps": taken, "iterations": march.iterations, "halvings": halvings}

    def _work(self, piece: Piece) -> Array:
        """Work (n_terms,) of the terms over one piece, by the quadrature of the scheme."""
        scheme = self.collocation
        shape, rate, _, inputs = scheme.at_stages(piece.x, piece.z, piece.u, piece.h)
        work: Array = piece.h * np.asarray(scheme.powers(shape, rate, inputs)) @ scheme.b
        return work

    # Sensitivities ---------------------------------------------------------------------------------------------------

    @in_turn("equations")
    def sensitivity(self, x: ArrayLike, u: ArrayLike) -> StepSensitivity:
        """One step of ``dt`` from a state under a command, and its exact derivatives.

        The derivatives are those of the discrete step, by the implicit function theorem on every stage.

        Args:
            x: state [xi, xi_t, u] (n_states,) before the step.
            u: command (n_inputs,).

        Raises RuntimeError where the step fails.
        """
        m, layout = self.scene.n_inputs, self.scene.layout
        q = layout.n_moving
        start = finite_array(x, "x", (self.scene.n_states,))
        command = self.scene.checked_inputs(u, "u", (m,))
        slope = np.hstack([np.eye(q), np.zeros((q, 2 * m))])  # d [xi, xi_t] / d [xi, xi_t, u before, command]
        time = 0.0
        end, pieces = self._pieces(start, command)
        for piece in pieces:
            ends = np.array([time, time + piece.h]) / self.dt
            slope = self._slope(piece, slope, ends)
            time += piece.h
        below = np.zeros((m, layout.size))
        return StepSensitivity(
            x=np.concatenate([end, command]),
            d_state=np.vstack([slope[:, : layout.size], below]),
            d_input=np.vstack([slope[:, layout.size :], np.eye(m)]),
        )

    def _pieces(self, start: Array, command: Array) -> tuple[Array, list[Piece]]:
        """The end (n_moving,) of one step and the pieces it was taken in."""
        layout = self.scene.layout
        march = March(self.collocation, self.tolerance)
        pieces = march.interval(start[layout.moving], start[layout.inputs], command, self.dt, self.substeps)
        return pieces[-1].end, pieces

    def _slope(self, piece: Piece, slope: Array, ends: Array) -> Array:
        """Derivative of [xi, xi_t] after a piece from that before it; ``ends`` are its times in parts of ``dt``."""
        m = self.scene.n_inputs
        d_inputs = np.zeros((2, m, slope.shape[1]))
        for k, fraction in enumerate(ends):
            d_inputs[k, :, self.scene.layout.inputs] = (1.0 - fraction) * np.eye(m)
            d_inputs[k, :, self.scene.n_states :] = fraction * np.eye(m)
        return self.carried(piece, slope, d_inputs)[0]

    def carried(self, piece: Piece, slope: Array, d_inputs: Array) -> tuple[Array, Array, Array]:
        """Derivatives in c parameters of the state after a ``piece`` (n_moving, c) and of its accelerations (s, n, c).

        By the implicit function theorem on its stages, from the derivatives before it, ``slope`` (n_moving, c) of the
        state and ``d_inputs`` (2, n_inputs, c) of the inputs at its two ends. The inverse of its matrix comes third.
        """
        scheme, h = self.collocation, piece.h
        n, s = self.scene.n_strains, scheme.stages
        derivatives = scheme.derivatives(*scheme.at_stages(piece.x, piece.z, piece.u, h))
        of_shape, of_rate, mass, of_acting = (np.split(np.asarray(block), s, axis=1) for block in derivatives)
        matrix = scheme.iteration_matrix([of_shape, of_rate, mass, of_acting], h)
        d_xi, d_xi_t, layout = slope[:n], slope[n : 2 * n], self.scene.layout
        of_sigma, of_input = zip(*(np.split(block, [layout.n_overstress], axis=1) for block in of_acting), strict=True)
        # of the overstress at the stages and the end under the accelerations that stay: (s+1, b n, ...)
        d_sigma = np.zeros((s + 1, 0, slope.shape[1]))
        if self.scene.branches:
            free = [scheme.overstress.along(column, np.zeros((n, s)), h).T for column in slope.T]
            d_sigma = np.moveaxis(np.array(free), 0, -1)
        rows = []
        for i, c in enumerate(scheme.c):
            d_u = d_inputs[0] + c * (d_inputs[1] - d_inputs[0])
            row = of_shape[i] @ (d_xi + h * c * d_xi_t) + of_rate[i] @ d_xi_t + of_input[i] @ d_u
            rows.append(row + of_sigma[i] @ d_sigma[i])
        inverse = np.linalg.inv(matrix)
        d_z = -(inverse @ np.vstack(rows)).reshape(s, n, -1)
        shape = d_xi + h * d_xi_t + h * h * np.tensordot(scheme.b @ scheme.a, d_z, 1)
        bent = [np.tensordot(w[2:, -1], d_z[:, : layout.n_free], 1) for w in scheme.overstress.weights(h)]
        hidden = [d_sigma[-1] + np.vstack(bent)] if bent else []
        return np.vstack([shape, d_xi_t + h * np.tensordot(scheme.b, d_z, 1), *hidden]), d_z, inverse
