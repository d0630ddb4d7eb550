"""What arrays have to be to make episodes, and what to do where they are not."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pisplit.checks import finite_array
from pisplit.data.rows import Rows, frozen

Array = NDArray[np.float64]

#: Episodes with so many times more inputs than steps probably have time along their columns.
FLAT = 4


def checked_arrays(xs: Sequence[Array], us: Sequence[Array]) -> tuple[Rows, Rows]:
    """States ``xs`` and inputs ``us`` that fit each other, one array an episode, in memory of their own.

    Raises ValueError, in one line, for arrays that do not; warns where they only fit as one step of many states.
    """
    if isinstance(xs, np.ndarray) or isinstance(us, np.ndarray):
        raise ValueError("xs and us are lists of arrays, one an episode; for a single episode give [x] and [u]")
    if len(xs) == 0 or len(xs) != len(us):
        raise ValueError(f"got {len(xs)} state and {len(us)} input arrays; expected as many of both, >= 1")
    states, inputs = _rows(xs, "xs"), _rows(us, "us")
    if states.stacked.shape[1] == 0:
        raise ValueError("xs[0] has no columns; an episode needs at least one state")
    for i, (x, u) in enumerate(zip(states, inputs, strict=True)):
        if len(u) != len(x) - 1 or len(x) < 2:
            raise ValueError(_misfit(i, x.shape, u.shape))
    steps, n, m = min(map(len, inputs)), states.stacked.shape[1], inputs.stacked.shape[1]
    if n == m + 1 and m > FLAT * steps:
        warnings.warn(f"{steps} steps of {n} states and {m} inputs: is time along the columns? give x.T", stacklevel=4)
    return states, inputs


def _rows(arrays: Sequence[Array], name: str) -> Rows:
    if isinstance(arrays, Rows):
        return arrays
    first = finite_array(arrays[0], f"{name}[0]", (None, None))
    rest = [finite_array(a, f"{name}[{i}]", (None, first.shape[1])) for i, a in enumerate(arrays) if i]
    return Rows.joined([first, *rest])


def _misfit(i: int, x: tuple[int, ...], u: tuple[int, ...]) -> str:
    """What is wrong with states of shape ``x`` and inputs of shape ``u`` in episode i, and what mends it."""
    if x[1] == u[1] + 1 and x[1] > x[0] and u[0] > 0:
        return f"xs[{i}] has shape {x}, us[{i}] {u}: time runs along rows; give x.T and u.T"
    if x[0] < 2:
        return f"xs[{i}] has {x[0]} row(s); an episode needs at least two to hold a pair"
    hint = "one a step"
    if u[0] == x[0]:
        hint = "one a step: leave out the last, u[:-1]"
    elif u[1] in (x[0], x[0] - 1):
        hint = f"one a step: give u{'[:, :-1]' if u[1] == x[0] else ''}.T"
    elif x[1] in (u[0], u[0] + 1):
        hint = "one a step, or is time along the columns of x? give x.T"
    return f"us[{i}] has {u[0]} rows for {x[0]} states; expected {x[0] - 1} ({hint})"


def extra_arrays(extra: Mapping[str, Sequence[Any]], size: int) -> dict[str, tuple[NDArray[Any], ...]]:
    """Read-only copies of ``extra``, {name: one array an episode}; ValueError if there are not ``size`` of them."""
    for name, arrays in extra.items():
        if len(arrays) != size:
            raise ValueError(f"extra[{name!r}] has {len(arrays)} arrays; expected {size}, one an episode")
    for name, arrays in extra.items():
        if any(isinstance(a, np.ma.MaskedArray) for a in arrays):
            raise ValueError(
                f"extra[{name!r}] is masked, which would be lost; give NaN, or the mask as an array of its own"
            )
    return {name: tuple(frozen(np.asarray(a)) for a in arrays) for name, arrays in extra.items()}


def output_groups(outputs: Mapping[str, Sequence[int]], n_states: int) -> dict[str, tuple[int, ...]]:
    """``outputs`` {name: state indices} as tuples; ValueError for an index that is none of ``n_states``."""
    groups = {name: tuple(int(i) for i in group) for name, group in outputs.items()}
    for name, group in groups.items():
        if any(not 0 <= i < n_states for i in group):
            raise ValueError(f"outputs[{name!r}] = {group}; expected state indices from 0 to {n_states - 1}")
    return groups
