"""Trajectories of an arm with tendons (D1): how it is moved, simulated, labelled and told apart from others."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import casadi as ca
import joblib
import numpy as np

from pisplit import Episodes
from pisplit.checks import Array, count, one_of, positive
from pisplit.data.actuator import Actuator, ActuatorState, checked_actuator
from pisplit.models import rod
from pisplit.models.arm.base import Arm
from pisplit.models.arm.blocks import Block, discard_blocks, run_blocks
from pisplit.models.rod.analysis.fields import UNITS, Fields
from pisplit.models.rod.output.compiled import CompiledScene
from pisplit.models.rod.output.paying import IDAS_STEP, RUBBING_STEP, STEP, Compiled, checked_compiled, pays

#: Steps between two random targets of the displacements. On the paper's arm at dt = 0.03 s, 16 makes the motion about
#: the equilibrium as large as that of the equilibrium itself; 8 is three times as violent, 24 nearly quasi-static.
STEPS_PER_TARGET = 16
ATTEMPTS = 5
#: Input laws. "zero-sum": pretension plus differential pulls, the tendons stay taut. "independent": each tendon its own
#: displacement; slack ones leave the arm to its weight.
LAWS = ("zero-sum", "independent")
#: What moves an arm whose motion is recorded, the usual one first.
METHODS = ("fast", "idas")
IDAS_RTOL = 1e-5
#: Large steps in a control interval: one keeps shapes to 1e-4 of their spread, rates of strains only to 1e-2; three
#: keep both to 1e-4, as IDAS does at rtol 1e-4, in twice the time of one.
STEPS_PER_INTERVAL = 3
NO_ACTUATOR = Actuator()
#: Changes when the same arm is moved or identified differently, so that older data are not taken for new ones.
EQUATIONS = 5


def random_displacements(
    arm: Arm, steps: int, rng: np.random.Generator, law: str = "zero-sum", hold: int = STEPS_PER_TARGET
) -> Array:
    """Smooth random displacements (steps, m) in m between random targets of ``law`` (:func:`random_targets`).

    A new target every ``hold`` steps, a raised cosine in between. It starts with the arm at rest.

    ``arm`` gives rest and amplitude, ``rng`` draws.
    """
    count(steps, "steps")
    knots = -(-steps // count(hold, "hold")) + 1
    targets = random_targets(arm, knots, rng, law)
    targets[0] = arm.rest_inputs
    phase = np.arange(1, steps + 1) / hold
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
    compiled: Compiled = "auto",
    actuator: Actuator = NO_ACTUATOR,
    method: str = METHODS[0],
) -> Episodes:
    """Simulate ``episodes`` trajectories of the arm, store them at ``path`` (HDF5) and return them.

    States are the 24 fields at every station (names, quantities, units in the file); ``extra["state"]`` holds the
    states [xi, xi_t, u] of the simulator. Seeds are per episode: the answer does not depend on ``workers``.
    ``compiled`` turns the scene into machine code first: some seconds once, then six times faster, the same numbers;
    by default where the run is long enough to gain by it, and there is a C compiler.
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
    checked_compiled(compiled)
    checked_actuator(actuator)
    identity = episodes_origin(arm, steps, dt, rtol, stations, seed, law, actuator, method)
    task = EpisodeTask(arm, *(identity[name] for name in ("steps", "dt", "rtol", "stations", "seed", "law")))
    task = replace(task, actuator=actuator, method=identity["method"])
    if _compile(compiled, task, episodes / min(joblib.effective_n_jobs(workers), episodes)):
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
        **labels(arm, found),
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
        **arm_origin(arm, "episodes", stations, seed, law),
        "steps": count(steps, "steps"),
        "steps_per_target": STEPS_PER_TARGET,
        "dt": positive(dt, "dt", "s"),
        "method": method,
        "rtol": None if method == "fast" else positive(IDAS_RTOL if rtol is None else rtol, "rtol"),
        "actuator": [actuator.lag, actuator.play, actuator.rate],
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
    given = dict(provenance or {})
    if "backlash" in given:  # of older versions, whose servos had play alone
        given["actuator"] = [0.0, given["backlash"], None]
    for name, value in expected.items():
        if name == "arm":  # a text for readers; "scene" tells arms apart
            continue
        if given.get(name) != value:
            found = f"with {name} = {given.get(name)!r}, not {value!r}"
            what = {"scene": "for another arm", "known": "with another known part"}.get(name, found)
            raise ValueError(f"{os.fspath(path)} holds data made {what}; delete it or choose another folder")


def labels(arm: Arm, found: Fields) -> dict[str, Any]:
    """Names, quantities, units and outputs of the fields ``found`` of an ``arm``, and names of its inputs."""
    return {
        "state_names": found.names,
        "quantities": found.quantities,
        "units": tuple(UNITS[q] for q in found.quantities),
        "outputs": found.outputs,
        "input_names": arm.scene.input_names,
    }


def arm_origin(arm: Arm, kind: str, stations: int, seed: int, law: str) -> dict[str, Any]:
    """What decides data of any ``kind``: the ``arm``, its ``stations``, ``seed`` and input ``law``."""
    return {
        "kind": kind,
        "equations": EQUATIONS,
        "arm": re.sub(r" at 0x[0-9a-f]+", "", str(arm.scene)),  # a text to read, without addresses of functions
        "scene": arm.scene.fingerprint(count(stations, "stations")),
        "pretension": arm.pretension,
        "amplitude": arm.amplitude,
        "law": one_of(law, "law", LAWS),
        "stations": count(stations, "stations"),
        "seed": count(seed, "seed", 0),
    }


def _compile(compiled: Compiled, task: EpisodeTask, episodes: float) -> bool:
    """Whether machine code is made for the ``task``, of which one core does ``episodes``."""
    rubs = any(isinstance(t, rod.Tendons) and t.friction > 0.0 and t.slip_speed for t in task.arm.scene.terms)
    a_step = STEPS_PER_INTERVAL * (RUBBING_STEP if rubs else STEP) if task.method == "fast" else IDAS_STEP
    twin = CompiledScene.of(task.arm.scene)

    def functions() -> list[ca.Function]:
        return [f for _, made in twin.to_compile(task.stations) for f in made]

    return pays(compiled, a_step * task.steps * episodes, functions)


@lru_cache(maxsize=2)
def _simulator(arm: Arm, dt: float, rtol: float | None, stations: int, compiled: bool, method: str) -> Any:
    scene = arm.scene.compile(stations) if compiled else arm.scene
    if method == "fast":
        return scene.fast_stepper(dt=dt, step=dt / STEPS_PER_INTERVAL, stations=stations)
    return scene.simulator(dt=dt, rtol=rtol, stations=stations)
