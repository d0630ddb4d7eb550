"""A Kalman filter in the lifted state: the textbook's gain, what it learns from data, and loops that measure little."""

from __future__ import annotations

import pickle
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import scipy.linalg

from pisplit import BilinearEDMDc, Dictionary, Episodes, LinearEDMDc
from pisplit import observables as ob
from pisplit.checks import Array
from pisplit.controllers import MPC, ClosedLoop, KalmanFilter, PlantStep, plants, references
from pisplit.controllers.estimation.kalman import predicted_covariance
from pisplit.lifted.model import LiftedModel

A = np.array([[0.95, 0.3, 0.0], [-0.3, 0.9, 0.1], [0.0, 0.0, 0.7]])
B = np.array([[0.0], [0.1], [0.5]])
PROCESS = np.array([2e-3, 4e-3, 1e-3])


class Arm:
    """x+ = A x + B u + push + noise."""

    dt, n_inputs, n_states = 0.1, 1, 3
    state_units = ("m", "m/s", "N")

    def __init__(self, noise: float = 0.0, push: float = 0.0) -> None:
        self.noise, self.push = noise, push

    def reset(self, u0: Any = None) -> Array:
        self.x, self.rng = np.zeros(3), np.random.default_rng(5)
        return self.x

    def step(self, u: Array) -> PlantStep:
        self.x = A @ self.x + B @ u + self.push * B[:, 0] + self.noise * PROCESS * self.rng.standard_normal(3)
        return PlantStep(self.x)


def recorded(noise: float, steps: int = 2000) -> Episodes:
    plant, rng = Arm(noise), np.random.default_rng(0)
    u = rng.uniform(-1.0, 1.0, (steps, 1))
    x = np.array([plant.reset(), *(plant.step(v).state for v in u)])
    named = {"units": Arm.state_units, "outputs": {"tip": (0,)}}
    return Episodes([x], [u], 0.1, **named)


def fitted(*parts: Any, data: Episodes | None = None) -> LiftedModel:
    theta = Dictionary(*parts, ob.Identity(), n_states=3, n_inputs=1)
    return LinearEDMDc(theta, 1e-12).fit(data or recorded(0.0, 200)).lifted


def test_the_gain_is_that_of_the_riccati_equation() -> None:
    model = fitted()
    std = np.array([0.02])
    found = KalmanFilter(model, np.diag(PROCESS**2), std, "tip")
    C = np.eye(3)[:1]
    P = scipy.linalg.solve_discrete_are(A.T, C.T, np.diag(PROCESS**2), np.diag(std**2))
    np.testing.assert_allclose(found.gain, P @ C.T / (C @ P @ C.T + std**2), rtol=1e-5)
    assert found.innovation_std[0] == pytest.approx(np.sqrt(P[0, 0] + std[0] ** 2), rel=1e-5)


def test_a_constant_column_needs_no_noise() -> None:
    found = KalmanFilter(fitted(ob.Constant()), np.diag([0.0, *PROCESS**2]), 0.02, "tip")
    np.testing.assert_allclose(found.gain[0], 0.0, atol=1e-9)
    plain = KalmanFilter(fitted(), np.diag(PROCESS**2), 0.02, "tip")
    np.testing.assert_allclose(found.gain[1:], plain.gain, rtol=1e-4)


def test_a_growing_mode_must_be_seen() -> None:
    grows = np.diag([1.05, 0.5])
    P = predicted_covariance(grows, np.array([[1.0, 0.0]]), 1e-4 * np.eye(2), np.array([1e-2]))
    np.testing.assert_allclose(
        P, scipy.linalg.solve_discrete_are(grows.T, np.eye(2)[:, :1], 1e-4 * np.eye(2), [[1e-2]])
    )
    with pytest.raises(ValueError, match="does not decay and that the measured states do not show"):
        predicted_covariance(grows, np.array([[0.0, 1.0]]), 1e-4 * np.eye(2), np.array([1e-2]))


def test_data_tell_the_noise_of_the_process_and_innovations_are_white() -> None:
    data = recorded(1.0)
    model = fitted(data=data)
    found = KalmanFilter.from_data(model, data, 0.02, "tip")
    exact = KalmanFilter(model, np.diag(PROCESS**2), 0.02, "tip")
    np.testing.assert_allclose(found.innovation_std, exact.innovation_std, rtol=0.05)
    plant, rng = plants.NoisyMeasurements(Arm(1.0), {"m": 0.02}, seed=3), np.random.default_rng(9)
    z, x, seen = np.zeros(3), plant.reset(), []
    for u in rng.uniform(-1.0, 1.0, (1500, 1)):
        seen.append(found.innovation(z, x)[0])
        z = model.step(found.corrected(z, np.array(seen[-1:])), u)
        x = plant.step(u).state
    innovations = np.array(seen[50:])
    assert innovations.std() == pytest.approx(found.innovation_std[0], rel=0.1)
    assert abs(np.corrcoef(innovations[1:], innovations[:-1])[0, 1]) < 0.1


def test_noise_of_recordings_is_no_noise_of_the_process() -> None:
    data, rng = recorded(1.0), np.random.default_rng(4)
    model = fitted(data=data)
    tip = np.isin(np.arange(data.n_states), (data.outputs or {})["tip"])
    seen = replace(data, xs=[x + 0.02 * tip * rng.standard_normal(x.shape) for x in data.xs])
    exact = KalmanFilter(model, np.diag(PROCESS**2), 0.02, "tip")
    right = KalmanFilter.from_data(model, seen, 0.02, "tip", noisy=True)
    wrong = KalmanFilter.from_data(model, seen, 0.02, "tip")
    assert abs(right.innovation_std[0] / exact.innovation_std[0] - 1.0) < 0.2
    assert wrong.innovation_std[0] > 1.4 * exact.innovation_std[0]


def loop(plant: Any, observer: KalmanFilter | None, model: LiftedModel, steps: int = 150, gain: float = 0.1) -> Any:
    mpc = MPC(model, 10, -2.0, 2.0, 1.0, rate_weight=1e-3, estimator_gain=gain, observer=observer)
    return ClosedLoop(plant, mpc).run(references.constant([0.5]), steps, progress=False)


def true_error(plant: plants.WrappedPlant) -> float:
    return float(np.sqrt(np.mean((plant.true_states[50:, 0] - 0.5) ** 2)))


def test_a_filter_tracks_where_noise_is_taken_for_motion() -> None:
    model = fitted(data=recorded(1.0))
    errors = []
    for std, measured in ((0.02, None), (0.02, "tip")):
        observer = KalmanFilter.from_data(model, recorded(1.0), std, measured)
        plant = plants.NoisyMeasurements(Arm(1.0), 0.02, seed=4)
        log = loop(plant, observer, model)
        assert not log.stopped and log.limit_violations == 0
        errors.append(true_error(plant))
    plant = plants.NoisyMeasurements(Arm(1.0), 0.02, seed=4)
    loop(plant, None, model, gain=0.3)
    assert max(errors) < 0.8 * true_error(plant)


@pytest.mark.parametrize("measured", [None, "tip"])
def test_a_constant_push_leaves_no_offset(measured: str | None) -> None:
    model = fitted()
    observer = KalmanFilter(model, np.diag(PROCESS**2), 0.02, measured)
    log = loop(Arm(push=0.3), observer, model, 900)
    np.testing.assert_allclose(log.y[-20:], 0.5, atol=1e-3)


def test_what_is_not_in_the_filter_need_not_be_measured() -> None:
    model = fitted()
    observer = KalmanFilter(model, np.diag(PROCESS**2), 0.02, "tip")
    blind = plants.LostMeasurements(Arm(), 1.0, [[1], [2]])
    all_seen, tip_seen = loop(Arm(), observer, model), loop(blind, observer, model)
    np.testing.assert_array_equal(tip_seen.u, all_seen.u)
    assert np.isnan(tip_seen.x[1:, 1:]).all()


class Bent(Arm):
    """The same, whose stiffness changes with the input."""

    def step(self, u: Array) -> PlantStep:
        bent = 0.2 * u[0] * np.array([self.x[1], -self.x[0], 0.0])
        super().step(u)
        self.x = self.x + bent
        return PlantStep(self.x)


def test_a_bilinear_model_is_filtered_along_its_inputs() -> None:
    plant, rng = Bent(1.0), np.random.default_rng(0)
    u = rng.uniform(-1.0, 1.0, (2000, 1))
    x = np.array([plant.reset(), *(plant.step(v).state for v in u)])
    data = Episodes([x], [u], 0.1, units=Arm.state_units, outputs={"tip": (0,)})
    theta = Dictionary(ob.Constant(), ob.Identity(), ob.Bilinear(), n_states=3, n_inputs=1)
    model = BilinearEDMDc(theta, 1e-9).fit(data).lifted
    found = KalmanFilter.from_data(model, data, 0.02, "tip")
    sensor, z = plants.NoisyMeasurements(Bent(1.0), {"m": 0.02}, seed=3), model.fixed_point(np.zeros(1))
    measured, errors = sensor.reset(), []
    for v in rng.uniform(-1.0, 1.0, (1500, 1)):
        z = found.corrected(z, found.innovation(z, measured))
        errors.append(model.read(z)[0])
        z = model.step(z, v)
        measured = sensor.step(v).state
    true = sensor.true_states[:1500, 0]
    filtered = np.std((np.array(errors) - true)[50:])
    assert filtered < 0.75 * 0.02  # of the sensor
    errors_of = []
    for observer in (found, None):
        noisy = plants.NoisyMeasurements(Bent(1.0), 0.02, seed=4)
        log = loop(noisy, observer, model, gain=0.1 if observer else 0.3)
        assert not log.stopped and log.limit_violations == 0
        errors_of.append(true_error(noisy))
    assert errors_of[0] < 0.8 * errors_of[1]


def test_an_outlier_is_as_good_as_a_gap_until_it_is_no_outlier() -> None:
    model = fitted()
    observer = KalmanFilter(model, np.diag(PROCESS**2), 0.02, "tip")
    window, far = np.full((10, 1), 0.5), 5.0
    first, second = (MPC(model, 10, -2.0, 2.0, 1.0, observer=observer) for _ in range(2))
    for x in ([0.0, 0.0, 0.0], [0.01, 0.0, 0.0]):
        first.step(x, window)
        second.step(x, window)
    wrong, gap = first.step([far, 0.0, 0.0], window), second.step([np.nan, 0.0, 0.0], window)
    assert wrong.rejected == 1 and gap.rejected == 0
    np.testing.assert_array_equal(wrong.u, gap.u)
    rejected = [first.step([far + 0.01 * k, 0.0, 0.0], window).rejected for k in range(14)]
    assert sum(rejected[:11]) == 11 and rejected[11] == 0  # a dozen in a row: the model is wrong


def test_what_is_off_in_all_entries_for_long_is_the_model_and_no_outlier() -> None:
    model = fitted()
    observer = KalmanFilter(model, np.diag(PROCESS**2), 0.02)
    rng = np.random.default_rng(0)
    level = 1.0
    for _ in range(400):  # as expected: nothing changes
        level = observer.level(level, observer.innovation_std * rng.standard_normal(3))
    assert 0.5 < level < 1.5
    one = observer.innovation_std * np.array([100.0, 0.5, -0.5])  # one sensor of three, once
    assert observer.doubted(one, observer.level(level, one)).tolist() == [True, False, False]
    for _ in range(40):
        level = observer.level(level, 20.0 * observer.innovation_std * rng.standard_normal(3))
    assert 10.0 < level < 30.0
    assert not observer.doubted(20.0 * observer.innovation_std, level).any()
    assert observer.level(level, np.full(3, np.nan)) == level
    # In the loop: a model that is wrong by a quarter of its step is heard from the start of its errors on.
    mpc, window = MPC(model, 10, -2.0, 2.0, 1.0, observer=observer), np.full((10, 1), 0.5)
    states = [3.0 * np.sin(0.8 * k + np.arange(3.0)) for k in range(60)]
    rejected = [mpc.step(x, window).rejected for x in states]
    assert sum(rejected[:20]) > 0 and sum(rejected[20:]) == 0


def test_a_copy_goes_on_to_the_last_bit() -> None:
    model = fitted()
    observer = KalmanFilter(model, np.diag(PROCESS**2), 0.02, "tip")
    mpc, window = MPC(model, 10, -2.0, 2.0, 1.0, observer=observer), np.full((10, 1), 0.5)
    mpc.step(np.zeros(3), window)
    mpc.step([9.0, 0.0, 0.0], window)
    again, state = pickle.loads(pickle.dumps(mpc)), mpc.snapshot()
    expected = mpc.step([0.1, 0.0, 0.0], window).u
    np.testing.assert_array_equal(again.step([0.1, 0.0, 0.0], window).u, expected)
    mpc.restore(state)
    np.testing.assert_array_equal(mpc.step([0.1, 0.0, 0.0], window).u, expected)


def test_filters_that_cannot_be_are_refused_in_one_line() -> None:
    model, Q = fitted(), np.diag(PROCESS**2)
    for make, message in (
        (lambda: KalmanFilter(model, np.eye(4), 0.1), "process has shape"),
        (lambda: KalmanFilter(model, Q, {"mm": 0.1}), "no state of the model has the unit 'mm'"),
        (lambda: KalmanFilter(model, Q, -0.1), "std = -0.1"),
        (lambda: KalmanFilter(model, Q, 0.1, "nose"), "expected an output group"),
        (
            lambda: MPC(fitted(), 5, -1.0, 1.0, 1.0, observer=KalmanFilter(model, Q, 0.1)),
            "observer is of another model",
        ),
    ):
        with pytest.raises(ValueError, match=message):
            make()


def test_a_loop_says_once_and_within_half_a_second_that_its_model_does_not_carry_it() -> None:
    data = recorded(1.0)
    model = fitted(data=data)
    observer = KalmanFilter.from_data(model, data, 0.02)
    fine = loop(plants.NoisyMeasurements(Arm(1.0), 0.02, seed=4), observer, model)
    assert not fine.notes

    class Kicked(Arm):
        def step(self, u: Array) -> PlantStep:
            after = super().step(u)
            self.x = self.x + 0.3 * np.cos(2.0 * u[0] + self.x)
            return after

    with pytest.warns(UserWarning, match="the model does not carry this motion"):
        log = loop(plants.NoisyMeasurements(Kicked(1.0), 0.02, seed=4), observer, model)
    assert len(log.notes) == 1 and float(log.notes[0].split()[2]) <= 15 * Arm.dt
