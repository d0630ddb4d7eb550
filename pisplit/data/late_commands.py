"""Commands of one table whose stamps do not fit the motion: found, told, and left as they are."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pisplit.checks import finite_number
from pisplit.data.latency import Latency, find_latency
from pisplit.data.warning import silently, warn

Array = NDArray[np.float64]

#: A table has one clock as a rule. Another is told only where it predicts better than the usual delay by this part,
VISIBLE = 0.3
#: where it is known to so many steps, and commands changed so often: a few changes tell anything.
SHARP, CHANGES = 2.5, 30
#: A motion that begins later than so many times its error is told.
CLEARLY = 1.5
#: The word for a shift that is whatever is found, either way.
FOUND = "found"


def told(command_shift: Any) -> float | str | None:
    """A ``command_shift`` in s, ``"found"`` or None, checked. Raises ValueError for anything else."""
    if command_shift is None or (isinstance(command_shift, str) and command_shift == FOUND):
        return command_shift
    if isinstance(command_shift, str):
        raise ValueError(f"command_shift is not a number: {command_shift!r}; expected seconds, or {FOUND!r}")
    return finite_number(command_shift, "command_shift")


def corrected(made: Callable[[float], dict[str, Any]]) -> dict[str, Any]:
    """What ``made`` gives for the shift of the commands [s] at which the motion begins with them, if it is known.

    ``made`` makes fields of Episodes of a shift. Warns of the shift, or that none was found.
    """
    first = made(0.0)
    latency = find_latency(first["xs"], first["us"], first["dt"])
    shift, text = correction(latency)
    warn(text)
    found = silently(lambda: made(shift)) if shift else first
    found["provenance"] |= left(latency, shift)
    return found


def correction(latency: Latency) -> tuple[float, str]:
    """The shift of the commands [s] that takes a ``latency`` away, either way, and what is said of it."""
    if latency.delay is None or abs(latency.delay) <= latency.error:
        seen = "no delay of the motion stands out" if latency.delay is None else f"{latency}: none to tell"
        return 0.0, f"{seen}; the commands keep their times (command_shift={FOUND!r})"
    which = "follows its commands by" if latency.delay > 0.0 else "comes before its commands by"
    late, within = 1e3 * abs(latency.delay), 1e3 * latency.error
    return latency.delay, (
        f"the motion {which} {late:.0f} ms (within {within:.0f} ms): these are moved by that, as asked; "
        f"where the robot itself answers late, MPC wants it as command_delay, in steps"
    )


def left(latency: Latency, shift: float) -> dict[str, Any]:
    """Provenance of commands that were moved by a ``shift`` [s]: that, and the ``latency`` that is left."""
    known = latency.delay is not None
    return {
        "command_shift": shift,
        "latency": latency.delay - shift if latency.delay is not None else None,
        "latency_error": latency.error if known else None,
    }


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
