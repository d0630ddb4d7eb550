"""One place says where what stands in a state."""

import casadi as ca
import numpy as np

from pisplit.models import rod

BODY = rod.Rod(length=0.4, section=rod.Circle(4e-3), material=rod.Elastic(4e6, 1.4e6, 1100.0))
SCENE = rod.Scene(BODY, rod.TipWrench(force=rod.Input("push", 3)), rod.Maxwell(0.2, 1.0), nodes=3)


def test_parts_of_a_state_are_those_it_was_made_of():
    """Stacked and split again: rows, one state, and columns of CasADi."""
    rng = np.random.default_rng(0)
    strains, rates, overstress, inputs = rows = [rng.standard_normal((5, k)) for k in (9, 9, 9, 3)]
    states = np.array([SCENE.state(x, v, u, s) for x, v, s, u in zip(*rows, strict=True)])
    assert states.shape == (5, SCENE.n_states) == (5, SCENE.layout.size)
    for made in (SCENE.layout.split(states), SCENE.layout.split(states.reshape(5, 1, -1))):
        assert all(np.array_equal(a.reshape(b.shape), b) for a, b in zip(made, rows, strict=True))
    columns = SCENE.layout.split(ca.DM(states[2]))
    assert all(np.array_equal(np.asarray(a).ravel(), b[2]) for a, b in zip(columns, rows, strict=True))
    of_motion = SCENE.layout.arguments(states)
    wanted = (strains, rates, np.hstack([overstress, inputs]))
    assert all(np.array_equal(a, b) for a, b in zip(of_motion, wanted, strict=True))
    assert np.array_equal(states[:, SCENE.layout.moving], np.hstack(rows[:3]))


def test_a_state_at_rest_has_strains_and_inputs_alone():
    """Of one shape and of many."""
    xi, u = np.arange(1.0, 19.0).reshape(2, 9), np.array([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]])
    rows = SCENE.at_rest(xi, u)
    for row, strains, inputs in zip(rows, xi, u, strict=True):
        assert np.array_equal(row, SCENE.at_rest(strains, inputs))
        assert np.array_equal(row, SCENE.state(strains, np.zeros(9), inputs))
