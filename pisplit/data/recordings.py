"""Recordings of real robots: clocks that jitter or restart, gaps, units, samples that are missing."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pisplit.checks import one_of, positive, real_array
from pisplit.data import (
    clock,
    exchanges,
    late_commands,
    mixups,
    recording_checks,
    resampling,
    screening,
    shifted_rows,
    unit_changes,
    wraps,
)
from pisplit.data.columns import default_names, labels, table_columns
from pisplit.data.resampling import BRIDGED, Signal
from pisplit.data.units import columns_to_si
from pisplit.data.warning import warn

Array = NDArray[np.float64]
Index = NDArray[np.int64]

INTERPOLATIONS = ("linear", "cubic")
#: Fields of Episodes that a recording may name.
FIELDS = ("state_names", "input_names", "quantities", "units", "outputs", "provenance")
#: dt and sample spacing may differ by so much before it is said, and before it is refused (a unit is a thousand).
SPARSE, DENSE, ABSURD = 5.0, 100.0, 100.0
#: Spacings of samples [s] from which, and below which, a clock without a unit is doubted.
SLOW, FAST = 2.0, 1e-5
#: Rounding of times in parts of their spacing from which on it is not that of two of them.
COARSE = 1e-6
#: Spacings that differ so much (90th and 10th percentile) are of samples of several clocks.
MIXED = 20.0


def from_arrays(
    t: ArrayLike | None,
    x: ArrayLike,
    u: ArrayLike,
    dt: float | None = None,
    interpolation: str = "linear",
    max_gap: float | None = None,
    state_units: str | Sequence[str] | None = None,
    input_units: str | Sequence[str] | None = None,
    time_unit: str | float | None = None,
    ranges: Mapping[str, tuple[float, float]] | None = None,
    episode: ArrayLike | None = None,
    screen: Sequence[str] = screening.KINDS,
    command_shift: float | str | None = None,
    **fields: Any,
) -> dict[str, Any]:
    """Fields of :class:`pisplit.Episodes`, by name, of a recording: its samples, brought to steps of one length.

    t              (N,) times: numbers in ``time_unit``, dates or durations; None: samples of a run are ``dt`` apart
    x, u           (N, n) states and (N, m) inputs at these times, or tables with named columns. NaN, masked and absent
                   entries are missing: every state is interpolated between its own readings, every command holds until
                   the next one that is known, so that commands need only be there where they change
    dt             step of the episodes [s]; default: the median spacing of the states that were read most often
    interpolation  of the states between readings, "linear" or "cubic". The input of a step is the mean of the commands
                   over the step
    max_gap        longest time between readings of a state that is bridged [s], default 3 times its median spacing, or
                   3 dt; at longer ones the recording is split into episodes
    state_units, input_units  units of the data (one for all, or one a column); converted to SI
    time_unit      unit of the times, s if not given; a number is seconds a tick, such as 0.01 for a counter of frames
    ranges         {column name: (low, high)} in SI units that readings must lie in
    episode        (N,) number or name of the run of every sample, for clocks that restart; default: one run
    screen         which readings are none, are taken for missing and warned of: "zeros" of lost tracking, in several
                   states at once and far from the readings beside (also an extreme value that comes back), and
                   "stalls", readings repeated to the last digit while the inputs move; () keeps all
    command_shift  [s] that is added to the times of the inputs, for commands whose stamps are late (negative) or early;
                   None: none, and where the motion comes before its commands, or follows them by more than a step,
                   this is said. A number says that it is known; "found" moves them by what is found, either way
    fields         state_names, input_names, quantities, units (of states whose unit has no factor to SI), outputs and
                   provenance of :class:`pisplit.Episodes`

    ``provenance`` counts what was read and lost; "starts" are the times [s] at which the episodes begin, "latency" is
    the delay [s] from commands to motion that was found where ``command_shift`` was not given.

    Warns of readings that were screened, of angles, counters and signs that wrap, of commands that are late or early,
    where more than 5 % of the samples are in no episode, and where dt or spacings do not look like one clock.
    Raises ValueError for times that do not increase, numbers that are infinite, unknown units, readings out of range,
    a dt a hundred times below the spacing, and if nothing is left.
    """
    asked = late_commands.told(command_shift)
    if asked == late_commands.FOUND:
        plain = (dt, interpolation, max_gap, state_units, input_units, time_unit, ranges, episode, screen)
        return late_commands.corrected(lambda found: from_arrays(t, x, u, *plain, found, **fields))
    one_of(interpolation, "interpolation", INTERPOLATIONS)
    unknown = sorted(set(fields) - set(FIELDS))
    if unknown:
        raise ValueError(f"unknown argument {unknown[0]!r}; a recording may name {', '.join(FIELDS)}")
    times = clock.seconds(t, time_unit) if t is not None else clock.counted(episode, x, dt)
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
    members = clock.runs(episode, times)
    shifted_rows.check_rows(np.hstack([states, inputs]), times, members)
    screened = screening.screened(times, states, inputs, members, names[0], screen)
    states = screened.states
    wraps.say(times, states, members, names[0])
    unit_changes.say(times, states, members, names[0])
    jumped = exchanges.say(times, np.hstack([states, inputs]), members, [*names[0], *names[1]])
    if ranges:
        recording_checks.check_ranges(ranges, [*names[0], *names[1]], np.hstack([states, inputs]), times)
    shift = asked if isinstance(asked, float) else 0.0
    signals = [_signals(times[rows], states[rows], inputs[rows], shift) for rows in members.values()]
    recording_checks.check_read(signals, names)
    step = _step(dt, [run for run, _ in signals], names[0], told=t is None or time_unit is not None)
    gap = None if max_gap is None else positive(max_gap, "max_gap", "s")
    xs, us, labels_of, cut, short, kept = [], [], [], [], 0, 0
    for (label, rows), (run, commands) in zip(members.items(), signals, strict=True):
        awake = rows[np.isfinite(states[rows]).any(axis=1)]
        recording_checks.say_what_is_held(times[awake], inputs[awake], names[1], step, gap)
        grids, left = resampling.pieces(run, commands, step, gap)
        short += len(left)
        for grid in grids:
            gaps = [resampling.longest_gap(signal, step, gap) for signal in run]
            parts = [s.interpolated(grid, g, interpolation) for s, g in zip(run, gaps, strict=True)]
            xs.append(resampling.columns_at(run, parts, len(grid)))
            us.append(resampling.columns_at(commands, [s.held(grid) for s in commands], len(grid) - 1))
            labels_of.append(label)
            cut.append(grid)
            kept += int(((times[rows] >= grid[0]) & (times[rows] < grid[-1] + step)).sum())
    recording_checks.say_what_is_lost(len(xs), short, kept, states, inputs, times, names, step)
    recording_checks.say_how_it_is_cut(cut, [run for run, _ in signals], names[0], step, gap)
    if not jumped:
        mixups.say(xs, us, cut, labels_of, [*names[0], *names[1]])
    lag = late_commands.found(xs, us, step) if asked is None else {"command_shift": shift}
    missing = ~(np.isfinite(states).all(axis=1) & np.isfinite(inputs).all(axis=1) & np.isfinite(times))
    origin = {
        "samples": len(times),
        "incomplete_samples": int(missing.sum()),
        "lost_samples": len(times) - kept,
        "pieces": len(xs) + short,
        "jitter": _jitter([run for run, _ in signals]),
        "interpolation": interpolation,
        "starts": [float(grid[0]) for grid in cut],
        **({"screened": screened.found} if screened.found else {}),
        **lag,
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


def _signals(times: Array, states: Array, inputs: Array, shift: float) -> tuple[list[Signal], list[Signal]]:
    read, sent = resampling.signals(times, states), resampling.signals(times + shift, inputs)
    if shift < 0.0 and len(times):  # nothing is known of the commands after the last one
        ends = times.max() + shift * (1.0 - 1e-9)
        read = [replace(s, times=s.times[s.times <= ends], values=s.values[s.times <= ends]) for s in read]
    return read, sent


def _step(dt: float | None, runs: Sequence[Sequence[Signal]], names: Sequence[str], told: bool = True) -> float:
    """The step [s]; says where it does not look like that of the readings, or as if a unit had not been ``told``."""
    finest = min((signal for run in runs for signal in run), key=lambda signal: signal.spacing)
    step = _spacing(finest.times, finest.spacing) if dt is None else positive(dt, "dt", "s")
    if finest.spacing > ABSURD * step:
        raise ValueError(
            f"dt = {step:g} s, but samples are {finest.spacing:g} s apart; check time_unit, or give a larger dt"
        )
    low, high = np.quantile(np.diff(finest.times), [0.1, 0.9])
    if high > MIXED * low:
        warn(f"samples are between {low:g} s and {high:g} s apart: several runs sorted into one? give episode=")
    elif finest.spacing * DENSE < step:
        warn(f"dt = {step:g} s, but samples are {finest.spacing:g} s apart: of {step / finest.spacing:.0f} one is used")
    if finest.spacing > SLOW and not told:
        warn(f"samples are {finest.spacing:g} s apart: is the clock in another unit? give time_unit, 's' if it is not")
    if finest.spacing < FAST and not told:
        warn(
            f"samples are {finest.spacing:.3g} s apart: is the clock in another unit? give time_unit, 'day' for dates "
            "of a spreadsheet, 's' if it is not"
        )
    slowest = max((signal for run in runs for signal in run), key=lambda s: s.spacing if len(s.times) > 1 else 0.0)
    if slowest.spacing > SPARSE * step:
        name = names[int(slowest.columns[0])]
        warn(f"dt = {step:g} s, but {name} is read every {slowest.spacing:g} s: what lies between is interpolated")
    return step


def _spacing(times: Array, median: float) -> float:
    """The ``median`` spacing of ``times`` [s]; the mean of those alike where floats since 1970 are too coarse."""
    coarse = float(np.spacing(np.abs(times).max()))
    if coarse < COARSE * median:
        return median
    steps = np.diff(times)
    alike = steps[np.abs(steps - median) <= 2.0 * coarse]
    return round(float(alike.mean()), int(-np.ceil(np.log10(2.0 * coarse / len(alike)))))


def _jitter(runs: Sequence[Sequence[Signal]]) -> float:
    """Largest departure of a spacing from the median one [s], gaps left out."""
    finest = min((signal for run in runs for signal in run), key=lambda signal: signal.spacing)
    steps = np.diff(finest.times)
    return float(np.abs(steps[steps <= BRIDGED * finest.spacing] - finest.spacing).max(initial=0.0))


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
