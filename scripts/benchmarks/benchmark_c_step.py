"""The step of an MPC on a model of 723 columns in C: agreement with Python, time of a step, size of the code.

A circle of 0.1 m in 4 s with noise; times are CPU times of the compiled step alone (cc -O3 -march=native).
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # the other rooms of scripts/

import numpy as np
from threadpoolctl import threadpool_limits
from tqdm import tqdm

from benchmarks.benchmark_control import COLUMNS, DT, HORIZON, arm_like_model
from common.report import Report, parser, run
from pisplit.controllers import MPC, QPSettings

MAIN = """
#define _POSIX_C_SOURCE 199309L
#include <stdio.h>
#include <time.h>
#include "arm.h"
static double now(void) {
  struct timespec t;
  clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
  return 1e3 * t.tv_sec + 1e-6 * t.tv_nsec;
}
int main(void) {
  static arm_state s;
  static double x[ARM_STATES], r[ARM_HORIZON * ARM_OUTPUTS], u[ARM_INPUTS];
  arm_reset(&s, u);
  while (fread(x, sizeof(double), ARM_STATES, stdin) == ARM_STATES) {
    if (fread(r, sizeof(double), ARM_HORIZON * ARM_OUTPUTS, stdin) != ARM_HORIZON * ARM_OUTPUTS) return 2;
    const double start = now();
    arm_step(&s, x, r, u);
    const double told[2] = {now() - start, s.iterations};
    fwrite(told, sizeof(double), 2, stdout);
    fwrite(u, sizeof(double), ARM_INPUTS, stdout);
  }
  fprintf(stderr, "%zu", sizeof(arm_state));
  return 0;
}
"""


def main() -> None:
    """Export, compile, run both, compare."""
    given = parser((__doc__ or "").splitlines()[0]).parse_args()
    report = Report.of(f"C step, M = {COLUMNS}, H = {HORIZON}", given)
    rng = np.random.default_rng([given.seed, 1])
    model, steps = arm_like_model(np.random.default_rng(given.seed)), 200 if given.quick else 1000
    exact = QPSettings(solver="daqp", eps=1e-10)
    mpc = MPC(model, HORIZON, -0.015, 0.015, 0.002, rate_weight=0.01, qp=exact, stuck_after=None)
    angle = 2.0 * np.pi * DT / 4.0 * np.arange(steps + HORIZON + 1)
    circle = 0.1 * np.stack([np.cos(angle) - 1.0, np.sin(angle), 0.0 * angle], axis=1)
    state, rows, moves, spent = np.zeros(COLUMNS), [], [], []
    with threadpool_limits(1):
        for k in tqdm(range(steps), desc="Python", unit="step"):
            window = circle[k + 1 : k + 1 + HORIZON]
            move = mpc.step(state, window)
            rows.append(np.concatenate([state, window.ravel()]))
            moves.append(move.u)
            spent.append(1e3 * move.cpu_time)
            state = model.A @ state + model.B @ move.u + 1e-4 * rng.standard_normal(COLUMNS)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        mpc.to_c(folder / "arm.h", name="arm")
        (folder / "main.c").write_text(MAIN)
        command = ["cc", "-std=c99", "-O3", "-march=native", "main.c", "-lm", "-o", "main"]
        subprocess.run(command, cwd=folder, check=True)
        told = subprocess.run([str(folder / "main")], input=np.array(rows).tobytes(), capture_output=True, check=True)
        binary, header = (folder / "main").stat().st_size, (folder / "arm.h").stat().st_size
    found = np.frombuffer(told.stdout).reshape(steps, -1)
    report.figure("largest difference of inputs", float(np.abs(found[:, 2:] - moves).max()), "m", ("<=", 1e-8))
    report.figure("step, median", float(np.median(found[:, 0])), "ms", ("<=", 0.2))
    report.figure("step, p99", float(np.percentile(found[:, 0], 99)), "ms")
    report.figure("step, maximum", float(found[:, 0].max()), "ms")
    report.figure("iterations of the program, most", int(found[:, 1].max()), "")
    report.figure("step in Python, median", float(np.median(spent)), "ms")
    report.figure("compiled program", binary / 1e6, "MB")
    report.figure("header", header / 1e6, "MB")
    report.figure("state of the controller", int(told.stderr) / 1e6, "MB")
    report.write(given.json)
    print(report)


if __name__ == "__main__":
    run(main)
