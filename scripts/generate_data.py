"""Make training data of the paper's tendon arm: trajectories D1 and phase-space samples D2, as HDF5.

Parallel over cores and resumable: every finished block is on disk, a killed run continues where it stopped. The data
depend on --seed only, not on the number of workers.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from pathlib import Path

from joblib.externals.loky import get_reusable_executor

from common.report import Report, parser, run
from pisplit import Episodes, PhaseSamples
from pisplit.models.arm.phase_samples import deviations_from_equilibrium, make_phase_samples, phase_origin, strain_rates
from pisplit.models.arm.recording import check_origin, episodes_origin, make_episodes
from pisplit.models.arm.tendon_arm import TendonArm


def load_or_make(
    arm: TendonArm,
    folder: Path,
    episodes: int,
    samples: int,
    seed: int,
    steps: int = 200,
    dt: float = 0.03,
    workers: int = -1,
    paper_shapes: bool = False,
) -> tuple[Episodes, PhaseSamples]:
    """D1 and D2 from ``folder`` where they are there, else simulated and stored there.

    Raises ValueError for files that are damaged, hold data of another arm, or were made with other settings.
    """
    first = folder / f"d1-{episodes}x{steps}-seed{seed}.h5"
    second = folder / f"d2-{samples}-of-{episodes}x{steps}-seed{seed}{'-paper' if paper_shapes else ''}.h5"
    if first.exists():
        d1 = Episodes.load(first)
        check_origin(first, d1.provenance, episodes_origin(arm, steps, dt, seed=seed))
    else:
        d1 = make_episodes(arm, first, episodes, steps, dt, seed=seed, workers=workers)
    if second.exists():
        d2 = PhaseSamples.load(second)
        origin = phase_origin(arm, strain_rates(arm, d1), seed=seed)
        if not paper_shapes:
            del origin["deviations"]  # they follow from the arm and its rates; solving for them again takes a minute
        check_origin(second, d2.provenance, origin)
        return d1, d2
    deviations, rates = deviations_from_equilibrium(arm, d1)
    kept = None if paper_shapes else deviations
    return d1, make_phase_samples(arm, second, samples, rates, kept, seed=seed, workers=workers)


def arguments() -> argparse.Namespace:
    """Command line."""
    made = parser(__doc__ or "")
    made.add_argument("--episodes", type=int, default=64, help="trajectories in D1")
    made.add_argument("--steps", type=int, default=200, help="steps of a trajectory")
    made.add_argument("--dt", type=float, default=0.03, help="time step in s")
    made.add_argument("--samples", type=int, default=4000, help="phase-space samples in D2")
    made.add_argument("--workers", type=int, default=-1, help="processes; -1 = one a core")
    made.add_argument("--paper-shapes", action="store_true", help="D2 of static shapes only, as in the paper")
    made.add_argument("--compare-workers", action="store_true", help="time D1 with one and with two workers")
    return made.parse_args()


def main() -> None:
    """Make the data and report how long it took."""
    given = arguments()
    if given.quick:
        given.episodes, given.samples = min(given.episodes, 4), min(given.samples, 500)
    report = Report.of("data of the tendon arm", given)
    arm = TendonArm.paper()
    print(arm.scene)
    folder = given.out / "data"
    begin = time.perf_counter()
    d1, d2 = load_or_make(
        arm,
        folder,
        given.episodes,
        given.samples,
        given.seed,
        given.steps,
        given.dt,
        given.workers,
        given.paper_shapes,
    )
    report.figure("episodes", len(d1), "")
    report.figure("phase samples", len(d2), "")
    report.figure("time", time.perf_counter() - begin, "s")
    if given.compare_workers:
        seconds = {n: _time_of(arm, folder / f"compare-{n}.h5", given, n) for n in (1, 2)}
        of_64 = 64 / given.episodes * 200 / given.steps
        report.figure("64 episodes x 200 steps on 2 cores, no machine code", seconds[2] * of_64, "s", ("<=", 45.0))
        report.figure("speed-up of 2 cores over 1", seconds[1] / seconds[2], "", (">=", 2.0))
        if not given.quick:
            many = _time_of_many(folder / "compare-many.h5", given)
            report.figure("700 episodes x 200 steps on 2 cores, machine code made on the way", many, "s", ("<=", 60.0))
    print(report)
    report.write(given.json)


def _time_of(arm: TendonArm, path: Path, given: argparse.Namespace, workers: int) -> float:
    make_episodes(
        arm, path, 2 * workers, 2, given.dt, seed=given.seed, workers=workers, progress=False, compiled=False
    )  # start workers
    begin = time.perf_counter()
    make_episodes(arm, path, given.episodes, given.steps, given.dt, seed=given.seed, workers=workers, compiled=False)
    seconds = time.perf_counter() - begin
    path.unlink()
    return seconds


def _time_of_many(path: Path, given: argparse.Namespace) -> float:
    """Of 700 episodes by the paper's arm where no machine code is kept yet."""
    with tempfile.TemporaryDirectory() as cache:
        os.environ["XDG_CACHE_HOME"] = cache  # read when machine code is looked for, here and in the workers to come
        get_reusable_executor().shutdown(wait=True)
        begin = time.perf_counter()
        make_episodes(TendonArm.paper(), path, 700, 200, given.dt, seed=given.seed, workers=2)
        seconds = time.perf_counter() - begin
    path.unlink()
    return seconds


if __name__ == "__main__":
    run(main)
