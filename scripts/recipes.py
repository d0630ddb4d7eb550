"""Which dictionary for which arm: recipes side by side on robots that the toolkit did not write or does not model.

A pneumatic arm in MuJoCo of which the tip is seen (two versions; pip install pisplit[plants]) and a tendon robot with
disks, friction, lag, play and noise of which six markers are seen. Penalties are chosen on held-out roll-outs of the
training recordings, and so is the recipe of the last row; errors are of recordings that nothing has seen.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pneumatic_arm import PneumaticArm, record
from tqdm import tqdm

from common.report import Report, parser, run
from pisplit import BilinearEDMDc, Dictionary, Episodes, LinearEDMDc, rollout_errors
from pisplit import observables as ob
from pisplit.models.arm.disk_robot import disk_robot

#: Steps of history that all recipes have before a roll-out, so that they are judged on the same steps.
HISTORY = 4
#: Recordings that are tested on, and the largest number to learn from.
TEST, POOL = 6, 12


@dataclass(frozen=True)
class Recipe:
    """Columns beside states, inputs and the constant; ``bilinear``: products of the inputs with the lifted states."""

    columns: tuple[Any, ...] = ()
    bilinear: bool = False

    def fitted(self, d1: Episodes) -> Any:
        """The estimator of this recipe with its penalty chosen on held-out roll-outs."""
        terms = (ob.Constant(), ob.Identity(), *self.columns)
        theta = Dictionary(*terms, n_states=d1.n_states, n_inputs=d1.n_inputs)
        made = (BilinearEDMDc if self.bilinear else LinearEDMDc)(theta, alpha="cv", cv_states="shape")
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")  # what little data allow is what is measured here
            return made.fit(d1, d1.pairs(HISTORY))


CUBIC = ob.Polynomials(3, of="inputs")
RECIPES: Mapping[str, Recipe] = {
    "states": Recipe(),
    "delays of inputs": Recipe((ob.Delays(inputs=HISTORY),)),
    "delays of states": Recipe((ob.Delays(states=HISTORY),)),
    "delays of both": Recipe((ob.Delays(HISTORY, HISTORY),)),
    "cubic inputs": Recipe((CUBIC,)),
    "cubic inputs, delays of inputs": Recipe((CUBIC, ob.Delays(inputs=HISTORY))),
    "cubic inputs, delays of both": Recipe((CUBIC, ob.Delays(HISTORY, HISTORY))),
    "bilinear": Recipe((), True),
    "bilinear, delays of inputs": Recipe((ob.Delays(inputs=HISTORY),), True),
    "bilinear, delays of both": Recipe((ob.Delays(HISTORY, HISTORY),), True),
}
CHOSEN = "chosen on held-out roll-outs"


def pneumatic(calibrated: bool) -> Callable[[int, int, int], Episodes]:
    """Recordings of the arm in MuJoCo: ``(number, steps, seed) -> episodes``, whose shape is the tip."""

    def made(number: int, steps: int, seed: int) -> Episodes:
        found = record(PneumaticArm(calibrated), number, steps, seed)
        return _of_shape(found, list(range(found.n_states)))

    return made


def disks(number: int, steps: int, seed: int) -> Episodes:
    """Recordings of the robot with disks: positions of six markers."""
    found = disk_robot().record(number, seed, steps, workers=1)
    return _of_shape(found, list((found.outputs or {})["shape"]))


def _of_shape(found: Episodes, columns: list[int]) -> Episodes:
    names = found.state_names
    return Episodes(
        [x[:, columns] for x in found.xs],
        list(found.us),
        found.dt,
        state_names=None if names is None else [names[i] for i in columns],
        input_names=found.input_names,
        quantities=["p"] * len(columns),
        units=["m"] * len(columns),
        outputs={"shape": tuple(range(len(columns)))},
    )


ROBOTS: Mapping[str, Callable[[int, int, int], Episodes]] = {
    "pneumatic arm": pneumatic(False),
    "pneumatic arm, calibrated": pneumatic(True),
    "robot with disks": disks,
}


def main() -> None:
    """Record, fit all recipes to several numbers of recordings, test them, and let held-out roll-outs choose."""
    made = parser((__doc__ or "").splitlines()[0], out="out/recipes")
    made.add_argument("--robots", nargs="+", choices=tuple(ROBOTS), default=list(ROBOTS))
    made.add_argument("--draws", type=int, default=3, help="sets of recordings to learn from, drawn from the pool")
    given = made.parse_args()
    report = Report.of("Recipes of dictionaries", given)
    for robot in given.robots:
        measure(robot, given, report)
    report.write(given.json)


def measure(robot: str, given: argparse.Namespace, report: Report) -> None:
    """All recipes on one robot."""
    pool, test = POOL // 2 if given.quick else POOL, TEST // 2 if given.quick else TEST
    steps = 100 if given.quick else 200
    data = recordings(robot, pool + test, steps, given.seed, given.out)
    known, unseen = data[:pool], data[pool:]
    sizes = (2, pool) if given.quick else (2, 4, pool)
    mean = float(np.median(((unseen.stacked_states() - known.stacked_states().mean(axis=0)) ** 2).sum(axis=1)))
    report.figure(f"{robot}, predicting the mean", mean, "m^2")
    errors: dict[tuple[str, int], list[float]] = {}
    rng = np.random.default_rng(given.seed)
    draws = [rng.permutation(pool) for _ in range(1 if given.quick else given.draws)]
    jobs = [(size, order) for size in sizes for order in (draws[:1] if size == pool else draws)]
    for size, order in tqdm(jobs, desc=robot, unit="set"):
        d1 = known.subset(sorted(order[:size].tolist()))
        held: dict[str, float] = {}
        for name, recipe in RECIPES.items():
            model = recipe.fitted(d1)
            found = rollout_errors(model, _from_history(unseen, model.lifted.n_delays), "shape")
            errors.setdefault((name, size), []).append(found.median if not found.diverged.any() else np.inf)
            held[name] = model.cv_.error
        best = min(held, key=lambda name: held[name])
        errors.setdefault((CHOSEN, size), []).append(errors[best, size][-1])
    print(table(robot, errors, sizes, mean))
    for (name, size), values in errors.items():
        report.figure(
            f"{robot}, {size} recordings, {name}: squared error of roll-outs", float(np.median(values)), "m^2"
        )


def recordings(robot: str, number: int, steps: int, seed: int, folder: Path) -> Episodes:
    """Those of the ``robot``, kept in ``folder``: read where they are there."""
    path = folder / f"{robot.replace(', ', '-').replace(' ', '-')}-{number}x{steps}-seed{seed}.h5"
    if path.exists():
        return Episodes.load(path)
    folder.mkdir(parents=True, exist_ok=True)
    found = ROBOTS[robot](number, steps, seed)
    found.save(path)
    return found


def _from_history(data: Episodes, delays: int) -> Episodes:
    """The same recordings without the steps of history that a model of so many ``delays`` does not need."""
    cut = HISTORY - delays
    return (
        data
        if cut == 0
        else Episodes(
            [x[cut:] for x in data.xs],
            [u[cut:] for u in data.us],
            data.dt,
            **{name: getattr(data, name) for name in ("state_names", "input_names", "quantities", "units", "outputs")},
        )
    )


def table(robot: str, errors: Mapping[tuple[str, int], list[float]], sizes: tuple[int, ...], mean: float) -> str:
    """Medians over draws of median squared errors; "diverges" where half of the draws do."""
    width = max(len(CHOSEN), *map(len, RECIPES))
    lines = [f"{robot}: squared error in m^2 over recordings (predicting the mean: {mean:.1e})"]
    lines.append(f"{'':<{width}}" + "".join(f"{size:>11}" for size in sizes))
    for name in (*RECIPES, CHOSEN):
        medians = [float(np.median(errors[name, size])) for size in sizes]
        lines.append(
            f"{name:<{width}}" + "".join(f"{v:>11.1e}" if np.isfinite(v) else f"{'diverges':>11}" for v in medians)
        )
    return "\n".join(lines)


if __name__ == "__main__":
    run(main)
