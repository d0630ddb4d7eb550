"""From the learned rows of the operator to a :class:`LiftedModel`."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pisplit.data.episodes import Episodes, Pairs
from pisplit.data.input_subspace import InputDirections, excited_directions
from pisplit.data.phase import PhaseSamples
from pisplit.dictionary.dictionary import Dictionary
from pisplit.lifted.model import LiftedModel
from pisplit.regression import ridge
from pisplit.regression.moments import accumulate
from pisplit.regression.scaling import column_scales

Array = NDArray[np.float64]

#: Ridge of the read-out, relative to the mean diagonal of its Gram matrix: columns may be collinear.
READ_OUT_ALPHA = 1e-10


def lifted_model(
    theta: Dictionary,
    k: Array,
    episodes: Episodes,
    pairs: Pairs,
    provenance: Mapping[str, Any],
    samples: PhaseSamples | Pairs | None = None,
) -> LiftedModel:
    """The model z+ = A z + B phi(u) (+ sum_i u_i N_i z), y = C z + d of learned rows ``k`` (S, M), physical units.

    The constant keeps its value and delays shift exactly: those rows are written, not learned. Where the states are not
    columns of the dictionary, C and d are regressed on the training pairs and, where there are any, on phase samples or
    pairs of a simulated twin (``samples``).

    ``theta`` is the dictionary; ``episodes`` give dt, names and units, ``pairs`` of them the inputs' directions;
    ``provenance`` is kept with the model.
    """
    read, offset = _read_out(theta, pairs, samples)
    inputs = excited_inputs(pairs, episodes.input_units)
    return LiftedModel(
        **operators(theta, k),
        c=np.zeros(theta.n_lifted),
        C=read,
        d=offset,
        dt=episodes.dt,
        lift_function=theta.lift_function,
        input_function=theta.input_function,
        n_delays=theta.n_delays,
        state_names=theta.names.states,
        input_names=theta.names.inputs,
        column_names=theta.lifted_names,
        feature_names=theta.feature_names,
        input_offset=inputs.offset,
        input_basis=inputs.basis,
        state_range=state_range(pairs, theta.names.quantities),
        outputs={name: tuple(group) for name, group in (episodes.outputs or {}).items()},
        provenance={**provenance, "input_directions": list(inputs.lines(theta.names.inputs))},
        state_units=episodes.units,
        input_units=episodes.input_units,
    )


def operators(theta: Dictionary, k: Array) -> dict[str, Any]:
    """A (M_z, M_z), B (M_z, P) and N (m, M_z, M_z) or None from the learned rows ``k`` (S, M): others are known.

    Lifted states and functions of the inputs apart: the upper blocks of eq. hilbert_split for one time step, with the
    columns of ``theta``.
    """
    rows = np.zeros((theta.n_lifted, theta.n_columns))
    rows[theta.learned_columns] = k
    if theta.constant_column is not None:
        rows[theta.constant_column, theta.constant_column] = 1.0
    at = theta.n_present
    states = np.empty(0, dtype=np.int64) if theta.state_columns is None else theta.state_columns
    features = np.arange(theta.n_lifted, theta.n_lifted + theta.n_features)
    for delays, source in ((theta.state_delays, states), (theta.input_delays, features)):
        for _ in range(delays):  # x_{k-1} becomes what x_k is now, x_{k-2} what x_{k-1} is now, ...
            target = np.arange(at, at + len(source))
            rows[target, source] = 1.0
            source, at = target, at + len(source)
    found: dict[str, Any] = {"A": rows[:, : theta.n_lifted].copy(), "B": rows[:, features].copy(), "N": None}
    if theta.is_bilinear:
        products = rows[:, theta.n_lifted + theta.n_features :].reshape(theta.n_lifted, theta.n_inputs, -1)
        found["N"] = np.zeros((theta.n_inputs, theta.n_lifted, theta.n_lifted))
        found["N"][:, :, theta.products] = products.transpose(1, 0, 2)
    return found


def _read_out(theta: Dictionary, pairs: Pairs, samples: PhaseSamples | Pairs | None) -> tuple[Array, Array]:
    exact = theta.invert
    if exact is not None:
        return exact, np.zeros(theta.n_states)
    columns = [i for i in range(theta.n_lifted) if i != theta.constant_column]
    size = len(columns)

    def blocks() -> Iterator[Array]:
        for b in pairs.blocks():
            yield np.hstack([theta.evaluate(b)[:, columns], b.x])
        if isinstance(samples, Pairs):
            for b in samples.blocks():
                yield np.hstack([theta.evaluate(b)[:, columns], b.x])
        elif samples is not None:
            for part in samples.blocks():
                yield np.hstack([theta.evaluate_static(part.x, part.u)[:, columns], part.x])

    moments = accumulate(blocks())
    scale = column_scales(moments.std[:size], [theta.column_quantities[i] for i in columns])
    a = moments.factor[:, :size] / scale
    fit = ridge(a, moments.factor[:, size:], READ_OUT_ALPHA * float((a**2).sum()) / size).K / scale
    read = np.zeros((theta.n_states, theta.n_lifted))
    read[:, columns] = fit
    return read, moments.mean[size:] - fit @ moments.mean[:size]


def state_range(pairs: Pairs, quantities: Sequence[str]) -> Array:
    """Largest magnitude (n,) of the ``quantities`` (n,) of the states in the pairs; 1 for one that is always zero."""
    largest = np.zeros(len(quantities))
    for b in pairs.blocks():
        for states in (b.x, b.x_next):
            np.maximum(largest, np.abs(states).max(axis=0), out=largest)
    labels = np.array(quantities)
    pooled = np.array([largest[labels == label].max() for label in labels])
    pooled[pooled == 0.0] = 1.0
    return pooled


def excited_inputs(pairs: Pairs, units: Sequence[str] | None = None) -> InputDirections:
    """Directions in which the inputs of the pairs vary, past ones too; ``units`` (m,) of the inputs."""
    size = pairs.inputs.shape[1]
    if size == 0:
        nothing = np.zeros(0)
        return excited_directions(nothing, np.zeros((0, 0)), nothing, 0)
    largest = np.zeros(size)

    def blocks() -> Iterator[Array]:
        for b in pairs.blocks():
            u = np.vstack([b.u, b.u_history.reshape(-1, size)])
            np.maximum(largest, np.abs(u).max(axis=0), out=largest)
            yield u

    moments = accumulate(blocks())
    return excited_directions(moments.mean, moments.factor, largest, moments.n_samples, units)
