"""Whether recordings contradict numbers of servos: models behind these predict worse than models of commands."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pisplit.brief import brief
from pisplit.data.actuator import Actuator, checked_actuator
from pisplit.data.episodes import Episodes
from pisplit.estimators.actuator_scan import positions
from pisplit.evaluation.horizon import horizon_errors
from pisplit.evaluation.matching import Fitted, States
from pisplit.lifted.model import LiftedModel

Array = NDArray[np.float64]

#: Part of the recordings that is held out, and steps ahead that are looked at.
HELD_OUT, STEPS = 0.25, (4, 16)
#: Error of a model behind servos, in parts of that of a model of commands, beyond which its numbers are wrong.
BORNE = 1.2


@brief
@dataclass(frozen=True, eq=False)
class ActuatorChoice:
    """The first ``actuator`` that recordings do not contradict, ``Actuator()`` where they contradict all.

    actuator    the chosen one
    candidates  (K,) what was tried, as given
    errors      (K,) errors of roll-outs behind each, in parts of those of a model of commands; infinite where a model
                diverges or cannot be fitted
    """

    actuator: Actuator
    candidates: tuple[Actuator, ...]
    errors: Array

    def __str__(self) -> str:
        lines = ["errors of roll-outs behind servos, in parts of those without"]
        for a, error in zip(self.candidates, self.errors, strict=True):
            said = "chosen" if a == self.actuator else "" if error <= BORNE else "contradicted"
            lines.append(f"lag {a.lag:.3g} s, play {a.play:.3g}: {error:.3g} {said}".rstrip())
        return "\n".join(lines)


def choose_actuator(
    fit: Callable[[Episodes], Fitted | LiftedModel],
    episodes: Episodes,
    candidates: Sequence[Actuator],
    start: ArrayLike | None = None,
    inputs: str = "ramp",
    states: States = None,
) -> ActuatorChoice:
    """The first of ``candidates`` that recordings do not contradict: servos of wrong numbers are worse than none.

    Behind each of them, and of commands, ``fit`` makes a model of three quarters of the recordings; the last quarter is
    rolled out over 4 and 16 steps. Numbers are contradicted where errors are 1.2 times those of the model of commands.
    Small gains decide nothing: a model of commands that makes up for a lag predicts as well, and controls worse.

    fit         recordings of positions -> a fitted estimator or a model; it may raise ValueError
    episodes    recordings under commands, two or more
    candidates  the most trusted first: those that are told, then what :func:`find_actuator` finds
    start       (m,) position at rest before each recording; the first command if not given
    inputs      whether commands are reached linearly over a step ("ramp") or held ("step")
    states      output group, names or indices that count; all if not given

    Raises ValueError for fewer than two recordings, no candidates, those that are no actuators, and where no model of
    commands can be fitted or rolled out.
    """
    if len(episodes) < 2:
        raise ValueError(f"{len(episodes)} recording cannot be learned from and held out; give two or more")
    if not candidates:
        raise ValueError("candidates is empty; give the servos that are told or found")
    out = max(1, round(HELD_OUT * len(episodes)))

    def missed(actuator: Actuator) -> float:
        moved = positions(episodes, checked_actuator(actuator), start, inputs)
        found = horizon_errors(fit(moved[:-out]), moved[-out:], STEPS, states, stride=STEPS[0])
        return float(np.exp(np.mean(np.log(found.normalised + 1e-300))))

    without, errors = missed(Actuator()), []
    if not np.isfinite(without):
        raise ValueError("the model of commands diverges on held-out recordings; give a fit that holds")
    for candidate in candidates:
        try:
            errors.append(missed(candidate) / without)
        except ValueError:
            checked_actuator(candidate)
            errors.append(np.inf)
    kept = next((a for a, error in zip(candidates, errors, strict=True) if error <= BORNE), Actuator())
    return ActuatorChoice(kept, tuple(candidates), np.array(errors))
