"""Cases run in worker processes under a limit of their time: a hang or a crash costs one worker, never the run."""

from __future__ import annotations

import json
import multiprocessing
import os
import threading
import time
from collections.abc import Callable, Sequence
from multiprocessing.connection import Connection
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any

from tqdm import tqdm

from pisplit.data import store

Case = dict[str, Any]
Outcome = dict[str, Any]
#: Seconds between two writes of what is finished.
EVERY = 2.0
#: Time by the clock that a case may take, in parts of its limit: it may wait, and others may use the machine.
WAITING = 10.0
#: Seconds that a worker without work is given to end.
PATIENCE = 5.0


class Finished:
    """Outcomes in a file beside the run, so that one that is killed goes on where it was.

    The file belongs to one set of ``arguments``; with others it is begun anew. It is written whole or not at all, every
    ``EVERY`` seconds at most, and removed when the run is over.
    """

    def __init__(self, path: Path, arguments: dict[str, Any]) -> None:
        self._path, self._arguments = path, arguments
        self._outcomes: dict[str, Outcome] = {}
        self._written, self._lock = time.monotonic(), threading.Lock()
        if path.exists():
            kept = store.load_json(path)
            if kept["arguments"] == arguments:
                self._outcomes = kept["outcomes"]

    def get(self, case: Case) -> Outcome | None:
        """The outcome of a case, None if it has not been run."""
        return self._outcomes.get(_key(case))

    def put(self, case: Case, outcome: Outcome) -> None:
        """Keep the outcome of a case."""
        with self._lock:
            self._outcomes[_key(case)] = outcome
            if time.monotonic() - self._written >= EVERY:
                self._write()
                self._written = time.monotonic()

    def remove(self) -> None:
        """The run is over."""
        self._path.unlink(missing_ok=True)

    def _write(self) -> None:
        store.save_json(self._path, {"arguments": self._arguments, "outcomes": self._outcomes})


def _key(case: Case) -> str:
    return json.dumps(case, sort_keys=True)


def run_watched(
    cases: Sequence[Case],
    work: Callable[[Case], Outcome],
    limit: float,
    workers: int,
    finished: Finished | None = None,
) -> list[Outcome]:
    """Outcome of every case, in order. One that takes longer is ``hang``, one that kills its worker ``crash``.

    ``limit`` is in s of CPU time, so that a busy machine makes no hangs; a case that waits has ``WAITING`` times that.

    Cases that ``finished`` holds are not run again; it is given the others as they end.
    """
    known = [None if finished is None else finished.get(case) for case in cases]
    waiting: SimpleQueue[int] = SimpleQueue()
    for index in (k for k, outcome in enumerate(known) if outcome is None):
        waiting.put(index)
    found: list[Outcome] = [outcome or {} for outcome in known]

    def keep(index: int, outcome: Outcome) -> None:
        found[index] = outcome
        if finished is not None:
            finished.put(cases[index], outcome)
        bar.update()

    with tqdm(total=len(cases), initial=len(cases) - waiting.qsize(), desc="stress", unit="case") as bar:
        threads = [
            threading.Thread(target=_serve, args=(cases, work, limit, waiting, keep), daemon=True)
            for _ in range(min(workers, waiting.qsize()))
        ]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    return found


def _serve(
    cases: Sequence[Case],
    work: Callable[[Case], Outcome],
    limit: float,
    waiting: SimpleQueue[int],
    keep: Callable[[int, Outcome], None],
) -> None:
    process, pipe = _start(work)
    while True:
        try:
            index = waiting.get_nowait()
        except Empty:
            break
        outcome: Outcome = {"outcome": "crash", "message": "the worker died"}
        try:
            pipe.send(cases[index])
            if _answers(process, pipe, limit):
                outcome = pipe.recv()
            else:
                outcome = {"outcome": "hang", "message": f"no answer in {limit:g} s of CPU time"}
        except (EOFError, OSError):
            pass
        if outcome["outcome"] in ("hang", "crash"):
            process.kill()
            process.join()
            process, pipe = _start(work)
        keep(index, outcome)
    pipe.close()  # the worker ends by itself, and tidies up
    process.join(PATIENCE)
    process.kill()
    process.join()


def _answers(process: Any, pipe: Connection, limit: float) -> bool:
    """Whether an answer comes before the worker has used ``limit`` s."""
    used, end = _cpu_seconds(process.pid), time.monotonic() + WAITING * limit
    while not pipe.poll(min(0.5, limit)):
        if _cpu_seconds(process.pid) - used > limit or time.monotonic() > end:
            return pipe.poll(0.0)
    return True


def _cpu_seconds(pid: int) -> float:
    """CPU time of a process; that of the clock where the system does not tell, and of one that has ended."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()
        return sum(map(int, fields[11:13])) / os.sysconf("SC_CLK_TCK")
    except (OSError, ValueError, IndexError):
        return time.monotonic()


def _start(work: Callable[[Case], Outcome]) -> tuple[Any, Connection]:
    context = multiprocessing.get_context("spawn")
    mine, theirs = context.Pipe()
    process = context.Process(target=_loop, args=(theirs, work), daemon=True)
    process.start()
    theirs.close()
    return process, mine


def _loop(pipe: Connection, work: Callable[[Case], Outcome]) -> None:
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)  # solvers print why they give up, across the progress bar
    while True:
        try:
            case = pipe.recv()
        except EOFError:
            return
        pipe.send(work(case))
