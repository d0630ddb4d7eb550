"""The front door on a robot that is not as drawn: recordings and shapes at rest in, the arm that it is and a model out.

The robot is ``disk_robot``: spacer disks with friction, servos with lag and play, stiffness and masses off its drawing,
another integrator, measurement noise. ``identify`` is told the drawing and how many disks there are.
"""

from __future__ import annotations

import time
import warnings

import pisplit as ps
from common.report import Report, parser, run
from pisplit.models.arm.disk_robot import PRESETS, disk_robot


def main() -> None:
    """Identify, print the reports, score on recordings that nothing has seen."""
    made = parser((__doc__ or "").splitlines()[0], out="out/other-robot-front")
    made.add_argument("--preset", type=int, default=1, choices=sorted(PRESETS), help="which robot")
    made.add_argument("--recordings", type=int, default=8, help="of 6 s each")
    given = made.parse_args()
    report = Report.of("the front door on the other robot", given)
    robot, number = disk_robot(given.preset), 3 if given.quick else given.recordings
    recorded, begin = robot.record(number + 4, given.seed), time.process_time()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        shapes = robot.rest_shapes(16)
        model = ps.identify(recorded[:number], arm=robot.drawing, shapes=shapes, disks=(None, PRESETS[given.preset][0]))
    report.figure("identify, CPU", time.process_time() - begin, "s")
    print(f"{model.report()}\n\n{model.calibration.report() if model.calibration else 'calibrated as drawn'}\n")
    test = recorded[number:]
    report.figure("chosen model, four unseen recordings of 6 s, median squared error", model.score(test).median, "m^2")
    if model.predictor is not None:
        report.figure("the arm that was found, the same", model.predictor.score(test).median, "m^2")
    given.out.mkdir(parents=True, exist_ok=True)
    model.plot(given.out / "model.png")
    report.write(given.json)
    print(report)


if __name__ == "__main__":
    run(main)
