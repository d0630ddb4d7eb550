"""Following a stable equilibrium along a way of loading, past the points at which it ceases to be."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pisplit.checks import Array
from pisplit.models.rod.statics.descent import NEUTRAL, Judge, descend, solved
from pisplit.models.rod.statics.whitened import Way

#: Largest correction in parts of a step, part of the stiffness that a step keeps, longest step [rad, root mean square].
CORRECTION, KEPT, LONGEST = 0.25, 0.3, 2.0
#: Steps of the parameter: the least, below which the branch has ended, and the one that tries the point itself anew.
LEAST, DOUBTFUL = 2e-5, 1e-3
#: How far a rod is pushed off a branch that ends [rad], and how far the load grows there, relative.
PUSH, ONWARD = 1e-2, 1e-2
#: Added to the stiffness in predictions, where it may be singular.
SHIFT = 1e-5
#: Most stiffness that a shape out of balance is given the benefit of: a rod that turns freely about a line never falls
#: short by more, and would otherwise be followed to where no balance is.
DOUBT = 0.2
#: Loss of stability at most along one way.
MOST_EVENTS = 12
#: Force that counts as none at the end.
BALANCED = 1e-9
#: Change that is small enough to be the error of such a force, and not a singular stiffness [rad].
SMALL = 1e-3
#: A bifurcation is told from a fold by the force along the softest direction, in parts of the whole.
ACROSS = 1e-3


@dataclass(frozen=True)
class Event:
    """A loss of stability on the way.

    Attributes:
        at: parameter of the way.
        kind: "fold" (the rod snaps through) or "bifurcation" (it buckles).
        at_rest: whether it came to rest behind.
    """

    at: float
    kind: str
    at_rest: bool


@dataclass(frozen=True)
class Walk:
    """Where following a way ended.

    Attributes:
        y: strains (n,).
        t: parameter that was reached, 1 at the end.
        success: whether the end was reached at a stable equilibrium.
        events: losses of stability on the way.
        passed: equilibria (t, y) on the way, in order, and the stiffness (n, n) about each, as it was predicted.
        stiffness: about the end (n, n); None where it was not reached.
    """

    y: Array
    t: float
    success: bool
    events: tuple[Event, ...]
    passed: tuple[tuple[float, Array, Array], ...] = ()
    stiffness: Array | None = None


def walk(way: Way, y: Array, judge: Judge, snaps: bool = True) -> Walk:
    """Follow the equilibrium from ``y`` (n,) at 0 to 1 along ``way``; the ``judge`` tells stable shapes.

    Prediction by the tangent and the curvature of the last two steps, one Newton correction a step. A step counts if
    its correction is small and the stiffness stays: in every direction a part of what it was. Where steps shrink to
    nothing the branch has ended: the rod is pushed along its softest direction and sinks (``descend``) to where it
    rests under a slightly larger load; with ``snaps=False`` the walk ends there.
    """
    events, passed = list[Event](), list[tuple[float, Array, Array]]()
    t, step = 0.0, 1.0
    force, stiffness, rate = way(y, 0.0)
    y = y + solved(_shifted(stiffness, 1e-2 * SHIFT), force)
    passed.append((t, y, stiffness))
    tangent = solved(_shifted(stiffness), rate)
    before: tuple[Array, float] | None = None
    fresh = False
    while t < 1.0:
        length = judge.size(tangent)
        step = min(step, 1.0 - t, LONGEST / length if length > 0.0 else 1.0)
        guess = y + step * tangent
        if before is not None:
            guess = guess + 0.5 * step * step * (tangent - before[0]) / before[1]
        ahead = t + step if 1.0 - t - step > 1e-12 else 1.0
        force, now, rate_ahead = way(guess, ahead)
        slack = min(DOUBT, NEUTRAL + float(np.linalg.norm(force)) / max(judge.size(guess), 0.1))
        accepted = judge.kept(now, stiffness, KEPT, slack)
        if accepted:
            correction = solved(_shifted(now), force)
            allowed = CORRECTION * judge.size(guess - y) + 1e-9
            part = judge.size(correction) / allowed
            accepted = part <= 1.0
        if accepted:
            before = tangent, step
            y, t, stiffness, rate, fresh = guess + correction, ahead, now, rate_ahead, False
            passed.append((t, y, stiffness))
            tangent = solved(_shifted(now), rate)
            step *= min(3.0, max(1.0, 0.7 / np.sqrt(max(part, 1e-3))))
            continue
        if step < DOUBTFUL and not fresh and snaps:  # the point itself may be off the path
            y, stiffness, rate = _settled(way, y, t, judge)
            tangent, before, fresh = solved(_shifted(stiffness), rate), None, True
        if step > LEAST:
            step *= 0.25 if step > 0.05 else 0.4
            continue
        events.append(_event(judge, stiffness, rate, t))
        if not snaps or len(events) >= MOST_EVENTS:
            return Walk(y, t, False, tuple(events))
        direction = judge.softest(stiffness)[1]
        side = 1.0 if direction @ tangent >= 0.0 else -1.0
        t = min(1.0, t + max(10.0 * LEAST, ONWARD * t))
        y, rests = descend(way, y + side * PUSH * direction, t, judge)
        events[-1] = Event(events[-1].at, events[-1].kind, rests)
        if not rests:
            return Walk(y, t, False, tuple(events))
        y, stiffness, rate = _settled(way, y, t, judge)
        passed.append((t, y, stiffness))
        tangent, before, fresh, step = solved(_shifted(stiffness), rate), None, True, 0.02
    return replace(_ended(way, y, judge, tuple(events)), passed=tuple(passed))


def _ended(way: Way, y: Array, judge: Judge, events: tuple[Event, ...]) -> Walk:
    """Newton's method at the end of the way."""
    for _ in range(12):
        force, stiffness, _ = way(y, 1.0)
        if not np.isfinite(force).all():
            break
        step = solved(_shifted(stiffness, 1e-2 * SHIFT), force)
        if np.abs(force).max() < BALANCED:
            last = step if judge.size(step) < SMALL else 0.0  # the last digits, for nothing
            return Walk(y + last, 1.0, judge.stable(stiffness), events, stiffness=stiffness)
        if not judge.size(step) <= 0.3:
            break
        y = y + step
    return Walk(y, 1.0, False, events)


def _settled(way: Way, y: Array, t: float, judge: Judge) -> tuple[Array, Array, Array]:
    """``y`` nearer to the equilibrium at ``t``, its stiffness and rate."""
    for _ in range(4):
        force, stiffness, rate = way(y, t)
        if np.abs(force).max() < 1e-8:
            break
        step = solved(_shifted(stiffness, 0.1 * SHIFT), force)
        if not judge.size(step) < 0.2:
            break
        y = y + step
    return y, stiffness, rate


def _event(judge: Judge, stiffness: Array, rate: Array, t: float) -> Event:
    direction = judge.softest(stiffness)[1]
    across = abs(float(direction @ rate)) < ACROSS * max(float(np.linalg.norm(rate)), ACROSS)
    return Event(t, "bifurcation" if across else "fold", False)


def _shifted(stiffness: Array, by: float = SHIFT) -> Array:
    shifted = stiffness.copy()
    shifted.flat[:: len(shifted) + 1] += by
    return shifted
