"""Where a function of arclength jumps, and elements that end there."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np

from pisplit.checks import Array
from pisplit.models.rod.section.body import Rod

#: Points of an element at which a function is sampled: what is narrower than their distance may be missed.
SAMPLES = 96
#: Change that counts as a jump: of logarithms of stiffness and mass, of rest curvature times the length (rad).
JUMP = 1e-2
#: Distance within which a jump is located, and that of borders which are one, in parts of the length.
PLACED = 1e-11
#: Ratio of bending stiffness that one element may bridge when a rod is cut by stiffness.
BRIDGED = 30.0


def jumps(function: Callable[[float], Any], start: float, end: float) -> list[float]:
    """Arclengths between ``start`` and ``end`` in m at which a ``function`` s -> (n,) jumps by ``JUMP`` or more.

    Found by halving wherever it changes by so much from one sample to the next.
    """
    width = PLACED * (end - start)

    def between(a: float, at_a: Array, b: float, at_b: Array) -> list[float]:
        if np.abs(at_b - at_a).max(initial=0.0) < JUMP:
            return []
        if b - a <= width:
            return [0.5 * (a + b)]
        middle = 0.5 * (a + b)
        value = np.asarray(function(middle), float)
        return between(a, at_a, middle, value) + between(middle, value, b, at_b)

    points = np.linspace(start + 10.0 * width, end - 10.0 * width, SAMPLES).tolist()
    values = [np.asarray(function(s), float) for s in points]
    pieces = zip(pairwise(points), pairwise(values), strict=True)
    return [s for (a, b), (at_a, at_b) in pieces for s in between(a, at_a, b, at_b)]


def rod_jumps(rod: Rod) -> list[float]:
    """Arclengths in m within the elements of ``rod`` at which its section, material or rest curvature jumps."""
    if not any(callable(part) for part in (rod.section, rod.material, rod.rest_curvature)):
        return []

    def profile(s: float) -> Array:
        at = rod.profile(s)
        return np.concatenate([np.log(at.stiffness[:, 0]), np.log(at.mass + 1e-300), rod.length * at.rest[:3, 0]])

    return [s for a, b in pairwise(rod_borders(rod)) for s in jumps(profile, a, b)]


def rod_borders(rod: Rod) -> list[float]:
    """Arclengths in m of the ends of all elements of ``rod``, from 0 to its length."""
    return [0.0, *np.cumsum(rod.elements[:-1]).tolist(), rod.length]


def cut(rod: Rod, places: Sequence[float]) -> tuple[Rod, list[int]]:
    """``rod`` with elements that also end at ``places`` in m, and the number of the old element of each new one."""
    old, apart = rod_borders(rod), 1e-9 * rod.length
    inner = [s for s in sorted(places) if min(abs(s - border) for border in old) > apart]
    inner = [s for k, s in enumerate(inner) if k == 0 or s - inner[k - 1] > apart]
    if not inner:
        return rod, list(range(len(old) - 1))
    borders = sorted([*old, *inner])
    owner = [int(np.searchsorted(old, 0.5 * (a + b))) - 1 for a, b in pairwise(borders)]
    section = tuple(rod.section[k] for k in owner) if isinstance(rod.section, tuple) else rod.section
    return replace(rod, elements=tuple(np.diff(borders).tolist()), section=section), owner


def shares(rod: Rod, start: float, end: float) -> list[float]:
    """Where to cut the element of ``rod`` from ``start`` to ``end`` in m: halves, or equal shares of stiffness."""
    points = np.linspace(start, end, SAMPLES + 2)[1:-1]
    changes = np.abs(np.diff(np.log(rod.profile(points).stiffness[:2].min(axis=0))))
    spread = np.concatenate([np.zeros(1), np.cumsum(changes)])
    pieces = int(np.ceil(spread[-1] / np.log(BRIDGED)))
    if pieces < 2:
        return [0.5 * (start + end)]
    found: list[float] = np.interp(spread[-1] * np.arange(1, pieces) / pieces, spread, points).tolist()
    return found
