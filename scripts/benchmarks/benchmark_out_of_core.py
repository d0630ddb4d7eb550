"""L-EDMDc with 723 columns on a file of recordings that is never in memory: time, largest memory, and what ten times
as many pairs would take.

The file is joined of parts of 100,000 pairs, as a campaign writes them. CPU time on one thread of this process.
"""

from __future__ import annotations

import resource
import subprocess
import sys
import tempfile
import time
from argparse import SUPPRESS
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # the other rooms of scripts/

import numpy as np
from threadpoolctl import threadpool_limits
from tqdm import tqdm

from benchmarks.benchmark_identification import sensor_data
from common.report import Report, parser, run
from pisplit import Dictionary, Episodes, LinearEDMDc
from pisplit import observables as ob

#: Pairs of a part of the file.
PART = 100_000


def main() -> None:
    """Write the parts, join them, learn, print."""
    made = parser(__doc__ or "")
    made.add_argument("--pairs", type=int, default=1_000_000, help="pairs in the file")
    made.add_argument("--worker", type=Path, default=None, help=SUPPRESS)
    given = made.parse_args()
    if given.worker is not None:
        learn(given.worker)
        return
    report = Report.of("out of core", given)
    pairs = 2 * PART if given.quick else given.pairs
    with tempfile.TemporaryDirectory() as folder:
        whole = write(Path(folder), max(1, pairs // PART), given.seed, report)
        command = [sys.executable, __file__, "--worker", str(whole)]
        done = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True)
        figures = dict(zip(("load", "fit", "memory", "used"), map(float, done.stdout.split()), strict=True))
    size = figures["used"]
    report.figure("pairs", size, "")
    report.figure("verify and map the file", figures["load"], "s")
    report.figure("fit, moments included", figures["fit"], "s", None if given.quick else ("<=", 25.0 * size / 1e6))
    report.figure("largest memory of the process", figures["memory"], "MB", ("<=", 1000.0))
    # Time grows with the pairs; memory with four numbers of eight bytes a pair, their places in the file.
    report.figure("extrapolated to 1e7 pairs, fit", figures["fit"] * 1e7 / size, "s")
    report.figure("extrapolated to 1e7 pairs, memory", figures["memory"] + 32e-6 * (1e7 - size), "MB", ("<=", 1000.0))
    report.write(given.json)
    print(f"\n{report}")


def write(folder: Path, parts: int, seed: int, report: Report) -> Path:
    """The file of so many parts in ``folder``."""
    paths = []
    for i in tqdm(range(parts), desc="recordings", unit="file"):
        x, u = sensor_data(np.random.default_rng([seed, i]), PART + 5)
        paths.append(folder / f"{i}.h5")
        Episodes([x], [u[:-1]], 0.03).save(paths[-1])
    begin = time.process_time()
    Episodes.join(paths, folder / "all.h5")
    report.figure("join the parts", time.process_time() - begin, "s")
    for path in paths:
        path.unlink()
    return folder / "all.h5"


def learn(path: Path) -> None:
    """Print seconds of loading and of the fit, megabytes of this process, and the number of pairs."""
    begin = time.process_time()
    d1 = Episodes.load(path, mapped=True)
    loaded = time.process_time()
    theta = Dictionary(ob.Identity(), ob.Delays(states=4), n_states=d1.n_states, n_inputs=d1.n_inputs)
    with threadpool_limits(1):
        LinearEDMDc(theta, alpha=1e-6).fit(d1)
    fitted = time.process_time()
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
    print(loaded - begin, fitted - loaded, memory, len(d1.pairs(4)))


if __name__ == "__main__":
    run(main)
