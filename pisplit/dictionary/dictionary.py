"""The dictionary Theta(x, u) of the paper: named columns, compiled in CasADi, evaluated in blocks."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from pisplit.checks import count
from pisplit.data import store
from pisplit.dictionary.compiled import Part, compile_part
from pisplit.mapping import Mapped
from pisplit.observables import Bilinear, Constant, Delays, Identity, Inputs, Names, Observable, States, Sum
from pisplit.observables.algebra import flattened

if TYPE_CHECKING:
    from pisplit.data.episodes import Episodes, Pairs

Array = NDArray[np.float64]


KIND = "pisplit/dictionary"


@dataclass(frozen=True)
class _Structure:
    """What the columns alone do not say: delays, and which plain columns the dictionary holds."""

    state_delays: int
    input_delays: int
    constant: bool
    states: bool
    inputs: bool


class Dictionary:
    """Theta = [psi; phi]: psi (M_z columns) are functions of the states and past inputs, phi (P columns) of u_k.

    psi holds first the columns that the observables write for x_k ("present" columns), then x_{k-1}..x_{k-d}, then
    phi(u_{k-1})..phi(u_{k-j}), as :class:`pisplit.observables.Delays` asks. With :class:`pisplit.observables.Bilinear`
    Theta = [psi; phi; u_1 psi_J; ..; u_m psi_J] for the chosen columns J of psi. ``quantities`` and
    ``input_quantities`` name the physical quantity of each state and input (scaling groups; default: each state its
    own, all inputs "u").
    Names and quantities left out are taken from the training episodes when an estimator is fitted.

    Dictionaries are never changed. Raises ValueError for no observables, repeated columns, more than one Delays or
    Bilinear, and delayed states without states.
    """

    def __init__(
        self,
        *observables: Observable | Delays | Bilinear | Sum,
        n_states: int,
        n_inputs: int,
        state_names: Sequence[str] | None = None,
        input_names: Sequence[str] | None = None,
        quantities: Sequence[str] | None = None,
        input_quantities: Sequence[str] | None = None,
    ) -> None:
        self.n_states = count(n_states, "n_states")
        self.n_inputs = count(n_inputs, "n_inputs", minimum=0)
        self.observables = tuple(flattened(observables))
        self._given = (state_names, input_names, quantities, input_quantities)
        states = _named(state_names, "state_names", [f"x{i + 1}" for i in range(n_states)])
        inputs = _named(input_names, "input_names", [f"u{i + 1}" for i in range(n_inputs)])
        self.names = Names(
            states=states,
            inputs=inputs,
            quantities=_named(quantities, "quantities", states),
            input_quantities=_named(input_quantities, "input_quantities", ["u"] * n_inputs),
        )
        delays = [o for o in self.observables if isinstance(o, Delays)]
        bilinear = [o for o in self.observables if isinstance(o, Bilinear)]
        if len(delays) > 1:
            raise ValueError(f"{len(delays)} Delays given; expected one, with the longest delays wanted")
        if len(bilinear) > 1:
            raise ValueError(f"{len(bilinear)} Bilinear given; expected one, with all columns wanted")
        present: list[Any] = [o for o in self.observables if not isinstance(o, Delays | Bilinear)]
        for observable in present:
            if isinstance(observable, type) or not hasattr(observable, "state_columns"):
                raise ValueError(f"{observable!r} is no observable; use those of pisplit.observables, with parentheses")
        self._structure = _Structure(
            state_delays=delays[0].states if delays else 0,
            input_delays=delays[0].inputs if delays else 0,
            constant=any(isinstance(o, Constant) for o in present),
            states=any(isinstance(o, States | Identity) for o in present),
            inputs=any(isinstance(o, Inputs | Identity) for o in present),
        )
        self._state_part = compile_part("x", n_states, [o.state_columns for o in present], self.names)
        self._input_part = compile_part("u", n_inputs, [o.input_columns for o in present], self.names)
        self.products = np.empty(0, dtype=np.int64)
        if not self._state_part.names:
            raise ValueError("the dictionary has no column that depends on the state; add ob.States() or ob.Identity()")
        if self.state_delays and self.state_columns is None:
            raise ValueError("delayed states need the states themselves as columns; add ob.States() or ob.Identity()")
        if bilinear:
            self.products = self._multiplied(bilinear[0])
        repeated = sorted({name for name in self.column_names if self.column_names.count(name) > 1})
        if repeated:
            raise ValueError(
                f"the dictionary holds {', '.join(repeated[:5])} more than once; drop or rename one of them"
            )

    def __repr__(self) -> str:
        what = ", ".join(map(repr, self.observables)) or "loaded"
        products = f" + {self.n_inputs * len(self.products)} products" if self.is_bilinear else ""
        return f"Dictionary({what}: {self.n_lifted} + {self.n_features} columns{products})"

    def __deepcopy__(self, memo: Any) -> Dictionary:
        return self  # never changed: copies of estimators may share it

    @property
    def state_delays(self) -> int:
        """Number of past states among the columns of psi."""
        return self._structure.state_delays

    @property
    def input_delays(self) -> int:
        """Number of past values of phi among the columns of psi."""
        return self._structure.input_delays

    @property
    def is_bilinear(self) -> bool:
        """True if Theta holds products of inputs and lifted columns."""
        return len(self.products) > 0

    @property
    def n_delays(self) -> int:
        """Steps of history that a lift needs, D = max(state delays, input delays)."""
        return max(self.state_delays, self.input_delays)

    @property
    def n_present(self) -> int:
        """Columns of psi that are functions of x_k; they come first."""
        return len(self._state_part.names)

    @property
    def n_lifted(self) -> int:
        """M_z, columns of psi."""
        return self.n_present + self.state_delays * self.n_states + self.input_delays * self.n_features

    @property
    def n_features(self) -> int:
        """P, columns of phi."""
        return len(self._input_part.names)

    @property
    def n_columns(self) -> int:
        """M = M_z + P (+ m times the multiplied columns), columns of Theta."""
        return self.n_lifted + self.n_features + self.n_inputs * len(self.products)

    @cached_property
    def column_names(self) -> tuple[str, ...]:
        """Names of all columns of Theta: psi, then phi, then their products with the inputs."""
        plain = self._plain_names()
        return (*plain, *(f"{u}*{plain[j]}" for u in self.names.inputs for j in self.products))

    @cached_property
    def column_quantities(self) -> tuple[str, ...]:
        """Physical quantity of every column: columns of one quantity share one scale."""
        plain = self._plain_quantities()
        return (*plain, *(f"{u}*{plain[j]}" for u in self.names.input_quantities for j in self.products))

    @property
    def lifted_names(self) -> tuple[str, ...]:
        """Names of the columns of psi."""
        return self._plain_names()[: self.n_lifted]

    @property
    def feature_names(self) -> tuple[str, ...]:
        """Names of the columns of phi."""
        return self._input_part.names

    @property
    def constant_column(self) -> int | None:
        """Position of the column 1, or None."""
        return self._state_part.names.index("1") if self._structure.constant else None

    @cached_property
    def learned_columns(self) -> NDArray[np.int64]:
        """Columns of psi whose dynamics are identified: all present ones but the constant (delays shift exactly)."""
        return np.array([i for i in range(self.n_present) if i != self.constant_column], dtype=np.int64)

    @property
    def input_function(self) -> ca.Function:
        """phi: u (m,) -> (P,)."""
        return self._input_part.function

    @cached_property
    def lift_function(self) -> ca.Function:
        """psi: (x_history (n, D+1), u_history (m, D)) -> z (M_z,), columns are times, oldest first."""
        in_sx = self._state_part.function.is_a("SXFunction") and self.input_function.is_a("SXFunction")
        kind: Any = ca.SX if in_sx else ca.MX
        last = self.n_delays
        x = kind.sym("x_history", self.n_states, last + 1)
        u = kind.sym("u_history", self.n_inputs, last)
        parts: list[Any] = [self._state_part.function(x[:, last])]
        parts += [x[:, last - j] for j in range(1, self.state_delays + 1)]
        parts += [self.input_function(u[:, last - j]) for j in range(1, self.input_delays + 1)]
        return ca.Function("lift", [x, u], [ca.densify(ca.vertcat(*parts))])

    @property
    def invert(self) -> Array | None:
        """C (n, M_z) with x = C psi, exact, when every state is a column; else None."""
        if self.state_columns is None:
            return None
        selection = np.zeros((self.n_states, self.n_lifted))
        selection[np.arange(self.n_states), self.state_columns] = 1.0
        return selection

    def evaluate(self, pairs: Pairs) -> Array:
        """Theta (N, M) = [psi_k, phi(u_k)] of snapshot pairs, with the products of a bilinear dictionary."""
        return self._theta(self._psi(pairs.x, pairs.x_history, pairs.u_history), pairs.u)

    def next_learned(self, pairs: Pairs) -> Array:
        """The learned columns of psi (N, S) one step later, functions of x_{k+1} alone."""
        return self._present(pairs.x_next)[:, self.learned_columns]

    def next(self, pairs: Pairs) -> Array:
        """psi (N, M_z) one step later: the history shifted, x_{k+1} and u_k at its end."""
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
        """Theta (N, M) at phase-space samples: the past equals the present."""
        history = np.broadcast_to(states[:, None], (len(states), self.n_delays + 1, self.n_states))
        past = np.broadcast_to(inputs[:, None], (len(inputs), self.n_delays, self.n_inputs))
        return self._theta(self._psi(states, history, past), inputs)

    def lie_derivative(self, states: Array, inputs: Array, velocities: Array) -> Array:
        """J_x Theta . f (N, M) at states (N, n) with f = velocities (N, n) (paper, eq. jacob_solve).

        One forward-mode product a sample. Inputs and delays do not move with f: their columns are zero.
        """
        derivative = np.zeros((len(states), self.n_columns))
        derivative[:, : self.n_present] = self.present_derivative(states, velocities)
        if self.is_bilinear:
            products = inputs[:, :, None] * derivative[:, None, self.products]
            derivative[:, self.n_lifted + self.n_features :] = products.reshape(len(states), -1)
        return derivative

    def present_derivative(self, states: Array, velocities: Array) -> Array:
        """Lie derivative (N, n_present) of the present columns alone."""
        return self._derivative(states, velocities)

    def named_after(self, episodes: Episodes) -> Dictionary:
        """The same dictionary with names and quantities of the episodes where none were given.

        Raises ValueError if numbers of states or inputs, or names that were given, differ from those of the episodes.
        """
        given = (self.n_states, self.n_inputs)
        if given != (episodes.n_states, episodes.n_inputs):
            raise ValueError(
                f"the dictionary is for {given[0]} states and {given[1]} inputs; "
                f"the episodes have {episodes.n_states} and {episodes.n_inputs}"
            )
        state_names, input_names, quantities, input_quantities = self._given
        for mine, theirs, what in (
            (state_names, episodes.state_names, "states"),
            (input_names, episodes.input_names, "inputs"),
        ):
            if mine is not None and theirs is not None and tuple(mine) != tuple(theirs):
                raise ValueError(f"the dictionary names its {what} {tuple(mine)[:4]}; the episodes {tuple(theirs)[:4]}")
        if not self.observables:  # loaded: its columns are compiled and keep their names
            return self
        return Dictionary(
            *self.observables,
            n_states=self.n_states,
            n_inputs=self.n_inputs,
            state_names=episodes.state_names,
            input_names=episodes.input_names,
            quantities=episodes.quantities if quantities is None else quantities,
            input_quantities=input_quantities,
        )

    def bilinear(self, columns: Sequence[str] | None = None) -> Dictionary:
        """The same dictionary with products of inputs and lifted columns (:class:`pisplit.observables.Bilinear`)."""
        if self.n_inputs == 0:
            raise ValueError("a bilinear dictionary needs inputs; n_inputs = 0")
        product = Bilinear(None if columns is None else tuple(columns))
        copy = _bare(self)
        copy.observables = (*self.observables, product) if self.observables else ()
        copy.products = self._multiplied(product)
        return copy

    def without_products(self) -> Dictionary:
        """The same dictionary without products of inputs and lifted columns."""
        copy = _bare(self)
        copy.observables = tuple(o for o in self.observables if not isinstance(o, Bilinear))
        copy.products = np.empty(0, dtype=np.int64)
        return copy

    def fingerprint(self) -> str:
        """SHA-256 of names, quantities, structure and compiled columns: equal in every process.

        It changes with any column, and with the CasADi version that compiled them. A loaded dictionary keeps its own.
        """
        return self._fingerprint

    @cached_property
    def _fingerprint(self) -> str:
        functions = (self._state_part.function, self._input_part.function)
        facts = {name: fact for name, fact in self._facts().items() if name != "given"}
        digest = hashlib.sha256(json.dumps(facts, sort_keys=True).encode())
        for function in functions:
            digest.update(function.serialize().encode())
        return digest.hexdigest()

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the compiled dictionary to an HDF5 file, whole or not at all."""
        with store.writing(path, KIND) as file:
            store.write_json(file, "facts", self._facts())
            store.write_function(file, "state_columns", self._state_part.function)
            store.write_function(file, "input_columns", self._input_part.function)
            file.attrs["fingerprint"] = self._fingerprint

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Dictionary:
        """Read a saved dictionary. Raises one line for files that are missing, damaged, foreign or of a newer CasADi.

        Its columns are compiled: they keep the names and quantities they were saved with, whatever data it meets.
        """
        with store.reading(path, KIND) as file:
            facts = store.read_json(file, "facts")
            fingerprint = str(file.attrs["fingerprint"])
            state, inputs = (store.read_function(file, name) for name in ("state_columns", "input_columns"))
        theta = cls.__new__(cls)
        theta.n_states, theta.n_inputs = len(facts["names"]["states"]), len(facts["names"]["inputs"])
        theta.observables, theta._given = (), tuple(facts["given"])
        theta.names = Names(**{name: tuple(labels) for name, labels in facts["names"].items()})
        theta._structure = _Structure(**facts["structure"])
        theta._state_part = Part(state, *map(tuple, facts["state_part"]))
        theta._input_part = Part(inputs, *map(tuple, facts["input_part"]))
        theta.products = np.array(facts["products"], dtype=np.int64)
        theta.__dict__["_fingerprint"] = fingerprint
        return theta

    def _facts(self) -> dict[str, Any]:
        """All that makes the dictionary but its compiled columns, JSON-able."""
        return {
            "names": asdict(self.names),
            "given": [None if names is None else list(names) for names in self._given],
            "structure": asdict(self._structure),
            "state_part": [self._state_part.names, self._state_part.quantities],
            "input_part": [self._input_part.names, self._input_part.quantities],
            "products": self.products.tolist(),
        }

    def _multiplied(self, product: Bilinear) -> NDArray[np.int64]:
        """Positions of the lifted columns that a bilinear dictionary multiplies by the inputs."""
        plain = range(self.n_lifted)
        if product.columns is None:
            skipped = self.constant_column if self._structure.inputs else None
            return np.array([i for i in plain if i != skipped], dtype=np.int64)
        labels = list(zip(self._plain_names(), self._plain_quantities(), strict=True))[: self.n_lifted]
        unknown = [name for name in product.columns if not any(name in label for label in labels)]
        if unknown or not product.columns:
            raise ValueError(f"Bilinear names {unknown[:3]}; expected names or quantities of lifted columns")
        return np.array([i for i in plain if any(name in labels[i] for name in product.columns)], dtype=np.int64)

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

    def _plain_names(self) -> tuple[str, ...]:
        """Names of psi and phi, without products."""
        # The past of u1*u2 is not u1 times the past of u2, which a bilinear dictionary may hold beside it.
        past = [f"({name})" if "*" in name else name for name in self._input_part.names]
        labels = self._labels(self._state_part.names, self.names.states, past, "{}[k-{}]")
        return (*labels[: len(labels) - len(past)], *self._input_part.names)

    def _plain_quantities(self) -> tuple[str, ...]:
        return self._labels(self._state_part.quantities, self.names.quantities, self._input_part.quantities, "{}")

    def _labels(
        self, present: Sequence[str], states: Sequence[str], features: Sequence[str], form: str
    ) -> tuple[str, ...]:
        delayed = [form.format(label, j) for j in range(1, self.state_delays + 1) for label in states]
        past = [form.format(label, j) for j in range(1, self.input_delays + 1) for label in features]
        return (*present, *delayed, *past, *features)

    @cached_property
    def state_columns(self) -> NDArray[np.int64] | None:
        """Positions of the states among the present columns, or None if they are not there."""
        if not self._structure.states:
            return None
        names = self._state_part.names
        return np.array([names.index(name) for name in self.names.states], dtype=np.int64)

    @cached_property
    def _present(self) -> Mapped:
        return Mapped(self._state_part.function)

    @cached_property
    def _features(self) -> Mapped:
        return Mapped(self._input_part.function)

    @cached_property
    def _derivative(self) -> Mapped:
        function = self._state_part.function
        kind: Any = ca.SX if function.is_a("SXFunction") else ca.MX
        x, v = kind.sym("x", self.n_states), kind.sym("v", self.n_states)
        return Mapped(ca.Function("lie_derivative", [x, v], [ca.densify(ca.jtimes(function(x), x, v))]))

    def __getstate__(self) -> dict[str, Any]:
        return {k: v for k, v in self.__dict__.items() if k not in ("_present", "_features", "_derivative")}


def _bare(theta: Dictionary) -> Dictionary:
    """A copy without anything that was computed from its columns."""
    copy = Dictionary.__new__(Dictionary)
    cached = {name for name, value in vars(Dictionary).items() if isinstance(value, cached_property)}
    copy.__dict__.update({name: value for name, value in theta.__dict__.items() if name not in cached})
    return copy


def _named(given: Sequence[str] | None, what: str, default: Sequence[str]) -> tuple[str, ...]:
    names = tuple(default if given is None else given)
    if len(names) != len(default):
        raise ValueError(f"{what} has {len(names)} entries; expected {len(default)}")
    return names
