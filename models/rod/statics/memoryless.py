"""KINSOL without what it remembers of former calls."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import casadi as ca

#: Calls after which the solver is built anew (10 ms) and the memories of its former calls are given back.
MOST_MEMORIES = 500


class Memoryless:
    """A rootfinder whose answer depends on its arguments alone.

    KINSOL compares its progress with a residual that it keeps from the call before, and one call in fifty then takes
    other steps: the answers differ in their last digits with the order of the calls. A node of a graph, unlike the
    function itself, is evaluated in a memory that nobody holds; every call keeps its own (12 microseconds).

    Args:
        build: makes the rootfinder.
    """

    def __init__(self, build: Callable[[], ca.Function]) -> None:
        self._build = build
        self._renew()

    def _renew(self) -> None:
        self._solver, self._calls = self._build(), 0
        symbols = [ca.MX.sym(f"i{k}", self._solver.size1_in(k)) for k in range(self._solver.n_in())]
        self._node = ca.Function("memoryless", symbols, [self._solver(*symbols)], {"never_inline": True})

    def __call__(self, *arguments: Any) -> Any:
        """The answer of the rootfinder to ``arguments``. Raises RuntimeError where it fails."""
        if self._calls == MOST_MEMORIES:
            self._renew()
        self._calls += 1
        try:
            return self._node(*arguments)
        finally:
            self._solver.checkout()  # takes the memory just used, for good
