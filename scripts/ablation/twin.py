"""The physical twin of the ablation: what is identified from a draw, its episodes, the dictionaries that suit it."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

from ablation.scenarios import NOISE, STEPS, Scenario, coordinates, equilibria, excitation, scenarios
from ablation.shared import best, compact, quietly
from common.data import DT
from common.protocol import HISTORY, Draw, Lifted, Predictor
from pisplit import Dictionary, Episodes, TwinEDMDc
from pisplit.checks import Array
from pisplit.data.actuator import Actuator
from pisplit.files import replacing
from pisplit.models.arm.recording import EQUATIONS, NO_ACTUATOR, make_episodes
from pisplit.models.arm.twin import OMIT, PLAIN, twin_alone, twin_dictionaries, twin_dictionary
from pisplit.models.calibration.fit import (
    Calibration,
    calibrate_from_equilibria,
    calibrate_from_pairs,
    calibrate_from_shapes,
)
from pisplit.models.calibration.parameters import TendonParameters
from pisplit.models.calibration.recordings import calibrate_from_recordings

#: Episodes that a twin is rolled out for, and their seed.
TWIN_EPISODES, TWIN_SEED = 96, 1_000_003
#: Pairs that damping, or all of the arm, is identified from, and the step of the logarithm of damping: equal factors
#: share a twin.
DAMPING_PAIRS, DAMPING_STEP = 24, 0.02
#: Residual of the balance of forces in measured equilibria, in parts of EI/L, below which it is the way to tendons.
BALANCED = 1e-3
#: What is identified at rest, and in motion.
RESTING = ("tendons", "routing", "bending", "load")
MOVING = (*RESTING, "damping")
#: Pairs that tendons are identified from when no equilibria are known.
TENDON_PAIRS = 16
#: The fields with delays, which carry what the twin knows nothing of, are a third candidate from so many pairs on.
DELAYS, DELAYED_FROM = 2, 2000
#: Weights of the twin to choose from.
TWIN_WEIGHTS = tuple(np.logspace(-6, 4, 6).tolist())
#: Where held-out roll-outs hardly tell weights apart, as noisy ones do, the twin gets the larger one; where they hardly
#: tell dictionaries apart, the smallest is taken.
CV_TOLERANCE = 0.05


@dataclass(frozen=True)
class TwinMethod:
    """Tendons from equilibria (or pairs), damping from pairs, a twin rolled out, then TwinEDMDc on twin and pairs.

    use_pairs        without them the twin has the damping it was told of, and the model is EDMDc on the twin
    use_equilibria   without them tendons are identified from pairs
    simulated        episodes of the twin, and how many of them are used
    """

    folder: Path
    seed: int
    simulated: int = TWIN_EPISODES
    episodes: int = TWIN_EPISODES
    use_pairs: bool = True
    use_equilibria: bool = True

    def __call__(self, draw: Draw) -> Predictor:
        """Fit to the pairs of a draw."""
        scenario, small = scenarios()[draw.law], compact(draw)
        try:
            calibration = self._calibrated(scenario, small)
        except RuntimeError as error:  # no answer is one: it counts as divergence
            raise ValueError(f"no twin: {error}") from None
        twin, dictionaries = _twin_of(self._simulated(calibration, scenario), self.episodes, scenario.name)
        inputs = excitation(scenario.name)
        fits = []
        if self.use_pairs and len(draw) >= DELAYED_FROM:
            dictionaries = [*dictionaries, (twin_dictionary(twin, 0, 0, DELAYS), PLAIN[-1])]
        for theta, ridge in dictionaries:
            if self.use_pairs:
                fit = TwinEDMDc(
                    theta, "cv", ridge, omit=OMIT, alphas=TWIN_WEIGHTS, cv_states="shape", cv_tolerance=CV_TOLERANCE
                )
                pairs = small.pairs(theta.n_delays)
                fits.append(quietly(fit.fit, small.episodes, twin, pairs, excitation=inputs))
            else:
                fits.append(quietly(twin_alone, theta, ridge, twin, inputs))
        return Lifted((best(fits, CV_TOLERANCE) if self.use_pairs else fits[-1]).lifted)

    def _calibrated(self, scenario: Scenario, draw: Draw) -> Calibration:
        """The arm by what is known of it.

        Where measured equilibria balance, forces are exact: tendons from them, damping from one-step predictions. Where
        they do not, for noise or a wrong form of the model, everything from what the arm looks like.
        """
        if not self.use_equilibria:
            return from_pairs(scenario, draw, TENDON_PAIRS, ("tendons", "bending", "damping"), scenario.first_guess)
        resting = from_equilibria(scenario.name, self.seed)
        if resting.residual <= BALANCED:
            if not self.use_pairs:
                return resting
            found = from_pairs(scenario, draw, DAMPING_PAIRS, ("damping",), resting.parameters)
            steps = np.round(np.log(found.parameters.damping) / DAMPING_STEP)
            return resting.with_damping(float(np.exp(DAMPING_STEP * steps)))
        if not self.use_pairs:
            return calibrate_from_shapes(
                scenario.known,
                *equilibria(scenario.name, self.seed),
                *errors_of(scenario)[:2],
                free=RESTING,
                start=scenario.first_guess,
            )
        return from_recordings(scenario, draw, self.seed)

    def _simulated(self, calibration: Calibration, scenario: Scenario) -> Path:
        """File of the twin's episodes."""
        made_of = (calibration.arm.scene.terms, scenario.law, EQUATIONS, self.simulated)
        digest = hashlib.sha256(repr(made_of).encode()).hexdigest()[:16]
        path = self.folder / f"{digest}.h5"
        if not path.exists():
            with replacing(path, make_folders=True) as part:
                make_episodes(
                    calibration.arm,
                    part,
                    self.simulated,
                    STEPS,
                    DT,
                    seed=TWIN_SEED,
                    workers=1,
                    progress=False,
                    law=scenario.law,
                    compiled=True,
                )
        return path


def from_pairs(scenario: Scenario, draw: Draw, count: int, free: Sequence[str], start: TendonParameters) -> Calibration:
    """Identification from the first pairs of a draw."""
    pairs = draw.pairs(1).take(np.arange(min(count, len(draw))))
    before, after = (coordinates(scenario.known, x) for x in (pairs.x, pairs.x_next))
    inputs = np.stack([pairs.u_history[:, -1], pairs.u], axis=1)
    return calibrate_from_pairs(scenario.known, before, after, inputs, DT, free, start)


def from_recordings(scenario: Scenario, draw: Draw, seed: int) -> Calibration:
    """Identification of everything from the first pairs of a draw with their history, and from equilibria."""
    fields, moves = recordings(draw, scenario, min(DAMPING_PAIRS, len(draw)))
    key = (scenario.name, seed, hashlib.sha256(fields.tobytes()).hexdigest())
    position, rotation, rate = errors_of(scenario)
    if key not in _RECORDED:  # larger draws of a seed begin with the same pairs
        _RECORDED[key] = calibrate_from_recordings(
            scenario.known,
            fields,
            moves,
            DT,
            position_error=position,
            rotation_error=rotation,
            rate_error=rate,
            free=MOVING,
            start=scenario.first_guess,
            equilibria=equilibria(scenario.name, seed),
            input_error=scenario.actuator.play / np.sqrt(12.0),  # play that is anywhere
        )
    return _RECORDED[key]


_RECORDED: dict[tuple[str, int, str], Calibration] = {}


def recordings(draw: Draw, scenario: Scenario, count: int, actuator: Actuator = NO_ACTUATOR) -> tuple[Array, Array]:
    """Fields (N, 6, 144) of the first pairs of a draw with their four steps of history, and displacements (N, 6, m).

    ``actuator``: servos that stand between commands and displacements.
    """
    fields, moves = [], []
    served = draw.episodes.through(actuator, scenario.known.rest_inputs).us
    for episode, k in draw.rows[:count]:
        x = draw.episodes.xs[episode]
        servo = np.vstack([scenario.known.rest_inputs, served[episode]])  # where it is at every instant
        fields.append(x[k - HISTORY : k + 2])
        moves.append(servo[k - HISTORY : k + 2])
    return np.stack(fields), np.stack(moves)


def errors_of(scenario: Scenario) -> tuple[float, float, float]:
    """Standard deviations of positions, frames and rates that a calibration takes; without noise those of the noise."""
    factor = scenario.noise or 1.0
    return factor * NOISE["p"], factor * NOISE["R"], factor * NOISE["rates"]


@lru_cache(maxsize=8)
def _twin_of(path: Path, episodes: int, name: str) -> tuple[Episodes, list[tuple[Dictionary, float]]]:
    """The first episodes of a twin and the dictionaries that suit them."""
    twin = Episodes.load(path)[:episodes]
    return twin, twin_dictionaries(twin, excitation(name))


@lru_cache(maxsize=32)
def from_equilibria(name: str, seed: int) -> Calibration:
    """Tendons and bending stiffness of a scenario's arm from its equilibria."""
    scenario = scenarios()[name]
    u, fields = equilibria(name, seed)
    rest = coordinates(scenario.known, fields)
    return calibrate_from_equilibria(scenario.known, u, rest, RESTING, scenario.first_guess)
