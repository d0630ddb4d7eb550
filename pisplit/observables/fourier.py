"""Trigonometric columns: harmonics of one variable, and random Fourier features of several."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from pisplit.checks import count, positive, real_array
from pisplit.observables.columns import Columns, OneSided, Symbol, linear_form


@dataclass(frozen=True)
class Fourier(OneSided):
    """cos(j w v) and sin(j w v) of every variable v for j = 1 to ``order``, w = 2 pi / ``period`` [unit of v].

    ``period``: one number or one a variable. Harmonics of several variables are products: ``Fourier(2) * Fourier(2)``
    of different ``variables``.
    """

    order: int
    period: float | Sequence[float] = 2.0 * np.pi
    of: str = "states"
    variables: Sequence[str] | Sequence[int] | None = None

    def __post_init__(self) -> None:
        count(self.order, "order")
        for period in self.period if isinstance(self.period, Sequence) else (self.period,):
            positive(period, "period")

    def _write(self, v: Symbol, labels: tuple[str, ...], quantities: tuple[str, ...]) -> Columns:
        w = 2.0 * np.pi / per_variable(self.period, "period", len(labels))
        waves = [(i, j * w[i]) for i in range(len(labels)) for j in range(1, self.order + 1)]
        names = [f"{wave}({linear_form([k], [labels[i]])})" for i, k in waves for wave in ("cos", "sin")]
        values = ca.vertcat(*[wave(k * v[i]) for i, k in waves for wave in (ca.cos, ca.sin)])
        return Columns(values, tuple(names), ("fourier",) * len(names))


@dataclass(frozen=True)
class RandomFourier(OneSided):
    """sqrt(2/size) cos(w_j . v + b_j), j = 1 to ``size``: w_j normal with deviation 1 / ``width``, b_j uniform.

    Inner products of these columns approach the Gaussian kernel exp(-|v - v'|^2 / (2 width^2)). ``width``: one number
    or one a variable [unit of v]. An equal ``seed`` gives equal columns.

    Source: Rahimi and Recht, Random features for large-scale kernel machines (2007).
    """

    size: int
    width: float | Sequence[float] = 1.0
    seed: int = 0
    of: str = "states"
    variables: Sequence[str] | Sequence[int] | None = None

    def __post_init__(self) -> None:
        count(self.size, "size")
        count(self.seed, "seed", minimum=0)
        for width in self.width if isinstance(self.width, Sequence) else (self.width,):
            positive(width, "width")

    def _write(self, v: Symbol, labels: tuple[str, ...], quantities: tuple[str, ...]) -> Columns:
        rng = np.random.default_rng(self.seed)
        w = rng.standard_normal((self.size, len(labels))) / per_variable(self.width, "width", len(labels))
        b = rng.uniform(0.0, 2.0 * np.pi, self.size)
        values = np.sqrt(2.0 / self.size) * ca.cos(ca.mtimes(ca.DM(w), v) + b)
        names = tuple(f"rff{self.seed}[{j + 1}]" for j in range(self.size))
        return Columns(values, names, ("fourier",) * self.size)


def per_variable(value: float | Sequence[float], name: str, size: int) -> np.ndarray:
    """One number ``value`` for all variables, or one for each (size,); errors call it ``name``."""
    numbers = np.atleast_1d(real_array(value, name))
    if numbers.shape not in ((1,), (size,)):
        raise ValueError(f"{name} has {numbers.size} entries; expected one, or {size}, one a variable")
    return np.broadcast_to(numbers, (size,))
