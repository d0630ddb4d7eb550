"""Whose error it is where a function that the user wrote is called with symbols: CasADi's or the function's own."""

from __future__ import annotations

import os

import casadi as ca

_CASADI = os.path.dirname(os.path.abspath(ca.__file__))


def is_of_casadi(error: BaseException) -> bool:
    """Whether ``error`` was raised inside CasADi: what cannot be written in SX may be in MX, an own error stays one."""
    place = error.__traceback__
    while place is not None and place.tb_next is not None:
        place = place.tb_next
    return place is not None and os.path.dirname(os.path.abspath(place.tb_frame.f_code.co_filename)) == _CASADI
