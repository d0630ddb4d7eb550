"""Damped Gauss-Newton steps to the parameters and initial states of recordings, and the way to where they begin."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from pisplit.checks import Array
from pisplit.models.calibration.motion import Known, Motion
from pisplit.models.calibration.problem import Local, Problem

#: Gauss-Newton ends when no free parameter, of order one, changes by more, or the sum of squares falls by a smaller
#: part; and after so many steps.
DIGITS, STEPS = (5e-3, 1e-4), 30
#: Factors of Marquardt's weight after a step that was taken and one that was not.
EASED, STIFFENED = 0.5, 5.0
#: Weight from which on steps of initial states are short, too, and rise of the sum of squares that is none: a standard
#: error of one parameter is worth more, and steps that the integrator halves here and not there make as much.
STOPPED, LEVEL = 1e3, 1.0
#: First weight, and factor after a step that was taken, where it holds back initial states too; standard errors, root
#: mean square over the parameters, that a whole step would be long where such a fit ends.
CAREFULLY, QUICKLY, NEAR = 0.03, 0.25, 0.1
#: Standard errors, root mean square over the parameters, that a step may still be long where no step goes downhill.
SETTLED = 0.5
#: Weight above which a short step only says that it was held back.
HELD_BACK = 0.1
#: Steps of recordings of markers, before the whole, that a fit is led through.
HORIZONS = (3, 6, 12, 24)
#: Factor from one to the next of the sensors' errors on the way from a first guess to markers, the largest that is left
#: out, and steps for each.
LADDER, NOISY, ROUGHLY = 6.0, 2.0, 4


@dataclass(frozen=True)
class Fitted:
    """Where a fit ended.

    Attributes:
        x: parameters (P,).
        first: initial states (N, n).
        best: the problem there.
        motion: the recordings that were simulated.
        why: it is not to be relied on, empty if it is.
        left: how long a whole step would be from there, in standard errors, root mean square over the parameters.
        unended: whether all steps were taken and it had not come to an end.
    """

    x: Array
    first: Array
    best: Local
    motion: Motion
    why: str
    left: float = np.inf
    unended: bool = False

    @property
    def settled(self) -> bool:
        """Whether what is left to do is below what data tell."""
        return not self.why and self.left < SETTLED

    @property
    def known(self) -> dict[int, Known]:
        """Steps of each recording, for a fit of similar parameters to start from."""
        return {i: Known.of(near.found, near.of_steps) for i, near in self.best.nearby.items()}


def approached(problem: Problem, x: Array, first: Array) -> tuple[Array, Array]:
    """Parameters and initial states near the end, by recordings of a few steps and then of more of them.

    Before the parameters explain what is seen, initial states that are free to explain it are thrown far off: short
    recordings are nearly linear in them, and sensors are taken for as bad as the first guess makes them, then less.

    Args:
        problem: what is to be small.
        x: first guess (P,).
        first: initial states and offsets (N, 2n + m).
    """
    whole = problem.motion.measured.shape[1] - 1
    for steps in (k for k in HORIZONS if k < whole):
        short = problem.shortened(steps)
        best = short.linearised(x, short.missed(x, first))
        factor = float(np.sqrt(best.misses / max(best.entries, 1.0)))
        while factor > NOISY:
            found = fitted(short.weighed_down(factor), x, first, ROUGHLY)
            x, first, factor = found.x, found.first, factor / LADDER
        found = fitted(short, x, first, ROUGHLY)
        x, first = found.x, found.first
    return x, first


def fitted(
    problem: Problem,
    x: Array,
    first: Array,
    steps: int = STEPS,
    digits: tuple[float, float] = DIGITS,
    known: Mapping[int, Known] | None = None,
) -> Fitted:
    """Damped Gauss-Newton steps to the end.

    Args:
        problem: what is to be small.
        x: first guess (P,); that of the model where shapes at rest have misled it.
        first: initial states and offsets (N, 2n + m).
        steps: most of them.
        digits: it ends where no free parameter, of order one, changes by more than the first, or the sum of squares
            falls by less than the second part of it.
        known: steps of each recording under other parameters, from which the first ones are looked for.

    Raises RuntimeError where no recording can be simulated.
    """
    here = problem.missed(x, first, known=known)
    if problem.rest is not None and not np.array_equal(x, problem.model.first):
        tried = problem.missed(problem.model.first, first)
        if not here.better(tried):  # shapes at rest alone may leave an arm that cannot be moved
            x, here = problem.model.first, tried
    if not here.motions:
        raise RuntimeError("no recording could be simulated; check that fields and inputs belong to this arm")
    best = problem.linearised(x, here)
    states_shown = problem.motion.energy is None
    weight = 0.0 if states_shown else CAREFULLY
    converged, unlikelier = digits
    for _ in range(steps):
        change = problem.change(x, best, weight)
        start_of = best.moved(first, change, weight)
        tried = problem.missed(x + change, start_of, best)
        small = bool(np.abs(change).max() < converged)
        fell = here.cost - tried.cost
        if tried.better(here):
            still = len(tried.motions) == len(here.motions) and fell < unlikelier * here.cost
            done = weight <= HELD_BACK and (small or still)
            x, first, here = x + change, start_of, tried
            best = problem.linearised(x, here)
            weight *= EASED if states_shown else QUICKLY
            if done or (not states_shown and problem.standard_errors_left(x, best) < NEAR):
                return Fitted(x, first, best, problem.motion, "", problem.standard_errors_left(x, best))
        else:
            if states_shown and weight == 0.0 and problem.standard_errors_left(x, best) < NEAR:
                return Fitted(x, first, best, problem.motion, "")  # what the whole step changes is below what data tell
            lost = tried.lost > here.lost
            weight = max((STIFFENED**2 if lost else STIFFENED) * weight, 1e-3)
            # uphill however short the step: the end, where what is left to do is below what data tell
            if states_shown and weight > HELD_BACK:
                left = problem.standard_errors_left(x, best)
                if left < SETTLED:
                    return Fitted(x, first, best, problem.motion, "", left)
            if small and not lost and (states_shown or weight > STOPPED or -fell < LEVEL):
                left = problem.standard_errors_left(x, best)
                uphill = f"the sum of squares {here.cost:.3g} rises by {-fell:.2g} or more however short the step"
                why = f"{uphill}, and a whole step would be {left:.2g} standard errors long"
                return Fitted(x, first, best, problem.motion, why if left > SETTLED else "")
    return Fitted(x, first, best, problem.motion, f"no end after {steps} steps", unended=True)
