"""A motion as one HTML file: an arm in 3-D, a slider of time, curves beside it; no network, readable on a phone."""

from __future__ import annotations

import base64
import html
import json
import os
import tempfile
import webbrowser
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from pisplit.checks import Array, finite_array, real_array
from pisplit.files import write_text

#: Points in space that a page holds at most, 8 bytes each, and moments: a longer motion is thinned out.
MOST_POINTS, MOST_MOMENTS = 400_000, 1500
#: Steps of the grid that positions are rounded to; the last number says that there is no point.
LEVELS = 65534
#: Digits of what is drawn in curves.
DIGITS = 5


@dataclass(frozen=True)
class Outline:
    """An arm over time, as it is drawn. Raises ValueError for shapes that do not fit each other.

    Attributes:
        backbone: (T, P, 3) in m.
        tendons: one array (T, P_i, 3) in m each; empty where there are none.
        tensions: (T, tendons) in N.
        up: (3,) against gravity.
    """

    backbone: Array
    tendons: tuple[Array, ...] = ()
    tensions: Array = field(default_factory=lambda: np.zeros((0, 0)))
    up: tuple[float, float, float] = (0.0, 0.0, 1.0)

    def __post_init__(self) -> None:
        moments = len(real_array(self.backbone, "backbone"))
        told = {"backbone": self.backbone, **{f"tendon {i + 1}": line for i, line in enumerate(self.tendons)}}
        for name, line in told.items():
            if np.ndim(line) != 3 or np.shape(line)[::2] != (moments, 3):
                raise ValueError(f"{name} has the shape {np.shape(line)}; expected ({moments}, points, 3)")
        if self.tendons and np.shape(self.tensions) != (moments, len(self.tendons)):
            raise ValueError(
                f"tensions have the shape {np.shape(self.tensions)}; expected ({moments}, {len(self.tendons)})"
            )


@dataclass(frozen=True)
class Chart:
    """Curves over time.

    Attributes:
        title: over them, with their unit.
        names: one a curve; not shown where there is one alone.
        values: (curves, T), NaN where there is nothing to draw.
    """

    title: str
    names: Sequence[str]
    values: ArrayLike


@dataclass(frozen=True)
class Page:
    """What a page shows.

    Attributes:
        title: of the page.
        t: (T,) times in s.
        charts: curves beside the arm.
        summary: text below.
        arm: the arm, if there is one.
        ghost: (T, P, 3) in m, another backbone behind it, NaN where there is none; ``ghost_name`` says what it is.
        reference: (T, 3) in m, where the tip should be, NaN where nobody asks.
    """

    title: str
    t: Array
    charts: Sequence[Chart]
    summary: str
    arm: Outline | None = None
    ghost: Array | None = None
    ghost_name: str = ""
    reference: Array | None = None

    def write(self, path: str | os.PathLike[str]) -> None:
        """Write the page to the HTML file ``path``, whole or not at all.

        Of a motion with more moments than a page holds every second, third, ... is drawn, which the text below says.
        """
        times = finite_array(self.t, "t", (None,))
        lines = [] if self.arm is None else [self.arm.backbone, *self.arm.tendons]
        ghost = [] if self.ghost is None or self.arm is None else [self.ghost]
        a_moment = sum(np.shape(line)[1] for line in (*lines, *ghost))
        stride = max(-(-len(times) // MOST_MOMENTS), -(-len(times) * a_moment // MOST_POINTS))
        chosen = np.arange(0, len(times), stride)
        points = [np.asarray(line, dtype=np.float64)[chosen] for line in (*lines, *ghost)]
        drawn = _packed(points, None if self.reference is None or not lines else self.reference[chosen])
        thinned = f"\nevery {stride}. moment is drawn" if stride > 1 else ""
        data = {
            "t": _rounded(times[chosen]),
            **drawn,
            "ghost": bool(ghost),
            "ghost_name": html.escape(self.ghost_name),
            "tensions": _rounded(self.arm.tensions[chosen]) if self.arm and self.arm.tendons else [],
            "up": list(self.arm.up) if self.arm else [0.0, 0.0, 1.0],
            "charts": [
                {
                    "title": html.escape(c.title),
                    "names": [html.escape(n) for n in c.names],
                    "values": _rounded(np.atleast_2d(np.asarray(c.values, dtype=np.float64))[:, chosen]),
                }
                for c in self.charts
            ],
            "summary": self.summary + thinned,
        }
        text = json.dumps(data, allow_nan=False).replace("</", "<\\/")
        page = files("pisplit.pictures").joinpath("page.html").read_text(encoding="utf-8")
        write_text(path, page.replace("/*TITLE*/", html.escape(self.title)).replace("/*DATA*/", text))


def shown(save: Callable[[Path], None]) -> str:
    """Let ``save`` write a page into a new folder, open it in the web browser; its path."""
    path = Path(tempfile.mkdtemp(prefix="pisplit-")) / "run.html"
    save(path)
    webbrowser.open(path.as_uri())
    return str(path)


def _packed(lines: list[Array], reference: Array | None) -> dict[str, Any]:
    """Lines (T, P, 3) and a reference (T, 3) on one grid of 16 bits in the box that holds them all."""
    every = [*lines, *([] if reference is None else [reference[:, None, :]])]
    if not lines:
        return {"lines": [], "low": [0.0] * 3, "step": 1.0, "reference": None}
    known = np.concatenate([line.reshape(-1, 3) for line in every])
    known = known[np.isfinite(known).all(axis=1)]
    low = known.min(axis=0) if len(known) else np.zeros(3)
    step = float((np.ptp(known, axis=0).max() if len(known) else 0.0) / LEVELS) or 1.0

    def packed(line: Array) -> dict[str, Any]:
        seen = np.isfinite(line).all(axis=2, keepdims=True)
        grid = np.where(seen, np.rint((np.where(seen, line, 0.0) - low) / step), LEVELS + 1).astype("<u2")
        return {"points": line.shape[1], "data": base64.b64encode(grid.tobytes()).decode()}

    found = [packed(line) for line in every]
    return {
        "lines": found[: len(lines)],
        "low": low.tolist(),
        "step": step,
        "reference": found[-1] if reference is not None else None,
    }


def _rounded(values: Array) -> Any:
    """Nested lists of numbers with so many digits, None for those that are not finite."""
    if values.ndim > 1:
        return [_rounded(row) for row in values]
    return [float(f"{v:.{DIGITS}g}") if np.isfinite(v) else None for v in values.tolist()]
