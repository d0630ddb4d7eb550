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

from common.drawing import save_figure
from common.report import Report, parser, run
from pisplit import BilinearEDMDc, Dictionary, Episodes, LinearEDMDc, identify
from pisplit import observables as ob
from pisplit.controllers import ClosedLoop, KalmanFilter, LoopLog, plants, references, tune
from pisplit.data import unrounded
from pisplit.models.arm import TendonArm, random_displacements

matplotlib.use("Agg")
from matplotlib import pyplot as plt

Array = NDArray[np.float64]

#: Time of a command [s], frames of the cameras in it, stations with a marker of six, noise of a coordinate [m].
DT, FRAMES, STATIONS, SEEN, NOISE = 0.05, 5, 6, (1, 3, 5, 6), 3e-4
MARKERS = [f"p_{axis}[{k}]" for k in SEEN for axis in "xyz"]
#: Of the commands in the log [mm]; by how much their times are wrong [s].
ROUNDINGS, SHIFTS = (1e-5, 1e-3, 1e-1), (0.05, -0.05)
#: Width of the figure-eight [m], its time [s]; steps of approach, times round.
WIDTH, PERIOD, APPROACH, ROUNDS = 0.04, 8.0, 40, 2
DELAYS = 4
#: Rounding [mm] and lateness [s] of a log, what is done with it (moved by what was told of it before, or
#: its commands unrounded), RMS to reach [mm].
Case = tuple[float, float, "str | None", "float | None"]
MODELS = {"L-EDMDc": LinearEDMDc, "B-EDMDc": BilinearEDMDc}
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


def logged(
    folder: Path,
    motions: list[Motion],
    rounding: float,
    late: float,
    shift: float | str | None = None,
    units: bool = True,
) -> Episodes:
    """Files of cameras and servos in a folder, and what one call loads of them; its warnings are printed.

    ``shift`` [s] is added to the times of commands; None leaves it to what the data tell. Without ``units`` columns
    name none.
    """
    folder.mkdir(parents=True, exist_ok=True)
    inputs, unit = [f"tendons[{k}]" for k in range(motions[0].commands.shape[1])], " (mm)" if units else ""
    size = 1.0 if units else 1e-3  # of the files' numbers in mm
    for number, motion in enumerate(motions):
        t = 10.0 + DT / FRAMES * np.arange(len(motion.markers))
        rows = np.column_stack([t, 1e3 * size * motion.markers])
        head = ",".join(["Time (s)", *(f"{name}{unit}" for name in MARKERS)])
        np.savetxt(folder / f"camera{number}.csv", rows, "%.8f", ",", header=head, comments="")
        sent = 10.0 + DT * np.arange(len(motion.commands)) + late
        rounded = size * rounding * np.round(1e3 * motion.commands / rounding)
        head = ",".join(["Time (s)", *(f"{name}{unit}" for name in inputs)])
        np.savetxt(
            folder / f"servo{number}.csv", np.column_stack([sent, rounded]), "%.9f", ",", header=head, comments=""
        )
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        found = Episodes.from_csv(
            str(folder / "camera*.csv"),
            "Time",
            MARKERS,
            inputs,
            commands=str(folder / "servo*.csv"),
            dt=DT,
            command_shift=shift,
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


def eight() -> references.Reference:
    """The figure-eight about the tip at rest, reached in ``APPROACH`` steps."""
    phase = 2.0 * np.pi * DT * np.arange(round(PERIOD / DT)) / PERIOD
    points = 0.5 * WIDTH * np.column_stack([np.sin(phase), np.sin(2.0 * phase)])
    return references.along(points, PERIOD, approach=APPROACH * DT)


def by_front(arm: TendonArm, d1: Episodes, seed: int, steps: int) -> tuple[Array, Array]:
    """As ``closed``, by ``identify`` and what it makes of the data alone."""
    stepper = arm.scene.fast_stepper(DT, stations=STATIONS)
    plant = plants.Markers(stepper, SEEN, NOISE, seed=seed)
    rest, box = arm.rest_inputs, 2.0 * arm.amplitude
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = identify(d1, progress=False)
        control = found.mpc(rest + box, 0.2 * arm.amplitude, rest - box, track=MARKERS[-3:], axes=(0, 1))
        log = control.run(plant, eight(), steps, u0=rest, progress=False)
    print(f"  {found.report().chosen}; {'; '.join(control.notes)}")
    return beside(plant, stepper, log)


def beside(plant: plants.Markers, stepper: Any, log: LoopLog) -> tuple[Array, Array]:
    """True tip (T, 2) in m and the reference (T, 2), from the approach on."""
    columns = [stepper.state_names.index(name) for name in MARKERS[-3:-1]]
    true = plant.true_states[: len(log.reference), columns]
    return true[APPROACH:], log.reference[APPROACH : len(true), :2]


def noise_of(d1: Episodes) -> float:
    """Noise of a coordinate in m, as the look at the data finds it."""
    return float(np.median([c.noise for c in d1.report().columns if c.kind == "state" and c.noise]))


def closed(
    arm: TendonArm, model: Any, train: Episodes, held: Episodes, seed: int, steps: int, answers_late: bool = False
) -> tuple[Array, Array]:
    """True tip (T, 2) in m in a loop along the figure-eight, and the reference (T, 2), from the approach on.

    The robot ``answers_late`` where a command moves it a step after it was sent.
    """
    stepper = arm.scene.fast_stepper(DT, stations=STATIONS)
    robot = plants.DelayedCommands(stepper, 1) if answers_late else stepper
    plant = plants.Markers(robot, SEEN, NOISE, seed=seed)
    rest, box = arm.rest_inputs, 2.0 * arm.amplitude
    limits = (rest - box, rest + box, 0.2 * arm.amplitude)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        observer = KalmanFilter.from_data(model, train, noise_of(train))
        settings: dict[str, Any] = {"track": MARKERS[-3:], "axes": (0, 1), "observer": observer}
        tuned = tune(model, held, *limits, progress=False, **settings)
        log = ClosedLoop(plant, tuned.mpc).run(eight(), steps, u0=rest, progress=False)
    return beside(plant, stepper, log)


def draw(found: dict[str, tuple[Array, Array]], path: Path) -> None:
    """Paths of the true tip and its errors, one colour a case."""
    figure, axes = plt.subplots(1, 2, figsize=(13.0, 5.2), constrained_layout=True)
    for k, (name, (true, wanted)) in enumerate(found.items()):
        colour = plt.get_cmap("tab10")(k % 10)
        axes[0].plot(*(1e3 * true.T), color=colour, lw=1.2)
        missed = 1e3 * np.linalg.norm(true - wanted, axis=1)
        axes[1].semilogy(DT * np.arange(len(missed)), np.maximum(missed, 1e-3), color=colour, lw=1.0, label=name)
    axes[0].plot(*(1e3 * wanted.T), "k--", lw=1.0)
    axes[0].set(xlabel="tip x (mm)", ylabel="tip y (mm)", aspect="equal", title="true tip; dashed: reference")
    axes[1].set(xlabel="time (s)", ylabel="distance of the true tip (mm)", title="error")
    figure.legend(loc="outside lower center", ncols=3)
    save_figure(figure, path)


def compare_early(report: Report, arm: TendonArm, motions: list[Motion], given: Any, steps: int) -> None:
    """A log that is a step early and a robot that answers a step late write the same files: L on each, moved or not."""
    for shift in (None, "found"):
        d1 = logged(given.out / f"early-{shift or 'kept'}", motions, 1e-3, SHIFTS[1], shift)
        train, held = d1[: len(motions) - 2], d1[len(motions) - 2 :]
        model = fitted(LinearEDMDc, train)
        for answers_late in (False, True):
            true, wanted = closed(arm, model, train, held, given.seed, steps, answers_late)
            error = 1e3 * float(np.sqrt(np.mean(np.sum((true - wanted)[20:] ** 2, axis=1))))
            which = "robot that answers a step late" if answers_late else "log stamped a step early"
            report.figure(f"{which}, commands {'moved as found' if shift else 'as logged'}: L-EDMDc", error, "mm")


def main() -> None:
    """Record, log, load, fit, tune and track, for roundings and clocks."""
    made = parser((__doc__ or "").splitlines()[0], "out/drawn-arm")
    made.add_argument("--no-units", action="store_true", help="files whose columns name no unit; they are in m")
    made.add_argument("--front", action="store_true", help="by identify alone, told nothing but the logs")
    made.add_argument(
        "--early", action="store_true", help="a log that is early beside a robot that answers late, alone"
    )
    given = made.parse_args()
    arm = drawn()
    print(arm.scene, end="\n\n")
    episodes, steps = (6, 200) if given.quick else (10, APPROACH + ROUNDS * round(PERIOD / DT))
    motions = recorded(arm, episodes, 10.0, given.seed)
    report = Report.of("an arm from a drawing, by its logs alone", given)
    if given.early:
        compare_early(report, arm, motions, given, steps)
        report.write(given.json)
        print(f"\n{report}")
        return
    cases: list[Case] = [(rounding, 0.0, None, 0.3) for rounding in ROUNDINGS]
    cases += [(ROUNDINGS[-1], 0.0, "unrounded", 0.3)]
    cases += [(1e-3, SHIFTS[0], None, 0.5), (1e-3, SHIFTS[1], None, None), (1e-3, SHIFTS[1], "as told", 0.5)]
    cases = cases[1:2] + cases[4:5] if given.quick else cases
    found: dict[str, tuple[Array, Array]] = {}
    told = 0.0
    for number, (rounding, late, shift, target) in enumerate(cases):
        clock = f"{1e3 * abs(late):.0f} ms {'late' if late > 0.0 else 'early'}" if late else "right"
        done = {None: "", "as told": ", moved"}.get(shift, f", {shift}")
        label = f"rounded to {rounding:g} mm, clock {clock}{done}"
        print(f"{label}:")
        folder = given.out / f"logs{number}"
        d1 = logged(folder, motions, rounding, late, told if shift == "as told" else None, not given.no_units)
        d1 = unrounded(d1) if shift == "unrounded" else d1
        origin = d1.provenance or {}
        if late and not shift:
            told = origin["latency"] or 0.0
            report.figure(f"{label}: shift that was made", 1e3 * origin["command_shift"], "ms")
            report.figure(f"{label}: delay that is left and told", 1e3 * told, "ms")
        train, held = d1[: episodes - 2], d1[episodes - 2 :]
        for name, kind in MODELS.items() if not given.front else [("identify", None)]:
            if kind is None:
                true, wanted = by_front(arm, d1, given.seed, steps)
            else:
                true, wanted = closed(arm, fitted(kind, train), train, held, given.seed, steps)
            found[f"{name}, {label}"] = true, wanted
            error = 1e3 * float(np.sqrt(np.mean(np.sum((true - wanted)[20:] ** 2, axis=1))))
            print(f"  {name}: {error:.3f} mm")
            report.figure(
                f"{label}: {name}, RMS of the true tip", error, "mm", None if target is None else ("<=", target)
            )
    draw(found, given.out / "paths.png")
    report.write(given.json)
    print(f"\n{report}\n\nlogs and picture in {given.out}: paths.png")


if __name__ == "__main__":
    run(main)
