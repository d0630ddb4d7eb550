"""Time of one MPC move whose model is the arm itself, and what the loop that it closes misses.

``python scripts/benchmarks/benchmark_physical.py``
"""

from __future__ import annotations

import sys
from importlib.util import find_spec
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # the other rooms of scripts/

import numpy as np
from threadpoolctl import threadpool_limits

from common.report import Report, parser, run
from pisplit.controllers import MPC, ClosedLoop, QPSettings, references
from pisplit.front import physical_model
from pisplit.models.arm import TendonArm

HORIZON = 20
DT = 0.03
#: Moves at the start that are not counted: they hold what is built once.
FIRST = 3


def measure_physical(report: Report, quick: bool) -> None:
    """A circle of 0.1 m in 4 s on the paper's arm, by the arm's equations, with either solver."""
    arm = TendonArm.paper()
    model = physical_model(arm, DT)
    for solver in ["osqp"] + (["daqp"] if find_spec("daqp") else []):
        settings = QPSettings(solver=solver)
        mpc = MPC(model, HORIZON, -0.014, 0.016, 0.002, rate_weight=1e-3, qp=settings)
        loop = ClosedLoop(arm.scene.fast_stepper(dt=DT), mpc)
        log = loop.run(references.circle(radius=0.1, period=4.0), 40 if quick else 400, u0=arm.rest_inputs)
        spent = 1e3 * np.asarray(log.cpu_time)[FIRST:]
        label = f"MPC move by the arm's equations, H = {HORIZON}, {solver.upper()}"
        asked = 12.0 if solver == "osqp" else 10.0
        report.figure(f"{label}, minimum", float(spent.min()), "ms")
        report.figure(f"{label}, median", float(np.median(spent)), "ms")
        report.figure(f"{label}, p99", float(np.percentile(spent, 99)), "ms", ("<=", asked))
        report.figure(f"{label}, maximum", float(spent.max()), "ms", ("<=", 20.0))
        report.figure(f"{label}, the three before, maximum", float(1e3 * np.max(log.cpu_time[:FIRST])), "ms")
        report.figure(f"{label}, RMS of the tip", 1e3 * float(np.sqrt(np.mean(log.error**2))), "mm")
        report.figure(f"{label}, fallbacks", float(log.fallbacks), "")


def main() -> None:
    """Measure, print, write the figures."""
    given = parser(__doc__ or "").parse_args()
    report = Report.of("MPC on the equations of an arm, CPU time on one thread", given)
    with threadpool_limits(1):
        measure_physical(report, given.quick)
    report.write(given.json)
    print(f"\n{report}")


if __name__ == "__main__":
    run(main)
