"""Reproduce the paper's result figure on its arm: error over |D1| and |D2|, for both input laws.

Without options a reduced run of minutes; --full is the paper's scale. Everything is resumable: data and every fit are
on disk as soon as they are there, a killed run continues.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace

os.environ.setdefault("OMP_NUM_THREADS", "1")  # one thread a worker

import numpy as np
from paper_data import PaperData, Scale, Source
from paper_figures import draw_panels
from paper_methods import Choices, paper_methods
from paper_protocol import Draw, Method, Predictor
from paper_runs import Cell, curve_cells, largest, run_cells, write_text
from paper_tables import Row, finite, printed, table, write_csv
from paper_variations import VARIATIONS, vary
from report import Report, parser, run

from pisplit.models.generation import EQUATIONS, LAWS
from pisplit.models.tendon_arm import TendonArm


@dataclass(frozen=True)
class Plan:
    """Data and sizes of a run: |D1| with its number of draws (0: all pairs, once), |D2| of the grid, |D1| there."""

    scale: Scale
    sizes: Mapping[int, int]
    grid_sizes: Mapping[int, int]
    d2_sizes: tuple[int, ...]


PLANS = {
    "quick": Plan(Scale(8, 3, 30, 200), {16: 1, 64: 1}, {16: 1, 64: 1}, (50, 200)),
    "reduced": Plan(
        Scale(84, 16, 200, 4096),
        {64: 5, 256: 5, 1024: 3, 4096: 1, 0: 1},
        {64: 3, 1024: 3, 0: 1},
        (64, 512, 4096),
    ),
    "full": Plan(
        Scale(),
        {2**k: 5 if k <= 12 else 3 if k <= 14 else 1 for k in range(6, 18)} | {0: 1},
        {2**k: 5 if k <= 12 else 3 for k in range(6, 16, 2)} | {0: 1},
        (2**6, 2**9, 2**12, 2**15, 140_000),
    ),
}


def arguments() -> argparse.Namespace:
    """Command line."""
    made = parser((__doc__ or "").splitlines()[0], out="out/paper")
    made.add_argument("--full", action="store_true", help="the paper's scale: under an hour on two cores")
    made.add_argument("--laws", nargs="+", choices=LAWS, default=list(LAWS), help="input laws of the trajectories")
    made.add_argument("--protocols", nargs="+", choices=tuple(PROTOCOLS), default=["paper"], help="whose protocol")
    made.add_argument("--vary", nargs="+", choices=(*VARIATIONS, "all"), help="what the paper leaves open, instead")
    made.add_argument("--workers", type=int, default=-1, help="processes; -1 = one a core")
    return made.parse_args()


def main() -> None:
    """Make the data, run the cells, draw the figures; or measure the effect of a choice."""
    given = arguments()
    if given.full and given.quick:
        raise ValueError("--full and --quick are given; choose one")
    kind = "full" if given.full else "quick" if given.quick else "reduced"
    plan = PLANS[kind]
    report = Report.of(f"the paper's experiment, {kind}", given)
    arm, begin = TendonArm.paper(), time.perf_counter()
    sources = {law: Source(arm, law, given.out / "data", plan.scale, given.seed, given.workers) for law in given.laws}
    data = {law: source.load_or_make() for law, source in sources.items()}
    report.figure("time of data", time.perf_counter() - begin, "s")
    if given.vary:
        names = list(VARIATIONS) if "all" in given.vary else given.vary
        rows = vary(names, sources, data, given.out / kind, plan.scale, given.workers)
        print(printed(rows))
        _record(report, rows)
    else:
        for name in given.protocols:
            _run_protocol(name, plan, sources, data, given, kind, report)
    report.figure("time", time.perf_counter() - begin, "s")
    print(f"{time.perf_counter() - begin:.0f} s, results in {given.out / kind}")
    report.write(given.json)


def _run_protocol(
    name: str,
    plan: Plan,
    sources: Mapping[str, Source],
    data: Mapping[str, PaperData],
    given: argparse.Namespace,
    kind: str,
    report: Report,
) -> None:
    """All cells of a protocol; figures, CSV and JSON of each law."""
    methods, grid_method, d2_sizes = PROTOCOLS[name](plan, given)
    folder = given.out / kind / name
    cells = plan_cells(replace(plan, d2_sizes=d2_sizes), data, [method.name for method in methods], grid_method)
    settings = {
        "scale": asdict(plan.scale),
        "seed": given.seed,
        "equations": EQUATIONS,
        "methods": [repr(m.fit)[:2000] for m in methods],
    }
    results = run_cells(sources, methods, cells, folder, settings, given.workers)
    rows = table(results)
    write_csv(rows, folder / "errors.csv")
    print(printed(rows))
    for law in given.laws:
        title = f"{TITLES[name]}; inputs: {law}; {plan.scale.test} test episodes"
        draw_panels(rows, law, [method.name for method in methods], grid_method, title, folder / f"figure-{law}.png")
    write_text(folder / "errors.json", json.dumps(finite(rows), indent=1))
    _record(report, rows, f"{name}, ")


def _record(report: Report, rows: Sequence[Row], prefix: str = "") -> None:
    """Median errors where they are finite, and the divergent part of all roll-outs."""
    for row in rows:
        label = f"{prefix}{row['law']}, {row['method']}, |D1| = {row['n1']}, |D2| = {row['n2']}"
        for what, unit in (("shape", "m^2"), ("velocity", "m^2/s^2")):
            if np.isfinite(row[f"{what} median [{unit}]"]):
                report.figure(f"{label}, squared {what} error", row[f"{what} median [{unit}]"], unit)
        report.figure(f"{label}, diverged", 100.0 * row["diverged"], "%")


def plan_cells(plan: Plan, data: Mapping[str, PaperData], methods: Sequence[str], grid_method: str) -> list[Cell]:
    """Cells of a plan; a size of 0 stands for all pairs, sizes above that are left out."""
    cells: dict[Cell, None] = {}
    for law, found in data.items():
        most = largest(found)
        for sizes, d2_sizes, names in (
            (plan.sizes, (plan.scale.samples,), methods),
            (plan.grid_sizes, plan.d2_sizes, [grid_method]),
        ):
            counts = {n if n else most: draws for n, draws in sizes.items() if n < most}
            for n2 in d2_sizes:
                cells |= dict.fromkeys(curve_cells([law], names, counts, n2))
    return list(cells)


#: Methods of a protocol, the one that is drawn over |D1| x |D2|, and |D2| there.
Protocol = tuple[tuple[Method, ...], str, tuple[int, ...]]


def _paper(plan: Plan, given: argparse.Namespace) -> Protocol:
    return paper_methods(Choices()), "PI-EDMDc", plan.d2_sizes


def _ours(plan: Plan, given: argparse.Namespace) -> Protocol:
    """The fair protocol: everything tuned on held-out episodes; its best method needs no phase-space samples."""
    from arm_methods import methods

    found = methods(given.out / "data" / "twins", given.seed)
    chosen = tuple(Method(name, OfScenario(found[name].fit)) for name in FAIR)
    return chosen, FAIR[-1], (plan.scale.samples,)


@dataclass(frozen=True)
class OfScenario:
    """A method that looks up what is known of the arm by the name of a scenario."""

    fit: Callable[[Draw], Predictor]

    def __call__(self, draw: Draw) -> Predictor:
        """Fit to the draw under the scenario's name."""
        return self.fit(replace(draw, law=SCENARIOS[draw.law]))


FAIR = ("L-EDMDc", "B-EDMDc", "L-EDMDc, rod + x_eq", "PI hold", "PI twin")
SCENARIOS = {"zero-sum": "paper arm", "independent": "independent pulls"}
PROTOCOLS: dict[str, Callable[[Plan, argparse.Namespace], Protocol]] = {"paper": _paper, "ours": _ours}
TITLES = {
    "paper": "The paper's protocol as printed",
    "ours": "Fair protocol: all methods tuned on held-out episodes",
}


if __name__ == "__main__":
    run(main)
