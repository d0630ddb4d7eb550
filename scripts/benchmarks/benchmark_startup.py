"""CPU time of a new process up to its first result: import, first equilibrium of a rod, of the paper's arm, of disks.

Every figure is of processes that take turns, after one of each that does not count; smallest and median.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # the other rooms of scripts/

import numpy as np
from tqdm import tqdm

from common.report import Report, Target, parser, run

CASES: dict[str, tuple[str, Target | None]] = {
    "import pisplit": ("import pisplit", ("<=", 0.3)),
    "first equilibrium of a rod": (
        "from pisplit.models import rod\n"
        "scene = rod.Scene(rod.Rod(1.0, rod.Circle(0.01), rod.Elastic(1e9, 4e8, 1000.0)), rod.Gravity((-9.81, 0, 0)))\n"
        "assert scene.statics().solve().success",
        ("<=", 0.6),
    ),
    "first equilibrium of the paper's arm": (
        "import pisplit\nassert pisplit.TendonArm.paper().scene.statics().solve([0.01, -0.005, -0.005]).success",
        ("<=", 0.6),
    ),
    "first equilibrium of tendons over disks": (
        "import warnings; warnings.simplefilter('ignore')\n"
        "from pisplit.models.arm.disk_robot import disk_robot\n"
        "arm = disk_robot().arm\nassert arm.scene.statics().solve(arm.rest_inputs).success",
        None,
    ),
}
CLOCK = "\nimport time; print(time.process_time())"


def main() -> None:
    """Measure, print, write the figures."""
    given = parser(__doc__ or "").parse_args()
    report = Report.of("start of a process, CPU time", given)
    times: dict[str, list[float]] = {name: [] for name in CASES}
    for i in tqdm(range(2 if given.quick else 8), unit="round"):
        for name, (code, _) in CASES.items():
            command = [sys.executable, "-c", code + CLOCK]
            done = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True)
            if i:
                times[name].append(float(done.stdout.split()[-1]))
    for name, (_, target) in CASES.items():
        report.figure(f"{name}, smallest", min(times[name]), "s")
        report.figure(f"{name}, median", float(np.median(times[name])), "s", target)
    report.write(given.json)
    print(f"\n{report}")


if __name__ == "__main__":
    run(main)
