"""A log as robots leave it: motion capture, servo commands and pressures in files of their own, and what loads of it.

Writes a folder of files of a simulated arm of two joints, with what goes wrong on a bench: a tracker that loses its
markers and stalls, a servo log that is stamped late, millimetres and psi, a decimal comma, a header of several rows.
Loads them, and compares what was loaded with what was simulated.
"""

from __future__ import annotations

import argparse
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from common.report import Report, parser, run
from pisplit import Dictionary, Episodes, LinearEDMDc
from pisplit import observables as ob

Array = NDArray[np.float64]

#: Rate of the cameras [Hz], time between commands [s], how late these are stamped [s].
RATE, HOLD, LATE = 100.0, 0.06, 0.05
FREQUENCY, DAMPING, SUBSTEPS = 9.0, 0.25, 10
#: Names of the file of the cameras, rest position of the tip [m], noise of a marker [m].
TIP, REST, NOISE = ("tip X", "tip Y", "tip Z"), np.array([0.05, -0.03, 0.42]), 1e-4
PSI = 6894.757293168361


@dataclass(frozen=True)
class Truth:
    """What was simulated: times (N,) [s], tip (N, 3) [m], pressures (N, 2) [Pa] at these times."""

    t: Array
    tip: Array
    pressure: Array


def simulated(rng: np.random.Generator, seconds: float) -> Truth:
    """Two joints of second order that follow pressures, which change every 0.06 s."""
    step = 1.0 / RATE
    size = round(seconds * RATE)
    levels = rng.uniform(-1.0, 1.0, (int(seconds / HOLD) + 2, 2))
    q, v, angles = np.zeros(2), np.zeros(2), np.zeros((size, 2))
    commands = levels[(np.arange(size) * step / HOLD + 1e-9).astype(int)]
    for k in range(size):
        angles[k] = q
        for _ in range(SUBSTEPS):
            v = v + step / SUBSTEPS * (FREQUENCY**2 * (commands[k] - q) - 2.0 * DAMPING * FREQUENCY * v)
            q = q + step / SUBSTEPS * v
    tip = REST + np.column_stack([0.08 * angles, 0.02 * (angles[:, 0] - angles[:, 1])])
    return Truth(np.arange(size, dtype=np.float64) * step, tip, 3e4 * commands)


def write(folder: Path, truths: list[Truth], rng: np.random.Generator) -> int:
    """Files of cameras (as Vicon exports them) and of commands, one of each a run; the number of spoilt samples."""
    folder.mkdir(parents=True, exist_ok=True)
    spoilt = 0
    for number, truth in enumerate(truths):
        seen = 1e3 * (truth.tip + NOISE * rng.standard_normal(truth.tip.shape))
        cells = [[f"{value:.3f}" for value in row] for row in seen]
        lost, stuck = (int(rng.integers(100, len(cells) // 2)), int(rng.integers(len(cells) // 2, len(cells) - 100)))
        for k in range(lost, lost + 25):
            cells[k] = ["0.000"] * 3  # the markers were hidden
        for k in range(stuck, stuck + 30):
            cells[k] = cells[stuck]  # the tracker stood still
        for k in rng.integers(10, lost - 10, 3):
            cells[k] = [""] * 3
        spoilt += 25 + 29 + 3
        head = ["Trajectories", f"{RATE:g}", ",,arm:tip,,", "Frame,Sub Frame,X,Y,Z", ",,mm,mm,mm"]
        rows = [f"{k + 1},0,{','.join(row)}" for k, row in enumerate(cells)]
        (folder / f"mocap{number}.csv").write_text("\n".join([*head, *rows]) + "\n", encoding="utf-8")
        new = np.flatnonzero(np.append(True, np.diff(truth.pressure, axis=0).any(axis=1)))
        stamps = 1e3 * (truth.t[new] + 1.0 / RATE + LATE)  # frames count from 1
        sent = [f"{t:.1f};{a / PSI:.6f};{b / PSI:.6f}" for t, (a, b) in zip(stamps, truth.pressure[new], strict=True)]
        text = "\n".join(["Zeit [ms];Druck 1 [psi];Druck 2 [psi]", *sent]).replace(".", ",") + "\n"
        (folder / f"servo{number}.csv").write_bytes(text.encode("utf-16"))
    return spoilt


def load(folder: Path, **options: Any) -> Episodes:
    """The recordings of a folder, in one call."""
    return Episodes.from_csv(
        str(folder / "mocap*.csv"),
        time="Frame",
        states=TIP,
        inputs=["Druck 1", "Druck 2"],
        commands=str(folder / "servo*.csv"),
        command_time="Zeit",
        time_unit=1.0 / RATE,
        **options,
    )


def worst_difference(found: Episodes, truths: list[Truth]) -> float:
    """Largest distance of a loaded tip from the simulated one at its time [m]."""
    origin, worst = found.provenance or {}, 0.0
    for x, start, name in zip(found.xs, origin["starts"], origin["runs"], strict=True):
        first = round(start * RATE) - 1  # frames count from 1
        truth = truths[int(name.removeprefix("mocap").removesuffix(".csv"))].tip[first : first + len(x)]
        worst = max(worst, float(np.linalg.norm(x - truth, axis=1).max()))
    return worst


def main() -> None:
    """Write, load, look, fit; figures beside what was put in."""
    made = parser(__doc__ or "", "out/messy-log")
    given: argparse.Namespace = made.parse_args()
    rng = np.random.default_rng(given.seed)
    truths = [simulated(rng, 6.0 if given.quick else 20.0) for _ in range(3 if given.quick else 6)]
    spoilt = write(given.out, truths, rng)
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        found = load(given.out)
        known = load(given.out, command_shift=-LATE)
    for text in dict.fromkeys(str(w.message) for w in said):
        print(f"warning: {text}")
    print(f"\n{found.report()}\n")
    found.report().plot(given.out / "look.png")
    origin = found.provenance or {}
    theta = Dictionary(ob.Identity(), ob.Delays(2, 2), n_states=3, n_inputs=2)
    report = Report.of("A log as robots leave it", given)
    report.figure("spoilt samples", spoilt, "samples")
    taken = sum(max(names.values()) for names in origin.get("screened", {}).values())
    report.figure("taken for missing", taken, "samples")
    report.figure(
        "largest difference of the tip from the truth", 1e3 * worst_difference(found, truths), "mm", ("<=", 1.0)
    )
    report.figure("delay of the command log found", -1e3 * origin["command_shift"], "ms")
    report.figure("delay of the command log true", 1e3 * LATE, "ms")
    for name, data in (("as found", found), ("as known", known)):
        error = LinearEDMDc(theta, 1e-8).fit(data[: len(data) * 2 // 3]).score(data[len(data) * 2 // 3 :])
        print(f"{name}: {error}")
    report.write(given.json)
    print(f"\n{report}\n\nfiles and picture in {given.out}")


if __name__ == "__main__":
    run(main)
