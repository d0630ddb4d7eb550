"""Regressions on many columns: BLAS threads on a busy machine, and ridge by QR beside ridge by singular values.

Every figure is of rounds in which the variants take turns: smallest and median. Wall time where threads are compared
(other processes keep every core busy meanwhile), CPU time elsewhere.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # the other rooms of scripts/

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from benchmarks.benchmark_identification import sensor_data
from benchmarks.rounds import busy_cores, rounds_of, show
from common.report import Report, parser, run
from pisplit import BilinearEDMDc, Dictionary, Episodes
from pisplit import observables as ob
from pisplit.regression import accumulate, ridge

Array = NDArray[np.float64]

COLUMNS, TARGETS = 723, 144


def main() -> None:
    """Measure, print, write the figures."""
    given = parser(__doc__ or "").parse_args()
    report = Report.of("regressions on many columns", given)
    rng = np.random.default_rng(given.seed)
    rounds = 2 if given.quick else 7
    measure_threads(report, rng, rounds)
    with threadpool_limits(1):
        measure_ridge(report, rng, rounds, 400 if given.quick else 1000)
        measure_fit(report, rng, 1 if given.quick else 3, given.quick)
    report.write(given.json)
    print(f"\n{report}")


def measure_threads(report: Report, rng: np.random.Generator, rounds: int) -> None:
    """Moments and ridge in a process that has two BLAS threads, beside one that has one; as they are, and unlimited."""
    block, rows = rng.normal(size=(2048, COLUMNS)), rng.normal(size=(500, 300))
    targets = rng.normal(size=(500, TARGETS))

    def under(threads: int, action: Callable[[], Any]) -> None:
        with threadpool_limits(threads):
            action()

    for busy in (0, os.cpu_count() or 1):
        actions: dict[str, tuple[Callable[[], Any], Callable[[], Any]]] = {
            f"moments, N = {len(block)}, M = {COLUMNS}": (
                partial(accumulate, [block]),
                partial(getattr(accumulate, "__wrapped__"), [block]),  # noqa: B009
            ),
            f"ridge, {rows.shape[0]} x {rows.shape[1]}": (
                partial(ridge, rows, targets, 1.0),
                partial(getattr(ridge, "__wrapped__"), rows, targets, 1.0),  # noqa: B009
            ),
        }
        for name, (limited, unlimited) in actions.items():
            variants = {
                "one thread": partial(under, 1, limited),
                "two threads": partial(under, 2, limited),
                "two threads, not limited": partial(under, 2, unlimited),
            }
            title = f"{name}, {busy} other processes"
            with busy_cores(busy):
                times = rounds_of(variants, rounds, time.perf_counter, title)
            show(report, title, times)
            for other in ("two threads", "two threads, not limited"):
                ratio = float(np.median(times[other]) / np.median(times["one thread"]))
                report.figure(f"{title}, {other} : one", ratio, "", ("<=", 1.3) if other == "two threads" else None)


def measure_ridge(report: Report, rng: np.random.Generator, rounds: int, size: int) -> None:
    """One ridge on the triangle of the data."""
    triangle: Array = np.asarray(np.linalg.qr(rng.normal(size=(4 * size, size + TARGETS)), mode="r"))
    a, y = triangle[:, :size], triangle[:, size:]
    variants: dict[str, Callable[[], Any]] = {
        "QR": partial(ridge, a, y, 1.0),
        "singular values": partial(by_singular_values, a, y, 1.0),
    }
    title = f"ridge, triangle of {size} columns and {TARGETS} targets"
    show(report, title, rounds_of(variants, rounds, time.process_time, title))
    distance = float(np.abs(ridge(a, y, 1.0).K - by_singular_values(a, y, 1.0)).max())
    report.figure(f"{title}, largest difference", distance, "", ("<=", 1e-12))


def by_singular_values(a: Array, y: Array, alpha: float) -> Array:
    """K (S, M) of the ridge by the singular value decomposition of ``a``."""
    u, s, vt = np.linalg.svd(a, full_matrices=False)
    return np.asarray(((vt.T * (s / (s**2 + alpha))) @ (u.T @ y)).T)


def measure_fit(report: Report, rng: np.random.Generator, rounds: int, quick: bool) -> None:
    """A whole fit of a bilinear model: with alpha > 0 by QR; with alpha = 0 by singular values, as any alpha once."""
    states, delays = (24, 2) if quick else (144, 4)
    x, u = sensor_data(rng, 3200)
    d1 = Episodes([x[:, :states]], [u[:-1]], 0.03)
    terms = (ob.Constant(), ob.Identity(), ob.Delays(states=delays, inputs=1))
    theta = Dictionary(*terms, n_states=states, n_inputs=3).bilinear()
    title = f"B-EDMDc, {len(d1.pairs(delays))} pairs, {theta.n_columns} columns"
    variants = {
        "alpha = 1e-6": partial(BilinearEDMDc(theta, alpha=1e-6).fit, d1),
        "alpha = 0": partial(BilinearEDMDc(theta, alpha=0.0).fit, d1),
    }
    show(report, title, rounds_of(variants, rounds, time.process_time, title))


if __name__ == "__main__":
    run(main)
