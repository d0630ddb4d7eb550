"""Phase-space samples of the known vector field (D2 of the paper)."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, replace
from typing import Any, Protocol

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from pisplit.brief import brief
from pisplit.checks import finite_array, positive
from pisplit.data import store
from pisplit.data.columns import column_order, labels, table_columns
from pisplit.data.rows import frozen, refrozen
from pisplit.mapping import Mapped

Array = NDArray[np.float64]

KIND = "pisplit/phase-samples"


class KnownSystem(Protocol):
    """What :meth:`PhaseSamples.from_system` asks of a system: the known vector field f and, optionally, its flow."""

    known: ca.Function

    def known_flow(self, states: Array, inputs: Array, t: float) -> Array:
        """Flow of f over ``t`` seconds from states (N, n) at constant inputs (N, m)."""


@brief
@dataclass(frozen=True, eq=False)
class PhaseSamples:
    """N samples of phase space with the known part of the dynamics.

    x (N, n) states, u (N, m) inputs, xdot (N, n) = f(x, u) [state units / s]; optionally x_half (N, n), the flow of f
    over dt/2 from x, with dt [s]. ``state_names`` (n,) and ``input_names`` (m,) are optional and are checked against
    those of the trajectories when given. ``provenance`` is JSON-able. All arrays are copied, and read-only.
    ``weights`` (N,) >= 0 weigh the samples in every mean, for instance those of a quadrature (default: all alike).

    Raises ValueError for shapes that do not fit each other and for entries that are not finite.
    """

    x: Array
    u: Array
    xdot: Array
    x_half: Array | None = None
    dt: float | None = None
    state_names: Sequence[str] | None = None
    input_names: Sequence[str] | None = None
    provenance: Mapping[str, Any] | None = None
    weights: Array | None = None

    def __post_init__(self) -> None:
        put = object.__setattr__
        for name, table in (("state_names", self.x), ("input_names", self.u)):
            put(self, name, table_columns([table], getattr(self, name), name))
        put(self, "x", frozen(finite_array(self.x, "x", (None, None))))
        size, n = self.x.shape
        if size == 0 or n == 0:
            raise ValueError(f"x has no {'columns' if size else 'rows'}; give at least one phase-space sample")
        put(self, "u", frozen(finite_array(self.u, "u", (size, None))))
        put(self, "xdot", frozen(finite_array(self.xdot, "xdot", (size, n))))
        if self.x_half is not None:
            put(self, "x_half", frozen(finite_array(self.x_half, "x_half", (size, n))))
            if self.dt is None:
                raise ValueError("x_half is given without dt; give the time step whose half it is the flow of")
        if self.weights is not None:
            put(self, "weights", frozen(finite_array(self.weights, "weights", (size,))))
            if (self.weights < 0.0).any() or not self.weights.any():
                raise ValueError("weights are negative or all zero; give non-negative weights, one of them positive")
        if self.dt is not None:
            put(self, "dt", positive(self.dt, "dt", "s"))
        for name, width in (("state_names", n), ("input_names", self.u.shape[1])):
            if getattr(self, name) is not None:
                put(self, name, labels(getattr(self, name), name, [""] * width))
        put(self, "provenance", deepcopy(dict(self.provenance or {})))

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(refrozen(state))

    def __len__(self) -> int:
        return len(self.x)

    @property
    def n_states(self) -> int:
        """Number of states n."""
        return int(self.x.shape[1])

    @property
    def n_inputs(self) -> int:
        """Number of inputs m."""
        return int(self.u.shape[1])

    @classmethod
    def from_system(
        cls,
        system: KnownSystem,
        x: ArrayLike,
        u: ArrayLike,
        dt: float | None = None,
        flow: bool = False,
        weights: Array | None = None,
    ) -> PhaseSamples:
        """Evaluate the known f of ``system`` at x (N, n) and u (N, m).

        dt       time step of the trajectories [s]
        flow     whether to compute the flow of f over dt/2 too, for a half step without a generator
        weights  (N,) of the samples, as above

        Raises ValueError for arrays of other sizes than the system's, and for ``flow`` without ``dt``.
        """
        states = finite_array(x, "x", (None, system.known.numel_in(0)))
        inputs = finite_array(u, "u", (len(states), system.known.numel_in(1)))
        if flow and dt is None:
            raise ValueError("flow=True needs dt, the time step of the trajectories")
        half = system.known_flow(states, inputs, positive(dt, "dt", "s") / 2) if flow else None
        return cls(
            x=states,
            u=inputs,
            xdot=Mapped(system.known)(states, inputs),
            x_half=half,
            dt=dt,
            state_names=getattr(system, "state_names", None),
            input_names=getattr(system, "input_names", None),
            weights=weights,
        )

    def arranged(
        self,
        state_names: Sequence[str] | None = None,
        input_names: Sequence[str] | None = None,
        owner: str = "the data",
    ) -> PhaseSamples:
        """The same samples with columns in the order of ``state_names`` (n,) and ``input_names`` (m,).

        Sides without names are matched by position, as in :meth:`pisplit.Episodes.arranged`; ``owner`` is who wants
        the order, for messages. Returns the same object where nothing changes. Raises ValueError for other names.
        """
        states = column_order(self.state_names, state_names, "states", "the phase samples", owner)
        inputs = column_order(self.input_names, input_names, "inputs", "the phase samples", owner)
        if (np.diff(states) == 1).all() and (np.diff(inputs) == 1).all():
            return self
        columns, commands = (order if len(order) else slice(None) for order in (states, inputs))
        return replace(
            self,
            x=self.x[:, columns],
            u=self.u[:, commands],
            xdot=self.xdot[:, columns],
            x_half=None if self.x_half is None else self.x_half[:, columns],
            state_names=None if self.state_names is None else np.array(self.state_names)[columns].tolist(),
            input_names=None if self.input_names is None else np.array(self.input_names)[commands].tolist(),
        )

    def take(self, which: ArrayLike) -> PhaseSamples:
        """The samples at positions ``which`` (integers), or under a boolean mask (N,) of that name."""
        chosen = np.arange(len(self))[np.asarray(which)]
        half = None if self.x_half is None else self.x_half[chosen]
        arrays = (self.x[chosen], self.u[chosen], self.xdot[chosen], half)
        weights = None if self.weights is None else self.weights[chosen]
        return PhaseSamples(*arrays, self.dt, self.state_names, self.input_names, self.provenance, weights)

    def blocks(self, size: int = 4096) -> Iterator[PhaseSamples]:
        """The samples in order, at most ``size`` at a time; those without weight are left out."""
        used = np.arange(len(self)) if self.weights is None else np.flatnonzero(self.weights)
        for first in range(0, len(used), size):
            yield self.take(used[first : first + size])

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the samples to the HDF5 file ``path``, whole or not at all."""
        with store.writing(path, KIND) as file:
            for name in ("x", "u", "xdot", "x_half", "weights"):
                if getattr(self, name) is not None:
                    file[name] = getattr(self, name)
            if self.dt is not None:
                file.attrs["dt"] = self.dt
            for name in ("state_names", "input_names"):
                if getattr(self, name) is not None:
                    store.write_strings(file, name, getattr(self, name))
            store.write_json(file, "provenance", self.provenance)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> PhaseSamples:
        """Read samples saved at ``path``. One line for files that are missing, damaged, foreign or of another kind."""
        with store.reading(path, KIND) as file:
            return cls(
                x=file["x"][()],
                u=file["u"][()],
                xdot=file["xdot"][()],
                x_half=file["x_half"][()] if "x_half" in file else None,
                dt=float(file.attrs["dt"]) if "dt" in file.attrs else None,
                state_names=store.read_strings(file, "state_names") if "state_names" in file else None,
                input_names=store.read_strings(file, "input_names") if "input_names" in file else None,
                provenance=store.read_json(file, "provenance"),
                weights=file["weights"][()] if "weights" in file else None,
            )
