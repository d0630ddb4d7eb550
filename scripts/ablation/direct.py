"""The calibrated arm itself as predictor, with servos whose lag and play are found on held-out recordings."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from ablation.scenarios import STATIONS, equilibria, scenarios
from ablation.shared import compact
from ablation.twin import DAMPING_PAIRS, MOVING, RESTING, errors_of, recordings
from common.data import DT
from common.protocol import HISTORY, Draw, Prediction, Predictor
from pisplit import Episodes
from pisplit.data.actuator import Actuator
from pisplit.models.arm.predictor import ArmPredictor
from pisplit.models.arm.tendon_arm import TendonArm
from pisplit.models.calibration.fit import calibrate_from_shapes
from pisplit.models.calibration.recordings import calibrate_from_recordings

#: Lags in s and plays in m to choose from.
LAGS, PLAYS = (0.0, 0.01, 0.02, 0.03, 0.04, 0.06), (0.0, 1e-4, 2e-4, 3e-4, 4e-4, 6e-4)
#: Steps of the roll-outs that choose, short enough for damping to count little.
CHOOSING = 64


@dataclass(frozen=True)
class DirectMethod:
    """Tendons from shapes at rest, servos by a scan, then everything from recordings behind these servos.

    Of the drawing and the two it is the one that predicts held-out recordings best.
    """

    seed: int

    def __call__(self, draw: Draw) -> Predictor:
        """Calibrate by the pairs of a draw; servos by its held-out recordings."""
        scenario, small = scenarios()[draw.law], compact(draw)
        position, rotation, rate = errors_of(scenario)
        shapes = equilibria(scenario.name, self.seed)
        guess = from_shapes(scenario.name, self.seed)
        servo = _scanned(guess, draw.held_out)
        fields, moves = recordings(small, scenario, min(DAMPING_PAIRS, len(small)), servo)
        try:
            found = calibrate_from_recordings(
                scenario.known,
                fields,
                moves,
                DT,
                position_error=position,
                rotation_error=rotation,
                rate_error=rate,
                free=MOVING,
                start=scenario.first_guess,
                equilibria=shapes,
                input_error=max(servo.play, 1e-5) / np.sqrt(12.0),
            ).arm
        except RuntimeError as error:
            raise ValueError(f"no arm: {error}") from None
        arms = {arm: _cost(arm, servo, draw.held_out) for arm in (scenario.known, guess, found)}
        arm = min(arms, key=lambda a: arms[a])
        return Direct(arm, _scanned(arm, draw.held_out))


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


@lru_cache(maxsize=8)
def from_shapes(name: str, seed: int) -> TendonArm:
    """The drawing of a scenario, with tendons and stiffness from shapes at rest."""
    scenario = scenarios()[name]
    shapes, errors = equilibria(name, seed), errors_of(scenario)
    return calibrate_from_shapes(scenario.known, *shapes, *errors[:2], free=RESTING, start=scenario.first_guess).arm


def _cost(arm: TendonArm, servo: Actuator, held: Episodes) -> float:
    """Mean squared error in m^2 of short roll-outs of held-out recordings, infinite where one fails."""
    cut = [x[: CHOOSING + 1] for x in held.xs], [u[:CHOOSING] for u in held.us]
    short = replace(held, xs=cut[0], us=cut[1], extra=None)
    return ArmPredictor(arm, DT, STATIONS, servo).score(short, start=HISTORY).mean


def _scanned(arm: TendonArm, held: Episodes) -> Actuator:
    """Lag first, then play, then lag again."""
    lag, play = 0.0, 0.0
    for _ in range(2):
        lag = min(LAGS, key=lambda v: _cost(arm, Actuator(lag=v, play=play), held))
        play = min(PLAYS, key=lambda v: _cost(arm, Actuator(lag=lag, play=v), held))
    return Actuator(lag=lag, play=play)
