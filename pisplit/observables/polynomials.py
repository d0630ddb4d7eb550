"""Monomials of states or of inputs."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations_with_replacement

import casadi as ca

from pisplit.checks import count
from pisplit.observables.columns import Columns, OneSided, Symbol, monomial


@dataclass(frozen=True)
class Polynomials(OneSided):
    """Monomials of total degree 2 to ``degree`` (degree 0 is Constant, degree 1 States or Inputs).

    ``each``: largest power of a variable, one number or one a variable; with it ``degree`` may be left out, and all
    products of powers up to ``each`` are taken. ``of`` and ``variables`` choose what the monomials are of: "states" or
    "inputs", and names or positions among them.

    Raises ValueError where neither ``degree`` nor ``each`` is given.
    """

    degree: int | None = None
    each: int | Sequence[int] | None = None
    of: str = "states"
    variables: Sequence[str] | Sequence[int] | None = None

    def __post_init__(self) -> None:
        if self.degree is None and self.each is None:
            raise ValueError("Polynomials has neither degree nor each; give the total degree or that of each variable")
        if self.degree is not None:
            count(self.degree, "degree", minimum=2)
        for power in self.each if isinstance(self.each, Sequence) else () if self.each is None else (self.each,):
            count(power, "each", minimum=0)

    def _write(self, v: Symbol, labels: tuple[str, ...], quantities: tuple[str, ...]) -> Columns:
        powers = self._powers(len(labels))
        # Every monomial is a shorter one times a variable: one product a column.
        known: dict[tuple[int, ...], Symbol] = {(i,): v[i] for i in range(len(labels))}
        for power in powers:
            for size in range(2, len(power) + 1):
                if power[:size] not in known:
                    known[power[:size]] = known[power[: size - 1]] * v[power[size - 1]]
        return Columns(
            ca.vertcat(*[known[power] for power in powers]),
            tuple(monomial([labels[i] for i in power]) for power in powers),
            tuple(monomial(sorted(quantities[i] for i in power)) for power in powers),
        )

    def _powers(self, size: int) -> list[tuple[int, ...]]:
        """Index tuples of the monomials, by total degree."""
        if self.each is None:
            highest = [self.degree or 0] * size
        else:
            highest = list(self.each) if isinstance(self.each, Sequence) else [self.each] * size
        if len(highest) != size:
            raise ValueError(f"each has {len(highest)} entries; expected {size}, one a variable")
        total = sum(highest) if self.degree is None else self.degree
        return [
            power
            for d in range(2, total + 1)
            for power in combinations_with_replacement(range(size), d)
            if all(n <= highest[i] for i, n in Counter(power).items())
        ]
