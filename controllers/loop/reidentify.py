"""What identifies a system again from the log of its loop, and what a loop gets from it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

from pisplit.controllers.loop.log import LoopLog
from pisplit.controllers.loop.tracking import Controller
from pisplit.data.episodes import Episodes
from pisplit.evaluation.matching import Fitted
from pisplit.lifted.model import LiftedModel


@dataclass(frozen=True, eq=False)
class NewModel:
    """A ``model`` that takes the place of another, and ``notes`` on it: what was identified, how well, in what time.

    ``episodes``: recordings (or simulations) of what it describes, from which a controller with an observer takes the
    new process noise. ``found``: all that was learned on the way.
    """

    model: LiftedModel | Fitted
    notes: tuple[str, ...] = ()
    episodes: Episodes | None = None
    found: Any = None

    def __str__(self) -> str:
        return "\n".join(self.notes)


class Identifier(Protocol):
    """Identifies a system from the log of its loop."""

    def __call__(self, log: LoopLog) -> NewModel:
        """The new model from the end of a ``log``; raises ValueError where the log does not identify it."""


@runtime_checkable
class Changeable(Protocol):
    """A controller that can be had for another model."""

    def with_model(self, model: LiftedModel | Fitted, log: LoopLog, episodes: Episodes | None) -> Controller:
        """The same controller on another ``model``, in the midst of the run of ``log``.

        ``episodes``: recordings of what the model describes, for an observer; see :meth:`MPC.with_model`.
        """


def changed(controller: Controller, new: NewModel, log: LoopLog) -> Controller:
    """The ``controller`` on the model of ``new``, which goes on after ``log``.

    Raises ValueError for controllers that cannot change their model, and for a model of other states or inputs.
    """
    if not isinstance(controller, Changeable):
        raise ValueError(f"{type(controller).__name__} has no with_model(model, log, episodes): it keeps its model")
    old = controller.model
    found = controller.with_model(new.model, log, new.episodes)
    for what in ("state_names", "input_names", "state_units", "input_units"):
        was, now = getattr(old, what), getattr(found.model, what)
        if was is not None and now is not None and was != now:
            raise ValueError(f"the new model has other {what.replace('_', ' ')} than the old one; identify the same")
    return found
