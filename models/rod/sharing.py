"""Whatever is made of a scene can be copied, pickled, sent to a worker, and asked from several threads."""

from __future__ import annotations

import threading
from collections.abc import Callable
from functools import cached_property, wraps
from typing import Any, TypeVar, cast

Method = TypeVar("Method", bound=Callable[..., Any])
_LOCK = "_lock_of_solvers"


class Rebuilt:
    """An object whose copies and pickles carry what it was made of; what is cached (graphs, solvers) is built anew.

    CasADi's symbols cannot be pickled, and its solvers hold memory that copies must not share. Subclasses keep
    everything of CasADi in cached properties.
    """

    def __getstate__(self) -> dict[str, Any]:
        kinds = type(self).__mro__
        cached = {name for kind in kinds for name, value in vars(kind).items() if isinstance(value, cached_property)}
        return {name: value for name, value in self.__dict__.items() if name not in cached and name != _LOCK}


def lock_of(scene: Any) -> threading.RLock:
    """The lock that everything which calls solvers of a scene takes.

    CasADi lets other threads run while it computes, and its solvers write into memory of their own: two threads in one
    rootfinder or integrator give wrong numbers or end the process. Scenes share nothing: copies run side by side.
    """
    lock: threading.RLock = scene.__dict__.setdefault(_LOCK, threading.RLock())
    return lock


def in_turn(of: str = "scene") -> Callable[[Method], Method]:
    """Decorator of a method: calls from several threads wait for one another; ``of`` names the attribute whose solvers
    it uses (see ``lock_of``)."""

    def decorate(method: Method) -> Method:
        @wraps(method)
        def call(self: Any, *args: Any, **kwargs: Any) -> Any:
            with lock_of(getattr(self, of)):
                return method(self, *args, **kwargs)

        return cast(Method, call)

    return decorate
