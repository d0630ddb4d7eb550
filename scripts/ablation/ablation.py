"""Every construction and baseline on the same draws: error of open-loop roll-outs over the number of recorded pairs.

Arms, input laws, noise and wrong physics are scenarios (``scenarios.py``), methods are in ``methods.py``. All
methods get the same pairs and the same held-out training episodes for their choices; no fit sees the test episodes.
The twin was built with test errors of seeds 0 to 4 in view (docs/ablation.md); other seeds are fresh data.
Errors are medians with quartiles over all steps of all test roll-outs of all draws; a roll-out that diverges counts as
infinite from there on. Cells are kept on disk: a killed run continues.
"""

from __future__ import annotations

import csv
import io
import os
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # the other rooms of scripts/

import numpy as np

from ablation.figures import Table, draw_noise, draw_sizes
from ablation.methods import methods
from ablation.scenarios import NOISE_CURVE, OTHER_ROBOT, PHASE_SAMPLES, ScenarioSource, scenarios
from common.protocol import HELD_OUT, HISTORY, summary
from common.report import Report, parser, run
from common.runs import Cell, Result, run_cells
from pisplit.files import write_text
from pisplit.models.arm.tendon_arm import TendonArm

MAIN = "paper arm"
BASELINES = ("L-EDMDc", "B-EDMDc")
#: The same, chosen among models that stay bounded under the inputs the twin's must stay bounded under.
BOUNDED = ("L-EDMDc, bounded", "B-EDMDc, bounded")
INFORMED = ("L-EDMDc, rod + x_eq", "B-EDMDc, rod + x_eq")
OURS = "PI twin"
#: The calibrated arm as predictor, and a model for MPC of its simulated recordings.
DIRECT, SIMULATED = "arm itself", "arm simulated"
#: Scenarios beside the main one, and the methods they run.
OTHERS = (*BASELINES, "PI hold", OURS)
#: Pairs (steps) of the rows that are run at one size.
ONE_SIZE = 64
#: Pairs of the curve over the level of noise.
NOISE_PAIRS = 128
#: Draws of the row whose every fit simulates its pairs some hundred times.
SLOW_DRAWS = 2
#: Splits that need the table of equilibria over differential pulls.
TABLED = (*INFORMED, "PI Strang, rod + x_eq", "PI balanced", "PI hold")


@dataclass(frozen=True)
class Plan:
    """Episodes, draws of every size for the main scenario, for the others and for further levels of noise; 0 stands for
    all pairs."""

    training: int
    test: int
    sizes: Mapping[int, int]
    other_sizes: Mapping[int, int]
    noise_sizes: Mapping[int, int]


FULL = Plan(120, 20, {8: 5, 16: 5, 64: 5, 128: 5, 512: 3, 0: 1}, {16: 5, 128: 5, 0: 1}, {128: 3})
#: The other robot's recordings are few, as a robot's are.
OTHER = Plan(20, 12, {}, {16: 3, 128: 3, 0: 3}, {})
OTHER_QUICK = Plan(6, 2, {}, {16: 1}, {})
QUICK = Plan(12, 4, {16: 1, 128: 1}, {16: 1}, {128: 1})


def cells_of(plan: Plan, name: str, steps: int) -> Iterator[Cell]:
    """Cells of one scenario."""
    main = name == MAIN
    sizes = plan.sizes if main else plan.noise_sizes if name in NOISE_CURVE else plan.other_sizes
    every = (plan.training - HELD_OUT) * (steps - HISTORY)
    wanted = [m for m in methods(Path(), 0) if m != SIMULATED] if main else list(OTHERS)
    if name.startswith(OTHER_ROBOT):
        wanted += ["re-lifted", DIRECT, SIMULATED]
    for method in wanted:
        if method in TABLED and name == "independent pulls":
            continue
        for size, draws in sizes.items():
            if method.endswith(("one recording", "from pairs")) and size != ONE_SIZE:
                continue
            if method.endswith("no pairs"):
                size, draws = 1, 1
            if method.endswith("from pairs"):
                draws = min(draws, SLOW_DRAWS)
            for seed in range(draws):
                yield Cell(name, method, size or every, PHASE_SAMPLES, seed)


def tabulate(results: Mapping[Cell, Result], what: str) -> Table:
    """Summary by scenario, method and size."""
    groups: dict[tuple[str, str, int], list[Result]] = {}
    for cell, result in results.items():
        groups.setdefault((cell.law, cell.method, cell.n1), []).append(result)
    return {key: summary([r.errors for r in group], what) for key, group in groups.items()}


def text(table: Table, name: str) -> str:
    """Medians of one scenario, methods by rows; the fraction of divergent roll-outs in brackets where there are any."""
    sizes = sorted({size for law, _, size in table if law == name})
    rows = list(dict.fromkeys(method for law, method, _ in table if law == name))
    lines = [f"{name}: median squared shape error in m^2", f"{'pairs':<30}" + "".join(f"{s:>17}" for s in sizes)]
    for method in rows:
        entries = []
        for size in sizes:
            found = table.get((name, method, size))
            if found is None:
                entries.append("-")
                continue
            number = f"{found.median:.1e}" if np.isfinite(found.median) else "diverges"
            entries.append(number + (f" [{100 * found.diverged:.0f} %]" if found.diverged else ""))
        lines.append(f"{method:<30}" + "".join(f"{e:>17}" for e in entries))
    return "\n".join(lines)


def gain(table: Table, name: str, size: int, others: Sequence[str]) -> float | None:
    """Error of the best of ``others`` over that of the twin, where all of them were run."""
    keys = [(name, method, size) for method in (*others, OURS)]
    if not all(key in table for key in keys):
        return None
    return min(table[key].median for key in keys[:-1]) / table[keys[-1]].median


def judge(table: Table, report: Report) -> None:
    """Figures with their targets, as far as the cells for them were run."""
    sizes = sorted({size for law, method, size in table if (law, method) == (MAIN, OURS)})
    median = {(method, size): s.median for (law, method, size), s in table.items() if law == MAIN}
    rivals = (*BASELINES, *(method for method in BOUNDED if any(method == key[1] for key in table)))
    for size, factor in ((16, 50.0), (64, 20.0), (128, 10.0)):
        _record(report, f"best baseline over PI twin, {size} pairs", gain(table, MAIN, size, rivals), ">=", factor)
    _record(report, "informed baselines over PI twin, 8 pairs", gain(table, MAIN, 8, INFORMED), ">=", 5.0)
    gains = [g for size in sizes if (g := gain(table, MAIN, size, INFORMED)) is not None]
    _record(report, "informed baselines over PI twin, worst size", min(gains, default=None), ">=", 1.0 / 1.05)
    every = [median[b, max(sizes)] for b in rivals if sizes and (b, max(sizes)) in median]
    if (OURS, 16) in median and len(every) == len(rivals):
        ratio = median[OURS, 16] / min(every)
        _record(report, "PI twin at 16 pairs over the best baseline with all", ratio, "<=", 1.0)
    for above, below, name, bound in (
        ((f"{OURS}, one recording", 64), (OURS, 64), "one recording of 64 steps over random pairs", 1.5),
        ((f"{OURS}, no pairs", 1), ("L-EDMDc", 512), "no pairs over L-EDMDc with 512", 1.0),
    ):
        if above in median and below in median:
            _record(report, name, median[above] / median[below], "<=", bound)
    diverged = [s.diverged for (_, method, size), s in table.items() if method == OURS and size >= 8]
    _record(report, "divergent roll-outs of PI twin, worst cell", max(diverged, default=None), "<=", 0.0)
    for name in dict.fromkeys(law for law, _, _ in table if law != MAIN):
        own = sorted(size for law, method, size in table if (law, method) == (name, OURS))
        gains = [g for size in own if (g := gain(table, name, size, BASELINES)) is not None]
        label = f"{name}: best baseline over PI twin, worst size"
        _record(report, label, min(gains, default=None), ">=", 1.0 / 1.1)
    for size in sorted(size for law, method, size in table if (law, method) == ("prototype arm", OURS)):
        square = table["prototype arm", OURS, size].median / TendonArm.prototype().scene.rod.length ** 2
        report.figure(f"prototype arm, PI twin, {size} pairs", square, "L^2", ("<=", 1.5e-6) if size >= 64 else None)


def _record(report: Report, name: str, value: float | None, kind: str, bound: float) -> None:
    if value is not None:
        report.figure(name, value, "times" if "divergent" not in name else "of all", (kind, bound))


def as_csv(tables: Mapping[str, Table]) -> str:
    """All summaries, one line each."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(["scenario", "method", "pairs", "error", "median", "lower", "upper", "divergent"])
    for what, table in tables.items():
        for (law, method, size), s in sorted(table.items()):
            writer.writerow([law, method, size, what, s.median, s.lower, s.upper, s.diverged])
    return out.getvalue()


def main() -> None:
    made = parser(__doc__ or "", "out/ablation")
    made.add_argument("--scenario", action="append", default=None, help="one or several scenarios, default all")
    made.add_argument("--method", action="append", default=None, help="one or several methods, default all")
    made.add_argument(
        "--pairs", type=int, action="append", help="one or several of the sizes, 0: all; default all sizes"
    )
    made.add_argument("--draws", type=int, help="draws of pairs of every size, the first ones; default all")
    made.add_argument("--workers", type=int, default=-1, help="worker processes, -1: all cores")
    arguments = made.parse_args()
    known = scenarios()
    names = arguments.scenario or ([MAIN] if arguments.quick else list(known))
    unknown = [name for name in names if name not in known]
    if unknown:
        raise ValueError(f"scenario {unknown[0]!r}; expected some of {', '.join(known)}")
    folder = arguments.out / ("quick" if arguments.quick else "full")
    found = methods(folder / "twins", arguments.seed)
    chosen = arguments.method or (["L-EDMDc", "PI hold", OURS] if arguments.quick else list(found))
    if set(chosen) - set(found):
        raise ValueError(f"method {sorted(set(chosen) - set(found))[0]!r}; expected some of {', '.join(found)}")
    (folder / "twins").mkdir(parents=True, exist_ok=True)
    results: dict[Cell, Result] = {}
    for name in names:
        if name.startswith(OTHER_ROBOT):
            plan = OTHER_QUICK if arguments.quick else OTHER
        else:
            plan = QUICK if arguments.quick else FULL
        source = ScenarioSource(
            known[name], folder / "data", plan.training, plan.test, arguments.seed, arguments.workers
        )
        data = source.load_or_make()
        steps = len(data.test.us[0])
        cells = [c for c in dict.fromkeys(cells_of(plan, name, steps)) if c.method in chosen]
        if arguments.pairs:
            every = (plan.training - HELD_OUT) * (steps - HISTORY)
            cells = [c for c in cells if c.n1 in {size or every for size in arguments.pairs}]
        if arguments.draws is not None:
            cells = [c for c in cells if c.seed < arguments.draws]
        settings = {"seed": arguments.seed, "training": plan.training, "test": plan.test}
        used = [found[label] for label in dict.fromkeys(c.method for c in cells)]
        results |= run_cells(
            {name: source},
            used,
            cells,
            folder / ("cells-other" if name.startswith(OTHER_ROBOT) else "cells"),
            settings,
            arguments.workers,
        )
        print(text(tabulate(results, "shape"), name), flush=True)
    tables = {what: tabulate(results, what) for what in ("shape", "velocity")}
    report = Report.of("ablation", arguments)
    judge(tables["shape"], report)
    if report.figures:
        print(report)
    for what, table in tables.items():
        draw_sizes(table, arguments.out / f"ablation_{what}.png", what)
    levels = {MAIN: 0.0, "noise": 1.0, **NOISE_CURVE}
    if len({law for law, _, _ in tables["shape"]} & set(levels)) > 1:
        draw_noise(tables, levels, NOISE_PAIRS, arguments.out / "ablation_noise.png")
    write_text(arguments.out / "ablation.csv", as_csv(tables), make_folders=True)
    report.write(arguments.json)


if __name__ == "__main__":
    run(main)
