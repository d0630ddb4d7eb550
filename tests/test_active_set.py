"""DAQP as solver of the MPC's programs: the same answers as OSQP at small tolerance, to more digits."""

from __future__ import annotations

import copy
import sys

import numpy as np
import pytest

pytest.importorskip("daqp", reason="the optional solver daqp is not installed")

from pisplit import Dictionary, Episodes, LinearEDMDc
from pisplit import observables as ob
from pisplit.controllers import MPC, QPSettings
from pisplit.controllers.mpc.active_set import ActiveSetQP
from pisplit.controllers.mpc.qp import QP
from pisplit.lifted.model import LiftedModel

DAQP = QPSettings(solver="daqp", eps=1e-9)
TIGHT = QPSettings(eps=1e-10, max_iterations=100_000, first_max_iterations=100_000)


def model() -> LiftedModel:
    rng = np.random.default_rng(2)
    A = np.array([[0.96, 0.25], [-0.25, 0.96]]) * 0.99
    B = np.array([[0.02, 0.0], [0.1, 0.05]])
    x, u = [np.zeros(2)], rng.uniform(-1.0, 1.0, (300, 2))
    for v in u:
        x.append(A @ x[-1] + B @ v)
    data = Episodes([np.array(x)], [u], 0.05, outputs={"tip": (0,)})
    return LinearEDMDc(Dictionary(ob.Identity(), n_states=2, n_inputs=2), 1e-12).fit(data).lifted


def test_random_programs_satisfy_the_optimality_conditions() -> None:
    rng = np.random.default_rng(0)
    for _ in range(30):
        n, k = 12, 30
        root, A = rng.standard_normal((n, n)), rng.standard_normal((k, n))
        P, q = root @ root.T + 0.01 * np.eye(n), 10.0 * rng.standard_normal(n)
        lower, upper = -rng.uniform(0.1, 1.0, k), rng.uniform(0.1, 1.0, k)
        program = ActiveSetQP(P, A, DAQP)
        found = program.solve(q, lower, upper)
        assert found.status == "solved" and found.x is not None and found.primal_residual < 1e-8
        y = program.multipliers
        np.testing.assert_allclose(P @ found.x + q + A.T @ y, 0.0, atol=1e-8)
        slack = np.where(y > 0.0, upper - A @ found.x, A @ found.x - lower)
        np.testing.assert_allclose(slack[np.abs(y) > 1e-9], 0.0, atol=1e-7)
        other = QP(P, A, settings=TIGHT).solve(q, lower, upper)
        assert other.x is not None
        np.testing.assert_allclose(found.x, other.x, atol=1e-6)


@pytest.mark.parametrize("soft", [False, True], ids=["inputs limited", "outputs limited too"])
def test_a_loop_moves_as_with_osqp_at_a_small_tolerance(soft: bool) -> None:
    found, limit = model(), {"y_max": 0.25} if soft else {}
    loops = [MPC(found, 12, -1.0, 1.0, 0.3, rate_weight=1e-3, qp=qp, **limit) for qp in (DAQP, TIGHT)]
    x, wanted = np.zeros(2), 0.3 * np.sin(0.1 * np.arange(100))[:, None]
    for k in range(60):
        moves = [mpc.step(x, wanted[k + 1 : k + 13]) for mpc in loops]
        assert [m.status for m in moves] == ["solved", "solved"]
        np.testing.assert_allclose(moves[0].u, moves[1].u, atol=1e-5)
        x = found.step(x, moves[0].u)


def test_copies_and_states_go_on_to_the_last_bit() -> None:
    mpc = MPC(model(), 12, -1.0, 1.0, 0.3, rate_weight=1e-3, qp=DAQP)
    window = np.full((12, 1), 0.3)
    for k in range(5):
        mpc.step(np.array([0.02 * k, 0.0]), window)
    kept, other = mpc.snapshot(), copy.deepcopy(mpc)
    u = [mpc.step(np.array([0.1, 0.01 * k]), window).u for k in range(5)]
    np.testing.assert_array_equal([other.step(np.array([0.1, 0.01 * k]), window).u for k in range(5)], u)
    mpc.restore(kept)
    np.testing.assert_array_equal([mpc.step(np.array([0.1, 0.01 * k]), window).u for k in range(5)], u)


def test_what_has_no_solution_is_named() -> None:
    program = ActiveSetQP(np.eye(1), np.array([[1.0], [1.0]]), DAQP)
    found = program.solve(np.zeros(1), np.array([1.0, -2.0]), np.array([2.0, -1.0]))
    assert found.status == "primal infeasible" and found.x is None
    assert program.solve(np.array([np.nan]), -np.ones(2), np.ones(2)).status == "cost not finite"
    assert program.solve(np.zeros(1), np.ones(2), -np.ones(2)).status == "bounds crossed"
    with pytest.raises(ValueError, match="another problem"):
        ActiveSetQP(np.eye(2), np.eye(2), DAQP).restore(program.snapshot())


def test_a_solver_that_is_not_there_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "daqp", None)
    with pytest.raises(ValueError, match=r"pip install pisplit\[daqp\]"):
        QPSettings(solver="daqp")
    with pytest.raises(ValueError, match="solver = 'qpoases'; expected one of"):
        QPSettings(solver="qpoases")
