"""Modes that the nodes do not resolve are marked, beside the frequencies of Euler and Bernoulli."""

import numpy as np

from pisplit.models import rod

#: Roots of cos x cosh x = -1.
ROOTS = np.array([1.87510407, 4.69409113, 7.85475744, 10.99554073])


def test_errors_of_frequencies_are_told_and_modes_marked() -> None:
    """Four nodes hold the first mode to 1e-3, the second to a hundredth, and the fourth not at all."""
    body = rod.Rod(0.5, rod.Circle(1e-3), rod.Elastic(2e11, 8e10, 8000.0), strains="planar")
    scene = rod.Scene(body, nodes=4)
    modes = scene.modes(np.zeros(scene.n_states))
    exact = ROOTS**2 * np.sqrt(body.stiffness[1] / body.mass_per_length) / 0.25 / (2.0 * np.pi)
    true = np.abs(modes.frequency / exact - 1.0)
    assert true[0] < 1e-3 < true[1] < 2e-2 and true[2] > 0.1
    assert modes.resolved.tolist() == [True, bool(modes.error[1] <= 1e-2), False, False]
    assert 0.7 < modes.error[1] / true[1] < 1.4 and modes.error[0] < 1e-3
    eight = rod.Scene(body, nodes=8).modes(np.zeros(16), 4)
    assert eight.resolved[:3].all() and np.abs(eight.frequency / exact - 1.0)[:3].max() < 1e-2


def test_pairs_of_a_round_rod_are_resolved_alike() -> None:
    """In space bending modes come in pairs, whose shapes are any in their plane."""
    body = rod.Rod(0.5, rod.Circle(1e-2), rod.Elastic(2e7, 8e6, 1000.0))
    modes = rod.Scene(body, nodes=5).modes(np.zeros(30), 4)
    assert modes.resolved[:4].tolist() == [True] * 4
    assert abs(modes.error[0] - modes.error[1]) < 1e-6
