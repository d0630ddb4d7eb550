"""Scenes as control systems: f and h from the terms, the motion that of the simulator."""

from __future__ import annotations

import numpy as np
import pytest

from pisplit import Dictionary, Episodes, LinearEDMDc, PhaseSamples
from pisplit import observables as ob
from pisplit.models import rod, systems
from pisplit.models.arm.tendon_arm import TendonArm
from pisplit.models.rod_system import rod_system

ARM = TendonArm.paper(nodes=3)
PULL = np.array([6e-3, 0.0, 1e-3])


def bent() -> tuple[np.ndarray, np.ndarray]:
    """Strains and rates away from rest."""
    n, rng = ARM.scene.n_strains, np.random.default_rng(0)
    rest = ARM.scene.statics().solve(ARM.rest_inputs).state[:n]
    strains = rest + 0.02 * ARM.scene.nominal_strains * rng.normal(size=n)
    return strains, 0.02 * ARM.scene.nominal_strains * ARM.scene.rod.bending_rate * rng.normal(size=n)


def test_the_parts_are_those_of_the_scene_and_add_up() -> None:
    system = systems.tendon_arm(nodes=3)
    n = ARM.scene.n_strains
    xi, rates = bent()
    x = np.concatenate([xi, rates])
    f, h = (np.asarray(part(x, PULL)).ravel() for part in (system.known, system.unknown))
    np.testing.assert_array_equal(f[:n], rates)
    assert not h[:n].any()
    passive = np.asarray(ARM.passive.acceleration(xi, rates, np.empty(0))).ravel()
    np.testing.assert_allclose(f[n:], passive, rtol=1e-12)
    full = np.asarray(ARM.scene.acceleration(xi, rates, PULL)).ravel()
    np.testing.assert_allclose(f[n:] + h[n:], full, rtol=1e-9, atol=1e-9 * np.abs(full).max())
    np.testing.assert_array_equal(system.known(x, PULL), system.known(x, 0 * PULL))  # f does not know the tendons
    assert system.state_names[0] == "w1[1]" and system.state_units[0] == "1/m" and system.state_units[n] == "1/(m s)"
    assert system.input_names == ARM.scene.input_names and system.input_units == ("m",) * 3


def test_a_step_is_that_of_the_simulator() -> None:
    system, dt = systems.tendon_arm(nodes=3), 0.02
    xi, rates = bent()
    x = np.concatenate([xi, rates])
    inputs = np.stack([PULL, 0.5 * PULL])
    found = system.simulate(x, inputs, dt, method="idas")
    size = np.abs(found[:, : len(xi)]).max(), np.abs(found[:, len(xi) :]).max()
    for rtol, bound in ((1e-7, 1e-4), (1e-9, 4e-6)):  # the simulator closes in on it
        truth = ARM.scene.simulator(dt=dt, rtol=rtol, inputs="step").run(
            u=inputs, x0=np.concatenate([x, inputs[0]]), check=False
        )
        assert truth.success
        assert np.abs((found - truth.x[:, : len(x)]) / np.repeat(size, len(xi))).max() <= bound


def test_equilibria_of_the_statics_are_those_of_the_system() -> None:
    system = systems.tendon_arm(nodes=3)
    at = ARM.scene.statics().solve(PULL).state
    rate = np.asarray(system.rhs(at[: system.n_states], PULL)).ravel()
    scale = np.abs(np.asarray(system.known(at[: system.n_states], PULL))).max()
    assert np.abs(rate).max() <= 1e-8 * scale


def test_the_system_serves_identification() -> None:
    system = systems.tendon_arm(nodes=2)
    rng, n = np.random.default_rng(1), system.n_states
    u = 1e-3 + 4e-3 * rng.uniform(size=(25, 3))
    rest = TendonArm.paper(2).scene.statics().solve(u[0]).state[:n]
    d1 = Episodes(
        [system.simulate(rest, u, 0.03, method="idas")],
        [u],
        0.03,
        state_names=system.state_names,
        input_names=system.input_names,
    )
    theta = Dictionary(ob.Constant(), ob.Identity(), n_states=n, n_inputs=3)
    assert LinearEDMDc(theta, alpha=1e-6).fit(d1).score(d1).diverged_fraction == 0.0
    d2 = PhaseSamples.from_system(system, d1.xs[0], np.zeros((26, 3)))
    assert d2.xdot.shape == (26, n) and np.isfinite(d2.xdot).all()


def test_inputs_of_other_terms_stay_known_and_a_scene_without_actuators_is_refused() -> None:
    pushed = ARM.scene + rod.TipWrench(force=rod.Input("push", 3))
    system = rod_system(pushed)
    xi, rates = bent()
    x, push = np.concatenate([xi, rates]), np.array([0.0, 0.01, 0.0])
    u = np.array([*PULL, *push]) if pushed.input_names[0].startswith("tendons") else np.array([*push, *PULL])
    passive = np.asarray((ARM.passive + rod.TipWrench(force=rod.Input("push", 3))).acceleration(xi, rates, push))
    np.testing.assert_allclose(np.asarray(system.known(x, u))[len(xi) :], passive, rtol=1e-12)
    with pytest.raises(ValueError, match="has no Tendons"):
        rod_system(ARM.passive)
