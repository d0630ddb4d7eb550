"""Small systems: the parts add up, and simulation has the order of its method."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest

from pisplit import Episodes, PhaseSamples
from pisplit.models import ControlSystem, systems

RNG = np.random.default_rng(6)


@pytest.mark.parametrize("system", [systems.slow_manifold(), systems.duffing()])
def test_known_and_unknown_parts_add_up(system: ControlSystem) -> None:
    x, u = RNG.normal(size=2), RNG.normal(size=1)
    parts = np.array(system.known(x, u)) + np.array(system.unknown(x, u))
    np.testing.assert_allclose(np.array(system.rhs(x, u)), parts, atol=1e-15)


def test_the_slow_manifold_has_its_closed_solution() -> None:
    mu, lam, t = -0.1, -1.0, np.linspace(0, 2, 41)
    states = systems.slow_manifold(mu, lam).simulate([0.3, 0.7], np.zeros((40, 1)), 0.05)
    b = lam / (lam - 2 * mu)  # x2 - b x1^2 is an eigenfunction with eigenvalue lam
    exact = np.column_stack([0.3 * np.exp(mu * t), b * 0.09 * np.exp(2 * mu * t) + (0.7 - b * 0.09) * np.exp(lam * t)])
    np.testing.assert_allclose(states, exact, atol=1e-7)


def test_runge_kutta_is_of_fourth_order_and_agrees_with_idas() -> None:
    system, u = systems.duffing(), np.sin(np.arange(20.0))[:, None]
    fine = system.simulate([1.2, 0.0], u, 0.2, substeps=64)
    errors = [np.abs(system.simulate([1.2, 0.0], u, 0.2, substeps=s) - fine).max() for s in (2, 4)]
    assert 3.5 < np.log2(errors[0] / errors[1]) < 4.5
    np.testing.assert_allclose(system.simulate([1.2, 0.0], u, 0.2, method="idas"), fine, atol=1e-6)


def test_the_known_flow_composes_to_a_trajectory_of_f() -> None:
    system, x = systems.duffing(), RNG.normal(size=(10, 2))
    twice = system.known_flow(system.known_flow(x, np.zeros((10, 1)), 0.1), np.zeros((10, 1)), 0.1)
    np.testing.assert_allclose(twice, system.known_flow(x, np.zeros((10, 1)), 0.2), atol=1e-6)
    np.testing.assert_allclose(system.known_flow(x, np.zeros((10, 1)), 0.2, method="idas"), twice, atol=1e-6)


def test_phase_samples_hold_f_and_its_half_flow() -> None:
    system, x, u = systems.duffing(), RNG.normal(size=(10, 2)), RNG.normal(size=(10, 1))
    samples = PhaseSamples.from_system(system, x, u, dt=0.1, flow=True)
    np.testing.assert_allclose(samples.xdot[3], np.array(system.known(x[3], u[3]))[:, 0])
    assert samples.x_half is not None and samples.state_names == ("x", "v")
    np.testing.assert_allclose(samples.x_half, system.known_flow(x, u, 0.05))
    with pytest.raises(ValueError, match="needs dt"):
        PhaseSamples.from_system(system, x, u, flow=True)


def test_symbols_may_be_of_either_kind() -> None:
    x, u = ca.MX.sym("x", 2), ca.MX.sym("u")
    system = ControlSystem(x, u, known=ca.vertcat(x[1], -x[0]), unknown=ca.vertcat(0, u))
    assert system.simulate([1.0, 0.0], np.zeros((5, 1)), 0.1).shape == (6, 2)


X, U = ca.SX.sym("x", 2), ca.SX.sym("u")


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: ControlSystem(X, U, known=X[0], unknown=X), "one entry a state"),
        (lambda: ControlSystem(X, U, known=X * ca.SX.sym("k"), unknown=X), "symbols other than"),
        (lambda: ControlSystem(X + 1, U, known=X, unknown=X), "column of CasADi symbols"),
        (lambda: ControlSystem(X, U, known=X, unknown=X, state_names=("a", "a")), "different names"),
        (lambda: systems.slow_manifold(mu=np.nan), "mu"),
        (lambda: systems.duffing().simulate([0.0], [[0.0]], 0.1), "x0"),
        (lambda: systems.duffing().simulate([0.0, 0.0], [[0.0]], 0.1, method="euler"), "method"),
        (lambda: systems.duffing().simulate([1e3, 0.0], np.zeros((9, 1)), 1.0), "not finite"),
    ],
)
def test_bad_systems_are_refused_in_one_line(build: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message) as error:
        build()
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("method", ["rk4", "idas"])
def test_simulated_episodes_carry_the_names_and_units_of_the_system(method: str) -> None:
    system, starts = systems.two_link_arm(), RNG.normal(size=(2, 4))
    inputs = [RNG.normal(size=(5, 2)), RNG.normal(size=(8, 2))]
    d1 = Episodes.from_system(system, starts, inputs, 0.01, method=method, substeps=2, outputs={"joints": (0, 1)})
    np.testing.assert_array_equal(d1.xs[1], system.simulate(starts[1], inputs[1], 0.01, method, 2))
    assert (d1.state_names, d1.input_names, d1.units) == (system.state_names, system.input_names, system.state_units)
    assert d1.outputs == {"joints": (0, 1)}
    with pytest.raises(ValueError, match="starts has shape"):
        Episodes.from_system(system, starts[:1], inputs, 0.01)


def test_the_example_of_the_guide_runs() -> None:
    guide = (Path(__file__).parent.parent / "docs" / "identification.md").read_text()
    code = guide.split("## Simulated systems", 1)[1].split("```python", 1)[1].split("```", 1)[0]
    made: dict[str, Any] = {}
    exec(compile(code, "identification.md", "exec"), made)
    assert made["d1"].state_names == made["d2"].state_names and made["d2"].x_half is not None
