"""What all scripts share: arguments, a table of measured figures, and the JSON that keeps them."""

from __future__ import annotations

import argparse
import json
import os
import platform
import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from importlib.metadata import PackageNotFoundError, version
from math import isfinite
from pathlib import Path
from typing import Any

from pisplit.files import write_text

#: A target is a bound on the measured value.
Target = tuple[str, float]
LIBRARIES = ("pisplit", "casadi", "numpy", "scipy", "osqp", "cvxpy", "h5py", "joblib", "matplotlib")


def parser(description: str, out: str = "out") -> argparse.ArgumentParser:
    """Arguments of every script: --seed, --quick, --json, --out."""
    made = argparse.ArgumentParser(description=description, formatter_class=argparse.ArgumentDefaultsHelpFormatter)
    made.add_argument("--seed", type=int, default=0, help="seed of all random draws")
    made.add_argument("--quick", action="store_true", help="a smaller run of under a minute")
    made.add_argument("--json", type=Path, default=None, metavar="PATH", help="write the figures to this file")
    made.add_argument("--out", type=Path, default=Path(out), metavar="DIR", help="folder for pictures and data")
    return made


def run(main: Callable[[], None]) -> None:
    """Run a script; what is wrong with its arguments or files ends it with one line, not with a traceback."""
    try:
        main()
    except (ValueError, OSError) as error:
        sys.exit(f"error: {' '.join(str(error).split())}")


@dataclass
class Report:
    """Figures measured in one run, each with its unit and, where there is one, the target it is held against."""

    title: str
    arguments: dict[str, Any]
    figures: dict[str, dict[str, Any]] = field(default_factory=dict)

    @classmethod
    def of(cls, title: str, arguments: argparse.Namespace) -> Report:
        """A report on a run with these arguments."""
        return cls(title, {name: str(v) if isinstance(v, Path) else v for name, v in vars(arguments).items()})

    def figure(self, name: str, value: float, unit: str, target: Target | None = None) -> None:
        """Record one measured value; ``target`` is ("<=" or ">=", bound) in the same unit."""
        met = None
        if target is not None:
            kind, bound = target
            if kind not in ("<=", ">="):
                raise ValueError(f"target of {name!r} starts with {kind!r}; expected '<=' or '>='")
            met = bool(value <= bound if kind == "<=" else value >= bound)
        self.figures[name] = {
            "value": float(value) if isfinite(value) else None,  # JSON has no NaN
            "unit": unit,
            "target": None if target is None else f"{target[0]} {target[1]:g} {unit}".strip(),
            "met": met,
        }

    def __str__(self) -> str:
        width = max((len(name) for name in self.figures), default=0)
        lines = [self.title]
        for name, f in self.figures.items():
            verdict = "" if f["met"] is None else f"  target {f['target']}: {'met' if f['met'] else 'MISSED'}"
            value = "not finite" if f["value"] is None else f"{f['value']:10.4g}"
            lines.append(f"  {name:<{width}}  {value} {f['unit']}{verdict}")
        return "\n".join(lines)

    def write(self, path: Path | None) -> None:
        """Write the report as JSON, whole or not at all; nothing if ``path`` is None."""
        if path is None:
            return
        content = {
            "title": self.title,
            "figures": self.figures,
            "machine": {"system": platform.platform(), "processor": platform.machine(), "cores": os.cpu_count()},
            "versions": {"python": platform.python_version(), **{name: _version(name) for name in LIBRARIES}},
            "seed": self.arguments.get("seed"),
            "arguments": self.arguments,
        }
        text = json.dumps(content, indent=1, allow_nan=False)
        write_text(path, text + "\n", make_folders=True)


def _version(name: str) -> str:
    """Version of an installed library; a source tree that is run in place has none."""
    try:
        return version(name)
    except PackageNotFoundError:
        return "not installed"
