"""Work-precision of the rod, at rest and in motion: error against CPU time, beside other codes in one run.

Motion: a clamped rod under a tip load that ramps up and stays, once soft (E = 1 MPa, r = 1 cm) and once steel
(E = 207 GPa, r = 1 mm). PyElastica (``pip install pisplit[bench]``) runs with its largest stable step, and with its
clamp, which is first order, moved by half an element. Exudyn (``pip install exudyn``) runs with the elements, steps and
Newton settings that serve it best on each rod (``rod_exudyn.py``). All codes share the load, the shear correction and a
drag proportional to mass; the method of lines (numpy + scipy BDF) is plane, and so are runs that say so; all others are
spatial. Errors are the largest distance of the tip from a reference by Radau of order 5 on 8 nodes, in parts of the
largest travel of the tip. Codes are compared at equal error along their fronts (fastest run at each error),
interpolated between runs. Every code has a process of its own; all take turns in five rounds, warm; times are medians,
and the least beside them. Plane codes are compared with Exudyn by their least times.

Rest: the same rods under the full load. Errors are the distance of the tip from the exact answer, in parts of L.
PyElastica has no static solver (it would relax a damped motion); peers are a numpy shooting method and ``solve_bvp``.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from importlib.util import find_spec
from multiprocessing import get_context
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # the other rooms of scripts/

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from tqdm import tqdm

from benchmarks.rod_exudyn import SETTINGS, run_exudyn
from benchmarks.rod_peers import (
    SOFT,
    STEEL,
    Case,
    Run,
    error,
    run_elastica,
    run_gauss,
    run_idas,
    run_large,
    run_lines,
    run_reference,
)
from benchmarks.rod_static_peers import Solve, exact_tip, solve_by_collocation, solve_by_pisplit, solve_by_shooting
from common.drawing import save_figure
from common.report import Report, parser
from common.report import run as run_script

#: Free strains of our rods: the soft rod shears, the steel rod does not (its shear is 1e-5 of its bending).
STRAINS = {"soft": "cosserat", "steel": "kirchhoff"}
PLANE = {"soft": "planar-cosserat", "steel": "planar"}
#: Rounds in which all codes take turns, quick and else.
ROUNDS = (1, 5)
#: Errors at which codes are compared, and how many times faster than PyElastica the rod shall be there.
GOALS = {"soft": (3e-4, 5.0), "steel": (1e-3, 500.0)}
#: Errors at which plane codes are compared with Exudyn, and the goals there.
PLANE_GOALS = {1e-3: 1.0, 3e-4: 5.0, 1.7e-4: 1.0}
#: Codes that come with a package of their own: its import name, and how to get it.
PEERS = {"PyElastica": ("elastica", "pyelastica"), "Exudyn": ("exudyn", "exudyn")}
COLOURS = {
    "pisplit IDAS": ("#1b6ca8", "o"),
    "pisplit IDAS, direct": ("#8ab8d8", "o"),
    "pisplit IDAS, compiled": ("#0b3c5d", "o"),
    "pisplit Gauss": ("#0f9d76", "D"),
    "pisplit Gauss, compiled": ("#0a5c46", "D"),
    "pisplit large steps, plane": ("#e8a33d", "X"),
    "pisplit large steps, plane, compiled": ("#8a5a00", "X"),
    "pisplit large steps": ("#c8553d", "P"),
    "pisplit large steps, compiled": ("#7d2e1f", "P"),
    "pisplit": ("#1b6ca8", "o"),
    "pisplit, plane": ("#0f9d76", "D"),
    "PyElastica": ("#d95f02", "s"),
    "Exudyn, plane": ("#b03a5b", "d"),
    "numpy + scipy BDF, plane": ("#7a7a7a", "^"),
    "numpy shooting (RK4), plane": ("#7a7a7a", "^"),
    "scipy solve_bvp, plane": ("#a05195", "v"),
}


def motion_jobs(case: Case, quick: bool) -> dict[str, list[Callable[[], Run]]]:
    """All runs of a case by code."""
    strains = STRAINS[case.name]
    idas, gauss, large = (partial(f, case, strains) for f in (run_idas, run_gauss, run_large))
    plane = partial(run_large, case, PLANE[case.name])
    if quick:
        return {
            "IDAS": [partial(idas, k, r) for k, r in ((4, 1e-3), (4, 1e-4), (5, 1e-4))],
            "Gauss": [partial(gauss, k, s, 1) for k, s in ((4, 1), (4, 2), (5, 2))],
            "large": [partial(large, k, 2, 1) for k in (3, 4)],
            "large, plane": [partial(plane, k, 2, 1) for k in (3, 4)],
            "PyElastica": [partial(run_elastica, case, n, 4 if case is STEEL else None) for n in (20, 50)],
            "Exudyn": [partial(run_exudyn, case, *setting) for setting in SETTINGS[case.name][::4]],
            "lines": [partial(run_lines, case, 10, 1e-4)] if case is SOFT else [],
        }
    tolerances, fewer = (1e-3, 3e-4, 1e-4, 3e-5), (1e-3, 1e-4, 3e-5)
    schemes, steps = ((1, 1), (1, 2), (1, 4), (2, 1), (2, 2)), ((2, 1), (3, 1), (2, 2))
    return {
        "IDAS": [partial(idas, k, r) for k in (3, 4, 5, 6) for r in tolerances],
        "IDAS, direct": [partial(idas, k, r, balance="direct") for k in (4, 5) for r in fewer],
        "IDAS, compiled": [partial(idas, k, r, True) for k in (4, 5) for r in fewer],
        "Gauss": [partial(gauss, k, *scheme) for k in (3, 4, 5, 6) for scheme in schemes],
        "Gauss, compiled": [partial(gauss, k, *scheme, True) for k in (4, 5) for scheme in schemes],
        "large": [partial(large, k, *step) for k in (3, 4, 5) for step in steps],
        "large, compiled": [partial(large, k, *step, True) for k in (3, 4, 5) for step in steps],
        "large, plane": [partial(plane, k, *step) for k in (3, 4, 5, 6) for step in steps],
        "large, plane, compiled": [partial(plane, k, *step, True) for k in (3, 4, 5, 6) for step in steps],
        "PyElastica": [partial(run_elastica, case, n) for n in ((10, 20, 50, 100) if case is SOFT else (10, 20, 50))],
        "Exudyn": [partial(run_exudyn, case, *setting) for setting in SETTINGS[case.name]],
        "lines": [partial(run_lines, case, n, 1e-4) for n in (10, 20, 40)],
    }


def measure_motion(case: Case, quick: bool, only: list[str], rounds: int) -> list[tuple[Run, float]]:
    """Runs of a case with their errors: codes with one of ``only`` in the name, in processes of their own, in turns."""
    reference = run_reference(case, STRAINS[case.name], *((6, 1e-5) if quick else (8, 1e-6)))
    missing = [code for code, (package, _) in PEERS.items() if find_spec(package) is None]
    jobs = {code: runs for code, runs in motion_jobs(case, quick).items() if runs and any(o in code for o in only)}
    jobs = {code: runs for code, runs in jobs.items() if code not in missing}
    found: dict[tuple[str, int], list[Run]] = {}
    fresh = get_context("spawn")  # nothing of one code is loaded where another runs
    with ExitStack() as stack:
        homes = {code: stack.enter_context(ProcessPoolExecutor(1, fresh)) for code in jobs}
        bar = stack.enter_context(tqdm(total=rounds * sum(map(len, jobs.values())), desc=f"{case.name} rod, motion"))
        for _ in range(rounds):
            for code, runs in jobs.items():
                for k, job in enumerate(runs):
                    done = found.setdefault((code, k), [])
                    if not done or done[-1].success:  # what does not finish is not tried again
                        done.append(homes[code].submit(job).result())
                    bar.update()
    return [(run, error(run, reference)) for run in map(summary, found.values())]


def summary(runs: list[Run]) -> Run:
    """One run with the median time of its rounds, and the least."""
    seconds = [run.seconds for run in runs]
    return replace(runs[-1], seconds=float(np.median(seconds)), least=min(seconds))


def measure_rest(case: Case, quick: bool) -> list[Solve]:
    """All static solves of a case."""
    shear = case.name == "soft"
    tip = exact_tip(case, shear)
    strains, plane = STRAINS[case.name], PLANE[case.name]
    nodes, steps = ((3, 5, 7), (5, 20, 80)) if quick else (range(2, 10), (3, 5, 10, 20, 40, 80, 160))
    jobs: list[Callable[[], Solve]] = []
    jobs += [partial(solve_by_pisplit, case, kind, k, tip) for kind in (strains, plane) for k in nodes]
    jobs += [partial(solve_by_shooting, case, shear, n, tip) for n in steps]
    jobs += [partial(solve_by_collocation, case, shear, 10.0**-k, tip) for k in ((3, 6) if quick else range(2, 11))]
    return [job() for job in tqdm(jobs, desc=f"{case.name} rod, rest", unit="solve")]


def motion_table(case: Case, rows: list[tuple[Run, float]]) -> str:
    """One line a run, from the least to the largest error of each code."""
    lines = [f"{case.name} rod in motion: F L^2/EI = {case.load:g}, {case.span:g} s simulated"]
    lines.append(f"  {'code':<38}{'setting':<56}{'ms per 0.03 s':>14}{'least':>10}{'error':>10}")
    for run, off in sorted(rows, key=lambda row: (row[0].code, row[1])):
        times = f"{per_interval(case, run.seconds):>14.3f}{per_interval(case, run.least):>10.3f}"
        lines.append(f"  {run.code:<38}{run.setting:<56}{times}{off:>10.1e}{run.note}")
    return "\n".join(lines)


def rest_table(case: Case, rows: list[Solve]) -> str:
    """One line a solve."""
    lines = [f"{case.name} rod at rest: F L^2/EI = {case.load:g}"]
    lines.append(f"  {'code':<30}{'setting':<26}{'ms':>10}{'error / L':>12}")
    lines += [f"  {r.code:<30}{r.setting:<26}{1e3 * r.seconds:>10.3f}{r.error:>12.1e}" for r in rows]
    return "\n".join(lines)


def per_interval(case: Case, seconds: float) -> float:
    """CPU time in ms per 0.03 s simulated, of ``seconds`` for all of it."""
    return 1e3 * seconds * 0.03 / case.span


def front(points: list[tuple[float, float]]) -> list[tuple[float, float]]:
    """(time, error) of the runs that no faster run beats in error, from the fastest on."""
    kept: list[tuple[float, float]] = []
    for time, off in sorted(points):
        if np.isfinite(off) and (not kept or off < kept[-1][1]):
            kept.append((time, off))
    return kept


def time_at(points: list[tuple[float, float]], limit: float) -> float:
    """Time along the front at an error, interpolated in logarithms; NaN where no run is that accurate."""
    line = front(points)
    if not line or line[-1][1] > limit:
        return float("nan")
    times, errors = (np.log(np.array(column)) for column in zip(*line, strict=True))
    return float(np.exp(np.interp(-np.log(limit), -errors, times)))


def compare(report: Report, case: Case, rows: list[tuple[Run, float]]) -> None:
    """Times of all codes at the error of the goal, and how many times faster than PyElastica they are."""
    limit, factor = GOALS[case.name]
    points = points_of(case, rows)
    if "PyElastica" not in points:
        return
    peer = time_at(points["PyElastica"], limit)
    for code, found in points.items():
        at = time_at(found, limit)
        if not np.isfinite(at):
            print(f"{case.name}: no run of {code} is within {limit:g}")
            continue
        report.figure(f"{case.name}: {code}, at error {limit:g}", at, "ms per 0.03 s")
        if code.startswith("pisplit"):
            report.figure(f"{case.name}: {code}, times faster than PyElastica", peer / at, "")
    least = [(per_interval(case, r.least), e) for r, e in rows if r.code == "PyElastica"]
    report.figure(f"{case.name}: PyElastica, least time, at error {limit:g}", time_at(least, limit), "ms per 0.03 s")
    interpreted = ("pisplit IDAS", "pisplit Gauss", "pisplit large steps")
    own = [time_at(found, limit) for code, found in points.items() if code in interpreted]
    if own:
        name = f"{case.name}: best without compiler, times faster than PyElastica at error {limit:g}"
        report.figure(name, peer / float(np.nanmin(own)), "", (">=", factor))


def compare_plane(report: Report, case: Case, rows: list[tuple[Run, float]]) -> None:
    """Least times of plane codes at three errors, and how many times faster than Exudyn ours are there."""
    points = points_of(case, rows, least=True)
    peer = points.get("Exudyn, plane")
    if peer is None:
        return
    for limit, factor in PLANE_GOALS.items():
        theirs = time_at(peer, limit)
        report.figure(f"{case.name}: Exudyn, plane, at error {limit:g}", theirs, "ms per 0.03 s")
        for code in ("pisplit large steps, plane", "pisplit large steps, plane, compiled"):
            own = time_at(points.get(code, []), limit)
            if np.isfinite(own):
                report.figure(f"{case.name}: {code}, at error {limit:g}", own, "ms per 0.03 s")
                name = f"{case.name}: {code}, times faster than Exudyn at error {limit:g}"
                report.figure(name, theirs / own, "", None if "compiled" in code else (">=", factor))


def points_of(case: Case, rows: list[tuple[Run, float]], least: bool = False) -> dict[str, list[tuple[float, float]]]:
    """(ms per 0.03 s, error) of the runs of every code, by the median of all rounds or the ``least`` time."""
    times = [(r.code, per_interval(case, r.least if least else r.seconds), e) for r, e in rows]
    return {code: [(time, e) for name, time, e in times if name == code] for code in codes(rows)}


def codes(rows: list[tuple[Run, float]]) -> list[str]:
    """Codes in the order of their first run."""
    return list(dict.fromkeys(run.code for run, _ in rows))


def lines_of(axis: Any, points: dict[str, list[tuple[float, float]]]) -> None:
    """Runs as marks, the front of each code as a line."""
    for code, found in points.items():
        colour, mark = COLOURS[code]
        shown = [point for point in found if np.isfinite(point[1]) and point[1] > 0.0]
        if shown:
            axis.loglog(*zip(*shown, strict=True), mark, ls="", color=colour, ms=4.5, alpha=0.45)
            axis.loglog(*zip(*front(shown), strict=True), marker=mark, color=colour, ms=4.5, lw=1.5, label=code)
    axis.grid(alpha=0.25)
    axis.spines[["top", "right"]].set_visible(False)
    axis.legend(frameon=False, fontsize=8)


def draw(motion: dict[str, list[tuple[Run, float]]], rest: dict[str, list[Solve]], path: Path) -> None:
    """Error against CPU time: motion above, rest below, one column a rod."""
    figure, axes = plt.subplots(2, len(motion), figsize=(6.6 * len(motion), 9.4), constrained_layout=True)
    for column, (name, rows) in zip(axes.T, motion.items(), strict=True):
        case = SOFT if name == "soft" else STEEL
        lines_of(column[0], points_of(case, rows))
        column[0].axhline(GOALS[name][0], color="k", lw=0.7, ls=":")
        column[0].set(
            title=f"{name} rod in motion (lines: fronts; dotted: error of the goal)",
            xlabel="CPU time (ms per 0.03 s simulated)",
            ylabel="largest tip error / largest tip travel",
        )
        found = rest[name]
        names = dict.fromkeys(r.code for r in found)
        lines_of(column[1], {c: [(1e3 * r.seconds, r.error) for r in found if r.code == c] for c in names})
        column[1].set(title=f"{name} rod at rest", xlabel="CPU time of a solve (ms)", ylabel="tip error / L")
    save_figure(figure, path, dpi=120)


def main() -> None:
    made = parser(__doc__ or "")
    made.add_argument("--only", nargs="*", default=[""], help="codes whose names have one of these in them")
    made.add_argument("--rounds", type=int, help="in which all codes take turns: 5, or 1 with --quick")
    arguments = made.parse_args()
    for code, (package, source) in PEERS.items():
        if find_spec(package) is None:
            print(f"{code} is left out: it is not installed; get it by: pip install {source}")
    rounds = arguments.rounds or ROUNDS[0 if arguments.quick else 1]
    report = Report.of("rod against peers", arguments)
    motion, rest = {}, {}
    for case in (SOFT, STEEL):
        rest[case.name] = measure_rest(case, arguments.quick)
        motion[case.name] = measure_motion(case, arguments.quick, arguments.only, rounds)
        print(rest_table(case, rest[case.name]))
        print(motion_table(case, motion[case.name]))
        compare(report, case, motion[case.name])
        compare_plane(report, case, motion[case.name])
        for code in dict.fromkeys(r.code for r in rest[case.name]):
            at = time_at([(1e3 * r.seconds, r.error) for r in rest[case.name] if r.code == code], 1e-6)
            report.figure(f"{case.name} at rest: {code}, at error 1e-6 L", at, "ms")
    draw(motion, rest, arguments.out / "benchmark_rod.png")
    print(report)
    report.write(arguments.json)


if __name__ == "__main__":
    run_script(main)
