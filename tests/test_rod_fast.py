"""Large Radau steps as one call: their order, what they leave to smaller ones, and what they say of their error."""

from __future__ import annotations

import pickle
from functools import cache

import numpy as np
import pytest

from pisplit.checks import Array
from pisplit.models import rod
from pisplit.models.arm import TendonArm, random_displacements
from pisplit.models.rod.dynamics.collocation import radau
from pisplit.models.rod.dynamics.fast import FastStepper

DT = 0.03


@cache
def arm(name: str = "paper") -> TendonArm:
    return {"paper": TendonArm.paper, "prototype": TendonArm.prototype}[name](nodes=4)


def rest(of: TendonArm) -> Array:
    return of.scene.statics().solve(of.rest_inputs).state


def usual(of: TendonArm, steps: int = 40, seed: int = 0) -> Array:
    return random_displacements(of, steps, np.random.default_rng(seed))


def harsh(of: TendonArm, steps: int = 6) -> Array:
    """New commands of +-10 mm at every step."""
    moves = np.random.default_rng(1).uniform(-1e-2, 1e-2, (steps, 3))
    return moves - moves.mean(axis=1, keepdims=True) + of.pretension


def tips(scene: rod.Scene, x: Array) -> Array:
    """Positions (T+1, 6, 3) along the rod in parts of its length."""
    return scene.fields(x, 6)[:, :, :3] / scene.rod.length


@pytest.mark.parametrize("name", ["paper", "prototype"])
def test_usual_commands_are_followed_within_the_accuracy(name: str) -> None:
    of, u = arm(name), usual(arm(name))
    exact = of.scene.simulator(DT, rtol=1e-8).run(u, rest(of), check=False)
    found = of.scene.fast_stepper(DT).run(u, rest(of), check=False)
    assert found.success and found.step_errors is not None
    assert np.abs(tips(of.scene, found.x) - tips(of.scene, exact.x)).max() < 1e-4
    named = sum(found.fallbacks.values(), ())
    assert len(named) <= 1 and len(u) <= found.stats["nsteps"] <= len(u) + 8 * len(named)


def test_the_error_of_a_step_is_what_the_step_is_off_by() -> None:
    of, u = arm(), usual(arm(), 24)
    plant = of.scene.fast_stepper(DT)
    found = plant.run(u, rest(of), check=False)
    exact = of.scene.simulator(DT, rtol=1e-9)
    errors = []
    for k, command in enumerate(u):
        true = exact.run(command[None, :], found.x[k], check=False).x[1:]
        errors.append(np.linalg.norm(tips(of.scene, found.x[k + 1 : k + 2]) - tips(of.scene, true), axis=2).max())
    length = of.scene.rod.length
    assert found.step_errors is not None
    worst = int(np.argmax(found.step_errors))
    assert found.step_errors[worst] == pytest.approx(length * errors[worst], rel=0.3)
    larger = np.array(errors) > 1e-6
    ratio = found.step_errors[larger] / (length * np.array(errors)[larger])
    assert larger.sum() > 5 and 0.3 < np.median(ratio) < 3.0 and ratio.min() > 0.1


@pytest.mark.parametrize(("stages", "order"), [(2, 3), (3, 5)])
def test_errors_fall_with_the_order_of_the_scheme(stages: int, order: int) -> None:
    scene = rod.Scene(
        rod.Rod(length=0.3, section=rod.Circle(5e-3), material=rod.Elastic(5e6, 2e6, 1.1e3), strains="planar"),
        rod.KelvinVoigt(bending=1e-4),
        rod.PointWrench(s=0.3, force=rod.Input("f", 3)),
        nodes=3,
    )
    start = scene.statics().solve(np.array([0.05, 0.0, 0.0])).state
    still = np.zeros((4, 3))  # let go over the first step

    def end(step: float) -> Array:
        return scene.fast_stepper(0.05, step=step, stages=stages).run(still, start, check=False).x[-1, :3]

    exact = scene.stepper(0.05, step=5e-4, stages=3, tolerance=1e-13).run(still, start, check=False).x[-1, :3]
    coarse, fine = (np.abs(end(step) - exact).max() for step in (0.0125, 0.00625))
    assert np.log2(coarse / fine) == pytest.approx(order, abs=0.7)


def test_small_steps_are_those_of_the_stepper() -> None:
    of, u = arm(), np.tile(arm().rest_inputs + 1e-4, (10, 1))
    fast = of.scene.fast_stepper(2e-3).run(u, rest(of), check=False)
    slow = of.scene.stepper(2e-3, step=2e-3, stages=3).run(fast.u, rest(of), check=False)
    scale = np.abs(slow.x[:, : of.scene.n_strains]).max()
    np.testing.assert_allclose(fast.x[:, : of.scene.n_strains], slow.x[:, : of.scene.n_strains], atol=1e-7 * scale)


def test_calls_of_any_length_take_the_same_steps() -> None:
    of, u = arm(), usual(arm(), 23)
    plant = of.scene.fast_stepper(DT)
    whole = plant.run(u, rest(of), check=False)
    plant.reset(x0=rest(of))
    singles = []
    for command in u:
        assert plant.step(command).ok
        singles.append(plant.state)
    np.testing.assert_allclose(singles, whole.x[1:], rtol=1e-9, atol=1e-9)


def test_a_call_ends_with_the_first_interval_that_does_not_pass_and_goes_on_behind_it() -> None:
    of = arm()
    u = np.vstack([usual(of, 8), harsh(of, 1), usual(of, 40)])
    plant = of.scene.fast_stepper(DT)
    whole = plant.run(u, rest(of), check=False)
    assert 8 in whole.fallbacks["halved"]
    cut = max(whole.fallbacks["halved"]) + 1
    assert cut < len(u)
    first = plant.run(u[:cut], rest(of), check=False)
    second = plant.run(u[cut:], first.x[-1], check=False)
    np.testing.assert_allclose(np.vstack([first.x, second.x[1:]]), whole.x, rtol=1e-12, atol=1e-12)


def test_no_piece_is_longer_than_the_step_that_was_asked_for() -> None:
    of = arm()
    u = harsh(of, 2)
    found = of.scene.fast_stepper(DT, step=DT / 3).run(u, rest(of), check=False)
    assert found.fallbacks["halved"] == (0, 1) and found.stats["nsteps"] >= 2 * 4
    exact = of.scene.simulator(DT, rtol=1e-7).run(u, rest(of), check=False)
    assert np.abs(tips(of.scene, found.x) - tips(of.scene, exact.x)).max() < 3e-4


def test_rough_commands_are_finished_and_named() -> None:
    of = arm()
    u = np.vstack([usual(of, 5), harsh(of)])
    exact = of.scene.simulator(DT, rtol=1e-7).run(u, rest(of), check=False)
    found = of.scene.fast_stepper(DT).run(u, rest(of), check=False)
    assert found.success, found.message
    assert np.abs(tips(of.scene, found.x) - tips(of.scene, exact.x)).max() < 5e-4
    named = sorted(sum(found.fallbacks.values(), ()))
    assert named == list(range(5, 5 + len(harsh(of)))) and found.stats["halved"] + found.stats["idas"] == len(named)


def test_a_motion_that_nothing_follows_ends_with_its_step() -> None:
    scene = rod.Scene(
        rod.Rod(length=0.3, section=rod.Circle(1e-3), material=rod.Elastic(1e9, 4e8, 1e3)),
        rod.KelvinVoigt(bending=1e-5, torsion=1e-5),
        rod.PointWrench(s=0.3, force=rod.Input("f", 3)),
        nodes=3,
    )
    u = np.zeros((5, 3))
    u[3:, 0] = 1e9
    found = scene.fast_stepper(DT).run(u, check=False)
    assert not found.success and len(found.u) == 3
    assert "gave up in step 3 at t = 0.09 s" in found.message and "IDAS" in found.message
    assert np.isfinite(found.x).all()


def test_it_can_be_copied_and_goes_on_from_a_snapshot() -> None:
    of, u = arm(), usual(arm(), 6)
    plant = of.scene.fast_stepper(DT)
    plant.reset(of.rest_inputs)
    plant.step(u[0])
    kept, expected = plant.snapshot(), [plant.step(c).state for c in u[1:]]
    again: FastStepper = pickle.loads(pickle.dumps(plant))
    again.restore(kept)
    np.testing.assert_array_equal([again.step(c).state for c in u[1:]], expected)


def test_the_work_of_the_terms_is_integrated_in_small_steps() -> None:
    of, u = arm(), usual(arm(), 6)
    found = of.scene.fast_stepper(DT).run(u, rest(of), energy=True, check=False)
    assert np.abs(found.energy().imbalance).max() < 1e-2 * np.abs(found.work).max()


def test_nodes_and_matrices_are_those_of_the_book() -> None:
    root = np.sqrt(6.0)
    c, a = radau(2)
    np.testing.assert_allclose(c, [1.0 / 3.0, 1.0], atol=1e-12)
    np.testing.assert_allclose(a, [[5.0 / 12.0, -1.0 / 12.0], [3.0 / 4.0, 1.0 / 4.0]], atol=1e-12)
    c, a = radau(3)
    np.testing.assert_allclose(c, [(4.0 - root) / 10.0, (4.0 + root) / 10.0, 1.0], atol=1e-12)
    np.testing.assert_allclose(a[-1], [(16.0 - root) / 36.0, (16.0 + root) / 36.0, 1.0 / 9.0], atol=1e-12)


def test_what_is_too_fast_for_a_step_is_damped() -> None:
    for stages in (2, 3):
        _, a = radau(stages)
        growth = 1.0 - a[-1] @ np.linalg.solve(a, np.ones(stages))  # of x' = lambda x for lambda -> -infinity
        assert abs(growth) < 1e-12


def test_derivatives_of_a_step_are_those_of_the_pieces_it_is_taken_in() -> None:
    plant = arm().scene.fast_stepper(dt=DT)
    plant.reset(arm().rest_inputs)
    q, u = plant.scene.layout.n_moving, arm().rest_inputs + 2e-3 * np.array([1.0, -0.3, -0.7])
    x = plant.state

    def after(command: Array) -> Array:
        rows, stats = plant.integrate(x, command[None])
        assert stats["halved"] == 1  # the motion is too fast for one piece
        return rows[0]

    found, way = plant.sensitivity(x, u), np.array([1.0, -0.5, -0.5])
    np.testing.assert_array_equal(found.x[:q], after(u))
    slope = (after(u + 1e-7 * way) - after(u - 1e-7 * way)) / 2e-7
    np.testing.assert_allclose(found.d_input[:q] @ way, slope, atol=2e-4 * np.abs(slope).max())
