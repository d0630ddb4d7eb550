"""What the recordings reached: limits of inputs where none are given, and a word where a loop is to go further."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from pisplit import Episodes
from pisplit.checks import Array, finite_array

#: Times the recorded distance from rest up to which limits of inputs are trusted.
TRUSTED = 2.0


def recorded(d1: Episodes) -> dict[str, list[list[float]]]:
    """Least and largest value of every state of the recordings ``d1``: ``{"states": [[low, ...], [high, ...]]}``."""
    x = d1.stacked_states()
    return {"states": [x.min(axis=0).tolist(), x.max(axis=0).tolist()]}


def limits(
    d1: Episodes, rest: Array, u_max: ArrayLike | None, u_min: ArrayLike | None, du_max: ArrayLike | None
) -> tuple[Array, Array, ArrayLike]:
    """Least and largest inputs (m,) and the largest change per step: those given, else those of the recordings ``d1``.

    rest             inputs (m,) at rest, about which ``u_max`` is mirrored where it is given and ``u_min`` is not
    u_max, u_min     limits, numbers or (m,), in the unit of the inputs, or None
    du_max           largest change per step, a number or (m,), or None
    """
    u = d1.stacked_inputs()
    given = None if u_max is None else np.broadcast_to(finite_array(np.atleast_1d(u_max), "u_max", (None,)), rest.shape)
    high = u.max(axis=0) if given is None else given.copy()
    if u_min is not None:
        low = np.broadcast_to(finite_array(np.atleast_1d(u_min), "u_min", (None,)), rest.shape).copy()
    else:
        low = u.min(axis=0) if given is None else 2.0 * rest - high
    if du_max is None:
        changes = [np.abs(np.diff(v, axis=0)).max(axis=0) for v in d1.us if len(v) > 1]
        du_max = np.max(changes, axis=0)
    return low, high, du_max


def beyond(d1: Episodes, rest: Array, low: Array, high: Array) -> str:
    """A word where limits ``low`` and ``high`` (m,) allow much more than the recordings ``d1``, else an empty text.

    ``rest`` (m,) is where inputs are at rest.
    """
    u = d1.stacked_inputs()
    least, most = u.min(axis=0), u.max(axis=0)
    reached = np.maximum(np.maximum(most - rest, rest - least), 1e-12 * (np.abs(u).max() or 1.0))
    wanted = np.maximum(high - rest, rest - low)
    k = int(np.argmax(wanted / reached))
    if not wanted[k] > TRUSTED * reached[k]:
        return ""
    name = (d1.input_names or [f"u{k + 1}"] * (k + 1))[k]
    return (
        f"the limits let {name} go {wanted[k]:.3g} from rest, {wanted[k] / reached[k]:.2g} times as far as recorded "
        f"({least[k]:.3g} .. {most[k]:.3g}): the model is a guess there; without u_max they are those of the recordings"
    )
