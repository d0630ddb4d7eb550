"""Sensors and commands that were logged apart, each with its own clock, become one recording."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pisplit.data import clock
from pisplit.data.joining import Table, from_columns
from pisplit.data.late_commands import FOUND, correction, said
from pisplit.data.late_commands import told as told_shift
from pisplit.data.latency import Latency, find_latency
from pisplit.data.warning import silently, warn

Array = NDArray[np.float64]

#: A log of commands is steady if nine of ten spacings are at most so many times the median; pauses are longer by this.
STEADY, PAUSE = 1.5, 10.0
#: Commands that all come within this part of the time of the sensors have another unit.
BRIEF = 0.1


def from_two_clocks(
    sensors: Sequence[Table],
    commands: Sequence[Table],
    states: Sequence[str],
    inputs: Sequence[str],
    told: tuple[str | float | None, str | float | None],
    options: Mapping[str, Any],
) -> dict[str, Any]:
    """Fields of Episodes of ``sensors`` with columns ``states`` and of ``commands`` with columns ``inputs``.

    told     unit of the times of commands where their files name none (None: that of the sensors if it is a text, or
             s), and what is added to them [s] (None: what the data tell, if the motion comes before its commands, which
             is warned of; "found": what they tell, either way)
    options  as in :func:`pisplit.data.recordings.from_arrays`

    Each file of sensors goes with the file of commands of the same place in the list, or with the only one. Commands
    hold from their time to the next. Raises ValueError, in one line, for other numbers of files, clocks that have no
    time in common, and runs within a file.
    """
    if len(commands) not in (1, len(sensors)):
        raise ValueError(
            f"{len(sensors)} files of sensors, {len(commands)} of commands; give one for each, or one for all"
        )
    if any(t.times is None for t in [*sensors, *commands]):
        raise ValueError("sensors and commands apart need times in both; name the column of times")
    if any(t.runs is not None for t in [*sensors, *commands]):
        raise ValueError("commands apart go with files of one run each; leave episode= out")
    paired = list(commands) * len(sensors) if len(commands) == 1 else list(commands)
    plain = {key: value for key, value in options.items() if key not in ("time_unit", "ranges")}
    unit = options.get("time_unit")
    units = unit, told[0] if told[0] is not None else unit if isinstance(unit, str) else None
    asked = told_shift(told[1])
    known = asked if isinstance(asked, float) else None

    def fields(shift: float, more: Mapping[str, Any]) -> dict[str, Any]:
        merged = [_merged(s, c, units, shift) for s, c in zip(sensors, paired, strict=True)]
        return from_columns(merged, states, inputs, {**plain, **more, "command_shift": 0.0})

    ranges = {"ranges": options["ranges"]} if "ranges" in options else {}
    first = fields(known or 0.0, ranges)
    finest = first if options.get("dt") is None else silently(lambda: fields(known or 0.0, {**ranges, "dt": None}))
    seen = finest if finest["dt"] < first["dt"] else first  # the sensors tell more than the steps that are made of them
    latency = find_latency(seen["xs"], seen["us"], seen["dt"])
    shift, text = known or 0.0, None
    if asked == FOUND:
        shift, text = correction(latency)
    elif known is None:
        shift, text = _shift(latency, first["dt"], _hold(first["us"], first["dt"]))
    found = first if shift == (known or 0.0) else silently(lambda: fields(shift, ranges))
    if text:
        warn(text)
    found["provenance"].pop("incomplete_samples")  # rows of both clocks: most have no command
    found["provenance"] |= {
        "commands": [c.source for c in commands],
        "command_shift": shift,
        "latency": None if latency.delay is None else latency.delay + (known or 0.0) - shift,
        "latency_error": latency.error if math.isfinite(latency.error) else None,
    }
    return found


def _hold(us: Sequence[Array], dt: float) -> float:
    """Usual time for which a command stays [s]."""
    new = sum(int((np.diff(u, axis=0) != 0.0).any(axis=1).sum()) for u in us)
    return dt * sum(map(len, us)) / max(new, 1)


def _shift(latency: Latency, dt: float, hold: float) -> tuple[float, str | None]:
    """The shift of the commands [s] that ``latency`` asks for, and what is said of it.

    A command that stays for a time is not sharper than a part of that: less than a quarter is no clock that is late.
    """
    if latency.delay is None:
        return 0.0, "the delay between commands and sensors is not visible in the data; their clocks are taken for one"
    late, within = 1e3 * latency.delay, 1e3 * latency.error
    within_hold = latency.error if latency.begins else 0.25 * min(hold, latency.error)
    if latency.delay < -latency.error - within_hold:
        return latency.delay, (
            f"the motion comes {-late:.0f} ms (within {within:.0f} ms) before its commands: these are moved by that; "
            f"command_shift={latency.delay:.3g} says it, a shift that is known is better"
        )
    return 0.0, said(latency, dt) or None


def _merged(sensors: Table, commands: Table, units: tuple[Any, Any], shift: float) -> Table:
    """One table of both: states where sensors were read, inputs where commands were sent."""
    t, s = clock.together(
        (sensors.times, sensors.clock or units[0], sensors.source),
        (commands.times, commands.clock or units[1], commands.source),
    )
    s = s + shift
    read, sent = np.flatnonzero(np.isfinite(t)), np.flatnonzero(np.isfinite(s))
    if not len(read) or not len(sent) or s[sent].min() > t[read].max() or s[sent].max() < t[read].min():
        spans = [f"{v[k].min():.6g} to {v[k].max():.6g} s" if len(k) else "no time" for v, k in ((t, read), (s, sent))]
        raise ValueError(
            f"{sensors.source} ({spans[0]}) and {commands.source} ({spans[1]}) have no time in common; "
            f"give time_unit, or command_shift= between their clocks"
        )
    if (np.diff(s[sent]) < 0.0).any():
        raise ValueError(f"{commands.source}: times run back; give one file a run")
    _say_where_commands_end(sensors, commands, t[read], s[sent])
    before = sent[s[sent] <= t[read].min()]
    wanted = np.concatenate([before[-1:], sent[(s[sent] > t[read].min()) & (s[sent] <= t[read].max())]])
    wanted = wanted[np.append(np.diff(s[wanted]) > 0.0, True)]  # of commands of one time the last one counts
    times = np.union1d(t[read], s[wanted])
    columns: dict[str, Array] = {}
    for source, own, rows in ((sensors, t, read), (commands, s, wanted)):
        at = np.searchsorted(times, own[rows])
        if len(np.unique(at)) < len(at):
            k = int(np.argmax(np.diff(np.sort(own[rows])) == 0.0))
            raise ValueError(
                f"{source.source}: time {np.sort(own[rows])[k]:.9g} s is there twice; keep one sample of each"
            )
        for name, column in source.columns.items():
            columns[name] = np.full(len(times), np.nan)
            columns[name][at] = column[rows]
    return replace(sensors, columns=columns, units={**sensors.units, **commands.units}, times=times, clock="s")


def _say_where_commands_end(sensors: Table, commands: Table, t: Array, s: Array) -> None:
    """Say where a log of commands at a steady rate stops or pauses; one that is written at changes may end any time."""
    if len(s) >= 10 and np.ptp(s) < BRIEF * np.ptp(t):
        warn(
            f"all {len(s)} commands of {commands.source} come within {np.ptp(s):.3g} s, {sensors.source} takes "
            f"{np.ptp(t):.3g} s: are its times in another unit? give command_time_unit"
        )
        return
    steps = np.diff(s[(s >= t.min()) & (s <= t.max())])
    if len(steps) < 10 or np.quantile(steps, 0.9) > STEADY * np.median(steps):
        return
    longest, pause = PAUSE * float(np.median(steps)), float(steps.max())
    if t.max() - s.max() > longest:
        warn(
            f"{commands.source} ends {t.max() - s.max():.3g} s before {sensors.source}; its last command is held: "
            f"cut the sensors if it was not"
        )
    if pause > longest:
        warn(f"{commands.source} pauses for {pause:.3g} s; its last command is held there")
