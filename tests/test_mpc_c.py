"""The step of an MPC in C does what it does in Python, to rounding."""

import shutil
import subprocess
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from example_models import DIFFERENTIAL, arm_model, delayed_model
from pisplit.controllers import MPC, KalmanFilter, QPSettings

pytest.importorskip("daqp")
pytestmark = pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")
EXACT = QPSettings(solver="daqp", eps=1e-12)
MAIN = """
#include <stdio.h>
#include "arm.h"
int main(void) {
  static arm_state s;
  double u0[ARM_INPUTS], x[ARM_STATES], r[ARM_HORIZON * ARM_OUTPUTS], u[ARM_INPUTS];
  if (fread(u0, sizeof(double), ARM_INPUTS, stdin) != ARM_INPUTS) return 1;
  arm_reset(&s, u0);
  while (fread(x, sizeof(double), ARM_STATES, stdin) == ARM_STATES) {
    if (fread(r, sizeof(double), ARM_HORIZON * ARM_OUTPUTS, stdin) != ARM_HORIZON * ARM_OUTPUTS) return 2;
    double told[3] = {0.0, 0.0, 0.0};
    told[0] = arm_step(&s, x, r, u);
    told[1] = s.missing;
    told[2] = s.rejected;
    fwrite(told, sizeof(double), 3, stdout);
    fwrite(u, sizeof(double), ARM_INPUTS, stdout);
  }
  return 0;
}
"""
ACTIONS = {"": 0, "shifted plan": 1, "steady target": 2, "hold": 3, "return to rest": 4}


def in_c(mpc: MPC, folder: Path, u0: np.ndarray, x: np.ndarray, r: np.ndarray) -> np.ndarray:
    """Status, missing, rejected and inputs (N, 3 + m) of the compiled step."""
    mpc.to_c(folder / "arm.h", name="arm")
    (folder / "main.c").write_text(MAIN)
    flags = ["-std=c99", "-O2", "-Wall", "-Werror", "-Wno-unused-function", "-Wno-unused-variable"]
    built = subprocess.run(["cc", *flags, "main.c", "-lm", "-o", "main"], cwd=folder, capture_output=True, text=True)
    assert built.returncode == 0, built.stderr
    rows = np.hstack([x, r.reshape(len(r), -1)])
    told = subprocess.run(
        [str(folder / "main")], input=np.concatenate([u0, rows.ravel()]).tobytes(), capture_output=True, check=True
    ).stdout
    return np.frombuffer(told).reshape(len(x), -1)


def delayed(**changes: Any) -> MPC:
    """Delays in the model, a fraction of a step of the commands, a plane of inputs; everything is measured."""
    model = replace(delayed_model(), c=1e-3 * np.arange(15.0), input_basis=DIFFERENTIAL)
    model = replace(model, input_offset=np.array([0.001, 0.001, 0.001]))
    settings = {"rate_weight": 1e-3, "qp": EXACT, "stuck_after": None, "command_delay": 1.4} | changes
    return MPC(model, 8, -0.02, 0.02, 0.004, **settings)


def observed(**changes: Any) -> MPC:
    """A filter that sees three of six states, all directions of the inputs, late measurements."""
    model = arm_model(4, basis=np.eye(3))
    observer = KalmanFilter(model, 1e-6 * np.eye(6), 1e-3, measured=[0, 2, 5])
    settings = {"qp": EXACT, "stuck_after": None, "observer": observer, "measurement_delay": 0.4} | changes
    return MPC(model, 10, [-0.02, -0.01, -0.02], 0.02, [0.002, 0.004, 0.003], axes=(1, 0), **settings)


def held(**changes: Any) -> MPC:
    """One direction of three inputs, found by alternating projections; references of which some are free."""
    model = arm_model(5, basis=DIFFERENTIAL[:, :1])
    return MPC(model, 6, -0.02, 0.02, 0.004, qp=EXACT, stuck_after=None, **changes)


def bilinear(**changes: Any) -> MPC:
    """Products of inputs and states, a whole step of delay; a filter that sees all of it."""
    model = arm_model(6, basis=DIFFERENTIAL)
    N = np.zeros((3, 6, 6))
    N[:, 1::2, ::2] = 4.0 * np.random.default_rng(3).standard_normal((3, 3, 3))
    model = replace(model, N=N)
    observer = KalmanFilter(model, 1e-6 * np.eye(6), 1e-3)
    settings = {"qp": EXACT, "stuck_after": None, "observer": observer, "command_delay": 1.0} | changes
    return MPC(model, 9, -0.02, 0.02, 0.004, rate_weight=1e-3, **settings)


@pytest.mark.parametrize("make", [delayed, observed, held, bilinear])
def test_a_thousand_steps_are_those_of_python(make: Any, tmp_path: Path) -> None:
    """In closed loop with noise, gaps, outliers, free references, blind stretches longer than the horizon."""
    mpc, rng = make(), np.random.default_rng(0)
    model, (H, p), N = mpc.model, (mpc.horizon, len(mpc.tracked)), 1000
    u0 = model.input_offset.copy()
    mpc.reset(u0)
    start = np.zeros((model.n_delays + 1, 6)), np.tile(u0, (model.n_delays, 1))
    z, xs, rs, found = model.lift(*start), [], [], []
    angles = 0.05 * np.arange(N + H)[:, None] + np.arange(p)
    wanted = 0.03 * np.sin(angles) + 0.02 * (np.floor(angles) % 2)
    for k in range(N):
        x = model.read(z) + 1e-4 * rng.standard_normal(6)
        x = np.where((rng.uniform(size=6) < 0.05) & (k > 0), np.nan, x)
        if k % 97 == 50:
            x[rng.integers(6)] += 0.5
        if k % 200 > 200 - (1 if make is bilinear else 2) * H:
            x[:] = np.nan
        r = wanted[k : k + H].copy()
        if make is held and k % 50 > 40:
            r[:, k % 3] = np.nan
        move = mpc.step(x, r)
        xs.append(x)
        rs.append(r)
        found.append([ACTIONS[move.action], move.missing, move.rejected, *move.u])
        z = model.step(z, move.u) + 1e-5 * rng.standard_normal(model.n_lifted)
    python = np.array(found)
    c = in_c(mpc, tmp_path, u0, np.array(xs), np.array(rs))
    np.testing.assert_array_equal(c[:, :3], python[:, :3])
    assert (make is bilinear or np.count_nonzero(python[:, 0]) > 5) and (python[:, 0] == 0.0).mean() > 0.8
    assert make is not observed or python[:, 2].any()
    np.testing.assert_allclose(c[:, 3:], python[:, 3:], rtol=0.0, atol=1e-9)  # 5e-8 of the half box


def test_without_measurements_it_goes_down_the_same_ladder(tmp_path: Path) -> None:
    """Shifted plan, steady target, hold, return to rest; Python's target is solved to 1e-8 by OSQP."""
    mpc = observed()
    mpc.reset(np.zeros(3))
    x = np.full((60, 6), np.nan)
    x[:3] = 0.01
    r = np.tile(np.array([0.2, -0.1]), (60, mpc.horizon, 1))
    moves = [mpc.step(row, window) for row, window in zip(x, r, strict=True)]
    c = in_c(mpc, tmp_path, np.zeros(3), x, r)
    assert [ACTIONS[move.action] for move in moves] == c[:, 0].tolist() and set(c[:, 0]) == {0.0, 1.0, 2.0, 3.0, 4.0}
    np.testing.assert_allclose(c[:, 3:], [move.u for move in moves], atol=1e-7)


def test_what_has_no_c_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="stuck_after=None"):
        delayed(stuck_after=5).to_c(tmp_path / "a.h")
    with pytest.raises(ValueError, match="leave y_min and y_max out"):
        delayed(y_max=1.0).to_c(tmp_path / "a.h")
    with pytest.raises(ValueError, match="C identifier"):
        delayed().to_c(tmp_path / "a.h", name="my arm")
    with pytest.raises(ValueError, match="whole steps of delay"):
        bilinear(command_delay=0.5).to_c(tmp_path / "a.h")
    assert not list(tmp_path.iterdir())
