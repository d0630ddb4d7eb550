"""Reference trajectories of tracked outputs: functions of time that know where they start.

A coordinate that a reference does not specify is NaN: free. The tip of an inextensible arm moves on a surface, so a
circle in x and y leaves z to the arm.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from pisplit.checks import Array, finite_array, finite_number, non_negative, positive

PLANES = {"xy": (0, 1), "yz": (1, 2), "xz": (0, 2), "yx": (1, 0), "zy": (2, 1), "zx": (2, 0)}
TIME_TOLERANCE = 1e-9  # [s] k * dt may fall short of a switching time by a rounding error


@dataclass(frozen=True, eq=False)
class Reference:
    """y_ref(t): ``reference(t (N,)) -> (N, width)`` for the outputs named ``track``; NaN marks a free coordinate.

    ``function``: (t (N,) from 0 on, start (width,)) -> (N, width). ``needs_start``: it begins at the measured outputs,
    which ``starting_at`` supplies; a closed loop does that at its start.
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
        y = np.asarray(self.function(times, start), dtype=np.float64)
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

        def blended(t: Array, start: Array) -> Array:
            weight = minimum_jerk(t / T)[:, None]
            target = self.function(t, start)
            return np.where(weight < 1.0, start + weight * (target - start), target)

        return replace(self, function=blended, needs_start=True)


def minimum_jerk(s: ArrayLike) -> Array:
    """10 s^3 - 15 s^4 + 6 s^5 on [0, 1], 0 before and 1 after: rest to rest with least jerk.

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
) -> Reference:
    """Circle of ``radius`` [m] with ``period`` [s] in a coordinate plane of a point; the third coordinate is free.

    ``center`` (2,) in the plane, the starting point if not given; ``phase`` [rad] at t = 0; the circle runs from the
    first axis of the plane to the second. ``approach``: seconds of blend from the starting point onto the circle, half
    a period if not given, 0 for none.
    """
    R, T = positive(radius, "radius", "m"), positive(period, "period", "s")
    if plane not in PLANES:
        raise ValueError(f"plane = {plane!r}; expected one of {', '.join(map(repr, PLANES))}")
    first = finite_number(phase, "phase")
    lead_in = T / 2 if approach is None else non_negative(approach, "approach", "s")
    axes = list(PLANES[plane])
    middle = None if center is None else finite_array(center, "center", (2,)).copy()

    def function(t: Array, start: Array) -> Array:
        angle = first + 2.0 * np.pi * t / T
        y = np.full((len(t), 3), np.nan)
        y[:, axes] = (start[axes] if middle is None else middle) + R * np.column_stack([np.cos(angle), np.sin(angle)])
        return y

    plain = Reference(function, width=3, needs_start=middle is None, track=track)
    return plain.approached(lead_in) if lead_in > 0.0 else plain


def hold(point: ArrayLike | None = None, width: int = 3, track: str = "tip") -> Reference:
    """A constant point (p,), or the starting point of ``width`` coordinates; NaN coordinates are free."""
    if point is None:
        return Reference(lambda t, start: np.tile(start, (len(t), 1)), width, needs_start=True, track=track)
    where = _points([point], "point")[0]
    return Reference(lambda t, start: np.tile(where, (len(t), 1)), len(where), track=track)


def setpoint(positions: ArrayLike, times: ArrayLike, track: str = "tip") -> Reference:
    """Piecewise constant: positions[k] (K, p) from times[k] (K,) [s] on, the starting point before the first time."""
    y, switch = _points(positions, "positions"), _increasing(times, len(np.atleast_2d(positions)))

    def function(t: Array, start: Array) -> Array:
        return np.vstack([start, y])[np.searchsorted(switch, t + TIME_TOLERANCE, side="right")]

    return Reference(function, y.shape[1], needs_start=switch[0] > 0.0, track=track)


def waypoints(points: ArrayLike, times: ArrayLike, track: str = "tip") -> Reference:
    """Rest-to-rest minimum-jerk moves through points (K, p), each reached at its time (K,) [s], then held.

    With times[0] > 0 the first move begins at the starting point.
    """
    y, stops = _points(points, "points"), _increasing(times, len(np.atleast_2d(points)))
    from_start = bool(stops[0] > 0.0)

    def function(t: Array, start: Array) -> Array:
        knots = np.vstack([start, y]) if from_start else y
        at = np.concatenate([[0.0], stops]) if from_start else stops
        if len(at) == 1:
            return np.tile(knots, (len(t), 1))
        k = np.clip(np.searchsorted(at, t, side="right") - 1, 0, len(at) - 2)
        weight = minimum_jerk((t - at[k]) / (at[k + 1] - at[k]))[:, None]
        return np.asarray(knots[k] + weight * (knots[k + 1] - knots[k]))

    return Reference(function, y.shape[1], needs_start=from_start, track=track)


def sequence(*segments: tuple[Reference, float]) -> Reference:
    """One reference after the other: (reference, duration [s]) pairs, the last duration may be infinite.

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
    begins = np.concatenate([[0.0], np.cumsum(durations[:-1])])

    def function(t: Array, start: Array) -> Array:
        owner = np.searchsorted(begins, t + TIME_TOLERANCE, side="right") - 1
        y = np.empty((len(t), first.width))
        for k, (part, begin) in enumerate(zip(parts, begins, strict=True)):
            chosen = owner == k
            own_start = start if part.start is None else part.start
            y[chosen] = part.function(np.maximum(t[chosen] - begin, 0.0), own_start)
            end = part.function(np.array([durations[k]]), own_start)[0] if k + 1 < len(parts) else own_start
            start = np.where(np.isnan(end), start, end)  # a free coordinate is taken to have stayed
        return y

    return Reference(function, first.width, any(part.needs_start for part in parts), first.track)


def from_array(y: ArrayLike, dt: float, track: str = "tip") -> Reference:
    """Samples y (T, p) at 0, dt, 2 dt, ... [s], linear in between, the last one held; NaN entries are free."""
    samples, step = _points(y, "y"), positive(dt, "dt", "s")

    def function(t: Array, start: Array) -> Array:
        position = np.clip(t / step, 0.0, len(samples) - 1)
        near = np.rint(position)
        position = np.where(np.abs(position - near) < TIME_TOLERANCE / step, near, position)
        k = np.floor(position).astype(int)
        weight = (position - k)[:, None]
        after = samples[np.minimum(k + 1, len(samples) - 1)]
        return np.where(weight > 0.0, samples[k] + weight * (after - samples[k]), samples[k])

    return Reference(function, samples.shape[1], track=track)


def _points(value: ArrayLike | Sequence[ArrayLike], name: str) -> Array:
    y = np.array(value, dtype=np.float64)
    if y.ndim != 2 or 0 in y.shape or np.isinf(y).any():
        raise ValueError(f"{name} has shape {y.shape} or infinite entries; expected (any, p), NaN where free")
    return y


def _increasing(times: ArrayLike, n: int) -> Array:
    t = finite_array(times, "times", (n,)).copy()
    if t[0] < 0.0 or (np.diff(t) <= 0.0).any():
        raise ValueError(f"times = {t}; expected increasing times from 0 s on")
    return t
