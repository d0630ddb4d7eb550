"""What the terms of a scene add to the balance of the rod."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from typing import Any, Protocol, runtime_checkable

import casadi as ca
import numpy as np

from pisplit.checks import Array, count, finite_array
from pisplit.models.rod.kinematics.kinematics import Motion


class NoEffect(UserWarning):
    """Something in a scene acts on nothing there."""


@dataclass(frozen=True)
class Input:
    """A named input of the scene with ``size`` entries, in place of a fixed number.

    Args:
        name: of the input; terms that use the same name read the same input.
        size: number of entries.

    Raises ValueError for a name that is no text, and a size below one.
    """

    name: str
    size: int

    def __post_init__(self) -> None:
        if not isinstance(self.name, str) or not self.name:
            raise ValueError(f"Input name = {self.name!r}; expected a non-empty string")
        count(self.size, f"Input {self.name!r} size")


#: A load that is either three numbers or an input of size 3.
Vector = Sequence[float] | Input


def checked_vector(value: Vector, name: str) -> Vector:
    """Three finite numbers as a tuple, or an ``Input`` of size 3. ``value`` is either; ``name`` is for messages."""
    if isinstance(value, Input):
        if value.size != 3:
            raise ValueError(f"{name} is an input of size {value.size}; expected size 3")
        return value
    return tuple(finite_array(value, name, (3,)).tolist())


@dataclass
class Loads:
    """Sums of loads. A term adds to what it affects; what nobody adds to stays exactly zero.

    Attributes:
        force: world force per length at the nodes (3, K) in N/m.
        moment: world moment per length at the nodes (3, K) in N.
        tip_force, tip_moment: world wrench at the tip (3,) in N, N m.
        stress_w, stress_v: body moment (3, K) in N m and force (3, K) in N that a term adds to the elastic stress
            at the nodes (damping, tendons).
        point_force: world internal force at the nodes (3, K) in N that balances forces at points of the rod (see
            ``add_at``); ``point_inertia`` (3, K) the same for inertia forces of added masses.
        point_moments: world moments (3,) in N m between base and tip by arclength in m.
        base_force, base_moment: what forces in N and moments in N m at points add to the resultants at the base (3,)
            beside ``tip_force`` and ``tip_moment``.
        gravity: world acceleration of gravity (3,) in m/s^2.
        moving: whether inertia counts.
        inputs: symbol of each input by name.
        outputs: quantities that a term offers for reading, by name (e.g. tendon tensions).
        work: stored energies in J by name.
    """

    force: ca.SX
    moment: ca.SX
    tip_force: ca.SX
    tip_moment: ca.SX
    stress_w: ca.SX
    stress_v: ca.SX
    point_force: ca.SX
    point_inertia: ca.SX
    base_force: ca.SX
    base_moment: ca.SX
    gravity: ca.SX
    moving: bool
    inputs: dict[str, ca.SX]
    outputs: dict[str, ca.SX] = field(default_factory=dict)
    point_moments: dict[float, ca.SX] = field(default_factory=dict)

    @classmethod
    def none(cls, n_nodes: int, inputs: dict[str, ca.SX], moving: bool = True) -> Loads:
        """No loads at all.

        ``n_nodes`` of the rod, symbols of the ``inputs`` by name, and whether it is ``moving`` (inertia counts).
        """
        nodes, point = ca.SX(3, n_nodes), ca.SX(3, 1)
        return cls(nodes, nodes, point, point, nodes, nodes, nodes, nodes, point, point, point, moving, inputs)

    def add(self, term: Term, motion: Motion) -> None:
        """Let a ``term`` add what it does to a rod in ``motion``.

        Raises ValueError where what it adds has another shape than the sum, or is not a number.
        """
        sums = {f.name: getattr(self, f.name) for f in fields(self) if isinstance(getattr(self, f.name), ca.SX)}
        try:
            term.apply(motion, self)
        except (RuntimeError, NotImplementedError) as error:
            reason = " ".join(str(error).split())[-160:]
            raise ValueError(f"{type(term).__name__}.apply adds what does not fit the loads: ...{reason}") from error
        for name, before in sums.items():
            after = ca.SX(getattr(self, name))
            if after.shape != before.shape:
                raise ValueError(
                    f"{type(term).__name__}.apply makes loads.{name} {after.shape}; expected {before.shape}"
                )
            self._check_numbers(term, name, after)
        for moment in self.point_moments.values():
            self._check_numbers(term, "point_moments", moment)

    def _check_numbers(self, term: Term, name: str, value: ca.SX) -> None:
        """Raise ValueError where a ``term`` from elsewhere makes a sum, by ``name``, a ``value`` that is no number."""
        if type(term).__module__.startswith("pisplit."):
            return
        entries: list[Any] = value.nonzeros()
        if not np.all(np.isfinite([float(e) for e in entries if e.is_constant()])):
            raise ValueError(f"{type(term).__name__}.apply makes loads.{name} NaN or infinite; expected numbers")

    def add_at(self, motion: Motion, s: float, force: ca.SX, moment: ca.SX) -> None:
        """Add a world force (3,) in N and moment (3,) in N m that act at arclength ``s``; see ``shares_below``.

        ``motion`` is that of the rod.
        """
        if motion.is_tip(s):
            self.tip_force += force
            self.tip_moment += moment
        else:
            if s > 0.0:
                self.point_force += force @ ca.DM(shares_below(motion, s))
                if moment.nnz():
                    self.point_moments[s] = self.point_moments.get(s, ca.SX(3, 1)) + moment
            self.base_force += force
            self.base_moment += moment

    def add_inertia_at(self, motion: Motion, s: float, force: ca.SX) -> None:
        """Add an inertia force (3,) in N at arclength ``s``. ``motion`` is that of the rod."""
        self.point_inertia += force @ ca.DM(shares_below(motion, s))
        self.base_force += force

    def read(self, value: Vector) -> ca.SX:
        """Symbol of an input, or the numbers themselves; zeros among them are not in the graph. ``value`` is either."""
        return self.inputs[value.name] if isinstance(value, Input) else ca.sparsify(ca.SX(ca.DM(list(value))))


@runtime_checkable
class Term(Protocol):
    """Anything that acts on a rod. ``inputs`` lists what it reads; ``apply`` adds its loads.

    A term that does not fit every rod may also have ``check(rod, rule)``, called when the scene is made; it raises
    ValueError. One that acts on nothing in some scenes may have ``idle(rod, terms)``, which says why, or None; one
    whose load jumps along the rod ``jumps(rod)``, the arclengths in m at which an element should end.
    """

    @property
    def inputs(self) -> tuple[Input, ...]:
        """Inputs that it reads."""

    def apply(self, motion: Motion, loads: Loads) -> None:
        """Add the loads of this term for a motion of the rod."""

    def describe(self, rod: Any) -> str:
        """One line for the table of the scene. ``rod`` is that of the scene."""


def shares_below(motion: Motion, s: float) -> Array:
    """By how much a wrench at arclength ``s`` loads each node (1, K): row(s)_j / b_j of the integration to ``s``.

    Its work on the motion of that point, F . int_0^s p_ts, is the work of an internal force F row_j / b_j at the nodes,
    so the load is the exact adjoint of the interpolated position and mass matrices stay symmetric. The shares are the
    step from 1 below ``s`` to 0 above it, exactly so where an element ends at ``s``.
    """
    if motion.is_tip(s):
        return np.ones((1, motion.rule.n_nodes))
    shares: Array = motion.rule.integrate_to([s]) / motion.rule.weights
    return shares


def by_row(values: Array, rows: int) -> ca.SX:
    """One number a node (K,) as a constant matrix (rows, K). ``values`` are the numbers."""
    return ca.SX(ca.DM(np.tile(values, (rows, 1))))


def spread(vector: ca.SX, values: Array) -> ca.SX:
    """A vector (3,) times one number a node (K,): (3, K). Equal numbers are multiplied once.

    ``values`` are the numbers.
    """
    if np.ptp(values) == 0.0:
        return ca.repmat(float(values[0]) * vector, 1, len(values))
    return vector @ ca.DM(values[None, :])


def on_the_rod(s: float, length: float, name: str) -> float:
    """``s``, which must be an arclength above 0 and at most the length of the rod. ``name`` is for messages."""
    if not 0.0 < s <= length * (1.0 + 1e-12):
        raise ValueError(f"{name} at s = {s:g} m; expected an arclength above 0 and at most L = {length:g} m")
    return s
