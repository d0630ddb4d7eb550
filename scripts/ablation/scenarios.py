"""What the ablation is run on: arms, input laws, noise, and what the methods are told of the arm (right or wrong)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from common.data import DT, PaperData
from pisplit import Episodes, PhaseSamples
from pisplit.checks import Array
from pisplit.data.actuator import Actuator
from pisplit.models import rod
from pisplit.models.arm.disk_robot import PRESETS, disk_robot
from pisplit.models.arm.phase_samples import deviations_from_equilibrium, make_phase_samples, phase_origin
from pisplit.models.arm.recording import (
    NO_ACTUATOR,
    check_origin,
    episodes_origin,
    make_episodes,
    random_displacements,
    random_targets,
)
from pisplit.models.arm.resting import turned
from pisplit.models.arm.tendon_arm import TendonArm
from pisplit.models.calibration.fit import nominal_parameters
from pisplit.models.calibration.parameters import TendonParameters

STEPS, STATIONS = 200, 6
#: Scenarios of the other robot begin with this, and a preset follows.
OTHER_ROBOT = "other robot"
#: Phase-space samples for the splits that average over D2.
PHASE_SAMPLES = 2000
#: Equilibria of the actuated arm that methods may know; their seed differs from those of the trajectories.
EQUILIBRIA, EQUILIBRIA_SEED = 16, 4711
#: Displacements of a scenario's law that a model has to stay bounded under, twice as long as the recordings: how many
#: sequences, and their seed. Nobody records what the arm does under them.
EXCITATIONS, EXCITATION_STEPS, EXCITATION_SEED = 64, 2 * STEPS, 2_000_003
#: Noise: positions in m, rotations in rad, velocities and curvatures as parts of their deviation.
NOISE = {"p": 1e-3, "R": np.deg2rad(1.0), "rates": 0.05}
#: Further levels of noise, as factors of it.
NOISE_CURVE = {"noise, a quarter": 0.25, "noise, half": 0.5, "noise, twice": 2.0, "noise, four times": 4.0}


@dataclass(frozen=True)
class Scenario:
    """An arm, how it is moved and measured, and what is known of it.

    arm     the arm that moves
    known   the arm that methods are told of: its backbone is f; its tendons are where a drawing has them
    law     input law
    noise   factor of ``NOISE`` on training states and equilibria
    actuator   servos between commands and tendons: hysteresis
    foreign    whether the arm that moves is unlike what is known of it: moved by IDAS, its states seen by fields alone
    data    name of the scenario whose recordings these are, before noise: its own, or one of the same arm
    """

    name: str
    arm: TendonArm
    known: TendonArm
    law: str = "zero-sum"
    noise: float = 0.0
    actuator: Actuator = NO_ACTUATOR
    foreign: bool = False
    data: str = ""

    @property
    def method(self) -> str:
        """What moves the arm."""
        return "idas" if self.foreign else "fast"

    @property
    def modelled(self) -> TendonArm:
        """The arm whose equilibria stand for the states about which phase samples lie."""
        return self.known if self.foreign else self.arm

    @property
    def first_guess(self) -> TendonParameters:
        """Tendons as a drawing may have them: turned by 8 degrees, 15 % too far out, half as stiff, 0.5 mm too long."""
        told = nominal_parameters(self.known)
        turn = Rotation.from_euler("z", 8.0, degrees=True).as_matrix()[:2, :2]
        return replace(
            told, offset=1.15 * told.offset @ turn.T, stiffness=0.5 * told.stiffness, slack=told.slack + 5e-4
        )


@dataclass(frozen=True)
class ScenarioSource:
    """Data of a scenario in files of ``folder``: training and test episodes."""

    scenario: Scenario
    folder: Path
    training: int
    test: int
    seed: int
    workers: int = -1
    progress: bool = True

    def load_or_make(self) -> PaperData:
        """Training with the scenario's noise, test without."""
        scenario, total = self.scenario, self.training + self.test
        clean = self._episodes(total)
        training, test = clean[: self.training], clean[self.training :]
        d2 = self._samples(training[:8])
        return PaperData(scenario.law, noisy(training, scenario.noise, self.seed), test, d2)

    def _samples(self, training: Episodes) -> PhaseSamples:
        scenario = self.scenario
        path = self.folder / f"d2-{scenario.name.replace(' ', '-')}-seed{self.seed}-{PHASE_SAMPLES}.h5"
        if scenario.foreign:
            deviations, rates = _seen(scenario.known, training)
        else:
            deviations, rates = deviations_from_equilibrium(scenario.arm, training)
        if path.exists():
            found = PhaseSamples.load(path)
            known = scenario.known.passive
            origin = phase_origin(
                scenario.modelled, rates, seed=self.seed, law=scenario.law, deviations=deviations, known=known
            )
            check_origin(path, found.provenance, origin)
            return found
        return make_phase_samples(
            scenario.modelled,
            path,
            PHASE_SAMPLES,
            rates,
            deviations,
            seed=self.seed,
            workers=self.workers,
            progress=False,
            law=scenario.law,
            known=scenario.known.passive,
        )

    def _episodes(self, total: int) -> Episodes:
        scenario = self.scenario
        name = (scenario.data or scenario.name).replace(" ", "-")
        path = self.folder / f"d1-{name}-seed{self.seed}-{total}x{STEPS}.h5"
        if path.exists():
            found = Episodes.load(path)
            origin = episodes_origin(
                scenario.arm,
                STEPS,
                DT,
                seed=self.seed,
                law=scenario.law,
                actuator=scenario.actuator,
                method=scenario.method,
            )
            check_origin(path, found.provenance, origin)
            return found
        return make_episodes(
            scenario.arm,
            path,
            total,
            STEPS,
            DT,
            seed=self.seed,
            workers=self.workers,
            progress=self.progress,
            law=scenario.law,
            compiled=True,
            actuator=scenario.actuator,
            method=scenario.method,
        )


def scenarios() -> dict[str, Scenario]:
    """All scenarios by name."""
    paper, soft = TendonArm.paper(), TendonArm.prototype()
    same = "paper arm"
    found = [
        Scenario(same, paper, paper),
        Scenario("independent pulls", paper, paper, law="independent"),
        Scenario("prototype arm", soft, soft),
        Scenario("noise", paper, paper, noise=1.0, data=same),
        *(Scenario(name, paper, paper, noise=factor, data=same) for name, factor in NOISE_CURVE.items()),
        Scenario("E 20 % too high", paper, _wrong(paper, young=1.2), data=same),
        Scenario("E 20 % too low", paper, _wrong(paper, young=0.8), data=same),
        Scenario("damping twice", paper, _wrong(paper, damping=2.0), data=same),
        Scenario("damping half", paper, _wrong(paper, damping=0.5), data=same),
        Scenario("capstan friction", _with_friction(paper, 0.2), paper),
        Scenario("backlash", paper, paper, actuator=Actuator(play=5e-4)),
        Scenario("routing error", _with_twist(paper, 20.0), paper),
        Scenario("tip load", _with_tip_load(paper, 0.01), paper),
        *(_other_robot(preset) for preset in PRESETS),
    ]
    return {scenario.name: scenario for scenario in found}


def noisy(episodes: Episodes, factor: float, seed: int) -> Episodes:
    """Episodes whose measured states carry ``factor`` times ``NOISE``; inputs are what they are."""
    if factor == 0.0:
        return episodes
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(7,)))
    groups = {q: np.array([i for i, label in enumerate(episodes.quantities or ()) if label == q]) for q in "pRwq"}
    groups["omega"] = np.array([i for i, label in enumerate(episodes.quantities or ()) if label == "omega"])
    states = episodes.stacked_states()
    spread = {q: float(np.sqrt(np.mean(states[:, i].std(axis=0) ** 2))) for q, i in groups.items()}
    changed = []
    for x in episodes.xs:
        y = x.copy()
        y[:, groups["p"]] += factor * NOISE["p"] * rng.standard_normal((len(x), len(groups["p"])))
        frames = x[:, groups["R"]].reshape(len(x), STATIONS, 9)
        y[:, groups["R"]] = turned(frames, factor * NOISE["R"], rng).reshape(len(x), -1)
        for q in ("w", "q", "omega"):
            y[:, groups[q]] += factor * NOISE["rates"] * spread[q] * rng.standard_normal((len(x), len(groups[q])))
        changed.append(y)
    return replace(episodes, xs=changed)


@lru_cache(maxsize=16)
def equilibria(name: str, seed: int) -> tuple[Array, Array]:
    """Displacements (16, m) in m and measured fields (16, 24 S) of the arm of a scenario at rest."""
    scenario = scenarios()[name]
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(EQUILIBRIA_SEED,)))
    u = random_targets(scenario.arm, EQUILIBRIA, rng, scenario.law)
    late = 0.5 * scenario.actuator.play * rng.uniform(-1.0, 1.0, size=u.shape)  # the play is used up in part
    solved = scenario.arm.scene.statics().solve_many(u + late)
    u, states = u[solved.success], solved.states[solved.success]
    fields = scenario.arm.scene.fields(states, STATIONS).reshape(len(u), -1)
    found = scenario.arm.scene.field_map(STATIONS)
    still = Episodes([fields], [u[1:]], DT, quantities=found.quantities)
    return u, noisy(still, scenario.noise, seed + 1).xs[0]


@lru_cache(maxsize=16)
def excitation(name: str) -> Array:
    """Displacements (64, 400, m) in m that the arm of a scenario is meant for."""
    scenario, rng = scenarios()[name], np.random.default_rng(EXCITATION_SEED)
    moves = [random_displacements(scenario.known, EXCITATION_STEPS, rng, scenario.law) for _ in range(EXCITATIONS)]
    return np.stack(moves)


def coordinates(arm: TendonArm, fields: Array) -> Array:
    """Rod coordinates (N, 2n) of measured fields (N, 24 S)."""
    function = arm.scene.coordinates(STATIONS).function
    return np.asarray(function.map(len(fields))(np.asarray(fields).T)).T


def _other_robot(preset: int) -> Scenario:
    """A robot with disks, friction, lag, play and noise, and its drawing."""
    robot = disk_robot(preset)
    name = f"{OTHER_ROBOT} {preset}"
    return Scenario(name, robot.arm, robot.drawing, noise=0.25, actuator=robot.actuator, foreign=True)


def _seen(arm: TendonArm, episodes: Episodes) -> tuple[Array, Array]:
    """Strains minus those of the drawn ``arm`` at rest under the commands, and strain rates, from measured fields."""
    n = arm.scene.n_strains
    x = np.concatenate([x[1:] for x in episodes.xs])
    found = coordinates(arm, x)
    rest = arm.scene.statics().solve_many(np.concatenate(list(episodes.us)))
    kept = rest.success
    return found[kept, :n] - rest.states[kept, :n], found[:, n:]


def _wrong(arm: TendonArm, young: float = 1.0, damping: float = 1.0) -> TendonArm:
    """The arm with another modulus and other material damping of its backbone."""
    scene = arm.scene
    material = scene.rod.material
    assert isinstance(material, rod.Elastic)
    body = replace(scene.rod, material=replace(material, young=young * material.young, shear=young * material.shear))
    terms = [
        rod.KelvinVoigt(bending=damping * t.bending, torsion=damping * t.torsion)
        if isinstance(t, rod.KelvinVoigt)
        else t
        for t in scene.terms
    ]
    return replace(arm, scene=rod.Scene(body, *terms, nodes=scene.nodes))


def _with_friction(arm: TendonArm, mu: float) -> TendonArm:
    """The arm with capstan friction in its tendons."""
    terms = [replace(t, friction=mu) if isinstance(t, rod.Tendons) else t for t in arm.scene.terms]
    return replace(arm, scene=rod.Scene(arm.scene.rod, *terms, nodes=arm.scene.nodes))


def _with_twist(arm: TendonArm, degrees: float) -> TendonArm:
    """The arm with tendons that turn about the backbone by so much over its length."""
    rod_of = arm.scene.rod
    term = next(t for t in arm.scene.terms if isinstance(t, rod.Tendons))
    x, y = np.array(term.offsets, dtype=float).T
    turned = rod.Tendons.helical(
        offset=float(np.hypot(x, y).mean()),
        pitch=rod_of.length * 360.0 / degrees,
        angles_deg=np.rad2deg(np.arctan2(y, x)).tolist(),
        drive=term.drive,
        name=term.name,
    )
    terms = [turned if t is term else t for t in arm.scene.terms]
    return replace(arm, scene=rod.Scene(rod_of, *terms, nodes=arm.scene.nodes))


def _with_tip_load(arm: TendonArm, mass: float) -> TendonArm:
    """The arm with a mass in kg at its tip that nobody is told of."""
    return replace(arm, scene=arm.scene + rod.PointMass(arm.scene.rod.length, mass))
