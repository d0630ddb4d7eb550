"""What was not measured: the model's prediction stands for it, it is counted, and inputs stay inside their limits."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

from pisplit import Dictionary, Episodes, LinearEDMDc
from pisplit import observables as ob
from pisplit.checks import Array
from pisplit.controllers import MPC, ClosedLoop, LoopLog, PlantStep, plants, references
from pisplit.lifted.model import LiftedModel

A = np.array([[0.9, 0.2], [-0.2, 0.85]])
B = np.array([[0.0], [0.5]])


class Arm:
    """x+ = A x + B u."""

    dt, n_inputs, n_states = 0.1, 1, 2

    def reset(self, u0: Array | None = None) -> Array:
        self.x = np.zeros(2)
        return self.x

    def step(self, u: Array) -> PlantStep:
        self.x = A @ self.x + B @ u
        return PlantStep(self.x)


def model(delays: int = 0) -> LiftedModel:
    rng, plant, xs, us = np.random.default_rng(0), Arm(), [], []
    for _ in range(4):
        u = rng.uniform(-1.0, 1.0, (40, 1))
        xs.append(np.array([plant.reset(), *(plant.step(v).state for v in u)]))
        us.append(u)
    parts = [ob.Identity(), ob.Delays(delays, delays)] if delays else [ob.Identity()]
    theta = Dictionary(*parts, n_states=2, n_inputs=1)
    return LinearEDMDc(theta, 1e-12).fit(Episodes(xs, us, 0.1, outputs={"tip": (0,)})).lifted


def controller(delays: int = 0) -> MPC:
    return MPC(model(delays), 8, -0.4, 0.4, 0.2, rate_weight=1e-3)


def run(plant: object, delays: int = 0, steps: int = 40) -> LoopLog:
    loop = ClosedLoop(plant, controller(delays))  # type: ignore[arg-type]
    return loop.run(references.setpoint([[0.5], [-0.3]], [0.0, 2.0]), steps, progress=False)


@pytest.mark.parametrize("delays", [0, 2])
@pytest.mark.parametrize("groups", [None, [[0], [1]]])
def test_an_exact_model_bridges_gaps_as_if_there_were_none(delays: int, groups: list[list[int]] | None) -> None:
    whole = run(Arm(), delays)
    gaps = run(plants.LostMeasurements(Arm(), 0.3, groups, seed=2), delays)
    assert not gaps.stopped and np.isnan(gaps.x).any()
    np.testing.assert_array_equal(gaps.missing, np.isnan(gaps.x[:-1]).sum(axis=1))
    np.testing.assert_allclose(gaps.u, whole.u, atol=2e-4)  # the solver's tolerance
    assert "missing measurements" in gaps.summary() and "missing" not in whole.summary()
    known = np.isfinite(gaps.y[1:, 0])
    rms = float(np.sqrt(np.mean(gaps.error[1:][known] ** 2)))
    assert gaps.rms_error() == pytest.approx(rms)


def test_a_blind_controller_goes_to_the_end_of_its_plan_and_says_so() -> None:
    mpc, seen = controller(), Arm()
    x, window = seen.reset(), np.full((8, 1), 0.5)
    for _ in range(5):
        move = mpc.step(x, window)
        x = seen.step(move.u).state
    before, moves = move.u, []
    for _ in range(20):
        moves.append(mpc.step([np.nan, np.nan], window))
    u = np.array([before, *(m.u for m in moves)])
    assert (np.abs(u) <= 0.4).all() and (np.abs(np.diff(u, axis=0)) <= 0.2 + 1e-12).all()
    assert all(m.missing == 2 for m in moves) and not moves[0].fallback
    assert moves[-1].fallback and moves[-1].status == "blind for more than the horizon"
    np.testing.assert_array_equal(moves[-1].u, moves[-2].u)


def test_before_anything_was_measured_the_input_rests() -> None:
    move = controller().step([np.nan, 0.0], np.full((8, 1), 0.5))
    assert (move.status, move.fallback, move.u.tolist(), move.missing) == ("not measured yet", True, [0.0], 1)
    with pytest.raises(ValueError, match="the plant at rest measured 2 states that are NaN"):

        class Blind(Arm):
            def reset(self, u0: Array | None = None) -> Array:
                return np.full(2, np.nan)

        run(Blind())


def test_a_log_with_gaps_survives_its_file(tmp_path) -> None:  # type: ignore[no-untyped-def]
    log = run(plants.LostMeasurements(Arm(), 0.3, seed=2))
    log.save(tmp_path / "run.h5")
    again = LoopLog.load(tmp_path / "run.h5")
    np.testing.assert_array_equal(again.x, log.x)
    np.testing.assert_array_equal(again.missing, log.missing)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert again.summary() == log.summary()
