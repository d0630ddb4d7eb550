"""The main job: identify the paper's tendon arm from a few recordings and run MPC on it, closed on the simulated arm.

Makes (or loads) the data, fits L-EDMDc and PI-EDMDc (by ridge, and by LASSO) on the same episodes, then
tracks a circle with the tip and steps to a set-point with each, beside feed-forward from exact statics. Prints a table,
draws tracking, shapes, an animation.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Any

import numpy as np
from generate_data import load_or_make
from tqdm import tqdm

from common.loops import HORIZON, TRIAL_JUMPS, Bench, Contest
from common.pictures import animate, draw_aim, draw_shapes, draw_tracking
from common.report import Report, parser, run
from pisplit import Dictionary, Episodes, LinearEDMDc, PhaseSamples, PIEDMDc
from pisplit import observables as ob
from pisplit.controllers import LoopLog, references
from pisplit.models.arm.blocks import unordered
from pisplit.models.arm.physics import ArmPhysics
from pisplit.models.arm.static_table import equilibrium_table
from pisplit.models.arm.tendon_arm import TendonArm

STATIONS, DT = 6, 0.03
TEST_EPISODES = 4
#: Models for control: the largest penalty that costs at most 30 % of held-out roll-out error.
CV_TOLERANCE = 0.3
#: Penalties of the LASSO, in parts of the one that leaves the physical map alone; smaller ones leave no entry at it.
LASSO_ALPHAS = tuple(np.logspace(-6, 0, 7).tolist())
#: Sparser models than the one with the best roll-outs track better: the sparsest within 50 % of its error.
LASSO_TOLERANCE = 0.5


def arguments() -> argparse.Namespace:
    """Command line."""
    made = parser((__doc__ or "").splitlines()[0], out="out/demo")
    made.add_argument("--episodes", type=int, default=10, help="training episodes of 200 steps")
    made.add_argument("--samples", type=int, default=4000, help="phase-space samples")
    made.add_argument("--steps", type=int, default=400, help="steps of each closed loop")
    made.add_argument("--radius", type=float, default=0.1, help="radius of the circle in m")
    made.add_argument("--period", type=float, default=4.0, help="period of the circle in s")
    made.add_argument("--data", type=Path, default=Path("out/data"), help="folder of the data")
    given = made.parse_args()
    if given.quick:
        given.steps = min(given.steps, 170)
    if given.steps < 150 or given.episodes < 2:
        made.error(f"--steps {given.steps} --episodes {given.episodes}; expected at least 150 steps and 2 episodes")
    references.circle(given.radius, given.period)  # raises on bad values before the data are made
    return given


def fit_models(arm: TendonArm, physics: ArmPhysics, d1: Episodes, d2: PhaseSamples) -> dict[str, LinearEDMDc | PIEDMDc]:
    """L-EDMDc on the 144 fields (no delays: with four it tracks far worse) and PI-EDMDc with the hold split.

    PI-EDMDc departs from its physical map by ridge, and once more sparsely, by LASSO.
    """
    plain = Dictionary(
        ob.Constant(), ob.Identity(), ob.Delays(inputs=1), n_states=d1.n_states, n_inputs=arm.scene.n_inputs
    )
    # Ten whole recordings are plenty: they are held out once.
    shared: dict[str, Any] = {"alpha": "cv", "cv_states": "shape", "cv_tolerance": CV_TOLERANCE, "cv_folds": 1}
    hold: dict[str, Any] = {"split": "hold", "options": physics.options(), **shared}
    sparse = {"penalty": "lasso", "alphas": LASSO_ALPHAS, "cv_tolerance": LASSO_TOLERANCE}
    return {
        "L-EDMDc": LinearEDMDc(plain, penalty="ridge", **shared).fit(d1),
        "PI-EDMDc": PIEDMDc(physics.dictionary(), penalty="ridge", **hold).fit(d1, d2),
        "PI-EDMDc LASSO": PIEDMDc(physics.dictionary(), **{**hold, **sparse}).fit(d1, d2),
    }


def main() -> None:
    """Data, models, closed loops, table, pictures."""
    given = arguments()
    begin = time.perf_counter()
    report = Report.of("closed-loop MPC on the simulated tendon arm", given)
    arm = TendonArm.paper()
    length = arm.scene.rod.length
    print(arm.scene, end="\n\n")
    bench = Bench(arm, DT, STATIONS)
    target = np.array([bench.tip[0] + 0.08, bench.tip[1] + 0.06, np.nan])
    given.out.mkdir(parents=True, exist_ok=True)
    draw_aim(arm, bench.tip, given.radius, target, given.out / "arm.png")
    print(f"{given.out / 'arm.png'}: the arm, the circle and the set-point ({time.perf_counter() - begin:.0f} s)\n")
    every, d2 = load_or_make(arm, given.data, given.episodes + TEST_EPISODES, given.samples, given.seed, dt=DT)
    d1, test = every[: given.episodes], every[given.episodes :]

    table = equilibrium_table(arm, half_width=0.022, stations=STATIONS)
    models = fit_models(arm, ArmPhysics(table, STATIONS), d1, d2)
    for name, model in models.items():
        errors = model.score(test, "shape")
        entries = 100 * float(np.mean(model.K_ != 0.0))
        print(f"{name}: M = {model.lifted.n_lifted}, {entries:.0f} % of K non-zero, alpha = {model.alpha_:.1g}")
        print(f"  6 s open-loop roll-outs of {len(test)} test episodes: {errors}")
        report.figure(f"{name} open-loop squared shape error, median", errors.median, "m^2")
        report.figure(f"{name} divergent roll-outs", 100 * errors.diverged_fraction, "%")

    approach = given.period / 2
    tasks = {
        "circle": references.circle(given.radius, given.period, center=bench.tip[:2], approach=approach),
        "set-point": references.setpoint([target], [0.3]),
    }
    turns = 1 if given.quick else len(TRIAL_JUMPS)
    lifted = tuple(model.lifted for model in models.values())
    contest = Contest(Bench(arm, DT, STATIONS), lifted, table, tasks, given.steps, turns)
    found: dict[int, dict[str, LoopLog]] = {}
    for k, logs in tqdm(unordered(contest, range(len(models) + 1)), "closed loops", len(models) + 1, unit="controller"):
        found[k] = logs
    order = {"feed-forward": len(models), **{name: k for k, name in enumerate(models)}}
    runs = {task: {name: found[k][task] for name, k in order.items()} for task in tasks}

    print_table(report, runs, approach, length)
    draw_tracking(runs, given.out / "tracking.png")
    best = runs["circle"]["PI-EDMDc"]
    draw_shapes(best, STATIONS, given.out / "shapes.png", "PI-EDMDc on the circle")
    animate(best, STATIONS, given.out / "arm.gif", "PI-EDMDc", frames=40 if given.quick else 80)
    best.save(given.out / "run.html")
    report.figure("run time", time.perf_counter() - begin, "s")
    report.write(given.json)
    print(f"\n{report}\n\npictures in {given.out}: arm.png, tracking.png, shapes.png, arm.gif, run.html")


def print_table(report: Report, runs: dict[str, dict[str, LoopLog]], approach: float, length: float) -> None:
    """One row a controller and task; figures against their targets into the report."""
    head = f"{'task':<10} {'controller':<15} {'RMS mm':>9} {'% of L':>8} {'steady mm':>10} {'MPC p99 ms':>11}"
    print(f"\n{head} {'max ms':>7} {'missed':>7} {'violations':>11} {'fallbacks':>10}")
    for task, logs in runs.items():
        for name, log in logs.items():
            if log.stopped:
                print(f"{task:<10} {name:<15} {log.message}")
                report.figure(f"{task} {name} completed steps", len(log.u), "")
                continue
            # The preview moves the arm before a jump and knows when a run ends: leave out the last H + 4 steps.
            window = (log.t > approach) & (np.arange(len(log.t)) < len(log.t) - HORIZON - 4)
            rms = float(np.sqrt(np.mean(log.error[window] ** 2)))
            steady = float(np.mean(log.error[window][-33:]))
            p99, worst = 1e3 * np.percentile(log.cpu_time, 99), 1e3 * log.cpu_time.max()
            shown = f"{1e3 * steady:10.4f}" if task == "set-point" else f"{'':>10}"
            print(
                f"{task:<10} {name:<15} {1e3 * rms:9.3f} {100 * rms / length:8.4f} {shown} {p99:11.2f} {worst:7.2f} "
                f"{log.deadline_misses:7d} {log.limit_violations:11d} {log.fallbacks:10d}"
            )
            ours = name != "feed-forward"
            if task == "circle":
                report.figure(f"circle {name} RMS", 100 * rms / length, "% of L", ("<=", 0.15) if ours else None)
                if ours:
                    gain = float(np.sqrt(np.mean(logs["feed-forward"].error[window] ** 2))) / rms
                    report.figure(f"circle {name} gain over feed-forward", gain, "times", (">=", 3.0))
                    report.figure(f"circle {name} MPC p99", p99, "ms", ("<=", 2.5))
                    report.figure(f"circle {name} MPC median", 1e3 * np.median(log.cpu_time), "ms", ("<=", 1.0))
                    report.figure(
                        f"circle {name} plant step median", 1e3 * np.median(log.plant_time), "ms", ("<=", 5.0)
                    )
            elif task == "set-point":
                bound = ("<=", 0.01) if ours else None
                report.figure(f"set-point {name} steady error", 100 * steady / length, "% of L", bound)
            report.figure(f"{task} {name} limit violations", log.limit_violations, "", ("<=", 0.0))


if __name__ == "__main__":
    run(main)
