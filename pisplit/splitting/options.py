"""Checks that the splittings about an equilibrium share: their samples, ports and loads."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pisplit.checks import finite_array
from pisplit.data.phase import PhaseSamples
from pisplit.splitting.base import SplitContext
from pisplit.splitting.rows import free_block

Array = NDArray[np.float64]


#: Names of the options of each splitting; those not listed have none.
OPTIONS = dict.fromkeys(("balanced", "hold"), ("tangent", "equilibrium", "ports", "loads"))


def check_names(options: Mapping[str, Any], split: str) -> None:
    """Raise ValueError for ``options`` that the splitting ``split`` does not know."""
    known = OPTIONS.get(split, ())
    unknown = [name for name in options if name not in known]
    if unknown:
        takes = f"options of split={split!r} are {', '.join(known)}" if known else f"split={split!r} takes no options"
        raise ValueError(f"{takes}; got {unknown[0]!r}")


def check_options(context: SplitContext, split: str) -> None:
    """Raise ValueError for options of ``context`` that ``split`` does not know, and for delays that it cannot take."""
    check_names(context.options, split)
    if context.theta.state_delays or context.theta.input_delays > 1:
        raise ValueError(f"split={split!r} takes Delays(inputs=1) or no delays; the state of f has no past")


def generator_samples(context: SplitContext, split: str) -> PhaseSamples:
    """Samples of f for the generator of ``split``; all that ``context`` holds must be of this system."""
    theta = context.theta
    for name, samples in (("d2", context.samples), ("options['tangent']", context.options.get("tangent"))):
        if samples is None and name != "d2":
            continue
        if not isinstance(samples, PhaseSamples):
            raise ValueError(
                f"{name} is a {type(samples).__name__}; split={split!r} needs PhaseSamples of the known part"
            )
        given = (samples.n_states, samples.n_inputs)
        if given != (theta.n_states, theta.n_inputs):
            raise ValueError(
                f"{name} has {given[0]} states and {given[1]} inputs; "
                f"the dictionary expects {theta.n_states} and {theta.n_inputs}"
            )
    chosen: PhaseSamples = context.options.get("tangent", context.samples)
    return chosen


def ports(context: SplitContext) -> Array:
    """Directions (S, r) in which h acts: those of ``context``, or unit vectors of its rows (all learned columns)."""
    options: Any = context.options
    size = len(context.theta.learned_columns)
    if "ports" in options:
        if context.rows is not None:
            raise ValueError("options['ports'] and rows both say where h acts; give one of them")
        return directions(options["ports"], "ports", (size, None))
    if context.rows == "inputs":
        return np.eye(size)
    free, _, _ = free_block(context.theta, context.rows)
    return np.eye(size)[:, np.searchsorted(context.theta.learned_columns, free)]


def directions(given: Any, name: str, shape: tuple[int | None, int | None]) -> Array:
    """The option ``name``, ``given`` with a ``shape`` of one free side: at least one direction, none of them zero."""
    array = finite_array(given, f"options[{name!r}]", shape)
    axis = shape.index(None)
    if array.shape[axis] == 0 or not np.abs(array).max(axis=1 - axis).all():
        raise ValueError(
            f"options[{name!r}] of shape {array.shape} holds no direction, or one that is zero; leave it out"
        )
    return array
