"""Generator EDMD: the Koopman generator of the known f from phase-space samples, without a trajectory.

Klus, Nueske, Peitz et al., Physica D 406 (2020); paper, eq. cont_koopman_solve.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from itertools import chain
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from pisplit.checks import finite_number, non_negative, one_of
from pisplit.data.phase import PhaseSamples
from pisplit.dictionary.dictionary import Dictionary
from pisplit.regression import absolute_weight, check_penalty, penalised, unit_weight
from pisplit.regression.moments import Moments, accumulate, block_rows

Array = NDArray[np.float64]
Index = NDArray[np.int64]

PASTS = ("absent", "equal")
#: Moments that are remembered for one set of phase samples.
REMEMBERED = 4
_MOMENTS: WeakKeyDictionary[PhaseSamples, dict[tuple[str, str, str], Moments]] = WeakKeyDictionary()


@dataclass(frozen=True)
class KnownOptions:
    """How the regressions of the known part are made, that of the generator and that of the flow map.

    penalty   "ridge", or "lasso" as the paper has it in every regression ("Regularization")
    solver    of a LASSO: "auto", "active-set" or "cvxpy"
    relative  what alpha is relative to: True = the data, "samples" = the number of phase samples, False = nothing
    rows      rows of the generator that are known, {column: {column: coefficient}} in units of the columns, per second:
              {"x": {"v": 1.0}} for x' = v. They are taken as they are and leave the regression
    past      past of a phase sample, which has none: "absent" (delays take no part in the known part) or "equal" to
              its present

    Raises ValueError for options that do not exist.
    """

    penalty: str = "ridge"
    solver: str = "auto"
    relative: bool | str = True
    rows: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    past: str = "absent"

    def __post_init__(self) -> None:
        check_penalty(self.penalty, self.solver, self.relative)
        one_of(self.past, "past", PASTS)
        if not isinstance(self.rows, Mapping) or not all(isinstance(row, Mapping) for row in self.rows.values()):
            raise ValueError("known rows are {column: {column: coefficient}}, for instance {'x': {'v': 1.0}}")
        for name, row in self.rows.items():
            for other, value in row.items():
                finite_number(value, f"coefficient of {other!r} in the known row {name!r}")


PLAIN = KnownOptions()


def generator_edmd(
    theta: Dictionary, samples: PhaseSamples, scale: Array, alpha: float = 0.0, options: KnownOptions = PLAIN
) -> Array:
    """L (M, M) = argmin |L Theta(X, U) - J(X, U)|^2 + alpha |L| on scaled columns [1/s], generator EDMD.

    Paper, eq. cont_koopman_solve; Klus, Nueske, Peitz et al., Physica D 406 (2020).

    ``theta``: dictionary of M columns; ``samples``: D2, with f; ``scale`` (M,): column scales; ``alpha`` and
    ``options``: the penalty. J(X, U) = J_x Theta . f is one forward-mode product a sample (paper, eq. jacob_solve).

    f acts on the present: delays, inputs and the constant have zero rows, since u is constant over a step
    (paper, eq. lie_deriv); delays also have zero columns where the past is absent. Inputs that do not vary
    over the samples have zero columns, because a constant input cannot be told from the constant.
    """
    check_samples(theta, samples)
    return regressed_generator(theta, generator_moments(theta, samples, scale, options), scale, alpha, options)


def check_samples(theta: Dictionary, samples: PhaseSamples) -> None:
    """Raise ValueError for ``samples`` of another system than ``theta``, and for products in ``theta``."""
    if (samples.n_states, samples.n_inputs) != (theta.n_states, theta.n_inputs):
        raise ValueError(
            f"phase samples have {samples.n_states} states and {samples.n_inputs} inputs; "
            f"the dictionary expects {theta.n_states} and {theta.n_inputs}"
        )
    if theta.is_bilinear:
        raise ValueError("the known half step is linear in Theta; leave ob.Bilinear to BilinearEDMDc")


def static_columns(theta: Dictionary, options: KnownOptions) -> Index:
    """Columns of ``theta`` that a phase sample has: all of them, or no delays where ``options`` say "absent"."""
    if options.past == "equal":
        return np.arange(theta.n_columns)
    return np.concatenate([np.arange(theta.n_present), np.arange(theta.n_lifted, theta.n_columns)])


def static_rows(theta: Dictionary, samples: PhaseSamples, options: KnownOptions) -> Array:
    """Theta (N, K) of ``samples``, in the K columns of ``theta`` that they have (paper, eq. theta_matrix).

    These are the :func:`static_columns` of ``options``.
    """
    if options.past == "equal":
        return theta.evaluate_static(samples.x, samples.u)
    return np.hstack([theta.present(samples.x), theta.features(samples.u)])


def generator_moments(theta: Dictionary, samples: PhaseSamples, scale: Array, options: KnownOptions) -> Moments:
    """Moments of [static columns | J_x Theta . f of the present columns] of ``samples``, divided by ``scale`` (M,).

    ``theta`` and ``options`` say which columns these are.
    """
    return static_moments(
        theta, samples, scale, options, "generator", lambda part: theta.present_derivative(part.x, part.xdot)
    )


def regressed_generator(
    theta: Dictionary, moments: Moments, scale: Array, alpha: float, options: KnownOptions
) -> Array:
    """L (M, M) of :func:`generator_edmd` from ``moments`` of :func:`generator_moments`, and the rows that are known.

    ``theta``, ``scale`` (M,), ``alpha`` and ``options`` are those of :func:`generator_edmd`.
    """
    generator = regressed_rows(theta, moments, alpha, np.zeros(theta.n_columns), options)
    for column, row in known_rows(theta, scale, options).items():
        generator[column] = row
    return generator


def static_moments(
    theta: Dictionary,
    samples: PhaseSamples,
    scale: Array,
    options: KnownOptions,
    name: str,
    target: Callable[[PhaseSamples], Array],
) -> Moments:
    """Moments of [static columns | ``target`` of a block of samples (N, n_present)], divided by ``scale`` (M,).

    ``theta`` and ``options`` say which columns; ``name`` tells one target from another. Moments are remembered as long
    as the ``samples``, which never change, are held: fits to many sets of pairs pass over the samples once.
    """
    remembered = _MOMENTS.setdefault(samples, {})
    key = (theta.fingerprint(), options.past, name)
    if key not in remembered:
        blocks = (
            (part.weights, np.hstack([static_rows(theta, part, options), target(part)]))
            for part in samples.blocks(block_rows(theta.n_columns))
        )
        found = weighted_moments(blocks)
        while len(remembered) >= REMEMBERED:
            remembered.pop(next(iter(remembered)))
        remembered[key] = found
    units = np.concatenate([scale[static_columns(theta, options)], scale[: theta.n_present]])
    return remembered[key].scaled(units)


def regressed_rows(theta: Dictionary, moments: Moments, alpha: float, diagonal: Array, options: KnownOptions) -> Array:
    """Rows (M, M) of a known operator: targets of the learned columns regressed, the others ``diagonal`` (M,).

    ``moments`` are of [static columns | targets of the present columns] on scaled columns of ``theta``;
    ``alpha`` weighs the penalty of ``options``, which the constant does not carry.
    """
    learned, used = theta.learned_columns, static_columns(theta, options)
    matrix = np.diag(diagonal)
    matrix[learned] = 0.0
    columns, targets = np.flatnonzero(_varying(theta, moments, used)), len(used) + learned
    constant = theta.constant_column
    if constant is not None:
        columns = columns[columns != constant]
    data = moments.rows(centred=constant is not None)
    a, y = data[:, columns], data[:, targets]
    unit = unit_weight(a, y, options.penalty) if alpha > 0.0 else 0.0
    weight = absolute_weight(non_negative(alpha, "alpha"), options.relative, unit, moments.n_samples)
    fit = penalised(a, y, weight, options.penalty, options.solver).K
    matrix[np.ix_(learned, used[columns])] = fit
    if constant is not None:
        matrix[learned, constant] = (moments.mean[targets] - fit @ moments.mean[columns]) / moments.mean[constant]
    return matrix


def known_rows(theta: Dictionary, scale: Array, options: KnownOptions) -> dict[int, Array]:
    """The known rows (M,) of the generator in ``options`` by position in ``theta``, on columns over ``scale`` (M,)."""
    names, found = list(theta.column_names), {}
    learned = {names[i]: int(i) for i in theta.learned_columns}
    static = {names[i]: int(i) for i in static_columns(theta, options)}
    for name, row in options.rows.items():
        unknown = sorted(({name} - set(learned)) | (set(row) - set(static)))
        if unknown:
            raise ValueError(
                f"known rows name {unknown[:3]}; expected learned columns, and columns that f reads: {list(static)[:6]}"
            )
        found[learned[name]] = np.zeros(theta.n_columns)
        for other, value in row.items():
            found[learned[name]][static[other]] = value * scale[static[other]] / scale[learned[name]]
    return found


def weighted_moments(blocks: Iterator[tuple[Array | None, Array]]) -> Moments:
    """Moments of rows (N_i, k) that arrive in ``blocks`` with weights (N_i,), or with None for equal weights."""
    first = next(blocks, None)
    parts = blocks if first is None else chain([first], blocks)
    if first is None or first[0] is None:
        return accumulate(rows for _, rows in parts)
    plain = accumulate(
        np.sqrt(weights)[:, None] * np.hstack([np.ones((len(rows), 1)), rows])
        for weights, rows in parts
        if weights is not None
    )
    # Orthogonal to the weighted column of ones, the rest is the factor about the weighted mean.
    triangle = np.asarray(np.linalg.qr(plain.rows(centred=False), mode="r"))
    total = float(triangle[0, 0] ** 2)
    return Moments(
        n_samples=plain.n_samples,
        mean=triangle[0, 1:] / triangle[0, 0],
        factor=triangle[1:, 1:] * np.sqrt(plain.n_samples / total),
    )


def _varying(theta: Dictionary, moments: Moments, used: Index) -> NDArray[np.bool_]:
    """Which static columns can be regressors: functions of the state, and functions of inputs that vary."""
    inputs = np.where(used < theta.n_present + theta.state_delays * theta.n_states, False, True)
    std, mean = moments.std[: len(used)], np.abs(moments.mean[: len(used)])
    return np.asarray(~inputs | (std > 1e-10 * np.maximum(mean, 1e-10)))
