"""Errors of a user's own function in a dictionary are the user's, from its first call; CasADi's are tried in MX."""

from __future__ import annotations

import pickle
from typing import Any

import casadi as ca
import numpy as np
import pytest

from pisplit import Dictionary
from pisplit import observables as ob


@pytest.mark.parametrize("kind", [RuntimeError, NotImplementedError, KeyError])
def test_an_own_error_is_raised_from_the_first_call(kind: type[Exception]) -> None:
    calls: list[Any] = []

    def columns(x: Any, u: Any) -> Any:
        calls.append(type(x))
        raise kind("gear two is missing")

    with pytest.raises(kind, match="gear two is missing"):
        Dictionary(ob.Identity(), ob.Expression(columns, name="own"), n_states=2, n_inputs=1)
    assert calls == [ca.SX]


def test_a_function_that_takes_no_scalars_is_written_in_matrices_and_travels() -> None:
    x = ca.MX.sym("x", 1)
    table = ca.interpolant("table", "linear", [[0.0, 1.0, 2.0]], [0.0, 1.0, 4.0])
    looked_up = ca.Function("looked_up", [x], [table(x)])
    theta = Dictionary(ob.Expression(lambda x, u: looked_up(x[0]), name="table"), n_states=2, n_inputs=1)
    again = pickle.loads(pickle.dumps(theta))
    for one in (theta, again):
        np.testing.assert_allclose(one.present(np.array([[1.5, 0.0]])), [[2.5]])


def test_what_casadi_cannot_write_is_one_line() -> None:
    with pytest.raises(ValueError, match="cannot be written in CasADi") as error:
        Dictionary(ob.Expression(lambda x, u: x + ca.vertcat(x, x), name="bad"), n_states=2, n_inputs=1)
    assert "\n" not in str(error.value)
