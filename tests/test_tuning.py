"""Numbers of a controller from model and data: modes, innovations, loops on the model, and no unit among them."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from scipy.linalg import expm

from pisplit import Dictionary, Episodes, LinearEDMDc
from pisplit import observables as ob
from pisplit.checks import Array
from pisplit.controllers import ClosedLoop, PlantStep, Tuned, plants, references, tune
from pisplit.controllers.tuning.innovations import Misses, innovations
from pisplit.controllers.tuning.spectrum import horizon_of, impulses, slow_modes, steps_of
from pisplit.controllers.tuning.trials import PushedModel
from pisplit.lifted.model import LiftedModel

DT, PERIOD, DAMPING = 0.05, 1.2, 0.08
OMEGA = 2.0 * np.pi / PERIOD
STEP = expm(DT * np.array([[0.0, 1.0, 0.0], [-(OMEGA**2), -2 * DAMPING * OMEGA, OMEGA**2], [0.0, 0.0, 0.0]]))
A, B = np.kron(np.eye(2), STEP[:2, :2]), np.kron(np.eye(2), STEP[:2, 2:])


class Arm:
    """Two oscillators of 1.2 s, pulled apart by springs that harden; states (p1, v1, p2, v2) in ``unit``."""

    dt, n_inputs, n_states = DT, 2, 4

    def __init__(self, cubic: float = 0.0, unit: float = 1.0, pull: float = 1.0, load: float = 0.0) -> None:
        self.cubic, self.unit, self.pull, self.load = cubic, unit, pull, load

    def reset(self, u0: Array | None = None) -> Array:
        u = np.zeros(2) if u0 is None else u0 / self.pull
        self.x = np.array([u[0], 0.0, u[1], 0.0])
        return self.unit * self.x

    def step(self, u: Array) -> PlantStep:
        hard = self.cubic * self.x[[0, 2]] ** 3
        self.x = A @ self.x + B @ (u / self.pull - hard + self.load)
        return PlantStep(self.unit * self.x)


def recorded(arm: Arm, seed: int = 0, episodes: int = 6) -> Episodes:
    rng, xs, us = np.random.default_rng(seed), [], []
    for _ in range(episodes):
        u = arm.pull * np.repeat(rng.uniform(-1.0, 1.0, (12, 2)), 8, axis=0)
        xs.append(np.array([arm.reset(), *(arm.step(v).state for v in u)]))
        us.append(u)
    return Episodes(xs, us, DT, outputs={"tip": (0, 2)})


def fitted(data: Episodes) -> LiftedModel:
    theta = Dictionary(ob.Constant(), ob.Identity(), n_states=4, n_inputs=2)
    return LinearEDMDc(theta, 1e-13).fit(data).lifted


@cache
def tuned(unit: float = 1.0, pull: float = 1.0) -> Tuned:
    arm = Arm(0.05, unit, pull)
    return tune(fitted(recorded(arm)), recorded(arm, 1), -pull, pull, 0.3 * pull, horizon=14, progress=False)


def test_the_modes_that_matter_are_those_of_the_response() -> None:
    weak = 1e-4  # a creeping mode that the outputs hardly see
    a = np.block([[A, np.zeros((4, 1))], [np.zeros((1, 4)), np.array([[0.999]])]])
    b = np.vstack([B, [[1.0, 1.0]]])
    c = np.array([[1.0, 0, 0, 0, weak], [0, 0, 1.0, 0, weak]])
    modes = slow_modes(impulses(a, b, c))
    expected = np.linalg.eigvals(A)
    assert all(np.abs(expected - m).min() < 1e-2 for m in modes) and len(modes) == 4
    assert steps_of(modes) == pytest.approx(PERIOD / DT, rel=0.02) and horizon_of(modes) in (24, 25)
    creeping = slow_modes(impulses(a, b, c + np.array([0, 0, 0, 0, 1.0])))
    assert steps_of(creeping) > 100 and horizon_of(creeping) == 60
    with pytest.raises(ValueError, match="do not answer to the inputs"):
        slow_modes(impulses(a, 0.0 * b, c))


def test_the_gain_follows_from_the_innovations() -> None:
    """A random walk among white noise: the best gain is that of its Kalman filter."""
    rng = np.random.default_rng(0)
    q, K = 0.25, 4000
    walk, noise = np.cumsum(np.sqrt(q) * rng.standard_normal((K, 1)), axis=0), rng.standard_normal((K, 1))
    best = 0.5 * (-q + np.sqrt(q**2 + 4 * q))  # P = q + (1 - g) P, g = P / (P + 1)
    one = np.ones(1)
    found = innovations(Misses(walk + noise, (walk + noise,), (0,), one, 1.0))
    assert found.gain == pytest.approx(best, rel=0.25) and abs(found.correlation) < 0.05 < found.without
    assert innovations(Misses(noise, (noise,), (0,), one, 1.0)).gain == pytest.approx(0.01)
    assert innovations(Misses(walk, (walk,), (0,), one, 1.0)).gain == pytest.approx(1.0, rel=0.1)


def test_a_pushed_model_is_the_model_where_it_misses_nothing() -> None:
    data = recorded(Arm())
    model = fitted(data)
    misses = Misses.of(model, data, (0, 2), np.ones(2))
    assert np.abs(misses.lifted).max() < 1e-9
    exact, pushed = plants.ModelPlant(model, np.zeros(4)), PushedModel(model, np.zeros(4), misses)
    exact.reset()
    pushed.reset()
    for u in np.random.default_rng(1).uniform(-1.0, 1.0, (20, 2)):
        np.testing.assert_allclose(pushed.step(u).state, exact.step(u).state, atol=1e-7)


def test_numbers_do_not_depend_on_units() -> None:
    plain, scaled = tuned(), tuned(1e3, 40.0)
    best, other = plain.chosen, scaled.chosen
    assert (best.horizon, best.rate_weight, best.gain) == (other.horizon, other.rate_weight, other.gain)
    assert best.error == pytest.approx(other.error, rel=1e-3)
    assert plain.mpc.horizon == scaled.mpc.horizon
    figure = plain.plot()
    drawn = figure.axes[0].lines[0].get_ydata()
    assert sorted(drawn) == [t.error for t in plain.trials if np.isfinite(t.error)]


@pytest.mark.parametrize("load", [0.0, 0.1])
def test_the_chosen_numbers_track_a_system_that_is_not_the_model(load: float) -> None:
    found, arm = tuned(), Arm(0.05, load=load)
    predicted = found.chosen.error
    circle = references.circle(0.5, 4.0, [0.0, 0.0], width=2)
    log = ClosedLoop(arm, found.mpc).run(circle, 200, progress=False)
    jump = ClosedLoop(arm, found.mpc).run(references.setpoint([[0.5, -0.3]], [0.2]), 120, progress=False)
    assert not log.stopped and log.limit_violations == 0
    assert log.rms_error(after=3.0) < 10.0 * predicted and jump.error[-1] < 2e-3
    assert predicted < 0.01 and "chosen of" in str(found) and found.seconds > 0.0


def test_what_is_given_is_kept_and_delays_are_in_the_trials() -> None:
    arm = Arm()
    data = recorded(arm)
    model = fitted(data)
    given = tune(model, data, -1.0, 1.0, 0.3, horizon=12, rate_weight=0.03, command_delay=1.0, progress=False)
    assert {(t.horizon, t.rate_weight) for t in given.trials} == {(12, 0.03)} and len(given.trials) >= 4
    plant = plants.DelayedCommands(Arm(), 1.0)
    log = ClosedLoop(plant, given.mpc).run(references.constant([0.4, -0.2]), 120, progress=False)
    assert log.error[-1] < 1e-3
    with pytest.raises(ValueError, match="names no output"):
        tune(model, data, -1.0, 1.0, 0.3, track="nose", progress=False)
