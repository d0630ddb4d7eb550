"""Tendons that are pulled each for itself, half of them slack: what columns of the stretch to come bring.

Error: median squared shape error of 6 s open-loop roll-outs of recordings that no fit sees; every model chooses its
structure and ridge on held-out recordings, and has to stay bounded under recorded commands.
"""

from __future__ import annotations

import sys
import time
import warnings
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # the other rooms of scripts/

import pisplit as ps
from common.report import Report, parser, run
from pisplit import observables as ob
from pisplit.models.arm.twin import SLACK_WIDTH

#: Structures of re-lifted models to choose from.
CHOICES: dict[str, Any] = {
    "components": (16, 20, 24),
    "leading": (0, 4, 8),
    "degrees": (2,),
    "alphas": (1e-8, 1e-7, 1e-6, 1e-5, 1e-4),
    "cv_states": "shape",
    "omit": ("v",),
    "cv_folds": 1,
}
#: Where the prototype was with 150 recordings.
TARGET = 9e-5


def main() -> None:
    made = parser(__doc__ or "")
    made.add_argument("--recordings", type=int, default=60, help="training recordings of 6 s")
    arguments = made.parse_args()
    report, quick = Report.of("slack tendons", arguments), arguments.quick
    arm = ps.TendonArm.paper()
    d1 = arm.record(12 if quick else arguments.recordings, seed=arguments.seed, law="independent")
    test = arm.record(4 if quick else 12, seed=arguments.seed + 1000, law="independent")
    moved = np.stack(d1.us[:8])
    for name, estimator in methods(arm, d1).items():
        spent = time.process_time()
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            found = estimator.fit(d1, excitation=moved)
            errors = found.score(test, "shape")
        target = ("<=", TARGET) if name.endswith("tension") and not quick else None
        report.figure(name, errors.median, "m^2", target)
        report.figure(f"{name}, divergent roll-outs of {len(test)}", float(errors.diverged.sum()), "")
        report.figure(f"{name}, bounded", float(found.bounded_ is not False), "")
        report.figure(f"{name}, fit", time.process_time() - spent, "s")
        print(f"{name}: {errors.median:.2g} m^2", flush=True)
    print(report)
    report.write(arguments.json)


def methods(arm: ps.TendonArm, d1: ps.Episodes) -> dict[str, Any]:
    """B-EDMDc with slack features of the command, and re-lifted models without and with those of the stretch."""
    terms = (ob.Constant(), ob.States(), ob.Inputs(), ob.Delays(inputs=1), ob.Slack(SLACK_WIDTH), ob.Bilinear())
    theta = ps.Dictionary(*terms, n_states=d1.n_states, n_inputs=d1.n_inputs)
    ridges = np.logspace(-10, 3, 14).tolist()
    return {
        "B-EDMDc, slack of the command": ps.BilinearEDMDc(
            theta, alpha="cv", alphas=ridges, cv_states="shape", cv_folds=1
        ),
        "re-lifted": ps.ReliftedEDMDc(**CHOICES),
        "re-lifted, tension": ps.ReliftedEDMDc(**CHOICES, tension=arm.tension()),
    }


if __name__ == "__main__":
    run(main)
