"""Dynamics: order of the time integration, static limit, ramps, restarts, stepping, and what a failure looks like."""

import casadi as ca
import numpy as np
import pytest

from pisplit.models import rod
from pisplit.models.arm.tendon_arm import TendonArm
from pisplit.models.rod.dynamics import integrator
from pisplit.models.rod.dynamics.integrator import STARTS

ARM = TendonArm.paper(nodes=4)
LENGTH = ARM.scene.rod.length


def commands(steps: int) -> np.ndarray:
    """Smooth displacements (steps, 3) of about 8 mm with a common pull of 1 mm."""
    t = 0.03 * np.arange(1, steps + 1)[:, None]
    return 1e-3 + 8e-3 * np.sin(3.0 * t) * np.cos(np.array([0.0, 2.1, 4.2]) + 2.0 * t)


def rest() -> np.ndarray:
    return ARM.scene.statics().solve(ARM.rest_inputs).state


def tips(states: np.ndarray, scene: rod.Scene = ARM.scene) -> np.ndarray:
    return scene.fields(states, [LENGTH])[:, 0, :3]


@pytest.fixture(scope="module")
def moving() -> np.ndarray:
    """A state in the middle of a motion."""
    state: np.ndarray = ARM.scene.simulator(0.03, rtol=1e-5).run(commands(9), rest(), check=False).x[-1]
    return state


def test_the_error_falls_with_the_tolerance() -> None:
    """Maximum tip error over ten steps against rtol 1e-9: each hundredth of rtol gives a tenth of the error or less."""
    u, start = commands(10), rest()
    fine = tips(ARM.scene.simulator(0.03, rtol=1e-9).run(u, start, check=False).x)
    errors = [
        np.abs(tips(ARM.scene.simulator(0.03, rtol=rtol).run(u, start, check=False).x) - fine).max() / LENGTH
        for rtol in (1e-3, 1e-5, 1e-7)
    ]
    assert errors[1] < errors[0] / 10.0 and errors[2] < errors[1] / 10.0
    assert errors[2] < 1e-6


def test_damped_motion_ends_in_the_static_equilibrium() -> None:
    """Tip within 1e-7 L; strong damping, one minute."""
    scene = ARM.scene.replace(rod.KelvinVoigt(bending=2e-2, torsion=2e-2)) + rod.LinearDrag(0.1)
    pulls = np.array([0.008, -0.003, -0.002])
    trajectory = scene.simulator(5.0, rtol=1e-7).run(
        np.tile(pulls, (12, 1)), scene.statics().solve([1e-3] * 3).state, check=False
    )
    assert trajectory.success
    assert np.abs(tips(trajectory.x[-1:], scene)[0] - scene.statics().solve(pulls).tip).max() <= 1e-7 * LENGTH


def test_an_equilibrium_stays_where_it_is() -> None:
    start = ARM.scene.statics().solve([0.006, -0.002, -0.003]).state
    trajectory = ARM.scene.simulator(0.03).run(np.tile(start[-3:], (20, 1)), start, check=False)
    assert np.abs(tips(trajectory.x) - tips(start[None, :])).max() <= 1e-8 * LENGTH


def test_stepping_agrees_with_one_run() -> None:
    u = commands(8)
    simulator = ARM.scene.simulator(0.03, rtol=1e-7)
    whole = simulator.run(u, rest(), check=False)
    first = simulator.reset(ARM.rest_inputs)
    measured = [first]
    for row in u:
        step = simulator.step(row)
        assert step.ok and step.message == ""
        measured.append(step.state)
    fields = np.array(measured).reshape(9, 6, 24)
    assert simulator.n_states == 144 and simulator.n_inputs == 3
    assert np.abs(fields[:, -1, :3] - tips(whole.x)).max() <= 1e-5 * LENGTH
    assert simulator.state[-3:] == pytest.approx(u[-1])


def test_run_may_be_cut_in_two() -> None:
    u = commands(8)
    simulator = ARM.scene.simulator(0.03, rtol=1e-7)
    whole = simulator.run(u, rest(), check=False)
    head = simulator.run(u[:5], rest(), check=False)
    tail = simulator.run(u[5:], head.x[-1], check=False)
    assert np.abs(tips(tail.x) - tips(whole.x[5:])).max() <= 1e-5 * LENGTH
    assert whole.t == pytest.approx(0.03 * np.arange(9))


@pytest.mark.parametrize("kept", STARTS)
def test_every_start_of_the_integrator_leads_to_the_same_motion(
    kept: tuple[float, float, bool], moving: np.ndarray, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As the states are given, with carried rates, and corrected by ``calc_ic``."""
    u = np.stack([moving[-3:] + 1e-3, moving[-3:] + 2e-3])
    usual = tips(ARM.scene.simulator(0.03, rtol=1e-7).run(u, moving, check=False).x)
    monkeypatch.setattr(integrator, "STARTS", (kept,))
    alone = ARM.scene.simulator(0.03, rtol=1e-7).run(u, moving, check=False)
    assert alone.success
    assert tips(alone.x) == pytest.approx(usual, abs=1e-5 * LENGTH)


@pytest.mark.parametrize("rtol", [1e-3, 1e-5, 1e-8])
@pytest.mark.parametrize("size", [1e-3, 1.0])
def test_a_rod_released_from_a_strange_shape_starts(rtol: float, size: float) -> None:
    """A moment that jumps to zero at the tip is against the boundary condition: first accelerations of 1e7 to 1e9."""
    start = rest()
    start[: ARM.scene.n_strains] += size * np.tile([1.0, -0.5, 0.2], ARM.scene.nodes)
    assert ARM.scene.simulator(0.05, rtol=rtol).run(np.tile(ARM.rest_inputs, (2, 1)), start, check=False).success


def test_a_start_that_fails_gives_way_to_the_next(moving: np.ndarray, monkeypatch: pytest.MonkeyPatch) -> None:
    simulator = ARM.scene.simulator(0.03, rtol=1e-6)
    u = moving[-3:] + 1e-3
    usual = simulator.run(u[None, :], moving, check=False)
    build, asked = simulator._integrator, []

    def only_corrected(steps: int, correct: bool, energy: bool, level: int) -> ca.Function:
        asked.append(correct)
        if not correct:
            x, z, p = ca.MX.sym("x"), ca.MX.sym("z"), ca.MX.sym("p")
            stuck = {"x": x, "z": z, "p": p, "ode": z, "alg": z * z + 1.0}  # has no consistent start at all
            return ca.integrator("stuck", "idas", stuck, 0.0, 1.0, {"disable_internal_warnings": True})
        return build(steps, correct, energy, level)

    monkeypatch.setattr(simulator, "_integrator", only_corrected)
    fallen_back = simulator.run(u[None, :], moving, check=False)
    assert fallen_back.success and True in asked and False in asked
    assert tips(fallen_back.x) == pytest.approx(tips(usual.x), abs=1e-4 * LENGTH)


def test_a_jump_of_an_input_starts_three_times_as_fast_as_its_ramp() -> None:
    """From rest, a constant load gives a t^2 / 2 and a ramp of the same end a t^2 / 6 (undamped, short times)."""
    scene = rod.Scene(
        rod.Rod(0.5, rod.Circle(1e-3), rod.Elastic(207e9, 8e10, 8000.0), "planar"),
        rod.TipWrench(force=rod.Input("f", 3)),
        nodes=2,
    )
    n = scene.n_strains
    bend = [
        scene.simulator(1e-5, rtol=1e-9, inputs=inputs)
        .run([[1e3, 0.0, 0.0]], np.zeros(scene.n_states), check=False)
        .x[-1][:n]
        for inputs in ("step", "ramp")
    ]
    assert bend[0] == pytest.approx(3.0 * bend[1], rel=2e-2)


def test_inputs_that_jump_reach_the_same_rest() -> None:
    scene = ARM.scene.replace(rod.KelvinVoigt(bending=2e-2, torsion=2e-2)) + rod.LinearDrag(0.1)
    u = np.tile([0.005, -0.002, -0.001], (10, 1))
    trajectory = scene.simulator(5.0, rtol=1e-6, inputs="step").run(
        u, scene.statics().solve([1e-3] * 3).state, check=False
    )
    assert trajectory.success
    assert np.abs(tips(trajectory.x[-1:], scene)[0] - scene.statics().solve(u[0]).tip).max() <= 1e-5 * LENGTH


def shaken() -> tuple[rod.Scene, np.ndarray]:
    """A rod and commands of which the third, a million newtons in 30 ms, is beyond IDAS."""
    scene = rod.Scene(
        rod.Rod(LENGTH, ARM.scene.rod.section, ARM.scene.rod.material, "planar"),
        rod.KelvinVoigt(bending=5e-4),
        rod.TipWrench(force=rod.Input("f", 3)),
        nodes=3,
    )
    return scene, np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [1e6, 0.0, 0.0], [0.0, 0.0, 0.0]])


def test_a_trajectory_that_cannot_be_finished_ends_at_its_last_good_step() -> None:
    scene, u = shaken()
    trajectory = scene.simulator(0.03).run(u, check=False)
    assert not trajectory.success
    assert "step 2" in trajectory.message and "\n" not in trajectory.message
    assert trajectory.t.shape == (3,) and trajectory.x.shape == (3, scene.n_states) and trajectory.u.shape == (2, 3)
    assert np.isfinite(trajectory.x).all()
    good = scene.simulator(0.03).run(u[:2], check=False)
    assert trajectory.x == pytest.approx(good.x, rel=1e-2, abs=1e-2)


def test_a_failed_step_leaves_the_plant_where_it_was() -> None:
    scene, u = shaken()
    simulator = scene.simulator(0.03)
    simulator.reset()
    before = simulator.step(u[1])
    failed = simulator.step(u[2])
    assert before.ok and not failed.ok and "IDAS" in failed.message
    assert np.array_equal(failed.state, before.state)
    assert simulator.step(u[1]).ok


def test_arguments_are_not_changed() -> None:
    u, start = commands(3), rest()
    copies = u.copy(), start.copy()
    ARM.scene.simulator(0.03).run(u, start, check=False)
    assert np.array_equal(u, copies[0]) and np.array_equal(start, copies[1])


def test_linear_dynamics_predict_small_motions() -> None:
    """expm of the linearisation about an equilibrium against IDAS, free vibration of 0.1 % of the strains."""
    from scipy.linalg import expm

    start = ARM.scene.statics().solve([0.004, 0.001, -0.001]).state
    n = ARM.scene.n_strains
    linear = ARM.scene.linearise(start)
    shift = np.zeros(2 * n)
    shift[:n] = 1e-3 * np.tile([1.0, -0.5, 0.2], ARM.scene.nodes)
    disturbed = start.copy()
    disturbed[: 2 * n] += shift
    end = ARM.scene.simulator(0.05, rtol=1e-8).run(np.tile(start[-3:], (4, 1)), disturbed, check=False).x[-1]
    expected = expm(0.2 * linear.A) @ shift
    assert np.abs(end[:n] - start[:n] - expected[:n]).max() <= 2e-2 * np.abs(shift).max()


def test_a_run_that_is_bound_to_fail_spends_its_steps_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """One call over all intervals, one over the interval that takes too many steps; no other start is tried there."""
    monkeypatch.setattr(integrator, "MAX_STEPS", 3)
    monkeypatch.setattr(integrator, "MAX_STEPS_TOGETHER", 3)
    simulator = ARM.scene.simulator(0.03)
    build, asked = simulator._integrator, []

    def counted(steps: int, correct: bool, energy: bool, level: int) -> ca.Function:
        asked.append(steps)
        return build(steps, correct, energy, level)

    monkeypatch.setattr(simulator, "_integrator", counted)
    failed = simulator.run(commands(5), rest(), check=False)
    assert not failed.success and "IDA_TOO_MUCH_WORK" in failed.message
    assert asked == [5, 1] and len(failed.t) == 1


def test_natural_rates_are_those_of_the_linear_modes() -> None:
    """Lowest modes of a straight rod: bending (Euler-Bernoulli), torsion and stretch (quarter waves), within 1 %."""
    body = rod.Rod(0.5, rod.Circle(1e-3), rod.Elastic(2e11, 8e10, 8000.0), "cosserat")
    scene = rod.Scene(body, nodes=6)
    found = 2.0 * np.pi * scene.modes(scene.statics().solve().state).frequency
    for rate in (body.natural_rates[k] for k in (0, 2, 5)):
        assert np.abs(found / rate - 1.0).min() < 0.01


@pytest.mark.parametrize("pluck", [1e-4, 1e-3, 1e-2, 1e-1])
def test_a_plucked_rod_rings_down_alike_whatever_the_size(pluck: float) -> None:
    """Five periods at 2 % damping: IDAS stays within 2 % of the pluck of fine Gauss steps, also where it is tiny."""
    body = rod.Rod(0.5, rod.Circle(0.01), rod.Elastic(1e6, 1e6 / 3, 1000.0), strains="planar")
    rate, stiffness = body.bending_rate, body.stiffness[0]
    damping = rod.KelvinVoigt(bending=2.0 * 0.02 * stiffness / rate)
    scene = rod.Scene(body, damping, rod.TipWrench(force=rod.Input("f", 3)))
    held = scene.statics().solve([pluck * 3.0 * stiffness / 0.25, 0.0, 0.0])
    start = np.concatenate([held.state[:-3], np.zeros(3)])
    still, dt = np.zeros((100, 3)), 0.1 * np.pi / rate
    fine = scene.stepper(dt, step=dt / 10.0).run(still, start, check=False).x
    found = scene.simulator(dt).run(still, start, check=False).x
    ends = [scene.fields(x, [0.5])[:, 0, 0] for x in (fine, found)]
    assert np.abs(ends[0][80:]).max() > 0.3 * held.tip[0]
    assert np.abs(ends[1] - ends[0]).max() <= 2e-2 * held.tip[0]


def test_absolute_tolerances_follow_small_motions_and_leave_typical_ones_alone() -> None:
    start, simulator = rest(), ARM.scene.simulator(0.03)
    assert simulator._level(start, commands(20)) == 0
    for size in (1e-1, 1e-2, 1e-3):
        small = ARM.rest_inputs + size * (commands(20) - ARM.rest_inputs)
        assert abs(simulator._level(start, small) - 2.0 * np.log10(size)) <= 2.0
    assert simulator._level(start, np.tile(ARM.rest_inputs, (20, 1))) == 0
