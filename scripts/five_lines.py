"""The five lines of the README at their real size: record, identify, tune, track; times and errors beside targets."""

from __future__ import annotations

import subprocess
import sys
import time
import warnings

import numpy as np

import pisplit as ps
from common.report import Report, parser, run


def main() -> None:
    """Run the five lines, print the report of the model and a table."""
    given = parser((__doc__ or "").splitlines()[0], out="out/five-lines").parse_args()
    few = given.quick
    report = Report.of("the five lines of the README", given)
    code = "import time; t = time.process_time(); import pisplit; print(time.process_time() - t)"
    imports = [
        float(subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout) for _ in "123"
    ]
    report.figure("import pisplit, CPU", min(imports), "s", ("<=", 0.3))
    begin = time.perf_counter()
    arm = ps.TendonArm.paper()
    d1, test = arm.record(4 if few else 10, given.seed), arm.record(2 if few else 4, given.seed + 1)
    report.figure("record", time.perf_counter() - begin, "s")
    lap = time.perf_counter()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        model = ps.identify(d1, arm=arm, candidates=["B-EDMDc", "PI-EDMDc, hold"] if few else None)
        print(model.report())
        report.figure("identify", time.perf_counter() - lap, "s")
        lap = time.perf_counter()
        mpc = model.mpc(u_max=0.016, du_max=0.002)
    print(f"\n{mpc}")
    report.figure("choose the weight", time.perf_counter() - lap, "s")
    lap = time.perf_counter()
    log = mpc.run(arm, ps.references.circle(radius=0.1, period=4.0), steps=200 if few else 400)
    report.figure("run", time.perf_counter() - lap, "s")
    report.figure("all five lines, wall", time.perf_counter() - begin, "s", ("<=", 60.0))
    score = model.score(test)
    report.figure("test roll-outs of 6 s, median squared shape error", score.median, "m^2")
    report.figure("test roll-outs that diverge", 100 * score.diverged_fraction, "%", ("<=", 0.0))
    report.figure("circle, RMS tip error", 1e3 * log.rms_error(after=2.0), "mm", ("<=", 1.07))
    report.figure("controller p99", 1e3 * float(np.percentile(log.solve_time, 99)), "ms")
    given.out.mkdir(parents=True, exist_ok=True)
    model.plot(given.out / "model.png")
    for name in ("run.html", "run.h5"):
        log.save(given.out / name)
    log.plot(given.out / "run.png")
    report.write(given.json)
    print(f"\n{log.summary()}\n\n{report}\n\npictures and page in {given.out}: model.png, run.png, run.html")


if __name__ == "__main__":
    run(main)
