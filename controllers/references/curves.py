"""Reference trajectories of tracked outputs: functions of time that know where they start.

A coordinate that a reference does not specify is NaN: free. The tip of an inextensible arm moves on a surface, so a
circle in x and y leaves z to the arm. References can be pickled and copied; a ``function`` of the user's own must be
one that can (no lambda).
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from pisplit.checks import Array, count, finite_array, finite_number, non_negative, positive, real_array

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PLANES = {"xy": (0, 1), "yz": (1, 2), "xz": (0, 2), "yx": (1, 0), "zy": (2, 1), "zx": (2, 0)}
TIME_TOLERANCE = 1e-9  # [s] k * dt may fall short of a switching time by a rounding error


@dataclass(frozen=True, eq=False)
class Reference:
    """y_ref(t): ``reference(t (N,)) -> (N, width)`` for the outputs named ``track``; NaN marks a free coordinate.

    ``function``: (t (N,) from 0 on, start (width,)) -> (N, width), in the units of the outputs. ``width``: their
    number. ``needs_start``: it begins at the measured outputs, ``start`` (width,), which ``starting_at`` supplies; a
    closed loop does that at its start.

    Raises ValueError where it is asked before it knows its start, and for a function of another width.
    """

    function: Callable[[Array, Array], Array]
    width: int
    needs_start: bool = False
    track: str = "tip"
    start: Array | None = None

    def __call__(self, t: ArrayLike) -> Array:
        """The reference (N, width) at times t (N,) [s] from the start of the run."""
        times = finite_array(t, "t", (None,))
        if self.needs_start and self.start is None:
            raise ValueError("this reference begins at the measured outputs; use reference.starting_at(y0)(t)")
        start = np.full(self.width, np.nan) if self.start is None else self.start
        y = np.array(self.function(times.copy(), start.copy()), dtype=np.float64)
        if y.shape != (len(times), self.width):
            raise ValueError(f"the reference function gave shape {y.shape}; expected ({len(times)}, {self.width})")
        return y

    def starting_at(self, y0: ArrayLike) -> Reference:
        """The same reference with the outputs y0 (width,) at t = 0, where it has not been given another start."""
        if self.start is not None or not self.needs_start:
            return self
        return replace(self, start=finite_array(y0, "y0", (self.width,)).copy())

    def approached(self, duration: float) -> Reference:
        """The same reference, reached from the starting point by a quintic blend over ``duration`` [s].

        Position, velocity and acceleration are those of rest at t = 0 and those of the reference at t = duration.
        """
        T = positive(duration, "duration", "s")
        return replace(self, function=_Approached(self.function, T), needs_start=True)

    def plot(
        self, path: str | os.PathLike[str] | None = None, duration: float = 10.0, y0: ArrayLike | None = None
    ) -> Figure:
        """The coordinates over ``duration`` s; written to ``path`` where one is given.

        ``y0`` (width,): where it starts, the origin if not given and nothing else is known.
        """
        from pisplit.controllers.reference_pictures import plot_reference

        return plot_reference(self, path, duration, y0)


@dataclass(frozen=True, eq=False)
class _Approached:
    """``function``, blended in from the start over ``duration``."""

    function: Callable[[Array, Array], Array]
    duration: float

    def __call__(self, t: Array, start: Array) -> Array:
        weight = minimum_jerk(t / self.duration)[:, None]
        target = self.function(t, start)
        return np.where(weight < 1.0, start + weight * (target - start), target)


def minimum_jerk(s: ArrayLike) -> Array:
    """10 s^3 - 15 s^4 + 6 s^5 for ``s`` on [0, 1], 0 before and 1 after: rest to rest with least jerk.

    Source: Flash and Hogan, Journal of Neuroscience 5 (1985).
    """
    s = np.clip(np.asarray(s, dtype=np.float64), 0.0, 1.0)
    return s**3 * (10.0 - 15.0 * s + 6.0 * s**2)


def circle(
    radius: float,
    period: float,
    center: ArrayLike | None = None,
    plane: str = "xy",
    phase: float = 0.0,
    approach: float | None = None,
    track: str = "tip",
    width: int = 3,
) -> Reference:
    """Circle of ``radius`` with ``period`` [s] in a coordinate ``plane`` of a point; the third coordinate is free.

    ``radius`` and ``center`` (2,) in the plane, the starting point if not given, are in the unit of the outputs;
    ``phase`` [rad] at t = 0; the circle runs from the first axis of the plane to the second. ``approach``: seconds of
    blend from the starting point onto the circle, half a period if not given, 0 for none. ``track``: name of the
    outputs, ``width`` coordinates: 3, or 2 where there is no third.
    """
    R, T = positive(radius, "radius"), positive(period, "period", "s")
    axes = axes_of(plane, width)
    lead_in = T / 2 if approach is None else non_negative(approach, "approach", "s")
    middle = None if center is None else finite_array(center, "center", (2,)).copy()
    function = _Circle(R, T, middle, axes, finite_number(phase, "phase"), width)
    plain = Reference(function, width=width, needs_start=middle is None, track=track)
    return plain.approached(lead_in) if lead_in > 0.0 else plain


def axes_of(plane: str, width: int) -> tuple[int, int]:
    """The two coordinates of a coordinate ``plane``, out of ``width``.

    Raises ValueError for planes that there are not among so many coordinates.
    """
    if plane not in PLANES:
        raise ValueError(f"plane = {plane!r}; expected one of {', '.join(map(repr, PLANES))}")
    if max(PLANES[plane]) >= count(width, "width"):
        raise ValueError(f"width = {width}; the plane {plane!r} needs {max(PLANES[plane]) + 1} coordinates")
    return PLANES[plane]


@dataclass(frozen=True, eq=False)
class _Circle:
    radius: float
    period: float
    center: Array | None
    axes: tuple[int, int]
    phase: float
    width: int

    def __call__(self, t: Array, start: Array) -> Array:
        angle = self.phase + 2.0 * np.pi * t / self.period
        axes = list(self.axes)
        center = start[axes] if self.center is None else self.center
        y = np.full((len(t), self.width), np.nan)
        y[:, axes] = center + self.radius * np.column_stack([np.cos(angle), np.sin(angle)])
        return y


def constant(point: ArrayLike | None = None, width: int | None = None, track: str = "tip") -> Reference:
    """One ``point`` (p,) at all times, NaN where free, or the starting point, of ``width`` coordinates (3).

    ``track``: name of the outputs. Raises ValueError if ``width`` is given beside a point of another size.
    """
    if point is None:
        size = 3 if width is None else count(width, "width")
        return Reference(_Constant(None), size, needs_start=True, track=track)
    where = _points([point], "point")[0]
    if width is not None and width != len(where):
        raise ValueError(f"width = {width}, but the point has {len(where)} coordinates; leave the width out")
    return Reference(_Constant(where), len(where), track=track)


@dataclass(frozen=True, eq=False)
class _Constant:
    point: Array | None

    def __call__(self, t: Array, start: Array) -> Array:
        return np.tile(start if self.point is None else self.point, (len(t), 1))


def setpoint(positions: ArrayLike, times: ArrayLike, track: str = "tip") -> Reference:
    """Piecewise constant: positions[k] (K, p) from times[k] (K,) [s] on, the starting point before the first time.

    ``track``: name of the outputs.
    """
    y = _points(positions, "positions")
    switch = _increasing(times, len(y))
    return Reference(_SetPoints(y, switch), y.shape[1], needs_start=bool(switch[0] > 0.0), track=track)


@dataclass(frozen=True, eq=False)
class _SetPoints:
    positions: Array
    times: Array

    def __call__(self, t: Array, start: Array) -> Array:
        at = np.searchsorted(self.times, t + TIME_TOLERANCE, side="right")
        return np.asarray(np.vstack([start, self.positions])[at])


def waypoints(points: ArrayLike, times: ArrayLike, track: str = "tip") -> Reference:
    """Rest-to-rest minimum-jerk moves through ``points`` (K, p), each reached at its time (K,) [s], then held.

    With ``times[0]`` > 0 the first move begins at the starting point. ``track``: name of the outputs.
    """
    y = _points(points, "points")
    stops = _increasing(times, len(y))
    return Reference(_Waypoints(y, stops), y.shape[1], needs_start=bool(stops[0] > 0.0), track=track)


@dataclass(frozen=True, eq=False)
class _Waypoints:
    points: Array
    times: Array

    def __call__(self, t: Array, start: Array) -> Array:
        from_start = self.times[0] > 0.0
        knots = np.vstack([start, self.points]) if from_start else self.points
        at = np.concatenate([[0.0], self.times]) if from_start else self.times
        if len(at) == 1:
            return np.tile(knots, (len(t), 1))
        k = np.clip(np.searchsorted(at, t, side="right") - 1, 0, len(at) - 2)
        weight = minimum_jerk((t - at[k]) / (at[k + 1] - at[k]))[:, None]
        return np.asarray(knots[k] + weight * (knots[k + 1] - knots[k]))


def sequence(*segments: tuple[Reference, float]) -> Reference:
    """One reference after the other: ``segments`` are (reference, duration [s]), the last duration may be infinite.

    Each segment starts where the one before ends, and the last goes on after its duration.
    """
    if not segments:
        raise ValueError("sequence() is empty; give (reference, duration) pairs")
    parts = [segment[0] for segment in segments]
    durations = [
        duration if k == len(segments) - 1 and duration == np.inf else positive(duration, f"duration of segment {k}")
        for k, (_, duration) in enumerate(segments)
    ]
    first = parts[0]
    if any(part.width != first.width or part.track != first.track for part in parts):
        raise ValueError("the segments differ in their outputs; give references of one width and track")
    function = _Sequence(tuple(parts), tuple(durations))
    return Reference(function, first.width, any(part.needs_start for part in parts), first.track)


@dataclass(frozen=True, eq=False)
class _Sequence:
    parts: tuple[Reference, ...]
    durations: tuple[float, ...]

    def __call__(self, t: Array, start: Array) -> Array:
        begins = np.concatenate([[0.0], np.cumsum(self.durations[:-1])])
        owner = np.searchsorted(begins, t + TIME_TOLERANCE, side="right") - 1
        y = np.empty((len(t), self.parts[0].width))
        for k, (part, begin) in enumerate(zip(self.parts, begins, strict=True)):
            chosen = owner == k
            own_start = start if part.start is None else part.start
            y[chosen] = part.function(np.maximum(t[chosen] - begin, 0.0), own_start)
            last = k + 1 == len(self.parts)
            end = own_start if last else part.function(np.array([self.durations[k]]), own_start)[0]
            start = np.where(np.isnan(end), start, end)  # a free coordinate is taken to have stayed
        return y


def from_array(y: ArrayLike, dt: float, track: str = "tip") -> Reference:
    """Samples ``y`` (T, p) at 0, ``dt``, 2 dt, ... [s], linear in between, the last one held; NaN entries are free.

    ``track``: name of the outputs. The samples are copied.
    """
    samples = _points(y, "y")
    return Reference(_Samples(samples, positive(dt, "dt", "s")), samples.shape[1], track=track)


@dataclass(frozen=True, eq=False)
class _Samples:
    samples: Array
    dt: float

    def __call__(self, t: Array, start: Array) -> Array:
        samples = self.samples
        position = np.clip(t / self.dt, 0.0, len(samples) - 1)
        near = np.rint(position)
        position = np.where(np.abs(position - near) < TIME_TOLERANCE / self.dt, near, position)
        k = np.floor(position).astype(int)
        weight = (position - k)[:, None]
        after = samples[np.minimum(k + 1, len(samples) - 1)]
        return np.where(weight > 0.0, samples[k] + weight * (after - samples[k]), samples[k])


def _points(value: ArrayLike | Sequence[ArrayLike], name: str) -> Array:
    y = real_array(value, name).copy()  # type: ignore[arg-type]
    if y.ndim != 2 or 0 in y.shape or np.isinf(y).any():
        raise ValueError(f"{name} has shape {y.shape} or infinite entries; expected (any, p), NaN where free")
    return y


def _increasing(times: ArrayLike, n: int) -> Array:
    t = finite_array(times, "times", (n,)).copy()
    if t[0] < 0.0 or (np.diff(t) <= 0.0).any():
        raise ValueError(f"times = {t.tolist()}; expected {n} increasing times from 0 s on")
    return t
