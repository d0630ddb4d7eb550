"""The calibrated arm itself as predictor: its servos with it, the form of its tendons by held-out roll-outs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ablation.scenarios import STATIONS, Scenario, equilibria, scenarios
from ablation.shared import compact
from ablation.twin import DAMPING_PAIRS, MOVING, errors_of
from common.data import DT
from common.protocol import HISTORY, Draw, Prediction, Predictor
from pisplit import Episodes
from pisplit.checks import Array
from pisplit.data.actuator import Actuator
from pisplit.models import rod
from pisplit.models.arm.disk_robot import PRESETS
from pisplit.models.arm.predictor import ArmPredictor
from pisplit.models.arm.tendon_arm import TendonArm
from pisplit.models.calibration import Calibration, CalibrationError, calibrate_from_recordings

#: Disks of an arm on which nobody has counted them.
DISKS = 8
#: First guess of servos, of friction and of the speed over which it turns round, and error of displacements in m.
SERVO, FRICTION, SLIP_SPEED, LATE = Actuator(lag=0.015, play=1.5e-4), 0.05, 5e-3, 1e-4
#: What is identified: points of the tendons at the tip are those at the base, unless a form is along the backbone.
FREE = (*(name for name in MOVING if name != "routing"), "friction", "lag", "play")
#: Steps of the roll-outs that choose.
CHOOSING = 64


@dataclass(frozen=True)
class DirectMethod:
    """Everything from windows of recordings and from shapes at rest, for every form of the tendons.

    Of the drawing and what was identified it is the one that predicts held-out recordings best.
    """

    seed: int

    def __call__(self, draw: Draw) -> Predictor:
        """Calibrate by the pairs of a draw; the form by its held-out recordings."""
        scenario, small = scenarios()[draw.law], compact(draw)
        found: dict[TendonArm, Actuator] = {scenario.known: Actuator()}
        for disks in forms(draw.law):
            try:
                fit = calibrated(scenario, small, self.seed, disks)
            except CalibrationError as error:
                fit = error.calibration  # held-out roll-outs tell what it is worth
            except RuntimeError:
                continue
            found[fit.arm] = fit.actuator
        costs = {arm: cost(arm, servo, draw.held_out) for arm, servo in found.items()}
        arm = min(costs, key=lambda a: costs[a])
        if not np.isfinite(costs[arm]):
            raise ValueError("no arm: none of the forms predicts the held-out recordings")
        return Direct(arm, found[arm])


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


def calibrated(scenario: Scenario, draw: Draw, seed: int, disks: int | None) -> Calibration:
    """The arm of a scenario with tendons over ``disks`` from the first pairs of a draw with their histories."""
    position, rotation, rate = errors_of(scenario)
    fields, logs = windows(draw, scenario, min(DAMPING_PAIRS, len(draw)))
    return calibrate_from_recordings(
        over_disks(scenario.known, disks),
        fields,
        logs,
        DT,
        position_error=position,
        rotation_error=rotation,
        rate_error=rate,
        free=FREE,
        start=replace(scenario.first_guess, friction=FRICTION, slip_speed=SLIP_SPEED),
        equilibria=equilibria(scenario.name, seed),
        input_error=LATE,
        actuator=SERVO,
    )


def over_disks(arm: TendonArm, disks: int | None) -> TendonArm:
    """The drawn ``arm`` with its tendons over so many ``disks``."""
    drawn = arm.tendons
    assert isinstance(drawn, rod.Tendons)
    terms = [replace(drawn, disks=disks) if term is drawn else term for term in arm.scene.terms]
    return replace(arm, scene=rod.Scene(arm.scene.rod, *terms, nodes=arm.scene.nodes))


def windows(draw: Draw, scenario: Scenario, count: int) -> tuple[Array, Sequence[Array]]:
    """Fields (N, 6, 144) of the first pairs of a draw with their four steps of history; all commands up to each."""
    fields, logs = [], []
    for episode, k in draw.rows[:count]:
        fields.append(draw.episodes.xs[episode][k - HISTORY : k + 2])
        logs.append(np.vstack([scenario.known.rest_inputs, draw.episodes.us[episode][: k + 1]]))
    return np.stack(fields), logs


def cost(arm: TendonArm, servo: Actuator, held: Episodes) -> float:
    """Mean squared error in m^2 of short roll-outs of held-out recordings, infinite where one fails."""
    cut = [x[: CHOOSING + 1] for x in held.xs], [u[:CHOOSING] for u in held.us]
    short = replace(held, xs=cut[0], us=cut[1], extra=None)
    return ArmPredictor(arm, DT, STATIONS, servo).score(short, start=HISTORY).mean
