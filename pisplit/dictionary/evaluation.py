"""Numbers for the columns of Theta(x, u): on pairs, on phase-space samples, and their derivative along f."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from pisplit.dictionary.layout import Layout
from pisplit.mapping import Mapped

if TYPE_CHECKING:
    from pisplit.data.episodes import Pairs

Array = NDArray[np.float64]


class Evaluation(Layout):
    """A layout of columns whose values are computed, in blocks, by compiled functions."""

    @property
    def input_function(self) -> ca.Function:
        """phi: u (m,) -> (P,)."""
        return self.input_part.function

    @cached_property
    def lift_function(self) -> ca.Function:
        """psi: (x_history (n, D+1), u_history (m, D)) -> z (M_z,), columns are times, oldest first."""
        in_sx = self.state_part.function.is_a("SXFunction") and self.input_function.is_a("SXFunction")
        kind: Any = ca.SX if in_sx else ca.MX
        last = self.n_delays
        x = kind.sym("x_history", self.n_states, last + 1)
        u = kind.sym("u_history", self.n_inputs, last)
        parts: list[Any] = [self.state_part.function(x[:, last])]
        parts += [x[:, last - j] for j in range(1, self.state_delays + 1)]
        parts += [self.input_function(u[:, last - j]) for j in range(1, self.input_delays + 1)]
        return ca.Function("lift", [x, u], [ca.densify(ca.vertcat(*parts))])

    def evaluate(self, pairs: Pairs) -> Array:
        """Theta (N, M) = [psi_k, phi(u_k)] of snapshot pairs, with the products of a bilinear dictionary."""
        return self._theta(self._psi(pairs.x, pairs.x_history, pairs.u_history), pairs.u)

    def next_learned(self, pairs: Pairs) -> Array:
        """The learned columns of psi (N, S) of ``pairs`` one step later, functions of x_{k+1} alone."""
        return self._present(pairs.x_next)[:, self.learned_columns]

    def next(self, pairs: Pairs) -> Array:
        """psi (N, M_z) of ``pairs`` one step later, K psi = psi o F (eq. koopman_def).

        The history is shifted, with x_{k+1} and u_k at its end.
        """
        x_next, states, inputs = pairs.x_next, pairs.x_history, pairs.u_history
        states = np.concatenate([states[:, 1:], x_next[:, None]], axis=1)
        inputs = np.concatenate([inputs, pairs.u[:, None]], axis=1)[:, 1:] if self.n_delays else inputs
        return self._psi(x_next, states, inputs)

    def present(self, states: Array) -> Array:
        """The present columns of psi (N, n_present) at states (N, n)."""
        return self._present(states)

    def features(self, inputs: Array) -> Array:
        """phi (N, P) at inputs (N, m)."""
        return self._features(inputs)

    def evaluate_static(self, states: Array, inputs: Array) -> Array:
        """Theta (N, M) at phase-space samples, ``states`` (N, n) and ``inputs`` (N, m): the past equals the present."""
        history = np.broadcast_to(states[:, None], (len(states), self.n_delays + 1, self.n_states))
        past = np.broadcast_to(inputs[:, None], (len(inputs), self.n_delays, self.n_inputs))
        return self._theta(self._psi(states, history, past), inputs)

    def lie_derivative(self, states: Array, inputs: Array, velocities: Array) -> Array:
        """J_x Theta . f (N, M) at ``states`` (N, n) and ``inputs`` (N, m) (paper, eq. jacob_solve).

        f are the ``velocities`` (N, n).

        One forward-mode product a sample. Inputs and delays do not move with f: their columns are zero.
        """
        derivative = np.zeros((len(states), self.n_columns))
        derivative[:, : self.n_present] = self.present_derivative(states, velocities)
        if self.is_bilinear:
            products = inputs[:, :, None] * derivative[:, None, self.products]
            derivative[:, self.n_lifted + self.n_features :] = products.reshape(len(states), -1)
        return derivative

    def present_derivative(self, states: Array, velocities: Array) -> Array:
        """Lie derivative (N, n_present) of the present columns alone, grad_x g . f (eq. lie_deriv).

        ``states`` (N, n) and ``velocities`` (N, n), the values of f.
        """
        return self._derivative(states, velocities)

    def _theta(self, psi: Array, inputs: Array) -> Array:
        features = self.features(inputs)
        if not self.is_bilinear:
            return np.hstack([psi, features])
        products = inputs[:, :, None] * psi[:, None, self.products]
        return np.hstack([psi, features, products.reshape(len(psi), -1)])

    def _psi(self, states: Array, x_history: Array, u_history: Array) -> Array:
        n, last = len(states), self.n_delays
        psi = np.empty((n, self.n_lifted))
        psi[:, : self.n_present] = self._present(states)
        at = self.n_present
        for j in range(1, self.state_delays + 1):
            psi[:, at : at + self.n_states] = x_history[:, last - j]
            at += self.n_states
        for j in range(1, self.input_delays + 1):
            psi[:, at : at + self.n_features] = self._features(np.ascontiguousarray(u_history[:, last - j]))
            at += self.n_features
        return psi

    @cached_property
    def _present(self) -> Mapped:
        return Mapped(self.state_part.function)

    @cached_property
    def _features(self) -> Mapped:
        return Mapped(self.input_part.function)

    @cached_property
    def _derivative(self) -> Mapped:
        function = self.state_part.function
        kind: Any = ca.SX if function.is_a("SXFunction") else ca.MX
        x, v = kind.sym("x", self.n_states), kind.sym("v", self.n_states)
        return Mapped(ca.Function("lie_derivative", [x, v], [ca.densify(ca.jtimes(function(x), x, v))]))

    def __getstate__(self) -> dict[str, Any]:
        return {k: v for k, v in self.__dict__.items() if k not in ("_present", "_features", "_derivative")}
