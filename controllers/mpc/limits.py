"""Input box, rate limits and the plane of inputs that the model knows; projection of a move onto all three."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from pisplit.checks import Array, finite_array
from pisplit.data.input_subspace import combination
from pisplit.lifted.model import LiftedModel

SPAN_TOLERANCE = 1e-10  # distance in half box widths at which an input counts as in offset + span(basis)


@dataclass(frozen=True)
class InputLimits:
    """u_min <= u <= u_max, |u_k - u_{k-1}| <= du_max and u in offset + span(basis); all (m,), basis (m, r) orthonormal.

    Build it with ``input_limits``, which checks the arguments.
    """

    u_min: Array
    u_max: Array
    du_max: Array
    offset: Array
    basis: Array

    @property
    def amplitude(self) -> Array:
        """Half width (m,) of the box: the unit in which moves are weighed."""
        return 0.5 * (self.u_max - self.u_min)

    def coordinates(self, u: Array) -> Array:
        """Coordinates (r,) of the input nearest to u that is inside both the box and the plane."""
        nearest = self._into(u, self.u_min, self.u_max)
        return self.basis.T @ ((self.on_plane(u) if nearest is None else nearest) - self.offset)

    def project(self, u: Array, u_previous: Array) -> Array:
        """The input (m,) to apply instead of u after u_previous: no limit is violated, not even by a rounding error.

        In the plane when u_previous is; otherwise as near to the plane as the rate limits let one step come.
        """
        low = np.maximum(self.u_min, u_previous - self.du_max)
        high = np.minimum(self.u_max, u_previous + self.du_max)
        if np.abs(self.on_plane(u_previous) - u_previous).max() <= 10 * SPAN_TOLERANCE * self.amplitude.max():
            inside = self._into(u, low, high)
            if inside is not None:
                return inside
        goal = self._into(u, self.u_min, self.u_max)
        move = (np.clip(u, self.u_min, self.u_max) if goal is None else goal) - u_previous
        move *= min(1.0, 1.0 / max(float((np.abs(move) / self.du_max).max()), 1e-300))
        return np.clip(u_previous + move, low, high)

    def on_plane(self, u: Array) -> Array:
        """The point (m,) of the plane that is nearest to ``u`` (m,)."""
        return self.offset + self.basis @ (self.basis.T @ (u - self.offset))

    @cached_property
    def normal(self) -> Array | None:
        """Unit vector (m,) across the plane where that is all there is across it, None where there is more or less."""
        m, r = self.basis.shape
        if m - r != 1:
            return None
        normal = np.linalg.svd(self.basis, full_matrices=True)[0][:, -1]
        return np.where(np.abs(normal) > SPAN_TOLERANCE, normal, 0.0)

    def _into(self, u: Array, low: Array, high: Array) -> Array | None:
        """A point of the box [low, high] on the plane, near u; None if there is none.

        With one direction across the plane it is the nearest; with several, it is found by alternating projections.
        """
        m, r = self.basis.shape
        if m == r:
            return np.asarray(np.minimum(np.maximum(u, low), high))
        tolerance = SPAN_TOLERANCE * self.amplitude.max()
        if self.normal is not None:
            return _nearest(u, low, high, self.normal, self.offset, tolerance)
        for _ in range(200):
            inside = np.clip(u, low, high)
            u = self.on_plane(inside)
            if np.abs(u - inside).max() <= tolerance:
                return inside
        return None


def _nearest(u: Array, low: Array, high: Array, normal: Array, offset: Array, tolerance: float) -> Array | None:
    """The point nearest to u of the box [low, high] with normal . (x - offset) = 0; None if there is none.

    It is clip(u - t normal) for the t at which the plane is met. Across the plane that point moves one way as t grows,
    along a line between the 2 m values of t at which a coordinate meets its limit.
    """
    inside = np.minimum(np.maximum(u, low), high)
    near = tolerance / np.abs(normal).max()
    if abs(normal @ (inside - offset)) <= near:
        return np.asarray(inside)
    moves = normal != 0.0
    t = np.sort(np.concatenate([(u - low)[moves] / normal[moves], (u - high)[moves] / normal[moves]]))
    points = np.minimum(np.maximum(u - t[:, None] * normal, low), high)
    across = (points - offset) @ normal
    if across[0] < 0.0 or across[-1] > 0.0:
        k = 0 if across[0] < 0.0 else -1
        return np.asarray(points[k]) if abs(across[k]) <= near else None
    k = int(np.argmax(across <= 0.0))
    if k == 0:
        return np.asarray(points[0])
    part = across[k - 1] / (across[k - 1] - across[k])
    return np.asarray(np.minimum(np.maximum(points[k - 1] + part * (points[k] - points[k - 1]), low), high))


def input_limits(
    u_min: ArrayLike,
    u_max: ArrayLike,
    du_max: ArrayLike,
    n_inputs: int,
    offset: Array | None = None,
    basis: Array | None = None,
) -> InputLimits:
    """Limits of ``n_inputs`` inputs, with or without a plane ``offset`` (m,) + span(``basis`` (m, r)).

    u_min, u_max, du_max: numbers or (m,), in input units, du_max per step.

    Raises ValueError on wrong lengths, an empty box, du_max <= 0, or a box that the plane offset + span(basis) misses.
    """
    for given, name, wanted in ((u_min, "u_min", "lower limits"), (u_max, "u_max", "upper limits")):
        if given is None:
            raise ValueError(f"{name} = None; give the {wanted} of the inputs, a number or {n_inputs}")
    if du_max is None:
        raise ValueError("du_max = None; give the largest change per step, u_max - u_min where there is no limit")
    low, high, rate = (
        _each_input(value, name, n_inputs) for value, name in ((u_min, "u_min"), (u_max, "u_max"), (du_max, "du_max"))
    )
    if (low >= high).any():
        i = int(np.argmax(low >= high))
        raise ValueError(f"u_min = {low[i]:g} is not below u_max = {high[i]:g} for input {i}; give a box with width")
    if (rate <= 0.0).any():
        raise ValueError(f"du_max = {rate.min():g}; expected a positive change per step for every input")
    centre = np.zeros(n_inputs) if offset is None else finite_array(offset, "input_offset", (n_inputs,))
    if basis is None or basis.shape[1] == n_inputs:  # the plane is the whole space: plain coordinates, plain bounds
        return InputLimits(low, high, rate, centre, np.eye(n_inputs))
    if basis.shape[1] == 0:
        raise ValueError("the model has an empty input_basis: its training inputs never changed; excite the inputs")
    limits = InputLimits(low, high, rate, centre, basis)
    if limits._into(centre, low, high) is None:
        raise ValueError(
            f"the box u_min .. u_max contains no input of the training data (their mean: {centre}); widen the box"
        )
    return limits


def directions(basis: ArrayLike, n_inputs: int) -> Array:
    """An orthonormal basis (``n_inputs``, r) of the columns of ``basis`` (``n_inputs``, r).

    Raises ValueError on another shape and on columns that depend on each other.
    """
    columns = finite_array(basis, "input_basis", (n_inputs, None))
    if columns.shape[1] == 0 or np.linalg.matrix_rank(columns) < columns.shape[1]:
        raise ValueError(
            f"input_basis has {columns.shape[1]} columns of rank {np.linalg.matrix_rank(columns)}; "
            "give independent directions, np.eye(m) for all"
        )
    return np.linalg.qr(columns)[0]


def held_directions(model: LiftedModel, basis: Array, given: bool) -> tuple[str, ...]:
    """Lines on the directions in which inputs may move, where recordings of the ``model`` leave some of them out.

    ``basis`` (m, r): the directions that are free; whether they were ``given`` by the user.
    """
    known = model.provenance.get("input_directions", [])
    if given:
        return (f"inputs move in {basis.shape[1]} of {model.n_inputs} directions, as given in input_basis", *known)
    if basis.shape[1] == model.n_inputs:
        return ()
    if not known:
        held = np.linalg.svd(basis, full_matrices=True)[0][:, basis.shape[1] :].T
        known = [f"{combination(row, model.input_names)}: held" for row in held]
    return ("inputs move in the directions that the recordings excite; input_basis overrides", *known)


def _each_input(value: ArrayLike, name: str, n_inputs: int) -> Array:
    if np.ndim(value) == 0:
        value = np.full(n_inputs, value)
    limit = finite_array(value, name, (n_inputs,)).copy()
    limit.setflags(write=False)  # controllers hand it out
    return limit
