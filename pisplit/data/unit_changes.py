"""A state whose unit changes within a recording: from one sample to the next all readings are 1000 times as large."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from pisplit.data.warning import warn

Array = NDArray[np.float64]

#: Factors between units that are mixed up: mm, um, cm and m, degrees and radians, inches and mm.
FACTORS = (1e3, 1e6, 1e2, 180.0 / np.pi, 25.4)
#: Readings on both sides; how near the first one after is to the last one before, times the factor; how near the usual
#: sizes and steps on both sides are.
FEWEST, NEAR, ALIKE = 10, 0.1, 3.0


def say(times: Array, states: Array, members: Mapping[str, NDArray[np.int64]], names: Sequence[str]) -> None:
    """Warn of ``states`` (N, n) at ``times`` (N,) [s] that change their unit within one of the runs ``members``.

    ``names`` (n,) are those of the states.
    """
    for i, name in enumerate(names):
        for rows in members.values():
            found = _change(states[rows, i])
            if found is not None:
                at, factor = found
                warn(
                    f"{name}: readings from {times[rows[at]]:.6g} s on are {factor:.3g} times those before: did its "
                    "unit change? cut the file there, and give each part its state_units"
                )


def _change(values: Array) -> tuple[int, float] | None:
    """Where ``values`` (N,) go on in another unit, and by which factor; None where they do not."""
    known = np.flatnonzero(np.isfinite(values))
    v = values[known]
    if len(v) < 2 * FEWEST:
        return None
    at = FEWEST - 1 + int(np.abs(np.diff(v))[FEWEST - 1 : len(v) - FEWEST].argmax())
    parts = v[: at + 1], v[at + 1 :]
    sizes, steps = ([float(np.median(np.abs(w))) for w in two] for two in (parts, [np.diff(w) for w in parts]))
    if not min(*sizes, *steps, abs(v[at]), abs(v[at + 1])) > 0.0:
        return None
    ratio = float(v[at + 1] / v[at])
    for factor in (*FACTORS, *(1.0 / f for f in FACTORS)):
        usual = [two[1] / two[0] / factor for two in (sizes, steps)]
        if abs(ratio / factor - 1.0) < NEAR and all(1.0 / ALIKE < u < ALIKE for u in usual):
            return int(known[at + 1]), factor
    return None
