"""A plant as an environment of Gymnasium: its own checker passes, limits hold, and rewards are distances."""

from __future__ import annotations

import numpy as np
import pytest

from pisplit.checks import Array
from pisplit.controllers import PlantStep, environment, references

A, B = np.array([[0.9, 0.2], [-0.2, 0.85]]), np.array([[0.0], [0.5]])


class Arm:
    """x+ = A x + B u; it fails beyond 10."""

    dt, n_inputs, n_states = 0.1, 1, 2

    def reset(self, u0: Array | None = None) -> Array:
        self.x = np.zeros(2)
        return self.x

    def step(self, u: Array) -> PlantStep:
        self.x = A @ self.x + B @ u
        return PlantStep(self.x, bool(abs(self.x[0]) < 10.0), "" if abs(self.x[0]) < 10.0 else "too far")


def test_an_environment_is_one_by_gymnasiums_own_checks() -> None:
    checks = pytest.importorskip("gymnasium.utils.env_checker", reason="needs the extra gym")
    env = environment(Arm(), references.constant([0.3]), -0.4, 0.6, 0.1, [0], 20, ahead=3)
    checks.check_env(env, skip_render_check=True)


def test_limits_hold_and_rewards_are_distances() -> None:
    pytest.importorskip("gymnasium", reason="needs the extra gym")
    env, arm = environment(Arm(), references.constant([0.3]), -0.4, 0.6, 0.1, [0], 20, ahead=3), Arm()
    seen, _ = env.reset(seed=1)
    np.testing.assert_allclose(seen, [0.0, 0.0, 0.1, 0.3, 0.3, 0.3])
    arm.reset()
    u, rng = np.array([0.1]), np.random.default_rng(0)
    for k in range(20):
        action = rng.uniform(-3.0, 3.0, 1)
        seen, reward, ended, truncated, info = env.step(action)
        assert -0.4 <= info["u"][0] <= 0.6 and abs(info["u"] - u)[0] <= 0.1 + 1e-15
        u = info["u"]
        x = arm.step(u).state
        np.testing.assert_allclose(seen[:3], [*x, *u])
        assert reward == pytest.approx(-abs(x[0] - 0.3)) and not ended and truncated == (k == 19)


def test_a_plant_that_fails_ends_the_episode_and_what_does_not_fit_is_refused() -> None:
    pytest.importorskip("gymnasium", reason="needs the extra gym")
    env = environment(Arm(), references.constant([0.3]), -100.0, 100.0, 50.0, [0], 50)
    env.reset()
    for _ in range(5):
        seen, _, ended, _, info = env.step([1.0])
        if ended:
            break
    assert ended and info["message"] == "too far" and abs(seen[0]) < 10.0
    with pytest.raises(ValueError, match="3 coordinates, tracked 1 states"):
        environment(Arm(), references.constant(), -1.0, 1.0, 1.0, [0], 5)
