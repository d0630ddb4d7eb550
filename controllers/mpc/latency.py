"""Known delays of commands and measurements, taken out by prediction."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from pisplit.checks import Array, non_negative


@dataclass(frozen=True)
class Latency:
    """Delays in steps, fractions allowed: ``command`` until a command acts, ``measurement`` until a state is known.

    A controller that only ever sees the state as it was ``measurement`` steps ago works with that state: to it both
    delays are one delay of the inputs, and what changes is the time at which its outputs are wanted. So fractions need
    no interpolation of measured states: with d = command + measurement, c = floor(d) and f = d - c, the input that
    acts between two measurements is (1 - f) u_{k-c} + f u_{k-c-1}.

    Raises ValueError for negative delays.

    Source: delay as a shift of the plan, Rawlings, Mayne and Diehl, Model Predictive Control (2017), section 1.3;
    Astrom and Wittenmark, Computer-Controlled Systems (1997), section 2.3, for fractions of a step.
    """

    command: float = 0.0
    measurement: float = 0.0

    def __post_init__(self) -> None:
        non_negative(self.command, "command_delay", "steps")
        non_negative(self.measurement, "measurement_delay", "steps")

    @property
    def total(self) -> float:
        """Both delays together, in steps."""
        return self.command + self.measurement

    @property
    def steps(self) -> int:
        """c: whole steps for which the acting inputs are already known."""
        return int(self.total)

    @property
    def part(self) -> float:
        """f: fraction of a step beyond them."""
        return self.total - self.steps

    @property
    def preview(self) -> int:
        """How many samples of the reference are needed beyond the horizon."""
        return max(0, math.ceil(self.steps - self.measurement))

    def mixed(self, response: Array, n_inputs: int) -> Array:
        """The ``response`` (q, H n_inputs) to acting inputs as one to commands."""
        if self.part == 0.0:
            return response
        later = np.zeros_like(response)
        later[:, :-n_inputs] = response[:, n_inputs:]
        return (1.0 - self.part) * response + self.part * later

    def acting(self, v: Array, v_previous: Array) -> Array:
        """Inputs (H, r) that act under the commands ``v`` (H, r), which come after ``v_previous`` (r,)."""
        if self.part == 0.0:
            return v
        return (1.0 - self.part) * v + self.part * np.vstack([v_previous, v[:-1]])

    def wanted(self, window: Array, before: Array) -> Array:
        """The reference (H, p) of the outputs that the plan decides on, H = len(window) - preview.

        ``window`` (H + preview, p): samples k+1, k+2, ...; ``before`` (p,): sample k. NaN stays free, also between.
        """
        shift = self.steps - self.measurement
        whole, part = math.floor(shift), shift - math.floor(shift)
        rows = np.vstack([before, window])
        first, H = 1 + whole, len(window) - self.preview
        found = rows[first : first + H]
        return found if part == 0.0 else (1.0 - part) * found + part * rows[first + 1 : first + 1 + H]
