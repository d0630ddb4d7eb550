"""Energy accounts: stored energies in closed form, work and dissipation that close the balance."""

import numpy as np
import pytest

from pisplit.models import rod
from pisplit.models.arm.tendon_arm import TendonArm

BODY = rod.Rod(0.5, rod.Circle(4e-3), rod.Elastic(2e7, 7e6, 1100.0), "planar")


def test_stored_energies_of_a_rod_in_a_circle() -> None:
    """Curvature 1/R everywhere: EI L / (2 R^2); height of a circular arc; a straight rod that starts to bend."""
    scene = rod.Scene(BODY, rod.Gravity((0.0, 0.0, -9.81)), nodes=8)
    n, length = scene.n_strains, BODY.length
    bent = np.concatenate([np.full(n, 2.0), np.zeros(n)])
    found = scene.energies(bent[None, :])
    assert found.elastic[0] == pytest.approx(0.5 * BODY.stiffness[1] * 4.0 * length, rel=1e-12)
    height = (1.0 - np.cos(2.0 * length)) / 4.0  # int sin(2 s) / 2 ds
    assert found.gravity[0] == pytest.approx(BODY.mass_per_length * 9.81 * height, rel=1e-9)
    assert found.kinetic[0] == 0.0
    rate = np.concatenate([np.zeros(n), np.ones(n)])  # angle s, deflection s^2/2
    translation = 0.5 * BODY.mass_per_length * length**5 / 20.0
    rotation = 0.5 * BODY.inertia_per_length[1] * length**3 / 3.0
    assert scene.energies(rate[None, :]).kinetic[0] == pytest.approx(translation + rotation, rel=1e-9)


def test_weights_of_masses_and_medium_are_potential() -> None:
    """An upright rod: mass at the tip adds m g L, the medium takes its share."""
    gravity = rod.Gravity((0.0, 0.0, -9.81))
    scene = rod.Scene(BODY, gravity, rod.PointMass(0.5, 0.1), rod.Buoyancy(500.0))
    found = scene.energies(np.zeros((1, scene.n_states))).gravity[0]
    line = 0.5 * 0.5**2 * 9.81 * (BODY.mass_per_length - 500.0 * BODY.section.area)
    assert found == pytest.approx(0.1 * 9.81 * 0.5 + line, rel=1e-12)


@pytest.mark.parametrize("scheme", ["idas", "gauss"])
def test_work_and_dissipation_close_the_balance(scheme: str) -> None:
    scene = rod.Scene(
        BODY,
        rod.Gravity((-9.81, 0.0, 1.5)),
        rod.KelvinVoigt(bending=1e-4),
        rod.QuadraticDrag(5e-2),
        rod.TipWrench(force=rod.Input("f", 3)),
        rod.PointMass(0.4, 0.01),
        nodes=4,
    )
    t = 0.02 * np.arange(1, 26)[:, None]
    u = np.hstack([0.08 * np.sin(9.0 * t), np.zeros_like(t), -0.02 * t])
    moving = scene.simulator(0.02, rtol=1e-7) if scheme == "idas" else scene.stepper(0.02, step=2e-3)
    trajectory = moving.run(u, energy=True)
    energy = trajectory.energy()
    assert set(energy.work) == {"TipWrench"}
    assert energy.t.shape == energy.dissipated.shape == energy.imbalance.shape == (26,)
    assert np.all(np.diff(energy.dissipated) > 0.0)
    assert np.abs(energy.imbalance).max() <= 1e-5 * np.ptp(energy.work["TipWrench"])


def test_energy_of_the_arm_in_three_dimensions() -> None:
    """With the variational equations the account of the spatial arm closes with tendons, drag and damping too."""
    scene = TendonArm.paper(nodes=3).scene.variational()
    t = 0.03 * np.arange(1, 11)[:, None]
    u = 1e-3 + 4e-3 * np.sin(3.0 * t) * np.cos(np.array([0.0, 2.1, 4.2]))
    trajectory = scene.stepper(0.03, step=1e-3).run(
        u, scene.statics().solve([1e-3] * 3).state, energy=True, check=False
    )
    energy = trajectory.energy()
    assert list(energy.work) == ["Tendons"]
    assert energy.dissipated[-1] > 0.0
    assert np.abs(energy.imbalance).max() <= 1e-4 * np.abs(energy.work["Tendons"]).max()


def test_the_work_is_integrated_on_request_only() -> None:
    scene = rod.Scene(BODY, rod.KelvinVoigt(bending=1e-4), nodes=2)
    with pytest.raises(ValueError, match="energy=True"):
        scene.stepper(0.01).run(np.zeros((1, 0)), check=False).energy()
    with pytest.raises(ValueError, match="resting base"):
        (scene + rod.Base(velocity=rod.Input("v", 3))).energies(np.zeros((1, scene.n_states + 3)))
