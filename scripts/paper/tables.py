"""Medians, quartiles and divergence of a protocol's cells, as rows of a table."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from common.protocol import Errors, summary
from common.runs import Cell, Result
from pisplit.files import write_text

COLUMNS = (
    "law",
    "method",
    "n1",
    "n2",
    "draws",
    "shape median [m^2]",
    "shape lower quartile [m^2]",
    "shape upper quartile [m^2]",
    "velocity median [m^2/s^2]",
    "velocity lower quartile [m^2/s^2]",
    "velocity upper quartile [m^2/s^2]",
    "diverged",
    "median step of divergence",
    "refused fits",
    "fit [s]",
)
Row = dict[str, Any]


def table(results: Mapping[Cell, Result]) -> list[Row]:
    """One row for every law, method, |D1| and |D2|, over all steps of all test roll-outs of all draws."""
    groups: dict[tuple[str, str, int, int], list[Result]] = {}
    for cell, result in results.items():
        groups.setdefault((cell.law, cell.method, cell.n1, cell.n2), []).append(result)
    return [_row(key, groups[key]) for key in sorted(groups)]


def _row(key: tuple[str, str, int, int], results: Sequence[Result]) -> Row:
    errors = [r.errors for r in results]
    shape, velocity = summary(errors), summary(errors, "velocity")
    values = [
        *key,
        len(results),
        *(shape.median, shape.lower, shape.upper),
        *(velocity.median, velocity.lower, velocity.upper),
        shape.diverged,
        _divergence(errors),
        sum("refused" in r.facts for r in results),
        float(np.median([r.seconds for r in results])),
    ]
    return dict(zip(COLUMNS, values, strict=True))


def _divergence(errors: Sequence[Errors]) -> float:
    at = np.concatenate([e.diverged_at for e in errors])
    return float(np.median(at[at >= 0])) if (at >= 0).any() else np.inf


def write_csv(rows: Sequence[Row], path: Path) -> None:
    """The table as CSV; infinite values are written as inf."""
    text = io.StringIO()
    writer = csv.DictWriter(text, COLUMNS, lineterminator="\n")
    writer.writeheader()
    writer.writerows({k: f"{v:.6g}" if isinstance(v, float) else v for k, v in row.items()} for row in rows)
    write_text(path, text.getvalue(), make_folders=True)


def finite(rows: Sequence[Row]) -> list[Row]:
    """The same rows for JSON: None where a value is infinite."""
    return [{k: None if isinstance(v, float) and not np.isfinite(v) else v for k, v in row.items()} for row in rows]


def printed(rows: Sequence[Row], label: str = "method") -> str:
    """The table as text."""
    width = max(len(str(row[label])) for row in rows)
    head = f"{'law':<12} {label:<{width}} {'|D1|':>7} {'|D2|':>7} {'shape [m^2]':>29}"
    lines = [f"{head} {'velocity':>9} {'diverged':>9} {'at step':>7}"]
    for row in rows:
        lower, median, upper = (row[f"shape {q} [m^2]"] for q in ("lower quartile", "median", "upper quartile"))
        shape = f"{median:.2e} [{lower:.1e}, {upper:.1e}]"
        line = f"{row['law']:<12} {row[label]:<{width}} {row['n1']:>7} {row['n2']:>7} {shape:>29}"
        line += f" {row['velocity median [m^2/s^2]']:>9.2e} {100 * row['diverged']:>7.0f} %"
        lines.append(line + (f" {row['median step of divergence']:>7.0f}" if row["diverged"] > 0.0 else ""))
    return "\n".join(lines)
