"""What recordings have to be to become episodes, and what is said where they only nearly are."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from pisplit.checks import finite_number
from pisplit.data.resampling import BRIDGED, Signal, longest_gap
from pisplit.data.warning import warn

Array = NDArray[np.float64]

#: A share of samples that is lost to no episode is said above this.
LOST = 0.05
#: So many cuts into pieces of so few samples are said.
MANY, BRIEF = 10, 60


def check_read(runs: Sequence[tuple[list[Signal], list[Signal]]], names: Sequence[Sequence[str]]) -> None:
    """Raise ValueError for columns without readings: two of a state in one run, one of a command.

    runs   signals of the states and of the inputs of every run
    names  names of the states and of the inputs
    """
    for kind, columns, least in ((0, names[0], 2), (1, names[1], 1)):
        most = dict.fromkeys(range(len(columns)), 0)
        for run in runs:
            for signal in run[kind]:
                most |= {int(c): max(most[int(c)], len(signal.times)) for c in signal.columns}
        for column, readings in most.items():
            if readings < least:
                raise ValueError(
                    f"{columns[column]} has {readings} readings with a time; a recording needs at least {least}"
                )


def say_what_is_lost(
    episodes: int,
    short: int,
    kept: int,
    states: Array,
    inputs: Array,
    times: Array,
    names: Sequence[Sequence[str]],
    step: float,
) -> None:
    """Say how many samples are in no episode, and why; ValueError for a recording that gives no episode.

    episodes, short        number of episodes, and of pieces that were shorter than a ``step`` [s]
    kept                   number of samples that are in an episode
    states, inputs, times  (N, n), (N, m), (N,) the samples, NaN where missing
    names                  names of the states and of the inputs
    """
    if not episodes:
        raise ValueError(
            f"no piece of the recording is longer than dt = {step:g} s; give a smaller dt or larger max_gap"
        )
    if short:
        warn(f"{short} of {episodes + short} pieces are shorter than dt and dropped")
    lost = len(times) - kept
    if lost <= LOST * len(times):
        return
    reasons = []
    if not np.isfinite(times).all():
        reasons.append(f"t is missing in {int((~np.isfinite(times)).sum())} samples")
    absent = (~np.isfinite(states)).sum(axis=0)
    if absent.any():
        reasons.append(f"{names[0][int(absent.argmax())]} is missing in {absent.max()}, for longer than max_gap")
    if inputs.shape[1]:
        first = np.argmax(np.isfinite(inputs), axis=0)
        if first.max() > 0:
            reasons.append(f"{names[1][int(first.argmax())]} has no command before sample {first.max()}")
    reasons.append("the rest is shorter than dt between gaps longer than max_gap" if not reasons else "")
    why = "; ".join(reason for reason in reasons if reason)
    warn(f"{100 * lost / len(times):.0f} % of the samples ({lost} of {len(times)}) are in no episode: {why}")


def say_how_it_is_cut(
    grids: Sequence[Array], runs: Sequence[Sequence[Signal]], names: Sequence[str], step: float, max_gap: float | None
) -> None:
    """Say where gaps cut a recording into very many pieces, and which ``max_gap`` would not.

    grids          times [s] of the pieces
    runs           signals of the states of every run
    names          (n,) of the states
    step, max_gap  step of the episodes and longest gap that is bridged [s]; None: 3 usual spacings
    """
    usual = float(np.median([len(grid) for grid in grids])) if grids else 0.0
    if len(grids) - len(runs) < MANY or usual > BRIEF:
        return
    cuts: dict[str, list[float]] = {}
    for run in runs:
        for signal in run:
            steps = np.diff(signal.times)
            gap = longest_gap(signal, step, max_gap)
            cuts.setdefault(names[int(signal.columns[0])], []).extend(steps[steps > gap].tolist())
    name = max(cuts, key=lambda key: len(cuts[key]))
    longer = np.array(cuts[name])
    most = float(np.quantile(longer, 0.9)) if len(longer) else step
    warn(
        f"gaps cut the recording into {len(grids)} pieces of about {usual:.0f} samples: {name} is missing "
        f"{len(longer)} times; max_gap={1.01 * most:.2g} bridges 9 of 10 of them by interpolation"
    )


def say_what_is_held(times: Array, inputs: Array, names: Sequence[str], step: float, gap: float | None) -> None:
    """Say where commands that are otherwise in the rows are missing for long: their last value is held there.

    times, inputs  (N,), (N, m) the samples of a run, NaN where missing
    names          (m,) of the inputs
    step, gap      step of the episodes and longest gap that is not said [s]; None: 3 usual spacings
    """
    for name, column in zip(names, inputs.T, strict=True):
        read = np.flatnonzero(np.isfinite(column))
        if 2 * len(read) < max(len(column), 4):  # written where it changes
            continue
        ends = np.append(read, len(column) - 1) if read[-1] < len(column) - 1 else read
        spans = np.diff(times[ends])
        longest = BRIDGED * max(float(np.median(spans)), step) if gap is None else gap
        held = np.flatnonzero((np.diff(ends) > 1) & (spans > longest))
        if len(held):
            at = held[np.argmax(spans[held])]
            warn(f"{name} is missing for {spans[at]:g} s from {times[ends[at]]:g} s on; its last command is held there")


def check_ranges(ranges: Mapping[str, tuple[float, float]], names: Sequence[str], values: Array, times: Array) -> None:
    """Raise ValueError where readings are outside the ``ranges`` {name: (low, high)} of their column.

    ``values`` (N, k) are those of the columns ``names`` (k,) at ``times`` (N,).
    """
    for name, bounds in ranges.items():
        if name not in names:
            raise ValueError(f"ranges names {name!r}; expected names of columns ({', '.join(names[:8])})")
        low, high = (finite_number(bound, f"ranges[{name!r}]") for bound in bounds)
        column = values[:, names.index(name)]
        outside = np.flatnonzero((column < low) | (column > high))
        if len(outside):
            raise ValueError(
                f"{name} is {column[outside[0]]:g} at {times[outside[0]]:g} s and outside [{low:g}, {high:g}] in "
                f"{len(outside)} samples; check its unit or remove them"
            )
