"""Systems x' = f(x, u) + h(x, u) with a known and an unknown part, written in CasADi symbols."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from pisplit.checks import count, finite_array, one_of, positive
from pisplit.mapping import Mapped

Array = NDArray[np.float64]


class ControlSystem:
    """x' = f(x, u) + h(x, u) (paper, eq. linearly_separable_diffeq), f known to the identification, h not.

    x (n,) and u (m,) are symbols (SX or MX), ``known`` and ``unknown`` expressions (n,) in them.
    ``known``, ``unknown`` and ``rhs`` (eq. x_diff_eq) are then CasADi Functions (x, u) -> (n,).

    Args:
        x, u: symbols of states and inputs.
        known, unknown: f and h.
        state_names, input_names: one text an entry; x1, u1, ... when not given.
        state_units, input_units: one text an entry, such as "m/s"; empty when not given.

    Raises ValueError if x or u is no column of symbols, or if an expression has another size or other free symbols.
    """

    def __init__(
        self,
        x: ca.SX | ca.MX,
        u: ca.SX | ca.MX,
        known: ca.SX | ca.MX,
        unknown: ca.SX | ca.MX,
        state_names: Sequence[str] | None = None,
        input_names: Sequence[str] | None = None,
        state_units: Sequence[str] | None = None,
        input_units: Sequence[str] | None = None,
    ) -> None:
        for symbol, what in ((x, "x"), (u, "u")):
            if not isinstance(symbol, ca.SX | ca.MX) or symbol.shape[1] != 1 or not symbol.is_valid_input():
                raise ValueError(f"{what} is not a column of CasADi symbols; make it with SX.sym or MX.sym")
        self.n_states, self.n_inputs = int(x.shape[0]), int(u.shape[0])
        self.state_names = _named(state_names, "state_names", self.n_states, "x")
        self.input_names = _named(input_names, "input_names", self.n_inputs, "u")
        self.state_units = _units(state_units, "state_units", self.n_states)
        self.input_units = _units(input_units, "input_units", self.n_inputs)
        kind: Any = type(x)
        self.known = _field("known", x, u, kind(known))
        self.unknown = _field("unknown", x, u, kind(unknown))
        self.rhs = _field("rhs", x, u, kind(known) + kind(unknown))

    def simulate(self, x0: ArrayLike, inputs: ArrayLike, dt: float, method: str = "rk4", substeps: int = 1) -> Array:
        """States (T+1, n) from x0 (n,) under inputs (T, m), each held over dt [s] (paper, eq. x_flow_map).

        ``method`` "rk4" takes ``substeps`` classical Runge-Kutta steps per dt, "idas" controls its error itself (1e-9).
        Raises ValueError for wrong shapes and if the solution leaves the finite numbers.
        """
        start = finite_array(x0, "x0", (self.n_states,))
        controls = finite_array(inputs, "inputs", (None, self.n_inputs))
        step = self._flow(self.rhs, positive(dt, "dt", "s"), method, substeps)
        # mapaccum runs the whole trajectory inside CasADi: no Python between the steps.
        steps = len(controls)
        states = np.array(step.mapaccum(steps)(start, controls.T)).T if steps else np.zeros((0, self.n_states))
        trajectory = np.vstack([start, states])
        if not np.isfinite(trajectory).all():
            first = int(np.argmin(np.isfinite(trajectory).all(axis=1)))
            raise ValueError(f"the solution is not finite from step {first} on; reduce dt or use more substeps")
        return trajectory

    def known_flow(self, states: Array, inputs: Array, t: float, method: str = "rk4", substeps: int = 8) -> Array:
        """Flow of the known f alone over ``t`` seconds from states (N, n) at constant inputs (N, m).

        ``method`` and ``substeps`` as in ``simulate``.
        """
        return Mapped(self._flow(self.known, positive(t, "t", "s"), method, substeps))(states, inputs)

    def _flow(self, field: ca.Function, t: float, method: str, substeps: int) -> ca.Function:
        one_of(method, "method", ("rk4", "idas"))
        x, u = ca.MX.sym("x", self.n_states), ca.MX.sym("u", self.n_inputs)
        if method == "idas":
            options = {"reltol": 1e-9, "abstol": 1e-10}
            solver = ca.integrator("flow", "idas", {"x": x, "p": u, "ode": field(x, u)}, 0.0, t, options)
            return ca.Function("flow", [x, u], [solver(x0=x, p=u)["xf"]])
        h = t / count(substeps, "substeps")
        end = x
        for _ in range(substeps):
            k1 = field(end, u)
            k2 = field(end + h / 2 * k1, u)
            k3 = field(end + h / 2 * k2, u)
            k4 = field(end + h * k3, u)
            end = end + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        return ca.Function("flow", [x, u], [end])


def _field(name: str, x: Any, u: Any, expression: Any) -> ca.Function:
    if expression.shape != x.shape:
        raise ValueError(f"{name} has shape {expression.shape}; expected {x.shape}, one entry a state")
    try:
        return ca.Function(name, [x, u], [ca.densify(expression)], ["x", "u"], ["xdot"])
    except RuntimeError:
        raise ValueError(f"{name} contains symbols other than x and u; give them values first") from None


def _named(given: Sequence[str] | None, what: str, size: int, letter: str) -> tuple[str, ...]:
    names = tuple(f"{letter}{i + 1}" for i in range(size)) if given is None else tuple(given)
    if len(names) != size or len(set(names)) != size:
        raise ValueError(f"{what} = {names}; expected {size} different names")
    return names


def _units(given: Sequence[str] | None, what: str, size: int) -> tuple[str, ...]:
    units = ("",) * size if given is None else tuple(given)
    if len(units) != size:
        raise ValueError(f"{what} has {len(units)} entries; expected {size}")
    return units
