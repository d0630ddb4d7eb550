"""Steps by the clock: a loop sleeps until the next sample is due, and says how late it came."""

from __future__ import annotations

import time

#: Part of a time step by which a sample may be late; beyond it is an overrun, and the clock goes on from there.
TOLERANCE = 0.1


class Pace:
    """Samples every ``dt`` [s] from its making on."""

    def __init__(self, dt: float) -> None:
        self._dt = dt
        self._due = time.monotonic() + dt

    def wait(self) -> float:
        """Sleep until the next sample is due; how late it is [s], zero or more.

        Later than a tenth of a step, the samples after it are due from now on: no step is ever shortened to catch up.
        """
        left = self._due - time.monotonic()
        if left > 0.0:
            time.sleep(left)
        now = time.monotonic()
        late = max(0.0, now - self._due)
        self._due = (now if late > TOLERANCE * self._dt else self._due) + self._dt
        return late
