"""Run times and errors of rod and controller against their targets, with general solvers as peers in the same run.

CPU times on one thread. ``make bench ARGS="--json out/benchmark.json"`` passes arguments through.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # the other rooms of scripts/

from benchmarks.benchmark_control import measure_control
from benchmarks.benchmark_dynamics import measure_dynamics
from benchmarks.benchmark_statics import measure_statics
from common.report import Report, parser, run


def on_one_thread() -> None:
    """Start again with one thread of linear algebra: the setting is read when numpy is loaded."""
    if os.environ.get("OMP_NUM_THREADS") != "1":
        os.environ |= {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
        os.execv(sys.executable, [sys.executable, *sys.argv])


def main() -> None:
    """Measure, print, draw, and write the figures."""
    on_one_thread()
    given = parser((__doc__ or "").splitlines()[0], out="out/benchmark").parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    report = Report.of("rod and controller, CPU time on one thread", given)
    measure_statics(report, given.quick, given.seed)
    measure_dynamics(report, given.quick, given.seed, given.out)
    measure_control(report, given.quick, given.seed)
    report.write(given.json)
    print(f"\n{report}\n\nplot: {given.out / 'work_precision.png'}")


if __name__ == "__main__":
    run(main)
