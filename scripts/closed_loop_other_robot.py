"""Closed loops on the other robot (disks, friction both ways, lag, play, noise): RMS error of the true tip.

Models learn from its recordings alone; a Kalman filter and the integrating disturbance estimate do the rest. The tip
follows a circle of 0.1 m in 4 s and stops on it. Kinds are L and B, models of commands; "L+told" and "B+told" are
models of the positions behind servos whose lag and play are told, which MPC takes out of what it sends; with "+found"
``find_actuator`` looks for these in all recordings; "+play1.3" and "+lag2" tell 1.3 times the play and twice the lag.
"S" is a model of simulated recordings of the calibrated arm and of the pairs (``fit_simulated``): the drawing over as
many disks as the robot has is calibrated by 16 shapes at rest and the pairs, at most 16; its groups of parameters by
four recordings that give no pairs. Its servos are those of the calibration.
With ``--check`` numbers that recordings contradict are not taken (``choose_actuator``).
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import pickle
import re
import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from tqdm import tqdm

from common.report import Report, parser, run
from pisplit import Actuator, BilinearEDMDc, Dictionary, Episodes, LinearEDMDc, choose_actuator, find_actuator
from pisplit import observables as ob
from pisplit.checks import Array
from pisplit.controllers import MPC, ClosedLoop, KalmanFilter, plants, references
from pisplit.data.episodes import Pairs
from pisplit.estimators.actuator_scan import positions
from pisplit.models.arm import DiskRobot, disk_robot, fit_simulated, simulated_recordings
from pisplit.models.arm.disk_robot import PRESETS
from pisplit.models.calibration import choose_calibration

DT, HORIZON, SETTLED, DELAYS = 0.03, 20, 100, 3
LIMITS = -0.014, 0.016, 0.002
#: Recordings, the steps of one of them, and the pairs of the small model.
EPISODES, STEPS, PAIRS = 20, 200, 128
#: Steps after the stop, of which the last ones count.
RESTING, AT_REST = 40, 15
ESTIMATORS = {"L": LinearEDMDc, "B": BilinearEDMDc}
#: Recordings that give no pairs to calibrations, steps of history of their pairs, the most of these, shapes at rest.
HELD_OUT, HISTORY, CALIBRATED, SHAPES = 4, 4, 16, 16
#: Ridge of the models by which servo numbers are checked.
CHECKED = 1e-4


@dataclass(frozen=True, eq=False)
class Learned:
    """A ``model``, the ``data`` of its filter, and the ``servo`` that it is behind, with the error of its play."""

    model: Any
    data: Episodes
    servo: Actuator | None
    play_error: float | None = None


@dataclass(frozen=True, eq=False)
class Stopping:
    """A reference's ``function`` that stays where it is after ``stop`` seconds."""

    function: Callable[[Array, Array], Array]
    stop: float

    def __call__(self, t: Array, start: Array) -> Array:
        return self.function(np.minimum(t, self.stop), start)


def around(robot: DiskRobot, seed: int, integrator: str) -> Any:
    """The robot behind its servos and cameras, moved by checked steps or by the integrator of its recordings."""
    scene = robot.arm.scene
    moving = scene.simulator(dt=DT) if integrator == "idas" else scene.fast_stepper(dt=DT)
    servo = plants.ActuatedPlant(plants.WrappedPlant(moving), robot.actuator)
    return plants.NoisyMeasurements(servo, robot.noise, robot.noise_angle, seed)


def dictionary(kind: str, data: Episodes) -> Dictionary:
    """That of models of the kind "L" or "B" of ``data``."""
    parts: list[Any] = [ob.Constant(), ob.Identity(), ob.Delays(inputs=DELAYS)]
    if kind == "B":
        parts.append(ob.Bilinear())
    names = {"state_names": data.state_names, "input_names": data.input_names}
    return Dictionary(*parts, n_states=data.n_states, n_inputs=data.n_inputs, **names)


def fitted(kind: str, data: Episodes, pairs: int | None, seed: int) -> Any:
    """A model of the kind "L" or "B" from ``pairs`` drawn from all recordings, or from all there are."""
    drawn = None if pairs is None else data.pairs(DELAYS).sample(pairs, seed)
    return ESTIMATORS[kind](dictionary(kind, data), alpha="cv", penalty="ridge").fit(data, drawn)


def servos(robot: DiskRobot, data: Episodes, how: str) -> Actuator | None:
    """Servos by ``how`` they are known: "told", "found" in ``data``, "play1.3" or "lag2": told so many times too large.

    None for "". Raises ValueError for other words.
    """
    if how == "found":
        found = find_actuator(data, start=robot.arm.rest_inputs)
        tqdm.write(f"  {found}")
        return found.actuator
    wrong = re.fullmatch(r"(lag|play)([0-9.]+)", how)
    if how not in ("", "told") and wrong is None:
        raise ValueError(f"+{how} is no way to know servos; expected +told, +found, +play1.3 or +lag2 behind L or B")
    true = robot.actuator
    if wrong is not None:
        return replace(true, **{wrong[1]: float(wrong[2]) * getattr(true, wrong[1])})
    return true if how else None


def checked(kind: str, data: Episodes, servo: Actuator | None, rest: Array) -> Actuator | None:
    """The ``servo`` if recordings do not contradict it."""
    if servo is None:
        return None

    def fit(d: Episodes) -> Any:
        return ESTIMATORS[kind](dictionary(kind, d), CHECKED, "ridge").fit(d)

    found = choose_actuator(fit, data, [servo], rest)
    tqdm.write(f"  {found}")
    return None if found.actuator == Actuator() else found.actuator


def learned(kind: str, preset: int, data: Episodes, pairs: int | None, given: Any) -> Learned:
    """A model of the ``kind`` from so many ``pairs`` of the recordings ``data`` of a robot, or from all there are."""
    if kind == "S":
        return calibrated(preset, data, pairs, given)
    robot = disk_robot(preset)
    rest = robot.arm.rest_inputs
    estimator, _, how = kind.partition("+")
    servo = servos(robot, data, how)
    servo = checked(estimator, data, servo, rest) if given.check else servo
    moved = data if servo is None else positions(data, servo, rest)
    return Learned(fitted(estimator, moved, pairs, given.seed + given.draw), moved[:1] if pairs else moved, servo)


def calibrated(preset: int, data: Episodes, pairs: int | None, given: Any) -> Learned:
    """A bilinear model of the calibrated arm, simulated, and of so many ``pairs``, or of all there are."""
    robot, learn = disk_robot(preset), data[:-HELD_OUT]
    drawn = learn.pairs(HISTORY).sample(min(pairs or CALIBRATED, CALIBRATED), given.seed)
    file = given.out / f"calibration-{preset}-{len(drawn)}-{given.seed}.pkl"
    if not file.exists():
        spans = [(e, k - HISTORY, k + 1) for e, k in zip(drawn.episode.tolist(), drawn.index.tolist(), strict=True)]
        found = choose_calibration(
            robot.drawing,
            learn,
            robot.rest_shapes(SHAPES, given.seed),
            data[-HELD_OUT:],
            disks=(PRESETS[preset][0],),
            spans=spans,
        )
        tqdm.write(str(found))
        file.write_bytes(pickle.dumps(found))
    found = pickle.loads(file.read_bytes())
    kept = file.with_suffix(".h5")
    sensors: dict[str, Any] = {"noise": robot.noise, "noise_angle": robot.noise_angle}
    twin = simulated_recordings(found.arm, given.simulated, STEPS, DT, **sensors, path=kept)
    moved = positions(data, found.actuator, robot.arm.rest_inputs)
    theta = dictionary("B", moved)
    few = None if pairs is None else of_recordings(moved, len(learn)).sample(pairs, given.seed + given.draw)
    error = next((e.error for e in found.calibration.estimates if e.name == "play"), None)
    model = fit_simulated(theta, moved, twin, few)
    return Learned(model, moved[:1] if pairs else moved, found.actuator, error)


def of_recordings(data: Episodes, number: int) -> Pairs:
    """Pairs of the first ``number`` recordings of ``data``."""
    found = data.pairs(DELAYS)
    return found.take(found.episode < number)


def errors(true: Array, log: Any, stop: int) -> tuple[float, float, float]:
    """Of the true tip in mm: RMS on the circle once settled, RMS at rest at the end, and the largest of all."""
    missed = true[:, list(log.tracked)] - log.reference
    missed = 1e3 * np.linalg.norm(np.where(np.isnan(log.reference), 0.0, missed), axis=1)
    if log.stopped:
        return float("inf"), float("inf"), float("inf")
    rms = [float(np.sqrt(np.mean(part**2))) for part in (missed[SETTLED:stop], missed[-AT_REST:])]
    return rms[0], rms[1], float(missed.max())


def main() -> None:
    """Record, fit, close the loops."""
    made = parser((__doc__ or "").splitlines()[0], "out/other_robot")
    made.add_argument("--presets", default="2", help="robots, separated by commas: 1 to 4")
    made.add_argument("--steps", type=int, default=170, help=f"steps of 30 ms until the tip stops for {RESTING} more")
    made.add_argument("--kinds", default="B,L", help="models: L, B, S, and with servos B+told, B+found, B+lag2")
    made.add_argument("--sizes", default=f"{PAIRS},all", help="pairs to learn from, and all")
    made.add_argument("--rate-weights", default="0.02", help="rate weights, separated by commas")
    made.add_argument("--gains", default="0.3", help="gains of the disturbance estimate")
    made.add_argument("--simulated", type=int, default=24, help="recordings of the calibrated arm of S")
    made.add_argument("--draw", type=int, default=0, help="draw of the pairs and of the noise in the loop")
    made.add_argument("--check", action="store_true", help="take no servo numbers that recordings contradict")
    made.add_argument("--episodes", type=int, default=EPISODES)
    made.add_argument("--integrator", default="fast", choices=("fast", "idas"), help="that moves the robot")
    given = made.parse_args()
    if given.steps <= SETTLED:
        made.error(f"--steps {given.steps}; expected more than {SETTLED}, the steps before errors count")
    if "S" in given.kinds.split(",") and (given.quick or given.episodes <= HELD_OUT):
        made.error(f"S holds {HELD_OUT} recordings out; give more --episodes than that, and not --quick")
    given.out.mkdir(parents=True, exist_ok=True)
    report = Report.of("closed loops on the other robot, circle of 0.1 m in 4 s, then at rest on it", given)
    circle = references.circle(radius=0.1, period=4.0)
    reference = replace(circle, function=Stopping(circle.function, given.steps * DT))
    settings = [(float(w), float(g)) for w in given.rate_weights.split(",") for g in given.gains.split(",")]
    found: dict[str, list[tuple[float, float, float]]] = {}
    for preset in (int(p) for p in given.presets.split(",")):
        robot, episodes = disk_robot(preset), 4 if given.quick else given.episodes
        file = given.out / f"d1-{preset}-{episodes}-{given.seed}.h5"
        data = Episodes.load(file) if file.exists() else robot.record(episodes, given.seed, STEPS, DT, path=file)
        told = {**robot.noise, "1": robot.noise_angle}
        plant = around(robot, given.seed + given.draw, given.integrator)
        tried = [(k, n) for k in given.kinds.split(",") for n in given.sizes.split(",")]
        for kind, size in tqdm(tried, desc=f"robot {preset}", unit="model"):
            pairs = None if size == "all" else int(size)
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                made_of = learned(kind, preset, data, pairs, given)
            observer = KalmanFilter.from_data(made_of.model, made_of.data, told)
            for weight, gain in settings:
                few = f"{pairs} pairs" if pairs else f"{episodes} recordings"
                label = f"{kind}, {few}, rate weight {weight:g}, gain {gain:g}"
                numbers: dict[str, Any] = {"rate_weight": weight, "estimator_gain": gain, "observer": observer}
                numbers |= {"actuator": made_of.servo, "play_error": made_of.play_error}
                mpc = MPC(made_of.model, HORIZON, *LIMITS, **numbers)
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore")
                    total = given.steps + RESTING
                    log = ClosedLoop(plant, mpc).run(reference, total, u0=robot.arm.rest_inputs, progress=False)
                seen = errors(plant.true_states, log, given.steps)
                found.setdefault(label, []).append(seen)
                report.figure(f"robot {preset}: {label}, circle", seen[0], "mm", ("<=", 0.5 if pairs else 0.3))
                report.figure(f"robot {preset}: {label}, at rest", seen[1], "mm")
                report.figure(f"robot {preset}: {label}, largest", seen[2], "mm")
                tqdm.write(f"robot {preset}: {label}: {seen[0]:.3g} / {seen[1]:.3g}, largest {seen[2]:.3g} mm")
                for note in [*([log.message] if log.stopped else []), *log.notes]:
                    tqdm.write(f"  {note}")
    for label, rows in found.items():
        if len(rows) > 1:
            report.figure(f"median: {label}, circle", float(np.median([r[0] for r in rows])), "mm")
            report.figure(f"worst: {label}, circle", max(r[0] for r in rows), "mm")
    report.write(given.json)
    print(report)


if __name__ == "__main__":
    run(main)
