"""Data of an arm with tendons: trajectories (D1) and phase-space samples of its passive part (D2)."""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from pisplit import Episodes, PhaseSamples
from pisplit.checks import Array, count, finite_array, one_of, positive
from pisplit.data.actuator import Actuator, ActuatorState
from pisplit.models import rod
from pisplit.models.arm.base import Arm
from pisplit.models.arm.blocks import Block, discard_blocks, run_blocks
from pisplit.models.rod.analysis.fields import UNITS, Fields

#: Steps between two random targets of the displacements. On the paper's arm at dt = 0.03 s, 16 makes the motion about
#: the equilibrium as large as that of the equilibrium itself; 8 is three times as violent, 24 nearly quasi-static.
STEPS_PER_TARGET = 16
SAMPLES_PER_BLOCK = 500
ATTEMPTS = 5
#: Input laws. "zero-sum": pretension plus differential pulls, the tendons stay taut. "independent": each tendon its own
#: displacement; slack ones leave the arm to its weight.
LAWS = ("zero-sum", "independent")
#: What moves an arm whose motion is recorded, the usual one first.
METHODS = ("fast", "idas")
IDAS_RTOL = 1e-5
NO_ACTUATOR = Actuator()
#: Changes when the same arm is moved or identified differently, so that older data are not taken for new ones.
EQUATIONS = 3


def random_displacements(arm: Arm, steps: int, rng: np.random.Generator, law: str = "zero-sum") -> Array:
    """Smooth random displacements (steps, m) in m between random targets of ``law`` (:func:`random_targets`).

    A new target every 16 steps, a raised cosine in between. It starts with the arm at rest.

    ``arm`` gives rest and amplitude, ``rng`` draws.
    """
    count(steps, "steps")
    knots = -(-steps // STEPS_PER_TARGET) + 1
    targets = random_targets(arm, knots, rng, law)
    targets[0] = arm.rest_inputs
    phase = np.arange(1, steps + 1) / STEPS_PER_TARGET
    before = np.minimum(phase.astype(int), knots - 2)
    blend = 0.5 - 0.5 * np.cos(np.pi * (phase - before))[:, None]
    moves: Array = targets[before] * (1.0 - blend) + targets[before + 1] * blend
    return moves


def random_targets(arm: Arm, n: int, rng: np.random.Generator, law: str = "zero-sum") -> Array:
    """``n`` random displacements (n, m) in m.

    "zero-sum": ``arm.rest_inputs`` plus :func:`random_differential`; "independent": each tendon uniformly between
    minus and plus ``arm.amplitude``, so that half of the tendons are slack.

    ``arm`` gives rest and amplitude, ``rng`` draws; ``law`` is one of :data:`LAWS`.
    """
    if one_of(law, "law", LAWS) == "independent":
        return rng.uniform(-arm.amplitude, arm.amplitude, size=(n, arm.scene.n_inputs))
    moves: Array = arm.rest_inputs + random_differential(arm, n, rng)
    return moves


def random_differential(arm: Arm, n: int, rng: np.random.Generator) -> Array:
    """``n`` random zero-sum displacements (n, m) in m that bend every section, even over the disc of ``arm.amplitude``.

    ``rng`` draws.
    """
    moves: Array = np.zeros((n, arm.scene.n_inputs))
    for share in arm.shares.T:
        radius = arm.amplitude * np.sqrt(rng.uniform(size=(n, 1)))
        direction = rng.uniform(-np.pi, np.pi, size=(n, 1))
        moves += share * (radius * np.cos(arm.tendon_angles[None, :] - direction))
    return moves


@dataclass(frozen=True)
class EpisodeTask:
    """One episode from rest: the work of one block of D1. Draws whose simulation fails are recorded and replaced.

    Its attributes are arguments of ``make_episodes``: arm, steps, dt, rtol, stations, seed, law, compiled, actuator,
    method.
    """

    arm: Arm
    steps: int
    dt: float
    rtol: float | None
    stations: int
    seed: int
    law: str = "zero-sum"
    compiled: bool = False
    actuator: Actuator = NO_ACTUATOR
    method: str = METHODS[0]

    def __call__(self, k: int) -> Block:
        """Episode ``k``: states, inputs, fields, and how many steps the fast way left to others."""
        simulator = _simulator(self.arm, self.dt, self.rtol, self.stations, self.compiled, self.method)
        failures: list[str] = []
        for attempt in range(ATTEMPTS):
            rng = np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=(1, k, attempt)))
            commands = random_displacements(self.arm, self.steps, rng, self.law)
            simulator.reset(self.arm.rest_inputs)
            check = None if self.method == "idas" else False  # each large step carries its own
            trajectory = simulator.run(self._moves(commands), simulator.state, check=check)
            if trajectory.success:
                fields = trajectory.fields(self.stations).reshape(self.steps + 1, -1)
                left = np.array([sum(map(len, trajectory.fallbacks.values()))])
                failed = np.array(failures, dtype=str)
                return {"x": fields, "u": commands, "state": trajectory.x, "failures": failed, "left": left}
            failures.append(trajectory.message)
        raise RuntimeError(f"episode {k} failed {ATTEMPTS} times, last: {failures[-1]}")

    def _moves(self, commands: Array) -> Array:
        """What the servos make of the commands (T, m), from rest."""
        start = ActuatorState.at(self.arm.rest_inputs)
        return self.actuator.simulate(commands, self.dt, start)[0]


def make_episodes(
    arm: Arm,
    path: str | os.PathLike[str],
    episodes: int,
    steps: int = 200,
    dt: float = 0.03,
    rtol: float | None = None,
    stations: int = 6,
    seed: int = 0,
    workers: int = -1,
    progress: bool = True,
    law: str = "zero-sum",
    compiled: bool = False,
    actuator: Actuator = NO_ACTUATOR,
    method: str = METHODS[0],
) -> Episodes:
    """Simulate ``episodes`` trajectories of the arm, store them at ``path`` (HDF5) and return them.

    States are the 24 fields at every station (names, quantities, units in the file); ``extra["state"]`` holds the
    states [xi, xi_t, u] of the simulator. Seeds are per episode: the answer does not depend on ``workers``.
    ``compiled`` turns the scene into machine code first: ten seconds once, then several times faster, same numbers.
    ``actuator``: servos between commands, which are recorded, and tendons.

    Args:
        arm: what moves.
        path: of the file.
        episodes: their number.
        steps: of each.
        dt: of a step in s.
        rtol: relative tolerance of IDAS, 1e-5 when not given; only with its method.
        stations: number of measured stations.
        seed: of all of them.
        workers: processes, -1 for one a core.
        progress: whether to show a bar.
        law: of the inputs (:data:`LAWS`).
        compiled, actuator: see above.
        method: what moves the arm (:data:`METHODS`): large checked Radau steps (``Scene.fast_stepper``), whose errors
            stay below 1e-4 L, or IDAS. Steps that the fast way left to smaller ones or to IDAS are counted in the
            provenance, ``fallback_steps``.
    """
    count(episodes, "episodes")
    identity = episodes_origin(arm, steps, dt, rtol, stations, seed, law, actuator, method)
    task = EpisodeTask(arm, *(identity[name] for name in ("steps", "dt", "rtol", "stations", "seed", "law")))
    task = replace(task, actuator=actuator, method=identity["method"])
    if compiled:
        task = replace(task, compiled=True)
        _simulator(arm, task.dt, task.rtol, task.stations, True, task.method)  # compiled once, not by every worker
    parts = f"{os.fspath(path)}.parts"
    Path(path).parent.mkdir(parents=True, exist_ok=True)
    blocks = run_blocks(task, episodes, parts, identity, workers, "episodes", progress)
    found = arm.scene.field_map(stations)
    failures = [f"episode {k}: {text}" for k, block in enumerate(blocks) for text in block["failures"]]
    result = Episodes(
        [block["x"] for block in blocks],
        [block["u"] for block in blocks],
        dt=dt,
        extra={"state": [block["state"] for block in blocks]},
        provenance={**identity, "failures": failures, "fallback_steps": int(sum(b["left"][0] for b in blocks))},
        **_labels(arm, found),
    )
    result.save(path)
    discard_blocks(parts)
    return result


def episodes_origin(
    arm: Arm,
    steps: int = 200,
    dt: float = 0.03,
    rtol: float | None = None,
    stations: int = 6,
    seed: int = 0,
    law: str = "zero-sum",
    actuator: Actuator = NO_ACTUATOR,
    method: str = METHODS[0],
) -> dict[str, Any]:
    """All that decides the episodes of ``make_episodes`` but their number; part of their provenance.

    ``arm``, ``steps``, ``dt``, ``rtol``, ``stations``, ``seed``, ``law``, ``actuator`` and ``method`` are as there.
    """
    if one_of(method, "method", METHODS) == "fast" and rtol is not None:
        raise ValueError(f"rtol = {rtol!r} has no effect on method='fast'; leave it out, or give method='idas'")
    return {
        **_arm_origin(arm, "episodes", stations, seed, law),
        "steps": count(steps, "steps"),
        "steps_per_target": STEPS_PER_TARGET,
        "dt": positive(dt, "dt", "s"),
        "method": method,
        "rtol": None if method == "fast" else positive(IDAS_RTOL if rtol is None else rtol, "rtol"),
        "actuator": [actuator.lag, actuator.play, actuator.rate],
    }


def phase_origin(
    arm: Arm,
    rates: Array,
    stations: int = 6,
    seed: int = 0,
    law: str = "zero-sum",
    deviations: Array | None = None,
    known: rod.Scene | None = None,
    dt: float | None = None,
) -> dict[str, Any]:
    """All that decides the samples of ``make_phase_samples``, whose arguments these are, but their number.

    It is part of their provenance. Raises ValueError for a known part with inputs or with other strains than the arm.

    ``arm``, ``rates``, ``stations``, ``seed``, ``law``, ``deviations``, ``known`` and ``dt`` are these arguments.
    """
    n = arm.scene.n_strains
    if known is not None and (known.n_inputs or known.n_strains != n):
        raise ValueError(
            f"known has {known.n_strains} strains and {known.n_inputs} inputs; "
            f"expected {n} and none: leave terms of the arm out with arm.scene.without(...)"
        )
    return {
        **_arm_origin(arm, "phase", stations, seed, law),
        "rates": _digest(finite_array(rates, "rates", (None, n))),
        "deviations": None if deviations is None else _digest(finite_array(deviations, "deviations", (None, n))),
        "known": _fingerprint(arm.passive if known is None else known, stations),
        "flow": None if dt is None else 0.5 * positive(dt, "dt", "s"),
    }


def check_origin(
    path: str | os.PathLike[str], provenance: Mapping[str, Any] | None, expected: Mapping[str, Any]
) -> None:
    """Raise ValueError if the data in ``path`` were made for another arm or with other settings.

    Args:
        path: of the data, for the message.
        provenance: that of the data.
        expected: what ``episodes_origin`` or ``phase_origin`` gives for the arm and the settings that are wanted.
    """
    given = provenance or {}
    for name, value in expected.items():
        if name == "arm":  # a text for readers; "scene" tells arms apart
            continue
        if given.get(name) != value:
            found = f"with {name} = {given.get(name)!r}, not {value!r}"
            what = {"scene": "for another arm", "known": "with another known part"}.get(name, found)
            raise ValueError(f"{os.fspath(path)} holds data made {what}; delete it or choose another folder")


@dataclass(frozen=True)
class PhaseTask:
    """Static shapes under random displacements with random rates: the work of one block of D2.

    Its attributes follow from arguments of ``make_phase_samples``: arm, samples (of a block), rate_factor and
    shape_factor (n, n) (roots of the covariances of rates and of deviations), stations, seed, law, known, dt, compiled.
    """

    arm: Arm
    samples: int
    rate_factor: Array
    shape_factor: Array | None
    stations: int
    seed: int
    law: str = "zero-sum"
    known: rod.Scene | None = None
    dt: float | None = None
    compiled: bool = False

    def __call__(self, k: int) -> Block:
        """Block ``k``: fields, inputs, passive derivative of the fields."""
        known = self.arm.passive if self.known is None else self.known
        statics, derivative = _known_derivative(self.arm, known, self.stations)
        scene = self.arm.scene
        rng = np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=(2, k)))
        states, failures = np.empty((0, scene.n_states)), []
        while len(states) < self.samples:
            wanted = self.samples - len(states)
            batch = statics.solve_many(random_targets(self.arm, wanted, rng, self.law))
            failures += [f"residual {r:.1e} EI/L" for r in batch.residual[~batch.success]]
            states = np.vstack([states, batch.states[batch.success]])
            if len(failures) > ATTEMPTS * self.samples:
                raise RuntimeError(f"block {k}: {len(failures)} static solves failed, last: {failures[-1]}")
        n = scene.n_strains
        if self.shape_factor is not None:
            states[:, :n] += rng.standard_normal((self.samples, n)) @ self.shape_factor
        states[:, n : 2 * n] = rng.standard_normal((self.samples, n)) @ self.rate_factor
        x, xdot = (np.asarray(v).T for v in derivative.map(self.samples)(states.T))
        block = {"x": x, "u": states[:, 2 * n :], "xdot": xdot, "failures": np.array(failures, dtype=str)}
        if self.dt is not None:
            flown = _flow(known, states, 0.5 * self.dt, self.compiled)
            block["x_half"] = scene.fields(flown, self.stations).reshape(self.samples, -1)
        return block


def make_phase_samples(
    arm: Arm,
    path: str | os.PathLike[str],
    samples: int,
    rates: Array,
    deviations: Array | None = None,
    stations: int = 6,
    seed: int = 0,
    workers: int = -1,
    progress: bool = True,
    law: str = "zero-sum",
    known: rod.Scene | None = None,
    dt: float | None = None,
    compiled: bool = False,
) -> PhaseSamples:
    """Sample the phase space of the passive arm, store the samples at ``path`` (HDF5) and return them.

    Shapes are equilibria of the arm under random displacements; rates are Gaussian with the covariance of ``rates``
    (N, n_strains), taken from simulated trajectories (paper, "Tendon-driven Soft Robot Setup"). ``xdot`` is the time
    derivative of the fields when the arm moves without its tendons.

    Args:
        arm: the arm; its tendons are not in f.
        path: of the file.
        samples: their number.
        stations: number of measured stations.
        seed: of all samples.
        workers: processes, -1 for one a core.
        progress: whether to show a bar.
        rates: strain rates (N, n_strains) of simulated trajectories.
        deviations: strains minus those of the equilibrium under the same inputs (N, n_strains), from trajectories.
            Their covariance is added to the static shapes. Without them D2 is the paper's: its shapes span few
            directions, and what is fitted to them is undetermined in the others.
        law: input law of the shapes (:data:`LAWS`).
        known: the arm as far as f knows it, without inputs (default: all but the tendons).
        dt: time step in s; with it the samples hold the flow of f over half of it, one integration each.
        compiled: integrate the flow by machine code (:func:`make_episodes`).
    """
    count(samples, "samples")
    identity = phase_origin(arm, rates, stations, seed, law, deviations, known, dt)
    if dt is not None and compiled:
        _flow_simulator(arm.passive if known is None else known, 0.5 * dt, True)
    n = arm.scene.n_strains
    factor = _gaussian_factor(rates, "rates", n)
    shape_factor = None if deviations is None else _gaussian_factor(deviations, "deviations", n)
    task = PhaseTask(
        arm, min(samples, SAMPLES_PER_BLOCK), factor, shape_factor, stations, identity["seed"], law, known, dt, compiled
    )
    identity["block"] = task.samples
    parts = f"{os.fspath(path)}.parts"
    Path(path).parent.mkdir(parents=True, exist_ok=True)
    blocks = run_blocks(task, -(-samples // task.samples), parts, identity, workers, "phase samples", progress)
    x, u, xdot = (np.concatenate([b[name] for b in blocks])[:samples] for name in ("x", "u", "xdot"))
    half = None if dt is None else np.concatenate([b["x_half"] for b in blocks])[:samples]
    failures = [f"block {k}: {text}" for k, block in enumerate(blocks) for text in block["failures"]]
    names = _labels(arm, arm.scene.field_map(stations))
    result = PhaseSamples(
        x,
        u,
        xdot,
        x_half=half,
        dt=dt,
        state_names=names["state_names"],
        input_names=names["input_names"],
        provenance={**identity, "failures": failures},
    )
    result.save(path)
    discard_blocks(parts)
    return result


def deviations_from_equilibrium(arm: Arm, episodes: Episodes) -> tuple[Array, Array]:
    """Strains minus those at rest under the inputs of the moment, and strain rates, each (N, n_strains), of simulated
    episodes.

    ``arm`` is the one that moved in ``episodes``. Raises ValueError for episodes of another arm and for recordings of a
    real one, whose strains nobody knows.
    """
    n = arm.scene.n_strains
    states = _simulated_states(arm, episodes)
    rest = arm.scene.statics().solve_many(states[:, 2 * n :])
    kept = rest.success
    return states[kept, :n] - rest.states[kept, :n], states[:, n : 2 * n]


def strain_rates(arm: Arm, episodes: Episodes) -> Array:
    """Strain rates (N, n_strains) of simulated episodes. ``arm`` is the one that moved in ``episodes``."""
    n = arm.scene.n_strains
    rates: Array = _simulated_states(arm, episodes)[:, n : 2 * n]
    return rates


def _simulated_states(arm: Arm, episodes: Episodes) -> Array:
    extra = episodes.extra or {}
    if "state" not in extra:
        raise ValueError("the episodes hold no states of a simulator (extra['state']); make them with make_episodes")
    made = episodes.provenance or {}
    if made.get("kind") == "episodes" and made.get("scene") != _fingerprint(arm.scene, made["stations"]):
        raise ValueError("the episodes were made by another arm, or by this one before it was changed; give that arm")
    return finite_array(np.concatenate(list(extra["state"])), "extra['state']", (None, arm.scene.n_states))


def _gaussian_factor(given: Array, name: str, n: int) -> Array:
    """F with F^T F the covariance of the samples: rows of standard normals times F have that covariance."""
    samples = finite_array(given, name, (None, n))
    if len(samples) < 2:
        raise ValueError(f"{name} has {len(samples)} rows; a covariance needs at least two")
    covariance = np.atleast_2d(np.cov(samples.T))
    floor = 1e-12 * np.trace(covariance) * np.eye(len(covariance))
    factor: Array = np.linalg.cholesky(covariance + floor).T
    return factor


def _labels(arm: Arm, found: Fields) -> dict[str, Any]:
    return {
        "state_names": found.names,
        "quantities": found.quantities,
        "units": tuple(UNITS[q] for q in found.quantities),
        "outputs": found.outputs,
        "input_names": arm.scene.input_names,
    }


def _arm_origin(arm: Arm, kind: str, stations: int, seed: int, law: str) -> dict[str, Any]:
    return {
        "kind": kind,
        "equations": EQUATIONS,
        "arm": re.sub(r" at 0x[0-9a-f]+", "", str(arm.scene)),  # a text to read, without addresses of functions
        "scene": _fingerprint(arm.scene, count(stations, "stations")),
        "pretension": arm.pretension,
        "amplitude": arm.amplitude,
        "law": one_of(law, "law", LAWS),
        "stations": count(stations, "stations"),
        "seed": count(seed, "seed", 0),
    }


def _fingerprint(scene: rod.Scene, stations: int = 6) -> str:
    return scene.fingerprint(stations)


def _digest(samples: Array) -> str:
    found = finite_array(samples, "samples", (None, None))
    return hashlib.sha256(f"{found.shape}".encode() + np.ascontiguousarray(found).tobytes()).hexdigest()[:16]


@lru_cache(maxsize=2)
def _simulator(arm: Arm, dt: float, rtol: float | None, stations: int, compiled: bool, method: str) -> Any:
    scene = arm.scene.compile(stations) if compiled else arm.scene
    if method == "fast":
        return scene.fast_stepper(dt=dt, stations=stations)
    return scene.simulator(dt=dt, rtol=rtol, stations=stations)


@lru_cache(maxsize=2)
def _known_derivative(arm: Arm, known: rod.Scene, stations: int) -> tuple[Any, ca.Function]:
    """Statics of the arm, and ``state -> (fields, time derivative of the fields under the known part)``."""
    scene = arm.scene
    n = scene.n_strains
    fields = scene.field_map(stations).function
    x = ca.MX.sym("x", scene.n_states)
    acceleration = known.acceleration(x[:n], x[n : 2 * n], ca.MX(known.n_inputs, 1))
    flow = ca.vertcat(x[n : 2 * n], acceleration, ca.MX.zeros(scene.n_inputs))
    y = fields(x)
    return scene.statics(), ca.Function("known", [x], [y, ca.jtimes(y, x, flow)])


def _flow(known: rod.Scene, states: Array, t: float, compiled: bool) -> Array:
    """States (N, n) after ``t`` seconds of the known part alone; the displacements in them stay."""
    simulator = _flow_simulator(known, t, compiled)
    n = 2 * known.n_strains
    flown = states.copy()
    for row in flown:
        trajectory = simulator.run(np.zeros((1, 0)), row[:n])
        if not trajectory.success:
            raise RuntimeError(f"the flow of the known part failed: {trajectory.message}")
        row[:n] = trajectory.x[-1, :n]
    return flown


@lru_cache(maxsize=2)
def _flow_simulator(known: rod.Scene, t: float, compiled: bool) -> Any:
    return (known.compile() if compiled else known).simulator(dt=t, rtol=1e-4)
