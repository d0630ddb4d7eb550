"""Newton corrections of large steps: blocks for the whole matrix, and as many corrections as are needed."""

import casadi as ca
import numpy as np
import pytest

from pisplit.models.arm import TendonArm
from pisplit.models.rod.dynamics.collocation import Collocation
from pisplit.models.rod.dynamics.simplified import AT, ENOUGH, SimplifiedNewton

H = 0.03


def moved(scheme: Collocation) -> list[np.ndarray]:
    """The arm as it swings, and its inputs at the start and at the end of a step."""
    arm, scene = TendonArm.paper(3), scheme.equations
    u = np.array([0.002, -0.001, -0.001])
    found = arm.scene.fast_stepper(H).run(np.outer(np.linspace(0.1, 1.0, 10), u), check=False)
    return [found.x[-1][: 2 * scene.n_strains], u, 1.1 * u]


@pytest.mark.parametrize("stages", [2, 3])
def test_blocks_invert_the_whole_matrix(stages: int) -> None:
    scene = TendonArm.paper(3).scene
    scheme = Collocation(scene, stages, "radau")
    newton, (x, u0, u1, h, _), n = SimplifiedNewton(scheme), scheme.symbols, scene.n_strains
    values = ca.MX.sym("values", n, stages)
    applied = ca.Function("applied", [x, u0, u1, h, values], [newton.applied(newton.inverses(x, u0, u1, h), values)])
    state, before, command = moved(scheme)
    given = np.random.default_rng(1).standard_normal((n, stages))
    found = np.asarray(applied(state, before, command, H, given))
    ahead, inputs = state[:n] + AT * H * state[n:], (1.0 - AT) * before + AT * command
    blocks = scene.motion_residual.jacobian()(ahead, state[n:], np.zeros(n), inputs, np.zeros(n))[:3]
    by_stage = [[np.asarray(ca.densify(b))] * stages for b in blocks]
    matrix = scheme.iteration_matrix([*by_stage, []], H)
    np.testing.assert_allclose(matrix @ found.T.ravel(), given.T.ravel(), atol=1e-9)


def test_corrections_end_where_they_are_small_enough() -> None:
    """What is left of an easy step is below the line after fewer corrections than of a hard one."""
    scheme = Collocation(TendonArm.paper(3).scene, 3, "radau")
    newton, (x, u0, u1, h, z), n = SimplifiedNewton(scheme), scheme.symbols, scheme.equations.n_strains
    inverses = newton.inverses(x, u0, u1, h)
    made = {
        most: ca.Function("z", [x, u0, u1, h, z], list(newton.converged(x, u0, u1, h, z, inverses, most)))
        for most in ((2, 2), (2, 6), (20, 20))
    }
    nominal, (state, before, _) = scheme.equations.nominal_strains, moved(scheme)
    needed = []
    for factor in (1.1, 2.0, 4.0):  # from a command that goes on as before to one that jumps
        point = [state, before, factor * before, H, np.zeros((n, 3))]
        few, right, exact = (np.asarray(made[key](*point)[0]) for key in made)
        left = H**2 * np.linalg.norm((right - exact) / nominal[:, None])
        assert left < 5.0 * ENOUGH
        needed.append(not np.array_equal(few, right))
    assert needed == sorted(needed) and needed[-1] and not needed[0], needed
