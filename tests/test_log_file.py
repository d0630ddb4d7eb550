"""A run is followed while it goes on: callbacks, and a file that is valid whatever ends the process."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import h5py
import numpy as np
import pytest

from pisplit import Dictionary, Episodes, LinearEDMDc
from pisplit import observables as ob
from pisplit.checks import Array
from pisplit.controllers import MPC, ClosedLoop, LoopLog, LoopStep, PlantStep, references
from pisplit.controllers.loop import stream
from pisplit.controllers.loop.following import Follower

A, B = np.array([[0.9, 0.2], [-0.2, 0.85]]), np.array([[0.0], [0.5]])
STEPS = references.setpoint([[0.3], [-0.3]], [0.0, 1.0])


class Arm:
    """x+ = A x + B u."""

    dt, n_inputs, n_states = 0.1, 1, 2

    def reset(self, u0: Array | None = None) -> Array:
        self.x, self.steps = np.zeros(2), 0
        return self.x

    def step(self, u: Array) -> PlantStep:
        self.x, self.steps = A @ self.x + B @ u, self.steps + 1
        return PlantStep(self.x)


def loop(plant: Arm | None = None) -> ClosedLoop:
    rng, arm = np.random.default_rng(0), Arm()
    u = rng.uniform(-1.0, 1.0, (80, 1))
    x = np.array([arm.reset(), *(arm.step(v).state for v in u)])
    theta = Dictionary(ob.Identity(), n_states=2, n_inputs=1)
    model = LinearEDMDc(theta, 1e-12).fit(Episodes([x], [u], 0.1, outputs={"tip": (0,)})).lifted
    return ClosedLoop(plant or Arm(), MPC(model, 8, -0.4, 0.4, 0.2, rate_weight=1e-3))


def same(one: LoopLog, other: LoopLog) -> None:
    for name in ("t", "x", "u", "u0", "reference", "iterations", "fallback", "solve_time", "missing", "stuck"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name), err_msg=name)
    for name in ("statuses", "actions", "state_names", "input_units", "tracked", "notes", "dt", "limit_violations"):
        assert getattr(one, name) == getattr(other, name), name


def test_the_file_of_a_run_is_its_log(tmp_path: Path) -> None:
    path, made = tmp_path / "run.h5", loop()
    log = made.run(STEPS, 20, progress=False, log_file=path)
    same(LoopLog.load(path), log)
    whole = made.resume(15, progress=False, log_file=path)
    same(LoopLog.load(path), whole)
    assert len(whole.u) == 35 and LoopLog.load(path).message == ""


def test_a_file_amid_a_run_holds_what_was_flushed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, seen = tmp_path / "run.h5", []
    monkeypatch.setattr(stream.LogStream, "due", lambda self: True)

    def look(step: LoopStep) -> None:
        found = LoopLog.load(path)
        seen.append(len(found.u))
        same(found, made.log)
        assert found.message == stream.CUT

    made = loop()
    made.run(STEPS, 5, progress=False, log_file=path, callbacks=[look])
    assert seen == [1, 2, 3, 4, 5]


def run_for_ever(path: str) -> None:
    stream.LogStream.due = lambda self: True  # type: ignore[method-assign]
    print("ready", flush=True)
    loop().run(STEPS, 10**5, progress=False, log_file=path)


@pytest.mark.parametrize("wait", [0.0, 0.13, 0.37])
def test_a_killed_run_leaves_a_file_that_can_be_read(wait: float, tmp_path: Path) -> None:
    path = tmp_path / "run.h5"
    process = subprocess.Popen([sys.executable, __file__, str(path)], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None and process.stdout.readline() == "ready\n"
    while not (stream.begins_as_stream(path) and rows(path) > 1):
        time.sleep(0.01)
    time.sleep(wait)
    flushed = rows(path)
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    process.stdout.close()
    log = LoopLog.load(path)
    assert len(log.u) >= flushed - 1 > 0 and log.stopped
    again = loop().run(STEPS, len(log.u), progress=False)
    np.testing.assert_array_equal(log.x, again.x)
    np.testing.assert_array_equal(log.u, again.u)
    assert log.statuses == again.statuses and len(log.solve_time) == len(log.u)


def rows(path: Path) -> int:
    try:
        with h5py.File(path, "r", libver="latest", swmr=True) as file:
            return len(file["x"])
    except OSError:
        return 0


def test_a_file_survives_what_ends_the_run(tmp_path: Path) -> None:
    class Breaks(Arm):
        def step(self, u: Array) -> PlantStep:
            if self.steps == 7:
                raise SystemExit
            return super().step(u)

    path = tmp_path / "run.h5"
    with pytest.raises(SystemExit):
        loop(Breaks()).run(STEPS, 20, progress=False, log_file=path)
    found = LoopLog.load(path)
    assert len(found.u) == 7 and "the plant raised SystemExit" in found.message


def test_a_full_disk_ends_no_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stream.LogStream, "due", lambda self: len(made.log.u) == 3)
    monkeypatch.setattr(stream, "SPARE", 1 << 62)
    made = loop()
    with pytest.warns(UserWarning, match="log file: .* are left on the disk"):
        log = made.run(STEPS, 10, progress=False, log_file=tmp_path / "run.h5")
    assert len(log.u) == 10 and not log.stopped and "are left on the disk" in log.notes[-1]


def test_files_that_cannot_be_are_refused_before_the_arm_moves(tmp_path: Path) -> None:
    for path, message in ((tmp_path, "is a folder"), (tmp_path / "no" / "run.h5", "cannot be written")):
        with pytest.raises(ValueError, match=message):
            loop().run(STEPS, 5, progress=False, log_file=path)
    (tmp_path / "run.h5").write_bytes(stream.BEGINNING + b"and no more")
    with pytest.raises(ValueError, match="is damaged, or was killed before its first step"):
        LoopLog.load(tmp_path / "run.h5")


def test_callbacks_are_told_every_step_and_may_end_the_run() -> None:
    told: list[LoopStep] = []

    def watch(step: LoopStep) -> str | None:
        told.append(step)
        step.x[:] = 9.0  # a copy
        return "the guest left" if step.k == 6 else None

    log = loop().run(STEPS, 20, progress=False, callbacks=[watch])
    assert [s.k for s in told] == list(range(7)) and len(log.u) == 7
    assert log.message == "step 7 of 20 (t = 0.700 s): ended by a callback: the guest left"
    np.testing.assert_array_equal([s.u for s in told], log.u)
    np.testing.assert_array_equal([s.reference for s in told], log.reference[1:])
    np.testing.assert_allclose([s.t for s in told], log.t[1:])
    assert np.abs(log.x).max() < 1.0 and [s.move.status for s in told] == list(log.statuses)


def test_a_callback_that_raises_leaves_the_log_with_its_step() -> None:
    def bad(step: LoopStep) -> None:
        raise ZeroDivisionError("plot")

    made = loop()
    with pytest.warns(UserWarning, match="a callback raised"):
        log = made.run(STEPS, 20, progress=False, callbacks=[bad])
    assert log.message == "step 1 of 20 (t = 0.100 s): a callback raised ZeroDivisionError: plot" and len(log.u) == 1
    assert made.log.message == log.message
    with pytest.raises(ValueError, match="callbacks hold a str"):
        Follower(["plot"], None, lambda first: log)  # type: ignore[list-item]


if __name__ == "__main__":
    run_for_ever(sys.argv[1])
