"""Closed loops on the other robot (disks, friction both ways, lag, play, noise): RMS error of the true tip.

Models learn from its recordings alone; a Kalman filter and the integrating disturbance estimate do the rest.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import warnings
from typing import Any

import numpy as np
from tqdm import tqdm

from common.report import Report, parser, run
from pisplit import BilinearEDMDc, Dictionary, Episodes, LinearEDMDc
from pisplit import observables as ob
from pisplit.checks import Array
from pisplit.controllers import MPC, ClosedLoop, KalmanFilter, plants, references
from pisplit.models.arm import DiskRobot, disk_robot

DT, HORIZON, SETTLED, DELAYS = 0.03, 20, 100, 3
LIMITS = -0.014, 0.016, 0.002
#: Recordings, the steps of one of them, and the pairs of the small model.
EPISODES, STEPS, PAIRS = 20, 200, 128
ESTIMATORS = {"L": LinearEDMDc, "B": BilinearEDMDc}


class Robot(plants.WrappedPlant):
    """The robot in motion, by the integrator that makes its recordings."""

    def __init__(self, robot: DiskRobot) -> None:
        super().__init__(robot.arm.scene.simulator(dt=DT))


def around(robot: DiskRobot, seed: int) -> Any:
    """The robot behind its servos and cameras."""
    servo = plants.ActuatedPlant(Robot(robot), robot.actuator)
    return plants.NoisyMeasurements(servo, robot.noise, robot.noise_angle, seed)


def fitted(kind: str, data: Episodes, pairs: int | None, seed: int) -> Any:
    """A model of the kind "L" or "B" from ``pairs`` drawn from all recordings, or from all there are."""
    parts: list[Any] = [ob.Constant(), ob.Identity(), ob.Delays(inputs=DELAYS)]
    if kind == "B":
        parts.append(ob.Bilinear())
    names = {"state_names": data.state_names, "input_names": data.input_names}
    theta = Dictionary(*parts, n_states=data.n_states, n_inputs=data.n_inputs, **names)
    drawn = None if pairs is None else data.pairs(DELAYS).sample(pairs, seed)
    return ESTIMATORS[kind](theta, alpha="cv", penalty="ridge").fit(data, drawn)


def rms(true: Array, log: Any) -> float:
    """RMS distance in mm of the true tip from the reference, once settled."""
    missed = true[:, list(log.tracked)] - log.reference
    missed = np.linalg.norm(np.where(np.isnan(log.reference), 0.0, missed), axis=1)
    return float("inf") if log.stopped else 1e3 * float(np.sqrt(np.mean(missed[SETTLED:] ** 2)))


def main() -> None:
    """Record, fit, close the loops."""
    made = parser((__doc__ or "").splitlines()[0], "out/other_robot")
    made.add_argument("--preset", type=int, default=1, help="of the robot: 1, 2 or 3")
    made.add_argument("--steps", type=int, default=300, help="steps of 30 ms in every loop")
    made.add_argument("--kinds", default="L,B", help="models, L and B")
    made.add_argument("--rate-weights", default="0.02", help="rate weights, separated by commas")
    made.add_argument("--gains", default="0.1", help="gains of the disturbance estimate")
    made.add_argument("--episodes", type=int, default=EPISODES)
    given = made.parse_args()
    if given.steps <= SETTLED:
        made.error(f"--steps {given.steps}; expected more than {SETTLED}, the steps before errors count")
    given.out.mkdir(parents=True, exist_ok=True)
    robot = disk_robot(given.preset)
    episodes = 4 if given.quick else given.episodes
    file = given.out / f"d1-{given.preset}-{episodes}-{given.seed}.h5"
    data = Episodes.load(file) if file.exists() else robot.record(episodes, given.seed, STEPS, DT, path=file)
    report = Report.of(f"closed loops on the other robot {given.preset}, circle of 0.1 m in 4 s", given)
    told = {**robot.noise, "1": robot.noise_angle}
    plant, reference = around(robot, given.seed), references.circle(radius=0.1, period=4.0)
    for kind in given.kinds.split(","):
        for pairs in (PAIRS, None):
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                model = fitted(kind, data, pairs, given.seed)
            observer = KalmanFilter.from_data(model, data[:1] if pairs else data, told)
            few = f"{PAIRS} pairs" if pairs else f"{episodes} recordings"
            settings = [(float(w), float(g)) for w in given.rate_weights.split(",") for g in given.gains.split(",")]
            for weight, gain in tqdm(settings, desc=f"{kind}, {few}", unit="loop"):
                mpc = MPC(model, HORIZON, *LIMITS, rate_weight=weight, estimator_gain=gain, observer=observer)
                log = ClosedLoop(plant, mpc).run(reference, given.steps, u0=robot.arm.rest_inputs, progress=False)
                target = 0.5 if pairs else 0.3
                label = f"{kind}, {few}, rate weight {weight:g}, gain {gain:g}"
                report.figure(label, rms(plant.true_states, log), "mm", ("<=", target))
                if log.stopped:
                    print(f"{label}: {log.message}")
    report.write(given.json)
    print(report)


if __name__ == "__main__":
    run(main)
