"""A sensor that repeats itself while the arm must have moved is not believed; others are, however coarse or calm."""

from __future__ import annotations

import pickle
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pisplit import Dictionary, Episodes, LinearEDMDc
from pisplit import observables as ob
from pisplit.checks import Array
from pisplit.controllers import MPC, ClosedLoop, KalmanFilter, LoopLog, PlantStep, plants, references
from pisplit.controllers.estimation.stuck import StuckSensors
from pisplit.lifted.model import LiftedModel

PAIR = np.array([[0.9, 0.25], [-0.25, 0.85]])
A, B = np.kron(np.eye(2), PAIR), np.kron(np.eye(2), [[0.0], [0.4]])
STEPS = 80


class Arm:
    """Two oscillators x+ = A x + B u + push; states (p1, v1, p2, v2)."""

    dt, n_inputs, n_states = 0.1, 2, 4

    def __init__(self, push: float = 0.0) -> None:
        self.push = push

    def reset(self, u0: Array | None = None) -> Array:
        self.x = np.zeros(4)
        return self.x

    def step(self, u: Array) -> PlantStep:
        self.x = A @ self.x + B @ u + self.push
        return PlantStep(self.x)

    def snapshot(self) -> Array:
        return self.x.copy()

    def restore(self, x: Array) -> None:
        self.x = x.copy()


def model(delays: int = 0) -> LiftedModel:
    rng, plant, xs, us = np.random.default_rng(0), Arm(), [], []
    for _ in range(4):
        u = rng.uniform(-1.0, 1.0, (60, 2))
        xs.append(np.array([plant.reset(), *(plant.step(v).state for v in u)]))
        us.append(u)
    parts = [ob.Identity(), ob.Delays(delays, delays)] if delays else [ob.Identity()]
    theta = Dictionary(*parts, n_states=4, n_inputs=2)
    data = Episodes(xs, us, 0.1, state_names=("p1", "v1", "p2", "v2"), outputs={"tip": (0, 2)})
    return LinearEDMDc(theta, 1e-12).fit(data).lifted


def wave(t: Array, start: Array) -> Array:
    return 0.4 * np.column_stack([np.sin(t), np.cos(0.7 * t) - 1.0])


def run(plant: Any, **options: Any) -> LoopLog:
    mpc = MPC(options.pop("model", None) or model(), 8, -1.0, 1.0, 0.5, rate_weight=1e-3, **options)
    return ClosedLoop(plant, mpc).run(references.Reference(wave, 2), STEPS, progress=False)


def true_error(plant: plants.WrappedPlant, log: LoopLog) -> float:
    return float(np.sqrt(np.mean((plant.true_states[10:, [0, 2]] - log.reference[10:]) ** 2)))


@pytest.mark.parametrize("delays", [0, 2])
def test_a_frozen_sensor_is_bridged_counted_and_named(delays: int) -> None:
    found = model(delays)
    whole = plants.WrappedPlant(Arm())
    nominal = true_error(whole, run(whole, model=found))
    frozen = [plants.FrozenMeasurements(Arm(), [0], 20, 30) for _ in range(2)]
    with pytest.warns(UserWarning, match=r"stuck sensors at t = 2.\d0 s: p1 repeated one value"):
        log = run(frozen[0], model=found)
    trusting = run(frozen[1], model=found, stuck_after=None)
    assert true_error(frozen[0], log) < 0.5 * true_error(frozen[1], trusting)
    assert true_error(frozen[0], log) < 3.0 * nominal + 0.03  # five samples were believed
    at = np.flatnonzero(log.stuck)
    assert 24 <= at[0] <= 30 and at[-1] == 50 and (np.diff(at) == 1).all()  # it lives again in sample 51
    np.testing.assert_array_equal(np.isnan(log.x[:-1, 0]), log.stuck > 0)
    np.testing.assert_array_equal(log.missing, log.stuck)
    assert log.limit_violations == 0 and "steps with stuck sensors" in log.summary() and "p1" in log.summary()
    assert not trusting.stuck.any()


def test_a_filter_goes_on_without_the_frozen_sensor() -> None:
    found = model()
    observer = KalmanFilter(found, 1e-6 * np.eye(4), 1e-3)
    frozen = [plants.FrozenMeasurements(plants.NoisyMeasurements(Arm(), 1e-3), [0, 1], 20, 30) for _ in range(2)]
    with pytest.warns(UserWarning, match="stuck sensors"):
        log = run(frozen[0], model=found, observer=observer)
    trusting = run(frozen[1], model=found, observer=observer, stuck_after=None)
    assert true_error(frozen[0], log) < 0.5 * true_error(frozen[1], trusting)


class Coarse(plants.WrappedPlant):
    """An encoder of so many counts a unit."""

    counts = 50.0

    def _measured(self, state: Array) -> Array:
        return np.round(self.counts * state) / self.counts


@pytest.mark.parametrize(
    "plant",
    [
        lambda: Arm(),
        lambda: Arm(push=0.01),
        lambda: Coarse(Arm()),
        lambda: plants.NoisyMeasurements(Arm(), 1e-3),
        lambda: plants.LostMeasurements(Arm(), 0.5),
        lambda: plants.DelayedMeasurements(Arm(), 1.0),
    ],
)
def test_sensors_that_live_are_believed(plant: Callable[[], Any]) -> None:
    log = run(plant())
    assert not log.stuck.any() and not log.stopped


def test_an_arm_at_rest_and_states_that_never_move_are_believed() -> None:
    arm = plants.WrappedPlant(Arm())
    mpc = MPC(model(), 8, -1.0, 1.0, 0.5, rate_weight=1e-3)
    still = references.constant([0.0, 0.0])
    assert not ClosedLoop(arm, mpc).run(still, 40, progress=False).stuck.any()
    one = references.Reference(one_axis, 2)
    log = ClosedLoop(arm, mpc).run(one, 40, progress=False)  # p2 and v2 stay exactly at zero
    assert (np.abs(log.x[:, 2:]) < 1e-3).all() and not log.stuck.any()


def one_axis(t: Array, start: Array) -> Array:
    return np.column_stack([0.4 * np.sin(t), np.zeros(len(t))])


def test_it_takes_so_many_repeats_motion_of_inputs_and_a_prediction_elsewhere() -> None:
    def found(change: float, predicted: float, repeats: int) -> bool:
        watch = StuckSensors(4, np.array([1.0]), np.array([1.0]))
        u, stuck = np.zeros(1), np.zeros(1, dtype=bool)
        for _ in range(repeats + 1):
            stuck = watch(np.array([0.5]), u, lambda states: np.full(len(states), 0.5 + predicted))
            u = u + change
        return bool(stuck[0])

    assert found(0.01, 0.01, 4)
    assert not found(0.01, 0.01, 3)
    assert not found(0.0, 0.01, 20)
    assert not found(0.01, 0.0009, 20)  # with a memory of ten steps never more than 1 %


def test_a_copy_knows_what_is_stuck(tmp_path: Path) -> None:
    loops = [ClosedLoop(plants.FrozenMeasurements(Arm(), [0], 20), MPC(model(), 8, -1.0, 1.0, 0.5)) for _ in range(2)]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        whole = loops[0].run(references.Reference(wave, 2), 50, progress=False)
        loops[1].run(references.Reference(wave, 2), 30, progress=False)
        state = pickle.loads(pickle.dumps(loops[1].snapshot()))
        loops[1].restore(state)
        again = loops[1].resume(20, progress=False)
    np.testing.assert_array_equal(again.u, whole.u)
    np.testing.assert_array_equal(again.stuck, whole.stuck)
    assert whole.stuck[30:].all()
    whole.save(tmp_path / "run.h5")
    np.testing.assert_array_equal(LoopLog.load(tmp_path / "run.h5").stuck, whole.stuck)
