"""Work-precision of the rod in motion: error against CPU time, beside PyElastica and a method of lines (numpy, scipy).

A clamped rod under a tip load that ramps up and stays, once soft (E = 1 MPa, r = 1 cm) and once steel (E = 207 GPa,
r = 1 mm), in one process. PyElastica (``pip install pisplit[bench]``) runs with its largest stable step, and with its
clamp, which is first order, moved by half an element. All codes share the load, the shear correction and a drag
proportional to mass. Errors are the largest distance of the tip from a reference by Radau of order 5 on twice the
nodes, in parts of the largest travel of the tip. Static solves and their peer are in ``benchmark.py``.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import partial
from importlib.util import find_spec
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
from report import Report, parser
from report import run as run_script
from rod_peers import SOFT, STEEL, Case, Run, error, run_elastica, run_lines, run_pisplit, run_reference
from tqdm import tqdm

#: Free strains of our rods: the soft rod shears, the steel rod does not (its shear is 1e-5 of its bending).
STRAINS = {"soft": "cosserat", "steel": "kirchhoff"}
#: Errors at which codes are compared, and how many times faster than PyElastica the rod shall be there.
GOALS = {"soft": (3e-4, 5.0), "steel": (1e-3, 500.0)}


def settings(quick: bool) -> list[tuple[int, float]]:
    """Nodes and tolerances of our runs."""
    if quick:
        return [(3, 1e-3), (4, 3e-4), (4, 1e-4), (5, 1e-4), (6, 1e-4)]
    return [(k, rtol) for k in (3, 4, 5, 6) for rtol in (1e-3, 3e-4, 1e-4, 3e-5, 1e-5)]


def measure(case: Case, quick: bool) -> list[tuple[Run, float]]:
    """All runs of a case with their errors."""
    strains = STRAINS[case.name]
    reference = run_reference(case, strains, 6, 1e-5) if quick else run_reference(case, strains, 8, 1e-6)
    jobs: list[Callable[[], Run]] = []
    jobs += [partial(run_pisplit, case, strains, *setting) for setting in settings(quick)]
    if not quick:
        jobs += [partial(run_pisplit, case, strains, k, r, True) for k in (4, 5, 6) for r in (3e-4, 1e-4, 3e-5)]
    short = 4 if quick and case is STEEL else None
    jobs += [partial(run_elastica, case, n, short) for n in ((20, 50) if quick else (10, 20, 50, 100))]
    if not (quick and case is STEEL):  # fast waves: many minutes of BDF steps on fine meshes
        lines = (10,) if quick or case is STEEL else (10, 20, 40)
        jobs += [partial(run_lines, case, n, 1e-4) for n in lines]
    runs = [job() for job in tqdm(jobs, desc=f"{case.name} rod", unit="run")]
    return [(run, error(run, reference)) for run in runs]


def table(case: Case, rows: list[tuple[Run, float]]) -> str:
    """One line a run, from the least to the largest error of each code."""
    lines = [f"{case.name}: F L^2/EI = {case.load:g}, {case.span:g} s simulated"]
    lines.append(f"  {'code':<34}{'setting':<26}{'ms per 0.03 s':>14}{'error':>10}")
    for run, off in sorted(rows, key=lambda row: (row[0].code, row[1])):
        note = "  time extrapolated from a shorter span" if run.extrapolated else ""
        lines.append(f"  {run.code:<34}{run.setting:<26}{per_interval(case, run):>14.3f}{off:>10.1e}{note}")
    return "\n".join(lines)


def per_interval(case: Case, run: Run) -> float:
    """CPU time in ms per 0.03 s simulated."""
    return 1e3 * run.seconds * 0.03 / case.span


def compare(report: Report, case: Case, rows: list[tuple[Run, float]]) -> None:
    """Fastest run of each code below the error of the goal; where PyElastica has none, its most accurate run."""
    limit, factor = GOALS[case.name]
    peers = [row for row in rows if row[0].code == "PyElastica"]
    accurate = [row for row in peers if row[1] <= limit]
    peer, peer_error = min(accurate, key=lambda r: r[0].seconds) if accurate else min(peers, key=lambda r: r[1])
    report.figure(f"{case.name}: PyElastica, {peer.setting}", per_interval(case, peer), "ms per 0.03 s")
    report.figure(f"{case.name}: its error", peer_error, "of tip travel")
    for code in sorted({run.code for run, _ in rows if run.code.startswith("pisplit")}):
        good = [row for row in rows if row[0].code == code and row[1] <= min(limit, peer_error)]
        if good:
            ours, off = min(good, key=lambda row: row[0].seconds)
            report.figure(f"{case.name}: {code}, {ours.setting}", per_interval(case, ours), "ms per 0.03 s")
            report.figure(f"{case.name}: {code}, its error", off, "of tip travel", ("<=", limit))
            ratio = peer.seconds / ours.seconds
            report.figure(f"{case.name}: {code}, times faster than PyElastica", ratio, "", (">=", factor))


def draw(results: dict[str, list[tuple[Run, float]]], path: Path) -> None:
    """Error against CPU time, one panel a rod."""
    figure, axes = plt.subplots(1, len(results), figsize=(6.2 * len(results), 5.0), constrained_layout=True)
    marks = {"PyElastica": ("#d95f02", "s"), "numpy + scipy BDF, plane": ("#7a7a7a", "^")}
    for axis, (name, rows) in zip(axes, results.items(), strict=True):
        case = SOFT if name == "soft" else STEEL
        for code in sorted({run.code for run, _ in rows}):
            own = ("#0f9d76", "D") if code.endswith("compiled") else ("#1b6ca8", "o")
            colour, mark = marks.get(code, own)
            points = sorted((per_interval(case, run), off) for run, off in rows if run.code == code)
            line = "-" if code in marks else ""
            axis.loglog(*zip(*points, strict=True), mark, ls=line, color=colour, ms=6, alpha=0.85, label=code)
        axis.axhline(GOALS[name][0], color="k", lw=0.7, ls=":")
        axis.set(title=f"{name} rod", xlabel="CPU time (ms per 0.03 s simulated)", ylabel="tip error / tip travel")
        axis.grid(alpha=0.25)
        axis.spines[["top", "right"]].set_visible(False)
        axis.legend(frameon=False, fontsize=8)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=140)
    plt.close(figure)


def main() -> None:
    made = parser(__doc__ or "")
    arguments = made.parse_args()
    if find_spec("elastica") is None:
        made.error("PyElastica is not installed; get it by: pip install pyelastica")
    report = Report.of("rod against peers", arguments)
    results = {}
    for case in (SOFT, STEEL):
        results[case.name] = measure(case, arguments.quick)
        print(table(case, results[case.name]))
        compare(report, case, results[case.name])
    draw(results, arguments.out / "benchmark_rod.png")
    print(report)
    report.write(arguments.json)


if __name__ == "__main__":
    run_script(main)
