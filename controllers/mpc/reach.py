"""References that cannot be reached: put where the model can rest, with a warning that gives the distance."""

from __future__ import annotations

import warnings

import numpy as np
from numpy.typing import ArrayLike

from pisplit.checks import Array, count, finite_array
from pisplit.controllers.mpc.mpc import MPC
from pisplit.controllers.references import Reference, from_array

#: Distance, in parts of the output's scale, from which on a sample counts as out of reach.
OUT = 1e-3


def within_reach(reference: Reference, mpc: MPC, steps: int, start: ArrayLike | None = None) -> Reference:
    """The ``reference`` over ``steps`` steps of the ``mpc``, samples out of reach replaced by the nearest within.

    Reach is that of rest: outputs under which the model is in equilibrium with inputs inside the limits; what is
    passed through in motion may lie beyond it. Near is meant in the weights and scales of the controller. Outputs are
    those that it tracks. ``start`` (p,): where the run begins, for references that need it.

    A warning gives the largest distance and the time of it. Raises ValueError for models that come to no rest.
    """
    if not mpc.steady.exists:
        raise ValueError("the model does not come to rest by itself: what it can reach is not known")
    p, dt = len(mpc.tracked), mpc.model.dt
    bound = reference if start is None else reference.starting_at(finite_array(start, "start", (reference.width,)))
    wanted = bound(dt * np.arange(count(steps, "steps") + 1))
    if wanted.shape[1] != p:
        wanted = wanted[:, list(mpc.axes)]
    model, none = mpc.model, np.zeros(mpc.model.n_lifted)
    u: Array = np.clip(model.input_offset, mpc.u_min, mpc.u_max)
    found, away = wanted.copy(), np.zeros(len(wanted))
    for k, y in enumerate(wanted):
        known = ~np.isnan(y)
        if k and np.array_equal(y, wanted[k - 1], equal_nan=True):
            found[k], away[k] = found[k - 1], away[k - 1]
            continue
        nearest = mpc.steady(y, none, np.zeros(p), u)
        if nearest is None or not known.any():
            continue
        u = nearest
        rest = model.read(model.fixed_point(u))[list(mpc.tracked)]
        if (np.abs(rest - y)[known] > OUT * mpc.output_scale[known]).any():
            away[k] = float(np.linalg.norm((rest - y)[known]))
            found[k] = np.where(known, rest, np.nan)
    if away.any():
        k = int(np.argmax(away))
        unit = f" {model.units[mpc.tracked[0]]}".rstrip()
        warnings.warn(
            f"{np.count_nonzero(away)} of {len(away)} samples of the reference are out of reach, by up to "
            f"{away[k]:.3g}{unit} at t = {k * dt:.2f} s; they are put where the model can rest",
            stacklevel=2,
        )
    return from_array(found, dt, reference.track)
