"""Kinks: hinges of linear forms, and those of tendons that go slack."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import casadi as ca
import numpy as np

from pisplit.checks import finite_array, finite_number, non_negative
from pisplit.observables.columns import Base, Columns, Names, OneSided, Symbol, linear_form
from pisplit.smooth import softplus


@dataclass(frozen=True)
class Hinge(OneSided):
    """max(0, w_j . v + b_j) for the rows w_j of ``directions`` (k, d) and ``offsets`` b (k,), default zero.

    ``width`` > 0 replaces max(0, s) by the softplus of that width [unit of s], 0 keeps the kink.
    """

    directions: Sequence[Sequence[float]]
    offsets: Sequence[float] | None = None
    width: float = 0.0
    of: str = "states"
    variables: Sequence[str] | Sequence[int] | None = None

    def __post_init__(self) -> None:
        rows = finite_array(self.directions, "directions", (None, None))
        offsets = finite_array(np.zeros(len(rows)) if self.offsets is None else self.offsets, "offsets", (len(rows),))
        object.__setattr__(self, "directions", tuple(tuple(row) for row in rows.tolist()))
        object.__setattr__(self, "offsets", tuple(offsets.tolist()))
        non_negative(self.width, "width")

    def _write(self, v: Symbol, labels: tuple[str, ...], quantities: tuple[str, ...]) -> Columns:
        w, b = np.array(self.directions), np.array(self.offsets)
        if w.shape[1] != len(labels):
            raise ValueError(f"directions have {w.shape[1]} entries; expected {len(labels)}, one a variable")
        values = [hinge(ca.dot(ca.DM(row), v) + offset, self.width) for row, offset in zip(w, b, strict=True)]
        names = tuple(f"max(0,{linear_form(row, labels, offset)})" for row, offset in zip(w, b, strict=True))
        return Columns(ca.vertcat(*values), names, ("hinge",) * len(names))


@dataclass(frozen=True)
class Slack(Base):
    """Hinges of tendon inputs: max(0, u_i - k) for every knot k, max(0, u_i + u_j), max(0, -u_i - u_j).

    A tendon that goes slack has such a kink in its input. ``width`` [unit of u] > 0 replaces max(0, s) by the smooth
    softplus of that width, whose Jacobian a controller needs; 0 keeps the kink. ``knots`` are in the unit of u.
    """

    width: float = 0.0
    knots: tuple[float, ...] = (0.0,)

    def __post_init__(self) -> None:
        non_negative(self.width, "width")
        object.__setattr__(self, "knots", tuple(finite_number(k, "knots") for k in self.knots))

    def input_columns(self, u: Symbol, names: Names) -> Columns:
        m = u.shape[0]
        pairs = list(combinations(range(m), 2))
        arguments = [u[i] - k for k in self.knots for i in range(m)]
        labels = [f"{names.inputs[i]}{-k:+g}" if k else names.inputs[i] for k in self.knots for i in range(m)]
        arguments += [u[i] + u[j] for i, j in pairs] + [-u[i] - u[j] for i, j in pairs]
        labels += [f"{names.inputs[i]}+{names.inputs[j]}" for i, j in pairs]
        labels += [f"-{names.inputs[i]}-{names.inputs[j]}" for i, j in pairs]
        values = ca.vertcat(*[hinge(argument, self.width) for argument in arguments])
        return Columns(values, tuple(f"max(0,{label})" for label in labels), ("slack",) * len(labels))


def hinge(s: Symbol, width: float) -> Symbol:
    """max(0, s), rounded over ``width`` where that is not zero."""
    if width == 0.0:
        return ca.fmax(s, 0)
    return softplus(s, width)
