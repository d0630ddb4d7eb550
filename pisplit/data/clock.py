"""Clocks of recordings: times in seconds, runs, and what is wrong with times that do not increase."""

from __future__ import annotations

from datetime import datetime, timedelta, timezone
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pisplit.checks import positive, real_array
from pisplit.data.units import to_si

Array = NDArray[np.float64]
Index = NDArray[np.int64]

#: A clock that falls back by more than so many steps has restarted; by less, samples are out of order.
RESTART = 10.0
EXACT = 2**53
#: Seconds from 1970 to a year of four digits are fewer.
SINCE_1970 = 1e11


def seconds(t: ArrayLike, time_unit: str | float | None = None) -> Array:
    """Times (N,) in seconds; those of dates count from the first of them. NaN where a time is missing.

    t          (N,) numbers in ``time_unit``, or dates or durations (NumPy, pandas, datetime), whose unit is their own
    time_unit  "s" (the default), "ms", "us", "ns", "min", "hour" or "day", or seconds a tick

    Raises ValueError for other shapes, texts and units, and for dates with a ``time_unit`` beside them.
    """
    if isinstance(time_unit, bool):
        raise ValueError(f"time_unit = {time_unit}; expected a unit of time, or seconds a tick")
    if isinstance(time_unit, str | None):
        second, factor = to_si(time_unit or "s", "time_unit")
        if second != "s":
            raise ValueError(f"time_unit = {time_unit!r}; expected a unit of time: s, ms, us, ns, min, hour or day")
    else:
        factor = positive(time_unit, "time_unit", "s")
    array = np.asarray(t) if not isinstance(t, np.ma.MaskedArray) else t
    if array.ndim != 1:
        raise ValueError(f"t has shape {array.shape}; expected (N,)")
    if array.dtype.kind == "O" and any(isinstance(v, datetime | timedelta) for v in array):
        array = _instants(array)
    if array.dtype.kind in "mM":
        if time_unit not in (None, "s"):
            raise ValueError(f"t holds dates or durations, whose unit is known; leave time_unit = {time_unit!r} out")
        return _elapsed(array)
    if array.dtype.kind in "iu" and len(array) and max(int(array.max()), -int(array.min())) > EXACT:
        array = array - array.min()  # ticks since 1970 have more digits than a float
    times = real_array(array, "t") * factor
    if time_unit is None and np.nanmax(np.abs(times), initial=0.0) > SINCE_1970:
        raise ValueError(
            f"t has times such as {np.nanmax(times):.6g}, too many for seconds since 1970; give time_unit, "
            "such as 'ms', 'us' or 'ns'"
        )
    if np.isinf(times).any():
        raise ValueError(f"t has {int(np.isinf(times).sum())} infinite entries; missing times are NaN")
    return times


def together(
    first: tuple[Any, str | float | None, str], second: tuple[Any, str | float | None, str]
) -> tuple[Array, Array]:
    """Two clocks in seconds since one moment, NaN where missing.

    ``first``, ``second``: times (N,), their unit as in :func:`seconds`, and their file. Raises ValueError where one has
    dates and the other numbers.
    """
    arrays = [np.asarray(times) for times, _, _ in (first, second)]
    dated = [array.dtype.kind in "OM" for array in arrays]
    if dated[0] != dated[1]:
        raise ValueError(f"{first[2]} and {second[2]} do not both have dates for times; write both clocks in one way")
    if dated[0]:
        both = [_instants(array) if array.dtype.kind == "O" else array for array in arrays]
        joint = _elapsed(np.concatenate(both))
        return joint[: len(arrays[0])], joint[len(arrays[0]) :]
    if all(array.dtype.kind in "iu" and len(array) for array in arrays) and first[1] == second[1]:
        start = min(int(array.min()) for array in arrays)
        arrays = [array - start for array in arrays]
    t, s = (seconds(array, unit) for array, (_, unit, _) in zip(arrays, (first, second), strict=True))
    return t, s


def counted(episode: ArrayLike | None, x: ArrayLike, dt: float | None) -> Array:
    """Times (N,) [s] of samples ``x`` (N, ...) that are ``dt`` [s] apart, from 0 on in every run of ``episode`` (N,).

    Raises ValueError where ``dt`` is None.
    """
    if dt is None:
        raise ValueError("no column of times and no dt; name the times, or give dt=, the seconds between samples")
    size = len(np.asarray(x))
    if episode is None:
        return np.arange(size, dtype=np.float64) * positive(dt, "dt", "s")
    seen: dict[str, int] = {}
    found = np.empty(size, dtype=np.float64)
    for i, label in enumerate(_labels(episode, size)):
        found[i] = seen.get(label, 0)
        seen[label] = seen.get(label, 0) + 1
    return found * positive(dt, "dt", "s")


def runs(episode: ArrayLike | None, times: Array) -> dict[str, Index]:
    """Positions of the samples of every run that have a time, in order, by the label of the run.

    episode  (N,) number or name of the run of every sample; None: all are of one run, whose label is ""
    times    (N,) seconds, NaN where missing

    Raises ValueError for labels that are missing, and where the time of a run does not increase.
    """
    timed = np.flatnonzero(np.isfinite(times))
    if episode is None:
        found = {"": timed}
    else:
        labels = _labels(episode, len(times))
        members: dict[str, list[int]] = {}
        for i in timed.tolist():
            members.setdefault(labels[i], []).append(i)
        found = {label: np.array(rows, dtype=np.int64) for label, rows in members.items()}
    for label, rows in found.items():
        _check_increasing(times, rows, f"run {label!r}: " if label else "")
    return found


def _labels(episode: ArrayLike, size: int) -> list[str]:
    array = np.asarray(episode)
    wanted = "the number or name of the run of every sample"
    if array.shape != (size,):
        raise ValueError(f"episode has shape {array.shape}; expected ({size},), {wanted}")
    labels = [str(v) for v in array.tolist()]
    if np.ma.is_masked(episode) or not {"", "nan", "None", "<NA>", "NaT"}.isdisjoint(labels):
        raise ValueError(f"episode is missing for some samples; give {wanted}")
    return labels


def _check_increasing(times: Array, rows: Index, run: str) -> None:
    steps = np.diff(times[rows])
    if (steps > 0.0).all():
        return
    falls = np.flatnonzero(steps < 0.0)
    at = int(falls[0]) if len(falls) else int(np.argmax(steps <= 0.0))
    before, after = (f"{times[rows[k]]:.12g} s" for k in (at, at + 1))
    where = f"{run}t does not increase after sample {rows[at]} ({before}, then {after})"
    if not len(falls):
        repeated = int((steps == 0.0).sum())
        if 3 * repeated > len(steps):
            raise ValueError(
                f"{where}: its times have too few digits (for a known rate time=None and dt=), or every row holds "
                f"another sensor (give one row a time)"
            )
        raise ValueError(f"{where}: {repeated} repeated times; keep one sample of each")
    if len(falls) == len(steps):
        raise ValueError(f"{where}: it runs backwards; reverse all rows")
    if -steps[at] > RESTART * float(np.median(np.abs(steps))):
        raise ValueError(f"{where}: several runs? give episode=, the number or name of the run of every sample")
    raise ValueError(f"{where}: samples are out of order; order the rows by time")


def _instants(array: NDArray[Any]) -> NDArray[Any]:
    """Objects of datetime as NumPy's; those with a time zone in UTC, where no hour is lost or repeated."""
    found = []
    for v in array:
        if isinstance(v, datetime) and v.tzinfo is not None:
            v = v.astimezone(timezone.utc).replace(tzinfo=None)
        if not isinstance(v, datetime | timedelta) and v is not None and v == v and type(v).__name__ != "NaTType":
            raise ValueError(f"t mixes dates with {v!r}; give times of one kind")
        found.append(v if isinstance(v, datetime | timedelta) else None)
    kinds = {isinstance(v, timedelta) for v in found if v is not None}
    if len(kinds) != 1:
        raise ValueError("t mixes dates and durations; give times of one kind")
    return np.array(
        [np.datetime64("NaT") if v is None else v for v in found], "m8[us]" if kinds == {True} else "M8[us]"
    )


def _elapsed(array: NDArray[Any]) -> Array:
    """Seconds of durations, or of dates since the first."""
    unit = np.datetime_data(array.dtype)[0]
    if unit in ("Y", "M", "generic"):
        raise ValueError(f"t holds {array.dtype}, whose ticks are no number of seconds; give seconds")
    plain = np.asarray(array)
    known = np.flatnonzero(~np.isnat(plain))
    if array.dtype.kind == "M" and len(known):
        plain = plain - plain[known[0]]
    times = plain / np.timedelta64(1, "s")
    times[np.isnat(plain) | np.ma.getmaskarray(array)] = np.nan
    return np.asarray(times, dtype=np.float64)
