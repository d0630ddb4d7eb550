"""Reproduce the paper's result figure on its arm: error over |D1| and |D2|, for both input laws.

Under the paper's own protocol and under a fair one, in separate figures; with ``--reading one-step`` under a reading of
the paper that shows its picture (docs/paper.md). Without options a reduced run of minutes;
--full is the paper's scale. Everything is resumable: data and every fit are on disk as soon as they are there, a killed
run continues.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")  # one thread a worker

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # the other rooms of scripts/

import numpy as np

from common.data import PaperData, Scale, Source
from common.protocol import Draw, Method, Predictor
from common.report import Report, parser, run
from common.runs import Cell, curve_cells, largest, run_cells
from paper import one_step_report
from paper.figures import draw_panels
from paper.methods import Choices, paper_methods
from paper.one_step import PENALTIES, Reading, planned, run_fits
from paper.one_step import largest as largest_draw
from paper.reasons import reasons
from paper.tables import Row, finite, printed, table, write_csv
from paper.variations import VARIATIONS, vary
from pisplit.files import write_text
from pisplit.models.arm.recording import EQUATIONS, LAWS
from pisplit.models.arm.tendon_arm import TendonArm


@dataclass(frozen=True)
class Plan:
    """Data and sizes of a run: |D1| with its number of draws (0: all pairs, once), |D2| of the grid, |D1| there; the
    same of the fair protocol, whose |D2| are episodes of a twin (no more of their pairs than ``scale`` has samples);
    |D1| and |D2| of the one-step reading, on the grid of the paper's protocol."""

    scale: Scale
    sizes: Mapping[int, int]
    grid_sizes: Mapping[int, int]
    d2_sizes: tuple[int, ...]
    fair_sizes: Mapping[int, int]
    fair_grid: Mapping[int, int]
    twin_episodes: tuple[int, ...]
    pair_sizes: Mapping[int, int]
    phase_sizes: tuple[int, ...]


PLANS = {
    "quick": Plan(
        Scale(8, 3, 30, 1600),
        {16: 1, 64: 1},
        {16: 1, 64: 1},
        (50, 1600),
        {16: 1, 64: 1},
        {16: 1},
        (8,),
        {16: 1, 64: 1},
        (16, 1600),
    ),
    "reduced": Plan(
        Scale(84, 16, 200, 4096),
        {64: 3, 256: 3, 1024: 3, 0: 1},
        {64: 1, 1024: 1, 0: 1},
        (64, 512, 4096),
        {16: 1, 256: 1, 4096: 1},
        {16: 1, 4096: 1},
        (8, 20),
        {2**k: 3 for k in range(6, 14)} | {0: 1},
        (8, 64, 512, 4096),
    ),
    "full": Plan(
        Scale(),
        {2**k: 5 if k <= 12 else 3 if k <= 14 else 1 for k in range(6, 18)} | {0: 1},
        {2**k: 5 if k <= 12 else 3 for k in range(6, 16, 2)} | {0: 1},
        (2**6, 2**9, 2**12, 2**15, 140_000),
        {2**k: 5 if k <= 8 else 3 if k <= 12 else 1 for k in range(4, 18, 2)} | {0: 1},
        {16: 3, 256: 3, 4096: 1, 0: 1},
        (8, 24, 96),
        {2**k: 5 if k <= 12 else 3 if k <= 14 else 1 for k in range(6, 18)} | {0: 1},
        (8, 64, 512, 4096, 140_000),
    ),
}


def arguments() -> argparse.Namespace:
    """Command line."""
    made = parser((__doc__ or "").splitlines()[0], out="out/paper")
    made.add_argument("--full", action="store_true", help="the paper's scale: under an hour on two cores")
    made.add_argument("--laws", nargs="+", choices=LAWS, default=list(LAWS), help="input laws of the trajectories")
    made.add_argument(
        "--protocols", nargs="+", choices=tuple(PROTOCOLS), default=list(PROTOCOLS), help="whose protocol"
    )
    made.add_argument("--vary", nargs="+", choices=(*VARIATIONS, "all"), help="what the paper leaves open, instead")
    made.add_argument("--reasons", action="store_true", help="why PI-EDMDc as printed diverges, instead")
    made.add_argument(
        "--reading",
        choices=("printed", "one-step"),
        default="printed",
        help="what of the paper is taken as printed, or the reading under which its figure appears",
    )
    made.add_argument("--hold", type=int, help="steps between input targets of the reading one-step (its default: 64)")
    made.add_argument("--penalty", choices=tuple(PENALTIES), help="weight of its LASSO (its default: fixed)")
    made.add_argument("--workers", type=int, default=-1, help="processes; -1 = one a core")
    return made.parse_args()


def main() -> None:
    """Make the data, run the cells, draw the figures; or measure the effect of a choice."""
    given = arguments()
    if given.full and given.quick:
        raise ValueError("--full and --quick are given; choose one")
    kind = "full" if given.full else "quick" if given.quick else "reduced"
    plan = PLANS[kind]
    if given.reading == "one-step":
        _run_one_step(plan, given, kind)
        return
    if given.hold is not None or given.penalty is not None:
        raise ValueError("--hold and --penalty are of --reading one-step; the other protocols choose their own")
    report = Report.of(f"the paper's experiment, {kind}", given)
    arm, begin = TendonArm.paper(), time.perf_counter()
    sources = {law: Source(arm, law, given.out / "data", plan.scale, given.seed, given.workers) for law in given.laws}
    data = {law: source.load_or_make() for law, source in sources.items()}
    report.figure("time of data", time.perf_counter() - begin, "s")
    if given.reasons:
        for law, found in data.items():
            for label, (value, unit) in reasons(found).items():
                print(f"{law:<12} {label:<56} {value:9.3g} {unit}")
                report.figure(f"{law}, {label}", value, unit)
    elif given.vary:
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


def _run_one_step(plan: Plan, given: argparse.Namespace, kind: str) -> None:
    """The reading under which the paper's figure appears: table, JSON and figure."""
    if given.vary or given.reasons:
        raise ValueError("--vary and --reasons are of the printed protocol; leave them or --reading one-step out")
    begin, report = time.perf_counter(), Report.of(f"the paper's experiment, one-step reading, {kind}", given)
    hold, penalty = given.hold or 64, given.penalty or "fixed"
    folder = given.out / kind / "one-step"
    found = Reading(
        TendonArm.paper(), given.out / "data", plan.scale, hold, penalty, seed=given.seed, workers=given.workers
    )
    most = largest_draw(found)
    report.figure("time of data", time.perf_counter() - begin, "s")
    n2s = tuple(dict.fromkeys((*plan.phase_sizes, plan.scale.samples)))
    rows = run_fits(found, planned(plan.pair_sizes, plan.grid_sizes, n2s, most), given.workers)
    print(one_step_report.printed(rows))
    usual = (hold, penalty) == (64, "fixed")
    title = (
        f"One-step reading: new input targets every {hold} steps, {penalty} penalty, {plan.scale.test} test episodes"
    )
    name = "figure" if usual else f"figure-hold{hold}-{penalty}"
    one_step_report.draw(rows, title, folder / f"{name}.png")
    one_step_report.record(report, rows, targets=usual)
    report.figure("time", time.perf_counter() - begin, "s")
    for line in str(report).splitlines():
        if "gain" in line or "time" in line or "halvings" in line:
            print(line)
    print(f"figure in {folder / name}.png")
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
    protocol = PROTOCOLS[name](plan, given)
    folder, begin = given.out / kind / name, time.perf_counter()
    settings = {
        "scale": asdict(plan.scale),
        "seed": given.seed,
        "equations": EQUATIONS,
        "methods": [re.sub(r" at 0x[0-9a-f]+", "", repr(m.fit))[:2000] for m in protocol.methods],
    }
    results = run_cells(sources, protocol.methods, plan_cells(protocol, data), folder, settings, given.workers)
    report.figure(f"time of protocol {name}", time.perf_counter() - begin, "s")
    rows = table(results)
    write_csv(rows, folder / "errors.csv")
    print(printed(rows))
    names = [method.name for method in protocol.methods]
    for law in given.laws:
        title = f"{protocol.title}; inputs: {law}; {plan.scale.test} test episodes"
        draw_panels(rows, law, names, protocol.drawn, title, folder / f"figure-{law}.png", protocol.d2)
    write_text(folder / "errors.json", json.dumps(finite(rows), indent=1), make_folders=True)
    _record(report, rows, f"{name}, ")


def _record(report: Report, rows: Sequence[Row], prefix: str = "") -> None:
    """Median errors where they are finite, and the divergent part of all roll-outs."""
    for row in rows:
        label = f"{prefix}{row['law']}, {row['method']}, |D1| = {row['n1']}, |D2| = {row['n2']}"
        for what, unit in (("shape", "m^2"), ("velocity", "m^2/s^2")):
            if np.isfinite(row[f"{what} median [{unit}]"]):
                report.figure(f"{label}, squared {what} error", row[f"{what} median [{unit}]"], unit)
        report.figure(f"{label}, diverged", 100.0 * row["diverged"], "%")


@dataclass(frozen=True)
class Protocol:
    """What is fitted to what.

    methods   all of them, and by law those that cannot be had there
    drawn     the method that is drawn over |D1| x |D2|
    sizes     |D1| of the curves with its number of draws (0: all pairs), with the last |D2|
    grid      |D1| of the grid likewise, with every |D2| of ``n2``
    d2        what |D2| counts
    """

    title: str
    methods: tuple[Method, ...]
    drawn: str
    sizes: Mapping[int, int]
    grid: Mapping[int, int]
    n2: tuple[int, ...]
    d2: str = "phase-space samples"
    left_out: Mapping[str, tuple[str, ...]] = field(default_factory=dict)


def plan_cells(protocol: Protocol, data: Mapping[str, PaperData]) -> list[Cell]:
    """Cells of a protocol; sizes above all pairs are left out."""
    cells: dict[Cell, None] = {}
    for law, found in data.items():
        most, without = largest(found), protocol.left_out.get(law, ())
        names = [method.name for method in protocol.methods if method.name not in without]
        for sizes, n2s, chosen in (
            (protocol.sizes, protocol.n2[-1:], names),
            (protocol.grid, protocol.n2, [protocol.drawn]),
        ):
            counts = {n if n else most: draws for n, draws in sizes.items() if n < most}
            for n2 in n2s:
                cells |= dict.fromkeys(curve_cells([law], chosen, counts, n2))
    return list(cells)


def _paper(plan: Plan, given: argparse.Namespace) -> Protocol:
    n2 = tuple(dict.fromkeys((*plan.d2_sizes, plan.scale.samples)))
    title = "The paper's protocol as printed"
    return Protocol(title, paper_methods(Choices()), "PI-EDMDc", plan.sizes, plan.grid_sizes, n2)


def _ours(plan: Plan, given: argparse.Namespace) -> Protocol:
    """The fair protocol: everything tuned on held-out episodes. D2 of its best method are pairs of a simulated twin."""
    from ablation.methods import TABLED, methods
    from ablation.scenarios import STEPS

    found = methods(given.out / "data" / "twins", given.seed, max(plan.twin_episodes))
    return Protocol(
        "Fair protocol: all methods tuned on held-out episodes",
        tuple(Method(name, OfScenario(found[name].fit, name == FAIR[-1])) for name in FAIR),
        FAIR[-1],
        plan.fair_sizes,
        plan.fair_grid,
        tuple(STEPS * episodes for episodes in plan.twin_episodes),
        "pairs of the twin",
        {"independent": TABLED},
    )


@dataclass(frozen=True)
class OfScenario:
    """A method that looks up what is known of the arm by the name of a scenario.

    twin    it simulates its D2: as many pairs as the draw has phase-space samples
    """

    fit: Callable[[Draw], Predictor]
    twin: bool

    def __call__(self, draw: Draw) -> Predictor:
        """Fit to the draw under the scenario's name."""
        from ablation.scenarios import STEPS
        from ablation.twin import TwinMethod

        fit = self.fit
        if self.twin:
            assert isinstance(fit, TwinMethod)
            fit = replace(fit, episodes=len(draw.d2) // STEPS)
        return fit(replace(draw, law=SCENARIOS[draw.law]))


FAIR = ("L-EDMDc", "B-EDMDc", "L-EDMDc, rod + x_eq", "PI hold", "PI twin")
SCENARIOS = {"zero-sum": "paper arm", "independent": "independent pulls"}
PROTOCOLS: dict[str, Callable[[Plan, argparse.Namespace], Protocol]] = {"paper": _paper, "ours": _ours}


if __name__ == "__main__":
    run(main)
