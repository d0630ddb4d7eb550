"""Choices on little data: does alpha="cv" take models that diverge, or one far from the best, without a word?

Three cases. Bilinear models on 64 pairs from 8 or 9 recordings that move one input at a time, rolled out on unseen
recordings of the same kind and on some that move all inputs; an unstable plant; one recording of 16 pairs.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # the other rooms of scripts/

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

import pisplit as ps
from common.report import Report, parser, run
from pisplit import observables as ob
from pisplit.models import systems
from pisplit.splitting.two_stage import GRIDS
from stress import little_data

Array = NDArray[np.float64]

#: Recordings to draw from, and to test on.
POOL, TEST = 18, 9
CASES = ("single", "unstable", "short")
#: Alphas of the unstable plant.
RIDGES = np.logspace(-10, 1, 12).tolist()
#: What a fit says where its choice may be wrong.
SAYS = ("decided for", "chosen on", "no better than", "diverges on", "can be judged")


def main() -> None:
    """Run all cases, print and write the figures."""
    made = parser(__doc__ or "")
    made.add_argument("--only", nargs="+", choices=CASES, default=list(CASES), help="cases to run")
    arguments = made.parse_args()
    report = Report.of("Choices on little data", arguments)
    quick, seed = arguments.quick, arguments.seed
    recorders: dict[str, Callable[..., ps.Episodes]] = {"bellows": little_data.bellows}
    if not quick:
        recorders["arm"] = little_data.arm
    for name, record in recorders.items() if "single" in arguments.only else ():
        measure_single_inputs(report, name, record, 2 if quick else 20, seed)
    if "unstable" in arguments.only:
        measure_unstable(report, 1 if quick else 8, seed)
    if "short" in arguments.only:
        measure_short(report, 3 if quick else 10, seed)
    print(report)
    report.write(arguments.json)


def measure_single_inputs(
    report: Report, name: str, record: Callable[..., ps.Episodes], number: int, seed: int
) -> None:
    """Trials that diverge of the models chosen by folds, and by one split without a test of boundedness."""
    rng = np.random.default_rng(seed)
    pool, same, mixed = record("single", POOL, rng), record("single", TEST, rng), record("all", TEST, rng)
    more = (ob.Polynomials(2),) if name == "bellows" else ()
    terms = (ob.Constant(), ob.States(), ob.Inputs(), ob.Delays(inputs=1), *more, ob.Bilinear())
    theta = ps.Dictionary(*terms, n_states=pool.n_states, n_inputs=pool.n_inputs)
    ways: dict[str, tuple[dict[str, Any], str | None]] = {"folds": ({}, "auto"), "one split": ({"cv_folds": 1}, None)}
    lost = {(way, kind): 0 for way in ways for kind in ("same", "mixed")}
    for d1, pairs in tqdm(list(little_data.draws(pool, number, seed + 1)), desc=name, unit="draw"):
        for way, (options, excitation) in ways.items():
            model, _ = quiet(ps.BilinearEDMDc(theta, "cv", **options).fit, d1, pairs, excitation=excitation)
            for kind, test in (("same", same), ("mixed", mixed)):
                lost[way, kind] += int(ps.rollout_errors(model, test).diverged.sum())
    of = f"of {number * TEST} trials in {number} draws"
    for way, note in (("folds", ""), ("one split", ", one split and no test of boundedness")):
        target = ("<=", 0.0) if way == "folds" else None
        report.figure(f"{name}, single inputs, 64 pairs: divergent{note}", lost[way, "same"], of, target)
        report.figure(f"{name}, the same models, all inputs move: divergent{note}", lost[way, "mixed"], of)


def measure_unstable(report: Report, seeds: int, seed: int) -> None:
    """Error ten steps ahead of the chosen alpha over that of the best of twelve."""
    test = little_data.pendulum(12, seed + 999)
    every: list[float] = []
    for degree, size in ((1, 40), (3, 40), (3, 120), (3, None), (5, None)):
        more = (ob.Polynomials(degree),) if degree > 1 else ()
        theta = ps.Dictionary(ob.Constant(), ob.States(), ob.Inputs(), *more, n_states=2, n_inputs=1)
        ratios: dict[int | None, list[float]] = {10: [], None: []}
        silent = 0
        for k in range(seeds):
            d1 = little_data.pendulum(4, seed + k)
            pairs = d1.pairs() if size is None else d1.pairs().sample(size, seed + k)
            fixed = [quiet(ps.LinearEDMDc(theta, alpha).fit, d1, pairs)[0] for alpha in RIDGES]
            errors = [float(ps.horizon_errors(model, test, [10]).normalised[0]) for model in fixed]
            for horizon, found in ratios.items():
                model, said = quiet(ps.LinearEDMDc(theta, "cv", alphas=RIDGES, cv_horizon=horizon).fit, d1, pairs)
                found.append(errors[RIDGES.index(model.alpha_)] / min(errors))
                silent += horizon is None and found[-1] > 1.2 and not said
        name = f"unstable plant, degree {degree}, {size or 'all'} pairs"
        every += ratios[10]
        report.figure(f"{name}: chosen over best, cv_horizon = 10, worst of {seeds}", max(ratios[10]), "", ("<=", 1.2))
        report.figure(f"{name}: chosen over best, whole roll-outs, worst", max(ratios[None]), "")
        report.figure(f"{name}: beyond 1.2 by whole roll-outs, and silent", silent, f"of {seeds}", ("<=", 0.0))
    size = len(every)
    report.figure(
        "unstable plant, all of these: chosen over best, cv_horizon = 10, median", float(np.median(every)), ""
    )
    report.figure("unstable plant, all of these: beyond 1.2", sum(r > 1.2 for r in every), f"of {size}", ("<=", 0.0))


def measure_short(report: Report, seeds: int, seed: int) -> None:
    """One recording of 16 pairs of the slow manifold, pulled to the physics: near the best fixed alpha, or a word."""
    system, dt, grid = systems.slow_manifold(), 1e-3, list(GRIDS["ridge"])
    theta = ps.Dictionary(ob.Constant(), ob.Identity(), n_states=2, n_inputs=1)
    ratios, silent = [], 0
    for k in range(seeds):
        rng = np.random.default_rng(seed + k)

        def recorded(steps: int, rng: np.random.Generator = rng) -> ps.Episodes:
            u = np.repeat(0.1 * rng.normal(size=(steps // 3 + 1, 1)), 3, axis=0)[:steps]
            return ps.Episodes.from_system(system, [[0.3, 0.7]], [u], dt)

        d1, test = recorded(16), recorded(4000)
        points = rng.uniform([0.0, -0.5], [0.5, 0.5], (500, 2))
        d2 = ps.PhaseSamples.from_system(system, points, np.zeros((500, 1)))
        options: dict[str, Any] = {"penalty": "ridge", "toward": "physics", "rows": "inputs"}
        fixed = [quiet(ps.PIEDMDc(theta, alpha, **options).fit, d1, d2)[0] for alpha in grid]
        errors = [ps.rollout_errors(model, test, ["x2"]).mean for model in fixed]
        model, said = quiet(ps.PIEDMDc(theta, "cv", **options).fit, d1, d2)
        ratios.append(np.sqrt(errors[grid.index(model.alpha_)] / min(errors)))
        silent += ratios[-1] > 3.0 and not said
    report.figure("one recording of 16 pairs: chosen over best, median", float(np.median(ratios)), "")
    report.figure("one recording of 16 pairs: within 3 times of the best", float(np.mean(np.array(ratios) <= 3)), "")
    report.figure("one recording of 16 pairs: beyond 3 times, and silent", silent, f"of {seeds}", ("<=", 0.0))


def quiet(fit: Callable[..., Any], *arguments: Any, **options: Any) -> tuple[Any, list[str]]:
    """The fitted estimator, and what it said against its own choice."""
    with warnings.catch_warnings(record=True) as caught, np.errstate(all="ignore"):
        warnings.simplefilter("always")
        fitted = fit(*arguments, **options)
    said = [str(w.message) for w in caught]
    return fitted, [line for line in said if any(mark in line for mark in SAYS)]


if __name__ == "__main__":
    run(main)
