"""Sweeps of the rod until something breaks, and where: success, internal steps and error of every case.

Modulus 1e4 to 1e12 Pa by slenderness r/L 1e-4 to 0.1; damping from none to overdamped; control intervals 1e-4 to 0.3 s;
cold tip loads to F L^2/EI = 300; tendon pulls to 30 % of the length; tendons slack and taut in turn; random scenes.
Every case runs in a worker process under a wall-clock limit. What counts as broken: a crash, a hang, a NaN that is
returned, or an exception; a solver that gives up with a clean status is recorded, not broken.
"""

from __future__ import annotations

import json
import os
from collections import Counter
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from report import Report, parser, run
from stress_cases import sweeps, work
from watched import run_watched

BROKEN = ("crash", "hang", "nan", "raised")
COLOURS = {"ok": "#1b9e77", "failed": "#e6ab02", "refused": "#7a7a7a"}
Row = dict[str, Any]


def table(rows: list[Row]) -> str:
    """One line a sweep, then every case that was not solved."""
    lines = [f"{'sweep':<28}{'cases':>6}{'ok':>6}{'failed':>8}{'broken':>8}{'steps':>9}{'error':>10}{'s, max':>9}"]
    for sweep in dict.fromkeys(row["sweep"] for row in rows):
        of = [row for row in rows if row["sweep"] == sweep]
        count = Counter(row["outcome"] for row in of)
        broken = sum(count[b] for b in BROKEN)
        steps = _median(row.get("steps") for row in of)
        error = _median(row.get("error") for row in of)
        slowest = max(row.get("seconds", np.inf) for row in of)
        lines.append(
            f"{sweep:<28}{len(of):>6}{count['ok']:>6}{count['failed'] + count['refused']:>8}{broken:>8}"
            f"{steps:>9.3g}{error:>10.1e}{slowest:>9.2f}"
        )
    unsolved = [row for row in rows if row["outcome"] != "ok"]
    for row in unsolved[:60]:
        what = ", ".join(f"{k} {_short(v)}" for k, v in row.items() if k not in NOT_SHOWN)
        lines.append(f"  {row['outcome']:<8}{row['sweep']}: {what}: {row.get('message', '')}")
    if len(unsolved) > 60:
        lines.append(f"  and {len(unsolved) - 60} more")
    return "\n".join(lines)


NOT_SHOWN = ("sweep", "kind", "outcome", "message", "steps", "error", "seconds", "strains", "pattern")


def _short(value: Any) -> str:
    return f"{value:.3g}" if isinstance(value, float) else str(value)


def _median(values: Any) -> float:
    given = [v for v in values if v is not None]
    return float(np.median(given)) if given else float("nan")


def draw(rows: list[Row], path: Path) -> None:
    """Maps over modulus and slenderness, then each sweep over what it varies."""
    figure, axes = plt.subplots(2, 4, figsize=(19.0, 8.6), constrained_layout=True)
    for axis, strains in zip(axes[:, 0], ("cosserat", "kirchhoff"), strict=True):
        of = [row for row in rows if row["sweep"] == f"stiffness, {strains}"]
        _map(figure, axis, of)
        axis.set_title(f"{strains}: steps per 1/20 of a period")
    panels = {
        "damping, cosserat": ("damping", "damping ratio of the first mode (leftmost: none)"),
        "damping, kirchhoff": ("damping", "damping ratio of the first mode (leftmost: none)"),
        "control interval": ("dt", "control interval (s)"),
        "tendon pull": ("amplitude", "pull of one tendon (m)"),
        "slack and taut in turn": ("amplitude", "pull, then release (m)"),
        "cold tip load, kirchhoff": ("load", "F L^2 / EI, cold"),
    }
    for axis, (sweep, (name, label)) in zip(axes[:, 1:].ravel(), panels.items(), strict=True):
        for row in (row for row in rows if row["sweep"] == sweep):
            value, colour = max(row[name], 3e-5), COLOURS.get(row["outcome"], "#d62728")
            axis.plot(
                value, max(row.get("error") or 1e-12, 1e-16), "o" if row["outcome"] == "ok" else "X", color=colour
            )
        kind = "residual (EI/L)" if name == "load" else "tip error / L"
        axis.set(xscale="log", yscale="log", xlabel=label, ylabel=kind, title=sweep)
        axis.grid(alpha=0.25)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=120)
    plt.close(figure)


def _map(figure: Any, axis: Any, rows: list[Row]) -> None:
    solved = [row for row in rows if row["outcome"] == "ok"]
    others = [row for row in rows if row["outcome"] != "ok"]
    steps = [row["steps"] for row in solved]
    drawn = axis.scatter(
        [row["young"] for row in solved],
        [row["ratio"] for row in solved],
        c=np.log10(np.maximum(steps, 1e-2)),
        s=130,
        marker="s",
        cmap="viridis",
    )
    for row in others:
        axis.plot(row["young"], row["ratio"], "X", ms=9, color=COLOURS.get(row["outcome"], "#d62728"))
    axis.set(xscale="log", yscale="log", xlabel="E (Pa)", ylabel="r / L")
    figure.colorbar(drawn, ax=axis, label="log10 of internal steps")


def main() -> None:
    made = parser(__doc__ or "")
    made.add_argument("--limit", type=float, default=60.0, help="wall-clock limit of a case in s")
    made.add_argument("--workers", type=int, default=2, help="worker processes")
    arguments = made.parse_args()
    cases = sweeps(arguments.quick, arguments.seed)
    rows = [
        case | found
        for case, found in zip(cases, run_watched(cases, work, arguments.limit, arguments.workers), strict=True)
    ]
    print(table(rows))
    report = Report.of("stress of the rod", arguments)
    report.figure("cases", len(rows), "")
    count = Counter(row["outcome"] for row in rows)
    for outcome in ("ok", "failed", "refused"):
        report.figure(outcome, count[outcome], "cases")
    for outcome in BROKEN:
        report.figure(outcome, count[outcome], "cases", ("<=", 0))
    hundred = [row["outcome"] == "ok" for row in rows if row.get("load") == 100.0]
    report.figure("cold F L^2/EI = 100 solved", 100.0 * float(np.mean(hundred)), "%", (">=", 100.0))
    print(report)
    draw(rows, arguments.out / "stress_rod.png")
    report.write(arguments.json)
    if arguments.json is not None:
        _write(arguments.json.with_name(f"{arguments.json.stem}_cases.json"), rows)


def _write(path: Path, rows: list[Row]) -> None:
    part = path.with_name(f".{path.name}.{os.getpid()}")
    part.write_text(json.dumps(rows, indent=1))
    os.replace(part, path)


if __name__ == "__main__":
    run(main)
