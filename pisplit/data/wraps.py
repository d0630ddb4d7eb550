"""States that jump though nothing did: angles and counters that wrap, quaternions that turn to their negatives."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from pisplit.data.warning import warn

Array = NDArray[np.float64]
Index = NDArray[np.int64]

#: A wrap jumps over so much of the range of a state, other steps stay below so much of it.
JUMP, STEP = 0.75, 0.25
#: Ranges of angles, encoders and counters; what is within this part of one is one.
PERIODS = (2.0 * np.pi, np.pi, 360.0, 180.0, *(2.0**bits for bits in (8, 10, 12, 13, 14, 16, 24, 32)))
NEAR = 0.02
#: Four states are a quaternion if the sum of their squares is one within this.
UNIT = 1e-2


def say(times: Array, states: Array, members: Mapping[str, Index], names: Sequence[str]) -> None:
    """Warn of what jumps in ``states`` (N, n) at ``times`` (N,) [s], in the runs ``members``, by ``names`` (n,)."""
    runs = [rows for rows in members.values() if len(rows) > 3]
    for i, name in enumerate(names):
        found = [rows[k] for rows in runs for k in wraps_of(states[rows, i])]
        if found:
            before, after = states[found[0] - 1, i], states[found[0], i]
            warn(
                f"{name} jumps from {before:.6g} to {after:.6g}, {len(found)} times such, first at "
                f"{times[found[0]]:.6g} s: an angle or a counter that wraps? unwrap it (numpy.unwrap), or give its "
                "sine and cosine"
            )
    for first in range(len(names) - 3):
        four = states[:, first : first + 4]
        if _is_quaternion(four):
            turned = [rows[k] for rows in runs for k in _turns(four[rows])]
            if turned:
                warn(
                    f"{', '.join(names[first : first + 4])} turn to their negatives, {len(turned)} times, first at "
                    f"{times[turned[0]]:.6g} s: the same orientation, but a jump; keep the sign that continues the "
                    "sample before"
                )


def wraps_of(values: Array) -> list[int]:
    """Positions in ``values`` (N,), N > 3, that come right after a wrap of an angle or a counter."""
    known = np.flatnonzero(np.isfinite(values))
    if len(known) < 4:
        return []
    steps = np.diff(values[known])
    span = float(np.ptp(values[known]))
    far = np.abs(steps) > JUMP * span
    if span == 0.0 or not far.any() or far.all() or np.abs(steps[~far]).max() > STEP * span:
        return []
    found: list[int] = []
    sizes: list[float] = []
    signs: set[bool] = set()
    for k in np.flatnonzero(far).tolist():
        beside = [steps[j] for j in (k - 1, k + 1) if 0 <= j < len(steps) and not far[j]]
        if beside and all(step * steps[k] < 0.0 for step in beside):  # it goes on as if nothing had happened
            found.append(int(known[k + 1]))
            signs.add(bool(steps[k] > 0.0))
            sizes.append(float(abs(steps[k]) + np.mean(np.abs(beside))))
    if not found:
        return []
    size = float(np.median(sizes))
    is_known = any(abs(size - period) <= NEAR * period for period in PERIODS)
    alike = float(np.ptp(sizes)) <= NEAR * size
    is_same = len(found) > 2 and alike and len(signs) == 1  # a phase; valves go up and down
    return found if is_known or is_same else []


def _is_quaternion(four: Array) -> bool:
    size = (four**2).sum(axis=1)
    size = size[np.isfinite(size)]
    moving = np.ptp(four[np.isfinite(four).all(axis=1)], axis=0) > 0.0 if len(size) else np.zeros(4, dtype=bool)
    return len(size) > 3 and int(moving.sum()) > 1 and bool((np.abs(size - 1.0) < UNIT).mean() > 0.99)


def _turns(four: Array) -> list[int]:
    """Positions in quaternions ``four`` (N, 4) whose sign is not that of the sample before."""
    known = np.flatnonzero(np.isfinite(four).all(axis=1))
    inner = (four[known[1:]] * four[known[:-1]]).sum(axis=1)
    return [int(k) for k in known[1:][inner < -0.5]]
