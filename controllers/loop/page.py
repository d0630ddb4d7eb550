"""A closed loop as a page (:class:`pisplit.pictures.Page`): the arm, the reference, error and inputs."""

from __future__ import annotations

import os
import re

import numpy as np

from pisplit.checks import Array
from pisplit.controllers.loop.log import LoopLog, shown_unit
from pisplit.pictures import Chart, Outline, Page
from pisplit.pictures.figures import labelled

POSITION = re.compile(r"p_([xyz])\[(\d+)\]")
#: Points of a backbone between its stations.
POINTS = 25


def write_page(log: LoopLog, path: str | os.PathLike[str]) -> None:
    """Write ``log`` to the HTML file ``path``, whole or not at all.

    States named p_x[k], p_y[k], p_z[k] are the stations of an arm that is clamped at the origin, along +z, and drawn
    where ``log.outline`` holds no better picture of it; without them error and inputs are drawn alone. Raises
    ValueError for a log without a step.
    """
    if not len(log.u):
        raise ValueError(f"nothing was run: there is nothing to draw ({log.message})")
    unit, factor = shown_unit(log.output_units[0])
    input_unit, input_factor = shown_unit(log.input_units[0])
    missed = factor * np.sqrt(np.nansum((log.y - log.reference) ** 2, axis=1))
    drawn = backbones(log, log.x)
    arm = log.outline if log.outline is not None else Outline(drawn) if drawn.size else None
    ghost = None if log.ghost is None else backbones(log, log.ghost)
    inputs = input_factor * np.vstack([log.u0, log.u]).T
    Page(
        title="pisplit run",
        t=log.t,
        charts=[
            Chart(labelled("distance from the reference", unit), ("error",), missed),
            Chart(labelled("inputs", input_unit), log.input_names, inputs),
        ],
        summary=log.summary(),
        arm=arm,
        ghost=ghost if ghost is not None and ghost.size else None,
        ghost_name=f"predicted {log.ahead * log.dt:.2g} s before",
        reference=_reference(log),
    ).write(path)


def backbones(log: LoopLog, x: Array) -> Array:
    """Backbones (N+1, points, 3) in m of states ``x`` (N+1, n) as in the ``log``, smooth from station to station.

    Empty without stations; NaN where a position is NaN.
    """
    from scipy.interpolate import CubicSpline

    found: dict[int, dict[str, int]] = {}
    for i, name in enumerate(log.state_names):
        match = POSITION.fullmatch(name)
        if match:
            found.setdefault(int(match.group(2)), {})[match.group(1)] = i
    stations = [found[k] for k in sorted(found) if len(found[k]) == 3]
    if not stations:
        return np.zeros((0, 0, 3))
    points = np.stack([x[:, [s[a] for a in "xyz"]] for s in stations], axis=1)
    whole = np.concatenate([np.zeros((len(points), 1, 3)), points], axis=1)
    drawn = np.full((len(x), POINTS, 3), np.nan)
    good = np.flatnonzero(np.isfinite(whole).all(axis=(1, 2)))
    if len(good):
        whole = whole[good]
        s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(whole[0], axis=0), axis=1))])
        keep = np.concatenate([[True], np.diff(s) > 1e-9])
        clamped = ((1, np.tile([0.0, 0.0, 1.0], (len(good), 1))), (2, np.zeros((len(good), 3))))
        spline = CubicSpline(s[keep], whole[:, keep], axis=1, bc_type=clamped)
        drawn[good] = spline(np.linspace(0.0, s[-1], POINTS))
    return drawn


def _reference(log: LoopLog) -> Array | None:
    """Points (N+1, 3) of the reference; a coordinate that is free is where the output was, NaN where all are free."""
    if log.reference.shape[1] != 3:
        return None
    whole = np.where(np.isfinite(log.reference), log.reference, log.y)
    whole[np.isnan(log.reference).all(axis=1)] = np.nan
    return np.asarray(whole, dtype=np.float64)
