"""The constructions and baselines that the ablation compares, each tuned on held-out training episodes."""

from __future__ import annotations

import hashlib
import os
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from arm_scenarios import NOISE, STATIONS, STEPS, Scenario, coordinates, equilibria, excitation, scenarios
from paper_data import DT
from paper_protocol import HELD_OUT, HISTORY, Draw, Lifted, Method, Prediction, Predictor, contiguous

from pisplit import BilinearEDMDc, Dictionary, Episodes, LiftedModel, LinearEDMDc, PIEDMDc, TwinEDMDc
from pisplit import observables as ob
from pisplit.checks import Array
from pisplit.models.arm_physics import ArmPhysics
from pisplit.models.calibrated import TendonParameters
from pisplit.models.calibration import (
    Calibration,
    calibrate_from_equilibria,
    calibrate_from_pairs,
    calibrate_from_shapes,
)
from pisplit.models.equilibrium import EquilibriumTable, equilibrium_table
from pisplit.models.generation import EQUATIONS, make_episodes
from pisplit.models.recordings import calibrate_from_recordings

#: Half width in m of the table of equilibria, in usual displacements.
TABLE_WIDTH = 2.2
#: Softplus width in m of slack features.
SLACK_WIDTH = 1e-4
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
#: Numbers of principal components whose products are columns and of radial functions of the inputs (with slack
#: features), and ridges of the twin's regression: what rolls the twin's last episodes out best is taken, beside the
#: plain fields, which are the safer choice where the twin is wrong.
RICH, PLAIN = ((4, 0, 1e-6), (6, 0, 1e-6), (12, 0, 3e-5), (12, 0, 1e-4), (4, 100, 1e-5)), (0, 0, 1e-5)
#: The fields with delays, which carry what the twin knows nothing of, are a third candidate from so many pairs on.
DELAYS, DELAYED_FROM = 2, 2000
TWIN_HELD_OUT = 6
#: Centres of radial functions are chosen from every seventh input, and there are some for each of them.
THINNED, ROWS_PER_CENTRE = 7, 4
#: Ridges to choose from. With few pairs bilinear models need more than the estimators' own grid has.
RIDGES = tuple(np.logspace(-10, 3, 14).tolist())
#: Weights of the twin to choose from.
TWIN_WEIGHTS = tuple(np.logspace(-6, 4, 6).tolist())
#: Where held-out roll-outs hardly tell weights apart, as noisy ones do, the twin gets the larger one; where they hardly
#: tell dictionaries apart, the smallest is taken.
CV_TOLERANCE = 0.05
#: Strains v of a backbone without shear and stretch are axial forces in the seventh digit: they predict nothing.
OMIT = ("v",)
#: Methods that need the table of equilibria over differential pulls.
TABLED = ("L-EDMDc, rod + x_eq", "B-EDMDc, rod + x_eq", "PI Strang", "PI balanced", "PI hold")


def methods(folder: Path, seed: int, episodes: int = TWIN_EPISODES) -> dict[str, Method]:
    """All methods by name; twins of so many episodes are kept in ``folder``."""
    twin = TwinMethod(folder, seed, episodes, episodes)
    found: dict[str, Callable[[Draw], Predictor]] = {
        "L-EDMDc": Tuned(LinearEDMDc, linear_dictionaries),
        "B-EDMDc": Tuned(BilinearEDMDc, bilinear_dictionaries),
        "L-EDMDc, bounded": Tuned(LinearEDMDc, linear_dictionaries, bounded=True),
        "B-EDMDc, bounded": Tuned(BilinearEDMDc, bilinear_dictionaries, bounded=True),
        "L-EDMDc, rod + x_eq": RodCoordinates(LinearEDMDc, seed),
        "B-EDMDc, rod + x_eq": RodCoordinates(BilinearEDMDc, seed),
        "PI Strang": Splitting("strang", seed),
        "PI balanced": Splitting("balanced", seed),
        "PI hold": Splitting("hold", seed),
        "PI twin": twin,
        "PI twin, no pairs": replace(twin, use_pairs=False),
        "PI twin, tendons from pairs": replace(twin, use_equilibria=False),
    }
    found |= {f"{name}, one recording": OneRecording(found[name]) for name in ("L-EDMDc", "B-EDMDc", "PI twin")}
    return {name: Method(name, fit) for name, fit in found.items()}


# Baselines -----------------------------------------------------------------------------------------------------------


def linear_dictionaries(draw: Draw) -> list[Dictionary]:
    """Fields with 0, 1 or 4 delays, with and without slack features of the inputs."""
    slack = ob.Slack(SLACK_WIDTH)
    return [
        _fields(draw, ob.Delays(states=delays, inputs=1), *extra) for delays in (0, 1, 4) for extra in ((), (slack,))
    ]


def bilinear_dictionaries(draw: Draw) -> list[Dictionary]:
    """Fields with 0 or 1 delays, times the inputs; with and without slack features at 0 delays."""
    return [
        _fields(draw, ob.Delays(inputs=1), ob.Bilinear()),
        _fields(draw, ob.Delays(inputs=1), ob.Slack(SLACK_WIDTH), ob.Bilinear()),
        _fields(draw, ob.Delays(states=1, inputs=1), ob.Bilinear()),
    ]


def _fields(draw: Draw, *extra: Any) -> Dictionary:
    data = draw.episodes
    return Dictionary(ob.Constant(), ob.States(), ob.Inputs(), *extra, n_states=data.n_states, n_inputs=data.n_inputs)


@dataclass(frozen=True)
class Tuned:
    """An estimator with several dictionaries; dictionary and alpha by roll-outs of the held-out episodes.

    ``bounded``: among those that stay bounded under inputs of the scenario's law, as the twin is chosen.
    """

    estimator: Callable[..., Any]
    dictionaries: Callable[[Draw], Sequence[Dictionary]]
    bounded: bool = False

    def __call__(self, draw: Draw) -> Predictor:
        """Fit to the pairs of a draw."""
        small = compact(draw)
        fits = [
            _quietly(
                self.estimator(theta, alpha="cv", alphas=RIDGES, cv_states="shape").fit,
                small.episodes,
                small.pairs(theta.n_delays),
                excitation=excitation(draw.law) if self.bounded else None,
            )
            for theta in self.dictionaries(small)
        ]
        return Lifted(_best(fits).lifted)


@dataclass(frozen=True)
class RodCoordinates:
    """An estimator in rod coordinates with the equilibrium under u as input, read out by exact kinematics."""

    estimator: Callable[..., Any]
    seed: int

    def __call__(self, draw: Draw) -> Predictor:
        """Fit to the pairs of a draw."""
        small, physics = compact(draw), physics_of(draw.law)
        theta = physics.dictionary()
        fit = self.estimator(theta, alpha="cv", alphas=RIDGES, cv_states="shape")
        return Kinematic(_quietly(fit.fit, small.episodes, small.pairs(theta.n_delays)).lifted, physics)


@dataclass(frozen=True)
class Kinematic:
    """Roll-outs of a model in rod coordinates; points and velocity from the coordinates by the rod's kinematics."""

    model: LiftedModel
    physics: ArmPhysics

    def __call__(self, episodes: Episodes, start: int) -> Prediction:
        """Predict steps start + 1 .. end."""
        model, scene = self.model, self.physics.arm.scene
        past, n = start - model.n_delays, scene.n_strains
        z0 = np.stack(
            [model.lift(x[past : start + 1], u[past:start]) for x, u in zip(episodes.xs, episodes.us, strict=True)]
        )
        found = model.rollout(z0, np.stack([u[start:] for u in episodes.us]))
        first = model.column_names.index(scene.coordinates(STATIONS).names[0])
        z = found.z[:, 1:, first : first + 2 * n]
        usable = np.all(np.abs(z) < 1e3 / scene.rod.length * np.repeat([1.0, scene.rod.bending_rate], n), axis=-1)
        late = np.logical_or.accumulate(~usable, axis=1)
        rest = np.tile(self.physics.arm.rest_inputs, (*z.shape[:2], 1))
        state = np.concatenate([np.where(late[..., None], 0.0, z), rest], axis=-1).reshape(-1, scene.n_states)
        fields = scene.fields(state, STATIONS).reshape(*z.shape[:2], STATIONS, 24)
        flagged = np.asarray(found.diverged_at)
        at = np.where(late.any(axis=1), np.argmax(late, axis=1), -1)
        at = np.where((flagged > 0) & ((at < 0) | (flagged - 1 < at)), flagged - 1, at)
        return Prediction(fields[..., :3].reshape(*z.shape[:2], -1), fields[:, :, -1, 18:21], at)


# Physics-informed ----------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Splitting:
    """PIEDMDc in rod coordinates about the equilibrium under u, or plain Strang; ridge, alpha on held-out roll-outs."""

    split: str
    seed: int

    def __call__(self, draw: Draw) -> Predictor:
        """Fit to the pairs and phase-space samples of a draw."""
        small, physics = compact(draw), physics_of(draw.law)
        theta, options = physics.dictionary(), physics.options()
        if self.split == "balanced":
            options = {name: options[name] for name in ("tangent", "equilibrium", "ports")}
        given, alphas = (None, RIDGES) if self.split == "strang" else (options, None)
        fit = PIEDMDc(
            theta, alpha="cv", penalty="ridge", split=self.split, alphas=alphas, cv_states="shape", options=given
        )
        fitted = _quietly(fit.fit, small.episodes, small.d2, small.pairs(theta.n_delays))
        return Kinematic(fitted.lifted, physics)


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
        calibration = self._calibrated(scenario, small)
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
                fits.append(_quietly(fit.fit, small.episodes, twin, pairs, excitation=inputs))
            else:
                fits.append(_quietly(twin_alone, theta, ridge, twin, inputs))
        return Lifted((_best(fits, CV_TOLERANCE) if self.use_pairs else fits[-1]).lifted)

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
                *_errors(scenario)[:2],
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
            part = self.folder / f"{digest}-{os.getpid()}.h5"
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
            os.replace(part, path)
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
    position, rotation, rate = _errors(scenario)
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
            input_error=scenario.backlash / np.sqrt(12.0),  # play that is anywhere
        )
    return _RECORDED[key]


_RECORDED: dict[tuple[str, int, str], Calibration] = {}


def recordings(draw: Draw, scenario: Scenario, count: int) -> tuple[Array, Array]:
    """Fields (N, 6, 144) of the first pairs of a draw with their four steps of history, and displacements (N, 6, m)."""
    fields, moves = [], []
    for episode, k in draw.rows[:count]:
        x = draw.episodes.xs[episode]
        servo = np.vstack([scenario.known.rest_inputs, draw.episodes.us[episode]])  # where it is at every instant
        fields.append(x[k - HISTORY : k + 2])
        moves.append(servo[k - HISTORY : k + 2])
    return np.stack(fields), np.stack(moves)


def _errors(scenario: Scenario) -> tuple[float, float, float]:
    """Standard deviations of positions, frames and rates that a calibration takes; without noise those of the noise."""
    factor = scenario.noise or 1.0
    return factor * NOISE["p"], factor * NOISE["R"], factor * NOISE["rates"]


@lru_cache(maxsize=8)
def _twin_of(path: Path, episodes: int, name: str) -> tuple[Episodes, list[tuple[Dictionary, float]]]:
    """The first episodes of a twin and the dictionaries that suit them."""
    twin = Episodes.load(path)[:episodes]
    return twin, twin_dictionaries(twin, excitation(name))


def twin_dictionaries(twin: Episodes, inputs: Array) -> list[tuple[Dictionary, float]]:
    """The plain dictionary and the rich one that rolls out held-out episodes of the twin best, with their ridges.

    Ridges are raised until models stay bounded under ``inputs`` (E, T, m).
    """
    out = max(1, min(TWIN_HELD_OUT, len(twin) // 4))
    training, held = twin[:-out], twin[-out:]
    found: dict[tuple[int, int, float], tuple[bool, float, float]] = {}
    for number, centres, ridge in RICH:
        if ROWS_PER_CENTRE * centres > len(training.stacked_inputs()[::THINNED]):
            continue
        fit = _quietly(twin_alone, twin_dictionary(training, number, centres), ridge, training, inputs)
        error = np.nan_to_num(fit.score(held, "shape").median, nan=np.inf)
        found[number, centres, ridge] = not fit.bounded_, error, fit.twin_alpha_
    number, centres, _ = best = min(found, key=lambda key: found[key][:2])
    return [
        (twin_dictionary(twin, *PLAIN[:2]), PLAIN[-1]),
        (twin_dictionary(twin, number, centres), found[best][-1]),
    ]


def twin_dictionary(twin: Episodes, number: int, centres: int, delays: int = 0) -> Dictionary:
    """Bilinear dictionary of the fields, with products of principal components and functions of the inputs."""
    inputs: list[Any] = []
    if centres:
        inputs = [ob.Slack(SLACK_WIDTH), ob.Radial.from_data(twin.stacked_inputs()[::THINNED], centres, of="inputs")]
    components = [ob.Principal.of(twin.stacked_states(), number, twin.quantities, OMIT)] if number else []
    return Dictionary(
        ob.Constant(),
        ob.States(),
        *(ob.compose(ob.Polynomials(2), c) for c in components),
        ob.Inputs(),
        ob.Polynomials(2, of="inputs"),
        *inputs,
        ob.Delays(states=delays, inputs=1),
        ob.Bilinear(),
        n_states=twin.n_states,
        n_inputs=twin.n_inputs,
    )


def twin_alone(theta: Dictionary, ridge: float, twin: Episodes, inputs: Array) -> TwinEDMDc:
    """The model of the twin, bounded under ``inputs``: recorded pairs have no weight."""
    return TwinEDMDc(theta, alpha=1e8, twin_alpha=ridge, omit=OMIT).fit(twin[:1], twin, excitation=inputs)


@lru_cache(maxsize=32)
def from_equilibria(name: str, seed: int) -> Calibration:
    """Tendons and bending stiffness of a scenario's arm from its equilibria."""
    scenario = scenarios()[name]
    u, fields = equilibria(name, seed)
    rest = coordinates(scenario.known, fields)
    return calibrate_from_equilibria(scenario.known, u, rest, RESTING, scenario.first_guess)


@lru_cache(maxsize=16)
def physics_of(name: str) -> ArmPhysics:
    """Measured equilibria of the arm, and the backbone as it is known."""
    scenario = scenarios()[name]
    if scenario.law != "zero-sum":
        raise ValueError("the table of equilibria is over differential displacements; this law pulls tendons freely")
    measured: EquilibriumTable = equilibrium_table(scenario.arm, TABLE_WIDTH * scenario.arm.amplitude)
    return ArmPhysics(replace(measured, arm=scenario.known), STATIONS)


# Shared --------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class OneRecording:
    """A method on one contiguous recording of as many steps in place of random pairs."""

    fit: Callable[[Draw], Predictor]

    def __call__(self, draw: Draw) -> Predictor:
        """Fit to a recording of ``len(draw)`` steps."""
        return self.fit(replace(draw, rows=contiguous(draw.episodes, len(draw), draw.seed)))


def compact(draw: Draw) -> Draw:
    """The draw with those episodes only that hold pairs or are held out."""
    used = np.unique(draw.rows[:, 0])
    total = len(draw.episodes)
    kept = [*used.tolist(), *range(total - HELD_OUT, total)]
    rows = np.stack([np.searchsorted(used, draw.rows[:, 0]), draw.rows[:, 1]], axis=1)
    return replace(draw, episodes=draw.episodes.subset(kept), rows=rows)


def _best(fits: Sequence[Any], tolerance: float = 0.0) -> Any:
    """The fit that rolls held-out episodes out best, among those that stay bounded if there are any.

    Of those within ``tolerance`` of the smallest error it is the one with the fewest columns.
    """
    bounded = [fit for fit in fits if fit.bounded_ is not False] or list(fits)
    errors = [float(np.nan_to_num(fit.cv_.error, nan=np.inf)) for fit in bounded]
    level = [fit for fit, error in zip(bounded, errors, strict=True) if error <= (1.0 + tolerance) * min(errors)]
    return min(level, key=lambda fit: fit.theta_.n_columns)


def _quietly(fit: Callable[..., Any], *arguments: Any, **options: Any) -> Any:
    """Fit without warnings: divergence on a grid of alphas is what cross-validation is for."""
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        return fit(*arguments, **options)
