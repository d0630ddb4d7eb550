"""Delays of commands and measurements: what a controller that knows them does is what it would do without them."""

from __future__ import annotations

import copy
import pickle
from typing import Any

import numpy as np
import pytest

from pisplit import BilinearEDMDc, Dictionary, Episodes, LinearEDMDc
from pisplit import observables as ob
from pisplit.checks import Array
from pisplit.controllers import MPC, ClosedLoop, PlantStep, plants, references
from pisplit.controllers.loop.history import Line
from pisplit.controllers.mpc.latency import Latency
from pisplit.lifted.model import LiftedModel

DT = 0.05
TURN = 2.0 * np.pi * DT
A = 0.98 * np.array([[np.cos(TURN), np.sin(TURN)], [-np.sin(TURN), np.cos(TURN)]])
B = np.array([[0.02], [0.2]])


class Oscillator:
    """Lightly damped, 1 Hz: x+ = A x + B u (1 + bend x_0)."""

    dt, n_inputs, n_states = DT, 1, 2

    def __init__(self, bend: float = 0.0) -> None:
        self.bend = bend

    def reset(self, u0: Any = None) -> Array:
        self.x = np.zeros(2)
        return self.x.copy()

    def step(self, u: Array) -> PlantStep:
        self.x = A @ self.x + B @ u * (1.0 + self.bend * self.x[0])
        return PlantStep(self.x.copy())

    def snapshot(self) -> Array:
        return self.x.copy()

    def restore(self, kept: Array) -> None:
        self.x = kept.copy()


def model(bend: float = 0.0, bilinear: bool = False) -> LiftedModel:
    plant, rng = Oscillator(bend), np.random.default_rng(0)
    x, u = [], []
    for _ in range(6):
        inputs = rng.uniform(-1.0, 1.0, (60, 1))
        x.append(np.array([plant.reset(), *(plant.step(v).state for v in inputs)]))
        u.append(inputs)
    data = Episodes(x, u, DT, outputs={"tip": (0,)})
    kind = BilinearEDMDc if bilinear else LinearEDMDc
    return kind(Dictionary(ob.Identity(), n_states=2, n_inputs=1), 1e-12).fit(data).lifted


def controller(found: LiftedModel, **delays: float) -> MPC:
    return MPC(found, 25, -1.0, 1.0, 0.5, rate_weight=1e-4, **delays)


T = DT * np.arange(400)
WAVE = references.from_array(0.3 * np.sin(np.pi * T)[:, None], DT)
STEP = references.setpoint([[0.4]], [0.0])


def missed(plant: Any, mpc: MPC, reference: Any = WAVE, steps: int = 200) -> float:
    """RMS distance of the true state from the reference after a second."""
    outer = plants.WrappedPlant(plant)
    log = ClosedLoop(outer, mpc).run(reference, steps, progress=False)
    assert not log.stopped and not log.fallbacks and not log.limit_violations
    return float(np.sqrt(np.mean((outer.true_states[20:, 0] - log.reference[20:, 0]) ** 2)))


@pytest.mark.parametrize("bilinear", [False, True], ids=["linear", "bilinear"])
@pytest.mark.parametrize(("command", "measurement"), [(1.0, 0.0), (2.0, 0.0), (0.0, 1.0), (0.0, 3.0), (1.0, 2.0)])
def test_whole_steps_cost_nothing_on_a_reference_that_is_known(
    command: float, measurement: float, bilinear: bool
) -> None:
    bend = 0.3 if bilinear else 0.0
    found = model(bend, bilinear)
    at_once = missed(Oscillator(bend), controller(found))
    late = plants.DelayedMeasurements(plants.DelayedCommands(Oscillator(bend), command), measurement)
    assert missed(late, controller(found, command_delay=command, measurement_delay=measurement)) < at_once + 1e-4
    assert missed(late, controller(found)) > 20.0 * at_once


@pytest.mark.parametrize("part", [0.25, 0.4, 1.7])
def test_fractions_of_a_step_are_taken_out(part: float) -> None:
    found = model()
    commands = plants.DelayedCommands(Oscillator(), part)
    assert missed(commands, controller(found, command_delay=part)) < 2e-3
    measured = plants.DelayedMeasurements(Oscillator(), part)
    assert missed(measured, controller(found, measurement_delay=part)) < 2e-2
    assert missed(measured, controller(found)) > 2.0 * missed(measured, controller(found, measurement_delay=part))


def test_a_set_point_is_reached_exactly_under_a_push_that_nobody_told() -> None:
    class Pushed(Oscillator):
        def step(self, u: Array) -> PlantStep:
            return super().step(u + 0.1)

    late = plants.DelayedMeasurements(plants.DelayedCommands(Pushed(), 1.0), 0.5)
    log = ClosedLoop(late, controller(model(), command_delay=1.0, measurement_delay=0.5)).run(STEP, 300, progress=False)
    assert abs(late.true_states[-1, 0] - 0.4) < 1e-6
    assert log.limit_violations == 0


def test_one_delay_of_both_kinds_is_one_delay() -> None:
    """Whole delays of the same sum give the same commands where the reference does not change."""
    found, logs = model(), []
    for command, measurement in [(2.0, 0.0), (0.0, 2.0), (1.0, 1.0)]:
        late = plants.DelayedMeasurements(plants.DelayedCommands(Oscillator(), command), measurement)
        mpc = controller(found, command_delay=command, measurement_delay=measurement)
        logs.append(ClosedLoop(late, mpc).run(STEP, 60, progress=False).u)
    np.testing.assert_allclose(logs[0], logs[1], atol=1e-9)
    np.testing.assert_allclose(logs[0], logs[2], atol=1e-9)


def test_copies_go_on_to_the_last_bit() -> None:
    late = plants.DelayedCommands(Oscillator(), 1.4)
    loop = ClosedLoop(late, controller(model(), command_delay=1.4))
    loop.run(WAVE, 30, progress=False)
    kept = copy.deepcopy(loop.snapshot())
    other = pickle.loads(pickle.dumps(loop.controller))
    once = loop.resume(20, progress=False)
    loop.restore(kept)
    np.testing.assert_array_equal(loop.resume(20, progress=False).u, once.u)
    window = np.zeros((loop.controller.horizon, 1))
    assert other.horizon == 25 + 1 and np.isfinite(other.step(np.zeros(2), window).u).all()


def test_a_delay_line_knows_what_is_on_its_way() -> None:
    rng = np.random.default_rng(3)
    for steps in (0.0, 0.3, 1.0, 2.6):
        line = Line(steps, "delay")
        line.fill(np.zeros(2))
        for value in rng.standard_normal((7, 2)):
            line(value)
        coming = line.coming()
        assert coming.shape == (int(steps), 2)
        for expected in coming:
            np.testing.assert_array_equal(line(rng.standard_normal(2)), expected)


def test_the_reference_is_read_where_the_outputs_are() -> None:
    window = np.arange(1.0, 9.0)[:, None]
    for command, measurement in [(0.0, 0.0), (0.0, 0.4), (1.5, 0.0), (1.3, 0.9), (0.2, 0.2)]:
        latency = Latency(command, measurement)
        found = latency.wanted(window, np.zeros(1))[:, 0]
        assert len(found) == 8 - latency.preview
        np.testing.assert_allclose(found, 1.0 + latency.steps - measurement + np.arange(len(found)), atol=1e-12)


def test_delays_that_are_none_are_refused() -> None:
    for bad in (-1.0, np.nan, "one"):
        with pytest.raises(ValueError, match="command_delay"):
            controller(model(), command_delay=bad)
        with pytest.raises(ValueError, match="measurement_delay"):
            controller(model(), measurement_delay=bad)
