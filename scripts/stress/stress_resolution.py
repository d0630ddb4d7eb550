"""Does the error that an equilibrium carries tell the truth? Estimates beside distances from a fine grid.

Random rolls, sags, dead and follower tip loads, helical tendons and tapered rods, in every strain set, on 4 to 8 nodes;
what fails on either grid is counted and left out. Draws estimates over true errors.
"""

from __future__ import annotations

import os
import sys
import time
import warnings
from dataclasses import dataclass
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # the other rooms of scripts/

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from tqdm import tqdm

from common.drawing import save_figure
from common.report import Report, parser, run
from pisplit.models import rod

LENGTH, RADIUS, YOUNG, DENSITY = 1.0, 0.01, 1e6, 1000.0
EI = YOUNG * np.pi * RADIUS**4 / 4.0
NODES, FINE = (4, 5, 6, 8), 14
#: True errors, in parts of the length, between which the estimate is judged: below is rounding, above no shape.
JUDGED = (1e-9, 0.3)
KINDS = ("roll", "sag", "tip load", "follower", "helix", "taper")
SETS = ("planar", "kirchhoff", "extensible", "cosserat")


@dataclass(frozen=True)
class Case:
    """A kind of scene, its strain set, how hard it is loaded, and in which direction (3,)."""

    kind: str
    strains: str
    load: float
    direction: tuple[float, float, float]

    @classmethod
    def random(cls, rng: np.random.Generator) -> Case:
        """One case."""
        kind = str(rng.choice(KINDS))
        strains = "planar" if kind == "roll" else str(rng.choice(SETS[1:] if kind == "helix" else SETS))
        direction = rng.normal(size=3)
        if strains == "planar":
            direction[1] = 0.0
        x, y, z = (direction / np.linalg.norm(direction)).tolist()
        return cls(kind, strains, float(10.0 ** rng.uniform(-0.5, 0.5)), (x, y, z))

    def scene(self, nodes: int) -> rod.Scene:
        """The scene, without inputs."""
        tapered = rod.Tapered(rod.Circle(RADIUS), rod.Circle(0.2 * RADIUS))
        section = tapered if self.kind == "taper" else rod.Circle(RADIUS)
        body = rod.Rod(LENGTH, section, rod.Elastic(YOUNG, 0.4 * YOUNG, DENSITY), self.strains)
        x, y, z = self.direction
        force = 5.0 * self.load * EI / LENGTH**2
        weight = 3.0 * force / (DENSITY * np.pi * RADIUS**2 * LENGTH)
        terms: dict[str, rod.TipWrench | rod.Gravity | rod.Tendons] = {
            "roll": rod.TipWrench(moment=(0.0, 2.0 * np.pi * 0.5 * self.load * EI / LENGTH, 0.0)),
            "sag": rod.Gravity((weight * x, weight * y, weight * z)),
            "tip load": rod.TipWrench(force=(force * x, force * y, force * z)),
            "follower": rod.TipWrench(force=(0.4 * force * x, 0.4 * force * y, 0.4 * force * z), follower=True),
            "helix": rod.Tendons.helical(0.8 * RADIUS, LENGTH / self.load, (0,), rod.Tension()),
            "taper": rod.Gravity((0.05 * weight * x, 0.05 * weight * y, 0.05 * weight * z)),
        }
        return rod.Scene(body, terms[self.kind], nodes=nodes)

    def inputs(self, scene: rod.Scene) -> np.ndarray:
        """Pull of the tendon."""
        return np.full(scene.n_inputs, 3.0 * EI / (LENGTH * 0.8 * RADIUS))


def judge(case: Case) -> tuple[list[tuple[float, float]], list[float], int]:
    """(estimate, true error) on every number of nodes, CPU seconds of the estimates, and how many shapes failed."""
    fine = case.scene(FINE)
    exact = fine.statics().solve(case.inputs(fine))
    if not exact.success:
        return [], [], len(NODES)
    shape, found, times = fine.fields(exact.state, 20)[:, :3], [], []
    for nodes in NODES:
        scene = case.scene(nodes)
        equilibrium = scene.statics().solve(case.inputs(scene))
        if equilibrium.success:
            true = np.linalg.norm(scene.fields(equilibrium.state, 20)[:, :3] - shape, axis=1).max() / LENGTH
            start = time.process_time()
            found.append((equilibrium.error, float(true)))
            times.append(time.process_time() - start)
    return found, times, len(NODES) - len(found)


def main() -> None:
    """Judge random cases; print quantiles of estimate over true error; draw both."""
    made = parser((__doc__ or "").splitlines()[0], out="out/resolution")
    made.add_argument("--cases", type=int, default=60, metavar="N", help="number of random scenes")
    given = made.parse_args()
    if given.cases < 1:
        made.error(f"--cases {given.cases}; expected at least 1")
    rng, cases = np.random.default_rng(given.seed), min(given.cases, 4) if given.quick else given.cases
    pairs, times, failed = [], [], 0
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", rod.Unresolved)
        for _ in tqdm(range(cases), desc="scenes", unit="scene"):
            found, used, lost = judge(Case.random(rng))
            pairs += found
            times += used
            failed += lost
    errors = np.array(pairs).reshape(-1, 2)
    judged = errors[(errors[:, 1] > JUDGED[0]) & (errors[:, 1] < JUDGED[1])]
    ratio = judged[:, 0] / judged[:, 1]
    report = Report.of("Estimated over true error of shapes at rest", given)
    report.figure("shapes judged", len(judged), "")
    report.figure("shapes that were flagged, not judged", failed, "")
    for name, share in (("smallest", 0.0), ("5 %", 0.05), ("median", 0.5), ("95 %", 0.95), ("largest", 1.0)):
        target = {0.0: (">=", 0.5), 1.0: ("<=", 2.0)}.get(share)
        report.figure(f"estimate / true error, {name}", float(np.quantile(ratio, share)), "", target)
    report.figure("CPU time of an estimate, median", 1e3 * float(np.median(times)), "ms")
    print(report)
    report.write(given.json)
    _draw(judged, given.out)


def _draw(judged: np.ndarray, folder: Path) -> None:
    figure, axes = plt.subplots(figsize=(5, 4.5), layout="constrained")
    ends = np.array([judged.min(), judged.max()])
    axes.loglog(ends, ends, color="0.6", label="equal")
    axes.loglog(judged[:, 1], judged[:, 0], ".", color="#1b9e77", label="shapes at rest")
    axes.set(xlabel="distance from a fine grid, parts of the length", ylabel="estimated error, parts of the length")
    axes.legend()
    save_figure(figure, folder / "resolution.png")
    print(f"picture: {folder / 'resolution.png'}")


if __name__ == "__main__":
    run(main)
