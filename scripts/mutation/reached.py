"""Which test executes which line of the package: every test file run once under coverage, kept until it changes."""

from __future__ import annotations

import functools
import json
import os
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from tqdm import tqdm

from mutation.copies import Copy, file_digest
from mutation.forks import Task, run_forked
from mutation.rooms import PACKAGE
from pisplit.files import write_text

#: A test file that needs longer than this is not measured.
WALL = 1200.0
Cached = type(functools.lru_cache(lambda: None))


@dataclass(frozen=True)
class Passing:
    """A test that passes: its CPU time [s] and the lines of every file that it executes, fixtures included."""

    name: str
    seconds: float
    lines: dict[str, frozenset[int]]

    @property
    def file(self) -> str:
        """The file of the test."""
        return self.name.split("::")[0]

    def share(self, file: str) -> float:
        """Part of all lines it executes that is in this file: how much the test is about it."""
        return len(self.lines.get(file, ())) / max(sum(map(len, self.lines.values())), 1)


@dataclass(frozen=True)
class Reach:
    """All tests, the names of those that failed without any mutation, and files that could not be measured."""

    tests: tuple[Passing, ...]
    failed: tuple[str, ...]
    unmeasured: tuple[str, ...]


def measure_reach(copies: list[Copy], kept: Path, only: Sequence[str] = ()) -> Reach:
    """Measure every test file of the copies whose own contents, or those of a file it executes, changed since.

    ``only``: parts of the names of the test files that matter; all of them if empty.
    """
    folder = copies[0].folder
    entries: dict[str, Any] = json.loads(kept.read_text()) if kept.exists() else {}
    names = sorted(path.relative_to(folder).as_posix() for path in (folder / "tests").rglob("test_*.py"))
    entries = {name: entries[name] for name in names if name in entries and _current(folder, entries[name])}
    asked = [name for name in names if not only or any(part in name for part in only)]
    wanted = [name for name in asked if name not in entries]
    unmeasured = []
    tasks = (Task(name, _measure, lambda _copy, _item: nullcontext(), WALL) for name in wanted)
    for name, end in tqdm(run_forked(tasks, copies), "who tests what", len(wanted), unit="file", disable=not wanted):
        if end.how != "done":
            unmeasured.append(name)
            continue
        entries[name] = end.value
        write_text(kept, json.dumps(entries))
    chosen = [entries[name] for name in asked if name in entries]
    tests = tuple(
        Passing(test, found["seconds"], {file: frozenset(lines) for file, lines in found["lines"].items()})
        for entry in chosen
        for test, found in entry["tests"].items()
    )
    failed = tuple(test for entry in chosen for test in entry["failed"])
    return Reach(tests, failed, tuple(unmeasured))


def _current(folder: Path, entry: dict[str, Any]) -> bool:
    return all(file_digest(folder / name) == digest for name, digest in entry["files"].items())


def _measure(copy: Copy, name: str) -> dict[str, Any]:
    """What the tests of one file execute; runs in a fork that has not loaded the package."""
    os.environ["COVERAGE_CORE"] = "ctrace"  # the one that tells tests apart
    import coverage

    include = [f"{copy.folder}/{part}/*" for part in PACKAGE]
    cover = coverage.Coverage(data_file=None, include=include, config_file=False, messages=False)
    contexts = Contexts(cover.switch_context)
    cover.start()
    pytest.main([name, "-p", "no:cacheprovider", f"--rootdir={copy.folder}"], plugins=[contexts])
    cover.stop()
    data = cover.get_data()
    lines: dict[str, dict[str, list[int]]] = defaultdict(lambda: defaultdict(list))
    files = {name}
    for path in data.measured_files():
        file = Path(path).relative_to(copy.folder.resolve()).as_posix()
        files.add(file)
        for line, names in data.contexts_by_lineno(path).items():
            for context in names:
                lines[context][file].append(line)
    tests = {}
    for test, seconds in contexts.passed.items():
        found: dict[str, set[int]] = defaultdict(set)
        for context in contexts.behind(test):
            for file, numbers in lines.get(context, {}).items():
                found[file].update(numbers)
        tests[test] = {"seconds": seconds, "lines": {file: sorted(numbers) for file, numbers in found.items()}}
    digests = {file: file_digest(copy.folder / file) for file in sorted(files)}
    return {"files": digests, "tests": tests, "failed": sorted(contexts.failed)}


class Contexts:
    """Pytest plugin: what runs inside a shared fixture or a cached helper counts for every test that uses it."""

    def __init__(self, switch: Callable[[str], object]) -> None:
        self._switch = switch
        self._stack = [""]
        self._bad = False
        self._uses: dict[str, set[str]] = defaultdict(set)
        self.passed: dict[str, float] = {}
        self.failed: set[str] = set()

    def behind(self, context: str) -> set[str]:
        """The context and all it uses, directly or not."""
        found, left = {context}, [context]
        while left:
            more = self._uses[left.pop()] - found
            found |= more
            left += more
        return found

    @contextmanager
    def inside(self, context: str) -> Iterator[None]:
        """Lines executed now belong to this context."""
        self._uses[self._stack[-1]].add(context)
        self._stack.append(context)
        self._switch(context)
        try:
            yield
        finally:
            self._stack.pop()
            self._switch(self._stack[-1])

    def pytest_collection_modifyitems(self, items: list[Any]) -> None:
        """Cached helpers of the test modules report who calls them."""
        for module in {item.module for item in items if hasattr(item, "module")}:
            for name, value in list(vars(module).items()):
                if isinstance(value, Cached) and value.__module__ == module.__name__:
                    setattr(module, name, self._reporting(name, value))

    def _reporting(self, name: str, function: Any) -> Callable[..., Any]:
        @functools.wraps(function)
        def call(*args: Any, **kwargs: Any) -> Any:
            with self.inside(f"cached {name} {args!r} {kwargs!r}"):
                return function(*args, **kwargs)

        return call

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: Any) -> Iterator[None]:
        """Everything from set-up to tear-down belongs to the test, and so do the shared fixtures that it uses."""
        before = os.times()
        self._bad = False
        information = getattr(item, "_fixtureinfo", None)
        for definitions in information.name2fixturedefs.values() if information else ():
            self._uses[item.nodeid].update(_shared(d) for d in definitions if d.scope != "function")
        with self.inside(item.nodeid):
            result = yield
        after = os.times()
        if not self._bad:
            self.passed[item.nodeid] = sum(after[:4]) - sum(before[:4])
        return result

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Only tests that pass without a mutation can notice one."""
        self._bad |= not report.passed
        if report.failed:
            self.failed.add(report.nodeid)

    @pytest.hookimpl(wrapper=True)
    def pytest_fixture_setup(self, fixturedef: Any) -> Iterator[None]:
        """Shared fixtures are contexts of their own."""
        if fixturedef.scope == "function":
            return (yield)
        with self.inside(_shared(fixturedef)):
            return (yield)


def _shared(definition: Any) -> str:
    return f"fixture {definition.baseid}::{definition.argname}"
