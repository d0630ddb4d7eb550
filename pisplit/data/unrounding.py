"""Inputs that a log rounded, made as smooth again as rounding allows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pisplit.checks import finite_array
from pisplit.data.episodes import Episodes
from pisplit.data.rounding import held, rounding, smoothest
from pisplit.data.warning import warn

Array = NDArray[np.float64]


def unrounded(episodes: Episodes, step: ArrayLike | None = None) -> Episodes:
    """The same recordings with inputs as smooth as possible within half a ``step`` of what was logged.

    For commands that a log rounds and the robot does not: what is rounded away is noise of the inputs, which makes
    regressions shrink what they do. Where the servo itself rounds, the log is the truth, and this takes it away.

    episodes   recordings; of commands that follow one another smoothly, one a step
    step       rounding of the inputs, a number or (m,), 0 for one that is exact, in their unit; found where it is not
               given and inputs are multiples of one

    Minimises the squared second differences of every input in each recording, with bounds (L-BFGS-B of scipy). Warns of
    inputs that are held for most of the time, which it leaves as they are. Raises ValueError where none is rounded,
    and for steps that are negative or of another shape.
    """
    us, m = episodes.us, episodes.n_inputs
    every = episodes.stacked_inputs()
    if step is None:
        sizes = np.array([rounding(column) for column in every.T])
        if not (sizes > 0.0).any():
            raise ValueError("the inputs are no multiples of one step; give step=, by which the log rounds them")
    else:
        given = np.atleast_1d(np.asarray(step, dtype=np.float64))
        sizes = finite_array(np.full(m, given[0]) if given.size == 1 else given, "step", (m,))
        if (sizes < 0.0).any():
            raise ValueError(f"step = {sizes.tolist()}; expected steps of rounding, 0 for none")
    still = [held([u[:, j] for u in us]) for j in range(m)]
    names = episodes.input_names or ()
    if left := [names[j] for j in range(m) if still[j] and sizes[j] > 0.0]:
        warn(f"{', '.join(left[:4])}: held for most of the time, and left as logged; what is smooth can be unrounded")
    sizes = np.where(still, 0.0, sizes)
    smooth = [np.column_stack([smoothest(u[:, j], float(sizes[j])) for j in range(m)]) if m else u for u in us]
    told = {"unrounded": sizes.tolist()}
    return replace(episodes, us=smooth, provenance={**(episodes.provenance or {}), **told})
