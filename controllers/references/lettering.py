"""Letters and drawings to follow: the paths of SVG files."""

from __future__ import annotations

import re
from collections.abc import Iterator

import numpy as np
from numpy.typing import ArrayLike

from pisplit.checks import Array, count, positive
from pisplit.controllers.references.curves import Reference
from pisplit.controllers.references.paths import along

#: Numbers that a command takes.
TAKES = {"M": 2, "L": 2, "H": 1, "V": 1, "C": 6, "S": 4, "Q": 4, "T": 2, "Z": 0}
TOKEN = re.compile(r"([A-Za-z])|([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)")


def svg_points(path: str, fine: int = 16) -> Array:
    """Points (K, 2) along the ``path`` of an SVG file (its attribute d), y upwards; curves are cut into ``fine`` parts.

    Commands M, L, H, V, C, S, Q, T, Z, absolute and relative; strokes are joined by straight lines. Raises ValueError,
    in one line, for arcs (A) and for what is no path.

    Source: Scalable Vector Graphics 2, W3C (2018), section 9.3.
    """
    parts = count(fine, "fine")
    s = np.linspace(0.0, 1.0, parts + 1)[1:, None]
    here = begin = np.zeros(2)
    control: tuple[str, Array] | None = None
    found: list[Array] = []
    for command, numbers in _commands(path):
        base = here if command.islower() else np.zeros(2)
        kind = command.upper()
        if kind == "H":
            to = np.array([base[0] + numbers[0], here[1]])
        elif kind == "V":
            to = np.array([here[0], base[1] + numbers[0]])
        elif kind == "Z":
            to = begin
        else:
            to = base + numbers[-2:]
        handles = [base + numbers[k : k + 2] for k in range(0, len(numbers) - 2, 2)] if kind in "CSQ" else []
        if kind in "ST":
            family = "CS" if kind == "S" else "QT"
            mirrored = 2.0 * here - control[1] if control is not None and control[0] in family else here
            handles = [mirrored, *handles]
        if kind in "CS":
            a, b = handles
            way = (1 - s) ** 3 * here + 3 * (1 - s) ** 2 * s * a + 3 * (1 - s) * s**2 * b + s**3 * to
        elif kind in "QT":
            a = handles[0]
            way = (1 - s) ** 2 * here + 2 * (1 - s) * s * a + s**2 * to
        else:
            way = to[None]
        control = (kind, handles[-1]) if handles else None
        found.append(way)
        here = to
        if kind == "M":
            begin = to
    if not found:
        raise ValueError(f"path = {path[:20]!r} draws nothing; give the attribute d of an SVG path")
    return np.concatenate(found) * np.array([1.0, -1.0])


def lettering(
    path: str,
    size: float,
    period: float,
    center: ArrayLike | None = None,
    plane: str = "xy",
    approach: float | None = None,
    track: str = "tip",
    width: int = 3,
) -> Reference:
    """The ``path`` of an SVG file, scaled so that its larger extent is ``size``, around ``center`` (2,).

    ``period`` [s], ``plane``, ``approach``, ``track`` and ``width`` as in :func:`along`. Raises ValueError for a path
    without extent, and as :func:`svg_points`.
    """
    points = svg_points(path)
    low, high = points.min(axis=0), points.max(axis=0)
    extent = float((high - low).max())
    if extent == 0.0:
        raise ValueError("path is a single point; give one that draws something")
    scaled = (points - 0.5 * (low + high)) * positive(size, "size") / extent
    return along(scaled, period, center, plane, approach, track, width)


def _commands(path: str) -> Iterator[tuple[str, Array]]:
    """Commands with their numbers, one at a time; those that are repeated without a letter get theirs."""
    rest = re.sub(r"[\s,]+", " ", TOKEN.sub(" ", path)).strip()
    tokens = TOKEN.findall(path)
    if rest or not tokens or tokens[0][0].upper() != "M":
        raise ValueError(f"path = {path[:20]!r} is no SVG path: it begins with M, numbers and commands after it")
    at, command = 0, ""
    while at < len(tokens):
        letter = tokens[at][0]
        if letter:
            command, at = letter, at + 1
        elif command.upper() in ("M", "Z", ""):
            command = {"M": "L", "m": "l"}.get(command, "")
        if command.upper() not in TAKES:
            raise ValueError(f"command {command or tokens[at][1]!r} of an SVG path is not known; {' '.join(TAKES)} are")
        n = TAKES[command.upper()]
        given = tokens[at : at + n]
        if len(given) < n or any(letter for letter, _ in given):
            raise ValueError(f"command {command!r} of an SVG path takes {n} numbers; it has {len(given)}")
        yield command, np.array([float(number) for _, number in given])
        at += n
        if letter == "" and n == 0:
            raise ValueError("numbers follow Z in an SVG path; begin anew with M")
