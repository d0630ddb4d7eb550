"""Recorded trajectories (D1 of the paper)."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, fields, replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pisplit.checks import finite_array, positive
from pisplit.data import episode_files, matlab, recordings, sums, tables
from pisplit.data.actuator import Actuator, ActuatorState, checked_actuator
from pisplit.data.columns import column_order, default_names, labels, regrouped, table_columns, unit_factors
from pisplit.data.episode_checks import checked_arrays, extra_arrays, output_groups
from pisplit.data.input_subspace import InputDirections, excited_directions
from pisplit.data.pairs import Pairs, Start, all_pairs, checked_pairs
from pisplit.data.patterns import Paths
from pisplit.data.report import DataReport, report_on
from pisplit.data.rows import Rows

Array = NDArray[np.float64]
Index = NDArray[np.int64]


class SimulatedSystem(Protocol):
    """What :meth:`Episodes.from_system` asks of a system."""

    state_names: tuple[str, ...]
    input_names: tuple[str, ...]
    state_units: tuple[str, ...]

    def simulate(self, x0: ArrayLike, inputs: ArrayLike, dt: float, method: str, substeps: int) -> Array:
        """States (T+1, n) from x0 (n,) under inputs (T, m), each held over dt [s].

        ``method`` is "rk4" or "idas", ``substeps`` the integrator's steps within dt.
        """


@dataclass(frozen=True, eq=False)
class Episodes:
    """Trajectories under known inputs, sampled at one step. All arrays are copied, and read-only.

    xs             states x (T_i + 1, n), one array an episode
    us             inputs u (T_i, m), one array an episode; row k is held from x_k to x_{k+1}. m = 0: no inputs
    dt             time step [s]
    state_names    (n,) default x1, x2, ..., or the names of the columns where xs are tables (pandas)
    input_names    (m,) default u1, u2, ..., or as above
    quantities     (n,) physical quantity of each state ("p", "R", "q", ...): states of one quantity share one scale in
                   regressions, so that one that hardly moves is not blown up to the size of the others, its noise
                   with it; default: states of one unit are of one quantity, any other is its own, and scaled by the
                   noise that regressions find in it (:func:`pisplit.data.noise.noise_margins`)
    units          (n,) units of the states, texts; "" where unknown
    outputs        {name: indices of states}, groups of states
    extra          {name: one array an episode} saved along, for instance the full simulator state
    provenance     JSON-able facts: seed, scene, version
    input_units    (m,) units of the inputs, texts

    ``len``, iteration and indices (an integer, a slice, a list or array of integers, a boolean mask) go by episodes;
    ``d1 + d2`` and ``sum([d1, d2, d3])`` are recordings joined.
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

    def __post_init__(self) -> None:
        put = object.__setattr__
        given = {"state_names": self.xs, "input_names": self.us}
        for name, arrays in given.items():
            put(self, name, table_columns(arrays, getattr(self, name), name))
        xs, us = checked_arrays(self.xs, self.us)
        put(self, "xs", xs)
        put(self, "us", us)
        put(self, "dt", positive(self.dt, "dt", "s"))
        put(self, "state_names", labels(self.state_names, "state_names", default_names("states", self.n_states)))
        put(self, "input_names", labels(self.input_names, "input_names", default_names("inputs", self.n_inputs)))
        put(self, "units", labels(self.units, "units", [""] * self.n_states, unique=False))
        shared = _shared_by_unit(self.state_names or (), self.units or ())
        put(self, "quantities", labels(self.quantities, "quantities", shared, unique=False))
        put(self, "input_units", labels(self.input_units, "input_units", [""] * self.n_inputs, unique=False))
        put(self, "outputs", output_groups(self.outputs or {}, self.n_states))
        put(self, "extra", extra_arrays(self.extra or {}, len(xs)))
        put(self, "provenance", deepcopy(dict(self.provenance or {})))
        try:
            json.dumps(self.provenance)
        except TypeError as error:
            raise ValueError(f"provenance cannot be written as JSON: {error}; use numbers, texts, lists") from None

    def __repr__(self) -> str:
        steps = sorted({len(u) for u in self.us})
        length = f"{steps[0]}" if len(steps) == 1 else f"{steps[0]} to {steps[-1]}"
        told = [_few(self.state_names or (), "state"), _few(self.input_names or (), "input")]
        return f"Episodes({len(self)} of {length} steps of {self.dt:g} s, {', '.join(told)})"

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update({**state, "extra": extra_arrays(state["extra"], len(state["xs"]))})

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

    def __iter__(self) -> Iterator[Episodes]:
        return (self[i] for i in range(len(self)))

    def __getitem__(self, which: int | slice | Sequence[int] | Sequence[bool] | NDArray[Any]) -> Episodes:
        """The episode ``which``, or those of a slice, of integers (k,) or under a mask (E,), as Episodes."""
        if isinstance(which, slice):
            return self.subset(range(len(self))[which])
        if isinstance(which, int | np.integer) and not isinstance(which, bool | np.bool_):
            if not -len(self) <= which < len(self):
                raise IndexError(f"episode {which} of {len(self)}; expected 0 to {len(self) - 1}")
            return self.subset([int(which)])
        index: NDArray[Any] = np.asarray(which) if isinstance(which, list | np.ndarray) else np.empty((0, 0))
        if index.ndim != 1 or index.dtype.kind not in "iub":
            raise ValueError(
                f"episodes[{which!r}]: give an integer, a slice, a list of integers or a mask of {len(self)} booleans"
            )
        if index.dtype.kind == "b" and len(index) != len(self):
            raise ValueError(f"a mask of {len(index)} booleans for {len(self)} episodes; give one an episode")
        return self.subset(np.flatnonzero(index) if index.dtype.kind == "b" else index.tolist())

    def __add__(self, other: Episodes) -> Episodes:
        """These recordings and then those of ``other``, whose columns are brought to the order and units of these.

        Raises ValueError, in one line, for other columns, units or steps. ``sum(list)`` joins many.
        """
        return Episodes(**sums.joined(self, other)) if isinstance(other, Episodes) else NotImplemented

    def __radd__(self, other: Any) -> Episodes:
        return self if isinstance(other, int) and other == 0 else NotImplemented  # sum() starts at 0

    def subset(self, indices: Sequence[int] | Index) -> Episodes:
        """The episodes at ``indices`` (integers, negative ones from the end), in that order.

        Raises ValueError if there are none, and for indices beyond the last episode.
        """
        size = len(self)
        chosen = [int(i) for i in indices]
        if not chosen or any(not -size <= i < size for i in chosen):
            raise ValueError(f"episode indices {chosen[:8]}; expected a non-empty selection of 0 to {size - 1}")
        chosen = [i % size for i in chosen]
        assert isinstance(self.xs, Rows) and isinstance(self.us, Rows)
        return replace(
            self,
            xs=self.xs.take(chosen),
            us=self.us.take(chosen),
            extra={name: [arrays[i] for i in chosen] for name, arrays in (self.extra or {}).items()},
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
            units=_either(units, ordered.units),
            input_units=_either(input_units, ordered.input_units),
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

    def through(self, actuator: Actuator, start: ArrayLike | None = None, inputs: str = "ramp") -> Episodes:
        """The same recordings with the positions of an ``actuator`` in the place of the commands.

        ``start`` (m,): position at which it rests before each recording, in the middle of its play; the first command
        of each if not given. ``inputs``: commands are reached linearly over a step ("ramp") or held ("step"). Raises
        ValueError for what is no Actuator, and for a start of another shape.
        """
        checked_actuator(actuator)
        rest = None if start is None else ActuatorState.at(finite_array(start, "start", (self.n_inputs,)))
        us = [actuator.simulate(u, self.dt, rest, inputs)[0] for u in self.us]
        passed = {"lag": actuator.lag, "play": actuator.play, "rate": actuator.rate, "inputs": inputs}
        return replace(self, us=us, provenance={**(self.provenance or {}), "actuator": passed})

    def pairs(self, n_delays: int = 0) -> Pairs:
        """All snapshot pairs with ``n_delays`` steps of history from the same episode; none crosses a seam.

        Raises ValueError if no episode is long enough.
        """
        return all_pairs(self.stacked_states(), self.stacked_inputs(), [len(u) for u in self.us], n_delays)

    def checked_pairs(self, pairs: Pairs, n_delays: int = 0) -> Pairs:
        """``pairs`` that were drawn from these episodes or from equal ones, with ``n_delays`` steps of history.

        Raises ValueError, in one line, for pairs of other data and for those without so much history.
        """
        steps = [len(u) for u in self.us]
        return checked_pairs(pairs, self.stacked_states(), self.stacked_inputs(), steps, n_delays)

    def start(self, episode: int, n_delays: int = 0) -> Start:
        """History of ``n_delays`` steps, inputs and true states for the roll-out of the episode number ``episode``.

        Raises ValueError if it is too short.
        """
        x, u = self.xs[episode], self.us[episode]
        if len(u) <= n_delays:
            raise ValueError(f"episode {episode} has {len(u)} steps; {n_delays} delays need at least {n_delays + 1}")
        return Start(x_history=x[: n_delays + 1], u_history=u[:n_delays], inputs=u[n_delays:], states=x[n_delays:])

    def input_directions(self) -> InputDirections:
        """Directions in which the inputs vary, how much, and which of them a model can be held to know.

        A direction is kept if its spread exceeds 3 % of the largest; ``lines(input_names)`` says it of each.
        """
        u = self.stacked_inputs()
        mean = u.mean(axis=0)
        largest = np.abs(u).max(axis=0, initial=0.0)
        factor: Array = np.asarray(
            np.linalg.qr(u - mean, mode="r"), dtype=np.float64
        )  # of m rows: as many as samples would be squared in memory
        return excited_directions(mean, factor, largest, len(u), self.input_units)

    def input_subspace(self) -> tuple[Array, Array]:
        """Mean input (m,) and an orthonormal basis (m, r) of the directions in which the inputs vary.

        Those that ``input_directions`` keeps.
        """
        found = self.input_directions()
        return found.offset, found.basis

    def report(self) -> DataReport:
        """One look: length, dt, gaps, ranges, noise, excited directions, delay, suspicious columns, correlations.

        ``print(d1.report())`` is a table, ``d1.report().plot("d1.png")`` a picture.
        """
        return report_on(self)

    def stacked_states(self) -> Array:
        """All states of all episodes (sum of T_i + 1, n), the memory of ``xs``."""
        assert isinstance(self.xs, Rows)
        return self.xs.stacked

    def stacked_inputs(self) -> Array:
        """All inputs of all episodes (sum of T_i, m), the memory of ``us``."""
        assert isinstance(self.us, Rows)
        return self.us.stacked

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the episodes to the HDF5 file ``path``, whole or not at all."""
        episode_files.write(path, {field.name: getattr(self, field.name) for field in fields(self)})

    @classmethod
    def load(cls, path: str | os.PathLike[str], mapped: bool = False) -> Episodes:
        """Read episodes saved at ``path``. One line for files that are missing, damaged, foreign or of another kind.

        ``mapped``: states and inputs stay in the file, which may be larger than memory, and which must not be changed
        meanwhile; what walks through pairs in blocks, as fits with a given alpha do, holds one block of them.
        """
        return cls(**episode_files.read(path, mapped))

    @staticmethod
    def join(paths: Sequence[str | os.PathLike[str]], path: str | os.PathLike[str]) -> None:
        """Write the episodes of the files ``paths``, in this order, to one file ``path``, holding little in memory.

        Provenance is a list of theirs under "joined". Raises ValueError if there is none, and if time step, names,
        units, quantities, output groups or extra arrays differ.
        """
        episode_files.join(paths, path)

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
        """Simulated episodes of ``system``, with its names and units.

        starts            (E, n) first states
        inputs            E arrays (T_i, m), each row held over a step
        dt                time step [s]
        method, substeps  as in ``system.simulate``: "rk4" or "idas", and its steps within dt
        options           further fields of the episodes

        Raises ValueError for shapes that are not the system's.
        """
        first = finite_array(starts, "starts", (len(inputs), None))
        us = [finite_array(u, f"inputs[{i}]", (None, len(system.input_names))) for i, u in enumerate(inputs)]
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
    def from_arrays(cls, t: ArrayLike | None, x: ArrayLike, u: ArrayLike, **options: Any) -> Episodes:
        """Episodes from a recording: times t (N,), states x (N, n), inputs u (N, m), resampled and split.

        ``options`` and errors as in :func:`pisplit.data.recordings.from_arrays`.
        """
        return cls(**recordings.from_arrays(t, x, u, **options))

    @classmethod
    def from_csv(
        cls,
        path: Paths,
        time: str | Sequence[str] | None,
        states: str | Sequence[str],
        inputs: str | Sequence[str],
        **options: Any,
    ) -> Episodes:
        """Episodes from text tables: names of their columns of ``time``, ``states`` and ``inputs``.

        path  a file, a pattern such as "run*.csv", or a list of these

        ``options`` and errors as in :func:`pisplit.data.tables.from_csv`.
        """
        return cls(**tables.from_csv(path, time, states, inputs, **options))

    @classmethod
    def from_mat(
        cls,
        path: str | os.PathLike[str],
        time: str | None,
        states: str | Sequence[str],
        inputs: str | Sequence[str],
        **options: Any,
    ) -> Episodes:
        """Episodes from the MATLAB file ``path``: names of its variables of ``time``, ``states`` and ``inputs``.

        ``options`` and errors as in :func:`pisplit.data.matlab.from_mat`.
        """
        return cls(**matlab.from_mat(path, time, states, inputs, **options))


def _shared_by_unit(names: Sequence[str], units: Sequence[str]) -> list[str]:
    """The unit of every state whose unit others have too, else its name; pure numbers are of many kinds."""
    return [
        u if u not in ("", "1") and list(units).count(u) > 1 else name for name, u in zip(names, units, strict=True)
    ]


def _few(names: Sequence[str], what: str) -> str:
    shown = list(names) if len(names) < 5 else [*names[:2], "...", names[-1]]
    return f"{len(names)} {what}{'s' * (len(names) != 1)}{': ' * bool(names)}{', '.join(shown)}"


def _either(wanted: Sequence[str] | None, given: Sequence[str] | None) -> list[str]:
    """Units that are wanted, or those that are given where none is."""
    return [new or old for new, old in zip(wanted or given or (), given or (), strict=True)]
