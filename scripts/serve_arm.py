"""The simulated arm as a plant of its own: it listens on a port and moves by the clock.

A controller in another process connects with ``pisplit.controllers.plants.SocketPlant(port)``.
"""

from __future__ import annotations

import sys

import numpy as np

from common.report import Report, parser, run
from pisplit import Actuator
from pisplit.controllers import plants
from pisplit.models.arm import TendonArm

ARMS = {"paper": TendonArm.paper, "prototype": TendonArm.prototype}


def main() -> None:
    """Serve the arm until clients have come and gone."""
    made = parser(__doc__.splitlines()[0])
    made.add_argument("--arm", choices=ARMS, default="paper")
    made.add_argument("--dt", type=float, default=0.03, metavar="S", help="time step")
    made.add_argument("--port", type=int, default=5555, help="0 takes a free one")
    made.add_argument("--realtime", action="store_true", help="answer a step when it is over, not when it is computed")
    made.add_argument("--noise", type=float, default=0.0, metavar="M", help="deviation of positions")
    made.add_argument("--angle", type=float, default=0.0, metavar="DEG", help="deviation of frames")
    made.add_argument("--delay", type=float, default=0.0, metavar="STEPS", help="of measurements")
    made.add_argument("--lag", type=float, default=0.0, metavar="S", help="of the servos")
    made.add_argument("--play", type=float, default=0.0, metavar="M", help="of the servos")
    made.add_argument("--connections", type=int, metavar="N", help="end after so many; never when not given")
    given = made.parse_args()

    plant = plants.ActuatedPlant(ARMS[given.arm]().scene.fast_stepper(dt=given.dt), Actuator(given.lag, given.play))
    noisy = plants.NoisyMeasurements(plant, {"m": given.noise}, np.deg2rad(given.angle), given.seed)
    late = plants.serve(
        plants.DelayedMeasurements(noisy, given.delay),
        given.port,
        realtime=given.realtime,
        connections=given.connections,
        ready=lambda port: print(f"{given.arm} arm, dt = {given.dt:g} s, on port {port}", flush=True),
    )
    report = Report.of("the simulated arm behind a socket", given)
    report.figure("late steps", late, "")
    report.write(given.json)
    print(report)


if __name__ == "__main__":
    try:
        run(main)
    except KeyboardInterrupt:
        sys.exit(130)
