"""Recordings of real robots: clocks that jitter or restart, gaps, units, samples that are missing."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pisplit.checks import finite_number, one_of, positive, real_array
from pisplit.data import clock, resampling
from pisplit.data.columns import default_names, labels, table_columns
from pisplit.data.resampling import BRIDGED, Signal
from pisplit.data.units import columns_to_si

Array = NDArray[np.float64]
Index = NDArray[np.int64]

INTERPOLATIONS = ("linear", "cubic")
#: Fields of Episodes that a recording may name.
FIELDS = ("state_names", "input_names", "quantities", "units", "outputs", "provenance")
#: A share of samples that is lost to no episode is said above this.
LOST = 0.05
#: dt and sample spacing may differ by so much before it is said, and before it is refused (a unit is a thousand).
SPARSE, DENSE, ABSURD = 5.0, 100.0, 100.0
#: Spacings that differ so much (90th and 10th percentile) are of samples of several clocks.
MIXED = 20.0


def from_arrays(
    t: ArrayLike,
    x: ArrayLike,
    u: ArrayLike,
    dt: float | None = None,
    interpolation: str = "linear",
    max_gap: float | None = None,
    state_units: str | Sequence[str] | None = None,
    input_units: str | Sequence[str] | None = None,
    time_unit: str = "s",
    ranges: Mapping[str, tuple[float, float]] | None = None,
    episode: ArrayLike | None = None,
    **fields: Any,
) -> dict[str, Any]:
    """Fields of :class:`pisplit.Episodes`, by name, of a recording: its samples, brought to steps of one length.

    t              (N,) times: numbers in ``time_unit``, dates or durations
    x, u           (N, n) states and (N, m) inputs at these times, or tables with named columns. NaN, masked and absent
                   entries are missing: every state is interpolated between its own readings, every command holds until
                   the next one that is known, so that commands need only be there where they change
    dt             step of the episodes [s]; default: the median spacing of the states that were read most often
    interpolation  of the states between readings, "linear" or "cubic". The input of a step is the mean of the commands
                   over the step
    max_gap        longest time between readings of a state that is bridged [s], default 3 times its median spacing, or
                   3 dt; at longer ones the recording is split into episodes
    state_units, input_units, time_unit   units of the data (one for all, or one a column); converted to SI
    ranges         {column name: (low, high)} in SI units that readings must lie in
    episode        (N,) number or name of the run of every sample, for clocks that restart; default: one run
    fields         state_names, input_names, quantities, units (of states whose unit has no factor to SI), outputs and
                   provenance of :class:`pisplit.Episodes`

    Warns where more than 5 % of the samples are in no episode, and where dt or spacings do not look like one clock.
    Raises ValueError for times that do not increase, numbers that are infinite, unknown units, readings out of range,
    a dt a hundred times below the spacing, and if nothing is left.
    """
    one_of(interpolation, "interpolation", INTERPOLATIONS)
    unknown = sorted(set(fields) - set(FIELDS))
    if unknown:
        raise ValueError(f"unknown argument {unknown[0]!r}; a recording may name {', '.join(FIELDS)}")
    times = clock.seconds(t, time_unit)
    fields["state_names"] = table_columns([x], fields.get("state_names"), "state_names")
    fields["input_names"] = table_columns([u], fields.get("input_names"), "input_names")
    states, state_si = _in_si(_rows(x, "x", len(times)), state_units, "state_units")
    inputs, input_si = _in_si(_rows(u, "u", len(times)), input_units, "input_units")
    if fields.get("units") is not None and state_units is not None:
        raise ValueError("units and state_units both name the units of the states; give one of them")
    names = [
        labels(fields["state_names"], "state_names", default_names("states", states.shape[1])),
        labels(fields["input_names"], "input_names", default_names("inputs", inputs.shape[1])),
    ]
    if ranges:
        _check_ranges(ranges, [*names[0], *names[1]], np.hstack([states, inputs]), times)
    members = clock.runs(episode, times)
    signals = [_signals(times[rows], states[rows], inputs[rows]) for rows in members.values()]
    _check_read(signals, names)
    step = _step(dt, [run for run, _ in signals], names[0])
    gap = None if max_gap is None else positive(max_gap, "max_gap", "s")
    xs, us, labels_of, short, kept = [], [], [], 0, 0
    for (label, rows), (run, commands) in zip(members.items(), signals, strict=True):
        awake = rows[np.isfinite(states[rows]).any(axis=1)]
        _say_what_is_held(times[awake], inputs[awake], names[1], step, gap)
        grids, left = resampling.pieces(run, commands, step, gap)
        short += len(left)
        for grid in grids:
            gaps = [resampling.longest_gap(signal, step, gap) for signal in run]
            parts = [s.interpolated(grid, g, interpolation) for s, g in zip(run, gaps, strict=True)]
            xs.append(resampling.columns_at(run, parts, len(grid)))
            us.append(resampling.columns_at(commands, [s.held(grid) for s in commands], len(grid) - 1))
            labels_of.append(label)
            kept += int(((times[rows] >= grid[0]) & (times[rows] < grid[-1] + step)).sum())
    _say_what_is_lost(len(xs), short, kept, states, inputs, times, names, step)
    missing = ~(np.isfinite(states).all(axis=1) & np.isfinite(inputs).all(axis=1) & np.isfinite(times))
    origin = {
        "samples": len(times),
        "incomplete_samples": int(missing.sum()),
        "lost_samples": len(times) - kept,
        "pieces": len(xs) + short,
        "jitter": _jitter([run for run, _ in signals]),
        "interpolation": interpolation,
        **({} if episode is None else {"runs": labels_of}),
    }
    units = {"units": fields.get("units") or state_si, "input_units": input_si}
    return {
        **fields,
        **units,
        "xs": xs,
        "us": us,
        "dt": step,
        "provenance": {**origin, **(fields.get("provenance") or {})},
    }


def _in_si(values: Array, units: str | Sequence[str] | None, what: str) -> tuple[Array, tuple[str, ...]]:
    """Values (N, k) in SI units, and these."""
    names, factors = columns_to_si(units, what, values.shape[1])
    return values if (factors == 1.0).all() else values * factors, names


def _signals(times: Array, states: Array, inputs: Array) -> tuple[list[Signal], list[Signal]]:
    return resampling.signals(times, states), resampling.signals(times, inputs)


def _check_read(runs: Sequence[tuple[list[Signal], list[Signal]]], names: Sequence[Sequence[str]]) -> None:
    """Every column has readings: two of a state in one run, one of a command."""
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


def _step(dt: float | None, runs: Sequence[Sequence[Signal]], names: Sequence[str]) -> float:
    """The step [s]; says where it does not look like that of the readings."""
    finest = min((signal for run in runs for signal in run), key=lambda signal: signal.spacing)
    step = finest.spacing if dt is None else positive(dt, "dt", "s")
    if finest.spacing > ABSURD * step:
        raise ValueError(
            f"dt = {step:g} s, but samples are {finest.spacing:g} s apart; check time_unit, or give a larger dt"
        )
    low, high = np.quantile(np.diff(finest.times), [0.1, 0.9])
    if high > MIXED * low:
        _warn(f"samples are between {low:g} s and {high:g} s apart: several runs sorted into one? give episode=")
    elif finest.spacing * DENSE < step:
        _warn(
            f"dt = {step:g} s, but samples are {finest.spacing:g} s apart: of {step / finest.spacing:.0f} one is used"
        )
    slowest = max((signal for run in runs for signal in run), key=lambda s: s.spacing if len(s.times) > 1 else 0.0)
    if slowest.spacing > SPARSE * step:
        name = names[int(slowest.columns[0])]
        _warn(f"dt = {step:g} s, but {name} is read every {slowest.spacing:g} s: what lies between is interpolated")
    return step


def _jitter(runs: Sequence[Sequence[Signal]]) -> float:
    """Largest departure of a spacing from the median one [s], gaps left out."""
    finest = min((signal for run in runs for signal in run), key=lambda signal: signal.spacing)
    steps = np.diff(finest.times)
    return float(np.abs(steps[steps <= BRIDGED * finest.spacing] - finest.spacing).max(initial=0.0))


def _say_what_is_lost(
    episodes: int,
    short: int,
    kept: int,
    states: Array,
    inputs: Array,
    times: Array,
    names: Sequence[Sequence[str]],
    step: float,
) -> None:
    """Refuse a recording that gives no episode; say how many samples are in none, and why."""
    if not episodes:
        raise ValueError(
            f"no piece of the recording is longer than dt = {step:g} s; give a smaller dt or larger max_gap"
        )
    if short:
        _warn(f"{short} of {episodes + short} pieces are shorter than dt and dropped")
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
    _warn(f"{100 * lost / len(times):.0f} % of the samples ({lost} of {len(times)}) are in no episode: {why}")


def _say_what_is_held(times: Array, inputs: Array, names: Sequence[str], step: float, gap: float | None) -> None:
    """Say where commands that are otherwise in the rows are missing for long: their last value is held there."""
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
            _warn(
                f"{name} is missing for {spans[at]:g} s from {times[ends[at]]:g} s on; its last command is held there"
            )


def _warn(text: str) -> None:
    """Warn at the line that called this room."""
    frame, level = sys._getframe(1), 2
    while frame.f_back is not None and str(frame.f_globals.get("__name__")).startswith("pisplit.data"):
        frame, level = frame.f_back, level + 1
    warnings.warn(text, stacklevel=level)


def _check_ranges(ranges: Mapping[str, tuple[float, float]], names: Sequence[str], values: Array, times: Array) -> None:
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


def _rows(value: ArrayLike, name: str, size: int) -> Array:
    """Numbers (size, k), NaN where missing."""
    array = real_array(value, name)
    array = array[:, None] if array.ndim == 1 else array
    if array.ndim != 2 or len(array) != size:
        hint = f"; give {name}.T" if array.ndim == 2 and array.shape[1] == size else ""
        raise ValueError(f"{name} has shape {array.shape}; expected ({size}, columns), one row a time{hint}")
    infinite = int(np.isinf(array).sum())
    if infinite:
        raise ValueError(f"{name} has {infinite} infinite entries; give NaN where samples are missing")
    return array
