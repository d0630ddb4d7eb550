"""A loop by the clock: it never runs ahead, says how late it was, and measures at the end of a step."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from queue import Queue

import numpy as np
import pytest

from pisplit import Dictionary, Episodes, LinearEDMDc
from pisplit import observables as ob
from pisplit.checks import Array
from pisplit.controllers import MPC, ClosedLoop, LoopLog, PlantStep, plants, references
from pisplit.controllers.loop import pacing
from pisplit.controllers.loop.pacing import Pace

DT, STEPS = 0.01, 12
A, B = np.array([[0.9, 0.2], [-0.2, 0.85]]), np.array([[0.0], [0.5]])


class Arm:
    """x+ = A x + B u, at once."""

    dt, n_inputs, n_states = DT, 1, 2

    def reset(self, u0: Array | None = None) -> Array:
        self.x = np.zeros(2)
        return self.x

    def step(self, u: Array) -> PlantStep:
        self.x = A @ self.x + B @ u
        return PlantStep(self.x)


class Robot(Arm):
    """The same, commanded and measured apart; it keeps the times of both."""

    def reset(self, u0: Array | None = None) -> Array:
        self.calls: list[tuple[str, float]] = []
        return super().reset(u0)

    def step(self, u: Array) -> PlantStep:
        raise AssertionError("not in real time")

    def send(self, u: Array) -> None:
        self.calls.append(("send", time.monotonic()))
        super().step(u)

    def measure(self) -> PlantStep:
        self.calls.append(("measure", time.monotonic()))
        return PlantStep(self.x)


def controller() -> MPC:
    rng, arm = np.random.default_rng(0), Arm()
    u = rng.uniform(-1.0, 1.0, (80, 1))
    x = np.array([arm.reset(), *(arm.step(v).state for v in u)])
    theta = Dictionary(ob.Identity(), n_states=2, n_inputs=1)
    return MPC(LinearEDMDc(theta, 1e-12).fit(Episodes([x], [u], DT, outputs={"tip": (0,)})), 8, -0.4, 0.4, 0.2)


def run(plant: object, realtime: bool = True) -> LoopLog:
    loop = ClosedLoop(plant, controller())  # type: ignore[arg-type]
    return loop.run(references.constant([0.3]), STEPS, progress=False, realtime=realtime)


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[float]]:
    """A clock that only sleeping moves, a millisecond too far."""
    now = [100.0]
    monkeypatch.setattr(pacing.time, "monotonic", lambda: now[0])

    def sleep(seconds: float) -> None:
        now[0] += seconds + 1e-3

    monkeypatch.setattr(pacing.time, "sleep", sleep)
    yield now


def test_samples_lie_on_a_grid_and_lateness_does_not_add_up(clock: list[float]) -> None:
    pace, at = Pace(0.1), []
    for spent in (0.02, 0.05, 0.0, 0.08):
        clock[0] += spent
        assert pace.wait() == pytest.approx(1e-3)
        at.append(clock[0] - 100.0)
    np.testing.assert_allclose(at, [0.101, 0.201, 0.301, 0.401])


def test_after_an_overrun_no_step_is_shortened(clock: list[float]) -> None:
    pace = Pace(0.1)
    clock[0] += 0.25
    assert pace.wait() == pytest.approx(0.15)
    assert pace.wait() == pytest.approx(1e-3)
    assert clock[0] - 100.0 == pytest.approx(0.351)


def test_a_loop_by_the_clock_does_what_one_without_does_but_no_faster() -> None:
    begin = time.monotonic()
    log = run(Arm())
    assert time.monotonic() - begin >= STEPS * DT
    plain = run(Arm(), realtime=False)
    np.testing.assert_array_equal(log.x, plain.x)
    assert np.isfinite(log.jitter).all() and (log.jitter >= 0.0).all() and np.isnan(plain.jitter).all()
    assert "real time: jitter median" in log.summary() and "real time" not in plain.summary()
    assert plain.overruns == 0


def test_a_step_that_takes_too_long_is_an_overrun(tmp_path: Path) -> None:
    class Slow(Arm):
        def step(self, u: Array) -> PlantStep:
            time.sleep(2.0 * DT)
            return super().step(u)

    log = run(Slow())
    assert log.overruns == STEPS and (log.jitter >= 0.9 * DT).all()
    assert replace(log, jitter=np.array([0.0999, 0.101, np.nan] * 4) * DT).overruns == 4
    log.save(tmp_path / "run.h5")
    np.testing.assert_array_equal(LoopLog.load(tmp_path / "run.h5").jitter, log.jitter)


def test_a_robot_is_commanded_at_the_beginning_and_measured_at_the_end_of_a_step() -> None:
    robot = Robot()
    log = run(robot)
    np.testing.assert_array_equal(log.x, run(Arm(), realtime=False).x)
    assert [name for name, _ in robot.calls] == ["send", "measure"] * STEPS
    at = np.array([t for _, t in robot.calls])
    assert at[-1] - at[0] >= (STEPS - 1) * DT
    assert (at[1:-1:2] <= at[2::2]).all()


def test_a_plant_behind_a_socket_keeps_the_same_clock() -> None:
    ports: Queue[int] = Queue()
    server = threading.Thread(
        target=plants.serve,
        args=(Arm(),),
        kwargs={"realtime": True, "connections": 1, "ready": ports.put},
        daemon=True,
    )
    server.start()
    begin = time.monotonic()
    with plants.SocketPlant(ports.get(timeout=10.0)) as plant:
        log = run(plant)
    server.join(timeout=10.0)
    assert not server.is_alive() and not log.stopped and time.monotonic() - begin >= STEPS * DT
    np.testing.assert_array_equal(log.x, run(Arm(), realtime=False).x)
    assert np.isfinite(log.jitter).all()
