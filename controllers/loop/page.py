"""A closed loop as one HTML file: the arm in 3-D, a slider of time, error and inputs, without network."""

from __future__ import annotations

import html
import json
import os
import re
from importlib.resources import files
from typing import Any

import numpy as np

from pisplit.checks import Array
from pisplit.controllers.loop.log import LoopLog, shown_unit
from pisplit.files import write_text

POSITION = re.compile(r"p_([xyz])\[(\d+)\]")
#: Points of a backbone between its stations, and digits of what is drawn.
POINTS, DIGITS = 25, 5


def write_page(log: LoopLog, path: str | os.PathLike[str]) -> None:
    """Write ``log`` to the HTML file ``path``, whole or not at all.

    States named p_x[k], p_y[k], p_z[k] are the stations of an arm that is clamped at the origin, along +z; without them
    error and inputs are drawn alone. Raises ValueError for a log without a step.
    """
    if not len(log.u):
        raise ValueError(f"nothing was run: there is nothing to draw ({log.message})")
    unit, factor = shown_unit(log.output_units[0])
    input_unit, input_factor = shown_unit(log.input_units[0])
    missed = factor * np.sqrt(np.nansum((log.y - log.reference) ** 2, axis=1))
    arm = backbones(log)
    data = {
        "t": _rounded(log.t),
        "arm": [_rounded(a) for a in arm],
        "reference": _reference(log) if len(arm) else [],
        "error": _rounded(missed),
        "error_unit": unit,
        "inputs": [_rounded(input_factor * np.append(log.u0[i], log.u[:, i])) for i in range(log.u.shape[1])],
        "input_names": [html.escape(name) for name in log.input_names],
        "input_unit": input_unit,
        "summary": log.summary(),
    }
    text = json.dumps(data, allow_nan=False).replace("</", "<\\/")
    page = files("pisplit.controllers.loop").joinpath("page.html").read_text(encoding="utf-8")
    write_text(path, page.replace("/*DATA*/", text))


def backbones(log: LoopLog) -> Array:
    """Backbones (N+1, points, 3) in m of the arm in ``log``, smooth from station to station; empty without stations."""
    from scipy.interpolate import CubicSpline

    found: dict[int, dict[str, int]] = {}
    for i, name in enumerate(log.state_names):
        match = POSITION.fullmatch(name)
        if match:
            found.setdefault(int(match.group(2)), {})[match.group(1)] = i
    stations = [found[k] for k in sorted(found) if len(found[k]) == 3]
    if not stations:
        return np.zeros((0, 0, 3))
    points = np.stack([log.x[:, [s[a] for a in "xyz"]] for s in stations], axis=1)
    whole = np.concatenate([np.zeros((len(points), 1, 3)), points], axis=1)
    s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(whole[0], axis=0), axis=1))])
    keep = np.concatenate([[True], np.diff(s) > 1e-9])
    clamped = ((1, np.tile([0.0, 0.0, 1.0], (len(points), 1))), (2, np.zeros((len(points), 3))))
    drawn = CubicSpline(s[keep], whole[:, keep], axis=1, bc_type=clamped)(np.linspace(0.0, s[-1], POINTS))
    return np.asarray(drawn, dtype=np.float64)


def _reference(log: LoopLog) -> list[list[float] | None]:
    """Points of the reference; a coordinate that is free is where the output was. None where all are free."""
    if log.reference.shape[1] != 3:
        return []
    whole = np.where(np.isfinite(log.reference), log.reference, log.y)
    free: Array = np.asarray(np.isnan(log.reference).all(axis=1))
    return [None if free[k] else _rounded(p) for k, p in enumerate(whole)]


def _rounded(values: Array) -> Any:
    return np.round(values, DIGITS).tolist()
