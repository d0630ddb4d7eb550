"""The calibrated arm itself as predictor: form of its tendons and groups of its parameters by held-out roll-outs."""

from __future__ import annotations

import pickle
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ablation.scenarios import STATIONS, equilibria, scenarios
from ablation.shared import compact
from ablation.twin import errors_of
from common.data import DT
from common.protocol import HELD_OUT, HISTORY, Draw, Prediction, Predictor
from pisplit import Episodes
from pisplit.data.actuator import Actuator
from pisplit.files import replacing
from pisplit.models.arm.disk_robot import PRESETS
from pisplit.models.arm.predictor import ArmPredictor
from pisplit.models.arm.resting import RestShapes
from pisplit.models.arm.tendon_arm import TendonArm
from pisplit.models.calibration import CalibrationChoice, choose_calibration

#: Disks of an arm on which nobody has counted them.
DISKS = 8


@dataclass(frozen=True)
class DirectMethod:
    """Everything from windows of recordings and from shapes at rest, for every form of the tendons.

    Form and groups of parameters are those that predict held-out recordings best (``choose_calibration``). Calibrations
    are kept in ``folder``: those of a draw serve other methods too.
    """

    folder: Path
    seed: int

    def __call__(self, draw: Draw) -> Predictor:
        """Calibrate by the pairs of a draw; form and groups by its held-out recordings."""
        try:
            found = kept(draw, self.folder, self.seed)
        except RuntimeError as error:  # no answer is one: it counts as divergence
            raise ValueError(f"no arm: {error}") from None
        return Direct(found.arm, found.actuator)


def kept(draw: Draw, folder: Path, seed: int) -> CalibrationChoice:
    """The calibration of a draw, read from ``folder`` where it was made before."""
    path = folder / f"{draw.law.replace(' ', '-')}-{len(draw)}-{seed}-{draw.seed}.pkl"
    if not path.exists():
        found = chosen(draw, seed)
        with replacing(path) as part:
            part.write_bytes(pickle.dumps(found))
    return pickle.loads(path.read_bytes())


def chosen(draw: Draw, seed: int) -> CalibrationChoice:
    """The calibration of a draw: its pairs with their histories are learned from, held-out recordings decide.

    Nobody has told of servos, friction or loads; disks can be counted.
    """
    scenario, small = scenarios()[draw.law], compact(draw)
    position, rotation, rate = errors_of(scenario)
    inputs, fields = equilibria(scenario.name, seed)
    spans = [(e, k - HISTORY, k + 1) for e, k in small.rows.tolist()]
    return choose_calibration(
        scenario.known,
        small.episodes[:-HELD_OUT],
        RestShapes(inputs, fields, position, rotation),
        small.held_out,
        disks=forms(draw.law),
        spans=spans,
        rate_error=rate,
        start=scenario.first_guess,
        progress=False,
    )


@dataclass(frozen=True)
class Direct:
    """Roll-outs of an arm behind its servos."""

    arm: TendonArm
    servo: Actuator

    def __call__(self, episodes: Episodes, start: int) -> Prediction:
        """Predict steps start + 1 .. end."""
        ahead = ArmPredictor(self.arm, DT, STATIONS, self.servo)
        steps = len(episodes.us[0]) - start
        shape, tip = (np.array(ahead.outputs[name]) for name in ("shape", "tip_velocity"))
        points = np.zeros((len(episodes), steps, len(shape)))
        velocity, at = np.zeros((len(episodes), steps, len(tip))), np.full(len(episodes), -1)
        for e, (x, u) in enumerate(zip(episodes.xs, episodes.us, strict=True)):
            found = ahead.predict(x[start], u[start:], np.vstack([self.arm.rest_inputs, u[:start]]))[1:]
            points[e, : len(found)], velocity[e, : len(found)] = found[:, shape], found[:, tip]
            if len(found) < steps:
                at[e] = len(found)
        return Prediction(points, velocity, at)


def forms(name: str) -> tuple[int | None, ...]:
    """Forms of the tendons that are tried: along the backbone, and over disks, which can be counted on a robot.

    Which of them it is, held-out recordings say.
    """
    kind, _, number = name.rpartition(" ")
    return None, PRESETS[int(number)][0] if kind == "other robot" else DISKS
