"""Phase-space samples of an arm's passive part (D2): shapes under random displacements with random rates."""

from __future__ import annotations

import hashlib
import os
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import casadi as ca
import joblib
import numpy as np

from pisplit import Episodes, PhaseSamples
from pisplit.checks import Array, count, finite_array, one_of, positive
from pisplit.models import rod
from pisplit.models.arm.base import Arm
from pisplit.models.arm.blocks import Block, discard_blocks, run_blocks
from pisplit.models.arm.recording import ATTEMPTS, METHODS, arm_origin, labels, random_targets
from pisplit.models.rod.output.compiled import CompiledScene
from pisplit.models.rod.output.paying import Compiled, checked_compiled, pays
from pisplit.models.rod.statics.machine import by_machine

SAMPLES_PER_BLOCK = 500
#: Relative tolerance of IDAS for a flow.
FLOW_RTOL = 1e-4
#: Evaluations of a Jacobian, or what costs as much, by the flow of one sample: it starts anywhere, with fast modes.
FLOW = {"fast": 20.0, "idas": 80.0}


def phase_origin(
    arm: Arm,
    rates: Array,
    stations: int = 6,
    seed: int = 0,
    law: str = "zero-sum",
    deviations: Array | None = None,
    known: rod.Scene | None = None,
    dt: float | None = None,
    method: str = METHODS[0],
) -> dict[str, Any]:
    """All that decides the samples of ``make_phase_samples``, whose arguments these are, but their number.

    It is part of their provenance. Raises ValueError for a known part with inputs or with other strains than the arm.

    ``arm``, ``rates``, ``stations``, ``seed``, ``law``, ``deviations``, ``known``, ``dt`` and ``method`` are these
    arguments.
    """
    one_of(method, "method", METHODS)
    n = arm.scene.n_strains
    if known is not None and (known.n_inputs or known.n_strains != n):
        raise ValueError(
            f"known has {known.n_strains} strains and {known.n_inputs} inputs; "
            f"expected {n} and none: leave terms of the arm out with arm.scene.without(...)"
        )
    if known is not None and known.branches:
        raise ValueError(
            "known has Maxwell branches, whose stress no measured field shows; leave them out with "
            "known.without(rod.Maxwell)"
        )
    return {
        **arm_origin(arm, "phase", stations, seed, law),
        "rates": _digest(finite_array(rates, "rates", (None, n))),
        "deviations": None if deviations is None else _digest(finite_array(deviations, "deviations", (None, n))),
        "known": (arm.backbone if known is None else known).fingerprint(stations),
        "flow": None if dt is None else 0.5 * positive(dt, "dt", "s"),
        "flow_method": None if dt is None else method,
    }


@dataclass(frozen=True)
class PhaseTask:
    """Static shapes under random displacements with random rates: the work of one block of D2.

    Its attributes follow from arguments of ``make_phase_samples``: arm, samples (of a block), rate_factor and
    shape_factor (n, n) (roots of the covariances of rates and of deviations), stations, seed, law, known, dt, compiled,
    method.
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
    method: str = METHODS[0]

    def __call__(self, k: int) -> Block:
        """Block ``k``: fields, inputs, passive derivative of the fields."""
        known = self.arm.backbone if self.known is None else self.known
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
        states[:, scene.layout.rates] = rng.standard_normal((self.samples, n)) @ self.rate_factor
        x, xdot = (np.asarray(v).T for v in derivative.map(self.samples)(states.T))
        block = {"x": x, "u": states[:, scene.layout.inputs], "xdot": xdot, "failures": np.array(failures, dtype=str)}
        if self.dt is not None:
            flown = _flow(known, states, 0.5 * self.dt, self.compiled, self.method)
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
    compiled: Compiled = "auto",
    method: str = METHODS[0],
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
        known: the arm as far as f knows it, without inputs (default: all but the tendons and Maxwell branches).
        dt: time step in s; with it the samples hold the flow of f over half of it, one integration each.
        compiled: integrate the flow, and solve for shapes, by machine code (:func:`make_episodes`).
        method: what integrates the flow, "fast" or "idas" (:func:`make_episodes`).
    """
    count(samples, "samples")
    checked_compiled(compiled)
    identity = phase_origin(arm, rates, stations, seed, law, deviations, known, dt, method)
    machine = _compile(compiled, arm, arm.backbone if known is None else known, samples, dt, workers, method)
    n = arm.scene.n_strains
    factor = _gaussian_factor(rates, "rates", n)
    shape_factor = None if deviations is None else _gaussian_factor(deviations, "deviations", n)
    block = min(samples, SAMPLES_PER_BLOCK)
    task = PhaseTask(arm, block, factor, shape_factor, stations, identity["seed"], law, known, dt, machine, method)
    identity["block"] = block
    parts = f"{os.fspath(path)}.parts"
    Path(path).parent.mkdir(parents=True, exist_ok=True)
    blocks = run_blocks(task, -(-samples // task.samples), parts, identity, workers, "phase samples", progress)
    x, u, xdot = (np.concatenate([b[name] for b in blocks])[:samples] for name in ("x", "u", "xdot"))
    half = None if dt is None else np.concatenate([b["x_half"] for b in blocks])[:samples]
    failures = [f"block {k}: {text}" for k, block in enumerate(blocks) for text in block["failures"]]
    names = labels(arm, arm.scene.field_map(stations))
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


def _compile(
    compiled: Compiled, arm: Arm, known: rod.Scene, samples: int, dt: float | None, workers: int, method: str
) -> bool:
    """Whether the flow of ``known`` over half of ``dt`` is machine code; what pays is made here once."""
    share = samples / joblib.effective_n_jobs(workers)
    by_machine(arm.scene.statics(), compiled, share)
    if dt is None:
        return False
    twin = CompiledScene.of(known)
    flows = pays(compiled, FLOW[method] * share, lambda: [f for _, made in twin.to_compile(6) for f in made])
    if flows:
        _flow_mover(known, 0.5 * dt, True, method)
    return flows


def deviations_from_equilibrium(arm: Arm, episodes: Episodes) -> tuple[Array, Array]:
    """Strains minus those at rest under the inputs of the moment, and strain rates, each (N, n_strains), of simulated
    episodes.

    ``arm`` is the one that moved in ``episodes``. Raises ValueError for episodes of another arm and for recordings of a
    real one, whose strains nobody knows.
    """
    strains, moving, _, u = arm.scene.layout.split(_simulated_states(arm, episodes))
    rest = arm.scene.statics().solve_many(u)
    kept = rest.success
    return strains[kept] - rest.states[kept, : arm.scene.n_strains], moving


def strain_rates(arm: Arm, episodes: Episodes) -> Array:
    """Strain rates (N, n_strains) of simulated episodes. ``arm`` is the one that moved in ``episodes``."""
    rates: Array = arm.scene.layout.split(_simulated_states(arm, episodes)).rates
    return rates


def _simulated_states(arm: Arm, episodes: Episodes) -> Array:
    extra = episodes.extra or {}
    if "state" not in extra:
        raise ValueError("the episodes hold no states of a simulator (extra['state']); make them with make_episodes")
    made = episodes.provenance or {}
    if made.get("kind") == "episodes" and made.get("scene") != arm.scene.fingerprint(made["stations"]):
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


def _digest(samples: Array) -> str:
    found = finite_array(samples, "samples", (None, None))
    return hashlib.sha256(f"{found.shape}".encode() + np.ascontiguousarray(found).tobytes()).hexdigest()[:16]


@lru_cache(maxsize=2)
def _known_derivative(arm: Arm, known: rod.Scene, stations: int) -> tuple[Any, ca.Function]:
    """Statics of the arm, and ``state -> (fields, time derivative of the fields under the known part)``."""
    scene = arm.scene
    made: dict[tuple[int, int], tuple[rod.Scene, ca.Function]] = scene.__dict__.setdefault("_known_derivatives", {})
    key = id(known), stations
    if key not in made:
        made[key] = known, _derivative(scene, known, stations)  # the scene stays alive with its number
    return scene.statics(), made[key][1]


def _derivative(scene: rod.Scene, known: rod.Scene, stations: int) -> ca.Function:
    """``state -> (fields, time derivative of the fields under the known part)``."""
    fields = scene.field_map(stations).function
    x = ca.MX.sym("x", scene.n_states)
    strains, moving, *hidden = scene.layout.split(x)
    acceleration = known.acceleration(strains, moving, ca.MX(known.n_inputs, 1))
    flow = ca.vertcat(moving, acceleration, *(ca.MX.zeros(part.shape[0]) for part in hidden))
    y = fields(x)
    return ca.Function("known", [x], [y, ca.jtimes(y, x, flow)])


def _flow(known: rod.Scene, states: Array, t: float, compiled: bool, method: str) -> Array:
    """States (N, n) after ``t`` seconds of the known part alone; the displacements in them stay."""
    mover = _flow_mover(known, t, compiled, method)
    n, check = known.layout.n_moving, None if method == "idas" else False  # each large step carries its own
    flown = states.copy()
    for row in flown:
        trajectory = mover.run(np.zeros((1, 0)), row[:n], check=check)
        if not trajectory.success:
            raise RuntimeError(f"the flow of the known part failed: {trajectory.message}")
        row[:n] = trajectory.x[-1, :n]
    return flown


@lru_cache(maxsize=2)
def _flow_mover(known: rod.Scene, t: float, compiled: bool, method: str) -> Any:
    scene = known.compile() if compiled else known
    return scene.fast_stepper(dt=t) if method == "fast" else scene.simulator(dt=t, rtol=FLOW_RTOL)
