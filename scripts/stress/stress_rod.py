"""Sweeps of the rod until something breaks, and where: success, internal steps and error of every case.

Rods: modulus 1e4 to 1e12 Pa by slenderness r/L 1e-4 to 0.1, damping from none to overdamped. The paper's arm, and the
same with shear and stretch ("full arm"): control intervals 1e-4 to 0.3 s, tendon pulls to 30 % of the length, tendons
slack and taut in turn, damping, tip loads. Random scenes, by hypothesis. Rods that sag or bear a dead tip load of 1 to
300 EI/L^2 on 4 to 10 nodes or ``nodes="auto"``, and arms with idle or pulled tendons under load.
Every result is held against the truth: dead loads against the plane elastica, other equilibria against a fine path of
Newton steps on four more nodes, motions against two more nodes and a tenth of the tolerance. Off by more than 1e-3 of
the length (motions: of the travel) without a word is *wrong*; with a warning, a lost branch or a clean status it is
*flagged* or *failed*. Broken is what is wrong, crashes, hangs, raises, or returns NaN. Every case runs in a worker
process under a limit of CPU time. A run that is killed goes on where it was when it is started again with the same
arguments. ``--spoil 2e-3`` moves every answer by so much of the length or the travel: none may pass for right then.
``--case '{...}'`` runs one case as it is printed; ``--only TEXT`` the sweeps whose names contain it.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections import Counter
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # the other rooms of scripts/

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.colors import LogNorm
from matplotlib.ticker import FormatStrFormatter

from common.drawing import save_figure
from common.report import Report, parser, run
from pisplit.files import write_text
from stress.cases import sweeps, work
from stress.watched import Finished, run_watched

BROKEN = ("wrong", "crash", "hang", "nan", "raised")
COLOURS = {"ok": "#1b9e77", "flagged": "#7570b3", "unjudged": "#66a61e", "failed": "#e6ab02", "refused": "#7a7a7a"}
#: A result was returned; what was flagged may be right all the same.
SOLVED = ("ok", "flagged", "unjudged")
#: Entries of a row that are not of its case.
FOUND = ("outcome", "message", "steps", "error", "seconds")
Row = dict[str, Any]


def table(rows: list[Row]) -> str:
    """One line a sweep, then every case that was not solved."""
    head = f"{'sweep':<33}{'cases':>6}{'ok':>6}{'flagged':>8}{'failed':>8}{'broken':>8}"
    lines = [f"{head}{'steps':>9}{'error':>10}{'s, max':>9}"]
    for sweep in dict.fromkeys(row["sweep"] for row in rows):
        of = [row for row in rows if row["sweep"] == sweep]
        count = Counter(row["outcome"] for row in of)
        broken = sum(count[b] for b in BROKEN)
        steps = _median(row.get("steps") for row in of)
        error = _median(row.get("error") for row in of)
        slowest = max(row.get("seconds", np.inf) for row in of)
        lines.append(
            f"{sweep:<33}{len(of):>6}{count['ok']:>6}{count['flagged']:>8}{count['failed'] + count['refused']:>8}"
            f"{broken:>8}{steps:>9.3g}{error:>10.1e}{slowest:>9.2f}"
        )
    unsolved = sorted((row for row in rows if row["outcome"] not in ("ok", "flagged")), key=_harmless)
    for row in unsolved[:60]:
        lines += [f"{row['outcome']}: {row.get('message', '')}", f"  --case '{json.dumps(_case(row))}'"]
    if len(unsolved) > 60:
        lines.append(f"  and {len(unsolved) - 60} more")
    return "\n".join(lines)


def _harmless(row: Row) -> bool:
    """What is broken is told first."""
    return row["outcome"] not in BROKEN


def _case(row: Row) -> Row:
    """The case of a row, without what became of it."""
    return {name: value for name, value in row.items() if name not in FOUND}


def _median(values: Any) -> float:
    given = [v for v in values if v is not None]
    return float(np.median(given)) if given else float("nan")


def draw(rows: list[Row], path: Path) -> None:
    """Maps over modulus and slenderness, then each sweep over what it varies."""
    figure, axes = plt.subplots(3, 4, figsize=(19.0, 12.6), constrained_layout=True)
    figure.suptitle(
        "Stress of the rod: green right, violet flagged, orange given up with a clean status, grey refused, red broken",
        fontsize=14,
    )
    for axis, strains in zip(axes[:2, 0], ("cosserat", "kirchhoff"), strict=True):
        _map(figure, axis, [row for row in rows if row["sweep"] == f"stiffness, {strains}"])
        axis.set_title(f"{strains} rod: internal steps per 1/20 period")
    _outcomes(axes[2, 0], rows)
    for axis, (names, (title, value, label)) in zip(axes[:, 1:].ravel(), PANELS.items(), strict=True):
        _panel(axis, rows, names, value)
        axis.set(xlabel=label, title=title)
    save_figure(figure, path, dpi=110)


#: Sweeps of a panel; its title, what they vary, and the label of that.
PANELS: dict[tuple[str, ...], tuple[str, str, str]] = {
    ("damping, cosserat", "damping, kirchhoff"): ("rod: damping", "damping", "damping ratio of the first mode"),
    ("truth: sag", "truth: tip load"): ("rods under dead loads", "load", "load (EI/L$^2$)"),
    ("random scenes",): ("random scenes", "steps", "internal steps per control interval"),
    ("arm: control interval", "full arm: control interval"): ("arm: control interval", "dt", "control interval (s)"),
    ("arm: tendon pull", "full arm: tendon pull"): ("arm: tendon pull", "amplitude", "pull of one tendon (m)"),
    ("arm: slack and taut in turn", "full arm: slack and taut in turn"): (
        "arm: slack and taut in turn",
        "dt",
        "time between pull and release (s)",
    ),
    ("arm: damping", "full arm: damping"): ("arm: damping, smooth pulls", "damping", "parts of the paper's damping"),
    ("arm: damping, jumping pulls", "full arm: damping, jumping pulls"): (
        "arm: damping, jumping pulls",
        "damping",
        "parts of the paper's damping",
    ),
    ("arm: cold tip load", "full arm: cold tip load"): ("arm: cold tip load", "load", "F L$^2$/EI"),
}


def _panel(axis: Any, rows: list[Row], names: tuple[str, ...], varied: str) -> None:
    """Error over what is varied. What was not solved stands above, what has no reference below, zero to the left."""
    of = [row for row in rows if row["sweep"] in names and row.get(varied) is not None]
    if not of:
        return
    errors = [max(row["error"], 1e-9) for row in of if row["outcome"] in SOLVED and row.get("error")]
    top, bottom = 10.0 * max(errors, default=1.0), 0.3 * min(errors, default=1.0)
    zero = 0.3 * min((row[varied] for row in of if row[varied] > 0.0), default=1.0)
    for name, (marker, filled) in zip(names, (("o", True), ("D", False)), strict=False):
        for row in (row for row in of if row["sweep"] == name):
            colour = COLOURS.get(row["outcome"], "#d62728")
            at, height = max(row[varied], zero), top
            if row["outcome"] in SOLVED:
                height = max(row["error"], 1e-9) if row.get("error") else bottom
            shape = "X" if row["outcome"] not in SOLVED else marker if row.get("error") else "v"
            axis.plot(at, height, shape, color=colour, mfc=colour if filled or shape == "X" else "none", alpha=0.8)
        if len(names) > 1:
            face = "#555555" if filled else "none"
            axis.plot([], [], marker, color="#555555", mfc=face, linestyle="none", label=_told_apart(name))
    if any(row["outcome"] in SOLVED and not row.get("error") for row in of):
        axis.plot([], [], "v", color="#555555", mfc="none", linestyle="none", label="no reference")
    if len(names) > 1:
        axis.legend(frameon=False, loc="best", fontsize=9)
    if any(row[varied] == 0.0 for row in of):
        axis.axvline(zero, color="#999999", lw=0.8, ls=":")
        below = {"xytext": (0, -14), "textcoords": "offset points", "ha": "center"}  # where ticks have their labels
        axis.annotate("0", (zero, 0.0), xycoords=axis.get_xaxis_transform(), **below)
    axis.set(xscale="linear" if varied == "amplitude" else "log", yscale="log")
    axis.set_ylabel("error (length; motions: travel)")
    axis.grid(alpha=0.25)


def _told_apart(name: str) -> str:
    """What tells the two sweeps of a panel apart: the arm, the load, or the strains of a rod."""
    return name.split(": ")[name.startswith("truth")] if ": " in name else name.split(", ")[1]


def _outcomes(axis: Any, rows: list[Row]) -> None:
    """Solved and other cases of every sweep, as bars in percent."""
    names = list(dict.fromkeys(row["sweep"] for row in rows))[::-1]
    for k, name in enumerate(names):
        of = [row["outcome"] for row in rows if row["sweep"] == name]
        left = 0.0
        for outcome in ("ok", "unjudged", "flagged", "failed", "refused", *BROKEN):
            share = 100.0 * of.count(outcome) / len(of)
            axis.barh(k, share, left=left, color=COLOURS.get(outcome, "#d62728"))
            left += share
        axis.text(2.0, k, f"{of.count('ok')} of {len(of)}", va="center", fontsize=7, color="white")
    axis.set_yticks(range(len(names)), names, fontsize=7)
    axis.set(xlabel="cases (%)", title="solved", xlim=(0.0, 100.0))


def _map(figure: Any, axis: Any, rows: list[Row]) -> None:
    solved = [row for row in rows if row["outcome"] in SOLVED]
    others = [row for row in rows if row["outcome"] not in SOLVED]
    if not solved:
        return
    steps = [row["steps"] for row in solved]
    drawn = axis.scatter(
        [row["young"] for row in solved],
        [row["ratio"] for row in solved],
        c=np.maximum(steps, 1.0),
        norm=LogNorm(),
        s=130,
        marker="s",
        cmap="viridis",
    )
    for row in others:
        axis.plot(row["young"], row["ratio"], "X", ms=9, color=COLOURS.get(row["outcome"], "#d62728"))
    axis.set(xscale="log", yscale="log", xlabel="E (Pa)", ylabel="r / L")
    bar = figure.colorbar(drawn, ax=axis, label="internal steps")
    for which in (bar.ax.yaxis.set_major_formatter, bar.ax.yaxis.set_minor_formatter):
        which(FormatStrFormatter("%.3g"))


def main() -> None:
    made = parser(__doc__ or "")
    made.add_argument("--limit", type=float, default=120.0, help="limit of a case in s of CPU time")
    made.add_argument("--workers", type=int, default=2, help="worker processes")
    made.add_argument("--only", default="", metavar="TEXT", help="run the sweeps whose names contain this")
    made.add_argument(
        "--spoil", type=float, default=0.0, metavar="PART", help="move every answer by this part of L or of the travel"
    )
    made.add_argument("--case", default=None, metavar="JSON", help="run this one case only, as printed by a run")
    arguments = made.parse_args()
    if arguments.case is not None:
        print(json.dumps(work(json.loads(arguments.case)), indent=1))
        return
    cases = [case for case in sweeps(arguments.quick, arguments.seed) if arguments.only in case["sweep"]]
    if arguments.spoil:
        cases = [case | {"spoil": arguments.spoil} for case in cases]
    if not cases:
        raise ValueError(f"--only {arguments.only!r} names no sweep")
    which = {"quick": arguments.quick, "seed": arguments.seed, "limit": arguments.limit, "only": arguments.only}
    finished = Finished(arguments.out / "stress_rod_unfinished.json", which)
    found = run_watched(cases, work, arguments.limit, arguments.workers, finished)
    rows = [case | outcome for case, outcome in zip(cases, found, strict=True)]
    print(table(rows))
    report = _report(rows, arguments)
    print(report)
    draw(rows, arguments.out / "stress_rod.png")
    report.write(arguments.json)
    if arguments.json is not None:
        write_text(arguments.json.with_name(f"{arguments.json.stem}_cases.json"), json.dumps(rows, indent=1))
    finished.remove()


def _report(rows: list[Row], arguments: argparse.Namespace) -> Report:
    report = Report.of("stress of the rod", arguments)
    report.figure("cases", len(rows), "")
    count = Counter(row["outcome"] for row in rows)
    for outcome in ("ok", "unjudged", "flagged", "failed", "refused"):
        report.figure(outcome, count[outcome], "cases")
    for outcome in BROKEN:
        spoilt = bool(arguments.spoil) and outcome == "wrong"
        report.figure(outcome, count[outcome], "cases", None if spoilt else ("<=", 0))
    report.figure("CPU time of all cases", sum(row.get("seconds", 0.0) for row in rows) / 60.0, "min")
    arm = [row["outcome"] in SOLVED for row in rows if row["sweep"].startswith("full arm")] or [True]
    report.figure("full Cosserat arm, stress scenes finished", 100.0 * float(np.mean(arm)), "%", (">=", 100.0))
    flagged = [row for row in rows if row["outcome"] == "flagged" and row.get("error") is not None]
    right = sum(row["error"] <= 1e-3 for row in flagged)
    report.figure("flagged though right", 100.0 * right / max(1, len(rows)), "% of all cases")
    return report


if __name__ == "__main__":
    run(main)
