"""Cases run in worker processes under a wall-clock limit: a hang or a crash costs one worker, never the run."""

from __future__ import annotations

import multiprocessing
import threading
from collections.abc import Callable, Sequence
from multiprocessing.connection import Connection
from queue import Empty, SimpleQueue
from typing import Any

from tqdm import tqdm

Case = dict[str, Any]
Outcome = dict[str, Any]


def run_watched(cases: Sequence[Case], work: Callable[[Case], Outcome], limit: float, workers: int) -> list[Outcome]:
    """Outcome of every case, in order. A case over ``limit`` s is ``hang``, one that kills its worker ``crash``."""
    waiting: SimpleQueue[int] = SimpleQueue()
    for index in range(len(cases)):
        waiting.put(index)
    found: list[Outcome] = [{} for _ in cases]
    with tqdm(total=len(cases), desc="stress", unit="case") as bar:
        threads = [
            threading.Thread(target=_serve, args=(cases, work, limit, waiting, found, bar)) for _ in range(workers)
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
    found: list[Outcome],
    bar: tqdm[Any],
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
            if pipe.poll(limit):
                outcome = pipe.recv()
            else:
                outcome = {"outcome": "hang", "message": f"no answer in {limit:g} s"}
        except (EOFError, OSError):
            pass
        if outcome["outcome"] in ("hang", "crash"):
            process.kill()
            process.join()
            process, pipe = _start(work)
        found[index] = outcome
        bar.update()
    process.kill()
    process.join()


def _start(work: Callable[[Case], Outcome]) -> tuple[Any, Connection]:
    context = multiprocessing.get_context("spawn")
    mine, theirs = context.Pipe()
    process = context.Process(target=_loop, args=(theirs, work), daemon=True)
    process.start()
    theirs.close()
    return process, mine


def _loop(pipe: Connection, work: Callable[[Case], Outcome]) -> None:
    while True:
        try:
            case = pipe.recv()
        except EOFError:
            return
        pipe.send(work(case))
