"""The constructions and baselines that the ablation compares, each tuned on held-out training episodes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from ablation.direct import DirectMethod
from ablation.scenarios import STATIONS, excitation, scenarios
from ablation.shared import best, compact, quietly
from ablation.simulated import SimulatedMethod
from ablation.twin import TWIN_EPISODES, TwinMethod
from common.protocol import Draw, Lifted, Method, Prediction, Predictor, contiguous
from pisplit import BilinearEDMDc, Dictionary, Episodes, LiftedModel, LinearEDMDc, PIEDMDc, ReliftedEDMDc
from pisplit import observables as ob
from pisplit.models.arm.physics import ArmPhysics
from pisplit.models.arm.static_table import EquilibriumTable, equilibrium_table
from pisplit.models.arm.twin import OMIT, SLACK_WIDTH

#: Half width in m of the table of equilibria, in usual displacements.
TABLE_WIDTH = 2.2
#: Ridges to choose from. With few pairs bilinear models need more than the estimators' own grid has.
RIDGES = tuple(np.logspace(-10, 3, 14).tolist())
#: Methods that need the table of equilibria over differential pulls.
TABLED = ("L-EDMDc, rod + x_eq", "B-EDMDc, rod + x_eq", "PI Strang, rod + x_eq", "PI balanced", "PI hold")


def methods(folder: Path, seed: int, episodes: int = TWIN_EPISODES) -> dict[str, Method]:
    """All methods by name; twins of so many episodes are kept in ``folder``."""
    twin = TwinMethod(folder, seed, episodes, episodes)
    found: dict[str, Callable[[Draw], Predictor]] = {
        "L-EDMDc": Tuned(LinearEDMDc, linear_dictionaries),
        "B-EDMDc": Tuned(BilinearEDMDc, bilinear_dictionaries),
        "L-EDMDc, bounded": Tuned(LinearEDMDc, linear_dictionaries, bounded=True),
        "B-EDMDc, bounded": Tuned(BilinearEDMDc, bilinear_dictionaries, bounded=True),
        "re-lifted": relifted,
        "L-EDMDc, rod + x_eq": InRodCoordinates(LinearEDMDc, seed),
        "B-EDMDc, rod + x_eq": InRodCoordinates(BilinearEDMDc, seed),
        "PI Strang, rod + x_eq": Splitting("strang", seed),
        "PI balanced": Splitting("balanced", seed),
        "PI hold": Splitting("hold", seed),
        "PI twin": twin,
        "arm itself": DirectMethod(folder, seed),
        "arm simulated": SimulatedMethod(folder, seed),
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
            quietly(
                self.estimator(theta, alpha="cv", alphas=RIDGES, cv_states="shape").fit,
                small.episodes,
                small.pairs(theta.n_delays),
                excitation=excitation(draw.law) if self.bounded else None,
            )
            for theta in self.dictionaries(small)
        ]
        return Lifted(best(fits).lifted)


def relifted(draw: Draw) -> Predictor:
    """Principal coordinates and their products, evaluated anew at each step: data alone."""
    small = compact(draw)
    estimator = ReliftedEDMDc(cv_states="shape", omit=OMIT)
    return Lifted(quietly(estimator.fit, small.episodes, small.pairs(1), excitation(draw.law)).lifted)


@dataclass(frozen=True)
class InRodCoordinates:
    """An estimator in rod coordinates with the equilibrium under u as input, read out by exact kinematics."""

    estimator: Callable[..., Any]
    seed: int

    def __call__(self, draw: Draw) -> Predictor:
        """Fit to the pairs of a draw."""
        small, physics = compact(draw), physics_of(draw.law)
        theta = physics.dictionary()
        fit = self.estimator(theta, alpha="cv", alphas=RIDGES, cv_states="shape")
        return Kinematic(quietly(fit.fit, small.episodes, small.pairs(theta.n_delays), excitation=None).lifted, physics)


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
        fitted = quietly(fit.fit, small.episodes, small.d2, small.pairs(theta.n_delays))
        return Kinematic(fitted.lifted, physics)


@lru_cache(maxsize=16)
def physics_of(name: str) -> ArmPhysics:
    """Measured equilibria of the arm, and the backbone as it is known; of a foreign arm its drawing."""
    scenario = scenarios()[name]
    if scenario.law != "zero-sum":
        raise ValueError("the table of equilibria is over differential displacements; this law pulls tendons freely")
    if scenario.foreign:
        return ArmPhysics(equilibrium_table(scenario.known, TABLE_WIDTH * scenario.known.amplitude), STATIONS)
    measured: EquilibriumTable = equilibrium_table(scenario.arm, TABLE_WIDTH * scenario.arm.amplitude)
    return ArmPhysics(replace(measured, arm=scenario.known), STATIONS)


@dataclass(frozen=True)
class OneRecording:
    """A method on one contiguous recording of as many steps in place of random pairs."""

    fit: Callable[[Draw], Predictor]

    def __call__(self, draw: Draw) -> Predictor:
        """Fit to a recording of ``len(draw)`` steps."""
        return self.fit(replace(draw, rows=contiguous(draw.episodes, len(draw), draw.seed)))
