"""Little data as robots give them: few pairs of recordings that move one input at a time, and an unstable plant."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import casadi as ca
import numpy as np
from numpy.typing import NDArray

import pisplit as ps
from pisplit.models import ControlSystem
from pisplit.models.arm.recording import labels

Array = NDArray[np.float64]

#: Steps between random targets of the commands.
STEPS_PER_TARGET = 16
INPUTS = 3


def commands(law: str, i: int, steps: int, rng: np.random.Generator, low: float) -> Array:
    """Smooth commands (steps, 3) from ``low`` to 1: of input ``i`` modulo 3 alone, or of all by the ``law`` "all"."""
    knots = -(-steps // STEPS_PER_TARGET) + 1
    targets = rng.uniform(low, 1.0, (knots, INPUTS))
    targets[0] = 0.0
    phase = np.arange(1, steps + 1) / STEPS_PER_TARGET
    before = np.minimum(phase.astype(int), knots - 2)
    blend = 0.5 - 0.5 * np.cos(np.pi * (phase - before))[:, None]
    moves: Array = targets[before] * (1.0 - blend) + targets[before + 1] * blend
    if law == "single":
        moves[:, [j for j in range(INPUTS) if j != i % INPUTS]] = 0.0
    return moves


def bellows(law: str, number: int, rng: np.random.Generator, steps: int = 100) -> ps.Episodes:
    """Three bellows at 120 degrees: two bending coordinates and a stretch, stiffer under pressure; 0.005 of noise."""
    x, u = ca.SX.sym("x", 6), ca.SX.sym("u", INPUTS)
    q, v = x[:3], x[3:]
    angles = 2.0 * np.pi * np.arange(INPUTS) / INPUTS
    drive = 30.0 * ca.DM(np.stack([np.cos(angles), np.sin(angles), np.full(INPUTS, 0.6)]))
    stiffness = 30.0 * (1.0 + ca.sum1(u) / 6.0) + 20.0 * ca.sumsqr(q)
    force = ca.mtimes(drive, u) - stiffness * q - 2.5 * v
    system = ControlSystem(x, u, known=ca.vertcat(v, ca.DM.zeros(3)), unknown=ca.vertcat(ca.DM.zeros(3), force))
    us = [commands(law, i, steps, rng, 0.0) for i in range(number)]
    d = ps.Episodes.from_system(system, np.zeros((number, 6)), us, 0.05, substeps=2)
    return replace(d, xs=[x + 0.005 * rng.standard_normal(x.shape) for x in d.xs])


def arm(law: str, number: int, rng: np.random.Generator, steps: int = 120) -> ps.Episodes:
    """The paper's arm, fields at two stations: single tendons are pulled and let go."""
    made, stations, dt = ps.TendonArm.paper(), 2, 0.03
    stepper = made.scene.fast_stepper(dt=dt, stations=stations)
    xs, us = [], []
    for i in range(number):
        u = made.rest_inputs + made.amplitude * commands(law, i, steps, rng, -1.0)
        stepper.reset(made.rest_inputs)
        found = stepper.run(u, stepper.state, check=False)
        if not found.success:
            raise RuntimeError(f"recording {i} could not be simulated: {found.message}")
        xs.append(found.fields(stations).reshape(steps + 1, -1))
        us.append(u)
    return ps.Episodes(xs, us, dt, **labels(made, made.scene.field_map(stations)))


def draws(pool: ps.Episodes, number: int, seed: int, pairs: int = 64) -> Iterator[tuple[ps.Episodes, ps.Pairs]]:
    """Draws of ``pairs`` from 8 or 9 recordings of the ``pool``, two or three of them for each input."""
    rng = np.random.default_rng(seed)
    for k in range(number):
        size = 8 + k % 2
        by_input = [rng.permutation(np.arange(j, len(pool), INPUTS)) for j in range(INPUTS)]
        d1 = pool.subset(np.concatenate([own[: (size + INPUTS - 1 - j) // INPUTS] for j, own in enumerate(by_input)]))
        yield d1, d1.pairs(1).sample(pairs, int(rng.integers(1 << 30)))


def pendulum(number: int, seed: int, steps: int = 150) -> ps.Episodes:
    """An inverted pendulum at 20 Hz under a stabilising law and an exploring command; 0.002 rad and rad/s of noise."""
    rng, dt, substeps = np.random.default_rng(seed), 0.05, 10
    xs, us = [], []
    for _ in range(number):
        x = np.zeros((steps + 1, 2))
        x[0] = 0.1 * rng.normal(size=2)
        command, u = np.repeat(rng.normal(size=steps // 5 + 1), 5)[:steps], np.zeros((steps, 1))
        for k in range(steps):
            u[k] = -25.0 * x[k, 0] - 7.0 * x[k, 1] + 4.0 * command[k]
            angle, rate = x[k]
            for _ in range(substeps):
                rate += dt / substeps * (9.81 * np.sin(angle) - 0.1 * rate + u[k, 0])
                angle += dt / substeps * rate
            x[k + 1] = angle, rate
        xs.append(x + 0.002 * rng.normal(size=x.shape))
        us.append(u)
    return ps.Episodes(xs, us, dt, state_names=["angle", "rate"], units=["rad", "rad/s"])
