"""A system that is not the one that was recorded is noticed within a second; the recorded one is not suspected."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from pisplit import Dictionary, Episodes, LinearEDMDc
from pisplit import observables as ob
from pisplit.checks import Array
from pisplit.controllers import MPC, ClosedLoop, InnovationWatch, LoopLog, PlantStep, plants, references

DT = 0.05
PAIR = np.array([[0.93, 0.25], [-0.25, 0.9]])
A, B = np.kron(np.eye(2), PAIR), np.kron(np.eye(2), [[0.0], [0.4]])


class Arm:
    """x+ = A x + gain B u + push + what hardens; states (p1, v1, p2, v2)."""

    dt, n_inputs, n_states = DT, 2, 4

    def __init__(self, gain: float = 1.0, push: float = 0.0, soft: float = 1.0, since: int = 0) -> None:
        self.gain, self.push, self.soft, self.since = gain, push, soft, since

    def reset(self, u0: Array | None = None) -> Array:
        self.x, self.k = np.zeros(4), 0
        return self.x

    def step(self, u: Array) -> PlantStep:
        own = self.k >= self.since
        gain, push, soft = (self.gain, self.push, self.soft) if own else (1.0, 0.0, 1.0)
        bend = np.array([0.0, 0.01, 0.0, 0.01]) * self.x**3
        self.x = soft * A @ self.x + gain * B @ u + push - bend
        self.k += 1
        return PlantStep(self.x)


def recorded(seed: int, noise: float = 0.0) -> Episodes:
    rng, xs, us = np.random.default_rng(seed), [], []
    for _ in range(4):
        plant: Any = plants.NoisyMeasurements(Arm(), noise, seed=int(rng.integers(1000)))
        u = np.repeat(rng.uniform(-1.0, 1.0, (20, 2)), 5, axis=0)
        xs.append(np.array([plant.reset(), *(plant.step(v).state for v in u)]))
        us.append(u)
    return Episodes(xs, us, DT, state_names=("p1", "v1", "p2", "v2"), outputs={"tip": (0, 2)})


def run(plant: Any, delays: int = 0, noise: float = 0.0, command_delay: float = 0.0) -> tuple[LoopLog, InnovationWatch]:
    parts = [ob.Identity(), ob.Delays(delays, delays)] if delays else [ob.Identity()]
    theta = Dictionary(ob.Constant(), *parts, n_states=4, n_inputs=2)
    model = LinearEDMDc(theta, 1e-9).fit(recorded(0, noise)).lifted
    watch = InnovationWatch(model, recorded(1, noise))
    mpc = MPC(model, 10, -1.0, 1.0, 0.4, rate_weight=1e-2, command_delay=command_delay)
    loop = ClosedLoop(plant, mpc)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        return loop.run(references.circle(0.5, 4.0, [0.0, 0.0], width=2), 120, progress=False, callbacks=[watch]), watch


@pytest.mark.parametrize(
    ("plant", "noise"),
    [
        (lambda: Arm(), 0.0),
        (lambda: plants.NoisyMeasurements(Arm(), 0.01, seed=5), 0.01),
        (lambda: plants.LostMeasurements(Arm(), 0.3, seed=5), 0.0),
    ],
)
@pytest.mark.parametrize("delays", [0, 2])
def test_the_system_that_was_recorded_is_not_suspected(plant: Callable[[], Any], noise: float, delays: int) -> None:
    log, watch = run(plant(), delays, noise)
    assert not log.notes and watch.level < 1.0 and not log.stopped


@pytest.mark.parametrize("delays", [0, 2])
@pytest.mark.parametrize(
    "changed", [{"gain": -1.0}, {"gain": 0.5}, {"push": 0.1}, {"soft": 0.9}], ids=["sign", "gain", "push", "soft"]
)
@pytest.mark.parametrize("since", [0, 60])
def test_another_system_is_noticed_within_a_second(changed: dict[str, float], delays: int, since: int) -> None:
    log, watch = run(Arm(since=since, **changed), delays)
    flipped = changed.get("gain", 1.0) < 0.0
    assert log.notes and ("innovations are" in log.notes[0] or flipped)
    assert bool(watch.fault) == flipped and (not flipped or since > 0 or "the other way round" in watch.fault)
    said = float(log.notes[0].split("t = ")[1].split(" s")[0])
    moving = max(since, int(np.argmax(np.abs(log.u).max(axis=1) > 0.02)))
    assert 0.0 < said - DT * moving <= 0.75


@pytest.mark.parametrize("mixing", [[[0.0, 1.0], [1.0, 0.0]], [[1.0, 0.0], [0.0, -1.0]]], ids=["swapped", "one turned"])
def test_inputs_that_are_mixed_up_are_named(mixing: list[list[float]]) -> None:
    class Mixed(Arm):
        def step(self, u: Array) -> PlantStep:
            return super().step(np.array(mixing) @ u)

    log, watch = run(Mixed())
    assert watch.fault and any(watch.fault in note for note in log.notes)
    assert ("in each other's place" in watch.fault) == (mixing[0][0] == 0.0)


def test_delays_that_the_controller_knows_are_no_fault() -> None:
    log, watch = run(plants.DelayedCommands(Arm(), 1.5), command_delay=1.5)
    assert not log.notes and watch.level < 1.0
    assert run(plants.DelayedCommands(Arm(), 1.5))[1].level > 1.0


def test_what_cannot_be_watched_is_refused() -> None:
    data = recorded(0)
    model = LinearEDMDc(Dictionary(ob.Identity(), n_states=4, n_inputs=2), 1e-9).fit(data)
    with pytest.raises(ValueError, match="no episode has the 200 steps of a window"):
        InnovationWatch(model, data, window=10.0)
    with pytest.raises(ValueError, match="expected an output group"):
        InnovationWatch(model, data, "nose")
