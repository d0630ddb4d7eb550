"""Predicted errors against true ones: over a hundred fits on four plants, of little data and much.

Every model is fitted to some pairs of the training recordings (each method with its own choice on held-out parts of
them), its error is predicted by ``predicted_error`` with the residuals of further recordings, and compared with the
median error of its roll-outs on test recordings, which nothing else sees: under their commands, which the prediction is
told, and under those of the recordings backwards, which it takes where it is told of none.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")

import sys
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # the other rooms of scripts/

import numpy as np
from tqdm import tqdm

from common.report import Report, parser, run
from pisplit import (
    BilinearEDMDc,
    Dictionary,
    Episodes,
    LinearEDMDc,
    ReliftedEDMDc,
    predicted_error,
    rollout_errors,
)
from pisplit import observables as ob
from pisplit.files import write_text
from pisplit.models.arm.disk_robot import disk_robot
from pisplit.models.arm.tendon_arm import TendonArm

#: Recordings to learn from, to take residuals from, and to test on; steps of each.
TRAINING, HELD, TEST, STEPS = 12, 4, 8, 120
STATIONS = 3
SIZES, SEEDS = (32, 64, 128, 256, 512), 3
#: Factors that a prediction should be within, and never be too small by.
NEAR, NEVER = 3.0, 10.0


@dataclass(frozen=True)
class Fit:
    """A fit with its errors, medians over all steps of all roll-outs: what was predicted and what came true."""

    plant: str
    method: str
    pairs: int
    seed: int
    predicted: float
    backwards: float
    true: float

    def ratio(self, predicted: float) -> float:
        """``predicted`` over true error; 1 where the model is lost and that is said."""
        if not np.isfinite(self.true):
            return 1.0 if not np.isfinite(predicted) else 0.0
        return predicted / self.true


def tendon_arm(arm: TendonArm) -> Callable[[int, int], Episodes]:
    """Recordings of a simulated arm."""
    return lambda episodes, seed: arm.record(episodes, seed, STEPS, stations=STATIONS, workers=1, progress=False)


def other_robot(episodes: int, seed: int) -> Episodes:
    """Noisy recordings of the robot with disks, friction, lag and play."""
    return disk_robot(1).record(episodes, seed, STEPS, stations=STATIONS, workers=1, progress=False)


def pneumatic(episodes: int, seed: int) -> Episodes:
    """Tip positions of the pneumatic arm in MuJoCo."""
    from pneumatic_arm import PneumaticArm, record

    return record(PneumaticArm(), episodes, STEPS, seed)


PLANTS: dict[str, Callable[[int, int], Episodes]] = {
    "paper arm": tendon_arm(TendonArm.paper(nodes=4)),
    "prototype arm": tendon_arm(TendonArm.prototype(nodes=4)),
    "other robot": other_robot,
    "pneumatic arm": pneumatic,
}


def estimators(data: Episodes) -> Iterator[tuple[str, Any, int]]:
    """Name, estimator and delays of every method."""
    delays = 4 if data.n_states < 10 else 0
    sizes: dict[str, Any] = {"n_states": data.n_states, "n_inputs": data.n_inputs}
    terms = (ob.Constant(), ob.States(), ob.Inputs(), ob.Delays(states=delays, inputs=max(1, delays)))
    group = "shape" if "shape" in (data.outputs or {}) else None
    ridges = np.logspace(-10, 2, 7).tolist()
    options: dict[str, Any] = {"alphas": ridges, "cv_states": group, "cv_folds": 1}
    yield "L-EDMDc", LinearEDMDc(Dictionary(*terms, **sizes), "cv", **options), max(1, delays)
    yield "B-EDMDc", BilinearEDMDc(Dictionary(*terms, ob.Bilinear(), **sizes), "cv", **options), max(1, delays)
    if not delays:
        yield "re-lifted", ReliftedEDMDc((8,), (4,), (2,), ridges, group, cv_folds=1), 1


def fits(plant: str, data: Episodes, sizes: tuple[int, ...], seeds: int) -> Iterator[Fit]:
    """All fits on the recordings of one plant."""
    training, held, test = data[:TRAINING], data[TRAINING : TRAINING + HELD], data[TRAINING + HELD :]
    group = "shape" if "shape" in (data.outputs or {}) else None
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")  # lost roll-outs are what this is about
        for name, estimator, delays in estimators(data):
            every = training.pairs(delays)
            for size in sizes:
                for seed in range(seeds):
                    try:
                        fit = estimator.fit(training, pairs=every.sample(size, seed), excitation=None)
                    except ValueError:
                        continue  # says that it is lost
                    ahead, backwards = (predicted_error(fit, held, e, group).median for e in (np.stack(test.us), None))
                    true = rollout_errors(fit, test, group).median
                    yield Fit(plant, name, size, seed, ahead, backwards, true)


def table(found: list[Fit]) -> str:
    """One line a fit."""
    lines = ["plant,method,pairs,seed,predicted,backwards,true"]
    for f in found:
        lines.append(f"{f.plant},{f.method},{f.pairs},{f.seed},{f.predicted:.4g},{f.backwards:.4g},{f.true:.4g}")
    return "\n".join(lines) + "\n"


def main() -> None:
    made = parser(__doc__ or "", "out/predicted")
    made.add_argument("--plant", action="append", default=None, help="one or several plants, default all")
    arguments = made.parse_args()
    names = arguments.plant or (["pneumatic arm"] if arguments.quick else list(PLANTS))
    if unknown := set(names) - set(PLANTS):
        raise ValueError(f"plant {min(unknown)!r}; expected some of {', '.join(PLANTS)}")
    sizes, seeds = ((64, 256), 2) if arguments.quick else (SIZES, SEEDS)
    found: list[Fit] = []
    for name in names:
        path = arguments.out / f"{name.replace(' ', '-')}-{arguments.seed}.h5"
        if not path.exists():
            arguments.out.mkdir(parents=True, exist_ok=True)
            PLANTS[name](TRAINING + HELD + TEST, arguments.seed).save(path)
        made_of = list(tqdm(fits(name, Episodes.load(path), sizes, seeds), desc=name, unit="fit"))
        print(f"{name}: {len(made_of)} fits", flush=True)
        found += made_of
    write_text(arguments.out / "predicted.csv", table(found), make_folders=True)
    report = Report.of("predicted errors", arguments)
    report.figure("fits", len(found), "", None if arguments.quick else (">=", 100))
    judged = {name: [f for f in found if f.plant == name] for name in names} | {"all plants": found}
    for name, some in judged.items():
        for how, told in (("", "predicted"), (", commands backwards", "backwards")):
            ratios = np.array([f.ratio(getattr(f, told)) for f in some])
            near = float(((ratios <= NEAR) & (ratios >= 1.0 / NEAR)).mean())
            every = name == "all plants" and not how
            report.figure(f"{name}{how}: within a factor 3", 100.0 * near, "%", (">=", 90.0) if every else None)
            lowest = (">=", 1.0 / NEVER) if name == "all plants" else None
            report.figure(f"{name}{how}: smallest predicted over true", float(ratios.min()), "", lowest)
            report.figure(f"{name}{how}: largest predicted over true", float(ratios.max()), "")
    print(report)
    report.write(arguments.json)


if __name__ == "__main__":
    run(main)
