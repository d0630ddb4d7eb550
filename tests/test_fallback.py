"""Without a solution: the shifted plan, the steady target, a hold, a slow return to rest; each inside the limits."""

from __future__ import annotations

import pickle
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.optimize

from pisplit import BilinearEDMDc, Dictionary, Episodes, LinearEDMDc
from pisplit import observables as ob
from pisplit.checks import Array
from pisplit.controllers import MPC, ClosedLoop, LoopLog, PlantStep, QPSettings, plants, references
from pisplit.controllers.mpc.fallback import HOLD, PLAN, REST, TARGET, Fallback
from pisplit.controllers.mpc.limits import input_limits
from pisplit.controllers.mpc.steady import SteadyTarget
from pisplit.lifted.model import LiftedModel

A = np.array([[0.9, 0.2, 0.0], [-0.2, 0.85, 0.1], [0.0, 0.0, 0.6]])
B = np.array([[0.0, 0.1], [0.5, 0.0], [0.2, 0.4]])
N = np.zeros((2, 3, 3))
N[0, 1, 0], N[1, 2, 2] = -0.1, 0.15
LIMITS = input_limits([-0.4, -0.3], [0.4, 0.5], 0.05, 2)
H = 6


class Arm:
    """x+ = A x + B u (+ sum_i u_i N_i x)."""

    dt, n_inputs, n_states = 0.1, 2, 3

    def __init__(self, bilinear: float = 0.0) -> None:
        self.bilinear = bilinear

    def reset(self, u0: Array | None = None) -> Array:
        self.x = np.zeros(3)
        return self.x

    def step(self, u: Array) -> PlantStep:
        self.x = (A + self.bilinear * np.tensordot(u, N, 1)) @ self.x + B @ u
        return PlantStep(self.x)

    def snapshot(self) -> Array:
        return self.x.copy()

    def restore(self, x: Array) -> None:
        self.x = x.copy()


def model(bilinear: bool = False, constant: bool = False) -> LiftedModel:
    rng, plant, xs, us = np.random.default_rng(0), Arm(float(bilinear)), [], []
    for _ in range(4):
        u = rng.uniform(-1.0, 1.0, (60, 2))
        xs.append(np.array([plant.reset(), *(plant.step(v).state for v in u)]))
        us.append(u)
    parts: list[Any] = [ob.Constant()] if constant or bilinear else []
    parts += [ob.Identity(), *([ob.Bilinear()] if bilinear else [])]
    theta = Dictionary(*parts, n_states=3, n_inputs=2)
    kind = BilinearEDMDc if bilinear else LinearEDMDc
    return kind(theta, 1e-12).fit(Episodes(xs, us, 0.1, outputs={"tip": (0, 1)})).lifted


def target(found: LiftedModel) -> SteadyTarget:
    return SteadyTarget(found, found.C[:2], found.d[:2], LIMITS, np.ones(2), np.array([0.5, 2.0]))


def rest(bilinear: bool, u: Array, w: Array) -> Array:
    """Outputs at rest of the true arm under u, pushed by w at every step."""
    transition = A + float(bilinear) * np.tensordot(u, N, 1)
    return np.asarray(np.linalg.solve(np.eye(3) - transition, B @ u + w)[:2])


@pytest.mark.parametrize("bilinear", [False, True])
@pytest.mark.parametrize("constant", [False, True])
def test_the_steady_target_is_the_input_of_that_equilibrium(bilinear: bool, constant: bool) -> None:
    found, w, missed = model(bilinear, constant), np.array([0.01, -0.02, 0.03]), np.array([0.02, -0.01])
    pushed = np.zeros(found.n_lifted)
    pushed[-3:] = w
    u = np.array([0.21, -0.13])
    r = rest(bilinear, u, w) + missed
    np.testing.assert_allclose(target(found)(r, pushed, missed, np.zeros(2)), u, atol=2e-4)


def test_under_limits_it_is_the_nearest_equilibrium_and_free_outputs_do_not_count() -> None:
    found, none, missed = model(), np.zeros(3), np.zeros(2)
    r = np.array([3.0, -2.0])
    best = scipy.optimize.lsq_linear(
        np.array([rest(False, e, none) for e in np.eye(2)]).T / np.array([[0.5], [2.0]]),
        r / np.array([0.5, 2.0]),
        (LIMITS.u_min, LIMITS.u_max),
    )
    np.testing.assert_allclose(target(found)(r, none, missed, np.zeros(2)), best.x, atol=1e-3)
    one = target(found)(np.array([0.4, np.nan]), none, missed, np.zeros(2))
    assert one is not None and rest(False, one, none)[0] == pytest.approx(0.4, abs=1e-3)


def test_a_model_that_does_not_come_to_rest_has_no_target() -> None:
    found = model()
    grows = replace(found, A=1.3 * found.A)
    steady = target(grows)
    assert not steady.exists and steady(np.zeros(2), np.zeros(3), np.zeros(2), np.zeros(2)) is None
    assert target(found)(np.zeros(2), np.full(3, np.nan), np.zeros(2), np.zeros(2)) is None


def test_the_order_is_gone_down_step_by_step_and_begins_anew_with_a_solution() -> None:
    ladder, u0, u = Fallback(H, LIMITS), np.array([0.1, 0.0]), np.array([0.1, 0.0])
    ladder.reset(u0)
    ladder.solved()
    goal, names, applied = np.array([-0.3, 0.4]), [], []
    for _ in range(200):
        u, name = ladder(np.array([0.2, 0.1]), lambda: goal, u)
        names.append(name)
        applied.append(u)
    steps = np.array([u0, *applied])
    assert names[: 3 * H] == [PLAN] * (H - 1) + [TARGET] * H + [HOLD] * H + [REST]
    assert (np.abs(np.diff(steps, axis=0)) <= LIMITS.du_max + 1e-15).all()
    away = np.abs(steps[3 * H :] - u0)
    assert (np.diff(away, axis=0) <= 1e-12).all() and away[-1].max() < 1e-12 and names[-1] == HOLD
    slow = np.abs(np.diff(steps[3 * H :], axis=0)) / LIMITS.amplitude
    assert slow.max() <= 1.0 / (10 * H) + 1e-12
    ladder.solved()
    assert ladder(u0, lambda: goal, u)[1] == PLAN
    for _ in range(H - 1):
        name = ladder(u0, lambda: None, u)[1]
    assert name == HOLD  # no target: held at once


@pytest.mark.parametrize("bilinear", [False, True])
def test_where_the_solver_is_lost_the_target_is_reached_and_it_goes_on_from_there(
    bilinear: bool, tmp_path: Path
) -> None:
    found = model(bilinear)
    u = np.array([0.2, -0.1])
    r = rest(bilinear, u, np.zeros(3))
    mpc = MPC(found, 20, LIMITS.u_min, LIMITS.u_max, 0.02, qp=QPSettings(max_iterations=1, first_max_iterations=1))
    log = ClosedLoop(Arm(float(bilinear)), mpc).run(references.constant(r), 80, progress=False)
    lost = log.fallbacks
    assert lost >= 10 and set(log.actions[:lost]) <= {TARGET, HOLD} and set(log.actions[lost:]) == {""}
    np.testing.assert_allclose(log.u[-1], u, atol=2e-3)
    assert log.error[-1] < 0.01 * log.error[0] and log.limit_violations == 0
    assert f"{lost} fallbacks (20 x steady target" in log.summary()
    log.save(tmp_path / "run.h5")
    assert LoopLog.load(tmp_path / "run.h5").actions == log.actions


def test_a_blind_loop_goes_down_the_order_and_comes_back() -> None:
    mpc = MPC(model(), H, LIMITS.u_min, LIMITS.u_max, 0.05)
    loop = ClosedLoop(Dark(Arm()), mpc)
    log = loop.run(references.constant([0.3, np.nan]), 20, progress=False)
    state = pickle.loads(pickle.dumps(loop.snapshot()))
    whole = loop.resume(60, progress=False)
    loop.restore(state)
    again = loop.resume(60, progress=False)
    np.testing.assert_array_equal(again.u, whole.u)
    assert again.actions == whole.actions and len(log.u) == 20
    first = whole.actions.index(PLAN)
    assert whole.actions[first : first + 3 * H - 1] == (PLAN,) * (H - 1) + (TARGET,) * H + (HOLD,) * H
    np.testing.assert_allclose(rest(False, whole.u[first + 2 * H - 2], np.zeros(3))[0], 0.3, atol=1e-3)
    assert REST in whole.actions and whole.limit_violations == 0
    assert whole.actions[-1] == "" and whole.statuses[-1] == "solved"


class Dark(plants.WrappedPlant):
    """Measures nothing from step 15 to step 60."""

    def _measured(self, state: Array) -> Array:
        return state if not 15 <= len(self._states) - 1 < 60 else np.full(3, np.nan)
