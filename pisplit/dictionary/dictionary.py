"""The dictionary Theta(x, u) of the paper: observables in one order, made, renamed, extended, saved."""

from __future__ import annotations

import os
from collections.abc import Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from pisplit.checks import count
from pisplit.data.columns import column_order, default_names, labels
from pisplit.dictionary import files
from pisplit.dictionary.compiled import compile_part
from pisplit.dictionary.evaluation import Evaluation
from pisplit.dictionary.layout import Structure
from pisplit.observables import Bilinear, Constant, Delays, Identity, Inputs, Names, Observable, States, Sum
from pisplit.observables.algebra import flattened

if TYPE_CHECKING:
    from pisplit.data.episodes import Episodes


class Dictionary(Evaluation):
    """Theta = [psi; phi]: psi (M_z columns) are functions of the states and past inputs, phi (P columns) of u_k.

    psi holds first the columns that the observables write for x_k ("present" columns), then x_{k-1}..x_{k-d}, then
    phi(u_{k-1})..phi(u_{k-j}), as :class:`pisplit.observables.Delays` asks. With :class:`pisplit.observables.Bilinear`
    Theta = [psi; phi; u_1 psi_J; ..; u_m psi_J] for the chosen columns J of psi.

    observables                  what writes the columns, in order (:mod:`pisplit.observables`)
    n_states, n_inputs           n, and m, which is 0 for an autonomous system
    state_names, input_names     (n,) and (m,); default x1, x2, ... and u1, u2, ...
    quantities                   (n,) the physical quantity of each state, a scaling group; default: each its own
    input_quantities             (m,) that of each input; default: "u" for all

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
        n, m = count(n_states, "n_states"), count(n_inputs, "n_inputs", minimum=0)
        self.observables = tuple(flattened(observables))
        self.given = (state_names, input_names, quantities, input_quantities)
        states = labels(state_names, "state_names", default_names("states", n))
        names = Names(
            states=states,
            inputs=labels(input_names, "input_names", default_names("inputs", m)),
            quantities=labels(quantities, "quantities", states, unique=False),
            input_quantities=labels(input_quantities, "input_quantities", ["u"] * m, unique=False),
        )
        delays, bilinear = self._only(Delays, "the longest delays"), self._only(Bilinear, "all columns")
        present: list[Any] = [o for o in self.observables if not isinstance(o, Delays | Bilinear)]
        for observable in present:
            if isinstance(observable, type) or not hasattr(observable, "state_columns"):
                raise ValueError(f"{observable!r} is no observable; use those of pisplit.observables, with parentheses")
        self.lay_out(
            names,
            Structure(
                state_delays=delays.states if delays else 0,
                input_delays=delays.inputs if delays else 0,
                constant=any(isinstance(o, Constant) for o in present),
                states=any(isinstance(o, States | Identity) for o in present),
                inputs=any(isinstance(o, Inputs | Identity) for o in present),
            ),
            compile_part("x", n, [o.state_columns for o in present], names),
            compile_part("u", m, [o.input_columns for o in present], names),
        )
        if bilinear:
            self.products = self.multiplied(bilinear)
        self._check()

    def _only(self, kind: type, wanted: str) -> Any:
        """The observable of this kind, or None. Raises ValueError for several."""
        found = [o for o in self.observables if isinstance(o, kind)]
        if len(found) > 1:
            raise ValueError(f"{len(found)} {kind.__name__} given; expected one, with {wanted} wanted")
        return found[0] if found else None

    def _check(self) -> None:
        """Raise ValueError for columns that make no dictionary."""
        if not self.state_part.names:
            raise ValueError("the dictionary has no column that depends on the state; add ob.States() or ob.Identity()")
        if self.state_delays and self.state_columns is None:
            raise ValueError("delayed states need the states themselves as columns; add ob.States() or ob.Identity()")
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
    def wanted_names(self) -> tuple[tuple[str, ...] | None, tuple[str, ...] | None]:
        """Names of states (n,) and inputs (m,) that data must have, in any order; None where any will do."""
        if not self.observables:
            return self.names.states, self.names.inputs
        states, inputs = self.given[:2]
        return None if states is None else self.names.states, None if inputs is None else self.names.inputs

    def named_after(self, episodes: Episodes) -> Dictionary:
        """The same dictionary with names and quantities of ``episodes`` where none were given.

        Raises ValueError if numbers of states or inputs, or names that were given, differ from those of the episodes.
        """
        given = (self.n_states, self.n_inputs)
        if given != (episodes.n_states, episodes.n_inputs):
            raise ValueError(
                f"the dictionary is for {given[0]} states and {given[1]} inputs; "
                f"the episodes have {episodes.n_states} and {episodes.n_inputs}"
            )
        theirs = (episodes.state_names, episodes.input_names)
        for what, mine, names in zip(("states", "inputs"), self.wanted_names, theirs, strict=True):
            order = column_order(names, mine, what, "the data", "the dictionary")
            if (np.diff(order) < 0).any():
                raise ValueError(
                    f"the data have {what} {tuple(names or ())[:4]}, the dictionary {tuple(mine or ())[:4]}; "
                    "give Episodes.arranged(...), in its order"
                )
        state_names, input_names, quantities, input_quantities = self.given
        if not self.observables:  # loaded: its columns are compiled and keep their names
            return self
        return Dictionary(
            *self.observables,
            n_states=self.n_states,
            n_inputs=self.n_inputs,
            state_names=episodes.state_names if state_names is None else state_names,
            input_names=episodes.input_names if input_names is None else input_names,
            quantities=episodes.quantities if quantities is None else quantities,
            input_quantities=input_quantities,
        )

    def bilinear(self, columns: Sequence[str] | None = None) -> Dictionary:
        """The same dictionary with products of inputs and lifted columns (:class:`pisplit.observables.Bilinear`).

        ``columns`` are names or quantities of the lifted columns that are multiplied, default all. Without inputs there
        are no products. Raises ValueError for unknown names.
        """
        product = Bilinear(None if columns is None else tuple(columns))
        copy = _bare(self)
        copy.observables = (*self.observables, product) if self.observables else ()
        copy.products = self.multiplied(product)
        return copy

    def without_products(self) -> Dictionary:
        """The same dictionary without products of inputs and lifted columns."""
        copy = _bare(self)
        copy.observables = tuple(o for o in self.observables if not isinstance(o, Bilinear))
        copy.products = self.products[:0]
        return copy

    def fingerprint(self) -> str:
        """SHA-256 of names, quantities, structure and compiled columns: equal in every process.

        It changes with any column, and with the CasADi version that compiled them. A loaded dictionary keeps its own.
        """
        return self._fingerprint

    @cached_property
    def _fingerprint(self) -> str:
        return files.fingerprint(self)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the compiled dictionary to the HDF5 file ``path``, whole or not at all."""
        files.save(self, path)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Dictionary:
        """Read a saved dictionary from ``path``. Raises one line for files missing, damaged or of another kind.

        Its columns are compiled: they keep the names and quantities they were saved with, whatever data it meets.
        """
        theta = cls.__new__(cls)
        files.load(theta, path)
        return theta


def _bare(theta: Dictionary) -> Dictionary:
    """A copy without anything that was computed from its columns."""
    copy = Dictionary.__new__(Dictionary)
    kinds = {name: value for base in Dictionary.__mro__ for name, value in vars(base).items()}
    cached = {name for name, value in kinds.items() if isinstance(value, cached_property)}
    copy.__dict__.update({name: value for name, value in theta.__dict__.items() if name not in cached})
    return copy
