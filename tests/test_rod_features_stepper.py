"""Gauss stepping: energy of undamped rods, order, agreement with IDAS, sensitivities, and what a failure looks like."""

import numpy as np
import pytest

from pisplit.models import rod
from pisplit.models.arm.tendon_arm import TendonArm
from pisplit.models.rod.dynamics.trajectory import Trajectory

ARM = TendonArm.paper(nodes=4).scene


def soft(strains: str, nodes: int = 4) -> rod.Scene:
    """An undamped soft rod (E = 1 MPa, r = 1 cm) that sags under gravity."""
    body = rod.Rod(0.5, rod.Circle(1e-2), rod.Elastic(1e6, 1e6 / 3.0, 1100.0), strains)
    return rod.Scene(body, rod.Gravity((-9.81, 0.0, 1.5)), nodes=nodes)


def released(scene: rod.Scene) -> np.ndarray:
    """The scene under a tip force and a tip moment, before they are taken away."""
    side = 0.0 if scene.rod.strain_set.planar else 1.0
    size = scene.rod.stiffness[0] / scene.rod.length**2
    load = rod.TipWrench((0.3 * size, 0.8 * side * size, 0.1 * size), (0.0, 0.0, 0.02 * side * size))
    equilibrium = (scene + load).statics().solve()
    assert equilibrium.success
    return equilibrium.state


def commands(steps: int) -> np.ndarray:
    t = 0.03 * np.arange(1, steps + 1)[:, None]
    return 1e-3 + 8e-3 * np.sin(3.0 * t) * np.cos(np.array([0.0, 2.1, 4.2]) + 2.0 * t)


def drift(trajectory: Trajectory) -> tuple[float, float]:
    """Largest change of the energy and its trend (last against first tenth) in parts of the kinetic swing."""
    energies = trajectory.scene.energies(trajectory.x)
    total, tenth = energies.total, len(energies.total) // 10
    swing = np.ptp(energies.kinetic)
    trend = total[-tenth:].mean() - total[:tenth].mean()
    return float(np.abs(total - total[0]).max() / swing), float(abs(trend) / swing)


def test_an_undamped_plane_rod_keeps_its_energy_for_ten_seconds() -> None:
    scene = soft("planar")
    trajectory = scene.stepper(0.02, step=2e-3).run(np.zeros((500, 0)), released(scene), check=False)
    assert trajectory.success and trajectory.stats["halvings"] == 0
    most, trend = drift(trajectory)
    assert most <= 1e-6
    assert trend <= 1e-7


@pytest.mark.parametrize("strains", ["kirchhoff", "cosserat"])
def test_an_undamped_spatial_rod_keeps_its_energy(strains: str) -> None:
    scene = soft(strains).variational()
    trajectory = scene.stepper(0.02, step=1e-3).run(np.zeros((25, 0)), released(scene), check=False)
    assert trajectory.success
    assert drift(trajectory)[0] <= 1e-6


def test_variational_equations_are_those_of_a_plane_rod() -> None:
    """The angle of a plane rod is integrated exactly: both balances agree to rounding."""
    scene = soft("planar")
    rng = np.random.default_rng(0)
    xi, xi_t = rng.standard_normal((2, scene.n_strains))
    usual, other = (np.asarray(s.acceleration(xi, xi_t, [])) for s in (scene, scene.variational()))
    assert other == pytest.approx(usual, rel=1e-8, abs=1e-6 * np.abs(usual).max())


def test_variational_equilibria_are_as_accurate_as_the_usual_ones() -> None:
    """Both tips of the arm on five nodes against ten nodes, 1e-5 L."""
    pulls = [8e-3, -3e-3, -2e-3]
    fine = TendonArm.paper(nodes=10).scene.statics().solve(pulls).tip
    coarse = TendonArm.paper(nodes=5).scene
    for scene in (coarse, coarse.variational()):
        assert np.linalg.norm(scene.statics().solve(pulls).tip - fine) <= 1e-5 * scene.rod.length


def test_variational_scenes_stay_variational() -> None:
    scene = ARM.variational()
    kinds = {s.balance_type for s in (scene + rod.LinearDrag(0.1), scene.without(rod.Gravity), scene.with_nodes(3))}
    assert kinds == {scene.balance_type} and scene != ARM
    with pytest.raises(ValueError, match="resting base"):
        (ARM + rod.Base(acceleration=rod.Input("shaker", 3))).variational()


@pytest.mark.parametrize(("stages", "order"), [(1, 2), (2, 4)])
def test_order(stages: int, order: int) -> None:
    """Error at the end of a damped plane swing under a ramped tip force, step against half the step."""
    body = rod.Rod(0.5, rod.Circle(1e-2), rod.Elastic(1e6, 1e6 / 3.0, 1100.0), "planar")
    scene = rod.Scene(body, rod.KelvinVoigt(bending=1e-4), rod.TipWrench(force=rod.Input("f", 3)), nodes=3)
    u = np.array([[0.0, 0.0, 0.0], [0.02, 0.0, 0.0], [0.0, 0.0, 0.01]])

    def end(step: float, stages: int) -> np.ndarray:
        x: np.ndarray = scene.stepper(0.08, step=step, stages=stages).run(u, check=False).x[-1]
        return x

    exact = end(2.5e-4, 3)
    coarse, fine = (np.abs(end(step, stages) - exact).max() for step in (8e-3 / order * 2, 4e-3 / order * 2))
    assert np.log2(coarse / fine) > order - 0.4


def test_gauss_and_idas_move_the_arm_alike() -> None:
    u, start = commands(8), ARM.statics().solve([1e-3] * 3).state
    idas = ARM.simulator(0.03, rtol=1e-8).run(u, start, check=False)
    gauss = ARM.stepper(0.03, step=1e-3).run(u, start, check=False)
    assert gauss.success
    tips = [ARM.fields(t.x, [ARM.rod.length])[:, 0, :3] for t in (idas, gauss)]
    assert np.abs(tips[1] - tips[0]).max() <= 1e-5 * ARM.rod.length


def test_stepping_agrees_with_one_run() -> None:
    u = commands(3)
    stepper = ARM.stepper(0.03, step=5e-3)
    whole = stepper.run(u, ARM.statics().solve([1e-3] * 3).state, check=False)
    stepper.reset([1e-3] * 3)
    for row in u:
        step = stepper.step(row)
        assert step.ok
    assert stepper.state == pytest.approx(whole.x[-1], rel=1e-6, abs=1e-6)
    assert step.state == pytest.approx(ARM.fields(whole.x[-1]).ravel(), rel=1e-5, abs=1e-5)


def test_a_motion_beyond_the_scheme_ends_with_a_status() -> None:
    body = rod.Rod(0.7, rod.Circle(1e-3), rod.Elastic(207e9, 8e10, 8000.0), "planar")
    scene = rod.Scene(body, rod.TipWrench(force=rod.Input("f", 3)), nodes=3)
    trajectory = scene.stepper(0.03).run(np.array([[0.0, 0, 0], [1e15, 0, 0]]), np.zeros(scene.n_states), check=False)
    assert not trajectory.success and "Gauss gave up in step 1" in trajectory.message
    assert len(trajectory.x) == 2 and np.isfinite(trajectory.x).all()


def test_bad_settings_raise() -> None:
    for options in ({"step": 0.0}, {"stages": 4}, {"tolerance": -1.0}):
        with pytest.raises(ValueError, match="Stepper"):
            ARM.stepper(0.03, **options)


@pytest.mark.parametrize("kind", ["damped", "variational"])
def test_sensitivities_are_the_derivatives_of_the_step(kind: str) -> None:
    """Against central differences of the step, 1e-5 of the largest entry in each group of rows and columns."""
    scene = ARM if kind == "damped" else ARM.without(rod.KelvinVoigt).with_nodes(3)
    stepper = scene.stepper(0.01, step=2.5e-3, tolerance=1e-12)
    start = scene.statics().solve([4e-3, -1e-3, 0.0]).state
    x = stepper.run(np.array([[6e-3, -3e-3, 1e-3]]), start, check=False).x[-1]
    u = np.array([7e-3, -2e-3, 1e-3])
    found = stepper.sensitivity(x, u)
    n, m = scene.n_strains, scene.n_inputs
    assert found.x == pytest.approx(stepper.run(u[None, :], x, check=False).x[-1], rel=1e-9, abs=1e-9)
    exact = np.hstack([found.d_state, found.d_input])
    sizes = np.concatenate([np.full(n, 1e-4), np.full(n, 1e-2), np.full(2 * m, 1e-6)])
    rows = {"strain": slice(0, n), "rate": slice(n, 2 * n)}
    for start_column, stop in ((0, n), (n, 2 * n), (2 * n, 2 * n + m), (2 * n + m, 2 * n + 2 * m)):
        columns = []
        for k in range(start_column, stop, max(1, (stop - start_column) // 3)):
            ends = []
            for sign in (1.0, -1.0):
                both = np.concatenate([x, u])
                both[k] += sign * sizes[k]
                ends.append(stepper.run(both[None, -m:], both[:-m], check=False).x[-1])
            difference = (ends[0] - ends[1]) / (2.0 * sizes[k])
            columns.append((k, difference))
        for part in rows.values():
            scale = max(np.abs(d[part]).max() for _, d in columns)
            for k, difference in columns:
                assert np.abs(exact[part, k] - difference[part]).max() <= 1e-5 * scale
    assert np.array_equal(found.d_input[2 * n :], np.eye(m))


def test_idas_keeps_the_energy_of_an_undamped_spatial_rod_too() -> None:
    """Variational equations by default: 1e-3 of the swing in 0.3 s at rtol 1e-5, where the usual ones gain a tenth."""
    scene = soft("kirchhoff", nodes=5)
    start = released(scene.variational())
    trajectory = scene.simulator(0.03, rtol=1e-5).run(np.zeros((10, 0)), start, check=False)
    assert trajectory.scene == scene.variational()
    energies = scene.variational().energies(trajectory.x)
    assert np.ptp(energies.total) <= 1e-3 * np.ptp(energies.kinetic)


def test_equations_of_motion_are_chosen_by_the_damping_of_the_material() -> None:
    scene = soft("kirchhoff")
    stiffness, rate = np.array(scene.rod.stiffness), scene.rod.bending_rate
    enough = 2.1e-3 * stiffness / rate  # a little more than a thousandth of critical
    damped = scene + rod.KelvinVoigt(bending=enough[0], torsion=enough[2])
    slow = scene + rod.Retardation(2.1e-3 / rate)
    for kept in (damped, slow, soft("planar"), scene.variational()):
        assert kept.simulator(0.03).equations is kept
    loose = [rod.KelvinVoigt(bending=enough[0]), rod.Retardation(1e-3 / rate), rod.LinearDrag(10.0)]
    for moved in (scene, *(scene + term for term in loose)):
        assert moved.stepper(0.03).equations == moved.variational()
        assert moved.simulator(0.03, balance="direct").equations is moved
    assert damped.stepper(0.03, balance="variational").equations == damped.variational()
    with pytest.raises(ValueError, match="balance"):
        scene.simulator(0.03, balance="usual")


def test_usual_equations_of_an_undamped_rod_stray() -> None:
    """What the choice is for: a rod released from a tip load, 0.2 s, four nodes against six."""
    body = rod.Rod(0.5, rod.Circle(1e-2), rod.Elastic(1e7, 1e7 / 3.0, 1100.0))

    def tips(nodes: int, balance: str) -> np.ndarray:
        scene = rod.Scene(body, rod.Gravity((-9.81, 0.0, 1.5)), rod.LinearDrag(0.35), nodes=nodes)
        run = scene.stepper(0.02, step=2e-3, balance=balance).run(np.zeros((10, 0)), released(scene), check=False)
        assert run.success
        return run.fields(1)[:, 0, :3]

    fine = tips(6, "variational")
    travel = np.linalg.norm(fine - fine[0], axis=1).max()
    assert np.linalg.norm(tips(4, "variational") - fine, axis=1).max() <= 1e-2 * travel
    assert np.linalg.norm(tips(4, "direct") - fine, axis=1).max() >= 4e-2 * travel


@pytest.mark.parametrize("scheme", ["idas", "gauss"])
def test_counters_are_there_when_the_first_step_fails(scheme: str) -> None:
    scene = soft("planar")
    moving = scene.simulator(0.03) if scheme == "idas" else scene.stepper(0.03)
    start = np.concatenate([np.full(scene.n_strains, 1e8), np.full(scene.n_strains, 1e12)])
    failed, good = moving.run(np.zeros((2, 0)), start), moving.run(np.zeros((2, 0)))
    assert not failed.success and len(failed.t) == 1 and good.success
    assert set(failed.stats) == set(good.stats) and not any(failed.stats.values())


def test_idas_says_where_derivatives_of_a_step_come_from() -> None:
    with pytest.raises(NotImplementedError, match="stepper"):
        ARM.simulator(0.03).sensitivity(np.zeros(ARM.n_states), np.zeros(3))
