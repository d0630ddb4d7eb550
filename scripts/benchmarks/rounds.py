"""Variants that take turns in one run, and other processes that keep the machine busy meanwhile."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from common.report import Report

Array = NDArray[np.float64]

BUSY = "while True: pass"


def rounds_of(
    variants: Mapping[str, Callable[[], Any]], rounds: int, clock: Callable[[], float], label: str
) -> dict[str, Array]:
    """Times [s] (rounds,) of every variant, which take turns after one run of each that does not count."""
    times: dict[str, list[float]] = {name: [] for name in variants}
    for i in tqdm(range(rounds + 1), desc=label, unit="round"):
        for name, action in variants.items():
            begin = clock()
            action()
            if i:
                times[name].append(clock() - begin)
    return {name: np.array(spent) for name, spent in times.items()}


def show(report: Report, title: str, times: Mapping[str, Array], unit: str = "s") -> None:
    """Smallest and median of every variant."""
    for name, spent in times.items():
        report.figure(f"{title}, {name}, smallest", float(spent.min()), unit)
        report.figure(f"{title}, {name}, median", float(np.median(spent)), unit)


@contextmanager
def busy_cores(count: int) -> Iterator[None]:
    """So many processes that do nothing but take time."""
    processes = [subprocess.Popen([sys.executable, "-c", BUSY]) for _ in range(count)]
    try:
        yield
    finally:
        for process in processes:
            process.kill()
            process.wait()
