"""Tasks in forked processes that inherit the libraries already loaded, each with a copy of the tree to itself."""

from __future__ import annotations

import gc
import importlib
import json
import os
import signal
import sys
import time
import traceback
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, TypeVar

from mutation.copies import Copy
from mutation.rooms import PACKAGE

T = TypeVar("T")
#: Loaded once, before any fork; never the package itself.
LIBRARIES = (
    *("numpy", "scipy.linalg", "scipy.sparse.linalg", "scipy.interpolate", "scipy.optimize", "scipy.integrate"),
    *("scipy.io", "scipy.signal", "scipy.special", "casadi", "cvxpy", "osqp", "h5py", "joblib", "tqdm", "PIL.Image"),
    *("matplotlib.pyplot", "matplotlib.animation", "control", "sklearn.linear_model", "hypothesis", "coverage"),
    *("pytest", "_pytest.assertion.rewrite"),
)
#: A mutant may ask for any amount of memory.
MEMORY = 8 << 30


@dataclass(frozen=True)
class Ended:
    """How a task ended: "done" with its value, "timeout" (CPU or wall time), or "crash"."""

    how: str
    value: Any = None


@dataclass(frozen=True)
class Task(Generic[T]):
    """``work(copy, item)`` in a process of its own while ``prepared(copy, item)`` is in force, within ``wall`` s."""

    item: T
    work: Callable[[Copy, T], Any]
    prepared: Callable[[Copy, T], AbstractContextManager[None]]
    wall: float


def load_libraries(names: Iterable[str] = LIBRARIES) -> None:
    """Import what every fork needs; what is not installed is left to the tests, which skip or fail."""
    os.environ |= {"MPLBACKEND": "Agg", "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"}
    for name in names:
        try:
            importlib.import_module(name)
        except ImportError:
            continue
    gc.collect()
    gc.freeze()  # collections in forks would otherwise copy every page


def run_forked(tasks: Iterable[Task[T]], copies: list[Copy]) -> Iterator[tuple[T, Ended]]:
    """Run the tasks, one a copy at a time, and yield items with their ends as they come."""
    waiting = iter(tasks)
    free = list(copies)
    running: dict[int, tuple[Task[T], Copy, AbstractContextManager[None], float]] = {}
    exhausted = False
    try:
        while running or not exhausted:
            while free and not exhausted:
                task = next(waiting, None)
                if task is None:
                    exhausted = True
                    break
                copy = free.pop()
                state = task.prepared(copy, task.item)
                state.__enter__()
                running[_fork(task, copy)] = task, copy, state, time.monotonic()
            for pid in list(running):
                task, copy, state, started = running[pid]
                late = time.monotonic() - started > task.wall
                if late:
                    _kill(pid)
                found, status = os.waitpid(pid, 0 if late else os.WNOHANG)
                if found == 0:
                    continue
                _kill(pid)  # whatever it has left behind
                del running[pid]
                state.__exit__(None, None, None)
                free.append(copy)
                yield task.item, Ended("timeout") if late else _end(status, copy)
            time.sleep(0.01)
    finally:
        for pid, (_, _, state, _) in running.items():
            _kill(pid)
            os.waitpid(pid, 0)
            state.__exit__(None, None, None)


def _result(copy: Copy) -> Path:
    return copy.folder.with_suffix(".json")


def _fork(task: Task[T], copy: Copy) -> int:
    _result(copy).unlink(missing_ok=True)
    sys.stdout.flush()
    sys.stderr.flush()
    pid = os.fork()
    if pid:
        return pid
    code = 1
    try:
        os.setpgid(0, 0)
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        _limit_memory()
        log = os.open(copy.folder.with_suffix(".log"), os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o644)
        os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
        os.dup2(log, 1)
        os.dup2(log, 2)
        os.chdir(copy.folder)
        _forget_package()
        sys.path.insert(0, str(copy.folder))
        os.environ |= {"PYTHONPATH": str(copy.folder), "PYTHONDONTWRITEBYTECODE": "1"}
        _result(copy).write_text(json.dumps(task.work(copy, task.item)))
        code = 0
    except BaseException:
        traceback.print_exc()
    finally:
        os._exit(code)


def _end(status: int, copy: Copy) -> Ended:
    if os.WIFEXITED(status) and os.WEXITSTATUS(status) == 0 and _result(copy).exists():
        return Ended("done", json.loads(_result(copy).read_text()))
    timed_out = os.WIFSIGNALED(status) and os.WTERMSIG(status) == signal.SIGXCPU
    return Ended("timeout" if timed_out else "crash")


def _kill(pid: int) -> None:
    for kill in (os.killpg, os.kill):
        try:
            kill(pid, signal.SIGKILL)
        except (ProcessLookupError, PermissionError):
            continue


def _forget_package() -> None:
    """Let imports find the package in the copy, whatever the scripts have loaded of it."""
    for name in [name for name in sys.modules if name.split(".")[0] == PACKAGE[0]]:
        del sys.modules[name]
    sys.meta_path[:] = [finder for finder in sys.meta_path if type(finder).__module__.split(".")[0] != PACKAGE[0]]


def _limit_memory() -> None:
    import resource

    _, hard = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, hard))
