"""A model for MPC of the calibrated arm: its simulated recordings, learned by a re-lifted model that knows friction."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ablation.direct import kept
from ablation.scenarios import STATIONS, STEPS, excitation, scenarios
from ablation.shared import compact, quietly
from common.data import DT
from common.protocol import Draw, Lifted, Prediction, Predictor
from pisplit import Episodes, LiftedModel, ReliftedEDMDc
from pisplit.checks import Array
from pisplit.data.actuator import Actuator, ActuatorState
from pisplit.estimators.actuator_scan import positions
from pisplit.models.arm.simulated import simulated_recordings
from pisplit.models.arm.twin import OMIT

#: Simulated recordings, and their seed.
SIMULATED, SEED = 64, 7919
#: Structures of re-lifted models to choose from; more components are noise, and higher degrees blow up.
CHOICES: dict[str, Any] = {
    "components": (24,),
    "leading": (4,),
    "degrees": (2,),
    "alphas": (3e-5, 1e-4, 3e-4, 1e-3),
    "cv_folds": 1,
}
#: Recorded pairs from which on a model that learns from them too is a candidate.
POOLED_FROM = 1000
#: The arm is calibrated by so many of the pairs at most: the first ones, which the draws of a seed share.
CALIBRATED = 16


@dataclass(frozen=True)
class SimulatedMethod:
    """Re-lifted models of the calibrated arm, simulated behind its servos, with gates of slip.

    It is calibrated by the first 16 pairs as :class:`ablation.direct.DirectMethod` does it; calibrations and recordings
    are kept in ``folder``. Where many pairs are recorded a model of these and of the simulated ones is another
    candidate: held-out recordings decide.
    """

    folder: Path
    seed: int

    def __call__(self, draw: Draw) -> Predictor:
        """Calibrate by the pairs of a draw, simulate, fit."""
        try:
            few = replace(draw, rows=draw.rows[:CALIBRATED])
            found = kept(few, self.folder, self.seed)
            rest, servo = found.arm.rest_inputs, found.actuator
            path = self.folder / f"{draw.law.replace(' ', '-')}-{len(few)}-{self.seed}-{draw.seed}-simulated.h5"
            told: dict[str, Any] = {"seed": SEED, "path": path, "workers": 1, "progress": False, "actuator": servo}
            twin = simulated_recordings(found.arm, SIMULATED, STEPS, DT, STATIONS, **told)
        except RuntimeError as error:  # no answer is one: it counts as divergence
            raise ValueError(f"no arm: {error}") from None
        small, known = compact(draw), scenarios()[draw.law].known
        data = positions(twin + replace(small.episodes, extra=None).through(servo, rest), Actuator(), rest)
        pairs, simulated = data.pairs(1), len(twin)
        drawn = {(e + simulated, k) for e, k in small.rows.tolist()}
        real = np.array([row in drawn for row in zip(pairs.episode.tolist(), pairs.index.tolist(), strict=True)])
        learned = [pairs.episode < simulated]
        learned += [learned[0] | real] if len(draw) >= POOLED_FROM else []
        start = ActuatorState.at(rest)
        moves = np.stack([servo.simulate(u, DT, start)[0] for u in excitation(draw.law)])
        fits = []
        for rows in learned:  # recordings without pairs are the held-out ones: they choose
            estimator = ReliftedEDMDc(cv_states="shape", omit=OMIT, slip=known.slip(STATIONS), **CHOICES)
            fits.append(quietly(estimator.fit, data, pairs.take(rows), moves))
        chosen = min(fits, key=lambda fit: (fit.bounded_ is False, fit.search_.error))
        return Behind(chosen.lifted, servo, rest)


@dataclass(frozen=True)
class Behind:
    """Roll-outs of a ``model`` of the positions behind a ``servo``, which rests at ``rest`` (m,) at first."""

    model: LiftedModel
    servo: Actuator
    rest: Array

    def __call__(self, episodes: Episodes, start: int) -> Prediction:
        """Predict steps start + 1 .. end."""
        return Lifted(self.model)(episodes.through(self.servo, self.rest), start)
