"""Loops on rods with right and wrong models: how often innovations suspect a right one, and how soon they name another.

Two arms, the paper's and one of nitinol from a drawing; models with and without delays of inputs; circles; exact
and noisy measurements (a filter), and commands that come late and are told to. Wrong: flipped signs, inputs in each
other's place, the model of the other arm.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import sys
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # the other rooms of scripts/

from common.report import Report, parser, run
from pisplit import Dictionary, LinearEDMDc
from pisplit import observables as ob
from pisplit.checks import Array
from pisplit.controllers import MPC, ClosedLoop, InnovationWatch, KalmanFilter, LoopLog, plants, references
from pisplit.controllers.plants.wrapped import WrappedPlant
from pisplit.models.arm import TendonArm
from pisplit.models.arm.simulated import seen_with_noise

DT, STEPS, RECORDED = 0.03, 80, 8
NOISE, TURNED = {"m": 1e-3, "m/s": 5e-3, "1/m": 5e-3}, 0.01


class Mixed(WrappedPlant):
    """A plant whose inputs act as ``mixing`` (m, m) of those commanded."""

    def __init__(self, plant: Any, mixing: Array) -> None:
        super().__init__(plant)
        self._mixing = mixing

    def step(self, u: Any) -> Any:
        return super().step(self._mixing @ np.asarray(u))


class Case:
    """An arm, its recordings, exact or ``noisy``, and a model with so many ``delays`` of inputs."""

    def __init__(self, arm: TendonArm, size: float, noisy: bool, delays: int, seed: int) -> None:
        self.arm, self.size, self.noisy = arm, size, noisy
        data = arm.record(RECORDED, seed=seed, dt=DT, progress=False)
        if noisy:
            rng = np.random.default_rng(seed)
            data = replace(data, xs=[seen_with_noise(x, np.array(data.units), NOISE, TURNED, rng) for x in data.xs])
        parts: list[Any] = [ob.Constant(), ob.Identity(), *([ob.Delays(inputs=delays)] if delays else [])]
        theta = Dictionary(*parts, n_states=data.n_states, n_inputs=data.n_inputs)
        self.learned, self.held = data[: RECORDED // 2], data[RECORDED // 2 :]
        self.model = LinearEDMDc(theta, alpha=1e-2 if noisy else 1e-4).fit(self.learned).lifted
        self.observer = KalmanFilter.from_data(self.model, self.learned, NOISE) if noisy else None

    def loop(self, on: TendonArm, mixing: Array, late: float, rng: np.random.Generator) -> LoopLog:
        """A watched loop of the model on an arm whose inputs act through ``mixing`` (m, m), ``late`` steps late."""
        plant: Any = Mixed(on.scene.fast_stepper(dt=DT), mixing)
        plant = plants.DelayedCommands(plant, late) if late else plant
        if self.noisy:
            plant = plants.NoisyMeasurements(plant, NOISE, angle=TURNED, seed=int(rng.integers(1000)))
        low, high = self.learned.stacked_inputs().min(axis=0), self.learned.stacked_inputs().max(axis=0)
        change = np.max([np.abs(np.diff(u, axis=0)).max(axis=0) for u in self.learned.us], axis=0)
        gain = 0.1 if self.noisy else None
        mpc = MPC(
            self.model,
            20,
            low,
            high,
            change,
            rate_weight=1.0,
            estimator_gain=gain,
            observer=self.observer,
            command_delay=late,
        )
        radius = self.size * rng.uniform(0.3, 1.0)
        circle = references.circle(radius=radius, period=float(rng.uniform(3.0, 6.0)))
        watch = InnovationWatch(self.model, self.held)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return ClosedLoop(plant, mpc).run(circle, STEPS, u0=on.rest_inputs, progress=False, callbacks=[watch])


def said(log: LoopLog) -> float:
    """Seconds from the first motion of the inputs until the watch said something; infinite where it did not."""
    texts = ("largest of the recordings", "the other way round", "in each other's place")
    notes = [note for note in log.notes if any(text in note for text in texts)]
    moved = np.flatnonzero(np.abs(log.u - log.u0).max(axis=1) > 0.02 * np.ptp(log.u, axis=0).max())
    return float(notes[0].split("t = ")[1].split(" s")[0]) - DT * int(moved[0]) if notes else np.inf


def main() -> None:
    """Run them all and count."""
    made = parser((__doc__ or "").splitlines()[0])
    made.add_argument("--loops", type=int, default=8, help="on the right model of each of eight cases")
    given = made.parse_args()
    paper = TendonArm.paper()
    drawn = TendonArm(length=0.4, radius=8e-4, material="nitinol", offset=0.012, tip_mass=0.012)
    arms = {"paper's": (paper, 0.08), "drawn": (drawn, 0.04)}
    rng = np.random.default_rng(given.seed)
    kinds = [(name, noisy, delays) for name in arms for noisy in (False, True) for delays in (0, 2)]
    right: list[float] = []
    lost = 0
    wrong: dict[str, list[float]] = {"flipped signs": [], "inputs swapped": [], "the other arm's model": []}
    for name, noisy, delays in tqdm(kinds[:2] if given.quick else kinds, desc="cases", unit="case"):
        case = Case(*arms[name], noisy, delays, given.seed)
        m = case.model.n_inputs
        for k in range(2 if given.quick else given.loops):
            log = case.loop(case.arm, np.eye(m), (0.0, 1.0, 0.5)[k % 3], rng)
            if log.stopped or any("the loop swings" in note for note in log.notes):
                lost += 1  # their models do not carry them, which is to be said
            else:
                right.append(said(log))
        other = drawn if case.arm is paper else paper
        for _ in range(2):
            wrong["flipped signs"].append(said(case.loop(case.arm, -np.eye(m), 0.0, rng)))
            wrong["inputs swapped"].append(said(case.loop(case.arm, np.eye(m)[[1, 0, 2]], 0.0, rng)))
            wrong["the other arm's model"].append(said(case.loop(other, np.eye(m), 0.0, rng)))
    report = Report.of("innovations on rods", given)
    report.figure("loops on right models that swing or are lost", lost, "")
    report.figure("other loops on right models", len(right), "")
    report.figure("of these suspected", sum(np.isfinite(t) for t in right), "", ("<=", 0))
    for name, times in wrong.items():
        report.figure(f"{name}: loops", len(times), "")
        report.figure(f"{name}: longest time until it is said", max(times), "s", ("<=", 1.0))
    report.write(given.json)
    print(report)


if __name__ == "__main__":
    run(main)
