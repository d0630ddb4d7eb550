"""From markers to physics: positions of four points, with noise, calibrate an arm, and its equations do the rest.

The drawing of an arm of 0.71 m is wrong: a quarter too stiff, with 40 % of the damping. Cameras see four markers with
0.3 mm of noise, nothing else. Stiffness and damping are calibrated; the predictor rolls out from the markers of the
last instants; all fields are found from the markers, and PI-EDMDc with the hold split is fitted to them. What learns
from the markers without an arm stands beside it.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import time
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from numpy.typing import NDArray

from common.drawing import save_figure
from common.report import Report, parser, run
from pisplit import BilinearEDMDc, Dictionary, Episodes, LinearEDMDc, identify
from pisplit import observables as ob
from pisplit.models.arm import ArmPredictor, MotionCapture, TendonArm, fields_from_markers
from pisplit.models.arm.marker_sight import MarkerSight
from pisplit.models.calibration import calibrate_from_markers, nominal_parameters

matplotlib.use("Agg")
from matplotlib import pyplot as plt
from matplotlib.ticker import NullFormatter

Array = NDArray[np.float64]

#: Stations of the markers in parts of the length, noise of a coordinate [m], time step [s].
MARKERS, NOISE, DT = (0.22, 0.47, 0.78, 1.0), 3e-4, 0.03
#: Stiffness and damping of the drawing, in those of the arm.
STIFF, DAMPED = 1.25, 0.4
RIDGES = tuple(np.logspace(-9, 0, 10).tolist())


def seen(arm: TendonArm, motions: Episodes, capture: MotionCapture, seed: int) -> Episodes:
    """What cameras see of ``motions``."""
    sight, rng, n = MarkerSight(arm.scene, capture), np.random.default_rng(seed), arm.scene.n_strains
    xs = []
    for rows in (motions.extra or {})["state"]:
        exact = np.stack([sight.look(row[: 2 * n])[0] for row in rows])
        xs.append(exact + NOISE * rng.standard_normal(exact.shape))
    return Episodes(xs, motions.us, motions.dt, state_names=capture.names, units=["m"] * capture.n_columns)


def shape_rms(model: Any, test: Episodes, states: Any = None) -> float:
    """Root of the median squared error of a point's position in open-loop roll-outs [m]."""
    return float(np.sqrt(model.score(test, states).median))


def without_an_arm(d1: Episodes) -> dict[str, Any]:
    """Models of the markers alone, with four delays."""
    theta = Dictionary(ob.Constant(), ob.Identity(), ob.Delays(4, 4), n_states=d1.n_states, n_inputs=d1.n_inputs)
    kinds = {"L-EDMDc, 4 delays": LinearEDMDc, "B-EDMDc, 4 delays": BilinearEDMDc}
    return {name: kind(theta, "cv", alphas=RIDGES, cv_tolerance=0.1).fit(d1) for name, kind in kinds.items()}


def draw(errors: dict[str, float], held: tuple[Array, Array, Array], path: Path) -> None:
    """Errors of all models; the tip of a recording that nobody learned from, beside its prediction and its markers."""
    figure, axes = plt.subplots(1, 2, figsize=(12.0, 4.2), constrained_layout=True)
    axes[0].barh(list(errors), [1e3 * e for e in errors.values()], color="tab:blue")
    axes[0].set(xscale="log", xlabel="root of the median squared error of a point (mm)", title="open-loop roll-outs")
    axes[0].xaxis.set_minor_formatter(NullFormatter())
    axes[0].set_xlim(left=0.1)
    axes[0].invert_yaxis()
    markers, true, predicted = held
    t = DT * np.arange(len(true))
    axes[1].plot(t, 1e3 * markers, ".", ms=3.0, color="0.7", label="marker")
    axes[1].plot(t, 1e3 * true, "k", lw=1.0, label="true")
    axes[1].plot(t, 1e3 * predicted, "--", color="tab:red", lw=1.2, label="predicted from the first instants")
    axes[1].set(xlabel="time (s)", ylabel="tip, y (mm)", title="the calibrated arm's prediction")
    figure.legend(loc="outside lower center", ncols=3)
    save_figure(figure, path)


def main() -> None:
    """Record, look with cameras, calibrate, predict, find all fields, fit, compare."""
    given = parser((__doc__ or "").splitlines()[0], "out/markers").parse_args()
    warnings.simplefilter("ignore")
    episodes, steps = (4, 60) if given.quick else (10, 200)
    arm = TendonArm.paper(nodes=4)
    motions = arm.record(episodes, given.seed, steps, DT, workers=1)
    unseen = arm.record(3, given.seed + 1000, steps, DT, workers=1)
    capture = MotionCapture(MARKERS, NOISE, stations_in="L")
    d1, test = seen(arm, motions, capture, given.seed), seen(arm, unseen, capture, given.seed + 1)
    report = Report.of("from markers to physics", given)

    begin = time.process_time()
    first = replace(nominal_parameters(arm), bending=STIFF, damping=DAMPED)
    found = calibrate_from_markers(arm, d1, capture, ("bending", "damping"), first, windows=8, steps=8)
    print(found.report())
    report.figure("calibration, CPU", time.process_time() - begin, "s")
    for e in found.estimates:
        report.figure(
            f"{e.name}, over the true one (drawing {STIFF if e.name == 'bending' else DAMPED:g})", e.value, ""
        )

    errors: dict[str, float] = {}
    predictor = ArmPredictor(found.arm, DT, capture=found.capture)
    errors["predictor from markers"] = float(np.sqrt(predictor.score(test, "shape", start=8).median))

    begin = time.process_time()
    fields = fields_from_markers(found.arm, d1, capture)
    report.figure("all fields from markers, CPU", time.process_time() - begin, "s")
    held = fields_from_markers(found.arm, test, capture)
    at = list((held.outputs or {})["shape"])
    off = np.concatenate([a[:, at] - b[:, at] for a, b in zip(held.xs, unseen.xs, strict=True)])
    report.figure(
        "positions found, RMS of a coordinate", 1e3 * float(np.sqrt((off**2).mean())), "mm", ("<=", 1e3 * NOISE)
    )
    model = identify(fields, arm=found.arm, candidates=["PI-EDMDc, hold"], progress=False)
    errors["PI-EDMDc, hold, fields from markers"] = shape_rms(model, unseen, "shape")
    model = identify(motions, arm=arm, candidates=["PI-EDMDc, hold"], progress=False)
    errors["PI-EDMDc, hold, true arm and fields"] = shape_rms(model, unseen, "shape")
    for name, alone in without_an_arm(d1).items():
        errors[f"{name}, markers alone"] = shape_rms(alone, test)
    for name, value in errors.items():
        report.figure(f"{name}: roll-outs of {DT * steps:g} s", 1e3 * value, "mm")

    y = [n for n in capture.names if "y" in n][-1]
    column, true = capture.names.index(y), (unseen.state_names or ()).index("p_y[6]")
    commands = np.vstack([arm.rest_inputs, unseen.us[0]])
    predicted = predictor.predict(test.xs[0][:9], unseen.us[0][8:], commands[:9])
    draw(errors, (test.xs[0][8:, column], unseen.xs[0][8:, true], predicted[:, column]), given.out / "markers.png")
    report.write(given.json)
    print(f"\n{report}\n\npicture in {given.out}: markers.png")


if __name__ == "__main__":
    run(main)
