"""Natural modes against beam theory, and exact discretisation of the linear dynamics."""

import numpy as np
import pytest
from scipy.linalg import expm

from pisplit.models import rod
from pisplit.models.arm.tendon_arm import TendonArm

LENGTH, RADIUS = 0.5, 1e-3


def beam(strains: str, nodes: int, *terms: rod.KelvinVoigt) -> rod.Scene:
    return rod.Scene(rod.Rod(LENGTH, rod.Circle(RADIUS), rod.Elastic(2e11, 8e10, 8000.0), strains), *terms, nodes=nodes)


def test_bending_modes_of_a_clamped_free_beam() -> None:
    """beta L = 1.8751, 4.6941, 7.8548 (Euler-Bernoulli); the tip leads the shape."""
    scene = beam("planar", 10)
    found = scene.modes(np.zeros(scene.n_states), 3)
    body = scene.rod
    speed = np.sqrt(body.stiffness[1] / body.mass_per_length) / LENGTH**2
    exact = np.array([1.8751040687, 4.6940911330, 7.8547574382]) ** 2 * speed / (2.0 * np.pi)
    assert found.frequency == pytest.approx(exact, rel=2e-4)  # rotary inertia lowers them by (r / L)^2
    assert found.damping == pytest.approx(np.zeros(3), abs=1e-9)
    s = np.linspace(0.05, 1.0, 20)
    b = 1.8751040687
    sigma = (np.cosh(b) + np.cos(b)) / (np.sinh(b) + np.sin(b))
    shape = np.cosh(b * s) - np.cos(b * s) - sigma * (np.sinh(b * s) - np.sin(b * s))
    assert found.displacements(20)[0, :, 0].real == pytest.approx(shape / shape[-1], abs=1e-4)
    assert found.strains.shape == (3, scene.n_strains)


def test_torsion_and_stretch_modes() -> None:
    """Clamped-free waves: sqrt(G / rho) / 4 L and sqrt(E / rho) / 4 L."""
    scene = beam("cosserat", 5)
    state = scene.state(scene.rest_coordinates, np.zeros(scene.n_strains), np.zeros(0))
    frequencies = scene.modes(state).frequency
    for modulus in (8e10, 2e11):
        exact = np.sqrt(modulus / 8000.0) / (4.0 * LENGTH)
        assert np.abs(frequencies - exact).min() <= 1e-4 * exact


def test_damping_of_a_kelvin_voigt_beam() -> None:
    """Stress K w + B w_t gives every mode the ratio omega B / 2 K."""
    damper = 2e-4
    scene = beam("planar", 8, rod.KelvinVoigt(bending=damper))
    found = scene.modes(np.zeros(scene.n_states), 2)
    expected = 2.0 * np.pi * found.frequency * damper / (2.0 * scene.rod.stiffness[1])
    assert found.damping == pytest.approx(expected, rel=1e-6)


def test_a_discrete_step_under_ramps_is_exact() -> None:
    """e^(A dt), int e^(A t) B = A^-1 (e^(A dt) - 1) B for held inputs, A^-1 (that / dt - B) for a ramp."""
    scene = TendonArm.paper(nodes=3).scene
    linear = scene.linearise(scene.statics().solve([4e-3, 1e-3, -1e-3]).state)
    dt = 0.02
    found = linear.discretise(dt)
    flow = expm(dt * linear.A)
    held = np.linalg.solve(linear.A, (flow - np.eye(len(flow))) @ linear.B)
    ramp = np.linalg.solve(linear.A, held / dt - linear.B)
    assert np.abs(found.A - flow).max() <= 1e-6 * np.abs(flow).max()
    assert np.abs(found.B - ramp).max() <= 1e-6 * np.abs(ramp).max()
    assert np.abs(found.B + found.B_before - held).max() <= 1e-6 * np.abs(held).max()


def test_discrete_dynamics_are_those_of_the_stepper() -> None:
    """The sensitivities of a step at an equilibrium tend to the exact discretisation as the internal step falls."""
    scene = TendonArm.paper(nodes=3).scene
    start = scene.statics().solve([4e-3, 1e-3, 1e-3]).state
    n = scene.n_strains
    exact = scene.linearise(start).discretise(0.03)
    found = scene.stepper(0.03, step=1e-3).sensitivity(start, start[2 * n :])
    strains = slice(0, n)
    size = np.abs(exact.B[strains]).max()
    assert np.abs(found.d_input[strains] - exact.B[strains]).max() <= 1e-3 * size
    assert np.abs(found.d_state[strains, 2 * n :] - exact.B_before[strains]).max() <= 1e-3 * size
