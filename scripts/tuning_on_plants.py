"""Numbers chosen by ``tune`` against the defaults, on several plants: a circle and a jump of the true tip.

Plants: "paper", "prototype" (simulated arms), "robot" (disks, friction, lag, play), "symmetric" and "calibrated"
(pneumatic arms in MuJoCo, pip install pisplit[plants]).
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np
from pneumatic_arm import HIGH, LOW, RATE, PneumaticArm, record
from tqdm import tqdm

from common.report import Report, parser, run
from pisplit import Dictionary, Episodes, LinearEDMDc
from pisplit import observables as ob
from pisplit.checks import Array
from pisplit.controllers import MPC, ClosedLoop, plants, references, tune
from pisplit.models.arm import TendonArm, disk_robot

DT, HORIZON, SETTLED, JUMP, HELD = 0.03, 20, 100, 80, 2
NAMES = ("paper", "prototype", "robot", "symmetric", "calibrated")


@dataclass(frozen=True)
class Case:
    """A ``plant`` with recordings of it, limits, delays of states and inputs in its model, the input ``rest`` (m,)
    where runs start, the tracked ``axes``, and the radius of the circle in m."""

    plant: Any
    data: Episodes
    limits: tuple[Any, Any, Any]
    delays: tuple[int, int]
    rest: Array
    axes: tuple[int, ...]
    radius: float


def case(name: str, episodes: int, seed: int) -> Case:
    """The plant of this ``name`` with its recordings."""
    if name in ("symmetric", "calibrated"):
        arm = PneumaticArm(name == "calibrated")
        data = record(arm, episodes, 200, seed)
        radius = 0.2 * float(np.ptp(np.concatenate(data.xs)[:, :2], axis=0).max())
        return Case(arm, data, (LOW, HIGH, RATE), (8, 8), np.full(arm.n_inputs, 0.5 * (LOW + HIGH)), (0, 1), radius)
    plant: Any
    if name == "robot":
        robot = disk_robot()
        servo = plants.ActuatedPlant(robot.arm.scene.simulator(dt=DT), robot.actuator)
        plant = plants.NoisyMeasurements(servo, robot.noise, robot.noise_angle, seed)
        tendons, data = robot.drawing, robot.record(episodes, seed, 200, DT, workers=1)
    else:
        tendons = getattr(TendonArm, name)()
        plant = plants.WrappedPlant(tendons.scene.fast_stepper(dt=DT))
        data = tendons.record(episodes, seed, 200, DT, workers=1, progress=False)
    reach = 1.5 * tendons.amplitude
    low, high = tendons.rest_inputs - reach, tendons.rest_inputs + reach
    radius = 0.3 * float(np.ptp(np.concatenate(data.xs)[:, list((data.outputs or {})["tip"])], axis=0)[1])
    return Case(plant, data, (low, high, 0.2 * tendons.amplitude), (0, 2), tendons.rest_inputs, (0, 1, 2), radius)


def errors(made: Case, mpc: MPC) -> tuple[float, float]:
    """RMS errors in mm of the true tip on the circle, and at the end of a jump; infinite where the loop was lost."""
    rows, found = list(mpc.tracked), []
    home = np.asarray(made.plant.reset(made.rest))[rows]
    dt = float(made.plant.dt)
    circle = references.circle(made.radius, 4.0, center=home[:2], approach=1.0, width=2)
    jump = references.setpoint([home[:2] + made.radius * np.array([0.6, 0.5])], [0.2])
    for reference, steps, after in ((circle, SETTLED + int(4.0 / dt), SETTLED), (jump, JUMP, JUMP - 20)):
        wanted = reference if len(made.axes) == 2 else _free_along(reference, steps + mpc.horizon + 2, dt)
        log = ClosedLoop(made.plant, mpc).run(wanted, steps, u0=made.rest, progress=False)
        true = getattr(made.plant, "true_states", log.x)[:, rows]
        missed = np.where(np.isnan(log.reference), 0.0, true - log.reference)[after:]
        found.append(np.inf if log.stopped else 1e3 * float(np.sqrt(np.mean((missed**2).sum(axis=1)))))
    return found[0], found[1]


def _free_along(reference: Any, samples: int, dt: float) -> references.Reference:
    """The plane reference in the two coordinates across the arm; along it, whatever follows."""
    y = reference(dt * np.arange(samples))
    return references.from_array(np.column_stack([y, np.full(len(y), np.nan)]), dt)


def main() -> None:
    """Record, fit, tune, compare."""
    made = parser((__doc__ or "").splitlines()[0])
    made.add_argument("--plants", default=",".join(NAMES), help="which, separated by commas")
    made.add_argument("--episodes", type=int, default=8, help="recordings, the last two held out")
    given = made.parse_args()
    report = Report.of("tune against the defaults", given)
    for name in tqdm(given.plants.split(","), desc="plants", unit="plant"):
        here = case(name, 5 if given.quick else given.episodes, given.seed)
        train, held = here.data[:-HELD], here.data[-HELD:]
        parts: list[Any] = [ob.Constant(), ob.Identity(), ob.Delays(*here.delays)]
        sizes: dict[str, Any] = {"n_states": train.n_states, "n_inputs": train.n_inputs}
        theta = Dictionary(*parts, **sizes, state_names=train.state_names, input_names=train.input_names)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            model = LinearEDMDc(theta, alpha="cv", penalty="ridge").fit(train)
            try:
                tuned = tune(model, held, *here.limits, axes=here.axes, progress=False)
            except ValueError as error:
                tqdm.write(f"{name}: not tuned: {error}")
                continue
        print(f"{name}\n{tuned}")
        plain = MPC(model, HORIZON, *here.limits, axes=here.axes)
        by_default, by_tuning = errors(here, plain), errors(here, tuned.mpc)
        for what, one, other in zip(("circle", "jump"), by_default, by_tuning, strict=True):
            report.figure(f"{name}, {what}: defaults", one, "mm")
            report.figure(f"{name}, {what}: tuned", other, "mm")
        report.figure(f"{name}, both: tuned", sum(by_tuning), "mm", ("<=", sum(by_default)))
    report.write(given.json)
    print(report)


if __name__ == "__main__":
    run(main)
