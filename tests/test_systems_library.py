"""Ready systems: invariants of their known parts, limit cycles, names and units."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pytest

from pisplit import Dictionary, Episodes, LinearEDMDc
from pisplit import observables as ob
from pisplit.models import ControlSystem, systems

RNG = np.random.default_rng(2)
EVERY = [systems.slow_manifold(), systems.duffing(), systems.van_der_pol(), systems.two_link_arm()]


@pytest.mark.parametrize("system", EVERY)
def test_parts_add_up_and_names_fit(system: ControlSystem) -> None:
    x, u = RNG.normal(size=system.n_states), RNG.normal(size=system.n_inputs)
    parts = np.array(system.known(x, u)) + np.array(system.unknown(x, u))
    np.testing.assert_allclose(np.array(system.rhs(x, u)), parts, atol=1e-13)
    np.testing.assert_array_equal(np.array(system.known(x, u)), np.array(system.known(x, 0 * u)))  # inputs are unknown
    assert len(system.state_names) == len(system.state_units) == system.n_states
    assert len(system.input_names) == len(system.input_units) == system.n_inputs


def test_the_limit_cycle_of_van_der_pol_has_amplitude_2_and_period_2_pi() -> None:
    dt = 2 * np.pi / 200
    x = systems.van_der_pol(mu=0.05).simulate([0.5, 0.0], np.zeros((200 * 80, 1)), dt)
    last = x[-400:, 0]
    assert last.max() == pytest.approx(2.0, abs=1e-2)
    np.testing.assert_allclose(last[:200], last[200:], atol=2e-2)


@pytest.mark.parametrize("method", ["rk4", "idas"])
def test_the_free_arm_keeps_its_kinetic_energy_and_angular_momentum(method: str) -> None:
    free = systems.two_link_arm(viscous=0.0, coulomb=0.0)
    x = free.simulate([0.3, 1.0, 2.0, -3.0], np.zeros((200, 2)), 0.01, method=method)
    q, w = ca.SX.sym("q", 2), ca.SX.sym("w", 2)
    inertia, _ = systems.two_link_inertia(q, w, (1.0, 0.8), (0.4, 0.3))
    energy = ca.Function("e", [q, w], [ca.vertcat(0.5 * ca.dot(w, ca.mtimes(inertia, w)), ca.mtimes(inertia, w)[0])])
    values = np.array([np.array(energy(row[:2], row[2:]))[:, 0] for row in x[::20]])
    np.testing.assert_allclose(values, np.tile(values[0], (len(values), 1)), rtol=1e-6)


def test_the_inertia_of_the_arm_is_that_of_rods() -> None:
    q, w = ca.SX.sym("q", 2), ca.SX.sym("w", 2)
    inertia = ca.Function("m", [q], [systems.two_link_inertia(q, w, (2.0, 3.0), (0.5, 0.7))[0]])
    straight = np.array(inertia([0.0, 0.0]))
    along = np.linspace(0, 1, 20001)
    middle = 0.5 * (along[1:] + along[:-1])
    whole = 2.0 * np.mean((0.5 * middle) ** 2) + 3.0 * np.mean((0.5 + 0.7 * middle) ** 2)
    assert straight[0, 0] == pytest.approx(whole, rel=1e-7)
    assert straight[1, 1] == pytest.approx(3.0 * np.mean((0.7 * middle) ** 2), rel=1e-7)
    np.testing.assert_array_equal(straight, straight.T)


def test_friction_takes_energy_and_torque_gives_it() -> None:
    arm = systems.two_link_arm()
    still = arm.simulate([0.3, 1.0, 2.0, -3.0], np.zeros((500, 2)), 0.01, substeps=4)
    assert np.abs(still[-1, 2:]).max() < 1e-2
    driven = arm.simulate(np.zeros(4), np.tile([0.5, 0.0], (100, 1)), 0.01, substeps=4)
    assert driven[-1, 2] > 0.5


def test_both_integrators_give_the_same_data_for_the_same_model() -> None:
    system, u = systems.van_der_pol(), RNG.normal(size=(150, 1))
    fits = []
    for method in ("rk4", "idas"):
        x = system.simulate([1.0, 0.0], u, 0.02, method=method)
        theta = Dictionary(ob.Constant(), ob.Identity(), n_states=2, n_inputs=1)
        fits.append(LinearEDMDc(theta).fit(Episodes([x], [u], 0.02)).K_)
    np.testing.assert_allclose(fits[0], fits[1], atol=1e-4)


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: systems.van_der_pol(mu=np.inf), "mu"),
        (lambda: systems.two_link_arm(masses=(1.0, 0.0)), "masses\\[1\\]"),
        (lambda: systems.two_link_arm(viscous=-1.0), "viscous"),
        (lambda: ControlSystem(ca.SX.sym("x"), ca.SX.sym("u"), 0, 0, state_units=("m", "s")), "state_units has 2"),
    ],
)
def test_bad_parameters_are_refused_in_one_line(build: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message) as error:
        build()
    assert "\n" not in str(error.value)
