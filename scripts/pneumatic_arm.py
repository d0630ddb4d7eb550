"""A pneumatic arm in MuJoCo that nobody here wrote, from recordings to MPC: tip alone measured, no number by hand.

Needs the package soft-robotic-arm: pip install pisplit[plants].
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import importlib
import time
import warnings
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from tqdm import tqdm

from common.report import Report, parser, run
from pisplit import Dictionary, Episodes, LinearEDMDc, identify
from pisplit import observables as ob
from pisplit.checks import Array
from pisplit.controllers import MPC, ClosedLoop, PlantStep, references, tune

DT, DELAYS = 0.05, 8
#: Pressures in psi, and their largest change in a step; samples for which a random pressure is aimed at.
LOW, HIGH, RATE, HOLD = 0.5, 6.0, 0.4, 10
#: Steps in which the arm comes to rest, in a circle's run, and of a jump.
REST, CIRCLE, JUMP = 80, 180, 100


class PneumaticArm:
    """The arm of the package: pressures in psi in, tip position in m out.

    ``calibrated``: the twin of the measured arm, with one sealed chamber and three pressures; else the symmetric one.
    """

    dt, n_states = DT, 3
    state_names, state_units = ("x", "y", "z"), ("m",) * 3

    def __init__(self, calibrated: bool = False) -> None:
        try:
            package: Any = importlib.import_module("soft_robotic_arm")
        except ImportError:
            raise ValueError("this needs the package soft-robotic-arm; pip install pisplit[plants]") from None
        make = package.make_calibrated_sim if calibrated else package.make_sim
        self._sim = make(control_hz=1.0 / DT)
        self.n_inputs = 3 if calibrated else 4
        self.input_names = tuple(f"segment {k}" for k in range(5 - self.n_inputs, 5))
        self.input_units = ("psi",) * self.n_inputs

    def reset(self, u0: ArrayLike | None = None) -> Array:
        """At rest under ``u0`` (n_inputs,)."""
        self._sim.reset()
        u = np.zeros(self.n_inputs) if u0 is None else np.array(u0, dtype=np.float64)
        for _ in range(REST):
            seen = self._sim.step(u)
        return np.array(seen["tip_pos"], dtype=np.float64)

    def step(self, u: ArrayLike) -> PlantStep:
        """One step under ``u`` (n_inputs,)."""
        return PlantStep(np.array(self._sim.step(np.array(u))["tip_pos"], dtype=np.float64))


def record(arm: PneumaticArm, episodes: int, steps: int, seed: int) -> Episodes:
    """Random pressures, each aimed at for half a second."""
    rng, middle, xs, us = np.random.default_rng(seed), np.full(arm.n_inputs, 0.5 * (LOW + HIGH)), [], []
    for _ in tqdm(range(episodes), desc="recordings", unit="episode"):
        u, x, inputs = middle, [arm.reset(middle)], []
        for k in range(steps):
            if k % HOLD == 0:
                goal = rng.uniform(LOW, HIGH, arm.n_inputs)
            u = u + np.clip(goal - u, -RATE, RATE)
            inputs.append(u)
            x.append(arm.step(u).state)
        xs.append(np.array(x))
        us.append(np.array(inputs))
    named: dict[str, Any] = {"state_names": arm.state_names, "input_names": arm.input_names, "units": arm.state_units}
    return Episodes(xs, us, DT, outputs={"tip": (0, 1, 2)}, input_units=arm.input_units, **named)


def by_hand(report: Report, train: Episodes, held: Episodes) -> MPC:
    """A linear model with delays, and what ``tune`` makes of it."""
    n, m = train.n_states, train.n_inputs
    theta = Dictionary(ob.Constant(), ob.Identity(), ob.Delays(DELAYS, DELAYS), n_states=n, n_inputs=m)
    model = LinearEDMDc(theta, alpha="cv").fit(train)
    report.figure("squared error of 10 s roll-outs, median", model.score(held, "tip").median, "m^2")
    tuned = tune(model, held, LOW, HIGH, RATE, axes=(0, 1))
    print(tuned)
    report.figure("tuning", tuned.seconds, "s")
    return tuned.mpc


def by_front(report: Report, train: Episodes) -> MPC:
    """What ``identify`` makes of the recordings alone."""
    begin = time.process_time()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = identify(train)
        control = found.mpc(u_max=HIGH, du_max=RATE, u_min=LOW, axes=(0, 1))
    print(f"{found.report()}\n\n{control}")
    report.figure("identify and its controller, CPU", time.process_time() - begin, "s")
    return control.controller


def main() -> None:
    """Record, fit, tune, and close the loop along a circle and a jump."""
    made = parser((__doc__ or "").splitlines()[0])
    made.add_argument("--calibrated", action="store_true", help="the twin of the measured arm")
    made.add_argument("--episodes", type=int, default=13, help="recordings of 10 s, the last three held out")
    made.add_argument("--front", action="store_true", help="by identify and what it makes of the data, not by tune")
    given = made.parse_args()
    episodes, steps = (6, 100) if given.quick else (given.episodes, 200)
    if episodes < 5:
        made.error(f"--episodes {episodes}; expected at least 5: three are held out")
    arm = PneumaticArm(given.calibrated)
    data = record(arm, episodes, steps, given.seed)
    train, held = data[: episodes - 3], data[episodes - 3 :]
    report = Report.of("MPC on a pneumatic arm in MuJoCo", given)
    mpc = by_front(report, train) if given.front else by_hand(report, train, held)
    middle = np.full(arm.n_inputs, 0.5 * (LOW + HIGH))
    home = arm.reset(middle)[:2]
    radius = 0.2 * float(np.ptp(np.concatenate(train.xs)[:, :2], axis=0).max())
    loop = ClosedLoop(arm, mpc)
    circle = references.circle(radius, 4.0, center=home, approach=1.0, width=2)
    log = loop.run(circle, CIRCLE, u0=middle)
    print(log.summary())
    report.figure(f"circle of {1e3 * radius:.2g} mm in 4 s", 1e3 * log.rms_error(after=3.0), "mm", ("<=", 0.02))
    jump = references.setpoint([home + radius * np.array([1.0, 0.5])], [0.2])
    log = loop.run(jump, JUMP, u0=middle)
    report.figure("after a jump", 1e3 * log.rms_error(after=4.0), "mm", ("<=", 0.002))
    report.write(given.json)
    print(report)


if __name__ == "__main__":
    run(main)
