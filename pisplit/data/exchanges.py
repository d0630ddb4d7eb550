"""Columns that change places, or their sign, from one sample to the next: each goes on where another one was."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pisplit.data import wraps
from pisplit.data.rounding import rounding
from pisplit.data.warning import warn

Array = NDArray[np.float64]
Index = NDArray[np.int64]

#: A column jumps by more than so many large steps (of 100, the 97th); it goes on within so many of another's,
FAR, NEAR = 5.0, 1.5
#: and within this part of its jump.
PART = 0.2
#: Columns that jump by less than this part of the largest jump, in steps of their own, need not be explained.
CORE = 0.3
#: Steps of a column are known from so many on; a column that stays as it is over more than this part of them is held.
ENOUGH, HELD = 20, 0.5
#: A coarse sensor moves by so many of its last digits at least.
COARSE = 3.0
#: Samples at which columns jump that are looked at, and names that are shown.
MOST, SHOWN = 500, 4


@dataclass(frozen=True)
class Steps:
    """Steps of columns within a run: ``before`` (N-1, k) the last readings, ``after`` those that follow them, NaN
    where there is none; ``slope`` (N-1, k) the steps before, 0 where unknown; ``large`` (N-1, k) steps in as much time.
    """

    before: Array
    after: Array
    slope: Array
    large: Array

    def near(self, k: int, source: Index, column: Index) -> NDArray[np.bool_]:
        """Whether each ``column`` (c,) goes on after sample k where its ``source`` (c,) was, or was going."""
        last, now = self.before[k, source], self.after[k, column]
        away = np.minimum(np.abs(now - last), np.abs(now - last - self.slope[k, source]))
        return away <= np.minimum(
            NEAR * np.maximum(self.large[k, source], self.large[k, column]), PART * np.abs(now - self.before[k, column])
        )


def say(times: Array, values: Array, members: Mapping[str, Index], names: Sequence[str]) -> bool:
    """Warn of columns ``values`` (N, k) at ``times`` (N,) [s] that exchange places or turn to their negatives, if any.

    members  {run: positions of its samples, in order of time}
    names    (k,) of the columns; several of a marker that is taken for another are said in one line

    Commands and states that are held, as those of valves, may jump to each other's values and are left alone.
    """
    found: dict[tuple[tuple[int, ...], tuple[int, ...]], list[tuple[float, str]]] = {}
    turned: dict[int, list[float]] = {}
    large = _large_steps(values, members)
    for label, rows in members.items():
        if len(rows) < 3:
            continue
        steps = _steps(times[rows], values[rows], large)
        with np.errstate(invalid="ignore"):
            jumps = np.nan_to_num(np.abs(steps.after - steps.before) / steps.large)
        far = np.abs(np.nan_to_num(steps.after - steps.before)) * (jumps > FAR)
        for k in np.flatnonzero((jumps > FAR).any(axis=1))[:MOST].tolist():
            every = np.flatnonzero(jumps[k] > FAR)
            cores = every, *(np.flatnonzero((jumps[k] > FAR) & (v[k] > CORE * v[k].max())) for v in (far, jumps))
            moved, sources = next(((c, s) for c in cores if (s := _sources(steps, k, c)) is not None), (every, None))
            if sources is not None:
                key = (tuple(moved.tolist()), tuple(sources.tolist()))
                found.setdefault(key, []).append((float(times[rows[k + 1]]), label))
            elif len(moved) <= 3:
                for c in _mirrored(steps, k, moved):
                    turned.setdefault(c, []).append(float(times[rows[k + 1]]))
    for (moved_to, come_from), moments in found.items():
        parts = [f"{names[a]} where {names[b]} was" for a, b in zip(moved_to, come_from, strict=True)]
        more = f" and {len(parts) - SHOWN} more" if len(parts) > SHOWN else ""
        often = f"; {len(moments)} times such" if len(moments) > 1 else ""
        warn(
            f"from {moments[0][0]:.6g} s on {', '.join(parts[:SHOWN])}{more}{often}: columns that changed places, or a "
            "marker taken for another? mend the file there, or cut it and name the columns of each part"
        )
    said = bool(found)
    for c, moments_of in turned.items():
        column = values[:, c]
        if len(moments_of) <= 2 and not any(wraps.wraps_of(column[rows]) for rows in members.values() if len(rows) > 3):
            warn(
                f"{names[c]} goes on as its negative from {moments_of[0]:.6g} s on: did its sign change? mend the file "
                "there, or cut it and turn one part"
            )
            said = True
    return said


def _large_steps(values: Array, members: Mapping[str, Index]) -> Array:
    """Large steps (k,) of every column within the runs; infinite where it is held, or has too few."""
    large = np.full(values.shape[1], np.inf)
    for c, column in enumerate(values.T):
        parts = [np.abs(np.diff(column[rows][np.isfinite(column[rows])])) for rows in members.values()]
        sizes = np.concatenate(parts) if parts else np.zeros(0)
        if len(sizes) < ENOUGH or ((sizes == 0.0).mean() > HELD and not _coarse(column, sizes)):
            continue
        least = COARSE * float(sizes[sizes > 0.0].min()) if (sizes == 0.0).mean() > HELD else 0.0
        large[c] = max(float(np.quantile(sizes, 0.97)), least, 1e-9 * float(np.nanmax(np.abs(column))))
    return large


def _coarse(column: Array, sizes: Array) -> bool:
    """Whether a ``column`` (N,) with steps of ``sizes`` is that of a sensor of few digits that moves step by step."""
    moved = sizes[sizes > 0.0]
    step = rounding(column[np.isfinite(column)]) if len(moved) >= ENOUGH else 0.0
    return step > 0.0 and float(np.median(moved)) < COARSE * step


def _steps(times: Array, values: Array, large: Array) -> Steps:
    """Steps of the columns of a run ``values`` (N, k) at ``times`` (N,), from the last reading that is there."""
    known = np.isfinite(values)
    last = np.maximum.accumulate(np.where(known, np.arange(len(values))[:, None], -1), axis=0)
    filled = np.where(last >= 0, np.take_along_axis(values, np.maximum(last, 0), axis=0), np.nan)
    slope = np.vstack([np.zeros((1, values.shape[1])), np.nan_to_num(np.diff(filled, axis=0))])
    waited = (times[1:, None] - times[np.maximum(last[:-1], 0)]) / float(np.median(np.diff(times)))
    return Steps(filled[:-1], np.where(known[1:], values[1:], np.nan), slope[:-1], large * np.maximum(waited, 1.0))


def _sources(steps: Steps, k: int, moved: Index) -> Index | None:
    """Which of the columns that ``moved`` (c,) at sample k each of them goes on from; None if not all have one."""
    if len(moved) < 2:
        return None
    where = np.repeat(moved, len(moved)), np.tile(moved, len(moved))
    fits = steps.near(k, where[0], where[1]).reshape(len(moved), len(moved))  # source, column
    np.fill_diagonal(fits, False)
    if not fits.any(axis=0).all():
        return None
    from scipy.optimize import linear_sum_assignment  # half of the import time of the package; rarely wanted

    away = np.abs(steps.before[k, moved][:, None] - steps.after[k, moved][None, :]) / steps.large[k, moved][:, None]
    source, column = linear_sum_assignment(np.where(fits, away, 1e9))
    return moved[source[np.argsort(column)]] if fits[source, column].all() else None


def _mirrored(steps: Steps, k: int, moved: Index) -> list[int]:
    """Columns of those that ``moved`` which are at sample k where their negatives were."""
    sums = np.abs(steps.after[k, moved] + steps.before[k, moved])
    size = np.abs(steps.after[k, moved] - steps.before[k, moved])
    return moved[(sums <= NEAR * steps.large[k, moved]) & (sums <= PART * size)].tolist()
