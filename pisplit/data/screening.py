"""Readings that are none: zeros of lost tracking and repeats of a sensor that stands still are taken for missing."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from pisplit.data.dropouts import dropouts
from pisplit.data.oversampling import oversampled
from pisplit.data.stalls import stalled
from pisplit.data.warning import warn

Array = NDArray[np.float64]
Index = NDArray[np.int64]

#: What can be looked for.
KINDS = ("zeros", "stalls")


@dataclass
class Screened:
    """``states`` (N, n) with NaN for what was no reading; ``found``: how often, by kind and name of the column."""

    states: Array
    found: dict[str, dict[str, int]] = field(default_factory=dict)


def screened(
    times: Array,
    states: Array,
    inputs: Array,
    members: Mapping[str, Index],
    names: Sequence[str],
    screen: Sequence[str] = KINDS,
) -> Screened:
    """The ``states`` (N, n) without readings that a sensor repeated, or wrote in place of one; each is said.

    times    (N,) [s]
    inputs   (N, m) commands, NaN where there is none
    members  {run: positions of its samples, in order of time}
    names    (n,) of the states
    screen   what is looked for: "zeros", exact values in the place of lost readings (0, or an extreme one such as
             -9999), and "stalls", readings that repeat the last one while the inputs move

    Raises ValueError for another name in ``screen``.
    """
    if not isinstance(screen, str | Iterable):
        raise ValueError(f"screen = {screen!r}; expected any of {', '.join(map(repr, KINDS))}, or () for none")
    wanted = [screen] if isinstance(screen, str) else list(screen)
    unknown = [name for name in wanted if name not in KINDS]
    if unknown:
        raise ValueError(f"screen names {unknown[0]!r}; expected any of {', '.join(map(repr, KINDS))}, or () for none")
    result = Screened(states)
    _say_what_never_moves(states, inputs, names)
    runs = list(members.values())
    if "zeros" in wanted:
        for value, lost in dropouts(times, result.states, inputs, runs):
            taken = _without(result, lost, f"at {value:g}", names)
            text = f"at exactly {value:g}, far from the readings before and after: taken for lost readings"
            _say(taken, text, "zeros", times, lost)
    if "stalls" in wanted:
        repeated, period = oversampled(result.states, inputs, runs)
        text = f"new at every {period}. sample only: repeats between are taken for missing"
        _say(_without(result, repeated, "held", names), text, "stalls", times, repeated)
        still = stalled(result.states, inputs, runs)
        text = "that repeat the last one to the last digit while the inputs or other readings move: taken for missing"
        _say(_without(result, still, "stalled", names), text, "stalls", times, still)
    return result


def _say_what_never_moves(states: Array, inputs: Array, names: Sequence[str]) -> None:
    """Say where commands move and no state does: nothing was seen."""
    if not len(states):
        return
    low, high = np.fmin.reduce(states, axis=0), np.fmax.reduce(states, axis=0)
    if (low == high).all() and bool((np.fmin.reduce(inputs, axis=0) < np.fmax.reduce(inputs, axis=0)).any()):
        warn(f"{names[0]} is {low[0]:g} in all {len(states)} readings, and no state moves: was the sensor on?")


def _without(result: Screened, bad: NDArray[np.bool_], what: str, names: Sequence[str]) -> dict[str, int]:
    """Put NaN for ``bad`` (N, n) readings of ``result``; their number by name of column."""
    counts = bad.sum(axis=0)
    taken = {names[int(i)]: int(counts[i]) for i in np.flatnonzero(counts)}
    if taken:
        result.states = np.where(bad, np.nan, result.states)
        result.found[what] = taken
    return taken


def _say(taken: Mapping[str, int], text: str, kind: str, times: Array, bad: NDArray[np.bool_]) -> None:
    if not taken:
        return
    shown = ", ".join(list(taken)[:4]) + (f" and {len(taken) - 4} more" if len(taken) > 4 else "")
    rest = ", ".join(repr(other) for other in KINDS if other != kind)
    first = times[int(np.argmax(bad.any(axis=1)))]
    warn(
        f"{shown}: {max(taken.values())} of {len(times)} readings, from {first:.6g} s on, {text} "
        f"(screen=({rest},) keeps them)"
    )
