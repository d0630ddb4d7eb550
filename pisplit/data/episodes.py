"""Recorded trajectories (D1 of the paper) and the snapshot pairs drawn from them."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

import h5py
import numpy as np
from numpy.typing import ArrayLike, NDArray

from pisplit.checks import count, finite_array, positive
from pisplit.data import store
from pisplit.data.columns import column_order, default_names, labels, regrouped, unit_factors
from pisplit.data.pairs import Pairs, excited_directions

Array = NDArray[np.float64]
Index = NDArray[np.int64]

KIND = "pisplit/episodes"
LABELS = ("state_names", "input_names", "quantities", "units", "input_units")


class SimulatedSystem(Protocol):
    """What :meth:`Episodes.from_system` asks of a system."""

    state_names: tuple[str, ...]
    input_names: tuple[str, ...]
    state_units: tuple[str, ...]

    def simulate(self, x0: ArrayLike, inputs: ArrayLike, dt: float, method: str, substeps: int) -> Array:
        """States (T+1, n) from x0 (n,) under inputs (T, m), each held over dt [s]."""


@dataclass(frozen=True)
class Start:
    """What a roll-out of one episode needs, and the truth to compare with (D delays).

    x_history (D+1, n), u_history (D, m), inputs (T-D, m), states (T-D+1, n) with states[0] = x_history[-1].
    """

    x_history: Array
    u_history: Array
    inputs: Array
    states: Array


@dataclass(frozen=True, eq=False)
class Episodes:
    """Trajectories x (T_i + 1, n) under inputs u (T_i, m), sampled every ``dt`` seconds.

    ``quantities`` (n,) names the physical quantity of each state ("p", "R", "q", ...): states of one quantity share one
    scale in regressions (default: each state is its own). ``units`` (n,) of the states and ``input_units`` (m,) are
    texts. ``outputs`` names groups of states, ``extra`` holds per-episode arrays that are saved along (for instance the
    full simulator state), ``provenance`` is JSON-able (seed, scene, version).

    Raises ValueError for empty lists, episodes of one row, shapes that do not fit and entries that are not finite.
    """

    xs: Sequence[Array]
    us: Sequence[Array]
    dt: float
    state_names: Sequence[str] | None = None
    input_names: Sequence[str] | None = None
    quantities: Sequence[str] | None = None
    units: Sequence[str] | None = None
    outputs: Mapping[str, Sequence[int]] | None = None
    extra: Mapping[str, Sequence[Array]] | None = None
    provenance: Mapping[str, Any] | None = None
    input_units: Sequence[str] | None = None
    _stacked: dict[str, Array] = field(default_factory=dict, init=False, repr=False)

    def __post_init__(self) -> None:
        if isinstance(self.xs, np.ndarray) or isinstance(self.us, np.ndarray):
            raise ValueError("xs and us are lists of arrays, one an episode; for a single episode give [x] and [u]")
        if len(self.xs) == 0 or len(self.xs) != len(self.us):
            raise ValueError(
                f"got {len(self.xs)} state and {len(self.us)} input arrays; expected as many of both, >= 1"
            )
        n, m = np.shape(self.xs[0])[-1:], np.shape(self.us[0])[-1:]
        xs = tuple(finite_array(x, f"xs[{i}]", (None, *n)) for i, x in enumerate(self.xs))
        us = tuple(finite_array(u, f"us[{i}]", (None, *m)) for i, u in enumerate(self.us))
        for i, (x, u) in enumerate(zip(xs, us, strict=True)):
            if len(x) < 2:
                raise ValueError(f"xs[{i}] has {len(x)} row(s); an episode needs at least two to hold a pair")
            if len(u) != len(x) - 1:
                raise ValueError(f"us[{i}] has {len(u)} rows for {len(x)} states; expected {len(x) - 1} (one a step)")
        put = object.__setattr__
        put(self, "xs", xs)
        put(self, "us", us)
        put(self, "dt", positive(self.dt, "dt", "s"))
        put(self, "state_names", labels(self.state_names, "state_names", default_names("states", self.n_states)))
        put(self, "input_names", labels(self.input_names, "input_names", default_names("inputs", self.n_inputs)))
        put(self, "quantities", labels(self.quantities, "quantities", self.state_names or (), unique=False))
        put(self, "units", labels(self.units, "units", [""] * self.n_states, unique=False))
        put(self, "input_units", labels(self.input_units, "input_units", [""] * self.n_inputs, unique=False))
        put(self, "outputs", _output_groups(self.outputs or {}, self.n_states))
        put(self, "extra", {name: tuple(np.asarray(a) for a in arrays) for name, arrays in (self.extra or {}).items()})
        for name, arrays in self.extra.items():  # type: ignore[union-attr]
            if len(arrays) != len(xs):
                raise ValueError(f"extra[{name!r}] has {len(arrays)} arrays; expected {len(xs)}, one an episode")
        put(self, "provenance", dict(self.provenance or {}))
        try:
            json.dumps(self.provenance)
        except TypeError as error:
            raise ValueError(f"provenance cannot be written as JSON: {error}; use numbers, texts, lists") from None

    @property
    def n_states(self) -> int:
        """Number of states n."""
        return int(self.xs[0].shape[1])

    @property
    def n_inputs(self) -> int:
        """Number of inputs m."""
        return int(self.us[0].shape[1])

    def __len__(self) -> int:
        return len(self.xs)

    def __getitem__(self, which: int | slice) -> Episodes:
        return self.subset(range(len(self))[which] if isinstance(which, slice) else [which])

    def subset(self, indices: Sequence[int] | Index) -> Episodes:
        """The episodes at ``indices``, in that order."""
        chosen = [int(i) for i in indices]
        if not chosen or any(not -len(self) <= i < len(self) for i in chosen):
            raise ValueError(f"episode indices {chosen}; expected a non-empty selection of 0 to {len(self) - 1}")
        return Episodes(
            xs=[self.xs[i] for i in chosen],
            us=[self.us[i] for i in chosen],
            dt=self.dt,
            state_names=self.state_names,
            input_names=self.input_names,
            quantities=self.quantities,
            units=self.units,
            outputs=self.outputs,
            extra={name: [arrays[i] for i in chosen] for name, arrays in (self.extra or {}).items()},
            provenance=self.provenance,
            input_units=self.input_units,
        )

    def arranged(
        self,
        state_names: Sequence[str] | None = None,
        input_names: Sequence[str] | None = None,
        units: Sequence[str] | None = None,
        input_units: Sequence[str] | None = None,
        owner: str = "the model",
    ) -> Episodes:
        """The same trajectories with the columns, in the order and units, that a model (or a plant) names.

        state_names, input_names  (n,) and (m,) names that are wanted; None takes the columns as they are. A permutation
                                  is reordered, with quantities, units and output groups; if either side has no names
                                  (x1, x2, ..., u1, u2, ...) columns are matched by position
        units, input_units        (n,) and (m,) units that are wanted, in the wanted order; known ones are converted
        owner                     who wants them, for messages

        Returns the same object where nothing changes. Raises ValueError, in one line, if sizes, names or units do not
        fit.
        """
        states = column_order(self.state_names, state_names, "states", "the data", owner)
        inputs = column_order(self.input_names, input_names, "inputs", "the data", owner)
        ordered = self._reordered(states, inputs)
        factors = unit_factors(ordered.units, units, ordered.state_names or (), "the data", owner)
        scales = unit_factors(ordered.input_units, input_units, ordered.input_names or (), "the data", owner)
        if (factors == 1.0).all() and (scales == 1.0).all():
            return ordered
        return replace(
            ordered,
            xs=[x * factors for x in ordered.xs],
            us=[u * scales for u in ordered.us],
            units=[
                new if f != 1.0 else old for f, new, old in zip(factors, units or (), ordered.units or (), strict=False)
            ],
            input_units=[
                new if f != 1.0 else old
                for f, new, old in zip(scales, input_units or (), ordered.input_units or (), strict=False)
            ],
        )

    def _reordered(self, states: Index, inputs: Index) -> Episodes:
        """The columns at positions ``states`` (n,) and ``inputs`` (m,), all of them, with all that belongs to them."""
        if (np.diff(states) == 1).all() and (np.diff(inputs) == 1).all():
            return self
        at = {
            "state_names": states,
            "quantities": states,
            "units": states,
            "input_names": inputs,
            "input_units": inputs,
        }
        named: dict[str, Any] = {name: [getattr(self, name)[i] for i in order] for name, order in at.items()}
        return replace(
            self,
            xs=[x[:, states] for x in self.xs],
            us=[u[:, inputs] for u in self.us],
            outputs=regrouped(self.outputs or {}, states),
            **named,
        )

    def pairs(self, n_delays: int = 0) -> Pairs:
        """All snapshot pairs with ``n_delays`` steps of history from the same episode; none crosses a seam.

        Raises ValueError if no episode is long enough.
        """
        delays = count(n_delays, "n_delays", minimum=0)
        rows, input_rows, episodes, steps = [], [], [], []
        first_row = first_input = 0
        for i, u in enumerate(self.us):
            k = np.arange(delays, len(u))
            rows.append(first_row + k)
            input_rows.append(first_input + k)
            episodes.append(np.full(len(k), i))
            steps.append(k)
            first_row += len(u) + 1
            first_input += len(u)
        if sum(map(len, steps)) == 0:
            longest = max(map(len, self.us))
            raise ValueError(f"n_delays = {delays} needs episodes of {delays + 1} steps; the longest has {longest}")
        row, input_row, episode, index = (
            np.concatenate(a).astype(np.int64) for a in (rows, input_rows, episodes, steps)
        )
        return Pairs(self.stacked_states(), self.stacked_inputs(), row, input_row, episode, index, delays)

    def start(self, episode: int, n_delays: int = 0) -> Start:
        """History, inputs and true states for the roll-out of one episode. Raises ValueError if it is too short."""
        x, u = self.xs[episode], self.us[episode]
        if len(u) <= n_delays:
            raise ValueError(f"episode {episode} has {len(u)} steps; {n_delays} delays need at least {n_delays + 1}")
        return Start(x_history=x[: n_delays + 1], u_history=u[:n_delays], inputs=u[n_delays:], states=x[n_delays:])

    def input_subspace(self) -> tuple[Array, Array]:
        """Mean input (m,) and an orthonormal basis (m, r) of the directions in which the inputs vary.

        A direction counts if its singular value exceeds 1e-6 of the largest.
        """
        return excited_directions(self.stacked_inputs())

    def stacked_states(self) -> Array:
        """All states of all episodes (sum of T_i + 1, n)."""
        if "x" not in self._stacked:
            self._stacked["x"] = np.concatenate(list(self.xs))
        return self._stacked["x"]

    def stacked_inputs(self) -> Array:
        """All inputs of all episodes (sum of T_i, m)."""
        if "u" not in self._stacked:
            self._stacked["u"] = np.concatenate(list(self.us))
        return self._stacked["u"]

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the episodes to an HDF5 file, whole or not at all."""
        with store.writing(path, KIND) as file:
            _write_ragged(file, "x", self.xs)
            _write_ragged(file, "u", self.us)
            for name, arrays in (self.extra or {}).items():
                _write_ragged(file.require_group("extra"), store.as_key(name), arrays)
            file.attrs["dt"] = self.dt
            for name in LABELS:
                store.write_strings(file, name, getattr(self, name))
            store.write_json(file, "outputs", dict(self.outputs or {}))
            store.write_json(file, "provenance", self.provenance)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Episodes:
        """Read saved episodes. Raises one line for files that are missing, damaged, foreign or of another kind."""
        with store.reading(path, KIND) as file:
            more = file.get("extra", {})
            extra = {store.from_key(key): _read_ragged(more, key) for key in more}
            return cls(
                xs=_read_ragged(file, "x"),
                us=_read_ragged(file, "u"),
                dt=float(file.attrs["dt"]),
                outputs=store.read_json(file, "outputs"),
                extra=extra,
                provenance=store.read_json(file, "provenance"),
                **{name: store.read_strings(file, name) for name in LABELS if name in file},
            )

    @classmethod
    def from_system(
        cls,
        system: SimulatedSystem,
        starts: ArrayLike,
        inputs: Sequence[ArrayLike],
        dt: float,
        method: str = "rk4",
        substeps: int = 1,
        **options: Any,
    ) -> Episodes:
        """Simulated episodes of a system with its names and units: starts (E, n), one (T_i, m) array of inputs each.

        ``method`` "rk4" or "idas" and ``substeps`` as in ``system.simulate``; ``options`` are further fields.
        """
        first = finite_array(starts, "starts", (len(inputs), None))
        us = [np.asarray(u, dtype=np.float64) for u in inputs]
        xs = [system.simulate(x, u, dt, method, substeps) for x, u in zip(first, us, strict=True)]
        named = {
            "state_names": system.state_names,
            "input_names": system.input_names,
            "units": system.state_units,
            "input_units": getattr(system, "input_units", None),
            "provenance": {"method": method, "substeps": substeps},
        }
        return cls(xs, us, dt, **{**named, **options})

    @classmethod
    def from_arrays(cls, t: ArrayLike, x: ArrayLike, u: ArrayLike, **options: Any) -> Episodes:
        """Episodes from a recording, resampled and split at gaps (:func:`pisplit.data.recordings.from_arrays`)."""
        from pisplit.data import recordings  # it makes Episodes: it cannot be imported before them

        return recordings.from_arrays(t, x, u, **options)

    @classmethod
    def from_csv(
        cls, path: str | os.PathLike[str], time: str, states: Sequence[str], inputs: Sequence[str], **options: Any
    ) -> Episodes:
        """Episodes from a table with one header line (:func:`pisplit.data.recordings.from_csv`)."""
        from pisplit.data import recordings

        return recordings.from_csv(path, time, states, inputs, **options)

    @classmethod
    def from_mat(
        cls,
        path: str | os.PathLike[str],
        time: str,
        states: str | Sequence[str],
        inputs: str | Sequence[str],
        **options: Any,
    ) -> Episodes:
        """Episodes from variables of a MATLAB file (:func:`pisplit.data.recordings.from_mat`)."""
        from pisplit.data import recordings

        return recordings.from_mat(path, time, states, inputs, **options)


def _write_ragged(group: h5py.Group, name: str, arrays: Sequence[Array]) -> None:
    rows = {(a.dtype if a.dtype.kind != "U" else "text", a.shape[1:]) for a in arrays}
    if len(rows) > 1 or any(a.ndim == 0 for a in arrays):
        raise ValueError(f"arrays of {name} differ in type or shape of their rows; a file holds rows of one kind")
    values = np.concatenate(list(arrays))
    store.write_arrays(group.create_group(name), {"lengths": np.array([len(a) for a in arrays]), "values": values})


def _read_ragged(group: h5py.Group, name: str) -> list[Array]:
    part = store.read_arrays(group[name])
    return np.split(part["values"], np.cumsum(part["lengths"])[:-1])


def _output_groups(outputs: Mapping[str, Sequence[int]], n_states: int) -> dict[str, tuple[int, ...]]:
    groups = {name: tuple(int(i) for i in group) for name, group in outputs.items()}
    for name, group in groups.items():
        if any(not 0 <= i < n_states for i in group):
            raise ValueError(f"outputs[{name!r}] = {group}; expected state indices from 0 to {n_states - 1}")
    return groups
