"""What happens to measurements on their way: noise, delay, samples that are lost, readings that are nonsense."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pisplit.checks import Array, count, finite_array, non_negative, positive
from pisplit.controllers.loop.history import Line
from pisplit.controllers.loop.plant import Plant
from pisplit.controllers.plants.wrapped import WrappedPlant

#: Entries of a rotation matrix, row by row, as rods name them: R_xx[1], R_xy[1], ...
FRAME = re.compile(r"R_[xyz][xyz]\[(\d+)\]")


class _Random(WrappedPlant):
    """A device that draws random numbers, from ``seed`` on at every reset."""

    def __init__(self, plant: Plant, seed: int) -> None:
        super().__init__(plant)
        self.seed = count(seed, "seed", 0)
        self._rng = np.random.default_rng(self.seed)

    def _begin(self, u: Array, state: Array) -> None:
        self._rng = np.random.default_rng(self.seed)

    def _own(self) -> Any:
        return self._rng.bit_generator.state

    def _take(self, own: Any) -> None:
        self._rng.bit_generator.state = own


class NoisyMeasurements(_Random):
    """Normal noise, independent from sample to sample and from state to state; frames are turned at random.

    Args:
        plant: the inner plant.
        std: standard deviation of every state (n_states,), one number for all, or {unit: standard deviation} for a
            plant that tells ``state_units``; states of other units are exact.
        angle: standard deviation in rad of the random rotation of every frame, states named R_xx[k] to R_zz[k]; they
            stay rotations, and ``std`` does not apply to them. Without it they are states like any other.
        seed: of the noise.

    Raises ValueError for an ``angle`` where the plant has no frames.
    """

    def __init__(self, plant: Plant, std: ArrayLike | Mapping[str, float], angle: float = 0.0, seed: int = 0) -> None:
        super().__init__(plant, seed)
        self.angle = non_negative(angle, "angle", "rad")
        self.std = self._deviations(std)
        self._frames = _frames(getattr(plant, "state_names", None)) if self.angle > 0.0 else []
        if self.angle > 0.0 and not self._frames:
            raise ValueError("angle has no effect on a plant without states R_xx[k] to R_zz[k]; leave it out")
        for frame in self._frames:
            self.std[frame] = 0.0

    def _deviations(self, std: ArrayLike | Mapping[str, float]) -> Array:
        if isinstance(std, Mapping):
            units = getattr(self.plant, "state_units", None)
            if units is None:
                raise ValueError("the plant tells no state_units; give std as a number, or one a state")
            unknown = sorted(set(std) - set(units))
            if unknown:
                raise ValueError(f"no state has the unit {unknown[0]!r}; the plant's are {sorted(set(units))}")
            found = np.array([non_negative(std.get(unit, 0.0), f"std of {unit!r}") for unit in units])
        else:
            given = np.full(self.n_states, non_negative(std, "std")) if np.ndim(std) == 0 else std
            found = finite_array(given, "std", (self.n_states,)).copy()
        if (found < 0.0).any():
            raise ValueError("std has negative entries; expected standard deviations")
        return found

    def _measured(self, state: Array) -> Array:
        from scipy.spatial.transform import Rotation  # slow to load, and needed here alone

        state += self.std * self._rng.standard_normal(self.n_states)
        for frame in self._frames:
            turn = Rotation.from_rotvec(self.angle * self._rng.standard_normal(3)).as_matrix()
            state[frame] = (state[frame].reshape(3, 3) @ turn).ravel()
        return state


class DelayedMeasurements(WrappedPlant):
    """What is measured is ``steps`` samples old, fractions by linear interpolation; at first it is the state at rest.

    Args:
        plant: the inner plant.
        steps: delay in samples.
    """

    def __init__(self, plant: Plant, steps: float) -> None:
        super().__init__(plant)
        self._line = Line(steps, "delay of measurements")

    def _begin(self, u: Array, state: Array) -> None:
        self._line.fill(state)

    def _measured(self, state: Array) -> Array:
        return self._line(state)

    def _own(self) -> Any:
        return self._line.own()

    def _take(self, own: Any) -> None:
        self._line.take(own)


class LostMeasurements(_Random):
    """Samples are lost at random: their states are NaN. The first one, at rest, always arrives.

    Args:
        plant: the inner plant.
        fraction: of the samples, from 0 to 1.
        groups: states (names or positions) that are lost together, for instance those of one marker; all of them when
            not given. States in no group are never lost.
        seed: of the losses.
    """

    def __init__(
        self, plant: Plant, fraction: float, groups: Sequence[Sequence[int | str]] | None = None, seed: int = 0
    ) -> None:
        super().__init__(plant, seed)
        self.fraction = _fraction(fraction)
        self._groups = [_positions(plant, group) for group in groups or [list(range(self.n_states))]]
        self._started = False

    def _begin(self, u: Array, state: Array) -> None:
        super()._begin(u, state)
        self._started = False

    def _measured(self, state: Array) -> Array:
        if not self._started:
            self._started = True
            return state
        for group, lost in zip(self._groups, self._rng.uniform(size=len(self._groups)) < self.fraction, strict=True):
            if lost:
                state[group] = np.nan
        return state

    def _own(self) -> Any:
        return super()._own(), self._started

    def _take(self, own: Any) -> None:
        super()._take(own[0])
        self._started = own[1]


class Outliers(_Random):
    """Samples are wrong at random: a jump of ``size`` in a random direction of a group of states.

    Args:
        plant: the inner plant.
        fraction: of the samples, from 0 to 1.
        size: length of the jump, in the unit of the states.
        groups: states (names or positions) of which one group at a time is wrong, for instance those of one marker.
        seed: of the outliers.

    Raises ValueError for groups without a state.
    """

    def __init__(
        self, plant: Plant, fraction: float, size: float, groups: Sequence[Sequence[int | str]], seed: int = 0
    ) -> None:
        super().__init__(plant, seed)
        self.fraction, self.size = _fraction(fraction), positive(size, "size")
        self._groups = [_positions(plant, group) for group in groups]
        if not self._groups:
            raise ValueError("groups is empty; give the states of at least one sensor")

    def _measured(self, state: Array) -> Array:
        wrong = self._rng.uniform() < self.fraction
        group = self._groups[self._rng.integers(len(self._groups))]
        direction = self._rng.standard_normal(len(group))
        if wrong:
            state[group] += self.size * direction / np.linalg.norm(direction)
        return state


def _fraction(value: float) -> float:
    fraction = non_negative(value, "fraction")
    if fraction > 1.0:
        raise ValueError(f"fraction = {fraction:g}; expected a part of the samples, from 0 to 1")
    return fraction


def _positions(plant: Plant, group: Sequence[int | str]) -> NDArray[np.int64]:
    """Positions of the states of a group, given by name or position."""
    names = list(getattr(plant, "state_names", None) or ())
    found = []
    for entry in group:
        if isinstance(entry, str):
            if entry not in names:
                raise ValueError(f"the plant has no state named {entry!r}; it has {names[:4]}")
            found.append(names.index(entry))
        else:
            found.append(count(entry, "state of a group", 0))
    if not found or max(found) >= plant.n_states:
        raise ValueError(f"group {list(group)[:4]}; expected states from 0 to {plant.n_states - 1}, at least one")
    return np.array(found, dtype=np.int64)


def _frames(names: Sequence[str] | None) -> list[NDArray[np.int64]]:
    """Positions of the nine entries of every frame, row by row."""
    found: dict[str, list[int]] = {}
    for i, name in enumerate(names or ()):
        match = FRAME.fullmatch(name)
        if match:
            found.setdefault(match.group(1), []).append(i)
    order = [f"R_{a}{b}" for a in "xyz" for b in "xyz"]
    return [
        np.array(sorted(at, key=lambda i: order.index((names or ())[i].split("[")[0])), dtype=np.int64)
        for at in found.values()
        if len(at) == 9
    ]
