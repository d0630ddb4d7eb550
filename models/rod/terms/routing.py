"""Routing of tendons and chambers: where they run in the section plane, as functions of arclength."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from pisplit.checks import Array, finite_array, finite_number, positive
from pisplit.models.rod.kinematics.gauss import Rule

#: Step in parts of L of the five-point formula for r' of a user's function.
STENCIL = 1e-3

#: A point (x, y) in m in the section plane, or a function of arclength s in m that returns one.
Route = tuple[float, ...] | Callable[[float], Sequence[float]]


@dataclass(frozen=True)
class Helix:
    """Circular helix about the centreline: r(s) = radius (cos, sin)(2 pi s / pitch + phase).

    Args:
        radius: in m.
        pitch: arclength of one turn in m; negative turns clockwise when seen from the tip.
        phase: angle at the base in rad.

    Raises ValueError for a pitch of zero.
    """

    radius: float
    pitch: float
    phase: float = 0.0

    def __post_init__(self) -> None:
        positive(self.radius, "Helix radius", "m")
        if finite_number(self.pitch, "Helix pitch") == 0.0:
            raise ValueError("Helix pitch = 0 m; expected the arclength of one turn")
        finite_number(self.phase, "Helix phase")

    def _angle(self, s: float) -> float:
        return 2.0 * np.pi * s / self.pitch + self.phase

    def __call__(self, s: float) -> tuple[float, float]:
        """(x, y) in m at arclength ``s`` in m."""
        return (self.radius * float(np.cos(self._angle(s))), self.radius * float(np.sin(self._angle(s))))

    def slope(self, s: float) -> tuple[float, float]:
        """(x', y') at arclength ``s`` in m."""
        rate = 2.0 * np.pi / self.pitch * self.radius
        return (-rate * float(np.sin(self._angle(s))), rate * float(np.cos(self._angle(s))))


@dataclass(frozen=True)
class Line:
    """Straight from ``start`` (x, y) at the base to ``end`` (x, y) at arclength ``length``; all in m."""

    start: tuple[float, float]
    end: tuple[float, float]
    length: float

    def __post_init__(self) -> None:
        positive(self.length, "Line length", "m")
        for name in ("start", "end"):
            point = finite_array(getattr(self, name), f"Line {name}", (2,))
            object.__setattr__(self, name, tuple(point.tolist()))

    def __call__(self, s: float) -> tuple[float, float]:
        """(x, y) in m at arclength ``s`` in m."""
        slope = self.slope(s)
        return (self.start[0] + s * slope[0], self.start[1] + s * slope[1])

    def slope(self, s: float) -> tuple[float, float]:
        """(x', y'), the same everywhere. ``s`` in m."""
        return ((self.end[0] - self.start[0]) / self.length, (self.end[1] - self.start[1]) / self.length)


def checked_routes(offsets: Sequence[Route], name: str) -> tuple[Route, ...]:
    """Points as pairs of floats and functions as they are; at least one.

    ``offsets`` are routes; ``name`` of the term is for messages.
    """
    if not any(callable(o) for o in offsets):
        points = finite_array(offsets, f"{name} offsets", (None, 2))  # type: ignore[arg-type]
        if len(points) == 0:
            raise ValueError(f"{name} offsets is empty; give at least one routing point (x, y)")
        return tuple(map(tuple, points.tolist()))
    return tuple(o if callable(o) else checked_routes([o], name)[0] for o in offsets)


def check_routes(routes: Sequence[Route], rule: Rule, n: int, length: float, name: str) -> None:
    """Raise ValueError for routes that leave the rod: a ``Line`` that ends before them, an offset in another unit.

    Args:
        routes: one a tendon or chamber.
        rule: nodes of the rod, of which it passes the first ``n``.
        n: number of these.
        length: of the rod in m.
        name: of the term.
    """
    end = next(border for border in (*rule.borders[1:], length) if border >= rule.nodes[n - 1])
    for route in routes:
        if isinstance(route, Line) and route.length < end * (1.0 - 1e-9):
            raise ValueError(
                f"{name} run to s = {end:g} m on a Line of length {route.length:g} m; give the Line the length they run"
            )
        offset = float(np.hypot(*sample(route, rule.nodes[:n], length)[0][:2]).max())
        if offset > length:
            raise ValueError(f"{name} offset {offset:g} m on a rod of {length:g} m; offsets are in m")


def on_circle(offset: float, angles_deg: Sequence[float], name: str) -> list[list[float]]:
    """Points (n, 2) on a circle of radius ``offset`` in m at ``angles_deg`` in degrees.

    ``name`` of the term is for messages.
    """
    positive(offset, f"{name} offset", "m")
    angles = np.deg2rad(finite_array(angles_deg, f"{name} angles_deg", (None,)))
    points: list[list[float]] = (offset * np.stack([np.cos(angles), np.sin(angles)], axis=1)).tolist()
    return points


def sample(route: Route, points: Array, length: float) -> tuple[Array, Array]:
    """r and r' (3, S) of a route at arclengths ``points`` in m on a rod of length ``length``.

    r' of a user's function comes from the five-point formula: its relative error is about 1e-10 for a route that turns
    once over the length.
    """
    if not callable(route):
        return np.tile(np.array([[route[0]], [route[1]], [0.0]]), (1, len(points))), np.zeros((3, len(points)))
    r = np.array([_point(route, s) for s in points.tolist()])
    slope = getattr(route, "slope", None)
    if slope is not None:
        dr = np.array([slope(s) for s in points.tolist()])
    else:
        dr = np.array([_slope(route, s, STENCIL * length, length) for s in points.tolist()])
    still = np.zeros((len(points), 1))
    return np.hstack([r, still]).T, np.hstack([dr, still]).T


def _point(route: Callable[[float], Sequence[float]], s: float) -> Array:
    return finite_array(route(s), f"route at s = {s:g} m", (2,))


def _slope(route: Callable[[float], Sequence[float]], s: float, h: float, length: float) -> Array:
    """Derivative at ``s`` of the polynomial through five points on the rod, ``h`` apart."""
    centre = min(max(s, 2.0 * h), length - 2.0 * h)
    steps = np.arange(-2.0, 3.0)
    at = (s - centre) / h
    monomials = np.array([0.0, 1.0, 2.0 * at, 3.0 * at**2, 4.0 * at**3])
    weights = np.linalg.solve(np.vander(steps, increasing=True).T, monomials)
    points = np.array([_point(route, float(centre + h * k)) for k in steps])
    slope: Array = weights @ (points - points[2]) / h  # differences: a constant has no slope, not even a rounded one
    return slope


def nodes_before(end: float | None, rule: Rule, name: str) -> int:
    """Number of nodes that a tendon or chamber passes before its ``end`` (None: the tip), which must end an element.

    ``rule`` has the nodes of the rod; ``name`` of the term is for messages.
    """
    if end is None:
        return rule.n_nodes
    if not np.any(np.isclose(end, rule.borders[1:], rtol=1e-9, atol=0.0)):
        raise ValueError(
            f"{name} end = {end:g} m; expected the end of an element; give the Rod elements= that end there"
        )
    return int(np.count_nonzero(rule.nodes < end))
