"""Commands of one table whose stamps do not fit the motion: found, told, and left as they are."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pisplit.data.latency import Latency, find_latency
from pisplit.data.warning import warn

Array = NDArray[np.float64]

#: A table has one clock as a rule. Another is told only where it predicts better than the usual delay by this part,
VISIBLE = 0.3
#: where it is known to so many steps, and commands changed so often: a few changes tell anything.
SHARP, CHANGES = 2.5, 30
#: A motion that begins later than so many times its error is told.
CLEARLY = 1.5


def found(xs: Sequence[Array], us: Sequence[Array], dt: float) -> dict[str, Any]:
    """Provenance of episodes ``xs`` (T_i + 1, n), ``us`` (T_i, m) at steps ``dt`` [s]: the delay of their motion.

    Warns where the motion comes before its commands, and where it follows them by more than a step.
    """
    if not us or not us[0].shape[1]:
        return {}
    if sum(int((np.diff(u, axis=0) != 0.0).any(axis=1).sum()) for u in us) < CHANGES:
        return {}
    latency = find_latency(xs, us, dt)
    if latency.delay is None or latency.error > SHARP * dt:
        return {}
    if latency.residual > (1.0 - VISIBLE) * latency.usual and not latency.begins:
        return {}
    text = said(latency, dt)
    if text:
        warn(text)
    return {"latency": latency.delay, "latency_error": latency.error}


def said(latency: Latency, dt: float) -> str:
    """What there is to say of a ``latency`` at steps of ``dt`` [s], "" if nothing."""
    if latency.delay is None:
        return ""
    late, within = 1e3 * latency.delay, 1e3 * latency.error
    if latency.delay < -latency.error:
        return (
            f"the motion comes {-late:.0f} ms (within {within:.0f} ms) before its commands: are they stamped late? "
            f"command_shift={latency.delay:.3g} moves them, command_shift=0 keeps them"
        )
    if latency.delay > (CLEARLY * latency.error if latency.begins else max(latency.error, dt)):
        return (
            f"the motion follows its commands by {late:.0f} ms (within {within:.0f} ms): of the robot, which MPC takes "
            f"as command_delay={latency.delay / dt:.2g}, or of commands stamped early, by so much at most, which "
            f"command_shift={latency.delay:.3g} mends"
        )
    return ""
