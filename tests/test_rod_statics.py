"""Statics: order of the discretisation, fallbacks, batches, and what a failed search looks like."""

from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from pisplit.models import rod
from pisplit.models.arm.tendon_arm import TendonArm


def steel(length: float = 0.4, strains: str = "kirchhoff") -> rod.Rod:
    """A steel rod of 1 mm radius."""
    return rod.Rod(length, rod.Circle(1e-3), rod.Elastic(207e9, 207e9 / 2.6, 8000.0), strains)


def tip_error(nodes: int, strains: str) -> float:
    """Tip error in parts of L at F L^2 / EI = 10 against the elastica (Bisshopp & Drucker 1945)."""
    body = steel(strains=strains)
    force = 10.0 * body.stiffness[0] / body.length**2
    tip = rod.Scene(body, rod.TipWrench(force=(force, 0.0, 0.0)), nodes=nodes).statics().solve().tip
    exact = np.array([0.8106090248802965, 0.0, 0.4450044022462487])
    return float(np.linalg.norm(tip / body.length - exact))


def test_elastica_at_eight_nodes_to_five_millionths_of_the_length() -> None:
    assert tip_error(8, "kirchhoff") <= 5e-6
    assert tip_error(6, "kirchhoff") <= 1e-5


def test_plane_rods_converge_spectrally() -> None:
    """The angle of a plane rod is integrated exactly."""
    plane = [tip_error(k, "planar") for k in (4, 6, 8, 10)]
    assert all(fine < coarse / 20.0 for coarse, fine in pairwise(plane))


def bend(nodes: int) -> rod.Scene:
    """The 45-degree bend of K. J. Bathe and S. Bolourchi (1979): radius 100, EI = EA / 12 = 1e7 / 12, tip load 600."""
    stiff = rod.Elastic(young=1e7, shear=5e6, density=1.0)
    square = rod.GeneralSection(area=1.0, second_moments=(1 / 12, 1 / 12), torsion_constant=0.1406)
    body = rod.Rod(100.0 * np.pi / 4, square, stiff, rest_curvature=(0.0, 0.01, 0.0))
    return rod.Scene(body, rod.TipWrench(force=(0.0, 600.0, 0.0)), nodes=nodes)


def helix(nodes: int) -> rod.Scene:
    """A force and a moment that turn with the tip twist the rod and bend it about an axis that turns."""
    body = rod.Rod(1.0, rod.Circle(0.01), rod.Elastic(young=1e6, shear=4e5, density=1000.0))
    unit = body.stiffness[0]
    wrench = rod.TipWrench((3.0 * unit, unit, -2.0 * unit), (0.0, 2.0 * unit, 3.0 * unit), follower=True)
    return rod.Scene(body, wrench, nodes=nodes)


def test_a_bend_converges_with_order_six() -> None:
    """Frames bound a rod whose axis of bending turns: of sixth order from six nodes on, of fourth below."""

    def shape(nodes: int) -> np.ndarray:
        scene = bend(nodes)
        found = scene.statics().solve()
        assert found.success
        return scene.fields(found.state, 21)[:, :3] / scene.rod.length

    finest = shape(16)
    errors = [float(np.linalg.norm(shape(k) - finest, axis=1).max()) for k in (5, 8, 12)]
    assert errors[2] <= 2e-8 and np.log(errors[1] / errors[2]) / np.log(12 / 8) >= 6.0
    assert errors[0] >= 10.0 * errors[1]


def helix_by_integration(s: np.ndarray) -> np.ndarray:
    """Positions (S, 3) of ``helix``: in body axes force and moment follow from those at the tip alone.

    n' = n x w, m' = m x w + n x e3, w = m / (EI, EI, GJ), and frames and positions with them.
    """
    body, unit = helix(2).rod, helix(2).rod.stiffness[0]

    def slopes(_: float, y: np.ndarray) -> np.ndarray:
        n, m, frame = y[:3], y[3:6], y[6:15].reshape(3, 3)
        w = m / body.stiffness[:3]
        spin = np.array([[0.0, -w[2], w[1]], [w[2], 0.0, -w[0]], [-w[1], w[0], 0.0]])
        return np.concatenate(
            [np.cross(n, w), np.cross(m, w) + np.cross(n, [0.0, 0.0, 1.0]), (frame @ spin).ravel(), frame[:, 2]]
        )

    tip = np.concatenate([unit * np.array([3.0, 1.0, -2.0, 0.0, 2.0, 3.0]), np.eye(3).ravel(), np.zeros(3)])
    found = solve_ivp(slopes, (1.0, 0.0), tip, "DOP853", dense_output=True, rtol=3e-14, atol=1e-15)
    base = found.sol(0.0)
    return (found.sol(s)[15:].T - base[15:]) @ base[6:15].reshape(3, 3)


def test_a_helix_converges_to_what_integration_from_its_tip_gives() -> None:
    """1e-8 L on 16 nodes; errors fall at least as the sixth power of the nodes."""
    s, nodes = np.arange(1, 21) / 20, (5, 8, 12, 16)
    true, errors = helix_by_integration(s), []
    for k in nodes:
        scene = helix(k)
        strains = scene.statics().search.find(np.zeros(0), np.zeros(scene.n_strains), False)[0]
        state = scene.at_rest(scene.statics().search.strains(strains), np.zeros(0))
        errors.append(float(np.linalg.norm(scene.fields(state, s)[:, :3] - true, axis=1).max()))
    assert errors[-1] < 3e-9
    for k in range(3):
        assert np.log(errors[k] / errors[k + 1]) / np.log(nodes[k + 1] / nodes[k]) >= 6.0


def test_every_random_tip_load_up_to_a_hundred_is_solved() -> None:
    """Tip forces of F L^2 / EI = 10 and 100: followed from nothing where roots are many."""
    body = steel()
    statics = rod.Scene(body, rod.TipWrench(force=rod.Input("f", 3)), nodes=6).statics()
    directions = np.random.default_rng(0).standard_normal((10, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    for size in (10.0, 100.0):
        for direction in directions:
            equilibrium = statics.solve(size * body.stiffness[0] / body.length**2 * direction)
            assert equilibrium.success
            assert equilibrium.residual <= 1e-8


def test_equilibrium_is_found_again_from_its_own_state() -> None:
    scene = TendonArm.paper().scene
    first = scene.statics().solve([0.01, -0.005, -0.005])
    second = scene.statics().solve([0.01, -0.005, -0.005], guess=first.state)
    assert second.state == pytest.approx(first.state, abs=1e-9)
    assert np.all(first.state[scene.n_strains : 2 * scene.n_strains] == 0.0)
    assert first.strains == pytest.approx(first.state[: scene.n_strains])


def test_a_batch_gives_what_single_solves_give() -> None:
    scene = TendonArm.paper().scene
    inputs = np.random.default_rng(1).uniform(-0.01, 0.01, (90, 3))
    batch = scene.statics().solve_many(inputs, chunk=40)
    assert batch.success.all()
    assert batch.states.shape == (90, scene.n_states)
    for k in (0, 41, 89):
        single = scene.statics().solve(inputs[k])
        assert batch.states[k] == pytest.approx(single.state, abs=1e-8)
        assert batch.tensions[k] == pytest.approx(single.tensions, rel=1e-6, abs=1e-8)


def bent_beyond_its_tendon() -> rod.Scene:
    """A rod with tendons driven by tension: one tendon alone has no equilibrium above EI / r^2 = 143 N (w r = 1)."""
    drive = rod.Tendons.parallel(15.06e-3, (0, 120, 240), rod.Tension())
    return rod.Scene(TendonArm.paper().scene.rod, drive)


def test_a_load_without_equilibrium_is_flagged_not_raised() -> None:
    equilibrium = bent_beyond_its_tendon().statics().solve([1000.0, 0.0, 0.0])
    assert not equilibrium.success
    assert equilibrium.solver == "path" and equilibrium.branch == "unverified"
    assert equilibrium.load_factor == pytest.approx(0.143, rel=0.2)
    assert equilibrium.residual > 1.0
    assert np.isfinite(equilibrium.state).all()
    assert "no rest behind" in equilibrium.message and "\n" not in equilibrium.message


def test_one_bad_row_spoils_no_other() -> None:
    statics = bent_beyond_its_tendon().statics()
    inputs = np.zeros((20, 3))
    inputs[:, 0] = np.linspace(0.0, 20.0, 20)
    inputs[7] = [1000.0, 0.0, 0.0]
    batch = statics.solve_many(inputs)
    assert np.flatnonzero(~batch.success).tolist() == [7]
    assert np.isfinite(batch.states).all()
    assert batch.states[8] == pytest.approx(statics.solve(inputs[8]).state, abs=1e-8)


def test_tension_moves_no_rod_beyond_its_stiffness() -> None:
    """Up to that tension the curvature is w = tau r / EI."""
    scene = bent_beyond_its_tendon()
    for tension in (10.0, 140.0):
        strains = scene.statics().solve([tension, 0.0, 0.0]).strains.reshape(-1, 3)
        assert strains[:, 1] == pytest.approx(tension * 15.06e-3 / scene.rod.stiffness[1], rel=1e-9)


def test_the_first_example_of_the_design_runs_as_written() -> None:
    arm = rod.Scene(
        rod.Rod(
            length=0.7144,
            section=rod.Circle(radius=0.675e-3),
            material=rod.Elastic(young=207e9, shear=207e9 / 2.6, density=33249.0),
            strains="kirchhoff",
        ),
        rod.Gravity((-9.81, 0.0, 0.0)),
        rod.KelvinVoigt(bending=5e-4, torsion=5e-4),
        rod.QuadraticDrag(1e-4),
        rod.Tendons.parallel(offset=15.06e-3, angles_deg=(0, 120, 240), drive=rod.Displacement(compliance=1e-4)),
    )
    statics = arm.statics()
    eq = statics.solve(u=[0.010, -0.005, -0.005])
    assert eq.success and eq.residual <= 1e-8 and eq.iterations is None
    assert eq.tensions.shape == eq.slack.shape == (3,)
    assert np.all((eq.tensions > 0.2) == (eq.slack == 0.0))
    p, R = eq.pose(0.35)
    assert p.shape == (3,) and R.shape == (3, 3)
    U = np.random.default_rng(0).uniform(-0.01, 0.01, (12, 3))
    batch = statics.solve_many(U)
    assert batch.success.all()
    sim = arm.simulator(dt=0.03, rtol=3e-5)
    U = np.linspace([0.010, -0.005, -0.005], [0.0, 0.002, -0.002], 10)
    traj = sim.run(u=U, x0=eq.state, check=False)
    assert traj.success
    assert traj.t.shape == (11,) and traj.x.shape == (11, arm.n_states) and traj.u.shape == (10, 3)
    y = arm.fields(traj.x, stations=6)
    assert y.shape == (11, 6, 24)
    assert np.array_equal(y, traj.fields(6))


def test_loading_is_followed_where_rootfinders_end() -> None:
    """The paper's arm under a tip force of 100 EI/L^2 in a direction at which Newton's method ends."""
    direction = np.random.default_rng(13).standard_normal(3)
    arm = TendonArm.paper(nodes=4).scene
    force = 100.0 * arm.rod.stiffness[0] / arm.rod.length**2 * direction / np.linalg.norm(direction)
    found = (arm + rod.TipWrench(force=tuple(force.tolist()))).statics().solve()
    assert found.success and found.stable and found.solver == "path"


def test_an_equilibrium_is_one_to_rounding_whatever_the_solvers_hand_over(monkeypatch: pytest.MonkeyPatch) -> None:
    """Solvers that stop 1e-5 of a curvature away from w = tau r / EI are not believed: others go on to the root."""
    statics = bent_beyond_its_tendon().statics()
    search, u = statics.search, np.array([10.0, 0.0, 0.0])
    exact = 10.0 * 15.06e-3 / statics.scene.rod.stiffness[1]
    root = search.scaled(statics.solve(u).strains)
    near = root + 1e-5
    assert 1e-8 < search.worst(near, u) < 1e-3
    monkeypatch.setitem(vars(search), "_cold_kinsol", lambda x0, u: near)
    monkeypatch.setattr(search, "of_rows", lambda rows, chunks, mild: lambda x, u: np.tile(near[:, None], rows))
    found, batch = statics.solve(u), statics.solve_many([u])
    assert found.success and found.solver == "newton" and found.residual <= 1e-8
    assert batch.success.all() and batch.residual.max() <= 1e-8
    for state in (found.state, batch.states[0]):
        assert state[: statics.scene.n_strains].reshape(-1, 3)[:, 1] == pytest.approx(exact, rel=1e-8)


def test_an_answer_that_is_no_root_is_not_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    """Residuals of 1e-7 and of 1e-9 EI/L: the line between them is the tolerance."""
    statics = bent_beyond_its_tendon().statics()
    search, u = statics.search, np.array([10.0, 0.0, 0.0])
    root = search.scaled(statics.solve(u).strains)
    for away, good in ((1e-7, False), (1e-9, True)):
        near = root + away / search.worst(root + 1e-3, u) * 1e-3
        monkeypatch.setattr(search, "find", lambda u, x0, mild, near=near: (near, 1, "newton"))
        found = statics.solve(u)
        assert found.success and (found.solver == "newton") is good and found.residual <= 1e-8
        if good:
            assert found.residual == pytest.approx(away, rel=0.2)
