"""An arm drawn in words, four markers in a camera's files, commands in a servo's: models without physics, and MPC.

The arm is 0.4 m of nitinol with a gripper of 12 g. Cameras see four markers at 100 Hz with a noise of 0.3 mm; the
servos log a command every 0.05 s, rounded, on a clock that may be late or early. What was logged is loaded in one
call, and the tip follows a figure-eight of 40 mm in 8 s, seen by the same cameras.
"""

from __future__ import annotations

import itertools
import os

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from pisplit import Dictionary, Episodes
from pisplit import observables as ob
from pisplit.controllers import ClosedLoop, LoopLog, plants, references, tune
from pisplit.models.arm import TendonArm, random_displacements

matplotlib.use("Agg")

Array = NDArray[np.float64]

#: Time of a command [s], frames of the cameras in it, stations with a marker of six, noise of a coordinate [m].
DT, FRAMES, STATIONS, SEEN, NOISE = 0.05, 5, 6, (1, 3, 5, 6), 3e-4
MARKERS = [f"p_{axis}[{k}]" for k in SEEN for axis in "xyz"]
#: Of the commands in the log [mm]; by how much their times are wrong [s].
ROUNDINGS, SHIFTS = (1e-5, 1e-3, 1e-1), (0.05, -0.05)
#: Width of the figure-eight [m], its time [s]; steps of approach, settled steps that count.
WIDTH, PERIOD, APPROACH, ROUNDS = 0.04, 8.0, 40, 2
DELAYS = 4
RIDGES = tuple(np.logspace(-9, 0, 10).tolist())


def drawn() -> TendonArm:
    """The arm."""
    return TendonArm(length=0.4, radius=0.7e-3, material="nitinol", offset=0.01, tip_mass=0.012, nodes=4)


@dataclass(frozen=True)
class Motion:
    """A recording as it was: markers (N, 12) in m at times of frames, commands (K, 3) in m."""

    markers: Array
    commands: Array


def recorded(arm: TendonArm, episodes: int, seconds: float, seed: int) -> list[Motion]:
    """Random smooth displacements; servos move on evenly from a command to the next."""
    stepper, made, steps = arm.scene.fast_stepper(DT / FRAMES, stations=STATIONS), [], round(seconds / DT)
    columns = [stepper.state_names.index(name) for name in MARKERS]
    for number in tqdm(range(episodes), desc="recordings", unit="recording"):
        rng = np.random.default_rng((seed, number))
        commands = random_displacements(arm, steps, rng)
        path, part = np.vstack([arm.rest_inputs, commands]), np.linspace(0.0, 1.0, FRAMES + 1)[1:, None]
        fine = np.concatenate([a + part * (b - a) for a, b in itertools.pairwise(path)])
        start = arm.scene.statics().solve(arm.rest_inputs).state
        states = stepper.run(fine, start).fields(STATIONS).reshape(len(fine) + 1, -1)[:, columns]
        made.append(Motion(states + NOISE * rng.standard_normal(states.shape), commands))
    return made


def logged(folder: Path, motions: list[Motion], rounding: float, late: float) -> Episodes:
    """Files of cameras and servos in a folder, and what one call loads of them; its warnings are printed."""
    folder.mkdir(parents=True, exist_ok=True)
    inputs = [f"tendons[{k}]" for k in range(motions[0].commands.shape[1])]
    for number, motion in enumerate(motions):
        t = 10.0 + DT / FRAMES * np.arange(len(motion.markers))
        rows = np.column_stack([t, 1e3 * motion.markers])
        head = ",".join(["Time (s)", *(f"{name} (mm)" for name in MARKERS)])
        np.savetxt(folder / f"camera{number}.csv", rows, "%.5f", ",", header=head, comments="")
        sent = 10.0 + DT * np.arange(len(motion.commands)) + late
        rounded = rounding * np.round(1e3 * motion.commands / rounding)
        head = ",".join(["Time (s)", *(f"{name} (mm)" for name in inputs)])
        np.savetxt(
            folder / f"servo{number}.csv", np.column_stack([sent, rounded]), "%.8f", ",", header=head, comments=""
        )
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        found = Episodes.from_csv(
            str(folder / "camera*.csv"), "Time", MARKERS, inputs, commands=str(folder / "servo*.csv"), dt=DT
        )
    for text in dict.fromkeys(str(w.message) for w in said):
        print(f"  {text}")
    return found


def fitted(kind: Any, d1: Episodes) -> Any:
    """The model, its penalty chosen on recordings of its own."""
    theta = Dictionary(
        ob.Constant(), ob.Identity(), ob.Delays(DELAYS, DELAYS), n_states=d1.n_states, n_inputs=d1.n_inputs
    )
    return kind(theta, "cv", alphas=RIDGES, cv_tolerance=0.1).fit(d1)


def eight(steps: int) -> references.Reference:
    """The figure-eight about the tip at rest, reached in ``APPROACH`` steps."""
    phase = 2.0 * np.pi * DT * np.arange(round(PERIOD / DT)) / PERIOD
    points = 0.5 * WIDTH * np.column_stack([np.sin(phase), np.sin(2.0 * phase)])
    return references.along(points, PERIOD, approach=APPROACH * DT)


def closed(arm: TendonArm, model: Any, held: Episodes, seed: int, steps: int) -> tuple[LoopLog, float, Any]:
    """The log of the loop, the RMS error of the true tip in mm once it is there, and the controller as tuned."""
    stepper = arm.scene.fast_stepper(DT, stations=STATIONS)
    plant = plants.Markers(stepper, SEEN, NOISE, seed=seed)
    rest, box = arm.rest_inputs, 2.0 * arm.amplitude
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        tuned = tune(
            model, held, rest - box, rest + box, 0.2 * arm.amplitude, track=MARKERS[-3:], axes=(0, 1), progress=False
        )
        log = ClosedLoop(plant, tuned.mpc).run(eight(steps), steps, u0=rest, progress=False)
    columns = [stepper.state_names.index(name) for name in MARKERS[-3:-1]]
    true = plant.true_states[: len(log.reference), columns]
    missed = np.linalg.norm(true - log.reference[: len(true), :2], axis=1)[APPROACH + 20 :]
    return log, 1e3 * float(np.sqrt(np.mean(missed**2))), tuned
