"""Identification on awkward data: every case must end in a correct answer or in one clear error.

A case is "correct" if its error against the known truth is within its bound, "refused" if it ends in a ValueError of
one line, "flagged" if it is off but says so (a divergence flag or a warning), and "wrong" otherwise. None may be wrong.
"""

from __future__ import annotations

import json
import sys
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # the other rooms of scripts/

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from common.report import Report, parser, run
from pisplit import Dictionary, Episodes, LinearEDMDc, PhaseSamples, PIEDMDc, TwinEDMDc
from pisplit import observables as ob
from pisplit.models import ControlSystem

Array = NDArray[np.float64]

DT = 0.1
FLOW = np.array([[0.90, 0.15, 0.0], [-0.15, 0.90, 0.05], [0.0, 0.0, 0.7]])
DRIVE = np.array([[0.0], [0.1], [0.3]])


@dataclass(frozen=True)
class Outcome:
    """Verdict of one case; ``error`` is relative to the truth, None if there is none to compare."""

    name: str
    verdict: str
    error: float | None
    bound: float
    message: str


@dataclass(frozen=True)
class Case:
    """``run`` returns the error and whether the result flags itself as bad."""

    name: str
    run: Callable[[], tuple[float, bool]]
    bound: float = 1e-6


def main() -> None:
    """Run all cases, print a table, write the JSON."""
    arguments = parser(str(__doc__).splitlines()[0]).parse_args()
    report = Report.of("Stress test of identification", arguments)
    outcomes = [outcome(case) for case in tqdm(list(cases(arguments.seed, arguments.quick)), unit="case")]
    width = max(len(o.name) for o in outcomes)
    for o in outcomes:
        error = "        -" if o.error is None else f"{o.error:9.1e}"
        print(f"  {o.name:<{width}}  {o.verdict:8} {error}  {o.message}")
        if o.error is not None and np.isfinite(o.error):
            report.figure(o.name, o.error, "", ("<=", o.bound) if o.verdict == "correct" else None)
    for verdict in ("correct", "refused", "flagged"):
        report.figure(f"{verdict} cases", sum(o.verdict == verdict for o in outcomes), "")
    report.figure("silently wrong cases", sum(o.verdict == "wrong" for o in outcomes), "", ("<=", 0))
    report.arguments["verdicts"] = {o.name: [o.verdict, o.message] for o in outcomes}
    print(f"{len(outcomes)} cases, {sum(o.verdict == 'wrong' for o in outcomes)} silently wrong")
    report.write(arguments.json)
    if any(o.verdict == "wrong" for o in outcomes):
        raise ValueError(f"silently wrong: {json.dumps([o.name for o in outcomes if o.verdict == 'wrong'])}")


def outcome(case: Case) -> Outcome:
    """Run one case and judge it."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            error, flag = case.run()
        except ValueError as refusal:
            text = str(refusal)
            return Outcome(case.name, "wrong" if "\n" in text else "refused", None, case.bound, text[:160])
    said = [str(w.message) for w in caught if issubclass(w.category, UserWarning)]
    if error <= case.bound:
        return Outcome(case.name, "correct", error, case.bound, said[0][:160] if said else "")
    known = "diverged" if flag else said[0] if said else ""
    return Outcome(case.name, "flagged" if known else "wrong", error, case.bound, known[:160])


def cases(seed: int, quick: bool) -> Iterator[Case]:
    """All cases, for every estimator that they make sense for."""
    rng = np.random.default_rng(seed)
    for name, fit in estimators().items():
        exponents = (-12, -6, 0, 6, 12) if not quick else (-12, 12)
        for e in exponents:
            yield Case(f"{name}, all columns x 1e{e}", partial(linear, fit, np.full(3, 10.0**e), rng))
        for scales in ((1e-12, 1.0, 1e12), (1e12, 1e-12, 1.0)):
            yield Case(
                f"{name}, columns x {scales[0]:g}, {scales[1]:g}, {scales[2]:g}",
                partial(linear, fit, np.array(scales), rng),
            )
        yield Case(f"{name}, inputs x 1e-12", partial(linear, fit, np.ones(3), rng, input_scale=1e-12))
        yield Case(f"{name}, duplicated column", partial(mapped, fit, np.vstack([np.eye(3), np.eye(3)[:1]]), rng))
        yield Case(f"{name}, columns that add up", partial(mapped, fit, np.vstack([np.eye(3), np.ones((1, 3))]), rng))
        yield Case(f"{name}, constant column", partial(mapped, fit, np.eye(3), rng, constant=5.0))
        yield Case(f"{name}, zero column", partial(mapped, fit, np.eye(3), rng, constant=0.0))
        yield Case(f"{name}, large constant offset", partial(mapped, fit, np.eye(3), rng, offset=1e6), 1e-4)
        yield Case(f"{name}, constant input", partial(mapped, fit, np.eye(3), rng, input_value=0.3))
        for pairs in (1, 2, 3, 5):
            yield Case(f"{name}, N = {pairs} of 5 columns", partial(few, fit, pairs, rng), 1e-6)
        yield Case(f"{name}, unstable system", partial(unstable, fit, rng), 1e-4)
        yield Case(f"{name}, NaN from the dictionary", partial(logarithm, fit, rng))
        yield Case(f"{name}, overflow in the dictionary", partial(power, fit, rng))
        for bad in (np.nan, np.inf, -np.inf):
            yield Case(f"{name}, a row with {bad}", partial(spoiled, fit, bad, rng))
        for rows in (0, 1):
            yield Case(f"{name}, an episode of {rows} rows", partial(short, fit, rows, rng))
    yield Case("alpha = NaN", partial(linear, edmdc(alpha=np.nan), np.ones(3), rng))
    yield Case("alpha < 0", partial(linear, edmdc(alpha=-1.0), np.ones(3), rng))
    yield Case("alpha by roll-outs of one pair", partial(few, edmdc(alpha="cv"), 1, rng))
    yield Case("no episodes", lambda: (float(len(Episodes([], [], DT))), False))
    yield Case("an empty input", lambda: (float(len(Episodes([np.zeros((3, 2))], [np.zeros((0, 1))], DT))), False))
    for penalty in ("ridge", "lasso"):
        for rate in (1e2, 1e4, 1e6):
            yield Case(
                f"known part of rate {rate:g} (K_f near singular), {penalty}",
                partial(known_part, -rate, penalty, rng),
                1e-4,
            )
        for rate in (1.0, 30.0):
            yield Case(
                f"unstable known part of rate {rate:g}, {penalty}",
                partial(known_part, rate, penalty, rng),
                1e-4,
            )
    for rate in (-1e6, -1.0, 1.0, 30.0):
        yield Case(f"toward physics of rate {rate:g}", partial(known_part, rate, "ridge", rng, "physics"), 1e-4)
    yield Case(
        "toward physics, phase samples of one point", partial(known_part, -1.0, "ridge", rng, "physics", 1), 1e-4
    )
    yield Case("phase samples of one point", partial(known_part, -1.0, "ridge", rng, samples=1), 1e-4)
    yield Case("phase samples with NaN", partial(known_part, -1.0, "ridge", rng, spoil=np.nan), 1e-4)


Fit = Callable[[Dictionary, Episodes], Any]


def edmdc(**options: Any) -> Fit:
    """EDMDc with these options as a function (dictionary, episodes) -> fitted estimator."""
    return lambda theta, d1: LinearEDMDc(theta, **options).fit(d1)


def estimators() -> dict[str, Fit]:
    """Every way to regress: least squares, ridge, LASSO, a bound on the radius, and a twin that repeats the data."""
    return {
        "least squares": edmdc(),
        "ridge": edmdc(alpha=1e-14),
        "LASSO": edmdc(alpha=1e-10, penalty="lasso"),
        "bounded": edmdc(max_radius=1.0),
        "twin": lambda theta, d1: TwinEDMDc(theta, alpha=1.0, twin_alpha=1e-15).fit(d1, d1),
    }


def affine(n: int, m: int = 1) -> Dictionary:
    """[1, x, u]."""
    return Dictionary(ob.Constant(), ob.Identity(), n_states=n, n_inputs=m)


def record(rng: np.random.Generator, count: int = 4, steps: int = 40, value: float | None = None) -> tuple[list, list]:
    """Episodes of the linear system x+ = FLOW x + DRIVE u."""
    xs, us = [], []
    for _ in range(count):
        u = rng.normal(size=(steps, 1)) if value is None else np.full((steps, 1), value)
        x = np.empty((steps + 1, 3))
        x[0] = rng.normal(size=3)
        for k in range(steps):
            x[k + 1] = FLOW @ x[k] + DRIVE @ u[k]
        xs.append(x)
        us.append(u)
    return xs, us


def judge(model: Any, xs: list, us: list) -> tuple[float, bool]:
    """Largest error of roll-outs of test episodes relative to the range of each state."""
    worst, diverged = 0.0, False
    for x, u in zip(xs, us, strict=True):
        lifted = model.lifted
        result = lifted.predict(x[: lifted.n_delays + 1], u[: lifted.n_delays], u[lifted.n_delays :])
        size = np.ptp(x, axis=0)
        size[size == 0.0] = np.abs(x).max() or 1.0
        worst = max(worst, float((np.abs(result.x - x[lifted.n_delays :]) / size).max()))
        diverged |= bool(result.diverged)
    return worst, diverged


def linear(fit: Fit, scale: Array, rng: np.random.Generator, input_scale: float = 1.0) -> tuple[float, bool]:
    """States in units that differ by many orders."""
    xs, us = record(rng)
    xs, us = [x * scale for x in xs], [u * input_scale for u in us]
    return judge(fit(affine(3), Episodes(xs[1:], us[1:], DT)), xs[:1], us[:1])


def mapped(
    fit: Fit,
    mixing: Array,
    rng: np.random.Generator,
    constant: float | None = None,
    offset: float = 0.0,
    input_value: float | None = None,
) -> tuple[float, bool]:
    """Redundant, constant or shifted states."""
    xs, us = record(rng, value=input_value)
    xs = [x @ mixing.T + offset for x in xs]
    if constant is not None:
        xs = [np.column_stack([x, np.full(len(x), constant)]) for x in xs]
    return judge(fit(affine(xs[0].shape[1]), Episodes(xs[1:], us[1:], DT)), xs[:1], us[:1])


def few(fit: Fit, pairs: int, rng: np.random.Generator) -> tuple[float, bool]:
    """Fewer pairs than columns: the fit must reproduce its own pairs."""
    xs, us = record(rng, count=1, steps=pairs)
    return judge(fit(affine(3), Episodes(xs, us, DT)), xs, us)


def unstable(fit: Fit, rng: np.random.Generator) -> tuple[float, bool]:
    """x+ = 1.2 x + u over 60 steps grows by 5e4; the model must grow alike or say that it diverged."""
    u = rng.normal(size=(4, 60, 1))
    x = np.zeros((4, 61, 1))
    for k in range(60):
        x[:, k + 1] = 1.2 * x[:, k] + u[:, k]
    return judge(fit(affine(1), Episodes(list(x[1:]), list(u[1:]), DT)), list(x[:1]), list(u[:1]))


def logarithm(fit: Fit, rng: np.random.Generator) -> tuple[float, bool]:
    """A column log(x1) of states that change sign."""
    xs, us = record(rng)
    theta = Dictionary(ob.Identity(), ob.Expression(lambda x, u: ca.log(x[0]), name="log"), n_states=3, n_inputs=1)
    return judge(fit(theta, Episodes(xs, us, DT)), xs, us)


def power(fit: Fit, rng: np.random.Generator) -> tuple[float, bool]:
    """A column exp(1e4 x1) that overflows."""
    xs, us = record(rng)
    theta = Dictionary(ob.Identity(), ob.Expression(lambda x, u: ca.exp(1e4 * x[0]), name="e"), n_states=3, n_inputs=1)
    return judge(fit(theta, Episodes(xs, us, DT)), xs, us)


def spoiled(fit: Fit, bad: float, rng: np.random.Generator) -> tuple[float, bool]:
    """One row of one episode is NaN or infinite."""
    xs, us = record(rng)
    xs[1][7] = bad
    return judge(fit(affine(3), Episodes(xs, us, DT)), xs[:1], us[:1])


def short(fit: Fit, rows: int, rng: np.random.Generator) -> tuple[float, bool]:
    """One of the episodes is empty or has a single row."""
    xs, us = record(rng)
    xs[2], us[2] = xs[2][:rows], us[2][:0]
    return judge(fit(affine(3), Episodes(xs, us, DT)), xs[:1], us[:1])


def known_part(
    rate: float,
    penalty: str,
    rng: np.random.Generator,
    toward: str = "identity",
    samples: int = 200,
    spoil: float | None = None,
) -> tuple[float, bool]:
    """f = (-x1, rate x2) is known, h = (0, u) is not; the exact flow of the sum is the truth."""
    x, u = ca.SX.sym("x", 2), ca.SX.sym("u")
    system = ControlSystem(x, u, known=ca.vertcat(-x[0], rate * x[1]), unknown=ca.vertcat(u, abs(rate) * u))
    points = rng.normal(size=(samples, 2))
    d2 = PhaseSamples.from_system(system, points, np.zeros((samples, 1)))
    if spoil is not None:
        d2 = PhaseSamples(points, d2.u, np.where(np.arange(samples)[:, None] == 3, spoil, d2.xdot))
    growth = np.exp(np.array([-1.0, rate]) * DT)
    gain = np.array([1.0 - growth[0], (growth[1] - 1.0) * np.sign(rate)])
    xs, us = [], []
    for _ in range(4):
        v = rng.normal(size=(30, 1))
        states = np.empty((31, 2))
        states[0] = rng.normal(size=2) * np.minimum(1.0, growth[1] ** -30.0)
        for k in range(30):
            states[k + 1] = growth * states[k] + gain * v[k]
        xs.append(states)
        us.append(v)
    alpha = 1e-12 if penalty == "ridge" else 1e-8
    rows = "inputs" if toward == "physics" else None
    split = PIEDMDc(affine(2), alpha=alpha, penalty=penalty, toward=toward, rows=rows)
    return judge(split.fit(Episodes(xs[1:], us[1:], DT), d2), xs[:1], us[:1])


if __name__ == "__main__":
    run(main)
