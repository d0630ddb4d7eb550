"""Markers on an arm, as a motion capture system sees them: a few positions, noisy, some of them lost."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from pisplit.checks import Array, count, non_negative
from pisplit.controllers.loop.plant import Plant
from pisplit.controllers.plants.measurements import _fraction, _positions, _Random


class Markers(_Random):
    """Positions p_x[k], p_y[k], p_z[k] of some stations of an arm are all that is measured.

    Args:
        plant: the arm, with states of these names in m, such as a rod's simulator.
        stations: numbers k of the stations that carry a marker, from 1 at the base to the last at the tip.
        noise: standard deviation in m of every coordinate.
        dropouts: part of the samples at which a marker is lost, from 0 to 1: its coordinates are NaN. The first sample,
            at rest, always arrives.
        seed: of noise and losses.
        names: what the coordinates are called, three a station, such as the columns of a log; p_x[k] if not given.
        input_names: what the inputs are called; as the ``plant`` does if not given.

    Raises ValueError for stations that the plant does not have, or has named otherwise, and for other numbers of names.
    """

    def __init__(
        self,
        plant: Plant,
        stations: Sequence[int],
        noise: float = 0.0,
        dropouts: float = 0.0,
        seed: int = 0,
        names: Sequence[str] | None = None,
        input_names: Sequence[str] | None = None,
    ) -> None:
        super().__init__(plant, seed)
        numbers = [count(k, "stations") for k in stations]
        if not numbers or len(set(numbers)) < len(numbers):
            raise ValueError(f"stations = {list(stations)}; expected different numbers of stations, at least one")
        self.stations = tuple(numbers)
        self.noise, self.dropouts = non_negative(noise, "noise", "m"), _fraction(dropouts)
        inner = tuple(f"p_{axis}[{k}]" for k in numbers for axis in "xyz")
        self._chosen = _positions(plant, inner)
        self.state_names = _names(names, "names", len(inner)) or inner
        self.state_units = ("m",) * len(inner)
        if input_names is not None:
            self.input_names = _names(input_names, "input_names", self.n_inputs)
        self._started = False

    @property
    def n_states(self) -> int:
        """Number of measured coordinates, three a marker."""
        return len(self.state_names)

    @property
    def true_states(self) -> Array:
        """States (T+1, n) of the inner plant since the last ``reset``, all of them, before anything measured them."""
        inner: Any = self.plant
        return np.asarray(inner.true_states if hasattr(inner, "true_states") else np.array(self._states))

    def _begin(self, u: Array, state: Array) -> None:
        super()._begin(u, state)
        self._started = False

    def _measured(self, state: Array) -> Array:
        seen = state[self._chosen] + self.noise * self._rng.standard_normal(self.n_states)
        lost = self._rng.uniform(size=len(self.stations)) < self.dropouts
        if self._started:
            seen[np.repeat(lost, 3)] = np.nan
        self._started = True
        return np.asarray(seen, dtype=np.float64)

    def _own(self) -> Any:
        return super()._own(), self._started

    def _take(self, own: Any) -> None:
        super()._take(own[0])
        self._started = own[1]


def _names(given: Sequence[str] | None, name: str, size: int) -> tuple[str, ...]:
    """The ``size`` different names that were given, none where none were."""
    found = () if given is None else tuple(given)
    if given is not None and (isinstance(given, str) or len(set(found)) < len(found) or len(found) != size):
        raise ValueError(f"{name} = {given!r}; expected {size} different names")
    return found
