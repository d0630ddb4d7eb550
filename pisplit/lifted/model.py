"""The identified model: linear in the lifted state, ready for roll-outs and for MPC."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from functools import cached_property
from typing import TYPE_CHECKING, Any

import casadi as ca
import numpy as np
import scipy.linalg
from numpy.typing import ArrayLike, NDArray

from pisplit.brief import brief
from pisplit.checks import finite_array, positive, real_array
from pisplit.data import store
from pisplit.data.columns import in_order
from pisplit.data.rows import frozen, refrozen
from pisplit.dictionary.products import BilinearTerm, Transition, runs, span
from pisplit.lifted.propagation import propagate, propagate_bilinear, propagate_relifted
from pisplit.lifted.relifting import ReliftedTerm
from pisplit.lifted.rollout import Rollout
from pisplit.lifted.signature import check_signature, units_of
from pisplit.mapping import Mapped
from pisplit.threads import one_blas_thread

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

KIND = "pisplit/lifted-model"


@brief
@dataclass(frozen=True, eq=False)
class LiftedModel:
    """z+ = A z + B phi(u) + sum_i u_i N_i z + c (+ g(z, u)),  y = C z + d, in physical units.

    A (M, M), B (M, P), c (M,), C (n, M), d (n,), dt [s]; N (m, M, M), or None for a model linear in z: nothing is
    stored or computed then. ``relifted``: g(z, u), products that are evaluated anew at every step, or None.
    ``lift_function``: (x_history (n, D+1), u_history (m, D)) -> z (M,), columns are times, oldest first; x_history
    holds x_{k-D}..x_k and u_history u_{k-D}..u_{k-1} with D = ``n_delays``.
    ``input_function``: u (m,) -> phi (P,), the identity if the dictionary is linear in u.
    ``state_names`` (n,), ``input_names`` (m,), ``column_names`` (M,) of z, ``feature_names`` (P,) of phi.
    ``outputs``: named groups of states, e.g. {"tip": (120, 121, 122)}.
    ``input_offset`` (m,), ``input_basis`` (m, r): mean of the training inputs and an orthonormal basis of the
    directions in which they vary; a controller keeps u in input_offset + span(input_basis): the data know no other.
    ``state_range`` (n,): largest training magnitude per state; 1e3 times it counts as divergence.
    ``provenance``: JSON-able facts about the origin of the model.
    ``state_units`` (n,), ``input_units`` (m,): units as texts, those of the training data; "" where nobody said.

    Arrays are copied, and read-only; ``dataclasses.replace(model, A=...)`` makes another model. Raises ValueError for
    shapes that do not fit each other and for entries that are not finite.
    """

    A: Array
    B: Array
    c: Array
    C: Array
    d: Array
    dt: float
    lift_function: ca.Function
    input_function: ca.Function
    n_delays: int
    state_names: tuple[str, ...]
    input_names: tuple[str, ...]
    column_names: tuple[str, ...]
    feature_names: tuple[str, ...]
    input_offset: Array
    input_basis: Array
    state_range: Array
    outputs: Mapping[str, tuple[int, ...]] = field(default_factory=dict)
    provenance: Mapping[str, Any] = field(default_factory=dict)
    N: Array | None = None
    state_units: Sequence[str] | None = None
    input_units: Sequence[str] | None = None
    relifted: ReliftedTerm | None = None

    def __post_init__(self) -> None:
        n, m = len(self.state_names), len(self.input_names)
        columns, features = len(self.column_names), len(self.feature_names)
        basis = real_array(self.input_basis, "input_basis")
        shapes: dict[str, tuple[int | None, ...]] = {
            "A": (columns, columns),
            "B": (columns, features),
            "c": (columns,),
            "C": (n, columns),
            "d": (n,),
            "input_offset": (m,),
            "input_basis": (m, basis.shape[-1] if basis.ndim == 2 else None),
            "state_range": (n,),
        }
        for name, shape in shapes.items():
            object.__setattr__(self, name, frozen(finite_array(getattr(self, name), name, shape)))
        if self.N is not None:
            object.__setattr__(self, "N", frozen(finite_array(self.N, "N", (m, columns, columns))))
        if self.relifted is not None:
            given = len(self.relifted.weights), self.relifted.basis.shape[1]
            if given != (columns, columns + m):
                raise ValueError(f"relifted is of {given} rows and variables; expected {(columns, columns + m)}")
        for name, size in (("state_units", n), ("input_units", m)):
            object.__setattr__(self, name, units_of(getattr(self, name), name, size))
        positive(self.dt, "dt", "s")
        history = (n, self.n_delays + 1), (m, self.n_delays)
        check_signature(self.lift_function, "lift_function", history, columns)
        check_signature(self.input_function, "input_function", ((m, 1),), features)
        for name, indices in self.outputs.items():
            if any(not 0 <= i < n for i in indices):
                raise ValueError(f"outputs[{name!r}] = {tuple(indices)}; expected state indices from 0 to {n - 1}")
        try:
            json.dumps(dict(self.provenance))
        except TypeError as error:
            raise ValueError(f"provenance cannot be written as JSON: {error}; use numbers, texts, lists") from None

    @property
    def n_states(self) -> int:
        """Number of states n."""
        return len(self.state_names)

    @property
    def n_inputs(self) -> int:
        """Number of inputs m."""
        return len(self.input_names)

    @property
    def n_lifted(self) -> int:
        """Number of lifted states M."""
        return len(self.column_names)

    @property
    def n_features(self) -> int:
        """Number of input features P."""
        return len(self.feature_names)

    @property
    def units(self) -> tuple[str, ...]:
        """Units (n,) of the states, as ``Episodes.units``."""
        return tuple(self.state_units or ())

    @property
    def is_bilinear(self) -> bool:
        """True if products of inputs and lifted states act, N is not None."""
        return self.N is not None

    @property
    def varies(self) -> bool:
        """True if what an input does depends on the lifted state: bilinear and re-lifted models."""
        return self.is_bilinear or self.relifted is not None

    @cached_property
    def linear_in_u(self) -> bool:
        """True if phi(u) = u and the model is not bilinear."""
        return not self.varies and self.features_are_inputs

    @cached_property
    def features_are_inputs(self) -> bool:
        """True if phi(u) = u."""
        if self.n_features != self.n_inputs:
            return False
        rng = np.random.default_rng(0)
        probe = rng.standard_normal((8, self.n_inputs)) * np.logspace(-3, 3, 8)[:, None]
        return bool(np.array_equal(self.features(probe), probe))

    def lift(self, x_history: ArrayLike, u_history: ArrayLike | None = None) -> Array:
        """z (M,) from x_history (D+1, n) and u_history (D, m), rows are times, newest last (D = n_delays).

        Without delays a single state x (n,) is accepted and u_history may be left out. E histories at once, (E, D+1, n)
        and (E, D, m), give z (E, M). Raises ValueError for other shapes and entries that are not finite.
        """
        x_history = in_order(x_history, self.state_names, "states")
        delays, axes = self.n_delays, np.ndim(x_history)
        lead = (len(x_history),) if axes == 3 else ()  # type: ignore[arg-type]
        if delays == 0 and axes == 1:
            states = finite_array(x_history, "x_history", (self.n_states,))
        else:
            states = finite_array(x_history, "x_history", (*lead, delays + 1, self.n_states))
        if u_history is None and delays == 0:
            u_history = np.zeros((*lead, 0, self.n_inputs))
        u_history = in_order(u_history, self.input_names, "inputs")
        inputs = finite_array(u_history, "u_history", (*lead, delays, self.n_inputs))
        rows = lead[0] if lead else 1
        z = self._lift(states.reshape(rows, (delays + 1) * self.n_states), inputs.reshape(rows, delays * self.n_inputs))
        return z if lead else z[0]

    def features(self, inputs: ArrayLike) -> Array:
        """phi (N, P) of inputs (N, m)."""
        return self._features(self._inputs(inputs))

    def feature_jacobian(self, inputs: ArrayLike) -> Array:
        """d phi / d u (N, P, m) at inputs (N, m)."""
        points = self._inputs(inputs)
        flat = self._jacobian(points)
        return flat.reshape(len(points), self.n_inputs, self.n_features).transpose(0, 2, 1)

    def step(self, z: ArrayLike, u: ArrayLike) -> Array:
        """One step z (M,) -> z+ (M,) under the input u (m,) (eq. update_rule)."""
        state, inputs = finite_array(z, "z", (self.n_lifted,)), self._input(u)
        following = self.A @ state + self.B @ self.features(inputs[None, :])[0] + self.c
        return np.asarray(following + self.products(state, inputs) if self.varies else following)

    def products(self, z: ArrayLike, u: ArrayLike) -> Array:
        """sum_i u_i N_i z + g(z, u) (M,): what a step adds to A z + B phi(u) + c, at z (M,) under u (m,)."""
        state, inputs = real_array(z, "z"), real_array(u, "u")
        found = np.zeros(self.n_lifted)
        if self.bilinear_term is not None:
            found[self.bilinear_term.rows] += self.bilinear_term(state, inputs)
        return found if self.relifted is None else found + self.relifted(state, inputs)

    def jacobian(self, z: ArrayLike, u: ArrayLike) -> tuple[Array, Array]:
        """Derivatives of one step: dz+/dz (M, M) and dz+/du (M, m), at z (M,) under u (m,).

        Raises ValueError for other shapes and entries that are not finite.
        """
        state, inputs = finite_array(z, "z", (self.n_lifted,)), self._input(u)
        by_state = self.A if self.N is None else self.A + np.tensordot(inputs, self.N, axes=1)
        by_input = self.B @ self.feature_jacobian(inputs[None, :])[0]
        if self.N is not None:
            by_input = by_input + (self.N @ state).T
        if self.relifted is None:
            return np.array(by_state), by_input
        more = self.relifted.jacobian(state, inputs)
        return by_state + more[0], by_input + more[1]

    def transition(self, u: ArrayLike) -> Array:
        """A + sum_i u_i N_i (M, M) under the input u (m,). Raises ValueError for a re-lifted model."""
        self._refuse_relifted("one transition for all states; use jacobian(z, u)")
        inputs = self._input(u)
        return self.A.copy() if self.N is None else self.A + np.tensordot(inputs, self.N, axes=1)

    def fixed_point(self, u: ArrayLike) -> Array:
        """Lifted state z (M,) with z+ = z under the constant input u (m,); ``read(z)`` are the states.

        The column "1" has its value 1. Raises ValueError where there is no fixed point, or a whole line of them, and
        for a re-lifted model, which may have several.
        """
        self._refuse_relifted("a single fixed point; roll it out under the constant input")
        inputs = self._input(u)
        forcing = self.B @ self.features(inputs[None, :])[0] + self.c
        matrix = np.eye(self.n_lifted) - self.transition(inputs)
        z = np.zeros(self.n_lifted)
        free = np.ones(self.n_lifted, dtype=bool)
        if "1" in self.column_names and not matrix[self.column_names.index("1")].any():
            one = self.column_names.index("1")
            z[one], free[one] = 1.0, False
        block, target = matrix[np.ix_(free, free)], (forcing - matrix @ z)[free]
        # Balanced by a similarity, the rank does not depend on the units of the columns.
        block, (units, _) = scipy.linalg.matrix_balance(block, permute=False, separate=True)
        found, _, rank, _ = np.linalg.lstsq(block, target / units, rcond=1e-13)
        if rank < len(block):
            raise ValueError(
                f"no single fixed point under u = {inputs.tolist()}: I - A has rank {rank} of {len(block)}; "
                "the model holds an integrator, or a constant column that is not named '1'"
            )
        z[free] = units * found
        return z

    def read(self, z: ArrayLike) -> Array:
        """States y (..., n) of lifted states z (..., M). Raises ValueError for another last axis."""
        lifted = real_array(z, "z")
        if lifted.shape[-1:] != (self.n_lifted,):
            raise ValueError(f"z has shape {lifted.shape}; expected (..., {self.n_lifted}): the lifted states")
        return np.array(self._read(lifted))

    @one_blas_thread()
    def rollout(self, z0: ArrayLike, inputs: ArrayLike) -> Rollout:
        """Predict T steps from z0 (M,) under inputs (T, m), or E episodes at once from (E, M) under (E, T, m)."""
        start = real_array(z0, "z0")
        if start.ndim == 2:
            start = finite_array(start, "z0", (None, self.n_lifted))
            return self._rollout_many(start, finite_array(inputs, "U", (len(start), None, self.n_inputs)))
        start = finite_array(start, "z0", (self.n_lifted,))
        batch = self._rollout_many(start[None], self._inputs(inputs)[None])
        at = int(np.asarray(batch.diverged_at)[0])
        return Rollout(x=batch.x[0], z=batch.z[0], diverged=at >= 0, diverged_at=at if at >= 0 else None)

    def predict(self, x_history: ArrayLike, u_history: ArrayLike | None, inputs: ArrayLike) -> Rollout:
        """Lift ``x_history`` (D+1, n) and ``u_history`` (D, m), then roll out under ``inputs`` (T, m).

        Without delays ``x_history`` may be x0 (n,) and ``u_history`` None.
        """
        return self.rollout(self.lift(x_history, u_history), inputs)

    def _refuse_relifted(self, what: str) -> None:
        if self.relifted is not None:
            raise ValueError(f"the model is re-lifted: its step is not linear in z and has not {what}")

    def _inputs(self, inputs: ArrayLike) -> Array:
        """Inputs (N, m), columns that have names in the model's order."""
        return finite_array(in_order(inputs, self.input_names, "inputs"), "U", (None, self.n_inputs))

    def _input(self, u: ArrayLike) -> Array:
        """One input (m,), entries that have names in the model's order."""
        return finite_array(in_order(u, self.input_names, "inputs"), "u", (self.n_inputs,))

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the model to an HDF5 file ``path``, whole or not at all.

        Raises ValueError for the equations of an arm, which no file holds: keep the arm.
        """
        if self.relifted is not None and not isinstance(self.relifted, ReliftedTerm):
            raise ValueError("the model is the equations of an arm, which no file holds; keep the arm")
        with store.writing(path, KIND) as file:
            for name in _ARRAYS:
                file[name] = getattr(self, name)
            if self.N is not None:
                file["N"] = self.N
            if self.relifted is not None:
                for item in fields(self.relifted):
                    file[f"relifted/{item.name}"] = getattr(self.relifted, item.name)
            for name in _FUNCTIONS:
                store.write_function(file, name, getattr(self, name))
            for name in (*_NAMES, *_UNITS):
                store.write_strings(file, name, getattr(self, name))
            file.attrs["dt"] = self.dt
            file.attrs["n_delays"] = self.n_delays
            store.write_json(file, "outputs", {name: [int(i) for i in group] for name, group in self.outputs.items()})
            store.write_json(file, "provenance", dict(self.provenance))

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> LiftedModel:
        """Read a model saved at ``path``. Raises one line if it is missing, damaged, foreign or of a newer CasADi."""
        with store.reading(path, KIND) as file:
            parts: dict[str, Any] = {name: np.asarray(file[name][()]) for name in _ARRAYS}
            parts |= {name: store.read_function(file, name) for name in _FUNCTIONS}
            parts |= {name: store.read_strings(file, name) for name in _NAMES}
            parts |= {name: store.read_strings(file, name) for name in _UNITS if name in file}
            parts["N"] = np.asarray(file["N"][()]) if "N" in file else None
            if "relifted" in file:
                names = [item.name for item in fields(ReliftedTerm) if f"relifted/{item.name}" in file]
                arrays = {name: np.asarray(file[f"relifted/{name}"][()]) for name in names}
                parts["relifted"] = ReliftedTerm(**arrays)
            return cls(
                **parts,
                dt=float(file.attrs["dt"]),
                n_delays=int(file.attrs["n_delays"]),
                outputs={name: tuple(group) for name, group in store.read_json(file, "outputs").items()},
                provenance=store.read_json(file, "provenance"),
            )

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(refrozen(state))

    def __getstate__(self) -> dict[str, Any]:
        return {item.name: self.__dict__[item.name] for item in fields(self)}  # evaluators are rebuilt, not pickled

    @cached_property
    def _transition(self) -> Transition:
        return Transition(self.A)

    @cached_property
    def bilinear_term(self) -> BilinearTerm | None:
        """sum_i u_i N_i z without its zero rows and columns, or None."""
        return None if self.N is None else BilinearTerm(self.N)

    def _read(self, z: Array) -> Array:
        """C z + d (..., n) of z (..., M), of which it may be a view."""
        return z[..., self._selected] if self._selected is not None else np.asarray(z @ self.C.T + self.d)

    @cached_property
    def _selected(self) -> slice | NDArray[np.int64] | None:
        """Positions of the states in z if y = C z + d just takes them, or None."""
        takes = np.count_nonzero(self.C, axis=1) == 1
        at = np.argmax(self.C != 0.0, axis=1)
        plain = takes.all() and not self.d.any() and bool((self.C[np.arange(len(at)), at] == 1.0).all())
        return span(at) if plain else None

    @cached_property
    def _lift(self) -> Mapped:
        return Mapped(self.lift_function)

    @cached_property
    def _features(self) -> Mapped:
        return Mapped(self.input_function)

    @cached_property
    def _jacobian(self) -> Mapped:
        u = ca.MX.sym("u", self.n_inputs)
        return Mapped(ca.Function("feature_jacobian", [u], [ca.densify(ca.jacobian(self.input_function(u), u))]))

    def _rollout_many(self, start: Array, inputs: Array) -> Rollout:
        episodes, steps = inputs.shape[:2]
        features = self.features(inputs.reshape(episodes * steps, self.n_inputs))
        features = features.reshape(episodes, steps, self.n_features)
        # All inputs act through one product before the loop: a step is then one product with A and one sum.
        z = np.empty((steps + 1, episodes, self.n_lifted))
        z[0] = start
        z[1:] = self.c
        for driven in runs(np.flatnonzero(self.B.any(axis=1))):  # delays are not
            z[1:, :, driven] += (features @ self.B[driven].T).transpose(1, 0, 2)
        with np.errstate(over="ignore", invalid="ignore"):
            if self.relifted is not None:
                propagate_relifted(self._transition, self.relifted, self.bilinear_term, z, inputs)
            elif self.bilinear_term is not None:
                propagate_bilinear(self._transition, self.bilinear_term, z, inputs)
            else:
                propagate(self._transition, z)
            return Rollout.of(self._read(z).transpose(1, 0, 2), z.transpose(1, 0, 2), self.state_range)

    def plot(self, path: str | os.PathLike[str] | None = None) -> Figure:
        """Eigenvalues of A and step responses per unit of input; written to ``path`` where one is given."""
        from pisplit.lifted.pictures import plot_model

        return plot_model(self, path)


_ARRAYS = ("A", "B", "c", "C", "d", "input_offset", "input_basis", "state_range")
_FUNCTIONS = ("lift_function", "input_function")
_NAMES = ("state_names", "input_names", "column_names", "feature_names")
_UNITS = ("state_units", "input_units")
