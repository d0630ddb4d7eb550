"""Kinks with their corner rounded, as CasADi expressions."""

from __future__ import annotations

from typing import TypeVar

import casadi as ca

Symbol = TypeVar("Symbol", ca.SX, ca.MX)


def softplus(x: Symbol, width: float) -> Symbol:
    """max(0, x) with its corner rounded: width log(1 + exp(x / width)), written so that it never overflows.

    Args:
        x: expression of any shape.
        width: positive, in the unit of x; at x = 0 the value is 0.69 of it, from 10 widths on it is below 5e-5 of it.
    """
    return width * ca.log1p(ca.exp(-ca.fabs(x) / width)) + ca.fmax(x, 0.0)
