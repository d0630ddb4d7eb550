"""Who follows a run while it goes on: callbacks, and a log file that is written as it grows."""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from pisplit.checks import Array
from pisplit.controllers.loop.log import LoopLog
from pisplit.controllers.loop.stream import LogStream
from pisplit.controllers.loop.tracking import Move


@dataclass(frozen=True, eq=False)
class LoopStep:
    """A completed step, told to callbacks; arrays are copies.

    ``k``: its number from 0 on; ``t``: time at its end [s]; ``x`` (n,): what was measured then; ``reference`` (p,):
    what was wanted then; ``u`` (m,): the input applied over it; ``move``: what the controller answered.
    """

    k: int
    t: float
    x: Array
    reference: Array
    u: Array
    move: Move


#: Called after every step. A text that it returns ends the run and is the reason in the log, as an exception does; a
#: Warning is given and noted in the log.
Callback = Callable[[LoopStep], str | Warning | None]


class Follower:
    """Tells ``callbacks`` each step, and writes ``log(first)``, the log from step ``first`` on, to the file ``path``.

    A file that cannot be written any further ends no run: ``fault`` says why.
    """

    def __init__(
        self, callbacks: Sequence[Callback], path: str | os.PathLike[str] | None, log: Callable[[int], LoopLog]
    ) -> None:
        for callback in callbacks:
            if not callable(callback):
                raise ValueError(f"callbacks hold a {type(callback).__name__}; expected functions of a LoopStep")
        self._callbacks, self._log, self._path = tuple(callbacks), log, path
        self._stream = None if path is None else LogStream(path, log(0))
        self.fault, self.warned = "", list[str]()

    def write_if_due(self) -> None:
        """Append the new steps to the file, about once a second."""
        if self._stream is not None and self._stream.due():
            try:
                self._stream.write(self._log(self._stream.steps))
            except ValueError as error:
                self._give_up(error)

    def tell(self, step: LoopStep) -> str:
        """Hand ``step`` to the callbacks; what ends the run, or an empty text. Warnings are collected in ``warned``."""
        for callback in self._callbacks:
            answer = callback(step)
            if isinstance(answer, Warning):
                self.warned.append(str(answer))
                warnings.warn(answer, stacklevel=5)
            if isinstance(answer, str):
                return answer or "no reason given"
        return ""

    def finish(self) -> None:
        """Replace the growing file by the whole log, which carries its digest."""
        if self._stream is not None:
            try:
                self._stream.close()
                self._log(0).save(self._stream.path)
            except ValueError as error:
                self._give_up(error)

    def _give_up(self, error: ValueError) -> None:
        self.fault = f"log file: {error}"
        self._stream = None
        warnings.warn(self.fault, stacklevel=5)
