"""One mutant against the tests that execute it: those most about it first, until one notices."""

from __future__ import annotations

import math
import os
import re
import resource
import sys
from collections import Counter, defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mutation.copies import Copy
from mutation.operators import Mutation
from mutation.reached import Passing, Reach
from mutation.rooms import PACKAGE

#: A test is stopped after so many times its own CPU time, and the seconds of grace.
SLACK = 3.0
#: CPU time [s] that loading and collecting one test file takes, for the order alone.
LOADING = 0.3


@dataclass(frozen=True)
class Trial:
    """A mutated file and the tests to run on it, in groups of (test, CPU seconds without the mutation).

    A test is stopped ``grace`` seconds of CPU time after ``SLACK`` times its own.
    """

    mutation: Mutation
    source: bytes
    groups: tuple[tuple[tuple[str, float], ...], ...]
    grace: float

    @property
    def seconds(self) -> float:
        """CPU time of all its tests without the mutation."""
        return sum(seconds for group in self.groups for _, seconds in group)


def covering(mutation: Mutation, reach: Reach, folder: Path) -> list[Passing]:
    """Tests that execute the mutated line; for a constant of a module those that use its file or name it.

    What a module computes from its constants while it is imported belongs to no test: a test may depend on a constant
    whose name it never executes.
    """
    if mutation.executed is not None:
        first, last = mutation.executed
        wanted = {mutation.file: set(range(first, last + 1))}
    else:
        wanted = _naming(mutation, folder)
    constant = mutation.executed is None
    naming = _tests_naming(mutation, folder) if constant else set()
    return [
        test
        for test in reach.tests
        if (constant and (mutation.file in test.lines or test.file in naming))
        or any(test.lines.get(file, frozenset()) & lines for file, lines in wanted.items())
    ]


def _tests_naming(mutation: Mutation, folder: Path) -> set[str]:
    """Test files that read the constant itself."""
    if not mutation.names:
        return set()
    files = (folder / "tests").rglob("test_*.py")
    return {path.relative_to(folder).as_posix() for path in files if _pattern(mutation).search(path.read_text())}


def _pattern(mutation: Mutation) -> re.Pattern[str]:
    return re.compile(rf"\b({'|'.join(map(re.escape, mutation.names))})\b")


def _naming(mutation: Mutation, folder: Path) -> dict[str, set[int]]:
    if not mutation.names:
        return {}
    pattern = _pattern(mutation)
    found: dict[str, set[int]] = {}
    for part in PACKAGE:
        for path in (folder / part).rglob("*.py"):
            lines = {i for i, line in enumerate(path.read_text().splitlines(), 1) if pattern.search(line)}
            if lines:
                found[path.relative_to(folder).as_posix()] = lines
    return found


def plan(
    mutation: Mutation, source: bytes, tests: Sequence[Passing], killers: Counter[str], budget: float, grace: float
) -> Trial:
    """The trial: tests that killed others of this file first, then file by file, short and specific ones first.

    ``budget``: CPU seconds of all tests; the longest are left out beyond it.
    """
    chosen: list[Passing] = []
    total = 0.0
    for test in sorted(tests, key=lambda t: (-killers[t.name], t.seconds)):
        if chosen and total + test.seconds > budget:
            continue
        chosen.append(test)
        total += test.seconds
    known = [test for test in chosen if killers[test.name]]
    groups = [known[:8]] if known else []
    by_file: dict[str, list[Passing]] = defaultdict(list)
    for test in chosen:
        if test not in known[:8]:
            by_file[test.file].append(test)

    def cost(group: list[Passing]) -> float:
        share = sum(test.share(mutation.file) for test in group) / len(group)
        return (sum(test.seconds for test in group) + LOADING) / (share + 1e-3)

    ordered = sorted(by_file.values(), key=cost)
    size = 1
    while ordered:
        groups.append(sorted((test for group in ordered[:size] for test in group), key=lambda t: t.seconds))
        ordered, size = ordered[size:], 2 * size
    return Trial(mutation, source, tuple(tuple((t.name, t.seconds) for t in group) for group in groups), grace)


def try_out(_: Copy, trial: Trial) -> str | None:
    """The test that notices the mutation, or None; runs in a fork that has not loaded the package."""
    import pytest

    sys.dont_write_bytecode = True
    for group in trial.groups:
        chosen = _Chosen(dict(group), trial.grace)
        files = list(dict.fromkeys(name.split("::")[0] for name, _ in group))
        code = pytest.main([*files, "-x", "-p", "no:cacheprovider", f"--rootdir={os.getcwd()}"], plugins=[chosen])
        if chosen.failed is not None:
            return chosen.failed
        if code not in (pytest.ExitCode.OK, pytest.ExitCode.NO_TESTS_COLLECTED):
            return f"{files[0]} (not collected)"
    return None


class _Chosen:
    """Pytest plugin: only these tests, in this order, each within its limit of CPU time."""

    def __init__(self, seconds: dict[str, float], grace: float) -> None:
        self._seconds, self._grace = seconds, grace
        self.failed: str | None = None

    def pytest_collection_modifyitems(self, items: list[Any]) -> None:
        order = {name: i for i, name in enumerate(self._seconds)}
        items[:] = sorted((item for item in items if item.nodeid in order), key=lambda item: order[item.nodeid])

    def pytest_runtest_logstart(self, nodeid: str) -> None:
        used = sum(os.times()[:2])
        _, hard = resource.getrlimit(resource.RLIMIT_CPU)
        resource.setrlimit(resource.RLIMIT_CPU, (math.ceil(used + SLACK * self._seconds[nodeid] + self._grace), hard))

    def pytest_runtest_logreport(self, report: Any) -> None:
        if report.failed and self.failed is None:
            self.failed = report.nodeid
