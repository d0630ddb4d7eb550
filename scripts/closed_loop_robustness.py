"""Closed loops on the paper's arm under delays, noise, gaps, outliers, payload and play: RMS error of the true tip."""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from tqdm import tqdm

from common.drawing import save_figure
from common.report import Report, parser, run
from pisplit import Actuator, ArmIdentifier, Episodes, PIEDMDc
from pisplit.controllers import MPC, ClosedLoop, KalmanFilter, plants, references
from pisplit.models import rod
from pisplit.models.arm import (
    ArmPhysics,
    TendonArm,
    deviations_from_equilibrium,
    equilibrium_table,
    make_episodes,
    make_phase_samples,
)

matplotlib.use("Agg")
from matplotlib import pyplot as plt

DT, HORIZON, SETTLED = 0.03, 20, 100
#: Noise of positions in m, of frames in rad, and of rates and curvatures by their units.
NOISE = {"m": 1e-3, "1/m": 0.05, "m/s": 0.02, "rad/s": 0.1}
ANGLE = float(np.deg2rad(1.0))
#: What the filter is told of the noise of frames, whose entries have no unit.
TOLD = {**NOISE, "1": ANGLE}

Wrap = Callable[[Any], Any]


@dataclass(frozen=True)
class Case:
    """A loop: what stands around the ``arm``, what is ``measured`` ("all", "shape", "tip", or "" without a filter).

    ``target`` is the largest RMS error in mm that is asked for. The delays, in steps, are those that the controller is
    told. ``again``: the arm is identified again from the loop, and the figure is that of a second loop.
    """

    name: str
    arm: TendonArm
    measured: str = "all"
    wrap: Wrap = plants.WrappedPlant
    target: float | None = None
    command_delay: float = 0.0
    measurement_delay: float = 0.0
    again: bool = False


def noisy(plant: Any, seed: int) -> plants.NoisyMeasurements:
    """The usual noise on all states."""
    return plants.NoisyMeasurements(plant, NOISE, ANGLE, seed)


def late(steps: float) -> Wrap:
    """Measurements that come ``steps`` samples late."""
    return lambda plant: plants.DelayedMeasurements(plant, steps)


def cases(arm: TendonArm, seed: int) -> list[Case]:
    """What the loops go through."""
    scene, length = arm.scene, arm.scene.rod.length
    tip, payload = list(scene.field_map(6).outputs["tip"]), rod.PointMass(s=length, mass=0.02)

    def with_term(term: Any) -> TendonArm:
        return replace(arm, scene=scene + term)

    def softer(arm: TendonArm, part: float) -> TendonArm:
        body = arm.scene.rod
        assert isinstance(body.material, rod.Elastic)
        material = replace(body.material, young=part * body.material.young, shear=part * body.material.shear)
        return replace(arm, scene=rod.Scene(replace(body, material=material), *arm.scene.terms, nodes=arm.scene.nodes))

    def outliers(plant: Any) -> Any:
        return plants.Outliers(noisy(plant, seed), 0.01, 0.5, [tip], seed)

    return [
        Case("nominal, no filter", arm, "", target=0.5),
        Case("nominal", arm, target=0.5),
        Case("one step of delay of commands, not told", arm, "", lambda p: plants.DelayedCommands(p, 1.0)),
        Case(
            "one step of delay of commands, told", arm, "", lambda p: plants.DelayedCommands(p, 1.0), command_delay=1.0
        ),
        Case("one step of delay of measurements, told", arm, "", late(1.0), measurement_delay=1.0),
        Case(
            "0.4 steps of delay of commands, told", arm, "", lambda p: plants.DelayedCommands(p, 0.4), command_delay=0.4
        ),
        Case("0.4 steps of delay of measurements, told", arm, "", late(0.4), measurement_delay=0.4),
        Case(
            "two steps of delay of commands, told", arm, "", lambda p: plants.DelayedCommands(p, 2.0), command_delay=2.0
        ),
        Case(
            "three steps of delay of commands, told",
            arm,
            "",
            lambda p: plants.DelayedCommands(p, 3.0),
            command_delay=3.0,
        ),
        Case("noise, no filter", arm, "", lambda p: noisy(p, seed)),
        Case("noise, all fields", arm, "all", lambda p: noisy(p, seed), 0.5),
        Case("noise, six markers", arm, "shape", lambda p: noisy(p, seed), 0.7),
        Case("noise, tip alone", arm, "tip", lambda p: noisy(p, seed), 1.0),
        Case("noise, 5 % of the samples missing", arm, "all", lambda p: plants.LostMeasurements(noisy(p, seed), 0.05)),
        Case("noise, 30 % of the samples missing", arm, "all", lambda p: plants.LostMeasurements(noisy(p, seed), 0.3)),
        Case("noise, 1 % outliers of 0.5 m", arm, "tip", outliers),
        Case("20 g at the tip, not told", with_term(payload), "all", target=20.0),
        Case("20 g at the tip, identified again", with_term(payload), "", target=0.1, again=True),
        Case("E x 0.9, not told", softer(arm, 0.9), "all", target=0.1),
        Case("20 g and E x 0.9, identified again", softer(with_term(payload), 0.9), "", target=0.1, again=True),
        Case("play of 0.5 mm", arm, "all", lambda p: plants.ActuatedPlant(p, Actuator(play=5e-4)), 0.1),
        Case("servo lag of 30 ms", arm, "all", lambda p: plants.ActuatedPlant(p, Actuator(lag=0.03))),
        Case("force of 0.02 N at the tip", with_term(rod.TipWrench(force=(0.0, 0.02, 0.0))), "all", target=0.1),
        Case("commands rounded to 0.1 mm", arm, "all", lambda p: plants.QuantisedCommands(p, 1e-4)),
    ]


def fitted(arm: TendonArm, folder: Path, seed: int, quick: bool) -> tuple[PIEDMDc, Episodes]:
    """The hold split on recordings of the arm, kept in ``folder``."""
    d1 = make_episodes(arm, folder / f"d1-{seed}.h5", 4 if quick else 10, seed=seed)
    deviations, rates = deviations_from_equilibrium(arm, d1)
    samples = 400 if quick else 4000
    d2 = make_phase_samples(arm, folder / f"d2-{seed}.h5", samples, rates, deviations, seed=seed)
    physics = ArmPhysics(equilibrium_table(arm, half_width=0.022))
    options = physics.options()
    model = PIEDMDc(physics.dictionary(), alpha="cv", penalty="ridge", split="hold", options=options, cv_folds=1)
    return model.fit(d1, d2), d1


def main() -> None:
    """Fit once, run every case, print and draw."""
    made = parser(__doc__.splitlines()[0], "out/robustness")
    made.add_argument("--only", default="", help="cases whose name has this in it")
    made.add_argument("--steps", type=int, default=400, help="steps of 30 ms in every loop")
    given = made.parse_args()
    if given.steps <= SETTLED:
        raise ValueError(f"--steps is {given.steps}; expected more than {SETTLED}, the steps before errors count")
    given.out.mkdir(parents=True, exist_ok=True)
    arm = TendonArm.paper()
    model, d1 = fitted(arm, given.out, given.seed, given.quick)
    report = Report.of("closed loops on the paper's arm, RMS error of the true tip on the circle", given)
    reference = references.circle(radius=0.1, period=4.0)
    steps = min(given.steps, 200) if given.quick else given.steps
    observers: dict[str, KalmanFilter | None] = {"": None}
    found: dict[str, tuple[float, float | None]] = {}
    for case in tqdm([c for c in cases(arm, given.seed) if given.only in c.name], desc="loops", unit="loop"):
        if case.measured not in observers:
            measured = None if case.measured == "all" else case.measured
            observers[case.measured] = KalmanFilter.from_data(model, d1, TOLD, measured)
        observer = observers[case.measured]
        gain = None if observer is None else 0.1
        delays = {"command_delay": case.command_delay, "measurement_delay": case.measurement_delay}
        mpc = MPC(model, HORIZON, -0.014, 0.016, 0.002, estimator_gain=gain, observer=observer, **delays)
        plant = case.wrap(plants.WrappedPlant(case.arm.scene.fast_stepper(dt=DT)))
        loop = ClosedLoop(plant, mpc)
        log = loop.run(reference, steps, u0=arm.rest_inputs, progress=False)
        if case.again:
            print(loop.reidentify(ArmIdentifier(arm)))
            log = loop.run(reference, steps, u0=arm.rest_inputs, progress=False)
        true = plant.true_states[:, list(log.tracked)]
        missed = np.where(np.isnan(log.reference), 0.0, true - log.reference)
        error = 1e3 * np.linalg.norm(missed, axis=1)
        rms = float("inf") if log.stopped else float(np.sqrt(np.mean(error[SETTLED:] ** 2)))
        found[case.name] = rms, case.target
        report.figure(case.name, rms, "mm", None if case.target is None else ("<=", case.target))
        if log.stopped:
            print(f"{case.name}: {log.message}")
        if log.limit_violations:
            raise RuntimeError(f"{case.name}: {log.limit_violations} limit violations")
    draw(found, given.out / "robustness.png")
    report.write(given.json)
    print(report)


def draw(found: dict[str, tuple[float, float | None]], path: Path) -> None:
    """RMS errors as bars, with a line where a target is."""
    figure, axes = plt.subplots(figsize=(9.0, 5.0), constrained_layout=True)
    names = list(found)[::-1]
    for row, name in enumerate(names):
        error, target = found[name]
        axes.barh(row, error, color="0.6" if "no filter" in name else "C0")
        axes.text(1.05 * error, row, f"{error:.2f} mm" if error < 10.0 else f"{error:.0f} mm", va="center", fontsize=8)
        if target is not None:
            axes.plot([target, target], [row - 0.4, row + 0.4], color="C3", lw=2.0)
    axes.set_yticks(range(len(names)), names)
    axes.set(
        xscale="log", xlim=(0.05, 300.0), xlabel="RMS distance of the true tip from the reference [mm]; red: target"
    )
    axes.set_title("Circle of 0.1 m in 4 s on the paper's arm, from 3 s on")
    axes.grid(True, axis="x", which="major", alpha=0.3)
    save_figure(figure, path)


if __name__ == "__main__":
    run(main)
