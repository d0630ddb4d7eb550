"""Motion at constant speed along a path of corners, sharp or rounded."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from pisplit.checks import Array, finite_array, non_negative, positive
from pisplit.controllers.references.curves import Reference, axes_of

#: Points of a rounded corner.
ARC = 24


def along(
    points: ArrayLike,
    period: float,
    center: ArrayLike | None = None,
    plane: str = "xy",
    approach: float | None = None,
    track: str = "tip",
    width: int = 3,
) -> Reference:
    """Motion at constant speed along the polygon through ``points`` (K, 2), again and again, once in ``period`` [s].

    A path whose last point is not its first is closed by a straight way back. ``points`` lie in a coordinate ``plane``
    relative to ``center`` (2,), the starting point if not given; other coordinates are free. ``approach``: seconds of
    blend from the starting point onto the path, half a period if not given, 0 for none. ``track``: name of the outputs,
    of ``width`` coordinates.

    Raises ValueError for fewer than two different points, and planes that there are not.
    """
    corners = finite_array(points, "points", (None, 2))
    T, axes = positive(period, "period", "s"), axes_of(plane, width)
    closed = np.vstack([corners, corners[:1]])
    closed = closed[np.concatenate([[True], np.linalg.norm(np.diff(closed, axis=0), axis=1) > 0.0])]
    if len(closed) < 3:
        raise ValueError("points has fewer than two different points: there is no way along them")
    middle = None if center is None else finite_array(center, "center", (2,)).copy()
    lead_in = T / 2 if approach is None else non_negative(approach, "approach", "s")
    plain = Reference(_Along(closed, T, middle, axes, width), width, middle is None, track)
    return plain.approached(lead_in) if lead_in > 0.0 else plain


@dataclass(frozen=True, eq=False)
class _Along:
    points: Array
    period: float
    center: Array | None
    axes: tuple[int, int]
    width: int

    def __call__(self, t: Array, start: Array) -> Array:
        axes = list(self.axes)
        way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(self.points, axis=0), axis=1))])
        s = way[-1] * np.mod(t / self.period, 1.0)
        center = start[axes] if self.center is None else self.center
        y = np.full((len(t), self.width), np.nan)
        y[:, axes] = center + np.column_stack([np.interp(s, way, column) for column in self.points.T])
        return y


def rounded(points: ArrayLike, radius: float) -> Array:
    """The closed polygon ``points`` (K, 2) with its corners replaced by arcs of a ``radius``: points (K', 2).

    Where two arcs would overlap, the radius is smaller: they then touch in the middle of the side. Raises ValueError
    for a negative radius and fewer than three points.
    """
    corners, r = finite_array(points, "points", (None, 2)), non_negative(radius, "radius")
    if len(corners) < 3:
        raise ValueError(f"points has {len(corners)} corners; expected at least three")
    found = []
    for before, corner, after in zip(np.roll(corners, 1, axis=0), corners, np.roll(corners, -1, axis=0), strict=True):
        a, b = before - corner, after - corner
        la, lb = float(np.linalg.norm(a)), float(np.linalg.norm(b))
        half = 0.5 * np.arccos(np.clip(a @ b / max(la * lb, 1e-300), -1.0, 1.0))
        if r == 0.0 or half < 1e-6 or half > 0.5 * np.pi - 1e-6:
            found.append(corner[None])
            continue
        back = min(r / np.tan(half), 0.5 * la, 0.5 * lb)  # from the corner to where the arc begins
        size = back * np.tan(half)
        bisector = a / la + b / lb
        middle = corner + bisector / np.linalg.norm(bisector) * np.hypot(back, size)
        first, last = corner + back * a / la - middle, corner + back * b / lb - middle
        start = np.arctan2(first[1], first[0])
        turn = np.arctan2(first[0] * last[1] - first[1] * last[0], first @ last)
        angle = start + turn * np.linspace(0.0, 1.0, ARC)
        found.append(middle + size * np.column_stack([np.cos(angle), np.sin(angle)]))
    return np.concatenate(found)


def square(
    side: float,
    period: float,
    center: ArrayLike | None = None,
    corner: float = 0.0,
    plane: str = "xy",
    approach: float | None = None,
    track: str = "tip",
    width: int = 3,
) -> Reference:
    """Square of a ``side`` around ``center`` (2,), at constant speed, once in ``period`` [s], corners of radius
    ``corner``; ``plane``, ``approach``, ``track`` and ``width`` as in :func:`along`.

    Raises ValueError where the corners are larger than half the side.
    """
    half = 0.5 * positive(side, "side")
    if non_negative(corner, "corner") > half:
        raise ValueError(f"corner = {corner:g}; expected at most half of the side, {half:g}")
    points = half * np.array([[1.0, 0.0], [1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]])
    return along(rounded(points, corner), period, center, plane, approach, track, width)
