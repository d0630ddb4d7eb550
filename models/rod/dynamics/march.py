"""Steps of a collocation one after another: Newton's method from step to step, halving where it fails."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import casadi as ca
import numpy as np

from pisplit.checks import Array
from pisplit.models.rod.dynamics.collocation import ITERATIONS, Collocation

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
class Piece:
    """One internal step.

    Attributes:
        x: [xi, xi_t] (2n,) before it; end: the same after it.
        z: accelerations (n, s) at its stages.
        u: inputs (m,) at both ends.
        h: its length in s.
        inverse: of the matrix by which it was found.
    """

    x: Array
    z: Array
    u: tuple[Array, Array]
    h: float
    end: Array
    inverse: ca.DM | Array


@dataclass(frozen=True, eq=False)
class Hint:
    """What is known of a step from another motion nearby.

    Attributes:
        z: guess (n, s) of the accelerations at its stages.
        h: its length in s.
        inverse: of the iteration matrix.
    """

    z: Array
    h: float
    inverse: ca.DM | Array


class March:
    """Internal steps that carry the guess and the iteration matrix from each to the next; made for one motion.

    Args:
        scheme: functions of a step.
        tolerance: of the strains in parts of their nominal size, below which the last Newton correction must be.
        slow: contraction of the iteration beyond which its matrix is formed anew.
        halvings: how often a step may be halved.

    ``iterations`` counts those of Newton's method.
    """

    def __init__(self, scheme: Collocation, tolerance: float, slow: float = SLOW, halvings: int = MAX_HALVINGS) -> None:
        self.scheme, self.tolerance, self.slow, self.halvings = scheme, tolerance, slow, halvings
        self.iterations = 0
        self._guess: Array | None = None
        self._matrix: tuple[float, ca.DM | Array] | None = None

    def interval(
        self, x: Array, before: Array, command: Array, dt: float, substeps: int, hints: Sequence[Hint] = ()
    ) -> list[Piece]:
        """All internal steps of one control interval: ``cut`` into equal ones.

        Args:
            x: [xi, xi_t] (2n,) at its start.
            before: inputs (m,) at its start; they move linearly to ``command`` (m,).
            command: inputs at its end.
            dt: its length in s.
            substeps: number of equal steps, each of which may be halved.
            hints: where each of them is looked for first; nothing if they are not as many.

        Raises RuntimeError where Newton's method does not converge in the smallest steps.
        """
        return self.cut(x, before, command, dt, np.arange(substeps + 1) / substeps, hints)

    def cut(
        self, x: Array, before: Array, command: Array, dt: float, at: Array, hints: Sequence[Hint] = ()
    ) -> list[Piece]:
        """The same from ``x`` (2n,) under ``before`` to ``command`` (m,) in steps between the times ``at`` (k,).

        These rise from 0 to 1, in parts of ``dt``; ``hints`` as in ``interval``.
        """
        pieces: list[Piece] = []
        for k, (first, last) in enumerate(pairwise(at)):
            start, end = before + (command - before) * first, before + (command - before) * last
            hint, h = (hints[k] if len(hints) == len(at) - 1 else None), dt * (last - first)
            made = self._hinted(x, (start, end), h, hint) or self._advance(x, (start, end), h)
            if len(made) > 1:
                self._guess = None
            x = made[-1].end
            pieces += made
        return pieces

    def _hinted(self, x: Array, u: tuple[Array, Array], h: float, hint: Hint | None) -> list[Piece]:
        """One step ``h`` as the ``hint`` says; none where that leads nowhere."""
        if hint is None or hint.h != h:
            return []
        z = self._iterated(x, u, h, hint.z, hint.inverse)
        if z is None:
            return []
        self._matrix, self._guess = (h, hint.inverse), z @ self.scheme.onwards
        return [Piece(x, z, u, h, self.scheme.end(x, z, h), hint.inverse)]

    def _advance(self, x: Array, u: tuple[Array, Array], h: float, depth: int = 0) -> list[Piece]:
        """One step ``h`` from ``x`` with inputs from ``u[0]`` to ``u[1]``, in one piece or in halves."""
        zero = np.zeros((self.scheme.equations.n_strains, self.scheme.stages))
        for guess in (self._guess, zero) if self._guess is not None else (zero,):
            z = self._solve(x, u, h, guess)
            if z is not None and self._matrix is not None:
                self._guess = z @ self.scheme.onwards
                return [Piece(x, z, u, h, self.scheme.end(x, z, h), self._matrix[1])]
        if depth == self.halvings:
            raise RuntimeError(f"Newton's method does not converge in steps of {h:.1e} s")
        self._guess = None
        middle = 0.5 * (u[0] + u[1])
        first = self._advance(x, (u[0], middle), 0.5 * h, depth + 1)
        return first + self._advance(first[-1].end, (middle, u[1]), 0.5 * h, depth + 1)

    def _solve(self, x: Array, u: tuple[Array, Array], h: float, z: Array) -> Array | None:
        """Stage accelerations (n, s) from the guess ``z``, or None where Newton's method does not converge."""
        known = self._solve_by_last_matrix(x, u, h, z)
        if known is not None:
            return known
        self._matrix, newton = None, self.scheme.newton
        best = LARGEST_CORRECTION
        for _ in range(MATRICES):
            self.iterations += ITERATIONS
            try:
                found, before, after, inverse = newton(x, *u, h, z)
            except RuntimeError:  # a singular matrix
                return None
            last, size = float(before), float(after)
            while self.tolerance < size < self.slow * last:
                self.iterations += 1
                found, after = self.scheme.iteration(x, *u, h, found, inverse)
                last, size = size, float(after)
            if not size <= best:  # far away there are solutions that no motion leads to
                return None
            z, best = np.asarray(found, float), size
            if size <= max(self.tolerance, ROUNDING):
                self._matrix = (h, inverse)
                return z
        return None

    def _solve_by_last_matrix(self, x: Array, u: tuple[Array, Array], h: float, z: Array) -> Array | None:
        """The same by the matrix of the step before, or None where that contracts too slowly."""
        if self._matrix is None or self._matrix[0] != h:
            return None
        return self._iterated(x, u, h, z, self._matrix[1])

    def _iterated(self, x: Array, u: tuple[Array, Array], h: float, z: Array, inverse: ca.DM | Array) -> Array | None:
        """The same by a given ``inverse`` matrix."""
        last = LARGEST_CORRECTION
        while True:
            self.iterations += 1
            found, correction = self.scheme.iteration(x, *u, h, z, inverse)
            z, size = np.asarray(found, float), float(correction)
            if size <= self.tolerance:
                return z
            if not size < self.slow * last:
                return z if size <= ROUNDING else None
            last = size
