"""Damaged files: each is refused in one line or gives the numbers that were saved. None crashes, hangs or lies."""

from __future__ import annotations

import json
import sys
import time
from collections import Counter
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # the other rooms of scripts/

from common.report import Report, parser, run
from stress.damage import DAMAGES, KINDS, LOST, OTHER, RAW, REFUSED, SAME, work
from stress.watched import run_watched

OUTCOMES = (REFUSED, SAME, OTHER, RAW, *LOST)
BROKEN = (OTHER, RAW, *LOST)
QUICK = 100


def main() -> None:
    """Damage files of every kind, load them, count what becomes of them."""
    made = parser(__doc__ or "")
    made.add_argument("--number", type=int, default=2000, help="damaged files of each kind")
    made.add_argument("--limit", type=float, default=20.0, help="limit of a load in s of CPU time")
    made.add_argument("--workers", type=int, default=2, help="worker processes")
    made.add_argument("--kind", choices=list(KINDS), action="append", help="this kind only (may be repeated)")
    made.add_argument("--unverified", action="store_true", help="load without verification, to see what it is good for")
    made.add_argument("--case", metavar="JSON", help="load this one file only, as printed by a run")
    arguments = made.parse_args()
    if arguments.case is not None:
        print(json.dumps(work(json.loads(arguments.case)), indent=1))
        return
    number = QUICK if arguments.quick else arguments.number
    cases = [
        {"kind": kind, "seed": number * arguments.seed + k, "unverified": arguments.unverified}
        for kind in arguments.kind or KINDS
        for k in range(number)
    ]
    began = time.perf_counter()
    rows = [
        case | found
        for case, found in zip(cases, run_watched(cases, work, arguments.limit, arguments.workers), strict=True)
    ]
    report = Report.of("damaged files", arguments)
    print(table(rows))
    report.figure("damaged files", len(rows), "files")
    report.figure("wall-clock time", time.perf_counter() - began, "s")
    for outcome in OUTCOMES:
        count = sum(row["outcome"] == outcome for row in rows)
        report.figure(outcome, count, "files", ("<=", 0) if outcome in BROKEN else None)
    report.arguments["outcomes"] = {kind: counts(rows, "kind", kind) for kind in KINDS}
    print(report)
    report.write(arguments.json)
    broken = [row for row in rows if row["outcome"] in BROKEN]
    if broken and not arguments.unverified:
        raise ValueError(f"{len(broken)} of {len(rows)} damaged files are neither refused in one line nor whole")


def counts(rows: list[dict[str, Any]], column: str, value: str) -> dict[str, int]:
    """How often each outcome happened to the files with ``value`` in ``column``."""
    return dict(Counter(row["outcome"] for row in rows if row.get(column) == value))


def table(rows: list[dict[str, Any]]) -> str:
    """Outcomes by kind and by damage, the messages of each kind, and the first files that are neither."""
    lines = ["  ".join([f"{'':22}", *(f"{outcome:>13}" for outcome in OUTCOMES)])]
    for column, values in (("kind", KINDS), ("damage", DAMAGES)):
        for value in values:
            found = counts(rows, column, value)
            if found:
                lines.append("  ".join([f"{value:22}", *(f"{found.get(outcome, 0):13}" for outcome in OUTCOMES)]))
    for row in [row for row in rows if row["outcome"] in BROKEN][:20]:
        case = json.dumps({name: row[name] for name in ("kind", "seed", "unverified")})
        lines += [f"{row['outcome']}: {' '.join(row['message'].split())[:160]}", f"  --case '{case}'"]
    return "\n".join(lines)


if __name__ == "__main__":
    run(main)
